//! `dronepose render`: a mesh under poses, as pictures and arrays.

mod args;
mod compare;
mod frames;
mod layers;
mod manifest;
mod overlay;
mod save;

use std::collections::HashSet;
use std::io::Write;
use std::path::Path;

use rayon::prelude::*;
use serde_json::{Map, Value, json};

pub use self::args::{Args, FileFormat, Layer, ModeName};
use self::frames::{CameraOf, Frame};
use self::layers::{Layers, Scene};
use self::manifest::{Manifest, Record};
use crate::cli::progress::Bar;
use crate::cli::{Terminal, finish};
use crate::draw::{Canvas, Cell, sheet};
use crate::error::{Error, Place, Result, visible};
use crate::eval::{Progress, Silent};
use crate::io::input::InputFile;
use crate::io::mesh_file::read_mesh_file;
use crate::io::{PoseOptions, PoseTable, Unit, read_poses};
use crate::raster::{Mode, Model};
use crate::threads;

/// File name of the sheet of small pictures.
const CONTACT_SHEET: &str = "contact_sheet.png";
const MOST_THUMBS: usize = 64;

/// Everything read and decided before the first picture is drawn.
struct Job {
    scene: Scene,
    frames: Vec<Frame>,
    layers: Vec<Layer>,
    formats: Vec<FileFormat>,
    /// The four modes, for the comparison.
    modes: Vec<Mode>,
    /// Of overlays.
    zoom: usize,
    warnings: Vec<String>,
}

/// What became of a frame.
#[derive(Default)]
struct Done {
    written: usize,
    empty: bool,
    clamped: bool,
    thumb: Option<Cell>,
}

/// Run `dronepose render`; `line` is the command line for the record. Its exit code.
pub(super) fn run(
    args: &Args,
    line: &[String],
    out: &mut dyn Write,
    err: &mut dyn Write,
    terminal: Terminal,
) -> u8 {
    if let Err(error) = args.check() {
        // If standard error is closed, nobody is left to tell.
        let _ = writeln!(err, "error: {error}\n\nFor more information, try '--help'.");
        return 2;
    }
    match render(args, line, terminal) {
        Ok((manifest, warnings, summary)) => {
            if !args.quiet {
                for warning in &warnings {
                    let _ = writeln!(err, "warning: {}", visible(warning));
                }
            }
            let printed = if args.json {
                manifest.text()
            } else if args.quiet {
                String::new()
            } else {
                visible(&summary).into_owned() + "\n"
            };
            finish(out.write_all(printed.as_bytes()).and_then(|()| out.flush()), err)
        }
        Err(error) => {
            let _ = writeln!(err, "error: {}", visible(&error.to_string()));
            1
        }
    }
}

fn render(
    args: &Args,
    line: &[String],
    terminal: Terminal,
) -> Result<(Manifest, Vec<String>, String)> {
    let bar = (terminal.progress && !args.quiet).then(Bar::new);
    let progress: &dyn Progress = bar.as_ref().map_or(&Silent, |bar| bar as &dyn Progress);
    let threads = args.threads;
    threads::install(threads, || {
        progress.begin("reading", 0);
        let (job, planned) = plan(args, line)?;
        let (manifest, there) = prepare(args, &job, planned)?;
        draw(args, job, manifest, &there, progress)
    })
    .map_err(|e| match e {
        Error::Argument { message, .. } => Error::argument("--threads", message),
        other => other,
    })?
}

