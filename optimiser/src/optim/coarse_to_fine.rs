//! Coarse first, fine second: a search by what a [`Surrogate`] guesses of two worlds.
//!
//! Epoch 0 makes [`FIRST_TRIALS`] in the coarse world: the skill that the seed draws, and others all over the range. Each further
//! epoch makes [`COARSE_TRIALS`] there, the first where the surrogate expects the lowest loss, the others where it expects most gain
//! below the best known (expected improvement; Mockus 1975, Jones et al. 1998), each as if those before had come out as guessed. After
//! [`COARSE_EPOCHS`] the coarse world has told what it can, unless its best skill is still off what is wanted or its loss still falls: a rollout costs
//! a third of one of the scene itself there, so it is where a search that has farther to go goes on, for [`COARSE_EPOCHS_ON_THE_WAY`] at most.
//!
//! From then on each epoch makes [`FINE_TRIALS`] in the scene itself, as a plan would ship them: at first where the lowest loss is expected, and
//! where it is farther away, in case the former is not what it seems; then where it is and where most is to be gained, both within a
//! box about the best skill of that world, of a third of the range at first. The surrogate learns what the
//! worlds differ by. How far it is to be believed, each epoch tells: where less than half of the fall came that was guessed, the box is
//! halved, else it grows by half (a trust region: Conn, Gould and Toint 2000; with models of two worlds: Alexandrov et al. 1998).
//!
//! A skill that the arm cannot perform is never asked for, as far as that is known before it is simulated. Where a scene has no coarse copy,
//! it is searched itself from the first.

use super::surrogate::{Edge, Known, Surrogate};
use super::{Epoch, Found, Problem, Search, SearchError, Step, Trial, World, check, unit};
use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};

/// Trials of epoch 0, and of each further epoch, in the coarse world.
const FIRST_TRIALS: usize = 8;
const COARSE_TRIALS: usize = 4;

/// Trials of an epoch in the scene itself.
const FINE_TRIALS: usize = 2;

/// Epochs in the coarse world, as a rule.
const COARSE_EPOCHS: u32 = 8;
/// At most, where its best skill is farther off what is wanted than [`COARSE_NEAR`], or the last epoch lowered the loss by [`COARSE_FALL`].
const COARSE_EPOCHS_ON_THE_WAY: u32 = 12;
/// At most, where less than half of what is wanted has ever arrived.
const COARSE_EPOCHS_WITHOUT_POWDER: u32 = 14;

/// Part of what is wanted that may be missing or too much in the coarse world, whose particles are larger, whatever the tolerance.
const COARSE_NEAR: f64 = 0.05;

/// Part of the loss by which an epoch has to lower it for the coarse world to go on.
const COARSE_FALL: f64 = 0.05;

/// How far from the middle the first trials go.
const FIRST_RANGE: f64 = 0.8;

/// Half the edge of the box in which the scene itself is searched: at first and at most, at the least, and how it changes. In the smallest
/// box what arrives still changes by more than its noise.
const WIDEST_BOX: f64 = 0.3;
const LEAST_BOX: f64 = 0.05;
const SHRINKING: f64 = 0.5;
const GROWING: f64 = 1.5;

/// Part of the fall that was guessed which has to come.
const BELIEVED: f64 = 0.5;

/// Two trials of an epoch differ by this in a component at the least: in the coarse world, and, over half the edge of the box, in the scene.
const COARSE_APART: f64 = 0.1;
const APART: f64 = 0.2;

/// Trials beyond this many, those with the highest losses, are forgotten: the work grows with their cube.
const MOST_KNOWN: usize = 160;

/// Places that are looked at: drawn from a box; and about each of the best, thrice, nearer each time.
const DRAWN: usize = 600;
const BEST: usize = 5;
const ABOUT_EACH: usize = 50;
const NEARER: [f64; 3] = [0.2, 0.07, 0.02];

/// Places by which the expected gain is averaged.
const GAIN_DRAWS: usize = 64;

/// Stream of the seed's generator.
const STREAM: u64 = 0x73_7572_726f;

