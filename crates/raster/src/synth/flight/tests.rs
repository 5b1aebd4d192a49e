//! Tests of [`super`]: every format against poses that are known, and what is refused.

use std::fmt::Write as _;

use glam::DMat3;
use proptest::prelude::*;

use super::resample::slerp;
use super::*;
use crate::rotation::angle;

fn read(text: &str) -> Result<Flight> {
    parse_flight("f", text.as_bytes().to_vec(), &Options::default())
}

fn with(text: &str, options: &Options) -> Result<Flight> {
    parse_flight("f", text.as_bytes().to_vec(), options)
}

fn refused(text: &str) -> String {
    read(text).expect_err("refused").to_string()
}

/// Turn about an axis by degrees.
fn turn(axis: DVec3, degrees: f64) -> DQuat {
    DQuat::from_axis_angle(axis, degrees.to_radians())
}

fn close(a: DVec3, b: DVec3) {
    assert!(a.distance(b) < 1e-9, "{a} {b}");
}

/// A TUM file of a straight flight at 50 Hz with a row changed by `edit`.
fn straight(rows: usize, mut edit: impl FnMut(usize, &mut [f64; 8])) -> String {
    let mut out = String::from("# time x y z qx qy qz qw\n");
    for k in 0..rows {
        let mut row = [k as f64 * 0.02, k as f64 * 0.02, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];
        edit(k, &mut row);
        let words: Vec<String> = row.iter().map(f64::to_string).collect();
        let _ = writeln!(out, "{}", words.join(" "));
    }
    out
}

#[test]
fn tum_is_scalar_last_and_already_in_our_frames() {
    let flight = read("# t x y z qx qy qz qw\n10.0 1 2 3 0 0 0.6 0.8\n10.05 1.1 2 3 0 0 0.6 0.8\n")
        .expect("a flight");
    assert_eq!(flight.conventions.format, Format::Tum);
    close(flight.positions[0], DVec3::new(1.0, 2.0, 3.0));
    assert!(angle(flight.rotations[0], DQuat::from_xyzw(0.0, 0.0, 0.6, 0.8)) < 1e-15);
    assert!((flight.time[1] - 0.05).abs() < 1e-12);
    assert_eq!(flight.lines, [2, 3]);
    let options = Options { quaternion: Some(Order::Wxyz), ..Options::default() };
    let other = with("0 0 0 0 0.8 0 0 0.6\n.05 0 0 0 0.8 0 0 0.6\n", &options).expect("a flight");
    assert!(angle(flight.rotations[0], other.rotations[0]) < 1e-15);
}

#[test]
fn airsim_is_north_east_down() {
    let text = "VehicleName\tTimeStamp\tPOS_X\tPOS_Y\tPOS_Z\tQ_W\tQ_X\tQ_Y\tQ_Z\tImageFile\n\
                PX4\t1726962106112\t1\t2\t-3\t0.8\t0\t0\t0.6\ta.png\n\
                PX4\t1726962106212\t1\t2\t-3\t0.8\t0\t0.6\t0\tb.png\n";
    let flight = read(text).expect("a flight");
    assert_eq!(flight.conventions.format, Format::Airsim);
    // North, west, up.
    close(flight.positions[0], DVec3::new(1.0, -2.0, 3.0));
    // A turn to the right about down is a turn to the right about up: negative.
    let yaw = 2.0 * 0.6_f64.atan2(0.8);
    assert!(angle(flight.rotations[0], DQuat::from_rotation_z(-yaw)) < 1e-12);
    // Nose up about right (y of front-right-down) is nose up: x forward goes to +z.
    let nose = flight.rotations[1] * DVec3::X;
    assert!(nose.z > 0.9 && nose.y.abs() < 1e-12, "{nose}");
    assert!((flight.time[1] - 0.1).abs() < 1e-12);
}

