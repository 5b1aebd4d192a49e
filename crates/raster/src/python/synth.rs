//! Bindings of [`crate::synth`]. Settings come as JSON, which `python/dronepose/synth` makes.
#![expect(clippy::needless_pass_by_value, reason = "arguments come from Python by value")]

use std::ops::Range;
use std::path::PathBuf;

use glam::{DQuat, DVec3};
use numpy::ndarray::Array2;
use numpy::{IntoPyArray, PyArray1, PyArray2, PyReadonlyArray2};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use serde::Serialize;
use serde::de::DeserializeOwned;

use super::mesh::{PyMesh, points};
use crate::Error;
use crate::rotation;
use crate::synth::anchors;
use crate::synth::flight::{self, Flight, Track};
use crate::synth::fly::{self, Pilot};
use crate::synth::free::{self, FreeSpace};
use crate::synth::place::{self, Fit, Placement};
use crate::synth::plan::{self, Plan};
use crate::synth::rules::Rules;

/// Settings from JSON.
fn settings<T: DeserializeOwned>(what: &str, json: &str) -> PyResult<T> {
    serde_json::from_str(json).map_err(|e| PyValueError::new_err(format!("{what}: {e}")))
}

fn json<T: Serialize>(value: &T) -> PyResult<String> {
    serde_json::to_string(value).map_err(|e| PyValueError::new_err(e.to_string()))
}

fn vectors<'py>(py: Python<'py>, v: &[DVec3]) -> Bound<'py, PyArray2<f64>> {
    Array2::from_shape_fn((v.len(), 3), |(i, k)| v[i][k]).into_pyarray(py)
}

fn quaternions<'py>(py: Python<'py>, q: &[DQuat]) -> Bound<'py, PyArray2<f64>> {
    let wxyz = |q: DQuat| [q.w, q.x, q.y, q.z];
    Array2::from_shape_fn((q.len(), 4), |(i, k)| wxyz(q[i])[k]).into_pyarray(py)
}

fn ranges<'py>(py: Python<'py>, s: &[Range<usize>]) -> Bound<'py, PyArray2<i64>> {
    let ends = |r: &Range<usize>| [r.start, r.end].map(usize::cast_signed);
    Array2::from_shape_fn((s.len(), 2), |(i, k)| ends(&s[i])[k] as i64).into_pyarray(py)
}

fn whole<'py>(py: Python<'py>, n: &[u64]) -> Bound<'py, PyArray1<i64>> {
    n.iter().map(|&x| x.cast_signed()).collect::<Vec<i64>>().into_pyarray(py)
}

/// A flight in our frames, cleaned and cut; `world_from_body`.
#[pyclass(frozen, name = "Flight", module = "dronepose._native")]
pub(super) struct PyFlight(Flight);

#[pymethods]
impl PyFlight {
    /// From a file; the options as JSON.
    #[staticmethod]
    fn read(py: Python<'_>, path: PathBuf, options: &str) -> PyResult<Self> {
        let options: flight::Options = settings("options", options)?;
        Ok(Self(py.detach(|| flight::read_flight(&path, &options))?))
    }

    /// Source, conventions and issues as JSON.
    fn facts(&self) -> PyResult<String> {
        let f = &self.0;
        json(&serde_json::json!({
            "source": f.source,
            "conventions": f.conventions,
            "rows": f.rows,
            "poses": f.time.len(),
            "segments": f.segments.len(),
            "sign_flips": f.sign_flips,
            "issues": f.issues,
        }))
    }

    /// `(N,)` seconds.
    fn time<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        self.0.time.clone().into_pyarray(py)
    }

    /// `(N, 3)` metres.
    fn positions<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray2<f64>> {
        vectors(py, &self.0.positions)
    }

    /// `(N, 4)`.
    fn quat_wxyz<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray2<f64>> {
        quaternions(py, &self.0.rotations)
    }

    /// `(N,)` lines of the file, from 1.
    fn lines<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<i64>> {
        whole(py, &self.0.lines)
    }

    /// `(S, 2)` first row and row behind the last.
    fn segments<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray2<i64>> {
        ranges(py, &self.0.segments)
    }

    /// At a steady rate.
    fn resample(&self, py: Python<'_>, rate_hz: f64) -> PyResult<PyTrack> {
        Ok(PyTrack(py.detach(|| self.0.resample(rate_hz))?))
    }
}

/// A flight at a steady rate.
#[pyclass(frozen, name = "Track", module = "dronepose._native")]
pub(super) struct PyTrack(Track);

