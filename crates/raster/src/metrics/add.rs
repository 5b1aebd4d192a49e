//! ADD, the mean distance of corresponding model points (Hinterstoisser et al., ACCV 2012).

use super::motion::{Motion, Screw};
use super::vertices::{Block, CountedBlock, LANES, VertexSet};
use crate::pose::Pose;

/// Mean over all model points of `|(R_est p + t_est) - (R_gt p + t_gt)|`, in metres.
///
/// Exact to about 1e-15 of itself, exactly 0 for equal poses, and without NaN for finite poses; a
/// distance that no `f64` can hold is infinite.
#[must_use]
pub fn add(set: &VertexSet, est: &Pose, gt: &Pose) -> f64 {
    match Motion::between(set, est, gt) {
        Motion::Far(distance) => distance,
        Motion::Near(moved) => moved.screw(set.extent).map_or(0.0, |screw| {
            let [sum] = sums(set, [screw]);
            mean(set, &screw, sum)
        }),
    }
}

/// ADD of two pairs `(est, gt)` at once, each bit for bit what [`add`] gives.
pub(crate) fn add_two(set: &VertexSet, pairs: [(&Pose, &Pose); 2]) -> [f64; 2] {
    let screw = |(est, gt)| match Motion::between(set, est, gt) {
        Motion::Far(_) => None,
        Motion::Near(moved) => moved.screw(set.extent),
    };
    if let (Some(first), Some(second)) = (screw(pairs[0]), screw(pairs[1])) {
        let [a, b] = sums(set, [first, second]);
        [mean(set, &first, a), mean(set, &second, b)]
    } else {
        pairs.map(|(est, gt)| add(set, est, gt))
    }
}

/// Bounds `(low, high)` of ADD in metres, without touching a point: the displacement of the mean
/// point, and the root of the mean squared displacement (from the covariance of the points).
/// They are wide enough that `low <= add(..) <= high` holds for the rounded value too.
#[must_use]
pub fn add_bounds(set: &VertexSet, est: &Pose, gt: &Pose) -> (f64, f64) {
    match Motion::between(set, est, gt) {
        Motion::Far(distance) => (distance, distance),
        Motion::Near(moved) => {
            let (low, high) = moved.bounds(set);
            (low * set.unit, high * set.unit)
        }
    }
}

/// Whether `add(..) < threshold` (metres, strict), decided by the bounds where they suffice.
#[must_use]
pub fn add_below(set: &VertexSet, est: &Pose, gt: &Pose, threshold: f64) -> bool {
    let (low, high) = add_bounds(set, est, gt);
    if low >= threshold {
        return false;
    }
    high < threshold || add(set, est, gt) < threshold
}

fn mean(set: &VertexSet, screw: &Screw, sum: f64) -> f64 {
    sum / set.total() as f64 * screw.scale * set.unit
}

/// Added to every square: 1e-18 of the largest displacement where a point does not move at all,
/// nothing anywhere else; it keeps reciprocals finite and single precision normal.
const FLOOR: f64 = 7.523_163_845_262_64e-37; // 2^-120

/// Sums over all points of `sqrt(s)` for each motion.
fn sums<const P: usize>(set: &VertexSet, mut screws: [Screw; P]) -> [f64; P] {
    for screw in &mut screws {
        screw.w2 += FLOOR;
    }
    let mut total = [0.0; P];
    for run in &set.runs {
        let sum = whole_sums(&run.blocks, &screws);
        for (t, s) in total.iter_mut().zip(sum) {
            *t += s * run.count;
        }
    }
    let rest = counted_sums(&set.rest, &screws);
    for (t, s) in total.iter_mut().zip(rest) {
        *t += s;
    }
    total
}

// A build for one processor that has AVX-512 leaves out the attributes that make those safe to call.
#[cfg(all(target_arch = "x86_64", not(target_feature = "avx512f")))]
use self::avx512 as wide;

/// The loops for 16 numbers at once, where the whole build may use them.
#[cfg(all(target_arch = "x86_64", target_feature = "avx512f"))]
mod wide {
    use super::{Block, CountedBlock, Screw, plain, plain_counted};