/// The search, on its way.
pub(super) struct CoarseToFine {
    problem: Problem,
    edge: Edge,
    rng: ChaCha8Rng,
    coarse: Known,
    fine: Known,
    /// How many epochs the coarse world had.
    coarse_epochs: u32,
    /// Whether the last of them lowered the loss so that another is worth it.
    coarse_falls: bool,
    /// Half the edge of the box about the best skill of the scene itself.
    half_box: f64,
    /// The fall of the loss that the present epoch's first trial is guessed to bring.
    guessed_fall: Option<f64>,
    asked: Vec<Trial>,
}

impl CoarseToFine {
    pub(super) fn new(problem: Problem) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(problem.seed);
        rng.set_stream(STREAM);
        Self {
            edge: Edge { unit_m: problem.unit_m },
            problem,
            rng,
            coarse: Known::default(),
            fine: Known::default(),
            coarse_epochs: 0,
            coarse_falls: false,
            half_box: WIDEST_BOX,
            guessed_fall: None,
            asked: Vec::new(),
        }
    }

    /// Whether the next trials are made in the coarse world.
    fn is_coarse(&self, is_last: bool) -> bool {
        let most = match self.coarse.most_arrives() {
            most if most < 0.5 => COARSE_EPOCHS_WITHOUT_POWDER,
            _ if self.problem.coarsest() == World::Coarse && self.is_on_the_way() => COARSE_EPOCHS_ON_THE_WAY,
            _ => COARSE_EPOCHS,
        };
        self.fine.is_empty() && !is_last && self.coarse_epochs < most
    }

    /// Whether another epoch in the coarse world is worth it.
    fn is_on_the_way(&self) -> bool {
        let near = self.problem.tolerance().max(COARSE_NEAR);
        self.coarse_falls || self.coarse.is_off(&self.edge, near)
    }

    /// The skill that the seed draws, and a sequence that fills the range evenly, from anywhere in it.
    fn first_points(&mut self) -> Vec<Vec<f64>> {
        let dimensions = self.problem.first.len();
        let from: Vec<f64> = (0..dimensions).map(|_| unit(&mut self.rng)).collect();
        // Roberts 2018: powers of the root of x^(n+1) = x + 1.
        let root = (0..60).fold(2.0, |x: f64, _| libm::pow(1.0 + x, 1.0 / (dimensions as f64 + 1.0)));
        let evenly = |draw: i32| -> Vec<f64> {
            let share =
                |(k, from): (usize, &f64)| (from + f64::from(draw) / libm::pow(root, (k + 1) as f64)).fract();
            from.iter().enumerate().map(share).map(|share| FIRST_RANGE * (2.0 * share - 1.0)).collect()
        };
        let able = (1..200).map(evenly).filter(|point| self.problem.is_able(&Trial::of(point.clone())));
        std::iter::once(self.problem.first.clone()).chain(able).take(FIRST_TRIALS).collect()
    }

    fn coarse_points(&mut self) -> Vec<Vec<f64>> {
        let mut known = self.coarse.best_of(MOST_KNOWN, &self.edge);
        let none = Known::default();
        let mut surrogate = Surrogate::fitted(self.edge, &known, &none);
        let mut points = Vec::new();
        let whole = vec![[-1.0, 1.0]; self.problem.first.len()];
        while points.len() < COARSE_TRIALS {
            let best = known
                .best(&self.edge)
                .map_or((self.problem.first.clone(), 0.0), |(at, loss)| (at.clone(), loss));
            let draws = self.draws();
            let point = match points.len() {
                0 => self.best_place(&whole, &best.0, &points, COARSE_APART, |place| {
                    -surrogate.expected_loss(place, &draws)
                }),
                _ => self.best_place(&whole, &best.0, &points, COARSE_APART, |place| {
                    surrogate.expected_gain(place, best.1, &draws)
                }),
            };
            known.push(point.clone(), surrogate.parts(&point));
            surrogate = surrogate.with(&known, &none);
            points.push(point);
        }
        points
    }

    fn fine_points(&mut self) -> Vec<Vec<f64>> {
        let (coarse, fine) =
            (self.coarse.best_of(MOST_KNOWN, &self.edge), self.fine.best_of(MOST_KNOWN, &self.edge));
        let Some((of_coarse, _)) = coarse.best(&self.edge) else { return vec![self.problem.first.clone()] };
        let surrogate = Surrogate::fitted(self.edge, &coarse, &fine);
        let best = fine.best(&self.edge).map(|(at, loss)| (at.clone(), loss));
        let (about, half_box) = match &best {
            Some((at, _)) => (at.clone(), self.half_box),
            // Where nothing is known of the scene itself, its like is believed.
            None => (of_coarse.clone(), 2.0),
        };
        let around = bounds(&about, half_box);
        let draws = self.draws();
        let lowest = |place: &[f64]| -surrogate.expected_loss(place, &draws);
        let first = self.best_place(&around, &about, &[], 0.0, lowest);
        self.guessed_fall = best.as_ref().map(|(_, loss)| loss - surrogate.expected_loss(&first, &draws));
        let mut points = vec![first];
        while points.len() < FINE_TRIALS {
            let next = match &best {
                Some((_, loss)) => {
                    self.best_place(&around, &about, &points, APART * self.half_box, |place| {
                        surrogate.expected_gain(place, *loss, &draws)
                    })
                }
                // Another basin, in case the first is not what it seems.
                None => self.best_place(&around, &about, &points, WIDEST_BOX, lowest),
            };
            points.push(next);
        }
        points
    }

    /// The place in a box where `value` is highest of all that are looked at, of those that are able and apart from what is taken.
    fn best_place(
        &mut self,
        around: &[[f64; 2]],
        about: &[f64],
        taken: &[Vec<f64>],
        apart: f64,
        value: impl Fn(&[f64]) -> f64,
    ) -> Vec<f64> {
        let is_free = |place: &[f64]| {
            let away =
                |other: &Vec<f64>| place.iter().zip(other).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
            taken.iter().all(|other| away(other) >= apart)
        };
        let mut looked: Vec<(f64, Vec<f64>)> = Vec::new();
        let mut look = |place: Vec<f64>| {
            if is_free(&place) {
                looked.push((value(&place), place));
            }
        };
        look(about.to_vec());
        for _ in 0..DRAWN {
            look(around.iter().map(|[low, high]| low + unit(&mut self.rng) * (high - low)).collect());
        }
        let ranked = |looked: &mut Vec<(f64, Vec<f64>)>| looked.sort_by(|a, b| b.0.total_cmp(&a.0));
        for nearer in NEARER {
            ranked(&mut looked);
            let best: Vec<Vec<f64>> = looked.iter().take(BEST).map(|(_, place)| place.clone()).collect();
            for place in best.iter().flat_map(|place| std::iter::repeat_n(place, ABOUT_EACH)) {
                let moved: Vec<f64> = place
                    .iter()
                    .zip(around)
                    .map(|(x, [low, high])| {
                        (x + nearer * 0.5 * (high - low) * normal(&mut self.rng)).clamp(*low, *high)
                    })
                    .collect();
                if is_free(&moved) {
                    looked.push((value(&moved), moved));
                }
            }
        }
        ranked(&mut looked);
        let able = looked.iter().find(|(_, place)| self.problem.is_able(&Trial::of(place.clone())));
        able.map_or_else(|| about.to_vec(), |(_, place)| place.clone())
    }

    fn draws(&mut self) -> Vec<[f64; 2]> {
        (0..GAIN_DRAWS).map(|_| [normal(&mut self.rng), normal(&mut self.rng)]).collect()
    }

    /// What an epoch in the scene itself says of how far the surrogate is to be believed.
    fn trust(&mut self, before: Option<f64>) {
        let (Some(guessed), Some(before)) = (self.guessed_fall.take(), before) else { return };
        let fell = before - self.fine.best(&self.edge).map_or(before, |(_, loss)| loss);
        let factor = if fell > BELIEVED * guessed.max(0.0) { GROWING } else { SHRINKING };
        self.half_box = (self.half_box * factor).clamp(LEAST_BOX, WIDEST_BOX);
    }
}