#[test]
fn vehicles_are_told_apart() {
    let text = "VehicleName\tTimeStamp\tPOS_X\tPOS_Y\tPOS_Z\tQ_W\tQ_X\tQ_Y\tQ_Z\n\
                a\t0\t0\t0\t0\t1\t0\t0\t0\nb\t0\t9\t0\t0\t1\t0\t0\t0\na\t100\t0\t0\t0\t1\t0\t0\t0\n";
    assert!(refused(text).starts_with("f:3:VehicleName: found a second vehicle 'b'"));
    let options = Options { vehicle: Some("a".into()), ..Options::default() };
    assert_eq!(with(text, &options).expect("a flight").lines, [2, 4]);
    let options = Options { vehicle: Some("c".into()), ..Options::default() };
    let error = with(text, &options).expect_err("refused").to_string();
    assert!(error.contains("no pose of vehicle 'c' in 3 rows"), "{error}");
}

#[test]
fn euroc_keeps_nanoseconds_and_its_imu_looks_up() {
    let text = "#timestamp, p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x []\n\
                1403715524907143168,1,2,3,0.5,-0.5,-0.5,-0.5,9,9\n\
                1403715524912143169,1,2,3,0.5,-0.5,-0.5,-0.5,9,9\n";
    let flight = read(text).expect("a flight");
    assert_eq!(flight.conventions.format, Format::Euroc);
    assert!((flight.time[1] - 0.005_000_001).abs() < 1e-15);
    // The file's x axis is our body's up, its z our forward.
    let q = DMat3::from_quat(DQuat::from_xyzw(-0.5, -0.5, -0.5, 0.5));
    close(flight.rotations[0] * DVec3::Z, q * DVec3::X);
    close(flight.rotations[0] * DVec3::X, q * DVec3::Z);
    close(flight.rotations[0] * DVec3::Y, q * -DVec3::Y);
}

#[test]
fn csv_names_its_columns_and_the_unit_of_its_time() {
    let text = "qz,qy,qx,qw,time_ms,z,y,x\n0.6,0,0,0.8,5,3,2,1\n0.6,0,0,0.8,105,3,2,1\n";
    let flight = read(text).expect("a flight");
    assert_eq!(flight.conventions.format, Format::Csv);
    close(flight.positions[0], DVec3::new(1.0, 2.0, 3.0));
    assert!(angle(flight.rotations[0], DQuat::from_xyzw(0.0, 0.0, 0.6, 0.8)) < 1e-15);
    assert!((flight.time[1] - 0.1).abs() < 1e-12);
}

/// A UAVA file of poses `(x, degrees about up)` in pairs.
fn uava(pairs: &[[(f64, f64); 2]]) -> String {
    let mut names = Vec::new();
    for step in ["_t1", "_t2"] {
        names.extend(["x", "y", "z"].map(|a| format!("Position({a}){step}")));
        names.extend(["x", "y", "z", "w"].map(|a| format!("Orientation({a}){step}")));
    }
    let mut out = names.join("\t") + "\tPilot(x)\n";
    for pair in pairs {
        for (x, degrees) in pair {
            let q = DQuat::from_rotation_z(degrees.to_radians());
            let _ = write!(out, "{x}\t0\t1\t{}\t{}\t{}\t{}\t", q.x, q.y, q.z, q.w);
        }
        out += "5\n";
    }
    out
}

#[test]
fn uava_rows_are_chained_where_they_meet_and_cut_where_not() {
    let flight = read(&uava(&[
        [(0.0, 0.0), (0.1, 5.0)],
        [(0.1, 5.0), (0.2, 10.0)],
        [(4.0, 50.0), (4.1, 55.0)],
    ]))
    .expect("a flight");
    assert_eq!(flight.conventions.format, Format::Uava);
    assert_eq!(flight.segments, [0..3, 3..5]);
    assert_eq!((flight.issues.len(), flight.issues[0].kind), (1, Kind::Break));
    assert_eq!(flight.issues[0].line, 4);
    assert!((flight.time[4] - 4.0 / 60.0).abs() < 1e-15);
    // The body is the paper's mesh: x left, y up, z forward; its file says that z is world up
    // for a turn about z, so that our forward, its z, points up.
    close(flight.rotations[0] * DVec3::X, DVec3::Z);
}

