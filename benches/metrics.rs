//! Time per pose of each metric, one thread, and how batches scale with threads.
//!
//! The model is `DJI.obj` (3,010 vertices) where the data folder is at hand (`DRONEPOSE_SHARED`, or
//! `shared` beside the repository), else a made-up drone of the same size. Each result is compared
//! once with plain loops.

mod noise;

use std::hint::black_box;
use std::path::PathBuf;
use std::time::Duration;

use criterion::{BatchSize, BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use dronepose_raster::camera::Intrinsics;
use dronepose_raster::metrics::add::{add, add_below, add_bounds};
use dronepose_raster::metrics::adds::adds;
use dronepose_raster::metrics::batch::{add_batch, add_below_batch, adds_batch};
use dronepose_raster::metrics::mspd::projection_errors;
use dronepose_raster::metrics::mssd::mssd;
use dronepose_raster::metrics::symmetry::Symmetries;
use dronepose_raster::metrics::vertices::VertexSet;
use dronepose_raster::{Mesh, Pose};
use glam::{DQuat, DVec3};

use self::noise::Noise;

fn model() -> Vec<DVec3> {
    let beside = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../../shared");
    let folder = std::env::var_os("DRONEPOSE_SHARED").map_or(beside, PathBuf::from);
    match std::fs::read_to_string(folder.join("data/drones/dji_mavic2/DJI.obj")) {
        Ok(text) => vertices(&text),
        Err(_) => made_up(),
    }
}

fn vertices(text: &str) -> Vec<DVec3> {
    let numbers = |line: &str| -> Vec<f64> {
        line.split_whitespace().skip(1).map(|c| c.parse().expect("a number")).collect()
    };
    let lines = text.lines().filter(|line| line.starts_with("v "));
    lines.map(|line| DVec3::from_slice(&numbers(line))).collect()
}

/// A body, four arms and four rotor discs; 3,010 points, 398 of them repeated.
fn made_up() -> Vec<DVec3> {
    let mut noise = Noise(7);
    let mut points: Vec<DVec3> = (0..2612)
        .map(|k| match k % 3 {
            0 => noise.vector().normalize() * DVec3::new(0.1, 0.05, 0.04),
            part => {
                let side =
                    DVec3::new(0.15 * noise.next().signum(), 0.15 * noise.next().signum(), 0.02);
                if part == 1 {
                    side * (0.5 + 0.5 * noise.next()) + noise.vector() * 0.01
                } else {
                    side + noise.vector() * DVec3::new(0.08, 0.08, 0.002)
                }
            }
        })
        .collect();
    points.extend_from_within(..398);
    points
}

/// Pairs `(est, gt)` with errors of so many degrees and metres.
fn poses(count: usize, degrees: f64, metres: f64) -> (Vec<Pose>, Vec<Pose>) {
    let mut noise = Noise(11);
    (0..count)
        .map(|_| {
            let gt = Pose::new(
                DQuat::from_axis_angle(noise.vector().normalize(), 3.0 * noise.next()),
                noise.vector() * 0.3 + DVec3::Z * 1.5,
            );
            let turn = DQuat::from_axis_angle(noise.vector().normalize(), degrees.to_radians());
            let est = Pose::new(
                (gt.rotation * turn).normalize(),
                gt.translation + noise.vector().normalize() * metres,
            );
            (est, gt)
        })
        .unzip()
}

fn distances<'a>(
    points: &'a [DVec3],
    est: &'a Pose,
    gt: &'a Pose,
) -> impl Iterator<Item = f64> + 'a {
    points.iter().map(|p| est.transform_point(*p).distance(gt.transform_point(*p)))
}

fn plain_add(points: &[DVec3], est: &Pose, gt: &Pose) -> f64 {
    distances(points, est, gt).sum::<f64>() / points.len() as f64
}

fn plain_adds(points: &[DVec3], est: &Pose, gt: &Pose) -> f64 {
    let there: Vec<DVec3> = points.iter().map(|p| est.transform_point(*p)).collect();
    let nearest = |p: &DVec3| {
        let q = gt.transform_point(*p);
        there.iter().map(|e| e.distance_squared(q)).fold(f64::INFINITY, f64::min).sqrt()
    };
    points.iter().map(nearest).sum::<f64>() / points.len() as f64
}

fn plain_mssd(points: &[DVec3], est: &Pose, gt: &Pose, symmetries: &[Pose]) -> f64 {
    let worst = |gt: &Pose| distances(points, est, gt).fold(0.0, f64::max);
    symmetries.iter().map(|s| worst(&gt.compose(s))).fold(worst(gt), f64::min)
}

fn same(fast: f64, plain: f64) {
    assert!((fast - plain).abs() <= 1e-12 * plain.abs() + 1e-14, "{fast} and {plain}");
}

/// Times `work` on one pair after the other.
fn each(
    c: &mut Criterion,
    name: &str,
    pairs: &(Vec<Pose>, Vec<Pose>),
    work: impl Fn(&Pose, &Pose),
) {
    let (est, gt) = pairs;
    let mut k = 0;
    c.bench_function(name, |b| {
        b.iter(|| {
            k = (k + 1) % est.len();
            work(black_box(&est[k]), black_box(&gt[k]));
        });
    });
}

