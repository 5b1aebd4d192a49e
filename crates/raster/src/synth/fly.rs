//! A flyer for who has no flight: a quadrotor that collects coins in a scene, as the pilots of the
//! paper's game did, and keeps away from its walls.
//!
//! **Body.** A point with a thrust along its own z axis: `v' = T z - g - k v`, in which the attitude
//! follows the wanted thrust with a lag, tilts by a bounded angle and turns about the vertical by a
//! bounded rate; integrated in steps of 1/240 s (semi-implicit Euler).
//!
//! **Pilot.** The coins are joined where the straight way between two keeps clear of the walls; the
//! next coin is the nearest by those ways that is not collected (Dijkstra), with the pilot's whim as
//! a random factor on each length. A speed towards the next point is asked for that can still be
//! braked there, and a slowly wandering error (Ornstein-Uhlenbeck) is added to what is asked. When
//! all coins are collected, they are laid out again.
//!
//! **Walls** push away within twice the clearance; a step that would come nearer than half the
//! clearance slides along the wall. Distances are parry3d's, in single precision.

use glam::{DMat3, DQuat, DVec3};
use parry3d::math::Vec3;
use parry3d::query::PointQuery;
use parry3d::shape::TriMesh;
use rand_pcg::Pcg64Mcg;
use serde::{Deserialize, Serialize};

use super::flight::Track;
use crate::Mesh;
use crate::error::{Error, Result};
use crate::random::{generator, unit};

const GRAVITY: f64 = 9.81;
/// Steps of the integration in a second.
const STEPS: usize = 240;
/// Points at which a way is looked at, metres apart.
const PROBE: f64 = 0.1;
/// A coin is collected from this far, metres.
const REACH: f64 = 0.35;
/// Seconds after which a coin that cannot be reached is given up.
const PATIENCE: f64 = 20.0;

/// How the flyer flies.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Pilot {
    /// Of everything random.
    pub seed: u64,
    /// Length of the flight, seconds.
    pub seconds: f64,
    /// Poses a second that are kept; divides 240.
    pub rate_hz: f64,
    /// Speed that is asked for, m/s.
    pub speed_m_s: f64,
    /// Largest tilt, degrees.
    pub max_tilt_deg: f64,
    /// Largest turn about the vertical, degrees/s.
    pub max_yaw_deg_s: f64,
    /// Distance to walls that ways keep, metres.
    pub clearance_m: f64,
    /// The pilot's variance: 0 flies the same way every time, 1 is erratic.
    pub variance: f64,
}

impl Default for Pilot {
    fn default() -> Self {
        Self {
            seed: 0,
            seconds: 60.0,
            rate_hz: 60.0,
            speed_m_s: 1.6,
            max_tilt_deg: 25.0,
            max_yaw_deg_s: 120.0,
            clearance_m: 0.4,
            variance: 0.3,
        }
    }
}

impl Pilot {
    fn check(&self) -> Result<()> {
        let refuse = |name: &str, value: f64, expected: &str| {
            Err(Error::argument(name, format!("found {value}, expected {expected}")))
        };
        for (name, value, low, high) in [
            ("seconds", self.seconds, 1e-3, 1e5),
            ("speed_m_s", self.speed_m_s, 0.05, 20.0),
            ("max_tilt_deg", self.max_tilt_deg, 1.0, 60.0),
            ("max_yaw_deg_s", self.max_yaw_deg_s, 1.0, 1000.0),
            ("clearance_m", self.clearance_m, 0.0, 10.0),
            ("variance", self.variance, 0.0, 1.0),
        ] {
            if !(low..=high).contains(&value) {
                return refuse(name, value, &format!("{low} to {high}"));
            }
        }
        let every = STEPS as f64 / self.rate_hz;
        if !(every >= 1.0 && every.fract() == 0.0) {
            return refuse("rate_hz", self.rate_hz, "a divisor of 240 such as 30, 60 or 120");
        }
        Ok(())
    }
}

/// What came out of a flight.
#[derive(Debug, Clone)]
pub struct Flown {
    /// The poses, at the rate asked for, in one piece.
    pub track: Track,
    /// Second and index of each coin that was collected, in order.
    pub collected: Vec<(f64, usize)>,
    /// Coins that the flyer cannot get to from where it starts.
    pub unreachable: Vec<usize>,
    /// Least distance to a wall, metres; infinite without walls.
    pub nearest_wall_m: f64,
}