impl Search for CoarseToFine {
    fn ask(&mut self, is_last: bool) -> Vec<Trial> {
        if self.asked.is_empty() {
            let is_coarse = self.is_coarse(is_last);
            let points = match is_coarse {
                true if self.coarse.is_empty() => self.first_points(),
                true => self.coarse_points(),
                false => self.fine_points(),
            };
            let world = if is_coarse { self.problem.coarsest() } else { World::Fine };
            let trial = |point| Trial { world, is_rounded: !is_coarse, may_fail: true, ..Trial::of(point) };
            self.asked = points.into_iter().map(trial).collect();
        }
        self.asked.clone()
    }

    fn tell(&mut self, found: &[Found]) -> Result<Option<Epoch>, SearchError> {
        check(&self.asked, found)?;
        let asked = std::mem::take(&mut self.asked);
        let lowest = |known: &Known| known.best(&self.edge).map(|(_, loss)| loss);
        let (before, coarse_before) = (lowest(&self.fine), lowest(&self.coarse));
        for (trial, found) in asked.iter().zip(found) {
            let parts = self.edge.parts(self.problem.amount(&found.evaluation), found.evaluation.loss);
            // What is rounded is what counts.
            let known = if trial.is_rounded { &mut self.fine } else { &mut self.coarse };
            known.push(trial.point.clone(), parts);
        }
        if asked.iter().all(|trial| trial.is_rounded) {
            self.trust(before);
        } else {
            self.coarse_epochs += 1;
            let (_, loss) = self.coarse.best(&self.edge).expect("one was told");
            self.coarse_falls = coarse_before.is_some_and(|before| loss < (1.0 - COARSE_FALL) * before);
        }
        let best = asked
            .into_iter()
            .zip(found)
            .min_by(|(_, a), (_, b)| a.evaluation.loss.total_cmp(&b.evaluation.loss));
        Ok(best.map(|(trial, found)| Epoch {
            trial,
            evaluation: found.evaluation,
            has_peers: true,
            step: Step::Update,
            slopes: None,
        }))
    }
}

