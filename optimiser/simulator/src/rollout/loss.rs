//! The loss of a motion, and its gradient.
//!
//! | symbol | meaning                                                                          |
//! |--------|----------------------------------------------------------------------------------|
//! | d_i    | distance of particle i from `p_target` at the end, in the scene's norm           |
//! | n      | wanted particles                                                                 |
//! | D      | distance from `p_target` of the point of the source's inside that is nearest it  |
//! | a_i    | how far particle i is beside the inside of the container that it is nearest to, seen from above |
//! | t      | that container's wall thickness                                                  |
//! | w      | `lost_weight`                                                                    |
//!
//! The paper's loss is the sum of all d_i ([`Aim::All`]): its minimum is as much powder as can be had, at `p_target`. With
//! [`Aim::Amount`] the n nearest particles count as in the paper, and each of the others by what it lies nearer to
//! `p_target` than the source does, max(0, D - d_i). A particle that is missing costs about as much as one too many, so the
//! minimum is the wanted amount at `p_target` and the rest where it came from.
//!
//! What ends on rims or beside the containers costs w D a^2 / (a^2 + t^2) more, with either aim: a fifth of w D in the middle of a
//! wall, half at its outer side, nearly all farther off. It begins with no slope, so that powder which leans on a wall feels nothing.

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

use crate::scene::{Aim, Norm, Observation, Scene};

