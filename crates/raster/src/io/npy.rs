//! Writing arrays as `NumPy` reads them: format NPY 1.0, little-endian, C order.

use std::io::{self, Write};

/// Bytes before the data are a multiple of this, as the format asks.
const ALIGNMENT: usize = 64;

/// Write `data` as an array of type `float32` and this shape.
///
/// # Errors
/// What the writer says; [`io::ErrorKind::InvalidInput`] if the shape holds another number of
/// elements.
pub fn write_f32(out: &mut dyn Write, shape: &[usize], data: &[f32]) -> io::Result<()> {
    if shape.iter().product::<usize>() != data.len() {
        let text = format!("{} numbers for an array of shape {shape:?}", data.len());
        return Err(io::Error::new(io::ErrorKind::InvalidInput, text));
    }
    out.write_all(&header("<f4", shape)?)?;
    let mut bytes = Vec::with_capacity(1 << 16);
    for chunk in data.chunks(1 << 14) {
        bytes.clear();
        bytes.extend(chunk.iter().flat_map(|x| x.to_le_bytes()));
        out.write_all(&bytes)?;
    }
    Ok(())
}

/// Magic, version, and the dictionary, padded with blanks.
fn header(descr: &str, shape: &[usize]) -> io::Result<Vec<u8>> {
    let sizes: Vec<String> = shape.iter().map(usize::to_string).collect();
    // (3,) for one axis, (2, 3) for two.
    let sizes = sizes.join(", ") + if shape.len() == 1 { "," } else { "" };
    let mut text = format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': ({sizes}), }}");
    let before = 10;
    let total = (before + text.len() + 1).next_multiple_of(ALIGNMENT);
    text.extend(std::iter::repeat_n(' ', total - before - text.len() - 1));
    text.push('\n');
    let length = u16::try_from(text.len())
        .map_err(|_| io::Error::new(io::ErrorKind::InvalidInput, "too many axes for NPY 1.0"))?;
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend(length.to_le_bytes());
    bytes.extend(text.as_bytes());
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_header_is_what_numpy_writes_itself() {
        // numpy.save of zeros((2, 3), "<f4"), byte for byte.
        let mut out = Vec::new();
        write_f32(&mut out, &[2, 3], &[0.0, 1.0, 2.0, 3.0, 4.0, 5.0]).expect("in memory");
        assert_eq!(out.len(), 128 + 24);
        assert_eq!(&out[..10], b"\x93NUMPY\x01\x00\x76\x00");
        let text = String::from_utf8_lossy(&out[10..128]);
        assert_eq!(text.trim_end(), "{'descr': '<f4', 'fortran_order': False, 'shape': (2, 3), }");
        assert!(text.ends_with(" \n"));
        assert_eq!(out[128 + 4..128 + 8], 1.0_f32.to_le_bytes());
    }

    #[test]
    fn one_axis_keeps_its_comma_and_a_wrong_shape_is_refused() {
        let text = header("<f4", &[7]).expect("short");
        assert!(String::from_utf8_lossy(&text).contains("'shape': (7,), }"));
        assert_eq!(text.len() % ALIGNMENT, 0);
        let error = write_f32(&mut Vec::new(), &[2, 2], &[0.0]).expect_err("refused");
        assert_eq!(error.to_string(), "1 numbers for an array of shape [2, 2]");
    }
}
