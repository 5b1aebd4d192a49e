//! A table of poses, whatever file it came from.

use glam::{DQuat, DVec3};

use crate::error::{Error, Place, Result};
use crate::io::input::InputFile;
use crate::pose::Pose;
use crate::rotation::{self, NOTABLE_DEPARTURE, NotARotation};

/// Unit of the translations in a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Unit {
    /// Metres.
    Metre,
    /// Centimetres.
    Centimetre,
    /// Millimetres.
    Millimetre,
}

impl Unit {
    /// Metres per unit.
    #[must_use]
    pub fn metres(self) -> f64 {
        match self {
            Self::Metre => 1.0,
            Self::Centimetre => 1e-2,
            Self::Millimetre => 1e-3,
        }
    }

    /// `m`, `cm` or `mm`.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Metre => "m",
            Self::Centimetre => "cm",
            Self::Millimetre => "mm",
        }
    }

    /// A length of this unit in metres. Dividing by 1000 rounds once, multiplying by 0.001 twice.
    #[must_use]
    pub fn to_metres(self, length: f64) -> f64 {
        match self {
            Self::Metre => length,
            Self::Centimetre => length / 100.0,
            Self::Millimetre => length / 1000.0,
        }
    }
}

/// Many short strings in one allocation.
#[derive(Debug, Clone, Default)]
pub struct Strings {
    bytes: String,
    ends: Vec<usize>,
}

impl Strings {
    /// Append one.
    pub fn push(&mut self, text: &str) {
        self.bytes.push_str(text);
        self.ends.push(self.bytes.len());
    }

    /// Append all of `more`.
    pub(crate) fn append(&mut self, more: &Self) {
        let before = self.bytes.len();
        self.bytes.push_str(&more.bytes);
        self.ends.extend(more.ends.iter().map(|end| before + end));
    }

    /// The `i`-th string.
    ///
    /// # Panics
    /// If there are not that many.
    #[must_use]
    pub fn get(&self, i: usize) -> &str {
        let from = if i == 0 { 0 } else { self.ends[i - 1] };
        &self.bytes[from..self.ends[i]]
    }

    /// How many there are.
    #[must_use]
    pub fn len(&self) -> usize {
        self.ends.len()
    }

    /// There are none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.ends.is_empty()
    }

    /// All of them in order.
    pub fn iter(&self) -> impl Iterator<Item = &str> {
        (0..self.len()).map(|i| self.get(i))
    }
}

/// Which object in which image: the key of BOP files.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Target {
    /// Scene; `None` if the file does not say.
    pub scene: Option<u32>,
    /// Image in the scene.
    pub image: u32,
    /// Object.
    pub object: u32,
}

/// A column beside the pose, kept because `--by` asked for it.
#[derive(Debug, Clone)]
pub struct ExtraColumn {
    /// Name as in the header.
    pub name: String,
    /// One value a row.
    pub values: Strings,
}

/// Poses with ids, in the order of the file, in metres.
#[derive(Debug, Clone)]
pub struct PoseTable {
    /// The file.
    pub source: InputFile,
    /// Its name for messages.
    pub name: String,
    /// Unit its translations were in.
    pub unit: Unit,
    /// Ids; empty if `targets` is set.
    pub ids: Strings,
    /// Poses, `cam_from_model`.
    pub poses: Vec<Pose>,
    /// Physical line of each row; empty for formats without lines.
    pub lines: Vec<u32>,
    /// BOP: what each row is about.
    pub targets: Option<Vec<Target>>,
    /// BOP: score of each row.
    pub scores: Option<Vec<f64>>,
    /// Further columns.
    pub extra: Vec<ExtraColumn>,
    /// What the user should know about the file.
    pub warnings: Vec<String>,
}