    #[inline(always)]
    pub(super) fn whole_sums<const P: usize>(blocks: &[Block], screws: &[Screw; P]) -> [f64; P] {
        plain::<P, true, true>(blocks, screws)
    }

    #[inline(always)]
    pub(super) fn counted_sums<const P: usize>(
        blocks: &[CountedBlock],
        screws: &[Screw; P],
    ) -> [f64; P] {
        plain_counted::<P, true>(blocks, screws)
    }
}

/// Sum of `sqrt(s)` over whole blocks.
#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512vl+avx512dq+avx512bw+avx2+fma",
    "x86_64+avx2+fma"
))]
fn whole_sums<const P: usize>(blocks: &[Block], screws: &[Screw; P]) -> [f64; P] {
    multiversion::target::match_target! {
        "x86_64+avx512f" => wide::whole_sums(blocks, screws),
        "x86_64+avx2+fma" => plain::<P, true, true>(blocks, screws),
        _ => plain::<P, { crate::FUSED }, false>(blocks, screws),
    }
}

/// Sum of `count * sqrt(s)` over counted blocks.
#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512vl+avx512dq+avx512bw+avx2+fma",
    "x86_64+avx2+fma"
))]
fn counted_sums<const P: usize>(blocks: &[CountedBlock], screws: &[Screw; P]) -> [f64; P] {
    multiversion::target::match_target! {
        "x86_64+avx512f" => wide::counted_sums(blocks, screws),
        "x86_64+avx2+fma" => plain_counted::<P, true>(blocks, screws),
        _ => plain_counted::<P, { crate::FUSED }>(blocks, screws),
    }
}

/// `a * b + c`.
#[inline(always)]
pub(crate) fn mul_add<const FMA: bool>(a: f64, b: f64, c: f64) -> f64 {
    if FMA { a.mul_add(b, c) } else { a * b + c }
}

/// The square of a displacement in the screw form.
#[inline(always)]
pub(crate) fn squared<const FMA: bool>(k: &Screw, x: f64, y: f64, z: f64) -> f64 {
    let a = mul_add::<FMA>(k.u[0], y, mul_add::<FMA>(k.u[1], z, k.u[2]));
    let b = mul_add::<FMA>(k.v[1], y, mul_add::<FMA>(k.v[2], z, k.v[3]));
    let b = mul_add::<FMA>(k.v[0], x, b);
    mul_add::<FMA>(a, a, mul_add::<FMA>(b, b, k.w2))
}

/// `SINGLE` takes the root in single precision and corrects it by one Newton step in double, which
/// leaves a relative error of 2e-15.
#[inline(always)]
fn plain<const P: usize, const FMA: bool, const SINGLE: bool>(
    blocks: &[Block],
    screws: &[Screw; P],
) -> [f64; P] {
    let mut sum = [[0.0; LANES]; P];
    for b in blocks {
        for (sum, k) in sum.iter_mut().zip(screws) {
            for l in 0..LANES {
                let s = squared::<FMA>(k, b.x[l], b.y[l], b.z[l]);
                sum[l] += if SINGLE {
                    let root = (s as f32).sqrt();
                    let half = f64::from(0.5 / root);
                    let root = f64::from(root);
                    mul_add::<FMA>(mul_add::<FMA>(-root, root, s), half, root)
                } else {
                    s.sqrt()
                };
            }
        }
    }
    sum.map(|lanes| fold(&lanes))
}

#[inline(always)]
fn plain_counted<const P: usize, const FMA: bool>(
    blocks: &[CountedBlock],
    screws: &[Screw; P],
) -> [f64; P] {
    let mut sum = [[0.0; LANES]; P];
    for CountedBlock { points: b, count } in blocks {
        for (sum, k) in sum.iter_mut().zip(screws) {
            for l in 0..LANES {
                let root = squared::<FMA>(k, b.x[l], b.y[l], b.z[l]).sqrt();
                sum[l] = mul_add::<FMA>(root, count[l], sum[l]);
            }
        }
    }
    sum.map(|lanes| fold(&lanes))
}

