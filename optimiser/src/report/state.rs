//! The `state` file: all that a run needs to go on with the same bits.
//!
//! A search is made again from what it was told. So that, and nothing of the search itself, is kept.

use super::sealed::Seal;
pub use super::sealed::StateError;
use super::{looks::Seen, tries::Try};
use crate::optim::{EpochRecord, Method};
use powderline_shared::plan::Precision;
use powderline_simulator::{PHYSICS_VERSION, scene::Digest};
use serde::{Deserialize, Serialize};

const SEAL: Seal = Seal { magic: *b"PLSTATE\0", version: 11 };

/// How a run searches.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Settings {
    /// The way.
    pub method: Method,
    /// Epochs after epoch 0, at most.
    pub epochs: u32,
    /// The search ends when the amount is met and so many epochs in a row have gained nothing; with 0 it goes on to its last epoch.
    pub patience_epochs: u32,
    /// By how much smaller the cells are on which the plan is corrected at the end; with 0 it stays as the search left it.
    pub refine_by: u32,
}

impl Settings {
    /// As usual for a way to search: one that has a second part gets time for it.
    pub fn of(method: Method) -> Self {
        let epochs = if method.begins_with_a_skill() { 32 } else { 16 };
        Self { method, epochs, patience_epochs: 2, refine_by: 2 }
    }
}

impl Default for Settings {
    fn default() -> Self {
        Self::of(Method::default())
    }
}

/// A run between two epochs.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RunState {
    /// Version of what a substep computes.
    pub physics: u32,
    /// Digest of the resolved scene.
    pub scene: Digest,
    /// Seed of packing and search.
    pub seed: u64,
    /// Precision of the simulation.
    pub precision: Precision,
    /// How it searches.
    pub settings: Settings,
    /// The evaluated epochs, in order.
    pub epochs: Vec<Evaluated>,
    /// Whether the search was ended before its last epoch: what was found is good enough.
    pub settled: bool,
    /// Whether the plan is written, and corrected.
    pub finished: bool,
    /// What the search's plan, and corrections of it, bring on the scene's own cells and on smaller ones, as far as was looked.
    pub looks: Vec<Seen>,
    /// Why nobody looked.
    pub unrefined: Option<String>,
}

/// An epoch, and what the search was told until it ended.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Evaluated {
    /// What is written down of it.
    pub record: EpochRecord,
    /// What it was told at once, again and again.
    pub rounds: Vec<Vec<Try>>,
}

impl RunState {
    /// Whether it is a run of this scene, seed, precision and search.
    pub fn is_of(&self, scene: Digest, (seed, precision): (u64, Precision), settings: Settings) -> bool {
        (self.scene, self.seed, self.precision, self.settings) == (scene, seed, precision, settings)
    }

    /// A run of this version of the program that has not begun to search.
    pub fn new(scene: Digest, seed: u64, precision: Precision, settings: Settings) -> Self {
        let (physics, epochs) = (PHYSICS_VERSION, Vec::new());
        let (looks, unrefined) = (Vec::new(), None);
        Self {
            physics,
            scene,
            seed,
            precision,
            settings,
            epochs,
            settled: false,
            finished: false,
            looks,
            unrefined,
        }
    }

    /// Whether all epochs are evaluated.
    fn is_complete(&self) -> bool {
        self.epochs.len() > self.settings.epochs as usize
    }

    /// Whether nothing is left to evaluate.
    pub fn is_done(&self) -> bool {
        self.settled || self.is_complete()
    }

    /// Whether it was ended before its last epoch.
    pub fn is_settled(&self) -> bool {
        self.settled && !self.is_complete()
    }

    /// Whether no epoch follows that of this number.
    pub fn is_last(&self, epoch: usize) -> bool {
        epoch >= self.settings.epochs as usize
    }

