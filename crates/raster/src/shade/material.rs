//! Materials of the faces of surfaces, and how they are lit.

use super::{Environment, Texture, ggx};
use crate::error::{Error, Result};
use crate::gbuffer::appearance::{Patch, Shade};
use crate::gbuffer::{Fragment, Surface};
use crate::raster::View;

/// The colour of a material.
#[derive(Debug, Clone, Copy)]
pub enum Paint<'a> {
    /// One linear RGB for all of it.
    Colour([f32; 3]),
    /// An image, at the texture coordinates of the surface.
    Texture(&'a Texture),
}

/// How a material answers to light.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Look {
    /// The paint is what is seen: light and shadow are in it, as in a scan.
    Unlit,
    /// The paint is the share of light that is given back; lit by the image's [`Light`].
    Lit {
        /// 0 is a mirror, 1 scatters; GGX with the square of it.
        roughness: f64,
        /// 0 for plastics and paints, which mirror 4 % at normal incidence, 1 for metals.
        metallic: f64,
    },
}

/// What a face is made of.
#[derive(Debug, Clone, Copy)]
pub struct Material<'a> {
    /// Its colour.
    pub paint: Paint<'a>,
    /// How it answers to light.
    pub look: Look,
}

/// Light from all sides on what is lit in an image.
#[derive(Debug, Clone, Copy)]
pub struct Light<'a> {
    /// The panorama, in the frame of the world.
    pub environment: &'a Environment,
    /// Factor of its radiance.
    pub strength: f32,
    /// Rotation from the camera frame to that of the panorama.
    pub world_from_camera: [[f64; 3]; 3],
}

/// What the surfaces of a scene are made of.
#[derive(Debug, Clone, Copy)]
pub struct Materials<'a> {
    /// Materials of each surface, at least one.
    pub of_surfaces: &'a [&'a [Material<'a>]],
    /// The material of each face by its index; `None` is the first for all.
    pub of_faces: &'a [Option<&'a [u32]>],
    /// The light of each image, or none where nothing is lit.
    pub lights: &'a [Light<'a>],
}

impl Materials<'_> {
    /// Refuses what would not fit the surfaces and images.
    ///
    /// # Errors
    /// [`Error::Argument`]: a number of lists that is not that of the surfaces, a surface without
    /// materials, an index of a material that is not there, texture coordinates that are missing, a
    /// roughness or metallic share outside 0 to 1, a colour that is negative or not finite, lights
    /// that are neither one for each image nor unneeded, a strength that is negative or not finite.
    pub fn check(&self, surfaces: &[Surface<'_>], images: usize) -> Result<()> {
        let refuse = |name: String, message: String| Err(Error::argument(name, message));
        let count = surfaces.len();
        if self.of_surfaces.len() != count || self.of_faces.len() != count {
            let message = format!("{} lists for {count} meshes", self.of_surfaces.len());
            return refuse("materials".to_owned(), message);
        }
        let mut lit = false;
        for (k, (surface, materials)) in surfaces.iter().zip(self.of_surfaces).enumerate() {
            let name = format!("materials[{k}]");
            if materials.is_empty() {
                return refuse(name, "expected at least one".to_owned());
            }
            for material in *materials {
                match material.paint {
                    Paint::Texture(_) if surface.uv.is_none() => {
                        return refuse(name, "a texture needs texture coordinates".to_owned());
                    }
                    Paint::Colour(c) if c.iter().any(|c| !c.is_finite() || *c < 0.0) => {
                        return refuse(name, format!("colour {c:?}; expected numbers >= 0"));
                    }
                    _ => {}
                }
                if let Look::Lit { roughness, metallic } = material.look {
                    lit = true;
                    if !(0.0..=1.0).contains(&roughness) || !(0.0..=1.0).contains(&metallic) {
                        let message =
                            format!("roughness {roughness}, metallic {metallic}; expected 0 to 1");
                        return refuse(name, message);
                    }
                }
            }
            if let Some(of_faces) = self.of_faces[k] {
                let faces = surface.model.faces().len();
                if of_faces.len() != faces {
                    let message = format!("{} indices for {faces} faces", of_faces.len());
                    return refuse(name, message);
                }
                if let Some(bad) = of_faces.iter().find(|&&m| m as usize >= materials.len()) {
                    let message = format!("index {bad} of {} materials", materials.len());
                    return refuse(name, message);
                }
            }
        }
        if lit && self.lights.len() != images {
            let message = format!("{} for {images} images with lit materials", self.lights.len());
            return refuse("lights".to_owned(), message);
        }
        let wrong = |light: &&Light<'_>| !(light.strength >= 0.0 && light.strength.is_finite());
        if let Some(light) = self.lights.iter().find(wrong) {
            let message = format!("strength {}; expected a number >= 0", light.strength);
            return refuse("lights".to_owned(), message);
        }
        Ok(())
    }
}

