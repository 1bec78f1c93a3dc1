//! Authentication, for two ends that have a key in common: tags take the place of checksums.
//!
//! ```text
//! key, 32 bytes:  [proofs, 16] [sessions, 16]
//! proof of Open:  tag by proofs over 1, the executor's nonce, and the body of the record
//! of its answer:  tag by proofs over 2, both nonces, session, digest of the request
//! session key:    tag by sessions over the same, with 3 in front
//! of a frame:     tag by the session key over identifier, tick or count, and what its checksum would cover
//! ```
//! A tag is SipHash-2-4 with 128 bits (J.-P. Aumasson and D. J. Bernstein, 2012), made to authenticate short messages: no tables
//! and no blocks of 64 bytes to fill, of which an HMAC takes up to four for each frame. It is cut to the bits that there are.

use core::fmt;

use heapless::Vec;
use serde::{Deserialize, Serialize};
use siphasher::sip128::SipHasher24;

use super::checksum::Context;
use super::fields::Put;
use super::frame::{Dialect, MAX_DATA, append};
use super::handshake;
use super::ids;
use super::message::OpenRequest;
use super::rejected::Rejected;

/// Bytes of a key.
pub const KEY_BYTES: usize = 32;

/// Frames with a wrong tag of 8 bits after which a session is stopped: by then one of 32 who guess has made one that is right.
pub const MOST_WRONG_TAGS: u32 = 8;

/// How many commands, or heartbeats, in a row may be lost before the next one is not known any more: more than are ever asked
/// again for one answer.
const ROLL_WINDOW: u32 = 32;

/// What a tag is over comes first, so that none is taken for one of another kind.
const OPEN: u8 = 1;
const OPENED: u8 = 2;
const SESSION: u8 = 3;

/// A secret of two ends.
#[derive(Clone, Copy, PartialEq, Eq)]
pub struct Key {
    proofs: Secret,
    sessions: Secret,
}

impl fmt::Debug for Key {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Key(..)")
    }
}

/// What the frames of one session are told by, and nobody without the key can make.
#[derive(Clone, Copy, PartialEq, Eq)]
pub struct SessionKey(Secret);

impl fmt::Debug for SessionKey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("SessionKey(..)")
    }
}

/// Shows that a handshake record was made with the key.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Tag(pub [u8; 8]);

/// What is added to a request for a session.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Proof {
    /// The executor's own, of this session alone.
    pub nonce: u64,
    /// Over nonce and request.
    pub tag: Tag,
}

/// Bytes of identifier and tick, which a frame's tag covers first.
const IN_FRONT: usize = 6;

/// Key of one SipHash.
type Secret = [u8; 16];

fn hashed(secret: &Secret, covered: &[u8]) -> [u8; 16] {
    u128::from(SipHasher24::new_with_key(secret).hash(covered)).to_le_bytes()
}

fn tag(secret: &Secret, covered: &[u8]) -> Tag {
    let [a, b, c, d, e, f, g, h, ..] = hashed(secret, covered);
    Tag([a, b, c, d, e, f, g, h])
}

/// What both ends know of a session that is opened, in an order of its own.
fn agreed(kind: u8, request: &OpenRequest, nonce: u64, arm_nonce: u32) -> Put {
    let put = Put::new().u8(kind).bytes(&nonce.to_le_bytes()).u32(arm_nonce).u16(request.session);
    put.bytes(&request.digest().to_le_bytes())
}

impl Key {
    /// A key from its bytes: 256 bits at random.
    #[must_use]
    pub fn new(bytes: &[u8; KEY_BYTES]) -> Self {
        let mut halves = [[0; 16]; 2];
        halves.iter_mut().flatten().zip(bytes).for_each(|(to, from)| *to = *from);
        let [proofs, sessions] = halves;
        Self { proofs, sessions }
    }

    /// What a client adds to its request; the nonce must be another one for each session.
    #[must_use]
    pub fn prove(&self, request: &OpenRequest, nonce: u64) -> Proof {
        let covered = handshake::covered_by_proof(OPEN, nonce, request);
        Proof { nonce, tag: tag(&self.proofs, &covered) }
    }

    /// Whether a request was made with the key.
    #[must_use]
    pub fn proves(&self, request: &OpenRequest, proof: &Proof) -> bool {
        self.prove(request, proof.nonce) == *proof
    }

    /// What an arm adds to its answer.
    #[must_use]
    pub fn answer(&self, request: &OpenRequest, nonce: u64, arm_nonce: u32) -> Tag {
        tag(&self.proofs, agreed(OPENED, request, nonce, arm_nonce).as_slice())
    }

    /// The key of a session.
    #[must_use]
    pub fn session(&self, request: &OpenRequest, nonce: u64, arm_nonce: u32) -> SessionKey {
        SessionKey(hashed(&self.sessions, agreed(SESSION, request, nonce, arm_nonce).as_slice()))
    }
}

