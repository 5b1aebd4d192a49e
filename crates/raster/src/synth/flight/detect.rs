//! The format of a flight by its first line.

use crate::synth::flight::Format;

/// The format that the first bytes of a file look like.
pub(super) fn detect(head: &[u8]) -> Option<Format> {
    let head = head.strip_prefix(b"\xef\xbb\xbf").unwrap_or(head);
    let mut lines =
        head.split(|&b| b == b'\n' || b == b'\r').map(<[u8]>::trim_ascii).filter(|l| !l.is_empty());
    let first = lines.next()?;
    let lower = first.to_ascii_lowercase();
    let holds = |text: &[u8]| memchr::memmem::find(&lower, text).is_some();
    if lower.contains(&b'\t') && holds(b"position(x)_t1") {
        return Some(Format::Uava);
    }
    if lower.contains(&b'\t') && holds(b"pos_x") {
        return Some(Format::Airsim);
    }
    if holds(b"p_rs_r_x") {
        return Some(Format::Euroc);
    }
    // The first line that is no comment decides what a comment could not.
    let comment = first.starts_with(b"#");
    let row = if comment { lines.find(|l| !l.starts_with(b"#")) } else { Some(first) };
    let names = first.contains(&b',') && holds(b"qw");
    let Some(row) = row else { return names.then_some(Format::Csv) };
    if comment && names && row.contains(&b',') {
        return Some(Format::Csv);
    }
    if row.contains(&b',') {
        let fields: Vec<&[u8]> = row.split(|&b| b == b',').map(<[u8]>::trim_ascii).collect();
        let numeric = fields.iter().all(|f| fast_float2::parse::<f64, _>(f).is_ok());
        let stamp = fields[0].len() >= 18 && fields[0].iter().all(u8::is_ascii_digit);
        return match (numeric, stamp) {
            (true, true) if fields.len() >= 8 => Some(Format::Euroc),
            (false, _) if holds(b"qw") || holds(b"qx") => Some(Format::Csv),
            _ => None,
        };
    }
    let fields: Vec<&[u8]> =
        row.split(u8::is_ascii_whitespace).filter(|f| !f.is_empty()).take(100).collect();
    let numeric = fields.iter().all(|f| fast_float2::parse::<f64, _>(f).is_ok());
    (numeric && fields.len() >= 8).then_some(Format::Tum)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_first_line_says_the_format() {
        for (text, format) in [
            ("Position(x)_t1\tPosition(y)_t1\n", Some(Format::Uava)),
            ("VehicleName\tTimeStamp\tPOS_X\tPOS_Y\n", Some(Format::Airsim)),
            ("TimeStamp\tPOS_X\tPOS_Y\n", Some(Format::Airsim)),
            ("# timestamp(s) tx ty tz qx qy qz qw\n1.0 0 0 0 0 0 0 1\n", Some(Format::Tum)),
            ("1.0 0 0 0 0 0 0 1\n", Some(Format::Tum)),
            ("#timestamp, p_RS_R_x [m], p_RS_R_y [m]\n", Some(Format::Euroc)),
            ("#timestamp [ns],p_x,p_y\n1403715524907143168,0,0,0,1,0,0,0\n", Some(Format::Euroc)),
            ("\u{feff}t,x,y,z,qw,qx,qy,qz\n", Some(Format::Csv)),
            ("# t,x,y,z,qw,qx,qy,qz\n", Some(Format::Csv)),
            ("1,0,0,0,1,0,0,0\n", None),
            ("hello world\n", None),
            ("# t,x,y,z,qw,qx,qy,qz\n0,0,0,0,1,0,0,0\n", Some(Format::Csv)),
            ("# x y z qx qy qz qw, metres\n1.0 0 0 0 0 0 0 1\n", Some(Format::Tum)),
            ("# only a comment\n", None),
            ("", None),
        ] {
            assert_eq!(detect(text.as_bytes()), format, "{text:?}");
        }
    }
}