/// The box about a place, within the range.
fn bounds(about: &[f64], half_box: f64) -> Vec<[f64; 2]> {
    about.iter().map(|x| [(x - half_box).max(-1.0), (x + half_box).min(1.0)]).collect()
}

/// A standard normal number (Box and Muller 1958).
fn normal(rng: &mut ChaCha8Rng) -> f64 {
    let (radius, angle) = (1.0 - unit(rng), unit(rng));
    libm::sqrt(-2.0 * libm::log(radius)) * libm::cos(2.0 * std::f64::consts::PI * angle)
}

#[cfg(test)]
mod tests {
    use super::*;
    use powderline_simulator::{
        rollout::{Census, Evaluation},
        scene::Scene,
    };

    const WANTED: f64 = 1200.0;

    fn problem(seed: u64) -> Problem {
        Problem::new(&Scene::load("bench").unwrap(), seed).without_obstacles()
    }

    /// What arrives in a bench of ours: more with depth, less where the transport is off; the world that counts is elsewhere by 0.1 in
    /// each component, and brings a tenth more.
    fn bench(trial: &Trial) -> Evaluation {
        let off = if trial.world == World::Fine { 0.1 } else { 0.0 };
        let x: Vec<f64> = trial.point.iter().map(|x| x + off).collect();
        let near = libm::exp(-4.0 * (x[3] - 0.2) * (x[3] - 0.2) - (x[1] - 0.3) * (x[1] - 0.3));
        let poured = 1.0 / (1.0 + libm::exp(-6.0 * (x[4] - 0.1)));
        let more = if trial.world == World::Fine { 1.1 } else { 1.0 };
        let amount = 1.6 * more * near * poured / (1.0 + libm::exp(-3.0 * x[0]));
        let arrives = libm::round(WANTED * amount);
        let spread = 0.02 * (1.0 + x[2] * x[2] + 4.0 * (x[3] - 0.2) * (x[3] - 0.2));
        let loss = 0.088 * (WANTED - arrives).abs() + arrives.min(WANTED) * spread;
        let census = Census { target: arrives as u32, ..Census::default() };
        Evaluation::new(loss, (WANTED - arrives) as i64, census)
    }

    /// Runs a search for so many epochs; what was asked in each, and what came of it.
    fn searched(
        problem: Problem,
        epochs: u32,
        of: impl Fn(&Trial) -> Evaluation,
    ) -> Vec<Vec<(Trial, Evaluation)>> {
        let mut search = CoarseToFine::new(problem);
        (0..epochs)
            .map(|epoch| {
                let is_last = epoch + 1 == epochs;
                let trials = search.ask(is_last);
                assert_eq!(trials, search.ask(is_last), "the same until it is told");
                let found: Vec<Found> =
                    trials.iter().map(|trial| Found { evaluation: of(trial), gradient: None }).collect();
                let ended = search.tell(&found).unwrap().unwrap();
                let lowest = found.iter().map(|found| found.evaluation.loss).fold(f64::INFINITY, f64::min);
                assert_eq!(ended.evaluation.loss.to_bits(), lowest.to_bits());
                trials.into_iter().zip(found.into_iter().map(|found| found.evaluation)).collect()
            })
            .collect()
    }

