//! Errors of every matched sample, in parallel; the result does not depend on the threads.

use rayon::prelude::*;

use crate::eval::matching::bop_groups;
use crate::eval::objects::{Cameras, MeshModel, Object, Objects};
use crate::eval::request::{ADDS_LIMIT, Choice, Progress, Request};
use crate::eval::{Bop, Samples, Up, viewing_angles};
use crate::io::table::PoseTable;
use crate::metrics;
use crate::pose::Pose;
use crate::rotation;

/// Samples a task works on between two progress reports.
const CHUNK: usize = 256;

/// Writes the errors of some pairs.
type Stage<'a> = dyn Fn(&mut [f64], &[(u32, u32)]) + Sync + 'a;

/// The tables and what is known of the objects.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Scene<'a> {
    pub(crate) predictions: &'a PoseTable,
    pub(crate) gt: &'a PoseTable,
    pub(crate) objects: &'a Objects,
    pub(crate) cameras: &'a Cameras,
}

impl<'a> Scene<'a> {
    /// Estimate and ground truth of a pair.
    fn poses(&self, (g, p): (u32, u32)) -> (&'a Pose, &'a Pose) {
        (&self.predictions.poses[p as usize], &self.gt.poses[g as usize])
    }

    /// The object of a pair.
    pub(crate) fn object(&self, (g, p): (u32, u32)) -> &'a Object {
        let of = |table: &PoseTable, row: u32| Some(table.targets.as_ref()?[row as usize].object);
        self.objects.get(of(self.gt, g).or_else(|| of(self.predictions, p)))
    }

    /// No table says which object or image a row is about.
    fn is_plain(&self) -> bool {
        self.gt.targets.is_none() && self.predictions.targets.is_none()
    }

    /// The mesh of two pairs, if it is the same.
    fn common_mesh(&self, p: (u32, u32), q: (u32, u32)) -> Option<&'a MeshModel> {
        let mesh = self.object(p).mesh.as_deref()?;
        self.object(q).mesh.as_deref().filter(|&other| std::ptr::eq(mesh, other))
    }

    fn camera(&self, (g, p): (u32, u32)) -> Option<&'a crate::camera::Intrinsics> {
        let of = |table: &PoseTable, row: u32| Some(table.targets.as_ref()?[row as usize].image);
        self.cameras.get(of(self.gt, g).or_else(|| of(self.predictions, p)))
    }
}

/// All per-sample errors that the inputs and the request allow; the second value holds notes on
/// what was left out.
pub(crate) fn samples(
    scene: Scene<'_>,
    pairs: &[(u32, u32)],
    request: &Request,
    progress: &dyn Progress,
) -> (Samples, Vec<String>) {
    let mut notes = Vec::new();
    let n = pairs.len();
    let mut s = pose_errors(scene, pairs, request.up);
    // One for each object and image: all tell the same without BOP's keys.
    let kinds = if scene.is_plain() { &pairs[..n.min(1)] } else { pairs };

    let symmetric = kinds.iter().any(|&pair| scene.object(pair).symmetries.transforms().len() > 1);
    if symmetric {
        s.oe_sym_rad = Some(column(pairs, |pair| {
            let (est, gt) = scene.poses(pair);
            let symmetries = &scene.object(pair).symmetries;
            metrics::rotation_angle(est, gt, symmetries)
        }));
    }
    let meshes = n > 0 && kinds.iter().all(|&pair| scene.object(pair).mesh.is_some());
    if !meshes {
        return (s, notes);
    }
    let wants = |metric: &str| request.choice.wants(metric);
    let in_chunks = |name: &str, f: &Stage<'_>| {
        progress.begin(name, n as u64);
        let mut out = vec![0.0; n];
        out.par_chunks_mut(CHUNK).zip(pairs.par_chunks(CHUNK)).for_each(|(out, pairs)| {
            f(out, pairs);
            progress.advance(pairs.len() as u64);
        });
        out
    };
    let staged = |name: &str, f: &(dyn Fn((u32, u32)) -> f64 + Sync)| {
        in_chunks(name, &|out, pairs| {
            for (slot, &pair) in out.iter_mut().zip(pairs) {
                *slot = f(pair);
            }
        })
    };
    // Checked above: every sample has a mesh, so NaN never shows.
    let with_mesh = |pair, f: &dyn Fn(&metrics::VertexSet, &Pose, &Pose) -> f64| {
        let (est, gt) = scene.poses(pair);
        scene.object(pair).mesh.as_ref().map_or(f64::NAN, |m| f(&m.set, est, gt))
    };
    if wants("add") {
        s.add_m = Some(in_chunks("ADD", &|out, pairs| {
            for (out, pairs) in out.chunks_mut(2).zip(pairs.chunks(2)) {
                if let (&[p, q], [a, b]) = (pairs, &mut *out)
                    && let Some(mesh) = scene.common_mesh(p, q)
                {
                    let poses = [scene.poses(p), scene.poses(q)];
                    [*a, *b] = metrics::add::add_two(&mesh.set, poses);
                    continue;
                }
                for (slot, &pair) in out.iter_mut().zip(pairs) {
                    *slot = with_mesh(pair, &metrics::add);
                }
            }
        }));
    }
    let queries = |pair| scene.object(pair).mesh.as_ref().map_or(0, |m| m.set.distinct().len());
    if wants("adds") {
        if request.choice == Choice::Auto && n.saturating_mul(queries(pairs[0])) > ADDS_LIMIT {
            notes.push(format!(
                "ADD-S was left out for {n} samples (it would take long); --metrics all computes it"
            ));
        } else {
            s.adds_m = Some(staged("ADD-S", &|pair| with_mesh(pair, &metrics::adds)));
        }
    }
    if wants("mssd") {
        s.mssd_m = Some(staged("MSSD", &|pair| {
            let symmetries = scene.object(pair).symmetries.transforms();
            with_mesh(pair, &|set, est, gt| metrics::mssd(set, est, gt, symmetries))
        }));
    }
    let cameras = kinds.iter().all(|&pair| scene.camera(pair).is_some());
    if cameras && (wants("mspd") || wants("proj")) {
        progress.begin("projection errors", n as u64);
        let mut both = vec![metrics::ProjectionErrors { mspd: 0.0, proj: 0.0 }; n];
        both.par_chunks_mut(CHUNK).zip(pairs.par_chunks(CHUNK)).for_each(|(out, pairs)| {
            for (slot, &pair) in out.iter_mut().zip(pairs) {
                let (est, gt) = scene.poses(pair);
                let object = scene.object(pair);
                if let (Some(mesh), Some(camera)) = (&object.mesh, scene.camera(pair)) {
                    let symmetries = object.symmetries.transforms();
                    *slot = metrics::projection_errors(&mesh.set, est, gt, symmetries, camera);
                }
            }
            progress.advance(pairs.len() as u64);
        });
        if wants("mspd") {
            s.mspd_px = Some(both.iter().map(|e| e.mspd).collect());
        }
        if wants("proj") {
            s.proj_px = Some(both.iter().map(|e| e.proj).collect());
        }
    } else if !cameras && !scene.cameras.is_empty() {
        notes.push(
            "projection errors were left out: the camera file lacks some of the images".into(),
        );
    }
    (s, notes)
}

