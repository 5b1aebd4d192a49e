//! What the mesh formats have in common: lines, fields, coordinates, polygons.

use glam::DVec3;

use crate::error::{Error, Place, Result, quoted};
use crate::mesh::LARGEST_COORDINATE;

/// The error for content that is not of the format at all.
pub(super) fn not_a(bytes: &[u8], name: &str, expected: &str) -> Error {
    let start = bytes.trim_ascii_start();
    let found = if bytes.is_empty() {
        "an empty file".into()
    } else if start.is_empty() {
        "nothing but blanks".into()
    } else if start.starts_with(b"<") {
        format!("a web page or XML, beginning with {}", quoted(first_line(start)))
    } else if start[..start.len().min(512)].contains(&0) {
        "binary data".into()
    } else {
        format!("a file beginning with {}", quoted(first_line(start)))
    };
    Error::malformed(Place::file(name), found, expected)
}

fn first_line(bytes: &[u8]) -> &[u8] {
    bytes.split(|&b| b == b'\n' || b == b'\r').next().unwrap_or_default()
}

/// A position from the fields of a line; `place` is asked for only in case of an error.
pub(super) fn position<'a>(
    mut fields: impl Iterator<Item = &'a [u8]>,
    place: impl Fn() -> Place,
) -> Result<DVec3> {
    const EXPECTED: &str = "three finite numbers (up to 1e100)";
    let mut p = [0.0; 3];
    for (k, c) in p.iter_mut().enumerate() {
        let Some(field) = fields.next() else {
            let found = ["no number", "one number", "two numbers"][k];
            return Err(Error::malformed(place(), found, EXPECTED));
        };
        let number = number(field).filter(|c| c.abs() <= LARGEST_COORDINATE);
        *c = number.ok_or_else(|| Error::malformed(place(), quoted(field), EXPECTED))?;
    }
    Ok(DVec3::from_array(p))
}

/// The position, if its coordinates are finite and not absurd.
pub(super) fn in_range(p: DVec3, place: impl Fn() -> Place) -> Result<DVec3> {
    if p.abs().to_array().iter().all(|c| *c <= LARGEST_COORDINATE) {
        return Ok(p);
    }
    let found = format!("({}, {}, {})", p.x, p.y, p.z);
    Err(Error::malformed(place(), found, "three finite numbers (up to 1e100)"))
}

/// A number in decimal notation.
pub(super) fn number(field: &[u8]) -> Option<f64> {
    std::str::from_utf8(field).ok()?.parse().ok()
}

/// The fields of a line, separated by blanks.
pub(super) fn fields(line: &[u8]) -> impl Iterator<Item = &[u8]> {
    line.split(u8::is_ascii_whitespace).filter(|f| !f.is_empty())
}

/// Physical lines with their numbers, ended by LF, CR LF, or CR in files that know no LF.
pub(super) fn lines(bytes: &[u8]) -> impl Iterator<Item = (u64, &[u8])> {
    let end = if memchr::memchr(b'\n', bytes).is_some() { b'\n' } else { b'\r' };
    bytes.split(move |&b| b == end).zip(1..).map(|(line, number)| (number, line))
}

/// Polygons above this size are not looked at for reflex corners; no modelling tool writes one.
const LARGEST_CLIPPED: usize = 1000;

/// Triangles of a polygon given by its corners, always two fewer than corners, with its winding.
///
/// A fan from the first corner for a convex polygon; where it has a reflex corner a fan would
/// cover what is outside, so ears are cut off one by one.
pub(super) fn triangulate(vertices: &[DVec3], corners: &[u32], out: &mut Vec<[u32; 3]>) {
    let at = |k: u32| vertices[k as usize];
    let turn = |a, b, c| (at(b) - at(a)).cross(at(c) - at(b));
    let mut left = corners.to_vec();
    if corners.len() > 3 && corners.len() <= LARGEST_CLIPPED {
        let origin = at(corners[0]);
        // Newell's normal: right for concave polygons and ones that are not quite plane.
        let normal: DVec3 =
            around(corners).map(|[_, b, c]| (at(b) - origin).cross(at(c) - origin)).sum();
        let reflex = |[a, b, c]: [u32; 3]| turn(a, b, c).dot(normal) < 0.0;
        while left.len() > 3 && around(&left).any(reflex) {
            let is_ear = |&k: &usize| {
                let [a, b, c] = corner(&left, k);
                let inside = |&p: &u32| {
                    let sides = [(a, b), (b, c), (c, a)];
                    ![a, b, c].contains(&p)
                        && sides
                            .iter()
                            .all(|&(s, e)| (at(e) - at(s)).cross(at(p) - at(s)).dot(normal) >= 0.0)
                };
                turn(a, b, c).dot(normal) > 0.0 && !left.iter().any(inside)
            };
            // Without an ear the polygon crosses itself, and any triangles are as good.
            let Some(ear) = (0..left.len()).find(is_ear) else { break };
            out.push(corner(&left, ear));
            left.remove(ear);
        }
    }
    out.extend((2..left.len()).map(|k| [left[0], left[k - 1], left[k]]));
}

/// A corner between its neighbours.
fn corner(corners: &[u32], k: usize) -> [u32; 3] {
    let n = corners.len();
    [corners[(k + n - 1) % n], corners[k], corners[(k + 1) % n]]
}

fn around(corners: &[u32]) -> impl Iterator<Item = [u32; 3]> {
    (0..corners.len()).map(|k| corner(corners, k))
}
