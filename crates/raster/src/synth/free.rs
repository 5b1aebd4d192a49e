//! Free space of a scene, for one without anchors: points of a box that are far enough from the
//! scene's surface, and from one another.

use glam::DVec3;
use rayon::prelude::*;

use crate::Mesh;
use crate::error::{Error, Result};
use crate::random::{generator, unit};
use crate::threads;

/// Candidates that are tried for every point that is asked for, before giving up.
const TRIES: u64 = 1000;
/// Candidates looked at in parallel; of no influence on the result.
const BLOCK: u64 = 256;

/// What is asked of the points.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FreeSpace {
    /// Least corner of the box, metres.
    pub low: DVec3,
    /// Largest corner of the box, metres.
    pub high: DVec3,
    /// How many points.
    pub count: usize,
    /// Least distance from the surface, metres.
    pub clearance_m: f64,
    /// Least distance between two points, metres.
    pub spacing_m: f64,
    /// Of the draw.
    pub seed: u64,
}

/// Points in free space: candidate `k` is uniform in the box, drawn by [`generator`]`(seed, k)`, and
/// taken if it is far enough from the mesh and from all points before. Points outside of a closed
/// scene are as free as those inside: the box says where to look.
///
/// # Errors
/// [`Error::Argument`]: a box without extent, a distance that is negative or not finite, or fewer
/// points than asked for in 1000 candidates each.
pub fn free_space(mesh: Option<&Mesh>, space: &FreeSpace, threads: usize) -> Result<Vec<DVec3>> {
    let size = space.high - space.low;
    if !(size.is_finite() && size.min_element() >= 0.0) {
        let text =
            format!("{} to {}: expected finite corners, low below high", space.low, space.high);
        return Err(Error::argument("low, high", text));
    }
    for (name, value) in [("clearance_m", space.clearance_m), ("spacing_m", space.spacing_m)] {
        if !(value >= 0.0 && value.is_finite()) {
            return Err(Error::argument(name, format!("found {value}, expected 0 or more")));
        }
    }
    let candidate = |k: u64| {
        let mut rng = generator(space.seed, k);
        let [x, y, z] = [(); 3].map(|()| unit(&mut rng));
        space.low + size * DVec3::new(x, y, z)
    };
    let free = |p: DVec3| mesh.is_none_or(|m| clear(m, p, space.clearance_m));
    let mut found: Vec<DVec3> = Vec::with_capacity(space.count.min(1 << 16));
    let last = TRIES.saturating_mul(space.count as u64);
    let mut begin = 0;
    while found.len() < space.count && begin < last {
        let end = last.min(begin + BLOCK);
        let block: Vec<Option<DVec3>> = threads::install(threads, || {
            let some = |k| Some(candidate(k)).filter(|p| free(*p));
            (begin..end).into_par_iter().map(some).collect()
        })?;
        for p in block.into_iter().flatten() {
            let apart = found.iter().all(|q| q.distance(p) >= space.spacing_m);
            if apart && found.len() < space.count {
                found.push(p);
            }
        }
        begin = end;
    }
    if found.len() == space.count {
        return Ok(found);
    }
    Err(Error::argument(
        "count",
        format!(
            "only {} of {} points found in {last} tries, {} m from the surface and {} m apart; \
             expected a larger box or smaller distances",
            found.len(),
            space.count,
            space.clearance_m,
            space.spacing_m
        ),
    ))
}

/// Whether no triangle is nearer than `clearance`.
fn clear(mesh: &Mesh, p: DVec3, clearance: f64) -> bool {
    let (v, limit) = (mesh.vertices(), clearance * clearance);
    mesh.faces().iter().all(|face| {
        let [a, b, c] = face.map(|k| v[k as usize]);
        // The box of a triangle is most often far away.
        let outside = (a.min(b).min(c) - p).max(p - a.max(b).max(c)).max(DVec3::ZERO);
        outside.length_squared() >= limit || closest(p, a, b, c).distance_squared(p) >= limit
    })
}