/// The surface of a scene, for distances.
struct Walls(Option<TriMesh>);

impl Walls {
    fn new(mesh: Option<&Mesh>) -> Result<Self> {
        let Some(mesh) = mesh.filter(|mesh| !mesh.faces().is_empty()) else {
            return Ok(Self(None));
        };
        let points = mesh.vertices().iter().map(|v| single(*v)).collect();
        let made = TriMesh::new(points, mesh.faces().to_vec());
        made.map(|mesh| Self(Some(mesh)))
            .map_err(|e| Error::argument("mesh", format!("cannot be searched: {e}")))
    }

    /// Distance to the nearest point, and the direction away from it.
    fn near(&self, p: DVec3) -> (f64, DVec3) {
        let Some(mesh) = &self.0 else { return (f64::INFINITY, DVec3::ZERO) };
        let found = mesh.project_local_point(single(p), false).point;
        let away = p - DVec3::new(found.x.into(), found.y.into(), found.z.into());
        (away.length(), away.normalize_or_zero())
    }

    /// Whether the straight way keeps clear.
    fn free(&self, a: DVec3, b: DVec3, clearance: f64) -> bool {
        if self.0.is_none() {
            return true;
        }
        let count = (a.distance(b) / PROBE).ceil().max(1.0) as usize;
        (0..=count).all(|k| self.near(a.lerp(b, k as f64 / count as f64)).0 >= clearance)
    }
}

fn single(p: DVec3) -> Vec3 {
    let p = p.as_vec3();
    Vec3::new(p.x, p.y, p.z)
}

/// Fly in a scene from the first coin on.
///
/// # Errors
/// [`Error::Argument`]: a setting out of its range, no coin, a coin that is not finite, or a first
/// coin nearer to a wall than half the clearance.
pub fn fly(mesh: Option<&Mesh>, coins: &[DVec3], pilot: &Pilot) -> Result<Flown> {
    pilot.check()?;
    if let Some(k) = coins.iter().position(|c| !c.is_finite()) {
        return Err(Error::argument(format!("coins[{k}]"), "not finite"));
    }
    let Some(&start) = coins.first() else {
        return Err(Error::argument("coins", "expected one at least"));
    };
    let walls = Walls::new(mesh)?;
    let (gap, _) = walls.near(start);
    if gap < 0.5 * pilot.clearance_m {
        let text = format!(
            "{gap:.3} m from a wall; expected half the clearance of {} m",
            pilot.clearance_m
        );
        return Err(Error::argument("coins[0]", text));
    }
    let ways = ways(&walls, coins, pilot.clearance_m);
    let mut flyer = Flyer::new(coins, &walls, &ways, pilot);
    let every = (STEPS as f64 / pilot.rate_hz) as usize;
    let frames = (pilot.seconds * pilot.rate_hz).floor() as usize + 1;
    let mut positions = Vec::with_capacity(frames);
    let mut rotations: Vec<DQuat> = Vec::with_capacity(frames);
    let mut nearest = f64::INFINITY;
    for frame in 0..frames {
        nearest = nearest.min(walls.near(flyer.position).0);
        positions.push(flyer.position);
        let q = flyer.attitude();
        let last = rotations.last().copied().unwrap_or(q);
        rotations.push(if last.dot(q) < 0.0 { -q } else { q });
        for step in 0..every {
            flyer.step((frame * every + step) as f64 / STEPS as f64);
        }
    }
    let reachable = lengths(&ways, coins, 0, |_| 1.0);
    let unreachable = (0..coins.len()).filter(|&k| reachable[k].0.is_infinite()).collect();
    let track = Track {
        rate_hz: pilot.rate_hz,
        frames: (0..frames.cast_signed() as i64).collect(),
        positions,
        rotations,
        lines: (1..=frames as u64).collect(),
        segments: std::iter::once(0..frames).collect(),
    };
    Ok(Flown { track, collected: flyer.collected, unreachable, nearest_wall_m: nearest })
}

