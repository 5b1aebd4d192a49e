//! Sixteen faces at a time, made ready for distances.

use super::nearest::Near;
use super::real::{LANES, Real};
use super::tiles::{Rectangle, SIDE, Units};
use super::visits::Visit;

/// Twice the area over the squares of two sides, up to which a face has no area: rounding leaves
/// collinear corners about 1e-16.
const FLAT: f64 = 1e-12;

/// Faces whose corners are further out than so many times the image are cut to its surroundings.
const FAR: f64 = 1.5;

/// Edge `k` of face `l` at `[k][l]`, in widths from the face's [origin](Block). With `d` the way
/// from there to a pixel, the pixel is at `along = e.d + along0` from the middle of the edge, and at
/// `across = e x d + across0` from its line, inwards positive. `e` is a unit vector. The fourth edge
/// is nothing: it spares checks of an index.
#[derive(Debug, Clone, Copy)]
pub(super) struct Edges<R> {
    pub(super) x: [[R; LANES]; 4],
    pub(super) y: [[R; LANES]; 4],
    pub(super) along: [[R; LANES]; 4],
    pub(super) across: [[R; LANES]; 4],
    /// Half the length.
    pub(super) half: [[R; LANES]; 4],
}

/// Sixteen faces. Edge `k` runs from corner `k` to the next, the corners positively oriented. The
/// origin of a face is the first pixel centre of the first tile of its visit.
#[derive(Debug)]
#[repr(C, align(64))]
pub(super) struct Block<R> {
    pub(super) edges: Edges<R>,
    /// The first tile of the visit: columns, rows.
    first: [[i32; LANES]; 2],
    /// Tiles by what is near to them.
    pub(super) near: Near,
    /// Whether the second and the third corner are exchanged.
    pub(super) turned: [bool; LANES],
    /// Without area, up to rounding.
    pub(super) flat: [bool; LANES],
    /// Further out than [`FAR`].
    pub(super) far: [bool; LANES],
    /// Where the part of each edge that is measured begins and ends: all of it but for far faces.
    pub(super) kept: [[[f64; LANES]; 2]; 3],
}

/// What a block is made of.
#[derive(Debug, Clone, Copy)]
pub(super) struct Source<'a> {
    pub(super) faces: &'a [[u32; 3]],
    pub(super) u: &'a [f64],
    pub(super) v: &'a [f64],
    pub(super) units: Units,
    pub(super) rectangle: Rectangle,
}

impl<R: Real> Block<R> {
    pub(super) fn new() -> Self {
        let none = [[R::ZERO; LANES]; 4];
        let edges = Edges { x: none, y: none, along: none, across: none, half: none };
        Self {
            edges,
            first: [[0; LANES]; 2],
            near: Near::new(),
            turned: [false; LANES],
            flat: [false; LANES],
            far: [false; LANES],
            kept: [[[0.0; LANES], [1.0; LANES]]; 3],
        }
    }

    /// Load the faces of up to 16 visits, without which edge is [near](Near) to which tile.
    #[inline(always)]
    pub(super) fn load(&mut self, source: &Source<'_>, visits: &[Visit]) {
        self.load_corners(source, visits);
    }

    /// As [`load`](Self::load), and find what is near. With `inside`, edges are told apart inside of
    /// faces too.
    #[inline(always)]
    pub(super) fn load_near(&mut self, source: &Source<'_>, visits: &[Visit], inside: bool) {
        let corners = self.load_corners(source, visits);
        // In tiles, from the first of the visit on: the pixel centres of tile `t` are at `t`, ..,
        // `t + 3/4`.
        let (mut low, mut high) = ([[0.0; LANES]; 2], [[0.0; LANES]; 2]);
        let Units { scale, half, .. } = source.units;
        for axis in 0..2 {
            let per_tile = 1.0 / (SIDE as f64 * scale[axis]);
            let shift = (half[axis] - 0.5) / SIDE as f64 - source.rectangle.first[axis] as f64;
            for l in 0..LANES {
                let (a, b, c) = (corners[axis][l], corners[axis + 2][l], corners[axis + 4][l]);
                let shift = shift - f64::from(self.first[axis][l]);
                low[axis][l] = a.least(b).least(c) * per_tile + shift;
                high[axis][l] = a.most(b).most(c) * per_tile + shift;
            }
        }
        let used = visits.iter().fold(0, |used, visit| used | visit.used);
        let rows = 8 - used.leading_zeros() / 8;
        Near::find(self, source, rows, &low, &high, inside);
    }

