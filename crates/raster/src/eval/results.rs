//! What an evaluation says: the shape of `--json` (schema `dronepose-eval/1`), of the reports and
//! of the Python dataclasses. `docs/json.md` documents every key.
//!
//! Absent values are left out, never `null`; every number is finite.

use std::collections::BTreeMap;

use serde::Serialize;

pub use crate::io::input::InputFile;

/// Name and version of the JSON layout.
pub const SCHEMA: &str = "dronepose-eval/1";

/// Result of scoring one file of predictions, with the comparisons made beside it.
#[derive(Debug, Clone, Serialize)]
pub struct Evaluation {
    /// [`SCHEMA`].
    pub schema: &'static str,
    /// Version of this crate.
    pub version: &'static str,
    /// Name of the method: the file name of the predictions without directories.
    pub name: String,
    /// Ground-truth poses.
    pub n_gt: usize,
    /// Predicted poses in the file, matched or not.
    pub n_predictions: usize,
    /// Ground-truth poses with a prediction.
    pub n_matched: usize,
    /// All metrics.
    pub metrics: Metrics,
    /// 95 % confidence intervals, if they were computed.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ci95: Option<Intervals>,
    /// Averages the way the authors' training script prints them (`--preset authors`).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub authors: Option<Authors>,
    /// Breakdowns asked for by `--by`.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub by: Vec<Breakdown>,
    /// The worst samples, worst first.
    pub worst: Vec<WorstSample>,
    /// Other methods on the same ground truth (`--compare`).
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub compare: Vec<Comparison>,
    /// The files that were read.
    pub inputs: Inputs,
    /// Every choice that influences a number.
    pub settings: Settings,
    /// What the user should know; each is one sentence. `--strict` makes the first an error.
    pub warnings: Vec<String>,
    /// What was left out by default, and how to get it.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub notes: Vec<String>,
}

/// Mean, spread and order statistics of an error over the matched samples.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Summary {
    /// Arithmetic mean.
    pub mean: f64,
    /// Median (mean of the two middle values for an even count).
    pub median: f64,
    /// Population standard deviation (divided by n).
    pub std: f64,
    /// Smallest value.
    pub min: f64,
    /// Largest value.
    pub max: f64,
    /// 90th percentile, linearly interpolated.
    pub p90: f64,
    /// 95th percentile, linearly interpolated.
    pub p95: f64,
    /// Root of the mean square.
    pub rmse: f64,
    /// Samples left out because the error is not defined for them (projections of points at or
    /// behind the camera); absent when zero. They count as wrong in every recall.
    #[serde(skip_serializing_if = "is_zero")]
    pub n_undefined: usize,
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde passes a reference")]
fn is_zero(n: &usize) -> bool {
    *n == 0
}

/// How many samples pass a threshold.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Recall {
    /// Samples that pass.
    pub count: usize,
    /// Percent of all ground-truth poses (a missing prediction fails).
    pub percent_of_gt: f64,
    /// Percent of the matched poses; absent if none is matched.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub percent_of_matched: Option<f64>,
}

/// Recall of a vertex distance at fractions of a reference length.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ReferenceRecall {
    /// `bbox-diagonal`, `diameter` or `metres`.
    pub reference: String,
    /// The reference length in metres; absent if objects of different size were scored together.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub reference_m: Option<f64>,
    /// The reference length of each object, if they differ.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub reference_m_by_object: BTreeMap<String, f64>,
    /// Percentage as the user wrote it -> recall.
    #[serde(flatten)]
    pub at: BTreeMap<String, Recall>,
}

/// Area under the recall curve up to 10 cm, in `[0, 1]`, over all ground truth.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Auc {
    /// Exact area: mean of `max(0, 1 - e / 0.1)`.
    pub exact: f64,
    /// YCB-Video's form, which takes the right edge of every step.
    pub ycb: f64,
}

/// SPEED+ score (SPEC2021) and its two terms.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct SpeedPlus {
    /// `e_t + e_q_rad`.
    pub score: f64,
    /// Mean normalised position error, values below 2.173e-3 counted as zero.
    pub e_t: f64,
    /// Mean orientation error in radians, values below 0.169 degrees counted as zero.
    pub e_q_rad: f64,
    /// Position errors counted as zero.
    pub zeroed_t: usize,
    /// Orientation errors counted as zero.
    pub zeroed_q: usize,
}

