//! One frame, whatever carries it: classic CAN, CAN FD, or a serial line as a tunnel for CAN FD.

use heapless::Vec;

/// Most data bytes of a frame.
pub const MAX_DATA: usize = 64;

/// A frame with an 11-bit identifier.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Frame {
    /// Identifier, 0..=0x7FF.
    pub id: u16,
    /// Data: at most 8 bytes on classic CAN, a length that CAN FD knows elsewhere.
    pub data: Vec<u8, MAX_DATA>,
}

/// The two ways messages are put into frames.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Dialect {
    /// Frames of at most 8 bytes: classic CAN.
    Classic,
    /// Frames of at most 64 bytes: CAN FD, and serial lines.
    Fd,
}
