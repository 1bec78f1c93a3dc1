//! The motion that the arm has really made of a plan: read from its file, held against the plan, made ready for the powder.

use super::CliError;
use powderline_shared::{
    displacement::{Displacement, pose_at},
    plan::{PlanHeader, PlanReader},
    pose::{Pose, norm},
    trajectory::{
        ANCHOR_TOLERANCE_M, ANCHOR_TOLERANCE_RAD, MAX_LINE_BYTES, TrajectoryHeader, TrajectoryReader,
    },
};
use powderline_simulator::scene::Scene;
use serde::Serialize;
use std::{
    fmt::Write as _,
    fs::File,
    io::{self, BufRead, BufReader, Read},
    path::Path,
};

/// An arm that stays this near to a pose rests there: no powder moves by it.
const REST_M: f64 = 1e-6;
const REST_RAD: f64 = 1e-5;

/// An arm that is faster than this in its last tick has not come to rest.
const REST_M_S: f64 = 1e-3;
const REST_RAD_S: f64 = 1e-2;

/// Furthest that the tool may go in one substep, in cells: further, and powder may be on its other side unnoticed.
const MAX_CELLS_PER_SUBSTEP: f64 = 0.5;

/// Furthest that the tool may turn in one control step, radians: further, and which way round it went is a guess.
const MAX_TURN_RAD: f64 = 1.0;

/// An executed motion of a plan.
#[derive(Clone, Debug)]
pub(super) struct Executed {
    /// Where the arm began.
    pub anchor: Pose,
    /// What the tool does in each control step: the displacements between successive poses, and none where the arm rests
    /// before the prediction ends.
    pub controls: Vec<Displacement>,
    /// The motion held against the plan.
    pub report: ExecutedReport,
}

/// How an executed motion compares with its plan.
#[derive(Clone, Debug, Serialize)]
pub(super) struct ExecutedReport {
    /// Control steps of the plan.
    planned_steps: usize,
    /// The last tick in the file.
    executed_steps: usize,
    /// Control steps for which the powder is simulated.
    simulated_steps: usize,
    /// The file ends before the plan does.
    stopped_early: bool,
    /// The file ends before the arm has come to rest.
    moves_at_end: bool,
    /// Largest distance and angle from the planned pose of the same tick; after the plan's end, from its end.
    largest_deviation: Deviation,
    /// Those of the last executed pose from the plan's end.
    end_deviation: Deviation,
}

/// A distance and an angle, each with the tick at which it is reached.
#[derive(Clone, Copy, Debug, Default, Serialize)]
struct Deviation {
    mm: f64,
    mm_tick: usize,
    mrad: f64,
    mrad_tick: usize,
}

impl Executed {
    /// Reads the motion and checks that it is one of this plan.
    ///
    /// # Errors
    /// One sentence.
    pub(super) fn read(path: &Path, plan: &PlanReader<'_>, scene: &Scene) -> Result<Self, CliError> {
        let wrong = |why: String| CliError::Input(format!("{} {why}", path.display()));
        let file = File::open(path).map_err(|error| wrong(format!("cannot be read: {error}")))?;
        let poses = read_poses(file, |header| check_header(header, plan)).map_err(wrong)?;
        check_anchor(&poses, plan.header()).map_err(wrong)?;
        check_steps(&poses, scene).map_err(wrong)?;
        let report = ExecutedReport::new(&poses, plan);
        let steps = poses.windows(2).map(|pair| pair[0].displacement_to(&pair[1]));
        let controls = steps.chain(std::iter::repeat(Displacement::default()));
        let controls = controls.take(report.simulated_steps).collect();
        Ok(Self { anchor: poses[0], controls, report })
    }
}

impl Deviation {
    fn of(planned: &Pose, pose: &Pose, tick: usize) -> Self {
        let off = planned.displacement_to(pose);
        let [mm, mrad] = [off.translation(), off.rotation()].map(|off| 1e3 * norm(&off));
        Self { mm, mm_tick: tick, mrad, mrad_tick: tick }
    }

    /// The larger of each.
    fn raise(&mut self, other: &Self) {
        if other.mm > self.mm {
            (self.mm, self.mm_tick) = (other.mm, other.mm_tick);
        }
        if other.mrad > self.mrad {
            (self.mrad, self.mrad_tick) = (other.mrad, other.mrad_tick);
        }
    }
}

impl ExecutedReport {
    fn new(poses: &[Pose], plan: &PlanReader<'_>) -> Self {
        let header = plan.header();
        let (planned_steps, executed_steps) = (header.step_count as usize, poses.len() - 1);
        let end = Deviation::of(&plan.end_pose(), &poses[executed_steps], executed_steps);
        Self {
            planned_steps,
            executed_steps,
            // As long as for the prediction, or longer if the arm comes to rest later.
            simulated_steps: rest_tick(poses).max(planned_steps),
            stopped_early: executed_steps < planned_steps,
            moves_at_end: moves_at_end(poses, f64::from(header.control_period_us) * 1e-6),
            largest_deviation: largest_deviation(poses, plan),
            end_deviation: end,
        }
    }

