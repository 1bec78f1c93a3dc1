//! From a skill to the bytes of a plan.

use powderline_shared::plan::{
    Finer, Mounting, PlanError, PlanHeader, PlanWriter, Precision, Prediction, StartPose, Version, WriteError,
};
use powderline_simulator::{
    rollout::Evaluation,
    scene::Scene,
    skill::{LSB, QuantisedControls, SkillMap, Theta},
};
use std::convert::Infallible;

/// What a plan is made of.
#[derive(Clone, Copy, Debug)]
pub struct PlanParts<'a> {
    /// The resolved scene.
    pub scene: &'a Scene,
    /// The mapping of that scene.
    pub map: &'a SkillMap,
    /// Seed of the run.
    pub seed: u64,
    /// Precision of the simulation.
    pub precision: Precision,
    /// The skill.
    pub theta: &'a Theta,
    /// How many numbers say how the motion leaves the skill's.
    pub path_coefficients: usize,
    /// The quantised motion.
    pub quantised: &'a QuantisedControls,
    /// What the quantised motion achieves.
    pub evaluation: &'a Evaluation,
    /// What it achieves on a finer grid.
    pub finer: Option<Finer>,
    /// The arm that can make it.
    pub arm: Option<Mounting>,
}

impl PlanParts<'_> {
    /// The plan's bytes.
    ///
    /// # Errors
    /// A number that no plan may hold.
    pub fn to_bytes(&self) -> Result<Vec<u8>, PlanError> {
        let mut bytes = Vec::new();
        self.write(&mut bytes).map_err(|error| match error {
            WriteError::Plan(error) => error,
            WriteError::Sink(never) => match never {},
        })?;
        Ok(bytes)
    }

    fn write(&self, bytes: &mut Vec<u8>) -> Result<(), WriteError<Infallible>> {
        let sink = |part: &[u8]| {
            bytes.extend_from_slice(part);
            Ok(())
        };
        let mut writer = PlanWriter::new(sink, &self.header())?;
        for step in &self.quantised.steps {
            writer.step(*step)?;
        }
        writer.finish().map(drop)
    }

    fn header(&self) -> PlanHeader {
        let Self { scene, map, evaluation, .. } = self;
        PlanHeader {
            scene_digest: scene.digest(),
            optimiser_version: version(),
            seed: self.seed,
            precision: self.precision,
            theta: self.theta.components(),
            skill_parameters: map.parameters(self.theta),
            path_coefficients: self.path_coefficients as u32,
            control_period_us: scene.time.control_period_us,
            step_count: self.quantised.steps.len() as u32,
            lsb: LSB,
            start: StartPose::from(map.start_pose()),
            limits: *map.limits(),
            predicted: Prediction {
                loss_m: evaluation.loss,
                indicator: evaluation.indicator,
                wanted_kg: scene.target_mass_kg(),
                particle_mass_kg: scene.particle_mass_kg(),
                census: evaluation.census,
            },
            finer: self.finer,
            arm: self.arm,
        }
    }
}

/// What a motion brings in a scene's finer copy, as a plan says it.
pub fn on_finer(finer: &Scene, found: &Evaluation) -> Finer {
    Finer {
        cell_m: finer.domain.cell_m,
        loss_m: found.loss,
        particle_mass_kg: finer.particle_mass_kg(),
        census: found.census,
    }
}

/// Version of this program.
fn version() -> Version {
    let number = |text: &str| text.parse().unwrap_or_default();
    Version {
        major: number(env!("CARGO_PKG_VERSION_MAJOR")),
        minor: number(env!("CARGO_PKG_VERSION_MINOR")),
        patch: number(env!("CARGO_PKG_VERSION_PATCH")),
    }
}
