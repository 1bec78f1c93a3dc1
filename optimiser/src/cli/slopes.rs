//! `optimise gradcheck --skills`: gradients of whole motions beside the slope that a search wants.

use super::{
    CliError, Context, Progress, Setup,
    gradcheck::GradcheckArgs,
    kept::difference,
    motion::{collision_words, parse_theta},
    options::DEFAULT_PRECISION,
};
use crate::report::folder::RunFolder;
use crate::report::words::hex;
use powderline_shared::plan::{Precision, SkillParameter};
use powderline_simulator::PHYSICS_VERSION;
use powderline_simulator::rollout::slopes::{
    Fit, HALF_STEP, LEAST_DELIVERED, Measured, Row, Summary, cosine, measure, skill,
};
use powderline_simulator::rollout::{
    Displacement, ProgressFn, RolloutError, SimulatorSettings, Workload, restart::Restarts,
};
use powderline_simulator::scene::{Aim, Scene};
use powderline_simulator::skill::{SkillMap, Theta, collision};
use serde::{Deserialize, Serialize};
use std::fmt::Write;

/// Skills that are tried at most for each one that is asked for.
const TRIES: u64 = 20;

/// The table so far, in the folder of `--out`.
const TABLE: &str = "gradcheck.json";

#[derive(Serialize, Deserialize)]
struct Report {
    #[serde(flatten)]
    of: Subject,
    /// Whether all that was asked for has been measured.
    complete: bool,
    skills: Vec<Skill>,
    passed_over: Vec<PassedOver>,
    #[serde(skip_deserializing)]
    summary: Option<Summary>,
    /// Without the skills whose differences look across the edge of the miss, if there are such.
    #[serde(skip_deserializing)]
    summary_without_edge: Option<Summary>,
}

/// What a table is of: skills that were measured otherwise do not stand in it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Subject {
    scene: String,
    scene_digest: String,
    aim: Aim,
    precision: String,
    physics: u32,
    half_step: f64,
    least_delivered: u32,
    packing_seeds: Vec<u64>,
    /// The first of the drawn skills; none if they were given.
    first: Option<u64>,
    /// Those that were given.
    #[serde(default)]
    given: Vec<Theta>,
}

#[derive(Serialize, Deserialize)]
struct Skill {
    /// Its number among the drawn ones; none of one that was given.
    draw: Option<u64>,
    #[serde(flatten)]
    row: Row,
}

/// A skill that says nothing of gradients.
#[derive(Serialize, Deserialize)]
struct PassedOver {
    draw: Option<u64>,
    theta: Theta,
    why: String,
}

/// Which skill.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Asked {
    draw: Option<u64>,
    theta: Theta,
}

/// What comes of a skill: what was measured of it, or why nothing was.
type Outcome<T> = Result<T, String>;

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
    let setup = arguments.resources.setup(seed, precision);
    let (count, asked) = asked(arguments)?;
    setup.check_memory(scene, Workload::Gradient, 0)?;
    let of = Subject {
        scene: scene.name.clone(),
        scene_digest: hex(&scene.digest()),
        aim: scene.objective.aim,
        precision: precision.name().into(),
        physics: PHYSICS_VERSION,
        half_step: HALF_STEP,
        least_delivered: LEAST_DELIVERED,
        packing_seeds: (0..arguments.packings).map(|k| seed.wrapping_add(k.into())).collect(),
        first: arguments.skills.map(|_| arguments.first),
        given: asked.iter().filter(|asked| asked.draw.is_none()).map(|asked| asked.theta).collect(),
    };
    let folder = arguments.out.as_deref().map(RunFolder::take).transpose()?;
    let mut table = Table { report: begun(of, folder.as_ref())?, folder, json: arguments.json };
    let bench = Bench { scene, map: SkillMap::new(scene), setup };
    table.begin(context)?;
    let finished = fill(&mut table, count, &asked, context, &mut |skill, seed, watch| {
        bench.outcome(&skill.theta, seed, watch)
    });
    // What took so long is shown, even if it ended early.
    let shown = table.end(finished.is_ok(), context);
    finished.map_err(|error| match (&error, &table.folder) {
        (CliError::Interrupted(_), Some(_)) => error
            .with_remark("the skills that were measured are saved, and the same command goes on from there"),
        _ => error,
    })?;
    shown
}

