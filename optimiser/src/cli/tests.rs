//! The commands end to end, with a stand-in for the simulator that only looks at where the motion ends.

use super::*;
use crate::{
    optim::EpochRecord,
    report::folder::{CURVES, METRICS, PLAN, RunFolder, SCENE, STATE, TRIES},
    report::words::{grouped, hex},
};
use powderline_shared::{
    displacement::{Displacement, pose_at},
    plan::PlanReader,
    pose::Pose,
    trajectory::{Sample, TrajectoryHeader},
};
use powderline_simulator::{
    rollout::{
        Census, CostsFn, DisplacementGradient, Evaluation, LossFn, Observer, Recording, RolloutError,
        Snapshot, Watch,
        restart::{Restarted, Restarts},
    },
    scene::{Amount, ContainerShape, Quantity},
    skill::{Control, SkillMap, Theta, ThetaGradient},
};
use powderline_view::Destination;
use serde_json::Value;
use std::{
    cell::Cell,
    fs,
    path::{Path, PathBuf},
    rc::Rc,
    sync::{Arc, Mutex},
};

mod commands;
mod compare;
mod export;
mod motion;
mod pages;
mod path;
mod refine;
mod shorten;
mod validate;

/// Exit code of a run whose plan misses the wanted amount, as after few epochs with this stand-in.
const MISSED: u8 = 3;

/// Name of a scene whose powder escapes from the branches of some restarted adjoints.
const LEAKY: &str = "leaky";
/// What arrives on cells of half the size over what arrives on the scene's own, with this stand-in.
const ON_FINER_CELLS: f64 = 0.8;

/// What arrives over what arrives in the packings of the first seeds, with this stand-in.
fn share_in_packing(seed: u64) -> f64 {
    1.0 - 0.02 * seed.saturating_sub(4).min(20) as f64
}

/// Speed at which the tool turns that is too much for the powder on it, with this stand-in, rad/s.
const TOO_FAST_RAD_S: f64 = 4.28;

/// Ticks of one evaluation.
const TICKS: u64 = 3;

/// Loss: squared distance of the motion's end from a wished one. The gradient is wrong in depth, as if a grain had
/// balanced on the rim.
struct Ends {
    map: SkillMap,
    interrupt: Interrupt,
    /// Ticks left until Ctrl-C.
    patience: Rc<Cell<u64>>,
    /// How many motions in whole counts bring nothing yet.
    spoilt: Cell<u32>,
    /// Mass of a particle over that of a scene as it comes, with eight to a cell of 4 mm.
    heavier: f64,
    /// What arrives over what arrives on cells of 4 mm.
    share: f64,
    /// Whether powder escapes from the branches of some restarted adjoints.
    leaks: bool,
    watch: Watch,
}

impl Ends {
    const WISH: Control = [0.09, 0.0, 0.01, 0.0, 1.3, 0.0];

    fn of_one_grain(theta: &Theta) -> f64 {
        libm::sin(1e6 * theta.components()[0])
    }

    fn tick(&mut self) -> Result<(), RolloutError> {
        for done in 1..=TICKS {
            self.patience.set(self.patience.get().saturating_sub(1));
            if self.patience.get() == 0 {
                self.interrupt.request();
            }
            self.watch.check(done, TICKS)?;
        }
        Ok(())
    }

    fn judge(&self, controls: impl Iterator<Item = Control>) -> (Evaluation, Control) {
        let mut fastest: f64 = 0.0;
        let end = controls.fold([0.0; 6], |sum, control| {
            fastest = fastest.max(control[4].abs());
            std::array::from_fn(|k| sum[k] + control[k])
        });
        let spilled = if fastest > TOO_FAST_RAD_S * 0.01 { 70 } else { 7 };
        let error: Control = std::array::from_fn(|k| end[k] - Self::WISH[k]);
        let loss = 1.0 + error.iter().map(|x| x * x).sum::<f64>();
        let transported = (200.0 * self.share / loss / self.heavier) as u32;
        let indicator = 200 - i64::from(transported);
        let census = Census { target: transported, spilled, ..Census::default() };
        (Evaluation::new(loss / self.heavier, indicator, census), error.map(|x| 2.0 * x / self.heavier))
    }
}

impl Simulate for Ends {
    fn watch(&mut self) -> &mut Watch {
        &mut self.watch
    }

    fn evaluate(&mut self, theta: &Theta) -> Result<Evaluation, RolloutError> {
        Ok(self.evaluate_with_gradient(theta)?.0)
    }

    fn evaluate_with_gradient(&mut self, theta: &Theta) -> Result<(Evaluation, ThetaGradient), RolloutError> {
        self.tick()?;
        let at = self.map.linearise(theta)?;
        let (evaluation, bar) = self.judge(at.controls.iter().map(Displacement::components));
        let mut slope = at.pull_back(&vec![DisplacementGradient::from(bar); at.controls.len()]);
        slope[0] += Self::of_one_grain(theta);
        Ok((evaluation, slope))
    }

    fn simulate(&mut self, controls: &[Displacement]) -> Result<Evaluation, RolloutError> {
        let anchor = *self.map.start_pose();
        let mut evaluation = self.simulate_from(&anchor, controls)?;
        if let Some(left) = self.spoilt.get().checked_sub(1) {
            self.spoilt.set(left);
            evaluation.census.target = 0;
        }
        Ok(evaluation)
    }

    /// Not in whole counts, as far as this bench can tell.
    fn simulate_all(&mut self, motions: &[Vec<Displacement>]) -> Result<Vec<Evaluation>, RolloutError> {
        let anchor = *self.map.start_pose();
        motions.iter().map(|controls| self.simulate_from(&anchor, controls)).collect()
    }

    /// Powder leaves where the pitch comes too close to what is wished.
    fn simulate_with_gradient(
        &mut self,
        controls: &[Displacement],
    ) -> Result<(Evaluation, Vec<DisplacementGradient>), RolloutError> {
        self.tick()?;
        let (evaluation, bar) = self.judge(controls.iter().map(Displacement::components));
        if bar[4].abs() < 0.1 {
            return Err(RolloutError::Escaped { step: 1, substep: 2, particle: 3 });
        }
        Ok((evaluation, vec![DisplacementGradient::from(bar); controls.len()]))
    }

    fn simulate_from(
        &mut self,
        anchor: &Pose,
        controls: &[Displacement],
    ) -> Result<Evaluation, RolloutError> {
        self.tick()?;
        let controls = controls.iter().map(Displacement::components);
        let offset = self.map.start_pose().displacement_to(anchor);
        // Added last: an anchor at the start pose changes no bit.
        Ok(self.judge(controls.chain([offset.components()])).0)
    }

    /// Two particles: one that stays, one that goes with the tool.
    fn record(
        &mut self,
        take: &Recording<'_>,
        look: Observer<'_>,
    ) -> Result<(Evaluation, Vec<Destination>), RolloutError> {
        let mut tool = *take.anchor;
        for step in 0..=take.controls.len() {
            if step.is_multiple_of(take.every) {
                let carried = tool.position_m.map(|x| x as f32).into();
                let positions_m = [[0.05, 0.06, 0.01], carried];
                let velocities_m_s = &[[0.0; 3]; 2];
                if look(&Snapshot { step, tool, positions_m: &positions_m, velocities_m_s }).is_break() {
                    return Err(RolloutError::Stopped);
                }
            }
            tool = take.controls.get(step).map_or(tool, |control| tool.displaced(control));
        }
        let evaluation = self.simulate_from(take.anchor, take.controls)?;
        Ok((evaluation, vec![Destination::Source, Destination::Tool]))
    }

    /// No grain balances on the rim.
    fn evaluate_restarted(&mut self, theta: &Theta, restarts: &Restarts) -> Result<Restarted, RolloutError> {
        assert!(!restarts.steps.is_empty());
        let (evaluation, mut gradient) = self.evaluate_with_gradient(theta)?;
        gradient[0] -= Self::of_one_grain(theta);
        Ok(Restarted::new(evaluation, gradient))
    }

    fn simulate_restarted(
        &mut self,
        controls: &[Displacement],
        restarts: &Restarts,
    ) -> Result<(Evaluation, Vec<DisplacementGradient>), RolloutError> {
        assert!(!restarts.steps.is_empty());
        self.tick()?;
        let (evaluation, bar) = self.judge(controls.iter().map(Displacement::components));
        if self.leaks && (1e6 * evaluation.loss) as u64 % 2 == 1 {
            return Err(RolloutError::Escaped { step: 1, substep: 2, particle: 3 });
        }
        Ok((evaluation, vec![DisplacementGradient::from(bar); controls.len()]))
    }

    fn gradient_of_custom_loss(
        &mut self,
        _: &[Displacement],
        _: LossFn<'_>,
    ) -> Result<(f64, Vec<DisplacementGradient>), RolloutError> {
        unreachable!("no command asks for it")
    }

    fn restarted_gradient_of_custom_loss(
        &mut self,
        _: &[Displacement],
        _: CostsFn<'_>,
        _: &Restarts,
    ) -> Result<(f64, Vec<DisplacementGradient>), RolloutError> {
        unreachable!("no command asks for it")
    }

    fn final_positions_m(&mut self, _: &[Displacement]) -> Result<Vec<[f64; 3]>, RolloutError> {
        unreachable!("no command asks for it")
    }
}

/// Where standard error goes.
type Buffer = Arc<Mutex<Vec<u8>>>;