impl PoseTable {
    /// Poses that are in memory already, called `name` in messages; without `ids` the rows are
    /// numbered from 0. The digest is that of the numbers.
    ///
    /// # Errors
    /// [`Error::Argument`] for no pose, another number of ids, or translations that are not finite.
    pub fn from_poses(name: &str, poses: Vec<Pose>, ids: Option<&[String]>) -> Result<Self> {
        if poses.is_empty() {
            return Err(Error::argument(name, "found no pose, expected at least one"));
        }
        row_limit(poses.len(), name)?;
        if let Some(ids) = ids.filter(|ids| ids.len() != poses.len()) {
            let message = format!("found {} ids for {} poses", ids.len(), poses.len());
            return Err(Error::argument(name, message));
        }
        let mut table_ids = Strings::default();
        for (row, pose) in poses.iter().enumerate() {
            let t = pose.translation;
            translation(t.to_array(), Unit::Metre, || Place::file(&format!("{name}.t[{row}]")))?;
            match ids {
                Some(ids) => table_ids.push(&ids[row]),
                None => table_ids.push(&row.to_string()),
            }
        }
        let flat = |p: &Pose| p.rotation.to_array().into_iter().chain(p.translation.to_array());
        let numbers = poses.iter().flat_map(flat);
        Ok(Self {
            source: InputFile::array(name, numbers),
            name: name.to_owned(),
            unit: Unit::Metre,
            ids: table_ids,
            poses,
            lines: Vec::new(),
            targets: None,
            scores: None,
            extra: Vec::new(),
            warnings: Vec::new(),
        })
    }

    /// Number of rows.
    #[must_use]
    pub fn len(&self) -> usize {
        self.poses.len()
    }

    /// There is no row.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.poses.is_empty()
    }

    /// The row's line, where the format has lines.
    #[must_use]
    pub fn line(&self, row: usize) -> Option<u64> {
        self.lines.get(row).map(|&l| u64::from(l))
    }

    /// Where the row stands, narrowed to a column.
    #[must_use]
    pub fn place(&self, row: usize, column: &str) -> Place {
        Place {
            file: self.name.clone(),
            line: self.line(row),
            column: Some(match self.line(row) {
                Some(_) => column.to_owned(),
                None => format!("{}.{column}", self.id(row)),
            }),
        }
    }

    /// The id of a row: as in the file, or `scene/image/object`.
    #[must_use]
    pub fn id(&self, row: usize) -> std::borrow::Cow<'_, str> {
        match &self.targets {
            Some(targets) => {
                let t = &targets[row];
                match t.scene {
                    Some(scene) => format!("{scene}/{}/{}", t.image, t.object).into(),
                    None => format!("{}/{}", t.image, t.object).into(),
                }
            }
            None => self.ids.get(row).into(),
        }
    }

    /// Drop the rows of other objects (BOP files only); returns how many rows are left.
    pub fn keep_objects(&mut self, objects: &[u32]) -> usize {
        let Some(targets) = &self.targets else { return self.len() };
        let keep: Vec<bool> = targets.iter().map(|t| objects.contains(&t.object)).collect();
        retain(&mut self.poses, &keep);
        retain(&mut self.lines, &keep);
        if let Some(targets) = &mut self.targets {
            retain(targets, &keep);
        }
        if let Some(scores) = &mut self.scores {
            retain(scores, &keep);
        }
        self.len()
    }

    /// Refuse ground truth at the camera: the normalised position error divides by `|t|`.
    ///
    /// # Errors
    /// [`Error::Malformed`] naming the first such row.
    pub fn refuse_zero_distance(&self) -> Result<()> {
        for (row, pose) in self.poses.iter().enumerate() {
            if pose.translation.length() == 0.0 {
                return Err(Error::malformed(
                    self.place(row, "tx..tz"),
                    "a ground-truth translation of zero norm",
                    "a distance above zero (the normalised position error divides by it)",
                ));
            }
        }
        Ok(())
    }
}

fn retain<T>(column: &mut Vec<T>, keep: &[bool]) {
    let mut row = 0;
    column.retain(|_| {
        row += 1;
        keep[row - 1]
    });
}

/// Collects the rotations of a file, with one warning for all that had to be projected.
#[derive(Debug, Default)]
pub(crate) struct Departures {
    count: usize,
    worst: f64,
    place: Option<Place>,
    unnormalised: usize,
    worst_norm: f64,
    norm_place: Option<Place>,
}

impl Departures {
    /// A matrix given row by row, projected to the nearest rotation.
    pub(crate) fn matrix(
        &mut self,
        rows: [[f64; 3]; 3],
        place: impl Fn() -> Place,
    ) -> Result<DQuat> {
        let (q, departure) = rotation::from_matrix(rows).map_err(|e| not_a_rotation(place(), e))?;
        if departure > NOTABLE_DEPARTURE {
            self.count += 1;
            if departure > self.worst {
                self.worst = departure;
                self.place = Some(place());
            }
        }
        Ok(q)
    }

