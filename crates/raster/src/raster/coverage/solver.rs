//! Hands rectangles to the lanes by their number of pieces, halves those with many, cuts those in
//! which pieces cross into bands, and has the few with slivers solved one by one.

use super::cell::{Cell, Half, LEFT_0, Piece, Rectangle, Stretch, split};
use super::lanes::{Lanes, Solved};

/// A rectangle smaller than this, in pixels, is not split further.
const SMALL: f64 = 1e-6;

/// Takes results. A pixel that was split comes in parts.
pub(super) trait Sink {
    /// Covered area of (a part of) the pixel `tag`.
    fn area(&mut self, tag: u32, area: f64);
    /// Of the outline in the pixel, `edge` is visible over the height `height` (positive if the
    /// uncovered side is the right one); `moment` is its first moment.
    fn edge(&mut self, tag: u32, edge: u32, height: f64, moment: f64);
}

/// Rectangles waiting for a lane.
#[derive(Debug, Default)]
pub(super) struct Solver {
    two: Queue<2, 4>,
    three: Queue<3, 6>,
    four: Queue<4, 8>,
    six: Queue<6, 12>,
    plain: Plain,
    /// Buffers for halves.
    spare: Vec<Vec<Piece>>,
}

/// Rectangles with at most `K` pieces.
#[derive(Debug, Default)]
struct Queue<const K: usize, const M: usize> {
    first: Lanes<K, M>,
    /// Parts of those in which pieces cross.
    bands: Lanes<K, M>,
    solved: Solved<K>,
    solved_bands: Solved<K>,
}

/// For the rectangles that are not simple.
#[derive(Debug, Default)]
struct Plain {
    cell: Cell,
    stretches: Vec<Stretch>,
    heights: Vec<f64>,
}

impl Solver {
    /// Solve a rectangle, now or [later](Self::finish). `layers` is the number of layers just
    /// outside its upper left corner.
    pub(super) fn add<const OUTLINE: bool>(
        &mut self,
        rectangle: Rectangle,
        pieces: &[Piece],
        layers: i32,
        tag: u32,
        sink: &mut impl Sink,
    ) {
        let plain = &mut self.plain;
        match pieces.len() {
            0 => {
                if layers > 0 {
                    sink.area(tag, rectangle.area());
                }
            }
            1..=2 => {
                put::<2, 4, OUTLINE>(&mut self.two, plain, rectangle, pieces, layers, tag, sink);
            }
            3 => put::<3, 6, OUTLINE>(&mut self.three, plain, rectangle, pieces, layers, tag, sink),
            4 => put::<4, 8, OUTLINE>(&mut self.four, plain, rectangle, pieces, layers, tag, sink),
            5..=6 => {
                put::<6, 12, OUTLINE>(&mut self.six, plain, rectangle, pieces, layers, tag, sink);
            }
            _ => self.halve::<OUTLINE>(rectangle, pieces, layers, tag, sink),
        }
    }

    /// Solve what is waiting.
    pub(super) fn finish<const OUTLINE: bool>(&mut self, sink: &mut impl Sink) {
        end::<2, 4, OUTLINE>(&mut self.two, &mut self.plain, sink);
        end::<3, 6, OUTLINE>(&mut self.three, &mut self.plain, sink);
        end::<4, 8, OUTLINE>(&mut self.four, &mut self.plain, sink);
        end::<6, 12, OUTLINE>(&mut self.six, &mut self.plain, sink);
    }

    #[inline(never)]
    fn halve<const OUTLINE: bool>(
        &mut self,
        rectangle: Rectangle,
        pieces: &[Piece],
        layers: i32,
        tag: u32,
        sink: &mut impl Sink,
    ) {
        // What the pieces can take away from the layers at the corner (see `rows::Entered`).
        let taken =
            |p: &Piece| if p.flags & LEFT_0 != 0 { p.step.max(0) } else { (-p.step).max(0) };
        let covered = layers > pieces.iter().map(taken).sum();
        if covered || rectangle.right - rectangle.left < SMALL {
            if layers > 0 {
                sink.area(tag, rectangle.area());
            }
            return;
        }
        let spare = std::array::from_fn(|_| self.spare.pop().unwrap_or_default());
        for Half { rectangle, pieces, layers } in split(rectangle, pieces, layers, spare) {
            self.add::<OUTLINE>(rectangle, &pieces, layers, tag, sink);
            self.spare.push(pieces);
        }
    }
}

#[inline(always)]
fn put<const K: usize, const M: usize, const OUTLINE: bool>(
    lanes: &mut Queue<K, M>,
    plain: &mut Plain,
    rectangle: Rectangle,
    pieces: &[Piece],
    layers: i32,
    tag: u32,
    sink: &mut impl Sink,
) {
    if lanes.first.push(rectangle, pieces, layers, tag) {
        run::<K, M, OUTLINE>(lanes, plain, sink);
    }
}

