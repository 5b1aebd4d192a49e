//! Which edge of a face is the nearest one, for whole tiles.
//!
//! Around a face, the points nearest to an edge are a strip from that edge outwards, and those
//! nearest to a corner are the wedge between two strips, where either edge gives the distance. Of
//! small faces nearly every tile within reach meets one strip or lies in one wedge, and needs one
//! edge instead of three. A tile is taken for the square of its pixel centres, a little enlarged.

use super::faces::{Block, Source};
use super::real::{LANES, Real};
use super::tiles::{LAST, SIDE, Units};

/// Widths by which strips are enlarged: more than rounding and [`LEVEL`] take away.
const MARGIN: f64 = 2e-3;

/// An edge that rises by less than so many widths over a tile counts as rising by that.
const LEVEL: f64 = 1e-4;

/// Of the 8x8 tiles of a visit: bit `8 row + column`, for each face.
#[derive(Debug)]
pub(super) struct Near {
    /// Those within reach.
    pub(super) all: [u64; LANES],
    /// Those of them for which an edge alone gives the distance to the face, for each edge.
    pub(super) one: [[u64; LANES]; 3],
}

/// The bounds of an edge's strip in a row of tiles, in columns.
#[derive(Debug, Clone, Copy)]
struct Strip<R> {
    /// From here on the tiles touch it; for row 0 and a row further.
    low: [R; LANES],
    shift: [R; LANES],
    /// The length.
    wide: [R; LANES],
    /// Whether the edge ends on the right of it.
    right: [bool; LANES],
    /// Up to here (or from here on: `beyond`) the tiles touch the outer side.
    outer: [R; LANES],
    outer_shift: [R; LANES],
    /// The same for the inner side.
    inner: [R; LANES],
    beyond: [bool; LANES],
}

impl Near {
    pub(super) fn new() -> Self {
        Self { all: [0; LANES], one: [[0; LANES]; 3] }
    }

    /// Find those of a block in so many rows; `low` and `high` are the bounds of its faces in tiles, from
    /// the first tile of the visit on. With `inside`, tiles that touch a face need all its edges.
    #[inline(always)]
    pub(super) fn find<R: Real>(
        block: &mut Block<R>,
        source: &Source<'_>,
        rows: u32,
        low: &[[f64; LANES]; 2],
        high: &[[f64; LANES]; 2],
        inside: bool,
    ) {
        let Units { scale, reach, .. } = source.units;
        let mut strips = [Strip::new(), Strip::new(), Strip::new()];
        let (mut x0, mut x1, mut y0, mut y1) =
            ([R::ZERO; LANES], [R::ZERO; LANES], [R::ZERO; LANES], [R::ZERO; LANES]);
        for k in 0..3 {
            strips[k].set(block, source, k);
        }
        for l in 0..LANES {
            (x0[l], x1[l]) = (R::of(low[0][l]), R::of(high[0][l]));
            (y0[l], y1[l]) = (R::of(low[1][l]), R::of(high[1][l]));
        }
        let (down, across) = (R::of(SIDE as f64 * scale[1]), R::of(1.0 / (SIDE as f64 * scale[0])));
        let squared = R::of(reach * reach * 1.001);
        let last = R::of(LAST + 1e-3);
        // Rows 0 to 3 and 4 to 7.
        let mut near = [[[0_u32; LANES]; 4]; 2];
        for row in 0..rows {
            let r = R::of(f64::from(row));
            let (half, place) = ((row / 4) as usize, 8 * (row % 4));
            for l in 0..LANES {
                let gap = (y0[l] - r - last).most(r - y1[l]).most(R::ZERO) * down;
                let left = squared - gap * gap;
                let wide = left.most(R::ZERO).sqrt() * across;
                let bits = before(x1[l] + wide) & !before(x0[l] - wide - last);
                let bits = if left > R::ZERO { bits & 0xFF } else { 0 };
                // Of each edge: touching its strip, wholly past its end, wholly before its begin.
                let (mut touch, mut past, mut ahead) = ([0; 3], [0; 3], [0; 3]);
                let mut within = u32::MAX;
                for k in 0..3 {
                    let s = &strips[k];
                    let from = s.low[l] + r * s.shift[l];
                    let (small, large) = (before(from), !before(from + s.wide[l]));
                    let shift = r * s.outer_shift[l];
                    let flip = if s.beyond[l] { u32::MAX } else { 0 };
                    touch[k] = !(small | large) & (before(s.outer[l] + shift) ^ flip);
                    past[k] = if s.right[l] { large } else { small };
                    ahead[k] = if s.right[l] { small } else { large };
                    if inside {
                        within &= before(s.inner[l] + shift) ^ !flip;
                    }
                }
                // The bounds of a strip are taken one by one, and a tile may be within all of them
                // without touching it. Wedges have no such doubt, and go first.
                let wedge = [past[0] & ahead[1], past[1] & ahead[2], past[2] & ahead[0]];
                let wedges = wedge[0] | wedge[1] | wedge[2];
                let outside = if inside { bits & !within } else { bits };
                let mut found = [0; 3];
                for k in 0..3 {
                    let others = touch[(k + 1) % 3] | touch[(k + 2) % 3];
                    found[k] = outside & (wedge[k] | (touch[k] & !(others | wedges)));
                }
                near[half][0][l] |= found[0] << place;
                near[half][1][l] |= found[1] << place;
                near[half][2][l] |= found[2] << place;
                near[half][3][l] |= bits << place;
            }
        }
        for l in 0..LANES {
            let join = |k: usize| u64::from(near[0][k][l]) | u64::from(near[1][k][l]) << 32;
            block.near.all[l] = join(3);
            for k in 0..3 {
                block.near.one[k][l] = join(k);
            }
        }
        let near = &mut block.near;
        for l in 0..LANES {
            let keep = if block.flat[l] | block.far[l] { 0 } else { u64::MAX };
            for k in 0..3 {
                near.one[k][l] &= keep;
            }
        }
    }
}