#[test]
fn unity_is_left_handed() {
    let axes = Axes::parse("body_axes", "ruf").expect("axes");
    let options =
        Options { world: Some(World::Unity), body_axes: Some(axes), ..Options::default() };
    // A turn by +90 degrees about y takes z to x in Unity's formulas: to the right.
    let h = 0.5_f64.sqrt();
    let text = format!("0 1 2 3 0 {h} 0 {h}\n0.1 1 2 3 0 {h} 0 {h}\n");
    let flight = with(&text, &options).expect("a flight");
    close(flight.positions[0], DVec3::new(3.0, -1.0, 2.0));
    close(flight.rotations[0] * DVec3::X, -DVec3::Y);
    close(flight.rotations[0] * DVec3::Z, DVec3::Z);
}

#[test]
fn a_mount_is_taken_off() {
    // A sensor that looks down by 20 degrees on a level drone.
    let sensor = turn(DVec3::Y, 20.0);
    let text = format!(
        "0 0 0 0 {0} {1} {2} {3}\n0.1 0 0 0 {0} {1} {2} {3}\n",
        sensor.x, sensor.y, sensor.z, sensor.w
    );
    let options = Options { mount_rpy_deg: [0.0, 20.0, 0.0], ..Options::default() };
    let flight = with(&text, &options).expect("a flight");
    assert!(angle(flight.rotations[0], DQuat::IDENTITY) < 1e-9);
}

#[test]
fn signs_are_put_on_one_side() {
    let text = straight(6, |k, row| {
        if k % 2 == 1 {
            row[7] = -1.0;
        }
    });
    let flight = read(&text).expect("a flight");
    assert_eq!(flight.sign_flips, 5);
    assert!(flight.rotations.windows(2).all(|w| w[0].dot(w[1]) > 0.0));
}

#[test]
fn a_flight_is_cut_where_it_makes_no_sense_and_says_where() {
    let kinds = |flight: &Flight| -> Vec<(Kind, u64)> {
        flight.issues.iter().map(|i| (i.kind, i.line)).collect()
    };
    // Line 1 is the comment, so row k is line k + 2.
    let gap = read(&straight(8, |k, row| row[0] += if k >= 4 { 0.3 } else { 0.0 }));
    let gap = gap.expect("a flight");
    assert_eq!((kinds(&gap), &gap.segments[..]), (vec![(Kind::Gap, 6)], &[0..4, 4..8][..]));
    let jump = read(&straight(8, |k, row| row[1] += if k >= 4 { 1.0 } else { 0.0 }));
    assert_eq!(kinds(&jump.expect("a flight")), [(Kind::Jump, 6)]);
    let spin = read(&straight(8, |k, row| {
        if k >= 4 {
            (row[6], row[7]) = (1.0, 0.0);
        }
    }));
    assert_eq!(kinds(&spin.expect("a flight")), [(Kind::Jump, 6)]);
    let twice = read(&straight(8, |k, row| row[0] -= if k == 4 { 0.02 } else { 0.0 }));
    let twice = twice.expect("a flight");
    assert_eq!((kinds(&twice), twice.time.len()), (vec![(Kind::Duplicate, 6)], 7));
    let back = read(&straight(8, |k, row| row[0] -= if k >= 4 { 0.08 } else { 0.0 }));
    let back = back.expect("a flight");
    assert_eq!(kinds(&back), [(Kind::Backward, 6)]);
    assert!(back.time.windows(2).all(|w| w[1] > w[0]), "{:?}", back.time);
    let alone = read(&straight(9, |k, row| row[1] += if k == 4 { 1.0 } else { 0.0 }));
    let alone = alone.expect("a flight");
    assert_eq!(kinds(&alone), [(Kind::Jump, 6), (Kind::Jump, 7), (Kind::Short, 6)]);
    assert_eq!(alone.time.len(), 8);
}

#[test]
fn a_slow_recording_is_refused_with_the_remedy() {
    let error = refused("0 0 0 0 0 0 0 1\n1.3 1 0 0 0 0 0 1\n2.6 2 0 0 0 0 0 1\n");
    assert!(error.starts_with("f:2: found no two poses") && error.contains("--max-gap"), "{error}");
    assert!(error.contains("steps of 1.300 s"), "{error}");
}

