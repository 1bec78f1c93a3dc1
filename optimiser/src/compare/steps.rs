//! A track of the search over displacements, as it is saved to go on from.

use super::{ADJOINT_ROLLOUTS, Try};
use crate::{
    optim::{
        initial_theta, is_loss,
        steps::{StepRule, StepSearch},
    },
    report::sealed::{Seal, StateError},
};
use powderline_shared::plan::Precision;
use powderline_simulator::{
    PHYSICS_VERSION,
    rollout::{DisplacementGradient, Evaluation},
    scene::{Digest, Scene},
    skill::{SkillError, SkillMap},
};
use serde::{Deserialize, Serialize};

const SEAL: Seal = Seal { magic: *b"PLSTEPS\0", version: 3 };

/// What a track's epochs depend on, beside the search itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Origin {
    /// Digest of the scene.
    pub scene: Digest,
    /// Seed of packing and first skill.
    pub seed: u64,
    /// Precision of the simulation.
    pub precision: Precision,
}

/// A track between two epochs. It knows nothing of its length: one that is prolonged has the bits of a longer one.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct StepTrack {
    /// Version of what a substep computes.
    physics: u32,
    /// What it comes from.
    pub origin: Origin,
    search: StepSearch,
    /// What was evaluated. An epoch whose motion has no loss repeats the best try before it, and counts as many
    /// rollouts as any other.
    pub tries: Vec<Try>,
}

impl StepTrack {
    /// Begins with the motion of the skill that the gradient's search begins with.
    ///
    /// # Errors
    /// The skill is not a motion.
    pub fn new(scene: &Scene, origin: Origin) -> Result<Self, SkillError> {
        let theta = initial_theta(&scene.skill.initial_theta, origin.seed);
        let search = StepSearch::new(&scene.into(), &SkillMap::new(scene).controls(&theta)?);
        Ok(Self { physics: PHYSICS_VERSION, origin, search, tries: Vec::new() })
    }

    /// The search.
    pub fn search(&self) -> &StepSearch {
        &self.search
    }

    /// The try with the lowest loss.
    pub fn best(&self) -> Option<&Try> {
        self.tries.iter().min_by(|a, b| a.loss.total_cmp(&b.loss))
    }

    /// Takes what was found of the search's motion, nothing where it has no loss. False if the search cannot go on: a
    /// number was not finite, or the first motion of all has no loss. It is then unchanged.
    #[must_use]
    pub fn take(
        &mut self,
        rule: &StepRule,
        found: Option<&(Evaluation, Vec<DisplacementGradient>)>,
        seconds: f64,
    ) -> bool {
        let next = match found {
            Some((evaluation, slopes)) => self.search.onward(rule, evaluation.loss, slopes),
            None => self.search.back(rule),
        };
        let evaluation = found.map(|(evaluation, _)| *evaluation).or(self.best().map(Try::evaluation));
        let (Some(search), Some(evaluation)) = (next, evaluation) else { return false };
        self.search = search;
        self.tries.push(Try::after(self.tries.last(), None, &evaluation, 1 + ADJOINT_ROLLOUTS, seconds));
        true
    }

    /// The file's bytes.
    pub fn to_bytes(&self) -> Vec<u8> {
        SEAL.close(self)
    }

    /// Reads the bytes of a file that a track of this scene left behind.
    ///
    /// # Errors
    /// See [`StateError`].
    pub fn from_bytes(bytes: &[u8], scene: &Scene) -> Result<Self, StateError> {
        let track: Self = SEAL.open(bytes)?;
        match track.physics {
            PHYSICS_VERSION if track.is_sound(scene) => Ok(track),
            PHYSICS_VERSION => Err(StateError::Nonsense),
            found => Err(StateError::Physics { found }),
        }
    }