/// What a table that was begun in the folder has, if it is of the same.
fn begun(of: Subject, folder: Option<&RunFolder>) -> Result<Report, CliError> {
    let empty = |of| Report {
        of,
        complete: false,
        skills: Vec::new(),
        passed_over: Vec::new(),
        summary: None,
        summary_without_edge: None,
    };
    let Some(folder) = folder.filter(|folder| folder.file(TABLE).exists()) else { return Ok(empty(of)) };
    let file = folder.file(TABLE).display().to_string();
    let report: Report = serde_json::from_slice(&folder.read(TABLE)?)
        .map_err(|error| CliError::Input(format!("{file} is no table of gradcheck: {error}")))?;
    if let Some((field, [found, asked])) = difference(&report.of, &of) {
        return Err(CliError::Input(format!(
            "{file} was begun with {field} {found}, and {asked} is asked for; another --out begins a new table"
        )));
    }
    if report.skills.iter().any(|skill| skill.row.packings.len() != of.packing_seeds.len()) {
        return Err(CliError::Input(format!(
            "{file} is no table of gradcheck: a skill has not all of its {} packings",
            of.packing_seeds.len()
        )));
    }
    Ok(report)
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
        if theta.components().iter().any(|x| x.abs() > 1.0 - HALF_STEP) {
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

/// A skill with the packing of a seed.
type MeasureFn<'a> = &'a mut dyn FnMut(&Asked, u64, ProgressFn) -> Result<Outcome<Measured>, CliError>;

/// Measures skill after skill, each with all packings, until there are `count` in the table.
fn fill(
    table: &mut Table,
    count: usize,
    asked: &[Asked],
    context: &mut Context<'_>,
    measure: MeasureFn<'_>,
) -> Result<(), CliError> {
    for skill in asked {
        if table.report.skills.len() >= count {
            break;
        }
        if table.has(skill) {
            continue;
        }
        let outcome = packings(table, skill, context, measure)?;
        table.push(*skill, outcome, context)?;
    }
    let (measured, passed_over) = (table.report.skills.len(), table.report.passed_over.len());
    if measured >= count {
        return Ok(());
    }
    let others = asked.iter().any(|skill| skill.draw.is_some()).then_some("; another --first finds others");
    Err(CliError::Failed(format!(
        "of {} skills {measured} could be measured, and {count} are asked for{}",
        measured + passed_over,
        others.unwrap_or_default()
    )))
}

/// One skill with all packings, up to the first that says nothing of it.
fn packings(
    table: &Table,
    skill: &Asked,
    context: &mut Context<'_>,
    measure: MeasureFn<'_>,
) -> Result<Outcome<Vec<Measured>>, CliError> {
    let progress = Progress::new(&context.err, context.live);
    let (seeds, row) = (&table.report.of.packing_seeds, table.report.skills.len() + 1);
    let mut all = Vec::new();
    for (seed, number) in seeds.iter().zip(1..) {
        progress.begin(&format!("skill {row}, packing {number} of {}", seeds.len()), 0, &[]);
        match measure(skill, *seed, progress.watch(&context.interrupt)) {
            Ok(Ok(measured)) => all.push(measured),
            other => {
                progress.clear();
                return other.map(|outcome| outcome.map(|_| all));
            }
        }
    }
    progress.clear();
    Ok(Ok(all))
}

/// What measures skills.
struct Bench<'a> {
    scene: &'a Scene,
    map: SkillMap,
    setup: Setup,
}

impl Bench<'_> {
    /// Measures one skill, if an arm may perform it and it delivers something. With a simulator of its own, so that one at a time
    /// takes memory.
    fn outcome(&self, theta: &Theta, seed: u64, watch: ProgressFn) -> Result<Outcome<Measured>, CliError> {
        let controls: Vec<Displacement> = match self.map.controls(theta) {
            Ok(controls) => controls,
            Err(error) => return Ok(Err(error.to_string())),
        };
        if let Some(collision) = collision(self.scene, self.map.start_pose(), &controls) {
            return Ok(Err(collision_words(&collision)));
        }
        let settings = SimulatorSettings { seed: Some(seed), ..self.setup.settings };
        let mut simulator = Setup { settings, ..self.setup }.simulator(self.scene)?;
        simulator.set_progress(watch);
        let restarts = Restarts::of_skill(self.scene, &self.map, theta);
        match measure(simulator.as_mut(), theta, &restarts) {
            Ok(Some(measured)) => Ok(Ok(measured)),
            Ok(None) => Ok(Err(format!("delivers fewer than {LEAST_DELIVERED} particles"))),
            Err(
                error @ (RolloutError::Stopped | RolloutError::Threads { .. } | RolloutError::Memory { .. }),
            ) => Err(CliError::from(error)),
            Err(error) => Ok(Err(error.to_string())),
        }
    }
}

