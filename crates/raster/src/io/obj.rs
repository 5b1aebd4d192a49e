//! Wavefront OBJ: the `v` lines, all of them in their order, and the `f` lines.
//!
//! Faces are read by tobj. It does not serve for the vertices: it drops those without a face, which
//! the metrics count, splits the mesh at `g`, `o` and `usemtl` and numbers the vertices of each part
//! anew, stops at Latin-1 in a comment and at lines continued by `\`, lets NaN through, and its
//! errors name no line. So the lines are sorted here, and tobj is handed only the faces, between
//! `v` lines whose coordinates are the vertex's own number: whatever it renumbers, a corner of a
//! face says which vertex of the file it is.

use std::fmt::Write as _;
use std::io::BufReader;

use super::mesh_text::{fields, lines, not_a, position, triangulate};
use crate::error::{Error, Place, Result, quoted};
use crate::mesh::Mesh;

const EXPECTED: &str = "a Wavefront OBJ file with 'v X Y Z' lines";

/// The lines may be anywhere, for other formats begin with words of their own.
pub(super) fn looks_like(bytes: &[u8]) -> bool {
    let vertex = |(_, line): (u64, &[u8])| {
        let mut fields = fields(line);
        fields.next() == Some(b"v") && position(fields, || Place::file("")).is_ok()
    };
    lines(bytes).any(vertex)
}

/// The mesh of an OBJ file; `name` is the file's, for messages.
///
/// Polygons are cut into triangles. Texture coordinates, normals, colours, groups, lines, points and
/// materials are ignored, and so is a material file that is missing.
///
/// # Errors
/// [`Error::Malformed`], with the line.
pub fn parse_obj(bytes: &[u8], name: &str) -> Result<Mesh> {
    let mut vertices = Vec::new();
    let mut text = String::new(); // for tobj
    let mut faces = 0_usize;
    for (number, line) in logical_lines(bytes) {
        let mut fields = fields(&line);
        match fields.next() {
            Some(b"v") => {
                let p = position(fields, || Place::line(name, number).column("v"))?;
                // Halves of 16 bits, for tobj's numbers are f32.
                let k = vertices.len();
                let _ = writeln!(text, "v {} {} 0", k >> 16, k & 0xffff);
                vertices.push(p);
            }
            Some(b"f") => {
                faces += 1;
                text.push('f');
                for field in fields {
                    text.push(' ');
                    text.push_str(&String::from_utf8_lossy(field));
                }
                text.push('\n');
            }
            _ => {}
        }
    }
    if vertices.is_empty() {
        return Err(not_a(bytes, name, EXPECTED));
    }
    let refused = || bad_face(bytes, name, vertices.len());
    let options = tobj::LoadOptions::default(); // polygons stay, to be cut up here
    let materials = |_: &std::path::Path| Ok(Default::default());
    let mut reader = BufReader::new(text.as_bytes());
    let (models, _) =
        tobj::load_obj_buf(&mut reader, &options, materials).map_err(|_| refused())?;
    let mut triangles = Vec::new();
    let mut read = 0;
    for tobj::Model { mesh, .. } in &models {
        let vertex = |k: &u32| {
            let p = &mesh.positions[3 * *k as usize..];
            ((p[0] as u32) << 16) | p[1] as u32
        };
        let corners: Vec<u32> = mesh.indices.iter().map(vertex).collect();
        let mut corners = corners.as_slice();
        // tobj leaves the sizes out if all are triangles.
        let mut sizes = mesh.face_arities.iter();
        while !corners.is_empty() || sizes.len() > 0 {
            let size = sizes.next().map_or(3, |&s| s as usize);
            let (face, rest) = corners.split_at_checked(size).ok_or_else(refused)?;
            if size < 3 {
                return Err(refused());
            }
            triangulate(&vertices, face, &mut triangles);
            corners = rest;
            read += 1;
        }
    }
    if read != faces {
        return Err(refused());
    }
    Mesh::new(vertices, triangles)
}