    /// Everything but what is near; the corners in widths, in order.
    #[inline(always)]
    fn load_corners(&mut self, source: &Source<'_>, visits: &[Visit]) -> [[f64; LANES]; 6] {
        let visits = &visits[..visits.len().min(LANES)];
        let mut corners = [[0.0; LANES]; 6];
        for (lane, visit) in visits.iter().enumerate() {
            let face = source.faces[visit.face as usize];
            for k in 0..3 {
                corners[2 * k][lane] = source.u[face[k] as usize];
                corners[2 * k + 1][lane] = source.v[face[k] as usize];
            }
            self.first[0][lane] = i32::from(visit.column);
            self.first[1][lane] = i32::from(visit.row);
        }
        self.prepare(source, &mut corners);
        for lane in 0..visits.len() {
            if self.far[lane] {
                self.cut(source, lane, &corners);
            }
        }
        corners
    }

    /// The edges of all lanes; the corners (pixels) become widths, in order.
    #[inline(always)]
    fn prepare(&mut self, source: &Source<'_>, corners: &mut [[f64; LANES]; 6]) {
        let Units { scale, half, reach } = source.units;
        let limit = FAR * (source.units.extent() + reach);
        for l in 0..LANES {
            let (ax, ay) =
                ((corners[0][l] - half[0]) * scale[0], (corners[1][l] - half[1]) * scale[1]);
            let (px, py) =
                ((corners[2][l] - half[0]) * scale[0], (corners[3][l] - half[1]) * scale[1]);
            let (qx, qy) =
                ((corners[4][l] - half[0]) * scale[0], (corners[5][l] - half[1]) * scale[1]);
            let area = (px - ax) * (qy - ay) - (py - ay) * (qx - ax);
            let turned = area < 0.0;
            let (bx, cx) = if turned { (qx, px) } else { (px, qx) };
            let (by, cy) = if turned { (qy, py) } else { (py, qy) };
            self.turned[l] = turned;
            let (ux, uy, vx, vy) = (px - ax, py - ay, qx - ax, qy - ay);
            let squares = ux * ux + uy * uy + vx * vx + vy * vy;
            self.flat[l] = area.abs() <= FLAT * squares;
            corners[0][l] = ax;
            corners[1][l] = ay;
            corners[2][l] = bx;
            corners[3][l] = by;
            corners[4][l] = cx;
            corners[5][l] = cy;
            let x = ax.abs().most(bx.abs()).most(cx.abs());
            let y = ay.abs().most(by.abs()).most(cy.abs());
            self.far[l] = x.most(y) > limit;
        }
        // From the first corner, or a face smaller than the digits of its place would lose its shape.
        let mut points = [[R::ZERO; LANES]; 6];
        let mut place = [[R::ZERO; LANES]; 2];
        for l in 0..LANES {
            let origin = self.origin(source, l);
            for axis in 0..2 {
                place[axis][l] = R::of(corners[axis][l] - origin[axis]);
                points[axis + 2][l] = R::of(corners[axis + 2][l] - corners[axis][l]);
                points[axis + 4][l] = R::of(corners[axis + 4][l] - corners[axis][l]);
            }
        }
        for k in 0..3 {
            let [i, j] = [2 * k, 2 * ((k + 1) % 3)];
            let edges = &mut self.edges;
            self.kept[k] = [[0.0; LANES], [1.0; LANES]];
            for l in 0..LANES {
                let (px, py, qx, qy) =
                    (points[i][l], points[i + 1][l], points[j][l], points[j + 1][l]);
                let (dx, dy) = (qx - px, qy - py);
                let length = (dx * dx + dy * dy).sqrt();
                let point = length <= R::SAME;
                let inverse = R::ONE / (if point { R::ONE } else { length });
                let ex = if point { R::ONE } else { dx * inverse };
                let ey = if point { R::ZERO } else { dy * inverse };
                let two = R::ONE + R::ONE;
                let (mx, my) = (place[0][l] + (px + qx) / two, place[1][l] + (py + qy) / two);
                edges.x[k][l] = ex;
                edges.y[k][l] = ey;
                edges.along[k][l] = -(ex * mx + ey * my);
                edges.across[k][l] = ey * mx - ex * my;
                edges.half[k][l] = if point { R::ZERO } else { length / two };
            }
        }
    }