#[pymethods]
impl PyTrack {
    #[new]
    fn new(
        rate_hz: f64,
        positions: PyReadonlyArray2<'_, f64>,
        quat_wxyz: PyReadonlyArray2<'_, f64>,
    ) -> PyResult<Self> {
        flight::positive("rate_hz", rate_hz)?;
        let positions = points("positions", &positions)?;
        let (rows, rest) = quat_wxyz.as_slice()?.as_chunks::<4>();
        if !rest.is_empty() || rows.len() != positions.len() || rows.is_empty() {
            return Err(PyValueError::new_err(
                "positions, quat_wxyz: expected shapes (N, 3) and (N, 4), N at least 1",
            ));
        }
        if let Some(row) = positions.iter().position(|p| !p.is_finite()) {
            return Err(PyValueError::new_err(format!("positions[{row}]: not finite")));
        }
        let mut rotations: Vec<DQuat> = Vec::with_capacity(rows.len());
        for (row, q) in rows.iter().enumerate() {
            let q = rotation::from_quat_wxyz(*q).map_err(|e| Error::NotARotation {
                argument: format!("quat_wxyz[{row}]"),
                found: e.found(),
                expected: e.expected(),
            })?;
            let last = rotations.last().copied().unwrap_or(q);
            rotations.push(if last.dot(q) < 0.0 { -q } else { q });
        }
        let n = positions.len();
        Ok(Self(Track {
            rate_hz,
            frames: (0..n.cast_signed() as i64).collect(),
            positions,
            rotations,
            lines: (1..=n as u64).collect(),
            segments: std::iter::once(0..n).collect(),
        }))
    }

    /// Frames a second.
    #[getter]
    fn rate_hz(&self) -> f64 {
        self.0.rate_hz
    }

    /// `(N,)` numbers of the frames.
    fn frames<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<i64>> {
        self.0.frames.clone().into_pyarray(py)
    }

    /// `(N, 3)` metres.
    fn positions<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray2<f64>> {
        vectors(py, &self.0.positions)
    }

    /// `(N, 4)`.
    fn quat_wxyz<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray2<f64>> {
        quaternions(py, &self.0.rotations)
    }

    /// `(N,)` lines of the file, from 1.
    fn lines<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<i64>> {
        whole(py, &self.0.lines)
    }

    /// `(S, 2)` first frame and frame behind the last.
    fn segments<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray2<i64>> {
        ranges(py, &self.0.segments)
    }

    /// A placement by the anchors, as JSON.
    fn fit(
        &self,
        anchors: PyReadonlyArray2<'_, f64>,
        placement: &str,
        how: &str,
    ) -> PyResult<String> {
        let given: Placement = settings("placement", placement)?;
        let how: Fit = match how {
            "centre" => Fit::Centre,
            "fill" => Fit::Fill,
            _ => {
                let text = format!("how: expected 'centre' or 'fill', got '{how}'");
                return Err(PyValueError::new_err(text));
            }
        };
        json(&place::fit(&self.0, &points("anchors", &anchors)?, &given, how)?)
    }

    /// Carried into a scene.
    fn placed(&self, placement: &str) -> PyResult<Self> {
        let placement: Placement = settings("placement", placement)?;
        let mut track = self.0.clone();
        placement.apply(&mut track)?;
        Ok(Self(track))
    }
}

/// Samples, and the funnel that led to them.
#[pyclass(frozen, name = "Plan", module = "dronepose._native")]
pub(super) struct PyPlan(Plan);

#[pymethods]
impl PyPlan {
    /// The rules over a flight.
    #[staticmethod]
    fn make(
        py: Python<'_>,
        track: &PyTrack,
        anchors: PyReadonlyArray2<'_, f64>,
        names: Vec<String>,
        rules: &str,
        threads: usize,
    ) -> PyResult<Self> {
        let rules: Rules = settings("rules", rules)?;
        let anchors = points("anchors", &anchors)?;
        if names.len() != anchors.len() {
            let text = format!("names: {}, but {} anchors", names.len(), anchors.len());
            return Err(PyValueError::new_err(text));
        }
        if let Some(row) = anchors.iter().position(|p| !p.is_finite()) {
            return Err(PyValueError::new_err(format!("anchors[{row}]: not finite")));
        }
        let made = py.detach(|| plan::plan(&track.0, &anchors, &names, &rules, threads))?;
        Ok(Self(made))
    }

    /// Names of the columns of numbers.
    #[staticmethod]
    fn columns() -> Vec<String> {
        Plan::columns()
    }