impl SessionKey {
    /// Over the identifier, the tick or a count that is not sent, and the rest.
    pub(super) fn frame(&self, id: u16, tick: u32, covered: &[u8]) -> Tag {
        // Longer than a frame: that has room neither for the tick nor, in its data, for the identifier.
        let mut all: Vec<u8, { IN_FRONT + MAX_DATA }> = Vec::new();
        let parts = [&id.to_le_bytes()[..], &tick.to_le_bytes(), covered];
        let fits = parts.into_iter().try_for_each(|part| append(&mut all, part));
        debug_assert!(fits.is_some(), "longer than a frame");
        tag(&self.0, &all)
    }
}

/// Commands and heartbeats of the executor are counted in a session with a key: the tag covers the count, which is not sent, so
/// that none of them is believed twice.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Rolls {
    control: u32,
    heartbeat: u32,
}

impl Rolls {
    pub(super) const NONE: Self = Self { control: 0, heartbeat: 0 };

    fn of(&mut self, id: u16) -> &mut u32 {
        if id == ids::CONTROL { &mut self.control } else { &mut self.heartbeat }
    }

    /// The count of the next one that is said: 0 without a key.
    pub(super) fn next(&mut self, id: u16, context: &Context) -> u32 {
        if context.key.is_none() {
            return 0;
        }
        let count = self.of(id);
        *count = count.saturating_add(1);
        *count
    }

    /// Whether one that is heard has a right count: that of one of those that are to come.
    pub(super) fn is_next(&mut self, id: u16, context: &Context, right: impl Fn(u32) -> bool) -> bool {
        if context.key.is_none() {
            return right(0);
        }
        let last = self.of(id);
        let found = (1..=ROLL_WINDOW).map(|ahead| last.saturating_add(ahead)).find(|count| right(*count));
        found.into_iter().for_each(|count| *last = count);
        found.is_some()
    }
}

/// Whoever guesses tags of 8 bits is heard to: counts those that are wrong in a session with a key. Tags of 32 bits are not
/// guessed, and what carries nothing else may be damaged.
#[derive(Clone, Copy, Debug, Default)]
pub struct TagWatch {
    context: Option<Context>,
    wrong: u32,
}

impl TagWatch {
    /// Notes a frame that was rejected in a session; whether there have been too many.
    pub fn is_too_many(&mut self, dialect: Dialect, context: &Context, rejected: &Rejected) -> bool {
        let guessed = matches!(rejected, Rejected::Checksum { id } if ids::is_short(*id));
        if dialect == Dialect::Fd || context.key.is_none() || !guessed {
            return false;
        }
        if self.context != Some(*context) {
            *self = Self { context: Some(*context), wrong: 0 };
        }
        self.wrong = self.wrong.saturating_add(1);
        self.wrong >= MOST_WRONG_TAGS
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Of the reference implementation (`vectors.h`, SipHash-2-4 with 128 bits): key 00 01 .. 0F, message of 0, 1 and 15 bytes.
    #[test]
    fn published_check_values() {
        let counting = |length: u8| (0..length).collect::<std::vec::Vec<u8>>();
        let mut secret = Secret::default();
        secret.copy_from_slice(&counting(16));
        for (length, head, tail) in [
            (0, 0xe6a8_25ba_047f_81a3_u64, 0x9302_55c7_1472_f66d_u64),
            (1, 0x44af_996b_d8c1_87da, 0x45fc_229b_1159_7634),
            (15, 0x11a8_b033_99e9_9354, 0xd9c3_cf97_0fec_087e),
        ] {
            let found = hashed(&secret, &counting(length));
            let expected = [head.to_le_bytes(), tail.to_le_bytes()].concat();
            assert_eq!(found, *expected, "{length}: {found:02x?}");
        }
    }

    #[test]
    fn a_count_is_right_once_and_not_far_ahead() {
        let key = Key::new(&[7; KEY_BYTES]);
        let context = Context { session: 1, seal: 1, key: Some(SessionKey(key.proofs)) };
        let mut heard = Rolls::default();
        let mut hear = |count: u32| heard.is_next(ids::CONTROL, &context, |found| found == count);
        assert_eq!([1, 1, 3, 2, 35, 68, 67].map(&mut hear), [true, false, true, false, true, false, true]);
    }

    /// All of it, from the first to the last byte, as long as anything can be that is sent.
    #[test]
    fn every_byte_of_the_longest_is_covered() {
        let key = SessionKey([7; 16]);
        let whole = [0x55; MAX_DATA];
        let right = key.frame(ids::HANDSHAKE_FROM_ARM, 0, &whole);
        for place in 0..MAX_DATA {
            let mut other = whole;
            other.iter_mut().skip(place).take(1).for_each(|byte| *byte ^= 1);
            assert_ne!(key.frame(ids::HANDSHAKE_FROM_ARM, 0, &other), right, "{place}");
        }
        assert_ne!(key.frame(ids::HANDSHAKE_FROM_ARM, 1 << 24, &whole), right);
    }

    #[test]
    fn a_secret_is_not_shown() {
        let key = Key::new(&[0x42; KEY_BYTES]);
        assert_eq!(std::format!("{key:?} {:?}", SessionKey(key.proofs)), "Key(..) SessionKey(..)");
    }
}
