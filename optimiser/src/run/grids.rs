//! A plan's skill on the scene's own cells and on smaller ones.

use super::{Simulators, Watcher};
use crate::{
    able::obstacle,
    failure::Failure,
    refine::{Corrected, Grid, Look, Wanted, corrected},
    report::{amounts::Amounts, looks::Seen, summary::cells, words::parameter},
};
use powderline_shared::plan::SkillParameter;
use powderline_simulator::{
    bench::cpu_seconds,
    rollout::{RolloutError, Simulate},
    scene::Scene,
    skill::{QuantisedControls, SkillMap, Splines, Theta},
};

/// Keeps what was seen so far, all of it, where it can be gone on from.
pub type KeepFn<'a> = &'a mut dyn FnMut(&[Seen]) -> Result<(), Failure>;

/// Both grids, one at a time in memory, and what was seen on them.
pub struct Grids<'a> {
    /// The scene, and its finer copy.
    scenes: [Scene; 2],
    /// Whether the copy is none: what is seen in one is seen in both.
    are_alike: bool,
    map: SkillMap,
    /// What is added to each skill's motion.
    splines: Option<Splines>,
    seen: Vec<Seen>,
    simulators: Simulators<'a>,
    present: Option<(Grid, Box<dyn Simulate>)>,
}

impl<'a> Grids<'a> {
    /// Of a scene and its finer copy; with what was seen before, which is not simulated again.
    pub fn new(
        scenes: [Scene; 2],
        splines: Option<Splines>,
        seen: Vec<Seen>,
        simulators: Simulators<'a>,
    ) -> Self {
        let (map, are_alike) = (SkillMap::new(&scenes[0]), scenes[0] == scenes[1]);
        Self { scenes, are_alike, map, splines, seen, simulators, present: None }
    }

    /// Corrects a skill until the finer grid brings what the scene wants.
    ///
    /// # Errors
    /// One sentence; what was seen before is kept.
    pub fn corrected(
        &mut self,
        theta: &Theta,
        watcher: &dyn Watcher,
        keep: KeepFn<'_>,
    ) -> Result<Corrected, Failure> {
        let amounts = Amounts::from(&self.scenes[0]);
        let wanted = Wanted { mass_kg: amounts.wanted_kg, tolerance: amounts.tolerance };
        let found = corrected(theta, wanted, &mut |grid, theta| self.look(grid, theta, watcher, keep));
        found.map_err(|error| {
            match self.seen.iter().find(|seen| seen.theta == *theta && seen.obstacle.is_some()) {
                Some(Seen { grid, obstacle: Some(why), .. }) => Failure::Failed(format!(
                    "the plan's skill cannot be looked at on {}: {why}",
                    self.cells(*grid)
                )),
                _ => error,
            }
        })
    }

    /// As it was seen before, or else simulated and kept.
    fn look(
        &mut self,
        grid: Grid,
        theta: &Theta,
        watcher: &dyn Watcher,
        keep: KeepFn<'_>,
    ) -> Result<Option<Look>, Failure> {
        let particle_mass_kg = self.scene(grid).particle_mass_kg();
        let is_it = |seen: &&Seen| seen.is_of(grid, theta) || self.are_alike && seen.is_of(seen.grid, theta);
        if let Some(seen) = self.seen.iter().find(is_it) {
            // What was seen by a version of before may be more than the arm may perform.
            let is_able = obstacle(&self.scenes[0], &self.map, theta, self.splines.as_ref()).is_none();
            return Ok(seen.look(particle_mass_kg).filter(|_| is_able));
        }
        let seen = self.simulated(grid, theta, watcher)?;
        let look = seen.look(particle_mass_kg);
        watcher.say(&self.words(&seen));
        self.seen.push(seen);
        keep(&self.seen)?;
        Ok(look)
    }

