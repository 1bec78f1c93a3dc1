//! Frames on a serial line: id (u16, little-endian) and data, stuffed by COBS so that a zero ends each frame and occurs
//! nowhere else.
//!
//! Source: S. Cheshire, M. Baker, "Consistent Overhead Byte Stuffing", IEEE/ACM Transactions on Networking 7(2), 1999. A
//! frame is at most 66 bytes, so a code byte never has to stand for a full block of 254.

use heapless::Vec;
use powderline_shared::wire::frame::{Frame, MAX_DATA};

/// Most bytes of a frame before stuffing.
const MAX_RAW: usize = MAX_DATA + 2;
/// Most bytes of a frame on the line: one code byte in front, the zero behind.
pub const MAX_ENCODED: usize = MAX_RAW + 2;
/// Highest identifier.
const MAX_ID: u16 = 0x7FF;

/// The bytes of a frame on the line, the zero at the end included.
#[must_use]
pub fn encode(frame: &Frame) -> Vec<u8, MAX_ENCODED> {
    let mut encoded = Vec::new();
    let mut block: Vec<u8, MAX_RAW> = Vec::new();
    // Capacities hold the longest frame, so no push fails; the end of the frame counts as a zero.
    for byte in frame.id.to_le_bytes().into_iter().chain(frame.data.iter().copied()).chain([0]) {
        if byte != 0 {
            let _ = block.push(byte);
            continue;
        }
        let code = u8::try_from(block.len().saturating_add(1)).unwrap_or(u8::MAX);
        let _ = encoded.push(code);
        let _ = encoded.extend_from_slice(&block);
        block.clear();
    }
    let _ = encoded.push(0);
    encoded
}

/// Takes bytes off a line and gives the frames among them. After anything that is no frame it goes on at the next zero.
#[derive(Clone, Debug, Default)]
pub struct Decoder {
    raw: Vec<u8, MAX_RAW>,
    /// Bytes until the next code byte; 0 before the first of a frame.
    left: u8,
    /// A block has ended where no frame may end: a zero of the data comes before what follows.
    zero_due: bool,
    /// Skips to the next zero.
    lost: bool,
    /// Pieces between zeros that were no frames.
    garbled: u64,
}

impl Decoder {
    /// The next byte of the line; the frame that it completes, if it does.
    pub fn push(&mut self, byte: u8) -> Option<Frame> {
        if byte == 0 {
            return self.end();
        }
        if !self.lost && self.take(byte).is_none() {
            self.lost = true;
        }
        None
    }

    /// Forgets a frame that has begun, as when the line is opened anew.
    pub fn reset(&mut self) {
        *self = Self { garbled: self.garbled, ..Self::default() };
    }

    /// Pieces between zeros that were no frames, since the beginning.
    #[must_use]
    pub fn garbled(&self) -> u64 {
        self.garbled
    }

    /// `None` if the byte belongs to no frame.
    fn take(&mut self, byte: u8) -> Option<()> {
        match self.left.checked_sub(1) {
            Some(left) => {
                self.raw.push(byte).ok()?;
                self.left = left;
            }
            None => {
                if std::mem::replace(&mut self.zero_due, true) {
                    self.raw.push(0).ok()?;
                }
                self.left = byte.checked_sub(1)?;
            }
        }
        Some(())
    }

    fn end(&mut self) -> Option<Frame> {
        let empty = !self.lost && !self.zero_due;
        let whole = !self.lost && self.left == 0;
        let frame = whole.then(|| frame(&self.raw)).flatten();
        if frame.is_none() && !empty {
            self.garbled = self.garbled.saturating_add(1);
        }
        self.reset();
        frame
    }
}

fn frame(raw: &[u8]) -> Option<Frame> {
    let (id, data) = raw.split_first_chunk::<2>()?;
    let id = u16::from_le_bytes(*id);
    (id <= MAX_ID).then_some(())?;
    Some(Frame { id, data: Vec::from_slice(data).ok()? })
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn made(id: u16, data: &[u8]) -> Frame {
        Frame { id, data: Vec::from_slice(data).unwrap() }
    }

    fn decode(decoder: &mut Decoder, bytes: &[u8]) -> std::vec::Vec<Frame> {
        bytes.iter().filter_map(|byte| decoder.push(*byte)).collect()
    }

    #[test]
    fn the_bytes_are_those_of_the_paper() {
        assert_eq!(encode(&made(0x201, &[])).as_slice(), [3, 1, 2, 0]);
        assert_eq!(encode(&made(0x001, b"STOP")).as_slice(), [2, 1, 5, b'S', b'T', b'O', b'P', 0]);
        assert_eq!(encode(&made(0x000, &[0, 7])).as_slice(), [1, 1, 1, 2, 7, 0]);
    }

    #[test]
    fn the_longest_frame_fits() {
        let longest = made(0x7FF, &[0xFF; MAX_DATA]);
        let bytes = encode(&longest);
        assert_eq!(bytes.len(), MAX_ENCODED);
        assert_eq!(decode(&mut Decoder::default(), &bytes), [longest]);
    }

    #[test]
    fn a_truncated_frame_is_dropped_and_the_next_one_found() {
        let first = encode(&made(0x181, &[1, 2, 0, 4]));
        let second = made(0x281, &[9; 48]);
        for cut in 1..first.len() - 1 {
            let mut decoder = Decoder::default();
            // The zero that ends the truncated piece is the one that a line sends when it is opened.
            let line = [&first[..cut], &[0], &encode(&second)].concat();
            let frames = decode(&mut decoder, &line);
            assert_eq!(frames.last(), Some(&second), "cut after {cut}");
            // Where a block ends, the piece is a shorter frame, which the messages' own checksums refuse.
            assert_eq!(
                u64::try_from(frames.len()).unwrap() + decoder.garbled(),
                2,
                "cut after {cut}: {frames:?}"
            );
        }
    }

    #[test]
    fn what_is_too_long_or_no_identifier_is_counted_as_garbled() {
        let mut decoder = Decoder::default();
        assert_eq!(decode(&mut decoder, &[0, 0, 0]), []);
        assert_eq!(decoder.garbled(), 0, "an empty piece is no garbage");
        assert_eq!(decode(&mut decoder, &[[0xFF; 300].as_slice(), &[0]].concat()), []);
        assert_eq!(decode(&mut decoder, &[3, 0xFF, 0xFF, 0]), [], "identifier 0xFFFF");
        assert_eq!(decode(&mut decoder, &[2, 1, 0]), [], "one byte is no identifier");
        assert_eq!(decoder.garbled(), 3);
        let good = made(0x701, &[5]);
        assert_eq!(decode(&mut decoder, &encode(&good)), [good]);
    }

    fn any_frame() -> impl Strategy<Value = Frame> {
        let byte = prop_oneof![Just(0_u8), any::<u8>()];
        (0..=MAX_ID, prop::collection::vec(byte, 0..=MAX_DATA)).prop_map(|(id, data)| made(id, &data))
    }

    proptest! {
        #[test]
        fn every_frame_comes_back_after_any_garbage(
            garbage in prop::collection::vec(any::<u8>(), 0..100),
            frames in prop::collection::vec(any_frame(), 1..5),
        ) {
            let mut decoder = Decoder::default();
            decode(&mut decoder, &garbage);
            decode(&mut decoder, &[0]);
            for frame in frames {
                let bytes = encode(&frame);
                prop_assert_eq!(bytes.iter().position(|byte| *byte == 0), Some(bytes.len() - 1));
                prop_assert_eq!(decode(&mut decoder, &bytes), [frame]);
            }
        }
    }
}
