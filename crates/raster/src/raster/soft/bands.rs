//! An image as bands of rows of tiles, which are worked on side by side where it is large.
//!
//! Bands depend on the image alone, and their gradients are added in order: the same bits for any
//! number of threads.

use std::cell::RefCell;

use rayon::prelude::*;

use super::faces::Source;
use super::kaolin::{self, Boxes};
use super::real::{LANES, Lanes, Real};
use super::tiles::{Rectangle, Run, SIDE, Tiles, Units};
use super::visits::{self, Bounds, Visit, Visits};
use super::{Profile, kernel};
use crate::raster::outline::Faces;
use crate::raster::{Background, KaolinCutoff, Model, Pixel, Screen, Size, add_in_order, hard};

/// A rectangle of more tiles than this is shared out.
const LARGE: usize = (1 << 16) / LANES;

/// The product of more tiles than this is not kept for the gradient.
const MOST_KEPT: usize = (1 << 22) / LANES;

/// Rows of tiles in a band.
const BAND: usize = 64 / SIDE;

/// Buffers of one thread, for one of the floats.
#[derive(Debug)]
pub(super) struct Scratch<R> {
    tiles: Tiles<R>,
    visits: Visits,
}

impl<R: Real> Default for Scratch<R> {
    fn default() -> Self {
        Self { tiles: Tiles::default(), visits: Visits::default() }
    }
}

thread_local! {
    static RUNS: RefCell<Vec<Run>> = const { RefCell::new(Vec::new()) };
    static BOUNDS: RefCell<Vec<Bounds>> = const { RefCell::new(Vec::new()) };
}

/// The values of all tiles, for the gradient.
pub(super) type Product<R> = Vec<Lanes<R>>;

/// What the bands of an image have in common.
struct Image<'a> {
    profile: Profile,
    screen: &'a Screen,
    faces: &'a [[u32; 3]],
    size: Size,
    units: Units,
    whole: Rectangle,
    /// Rows of tiles in a band.
    rows: usize,
    /// What is covered: nothing of a sigmoid.
    runs: &'a [Run],
    /// What each image point reaches.
    bounds: &'a [Bounds],
}

