//! Rows of an image with their z-buffer, drawn by one thread.

use std::cell::RefCell;
use std::ops::Range;

use multiversion::multiversion;

// A build for one processor that has AVX-512 leaves out the attributes that make it safe to call.
#[cfg(all(target_arch = "x86_64", not(target_feature = "avx512f")))]
use super::avx512::draw as draw_wide;
#[cfg(all(target_arch = "x86_64", target_feature = "avx512f"))]
use draw_record as draw_wide;

use super::setup::{Image, Keep, Prepared, Record};
use super::{Fragment, Surface};
use crate::error::Result;
use crate::raster::Size;

/// Samples of a row that are drawn together.
const LANES: usize = 8;

/// Samples of a band at least, unless the image has fewer: their z-buffer is 3 MiB.
const BAND_SAMPLES: usize = 1 << 18;

/// Bands of an image at most, about: each looks at the rows of every face.
const BANDS: usize = 128;

/// The z-buffer of one thread; all zeros between uses.
#[derive(Debug, Default)]
struct Scratch {
    nearness: Vec<f64>,
    ids: Vec<u32>,
    fragments: Vec<Fragment>,
}

thread_local! {
    // Lists, for a thread that waits for its bands may begin another image meanwhile.
    static SCRATCHES: RefCell<Vec<Scratch>> = const { RefCell::new(Vec::new()) };
    static PREPARED: RefCell<Vec<Prepared>> = const { RefCell::new(Vec::new()) };
}

/// Work with buffers of this thread for a whole image.
pub(super) fn with_prepared<T>(work: impl FnOnce(&mut Prepared) -> T) -> T {
    let mut prepared = PREPARED.with_borrow_mut(Vec::pop).unwrap_or_default();
    let result = work(&mut prepared);
    PREPARED.with_borrow_mut(|list| list.push(prepared));
    result
}

/// How many rows of an image are drawn at once, as a multiple of `unit`; with several samples a pixel
/// they are fewer, for textures want the cache too.
pub(super) fn band_rows(size: Size, unit: usize) -> usize {
    let least = if unit > 1 { BAND_SAMPLES / 4 } else { BAND_SAMPLES };
    let samples = least.max(size.pixels() / BANDS);
    (samples / size.width / unit).max(1) * unit
}

/// Work on each of a range with its part of a piece, in parallel, without a list of the parts;
/// `cut` takes those of the first so many off a piece. The error is that of the first that has one.
pub(super) fn for_each<P: Send>(
    range: Range<usize>,
    piece: P,
    cut: &(impl Fn(P, usize) -> (P, P) + Sync),
    work: &(impl Fn(usize, P) -> Result<()> + Sync),
) -> Result<()> {
    let Range { start, end } = range;
    if end - start <= 1 {
        return if start < end { work(start, piece) } else { Ok(()) };
    }
    let middle = start.midpoint(end);
    let (head, tail) = cut(piece, middle - start);
    let (head, tail) = rayon::join(
        || for_each(start..middle, head, cut, work),
        || for_each(middle..end, tail, cut, work),
    );
    head.and(tail)
}

