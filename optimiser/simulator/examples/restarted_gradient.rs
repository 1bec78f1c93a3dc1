//! The gradient of a skill by the exact adjoint, by the restarted one, and the slope over a step that a search might take.
//!
//!     cargo run --release -p powderline-simulator --example restarted_gradient [SCENE [SKILLS [FIRST_DRAW]]]
//!
//! Skills are drawn from all of theta's range, always the same ones; those that deliver fewer than 20 particles are left out.
//! Two packings are averaged. At the end: cosines with the slope, and how long a gradient is beside it.

use powderline_simulator::rollout::restart::Restarts;
use powderline_simulator::rollout::{ParticleSimulator, RolloutError, SimulatorSettings, boxed_simulator};
use powderline_simulator::scene::Scene;
use powderline_simulator::skill::{SkillMap, Theta};

/// Of the differences, in units of theta.
const HALF_STEP: f64 = 0.1;
const PACKINGS: [u64; 2] = [1, 2];
const LEAST_DELIVERED: u32 = 20;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let scene = Scene::load(&arguments.next().unwrap_or("bench-small".into()))?;
    let mut number = |usual: u64| arguments.next().map_or(Ok(usual), |text| text.parse());
    let (skills, first) = (number(5)?, number(0)?);
    let map = SkillMap::new(&scene);
    let packed = |seed| boxed_simulator(&scene, &SimulatorSettings { seed, ..SimulatorSettings::default() });
    let mut simulators = PACKINGS.map(packed).into_iter().collect::<Result<Vec<_>, _>>()?;
    let (mut rows, mut draw) = (Vec::new(), first);
    while (rows.len() as u64) < skills {
        let theta = skill(draw);
        draw += 1;
        let delivered = simulators[0].evaluate(&theta, false, &mut |_, _| true)?.census.target;
        if delivered < LEAST_DELIVERED {
            continue;
        }
        let restarts = Restarts::of_skill(&scene, &map, &theta);
        let mut mean = [[0.0; 5]; 3];
        for simulator in &mut simulators {
            for (mean, one) in mean.iter_mut().zip(gradients(simulator.as_mut(), &theta, &restarts)?) {
                (0..5).for_each(|k| mean[k] += one[k] / PACKINGS.len() as f64);
            }
        }
        let [slope, exact, restarted] = mean;
        println!("skill {} {}, {delivered} particles", draw - 1, shown(&theta));
        println!("  slope     {}", shown(&slope));
        println!("  exact     {}  cosine {:.2}", shown(&exact), cosine(&exact, &slope));
        println!("  restarted {}  cosine {:.2}", shown(&restarted), cosine(&restarted, &slope));
        rows.push(mean);
    }
    for (name, index) in [("exact", 1), ("restarted", 2)] {
        let ordered = |of: &dyn Fn(&[Theta; 3]) -> f64| {
            let mut all: Vec<f64> = rows.iter().map(of).collect();
            all.sort_by(f64::total_cmp);
            all
        };
        let cosines = ordered(&|row| cosine(&row[index], &row[0]));
        let lengths = ordered(&|row| length(&row[index]) / length(&row[0]));
        let median = |all: &[f64]| all[all.len() / 2];
        println!(
            "{name}: cosine {:.2} in the median, {:.2} at worst; {:.2} times as long in the median, {:.2} to {:.2}",
            median(&cosines),
            cosines[0],
            median(&lengths),
            lengths[0],
            lengths[lengths.len() - 1]
        );
    }
    Ok(())
}

/// Slope by central differences, exact and restarted gradient.
fn gradients(
    simulator: &mut dyn ParticleSimulator,
    theta: &Theta,
    restarts: &Restarts,
) -> Result<[Theta; 3], RolloutError> {
    let go_on = &mut |_, _| true;
    let moved = |k: usize, step: f64| {
        let mut moved = *theta;
        moved[k] += step;
        moved
    };
    let both_ways: Vec<Theta> = (0..5).flat_map(|k| [moved(k, HALF_STEP), moved(k, -HALF_STEP)]).collect();
    let ends = simulator.evaluate_all(&both_ways, go_on)?;
    let slope = std::array::from_fn(|k| (ends[2 * k].loss - ends[2 * k + 1].loss) / (2.0 * HALF_STEP));
    let exact = simulator.evaluate(theta, true, go_on)?.gradient.unwrap_or_default();
    let restarted = simulator.evaluate_restarted(theta, restarts, go_on)?.gradient.unwrap_or_default();
    Ok([slope, exact, restarted])
}

/// Number `draw` of a sequence that fills theta's range evenly, its ends left out so that differences fit in.
fn skill(draw: u64) -> Theta {
    // Roberts 2018: powers of the root of x^6 = x + 1.
    const ROOT: f64 = 1.134_724_138_401_519_4;
    std::array::from_fn(|k| {
        let share = (0.5 + (draw + 1) as f64 / ROOT.powi(k as i32 + 1)).fract();
        (1.0 - HALF_STEP) * (2.0 * share - 1.0)
    })
}

fn length(a: &Theta) -> f64 {
    a.iter().map(|x| x * x).sum::<f64>().sqrt()
}

fn cosine(a: &Theta, b: &Theta) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>() / (length(a) * length(b))
}

fn shown(theta: &Theta) -> String {
    theta.map(|x| format!("{x:9.3}")).join(" ")
}
