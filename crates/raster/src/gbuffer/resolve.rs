//! From the ids and depths of a band to the planes: they are filled with what stands for nothing,
//! and where faces are, they are written over in the cache.

use multiversion::multiversion;

use super::band::Band;
use super::normals::{flat, smooth};
use super::{Blank, Fragment, GBuffer, Normals, Surface};
use crate::raster::{Background, Pixel, View};

/// Write the planes of a band, every pixel of them.
pub(super) fn resolve<T: Pixel>(
    band: &Band<'_>,
    (surfaces, views): (&[Surface<'_>], &[View]),
    (normals, channels, background): (Normals, usize, Background),
    fragments: &mut Vec<Fragment>,
    mut out: GBuffer<'_, T>,
) {
    let width = band.width();
    let wanted = out.barycentrics.is_some()
        || out.normal.is_some()
        || out.attributes.is_some()
        || out.uv.is_some();
    out.clear(&Blank { background, width, dirty: band.dirty }, channels);
    let dirty = band.dirty.columns.clone();
    for row in band.dirty.rows.clone() {
        let pixels = row * width..(row + 1) * width;
        let seen = row * width + dirty.start..row * width + dirty.end;
        let (nearness, ids) = band.row(row);
        let (nearness, ids) = (&nearness[dirty.clone()], &ids[dirty.clone()]);
        if let Some(face) = &mut out.face {
            faces(band, surfaces, ids, &mut face[seen.clone()]);
        }
        if let Some(object) = &mut out.object {
            objects(band, surfaces, ids, &mut object[seen.clone()]);
        }
        if let Some(mask) = &mut out.mask {
            mask[seen.clone()].iter_mut().zip(ids).for_each(|(mask, &id)| *mask = id != 0);
        }
        if let Some(depth) = &mut out.depth {
            depths(nearness, &mut depth[seen]);
        }
        if !wanted {
            continue;
        }
        band.fragments(row, surfaces, fragments);
        let row_of = |channels: usize| pixels.start * channels..pixels.end * channels;
        if let Some(plane) = &mut out.barycentrics {
            each(&mut plane[row_of(3)], 3, fragments, |f, k| f.barycentrics[k]);
        }
        if let Some(plane) = &mut out.normal {
            let plane = &mut plane[row_of(3)];
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
            each(&mut plane[row_of(channels)], channels, fragments, value);
        }
        if let Some(plane) = &mut out.uv {
            let value = |f: &Fragment, k: usize| {
                surfaces[f.surface].uv.map_or(0.0, |uv| f.mix(uv[f.face].map(|corner| corner[k])))
            };
            each(&mut plane[row_of(2)], 2, fragments, value);
        }
    }
}

/// Depths of a part of a row.
#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx512bw+avx2+fma", "x86_64+avx2+fma"))]
fn depths<T: Pixel>(nearness: &[f64], out: &mut [T]) {
    for (depth, &w) in out.iter_mut().zip(nearness) {
        let z = 1.0 / w;
        *depth = T::from_f64(if w > 0.0 { z } else { 0.0 });
    }
}

/// Whether ids are those of the faces of one mesh.
fn plain(band: &Band<'_>, surfaces: &[Surface<'_>]) -> bool {
    surfaces.len() == 1 && !band.prepared.screens[0].is_clipped()
}

/// Faces of a part of a row.
fn faces(band: &Band<'_>, surfaces: &[Surface<'_>], ids: &[u32], out: &mut [i32]) {
    let pairs = out.iter_mut().zip(ids);
    if plain(band, surfaces) {
        pairs.for_each(|(out, &id)| *out = id.wrapping_sub(1).cast_signed());
        return;
    }
    for (out, &id) in pairs.filter(|(_, id)| **id != 0) {
        let (surface, face) = band.prepared.find(id);
        *out = band.prepared.screens[surface].parent(face) as i32;
    }
}

/// Surfaces of a part of a row.
fn objects(band: &Band<'_>, surfaces: &[Surface<'_>], ids: &[u32], out: &mut [i32]) {
    for (out, &id) in out.iter_mut().zip(ids).filter(|(_, id)| **id != 0) {
        *out = if surfaces.len() == 1 { 0 } else { band.prepared.find(id).0 as i32 };
    }
}

/// Write `value(fragment, channel)` where there is a fragment.
fn each<T: Pixel>(
    plane: &mut [T],
    channels: usize,
    fragments: &[Fragment],
    value: impl Fn(&Fragment, usize) -> f64,
) {
    for f in fragments {
        let out = &mut plane[f.column * channels..(f.column + 1) * channels];
        for (k, out) in out.iter_mut().enumerate() {
            *out = T::from_f64(value(f, k));
        }
    }
}
