//! The header of a PLY file: which elements follow, with which properties, in which encoding.

use super::super::mesh_text::{fields, not_a};
use super::EXPECTED;
use crate::error::{Error, Place, Result, quoted};

#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Encoding {
    Text,
    Little,
    Big,
}

/// The number types, all of which fit into an `f64` exactly.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Type {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

impl Type {
    pub(super) fn parse(word: &[u8]) -> Option<Self> {
        Some(match word {
            b"char" | b"int8" => Self::I8,
            b"uchar" | b"uint8" => Self::U8,
            b"short" | b"int16" => Self::I16,
            b"ushort" | b"uint16" => Self::U16,
            b"int" | b"int32" => Self::I32,
            b"uint" | b"uint32" => Self::U32,
            b"float" | b"float32" => Self::F32,
            b"double" | b"float64" => Self::F64,
            _ => return None,
        })
    }

    pub(super) fn is_integer(self) -> bool {
        !matches!(self, Self::F32 | Self::F64)
    }

    /// Bytes of a number.
    pub(super) fn size(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }

    /// The number in the first bytes, least significant first.
    pub(super) fn decode(self, b: [u8; 8]) -> f64 {
        let four = [b[0], b[1], b[2], b[3]];
        match self {
            Self::I8 => f64::from(i8::from_le_bytes([b[0]])),
            Self::U8 => f64::from(b[0]),
            Self::I16 => f64::from(i16::from_le_bytes([b[0], b[1]])),
            Self::U16 => f64::from(u16::from_le_bytes([b[0], b[1]])),
            Self::I32 => f64::from(i32::from_le_bytes(four)),
            Self::U32 => f64::from(u32::from_le_bytes(four)),
            Self::F32 => f64::from(f32::from_le_bytes(four)),
            Self::F64 => f64::from_le_bytes(b),
        }
    }
}

#[derive(Debug)]
pub(super) struct Property {
    pub(super) name: Vec<u8>,
    /// The type of the length, for a list.
    pub(super) length: Option<Type>,
    pub(super) kind: Type,
}

/// What an element is to the mesh, with the places of the properties that count.
#[derive(Debug, Clone, Copy)]
pub(super) enum Role {
    Vertex([usize; 3]),
    Face(usize),
    Other,
}

#[derive(Debug)]
pub(super) struct Element {
    pub(super) name: Vec<u8>,
    pub(super) count: u64,
    pub(super) properties: Vec<Property>,
    pub(super) role: Role,
}

impl Element {
    /// Finds the role, or says which property is missing.
    fn find_role(&mut self) -> Result<(), &'static str> {
        let find = |names: &[&str], list: bool| {
            self.properties.iter().position(|p| {
                names.iter().any(|n| n.as_bytes() == p.name) && p.length.is_some() == list
            })
        };
        self.role = match self.name.as_slice() {
            b"vertex" => match (find(&["x"], false), find(&["y"], false), find(&["z"], false)) {
                (Some(x), Some(y), Some(z)) => Role::Vertex([x, y, z]),
                _ => return Err("the properties x, y and z"),
            },
            b"face" => match find(&["vertex_indices", "vertex_index"], true) {
                Some(k) if self.properties[k].kind.is_integer() => Role::Face(k),
                _ => return Err("a list of integers named vertex_indices"),
            },
            _ => Role::Other,
        };
        Ok(())
    }
}

#[derive(Debug)]
pub(super) struct Header {
    pub(super) encoding: Encoding,
    pub(super) elements: Vec<Element>,
    pub(super) lines: u64,
}

impl Header {
    /// The header, and the bytes behind it.
    pub(super) fn parse<'a>(bytes: &'a [u8], name: &str) -> Result<(Self, &'a [u8])> {
        if !super::looks_like(bytes) {
            return Err(not_a(bytes, name, EXPECTED));
        }
        let mut encoding = None;
        let mut elements: Vec<Element> = Vec::new();
        let mut rest = bytes;
        let mut number = 0;
        loop {
            let Some((line, next)) = split_line(rest) else {
                let found = "the end of the file in the header";
                return Err(Error::malformed(Place::line(name, number), found, EXPECTED));
            };
            rest = next;
            number += 1;
            let words: Vec<&[u8]> = fields(line).collect();
            let wrong = |expected: &str| {
                Error::malformed(Place::line(name, number), quoted(line.trim_ascii()), expected)
            };
            match words.as_slice() {
                [b"ply"] if number == 1 => {}
                [] | [b"comment" | b"obj_info", ..] => {}
                [b"format", kind, b"1.0"] => {
                    encoding = Some(match *kind {
                        b"ascii" => Encoding::Text,
                        b"binary_little_endian" => Encoding::Little,
                        b"binary_big_endian" => Encoding::Big,
                        _ => return Err(wrong("ascii, binary_little_endian or binary_big_endian")),
                    });
                }
                [b"element", element, count] => {
                    let count = std::str::from_utf8(count).ok().and_then(|c| c.parse().ok());
                    let count = count.ok_or_else(|| wrong("a number of elements"))?;
                    let (name, role) = (element.to_vec(), Role::Other);
                    elements.push(Element { name, count, properties: Vec::new(), role });
                }
                [b"property", words @ ..] => {
                    let element = elements.last_mut().ok_or_else(|| wrong("an element first"))?;
                    element.properties.push(property(words).ok_or_else(|| {
                        wrong("'property TYPE NAME' or 'property list INTEGER_TYPE TYPE NAME'")
                    })?);
                }
                [b"end_header"] => break,
                _ => return Err(wrong("format, element, property, comment or end_header")),
            }
        }
        for element in &mut elements {
            if let Err(missing) = element.find_role() {
                let found = format!("an element {} without them", quoted(&element.name));
                return Err(Error::malformed(Place::file(name), found, missing));
            }
        }
        let place = Place::file(name);
        let encoding = encoding.ok_or_else(|| Error::malformed(place, "no format", EXPECTED))?;
        Ok((Self { encoding, elements, lines: number }, rest))
    }
}

fn property(words: &[&[u8]]) -> Option<Property> {
    let (length, kind, name) = match words {
        [b"list", length, kind, name] => (Some(Type::parse(length)?), kind, name),
        [kind, name] => (None, kind, name),
        _ => return None,
    };
    let property = Property { name: name.to_vec(), length, kind: Type::parse(kind)? };
    property.length.is_none_or(Type::is_integer).then_some(property)
}

/// A line ended by LF, CR LF or CR, and what is behind it.
pub(super) fn split_line(bytes: &[u8]) -> Option<(&[u8], &[u8])> {
    let end = memchr::memchr2(b'\n', b'\r', bytes)?;
    let ending = if bytes[end..].starts_with(b"\r\n") { 2 } else { 1 };
    Some((&bytes[..end], &bytes[end + ending..]))
}
