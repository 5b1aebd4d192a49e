//! The loops over faces and tiles: lanes are the pixels of a tile.

use multiversion::multiversion;

use super::faces::{Block, Source};
use super::real::{LANES, Real};
use super::tiles::Tiles;

/// Whether every machine of the build's target multiplies and adds in one instruction; elsewhere
/// `mul_add` is a library call.
pub(super) const FUSED: bool = cfg!(any(target_arch = "aarch64", target_feature = "fma"));

/// Multiply the values of the tiles in use by what each face leaves uncovered: `1 - p`.
#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx512bw+avx2+fma", "x86_64+avx2+fma"))]
pub(super) fn draw<R: Real, const SIGMOID: bool>(source: &Source<'_>, tiles: &mut Tiles<R>) {
    multiversion::target::match_target! {
        "x86_64+avx2+fma" => draw_all::<R, true, SIGMOID>(source, tiles),
        _ => draw_all::<R, FUSED, SIGMOID>(source, tiles),
    }
}

/// Add to `du` and `dv` the gradient of `sum(upstream * mask)` times `factor`, where the values of
/// the tiles are `upstream` times the product that [`draw`] left.
#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx512bw+avx2+fma", "x86_64+avx2+fma"))]
pub(super) fn back<R: Real, const SIGMOID: bool>(
    source: &Source<'_>,
    tiles: &Tiles<R>,
    factor: f64,
    du: &mut [f64],
    dv: &mut [f64],
) {
    multiversion::target::match_target! {
        "x86_64+avx2+fma" => back_all::<R, true, SIGMOID>(source, tiles, factor, du, dv),
        _ => back_all::<R, FUSED, SIGMOID>(source, tiles, factor, du, dv),
    }
}

/// The pixels of a tile that a face counts for.
pub(super) trait Pixels {
    /// Whether the pixel in a lane is one; asked once for each.
    fn has(&mut self, lane: usize) -> bool;
}

/// All of them.
pub(super) struct All;

impl Pixels for All {
    #[inline(always)]
    fn has(&mut self, _: usize) -> bool {
        true
    }
}

#[inline(always)]
fn draw_all<R: Real, const FMA: bool, const SIGMOID: bool>(
    source: &Source<'_>,
    tiles: &mut Tiles<R>,
) {
    let mut block = Block::new();
    let mut first = 0;
    while first < source.faces.len() {
        let count = block.load(source, first, SIGMOID);
        for lane in 0..count {
            if SIGMOID && block.flat[lane] {
                continue;
            }
            let [from, to, top, bottom] = [0, 1, 2, 3].map(|k| block.tiles[k][lane] as usize);
            let mut row = top;
            while row < bottom {
                let mut column = from;
                while column < to {
                    let (Some(x), Some(y)) =
                        (tiles.x[column..].first_chunk::<8>(), tiles.y[row..].first_chunk::<8>())
                    else {
                        break;
                    };
                    let mut used = tiles.used(column, row, to - column, bottom - row);
                    used &= block.near.all[lane];
                    let one = [0, 1, 2].map(|k| block.near.one[k][lane] & used);
                    let mut left = one[0] | one[1] | one[2];
                    used ^= left;
                    while left != 0 {
                        let at = left.trailing_zeros() as usize;
                        let (c, r) = (at % 8, (at / 8) % 8);
                        let place = [&x[c], &y[r]];
                        let values =
                            &mut tiles.values[(row + r) * tiles.rectangle.count[0] + column + c];
                        let k = edge_of(one, at);
                        draw_one::<R, FMA, SIGMOID>(&block, lane, k, place, values, All);
                        left &= left - 1;
                    }
                    while used != 0 {
                        let at = used.trailing_zeros() as usize;
                        let (c, r) = (at % 8, (at / 8) % 8);
                        let place = [&x[c], &y[r]];
                        let values =
                            &mut tiles.values[(row + r) * tiles.rectangle.count[0] + column + c];
                        draw_tile::<R, FMA, SIGMOID>(&block, lane, place, values, All);
                        used &= used - 1;
                    }
                    column += 8;
                }
                row += 8;
            }
        }
        first += LANES;
    }
}