    /// `(N, C)`.
    fn values<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray2<f64>> {
        let plan = &self.0;
        let shape = (plan.samples.len(), Plan::columns().len());
        let mut out = Array2::zeros(shape);
        for (mut row, sample) in out.rows_mut().into_iter().zip(&plan.samples) {
            row.iter_mut().zip(plan.row(sample)).for_each(|(to, from)| *to = from);
        }
        out.into_pyarray(py)
    }

    /// `N` ids.
    fn ids(&self) -> Vec<String> {
        self.0.samples.iter().map(|s| self.0.id(s)).collect()
    }

    /// The names of the anchors of the samples.
    fn anchors(&self) -> Vec<String> {
        self.0.samples.iter().map(|s| self.0.anchors[s.anchor].clone()).collect()
    }

    /// The steps as JSON.
    fn funnel(&self) -> PyResult<String> {
        json(&self.0.funnel)
    }

    /// The samples of which `keep` is true.
    fn only(&self, keep: Vec<bool>) -> PyResult<Self> {
        if keep.len() != self.0.samples.len() {
            let text = format!("keep: {} values, but {} samples", keep.len(), self.0.samples.len());
            return Err(PyValueError::new_err(text));
        }
        Ok(Self(self.0.only(&keep)))
    }

    /// The plan and its manifest, both or none.
    fn write(&self, py: Python<'_>, csv: PathBuf, manifest: PathBuf, text: &str) -> PyResult<()> {
        Ok(py.detach(|| self.0.write(&csv, &manifest, text))?)
    }

    fn __len__(&self) -> usize {
        self.0.samples.len()
    }
}

/// Anchors: names, `(A, 3)` metres, facts.
type Read<'py> = (Vec<String>, Bound<'py, PyArray2<f64>>, String);

/// Names, `(A, 3)` metres, facts as JSON.
#[pyfunction]
pub(super) fn read_anchors<'py>(
    py: Python<'py>,
    path: PathBuf,
    options: &str,
) -> PyResult<Read<'py>> {
    let options: anchors::Options = settings("options", options)?;
    let found = py.detach(|| anchors::read_anchors(&path, options))?;
    let facts = serde_json::json!({
        "source": found.source,
        "anchors": found.positions.len(),
        "excluded": found.excluded,
        "coincident": found.coincident,
    });
    Ok((found.names, vectors(py, &found.positions), json(&facts)?))
}

/// Points in free space, `(count, 3)` metres.
#[pyfunction]
#[expect(clippy::too_many_arguments, reason = "a box, what is asked of the points, threads")]
pub(super) fn free_space<'py>(
    py: Python<'py>,
    mesh: Option<PyRef<'py, PyMesh>>,
    low: [f64; 3],
    high: [f64; 3],
    count: usize,
    clearance_m: f64,
    spacing_m: f64,
    seed: u64,
    threads: usize,
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let (low, high) = (DVec3::from_array(low), DVec3::from_array(high));
    let space = FreeSpace { low, high, count, clearance_m, spacing_m, seed };
    let mesh = mesh.as_deref().map(PyMesh::mesh);
    let found = py.detach(|| free::free_space(mesh, &space, threads))?;
    Ok(vectors(py, &found))
}

/// A flight through coins `(N, 3)` metres, and what happened on it as JSON.
#[pyfunction]
pub(super) fn fly_coins(
    py: Python<'_>,
    mesh: Option<PyRef<'_, PyMesh>>,
    coins: PyReadonlyArray2<'_, f64>,
    pilot: &str,
) -> PyResult<(PyTrack, String)> {
    let pilot: Pilot = settings("pilot", pilot)?;
    let coins = points("coins", &coins)?;
    let mesh = mesh.as_deref().map(PyMesh::mesh);
    let flown = py.detach(|| fly::fly(mesh, &coins, &pilot))?;
    let wall = flown.nearest_wall_m;
    let facts = serde_json::json!({
        "pilot": pilot,
        "collected": flown.collected,
        "unreachable": flown.unreachable,
        "nearest_wall_m": if wall.is_finite() { Some(wall) } else { None },
    });
    Ok((PyTrack(flown.track), json(&facts)?))
}

/// The settings of flights and rules as JSON.
#[pyfunction]
pub(super) fn synth_defaults() -> PyResult<String> {
    json(&serde_json::json!({
        "flight": flight::Options::default(),
        "rules": Rules::default(),
        "placement": Placement::default(),
    }))
}
