//! Bindings of [`crate::gbuffer`].
//!
//! Rows are `B * M`: image after image, in each the poses of its meshes. Shapes are prepared by
//! `python/dronepose/_gbuffer.py`.
#![expect(clippy::needless_pass_by_value, reason = "array borrows come by value")]
#![expect(clippy::too_many_arguments, reason = "two poses are four arrays in Python")]
#![expect(non_snake_case, reason = "R is what the field, and so the Python side, calls a rotation")]

use numpy::ndarray::{Dimension, IxDyn};
use numpy::{
    Element, PyArray, PyArrayDyn, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2,
    PyReadonlyArray3, PyReadwriteArray,
};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use super::mesh::PyMesh;
use crate::camera::Intrinsics;
use crate::gbuffer::coverage::{self, Share};
use crate::gbuffer::flow::{Background, Fate, Pairs};
use crate::gbuffer::normals::{self, Weight};
use crate::gbuffer::{GBuffer, Normals, Scenes, Surface};
use crate::raster::{Model, Pixel, Size, View};
use crate::threads;

/// `fx, fy, cx, cy, skew, width, height`.
type Camera = (f64, f64, f64, f64, f64, usize, usize);

/// The meshes prepared for drawing, which each does once.
fn models<'a>(py: Python<'_>, meshes: &'a [PyRef<'_, PyMesh>]) -> PyResult<Vec<&'a Model>> {
    let meshes: Vec<&PyMesh> = meshes.iter().map(|mesh| &**mesh).collect();
    let one = |mesh: &'a PyMesh| mesh.model().map(|model| &**model);
    Ok(py.detach(|| meshes.into_iter().map(one).collect::<crate::Result<_>>())?)
}

/// Poses as views of a camera.
fn views(
    R: &PyReadonlyArray3<'_, f64>,
    t: &PyReadonlyArray2<'_, f64>,
    (fx, fy, cx, cy, skew, ..): Camera,
) -> PyResult<Vec<View>> {
    let camera = Intrinsics { skew, ..Intrinsics::new(fx, fy, cx, cy)? };
    let (rotations, rest) = R.as_slice()?.as_chunks::<9>();
    let (translations, odd) = t.as_slice()?.as_chunks::<3>();
    if !rest.is_empty() || !odd.is_empty() || rotations.len() != translations.len() {
        return Err(PyValueError::new_err("R, t: expected shapes (N, 3, 3) and (N, 3)"));
    }
    let pairs = rotations.iter().zip(translations);
    Ok(pairs.map(|(m, &translation)| View { rotation: rows(m), translation, camera }).collect())
}

fn rows(m: &[f64; 9]) -> [[f64; 3]; 3] {
    [[m[0], m[1], m[2]], [m[3], m[4], m[5]], [m[6], m[7], m[8]]]
}

fn size((.., width, height): Camera) -> Size {
    Size { height, width }
}

/// Zeros of `NumPy`, which may take huge pages for them and leaves pages alone that stay zero.
struct Plane<'py, X: Element>(Bound<'py, PyArrayDyn<X>>);

impl<'py, X: Element> Plane<'py, X> {
    fn new(py: Python<'py>, wanted: bool, shape: &[usize]) -> Option<Self> {
        wanted.then(|| Self(PyArray::zeros(py, IxDyn(shape), false)))
    }
}

/// The plane to be written to.
fn borrowed<'py, X: Element>(
    plane: Option<&Plane<'py, X>>,
) -> Option<PyReadwriteArray<'py, X, IxDyn>> {
    plane.map(|plane| plane.0.readwrite())
}

fn slice<'a, X: Element, D: Dimension>(
    plane: &'a mut Option<PyReadwriteArray<'_, X, D>>,
) -> PyResult<Option<&'a mut [X]>> {
    Ok(plane.as_mut().map(PyReadwriteArray::as_slice_mut).transpose()?)
}

/// The planes named in `channels`, `(B, H, W, ...)`, by name.
#[pyfunction]
pub(super) fn gbuffer<'py>(
    py: Python<'py>,
    meshes: Vec<PyRef<'py, PyMesh>>,
    camera: Camera,
    R: PyReadonlyArray3<'py, f64>,
    t: PyReadonlyArray2<'py, f64>,
    channels: Vec<String>,
    normals: &str,
    attributes: Vec<Option<PyReadonlyArray2<'py, f64>>>,
    uv: Vec<Option<PyReadonlyArray3<'py, f64>>>,
    samples: usize,
    near: Option<f64>,
    double: bool,
    threads: usize,
) -> PyResult<Bound<'py, PyDict>> {
    let meshes = Meshes::new(py, &meshes, (&channels, normals), &attributes, &uv)?;
    let views = views(&R, &t, camera)?;
    let request = Request { camera, views, channels, samples, near, threads };
    if double { request.draw::<f64>(py, &meshes) } else { request.draw::<f32>(py, &meshes) }
}

