//! A program for the controller of a UR e-Series arm, PolyScope 5.9 or later.
//!
//! It holds the joints and their speeds at each tick, and what they mean: the cubic of [`super::spline`], streamed by `servoj`
//! at the controller's rate. So a program is as long as the plan, not as the stream.

use std::io::{self, Write};

use powderline_shared::arm::links::base_from_flange;
use powderline_shared::arm::{ArmModel, Joints};
use powderline_shared::pose::{Pose, log_so3};

use super::Motion;
use powderline_simulator::arm::ArmMotion;

/// Cycles a second of an e-Series controller.
pub const CONTROLLER_HZ: u32 = 500;

/// More ticks make a program that is not written: controllers load a program whole, and give up or take minutes over those of
/// some ten thousand lines. There is no published limit.
pub const MAX_TICKS: usize = 10_000;

/// On the way to the start, rad/s and rad/s^2.
const APPROACH: [f64; 2] = [0.2, 0.3];

/// How far the flange of a calibrated arm may be from where a nominal one has it, metres.
const CALIBRATION_TOLERANCE_M: f64 = 0.02;

/// How far the joints may be off their start after the way there, radians.
const START_TOLERANCE_RAD: f64 = 0.002;

/// How the controller follows, as UR's own ROS driver asks it to: looking so many seconds ahead, with this gain.
const FOLLOWING: [f64; 2] = [0.03, 2000.0];

/// For how long the end is held before the program stops, seconds: ten times what the controller looks ahead.
const HOLD_S: f64 = 0.3;

/// Deceleration at the end, rad/s^2.
const STOP_RAD_S2: f64 = 2.0;

/// Writes the program, which gives the controller new joints every `cycle_us` microseconds.
///
/// # Errors
/// What the system says.
pub fn write(out: &mut dyn Write, motion: &Motion, arm: &ArmMotion, cycle_us: u32) -> io::Result<()> {
    write_header(out, motion, arm, cycle_us)?;
    write_functions(out, motion, arm, cycle_us)?;
    write_approach(out, motion, arm)?;
    for (joints, speeds) in arm.joints.iter().zip(&arm.speeds).skip(1) {
        writeln!(out, "  powderline_tick({}, {})", list(joints), list(speeds))?;
    }
    write_end(out, cycle_us)
}

fn write_header(out: &mut dyn Write, motion: &Motion, arm: &ArmMotion, cycle_us: u32) -> io::Result<()> {
    let ArmModel { world_from_base, flange_from_tool, .. } = &arm.model;
    let start_deg = arm.joints[0].map(|angle| format!("{:.1}", angle.to_degrees())).join(", ");
    let rate_hz = 1e6 / f64::from(cycle_us);
    write!(
        out,
        "\
# Motion of Powderline's plan {hash:016x}, written by optimise {version}, for a UR5e.
# Base in the world: {base}
# Tool in the flange: {tool}
# (position in m, rotation vector in rad)
#
# What it does, when it is run:
#   1. It stops at once if the arm is not like a UR5e, by more than a calibration.
#   2. It moves slowly, joint by joint and at {approach} rad/s at most, from wherever the arm is to the start of the motion:
#      {start_deg} degrees. Nobody looks what is in the way. Bring the arm near to the start first.
#   3. It plays the motion: {duration} s, new joints for servoj {rate_hz} times a second.
#   4. It holds the end for {HOLD_S} s and stops.
#
# The joints are those of UR's nominal kinematics; a real arm differs from it by its calibration. What the installation says
# of tool centre point and payload changes nothing in them, but set the payload. This is no safety function.
#
# Sent to port 30002 of the controller it runs at once. In a program of PolyScope: include it as a script file, and call
# powderline() in a script line behind it.
",
        hash = motion.plan_hash,
        version = motion.version_text(),
        base = pose(world_from_base),
        tool = pose(flange_from_tool),
        approach = APPROACH[0],
        duration = motion.path.duration_s(),
    )
}

