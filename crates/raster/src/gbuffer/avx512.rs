//! The inner loop of a band with the masks of AVX-512: about half the time of the plain loop.

use super::setup::{Record, Sides};
use std::arch::x86_64::{
    __m128i, __m256d, __m256i, __m512d, _CMP_GE_OQ, _CMP_GT_OQ, _CMP_LT_OQ, _mm_cvtsd_f64,
    _mm_extract_epi32, _mm_setr_epi32, _mm_unpackhi_pd, _mm256_castpd256_pd128,
    _mm256_castsi256_si128, _mm256_extractf128_pd, _mm256_extracti128_si256, _mm256_mask_mov_epi32,
    _mm256_set_m128i, _mm256_set1_epi32, _mm256_setr_pd, _mm512_add_pd, _mm512_castpd256_pd512,
    _mm512_castpd512_pd256, _mm512_cmp_pd_mask, _mm512_extractf64x4_pd, _mm512_insertf64x4,
    _mm512_mask_cmp_pd_mask, _mm512_mask_mov_pd, _mm512_max_pd, _mm512_min_pd, _mm512_mul_pd,
    _mm512_set1_pd, _mm512_setr_pd, _mm512_sub_pd,
};

/// Draw the rows of a record into planes that begin at its first row and column, bit for bit as the
/// plain loop does: eight samples of a row a step, or four of two rows. The planes have a row more
/// than there is to draw.
#[inline]
#[target_feature(enable = "avx512f,avx512vl")]
pub(super) fn draw(
    record: &Record,
    rows: [i32; 2],
    stride: usize,
    planes: (&mut [f64], &mut [u32]),
) {
    if record.columns[1] - record.columns[0] <= 4 {
        draw_narrow(record, rows, stride, planes);
    } else {
        draw_wide(record, rows, stride, planes);
    }
}

/// Up to four columns.
#[inline]
#[target_feature(enable = "avx512f,avx512vl")]
fn draw_narrow(
    record: &Record,
    [first, end]: [i32; 2],
    stride: usize,
    (nearness, ids): (&mut [f64], &mut [u32]),
) {
    let [left, right] = record.columns;
    let all = |x: f64| _mm512_set1_pd(x);
    let (low, high) = (all(record.range[0]), all(record.range[1]));
    let id = _mm256_set1_epi32(record.id.cast_signed());
    let columns = _mm512_setr_pd(0.5, 1.5, 2.5, 3.5, 0.5, 1.5, 2.5, 3.5);
    let rows = _mm512_setr_pd(0.5, 0.5, 0.5, 0.5, 1.5, 1.5, 1.5, 1.5);
    let x = _mm512_add_pd(all(f64::from(left)), columns);
    let within = _mm512_cmp_pd_mask::<_CMP_LT_OQ>(x, all(f64::from(right)));
    let x0 = _mm512_sub_pd(x, all(record.u[0]));
    let x1 = _mm512_sub_pd(x, all(record.u[1]));
    let a = _mm512_mul_pd(all(record.dv[0]), x0);
    let b = _mm512_mul_pd(all(record.dv[1]), x0);
    let c = _mm512_mul_pd(all(record.dv[2]), x1);
    let base = _mm512_add_pd(all(record.nearness[0]), _mm512_mul_pd(all(record.nearness[1]), x0));
    let mut start = 0;
    let mut row = first;
    while row < end {
        let y = _mm512_add_pd(all(f64::from(row)), rows);
        let y0 = _mm512_sub_pd(y, all(record.v[0]));
        let y1 = _mm512_sub_pd(y, all(record.v[1]));
        let w = _mm512_add_pd(base, _mm512_mul_pd(all(record.nearness[2]), y0));
        let w = _mm512_min_pd(_mm512_max_pd(w, low), high);
        let Some((upper, lower)) = two(nearness, start, stride) else { return };
        let Some((upper_ids, lower_ids)) = two(ids, start, stride) else { return };
        let old = load(upper, lower);
        let seen = _mm512_mask_cmp_pd_mask::<_CMP_LT_OQ>(within, y, all(f64::from(end)));
        let side = |du: f64, y| _mm512_mul_pd(all(du), y);
        let seen = _mm512_mask_cmp_pd_mask::<_CMP_GE_OQ>(seen, side(record.du[0], y0), a);
        let seen = _mm512_mask_cmp_pd_mask::<_CMP_GE_OQ>(seen, side(record.du[1], y0), b);
        let seen = _mm512_mask_cmp_pd_mask::<_CMP_GE_OQ>(seen, side(record.du[2], y1), c);
        let seen = _mm512_mask_cmp_pd_mask::<_CMP_GT_OQ>(seen, w, old);
        store(_mm512_mask_mov_pd(old, seen, w), upper, lower);
        let old_ids = load_ids(upper_ids, lower_ids);
        store_ids(_mm256_mask_mov_epi32(old_ids, seen, id), upper_ids, lower_ids);
        start += 2 * stride;
        row += 2;
    }
}

/// Four samples, and four that begin `step` further on.
#[inline]
fn two<T>(plane: &mut [T], start: usize, step: usize) -> Option<(&mut [T; 4], &mut [T; 4])> {
    let (upper, lower) = plane.get_mut(start..)?.split_at_mut_checked(step)?;
    Some((upper.first_chunk_mut()?, lower.first_chunk_mut()?))
}

