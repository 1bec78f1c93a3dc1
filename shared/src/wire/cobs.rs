//! Consistent overhead byte stuffing: packets on a byte stream, each ended by a 0x00 that occurs nowhere else.
//!
//! After S. Cheshire and M. Baker, "Consistent Overhead Byte Stuffing", IEEE/ACM Transactions on Networking 7 (2), 1999.
//! Each block is a code byte n and n - 1 bytes that are not 0; a 0 follows each block but the last and those of code 0xFF.

use core::fmt;

use heapless::Vec;

use super::frame::append;

/// Ends a packet.
pub const DELIMITER: u8 = 0;

/// Code of a block of 254 bytes that no 0 follows.
const FULL: u8 = 0xFF;

/// Bytes of such a block.
const FULL_BYTES: usize = 254;

/// The encoding does not fit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NoRoom;

impl fmt::Display for NoRoom {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("the encoded packet is longer than the room for it")
    }
}

impl core::error::Error for NoRoom {}

/// Appends the encoding of `packet` and its delimiter: at most `1 + len / 254` code bytes and the delimiter more than the
/// packet.
///
/// # Errors
/// `out` is too small; it then holds part of the encoding.
pub fn encode<const N: usize>(packet: &[u8], out: &mut Vec<u8, N>) -> Result<(), NoRoom> {
    let mut groups = packet.split(|byte| *byte == DELIMITER).peekable();
    while let Some(group) = groups.next() {
        let mut rest = group;
        while let Some((full, after)) = rest.split_at_checked(FULL_BYTES) {
            put_block(full, FULL, out)?;
            rest = after;
        }
        // A full block may end the packet; before a 0 it cannot.
        let ended = rest.is_empty() && !group.is_empty() && groups.peek().is_none();
        if !ended {
            // Shorter than 254: the largest code here is 254.
            let code = u8::try_from(rest.len()).unwrap_or(FULL).saturating_add(1);
            put_block(rest, code, out)?;
        }
    }
    out.push(DELIMITER).map_err(|_| NoRoom)
}

fn put_block<const N: usize>(bytes: &[u8], code: u8, out: &mut Vec<u8, N>) -> Result<(), NoRoom> {
    out.push(code).map_err(|_| NoRoom)?;
    append(out, bytes).ok_or(NoRoom)
}

/// Why what lies between two delimiters is no packet.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CobsError {
    /// It is longer than any packet; the rest of it was not looked at.
    TooLong,
    /// It ends within a block.
    Truncated,
}

impl fmt::Display for CobsError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::TooLong => "the bytes up to the delimiter are more than any packet has",
            Self::Truncated => "the delimiter came before the end of a block",
        })
    }
}

impl core::error::Error for CobsError {}

/// Takes packets of at most `N` bytes out of a stream, byte by byte. Whatever has come before, the packet that follows a
/// delimiter is read right.
#[derive(Clone, Debug, Default)]
pub struct Decoder<const N: usize> {
    packet: Vec<u8, N>,
    /// Bytes that the block still needs.
    missing: u8,
    /// Whether the block that is complete stands for a 0 as well, should another follow.
    zero_due: bool,
    /// Whether anything has come since the delimiter.
    begun: bool,
    too_long: bool,
}

impl<const N: usize> Decoder<N> {
    /// A decoder at the begin of a stream.
    #[must_use]
    pub const fn new() -> Self {
        Self { packet: Vec::new(), missing: 0, zero_due: false, begun: false, too_long: false }
    }

    /// Takes one byte. A delimiter ends a packet, or what should have been one; several of them in a row are as good as
    /// one.
    pub fn push(&mut self, byte: u8) -> Option<Result<Vec<u8, N>, CobsError>> {
        if byte == DELIMITER {
            let ended = core::mem::take(self);
            return ended.begun.then(|| ended.into_packet());
        }
        self.begun = true;
        if self.too_long {
            return None;
        }
        let kept = if self.missing == 0 { self.begin_block(byte) } else { self.keep(byte) };
        self.too_long = kept.is_none();
        None
    }

    fn begin_block(&mut self, code: u8) -> Option<()> {
        if self.zero_due {
            self.packet.push(0).ok()?;
        }
        self.zero_due = code != FULL;
        // A code is not 0, or it would be a delimiter.
        self.missing = code.saturating_sub(1);
        Some(())
    }

    fn keep(&mut self, byte: u8) -> Option<()> {
        self.missing = self.missing.saturating_sub(1);
        self.packet.push(byte).ok()
    }