/// The edge whose tiles hold bit `at`.
#[inline(always)]
fn edge_of(one: [u64; 3], at: usize) -> usize {
    (((one[1] >> at) & 1) | (((one[2] >> at) & 1) << 1)) as usize
}

/// Squared distance to an edge, how far the pixel is inside its line, how far beyond its ends.
#[inline(always)]
fn measure<R: Real, const FMA: bool>(
    block: &Block<R>,
    lane: usize,
    k: usize,
    x: R,
    y: R,
) -> (R, R, R, R) {
    let e = &block.edges[k & 3];
    let (ex, ey) = (e.x[lane], e.y[lane]);
    let along = ex.fused::<FMA>(x, ey.fused::<FMA>(y, e.along[lane]));
    let across = ex.fused::<FMA>(y, (-ey).fused::<FMA>(x, e.across[lane]));
    let beyond = (along.abs() - e.half[lane]).most(R::ZERO);
    (across.fused::<FMA>(across, beyond * beyond), across, beyond, along)
}

#[inline(always)]
pub(super) fn draw_tile<R: Real, const FMA: bool, const SIGMOID: bool>(
    block: &Block<R>,
    lane: usize,
    [x, y]: [&[R; LANES]; 2],
    values: &mut [R; LANES],
    mut pixels: impl Pixels,
) {
    for l in 0..LANES {
        let (x, y) = (x[l] - block.x[lane], y[l] - block.y[lane]);
        let (d0, s0, _, _) = measure::<R, FMA>(block, lane, 0, x, y);
        let (d1, s1, _, _) = measure::<R, FMA>(block, lane, 1, x, y);
        let (d2, s2, _, _) = measure::<R, FMA>(block, lane, 2, x, y);
        let e = d0.least(d1).least(d2).exp2_negative::<FMA>();
        let left = if SIGMOID {
            let inside = s0.least(s1).least(s2) >= R::ZERO;
            values[l] * (if inside { e } else { R::ONE }) / (R::ONE + e)
        } else {
            (-e).fused::<FMA>(values[l], values[l])
        };
        values[l] = if pixels.has(l) { left.most(R::LEAST_PRODUCT) } else { values[l] };
    }
}

/// As [`draw_tile`] for a tile outside of the face to which edge `k` is the nearest.
#[inline(always)]
pub(super) fn draw_one<R: Real, const FMA: bool, const SIGMOID: bool>(
    block: &Block<R>,
    lane: usize,
    k: usize,
    [x, y]: [&[R; LANES]; 2],
    values: &mut [R; LANES],
    mut pixels: impl Pixels,
) {
    for l in 0..LANES {
        let (d, _, _, _) =
            measure::<R, FMA>(block, lane, k, x[l] - block.x[lane], y[l] - block.y[lane]);
        let e = d.exp2_negative::<FMA>();
        let left = if SIGMOID {
            values[l] / (R::ONE + e)
        } else {
            (-e).fused::<FMA>(values[l], values[l])
        };
        values[l] = if pixels.has(l) { left.most(R::LEAST_PRODUCT) } else { values[l] };
    }
}

/// Sums over pixels, for each edge: weight times `across`, `across * along`, `beyond` with the
/// sign of the end, `beyond`; `along` ends at the ends of the edge.
pub(super) type Sums<R> = [[[R; LANES]; 4]; 3];