fn read(buffer: &Buffer) -> String {
    String::from_utf8(buffer.lock().unwrap().clone()).unwrap()
}

/// Exit code, standard output, standard error.
struct Done {
    code: u8,
    out: String,
    err: String,
}

impl Done {
    /// Whether a run came to its plan, whatever it brings.
    fn is_finished(&self) -> bool {
        [0, MISSED].contains(&self.code)
    }
}

/// Runs `optimise` with Ctrl-C after `patience` ticks.
fn optimise_for(patience: u64, arguments: &[&str]) -> Done {
    optimise_with(patience, 0, arguments)
}

/// The same where the first `spoilt` motions bring nothing in whole counts.
fn optimise_with(patience: u64, spoilt: u32, arguments: &[&str]) -> Done {
    let interrupt = Interrupt::default();
    let patience = Rc::new(Cell::new(patience));
    let factory = |scene: &Scene, setup: &Setup| -> Result<Box<dyn Simulate>, RolloutError> {
        let (interrupt, patience) = (interrupt.clone(), patience.clone());
        let (map, spoilt) = (SkillMap::new(scene), Cell::new(spoilt));
        let cell = scene.domain.cell_m / 0.004;
        let heavier = cell.powi(3) * 8.0 / f64::from(scene.powder.particles_per_cell);
        let share =
            if cell < 0.75 { ON_FINER_CELLS } else { 1.0 } * share_in_packing(setup.settings.seed_of(scene));
        let (leaks, watch) = (scene.name == LEAKY, Watch::default());
        Ok(Box::new(Ends { map, interrupt, patience, spoilt, heavier, share, leaks, watch }))
    };
    let (mut out, err) = (Vec::new(), Buffer::default());
    let mut context = Context {
        factory: &factory,
        interrupt: interrupt.clone(),
        out: &mut out,
        err: err.clone().into(),
        live: false,
    };
    let result = execute(["optimise"].iter().chain(arguments), &mut context);
    let (out, mut err) = (String::from_utf8(out).unwrap(), read(&err));
    let code = result.as_ref().map_or_else(CliError::code, |()| 0);
    if let Err(error) = result {
        err += &error.to_string();
    }
    Done { code, out, err }
}

fn optimise(arguments: &[&str]) -> Done {
    optimise_for(u64::MAX, arguments)
}

/// A place for one test's folders.
struct Place(tempfile::TempDir);

impl Place {
    fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    fn text(&self, name: &str) -> String {
        self.path(name).to_str().unwrap().to_owned()
    }

    /// A finished run of `epochs` epochs.
    fn finished(&self, name: &str, epochs: u32) -> String {
        let folder = self.text(name);
        let done = optimise(&mixed(&epochs.to_string(), &folder));
        assert!(done.is_finished(), "{}", done.err);
        folder
    }
}

/// A run down the gradient, of which this bench has a wrong and a right one.
fn mixed<'a>(epochs: &'a str, folder: &'a str) -> [&'a str; 10] {
    ["bench-small", "--no-refine", "--seed", "4", "--method", "mixed", "--epochs", epochs, "--out", folder]
}

/// What is in a place.
fn names(place: &Place) -> Vec<String> {
    let entries = fs::read_dir(place.0.path()).unwrap();
    let mut names: Vec<_> =
        entries.map(|entry| entry.unwrap().file_name().to_string_lossy().into_owned()).collect();
    names.sort();
    names
}

/// The metrics without the wall times.
fn metrics(folder: &str) -> Vec<Value> {
    let text = fs::read_to_string(Path::new(folder).join(METRICS)).unwrap();
    let parse = |line| {
        let mut value: Value = serde_json::from_str(line).unwrap();
        value.as_object_mut().unwrap().remove("seconds").unwrap();
        value["work"].as_object_mut().unwrap().remove("cpu_seconds").unwrap();
        value
    };
    text.lines().map(parse).collect()
}

fn bytes(folder: &str, name: &str) -> Vec<u8> {
    fs::read(Path::new(folder).join(name)).unwrap()
}

/// One line, no debug output, and a word that tells what it is about.
fn assert_sentence(done: &Done, code: u8, about: &str) {
    let sentence = done.err.lines().last().unwrap_or_default();
    assert_eq!(done.code, code, "{}", done.err);
    assert!(sentence.contains(about), "`{about}` in: {sentence}");
    assert!(done.out.is_empty(), "{}", done.out);
}

/// A writer whose reader went away.
struct Closed;

