//! Exact nearest vertex from anywhere: a 16-ary tree of bounding boxes over the vertices in curve
//! order.

use super::squared_distance;

const WIDTH: usize = 16;

/// The bounding boxes of sixteen children, coordinate by coordinate; missing ones are infinitely
/// far away.
#[derive(Debug, Clone, Copy)]
#[repr(C, align(64))]
struct Boxes {
    low: [[f64; WIDTH]; 3],
    high: [[f64; WIDTH]; 3],
}

const NOWHERE: Boxes =
    Boxes { low: [[f64::INFINITY; WIDTH]; 3], high: [[f64::INFINITY; WIDTH]; 3] };

/// The tree; level 0 holds the boxes of groups of sixteen vertices.
#[derive(Debug)]
pub(crate) struct Tree {
    levels: Vec<Vec<Boxes>>,
}

impl Tree {
    pub(crate) fn new(points: &[[f64; 4]]) -> Self {
        let mut boxes: Vec<[[f64; 3]; 2]> = points
            .chunks(WIDTH)
            .map(|chunk| bound(chunk.iter().map(|p| [[p[0], p[1], p[2]]; 2])))
            .collect();
        let mut levels = Vec::new();
        loop {
            let level: Vec<Boxes> = boxes
                .chunks(WIDTH)
                .map(|chunk| {
                    let mut node = NOWHERE;
                    for (l, [low, high]) in chunk.iter().enumerate() {
                        for axis in 0..3 {
                            node.low[axis][l] = low[axis];
                            node.high[axis][l] = high[axis];
                        }
                    }
                    node
                })
                .collect();
            boxes = boxes.chunks(WIDTH).map(|chunk| bound(chunk.iter().copied())).collect();
            levels.push(level);
            if boxes.len() <= 1 {
                return Self { levels };
            }
        }
    }

    pub(crate) fn bytes(&self) -> usize {
        self.levels.iter().map(Vec::len).sum::<usize>() * size_of::<Boxes>()
    }

    /// The least squared distance from `q` to a vertex, given some vertex's (`best`).
    #[inline(always)]
    pub(crate) fn nearest(&self, points: &[[f64; 4]], q: [f64; 3], best: f64) -> f64 {
        let mut best = best;
        self.visit(points, q, self.levels.len() - 1, 0, &mut best);
        best
    }

    fn visit(&self, points: &[[f64; 4]], q: [f64; 3], level: usize, node: usize, best: &mut f64) {
        let mut near = gaps(&self.levels[level][node], q);
        loop {
            let (mut child, mut least) = (0, f64::INFINITY);
            for (l, &gap) in near.iter().enumerate() {
                if gap < least {
                    (child, least) = (l, gap);
                }
            }
            // A gap is rounded like a distance is, so a margin keeps ties and near ties.
            if least.is_infinite() || least * (1.0 - 1e-14) >= *best {
                return;
            }
            near[child] = f64::INFINITY;
            let below = node * WIDTH + child;
            if level == 0 {
                let end = points.len().min(below * WIDTH + WIDTH);
                for p in &points[below * WIDTH..end] {
                    let d = squared_distance(p, q);
                    *best = if d < *best { d } else { *best };
                }
            } else {
                self.visit(points, q, level - 1, below, best);
            }
        }
    }
}

/// Squared distance from `q` to each box.
#[inline(always)]
fn gaps(boxes: &Boxes, q: [f64; 3]) -> [f64; WIDTH] {
    let mut sum = [0.0; WIDTH];
    for axis in 0..3 {
        let (low, high, c) = (&boxes.low[axis], &boxes.high[axis], q[axis]);
        for l in 0..WIDTH {
            let (under, over) = (low[l] - c, c - high[l]);
            let gap = if under > over { under } else { over };
            let gap = if gap > 0.0 { gap } else { 0.0 };
            sum[l] += gap * gap;
        }
    }
    sum
}

fn bound(boxes: impl Iterator<Item = [[f64; 3]; 2]>) -> [[f64; 3]; 2] {
    let empty = [[f64::INFINITY; 3], [f64::NEG_INFINITY; 3]];
    boxes.fold(empty, |[low, high], [l, h]| {
        [std::array::from_fn(|k| low[k].min(l[k])), std::array::from_fn(|k| high[k].max(h[k]))]
    })
}
