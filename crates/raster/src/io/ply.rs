//! PLY (Stanford polygon format): text, and binary in both byte orders.
//!
//! By hand, for what counts here is what a reader does with broken files: nothing is reserved on
//! the word of the header, and every refusal names the line, or the element and its number.

mod header;

use glam::DVec3;

use self::header::{Element, Encoding, Header, Property, Role, Type, split_line};
use super::mesh_text::{fields, in_range, lines, number, triangulate};
use crate::error::{Error, Place, Result, quoted};
use crate::mesh::Mesh;

const EXPECTED: &str = "a PLY file ('ply', 'format', ..., 'end_header')";

pub(super) fn looks_like(bytes: &[u8]) -> bool {
    bytes.starts_with(b"ply\n") || bytes.starts_with(b"ply\r")
}

/// The mesh of a PLY file; `name` is the file's, for messages.
///
/// Read are `x y z` of the element `vertex` and `vertex_indices` (or `vertex_index`) of the
/// element `face`, of any type; all else is skipped. Polygons are cut into triangles.
///
/// # Errors
/// [`Error::Malformed`], with the line, or with the element and its number from 0.
pub fn parse_ply(bytes: &[u8], name: &str) -> Result<Mesh> {
    let (header, body) = Header::parse(bytes, name)?;
    let mut reader = Reader { name, encoding: header.encoding, rest: body, line: header.lines };
    let mut vertices = Vec::new();
    let mut faces: Vec<(u32, Spot<'_>)> = Vec::new();
    let mut corners: Vec<f64> = Vec::new();
    let (mut row, mut list) = (Vec::new(), Vec::new());
    for element in &header.elements {
        // An element without properties takes no bytes, however many there are.
        let count = if element.properties.is_empty() { 0 } else { element.count };
        for k in 0..count {
            let spot = reader.element(element, k, &mut row, &mut list)?;
            match element.role {
                Role::Vertex([x, y, z]) => {
                    let p = DVec3::new(row[x], row[y], row[z]);
                    vertices.push(in_range(p, || spot.place())?);
                }
                Role::Face(_) if list.len() < 3 => {
                    let found = format!("a face of {} corners", list.len());
                    return Err(Error::malformed(spot.place(), found, "at least three"));
                }
                Role::Face(_) => {
                    faces.push((list.len() as u32, spot));
                    corners.extend(&list);
                }
                Role::Other => {}
            }
        }
    }
    reader.end()?;
    if vertices.is_empty() {
        return Err(Error::malformed(Place::file(name), "no vertex", "at least one"));
    }
    let mut triangles = Vec::new();
    let (mut face, mut rest) = (Vec::new(), corners.as_slice());
    for (size, spot) in faces {
        let (here, next) = rest.split_at(size as usize);
        face.clear();
        for &index in here {
            if !(index >= 0.0 && index < vertices.len() as f64) {
                let n = vertices.len();
                let expected = format!("one of the {n} vertices, from 0 to {}", n - 1);
                return Err(Error::malformed(
                    spot.place(),
                    format!("vertex index {index}"),
                    expected,
                ));
            }
            face.push(index as u32);
        }
        triangulate(&vertices, &face, &mut triangles);
        rest = next;
    }
    Mesh::new(vertices, triangles)
}

/// Where an element is: in a text its line, else its number.
#[derive(Debug, Clone, Copy)]
struct Spot<'a> {
    file: &'a str,
    element: Option<&'a Element>,
    number: u64,
}

impl Spot<'_> {
    fn place(&self) -> Place {
        let Some(element) = self.element else { return Place::line(self.file, self.number) };
        Place::file(self.file).column(format!("{} {}", plain(&element.name), self.number))
    }
}

/// A name of the header in a message.
fn plain(name: &[u8]) -> String {
    quoted(name).trim_matches('\'').to_owned()
}

/// The elements, one after the other.
struct Reader<'a> {
    name: &'a str,
    encoding: Encoding,
    rest: &'a [u8],
    line: u64,
}

