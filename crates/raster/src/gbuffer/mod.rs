//! What is seen at each pixel: surface, face, depth, barycentrics, normals, attributes, motion.
//!
//! Point samples at the centres of the pixels, with a z-buffer over all surfaces of a view. Both
//! sides of a triangle are seen, a triangle holds its edges and corners, one without area holds
//! nothing. Of surfaces at the same depth the first is seen, and of its faces that of the lowest
//! index. Faces are cut at the near plane; ids and barycentrics are those of the whole face.
//!
//! The stages of an image:
//!
//! 1. `setup`: every surface as a [`Screen`](crate::raster::Screen); faces that can hold a pixel
//!    centre become edge functions and an affine function for `1/z`.
//! 2. `band`: bands of rows, in parallel, each with a z-buffer in `f64`.
//! 3. `resolve`: the planes that were asked for, from the ids; what needs barycentrics goes through
//!    [`Fragment`]s. [`flow`] and [`coverage`] resolve the same bands in their own way.
//!
//! All numbers are computed in `f64` without fused operations and rounded once, so they depend
//! neither on the processor nor on the number of threads.
#![expect(
    clippy::cast_possible_wrap,
    reason = "pixels and faces are bounded far below 2^31 where they are signed"
)]
#![expect(
    clippy::inline_always,
    clippy::needless_bitwise_bool,
    reason = "loops over lanes have to be compiled for the wide registers, and without branches"
)]

pub mod appearance;
#[cfg(all(target_arch = "x86_64", not(target_feature = "avx512f")))]
mod avx512;
mod band;
pub mod coverage;
pub mod flow;
mod fragment;
pub mod normals;
#[cfg(test)]
mod oracle;
mod resolve;
mod setup;
#[cfg(test)]
mod tests;
mod tiles;

use self::band::Dirty;
pub use self::fragment::Fragment;
use self::setup::Image;
use crate::error::{Error, Result};
use crate::raster::{Background, DEFAULT_NEAR, Model, Pixel, Plain, Size, View};
use crate::threads;

/// The largest height and width in pixels.
pub const LARGEST_SIDE: usize = 16_384;

/// A mesh of the scene with what is interpolated over it.
#[derive(Debug, Clone, Copy)]
pub struct Surface<'a> {
    /// Vertices and faces.
    pub model: &'a Model,
    /// Normals of the vertices in the model frame, `V` of them, as from [`normals::of_vertices`].
    pub normals: Option<&'a [[f64; 3]]>,
    /// Values at the vertices, `(V, C)`.
    pub attributes: Option<&'a [f64]>,
    /// Texture coordinates of the corners of each face.
    pub uv: Option<&'a [[[f64; 2]; 3]]>,
}

impl<'a> Surface<'a> {
    /// A mesh and nothing else.
    #[must_use]
    pub fn new(model: &'a Model) -> Self {
        Self { model, normals: None, attributes: None, uv: None }
    }
}

/// Images to draw: the same surfaces, each under a pose of its own in every image.
#[derive(Debug, Clone, Copy)]
pub struct Scenes<'a> {
    /// The surfaces, `M`.
    pub surfaces: &'a [Surface<'a>],
    /// Poses and cameras `(B, M)`.
    pub views: &'a [View],
    /// Rows and columns.
    pub size: Size,
    /// Distance to the near plane in metres; `None` is [`DEFAULT_NEAR`].
    pub near: Option<f64>,
}

/// Which normals are drawn.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Normals {
    /// Those of the faces.
    #[default]
    Flat,
    /// Those of the vertices ([`Surface::normals`]), interpolated.
    Smooth,
}

/// The planes to write, `(B, H, W)` or `(B, H, W, channels)` each; every pixel is written.
#[derive(Debug, Default)]
pub struct GBuffer<'a, T> {
    /// Whether something is seen.
    pub mask: Option<&'a mut [bool]>,
    /// Index of the surface, -1 where there is none.
    pub object: Option<&'a mut [i32]>,
    /// Index of the face in its mesh, -1 where there is none.
    pub face: Option<&'a mut [i32]>,
    /// `z` in the camera frame in metres, 0 where there is nothing.
    pub depth: Option<&'a mut [T]>,
    /// Three weights of the corners of the face, on the surface (not in the image), zero where
    /// there is nothing.
    pub barycentrics: Option<&'a mut [T]>,
    /// Unit normal in the camera frame on the side of the camera, zero where there is nothing.
    pub normal: Option<&'a mut [T]>,
    /// Interpolated attributes, `C` channels.
    pub attributes: Option<&'a mut [T]>,
    /// Interpolated texture coordinates, two channels.
    pub uv: Option<&'a mut [T]>,
}

/// How planes are cleared that are written over in part.
struct Blank<'a> {
    background: Background,
    width: usize,
    /// The part that may be written over.
    dirty: &'a Dirty,
}