/// Draw an image in bands of so many rows and hand each band to `resolve`, with its part of the
/// piece; `cut` takes the part of so many samples off a piece.
pub(super) fn draw<P: Send>(
    image: &Image<'_>,
    rows: usize,
    piece: P,
    cut: impl Fn(P, usize) -> (P, P) + Sync,
    resolve: impl Fn(&Band<'_>, &mut Vec<Fragment>, P) + Sync,
) -> Result<()> {
    let Size { height, width } = image.size;
    with_prepared(|prepared| {
        if height <= rows {
            return with_planes(0..height, width, |planes, fragments| {
                prepared.stream(image, Keep::Centres, |records| planes.draw(records))?;
                resolve(&planes.band(prepared), fragments, piece);
                Ok(())
            });
        }
        prepared.prepare(image, Keep::Centres)?;
        let one = |k: usize, piece: P| {
            let band = k * rows..((k + 1) * rows).min(height);
            with_planes(band, width, |planes, fragments| {
                planes.draw(prepared.records());
                resolve(&planes.band(prepared), fragments, piece);
                Ok(())
            })
        };
        let cut = |piece, bands| cut(piece, bands * rows * width);
        for_each(0..height.div_ceil(rows), piece, &cut, &one)
    })
}

/// Work with planes of this thread for a band of rows of an image so wide, all zeros.
fn with_planes<T>(
    rows: Range<usize>,
    width: usize,
    work: impl FnOnce(&mut Planes<'_>, &mut Vec<Fragment>) -> T,
) -> T {
    let mut scratch = SCRATCHES.with_borrow_mut(Vec::pop).unwrap_or_default();
    let stride = width + LANES;
    let samples = stride * (rows.len() + 1); // one more, for steps of two rows
    if scratch.nearness.len() < samples {
        scratch.nearness.resize(samples, 0.0);
        scratch.ids.resize(samples, 0);
    }
    let Scratch { nearness, ids, fragments } = &mut scratch;
    let (nearness, ids) = (&mut nearness[..samples], &mut ids[..samples]);
    let mut planes = Planes { rows, stride, nearness, ids, dirty: Dirty::default() };
    let result = work(&mut planes, fragments);
    planes.clear();
    SCRATCHES.with_borrow_mut(|list| list.push(scratch));
    result
}

/// The z-buffer of a band of rows.
struct Planes<'a> {
    rows: Range<usize>,
    stride: usize,
    nearness: &'a mut [f64],
    ids: &'a mut [u32],
    dirty: Dirty,
}

impl Planes<'_> {
    fn draw(&mut self, records: &[Record]) {
        let planes = (&mut *self.nearness, &mut *self.ids);
        let found = fill(records, self.rows.clone(), self.stride, planes);
        self.dirty.add(found);
    }

    fn band<'a>(&'a self, prepared: &'a Prepared) -> Band<'a> {
        let Self { rows, stride, nearness, ids, dirty } = self;
        Band { prepared, rows: rows.clone(), dirty, stride: *stride, nearness, ids }
    }

    fn clear(&mut self) {
        let Dirty { rows, columns } = &self.dirty;
        for row in rows.clone() {
            let samples = row * self.stride + columns.start..row * self.stride + columns.end;
            self.nearness[samples.clone()].fill(0.0);
            self.ids[samples].fill(0);
        }
    }
}

/// The part of a band that faces may have drawn to.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(super) struct Dirty {
    /// Counted from the first row of the band.
    pub(super) rows: Range<usize>,
    pub(super) columns: Range<usize>,
}

impl Dirty {
    fn add(&mut self, other: Self) {
        if self.rows.is_empty() {
            *self = other;
        } else if !other.rows.is_empty() {
            let join = |a: &Range<usize>, b: &Range<usize>| a.start.min(b.start)..a.end.max(b.end);
            self.rows = join(&self.rows, &other.rows);
            self.columns = join(&self.columns, &other.columns);
        }
    }
}

/// Rows of an image, drawn.
#[derive(Debug)]
pub(super) struct Band<'a> {
    pub(super) prepared: &'a Prepared,
    /// The rows of the image.
    pub(super) rows: Range<usize>,
    pub(super) dirty: &'a Dirty,
    stride: usize,
    nearness: &'a [f64],
    ids: &'a [u32],
}

impl Band<'_> {
    /// Columns of the image.
    pub(super) fn width(&self) -> usize {
        self.stride - LANES
    }

    /// `1/z` (0: nothing there) and ids of a row, counted from the first of the band.
    pub(super) fn row(&self, row: usize) -> (&[f64], &[u32]) {
        let samples = row * self.stride..(row + 1) * self.stride;
        (&self.nearness[samples.clone()], &self.ids[samples])
    }

    /// What is seen in a row, from left to right.
    pub(super) fn fragments(&self, row: usize, surfaces: &[Surface<'_>], out: &mut Vec<Fragment>) {
        out.clear();
        if !self.dirty.rows.contains(&row) {
            return;
        }
        let (nearness, ids) = self.row(row);
        let v = (self.rows.start + row) as f64 + 0.5;
        for column in self.dirty.columns.clone() {
            if ids[column] != 0 {
                let (part, face) = self.prepared.find(ids[column]);
                let centre = [column as f64 + 0.5, v];
                let depth = 1.0 / nearness[column];
                let (model, screen) = (surfaces[part].model, &self.prepared.screens[part]);
                out.push(Fragment::new((model, screen), (part, face), column, centre, depth));
            }
        }
    }
}

