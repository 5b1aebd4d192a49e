//! The loops over faces and tiles: lanes are the pixels of a tile.

use multiversion::multiversion;

use super::faces::{Block, Face, Source};
use super::real::{LANES, Real};
use super::tiles::Tiles;

/// Whether every machine of the build's target multiplies and adds in one instruction; elsewhere
/// `mul_add` is a library call.
const FUSED: bool = cfg!(any(target_arch = "aarch64", target_feature = "fma"));

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

#[inline(always)]
fn draw_all<R: Real, const FMA: bool, const SIGMOID: bool>(
    source: &Source<'_>,
    tiles: &mut Tiles<R>,
) {
    let mut block = Block::new();
    let mut first = 0;
    while first < source.faces.len() {
        let count = block.load(source, first);
        for lane in 0..count {
            if SIGMOID && block.flat[lane] {
                continue;
            }
            let face = block.face(lane);
            let [from, to, top, bottom] = [0, 1, 2, 3].map(|k| block.tiles[k][lane] as usize);
            let mut row = top;
            while row < bottom {
                let mut column = from;
                while column < to {
                    let mut used = tiles.used(column, row, to - column, bottom - row);
                    while used != 0 {
                        let at = used.trailing_zeros() as usize;
                        let (c, r) = (column + at % 8, row + at / 8);
                        let x = tiles.x[c] - face.x;
                        let y = tiles.y[r] - face.y;
                        let values = &mut tiles.values[r * tiles.count[0] + c];
                        draw_tile::<R, FMA, SIGMOID>(&face, [x, y], &tiles.offset, values);
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

/// Squared distance to an edge, how far the pixel is inside its line, how far beyond its ends.
#[inline(always)]
fn measure<R: Real, const FMA: bool>(face: &Face<R>, k: usize, x: R, y: R) -> (R, R, R, R) {
    let e = &face.edges[k];
    let along = e.x.fused::<FMA>(x, e.y.fused::<FMA>(y, e.along));
    let across = e.x.fused::<FMA>(y, (-e.y).fused::<FMA>(x, e.across));
    let beyond = (along.abs() - e.half).most(R::ZERO);
    (across.fused::<FMA>(across, beyond * beyond), across, beyond, along)
}

#[inline(always)]
fn draw_tile<R: Real, const FMA: bool, const SIGMOID: bool>(
    face: &Face<R>,
    [x, y]: [R; 2],
    offset: &[[R; LANES]; 2],
    values: &mut [R; LANES],
) {
    for l in 0..LANES {
        let (x, y) = (x + offset[0][l], y + offset[1][l]);
        let (d0, s0, _, _) = measure::<R, FMA>(face, 0, x, y);
        let (d1, s1, _, _) = measure::<R, FMA>(face, 1, x, y);
        let (d2, s2, _, _) = measure::<R, FMA>(face, 2, x, y);
        let e = d0.least(d1).least(d2).exp_negative::<FMA>();
        let left = if SIGMOID {
            let inside = s0.least(s1).least(s2) >= R::ZERO;
            (if inside { e } else { R::ONE }) / (R::ONE + e)
        } else {
            (R::ONE - e).most(R::LEAST_FACTOR)
        };
        values[l] = (values[l] * left).most(R::LEAST_PRODUCT);
    }
}

/// Sums over pixels, for each edge: weight times `across`, `across * along`, `beyond` with the
/// sign of the end, `beyond`; `along` ends at the ends of the edge.
type Sums<R> = [[[R; LANES]; 4]; 3];

#[inline(always)]
fn back_all<R: Real, const FMA: bool, const SIGMOID: bool>(
    source: &Source<'_>,
    tiles: &Tiles<R>,
    factor: f64,
    du: &mut [f64],
    dv: &mut [f64],
) {
    let mut block = Block::new();
    let mut first = 0;
    while first < source.faces.len() {
        let count = block.load(source, first);
        for lane in 0..count {
            if SIGMOID && block.flat[lane] {
                continue;
            }
            let face = block.face(lane);
            let [from, to, top, bottom] = [0, 1, 2, 3].map(|k| block.tiles[k][lane] as usize);
            let mut sums = [[[R::ZERO; LANES]; 4]; 3];
            let mut any = false;
            let mut row = top;
            while row < bottom {
                let mut column = from;
                while column < to {
                    let mut used = tiles.used(column, row, to - column, bottom - row);
                    any |= used != 0;
                    while used != 0 {
                        let at = used.trailing_zeros() as usize;
                        let (c, r) = (column + at % 8, row + at / 8);
                        let x = tiles.x[c] - face.x;
                        let y = tiles.y[r] - face.y;
                        let values = &tiles.values[r * tiles.count[0] + c];
                        back_tile::<R, FMA, SIGMOID>(
                            &face,
                            [x, y],
                            &tiles.offset,
                            values,
                            &mut sums,
                        );
                        used &= used - 1;
                    }
                    column += 8;
                }
                row += 8;
            }
            if any {
                scatter(source, &block, [first, lane], &total(&sums), factor, du, dv);
            }
        }
        first += LANES;
    }
}

#[inline(always)]
fn back_tile<R: Real, const FMA: bool, const SIGMOID: bool>(
    face: &Face<R>,
    [x, y]: [R; 2],
    offset: &[[R; LANES]; 2],
    values: &[R; LANES],
    sums: &mut Sums<R>,
) {
    for l in 0..LANES {
        let (x, y) = (x + offset[0][l], y + offset[1][l]);
        let (d0, s0, b0, a0) = measure::<R, FMA>(face, 0, x, y);
        let (d1, s1, b1, a1) = measure::<R, FMA>(face, 1, x, y);
        let (d2, s2, b2, a2) = measure::<R, FMA>(face, 2, x, y);
        let nearest = d0.least(d1).least(d2);
        let e = nearest.exp_negative::<FMA>();
        // The derivative of the mask for the squared distance.
        let weight = if SIGMOID {
            let inside = s0.least(s1).least(s2) >= R::ZERO;
            values[l] * (if inside { R::ONE } else { -e }) / (R::ONE + e)
        } else {
            -values[l] * e / (R::ONE - e).most(R::LEAST_FACTOR)
        };
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

/// Sums over the lanes, in a fixed order.
#[inline(always)]
fn total<R: Real>(sums: &Sums<R>) -> [[f64; 4]; 3] {
    let mut total = [[0.0; 4]; 3];
    for k in 0..3 {
        for n in 0..4 {
            let mut lanes = sums[k][n];
            let mut half = LANES / 2;
            while half > 0 {
                for l in 0..half {
                    lanes[l] = lanes[l] + lanes[l + half];
                }
                half /= 2;
            }
            total[k][n] = lanes[0].wide();
        }
    }
    total
}

/// Carry the sums of a face on to its corners. With `q` the nearest point of edge `a b` at `s`, the
/// derivative of the squared distance is `2 (1 - s)(q - pixel)` for `a` and `2 s (q - pixel)` for
/// `b` (envelope theorem).
#[inline(always)]
pub(super) fn scatter<R: Real>(
    source: &Source<'_>,
    block: &Block<R>,
    [first, lane]: [usize; 2],
    sums: &[[f64; 4]; 3],
    factor: f64,
    du: &mut [f64],
    dv: &mut [f64],
) {
    let [a, b, c] = source.faces[first + lane];
    let corners = if block.turned[lane] { [a, c, b] } else { [a, b, c] };
    let scale = source.units.scale.map(|s| 2.0 * factor * s);
    let face = block.face(lane);
    for (k, [across, across_along, end, beyond]) in sums.iter().enumerate() {
        let e = [face.edges[k].x.wide(), face.edges[k].y.wide()];
        let half = face.edges[k].half.wide();
        // q - pixel = -end e - across (-e_y, e_x).
        let whole = [-end * e[0] + across * e[1], -end * e[1] - across * e[0]];
        let (end, across) = (half * beyond, across_along);
        let tilt = [-end * e[0] + across * e[1], -end * e[1] - across * e[0]];
        let [from, to] = block.kept(lane, k);
        let [p, q] = [corners[k] as usize, corners[(k + 1) % 3] as usize];
        for (axis, out) in [&mut *du, &mut *dv].into_iter().enumerate() {
            let part = if half > 0.0 {
                0.5 * (whole[axis] + tilt[axis] / half)
            } else {
                0.5 * whole[axis]
            };
            let second = from * whole[axis] + (to - from) * part;
            out[p] += scale[axis] * (whole[axis] - second);
            out[q] += scale[axis] * second;
        }
    }
}
