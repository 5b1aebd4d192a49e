//! Sums over pixels, one set for each edge of a block, and what becomes of them at the corners.

use multiversion::multiversion;

use super::faces::{Block, Source};
use super::real::{LANES, Lanes, Real};
use super::visits::Visit;

/// Of an edge, over the pixels of a tile in lanes: weight times `across`, `across * along`, `beyond`
/// with the sign of the end, `beyond`; `along` ends at the ends of the edge.
pub(super) type EdgeSums<R> = [Lanes<R>; 4];

/// Edge `k` of face `lane` is at `16 k + lane`; a quarter is nothing and spares a check of the index.
pub(super) type BlockSums<R> = [EdgeSums<R>; 4 * LANES];

/// Sums of a block.
#[derive(Debug)]
pub(super) struct Sums<R> {
    pub(super) edges: BlockSums<R>,
}

/// Sums over the pixels too: the lanes are faces.
pub(super) type Totals<R> = [[[R; LANES]; 4]; 3];

impl<R: Real> Sums<R> {
    pub(super) fn new() -> Self {
        Self { edges: [[Lanes::ZERO; 4]; 4 * LANES] }
    }

    /// Those of the edge with this record.
    #[inline(always)]
    pub(super) fn of(&mut self, record: usize) -> &mut EdgeSums<R> {
        &mut self.edges[record % (4 * LANES)]
    }

    /// All become 0.
    #[inline(always)]
    pub(super) fn clear(&mut self) {
        self.edges[..3 * LANES].as_flattened_mut().fill(Lanes::ZERO);
    }

    /// Carry the sums of a block on to the corners. With `q` the nearest point of edge `a b` at `s`,
    /// the derivative of the squared distance is `2 (1 - s)(q - pixel)` for `a` and
    /// `2 s (q - pixel)` for `b` (envelope theorem).
    #[inline(always)]
    pub(super) fn scatter(
        &self,
        source: &Source<'_>,
        block: &Block<R>,
        visits: &[Visit],
        factor: f64,
        du: &mut [f64],
        dv: &mut [f64],
    ) {
        let totals = R::totals(&self.edges);
        // The exponent is one of 2.
        let scale = source.units.scale.map(|s| 2.0 * std::f64::consts::LN_2 * factor * s);
        // For the ends of each edge, per axis.
        let mut ends = [[[0.0; LANES]; 4]; 3];
        for k in 0..3 {
            let (edges, [s0, s1, s2, s3]) = (&block.edges, &totals[k]);
            for l in 0..LANES {
                let (x, y) = (edges.x[k][l].wide(), edges.y[k][l].wide());
                let half = edges.half[k][l].wide();
                let (across, end) = (s0[l].wide(), s2[l].wide());
                let inverse = if half > 0.0 { 1.0 / half } else { 0.0 };
                // q - pixel = -end e - across (-e_y, e_x).
                let (wx, wy) = (across * y - end * x, -across * x - end * y);
                let (across, end) = (s1[l].wide() * inverse, s3[l].wide());
                let end = if half > 0.0 { end } else { 0.0 };
                let (tx, ty) = (across * y - end * x, -across * x - end * y);
                let [from, to] = [block.kept[k][0][l], block.kept[k][1][l]];
                let (bx, by) = (0.5 * (wx + tx), 0.5 * (wy + ty));
                let (bx, by) = (from * wx + (to - from) * bx, from * wy + (to - from) * by);
                ends[k][0][l] = scale[0] * (wx - bx);
                ends[k][1][l] = scale[1] * (wy - by);
                ends[k][2][l] = scale[0] * bx;
                ends[k][3][l] = scale[1] * by;
            }
        }
        for (lane, visit) in visits.iter().enumerate() {
            let [a, b, c] = source.faces[visit.face as usize];
            let corners = if block.turned[lane] { [a, c, b] } else { [a, b, c] };
            for k in 0..3 {
                let (point, before) = (corners[k] as usize, (k + 2) % 3);
                du[point] += ends[k][0][lane] + ends[before][2][lane];
                dv[point] += ends[k][1][lane] + ends[before][3][lane];
            }
        }
    }
}

// A build for one processor that has AVX-512 leaves out the attributes that make it safe to call.
#[cfg(all(target_arch = "x86_64", not(target_feature = "avx512f")))]
use self::avx512::totals as totals_wide;
#[cfg(all(target_arch = "x86_64", target_feature = "avx512f"))]
use totals as totals_wide;

/// Sums over the lanes, in a fixed order. A call of its own, for an instruction set of its own.
#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx512bw+avx2+fma", "x86_64+avx2+fma"))]
pub(super) fn totals_single(edges: &BlockSums<f32>) -> Totals<f32> {
    multiversion::target::match_target! {
        "x86_64+avx512f" => totals_wide(edges),
        _ => totals(edges),
    }
}

