//! The parts of net edges inside a row, eight at a time, and what they are in their first and last
//! column.

use pulp::Simd;

use super::super::outline::{self, NetEdge};
use super::cell::{LEFT_0, LEFT_1, LEVEL, Piece, RIGHT_0, RIGHT_1, TOP};
use super::lanes::{Lanes, WIDE};

/// Whole numbers are kept on top of this, so that they are in the low bits.
const WHOLE: f64 = 1.5 * (1_u64 << 52) as f64;

/// The parts of up to eight edges inside a row; `x` from the left of the canvas, `y` from the top
/// of the row, in pixels. Columns are counted on the canvas; one beyond it on either side stands
/// for all that is there.
#[derive(Debug, Clone, Default)]
pub(super) struct Group {
    pub(super) count: usize,
    pub(super) edge: [u32; WIDE],
    pub(super) step: [i32; WIDE],
    /// The edges.
    ax: Lanes,
    ay: Lanes,
    bx: Lanes,
    by: Lanes,
    slope: Lanes,
    steps: Lanes,
    /// Columns of the upper and of the lower end, and the step below the row; on [`WHOLE`].
    from: Lanes,
    to: Lanes,
    goes_on: Lanes,
    /// The upper end of the part.
    x0: Lanes,
    y0: Lanes,
    /// Height per column.
    rise: Lanes,
    /// What is in the first column, and in the last one.
    begin: Ends,
    end: Ends,
}

/// Pieces of a column, from its left side.
#[derive(Debug, Clone, Default)]
struct Ends {
    x0: Lanes,
    y0: Lanes,
    x1: Lanes,
    y1: Lanes,
    /// On [`WHOLE`].
    flags: Lanes,
}

#[inline(always)]
fn whole(lanes: &Lanes, l: usize) -> i32 {
    lanes[l % WIDE].to_bits() as i32
}

/// The column in which an edge comes through the upper side of a row, from column `first` of the
/// image on.
pub(super) fn column_at(edge: &NetEdge, top: f64, first: f64, columns: f64) -> i32 {
    let x = edge.x_at(top) - first;
    x.clamp(0.0, columns) as i32 - i32::from(x < 0.0)
}

impl Group {
    /// Take up to eight edges.
    #[inline(always)]
    pub(super) fn load(&mut self, edges: &[NetEdge], ids: &[u32]) {
        self.count = ids.len().min(WIDE);
        for l in 0..self.count {
            let e = &edges[ids[l] as usize];
            self.edge[l] = ids[l];
            self.step[l] = e.step;
            self.steps[l] = f64::from(e.step);
            (self.ax[l], self.ay[l], self.bx[l], self.by[l]) = (e.x0, e.y0, e.x1, e.y1);
            self.slope[l] = e.slope;
        }
    }

    /// Find their parts in the row below `top`, from column `first` of the image on.
    #[inline(always)]
    pub(super) fn cut<S: Simd>(&mut self, s: S, top: f64, first: f64, columns: f64) {
        for k in 0..WIDE / S::F64_LANES {
            self.cut_register(s, k, [top, top + 1.0, first, columns].map(|x| s.splat_f64s(x)));
        }
    }