/// Read the inputs; refuse what cannot be drawn.
fn plan(args: &Args, line: &[String]) -> Result<(Job, Manifest)> {
    let unit = Unit::from(args.mesh_unit);
    let options = PoseOptions { unit: args.unit.map(Unit::from), ..PoseOptions::default() };
    let (mesh, table) =
        rayon::join(|| read_mesh_file(&args.mesh), || read_poses(&args.poses, &options));
    let ((mesh, mesh_file), mut table) = (mesh?, table?);
    let name = args.mesh.display().to_string();
    let mesh = if unit == Unit::Metre { mesh } else { mesh.scaled(unit.metres())? };
    if mesh.faces().is_empty() {
        return Err(Error::malformed(
            Place::file(&name),
            "a mesh without faces",
            "triangles: points have no silhouette",
        ));
    }
    let in_mesh = |e: Error| Error::Mismatch { place: Place::file(&name), message: e.to_string() };
    let model = Model::from_mesh(&mesh).map_err(in_mesh)?;
    one_object(args, &mut table)?;
    let camera = CameraOf::read(args)?;
    let frames = frames::select(args, &table, &camera)?;
    let bounds = mesh.bounds();
    let mode = args.mode(args.mode);
    let scene = Scene { model, bounds, near: args.near, mode };
    let modes = [ModeName::Coverage, ModeName::Hard, ModeName::Dibr, ModeName::Sigmoid];
    let mut job = Job {
        scene,
        frames,
        layers: args.layers(),
        formats: args.formats(),
        modes: modes.map(|m| args.mode(m)).to_vec(),
        zoom: args.zoom as usize,
        warnings: std::mem::take(&mut table.warnings),
    };
    for frame in &job.frames {
        frame.view.check(frame.row).map_err(|e| Error::Mismatch {
            place: table.place(frame.row, "id"),
            message: e.to_string(),
        })?;
    }
    job.warnings.extend(odd_units(args, &job, mesh.bbox_diagonal()));
    let settings = settings(args, &job, &table, &mesh_file, &camera);
    let mut manifest = Manifest::new(line, settings);
    manifest.encoding = save::encoding(&job.layers, &job.formats);
    manifest.frames = job.frames.iter().map(|f| record(&job, f)).collect();
    if args.contact_sheet {
        manifest.sheets.push(CONTACT_SHEET.to_owned());
    }
    Ok((job, manifest))
}

/// A mesh is one object; a BOP file may hold poses of many.
fn one_object(args: &Args, table: &mut PoseTable) -> Result<()> {
    let Some(targets) = &table.targets else { return Ok(()) };
    let mut objects: Vec<u32> = targets.iter().map(|t| t.object).collect();
    objects.sort_unstable();
    objects.dedup();
    let place = Place::file(&table.name).column("obj_id");
    let list = objects.iter().take(8).map(u32::to_string).collect::<Vec<_>>().join(", ");
    match (args.object, objects.as_slice()) {
        (None, [_]) => Ok(()),
        (None, _) => Err(Error::Mismatch {
            place,
            message: format!("found poses of the objects {list}, expected one; pass --object ID"),
        }),
        (Some(object), _) if table.keep_objects(&[object]) == 0 => Err(Error::Mismatch {
            place,
            message: format!("--object: found no pose of {object}, expected one of {list}"),
        }),
        _ => Ok(()),
    }
}

/// Sizes that make no picture look like a mistake in a unit.
fn odd_units(args: &Args, job: &Job, diagonal: f64) -> Option<String> {
    let mut far: Vec<f64> = job.frames.iter().map(|f| f.pose.translation.length()).collect();
    far.sort_by(f64::total_cmp);
    let median = *far.get(far.len() / 2)?;
    let mesh = args.mesh.display();
    if diagonal > 20.0 * median {
        return Some(format!(
            "{mesh} is {diagonal:.1} m across, {:.0} times its distance to the camera: does it \
             need --mesh-unit mm?",
            diagonal / median
        ));
    }
    (median > 300.0 * diagonal).then(|| {
        format!(
            "the poses are {median:.1} m away, {:.0} times the size of {mesh}: do they need \
             --unit mm?",
            median / diagonal
        )
    })
}