#[inline(always)]
fn back_all<R: Real, const FMA: bool, const SIGMOID: bool>(
    source: &Source<'_>,
    tiles: &Tiles<R>,
    factor: f64,
    du: &mut [f64],
    dv: &mut [f64],
) {
    let mut block = Block::new();
    let mut block_sums = BlockSums::new();
    let mut first = 0;
    while first < source.faces.len() {
        let count = block.load(source, first, SIGMOID);
        for lane in 0..count {
            block_sums.any[lane] = false;
            if SIGMOID && block.flat[lane] {
                continue;
            }
            let [from, to, top, bottom] = [0, 1, 2, 3].map(|k| block.tiles[k][lane] as usize);
            let mut sums = [[[R::ZERO; LANES]; 4]; 4];
            let mut any = false;
            let mut row = top;
            while row < bottom {
                let mut column = from;
                while column < to {
                    let (Some(x), Some(y)) =
                        (tiles.x[column..].first_chunk::<8>(), tiles.y[row..].first_chunk::<8>())
                    else {
                        break;
                    };
                    let mut used = tiles.used(column, row, to - column, bottom - row);
                    used &= block.near.all[lane];
                    any |= used != 0;
                    let one = [0, 1, 2].map(|k| block.near.one[k][lane] & used);
                    let mut left = one[0] | one[1] | one[2];
                    used ^= left;
                    while left != 0 {
                        let at = left.trailing_zeros() as usize;
                        let (c, r) = (at % 8, (at / 8) % 8);
                        let place = [&x[c], &y[r]];
                        let values =
                            &tiles.values[(row + r) * tiles.rectangle.count[0] + column + c];
                        let k = edge_of(one, at);
                        back_one::<R, FMA, SIGMOID>(
                            &block,
                            lane,
                            k,
                            place,
                            values,
                            &mut sums[k & 3],
                            All,
                        );
                        left &= left - 1;
                    }
                    if used == 0 {
                        column += 8;
                        continue;
                    }
                    // A copy whose address nobody takes stays in registers.
                    let mut local = [sums[0], sums[1], sums[2]];
                    while used != 0 {
                        let at = used.trailing_zeros() as usize;
                        let (c, r) = (at % 8, (at / 8) % 8);
                        let place = [&x[c], &y[r]];
                        let values =
                            &tiles.values[(row + r) * tiles.rectangle.count[0] + column + c];
                        back_tile::<R, FMA, SIGMOID>(&block, lane, place, values, &mut local, All);
                        used &= used - 1;
                    }
                    (sums[0], sums[1], sums[2]) = (local[0], local[1], local[2]);
                    column += 8;
                }
                row += 8;
            }
            block_sums.set(lane, any, &[sums[0], sums[1], sums[2]]);
        }
        scatter(source, &block, [first, count], &block_sums, factor, du, dv);
        first += LANES;
    }
}

#[inline(always)]
pub(super) fn back_tile<R: Real, const FMA: bool, const SIGMOID: bool>(
    block: &Block<R>,
    lane: usize,
    [x, y]: [&[R; LANES]; 2],
    values: &[R; LANES],
    sums: &mut Sums<R>,
    mut pixels: impl Pixels,
) {
    for l in 0..LANES {
        let (x, y) = (x[l] - block.x[lane], y[l] - block.y[lane]);
        let (d0, s0, b0, a0) = measure::<R, FMA>(block, lane, 0, x, y);
        let (d1, s1, b1, a1) = measure::<R, FMA>(block, lane, 1, x, y);
        let (d2, s2, b2, a2) = measure::<R, FMA>(block, lane, 2, x, y);
        let nearest = d0.least(d1).least(d2);
        let e = nearest.exp2_negative::<FMA>();
        // The derivative of the mask for the squared distance.
        let weight = if SIGMOID {
            let inside = s0.least(s1).least(s2) >= R::ZERO;
            values[l] * (if inside { R::ONE } else { -e }) / (R::ONE + e)
        } else {
            -values[l] * e / (R::ONE - e).most(R::LEAST_FACTOR)
        };
        let weight = if pixels.has(l) { weight } else { R::ZERO };
        let first = d0 <= nearest;
        let second = d1 <= nearest;
        let w0 = if first { weight } else { R::ZERO };
        let w1 = if !first && second { weight } else { R::ZERO };
        let w2 = if first || second { R::ZERO } else { weight };
        // One edge after another: a loop over them would not become lanes.
        let g0 = if a0 < R::ZERO { -b0 } else { b0 };
        sums[0][0][l] = w0.fused::<FMA>(s0, sums[0][0][l]);
        sums[0][1][l] = (w0 * s0).fused::<FMA>(a0 - g0, sums[0][1][l]);
        sums[0][2][l] = w0.fused::<FMA>(g0, sums[0][2][l]);
        sums[0][3][l] = w0.fused::<FMA>(b0, sums[0][3][l]);
        let g1 = if a1 < R::ZERO { -b1 } else { b1 };
        sums[1][0][l] = w1.fused::<FMA>(s1, sums[1][0][l]);
        sums[1][1][l] = (w1 * s1).fused::<FMA>(a1 - g1, sums[1][1][l]);
        sums[1][2][l] = w1.fused::<FMA>(g1, sums[1][2][l]);
        sums[1][3][l] = w1.fused::<FMA>(b1, sums[1][3][l]);
        let g2 = if a2 < R::ZERO { -b2 } else { b2 };
        sums[2][0][l] = w2.fused::<FMA>(s2, sums[2][0][l]);
        sums[2][1][l] = (w2 * s2).fused::<FMA>(a2 - g2, sums[2][1][l]);
        sums[2][2][l] = w2.fused::<FMA>(g2, sums[2][2][l]);
        sums[2][3][l] = w2.fused::<FMA>(b2, sums[2][3][l]);
    }
}

