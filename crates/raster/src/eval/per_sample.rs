//! The errors of every sample as CSV (`--per-sample`).

use std::io::{self, Write};

use crate::eval::Samples;
use crate::io::PoseTable;

/// Write one line for each ground-truth pose, in its order: `id,matched,distance_m,...`. Fields of
/// samples without a prediction, and undefined projection errors, are empty.
///
/// # Errors
/// Of `out`.
pub fn write_per_sample(out: &mut dyn Write, gt: &PoseTable, s: &Samples) -> io::Result<()> {
    let degrees = |c: &[f64]| c.iter().map(|x| x.to_degrees()).collect::<Vec<_>>();
    let cpe: Vec<f64> = (0..s.len()).map(|i| s.cpe(i)).collect();
    let oe_deg = degrees(&s.oe_rad);
    let oe_sym_deg = s.oe_sym_rad.as_deref().map(degrees);
    let all: [(&str, Option<&[f64]>); 14] = [
        ("distance_m", Some(&s.distance_m)),
        ("azimuth_deg", Some(&s.azimuth_deg)),
        ("elevation_deg", Some(&s.elevation_deg)),
        ("te_m", Some(&s.te_m)),
        ("npe", Some(&s.npe)),
        ("oe_rad", Some(&s.oe_rad)),
        ("oe_deg", Some(&oe_deg)),
        ("cpe", Some(&cpe)),
        ("oe_sym_deg", oe_sym_deg.as_deref()),
        ("add_m", s.add_m.as_deref()),
        ("adds_m", s.adds_m.as_deref()),
        ("mssd_m", s.mssd_m.as_deref()),
        ("mspd_px", s.mspd_px.as_deref()),
        ("proj_px", s.proj_px.as_deref()),
    ];
    let columns: Vec<(&str, &[f64])> = all.into_iter().filter_map(|(n, c)| Some((n, c?))).collect();
    write!(out, "id,matched")?;
    for (name, _) in &columns {
        write!(out, ",{name}")?;
    }
    writeln!(out)?;
    let mut next = 0;
    for row in 0..gt.len() {
        write_field(out, &gt.id(row))?;
        let matched = s.gt_row.get(next).is_some_and(|&g| g as usize == row);
        write!(out, ",{}", u8::from(matched))?;
        for (_, column) in &columns {
            match column.get(next).filter(|x| matched && x.is_finite()) {
                Some(x) => write!(out, ",{x}")?,
                None => write!(out, ",")?,
            }
        }
        writeln!(out)?;
        next += usize::from(matched);
    }
    Ok(())
}

/// A field, quoted where RFC 4180 asks for it.
fn write_field(out: &mut dyn Write, text: &str) -> io::Result<()> {
    if text.contains([',', '"', '\n', '\r']) {
        write!(out, "\"{}\"", text.replace('"', "\"\""))
    } else {
        write!(out, "{text}")
    }
}