/// Sum of the lanes in a fixed order.
#[inline(always)]
fn fold(lanes: &[f64; LANES]) -> f64 {
    let mut sum = *lanes;
    let mut half = LANES / 2;
    while half > 0 {
        for l in 0..half {
            sum[l] += sum[l + half];
        }
        half /= 2;
    }
    sum[0]
}

#[cfg(all(target_arch = "x86_64", not(target_feature = "avx512f")))]
mod avx512 {
    use std::arch::x86_64::{
        __m512d, _mm512_add_pd, _mm512_fmadd_pd, _mm512_fnmadd_pd, _mm512_mul_pd,
        _mm512_reduce_add_pd, _mm512_rsqrt14_pd, _mm512_set1_pd, _mm512_setr_pd, _mm512_setzero_pd,
    };

    use super::{Block, CountedBlock, LANES, Screw};

    /// Half a row of a block: one load.
    #[inline]
    #[target_feature(enable = "avx512f")]
    fn load(row: &[f64; LANES], at: usize) -> __m512d {
        let r = &row[at..at + 8];
        _mm512_setr_pd(r[0], r[1], r[2], r[3], r[4], r[5], r[6], r[7])
    }

    /// A motion in every lane.
    #[derive(Clone, Copy)]
    struct Wide {
        u: [__m512d; 3],
        v: [__m512d; 4],
        w2: __m512d,
    }

    #[inline]
    #[target_feature(enable = "avx512f")]
    fn widen(k: &Screw) -> Wide {
        Wide {
            u: k.u.map(|c| _mm512_set1_pd(c)),
            v: k.v.map(|c| _mm512_set1_pd(c)),
            w2: _mm512_set1_pd(k.w2),
        }
    }

    /// The length of a displacement as `(r, h)`, their product, without a division or a square
    /// root: the machine's reciprocal root `g` is good to 2^-14, so with `r = s g` and
    /// `e = 1 - r g` (below 1.3e-4) the root is `r (1 + e/2 + 3/8 e² + 5/16 e³)` to 1e-16.
    #[inline]
    #[target_feature(enable = "avx512f")]
    fn length(k: &Wide, [x, y, z]: [__m512d; 3]) -> (__m512d, __m512d) {
        let [one, half, c2, c3] = [1.0, 0.5, 0.375, 0.3125].map(|c| _mm512_set1_pd(c));
        let a = _mm512_fmadd_pd(k.u[0], y, _mm512_fmadd_pd(k.u[1], z, k.u[2]));
        let b = _mm512_fmadd_pd(k.v[1], y, _mm512_fmadd_pd(k.v[2], z, k.v[3]));
        let b = _mm512_fmadd_pd(k.v[0], x, b);
        let s = _mm512_fmadd_pd(a, a, _mm512_fmadd_pd(b, b, k.w2));
        let g = _mm512_rsqrt14_pd(s);
        let r = _mm512_mul_pd(s, g);
        let e = _mm512_fnmadd_pd(r, g, one);
        let q = _mm512_fmadd_pd(e, _mm512_fmadd_pd(e, c3, c2), half);
        (r, _mm512_fmadd_pd(e, q, one))
    }

    #[inline]
    #[target_feature(enable = "avx512f")]
    pub(super) fn whole_sums<const P: usize>(blocks: &[Block], screws: &[Screw; P]) -> [f64; P] {
        let wide: [Wide; P] = std::array::from_fn(|k| widen(&screws[k]));
        let mut sum = [[_mm512_setzero_pd(); 2]; P];
        for b in blocks {
            for h in 0..2 {
                let p = [load(&b.x, 8 * h), load(&b.y, 8 * h), load(&b.z, 8 * h)];
                for k in 0..P {
                    let (r, factor) = length(&wide[k], p);
                    sum[k][h] = _mm512_fmadd_pd(r, factor, sum[k][h]);
                }
            }
        }
        sum.map(|[a, b]| _mm512_reduce_add_pd(_mm512_add_pd(a, b)))
    }

