//! The command line of `dronepose render`.

use std::path::PathBuf;

use clap::{ArgGroup, Parser, ValueEnum};

use crate::camera::Intrinsics;
use crate::cli::args::{MeshUnit, PoseUnit};
use crate::error::{Error, Result};
use crate::eval::Cameras;
use crate::raster::{DEFAULT_NEAR, KaolinCutoff, Mode, Pytorch3dCutoff};

const EXAMPLES: &str = "\
Examples:
  dronepose render drone.obj poses.csv --camera 252.7,252.7,160,120,320,240 --out drawn
  dronepose render drone.obj poses.csv --fov 50.8 --size 320x240 --out drawn --sigma 1.5
  dronepose render drone.obj poses.csv --camera camera.json --out drawn --save depth,normal --format npy
  dronepose render drone.obj poses.csv --camera camera.json --out drawn --save overlay --background frames
  dronepose render drone.obj poses.csv --camera camera.json --out drawn --limit 1 --compare

Files are OUT/LAYER/ID.png and .npy; OUT/manifest.json says how they were made. A run that was
interrupted goes on where it stopped. Poses are cam_from_model in the OpenCV camera frame, metres;
the centre of the first pixel is (0.5, 0.5). Exit codes: 0 done, 1 an input was refused, 2 the
command line was not understood, 130 interrupted.";

/// Draw a mesh under poses: silhouettes, depth, normals, overlays.
#[derive(Debug, Parser)]
#[command(
    name = "dronepose render",
    version,
    after_help = EXAMPLES,
    max_term_width = 100,
    group = ArgGroup::new("view").args(["camera", "fov"]).required(true),
)]
#[expect(clippy::struct_excessive_bools, reason = "each is a flag of the command line")]
pub struct Args {
    /// Mesh of the object: OBJ, PLY or STL; .gz is unpacked
    pub mesh: PathBuf,
    /// Poses: CSV as for `dronepose eval`, BOP `scene_gt.json` or results, SPEED labels; - is stdin
    pub poses: PathBuf,
    /// Folder for the pictures; made if it is not there
    #[arg(long, short, value_name = "FOLDER")]
    pub out: PathBuf,

    /// Intrinsics in pixels, or a JSON file (camera.json, `scene_camera.json`)
    #[arg(long, value_name = "fx,fy,cx,cy,W,H|FILE", help_heading = "Camera")]
    pub camera: Option<String>,
    /// Vertical field of view in degrees, of a camera that looks through the middle of the picture
    #[arg(long, value_name = "DEGREES", requires = "size", help_heading = "Camera")]
    pub fov: Option<f64>,
    /// Size of the pictures, where the camera does not say it
    #[arg(long, value_name = "WxH", value_parser = size, help_heading = "Camera")]
    pub size: Option<(u32, u32)>,
    /// The camera's cx, cy count from the centre of the first pixel, as those of OpenCV and BOP do:
    /// half a pixel is added
    #[arg(long, help_heading = "Camera")]
    pub integer_centers: bool,
    /// Distance in metres below which the mesh is cut off
    #[arg(long, value_name = "METRES", default_value_t = DEFAULT_NEAR, help_heading = "Camera")]
    pub near: f64,

