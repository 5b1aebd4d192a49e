//! A point set prepared for every metric that is a sum or a maximum over model points.

use std::sync::OnceLock;

use glam::{DMat3, DVec3};

use super::nearest::NearestVertex;
use crate::error::{Error, Result};

/// Points per block of the structure-of-arrays layouts.
pub(crate) const LANES: usize = 16;

/// Sixteen points, coordinate by coordinate, on cache-line boundaries.
#[derive(Debug, Clone, Copy)]
#[repr(C, align(64))]
pub(crate) struct Block {
    pub(crate) x: [f64; LANES],
    pub(crate) y: [f64; LANES],
    pub(crate) z: [f64; LANES],
}

/// Sixteen points with a count each; padding has count 0.
#[derive(Debug, Clone, Copy)]
#[repr(C, align(64))]
pub(crate) struct CountedBlock {
    pub(crate) points: Block,
    pub(crate) count: [f64; LANES],
}

/// Blocks whose points all occur equally often.
#[derive(Debug, Clone)]
pub(crate) struct Run {
    pub(crate) count: f64,
    pub(crate) blocks: Vec<Block>,
}

/// A non-empty set of model points in metres, prepared once and then scored against any number of
/// poses.
///
/// Points that agree bit for bit are stored once with their number of occurrences, so that every
/// mean is still the mean over *all* points given. Inside, coordinates are relative to the mean
/// and divided by a power of two, which no result shows.
#[derive(Debug)]
pub struct VertexSet {
    /// Number of points given.
    total: usize,
    /// Distinct points as given (metres, model frame) and how often each occurs.
    points: Vec<DVec3>,
    counts: Vec<u32>,
    /// A power of two; inside, one unit is so many metres.
    pub(crate) unit: f64,
    /// Mean of all points, in units.
    pub(crate) centre: DVec3,
    /// Largest absolute coordinate relative to the centre, in units.
    pub(crate) extent: f64,
    /// Mean of `q qᵀ` over all points, `q` relative to the centre, in square units.
    pub(crate) covariance: DMat3,
    pub(crate) runs: Vec<Run>,
    pub(crate) rest: Vec<CountedBlock>,
    /// All distinct points with their numbers: `runs` and `rest` in one.
    pub(crate) all: Vec<CountedBlock>,
    pub(crate) hull: Vec<Block>,
    nearest: OnceLock<NearestVertex>,
}

impl VertexSet {
    /// From points in metres, model frame. Every distinct point counts as a hull point.
    ///
    /// # Errors
    /// [`Error::NoPoints`] without points, [`Error::NonFiniteVertex`].
    pub fn new(points: &[DVec3]) -> Result<Self> {
        Self::build(points, None)
    }

    /// The same, with the indices of points among which the vertices of the convex hull are: a
    /// maximum over them is the maximum over all, so the metrics that are maxima become cheaper.
    ///
    /// # Errors
    /// As [`VertexSet::new`]; [`Error::Argument`] for an index out of range or no index at all.
    pub fn with_hull(points: &[DVec3], hull: &[u32]) -> Result<Self> {
        if hull.is_empty() && !points.is_empty() {
            return Err(Error::argument("hull", "at least one point is needed"));
        }
        if let Some(&k) = hull.iter().find(|&&k| k as usize >= points.len()) {
            let n = points.len();
            return Err(Error::argument("hull", format!("index {k} of {n} points")));
        }
        Self::build(points, Some(hull))
    }

    fn build(given: &[DVec3], hull: Option<&[u32]>) -> Result<Self> {
        if given.is_empty() {
            return Err(Error::NoPoints("model points"));
        }
        if let Some(vertex) = given.iter().position(|p| !p.is_finite()) {
            return Err(Error::NonFiniteVertex { vertex });
        }
        let (points, counts) = distinct(given);
        let largest = points.iter().fold(0.0_f64, |m, p| m.max(p.abs().max_element()));
        let unit = power_of_two_below(largest);
        let total = given.len() as f64;
        // Two passes: the second removes the rounding of the first sum.
        let mut centre = DVec3::ZERO;
        for _ in 0..2 {
            let mut sum = DVec3::ZERO;
            for (p, &n) in points.iter().zip(&counts) {
                sum += (*p / unit - centre) * f64::from(n);
            }
            centre += sum / total;
        }
        let centred: Vec<DVec3> = points.iter().map(|p| *p / unit - centre).collect();
        let extent = centred.iter().fold(0.0_f64, |m, q| m.max(q.abs().max_element()));
        let mut covariance = DMat3::ZERO;
        for (q, &n) in centred.iter().zip(&counts) {
            let scaled = *q * (f64::from(n) / total);
            covariance += DMat3::from_cols(scaled * q.x, scaled * q.y, scaled * q.z);
        }
        let hull = match hull {
            None => blocks(&centred),
            Some(indices) => {
                let corners = indices.iter().map(|&k| given[k as usize] / unit - centre);
                blocks(&corners.collect::<Vec<_>>())
            }
        };
        let (runs, rest) = by_count(&centred, &counts);
        let all = counted(&centred, &counts);
        Ok(Self {
            total: given.len(),
            points,
            counts,
            unit,
            centre,
            extent,
            covariance,
            runs,
            rest,
            all,
            hull,
            nearest: OnceLock::new(),
        })
    }

    /// How many points were given, repetitions included. Never 0.
    #[must_use]
    pub fn total(&self) -> usize {
        self.total
    }

    /// The distinct points in metres, model frame, in order of first appearance.
    #[must_use]
    pub fn distinct(&self) -> &[DVec3] {
        &self.points
    }

    /// How often each of [`VertexSet::distinct`] was given.
    #[must_use]
    pub fn counts(&self) -> &[u32] {
        &self.counts
    }

