//! The objects that are scored: meshes, symmetries, diameters, cameras.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

use crate::camera::Intrinsics;
use crate::error::{Error, Place, Result, shortened};
use crate::io::Unit;
use crate::io::bop::{ObjectInfo, parse_scene_camera, read_models_info};
use crate::io::input::{Input, InputFile};
use crate::io::mesh_file::read_mesh_file;
use crate::mesh::Mesh;
use crate::metrics::{Symmetries, VertexSet};

/// A mesh prepared for the metrics.
#[derive(Debug)]
pub struct MeshModel {
    /// All vertices, duplicates included.
    pub set: VertexSet,
    /// Diagonal of the bounding box, metres.
    pub diagonal: f64,
    /// Largest distance of two vertices, metres.
    pub diameter: f64,
}

impl MeshModel {
    /// Prepare a mesh.
    ///
    /// # Errors
    /// As [`VertexSet::with_hull`].
    pub fn new(mesh: &Mesh) -> Result<Self> {
        Ok(Self {
            set: VertexSet::with_hull(mesh.vertices(), mesh.hull_candidates())?,
            diagonal: mesh.bbox_diagonal(),
            diameter: mesh.diameter(),
        })
    }
}

/// What is known of one object.
#[derive(Debug, Clone)]
pub struct Object {
    /// Its mesh.
    pub mesh: Option<Arc<MeshModel>>,
    /// Its symmetries; only the identity by default.
    pub symmetries: Symmetries,
    /// Diameter as `models_info.json` says, metres; used for BOP's recalls.
    pub listed_diameter: Option<f64>,
}

impl Default for Object {
    fn default() -> Self {
        Self { mesh: None, symmetries: Symmetries::none(), listed_diameter: None }
    }
}

impl Object {
    /// The diameter that BOP's recalls refer to.
    #[must_use]
    pub fn bop_diameter(&self) -> Option<f64> {
        self.listed_diameter.or(self.mesh.as_ref().map(|m| m.diameter))
    }
}

/// All objects of an evaluation.
#[derive(Debug, Default)]
pub struct Objects {
    default: Object,
    by_id: BTreeMap<u32, Object>,
    /// The meshes read.
    pub mesh_files: Vec<InputFile>,
    /// The symmetry file read.
    pub symmetry_file: Option<InputFile>,
    /// Unit of the meshes.
    pub unit: Option<Unit>,
    /// What the user should know.
    pub warnings: Vec<String>,
}

impl Objects {
    /// One mesh in memory, in metres, for everything; its digest is that of the vertices.
    ///
    /// # Errors
    /// As [`MeshModel::new`].
    pub fn from_mesh(mesh: &Mesh) -> Result<Self> {
        let mut objects = Self::default();
        objects.default.mesh = Some(Arc::new(MeshModel::new(mesh)?));
        objects.unit = Some(Unit::Metre);
        let numbers = mesh.vertices().iter().flat_map(glam::DVec3::to_array);
        objects.mesh_files.push(InputFile::array("mesh", numbers));
        Ok(objects)
    }

    /// The object with a BOP id, or the one object of other files.
    #[must_use]
    pub fn get(&self, id: Option<u32>) -> &Object {
        id.and_then(|id| self.by_id.get(&id)).unwrap_or(&self.default)
    }

    /// The largest number of symmetry transforms of an object, the identity included.
    #[must_use]
    pub fn max_symmetries(&self) -> usize {
        let all = std::iter::once(&self.default).chain(self.by_id.values());
        all.map(|o| o.symmetries.transforms().len()).max().unwrap_or(1)
    }

    /// Read `--mesh`: a mesh file, or a BOP `models` folder (`obj_000001.ply`, ..., in
    /// millimetres unless `unit` says otherwise, and `models_info.json`).
    ///
    /// # Errors
    /// [`Error::Read`], [`Error::Malformed`].
    pub fn read_mesh(&mut self, path: &Path, unit: Option<Unit>) -> Result<()> {
        if !path.is_dir() {
            let unit = unit.unwrap_or(Unit::Metre);
            self.unit = Some(unit);
            self.default.mesh = Some(self.load(path, unit)?);
            return Ok(());
        }
        let unit = unit.unwrap_or(Unit::Millimetre);
        self.unit = Some(unit);
        let read = |source| Error::Read { path: path.to_owned(), source };
        let mut files = Vec::new();
        for entry in std::fs::read_dir(path).map_err(read)? {
            let file = entry.map_err(read)?.path();
            let stem = file.file_stem().and_then(|s| s.to_str()).unwrap_or_default();
            if let Some(id) = stem.strip_prefix("obj_").and_then(|n| n.parse::<u32>().ok())
                && file.extension().is_some_and(|e| e == "ply" || e == "obj" || e == "stl")
            {
                files.push((id, file));
            }
        }
        files.sort();
        if files.is_empty() {
            return Err(Error::malformed(
                Place::file(&path.display().to_string()),
                "a directory without obj_000001.ply",
                "a mesh file, or the models folder of a BOP data set",
            ));
        }
        for (id, file) in files {
            let mesh = self.load(&file, unit)?;
            self.by_id.insert(id, Object { mesh: Some(mesh), ..Object::default() });
        }
        let infos = path.join("models_info.json");
        if infos.is_file() { self.read_symmetries(&infos, unit, None) } else { Ok(()) }
    }

