//! What a run has to say, for people and for programs.

use core::fmt::{self, Write as _};

use powderline_executor::Telemetry;
use powderline_host::jitter::JitterSummary;
use powderline_host::words::counted;
use powderline_shared::displacement::{Axis, Lsb, Setpoint};
use powderline_shared::fault::{Fault, FaultCode, Side};
use powderline_shared::limits::PeakUse;
use powderline_shared::mass::Mass;
use powderline_shared::plan::{Finer, Mounting, PlanReader, Prediction, SkillParameter, StartPose};
use powderline_shared::wire::message::Refusal;
use serde::Serialize;

use crate::run::{FrameCounts, RunResult};
use powderline_executor::Outcome;

/// Largest accepted difference between the final pose and the plan's end, LSB; more than a half by what floating-point
/// numbers may be off.
const HALF_LSB: f64 = 0.5 * (1.0 + 1e-6);

/// Everything about a run.
#[derive(Clone, Debug, Serialize)]
pub struct Report {
    /// The plan.
    pub plan: PlanFacts,
    /// Whether the arm holds the plan's last setpoint.
    pub completed: bool,
    /// Why not.
    pub stop: Option<Stop>,
    /// Whether the arm has reported that it stands still; if not, it may be moving yet.
    pub standstill: bool,
    /// The stop that the arm had latched and was taken out of before, in words; none if it had none.
    pub reset_from: Option<String>,
    /// What was played.
    pub ticks: Ticks,
    /// Begin to end, seconds of the arm's time.
    pub duration_s: f64,
    /// Under the wall clock: how late this process woke up.
    pub jitter: Option<JitterSummary>,
    /// On a wire: what became of frames.
    pub frames: Option<FrameCounts>,
    /// On a wire: what is to be said of it.
    pub wire: Option<String>,
    /// What the executor counted and measured.
    pub stream: Stream,
    /// Where the arm stands, as far as it has said.
    pub final_pose: Option<StartPose>,
    /// Where the plan ends.
    pub plan_end_pose: StartPose,
    /// Where the arm stands minus where the plan ends, both from the arm's anchor (x, y, z, rx, ry, rz), metres and radians.
    pub error_m_rad: Option<[f64; 6]>,
    /// The same in LSB of the wire, which may be coarser than the plan's.
    pub error_lsb: Option<[f64; 6]>,
    /// Whether each of them is at most half an LSB.
    pub within_half_lsb: bool,
    /// Largest use of the plan's limits, per cent.
    pub peak_use_percent: PeakUse,
}

/// The plan's header, for programs.
#[derive(Clone, Debug, Serialize)]
pub struct PlanFacts {
    /// As given on the command line.
    pub file: String,
    /// Hexadecimal.
    pub content_hash: String,
    /// Hexadecimal.
    pub scene_digest: String,
    /// major.minor.patch.
    pub optimiser_version: String,
    /// Of the run that made it.
    pub seed: u64,
    /// `f32` or `f64`.
    pub precision: &'static str,
    /// Normalised.
    pub theta: [f64; 5],
    /// m, rad, m, m, rad.
    pub skill_parameters: [f64; 5],
    /// How many numbers say how the motion leaves the skill's: 0 where it is the skill's own.
    pub path_coefficients: u32,
    /// Microseconds.
    pub control_period_us: u32,
    /// Steps.
    pub step_count: u32,
    /// What one count is worth.
    pub lsb: Lsb,
    /// What it brings, as it was simulated.
    pub predicted: Prediction,
    /// What it brings on a finer grid; none if nobody looked.
    pub finer: Option<Finer>,
    /// The arm that it was made for; none if no arm was looked at.
    pub arm: Option<Mounting>,
}

/// Why an arm stopped.
#[derive(Clone, Debug, Serialize)]
pub struct Stop {
    /// Stable number.
    pub code: u16,
    /// Last setpoint taken before.
    pub tick: u32,
    /// One plain sentence.
    pub reason: &'static str,
    /// The numbers behind it, if there are any.
    pub detail: Option<String>,
}

