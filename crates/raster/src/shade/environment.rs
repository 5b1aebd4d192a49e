//! Light from all sides: a panorama, blurred for surfaces of every roughness.

use rayon::prelude::*;

use super::ggx;
use crate::error::{Error, Result};

/// Roughnesses that the panorama is blurred for; the first is a mirror, the last scatters evenly.
const ROUGHNESS: [f64; 6] = [0.0, 0.2, 0.4, 0.6, 0.8, 1.0];

/// Rows of the mirror's image at most.
const MIRROR_ROWS: usize = 256;

/// Rows of the panorama that is blurred at most, and of what comes out.
const SOURCE_ROWS: usize = 64;
const BLURRED_ROWS: usize = 32;

/// An environment map in equal steps of longitude and latitude, prepared for lighting.
///
/// The upper row is the zenith (`+z` of the world). The middle column looks along `+x`, the left
/// half to `+y`: a direction `(x, y, z)` is in the column at `1/2 - atan2(y, x) / 2 pi` of the width
/// and the row at `acos(z) / pi` of the height.
#[derive(Debug, Clone)]
pub struct Environment {
    levels: Vec<Panorama>,
}

#[derive(Debug, Clone)]
struct Panorama {
    width: usize,
    height: usize,
    radiance: Vec<[f32; 3]>,
}

impl Environment {
    /// From linear radiance, `(H, W, 3)`, the zenith first; works on rayon's current pool.
    ///
    /// # Errors
    /// [`Error::Argument`] where the length is not `3 height width`, a side is 0 or above 32768, or a
    /// value is negative or not finite.
    pub fn new((height, width): (usize, usize), rgb: &[f32]) -> Result<Self> {
        let refuse = |message: String| Err(Error::argument("environment", message));
        if !(1..=32_768).contains(&height) || !(1..=32_768).contains(&width) {
            return refuse(format!("{height} x {width} pixels; expected sides of 1 to 32768"));
        }
        if rgb.len() != 3 * height * width {
            return refuse(format!("{} numbers, expected {}", rgb.len(), 3 * height * width));
        }
        if let Some(place) = rgb.iter().position(|x| !x.is_finite() || *x < 0.0) {
            let (row, column) = (place / 3 / width, place / 3 % width);
            let message =
                format!("{} in row {row}, column {column}; expected a radiance >= 0", rgb[place]);
            return refuse(message);
        }
        let radiance = rgb.as_chunks::<3>().0.to_vec();
        let whole = Panorama { width, height, radiance };
        let source = whole.reduced(SOURCE_ROWS).directions();
        let mut levels = vec![whole.reduced(MIRROR_ROWS)];
        levels.extend(ROUGHNESS[1..].iter().map(|r| source.blurred(r * r)));
        Ok(Self { levels })
    }

    /// Mean radiance over the sphere.
    #[must_use]
    pub fn mean(&self) -> [f32; 3] {
        let (mut sum, mut all) = ([0.0_f64; 3], 0.0);
        let map = &self.levels[0];
        for (row, pixels) in map.radiance.chunks_exact(map.width).enumerate() {
            let area = map.solid_angle(row);
            for pixel in pixels {
                sum.iter_mut().zip(pixel).for_each(|(sum, &c)| *sum += area * f64::from(c));
                all += area;
            }
        }
        sum.map(|c| (c / all) as f32)
    }

    /// Light that an even white surface scatters: the irradiance over pi, for a unit normal.
    #[must_use]
    pub fn scattered(&self, normal: [f64; 3]) -> [f32; 3] {
        // The lobe of roughness 1 is the cosine alone.
        self.levels[ROUGHNESS.len() - 1].at(normal)
    }

    /// Light that a surface of a roughness from 0 to 1 mirrors, from a unit direction.
    #[must_use]
    pub fn mirrored(&self, direction: [f64; 3], roughness: f64) -> [f32; 3] {
        let steps = (ROUGHNESS.len() - 1) as f64;
        let place = (roughness * steps).clamp(0.0, steps);
        let first = (place as usize).min(ROUGHNESS.len() - 2);
        let part = (place - first as f64) as f32;
        let (a, b) = (self.levels[first].at(direction), self.levels[first + 1].at(direction));
        [0, 1, 2].map(|k| a[k] + part * (b[k] - a[k]))
    }
}

