//! Sentences and lists that several formats share.

use super::columns::keys;
use super::number::{count, fixed, percent, short, significant};
use super::{Report, Scored};
use crate::eval::{Authors, Evaluation, InputFile, Metrics, ReferenceRecall};

/// What to do to get the vertex metrics.
pub(super) const NO_MESH: &str = "ADD, ADD-S, MSSD and 6D Pose need the mesh: add --mesh FILE \
     (OBJ, PLY or STL; --mesh-unit for units other than metres)";

/// What the denominators are.
pub(super) const DENOMINATORS: &str =
    "Means are over the matched samples, recalls over all ground truth.";

/// `500 ground truth, 430 predictions, 430 matched, 70 missing`.
pub(super) fn counts(n_gt: usize, s: &Scored<'_>) -> String {
    format!(
        "{} ground truth, {} {}, {} matched, {} missing",
        count(n_gt),
        count(s.n_predictions),
        if s.n_predictions == 1 { "prediction" } else { "predictions" },
        count(s.n_matched),
        count(n_gt.saturating_sub(s.n_matched)),
    )
}

/// `6D Pose-k: ADD below k % of the bounding-box diagonal, 0.6089 m`; `None` without a mesh.
pub(super) fn reference(m: &Metrics) -> Option<String> {
    let r = m.add_recall.as_ref()?;
    Some(format!("6D Pose-k: ADD below k % of {}", reference_length(r)))
}

/// `the bounding-box diagonal, 0.6089 m`.
pub(super) fn reference_length(r: &ReferenceRecall) -> String {
    let what = match r.reference.as_str() {
        "bbox-diagonal" => "the bounding-box diagonal",
        "diameter" => "the diameter",
        "metres" => "a given length",
        other => other,
    };
    match r.reference_m {
        Some(m) => format!("{what}, {} m", short(m)),
        None if r.reference_m_by_object.is_empty() => what.to_owned(),
        None => {
            let each: Vec<_> = r
                .reference_m_by_object
                .iter()
                .map(|(object, m)| format!("{object} {} m", short(*m)))
                .collect();
            format!("{what} of each object: {}", each.join(", "))
        }
    }
}

/// The scores that are one number: name, value, remark.
pub(super) fn scores(m: &Metrics) -> Vec<(String, String, String)> {
    let mut out = Vec::new();
    let mut add = |name: &str, value: String, remark: String| {
        out.push((name.to_owned(), value, remark));
    };
    if let Some(r) = &m.adds_recall {
        for k in keys(&r.at) {
            let name = format!("ADD-S recall at {k} %");
            let remark = format!("of {}", reference_length(r));
            add(&name, format!("{} %", percent(r.at[k].percent_of_gt)), remark);
        }
    }
    for (name, auc) in [("AUC of ADD", m.add_auc), ("AUC of ADD-S", m.adds_auc)] {
        if let Some(auc) = auc {
            let remark = format!("up to 10 cm; {} in YCB-Video's form", fixed(auc.ycb, 4));
            add(name, fixed(auc.exact, 4), remark);
        }
    }
    if let Some(r) = m.proj_recall_5px {
        let remark = "mean projection error below 5 px".to_owned();
        add("Projection recall", format!("{} %", percent(r.percent_of_gt)), remark);
    }
    if let Some(s) = m.speed {
        add("SPEED", significant(s.score), "Kelvins 2019, the mean CPE".to_owned());
    }
    if let Some(s) = m.speedplus {
        let remark = format!(
            "position {} + orientation {} rad; counted as zero: {} NPE, {} OE",
            significant(s.e_t),
            significant(s.e_q_rad),
            count(s.zeroed_t),
            count(s.zeroed_q),
        );
        add("SPEED+", significant(s.score), remark);
    }
    if let Some(bop) = m.bop {
        for (name, value, remark) in [
            ("BOP AR of MSSD", bop.ar_mssd, "5 % to 50 % of the diameter"),
            ("BOP AR of MSPD", bop.ar_mspd, "5 to 50 px of a 640 px wide image"),
        ] {
            if let Some(value) = value {
                add(name, fixed(value, 4), remark.to_owned());
            }
        }
    }
    out
}