/// Lines without comments, joined with those that continue them, and the number of the first.
///
/// A backslash at the end of a comment continues nothing: paths are often found there.
fn logical_lines(bytes: &[u8]) -> impl Iterator<Item = (u64, Vec<u8>)> {
    let bytes = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
    let mut lines = lines(bytes);
    std::iter::from_fn(move || {
        let (number, mut physical) = lines.next()?;
        let mut line = Vec::new();
        loop {
            let comment = memchr::memchr(b'#', physical);
            let content = physical[..comment.unwrap_or(physical.len())].trim_ascii_end();
            let continued = content.strip_suffix(b"\\").filter(|_| comment.is_none());
            line.extend_from_slice(continued.unwrap_or(content));
            match continued.and_then(|_| lines.next()) {
                Some((_, next)) => physical = next,
                None => return Some((number, line)),
            }
            line.push(b' ');
        }
    })
}

/// Why tobj refused a face: the lines once more, up to the first that is wrong.
fn bad_face(bytes: &[u8], name: &str, vertices: usize) -> Error {
    let mut so_far = 0;
    for (number, line) in logical_lines(bytes) {
        let place = || Place::line(name, number).column("f");
        let mut fields = fields(&line);
        match fields.next() {
            Some(b"v") => so_far += 1,
            Some(b"f") => {
                let mut corners = 0;
                for field in fields {
                    corners += 1;
                    if let Some(expected) = bad_corner(field, so_far, vertices) {
                        return Error::malformed(place(), quoted(field), expected);
                    }
                }
                if corners < 3 {
                    let found = format!("a face of {corners} corners");
                    return Error::malformed(place(), found, "at least three");
                }
            }
            _ => {}
        }
    }
    Error::malformed(Place::file(name), "faces that could not be read", EXPECTED)
}

/// What should be in place of a corner such as `3/1/2`, if something is wrong with it.
fn bad_corner(field: &[u8], so_far: usize, vertices: usize) -> Option<String> {
    let mut parts = field.split(|&b| b == b'/');
    let index = |part: &[u8]| std::str::from_utf8(part).ok()?.parse::<i64>().ok();
    let vertex = parts.next().and_then(index);
    let others: Vec<&[u8]> = parts.collect();
    let readable = others.iter().all(|p| p.is_empty() || index(p).is_some());
    match vertex {
        Some(v) if readable && others.len() <= 2 => {
            let magnitude = usize::try_from(v.unsigned_abs()).unwrap_or(usize::MAX);
            let limit = if v < 0 { so_far } else { vertices };
            (magnitude == 0 || magnitude > limit).then(|| match v {
                ..0 => format!("one of the {so_far} vertices so far, from -{so_far} to -1"),
                _ => format!("one of the {vertices} vertices, from 1 to {vertices}"),
            })
        }
        _ => Some("a vertex index, as V, V/VT, V//VN or V/VT/VN".into()),
    }
}

#[cfg(test)]
mod tests {
    use glam::DVec3;
    use proptest::prelude::*;

    use super::super::mesh_file::shared;
    use super::*;

    const SQUARE: &str = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n";

    fn parse(text: &str) -> Mesh {
        parse_obj(text.as_bytes(), "m.obj").expect(text)
    }

    fn refusal(text: &str) -> String {
        parse_obj(text.as_bytes(), "m.obj").expect_err(text).to_string()
    }