/// What has been measured, on the terminal and in the folder as it comes.
struct Table {
    report: Report,
    folder: Option<RunFolder>,
    json: bool,
}

impl Table {
    /// Whether a skill was tried before.
    fn has(&self, asked: &Asked) -> bool {
        let bits = |theta: &Theta| theta.components().map(f64::to_bits);
        let Report { skills, passed_over, .. } = &self.report;
        let mut tried =
            skills.iter().map(|skill| &skill.row.theta).chain(passed_over.iter().map(|skill| &skill.theta));
        tried.any(|theta| bits(theta) == bits(&asked.theta))
    }

    /// Shows what is there so far.
    fn begin(&self, context: &mut Context<'_>) -> Result<(), CliError> {
        self.show(&self.report.of.text(), context)?;
        self.report.skills.iter().try_for_each(|skill| self.show(&skill.text(), context))
    }

    fn push(
        &mut self,
        Asked { draw, theta }: Asked,
        outcome: Outcome<Vec<Measured>>,
        context: &mut Context<'_>,
    ) -> Result<(), CliError> {
        match outcome {
            Ok(packings) => {
                let skill = Skill { draw, row: Row::new(theta, packings) };
                self.show(&skill.text(), context)?;
                self.report.skills.push(skill);
            }
            Err(why) => self.report.passed_over.push(PassedOver { draw, theta, why }),
        }
        self.save()
    }

    /// What was left out and the summary, or all as JSON.
    fn end(&mut self, complete: bool, context: &mut Context<'_>) -> Result<(), CliError> {
        let Report { of, skills, .. } = &self.report;
        let rows: Vec<Row> = skills.iter().map(|skill| skill.row.clone()).collect();
        let level: Vec<Row> = rows.iter().filter(|row| !row.across_edge).cloned().collect();
        let has_edge = of.aim == Aim::Amount && level.len() < rows.len();
        self.report.summary = Summary::new(&rows);
        self.report.summary_without_edge = if has_edge { Summary::new(&level) } else { None };
        self.report.complete = complete;
        if self.json {
            context.json(&self.report)?;
            return self.save();
        }
        let mut out: String = self.report.passed_over.iter().map(PassedOver::text).collect();
        if let Some(summary) = &self.report.summary {
            write_summary(&mut out, summary, &format!("over {} skills", rows.len()));
            let _ = writeln!(
                out,
                "\nBy processor time the exact gradient costs {:.1} rollouts, the restarted one {:.1}.",
                summary.exact_in_rollouts, summary.restarted_in_rollouts
            );
        }
        if let Some(summary) = &self.report.summary_without_edge {
            let _ = writeln!(
                out,
                "\nOf these, differences of {} look across the edge of the miss: from too much to too little. Without them:",
                rows.len() - level.len()
            );
            write_summary(&mut out, summary, &format!("over {} skills", level.len()));
        }
        self.show(&out, context)?;
        self.save()
    }

