//! Optical flow: where the point seen at a pixel is in a second image, and whether it is seen there.
//!
//! Analytic, from the barycentrics of the point: object and camera move rigidly between the images,
//! each object by itself. Whether something hides the point is asked at its very place in the second
//! image, against every face there, and not in a depth image of rounded places.

use rayon::prelude::*;

use super::setup::{Image, Keep, Prepared};
use super::tiles::Tiles;
use super::{Fragment, Scenes, band};
use crate::camera::Intrinsics;
use crate::error::{Error, Result};
use crate::raster::{Pixel, Size, View};

/// A surface hides a point if it is nearer by more than this share of the depth, where the caller
/// names none.
pub const DEFAULT_TOLERANCE: f64 = 1e-6;

/// What became of the point behind a pixel.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
#[repr(u8)]
pub enum Fate {
    /// There is no point, or no motion is known for it; the flow is 0.
    #[default]
    None = 0,
    /// It is seen in the second image.
    Visible = 1,
    /// It is in the second image, behind another surface (or another part of the same).
    Occluded = 2,
    /// It is outside the second image.
    Outside = 3,
    /// It is nearer than the near plane, or behind the camera; the flow is 0.
    Behind = 4,
}

/// What is behind all surfaces: points at one depth in the first camera, fixed in a world in which
/// the camera moves.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Background {
    /// `R` of `cam1_from_cam0`, row by row.
    pub rotation: [[f64; 3]; 3],
    /// `t` of `cam1_from_cam0`, in metres.
    pub translation: [f64; 3],
    /// `z` in the first camera in metres; may be infinite.
    pub depth: f64,
}

/// Pairs of images.
#[derive(Debug, Clone, Copy)]
pub struct Pairs<'a> {
    /// The first images.
    pub first: Scenes<'a>,
    /// Poses and cameras `(B, M)` of the second.
    pub second: &'a [View],
    /// Rows and columns of the second.
    pub second_size: Size,
    /// What is behind the surfaces, for each pair; without it, pixels there have no flow.
    pub backgrounds: Option<&'a [Background]>,
    /// See [`DEFAULT_TOLERANCE`].
    pub tolerance: Option<f64>,
}

