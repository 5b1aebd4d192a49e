//! The union of layers inside one rectangle: its area, and where its outline runs.
//!
//! The rectangle is cut into horizontal slabs at every end of a piece and at every crossing. In a
//! slab the pieces that run through it are ordered from left to right, and the number of layers
//! follows by adding up their steps. Whatever rounding does to the order of pieces that nearly
//! coincide, the steps add up to the same number at the right-hand side: an error stays as small
//! as the distance between them.

/// A part of a net edge inside a rectangle, from its upper end to its lower one.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Piece {
    pub(super) x0: f64,
    pub(super) y0: f64,
    pub(super) x1: f64,
    pub(super) y1: f64,
    /// Layers on the right minus layers on the left (above minus below, if horizontal).
    pub(super) step: i32,
    /// The edge.
    pub(super) edge: u32,
    /// Where the piece goes on outside the rectangle: [`TOP`], [`LEFT_0`] and its like.
    pub(super) flags: u8,
}

/// The upper end is on the top side, and the edge comes from above.
pub(super) const TOP: u8 = 1;
/// The upper end is on the left side, and the edge comes from there.
pub(super) const LEFT_0: u8 = 2;
/// The lower end is on the left side, and the edge goes on there.
pub(super) const LEFT_1: u8 = 4;
/// The upper end is on the right side, and the edge comes from there.
pub(super) const RIGHT_0: u8 = 8;
/// The lower end is on the right side, and the edge goes on there.
pub(super) const RIGHT_1: u8 = 16;
/// The edge is so level that its height does not tell where on it a point is.
pub(super) const LEVEL: u8 = 32;

/// Two outlines closer than this, in pixels, with nothing but a sliver between them are none.
pub(super) const SLIVER: f64 = 1e-9;

/// Left, right, top and bottom.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Rectangle {
    pub(super) left: f64,
    pub(super) right: f64,
    pub(super) top: f64,
    pub(super) bottom: f64,
}

impl Rectangle {
    /// In square pixels.
    pub(super) fn area(&self) -> f64 {
        (self.right - self.left) * (self.bottom - self.top)
    }
}

/// A stretch of outline: `edge`, from `from` to `to` along the axis of the sweep; `ahead` if the
/// uncovered side is the right one (below, in a sweep to the right).
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Stretch {
    pub(super) edge: u32,
    pub(super) from: f64,
    pub(super) to: f64,
    pub(super) ahead: bool,
}

/// Buffers of a solver.
#[derive(Debug, Default)]
pub(super) struct Cell {
    heights: Vec<f64>,
    active: Vec<Active>,
    crossings: Vec<f64>,
    visible: Vec<(u32, bool, f64)>,
}

/// A piece in a slab: where it is at the top and at the bottom of it.
#[derive(Debug, Clone, Copy)]
struct Active {
    top: f64,
    bottom: f64,
    step: i32,
    piece: u32,
}

