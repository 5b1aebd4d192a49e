//! A separable Gaussian that sees 0 outside the image. Its taps are symmetric, so it is its own
//! adjoint.
//!
//! Rows come in fours: down the columns each pixel that is loaded serves four of them, and along
//! the rows all taps of a stretch of pixels are added up in registers. Rows and columns outside the
//! part of the image that is not 0 are left out.

use super::{Sample, Size};

/// Rows at a time.
const ROWS: usize = 4;

/// The taps of one axis, without those that cannot count.
#[derive(Debug, Clone)]
pub(super) struct Taps<T> {
    weights: Vec<T>,
    /// The same with a margin of `ROWS - 1` zeros.
    padded: Vec<T>,
    radius: usize,
}

/// What a pass works with.
#[derive(Debug, Default)]
pub(super) struct Buffers<T> {
    /// Some rows of column sums, with the reach of the taps on either side, which stays 0.
    lines: Vec<T>,
    out: Vec<T>,
}

impl<T: Sample> Taps<T> {
    /// A standard deviation in pixels and the taps on either side; divided by the sum of all.
    ///
    /// Those below [`Sample::NEGLIGIBLE`] of the largest are then dropped: together they are less
    /// than the rounding of one pixel.
    pub(super) fn new(sigma: f64, radius: usize) -> Self {
        let tap = |x: usize| match x {
            0 => 1.0,
            _ => (-((x * x) as f64) / (2.0 * sigma * sigma)).exp(),
        };
        let sum = 1.0 + 2.0 * (1..=radius).map(tap).sum::<f64>();
        let kept = (1..=radius).take_while(|&x| tap(x) >= T::NEGLIGIBLE).count();
        let one = |k: usize| T::from_f64(tap(k.abs_diff(kept)) / sum);
        let weights: Vec<T> = (0..=2 * kept).map(one).collect();
        let mut padded = vec![T::default(); weights.len() + 2 * (ROWS - 1)];
        padded[ROWS - 1..ROWS - 1 + weights.len()].copy_from_slice(&weights);
        Self { weights, padded, radius: kept }
    }

    /// As far as `4 sigma`; 0 is no blur.
    pub(super) fn whole(sigma: f64) -> Self {
        Self::new(sigma, (4.0 * sigma).ceil() as usize)
    }

    /// Whether this is no blur.
    pub(super) fn is_identity(&self) -> bool {
        self.radius == 0
    }

    /// The blur of a row (or column) of ones.
    pub(super) fn ones(&self, length: usize, out: &mut Vec<T>) {
        out.clear();
        out.extend((0..length).map(|place| {
            // Tap k takes place + k - radius.
            let first = self.radius.saturating_sub(place);
            let end = (length + self.radius - place).min(self.weights.len());
            T::from_f64(self.weights[first..end].iter().map(|t| t.to_f64()).sum())
        }));
    }

    /// Hand row after row of the blurred image to `each`.
    #[inline(always)]
    pub(super) fn rows<const FMA: bool>(
        &self,
        image: &[T],
        size: Size,
        Buffers { lines, out }: &mut Buffers<T>,
        mut each: impl FnMut(usize, &[T]),
    ) {
        let (r, Size { height, width }) = (self.radius, size);
        out.clear();
        out.resize(width, T::default());
        let (rows, mut columns) = support(image, size);
        // At least one stretch of lanes wide, if the image is.
        columns.1 = columns.1.max((columns.0 + 32).min(width));
        columns.0 = columns.0.min(columns.1.saturating_sub(32));
        let length = width + 2 * r;
        lines.clear();
        lines.resize(ROWS * length, T::default());
        let reach = (columns.0.saturating_sub(r), (columns.1 + r).min(width));
        for i in (0..height).step_by(ROWS) {
            let count = ROWS.min(height - i);
            let from = i.saturating_sub(r).max(rows.0);
            let to = (i + count + r).min(rows.1);
            let any = from < to;
            if any {
                let job = Down { image, width, from, to, offset: ROWS - 1 + r + from - i };
                match columns.1 - columns.0 {
                    32.. => job.all::<FMA, 32>(&self.padded, columns, lines, length, r),
                    _ => job.all::<FMA, 1>(&self.padded, columns, lines, length, r),
                }
            }
            for k in 0..count {
                let line = &lines[k * length..(k + 1) * length];
                match reach.1 - reach.0 {
                    _ if !any => out.fill(T::default()),
                    64.. => along::<FMA, T, 64>(&self.weights, line, reach, out),
                    16.. => along::<FMA, T, 16>(&self.weights, line, reach, out),
                    _ => along::<FMA, T, 1>(&self.weights, line, reach, out),
                }
                each(i + k, out);
            }
        }
    }
}

