//! A surface point behind the centre of a pixel.

use super::setup::edge;
use crate::raster::{Model, Screen};

/// What is seen at a pixel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Fragment {
    /// Column of the pixel.
    pub column: usize,
    /// Index of the surface.
    pub surface: usize,
    /// Index of the face in its mesh.
    pub face: usize,
    /// Weights of the corners of that face, on the surface; their sum is 1. All are at least 0.
    pub barycentrics: [f64; 3],
    /// `z` in the camera frame, in metres.
    pub depth: f64,
}

impl Fragment {
    /// The point of a face of the screen at `centre`.
    pub(super) fn new(
        (model, screen): (&Model, &Screen),
        (surface, face): (usize, usize),
        column: usize,
        centre: [f64; 2],
        depth: f64,
    ) -> Self {
        let corners = screen.faces(model)[face];
        let weights = weights(screen, corners, centre);
        let parent = screen.parent(face);
        let barycentrics = if screen.is_clipped() {
            carried(screen, (model.vertex_count(), model.faces()[parent]), corners, weights)
        } else {
            weights
        };
        Self { column, surface, face: parent, barycentrics, depth }
    }

    /// The same, and the change of its barycentrics per pixel to the right, and down.
    pub(super) fn with_slopes(
        (model, screen): (&Model, &Screen),
        (surface, face): (usize, usize),
        column: usize,
        centre: [f64; 2],
        depth: f64,
    ) -> (Self, [[f64; 3]; 2]) {
        let corners = screen.faces(model)[face];
        let (mut barycentrics, mut slopes) = weights_and_slopes(screen, corners, centre);
        let parent = screen.parent(face);
        if screen.is_clipped() {
            let whole = (model.vertex_count(), model.faces()[parent]);
            barycentrics = carried(screen, whole, corners, barycentrics);
            slopes = slopes.map(|slope| carried(screen, whole, corners, slope));
        }
        (Self { column, surface, face: parent, barycentrics, depth }, slopes)
    }

    /// The weighted mean of values at the corners, exactly theirs where they are equal.
    #[must_use]
    pub fn mix(&self, [a, b, c]: [f64; 3]) -> f64 {
        a + self.barycentrics[1] * (b - a) + self.barycentrics[2] * (c - a)
    }

    /// The weighted mean of points at the corners.
    #[must_use]
    pub fn mix_points(&self, corners: [[f64; 3]; 3]) -> [f64; 3] {
        [0, 1, 2].map(|k| self.mix(corners.map(|p| p[k])))
    }
}

/// Perspective-correct weights of the corners of a face of the screen: areas in the image by `1/z`.
fn weights(screen: &Screen, corners: [u32; 3], centre: [f64; 2]) -> [f64; 3] {
    let corners = corners.map(|k| k as usize);
    let [a, b, c] = corners.map(|k| [screen.u[k] - centre[0], screen.v[k] - centre[1]]);
    let [za, zb, zc] = corners.map(|k| screen.z[k]);
    let w = [edge(b, c) / za, edge(c, a) / zb, edge(a, b) / zc];
    let sum = w[0] + w[1] + w[2];
    if sum == 0.0 {
        return [1.0, 0.0, 0.0]; // smaller than an f64 can tell
    }
    w.map(|w| w / sum)
}

/// Those weights with their derivatives by the place in the image: each is an affine function over
/// the sum of all three.
fn weights_and_slopes(
    screen: &Screen,
    corners: [u32; 3],
    centre: [f64; 2],
) -> ([f64; 3], [[f64; 3]; 2]) {
    let corners = corners.map(|k| k as usize);
    let [a, b, c] = corners.map(|k| [screen.u[k] - centre[0], screen.v[k] - centre[1]]);
    let [za, zb, zc] = corners.map(|k| screen.z[k]);
    // Times za zb zc.
    let z = [zb * zc, zc * za, za * zb];
    let w = [edge(b, c) * z[0], edge(c, a) * z[1], edge(a, b) * z[2]];
    let sum = w[0] + w[1] + w[2];
    let inverse = 1.0 / sum;
    if !inverse.is_finite() {
        return ([1.0, 0.0, 0.0], [[0.0; 3]; 2]);
    }
    let right = [(b[1] - c[1]) * z[0], (c[1] - a[1]) * z[1], (a[1] - b[1]) * z[2]];
    let down = [(c[0] - b[0]) * z[0], (a[0] - c[0]) * z[1], (b[0] - a[0]) * z[2]];
    let weights = w.map(|w| w * inverse);
    let slopes = [right, down].map(|slope| {
        let change = slope[0] + slope[1] + slope[2];
        [0, 1, 2].map(|k| (slope[k] - weights[k] * change) * inverse)
    });
    (weights, slopes)
}

/// Weights of the corners of a part as weights of the corners of the whole face.
fn carried(
    screen: &Screen,
    (vertices, whole): (usize, [u32; 3]),
    corners: [u32; 3],
    weights: [f64; 3],
) -> [f64; 3] {
    let mut out = [0.0; 3];
    let mut add = |vertex: u32, weight: f64| {
        // A face that names a vertex twice has no area and is never seen.
        if let Some(k) = whole.iter().position(|&v| v == vertex) {
            out[k] += weight;
        }
    };
    for (corner, weight) in corners.into_iter().zip(weights) {
        match (corner as usize).checked_sub(vertices) {
            None => add(corner, weight),
            Some(cut) => {
                let cut = screen.cuts[cut];
                add(cut.a, weight * (1.0 - cut.s));
                add(cut.b, weight * cut.s);
            }
        }
    }
    out
}