    fn into_packet(self) -> Result<Vec<u8, N>, CobsError> {
        if self.too_long {
            Err(CobsError::TooLong)
        } else if self.missing > 0 {
            Err(CobsError::Truncated)
        } else {
            Ok(self.packet)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::vec;
    use std::vec::Vec as StdVec;

    fn encoded(packet: &[u8]) -> StdVec<u8> {
        let mut out = Vec::<u8, 1024>::new();
        encode(packet, &mut out).unwrap();
        out.to_vec()
    }

    fn decoded<const N: usize>(stream: &[u8]) -> StdVec<Result<StdVec<u8>, CobsError>> {
        let mut decoder = Decoder::<N>::new();
        let packets = stream.iter().filter_map(|byte| decoder.push(*byte));
        packets.map(|packet| packet.map(|packet| packet.to_vec())).collect()
    }

    /// The examples that Wikipedia's article and many implementations have in common.
    fn published() -> StdVec<(StdVec<u8>, StdVec<u8>)> {
        let run = |from: u8, to: u8| (from..=to).collect::<StdVec<u8>>();
        let join = |parts: &[&[u8]]| parts.concat();
        vec![
            (vec![], vec![1, 0]),
            (vec![0], vec![1, 1, 0]),
            (vec![0, 0], vec![1, 1, 1, 0]),
            (vec![0, 0x11, 0], vec![1, 2, 0x11, 1, 0]),
            (vec![0x11, 0x22, 0, 0x33], vec![3, 0x11, 0x22, 2, 0x33, 0]),
            (vec![0x11, 0x22, 0x33, 0x44], vec![5, 0x11, 0x22, 0x33, 0x44, 0]),
            (vec![0x11, 0, 0, 0], vec![2, 0x11, 1, 1, 1, 0]),
            (run(1, 0xFE), join(&[&[0xFF], &run(1, 0xFE), &[0]])),
            (run(0, 0xFE), join(&[&[1, 0xFF], &run(1, 0xFE), &[0]])),
            (run(1, 0xFF), join(&[&[0xFF], &run(1, 0xFE), &[2, 0xFF, 0]])),
            (join(&[&run(2, 0xFF), &[0]]), join(&[&[0xFF], &run(2, 0xFF), &[1, 1, 0]])),
            (join(&[&run(3, 0xFF), &[0, 1]]), join(&[&[0xFE], &run(3, 0xFF), &[2, 1, 0]])),
        ]
    }

    #[test]
    fn published_examples() {
        for (packet, stream) in published() {
            assert_eq!(encoded(&packet), stream);
            assert_eq!(decoded::<512>(&stream), [Ok(packet)]);
        }
    }

    #[test]
    fn what_is_no_packet_is_said_so_and_the_next_is_read() {
        let stream = [9, 1, 2, 0, 0, 0, 3, 1, 2, 0, 1, 1, 1, 1, 1, 1, 0, 2, 7, 0];
        let found = decoded::<4>(&stream);
        let expected = [Err(CobsError::Truncated), Ok(vec![1, 2]), Err(CobsError::TooLong), Ok(vec![7])];
        assert_eq!(found, expected);
        assert_eq!(decoded::<4>(&[0xFF; 2_000]), []);
    }

    #[test]
    fn no_room_is_no_panic() {
        for length in 0..6 {
            let mut out = Vec::<u8, 5>::new();
            assert_eq!(encode(&vec![7; length], &mut out).is_ok(), length <= 3);
        }
    }

    proptest! {
        #[test]
        fn packets_survive_after_any_noise(
            packets in prop::collection::vec(prop::collection::vec(0..4_u8, 0..600), 1..4), noise: StdVec<u8>,
        ) {
            let mut stream = noise;
            stream.push(0);
            let before = decoded::<600>(&stream).len();
            for packet in &packets {
                let bytes = encoded(packet);
                let overhead = bytes.len().saturating_sub(packet.len());
                prop_assert!(overhead.saturating_sub(2) <= packet.len() / 254);
                prop_assert!(bytes.iter().rev().skip(1).all(|byte| *byte != 0));
                stream.extend(bytes);
            }
            let found: StdVec<_> = decoded::<600>(&stream).into_iter().skip(before).collect();
            let expected: StdVec<_> = packets.into_iter().map(Ok).collect();
            prop_assert_eq!(found, expected);
        }
    }
}