    #[inline]
    #[target_feature(enable = "avx512f")]
    pub(super) fn counted_sums<const P: usize>(
        blocks: &[CountedBlock],
        screws: &[Screw; P],
    ) -> [f64; P] {
        let wide: [Wide; P] = std::array::from_fn(|k| widen(&screws[k]));
        let mut sum = [_mm512_setzero_pd(); P];
        for CountedBlock { points: b, count } in blocks {
            for h in 0..2 {
                let p = [load(&b.x, 8 * h), load(&b.y, 8 * h), load(&b.z, 8 * h)];
                let count = load(count, 8 * h);
                for k in 0..P {
                    let (r, factor) = length(&wide[k], p);
                    sum[k] = _mm512_fmadd_pd(_mm512_mul_pd(r, count), factor, sum[k]);
                }
            }
        }
        sum.map(|a| _mm512_reduce_add_pd(a))
    }
}

#[cfg(test)]
mod tests {
    use glam::{DQuat, DVec3};
    use proptest::prelude::*;

    use super::super::vertices::blocks;
    use super::*;
    use crate::metrics::oracle::{self, close};

    fn slow(points: &[DVec3], est: &Pose, gt: &Pose) -> f64 {
        let distance = |p: &DVec3| est.transform_point(*p).distance(gt.transform_point(*p));
        points.iter().map(distance).sum::<f64>() / points.len() as f64
    }

    proptest! {
        #[test]
        fn equals_the_plain_mean((points, est, gt) in oracle::scene()) {
            let set = VertexSet::new(&points).expect("points");
            let fast = add(&set, &est, &gt);
            // The plain form loses digits by cancellation: 1e-15 of the metres in the poses.
            prop_assert!(close(fast, slow(&points, &est, &gt), 2e-15), "{fast}");
            prop_assert_eq!(add(&set, &gt, &gt), 0.0);
            let two = add_two(&set, [(&est, &gt), (&gt, &est)]);
            prop_assert_eq!(two, [fast, add(&set, &gt, &est)]);
            prop_assert_eq!(add_two(&set, [(&gt, &gt), (&est, &gt)]), [0.0, fast]);
        }

        #[test]
        fn bounds_hold_and_decide_as_the_value((points, est, gt) in oracle::scene(), factor in 0.5..2.0_f64) {
            let set = VertexSet::new(&points).expect("points");
            let exact = add(&set, &est, &gt);
            let (low, high) = add_bounds(&set, &est, &gt);
            prop_assert!(low <= exact && exact <= high, "{low} {exact} {high}");
            for threshold in [exact, exact * factor, exact.next_up(), low, high, 0.0, f64::NAN] {
                prop_assert_eq!(add_below(&set, &est, &gt, threshold), exact < threshold);
            }
        }

        #[test]
        fn every_instruction_set_gives_the_same_mean((points, est, gt) in oracle::scene()) {
            let set = VertexSet::new(&points).expect("points");
            let Motion::Near(moved) = Motion::between(&set, &est, &gt) else { panic!("near") };
            let Some(mut screw) = moved.screw(set.extent) else { panic!("moves") };
            screw.w2 += FLOOR;
            let all = blocks(&points);
            let [fast] = whole_sums(&all, &[screw]);
            for other in [
                plain::<1, false, false>(&all, &[screw]),
                plain::<1, false, true>(&all, &[screw]),
                plain::<1, true, true>(&all, &[screw]),
            ] {
                prop_assert!((fast - other[0]).abs() <= 1e-13 * fast);
            }
        }

        #[test]
        fn tiny_and_huge_motions_keep_their_digits(
            (points, est, gt) in oracle::scene(), exponent in -300..300_i32,
        ) {
            let set = VertexSet::new(&points).expect("points");
            let shift = est.translation - gt.translation;
            let scale = 10.0_f64.powi(exponent);
            // Pure translation from the origin, so that nothing rounds the shift itself.
            let gt = Pose::new(gt.rotation, DVec3::ZERO);
            let moved = Pose::new(gt.rotation, shift * scale);
            let expected = shift.length() * scale;
            prop_assert!(close(add(&set, &moved, &gt), expected, 0.0));
            // The whole scene grown or shrunk.
            let grown: Vec<DVec3> = points.iter().map(|p| *p * scale).collect();
            let large = VertexSet::new(&grown).expect("points");
            let at = |pose: &Pose| Pose { translation: pose.translation * scale, ..*pose };
            let (e, g) = (at(&est), at(&gt));
            let expected = add(&set, &est, &gt) * scale;
            prop_assert!(close(add(&large, &e, &g), expected, 1e-15 * scale));
            let (low, high) = add_bounds(&large, &e, &g);
            let value = add(&large, &e, &g);
            prop_assert!(low <= value && value <= high);
        }
    }

