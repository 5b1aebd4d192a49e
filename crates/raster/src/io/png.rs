//! Pictures: PNG written in 8 and 16 bits, PNG and JPEG read as RGB.

use std::io::{self, Cursor, Read, Write};
use std::path::Path;

use crate::error::{Error, Place, Result};
use crate::io::input::Input;

/// A picture above this is refused.
const LARGEST_FILE: u64 = 256 << 20;

/// The size of a picture is said before this many bytes.
const LARGEST_HEAD: u64 = 1 << 20;

/// Samples of a picture to write, row by row.
#[derive(Debug, Clone, Copy)]
pub enum Samples<'a> {
    /// One byte a pixel.
    Gray8(&'a [u8]),
    /// One number of 16 bits a pixel.
    Gray16(&'a [u16]),
    /// Red, green and blue a pixel.
    Rgb8(&'a [[u8; 3]]),
}

/// Write a picture; `comment` says what the numbers mean and goes into a text chunk.
///
/// # Errors
/// What the writer says; [`io::ErrorKind::InvalidInput`] for another number of pixels.
pub fn write_png(
    out: &mut dyn Write,
    width: usize,
    height: usize,
    samples: Samples<'_>,
    comment: &str,
) -> io::Result<()> {
    let (color, depth, pixels) = match samples {
        Samples::Gray8(s) => (png::ColorType::Grayscale, png::BitDepth::Eight, s.len()),
        Samples::Gray16(s) => (png::ColorType::Grayscale, png::BitDepth::Sixteen, s.len()),
        Samples::Rgb8(s) => (png::ColorType::Rgb, png::BitDepth::Eight, s.len()),
    };
    let side = |n: usize| u32::try_from(n).ok().filter(|&n| n > 0);
    let (Some(w), Some(h), true) = (side(width), side(height), pixels == width * height) else {
        let text = format!("{pixels} pixels for a picture of {width} x {height}");
        return Err(io::Error::new(io::ErrorKind::InvalidInput, text));
    };
    let mut encoder = png::Encoder::new(out, w, h);
    encoder.set_color(color);
    encoder.set_depth(depth);
    encoder.set_compression(png::Compression::Balanced);
    encoder.add_text_chunk(
        "Software".to_owned(),
        concat!("dronepose ", env!("CARGO_PKG_VERSION")).to_owned(),
    )?;
    if !comment.is_empty() {
        encoder.add_text_chunk("Comment".to_owned(), comment.to_owned())?;
    }
    let mut writer = encoder.write_header()?;
    match samples {
        Samples::Gray8(s) => writer.write_image_data(s)?,
        Samples::Gray16(s) => {
            let bytes: Vec<u8> = s.iter().flat_map(|x| x.to_be_bytes()).collect();
            writer.write_image_data(&bytes)?;
        }
        Samples::Rgb8(s) => writer.write_image_data(s.as_flattened())?,
    }
    writer.finish()?;
    Ok(())
}

/// A picture that was read.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Picture {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Row by row.
    pub pixels: Vec<[u8; 3]>,
}

/// Read a PNG or JPEG file as 8-bit RGB; transparency is dropped.
///
/// # Errors
/// [`Error::Read`]; [`Error::Malformed`] for another format or a broken file.
pub fn read_picture(path: &Path) -> Result<Picture> {
    let mut input = Input::open(path)?;
    let bytes = input.read_all(LARGEST_FILE)?;
    let refuse = |found: String| Error::malformed(input.place(), found, "a PNG or JPEG picture");
    if bytes.starts_with(b"\x89PNG") {
        decode_png(&bytes).map_err(|e| refuse(format!("a broken PNG ({e})")))
    } else if bytes.starts_with(&[0xff, 0xd8]) {
        decode_jpeg(&bytes).map_err(|e| refuse(format!("a broken JPEG ({e})")))
    } else {
        Err(refuse("something else".to_owned()))
    }
}

/// The size of a PNG or JPEG file, from its header alone.
///
/// # Errors
/// As [`read_picture`].
pub fn picture_size(path: &Path) -> Result<(usize, usize)> {
    let mut input = Input::open(path)?;
    let place = Place::file(&path.display().to_string());
    let refuse = |found: String| Error::malformed(place.clone(), found, "a PNG or JPEG picture");
    let mut bytes = Vec::new();
    let head = input.by_ref().take(LARGEST_HEAD).read_to_end(&mut bytes);
    head.map_err(|source| Error::Read { path: path.to_owned(), source })?;
    if bytes.starts_with(b"\x89PNG") {
        let reader = png::Decoder::new(Cursor::new(&bytes)).read_info();
        let info = reader.map_err(|e| refuse(format!("a broken PNG ({e})")))?.info().size();
        Ok((info.0 as usize, info.1 as usize))
    } else if bytes.starts_with(&[0xff, 0xd8]) {
        let mut decoder = zune_jpeg::JpegDecoder::new(Cursor::new(&bytes));
        decoder.decode_headers().map_err(|e| refuse(format!("a broken JPEG ({e})")))?;
        decoder.dimensions().ok_or_else(|| refuse("a JPEG without a size".to_owned()))
    } else {
        Err(refuse("something else".to_owned()))
    }
}

fn decode_png(bytes: &[u8]) -> Result<Picture, png::DecodingError> {
    let mut decoder = png::Decoder::new(Cursor::new(bytes));
    decoder.set_transformations(png::Transformations::normalize_to_color8());
    let mut reader = decoder.read_info()?;
    let size = reader.output_buffer_size().ok_or(png::DecodingError::LimitsExceeded)?;
    let mut data = vec![0; size];
    let info = reader.next_frame(&mut data)?;
    data.truncate(info.buffer_size());
    let channels = info.color_type.samples();
    let pixels = data
        .chunks_exact(channels)
        .map(|p| if channels < 3 { [p[0]; 3] } else { [p[0], p[1], p[2]] })
        .collect();
    Ok(Picture { width: info.width as usize, height: info.height as usize, pixels })
}

fn decode_jpeg(bytes: &[u8]) -> Result<Picture, String> {
    let mut decoder = zune_jpeg::JpegDecoder::new(Cursor::new(bytes));
    let data = decoder.decode().map_err(|e| e.to_string())?;
    let (width, height) = decoder.dimensions().ok_or("no size")?;
    let channels = data.len() / (width * height).max(1);
    let pixels: Vec<[u8; 3]> = match channels {
        1 => data.iter().map(|&g| [g; 3]).collect(),
        3 => data.chunks_exact(3).map(|p| [p[0], p[1], p[2]]).collect(),
        n => return Err(format!("{n} channels")),
    };
    Ok(Picture { width, height, pixels })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn file(bytes: &[u8]) -> (tempfile::TempDir, std::path::PathBuf) {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("picture");
        std::fs::write(&path, bytes).expect("written");
        (folder, path)
    }

    #[test]
    fn what_is_written_is_read_back() {
        let rgb: Vec<[u8; 3]> = (0..6).map(|k| [k, 10 * k, 255 - k]).collect();
        let mut bytes = Vec::new();
        write_png(&mut bytes, 3, 2, Samples::Rgb8(&rgb), "colours").expect("in memory");
        let (_folder, path) = file(&bytes);
        let read = read_picture(&path).expect("a picture");
        assert_eq!(read, Picture { width: 3, height: 2, pixels: rgb });
        assert_eq!(picture_size(&path).expect("a picture"), (3, 2));
        assert!(bytes.windows(7).any(|w| w == b"colours"));
    }

    #[test]
    fn sixteen_bits_stay_sixteen() {
        let deep = [0, 1, 256, 65_535];
        let mut bytes = Vec::new();
        write_png(&mut bytes, 2, 2, Samples::Gray16(&deep), "").expect("in memory");
        let mut reader = png::Decoder::new(Cursor::new(&bytes)).read_info().expect("a picture");
        let mut data = vec![0; reader.output_buffer_size().expect("small")];
        reader.next_frame(&mut data).expect("a frame");
        let read: Vec<u16> =
            data.chunks_exact(2).map(|b| u16::from_be_bytes([b[0], b[1]])).collect();
        assert_eq!(read, deep);
    }

    #[test]
    fn what_is_no_picture_is_refused_by_name() {
        for (bytes, found) in [
            (&b"hello"[..], "something else"),
            (b"", "something else"),
            (b"\x89PNG\r\n\x1a\nxx", "a broken PNG"),
            (&[0xff, 0xd8, 0xff, 0xe0, 0], "a broken JPEG"),
        ] {
            let (_folder, path) = file(bytes);
            for error in [read_picture(&path).map(|_| ()), picture_size(&path).map(|_| ())] {
                let text = error.expect_err("refused").to_string();
                assert!(text.contains(&format!("found {found}")), "{text}");
            }
        }
        let error =
            write_png(&mut Vec::new(), 2, 2, Samples::Gray8(&[0]), "").expect_err("refused");
        assert_eq!(error.to_string(), "1 pixels for a picture of 2 x 2");
    }
}
