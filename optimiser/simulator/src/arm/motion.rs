//! The joints of an arm that makes a motion, and whether it can: the whole way, also between ticks.

use nalgebra::Vector3;
use powderline_shared::arm::inverse::Posture;
use powderline_shared::arm::links::{Link, SingularityMargins, axes};
use powderline_shared::arm::{ArmError, ArmKind, ArmModel, Joints};
use powderline_shared::displacement::Lsb;
use powderline_shared::limits::{LimitChecker, Limits, PeakUse, Violation};
use powderline_shared::pose::Pose;
use std::fmt;

use super::path::ToolPath;
use super::self_collision::{Contact, Part, contact};
use super::spline;
use super::surroundings::Surroundings;
use super::transit::BEFORE_S;
use crate::scene::Obstacle;
use std::f64::consts::FRAC_PI_4;

/// How an arm stands and holds the tool.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mount {
    /// Which arm.
    pub kind: ArmKind,
    /// The arm's base in the world.
    pub world_from_base: Pose,
    /// The tool's frame in the flange.
    pub flange_from_tool: Pose,
    /// The posture that it has to take. Without, the best one (see [`ArmMotion::new`]).
    pub posture: Option<Posture>,
    /// Joints near which the motion is to begin, radians, which also decide the posture. Without, each joint begins within half
    /// a turn of zero.
    pub near: Option<Joints>,
    /// What every link keeps from its surroundings, metres: a motion that does not is refused. Without, the clearance is only
    /// measured, and the posture chosen by it.
    pub clearance_m: Option<f64>,
}

/// How near a link comes to what is around it.
#[derive(Clone, Debug, PartialEq)]
pub struct Clearance {
    /// Which.
    pub link: Link,
    /// What it comes near to.
    pub obstacle: Obstacle,
    /// From surface to surface, metres; negative where they would pass through each other.
    pub distance_m: f64,
    /// When, seconds.
    pub time_s: f64,
}

/// What the joints do.
#[derive(Clone, Debug)]
pub struct ArmMotion {
    /// The arm, in the posture that it keeps.
    pub model: ArmModel,
    /// Joints at each tick, radians.
    pub joints: Vec<Joints>,
    /// Their speeds, rad/s.
    pub speeds: Vec<Joints>,
    /// What the checks found.
    pub figures: Figures,
}

/// How near the motion comes to what the arm can do.
#[derive(Clone, Debug)]
pub struct Figures {
    /// Joint that comes nearest to its speed, from 1.
    pub fastest_joint: usize,
    /// Its largest speed, rad/s.
    pub speed_rad_s: f64,
    /// Joint that comes nearest to a singularity, from 1.
    pub singular_joint: u8,
    /// Least margin from a singularity, 0 to 1.
    pub margin: f64,
    /// Largest use of the plan's limits, looked at from cycle to cycle.
    pub limit_use: PeakUse,
    /// How far a joint stays from the ends of its range, radians.
    pub range_left_rad: f64,
    /// How near each link comes to its surroundings, in the order of [`Link::ALL`].
    pub clearances: [Clearance; 5],
}

/// Why an arm cannot make a motion.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Refusal {
    /// In no posture, or not in the one that was asked for.
    #[error(
        "at {time_s:.3} s {error}{}; {}",
        if *all_postures { ", and no other posture gets further" } else { "" },
        remedy(error)
    )]
    Arm {
        /// When, seconds.
        time_s: f64,
        /// Joint, value and limit.
        error: ArmError,
        /// All that were allowed were tried; this is the one that gets furthest.
        all_postures: bool,
    },
    /// A link would come too near to its surroundings.
    #[error(
        "at {:.3} s its {} would {}, and {:.1} mm is the least that is kept{}; another place for the base, or the tool turned \
         otherwise in the flange, would be right",
        clearance.time_s, clearance.link.name(), clearance.words_beside(*least_m), 1e3 * least_m,
        if *all_postures { ", and no other posture gets further" } else { "" }
    )]
    TooNear {
        /// Which link, what it comes near to, when, and how near.
        clearance: Clearance,
        /// What is to be kept, metres.
        least_m: f64,
        /// All that were allowed were tried; this is the one that gets furthest.
        all_postures: bool,
    },
    /// A link would pass through another one or the base, or the tool through the arm.
    #[error(
        "at {time_s:.3} s {} would {contact}{}; {} would be right",
        contact.part,
        if *all_postures { ", and no other posture gets further" } else { "" },
        remedy_of_contact(contact, *all_postures)
    )]
    SelfCollision {
        /// When, seconds.
        time_s: f64,
        /// What, and how deep.
        contact: Contact,
        /// All that were allowed were tried; this is the one that gets furthest.
        all_postures: bool,
    },
    /// Between ticks the tool would break a limit that it keeps from tick to tick.
    #[error(
        "at {time_s:.3} s, from cycle to cycle, the {} is {:.4} {unit}, but the plan's limit is {} {unit}; a lower rate looks at \
         it as the plan does, or make the skill slower",
        violation.limit, violation.value, violation.bound, unit = violation.limit.unit()
    )]
    Between {
        /// When, seconds.
        time_s: f64,
        /// What.
        violation: Violation,
    },
}