/// SPEED score (Kelvins 2019): the mean CPE.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Speed {
    /// Mean of normalised position error plus orientation error.
    pub score: f64,
}

/// Average recalls of the BOP challenge.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Bop {
    /// MSSD at 5 %, 10 %, ... 50 % of the diameter.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ar_mssd: Option<f64>,
    /// MSPD at 5, 10, ... 50 pixels of a 640 pixel wide image.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ar_mspd: Option<f64>,
}

/// Every metric; one that could not be computed from the inputs is absent.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct Metrics {
    /// Normalised position error.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub npe: Option<Summary>,
    /// Orientation error in radians.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub oe_rad: Option<Summary>,
    /// Orientation error in degrees.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub oe_deg: Option<Summary>,
    /// Translation error in metres.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub te_m: Option<Summary>,
    /// Combined pose error, NPE + OE.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub cpe: Option<Summary>,
    /// Orientation error to the nearest symmetric pose, degrees (objects with symmetries).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub oe_sym_deg: Option<Summary>,
    /// Average distance of corresponding vertices, metres.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub add_m: Option<Summary>,
    /// Average distance to the nearest vertex, metres.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub adds_m: Option<Summary>,
    /// Maximum symmetry-aware surface distance, metres.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub mssd_m: Option<Summary>,
    /// Maximum symmetry-aware projection distance, pixels.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub mspd_px: Option<Summary>,
    /// Mean projection error of the vertices, pixels.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub proj_px: Option<Summary>,
    /// Accuracy at X degrees and X centimetres; the key is X.
    pub acc: BTreeMap<String, Recall>,
    /// Recall of ADD ("6D Pose-k" in the paper).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub add_recall: Option<ReferenceRecall>,
    /// Recall of ADD-S.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub adds_recall: Option<ReferenceRecall>,
    /// Area under the ADD curve.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub add_auc: Option<Auc>,
    /// Area under the ADD-S curve.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub adds_auc: Option<Auc>,
    /// Recall of the mean projection error at 5 pixels.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub proj_recall_5px: Option<Recall>,
    /// SPEED+ score.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub speedplus: Option<SpeedPlus>,
    /// SPEED 2019 score.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub speed: Option<Speed>,
    /// BOP average recalls.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub bop: Option<Bop>,
}

/// Lower and upper end of an interval.
pub type Interval = [f64; 2];

/// 95 % confidence intervals of means and of recalls (percent of ground truth).
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Intervals {
    /// `percentile bootstrap`.
    pub method: &'static str,
    /// Number of resamples.
    pub resamples: usize,
    /// Seed of the resampling.
    pub seed: u64,
    /// Metric key (`npe`, `oe_rad`, `oe_deg`, `te_m`, `cpe`, `add_m`, ...) -> interval of its mean.
    #[serde(flatten)]
    pub mean: BTreeMap<String, Interval>,
    /// X -> interval of the accuracy in percent of ground truth.
    pub acc: BTreeMap<String, Interval>,
    /// k -> interval of the ADD recall in percent of ground truth.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub add_recall: BTreeMap<String, Interval>,
    /// k -> interval of the ADD-S recall in percent of ground truth.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub adds_recall: BTreeMap<String, Interval>,
}

/// The averages that the authors' script prints: means of batch means over the matched samples in
/// file order, in which a short last batch weighs as much as a full one.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Authors {
    /// Samples in a batch.
    pub batch_size: usize,
    /// Number of batches.
    pub n_batches: usize,
    /// Mean of batch means of NPE.
    pub npe: f64,
    /// Mean of batch means of OE in radians.
    pub oe_rad: f64,
    /// Mean of batch means of CPE.
    pub cpe: f64,
    /// X -> mean of batch means of AccX in percent.
    pub acc: BTreeMap<String, f64>,
    /// k -> mean of batch means of 6D Pose-k in percent.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub add_recall: BTreeMap<String, f64>,
}

/// The samples split by a quantity.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Breakdown {
    /// `distance`, `azimuth`, `elevation` or the name of a column.
    pub column: String,
    /// Unit of the edges, empty where there is none.
    pub unit: String,
    /// The groups in order; none is empty.
    pub groups: Vec<Group>,
}

