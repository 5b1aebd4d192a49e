use dronepose_raster::{
    Pose,
    metrics::{VertexSet, add::*, adds::*},
};
use glam::*;
use std::hint::black_box;
use std::time::Instant;
fn main() {
    let txt = std::fs::read_to_string("/work/shared/data/drones/dji_mavic2/DJI.obj").unwrap();
    let pts: Vec<DVec3> = txt
        .lines()
        .filter(|l| l.starts_with("v "))
        .map(|l| {
            let v: Vec<f64> = l[2..].split_whitespace().map(|x| x.parse().unwrap()).collect();
            DVec3::new(v[0], v[1], v[2])
        })
        .collect();
    let set = VertexSet::new(&pts).unwrap();
    println!("{} {} {:?}", set.total(), set.distinct().len(), set.mean());
    let t = Instant::now();
    let nn = set.nearest();
    println!("build {:?} bytes {}", t.elapsed(), nn.bytes());
    let mut s = 1u64;
    let mut r = || {
        s = s.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        ((s >> 11) as f64) / (1u64 << 53) as f64 * 2. - 1.
    };
    let mut mk = |ang: f64, tr: f64| -> Vec<(Pose, Pose)> {
        (0..200)
            .map(|_| {
                let q = DQuat::from_xyzw(r(), r(), r(), r()).normalize();
                let t = DVec3::new(r(), r(), r() + 3.);
                let ax = DVec3::new(r(), r(), r()).normalize();
                let dt = DVec3::new(r(), r(), r()).normalize() * tr;
                (
                    Pose::new((q * DQuat::from_axis_angle(ax, ang)).normalize(), t + dt),
                    Pose::new(q, t),
                )
            })
            .collect()
    };
    let near = mk(5f64.to_radians(), 0.02);
    let far = mk(90f64.to_radians(), 0.3);
    let run = |name: &str, f: &dyn Fn(&Pose, &Pose) -> f64, ps: &[(Pose, Pose)], reps: usize| {
        let mut best = f64::MAX;
        let mut s = 0.;
        for _ in 0..reps {
            let t = Instant::now();
            s = 0.;
            for (e, g) in ps {
                s += black_box(f(black_box(e), black_box(g)));
            }
            best = best.min(t.elapsed().as_secs_f64() / ps.len() as f64);
        }
        println!("{name:20} {:.3} us  {s:.15}", best * 1e6);
    };
    run("add near", &|e, g| add(&set, e, g), &near, 100);
    let slow = |e: &Pose, g: &Pose| {
        let (a, b) = (e.matrix(), g.matrix());
        pts.iter()
            .map(|p| (a * *p + e.translation - (b * *p + g.translation)).length())
            .sum::<f64>()
            / pts.len() as f64
    };
    run("add slow", &slow, &near, 3);
    run("bounds", &|e, g| add_bounds(&set, e, g).1, &near, 100);
    run("adds near", &|e, g| adds(&set, e, g), &near, 20);
    run("adds far", &|e, g| adds(&set, e, g), &far, 5);
    let slows = |e: &Pose, g: &Pose| {
        let (a, b) = (e.matrix(), g.matrix());
        let ev: Vec<DVec3> = pts.iter().map(|p| a * *p + e.translation).collect();
        pts.iter()
            .map(|p| {
                let q = b * *p + g.translation;
                ev.iter().map(|e| e.distance_squared(q)).fold(f64::MAX, f64::min).sqrt()
            })
            .sum::<f64>()
            / pts.len() as f64
    };
    run("slow near 20", &slows, &near[..10], 1);
    run("adds near 20", &|e, g| adds(&set, e, g), &near[..10], 1);
    run("slow far 20", &slows, &far[..10], 1);
    run("adds far 20", &|e, g| adds(&set, e, g), &far[..10], 1);
}
