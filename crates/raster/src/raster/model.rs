//! A mesh prepared for drawing.

use glam::DVec3;

use super::Topology;
use super::planes::Planes;
use crate::error::{Error, Result};
use crate::mesh::Mesh;

/// The largest coordinate that is drawn, in metres.
pub(crate) const LARGEST_DRAWN: f64 = 1e9;

/// Vertices in the model frame (metres), faces, and the edges they share.
#[derive(Debug, Clone)]
pub struct Model {
    /// Coordinates, one array an axis, `V` each.
    pub(crate) x: Vec<f64>,
    pub(crate) y: Vec<f64>,
    pub(crate) z: Vec<f64>,
    faces: Vec<[u32; 3]>,
    topology: Topology,
    planes: Planes,
}

impl Model {
    /// Vertices `(V, 3)` in metres and faces `(F, 3)` over them.
    ///
    /// # Errors
    /// [`Error::NoPoints`] without vertices or faces, [`Error::NonFiniteVertex`],
    /// [`Error::FaceIndex`], and [`Error::Argument`] for a coordinate beyond 1e9 m.
    pub fn new(vertices: &[[f64; 3]], faces: &[[u32; 3]]) -> Result<Self> {
        Self::check_vertices(vertices)?;
        for (k, face) in faces.iter().enumerate() {
            if let Some(&bad) = face.iter().find(|&&v| v as usize >= vertices.len()) {
                let vertices = vertices.len();
                return Err(Error::FaceIndex { face: k, vertex: bad.into(), vertices });
            }
        }
        if faces.is_empty() {
            return Err(Error::argument("faces", "a mesh without faces has no silhouette"));
        }
        if faces.len() > (u32::MAX / 2 - 1) as usize {
            return Err(Error::argument("faces", format!("{} are more than fit", faces.len())));
        }
        let topology = Topology::new(&keys(vertices), faces);
        Ok(Self::with_topology(vertices, faces, topology))
    }

    /// From a mesh in metres.
    ///
    /// # Errors
    /// As [`Model::new`].
    pub fn from_mesh(mesh: &Mesh) -> Result<Self> {
        let vertices: Vec<[f64; 3]> = mesh.vertices().iter().map(DVec3::to_array).collect();
        Self::new(&vertices, mesh.faces())
    }

    /// The same faces over other vertices. The edges are found again only if other vertices
    /// coincide than before.
    ///
    /// # Errors
    /// As [`Model::new`], and [`Error::Argument`] for another number of vertices.
    pub fn with_vertices(&self, vertices: &[[f64; 3]]) -> Result<Self> {
        if vertices.len() != self.x.len() {
            let message = format!("{}, expected {} as before", vertices.len(), self.x.len());
            return Err(Error::argument("vertices", message));
        }
        Self::check_vertices(vertices)?;
        let topology = self.topology.rewelded(&keys(vertices), &self.faces);
        Ok(Self::with_topology(vertices, &self.faces, topology))
    }

    fn with_topology(vertices: &[[f64; 3]], faces: &[[u32; 3]], topology: Topology) -> Self {
        let [x, y, z] = std::array::from_fn(|k| vertices.iter().map(|p| p[k]).collect::<Vec<_>>());
        let planes = Planes::new([&x, &y, &z], faces);
        Self { x, y, z, faces: faces.to_vec(), topology, planes }
    }

    fn check_vertices(vertices: &[[f64; 3]]) -> Result<()> {
        if vertices.is_empty() {
            return Err(Error::NoPoints("vertices"));
        }
        if u32::try_from(vertices.len()).is_err() {
            let message = format!("{} are more than 32 bits count", vertices.len());
            return Err(Error::argument("vertices", message));
        }
        for (k, p) in vertices.iter().enumerate() {
            if !p.iter().all(|c| c.is_finite()) {
                return Err(Error::NonFiniteVertex { vertex: k });
            }
            if p.iter().any(|c| c.abs() > LARGEST_DRAWN) {
                let message = format!("vertex {k} is {p:?} m; expected at most 1e9 m");
                return Err(Error::argument("vertices", message));
            }
        }
        Ok(())
    }

    /// Number of vertices.
    #[must_use]
    pub fn vertex_count(&self) -> usize {
        self.x.len()
    }

    /// Triangles over the vertices.
    #[must_use]
    pub fn faces(&self) -> &[[u32; 3]] {
        &self.faces
    }

    /// The edges.
    #[must_use]
    pub fn topology(&self) -> &Topology {
        &self.topology
    }

    pub(super) fn planes(&self) -> &Planes {
        &self.planes
    }

    /// A vertex, in metres.
    #[must_use]
    pub fn vertex(&self, k: usize) -> [f64; 3] {
        [self.x[k], self.y[k], self.z[k]]
    }
}

/// What makes positions equal: adding 0.0 turns -0.0 into 0.0 and changes nothing else.
fn keys(vertices: &[[f64; 3]]) -> Vec<[u64; 3]> {
    vertices.iter().map(|p| p.map(|c| (c + 0.0).to_bits())).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_cannot_be_drawn_is_refused_by_name() {
        let v = [[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];
        let message = |r: Result<Model>| r.expect_err("refused").to_string();
        assert!(message(Model::new(&[], &[])).starts_with("vertices:"));
        assert!(message(Model::new(&v, &[])).starts_with("faces:"));
        assert!(message(Model::new(&v, &[[0, 1, 3]])).starts_with("face 0 refers to vertex 3"));
        let mut bad = v;
        bad[1][2] = f64::NAN;
        assert_eq!(message(Model::new(&bad, &[[0, 1, 2]])), "vertex 1 is not finite");
        bad[1][2] = 1e10;
        assert!(message(Model::new(&bad, &[[0, 1, 2]])).starts_with("vertices: vertex 1"));
        let model = Model::new(&v, &[[0, 1, 2]]).expect("valid");
        assert!(message(model.with_vertices(&v[..2])).starts_with("vertices: 2, expected 3"));
    }

    #[test]
    fn moving_vertices_apart_or_together_finds_the_edges_again() {
        let v = [
            [0.0; 3],
            [1.0, 0.0, 0.0],
            [0.0, 1.0, 0.0],
            [1.0, 1.0, 0.0],
            [1.0, 0.0, 0.0],
            [0.0, 1.0, 0.0],
        ];
        let faces = [[0, 1, 2], [4, 3, 5]];
        let model = Model::new(&v, &faces).expect("valid");
        assert_eq!(model.topology().edges.len(), 5);
        let mut apart = v;
        apart[4][0] = 1.1;
        let moved = model.with_vertices(&apart).expect("valid");
        assert_eq!(moved.topology().edges.len(), 6);
        let back = moved.with_vertices(&v).expect("valid");
        assert_eq!(back.topology().edges, model.topology().edges);
    }
}
