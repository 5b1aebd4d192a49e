//! Which faces share which edge.

use std::hash::BuildHasher;

use hashbrown::HashTable;

/// An edge between two welded vertices `a < b`, and up to two of the faces at it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Edge {
    /// The vertex of the smaller index.
    pub a: u32,
    /// The vertex of the larger index.
    pub b: u32,
    /// Faces at the edge as `2 * face + 1` where the face runs from `b` to `a`, `2 * face` where it
    /// runs from `a` to `b`; a missing one names the face after the last.
    pub faces: [u32; 2],
}

/// Edges of a mesh whose vertices at equal positions count as one.
#[derive(Debug, Clone, Default)]
pub struct Topology {
    /// For each vertex the first one at its position.
    pub representative: Vec<u32>,
    /// For each vertex its share of what happens to its position: 1 over the number of vertices
    /// there that a face names, 0 for a vertex that no face names.
    pub share: Vec<f64>,
    /// The vertices that get another gradient than their own: whose share is not 1, or that are not
    /// the first at their position. Last first.
    pub shared: Vec<u32>,
    /// The faces over representatives.
    pub faces: Vec<[u32; 3]>,
    /// Every edge once, in the order in which the faces name them; edges from a vertex to itself
    /// are left out.
    pub edges: Vec<Edge>,
    /// Third and further faces at an edge, in order: `(edge, coded face)`.
    pub more: Vec<(u32, u32)>,
}

impl Topology {
    /// From the keys of the vertices (equal keys are one vertex) and faces over them.
    ///
    /// # Panics
    /// If a face names a vertex that does not exist.
    #[must_use]
    pub fn new<K: std::hash::Hash + Eq>(keys: &[K], faces: &[[u32; 3]]) -> Self {
        Self::of_welded(weld(keys), faces)
    }

    /// The topology of the same faces over other vertices, found again only if others coincide.
    #[must_use]
    pub fn rewelded<K: std::hash::Hash + Eq>(&self, keys: &[K], faces: &[[u32; 3]]) -> Self {
        let representative = weld(keys);
        if representative == self.representative {
            self.clone()
        } else {
            Self::of_welded(representative, faces)
        }
    }

    fn of_welded(representative: Vec<u32>, faces: &[[u32; 3]]) -> Self {
        let mut share = vec![0.0; representative.len()];
        let mut copies = vec![0_u32; representative.len()];
        for &v in faces.as_flattened() {
            if std::mem::replace(&mut share[v as usize], 1.0) == 0.0 {
                copies[representative[v as usize] as usize] += 1;
            }
        }
        for (share, &first) in share.iter_mut().zip(&representative) {
            *share /= f64::from(copies[first as usize].max(1));
        }
        let faces: Vec<[u32; 3]> =
            faces.iter().map(|f| f.map(|v| representative[v as usize])).collect();
        let (edges, more) = edges(&faces);
        let alone = |k: u32| share[k as usize] == 1.0 && representative[k as usize] == k;
        let shared = (0..share.len() as u32).rev().filter(|&k| !alone(k)).collect();
        Self { representative, share, shared, faces, edges, more }
    }

    /// Vertices at one position move together: share what the first of them has got among all
    /// that a face names.
    pub(super) fn share(&self, gradient: &mut [f64]) {
        for &k in &self.shared {
            let k = k as usize;
            gradient[k] = gradient[self.representative[k] as usize] * self.share[k];
        }
    }
}

/// For each key the index of the first equal one.
fn weld<K: std::hash::Hash + Eq>(keys: &[K]) -> Vec<u32> {
    let state = foldhash::fast::FixedState::default();
    let mut table: HashTable<u32> = HashTable::with_capacity(keys.len());
    keys.iter()
        .enumerate()
        .map(|(k, key)| {
            *table
                .entry(
                    state.hash_one(key),
                    |&id| keys[id as usize] == *key,
                    |&id| state.hash_one(&keys[id as usize]),
                )
                .or_insert(k as u32)
                .get()
        })
        .collect()
}

fn edges(faces: &[[u32; 3]]) -> (Vec<Edge>, Vec<(u32, u32)>) {
    let state = foldhash::fast::FixedState::default();
    let none = 2 * faces.len() as u32;
    let mut table: HashTable<u32> = HashTable::with_capacity(faces.len() * 3 / 2);
    let mut edges: Vec<Edge> = Vec::with_capacity(faces.len() * 3 / 2);
    let mut more = Vec::new();
    for (f, face) in faces.iter().enumerate() {
        for k in 0..3 {
            let (from, to) = (face[k], face[(k + 1) % 3]);
            if from == to {
                continue;
            }
            let (a, b) = (from.min(to), from.max(to));
            let code = 2 * f as u32 + u32::from(from > to);
            let next = edges.len() as u32;
            let id = *table
                .entry(
                    state.hash_one((a, b)),
                    |&id| (edges[id as usize].a, edges[id as usize].b) == (a, b),
                    |&id| state.hash_one((edges[id as usize].a, edges[id as usize].b)),
                )
                .or_insert(next)
                .get();
            if id == next {
                edges.push(Edge { a, b, faces: [code, none] });
            } else if edges[id as usize].faces[1] == none {
                edges[id as usize].faces[1] = code;
            } else {
                more.push((id, code));
            }
        }
    }
    more.sort_unstable();
    (edges, more)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_edge_knows_its_faces_and_the_way_they_run() {
        let topology = Topology::new(&[0, 1, 2, 3], &[[0, 1, 2], [2, 1, 3]]);
        assert_eq!(topology.edges.len(), 5);
        let shared = topology.edges.iter().find(|e| (e.a, e.b) == (1, 2)).expect("there");
        assert_eq!(shared.faces, [0, 3]);
        assert_eq!(topology.edges.iter().filter(|e| e.faces[1] == 4).count(), 4);
    }

    #[test]
    fn what_the_first_vertex_at_a_position_gets_goes_to_those_that_faces_name() {
        // At each of three positions: one vertex, two, and three of which the first has no face.
        let keys = [1, 2, 3, 2, 3, 3, 4];
        for (faces, expected) in [
            (vec![[0, 1, 4], [0, 3, 5]], [8.0, 2.0, 0.0, 2.0, 1.0, 1.0, 0.0]),
            (vec![[0, 3, 5]], [8.0, 0.0, 0.0, 4.0, 0.0, 2.0, 0.0]),
            (vec![[0, 1, 2]], [8.0, 4.0, 2.0, 0.0, 0.0, 0.0, 0.0]),
        ] {
            let mut gradient = [8.0, 4.0, 2.0, 0.0, 0.0, 0.0, 0.0];
            Topology::new(&keys, &faces).share(&mut gradient);
            assert_eq!(gradient, expected, "{faces:?}");
        }
    }

    #[test]
    fn equal_keys_are_one_vertex_and_extra_faces_are_kept() {
        let topology =
            Topology::new(&[7, 8, 9, 7, 8, 1], &[[0, 1, 2], [3, 4, 2], [0, 4, 5], [0, 3, 1]]);
        assert_eq!(topology.representative, [0, 1, 2, 0, 1, 5]);
        assert_eq!(topology.share, [0.5, 0.5, 1.0, 0.5, 0.5, 1.0]);
        let shared = topology.edges.iter().position(|e| (e.a, e.b) == (0, 1)).expect("there");
        assert_eq!(topology.edges[shared].faces, [0, 2]);
        // The last face runs 0, 0, 1: once along the edge, once back.
        assert_eq!(topology.more, [(shared as u32, 4), (shared as u32, 6), (shared as u32, 7)]);
    }
}
