//! From the ids and depths of a band to the planes.

use super::band::Band;
use super::normals::{flat, smooth};
use super::{Fragment, GBuffer, Normals, Surface};
use crate::raster::{Pixel, View};

/// Write the planes of a band.
pub(super) fn resolve<T: Pixel>(
    band: &Band<'_>,
    (surfaces, views): (&[Surface<'_>], &[View]),
    (normals, channels): (Normals, usize),
    fragments: &mut Vec<Fragment>,
    mut out: GBuffer<'_, T>,
) {
    let width = band.width();
    let zeroed = out.zeroed;
    let wanted = out.barycentrics.is_some()
        || out.normal.is_some()
        || out.attributes.is_some()
        || out.uv.is_some();
    for row in 0..band.rows.len() {
        let pixels = row * width..(row + 1) * width;
        ids(band, row, surfaces, [&mut out.face, &mut out.object], pixels.clone());
        let (nearness, ids) = band.row(row);
        let dirty = if band.dirty.rows.contains(&row) { band.dirty.columns.clone() } else { 0..0 };
        if let Some(mask) = &mut out.mask {
            let mask = &mut mask[pixels.clone()];
            clear(mask, zeroed);
            for (mask, id) in mask[dirty.clone()].iter_mut().zip(&ids[dirty.clone()]) {
                *mask = *id != 0;
            }
        }
        if let Some(depth) = &mut out.depth {
            let depth = &mut depth[pixels.clone()];
            clear(depth, zeroed);
            for (depth, &w) in depth[dirty.clone()].iter_mut().zip(&nearness[dirty]) {
                *depth = T::from_f64(if w > 0.0 { 1.0 / w } else { 0.0 });
            }
        }
        if !wanted {
            continue;
        }
        band.fragments(row, surfaces, fragments);
        let row_of = |channels: usize| pixels.start * channels..pixels.end * channels;
        if let Some(plane) = &mut out.barycentrics {
            each(&mut plane[row_of(3)], 3, zeroed, fragments, |f, k| f.barycentrics[k]);
        }
        if let Some(plane) = &mut out.normal {
            let plane = &mut plane[row_of(3)];
            clear(plane, zeroed);
            for f in &*fragments {
                let (surface, screen) = (&surfaces[f.surface], &band.prepared.screens[f.surface]);
                let face = surface.model.faces()[f.face];
                let mut n = flat(screen, face);
                if let (Normals::Smooth, Some(vertices)) = (normals, surface.normals) {
                    n = smooth(f, face, vertices, &views[f.surface].rotation, n);
                }
                let out = &mut plane[3 * f.column..3 * f.column + 3];
                out.iter_mut().zip(n).for_each(|(out, n)| *out = T::from_f64(n));
            }
        }
        if let Some(plane) = &mut out.attributes {
            let value = |f: &Fragment, k: usize| {
                let Surface { model, attributes: Some(values), .. } = &surfaces[f.surface] else {
                    return 0.0;
                };
                let at = |v: u32| values[v as usize * channels + k];
                f.mix(model.faces()[f.face].map(at))
            };
            each(&mut plane[row_of(channels)], channels, zeroed, fragments, value);
        }
        if let Some(plane) = &mut out.uv {
            let value = |f: &Fragment, k: usize| {
                surfaces[f.surface].uv.map_or(0.0, |uv| f.mix(uv[f.face].map(|corner| corner[k])))
            };
            each(&mut plane[row_of(2)], 2, zeroed, fragments, value);
        }
    }
}

fn clear<X: Default + Clone>(row: &mut [X], zeroed: bool) {
    if !zeroed {
        row.fill(X::default());
    }
}

/// Faces and objects of a row.
fn ids(
    band: &Band<'_>,
    row: usize,
    surfaces: &[Surface<'_>],
    [face, object]: [&mut Option<&mut [i32]>; 2],
    pixels: std::ops::Range<usize>,
) {
    let (_, ids) = band.row(row);
    let screens = &band.prepared.screens;
    let plain = surfaces.len() == 1 && !screens[0].is_clipped();
    for (plane, of_face) in [(face, true), (object, false)] {
        let Some(plane) = plane else { continue };
        let plane = &mut plane[pixels.clone()];
        if !band.dirty.rows.contains(&row) {
            plane.fill(-1);
            continue;
        }
        let columns = band.dirty.columns.clone();
        plane[..columns.start].fill(-1);
        plane[columns.end..].fill(-1);
        let pairs = plane[columns.clone()].iter_mut().zip(&ids[columns]);
        if plain && of_face {
            pairs.for_each(|(out, &id)| *out = id.wrapping_sub(1).cast_signed());
        } else if plain {
            pairs.for_each(|(out, &id)| *out = if id == 0 { -1 } else { 0 });
        } else {
            pairs.for_each(|(out, &id)| {
                *out = -1;
                if id != 0 {
                    let (surface, face) = band.prepared.find(id);
                    let face = screens[surface].parent(face);
                    *out = (if of_face { face } else { surface }) as i32;
                }
            });
        }
    }
}

/// Write `value(fragment, channel)` where there is a fragment.
fn each<T: Pixel>(
    plane: &mut [T],
    channels: usize,
    zeroed: bool,
    fragments: &[Fragment],
    value: impl Fn(&Fragment, usize) -> f64,
) {
    clear(plane, zeroed);
    for f in fragments {
        let out = &mut plane[f.column * channels..(f.column + 1) * channels];
        for (k, out) in out.iter_mut().enumerate() {
            *out = T::from_f64(value(f, k));
        }
    }
}
