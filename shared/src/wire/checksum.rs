//! Checksums of frames, and what they cover without its being sent.
//!
//! A frame that is whole but not meant (of another session, another plan, another 65.536 mm) has to fail like one that
//! is damaged; so the checksum covers what both ends know anyway.

use crc::{CRC_8_AUTOSAR, CRC_32_ISO_HDLC, Crc, NoTable};

use super::message::NO_SESSION;

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
    digest.update(&context.session.to_le_bytes());
    digest.update(&tick.to_le_bytes());
    digest.update(&context.plan_hash.to_le_bytes());
    digest.update(payload);
    digest.finalize()
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
        for (i, a) in sums.iter().enumerate() {
            assert!(sums.iter().skip(i + 1).all(|b| a != b), "{sums:?}");
        }
    }

    #[test]
    fn no_session_has_no_plan() {
        assert_eq!(Context { session: NO_SESSION, plan_hash: 9 }.of(NO_SESSION), Context::NONE);
        let context = Context { session: 3, plan_hash: 5 };
        assert_eq!([context.of(3), context.of(0)], [context, Context::NONE]);
        assert_eq!(context.of(4), Context { session: 4, plan_hash: 0 });
    }
}
