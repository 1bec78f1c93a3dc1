//! The `state` file: all that a run needs to go on with the same bits.

use super::sealed::Seal;
pub use super::sealed::StateError;
use crate::optim::Search;
use powderline_shared::plan::Precision;
use powderline_simulator::{PHYSICS_VERSION, scene::Digest};
use serde::{Deserialize, Serialize};

const SEAL: Seal = Seal { magic: *b"PLSTATE\0", version: 8 };

/// A run between two epochs.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RunState {
    /// Version of what a substep computes.
    pub physics: u32,
    /// Digest of the resolved scene.
    pub scene: Digest,
    /// Seed of packing and initial theta.
    pub seed: u64,
    /// Precision of the simulation.
    pub precision: Precision,
    /// The search, with all evaluated epochs.
    pub search: Search,
    /// Whether the plan is written.
    pub finished: bool,
}

impl RunState {
    /// A run of this version of the program that is not finished.
    pub fn new(scene: Digest, seed: u64, precision: Precision, search: Search) -> Self {
        Self { physics: PHYSICS_VERSION, scene, seed, precision, search, finished: false }
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
            PHYSICS_VERSION if state.search.is_sound() => Ok(state),
            PHYSICS_VERSION => Err(StateError::Nonsense),
            found => Err(StateError::Physics { found }),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::sealed::{CHECKSUM, HEAD};
    use powderline_simulator::skill::Theta;
    use sha2::{Digest as _, Sha256};

    fn state() -> RunState {
        let theta = Theta::new([0.1, -0.2, 1.0 / 3.0, 0.0, -1.0]).unwrap();
        let search = Search::new(theta, 30);
        RunState::new([7; 32], 3, Precision::F32, search)
    }

    #[test]
    fn loads_back() {
        assert_eq!(RunState::from_bytes(&state().to_bytes()), Ok(state()));
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
        let with_angle = |value: f64| {
            let bytes = &state().to_bytes()[..state().to_bytes().len() - CHECKSUM];
            let at = bytes.windows(8).position(|eight| eight == (-0.2f64).to_le_bytes()).unwrap();
            [&bytes[..at], &value.to_le_bytes(), &bytes[at + 8..]].concat()
        };
        let physics_only = [&state().to_bytes()[..HEAD], &[2]].concat();
        let longer = [&state().to_bytes()[..state().to_bytes().len() - CHECKSUM], &[0]].concat();
        let sealed = |bytes: Vec<u8>| [&bytes[..], &Sha256::digest(&bytes)].concat();
        assert!(RunState::from_bytes(&sealed(with_angle(-0.3))).is_ok());
        let outside = [2.0, -1.001, f64::NAN].map(with_angle);
        for bytes in outside.into_iter().chain([physics_only, longer]) {
            assert_eq!(RunState::from_bytes(&sealed(bytes)), Err(StateError::Nonsense));
        }
    }

    #[test]
    fn version_from_the_future_is_refused_with_both_numbers() {
        let mut bytes = state().to_bytes();
        bytes[8] = 9;
        let error = RunState::from_bytes(&bytes).unwrap_err().to_string();
        assert!(error.contains("version 9") && error.contains("version 8"), "{error}");
    }
}