    #[test]
    fn extreme_numbers_make_no_nan() {
        let all = [0.0, 5e-324, 1e-300, 1e-200, 1.0, 1e200, f64::MAX];
        for a in all {
            let points = [DVec3::new(a, 0.0, -a), DVec3::new(-a, a / 3.0, 0.0), DVec3::ZERO];
            let set = VertexSet::new(&points).expect("points");
            for t in all {
                for angle in all {
                    let turn = DQuat::from_xyzw(angle.min(0.6), 0.0, 0.0, 0.8).normalize();
                    let est = Pose::new(turn, DVec3::new(t, -t, t / 7.0));
                    let gt = Pose::new(DQuat::IDENTITY, DVec3::new(-t, 0.0, 0.0));
                    let value = add(&set, &est, &gt);
                    let (low, high) = add_bounds(&set, &est, &gt);
                    assert!(low <= value && value <= high, "{a} {t} {angle}: {low} {value} {high}");
                    assert!(value >= 0.0, "{a} {t} {angle}: {value}");
                }
            }
        }
    }

    #[test]
    fn a_tiny_turn_has_its_first_order_error() {
        let set = VertexSet::new(&[DVec3::X, -DVec3::X]).expect("points");
        let gt = Pose::IDENTITY;
        for half in [1e-300, 1e-170, 1e-100, 1e-20, 1e-9] {
            let est = Pose::new(DQuat::from_xyzw(0.0, half, 0.0, 1.0), DVec3::ZERO);
            assert!((add(&set, &est, &gt) / (2.0 * half) - 1.0).abs() < 1e-14, "{half}");
        }
    }

    #[test]
    fn points_on_the_axis_do_not_move() {
        let set = VertexSet::new(&[DVec3::Z, -DVec3::Z, DVec3::Z * 0.5]).expect("points");
        let est = Pose::new(DQuat::from_xyzw(0.0, 0.0, 0.6, 0.8), DVec3::ZERO);
        assert!(add(&set, &est, &Pose::IDENTITY) < 1e-15);
    }

    #[test]
    #[ignore = "a measurement; for the release build"]
    #[expect(clippy::print_stdout, reason = "a measurement")]
    fn time_of_each_instruction_set() {
        #[multiversion::multiversion(targets("x86_64+avx2+fma"))]
        fn avx2(blocks: &[Block], screw: &Screw) -> f64 {
            multiversion::target::match_target! {
                "x86_64+avx2+fma" => plain::<1, true, true>(blocks, &[*screw])[0],
                _ => plain::<1, { crate::FUSED }, false>(blocks, &[*screw])[0],
            }
        }
        fn time(work: impl Fn() -> f64) -> f64 {
            let runs = (0..200).map(|_| {
                let start = std::time::Instant::now();
                for _ in 0..50 {
                    std::hint::black_box(work());
                }
                start.elapsed().as_secs_f64() / 50.0
            });
            runs.fold(f64::INFINITY, f64::min) * 1e6
        }
        let points: Vec<DVec3> = (0..2612)
            .map(|k| DVec3::new(0.37, 0.71, 1.3) * f64::from(k))
            .map(|p| DVec3::new(p.x.sin(), p.y.sin(), p.z.sin()) * 0.3)
            .collect();
        let all = blocks(&points);
        let screw = Screw { u: [0.1, 0.2, 0.03], v: [0.1, 0.2, 0.1, 0.01], w2: 1e-4, scale: 1.0 };
        let best = time(|| whole_sums(&all, &[screw])[0]);
        let two = time(|| whole_sums(&all, &[screw; 2])[0]) / 2.0;
        let avx2 = time(|| avx2(&all, &screw));
        let base = time(|| plain::<1, { crate::FUSED }, false>(&all, &[screw])[0]);
        println!("us a pose: best {best}, in pairs {two}, AVX2 {avx2}, baseline {base}");
        assert!(best <= base && two <= base);
    }
}
