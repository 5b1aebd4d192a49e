//! Colours of the surfaces, anti-aliased: `n x n` samples a pixel, shaded once for each face in it.
//!
//! Visibility is found at every sample. The samples of a pixel that see the same face are one
//! [`Patch`], shaded at the mean of their places, which is inside the face; so edges are smooth at
//! little more than the price of one sample. Colours are linear, so that means are physical.

use super::band::Band;
use super::normals::{flat, smooth};
use super::{Fragment, Scenes, Surface, band};
use crate::error::{Error, Result};
use crate::raster::View;

/// The largest number of samples along a side of a pixel.
pub const LARGEST_SAMPLES: usize = 8;

/// What is seen of one face in one pixel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Patch {
    /// Index of the image.
    pub image: usize,
    /// The face and the place on it.
    pub fragment: Fragment,
    /// Mean of the places of the samples in the image, pixels.
    pub centre: [f64; 2],
    /// Change of the barycentrics per pixel to the right, and down.
    pub slopes: [[f64; 3]; 2],
    /// Unit normal in the camera frame on the side of the camera: that of the vertices where the
    /// surface has them, else that of the face.
    pub normal: [f64; 3],
}

/// What gives surfaces their colour.
pub trait Shade: Sync {
    /// Linear RGB, and opacity, of a patch of a surface that is seen under a view.
    fn colour(&self, surface: &Surface<'_>, view: &View, patch: &Patch) -> [f32; 4];
}

/// Planes to write.
#[derive(Debug)]
pub struct Colours<'a> {
    /// `(B, H, W, 4)`: linear red, green and blue times the share of the pixel that is covered and
    /// the opacity there, and that share.
    pub colour: &'a mut [f32],
    /// `(B, H, W, M)`: the share of the pixel in which each surface is seen.
    pub shares: Option<&'a mut [f32]>,
    /// `(B, H, W)`: the share that shows what is behind the nearest surface: shares times what is
    /// missing of their opacity.
    pub veil: Option<&'a mut [f32]>,
}

impl Colours<'_> {
    /// The planes of the first `pixels` pixels, and the rest.
    fn split_at(self, pixels: usize, surfaces: usize) -> (Self, Self) {
        let (colour, rest) = self.colour.split_at_mut(4 * pixels);
        let (shares, others) =
            self.shares.map(|shares| shares.split_at_mut(surfaces * pixels)).unzip();
        let (veil, behind) = self.veil.map(|veil| veil.split_at_mut(pixels)).unzip();
        (Colours { colour, shares, veil }, Colours { colour: rest, shares: others, veil: behind })
    }
}

/// Draw the planes; every pixel is written.
///
/// # Errors
/// As [`Scenes::check`], and [`Error::Argument`] for `samples` outside 1 to [`LARGEST_SAMPLES`].
///
/// # Panics
/// If a plane has another length.
pub fn draw<'a>(
    scenes: &Scenes<'_>,
    samples: usize,
    shade: &impl Shade,
    out: Colours<'a>,
) -> Result<()> {
    scenes.check()?;
    if !(1..=LARGEST_SAMPLES).contains(&samples) {
        let message = format!("{samples}; expected 1 to {LARGEST_SAMPLES} along a side");
        return Err(Error::argument("samples", message));
    }
    let (pixels, count) = (scenes.size.pixels(), scenes.surfaces.len());
    assert_eq!(out.colour.len(), scenes.images() * pixels * 4, "colour: (B, H, W, 4)");
    if let Some(shares) = &out.shares {
        assert_eq!(shares.len(), scenes.images() * pixels * count, "shares: (B, H, W, M)");
    }
    if let Some(veil) = &out.veil {
        assert_eq!(veil.len(), scenes.images() * pixels, "veil: (B, H, W)");
    }
    let image = |image: usize, out: Colours<'a>| {
        let set_up = scenes.image(image, samples);
        let rows = band::band_rows(set_up.size, samples);
        let cut = |out: Colours<'a>, fine| out.split_at(fine / (samples * samples), count);
        band::draw(&set_up, rows, out, cut, |band, _, piece| {
            let views = set_up.views;
            let pixels = Pixels { band, surfaces: scenes.surfaces, views, image, samples };
            pixels.draw(scenes.size.width, shade, piece);
        })
    };
    let cut = |out: Colours<'a>, images: usize| out.split_at(images * pixels, count);
    band::for_each(0..scenes.images(), out, &cut, &image)
}

