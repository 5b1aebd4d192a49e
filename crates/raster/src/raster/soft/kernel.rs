//! The loops over faces and tiles: lanes are the pixels of a tile.

use multiversion::multiversion;

use super::faces::{Block, Source};
use super::items::Items;
use super::real::{LANES, Lanes, Real};
use super::sums::{EdgeSums, Sums};
use super::tiles::{Places, Tiles};
use super::visits::Visit;

/// Multiply the values of the tiles in use by what each face leaves uncovered: `1 - p`.
#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx512bw+avx2+fma", "x86_64+avx2+fma"))]
pub(super) fn draw<R: Real, const SIGMOID: bool>(
    source: &Source<'_>,
    tiles: &mut Tiles<R>,
    visits: &[Visit],
) {
    multiversion::target::match_target! {
        "x86_64+avx2+fma" => draw_all::<R, true, SIGMOID>(source, tiles, visits),
        _ => draw_all::<R, { crate::FUSED }, SIGMOID>(source, tiles, visits),
    }
}

/// Add to `du` and `dv` the gradient of `sum(upstream * mask)` times `factor`, where the values of
/// the tiles are `upstream` times the product that [`draw`] left.
#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx512bw+avx2+fma", "x86_64+avx2+fma"))]
pub(super) fn back<R: Real, const SIGMOID: bool>(
    source: &Source<'_>,
    tiles: &Tiles<R>,
    visits: &[Visit],
    factor: f64,
    out: [&mut [f64]; 2],
) {
    multiversion::target::match_target! {
        "x86_64+avx2+fma" => back_all::<R, true, SIGMOID>(source, tiles, visits, factor, out),
        _ => back_all::<R, { crate::FUSED }, SIGMOID>(source, tiles, visits, factor, out),
    }
}

/// The pixels of a tile that a face counts for.
pub(super) trait Pixels {
    /// The number if the pixel in a lane is one, else 0; asked once for each lane.
    fn keep<R: Real>(&mut self, lane: usize, number: R) -> R;
}

/// All of them.
pub(super) struct All;

impl Pixels for All {
    #[inline(always)]
    fn keep<R: Real>(&mut self, _: usize, number: R) -> R {
        number
    }
}

/// These, a bit each.
pub(super) struct Held(pub(super) u32);

impl Pixels for Held {
    #[inline(always)]
    fn keep<R: Real>(&mut self, lane: usize, number: R) -> R {
        number.where_bit((self.0 >> lane) & 1)
    }
}

/// What the pixels of a tile are from an edge.
pub(super) struct Measured<R> {
    /// Squared distance.
    squared: Lanes<R>,
    /// How far inside its line.
    across: Lanes<R>,
    /// How far beyond its ends.
    beyond: Lanes<R>,
    /// How far along it, from the middle.
    along: Lanes<R>,
}

impl<R: Real> Measured<R> {
    /// From the edge with this record.
    #[inline(always)]
    pub(super) fn new<const FMA: bool>(
        block: &Block<R>,
        record: usize,
        [x, y]: [&Lanes<R>; 2],
    ) -> Self {
        let zero = Lanes::ZERO;
        let mut of = Self { squared: zero, across: zero, beyond: zero, along: zero };
        for l in 0..LANES {
            (of.squared[l], of.across[l], of.beyond[l], of.along[l]) =
                measure::<R, FMA>(block, record, x[l], y[l]);
        }
        of
    }
}

#[inline(always)]
fn draw_all<R: Real, const FMA: bool, const SIGMOID: bool>(
    source: &Source<'_>,
    tiles: &mut Tiles<R>,
    visits: &[Visit],
) {
    let (mut block, mut items) = (Block::new(), Items::new(tiles.rectangle.count[0]));
    let places = Places::new(&source.units);
    for visits in visits.chunks(LANES) {
        block.load_near(source, visits, SIGMOID);
        items.find(visits, &block, |lane| {
            if SIGMOID && block.flat[lane] { 0 } else { block.near.all[lane] }
        });
        let mut list = items.one.iter();
        if let Some((record, tile)) = list.next() {
            let mut at = items.place(record, tile);
            let mut from = Measured::new::<FMA>(&block, record, places.of(tile));
            // The next is measured while this one waits for its exponential.
            for (record, tile) in list {
                let next = Measured::new::<FMA>(&block, record, places.of(tile));
                draw_one::<R, FMA, SIGMOID>(&from.squared, &mut tiles.values[at], All);
                (from, at) = (next, items.place(record, tile));
            }
            draw_one::<R, FMA, SIGMOID>(&from.squared, &mut tiles.values[at], All);
        }
        for (lane, tile) in items.all.iter() {
            let values = &mut tiles.values[items.place(lane, tile)];
            draw_tile::<R, FMA, SIGMOID>(&block, lane, places.of(tile), values);
        }
    }
}

