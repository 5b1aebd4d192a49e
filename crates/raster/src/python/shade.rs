//! Bindings of [`crate::shade`] and [`crate::gbuffer::appearance`].
//!
//! Rows of poses are `B * M`, as in the bindings of the G-buffer.
#![expect(clippy::needless_pass_by_value, reason = "array borrows come by value")]
#![expect(clippy::too_many_arguments, reason = "a scene is many arrays in Python")]
#![expect(non_snake_case, reason = "R is what the field, and so the Python side, calls a rotation")]

use numpy::{
    PyArray1, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2, PyReadonlyArray3,
    PyReadwriteArray3, PyReadwriteArray4, PyUntypedArrayMethods,
};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use super::gbuffer::{Camera, models, rows, size, views};
use super::mesh::PyMesh;
use crate::gbuffer::appearance::{self, Colours};
use crate::gbuffer::normals::{self, Weight};
use crate::gbuffer::{Scenes, Surface};
use crate::raster::View;
use crate::shade::{Environment, Light, Look, Material, Materials, Paint, Texture, srgb};
use crate::threads;

/// A pyramid of images of sRGB colours, which repeats.
#[pyclass(frozen, name = "Texture", module = "dronepose._native")]
pub(super) struct PyTexture(Texture);

#[pymethods]
impl PyTexture {
    /// From `(H, W, 3)` bytes, or `(H, W, 4)` with opacity.
    #[new]
    fn new(py: Python<'_>, image: PyReadonlyArray3<'_, u8>) -> PyResult<Self> {
        let (size, opacity) = ((image.shape()[0], image.shape()[1]), image.shape()[2] == 4);
        let bytes = image.as_slice()?;
        let new = if opacity { Texture::with_opacity } else { Texture::new };
        let made = py.detach(|| new(size, bytes));
        Ok(Self(made?))
    }

    /// Rows and columns.
    #[getter]
    fn size(&self) -> (usize, usize) {
        self.0.size()
    }

    /// Mean of linear RGB.
    #[getter]
    fn mean(&self) -> [f32; 3] {
        self.0.mean()
    }
}

/// An environment map, prepared for lighting.
#[pyclass(frozen, name = "Environment", module = "dronepose._native")]
pub(super) struct PyEnvironment(Environment);

#[pymethods]
impl PyEnvironment {
    /// From `(H, W, 3)` linear radiance.
    #[new]
    fn new(py: Python<'_>, rgb: PyReadonlyArray3<'_, f32>, threads: usize) -> PyResult<Self> {
        let shape = (rgb.shape()[0], rgb.shape()[1]);
        let rgb = rgb.as_slice()?;
        let made = py.detach(|| threads::install(threads, || Environment::new(shape, rgb)))?;
        Ok(Self(made?))
    }

    /// Mean radiance over the sphere.
    #[getter]
    fn mean(&self) -> [f32; 3] {
        self.0.mean()
    }

    /// Irradiance over pi for a unit normal.
    fn scattered(&self, normal: [f64; 3]) -> [f32; 3] {
        self.0.scattered(normal)
    }

    /// Radiance from around a unit direction for a roughness.
    fn mirrored(&self, direction: [f64; 3], roughness: f64) -> [f32; 3] {
        self.0.mirrored(direction, roughness)
    }
}

/// Texture, or linear RGB, and roughness and metallic share where the material is lit.
type Made<'py> = (Option<PyRef<'py, PyTexture>>, [f32; 3], Option<(f64, f64)>);

/// Environment, strength, `world_from_camera` row by row.
type Lit<'py> = (PyRef<'py, PyEnvironment>, f32, [f64; 9]);

