//! Checksums of frames, and what they cover without its being sent.
//!
//! A frame that is whole but not meant (of another session, another plan, another 65.536 mm) has to fail like one that
//! is damaged; so the checksum covers what both ends know anyway.
//!
//! A CRC is linear: whether the frames of one session pass for those of another does not depend on the frames. Eight bits
//! that cover the session itself would take all frames of every 256th foreign session. So the two halves of a setpoint cover
//! different bytes of a key, what enables and keeps an arm has 32 bits on every wire, and an arm chooses its nonce so that the
//! key is not that of no session, nor one that could be taken for one of the last sessions.

use crc::{CRC_8_AUTOSAR, CRC_32_ISO_HDLC, Crc, NoTable, Table};

use super::{
    auth::{SessionKey, Tag},
    fields::{Put, low16},
    ids,
    message::{NO_SESSION, OpenRequest},
};
use crate::plan::Fnv1a64;

/// CRC-8/AUTOSAR: polynomial 0x2F, initial value and final exclusive-or 0xFF.
static CRC8: Crc<u8, NoTable> = Crc::<u8, NoTable>::new(&CRC_8_AUTOSAR);
/// With a table of 1 KiB: it is over all of an FD frame.
static CRC32: Crc<u32, Table<1>> = Crc::<u32, Table<1>>::new(&CRC_32_ISO_HDLC);

/// What both ends know of a session, and nobody else who has not heard it being opened.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Context {
    /// Number of the session, or [`NO_SESSION`].
    pub session: u16,
    /// Of all that was agreed on and of the arm's nonce; does not count without a session.
    pub seal: u64,
    /// What tags are made with, which then take the place of checksums, if both ends have a key.
    pub key: Option<SessionKey>,
}

impl Context {
    /// No session.
    pub const NONE: Self = Self { session: NO_SESSION, seal: 0, key: None };

    /// The session that an arm opens for a request, with a nonce of its own: FNV-1a over digest and nonce.
    #[must_use]
    pub fn sealed(request: &OpenRequest, nonce: u32) -> Self {
        let mut seal = Fnv1a64::default();
        seal.update(&request.digest().to_le_bytes());
        seal.update(&nonce.to_le_bytes());
        Self { session: request.session, seal: seal.value(), key: None }
    }

    /// The same session between two ends that have a key.
    #[must_use]
    pub fn with_key(self, key: SessionKey) -> Self {
        Self { key: Some(key), ..self }
    }

    /// One byte each for translation, for rotation, and for everything else; zero without a session.
    #[must_use]
    pub fn key(&self) -> [u8; 3] {
        if self.session == NO_SESSION {
            return [0; 3];
        }
        let mut digest = CRC32.digest();
        digest.update(&self.session.to_le_bytes());
        digest.update(&self.seal.to_le_bytes());
        let [translation, rotation, rest, _] = digest.finalize().to_le_bytes();
        [translation, rotation, rest]
    }

    /// Whether no frame of this session can be taken for one of no session.
    #[must_use]
    pub fn is_usable(&self) -> bool {
        !self.key().contains(&0)
    }

    /// Whether frames of the one may be taken for frames of the other.
    #[must_use]
    pub fn resembles(&self, other: &Self) -> bool {
        let ([t, r, rest], [other_t, other_r, other_rest]) = (self.key(), other.key());
        (t, r) == (other_t, other_r) || rest == other_rest
    }

    /// What the other end must know of `session` if this end is in `self`.
    pub(super) fn of(&self, session: u16) -> Self {
        if session == self.session { self.normalised() } else { Self { session, seal: 0, key: None } }
    }

    pub(super) fn normalised(&self) -> Self {
        if self.session == NO_SESSION { Self::NONE } else { *self }
    }
}

/// Checksum of a classic frame, or its tag. The low half of the tick is in the payload, if there is one.
pub(super) fn sum8(id: u16, context: &Context, tick: u32, payload: &[u8]) -> u8 {
    let Some(key) = &context.key else {
        let [low, high, ..] = gray(tick >> 16).to_le_bytes();
        return crc8(id, context, &[low, high], payload);
    };
    let Tag([tag, ..]) = key.frame(id, tick, payload);
    tag
}

/// The same for three counts of which the low halves are sent, and a tick of which the low byte is.
pub(super) fn sum8_counts(id: u16, context: &Context, tick: u32, counts: [i32; 3]) -> u8 {
    if let Some(key) = &context.key {
        let Tag([tag, ..]) = key.frame(id, tick, Put::new().counts(&counts).as_slice());
        return tag;
    }
    let counts = counts.map(i32::cast_unsigned);
    let [tick_low, ..] = tick.to_le_bytes();
    let [low, middle, high, _] = gray(tick >> 8).to_le_bytes();
    let halves = |put: Put, of: fn(u32) -> u16| counts.iter().fold(put, |put, count| put.u16(of(*count)));
    let unsent = halves(Put::new().bytes(&[low, middle, high]), |count| low16(gray(count >> 16)));
    let sent = halves(Put::new(), low16).u8(tick_low);
    crc8(id, context, unsent.as_slice(), sent.as_slice())
}

