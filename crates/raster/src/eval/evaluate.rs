//! The whole evaluation: match, compute, summarise, compare.

use std::collections::BTreeMap;

use rayon::prelude::*;

use crate::error::{Error, Result};
use crate::eval::bootstrap::{Features, paired};
use crate::eval::compute::{self, Scene};
use crate::eval::groups::breakdowns;
use crate::eval::matching::{Matching, match_tables};
use crate::eval::objects::{Cameras, Objects};
use crate::eval::request::{BOOTSTRAP_LIMIT, Preset, Progress, RESAMPLES, Reference, Request};
use crate::eval::summary::{
    AUC_LIMIT_M, accurate, auc, mean, mean_of_batch_means, recall, speedplus, summarize,
};
use crate::eval::{
    Authors, Comparison, Difference, Evaluation, Inputs, Intervals, Metrics, Recall,
    ReferenceRecall, SCHEMA, Samples, Settings, Speed, Summary, WorstSample, blunders,
};
use crate::io::PoseTable;

/// Samples shown as the worst.
const WORST: usize = 5;

/// Everything that goes into an evaluation.
#[derive(Debug)]
pub struct Evaluator<'a> {
    /// Ground truth.
    pub gt: &'a PoseTable,
    /// Meshes and symmetries.
    pub objects: &'a Objects,
    /// Cameras.
    pub cameras: &'a Cameras,
    /// Choices.
    pub request: &'a Request,
}

/// An evaluation and the errors of the samples behind it.
#[derive(Debug, Clone)]
pub struct Outcome {
    /// The numbers.
    pub evaluation: Evaluation,
    /// Per-sample errors of the predictions.
    pub samples: Samples,
    /// Per-sample errors of each method compared with.
    pub others: Vec<Samples>,
}

/// One scored method.
struct Scored {
    name: String,
    samples: Samples,
    reference_m: Vec<f64>,
    metrics: Metrics,
    ci95: Option<Intervals>,
    warnings: Vec<String>,
    notes: Vec<String>,
}