fn write_functions(out: &mut dyn Write, motion: &Motion, arm: &ArmMotion, cycle_us: u32) -> io::Result<()> {
    let [lookahead_s, gain] = FOLLOWING;
    write!(
        out,
        "\
def powderline():
  # Joints in rad where the last tick was, their change per tick there, and microseconds from it to the next setpoint.
  global powderline_q = {start}
  global powderline_m = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
  global powderline_us = {cycle_us}.0

  # From the last tick to the joints q (rad) with speeds qd (rad/s), on the cubic with these ends.
  def powderline_tick(q, qd):
    local m = qd * {period_s}
    local d = q - powderline_q
    local b = 3.0 * d - 2.0 * powderline_m - m
    local c = powderline_m + m - 2.0 * d
    while powderline_us <= {period_us}.0:
      local s = powderline_us / {period_us}.0
      servoj(powderline_q + s * (powderline_m + s * (b + s * c)), t={cycle_s}, lookahead_time={lookahead_s}, gain={gain})
      powderline_us = powderline_us + {cycle_us}.0
    end
    powderline_us = powderline_us - {period_us}.0
    powderline_q = q
    powderline_m = m
  end

",
        start = list(&arm.joints[0]),
        period_s = motion.path.period_s(),
        period_us = motion.path.period_us,
        cycle_s = f64::from(cycle_us) / 1e6,
    )
}

fn write_approach(out: &mut dyn Write, motion: &Motion, arm: &ArmMotion) -> io::Result<()> {
    let [speed, acceleration] = APPROACH;
    let [x, y, z]: [f64; 3] = base_from_flange(arm.model.kind, &arm.joints[0]).position_m.into();
    write!(
        out,
        "  # Where this arm would have its flange at the start. What it is off is its calibration, unless it is another arm.
  local flange = get_forward_kin(powderline_q, p[0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
  local off = norm([flange[0] - {x:.6}, flange[1] - {y:.6}, flange[2] - {z:.6}])
  textmsg(\"Powderline: metres that this arm is off a nominal UR5e at the start: \", off)
  if off > {CALIBRATION_TOLERANCE_M}:
    textmsg(\"Powderline: this is no UR5e; the motion is not played\")
    halt
  end
  textmsg(\"Powderline: slowly to the start of plan {hash:016x}\")
  movej(powderline_q, a={acceleration}, v={speed})
  if norm(get_actual_joint_positions() - powderline_q) > {START_TOLERANCE_RAD}:
    textmsg(\"Powderline: the arm is not at the start; the motion is not played\")
    halt
  end
  textmsg(\"Powderline: plays the motion\")
",
        hash = motion.plan_hash,
    )
}

fn write_end(out: &mut dyn Write, cycle_us: u32) -> io::Result<()> {
    let cycle_s = f64::from(cycle_us) / 1e6;
    let [lookahead_s, gain] = FOLLOWING;
    write!(
        out,
        "  local held = 0
  while held < {cycles}:
    servoj(powderline_q, t={cycle_s}, lookahead_time={lookahead_s}, gain={gain})
    held = held + 1
  end
  stopj({STOP_RAD_S2:?})
  textmsg(\"Powderline: done\")
end
",
        cycles = (HOLD_S / cycle_s).ceil(),
    )
}

/// A list of numbers to 10^-12, without exponents.
fn list(values: &Joints) -> String {
    let number = |value: f64| if value.abs() < 1e-12 { "0.0".into() } else { format!("{value:.12}") };
    format!("[{}]", values.map(number).join(", "))
}

fn pose(pose: &Pose) -> String {
    let ([x, y, z], [rx, ry, rz]): ([f64; 3], [f64; 3]) =
        (pose.position_m.into(), log_so3(&pose.orientation).into());
    // Adding zero takes the sign from a zero that has one.
    let [x, y, z, rx, ry, rz] = [x, y, z, rx, ry, rz].map(|value| (value * 1e6).round() / 1e6 + 0.0);
    format!("p[{x}, {y}, {z}, {rx}, {ry}, {rz}]")
}