/// The samples of a pixel that see the same face.
#[derive(Debug, Clone, Copy, Default)]
struct Seen {
    id: u32,
    count: u32,
    /// Sum of the columns and rows of the samples within the pixel, and of `1/z`.
    place: [u32; 2],
    nearness: f64,
}

/// The pixels of a band.
struct Pixels<'a> {
    band: &'a Band<'a>,
    surfaces: &'a [Surface<'a>],
    views: &'a [View],
    image: usize,
    samples: usize,
}

impl Pixels<'_> {
    /// Write the rows of the band.
    fn draw(&self, width: usize, shade: &impl Shade, mut out: Colours<'_>) {
        let count = self.surfaces.len();
        out.colour.fill(0.0);
        if let Some(shares) = &mut out.shares {
            shares.fill(0.0);
        }
        if let Some(veil) = &mut out.veil {
            veil.fill(0.0);
        }
        let (n, dirty) = (self.samples, self.band.dirty);
        let share = 1.0 / (n * n) as f32;
        let mut seen = [Seen::default(); LARGEST_SAMPLES * LARGEST_SAMPLES];
        for row in dirty.rows.start / n..dirty.rows.end.div_ceil(n) {
            for column in dirty.columns.start / n..dirty.columns.end.div_ceil(n) {
                let pixel = row * width + column;
                let colour = &mut out.colour[4 * pixel..4 * pixel + 4];
                for seen in self.seen(row, column, &mut seen) {
                    let patch = self.patch(row, column, seen);
                    let surface = patch.fragment.surface;
                    let view = &self.views[surface];
                    let [r, g, b, opacity] = shade.colour(&self.surfaces[surface], view, &patch);
                    let weight = seen.count as f32 * share;
                    let shown = weight * opacity;
                    for (out, c) in colour.iter_mut().zip([shown * r, shown * g, shown * b, weight])
                    {
                        *out += c;
                    }
                    if let Some(veil) = &mut out.veil {
                        veil[pixel] += weight - shown;
                    }
                    if let Some(shares) = &mut out.shares {
                        shares[pixel * count + surface] += weight;
                    }
                }
            }
        }
    }

    /// The faces in a pixel, in the order in which its samples see them first.
    fn seen<'s>(&self, row: usize, column: usize, found: &'s mut [Seen]) -> &'s [Seen] {
        let n = self.samples;
        let columns = column * n..(column + 1) * n;
        let first = self.band.row(row * n).1[columns.start];
        let same = |y| self.band.row(row * n + y).1[columns.clone()].iter().all(|&id| id == first);
        if (0..n).all(same) {
            // Most pixels are inside one face, or empty.
            let nearness = |y| self.band.row(row * n + y).0[columns.clone()].iter().sum::<f64>();
            let sum = (n * n * (n - 1) / 2) as u32;
            let (count, nearness) = ((n * n) as u32, (0..n).map(nearness).sum());
            found[0] = Seen { id: first, count, place: [sum; 2], nearness };
            return if first == 0 { &[] } else { &found[..1] };
        }
        let mut count = 0;
        for y in 0..n {
            let (nearness, ids) = self.band.row(row * n + y);
            for x in 0..n {
                let (id, w) = (ids[column * n + x], nearness[column * n + x]);
                if id == 0 {
                    continue;
                }
                // Neighbours mostly see the same face: the last one is asked first.
                let known = found[..count].iter().rposition(|seen| seen.id == id);
                let place = known.unwrap_or(count);
                if place == count {
                    found[count] = Seen { id, ..Seen::default() };
                    count += 1;
                }
                let seen = &mut found[place];
                seen.count += 1;
                seen.place[0] += x as u32;
                seen.place[1] += y as u32;
                seen.nearness += w;
            }
        }
        &found[..count]
    }

    /// The patch of a face in a pixel.
    fn patch(&self, row: usize, column: usize, seen: &Seen) -> Patch {
        let (n, count) = (self.samples as f64, f64::from(seen.count));
        let within = seen.place.map(|sum| (f64::from(sum) / count + 0.5) / n);
        let top = self.band.rows.start / self.samples;
        let centre = [column as f64 + within[0], (top + row) as f64 + within[1]];
        let prepared = self.band.prepared;
        let (index, face) = prepared.find(seen.id);
        let (surface, screen) = (&self.surfaces[index], &prepared.screens[index]);
        let drawn = (surface.model, screen);
        // 1/z is affine in the image: its mean is that of the mean place.
        let depth = count / seen.nearness;
        let (fragment, slopes) = Fragment::with_slopes(drawn, (index, face), column, centre, depth);
        let corners = surface.model.faces()[fragment.face];
        let mut normal = flat(screen, corners);
        if let Some(vertices) = surface.normals {
            normal = smooth(&fragment, corners, vertices, &self.views[index].rotation, normal);
        }
        Patch { image: self.image, fragment, centre, slopes, normal }
    }
}