/// What the executor counted and measured.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Stream {
    /// Setpoints sent again because the arm did not have them.
    pub resent: u32,
    /// Requests made again because nothing had come of them.
    pub retries: u32,
    /// Messages that the arm dropped since its power on.
    pub dropped_by_arm: u16,
    /// Shortest time from saying something to hearing of it, seconds.
    pub quickest_round_trip_s: Option<f64>,
    /// Longest time from saying something to hearing of it, the wait for the arm's next report included, seconds.
    pub longest_round_trip_s: Option<f64>,
    /// Ticks at which where the arm was could be compared with where it was due.
    pub tracked: u32,
    /// Largest distance of the arm from where it was due, metres; unknown if nothing could be compared.
    pub tracking_m: Option<f64>,
    /// Largest angle of the arm from where it was due, radians; unknown if nothing could be compared.
    pub tracking_rad: Option<f64>,
}

impl Stream {
    fn new(telemetry: &Telemetry) -> Self {
        let known = |largest| (telemetry.tracked > 0).then_some(largest);
        Self {
            resent: telemetry.resent,
            retries: telemetry.retries,
            dropped_by_arm: telemetry.dropped,
            quickest_round_trip_s: telemetry.round_trip.shortest_us().map(seconds),
            longest_round_trip_s: telemetry.round_trip.longest_us().map(seconds),
            tracked: telemetry.tracked,
            tracking_m: known(telemetry.tracking_m),
            tracking_rad: known(telemetry.tracking_rad),
        }
    }
}

/// Counts of ticks.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Ticks {
    /// In the plan.
    pub planned: u32,
    /// Taken by the arm.
    pub applied: u32,
    /// Not there when needed.
    pub lost: u16,
}

/// Of an arm that took all ticks, was let go at the end of the plan, and has not stayed there.
const ENDED_ELSEWHERE: &str = "The arm has left the plan's end since it was let go";

impl Report {
    /// Puts together what a run of `plan` from `file` gave.
    #[must_use]
    pub fn new(file: &str, plan: &PlanReader<'_>, run: &RunResult) -> Self {
        let header = plan.header();
        let end = plan.end_pose();
        let error_m_rad = run.reached.map(|reached| end_error(plan, reached, run.lsb));
        let error_lsb = error_m_rad.map(|errors| in_counts(errors, run.lsb));
        Self {
            plan: PlanFacts::new(file, plan),
            completed: run.outcome == Outcome::Completed,
            stop: match run.outcome {
                Outcome::Completed => None,
                Outcome::Stopped { fault, .. } => Some(Stop::new(fault, run)),
            },
            standstill: match run.outcome {
                Outcome::Completed => true,
                Outcome::Stopped { standstill, .. } => standstill,
            },
            reset_from: run.reset_from.map(|fault| fault.to_string()),
            ticks: Ticks {
                planned: header.step_count,
                applied: run.arm.map_or(0, |arm| arm.applied_tick),
                lost: run.telemetry.lost,
            },
            duration_s: seconds(run.duration_us),
            jitter: run.jitter,
            frames: run.frames,
            wire: run.wire.clone(),
            stream: Stream::new(&run.telemetry),
            final_pose: run.final_pose.as_ref().map(StartPose::from),
            plan_end_pose: StartPose::from(&end),
            error_m_rad,
            error_lsb,
            within_half_lsb: error_lsb
                .is_some_and(|errors| errors.iter().all(|error| error.abs() <= HALF_LSB)),
            peak_use_percent: percent(run.peak_use),
        }
    }

    /// Whether the arm did what the plan says.
    #[must_use]
    pub fn succeeded(&self) -> bool {
        self.completed && self.within_half_lsb
    }

    /// One sentence on how it ended.
    #[must_use]
    pub fn cause(&self) -> String {
        match &self.stop {
            None => {
                let planned = counted(self.ticks.planned, "tick", "ticks");
                let how = if self.within_half_lsb { "completed" } else { ENDED_ELSEWHERE };
                format!("{how}: {} of {planned}", self.ticks.applied)
            }
            Some(stop) => {
                let how =
                    if self.standstill { "stopped" } else { "given up, and nobody knows whether it stands," };
                format!("{how} at tick {}, fault {}: {}", self.ticks.applied, stop.code, stop.reason)
            }
        }
    }

