//! From layers to files: which there are, what their numbers mean, and how they are written.

use std::collections::BTreeMap;
use std::io::{self, Write};
use std::path::Path;

use super::args::{FileFormat, Layer};
use super::compare::compare;
use super::layers::Layers;
use super::overlay::{normal_colors, overlay, preview};
use crate::draw::{Canvas, Rgb};
use crate::error::Result;
use crate::io::npy;
use crate::io::output::Outputs;
use crate::io::png::{Samples, write_png};
use crate::raster::{Mode, Size};

/// The kinds of files of a layer.
pub(super) fn endings(layer: Layer, formats: &[FileFormat]) -> &[FileFormat] {
    if layer.is_data() { formats } else { &[FileFormat::Png] }
}

/// A file relative to the folder.
pub(super) fn file(layer: Layer, format: FileFormat, name: &str) -> String {
    format!("{}/{name}.{}", layer.name(), format.extension())
}

/// What the numbers in a file mean.
fn meaning(layer: Layer, format: FileFormat) -> &'static str {
    match (layer, format) {
        (Layer::Silhouette, FileFormat::Png) => "8-bit grey, 255 times the mask",
        (Layer::Silhouette, FileFormat::Npy) => "float32 (H, W), mask from 0 to 1",
        (Layer::Depth, FileFormat::Png) => {
            "16-bit grey, distance along z in millimetres, rounded; 0 is none, 65535 is that or more"
        }
        (Layer::Depth, FileFormat::Npy) => "float32 (H, W), distance along z in metres; 0 is none",
        (Layer::Normal, FileFormat::Png) => {
            "8-bit RGB, 255 (n + 1) / 2 of the unit normal in the camera frame (x right, y down, z \
             forward); black is none"
        }
        (Layer::Normal, FileFormat::Npy) => {
            "float32 (H, W, 3), unit normal in the camera frame (x right, y down, z forward), \
             towards the camera; 0 is none"
        }
        (Layer::Overlay, _) => "8-bit RGB, for the eye: silhouette, outline, box, axes x y z = RGB",
        (Layer::Preview, _) => "8-bit RGB, for the eye: silhouette, depth, normals, overlay",
        (Layer::Compare, _) => "8-bit RGB, for the eye: the four modes side by side",
    }
}

/// For the manifest.
pub(super) fn encoding(
    layers: &[Layer],
    formats: &[FileFormat],
) -> BTreeMap<String, BTreeMap<String, String>> {
    let of = |&layer: &Layer| {
        let each = endings(layer, formats).iter();
        let texts = each.map(|&f| (f.extension().to_owned(), meaning(layer, f).to_owned()));
        (layer.name().to_owned(), texts.collect())
    };
    layers.iter().map(of).collect()
}

/// The content of a file.
pub(super) struct Saved {
    content: Content,
    meaning: &'static str,
    /// Some depth did not fit.
    pub(super) clamped: bool,
}

enum Content {
    Gray8(Vec<u8>),
    Gray16(Vec<u16>),
    Rgb(Vec<Rgb>),
    Picture(Canvas),
    Array(Vec<f32>, usize),
}

impl Saved {
    /// Write it; numbers of a layer have the size of the camera's picture.
    pub(super) fn write(&self, out: &mut dyn Write, size: Size) -> io::Result<()> {
        let Size { width, height } = size;
        let png =
            |out: &mut dyn Write, samples| write_png(out, width, height, samples, self.meaning);
        match &self.content {
            Content::Gray8(pixels) => png(out, Samples::Gray8(pixels)),
            Content::Gray16(pixels) => png(out, Samples::Gray16(pixels)),
            Content::Rgb(pixels) => png(out, Samples::Rgb8(pixels)),
            Content::Picture(p) => {
                write_png(out, p.width(), p.height(), Samples::Rgb8(p.pixels()), self.meaning)
            }
            Content::Array(numbers, 1) => npy::write_f32(out, &[height, width], numbers),
            Content::Array(numbers, n) => npy::write_f32(out, &[height, width, *n], numbers),
        }
    }
}

/// Draw one layer of a frame for a kind of file.
pub(super) fn layer(
    layers: &Layers<'_>,
    layer: Layer,
    format: FileFormat,
    modes: &[Mode],
    zoom: usize,
) -> Result<Saved> {
    let mut clamped = false;
    let content = match (layer, format) {
        (Layer::Silhouette, FileFormat::Png) => {
            let gray = |m: &f32| (255.0 * m.clamp(0.0, 1.0)).round() as u8;
            Content::Gray8(layers.silhouette()?.iter().map(gray).collect())
        }
        (Layer::Silhouette, FileFormat::Npy) => Content::Array(layers.silhouette()?.to_vec(), 1),
        (Layer::Depth, FileFormat::Png) => {
            let (millimetres, beyond) = millimetres(&layers.surface()?.depth);
            clamped = beyond;
            Content::Gray16(millimetres)
        }
        (Layer::Depth, FileFormat::Npy) => Content::Array(layers.surface()?.depth.clone(), 1),
        (Layer::Normal, FileFormat::Png) => Content::Rgb(normal_colors(&layers.surface()?.normal)),
        (Layer::Normal, FileFormat::Npy) => {
            Content::Array(layers.surface()?.normal.as_flattened().to_vec(), 3)
        }
        (Layer::Overlay, _) => Content::Picture(overlay(layers, zoom)?),
        (Layer::Preview, _) => Content::Picture(preview(layers)?),
        (Layer::Compare, _) => Content::Picture(compare(layers, modes)?),
    };
    Ok(Saved { content, meaning: meaning(layer, format), clamped })
}

/// Metres as whole millimetres, at least 1 where there is something; whether some did not fit.
fn millimetres(depth: &[f32]) -> (Vec<u16>, bool) {
    let mut beyond = false;
    let one = |&d: &f32| {
        let whole = (f64::from(d) * 1000.0).round();
        beyond |= whole > 65_535.0;
        if d > 0.0 { whole.clamp(1.0, 65_535.0) as u16 } else { 0 }
    };
    (depth.iter().map(one).collect(), beyond)
}

/// Write one picture for the eye, whole or not at all.
pub(super) fn picture(path: &Path, canvas: &Canvas) -> Result<()> {
    let mut outputs = Outputs::default();
    outputs.write(path, |out| {
        write_png(out, canvas.width(), canvas.height(), Samples::Rgb8(canvas.pixels()), "")
    })?;
    outputs.commit()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn depth_is_whole_millimetres_and_never_none_by_rounding() {
        assert_eq!(millimetres(&[0.0, 1.2344, 0.0001, 65.535]), (vec![0, 1234, 1, 65_535], false));
        assert_eq!(millimetres(&[65.6, 1e9]), (vec![65_535, 65_535], true));
    }

    #[test]
    fn pictures_for_the_eye_are_png_only() {
        let both = [FileFormat::Png, FileFormat::Npy];
        assert_eq!(endings(Layer::Overlay, &both), [FileFormat::Png]);
        assert_eq!(endings(Layer::Depth, &both), both);
        assert_eq!(file(Layer::Depth, FileFormat::Npy, "a"), "depth/a.npy");
        let texts = encoding(&[Layer::Depth, Layer::Overlay], &both);
        assert_eq!((texts["depth"].len(), texts["overlay"].len()), (2, 1));
    }
}