    fn is_sound(&self, scene: &Scene) -> bool {
        let lowest = self.best().map(|best| best.loss.to_bits());
        self.search.is_sound(&scene.into(), scene.time.horizon_steps as usize)
            && self.search.lowest_loss().map(f64::to_bits) == lowest
            && self.tries.iter().all(|one| {
                one.theta.is_none() && is_loss(one.loss) && (0.0..=f64::MAX).contains(&one.seconds)
            })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use powderline_simulator::{rollout::Census, skill::Theta};

    fn scene() -> Scene {
        Scene::load("bench-small").expect("shipped")
    }

    fn begun(scene: &Scene) -> StepTrack {
        let origin = Origin { scene: scene.digest(), seed: 3, precision: Precision::F32 };
        StepTrack::new(scene, origin).unwrap()
    }

    fn found(loss: f64, steps: usize) -> (Evaluation, Vec<DisplacementGradient>) {
        let slope = DisplacementGradient { per_metre: [1.0, 0.0, -2.0], per_radian: [0.0, 3.0, 0.0] };
        let census = Census { target: 1, ..Census::default() };
        (Evaluation::new(loss, 5, census), vec![slope; steps])
    }

    fn with_two_epochs(scene: &Scene) -> StepTrack {
        let mut track = begun(scene);
        for loss in [9.0, 8.0] {
            assert!(track.take(&scene.into(), Some(&found(loss, 330)), 1.5));
        }
        track
    }

    #[test]
    fn begins_where_the_gradient_begins() {
        let scene = scene();
        let theta = initial_theta(&scene.skill.initial_theta, 3);
        let controls = SkillMap::new(&scene).linearise(&theta).unwrap().controls;
        assert_eq!(begun(&scene).search().controls(), controls);
    }

    #[test]
    fn an_epoch_without_loss_repeats_the_best_and_counts() {
        let scene = scene();
        let rule = StepRule::from(&scene);
        let mut track = begun(&scene);
        assert!(!track.take(&rule, None, 1.0) && track == begun(&scene), "there is nothing to go back to");
        track = with_two_epochs(&scene);
        assert!(track.take(&rule, Some(&found(9.5, 330)), 1.5) && track.take(&rule, None, 0.5));
        let [.., last] = track.tries[..] else { panic!("{:?}", track.tries) };
        assert_eq!((last.loss.to_bits(), last.theta), (8.0f64.to_bits(), None));
        assert_eq!((last.rollouts, last.seconds.to_bits()), (4 * (1 + ADJOINT_ROLLOUTS), 5.0f64.to_bits()));
        assert_eq!(track.search().halvings(), 1);
        let before = track.clone();
        assert!(!track.take(&rule, Some(&found(f64::NAN, 330)), 1.5) && track == before);
        assert_eq!(StepTrack::from_bytes(&track.to_bytes(), &scene), Ok(before));
    }

    #[test]
    fn what_was_cut_short_or_changed_is_refused() {
        let scene = scene();
        let bytes = with_two_epochs(&scene).to_bytes();
        for length in (0..bytes.len()).step_by(499).chain(0..20).chain([bytes.len() - 1]) {
            assert!(StepTrack::from_bytes(&bytes[..length], &scene).is_err(), "{length}");
        }
        for bit in (0..8 * bytes.len()).step_by(3989).chain(0..100) {
            let mut broken = bytes.clone();
            broken[bit / 8] ^= 1 << (bit % 8);
            assert!(StepTrack::from_bytes(&broken, &scene).is_err(), "{bit}");
        }
        assert_eq!(StepTrack::from_bytes(b"PLSTATE\0 and more", &scene), Err(StateError::NotAState));
    }

    #[test]
    fn what_no_track_leaves_behind_is_refused_whatever_its_checksum() {
        let scene = scene();
        let defects: [fn(&mut StepTrack); 6] = [
            |track| track.tries.clear(),
            |track| track.tries[0].loss = f64::INFINITY,
            |track| track.tries[1].loss = 8.5,
            |track| track.tries[0].theta = Some(Theta::MIDDLE),
            |track| track.tries[0].seconds = f64::NAN,
            |track| track.physics += 1,
        ];
        for (index, defect) in defects.into_iter().enumerate() {
            let mut track = with_two_epochs(&scene);
            defect(&mut track);
            assert!(StepTrack::from_bytes(&track.to_bytes(), &scene).is_err(), "{index}");
        }
        let longer = scene.with(|spec| spec.time.horizon_steps += 1).unwrap();
        let refused = StepTrack::from_bytes(&begun(&scene).to_bytes(), &longer);
        assert_eq!(refused, Err(StateError::Nonsense));
    }
}