    /// Unit of the mesh
    #[arg(long, value_name = "UNIT", default_value = "m", help_heading = "Inputs")]
    pub mesh_unit: MeshUnit,
    /// Unit of the translations [default: m; mm for BOP files]
    #[arg(long, value_name = "UNIT", help_heading = "Inputs")]
    pub unit: Option<PoseUnit>,
    /// Draw only the poses of this object of a BOP file
    #[arg(long, value_name = "ID", help_heading = "Inputs")]
    pub object: Option<u32>,
    /// Draw only these samples (repeatable)
    #[arg(long, value_name = "ID", help_heading = "Inputs")]
    pub id: Vec<String>,
    /// Draw the first of every K poses
    #[arg(long, value_name = "K", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..), help_heading = "Inputs")]
    pub every: u32,
    /// Draw at most so many
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..), help_heading = "Inputs")]
    pub limit: Option<u32>,

    /// How silhouettes are drawn; docs/rendering.md says which to use when
    #[arg(long, value_name = "MODE", default_value = "coverage", help_heading = "Silhouette")]
    pub mode: ModeName,
    /// Blur of the mode coverage: standard deviation in pixels, 0 for none [default:
    /// 0]
    #[arg(long, value_name = "PIXELS", help_heading = "Silhouette", allow_negative_numbers = true)]
    pub sigma: Option<f64>,
    /// Sharpness of the mode dibr: Kaolin's sigmainv, p = exp(-delta d²), d in NDC [default: 7000]
    #[arg(long, value_name = "DELTA", help_heading = "Silhouette", allow_negative_numbers = true)]
    pub delta: Option<f64>,
    /// Width of the mode sigmoid: PyTorch3D's sigma, p = sigmoid(d² / sigma), d in NDC [default:
    /// 1e-4]
    #[arg(long, value_name = "SIGMA", help_heading = "Silhouette", allow_negative_numbers = true)]
    pub sigma_ndc: Option<f64>,
    /// Draw dibr and sigmoid with the cut-offs of Kaolin (boxlen 0.02, 30 faces) and PyTorch3D
    /// (50 faces), not exactly
    #[arg(long, help_heading = "Silhouette")]
    pub cutoffs: bool,

    /// What to write [default: silhouette; nothing more with --compare or --contact-sheet]
    #[arg(long, value_name = "LAYER,...", value_delimiter = ',', help_heading = "Output")]
    pub save: Vec<Layer>,
    /// Of silhouettes, depth and normals: pictures, arrays of float32, or both
    #[arg(
        long,
        value_name = "png,npy",
        value_delimiter = ',',
        default_value = "png",
        help_heading = "Output"
    )]
    pub format: Vec<FileFormat>,
    /// Draw each pose in the four modes side by side, with an enlarged piece of the outline
    #[arg(long, help_heading = "Output")]
    pub compare: bool,
    /// Draw a sheet of small overlays with their ids, at most 64
    #[arg(long, help_heading = "Output")]
    pub contact_sheet: bool,
    /// Picture behind overlays, or a folder with ID.png or ID.jpg for each pose
    #[arg(long, value_name = "PICTURE|FOLDER", help_heading = "Output")]
    pub background: Option<PathBuf>,
    /// Draw overlays so many times as large as the camera's pictures
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=16), help_heading = "Output")]
    pub zoom: u32,
    /// Draw everything again, also over what was drawn in another way
    #[arg(long, help_heading = "Output")]
    pub force: bool,

    /// Print the manifest to standard output
    #[arg(long, help_heading = "Running")]
    pub json: bool,
    /// Threads; 0 for all cores. The pictures do not depend on it
    #[arg(long, value_name = "N", default_value_t = 0, help_heading = "Running")]
    pub threads: usize,
    /// Print neither the summary nor warnings
    #[arg(long, short, help_heading = "Running")]
    pub quiet: bool,
}

/// Name of a mode.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum ModeName {
    /// Exact area of the union of the triangles, then a Gaussian of --sigma pixels
    Coverage,
    /// 1 where the centre of the pixel is inside
    Hard,
    /// The soft mask of DIB-R (Kaolin), over all faces
    Dibr,
    /// The soft mask of SoftRas and PyTorch3D, over all faces
    Sigmoid,
}

/// What is drawn of a pose.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, ValueEnum)]
pub enum Layer {
    /// The mask of --mode, 0 to 1
    Silhouette,
    /// Distance along z; PNG in millimetres (16 bits), NPY in metres, 0 for none
    Depth,
    /// Unit normals in the camera frame; PNG holds (n + 1) / 2
    Normal,
    /// Silhouette, outline, axes and box over the background
    Overlay,
    /// The four above in a row, in colours for the eye
    Preview,
    /// The four modes (as --compare)
    #[value(skip)]
    Compare,
}

/// A kind of file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, ValueEnum)]
pub enum FileFormat {
    /// A picture.
    Png,
    /// An array of NumPy.
    Npy,
}