/// The part of the upper arm that is looked at begins beyond this share of its length: its shoulder is as near to the table as the
/// base is high, in every posture.
const SHOULDER: f64 = 0.25;

/// A posture that is as good as this share of the best one may be taken for being usual.
const NEARLY: f64 = 0.8;

/// What could help.
fn remedy(error: &ArmError) -> String {
    match *error {
        ArmError::Unreachable { distance_m, bound_m, .. } if distance_m > bound_m => {
            format!("put the base at least {:.0} mm nearer", 1e3 * (distance_m - bound_m) + 1.0)
        }
        ArmError::Unreachable { distance_m, bound_m, .. } => {
            format!("put the base at least {:.0} mm farther away", 1e3 * (bound_m - distance_m) + 1.0)
        }
        ArmError::JointLimit { .. } => "turn the base, or begin with that joint farther from its end".into(),
        ArmError::JointSpeed { .. } => {
            "another place for the base or the tool may ask less of it, or a slower skill".into()
        }
        ArmError::Singular { joint: 1, .. } => "put the base farther away from the tool's way".into(),
        ArmError::Singular { joint: 3, .. } => {
            "put the base nearer, so that the arm is not stretched out".into()
        }
        ArmError::Singular { .. } => "turn the tool in the flange, or put the base elsewhere".into(),
    }
}

fn remedy_of_contact(contact: &Contact, all_postures: bool) -> &'static str {
    match (contact.part, all_postures) {
        (Part::Tool(_), _) => "the tool held farther away from the flange, or turned otherwise in it,",
        (_, true) => "another place for the base, or the tool turned otherwise in the flange,",
        (_, false) => {
            "another posture, another place for the base, or the tool turned otherwise in the flange,"
        }
    }
}

impl Clearance {
    /// The same beside what it falls short of, so that a hair less does not read as just enough.
    fn words_beside(&self, least_m: f64) -> String {
        let short_m = least_m - self.distance_m;
        if self.distance_m >= 0.0 && short_m < 1e-4 {
            return format!("be a hair less than {:.1} mm from {}", 1e3 * least_m, self.obstacle);
        }
        self.to_string()
    }
}

impl fmt::Display for Clearance {
    /// Such as "be 12.0 mm from the table".
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.distance_m < 0.0 {
            write!(f, "be {:.1} mm deep in {}", -1e3 * self.distance_m, self.obstacle)
        } else {
            write!(f, "be {:.1} mm from {}", 1e3 * self.distance_m, self.obstacle)
        }
    }
}

impl Mount {
    /// Postures that may be tried, the usual ones first.
    fn postures(&self, path: &ToolPath) -> Vec<Posture> {
        match (&self.near, self.posture) {
            (_, Some(posture)) => vec![posture],
            (Some(near), None) => vec![self.nearest(path, near)],
            (None, None) => Posture::PREFERRED.to_vec(),
        }
    }

    /// The posture whose joints at the start are nearest to `near`.
    fn nearest(&self, path: &ToolPath, near: &Joints) -> Posture {
        let away = |posture: &Posture| {
            self.model(*posture).joints_near(near, &path.poses[0]).map_or(f64::INFINITY, |joints| {
                joints.iter().zip(near).map(|(joint, near)| (joint - near).abs()).fold(0.0, f64::max)
            })
        };
        let [first, others @ ..] = Posture::PREFERRED;
        others.into_iter().fold(first, |best, other| if away(&other) < away(&best) { other } else { best })
    }

    /// The arm in one posture.
    #[must_use]
    pub fn model(&self, posture: Posture) -> ArmModel {
        ArmModel::new(self.kind, self.world_from_base, self.flange_from_tool, posture)
    }
}