/// As [`back_tile`] for a tile outside of the face to which edge `k` is the nearest.
#[inline(always)]
pub(super) fn back_one<R: Real, const FMA: bool, const SIGMOID: bool>(
    block: &Block<R>,
    lane: usize,
    k: usize,
    [x, y]: [&[R; LANES]; 2],
    values: &[R; LANES],
    sums: &mut [[R; LANES]; 4],
    mut pixels: impl Pixels,
) {
    for l in 0..LANES {
        let (d, s, b, a) =
            measure::<R, FMA>(block, lane, k, x[l] - block.x[lane], y[l] - block.y[lane]);
        let e = d.exp2_negative::<FMA>();
        let w = if SIGMOID {
            -values[l] * e / (R::ONE + e)
        } else {
            -values[l] * e / (R::ONE - e).most(R::LEAST_FACTOR)
        };
        let w = if pixels.has(l) { w } else { R::ZERO };
        let g = if a < R::ZERO { -b } else { b };
        sums[0][l] = w.fused::<FMA>(s, sums[0][l]);
        sums[1][l] = (w * s).fused::<FMA>(a - g, sums[1][l]);
        sums[2][l] = w.fused::<FMA>(g, sums[2][l]);
        sums[3][l] = w.fused::<FMA>(b, sums[3][l]);
    }
}

/// [`Sums`] of the faces of a block, over the pixels: the lanes are the faces.
pub(super) struct BlockSums<R> {
    sums: Sums<R>,
    any: [bool; LANES],
}

impl<R: Real> BlockSums<R> {
    pub(super) fn new() -> Self {
        Self { sums: [[[R::ZERO; LANES]; 4]; 3], any: [false; LANES] }
    }

    /// Sums over the pixels, in a fixed order.
    #[inline(always)]
    pub(super) fn set(&mut self, lane: usize, any: bool, sums: &Sums<R>) {
        self.any[lane] = any;
        if !any {
            return;
        }
        for (sum, total) in self.sums.as_flattened_mut().iter_mut().zip(R::totals(sums)) {
            sum[lane] = total;
        }
    }
}

// A build for one processor that has AVX-512 leaves out the attributes that make it safe to call.
#[cfg(all(target_arch = "x86_64", not(target_feature = "avx512f")))]
use self::avx512::totals as totals_wide;
#[cfg(all(target_arch = "x86_64", target_feature = "avx512f"))]
use totals as totals_wide;

/// Sums over the lanes. A call of its own, for an instruction set of its own.
#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx512bw+avx2+fma", "x86_64+avx2+fma"))]
pub(super) fn totals_single(sums: &Sums<f32>) -> [f32; 12] {
    multiversion::target::match_target! {
        "x86_64+avx512f" => totals_wide(sums),
        _ => totals(sums),
    }
}