impl Pairs<'_> {
    fn second(&self) -> Scenes<'_> {
        Scenes { views: self.second, size: self.second_size, ..self.first }
    }

    /// Refuses what has no flow, by name.
    ///
    /// # Errors
    /// As [`Scenes::check`] for both images; [`Error::Argument`] for other numbers of views or
    /// backgrounds, a tolerance outside `0..1`, and a background that is not finite (its depth may
    /// be infinite) or not in front of the camera.
    pub fn check(&self) -> Result<()> {
        self.first.check()?;
        self.second().check()?;
        if self.second.len() != self.first.views.len() {
            let message = format!(
                "{} poses, {} in the first images",
                self.second.len(),
                self.first.views.len()
            );
            return Err(Error::argument("R1", message));
        }
        if let Some(tolerance) = self.tolerance
            && !(0.0..1.0).contains(&tolerance)
        {
            return Err(Error::argument(
                "tolerance",
                format!("{tolerance}; expected 0 to below 1"),
            ));
        }
        let Some(backgrounds) = self.backgrounds else { return Ok(()) };
        if backgrounds.len() != self.first.images() {
            let message = format!("{} for {} images", backgrounds.len(), self.first.images());
            return Err(Error::argument("camera_motion", message));
        }
        for (row, b) in backgrounds.iter().enumerate() {
            let mut entries = b.rotation.as_flattened().iter().chain(&b.translation);
            if let Some(bad) = entries.find(|c| !c.is_finite()) {
                let message = format!("found {bad}, expected finite numbers");
                return Err(Error::argument(format!("camera_motion[{row}]"), message));
            }
            if b.depth.is_nan() || b.depth <= 0.0 {
                let message = format!("{} m; expected a depth above 0, or infinity", b.depth);
                return Err(Error::argument("background_depth", message));
            }
        }
        Ok(())
    }

    /// Draw the flow `(B, H, W, 2)` in pixels and the [`Fate`] `(B, H, W)` of all pixels of the
    /// first images, on rayon's current pool; every entry is written.
    ///
    /// The flow is the place `(u, v)` in the second image minus the centre of the pixel.
    ///
    /// # Errors
    /// As [`Pairs::check`], and a vertex further than 1e12 m away.
    ///
    /// # Panics
    /// If an output has another length.
    pub fn draw<T: Pixel>(&self, flow: &mut [T], fate: &mut [Fate]) -> Result<()> {
        self.check()?;
        let pixels = self.first.size.pixels();
        assert_eq!(fate.len(), self.first.images() * pixels, "fate: (B, H, W)");
        assert_eq!(flow.len(), 2 * fate.len(), "flow: (B, H, W, 2)");
        let images = flow
            .par_chunks_exact_mut(2 * pixels)
            .zip(fate.par_chunks_exact_mut(pixels))
            .enumerate();
        images.try_for_each(|(image, (flow, fate))| {
            band::with_prepared(|after| self.pair(image, after, flow, fate))
        })
    }

    /// One pair of images.
    fn pair<T: Pixel>(
        &self,
        image: usize,
        after: &mut Prepared,
        flow: &mut [T],
        fate: &mut [Fate],
    ) -> Result<()> {
        let before = self.first.image(image, 1);
        let Image { surfaces, views, near, size, .. } = before;
        let second = &self.second[image * surfaces.len()..(image + 1) * surfaces.len()];
        let later = Image { views: second, size: self.second_size, ..before };
        after.prepare(&later, Keep::Touched)?;
        let tiles = Tiles::new(after, self.second_size);
        let slack = 1.0 + self.tolerance.unwrap_or(DEFAULT_TOLERANCE);
        let arrival = |p: [f64; 3], camera: &Intrinsics, far: bool| -> ([f64; 2], Fate) {
            if if far { p[2] <= 0.0 } else { p[2] < near } {
                return ([0.0; 2], Fate::Behind);
            }
            let u = (camera.fx * p[0] + camera.skew * p[1]) / p[2] + camera.cx;
            let v = camera.fy * p[1] / p[2] + camera.cy;
            if !(u.is_finite() && v.is_finite()) {
                return ([0.0; 2], Fate::Behind);
            }
            let Size { height, width } = self.second_size;
            let inside = u >= 0.0 && v >= 0.0 && u < width as f64 && v < height as f64;
            let nearness = if far { 0.0 } else { slack / p[2] };
            let fate = match inside {
                false => Fate::Outside,
                true if tiles.hides(after, [u, v], nearness) => Fate::Occluded,
                true => Fate::Visible,
            };
            ([u, v], fate)
        };
        let seen = |f: &Fragment| {
            let screen = &after.screens[f.surface];
            let face = surfaces[f.surface].model.faces()[f.face].map(|k| k as usize);
            let corners = face.map(|k| [screen.x[k], screen.y[k], screen.z[k]]);
            arrival(f.mix_points(corners), &second[f.surface].camera, false)
        };
        let background = self.backgrounds.map(|b| b[image]);
        let behind = |b: &Background, centre: [f64; 2]| {
            let k = &views[0].camera;
            let y = (centre[1] - k.cy) / k.fy;
            let ray = [(centre[0] - k.cx - k.skew * y) / k.fx, y, 1.0];
            let far = b.depth.is_infinite();
            let p = [0, 1, 2].map(|row| {
                let turned: f64 = b.rotation[row].iter().zip(ray).map(|(r, x)| r * x).sum();
                if far { turned } else { turned * b.depth + b.translation[row] }
            });
            arrival(p, &second[0].camera, far)
        };
        let rows = band::band_rows(size, 1);
        band::draw(&before, rows, (flow, fate), cut, |band, fragments, (flow, fate)| {
            let rows = flow.chunks_exact_mut(2 * size.width).zip(fate.chunks_exact_mut(size.width));
            for (row, (flow, fate)) in rows.enumerate() {
                let v = (band.rows.start + row) as f64 + 0.5;
                if background.is_none() {
                    flow.fill(T::default());
                    fate.fill(Fate::None);
                }
                let mut write = |column: usize, (place, found): ([f64; 2], Fate)| {
                    let known = !matches!(found, Fate::Behind | Fate::None);
                    let centre = [column as f64 + 0.5, v];
                    for k in 0..2 {
                        let moved = if known { place[k] - centre[k] } else { 0.0 };
                        flow[2 * column + k] = T::from_f64(moved);
                    }
                    fate[column] = found;
                };
                band.fragments(row, surfaces, fragments);
                if let Some(background) = &background {
                    let mut seen = fragments.iter().map(|f| f.column).peekable();
                    for column in 0..size.width {
                        if seen.next_if_eq(&column).is_none() {
                            write(column, behind(background, [column as f64 + 0.5, v]));
                        }
                    }
                }
                for f in &*fragments {
                    write(f.column, seen(f));
                }
            }
        })
    }
}

/// Flow and fate of pixels.
type Planes<'a, T> = (&'a mut [T], &'a mut [Fate]);