impl Cell {
    /// Area of the points of the rectangle with at least one layer; which stretches of which edges
    /// bound them is added to `outline`. `layers` is their number just outside the upper left
    /// corner.
    pub(super) fn solve(
        &mut self,
        Rectangle { left, right, top, bottom }: Rectangle,
        pieces: &[Piece],
        layers: i32,
        outline: &mut Vec<Stretch>,
    ) -> f64 {
        self.heights.clear();
        self.heights.push(top);
        for p in pieces {
            self.heights.push(p.y0.clamp(top, bottom));
            self.heights.push(p.y1.clamp(top, bottom));
        }
        self.heights.push(bottom);
        sort(&mut self.heights, |a, b| a < b);
        let mut area = 0.0;
        for k in 1..self.heights.len() {
            let (high, low) = (self.heights[k - 1], self.heights[k]);
            let height = low - high;
            if height <= 0.0 {
                continue;
            }
            let mut at_left = layers;
            self.active.clear();
            for (id, p) in pieces.iter().enumerate() {
                // A piece through the left side: above it is its right (left) hand side.
                if p.flags & LEFT_0 != 0 && p.y0 <= high {
                    at_left -= p.step;
                }
                if p.flags & LEFT_1 != 0 && p.y1 <= high {
                    at_left += p.step;
                }
                if p.y0 <= high && p.y1 >= low {
                    let slope = (p.x1 - p.x0) / (p.y1 - p.y0);
                    let x = |y: f64| if y == p.y1 { p.x1 } else { p.x0 + (y - p.y0) * slope };
                    self.active.push(Active {
                        top: x(high),
                        bottom: x(low),
                        step: p.step,
                        piece: id as u32,
                    });
                }
            }
            sort(&mut self.active, |a, b| a.top + a.bottom < b.top + b.bottom);
            let crossed =
                self.active.windows(2).any(|w| w[0].top > w[1].top || w[0].bottom > w[1].bottom);
            if !crossed {
                let covered = self.walk(left, right, at_left, |a| 0.5 * (a.top + a.bottom));
                area += covered * height;
                self.emit(pieces, high, low, outline);
                continue;
            }
            self.crossings.clear();
            for (i, a) in self.active.iter().enumerate() {
                for b in &self.active[i + 1..] {
                    let (at_top, at_bottom) = (a.top - b.top, a.bottom - b.bottom);
                    if (at_top > 0.0) != (at_bottom > 0.0) && at_top != at_bottom {
                        self.crossings.push(at_top / (at_top - at_bottom));
                    }
                }
            }
            self.crossings.push(1.0);
            sort(&mut self.crossings, |a, b| a < b);
            let mut from = 0.0;
            for k in 0..self.crossings.len() {
                let to = self.crossings[k];
                if to <= from {
                    continue;
                }
                let middle = 0.5 * (from + to);
                let x = |a: &Active| a.top + middle * (a.bottom - a.top);
                sort(&mut self.active, |a, b| x(a) < x(b));
                let covered = self.walk(left, right, at_left, x);
                area += covered * (to - from) * height;
                self.emit(pieces, high + from * height, high + to * height, outline);
                from = to;
            }
        }
        area
    }

    /// Covered length of a slab, from left to right; remembers the visible pieces.
    #[inline(always)]
    fn walk(&mut self, left: f64, right: f64, at_left: i32, place: impl Fn(&Active) -> f64) -> f64 {
        let (mut layers, mut covered, mut since) = (at_left, 0.0, left);
        self.visible.clear();
        for a in &self.active {
            let next = layers + a.step;
            if (layers > 0) != (next > 0) {
                let x = place(a);
                if layers > 0 {
                    covered += x - since;
                } else {
                    since = x;
                }
                match self.visible.last() {
                    Some(last) if x - last.2 < SLIVER => {
                        self.visible.pop();
                    }
                    _ => self.visible.push((a.piece, layers > 0, x)),
                }
            }
            layers = next;
        }
        if layers > 0 {
            covered += right - since;
        }
        covered
    }

    #[inline(always)]
    fn emit(&self, pieces: &[Piece], from: f64, to: f64, outline: &mut Vec<Stretch>) {
        for &(piece, ahead, _) in &self.visible {
            let edge = pieces[piece as usize].edge;
            outline.push(Stretch { edge, from, to, ahead });
        }
    }
}

/// A part of a rectangle: what is in it, and the layers at its upper left corner.
#[derive(Debug, Default)]
pub(super) struct Half {
    pub(super) rectangle: Rectangle,
    pub(super) pieces: Vec<Piece>,
    pub(super) layers: i32,
}