impl<'a> Reader<'a> {
    /// Reads an element: its scalars into `row` (a list leaves a 0) and the list that counts into
    /// `list`.
    fn element(
        &mut self,
        element: &'a Element,
        k: u64,
        row: &mut Vec<f64>,
        list: &mut Vec<f64>,
    ) -> Result<Spot<'a>> {
        row.clear();
        list.clear();
        let mut spot = Spot { file: self.name, element: Some(element), number: k };
        let mut line = &[][..];
        if self.encoding == Encoding::Text {
            line = self.text_line(element, k)?;
            spot = Spot { element: None, number: self.line, ..spot };
        }
        let mut words = fields(line);
        for (j, property) in element.properties.iter().enumerate() {
            let mut scalar = |kind| match self.encoding {
                Encoding::Text => text_scalar(&mut words, kind, spot, property),
                _ => self.binary_scalar(kind, spot, element),
            };
            let Some(length) = property.length else {
                row.push(scalar(property.kind)?);
                continue;
            };
            row.push(0.0);
            let length = scalar(length)?;
            if length < 0.0 {
                let found = format!("a list of {length} values");
                return Err(Error::malformed(spot.place(), found, "a length that is not negative"));
            }
            let counts = matches!(element.role, Role::Face(face) if face == j);
            for _ in 0..length as u64 {
                let value = scalar(property.kind)?;
                if counts {
                    list.push(value);
                }
            }
        }
        if let Some(word) = words.next() {
            let expected = "the end of the line, after all properties of the header";
            return Err(Error::malformed(spot.place(), quoted(word), expected));
        }
        Ok(spot)
    }

    /// The next line that is not blank.
    fn text_line(&mut self, element: &Element, k: u64) -> Result<&'a [u8]> {
        while !self.rest.is_empty() {
            let (line, rest) = split_line(self.rest).unwrap_or((self.rest, &[]));
            (self.rest, self.line) = (rest, self.line + 1);
            if !line.trim_ascii().is_empty() {
                return Ok(line);
            }
        }
        let found = format!("the end of the file after {k} of {}", element.count);
        let expected = format!("more of {}; is the file complete?", quoted(&element.name));
        Err(Error::malformed(Place::line(self.name, self.line), found, expected))
    }

    fn binary_scalar(&mut self, kind: Type, spot: Spot<'_>, element: &Element) -> Result<f64> {
        let Some((number, rest)) = self.rest.split_at_checked(kind.size()) else {
            let expected = format!("{} of them; is the file complete?", element.count);
            return Err(Error::malformed(spot.place(), "the end of the file", expected));
        };
        self.rest = rest;
        let mut bytes = [0; 8];
        bytes[..number.len()].copy_from_slice(number);
        if self.encoding == Encoding::Big {
            bytes[..number.len()].reverse();
        }
        Ok(kind.decode(bytes))
    }

    /// Refuses a text that goes on behind the last element: some count in the header is too small.
    fn end(&self) -> Result<()> {
        if self.encoding != Encoding::Text || self.rest.trim_ascii().is_empty() {
            return Ok(());
        }
        let blank = |(_, line): &(u64, &[u8])| line.trim_ascii().is_empty();
        let (skipped, line) = lines(self.rest).find(|l| !blank(l)).unwrap_or((1, self.rest));
        let place = Place::line(self.name, self.line + skipped);
        Err(Error::malformed(
            place,
            quoted(line.trim_ascii()),
            "no more elements after those of the header",
        ))
    }
}

