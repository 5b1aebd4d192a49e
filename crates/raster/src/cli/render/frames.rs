//! Which poses are drawn, with which camera, over which background, and into which files.

use std::collections::HashSet;
use std::path::{Path, PathBuf};

use super::args::Args;
use crate::camera::Intrinsics;
use crate::error::{Error, Place, Result};
use crate::eval::Cameras;
use crate::io::PoseTable;
use crate::io::png::picture_size;
use crate::pose::Pose;
use crate::raster::{Size, View};

/// One picture to draw.
#[derive(Debug, Clone)]
pub(super) struct Frame {
    /// Row of the table of poses.
    pub(super) row: usize,
    pub(super) id: String,
    /// Line in the file, where it has lines.
    pub(super) line: Option<u64>,
    /// Name of its files without the ending.
    pub(super) name: String,
    pub(super) pose: Pose,
    pub(super) view: View,
    pub(super) background: Option<PathBuf>,
}

impl Frame {
    /// Of the picture.
    pub(super) fn size(&self) -> Size {
        let side = |n: Option<u32>| n.unwrap_or(0) as usize;
        let camera = &self.view.camera;
        Size { height: side(camera.height), width: side(camera.width) }
    }

    /// The rectangle at `(x, y)` of this size in pixels, each pixel drawn as `times` by `times`.
    pub(super) fn window(&self, corner: [usize; 2], size: Size, times: usize) -> Self {
        let (k, s) = (self.view.camera, times as f64);
        let [x, y] = corner.map(|c| c as f64);
        let moved = Intrinsics {
            fx: s * k.fx,
            fy: s * k.fy,
            cx: s * (k.cx - x),
            cy: s * (k.cy - y),
            skew: s * k.skew,
            ..k
        };
        let camera = moved.with_size((size.width * times) as u32, (size.height * times) as u32);
        Self { view: View { camera, ..self.view }, ..self.clone() }
    }
}

/// Longest name of a file, so that endings and the marks of unfinished files still fit.
const LONGEST_NAME: usize = 120;

/// Names of files for ids, in order: letters, digits, `.`, `_` and `-` stay, everything else is
/// `_`; the ending of a picture is dropped. No two are equal, whatever the case of their letters.
pub(super) fn names<'a>(ids: impl Iterator<Item = std::borrow::Cow<'a, str>>) -> Vec<String> {
    let mut taken = HashSet::new();
    ids.map(|id| {
        let plain = sanitised(&id);
        let mut name = plain.clone();
        let mut count = 1;
        while !taken.insert(name.to_ascii_lowercase()) {
            count += 1;
            name = format!("{plain}-{count}");
        }
        name
    })
    .collect()
}

fn sanitised(id: &str) -> String {
    let stem = match id.rsplit_once('.') {
        Some((stem, "png" | "jpg" | "jpeg" | "PNG" | "JPG" | "JPEG")) if !stem.is_empty() => stem,
        _ => id,
    };
    let kept = |c: char| if c.is_ascii_alphanumeric() || "._-".contains(c) { c } else { '_' };
    let name: String = stem.chars().map(kept).take(LONGEST_NAME).collect();
    // Neither hidden files nor options, nor the folders . and ..
    let name = name.trim_start_matches(['.', '-']);
    if name.is_empty() { "_".to_owned() } else { name.to_owned() }
}

/// Size of the pictures, and the camera of each image.
#[derive(Debug)]
pub(super) struct CameraOf {
    cameras: Cameras,
    integer_centers: bool,
    pub(super) size: Size,
}

impl CameraOf {
    /// The camera that the arguments describe.
    pub(super) fn read(args: &Args) -> Result<Self> {
        let mut integer_centers = args.integer_centers;
        let cameras = if let (Some(fov), Some((w, h))) = (args.fov, args.size) {
            let (w, h) = (f64::from(w), f64::from(h));
            let f = 0.5 * h / (0.5 * fov.to_radians()).tan();
            integer_centers = false;
            Cameras::of(Intrinsics::new(f, f, 0.5 * w, 0.5 * h)?)
        } else {
            Cameras::read(args.camera.as_deref().unwrap_or_default())?
        };
        args.sized(cameras.get(None))?;
        let own = cameras.get(None).and_then(|c| c.width.zip(c.height));
        let (width, height) = own.or(args.size).unwrap_or_default();
        let size = Size { height: height as usize, width: width as usize };
        Ok(Self { cameras, integer_centers, size })
    }

    /// The intrinsics of an image, its pixel centres at `+ 0.5`.
    pub(super) fn get(&self, image: Option<u32>) -> Option<Intrinsics> {
        let camera = *self.cameras.get(image)?;
        let half = if self.integer_centers { 0.5 } else { 0.0 };
        let moved = Intrinsics { cx: camera.cx + half, cy: camera.cy + half, ..camera };
        Some(moved.with_size(self.size.width as u32, self.size.height as u32))
    }

