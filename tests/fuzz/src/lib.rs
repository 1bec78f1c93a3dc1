//! What the fuzz targets have in common: bytes as frames, and checksums made right so that what they guard is reached.

use powderline_shared::wire::Context;
use powderline_shared::wire::codec::{FromArmDecoder, ToArmDecoder};
use powderline_shared::wire::frame::{Dialect, Frame};
use powderline_shared::wire::ids;

/// Session of all targets.
pub const CONTEXT: Context = Context { session: 0x1234, plan_hash: 0x0123_4567_89ab_cdef };

const IDS: [u16; 12] = [
    ids::STOP,
    ids::FAULT,
    ids::STATUS,
    ids::SETPOINT_T,
    ids::ACTUAL_T,
    ids::SETPOINT_R,
    ids::ACTUAL_R,
    ids::CONTROL,
    ids::HANDSHAKE_FROM_ARM,
    ids::HANDSHAKE_TO_ARM,
    ids::HEARTBEAT_FROM_ARM,
    ids::HEARTBEAT_TO_ARM,
];

/// Frames from bytes: one that chooses the identifier, one for the length, data; and so on.
pub fn frames(mut bytes: &[u8]) -> impl Iterator<Item = Frame> {
    std::iter::from_fn(move || {
        let ([choice, length], rest) = bytes.split_first_chunk::<2>()?;
        let (data, rest) = rest.split_at(usize::from(*length).min(64).min(rest.len()));
        bytes = rest;
        Frame::new(IDS[usize::from(*choice) % IDS.len()], data)
    })
}

/// The frame with its first four bytes replaced by the checksum of FD frames, for the session that it names.
pub fn sealed_fd(frame: &Frame) -> Frame {
    let mut sealed = frame.clone();
    if sealed.data.len() < 12 {
        return sealed;
    }
    let plan_hash = if sealed.data[8..10] == [0, 0] { 0 } else { CONTEXT.plan_hash };
    let covered = [&frame.id.to_le_bytes()[..], &plan_hash.to_le_bytes(), &frame.data[4..]].concat();
    sealed.data[..4].copy_from_slice(&crc32(&covered).to_le_bytes());
    sealed
}

/// CRC-32/ISO-HDLC.
pub fn crc32(bytes: &[u8]) -> u32 {
    crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC).checksum(bytes)
}

/// An arm's decoder in the session.
pub fn arm(dialect: Dialect) -> ToArmDecoder {
    let mut decoder = ToArmDecoder::new(dialect);
    decoder.set_context(CONTEXT);
    decoder
}

/// An executor's decoder in the session.
pub fn executor(dialect: Dialect) -> FromArmDecoder {
    let mut decoder = FromArmDecoder::new(dialect);
    decoder.set_context(CONTEXT);
    decoder
}
