//! How often drawing asks for memory, once its buffers have grown: never, but for the gradients that
//! are returned.
#![expect(unsafe_code, reason = "an allocator can be written in no other way")]

use std::alloc::{GlobalAlloc, Layout, System};
use std::sync::atomic::{AtomicUsize, Ordering};

use dronepose_raster::camera::Intrinsics;
use dronepose_raster::gbuffer::{GBuffer, Normals, Scenes, Surface};
use dronepose_raster::raster::{Batch, Mode, Model, Size, View, Wanted};
use dronepose_raster::threads;

/// The allocator of the system, counted. One test in this file: the count is that of the process.
struct Counting;

static ASKED: AtomicUsize = AtomicUsize::new(0);

// SAFETY: every call goes to the allocator of the system as it came.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        ASKED.fetch_add(1, Ordering::Relaxed);
        // SAFETY: as the caller promised.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, at: *mut u8, layout: Layout) {
        // SAFETY: as the caller promised.
        unsafe { System.dealloc(at, layout) }
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        ASKED.fetch_add(1, Ordering::Relaxed);
        // SAFETY: as the caller promised.
        unsafe { System.alloc_zeroed(layout) }
    }

    unsafe fn realloc(&self, at: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        ASKED.fetch_add(1, Ordering::Relaxed);
        // SAFETY: as the caller promised.
        unsafe { System.realloc(at, layout, size) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// Requests for the gradients that are returned: those of the views, and with them those of the
/// vertices, a list of one list.
const OF_VIEWS: usize = 1;
const OF_VERTICES: usize = 3;

/// A ball of 2,208 triangles, which share their vertices.
fn ball() -> Model {
    let (bands, around) = (24_u32, 48_u32);
    let angle = |k: u32, of: u32| std::f64::consts::TAU * f64::from(k) / f64::from(of);
    let mut vertices = vec![[0.0, 0.0, 0.2], [0.0, 0.0, -0.2]];
    for i in 1..bands {
        let (s, c) = angle(i, 2 * bands).sin_cos();
        vertices.extend((0..around).map(|j| {
            let (y, x) = angle(j, around).sin_cos();
            [0.2 * s * x, 0.2 * s * y, 0.2 * c]
        }));
    }
    let at = |i: u32, j: u32| match i {
        0 => 0,
        _ if i == bands => 1,
        _ => 2 + (i - 1) * around + j % around,
    };
    let mut faces = Vec::new();
    for (i, j) in (0..bands).flat_map(|i| (0..around).map(move |j| (i, j))) {
        let [a, b, c, d] = [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)];
        faces.extend(
            [[a, b, c], [a, c, d]]
                .into_iter()
                .filter(|f| f[0] != f[1] && f[1] != f[2] && f[0] != f[2]),
        );
    }
    Model::new(&vertices, &faces).expect("valid")
}

fn views(count: usize, size: Size) -> Vec<View> {
    let f = size.height as f64;
    let camera =
        Intrinsics::new(f, f, 0.5 * size.width as f64, 0.5 * size.height as f64).expect("valid");
    let view = |k: usize| {
        let (s, c) = (0.3 * k as f64).sin_cos();
        let rotation = [[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]];
        View { rotation, translation: [0.01 * k as f64, 0.0, 1.0], camera }
    };
    (0..count).map(view).collect()
}

/// Requests of one call after three others.
fn asked(mut call: impl FnMut()) -> usize {
    (0..3).for_each(|_| call());
    let before = ASKED.load(Ordering::Relaxed);
    call();
    ASKED.load(Ordering::Relaxed) - before
}

const SMALL: Size = Size { height: 120, width: 160 };
const LARGE: Size = Size { height: 480, width: 640 };

#[test]
fn buffers_are_used_again() {
    let model = ball();
    let modes = [
        ("hard", Mode::Hard),
        ("coverage", Mode::Coverage { sigma: 0.0 }),
        ("coverage, sigma 1", Mode::Coverage { sigma: 1.0 }),
        ("dibr", Mode::Dibr { delta: 7000.0, cutoff: None }),
        ("sigmoid", Mode::Sigmoid { sigma: 1e-4, cutoff: None }),
    ];
    let mut found = Vec::new();
    for (count, size) in [(1, SMALL), (8, SMALL), (32, SMALL), (8, LARGE)] {
        let views = views(count, size);
        let pixels = count * size.pixels();
        let (mut mask, upstream) = (vec![0.0_f32; pixels], vec![1.0_f32; pixels]);
        let (mut depth, mut face, mut normal) =
            (vec![0.0_f32; pixels], vec![0_i32; pixels], vec![0.0_f32; 3 * pixels]);
        let models = [&model];
        let surfaces = [Surface::new(&model)];
        let of = |name: &str| format!("{name}, {count} x {} x {}", size.width, size.height);
        threads::install(1, || {
            for (name, mode) in modes {
                let batch = Batch { models: &models, views: &views, size, mode, near: None };
                found.push((of(name), asked(|| batch.draw(&mut mask).expect("drawn")), 0));
                let back = |vertices: bool| {
                    asked(|| drop(batch.gradients(&upstream, Wanted { vertices }).expect("drawn")))
                };
                let name = format!("{name} gradient");
                found.push((of(&name), back(false), OF_VIEWS));
                found.push((of(&format!("{name}, vertices")), back(true), OF_VERTICES));
            }
            let scenes = Scenes { surfaces: &surfaces, views: &views, size, near: None };
            let draw = || {
                let (depth, face) = (Some(depth.as_mut_slice()), Some(face.as_mut_slice()));
                let out = GBuffer { depth, face, ..GBuffer::default() };
                scenes.draw(Normals::Flat, out).expect("drawn");
            };
            found.push((of("depth, face"), asked(draw), 0));
            let draw = || {
                let out = GBuffer { normal: Some(normal.as_mut_slice()), ..GBuffer::default() };
                scenes.draw(Normals::Flat, out).expect("drawn");
            };
            found.push((of("normal"), asked(draw), 0));
        })
        .expect("startable");
    }
    for (name, count, most) in &found {
        assert!(count <= most, "{name}: {count} requests, expected at most {most}");
    }
}