#[cfg(test)]
#[expect(clippy::float_cmp, reason = "colours of single texels are exact")]
mod tests {
    use super::*;
    use crate::camera::Intrinsics;
    use crate::gbuffer::coverage::{self, Share};
    use crate::raster::{Model, Size};
    use crate::shade::{Environment, Light, Look, Material, Materials, Paint, Texture};

    const SIZE: Size = Size { height: 24, width: 32 };

    fn view(translation: [f64; 3]) -> View {
        let rotation = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        let camera = Intrinsics::new(20.0, 22.0, 16.0, 12.0).unwrap();
        View { rotation, translation, camera }
    }

    /// A square of two triangles with corners at `+-side`, at z = 0.
    fn square(side: f64) -> (Model, Vec<[[f64; 2]; 3]>) {
        let points =
            [[-side, -side, 0.0], [side, -side, 0.0], [side, side, 0.0], [-side, side, 0.0]];
        let faces = vec![[0, 1, 2], [0, 2, 3]];
        // v is up in the texture, y down in the camera.
        let uv = [[0.0, 1.0], [1.0, 1.0], [1.0, 0.0], [0.0, 0.0]];
        let corners = faces.iter().map(|f: &[u32; 3]| f.map(|k| uv[k as usize])).collect();
        (Model::new(&points, &faces).unwrap(), corners)
    }

