//! STL, binary and as text: three vertices to a face, kept as they are, none shared.
//!
//! By hand: it is a few lines, and the crates for it weld vertices, or know no file and line.

use glam::DVec3;

use super::mesh_text::{fields, in_range, lines, not_a, position};
use crate::error::{Error, Place, Result, quoted};
use crate::mesh::Mesh;

/// Bytes before the first triangle, and of each.
const HEADER: usize = 84;
const TRIANGLE: usize = 50;

pub(super) fn looks_like(bytes: &[u8]) -> bool {
    is_binary(bytes) || is_text(bytes)
}

/// The size says it for certain. The first word does not: there are binary files that begin with
/// "solid".
fn is_binary(bytes: &[u8]) -> bool {
    declared(bytes).is_some_and(|n| Some(bytes.len()) == size_of_file(n))
}

fn is_text(bytes: &[u8]) -> bool {
    bytes.trim_ascii_start().get(..5).is_some_and(|word| word.eq_ignore_ascii_case(b"solid"))
}

/// The number of triangles in the header of a binary file.
fn declared(bytes: &[u8]) -> Option<usize> {
    let (_, count) = bytes.get(..HEADER)?.split_last_chunk()?;
    usize::try_from(u32::from_le_bytes(*count)).ok()
}

fn size_of_file(triangles: usize) -> Option<usize> {
    triangles.checked_mul(TRIANGLE)?.checked_add(HEADER)
}

/// The mesh of an STL file; `name` is the file's, for messages.
///
/// The stored normals are ignored: a face's winding says the same.
///
/// # Errors
/// [`Error::Malformed`], with the line or the triangle.
pub fn parse_stl(bytes: &[u8], name: &str) -> Result<Mesh> {
    let vertices = if is_binary(bytes) {
        binary(bytes, name)?
    } else if is_text(bytes) && memchr::memchr(0, bytes).is_none() {
        text(bytes, name)?
    } else {
        return Err(match declared(bytes) {
            // Not the number in a text that is something else.
            Some(n) if memchr::memchr(0, &bytes[..HEADER]).is_some() => Error::malformed(
                Place::file(name),
                format!("{} bytes and a header for {n} triangles", bytes.len()),
                "84 bytes and 50 for each triangle; is the file complete?",
            ),
            _ => not_a(bytes, name, "an STL file, binary or beginning with 'solid'"),
        });
    };
    if vertices.is_empty() {
        return Err(Error::malformed(Place::file(name), "no triangle", "at least one"));
    }
    let faces = (0..vertices.len() as u32 / 3).map(|k| [3 * k, 3 * k + 1, 3 * k + 2]).collect();
    Mesh::new(vertices, faces)
}

fn binary(bytes: &[u8], name: &str) -> Result<Vec<DVec3>> {
    let mut vertices = Vec::with_capacity((bytes.len() - HEADER) / TRIANGLE * 3);
    for (k, triangle) in bytes[HEADER..].chunks_exact(TRIANGLE).enumerate() {
        // Twelve bytes of normal before the vertices, two of attributes after.
        for vertex in triangle[12..48].chunks_exact(12) {
            let (numbers, _) = vertex.as_chunks::<4>();
            let c = |i: usize| f64::from(f32::from_le_bytes(numbers[i]));
            let place = || Place::file(name).column(format!("triangle {k}"));
            vertices.push(in_range(DVec3::new(c(0), c(1), c(2)), place)?);
        }
    }
    Ok(vertices)
}

fn text(bytes: &[u8], name: &str) -> Result<Vec<DVec3>> {
    let mut vertices = Vec::new();
    let mut last = 0;
    let mut ended = false;
    for (number, line) in lines(bytes) {
        let mut fields = fields(line);
        let Some(word) = fields.next() else { continue };
        last = number;
        match word.to_ascii_lowercase().as_slice() {
            b"solid" => ended = false,
            b"facet" | b"outer" => {}
            b"vertex" => {
                let place = || Place::line(name, number).column("vertex");
                vertices.push(position(fields, place)?);
            }
            b"endloop" | b"endfacet" if vertices.len() % 3 == 0 => {}
            b"endloop" | b"endfacet" => {
                let found = format!("{} vertices before it", vertices.len() % 3);
                return Err(Error::malformed(
                    Place::line(name, number),
                    found,
                    "three for each facet",
                ));
            }
            b"endsolid" => ended = true,
            _ => {
                let expected = "solid, facet, outer loop, vertex, endloop, endfacet or endsolid";
                return Err(Error::malformed(Place::line(name, number), quoted(word), expected));
            }
        }
    }
    if ended && vertices.len() % 3 == 0 {
        return Ok(vertices);
    }
    let expected = "'endsolid' after it; is the file complete?";
    Err(Error::malformed(Place::line(name, last), "the last line", expected))
}