    /// Sentences on the motion, not on the powder.
    pub(super) fn text(&self) -> String {
        let Self { planned_steps, executed_steps, simulated_steps, .. } = self;
        let Deviation { mm, mm_tick, mrad, mrad_tick } = self.largest_deviation;
        let mut text = format!(
            "The arm was off the plan by {mm:.3} mm (tick {mm_tick}) and {mrad:.3} mrad (tick {mrad_tick}) at most, and by \
             {:.3} mm and {:.3} mrad at its last tick.\n",
            self.end_deviation.mm, self.end_deviation.mrad
        );
        // Writing to a string does not fail.
        if self.stopped_early {
            let _ = writeln!(
                text,
                "The motion is shorter than the plan: it ends at tick {executed_steps} of {planned_steps}; the tool is kept \
                 there up to tick {planned_steps}, for which the plan predicts."
            );
        } else if simulated_steps > planned_steps {
            let _ = writeln!(
                text,
                "The arm came to rest after the plan's end at tick {planned_steps}, at tick {simulated_steps}; the powder \
                 is simulated up to there."
            );
        }
        if self.moves_at_end {
            let _ = writeln!(
                text,
                "At the last tick of the record the arm still moves: where it rested is not known."
            );
        }
        text
    }
}

/// All poses of a file; the header is checked before any of them is read.
fn read_poses(
    file: impl Read,
    check: impl Fn(&TrajectoryHeader) -> Result<(), String>,
) -> Result<Vec<Pose>, String> {
    let wrong = |error| format!("is no usable record of an executed motion: {error}");
    let mut lines = BufReader::new(file);
    let (mut reader, mut line, mut poses) = (TrajectoryReader::default(), Vec::new(), Vec::new());
    let mut known = false;
    while read_line(&mut lines, &mut line).map_err(|error| format!("cannot be read: {error}"))? {
        poses.extend(reader.line(&line).map_err(wrong)?.map(|sample| sample.pose));
        if let Some(header) = reader.header().filter(|_| !known) {
            check(&header)?;
            known = true;
        }
    }
    reader.finish().map_err(wrong)?;
    Ok(poses)
}

/// The next line with its end; of one that is too long, enough to see that. `false` when there is none.
fn read_line(lines: &mut impl BufRead, line: &mut Vec<u8>) -> io::Result<bool> {
    line.clear();
    let most = MAX_LINE_BYTES as u64 + 2;
    Ok(lines.by_ref().take(most).read_until(b'\n', line)? > 0)
}

fn check_header(found: &TrajectoryHeader, plan: &PlanReader<'_>) -> Result<(), String> {
    let (plan_hash, period_us) = (plan.content_hash(), plan.header().control_period_us);
    if found.plan_hash != plan_hash {
        return Err(format!(
            "was executed from another plan, {:016x} and not {plan_hash:016x}: give the plan that the arm was sent",
            found.plan_hash
        ));
    }
    if found.period_us != period_us {
        return Err(format!(
            "was executed with a period of {} us, but the plan has one of {period_us} us, for which alone it predicts",
            found.period_us
        ));
    }
    Ok(())
}

fn check_anchor(poses: &[Pose], header: &PlanHeader) -> Result<(), String> {
    let off = Deviation::of(&header.start_pose(), &poses[0], 0);
    let [most_mm, most_mrad] = [ANCHOR_TOLERANCE_M, ANCHOR_TOLERANCE_RAD].map(|tolerance| 1e3 * tolerance);
    if off.mm <= most_mm && off.mrad <= most_mrad {
        return Ok(());
    }
    Err(format!(
        "begins {:.3} mm and {:.3} mrad off the plan's start pose, but an arm starts at most {most_mm} mm and {most_mrad} \
         mrad off",
        off.mm, off.mrad
    ))
}

/// Whether the simulated powder can follow the tool.
fn check_steps(poses: &[Pose], scene: &Scene) -> Result<(), String> {
    let most_m = MAX_CELLS_PER_SUBSTEP * scene.domain.cell_m * f64::from(scene.time.substeps);
    for (tick, pair) in (1..).zip(poses.windows(2)) {
        let Deviation { mm, mrad, .. } = Deviation::of(&pair[0], &pair[1], tick);
        // A distance that is no number is no distance that can be followed.
        let follows = mm <= 1e3 * most_m && mrad <= 1e3 * MAX_TURN_RAD;
        if !follows {
            return Err(format!(
                "moves by {mm:.3} mm and {mrad:.3} mrad in the one tick {tick}, but the simulated powder follows at most \
                 {:.3} mm and {:.0} mrad",
                1e3 * most_m,
                1e3 * MAX_TURN_RAD
            ));
        }
    }
    Ok(())
}

fn largest_deviation(poses: &[Pose], plan: &PlanReader<'_>) -> Deviation {
    let (start, lsb) = (plan.header().start_pose(), plan.header().lsb);
    let planned = std::iter::once(start)
        .chain(plan.setpoints().map(|setpoint| pose_at(&start, setpoint, lsb)))
        .chain(std::iter::repeat(plan.end_pose()));
    let mut largest = Deviation::default();
    for (tick, (pose, planned)) in poses.iter().zip(planned).enumerate() {
        largest.raise(&Deviation::of(&planned, pose, tick));
    }
    largest
}

/// The first tick from which on the arm stays at its last pose.
fn rest_tick(poses: &[Pose]) -> usize {
    let last = &poses[poses.len() - 1];
    let rests = |pose: &&Pose| {
        let off = last.displacement_to(pose);
        norm(&off.translation()) <= REST_M && norm(&off.rotation()) <= REST_RAD
    };
    poses.len() - poses.iter().rev().take_while(rests).count()
}

fn moves_at_end(poses: &[Pose], period_s: f64) -> bool {
    let [.., before, last] = poses else { return false };
    let step = before.displacement_to(last);
    norm(&step.translation()) > REST_M_S * period_s || norm(&step.rotation()) > REST_RAD_S * period_s
}
