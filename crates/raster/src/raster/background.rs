//! Pixels where nothing is: most of an image, and the time to write them is that of the memory.
//!
//! What is larger than the processor's caches is written past them. A plain store first reads the
//! line that it is about to overwrite, and drives out what is of use; a batch of 1080p images took
//! twice as long.

#![expect(unsafe_code, reason = "stores past the caches have no safe form")]

use std::ops::Range;

use rayon::prelude::*;

/// Outputs of more bytes than this do not stay in a cache until they are read.
const FAR: usize = 64 << 20;

/// A stretch of fewer bytes is written as any other: waiting for the end of the others takes longer.
const SHORTEST: usize = 4096;

/// Longer stretches are shared out, in parts of so many numbers.
const LARGE: usize = 1 << 18;

/// How the background of a batch is written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Background {
    /// As anything else.
    Near,
    /// Past the caches.
    Far,
}

/// Numbers that are nothing but their bits.
pub trait Plain: Copy + Send + Sync {
    /// The value over and over, in eight bytes.
    fn word(self) -> u64;
}

impl Plain for f64 {
    fn word(self) -> u64 {
        self.to_bits()
    }
}

impl Plain for u32 {
    fn word(self) -> u64 {
        u64::from(self) * 0x1_0000_0001
    }
}

impl Plain for f32 {
    fn word(self) -> u64 {
        self.to_bits().word()
    }
}

impl Plain for i32 {
    fn word(self) -> u64 {
        self.cast_unsigned().word()
    }
}

impl Plain for bool {
    fn word(self) -> u64 {
        u64::from(self) * 0x0101_0101_0101_0101
    }
}

/// A line of a cache.
#[derive(Clone, Copy)]
#[repr(C, align(64))]
struct Line([u64; 8]);

impl Background {
    /// For outputs of so many bytes in one call.
    pub(crate) fn of(bytes: usize) -> Self {
        if bytes > FAR { Self::Far } else { Self::Near }
    }

    /// Give all of a stretch one value.
    pub(crate) fn fill<T: Plain>(self, out: &mut [T], value: T) {
        if self == Self::Near || size_of_val(out) < SHORTEST {
            out.fill(value);
        } else {
            far(out, value);
        }
    }

    /// As [`fill`](Self::fill), by all threads. One that waits for the others may be given another
    /// image meanwhile, so nothing may be borrowed from its buffers.
    pub(crate) fn fill_together<T: Plain>(self, out: &mut [T], value: T) {
        if out.len() > LARGE {
            out.par_chunks_mut(LARGE).for_each(|part| self.fill(part, value));
        } else {
            self.fill(out, value);
        }
    }

    /// Give one value to everything but these columns of these rows, in rows of `width`.
    pub(crate) fn fill_around<T: Plain>(
        self,
        out: &mut [T],
        value: T,
        width: usize,
        (rows, columns): (Range<usize>, Range<usize>),
    ) {
        let mut begin = 0;
        for row in rows {
            self.fill(&mut out[begin..row * width + columns.start], value);
            begin = row * width + columns.end;
        }
        self.fill(&mut out[begin..], value);
    }
}

/// An output that is given its background between steps of other work: stores wait for the memory,
/// and that work does not wait for them unless there are many at a time.
#[derive(Debug)]
pub(crate) struct Beside<'a, T> {
    out: &'a mut [T],
    value: T,
    /// So many are written.
    done: usize,
    /// Of a step.
    share: usize,
}

impl<'a, T: Plain> Beside<'a, T> {
    /// Outputs that are written past the caches, and those that threads share, are done at once.
    pub(crate) fn new(background: Background, out: &'a mut [T], value: T) -> Self {
        let shared = out.len() > LARGE && rayon::current_num_threads() > 1;
        let at_once = shared || background == Background::Far;
        if at_once {
            background.fill_together(out, value);
        }
        let done = if at_once { out.len() } else { 0 };
        Self { out, value, done, share: 0 }
    }

    /// So many steps share what is left.
    pub(crate) fn pace(&mut self, steps: usize) {
        self.share = (self.out.len() - self.done).div_ceil(steps.max(1));
    }

    /// Write the next part.
    #[inline(always)]
    pub(crate) fn step(&mut self) {
        let end = (self.done + self.share).min(self.out.len());
        self.out[self.done..end].fill(self.value);
        self.done = end;
    }

    /// The output, all of it written.
    #[inline(always)]
    pub(crate) fn finish(&mut self) -> &mut [T] {
        if self.done < self.out.len() {
            self.out[self.done..].fill(self.value);
            self.done = self.out.len();
        }
        self.out
    }
}

/// As [`slice::fill`], past the caches.
fn far<T: Plain>(out: &mut [T], value: T) {
    // SAFETY: lines have no bits without meaning, and get only copies of the bits of a `T`, from a
    // multiple of its size on; `Plain` is implemented in this file alone.
    let (head, lines, tail) = unsafe { out.align_to_mut::<Line>() };
    head.fill(value);
    tail.fill(value);
    stream(lines, Line([value.word(); 8]));
}

