//! Pinhole cameras without distortion.
//!
//! Image coordinates: u to the right and v down, in pixels; the corner of the image is `(0, 0)` and
//! the centre of the pixel in row `i` and column `j` is `(j + 0.5, i + 0.5)`. A file whose camera
//! matrix puts pixel *centres* at whole numbers (OpenCV, BOP) needs 0.5 added to `cx` and `cy`
//! before anything is drawn with it; differences of image points, and so every metric here, are
//! the same in both.

use glam::{DVec2, DVec3};

use crate::error::{Error, Result, quoted};

/// A camera matrix `[[fx, skew, cx], [0, fy, cy], [0, 0, 1]]` in pixels, with the size of the image
/// where it is known.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Intrinsics {
    /// Focal length along u, in pixels; positive.
    pub fx: f64,
    /// Focal length along v, in pixels; positive.
    pub fy: f64,
    /// Principal point along u, in pixels.
    pub cx: f64,
    /// Principal point along v, in pixels.
    pub cy: f64,
    /// Shear of u with y, in pixels; nearly always 0.
    pub skew: f64,
    /// Width of the image in pixels.
    pub width: Option<u32>,
    /// Height of the image in pixels.
    pub height: Option<u32>,
}

impl Intrinsics {
    /// From focal lengths and principal point in pixels, without skew and image size.
    ///
    /// # Errors
    /// [`Error::Argument`] that names the value: a focal length that is not positive and finite,
    /// or a principal point that is not finite.
    pub fn new(fx: f64, fy: f64, cx: f64, cy: f64) -> Result<Self> {
        let k = Self { fx, fy, cx, cy, skew: 0.0, width: None, height: None };
        k.checked()
    }

    /// The same camera for images of so many pixels.
    #[must_use]
    pub fn with_size(self, width: u32, height: u32) -> Self {
        Self { width: Some(width), height: Some(height), ..self }
    }

    /// From a 3x3 camera matrix, row by row; a common factor is divided out.
    ///
    /// # Errors
    /// [`Error::Argument`] for entries that are not finite, a last row other than `0, 0, k` with
    /// `k` not 0, an entry below the diagonal, and as [`Intrinsics::new`].
    pub fn from_matrix(rows: [[f64; 3]; 3]) -> Result<Self> {
        if !rows.iter().flatten().all(|c| c.is_finite()) {
            return Err(Error::argument("K", "an entry is NaN or infinite"));
        }
        let [[fx, skew, cx], [below, fy, cy], [a, b, k]] = rows;
        if k == 0.0 || a != 0.0 || b != 0.0 {
            return Err(Error::argument(
                "K",
                format!("the last row is {a}, {b}, {k}; expected 0, 0, 1"),
            ));
        }
        if below != 0.0 {
            return Err(Error::argument("K", format!("row 2, column 1 is {below}; expected 0")));
        }
        let k = Self { skew: skew / k, ..Self::new(fx / k, fy / k, cx / k, cy / k)? };
        k.checked()
    }

    /// The 3x3 camera matrix, row by row.
    #[must_use]
    pub fn matrix(&self) -> [[f64; 3]; 3] {
        [[self.fx, self.skew, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]]
    }