/// Draw the faces of the rows; what they may have touched.
#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx512bw+avx2+fma", "x86_64+avx2+fma"))]
fn fill(
    records: &[Record],
    band: Range<usize>,
    stride: usize,
    (nearness, ids): (&mut [f64], &mut [u32]),
) -> Dirty {
    let (top, bottom) = (band.start as i32, band.end as i32);
    let mut touched = [i32::MAX, 0, i32::MAX, 0];
    for record in records {
        let [first, end] = record.rows;
        let (first, end) = (first.max(top), end.min(bottom));
        if first >= end {
            continue;
        }
        let [left, right] = record.columns;
        touched[0] = touched[0].min(first);
        touched[1] = touched[1].max(end);
        touched[2] = touched[2].min(left);
        touched[3] = touched[3].max(right);
        let start = (first - top) as usize * stride + left as usize;
        let planes = (&mut nearness[start..], &mut ids[start..]);
        multiversion::target::match_target! {
            "x86_64+avx512f+avx512vl" => draw_wide(record, [first, end], stride, planes),
            _ => draw_record(record, [first, end], stride, planes),
        }
    }
    if touched[1] == 0 {
        return Dirty { rows: 0..0, columns: 0..0 };
    }
    let [first, end, left, right] = touched;
    Dirty {
        rows: (first - top) as usize..(end - top) as usize,
        columns: left as usize..right as usize,
    }
}

/// Draw the rows of a record into planes that begin at its first row and column.
#[inline(always)]
fn draw_record(
    record: &Record,
    [first, end]: [i32; 2],
    stride: usize,
    (nearness, ids): (&mut [f64], &mut [u32]),
) {
    let [left, right] = record.columns;
    let count = ((right - left) as usize).div_ceil(LANES) * LANES;
    let mut start = 0;
    for row in first..end {
        let samples = start..start + count;
        let planes = (&mut nearness[samples.clone()], &mut ids[samples]);
        draw_row(record, f64::from(left) + 0.5, f64::from(row) + 0.5, planes);
        start += stride;
    }
}

/// Samples of one row from `u` on; as many as there are whole groups of lanes.
#[inline(always)]
fn draw_row(record: &Record, u: f64, v: f64, (nearness, ids): (&mut [f64], &mut [u32])) {
    // Of a length that has no remainder, which the compiler can see.
    let count = nearness.len() / LANES * LANES;
    let (nearness, ids) = (&mut nearness[..count], &mut ids[..count]);
    let row = record.row(v);
    let right = f64::from(record.columns[1]);
    for k in 0..count {
        let x = u + f64::from(k as i32);
        let (inside, w) = record.meet(record.column(x), row);
        let seen = inside & (x < right) & (w > nearness[k]);
        nearness[k] = if seen { w } else { nearness[k] };
        ids[k] = if seen { record.id } else { ids[k] };
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::camera::Intrinsics;
    use crate::raster::{Model, View};

    proptest! {
        #[test]
        fn every_instruction_set_draws_the_same_bits(
            // Where, how large (some are less than four columns wide), and which shape.
            triangles in prop::collection::vec(
                (
                    prop::array::uniform3(-1.0..1.0_f64),
                    0.02..1.0_f64,
                    prop::array::uniform3(prop::array::uniform3(-1.0..1.0_f64)),
                ),
                1..20,
            )
        ) {
            let triangles: Vec<[[f64; 3]; 3]> = triangles
                .iter()
                .map(|(middle, size, shape)| {
                    let size = if *size < 0.5 { 0.4 * size } else { *size };
                    shape.map(|corner| [0, 1, 2].map(|k| 0.6 * middle[k] + 0.4 * size * corner[k]))
                })
                .collect();
            let faces: Vec<[u32; 3]> =
                (0..triangles.len() as u32).map(|k| [3 * k, 3 * k + 1, 3 * k + 2]).collect();
            let model = Model::new(triangles.as_flattened(), &faces).expect("valid");
            let rotation = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
            let camera = Intrinsics::new(40.0, 40.0, 20.0, 15.0).expect("valid");
            let view = View { rotation, translation: [0.0, 0.0, 1.5], camera };
            let size = Size { height: 30, width: 43 };
            let mut prepared = Prepared::default();
            let surfaces = [Surface::new(&model)];
            let image = Image { surfaces: &surfaces, views: &[view], near: 0.1, size, samples: 1 };
            prepared.prepare(&image, Keep::Centres).expect("drawn");
            let stride = size.width + LANES;
            let n = stride * 21;
            let (mut fast, mut plain) = ((vec![0.0; n], vec![0; n]), (vec![0.0; n], vec![0; n]));
            let planes = (fast.0.as_mut_slice(), fast.1.as_mut_slice());
            fill(prepared.records(), 5..25, stride, planes);
            for record in prepared.records() {
                let [first, end] = record.rows;
                let (first, end) = (first.max(5), end.min(25));
                if first < end {
                    let start = (first - 5) as usize * stride + record.columns[0] as usize;
                    let planes = (&mut plain.0[start..], &mut plain.1[start..]);
                    draw_record(record, [first, end], stride, planes);
                }
            }
            prop_assert!(fast == plain);
        }
    }
}