/// Recalls over the matched samples alone: name and percent.
pub(super) fn recalls_of_matched(m: &Metrics) -> Vec<(String, f64)> {
    let acc = keys(&m.acc).into_iter().map(|x| (format!("Acc{x}"), m.acc[x]));
    let add = m
        .add_recall
        .iter()
        .flat_map(|r| keys(&r.at).into_iter().map(|k| (format!("6D Pose-{k}"), r.at[k])));
    acc.chain(add).filter_map(|(name, r)| Some((name, r.percent_of_matched?))).collect()
}

/// What the authors' averages are, in one sentence.
pub(super) fn authors_sentence(a: &Authors) -> String {
    format!(
        "Means of batch means in file order, {} {} of up to {} matched samples, as the training \
         script of the paper's authors prints them; a short last batch weighs as much as a full \
         one.",
        count(a.n_batches),
        if a.n_batches == 1 { "batch" } else { "batches" },
        count(a.batch_size),
    )
}

/// The authors' averages by name.
pub(super) fn authors_values(a: &Authors) -> Vec<(String, String)> {
    let mut out = vec![
        ("NPE".to_owned(), significant(a.npe)),
        ("OE (rad)".to_owned(), significant(a.oe_rad)),
        ("CPE".to_owned(), significant(a.cpe)),
    ];
    out.extend(keys(&a.acc).iter().map(|x| (format!("Acc{x} (%)"), percent(a.acc[*x]))));
    let add = keys(&a.add_recall);
    out.extend(add.iter().map(|k| (format!("6D Pose-{k} (%)"), percent(a.add_recall[*k]))));
    out
}

/// The method of the intervals in one sentence.
pub(super) fn intervals_sentence(e: &Evaluation) -> Option<String> {
    let ci = e.ci95.as_ref()?;
    Some(format!(
        "95 % intervals: {}, {} resamples, seed {}.",
        ci.method,
        count(ci.resamples),
        ci.seed
    ))
}

/// The files that were read, with their part in it.
pub(super) fn inputs(e: &Evaluation) -> Vec<(&'static str, &InputFile)> {
    let mut out = vec![("predictions", &e.inputs.predictions)];
    out.extend(e.compare.iter().map(|c| ("compared with", &c.input)));
    out.push(("ground truth", &e.inputs.gt));
    out.extend(e.inputs.mesh.iter().map(|f| ("mesh", f)));
    out.extend(e.inputs.symmetries.iter().map(|f| ("symmetries", f)));
    out.extend(e.inputs.camera.iter().map(|f| ("camera", f)));
    out
}

/// Every setting by name.
pub(super) fn settings(e: &Evaluation) -> Vec<(&'static str, String)> {
    let s = &e.settings;
    let list = |v: &[f64]| v.iter().map(|x| short(*x)).collect::<Vec<_>>().join(", ");
    let mut out = vec![
        ("preset", s.preset.clone()),
        ("unit of the predictions", s.unit_predictions.clone()),
        ("unit of the ground truth", s.unit_gt.clone()),
        ("unit of the mesh", s.mesh_unit.clone()),
        ("AccX for X =", list(&s.acc)),
        ("6D Pose-k for k =", list(&s.add)),
        ("reference of 6D Pose-k", s.add_reference.clone()),
    ];
    if let Some(m) = e.metrics.add_recall.as_ref().and_then(|r| r.reference_m) {
        out.push(("reference length", format!("{} m", short(m))));
    }
    out.extend(s.camera.clone().map(|c| ("camera", c)));
    out.push(("symmetry transforms", count(s.n_symmetries)));
    out.push(("bootstrap resamples", count(s.bootstrap)));
    out.push(("seed", s.seed.to_string()));
    out.push(("up axis of the model", s.up.clone()));
    out.push(("strict", if s.strict { "yes" } else { "no" }.to_owned()));
    out.push(("version", e.version.to_owned()));
    out
}

/// All warnings, those about a compared file with its name in front.
pub(super) fn warnings(report: &Report<'_>) -> Vec<String> {
    let e = report.evaluation;
    let others =
        e.compare.iter().flat_map(|c| c.warnings.iter().map(|w| format!("{}: {w}", c.name)));
    e.warnings.iter().cloned().chain(others).collect()
}

/// Text with control characters made visible, so that an id cannot steer the terminal.
pub(super) fn visible(s: &str) -> String {
    s.chars().map(|c| if c.is_control() { char::REPLACEMENT_CHARACTER } else { c }).collect()
}
