//! Which vertices can be extreme, and from them the exact diameter.
//!
//! The convex hull is only used to discard vertices that are certainly not on it, so it may be
//! that of coarsely rounded points. Rounded to integers of 19 bits, every sign the construction
//! asks for is computed without error in 64 bits, so it has no tolerance, cannot run into a
//! contradiction and never fails, unlike a hull in floating point (parry3d's is in `f32`, and
//! asserts in places); it is the tests' oracle.

use foldhash::fast::FixedState;
use glam::DVec3;
use hashbrown::HashSet;

/// Steps of the integer grid to half of the largest extent. Differences of coordinates stay below
/// `2^20`, components of cross products below `2^41`, triple products below `3 * 2^60`.
const GRID: f64 = (1_i64 << 18) as f64;

/// How deep, in halves of the largest extent, a vertex must be inside the hull of rounded points
/// to be discarded.
///
/// Rounding moves a point by at most `e = sqrt(3) / 2 / GRID`, 3.3e-6. If a point `p` is deeper
/// than `e` below every facet, then in every direction `u` the rounded points reach further than
/// `u·p + e`, so the points themselves reach further than `u·p`: `p` is inside of their hull and no
/// vertex of it. The rest of the margin is for the rounding of `u·p`, which is around 1e-15.
const MARGIN: f64 = 1e-5;

/// Up to so many points, all go into the hull; it takes a time up to proportional to the square
/// (0.1 s). Above, those that are extreme in some directions decide first which others may matter.
const DIRECT: usize = 4000;

/// Number of those directions.
const DIRECTIONS: usize = 400;

/// Indices, ascending, of points among which are all vertices of the convex hull.
///
/// Points in a plane or on a line are all kept, and so are most of those on a sphere.
pub(super) fn candidates(points: &[DVec3]) -> Vec<u32> {
    let mut kept: Vec<u32> = (0..points.len() as u32).collect();
    let lo = points.iter().fold(DVec3::INFINITY, |m, &p| m.min(p));
    let hi = points.iter().fold(DVec3::NEG_INFINITY, |m, &p| m.max(p));
    let half = 0.5 * (hi - lo).max_element();
    if points.len() < 5 || half < f64::MIN_POSITIVE {
        return kept;
    }
    // The difference is exact where it matters, far from the origin (Sterbenz), whatever the
    // rounding of the centre.
    let centre = lo + 0.5 * (hi - lo);
    let points: Vec<DVec3> = points.iter().map(|&p| (p - centre) / half).collect();
    let grid: Vec<Cell> =
        points.iter().map(|p| (p * GRID).round().to_array().map(|c| c as i64)).collect();
    if points.len() > DIRECT {
        prune(&mut kept, &points, &hull(&grid, &extremes(&points)));
    }
    if kept.len() <= DIRECT {
        let all = kept.clone();
        prune(&mut kept, &points, &hull(&grid, &all));
    }
    kept
}

/// The largest distance between two of the points; 0 for one.
///
/// In the order of falling distance from the centre, for each point only those matter that are far
/// enough out to beat the best pair so far.
pub(super) fn diameter(points: &[DVec3]) -> f64 {
    let lo = points.iter().fold(DVec3::INFINITY, |m, &p| m.min(p));
    let hi = points.iter().fold(DVec3::NEG_INFINITY, |m, &p| m.max(p));
    let centre = lo + 0.5 * (hi - lo);
    let mut order: Vec<(f64, DVec3)> = points.iter().map(|&p| (p.distance(centre), p)).collect();
    order.sort_unstable_by(|a, b| b.0.total_cmp(&a.0));
    // One slice for each coordinate: the inner loop runs in vector registers.
    let [x, y, z] = [0, 1, 2].map(|c| order.iter().map(|(_, p)| p[c]).collect::<Vec<f64>>());
    let mut best = 0.0_f64; // squared
    for (i, &(radius, p)) in order.iter().enumerate() {
        let needed = best.sqrt() * (1.0 - 1e-12) - radius; // safe against every rounding here
        let end = order.partition_point(|&(r, _)| r >= needed);
        if end <= i {
            break;
        }
        for ((&x, &y), &z) in x[i..end].iter().zip(&y[i..end]).zip(&z[i..end]) {
            let (x, y, z) = (x - p.x, y - p.y, z - p.z);
            let squared = x * x + y * y + z * z;
            best = if squared > best { squared } else { best };
        }
    }
    best.sqrt()
}