/// Squared distance to an edge, how far the pixel is inside its line, how far beyond its ends, and
/// where along it from the middle.
#[inline(always)]
fn measure<R: Real, const FMA: bool>(block: &Block<R>, record: usize, x: R, y: R) -> (R, R, R, R) {
    let edges = &block.edges;
    let of = |field: &[[R; LANES]; 4]| field.as_flattened()[record % (4 * LANES)];
    let (ex, ey) = (of(&edges.x), of(&edges.y));
    let along = ex.fused::<FMA>(x, ey.fused::<FMA>(y, of(&edges.along)));
    let across = ex.fused::<FMA>(y, (-ey).fused::<FMA>(x, of(&edges.across)));
    let beyond = (along.abs() - of(&edges.half)).most(R::ZERO);
    (across.fused::<FMA>(across, beyond * beyond), across, beyond, along)
}

/// Squared distance of the pixels of a tile to the nearest edge of a face.
#[inline(always)]
pub(super) fn nearest<R: Real, const FMA: bool>(
    block: &Block<R>,
    lane: usize,
    [x, y]: [&Lanes<R>; 2],
) -> Lanes<R> {
    let (lane, mut nearest) = (lane % LANES, Lanes::ZERO);
    for l in 0..LANES {
        let (d0, _, _, _) = measure::<R, FMA>(block, lane, x[l], y[l]);
        let (d1, _, _, _) = measure::<R, FMA>(block, LANES + lane, x[l], y[l]);
        let (d2, _, _, _) = measure::<R, FMA>(block, 2 * LANES + lane, x[l], y[l]);
        nearest[l] = d0.least(d1).least(d2);
    }
    nearest
}

#[inline(always)]
fn draw_tile<R: Real, const FMA: bool, const SIGMOID: bool>(
    block: &Block<R>,
    lane: usize,
    [x, y]: [&Lanes<R>; 2],
    values: &mut Lanes<R>,
) {
    let lane = lane % LANES;
    for l in 0..LANES {
        let (d0, s0, _, _) = measure::<R, FMA>(block, lane, x[l], y[l]);
        let (d1, s1, _, _) = measure::<R, FMA>(block, LANES + lane, x[l], y[l]);
        let (d2, s2, _, _) = measure::<R, FMA>(block, 2 * LANES + lane, x[l], y[l]);
        let e = d0.least(d1).least(d2).exp2_negative::<FMA>();
        let left = if SIGMOID {
            let inside = s0.least(s1).least(s2) >= R::ZERO;
            values[l] * (if inside { e } else { R::ONE }) / (R::ONE + e)
        } else {
            (-e).fused::<FMA>(values[l], values[l])
        };
        values[l] = left.most(R::LEAST_PRODUCT);
    }
}

/// As [`draw_tile`] for a tile outside of the face, from the squared distance.
#[inline(always)]
pub(super) fn draw_one<R: Real, const FMA: bool, const SIGMOID: bool>(
    squared: &Lanes<R>,
    values: &mut Lanes<R>,
    mut pixels: impl Pixels,
) {
    for l in 0..LANES {
        // Rather than of the product: numbers stored in part would not be there for the next face.
        let e = pixels.keep(l, squared[l].exp2_negative::<FMA>());
        let left = if SIGMOID {
            values[l] / (R::ONE + e)
        } else {
            (-e).fused::<FMA>(values[l], values[l])
        };
        values[l] = left.most(R::LEAST_PRODUCT);
    }
}

#[inline(always)]
fn back_all<R: Real, const FMA: bool, const SIGMOID: bool>(
    source: &Source<'_>,
    tiles: &Tiles<R>,
    visits: &[Visit],
    factor: f64,
    out: [&mut [f64]; 2],
) {
    let [du, dv] = out;
    let (mut block, mut items) = (Block::new(), Items::new(tiles.rectangle.count[0]));
    let (places, mut sums) = (Places::new(&source.units), Sums::new());
    for visits in visits.chunks(LANES) {
        block.load_near(source, visits, SIGMOID);
        items.find(visits, &block, |lane| {
            if SIGMOID && block.flat[lane] { 0 } else { block.near.all[lane] }
        });
        sums.clear();
        let mut list = items.one.iter();
        if let Some((mut last, tile)) = list.next() {
            let mut at = items.place(last, tile);
            let mut from = Measured::new::<FMA>(&block, last, places.of(tile));
            for (record, tile) in list {
                let next = Measured::new::<FMA>(&block, record, places.of(tile));
                back_one::<R, FMA, SIGMOID>(&from, &tiles.values[at], sums.of(last), All);
                (from, last, at) = (next, record, items.place(record, tile));
            }
            back_one::<R, FMA, SIGMOID>(&from, &tiles.values[at], sums.of(last), All);
        }
        for (lane, tile) in items.all.iter() {
            let values = &tiles.values[items.place(lane, tile)];
            back_tile::<R, FMA, SIGMOID>(&block, lane, places.of(tile), values, &mut sums, All);
        }
        sums.scatter(source, &block, visits, factor, du, dv);
    }
}