/// Neighbours differ by one bit: a wrong bit that is sent moves what is rebuilt of the rest by one at most.
fn gray(number: u32) -> u32 {
    number ^ (number >> 1)
}

/// What is sent comes last, and nothing of it twice: together with the checksum it is the last 64 bits. CRC-8/AUTOSAR finds any
/// odd number of wrong bits and any two, but for two that are 127 apart, as bit i of the tick and bit i + 1 of the checksum once
/// were.
fn crc8(id: u16, context: &Context, unsent: &[u8], sent: &[u8]) -> u8 {
    let mut digest = CRC8.digest();
    digest.update(&id.to_le_bytes());
    digest.update(&[key_of(id, context)]);
    digest.update(unsent);
    digest.update(sent);
    digest.finalize()
}

fn key_of(id: u16, context: &Context) -> u8 {
    let [translation, rotation, rest] = context.key();
    match id {
        ids::SETPOINT_T | ids::ACTUAL_T => translation,
        ids::SETPOINT_R | ids::ACTUAL_R => rotation,
        _ => rest,
    }
}

/// Checksum of an FD frame, and of what enables an arm on every wire, or its tag; session and tick are part of `covered`. The
/// count is in the tag only.
pub(super) fn sum32(id: u16, context: &Context, count: u32, covered: &[u8]) -> u32 {
    let Some(key) = &context.key else { return crc32(id, context.seal, covered) };
    let Tag([a, b, c, d, ..]) = key.frame(id, count, covered);
    u32::from_le_bytes([a, b, c, d])
}

fn crc32(id: u16, seal: u64, covered: &[u8]) -> u32 {
    let mut digest = CRC32.digest();
    digest.update(&id.to_le_bytes());
    digest.update(&seal.to_le_bytes());
    digest.update(covered);
    digest.finalize()
}

/// Checksum of a handshake record.
pub(super) fn record_crc32(covered: &[u8]) -> u32 {
    CRC32.checksum(covered)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn published_check_values() {
        assert_eq!(CRC8.checksum(b"123456789"), 0xDF);
        assert_eq!(CRC32.checksum(b"123456789"), 0xCBF4_3926);
    }

    #[test]
    fn everything_unsent_counts() {
        let context = Context { session: 3, seal: 5, key: None };
        let sums = [
            crc8(0x201, &context, b"u", b"x"),
            crc8(0x301, &context, b"u", b"x"),
            crc8(0x201, &Context { session: 4, ..context }, b"u", b"x"),
            crc8(0x201, &Context { seal: 6, ..context }, b"u", b"x"),
            crc8(0x201, &context, b"v", b"x"),
            crc8(0x201, &context, b"u", b"y"),
        ];
        // Each of them alone; two changes together may well make up for each other in 8 bits.
        let [right, wrong @ ..] = sums;
        assert!(wrong.iter().all(|sum| *sum != right), "{sums:?}");
    }

    #[test]
    fn sessions_are_told_apart_or_said_to_be_alike() {
        let context = |session| Context { session, seal: 0x1234_5678_9abc_def0, key: None };
        let ids = [ids::SETPOINT_T, ids::SETPOINT_R, ids::STATUS];
        let same =
            |a: &Context, b: &Context| ids.map(|id| sum8(id, a, 5, b"data") == sum8(id, b, 5, b"data"));
        let alike = (2..60_000).filter(|other| {
            let [t, r, rest] = same(&context(1), &context(*other));
            assert_eq!(context(1).resembles(&context(*other)), (t && r) || rest);
            t && r
        });
        assert!(alike.count() < 8);
        for session in 1..2_000 {
            let none = same(&context(session), &Context::NONE);
            assert_eq!(context(session).is_usable(), none == [false; 3]);
        }
        assert!(!Context::NONE.is_usable());
    }

    #[test]
    fn no_session_has_no_plan() {
        assert_eq!(Context { session: NO_SESSION, seal: 9, key: None }.of(NO_SESSION), Context::NONE);
        let context = Context { session: 3, seal: 5, key: None };
        assert_eq!([context.of(3), context.of(0)], [context, Context::NONE]);
        assert_eq!(context.of(4), Context { session: 4, seal: 0, key: None });
    }
}
