//! The edges that can bound the union of the projected triangles, with what is on their two sides.
//!
//! Turn every projected triangle the same way round; its three directed edges then have one layer
//! more on their inner side than on their outer one. Added up over all triangles, edges inside a
//! surface cancel, and what is left, the *net edges*, are closed curves whose winding number at a
//! point is the number of triangles that cover it. The union is where that number is above zero.
//! Nothing is said about the order of the faces, their winding, duplicates, open borders or edges
//! with more than two faces: they all are sums.

use multiversion::multiversion;

use super::{Model, Screen, Topology};

/// A net edge from its upper end to its lower one; a horizontal edge from left to right.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct NetEdge {
    /// Upper end, in pixels.
    pub(super) x0: f64,
    pub(super) y0: f64,
    /// Lower end.
    pub(super) x1: f64,
    pub(super) y1: f64,
    /// `dx / dy`; 0 for a horizontal edge.
    pub(super) slope: f64,
    /// Image points at the two ends.
    pub(super) from: u32,
    pub(super) to: u32,
    /// Layers on the right of the edge minus layers on its left; for a horizontal edge, above
    /// minus below. Never 0.
    pub(super) step: i32,
}

/// The slope of edges whose height tells badly where on it a point is.
pub(super) const LEVEL: f64 = 1e-4;

impl NetEdge {
    /// Whether the height of the edge tells well where on it a point is: lost are at most four of
    /// sixteen digits.
    #[inline(always)]
    pub(super) fn is_steep(&self) -> bool {
        self.y1 - self.y0 >= LEVEL * (self.x1 - self.x0).abs()
    }

    /// Where the edge is at height `y`, between its ends.
    #[inline(always)]
    pub(super) fn x_at(&self, y: f64) -> f64 {
        let x = self.x0 + (y - self.y0) * self.slope;
        let (low, high) = if self.x0 < self.x1 { (self.x0, self.x1) } else { (self.x1, self.x0) };
        let x = if x < low { low } else { x };
        if x > high { high } else { x }
    }
}

/// Faces that are projected.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Faces {
    All,
    /// Those with [`Screen::is_front`].
    Front,
}

/// Rows that the edges reach, and the leftmost and rightmost column.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Extent {
    pub(super) rows: (usize, usize),
    pub(super) columns: (usize, usize),
}

impl Extent {
    /// In rows.
    pub(super) fn height(&self) -> usize {
        self.rows.1 - self.rows.0
    }
}

/// The net edges of a screen.
#[derive(Debug, Default)]
pub(super) struct Outline {
    pub(super) edges: Vec<NetEdge>,
    /// Whether an edge was left out because it lies to the right of the canvas.
    pub(super) beyond: bool,
    /// See [`Planes::signs`](super::planes::Planes::signs).
    signs: Vec<u8>,
    /// Layers that each face adds on the inner side of an edge, for each coded face of
    /// [`Edge`](super::Edge): as it runs on the screen, and reversed; +1, -1, or 0 without area.
    /// Zeros follow for a missing face.
    sides: Vec<[i8; 2]>,
    /// See [`Planes::leanings`](super::planes::Planes::leanings).
    leanings: Vec<u8>,
    /// Net edges by number, and their layers; what follows them is of no account.
    chosen: Vec<(u32, i32)>,
    /// Of the faces cut at the near plane, if any were.
    clipped: Option<Topology>,
}

impl Outline {
    /// Find the net edges, moved by `(shift, shift)` pixels. Those that lie above, below or to
    /// the right of the canvas of `height` x `width` pixels are left out.
    pub(super) fn find(
        &mut self,
        model: &Model,
        screen: &Screen,
        shift: f64,
        height: f64,
        width: f64,
    ) {
        let mut edges = std::mem::take(&mut self.edges);
        edges.clear();
        let beyond =
            keep(&self.choose(model, screen, shift, Faces::All), [height, width], &mut edges);
        (self.edges, self.beyond) = (edges, beyond);
    }