/// Solve what is waiting for its first round; where pieces cross, in bands between the crossings.
#[inline(never)]
fn run<const K: usize, const M: usize, const OUTLINE: bool>(
    lanes: &mut Queue<K, M>,
    plain: &mut Plain,
    sink: &mut impl Sink,
) {
    let Queue { first, bands, solved, solved_bands } = lanes;
    if first.count == 0 {
        return;
    }
    first.solve::<OUTLINE>(solved);
    for l in 0..std::mem::take(&mut first.count) {
        if solved.crossing[l] >= 0.0 || solved.sliver[l] < 0.0 {
            take::<K, M, OUTLINE>(first, solved, l, plain, sink);
            continue;
        }
        let pieces = &first.pieces[l][..first.lengths[l]];
        let rectangle = first.rectangles[l];
        plain.cross(rectangle, pieces);
        let mut top = rectangle.top;
        for k in 0..plain.heights.len() {
            let bottom = plain.heights[k];
            if bottom > top {
                let band = Rectangle { top, bottom, ..rectangle };
                if bands.push(band, pieces, first.layers[l], first.tags[l]) {
                    finish::<K, M, OUTLINE>(bands, solved_bands, plain, sink);
                }
                top = bottom;
            }
        }
    }
}

/// Solve all that is waiting.
fn end<const K: usize, const M: usize, const OUTLINE: bool>(
    lanes: &mut Queue<K, M>,
    plain: &mut Plain,
    sink: &mut impl Sink,
) {
    run::<K, M, OUTLINE>(lanes, plain, sink);
    finish::<K, M, OUTLINE>(&mut lanes.bands, &mut lanes.solved_bands, plain, sink);
}

/// Solve the bands that are waiting.
fn finish<const K: usize, const M: usize, const OUTLINE: bool>(
    bands: &mut Lanes<K, M>,
    solved: &mut Solved<K>,
    plain: &mut Plain,
    sink: &mut impl Sink,
) {
    if bands.count > 0 {
        bands.solve::<OUTLINE>(solved);
        for l in 0..std::mem::take(&mut bands.count) {
            take::<K, M, OUTLINE>(bands, solved, l, plain, sink);
        }
    }
}

/// Hand on the result of a lane.
#[inline(always)]
fn take<const K: usize, const M: usize, const OUTLINE: bool>(
    lanes: &Lanes<K, M>,
    solved: &Solved<K>,
    l: usize,
    plain: &mut Plain,
    sink: &mut impl Sink,
) {
    let (pieces, tag) = (&lanes.pieces[l][..lanes.lengths[l]], lanes.tags[l]);
    if solved.sliver[l] < 0.0 {
        plain.solve(lanes.rectangles[l], pieces, lanes.layers[l], tag, sink);
        return;
    }
    sink.area(tag, solved.area[l]);
    if OUTLINE {
        for (k, piece) in pieces.iter().enumerate() {
            let (height, moment) = (solved.height[k][l], solved.moment[k][l]);
            if height != 0.0 || moment != 0.0 {
                sink.edge(tag, piece.edge, height, moment);
            }
        }
    }
}

impl Plain {
    /// The heights at which pieces cross inside the rectangle, in order, and its lower side.
    fn cross(&mut self, rectangle: Rectangle, pieces: &[Piece]) {
        self.heights.clear();
        for (i, a) in pieces.iter().enumerate() {
            let (left, right) = if a.x0 < a.x1 { (a.x0, a.x1) } else { (a.x1, a.x0) };
            let a_slope = (a.x1 - a.x0) / (a.y1 - a.y0);
            for b in &pieces[i + 1..] {
                let (high, low) = (a.y0.max(b.y0), a.y1.min(b.y1));
                let beside = (b.x0 < left && b.x1 < left) || (b.x0 > right && b.x1 > right);
                if high >= low || beside {
                    continue;
                }
                let b_slope = (b.x1 - b.x0) / (b.y1 - b.y0);
                let apart = |y: f64| (a.x0 + (y - a.y0) * a_slope) - (b.x0 + (y - b.y0) * b_slope);
                let (at_top, at_bottom) = (apart(high), apart(low));
                if at_top * at_bottom < 0.0 {
                    let y = high + (low - high) * (at_top / (at_top - at_bottom));
                    if rectangle.top < y && y < rectangle.bottom {
                        self.heights.push(y);
                    }
                }
            }
        }
        self.heights.push(rectangle.bottom);
        self.heights.sort_unstable_by(f64::total_cmp);
    }

    /// Slivers are looked for only where the outline is asked for.
    fn solve(
        &mut self,
        rectangle: Rectangle,
        pieces: &[Piece],
        layers: i32,
        tag: u32,
        sink: &mut impl Sink,
    ) {
        self.stretches.clear();
        let area = self.cell.solve(rectangle, pieces, layers, &mut self.stretches);
        sink.area(tag, area);
        for s in &self.stretches {
            let height = if s.ahead { s.to - s.from } else { s.from - s.to };
            sink.edge(tag, s.edge, height, height * 0.5 * (s.from + s.to));
        }
    }
}