impl Shade for Materials<'_> {
    fn colour(&self, surface: &Surface<'_>, view: &View, patch: &Patch) -> [f32; 4] {
        let Fragment { surface: index, face, .. } = patch.fragment;
        let which = self.of_faces[index].map_or(0, |of_faces| of_faces[face] as usize);
        let material = &self.of_surfaces[index][which];
        let [r, g, b, opacity] = match (material.paint, surface.uv) {
            (Paint::Colour([r, g, b]), _) => [r, g, b, 1.0],
            (Paint::Texture(texture), Some(uv)) => textured(texture, &uv[face], patch),
            (Paint::Texture(texture), None) => texture.smallest(),
        };
        let [r, g, b] = match (material.look, self.lights.get(patch.image)) {
            (Look::Lit { roughness, metallic }, Some(light)) => {
                lit(light, view, patch, [r, g, b], (roughness, metallic as f32))
            }
            _ => [r, g, b],
        };
        [r, g, b, opacity]
    }
}

/// The texture behind a patch, over its footprint.
fn textured(texture: &Texture, corners: &[[f64; 2]; 3], patch: &Patch) -> [f32; 4] {
    let along =
        |weights: [f64; 3]| [0, 1].map(|c| (0..3).map(|k| weights[k] * corners[k][c]).sum::<f64>());
    texture.sample(along(patch.fragment.barycentrics), patch.slopes.map(along))
}

/// Light of a panorama, scattered and mirrored.
fn lit(
    light: &Light<'_>,
    view: &View,
    patch: &Patch,
    colour: [f32; 3],
    (roughness, metallic): (f64, f32),
) -> [f32; 3] {
    let n = patch.normal;
    let to_camera = towards_camera(view, patch.centre);
    let facing = dot(n, to_camera);
    // A normal of the vertices may point away from the camera at the rim.
    let cosine = facing.max(1e-3);
    let mirrored = [0, 1, 2].map(|k| 2.0 * facing * n[k] - to_camera[k]);
    let world = |d: [f64; 3]| light.world_from_camera.map(|row| dot(row, d));
    let scattered = light.environment.scattered(world(n));
    let mirrored = light.environment.mirrored(world(mirrored), roughness);
    let [scale, offset] = ggx::scale_and_offset(cosine, roughness);
    [0, 1, 2].map(|k| {
        let base = 0.04 + metallic * (colour[k] - 0.04);
        let mirror = base * scale + offset;
        let scatter = colour[k] * (1.0 - metallic) * (1.0 - mirror);
        light.strength * (scatter * scattered[k] + mirror * mirrored[k])
    })
}

/// Unit direction from the surface behind a place in the image to the camera, camera frame.
fn towards_camera(view: &View, [u, v]: [f64; 2]) -> [f64; 3] {
    let camera = &view.camera;
    let y = (v - camera.cy) / camera.fy;
    let x = (u - camera.cx - camera.skew * y) / camera.fx;
    let length = (x * x + y * y + 1.0).sqrt();
    [-x / length, -y / length, -1.0 / length]
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}