/// Borrowed meshes with their values.
struct Meshes<'a> {
    models: Vec<&'a Model>,
    of_vertices: Vec<Option<Vec<[f64; 3]>>>,
    attributes: Vec<Option<&'a [f64]>>,
    uv: Vec<Option<&'a [[[f64; 2]; 3]]>>,
    normals: Normals,
}

impl<'a> Meshes<'a> {
    fn new(
        py: Python<'_>,
        meshes: &'a [PyRef<'_, PyMesh>],
        (channels, normals): (&[String], &str),
        attributes: &'a [Option<PyReadonlyArray2<'_, f64>>],
        uv: &'a [Option<PyReadonlyArray3<'_, f64>>],
    ) -> PyResult<Self> {
        let models = models(py, meshes)?;
        let weight = match normals {
            "flat" => None,
            "area" => Some(Weight::Area),
            "angle" => Some(Weight::Angle),
            _ => return Err(PyValueError::new_err("normals: expected flat, area or angle")),
        };
        let weight = weight.filter(|_| channels.iter().any(|c| c == "normal"));
        let of_vertices = py.detach(|| {
            models.iter().map(|m| Some(normals::of_vertices(m, weight?))).collect::<Vec<_>>()
        });
        let values = |a: &'a Option<PyReadonlyArray2<'_, f64>>| -> PyResult<_> {
            Ok(a.as_ref().map(PyReadonlyArray2::as_slice).transpose()?)
        };
        let corners = |a: &'a Option<PyReadonlyArray3<'_, f64>>| -> PyResult<_> {
            let numbers = a.as_ref().map(PyReadonlyArray3::as_slice).transpose()?;
            Ok(numbers.map(|n| n.as_chunks::<2>().0.as_chunks::<3>().0))
        };
        Ok(Self {
            models,
            of_vertices,
            attributes: attributes.iter().map(values).collect::<PyResult<_>>()?,
            uv: uv.iter().map(corners).collect::<PyResult<_>>()?,
            normals: if weight.is_some() { Normals::Smooth } else { Normals::Flat },
        })
    }

    fn surfaces(&self) -> Vec<Surface<'_>> {
        let surface = |(k, &model): (usize, &&'a Model)| Surface {
            model,
            normals: self.of_vertices[k].as_deref(),
            attributes: self.attributes.get(k).copied().flatten(),
            uv: self.uv.get(k).copied().flatten(),
        };
        self.models.iter().enumerate().map(surface).collect()
    }
}

/// What to draw, and how.
struct Request {
    camera: Camera,
    views: Vec<View>,
    channels: Vec<String>,
    samples: usize,
    near: Option<f64>,
    threads: usize,
}

impl Request {
    fn draw<'py, T: Pixel + Element>(
        &self,
        py: Python<'py>,
        meshes: &Meshes<'_>,
    ) -> PyResult<Bound<'py, PyDict>> {
        let surfaces = meshes.surfaces();
        let size = size(self.camera);
        let scenes = Scenes { surfaces: &surfaces, views: &self.views, size, near: self.near };
        scenes.check()?;
        let wanted = |name: &str| self.channels.iter().any(|c| c == name);
        let image = [scenes.images(), size.height, size.width];
        let with = |channels: usize| [image[0], image[1], image[2], channels];
        let mask = Plane::<bool>::new(py, wanted("mask"), &image);
        let ids = ["object", "face"].map(|name| Plane::<i32>::new(py, wanted(name), &image));
        let depth = Plane::<T>::new(py, wanted("depth"), &image);
        let barycentrics = Plane::<T>::new(py, wanted("barycentrics"), &with(3));
        let normal = Plane::<T>::new(py, wanted("normal"), &with(3));
        let values = with(scenes.attribute_channels());
        let attributes = Plane::<T>::new(py, wanted("attributes"), &values);
        let uv = Plane::<T>::new(py, wanted("uv"), &with(2));
        let each = wanted("coverage_each");
        let share = if each { with(surfaces.len()).to_vec() } else { image.to_vec() };
        let coverage = Plane::<T>::new(py, each || wanted("coverage"), &share);
        {
            let mut mask = borrowed(mask.as_ref());
            let [mut object, mut face] = [0, 1].map(|k| borrowed(ids[k].as_ref()));
            let mut floats = [&depth, &barycentrics, &normal, &attributes, &uv, &coverage]
                .map(|plane| borrowed(plane.as_ref()));
            let [depth, barycentrics, normal, attributes, uv, coverage] = &mut floats;
            let out = GBuffer {
                mask: slice(&mut mask)?,
                object: slice(&mut object)?,
                face: slice(&mut face)?,
                depth: slice(depth)?,
                barycentrics: slice(barycentrics)?,
                normal: slice(normal)?,
                attributes: slice(attributes)?,
                uv: slice(uv)?,
                zeroed: true,
            };
            let coverage = slice(coverage)?;
            let share = if each { Share::Each } else { Share::All };
            py.detach(|| {
                threads::install(self.threads, || {
                    if !out.is_empty() {
                        scenes.draw(meshes.normals, out)?;
                    }
                    coverage.map_or(Ok(()), |out| coverage::draw(&scenes, self.samples, share, out))
                })
            })??;
        }
        let planes = PyDict::new(py);
        let [object, face] = ids;
        planes.set_item("mask", mask.map(|p| p.0))?;
        planes.set_item("object", object.map(|p| p.0))?;
        planes.set_item("face", face.map(|p| p.0))?;
        planes.set_item("depth", depth.map(|p| p.0))?;
        planes.set_item("barycentrics", barycentrics.map(|p| p.0))?;
        planes.set_item("normal", normal.map(|p| p.0))?;
        planes.set_item("attributes", attributes.map(|p| p.0))?;
        planes.set_item("uv", uv.map(|p| p.0))?;
        planes.set_item("coverage", coverage.map(|p| p.0))?;
        Ok(planes)
    }
}

