//! Checksums of frames, and what they cover without its being sent.
//!
//! A frame that is whole but not meant (of another session, another plan, another 65.536 mm) has to fail like one that
//! is damaged; so the checksum covers what both ends know anyway.
//!
//! A CRC is linear: whether the frames of one session pass for those of another does not depend on the frames. Eight bits
//! that cover the session number itself would take all frames of every 256th foreign session. So the two halves of a
//! setpoint cover different bytes of a key made from session and plan, a session is usable only if its key cannot be taken
//! for that of no session, and an arm opens none that could be taken for one that is over.

use crc::{CRC_8_AUTOSAR, CRC_32_ISO_HDLC, Crc, NoTable};

use super::{ids, message::NO_SESSION};

/// CRC-8/AUTOSAR: polynomial 0x2F, initial value and final exclusive-or 0xFF.
static CRC8: Crc<u8, NoTable> = Crc::<u8, NoTable>::new(&CRC_8_AUTOSAR);
static CRC32: Crc<u32, NoTable> = Crc::<u32, NoTable>::new(&CRC_32_ISO_HDLC);

/// Session and plan that both ends know.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Context {
    /// Number of the session, or [`NO_SESSION`].
    pub session: u16,
    /// Content hash of its plan; does not count without a session.
    pub plan_hash: u64,
}

impl Context {
    /// No session.
    pub const NONE: Self = Self { session: NO_SESSION, plan_hash: 0 };

    /// One byte each for translation, for rotation, and for everything else; zero without a session.
    #[must_use]
    pub fn key(&self) -> [u8; 3] {
        if self.session == NO_SESSION {
            return [0; 3];
        }
        let mut digest = CRC32.digest();
        digest.update(&self.session.to_le_bytes());
        digest.update(&self.plan_hash.to_le_bytes());
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

    /// The first usable context of the same plan, beginning with this session's number.
    #[must_use]
    pub fn usable(mut self) -> Self {
        while !self.is_usable() {
            self = self.next();
        }
        self
    }

    /// The next session number with the same plan.
    #[must_use]
    pub const fn next(self) -> Self {
        Self { session: self.session.wrapping_add(1), ..self }
    }

    /// What the other end must know of `session` if this end is in `self`.
    pub(super) fn of(&self, session: u16) -> Self {
        if session == self.session { self.normalised() } else { Self { session, plan_hash: 0 } }
    }

    pub(super) fn normalised(&self) -> Self {
        if self.session == NO_SESSION { Self::NONE } else { *self }
    }
}

/// Checksum of a classic frame.
pub(super) fn crc8(id: u16, context: &Context, tick: u32, payload: &[u8]) -> u8 {
    let mut digest = CRC8.digest();
    digest.update(&id.to_le_bytes());
    digest.update(&[key_of(id, context)]);
    digest.update(&tick.to_le_bytes());
    digest.update(payload);
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

/// Checksum of an FD frame; session and tick are part of `covered`.
pub(super) fn crc32(id: u16, plan_hash: u64, covered: &[u8]) -> u32 {
    let mut digest = CRC32.digest();
    digest.update(&id.to_le_bytes());
    digest.update(&plan_hash.to_le_bytes());
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
        let context = Context { session: 3, plan_hash: 5 };
        let sums = [
            crc8(0x201, &context, 7, b"x"),
            crc8(0x301, &context, 7, b"x"),
            crc8(0x201, &Context { session: 4, ..context }, 7, b"x"),
            crc8(0x201, &Context { plan_hash: 6, ..context }, 7, b"x"),
            crc8(0x201, &context, 7 + 256, b"x"),
            crc8(0x201, &context, 7, b"y"),
        ];
        // Each of them alone; two changes together may well make up for each other in 8 bits.
        let [right, wrong @ ..] = sums;
        assert!(wrong.iter().all(|sum| *sum != right), "{sums:?}");
    }

    #[test]
    fn sessions_are_told_apart_or_said_to_be_alike() {
        let context = |session| Context { session, plan_hash: 0x1234_5678_9abc_def0 };
        let ids = [ids::SETPOINT_T, ids::SETPOINT_R, ids::STATUS];
        let same =
            |a: &Context, b: &Context| ids.map(|id| crc8(id, a, 5, b"data") == crc8(id, b, 5, b"data"));
        let alike = (2..60_000).filter(|other| {
            let [t, r, rest] = same(&context(1), &context(*other));
            assert_eq!(context(1).resembles(&context(*other)), (t && r) || rest);
            t && r
        });
        assert!(alike.count() < 8);
        for session in 1..2_000 {
            let none = same(&context(session), &Context::NONE);
            assert_eq!(context(session).is_usable(), none == [false; 3]);
            assert!(context(session).usable().is_usable());
        }
        assert!(!Context::NONE.is_usable() && context(u16::MAX).next().usable().session != NO_SESSION);
    }

    #[test]
    fn no_session_has_no_plan() {
        assert_eq!(Context { session: NO_SESSION, plan_hash: 9 }.of(NO_SESSION), Context::NONE);
        let context = Context { session: 3, plan_hash: 5 };
        assert_eq!([context.of(3), context.of(0)], [context, Context::NONE]);
        assert_eq!(context.of(4), Context { session: 4, plan_hash: 0 });
    }
}
