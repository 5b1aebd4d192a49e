//! Slow twin: the ray of every pixel against every face, in the camera frame, nothing cut.

use super::{Fragment, GBuffer, Normals, Scenes};
use crate::camera::Intrinsics;
use crate::raster::{Model, Pixel, Size, View};

/// What the ray through a pixel meets first.
#[derive(Debug, Clone, Copy)]
pub(super) enum Seen {
    Nothing,
    Point(Fragment),
    /// Too close to an edge or to another surface to tell.
    Unclear,
}

/// An image of one view for each surface.
pub(super) fn image(models: &[Model], views: &[View], size: Size, near: f64) -> Vec<Seen> {
    let pixels = (0..size.height).flat_map(|i| (0..size.width).map(move |j| (i, j)));
    pixels.map(|(i, j)| pixel(models, views, (i, j), near)).collect()
}

fn pixel(models: &[Model], views: &[View], (i, j): (usize, usize), near: f64) -> Seen {
    let mut best: Option<Fragment> = None;
    let mut unclear = Vec::new();
    for (surface, (model, view)) in models.iter().zip(views).enumerate() {
        let k = &view.camera;
        let y = (i as f64 + 0.5 - k.cy) / k.fy;
        let x = (j as f64 + 0.5 - k.cx - k.skew * y) / k.fx;
        for (face, corners) in model.faces().iter().enumerate() {
            let p = corners.map(|v| in_camera(model.vertex(v as usize), view));
            let sides = [0, 1, 2].map(|c| triple([x, y, 1.0], p[(c + 1) % 3], p[(c + 2) % 3]));
            let scale: f64 = p.iter().flatten().fold(0.0_f64, |a, b| a.max(b.abs()));
            let close = 1e-10 * scale * scale * (1.0 + x.abs() + y.abs());
            let sum: f64 = sides.iter().sum();
            let outside = sides.iter().any(|&s| s > close) && sides.iter().any(|&s| s < -close);
            if outside {
                continue;
            }
            let w = sides.map(|s| s / sum);
            let depth = (0..3).map(|c| w[c] * p[c][2]).sum::<f64>();
            let doubtful = sides.iter().any(|s| s.abs() <= close) || sum.abs() <= 10.0 * close;
            if doubtful || (depth - near).abs() < 1e-9 * near {
                unclear.push(depth);
            } else if depth > near && best.is_none_or(|b| depth < b.depth) {
                if let Some(b) = best
                    && b.depth - depth < 1e-9 * depth
                {
                    unclear.push(depth);
                }
                best = Some(Fragment { column: j, surface, face, barycentrics: w, depth });
            } else if depth > near && best.is_some_and(|b| depth - b.depth < 1e-9 * depth) {
                unclear.push(depth);
            }
        }
    }
    match best {
        _ if unclear.iter().any(|&d| d.is_nan() || best.is_none_or(|b| d < b.depth + 1e-6)) => {
            Seen::Unclear
        }
        Some(fragment) => Seen::Point(fragment),
        None => Seen::Nothing,
    }
}

pub(super) fn in_camera(p: [f64; 3], view: &View) -> [f64; 3] {
    let row = |k: usize| (0..3).map(|c| view.rotation[k][c] * p[c]).sum::<f64>();
    [0, 1, 2].map(|k| row(k) + view.translation[k])
}

/// The image point of a point in the camera frame.
pub(super) fn project(p: [f64; 3], k: &Intrinsics) -> [f64; 2] {
    [(k.fx * p[0] + k.skew * p[1]) / p[2] + k.cx, k.fy * p[1] / p[2] + k.cy]
}

fn triple(a: [f64; 3], b: [f64; 3], c: [f64; 3]) -> f64 {
    a[0] * (b[1] * c[2] - b[2] * c[1])
        + a[1] * (b[2] * c[0] - b[0] * c[2])
        + a[2] * (b[0] * c[1] - b[1] * c[0])
}

/// All planes of a drawing, owned.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct Planes<T> {
    pub(super) mask: Vec<bool>,
    pub(super) object: Vec<i32>,
    pub(super) face: Vec<i32>,
    pub(super) depth: Vec<T>,
    pub(super) barycentrics: Vec<T>,
    pub(super) normal: Vec<T>,
    pub(super) attributes: Vec<T>,
    pub(super) uv: Vec<T>,
}

/// Draw everything.
pub(super) fn planes<T: Pixel>(scenes: &Scenes<'_>, normals: Normals) -> Planes<T> {
    let n = scenes.images() * scenes.size.pixels();
    // Whatever was there before has to go.
    let old = T::from_f64(7.0);
    let mut p = Planes {
        mask: vec![true; n],
        object: vec![7; n],
        face: vec![7; n],
        depth: vec![old; n],
        barycentrics: vec![old; 3 * n],
        normal: vec![old; 3 * n],
        attributes: vec![old; scenes.attribute_channels() * n],
        uv: vec![old; 2 * n],
    };
    let out = GBuffer {
        mask: Some(&mut p.mask),
        object: Some(&mut p.object),
        face: Some(&mut p.face),
        depth: Some(&mut p.depth),
        barycentrics: Some(&mut p.barycentrics),
        normal: Some(&mut p.normal),
        attributes: Some(&mut p.attributes),
        uv: Some(&mut p.uv),
    };
    scenes.draw(normals, out).expect("drawn");
    p
}