    fn simulated(&mut self, grid: Grid, theta: &Theta, watcher: &dyn Watcher) -> Result<Seen, Failure> {
        if let Some(why) = obstacle(&self.scenes[0], &self.map, theta, self.splines.as_ref()) {
            return Ok(Seen::nothing(grid, theta, why));
        }
        let motion = QuantisedControls::new(&self.map.motion(theta, self.splines.as_ref())?)?;
        if watcher.is_stopped() {
            return Err(RolloutError::Stopped.into());
        }
        let begun_s = cpu_seconds();
        watcher.begin(&format!("look {}, {}", self.seen.len() + 1, self.cells(grid)), 0, &[]);
        match self.enter(grid)?.simulate(&motion.controls) {
            Ok(found) => Ok(Seen::new(grid, theta, &found, cpu_seconds() - begun_s)),
            Err(error) if error.is_of_motion() => Ok(Seen::nothing(grid, theta, error.to_string())),
            Err(error) => Err(error.into()),
        }
    }

    /// The simulator of a grid.
    fn enter(&mut self, grid: Grid) -> Result<&mut dyn Simulate, RolloutError> {
        if self.present.as_ref().is_none_or(|(present, _)| *present != grid) {
            // What the other one holds is given back first.
            self.present = None;
            self.present = Some((grid, (self.simulators)(self.scene(grid))?));
        }
        let (_, simulator) = self.present.as_mut().expect("made above");
        Ok(simulator.as_mut())
    }

    fn scene(&self, grid: Grid) -> &Scene {
        &self.scenes[usize::from(grid == Grid::Finer)]
    }

    fn cells(&self, grid: Grid) -> String {
        cells(self.scene(grid).domain.cell_m)
    }

    fn words(&self, seen: &Seen) -> String {
        let skill = self.map.parameters(&seen.theta);
        let skill: Vec<String> =
            SkillParameter::ALL.iter().map(|which| parameter(*which, skill[which.index()])).collect();
        let found = match &seen.obstacle {
            Some(why) => why.clone(),
            None => {
                let amounts = Amounts::from(self.scene(seen.grid));
                format!("{} ({})", amounts.mass(seen.census.target), amounts.off(seen.census.target))
            }
        };
        format!("  {}, {}: {found}", self.cells(seen.grid), skill.join(", "))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::optim::EpochRecord;
    use powderline_simulator::rollout::{Census, Evaluation};

    struct Nobody;

    impl Watcher for Nobody {
        fn begin(&self, _: &str, _: u32, _: &[EpochRecord]) {}
        fn is_stopped(&self) -> bool {
            false
        }
        fn epoch(&self, _: &str, _: &Amounts, _: [u32; 2], _: &[EpochRecord]) {}
        fn say(&self, _: &str) {}
    }

    /// Kept by a version that did not look at all that the arm may not do.
    #[test]
    fn what_was_seen_is_not_looked_at_again_and_refused_if_the_arm_may_not_perform_it() {
        let look = |base_position_m: [f64; 3]| {
            let mut scene = Scene::load("bench").unwrap().into_spec();
            scene.arm.as_mut().unwrap().base_position_m = base_position_m;
            let scene = Scene::from_toml("moved.toml", &scene.to_toml()).unwrap();
            let found = Evaluation::new(1.0, 0, Census { target: 7, ..Census::default() });
            let seen = vec![Seen::new(Grid::Own, &Theta::MIDDLE, &found, 0.0)];
            let simulators = |_: &Scene| -> Result<Box<dyn Simulate>, RolloutError> { panic!("it was seen") };
            let scenes = [scene.clone(), scene.refined(2).unwrap()];
            let mut grids = Grids::new(scenes, None, seen, &simulators);
            grids.look(Grid::Own, &Theta::MIDDLE, &Nobody, &mut |_| Ok(())).unwrap()
        };
        assert_eq!(look([0.26, -0.8, -0.1]).unwrap().evaluation.census.target, 7);
        assert_eq!(look([0.13, -0.4, -0.1]), None);
    }
}