impl ArmMotion {
    /// Joints for a motion, checked at every tick and every `cycle_us` microseconds between.
    ///
    /// Of the postures that can make it, the first of [`Posture::PREFERRED`] that is nearly as good as the best: how good one is
    /// says the least of its margins over the whole way ([`Figures::score`]).
    ///
    /// # Errors
    /// What the arm cannot do first.
    pub fn new(
        path: &ToolPath,
        mount: &Mount,
        around: &Surroundings,
        cycle_us: u32,
    ) -> Result<Self, Refusal> {
        let kept = Kept { around, least_m: mount.clearance_m, checks_self: true };
        Self::best(path, mount, &kept, cycle_us)
    }

    /// The same, though links pass through what is around, or through each other: to be shown, not to be performed.
    ///
    /// # Errors
    /// What else the arm cannot do first.
    pub fn through_anything(
        path: &ToolPath,
        mount: &Mount,
        around: &Surroundings,
        cycle_us: u32,
    ) -> Result<Self, Refusal> {
        Self::best(path, mount, &Kept { around, least_m: None, checks_self: false }, cycle_us)
    }

    fn best(path: &ToolPath, mount: &Mount, kept: &Kept<'_>, cycle_us: u32) -> Result<Self, Refusal> {
        let made = Self::all(path, mount, kept, cycle_us)?;
        let score = |arm: &Self| arm.figures.score(&arm.model);
        let best = made.iter().map(score).fold(f64::NEG_INFINITY, f64::max);
        // Where the best passes through something, a share of it would be above it, and nothing be chosen.
        let enough = if best > 0.0 { NEARLY * best } else { best };
        let chosen = made.into_iter().find(|arm| score(arm) >= enough);
        Ok(chosen.expect("one of them is the best"))
    }

    /// What every posture does that can make it; at least one.
    fn all(path: &ToolPath, mount: &Mount, kept: &Kept<'_>, cycle_us: u32) -> Result<Vec<Self>, Refusal> {
        let postures = mount.postures(path);
        let (mut made, mut furthest) = (Vec::new(), None::<Stuck>);
        for posture in &postures {
            match attempt(path, mount, *posture, kept, cycle_us) {
                Ok(arm) => made.push(arm),
                Err(stuck) if furthest.as_ref().is_none_or(|other| stuck.time_us > other.time_us) => {
                    furthest = Some(stuck);
                }
                Err(_) => {}
            }
        }
        match furthest {
            Some(stuck) if made.is_empty() => Err(stuck.refusal(postures.len() > 1)),
            _ => Ok(made),
        }
    }

    /// The same way back.
    pub(super) fn reversed(mut self) -> Self {
        self.joints.reverse();
        self.speeds.reverse();
        // Taking it from zero takes the sign from a zero that has one.
        self.speeds.iter_mut().for_each(|speeds| *speeds = speeds.map(|speed| 0.0 - speed));
        self
    }

    /// Joints so many microseconds after the beginning, radians.
    #[must_use]
    pub fn joints_at(&self, path: &ToolPath, time_us: u64) -> Joints {
        let slopes = |k: usize| self.speeds[k].map(|speed| speed * path.period_s());
        let period_us = u64::from(path.period_us);
        let (k, share) = ((time_us / period_us) as usize, (time_us % period_us) as f64 / period_us as f64);
        if k >= path.last_tick() {
            return self.joints[path.last_tick()];
        }
        spline::between(&self.joints[k..k + 2], &[slopes(k), slopes(k + 1)], 0, share)
    }
}

/// Where an attempt ends.
struct Stuck {
    time_us: u64,
    cause: Cause,
}

enum Cause {
    Arm(ArmError),
    Limit(Violation),
    TooNear { clearance: Clearance, least_m: f64 },
    SelfCollision(Contact),
}

impl Stuck {
    fn arm(time_us: u64) -> impl Fn(ArmError) -> Self {
        move |error| Self { time_us, cause: Cause::Arm(error) }
    }

    fn refusal(self, all_postures: bool) -> Refusal {
        let time_s = self.time_us as f64 / 1e6;
        match self.cause {
            Cause::Arm(error) => Refusal::Arm { time_s, error, all_postures },
            Cause::Limit(violation) => Refusal::Between { time_s, violation },
            Cause::TooNear { clearance, least_m } => Refusal::TooNear { clearance, least_m, all_postures },
            Cause::SelfCollision(contact) => Refusal::SelfCollision { time_s, contact, all_postures },
        }
    }
}

