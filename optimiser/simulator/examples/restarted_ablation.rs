//! The restarted gradient of named skills with its settings changed one at a time, beside the slope, and what happens at its cuts.
//!
//!     cargo run --release -p powderline-simulator --example restarted_ablation SCENE SKILLS [VARIANT...]
//!
//! SKILLS are numbers of the list below, as in `0,3,6`, or drawn ones as `optimise gradcheck` numbers them, as in `draw603`. A VARIANT is a list of words; without any, all of `VARIANTS` are tried.
//!
//! | word | sets |
//! |---|---|
//! | `cuts=insert+scoop:4+lift` | cuts at that many equal parts' ends of a segment, its end the last |
//! | `radius=0.006` | `Restarts::radius_m` |
//! | `ahead=0.02` | `Restarts::ahead_s` |
//! | `room=0.004` | `Restarts::room_m` |
//! | `from=scoop` | tool and powder as one body from the end of that segment on; `never`: the adjoint goes through all of the motion |
//! | `over=transport` | the segment over which the body is moved |
//! | `ways=3` | only so many of the ways, as in `Carrying::ways` |
//! | `sleep=0.02` | `Carrying::sleep_speed_m_s` |
//! | `residue=0` | `Restarts::through_residue` |
//! | `bed=0` | `Restarts::through_bed` |
//! | `end=0` | `Restarts::begins_with_slopes` |
//! | `trace=1` | shows the cuts |

use std::ops::Range;

use powderline_simulator::bench::cpu_seconds;
use powderline_simulator::rollout::restart::{Carrying, Restarted, Restarts};
use powderline_simulator::rollout::slopes::{HALF_STEP, cosine, skill as drawn};
use powderline_simulator::rollout::{RolloutError, Simulate, Simulator, SimulatorSettings};
use powderline_simulator::scene::Scene;
use powderline_simulator::skill::{SegmentKind, SkillMap, SkillParameter, Theta, ThetaGradient};

type Failure = Box<dyn std::error::Error>;

/// Those by which the settings were chosen: not drawn, so that drawn ones can judge.
const SKILLS: [[f64; 5]; 7] = [
    [0.3, 0.0, 0.0, 0.0, 0.3],
    [0.21, -0.37, 0.12, 0.33, 0.45],
    [-0.31, 0.42, -0.22, -0.15, 0.18],
    [0.45, 0.25, 0.38, 0.08, -0.12],
    [-0.08, -0.18, -0.41, 0.27, 0.36],
    [0.05, 0.35, 0.2, -0.4, -0.33],
    [0.6, 0.5, 0.0, 0.1, 0.8],
];

const VARIANTS: [&str; 17] = [
    "",
    "from=never",
    "from=never end=0",
    "from=never cuts=scoop:4+lift+transport+pour:4",
    "from=scoop",
    "ways=0",
    "over=transport",
    "cuts=scoop",
    "cuts=insert+scoop:2",
    "cuts=insert+scoop:8",
    "radius=0.004",
    "radius=0.010",
    "ahead=0.02",
    "room=0",
    "residue=0",
    "bed=0",
    "sleep=0.002",
];

fn main() -> Result<(), Failure> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let scene = Scene::load(arguments.first().map_or("bench-small", String::as_str))?;
    let skills = arguments.get(1).map_or("0,1", String::as_str);
    let given: Vec<&str> = arguments.iter().skip(2).map(String::as_str).collect();
    let variants = if given.is_empty() { VARIANTS.to_vec() } else { given };
    let map = SkillMap::new(&scene);
    let settings = SimulatorSettings::default();
    let mut simulator = Simulator::<f32>::new(&scene, &settings)?;
    for skill in skills.split(',') {
        let theta = &match skill.strip_prefix("draw") {
            Some(number) => drawn(number.parse()?),
            None => Theta::new(*SKILLS.get(skill.parse::<usize>()?).ok_or("there is no such skill")?)?,
        };
        let (slope, rollout_s) = slope(&mut simulator, theta)?;
        println!("skill {skill}: slope {}", shown(&slope));
        for words in &variants {
            let (restarts, traces) = variant(&scene, &map, theta, words)?;
            let from_s = cpu_seconds();
            let found = simulator.evaluate_restarted(theta, &restarts)?;
            let rollouts = (cpu_seconds() - from_s) / rollout_s;
            let longer = length(&found.gradient) / length(&slope);
            println!(
                "{} cosine {:5.2} length {longer:5.2} rollouts {rollouts:4.1}  {words}",
                shown(&found.gradient),
                cosine(&found.gradient, &slope)
            );
            if traces {
                trace(&found);
            }
        }
    }
    Ok(())
}