/// Halve the longer side; the vectors are used again.
pub(super) fn split(
    rectangle: Rectangle,
    pieces: &[Piece],
    layers: i32,
    [mut first, mut second]: [Vec<Piece>; 2],
) -> [Half; 2] {
    first.clear();
    second.clear();
    let Rectangle { left, right, top, bottom } = rectangle;
    let mut beyond = layers;
    let (one, two);
    if bottom - top >= right - left {
        let y = 0.5 * (top + bottom);
        one = Rectangle { bottom: y, ..rectangle };
        two = Rectangle { top: y, ..rectangle };
        for p in pieces {
            if p.flags & LEFT_0 != 0 && p.y0 < y {
                beyond -= p.step;
            }
            if p.flags & LEFT_1 != 0 && p.y1 < y {
                beyond += p.step;
            }
            if p.y1 < y {
                first.push(*p);
            } else if p.y0 >= y {
                second.push(*p);
            } else {
                let x = between(p.x0, p.x1, (y - p.y0) / (p.y1 - p.y0));
                first.push(Piece { x1: x, y1: y, flags: p.flags & !(LEFT_1 | RIGHT_1), ..*p });
                let flags = (p.flags & (LEFT_1 | RIGHT_1)) | TOP;
                second.push(Piece { x0: x, y0: y, flags, ..*p });
            }
        }
    } else {
        let x = 0.5 * (left + right);
        one = Rectangle { right: x, ..rectangle };
        two = Rectangle { left: x, ..rectangle };
        for p in pieces {
            if p.flags & TOP != 0 && p.x0 < x {
                beyond += p.step;
            }
            let (a, b) = (p.x0 < x, p.x1 < x);
            if a && b {
                first.push(*p);
            } else if !a && !b {
                second.push(*p);
            } else {
                let y = between(p.y0, p.y1, (x - p.x0) / (p.x1 - p.x0));
                let upper = p.flags & !(LEFT_1 | RIGHT_1);
                let lower = p.flags & (LEFT_1 | RIGHT_1);
                if a {
                    first.push(Piece { x1: x, y1: y, flags: upper | RIGHT_1, ..*p });
                    second.push(Piece { x0: x, y0: y, flags: lower | LEFT_0, ..*p });
                } else {
                    second.push(Piece { x1: x, y1: y, flags: upper | LEFT_1, ..*p });
                    first.push(Piece { x0: x, y0: y, flags: lower | RIGHT_0, ..*p });
                }
            }
        }
    }
    [
        Half { rectangle: one, pieces: first, layers },
        Half { rectangle: two, pieces: second, layers: beyond },
    ]
}

/// The point at `part` of the way from `a` to `b`; never beyond them.
#[inline(always)]
fn between(a: f64, b: f64, part: f64) -> f64 {
    let (low, high) = if a < b { (a, b) } else { (b, a) };
    let x = a + part * (b - a);
    let x = if x < low { low } else { x };
    if x > high { high } else { x }
}

/// The pieces with rows and columns exchanged, for a sweep to the right.
pub(super) fn transposed(pieces: &[Piece], out: &mut Vec<Piece>) {
    out.clear();
    out.extend(pieces.iter().map(|p| {
        let right = p.x1 >= p.x0;
        let (first, second) =
            if right { ((p.y0, p.x0), (p.y1, p.x1)) } else { ((p.y1, p.x1), (p.y0, p.x0)) };
        let mut flags = 0;
        if p.flags & TOP != 0 {
            flags |= if right { LEFT_0 } else { LEFT_1 };
        }
        if p.flags & (LEFT_0 | LEFT_1) != 0 {
            flags |= TOP;
        }
        Piece {
            x0: first.0,
            y0: first.1,
            x1: second.0,
            y1: second.1,
            step: if right { -p.step } else { p.step },
            edge: p.edge,
            flags,
        }
    }));
}

/// Insertion sort: the lists are short, and often nearly in order.
#[inline(always)]
fn sort<T: Copy>(list: &mut [T], before: impl Fn(&T, &T) -> bool) {
    for i in 1..list.len() {
        let item = list[i];
        let mut k = i;
        while k > 0 && before(&item, &list[k - 1]) {
            list[k] = list[k - 1];
            k -= 1;
        }
        list[k] = item;
    }
}
