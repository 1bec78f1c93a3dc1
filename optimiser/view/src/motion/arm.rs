//! The joints of an arm that makes the motion, and whether it can: the whole way, also between ticks.

use powderline_shared::arm::inverse::Posture;
use powderline_shared::arm::ur5e::{Link, SingularityMargins, axes};
use powderline_shared::arm::{ArmError, ArmModel, Joints};
use powderline_shared::displacement::Lsb;
use powderline_shared::limits::{LimitChecker, Limits, PeakUse, Violation};
use powderline_shared::pose::Pose;

use super::{Motion, per_second, spline};
use nalgebra::Vector3;
use std::f64::consts::FRAC_PI_4;

/// How an arm stands and holds the tool.
#[derive(Clone, Copy, Debug)]
pub struct Mount {
    /// The arm's base in the world.
    pub world_from_base: Pose,
    /// The plan's tool frame in the flange.
    pub flange_from_tool: Pose,
    /// Joints near which the motion is to begin, radians. Without, the best posture (see [`ArmMotion::new`]), and each joint
    /// within half a turn of zero.
    pub near: Option<Joints>,
    /// The table that links are to stay above.
    pub table: Table,
}

/// A level table beneath arm and bench.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Table {
    /// Height in the world, metres.
    pub height_m: f64,
    /// Whether links must keep [`CLEARANCE_M`] from it: a motion that does not is refused. Otherwise their clearance is only
    /// measured, and the posture chosen by it.
    pub is_kept: bool,
}

/// What every link keeps from the table, metres.
pub const CLEARANCE_M: f64 = 0.02;

/// How near a link comes to the table.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Clearance {
    /// Which.
    pub link: Link,
    /// From its surface down to the table, metres; negative where it would be in it.
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
#[derive(Clone, Copy, Debug)]
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
    /// How near each link comes to the table, in the order of [`Link::ALL`].
    pub clearances: [Clearance; 5],
}

/// Why an arm cannot make a motion.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
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
        /// All eight were tried; this is the one that gets furthest.
        all_postures: bool,
    },
    /// A link would come too near to the table.
    #[error(
        "at {:.3} s its {} would be {:.0} mm above the table, and {:.0} mm is the least{}; another --base, or the tool turned \
         otherwise in the flange by --tool, would be right, or --table where the table is lower",
        clearance.time_s, clearance.link.name(), 1e3 * clearance.distance_m, 1e3 * CLEARANCE_M,
        if *all_postures { ", and no other posture gets further" } else { "" }
    )]
    Table {
        /// Which link, when, and how near.
        clearance: Clearance,
        /// All eight were tried; this is the one that gets furthest.
        all_postures: bool,
    },
    /// Between ticks the tool would break a limit that it keeps from tick to tick.
    #[error(
        "at {time_s:.3} s, from cycle to cycle, the {} is {:.4} {unit}, but the plan's limit is {} {unit}; a lower --rate looks \
         at it as the plan does, or make the skill slower",
        violation.limit, violation.value, violation.bound, unit = violation.limit.unit()
    )]
    Between {
        /// When, seconds.
        time_s: f64,
        /// What.
        violation: Violation,
    },
}

/// A posture that is as good as this share of the best one may be taken for being usual.
const NEARLY: f64 = 0.8;

