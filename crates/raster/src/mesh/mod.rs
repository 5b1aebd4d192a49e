//! A triangle mesh over shared vertices, or a point set: checked when made, so never in doubt later.
//!
//! *All* vertices of a file stay, also those no face refers to and those at the position of
//! another: "the mean over the model's vertices" of ADD counts them. [`Mesh::unique_vertices`]
//! gives the distinct positions with weights, for the same mean at less work.

mod check;
mod hull;

use std::hash::BuildHasher;
use std::sync::OnceLock;

use glam::DVec3;
use hashbrown::HashTable;

pub use self::check::{MeshCheck, UnitGuess};
use crate::error::{Error, Result};

/// The largest coordinate a mesh may have: far beyond any object, and squares of distances do not
/// overflow.
pub const LARGEST_COORDINATE: f64 = 1e100;

/// Vertices and triangles, in the model frame; metres once [scaled](Mesh::scaled).
#[derive(Debug, Clone)]
pub struct Mesh {
    vertices: Vec<DVec3>,
    faces: Vec<[u32; 3]>,
    bounds: (DVec3, DVec3),
    unique: OnceLock<UniqueVertices>,
    hull: OnceLock<Vec<u32>>,
    diameter: OnceLock<f64>,
}

/// The distinct positions of a mesh, in the order of their first occurrence.
///
/// Two vertices share a position if their coordinates are equal as numbers: `-0.0` is `0.0`, and
/// nothing else is rounded.
#[derive(Debug, Clone, PartialEq)]
pub struct UniqueVertices {
    /// The positions.
    pub positions: Vec<DVec3>,
    /// The share of the mesh's vertices at each position; the sum is 1.
    pub weights: Vec<f64>,
    /// The first vertex at each position.
    pub first: Vec<u32>,
    /// For each vertex of the mesh, its place in `positions`.
    pub of_vertex: Vec<u32>,
}

impl Mesh {
    /// A mesh of these vertices and faces. No faces at all is a point set, and valid.
    ///
    /// # Errors
    /// [`Error::NoPoints`] without vertices, [`Error::NonFiniteVertex`], [`Error::FaceIndex`], and
    /// [`Error::Argument`] for coordinates above [`LARGEST_COORDINATE`] or more vertices than
    /// 32 bits count.
    pub fn new(vertices: Vec<DVec3>, faces: Vec<[u32; 3]>) -> Result<Self> {
        if u32::try_from(vertices.len()).is_err() {
            let message = format!("{} are more than 32 bits count", vertices.len());
            return Err(Error::argument("vertices", message));
        }
        let mut bounds = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        for (k, &p) in vertices.iter().enumerate() {
            if !p.is_finite() {
                return Err(Error::NonFiniteVertex { vertex: k });
            }
            if p.abs().max_element() > LARGEST_COORDINATE {
                let message = format!("vertex {k} is out of range (coordinates up to 1e100)");
                return Err(Error::argument("vertices", message));
            }
            bounds = (bounds.0.min(p), bounds.1.max(p));
        }
        if vertices.is_empty() {
            return Err(Error::NoPoints("mesh"));
        }
        for (k, face) in faces.iter().enumerate() {
            if let Some(&bad) = face.iter().find(|&&v| v as usize >= vertices.len()) {
                let vertices = vertices.len();
                return Err(Error::FaceIndex { face: k, vertex: bad.into(), vertices });
            }
        }
        Ok(Self {
            vertices,
            faces,
            bounds,
            unique: OnceLock::new(),
            hull: OnceLock::new(),
            diameter: OnceLock::new(),
        })
    }

    /// All vertices, in the order of the file.
    #[must_use]
    pub fn vertices(&self) -> &[DVec3] {
        &self.vertices
    }

    /// Triangles, as indices into [`vertices`](Self::vertices).
    #[must_use]
    pub fn faces(&self) -> &[[u32; 3]] {
        &self.faces
    }

    /// Smallest and largest corner of the box along the axes.
    #[must_use]
    pub fn bounds(&self) -> (DVec3, DVec3) {
        self.bounds
    }

    /// Length of the diagonal of that box.
    #[must_use]
    pub fn bbox_diagonal(&self) -> f64 {
        (self.bounds.1 - self.bounds.0).length()
    }

    /// The largest distance between two vertices, exactly; computed once.
    #[must_use]
    pub fn diameter(&self) -> f64 {
        *self.diameter.get_or_init(|| {
            let at = |&k: &u32| self.vertices[k as usize];
            hull::diameter(&self.hull_candidates().iter().map(at).collect::<Vec<_>>())
        })
    }

    /// Vertices, of distinct positions, among which are all vertices of the convex hull; computed
    /// once.
    ///
    /// The maximum of a convex function over the mesh's vertices, such as the largest distance
    /// between two poses of a vertex (MSSD), is attained on them.
    #[must_use]
    pub fn hull_candidates(&self) -> &[u32] {
        self.hull.get_or_init(|| {
            let unique = self.unique_vertices();
            let kept = hull::candidates(&unique.positions);
            kept.into_iter().map(|k| unique.first[k as usize]).collect()
        })
    }

    /// The distinct positions and how many vertices are at each; computed once.
    #[must_use]
    pub fn unique_vertices(&self) -> &UniqueVertices {
        self.unique.get_or_init(|| UniqueVertices::of(&self.vertices))
    }