    /// Whether a person stopped it, and it stands.
    #[must_use]
    pub fn stopped_by_a_person(&self) -> bool {
        self.standstill
            && self.stop.as_ref().is_some_and(|stop| stop.code == FaultCode::OperatorStop.number())
    }
}

impl PlanFacts {
    /// Reads them off the plan's header.
    #[must_use]
    pub fn new(file: &str, plan: &PlanReader<'_>) -> Self {
        let header = plan.header();
        let version = header.optimiser_version;
        Self {
            file: file.to_string(),
            content_hash: format!("{:016x}", plan.content_hash()),
            scene_digest: hex(&header.scene_digest),
            optimiser_version: format!("{}.{}.{}", version.major, version.minor, version.patch),
            seed: header.seed,
            precision: header.precision.name(),
            theta: header.theta,
            skill_parameters: header.skill_parameters,
            path_coefficients: header.path_coefficients,
            control_period_us: header.control_period_us,
            step_count: header.step_count,
            lsb: header.lsb,
            predicted: header.predicted,
            finer: header.finer,
            arm: header.arm,
        }
    }
}

impl fmt::Display for PlanFacts {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let digest: String = self.scene_digest.chars().take(12).collect();
        let predicted = &self.predicted;
        writeln!(f, "Plan {} ({})", self.file, self.content_hash)?;
        writeln!(
            f,
            "  from      optimiser {}, scene {digest}.., seed {}, {}",
            self.optimiser_version, self.seed, self.precision
        )?;
        let near = if self.path_coefficients == 0 { "skill     " } else { "path near " };
        write!(f, "  {near}")?;
        for (parameter, (separator, value)) in SkillParameter::ALL
            .into_iter()
            .zip(["", ", ", ", ", ", ", ", "].into_iter().zip(self.skill_parameters))
        {
            write!(f, "{separator}{} {value:.4} {}", parameter.name(), parameter.unit())?;
        }
        let length_s = seconds(u64::from(self.control_period_us).saturating_mul(u64::from(self.step_count)));
        writeln!(f)?;
        writeln!(
            f,
            "  motion    {} of {} ms, {length_s:.3} s",
            counted(self.step_count, "step", "steps"),
            f64::from(self.control_period_us) / 1e3
        )?;
        match self.arm {
            Some(arm) => {
                let Mounting { kind, posture, .. } = arm;
                let [x, y, z] = arm.world_from_base.position_m.map(|metres| 1e3 * metres);
                writeln!(
                    f,
                    "  for       a {} with its base at ({x:.0}, {y:.0}, {z:.0}) mm: {posture}",
                    kind.label()
                )?;
            }
            None => writeln!(f, "  for       no arm that was looked at: its scene has no [arm]")?,
        }
        let wanted = Mass(predicted.wanted_kg);
        let own = format!(
            "{} ({})",
            Mass(predicted.arrives_kg()),
            counted(predicted.census.target, "particle", "particles")
        );
        let rest = predicted.census.rest(predicted.particle_mass_kg);
        // What it was corrected by comes first.
        let Some(finer) = &self.finer else {
            return writeln!(f, "  predicts  {own} of the {wanted} wanted arrive; {rest}");
        };
        writeln!(
            f,
            "  predicts  {} of the {wanted} wanted arrive, on a finer grid with cells of {} mm; {}",
            Mass(finer.arrives_kg()),
            (1e6 * finer.cell_m).round() / 1e3,
            finer.census.rest(finer.particle_mass_kg)
        )?;
        writeln!(f, "            {own} on the scene's own; {rest}")
    }
}

impl Stop {
    fn new(fault: Fault, run: &RunResult) -> Self {
        Self {
            code: fault.code.number(),
            tick: fault.tick,
            reason: fault.code.sentence(),
            detail: numbers(fault.code, run).or_else(|| wrong_key(fault, run)),
        }
    }
}