    fn load(&mut self, path: &Path, unit: Unit) -> Result<Arc<MeshModel>> {
        let (mesh, file) = read_mesh_file(path)?;
        self.mesh_files.push(file);
        // Dividing rounds once; multiplying by 0.001 would round twice.
        let metres =
            |v: glam::DVec3| glam::DVec3::from_array(v.to_array().map(|c| unit.to_metres(c)));
        let vertices = mesh.vertices().iter().copied().map(metres).collect();
        let mesh = Mesh::new(vertices, mesh.faces().to_vec())?;
        let model = MeshModel::new(&mesh)?;
        if !(0.01..=50.0).contains(&model.diagonal) {
            self.warnings.push(format!(
                "{}: the bounding-box diagonal of the mesh is {:.4} m; if the file is not in {} pass \
                 --mesh-unit",
                path.display(),
                model.diagonal,
                match unit {
                    Unit::Metre => "metres",
                    Unit::Centimetre => "centimetres",
                    Unit::Millimetre => "millimetres",
                }
            ));
        }
        Ok(Arc::new(model))
    }

    /// Read `--symmetries`: `models_info.json`, or the symmetry keys of a single object. The
    /// entry of the mesh is found by object id or by the mesh's file name.
    ///
    /// # Errors
    /// [`Error::Read`], [`Error::Malformed`]; [`Error::Mismatch`] if it is unclear which object is
    /// meant.
    pub fn read_symmetries(&mut self, path: &Path, unit: Unit, mesh: Option<&Path>) -> Result<()> {
        let (infos, file) = read_models_info(Input::open(path)?, unit)?;
        let place = Place::file(&file.path);
        self.symmetry_file = Some(file);
        let name = |p: &Path| p.file_name().map(|n| n.to_string_lossy().into_owned());
        let stem = |p: &Path| p.file_stem().map(|n| n.to_string_lossy().into_owned());
        let wanted: Vec<String> =
            mesh.into_iter().flat_map(|m| [name(m), stem(m)]).flatten().collect();
        let number =
            |key: &str| key.parse::<u32>().ok().or_else(|| key.strip_prefix("obj_")?.parse().ok());
        let of_mesh = wanted.iter().find_map(|w| {
            infos.get(w).or_else(|| {
                infos
                    .iter()
                    .find(|(k, _)| number(k).is_some() && number(k) == number(w))
                    .map(|(_, i)| i)
            })
        });
        if let Some(info) = of_mesh.or_else(|| infos.values().next().filter(|_| infos.len() == 1)) {
            set_info(&mut self.default, info, &place)?;
        } else if !infos.keys().all(|k| number(k).is_some()) {
            let keys: Vec<_> = infos.keys().take(12).map(|k| shortened(k.as_bytes())).collect();
            return Err(Error::Mismatch {
                place,
                message: format!(
                    "none of its objects ({}) is named like the mesh; rename the key, or keep only one",
                    keys.join(", ")
                ),
            });
        }
        for (key, info) in &infos {
            if let Some(id) = number(key) {
                let mut object = self.by_id.remove(&id).unwrap_or_else(|| self.default.clone());
                set_info(&mut object, info, &place)?;
                self.by_id.insert(id, object);
            }
        }
        Ok(())
    }
}

fn set_info(object: &mut Object, info: &ObjectInfo, place: &Place) -> Result<()> {
    object.symmetries = Symmetries::new(&info.discrete, &info.continuous, 0.01)
        .map_err(|e| Error::Mismatch { place: place.clone(), message: e.to_string() })?;
    object.listed_diameter = info.diameter;
    Ok(())
}

/// Intrinsics of the images.
#[derive(Debug, Clone, Default)]
pub struct Cameras {
    default: Option<Intrinsics>,
    by_image: BTreeMap<u32, Intrinsics>,
    /// The file they came from.
    pub file: Option<InputFile>,
    /// How the user gave them.
    pub text: Option<String>,
}

impl Cameras {
    /// One camera for every image.
    #[must_use]
    pub fn of(camera: Intrinsics) -> Self {
        Self { default: Some(camera), ..Self::default() }
    }

