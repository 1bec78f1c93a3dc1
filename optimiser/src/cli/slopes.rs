//! `optimise gradcheck --skills`: gradients of whole motions beside the slope that a search wants.

use super::{
    CliError, Context, Progress,
    gradcheck::GradcheckArgs,
    motion::{collision_words, parse_theta},
    options::DEFAULT_PRECISION,
};
use crate::report::words::precision_name;
use powderline_shared::plan::{Precision, SkillParameter};
use powderline_simulator::rollout::slopes::{
    Fit, HALF_STEP, LEAST_DELIVERED, Measured, Row, Summary, cosine, measure, skill,
};
use powderline_simulator::rollout::{
    Displacement, ParticleSimulator, RolloutError, SimulatorSettings, Workload, boxed_simulator,
    check_memory, restart::Restarts,
};
use powderline_simulator::scene::{Aim, Scene};
use powderline_simulator::skill::{SkillMap, Theta, collision};
use serde::Serialize;
use std::fmt::Write;

/// Skills that are tried at most for each one that is asked for.
const TRIES: u64 = 20;

#[derive(Serialize)]
struct Report {
    scene: String,
    aim: Aim,
    precision: &'static str,
    half_step: f64,
    least_delivered: u32,
    packing_seeds: Vec<u64>,
    /// Whether all that was asked for has been measured.
    complete: bool,
    skills: Vec<Skill>,
    passed_over: Vec<PassedOver>,
    summary: Option<Summary>,
}

#[derive(Serialize)]
struct Skill {
    #[serde(flatten)]
    asked: Asked,
    #[serde(flatten)]
    row: Row,
}

/// A skill that says nothing of gradients.
#[derive(Serialize)]
struct PassedOver {
    #[serde(flatten)]
    asked: Asked,
    why: String,
}

/// Which skill.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
struct Asked {
    /// Its number among the drawn ones; none of one that was given.
    draw: Option<u64>,
    #[serde(skip)]
    theta: Theta,
}

/// A skill with what has been measured of it.
struct Found {
    asked: Asked,
    packings: Vec<Measured>,
}

/// What `measure` says of a skill.
enum Outcome {
    Measured(Measured),
    PassedOver(String),
}

/// Runs the command.
///
/// # Errors
/// One sentence.
pub(super) fn execute(
    arguments: &GradcheckArgs,
    scene: &Scene,
    context: &mut Context<'_>,
) -> Result<(), CliError> {
    let precision = arguments.precision.map_or(DEFAULT_PRECISION, Precision::from);
    let seed = arguments.seed.unwrap_or(scene.powder.seed);
    let settings = arguments.resources.settings(seed, precision);
    let (count, asked) = asked(arguments)?;
    check_memory(scene, &settings, Workload::Gradient, 0)?;
    let mut report = Report {
        scene: scene.name.clone(),
        aim: scene.objective.aim,
        precision: precision_name(precision),
        half_step: HALF_STEP,
        least_delivered: LEAST_DELIVERED,
        packing_seeds: (0..arguments.packings).map(|k| seed.wrapping_add(k.into())).collect(),
        complete: false,
        skills: Vec::new(),
        passed_over: Vec::new(),
        summary: None,
    };
    let finished = fill(&mut report, count, asked, scene, &settings, context);
    report.complete = finished.is_ok();
    let rows: Vec<Row> = report.skills.iter().map(|skill| skill.row.clone()).collect();
    report.summary = Summary::new(&rows);
    // What took so long is shown, even if it ended early.
    if arguments.json {
        context.json(&report)?;
    } else {
        write!(context.out, "{}", text(&report))?;
    }
    finished
}

/// How many skills are wanted, and which are tried for that.
fn asked(arguments: &GradcheckArgs) -> Result<(usize, Vec<Asked>), CliError> {
    if let Some(skills) = arguments.skills {
        let draws = arguments.first..arguments.first + TRIES * u64::from(skills);
        let drawn = draws.map(|draw| Asked { draw: Some(draw), theta: skill(draw) });
        return Ok((skills as usize, drawn.collect()));
    }
    let given = |text: &String| {
        let theta = parse_theta(text)?;
        if theta.iter().any(|x| x.abs() > 1.0 - HALF_STEP) {
            let most = 1.0 - HALF_STEP;
            return Err(CliError::Input(format!(
                "--theta is `{text}`: numbers from -{most} to {most} would leave room for differences over +-{HALF_STEP}"
            )));
        }
        Ok(Asked { draw: None, theta })
    };
    let all = arguments.theta.iter().map(given).collect::<Result<Vec<_>, _>>()?;
    Ok((all.len(), all))
}