    fn show(&self, text: &str, context: &mut Context<'_>) -> Result<(), CliError> {
        if !self.json {
            write!(context.out, "{text}")?;
            context.out.flush()?;
        }
        Ok(())
    }

    fn save(&self) -> Result<(), CliError> {
        let Some(folder) = &self.folder else { return Ok(()) };
        let text = serde_json::to_vec(&self.report).map_err(std::io::Error::from)?;
        Ok(folder.replace(TABLE, &text)?)
    }
}

impl Subject {
    fn text(&self) -> String {
        let seeds: Vec<String> = self.packing_seeds.iter().map(u64::to_string).collect();
        format!(
            "{}, {}, packings {}; m per unit of theta, differences over +-{}\n",
            self.scene,
            self.precision,
            seeds.join(", "),
            self.half_step
        )
    }
}

impl PassedOver {
    fn text(&self) -> String {
        format!("\n{} is left out: {}\n", name(self.draw), self.why)
    }
}

impl Skill {
    fn text(&self) -> String {
        let (mut out, row) = (String::new(), &self.row);
        let _ = writeln!(out, "\n{}: theta {}", name(self.draw), numbers(&row.theta.components()));
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
        out
    }
}

fn name(draw: Option<u64>) -> String {
    draw.map_or("a given skill".into(), |draw| format!("skill {draw}"))
}

fn numbers(theta: &[f64; 5]) -> String {
    theta.map(|x| format!("{x:9.3}")).join(" ")
}