/// Write `(B, H, W, 4)`: linear RGB times coverage and opacity, and coverage; and `(B, H, W, M)`: the share of
/// each mesh; and `(B, H, W)`: the share that shows what is behind.
#[pyfunction]
pub(super) fn colours(
    py: Python<'_>,
    meshes: Vec<PyRef<'_, PyMesh>>,
    camera: Camera,
    R: PyReadonlyArray3<'_, f64>,
    t: PyReadonlyArray2<'_, f64>,
    uv: Vec<Option<PyReadonlyArray3<'_, f64>>>,
    materials: Vec<Vec<Made<'_>>>,
    of_faces: Vec<Option<PyReadonlyArray1<'_, u32>>>,
    lights: Vec<Lit<'_>>,
    smooth: bool,
    samples: usize,
    near: Option<f64>,
    threads: usize,
    mut out: PyReadwriteArray4<'_, f32>,
    mut shares: PyReadwriteArray4<'_, f32>,
    mut veil: PyReadwriteArray3<'_, f32>,
) -> PyResult<()> {
    let models = models(py, &meshes)?;
    let views: Vec<View> = views(&R, &t, camera)?;
    if [uv.len(), materials.len(), of_faces.len()] != [models.len(); 3] {
        return Err(PyValueError::new_err("materials: expected one list for each mesh"));
    }
    let wanted = |k: usize| smooth && materials[k].iter().any(|made| made.2.is_some());
    let of_vertices: Vec<_> = (0..models.len())
        .map(|k| wanted(k).then(|| normals::of_vertices(models[k], Weight::Angle)))
        .collect();
    let corners: Vec<_> = uv
        .iter()
        .map(|uv| uv.as_ref().map(PyReadonlyArray3::as_slice).transpose())
        .collect::<Result<_, _>>()?;
    let surfaces: Vec<_> = (0..models.len())
        .map(|k| Surface {
            normals: of_vertices[k].as_deref(),
            uv: corners[k].map(|n| n.as_chunks::<2>().0.as_chunks::<3>().0),
            ..Surface::new(models[k])
        })
        .collect();
    let made: Vec<Vec<_>> =
        materials.iter().map(|list| list.iter().map(material).collect()).collect();
    let lists: Vec<_> = made.iter().map(Vec::as_slice).collect();
    let of_faces: Vec<_> = of_faces
        .iter()
        .map(|of| of.as_ref().map(PyReadonlyArray1::as_slice).transpose())
        .collect::<Result<_, _>>()?;
    let lights: Vec<_> = lights
        .iter()
        .map(|(environment, strength, turn)| Light {
            environment: &environment.0,
            strength: *strength,
            world_from_camera: rows(turn),
        })
        .collect();
    let size = size(camera);
    let scenes = Scenes { surfaces: &surfaces, views: &views, size, near };
    scenes.check()?;
    let materials = Materials { of_surfaces: &lists, of_faces: &of_faces, lights: &lights };
    materials.check(&surfaces, scenes.images())?;
    let expected = [scenes.images(), size.height, size.width, 4];
    if out.shape() != expected {
        let message = format!("out: expected shape {expected:?}, got {:?}", out.shape());
        return Err(PyValueError::new_err(message));
    }
    if shares.shape() != [expected[0], expected[1], expected[2], models.len()] {
        return Err(PyValueError::new_err("shares: expected shape (B, H, W, M)"));
    }
    if veil.shape() != &expected[..3] {
        return Err(PyValueError::new_err("veil: expected shape (B, H, W)"));
    }
    let out = Colours {
        colour: out.as_slice_mut()?,
        shares: Some(shares.as_slice_mut()?),
        veil: Some(veil.as_slice_mut()?),
    };
    py.detach(|| {
        threads::install(threads, || appearance::draw(&scenes, samples, &materials, out))
    })??;
    Ok(())
}

fn material<'a>((texture, colour, lit): &'a Made<'_>) -> Material<'a> {
    let paint = match texture {
        Some(texture) => Paint::Texture(&texture.0),
        None => Paint::Colour(*colour),
    };
    let look = match *lit {
        Some((roughness, metallic)) => Look::Lit { roughness, metallic },
        None => Look::Unlit,
    };
    Material { paint, look }
}

/// sRGB bytes of linear values, flat.
#[pyfunction]
pub(super) fn srgb_bytes<'py>(
    py: Python<'py>,
    linear: PyReadonlyArray1<'py, f32>,
) -> PyResult<Bound<'py, PyArray1<u8>>> {
    let linear = linear.as_slice()?;
    let out = PyArray1::zeros(py, linear.len(), false);
    {
        let mut out = out.readwrite();
        let out = out.as_slice_mut()?;
        py.detach(|| srgb::encode_all(linear, out));
    }
    Ok(out)
}

/// Linear values of sRGB bytes, flat.
#[pyfunction]
pub(super) fn srgb_linear<'py>(
    py: Python<'py>,
    bytes: PyReadonlyArray1<'py, u8>,
) -> PyResult<Bound<'py, PyArray1<f32>>> {
    let linear: Vec<f32> = bytes.as_slice()?.iter().map(|&byte| srgb::decode(byte)).collect();
    Ok(PyArray1::from_vec(py, linear))
}
