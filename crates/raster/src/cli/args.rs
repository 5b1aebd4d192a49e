//! The command line of `dronepose-eval`.

use std::path::{Path, PathBuf};

use clap::{Parser, ValueEnum};

use crate::error::{Error, Result};
use crate::eval::request::CHOICES;
use crate::eval::{Cameras, Choice, Level, Preset, Reference, Request, Up};
use crate::io::{Format, Unit};

const EXAMPLES: &str = "\
Examples:
  dronepose-eval predictions.csv gt.csv
  dronepose-eval predictions.csv gt.csv --mesh drone.obj --html report.html
  dronepose-eval ours.csv gt.csv --mesh drone.obj --compare baseline.csv --by distance
  dronepose-eval results_lmo-test.csv test/000002/scene_gt.json --mesh models --camera camera.json
  dronepose-eval submission.csv test.json --preset speedplus --json -

CSV files have a header: id,qw,qx,qy,qz,tx,ty,tz in any order (or r11..r33, or rx,ry,rz for the
rotation). Poses are cam_from_model in the OpenCV camera frame. An output named - goes to
standard output. Exit codes: 0 done, 1 an input was refused, 2 the command line was not understood,
130 interrupted.";

/// Score 6D pose predictions against ground truth.
///
/// Prints NPE, OE, CPE, AccX and, with a mesh, ADD, ADD-S, MSSD and their recalls, with confidence
/// intervals and the worst samples.
#[derive(Debug, Parser)]
#[command(name = "dronepose-eval", version, after_help = EXAMPLES, max_term_width = 100)]
pub struct Args {
    /// Predicted poses: CSV, BOP result CSV, SPEED JSON or CSV; .gz is unpacked; - is stdin
    pub predictions: PathBuf,
    /// Ground-truth poses: CSV, BOP `scene_gt.json` or folder, SPEED labels
    pub gt: PathBuf,

    /// Format of both files; auto recognises each from its content
    #[arg(long, value_name = "FORMAT", default_value = "auto", value_parser = ["auto", "csv", "bop", "speed"])]
    pub format: String,
    /// Mesh of the object (OBJ, PLY, STL), or a BOP models folder; without it the metrics over
    /// vertices are left out
    #[arg(long, value_name = "FILE")]
    pub mesh: Option<PathBuf>,
    /// Unit of the mesh [default: m; mm for a BOP models folder]
    #[arg(long, value_name = "UNIT")]
    pub mesh_unit: Option<MeshUnit>,
    /// Unit of the translations in both files [default: m; mm for BOP files]
    #[arg(long, value_name = "UNIT")]
    pub unit: Option<PoseUnit>,
    /// Unit of the translations in the predictions alone
    #[arg(long, value_name = "UNIT")]
    pub pred_unit: Option<PoseUnit>,
    /// Unit of the translations in the ground truth alone
    #[arg(long, value_name = "UNIT")]
    pub gt_unit: Option<PoseUnit>,
    /// Length that 6D Pose-k is a percentage of: bbox-diagonal, diameter, or metres [default: that
    /// of the preset]
    #[arg(long, value_name = "LENGTH")]
    pub add_reference: Option<Reference>,
    /// Symmetries: BOP `models_info.json`, or a JSON file with its symmetry keys (lengths in mm)
    #[arg(long, value_name = "FILE")]
    pub symmetries: Option<PathBuf>,
    /// Intrinsics in pixels for the projection errors, or a JSON file (camera.json,
    /// `scene_camera.json`)
    #[arg(long, value_name = "fx,fy,cx,cy,W,H|FILE")]
    pub camera: Option<String>,
    /// X of the accuracy at X degrees and X centimetres
    #[arg(long, value_name = "X,...", value_delimiter = ',', default_value = "2,5,10")]
    pub acc: Vec<f64>,
    /// k of 6D Pose-k: ADD below k percent of the reference length
    #[arg(long, value_name = "k,...", value_delimiter = ',', default_value = "2,5,10")]
    pub add: Vec<f64>,
    /// Metrics over vertices: auto, all, or some of add,adds,mssd,mspd,proj; auto leaves ADD-S out
    /// where it would take long
    #[arg(long, value_name = "LIST", value_delimiter = ',', default_value = "auto")]
    pub metrics: Vec<String>,
    /// A set of choices: paper (bounding-box diagonal), authors (0.354 m and means of batch
    /// means), bop (diameter), speedplus
    #[arg(long, value_name = "NAME", default_value = "paper", value_parser = ["paper", "authors", "bop", "speedplus"])]
    pub preset: String,
    /// Batch size of the authors preset
    #[arg(long, value_name = "N", default_value_t = 8, value_parser = clap::value_parser!(u32).range(1..))]
    pub batch_size: u32,
    /// Score only these objects of BOP files
    #[arg(long, value_name = "ID,...", value_delimiter = ',')]
    pub objects: Vec<u32>,
    /// Break the numbers down by distance, azimuth, elevation or a column (repeatable)
    #[arg(long, value_name = "distance|azimuth|elevation|COLUMN", value_delimiter = ',')]
    pub by: Vec<String>,
    /// The model's up axis, which azimuth and elevation refer to
    #[arg(long, value_name = "AXIS", default_value = "z", value_parser = ["y", "z"])]
    pub up: String,
    /// Resamples of the bootstrap behind the 95 % intervals; 0 for none [default: 1000, none above
    /// 50000 samples]
    #[arg(long, value_name = "N")]
    pub bootstrap: Option<u32>,
    /// Seed of the bootstrap
    #[arg(long, value_name = "S", default_value_t = 0)]
    pub seed: u64,
    /// Further predictions on the same ground truth: a leaderboard with paired differences
    #[arg(long, value_name = "OTHER", num_args = 1..)]
    pub compare: Vec<PathBuf>,
    /// Write all numbers as JSON
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
    /// Write the errors of every sample as CSV
    #[arg(long, value_name = "FILE")]
    pub per_sample: Option<PathBuf>,
    /// Write a self-contained report with curves and histograms
    #[arg(long, value_name = "FILE")]
    pub html: Option<PathBuf>,
    /// Write the tables as Markdown
    #[arg(long, value_name = "FILE")]
    pub markdown: Option<PathBuf>,
    /// Write the paper's table as LaTeX
    #[arg(long, value_name = "FILE")]
    pub latex: Option<PathBuf>,
    /// Threads; 0 for all cores. The results do not depend on it
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub threads: usize,
    /// Treat every warning (missing predictions, projected rotations, ...) as an error
    #[arg(long)]
    pub strict: bool,
    /// Print neither the table nor warnings
    #[arg(long, short)]
    pub quiet: bool,
}

