//! `optimise gradcheck --skills`: gradients of whole motions beside the slope that a search wants.

use super::{CliError, Context, Progress, gradcheck::GradcheckArgs, options::DEFAULT_PRECISION};
use crate::report::words::precision_name;
use powderline_shared::plan::{Precision, SKILL_PARAMETERS};
use powderline_simulator::rollout::slopes::{
    Fit, HALF_STEP, LEAST_DELIVERED, Measured, Row, Summary, cosine, measure, skill,
};
use powderline_simulator::rollout::{
    RolloutError, SimulatorSettings, Workload, boxed_simulator, check_memory, restart::Restarts,
};
use powderline_simulator::scene::Scene;
use powderline_simulator::skill::SkillMap;
use serde::Serialize;
use std::fmt::Write;

/// Skills that are tried at most for each one that is asked for.
const TRIES: u64 = 20;

#[derive(Serialize)]
struct Report {
    scene: String,
    precision: &'static str,
    half_step: f64,
    least_delivered: u32,
    packing_seeds: Vec<u64>,
    skills: Vec<Skill>,
    passed_over: Vec<PassedOver>,
    summary: Option<Summary>,
}

#[derive(Serialize)]
struct Skill {
    draw: u64,
    #[serde(flatten)]
    row: Row,
}

/// A skill that says nothing of gradients.
#[derive(Serialize)]
struct PassedOver {
    draw: u64,
    why: String,
}

/// Runs the command.
///
/// # Errors
/// One sentence.
pub(super) fn execute(
    skills: u32,
    arguments: &GradcheckArgs,
    scene: &Scene,
    context: &mut Context<'_>,
) -> Result<(), CliError> {
    let precision = arguments.precision.map_or(DEFAULT_PRECISION, Precision::from);
    let seed = arguments.seed.unwrap_or(scene.powder.seed);
    let settings = arguments.resources.settings(seed, precision);
    check_memory(scene, &settings, Workload::Gradient, 0)?;
    let packing_seeds: Vec<u64> = (0..arguments.packings).map(|k| seed.wrapping_add(k.into())).collect();
    let mut report = Report {
        scene: scene.name.clone(),
        precision: precision_name(precision),
        half_step: HALF_STEP,
        least_delivered: LEAST_DELIVERED,
        packing_seeds,
        skills: Vec::new(),
        passed_over: Vec::new(),
        summary: None,
    };
    let draws = arguments.first..arguments.first + TRIES * u64::from(skills);
    let stopped = fill(&mut report, skills as usize, draws, scene, &settings, context);
    let rows: Vec<Row> = report.skills.iter().map(|skill| skill.row.clone()).collect();
    report.summary = Summary::new(&rows);
    if stopped.is_err() && arguments.json {
        return stopped;
    }
    if arguments.json {
        return context.json(&report);
    }
    // What took so long is shown, even if it ended early.
    write!(context.out, "{}", text(&report))?;
    stopped
}

/// Measures packing after packing, so that one simulator at a time takes memory. The first packing finds the skills.
fn fill(
    report: &mut Report,
    skills: usize,
    draws: std::ops::Range<u64>,
    scene: &Scene,
    settings: &SimulatorSettings,
    context: &mut Context<'_>,
) -> Result<(), CliError> {
    let interrupt = context.interrupt.clone();
    let mut progress = Progress::new(context.err, context.live);
    let map = SkillMap::new(scene);
    let packings = report.packing_seeds.clone();
    let mut wanted: Vec<u64> = draws.collect();
    let mut found: Vec<(u64, Vec<Measured>)> = Vec::new();
    let mut outcome = Ok(());
    'packings: for (index, seed) in packings.iter().enumerate() {
        let mut simulator = boxed_simulator(scene, &SimulatorSettings { seed: *seed, ..*settings })?;
        let mut of_this = Vec::new();
        for draw in wanted {
            if of_this.len() == skills {
                break;
            }
            let (number, all) = (of_this.len() + 1, packings.len());
            progress.begin(&format!("skill {number} of {skills}, packing {} of {all}", index + 1), 0, &[]);
            let mut tick = |done, total| {
                progress.tick(done, total);
                !interrupt.is_requested()
            };
            let theta = skill(draw);
            let restarts = Restarts::of_skill(scene, &map, &theta);
            match measure(simulator.as_mut(), &theta, &restarts, &mut tick) {
                Ok(Some(measured)) => of_this.push((draw, measured)),
                Ok(None) => {
                    let why = format!("delivers fewer than {LEAST_DELIVERED} particles");
                    report.passed_over.push(PassedOver { draw, why });
                }
                Err(
                    error @ (RolloutError::Stopped
                    | RolloutError::Threads { .. }
                    | RolloutError::Memory { .. }),
                ) => {
                    outcome = Err(CliError::from(error));
                    break;
                }
                Err(error) => report.passed_over.push(PassedOver { draw, why: error.to_string() }),
            }
        }
        // A skill stays only with all its packings.
        let before =
            if index == 0 { of_this.iter().map(|(draw, _)| (*draw, Vec::new())).collect() } else { found };
        found = before
            .into_iter()
            .filter_map(|(draw, mut measured)| {
                let at = of_this.iter().position(|(other, _)| *other == draw)?;
                measured.push(of_this.swap_remove(at).1);
                Some((draw, measured))
            })
            .collect();
        wanted = found.iter().map(|(draw, _)| *draw).collect();
        if outcome.is_err() {
            report.packing_seeds.truncate(index + 1);
            break 'packings;
        }
    }
    progress.clear();
    report.skills = found
        .into_iter()
        .map(|(draw, packings)| Skill { draw, row: Row::new(skill(draw), packings) })
        .collect();
    if outcome.is_ok() && report.skills.len() < 2 {
        let tried = report.passed_over.len() + report.skills.len();
        let text = format!(
            "of {tried} skills {} could be measured: fewer than two make no table; another --first finds others",
            report.skills.len()
        );
        return Err(CliError::Failed(text));
    }
    outcome
}

