//! Writing a scene: TOML for people, and a digest that identifies it.

use sha2::{Digest as _, Sha256};

use super::SceneSpec;

/// SHA-256 over a scene's canonical form.
pub type Digest = [u8; 32];

/// Version of the canonical form; raised whenever a field is added, removed, renamed or moved, so that equal
/// digests always mean equal scenes.
pub const DIGEST_VERSION: u32 = 16;

impl SceneSpec {
    /// The scene as TOML. It loads back to an equal scene, every float to the same bits.
    pub fn to_toml(&self) -> String {
        toml::to_string(self).expect("every field has a notation in TOML")
    }

    /// Digest of the resolved scene: SHA-256 over [`DIGEST_VERSION`] (little-endian) and the postcard encoding
    /// of all fields in declaration order, floats as their bits. Comments, layout and key order of the file
    /// do not matter.
    pub fn digest(&self) -> Digest {
        let body = postcard::to_allocvec(self).expect("a scene holds nothing that postcard cannot encode");
        let mut hasher = Sha256::new();
        hasher.update(DIGEST_VERSION.to_le_bytes());
        hasher.update(&body);
        hasher.finalize().into()
    }
}
