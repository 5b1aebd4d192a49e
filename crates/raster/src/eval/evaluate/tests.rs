//! The whole evaluation on data whose numbers can be worked out by hand.

use glam::DVec3;

use super::*;
use crate::eval::request::{Choice, Level, Silent};
use crate::io::{PoseOptions, parse_poses};
use crate::mesh::Mesh;

/// A square of 2 m diagonal in the plane z = 0.
fn square() -> Objects {
    let corners = [DVec3::X, DVec3::Y, -DVec3::X, -DVec3::Y];
    let mesh = Mesh::new(corners.to_vec(), vec![[0, 1, 2], [0, 2, 3]]).expect("sound");
    Objects::from_mesh(&mesh).expect("sound")
}

fn csv(rows: &str) -> PoseTable {
    let text = format!("id,qw,qx,qy,qz,tx,ty,tz,scene\n{rows}");
    let options = PoseOptions { keep: vec!["scene".into()], ..PoseOptions::default() };
    parse_poses("x.csv", text.into_bytes(), &options).expect("sound")
}

fn run(predictions: &PoseTable, gt: &PoseTable, request: &Request) -> Result<Outcome> {
    let (objects, cameras) =
        (square(), Cameras::from_text("100,100,50,50,320,240").expect("a list")?);
    Evaluator { gt, objects: &objects, cameras: &cameras, request }.run(predictions, &[], &Silent)
}

fn close(a: f64, b: f64) {
    assert!((a - b).abs() < 1e-12, "{a} {b}");
}

const GT: &str = "a,1,0,0,0,0,0,2,x\nb,1,0,0,0,0,0,4,x\nc,1,0,0,0,0,0,5,y\n";

#[test]
fn a_shift_and_a_half_turn_have_the_numbers_of_the_closed_form() {
    // a: 3 cm aside at 2 m; b: half a turn about z, the square onto itself; c: missing.
    let predictions = csv("a,1,0,0,0,0.03,0,2,x\nb,0,0,0,1,0,0,4,x\n");
    let e = run(&predictions, &csv(GT), &Request::default()).expect("sound").evaluation;
    let m = &e.metrics;
    assert_eq!((e.n_gt, e.n_predictions, e.n_matched), (3, 2, 2));
    close(m.npe.expect("two").mean, 0.015 / 2.0);
    close(m.oe_deg.expect("two").max, 180.0);
    close(m.cpe.expect("two").max, std::f64::consts::PI);
    // Each corner of b moves to the opposite one, 2 m away; its nearest corner is where it was.
    close(m.add_m.expect("two").mean, f64::midpoint(0.03, 2.0));
    close(m.adds_m.expect("two").mean, 0.015);
    close(m.mssd_m.expect("two").max, 2.0);
    // 100 px * 0.03 m / 2 m, and 100 px * 2 m / 4 m.
    close(m.mspd_px.expect("two").min, 1.5);
    close(m.proj_px.expect("two").max, 50.0);
    assert_eq!(m.acc["5"].count, 1);
    close(m.acc["5"].percent_of_gt, 100.0 / 3.0);
    close(m.acc["5"].percent_of_matched.expect("two"), 50.0);
    let recall = m.add_recall.as_ref().expect("a mesh");
    close(recall.reference_m.expect("one object"), 8.0_f64.sqrt());
    assert_eq!(
        (recall.at["2"].count, m.adds_recall.as_ref().expect("a mesh").at["2"].count),
        (1, 2)
    );
    close(m.add_auc.expect("a mesh").exact, 0.7 / 3.0);
    // MSSD of a is below 5 % of 2 m; MSPD below 5 px of 640, which is 2.5 px of 320.
    let bop = m.bop.expect("a mesh and a camera");
    close(bop.ar_mssd.expect("a mesh"), 1.0 / 3.0);
    close(bop.ar_mspd.expect("a camera"), 1.0 / 3.0);
    assert_eq!(e.worst[0].id, "b");
    assert_eq!(e.worst[0].line, Some(3));
    assert!(e.warnings[0].contains("1 of 3 ground-truth poses"), "{:?}", e.warnings);
}

#[test]
fn strict_refuses_what_draws_a_warning() {
    let predictions = csv("a,1,0,0,0,0.03,0,2,x\n");
    let request = Request { strict: true, ..Request::default() };
    let error = run(&predictions, &csv(GT), &request).expect_err("two are missing").to_string();
    assert!(error.contains("--strict") && error.contains("2 of 3"), "{error}");
    let gt = csv(GT);
    assert!(run(&gt, &gt, &request).is_ok());
}

#[test]
fn perfect_predictions_are_exactly_perfect() {
    let gt = csv("a,0.3,-0.2,0.9,0.1,0.1,-0.4,2.3,x\nb,-0.7,0.2,0.1,0.5,0.3,0.2,1.7,y\n");
    let m = run(&gt, &gt, &Request::default()).expect("sound").evaluation.metrics;
    for s in [m.npe, m.oe_rad, m.te_m, m.cpe, m.add_m, m.adds_m, m.mssd_m, m.mspd_px, m.proj_px] {
        assert_eq!(s.expect("computed").max.to_bits(), 0);
    }
    assert_eq!(m.bop, Some(crate::eval::Bop { ar_mssd: Some(1.0), ar_mspd: Some(1.0) }));
}