#[inline(always)]
pub(super) fn back_tile<R: Real, const FMA: bool, const SIGMOID: bool>(
    block: &Block<R>,
    lane: usize,
    [x, y]: [&Lanes<R>; 2],
    values: &Lanes<R>,
    sums: &mut Sums<R>,
    mut pixels: impl Pixels,
) {
    let (lane, edges) = (lane % LANES, &mut sums.edges);
    // Lists whose address nobody takes stay in registers.
    let mut sums = [[Lanes::<R>::ZERO; 4]; 3];
    for l in 0..LANES {
        let (d0, s0, b0, a0) = measure::<R, FMA>(block, lane, x[l], y[l]);
        let (d1, s1, b1, a1) = measure::<R, FMA>(block, LANES + lane, x[l], y[l]);
        let (d2, s2, b2, a2) = measure::<R, FMA>(block, 2 * LANES + lane, x[l], y[l]);
        let nearest = d0.least(d1).least(d2);
        let e = nearest.exp2_negative::<FMA>();
        // The derivative of the mask for the squared distance.
        let weight = if SIGMOID {
            let inside = s0.least(s1).least(s2) >= R::ZERO;
            values[l] * (if inside { R::ONE } else { -e }) / (R::ONE + e)
        } else {
            -values[l] * e / (R::ONE - e).most(R::LEAST_FACTOR)
        };
        let weight = pixels.keep(l, weight);
        let first = d0 <= nearest;
        let second = d1 <= nearest;
        let w0 = if first { weight } else { R::ZERO };
        let w1 = if !first && second { weight } else { R::ZERO };
        let w2 = if first || second { R::ZERO } else { weight };
        // One edge after another: a loop over them would not become lanes.
        let g0 = if a0 < R::ZERO { -b0 } else { b0 };
        sums[0][0][l] = w0.fused::<FMA>(s0, edges[lane][0][l]);
        sums[0][1][l] = (w0 * s0).fused::<FMA>(a0 - g0, edges[lane][1][l]);
        sums[0][2][l] = w0.fused::<FMA>(g0, edges[lane][2][l]);
        sums[0][3][l] = w0.fused::<FMA>(b0, edges[lane][3][l]);
        let g1 = if a1 < R::ZERO { -b1 } else { b1 };
        sums[1][0][l] = w1.fused::<FMA>(s1, edges[LANES + lane][0][l]);
        sums[1][1][l] = (w1 * s1).fused::<FMA>(a1 - g1, edges[LANES + lane][1][l]);
        sums[1][2][l] = w1.fused::<FMA>(g1, edges[LANES + lane][2][l]);
        sums[1][3][l] = w1.fused::<FMA>(b1, edges[LANES + lane][3][l]);
        let g2 = if a2 < R::ZERO { -b2 } else { b2 };
        sums[2][0][l] = w2.fused::<FMA>(s2, edges[2 * LANES + lane][0][l]);
        sums[2][1][l] = (w2 * s2).fused::<FMA>(a2 - g2, edges[2 * LANES + lane][1][l]);
        sums[2][2][l] = w2.fused::<FMA>(g2, edges[2 * LANES + lane][2][l]);
        sums[2][3][l] = w2.fused::<FMA>(b2, edges[2 * LANES + lane][3][l]);
    }
    for (k, sums) in sums.iter().enumerate() {
        for (to, sum) in edges[k * LANES + lane].iter_mut().zip(sums) {
            *to = *sum;
        }
    }
}

/// As [`back_tile`] for a tile outside of the face to which the measured edge is the nearest.
#[inline(always)]
pub(super) fn back_one<R: Real, const FMA: bool, const SIGMOID: bool>(
    from: &Measured<R>,
    values: &Lanes<R>,
    sums: &mut EdgeSums<R>,
    mut pixels: impl Pixels,
) {
    for l in 0..LANES {
        let (s, b, a) = (from.across[l], from.beyond[l], from.along[l]);
        let e = from.squared[l].exp2_negative::<FMA>();
        let w = if SIGMOID {
            -values[l] * e / (R::ONE + e)
        } else {
            -values[l] * e / (R::ONE - e).most(R::LEAST_FACTOR)
        };
        let w = pixels.keep(l, w);
        let g = if a < R::ZERO { -b } else { b };
        sums[0][l] = w.fused::<FMA>(s, sums[0][l]);
        sums[1][l] = (w * s).fused::<FMA>(a - g, sums[1][l]);
        sums[2][l] = w.fused::<FMA>(g, sums[2][l]);
        sums[3][l] = w.fused::<FMA>(b, sums[3][l]);
    }
}