#[test]
fn what_is_no_flight_is_refused_by_name() {
    let euroc = "1403715524907143168,1,2,3,1,0,0,0\n";
    for (text, expected) in [
        ("", "f: found an empty file"),
        ("hello\n", "f:1: found 'hello', expected a flight: UAVA"),
        ("0 0 0 0 0 0 0 1\n", "f: found one pose, expected two"),
        ("# only a comment\n1 2 3\n", "f:1: found"),
        ("0 0 0 0 0 0 0 1\n0.1 0 0 0 0 0 0\n", "f:2: found 7 fields, expected 8"),
        ("0 0 0 0 0 0 0 1\n0.1 0 0 nan 0 0 0 1\n", "f:2:z: found 'nan', expected a finite"),
        ("0 0 0 0 0 0 0 1\n0.1 0 0 0 0 0 0 0\n", "f:2:qx: found a quaternion of zero norm"),
        ("0 0 0 0 0 0 0 1\n0.1 0 0 0 0 0 0 1.2\n", "f:2:qx: found a quaternion of norm 1.2000"),
        ("0 0 0 0 0 0 0 1\n0.1 0 0 1e16 0 0 0 1\n", "f:2:x: found a translation of"),
        ("0 0 0 0 0 0 0 1\nx 0 0 0 0 0 0 1\n", "f:2:time: found 'x', expected a time in s"),
        ("1e18 0 0 0 0 0 0 1\n2e18 0 0 0 0 0 0 1\n", "f:1:time: found '1e18', expected a time"),
        ("1403715524907 0 0 0 0 0 0 1\n", "f:1:time: found '1403715524907', expected a time in s"),
        (&format!("{euroc}1403715524912143168,1,2,3\n"), "f:2: found 4 fields, expected 8"),
        ("t,x,y,qw,qx,qy,qz\n", "f:1:z: found a header without it: 't', 'x'"),
        ("t,x,y,z,tx,qw,qx,qy,qz\n", "f:1:tx: found two columns for one thing: 'x' and 'tx'"),
        ("t,x,y,z,qw,qx,qy,qz\n", "f: found no pose"),
        ("t,x,y,z,qw,qx,qy,qz\n0,0,0,0,1,0,0\n", "f:2: found 7 fields, expected 8, as the header"),
        ("TimeStamp\tPOS_X\tPOS_Y\n", "f:1:POS_Z: found a header without it"),
    ] {
        let error = refused(text);
        assert!(error.starts_with(expected), "{text:?}: {error}");
    }
}

#[test]
fn options_out_of_range_are_named() {
    let text = straight(4, |_, _| ());
    let error = |options| with(&text, &options).expect_err("refused").to_string();
    let limits = Limits { max_gap_s: 0.0, ..Limits::default() };
    assert!(error(Options { limits, ..Options::default() }).starts_with("max_gap_s: found 0"));
    let body_axes = Some(Axes::parse("body_axes", "ruf").expect("axes"));
    assert!(error(Options { body_axes, ..Options::default() }).starts_with("body_axes: 'ruf' are"));
    let csv = Options { format: Format::Csv, quaternion: Some(Order::Wxyz), ..Options::default() };
    assert!(error(csv).starts_with("quaternion: given, but"));
    let flight = read(&text).expect("a flight");
    for rate in [0.0, -1.0, f64::NAN, 1e12] {
        let error = flight.resample(rate).expect_err("refused").to_string();
        assert!(error.starts_with("rate_hz: "), "{error}");
    }
}

/// The second derivatives of the natural spline, by Gaussian elimination of the whole system.
fn dense_spline(t: &[f64], p: &[f64]) -> Vec<f64> {
    let n = t.len();
    let mut a = vec![vec![0.0; n + 1]; n];
    (a[0][0], a[n - 1][n - 1]) = (1.0, 1.0);
    for i in 1..n - 1 {
        let (h0, h1) = (t[i] - t[i - 1], t[i + 1] - t[i]);
        (a[i][i - 1], a[i][i], a[i][i + 1]) = (h0, 2.0 * (h0 + h1), h1);
        a[i][n] = 6.0 * ((p[i + 1] - p[i]) / h1 - (p[i] - p[i - 1]) / h0);
    }
    for k in 0..n {
        let pivot = a[k].clone();
        for (i, row) in a.iter_mut().enumerate() {
            let factor = if i == k { 0.0 } else { row[k] / pivot[k] };
            row.iter_mut().zip(&pivot).for_each(|(x, y)| *x -= factor * y);
        }
    }
    (0..n).map(|i| a[i][n] / a[i][i]).collect()
}

