//! Files to go on from: taken whole and unchanged, or not at all.
//!
//! ```text
//! magic (8) | version u32 LE (4) | body (postcard) | SHA-256 of everything before (32)
//! ```

use powderline_simulator::PHYSICS_VERSION;
use serde::{Serialize, de::DeserializeOwned};
use sha2::{Digest as _, Sha256};
use thiserror::Error;

pub(crate) const HEAD: usize = 8 + size_of::<u32>();
pub(crate) const CHECKSUM: usize = 32;

/// Why bytes are not a state.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum StateError {
    /// Too short, or another kind of file.
    #[error("it is not a state file")]
    NotAState,
    /// Written by another version of the program.
    #[error("it has version {found}, and this program reads version {read}")]
    Version {
        /// The file's version.
        found: u32,
        /// The program's.
        read: u32,
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

/// Kind and version of a file.
pub(crate) struct Seal {
    pub(crate) magic: [u8; 8],
    pub(crate) version: u32,
}

impl Seal {
    /// The file's bytes.
    pub(crate) fn close(&self, body: &impl Serialize) -> Vec<u8> {
        let head = [&self.magic[..], &self.version.to_le_bytes()].concat();
        let mut bytes =
            postcard::to_extend(body, head).expect("a state holds nothing that postcard cannot encode");
        let checksum = Sha256::digest(&bytes);
        bytes.extend_from_slice(&checksum);
        bytes
    }

    /// What the file's bytes hold, if they are whole and of this kind and version; whether it makes sense is for the
    /// caller to judge.
    pub(crate) fn open<T: DeserializeOwned>(&self, bytes: &[u8]) -> Result<T, StateError> {
        if bytes.len() < HEAD || !bytes.starts_with(&self.magic) {
            return Err(StateError::NotAState);
        }
        let found = u32::from_le_bytes([bytes[8], bytes[9], bytes[10], bytes[11]]);
        if found != self.version {
            return Err(StateError::Version { found, read: self.version });
        }
        let (checked, checksum) = bytes.split_last_chunk::<CHECKSUM>().ok_or(StateError::Damaged)?;
        let intact = checked.len() >= HEAD && Sha256::digest(checked)[..] == checksum[..];
        if !intact {
            return Err(StateError::Damaged);
        }
        match postcard::take_from_bytes(&checked[HEAD..]) {
            Ok((body, [])) => Ok(body),
            _ => Err(StateError::Nonsense),
        }
    }
}