    /// Prolongs a run that is not settled to so many epochs. The last epoch of one that was done is taken back, to be evaluated again as one
    /// that others follow: the result has the bits of a run that was this long from the start.
    pub fn extend(&mut self, epochs: u32) {
        if self.is_complete() && epochs > self.settings.epochs {
            self.epochs.pop();
            self.finished = false;
        }
        // What comes of more epochs is another plan.
        self.looks.clear();
        self.unrefined = None;
        self.settings.epochs = self.settings.epochs.max(epochs);
    }

    /// What is written down of the epochs.
    pub fn history(&self) -> Vec<EpochRecord> {
        self.epochs.iter().map(|epoch| epoch.record.clone()).collect()
    }

    /// All that was simulated, in order.
    pub fn tries(&self) -> impl Iterator<Item = &Try> {
        self.epochs.iter().flat_map(|epoch| epoch.rounds.iter().flatten())
    }

    /// The file's bytes.
    pub fn to_bytes(&self) -> Vec<u8> {
        SEAL.close(self)
    }

    /// Reads the file's bytes.
    ///
    /// # Errors
    /// See [`StateError`].
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, StateError> {
        let state: Self = SEAL.open(bytes)?;
        match state.physics {
            PHYSICS_VERSION if state.is_sound() => Ok(state),
            PHYSICS_VERSION => Err(StateError::Nonsense),
            found => Err(StateError::Physics { found }),
        }
    }

    /// Whether epochs can have led here, so that more of them can follow. Numbers that are only written down or added up may
    /// be anything.
    fn is_sound(&self) -> bool {
        let tries = |epoch: &Evaluated| epoch.rounds.iter().flatten().all(Try::is_sound);
        self.epochs.len() <= self.settings.epochs as usize + 1
            && !(self.settled && self.epochs.is_empty())
            && (!self.finished || self.is_done())
            && (self.looks.is_empty() || self.is_done())
            && self.looks.iter().all(Seen::is_sound)
            && (0..).zip(&self.epochs).all(|(epoch, one)| one.record.is_sound(epoch) && tries(one))
    }
}
#[cfg(test)]
mod tests {
    use super::*;
    use crate::optim::{Epoch, Found, Step, Trial, World};
    use crate::refine::Grid;
    use crate::report::sealed::{CHECKSUM, HEAD};
    use powderline_simulator::rollout::{Census, Evaluation};
    use powderline_simulator::skill::{Freedom, Splines, Theta};
    use sha2::{Digest as _, Sha256};

    fn state() -> RunState {
        let theta = vec![0.1, -0.2, 1.0 / 3.0, 0.0, -1.0];
        let evaluation = Evaluation::new(2.5, 7, Census { target: 9, ..Census::default() });
        let trial = Trial {
            point: theta.clone(),
            splines: None,
            world: World::Fine,
            is_rounded: true,
            adjoint: None,
            may_fail: true,
        };
        let found = Found { evaluation, gradient: None };
        let tried = Try::new(0, &trial, &found, 1.5);
        let ended = Epoch { trial, evaluation, has_peers: true, step: Step::Update, slopes: None };
        let record = EpochRecord::new(0, &ended, tried.work(), 2.0).unwrap();
        let mut state = RunState::new([7; 32], 3, Precision::F32, Settings::default());
        state.epochs.push(Evaluated { record, rounds: vec![vec![tried]] });
        state
    }

    /// One whose plan was looked at on smaller cells.
    fn looked_at() -> RunState {
        let seen = Seen::new(Grid::Finer, &Theta::MIDDLE, &Evaluation::new(2.0, 1, Census::default()), 0.5);
        let none = Seen::nothing(Grid::Finer, &Theta::MIDDLE, "too far".into());
        RunState { settled: true, looks: vec![seen, none], ..state() }
    }

    #[test]
    fn loads_back() {
        for state in [state(), looked_at()] {
            assert_eq!(RunState::from_bytes(&state.to_bytes()), Ok(state));
        }
    }

    #[test]
    fn every_truncation_is_refused() {
        let bytes = state().to_bytes();
        for length in 0..bytes.len() {
            assert!(RunState::from_bytes(&bytes[..length]).is_err(), "{length}");
        }
    }