fn text(report: &Report) -> String {
    let mut out = String::new();
    let seeds: Vec<String> = report.packing_seeds.iter().map(u64::to_string).collect();
    let _ = writeln!(
        out,
        "{}, {}, packings {}; m per unit of theta, differences over +-{}",
        report.scene,
        report.precision,
        seeds.join(", "),
        report.half_step
    );
    for Skill { draw, row } in &report.skills {
        let _ = writeln!(out, "\nskill {draw}: theta {}", numbers(&row.theta));
        let delivered: Vec<String> = row.packings.iter().map(|one| one.delivered.to_string()).collect();
        let _ =
            writeln!(out, "  slope      {}   {} particles arrive", numbers(&row.slope), delivered.join(", "));
        if let Some(noise) = &row.noise {
            let _ = writeln!(out, "  +-         {}", numbers(noise));
        }
        for (name, gradient) in [("exact", &row.exact), ("restarted", &row.restarted)] {
            let cosine = cosine(gradient, &row.slope);
            let _ = writeln!(out, "  {name:9}  {}   cosine {cosine:.2}", numbers(gradient));
        }
    }
    for PassedOver { draw, why } in &report.passed_over {
        let _ = writeln!(out, "\nskill {draw} is left out: {why}");
    }
    if let Some(summary) = &report.summary {
        write_summary(&mut out, summary, report.skills.len());
    }
    out
}

fn numbers(theta: &[f64; 5]) -> String {
    theta.map(|x| format!("{x:9.3}")).join(" ")
}

fn write_summary(out: &mut String, summary: &Summary, skills: usize) {
    let Summary { exact, restarted, constant, .. } = summary;
    let columns = [exact, restarted, constant];
    let mut line = |name: &str, of: &dyn Fn(&Fit) -> String| {
        let _ = write!(out, "{name:38}");
        columns.iter().for_each(|fit| {
            let _ = write!(out, "{:>20}", of(fit));
        });
        out.push('\n');
    };
    line(&format!("\nover {skills} skills"), &|fit| {
        let at = columns.iter().position(|other| std::ptr::eq(*other, fit)).unwrap_or(0);
        ["exact", "restarted", "constant direction"][at].into()
    });
    let two = |[a, b]: [f64; 2]| format!("{a:.2}, {b:.2}");
    line("cosine: median, worst", &|fit| two(fit.cosine));
    line("  without the constant direction", &|fit| fit.residual_cosine.map_or("-".into(), two));
    line("length over the slope's: median", &|fit| format!("{:.2}", fit.length[0]));
    line("  range", &|fit| format!("{:.2} to {:.2}", fit.length[1], fit.length[2]));
    for (k, (name, _)) in SKILL_PARAMETERS.iter().enumerate() {
        line(&format!("{name}: signs, correlation"), &|fit| {
            let [right, of] = fit.signs[k];
            let correlation = fit.correlation[k].map_or("-".into(), |r| format!("{r:.2}"));
            format!("{right} of {of}, {correlation}")
        });
    }
    let _ = writeln!(
        out,
        "\nBy processor time the exact gradient costs {:.1} rollouts, the restarted one {:.1}.",
        summary.exact_in_rollouts, summary.restarted_in_rollouts
    );
}