/// Everything the pixels depend on.
fn settings(
    args: &Args,
    job: &Job,
    table: &PoseTable,
    mesh: &InputFile,
    camera: &CameraOf,
) -> Map<String, Value> {
    let mut settings = Map::new();
    let mut set = |key: &str, value: Value| settings.insert(key.to_owned(), value);
    set(
        "mesh",
        json!({
            "sha256": mesh.sha256, "format": mesh.format,
            "unit": Unit::from(args.mesh_unit).name(),
        }),
    );
    set(
        "poses",
        json!({
            "sha256": table.source.sha256, "format": table.source.format,
            "unit": table.unit.name(), "object": args.object,
        }),
    );
    set("camera", camera.record(&job.frames));
    set("near_m", json!(args.near));
    set("mode", mode_record(job.scene.mode));
    if job.layers.contains(&Layer::Compare) {
        set("compare", job.modes.iter().map(|m| mode_record(*m)).collect());
    }
    let pictures = [Layer::Overlay, Layer::Preview];
    if args.contact_sheet || pictures.iter().any(|l| job.layers.contains(l)) {
        let background = args.background.as_ref().map(|p| p.display().to_string());
        set("background", json!(background));
    }
    if job.layers.contains(&Layer::Overlay) {
        set("zoom", json!(args.zoom));
    }
    settings
}

fn mode_record(mode: Mode) -> Value {
    match mode {
        Mode::Coverage { sigma } => json!({"name": "coverage", "sigma_px": sigma}),
        Mode::Hard => json!({"name": "hard"}),
        Mode::Dibr { delta, cutoff } => json!({
            "name": "dibr", "delta_ndc": delta,
            "cutoff": cutoff.map(|c| json!({"boxlen": c.boxlen, "knum": c.knum})),
        }),
        Mode::Sigmoid { sigma, cutoff } => json!({
            "name": "sigmoid", "sigma_ndc": sigma,
            "cutoff": cutoff.map(|c| json!({
                "blur_radius": c.blur_radius, "faces_per_pixel": c.faces_per_pixel,
            })),
        }),
    }
}

/// The files of a frame.
fn record(job: &Job, frame: &Frame) -> Record {
    let files = job.layers.iter().flat_map(|&layer| {
        save::endings(layer, &job.formats).iter().map(move |f| save::file(layer, *f, &frame.name))
    });
    Record { row: frame.row, id: frame.id.clone(), line: frame.line, files: files.collect() }
}

/// Make the folders and hold the plan against what is there. Returns the manifest, written, and the
/// files that need not be drawn again.
fn prepare(args: &Args, job: &Job, mut manifest: Manifest) -> Result<(Manifest, HashSet<String>)> {
    let out = &args.out;
    let mut there = HashSet::new();
    let old = match Manifest::read(out) {
        Err(Error::Malformed { .. }) if args.force => None,
        other => other?,
    };
    let difference = old.as_ref().and_then(|old| old.difference(&manifest));
    match (old, difference) {
        (Some(mut old), None) => {
            // An interrupted run lists more than it drew.
            old.keep_files(|f| out.join(f).is_file());
            if !args.force {
                there.extend(old.files().map(str::to_owned));
            }
            manifest.absorb(&old);
        }
        (Some(old), Some(_)) if args.force => old.remove_files(out),
        (Some(_), Some((name, was, is))) => {
            return Err(Error::Mismatch {
                place: Place::file(&out.join(manifest::NAME).display().to_string()),
                message: format!(
                    "found pictures with {name} = {was}, expected {is}; choose another --out, or \
                     pass --force to draw all again"
                ),
            });
        }
        (None, _) if args.force => {}
        (None, _) => {
            if let Some(file) = manifest.files().find(|f| out.join(f).exists()) {
                return Err(Error::Mismatch {
                    place: Place::file(&out.join(file).display().to_string()),
                    message:
                        "is there already, and no manifest.json says how it was drawn; choose \
                              another --out, or pass --force to write over it"
                            .to_owned(),
                });
            }
        }
    }
    make_folder(out)?;
    for layer in &job.layers {
        make_folder(&out.join(layer.name()))?;
    }
    manifest.write(out)?;
    Ok((manifest, there))
}

fn make_folder(path: &Path) -> Result<()> {
    std::fs::create_dir_all(path).map_err(|source| Error::Write { path: path.to_owned(), source })
}