/// Those of the first so many pixels, and of the rest.
fn cut<T>((flow, fate): Planes<'_, T>, pixels: usize) -> (Planes<'_, T>, Planes<'_, T>) {
    let (flow, rest) = flow.split_at_mut(2 * pixels);
    let (fate, last) = fate.split_at_mut(pixels);
    ((flow, fate), (rest, last))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gbuffer::oracle::{Planes, in_camera, planes, project};
    use crate::gbuffer::{Normals, Surface};
    use crate::raster::Model;
    use crate::threads;

    const SIZE: Size = Size { height: 24, width: 32 };
    const STILL: [[f64; 3]; 3] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];

    fn view(translation: [f64; 3]) -> View {
        let camera = Intrinsics::new(32.0, 32.0, 16.0, 12.0).expect("valid");
        View { rotation: STILL, translation, camera }
    }

    fn square(half: f64) -> Model {
        let v = [[-half, -half, 0.0], [half, -half, 0.0], [half, half, 0.0], [-half, half, 0.0]];
        Model::new(&v, &[[0, 1, 2], [0, 2, 3]]).expect("valid")
    }

    /// A turn about an axis near `(1, 2, 3)`.
    fn turn(angle: f64) -> [[f64; 3]; 3] {
        let q = glam::DQuat::from_axis_angle(glam::DVec3::new(1.0, 2.0, 3.0).normalize(), angle);
        let m = glam::DMat3::from_quat(q).transpose();
        m.to_cols_array_2d()
    }

    fn run(
        models: &[Model],
        first: &[View],
        second: &[View],
        backgrounds: Option<&[Background]>,
    ) -> (Planes<f64>, Vec<f64>, Vec<Fate>) {
        let surfaces: Vec<_> = models.iter().map(Surface::new).collect();
        let scenes = Scenes { surfaces: &surfaces, views: first, size: SIZE, near: Some(0.1) };
        let n = scenes.images() * SIZE.pixels();
        let (mut flow, mut fate) = (vec![7.0; 2 * n], vec![Fate::Behind; n]);
        let pairs =
            Pairs { first: scenes, second, second_size: SIZE, backgrounds, tolerance: None };
        pairs.draw(&mut flow, &mut fate).expect("drawn");
        (planes(&scenes, Normals::Flat), flow, fate)
    }

    #[test]
    fn nothing_moves_and_everything_stays_visible() {
        let models = [square(0.5), square(0.9)];
        let tilted = View { rotation: turn(0.8), ..view([0.1, 0.0, 2.0]) };
        let views = [tilted, view([0.0, 0.1, 2.1])];
        let (drawn, flow, fate) = run(&models, &views, &views, None);
        assert!(flow.iter().all(|f| f.abs() < 1e-12));
        for (fate, seen) in fate.iter().zip(&drawn.mask) {
            assert_eq!(*fate, if *seen { Fate::Visible } else { Fate::None });
        }
    }

    #[test]
    fn points_go_where_they_project_each_with_its_object() {
        let models = [square(0.5), square(0.6)];
        let first = [view([-0.4, 0.0, 2.0]), View { rotation: turn(0.5), ..view([0.4, 0.2, 1.8]) }];
        let mut second =
            [View { rotation: turn(-0.4), ..view([-0.3, 0.1, 1.5]) }, view([0.3, -0.2, 2.5])];
        for view in &mut second {
            view.camera.fx = 40.0;
        }
        let (drawn, flow, _) = run(&models, &first, &second, None);
        let mut objects = [0; 2];
        for k in (0..SIZE.pixels()).filter(|&k| drawn.mask[k]) {
            let o = drawn.object[k] as usize;
            objects[o] += 1;
            let face = models[o].faces()[drawn.face[k] as usize];
            let b = &drawn.barycentrics[3 * k..3 * k + 3];
            let corners = face.map(|v| in_camera(models[o].vertex(v as usize), &second[o]));
            let p = [0, 1, 2].map(|axis| (0..3).map(|c| b[c] * corners[c][axis]).sum());
            let to = project(p, &second[o].camera);
            assert!((to[0] - flow[2 * k] - (k % 32) as f64 - 0.5).abs() < 1e-9);
            assert!((to[1] - flow[2 * k + 1] - (k / 32) as f64 - 0.5).abs() < 1e-9);
        }
        assert!(objects.iter().all(|&n| n > 20), "{objects:?}");
    }

    #[test]
    fn a_nearer_square_hides_exactly_what_is_behind_it() {
        let models = [square(1.0), square(0.25)];
        let first = [view([0.0, 0.0, 4.0]), view([9.0, 0.0, 2.0])];
        let second = [view([0.1, 0.0, 4.0]), view([0.013, 0.0, 2.0])];
        let (drawn, flow, fate) = run(&models, &first, &second, None);
        let mut counts = [0; 2];
        for k in (0..SIZE.pixels()).filter(|&k| drawn.mask[k]) {
            // 0.1 m at 4 m are 0.8 pixels.
            assert!((flow[2 * k] - 0.8).abs() < 1e-12 && flow[2 * k + 1].abs() < 1e-12);
            let (u, v) = ((k % 32) as f64 + 1.3, (k / 32) as f64 + 0.5);
            let hidden = (u - 16.208).abs() < 4.0 && (v - 12.0).abs() < 4.0;
            assert_eq!(fate[k], if hidden { Fate::Occluded } else { Fate::Visible }, "{u} {v}");
            counts[usize::from(hidden)] += 1;
        }
        assert!(counts[0] > 100 && counts[1] > 40, "{counts:?}");
    }

    #[test]
    fn what_leaves_the_image_or_passes_the_camera_is_told() {
        let models = [square(0.5)];
        let first = [view([0.0, 0.0, 2.0])];
        let (drawn, flow, fate) = run(&models, &first, &[view([2.0, 0.0, 2.0])], None);
        assert!(drawn.mask.iter().zip(&fate).all(|(m, f)| !m || *f == Fate::Outside));
        assert!(drawn.mask.iter().zip(flow.chunks(2)).all(|(m, f)| !m || f[0] > 31.9));
        let (drawn, flow, fate) = run(&models, &first, &[view([0.0, 0.0, -2.0])], None);
        assert!(drawn.mask.iter().zip(&fate).all(|(m, f)| !m || *f == Fate::Behind));
        assert!(flow.iter().all(|&f| f == 0.0));
    }

    #[test]
    fn the_background_moves_with_the_camera() {
        let models = [square(0.5)];
        let (first, second) = ([view([0.0, 0.0, 2.0])], [view([0.2, 0.0, 2.0])]);
        let still = Background { rotation: STILL, translation: [0.1, 0.0, 0.0], depth: 4.0 };
        let (drawn, flow, fate) = run(&models, &first, &second, Some(&[still]));
        let mut hidden = 0;
        for k in (0..SIZE.pixels()).filter(|&k| !drawn.mask[k]) {
            assert!((flow[2 * k] - 0.8).abs() < 1e-12, "{}", flow[2 * k]);
            hidden += usize::from(fate[k] == Fate::Occluded);
            assert_eq!(fate[k] == Fate::Outside, k % 32 == 31);
        }
        // The square moved by 3.2 pixels and the background by 0.8.
        assert!((16..=64).contains(&hidden), "{hidden}");
        // At infinity only the turn counts: the homography K R K^-1.
        let rotation = turn(0.05);
        let far = Background { rotation, translation: [5.0, 6.0, 7.0], depth: f64::INFINITY };
        let (drawn, flow, _) = run(&models, &first, &second, Some(&[far]));
        for k in (0..SIZE.pixels()).filter(|&k| !drawn.mask[k]) {
            let (u, v) = ((k % 32) as f64 + 0.5, (k / 32) as f64 + 0.5);
            let ray = [(u - 16.0) / 32.0, (v - 12.0) / 32.0, 1.0];
            let p = in_camera(ray, &View { rotation, ..view([0.0; 3]) });
            let to = project(p, &first[0].camera);
            assert!((to[0] - u - flow[2 * k]).hypot(to[1] - v - flow[2 * k + 1]) < 1e-12);
        }
    }

    #[test]
    fn threads_change_no_bit() {
        let models = [square(0.5), square(0.3)];
        let first = [view([0.0, 0.0, 2.0]), view([0.1, 0.0, 1.9])].repeat(5);
        let second: Vec<_> =
            (0..10).map(|k| View { rotation: turn(0.1 * f64::from(k)), ..first[0] }).collect();
        let draw = || run(&models, &first, &second, None);
        let one = threads::install(1, draw).expect("run");
        for count in [2, 7] {
            assert!(threads::install(count, draw).expect("run") == one);
        }
    }

    #[test]
    fn what_has_no_flow_is_refused_by_name() {
        let model = square(1.0);
        let (surfaces, views) = ([Surface::new(&model)], [view([0.0, 0.0, 2.0])]);
        let first = Scenes { surfaces: &surfaces, views: &views, size: SIZE, near: None };
        let good =
            Pairs { first, second: &views, second_size: SIZE, backgrounds: None, tolerance: None };
        let message = |pairs: Pairs<'_>| pairs.check().expect_err("refused").to_string();
        assert!(message(Pairs { second: &[], ..good }).starts_with("R1:"));
        assert!(message(Pairs { tolerance: Some(1.0), ..good }).starts_with("tolerance:"));
        assert!(message(Pairs { backgrounds: Some(&[]), ..good }).starts_with("camera_motion:"));
        let b = Background { rotation: STILL, translation: [0.0; 3], depth: 0.0 };
        let message = message(Pairs { backgrounds: Some(&[b]), ..good });
        assert!(message.starts_with("background_depth:"), "{message}");
    }
}