/// What could help.
fn remedy(error: &ArmError) -> String {
    match *error {
        ArmError::Unreachable { distance_m, bound_m, .. } if distance_m > bound_m => {
            format!("put --base at least {:.0} mm nearer", 1e3 * (distance_m - bound_m) + 1.0)
        }
        ArmError::Unreachable { distance_m, bound_m, .. } => {
            format!("put --base at least {:.0} mm farther away", 1e3 * (bound_m - distance_m) + 1.0)
        }
        ArmError::JointLimit { .. } => {
            "turn --base, or begin with that joint farther from its end by --near".into()
        }
        ArmError::JointSpeed { .. } => {
            "another --base or --tool may ask less of it, or a slower skill".into()
        }
        ArmError::Singular { joint: 1, .. } => "put --base farther away from the tool's way".into(),
        ArmError::Singular { joint: 3, .. } => {
            "put --base nearer, so that the arm is not stretched out".into()
        }
        ArmError::Singular { .. } => "turn the tool in the flange by --tool, or put --base elsewhere".into(),
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
    pub fn new(motion: &Motion, mount: &Mount, cycle_us: u32) -> Result<Self, Refusal> {
        let attempt = |posture| attempt(motion, mount, posture, cycle_us);
        if let Some(near) = &mount.near {
            return attempt(nearest(motion, mount, near)).map_err(|stuck| stuck.refusal(false));
        }
        let (mut made, mut furthest) = (Vec::new(), None::<Stuck>);
        for posture in Posture::PREFERRED {
            match attempt(posture) {
                Ok(arm) => made.push(arm),
                Err(stuck) if furthest.as_ref().is_none_or(|other| stuck.time_us > other.time_us) => {
                    furthest = Some(stuck);
                }
                Err(_) => {}
            }
        }
        let best = made.iter().map(|arm| arm.figures.score(&arm.model)).fold(f64::NEG_INFINITY, f64::max);
        // Where the best is below the table, a share of it would be above it, and nothing be chosen.
        let enough = if best > 0.0 { NEARLY * best } else { best };
        let chosen = made.into_iter().find(|arm| arm.figures.score(&arm.model) >= enough);
        chosen.ok_or_else(|| furthest.expect("what is not made is stuck").refusal(true))
    }

    /// Joints so many microseconds after the beginning, radians.
    #[must_use]
    pub fn joints_at(&self, motion: &Motion, time_us: u64) -> Joints {
        let slopes = |k: usize| self.speeds[k].map(|speed| speed * motion.period_s());
        let period_us = u64::from(motion.period_us);
        let (k, share) = ((time_us / period_us) as usize, (time_us % period_us) as f64 / period_us as f64);
        if k >= motion.last_tick() {
            return self.joints[motion.last_tick()];
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
    Table(Clearance),
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
            Cause::Table(clearance) => Refusal::Table { clearance, all_postures },
        }
    }
}

/// The posture whose joints at the start are nearest to `near`.
fn nearest(motion: &Motion, mount: &Mount, near: &Joints) -> Posture {
    let away = |posture: &Posture| {
        let model = ArmModel::new(mount.world_from_base, mount.flange_from_tool, *posture);
        model.joints_near(near, &motion.poses[0]).map_or(f64::INFINITY, |joints| {
            joints.iter().zip(near).map(|(joint, near)| (joint - near).abs()).fold(0.0, f64::max)
        })
    };
    let [first, others @ ..] = Posture::PREFERRED;
    others.into_iter().fold(first, |best, other| if away(&other) < away(&best) { other } else { best })
}

fn attempt(motion: &Motion, mount: &Mount, posture: Posture, cycle_us: u32) -> Result<ArmMotion, Stuck> {
    let model = ArmModel::new(mount.world_from_base, mount.flange_from_tool, posture);
    let near = mount.near.unwrap_or_default();
    let start = model.joints_near(&near, &motion.poses[0]).map_err(Stuck::arm(0))?;
    let mut joints = vec![start];
    for (tick, pose) in motion.poses.iter().enumerate().skip(1) {
        let next = model.joints_after(&joints[tick - 1], pose, motion.period_s());
        joints.push(next.map_err(Stuck::arm(motion.time_us(tick)))?);
    }
    let speeds = per_second(spline::slopes(&joints), motion.period_us);
    let mut made = ArmMotion { model, joints, speeds, figures: Figures::new() };
    made.figures = made.checked(motion, cycle_us, mount.table)?;
    Ok(made)
}

impl ArmMotion {
    /// Goes the whole way from cycle to cycle, as a controller does.
    fn checked(&self, motion: &Motion, cycle_us: u32, table: Table) -> Result<Figures, Stuck> {
        let (model, mut figures) = (&self.model, Figures::new());
        let near = |time_us| move |clearance| Stuck { time_us, cause: Cause::Table(clearance) };
        figures.keep_clear(model, &self.joints[0], 0, table).map_err(near(0))?;
        let mut checker =
            LimitChecker::new(widened(&motion.limits, motion.lsb), EXACT, cycle_us, motion.poses[0]);
        let mut before = self.joints[0];
        for time_us in cycles_us(motion, cycle_us) {
            let limit = |violation| Stuck { time_us, cause: Cause::Limit(violation) };
            let joints = self.joints_at(motion, time_us);
            model.check_joints(&joints).map_err(Stuck::arm(time_us))?;
            let cycle_s = f64::from(cycle_us) / 1e6;
            model.check_speed(&before, &joints, cycle_s).map_err(Stuck::arm(time_us))?;
            checker.check(model.world_from_tool(&joints)).map_err(limit)?;
            figures.look(model, &before, &joints, cycle_s);
            figures.keep_clear(model, &joints, time_us, table).map_err(near(time_us))?;
            before = joints;
        }
        let end_us = motion.time_us(motion.last_tick());
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

/// Moments at which a controller is given joints, microseconds: each cycle, up to the first at which the motion is over.
pub fn cycles_us(motion: &Motion, cycle_us: u32) -> impl Iterator<Item = u64> {
    let cycle_us = u64::from(cycle_us);
    (1..=motion.time_us(motion.last_tick()).div_ceil(cycle_us)).map(move |cycle| cycle * cycle_us)
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
            clearances: Link::ALL.map(|link| Clearance { link, distance_m: f64::INFINITY, time_s: 0.0 }),
        }
    }

    /// How good a posture is for a motion, 0 to 1: the least of its margins, each as a share of what is ample. A quarter of the
    /// way from a singularity's worst to its best, half of a joint's speed, an eighth of a turn of a joint's range and 150 mm
    /// above the table are ample.
    #[must_use]
    pub fn score(&self, model: &ArmModel) -> f64 {
        let speed_left = 1.0 - self.speed_rad_s / model.joint_speed_rad_s[self.fastest_joint - 1];
        let clear_m = self.nearest_to_table().distance_m;
        let shares = [self.margin / 0.25, speed_left / 0.5, self.range_left_rad / FRAC_PI_4, clear_m / 0.15];
        shares.into_iter().fold(1.0, f64::min)
    }

    /// The link that comes nearest to the table.
    #[must_use]
    pub fn nearest_to_table(&self) -> Clearance {
        let [first, others @ ..] = self.clearances;
        others
            .into_iter()
            .fold(first, |least, other| if other.distance_m < least.distance_m { other } else { least })
    }

    fn keep_clear(
        &mut self,
        model: &ArmModel,
        joints: &Joints,
        time_us: u64,
        table: Table,
    ) -> Result<(), Clearance> {
        let height_m = |point: &Vector3<f64>| {
            (model.world_from_base.position_m + model.world_from_base.orientation * point).z - table.height_m
        };
        let mut axes = axes(joints).into_iter();
        let now = Link::ALL.map(|link| {
            let ends = axes.next().unwrap_or_default();
            // The upper arm hangs at the shoulder, which stands where the base does.
            let ends = if link == Link::UpperArm { &ends[1..] } else { &ends[..] };
            let lowest_m = ends.iter().map(height_m).fold(f64::INFINITY, f64::min);
            Clearance { link, distance_m: lowest_m - link.radius_m(), time_s: time_us as f64 / 1e6 }
        });
        for (least, now) in self.clearances.iter_mut().zip(now) {
            if now.distance_m < least.distance_m {
                *least = now;
            }
        }
        let too_near = now.into_iter().find(|now| table.is_kept && now.distance_m < CLEARANCE_M);
        too_near.map_or(Ok(()), Err)
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
        let (joint, margin) = SingularityMargins::of(joints).least();
        if margin < self.margin {
            (self.singular_joint, self.margin) = (joint, margin);
        }
    }
}