impl Panorama {
    /// Of a pixel of a row, in steradians.
    fn solid_angle(&self, row: usize) -> f64 {
        let z = |row: usize| (std::f64::consts::PI * row as f64 / self.height as f64).cos();
        (z(row) - z(row + 1)) * std::f64::consts::TAU / self.width as f64
    }

    /// The direction of the centre of a pixel.
    fn direction(&self, row: usize, column: usize) -> [f64; 3] {
        let polar = std::f64::consts::PI * (row as f64 + 0.5) / self.height as f64;
        let turn = 0.5 - (column as f64 + 0.5) / self.width as f64;
        let (sin, cos) = (std::f64::consts::TAU * turn).sin_cos();
        [polar.sin() * cos, polar.sin() * sin, polar.cos()]
    }

    /// Not more than so many rows, of means over whole pixels; their number divides the old one.
    fn reduced(&self, rows: usize) -> Self {
        let step = self.height.div_ceil(rows);
        if step <= 1 {
            return self.clone();
        }
        let (height, width) = (self.height.div_ceil(step), self.width.div_ceil(step));
        let mut radiance = Vec::with_capacity(height * width);
        for y in 0..height {
            for x in 0..width {
                let (mut sum, mut all) = ([0.0_f64; 3], 0.0);
                for row in y * step..((y + 1) * step).min(self.height) {
                    let area = self.solid_angle(row);
                    for column in x * step..((x + 1) * step).min(self.width) {
                        let pixel = self.radiance[row * self.width + column];
                        sum.iter_mut().zip(pixel).for_each(|(s, c)| *s += area * f64::from(c));
                        all += area;
                    }
                }
                radiance.push(sum.map(|c| (c / all) as f32));
            }
        }
        Self { width, height, radiance }
    }

    fn directions(&self) -> Directions {
        let mut out = Directions::default();
        for (row, pixels) in self.radiance.chunks_exact(self.width).enumerate() {
            let area = self.solid_angle(row) as f32;
            for (column, pixel) in pixels.iter().enumerate() {
                let to = self.direction(row, column).map(|c| c as f32);
                for k in 0..3 {
                    out.to[k].push(to[k]);
                    out.light[k].push(pixel[k] * area);
                }
                out.area.push(area);
            }
        }
        out
    }

    /// Between the centres of the pixels; east meets west.
    fn at(&self, [x, y, z]: [f64; 3]) -> [f32; 3] {
        let across = (0.5 - y.atan2(x) / std::f64::consts::TAU) * self.width as f64 - 0.5;
        let down = z.clamp(-1.0, 1.0).acos() / std::f64::consts::PI * self.height as f64 - 0.5;
        let down = down.clamp(0.0, (self.height - 1) as f64);
        let left = across.floor();
        let part = [(across - left) as f32, (down - down.floor()) as f32];
        // From -1 to the width.
        let left = if left < 0.0 { self.width - 1 } else { left as usize % self.width };
        let right = if left + 1 == self.width { 0 } else { left + 1 };
        let upper = (down as usize).min(self.height - 1);
        let lower = (upper + 1).min(self.height - 1);
        let pixel = |row: usize, column: usize| self.radiance[row * self.width + column];
        let [a, b] = [upper, lower].map(|row| {
            let (a, b) = (pixel(row, left), pixel(row, right));
            [0, 1, 2].map(|k| a[k] + part[0] * (b[k] - a[k]))
        });
        [0, 1, 2].map(|k| a[k] + part[1] * (b[k] - a[k]))
    }
}

/// The pixels of a panorama as lamps, one array a number.
#[derive(Debug, Default)]
struct Directions {
    to: [Vec<f32>; 3],
    /// Radiance times solid angle.
    light: [Vec<f32>; 3],
    area: Vec<f32>,
}

impl Directions {
    /// The mean over the lobe of GGX with this `alpha` around every direction, for a surface seen
    /// from there (Karis 2013, first factor of the split sum): weights `D(n.h) (n.l)`.
    fn blurred(&self, alpha: f64) -> Panorama {
        let (height, width) = (BLURRED_ROWS, 2 * BLURRED_ROWS);
        let shape = Panorama { width, height, radiance: Vec::new() };
        let radiance = (0..height * width).into_par_iter().map(|k| {
            let n = shape.direction(k / width, k % width).map(|c| c as f32);
            self.mean(n, alpha)
        });
        let radiance = radiance.collect();
        Panorama { radiance, ..shape }
    }

