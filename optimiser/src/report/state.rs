//! The `state` file: all that a run needs to go on with the same bits.
//!
//! ```text
//! magic "PLSTATE\0" (8) | version u32 LE (4) | body (postcard) | SHA-256 of everything before (32)
//! ```

use crate::{mpm::PHYSICS_VERSION, optim::Search, scene::Digest};
use powderline_shared::plan::Precision;
use serde::{Deserialize, Serialize};
use sha2::{Digest as _, Sha256};
use thiserror::Error;

const MAGIC: &[u8; 8] = b"PLSTATE\0";
const VERSION: u32 = 5;
const HEAD: usize = MAGIC.len() + size_of::<u32>();
const CHECKSUM: usize = 32;

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

/// Why bytes are not a state.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum StateError {
    /// Too short, or another kind of file.
    #[error("it is not a state file")]
    NotAState,
    /// Written by another version of the program.
    #[error("it has version {found}, and this program reads version {VERSION}")]
    Version {
        /// The file's version.
        found: u32,
    },
    /// Its epochs were simulated by another physics.
    #[error(
        "its epochs were simulated by version {found} of the powder's physics, and this program has {PHYSICS_VERSION}; start a new run"
    )]
    Physics {
        /// The file's version.
        found: u32,
    },
    /// Cut short or changed.
    #[error("it is damaged: its checksum does not fit its contents")]
    Damaged,
    /// Intact, but not written by a run.
    #[error("it holds what no run leaves behind, although its checksum fits")]
    Nonsense,
}

impl RunState {
    /// A run of this version of the program that is not finished.
    pub fn new(scene: Digest, seed: u64, precision: Precision, search: Search) -> Self {
        Self { physics: PHYSICS_VERSION, scene, seed, precision, search, finished: false }
    }

    /// The file's bytes.
    pub fn to_bytes(&self) -> Vec<u8> {
        let head = [&MAGIC[..], &VERSION.to_le_bytes()].concat();
        let mut bytes =
            postcard::to_extend(self, head).expect("a state holds nothing that postcard cannot encode");
        let checksum = Sha256::digest(&bytes);
        bytes.extend_from_slice(&checksum);
        bytes
    }

    /// Reads the file's bytes.
    ///
    /// # Errors
    /// See [`StateError`].
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, StateError> {
        if bytes.len() < HEAD || !bytes.starts_with(MAGIC) {
            return Err(StateError::NotAState);
        }
        let found = u32::from_le_bytes([bytes[8], bytes[9], bytes[10], bytes[11]]);
        if found != VERSION {
            return Err(StateError::Version { found });
        }
        let (checked, checksum) = bytes.split_last_chunk::<CHECKSUM>().ok_or(StateError::Damaged)?;
        let intact = checked.len() >= HEAD && Sha256::digest(checked)[..] == checksum[..];
        if !intact {
            return Err(StateError::Damaged);
        }
        let (state, rest) =
            postcard::take_from_bytes::<Self>(&checked[HEAD..]).map_err(|_| StateError::Nonsense)?;
        match state.physics {
            PHYSICS_VERSION if rest.is_empty() && state.search.is_sound() => Ok(state),
            PHYSICS_VERSION => Err(StateError::Nonsense),
            found => Err(StateError::Physics { found }),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn state() -> RunState {
        let search = Search::new([0.1, -0.2, 1.0 / 3.0, 0.0, -1.0], 30);
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
        let outside = RunState { search: Search::new([2.0; 5], 30), ..state() };
        let physics_only = [&state().to_bytes()[..HEAD], &[2]].concat();
        let longer = [&state().to_bytes()[..state().to_bytes().len() - CHECKSUM], &[0]].concat();
        let sealed = |bytes: Vec<u8>| [&bytes[..], &Sha256::digest(&bytes)].concat();
        for bytes in [outside.to_bytes(), sealed(physics_only), sealed(longer)] {
            assert_eq!(RunState::from_bytes(&bytes), Err(StateError::Nonsense));
        }
    }

    #[test]
    fn version_from_the_future_is_refused_with_both_numbers() {
        let mut bytes = state().to_bytes();
        bytes[8] = 9;
        let error = RunState::from_bytes(&bytes).unwrap_err().to_string();
        assert!(error.contains("version 9") && error.contains("version 5"), "{error}");
    }
}