/// Loss, metres, and its gradient with respect to the position of every particle.
pub(crate) fn loss(scene: &Scene, positions: &[[f64; 3]]) -> (f64, Vec<[f64; 3]>) {
    let from_target = |p: &[f64; 3]| distance(scene.objective.norm, p, &scene.objective.p_target_m);
    let seen = observed(scene, positions);
    let mut ranked: Vec<(f64, usize)> = seen.iter().map(|&id| (from_target(&positions[id]).0, id)).collect();
    let wanted = wanted(scene, seen.len(), positions.len());
    if wanted < ranked.len() {
        // By identity among equals, so that the choice is the same every time.
        ranked.select_nth_unstable_by(wanted, |a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        // The sum is rounded, so its order matters, and the selection's is its own affair.
        ranked[..wanted].sort_unstable_by_key(|(_, id)| *id);
        ranked[wanted..].sort_unstable_by_key(|(_, id)| *id);
    }
    let away = scene.source_distance_m();
    let mut sum = 0.0;
    let mut gradient = vec![[0.0; 3]; positions.len()];
    for (rank, &(d, id)) in ranked.iter().enumerate() {
        if rank < wanted {
            sum += d;
            gradient[id] = from_target(&positions[id]).1;
        } else if d < away {
            sum += away - d;
            gradient[id] = from_target(&positions[id]).1.map(|slope| -slope);
        }
    }
    if scene.objective.lost_weight > 0.0 {
        let dear = scene.objective.lost_weight * away;
        for &id in &seen {
            let (share, slope) = lost(scene, &positions[id]);
            sum += dear * share;
            gradient[id] = [0, 1, 2].map(|axis| gradient[id][axis] + dear * slope[axis]);
        }
    }
    (sum, gradient)
}

/// What each particle costs, metres, by identity; none of those that the loss does not see. A constant more or less does not matter.
///
/// The loss is no sum over particles where an amount is wanted, since they compete for being among the nearest. One that comes
/// nearer than the n-th, d_n, takes its place: it costs d_i where that is below d_n, and beyond d_n - max(0, D - d_n) + max(0, D - d_i),
/// which goes on from there. The difference between two places is then what moving one particle from one to the other
/// changes of the loss, the others as they are.
pub(crate) fn values(scene: &Scene, positions: &[[f64; 3]]) -> Vec<Option<f64>> {
    let from_target = |p: &[f64; 3]| distance(scene.objective.norm, p, &scene.objective.p_target_m).0;
    let seen = observed(scene, positions);
    let mut distances: Vec<f64> = seen.iter().map(|&id| from_target(&positions[id])).collect();
    distances.sort_unstable_by(f64::total_cmp);
    let wanted = wanted(scene, seen.len(), positions.len());
    let last = match distances.get(wanted.saturating_sub(1)..) {
        Some([at, beyond, ..]) => 0.5 * (at + beyond),
        _ => f64::INFINITY,
    };
    let away = scene.source_distance_m();
    let mut out = vec![None; positions.len()];
    for id in seen {
        let d = from_target(&positions[id]);
        let own = if d < last { d } else { last - (away - last).max(0.0) + (away - d).max(0.0) };
        let lost = scene.objective.lost_weight * away * lost(scene, &positions[id]).0;
        out[id] = Some(own + lost);
    }
    out
}

/// a^2 / (a^2 + t^2), and its gradient with respect to the position.
fn lost(scene: &Scene, p: &[f64; 3]) -> (f64, [f64; 3]) {
    let beside = scene.containers.iter().map(|container| {
        let aside = container.beside_m(p);
        (aside[0] * aside[0] + aside[1] * aside[1], aside, container.wall_thickness_m)
    });
    let nearest = beside.min_by(|a, b| a.0.total_cmp(&b.0));
    let Some((square, [x, y], wall_m)) = nearest else { return (0.0, [0.0; 3]) };
    let sum = square + wall_m * wall_m;
    let rise = 2.0 * wall_m * wall_m / (sum * sum);
    (square / sum, [rise * x, rise * y, 0.0])
}

/// How many of the `seen` particles are wanted at the target point.
fn wanted(scene: &Scene, seen: usize, all: usize) -> usize {
    match scene.objective.aim {
        Aim::All => seen,
        Aim::Amount => (scene.target_count() * seen + all / 2).checked_div(all).unwrap_or(0).max(1),
    }
}

/// Distance of two points, and its gradient with respect to the first.
fn distance(norm: Norm, p: &[f64; 3], target: &[f64; 3]) -> (f64, [f64; 3]) {
    let d = [0, 1, 2].map(|i| p[i] - target[i]);
    let length = norm.length(&d);
    let slope = match norm {
        Norm::Euclidean => d.map(|x| if length > 0.0 { x / length } else { 0.0 }),
        Norm::L1 => d.map(|x| if x == 0.0 { 0.0 } else { x.signum() }),
    };
    (length, slope)
}

/// Which particles the loss sees, by identity.
///
/// The choice is a constant for the gradient: it flows through the positions of the particles seen.
pub(crate) fn observed(scene: &Scene, positions: &[[f64; 3]]) -> Vec<usize> {
    match scene.objective.observation {
        Observation::All => (0..positions.len()).collect(),
        Observation::Subsample { particles } => {
            subsample(scene.powder.seed, positions.len(), particles as usize)
        }
        Observation::VisibleFromAbove { pixel_m } => visible_from_above(positions, pixel_m),
    }
}

/// The first `wanted` of a Fisher-Yates shuffle, in ascending order.
fn subsample(seed: u64, count: usize, wanted: usize) -> Vec<usize> {
    // A stream of its own, so that the packing and the subsample do not share random numbers.
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    random.set_stream(1);
    let mut all: Vec<usize> = (0..count).collect();
    let wanted = wanted.min(count);
    for i in 0..wanted {
        let j = i + (random.next_u64() % (count - i) as u64) as usize;
        all.swap(i, j);
    }
    all.truncate(wanted);
    all.sort_unstable();
    all
}

/// The highest particle of each pixel column.
fn visible_from_above(positions: &[[f64; 3]], pixel_m: f64) -> Vec<usize> {
    let mut highest = std::collections::BTreeMap::new();
    for (id, [x, y, z]) in positions.iter().enumerate() {
        let pixel = ((x / pixel_m).floor() as i64, (y / pixel_m).floor() as i64);
        let best = highest.entry(pixel).or_insert(id);
        if *z > positions[*best][2] {
            *best = id;
        }
    }
    let mut out: Vec<usize> = highest.into_values().collect();
    out.sort_unstable();
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{Amount, Quantity};

    /// Ten particles on a line through the target point: at 0, 1, .. 9 cm from it.
    fn line(scene: &Scene) -> Vec<[f64; 3]> {
        let [x, y, z] = scene.objective.p_target_m;
        (0..10).map(|i| [x - 0.01 * f64::from(i), y, z]).collect()
    }

    fn scene(aim: Aim, particles: u32) -> Scene {
        let mut scene = Scene::load("bench").expect("shipped");
        scene.objective.aim = aim;
        scene.objective.lost_weight = 0.0;
        scene.objective.amount = Amount::new(Quantity::Particles(particles));
        scene
    }

    #[test]
    fn the_paper_draws_every_particle_to_the_target() {
        let scene = scene(Aim::All, 4);
        let (sum, gradient) = loss(&scene, &line(&scene));
        assert!((sum - 0.45).abs() < 1e-12);
        assert!(gradient[1..].iter().all(|g| (g[0] + 1.0).abs() < 1e-12));
    }

    #[test]
    fn the_wanted_amount_is_drawn_to_the_target_and_the_rest_back_to_the_source() {
        let scene = scene(Aim::Amount, 4);
        // The source's inner wall, in `bench`.
        let away = 0.176 - 0.088;
        let (sum, gradient) = loss(&scene, &line(&scene));
        let expected = 0.01 + 0.02 + 0.03 + (4..=8).map(|i| away - 0.01 * f64::from(i)).sum::<f64>();
        assert!((sum - expected).abs() < 1e-12, "{sum} {expected}");
        let signs: Vec<f64> = gradient.iter().map(|g| g[0].round()).collect();
        assert_eq!(signs, [0.0, -1.0, -1.0, -1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 0.0]);
    }

    #[test]
    fn one_too_few_costs_as_one_too_many() {
        let scene = scene(Aim::Amount, 5);
        let [_, y, z] = scene.objective.p_target_m;
        let of = |arrived: usize| {
            let place = |i| if i < arrived { scene.objective.p_target_m } else { [0.088, y, z] };
            loss(&scene, &(0..10).map(place).collect::<Vec<_>>()).0
        };
        assert!(of(5).abs() < 1e-12);
        assert!((of(4) - 0.088).abs() < 1e-12 && (of(6) - 0.088).abs() < 1e-12);
    }

    /// From the inside of the target outwards over its wall of 4 mm.
    #[test]
    fn what_is_lost_costs_up_to_its_weight() {
        let mut scene = scene(Aim::Amount, 4);
        let [_, y, _] = scene.objective.p_target_m;
        let inner_x = 0.208;
        let at = |scene: &Scene, beside_m: f64| {
            loss(scene, &[[[inner_x + beside_m, y, 0.046]; 4].as_slice(), &[[0.05, y, 0.01]; 6]].concat()).0
        };
        let plain = [-0.001, 0.0, 0.002, 0.004, 0.040].map(|beside_m| at(&scene, beside_m));
        scene.objective.lost_weight = 2.0;
        let weighed = [-0.001, 0.0, 0.002, 0.004, 0.040].map(|beside_m| at(&scene, beside_m));
        let missing = 0.088;
        for ((plain, weighed), share) in plain.iter().zip(weighed).zip([0.0, 0.0, 0.2, 0.5, 100.0 / 101.0]) {
            let expected = 4.0 * 2.0 * missing * share;
            assert!((weighed - plain - expected).abs() < 1e-9, "{share}: {}", weighed - plain);
        }
    }

    #[test]
    fn a_subsample_is_wanted_in_proportion() {
        let mut scene = scene(Aim::Amount, 400);
        scene.objective.observation = Observation::Subsample { particles: 100 };
        let at = |arrived: usize| {
            let place = |i| if i < arrived { scene.objective.p_target_m } else { [0.0, 0.048, 0.01] };
            loss(&scene, &(0..1000).map(place).collect::<Vec<_>>()).0
        };
        // All of it or nothing is wrong; about four in ten is right.
        assert!(at(400) < 0.3 * at(0) && at(400) < 0.3 * at(1000), "{} {} {}", at(0), at(400), at(1000));
    }

    #[test]
    fn of_the_smallest_amount_one_particle_is_wanted_in_any_subsample() {
        let mut scene = scene(Aim::Amount, 1);
        scene.objective.observation = Observation::Subsample { particles: 3 };
        let far = vec![[0.0, 0.048, 0.01]; 1000];
        assert!(loss(&scene, &far).0 > 0.17, "bringing nothing is not what is wanted");
    }

    /// Moving one particle changes the loss as it changes what the particle costs, as long as no other's place in the ranking changes.
    #[test]
    fn what_a_particle_costs_is_what_moving_it_changes() {
        for (aim, lost_weight) in [(Aim::All, 0.0), (Aim::Amount, 0.0), (Aim::Amount, 2.0)] {
            let mut scene = scene(aim, 6);
            scene.objective.lost_weight = lost_weight;
            let mut places = line(&scene);
            // Many at one distance, so that one more or less does not move the sixth.
            places.extend([places[4]; 4]);
            let at = |to: usize| {
                let mut moved = places.clone();
                moved[0] = places[to];
                (loss(&scene, &moved).0, values(&scene, &moved)[0].unwrap())
            };
            let (loss_there, cost_there) = at(2);
            for to in [1, 3, 6, 8] {
                let (loss, cost) = at(to);
                assert!(
                    (loss - loss_there - (cost - cost_there)).abs() < 1e-12,
                    "{aim:?} {to}: {loss} {cost}"
                );
            }
        }
    }

    #[test]
    fn gradient_is_the_slope() {
        for (aim, norm, lost_weight) in [
            (Aim::All, Norm::L1, 0.0),
            (Aim::Amount, Norm::Euclidean, 0.0),
            (Aim::Amount, Norm::L1, 0.0),
            (Aim::Amount, Norm::Euclidean, 3.0),
        ] {
            let mut scene = scene(aim, 4);
            scene.objective.norm = norm;
            scene.objective.lost_weight = lost_weight;
            // Turned, the way back is along neither axis.
            scene.containers[1].yaw_deg = 20.0;
            let mut places: Vec<[f64; 3]> = line(&scene);
            places.iter_mut().zip(1..).for_each(|(p, i)| p[1] += 1e-3 * f64::from(i));
            let (_, gradient) = loss(&scene, &places);
            for id in 0..places.len() {
                for axis in 0..3 {
                    let mut at = |step: f64| {
                        places[id][axis] += step;
                        let there = loss(&scene, &places).0;
                        places[id][axis] -= step;
                        there
                    };
                    let slope = (at(1e-7) - at(-1e-7)) / 2e-7;
                    // At the target's own coordinate the L1 norm has a kink.
                    let kink = norm == Norm::L1 && (axis == 2 || id == 0);
                    assert!(
                        kink || (gradient[id][axis] - slope).abs() < 1e-5,
                        "{id} {axis} {slope} {lost_weight}"
                    );
                }
            }
        }
    }
}