    /// Barycentrics of the patch and their slopes by differences.
    struct Slopes<'a>(&'a Model);

    impl Shade for Slopes<'_> {
        fn colour(&self, _: &Surface<'_>, view: &View, patch: &Patch) -> [f32; 4] {
            let corners = self.0.faces()[patch.fragment.face].map(|k| {
                let p = self.0.vertex(k as usize);
                let turned = view.rotation.map(|row| (0..3).map(|k| row[k] * p[k]).sum::<f64>());
                [0, 1, 2].map(|k| turned[k] + view.translation[k])
            });
            let place = |weights: [f64; 3]| {
                let p = [0, 1, 2].map(|c| (0..3).map(|k| weights[k] * corners[k][c]).sum::<f64>());
                let camera = &view.camera;
                [camera.fx * p[0] / p[2] + camera.cx, camera.fy * p[1] / p[2] + camera.cy]
            };
            let here = place(patch.fragment.barycentrics);
            assert!((here[0] - patch.centre[0]).abs() < 1e-9);
            assert!((here[1] - patch.centre[1]).abs() < 1e-9);
            for (axis, slope) in patch.slopes.iter().enumerate() {
                let h = 1e-5;
                let near = place([0, 1, 2].map(|k| patch.fragment.barycentrics[k] + h * slope[k]));
                for (c, (near, here)) in near.into_iter().zip(here).enumerate() {
                    let expected = if c == axis { h } else { 0.0 };
                    assert!((near - here - expected).abs() < 1e-3 * h, "{axis} {c}");
                }
            }
            [1.0; 4]
        }
    }

    #[test]
    fn places_and_slopes_are_those_of_the_image() {
        let points = [[-1.0, -0.6, 0.4], [1.1, -0.5, -0.3], [0.2, 0.9, 0.6], [-3.0, 2.0, -2.5]];
        let model = Model::new(&points, &[[0, 1, 2], [0, 2, 3]]).unwrap();
        let surfaces = [Surface::new(&model)];
        // The second image cuts faces at the near plane.
        let views = [view([0.0, 0.0, 3.0]), view([0.1, 0.2, 1.2])];
        let scenes = Scenes { surfaces: &surfaces, views: &views, size: SIZE, near: Some(0.05) };
        let mut out = vec![0.0; 2 * SIZE.pixels() * 4];
        let mut shares = vec![0.0; 2 * SIZE.pixels()];
        let planes = Colours { colour: &mut out, shares: Some(&mut shares), veil: None };
        draw(&scenes, 3, &Slopes(&model), planes).unwrap();
        let mut share = vec![0.0_f32; 2 * SIZE.pixels()];
        coverage::draw(&scenes, 3, Share::All, &mut share).unwrap();
        for (pixel, share) in out.as_chunks::<4>().0.iter().zip(&share) {
            assert!(pixel.iter().all(|x| (x - share).abs() < 1e-5), "{pixel:?} {share}");
        }
        assert!(shares.iter().zip(&share).all(|(a, b)| (a - b).abs() < 1e-5));
        assert!(share.iter().any(|&s| s > 0.0 && s < 1.0));
    }

    #[test]
    fn a_texture_lies_as_its_coordinates_say() {
        let (model, uv) = square(0.5);
        let texture =
            Texture::new((2, 2), &[255, 0, 0, 0, 255, 0, 0, 0, 255, 255, 255, 255]).unwrap();
        let surfaces = [Surface { uv: Some(&uv), ..Surface::new(&model) }];
        let views = [view([0.0, 0.0, 1.0])];
        let scenes = Scenes { surfaces: &surfaces, views: &views, size: SIZE, near: None };
        let material = [Material { paint: Paint::Texture(&texture), look: Look::Unlit }];
        let materials = Materials { of_surfaces: &[&material], of_faces: &[None], lights: &[] };
        materials.check(&surfaces, 1).unwrap();
        let mut out = vec![0.0; SIZE.pixels() * 4];
        draw(&scenes, 4, &materials, Colours { colour: &mut out, shares: None, veil: None })
            .unwrap();
        let at = |row: usize, column: usize| {
            let pixel = &out[4 * (row * SIZE.width + column)..][..4];
            [pixel[0], pixel[1], pixel[2]].map(|c| (c * 4.0).round() / 4.0)
        };
        // Corners of the square are at columns 6 and 26, rows 1 and 23.
        assert_eq!(at(6, 10), [1.0, 0.0, 0.0]);
        assert_eq!(at(6, 21), [0.0, 1.0, 0.0]);
        assert_eq!(at(17, 10), [0.0, 0.0, 1.0]);
        assert_eq!(at(17, 21), [1.0, 1.0, 1.0]);
        assert_eq!(at(6, 3), [0.0; 3]);
    }

    #[test]
    fn what_is_not_opaque_leaves_a_share_to_what_is_behind() {
        let (model, uv) = square(0.5);
        let texture = Texture::with_opacity((1, 1), &[255, 255, 255, 51]).unwrap();
        let surfaces = [Surface { uv: Some(&uv), ..Surface::new(&model) }];
        let views = [view([0.0, 0.0, 1.0])];
        let scenes = Scenes { surfaces: &surfaces, views: &views, size: SIZE, near: None };
        let material = [Material { paint: Paint::Texture(&texture), look: Look::Unlit }];
        let materials = Materials { of_surfaces: &[&material], of_faces: &[None], lights: &[] };
        let (mut out, mut veil) = (vec![0.0; SIZE.pixels() * 4], vec![9.0; SIZE.pixels()]);
        let planes = Colours { colour: &mut out, shares: None, veil: Some(&mut veil) };
        draw(&scenes, 2, &materials, planes).unwrap();
        for (pixel, veil) in out.as_chunks::<4>().0.iter().zip(&veil) {
            assert!((pixel[0] - 0.2 * pixel[3]).abs() < 1e-6, "{pixel:?}");
            assert!((veil - 0.8 * pixel[3]).abs() < 1e-6, "{veil} {pixel:?}");
        }
        assert!((veil[12 * SIZE.width + 16] - 0.8).abs() < 1e-6);
    }

    #[test]
    fn white_under_an_even_sky_gives_back_its_light() {
        let (model, _) = square(5.0);
        let surfaces = [Surface::new(&model)];
        let views = [view([0.0, 0.0, 1.0])];
        let scenes = Scenes { surfaces: &surfaces, views: &views, size: SIZE, near: None };
        let environment = Environment::new((8, 16), &[1.0; 8 * 16 * 3]).unwrap();
        let world_from_camera = [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]];
        let lights = [Light { environment: &environment, strength: 0.5, world_from_camera }];
        for (metallic, roughness) in [(0.0, 0.5), (0.0, 0.9), (1.0, 0.1)] {
            let look = Look::Lit { roughness, metallic };
            let material = [Material { paint: Paint::Colour([1.0; 3]), look }];
            let materials =
                Materials { of_surfaces: &[&material], of_faces: &[None], lights: &lights };
            materials.check(&surfaces, 1).unwrap();
            let mut out = vec![0.0; SIZE.pixels() * 4];
            draw(&scenes, 2, &materials, Colours { colour: &mut out, shares: None, veil: None })
                .unwrap();
            let middle = &out[4 * (12 * SIZE.width + 16)..][..4];
            // No light is made, and what is lost between facets is little.
            assert!(middle[0] > 0.46 && middle[0] < 0.51, "{metallic} {roughness}: {middle:?}");
        }
    }

    #[test]
    fn materials_that_do_not_fit_are_refused() {
        type Case<'a> = (&'a [Material<'a>], Option<&'a [u32]>, &'a str);
        let (model, _) = square(1.0);
        let surfaces = [Surface::new(&model)];
        let texture = Texture::new((1, 1), &[0; 3]).unwrap();
        let lit = Look::Lit { roughness: 0.5, metallic: 0.0 };
        let plain = Material { paint: Paint::Colour([0.5; 3]), look: Look::Unlit };
        let cases: [Case<'_>; 6] = [
            (&[], None, "at least one"),
            (&[plain], Some(&[0, 1]), "index 1 of 1"),
            (&[plain], Some(&[0]), "1 indices for 2 faces"),
            (&[Material { paint: Paint::Texture(&texture), ..plain }], None, "texture coordinates"),
            (&[Material { paint: Paint::Colour([f32::NAN; 3]), ..plain }], None, "colour"),
            (&[Material { look: lit, ..plain }], None, "lights"),
        ];
        for (materials, of_faces, message) in cases {
            let found = Materials { of_surfaces: &[materials], of_faces: &[of_faces], lights: &[] };
            let error = found.check(&surfaces, 1).unwrap_err().to_string();
            assert!(error.contains(message), "{error}");
        }
    }
}