/// The loops over visits.
enum Kernel<'a> {
    Dibr,
    Sigmoid,
    /// Faces reach as far as their boxes.
    Boxes(Boxes<'a>),
    /// A pixel may meet too many of these.
    Counted(Boxes<'a>),
}

/// Draw the mask; every pixel of `out` is written. With `traced`, its product, unless it is large.
pub(super) fn draw<R: Real, T: Pixel>(
    profile: Profile,
    (model, screen): (&Model, &Screen),
    size: Size,
    (out, background): (&mut [T], Background),
    traced: bool,
) -> Option<Product<R>> {
    Image::with::<R, _>(profile, (model, screen), size, None, |image| {
        let kept = traced && image.is_none_or(|image| image.whole.tiles() <= MOST_KEPT);
        let mut product = kept.then(|| R::spare().take());
        if let Some(product) = &mut product {
            product.clear();
        }
        let Some(image) = image else {
            background.fill_together(out, T::default());
            return product;
        };
        let one = |k: usize, out: &mut [T], top: usize, kept: Option<&mut [Lanes<R>]>| {
            image.band(k, |source, Scratch { tiles, visits }: &mut Scratch<R>| {
                image.multiply(source, tiles, visits);
                tiles.compose(size, (out, top), background);
                if let Some(kept) = kept {
                    kept.copy_from_slice(&tiles.values);
                }
            });
        };
        if let Some(product) = &mut product {
            product.resize(image.whole.tiles(), Lanes::ZERO);
        }
        let [_, rows] = image.whole.pixels(size);
        let (head, rest) = out.split_at_mut(rows.start * size.width);
        let (out, tail) = rest.split_at_mut(rows.len() * size.width);
        background.fill_together(head, T::default());
        background.fill_together(tail, T::default());
        if image.bands() == 1 {
            one(0, out, rows.start, product.as_deref_mut());
            return product;
        }
        let step = SIDE * image.rows;
        let parts = out.par_chunks_mut(step * size.width).enumerate();
        match &mut product {
            Some(product) => parts
                .zip(product.par_chunks_mut(image.rows * image.whole.count[0]))
                .for_each(|((k, out), kept)| one(k, out, rows.start + k * step, Some(kept))),
            None => parts.for_each(|(k, out)| one(k, out, rows.start + k * step, None)),
        }
        product
    })
}

/// Add the gradient of `sum(upstream * mask)` for image points (pixels) to `du` and `dv`, with the
/// product of the mask or without.
pub(super) fn back<R: Real, T: Pixel>(
    profile: Profile,
    product: Option<&[Lanes<R>]>,
    (model, screen): (&Model, &Screen),
    size: Size,
    upstream: &[T],
    [du, dv]: [&mut [f64]; 2],
) {
    let kept = product.map(<[_]>::len);
    Image::with::<R, _>(profile, (model, screen), size, kept, |image| {
        let Some(image) = image else { return };
        let product = product.filter(|product| product.len() == image.whole.tiles());
        let scale = image.largest(upstream);
        if scale == 0.0 {
            return;
        }
        let one = |k: usize, du: &mut [f64], dv: &mut [f64]| {
            image.band(k, |source, Scratch { tiles, visits }: &mut Scratch<R>| {
                if let Some(product) = product {
                    let first = k * image.rows * image.whole.count[0];
                    tiles.values.clear();
                    let values = &product[first..first + tiles.rectangle.tiles()];
                    tiles.values.extend_from_slice(values);
                } else {
                    image.multiply(source, tiles, visits);
                }
                tiles.weigh(size, upstream, scale);
                image.visit(tiles, visits, |tiles, visits| {
                    let out = [&mut *du, &mut *dv];
                    match image.kernel() {
                        Kernel::Dibr => kernel::back::<R, false>(source, tiles, visits, scale, out),
                        Kernel::Sigmoid => {
                            kernel::back::<R, true>(source, tiles, visits, scale, out);
                        }
                        Kernel::Boxes(boxes) => {
                            kaolin::back::<R, false>(source, boxes, tiles, visits, scale, out);
                        }
                        Kernel::Counted(boxes) => {
                            kaolin::back::<R, true>(source, boxes, tiles, visits, scale, out);
                        }
                    }
                });
            });
        };
        if image.bands() == 1 {
            one(0, du, dv);
            return;
        }
        add_in_order(image.bands(), [du, dv], one);
    });
}

impl Image<'_> {
    /// Work on an image, or on `None` where no face reaches it; a product with so many tiles is
    /// known.
    fn with<R: Real, O>(
        profile: Profile,
        (model, screen): (&Model, &Screen),
        size: Size,
        kept: Option<usize>,
        work: impl FnOnce(Option<&Image<'_>>) -> O,
    ) -> O {
        let faces = screen.faces(model);
        let Some((low, high)) = super::bounds(model, screen) else { return work(None) };
        let sides = [high[0] - low[0], high[1] - low[1]];
        let reach = profile.reach::<R>(size, faces.len(), sides);
        let units = Units::new(size, profile.scale(size), reach);
        let widest = Units::new(size, profile.scale(size), profile.widest(reach));
        let Some(whole) = Rectangle::around(size, &widest, low, high) else { return work(None) };
        // Taken out meanwhile: a thread that waits for bands may be given another image.
        let (mut runs, mut bounds) = (RUNS.take(), BOUNDS.take());
        runs.clear();
        match profile {
            Profile::Kaolin(_, cutoff) => kaolin::grown(screen, size, cutoff.boxlen, &mut bounds),
            _ => visits::reach(screen, size, &units, &mut bounds),
        }
        if kept != Some(whole.tiles()) {
            match profile {
                Profile::Dibr(_) => {
                    let cover = |row, columns| runs.push(Run::new(row, columns));
                    hard::runs(model, screen, Faces::All, size, cover);
                }
                Profile::Kaolin(..) => {
                    kaolin::cover(model, screen, size, &mut runs);
                }
                Profile::Sigmoid(_) => {}
            }
        }
        let rows = if whole.tiles() > LARGE { BAND } else { whole.count[1] };
        let image = Image {
            profile,
            screen,
            faces,
            size,
            units,
            whole,
            rows,
            runs: &runs,
            bounds: &bounds,
        };
        let out = work(Some(&image));
        RUNS.set(runs);
        BOUNDS.set(bounds);
        out
    }

    fn bands(&self) -> usize {
        self.whole.count[1].div_ceil(self.rows)
    }

    /// Work on the tiles of a band.
    fn band<R: Real>(&self, k: usize, work: impl FnOnce(&Source<'_>, &mut Scratch<R>)) {
        R::with_scratch(|scratch| {
            let rectangle = self.whole.band(self.rows, k);
            let (u, v) = (&self.screen.u[..], &self.screen.v[..]);
            scratch.tiles.rectangle = rectangle;
            work(&Source { faces: self.faces, u, v, units: self.units, rectangle }, scratch);
        });
    }

    /// Leave `prod_f (1 - p_f)` in the tiles.
    fn multiply<R: Real>(&self, source: &Source<'_>, tiles: &mut Tiles<R>, visits: &mut Visits) {
        tiles.fill(self.size, R::ONE);
        tiles.cover(self.runs, self.size);
        self.visit(tiles, visits, |tiles, visits| match self.kernel() {
            Kernel::Dibr => kernel::draw::<R, false>(source, tiles, visits),
            Kernel::Sigmoid => kernel::draw::<R, true>(source, tiles, visits),
            Kernel::Boxes(boxes) => kaolin::draw::<R, false>(source, boxes, tiles, visits),
            Kernel::Counted(boxes) => kaolin::draw::<R, true>(source, boxes, tiles, visits),
        });
    }

    /// Which loops to use.
    fn kernel(&self) -> Kernel<'_> {
        match self.profile {
            Profile::Dibr(_) => Kernel::Dibr,
            Profile::Sigmoid(_) => Kernel::Sigmoid,
            Profile::Kaolin(_, KaolinCutoff { knum, .. }) => {
                let boxes = Boxes { bounds: self.bounds, knum };
                if knum < self.faces.len() { Kernel::Counted(boxes) } else { Kernel::Boxes(boxes) }
            }
        }
    }

    /// Call `work` with the visits of the faces to the tiles that are not 0, some at a time.
    fn visit<R: Real>(
        &self,
        tiles: &mut Tiles<R>,
        visits: &mut Visits,
        work: impl FnMut(&mut Tiles<R>, &[Visit]),
    ) {
        tiles.mark();
        if let Kernel::Counted(_) = self.kernel() {
            tiles.meet_nobody();
        }
        visits.each(tiles, self.faces, self.bounds, work);
    }

    /// The largest size of a number of the tiles' part of an image.
    fn largest<T: Pixel>(&self, image: &[T]) -> f64 {
        let [columns, rows] = self.whole.pixels(self.size);
        let mut largest = 0.0_f64;
        for row in rows {
            let line = &image[row * self.size.width..(row + 1) * self.size.width];
            for pixel in &line[columns.clone()] {
                let value = pixel.to_f64().abs();
                largest = if value > largest { value } else { largest };
            }
        }
        largest
    }
}
