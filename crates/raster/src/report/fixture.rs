//! Made-up evaluations for the tests of the reports: a few hundred deterministic samples.

use std::collections::BTreeMap;

use crate::eval::{
    Auc, Authors, Bop, Breakdown, Comparison, Difference, Evaluation, Group, InputFile, Inputs,
    Intervals, Metrics, Recall, ReferenceRecall, SCHEMA, Samples, Settings, Speed, SpeedPlus,
    Summary, WorstSample,
};
use crate::report::{Method, Report};

const REFERENCE: f64 = 0.608_931_015_7;

/// An evaluation with the samples behind it.
#[derive(Debug)]
pub(crate) struct Fixture {
    pub(crate) evaluation: Evaluation,
    pub(crate) samples: Vec<Samples>,
}

impl Fixture {
    /// Two methods, a mesh, intervals, breakdowns, hostile names: everything at once.
    pub(crate) fn pair() -> Self {
        Self::pair_of(430, 500)
    }

    /// As [`Fixture::pair`], with as many samples as asked for.
    pub(crate) fn pair_of(n: usize, n_gt: usize) -> Self {
        let samples = vec![samples(n, 1.0, 7), samples(n - 4, 1.25, 8)];
        let mut e = evaluation("gauss_0.1|<b>&.csv", &samples[0], n_gt, true);
        let m = metrics(&samples[1], n_gt, true);
        let difference = ["npe", "oe_rad", "oe_deg", "te_m", "cpe", "add_m"]
            .iter()
            .enumerate()
            .map(|(i, key)| {
                let mean = 0.01 - 0.004 * i as f64;
                let ci95 = Some([mean - 0.003, mean + 0.003]);
                let p = Some(0.0004 * (i as f64 * 2.0).exp()).filter(|p| *p <= 1.0);
                ((*key).to_owned(), Difference { mean, ci95, p, n: n - 4 })
            })
            .collect();
        e.compare.push(Comparison {
            name: "direct_baseline_with_a_long_name.csv".into(),
            input: file("runs/direct_baseline_with_a_long_name.csv", "csv"),
            n_predictions: n - 4,
            n_matched: n - 4,
            ci95: Some(intervals(&m)),
            metrics: m,
            difference,
            warnings: vec!["4 samples have no prediction".into()],
        });
        e.authors = Some(Authors {
            batch_size: 64,
            n_batches: 7,
            npe: 0.0171,
            oe_rad: 0.0612,
            cpe: 0.0783,
            acc: [("5".into(), 89.1), ("10".into(), 98.2)].into(),
            add_recall: [("5".into(), 56.0), ("10".into(), 91.0)].into(),
        });
        Self { evaluation: e, samples }
    }

    /// One method without extras.
    pub(crate) fn single() -> Self {
        let samples = vec![samples(300, 1.0, 3)];
        let mut e = evaluation("efficientnet.csv", &samples[0], 300, true);
        e.ci95 = None;
        Self { evaluation: e, samples }
    }

    /// All errors are zero.
    pub(crate) fn perfect() -> Self {
        let samples = vec![samples(100, 0.0, 3)];
        let e = evaluation("gt.csv", &samples[0], 100, true);
        Self { evaluation: e, samples }
    }

    /// One sample.
    pub(crate) fn one() -> Self {
        let samples = vec![samples(1, 1.0, 3)];
        let e = evaluation("one.csv", &samples[0], 1, true);
        Self { evaluation: e, samples }
    }

    /// No prediction matches.
    pub(crate) fn empty() -> Self {
        let samples = vec![samples(0, 1.0, 3)];
        let e = evaluation("empty.csv", &samples[0], 20, true);
        Self { evaluation: e, samples }
    }

    /// No mesh, hence no vertex metrics.
    pub(crate) fn no_mesh() -> Self {
        let mut s = samples(200, 1.0, 5);
        s.add_m = None;
        s.adds_m = None;
        s.mssd_m = None;
        s.mspd_px = None;
        s.proj_px = None;
        let samples = vec![s];
        let e = evaluation("poses.csv", &samples[0], 200, false);
        Self { evaluation: e, samples }
    }

