//! Time per image of the G-buffer, one thread: the drone at 1.1 m, in images of three sizes.
//!
//! The model is `DJI.obj` (5,013 faces) where the data folder is at hand (`DRONEPOSE_SHARED`, or
//! `shared` beside the repository), else the quadrotor of the examples (3,912 faces).

use std::hint::black_box;
use std::path::PathBuf;
use std::time::Duration;

use criterion::{BenchmarkId, Criterion, criterion_group, criterion_main};
use dronepose_raster::camera::Intrinsics;
use dronepose_raster::gbuffer::flow::{Fate, Pairs};
use dronepose_raster::gbuffer::normals::{Weight, of_vertices};
use dronepose_raster::gbuffer::{GBuffer, Normals, Scenes, Surface, coverage};
use dronepose_raster::raster::{Model, Size, View};
use dronepose_raster::threads;

const SIZES: [Size; 3] = [
    Size { height: 240, width: 320 },
    Size { height: 480, width: 640 },
    Size { height: 1080, width: 1920 },
];

fn model() -> Model {
    let root = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../..");
    let folder = std::env::var_os("DRONEPOSE_SHARED").map_or(root.join("../shared"), PathBuf::from);
    let drone = folder.join("data/drones/dji_mavic2/DJI.obj");
    let path = if drone.exists() { drone } else { root.join("examples/quadrotor.obj") };
    let mesh = dronepose_raster::io::read_mesh(&path).expect("a mesh");
    Model::from_mesh(&mesh).expect("drawable")
}

/// The camera of UAVA (50.8 degrees upwards) for an image of this size.
fn view(size: Size, turn: f64, distance: f64) -> View {
    let f = 0.5 * size.height as f64 / 25.4_f64.to_radians().tan();
    let camera =
        Intrinsics::new(f, f, 0.5 * size.width as f64, 0.5 * size.height as f64).expect("valid");
    let (s, c) = turn.sin_cos();
    // Upside down about x, after a turn about the vertical axis of the model.
    let rotation = [[c, 0.0, s], [0.3 * s, -0.954, -0.3 * c], [0.954 * s, 0.3, -0.954 * c]];
    View { rotation, translation: [0.05, -0.03, distance], camera }
}

fn images(c: &mut Criterion) {
    let model = model();
    let normals = of_vertices(&model, Weight::Area);
    let surfaces = [Surface { normals: Some(&normals), ..Surface::new(&model) }];
    for (name, channels) in
        [("depth_face", 2), ("barycentrics", 3), ("normals", 4), ("smooth_normals", 5)]
    {
        let mut group = c.benchmark_group(format!("gbuffer/{name}"));
        group.warm_up_time(Duration::from_millis(500)).measurement_time(Duration::from_secs(2));
        for size in SIZES {
            let n = size.pixels();
            let (mut face, mut depth) = (vec![0_i32; n], vec![0.0_f32; n]);
            let mut three = vec![0.0_f32; 3 * n];
            let views: Vec<View> =
                (0..8).map(|k| view(size, 0.7 * f64::from(k), 0.8 + 0.1 * f64::from(k))).collect();
            let mut next = 0;
            let mut draw = || {
                next = (next + 1) % views.len();
                let view = &views[next..=next];
                let scenes = Scenes { surfaces: &surfaces, views: view, size, near: None };
                let mut out = GBuffer::<f32>::default();
                match channels {
                    2 => {
                        out.face = Some(face.as_mut_slice());
                        out.depth = Some(depth.as_mut_slice());
                    }
                    3 => out.barycentrics = Some(three.as_mut_slice()),
                    _ => out.normal = Some(three.as_mut_slice()),
                }
                let kind = if channels == 5 { Normals::Smooth } else { Normals::Flat };
                scenes.draw(kind, out).expect("drawn");
            };
            let id = BenchmarkId::from_parameter(format!("{}x{}", size.width, size.height));
            group.bench_function(id, |b| {
                threads::install(1, || b.iter(&mut draw)).expect("startable");
            });
            if channels == 2 {
                assert!(face.iter().filter(|&&f| f >= 0).count() > n / 200, "a drone is seen");
            }
            black_box((&face, &depth, &three));
        }
        group.finish();
    }
}

fn others(c: &mut Criterion) {
    let model = model();
    let surfaces = [Surface::new(&model)];
    let size = SIZES[1];
    let n = size.pixels();
    let views = [view(size, 0.3, 1.1)];
    let scenes = Scenes { surfaces: &surfaces, views: &views, size, near: None };
    let mut group = c.benchmark_group("gbuffer/640x480");
    group.warm_up_time(Duration::from_millis(500)).measurement_time(Duration::from_secs(2));
    let (mut flow, mut fate) = (vec![0.0_f32; 2 * n], vec![Fate::None; n]);
    let second = [view(size, 0.4, 1.15)];
    let pairs = Pairs {
        first: scenes,
        second: &second,
        second_size: size,
        backgrounds: None,
        tolerance: None,
    };
    let mut draw = || pairs.draw(&mut flow, &mut fate).expect("drawn");
    group.bench_function("flow", |b| {
        threads::install(1, || b.iter(&mut draw)).expect("startable");
    });
    let mut share = vec![0.0_f32; n];
    for samples in [4, 8] {
        let mut draw =
            || coverage::draw(&scenes, samples, coverage::Share::All, &mut share).expect("drawn");
        group.bench_function(format!("coverage_{samples}x{samples}"), |b| {
            threads::install(1, || b.iter(&mut draw)).expect("startable");
        });
    }
    group.finish();
}

criterion_group!(benches, images, others);
criterion_main!(benches);
