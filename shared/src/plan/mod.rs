//! The plan file: one optimised motion, where it comes from and what it is expected to do.
//!
//! | bytes    | content                                                                       |
//! |----------|-------------------------------------------------------------------------------|
//! | 8        | [`MAGIC`]                                                                     |
//! | 2        | format version, little-endian                                                 |
//! | variable | [`PlanHeader`] in postcard                                                    |
//! | variable | `step_count` times six zigzag varints ([`StepCounts`](crate::displacement::StepCounts)) in postcard |
//! | 4        | CRC-32 (ISO-HDLC) over everything before, little-endian                       |
//!
//! A reader works on a byte slice, in flash or mapped from a file, without allocating; it checks all of it once and then
//! hands out one step at a time. The content hash that names a plan elsewhere is FNV-1a (64 bits) over the whole file:
//! it tells plans apart by accident-proof odds, it is no protection against an adversary.

mod checksum;
mod error;
#[cfg(feature = "std")]
pub mod file;
mod header;
mod parameter;
mod reader;
mod writer;

pub use checksum::{Crc32, Fnv1a64};
pub use error::PlanError;
pub use header::{
    Finer, MAX_STEPS, Mounting, PERIOD_US_MAX, PERIOD_US_MIN, PlanHeader, Precision, Prediction, StartPose,
    Version,
};
pub use parameter::SkillParameter;
pub use reader::{PlanReader, Setpoints, Steps};
pub use writer::{PlanSummary, PlanWriter, Sink, SliceSink, WriteError};

/// First bytes of every plan file.
pub const MAGIC: [u8; 8] = *b"PWDLPLAN";

/// The format version that this crate writes, and the only one that it reads.
pub const FORMAT_VERSION: u16 = 4;

/// No plan is larger; a reader may refuse a longer file unread.
pub const MAX_FILE_BYTES: usize = 32 * 1024 * 1024;

/// No header in postcard is larger.
pub const MAX_HEADER_BYTES: usize = 768;

/// Magic and version.
const PREFIX_BYTES: usize = 10;

/// The checksum.
const SUFFIX_BYTES: usize = 4;

/// Six varints of at most five bytes.
const MAX_STEP_BYTES: usize = 30;
