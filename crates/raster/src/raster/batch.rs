//! Many images at once, in parallel, and the reduction of their gradients in a fixed order.

use std::cell::RefCell;

use rayon::prelude::*;

use super::trace::Trace;
use super::{Background, DEFAULT_NEAR, Mode, Model, Pixel, Screen, Size, View, ViewGradient};
use crate::error::{Error, Result};
use crate::threads::{self, SMALL_IMAGE};

/// What to draw: poses of one model, or one pose for each of as many models.
#[derive(Debug, Clone, Copy)]
pub struct Batch<'a> {
    /// One model, or one for each view.
    pub models: &'a [&'a Model],
    /// Pose and camera of each image.
    pub views: &'a [View],
    /// Rows and columns.
    pub size: Size,
    /// What kind of mask.
    pub mode: Mode,
    /// Distance to the near plane in metres; `None` is [`DEFAULT_NEAR`].
    pub near: Option<f64>,
}

/// Which gradients are asked for.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Wanted {
    /// For the vertices too, not only for the views.
    pub vertices: bool,
}

/// Gradients of a batch.
#[derive(Debug, Clone, Default)]
pub struct Gradients {
    /// For each view.
    pub views: Vec<ViewGradient>,
    /// `(V, 3)` for each model, if asked for; for one model, the sum over the views.
    pub vertices: Vec<Vec<f64>>,
}

/// What the masks of a batch leave behind for its gradients. Some 40 kB an image of 320 x 240 in mode
/// coverage (the outline), up to 4 bytes a pixel in the exact soft modes (8 in double precision).
#[derive(Debug, Clone, Default)]
pub struct Traces(Vec<Option<Trace>>);

impl Traces {
    /// Memory in bytes.
    #[must_use]
    pub fn bytes(&self) -> usize {
        self.0.iter().flatten().map(Trace::bytes).sum()
    }
}

/// Views whose vertex gradients are added up one after another, before the groups are: a number
/// that no thread count changes.
const GROUPS: usize = 8;

/// Buffers of one thread.
#[derive(Debug, Default)]
struct Scratch {
    screen: Screen,
    du: Vec<f64>,
    dv: Vec<f64>,
}

thread_local! {
    static SCRATCH: RefCell<Scratch> = RefCell::default();
    /// Vertex gradients of the groups.
    static PARTS: RefCell<Vec<f64>> = const { RefCell::new(Vec::new()) };
}

/// Lend this thread's buffers. They are taken out meanwhile: a thread that waits for a part of one
/// image may be given another.
fn lend<O>(work: impl FnOnce(&mut Scratch) -> O) -> O {
    let mut scratch = SCRATCH.take();
    let out = work(&mut scratch);
    SCRATCH.set(scratch);
    out
}

/// Soft masks and blurs share out what is above 65,536 pixels of an image, which one of so many hardly
/// has.
const SMALL_SOFT: usize = 80_000;

