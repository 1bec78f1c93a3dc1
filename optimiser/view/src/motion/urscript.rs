//! A program for the controller of a UR e-Series arm, PolyScope 5.9 or later.
//!
//! It holds the joints and their speeds at each tick, and what they mean: the cubic of [`super::spline`], streamed by `servoj`
//! at the controller's rate. So a program is as long as the plan, not as the stream. Around the motion it makes the ways of
//! [`Transit`], and is where it began when it ends: it can be run again.

use std::io::{self, Write};

use powderline_shared::arm::links::base_from_flange;
use powderline_shared::arm::{ArmModel, Joints};
use powderline_shared::pose::{Pose, log_so3};

use super::Motion;
use powderline_simulator::arm::{ArmMotion, Transit};
use powderline_simulator::scene::TurnBack;

/// Cycles a second of an e-Series controller.
pub const CONTROLLER_HZ: u32 = 500;

/// The first PolyScope that has all that a program uses; arithmetic of lists came last.
pub const LEAST_POLYSCOPE: &str = "5.9";

/// More ticks make a program that is not written: controllers load a program whole, and give up or take minutes over those of
/// some ten thousand lines. There is no published limit.
pub const MAX_TICKS: usize = 10_000;

/// Least share of full speed that a program is written for.
pub const LEAST_SPEED: f64 = 0.01;

/// Of joints that move in a straight line of them, rad/s and rad/s^2.
const APPROACH: [f64; 2] = [0.2, 0.3];

/// How far an arm may be from where the program begins, radians, the root of the sum of squares over all joints: what is in
/// between nobody knows.
const NEAR_RAD: f64 = 0.1;

/// How far the flange of a calibrated arm may be from where a nominal one has it, metres.
const CALIBRATION_TOLERANCE_M: f64 = 0.02;

/// How far the joints may be off their start after the way there, radians, likewise.
const START_TOLERANCE_RAD: f64 = 0.002;

/// How the controller follows, as UR's own ROS driver asks it to: looking so many seconds ahead, with this gain.
const FOLLOWING: [f64; 2] = [0.03, 2000.0];

/// For how long the end of each part is held, seconds: ten times what the controller looks ahead.
const HOLD_S: f64 = 0.3;

/// Deceleration at the end, rad/s^2.
const STOP_RAD_S2: f64 = 2.0;

/// What a program is made of.
#[derive(Clone, Copy, Debug)]
pub struct Program<'a> {
    /// The plan's motion.
    pub motion: &'a Motion,
    /// The arm that makes it.
    pub arm: &'a ArmMotion,
    /// The ways before and after.
    pub transit: &'a Transit,
    /// From setpoint to setpoint, microseconds.
    pub cycle_us: u32,
    /// Share of full speed, [`LEAST_SPEED`] to 1, at which everything goes.
    pub speed: f64,
    /// Mass at the flange, kilograms; the controller keeps what it has been told if it is not known.
    pub payload_kg: Option<f64>,
    /// Whether containers and gates were known, to stay clear of; otherwise the program says that they were not.
    pub knows_scene: bool,
}

