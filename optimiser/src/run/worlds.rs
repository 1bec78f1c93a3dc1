//! The worlds that a search asks about: the scene, and its coarse copy.

use crate::optim::{Adjoint, Found, Trial, World};
use crate::report::tries::Try;
use powderline_simulator::{
    bench::cpu_seconds,
    rollout::{
        Census, Displacement, Evaluation, RolloutError, Simulate, initial_loss, part, restart::Restarts,
    },
    scene::Scene,
    skill::{QuantisedControls, SkillMap, SplinePath, Splines, Theta, ThetaError},
};

/// Progress of a gradient in that of a rollout.
const GRADIENT_WORK: f64 = 6.0;

/// What a motion costs that came to no end, over what powder at rest does.
const COST_OF_FAILURE: f64 = 2.0;

/// Makes the simulator of a scene, with those who watch it.
pub type Simulators<'a> = &'a dyn Fn(&Scene) -> Result<Box<dyn Simulate>, RolloutError>;

/// Simulators of the worlds, one at a time.
pub struct Worlds<'a> {
    simulators: Simulators<'a>,
    scene: Scene,
    coarse: Option<Scene>,
    map: SkillMap,
    seed: u64,
    /// Of the world that was asked about last.
    present: Option<(World, Box<dyn Simulate>)>,
}

impl<'a> Worlds<'a> {
    /// Of a scene, with packings of this seed.
    pub fn new(scene: &Scene, seed: u64, simulators: Simulators<'a>) -> Self {
        let map = SkillMap::new(scene);
        Self { simulators, scene: scene.clone(), coarse: scene.coarse(), map, seed, present: None }
    }