/// The columns of eight that are less than `x`, and what further bits may be.
#[inline(always)]
fn before<R: Real>(x: R) -> u32 {
    !u32::MAX.unbounded_shl(x.most(R::ZERO).ceil_shift())
}

impl<R: Real> Strip<R> {
    #[inline(always)]
    fn new() -> Self {
        let none = [R::ZERO; LANES];
        Self {
            low: none,
            shift: none,
            wide: none,
            right: [false; LANES],
            outer: none,
            outer_shift: none,
            inner: none,
            beyond: [false; LANES],
        }
    }

    /// The strip of edge `k` of each face.
    #[inline(always)]
    fn set(&mut self, block: &Block<R>, source: &Source<'_>, k: usize) {
        let Units { scale, .. } = source.units;
        let edges = &block.edges;
        // Widths in a tile, and from its middle to its last pixel centre.
        let tile = [R::of(SIDE as f64 * scale[0]), R::of(SIDE as f64 * scale[1])];
        let out = 0.5 * LAST * SIDE as f64;
        let radius = [R::of(out * scale[0]), R::of(out * scale[1])];
        let (level, margin) = (R::of(LEVEL), R::of(MARGIN));
        for l in 0..LANES {
            let (ex, ey) = (edges.x[k][l], edges.y[k][l]);
            // Of the middle of the first tile.
            let along = ex * radius[0] + ey * radius[1] + edges.along[k][l];
            let across = ex * radius[1] - ey * radius[0] + edges.across[k][l];
            let wide = edges.half[k][l] + ex.abs() * radius[0] + ey.abs() * radius[1] + margin;
            let thick = ey.abs() * radius[0] + ex.abs() * radius[1] + margin;
            // |along + (row, column) part| <= wide, solved for the column.
            let step = ex * tile[0];
            let step = if step.abs() > level { step } else { level };
            let inverse = R::ONE / step;
            let right = step > R::ZERO;
            let end = if right { wide } else { -wide };
            self.low[l] = -(end + along) * inverse;
            self.wide[l] = (end + end) * inverse;
            self.shift[l] = -(ey * tile[1]) * inverse;
            self.right[l] = right;
            // across + (row, column) part < thick.
            let step = -(ey * tile[0]);
            let step = if step.abs() > level { step } else { level };
            let inverse = R::ONE / step;
            self.outer[l] = (thick - across) * inverse;
            self.inner[l] = -(thick + across) * inverse;
            self.outer_shift[l] = -(ex * tile[1]) * inverse;
            self.beyond[l] = step < R::ZERO;
        }
    }
}