    /// A quaternion of any norm but zero.
    pub(crate) fn quat_wxyz(&mut self, q: [f64; 4], place: impl Fn() -> Place) -> Result<DQuat> {
        let unit = rotation::from_quat_wxyz(q).map_err(|e| not_a_rotation(place(), e))?;
        let norm2: f64 = q.iter().map(|c| c * c).sum();
        // |norm - 1| > 1e-3, without the square root in the common case.
        if (norm2 - 1.0).abs() > 2e-3 {
            // The squares may have overflowed.
            let largest = q.iter().fold(0.0_f64, |m, c| m.max(c.abs()));
            let scaled = q.map(|c| c / largest);
            let norm = largest * scaled.iter().map(|c| c * c).sum::<f64>().sqrt();
            let norm = norm.min(f64::MAX);
            self.unnormalised += 1;
            if self.norm_place.is_none() || (norm - 1.0).abs() > (self.worst_norm - 1.0).abs() {
                self.worst_norm = norm;
                self.norm_place = Some(place());
            }
        }
        Ok(unit)
    }

    /// Add those of the rows that follow, whose lines were counted from `lines_before`.
    pub(crate) fn append(&mut self, more: Self, lines_before: u64) {
        let shifted = |place: Option<Place>| {
            place.map(|p| Place { line: p.line.map(|line| line + lines_before), ..p })
        };
        self.count += more.count;
        if more.worst > self.worst {
            self.worst = more.worst;
            self.place = shifted(more.place);
        }
        self.unnormalised += more.unnormalised;
        let off = |norm: f64| (norm - 1.0).abs();
        if more.norm_place.is_some()
            && (self.norm_place.is_none() || off(more.worst_norm) > off(self.worst_norm))
        {
            self.worst_norm = more.worst_norm;
            self.norm_place = shifted(more.norm_place);
        }
    }

    /// The warnings to show.
    pub(crate) fn warnings(&self) -> Vec<String> {
        let mut out = Vec::new();
        if let Some(place) = &self.place {
            out.push(format!(
                "{place}: rotation matrices depart from orthonormal by up to {:.2e} here ({} of them \
                 above {NOTABLE_DEPARTURE:.0e}); each was replaced by the nearest rotation",
                self.worst, self.count
            ));
        }
        if let Some(place) = &self.norm_place {
            let norm = self.worst_norm;
            let norm = if (1e-3..1e6).contains(&norm) {
                format!("{norm:.6}")
            } else {
                format!("{norm:.3e}")
            };
            out.push(format!(
                "{place}: quaternion of norm {norm} here ({} of them off by more than 1e-3); each was normalised",
                self.unnormalised
            ));
        }
        out
    }
}

/// The error for numbers that are no rotation.
pub(crate) fn not_a_rotation(place: Place, why: NotARotation) -> Error {
    Error::malformed(place, why.found(), why.expected())
}

/// A translation in metres.
///
/// # Errors
/// If it overflows.
pub(crate) fn translation(t: [f64; 3], unit: Unit, place: impl Fn() -> Place) -> Result<DVec3> {
    let v = DVec3::from_array(t.map(|c| unit.to_metres(c)));
    // Distances are squared later on; 1e150 m is no drone.
    if v.is_finite() && v.abs().max_element() <= 1e15 {
        return Ok(v);
    }
    Err(Error::malformed(
        place(),
        format!("a translation of {:e} m", v.abs().max_element()),
        "three finite lengths below 1e15 m",
    ))
}

/// A row number that fits the table.
///
/// # Errors
/// Above 2^32 rows.
pub(crate) fn row_limit(rows: usize, name: &str) -> Result<()> {
    if u32::try_from(rows).is_ok() {
        return Ok(());
    }
    Err(Error::malformed(Place::file(name), "more than 4,294,967,295 rows", "fewer rows"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_norm_of_a_huge_quaternion_is_reported_as_it_is() {
        for (q, shown) in [
            ([1e300, 0.0, 0.0, 1e300], "norm 1.414e300 here (1 of them"),
            ([f64::MAX, 0.0, 0.0, f64::MAX], "norm 1.798e308 here (1 of them"),
            ([3e-10, 0.0, 4e-10, 0.0], "norm 5.000e-10 here (1 of them"),
            ([0.0, 2.0, 0.0, 0.0], "norm 2.000000 here (1 of them"),
        ] {
            let mut departures = Departures::default();
            departures.quat_wxyz(q, || Place::line("a.csv", 2)).expect("a rotation");
            let warnings = departures.warnings();
            assert!(warnings[0].contains(shown), "{warnings:?}");
        }
    }
}
