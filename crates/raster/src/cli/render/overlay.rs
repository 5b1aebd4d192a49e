//! A pose for the eye: silhouette, outline, axes and box over the picture, or over a shaded mesh.

use super::layers::{Layers, Surface};
use crate::draw::{
    BLUE, Canvas, Cell, GREEN, ORANGE, RED, Rgb, TEAL, axes, box_edges, contour, mix, sheet, turbo,
};
use crate::error::Result;
use crate::io::png::read_picture;
use crate::raster::Size;

const SKY: Rgb = [226, 229, 233];
const GROUND: Rgb = [196, 200, 206];
const DARK: Rgb = [44, 50, 60];
const LIGHT: Rgb = [236, 238, 240];

/// The overlay of a frame, `zoom` times as large as its picture.
pub(super) fn overlay(layers: &Layers<'_>, zoom: usize) -> Result<Canvas> {
    if zoom == 1 {
        return drawn(layers, 1);
    }
    let frame = layers.frame.window([0, 0], layers.frame.size(), zoom);
    drawn(&Layers::new(layers.scene, &frame), zoom)
}

fn drawn(layers: &Layers<'_>, zoom: usize) -> Result<Canvas> {
    let (scene, frame) = (layers.scene, layers.frame);
    let Size { width, height } = frame.size();
    let exact = layers.exact()?;
    let photo = frame.background.is_some();
    let mut canvas = match &frame.background {
        Some(path) => {
            let picture = read_picture(path)?;
            let canvas = Canvas::from_pixels(picture.width, picture.height, picture.pixels);
            let mut canvas = canvas.enlarged(zoom);
            canvas.tint(layers.silhouette()?, TEAL, 0.4);
            canvas
        }
        None => shaded(width, height, layers.surface()?),
    };
    // Lines are as thin as can be up to a VGA picture, and grow with larger ones.
    let thin = ((width as f64).hypot(height as f64) / 800.0).max(1.0);
    let (camera, near) = (&frame.view.camera, scene.near);
    let (color, alpha) = if photo { (LIGHT, 0.75) } else { (DARK, 0.4) };
    canvas.stroke(&box_edges(&frame.pose, camera, near, scene.bounds), 0.9 * thin, color, alpha);
    canvas.stroke(&contour(&exact, width, height, 0.5), 1.1 * thin, ORANGE, 1.0);
    let length = 0.3 * (scene.bounds.1 - scene.bounds.0).length();
    let lines = axes(&frame.pose, camera, near, length);
    for (line, color) in lines.into_iter().zip([RED, GREEN, BLUE]) {
        canvas.stroke(line.as_slice(), 1.8 * thin, color, 1.0);
    }
    Ok(canvas)
}

/// The mesh in grey under a light from the upper left, over a neutral ground.
fn shaded(width: usize, height: usize, surface: &Surface) -> Canvas {
    let light = [-0.36, -0.60, -0.71];
    let pixels = surface.normal.iter().zip(&surface.depth).enumerate().map(|(k, (n, &depth))| {
        if depth == 0.0 {
            return mix(SKY, GROUND, (k / width) as f64 / height as f64);
        }
        let cosine: f64 = n.iter().zip(light).map(|(n, l)| f64::from(*n) * l).sum();
        mix(DARK, LIGHT, 0.15 + 0.85 * cosine.max(0.0))
    });
    Canvas::from_pixels(width, height, pixels.collect())
}

/// Depth in colours, near is red; where there is no surface it is black.
fn depth_colors(width: usize, height: usize, depth: &[f32]) -> (Canvas, Option<(f32, f32)>) {
    let seen = || depth.iter().copied().filter(|d| *d > 0.0);
    let low = seen().fold(f32::INFINITY, f32::min);
    let high = seen().fold(0.0, f32::max);
    let span = f64::from(high - low).max(1e-9);
    let color = |&d: &f32| {
        if d > 0.0 { turbo(0.95 - 0.85 * f64::from(d - low) / span) } else { [0; 3] }
    };
    let canvas = Canvas::from_pixels(width, height, depth.iter().map(color).collect());
    (canvas, (high > 0.0).then_some((low, high)))
}

/// Normals as they are in their picture: `(n + 1) / 2`, black where there is none.
pub(super) fn normal_colors(normal: &[[f32; 3]]) -> Vec<Rgb> {
    let color = |n: &[f32; 3]| {
        if n.iter().all(|c| *c == 0.0) {
            return [0; 3];
        }
        n.map(|c| (255.0 * (0.5 * c + 0.5)).round().clamp(0.0, 255.0) as u8)
    };
    normal.iter().map(color).collect()
}

/// Silhouette, depth, normals and overlay in a row.
pub(super) fn preview(layers: &Layers<'_>) -> Result<Canvas> {
    let Size { width, height } = layers.frame.size();
    let surface = layers.surface()?;
    let mask = layers.silhouette()?;
    let area: f64 = mask.iter().map(|m| f64::from(*m)).sum();
    let (depth, range) = depth_colors(width, height, &surface.depth);
    let range = range.map_or_else(
        || "nothing is seen".to_owned(),
        |(low, high)| format!("{low:.3} (red) to {high:.3} m (blue)"),
    );
    let normal = Canvas::from_pixels(width, height, normal_colors(&surface.normal));
    let cells = [
        ("silhouette", Canvas::from_mask(width, height, mask), format!("area {area:.1} px")),
        ("depth", depth, range),
        ("normal", normal, "(n + 1) / 2, camera frame".to_owned()),
        ("overlay", overlay(layers, 1)?, "x red, y green, z blue".to_owned()),
    ];
    let cells = cells.map(|(title, picture, caption)| Cell {
        picture: picture.fitted(480, 480),
        title: title.to_owned(),
        captions: vec![caption],
    });
    Ok(sheet(&layers.frame.id, &cells, 4))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn colours_say_what_the_numbers_are() {
        let (canvas, range) = depth_colors(3, 1, &[0.0, 1.0, 2.0]);
        assert_eq!(range, Some((1.0, 2.0)));
        let [none, near, far] = [0, 1, 2].map(|k| canvas.pixels()[k]);
        assert!(none == [0; 3] && near[0] > near[2] && far[2] > far[0]);
        assert_eq!(depth_colors(1, 1, &[0.0]).1, None);
        assert_eq!(normal_colors(&[[0.0; 3], [0.0, 0.0, -1.0]]), [[0; 3], [128, 128, 0]]);
    }
}
