//! Files of flights: UAVA, AirSim, TUM, EuRoC, CSV. Each refusal names file, line and column.

use std::path::Path;

use glam::DQuat;

use crate::error::{Error, Place, Result, quoted};
use crate::io::input::{Input, InputFile};
use crate::io::records::{Record, Records, Separator, text};
use crate::io::table::row_limit;
use crate::rotation;
use crate::synth::axes::{Axes, World, same_handedness};
use crate::synth::flight::columns::{Columns, Fields, Frames, Header, ordered};
use crate::synth::flight::detect::detect;
use crate::synth::flight::{
    Conventions, Flight, Format, Options, Order, Row, TimeUnit, clean, positive,
};

/// Two ends of UAVA rows that are nearer than this, in metres and radians, are one pose: single
/// precision, written with six digits.
const SAME_POSE: f64 = 1e-4;

const KINDS: &str = "a flight: UAVA (tabs, Position(x)_t1), airsim_rec.txt (tabs, POS_X), TUM \
                     (time x y z qx qy qz qw), EuRoC (time in ns, p, q scalar first) or CSV with a \
                     header t,x,y,z,qw,qx,qy,qz; --flight-format forces one";

/// Read a flight from a file, a pipe, or standard input (`-`); gzip is read through.
///
/// # Errors
/// [`Error::Read`]; [`Error::Malformed`] naming line and column; [`Error::Argument`].
pub fn read_flight(path: &Path, options: &Options) -> Result<Flight> {
    read(Input::open(path)?, options)
}

/// As [`read_flight`], from bytes under a name.
///
/// # Errors
/// As [`read_flight`].
pub fn parse_flight(name: &str, bytes: Vec<u8>, options: &Options) -> Result<Flight> {
    read(Input::from_bytes(name, bytes)?, options)
}

fn read(mut input: Input, options: &Options) -> Result<Flight> {
    options.limits.check()?;
    positive("rate_hz", options.rate_hz)?;
    if options.mount_rpy_deg.iter().any(|a| !a.is_finite()) {
        return Err(Error::argument("mount_rpy_deg", "expected three finite angles"));
    }
    input.refuse_binary()?;
    let format = match options.format {
        Format::Auto => {
            let place = input.place();
            let head = input.peek()?;
            detect(head).ok_or_else(|| {
                let line = head.split(|&b| b == b'\n').next().unwrap_or_default();
                Error::malformed(Place { line: Some(1), ..place }, quoted(line), KINDS)
            })?
        }
        format => format,
    };
    let mut reader = Reader {
        conventions: conventions(format, options)?,
        options,
        records: Records::new(input)?,
        rows: Vec::new(),
        count: 0,
        first_ns: None,
        signs: Signs::default(),
    };
    match format {
        Format::Uava => reader.uava()?,
        Format::Airsim | Format::Csv => reader.named()?,
        Format::Tum | Format::Euroc | Format::Auto => reader.positional()?,
    }
    reader.finish()
}

/// What a format means, unless the options say otherwise.
fn conventions(format: Format, options: &Options) -> Result<Conventions> {
    let (world, body, quaternion, unit) = match format {
        // The body is that of the paper's mesh: x left, y up, z forward.
        Format::Uava => (World::ZUp, "luf", Order::Xyzw, None),
        Format::Airsim => (World::Ned, "frd", Order::Wxyz, Some(TimeUnit::Ms)),
        // The frame of the ADIS IMU: x up, z forward (and 20 degrees down).
        Format::Euroc => (World::ZUp, "urf", Order::Wxyz, Some(TimeUnit::Ns)),
        Format::Csv => (World::ZUp, "flu", Order::Wxyz, Some(TimeUnit::S)),
        Format::Tum | Format::Auto => (World::ZUp, "flu", Order::Xyzw, Some(TimeUnit::S)),
    };
    if let (Some(_), Format::Uava | Format::Airsim | Format::Csv) = (options.quaternion, format) {
        return Err(Error::argument(
            "quaternion",
            "given, but this format names the columns of its quaternion; leave it out",
        ));
    }
    let world = options.world.unwrap_or(world);
    let body_axes = match options.body_axes {
        Some(axes) => axes,
        None => Axes::parse("body_axes", body)?,
    };
    same_handedness(world, body_axes)?;
    Ok(Conventions {
        format,
        world,
        body_axes,
        quaternion: options.quaternion.unwrap_or(quaternion),
        time_unit: options.time_unit.filter(|_| unit.is_some()).or(unit),
        mount_rpy_deg: options.mount_rpy_deg,
    })
}

struct Reader<'a> {
    conventions: Conventions,
    options: &'a Options,
    records: Records,
    rows: Vec<Row>,
    count: usize,
    first_ns: Option<i64>,
    signs: Signs,
}

