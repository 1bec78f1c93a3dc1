//! Why bytes are no plan.

use core::fmt;

use super::{FORMAT_VERSION, MAX_FILE_BYTES};
use crate::displacement::SetpointError;
use crate::limits::LimitsError;

/// Why bytes are no plan, or a plan cannot be written.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum PlanError {
    /// Fewer bytes than the smallest plan.
    TooShort {
        /// Bytes there.
        bytes: usize,
        /// Bytes that even an empty plan has.
        least: usize,
    },
    /// More bytes than any plan.
    TooLong {
        /// Bytes there.
        bytes: u64,
    },
    /// The first bytes are not the plan's.
    NotAPlan {
        /// The first bytes.
        found: [u8; 8],
    },
    /// Another format version.
    Version {
        /// Version of the file.
        found: u16,
    },
    /// The checksum does not fit the bytes.
    Checksum {
        /// At the end of the file.
        stored: u32,
        /// Of the bytes.
        computed: u32,
    },
    /// The header cannot be decoded.
    Header,
    /// A header field is NaN or infinite.
    NotFinite {
        /// Which.
        field: &'static str,
        /// Its value.
        value: f64,
    },
    /// A header field is outside its range.
    OutOfRange {
        /// Which.
        field: &'static str,
        /// Its value.
        value: u32,
        /// Least accepted.
        min: u32,
        /// Most accepted.
        max: u32,
    },
    /// A normalised skill parameter is outside [-1, 1].
    ThetaOutOfRange {
        /// Its value.
        value: f64,
    },
    /// A mass is negative.
    NegativeMass {
        /// Which one.
        field: &'static str,
        /// Its value, kilograms.
        value: f64,
    },
    /// The cells of the finer grid have no size.
    NoCell {
        /// Their edge, metres.
        value: f64,
    },
    /// An orientation is no rotation.
    OrientationNotUnit {
        /// What it is of.
        field: &'static str,
        /// Norm of the quaternion.
        norm: f64,
    },
    /// The limits cannot be limits.
    Limits(LimitsError),
    /// A step cannot be decoded.
    Step {
        /// Its number, from 1.
        step: u32,
        /// How many the header promises.
        step_count: u32,
    },
    /// A step leads to no setpoint.
    Setpoint(SetpointError),
    /// Bytes remain after the last step.
    TrailingBytes {
        /// How many.
        bytes: usize,
    },
    /// The writer was given another number of steps than the header promises.
    StepCount {
        /// Steps given.
        given: u32,
        /// Steps promised.
        promised: u32,
    },
}

impl fmt::Display for PlanError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::TooShort { bytes, least } => {
                write!(f, "it holds {bytes} bytes, but even the smallest plan has {least}")
            }
            Self::TooLong { bytes } => {
                write!(f, "it holds {bytes} bytes, but a plan has at most {MAX_FILE_BYTES}")
            }
            Self::NotAPlan { found } => write!(
                f,
                "it begins with \"{}\", but a plan begins with \"{}\"",
                found.escape_ascii(),
                super::MAGIC.escape_ascii()
            ),
            Self::Version { found } => write!(
                f,
                "it has plan format version {found}, but this program reads version {FORMAT_VERSION} only"
            ),
            Self::Checksum { stored, computed } => write!(
                f,
                "its checksum is {stored:#010x}, but its bytes give {computed:#010x}: the file is damaged or cut short; \
                 copy it again or make it anew"
            ),
            Self::Header => {
                write!(f, "its header cannot be decoded although its checksum is right; make it anew")
            }
            Self::NotFinite { field, value } => {
                write!(f, "its {field} holds {value}, but only finite numbers have a meaning there")
            }
            Self::OutOfRange { field, value, min, max } => {
                write!(f, "its {field} is {value}, but must lie between {min} and {max}")
            }
            Self::ThetaOutOfRange { value } => {
                write!(f, "its theta holds {value}, but each component must lie between -1 and 1")
            }
            Self::NegativeMass { field, value } => {
                write!(f, "its {field} is {value} kg, but must not be negative")
            }
            Self::NoCell { value } => {
                write!(f, "its finer grid has cells of {value} m, but they must be larger than 0")
            }
            Self::OrientationNotUnit { field, norm } => {
                write!(f, "its {field} is a quaternion of norm {norm}, but must have norm 1")
            }
            Self::Limits(error) => error.fmt(f),
            Self::Step { step, step_count } => {
                write!(
                    f,
                    "its step {step} of {step_count} cannot be decoded, although its checksum is right; make it anew"
                )
            }
            Self::Setpoint(error) => error.fmt(f),
            Self::TrailingBytes { bytes } => {
                write!(f, "{bytes} bytes follow its last step, but nothing but the checksum may")
            }
            Self::StepCount { given, promised } => {
                write!(f, "it was given {given} steps, but its header promises {promised}")
            }
        }
    }
}

impl core::error::Error for PlanError {}

impl From<LimitsError> for PlanError {
    fn from(error: LimitsError) -> Self {
        Self::Limits(error)
    }
}

impl From<SetpointError> for PlanError {
    fn from(error: SetpointError) -> Self {
        Self::Setpoint(error)
    }
}