fn write_summary(out: &mut String, summary: &Summary, over: &str) {
    let columns = [
        ("exact", &summary.exact),
        ("restarted", &summary.restarted),
        ("constant direction", &summary.constant),
    ];
    let _ = write!(out, "\n{over:37}");
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
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cli::Stream;

    fn measured(across_edge: bool) -> Measured {
        let one = [1.0; 5];
        serde_json::from_value(serde_json::json!({
            "delivered": 50, "across_edge": across_edge, "slope": one, "exact": one, "restarted": one,
            "seconds": { "rollout": 1.0, "exact": 8.0, "restarted": 6.0 }
        }))
        .unwrap()
    }

    fn subject() -> Subject {
        Subject {
            scene: "bench".into(),
            scene_digest: "00".into(),
            aim: Aim::Amount,
            precision: "f32".into(),
            physics: PHYSICS_VERSION,
            half_step: HALF_STEP,
            least_delivered: LEAST_DELIVERED,
            packing_seeds: vec![1, 2],
            first: Some(0),
            given: Vec::new(),
        }
    }

    fn skills(count: u64) -> Vec<Asked> {
        (0..count).map(|draw| Asked { draw: Some(draw), theta: skill(draw) }).collect()
    }

    /// Fills a table of three out of nine, in which odd draws deliver, 3 only with the first packing; 5 is at the edge of the miss. `left` measurements succeed, and the
    /// next one is stopped.
    fn filled(folder: &std::path::Path, subject: Subject, left: u32) -> (Result<Table, CliError>, String) {
        filled_up_to(3, folder, subject, left)
    }

    fn filled_up_to(
        wanted: usize,
        folder: &std::path::Path,
        subject: Subject,
        left: u32,
    ) -> (Result<Table, CliError>, String) {
        let (mut out, mut left) = (Vec::new(), left);
        let mut context = Context {
            factory: &|_, _| unreachable!(),
            interrupt: super::super::Interrupt::default(),
            out: &mut out,
            err: Stream::new(std::io::sink()),
            live: false,
        };
        let mut measure = |asked: &Asked, seed: u64, _: ProgressFn| {
            if left == 0 {
                return Err(CliError::from(RolloutError::Stopped));
            }
            left -= 1;
            Ok(match asked.draw {
                Some(draw) if draw % 2 == 1 && (draw, seed) != (3, 2) => Ok(measured(draw == 5)),
                _ => Err("delivers too little".into()),
            })
        };
        let folder = RunFolder::take(folder).unwrap();
        let table = begun(subject, Some(&folder)).and_then(|report| {
            let mut table = Table { report, folder: Some(folder), json: false };
            table.begin(&mut context)?;
            fill(&mut table, wanted, &skills(9), &mut context, &mut measure)?;
            table.end(true, &mut context)?;
            Ok(table)
        });
        (table, String::from_utf8(out).unwrap())
    }

    fn draws(report: &Report) -> Vec<u64> {
        report.skills.iter().filter_map(|skill| skill.draw).collect()
    }

    /// One that delivers too little with the second packing makes room for another.
    #[test]
    fn a_table_has_as_many_skills_as_asked_for() {
        let place = tempfile::tempdir().unwrap();
        let (table, out) = filled(place.path(), subject(), 99);
        let table = table.unwrap();
        assert_eq!(draws(&table.report), [1, 5, 7]);
        assert_eq!(table.report.passed_over.len(), 5);
        assert!(table.report.skills.iter().all(|skill| skill.row.packings.len() == 2));
        assert!(out.contains("skill 3 is left out") && out.contains("over 3 skills"), "{out}");
        // One looks across the edge of the miss, of which there is none where all powder is wanted.
        assert!(out.contains("differences of 1 look across") && out.contains("over 2 skills"), "{out}");
        let place = tempfile::tempdir().unwrap();
        let (_, out) = filled(place.path(), Subject { aim: Aim::All, ..subject() }, 99);
        assert!(out.contains("over 3 skills") && !out.contains("look across"), "{out}");
    }

    /// Three of nine deliver.
    #[test]
    fn a_table_of_fewer_skills_than_asked_for_says_so() {
        let place = tempfile::tempdir().unwrap();
        let (table, _) = filled_up_to(4, place.path(), subject(), 99);
        let error = table.err().unwrap().to_string();
        let wanted = "of 9 skills 3 could be measured, and 4 are asked for; another --first finds others";
        assert_eq!(error, wanted);
    }

    /// Stopped, it goes on from where it was, to the same table; each skill is shown when it is done.
    #[test]
    fn a_table_that_was_stopped_goes_on() {
        let place = tempfile::tempdir().unwrap();
        let (stopped, out) = filled(place.path(), subject(), 4);
        assert!(stopped.is_err() && out.contains("skill 1: theta") && !out.contains("median"), "{out}");
        let (table, out) = filled(place.path(), subject(), 8);
        assert_eq!(draws(&table.unwrap().report), [1, 5, 7]);
        let at_once = tempfile::tempdir().unwrap();
        assert_eq!(out, filled(at_once.path(), subject(), 99).1);
        // Nothing is left to be done.
        assert_eq!(filled(place.path(), subject(), 0).1, out);
    }

    #[test]
    fn a_table_of_something_else_is_not_gone_on_with() {
        let place = tempfile::tempdir().unwrap();
        filled(place.path(), subject(), 99).0.unwrap();
        let other = Subject { packing_seeds: vec![1, 3], ..subject() };
        let error = filled(place.path(), other, 0).0.err().unwrap().to_string();
        assert!(error.contains("packing_seeds [1,2], and [1,3] is asked for"), "{error}");
        // Nor one of other skills that were given.
        let other = Subject { given: vec![Theta::MIDDLE], ..subject() };
        let error = filled(place.path(), other, 0).0.err().unwrap().to_string();
        assert!(error.contains("given []"), "{error}");
        std::fs::write(place.path().join(TABLE), "{}").unwrap();
        let error = filled(place.path(), subject(), 0).0.err().unwrap().to_string();
        assert!(error.contains("gradcheck.json is no table of gradcheck: missing field"), "{error}");
    }
}