fn text_scalar<'a>(
    words: &mut impl Iterator<Item = &'a [u8]>,
    kind: Type,
    spot: Spot<'_>,
    property: &Property,
) -> Result<f64> {
    let place = || spot.place().column(plain(&property.name));
    let expected = if kind.is_integer() { "an integer" } else { "a number" };
    let Some(word) = words.next() else {
        return Err(Error::malformed(place(), "the end of the line", expected));
    };
    let value = number(word).filter(|v| !kind.is_integer() || v.fract() == 0.0);
    value.ok_or_else(|| Error::malformed(place(), quoted(word), expected))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const HEADER: &str = "ply\nformat ENCODING 1.0\ncomment by hand\nobj_info x\n\
        element camera 1\nproperty list uchar float view\nproperty short id\n\
        element vertex 5\nproperty uchar red\nproperty float x\nproperty double y\n\
        property float z\nproperty list uint8 int8 bones\n\
        element face 2\nproperty uchar flag\nproperty list uchar int vertex_indices\n\
        property list int ushort more\nelement empty 99999999999\nend_header\n";
    const BODY: &str = "2 0.5 0.25 -3\n\n255 0 0 0 0\n1 1 0 0 2 1 -1\n1 1 1 0 0\n\
        1 0 1.0 0 1 4\n0 0.5 0.5 -1e0 0\n\n7 4 0 1 2 3 1 5\n8 3 0 1 4 0\n";

    fn text() -> String {
        HEADER.replace("ENCODING", "ascii") + BODY
    }

    /// The same file in binary, from the numbers of the text.
    fn binary(big: bool) -> Vec<u8> {
        let encoding = if big { "binary_big_endian" } else { "binary_little_endian" };
        let mut bytes = HEADER.replace("ENCODING", encoding).into_bytes();
        let (header, _) = Header::parse(&bytes, "m.ply").expect("valid");
        let mut words = BODY.split_ascii_whitespace().map(|w| w.parse::<f64>().expect("a number"));
        let mut put = |kind: Type| {
            let value = words.next().expect("complete");
            let mut number = match kind {
                Type::I8 => (value as i8).to_le_bytes().to_vec(),
                Type::U8 => (value as u8).to_le_bytes().to_vec(),
                Type::I16 => (value as i16).to_le_bytes().to_vec(),
                Type::U16 => (value as u16).to_le_bytes().to_vec(),
                Type::I32 => (value as i32).to_le_bytes().to_vec(),
                Type::U32 => (value as u32).to_le_bytes().to_vec(),
                Type::F32 => (value as f32).to_le_bytes().to_vec(),
                Type::F64 => value.to_le_bytes().to_vec(),
            };
            if big {
                number.reverse();
            }
            bytes.extend(number);
            value
        };
        for element in header.elements.iter().filter(|e| !e.properties.is_empty()) {
            for property in (0..element.count).flat_map(|_| &element.properties) {
                let length = property.length.map_or(1, |kind| put(kind) as usize);
                for _ in 0..length {
                    put(property.kind);
                }
            }
        }
        bytes
    }

    fn refusal(bytes: &[u8]) -> String {
        parse_ply(bytes, "m.ply").expect_err("refused").to_string()
    }

    #[test]
    fn all_encodings_hold_the_same_mesh() {
        let crlf = text().replace('\n', "\r\n").into_bytes();
        let cr = text().replace('\n', "\r").into_bytes();
        for bytes in [text().into_bytes(), crlf, cr, binary(false), binary(true)] {
            let mesh = parse_ply(&bytes, "m.ply").expect("valid");
            assert_eq!(mesh.vertices()[3], DVec3::new(0.0, 1.0, 0.0));
            assert_eq!(mesh.vertices()[4], DVec3::new(0.5, 0.5, -1.0));
            assert_eq!(mesh.faces(), [[0, 1, 2], [0, 2, 3], [0, 1, 4]]);
        }
    }

    #[test]
    fn points_alone_are_a_mesh() {
        let text = "ply\nformat ascii 1.0\nelement vertex 1\nproperty int x\nproperty int y\n\
            property int z\nend_header\n1 2 3";
        let mesh = parse_ply(text.as_bytes(), "m.ply").expect("valid");
        assert_eq!((mesh.vertices(), mesh.faces().len()), (&[DVec3::new(1.0, 2.0, 3.0)][..], 0));
    }

    #[test]
    fn what_is_wrong_is_named_with_its_place() {
        let cases = [
            ("ascii 1.0", "ascii 2.0", "m.ply:2: found 'format ascii 2.0', expected format,"),
            ("ascii", "utf8", "m.ply:2: found 'format utf8 1.0', expected ascii, binary_little"),
            ("vertex 5", "vertex -5", "m.ply:8: found 'element vertex -5', expected a number of"),
            (
                "float z",
                "float w",
                "m.ply: found an element 'vertex' without them, expected the prop",
            ),
            ("float z", "real z", "m.ply:12: found 'property real z', expected 'property TYPE"),
            ("uchar int v", "uchar float v", "'face' without them, expected a list of integers"),
            ("uchar int v", "float int v", "m.ply:16: found 'property list float int"),
            ("obj_info", "element", "m.ply:4: found 'element x'"),
            ("end_header", "comment", "m.ply:20: found '2 0.5 0.25 -3', expected format, element"),
            ("1 0 1.0", "1 0 x", "m.ply:25:y: found 'x', expected a number"),
            ("1 0 1.0", "1 0 nan", "m.ply:25: found (0, NaN, 0), expected three finite"),
            (
                "1 4\n0 0.5",
                "\n0 0.5",
                "m.ply:25:bones: found the end of the line, expected an integer",
            ),
            ("1 1 1 0 0\n", "1 1 1 0 0 9\n", "m.ply:24: found '9', expected the end of the line"),
            ("4 0 1 2 3", "4 0 1 2 5", "m.ply:28: found vertex index 5, expected one of the 5"),
            ("4 0 1 2 3", "4 0 1 2 -1", "m.ply:28: found vertex index -1, expected one"),
            ("4 0 1 2 3", "2 0 1", "m.ply:28: found a face of 2 corners, expected at least"),
            ("4 0 1 2 3", "-4 0 1 2 3", "m.ply:28: found a list of -4 values"),
            (
                "4 0 1 2 3",
                "4 0 1 2 2.5",
                "m.ply:28:vertex_indices: found '2.5', expected an integer",
            ),
            (
                "8 3 0 1 4 0\n",
                "",
                "m.ply:28: found the end of the file after 1 of 2, expected more of 'face'",
            ),
            ("face 2", "face 1", "m.ply:29: found '8 3 0 1 4 0', expected no more elements"),
        ];
        for (from, to, wanted) in cases {
            let changed = text().replacen(from, to, 1);
            assert_ne!(changed, text(), "{from}");
            let found = refusal(changed.as_bytes());
            assert!(found.contains(wanted), "{wanted}: {found}");
        }
        let bytes = binary(false);
        let cut = refusal(&bytes[..bytes.len() - 1]);
        assert_eq!(
            cut,
            "m.ply:face 1: found the end of the file, expected 2 of them; is the file complete?"
        );
        let text = "ply\nformat ascii 1.0\nelement vertex 0\nproperty int x\nproperty int y\n\
            property int z\nend_header\n";
        assert_eq!(refusal(text.as_bytes()), "m.ply: found no vertex, expected at least one");
    }

    #[test]
    fn a_header_that_promises_too_much_costs_nothing() {
        for (from, to) in
            [("vertex 5", "vertex 18446744073709551615"), ("face 2", "face 4294967295")]
        {
            let changed = String::from_utf8_lossy(&binary(false)).replacen(from, to, 1);
            assert!(refusal(changed.as_bytes()).contains("m.ply:"));
        }
    }

    proptest! {
        #[test]
        fn no_bytes_make_it_panic(
            kind in 0..3,
            changes in prop::collection::vec((0..700_usize, any::<u8>()), 0..8),
            cut in 0..700_usize,
        ) {
            let mut bytes = if kind == 0 { text().into_bytes() } else { binary(kind == 1) };
            for (k, b) in changes {
                let n = bytes.len();
                bytes[k % n] = b;
            }
            let _ = parse_ply(&bytes, "m.ply");
            bytes.truncate(cut);
            let _ = parse_ply(&bytes, "m.ply");
        }
    }
}
