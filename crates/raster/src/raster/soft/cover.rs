//! Which pixel centres lie in a projected triangle, by winding numbers.
//!
//! Every face is turned the same way round, so the number of faces over a pixel is the sum of the
//! crossings to its left, and an edge between two faces on either side of it adds nothing: of a
//! closed mesh only the silhouette edges are drawn.

use super::real::{LANES, Real};
use super::tiles::{SIDE, Tiles};
use crate::raster::{Model, Screen, Size};

/// Buffers of the count.
#[derive(Debug, Default)]
pub(super) struct Cover {
    signs: Vec<i8>,
    counts: Vec<i32>,
}

impl Cover {
    /// Set the pixels inside to 0. Triangles without area contain nothing; a pixel exactly on an
    /// outline belongs to one of its sides.
    pub(super) fn clear<R: Real>(
        &mut self,
        model: &Model,
        screen: &Screen,
        size: Size,
        tiles: &mut Tiles<R>,
    ) {
        let [columns, rows] = tiles.pixels(size);
        let width = columns.len() + 1;
        self.counts.clear();
        self.counts.resize(width * rows.len(), 0);
        let mut canvas = Canvas {
            first: [columns.start as f64 + 0.5, rows.start as f64 + 0.5],
            columns: columns.len(),
            rows: rows.len(),
            counts: &mut self.counts,
        };
        let (u, v) = (&screen.u[..], &screen.v[..]);
        let point = |k: u32| (u[k as usize], v[k as usize]);
        let sign = |face: &[u32; 3]| {
            let [(ax, ay), (bx, by), (cx, cy)] = face.map(point);
            let area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax);
            i8::from(area > 0.0) - i8::from(area < 0.0)
        };
        if screen.is_clipped() {
            for face in screen.faces(model) {
                let sign = i32::from(sign(face));
                for k in 0..3 {
                    let (from, to) = (face[k], face[(k + 1) % 3]);
                    let along = if from < to { sign } else { -sign };
                    canvas.edge(point(from.min(to)), point(from.max(to)), along);
                }
            }
        } else {
            let topology = model.topology();
            self.signs.clear();
            self.signs.extend(model.faces().iter().map(sign));
            self.signs.push(0);
            let along = |code: u32| {
                let sign = i32::from(self.signs[(code / 2) as usize]);
                if code & 1 == 0 { sign } else { -sign }
            };
            for edge in &topology.edges {
                let turns = along(edge.faces[0]) + along(edge.faces[1]);
                if turns != 0 {
                    canvas.edge(point(edge.a), point(edge.b), turns);
                }
            }
            for &(edge, code) in &topology.more {
                let edge = &topology.edges[edge as usize];
                canvas.edge(point(edge.a), point(edge.b), along(code));
            }
        }
        for (row, counts) in self.counts.chunks_exact(width).enumerate() {
            let (line, lane) = (row / SIDE, SIDE * (row % SIDE));
            let tiles = &mut tiles.values[line * tiles.count[0]..(line + 1) * tiles.count[0]];
            let mut inside = 0;
            for (counts, tile) in counts[..width - 1].chunks(SIDE).zip(tiles) {
                for (count, value) in counts.iter().zip(&mut tile[lane % LANES..]) {
                    inside += count;
                    *value = if inside == 0 { *value } else { R::ZERO };
                }
            }
        }
    }
}

/// Crossings of pixel rows by edges.
struct Canvas<'a> {
    /// Centre of the first pixel, in pixels.
    first: [f64; 2],
    columns: usize,
    rows: usize,
    counts: &'a mut [i32],
}

impl Canvas<'_> {
    /// An edge that is passed `turns` times from `a` to `b`. It crosses the rows whose centres are
    /// in `[top, bottom)`, and a pixel is to the right of it from the crossing on.
    #[inline(always)]
    fn edge(&mut self, a: (f64, f64), b: (f64, f64), turns: i32) {
        let (top, bottom, turns) = if a.1 < b.1 { (a, b, -turns) } else { (b, a, turns) };
        let row = |v: f64| (v - self.first[1]).ceil().clamp(0.0, self.rows as f64) as usize;
        let (from, to) = (row(top.1), row(bottom.1));
        if from >= to {
            return;
        }
        let slope = (bottom.0 - top.0) / (bottom.1 - top.1);
        for row in from..to {
            let down = row as f64 + self.first[1] - top.1;
            let x = top.0 + down * slope;
            let column = (x - self.first[0]).ceil().clamp(0.0, self.columns as f64) as usize;
            self.counts[row * (self.columns + 1) + column] += turns;
        }
    }
}