impl Blank<'_> {
    fn fill<X: Plain>(&self, plane: &mut [X], channels: usize, value: X) {
        if self.background == Background::Near || channels == 0 {
            plane.fill(value); // fastest in one piece
            return;
        }
        let width = channels * self.width;
        let Dirty { rows, columns } = self.dirty;
        let columns = channels * columns.start..channels * columns.end;
        self.background.fill_around(plane, value, width, (rows.clone(), columns.clone()));
        for row in plane.chunks_exact_mut(width).take(rows.end).skip(rows.start) {
            row[columns.clone()].fill(value);
        }
    }
}

/// The first `count` entries of a plane, which keeps the rest.
fn split<'a, X>(plane: &mut Option<&'a mut [X]>, count: usize) -> Option<&'a mut [X]> {
    let (head, tail) = plane.take()?.split_at_mut(count);
    *plane = Some(tail);
    Some(head)
}

impl<T: Pixel> GBuffer<'_, T> {
    /// Nothing anywhere.
    fn clear(&mut self, blank: &Blank<'_>, channels: usize) {
        if let Some(mask) = &mut self.mask {
            blank.fill(mask, 1, false);
        }
        for ids in [&mut self.object, &mut self.face].into_iter().flatten() {
            blank.fill(ids, 1, -1);
        }
        for (plane, channels) in [
            (&mut self.depth, 1),
            (&mut self.barycentrics, 3),
            (&mut self.normal, 3),
            (&mut self.attributes, channels),
            (&mut self.uv, 2),
        ] {
            if let Some(plane) = plane {
                blank.fill(plane, channels, T::default());
            }
        }
    }

    /// Memory of all planes.
    fn bytes(&self) -> usize {
        let ids = [&self.object, &self.face];
        let floats = [&self.depth, &self.barycentrics, &self.normal, &self.attributes, &self.uv];
        self.mask.as_ref().map_or(0, |plane| size_of_val(&**plane))
            + ids.into_iter().flatten().map(|plane| size_of_val(&**plane)).sum::<usize>()
            + floats.into_iter().flatten().map(|plane| size_of_val(&**plane)).sum::<usize>()
    }

    /// Whether no plane is there.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        let floats = [&self.depth, &self.barycentrics, &self.normal, &self.attributes, &self.uv];
        self.mask.is_none()
            && self.object.is_none()
            && self.face.is_none()
            && floats.iter().all(|plane| plane.is_none())
    }

    /// The planes of the next `pixels` pixels.
    fn split(&mut self, pixels: usize, channels: usize) -> Self {
        GBuffer {
            mask: split(&mut self.mask, pixels),
            object: split(&mut self.object, pixels),
            face: split(&mut self.face, pixels),
            depth: split(&mut self.depth, pixels),
            barycentrics: split(&mut self.barycentrics, 3 * pixels),
            normal: split(&mut self.normal, 3 * pixels),
            attributes: split(&mut self.attributes, channels * pixels),
            uv: split(&mut self.uv, 2 * pixels),
        }
    }

    fn assert_lengths(&self, pixels: usize, channels: usize) {
        let check = |name: &str, found: Option<usize>, channels: usize| {
            if let Some(found) = found {
                assert_eq!(found, channels * pixels, "{name}: (B, H, W, {channels})");
            }
        };
        check("mask", self.mask.as_ref().map(|p| p.len()), 1);
        check("object", self.object.as_ref().map(|p| p.len()), 1);
        check("face", self.face.as_ref().map(|p| p.len()), 1);
        check("depth", self.depth.as_ref().map(|p| p.len()), 1);
        check("barycentrics", self.barycentrics.as_ref().map(|p| p.len()), 3);
        check("normal", self.normal.as_ref().map(|p| p.len()), 3);
        check("attributes", self.attributes.as_ref().map(|p| p.len()), channels);
        check("uv", self.uv.as_ref().map(|p| p.len()), 2);
    }
}