    /// Every case, for what must hold always.
    pub(crate) fn all() -> Vec<Self> {
        vec![
            Self::pair(),
            Self::single(),
            Self::perfect(),
            Self::one(),
            Self::empty(),
            Self::no_mesh(),
        ]
    }

    /// What the reports take.
    pub(crate) fn report(&self) -> Report<'_> {
        let e = &self.evaluation;
        let names = std::iter::once(e.name.as_str()).chain(e.compare.iter().map(|c| &*c.name));
        let methods = names
            .zip(&self.samples)
            .map(|(name, samples)| Method { name, samples, n_gt: e.n_gt })
            .collect();
        Report { evaluation: e, methods }
    }
}

/// Uniform numbers in [0, 1) from a seed.
fn uniform(seed: u64) -> impl FnMut() -> f64 {
    let mut state = seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1;
    move || {
        state =
            state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 11) as f64 / (1_u64 << 53) as f64
    }
}

fn samples(n: usize, scale: f64, seed: u64) -> Samples {
    let mut u = uniform(seed);
    let mut s = Samples::default();
    let (mut add, mut adds, mut mssd, mut proj) = (vec![], vec![], vec![], vec![]);
    for i in 0..n {
        let distance = 1.0 + 4.0 * u();
        let tail = if u() < 0.03 { 12.0 } else { 1.0 };
        let te = scale * 0.006 * distance * tail * -(1.0 - u()).ln();
        let oe = scale * 0.03 * tail * (-(1.0 - u()).ln() - (1.0 - u()).ln());
        s.gt_row.push(i as u32);
        s.pred_row.push(i as u32);
        s.te_m.push(te);
        s.npe.push(te / distance);
        s.oe_rad.push(oe.min(3.1));
        s.distance_m.push(distance);
        s.azimuth_deg.push(360.0 * u() - 180.0);
        s.elevation_deg.push(70.0 * u() * u() - 20.0);
        add.push(0.15 * oe + te);
        adds.push(0.06 * oe + 0.5 * te);
        mssd.push(0.3 * oe + te);
        proj.push(if scale > 0.0 && i % 97 == 5 { f64::INFINITY } else { 90.0 * oe + te });
    }
    s.add_m = Some(add);
    s.adds_m = Some(adds);
    s.mssd_m = Some(mssd);
    s.mspd_px = Some(proj.iter().map(|x| 2.0 * x).collect());
    s.proj_px = Some(proj);
    s
}

fn summary(values: &[f64]) -> Option<Summary> {
    let mut v: Vec<f64> = values.iter().copied().filter(|x| x.is_finite()).collect();
    v.sort_by(f64::total_cmp);
    let n = v.len();
    if n == 0 {
        return None;
    }
    let mean = v.iter().sum::<f64>() / n as f64;
    let at = |q: f64| v[((n - 1) as f64 * q).round() as usize];
    let moment = |f: &dyn Fn(f64) -> f64| (v.iter().map(|x| f(*x)).sum::<f64>() / n as f64).sqrt();
    Some(Summary {
        mean,
        median: at(0.5),
        std: moment(&|x| (x - mean).powi(2)),
        min: v[0],
        max: v[n - 1],
        p90: at(0.9),
        p95: at(0.95),
        rmse: moment(&|x| x * x),
        n_undefined: values.len() - n,
    })
}

fn recall(passed: impl Iterator<Item = bool>, n_gt: usize) -> Recall {
    let (mut n, mut count) = (0, 0);
    for p in passed {
        n += 1;
        count += usize::from(p);
    }
    Recall {
        count,
        percent_of_gt: 100.0 * count as f64 / n_gt as f64,
        percent_of_matched: (n > 0).then(|| 100.0 * count as f64 / f64::from(n)),
    }
}

