//! The numbers that are drawn: masks and surfaces of a frame. The only place here that calls the
//! rasteriser.

use std::cell::OnceCell;

use glam::DVec3;

use super::frames::Frame;
use crate::error::Result;
use crate::raster::{Batch, Mode, Model, Screen};

/// What all frames share.
#[derive(Debug)]
pub(super) struct Scene {
    pub(super) model: Model,
    /// The box around the mesh, in metres.
    pub(super) bounds: (DVec3, DVec3),
    pub(super) near: f64,
    /// Of the silhouette.
    pub(super) mode: Mode,
}

/// The surface that each pixel sees.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Surface {
    /// Distance along z in metres; 0 where there is none.
    pub(super) depth: Vec<f32>,
    /// Unit normals in the camera frame, towards the camera; 0 where there is none.
    pub(super) normal: Vec<[f32; 3]>,
}

/// The layers of one frame, each drawn when it is first asked for.
#[derive(Debug)]
pub(super) struct Layers<'a> {
    pub(super) scene: &'a Scene,
    pub(super) frame: &'a Frame,
    silhouette: OnceCell<Vec<f32>>,
    surface: OnceCell<Surface>,
}

impl<'a> Layers<'a> {
    pub(super) fn new(scene: &'a Scene, frame: &'a Frame) -> Self {
        Self { scene, frame, silhouette: OnceCell::new(), surface: OnceCell::new() }
    }

    /// The mask in the mode of the scene, `(H, W)`.
    pub(super) fn silhouette(&self) -> Result<&[f32]> {
        if let Some(mask) = self.silhouette.get() {
            return Ok(mask);
        }
        let mask = self.mask(self.scene.mode)?;
        Ok(self.silhouette.get_or_init(|| mask))
    }

    /// The mask in any mode, `(H, W)`.
    pub(super) fn mask(&self, mode: Mode) -> Result<Vec<f32>> {
        let Scene { model, near, .. } = self.scene;
        let size = self.frame.size();
        let mut mask = vec![0.0; size.pixels()];
        let views = [self.frame.view];
        Batch { models: &[model], views: &views, size, mode, near: Some(*near) }.draw(&mut mask)?;
        Ok(mask)
    }

    /// The area of the mesh in each pixel, `(H, W)`.
    pub(super) fn exact(&self) -> Result<Vec<f32>> {
        self.mask(Mode::Coverage { sigma: 0.0 })
    }

    /// Something was drawn, and nothing of the mesh is in it.
    pub(super) fn shows_nothing(&self) -> bool {
        let blank_mask = self.silhouette.get().map(|m| m.iter().all(|m| *m == 0.0));
        let blank_surface = self.surface.get().map(|s| s.depth.iter().all(|d| *d == 0.0));
        blank_mask.or(blank_surface).is_some_and(|b| b && blank_surface.unwrap_or(true))
    }

    /// Depth and normals.
    pub(super) fn surface(&self) -> Result<&Surface> {
        if let Some(surface) = self.surface.get() {
            return Ok(surface);
        }
        let surface = surface(self.scene, self.frame)?;
        Ok(self.surface.get_or_init(|| surface))
    }
}

/// The nearest face at the centre of each pixel.
fn surface(scene: &Scene, frame: &Frame) -> Result<Surface> {
    let (Scene { model, near, .. }, size) = (scene, frame.size());
    let mut screen = Screen::default();
    screen.project(model, &frame.view, *near)?;
    let mut depth = vec![0.0_f32; size.pixels()];
    let mut normal = vec![[0.0_f32; 3]; size.pixels()];
    for face in screen.faces(model) {
        let [a, b, c] = face.map(|k| k as usize);
        let uv = [a, b, c].map(|k| [screen.u[k], screen.v[k]]);
        let p = [a, b, c].map(|k| DVec3::new(screen.x[k], screen.y[k], screen.z[k]));
        let cross = |p: [f64; 2], q: [f64; 2], r: [f64; 2]| {
            (q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0])
        };
        let area = cross(uv[0], uv[1], uv[2]);
        let n = (p[1] - p[0]).cross(p[2] - p[0]);
        let Some(n) = n.try_normalize().filter(|_| area != 0.0) else { continue };
        let n = if n.dot(p[0]) > 0.0 { -n } else { n };
        let range = |k: usize, limit: usize| {
            let values = uv.map(|q| q[k] - 0.5);
            let low = values.iter().fold(f64::INFINITY, |m, v| m.min(*v)).ceil().max(0.0);
            let high = values.iter().fold(f64::NEG_INFINITY, |m, v| m.max(*v)).floor();
            low as usize..((high + 1.0).max(0.0) as usize).min(limit)
        };
        for y in range(1, size.height) {
            for x in range(0, size.width) {
                let at = [x as f64 + 0.5, y as f64 + 0.5];
                let w = [
                    cross(at, uv[1], uv[2]) / area,
                    cross(uv[0], at, uv[2]) / area,
                    cross(uv[0], uv[1], at) / area,
                ];
                if w.iter().any(|w| *w < 0.0) {
                    continue;
                }
                let z = 1.0 / (w[0] / p[0].z + w[1] / p[1].z + w[2] / p[2].z);
                let pixel = y * size.width + x;
                if depth[pixel] == 0.0 || z < f64::from(depth[pixel]) {
                    depth[pixel] = z as f32;
                    normal[pixel] = n.as_vec3_array();
                }
            }
        }
    }
    Ok(Surface { depth, normal })
}

trait AsF32 {
    fn as_vec3_array(self) -> [f32; 3];
}

impl AsF32 for DVec3 {
    fn as_vec3_array(self) -> [f32; 3] {
        self.to_array().map(|c| c as f32)
    }
}
