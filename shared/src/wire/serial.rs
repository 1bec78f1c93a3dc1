//! CAN FD frames on a serial line: COBS of (identifier, data), then 0x00.

use core::fmt;

use heapless::Vec;

use super::cobs::{self, CobsError};
use super::frame::{Frame, MAX_DATA, append};

/// Bytes of the identifier.
const ID_BYTES: usize = 2;

/// Most bytes of a packet.
const MAX_PACKET: usize = MAX_DATA + ID_BYTES;

/// Most bytes of a frame on the line: one code byte, identifier, data, delimiter.
pub const MAX_LINE_BYTES: usize = MAX_PACKET + 2;

/// The bytes of a frame. A sender puts one 0x00 before its first frame, for whatever the line held before.
#[must_use]
pub fn to_line(frame: &Frame) -> Vec<u8, MAX_LINE_BYTES> {
    let mut packet = Vec::<u8, MAX_PACKET>::new();
    let mut line = Vec::new();
    // Both have room for any frame, as a test shows.
    let _ = append(&mut packet, &frame.id.to_le_bytes());
    let _ = append(&mut packet, &frame.data);
    let _ = cobs::encode(&packet, &mut line);
    line
}

/// Why what lies between two delimiters is no frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LineError {
    /// It is no packet.
    Cobs(CobsError),
    /// It has no identifier of 11 bits.
    NoId,
}

impl fmt::Display for LineError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Cobs(error) => error.fmt(f),
            Self::NoId => f.write_str("the packet does not begin with an identifier of 11 bits"),
        }
    }
}

impl core::error::Error for LineError {}

/// Takes frames out of a line, byte by byte.
#[derive(Clone, Debug, Default)]
pub struct LineReader {
    packets: cobs::Decoder<MAX_PACKET>,
}

impl LineReader {
    /// A reader at the begin of a line.
    #[must_use]
    pub const fn new() -> Self {
        Self { packets: cobs::Decoder::new() }
    }

    /// Takes one byte; a frame, or why there is none, at each delimiter that ends something.
    pub fn push(&mut self, byte: u8) -> Option<Result<Frame, LineError>> {
        self.packets.push(byte).map(|packet| match packet {
            Ok(packet) => frame(&packet).ok_or(LineError::NoId),
            Err(error) => Err(LineError::Cobs(error)),
        })
    }
}

fn frame(packet: &[u8]) -> Option<Frame> {
    let (id, data) = packet.split_first_chunk::<ID_BYTES>()?;
    Frame::new(u16::from_le_bytes(*id), data)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::vec::Vec as StdVec;

    fn read(line: &[u8]) -> StdVec<Result<Frame, LineError>> {
        let mut reader = LineReader::new();
        line.iter().filter_map(|byte| reader.push(*byte)).collect()
    }

    #[test]
    fn the_longest_frame_fits() {
        for fill in [0, 1, 0xFF] {
            let frame = Frame::new(0x7FF, &[fill; 64]).unwrap();
            let line = to_line(&frame);
            assert_eq!(line.len(), MAX_LINE_BYTES);
            assert_eq!(read(&line), [Ok(frame)]);
        }
    }

    #[test]
    fn a_packet_without_identifier_is_no_frame() {
        assert_eq!(read(&[2, 1, 0]), [Err(LineError::NoId)]);
        assert_eq!(read(&[3, 1, 8, 0]), [Err(LineError::NoId)]);
        assert_eq!(read(&[3, 1, 0]), [Err(LineError::Cobs(CobsError::Truncated))]);
        assert_eq!(
            read(&[[0xFE; 200].as_slice(), &[0]].concat()),
            [Err(LineError::Cobs(CobsError::TooLong))]
        );
    }

    proptest! {
        #[test]
        fn frames_survive(frames in prop::collection::vec((0..0x800_u16, prop::collection::vec(any::<u8>(), 0..=64)), 0..9)) {
            let frames: StdVec<Frame> = frames.iter().map(|(id, data)| Frame::new(*id, data).unwrap()).collect();
            let line: StdVec<u8> = frames.iter().flat_map(to_line).collect();
            prop_assert_eq!(read(&line).into_iter().collect::<Result<StdVec<_>, _>>(), Ok(frames));
        }
    }
}