impl Layer {
    /// Its folder.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Silhouette => "silhouette",
            Self::Depth => "depth",
            Self::Normal => "normal",
            Self::Overlay => "overlay",
            Self::Preview => "preview",
            Self::Compare => "compare",
        }
    }

    /// Numbers, and not a picture for the eye only.
    #[must_use]
    pub fn is_data(self) -> bool {
        matches!(self, Self::Silhouette | Self::Depth | Self::Normal)
    }
}

impl FileFormat {
    /// The ending of a file's name.
    #[must_use]
    pub fn extension(self) -> &'static str {
        match self {
            Self::Png => "png",
            Self::Npy => "npy",
        }
    }
}

/// `320x240`.
fn size(text: &str) -> std::result::Result<(u32, u32), String> {
    let parts = text.split_once(['x', 'X']).or_else(|| text.split_once(','));
    let side = |s: &str| s.trim().parse::<u32>().ok().filter(|n| (1..=65_535).contains(n));
    parts
        .and_then(|(w, h)| Some((side(w)?, side(h)?)))
        .ok_or_else(|| "expected two numbers of pixels from 1 to 65535, such as 320x240".to_owned())
}

impl Args {
    /// The layers to write, each once, in the order of [`Layer`].
    #[must_use]
    pub fn layers(&self) -> Vec<Layer> {
        let mut layers = self.save.clone();
        if self.compare {
            layers.push(Layer::Compare);
        }
        if layers.is_empty() && !self.contact_sheet {
            layers.push(Layer::Silhouette);
        }
        layers.sort_unstable();
        layers.dedup();
        layers
    }

    /// The kinds of files, each once.
    #[must_use]
    pub fn formats(&self) -> Vec<FileFormat> {
        let mut formats = self.format.clone();
        formats.sort_unstable();
        formats.dedup();
        formats
    }

    /// A mode with the parameters given for it.
    #[must_use]
    pub fn mode(&self, name: ModeName) -> Mode {
        let sigma_ndc = self.sigma_ndc.unwrap_or(1e-4);
        match name {
            ModeName::Coverage => Mode::Coverage { sigma: self.sigma.unwrap_or(0.0) },
            ModeName::Hard => Mode::Hard,
            ModeName::Dibr => Mode::Dibr {
                delta: self.delta.unwrap_or(7000.0),
                cutoff: self.cutoffs.then_some(KaolinCutoff { boxlen: 0.02, knum: 30 }),
            },
            ModeName::Sigmoid => Mode::Sigmoid {
                sigma: sigma_ndc,
                // Where the probability is 1e-4, as PyTorch3D's tutorials choose it.
                cutoff: self.cutoffs.then(|| Pytorch3dCutoff {
                    blur_radius: (1.0_f64 / 1e-4 - 1.0).ln() * sigma_ndc,
                    faces_per_pixel: 50,
                }),
            },
        }
    }

    /// Refuses options that contradict each other, and parameters out of range.
    ///
    /// # Errors
    /// [`Error::Argument`] that names the option.
    pub fn check(&self) -> Result<()> {
        let of_mode = [
            ("--sigma", self.sigma.is_some(), ModeName::Coverage),
            ("--delta", self.delta.is_some(), ModeName::Dibr),
            ("--sigma-ndc", self.sigma_ndc.is_some(), ModeName::Sigmoid),
        ];
        for (option, given, mode) in of_mode {
            if given && mode != self.mode && !self.compare {
                let name = |m: ModeName| m.to_possible_value().map(|v| v.get_name().to_owned());
                let (of, now) = (name(mode).unwrap_or_default(), name(self.mode));
                let message = format!(
                    "belongs to --mode {of}, and the mode is {}; pass --mode {of}, or --compare",
                    now.unwrap_or_default()
                );
                return Err(Error::argument(option, message));
            }
        }
        for name in [ModeName::Coverage, ModeName::Dibr, ModeName::Sigmoid] {
            self.mode(name).check().map_err(|e| match e {
                Error::Argument { argument, message } => {
                    Error::argument(format!("--{}", argument.replace('_', "-")), message)
                }
                other => other,
            })?;
        }
        if self.near.is_nan() || !(1e-9..=1e9).contains(&self.near) {
            let message = format!("{}; expected 1e-9 to 1e9 metres", self.near);
            return Err(Error::argument("--near", message));
        }
        if let Some(fov) = self.fov.filter(|f| !(*f > 0.0 && *f < 180.0)) {
            return Err(Error::argument("--fov", format!("{fov}; expected 0 to 180 degrees")));
        }
        if self.fov.is_some() && self.integer_centers {
            let message = "--fov already puts the centre in the middle of the picture";
            return Err(Error::argument("--integer-centers", message));
        }
        if let Some(Ok(cameras)) = self.camera.as_deref().and_then(Cameras::from_text) {
            self.sized(cameras.get(None))?;
        }
        match self.camera.as_deref().and_then(Cameras::from_text) {
            Some(Err(error)) => Err(Error::argument("--camera", error.to_string())),
            _ => Ok(()),
        }
    }