    /// Find which edges are net edges of such faces, moved as by [`find`](Self::find).
    pub(super) fn choose<'a>(
        &'a mut self,
        model: &'a Model,
        screen: &'a Screen,
        shift: f64,
        faces: Faces,
    ) -> Net<'a> {
        self.clipped = screen.is_clipped().then(|| {
            let keys: Vec<[u64; 2]> = (screen.u.iter().zip(&screen.v))
                .map(|(&u, &v)| [(u + 0.0).to_bits(), (v + 0.0).to_bits()])
                .collect();
            Topology::new(&keys, screen.faces(model))
        });
        let topology = self.clipped.as_ref().unwrap_or(model.topology());
        let Self { signs, sides, .. } = self;
        if let Some(facing) = screen.facing() {
            model.planes().signs(facing, shift, signs);
        } else {
            signs.clear();
            signs.resize(topology.faces.len(), 0);
        }
        if faces == Faces::Front {
            hide_others(model, screen, &mut self.leanings, signs);
        }
        sides.clear();
        sides.extend(signs.iter().map(|&sign| {
            let sign = if sign == HIDDEN { 0 } else { sign.cast_signed() };
            [sign, sign.wrapping_neg()]
        }));
        for face in memchr::memchr_iter(0, signs) {
            let sign = turn(screen, shift, topology.faces[face]);
            sides[face] = [sign, -sign];
        }
        sides.push([0, 0]);
        let count = select(topology, sides.as_flattened(), &mut self.chosen);
        Net { topology, screen, shift, chosen: &self.chosen[..count] }
    }

    /// The part of a canvas that the union can reach, half open; `None` if none.
    pub(super) fn extent(&self, height: usize, width: usize) -> Option<Extent> {
        let (mut top, mut bottom) = (f64::INFINITY, f64::NEG_INFINITY);
        let (mut left, mut right) = (f64::INFINITY, f64::NEG_INFINITY);
        for e in &self.edges {
            top = if e.y0 < top { e.y0 } else { top };
            bottom = if e.y1 > bottom { e.y1 } else { bottom };
            let (low, high) = if e.x0 < e.x1 { (e.x0, e.x1) } else { (e.x1, e.x0) };
            left = if low < left { low } else { left };
            right = if high > right { high } else { right };
        }
        // Edges to the right of the canvas are not in the list, but bound what is on it.
        right = if self.beyond { width as f64 } else { right };
        let end = |x: f64, n: usize| (x.max(0.0).min(n as f64 - 1.0)) as usize + 1;
        let begin = |x: f64, n: usize| (x.max(0.0).min(n as f64 - 1.0)) as usize;
        (top < height as f64 && bottom >= 0.0).then(|| Extent {
            rows: (begin(top, height), end(bottom, height)),
            columns: (begin(left, width), end(right, width)),
        })
    }

    /// See [`Topology::share`]. With a cut at the near plane positions are those in the image.
    pub(super) fn share(&self, model: &Model, gradient: &mut [f64]) {
        self.clipped.as_ref().unwrap_or(model.topology()).share(gradient);
    }
}

/// The net edges, one by one.
#[derive(Debug, Clone, Copy)]
pub(super) struct Net<'a> {
    topology: &'a Topology,
    screen: &'a Screen,
    shift: f64,
    chosen: &'a [(u32, i32)],
}