/// Down the columns, for one group of rows.
#[derive(Clone, Copy)]
struct Down<'a, T> {
    image: &'a [T],
    width: usize,
    /// Rows of the image that count.
    from: usize,
    to: usize,
    /// Which padded tap the first row of the group takes of row `from`.
    offset: usize,
}

impl<T: Sample> Down<'_, T> {
    /// All columns, in stretches of `L`; the last one overlaps.
    #[inline(always)]
    fn all<const FMA: bool, const L: usize>(
        self,
        padded: &[T],
        columns: (usize, usize),
        lines: &mut [T],
        length: usize,
        r: usize,
    ) {
        let mut j = columns.0;
        while j < columns.1 {
            let at = j.min(columns.1 - L);
            let sums = self.stretch::<FMA, L>(padded, at);
            for (k, sums) in sums.iter().enumerate() {
                lines[k * length + r + at..][..L].copy_from_slice(sums);
            }
            j += L;
        }
    }

    #[inline(always)]
    fn stretch<const FMA: bool, const L: usize>(self, padded: &[T], at: usize) -> [[T; L]; ROWS] {
        let mut sums = [[T::default(); L]; ROWS];
        let mut place = self.from * self.width + at;
        for row in 0..self.to - self.from {
            let pixels: &[T; L] = self.image[place..place + L].try_into().expect("L pixels");
            let end = self.offset + row + 1;
            let taps: &[T; ROWS] = padded[end - ROWS..end].try_into().expect("a tap for each");
            for k in 0..ROWS {
                let tap = taps[ROWS - 1 - k];
                for l in 0..L {
                    sums[k][l] = pixels[l].fused::<FMA>(tap, sums[k][l]);
                }
            }
            place += self.width;
        }
        sums
    }
}

/// Along a padded line, in stretches of `L`; the last one overlaps. What is out of reach is 0.
#[inline(always)]
fn along<const FMA: bool, T: Sample, const L: usize>(
    taps: &[T],
    line: &[T],
    reach: (usize, usize),
    out: &mut [T],
) {
    let mut j = reach.0;
    while j < reach.1 {
        let at = j.min(reach.1 - L);
        let mut sums = [T::default(); L];
        for (k, &tap) in taps.iter().enumerate() {
            let pixels: &[T; L] = line[at + k..at + k + L].try_into().expect("L pixels");
            for l in 0..L {
                sums[l] = pixels[l].fused::<FMA>(tap, sums[l]);
            }
        }
        out[at..at + L].copy_from_slice(&sums);
        j += L;
    }
    out[..reach.0].fill(T::default());
    out[reach.1..].fill(T::default());
}

/// The rows and the columns, half open, outside which all pixels are 0.
#[inline(always)]
fn support<T: Sample>(image: &[T], size: Size) -> ((usize, usize), (usize, usize)) {
    let zero = T::default();
    let (mut rows, mut columns) = ((size.height, 0), (size.width, 0));
    for (i, row) in image.chunks_exact(size.width).enumerate() {
        let mut any = false;
        for &pixel in row {
            any |= pixel != zero;
        }
        if !any {
            continue;
        }
        rows = (rows.0.min(i), i + 1);
        columns.0 = row[..columns.0].iter().position(|&p| p != zero).unwrap_or(columns.0);
        let right = row[columns.1..].iter().rposition(|&p| p != zero);
        columns.1 = right.map_or(columns.1, |k| columns.1 + k + 1);
    }
    if rows.1 == 0 { ((0, 0), (0, 0)) } else { (rows, columns) }
}