/// The point of a triangle nearest to `p`. Ericson, "Real-Time Collision Detection", section 5.1.5.
fn closest(p: DVec3, a: DVec3, b: DVec3, c: DVec3) -> DVec3 {
    let (ab, ac, ap) = (b - a, c - a, p - a);
    let (d1, d2) = (ab.dot(ap), ac.dot(ap));
    if d1 <= 0.0 && d2 <= 0.0 {
        return a;
    }
    let bp = p - b;
    let (d3, d4) = (ab.dot(bp), ac.dot(bp));
    if d3 >= 0.0 && d4 <= d3 {
        return b;
    }
    let vc = d1 * d4 - d3 * d2;
    if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 {
        return a + ab * (d1 / (d1 - d3));
    }
    let cp = p - c;
    let (d5, d6) = (ab.dot(cp), ac.dot(cp));
    if d6 >= 0.0 && d5 <= d6 {
        return c;
    }
    let vb = d5 * d2 - d1 * d6;
    if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 {
        return a + ac * (d2 / (d2 - d6));
    }
    let va = d3 * d6 - d5 * d4;
    if va <= 0.0 && d4 >= d3 && d5 >= d6 {
        return b + (c - b) * ((d4 - d3) / ((d4 - d3) + (d5 - d6)));
    }
    let sum = va + vb + vc;
    a + ab * (vb / sum) + ac * (vc / sum)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// Two walls at x = 0 and x = 4, of 4 x 4 m.
    fn walls() -> Mesh {
        let corner = |x: f64, k: usize| {
            DVec3::new(x, 4.0 * f64::from(k as u32 & 1), 4.0 * f64::from(k as u32 >> 1))
        };
        let vertices = [0.0, 4.0].iter().flat_map(|&x| (0..4).map(move |k| corner(x, k))).collect();
        Mesh::new(vertices, vec![[0, 1, 2], [1, 3, 2], [4, 5, 6], [5, 7, 6]]).expect("sound")
    }

    fn asked() -> FreeSpace {
        FreeSpace {
            low: DVec3::new(-1.0, 0.0, 0.0),
            high: DVec3::splat(4.0),
            count: 40,
            clearance_m: 0.7,
            spacing_m: 0.4,
            seed: 3,
        }
    }

    #[test]
    fn points_keep_their_distances_whatever_the_threads() {
        let points = free_space(Some(&walls()), &asked(), 1).expect("room");
        assert_eq!(points, free_space(Some(&walls()), &asked(), 3).expect("room"));
        for (k, p) in points.iter().enumerate() {
            assert!(p.x.abs() >= 0.7 && (p.x - 4.0).abs() >= 0.7, "{p}");
            assert!(points[..k].iter().all(|q| q.distance(*p) >= 0.4));
        }
        // They are spread over the room, and on both sides of the wall.
        assert!(points.iter().any(|p| p.x < 0.0) && points.iter().any(|p| p.x > 3.0));
    }

    #[test]
    fn too_much_is_refused_with_the_count() {
        let tight = FreeSpace { spacing_m: 3.0, ..asked() };
        let error = free_space(None, &tight, 1).expect_err("refused").to_string();
        assert!(error.starts_with("count: only ") && error.contains("of 40 points"), "{error}");
        let bad = FreeSpace { low: DVec3::splat(5.0), ..asked() };
        assert!(
            free_space(None, &bad, 1).expect_err("refused").to_string().starts_with("low, high")
        );
        let bad = FreeSpace { clearance_m: f64::NAN, ..asked() };
        assert!(free_space(None, &bad, 1).expect_err("refused").to_string().starts_with("clear"));
    }

    proptest! {
        #[test]
        fn the_closest_point_is_closer_than_a_fine_grid_of_points(
            v in prop::array::uniform4(prop::array::uniform3(-2.0..2.0_f64)),
        ) {
            let [p, a, b, c] = v.map(DVec3::from_array);
            let found = closest(p, a, b, c).distance(p);
            let (mut best, n) = (f64::INFINITY, 60);
            for i in 0..=n {
                for j in 0..=n - i {
                    let (s, t) = (f64::from(i) / f64::from(n), f64::from(j) / f64::from(n));
                    best = best.min((a + (b - a) * s + (c - a) * t).distance(p));
                }
            }
            let step = (b - a).length().max((c - a).length()) / f64::from(n);
            prop_assert!(found <= best + 1e-9 && best <= found + 1.5 * step, "{found} {best}");
        }
    }
}