impl Net<'_> {
    pub(super) fn count(&self) -> usize {
        self.chosen.len()
    }

    /// Both ends, in any order.
    #[inline(always)]
    pub(super) fn ends(&self, k: usize) -> [(f64, f64); 2] {
        let edge = &self.topology.edges[self.chosen[k].0 as usize];
        let column = |k: u32| self.screen.u[k as usize] + self.shift;
        let (ya, yb) = (self.height(edge.a), self.height(edge.b));
        [(column(edge.a), ya), (column(edge.b), yb)]
    }

    #[inline(always)]
    pub(super) fn edge(&self, k: usize) -> NetEdge {
        let (id, net) = self.chosen[k];
        let edge = &self.topology.edges[id as usize];
        let column = |k: u32| self.screen.u[k as usize] + self.shift;
        let (ya, yb) = (self.height(edge.a), self.height(edge.b));
        // Looked up rather than branched on: nothing foretells which way an edge runs.
        let up = (yb < ya) | ((ya == yb) & (column(edge.a) >= column(edge.b)));
        let [from, to] = [[edge.a, edge.b], [edge.b, edge.a]][usize::from(up)];
        let (x0, y0, x1, y1) = (column(from), self.height(from), column(to), self.height(to));
        let slope = if y1 > y0 { (x1 - x0) / (y1 - y0) } else { 0.0 };
        NetEdge { x0, y0, x1, y1, slope, from, to, step: if up { net } else { -net } }
    }

    #[inline(always)]
    fn height(&self, point: u32) -> f64 {
        self.screen.v[point as usize] + self.shift
    }
}

/// List the edges that [`Outline::find`] does not leave out; whether one is to the right of the
/// canvas.
#[multiversion(targets("x86_64+avx2+bmi1+bmi2"))]
fn keep(net: &Net<'_>, [height, width]: [f64; 2], edges: &mut Vec<NetEdge>) -> bool {
    let mut beyond = false;
    for k in 0..net.count() {
        let e = net.edge(k);
        let right = if e.x0 < e.x1 { e.x0 } else { e.x1 };
        if e.y1 < 0.0 || e.y0 >= height || (e.x0 == e.x1 && e.y0 == e.y1) {
            continue;
        }
        if right >= width {
            beyond = true;
            continue;
        }
        edges.push(e);
    }
    beyond
}

/// The sign of a face that has no layer.
const HIDDEN: u8 = 2;

/// Hide the faces that are not [in front](Screen::is_front).
fn hide_others(model: &Model, screen: &Screen, leanings: &mut Vec<u8>, signs: &mut [u8]) {
    if let Some(facing) = screen.facing() {
        model.planes().leanings(facing, leanings);
    } else {
        leanings.clear();
        leanings.resize(signs.len(), 0);
    }
    for (sign, leaning) in signs.iter_mut().zip(&*leanings) {
        *sign = if *leaning == 1 { HIDDEN } else { *sign };
    }
    let faces = screen.faces(model);
    for face in memchr::memchr_iter(0, leanings) {
        if !screen.is_front(faces[face]) {
            signs[face] = HIDDEN;
        }
    }
}

/// Which way round a face runs on the screen: 1, -1, or 0 without area.
fn turn(screen: &Screen, shift: f64, face: [u32; 3]) -> i8 {
    let [a, b, c] = face.map(|k| [screen.u[k as usize] + shift, screen.v[k as usize] + shift]);
    let area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
    i8::from(area > 0.0) - i8::from(area < 0.0)
}

/// Edges whose faces do not cancel, with the layers on their inner side, at the front of `chosen`;
/// how many.
#[multiversion(targets("x86_64+avx2+bmi1+bmi2"))]
fn select(topology: &Topology, sides: &[i8], chosen: &mut Vec<(u32, i32)>) -> usize {
    let side = |code: u32| i32::from(sides[code as usize]);
    if chosen.len() < topology.edges.len() {
        chosen.resize(topology.edges.len(), (0, 0));
    }
    let mut count = 0;
    if topology.more.is_empty() {
        for (id, edge) in topology.edges.iter().enumerate() {
            let net = side(edge.faces[0]) + side(edge.faces[1]);
            chosen[count] = (id as u32, net);
            count += usize::from(net != 0);
        }
        return count;
    }
    let mut more = topology.more.iter().peekable();
    for (id, edge) in topology.edges.iter().enumerate() {
        let mut net = side(edge.faces[0]) + side(edge.faces[1]);
        while let Some(&(_, code)) = more.next_if(|m| m.0 as usize == id) {
            net += side(code);
        }
        chosen[count] = (id as u32, net);
        count += usize::from(net != 0);
    }
    count
}