/// What is behind this very fault: whatever else was heard on the way is not the reason.
fn numbers(code: FaultCode, run: &RunResult) -> Option<String> {
    use FaultCode::{ArmAstray, ArmFaultUnknown, ArmSilent, ArmTickImpossible, EndElsewhere, SessionRefused};
    match code {
        SessionRefused => run.refusal.map(|refusal| match refusal {
            Refusal::Latched { fault, .. } if run.is_stopped_anew => {
                format!("the arm has stopped since --reset was asked for ({fault}); look at it again, then start once more")
            }
            other => other.to_string(),
        }),
        ArmTickImpossible | ArmSilent | ArmAstray | EndElsewhere | ArmFaultUnknown => {
            run.doubt.map(|doubt| doubt.to_string())
        }
        _ => {
            let of = |limit| [Side::Executor, Side::Arm].map(|side| FaultCode::from_limit(limit, side));
            let violation = run.violation.filter(|violation| of(violation.limit).contains(&code));
            violation.map(|violation| violation.to_string())
        }
    }
}

/// What tells a wrong key from an arm that says nothing. Who has the half of it that opens a session gets no further.
fn wrong_key(fault: Fault, run: &RunResult) -> Option<String> {
    use FaultCode::{ArmSilent, HandshakeTimeout, WrongTags};
    let wrong = run.frames.map_or(0, |frames| frames.wrong_tags);
    let is_its_doing = wrong > 0 && matches!(fault.code, ArmSilent | HandshakeTimeout | WrongTags);
    is_its_doing.then(|| {
        let frames = counted(wrong, "frame with a wrong tag was", "frames with a wrong tag were");
        format!("{frames} dropped; both ends need the same --key FILE")
    })
}

/// Without the plan's facts, which are shown before the run.
impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Ticks { planned, applied, lost } = self.ticks;
        match &self.stop {
            None => {
                let planned = counted(planned, "tick", "ticks");
                let how = if self.within_half_lsb { "Completed" } else { ENDED_ELSEWHERE };
                writeln!(f, "{how}: {applied} of {planned} in {:.3} s", self.duration_s)?;
            }
            Some(stop) => {
                let what = if self.standstill { "Stopped" } else { "Given up" };
                writeln!(f, "{what} at tick {applied} of {planned}, after {:.3} s", self.duration_s)?;
                if !self.standstill {
                    writeln!(f, "  arm       has not reported standstill: it may be moving yet")?;
                }
                writeln!(f, "  reason    {} (fault {})", stop.reason, stop.code)?;
                stop.detail.iter().try_for_each(|detail| writeln!(f, "            {detail}"))?;
            }
        }
        self.reset_from
            .iter()
            .try_for_each(|fault| writeln!(f, "  reset     the arm had stopped: {fault}"))?;
        if lost > 0 {
            let lost = counted(lost, "setpoint was", "setpoints were");
            writeln!(f, "  lost      {lost} not there when the arm needed them")?;
        }
        if let Some(errors) = self.error_m_rad {
            let verdict = match self.within_half_lsb {
                true => "all within half a count of the wire",
                false => "more than half a count of the wire",
            };
            let [x, y, z, rx, ry, rz] = errors.map(|error| 1e3 * error.abs());
            let [mm, mrad] = [x.max(y).max(z), rx.max(ry).max(rz)];
            writeln!(
                f,
                "  end pose  {mm:.4} mm and {mrad:.4} mrad off the plan's end along or about an axis, {verdict}"
            )?;
        }
        let peak = &self.peak_use_percent;
        writeln!(
            f,
            "  limits    peak use: linear velocity {:.0} %, acceleration {:.0} %, jerk {:.0} %; \
             angular velocity {:.0} %, acceleration {:.0} %, jerk {:.0} %",
            peak.linear_velocity,
            peak.linear_acceleration,
            peak.linear_jerk,
            peak.angular_velocity,
            peak.angular_acceleration,
            peak.angular_jerk
        )?;
        self.fmt_stream(f)
    }
}

