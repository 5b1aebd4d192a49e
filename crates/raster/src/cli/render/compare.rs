//! The four modes of one pose side by side, with a piece of the outline under a magnifying glass.

use super::layers::Layers;
use crate::draw::{Canvas, Cell, ORANGE, TEAL, contour, sheet};
use crate::error::Result;
use crate::raster::{Mode, Size};

/// How wide a picture is shown.
const SHOWN: usize = 320;
/// Pixels of the picture along the longer side of the magnified piece.
const PIECE: usize = 32;

/// What a mode is called, with its parameters.
fn title(mode: Mode) -> String {
    match mode {
        Mode::Coverage { sigma } => format!("coverage, sigma {sigma} px"),
        Mode::Hard => "hard".to_owned(),
        Mode::Dibr { delta, .. } => format!("dibr, delta {delta}"),
        Mode::Sigmoid { sigma, .. } => format!("sigmoid, sigma {sigma:e} NDC"),
    }
}

fn area(mask: &[f32]) -> f64 {
    mask.iter().map(|m| f64::from(*m)).sum()
}

/// The picture for a frame.
pub(super) fn compare(layers: &Layers<'_>, modes: &[Mode]) -> Result<Canvas> {
    let Size { width, height } = layers.frame.size();
    let masks: Vec<Vec<f32>> = modes.iter().map(|m| layers.mask(*m)).collect::<Result<_>>()?;
    let truth = area(&layers.exact()?);
    let long = width.max(height);
    let (w, h) =
        ((PIECE * width).div_ceil(long).min(width), (PIECE * height).div_ceil(long).min(height));
    let (x, y) = busiest(&masks, width, (w, h));
    let times = (SHOWN / w).max(1);
    // The outline of the mesh in a picture that is as fine as the magnified one.
    let frame = layers.frame.window([x, y], Size { height: h, width: w }, times);
    let fine = Layers::new(layers.scene, &frame).exact()?;
    let outline = contour(&fine, w * times, h * times, 0.5);
    let mut wholes = Vec::new();
    let mut pieces = Vec::new();
    for (mode, mask) in modes.iter().zip(&masks) {
        let picture = Canvas::from_mask(width, height, mask);
        let mut piece = picture.crop(x, y, w, h).enlarged(times);
        piece.stroke(&outline, 2.0, ORANGE, 1.0);
        // The piece is marked in the picture as it is shown, so that the frame is never too thin.
        let zoom = (SHOWN / width).max(1);
        let mut whole = picture.enlarged(zoom).fitted(2 * SHOWN, 2 * SHOWN);
        let scale = whole.width() as f64 / width as f64;
        let corner = [x as f64 * scale, y as f64 * scale];
        whole.frame(corner, [w as f64 * scale, h as f64 * scale], 1.5, TEAL);
        let ratio = area(mask) / truth;
        let captions = if truth > 0.0 {
            vec![format!("{:.1} px = {ratio:.3} x true area", area(mask))]
        } else {
            vec![format!("{:.1} px", area(mask))]
        };
        wholes.push(Cell { picture: whole, title: title(*mode), captions });
        pieces.push(Cell { picture: piece, title: String::new(), captions: vec![] });
    }
    if let Some(first) = pieces.first_mut() {
        first.captions.push(format!("x{times}; line: true outline"));
    }
    let heading = format!("{}: true area {truth:.1} px", layers.frame.id);
    wholes.extend(pieces);
    Ok(sheet(&heading, &wholes, modes.len()))
}

/// Corner of the window of this size in which the masks differ most from each other.
fn busiest(masks: &[Vec<f32>], width: usize, (w, h): (usize, usize)) -> (usize, usize) {
    let height = masks.first().map_or(0, Vec::len) / width.max(1);
    if height < h || width < w {
        return (0, 0);
    }
    // Sums over the rectangle from the corner, one row and column more than the picture.
    let mut sums = vec![0.0_f64; (width + 1) * (height + 1)];
    for y in 0..height {
        let mut row = 0.0;
        for x in 0..width {
            let values = masks.iter().map(|m| f64::from(m[y * width + x]));
            let (low, high) =
                values.fold((f64::INFINITY, 0.0_f64), |(l, h), v| (l.min(v), h.max(v)));
            row += high - low;
            sums[(y + 1) * (width + 1) + x + 1] = sums[y * (width + 1) + x + 1] + row;
        }
    }
    let at = |x: usize, y: usize| sums[y * (width + 1) + x];
    let mut best = (f64::NEG_INFINITY, (0, 0));
    for y in 0..=height - h {
        for x in 0..=width - w {
            let sum = at(x + w, y + h) - at(x, y + h) - at(x + w, y) + at(x, y);
            // Rounding must not move the window about.
            if sum > best.0 + 1e-6 {
                best = (sum, (x, y));
            }
        }
    }
    best.1
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_window_lies_where_the_masks_differ() {
        let flat = vec![0.5_f32; 20 * 10];
        let mut other = flat.clone();
        for (x, y) in [(13, 6), (14, 6), (14, 7), (2, 2)] {
            other[y * 20 + x] = 1.0;
        }
        let (x, y) = busiest(&[flat.clone(), other], 20, (4, 3));
        assert!((11..=13).contains(&x) && (5..=6).contains(&y), "{x} {y}");
        assert_eq!(busiest(&[flat.clone(), flat], 20, (4, 3)), (0, 0));
    }
}