/// Central differences over what a search might step, metres, and processor time of one of their rollouts, seconds.
fn slope(simulator: &mut dyn Simulate, theta: &Theta) -> Result<(ThetaGradient, f64), RolloutError> {
    let both_ways = |which| [HALF_STEP, -HALF_STEP].map(|step| theta.moved(which, step));
    let both: Vec<Theta> = SkillParameter::ALL.into_iter().flat_map(both_ways).collect();
    // Settles the powder, so that it counts nowhere.
    simulator.evaluate_all(&[])?;
    let from_s = cpu_seconds();
    let ends = simulator.evaluate_all(&both)?;
    let rollout_s = (cpu_seconds() - from_s) / both.len() as f64;
    let slope = std::array::from_fn(|k| (ends[2 * k].loss - ends[2 * k + 1].loss) / (2.0 * HALF_STEP));
    Ok((slope, rollout_s))
}

fn variant(scene: &Scene, map: &SkillMap, theta: &Theta, words: &str) -> Result<(Restarts, bool), Failure> {
    let mut restarts = Restarts::of_skill(scene, map, theta);
    let mut traces = false;
    for word in words.split_whitespace() {
        let (key, value) = word.split_once('=').ok_or("a word is KEY=VALUE")?;
        match key {
            "cuts" => restarts.steps = cuts(scene, map, theta, value)?,
            "radius" => restarts.radius_m = value.parse()?,
            "ahead" => restarts.ahead_s = value.parse()?,
            "room" => restarts.room_m = value.parse()?,
            "from" if value == "never" => restarts.carrying = None,
            "from" => carrying(&mut restarts)?.from = spans(scene, map, theta, value)?.end,
            "over" => carrying(&mut restarts)?.over = spans(scene, map, theta, value)?,
            "ways" => carrying(&mut restarts)?.ways.truncate(value.parse()?),
            "sleep" => carrying(&mut restarts)?.sleep_speed_m_s = value.parse()?,
            "bed" => restarts.through_bed = value == "1",
            "residue" => restarts.through_residue = value == "1",
            "end" => restarts.begins_with_slopes = value == "1",
            "trace" => traces = value == "1",
            _ => return Err(format!("there is no {key}").into()),
        }
    }
    Ok((restarts, traces))
}

fn carrying(restarts: &mut Restarts) -> Result<&mut Carrying, Failure> {
    Ok(restarts.carrying.as_mut().ok_or("it carries nothing")?)
}

/// Control steps of a segment.
fn spans(scene: &Scene, map: &SkillMap, theta: &Theta, name: &str) -> Result<Range<usize>, Failure> {
    let kind = match name {
        "insert" => SegmentKind::Insert,
        "scoop" => SegmentKind::Scoop,
        "lift" => SegmentKind::Lift,
        "transport" => SegmentKind::Transport,
        "pour" => SegmentKind::Pour,
        _ => return Err(format!("there is no segment {name}").into()),
    };
    let segments = map.segments(theta);
    let segment = segments.iter().find(|segment| segment.kind == kind).ok_or("there is no such segment")?;
    let step = |time_s: f64| (time_s / scene.time.control_period_s()).round() as usize;
    Ok(step(segment.start_s)..step(segment.end_s))
}

fn cuts(scene: &Scene, map: &SkillMap, theta: &Theta, text: &str) -> Result<Vec<usize>, Failure> {
    let mut steps = Vec::new();
    for part in text.split('+') {
        let (name, count) = part.split_once(':').unwrap_or((part, "1"));
        let (span, count): (_, usize) = (spans(scene, map, theta, name)?, count.parse()?);
        steps.extend((1..=count).map(|part| span.start + part * span.len() / count));
    }
    steps.sort_unstable();
    steps.dedup();
    Ok(steps)
}

/// What the controls before, between and after the cuts bring, and what the cuts put in the place of what.
fn trace(found: &Restarted) {
    let row = |numbers: &[f64]| numbers.iter().map(|x| format!("{x:9.1}")).collect::<String>();
    for (index, share) in found.shares.iter().enumerate() {
        println!("    controls   {}", shown(share));
        let Some(cut) = found.cuts.get(index) else { continue };
        println!("    cut {:4}   tool {} -> {}", cut.step, row(&cut.tool_before), row(&cut.tool_after));
        for (name, grains) in [("carried", cut.carried), ("moving", cut.moving), ("resting", cut.resting)] {
            let (exact, slopes) = (row(&grains.exact), row(&grains.slopes));
            let largest = row(&[grains.largest_exact, grains.largest_slope]);
            println!("      {:5} {name:8} {exact} -> {slopes}, largest {largest}", grains.grains);
        }
    }
}

fn length(gradient: &ThetaGradient) -> f64 {
    gradient.iter().map(|x| x * x).sum::<f64>().sqrt()
}

fn shown(gradient: &ThetaGradient) -> String {
    gradient.map(|x| format!("{x:9.3}")).join(" ")
}