    /// The mesh with its coordinates multiplied by `metres_per_unit`.
    ///
    /// # Errors
    /// [`Error::Argument`] unless the factor is finite and above zero and the result in range.
    pub fn scaled(self, metres_per_unit: f64) -> Result<Self> {
        if !(metres_per_unit.is_finite() && metres_per_unit > 0.0) {
            let message = format!("{metres_per_unit} is not a finite number above zero");
            return Err(Error::argument("metres_per_unit", message));
        }
        let vertices = self.vertices.iter().map(|p| p * metres_per_unit).collect();
        Self::new(vertices, self.faces)
    }

    /// What is notable about the mesh: size, duplicates, open edges.
    #[must_use]
    pub fn check(&self) -> MeshCheck {
        MeshCheck::of(self)
    }
}

impl UniqueVertices {
    fn of(vertices: &[DVec3]) -> Self {
        let state = foldhash::fast::FixedState::default();
        // Adding 0.0 turns -0.0 into 0.0 and changes nothing else.
        let key = |p: DVec3| (p + DVec3::ZERO).to_array().map(f64::to_bits);
        let mut table: HashTable<u32> = HashTable::new();
        let mut positions: Vec<DVec3> = Vec::new();
        let (mut first, mut count) = (Vec::new(), Vec::<u32>::new());
        let mut of_vertex = Vec::with_capacity(vertices.len());
        for (k, &p) in vertices.iter().enumerate() {
            let wanted = key(p);
            let slot = table.entry(
                state.hash_one(wanted),
                |&id| key(positions[id as usize]) == wanted,
                |&id| state.hash_one(key(positions[id as usize])),
            );
            let next = positions.len() as u32;
            let id = *slot.or_insert(next).get();
            if id == next {
                positions.push(p);
                first.push(k as u32);
                count.push(0);
            }
            count[id as usize] += 1;
            of_vertex.push(id);
        }
        let total = vertices.len() as f64;
        let weights = count.into_iter().map(|c| f64::from(c) / total).collect();
        Self { positions, weights, first, of_vertex }
    }
}

#[cfg(test)]
#[expect(clippy::float_cmp, reason = "that results are exact is what is tested")]
mod tests {
    use super::*;

    fn square() -> Mesh {
        let v = [[0.0, 0.0, 0.0], [3.0, 0.0, 0.0], [3.0, 4.0, 0.0], [0.0, 4.0, 0.0]];
        let vertices = v.map(DVec3::from_array).to_vec();
        Mesh::new(vertices, vec![[0, 1, 2], [0, 2, 3]]).expect("valid")
    }

    #[test]
    fn a_square_has_its_size() {
        let mesh = square();
        assert_eq!(mesh.bounds(), (DVec3::ZERO, DVec3::new(3.0, 4.0, 0.0)));
        assert_eq!((mesh.bbox_diagonal(), mesh.diameter()), (5.0, 5.0));
        assert_eq!(mesh.hull_candidates(), [0, 1, 2, 3]);
    }

    #[test]
    fn what_is_no_mesh_is_refused() {
        assert!(matches!(Mesh::new(vec![], vec![]), Err(Error::NoPoints(_))));
        let nan = vec![DVec3::ZERO, DVec3::new(0.0, f64::NAN, 0.0)];
        assert!(matches!(Mesh::new(nan, vec![]), Err(Error::NonFiniteVertex { vertex: 1 })));
        let text =
            Mesh::new(vec![DVec3::ZERO], vec![[0, 0, 0], [0, 1, 0]]).unwrap_err().to_string();
        assert_eq!(text, "face 1 refers to vertex 1, but the mesh has 1 vertices");
        assert!(Mesh::new(vec![DVec3::splat(1e200)], vec![]).is_err());
        assert!(
            Mesh::new(vec![DVec3::splat(1e100), DVec3::ZERO], vec![]).unwrap().diameter() > 1e100
        );
    }

    #[test]
    fn equal_positions_share_a_weight_and_minus_zero_is_zero() {
        let v = [[0.0, 1.0, 0.0], [2.0, 0.0, 0.0], [-0.0, 1.0, -0.0], [2.0, 1e-300, 0.0]];
        let mesh = Mesh::new(v.map(DVec3::from_array).to_vec(), vec![]).expect("valid");
        let unique = mesh.unique_vertices();
        assert_eq!(unique.weights, [0.5, 0.25, 0.25]);
        assert_eq!(unique.first, [0, 1, 3]);
        assert_eq!(unique.of_vertex, [0, 1, 0, 2]);
        assert_eq!(unique.positions[1], DVec3::new(2.0, 0.0, 0.0));
        assert_eq!(mesh.vertices().len(), 4);
    }

    #[test]
    fn scaling_scales_what_was_cached() {
        let mesh = square();
        assert_eq!(mesh.diameter(), 5.0);
        let mesh = mesh.scaled(0.01).expect("a good factor");
        assert!((mesh.diameter() - 0.05).abs() < 1e-16);
        assert!((mesh.bbox_diagonal() - 0.05).abs() < 1e-16);
        for bad in [0.0, -1.0, f64::NAN, f64::INFINITY, 1e101] {
            assert!(square().scaled(bad).is_err(), "{bad}");
        }
    }
}