/// Unit of a mesh.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum MeshUnit {
    /// Metres.
    M,
    /// Centimetres.
    Cm,
    /// Millimetres.
    Mm,
}

/// Unit of translations.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum PoseUnit {
    /// Metres.
    M,
    /// Millimetres.
    Mm,
}

impl From<MeshUnit> for Unit {
    fn from(unit: MeshUnit) -> Self {
        match unit {
            MeshUnit::M => Self::Metre,
            MeshUnit::Cm => Self::Centimetre,
            MeshUnit::Mm => Self::Millimetre,
        }
    }
}

impl From<PoseUnit> for Unit {
    fn from(unit: PoseUnit) -> Self {
        match unit {
            PoseUnit::M => Self::Metre,
            PoseUnit::Mm => Self::Millimetre,
        }
    }
}

impl Args {
    /// The format asked for.
    #[must_use]
    pub fn pose_format(&self) -> Format {
        match self.format.as_str() {
            "csv" => Format::Csv,
            "bop" => Format::Bop,
            "speed" => Format::Speed,
            _ => Format::Auto,
        }
    }

    /// The evaluation asked for.
    ///
    /// # Errors
    /// [`Error::Argument`] for levels that are not above zero, unknown metrics.
    pub fn request(&self) -> Result<Request> {
        if let Some(Err(error)) = self.camera.as_deref().and_then(Cameras::from_text) {
            return Err(Error::argument("--camera", error.to_string()));
        }
        let preset = match self.preset.as_str() {
            "authors" => Preset::Authors,
            "bop" => Preset::Bop,
            "speedplus" => Preset::SpeedPlus,
            _ => Preset::Paper,
        };
        let choice = match self.metrics.as_slice() {
            [one] if one == "auto" => Choice::Auto,
            [one] if one == "all" => Choice::All,
            names => {
                if let Some(unknown) = names.iter().find(|n| !CHOICES.contains(&n.as_str())) {
                    return Err(Error::argument(
                        "--metrics",
                        format!(
                            "found '{unknown}', expected auto, all, or some of {}",
                            CHOICES.join(",")
                        ),
                    ));
                }
                Choice::These(names.to_vec())
            }
        };
        Ok(Request {
            preset,
            acc: Level::list("--acc", &self.acc)?,
            add: Level::list("--add", &self.add)?,
            reference: self.add_reference.unwrap_or(preset.reference()),
            choice,
            by: self.by.clone(),
            up: if self.up == "y" { Up::Y } else { Up::Z },
            bootstrap: self.bootstrap.map(|n| n as usize),
            seed: self.seed,
            batch_size: self.batch_size as usize,
            objects: self.objects.clone(),
            strict: self.strict,
        })
    }