    #[test]
    fn every_way_to_write_a_face_is_read() {
        let wanted = vec![[0, 1, 2], [0, 2, 3]];
        for face in [
            "f 1 2 3 4",
            "f 1 2 3\nf 1 3 4",
            "f -4 -3 -2 -1",
            "f 1/7 2/8 3/9 4/10",
            "f 1//1 2//1 3//1 4//1",
            "f 1/1/1 2/2/2 3/3/3 4/4/4",
            "f\t1 2\t3  4 # a quad",
            "f 1 2 \\\n 3 4",
            "g a\nf 1 2 3\no b\nusemtl red\ns off\nf 1 3 4",
            "f 1/ 2/ 3/ 4/",
            "vt 0 0\nvn 0 0 1\nf 1/1/1 2/1/1 3//1 4/1",
            "f +1 2 3 4",
            "l 1 2\np 3\nf 1 2 3 4\nl 4 1",
        ] {
            assert_eq!(parse(&format!("{SQUARE}{face}")).faces(), wanted, "{face}");
            let crlf = format!("{SQUARE}{face}\n").replace('\n', "\r\n");
            assert_eq!(parse(&crlf).faces(), wanted, "{face} with CR LF");
        }
        assert_eq!(parse(&format!("f 1 2 3 4\n{SQUARE}")).faces(), wanted, "faces first");
        assert_eq!(parse(&SQUARE.replace('\n', "\r")).vertices().len(), 4);
    }

    #[test]
    fn vertices_stay_as_they_are_in_the_file() {
        let mesh = parse(
            "\u{feff}v 1 2 3 1.0\nv 4 5 6 0.5 0.5 0.5\nv\t7 8 9 1 0 0 0\n  v 1 2 3\nv 0.1 -1e-3 .5 # c\n",
        );
        assert_eq!(mesh.vertices()[3], DVec3::new(1.0, 2.0, 3.0));
        assert_eq!(mesh.vertices()[4], DVec3::new(0.1, -1e-3, 0.5));
        assert_eq!((mesh.vertices().len(), mesh.faces().len()), (5, 0));
        let latin1 = b"# caf\xe9 C:\\a\\\nmtllib \xe9.mtl\nv 1 2 3\n";
        assert_eq!(parse_obj(latin1, "m.obj").expect("valid").vertices().len(), 1);
    }

    #[test]
    fn more_vertices_than_16_bits_keep_their_numbers() {
        let mut text = String::new();
        for k in 0..70_000 {
            let _ = writeln!(text, "v {k} 0 0");
        }
        text.push_str("f 69999 65536 65537\nf 1 2 -1\n");
        assert_eq!(parse(&text).faces(), [[69_998, 65_535, 65_536], [0, 1, 69_999]]);
    }

    #[test]
    fn what_is_wrong_is_named_with_its_line() {
        let cases = [
            ("v 1 2\n", "m.obj:1:v: found two numbers, expected three finite numbers"),
            ("# c\n\nv 1 2 x\n", "m.obj:3:v: found 'x', expected three finite numbers"),
            ("v 1 2 nan\n", "m.obj:1:v: found 'nan', expected three finite numbers (up to 1e100)"),
            ("v 1 inf 3\n", "m.obj:1:v: found 'inf'"),
            ("v 1 1e400 3\n", "m.obj:1:v: found '1e400'"),
            ("v 0,1 0,2 0,3\n", "m.obj:1:v: found '0,1'"),
            ("v 1 \\\n2 x\n", "m.obj:1:v: found 'x'"),
            ("hello\n", "m.obj: found a file beginning with 'hello', expected a Wavefront OBJ"),
            ("f 1 2 3\n", "expected a Wavefront OBJ"),
        ];
        for (text, wanted) in cases {
            let found = refusal(text);
            assert!(found.contains(wanted), "{text:?}: {found}");
        }
        let cases = [
            ("f 1 2 5", "m.obj:5:f: found '5', expected one of the 4 vertices, from 1 to 4"),
            ("f 1 2 3\nf 0 1 2", "m.obj:6:f: found '0', expected one of the 4 vertices"),
            (
                "f 1 2 -5",
                "m.obj:5:f: found '-5', expected one of the 4 vertices so far, from -4 to -1",
            ),
            (
                "f 1 2 99999999999999999999",
                "m.obj:5:f: found '99999999999999999999', expected a vertex index",
            ),
            ("f 1 2 a", "m.obj:5:f: found 'a', expected a vertex index"),
            ("f 1 2 3/x", "m.obj:5:f: found '3/x'"),
            ("f 1 2 3/1/1/1", "m.obj:5:f: found '3/1/1/1'"),
            ("f 1 2 /1", "m.obj:5:f: found '/1'"),
            ("f 1 2", "m.obj:5:f: found a face of 2 corners, expected at least three"),
            ("f 1", "m.obj:5:f: found a face of 1 corners"),
            ("f 1 2 3\nf", "m.obj:6:f: found a face of 0 corners"),
            ("f 1 2 3 4\nf 1 2\nf 1 2 3 4", "m.obj:6:f: found a face of 2 corners"),
        ];
        for (face, wanted) in cases {
            let found = refusal(&format!("{SQUARE}{face}\n"));
            assert!(found.contains(wanted), "{face:?}: {found}");
        }
    }

