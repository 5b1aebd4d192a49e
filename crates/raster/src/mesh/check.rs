//! What is notable about a mesh, for a person to read before trusting scores on it.

use std::fmt;

use foldhash::fast::FixedState;
use hashbrown::{HashMap, HashSet};
use serde::Serialize;

use super::Mesh;

/// Counts and sizes of a [`Mesh`]; lengths are in the mesh's own unit.
///
/// Edges, components and duplicate faces are those after welding vertices at exactly equal
/// positions: many files give each corner its own vertex.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct MeshCheck {
    /// All vertices.
    pub vertices: usize,
    /// Different positions among them.
    pub distinct_positions: usize,
    /// Vertices at the position of an earlier one.
    pub duplicate_vertices: usize,
    /// Vertices no face refers to.
    pub unreferenced_vertices: usize,
    /// All faces.
    pub faces: usize,
    /// Faces of zero area: two corners at one position, or all three on a line.
    pub degenerate_faces: usize,
    /// Faces with the corners of an earlier one, in any order.
    pub duplicate_faces: usize,
    /// Edges of exactly one face.
    pub boundary_edges: usize,
    /// Edges of more than two faces.
    pub crowded_edges: usize,
    /// Every edge has exactly two faces, and there are faces.
    pub closed: bool,
    /// Sets of faces that share no position with another.
    pub components: usize,
    /// Size of the box along the axes.
    pub bbox_size: [f64; 3],
    /// Its diagonal.
    pub bbox_diagonal: f64,
    /// The largest distance between two vertices.
    pub diameter: f64,
    /// What the unit would be if the mesh were a drone.
    pub unit_guess: UnitGuess,
}

/// A guess at a mesh's unit from its diameter: a drone measures 0.05 to 2 m.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum UnitGuess {
    /// Diameter from 0.05 to 2.
    Metres,
    /// From 5 to 50: 0.05 to 0.5 m; in millimetres it would be too small.
    Centimetres,
    /// From 50 to 200, which is a large drone in centimetres or a small one in millimetres.
    CentimetresOrMillimetres,
    /// From 200 to 2000.
    Millimetres,
    /// Anything else: no drone in any of these units.
    Unknown,
}

impl UnitGuess {
    /// From a diameter in the unknown unit.
    #[must_use]
    pub fn from_diameter(diameter: f64) -> Self {
        match diameter {
            0.05..=2.0 => Self::Metres,
            5.0..50.0 => Self::Centimetres,
            50.0..=200.0 => Self::CentimetresOrMillimetres,
            200.0..=2000.0 => Self::Millimetres,
            _ => Self::Unknown,
        }
    }
}

impl fmt::Display for UnitGuess {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Metres => "metres",
            Self::Centimetres => "centimetres",
            Self::CentimetresOrMillimetres => "centimetres or millimetres",
            Self::Millimetres => "millimetres",
            Self::Unknown => "unknown",
        })
    }
}

/// Twice the area of a face is zero if below this share of its longest edge squared: the rounding
/// of coordinates.
const FLAT: f64 = 1e-12;

impl MeshCheck {
    pub(super) fn of(mesh: &Mesh) -> Self {
        let unique = mesh.unique_vertices();
        let mut referenced = vec![false; mesh.vertices().len()];
        let mut degenerate_faces = 0;
        let mut duplicate_faces = 0;
        let mut seen: HashSet<[u32; 3], FixedState> = HashSet::default();
        let mut edges: HashMap<(u32, u32), u32, FixedState> = HashMap::default();
        let mut sets = Sets::new(unique.positions.len());
        for face in mesh.faces() {
            for &v in face {
                referenced[v as usize] = true;
            }
            let [a, b, c] = face.map(|v| unique.of_vertex[v as usize]);
            sets.join(a, b);
            sets.join(b, c);
            degenerate_faces += usize::from(is_flat(mesh, *face));
            let mut sorted = [a, b, c];
            sorted.sort_unstable();
            duplicate_faces += usize::from(!seen.insert(sorted));
            // A face with two corners at one position has no edge between them.
            for (a, b) in [(a, b), (b, c), (c, a)] {
                if a != b {
                    *edges.entry((a.min(b), a.max(b))).or_insert(0) += 1;
                }
            }
        }
        let boundary_edges = edges.values().filter(|&&n| n == 1).count();
        let crowded_edges = edges.values().filter(|&&n| n > 2).count();
        let corner = |f: &[u32; 3]| unique.of_vertex[f[0] as usize];
        let roots: HashSet<u32, FixedState> =
            mesh.faces().iter().map(|f| sets.root(corner(f))).collect();
        let (lo, hi) = mesh.bounds();
        let diameter = mesh.diameter();
        Self {
            vertices: mesh.vertices().len(),
            distinct_positions: unique.positions.len(),
            duplicate_vertices: mesh.vertices().len() - unique.positions.len(),
            unreferenced_vertices: referenced.iter().filter(|&&r| !r).count(),
            faces: mesh.faces().len(),
            degenerate_faces,
            duplicate_faces,
            boundary_edges,
            crowded_edges,
            closed: boundary_edges == 0 && crowded_edges == 0 && !edges.is_empty(),
            components: roots.len(),
            bbox_size: (hi - lo).to_array(),
            bbox_diagonal: mesh.bbox_diagonal(),
            diameter,
            unit_guess: UnitGuess::from_diameter(diameter),
        }
    }
}