    /// For the record: one camera, or those of the frames by name.
    pub(super) fn record(&self, frames: &[Frame]) -> serde_json::Value {
        let one = |k: &Intrinsics| {
            serde_json::json!({
                "fx": k.fx, "fy": k.fy, "cx": k.cx, "cy": k.cy, "skew": k.skew,
                "width": self.size.width, "height": self.size.height,
            })
        };
        match self.get(None) {
            Some(camera) => one(&camera),
            None => frames.iter().map(|f| (f.name.clone(), one(&f.view.camera))).collect(),
        }
    }
}

/// The frames that the arguments ask for.
pub(super) fn select(args: &Args, table: &PoseTable, camera: &CameraOf) -> Result<Vec<Frame>> {
    let all = names((0..table.len()).map(|row| table.id(row)));
    let wanted: HashSet<&str> = args.id.iter().map(String::as_str).collect();
    let known: HashSet<_> = if wanted.is_empty() {
        HashSet::new()
    } else {
        (0..table.len()).map(|row| table.id(row)).collect()
    };
    if let Some(missing) = args.id.iter().find(|id| !known.contains(id.as_str())) {
        return Err(Error::Mismatch {
            place: Place::file(&table.name).column("id"),
            message: format!(
                "--id: found no sample '{missing}', expected ids like '{}'",
                table.id(0)
            ),
        });
    }
    let rows = (0..table.len()).filter(|&r| wanted.is_empty() || wanted.contains(&*table.id(r)));
    let limit = args.limit.map_or(usize::MAX, |n| n as usize);
    let mut frames = Vec::new();
    for row in rows.step_by(args.every as usize).take(limit) {
        let image = table.targets.as_ref().map(|t| t[row].image);
        let id = table.id(row).into_owned();
        let Some(intrinsics) = camera.get(image) else {
            return Err(Error::Mismatch {
                place: table.place(row, "id"),
                message: format!(
                    "--camera: found no camera for image {}, expected one for each",
                    image.map_or_else(|| id.clone(), |i| i.to_string())
                ),
            });
        };
        let pose = table.poses[row];
        let m = pose.matrix().transpose().to_cols_array_2d();
        let view =
            View { rotation: m, translation: pose.translation.to_array(), camera: intrinsics };
        let background = match &args.background {
            Some(path) => Some(background(path, &id, &all[row], camera.size)?),
            None => None,
        };
        let name = all[row].clone();
        frames.push(Frame { row, id, line: table.line(row), name, pose, view, background });
    }
    if let Some(one) = args.background.as_deref().filter(|p| !p.is_dir()) {
        of_size(one, camera.size)?;
    }
    Ok(frames)
}

/// The picture behind a frame.
fn background(path: &Path, id: &str, name: &str, size: Size) -> Result<PathBuf> {
    if !path.is_dir() {
        return Ok(path.to_owned());
    }
    let endings = ["", ".png", ".jpg", ".jpeg", ".PNG", ".JPG", ".JPEG"];
    let mut stems = vec![name];
    // An id may name a file below the folder, and nothing above it.
    if Path::new(id).components().all(|c| matches!(c, std::path::Component::Normal(_))) {
        stems.insert(0, id);
    }
    let files = stems.iter().flat_map(|s| endings.map(|e| path.join(format!("{s}{e}"))));
    match files.into_iter().find(|f| f.is_file()) {
        Some(file) => of_size(&file, size).map(|()| file),
        None => Err(Error::Mismatch {
            place: Place::file(&path.display().to_string()),
            message: format!("found no picture for '{id}', expected {name}.png or {name}.jpg"),
        }),
    }
}

fn of_size(path: &Path, size: Size) -> Result<()> {
    let (w, h) = picture_size(path)?;
    if (w, h) == (size.width, size.height) {
        return Ok(());
    }
    Err(Error::malformed(
        Place::file(&path.display().to_string()),
        format!("a picture of {w}x{h} pixels"),
        format!("{}x{}, as the camera says", size.width, size.height),
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn named(ids: &[&str]) -> Vec<String> {
        names(ids.iter().map(|&id| id.into()))
    }

    #[test]
    fn names_are_safe_and_unique() {
        let names = named(&["a", "A", "../../etc/passwd", "img1.jpg", "img1.png", "", "..", "é b"]);
        assert_eq!(names, ["a", "A-2", "_.._etc_passwd", "img1", "img1-2", "_", "_-2", "__b"]);
        assert_eq!(named(&["a-2", "a", "A", "a/"]), ["a-2", "a", "A-3", "a_"]);
        assert_eq!(named(&["1/2/3", "frame.0001", ".jpg"]), ["1_2_3", "frame.0001", "jpg"]);
        assert_eq!(named(&["x".repeat(1000).as_str()])[0].len(), LONGEST_NAME);
    }
}
