//! The whole command on large files, beside the time it takes only to parse them.
//!
//!     cargo bench --bench eval                                200,000 rows
//!     DRONEPOSE_BENCH_ROWS=1000000 cargo bench --bench eval   a million (1 GB of memory is plenty)
//!     cargo bench --bench eval -- --quick                     20,000 rows, fewer repetitions
//!
//! Two CSV files with errors of some degrees and centimetres are written to a temporary folder.
//! Each measurement is repeated in turn with the others; the least wall-clock time counts, and the
//! least processor time beside it (Linux; it stands still while other programs have the cores).
//! The mesh is `DJI.obj` (3,010 vertices) where the data folder is at hand (`DRONEPOSE_SHARED`, or
//! `shared` beside the repository), else a sphere of as many vertices. The default metrics hold
//! ADD-S too below some 190,000 rows, and confidence intervals up to 50,000.
#![expect(clippy::print_stdout, reason = "the numbers are what a benchmark is for")]

mod noise;

use std::ffi::OsString;
use std::fmt::Write as _;
use std::hint::black_box;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use dronepose_raster::cli::{self, Terminal};
use dronepose_raster::io::{PoseOptions, read_poses};
use dronepose_raster::threads;
use glam::{DQuat, DVec3};

use self::noise::Noise;

type Error = Box<dyn std::error::Error>;

fn main() -> Result<(), Error> {
    let has = |flag: &str| std::env::args().any(|arg| arg == flag);
    let quick = has("--quick") || has("--test");
    let asked = std::env::var("DRONEPOSE_BENCH_ROWS").ok();
    let rows: u32 = match asked {
        Some(text) => text.parse()?,
        None if quick => 20_000,
        None => 200_000,
    };
    let folder = tempfile::tempdir()?;
    let [gt, predictions] = ["gt.csv", "predictions.csv"].map(|name| folder.path().join(name));
    write_poses(&gt, &predictions, rows)?;
    let mesh = mesh(folder.path())?;
    println!(
        "{rows} rows, 2 x {} MB, {}",
        std::fs::metadata(&gt)?.len() / 1_000_000,
        mesh.display()
    );
    println!(
        "threads  measurement                     wall s   processor s   peak MB   x parsing (wall, processor)"
    );
    for threads in [1, 2] {
        let parse = || {
            let read = |path: &Path| read_poses(path, &PoseOptions::default());
            let both = || rayon::join(|| read(&predictions), || read(&gt));
            let (a, b) = threads::install(threads, both).expect("few threads");
            let (a, b) = (a.expect("sound"), b.expect("sound"));
            assert_eq!((black_box(a).len(), black_box(b).len()), (rows as usize, rows as usize));
        };
        let whole = |more: &[&str]| {
            let mut args: Vec<OsString> = vec!["dronepose-eval".into()];
            args.extend([&predictions, &gt].map(OsString::from));
            args.extend(["--threads".into(), threads.to_string().into(), "--mesh".into()]);
            args.push(mesh.clone().into());
            args.extend(more.iter().map(OsString::from));
            let mut messages = Vec::new();
            let code = cli::run(args, &mut io::sink(), &mut messages, Terminal::default());
            assert_eq!(code, 0, "{}", String::from_utf8_lossy(&messages));
        };
        let work: [(&str, &dyn Fn()); 3] = [
            ("parsing the two files", &parse),
            ("whole command, --metrics add", &|| whole(&["--metrics", "add"])),
            ("whole command, default metrics", &|| whole(&[])),
        ];
        let mut least = [Used::MOST; 3];
        for _ in 0..if quick { 2 } else { 5 } {
            for (least, (_, work)) in least.iter_mut().zip(&work) {
                *least = least.min(Used::by(work));
            }
        }
        for (used, (name, _)) in least.iter().zip(&work) {
            println!("{threads:7}  {name:30} {}", used.line(&least[0]));
        }
    }
    Ok(())
}

/// What a piece of work took.
#[derive(Clone, Copy)]
struct Used {
    wall: Duration,
    processor: Duration,
    peak_kb: u64,
}

impl Used {
    const MOST: Self = Self { wall: Duration::MAX, processor: Duration::MAX, peak_kb: u64::MAX };