fn attempt(
    path: &ToolPath,
    mount: &Mount,
    posture: Posture,
    kept: &Kept<'_>,
    cycle_us: u32,
) -> Result<ArmMotion, Stuck> {
    let model = mount.model(posture);
    let near = mount.near.unwrap_or_default();
    let start = model.joints_near(&near, &path.poses[0]).map_err(Stuck::arm(0))?;
    let mut joints = vec![start];
    for (tick, pose) in path.poses.iter().enumerate().skip(1) {
        let next = model.joints_after(&joints[tick - 1], pose, path.period_s());
        joints.push(next.map_err(Stuck::arm(path.time_us(tick)))?);
    }
    let speeds = spline::per_second(spline::slopes(&joints), path.period_us);
    let mut made = ArmMotion { model, joints, speeds, figures: Figures::new() };
    made.figures = made.checked(path, cycle_us, kept)?;
    Ok(made)
}

/// What is around, and what is to be kept from it.
struct Kept<'a> {
    around: &'a Surroundings,
    least_m: Option<f64>,
    /// Whether arm and tool are kept from passing through each other and themselves.
    checks_self: bool,
}

impl ArmMotion {
    /// Goes the whole way from cycle to cycle, as a controller does.
    fn checked(&self, path: &ToolPath, cycle_us: u32, kept: &Kept<'_>) -> Result<Figures, Stuck> {
        let (model, mut figures) = (&self.model, Figures::new());
        let near = |time_us| move |cause| Stuck { time_us, cause };
        // While the powder settled it stood there, before gates that are gone at once.
        let around = &kept.around.standing(BEFORE_S);
        figures.keep_clear(model, &self.joints[0], 0, &Kept { around, ..*kept }).map_err(near(0))?;
        figures.keep_clear(model, &self.joints[0], 0, kept).map_err(near(0))?;
        let mut checker = LimitChecker::new(widened(&path.limits, path.lsb), EXACT, cycle_us, path.poses[0]);
        let mut before = self.joints[0];
        for time_us in cycles_us(path, cycle_us) {
            let limit = |violation| Stuck { time_us, cause: Cause::Limit(violation) };
            let joints = self.joints_at(path, time_us);
            model.check_joints(&joints).map_err(Stuck::arm(time_us))?;
            let cycle_s = f64::from(cycle_us) / 1e6;
            model.check_speed(&before, &joints, cycle_s).map_err(Stuck::arm(time_us))?;
            checker.check(model.world_from_tool(&joints)).map_err(limit)?;
            figures.look(model, &before, &joints, cycle_s);
            figures.keep_clear(model, &joints, time_us, kept).map_err(near(time_us))?;
            before = joints;
        }
        let end_us = path.time_us(path.last_tick());
        checker.finish().map_err(|violation| Stuck { time_us: end_us, cause: Cause::Limit(violation) })?;
        figures.limit_use = checker.peak_use();
        Ok(figures)
    }
}

/// Poses between ticks are exact but for the rounding of floating-point numbers.
const EXACT: Lsb = Lsb { translation_nm: 1, rotation_nrad: 1 };

/// The limits with the workspace as wide as the plan's own poses may be off.
fn widened(limits: &Limits, lsb: Lsb) -> Limits {
    let off_m = lsb.translation_m();
    Limits {
        workspace_min_m: limits.workspace_min_m.map(|side| side - off_m),
        workspace_max_m: limits.workspace_max_m.map(|side| side + off_m),
        ..*limits
    }
}

/// What a link comes nearest to where the joints are so, at a time that is given to it.
pub(super) fn line_clearance(
    model: &ArmModel,
    joints: &Joints,
    around: &Surroundings,
    time_s: f64,
) -> Clearance {
    let mut figures = Figures::new();
    let time_us = (1e6 * time_s) as u64;
    // Nothing is refused where nothing is kept.
    let _ = figures.keep_clear(model, joints, time_us, &Kept { around, least_m: None, checks_self: false });
    figures.nearest().clone()
}

/// Moments at which a controller is given joints, microseconds: each cycle, up to the first at which the motion is over.
pub fn cycles_us(path: &ToolPath, cycle_us: u32) -> impl Iterator<Item = u64> {
    let cycle_us = u64::from(cycle_us);
    (1..=path.time_us(path.last_tick()).div_ceil(cycle_us)).map(move |cycle| cycle * cycle_us)
}