#[cfg(all(target_arch = "x86_64", not(miri)))]
fn stream(lines: &mut [Line], line: Line) {
    use std::arch::x86_64::{_mm_set1_pd, _mm_sfence, _mm_stream_pd};
    let word = f64::from_bits(line.0[0]);
    for line in lines {
        let start = line.0.as_mut_ptr().cast::<f64>();
        for pair in 0..4 {
            // SAFETY: the four pairs of words of a line, which begins at a multiple of 64 bytes;
            // SSE2 is part of every x86-64 processor.
            unsafe { _mm_stream_pd(start.add(2 * pair), _mm_set1_pd(word)) };
        }
    }
    // SAFETY: an instruction of every x86-64 processor. Without it another thread might see what is
    // written later before these stores.
    unsafe { _mm_sfence() };
}

#[cfg(any(not(target_arch = "x86_64"), miri))]
fn stream(lines: &mut [Line], line: Line) {
    lines.fill(line);
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::super::{Mode, Model, Screen, Size, View};
    use super::*;
    use crate::camera::Intrinsics;

    /// Written past the caches and plainly, from any place on.
    fn check<T: Plain + PartialEq + std::fmt::Debug>(values: [T; 2], cut: (usize, usize)) {
        let (first, end) = cut;
        let mut found = vec![values[0]; 1000];
        let mut expected = found.clone();
        far(&mut found[first..end], values[1]);
        expected[first..end].fill(values[1]);
        assert_eq!(found, expected);
    }

    proptest! {
        #[test]
        fn past_the_caches_the_same_is_written(
            first in 0..1000_usize, length in 0..1000_usize, bits in any::<u32>()
        ) {
            let cut = (first, (first + length).min(1000));
            check([0, bits], cut);
            check([-1, bits.cast_signed()], cut);
            check([0.0, f64::from(bits) / 7.0], cut);
            check([0.0, bits as f32 / 7.0], cut);
            check([true, bits % 2 == 0], cut);
        }

        #[test]
        fn only_the_part_in_the_middle_is_left(
            height in 1..12_usize, width in 1..4000_usize, cut in prop::array::uniform4(0.0..1.0_f64)
        ) {
            let of = |share: f64, n: usize| (share * n as f64) as usize;
            let ordered = |a: usize, b: usize| a.min(b)..a.max(b);
            let rows = ordered(of(cut[0], height + 1), of(cut[1], height + 1));
            let columns = ordered(of(cut[2], width + 1), of(cut[3], width + 1));
            for background in [Background::Near, Background::Far] {
                let mut out = vec![7_i32; height * width];
                background.fill_around(&mut out, -1, width, (rows.clone(), columns.clone()));
                for (k, value) in out.iter().enumerate() {
                    let kept = rows.contains(&(k / width)) && columns.contains(&(k % width));
                    prop_assert_eq!(*value, if kept { 7 } else { -1 });
                }
            }
        }
    }

    #[test]
    fn steps_write_each_part_once_and_the_end_what_is_left() {
        for (length, steps, taken) in [(100, 7, 7), (100, 7, 3), (3, 10, 10), (0, 4, 4), (5, 0, 1)]
        {
            let mut out = vec![7_i32; length];
            let mut beside = Beside::new(Background::Near, &mut out, 0);
            beside.pace(steps);
            for _ in 0..taken {
                beside.step();
            }
            let expected = (taken * length.div_ceil(steps.max(1))).min(length);
            assert_eq!(beside.done, expected);
            assert!(beside.out[..expected].iter().all(|&x| x == 0));
            assert!(beside.out[expected..].iter().all(|&x| x == 7));
            assert!(beside.finish().iter().all(|&x| x == 0));
        }
        let mut out = vec![7_i32; 100];
        let beside = Beside::new(Background::Far, &mut out, 0);
        assert_eq!(beside.done, 100);
    }

    #[test]
    #[cfg_attr(miri, ignore = "takes too long there")]
    fn masks_are_the_same_past_the_caches() {
        let size = Size { height: 40, width: 3000 };
        let corners = [[-1.0, -0.4, 0.0], [0.9, -0.3, 0.2], [0.1, 0.6, -0.3], [0.3, 0.2, 0.4]];
        let model = Model::new(&corners, &[[0, 1, 2], [1, 3, 2]]).expect("valid");
        let view = View {
            rotation: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
            translation: [0.0, 0.0, 2.0],
            camera: Intrinsics::new(900.0, 30.0, 1500.0, 20.0).expect("valid"),
        };
        let mut screen = Screen::default();
        screen.project(&model, &view, 0.1).expect("drawn");
        for mode in [
            Mode::Hard,
            Mode::Coverage { sigma: 0.0 },
            Mode::Coverage { sigma: 1.5 },
            Mode::Dibr { delta: 7000.0, cutoff: None },
            Mode::Sigmoid { sigma: 1e-4, cutoff: None },
        ] {
            let masks = [Background::Near, Background::Far].map(|background| {
                let mut out = vec![f32::NAN; size.pixels()];
                mode.draw(&model, &screen, size, (&mut out, background), false);
                out
            });
            assert!(masks[0].iter().any(|&value| value > 0.5), "{mode:?}");
            assert_eq!(masks[0], masks[1], "{mode:?}");
        }
    }
}