    fn by(work: &dyn Fn()) -> Self {
        // Linux: forget the peak so far. Elsewhere nothing is shown.
        let _ = std::fs::write("/proc/self/clear_refs", "5");
        let (start, before) = (Instant::now(), processor_time());
        work();
        let (wall, after) = (start.elapsed(), processor_time());
        Self { wall, processor: after.saturating_sub(before), peak_kb: peak_kb() }
    }

    fn min(self, other: Self) -> Self {
        Self {
            wall: self.wall.min(other.wall),
            processor: self.processor.min(other.processor),
            peak_kb: self.peak_kb.min(other.peak_kb),
        }
    }

    fn line(&self, parsing: &Self) -> String {
        let ratio = |a: Duration, b: Duration| a.as_secs_f64() / b.as_secs_f64().max(1e-9);
        format!(
            "{:8.3} {:13.2} {:9.0}   {:.2}, {:.2}",
            self.wall.as_secs_f64(),
            self.processor.as_secs_f64(),
            self.peak_kb as f64 / 1000.0,
            ratio(self.wall, parsing.wall),
            ratio(self.processor, parsing.processor),
        )
    }
}

/// Processor time of all threads of this process, zero where there is no `/proc`.
fn processor_time() -> Duration {
    let stat = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    let fields = stat.rsplit(") ").next().unwrap_or_default().split(' ');
    // utime and stime, in hundredths of a second.
    let ticks = fields.skip(11).take(2).filter_map(|t| t.parse::<u64>().ok()).sum::<u64>();
    Duration::from_millis(10 * ticks)
}

/// Largest memory in use since it was last forgotten, zero where there is no `/proc`.
fn peak_kb() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
    line.and_then(|rest| rest.trim().strip_suffix(" kB")?.parse().ok()).unwrap_or(0)
}

fn write_poses(gt: &Path, predictions: &Path, rows: u32) -> io::Result<()> {
    let create = |path| -> io::Result<_> {
        let mut out = io::BufWriter::new(std::fs::File::create(path)?);
        out.write_all(b"id,qw,qx,qy,qz,tx,ty,tz\n")?;
        Ok(out)
    };
    let (mut gt, mut predictions) = (create(gt)?, create(predictions)?);
    let mut noise = Noise(3);
    for id in 0..rows {
        let q = DQuat::from_axis_angle(noise.vector().normalize(), 3.0 * noise.next());
        let t = DVec3::new(noise.next(), noise.next(), 2.9 + 2.1 * noise.next());
        let turn = DQuat::from_axis_angle(noise.vector().normalize(), 0.15 * noise.next());
        let (q2, t2) = ((q * turn).normalize(), t + 0.03 * noise.vector());
        for (out, q, t) in [(&mut gt, q, t), (&mut predictions, q2, t2)] {
            writeln!(out, "{id},{},{},{},{},{},{},{}", q.w, q.x, q.y, q.z, t.x, t.y, t.z)?;
        }
    }
    gt.flush()?;
    predictions.flush()
}

/// `DJI.obj`, or a sphere in the folder.
fn mesh(folder: &Path) -> io::Result<PathBuf> {
    let beside = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../../shared");
    let shared = std::env::var_os("DRONEPOSE_SHARED").map_or(beside, PathBuf::from);
    let drone = shared.join("data/drones/dji_mavic2/DJI.obj");
    if drone.is_file() {
        return Ok(drone);
    }
    let (rings, around) = (35, 86);
    let mut text = String::new();
    for k in 0..rings * around {
        let (ring, step) = (f64::from(k / around), f64::from(k % around));
        let down = std::f64::consts::PI * (ring + 0.5) / f64::from(rings);
        let turn = std::f64::consts::TAU * step / f64::from(around);
        let p = 0.3 * DVec3::new(down.sin() * turn.cos(), down.cos(), down.sin() * turn.sin());
        // Writing to a string cannot fail.
        let _ = writeln!(text, "v {} {} {}", p.x, p.y, p.z);
    }
    for k in 0..(rings - 1) * around {
        let beside = k - k % around + (k + 1) % around;
        let [a, b, c, d] = [k, beside, k + around, beside + around].map(|v| v + 1);
        let _ = writeln!(text, "f {a} {b} {c}\nf {b} {d} {c}");
    }
    let path = folder.join("sphere.obj");
    std::fs::write(&path, text)?;
    Ok(path)
}