/// One group of a [`Breakdown`].
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Group {
    /// What to print: a range such as `1 to 1.5`, or a value of the column.
    pub label: String,
    /// Lower edge (inclusive) of a numeric range.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub from: Option<f64>,
    /// Upper edge of a numeric range.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub to: Option<f64>,
    /// Ground-truth poses in the group.
    pub n_gt: usize,
    /// Those with a prediction.
    pub n_matched: usize,
    /// Mean NPE over the matched samples; absent (with the next four) if none is matched.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub npe: Option<f64>,
    /// Mean OE in degrees.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub oe_deg: Option<f64>,
    /// Mean translation error in metres.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub te_m: Option<f64>,
    /// Mean CPE.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub cpe: Option<f64>,
    /// Mean ADD in metres.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub add_m: Option<f64>,
    /// X -> AccX in percent of ground truth.
    pub acc: BTreeMap<String, f64>,
    /// k -> ADD recall in percent of ground truth.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub add_recall: BTreeMap<String, f64>,
}

/// One of the worst samples by CPE.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct WorstSample {
    /// The sample's id.
    pub id: String,
    /// Line of the prediction in its file, where the format has lines.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub line: Option<u64>,
    /// Combined pose error.
    pub cpe: f64,
    /// Normalised position error.
    pub npe: f64,
    /// Orientation error in degrees.
    pub oe_deg: f64,
    /// Translation error in metres.
    pub te_m: f64,
    /// ADD in metres.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub add_m: Option<f64>,
    /// Distance of the model from the camera in metres.
    pub distance_m: f64,
}

/// Another method on the same ground truth, and its difference to the first one.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Comparison {
    /// Name of the method.
    pub name: String,
    /// Its file.
    pub input: InputFile,
    /// Predicted poses in the file.
    pub n_predictions: usize,
    /// Ground-truth poses with a prediction.
    pub n_matched: usize,
    /// All metrics.
    pub metrics: Metrics,
    /// 95 % confidence intervals.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ci95: Option<Intervals>,
    /// Difference of means, this method minus the first, over the samples that both predict;
    /// key as in [`Intervals`].
    pub difference: BTreeMap<String, Difference>,
    /// Warnings about this file.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub warnings: Vec<String>,
}

/// A difference of means with its paired bootstrap.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Difference {
    /// Mean of the paired differences.
    pub mean: f64,
    /// 95 % interval of the paired bootstrap.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ci95: Option<Interval>,
    /// Two-sided bootstrap p-value of "no difference".
    #[serde(skip_serializing_if = "Option::is_none")]
    pub p: Option<f64>,
    /// Samples in the comparison.
    pub n: usize,
}

/// The files behind the numbers.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Inputs {
    /// The predictions.
    pub predictions: InputFile,
    /// The ground truth.
    pub gt: InputFile,
    /// The mesh or meshes.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub mesh: Vec<InputFile>,
    /// The symmetries.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub symmetries: Option<InputFile>,
    /// The camera, if it came from a file.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub camera: Option<InputFile>,
}

/// Every choice that influences a number.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Settings {
    /// `paper`, `authors`, `bop` or `speedplus`.
    pub preset: String,
    /// Unit of the translations of the predictions, `m` or `mm`.
    pub unit_predictions: String,
    /// Unit of the translations of the ground truth.
    pub unit_gt: String,
    /// Unit of the mesh.
    pub mesh_unit: String,
    /// X of the AccX.
    pub acc: Vec<f64>,
    /// k of the 6D Pose-k.
    pub add: Vec<f64>,
    /// `bbox-diagonal`, `diameter` or a length in metres.
    pub add_reference: String,
    /// `fx,fy,cx,cy,W,H` or the camera file.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub camera: Option<String>,
    /// Number of symmetry transforms, the identity included.
    pub n_symmetries: usize,
    /// Resamples of the bootstrap; 0 for none.
    pub bootstrap: usize,
    /// Seed of the bootstrap.
    pub seed: u64,
    /// The model's up axis, which azimuth and elevation refer to: `y` or `z`.
    pub up: String,
    /// Whether warnings were errors.
    pub strict: bool,
}