/// Sums over the lanes, in a fixed order: (0 + 8 + 4 + 12) + (2 + 10 + 6 + 14), and the odd ones.
#[inline(always)]
pub(super) fn totals<R: Real>(edges: &BlockSums<R>) -> Totals<R> {
    let mut totals = [[[R::ZERO; LANES]; 4]; 3];
    for (total, faces) in totals.iter_mut().zip(edges.chunks_exact(LANES)) {
        for (lane, sums) in faces.iter().enumerate() {
            for (total, lanes) in total.iter_mut().zip(sums) {
                let mut four = [R::ZERO; 4];
                for l in 0..4 {
                    four[l] = (lanes[l] + lanes[l + 8]) + (lanes[l + 4] + lanes[l + 12]);
                }
                total[lane] = (four[0] + four[2]) + (four[1] + four[3]);
            }
        }
    }
    totals
}

#[cfg(all(target_arch = "x86_64", not(target_feature = "avx512f")))]
mod avx512 {
    use std::arch::x86_64::{
        __m512, _mm_cvtss_f32, _mm_extract_ps, _mm512_add_ps, _mm512_castpd_ps, _mm512_castps_pd,
        _mm512_extractf32x4_ps, _mm512_setr_ps, _mm512_setzero_ps, _mm512_shuffle_f32x4,
        _mm512_unpackhi_pd, _mm512_unpackhi_ps, _mm512_unpacklo_pd, _mm512_unpacklo_ps,
    };

    use super::{BlockSums, LANES, Totals};

    /// The same bits as [`super::totals`], sixteen faces at a time.
    #[inline]
    #[target_feature(enable = "avx512f")]
    pub(super) fn totals(edges: &BlockSums<f32>) -> Totals<f32> {
        let mut totals = [[[0.0; LANES]; 4]; 3];
        for (total, faces) in totals.iter_mut().zip(edges.chunks_exact(LANES)) {
            for (k, total) in total.iter_mut().enumerate() {
                let mut eight = [_mm512_setzero_ps(); 8];
                for (l, sum) in eight.iter_mut().enumerate() {
                    let (a, b) = (load(&faces[l][k]), load(&faces[l + 8][k]));
                    *sum = _mm512_add_ps(
                        _mm512_shuffle_f32x4::<0x44>(a, b),
                        _mm512_shuffle_f32x4::<0xEE>(a, b),
                    );
                }
                let mut four = [_mm512_setzero_ps(); 4];
                for (l, sum) in four.iter_mut().enumerate() {
                    let (a, b) = (eight[l], eight[l + 4]);
                    *sum = _mm512_add_ps(
                        _mm512_shuffle_f32x4::<0x88>(a, b),
                        _mm512_shuffle_f32x4::<0xDD>(a, b),
                    );
                }
                // Faces l, l + 8, l + 4, l + 12 in the quarters of each, four partial sums of it.
                let pair = |a: __m512, b: __m512| {
                    _mm512_add_ps(_mm512_unpacklo_ps(a, b), _mm512_unpackhi_ps(a, b))
                };
                let (a, b) = (pair(four[0], four[1]), pair(four[2], four[3]));
                let (a, b) = (_mm512_castps_pd(a), _mm512_castps_pd(b));
                let low = _mm512_castpd_ps(_mm512_unpacklo_pd(a, b));
                let high = _mm512_castpd_ps(_mm512_unpackhi_pd(a, b));
                let sum = _mm512_add_ps(low, high);
                store(_mm512_shuffle_f32x4::<0xD8>(sum, sum), total);
            }
        }
        totals
    }

    /// One load.
    #[inline]
    #[target_feature(enable = "avx512f")]
    fn load(l: &[f32; LANES]) -> __m512 {
        _mm512_setr_ps(
            l[0], l[1], l[2], l[3], l[4], l[5], l[6], l[7], l[8], l[9], l[10], l[11], l[12], l[13],
            l[14], l[15],
        )
    }

    /// One store.
    #[inline]
    #[target_feature(enable = "avx512f")]
    fn store(sums: __m512, to: &mut [f32; LANES]) {
        let parts = [
            _mm512_extractf32x4_ps::<0>(sums),
            _mm512_extractf32x4_ps::<1>(sums),
            _mm512_extractf32x4_ps::<2>(sums),
            _mm512_extractf32x4_ps::<3>(sums),
        ];
        let bits = |bits: i32| f32::from_bits(bits.cast_unsigned());
        for (part, to) in parts.into_iter().zip(to.chunks_exact_mut(4)) {
            to[0] = _mm_cvtss_f32(part);
            to[1] = bits(_mm_extract_ps::<1>(part));
            to[2] = bits(_mm_extract_ps::<2>(part));
            to[3] = bits(_mm_extract_ps::<3>(part));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn totals_have_the_same_bits_on_every_instruction_set() {
        let mut sums = Sums::<f32>::new();
        for (k, sum) in sums.edges.as_flattened_mut().iter_mut().flat_map(|l| &mut l.0).enumerate()
        {
            *sum = ((k * 2_654_435_761) % 10_007) as f32 * 1e-3 - 5.0;
        }
        let (a, b) = (totals(&sums.edges), totals_single(&sums.edges));
        for k in 0..3 {
            for s in 0..4 {
                for lane in 0..LANES {
                    assert_eq!(a[k][s][lane].to_bits(), b[k][s][lane].to_bits());
                    let exact: f64 =
                        sums.edges[LANES * k + lane][s].iter().map(|&x| f64::from(x)).sum();
                    assert!((f64::from(a[k][s][lane]) - exact).abs() < 1e-4);
                }
            }
        }
    }
}