/// Which coins can be reached from which along a straight line.
fn ways(walls: &Walls, coins: &[DVec3], clearance: f64) -> Vec<Vec<usize>> {
    let mut found = vec![Vec::new(); coins.len()];
    for a in 0..coins.len() {
        for b in 0..a {
            if walls.free(coins[a], coins[b], clearance) {
                found[a].push(b);
                found[b].push(a);
            }
        }
    }
    found
}

/// Length of the shortest way from a coin to every other and the coin before it (Dijkstra), where
/// each straight piece counts `whim` times as long.
fn lengths(
    ways: &[Vec<usize>],
    coins: &[DVec3],
    from: usize,
    mut whim: impl FnMut(usize) -> f64,
) -> Vec<(f64, usize)> {
    let mut best = vec![(f64::INFINITY, from); coins.len()];
    let mut open: Vec<usize> = (0..coins.len()).collect();
    best[from].0 = 0.0;
    while let Some(place) = (0..open.len())
        .min_by(|&a, &b| best[open[a]].0.total_cmp(&best[open[b]].0).then(open[a].cmp(&open[b])))
    {
        let here = open.swap_remove(place);
        if best[here].0.is_infinite() {
            break;
        }
        for &next in &ways[here] {
            let length = best[here].0 + coins[here].distance(coins[next]) * whim(next);
            if length < best[next].0 {
                best[next] = (length, here);
            }
        }
    }
    best
}

/// The drone, its pilot, and what is left of the coins.
struct Flyer<'a> {
    coins: &'a [DVec3],
    walls: &'a Walls,
    ways: &'a [Vec<usize>],
    pilot: &'a Pilot,
    rng: Pcg64Mcg,
    position: DVec3,
    velocity: DVec3,
    /// Unit thrust direction, the body's z.
    up: DVec3,
    /// Heading of the nose about the vertical, radians.
    yaw: f64,
    /// The pilot's error, m/s^2.
    error: DVec3,
    left: Vec<bool>,
    /// Coins on the way, the next one last.
    path: Vec<usize>,
    /// The coin the flyer was at last, and when.
    at: (usize, f64),
    collected: Vec<(f64, usize)>,
}

impl<'a> Flyer<'a> {
    fn new(coins: &'a [DVec3], walls: &'a Walls, ways: &'a [Vec<usize>], pilot: &'a Pilot) -> Self {
        let mut rng = generator(pilot.seed, 0);
        let yaw = std::f64::consts::TAU * unit(&mut rng);
        Self {
            coins,
            walls,
            ways,
            pilot,
            rng,
            position: coins[0],
            velocity: DVec3::ZERO,
            up: DVec3::Z,
            yaw,
            error: DVec3::ZERO,
            left: vec![true; coins.len()],
            path: Vec::new(),
            at: (0, 0.0),
            collected: Vec::new(),
        }
    }

    /// `world_from_body`: z along the thrust, x towards the heading.
    fn attitude(&self) -> DQuat {
        let nose = DVec3::new(self.yaw.cos(), self.yaw.sin(), 0.0);
        let left = self.up.cross(nose).normalize_or(DVec3::Y);
        DQuat::from_mat3(&DMat3::from_cols(left.cross(self.up), left, self.up)).normalize()
    }

    /// About normal, mean 0, deviation 1.
    fn noise(&mut self) -> f64 {
        (0..12).map(|_| unit(&mut self.rng)).sum::<f64>() - 6.0
    }

    /// Choose the next coin where there is none, or where the last could not be reached.
    fn choose(&mut self, time: f64) {
        if self.left.iter().all(|left| !left) {
            self.left.fill(true);
            self.left[self.at.0] = false;
        }
        let (variance, rng) = (self.pilot.variance, &mut self.rng);
        let best = lengths(self.ways, self.coins, self.at.0, |_| 1.0 + variance * unit(rng));
        let next = (0..best.len())
            .filter(|&k| self.left[k] && best[k].0.is_finite())
            .min_by(|&a, &b| best[a].0.total_cmp(&best[b].0));
        self.path.clear();
        self.at.1 = time;
        let Some(mut k) = next else {
            // Nothing else can be reached: what could not is given up, the rest is laid out again.
            self.left.fill(true);
            return;
        };
        while k != self.at.0 {
            self.path.push(k);
            k = best[k].1;
        }
        if self.path.is_empty() {
            self.path.push(self.at.0);
        }
    }

