//! Pictures with labels in rows and columns.

use super::{Canvas, INK, LINE_HEIGHT, PAPER, Rgb, SOFT, fitted};

/// One picture of a sheet.
#[derive(Debug, Clone)]
pub struct Cell {
    /// The picture; empty ones leave a gap.
    pub picture: Canvas,
    /// Above it.
    pub title: String,
    /// Below it, a line each.
    pub captions: Vec<String>,
}

const MARGIN: usize = 12;
const GAP: usize = 10;
/// Between a picture and its texts.
const LEAD: usize = 3;

/// A sheet of cells, `columns` in a row, under a heading. Columns are as wide and rows as high as
/// their largest picture; texts are shortened to the width of the column.
#[must_use]
pub fn sheet(heading: &str, cells: &[Cell], columns: usize) -> Canvas {
    let columns = columns.clamp(1, cells.len().max(1));
    let rows: Vec<&[Cell]> = cells.chunks(columns).collect();
    let widths: Vec<usize> = (0..columns)
        .map(|c| rows.iter().filter_map(|r| r.get(c)).map(|x| x.picture.width()).max())
        .map(|w| w.unwrap_or(0))
        .collect();
    let above = |row: &[Cell]| line_height(row.iter().any(|c| !c.title.is_empty()).into());
    let below = |row: &[Cell]| line_height(row.iter().map(|c| c.captions.len()).max().unwrap_or(0));
    let high = |row: &[Cell]| row.iter().map(|c| c.picture.height()).max().unwrap_or(0);
    let head = if heading.is_empty() { 0 } else { LINE_HEIGHT + GAP };
    let heights = rows.iter().map(|r| above(r) + high(r) + below(r)).sum::<usize>();
    let width = 2 * MARGIN + widths.iter().sum::<usize>() + GAP * (columns - 1);
    let height = 2 * MARGIN + head + heights + GAP * rows.len().saturating_sub(1);
    let mut canvas = Canvas::new(width, height, PAPER);
    canvas.text(MARGIN, MARGIN, &fitted(heading, width - 2 * MARGIN), INK);
    let mut y = MARGIN + head;
    for row in rows {
        let mut x = MARGIN;
        let picture = y + above(row);
        for (cell, &room) in row.iter().zip(&widths) {
            let line = |canvas: &mut Canvas, y: usize, text: &str, color: Rgb| {
                canvas.text(x, y, &fitted(text, room), color);
            };
            line(&mut canvas, y, &cell.title, INK);
            canvas.paste(&cell.picture, x, picture);
            for (k, caption) in cell.captions.iter().enumerate() {
                let under = picture + cell.picture.height() + LEAD + k * LINE_HEIGHT;
                line(&mut canvas, under, caption, SOFT);
            }
            x += room + GAP;
        }
        y = picture + high(row) + below(row) + GAP;
    }
    canvas
}

fn line_height(lines: usize) -> usize {
    if lines == 0 { 0 } else { lines * LINE_HEIGHT + LEAD }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sheet_holds_all_its_pictures() {
        let cell = |w, h, captions: usize| Cell {
            picture: Canvas::new(w, h, [9, 9, 9]),
            title: "a".to_owned(),
            captions: vec!["caption".to_owned(); captions],
        };
        let cells = [cell(30, 20, 0), cell(10, 40, 2), cell(5, 5, 1)];
        let canvas = sheet("all", &cells, 2);
        let area = canvas.pixels().iter().filter(|p| **p == [9, 9, 9]).count();
        assert_eq!(area, 30 * 20 + 10 * 40 + 5 * 5);
        assert_eq!(canvas.width(), 2 * MARGIN + 30 + 10 + GAP);
        let empty = sheet("", &[], 3);
        assert_eq!((empty.width(), empty.height()), (2 * MARGIN, 2 * MARGIN));
    }
}