    /// A camera with a size, from one that may have none.
    ///
    /// # Errors
    /// [`Error::Argument`] if neither it nor `--size` says how large the pictures are, or both do
    /// and differ.
    pub fn sized(&self, camera: Option<&Intrinsics>) -> Result<()> {
        let own = camera.and_then(|c| c.width.zip(c.height));
        match (own, self.size) {
            (None, None) => Err(Error::argument(
                "--camera",
                "found no size of the pictures, expected fx,fy,cx,cy,W,H, or --size WxH",
            )),
            (Some(own), Some(asked)) if own != asked => Err(Error::argument(
                "--size",
                format!("{}x{}, and the camera says {}x{}", asked.0, asked.1, own.0, own.1),
            )),
            (Some((w, h)), _) if w > 65_535 || h > 65_535 => Err(Error::argument(
                "--camera",
                format!("a picture of {w}x{h}; expected at most 65535 pixels a side"),
            )),
            _ => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(more: &[&str]) -> Args {
        let fixed = ["render", "m.obj", "p.csv", "--out", "o"];
        Args::try_parse_from(fixed.iter().chain(more)).expect("arguments")
    }

    fn refused(more: &[&str]) -> String {
        parse(more).check().expect_err("refused").to_string()
    }

    #[test]
    fn contradictions_are_named() {
        let camera = ["--camera", "10,10,5,5,10,10"];
        let with = |more: &[&str]| refused(&[&camera[..], more].concat());
        assert!(with(&["--delta", "10"]).starts_with("--delta: belongs to --mode dibr"));
        assert!(with(&["--sigma", "-1"]).starts_with("--sigma: -1"));
        assert!(with(&["--mode", "sigmoid", "--sigma-ndc", "0"]).starts_with("--sigma-ndc: 0"));
        assert!(with(&["--near", "0"]).starts_with("--near"));
        assert!(with(&["--size", "9x9"]).starts_with("--size: 9x9"));
        assert!(refused(&["--camera", "10,10,5,5"]).contains("--size WxH"));
        assert!(refused(&["--camera", "10,1o,5,5,10,10"]).contains("fy"));
        assert!(refused(&["--fov", "200", "--size", "9x9"]).starts_with("--fov"));
        parse(&[&camera[..], &["--delta", "10", "--compare"]].concat()).check().expect("sound");
    }

    #[test]
    fn layers_are_each_drawn_once_in_order() {
        let fov = ["--fov", "50", "--size", "8x6"];
        let layers = |more: &[&str]| parse(&[&fov[..], more].concat()).layers();
        assert_eq!(layers(&[]), [Layer::Silhouette]);
        assert_eq!(layers(&["--compare"]), [Layer::Compare]);
        assert_eq!(layers(&["--contact-sheet"]), []);
        let some = layers(&["--save", "depth,silhouette,depth", "--compare"]);
        assert_eq!(some, [Layer::Silhouette, Layer::Depth, Layer::Compare]);
    }

    #[test]
    fn a_size_is_two_numbers() {
        assert_eq!(size("320x240"), Ok((320, 240)));
        assert_eq!(size("8,6"), Ok((8, 6)));
        for bad in ["320", "0x5", "x", "70000x5", "-1x5"] {
            assert!(size(bad).is_err(), "{bad}");
        }
    }
}