    /// Whether an output goes to standard output; at most one may, and no file may be named twice
    /// if it is written.
    ///
    /// # Errors
    /// [`Error::Argument`] if two outputs are one file, an output is an input, or two inputs are
    /// standard input.
    pub fn to_stdout(&self) -> Result<bool> {
        let outputs = [
            ("--json", &self.json),
            ("--per-sample", &self.per_sample),
            ("--html", &self.html),
            ("--markdown", &self.markdown),
            ("--latex", &self.latex),
        ];
        let outputs = outputs.iter().filter_map(|(name, path)| Some((*name, path.as_deref()?)));
        let (dashes, outputs): (Vec<_>, Vec<_>) = outputs.partition(|(_, p)| *p == "-");
        if dashes.len() > 1 {
            return Err(Error::argument("-", "only one output can go to standard output"));
        }
        let mut inputs = vec![("PREDICTIONS", self.predictions.as_path()), ("GT", &self.gt)];
        inputs.extend(self.compare.iter().map(|p| ("--compare", p.as_path())));
        inputs.extend(self.mesh.iter().map(|p| ("--mesh", p.as_path())));
        inputs.extend(self.symmetries.iter().map(|p| ("--symmetries", p.as_path())));
        inputs.extend(self.camera.iter().map(|c| ("--camera", Path::new(c))));
        if inputs.iter().filter(|(_, p)| *p == "-").count() > 1 {
            return Err(Error::argument("-", "only one input can be standard input"));
        }
        for (k, (name, path)) in outputs.iter().enumerate() {
            let Some(file) = written_file(path) else { continue };
            let others = inputs.iter().chain(&outputs[..k]);
            let same = |(_, p): &&(&str, &Path)| written_file(p).as_ref() == Some(&file);
            if let Some((other, _)) = others.into_iter().find(same) {
                let message = format!("{} is also the file of {other}", path.display());
                return Err(Error::argument(*name, message));
            }
        }
        Ok(!dashes.is_empty())
    }
}

/// The file behind a path, there or not yet; `None` for devices, pipes and folders.
fn written_file(path: &Path) -> Option<PathBuf> {
    if let Ok(file) = std::fs::canonicalize(path) {
        return file.is_file().then_some(file);
    }
    let folder = path.parent().filter(|p| !p.as_os_str().is_empty());
    let folder = std::fs::canonicalize(folder.unwrap_or(Path::new("."))).ok()?;
    Some(folder.join(path.file_name()?))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_is_not_written_twice_nor_over_an_input() {
        let folder = tempfile::tempdir().expect("a folder");
        let file = |name: &str| folder.path().join(name).display().to_string();
        for name in ["p.csv", "g.csv"] {
            std::fs::write(folder.path().join(name), "x").expect("written");
        }
        let check = |more: &[&str]| {
            let fixed = ["dronepose-eval".to_owned(), file("p.csv"), file("g.csv")];
            let more = more.iter().map(|&a| a.to_owned());
            Args::try_parse_from(fixed.into_iter().chain(more)).expect("arguments").to_stdout()
        };
        let out = file("out");
        assert_eq!(check(&["--json", &out, "--html", &file("other")]).ok(), Some(false));
        assert_eq!(check(&["--json", "-", "--html", &out]).ok(), Some(true));
        assert_eq!(check(&["--json", "/dev/null", "--html", "/dev/null"]).ok(), Some(false));
        let refused = |more: &[&str]| check(more).expect_err("refused").to_string();
        assert!(refused(&["--json", &out, "--html", &out]).ends_with("the file of --json"));
        assert!(refused(&["--latex", &file("g.csv")]).ends_with("is also the file of GT"));
        assert!(refused(&["--json", "-", "--latex", "-"]).contains("only one output"));
        assert!(refused(&["--compare", "-", "--mesh", "-"]).contains("only one input"));
    }
}