impl Program<'_> {
    /// Writes it.
    ///
    /// # Errors
    /// What the system says.
    pub fn write(&self, out: &mut dyn Write) -> io::Result<()> {
        self.write_header(out)?;
        self.write_functions(out)?;
        self.write_checks(out)?;
        self.write_approach(out)?;
        writeln!(out, "  textmsg(\"Powderline: plays the motion\")")?;
        write_ticks(out, self.arm)?;
        writeln!(out, "  powderline_hold()")?;
        self.write_retreat(out)
    }

    fn label(&self) -> &'static str {
        self.arm.model.kind.label()
    }

    fn write_header(&self, out: &mut dyn Write) -> io::Result<()> {
        let Self { motion, arm, transit, cycle_us, speed, payload_kg, knows_scene } = self;
        let ArmModel { world_from_base, flange_from_tool, .. } = &arm.model;
        let rate_hz = 1e6 / f64::from(*cycle_us);
        let above = 1e3 * (transit.height_m - motion.path.poses[0].position_m.z);
        let (to_above, back, begin) = match transit.home {
            Some(_) => (
                format!("all joints at once to {above:.0} mm above the start, then "),
                "all joints at once to its home",
                "its home",
            ),
            None => (String::new(), "stops there", "its place above the start"),
        };
        let turn = match transit.turn_back {
            TurnBack::Target => "turns the tool back, goes level to above the start",
            TurnBack::Source => "goes level to above the start, turns the tool back",
        };
        let payload = payload_kg
            .map_or("the payload stays what the installation says, set it".into(), |mass_kg| {
                format!("payload {mass_kg} kg with its centre there")
            });
        write!(
            out,
            "\
# Motion of Powderline's plan {hash:016x}, written by optimise {version}, for a {label}; PolyScope {LEAST_POLYSCOPE} or later.
# Base in the world: {base}
# Tool in the flange: {tool}
# (position in m, rotation vector in rad)
#
# What it does, when it is run:
#   1. It stops at once if the arm is not like a {label} (its flange is 20 mm or more from where it should be), or farther than {NEAR_RAD} rad from {begin}:
#      {begin_deg} degrees. Bring it there first; nobody looks what is in the way.
#   2. It goes there slowly, {to_above}straight down {above:.0} mm to the start.
#   3. It plays the motion: {duration} s, new joints for servoj {rate_hz} times a second.
#   4. It holds the end for {HOLD_S} s, goes up to {height:.0} mm, {turn}, and {back}.
#      What falls off the tool on that way is in no amount of the plan's.
",
            hash = motion.plan_hash,
            version = motion.version_text(),
            label = self.label(),
            base = pose(world_from_base),
            tool = pose(flange_from_tool),
            begin_deg = degrees(self.transit.begin()),
            duration = decimals(motion.path.duration_s() / speed),
            height = 1e3 * transit.height_m,
        )?;
        if !knows_scene {
            let not_known = "# NOT LOOKED AT: what tool and arm may run into, for the plan's scene was not known. Free the whole way first.";
            writeln!(out, "{not_known}")?;
        }
        if *speed < 1.0 {
            let percent = percent(*speed);
            writeln!(
                out,
                "# At {percent} % of full speed, on the same path, to see whether it is free. Powder behaves as planned at full speed only."
            )?;
        }
        write!(
            out,
            "\
#
# The joints are those of UR's nominal kinematics; a real arm differs from it by its calibration. The tool centre point is set to
# the tool's frame; {payload}. Neither changes the joints. This is no safety function.
#
# Sent to port 30002 of the controller it runs at once. In a program of PolyScope: include it as a script file, and call
# powderline() in a script line behind it; it may be called again and again.
"
        )
    }

    fn write_functions(&self, out: &mut dyn Write) -> io::Result<()> {
        let Self { motion, arm, transit, cycle_us, speed, payload_kg, .. } = self;
        let [lookahead_s, gain] = FOLLOWING;
        let cycle_s = f64::from(*cycle_us) / 1e6;
        let advance_us = decimals(f64::from(*cycle_us) * speed);
        let set_payload = payload_kg.map_or(String::new(), |mass_kg| {
            let [x, y, z]: [f64; 3] = arm.model.flange_from_tool.position_m.into();
            format!(
                "  set_payload({}, [{}, {}, {}])\n",
                decimals(mass_kg),
                decimals(x),
                decimals(y),
                decimals(z)
            )
        });
        write!(
            out,
            "\
def powderline():
  set_tcp({tcp})
{set_payload}  # Joints in rad where the last tick was, their change per tick there, and microseconds from it to the next setpoint.
  global powderline_q = {above}
  global powderline_m = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
  global powderline_us = {advance_us}

  # From the last tick to the joints q (rad) with speeds qd (rad/s), on the cubic with these ends.
  def powderline_tick(q, qd):
    local m = qd * {period_s}
    local d = q - powderline_q
    local b = 3.0 * d - 2.0 * powderline_m - m
    local c = powderline_m + m - 2.0 * d
    while powderline_us <= {period_us}.0:
      local s = powderline_us / {period_us}.0
      servoj(powderline_q + s * (powderline_m + s * (b + s * c)), t={cycle_s}, lookahead_time={lookahead_s}, gain={gain})
      powderline_us = powderline_us + {advance_us}
    end
    powderline_us = powderline_us - {period_us}.0
    powderline_q = q
    powderline_m = m
  end

  # Until the arm is at the last tick, where it rests.
  def powderline_hold():
    local held = 0
    while held < {cycles}:
      servoj(powderline_q, t={cycle_s}, lookahead_time={lookahead_s}, gain={gain})
      held = held + 1
    end
    stopj({STOP_RAD_S2:?})
    powderline_m = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
    powderline_us = {advance_us}
  end

",
            tcp = pose(&arm.model.flange_from_tool),
            above = list(&transit.approach.joints[0]),
            period_s = motion.path.period_s(),
            period_us = motion.path.period_us,
            cycles = (HOLD_S / cycle_s).ceil(),
        )
    }

    /// That it is such an arm, and near enough.
    fn write_checks(&self, out: &mut dyn Write) -> io::Result<()> {
        let label = self.label();
        let start = &self.arm.joints[0];
        let [x, y, z]: [f64; 3] = base_from_flange(self.arm.model.kind, start).position_m.into();
        let place = if self.transit.home.is_some() { "its home" } else { "its place above the start" };
        write!(
            out,
            "  # Where this arm would have its flange at the start. What it is off is its calibration, unless it is another arm.
  local flange = get_forward_kin({start}, p[0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
  local off = norm([flange[0] - {x:.6}, flange[1] - {y:.6}, flange[2] - {z:.6}])
  textmsg(\"Powderline: metres that this arm is off a nominal {label} at the start: \", off)
  if off > {CALIBRATION_TOLERANCE_M}:
    textmsg(\"Powderline: this is no {label}; the motion is not played\")
    halt
  end
  local begin = {begin}
  if norm(get_actual_joint_positions() - begin) > {NEAR_RAD}:
    textmsg(\"Powderline: the arm is too far from {place}; bring it there, in degrees: {begin_deg}\")
    halt
  end
",
            start = list(start),
            begin = list(self.transit.begin()),
            begin_deg = degrees(self.transit.begin()),
        )
    }

    fn write_approach(&self, out: &mut dyn Write) -> io::Result<()> {
        writeln!(
            out,
            "  textmsg(\"Powderline: slowly to the start of plan {:016x}\")",
            self.motion.plan_hash
        )?;
        let above = &self.transit.approach.joints[0];
        self.write_move(out, "begin")?;
        if self.transit.home.is_some() {
            self.write_move(out, &list(above))?;
        }
        write_ticks(out, &self.transit.approach)?;
        write!(
            out,
            "  powderline_hold()
  if norm(get_actual_joint_positions() - powderline_q) > {START_TOLERANCE_RAD}:
    textmsg(\"Powderline: the arm is not at the start; the motion is not played\")
    halt
  end
"
        )
    }

    fn write_retreat(&self, out: &mut dyn Write) -> io::Result<()> {
        writeln!(out, "  textmsg(\"Powderline: back to where it began\")")?;
        write_ticks(out, &self.transit.retreat)?;
        writeln!(out, "  powderline_hold()")?;
        if self.transit.home.is_some() {
            self.write_move(out, "begin")?;
        }
        write!(out, "  textmsg(\"Powderline: done\")\nend\n")
    }

    /// All joints in a straight line to others.
    fn write_move(&self, out: &mut dyn Write, to: &str) -> io::Result<()> {
        let [speed, acceleration] = APPROACH.map(|full| decimals(full * self.speed));
        writeln!(out, "  movej({to}, a={acceleration}, v={speed})")
    }
}

fn write_ticks(out: &mut dyn Write, way: &ArmMotion) -> io::Result<()> {
    way.joints.iter().zip(&way.speeds).skip(1).try_for_each(|(joints, speeds)| {
        writeln!(out, "  powderline_tick({}, {})", list(joints), list(speeds))
    })
}

fn degrees(joints: &Joints) -> String {
    joints.map(|angle| format!("{:.1}", angle.to_degrees())).join(", ")
}

/// A share of full speed in percent, to the digits that were given.
#[must_use]
pub fn percent(share: f64) -> f64 {
    (1e8 * share).round() / 1e6
}

/// To nine decimals, with a point, without zeros behind or exponent.
fn decimals(value: f64) -> String {
    // Adding zero takes the sign from a zero that has one.
    let text = ((value * 1e9).round() / 1e9 + 0.0).to_string();
    if text.contains('.') { text } else { text + ".0" }
}

/// A list of numbers to 10^-12, without exponents.
fn list(values: &Joints) -> String {
    let number = |value: f64| if value.abs() < 1e-12 { "0.0".into() } else { format!("{value:.12}") };
    format!("[{}]", values.map(number).join(", "))
}

fn pose(pose: &Pose) -> String {
    let ([x, y, z], [rx, ry, rz]): ([f64; 3], [f64; 3]) =
        (pose.position_m.into(), log_so3(&pose.orientation).into());
    format!("p[{}]", [x, y, z, rx, ry, rz].map(decimals).join(", "))
}