impl Figures {
    fn new() -> Self {
        Self {
            fastest_joint: 1,
            speed_rad_s: 0.0,
            singular_joint: 1,
            margin: f64::INFINITY,
            limit_use: PeakUse::default(),
            range_left_rad: f64::INFINITY,
            clearances: Link::ALL.map(|link| Clearance {
                link,
                obstacle: Obstacle::Table,
                distance_m: f64::INFINITY,
                time_s: 0.0,
            }),
        }
    }

    /// How good a posture is for a motion, 0 to 1: the least of its margins, each as a share of what is ample. A quarter of the
    /// way from a singularity's worst to its best, half of a joint's speed, an eighth of a turn of a joint's range and 150 mm
    /// from everything around are ample.
    #[must_use]
    pub fn score(&self, model: &ArmModel) -> f64 {
        let speed_left = 1.0 - self.speed_rad_s / model.joint_speed_rad_s[self.fastest_joint - 1];
        let clear_m = self.nearest().distance_m;
        let shares = [self.margin / 0.25, speed_left / 0.5, self.range_left_rad / FRAC_PI_4, clear_m / 0.15];
        shares.into_iter().fold(1.0, f64::min)
    }

    /// The link that comes nearest to its surroundings.
    #[must_use]
    pub fn nearest(&self) -> &Clearance {
        let [first, others @ ..] = &self.clearances;
        others
            .iter()
            .fold(first, |least, other| if other.distance_m < least.distance_m { other } else { least })
    }

    fn keep_clear(
        &mut self,
        model: &ArmModel,
        joints: &Joints,
        time_us: u64,
        kept: &Kept<'_>,
    ) -> Result<(), Cause> {
        let met = kept.checks_self.then(|| contact(model, joints, kept.around.tool())).flatten();
        if let Some(met) = met {
            return Err(Cause::SelfCollision(met));
        }
        let in_world = |point: &Vector3<f64>| {
            model.world_from_base.position_m + model.world_from_base.orientation * point
        };
        let time_s = time_us as f64 / 1e6;
        for (least, axis) in self.clearances.iter_mut().zip(axes(model.kind, joints)) {
            let link = least.link;
            let [mut from, to] = [in_world(&axis[0]), in_world(&axis[1])];
            // The upper arm hangs at the shoulder, which stands where the base does.
            if link == Link::UpperArm {
                from = from + (to - from) * SHOULDER;
            }
            let near = kept.around.nearest([from, to], link.radius_m(model.kind), time_s, least.distance_m);
            let Some(near) = near else { continue };
            *least = Clearance { link, obstacle: near.obstacle.clone(), distance_m: near.distance_m, time_s };
            if let Some(least_m) = kept.least_m.filter(|least_m| near.distance_m < *least_m) {
                return Err(Cause::TooNear { clearance: least.clone(), least_m });
            }
        }
        Ok(())
    }