    #[test]
    fn every_flipped_bit_is_refused() {
        let bytes = state().to_bytes();
        for bit in 0..8 * bytes.len() {
            let mut broken = bytes.clone();
            broken[bit / 8] ^= 1 << (bit % 8);
            assert!(RunState::from_bytes(&broken).is_err(), "{bit}");
        }
    }

    #[test]
    fn epochs_of_another_physics_are_refused() {
        let other = RunState { physics: PHYSICS_VERSION + 1, ..state() };
        let refused = Err(StateError::Physics { found: PHYSICS_VERSION + 1 });
        assert_eq!(RunState::from_bytes(&other.to_bytes()), refused);
    }

    #[test]
    fn what_no_run_leaves_behind_is_refused_whatever_its_checksum() {
        let whole = state().to_bytes();
        let body = &whole[..whole.len() - CHECKSUM];
        let physics_only = [&whole[..HEAD], &[2]].concat();
        let longer = [body, &[0]].concat();
        // So many coefficients for two freedoms.
        fn added(coefficients: usize) -> Splines {
            Splines { freedoms: vec![Freedom::Up, Freedom::Pitch], coefficients: vec![0.5; coefficients] }
        }
        let sealed = |bytes: Vec<u8>| [&bytes[..], &Sha256::digest(&bytes)].concat();
        assert!(RunState::from_bytes(&sealed(body.into())).is_ok());
        for bytes in [physics_only, longer] {
            assert_eq!(RunState::from_bytes(&sealed(bytes)), Err(StateError::Nonsense));
        }
        let defects: [fn(&mut RunState); 12] = [
            |state| state.settings.epochs = 0,
            |state| state.finished = true,
            |state| (state.settled, state.epochs) = (true, Vec::new()),
            |state| state.epochs[0].record.epoch = 1,
            |state| state.epochs[0].record.loss = f64::NAN,
            |state| state.epochs[0].record.seconds = f64::INFINITY,
            |state| state.epochs[0].rounds[0][0].loss = -1.0,
            |state| state.epochs[0].rounds[0][0].splines = Some(added(5)),
            |state| state.epochs[0].record.splines = Some(added(1 << 20)),
            |state| state.epochs[0].rounds[0][0].cpu_seconds = f64::NAN,
            |state| {
                *state = RunState {
                    looks: vec![Seen { loss_m: f64::NAN, ..looked_at().looks.remove(0) }],
                    ..looked_at()
                }
            },
            |state| state.looks = looked_at().looks,
        ];
        for (index, defect) in defects.into_iter().enumerate() {
            let mut state = state();
            state.epochs.push(Evaluated {
                record: EpochRecord { epoch: 1, ..state.epochs[0].record.clone() },
                ..state.epochs[0].clone()
            });
            assert_eq!(RunState::from_bytes(&state.to_bytes()), Ok(state.clone()));
            defect(&mut state);
            assert_eq!(RunState::from_bytes(&state.to_bytes()), Err(StateError::Nonsense), "{index}");
        }
    }

    #[test]
    fn the_last_epoch_of_a_run_that_is_prolonged_is_taken_back() {
        let mut state = state();
        state.settings.epochs = 0;
        state.finished = true;
        assert!(state.is_done() && state.is_last(0) && !state.is_settled());
        state.extend(5);
        assert!(state.epochs.is_empty() && !state.finished && !state.is_done() && !state.is_last(0));
        // One that ended early keeps what it has.
        let mut settled = RunState { settled: true, ..super::tests::state() };
        assert!(settled.is_done() && settled.is_settled());
        settled.extend(50);
        assert_eq!((settled.epochs.len(), settled.settings.epochs), (1, 50));
    }

    #[test]
    fn version_from_the_future_is_refused_with_both_numbers() {
        let mut bytes = state().to_bytes();
        bytes[8] = 12;
        let error = RunState::from_bytes(&bytes).unwrap_err().to_string();
        assert!(error.contains("version 12") && error.contains("version 11"), "{error}");
    }
}
