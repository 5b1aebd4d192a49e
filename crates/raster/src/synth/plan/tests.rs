//! Tests of [`super`].

use glam::DQuat;

use super::*;
use crate::rotation::angle;

/// A flight along x through two anchors, with a rest in the middle.
fn track(n: usize) -> Track {
    let x = |i: usize| 0.02 * (i.min(n / 2) + i.saturating_sub(n / 2 + 10)) as f64;
    Track {
        rate_hz: 60.0,
        frames: (100..100 + n.cast_signed() as i64).collect(),
        positions: (0..n).map(|i| DVec3::new(x(i), 0.0, 1.2)).collect(),
        rotations: (0..n).map(|i| DQuat::from_rotation_z(0.001 * i as f64)).collect(),
        lines: (2..n as u64 + 2).collect(),
        segments: vec![0..n / 3, n / 3..n],
    }
}

fn anchors() -> (Vec<DVec3>, Vec<String>) {
    let p = vec![DVec3::new(1.0, 1.0, 1.5), DVec3::new(4.0, 1.0, 1.5)];
    (p, vec!["a".into(), "b, \"c\"".into()])
}

fn made(rules: &Rules, threads: usize) -> Plan {
    let (p, names) = anchors();
    plan(&track(300), &p, &names, rules, threads).expect("sound")
}

fn bytes(plan: &Plan) -> Vec<u8> {
    let mut out = Vec::new();
    plan.write_csv(&mut out).expect("in memory");
    out
}

#[test]
fn the_bits_do_not_depend_on_threads() {
    let rules = Rules::default();
    let one = bytes(&made(&rules, 1));
    assert!(one == bytes(&made(&rules, 2)) && one == bytes(&made(&rules, 7)));
    assert!(one != bytes(&made(&Rules { seed: 1, ..rules }, 1)));
}

#[test]
fn a_rule_more_changes_no_draw_of_another_sample() {
    let all = made(&Rules::default(), 1);
    let near = made(&Rules { max_distance_m: 1.2, ..Rules::default() }, 1);
    assert!(!near.samples.is_empty() && near.samples.len() < all.samples.len());
    for s in &near.samples {
        let same = all.samples.iter().find(|o| o.frame == s.frame).expect("kept before too");
        assert_eq!((s.exo, s.pose), (same.exo, same.pose));
    }
}

#[test]
fn the_funnel_adds_up() {
    let plan = made(&Rules::default(), 1);
    let names: Vec<&str> = plan.funnel.iter().map(|s| s.rule).collect();
    assert_eq!(
        names,
        ["anchor", "distance", "neighbours", "ego-motion", "look-at", "border", "pair"]
    );
    assert_eq!(plan.funnel[0].came_in, 300);
    for pair in plan.funnel.windows(2) {
        assert_eq!(pair[0].came_in - pair[0].removed, pair[1].came_in);
    }
    let last = plan.funnel.last().expect("steps");
    assert_eq!(last.came_in - last.removed, plan.samples.len());
    assert!(plan.funnel[1].removed > 0 && plan.funnel[3].removed > 0);
}

#[test]
fn a_rule_that_was_not_asked_for_has_no_step() {
    let corners = Some([[-0.3, -0.3, -0.1], [0.3, 0.3, 0.1]]);
    let plan = made(&Rules { whole_box_m: corners, ..Rules::default() }, 1);
    let step = plan.funnel.iter().find(|s| s.rule == "whole").expect("asked for");
    assert!(step.removed > 0 && step.came_in > step.removed);
    assert!(plan.samples.len() < made(&Rules::default(), 1).samples.len());
}

#[test]
fn poses_of_a_sample_agree_with_one_another() {
    let axes = crate::synth::axes::Axes::parse("model_axes", "luf").expect("axes");
    let rules = Rules { model_axes: axes, stride: 2, ..Rules::default() };
    let (plan, track) = (made(&rules, 1), track(300));
    assert!(plan.samples.len() > 10);
    for s in &plan.samples {
        assert_eq!(s.frame, track.frames[s.index]);
        let world = Pose::new(track.rotations[s.index], track.positions[s.index]);
        // The mesh's z is the body's x.
        let ahead = world.transform_point(DVec3::X);
        assert!(s.drone.transform_point(DVec3::Z).distance(ahead) < 1e-12);
        let seen = s.exo.transform_point(ahead);
        assert!(s.pose.transform_point(DVec3::Z).distance(seen) < 1e-12);
        // What the drone sees ahead is on its camera's axis.
        assert!(s.ego.transform_point(ahead).distance(DVec3::Z) < 1e-12);
        let later = Pose::new(track.rotations[s.index + 2], track.positions[s.index + 2]);
        assert!(s.drone_next.translation.distance(later.translation) < 1e-12);
        assert!(s.ego_next.inverse().translation.distance(later.translation) < 1e-12);
        assert!((s.next.0 - world.translation.distance(later.translation)).abs() < 1e-15);
        let turned = angle(world.rotation, later.rotation).to_degrees();
        assert!((s.next.1 - turned).abs() < 1e-12);
    }
}

#[test]
fn the_csv_has_a_number_for_every_column_and_quotes_names() {
    let plan = made(&Rules { prefix: "house-".into(), ..Rules::default() }, 1);
    let text = String::from_utf8(bytes(&plan)).expect("text");
    let mut lines = text.lines();
    let columns = lines.next().expect("a header").split(',').count();
    assert_eq!(columns, 2 + 15 + 7 * 7);
    assert!(text.contains("\nhouse-000") && text.contains(",\"b, \"\"c\"\"\","));
    let row = lines.next().expect("a row");
    assert_eq!(row.split(',').count(), columns);
    assert!(row.split(',').skip(2).all(|f| f.parse::<f64>().is_ok_and(f64::is_finite)));
}

#[test]
fn a_rule_that_needs_pictures_keeps_what_it_says() {
    let plan = made(&Rules::default(), 1);
    let keep: Vec<bool> = (0..plan.samples.len()).map(|k| k % 2 == 0).collect();
    let half = plan.only(&keep);
    assert_eq!(half.samples.len(), plan.samples.len().div_ceil(2));
    assert_eq!(half.samples[1].frame, plan.samples[2].frame);
}

#[test]
fn a_scene_without_anchors_is_refused() {
    let error = plan(&track(30), &[], &[], &Rules::default(), 1).expect_err("refused");
    assert!(error.to_string().starts_with("anchors: one at least"));
}