impl Evaluator<'_> {
    /// Score `predictions`, and `others` on the same ground truth.
    ///
    /// # Errors
    /// Duplicate ids, nothing in common, ground truth at the camera, a length that the reference
    /// needs and nobody gave; with `strict`, the first warning.
    pub fn run(
        &self,
        predictions: &PoseTable,
        others: &[PoseTable],
        progress: &dyn Progress,
    ) -> Result<Outcome> {
        self.gt.refuse_zero_distance()?;
        let first = self.score(predictions, progress)?;
        let scene = self.scene(predictions);
        let by = breakdowns(scene, &first.samples, &first.reference_m, self.request)?;
        let mut warnings = self.gt.warnings.clone();
        warnings.extend(self.objects.warnings.iter().cloned());
        warnings.extend(first.warnings.iter().cloned());
        let mut compare = Vec::with_capacity(others.len());
        let mut other_samples = Vec::with_capacity(others.len());
        for table in others {
            let mut other = self.score(table, progress)?;
            let taken = |name: &str| {
                first.name == name || compare.iter().any(|c: &Comparison| c.name == name)
            };
            if taken(&other.name) {
                // Two files of one name: tell them apart by their paths.
                other.name.clone_from(&table.source.path);
            }
            compare.push(Comparison {
                n_predictions: table.len(),
                n_matched: other.samples.len(),
                difference: self.differences(&first, &other),
                name: other.name,
                input: table.source.clone(),
                metrics: other.metrics,
                ci95: other.ci95,
                warnings: other.warnings,
            });
            other_samples.push(other.samples);
        }
        if self.request.strict {
            let all = warnings.iter().chain(compare.iter().flat_map(|c| &c.warnings));
            if let Some(warning) = all.into_iter().next() {
                return Err(Error::Strict(warning.clone()));
            }
        }
        let mut notes = first.notes;
        notes.dedup();
        let evaluation = Evaluation {
            schema: SCHEMA,
            version: env!("CARGO_PKG_VERSION"),
            name: first.name,
            n_gt: self.gt.len(),
            n_predictions: predictions.len(),
            n_matched: first.samples.len(),
            authors: (self.request.preset == Preset::Authors)
                .then(|| self.authors(&first.samples, &first.reference_m))
                .flatten(),
            metrics: first.metrics,
            ci95: first.ci95,
            by,
            worst: worst(scene, &first.samples),
            compare,
            inputs: Inputs {
                predictions: predictions.source.clone(),
                gt: self.gt.source.clone(),
                mesh: self.objects.mesh_files.clone(),
                symmetries: self.objects.symmetry_file.clone(),
                camera: self.cameras.file.clone(),
            },
            settings: self.settings(predictions),
            warnings,
            notes,
        };
        Ok(Outcome { evaluation, samples: first.samples, others: other_samples })
    }

    fn scene<'s>(&'s self, predictions: &'s PoseTable) -> Scene<'s> {
        Scene { predictions, gt: self.gt, objects: self.objects, cameras: self.cameras }
    }

    fn score(&self, predictions: &PoseTable, progress: &dyn Progress) -> Result<Scored> {
        let Matching { pairs, warnings: mismatches } = match_tables(predictions, self.gt)?;
        let scene = self.scene(predictions);
        let mut warnings = predictions.warnings.clone();
        warnings.extend(blunders::warnings(predictions, self.gt, &pairs));
        warnings.extend(mismatches);
        let (samples, mut notes) = compute::samples(scene, &pairs, self.request, progress);
        let reference_m = self.references(scene, &pairs)?;
        let (bop, more) = compute::bop(scene, &pairs, &samples);
        notes.extend(more);
        let mut metrics = self.metrics(&samples, &reference_m);
        metrics.bop = bop;
        if let Some(undefined) = metrics.mspd_px.map(|m| m.n_undefined).filter(|&n| n > 0) {
            warnings.push(format!(
                "{}: {undefined} samples have vertices at or behind the camera; their projection \
                 errors are undefined, left out of the means and wrong in the recalls",
                predictions.name
            ));
        }
        if metrics.add_recall.as_ref().is_some_and(|r| r.reference_m.is_none()) {
            notes.push(
                "objects of different size were scored together: each has its own reference length"
                    .into(),
            );
        }
        let resamples = self.resamples();
        if self.request.bootstrap.is_none() && resamples == 0 {
            notes.push(format!(
                "no confidence intervals above {BOOTSTRAP_LIMIT} samples; --bootstrap {RESAMPLES} computes them"
            ));
        }
        let ci95 = (resamples > 0).then(|| self.intervals(&samples, &reference_m, resamples));
        Ok(Scored {
            name: method_name(&predictions.source.path),
            samples,
            reference_m,
            metrics,
            ci95,
            warnings,
            notes,
        })
    }

    fn resamples(&self) -> usize {
        let default = if self.gt.len() > BOOTSTRAP_LIMIT { 0 } else { RESAMPLES };
        self.request.bootstrap.unwrap_or(default)
    }

    /// Reference length of every sample; empty without meshes.
    fn references(&self, scene: Scene<'_>, pairs: &[(u32, u32)]) -> Result<Vec<f64>> {
        let mut out = Vec::with_capacity(pairs.len());
        for &pair in pairs {
            let Some(mesh) = &scene.object(pair).mesh else { return Ok(Vec::new()) };
            out.push(match self.request.reference {
                Reference::BboxDiagonal => mesh.diagonal,
                Reference::Diameter => mesh.diameter,
                Reference::Metres(m) => m,
            });
        }
        if let Some(zero) = out.iter().position(|&m| m <= 0.0) {
            return Err(Error::argument(
                "--add-reference",
                format!(
                    "the mesh of sample {} has no extent; give a length in metres",
                    scene.gt.id(pairs[zero].0 as usize)
                ),
            ));
        }
        Ok(out)
    }

    fn metrics(&self, s: &Samples, reference_m: &[f64]) -> Metrics {
        let n_gt = self.gt.len();
        let cpe: Vec<f64> = (0..s.len()).map(|i| s.cpe(i)).collect();
        let degrees = |rad: &[f64]| rad.iter().map(|x| x.to_degrees()).collect::<Vec<_>>();
        let oe_deg = degrees(&s.oe_rad);
        let oe_sym_deg = s.oe_sym_rad.as_deref().map(degrees);
        let columns: [Option<&[f64]>; 11] = [
            Some(&s.npe),
            Some(&s.oe_rad),
            Some(&oe_deg),
            Some(&s.te_m),
            Some(&cpe),
            oe_sym_deg.as_deref(),
            s.add_m.as_deref(),
            s.adds_m.as_deref(),
            s.mssd_m.as_deref(),
            s.mspd_px.as_deref(),
            s.proj_px.as_deref(),
        ];
        let summaries: Vec<Option<Summary>> =
            columns.par_iter().map(|c| c.and_then(summarize)).collect();
        let count = |pass: &dyn Fn(usize) -> bool| {
            recall((0..s.len()).filter(|&i| pass(i)).count(), s.len(), n_gt)
        };
        let acc = self
            .request
            .acc
            .iter()
            .map(|x| (x.label.clone(), count(&|i| accurate(s.te_m[i], s.oe_rad[i], x.value))));
        let vertex_recall = |errors: &Option<Vec<f64>>| {
            errors.as_ref().map(|errors| self.reference_recall(errors, reference_m))
        };
        Metrics {
            npe: summaries[0],
            oe_rad: summaries[1],
            oe_deg: summaries[2],
            te_m: summaries[3],
            cpe: summaries[4],
            oe_sym_deg: summaries[5],
            add_m: summaries[6],
            adds_m: summaries[7],
            mssd_m: summaries[8],
            mspd_px: summaries[9],
            proj_px: summaries[10],
            acc: acc.collect(),
            add_recall: vertex_recall(&s.add_m),
            adds_recall: vertex_recall(&s.adds_m),
            add_auc: s.add_m.as_ref().map(|e| auc(e, n_gt, AUC_LIMIT_M)),
            adds_auc: s.adds_m.as_ref().map(|e| auc(e, n_gt, AUC_LIMIT_M)),
            proj_recall_5px: s.proj_px.as_ref().map(|e| count(&|i| e[i] < 5.0)),
            speedplus: speedplus(&s.npe, &s.oe_rad),
            speed: mean(&cpe).map(|score| Speed { score }),
            bop: None,
        }
    }

    fn reference_recall(&self, errors: &[f64], reference_m: &[f64]) -> ReferenceRecall {
        let at: BTreeMap<String, Recall> = self
            .request
            .add
            .iter()
            .map(|k| {
                let below = |(e, r): &(&f64, &f64)| **e < k.value / 100.0 * **r;
                let count = errors.iter().zip(reference_m).filter(below).count();
                (k.label.clone(), recall(count, errors.len(), self.gt.len()))
            })
            .collect();
        let same =
            reference_m.first().filter(|&&r| reference_m.iter().all(|x| x.total_cmp(&r).is_eq()));
        let mut by_object = BTreeMap::new();
        if let (None, Some(targets)) = (same, &self.gt.targets) {
            for t in targets {
                let mesh = self.objects.get(Some(t.object)).mesh.as_ref();
                if let Some(length) = mesh.map(|m| match self.request.reference {
                    Reference::BboxDiagonal => m.diagonal,
                    Reference::Diameter => m.diameter,
                    Reference::Metres(m) => m,
                }) {
                    by_object.insert(t.object.to_string(), length);
                }
            }
        }
        ReferenceRecall {
            reference: self.request.reference.name().to_owned(),
            reference_m: same.copied(),
            reference_m_by_object: by_object,
            at,
        }
    }

    /// The columns that are averaged: key, whether missing samples count as zero, values.
    fn columns(&self, s: &Samples, reference_m: &[f64]) -> Vec<(String, bool, Vec<f64>)> {
        let mut out = vec![
            ("npe".to_owned(), false, s.npe.clone()),
            ("oe_rad".to_owned(), false, s.oe_rad.clone()),
            ("te_m".to_owned(), false, s.te_m.clone()),
            ("cpe".to_owned(), false, (0..s.len()).map(|i| s.cpe(i)).collect()),
        ];
        let optional = [
            (
                "oe_sym_deg",
                s.oe_sym_rad.as_ref().map(|c| c.iter().map(|x| x.to_degrees()).collect()),
            ),
            ("add_m", s.add_m.clone()),
            ("adds_m", s.adds_m.clone()),
            ("mssd_m", s.mssd_m.clone()),
            ("mspd_px", s.mspd_px.clone()),
            ("proj_px", s.proj_px.clone()),
        ];
        for (name, values) in optional {
            // A mean with undefined values has no interval.
            if let Some(values) = values.filter(|v: &Vec<f64>| v.iter().all(|x| x.is_finite())) {
                out.push((name.to_owned(), false, values));
            }
        }
        let percent = |pass: bool| if pass { 100.0 } else { 0.0 };
        for x in &self.request.acc {
            let pass = (0..s.len()).map(|i| percent(accurate(s.te_m[i], s.oe_rad[i], x.value)));
            out.push((format!("acc_{}", x.label), true, pass.collect()));
        }
        for (name, errors) in [("add_recall", &s.add_m), ("adds_recall", &s.adds_m)] {
            let Some(errors) = errors else { continue };
            for k in &self.request.add {
                let below = |(e, r): (&f64, &f64)| percent(*e < k.value / 100.0 * r);
                let pass = errors.iter().zip(reference_m).map(below).collect();
                out.push((format!("{name}_{}", k.label), true, pass));
            }
        }
        out
    }

    fn intervals(&self, s: &Samples, reference_m: &[f64], resamples: usize) -> Intervals {
        let features = Features::new(self.columns(s, reference_m), self.gt.len());
        let found = features.intervals(resamples, self.request.seed);
        let mut intervals = Intervals {
            method: "percentile bootstrap",
            resamples,
            seed: self.request.seed,
            mean: BTreeMap::new(),
            acc: BTreeMap::new(),
            add_recall: BTreeMap::new(),
            adds_recall: BTreeMap::new(),
        };
        for (name, interval) in features.names.iter().zip(found) {
            let Some(interval) = interval else { continue };
            if let Some(x) = name.strip_prefix("acc_") {
                intervals.acc.insert(x.to_owned(), interval);
            } else if let Some(k) = name.strip_prefix("add_recall_") {
                intervals.add_recall.insert(k.to_owned(), interval);
            } else if let Some(k) = name.strip_prefix("adds_recall_") {
                intervals.adds_recall.insert(k.to_owned(), interval);
            } else {
                if name == "oe_rad" {
                    let degrees = interval.map(f64::to_degrees);
                    intervals.mean.insert("oe_deg".to_owned(), degrees);
                }
                intervals.mean.insert(name.clone(), interval);
            }
        }
        intervals
    }

    /// Differences `other - first`: of errors over the samples that both have, of recalls over all
    /// ground truth.
    fn differences(&self, first: &Scored, other: &Scored) -> BTreeMap<String, Difference> {
        let n_gt = self.gt.len();
        let spread = |scored: &Scored| -> Vec<Option<u32>> {
            let mut at = vec![None; n_gt];
            for (i, &g) in scored.samples.gt_row.iter().enumerate() {
                at[g as usize] = Some(i as u32);
            }
            at
        };
        let (at_first, at_other) = (spread(first), spread(other));
        let columns = |scored: &Scored| self.columns(&scored.samples, &scored.reference_m);
        let others: BTreeMap<String, Vec<f64>> =
            columns(other).into_iter().map(|(name, _, values)| (name, values)).collect();
        let mut out = BTreeMap::new();
        for (name, over_gt, a) in columns(first) {
            let Some(b) = others.get(&name) else { continue };
            let pairs = at_first.iter().zip(&at_other);
            let differences: Vec<f64> = if over_gt {
                let value = |v: &[f64], i: Option<u32>| i.map_or(0.0, |i| v[i as usize]);
                pairs.map(|(&i, &j)| value(b, j) - value(&a, i)).collect()
            } else {
                pairs.filter_map(|(&i, &j)| Some(b[j? as usize] - a[i? as usize])).collect()
            };
            if let Some(d) = paired(&differences, self.resamples(), self.request.seed) {
                if name == "oe_rad" {
                    let ci95 = d.ci95.map(|i| i.map(f64::to_degrees));
                    out.insert(
                        "oe_deg".into(),
                        Difference { mean: d.mean.to_degrees(), ci95, ..d },
                    );
                }
                out.insert(name, d);
            }
        }
        out
    }

    fn authors(&self, s: &Samples, reference_m: &[f64]) -> Option<Authors> {
        let batch_size = self.request.batch_size;
        let average = |values: &[f64]| mean_of_batch_means(values, batch_size);
        let columns = self.columns(s, reference_m);
        let with_prefix = |prefix: &str| {
            let named = columns.iter().filter_map(|(name, _, values)| {
                Some((name.strip_prefix(prefix)?.to_owned(), average(values)?))
            });
            named.collect::<BTreeMap<_, _>>()
        };
        Some(Authors {
            batch_size,
            n_batches: s.len().div_ceil(batch_size.max(1)),
            npe: average(&s.npe)?,
            oe_rad: average(&s.oe_rad)?,
            cpe: average(&columns.iter().find(|c| c.0 == "cpe")?.2)?,
            acc: with_prefix("acc_"),
            add_recall: with_prefix("add_recall_"),
        })
    }

    fn settings(&self, predictions: &PoseTable) -> Settings {
        let request = self.request;
        Settings {
            preset: request.preset.name().to_owned(),
            unit_predictions: predictions.unit.name().to_owned(),
            unit_gt: self.gt.unit.name().to_owned(),
            mesh_unit: self.objects.unit.map_or("m", crate::io::Unit::name).to_owned(),
            acc: request.acc.iter().map(|l| l.value).collect(),
            add: request.add.iter().map(|l| l.value).collect(),
            add_reference: request.reference.to_string(),
            camera: self.cameras.text.clone(),
            n_symmetries: self.objects.max_symmetries(),
            bootstrap: self.resamples(),
            seed: request.seed,
            up: request.up.name().to_owned(),
            strict: request.strict,
        }
    }
}

