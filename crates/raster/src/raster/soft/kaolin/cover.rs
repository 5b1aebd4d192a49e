//! Which pixels are inside of faces.

use multiversion::multiversion;

use super::super::real::LANES;
use super::super::tiles::Run;
use super::super::visits::{Bounds, of_face};
use super::points::{Grid, Points};
use crate::raster::outline::Faces;
use crate::raster::{Model, Screen, Size, hard};

/// Added to denominators, in multiplied units.
const EPSILON: f64 = 1e-15;
/// Faces at this depth (metres, down -z) or beyond are not drawn.
const DEEPEST: f64 = -1000.0;
/// Up to this part of it, rounding does not matter.
const CERTAIN: f64 = 0.999;

/// Side of a block of pixels, a lane each.
const SIDE: usize = 4;

/// Add the pixels inside of faces to `runs`, row after row.
///
/// Away from edges, where rounding decides nothing, they are those of any point-sampled mask.
pub(in super::super) fn cover(model: &Model, screen: &Screen, size: Size, runs: &mut Vec<Run>) {
    if screen.z.iter().all(|&z| z < CERTAIN * -DEEPEST) {
        let cover = |row, columns| runs.push(Run::new(row, columns));
        if !hard::runs(model, screen, Faces::Front, size, cover) {
            return;
        }
        runs.clear();
    }
    cover_exactly(model, screen, &Points::new(screen, size), size, runs);
    runs.sort_unstable_by_key(|run| (run.row, run.from));
}

/// As Kaolin decides it, pixel by pixel.
#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx512bw+avx2+fma", "x86_64+avx2+fma"))]
fn cover_exactly(model: &Model, screen: &Screen, points: &Points, size: Size, runs: &mut Vec<Run>) {
    let grid = Grid::new(size);
    for faces in screen.faces(model).chunks(LANES) {
        let mut boxes = [([0; 4], [0; 3]); LANES];
        let mut kept = 0;
        for face in faces {
            let (bounds, of) = &mut boxes[kept];
            of_face(&points.held, *face, bounds);
            *of = *face;
            let front = screen.is_front(*face);
            kept += usize::from(front & (bounds[0] < -bounds[2]) & (bounds[1] < -bounds[3]));
        }
        for (bounds, face) in &boxes[..kept] {
            let face = Face::new(points, screen, *face);
            let [left, top, right, bottom] = *bounds;
            for row in (top..-bottom).step_by(SIDE) {
                for column in (left..-right).step_by(SIDE) {
                    let mut held = face.holds(&grid, bounds, [column, row]);
                    while held != 0 {
                        let [down, across] = [held.trailing_zeros() / 4, held.trailing_zeros() % 4];
                        let [row, from] = [row as u32 + down, column as u32 + across];
                        runs.push(Run { row, from, to: from + 1 });
                        held &= held - 1;
                    }
                }
            }
        }
    }
}

/// A face in multiplied NDC.
struct Face {
    a: [f64; 2],
    b: [f64; 2],
    c: [f64; 2],
    /// Down -z.
    depth: [f64; 3],
}

impl Face {
    #[inline(always)]
    fn new(points: &Points, screen: &Screen, face: [u32; 3]) -> Self {
        let [a, b, c] = face.map(|k| [points.x[k as usize], points.y[k as usize]]);
        Self { a, b, c, depth: face.map(|k| -screen.z[k as usize]) }
    }

    /// Which pixels of a block, from its first column and row on, the face holds at a depth that is
    /// drawn: a bit each, row by row.
    #[inline(always)]
    fn holds(&self, grid: &Grid, bounds: &Bounds, first: [i32; 2]) -> u32 {
        let ([ax, ay], [bx, by], [cx, cy]) = (self.a, self.b, self.c);
        let (m, p, n, q) = (bx - ax, by - ay, cx - ax, cy - ay);
        let k = m * q - n * p + EPSILON;
        let [column, row] = first.map(f64::from);
        let (right, bottom) = (-f64::from(bounds[2]), -f64::from(bounds[3]));
        let mut held = [false; LANES];
        for l in 0..LANES {
            let (column, row) = (column + (l % SIDE) as f64, row + (l / SIDE) as f64);
            let (x, y) = (grid.x(column), grid.y(row));
            let w1 = ((x - ax) * q - n * (y - ay)) / k;
            let w2 = (m * (y - ay) - (x - ax) * p) / k;
            let w0 = 1.0 - w1 - w2;
            let z = w0 * self.depth[0] + w1 * self.depth[1] + w2 * self.depth[2];
            held[l] = !((w0 < 0.0) | (w1 < 0.0) | (w2 < 0.0))
                & (z > DEEPEST)
                & (column < right)
                & (row < bottom);
        }
        let mut bits = 0;
        for l in 0..LANES {
            bits |= u32::from(held[l]) << l;
        }
        bits
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::Intrinsics;
    use crate::raster::View;

    fn pixels(runs: &[Run]) -> Vec<(u32, u32)> {
        let mut pixels: Vec<_> = runs
            .iter()
            .flat_map(|run| (run.from..run.to).map(|column| (run.row, column)))
            .collect();
        pixels.sort_unstable();
        pixels.dedup();
        pixels
    }

    /// Both ways, and how many pixels there are; `depth` moves everything away.
    fn compare(seed: u64, grid: f64, depth: f64) -> usize {
        let mut state = seed;
        let mut next = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            (state >> 11) as f64 / (1_u64 << 53) as f64
        };
        let mut place = |scale: f64| {
            let x = scale * (next() - 0.5);
            if grid > 0.0 { (x / grid).round() * grid } else { x }
        };
        let vertices: Vec<[f64; 3]> =
            (0..60).map(|_| [place(1.2), place(1.2), place(0.8)]).collect();
        let mut index = seed;
        let faces: Vec<[u32; 3]> = (0..40)
            .map(|_| {
                std::array::from_fn(|_| {
                    index = index.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(7);
                    ((index >> 33) % 60) as u32
                })
            })
            .collect();
        let model = Model::new(&vertices, &faces).expect("valid");
        let view = View {
            rotation: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
            translation: [0.0, 0.0, depth],
            camera: Intrinsics::new(32.0 * depth, 32.0 * depth, 20.0, 16.0).expect("valid"),
        };
        let mut screen = Screen::default();
        screen.project(&model, &view, 0.3).expect("drawn");
        let size = Size { height: 32, width: 40 };
        let (mut fast, mut exact) = (Vec::new(), Vec::new());
        cover(&model, &screen, size, &mut fast);
        assert!(fast.is_sorted_by_key(|run| run.row));
        cover_exactly(&model, &screen, &Points::new(&screen, size), size, &mut exact);
        assert_eq!(pixels(&fast), pixels(&exact), "{seed}, {grid}, {depth}");
        pixels(&exact).len()
    }

    #[test]
    fn pixels_inside_are_those_that_kaolin_finds() {
        let mut covered = 0;
        for seed in 0..100 {
            covered += compare(seed, 0.0, 2.0);
            // Centres on edges, faces that are seen from their edge, and others cut at the near plane.
            covered += compare(seed, 0.25, 2.0);
            covered += compare(seed, 0.0, 0.5);
            compare(seed, 0.0, 999.9);
        }
        assert!(covered > 10_000, "{covered}");
    }
}