impl Write for Closed {
    fn write(&mut self, _: &[u8]) -> io::Result<usize> {
        Err(io::ErrorKind::BrokenPipe.into())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// That the command ends and says nothing where nobody reads standard output.
fn assert_unread(arguments: &[&str]) {
    let err = Buffer::default();
    let mut context = Context {
        factory: &|_, _| unreachable!(),
        interrupt: Interrupt::default(),
        out: &mut Closed,
        err: err.clone().into(),
        live: false,
    };
    let ended = execute(["optimise"].iter().chain(arguments), &mut context).unwrap_err();
    assert_eq!((ended.code(), &ended), (141, &CliError::Unread), "{arguments:?}");
    assert!(read(&err).is_empty(), "{arguments:?}");
}

#[test]
fn arguments_are_consistent() {
    use clap::CommandFactory;
    Cli::command().debug_assert();
    for line in [
        "",
        "bench-fine",
        "--seed 2",
        "run bench --epochs 3",
        "--resume runs/x --epochs 40",
        "simulate --plan p --json",
        "simulate --plan p --executed e",
        "simulate --plan p --refine 2",
        "simulate --plan p --packings 8",
        "refine p --by 3 --out d --json",
        "shorten p --threads 2 --out d --json",
        "scenes --json",
        "new mine.toml --from bench-small",
        "completions fish",
        "validate vial --full --threads 2",
        "validate --full --only spoon",
        "validate --short --write kept --commit abc --json",
        "export p --format csv",
        "export --plan p --format vtk",
        "export p --format csv --arm ur5e --base -1,0,0,0,0,-90 --tool 0,0,0.1,0,0,0 --near -1,2,3,4,5,6",
        "export --format ply --theta 0,0,0,0,0 --scene bench --seed 3",
        "export p --format csv --out -",
    ] {
        let arguments = ["optimise"].into_iter().chain(line.split_whitespace());
        assert!(Cli::try_parse_from(arguments).is_ok(), "{line}");
    }
    for line in [
        "--resume a --out b",
        "simulate",
        "simulate --plan p --theta 0",
        "simulate --plan p --seed 1",
        "simulate --executed e",
        // Nobody would look at it.
        "report p --executed e --no-replay",
        "simulate --plan p --refine 1",
        "simulate --plan p --packings 1",
        "refine",
        "refine p --by 5",
        "shorten",
        "simulate --theta 0,0,0,0,0 --executed e",
        "validate --short --full",
        "validate --only spoon --write kept",
        "validate --threads 0",
        "validate --commit abc",
        "export --format csv",
        "export p",
        "export p --plan p --format csv",
        "export p --format xml",
        "export p --format csv --arm ur5e",
        "export p --format csv --base 0,0,0,0,0,0",
        "export p --format csv --arm ur3 --base 0,0,0,0,0,0 --tool 0,0,0,0,0,0",
        "export p --format csv --arm ur5e --base 0,0,0,0,0 --tool 0,0,0,0,0,0",
        "export p --format csv --arm ur5e --base 0,0,0,0,0,x --tool 0,0,0,0,0,0",
        "export p --format csv --arm ur5e --base 0,0,0,0,0,nan --tool 0,0,0,0,0,0",
        "export p --format urscript --arm ur5e --base 0,0,0,0,0,0 --tool 0,0,0,0,0,0 --rate 300",
        "export p --format urscript --speed 0",
        "export p --format urscript --speed 1.5",
        "export p --format urscript --home 1,2,3",
        "export p --format urscript --arm ur5e --base 0,0,0,0,0,0 --tool 0,0,0,0,0,0 --rate 1000",
        "export p --format vtk --theta 0,0,0,0,0",
        "export p --format vtk --seed 3",
        "--threads 0",
        "--memory 5x",
    ] {
        let arguments = ["optimise"].into_iter().chain(line.split_whitespace());
        assert!(Cli::try_parse_from(arguments).is_err(), "{line}");
    }
}

#[test]
fn run_leaves_its_files_and_says_what_it_found() {
    let place = Place::new();
    let folder = place.text("run");
    let done = optimise(&[&["run"][..], &mixed("2", &folder)].concat());
    assert_eq!(done.code, MISSED, "{}", done.err);
    for file in [SCENE, STATE, METRICS, TRIES, CURVES, PLAN] {
        assert!(Path::new(&folder).join(file).is_file(), "{file}");
    }
    let first = done.out.lines().nth(1).unwrap_or_default();
    assert!(first.starts_with("The plan brings ") && first.contains("of the 1.6 g wanted"), "{}", done.out);
    assert!(done.err.ends_with("and the tolerance is 2 %"), "{}", done.err);
    let next = done.out.lines().last().unwrap();
    assert!(next.contains("execute") && next.ends_with(&format!(" {folder}/skill.plan")), "{next}");
    assert_eq!(done.err.lines().filter(|line| line.starts_with("epoch")).count(), 3, "{}", done.err);
    assert_eq!(Scene::load(&format!("{folder}/scene.toml")).unwrap(), Scene::load("bench-small").unwrap());
    // More epochs meet the amount.
    let done = optimise(&["--resume", &folder, "--epochs", "20"]);
    assert_eq!(done.code, 0, "{}", done.err);
    assert!(done.out.contains("within the tolerance of 2 %"), "{}", done.out);
    assert!(!done.out.contains("help"), "{}", done.out);
}

#[test]
fn a_skill_that_takes_the_tool_through_a_wall_is_no_plan() {
    let place = Place::new();
    let mut scene = Scene::load("bench").unwrap().into_spec();
    scene.skill.lift_height_m = [0.018, 0.019];
    fs::write(place.path("low.toml"), scene.to_toml()).unwrap();
    let [file, folder] = ["low.toml", "run"].map(|name| place.text(name));
    let done = optimise(&[&file, "--method", "mixed", "--epochs", "1", "--out", &folder]);
    let about = "no evaluated skill is a motion that the arm may perform: the tool's body would pass through container \
                 \"target\" at ";
    assert_sentence(&done, 1, about);
    assert!(done.err.contains("are passed over: the tool's body would pass through"), "{}", done.err);
    assert!(!Path::new(&folder).join(PLAN).exists());
    // What was evaluated is there all the same, and a comparison goes on with it.
    assert_eq!(metrics(&folder).len(), 2);
    let folder = place.text("comparison");
    let methods = ["--methods", "mixed,random", "--seeds", "1", "--rollouts", "8"];
    let done = optimise(&[&["compare", &file, "--out", &folder][..], &methods].concat());
    assert_eq!(done.code, 0, "{}", done.err);
}

/// A scene of which some skills take the tool through a wall: the lower the lift, and the search lowers it.
fn low_scene(place: &Place) -> String {
    let mut scene = Scene::load("bench").unwrap().into_spec();
    scene.skill.lift_height_m = [0.018, 0.060];
    scene.skill.initial_theta = [[0.0; 2], [0.0; 2], [0.9; 2], [0.0; 2], [0.0; 2]];
    // The stand-in wishes the tool 10 mm above its start, which is inside of a target as high as this one.
    scene.skill.scooping_depth_m = [0.002, 0.0021];
    scene.containers[1].shape = ContainerShape::Box { inner_size_m: [0.064, 0.064, 0.060] };
    scene.objective.amount = Amount::new(Quantity::Particles(200));
    fs::write(place.path("low.toml"), scene.to_toml()).unwrap();
    place.text("low.toml")
}

#[test]
fn every_place_says_the_same_of_a_run_also_when_epochs_were_passed_over() {
    let place = Place::new();
    let [file, folder] = [low_scene(&place), place.text("run")];
    let search = ["--method", "mixed", "--epochs", "8", "--no-refine", "--json"];
    let done = optimise(&[&[file.as_str(), "--out", &folder][..], &search].concat());
    assert!(done.is_finished(), "{}", done.err);
    let found: Value = serde_json::from_str(&done.out).unwrap();
    let epoch = found["epoch"].as_u64().unwrap();
    let passed: Vec<u64> =
        found["passed_over"].as_array().unwrap().iter().map(|one| one["epoch"].as_u64().unwrap()).collect();
    assert!(!passed.is_empty() && !passed.contains(&epoch), "{found}");
    let grams = 1e3 * found["plan"]["mass_kg"].as_f64().unwrap();
    let miss = -100.0 * found["plan"]["miss"].as_f64().unwrap();
    // Some passed-over epoch comes nearer: it is the one that a page without the rule would headline.
    let lines = metrics(&folder);
    let arrives = |line: &Value| line["census"]["target"].as_u64().unwrap();
    assert!(passed.iter().any(|one| arrives(&lines[*one as usize]) > arrives(&lines[epoch as usize])));
    for (number, line) in (0..).zip(&lines) {
        assert_eq!(line["shipped"], number == epoch, "{line}");
        assert_eq!(line["passed_over"].is_string(), passed.contains(&number), "{line}");
    }
    let again = optimise(&["--resume", &folder]).out;
    let inspected = optimise(&["inspect", &format!("{folder}/skill.plan")]).out;
    let written = std::time::UNIX_EPOCH + std::time::Duration::from_secs(1_700_000_000);
    let plan = fs::File::options().write(true).open(format!("{folder}/skill.plan")).unwrap();
    plan.set_modified(written).unwrap();
    assert_eq!(optimise(&["report", &folder]).code, 0);
    let page = String::from_utf8(bytes(&folder, "report.html")).unwrap();
    assert!(
        page.contains("<dt>Date</dt><dd>2023-11-14, 22:13 UTC</dd>"),
        "the date that the plan was written"
    );
    let curves = String::from_utf8(bytes(&folder, CURVES)).unwrap();
    let mass = powderline_simulator::scene::figures::mass(1e-3 * grams);
    for (name, text) in [("terminal", &again), ("inspect", &inspected), ("page", &page)] {
        assert!(text.contains(&format!("Epoch {epoch} of 8 is the plan")), "{name}: {text}");
        assert!(text.contains(&mass), "{name}: {mass}");
        assert!(text.contains(&format!("{miss:.0} % too little")), "{name}: {miss}");
        // The page writes the apostrophe as HTML does.
        assert!(text.contains("passed over") && text.contains("body would pass through container"), "{name}");
    }
    assert!(curves.contains("shipped"), "{curves}");
    let json = optimise(&["inspect", &format!("{folder}/skill.plan"), "--json"]).out;
    let inspected: Value = serde_json::from_str(&json).unwrap();
    let reported: Value =
        serde_json::from_str(&optimise(&["report", &folder, "--no-replay", "--json"]).out).unwrap();
    for run in [&inspected["run"], &reported["run"]] {
        for key in ["epoch", "plan", "amounts", "passed_over", "met", "rule", "first", "best", "advice"] {
            assert_eq!(run[key], found[key], "{key}");
        }
    }
}

#[test]
fn what_cannot_be_done_is_refused_before_anything_runs() {
    let place = Place::new();
    let mut scene = Scene::load("bench").unwrap().into_spec();
    scene.objective.amount = Amount::new(Quantity::MassKg(0.030));
    fs::write(place.path("much.toml"), scene.to_toml()).unwrap();
    let mut scene = Scene::load("bench").unwrap().into_spec();
    scene.skill.transport_displacement_m = [0.02, 0.03];
    fs::write(place.path("far.toml"), scene.to_toml()).unwrap();
    let mut scene = Scene::load("bench").unwrap().into_spec();
    scene.arm.as_mut().unwrap().base_position_m[1] = -2.0;
    fs::write(place.path("arm.toml"), scene.to_toml()).unwrap();
    for (file, about) in [
        ("much.toml", "3 trips of 10 g each"),
        ("far.toml", "out of reach"),
        ("arm.toml", "the UR5e of [arm] can make no motion"),
    ] {
        let file = place.text(file);
        let folder = place.text("run");
        assert_sentence(&optimise(&[&file, "--out", &folder]), 2, about);
        assert_sentence(&optimise(&["compare", &file, "--out", &folder]), 2, about);
        assert!(!Path::new(&folder).exists());
        let checked = optimise(&["check", &file]);
        assert_eq!(checked.code, 2);
        assert!(checked.err.contains(about) && checked.out.contains("cannot be done"), "{}", checked.err);
    }
}

#[test]
fn what_memory_does_not_hold_is_refused_before_anything_is_written() {
    let place = Place::new();
    let run = place.finished("run", 1);
    let (plan, out) = (format!("{run}/skill.plan"), place.text("out"));
    let (page, sentence) = (format!("{run}/report.html"), "a memory budget of 1 MiB is too little");
    let export = |format| ["export", &plan, "--format", format, "--particles", "--out", &out];
    for words in [
        &["report", &run][..],
        &["report", &plan, "--out", &out],
        &["render", "--plan", &plan, "--out", &out],
        &export("vtk"),
        &export("ply"),
        &export("csv"),
        &export("mcap"),
    ] {
        let done = optimise(&[words, &["--memory", "1MiB"]].concat());
        assert_sentence(&done, 2, sentence);
        // A page holds the replay beside the simulation.
        assert_eq!(done.err.contains("what is made of it"), words[0] == "report", "{}", done.err);
        assert_eq!(names(&place), ["run"], "{words:?}");
        assert!(!Path::new(&page).exists());
    }
}

#[test]
fn metrics_have_their_fields_in_order_and_one_line_per_epoch() {
    let place = Place::new();
    let folder = place.finished("run", 5);
    let text = fs::read_to_string(Path::new(&folder).join(METRICS)).unwrap();
    assert_eq!(text.lines().count(), 6);
    for (epoch, line) in text.lines().enumerate() {
        let names = [
            "epoch",
            "world",
            "rounded",
            "loss",
            "indicator",
            "census",
            "theta",
            "work",
            "seconds",
            "step",
            "slopes",
            "mass_kg",
            "miss",
            "lost_kg",
            "powder_kg",
            "passed_over",
            "shipped",
        ];
        let positions = names.map(|name| line.find(&format!("\"{name}\":")).unwrap());
        assert!(positions.is_sorted(), "{line}");
        let record: EpochRecord = serde_json::from_str(line).unwrap();
        assert_eq!(record.epoch as usize, epoch);
        assert_eq!(record.slopes.is_none(), epoch == 5);
    }
}

#[test]
fn run_interrupted_anywhere_and_resumed_has_the_same_bits() {
    let place = Place::new();
    let whole = place.finished("whole", 4);
    // Five skills, the probes of depth in four epochs and of the others in the two before they are trusted, the plan.
    for patience in 1..=(5 + 4 * 2 + 2 * 8 + 1) * TICKS {
        let folder = place.text(&format!("run{patience}"));
        let done = optimise_for(patience, &mixed("4", &folder));
        assert_sentence(&done, 130, &format!("--resume {folder}"));
        assert!(!Path::new(&folder).join(PLAN).exists());
        let done = optimise(&["--resume", &folder]);
        assert!(done.is_finished(), "{}", done.err);
        assert_eq!(metrics(&folder), metrics(&whole), "after {patience}");
        assert_eq!(bytes(&folder, PLAN), bytes(&whole, PLAN), "after {patience}");
        assert_eq!(bytes(&folder, CURVES), bytes(&whole, CURVES), "after {patience}");
    }
}

/// The search that is the usual one, in both worlds.
#[test]
fn usual_run_interrupted_again_and_again_has_the_same_bits() {
    let place = Place::new();
    let arguments =
        |folder: &str| ["bench-small", "--seed", "4", "--epochs", "9", "--out", folder].map(String::from);
    let whole = place.text("whole");
    let done = optimise(&arguments(&whole).each_ref().map(String::as_str));
    assert!(done.is_finished(), "{}", done.err);
    let turns = ["in a coarse copy of the scene, to see", "in the scene itself, in whole"];
    assert_eq!(turns.map(|turn| done.err.matches(turn).count()), [1, 1], "{}", done.err);
    let worlds: Vec<Value> = metrics(&whole).into_iter().map(|line| line["world"].clone()).collect();
    assert!(worlds[0] == "coarse" && *worlds.last().unwrap() == "fine", "{worlds:?}");
    let folder = place.text("run");
    let mut done = optimise_for(2, &arguments(&folder).each_ref().map(String::as_str));
    let mut resumptions = 0;
    while done.code == 130 {
        // Enough for the longest epoch, and a tick or two.
        done = optimise_for(8 * TICKS + 2, &["--resume", &folder]);
        resumptions += 1;
    }
    assert!(done.is_finished() && resumptions >= 3, "{} after {resumptions}", done.err);
    assert_eq!(metrics(&folder), metrics(&whole));
    for file in [PLAN, CURVES] {
        assert_eq!(bytes(&folder, file), bytes(&whole, file), "{file}");
    }
    // The page says which epochs were coarse.
    assert_eq!(optimise(&["report", &whole, "--no-replay"]).code, 0);
    let page = String::from_utf8(bytes(&whole, "report.html")).unwrap();
    assert!(page.contains("in a coarse copy of the scene") && page.contains(">coarse</td>"), "{page}");
}

#[test]
fn run_interrupted_again_and_again_has_the_same_bits() {
    let place = Place::new();
    let whole = place.finished("whole", 4);
    let folder = place.text("run");
    let mut done = optimise_for(2, &mixed("4", &folder));
    let mut resumptions = 0;
    while done.code == 130 {
        // Enough for the longest epoch.
        done = optimise_for(11 * TICKS + 1, &["--resume", &folder]);
        resumptions += 1;
    }
    assert!(done.is_finished() && resumptions >= 3, "{} after {resumptions}", done.err);
    assert_eq!(metrics(&folder), metrics(&whole));
    assert_eq!(bytes(&folder, PLAN), bytes(&whole, PLAN));
}

#[test]
fn run_by_the_adjoint_alone_evaluates_every_skill_once() {
    let place = Place::new();
    let folder = place.text("run");
    let arguments = ["bench-small", "--seed", "4", "--method", "exact", "--epochs", "4", "--out", &folder];
    // Five skills, and Ctrl-C at the end of the plan's simulation.
    let done = optimise_for(6 * TICKS, &arguments);
    assert_eq!(done.code, 130, "{}", done.err);
    let lines = metrics(&folder);
    assert_eq!(lines.len(), 5);
    for line in &lines[..4] {
        let slopes = &line["slopes"];
        assert_eq!(slopes["gradient"], slopes["adjoint"]);
        assert_eq!(slopes["differences"], serde_json::json!([null, null, null, null, null]));
        assert_eq!(slopes["first_order_weight"], serde_json::json!([1.0, 1.0, 1.0, 1.0, 1.0]));
        let work = &line["work"];
        assert_eq!(
            (&work["rollouts"], &work["adjoints"], &work["coarse_rollouts"]),
            (&1.into(), &1.into(), &0.into())
        );
    }
    assert!(optimise(&["--resume", &folder]).is_finished());
}

#[test]
fn run_restarts_the_adjoint_where_that_is_asked_for() {
    let place = Place::new();
    let off = |method: &str| {
        let folder = place.text(method);
        optimise(&["bench-small", "--seed", "4", "--method", method, "--epochs", "1", "--out", &folder]);
        let lines = metrics(&folder);
        let first = &lines[0]["slopes"];
        let [adjoint, differences] = ["adjoint", "differences"].map(|key| first[key][0].as_f64().unwrap());
        (adjoint - differences).abs()
    };
    // Differences of a square are its derivative.
    let [exact, restarted] = ["mixed", "restarted"].map(off);
    assert!(restarted < 0.01 * exact, "{restarted} {exact}");
}

#[test]
fn finished_run_is_prolonged_to_the_bits_of_a_longer_one() {
    let place = Place::new();
    let long = place.finished("long", 9);
    let folder = place.finished("short", 4);
    let done = optimise(&["--resume", &folder, "--epochs", "9"]);
    assert!(done.is_finished(), "{}", done.err);
    assert_eq!(metrics(&folder), metrics(&long));
    assert_eq!(bytes(&folder, PLAN), bytes(&long, PLAN));
}

#[test]
fn a_prolongation_that_memory_does_not_hold_leaves_the_run_as_it_was() {
    let place = Place::new();
    let folder = place.finished("run", 4);
    let saved = || [METRICS, TRIES, PLAN, STATE].map(|name| bytes(&folder, name));
    let before = saved();
    let done = optimise(&["--resume", &folder, "--epochs", "9", "--memory", "1MiB"]);
    assert_sentence(&done, 2, "a memory budget of 1 MiB is too little");
    assert_eq!(saved(), before);
    // What is finished can be looked at, however little there is.
    assert!(optimise(&["--resume", &folder, "--memory", "1MiB"]).is_finished());
}

#[test]
fn a_run_that_has_the_amount_ends_early_says_so_and_is_not_prolonged() {
    let place = Place::new();
    let mut scene = Scene::load("bench-small").unwrap().into_spec();
    scene.objective.amount = Amount { tolerance: 1.0, ..Amount::new(Quantity::Particles(200)) };
    let (path, folder) = (place.text("met.toml"), place.text("run"));
    fs::write(&path, scene.to_toml()).unwrap();
    let search = ["--seed", "4", "--method", "mixed", "--epochs", "60", "--no-refine"];
    let done = optimise(&[&[path.as_str(), "--out", &folder][..], &search].concat());
    // Not before two epochs in a row had no loss that is worth going on for.
    let losses: Vec<f64> = metrics(&folder).iter().map(|epoch| epoch["loss"].as_f64().unwrap()).collect();
    let falls = |at: usize| losses[at] <= 0.95 * losses[..at].iter().copied().fold(f64::INFINITY, f64::min);
    let last = losses.len() - 1;
    assert!(done.code == 0 && (4..50).contains(&last), "{}", done.err);
    assert_eq!([2, 1, 0].map(|before| falls(last - before)), [true, false, false], "{losses:?}");
    assert!(done.out.contains("The search ended there, of at most 60 epochs"), "{}", done.out);
    let saved = [METRICS, PLAN, STATE].map(|name| bytes(&folder, name));
    // Not a tick is simulated for the plan that is there.
    let again = optimise_for(1, &["--resume", &folder, "--epochs", "80"]);
    assert!(again.code == 0 && again.err.contains("--patience 0"), "{}", again.err);
    assert_eq!([METRICS, PLAN, STATE].map(|name| bytes(&folder, name)), saved);
    // Nor is what is known of a corrected one forgotten.
    let corrected = place.text("corrected");
    let search = ["--seed", "4", "--method", "mixed", "--epochs", "60", "--out", &corrected];
    assert!(optimise(&[&[path.as_str()][..], &search].concat()).is_finished());
    let saved = [METRICS, PLAN, STATE].map(|name| bytes(&corrected, name));
    let again = optimise_for(1, &["--resume", &corrected, "--epochs", "80", "--no-refine"]);
    assert!(again.is_finished() && again.out.contains("Simulated for that: "), "{} {}", again.out, again.err);
    assert_eq!([METRICS, PLAN, STATE].map(|name| bytes(&corrected, name)), saved);
    // Curves that were not written when it ended are drawn by whoever looks again.
    let curves = bytes(&corrected, CURVES);
    fs::write(place.path("corrected").join(CURVES), "half").unwrap();
    assert!(optimise_for(1, &["--resume", &corrected]).is_finished());
    assert_eq!(bytes(&corrected, CURVES), curves);
}

/// A run of a scene whose amount every epoch brings, in `folder`, where the first `spoilt` motions bring nothing in whole counts.
fn easy_run(place: &Place, folder: &str, spoilt: u32, [epochs, patience]: [&str; 2]) -> Done {
    let mut scene = Scene::load("bench-small").unwrap().into_spec();
    scene.objective.amount = Amount { tolerance: 0.99, ..Amount::new(Quantity::Particles(200)) };
    let path = place.text("easy.toml");
    fs::write(&path, scene.to_toml()).unwrap();
    let search = ["--method", "mixed", "--no-refine", "--epochs", epochs, "--patience", patience];
    optimise_with(
        u64::MAX,
        spoilt,
        &[&[path.as_str(), "--seed", "4"][..], &search, &["--out", folder]].concat(),
    )
}

/// The epoch that is marked as the plan's.
fn shipped(folder: &str) -> u64 {
    let chosen = |line: &Value| line["shipped"] == true;
    metrics(folder).iter().find(|line| chosen(line)).and_then(|line| line["epoch"].as_u64()).unwrap()
}

#[test]
fn a_motion_that_rounding_spoils_makes_room_for_the_next() {
    let place = Place::new();
    let run = |name: &str, spoilt: u32| {
        let folder = place.text(name);
        let done = easy_run(&place, &folder, spoilt, ["5", "0"]);
        assert_eq!((done.code, metrics(&folder).len()), (0, 6), "{}", done.err);
        (done.out, shipped(&folder))
    };
    let ((first, best), (second, next)) = (run("first", 0), run("second", 1));
    assert!(next != best && !first.contains("came before it"), "{best} {next} {first}");
    assert!(second.contains(&format!("Epoch {best} came before it")), "{second}");
}

#[test]
fn a_search_goes_on_while_rounding_spoils_all_that_it_found() {
    let place = Place::new();
    let run = |name: &str, spoilt: u32| {
        let folder = place.text(name);
        let done = easy_run(&place, &folder, spoilt, ["40", "1"]);
        (done, folder)
    };
    let (once, folder) = run("once", 1);
    // Some epochs, of which the last gained nothing; the best one's motion is spoilt, and another one's is not.
    let epochs = metrics(&folder).len();
    assert!(once.code == 0 && (2..30).contains(&epochs), "{}", once.err);
    assert!(!once.err.contains("the search goes on"), "{}", once.err);
    let (all, folder) = run("all", epochs as u32);
    assert!(all.code == 0 && metrics(&folder).len() > epochs, "{}", all.err);
    assert!(all.err.contains("no motion stays within the tolerance: the search goes on"), "{}", all.err);
    // To the last epoch: the miss comes first, and more epochs are an advice that can be followed.
    let (never, folder) = run("never", u32::MAX);
    assert_eq!((never.code, metrics(&folder).len()), (MISSED, 41), "{}", never.err);
    assert!(never.out.contains("--epochs") && !never.out.contains("The search ended there"), "{}", never.out);
    let longer = optimise(&["--resume", &folder, "--epochs", "44"]);
    assert!(longer.code == 0 && !longer.err.contains("is finished"), "{}", longer.err);
}

#[test]
fn resuming_a_finished_run_says_so() {
    let place = Place::new();
    let folder = place.finished("run", 2);
    let plan = bytes(&folder, PLAN);
    let done = optimise(&["--resume", &folder]);
    assert!(done.code == MISSED && done.err.contains("is finished"), "{}{}", done.out, done.err);
    // What it found is said again.
    assert!(done.out.contains("The plan brings"), "{}", done.out);
    assert_eq!(bytes(&folder, PLAN), plan);
}

#[test]
fn metrics_lost_or_half_written_are_put_right_on_resuming() {
    let place = Place::new();
    let whole = place.finished("whole", 4);
    for damage in ["", "{\"epoch\":0,\"lo"] {
        let folder = place.text(&format!("run{}", damage.len()));
        optimise_for(3 * TICKS, &mixed("4", &folder));
        fs::write(Path::new(&folder).join(METRICS), damage).unwrap();
        assert!(optimise(&["--resume", &folder]).is_finished());
        assert_eq!(metrics(&folder), metrics(&whole));
    }
}

#[test]
fn resume_refuses_another_scene_seed_precision_and_fewer_epochs() {
    let place = Place::new();
    let folder = place.finished("run", 3);
    for (arguments, about) in [
        (&["bench"][..], "another scene than `bench`"),
        (&["--seed", "5"], "seed 4, not 5"),
        (&["--precision", "f64"], "precision f32, not f64"),
        (&["--epochs", "2"], "can only be prolonged"),
        (&["--method", "random"], "method mixed, not random"),
        (&["--patience", "5"], "patience 2, not 5"),
    ] {
        let done = optimise(&[&["--resume", &folder], arguments].concat());
        assert_sentence(&done, 2, about);
    }
    let same = ["--resume", &folder, "bench-small", "--seed", "4", "--precision", "f32", "--epochs", "3"];
    assert_eq!(optimise(&same).code, MISSED);
}

#[test]
fn resume_refuses_a_scene_that_was_changed_meanwhile() {
    let place = Place::new();
    let folder = place.finished("run", 1);
    let path = Path::new(&folder).join(SCENE);
    let mut scene = Scene::load("bench-small").unwrap().into_spec();
    scene.powder.friction_angle_deg = 34.0;
    fs::write(&path, scene.to_toml()).unwrap();
    assert_sentence(&optimise(&["--resume", &folder, "--epochs", "2"]), 2, "no longer the scene");
}

#[test]
fn damaged_state_is_refused() {
    let place = Place::new();
    let folder = place.finished("run", 1);
    let path = Path::new(&folder).join(STATE);
    let sound = fs::read(&path).unwrap();
    for (broken, about) in [
        (&sound[..sound.len() / 2], "damaged"),
        (&sound[..0], "not a state file"),
        (b"PLSTATE\0\x0c\0\0\0".as_slice(), "version 12"),
    ] {
        fs::write(&path, broken).unwrap();
        assert_sentence(&optimise(&["--resume", &folder]), 2, about);
    }
}

#[test]
fn folder_in_use_or_taken_is_refused() {
    let place = Place::new();
    let folder = place.text("run");
    let other = RunFolder::create(Path::new(&folder)).unwrap();
    assert_sentence(&optimise(&["bench-small", "--out", &folder]), 1, "another run is writing");
    other.replace(STATE, b"x").unwrap();
    assert_sentence(&optimise(&["--resume", &folder]), 1, "another run is writing");
    drop(other);
    assert_sentence(&optimise(&["bench-small", "--out", &folder]), 2, "not overwritten");
    assert_eq!(bytes(&folder, STATE), b"x");
}

#[test]
fn folder_that_cannot_be_written_is_refused_before_anything_is_simulated() {
    let place = Place::new();
    fs::write(place.path("file"), "").unwrap();
    let folder = place.text("file/run");
    assert_sentence(&optimise_for(0, &["bench-small", "--out", &folder]), 1, "cannot be created");
}

#[cfg(target_os = "linux")]
#[test]
fn full_disk_loses_nothing_that_was_saved() {
    let place = Place::new();
    let whole = place.finished("whole", 4);
    for file in ["state.new", "curves.svg.new", "skill.plan.new"] {
        let folder = place.text(&format!("run-{file}"));
        optimise_for(2 * TICKS, &mixed("4", &folder));
        // Resuming writes the state first; the disk fills up later.
        let full = Path::new(&folder).join(file);
        if file == "state.new" {
            fs::create_dir(&full).unwrap();
        } else {
            std::os::unix::fs::symlink("/dev/full", &full).unwrap();
        }
        let done = optimise(&["--resume", &folder]);
        assert_sentence(&done, 1, "cannot be written");
        if file == "state.new" {
            fs::remove_dir(&full).unwrap();
        }
        assert!(optimise(&["--resume", &folder]).is_finished());
        assert_eq!(metrics(&folder), metrics(&whole), "{file}");
        assert_eq!(bytes(&folder, PLAN), bytes(&whole, PLAN), "{file}");
    }
}

#[cfg(target_os = "linux")]
#[test]
fn full_disk_at_the_start_leaves_the_way_free() {
    let place = Place::new();
    let folder = place.text("run");
    fs::create_dir(&folder).unwrap();
    for file in ["scene.toml.new", "state.new"] {
        std::os::unix::fs::symlink("/dev/full", Path::new(&folder).join(file)).unwrap();
        assert_sentence(&optimise(&["bench-small", "--out", &folder]), 1, "No space left");
    }
    assert!(optimise(&mixed("1", &folder)).is_finished());
}

#[test]
fn plan_reproduces_exactly() {
    let place = Place::new();
    let folder = place.finished("run", 3);
    let plan = format!("{folder}/skill.plan");
    let done = optimise(&["simulate", "--plan", &plan, "--json"]);
    assert_eq!(done.code, 0, "{}", done.err);
    let report: Value = serde_json::from_str(&done.out).unwrap();
    assert_eq!(report["plan"]["reproduced"], true);
    assert_eq!((&report["seed"], &report["precision"]), (&4.into(), &"f32".into()));
    let bytes = fs::read(&plan).unwrap();
    let header = *PlanReader::new(&bytes).unwrap().header();
    assert_eq!(report["loss_m"].as_f64().map(f64::to_bits), Some(header.predicted.loss_m.to_bits()));
    assert_eq!(report["theta"][2].as_f64().map(f64::to_bits), Some(header.theta[2].to_bits()));
    let text = optimise(&["simulate", "--plan", &plan]).out;
    assert!(text.contains("exactly those that the plan predicts"), "{text}");
}

#[test]
fn what_a_plan_brings_on_smaller_cells_is_said_beside_what_it_brings() {
    let place = Place::new();
    let plan = format!("{}/skill.plan", place.finished("run", 3));
    let done = optimise(&["simulate", "--plan", &plan, "--refine", "2", "--json"]);
    let report: Value = serde_json::from_str(&done.out).unwrap();
    assert_eq!(report["plan"]["reproduced"], true);
    let finer = &report["finer"];
    let [own, fine] = [&report, finer].map(|of| of["mass_kg"].as_f64().unwrap());
    assert!((fine / own - ON_FINER_CELLS).abs() < 0.01, "{own} {fine}");
    assert!(near(&finer["change"], fine / own - 1.0, 1e-12) && near(&finer["cell_m"], 0.002, 1e-12));
    assert!(near(&finer["amounts"]["particle_mass_kg"], 1e-6, 1e-9), "{finer}");
    let text = optimise(&["simulate", "--plan", &plan, "--refine", "2"]).out;
    let line = text.lines().nth(3).unwrap();
    assert!(
        line.starts_with("On cells of 2 mm: ") && line.contains(" 20 % less than on the scene's own, "),
        "{text}"
    );
    // Nothing is simulated first.
    assert_sentence(
        &optimise_for(1, &["simulate", "workcell", "--theta=0,0,0,0,0", "--refine", "2"]),
        2,
        "0.0015",
    );
}

#[test]
fn what_a_plan_brings_in_other_packings_is_said_beside_what_it_brings() {
    let place = Place::new();
    let plan = format!("{}/skill.plan", place.finished("run", 3));
    let done = optimise(&["simulate", "--plan", &plan, "--packings", "3", "--json"]);
    let report: Value = serde_json::from_str(&done.out).unwrap();
    assert_eq!((&report["plan"]["reproduced"], &report["seed"]), (&true.into(), &4.into()));
    let packings = &report["packings"];
    let each = packings["each"].as_array().unwrap();
    let number = |of: &Value, key: &str| of[key].as_f64().unwrap();
    let own = number(&report, "mass_kg");
    for (packing, seed) in each.iter().zip(5u64..) {
        assert_eq!(packing["seed"], seed);
        assert!((number(packing, "mass_kg") / own - share_in_packing(seed)).abs() < 0.01, "{packing} {own}");
    }
    for key in ["mass_kg", "miss", "lost_kg", "loss_m"] {
        let mean = each.iter().map(|packing| number(packing, key)).sum::<f64>() / 3.0;
        assert!(near(&packings["mean"][key], mean, 1e-12), "{key} {packings}");
    }
    let text = optimise(&["simulate", "--plan", &plan, "--packings", "3"]).out;
    let mass_of = |packing: &Value| powderline_simulator::scene::figures::mass(number(packing, "mass_kg"));
    let [most, least] = [mass_of(&each[0]), mass_of(&each[2])];
    let line = text.lines().nth(3).unwrap();
    assert!(line.starts_with("In 3 other packings of the powder, on the scene's own cells: "), "{text}");
    assert!(
        line.contains(&format!(
            "; {least} at least, {most} at most, within the tolerance in 0. 56 mg are lost"
        )),
        "{line}"
    );
    let finer = optimise(&["simulate", "--plan", &plan, "--packings", "3", "--refine", "2"]).out;
    let lines: Vec<&str> = finer.lines().collect();
    let untimed = |line: &str| line.rsplit_once(" in ").unwrap().0.to_owned();
    assert!(lines[4].starts_with("In 3 other packings of the powder, on cells of 2 mm: "), "{finer}");
    assert_eq!(untimed(lines[5]), untimed(line));
}

#[test]
fn what_was_looked_at_before_a_stop_is_said() {
    let place = Place::new();
    let plan = format!("{}/skill.plan", place.finished("run", 3));
    let words = ["simulate", "--plan", &plan, "--packings", "2", "--refine", "2"];
    let mut said = Vec::new();
    for patience in 1..100 {
        let done = optimise_for(patience, &words);
        let lines = done.out.lines().filter(|line| line.contains(" of the powder, on ")).count();
        if done.code == 0 {
            assert_eq!(lines, 2, "{}", done.out);
            break;
        }
        assert_eq!(done.code, 130);
        let sentence = done.err.lines().last().unwrap_or_default().to_owned();
        said.push((sentence, done.out.lines().any(|line| line.starts_with("bench-small, ")), lines));
    }
    said.dedup();
    // Each with whether what it brings on the scene's own cells is said, and in how many kinds of other packings.
    let of = |sentence: &str, is_own_said, lines| (sentence.to_owned(), is_own_said, lines);
    let there = |looked: u32| {
        format!(
            "stopped after {looked} of 2 other packings on cells of 2 mm; other packings on the scene's own cells were not looked at"
        )
    };
    let here = |looked: u32| format!("stopped after {looked} of 2 other packings on the scene's own cells");
    let unknown =
        "stopped on request; what it brings on cells of 2 mm is not known; other packings were not looked at";
    assert_eq!(
        said,
        [
            of("stopped on request", false, 0),
            of(unknown, true, 0),
            of(&there(0), true, 0),
            of(&there(1), true, 1),
            of(&here(0), true, 1),
            of(&here(1), true, 2),
        ]
    );
}

/// A plan, and the motion of an arm that performs it to the last bit, to be spoilt.
struct Performed {
    place: Place,
    plan: String,
    header: TrajectoryHeader,
    poses: Vec<Pose>,
}

impl Performed {
    fn new() -> Self {
        let place = Place::new();
        let plan = format!("{}/skill.plan", place.finished("run", 1));
        let bytes = fs::read(&plan).unwrap();
        let reader = PlanReader::new(&bytes).unwrap();
        let (start, lsb) = (reader.header().start_pose(), reader.header().lsb);
        let after = reader.setpoints().map(|setpoint| pose_at(&start, setpoint, lsb));
        let poses = std::iter::once(start).chain(after).collect();
        let period_us = reader.header().control_period_us;
        Self { place, plan, header: TrajectoryHeader { plan_hash: reader.content_hash(), period_us }, poses }
    }

    fn last(&self) -> Pose {
        *self.poses.last().unwrap()
    }

    fn steps(&self) -> usize {
        self.poses.len() - 1
    }

    fn simulate(&self, more: &[&str]) -> Done {
        let mut text = format!("{}\n", self.header);
        for (tick, pose) in (0..).zip(&self.poses) {
            text += &format!("{}\n", Sample { tick, pose: *pose });
        }
        self.simulate_text(&text, more)
    }

    fn simulate_text(&self, text: &str, more: &[&str]) -> Done {
        self.simulate_for(u64::MAX, text, more)
    }

    /// With Ctrl-C after `patience` ticks.
    fn simulate_for(&self, patience: u64, text: &str, more: &[&str]) -> Done {
        let file = self.place.text("executed.txt");
        fs::write(&file, text).unwrap();
        optimise_for(patience, &[&["simulate", "--plan", &self.plan, "--executed", &file], more].concat())
    }

    fn report(&self) -> Value {
        let done = self.simulate(&["--json"]);
        assert_eq!(done.code, 0, "{}", done.err);
        serde_json::from_str(&done.out).unwrap()
    }
}

fn moved(pose: &Pose, x_m: f64, pitch_rad: f64) -> Pose {
    pose.displaced(&Displacement { translation_m: [x_m, 0.0, 0.0], rotation_rad: [0.0, pitch_rad, 0.0] })
}

fn near(value: &Value, wanted: f64, tolerance: f64) -> bool {
    value.as_f64().is_some_and(|value| (value - wanted).abs() <= tolerance)
}

#[test]
fn executed_exactly_as_planned_gives_what_the_plan_predicts() {
    let performed = Performed::new();
    let report = performed.report();
    let predicted = &report["plan"]["predicted"];
    for name in ["indicator", "census"] {
        assert_eq!(report[name], predicted[name], "{name}");
    }
    assert!(near(&report["loss_m"], predicted["loss_m"].as_f64().unwrap(), 1e-12), "{report}");
    assert!(report["plan"]["reproduced"].is_null());
    let executed = &report["executed"];
    assert_eq!(executed["executed_steps"], performed.steps());
    assert_eq!(executed["simulated_steps"], performed.steps());
    assert_eq!((&executed["stopped_early"], &executed["moves_at_end"]), (&false.into(), &false.into()));
    assert_eq!(
        (&executed["largest_deviation"]["mm"], &executed["largest_deviation"]["mrad"]),
        (&0.0.into(), &0.0.into())
    );
    let text = performed.simulate(&[]).out;
    assert!(
        text.contains("The plan predicts that")
            && text.contains(&format!("({} particles) arrive", predicted["census"]["target"]))
            && text.contains("off the plan by 0.000 mm"),
        "{text}"
    );
    assert_eq!(text.lines().count(), 5, "{text}");
}

#[test]
fn deviations_of_an_executed_motion_are_found_and_count() {
    let mut performed = Performed::new();
    let exact = performed.report()["loss_m"].as_f64().unwrap();
    performed.poses[100] = moved(&performed.poses[100], 1e-3, 0.0);
    performed.poses[200] = moved(&performed.poses[200], 0.0, -7e-3);
    let report = performed.report();
    let largest = &report["executed"]["largest_deviation"];
    assert!(near(&largest["mm"], 1.0, 1e-9) && near(&largest["mrad"], 7.0, 1e-9), "{largest}");
    assert_eq!((&largest["mm_tick"], &largest["mrad_tick"]), (&100.into(), &200.into()));
    assert_eq!((&report["executed"]["end_deviation"]["mm"]), &0.0);
    // It comes back to where it should be, and the stand-in only looks at the end.
    assert!(near(&report["loss_m"], exact, 1e-12));

    // The whole motion beside the planned one, from the anchor on.
    let mut aside = Performed::new();
    aside.poses = aside.poses.iter().map(|pose| moved(pose, 0.4e-3, 0.0)).collect();
    let report = aside.report();
    assert!(near(&report["executed"]["end_deviation"]["mm"], 0.4, 1e-9));
    assert!(!near(&report["loss_m"], exact, 1e-9), "{report}");
}

#[test]
fn an_arm_that_stops_early_is_kept_where_it_stopped() {
    let mut performed = Performed::new();
    let planned = performed.steps();
    performed.poses.truncate(151);
    let stopped = performed.report();
    let executed = &stopped["executed"];
    assert_eq!((&executed["stopped_early"], &executed["executed_steps"]), (&true.into(), &150.into()));
    assert_eq!(executed["simulated_steps"], planned);
    assert_eq!(executed["moves_at_end"], true);
    assert_ne!(stopped["loss_m"], stopped["plan"]["predicted"]["loss_m"]);
    let text = performed.simulate(&[]).out;
    assert!(text.contains(&format!("it ends at tick 150 of {planned}")), "{text}");
    assert!(text.contains("still moves"), "{text}");
    // Recorded while it stands, up to the plan's end, it is the same motion.
    performed.poses.resize(planned + 1, performed.last());
    let recorded = performed.report();
    assert_eq!(recorded["loss_m"], stopped["loss_m"]);
    assert_eq!(
        (&recorded["executed"]["stopped_early"], &recorded["executed"]["moves_at_end"]),
        (&false.into(), &false.into())
    );
    // An arm that never moves is recorded with its anchor alone.
    performed.poses.truncate(1);
    let report = performed.report();
    assert_eq!(
        (&report["executed"]["executed_steps"], &report["executed"]["simulated_steps"]),
        (&0.into(), &planned.into())
    );
}

#[test]
fn an_arm_that_settles_after_the_plan_is_followed_until_it_rests() {
    let mut performed = Performed::new();
    let (planned, end) = (performed.steps(), performed.last());
    // Standing still adds nothing to what is simulated, moving less than anybody can tell neither.
    performed.poses.extend([moved(&end, 3e-7, 0.0), end, end]);
    assert_eq!(performed.report()["executed"]["simulated_steps"], planned);
    performed.poses.truncate(planned + 1);
    performed.poses.extend([2e-3, 1e-3, 1e-4, 0.0, 0.0, 0.0].map(|x_m| moved(&end, x_m, 0.0)));
    let report = performed.report();
    assert_eq!(report["executed"]["executed_steps"], planned + 6);
    assert_eq!(report["executed"]["simulated_steps"], planned + 4);
    assert!(near(&report["executed"]["largest_deviation"]["mm"], 2.0, 1e-9));
    assert_eq!(report["executed"]["largest_deviation"]["mm_tick"], planned + 1);
    let text = performed.simulate(&[]).out;
    assert!(
        text.contains(&format!(
            "came to rest after the plan's end at tick {planned}, at tick {}",
            planned + 4
        )),
        "{text}"
    );
}

#[test]
fn an_executed_motion_of_another_plan_period_or_place_is_refused() {
    let mut performed = Performed::new();
    let sound = performed.header;
    performed.header.plan_hash ^= 1 << 63;
    let (found, wanted) = (performed.header.plan_hash, sound.plan_hash);
    let about = format!("another plan, {found:016x} and not {wanted:016x}");
    assert_sentence(&performed.simulate(&[]), 2, &about);
    performed.header = TrajectoryHeader { period_us: 20_000, ..sound };
    assert_sentence(&performed.simulate(&[]), 2, "a period of 20000 us, but the plan has one of 10000 us");
    performed.header = sound;
    let start = performed.poses[0];
    for (anchor, about) in [
        (moved(&start, 0.51e-3, 0.0), "begins 0.510 mm and 0.000 mrad off the plan's start pose"),
        (moved(&start, 0.0, 5.1e-3), "begins 0.000 mm and 5.100 mrad off"),
        (moved(&start, f64::MAX, 0.0), "off the plan's start pose"),
    ] {
        performed.poses[0] = anchor;
        assert_sentence(&performed.simulate(&[]), 2, about);
    }
    performed.poses[0] = moved(&start, 0.49e-3, 4.9e-3);
    assert_eq!(performed.simulate(&[]).code, 0);
}

#[test]
fn an_executed_motion_that_the_powder_cannot_follow_is_refused() {
    for (x_m, pitch_rad, about) in [
        (0.0401, 0.0, "mm and 0.0"),
        (0.0, 1.001, "mrad in the one tick 7"),
        (
            f64::MAX,
            0.0,
            "in the one tick 7, but the simulated powder follows at most 40.000 mm and 1000 mrad",
        ),
    ] {
        let mut performed = Performed::new();
        performed.poses.truncate(7);
        let jump = moved(&performed.last(), x_m, pitch_rad);
        performed.poses.push(jump);
        assert_sentence(&performed.simulate(&[]), 2, about);
    }
}

#[test]
fn what_is_no_executed_motion_is_refused() {
    let performed = Performed::new();
    let lines = performed.header.to_string();
    for (text, about) in [
        (String::new(), "no usable record of an executed motion: it is empty"),
        (lines.clone(), "it ends after line 3"),
        (format!("{lines}\n1 0 0 0 1 0 0 0\n"), "in line 4 the tick is 1"),
        (format!("{lines}\n0 {}", "1".repeat(1 << 20)), "line 4 is longer than 256 bytes"),
        ("PWDLPLAN".repeat(1000), "it begins with `PWDLPLANPWDLPLANPWDLPLAN..`"),
    ] {
        assert_sentence(&performed.simulate_text(&text, &[]), 2, about);
    }
    let anchor = Sample { tick: 0, pose: performed.poses[0] };
    assert_sentence(
        &performed.simulate_for(2, &format!("{lines}\n{anchor}"), &[]),
        130,
        "stopped on request",
    );
    let none = performed.place.text("none");
    assert_sentence(
        &optimise(&["simulate", "--plan", &performed.plan, "--executed", &none]),
        2,
        "cannot be read",
    );
    let folder = performed.place.text("run");
    assert_sentence(
        &optimise(&["simulate", "--plan", &performed.plan, "--executed", &folder]),
        2,
        "cannot be read",
    );
}

#[test]
fn simulate_takes_a_theta() {
    let done = optimise(&["simulate", "bench-small", "--theta", "-0.5,0,0.25,1,-1", "--json"]);
    assert_eq!(done.code, 0, "{}", done.err);
    let report: Value = serde_json::from_str(&done.out).unwrap();
    assert_eq!(report["theta"], serde_json::json!([-0.5, 0.0, 0.25, 1.0, -1.0]));
    assert_eq!(report["amounts"]["wanted_particles"], 200);
    assert!(near(&report["amounts"]["wanted_kg"], 1.6e-3, 1e-12));
    assert!(report["plan"].is_null());
}

#[test]
fn simulate_refuses_what_is_no_theta() {
    for (theta, about) in [
        ("2,0,0,0,0", "scooping depth"),
        ("0,0,0,0,-1.0001", "pouring angle"),
        ("0,0,NaN,0,0", "lift height"),
        ("0,0,0,0", "there are 4"),
        ("0,0,0,0,0,0", "there are 6"),
        ("0,0,x,0,0", "`x` is no number"),
        ("", "no number"),
    ] {
        assert_sentence(&optimise(&["simulate", "bench-small", "--theta", theta]), 2, about);
    }
}

#[test]
fn inspect_tells_what_a_plan_holds() {
    let place = Place::new();
    let plan = format!("{}/skill.plan", place.finished("run", 1));
    let text = optimise(&["inspect", &plan]).out;
    for part in ["scooping depth", "uses", "steps of 10000 us", "workspace", "digest"] {
        assert!(text.contains(part), "{part} in {text}");
    }
    let report: Value = serde_json::from_str(&optimise(&["inspect", &plan, "--json"]).out).unwrap();
    assert!(report["limit_use"]["linear_jerk"].as_f64().unwrap() <= 1.0 && report["limit_broken"].is_null());
    assert_eq!(report["parameters"][4]["unit"], "rad");
}

#[test]
fn what_is_no_plan_is_refused() {
    let place = Place::new();
    let plan = format!("{}/skill.plan", place.finished("run", 1));
    let sound = fs::read(&plan).unwrap();
    let broken = place.text("broken.plan");
    for (contents, about) in [(&sound[..100], "checksum"), (b"hello, world", "begins with"), (b"", "0 bytes")]
    {
        fs::write(&broken, contents).unwrap();
        assert_sentence(&optimise(&["inspect", &broken]), 2, about);
        assert_sentence(&optimise(&["simulate", "--plan", &broken]), 2, about);
    }
    assert_sentence(&optimise(&["inspect", &place.text("none")]), 2, "there is no such file");
}

#[test]
fn scene_without_a_motion_for_every_skill_is_refused() {
    let place = Place::new();
    let mut scene = Scene::load("bench-small").unwrap().into_spec();
    scene.skill.profile = powderline_simulator::scene::Profile::ConstantSpeed;
    let path = place.text("jerky.toml");
    fs::write(&path, scene.to_toml()).unwrap();
    assert_sentence(&optimise(&[&path, "--out", &place.text("run")]), 2, "linear acceleration");
    assert!(!place.path("run").exists());
}

/// `optimise bench` with the smallest bed and these arguments.
fn bench(arguments: &[&str]) -> Done {
    optimise(&[&["bench", "--particles", "1000", "--grid", "16", "--steps", "30"], arguments].concat())
}

/// Numbers of the rows of a report's table, those of `part` only.
fn column(report: &Value, table: &str, part: Option<&str>, key: &str) -> Vec<f64> {
    let rows = report[table].as_array().unwrap().iter();
    let rows = rows.filter(|row| part.is_none_or(|part| row["part"] == part));
    rows.map(|row| row[key].as_f64().unwrap_or_else(|| panic!("{key} in {row}"))).collect()
}

#[test]
fn bench_reports_stages_that_add_up_to_no_more_than_the_whole() {
    for precision in ["f32", "f64"] {
        let done = bench(&["--threads", "2", "--precision", precision, "--json"]);
        assert_eq!(done.code, 0, "{}", done.err);
        let report: Value = serde_json::from_str(&done.out).unwrap();
        assert_eq!((&report["precision"], &report["threads"]), (&precision.into(), &2.into()));
        assert_eq!((&report["particles"], &report["grid"]), (&1000.into(), &16.into()));
        assert_eq!((&report["substeps"], &report["warm_up_substeps"]), (&40.into(), &40.into()));

        let sum = |part: &str, key: &str| column(&report, "stages", Some(part), key).iter().sum::<f64>();
        for key in ["mean_ns", "operations", "divisions_and_roots"] {
            let [forward, gradient] = column(&report, "whole", None, key)[..] else { panic!("two rows") };
            let advances = report["whole"][1]["advances"].as_f64().unwrap();
            let [once, adjoint] = [sum("forward", key), sum("adjoint", key)];
            assert!(once > 0.0, "{key}");
            if key == "mean_ns" {
                // Stages lie within the whole; which of them takes longer is the machine's affair.
                assert!(once <= forward && adjoint <= gradient, "{once} {forward} {adjoint} {gradient}");
            } else {
                assert!(adjoint > once, "{key}: {once} {adjoint}");
                assert!((once - forward).abs() < 1e-6 * once, "{key}: {once} {forward}");
                assert!((advances * once + adjoint - gradient).abs() < 1e-6 * gradient, "{key}: {gradient}");
            }
        }
        assert_eq!(column(&report, "whole", None, "kept_states"), [0.0, 5.0]);
        for table in ["stages", "whole"] {
            let rows = report[table].as_array().unwrap();
            assert_eq!(rows.len(), if table == "whole" { 2 } else { 14 });
            let middle = column(&report, table, None, "median_ns");
            for (row, (min, median)) in
                rows.iter().zip(column(&report, table, None, "min_ns").into_iter().zip(middle))
            {
                assert!(0.0 < min && min <= median, "{row}");
                let computes = row["operations"].as_f64().unwrap() > 0.0;
                assert_eq!(computes, row["multiple"].as_f64().is_some_and(|m| m > 0.0), "{row}");
                assert_eq!(computes, row["floor_ns"].as_f64().unwrap() > 0.0, "{row}");
            }
        }
        let filled = report["filled_lanes"].as_f64().unwrap();
        assert!(filled > 0.5 && filled <= 1.0);
        let of = |table: &str, key: &str| report[table][key].as_f64().unwrap();
        assert!(of("machine", "fma_gflops") > 0.0 && of("machine", "read_gb_per_s") > 0.0);
        assert!(of("memory", "peak_bytes") >= of("memory", "forward_peak_bytes"));
        let scalar_bytes = if precision == "f32" { 4.0 } else { 8.0 };
        assert!((of("memory", "traffic_bytes_per_particle") - 2.0 * 22.0 * scalar_bytes).abs() < 1e-9);
    }
}

#[test]
fn bench_without_gradient_has_no_adjoint() {
    let done = bench(&["--forward-only", "--json"]);
    let report: Value = serde_json::from_str(&done.out).unwrap();
    assert_eq!(column(&report, "whole", None, "advances"), [1.0]);
    let parts = report["stages"].as_array().unwrap().iter().map(|row| row["part"].as_str().unwrap());
    assert_eq!(parts.collect::<Vec<_>>(), ["forward"; 4]);

    let text = bench(&["--forward-only"]).out;
    for part in ["1,000 particles in 16^3 cells, f32, 1 thread", "particles to grid", "Peak memory"] {
        assert!(text.contains(part), "{part} in {text}");
    }
    assert!(!text.contains("adjoint"), "{text}");
}

/// The smallest of benches, of a powder that is soft and coarse.
fn coarse_scene(place: &Place) -> String {
    let scene = Scene::load("bench-small").unwrap().with(|spec| {
        spec.name = "coarse".into();
        spec.powder.particles_per_cell = 1;
        spec.time.settle_s = 0.05;
    });
    let path = place.text("coarse.toml");
    fs::write(&path, scene.unwrap().to_toml()).unwrap();
    path
}

#[test]
fn bench_says_where_the_time_of_a_scenes_rollout_goes() {
    let place = Place::new();
    let scene = coarse_scene(&place);
    let done = optimise(&["bench", "--scene", &scene, "--theta=0.3,0,0,0,0.3", "--threads", "2", "--json"]);
    assert_eq!(done.code, 0, "{}", done.err);
    let report: Value = serde_json::from_str(&done.out).unwrap();
    assert_eq!((&report["scene"], &report["threads"]), (&"coarse".into(), &2.into()));
    assert_eq!(report["theta"].as_array().unwrap()[4], 0.3);
    let [forward, gradient] = &report["runs"].as_array().unwrap()[..] else { panic!("two runs") };
    for (run, stages) in [(forward, 4), (gradient, 10)] {
        let times = column(run, "stages", None, "wall_s");
        assert_eq!(times.len(), stages, "{run}");
        assert!(
            times.iter().all(|time| *time >= 0.0)
                && times.iter().sum::<f64>() <= run["wall_s"].as_f64().unwrap()
        );
    }
    assert_eq!(forward["advances"], 1.0);
    assert!(gradient["advances"].as_f64().unwrap() >= 1.0 && gradient["stages"][4]["part"] == "adjoint");

    let text = optimise(&["bench", "--scene", &scene, "--forward-only"]).out;
    for part in [
        "coarse, ",
        "f32, 1 thread; settled in",
        "grid update, with contact",
        "what is between them",
        "100.0 %",
    ] {
        assert!(text.contains(part), "{part} in {text}");
    }
    assert!(!text.contains("adjoint"), "{text}");
}

#[test]
fn bench_of_a_scene_refuses_in_one_sentence() {
    for (arguments, about) in [
        (&["--scene", "nowhere"][..], "nowhere"),
        (&["--scene", "bench-small", "--theta", "0,0,0"], "there are 3"),
        (&["--scene", "bench-small", "--memory", "2MiB"], "memory"),
    ] {
        assert_sentence(&optimise(&[&["bench"], arguments].concat()), 2, about);
    }
}

#[test]
fn bench_refuses_in_one_sentence() {
    for (arguments, about) in [
        (["--particles", "999"], "--particles is a number from 1,000 to 4,000,000, and 999 is not"),
        (["--particles", "4000001"], "4000001 is not"),
        (["--grid", "15"], "--grid is a number from 16 to 256"),
        (["--steps", "0"], "--steps is a number from 1 to 1,000,000"),
        (["--particles", "400000"], "a bed of about 169,"),
        (["--memory", "100MiB"], "20,000 particles need about 3"),
    ] {
        let grid: &[&str] = if arguments[1] == "400000" { &["--grid", "32"] } else { &[] };
        assert_sentence(&optimise(&[&["bench"], &arguments[..], grid].concat()), 2, about);
    }
    assert_sentence(&bench(&["--memory", "100MiB"]), 2, "or for --forward-only");
    let done = bench(&["--memory", "100MiB", "--forward-only"]);
    assert_sentence(&done, 2, "ask for fewer");
    assert!(!done.err.contains("forward-only"));
}

/// What makes simulators of its own, so that no stand-in sees whether it listens.
#[test]
fn what_measures_stops_on_request() {
    let commands: [&[&str]; 4] = [
        &["bench", "--particles", "1000"],
        &["bench", "--scene", "bench-small"],
        &["gradcheck", "bench-small", "--short"],
        &["gradcheck", "bench-small", "--skills", "2", "--json"],
    ];
    for command in commands {
        let interrupt = Interrupt::default();
        interrupt.request();
        let mut out = Vec::new();
        let mut context = Context {
            factory: &|_, _| unreachable!(),
            interrupt,
            out: &mut out,
            err: Buffer::default().into(),
            live: false,
        };
        let stopped = execute(["optimise"].iter().chain(command), &mut context);
        assert_eq!(stopped.map_err(|error| error.code()), Err(130), "{command:?}");
        // A table that has no skill yet is shown as that.
        let table = command.contains(&"--json").then(|| serde_json::from_slice::<Value>(&out).unwrap());
        assert!(table.map_or(out.is_empty(), |table| table["skills"].as_array().unwrap().is_empty()));
    }
}
