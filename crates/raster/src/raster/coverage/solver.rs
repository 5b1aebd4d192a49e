//! Solves rectangles: pieces by pairs, halves where there are many, and the plain solver where
//! some run along each other.

use super::cell::{Cell, Half, LEFT_0, Piece, Rectangle, Stretch, split};
use super::pairs::{Events, MOST, Pairs};

/// A rectangle smaller than this, in pixels, is not split further.
const SMALL: f64 = 1e-6;

/// Takes results; a rectangle that was split comes in parts.
pub(super) trait Sink {
    /// Covered area of (a part of) the rectangle.
    fn area(&mut self, area: f64);
    /// A stretch of `edge` is visible, of the height `height` (positive if the uncovered side is
    /// the right one), its middle at the height `middle`.
    fn edge(&mut self, edge: u32, height: f64, middle: f64);
}

/// Buffers.
#[derive(Debug, Default)]
pub(super) struct Solver {
    pairs: Pairs,
    events: Events,
    plain: Plain,
    /// For halves.
    spare: Vec<Vec<Piece>>,
}

/// For the rectangles that are not simple.
#[derive(Debug, Default)]
struct Plain {
    cell: Cell,
    stretches: Vec<Stretch>,
}

impl Solver {
    /// Solve a rectangle. `layers` is the number of layers just outside its upper left corner.
    #[inline]
    pub(super) fn solve(
        &mut self,
        rectangle: Rectangle,
        pieces: &[Piece],
        layers: i32,
        sink: &mut impl Sink,
    ) {
        if is_covered(pieces, layers) {
            sink.area(rectangle.area());
            return;
        }
        if pieces.len() > MOST {
            self.halve(rectangle, pieces, layers, sink);
            return;
        }
        let visible = |p: &Piece, height: f64, middle: f64| sink.edge(p.edge, height, middle);
        match self.pairs.solve(rectangle, pieces, layers, &mut self.events, visible) {
            Some(area) => sink.area(area),
            None => self.plain.solve(rectangle, pieces, layers, sink),
        }
    }

    #[inline(never)]
    fn halve(&mut self, rectangle: Rectangle, pieces: &[Piece], layers: i32, sink: &mut impl Sink) {
        if rectangle.right - rectangle.left < SMALL {
            if layers > 0 {
                sink.area(rectangle.area());
            }
            return;
        }
        let spare = std::array::from_fn(|_| self.spare.pop().unwrap_or_default());
        for Half { rectangle, pieces, layers } in split(rectangle, pieces, layers, spare) {
            self.solve(rectangle, &pieces, layers, sink);
            self.spare.push(pieces);
        }
    }
}

/// Whether there are more layers at the upper left corner than the pieces can take away (see
/// `Columns`). The other corners find little more, and cost more than that.
#[inline(always)]
fn is_covered(pieces: &[Piece], layers: i32) -> bool {
    let taken = |p: &Piece| if p.flags & LEFT_0 != 0 { p.step.max(0) } else { (-p.step).max(0) };
    i64::from(layers) > pieces.iter().map(|p| i64::from(taken(p))).sum()
}

impl Plain {
    /// Slab by slab.
    #[inline(never)]
    fn solve(&mut self, rectangle: Rectangle, pieces: &[Piece], layers: i32, sink: &mut impl Sink) {
        self.stretches.clear();
        let area = self.cell.solve(rectangle, pieces, layers, &mut self.stretches);
        sink.area(area);
        for s in &self.stretches {
            let height = if s.ahead { s.to - s.from } else { s.from - s.to };
            sink.edge(s.edge, height, 0.5 * (s.from + s.to));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pieces_may_take_away_more_layers_than_fit_in_32_bits() {
        let piece = Piece { step: -(1 << 30), ..Piece::default() };
        assert!(!is_covered(&[piece; 4], 5));
        assert!(is_covered(&[piece], 5 + (1 << 30)));
    }
}