    /// From text `fx,fy,cx,cy,W,H` or `fx,fy,cx,cy`, in pixels.
    ///
    /// # Errors
    /// [`Error::Argument`] that names the field which is missing, no number or out of range.
    pub fn parse(text: &str) -> Result<Self> {
        const FIELDS: [&str; 6] = ["fx", "fy", "cx", "cy", "W", "H"];
        let parts: Vec<&str> = text.split(',').map(str::trim).collect();
        if parts.len() != 4 && parts.len() != 6 {
            let found = quoted(text.as_bytes());
            return Err(Error::argument(
                "intrinsics",
                format!(
                    "{found} has {} fields; expected fx,fy,cx,cy or fx,fy,cx,cy,W,H",
                    parts.len()
                ),
            ));
        }
        let wrong = |k: usize, expected: &str| {
            let found = quoted(parts[k].as_bytes());
            Error::argument(
                "intrinsics",
                format!("{}: found {found}, expected {expected}", FIELDS[k]),
            )
        };
        let number = |k: usize| parts[k].parse::<f64>().map_err(|_| wrong(k, "a number of pixels"));
        let camera = Self::new(number(0)?, number(1)?, number(2)?, number(3)?)?;
        if parts.len() == 4 {
            return Ok(camera);
        }
        let count = |k: usize| match parts[k].parse::<u32>() {
            Ok(n) if n > 0 => Ok(n),
            _ => Err(wrong(k, "a positive whole number of pixels")),
        };
        Ok(camera.with_size(count(4)?, count(5)?))
    }

    /// Image point of a point in the camera frame (metres); `None` at or behind the camera's plane
    /// (`z <= 0`).
    #[must_use]
    pub fn project(&self, p_cam: DVec3) -> Option<DVec2> {
        let (x, y) = (p_cam.x / p_cam.z, p_cam.y / p_cam.z);
        let uv = DVec2::new(self.fx * x + self.skew * y + self.cx, self.fy * y + self.cy);
        (p_cam.z > 0.0).then_some(uv)
    }

    fn checked(self) -> Result<Self> {
        for (name, value) in [("fx", self.fx), ("fy", self.fy)] {
            if !(value > 0.0 && value.is_finite()) {
                return Err(Error::argument(
                    name,
                    format!("{value} is no focal length; expected a positive number of pixels"),
                ));
            }
        }
        for (name, value) in [("cx", self.cx), ("cy", self.cy), ("skew", self.skew)] {
            if !value.is_finite() {
                return Err(Error::argument(name, format!("{value}; expected a finite number")));
            }
        }
        Ok(self)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_optical_axis_meets_the_principal_point() {
        let k = Intrinsics::new(500.0, 400.0, 160.0, 120.0).expect("valid");
        assert_eq!(k.project(DVec3::new(0.0, 0.0, 3.0)), Some(DVec2::new(160.0, 120.0)));
        assert_eq!(k.project(DVec3::new(1.0, 1.0, 2.0)), Some(DVec2::new(410.0, 320.0)));
        assert_eq!(k.project(DVec3::new(1.0, 1.0, 0.0)), None);
        assert_eq!(k.project(DVec3::new(1.0, 1.0, -2.0)), None);
    }

    #[test]
    fn matrices_go_there_and_back() {
        let rows = [[500.0, 1.5, 160.0], [0.0, 400.0, 120.0], [0.0, 0.0, 1.0]];
        let k = Intrinsics::from_matrix(rows).expect("valid");
        assert_eq!(k.matrix(), rows);
        let doubled = rows.map(|r| r.map(|c| 2.0 * c));
        assert_eq!(Intrinsics::from_matrix(doubled).expect("valid"), k);
        assert!(Intrinsics::from_matrix([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0; 3]]).is_err());
        assert!(Intrinsics::from_matrix([[f64::NAN; 3]; 3]).is_err());
    }

    #[test]
    fn text_is_read_and_errors_name_the_field() {
        let k = Intrinsics::parse("500, 400,160,120,320,240").expect("valid");
        assert_eq!((k.fy, k.width, k.height), (400.0, Some(320), Some(240)));
        assert!(Intrinsics::parse("500,400,160,120").is_ok());
        for (text, field) in [
            ("500,400,160", "3 fields"),
            ("500,4o0,160,120,320,240", "fy: found '4o0'"),
            ("500,400,160,120,320.5,240", "W: found '320.5'"),
            ("500,400,160,120,320,0", "H: found '0'"),
            ("0,400,160,120", "fx: 0"),
            ("500,400,inf,120", "cx: inf"),
        ] {
            let message = Intrinsics::parse(text).expect_err("refused").to_string();
            assert!(message.contains(field), "{message}");
        }
    }
}