    /// From `--camera`: `fx,fy,cx,cy,W,H`, or a JSON file with `fx fy cx cy [width height]` (BOP's
    /// `camera.json`), with `K` or `cam_K`, or BOP's `scene_camera.json`.
    ///
    /// # Errors
    /// [`Error::Argument`] naming the field; [`Error::Read`], [`Error::Malformed`] for a file.
    pub fn read(text: &str) -> Result<Self> {
        let path = Path::new(text);
        if let Some(camera) = Self::from_text(text) {
            return camera;
        }
        let mut input = Input::open(path)?;
        let bytes = input.read_all(256 << 20)?;
        let mut cameras = Self::parse(text, &bytes)?;
        cameras.text = Some(text.to_owned());
        cameras.file = Some(input.finish("json")?);
        Ok(cameras)
    }

    /// From `fx,fy,cx,cy,W,H`; `None` if the text is no list, or is the name of a file.
    #[must_use]
    pub fn from_text(text: &str) -> Option<Result<Self>> {
        if !text.contains(',') || Path::new(text).exists() {
            return None;
        }
        let camera = Intrinsics::parse(text);
        let text = Some(text.to_owned());
        Some(camera.map(|c| Self { default: Some(c), text, ..Self::default() }))
    }

    /// From the bytes of a JSON file, for messages called `name`.
    ///
    /// # Errors
    /// As [`Cameras::read`].
    pub fn parse(name: &str, bytes: &[u8]) -> Result<Self> {
        let mut cameras = Self::default();
        cameras.fill(bytes, name)?;
        Ok(cameras)
    }

    fn fill(&mut self, bytes: &[u8], name: &str) -> Result<()> {
        let expected = "a camera: {\"fx\", \"fy\", \"cx\", \"cy\", \"width\", \"height\"}, {\"K\": [9 numbers]}, \
                        or BOP's scene_camera.json";
        let value: serde_json::Value = serde_json::from_slice(bytes)
            .map_err(|e| crate::io::bop::json_error(name, &e, expected))?;
        let refuse = |e: &Error| Error::malformed(Place::file(name), e.to_string(), expected);
        let number = |key: &str| value.get(key).and_then(serde_json::Value::as_f64);
        let size = |keys: [&str; 2]| {
            let n = keys.iter().find_map(|k| value.get(*k)?.as_u64());
            n.and_then(|n| u32::try_from(n).ok())
        };
        let (width, height) = (size(["width", "W"]), size(["height", "H"]));
        if let (Some(fx), Some(fy), Some(cx), Some(cy)) =
            (number("fx"), number("fy"), number("cx"), number("cy"))
        {
            let skew = number("skew").unwrap_or(0.0);
            let camera = Intrinsics::from_matrix([[fx, skew, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]]);
            self.default = Some(Intrinsics { width, height, ..camera.map_err(|e| refuse(&e))? });
            return Ok(());
        }
        if let Some(k) = ["K", "cam_K", "camera_matrix"].iter().find_map(|k| value.get(k)) {
            let mut flat = Vec::new();
            flatten(k, &mut flat);
            let k: [f64; 9] = flat.as_slice().try_into().map_err(|_| {
                let found = format!("a matrix of {} numbers", flat.len());
                Error::malformed(Place::file(name).column("K"), found, "9 numbers, row by row")
            })?;
            let camera = from_k(&k).map_err(|e| refuse(&e))?;
            self.default = Some(Intrinsics { width, height, ..camera });
            return Ok(());
        }
        for (image, k) in parse_scene_camera(bytes, name)? {
            let camera = from_k(&k).map_err(|e| {
                let place = Place::file(name).column(format!("{image}.cam_K"));
                Error::malformed(place, e.to_string(), "a camera matrix")
            })?;
            self.by_image.insert(image, camera);
        }
        if self.by_image.is_empty() {
            return Err(Error::malformed(Place::file(name), "no camera", expected));
        }
        Ok(())
    }

    /// There is no camera.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.default.is_none() && self.by_image.is_empty()
    }

    /// Intrinsics of an image, or those of all.
    #[must_use]
    pub fn get(&self, image: Option<u32>) -> Option<&Intrinsics> {
        image.and_then(|i| self.by_image.get(&i)).or(self.default.as_ref())
    }

    /// Image width, where it is the same for all.
    #[must_use]
    pub fn width(&self) -> Option<u32> {
        self.default.as_ref().and_then(|c| c.width)
    }
}

fn from_k(k: &[f64; 9]) -> Result<Intrinsics> {
    Intrinsics::from_matrix([[k[0], k[1], k[2]], [k[3], k[4], k[5]], [k[6], k[7], k[8]]])
}

fn flatten(value: &serde_json::Value, out: &mut Vec<f64>) {
    match value {
        serde_json::Value::Array(items) if out.len() <= 9 => {
            for item in items {
                flatten(item, out);
            }
        }
        other => out.extend(other.as_f64()),
    }
}
