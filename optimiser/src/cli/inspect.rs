//! `optimise inspect`: what a plan holds.

use super::{CliError, Context};
use crate::report::{
    amounts::counted,
    finding::Finding,
    record::RunRecord,
    words::{grouped, hex, parameter},
};
use clap::Args;
use powderline_shared::{
    limits::{Limits, PeakUse},
    plan::{
        Finer, PlanHeader, PlanReader, Prediction, SkillParameter, StartPose,
        file::{parse_plan, read_plan_file},
    },
};
use powderline_simulator::scene::figures::{about, mass};
use serde::Serialize;
use std::{
    fmt::Write as _,
    path::{Path, PathBuf},
};

/// Arguments of `optimise inspect`.
#[derive(Clone, Debug, Args)]
pub(super) struct InspectArgs {
    /// The plan
    #[arg(value_name = "PLAN")]
    pub plan: PathBuf,
    /// Print one JSON object
    #[arg(long)]
    pub json: bool,
}

#[derive(Serialize)]
struct Report {
    content_hash: String,
    scene_digest: String,
    optimiser_version: String,
    seed: u64,
    precision: &'static str,
    parameters: Vec<Parameter>,
    /// How many numbers say how the motion leaves that skill's: 0 where it is the skill's own.
    path_coefficients: u32,
    control_period_us: u32,
    step_count: u32,
    duration_s: f64,
    translation_lsb_nm: u32,
    rotation_lsb_nrad: u32,
    start: StartPose,
    end: StartPose,
    /// From start to end: translation (m) and rotation vector (rad), world axes.
    displacement: [f64; 6],
    limits: Limits,
    /// Share of each limit that the motion uses; none when it breaks one.
    limit_use: Option<PeakUse>,
    limit_broken: Option<String>,
    predicted: Prediction,
    /// What it brings on a finer grid; null if nobody looked.
    finer: Option<Finer>,
    /// What the run that made it found, where the plan still lies in its folder.
    run: Option<Finding>,
}

#[derive(Serialize)]
struct Parameter {
    name: &'static str,
    theta: f64,
    value: f64,
    unit: &'static str,
}

/// Runs the command.
///
/// # Errors
/// One sentence, if the file is no usable plan.
pub(super) fn execute(arguments: &InspectArgs, context: &mut Context<'_>) -> Result<(), CliError> {
    let bytes = read_plan_file(&arguments.plan)?;
    let plan = parse_plan(&arguments.plan, &bytes)?;
    let report = Report::new(&plan, run_of(&arguments.plan, &plan));
    if arguments.json {
        return context.json(&report);
    }
    write!(context.out, "{}", report.text())?;
    Ok(())
}

/// What the run found in whose folder the plan lies, if that run made it.
pub(super) fn run_of(path: &Path, plan: &PlanReader<'_>) -> Option<Finding> {
    let record = RunRecord::read(path.parent()?).ok()?;
    let header = plan.header();
    let made = record.shipped?.is_of(header.theta)
        && record.state.scene == header.scene_digest
        && record.state.seed == header.seed;
    record.finding().filter(|_| made)
}

impl Report {
    fn new(plan: &PlanReader<'_>, run: Option<Finding>) -> Self {
        let header = plan.header();
        let checked = plan.check_limits();
        let version = header.optimiser_version;
        Self {
            content_hash: format!("{:016x}", plan.content_hash()),
            scene_digest: hex(&header.scene_digest),
            optimiser_version: format!("{}.{}.{}", version.major, version.minor, version.patch),
            seed: header.seed,
            precision: header.precision.name(),
            parameters: parameters(header),
            path_coefficients: header.path_coefficients,
            control_period_us: header.control_period_us,
            step_count: header.step_count,
            duration_s: f64::from(header.step_count) * f64::from(header.control_period_us) * 1e-6,
            translation_lsb_nm: header.lsb.translation_nm,
            rotation_lsb_nrad: header.lsb.rotation_nrad,
            start: header.start,
            end: StartPose::from(&plan.end_pose()),
            displacement: plan.end_setpoint().cumulative(header.lsb).components(),
            limits: header.limits,
            limit_use: checked.ok(),
            limit_broken: checked.err().map(|violation| violation.to_string()),
            predicted: header.predicted,
            finer: header.finer,
            run,
        }
    }

    fn text(&self) -> String {
        let mut text = String::new();
        // Writing to a string does not fail.
        let _ = self.write_text(&mut text);
        text
    }