fn metrics(s: &Samples, n_gt: usize, mesh: bool) -> Metrics {
    let cpe: Vec<f64> = (0..s.len()).map(|i| s.cpe(i)).collect();
    let deg: Vec<f64> = s.oe_rad.iter().map(|x| x.to_degrees()).collect();
    let column = |c: &Option<Vec<f64>>| c.as_deref().and_then(summary);
    let acc = [2.0, 5.0, 10.0].map(|x| {
        let pass = (0..s.len()).map(|i| deg[i] < x && s.te_m[i] * 100.0 < x);
        (format!("{x}"), recall(pass, n_gt))
    });
    let recalls = |c: &Option<Vec<f64>>, ks: &[f64]| {
        let c = c.as_ref().filter(|_| mesh)?;
        let at = ks
            .iter()
            .map(|k| (format!("{k}"), recall(c.iter().map(|e| *e < k / 100.0 * REFERENCE), n_gt)));
        Some(ReferenceRecall {
            reference: "bbox-diagonal".into(),
            reference_m: Some(REFERENCE),
            reference_m_by_object: BTreeMap::new(),
            at: at.collect(),
        })
    };
    let score = summary(&cpe).map(|s| s.mean);
    let area = |c: &Option<Vec<f64>>| {
        let sum: f64 = c.as_ref()?.iter().map(|e| (1.0 - e / 0.1).max(0.0)).sum();
        Some(Auc { exact: sum / n_gt as f64, ycb: sum / n_gt as f64 + 1e-3 })
    };
    Metrics {
        npe: summary(&s.npe),
        oe_rad: summary(&s.oe_rad),
        oe_deg: summary(&deg),
        te_m: summary(&s.te_m),
        cpe: summary(&cpe),
        oe_sym_deg: None,
        add_m: column(&s.add_m),
        adds_m: column(&s.adds_m),
        mssd_m: column(&s.mssd_m),
        mspd_px: column(&s.mspd_px),
        proj_px: column(&s.proj_px),
        acc: acc.into(),
        add_recall: recalls(&s.add_m, &[2.0, 5.0, 10.0]),
        adds_recall: recalls(&s.adds_m, &[5.0, 10.0]),
        add_auc: area(&s.add_m),
        adds_auc: area(&s.adds_m),
        proj_recall_5px: s.proj_px.as_ref().map(|c| recall(c.iter().map(|e| *e < 5.0), n_gt)),
        speedplus: score.map(|score| SpeedPlus {
            score,
            e_t: score * 0.2,
            e_q_rad: score * 0.8,
            zeroed_t: 12,
            zeroed_q: 3,
        }),
        speed: score.map(|score| Speed { score }),
        bop: mesh.then_some(Bop { ar_mssd: Some(0.8123), ar_mspd: Some(0.7456) }),
    }
}

fn intervals(m: &Metrics) -> Intervals {
    let around = |x: f64| [0.93 * x, 1.08 * x];
    let percent = |x: f64| [(x - 2.5).max(0.0), (x + 2.1).min(100.0)];
    let recalls = |r: &BTreeMap<String, Recall>| {
        r.iter().map(|(k, r)| (k.clone(), percent(r.percent_of_gt))).collect()
    };
    let mean = [("npe", m.npe), ("oe_rad", m.oe_rad), ("cpe", m.cpe), ("add_m", m.add_m)];
    let mean = mean.into_iter().filter_map(|(k, s)| Some((k.to_owned(), around(s?.mean))));
    Intervals {
        method: "percentile bootstrap",
        resamples: 10_000,
        seed: 0,
        mean: mean.collect(),
        acc: recalls(&m.acc),
        add_recall: m.add_recall.as_ref().map(|r| recalls(&r.at)).unwrap_or_default(),
        adds_recall: m.adds_recall.as_ref().map(|r| recalls(&r.at)).unwrap_or_default(),
    }
}