/// A point of the integer grid.
type Cell = [i64; 3];

/// A triangle of the hull: `normal · x > offset` outside.
#[derive(Debug, Clone, Copy)]
struct Facet {
    corners: [u32; 3],
    normal: Cell,
    offset: i64,
}

impl Facet {
    fn new(grid: &[Cell], corners: [u32; 3]) -> Self {
        let [a, b, c] = corners.map(|k| grid[k as usize]);
        let normal = cross(minus(b, a), minus(c, a));
        Self { corners, normal, offset: dot(normal, a) }
    }

    fn sees(&self, p: Cell) -> bool {
        dot(self.normal, p) > self.offset
    }
}

fn minus(a: Cell, b: Cell) -> Cell {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

fn cross(a: Cell, b: Cell) -> Cell {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

fn dot(a: Cell, b: Cell) -> i64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Convex hull of some cells, one cell after the other; empty if they are in one plane.
///
/// A cell sees the facets it is strictly outside of. Seen from it they fill a convex outline, so
/// they are a disc, and its border is joined to the cell. The cell is on no line through a border
/// edge, or it would be in the plane of the facet it sees there: no facet is degenerate.
fn hull(grid: &[Cell], chosen: &[u32]) -> Vec<Facet> {
    let Some([a, b, c, d]) = tetrahedron(grid, chosen) else { return Vec::new() };
    let mut facets: Vec<Facet> =
        [[a, b, c], [a, c, d], [a, d, b], [b, d, c]].map(|f| Facet::new(grid, f)).to_vec();
    let mut edges: HashSet<(u32, u32), FixedState> = HashSet::default();
    for &k in chosen {
        let p = grid[k as usize];
        edges.clear();
        facets.retain(|f| {
            let seen = f.sees(p);
            if seen {
                let [a, b, c] = f.corners;
                edges.extend([(a, b), (b, c), (c, a)]);
            }
            !seen
        });
        let border = edges.iter().filter(|&&(a, b)| !edges.contains(&(b, a)));
        facets.extend(border.map(|&(a, b)| Facet::new(grid, [a, b, k])));
    }
    facets
}

/// Four of the chosen cells that are not in one plane, the first three seen counterclockwise from
/// outside.
fn tetrahedron(grid: &[Cell], chosen: &[u32]) -> Option<[u32; 4]> {
    let at = |k: u32| grid[k as usize];
    let &a = chosen.first()?;
    let furthest = |measure: &dyn Fn(u32) -> f64| {
        let best = chosen.iter().copied().max_by(|&j, &k| measure(j).total_cmp(&measure(k)))?;
        (measure(best) > 0.0).then_some(best)
    };
    let squared = |v: Cell| v.iter().map(|&c| c as f64 * c as f64).sum::<f64>();
    let b = furthest(&|k| squared(minus(at(k), at(a))))?;
    let c = furthest(&|k| squared(cross(minus(at(b), at(a)), minus(at(k), at(a)))))?;
    let base = Facet::new(grid, [a, b, c]);
    let d = furthest(&|k| (dot(base.normal, at(k)) - base.offset).abs() as f64)?;
    Some(if base.sees(at(d)) { [a, c, b, d] } else { [a, b, c, d] })
}

/// For each of some directions spread evenly over the sphere, the point furthest in it.
fn extremes(points: &[DVec3]) -> Vec<u32> {
    let golden = std::f64::consts::PI * (3.0 - 5.0_f64.sqrt());
    let mut found: Vec<u32> = (0..DIRECTIONS)
        .map(|k| {
            let z = 1.0 - (2 * k + 1) as f64 / DIRECTIONS as f64;
            let (sin, cos) = (golden * k as f64).sin_cos();
            let rho = (1.0 - z * z).sqrt();
            let direction = DVec3::new(rho * cos, rho * sin, z);
            let mut best = (f64::NEG_INFINITY, 0);
            for (j, p) in points.iter().enumerate() {
                let reach = direction.dot(*p);
                if reach > best.0 {
                    best = (reach, j as u32);
                }
            }
            best.1
        })
        .collect();
    found.sort_unstable();
    found.dedup();
    found
}

/// Drops the points that are deeper than [`MARGIN`] below all facets.
fn prune(kept: &mut Vec<u32>, points: &[DVec3], facets: &[Facet]) {
    let planes: Vec<(DVec3, f64)> = facets
        .iter()
        .map(|f| {
            // Exact up to the normalisation: the integers are below 2^53.
            let normal = DVec3::from_array(f.normal.map(|c| c as f64));
            (normal / normal.length(), f.offset as f64 / GRID / normal.length())
        })
        .collect();
    if planes.is_empty() {
        return;
    }
    // Neighbours in the file tend to be near the same facet, so begin with the last that decided.
    let mut last = 0;
    kept.retain(|&k| {
        let near = |&(n, d): &(DVec3, f64)| n.dot(points[k as usize]) - d >= -MARGIN;
        near(&planes[last])
            || planes.iter().position(near).is_some_and(|facet| {
                last = facet;
                true
            })
    });
}

#[cfg(test)]
#[expect(clippy::float_cmp, reason = "that results are exact is what is tested")]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::Mesh;

    fn brute(points: &[DVec3]) -> f64 {
        let mut best = 0.0_f64;
        for (k, p) in points.iter().enumerate() {
            for q in &points[k..] {
                best = best.max(p.distance_squared(*q));
            }
        }
        best.sqrt()
    }

    /// Vertices of the hull by parry, as positions.
    fn parry(points: &[DVec3]) -> Option<Vec<DVec3>> {
        let points: Vec<_> = points.iter().map(|p| p.as_vec3()).collect();
        let (vertices, _) = parry3d::transformation::try_convex_hull(&points).ok()?;
        Some(vertices.iter().map(|p| p.as_dvec3()).collect())
    }

    fn sphere(n: usize) -> Vec<DVec3> {
        (0..n)
            .map(|k| {
                let z = 1.0 - (2 * k + 1) as f64 / n as f64;
                let (sin, cos) = (2.4 * k as f64).sin_cos();
                let rho = (1.0 - z * z).sqrt();
                DVec3::new(rho * cos, rho * sin, z)
            })
            .collect()
    }

    fn pruned(points: &[DVec3]) -> Vec<DVec3> {
        candidates(points).into_iter().map(|k| points[k as usize]).collect()
    }

    fn holds(points: &[DVec3]) {
        assert_eq!(diameter(&pruned(points)), brute(points));
    }

    #[test]
    fn points_lines_and_planes_keep_their_diameter() {
        holds(&[DVec3::ONE]);
        holds(&[DVec3::ONE; 7]);
        holds(&[DVec3::ZERO, DVec3::new(3.0, 4.0, 12.0)]);
        assert_eq!(diameter(&[DVec3::ZERO, DVec3::new(3.0, 4.0, 12.0)]), 13.0);
        holds(&(0..500).map(|k| DVec3::new(0.1, 0.2, 0.3) * f64::from(k)).collect::<Vec<_>>());
        let grid = |k: i32| DVec3::new(f64::from(k % 20), f64::from(k / 20), 7.0);
        holds(&(0..400).map(grid).collect::<Vec<_>>());
        let tilted = |k: i32| DVec3::new(f64::from(k % 20), f64::from(k / 20), f64::from(k % 20));
        holds(&(0..400).map(tilted).collect::<Vec<_>>());
        let thin = |k: i32| grid(k) + DVec3::Z * 1e-7 * f64::from(k % 3);
        holds(&(0..400).map(thin).collect::<Vec<_>>());
    }

    #[test]
    fn a_cube_is_left_with_its_corners_and_what_is_on_its_faces() {
        let cell = |k: i32| DVec3::new(f64::from(k % 9), f64::from(k / 9 % 9), f64::from(k / 81));
        let cube: Vec<_> = (0..729).map(cell).collect();
        assert_eq!(candidates(&cube).len(), 729 - 343);
        assert_eq!(diameter(&pruned(&cube)), 192.0_f64.sqrt());
    }

    #[test]
    fn an_object_far_from_the_origin_is_as_good_as_one_near() {
        for far in [1e3, 1e6, 1e12] {
            let points: Vec<_> = sphere(500).iter().map(|p| (p + far) * 0.3).collect();
            holds(&points);
        }
        holds(&sphere(300).iter().map(|p| p * 1e90).collect::<Vec<_>>());
        holds(&sphere(300).iter().map(|p| p * 1e-90).collect::<Vec<_>>());
    }

    #[test]
    fn inner_points_of_a_large_cloud_are_discarded() {
        let shells =
            [1.0, 0.98, 0.5].map(|r| sphere(3000).iter().map(|p| p * r).collect::<Vec<_>>());
        let kept = candidates(&shells.concat());
        assert!(kept.len() <= 3000, "{}", kept.len());
        assert_eq!(kept, candidates(&shells[0]));
    }

    #[test]
    fn a_sphere_of_20_000_vertices_has_its_diameter() {
        // All of them are corners of the hull: `cargo bench --bench metrics` has the time.
        let mesh = Mesh::new(sphere(20_000), vec![]).expect("valid");
        let diameter = mesh.diameter();
        assert!(diameter <= 2.0 && diameter > 1.9999, "{diameter}");
    }

    #[test]
    fn no_vertex_of_parry_s_hull_is_missing() {
        for n in [10, 100, 1000, 5000] {
            let points: Vec<DVec3> = sphere(n)
                .iter()
                .enumerate()
                .map(|(k, p)| (p * (0.5 + 0.5 * (k as f64).sin().abs())).as_vec3().as_dvec3())
                .collect();
            let kept = pruned(&points);
            let missing =
                parry(&points).expect("a hull").iter().filter(|p| !kept.contains(p)).count();
            assert_eq!(missing, 0, "of {n}");
        }
    }

    /// Coordinates from a coarse grid (collinear and coplanar points) or anywhere.
    fn cloud() -> impl Strategy<Value = Vec<DVec3>> {
        let coarse = (0..4_i32).prop_map(f64::from);
        let coordinate = prop_oneof![2 => coarse, 1 => -3.0..3.0_f64, 1 => -1e-5..1e-5_f64];
        let point = prop::array::uniform3(coordinate).prop_map(DVec3::from_array);
        prop::collection::vec(point, 1..80)
    }

    proptest! {
        #[test]
        fn the_diameter_is_that_of_brute_force(
            points in cloud(),
            scale in prop::array::uniform3(prop_oneof![Just(1.0), Just(0.0), Just(1e-6), Just(1e3)]),
            offset in prop_oneof![Just(0.0), Just(1e4), Just(-1e9)],
        ) {
            let points: Vec<_> =
                points.iter().map(|p| p * DVec3::from_array(scale) + offset).collect();
            prop_assert_eq!(diameter(&pruned(&points)), brute(&points));
        }

        #[test]
        fn the_candidates_reach_as_far_in_every_direction(
            points in cloud(), direction in prop::array::uniform3(-1.0..1.0_f64),
        ) {
            let direction = DVec3::from_array(direction);
            let reach = |p: &[DVec3]| p.iter().map(|p| p.dot(direction)).fold(f64::MIN, f64::max);
            prop_assert_eq!(reach(&pruned(&points)), reach(&points));
        }

        #[test]
        fn the_integer_hull_holds_all_its_points(points in cloud()) {
            let cells: Vec<Cell> = points.iter().map(|p| p.to_array().map(|c| (c * 1e4) as i64)).collect();
            let chosen: Vec<u32> = (0..cells.len() as u32).collect();
            let facets = hull(&cells, &chosen);
            prop_assert!(facets.iter().all(|f| f.normal != [0; 3]));
            prop_assert!(facets.iter().all(|f| !cells.iter().any(|&p| f.sees(p))));
            // Closed, and of one piece: every edge twice, and Euler's formula.
            let mut corners: Vec<u32> = facets.iter().flat_map(|f| f.corners).collect();
            corners.sort_unstable();
            corners.dedup();
            prop_assert!(facets.is_empty() || facets.len() == 2 * corners.len() - 4);
        }
    }
}
