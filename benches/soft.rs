//! Time per image of the soft masks and of their gradients, one thread, 320x240.
//!
//! The mesh is `DJI.obj` (5,013 faces) where the data folder is at hand (`DRONEPOSE_SHARED`, or
//! `shared` beside the repository), else `examples/quadrotor.obj`.

use std::hint::black_box;
use std::path::PathBuf;
use std::time::Duration;

use criterion::{Criterion, criterion_group, criterion_main};
use dronepose_raster::camera::Intrinsics;
use dronepose_raster::io::mesh_file::read_mesh;
use dronepose_raster::raster::{
    KaolinCutoff, Model, Pytorch3dCutoff, Screen, Size, View, dibr, sigmoid,
};

const SIZE: Size = Size { height: 240, width: 320 };

fn model() -> Model {
    let root = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../..");
    let beside = root.join("../shared");
    let folder = std::env::var_os("DRONEPOSE_SHARED").map_or(beside, PathBuf::from);
    let mesh = read_mesh(&folder.join("data/drones/dji_mavic2/DJI.obj"))
        .or_else(|_| read_mesh(&root.join("examples/quadrotor.obj")));
    Model::from_mesh(&mesh.expect("a mesh")).expect("a model")
}

/// The drone 1.2 m away, seen from the front and a little from above.
fn screen(model: &Model) -> Screen {
    let (s, c) = 0.3_f64.sin_cos();
    let view = View {
        rotation: [[c, 0.0, s], [s * s, -c, -c * s], [c * s, s, -c * c]],
        translation: [0.05, 0.02, 1.2],
        camera: Intrinsics::new(252.72, 252.72, 160.0, 120.0).expect("a camera"),
    };
    let mut screen = Screen::default();
    screen.project(model, &view, 1e-3).expect("in front");
    screen
}

fn soft(c: &mut Criterion) {
    let model = model();
    let screen = screen(&model);
    let mut out = vec![0.0_f32; SIZE.pixels()];
    let upstream: Vec<f32> =
        (0..SIZE.pixels()).map(|k| ((k * 7919) % 1000) as f32 / 500.0 - 1.0).collect();
    let mut du = vec![0.0; screen.points()];
    let mut dv = du.clone();
    let kaolin = KaolinCutoff { boxlen: 0.02, knum: 30 };
    for (name, cutoff) in [("dibr", None), ("dibr, cut-offs of Kaolin", Some(kaolin))] {
        c.bench_function(&format!("{name}, forward"), |b| {
            b.iter(|| dibr::draw(&model, &screen, SIZE, 7000.0, cutoff, black_box(&mut out)));
        });
        c.bench_function(&format!("{name}, backward"), |b| {
            b.iter(|| {
                let (du, dv) = (black_box(&mut du), black_box(&mut dv));
                dibr::back(&model, &screen, SIZE, 7000.0, cutoff, &upstream, du, dv);
            });
        });
    }
    let pytorch3d = Pytorch3dCutoff { blur_radius: 9.21e-4, faces_per_pixel: 50 };
    for (name, cutoff) in [("sigmoid", None), ("sigmoid, cut-offs of PyTorch3D", Some(pytorch3d))] {
        c.bench_function(&format!("{name}, forward"), |b| {
            b.iter(|| sigmoid::draw(&model, &screen, SIZE, 1e-4, cutoff, black_box(&mut out)));
        });
        c.bench_function(&format!("{name}, backward"), |b| {
            b.iter(|| {
                let (du, dv) = (black_box(&mut du), black_box(&mut dv));
                sigmoid::back(&model, &screen, SIZE, 1e-4, cutoff, &upstream, du, dv);
            });
        });
    }
}

criterion_group! {
    name = benches;
    config = Criterion::default()
        .warm_up_time(Duration::from_millis(300))
        .measurement_time(Duration::from_secs(2))
        .sample_size(50)
        .without_plots();
    targets = soft
}
criterion_main!(benches);