fn file(path: &str, format: &str) -> InputFile {
    let sha256 = "9f86d081884c7d659a2feaa0c55ad015a3bf4f1b2b0b822cd15d6c15b0f00a08".into();
    InputFile { path: path.into(), format: format.into(), sha256, bytes: 48_231 }
}

fn breakdown(s: &Samples, m: &Metrics) -> Breakdown {
    let groups = [(1.0, 2.0), (2.0, 3.0), (3.0, 4.0), (4.0, 5.0)].map(|(from, to)| {
        let within = s.distance_m.iter().filter(|d| **d >= from && **d < to).count();
        let some = |x: f64| (within > 0).then_some(x * from.sqrt());
        Group {
            label: format!("{from} to {to}"),
            from: Some(from),
            to: Some(to),
            n_gt: within + 5,
            n_matched: within,
            npe: some(0.0131),
            oe_deg: some(2.9),
            te_m: some(0.0213),
            cpe: some(0.0651),
            add_m: m.add_m.and_then(|a| some(a.mean)),
            acc: [("2".into(), 40.1), ("5".into(), 91.2), ("10".into(), 98.0)].into(),
            add_recall: m
                .add_m
                .map(|_| [("5".into(), 57.0), ("10".into(), 91.0)].into())
                .unwrap_or_default(),
        }
    });
    Breakdown { column: "distance".into(), unit: "m".into(), groups: groups.into() }
}

fn evaluation(name: &str, s: &Samples, n_gt: usize, mesh: bool) -> Evaluation {
    let metrics = metrics(s, n_gt, mesh);
    let mut order: Vec<usize> = (0..s.len()).collect();
    order.sort_by(|a, b| s.cpe(*b).total_cmp(&s.cpe(*a)));
    let worst = order.iter().take(10).map(|&i| WorstSample {
        id: format!("<script>alert({i})</script>&_%|{i}\u{1b}[31m"),
        line: Some(i as u64 + 2),
        cpe: s.cpe(i),
        npe: s.npe[i],
        oe_deg: s.oe_rad[i].to_degrees(),
        te_m: s.te_m[i],
        add_m: s.add_m.as_ref().map(|c| c[i]),
        distance_m: s.distance_m[i],
    });
    let light = Breakdown {
        column: "light_<i>".into(),
        unit: String::new(),
        groups: breakdown(s, &metrics)
            .groups
            .into_iter()
            .take(2)
            .map(|g| Group { label: format!("a|b & {}", g.label), from: None, to: None, ..g })
            .collect(),
    };
    Evaluation {
        notes: Vec::new(),
        schema: SCHEMA,
        version: "0.1.0",
        name: name.into(),
        n_gt,
        n_predictions: s.len(),
        n_matched: s.len(),
        ci95: metrics.npe.map(|_| intervals(&metrics)),
        authors: None,
        by: vec![breakdown(s, &metrics), light],
        worst: worst.collect(),
        compare: vec![],
        inputs: Inputs {
            predictions: file(&format!("runs/{name}"), "csv"),
            gt: file("data/test_gt.csv", "csv"),
            mesh: if mesh { vec![file("data/DJI.obj", "obj")] } else { vec![] },
            symmetries: None,
            camera: None,
        },
        settings: Settings {
            preset: "paper".into(),
            unit_predictions: "m".into(),
            unit_gt: "m".into(),
            mesh_unit: "m".into(),
            acc: vec![2.0, 5.0, 10.0],
            add: vec![2.0, 5.0, 10.0],
            add_reference: "bbox-diagonal".into(),
            camera: mesh.then(|| "240.9,240.9,160,120,320,240".into()),
            n_symmetries: 1,
            up: "z".into(),
            bootstrap: 10_000,
            seed: 0,
            strict: false,
        },
        warnings: if s.len() < n_gt {
            vec![format!(
                "{} of {n_gt} poses have no prediction & count as <wrong>",
                n_gt - s.len()
            )]
        } else {
            vec![]
        },
        metrics,
    }
}