#[inline]
#[target_feature(enable = "avx512f,avx512vl")]
fn load_four(r: &[f64; 4]) -> __m256d {
    _mm256_setr_pd(r[0], r[1], r[2], r[3])
}

#[inline]
#[target_feature(enable = "avx512f,avx512vl")]
fn store_four(w: __m256d, out: &mut [f64; 4]) {
    let pairs = [_mm256_castpd256_pd128(w), _mm256_extractf128_pd::<1>(w)];
    *out = [
        _mm_cvtsd_f64(pairs[0]),
        _mm_cvtsd_f64(_mm_unpackhi_pd(pairs[0], pairs[0])),
        _mm_cvtsd_f64(pairs[1]),
        _mm_cvtsd_f64(_mm_unpackhi_pd(pairs[1], pairs[1])),
    ];
}

#[inline]
#[target_feature(enable = "avx512f,avx512vl")]
fn load_four_ids(r: &[u32; 4]) -> __m128i {
    let r = r.map(u32::cast_signed);
    _mm_setr_epi32(r[0], r[1], r[2], r[3])
}

#[inline]
#[target_feature(enable = "avx512f,avx512vl")]
fn store_four_ids(w: __m128i, out: &mut [u32; 4]) {
    *out = [
        _mm_extract_epi32::<0>(w),
        _mm_extract_epi32::<1>(w),
        _mm_extract_epi32::<2>(w),
        _mm_extract_epi32::<3>(w),
    ]
    .map(i32::cast_unsigned);
}

#[inline]
#[target_feature(enable = "avx512f,avx512vl")]
fn load(first: &[f64; 4], second: &[f64; 4]) -> __m512d {
    _mm512_insertf64x4::<1>(_mm512_castpd256_pd512(load_four(first)), load_four(second))
}

#[inline]
#[target_feature(enable = "avx512f,avx512vl")]
fn store(w: __m512d, first: &mut [f64; 4], second: &mut [f64; 4]) {
    store_four(_mm512_castpd512_pd256(w), first);
    store_four(_mm512_extractf64x4_pd::<1>(w), second);
}

#[inline]
#[target_feature(enable = "avx512f,avx512vl")]
fn load_ids(first: &[u32; 4], second: &[u32; 4]) -> __m256i {
    _mm256_set_m128i(load_four_ids(second), load_four_ids(first))
}

#[inline]
#[target_feature(enable = "avx512f,avx512vl")]
fn store_ids(w: __m256i, first: &mut [u32; 4], second: &mut [u32; 4]) {
    store_four_ids(_mm256_castsi256_si128(w), first);
    store_four_ids(_mm256_extracti128_si256::<1>(w), second);
}

/// Eight columns a step.
#[inline]
#[target_feature(enable = "avx512f,avx512vl")]
fn draw_wide(
    record: &Record,
    [first, end]: [i32; 2],
    stride: usize,
    (nearness, ids): (&mut [f64], &mut [u32]),
) {
    let [left, right] = record.columns;
    let all = |x: f64| _mm512_set1_pd(x);
    let (low, high) = (all(record.range[0]), all(record.range[1]));
    let id = _mm256_set1_epi32(record.id.cast_signed());
    let lanes = _mm512_setr_pd(0.5, 1.5, 2.5, 3.5, 4.5, 5.5, 6.5, 7.5);
    let mut column = left;
    while column < right {
        let x = _mm512_add_pd(all(f64::from(column)), lanes);
        let inside = _mm512_cmp_pd_mask::<_CMP_LT_OQ>(x, all(f64::from(right)));
        let x0 = _mm512_sub_pd(x, all(record.u[0]));
        let x1 = _mm512_sub_pd(x, all(record.u[1]));
        let a = _mm512_mul_pd(all(record.dv[0]), x0);
        let b = _mm512_mul_pd(all(record.dv[1]), x0);
        let c = _mm512_mul_pd(all(record.dv[2]), x1);
        let base =
            _mm512_add_pd(all(record.nearness[0]), _mm512_mul_pd(all(record.nearness[1]), x0));
        let mut start = (column - left) as usize;
        for row in first..end {
            let Sides(side) = record.row(f64::from(row) + 0.5);
            let w = _mm512_add_pd(base, all(side[3]));
            let w = _mm512_min_pd(_mm512_max_pd(w, low), high);
            // Rows have room for the lanes beyond their last column.
            let Some((near, far)) = two(nearness, start, 4) else { return };
            let Some((near_ids, far_ids)) = two(ids, start, 4) else { return };
            let old = load(near, far);
            let seen = _mm512_mask_cmp_pd_mask::<_CMP_GE_OQ>(inside, all(side[0]), a);
            let seen = _mm512_mask_cmp_pd_mask::<_CMP_GE_OQ>(seen, all(side[1]), b);
            let seen = _mm512_mask_cmp_pd_mask::<_CMP_GE_OQ>(seen, all(side[2]), c);
            let seen = _mm512_mask_cmp_pd_mask::<_CMP_GT_OQ>(seen, w, old);
            store(_mm512_mask_mov_pd(old, seen, w), near, far);
            let old_ids = load_ids(near_ids, far_ids);
            store_ids(_mm256_mask_mov_epi32(old_ids, seen, id), near_ids, far_ids);
            start += stride;
        }
        column += 8;
    }
}