    fn best_of(epochs: &[Vec<(Trial, Evaluation)>]) -> &Evaluation {
        let fine = epochs.iter().flatten().filter(|(trial, _)| trial.world == World::Fine);
        fine.map(|(_, found)| found).min_by(|a, b| a.loss.total_cmp(&b.loss)).unwrap()
    }

    #[test]
    fn a_bench_that_differs_from_its_coarse_copy_is_solved_by_few_looks_at_it() {
        for seed in 1..=6 {
            let epochs = searched(problem(seed), 16, bench);
            let fine = epochs.iter().flatten().filter(|(trial, _)| trial.world == World::Fine).count();
            let best = best_of(&epochs);
            assert!(fine <= 18, "{fine}");
            assert!(best.indicator.abs() <= 12, "seed {seed}: {best:?}");
            // 24 m are the least that there is.
            assert!(best.loss < 27.0, "seed {seed}: {best:?}");
        }
    }

    #[test]
    fn it_looks_at_the_coarse_world_first_and_ships_what_it_evaluates_in_the_other() {
        let epochs = searched(problem(1), 10, bench);
        let worlds: Vec<World> = epochs.iter().map(|trials| trials[0].0.world).collect();
        assert!(worlds.is_sorted_by_key(|world| *world == World::Fine) && worlds[0] == World::Coarse);
        assert!(worlds[9] == World::Fine && epochs[0].len() == FIRST_TRIALS, "{worlds:?}");
        for (trial, _) in epochs.iter().flatten() {
            assert_eq!(trial.is_rounded, trial.world == World::Fine);
            assert!(trial.point.iter().all(|x| (-1.0..=1.0).contains(x)) && trial.may_fail);
        }
        let first = problem(1).first;
        assert_eq!(epochs[0][0].0.point, first, "it begins where the seed says");
    }

    #[test]
    fn the_last_epoch_is_of_the_scene_itself_however_early() {
        for epochs in 1..4 {
            let asked = searched(problem(2), epochs, bench);
            assert!(
                asked.last().unwrap().iter().all(|(trial, _)| trial.world == World::Fine && trial.is_rounded)
            );
        }
    }

    #[test]
    fn the_same_answers_lead_to_the_same_questions() {
        assert_eq!(searched(problem(3), 8, bench), searched(problem(3), 8, bench));
        assert_ne!(searched(problem(3), 1, bench), searched(problem(4), 1, bench));
    }

    #[test]
    fn the_box_follows_how_far_the_guesses_held() {
        let mut search = CoarseToFine::new(problem(1));
        search.fine.push(vec![0.0; 5], Edge { unit_m: search.edge.unit_m }.parts(1.0, 20.0));
        let mut after = |guessed: f64, before: f64| {
            search.guessed_fall = Some(guessed);
            search.trust(Some(before));
            search.half_box
        };
        // The loss fell to 20: by all that was guessed, by a tenth of it, and not at all, again and again.
        assert!((after(4.0, 24.0) - WIDEST_BOX).abs() < 1e-12);
        assert!((after(10.0, 21.0) - SHRINKING * WIDEST_BOX).abs() < 1e-12);
        assert!((after(4.0, 24.0) - GROWING * SHRINKING * WIDEST_BOX).abs() < 1e-12);
        assert!(
            (0..9).map(|_| after(4.0, 20.0)).last().is_some_and(|least| (least - LEAST_BOX).abs() < 1e-12)
        );
    }

    #[test]
    fn where_nothing_arrives_it_goes_on_looking() {
        let flat = |_: &Trial| Evaluation::new(105.6, 1200, Census::default());
        let epochs = searched(problem(5), 20, flat);
        let coarse = epochs.iter().filter(|trials| trials[0].0.world == World::Coarse).count();
        assert_eq!(coarse, COARSE_EPOCHS_WITHOUT_POWDER as usize);
        // A corner that brings powder is found.
        let corner = |trial: &Trial| {
            let [depth, .., pour] = trial.point[..] else { panic!("five parameters") };
            let inside = depth > 0.4 && pour > 0.4;
            let arrives = if inside { 900.0 + 200.0 * depth } else { 0.0 };
            let census = Census { target: arrives as u32, ..Census::default() };
            Evaluation::new(0.088 * (WANTED - arrives) + 0.01 * arrives, 0, census)
        };
        for seed in 1..=4 {
            let epochs = searched(problem(seed), 16, corner);
            assert!(best_of(&epochs).census.target > 900, "seed {seed}");
        }
    }

