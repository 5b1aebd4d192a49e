//! Normals of faces and of vertices.

use super::Fragment;
use crate::raster::{Model, Screen};

/// How much each face counts in the normal of a vertex.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Weight {
    /// By its area.
    #[default]
    Area,
    /// By its angle at the vertex (Thürmer & Wüthrich, "Computing Vertex Normals from Polygonal
    /// Facets", JGT 1998): independent of how the surface is cut into triangles.
    Angle,
}

/// Unit normals of the vertices in the model frame, `(V, 3)`, from the faces around their
/// *positions*: vertices at the same position have the same normal.
///
/// The normal of a face `(a, b, c)` is along `(b - a) x (c - a)`. A vertex without faces, or whose
/// faces cancel, has a normal of zeros.
#[must_use]
pub fn of_vertices(model: &Model, weight: Weight) -> Vec<[f64; 3]> {
    let topology = model.topology();
    let mut sums = vec![[0.0; 3]; model.vertex_count()];
    for face in &topology.faces {
        let p = face.map(|k| model.vertex(k as usize));
        let n = cross(difference(p[1], p[0]), difference(p[2], p[0]));
        for k in 0..3 {
            let n = match weight {
                Weight::Area => n,
                Weight::Angle => {
                    let (d, e) =
                        (difference(p[(k + 1) % 3], p[k]), difference(p[(k + 2) % 3], p[k]));
                    unit(n).map(|c| c * length(cross(d, e)).atan2(dot(d, e)))
                }
            };
            let sum = &mut sums[face[k] as usize];
            sum.iter_mut().zip(n).for_each(|(sum, n)| *sum += n);
        }
    }
    topology.representative.iter().map(|&k| unit(sums[k as usize])).collect()
}

/// Unit normal of a face in the camera frame, turned towards the camera.
pub(super) fn flat(screen: &Screen, face: [u32; 3]) -> [f64; 3] {
    let p = face.map(|k| k as usize).map(|k| [screen.x[k], screen.y[k], screen.z[k]]);
    let n = unit(cross(difference(p[1], p[0]), difference(p[2], p[0])));
    if dot(n, p[0]) > 0.0 { n.map(|c| -c) } else { n }
}

/// The normals of the vertices at a fragment, in the camera frame: on the side of the flat normal
/// of the face, and that where they cancel.
pub(super) fn smooth(
    fragment: &Fragment,
    face: [u32; 3],
    vertices: &[[f64; 3]],
    rotation: &[[f64; 3]; 3],
    flat: [f64; 3],
) -> [f64; 3] {
    let n = fragment.mix_points(face.map(|k| vertices[k as usize]));
    // Normals go by the cofactors of the matrix, which for a rotation are the matrix.
    let [x, y, z] = *rotation;
    let n = unit([dot(cross(y, z), n), dot(cross(z, x), n), dot(cross(x, y), n)]);
    let side = dot(n, flat);
    if side > 0.0 {
        n
    } else if side < 0.0 {
        n.map(|c| -c)
    } else {
        flat
    }
}

fn difference(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn length(a: [f64; 3]) -> f64 {
    // Scaled, so that the squares of the smallest triangles do not vanish.
    let largest = a[0].abs().max(a[1].abs()).max(a[2].abs());
    if largest == 0.0 || !largest.is_finite() {
        return largest;
    }
    let b = a.map(|c| c / largest);
    largest * dot(b, b).sqrt()
}

/// The vector at length 1; zeros stay.
fn unit(a: [f64; 3]) -> [f64; 3] {
    let length = length(a);
    if length == 0.0 { [0.0; 3] } else { a.map(|c| c / length) }
}
