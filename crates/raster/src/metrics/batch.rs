//! Many pairs of poses at once, in parallel.
//!
//! The pairs are shared out over rayon's current pool; each is scored as by the function of the
//! same name, so results are the same bits for any number of threads.

use rayon::prelude::*;

use super::mspd::{ProjectionErrors, projection_errors};
use super::vertices::VertexSet;
use super::{add, adds, mssd};
use crate::camera::Intrinsics;
use crate::error::{Error, Result};
use crate::pose::Pose;

/// Pairs per piece of work: some tens of microseconds.
const PIECE: usize = 64;

/// Ahead of the work: the two lists have to be equally long.
fn same_length(est: &[Pose], gt: &[Pose]) -> Result<()> {
    if est.len() == gt.len() {
        return Ok(());
    }
    let message = format!("{} estimates for {} true poses", est.len(), gt.len());
    Err(Error::argument("est", message))
}

/// [`add::add`] of each pair, in metres.
///
/// # Errors
/// [`Error::Argument`] if the lists are not equally long.
pub fn add_batch(set: &VertexSet, est: &[Pose], gt: &[Pose]) -> Result<Vec<f64>> {
    same_length(est, gt)?;
    let mut out = vec![0.0; est.len()];
    out.par_chunks_mut(PIECE).zip(est.par_chunks(PIECE)).zip(gt.par_chunks(PIECE)).for_each(
        |((out, est), gt)| {
            for ((out, est), gt) in out.chunks_mut(2).zip(est.chunks(2)).zip(gt.chunks(2)) {
                if let ([first, second], [e1, e2], [g1, g2]) = (&mut *out, est, gt) {
                    [*first, *second] = add::add_two(set, [(e1, g1), (e2, g2)]);
                } else {
                    out[0] = add(set, &est[0], &gt[0]);
                }
            }
        },
    );
    Ok(out)
}

/// [`add::add_below`] of each pair.
///
/// # Errors
/// [`Error::Argument`] if the lists are not equally long.
pub fn add_below_batch(
    set: &VertexSet,
    est: &[Pose],
    gt: &[Pose],
    threshold: f64,
) -> Result<Vec<bool>> {
    each(est, gt, |est, gt| add::add_below(set, est, gt, threshold))
}

/// [`adds::adds`] of each pair, in metres.
///
/// # Errors
/// [`Error::Argument`] if the lists are not equally long.
pub fn adds_batch(set: &VertexSet, est: &[Pose], gt: &[Pose]) -> Result<Vec<f64>> {
    if !est.is_empty() {
        // Built here, so that no worker waits for another.
        set.nearest();
    }
    each(est, gt, |est, gt| adds(set, est, gt))
}

/// [`mssd::mssd`] of each pair, in metres.
///
/// # Errors
/// [`Error::Argument`] if the lists are not equally long.
pub fn mssd_batch(
    set: &VertexSet,
    est: &[Pose],
    gt: &[Pose],
    symmetries: &[Pose],
) -> Result<Vec<f64>> {
    each(est, gt, |est, gt| mssd(set, est, gt, symmetries))
}

/// [`projection_errors`] of each pair, in pixels.
///
/// # Errors
/// [`Error::Argument`] if the lists are not equally long.
pub fn projection_batch(
    set: &VertexSet,
    est: &[Pose],
    gt: &[Pose],
    symmetries: &[Pose],
    camera: &Intrinsics,
) -> Result<Vec<ProjectionErrors>> {
    each(est, gt, |est, gt| projection_errors(set, est, gt, symmetries, camera))
}

fn each<T: Send>(
    est: &[Pose],
    gt: &[Pose],
    score: impl Fn(&Pose, &Pose) -> T + Sync,
) -> Result<Vec<T>> {
    same_length(est, gt)?;
    let pairs = est.par_iter().zip(gt).with_min_len(8);
    Ok(pairs.map(|(est, gt)| score(est, gt)).collect())
}

#[cfg(test)]
mod tests {
    use glam::{DQuat, DVec3};

    use super::*;
    use crate::rotation::from_axis_angle;

    #[test]
    fn any_number_of_threads_gives_the_same_bits() {
        let wave = |k: u32| {
            let k = f64::from(k);
            DVec3::new((k * 0.37).sin(), (k * 0.71).cos(), (k * 1.3).sin()) * 0.3
        };
        let points: Vec<DVec3> = (0..700).map(|k| wave(k % 450)).collect();
        let set = VertexSet::new(&points).expect("points");
        let gt: Vec<Pose> = (0..301)
            .map(|k| {
                let turn = from_axis_angle((wave(k) * 9.0).to_array()).expect("finite");
                Pose::new(turn, wave(k + 1) + DVec3::Z * 2.0)
            })
            .collect();
        let mut est: Vec<Pose> = gt
            .iter()
            .zip(0..)
            .map(|(gt, k)| {
                let turn = from_axis_angle((wave(k + 5) * 0.3).to_array()).expect("finite");
                gt.compose(&Pose::new(turn, wave(k + 9) * 0.2))
            })
            .collect();
        est[7] = gt[7];
        let half = Pose::new(DQuat::from_xyzw(0.0, 0.0, 1.0, 0.0), DVec3::ZERO);
        let camera = Intrinsics::new(500.0, 500.0, 160.0, 120.0).expect("valid");
        let all = || {
            (
                add_batch(&set, &est, &gt).expect("equally long"),
                adds_batch(&set, &est, &gt).expect("equally long"),
                mssd_batch(&set, &est, &gt, &[half]).expect("equally long"),
                projection_batch(&set, &est, &gt, &[half], &camera).expect("equally long"),
                add_below_batch(&set, &est, &gt, 0.05).expect("equally long"),
            )
        };
        let single: Vec<f64> = est.iter().zip(&gt).map(|(est, gt)| add(&set, est, gt)).collect();
        let first = all();
        assert_eq!(first.0, single);
        assert!(first.0[7] == 0.0 && first.1[7] == 0.0 && first.2[7] == 0.0);
        for (below, add) in first.4.iter().zip(&first.0) {
            assert_eq!(*below, *add < 0.05);
        }
        for threads in [1, 2, 7] {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("pool");
            assert_eq!(pool.install(all), first, "{threads} threads");
        }
        assert!(add_batch(&set, &est[1..], &gt).is_err());
    }
}