    fn look(&mut self, model: &ArmModel, before: &Joints, joints: &Joints, cycle_s: f64) {
        let left = joints.iter().zip(model.joint_range_rad).map(|(joint, range)| range - joint.abs());
        self.range_left_rad = left.fold(self.range_left_rad, f64::min);
        let share = |joint: usize, speed: f64| speed / model.joint_speed_rad_s[joint - 1];
        for (joint, (from, to)) in (1..).zip(before.iter().zip(joints)) {
            let speed = (to - from).abs() / cycle_s;
            if share(joint, speed) > share(self.fastest_joint, self.speed_rad_s) {
                (self.fastest_joint, self.speed_rad_s) = (joint, speed);
            }
        }
        let (joint, margin) = SingularityMargins::of(model.kind, joints).least();
        if margin < self.margin {
            (self.singular_joint, self.margin) = (joint, margin);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::arm::CYCLE_US;
    use crate::scene::{Arm, Scene};
    use crate::skill::{SkillMap, Theta};

    /// What `bench` brings its arm to, once that is changed; by itself, and where it may pass through anything.
    fn made(change: impl Fn(&mut Arm)) -> [Result<ArmMotion, Refusal>; 2] {
        let mut scene = Scene::load("bench").unwrap();
        scene.arm.as_mut().into_iter().for_each(change);
        let (map, arm) = (SkillMap::new(&scene), scene.arm.clone().unwrap());
        let path = ToolPath::of_skill(&map, &map.quantise(&Theta::MIDDLE).unwrap());
        let around = Surroundings::of_scene(&scene, arm.table_height_m);
        // Nothing is kept from anything, but arm and tool from themselves.
        let mount = Mount { clearance_m: None, ..Mount::of(&arm) };
        [ArmMotion::new, ArmMotion::through_anything].map(|make| make(&path, &mount, &around, CYCLE_US))
    }

    /// Refused at once in all postures, with this sentence, and shown all the same.
    fn assert_refused(change: impl Fn(&mut Arm), words: &str) {
        let [kept, shown] = made(change);
        let refusal = kept.map(drop).unwrap_err();
        assert!(matches!(refusal, Refusal::SelfCollision { all_postures: true, .. }), "{refusal}");
        assert!(refusal.to_string().starts_with(&format!("at 0.000 s {words}, ")), "{refusal}");
        assert!(shown.is_ok());
    }

    #[test]
    fn an_arm_does_not_pass_through_itself() {
        let near = |arm: &mut Arm| arm.base_position_m = [0.13, -0.4, -0.1];
        assert_refused(near, "its forearm would pass through its base or shoulder");
    }

    #[test]
    fn a_tool_is_not_held_within_the_arm() {
        // Behind the flange, where the wrist is.
        let within = |arm: &mut Arm| {
            (arm.tool_position_m, arm.base_position_m) = ([0.0, 0.0, -0.12], [0.26, -0.48, -0.1]);
        };
        assert_refused(within, "the tool's handle would pass through the arm's wrist 1");
    }

    /// It is gone when the motion begins, but stood there while the powder settled, and so did the wrist.
    #[test]
    fn a_gate_that_is_gone_at_once_is_in_the_way_before() {
        use crate::scene::{Gate, GateOpening, GateShape};
        let mut scene = Scene::load("bench").unwrap();
        let arm = scene.arm.clone().unwrap();
        let map = SkillMap::new(&scene);
        let path = ToolPath::of_skill(&map, &map.quantise(&Theta::MIDDLE).unwrap());
        let made = |scene: &Scene| {
            let around = Surroundings::of_scene(scene, arm.table_height_m);
            ArmMotion::new(&path, &Mount::of(&arm), &around, CYCLE_US)
        };
        let free = made(&scene).unwrap();
        // Wherever the other links are, the last one is there.
        let [from, to] = axes(free.model.kind, &free.joints[0])[4];
        let base = free.model.world_from_base;
        let middle = base.position_m + base.orientation * ((from + to) * 0.5);
        scene.gates = vec![Gate {
            name: "lid".into(),
            position_m: middle.into(),
            yaw_deg: 0.0,
            friction: 0.4,
            opens_at_s: 0.0,
            shape: GateShape::Box { size_m: [0.02, 0.02, 0.02] },
            opening: GateOpening::Vanish {},
        }];
        let refusal = made(&scene).map(drop).unwrap_err();
        assert!(refusal.to_string().contains("gate \"lid\""), "{refusal}");
    }

    /// Some base stands so that the arm is free at both ends of the motion, and passes through itself between.
    #[test]
    fn all_of_the_way_is_looked_at() {
        let is_between = |near_mm: i32| {
            let [kept, shown] = made(|arm| arm.base_position_m = [0.13, -1e-3 * f64::from(near_mm), -0.1]);
            let (Err(Refusal::SelfCollision { time_s, .. }), Ok(shown)) = (kept.map(drop), shown) else {
                return false;
            };
            let is_free = |joints: &Joints| contact(&shown.model, joints, &[]).is_none();
            time_s > 0.0 && is_free(&shown.joints[0]) && shown.joints.last().is_some_and(is_free)
        };
        assert!((400..450).step_by(5).any(is_between));
    }

    #[test]
    fn a_distance_that_falls_short_does_not_read_as_enough() {
        let refusal = |distance_m| {
            let clearance =
                Clearance { link: Link::Wrist3, obstacle: Obstacle::Table, distance_m, time_s: 0.028 };
            Refusal::TooNear { clearance, least_m: 0.02, all_postures: false }.to_string()
        };
        assert!(
            refusal(0.01999)
                .starts_with("at 0.028 s its wrist 3 would be a hair less than 20.0 mm from the table, and")
        );
        assert!(refusal(0.0189).contains("would be 18.9 mm from the table, and 20.0 mm is the least"));
        assert!(refusal(-0.0001).contains("would be 0.1 mm deep in the table"));
    }
}
