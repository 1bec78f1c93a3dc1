//! Why a frame says nothing: what the codec answers with.

use core::fmt;

use super::frame::Frame;

/// Why a frame says nothing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Rejected {
    /// The identifier is not one of this direction and dialect.
    UnknownId {
        /// Identifier.
        id: u16,
    },
    /// The frame does not have the length of its kind.
    Length {
        /// Identifier.
        id: u16,
        /// Data bytes.
        len: u8,
    },
    /// The checksum is wrong: damage, another session, another plan, or too far from what was decoded last.
    Checksum {
        /// Identifier.
        id: u16,
    },
    /// The type in the frame is not that of its identifier.
    Type {
        /// Identifier.
        id: u16,
        /// Type.
        number: u8,
    },
    /// A reserved field is not zero.
    Reserved {
        /// Identifier.
        id: u16,
    },
    /// A word has no meaning.
    Word {
        /// Identifier.
        id: u16,
        /// Controlword, statusword, EMCY error code or NMT state.
        word: u16,
    },
    /// Two halves of one kind and tick differ.
    Contradiction {
        /// Identifier.
        id: u16,
        /// Tick.
        tick: u32,
    },
    /// A handshake segment is one that no record has.
    Segment {
        /// Identifier.
        id: u16,
    },
    /// A handshake record is damaged or has no meaning.
    Record {
        /// Identifier.
        id: u16,
    },
}

impl Rejected {
    pub(super) fn length(frame: &Frame) -> Self {
        Self::Length { id: frame.id, len: u8::try_from(frame.data.len()).unwrap_or(u8::MAX) }
    }
}

impl fmt::Display for Rejected {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::UnknownId { id } => write!(f, "frame {id:#05x} is none that this end listens to"),
            Self::Length { id, len } => {
                write!(f, "frame {id:#05x} has {len} bytes, which is not the length of its kind")
            }
            Self::Checksum { id } => write!(
                f,
                "frame {id:#05x} is damaged, of another session or plan, or too far from the one decoded last"
            ),
            Self::Type { id, number } => {
                write!(f, "frame {id:#05x} says that it is of type {number}, which has another identifier")
            }
            Self::Reserved { id } => write!(f, "frame {id:#05x} sets a field that must be 0 in this version"),
            Self::Word { id, word } => {
                write!(f, "frame {id:#05x} has the word {word:#06x}, which stands for nothing")
            }
            Self::Contradiction { id, tick } => {
                write!(f, "frame {id:#05x} contradicts an earlier one of the same tick {tick}")
            }
            Self::Segment { id } => {
                write!(f, "segment {id:#05x} is empty, not full, overlong or beyond the longest record")
            }
            Self::Record { id } => write!(f, "the record in segments {id:#05x} is damaged or has no meaning"),
        }
    }
}

impl core::error::Error for Rejected {}