#[test]
fn ground_truth_at_the_camera_is_refused() {
    let gt = csv("a,1,0,0,0,0,0,0,x\n");
    let error = run(&gt, &gt, &Request::default()).expect_err("NPE divides by zero").to_string();
    assert!(error.starts_with("x.csv:2:tx..tz: found"), "{error}");
}

#[test]
fn breakdowns_add_up() {
    let predictions = csv("a,1,0,0,0,0.03,0,2,x\nb,1,0,0,0,0,0,4,x\nc,1,0,0,0,0,0,5,y\n");
    let by = ["scene", "distance", "azimuth"].map(String::from).to_vec();
    let request = Request { by, ..Request::default() };
    let e = run(&predictions, &csv(GT), &request).expect("sound").evaluation;
    let labels: Vec<&str> = e.by[0].groups.iter().map(|g| g.label.as_str()).collect();
    assert_eq!(labels, ["x", "y"]);
    assert_eq!(e.by[0].groups[0].n_gt, 2);
    close(e.by[0].groups[0].te_m.expect("two"), 0.015);
    for by in &e.by {
        assert_eq!(by.groups.iter().map(|g| g.n_gt).sum::<usize>(), 3, "{}", by.column);
    }
    let unknown = Request { by: vec!["nosuch".into()], ..Request::default() };
    assert!(run(&predictions, &csv(GT), &unknown).is_err());
}

#[test]
fn the_authors_average_batches() {
    let predictions = csv("a,1,0,0,0,0.03,0,2,x\nb,1,0,0,0,0,0,4,x\nc,1,0,0,0,0,0.5,5,y\n");
    let request = Request { preset: Preset::Authors, batch_size: 2, ..Request::default() };
    let authors = run(&predictions, &csv(GT), &request).expect("sound").evaluation.authors;
    let authors = authors.expect("the preset asks for it");
    assert_eq!((authors.batch_size, authors.n_batches), (2, 2));
    close(authors.npe, f64::midpoint(0.015 / 2.0, 0.1));
    close(authors.acc["5"], 50.0);
}

#[test]
fn the_same_bits_on_any_number_of_threads() {
    let row = |i: i32| {
        let a = f64::from(i);
        format!(
            "{i},{},{},0.3,{},{},0.2,{},s{}\n",
            a.sin(),
            a.cos(),
            (a * 0.7).sin(),
            a * 1e-3,
            1.0 + a * 1e-2,
            i % 3
        )
    };
    let gt = csv(&(0..700).map(row).collect::<Vec<_>>().concat());
    let predictions = csv(&(0..650)
        .map(|i| row(i + 1))
        .enumerate()
        .map(|(i, r)| format!("{i},{}", r.split_once(',').expect("an id").1))
        .collect::<Vec<_>>()
        .concat());
    let request = Request {
        by: vec!["scene".into()],
        acc: Level::list("acc", &[0.5, 5.0]).expect("positive"),
        choice: Choice::All,
        bootstrap: Some(200),
        ..Request::default()
    };
    let on = |threads| {
        let outcome = crate::threads::install(threads, || run(&predictions, &gt, &request));
        crate::report::json(&outcome.expect("startable").expect("sound").evaluation)
    };
    let one = on(1);
    assert_eq!(one, on(2));
    assert_eq!(one, on(7));
}

#[test]
fn several_instances_are_matched_as_bop_does() {
    // Two instances of one object in an image; the better score takes its nearest instance.
    let table = |name: &str, rows: &[(f64, f64)]| {
        let line =
            |&(score, x): &(f64, f64)| format!("1,0,1,{score},1 0 0 0 1 0 0 0 1,{x} 0 4000,-1\n");
        let rows: String = rows.iter().map(line).collect::<Vec<_>>().concat();
        let text = format!("scene_id,im_id,obj_id,score,R,t,time\n{rows}");
        parse_poses(name, text.into_bytes(), &PoseOptions::default()).expect("sound")
    };
    let gt = table("gt.csv", &[(1.0, 0.0), (1.0, 500.0)]);
    let estimates = table("est.csv", &[(0.2, 0.0), (0.9, 490.0), (0.8, 480.0)]);
    let e = run(&estimates, &gt, &Request::default()).expect("sound").evaluation;
    // The two best scores: 490 for the instance at 500; 480 is left with the one at 0.
    assert_eq!(e.n_matched, 2);
    close(e.metrics.te_m.expect("two").max, 0.48);
    // Of a diameter of 2 m: 10 mm is below every threshold, 480 mm below 25 % and more.
    close(e.metrics.bop.expect("a mesh").ar_mssd.expect("a mesh"), (10.0 + 6.0) / 20.0);
}