    #[inline(always)]
    fn cut_register<S: Simd>(&mut self, s: S, k: usize, bounds: [S::f64s; 4]) {
        let [top, bottom, first, columns] = bounds;
        let load = |lanes: &Lanes| S::as_simd_f64s(lanes).0[k];
        let (zero, one, bias) = (s.splat_f64s(0.0), s.splat_f64s(1.0), s.splat_f64s(WHOLE));
        let within = |x, low, high| s.min_f64s(s.max_f64s(x, low), high);
        let (ax, ay, bx, by) = (load(&self.ax), load(&self.ay), load(&self.bx), load(&self.by));
        let (slope, step) = (load(&self.slope), load(&self.steps));
        let (left, right) = (s.min_f64s(ax, bx), s.max_f64s(ax, bx));
        let at = |y| within(s.add_f64s(ax, s.mul_f64s(s.sub_f64s(y, ay), slope)), left, right);
        let above = s.less_than_f64s(ay, top);
        let below = s.greater_than_or_equal_f64s(by, bottom);
        let x0 = s.sub_f64s(s.select_f64s(above, at(top), ax), first);
        let y0 = s.select_f64s(above, zero, s.sub_f64s(ay, top));
        let x1 = s.sub_f64s(s.select_f64s(below, at(bottom), bx), first);
        let y1 = s.select_f64s(below, one, s.sub_f64s(by, top));
        let column = |x| {
            let inside = within(x, zero, columns);
            let nearest = s.sub_f64s(s.add_f64s(inside, bias), bias);
            let above = s.or_m64s(s.greater_than_f64s(nearest, inside), s.less_than_f64s(x, zero));
            s.sub_f64s(nearest, s.select_f64s(above, one, zero))
        };
        let (from, to) = (column(x0), column(x1));
        let (stays, to_right) = (s.equal_f64s(from, to), s.less_than_f64s(from, to));
        let to_left = s.greater_than_f64s(from, to);
        let wide = s.select_f64s(stays, one, s.sub_f64s(x1, x0));
        let rise = s.div_f64s(s.sub_f64s(y1, y0), wide);
        // Where the first column ends, and where the last one begins.
        let end = s.add_f64s(from, s.select_f64s(to_right, one, zero));
        let begin = s.add_f64s(to, s.select_f64s(to_left, one, zero));
        let height = |x| s.add_f64s(y0, s.mul_f64s(s.sub_f64s(x, x0), rise));
        let leaves = within(height(end), y0, y1);
        let enters = within(height(begin), leaves, y1);
        let flag = |on, flag: u8| s.select_f64s(on, s.splat_f64s(f64::from(flag)), zero);
        let steep = s.mul_f64s(s.splat_f64s(outline::LEVEL), s.sub_f64s(right, left));
        let level = s.add_f64s(bias, flag(s.less_than_f64s(s.sub_f64s(by, ay), steep), LEVEL));
        let ways = s.add_f64s(flag(to_right, RIGHT_1), flag(to_left, LEFT_1));
        let first_flags = s.add_f64s(level, s.add_f64s(flag(above, TOP), ways));
        let ways = s.add_f64s(flag(to_right, LEFT_0), flag(to_left, RIGHT_0));
        let last_flags = s.add_f64s(level, ways);
        let side = s.select_f64s(to_right, one, zero);
        let x_begin = within(s.sub_f64s(x0, from), zero, one);
        let x_end = within(s.sub_f64s(x1, to), zero, one);
        let goes_on = s.select_f64s(below, step, zero);
        for (lanes, value) in [
            (&mut self.from, s.add_f64s(from, bias)),
            (&mut self.to, s.add_f64s(to, bias)),
            (&mut self.goes_on, s.add_f64s(goes_on, bias)),
            (&mut self.x0, x0),
            (&mut self.y0, y0),
            (&mut self.rise, rise),
            (&mut self.begin.x0, x_begin),
            (&mut self.begin.y0, y0),
            (&mut self.begin.x1, s.select_f64s(stays, x_end, side)),
            (&mut self.begin.y1, s.select_f64s(stays, y1, leaves)),
            (&mut self.begin.flags, first_flags),
            (&mut self.end.x0, s.sub_f64s(one, side)),
            (&mut self.end.y0, enters),
            (&mut self.end.x1, x_end),
            (&mut self.end.y1, y1),
            (&mut self.end.flags, last_flags),
        ] {
            S::as_mut_simd_f64s(lanes).0[k] = value;
        }
    }

    /// Columns of the upper and of the lower end.
    #[inline(always)]
    pub(super) fn columns(&self, l: usize) -> (i32, i32) {
        (whole(&self.from, l), whole(&self.to, l))
    }

    /// The step below the row.
    #[inline(always)]
    pub(super) fn step_below(&self, l: usize) -> i32 {
        whole(&self.goes_on, l)
    }

    #[inline(always)]
    fn piece(&self, ends: &Ends, l: usize) -> Piece {
        let l = l % WIDE;
        Piece {
            x0: ends.x0[l],
            y0: ends.y0[l],
            x1: ends.x1[l],
            y1: ends.y1[l],
            step: self.step[l],
            edge: self.edge[l],
            flags: whole(&ends.flags, l) as u8,
        }
    }

    /// What is in the first column.
    #[inline(always)]
    pub(super) fn begin(&self, l: usize) -> Piece {
        self.piece(&self.begin, l)
    }

    /// What is in the last column, of those in more than one.
    #[inline(always)]
    pub(super) fn end(&self, l: usize) -> Piece {
        self.piece(&self.end, l)
    }

    /// What is in a column between, from the height `y0` on.
    pub(super) fn middle(&self, l: usize, column: i32, y0: f64) -> Piece {
        let (from, to) = self.columns(l);
        let right = from < to;
        let beyond = f64::from(column + i32::from(right)) - self.x0[l];
        let y1 = (self.y0[l] + beyond * self.rise[l]).max(y0).min(self.end.y0[l]);
        let (x0, x1, way) =
            if right { (0.0, 1.0, LEFT_0 | RIGHT_1) } else { (1.0, 0.0, RIGHT_0 | LEFT_1) };
        let flags = whole(&self.end.flags, l) as u8 & LEVEL | way;
        Piece { x0, y0, x1, y1, step: self.step[l], edge: self.edge[l], flags }
    }
}