/// Draw what is not there, then complete the manifest.
fn draw(
    args: &Args,
    job: Job,
    mut manifest: Manifest,
    there: &HashSet<String>,
    progress: &dyn Progress,
) -> Result<(Manifest, Vec<String>, String)> {
    let count = job.frames.len();
    let thumbs = if args.contact_sheet { count.min(MOST_THUMBS) } else { 0 };
    // Evenly over the frames: a frame is on the sheet if it begins a new share.
    let is_thumb =
        |k: usize| thumbs > 0 && (k == 0 || k * thumbs / count > (k - 1) * thumbs / count);
    progress.begin("drawing", count as u64);
    let done: Vec<Done> = job
        .frames
        .par_iter()
        .enumerate()
        .map(|(k, frame)| {
            let done = draw_frame(args, &job, frame, is_thumb(k), there);
            progress.advance(1);
            done
        })
        .collect::<Result<_>>()?;
    let mut written: usize = done.iter().map(|d| d.written).sum();
    let drawn = done.iter().filter(|d| d.written > 0).count();
    let mut warnings = job.warnings;
    let ids = |pick: &dyn Fn(&Done) -> bool| {
        let picked: Vec<&str> = job
            .frames
            .iter()
            .zip(&done)
            .filter(|(_, d)| pick(d))
            .map(|(f, _)| f.id.as_str())
            .collect();
        let more = if picked.len() > 5 { ", …" } else { "" };
        let list = picked.iter().take(5).copied().collect::<Vec<_>>().join(", ") + more;
        (!picked.is_empty()).then_some((picked.len(), list))
    };
    if let Some((n, list)) = ids(&|d| d.empty) {
        warnings.push(format!(
            "{n} of {count} poses show nothing: {list}; the mesh is behind the camera or beside the \
             picture"
        ));
    }
    if let Some((n, list)) = ids(&|d| d.clamped) {
        warnings.push(format!(
            "{n} of {count} depth pictures end at 65.535 m, what 16 bits of millimetres hold: \
             {list}; pass --format npy for all of it"
        ));
    }
    if args.contact_sheet {
        let cells: Vec<Cell> = done.into_iter().filter_map(|d| d.thumb).collect();
        save::picture(&args.out.join(CONTACT_SHEET), &contact_sheet(args, &cells, count))?;
        written += 1;
    }
    manifest.complete = true;
    manifest.write(&args.out)?;
    let folder = args.out.display();
    let rest = count - drawn;
    let note = if rest > 0 && !job.layers.is_empty() {
        format!(", {rest} were there")
    } else {
        String::new()
    };
    let summary = format!(
        "{drawn} of {count} poses drawn{note}: {written} file{} in {folder}",
        if written == 1 { "" } else { "s" }
    );
    Ok((manifest, warnings, summary))
}

fn draw_frame(
    args: &Args,
    job: &Job,
    frame: &Frame,
    thumb: bool,
    there: &HashSet<String>,
) -> Result<Done> {
    let layers = Layers::new(&job.scene, frame);
    let mut done = Done::default();
    let mut outputs = crate::io::output::Outputs::default();
    for &layer in &job.layers {
        for &format in save::endings(layer, &job.formats) {
            let file = save::file(layer, format, &frame.name);
            if there.contains(&file) {
                continue;
            }
            let saved = save::layer(&layers, layer, format, &job.modes, job.zoom)?;
            outputs.write(&args.out.join(file), |out| saved.write(out, frame.size()))?;
            done.clamped |= saved.clamped;
            done.written += 1;
        }
    }
    if thumb {
        let picture = overlay::overlay(&layers, 1)?.fitted(200, 150);
        done.thumb = Some(Cell { picture, title: String::new(), captions: vec![frame.id.clone()] });
    }
    outputs.commit()?;
    done.empty = layers.shows_nothing();
    Ok(done)
}

fn contact_sheet(args: &Args, cells: &[Cell], count: usize) -> Canvas {
    let mesh = args.mesh.file_name().unwrap_or_default().to_string_lossy();
    let heading = if cells.len() < count {
        format!("{mesh}: {} of {count} poses", cells.len())
    } else {
        format!("{mesh}: {count} poses")
    };
    // About as wide as high.
    let columns = (1..=8).find(|c| c * c * 3 >= cells.len() * 2).unwrap_or(8);
    sheet(&heading, cells, columns)
}