/// The worst samples by CPE, worst first; ties in the order of the ground truth.
fn worst(scene: Scene<'_>, s: &Samples) -> Vec<WorstSample> {
    let mut top: Vec<usize> = Vec::with_capacity(WORST + 1);
    for i in 0..s.len() {
        if top.len() == WORST && s.cpe(i) <= s.cpe(top[WORST - 1]) {
            continue;
        }
        let at = top.partition_point(|&j| s.cpe(j) >= s.cpe(i));
        top.insert(at, i);
        top.truncate(WORST);
    }
    let sample = |i: usize| WorstSample {
        id: scene.gt.id(s.gt_row[i] as usize).into_owned(),
        line: scene.predictions.line(s.pred_row[i] as usize),
        cpe: s.cpe(i),
        npe: s.npe[i],
        oe_deg: s.oe_rad[i].to_degrees(),
        te_m: s.te_m[i],
        add_m: s.add_m.as_ref().map(|c| c[i]),
        distance_m: s.distance_m[i],
    };
    top.into_iter().filter(|&i| s.cpe(i) > 0.0).map(sample).collect()
}

/// File name without folders and endings.
fn method_name(path: &str) -> String {
    if path == "-" {
        return "stdin".to_owned();
    }
    let file = path.rsplit(['/', '\\']).next().unwrap_or(path);
    let stem = file.strip_suffix(".gz").unwrap_or(file);
    let stem = stem.rsplit_once('.').map_or(stem, |(stem, _)| stem);
    if stem.is_empty() { file.to_owned() } else { stem.to_owned() }
}

#[cfg(test)]
mod tests;