    /// The first pixel centre of the first tile of a visit, in widths.
    #[inline(always)]
    fn origin(&self, source: &Source<'_>, lane: usize) -> [f64; 2] {
        let Units { scale, half, .. } = source.units;
        let at = |axis: usize| {
            let tile = source.rectangle.first[axis] as f64 + f64::from(self.first[axis][lane]);
            (SIDE as f64 * tile + 0.5 - half[axis]) * scale[axis]
        };
        [at(0), at(1)]
    }

    /// Measure a face of which a corner is far away from what is near to the image, where single
    /// precision and the squares of distances are at home.
    #[cold]
    fn cut(&mut self, source: &Source<'_>, lane: usize, corners: &[[f64; LANES]; 6]) {
        let Units { scale, half, reach } = source.units;
        let bounds = [0, 1].map(|axis| half[axis] * scale[axis] + reach + scale[axis]);
        let origin = self.origin(source, lane);
        for k in 0..3 {
            let corner = |k: usize| [corners[2 * (k % 3)][lane], corners[2 * (k % 3) + 1][lane]];
            let (a, b) = (corner(k), corner(k + 1));
            let d = [b[0] - a[0], b[1] - a[1]];
            let length = d[0].hypot(d[1]);
            let e = if length > 0.0 { [d[0] / length, d[1] / length] } else { [1.0, 0.0] };
            let (mut from, mut to) = (0.0_f64, 1.0_f64);
            for axis in 0..2 {
                if d[axis] == 0.0 {
                    if a[axis].abs() > bounds[axis] {
                        to = -1.0;
                    }
                    continue;
                }
                let at = |side: f64| (side * bounds[axis] - a[axis]) / d[axis];
                let (p, q) = (at(-1.0), at(1.0));
                from = from.max(p.min(q));
                to = to.min(p.max(q));
            }
            let edges = &mut self.edges;
            edges.x[k][lane] = R::of(e[0]);
            edges.y[k][lane] = R::of(e[1]);
            if from <= to {
                let point = |s: f64, axis: usize| {
                    // From the nearer end, or a long edge would lose the digits of its far one.
                    let p =
                        if s < 0.5 { a[axis] + s * d[axis] } else { b[axis] - (1.0 - s) * d[axis] };
                    p.clamp(-bounds[axis], bounds[axis])
                };
                let p = [point(from, 0), point(from, 1)];
                let q = [point(to, 0), point(to, 1)];
                let m = [0.5 * (p[0] + q[0]) - origin[0], 0.5 * (p[1] + q[1]) - origin[1]];
                edges.along[k][lane] = R::of(-(e[0] * m[0] + e[1] * m[1]));
                edges.across[k][lane] = R::of(e[1] * m[0] - e[0] * m[1]);
                edges.half[k][lane] = R::of(0.5 * (q[0] - p[0]).hypot(q[1] - p[1]));
                (self.kept[k][0][lane], self.kept[k][1][lane]) = (from, to);
            } else {
                // Out of reach, but its line still says on which side a pixel is.
                let away = 1e3 * (source.units.extent() + reach);
                let across = e[1] * (a[0] - origin[0]) - e[0] * (a[1] - origin[1]);
                edges.along[k][lane] = R::of(away);
                edges.across[k][lane] = R::of(across.clamp(-away, away));
                edges.half[k][lane] = R::ZERO;
            }
        }
    }
}