/// Measures packing after packing, so that one simulator at a time takes memory. The first packing finds the skills; one stays only
/// with all its packings, unless the time does not suffice for them.
fn fill(
    report: &mut Report,
    count: usize,
    asked: Vec<Asked>,
    scene: &Scene,
    settings: &SimulatorSettings,
    context: &mut Context<'_>,
) -> Result<(), CliError> {
    let interrupt = context.interrupt.clone();
    let mut progress = Progress::new(context.err, context.live);
    let map = SkillMap::new(scene);
    let packings = report.packing_seeds.clone();
    let mut found: Vec<Found> =
        asked.into_iter().map(|asked| Found { asked, packings: Vec::new() }).collect();
    let mut finished = Ok(());
    for (seed, number) in packings.iter().zip(1..) {
        let mut simulator = boxed_simulator(scene, &SimulatorSettings { seed: *seed, ..*settings })?;
        let mut skills = 0;
        let of_this = next_packing(&mut found, count, &mut report.passed_over, &mut |asked: &Asked| {
            skills += 1;
            progress.begin(&format!("skill {skills}, packing {number} of {}", packings.len()), 0, &[]);
            let mut tick = |done, total| {
                progress.tick(done, total);
                !interrupt.is_requested()
            };
            outcome(simulator.as_mut(), scene, &map, &asked.theta, &mut tick)
        });
        if of_this.is_err() {
            report.packing_seeds.truncate(number);
            finished = of_this;
            break;
        }
    }
    progress.clear();
    let row = |found: Found| Skill { asked: found.asked, row: Row::new(found.asked.theta, found.packings) };
    report.skills = found.into_iter().map(row).collect();
    let measured = report.skills.len();
    if finished.is_ok() && (measured == 0 || count > 1 && measured < 2) {
        let tried = report.passed_over.len() + measured;
        return Err(CliError::Failed(format!(
            "of {tried} skills {measured} could be measured: fewer than two make no table; another --first finds others"
        )));
    }
    finished
}

/// Measures skills with one more packing, until there are `count`, and leaves those in `found` that it has. If `measure` fails,
/// those that have any packing stay.
fn next_packing(
    found: &mut Vec<Found>,
    count: usize,
    passed_over: &mut Vec<PassedOver>,
    measure: &mut dyn FnMut(&Asked) -> Result<Outcome, CliError>,
) -> Result<(), CliError> {
    let mut to_come = std::mem::take(found).into_iter();
    while found.len() < count
        && let Some(mut skill) = to_come.next()
    {
        match measure(&skill.asked) {
            Ok(Outcome::Measured(measured)) => {
                skill.packings.push(measured);
                found.push(skill);
            }
            Ok(Outcome::PassedOver(why)) => passed_over.push(PassedOver { asked: skill.asked, why }),
            Err(error) => {
                let rest = std::iter::once(skill).chain(to_come);
                found.extend(rest.filter(|skill| !skill.packings.is_empty()));
                return Err(error);
            }
        }
    }
    Ok(())
}

/// Measures one skill, if an arm may perform it and it delivers something.
fn outcome(
    simulator: &mut dyn ParticleSimulator,
    scene: &Scene,
    map: &SkillMap,
    theta: &Theta,
    tick: powderline_simulator::rollout::Progress<'_>,
) -> Result<Outcome, CliError> {
    let controls: Vec<Displacement> = match map.controls(theta) {
        Ok(controls) => controls,
        Err(error) => return Ok(Outcome::PassedOver(error.to_string())),
    };
    if let Some(collision) = collision(scene, map.start_pose(), &controls) {
        return Ok(Outcome::PassedOver(collision_words(&collision)));
    }
    match measure(simulator, theta, &Restarts::of_skill(scene, map, theta), tick) {
        Ok(Some(measured)) => Ok(Outcome::Measured(measured)),
        Ok(None) => Ok(Outcome::PassedOver(format!("delivers fewer than {LEAST_DELIVERED} particles"))),
        Err(error @ (RolloutError::Stopped | RolloutError::Threads { .. } | RolloutError::Memory { .. })) => {
            Err(CliError::from(error))
        }
        Err(error) => Ok(Outcome::PassedOver(error.to_string())),
    }
}