fn column(pairs: &[(u32, u32)], f: impl Fn((u32, u32)) -> f64 + Sync) -> Vec<f64> {
    pairs.par_iter().with_min_len(CHUNK).map(|&pair| f(pair)).collect()
}

/// The columns that need no mesh.
fn pose_errors(scene: Scene<'_>, pairs: &[(u32, u32)], up: Up) -> Samples {
    let zeros = || vec![0.0; pairs.len()];
    let mut s = Samples {
        gt_row: pairs.iter().map(|p| p.0).collect(),
        pred_row: pairs.iter().map(|p| p.1).collect(),
        te_m: zeros(),
        npe: zeros(),
        oe_rad: zeros(),
        distance_m: zeros(),
        azimuth_deg: zeros(),
        elevation_deg: zeros(),
        ..Samples::default()
    };
    let errors = (s.te_m.par_chunks_mut(CHUNK), s.npe.par_chunks_mut(CHUNK));
    let errors = (errors.0, errors.1, s.oe_rad.par_chunks_mut(CHUNK)).into_par_iter();
    let (azimuth, elevation) = (&mut s.azimuth_deg, &mut s.elevation_deg);
    let views = (s.distance_m.par_chunks_mut(CHUNK), azimuth.par_chunks_mut(CHUNK));
    let views = (views.0, views.1, elevation.par_chunks_mut(CHUNK)).into_par_iter();
    errors.zip(views).zip(pairs.par_chunks(CHUNK)).for_each(
        |(((te, npe, oe), (distance, azimuth, elevation)), pairs)| {
            for (i, &pair) in pairs.iter().enumerate() {
                let (est, gt) = scene.poses(pair);
                te[i] = est.translation.distance(gt.translation);
                oe[i] = rotation::angle(est.rotation, gt.rotation);
                distance[i] = gt.translation.length();
                npe[i] = te[i] / distance[i];
                (azimuth[i], elevation[i]) = viewing_angles(gt, up);
            }
        },
    );
    s
}

/// Errors of one estimate against the instances it may match, infinite where BOP says so.
struct Candidates {
    /// For each estimate by descending score: error to each instance.
    errors: Vec<Vec<f64>>,
}

impl Candidates {
    /// Instances found below a threshold: estimates by score, each takes its nearest free one.
    fn found(&self, threshold: f64) -> usize {
        let instances = self.errors.first().map_or(0, Vec::len);
        let mut free = vec![true; instances];
        let mut found = 0;
        for errors in &self.errors {
            let nearest = (0..instances)
                .filter(|&g| free[g] && errors[g] < threshold)
                .min_by(|&a, &b| errors[a].total_cmp(&errors[b]));
            if let Some(g) = nearest {
                free[g] = false;
                found += 1;
            }
        }
        found
    }
}