/// Flow `(B, H, W, 2)` in pixels and what became of each point `(B, H, W)`, as the numbers of
/// [`Fate`].
#[pyfunction]
pub(super) fn flow<'py>(
    py: Python<'py>,
    meshes: Vec<PyRef<'py, PyMesh>>,
    cameras: (Camera, Camera),
    R0: PyReadonlyArray3<'py, f64>,
    t0: PyReadonlyArray2<'py, f64>,
    R1: PyReadonlyArray3<'py, f64>,
    t1: PyReadonlyArray2<'py, f64>,
    background: Option<(
        PyReadonlyArray3<'py, f64>,
        PyReadonlyArray2<'py, f64>,
        PyReadonlyArray1<'py, f64>,
    )>,
    tolerance: f64,
    near: Option<f64>,
    double: bool,
    threads: usize,
) -> PyResult<(Bound<'py, PyAny>, Bound<'py, PyArrayDyn<u8>>)> {
    let models = models(py, &meshes)?;
    let surfaces: Vec<_> = models.iter().copied().map(Surface::new).collect();
    let (first, second) = (views(&R0, &t0, cameras.0)?, views(&R1, &t1, cameras.1)?);
    let backgrounds =
        background
            .map(|(R, t, depth)| -> PyResult<Vec<Background>> {
                let poses =
                    R.as_slice()?.as_chunks::<9>().0.iter().zip(t.as_slice()?.as_chunks::<3>().0);
                let one = |((m, &translation), &depth): ((&[f64; 9], &[f64; 3]), &f64)| {
                    Background { rotation: rows(m), translation, depth }
                };
                Ok(poses.zip(depth.as_slice()?).map(one).collect())
            })
            .transpose()?;
    let pairs = Pairs {
        first: Scenes { surfaces: &surfaces, views: &first, size: size(cameras.0), near },
        second: &second,
        second_size: size(cameras.1),
        backgrounds: backgrounds.as_deref(),
        tolerance: Some(tolerance),
    };
    pairs.check()?;
    if double { drawn::<f64>(py, &pairs, threads) } else { drawn::<f32>(py, &pairs, threads) }
}

fn drawn<'py, T: Pixel + Element>(
    py: Python<'py>,
    pairs: &Pairs<'_>,
    threads: usize,
) -> PyResult<(Bound<'py, PyAny>, Bound<'py, PyArrayDyn<u8>>)> {
    let Size { height, width } = pairs.first.size;
    let image = [pairs.first.images(), height, width];
    let flow = PyArray::<T, _>::zeros(py, IxDyn(&[image[0], height, width, 2]), false);
    // The enumeration is one byte, but NumPy knows only numbers.
    let mut found = vec![Fate::None; image.iter().product()];
    {
        let mut flow = flow.readwrite();
        let flow = flow.as_slice_mut()?;
        py.detach(|| threads::install(threads, || pairs.draw(flow, &mut found)))??;
    }
    let fate = PyArray::<u8, _>::zeros(py, IxDyn(&image), false);
    for (out, fate) in fate.readwrite().as_slice_mut()?.iter_mut().zip(found) {
        *out = fate as u8;
    }
    Ok((flow.into_any(), fate))
}
