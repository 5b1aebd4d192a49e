//! The numbers that are drawn: masks and surfaces of a frame. The only place here that calls the
//! rasteriser.

use std::cell::OnceCell;

use glam::DVec3;

use super::frames::Frame;
use crate::error::Result;
use crate::gbuffer::{self, GBuffer, Normals, Scenes};
use crate::raster::{Batch, Mode, Model};

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
    let size = frame.size();
    let mut surface =
        Surface { depth: vec![0.0; size.pixels()], normal: vec![[0.0; 3]; size.pixels()] };
    let planes = GBuffer {
        depth: Some(&mut surface.depth),
        normal: Some(surface.normal.as_flattened_mut()),
        ..GBuffer::default()
    };
    let surfaces = [gbuffer::Surface::new(&scene.model)];
    let views = [frame.view];
    let scenes = Scenes { surfaces: &surfaces, views: &views, size, near: Some(scene.near) };
    scenes.draw(Normals::Flat, planes)?;
    Ok(surface)
}