fn is_flat(mesh: &Mesh, face: [u32; 3]) -> bool {
    let [a, b, c] = face.map(|v| mesh.vertices()[v as usize]);
    let longest =
        (b - a).length_squared().max((c - b).length_squared()).max((a - c).length_squared());
    // Divided first, so that the products of tiny edges do not vanish.
    let unit = longest.sqrt();
    unit == 0.0 || ((b - a) / unit).cross((c - a) / unit).length() <= FLAT
}

/// Disjoint sets, joined by halving paths.
struct Sets(Vec<u32>);

impl Sets {
    fn new(n: usize) -> Self {
        Self((0..n as u32).collect())
    }

    fn root(&mut self, mut k: u32) -> u32 {
        while self.0[k as usize] != k {
            let up = self.0[k as usize];
            self.0[k as usize] = self.0[up as usize];
            k = up;
        }
        k
    }

    fn join(&mut self, a: u32, b: u32) {
        let (a, b) = (self.root(a), self.root(b));
        self.0[a.max(b) as usize] = a.min(b);
    }
}

impl fmt::Display for MeshCheck {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [x, y, z] = self.bbox_size;
        writeln!(
            f,
            "vertices    {} ({} distinct positions, {} duplicate, {} unreferenced)",
            self.vertices,
            self.distinct_positions,
            self.duplicate_vertices,
            self.unreferenced_vertices
        )?;
        writeln!(
            f,
            "faces       {} ({} degenerate, {} duplicate)",
            self.faces, self.degenerate_faces, self.duplicate_faces
        )?;
        writeln!(
            f,
            "closed      {} ({} boundary edges, {} edges of more than two faces)",
            if self.closed { "yes" } else { "no" },
            self.boundary_edges,
            self.crowded_edges
        )?;
        writeln!(f, "components  {}", self.components)?;
        writeln!(f, "box         {x:.6} x {y:.6} x {z:.6}, diagonal {:.6}", self.bbox_diagonal)?;
        writeln!(f, "diameter    {:.6}", self.diameter)?;
        write!(f, "unit        {} if it is a drone of 0.05 to 2 m", self.unit_guess)
    }
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;

    fn tetrahedron() -> (Vec<DVec3>, Vec<[u32; 3]>) {
        (
            vec![DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z],
            vec![[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]],
        )
    }

    #[test]
    fn a_tetrahedron_is_closed_and_of_one_piece() {
        let (v, f) = tetrahedron();
        let check = Mesh::new(v, f).expect("valid").check();
        assert!(check.closed);
        assert_eq!((check.components, check.boundary_edges, check.crowded_edges), (1, 0, 0));
        assert_eq!((check.degenerate_faces, check.duplicate_faces), (0, 0));
        assert_eq!(check.unit_guess, UnitGuess::Metres);
    }

    #[test]
    fn corners_of_their_own_are_welded() {
        let (v, f) = tetrahedron();
        let soup: Vec<DVec3> = f.iter().flatten().map(|&k| v[k as usize]).collect();
        let faces = (0..4).map(|k| [3 * k, 3 * k + 1, 3 * k + 2]).collect();
        let check = Mesh::new(soup, faces).expect("valid").check();
        assert!(check.closed);
        assert_eq!(
            (check.vertices, check.distinct_positions, check.duplicate_vertices),
            (12, 4, 8)
        );
    }

    #[test]
    fn every_defect_is_counted() {
        let (mut v, mut f) = tetrahedron();
        v.extend([DVec3::splat(9.0), DVec3::new(0.5, 0.0, 0.0), DVec3::Y]);
        f.remove(3); // three boundary edges: 12, 23, 31
        f.push([1, 0, 2]); // the first face again, turned over: edges 02, 21 and 10 get a third
        f.push([0, 5, 1]); // on a line: edges 05 and 51, and a fourth face at 01
        f.push([2, 6, 6]); // one position: no edge
        let check = Mesh::new(v, f).expect("valid").check();
        assert_eq!(check.unreferenced_vertices, 1);
        assert_eq!(check.duplicate_vertices, 1);
        assert_eq!((check.degenerate_faces, check.duplicate_faces), (2, 1));
        // 12 has two faces now; 13, 23, 05 and 51 one; 02 three, 01 four.
        assert_eq!((check.boundary_edges, check.crowded_edges), (4, 2));
        assert!(!check.closed);
        assert_eq!(check.components, 1);
    }

    #[test]
    fn points_without_faces_are_not_closed() {
        let check = Mesh::new(vec![DVec3::ZERO, DVec3::X * 653.0], vec![]).expect("valid").check();
        assert!(!check.closed);
        assert_eq!((check.components, check.unreferenced_vertices), (0, 2));
        assert_eq!(check.unit_guess, UnitGuess::Millimetres);
        let text = check.to_string();
        assert!(text.contains("2 distinct positions"), "{text}");
        assert!(text.ends_with("millimetres if it is a drone of 0.05 to 2 m"), "{text}");
        let json = serde_json::to_value(&check).expect("serialises");
        assert_eq!(json["unit_guess"], "millimetres");
    }

    #[test]
    fn the_unit_is_guessed_from_the_size_of_drones() {
        let guesses = [0.6, 87.0, 30.0, 653.0, 3.0, 0.0].map(UnitGuess::from_diameter);
        let names = guesses.map(|g| g.to_string());
        assert_eq!(
            names,
            [
                "metres",
                "centimetres or millimetres",
                "centimetres",
                "millimetres",
                "unknown",
                "unknown"
            ]
        );
    }
}
