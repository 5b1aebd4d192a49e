//! Labels in Noto Sans Mono, 16 pixels high.

use noto_sans_mono_bitmap::{FontWeight, RasterHeight, get_raster, get_raster_width};

use super::{Canvas, Rgb};

/// Height of a line of text in pixels.
pub const LINE_HEIGHT: usize = RasterHeight::Size16.val();

const ADVANCE: usize = get_raster_width(FontWeight::Regular, RasterHeight::Size16);

/// Width of a text in pixels.
#[must_use]
pub fn text_width(text: &str) -> usize {
    ADVANCE * text.chars().count()
}

/// The text, or its two ends with `..` between, so that it is no wider than `width` pixels.
#[must_use]
pub fn fitted(text: &str, width: usize) -> String {
    let (count, room) = (text.chars().count(), width / ADVANCE);
    if count <= room {
        return text.to_owned();
    }
    let Some(kept) = room.checked_sub(2) else { return text.chars().take(room).collect() };
    let tail = kept - kept / 2;
    let head: String = text.chars().take(kept / 2).collect();
    head + ".." + &text.chars().skip(count - tail).collect::<String>()
}

impl Canvas {
    /// Write one line, its top left corner at `(x, y)`. What the font lacks is a question mark.
    pub fn text(&mut self, x: usize, y: usize, text: &str, color: Rgb) {
        let raster = |c| get_raster(c, FontWeight::Regular, RasterHeight::Size16);
        for (k, c) in text.chars().enumerate() {
            let Some(glyph) = raster(c).or_else(|| raster('?')) else { continue };
            for (row, line) in glyph.rows().enumerate() {
                for (column, &ink) in line.iter().enumerate() {
                    self.blend(x + k * ADVANCE + column, y + row, color, f64::from(ink) / 255.0);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_text_leaves_ink_within_its_width() {
        let mut canvas = Canvas::new(80, LINE_HEIGHT, [255; 3]);
        canvas.text(2, 0, "Ag\u{1f681}", [0; 3]);
        let inked = |x: usize| (0..LINE_HEIGHT).any(|y| canvas.pixels()[y * 80 + x] != [255; 3]);
        assert!((2..2 + text_width("Ag?")).any(inked));
        assert!(!(2 + text_width("Ag?")..80).any(inked));
        // Beyond the picture nothing happens.
        canvas.text(75, 10, "long", [0; 3]);
    }

    #[test]
    fn a_long_text_keeps_both_ends() {
        assert_eq!(fitted("short", 1000), "short");
        let text = fitted("a-very-long-name-0042", text_width("0123456789"));
        assert_eq!(text, "a-ve..0042");
        assert_eq!(fitted("abc", ADVANCE), "a");
        assert_eq!(fitted("abc", 0), "");
    }
}
