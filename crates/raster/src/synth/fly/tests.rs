//! Tests of [`super`]: a flight through two rooms, and what cannot be flown.

use super::*;

/// A room of 8 x 6 x 3 m with a wall at x = 4 that has a door.
fn room() -> Mesh {
    let mut vertices = Vec::new();
    let mut faces = Vec::new();
    let mut wall = |corners: [[f64; 3]; 4]| {
        let k = vertices.len() as u32;
        vertices.extend(corners.map(DVec3::from_array));
        faces.extend([[k, k + 1, k + 2], [k, k + 2, k + 3]]);
    };
    let (x, y, z) = (8.0, 6.0, 3.0);
    wall([[0.0, 0.0, 0.0], [x, 0.0, 0.0], [x, y, 0.0], [0.0, y, 0.0]]);
    wall([[0.0, 0.0, z], [x, 0.0, z], [x, y, z], [0.0, y, z]]);
    wall([[0.0, 0.0, 0.0], [x, 0.0, 0.0], [x, 0.0, z], [0.0, 0.0, z]]);
    wall([[0.0, y, 0.0], [x, y, 0.0], [x, y, z], [0.0, y, z]]);
    wall([[0.0, 0.0, 0.0], [0.0, y, 0.0], [0.0, y, z], [0.0, 0.0, z]]);
    wall([[x, 0.0, 0.0], [x, y, 0.0], [x, y, z], [x, 0.0, z]]);
    wall([[4.0, 0.0, 0.0], [4.0, 4.0, 0.0], [4.0, 4.0, z], [4.0, 0.0, z]]);
    Mesh::new(vertices, faces).expect("sound")
}

fn coins() -> Vec<DVec3> {
    [[1.5, 1.0, 1.5], [6.5, 1.0, 1.4], [4.0, 5.0, 1.5], [2.0, 4.5, 1.2], [6.5, 4.8, 1.7]]
        .map(DVec3::from_array)
        .to_vec()
}

#[test]
fn all_coins_are_collected_through_the_door() {
    let pilot = Pilot { seconds: 60.0, ..Pilot::default() };
    let flown = fly(Some(&room()), &coins(), &pilot).expect("flies");
    let mut seen: Vec<usize> = flown.collected.iter().map(|c| c.1).collect();
    assert!(seen.len() >= 10, "{seen:?}"); // laid out again
    seen.sort_unstable();
    seen.dedup();
    assert_eq!(seen, [0, 1, 2, 3, 4]);
    assert!(flown.unreachable.is_empty());
    assert!(flown.nearest_wall_m > 0.15, "{}", flown.nearest_wall_m);
    // Nobody goes through the wall: at x = 4 the flyer is in the door.
    for pair in flown.track.positions.windows(2) {
        if (pair[0].x - 4.0) * (pair[1].x - 4.0) <= 0.0 {
            assert!(pair[0].y > 4.1, "{}", pair[0]);
        }
    }
}

#[test]
fn it_flies_like_a_drone() {
    let pilot = Pilot { seconds: 30.0, seed: 4, ..Pilot::default() };
    let track = fly(Some(&room()), &coins(), &pilot).expect("flies").track;
    assert_eq!(track.positions.len(), 1801);
    let tilt = |q: &DQuat| (*q * DVec3::Z).z.clamp(-1.0, 1.0).acos().to_degrees();
    let most = track.rotations.iter().map(tilt).fold(0.0, f64::max);
    assert!(most > 3.0 && most < 25.1, "{most}");
    let speeds = track.positions.windows(2).map(|p| p[0].distance(p[1]) * 60.0);
    let fastest = speeds.fold(0.0, f64::max);
    assert!(fastest > 0.8 && fastest < 3.5, "{fastest}");
    let turns = track.rotations.windows(2).map(|q| q[0].angle_between(q[1]).to_degrees());
    let quickest = turns.fold(0.0, f64::max) * 60.0;
    assert!(quickest < 400.0, "{quickest}");
}

#[test]
fn a_seed_gives_one_flight_and_another_seed_another() {
    let flown = |seed, variance| {
        let pilot = Pilot { seconds: 5.0, seed, variance, ..Pilot::default() };
        fly(Some(&room()), &coins(), &pilot).expect("flies").track.positions
    };
    assert_eq!(flown(1, 0.3), flown(1, 0.3));
    assert_ne!(flown(1, 0.3), flown(2, 0.3));
    let spread = |variance| {
        let (a, b) = (flown(1, variance), flown(2, variance));
        a.iter().zip(&b).map(|(a, b)| a.distance(*b)).fold(0.0, f64::max)
    };
    assert!(spread(0.0) < 0.2 * spread(0.6) + 0.2);
}

#[test]
fn what_cannot_be_flown_is_named() {
    let refused = |coins: &[DVec3], pilot: Pilot| {
        fly(Some(&room()), coins, &pilot).expect_err("refused").to_string()
    };
    let sound = Pilot::default();
    assert!(refused(&[], sound).starts_with("coins: "));
    assert!(refused(&[DVec3::NAN], sound).starts_with("coins[0]: not finite"));
    assert!(refused(&[DVec3::new(0.05, 1.0, 1.0)], sound).contains("from a wall"));
    let wrong = Pilot { rate_hz: 50.0, ..sound };
    assert!(refused(&coins(), wrong).starts_with("rate_hz: found 50"));
    let wrong = Pilot { variance: f64::NAN, ..sound };
    assert!(refused(&coins(), wrong).starts_with("variance"));
    // A coin behind a closed wall is told.
    let outside = [coins()[0], DVec3::new(20.0, 1.0, 1.0)];
    let flown = fly(Some(&room()), &outside, &Pilot { seconds: 2.0, ..sound }).expect("flies");
    assert_eq!(flown.unreachable, [1]);
    assert!(fly(None, &coins(), &Pilot { seconds: 1.0, ..sound }).is_ok());
}