impl Scenes<'_> {
    /// Number of images.
    #[must_use]
    pub fn images(&self) -> usize {
        if self.surfaces.is_empty() { 0 } else { self.views.len() / self.surfaces.len() }
    }

    /// On how many threads to draw where nobody asked for a number (0): on one, that of the caller, if
    /// it is a single image of one band. Results do not depend on it.
    #[must_use]
    pub fn threads(&self, asked: usize) -> usize {
        threads::or_one(asked, self.images() == 1 && self.size.pixels() <= threads::SMALL_IMAGE)
    }

    /// The near plane in metres.
    fn near(&self) -> f64 {
        self.near.unwrap_or(DEFAULT_NEAR)
    }

    /// One of the images, with so many samples along the side of a pixel.
    fn image(&self, index: usize, samples: usize) -> Image<'_> {
        let count = self.surfaces.len();
        let size = Size { height: self.size.height * samples, width: self.size.width * samples };
        Image {
            surfaces: self.surfaces,
            views: &self.views[index * count..(index + 1) * count],
            near: self.near(),
            size,
            samples,
        }
    }

    /// Channels of the attributes: those of the first surface that has any.
    #[must_use]
    pub fn attribute_channels(&self) -> usize {
        let channels = |s: &Surface<'_>| Some(s.attributes?.len() / s.model.vertex_count());
        self.surfaces.iter().find_map(channels).unwrap_or(0)
    }

    /// Refuses what cannot be drawn, by name.
    ///
    /// # Errors
    /// [`Error::Argument`]: no surface, a number of views that is no multiple of theirs, an image
    /// without pixels or beyond [`LARGEST_SIDE`], a near plane outside 1e-9 to 1e9 m, normals,
    /// attributes or texture coordinates of a wrong number or not finite; and as [`View::check`].
    pub fn check(&self) -> Result<()> {
        let refuse = |name: String, message: String| Err(Error::argument(name, message));
        for (name, value) in [("height", self.size.height), ("width", self.size.width)] {
            if !(1..=LARGEST_SIDE).contains(&value) {
                let message = format!("{value}; expected 1 to {LARGEST_SIDE} pixels");
                return refuse(name.to_owned(), message);
            }
        }
        let count = self.surfaces.len();
        if count == 0 {
            return refuse("mesh".to_owned(), "expected at least one".to_owned());
        }
        if !self.views.len().is_multiple_of(count) {
            let message = format!("{} poses for {count} meshes in each image", self.views.len());
            return refuse("R".to_owned(), message);
        }
        if let Some(near) = self.near
            && !(1e-9..=1e9).contains(&near)
        {
            return refuse("near".to_owned(), format!("{near} m; expected 1e-9 to 1e9 m"));
        }
        let faces: usize = self.surfaces.iter().map(|s| s.model.faces().len()).sum();
        if faces > (u32::MAX / 2 - 1) as usize {
            return refuse("mesh".to_owned(), format!("{faces} faces are more than fit"));
        }
        let channels = self.attribute_channels();
        for (k, surface) in self.surfaces.iter().enumerate() {
            let (vertices, faces) = (surface.model.vertex_count(), surface.model.faces().len());
            let normals = surface.normals.map(<[_]>::as_flattened);
            let uv = surface.uv.map(|uv| uv.as_flattened().as_flattened());
            for (name, values, expected) in [
                ("normals", normals, 3 * vertices),
                ("attributes", surface.attributes, channels * vertices),
                ("uv", uv, 6 * faces),
            ] {
                let Some(values) = values else { continue };
                if values.len() != expected {
                    let message = format!("{} numbers, expected {expected}", values.len());
                    return refuse(format!("{name}[{k}]"), message);
                }
                if let Some(bad) = values.iter().find(|x| !x.is_finite()) {
                    let message = format!("found {bad}, expected finite numbers");
                    return refuse(format!("{name}[{k}]"), message);
                }
            }
        }
        self.views.iter().enumerate().try_for_each(|(row, view)| view.check(row))
    }

    /// Draw all images into the planes that are there, on rayon's current pool.
    ///
    /// Surfaces without attributes or texture coordinates have zeros there.
    ///
    /// # Errors
    /// As [`Scenes::check`], a vertex further than 1e12 m away, and [`Error::Argument`] where smooth
    /// normals are asked for and a surface has none.
    ///
    /// # Panics
    /// If a plane has another length.
    pub fn draw<'a, T: Pixel>(&self, normals: Normals, out: GBuffer<'a, T>) -> Result<()> {
        self.check()?;
        let smooth = out.normal.is_some() && normals == Normals::Smooth;
        if smooth && self.surfaces.iter().any(|s| s.normals.is_none()) {
            return Err(Error::argument("normals", "smooth normals need those of the vertices"));
        }
        let (channels, pixels) = (self.attribute_channels(), self.size.pixels());
        out.assert_lengths(self.images() * pixels, channels);
        let background = Background::of(out.bytes());
        let cut = |mut out: GBuffer<'a, T>, pixels: usize| (out.split(pixels, channels), out);
        let image = |image: usize, out: GBuffer<'a, T>| {
            let set_up = self.image(image, 1);
            let rows = band::band_rows(self.size, 1);
            band::draw(&set_up, rows, out, cut, |band, fragments, out| {
                let surfaces = (self.surfaces, set_up.views);
                let wanted = (normals, channels, background);
                resolve::resolve(band, surfaces, wanted, fragments, out);
            })
        };
        let cut_images = |out, images: usize| cut(out, images * pixels);
        band::for_each(0..self.images(), out, &cut_images, &image)
    }
}