    /// A step of `1 / STEPS` seconds that begins at `time`.
    fn step(&mut self, time: f64) {
        let dt = 1.0 / STEPS as f64;
        if self.path.is_empty() || time - self.at.1 > PATIENCE {
            self.choose(time);
        }
        let target = self.path.last().map_or(self.coins[self.at.0], |&k| self.coins[k]);
        let to = target - self.position;
        if let Some(&k) = self.path.last()
            && to.length() < REACH
        {
            self.path.pop();
            self.at = (k, time);
            if std::mem::replace(&mut self.left[k], false) {
                self.collected.push((time, k));
            }
        }
        let wanted = self.acceleration(to, dt);
        self.tilt(wanted, dt);
        let (gap, away) = self.walls.near(self.position);
        let thrust = (wanted + DVec3::Z * GRAVITY + 0.25 * self.velocity).dot(self.up).max(0.0);
        let force = self.up * thrust - DVec3::Z * GRAVITY - 0.25 * self.velocity;
        self.velocity += force * dt;
        let next = self.position + self.velocity * dt;
        if gap < 0.5 * self.pilot.clearance_m + self.velocity.length() * dt
            && self.velocity.dot(away) < 0.0
        {
            self.velocity -= away * self.velocity.dot(away);
            self.position += self.velocity * dt;
        } else {
            self.position = next;
        }
        self.turn(dt);
    }

    /// What the pilot asks for, m/s^2.
    fn acceleration(&mut self, to: DVec3, dt: f64) -> DVec3 {
        let most = GRAVITY * self.pilot.max_tilt_deg.to_radians().tan();
        let brake = (2.0 * 0.5 * most * (to.length() - 0.3 * REACH).max(0.0)).sqrt();
        let passing = if self.path.len() > 1 { 0.6 * self.pilot.speed_m_s } else { 0.2 };
        let speed = self.pilot.speed_m_s.min(brake.max(passing));
        // Ornstein-Uhlenbeck with a memory of 0.7 s.
        let memory = (-dt / 0.7_f64).exp();
        let fresh = (1.0 - memory * memory).sqrt() * 1.8 * self.pilot.variance;
        let noise = DVec3::new(self.noise(), self.noise(), 0.5 * self.noise());
        self.error = memory * self.error + fresh * noise;
        let (gap, away) = self.walls.near(self.position);
        let close = (1.0 - gap / (2.0 * self.pilot.clearance_m).max(1e-9)).max(0.0);
        let asked = 2.5 * (to.normalize_or_zero() * speed - self.velocity);
        let wanted = asked + self.error + away * (close * close * 6.0);
        DVec3::new(wanted.x, wanted.y, wanted.z.clamp(-4.0, 4.0)).clamp_length_max(most)
    }

    /// The attitude follows the wanted thrust.
    fn tilt(&mut self, wanted: DVec3, dt: f64) {
        let thrust = wanted + DVec3::Z * GRAVITY + 0.25 * self.velocity;
        let level = DVec3::new(thrust.x, thrust.y, 0.0);
        let most = thrust.z.max(1.0) * self.pilot.max_tilt_deg.to_radians().tan();
        let aim = (level.clamp_length_max(most) + DVec3::Z * thrust.z.max(1.0)).normalize();
        let follow = 1.0 - (-dt / 0.12_f64).exp();
        self.up = self.up.lerp(aim, follow).normalize();
    }

    /// The nose turns to where the flight goes.
    fn turn(&mut self, dt: f64) {
        let level = DVec3::new(self.velocity.x, self.velocity.y, 0.0);
        if level.length() < 0.15 {
            return;
        }
        let to = level.y.atan2(level.x) - self.yaw;
        let to = to - std::f64::consts::TAU * (to / std::f64::consts::TAU).round();
        let most = self.pilot.max_yaw_deg_s.to_radians() * dt;
        self.yaw += (to * (1.0 - (-dt / 0.3_f64).exp())).clamp(-most, most);
    }
}

#[cfg(test)]
mod tests;