    /// The corners' positions as tobj alone reads them from the file.
    fn by_tobj(text: &[u8]) -> Vec<[f32; 3]> {
        let options = tobj::LoadOptions {
            triangulate: true,
            ignore_lines: true,
            ignore_points: true,
            ..tobj::LoadOptions::default()
        };
        let none = |_: &std::path::Path| Err(tobj::LoadError::GenericFailure);
        let (models, _) =
            tobj::load_obj_buf(&mut BufReader::new(text), &options, none).expect("valid");
        let corner = |m: &tobj::Mesh, k: u32| [0, 1, 2].map(|c| m.positions[3 * k as usize + c]);
        models.iter().flat_map(|m| m.mesh.indices.iter().map(|&k| corner(&m.mesh, k))).collect()
    }

    #[test]
    fn the_drones_have_the_faces_tobj_finds() {
        for name in ["dji_mavic2/DJI.obj", "skydio_x2/assets/X2_lowpoly.obj"] {
            let Some(path) = shared::file(&format!("data/drones/{name}")) else { return };
            let bytes = std::fs::read(path).expect("readable");
            let mesh = parse_obj(&bytes, name).expect("valid");
            let position = |&k: &u32| mesh.vertices()[k as usize].as_vec3().to_array();
            let ours: Vec<_> = mesh.faces().iter().flatten().map(position).collect();
            assert_eq!(ours, by_tobj(&bytes), "{name}");
        }
    }

    fn line() -> impl Strategy<Value = String> {
        prop_oneof![
            "v( -?[0-9]{1,2}){3}",
            "f( [1-9](/[0-9]?){0,2}){3,5}",
            "f( -[1-4]){3,4}",
            "[fvlgo# ].{0,12}",
            "(v|f|f 1 2|usemtl|vn|vt)( [0-9a-z./-]{0,4}){0,4}\\\\?",
        ]
    }

    proptest! {
        #[test]
        fn no_text_makes_it_panic(lines in prop::collection::vec(line(), 0..30), end in "\n|\r\n|\r") {
            let text = lines.join(&end);
            if let Err(error) = parse_obj(text.as_bytes(), "m.obj") {
                prop_assert!(!error.to_string().contains('\n'));
                prop_assert!(!error.to_string().contains("could not be read"), "{}", error);
            }
        }

        #[test]
        fn no_bytes_make_it_panic(
            changes in prop::collection::vec((0..400_usize, any::<u8>()), 1..12), cut in 0..400_usize,
        ) {
            let mut bytes = format!("# x\n{SQUARE}f 1/1/1 2/2/2 3/3/3 4/4/4\ng a\nf -1 -2 -3\n").into_bytes();
            for (k, b) in changes {
                let n = bytes.len();
                bytes[k % n] = b;
            }
            bytes.truncate(cut);
            let _ = parse_obj(&bytes, "m.obj");
        }
    }
}
