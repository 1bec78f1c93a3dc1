//! One frame, whatever carries it: classic CAN, CAN FD, or a serial line as a tunnel for CAN FD.

use heapless::Vec;

use crate::displacement::Lsb;

/// Most data bytes of a frame.
pub const MAX_DATA: usize = 64;

/// Largest identifier: 11 bits.
pub const MAX_ID: u16 = 0x7FF;

/// Numbers of data bytes that a CAN FD frame can have beyond 8 (ISO 11898-1, data length codes 9 to 15).
const FD_LENGTHS: [usize; 7] = [12, 16, 20, 24, 32, 48, 64];

/// A frame with an 11-bit identifier.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Frame {
    /// Identifier, 0..=0x7FF.
    pub id: u16,
    /// Data: at most 8 bytes on classic CAN, a length that CAN FD knows elsewhere.
    pub data: Vec<u8, MAX_DATA>,
}

impl Frame {
    /// A frame as it came from outside; `None` if the identifier or the data are too long for any bus.
    #[must_use]
    pub fn new(id: u16, data: &[u8]) -> Option<Self> {
        let mut frame = Self { id, data: Vec::new() };
        append(&mut frame.data, data)?;
        (id <= MAX_ID).then_some(frame)
    }
}

/// Appends bytes; `None`, with some of them appended, if there is no room. (`Vec::extend_from_slice` adds two lengths, which a
/// build with overflow checks cannot see to be small: a microcontroller's program would not link without a panic.)
pub(super) fn append<const N: usize>(out: &mut Vec<u8, N>, bytes: &[u8]) -> Option<()> {
    bytes.iter().try_for_each(|byte| out.push(*byte).ok())
}

/// The smallest number of data bytes that CAN FD has room for `bytes` in; 64 for anything larger.
#[must_use]
pub fn fd_length(bytes: usize) -> usize {
    if bytes <= 8 {
        return bytes;
    }
    FD_LENGTHS.into_iter().find(|length| *length >= bytes).unwrap_or(MAX_DATA)
}

/// The two ways messages are put into frames.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Dialect {
    /// Frames of at most 8 bytes: classic CAN.
    Classic,
    /// Frames of at most 64 bytes: CAN FD, and serial lines.
    Fd,
}

impl Dialect {
    /// How far apart, in counts, two setpoints may be for the second to be understood by the first; any distance if `None`.
    #[must_use]
    pub const fn span(self) -> Option<u32> {
        match self {
            Self::Classic => Some(32_767),
            Self::Fd => None,
        }
    }

    /// Both.
    pub const ALL: [Self; 2] = [Self::Classic, Self::Fd];

    /// What one count is worth on the wire: 1 um and 10 urad in 8 bytes, 0.1 um and 0.1 urad where there is room.
    #[must_use]
    pub const fn lsb(self) -> Lsb {
        match self {
            Self::Classic => Lsb { translation_nm: 1_000, rotation_nrad: 10_000 },
            Self::Fd => Lsb { translation_nm: 100, rotation_nrad: 100 },
        }
    }

    /// Most data bytes of a frame.
    #[must_use]
    pub const fn max_data(self) -> usize {
        match self {
            Self::Classic => 8,
            Self::Fd => MAX_DATA,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    #[test]
    fn lengths_are_those_of_can_fd() {
        let lengths: Vec<usize> = (0..=64).filter(|bytes| fd_length(*bytes) == *bytes).collect();
        assert_eq!(lengths, [0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64]);
        assert_eq!([fd_length(9), fd_length(33), fd_length(64)], [12, 48, 64]);
    }

    #[test]
    fn a_frame_has_eleven_bits_and_sixty_four_bytes() {
        assert!(Frame::new(0x7FF, &[0; 64]).is_some());
        assert!(Frame::new(0x800, &[]).is_none() && Frame::new(0, &[0; 65]).is_none());
    }
}
