//! Frames on the serial line, as `powderline_host::cobs` has them on the host.
//!
//! Frames on a serial line: id (u16, little-endian) and data, stuffed by COBS so that a zero ends each frame and occurs
//! nowhere else.
//!
//! Source: S. Cheshire, M. Baker, "Consistent Overhead Byte Stuffing", IEEE/ACM Transactions on Networking 7(2), 1999. A
//! frame is at most [`MAX_RAW`] bytes, so a code byte never has to stand for a full block of 254.

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
                if core::mem::replace(&mut self.zero_due, true) {
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
