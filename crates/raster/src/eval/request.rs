//! What to compute: the options of an evaluation, independent of any command line.

use crate::error::{Error, Result};
use crate::eval::Up;

/// A threshold with the text that names it in every output.
#[derive(Debug, Clone, PartialEq)]
pub struct Level {
    /// Shortest decimal form, such as `5` or `2.5`.
    pub label: String,
    /// The value.
    pub value: f64,
}

impl Level {
    /// Levels from numbers, in ascending order, each once.
    ///
    /// # Errors
    /// [`Error::Argument`] for a value that is not a finite number above zero.
    pub fn list(argument: &str, values: &[f64]) -> Result<Vec<Self>> {
        let mut sorted = values.to_vec();
        sorted.sort_by(f64::total_cmp);
        sorted.dedup();
        sorted
            .into_iter()
            .map(|value| {
                if value > 0.0 && value.is_finite() {
                    Ok(Self { label: value.to_string(), value })
                } else {
                    Err(Error::argument(
                        argument,
                        format!("found {value}, expected numbers above zero such as 2,5,10"),
                    ))
                }
            })
            .collect()
    }
}

/// The length that 6D Pose-k takes k percent of.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Reference {
    /// Diagonal of the axis-aligned bounding box (the paper).
    BboxDiagonal,
    /// Largest distance of two vertices (BOP and most others).
    Diameter,
    /// A length in metres (the authors' code: 0.354).
    Metres(f64),
}

impl Reference {
    /// `bbox-diagonal`, `diameter` or `metres`.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::BboxDiagonal => "bbox-diagonal",
            Self::Diameter => "diameter",
            Self::Metres(_) => "metres",
        }
    }
}

impl std::fmt::Display for Reference {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Metres(m) => write!(f, "{m} m"),
            other => f.write_str(other.name()),
        }
    }
}

impl std::str::FromStr for Reference {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "bbox-diagonal" => Ok(Self::BboxDiagonal),
            "diameter" => Ok(Self::Diameter),
            _ => match text.trim_end_matches('m').trim_end().parse::<f64>() {
                Ok(m) if m > 0.0 && m.is_finite() => Ok(Self::Metres(m)),
                _ => {
                    Err("expected bbox-diagonal, diameter, or a length in metres above zero".into())
                }
            },
        }
    }
}

/// A named set of choices.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Preset {
    /// Albanis et al. 2020: 6D Pose-k of the bounding-box diagonal, means over samples.
    #[default]
    Paper,
    /// The authors' code: 0.354 m, means of batch means.
    Authors,
    /// BOP: diameter, average recalls.
    Bop,
    /// SPEED+: its score.
    SpeedPlus,
}

impl Preset {
    /// The reference length the preset stands for.
    #[must_use]
    pub fn reference(self) -> Reference {
        match self {
            Self::Authors => Reference::Metres(0.354),
            Self::Bop => Reference::Diameter,
            Self::Paper | Self::SpeedPlus => Reference::BboxDiagonal,
        }
    }

    /// `paper`, `authors`, `bop` or `speedplus`.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Paper => "paper",
            Self::Authors => "authors",
            Self::Bop => "bop",
            Self::SpeedPlus => "speedplus",
        }
    }
}

/// Which of the metrics over vertices to compute.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub enum Choice {
    /// All that the inputs allow; ADD-S only up to [`ADDS_LIMIT`].
    #[default]
    Auto,
    /// All that the inputs allow.
    All,
    /// These: `add`, `adds`, `mssd`, `mspd`, `proj`.
    These(Vec<String>),
}

/// Names for [`Choice::These`].
pub const CHOICES: [&str; 5] = ["add", "adds", "mssd", "mspd", "proj"];

/// ADD-S is left out by default above this number of nearest-vertex queries (samples x distinct
/// vertices): some ten seconds on two cores.
pub const ADDS_LIMIT: usize = 500_000_000;

/// Bootstrap intervals are left out by default above this number of samples.
pub const BOOTSTRAP_LIMIT: usize = 50_000;

/// Resamples of the bootstrap by default.
pub const RESAMPLES: usize = 1000;

impl Choice {
    /// Whether a metric is wanted.
    #[must_use]
    pub fn wants(&self, metric: &str) -> bool {
        match self {
            Self::Auto | Self::All => true,
            Self::These(names) => names.iter().any(|n| n == metric),
        }
    }
}

/// Everything that influences a number, apart from the inputs.
#[derive(Debug, Clone, PartialEq)]
pub struct Request {
    /// The preset.
    pub preset: Preset,
    /// X of the AccX, in degrees and centimetres.
    pub acc: Vec<Level>,
    /// k of the 6D Pose-k, in percent.
    pub add: Vec<Level>,
    /// What k is a percentage of.
    pub reference: Reference,
    /// Metrics over vertices.
    pub choice: Choice,
    /// Breakdowns: `distance`, `azimuth`, `elevation`, or a column.
    pub by: Vec<String>,
    /// The model's up axis, for azimuth and elevation.
    pub up: Up,
    /// Resamples; `None` for the default.
    pub bootstrap: Option<usize>,
    /// Seed of the bootstrap.
    pub seed: u64,
    /// Batch size of the `authors` preset.
    pub batch_size: usize,
    /// Score only these objects (BOP); empty for all.
    pub objects: Vec<u32>,
    /// Warnings are errors.
    pub strict: bool,
}

impl Default for Request {
    fn default() -> Self {
        let levels = |values: &[f64]| -> Vec<Level> {
            values.iter().map(|&value| Level { label: value.to_string(), value }).collect()
        };
        Self {
            preset: Preset::Paper,
            acc: levels(&[2.0, 5.0, 10.0]),
            add: levels(&[2.0, 5.0, 10.0]),
            reference: Reference::BboxDiagonal,
            choice: Choice::Auto,
            by: Vec::new(),
            up: Up::Z,
            bootstrap: None,
            seed: 0,
            batch_size: 8,
            objects: Vec::new(),
            strict: false,
        }
    }
}

/// Told how far a long computation is.
pub trait Progress: Sync {
    /// A stage of `total` steps begins.
    fn begin(&self, stage: &str, total: u64);
    /// `steps` more are done.
    fn advance(&self, steps: u64);
}

/// Tells nobody.
#[derive(Debug, Clone, Copy, Default)]
pub struct Silent;

impl Progress for Silent {
    fn begin(&self, _stage: &str, _total: u64) {}
    fn advance(&self, _steps: u64) {}
}