#[cfg(test)]
mod tests {
    use std::fmt::Write as _;

    use proptest::prelude::*;

    use super::*;

    const CORNERS: [[f32; 3]; 6] = [
        [0.0, 0.0, 0.0],
        [1.0, 0.0, 0.0],
        [0.0, 1.0, 0.0],
        [0.0, 0.0, 0.0],
        [0.0, 1.0, 0.0],
        [0.0, 0.25, 1.5],
    ];

    fn as_binary(start: &[u8]) -> Vec<u8> {
        let mut bytes = start.to_vec();
        bytes.resize(80, b' ');
        bytes.extend(2_u32.to_le_bytes());
        for triangle in CORNERS.chunks(3) {
            bytes.extend([0; 12]);
            bytes.extend(triangle.iter().flatten().flat_map(|c| c.to_le_bytes()));
            bytes.extend([7; 2]);
        }
        bytes
    }

    fn as_text() -> String {
        let mut text = String::from("solid two triangles\n");
        for triangle in CORNERS.chunks(3) {
            text.push_str("  facet normal 0 0 1\n    outer loop\n");
            for [x, y, z] in triangle {
                let _ = writeln!(text, "      vertex {x:e} {y} {z}");
            }
            text.push_str("    endloop\n  endfacet\n");
        }
        text + "endsolid two triangles\n"
    }

    fn refusal(bytes: &[u8]) -> String {
        parse_stl(bytes, "m.stl").expect_err("refused").to_string()
    }

    #[test]
    fn both_kinds_hold_the_same_mesh() {
        let text = as_text();
        let crlf = text.replace('\n', "\r\n");
        let binary = as_binary(b"made by hand");
        let solid = as_binary(b"solid but binary");
        for bytes in
            [&binary, &solid, text.as_bytes(), crlf.as_bytes(), text.to_uppercase().as_bytes()]
        {
            let mesh = parse_stl(bytes, "m.stl").expect("valid");
            assert_eq!(mesh.faces(), [[0, 1, 2], [3, 4, 5]]);
            let wanted = CORNERS.map(|c| DVec3::from_array(c.map(f64::from)));
            assert_eq!(mesh.vertices(), wanted);
        }
    }

    #[test]
    fn what_is_wrong_is_named_with_its_place() {
        let mut binary = as_binary(b"x\0");
        let cut = refusal(&binary[..150]);
        assert!(cut.starts_with("m.stl: found 150 bytes and a header for 2 triangles"), "{cut}");
        binary[84 + 50 + 12..][..4].copy_from_slice(&f32::NAN.to_le_bytes());
        let nan = refusal(&binary);
        assert!(
            nan.starts_with("m.stl:triangle 1: found (NaN, 0, 0), expected three finite"),
            "{nan}"
        );
        let mut none = as_binary(b"x\0")[..84].to_vec();
        none[80] = 0;
        assert_eq!(refusal(&none), "m.stl: found no triangle, expected at least one");
        let text = as_text();
        let cases = [
            (text.replace("1e0", "x"), "m.stl:5:vertex: found 'x', expected three finite numbers"),
            (text.replace("1.5", ""), "m.stl:13:vertex: found two numbers"),
            (text.replace("1.5", "inf"), "m.stl:13:vertex: found 'inf'"),
            (text.replace("endloop", "enloop"), "m.stl:7: found 'enloop', expected solid, facet"),
            (text.replacen("      vertex", "facet", 1), "m.stl:7: found 2 vertices before it"),
            (text[..120].to_owned(), "found the last line, expected 'endsolid'"),
            ("solid".into(), "m.stl:1: found the last line"),
            ("solid a\nendsolid a".into(), "m.stl: found no triangle"),
            ("<!DOCTYPE html>".repeat(30), "m.stl: found a web page or XML"),
        ];
        for (text, wanted) in cases {
            let found = refusal(text.as_bytes());
            assert!(found.contains(wanted), "{wanted}: {found}");
        }
    }

    proptest! {
        #[test]
        fn no_bytes_make_it_panic(
            binary: bool, changes in prop::collection::vec((0..600_usize, any::<u8>()), 0..12), cut in 0..600_usize,
        ) {
            let mut bytes = if binary { as_binary(b"solid") } else { as_text().into_bytes() };
            for (k, b) in changes {
                let n = bytes.len();
                bytes[k % n] = b;
            }
            let _ = parse_stl(&bytes, "m.stl");
            bytes.truncate(cut);
            let _ = parse_stl(&bytes, "m.stl");
        }
    }
}