fn spline_at(t: &[f64], p: &[f64], second: &[f64], at: f64) -> f64 {
    let k = (0..t.len() - 1).rev().find(|&k| t[k] <= at).unwrap_or(0);
    let (h, x) = (t[k + 1] - t[k], at - t[k]);
    let c = (p[k + 1] - p[k]) / h - h * (2.0 * second[k] + second[k + 1]) / 6.0;
    p[k] + x * (c + x * (second[k] / 2.0 + x * (second[k + 1] - second[k]) / (6.0 * h)))
}

#[test]
fn positions_lie_on_the_natural_spline() {
    // Unequal steps, and a curve with corners.
    let t = [0.0, 0.03, 0.05, 0.12, 0.2, 0.21, 0.3];
    let x = [0.0, 0.15, -0.05, 0.2, 0.25, 0.25, -0.05];
    let mut text = String::new();
    for (t, x) in t.iter().zip(&x) {
        let _ = writeln!(text, "{t} {x} {} 1 0 0 0 1", 2.0 * x);
    }
    let track = read(&text).expect("a flight").resample(60.0).expect("frames");
    assert_eq!(track.frames, (0..=18).collect::<Vec<i64>>());
    let second = dense_spline(&t, &x);
    for (frame, p) in track.frames.iter().zip(&track.positions) {
        let expected = spline_at(&t, &x, &second, *frame as f64 / 60.0);
        close(*p, DVec3::new(expected, 2.0 * expected, 1.0));
    }
}

#[test]
fn a_steady_turn_stays_steady() {
    // 90 degrees a second, in steps of 9 degrees; signs change now and then.
    let text = straight(11, |k, row| {
        let q = turn(DVec3::Z, 9.0 * k as f64);
        let sign = if k % 3 == 0 { -1.0 } else { 1.0 };
        row[0] = 0.1 * k as f64;
        (row[6], row[7]) = (sign * q.z, sign * q.w);
    });
    let track = read(&text).expect("a flight").resample(60.0).expect("frames");
    assert_eq!(track.frames.len(), 61);
    for (frame, q) in track.frames.iter().zip(&track.rotations) {
        assert!(angle(*q, turn(DVec3::Z, 1.5 * *frame as f64)) < 1e-9, "{frame}");
    }
    // And a straight flight straight.
    close(track.positions[30], DVec3::new(0.1, 0.0, 1.0));
}

#[test]
fn frames_count_from_the_first_row_whatever_is_cut() {
    let text = straight(40, |k, row| row[0] += if k >= 20 { 1.0 } else { 0.0 });
    let track = read(&text).expect("a flight").resample(60.0).expect("frames");
    assert_eq!(track.segments.len(), 2);
    let second = track.segments[1].start;
    assert_eq!((track.frames[second - 1], track.frames[second]), (22, 84));
    assert_eq!(track.lines[0], 2);
    assert!(track.lines.windows(2).all(|w| w[0] <= w[1]));
}

proptest! {
    #[test]
    fn slerp_goes_the_shorter_way_at_a_steady_rate(
        a in prop::array::uniform4(-1.0..1.0_f64), b in prop::array::uniform4(-1.0..1.0_f64), s in 0.0..1.0_f64,
    ) {
        let unit = |q: [f64; 4]| crate::rotation::from_quat_wxyz(q).ok();
        let (Some(a), Some(b)) = (unit(a), unit(b)) else { return Ok(()) };
        let q = slerp(a, b, s);
        let whole = angle(a, b);
        prop_assert!((angle(a, q) - s * whole).abs() < 1e-12);
        prop_assert!((angle(q, b) - (1.0 - s) * whole).abs() < 1e-12);
    }

    #[test]
    fn no_bytes_make_a_reader_panic(bytes in prop::collection::vec(any::<u8>(), 0..200)) {
        for format in [Format::Auto, Format::Uava, Format::Airsim, Format::Tum, Format::Euroc, Format::Csv] {
            let options = Options { format, ..Options::default() };
            if let Err(error) = parse_flight("f", bytes.clone(), &options) {
                let text = error.to_string();
                prop_assert!(text.starts_with('f') && !text.contains(char::is_control), "{text:?}");
            }
        }
    }
}
