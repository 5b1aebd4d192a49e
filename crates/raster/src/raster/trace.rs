//! What a mask leaves behind for its gradient.

use super::{Mode, Model, Size, coverage, soft};

/// Of an image; the gradient is the same without, to the same bits, but has to find it again.
#[derive(Debug, Clone)]
pub(super) enum Trace {
    /// The visible outline, of mode coverage.
    Outline(coverage::Trace),
    /// What the faces leave of each pixel, of the exact soft masks.
    Product(soft::Kept),
}

impl Trace {
    pub(super) fn outline(&self) -> Option<&coverage::Trace> {
        match self {
            Self::Outline(outline) => Some(outline),
            Self::Product(_) => None,
        }
    }

    pub(super) fn product(&self) -> Option<&soft::Kept> {
        match self {
            Self::Product(product) => Some(product),
            Self::Outline(_) => None,
        }
    }

    /// Memory in bytes.
    pub(super) fn bytes(&self) -> usize {
        match self {
            Self::Outline(outline) => outline.bytes(),
            Self::Product(product) => product.bytes(),
        }
    }

    /// Whether it can be that of a mask of this kind.
    pub(super) fn is_of(&self, model: &Model, size: Size, mode: Mode) -> bool {
        match self {
            Self::Outline(outline) => outline.is_of(model, size, mode),
            Self::Product(product) => product.is_of(model, size, mode),
        }
    }
}