/// Quaternions of a file that are on the other side than the one before.
#[derive(Default)]
struct Signs {
    last: Option<DQuat>,
    flips: usize,
}

impl Signs {
    fn see(&mut self, raw: DQuat) {
        self.flips += usize::from(self.last.is_some_and(|last| last.dot(raw) < 0.0));
        self.last = Some(raw);
    }
}

/// Columns of a table with time stamps.
struct Table {
    separator: Separator,
    names: Vec<String>,
    time: usize,
    pose: Columns,
    vehicle: Option<usize>,
}

impl Reader<'_> {
    /// TUM and EuRoC: columns by position, comments with `#`.
    fn positional(&mut self) -> Result<()> {
        let tum = self.conventions.format != Format::Euroc;
        let separator = if tum { Separator::Space } else { Separator::Comma };
        let order = self.conventions.quaternion;
        let names = match order {
            Order::Xyzw => ["time", "x", "y", "z", "qx", "qy", "qz", "qw"],
            Order::Wxyz => ["time", "x", "y", "z", "qw", "qx", "qy", "qz"],
        };
        let table = Table {
            separator,
            names: names.map(str::to_owned).to_vec(),
            time: 0,
            pose: Columns { position: [1, 2, 3], quaternion: ordered(4, order) },
            vehicle: None,
        };
        self.table(&table, None)
    }

    /// AirSim and CSV: columns by name.
    fn named(&mut self) -> Result<()> {
        let airsim = self.conventions.format == Format::Airsim;
        let separator = if airsim { Separator::Tab } else { Separator::Comma };
        let header = self.header(separator)?;
        let table = if airsim {
            Table {
                separator,
                time: header.need(&["TimeStamp"])?,
                pose: Columns {
                    position: header.three([&["POS_X"], &["POS_Y"], &["POS_Z"]])?,
                    quaternion: [
                        header.need(&["Q_W"])?,
                        header.need(&["Q_X"])?,
                        header.need(&["Q_Y"])?,
                        header.need(&["Q_Z"])?,
                    ],
                },
                vehicle: header.find(&["VehicleName"])?,
                names: header.names,
            }
        } else {
            let time = header.need(&[
                "t",
                "time",
                "timestamp",
                "t_s",
                "time_s",
                "timestamp_s",
                "t_ms",
                "time_ms",
                "timestamp_ms",
                "t_us",
                "time_us",
                "timestamp_us",
                "t_ns",
                "time_ns",
                "timestamp_ns",
            ])?;
            let name = header.names[time].to_ascii_lowercase();
            let unit = match name.rsplit_once('_').map(|(_, unit)| unit) {
                Some("ns") => Some(TimeUnit::Ns),
                Some("us") => Some(TimeUnit::Us),
                Some("ms") => Some(TimeUnit::Ms),
                Some("s") => Some(TimeUnit::S),
                _ => None,
            };
            if self.options.time_unit.is_none() && unit.is_some() {
                self.conventions.time_unit = unit;
            }
            Table {
                separator,
                time,
                pose: Columns {
                    position: header.three([
                        &["x", "tx", "px", "pos_x"],
                        &["y", "ty", "py", "pos_y"],
                        &["z", "tz", "pz", "pos_z"],
                    ])?,
                    quaternion: [
                        header.need(&["qw", "q_w"])?,
                        header.need(&["qx", "q_x"])?,
                        header.need(&["qy", "q_y"])?,
                        header.need(&["qz", "q_z"])?,
                    ],
                },
                vehicle: None,
                names: header.names,
            }
        };
        let fields = table.names.len();
        self.table(&table, Some(fields))
    }

    fn header(&mut self, separator: Separator) -> Result<Header> {
        let file = self.records.name().to_owned();
        let Some(record) = self.records.next_record()? else {
            return Err(Error::malformed(Place::file(&file), "an empty file", KINDS));
        };
        let mut fields = Vec::new();
        record.split_by(separator, &mut fields);
        Header::new(&file, record.line, &fields)
    }

    /// The rows of a table; `expected` fields in each, or as many as the first has.
    fn table(&mut self, table: &Table, mut expected: Option<usize>) -> Result<()> {
        let of = if expected.is_some() { "the header has" } else { "the first row has" };
        let file = self.records.name().to_owned();
        let unit = self.conventions.time_unit.unwrap_or(TimeUnit::S);
        let frames = Frames::new(&self.conventions);
        let mut vehicle: Option<String> = self.options.vehicle.clone();
        while let Some(record) = self.records.next_record()? {
            if is_comment(&record) {
                continue;
            }
            let mut fields = Vec::with_capacity(table.names.len());
            record.split_by(table.separator, &mut fields);
            let row =
                Fields { file: &file, line: record.line, cells: &fields, names: &table.names };
            if expected.is_none() && fields.len() < 8 {
                return Err(Error::malformed(
                    Place::line(&file, record.line),
                    format!("{} fields", fields.len()),
                    format!("8 or more: {}", table.names.join(" ")),
                ));
            }
            row.count(*expected.get_or_insert(fields.len()), of)?;
            self.count += 1;
            row_limit(self.count, &file)?;
            if let Some(column) = table.vehicle {
                let name = text(fields[column]).unwrap_or_default();
                match &vehicle {
                    Some(wanted) if *wanted == name => {}
                    // Somebody said which; the others are left out.
                    Some(_) if self.options.vehicle.is_some() => continue,
                    Some(first) => {
                        return Err(Error::malformed(
                            row.place(column),
                            format!("a second vehicle {}", quoted(name.as_bytes())),
                            format!("only {} (--vehicle chooses one)", quoted(first.as_bytes())),
                        ));
                    }
                    None => vehicle = Some(name.into_owned()),
                }
            }
            let ns = row.time(table.time, unit)?;
            let first = *self.first_ns.get_or_insert(ns);
            let (position, rotation, raw) = row.pose(&table.pose, &frames)?;
            self.signs.see(raw);
            let time = (i128::from(ns) - i128::from(first)) as f64 * 1e-9;
            self.rows.push(Row { time, position, rotation, line: row.line, cut: false });
        }
        Ok(())
    }

    /// Two time steps in a row; a row that goes on where the one before ended shares a pose with it.
    fn uava(&mut self) -> Result<()> {
        let header = self.header(Separator::Tab)?;
        let step = |n: u8| -> Result<Columns> {
            let need = |what: &str, axis: char| header.need(&[&format!("{what}({axis})_t{n}")]);
            let position = ['x', 'y', 'z'].map(|a| need("Position", a));
            let quaternion = ['w', 'x', 'y', 'z'].map(|a| need("Orientation", a));
            let [x, y, z] = position;
            let [qw, qx, qy, qz] = quaternion;
            Ok(Columns { position: [x?, y?, z?], quaternion: [qw?, qx?, qy?, qz?] })
        };
        let steps = [step(1)?, step(2)?];
        let (file, frames) = (header.file.clone(), Frames::new(&self.conventions));
        let mut tick = 0_u64;
        while let Some(record) = self.records.next_record()? {
            let line = record.line;
            let mut fields = Vec::with_capacity(header.names.len());
            record.split_by(Separator::Tab, &mut fields);
            let row = Fields { file: &file, line, cells: &fields, names: &header.names };
            row.count(header.names.len(), "the header has")?;
            self.count += 1;
            row_limit(self.count, &file)?;
            let (p1, q1, raw1) = row.pose(&steps[0], &frames)?;
            let (p2, q2, raw2) = row.pose(&steps[1], &frames)?;
            self.signs.see(raw1);
            self.signs.see(raw2);
            let goes_on = self.rows.last().is_some_and(|last| {
                last.position.distance(p1) <= SAME_POSE
                    && rotation::angle(last.rotation, q1) <= SAME_POSE
            });
            let begun = tick > 0;
            let mut push = |position, rotation, cut| {
                let time = tick as f64 / self.options.rate_hz;
                tick += 1;
                self.rows.push(Row { time, position, rotation, line, cut });
            };
            if !goes_on {
                push(p1, q1, begun);
            }
            push(p2, q2, false);
        }
        Ok(())
    }

    fn finish(self) -> Result<Flight> {
        let file = self.records.name().to_owned();
        let format = serde_json::to_value(self.conventions.format).unwrap_or_default();
        let source: InputFile =
            self.records.into_input().finish(format.as_str().unwrap_or_default())?;
        if self.rows.len() < 2 {
            let found = match (self.rows.len(), self.count) {
                (0, 0) => "no pose".to_owned(),
                (0, n) => format!(
                    "no pose of vehicle {} in {n} rows",
                    quoted(self.options.vehicle.as_deref().unwrap_or_default().as_bytes())
                ),
                _ => "one pose".to_owned(),
            };
            return Err(Error::malformed(
                Place::file(&file),
                found,
                "two poses at least: a flight moves",
            ));
        }
        let flight = Flight {
            source,
            conventions: self.conventions,
            rows: self.count,
            sign_flips: self.signs.flips,
            time: Vec::with_capacity(self.rows.len()),
            positions: Vec::with_capacity(self.rows.len()),
            rotations: Vec::with_capacity(self.rows.len()),
            lines: Vec::with_capacity(self.rows.len()),
            segments: Vec::new(),
            issues: Vec::new(),
        };
        clean::clean(flight, self.rows, &file, &self.options.limits)
    }
}

fn is_comment(record: &Record<'_>) -> bool {
    record.text().trim_ascii_start().starts_with(b"#")
}
