//! Least time an image of every mode and of the G-buffer, one thread: the least of several
//! repetitions of each image, averaged over 64. For comparing builds: see `bench_builds.py`.
//!
//! `cargo bench --bench minima -- 30`, with the number of repetitions. 320 x 240 pixels; the mesh is
//! `examples/quadrotor.obj`, or the file named by `DRONEPOSE_BENCH_MESH` (metres).
#![expect(clippy::print_stdout, reason = "a program")]

use std::path::PathBuf;
use std::time::Instant;

use dronepose_raster::camera::Intrinsics;
use dronepose_raster::gbuffer::{GBuffer, Normals, Scenes, Surface};
use dronepose_raster::io::read_mesh;
use dronepose_raster::raster::{Batch, Mode, Model, Size, View, Wanted};
use dronepose_raster::threads::install;
use glam::{DMat3, DQuat};

const BATCH: usize = 64;
const SIZE: Size = Size { height: 240, width: 320 };

/// Random rotations, 0.8 to 1.5 m away, the centre inside the image; the same in every run.
fn views() -> Vec<View> {
    let mut state = 1_u64;
    let mut next = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        (state >> 11) as f64 / (1_u64 << 53) as f64
    };
    let camera = Intrinsics::new(252.72, 252.72, 160.0, 120.0).expect("valid");
    let mut view = || {
        let q: [f64; 4] = std::array::from_fn(|_| (0..6).map(|_| next()).sum::<f64>() - 3.0);
        let m = DMat3::from_quat(DQuat::from_array(q).normalize());
        let z = 0.8 + 0.7 * next();
        let translation = [0.6 * (next() - 0.5) * z, 0.4 * (next() - 0.5) * z, z];
        View { rotation: std::array::from_fn(|row| m.row(row).to_array()), translation, camera }
    };
    (0..BATCH).map(|_| view()).collect()
}

/// Microseconds an image.
fn least(repetitions: usize, mut image: impl FnMut(usize)) -> f64 {
    let mut best = [f64::MAX; BATCH];
    for _ in 0..repetitions {
        for (k, best) in best.iter_mut().enumerate() {
            let start = Instant::now();
            image(k);
            *best = best.min(start.elapsed().as_secs_f64());
        }
    }
    best.iter().sum::<f64>() / BATCH as f64 * 1e6
}

fn main() {
    let repetitions = std::env::args().find_map(|a| a.parse().ok()).unwrap_or(10);
    let default =
        PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../../examples/quadrotor.obj"));
    let path = std::env::var_os("DRONEPOSE_BENCH_MESH").map_or(default, PathBuf::from);
    let model = Model::from_mesh(&read_mesh(&path).expect("a mesh")).expect("a mesh with faces");
    let (views, pixels) = (views(), SIZE.pixels());
    let mut mask = vec![0.0_f32; BATCH * pixels];
    let upstream: Vec<f32> =
        (0..mask.len()).map(|k| (k * 7919 % 101) as f32 / 50.0 - 1.0).collect();
    let mut face = vec![0_i32; BATCH * pixels];
    let of = |k: usize| k * pixels..(k + 1) * pixels;
    let run = || {
        for (name, mode) in [
            ("hard", Mode::Hard),
            ("coverage", Mode::Coverage { sigma: 0.0 }),
            ("coverage, sigma 1", Mode::Coverage { sigma: 1.0 }),
            ("dibr", Mode::Dibr { delta: 7000.0, cutoff: None }),
            ("sigmoid", Mode::Sigmoid { sigma: 1e-4, cutoff: None }),
        ] {
            let models = [&model];
            let batch = |k: usize| {
                let views = &views[k..=k];
                Batch { models: &models, views, size: SIZE, mode, near: None }
            };
            let time = least(repetitions, |k| batch(k).draw(&mut mask[of(k)]).expect("drawn"));
            println!("{time:.2} {name}");
            if mode != Mode::Hard {
                let wanted = Wanted { vertices: false };
                let time = least(repetitions, |k| {
                    batch(k).gradients(&upstream[of(k)], wanted).expect("drawn");
                });
                println!("{time:.2} {name}, gradient");
            }
        }
        let surfaces = [Surface::new(&model)];
        let time = least(repetitions, |k| {
            let views = &views[k..=k];
            let scenes = Scenes { surfaces: &surfaces, views, size: SIZE, near: None };
            let (depth, face) = (Some(&mut mask[of(k)]), Some(&mut face[of(k)]));
            let out = GBuffer { depth, face, ..GBuffer::default() };
            scenes.draw(Normals::Flat, out).expect("drawn");
        });
        println!("{time:.2} depth, face");
    };
    install(1, run).expect("startable");
}