/// Sums over the lanes.
pub(super) fn totals<R: Real>(sums: &Sums<R>) -> [R; 12] {
    let mut totals = [R::ZERO; 12];
    for (total, lanes) in totals.iter_mut().zip(sums.as_flattened()) {
        let mut four = [R::ZERO; 4];
        for l in 0..4 {
            four[l] = (lanes[l] + lanes[l + 8]) + (lanes[l + 4] + lanes[l + 12]);
        }
        *total = (four[0] + four[2]) + (four[1] + four[3]);
    }
    totals
}

#[cfg(all(target_arch = "x86_64", not(target_feature = "avx512f")))]
mod avx512 {
    use std::arch::x86_64::{__m512, _mm512_reduce_add_ps, _mm512_setr_ps};

    use super::{LANES, Sums};

    /// One load.
    #[inline]
    #[target_feature(enable = "avx512f")]
    fn load(l: &[f32; LANES]) -> __m512 {
        _mm512_setr_ps(
            l[0], l[1], l[2], l[3], l[4], l[5], l[6], l[7], l[8], l[9], l[10], l[11], l[12], l[13],
            l[14], l[15],
        )
    }

    #[inline]
    #[target_feature(enable = "avx512f")]
    pub(super) fn totals(sums: &Sums<f32>) -> [f32; 12] {
        let mut totals = [0.0; 12];
        for (total, lanes) in totals.iter_mut().zip(sums.as_flattened()) {
            *total = _mm512_reduce_add_ps(load(lanes));
        }
        totals
    }
}

/// Carry the sums of a block on to the corners. With `q` the nearest point of edge `a b` at `s`, the
/// derivative of the squared distance is `2 (1 - s)(q - pixel)` for `a` and `2 s (q - pixel)` for
/// `b` (envelope theorem).
#[inline(always)]
pub(super) fn scatter<R: Real>(
    source: &Source<'_>,
    block: &Block<R>,
    [first, count]: [usize; 2],
    sums: &BlockSums<R>,
    factor: f64,
    du: &mut [f64],
    dv: &mut [f64],
) {
    // The exponent is one of 2.
    let scale = source.units.scale.map(|s| 2.0 * std::f64::consts::LN_2 * factor * s);
    // For the ends of each edge, per axis.
    let mut ends = [[[0.0; LANES]; 4]; 3];
    for k in 0..3 {
        let (edges, [s0, s1, s2, s3]) = (&block.edges[k], &sums.sums[k]);
        for l in 0..LANES {
            let (x, y, half) = (edges.x[l].wide(), edges.y[l].wide(), edges.half[l].wide());
            let (across, end) = (s0[l].wide(), s2[l].wide());
            let inverse = if half > 0.0 { 1.0 / half } else { 0.0 };
            // q - pixel = -end e - across (-e_y, e_x).
            let (wx, wy) = (across * y - end * x, -across * x - end * y);
            let (across, end) = (s1[l].wide() * inverse, s3[l].wide());
            let end = if half > 0.0 { end } else { 0.0 };
            let (tx, ty) = (across * y - end * x, -across * x - end * y);
            let [from, to] = [block.kept[k][0][l], block.kept[k][1][l]];
            let (bx, by) = (0.5 * (wx + tx), 0.5 * (wy + ty));
            let (bx, by) = (from * wx + (to - from) * bx, from * wy + (to - from) * by);
            ends[k][0][l] = scale[0] * (wx - bx);
            ends[k][1][l] = scale[1] * (wy - by);
            ends[k][2][l] = scale[0] * bx;
            ends[k][3][l] = scale[1] * by;
        }
    }
    for lane in 0..count {
        if !sums.any[lane] {
            continue;
        }
        let [a, b, c] = source.faces[first + lane];
        let corners = if block.turned[lane] { [a, c, b] } else { [a, b, c] };
        for k in 0..3 {
            let (point, before) = (corners[k] as usize, (k + 2) % 3);
            du[point] += ends[k][0][lane] + ends[before][2][lane];
            dv[point] += ends[k][1][lane] + ends[before][3][lane];
        }
    }
}