    /// What makes its simulators, once the one at hand is given back.
    pub(super) fn leave(&mut self) -> Simulators<'a> {
        self.present = None;
        self.simulators
    }

    /// The simulator of a world.
    fn enter(&mut self, world: World) -> Result<&mut dyn Simulate, RolloutError> {
        if self.present.as_ref().is_none_or(|(present, _)| *present != world) {
            // What the other one holds is given back first.
            self.present = None;
            let scene = match world {
                World::Coarse => self.coarse.as_ref().unwrap_or(&self.scene),
                World::Fine => &self.scene,
            };
            self.present = Some((world, (self.simulators)(scene)?));
        }
        let (_, simulator) = self.present.as_mut().expect("made above");
        Ok(simulator.as_mut())
    }

    /// What comes of an epoch's trials that do not depend on each other.
    ///
    /// # Errors
    /// See [`RolloutError`]. A motion that comes to no end is an answer where trials may fail: it costs more than powder at rest.
    pub fn evaluate(&mut self, epoch: u32, trials: &[Trial]) -> Result<Vec<Try>, RolloutError> {
        let cost = |trial: &Trial| if trial.adjoint.is_some() { GRADIENT_WORK } else { 1.0 };
        let whole: f64 = trials.iter().map(cost).sum();
        let (mut tries, mut done) = (Vec::with_capacity(trials.len()), 0.0);
        for alike in trials.chunk_by(|a, b| a.world == b.world && a.adjoint.is_none() && b.adjoint.is_none())
        {
            let share = alike.iter().map(cost).sum::<f64>();
            let span = [done / whole, (done + share) / whole];
            done += share;
            // Settles the powder, so that it counts nowhere.
            self.enter(alike[0].world)?.simulate_all(&[])?;
            let begun_s = cpu_seconds();
            let found = self.evaluate_alike(alike, span)?;
            let each_s = (cpu_seconds() - begun_s) / alike.len() as f64;
            tries
                .extend(alike.iter().zip(&found).map(|(trial, found)| Try::new(epoch, trial, found, each_s)));
        }
        Ok(tries)
    }

    /// Of trials in one world, without derivatives or a single one.
    fn evaluate_alike(&mut self, trials: &[Trial], span: [f64; 2]) -> Result<Vec<Found>, RolloutError> {
        if let [trial @ Trial { adjoint: Some(adjoint), .. }] = trials {
            let found = match &trial.splines {
                None => self.gradient(&theta(&trial.point)?, trial.world, *adjoint, span),
                Some(splines) => self.gradient_of_path(trial, splines, *adjoint, span),
            };
            return Ok(vec![match found {
                Err(error) if error.is_of_motion() && trial.may_fail => self.failed(),
                found => found?,
            }]);
        }
        let motions: Vec<_> =
            trials.iter().map(|trial| self.controls(trial)).collect::<Result<_, RolloutError>>()?;
        let all = part(self.enter(trials[0].world)?, span, |simulator| simulator.simulate_all(&motions));
        let evaluations = match all {
            Err(error) if error.is_of_motion() && trials.iter().all(|trial| trial.may_fail) => {
                // Which of them it was, they tell one by one.
                let simulator = self.enter(trials[0].world)?;
                let mut evaluations = Vec::with_capacity(motions.len());
                for controls in &motions {
                    evaluations.push(match simulator.simulate(controls) {
                        Err(error) if error.is_of_motion() => None,
                        other => Some(other?),
                    });
                }
                evaluations
            }
            all => all?.into_iter().map(Some).collect(),
        };
        let found = |(trial, evaluation): (&Trial, Option<Evaluation>)| match evaluation {
            None => self.failed(),
            Some(found) => Found { evaluation: self.in_scene(found, trial.world), gradient: None },
        };
        Ok(trials.iter().zip(evaluations).map(found).collect())
    }

    fn controls(&self, trial: &Trial) -> Result<Vec<Displacement>, RolloutError> {
        let controls = self.map.motion(&theta(&trial.point)?, trial.splines.as_ref())?;
        Ok(match trial.is_rounded {
            true => QuantisedControls::new(&controls)?.controls,
            false => controls,
        })
    }

    /// By the coefficients of splines; rounding counts for nothing there.
    fn gradient_of_path(
        &mut self,
        trial: &Trial,
        splines: &Splines,
        adjoint: Adjoint,
        span: [f64; 2],
    ) -> Result<Found, RolloutError> {
        let theta = theta(&trial.point)?;
        let path = SplinePath::new(&self.map, &theta, &splines.freedoms, splines.knots())?;
        let restarts = Restarts::of_path(&self.scene, &self.map, &theta, &splines.freedoms);
        let controls = self.controls(trial)?;
        let (evaluation, gradient) = part(self.enter(trial.world)?, span, |simulator| match adjoint {
            Adjoint::Exact => simulator.simulate_with_gradient(&controls),
            Adjoint::Restarted => simulator.simulate_restarted(&controls, &restarts),
        })?;
        Ok(Found { evaluation, gradient: Some(path.pull_back(&gradient)) })
    }

    fn gradient(
        &mut self,
        theta: &Theta,
        world: World,
        adjoint: Adjoint,
        span: [f64; 2],
    ) -> Result<Found, RolloutError> {
        let restarts = match adjoint {
            Adjoint::Exact => None,
            Adjoint::Restarted => Some(Restarts::of_skill(&self.scene, &self.map, theta)),
        };
        let (evaluation, gradient) = part(self.enter(world)?, span, |simulator| match &restarts {
            None => simulator.evaluate_with_gradient(theta),
            Some(restarts) => {
                let found = simulator.evaluate_restarted(theta, restarts)?;
                Ok((found.evaluation, found.gradient))
            }
        })?;
        Ok(Found { evaluation, gradient: Some(gradient.to_vec()) })
    }

    /// What was found in a world, as of the scene's particles: so many heavier ones are so many more, and a sum over them so much less.
    fn in_scene(&self, found: Evaluation, world: World) -> Evaluation {
        let Some(coarse) = self.coarse.as_ref().filter(|_| world == World::Coarse) else { return found };
        let heavier = coarse.particle_mass_kg() / self.scene.particle_mass_kg();
        let census = found.census.map(|particles| (f64::from(particles) * heavier).round() as u32);
        let indicator = self.scene.target_count() as i64 - i64::from(census.target);
        Evaluation::new(found.loss * heavier, indicator, census)
    }

    /// What is told of a motion that comes to no end.
    fn failed(&self) -> Found {
        let loss = COST_OF_FAILURE * initial_loss(&self.scene, self.seed);
        let evaluation = Evaluation::new(loss, self.scene.target_count() as i64, Census::default());
        Found { evaluation, gradient: None }
    }

    /// What a motion in whole counts brings in the scene itself.
    ///
    /// # Errors
    /// See [`RolloutError`].
    pub fn rehearse(&mut self, controls: &[Displacement]) -> Result<Evaluation, RolloutError> {
        self.enter(World::Fine)?.simulate(controls)
    }
}

fn theta(point: &[f64]) -> Result<Theta, ThetaError> {
    Theta::new(std::array::from_fn(|k| point.get(k).copied().unwrap_or(f64::NAN)))
}