fn in_space(c: &mut Criterion) {
    let points = model();
    let set = VertexSet::new(&points).expect("points");
    let near = poses(1000, 5.0, 0.02);
    let far = poses(1000, 90.0, 0.3);
    for (est, gt) in near.0.iter().zip(&near.1).take(3) {
        same(add(&set, est, gt), plain_add(&points, est, gt));
        same(adds(&set, est, gt), plain_adds(&points, est, gt));
    }
    for (est, gt) in far.0.iter().zip(&far.1).take(3) {
        same(adds(&set, est, gt), plain_adds(&points, est, gt));
    }
    each(c, "add/plain", &near, |e, g| {
        black_box(plain_add(&points, e, g));
    });
    each(c, "add/exact", &near, |e, g| {
        black_box(add(&set, e, g));
    });
    each(c, "add/bounds", &near, |e, g| {
        black_box(add_bounds(&set, e, g));
    });
    let diagonal = 0.608_931_015_7;
    for percent in [2, 5, 10] {
        let threshold = diagonal * f64::from(percent) / 100.0;
        each(c, &format!("add_below/{percent}%"), &near, |e, g| {
            black_box(add_below(&set, e, g, threshold));
        });
    }
    c.bench_function("adds/prepare", |b| {
        b.iter(|| black_box(VertexSet::new(&points).expect("points").nearest().bytes()));
    });
    for (name, pairs) in [("adds/near", &near), ("adds/far", &far)] {
        each(c, name, pairs, |e, g| {
            black_box(adds(&set, e, g));
        });
    }
}

fn with_symmetries(c: &mut Criterion) {
    let points = model();
    let set = VertexSet::new(&points).expect("points");
    let near = poses(1000, 5.0, 0.02);
    let camera = Intrinsics::new(252.72, 252.72, 160.0, 120.0).expect("valid");
    let quarter = |k: u32| {
        let angle = f64::from(k) * std::f64::consts::FRAC_PI_2;
        Pose::new(DQuat::from_rotation_z(angle), DVec3::ZERO)
    };
    let four = Symmetries::new(&[1, 2, 3].map(quarter), &[], 0.01).expect("valid");
    let round = Symmetries::new(&[], &[(DVec3::Z, DVec3::ZERO)], 0.01).expect("valid");
    for (name, symmetries) in [("1", Symmetries::none()), ("4", four), ("315", round)] {
        let list = symmetries.transforms();
        for (est, gt) in near.0.iter().zip(&near.1).take(2) {
            same(mssd(&set, est, gt, list), plain_mssd(&points, est, gt, list));
        }
        each(c, &format!("mssd/{name}"), &near, |e, g| {
            black_box(mssd(&set, e, g, list));
        });
        each(c, &format!("projection/{name}"), &near, |e, g| {
            black_box(projection_errors(&set, e, g, list, &camera));
        });
    }
}

/// What is done once for a mesh, of the largest that people bring.
fn preparations(c: &mut Criterion) {
    let mut noise = Noise(5);
    let mut directions =
        |count: usize| -> Vec<DVec3> { (0..count).map(|_| noise.vector().normalize()).collect() };
    let (sphere, large) = (directions(20_000), directions(100_000));
    let mut group = c.benchmark_group("prepare");
    group.sample_size(10);
    // Every vertex is a corner of the hull: the worst case.
    group.bench_function("diameter/20000", |b| {
        let mesh = || Mesh::new(sphere.clone(), vec![]).expect("valid");
        b.iter_batched_ref(mesh, |mesh| black_box(mesh.diameter()), BatchSize::PerIteration);
    });
    group.bench_function("adds/100000", |b| {
        b.iter(|| black_box(VertexSet::new(&large).expect("points").nearest().bytes()));
    });
    group.finish();
}

fn threads(c: &mut Criterion) {
    let set = VertexSet::new(&model()).expect("points");
    set.nearest();
    let (est, gt) = poses(10_000, 5.0, 0.02);
    let mut group = c.benchmark_group("threads");
    group.sample_size(20).throughput(Throughput::Elements(est.len() as u64));
    let mut first = None;
    for threads in [1, 2] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("pool");
        let result = pool.install(|| add_batch(&set, &est, &gt)).expect("equally long");
        assert_eq!(first.get_or_insert(result.clone()), &result);
        group.bench_function(BenchmarkId::new("add", threads), |b| {
            b.iter(|| pool.install(|| black_box(add_batch(&set, &est, &gt))));
        });
        group.bench_function(BenchmarkId::new("add_below", threads), |b| {
            b.iter(|| pool.install(|| black_box(add_below_batch(&set, &est, &gt, 0.03))));
        });
        group.bench_function(BenchmarkId::new("adds", threads), |b| {
            b.iter(|| pool.install(|| black_box(adds_batch(&set, &est[..1000], &gt[..1000]))));
        });
    }
    group.finish();
}

criterion_group! {
    name = benches;
    config = Criterion::default()
        .measurement_time(Duration::from_secs(2))
        .warm_up_time(Duration::from_millis(500));
    targets = in_space, with_symmetries, preparations, threads
}
criterion_main!(benches);