impl Asked {
    fn name(&self) -> String {
        self.draw.map_or("a given skill".into(), |draw| format!("skill {draw}"))
    }
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
    for Skill { asked, row } in &report.skills {
        let _ = writeln!(out, "\n{}: theta {}", asked.name(), numbers(&row.theta));
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
    for PassedOver { asked, why } in &report.passed_over {
        let _ = writeln!(out, "\n{} is left out: {why}", asked.name());
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
    let columns = [
        ("exact", &summary.exact),
        ("restarted", &summary.restarted),
        ("constant direction", &summary.constant),
    ];
    let _ = write!(out, "\n{:37}", format!("over {skills} skills"));
    columns.iter().for_each(|(name, _)| out.push_str(&format!("{name:>20}")));
    out.push('\n');
    let mut line = |name: &str, of: &dyn Fn(&Fit) -> String| {
        let _ = write!(out, "{name:38}");
        columns.iter().for_each(|(_, fit)| {
            let _ = write!(out, "{:>20}", of(fit));
        });
        out.push('\n');
    };
    let two = |[a, b]: [f64; 2]| format!("{a:.2}, {b:.2}");
    line("cosine: median, worst", &|fit| two(fit.cosine));
    line("  without the constant direction", &|fit| fit.residual_cosine.map_or("-".into(), two));
    line("length over the slope's: median", &|fit| format!("{:.2}", fit.length[0]));
    line("  range", &|fit| format!("{:.2} to {:.2}", fit.length[1], fit.length[2]));
    for parameter in SkillParameter::ALL {
        line(&format!("{}: signs, correlation", parameter.name()), &|fit| {
            let [right, of] = fit.signs[parameter.index()];
            let correlation = fit.correlation[parameter.index()].map_or("-".into(), |r| format!("{r:.2}"));
            format!("{right} of {of}, {correlation}")
        });
    }
    let _ = writeln!(
        out,
        "\nBy processor time the exact gradient costs {:.1} rollouts, the restarted one {:.1}.",
        summary.exact_in_rollouts, summary.restarted_in_rollouts
    );
}

#[cfg(test)]
mod tests {
    use super::*;

    fn measured() -> Measured {
        let one = [1.0; 5];
        serde_json::from_value(serde_json::json!({
            "delivered": 50, "slope": one, "exact": one, "restarted": one,
            "seconds": { "rollout": 1.0, "exact": 8.0, "restarted": 6.0 }
        }))
        .unwrap()
    }

    fn skills(count: u64) -> Vec<Found> {
        (0..count)
            .map(|draw| Found { asked: Asked { draw: Some(draw), theta: skill(draw) }, packings: Vec::new() })
            .collect()
    }

    /// Ctrl-C in the second packing: what has been measured stays, with as many packings as there are.
    #[test]
    fn what_was_measured_before_a_stop_stays() {
        let (mut found, mut passed_over) = (skills(9), Vec::new());
        let mut odd = |asked: &Asked| {
            Ok(match asked.draw {
                Some(draw) if draw % 2 == 1 => Outcome::Measured(measured()),
                _ => Outcome::PassedOver("even".into()),
            })
        };
        next_packing(&mut found, 3, &mut passed_over, &mut odd).unwrap();
        let draws = |found: &[Found]| found.iter().map(|found| found.asked.draw.unwrap()).collect::<Vec<_>>();
        assert_eq!(draws(&found), [1, 3, 5]);
        assert_eq!(passed_over.len(), 3);
        let mut left = 1;
        let stopped = next_packing(&mut found, 3, &mut passed_over, &mut |_| {
            left -= 1;
            if left < 0 {
                Err(CliError::from(RolloutError::Stopped))
            } else {
                Ok(Outcome::Measured(measured()))
            }
        });
        assert!(stopped.is_err());
        assert_eq!(draws(&found), [1, 3, 5]);
        assert_eq!(found.iter().map(|found| found.packings.len()).collect::<Vec<_>>(), [2, 1, 1]);
    }

    /// Stopped while the first packing looks for skills: what has not been tried is no skill.
    #[test]
    fn what_was_not_measured_before_a_stop_goes() {
        let (mut found, mut passed_over) = (skills(4), Vec::new());
        let mut left = 2;
        let stopped = next_packing(&mut found, 4, &mut passed_over, &mut |_| {
            left -= 1;
            if left < 0 {
                Err(CliError::from(RolloutError::Stopped))
            } else {
                Ok(Outcome::Measured(measured()))
            }
        });
        assert!(stopped.is_err() && found.len() == 2 && passed_over.is_empty());
    }
}