/// What estimates are matched from.
enum Matched {
    /// One estimate for one instance: its error.
    Single(Vec<f64>),
    /// Groups of several.
    Groups(Vec<Candidates>),
}

impl Matched {
    /// Instances found below the threshold of their pair or group.
    fn found(&self, threshold: impl Fn(usize) -> f64 + Sync) -> usize {
        match self {
            Self::Single(errors) => {
                let below = |(i, e): &(usize, &f64)| **e < threshold(*i);
                errors.par_iter().enumerate().with_min_len(CHUNK).filter(below).count()
            }
            Self::Groups(groups) => {
                groups.iter().enumerate().map(|(i, group)| group.found(threshold(i))).sum()
            }
        }
    }
}

/// BOP's average recalls over MSSD and MSPD. Hodaň et al., "BOP Challenge 2020", ECCVW 2020.
///
/// Estimates whose translation is off by a diameter or more are wrong, as in the toolkit's scripts.
pub(crate) fn bop(
    scene: Scene<'_>,
    pairs: &[(u32, u32)],
    s: &Samples,
) -> (Option<Bop>, Vec<String>) {
    let mut notes = Vec::new();
    let n_gt = scene.gt.len();
    let Some(mssd) = &s.mssd_m else { return (None, notes) };
    // One estimate for one instance needs no matching: the samples already hold the errors.
    let groups = bop_groups(scene.predictions, scene.gt)
        .filter(|groups| groups.iter().any(|(instances, _)| instances.len() > 1));
    let far = |pair: (u32, u32)| {
        let (est, gt) = scene.poses(pair);
        scene
            .object(pair)
            .bop_diameter()
            .is_none_or(|d| est.translation.distance(gt.translation) >= d)
    };
    let candidates = |error: &(dyn Fn((u32, u32)) -> f64 + Sync), known: &[f64]| match &groups {
        None => {
            let known = pairs.par_iter().zip(known).with_min_len(CHUNK);
            let error = |(&pair, &e): (_, &f64)| if far(pair) { f64::INFINITY } else { e };
            Matched::Single(known.map(error).collect())
        }
        Some(groups) => {
            let group = |(instances, estimates): &(Vec<u32>, Vec<u32>)| {
                let of = |p: u32, g: u32| if far((g, p)) { f64::INFINITY } else { error((g, p)) };
                let row = |&p: &u32| instances.iter().map(|&g| of(p, g)).collect();
                Candidates { errors: estimates.iter().map(row).collect() }
            };
            Matched::Groups(groups.par_iter().map(group).collect())
        }
    };
    let average = |found: &dyn Fn(usize) -> usize| {
        (1..=10).map(|k| found(k) as f64 / n_gt as f64).sum::<f64>() / 10.0
    };
    // A group has one object, so one diameter.
    let diameters: Vec<f64> = match &groups {
        None => {
            pairs.iter().map(|&pair| scene.object(pair).bop_diameter().unwrap_or(0.0)).collect()
        }
        Some(groups) => groups
            .iter()
            .map(|(g, p)| {
                let pair = (g[0], p.first().copied().unwrap_or(0));
                scene.object(pair).bop_diameter().unwrap_or(0.0)
            })
            .collect(),
    };
    let by_mssd = candidates(
        &|pair| {
            let (est, gt) = scene.poses(pair);
            let object = scene.object(pair);
            let symmetries = object.symmetries.transforms();
            object
                .mesh
                .as_ref()
                .map_or(f64::INFINITY, |m| metrics::mssd(&m.set, est, gt, symmetries))
        },
        mssd,
    );
    let ar_mssd = average(&|k| {
        // The thresholds of numpy.arange(0.05, 0.51, 0.05).
        let fraction = 0.05 + (k - 1) as f64 * 0.05;
        by_mssd.found(|i| fraction * diameters[i])
    });
    let ar_mspd = s.mspd_px.as_ref().and_then(|mspd| {
        let Some(width) = scene.cameras.width() else {
            notes.push("AR over MSPD was left out: --camera gives no image width".into());
            return None;
        };
        let by_mspd = candidates(
            &|pair| {
                let (est, gt) = scene.poses(pair);
                let object = scene.object(pair);
                match (&object.mesh, scene.camera(pair)) {
                    (Some(m), Some(camera)) => {
                        let symmetries = object.symmetries.transforms();
                        metrics::projection_errors(&m.set, est, gt, symmetries, camera).mspd
                    }
                    _ => f64::INFINITY,
                }
            },
            mspd,
        );
        let scale = 640.0 / f64::from(width);
        Some(average(&|k| by_mspd.found(|_| 5.0 * k as f64 / scale)))
    });
    (Some(Bop { ar_mssd: Some(ar_mssd), ar_mspd }), notes)
}