    /// Mean of all points given, in metres, model frame.
    #[must_use]
    pub fn mean(&self) -> DVec3 {
        self.centre * self.unit
    }

    /// The structure that answers which vertex is nearest; built on first use and kept.
    pub fn nearest(&self) -> &NearestVertex {
        self.nearest.get_or_init(|| {
            let centred: Vec<DVec3> =
                self.points.iter().map(|p| *p / self.unit - self.centre).collect();
            NearestVertex::new(&centred, &self.counts)
        })
    }
}

/// The largest power of two not above `x`; 1 for zero, the smallest normal number below that.
pub(crate) fn power_of_two_below(x: f64) -> f64 {
    if x == 0.0 {
        return 1.0;
    }
    f64::from_bits(x.to_bits() & 0x7ff0_0000_0000_0000).max(f64::MIN_POSITIVE)
}

/// Points that differ in some bit, in order of first appearance, and their numbers.
fn distinct(points: &[DVec3]) -> (Vec<DVec3>, Vec<u32>) {
    // Adding zero makes -0 a 0.
    let key = |k: u32| (points[k as usize] + DVec3::ZERO).to_array().map(f64::to_bits);
    let mut order: Vec<u32> = (0..points.len() as u32).collect();
    order.sort_unstable_by_key(|&k| (key(k), k));
    let mut groups: Vec<(u32, u32)> = Vec::with_capacity(points.len());
    let mut last = None;
    for k in order {
        if last == Some(key(k)) {
            if let Some(group) = groups.last_mut() {
                group.1 += 1;
            }
        } else {
            last = Some(key(k));
            groups.push((k, 1));
        }
    }
    groups.sort_unstable();
    groups.into_iter().map(|(k, n)| (points[k as usize] + DVec3::ZERO, n)).unzip()
}

fn block(points: &[DVec3]) -> Block {
    let at = |l: usize| points[l.min(points.len() - 1)];
    Block {
        x: std::array::from_fn(|l| at(l).x),
        y: std::array::from_fn(|l| at(l).y),
        z: std::array::from_fn(|l| at(l).z),
    }
}

/// Blocks of sixteen; the last is filled up with its last point.
pub(crate) fn blocks(points: &[DVec3]) -> Vec<Block> {
    points.chunks(LANES).map(block).collect()
}

/// Whole blocks by number of occurrences, which need no weight per point, and the rest with one.
fn by_count(points: &[DVec3], counts: &[u32]) -> (Vec<Run>, Vec<CountedBlock>) {
    let mut order: Vec<usize> = (0..points.len()).collect();
    order.sort_by_key(|&k| counts[k]);
    let (mut runs, mut rest) = (Vec::new(), Vec::new());
    for same in order.chunk_by(|&a, &b| counts[a] == counts[b]) {
        let (whole, left) = same.split_at(same.len() - same.len() % LANES);
        let whole: Vec<DVec3> = whole.iter().map(|&k| points[k]).collect();
        if !whole.is_empty() {
            runs.push(Run { count: f64::from(counts[same[0]]), blocks: blocks(&whole) });
        }
        rest.extend_from_slice(left);
    }
    let (points, counts): (Vec<_>, Vec<_>) = rest.iter().map(|&k| (points[k], counts[k])).unzip();
    (runs, counted(&points, &counts))
}

/// Blocks of sixteen; the last is filled up with its last point, zero times.
pub(crate) fn counted(points: &[DVec3], counts: &[u32]) -> Vec<CountedBlock> {
    points
        .chunks(LANES)
        .zip(counts.chunks(LANES))
        .map(|(points, counts)| CountedBlock {
            points: block(points),
            count: std::array::from_fn(|l| counts.get(l).map_or(0.0, |&n| f64::from(n))),
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn repetitions_are_counted_and_kept_in_the_mean() {
        let (a, b) = (DVec3::new(1.0, 0.0, 0.0), DVec3::new(0.0, 2.0, 0.0));
        let set = VertexSet::new(&[a, b, a, a, DVec3::new(-0.0, 2.0, 0.0)]).expect("points");
        assert_eq!(set.total(), 5);
        assert_eq!(set.distinct(), [a, b]);
        assert_eq!(set.counts(), [3, 2]);
        assert!(set.mean().distance(DVec3::new(0.6, 0.8, 0.0)) < 1e-15);
    }

    #[test]
    fn every_point_is_in_a_block_with_its_count() {
        let points: Vec<DVec3> = (0..100_u32)
            .flat_map(|k| vec![DVec3::splat(f64::from(k)); 1 + (k % 3) as usize])
            .collect();
        let set = VertexSet::new(&points).expect("points");
        let whole: f64 = set.runs.iter().map(|r| r.count * (LANES * r.blocks.len()) as f64).sum();
        let rest: f64 = set.rest.iter().flat_map(|b| b.count).sum();
        assert!((whole + rest - points.len() as f64).abs() < 1e-12);
        assert_eq!(set.runs.len(), 3);
    }

    #[test]
    fn empty_and_non_finite_sets_are_refused() {
        assert!(matches!(VertexSet::new(&[]), Err(Error::NoPoints(_))));
        let bad = [DVec3::ZERO, DVec3::new(0.0, f64::NAN, 0.0)];
        assert!(matches!(VertexSet::new(&bad), Err(Error::NonFiniteVertex { vertex: 1 })));
        assert!(VertexSet::with_hull(&[DVec3::ZERO], &[1]).is_err());
        assert!(VertexSet::with_hull(&[DVec3::ZERO], &[]).is_err());
        assert!(VertexSet::with_hull(&[DVec3::ZERO], &[0]).is_ok());
    }
}