impl Batch<'_> {
    /// On how many threads to draw where nobody asked for a number (0): on one, that of the caller, if
    /// it is a single small image. Results do not depend on it.
    #[must_use]
    pub fn threads(&self, asked: usize) -> usize {
        let small = match self.mode {
            Mode::Hard | Mode::Coverage { sigma: 0.0 } => SMALL_IMAGE,
            _ => SMALL_SOFT,
        };
        let is_small = self.views.len() == 1 && self.size.pixels() <= small;
        threads::or_one(asked, is_small)
    }

    /// Refuses what cannot be drawn, by name.
    ///
    /// # Errors
    /// [`Error::Argument`]: an image without pixels or beyond 65,535 a side, a number of models
    /// other than one or that of the views, a near plane at or behind the camera, a parameter of
    /// the mode out of range; and as [`View::check`].
    pub fn check(&self) -> Result<()> {
        for (name, value) in [("height", self.size.height), ("width", self.size.width)] {
            if !(1..=65_535).contains(&value) {
                return Err(Error::argument(name, format!("{value}; expected 1 to 65535 pixels")));
            }
        }
        if self.models.len() != 1 && self.models.len() != self.views.len() {
            let message = format!(
                "{} for {} views; expected one, or one each",
                self.models.len(),
                self.views.len()
            );
            return Err(Error::argument("meshes", message));
        }
        if let Some(near) = self.near
            && !(1e-9..=1e9).contains(&near)
        {
            return Err(Error::argument("near", format!("{near} m; expected 1e-9 to 1e9 m")));
        }
        self.mode.check()?;
        self.views.iter().enumerate().try_for_each(|(row, view)| view.check(row))
    }

    fn model(&self, image: usize) -> &Model {
        self.models[if self.models.len() == 1 { 0 } else { image }]
    }

    /// Draw all masks into `out`, `(B, H, W)`, on rayon's current pool.
    ///
    /// # Errors
    /// As [`Batch::check`], and a point further than 1e12 m away.
    ///
    /// # Panics
    /// If `out` has another length.
    pub fn draw<T: Pixel>(&self, out: &mut [T]) -> Result<()> {
        self.check_masks(out)?;
        self.images(out).try_for_each(|(image, out)| self.image(image, out, false).map(|_| ()))
    }

    /// As [`draw`](Self::draw), keeping what [`gradients_of`](Self::gradients_of) would have to find
    /// again.
    ///
    /// # Errors
    /// As [`Batch::draw`].
    ///
    /// # Panics
    /// As [`Batch::draw`].
    pub fn draw_traced<T: Pixel>(&self, out: &mut [T]) -> Result<Traces> {
        self.check_masks(out)?;
        let mut traces = vec![None; self.views.len()];
        self.images(out).zip(&mut traces).try_for_each(|((image, out), trace)| {
            self.image(image, out, true).map(|found| *trace = found)
        })?;
        Ok(Traces(traces))
    }

    /// The images of a batch. Some cost many times as much as others: each is a task of its own.
    fn images<'a, T: Pixel>(
        &self,
        out: &'a mut [T],
    ) -> impl IndexedParallelIterator<Item = (usize, &'a mut [T])> + use<'a, T> {
        out.par_chunks_exact_mut(self.size.pixels()).enumerate().with_max_len(1)
    }

    fn check_masks<T>(&self, masks: &[T]) -> Result<()> {
        self.check()?;
        assert_eq!(masks.len(), self.views.len() * self.size.pixels(), "expected (B, H, W)");
        Ok(())
    }

    fn image<T: Pixel>(&self, image: usize, out: &mut [T], traced: bool) -> Result<Option<Trace>> {
        lend(|scratch| {
            let (model, near) = (self.model(image), self.near.unwrap_or(DEFAULT_NEAR));
            scratch.screen.project(model, &self.views[image], near)?;
            let bytes = self.views.len() * size_of_val(out);
            let out = (out, Background::of(bytes));
            Ok(self.mode.draw(model, &scratch.screen, self.size, out, traced))
        })
    }

    /// Gradients of `sum(upstream * masks)`; the masks are drawn again rather than kept.
    ///
    /// # Errors
    /// As [`Batch::draw`].
    ///
    /// # Panics
    /// If `upstream` is not `(B, H, W)`.
    pub fn gradients<T: Pixel>(&self, upstream: &[T], wanted: Wanted) -> Result<Gradients> {
        self.gradients_of(&Traces::default(), upstream, wanted)
    }

    /// As [`gradients`](Self::gradients), to the same bits, for masks whose traces were kept by
    /// [`draw_traced`](Self::draw_traced) of the same batch.
    ///
    /// # Errors
    /// As [`Batch::draw`]; and [`Error::Argument`] if the traces are of another batch, as far as
    /// their number and that of the vertices tell.
    ///
    /// # Panics
    /// If `upstream` is not `(B, H, W)`.
    pub fn gradients_of<T: Pixel>(
        &self,
        Traces(traces): &Traces,
        upstream: &[T],
        wanted: Wanted,
    ) -> Result<Gradients> {
        self.check_masks(upstream)?;
        let fits = |(image, trace): (usize, &Option<Trace>)| {
            trace.as_ref().is_none_or(|t| t.is_of(self.model(image), self.size, self.mode))
        };
        if !traces.is_empty()
            && (traces.len() != self.views.len() || !traces.iter().enumerate().all(fits))
        {
            return Err(Error::argument("traces", "these are of other masks"));
        }
        let near = self.near.unwrap_or(DEFAULT_NEAR);
        let one = |image: usize, vertices: Option<&mut [f64]>| -> Result<ViewGradient> {
            lend(|scratch| {
                let (model, view) = (self.model(image), &self.views[image]);
                let Scratch { screen, du, dv } = scratch;
                screen.project(model, view, near)?;
                for d in [&mut *du, &mut *dv] {
                    d.clear();
                    d.resize(screen.points(), 0.0);
                }
                let pixels = self.size.pixels();
                let upstream = &upstream[image * pixels..(image + 1) * pixels];
                let trace = traces.get(image).and_then(Option::as_ref);
                self.mode.back(model, screen, self.size, upstream, trace, [du, dv]);
                let mut gradient = ViewGradient::default();
                screen.pull_back(model, view, du, dv, &mut gradient, vertices);
                Ok(gradient)
            })
        };
        let count = self.views.len();
        let mut views = vec![ViewGradient::default(); count];
        if !wanted.vertices {
            (views.par_iter_mut().enumerate().with_max_len(1))
                .try_for_each(|(k, view)| one(k, None).map(|found| *view = found))?;
            return Ok(Gradients { views, vertices: Vec::new() });
        }
        let length = |image: usize| 3 * self.model(image).vertex_count();
        if self.models.len() != 1 {
            let mut vertices: Vec<_> = (0..count).map(|k| vec![0.0; length(k)]).collect();
            (views.par_iter_mut().zip(&mut vertices).enumerate().with_max_len(1)).try_for_each(
                |(k, (view, vertices))| one(k, Some(vertices)).map(|found| *view = found),
            )?;
            return Ok(Gradients { views, vertices });
        }
        let size = count.div_ceil(GROUPS).max(1);
        let mut parts = PARTS.take();
        parts.clear();
        parts.resize(count.div_ceil(size) * length(0), 0.0);
        let groups = views.par_chunks_mut(size).zip(parts.par_chunks_mut(length(0).max(1)));
        groups.enumerate().with_max_len(1).try_for_each(
            |(group, (views, vertices))| -> Result<()> {
                for (k, view) in views.iter_mut().enumerate() {
                    *view = one(group * size + k, Some(&mut *vertices))?;
                }
                Ok(())
            },
        )?;
        let mut vertices = vec![0.0; length(0)];
        for part in parts.chunks(length(0).max(1)) {
            for (sum, part) in vertices.iter_mut().zip(part) {
                *sum += part;
            }
        }
        PARTS.set(parts);
        Ok(Gradients { views, vertices: vec![vertices] })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::Intrinsics;

    #[test]
    fn one_small_image_is_for_the_caller() {
        let view = View {
            rotation: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
            translation: [0.0, 0.0, 1.0],
            camera: Intrinsics::new(1.0, 1.0, 0.0, 0.0).expect("a camera"),
        };
        let threads = |images: usize, [height, width]: [usize; 2], mode, asked| {
            let views = vec![view; images];
            let size = Size { height, width };
            Batch { models: &[], views: &views, size, mode, near: None }.threads(asked)
        };
        let coverage = |sigma| Mode::Coverage { sigma };
        let dibr = Mode::Dibr { delta: 7000.0, cutoff: None };
        for mode in [Mode::Hard, coverage(0.0), coverage(1.0), dibr] {
            assert_eq!(threads(1, [240, 320], mode, 0), 1);
            assert_eq!(threads(1, [240, 320], mode, 2), 2);
            assert_eq!(threads(2, [240, 320], mode, 0), 0);
            assert_eq!(threads(1, [720, 1280], mode, 0), 0);
        }
        assert_eq!(threads(1, [480, 500], coverage(0.0), 0), 1);
        assert_eq!(threads(1, [480, 500], coverage(1.0), 0), 0);
        assert_eq!(threads(1, [480, 500], dibr, 0), 0);
    }
}