    fn mean(&self, n: [f32; 3], alpha: f64) -> [f32; 3] {
        let peak = ggx::density(1.0, alpha);
        let (mut sum, mut all) = ([0.0_f64; 3], 0.0_f64);
        for k in 0..self.area.len() {
            let cosine = n[0] * self.to[0][k] + n[1] * self.to[1][k] + n[2] * self.to[2][k];
            if cosine <= 0.0 {
                continue;
            }
            let half = f64::from(0.5 + 0.5 * cosine).min(1.0).sqrt();
            let weight = f64::from(cosine) * (ggx::density(half, alpha) / peak);
            for (sum, light) in sum.iter_mut().zip(&self.light) {
                *sum += weight * f64::from(light[k]);
            }
            all += weight * f64::from(self.area[k]);
        }
        sum.map(|c| (c / all) as f32)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn map(radiance: impl Fn([f64; 3]) -> [f32; 3]) -> Environment {
        let (height, width) = (96, 192);
        let shape = Panorama { width, height, radiance: Vec::new() };
        let rgb: Vec<f32> = (0..height * width)
            .flat_map(|k| radiance(shape.direction(k / width, k % width)))
            .collect();
        Environment::new((height, width), &rgb).unwrap()
    }

    #[test]
    fn an_even_sky_lights_everything_alike() {
        let even = map(|_| [0.5, 1.0, 2.0]);
        for n in [[0.0, 0.0, 1.0], [0.6, 0.0, -0.8], [0.0, -1.0, 0.0]] {
            for found in [even.scattered(n), even.mirrored(n, 0.5), even.mirrored(n, 0.0)] {
                for (found, expected) in found.into_iter().zip([0.5, 1.0, 2.0]) {
                    assert!((found - expected).abs() < 1e-4 * expected, "{found} {expected}");
                }
            }
        }
    }

    #[test]
    fn a_bright_upper_half_gives_the_closed_form() {
        // Irradiance over pi under a half sphere of radiance 1: (1 + cos(angle)) / 2.
        let sky = map(|d| [if d[2] > 0.0 { 1.0 } else { 0.0 }; 3]);
        for degrees in [0.0, 45.0, 90.0, 135.0, 180.0_f64] {
            let (sin, cos) = degrees.to_radians().sin_cos();
            let found = sky.scattered([sin, 0.0, cos])[0];
            let expected = f64::midpoint(1.0, cos) as f32;
            assert!((found - expected).abs() < 0.02, "{degrees}: {found} {expected}");
        }
        assert!((sky.mean()[0] - 0.5).abs() < 1e-3);
    }

    #[test]
    fn directions_are_those_of_the_docstring() {
        let coloured = map(|[x, y, z]| [x, y, z].map(|c| c.max(0.0) as f32));
        for (k, direction) in
            [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]].into_iter().enumerate()
        {
            let found = coloured.mirrored(direction, 0.0);
            assert!(
                found[k] > 0.99 && found.iter().sum::<f32>() < 1.05,
                "{direction:?}: {found:?}"
            );
        }
        // Seen from both sides of the seam at the back.
        let [a, b] = [1e-9, -1e-9].map(|y| coloured.mirrored([-1.0, y, 0.0], 0.0));
        assert!(a.into_iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-6), "{a:?} {b:?}");
    }

    #[test]
    fn what_is_no_light_is_refused() {
        assert!(Environment::new((2, 4), &[1.0; 23]).is_err());
        let mut rgb = [1.0_f32; 24];
        rgb[5] = f32::NAN;
        let error = Environment::new((2, 4), &rgb).unwrap_err().to_string();
        assert!(error.contains("row 0, column 1"), "{error}");
        rgb[5] = -1.0;
        assert!(Environment::new((2, 4), &rgb).is_err());
        assert!(Environment::new((1, 1), &[1.0, 2.0, 3.0]).is_ok());
    }
}