    fn write_text(&self, text: &mut String) -> std::fmt::Result {
        self.write_prediction(text)?;
        writeln!(
            text,
            "Plan {}, made by optimise {} with seed {} in {}",
            self.content_hash, self.optimiser_version, self.seed, self.precision
        )?;
        writeln!(text, "for the scene with digest {}.\n", self.scene_digest)?;
        writeln!(
            text,
            "{} steps of {} us: {:.2} s; one count is {} nm or {} nrad.\n",
            grouped(self.step_count.into()),
            self.control_period_us,
            self.duration_s,
            self.translation_lsb_nm,
            self.rotation_lsb_nrad
        )?;
        for (which, shown) in SkillParameter::ALL.into_iter().zip(&self.parameters) {
            let value = parameter(which, shown.value);
            writeln!(text, "{:<24}{value:>12}   theta {:>8.4}", shown.name, shown.theta)?;
        }
        if self.path_coefficients > 0 {
            writeln!(
                text,
                "The motion is not this skill's own, but a path near it: {} numbers say how it leaves that.",
                self.path_coefficients
            )?;
        }
        self.write_motion(text)
    }

    /// What it brings, in the words of the run that made it where that is at hand.
    fn write_prediction(&self, text: &mut String) -> std::fmt::Result {
        if let Some(finding) = &self.run {
            writeln!(text, "{}", finding.headline())?;
            for sentence in finding.sentences() {
                writeln!(text, "{sentence}")?;
            }
            return writeln!(text);
        }
        let Prediction { loss_m, wanted_kg, particle_mass_kg, census, .. } = self.predicted;
        let (wanted, rest) = (mass(wanted_kg), census.rest(particle_mass_kg));
        let own = format!("{} ({})", mass(self.predicted.arrives_kg()), counted(census.target));
        match &self.finer {
            None => writeln!(text, "The plan brings {own} of the {wanted} wanted; {rest}.")?,
            // What it was corrected by comes first.
            Some(finer) => {
                writeln!(
                    text,
                    "On a finer grid, with cells of {} mm, the plan brings {} of the {wanted} wanted; {}.",
                    about(1e3 * finer.cell_m, 3),
                    mass(finer.arrives_kg()),
                    finer.census.rest(finer.particle_mass_kg)
                )?;
                writeln!(text, "On the scene's own it brings {own}; {rest}.")?;
            }
        }
        writeln!(text, "Its loss is {loss_m:.3} m.")?;
        writeln!(text)
    }

    fn write_motion(&self, text: &mut String) -> std::fmt::Result {
        let millimetres = |position: [f64; 3]| position.map(|x| format!("{:.1}", 1e3 * x)).join(", ");
        let [x, y, z, rx, ry, rz] = self.displacement;
        let turn_deg = (rx * rx + ry * ry + rz * rz).sqrt().to_degrees();
        writeln!(
            text,
            "\nStarts at ({}) mm, ends at ({}) mm:",
            millimetres(self.start.position_m),
            millimetres(self.end.position_m)
        )?;
        writeln!(text, "moved by ({}) mm and turned by {turn_deg:.1} deg.\n", millimetres([x, y, z]))?;
        if let Some(broken) = &self.limit_broken {
            return writeln!(text, "It breaks its own limits: {broken}.");
        }
        let Some(used) = self.limit_use else { return Ok(()) };
        let limits = &self.limits;
        for (name, limit, unit, share) in [
            ("linear velocity", limits.linear_velocity_m_s, "m/s", used.linear_velocity),
            ("linear acceleration", limits.linear_acceleration_m_s2, "m/s^2", used.linear_acceleration),
            ("linear jerk", limits.linear_jerk_m_s3, "m/s^3", used.linear_jerk),
            ("angular velocity", limits.angular_velocity_rad_s, "rad/s", used.angular_velocity),
            (
                "angular acceleration",
                limits.angular_acceleration_rad_s2,
                "rad/s^2",
                used.angular_acceleration,
            ),
            ("angular jerk", limits.angular_jerk_rad_s3, "rad/s^3", used.angular_jerk),
        ] {
            writeln!(text, "{name:<24}uses {:>5.1} % of {limit} {unit}", 100.0 * share)?;
        }
        let [min, max] = [limits.workspace_min_m, limits.workspace_max_m].map(millimetres);
        writeln!(text, "{:<24}kept, ({min}) to ({max}) mm", "workspace")
    }
}

fn parameters(header: &PlanHeader) -> Vec<Parameter> {
    let all = SkillParameter::ALL.into_iter().zip(header.theta).zip(header.skill_parameters);
    all.map(|((which, theta), value)| Parameter { name: which.name(), theta, value, unit: which.unit() })
        .collect()
}
