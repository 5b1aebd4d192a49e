//! Bindings of [`crate::gbuffer`].
//!
//! Rows are `B * M`: image after image, in each the poses of its meshes. Shapes are prepared by
//! `python/dronepose/_gbuffer.py`. Planes are written into arrays of the caller's, so that memory
//! can be used again.
#![expect(clippy::needless_pass_by_value, reason = "array borrows come by value")]
#![expect(clippy::too_many_arguments, reason = "two poses are four arrays in Python")]
#![expect(non_snake_case, reason = "R is what the field, and so the Python side, calls a rotation")]

use numpy::ndarray::IxDyn;
use numpy::{
    Element, PyArray, PyArrayDyn, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2,
    PyReadonlyArray3, PyReadwriteArray, PyReadwriteArrayDyn,
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
pub(super) type Camera = (f64, f64, f64, f64, f64, usize, usize);

/// The meshes prepared for drawing, which each does once.
pub(super) fn models<'a>(
    py: Python<'_>,
    meshes: &'a [PyRef<'_, PyMesh>],
) -> PyResult<Vec<&'a Model>> {
    let meshes: Vec<&PyMesh> = meshes.iter().map(|mesh| &**mesh).collect();
    let one = |mesh: &'a PyMesh| mesh.model().map(|model| &**model);
    Ok(py.detach(|| meshes.into_iter().map(one).collect::<crate::Result<_>>())?)
}

/// Poses as views of a camera.
pub(super) fn views(
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

pub(super) fn rows(m: &[f64; 9]) -> [[f64; 3]; 3] {
    [[m[0], m[1], m[2]], [m[3], m[4], m[5]], [m[6], m[7], m[8]]]
}

pub(super) fn size((.., width, height): Camera) -> Size {
    Size { height, width }
}

/// A plane to be written to.
type Plane<'py, X> = Option<PyReadwriteArrayDyn<'py, X>>;

/// The plane of this name, if the caller wants it.
fn plane<'py, X: Element>(
    planes: &Bound<'py, PyDict>,
    name: &str,
    shape: &[usize],
) -> PyResult<Plane<'py, X>> {
    let Some(found) = planes.get_item(name)? else { return Ok(None) };
    let plane: PyReadwriteArrayDyn<'py, X> = found.extract()?;
    if plane.as_array().shape() != shape {
        let found = plane.as_array().shape().to_vec();
        let message = format!("{name}: expected shape {shape:?}, got {found:?}");
        return Err(PyValueError::new_err(message));
    }
    Ok(Some(plane))
}

fn slice<'a, X: Element>(plane: &'a mut Plane<'_, X>) -> PyResult<Option<&'a mut [X]>> {
    Ok(plane.as_mut().map(PyReadwriteArray::as_slice_mut).transpose()?)
}

/// Write the planes by name, `(B, H, W, ...)`.
#[pyfunction]
pub(super) fn gbuffer<'py>(
    py: Python<'py>,
    meshes: Vec<PyRef<'py, PyMesh>>,
    camera: Camera,
    R: PyReadonlyArray3<'py, f64>,
    t: PyReadonlyArray2<'py, f64>,
    planes: Bound<'py, PyDict>,
    normals: &str,
    attributes: Vec<Option<PyReadonlyArray2<'py, f64>>>,
    uv: Vec<Option<PyReadonlyArray3<'py, f64>>>,
    samples: usize,
    near: Option<f64>,
    double: bool,
    threads: usize,
) -> PyResult<()> {
    let shaded = planes.contains("normal")?;
    let meshes = Meshes::new(py, &meshes, (shaded, normals), &attributes, &uv)?;
    let views = views(&R, &t, camera)?;
    let request = Request { camera, views, samples, near, threads };
    if double {
        request.draw::<f64>(py, &meshes, &planes)
    } else {
        request.draw::<f32>(py, &meshes, &planes)
    }
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
        (shaded, normals): (bool, &str),
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
        let weight = weight.filter(|_| shaded);
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
    samples: usize,
    near: Option<f64>,
    threads: usize,
}

impl Request {
    fn draw<T: Pixel + Element>(
        &self,
        py: Python<'_>,
        meshes: &Meshes<'_>,
        planes: &Bound<'_, PyDict>,
    ) -> PyResult<()> {
        let surfaces = meshes.surfaces();
        let size = size(self.camera);
        let scenes = Scenes { surfaces: &surfaces, views: &self.views, size, near: self.near };
        scenes.check()?;
        let image = [scenes.images(), size.height, size.width];
        let with = |channels: usize| [image[0], image[1], image[2], channels];
        let mut mask = plane::<bool>(planes, "mask", &image)?;
        let mut object = plane::<i32>(planes, "object", &image)?;
        let mut face = plane::<i32>(planes, "face", &image)?;
        let mut depth = plane::<T>(planes, "depth", &image)?;
        let mut barycentrics = plane::<T>(planes, "barycentrics", &with(3))?;
        let mut normal = plane::<T>(planes, "normal", &with(3))?;
        let values = with(scenes.attribute_channels());
        let mut attributes = plane::<T>(planes, "attributes", &values)?;
        let mut uv = plane::<T>(planes, "uv", &with(2))?;
        let mut coverage = plane::<T>(planes, "coverage", &image)?;
        let mut coverage_each = plane::<T>(planes, "coverage_each", &with(surfaces.len()))?;
        let out = GBuffer {
            mask: slice(&mut mask)?,
            object: slice(&mut object)?,
            face: slice(&mut face)?,
            depth: slice(&mut depth)?,
            barycentrics: slice(&mut barycentrics)?,
            normal: slice(&mut normal)?,
            attributes: slice(&mut attributes)?,
            uv: slice(&mut uv)?,
        };
        let shares =
            [(Share::All, slice(&mut coverage)?), (Share::Each, slice(&mut coverage_each)?)];
        // Samples are many pixels to share out.
        let sampled = shares.iter().any(|(_, out)| out.is_some());
        let threads = if sampled { self.threads } else { scenes.threads(self.threads) };
        py.detach(|| {
            threads::install(threads, || {
                if !out.is_empty() {
                    scenes.draw(meshes.normals, out)?;
                }
                for (share, out) in shares {
                    if let Some(out) = out {
                        coverage::draw(&scenes, self.samples, share, out)?;
                    }
                }
                Ok::<_, crate::Error>(())
            })
        })??;
        Ok(())
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
        let threads = pairs.first.threads(threads);
        py.detach(|| threads::install(threads, || pairs.draw(flow, &mut found)))??;
    }
    let fate = PyArray::<u8, _>::zeros(py, IxDyn(&image), false);
    for (out, fate) in fate.readwrite().as_slice_mut()?.iter_mut().zip(found) {
        *out = fate as u8;
    }
    Ok((flow.into_any(), fate))
}