impl Report {
    fn fmt_stream(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Stream { resent, retries, tracked, tracking_m, tracking_rad, .. } = self.stream;
        if let Some(frames) = self.frames {
            let FrameCounts { sent, received, rejected, not_taken, garbled, .. } = frames;
            writeln!(
                f,
                "  frames    {sent} sent, {received} received, {rejected} not understood, {not_taken} not taken by the wire, \
                 {garbled} garbled; {} sent again, {} repeated",
                counted(resent, "setpoint", "setpoints"),
                counted(retries, "request", "requests")
            )?;
        }
        if let (Some(_), Some(quickest), Some(longest)) =
            (self.frames, self.stream.quickest_round_trip_s, self.stream.longest_round_trip_s)
        {
            writeln!(
                f,
                "  answers   {:.3} ms at the quickest, {:.3} ms at the slowest",
                quickest * 1e3,
                longest * 1e3
            )?;
        }
        match (tracking_m, tracking_rad) {
            (Some(metres), Some(radians)) => writeln!(
                f,
                "  tracking  {:.3} mm, {:.3} mrad off at the most, at {} of {} ticks",
                metres * 1e3,
                radians * 1e3,
                tracked,
                self.ticks.applied
            )?,
            _ if self.ticks.applied > 0 => {
                writeln!(f, "  tracking  unknown: the arm did not say where it was on its way")?
            }
            _ => {}
        }
        self.wire.iter().try_for_each(|wire| writeln!(f, "  wire      {wire}"))?;
        self.jitter.iter().try_for_each(|jitter| writeln!(f, "  clock     {jitter}"))
    }
}

/// Component by component, as setpoints are rounded; metres and radians.
fn end_error(plan: &PlanReader<'_>, reached: Setpoint, lsb: Lsb) -> [f64; 6] {
    let end = plan.end_setpoint().cumulative(plan.header().lsb).components();
    let mut errors = reached.cumulative(lsb).components();
    for (error, end) in errors.iter_mut().zip(end) {
        *error -= end;
    }
    errors
}

fn in_counts(mut errors: [f64; 6], lsb: Lsb) -> [f64; 6] {
    for (error, axis) in errors.iter_mut().zip(Axis::ALL) {
        *error /= lsb.of(axis);
    }
    errors
}

fn percent(share: PeakUse) -> PeakUse {
    PeakUse {
        linear_velocity: share.linear_velocity * 100.0,
        linear_acceleration: share.linear_acceleration * 100.0,
        linear_jerk: share.linear_jerk * 100.0,
        angular_velocity: share.angular_velocity * 100.0,
        angular_acceleration: share.angular_acceleration * 100.0,
        angular_jerk: share.angular_jerk * 100.0,
    }
}

#[expect(clippy::cast_precision_loss, reason = "2^53 microseconds are 285 years")]
fn seconds(microseconds: u64) -> f64 {
    microseconds as f64 / 1e6
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().fold(String::new(), |mut text, byte| {
        // Writing to a string cannot fail.
        let _ = write!(text, "{byte:02x}");
        text
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_error_is_worth_what_the_wire_says() {
        let plan = PlanReader::new(include_bytes!("../../../shared/tests/golden/plan-v4.plan")).unwrap();
        let (fine, coarse) = (plan.header().lsb, Lsb { translation_nm: 1_000, rotation_nrad: 10_000 });
        // Two millimetres and four milliradians beyond the end, in counts of a wire that is coarser than the plan.
        let mut reached = plan.end_setpoint().rescaled(fine, coarse).unwrap();
        let at_the_end = in_counts(end_error(&plan, reached, coarse), coarse);
        assert!(at_the_end.iter().all(|error| error.abs() <= HALF_LSB), "{at_the_end:?}");
        reached.counts[1] += 2_000;
        reached.counts[5] -= 400;
        let errors = end_error(&plan, reached, coarse);
        assert!((errors[1] - 2e-3).abs() < 1e-6 && (errors[5] + 4e-3).abs() < 1e-5, "{errors:?}");
        let counts = in_counts(errors, coarse);
        assert!((counts[1] - 2_000.0).abs() <= 1.0 && (counts[5] + 400.0).abs() <= 1.0, "{counts:?}");
    }
}
