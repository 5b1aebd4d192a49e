//! Silhouettes and their gradients: time for a batch of 64 images of 320 x 240 pixels, one thread.
//!
//! `cargo bench --bench silhouette -- coverage`. The mesh is `examples/quadrotor.obj`, or the file
//! named by `DRONEPOSE_BENCH_MESH` (metres).

use std::hint::black_box;
use std::path::PathBuf;

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use dronepose_raster::camera::Intrinsics;
use dronepose_raster::io::read_mesh;
use dronepose_raster::raster::{Batch, Mode, Model, Size, View, Wanted};
use dronepose_raster::threads::install;
use glam::{DMat3, DQuat};

const BATCH: usize = 64;

/// Uniform in `[0, 1)`, the same in every run.
struct Random(u64);

impl Random {
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        (self.0 >> 11) as f64 / (1_u64 << 53) as f64
    }

    fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.next()
    }
}

fn model() -> Model {
    let default =
        PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../../examples/quadrotor.obj"));
    let path = std::env::var_os("DRONEPOSE_BENCH_MESH").map_or(default, PathBuf::from);
    Model::from_mesh(&read_mesh(&path).expect("a mesh")).expect("a mesh with faces")
}

/// Random rotations, 0.8 to 1.5 m away, the centre inside the image.
fn views(size: Size, count: usize) -> Vec<View> {
    let mut random = Random(1);
    let focal = 252.72 / 240.0 * size.height as f64;
    let (cx, cy) = (size.width as f64 / 2.0, size.height as f64 / 2.0);
    let camera = Intrinsics::new(focal, focal, cx, cy).expect("valid");
    (0..count)
        .map(|_| {
            let normal = |r: &mut Random| (0..6).map(|_| r.next()).sum::<f64>() - 3.0;
            let q: [f64; 4] = std::array::from_fn(|_| normal(&mut random));
            let m = DMat3::from_quat(DQuat::from_array(q).normalize());
            let z = random.between(0.8, 1.5);
            View {
                rotation: std::array::from_fn(|row| m.row(row).to_array()),
                translation: [random.between(-0.3, 0.3) * z, random.between(-0.2, 0.2) * z, z],
                camera,
            }
        })
        .collect()
}

fn modes() -> [(&'static str, Mode); 5] {
    [
        ("hard", Mode::Hard),
        ("coverage", Mode::Coverage { sigma: 0.0 }),
        ("coverage_s1", Mode::Coverage { sigma: 1.0 }),
        ("dibr", Mode::Dibr { delta: 7000.0, cutoff: None }),
        ("sigmoid", Mode::Sigmoid { sigma: 1e-4, cutoff: None }),
    ]
}

fn silhouettes(c: &mut Criterion) {
    let model = model();
    let models = [&model];
    let size = Size { height: 240, width: 320 };
    let views = views(size, BATCH);
    let mut out = vec![0.0_f32; BATCH * size.pixels()];
    let upstream: Vec<f32> = (0..out.len()).map(|k| (k * 7919 % 101) as f32 / 50.0 - 1.0).collect();
    for (name, mode) in modes() {
        let batch = Batch { models: &models, views: &views, size, mode, near: None };
        let mut group = c.benchmark_group(name);
        group.throughput(Throughput::Elements(BATCH as u64)).sample_size(20);
        for threads in [1, 2] {
            group.bench_function(format!("forward/{threads}"), |b| {
                b.iter(|| install(threads, || batch.draw(black_box(&mut out))));
            });
            if mode != Mode::Hard {
                group.bench_function(format!("backward/{threads}"), |b| {
                    b.iter(|| {
                        install(threads, || batch.gradients(&upstream, Wanted { vertices: false }))
                    });
                });
            }
        }
    }
}

criterion_group!(benches, silhouettes);
criterion_main!(benches);