    /// A search that has farther to go does so where that is cheap.
    #[test]
    fn where_it_is_on_the_way_it_stays_in_the_coarse_world() {
        let coarse = |epochs: &[Vec<(Trial, Evaluation)>]| {
            epochs.iter().filter(|trials| trials[0].0.world == World::Coarse).count()
        };
        // Of what is wanted nine tenths are the most that can be had.
        let most = |part: f64| {
            move |trial: &Trial| {
                let arrives = f64::from(bench(trial).census.target).min(part * WANTED);
                let census = Census { target: arrives as u32, ..Census::default() };
                Evaluation::new(0.088 * (WANTED - arrives) + 0.03 * arrives, 0, census)
            }
        };
        for (part, epochs) in [(0.9, COARSE_EPOCHS_ON_THE_WAY), (0.97, COARSE_EPOCHS)] {
            assert_eq!(coarse(&searched(problem(1), 16, most(part))), epochs as usize, "{part}");
        }
        // What is wanted arrives, and each trial has a tenth less loss than the one before.
        let falls = std::cell::Cell::new(50.0);
        let falling = |_: &Trial| {
            falls.set(0.9 * falls.get());
            Evaluation::new(falls.get(), 0, Census { target: WANTED as u32, ..Census::default() })
        };
        assert_eq!(coarse(&searched(problem(1), 16, falling)), COARSE_EPOCHS_ON_THE_WAY as usize);
    }

    #[test]
    fn what_the_arm_cannot_perform_is_not_asked_for() {
        let able = problem(6).with_obstacle(|theta| theta.components()[0] > 0.0);
        let first = able.first.clone();
        for (trial, _) in searched(able, 10, bench).iter().flatten() {
            assert!(trial.point[0] <= 0.0 || trial.point == first, "{trial:?}");
        }
    }

    #[test]
    fn a_scene_without_a_coarse_copy_is_searched_itself() {
        let scene = Scene::load("bench").unwrap().coarse().unwrap();
        let problem = Problem::new(&scene, 1).without_obstacles();
        // However far off it is: an epoch of it is no cheaper than one of what counts.
        let far_off = |_: &Trial| {
            Evaluation::new(50.0, 0, Census { target: (0.8 * WANTED) as u32, ..Census::default() })
        };
        for epochs in [searched(problem.clone(), 10, bench), searched(problem, 10, far_off)] {
            assert!(epochs.iter().flatten().all(|(trial, _)| trial.world == World::Fine));
            let rounded = |epoch: u32| epochs[epoch as usize][0].0.is_rounded;
            assert!(!rounded(0) && !rounded(COARSE_EPOCHS - 1) && rounded(COARSE_EPOCHS));
        }
    }

    #[test]
    fn where_all_that_can_be_had_is_wanted_there_is_no_edge() {
        let scene = Scene::load("bench")
            .unwrap()
            .with(|spec| spec.objective.aim = powderline_simulator::scene::Aim::All);
        let problem = Problem::new(&scene.unwrap(), 1).without_obstacles();
        let all = |trial: &Trial| {
            let found = bench(trial);
            Evaluation::new(900.0 - 0.088 * f64::from(found.census.target), found.indicator, found.census)
        };
        let epochs = searched(problem, 12, all);
        // Of at most 1.7 times what is wanted.
        assert!(best_of(&epochs).census.target > 1800, "{:?}", best_of(&epochs));
    }

    #[test]
    fn numbers_that_nothing_follows_from_are_refused() {
        let mut search = CoarseToFine::new(problem(1));
        let trials = search.ask(false);
        let found =
            |loss: f64| Found { evaluation: Evaluation::new(loss, 0, Census::default()), gradient: None };
        assert!(search.tell(&[]).is_err());
        assert!(search.tell(&vec![found(f64::NAN); trials.len()]).is_err());
    }
}
