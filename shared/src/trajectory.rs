//! The motion that an arm has made: one pose at each tick of its clock, as text.
//!
//! ```text
//! powderline-executed 1
//! plan 0123456789abcdef
//! period_us 10000
//! 0 0.038 0.032 0.047 0.766044443118978 0.0 0.6427876096865393 0.0
//! 1 0.038 0.032 0.04699 0.766044443118978 0.0 0.6427876096865393 0.0
//! ```
//!
//! First the name of the format and its version, then the content hash of the plan and the period of the arm's clock in
//! microseconds, then one line for each tick: its number, the origin of the tool in the world (x, y, z, metres) and the unit
//! quaternion (w, x, y, z) from tool to world coordinates. Tick 0 is the anchor, tick k the moment at which the plan's step k
//! ends. Ticks follow each other without a gap, also while the arm brakes and settles.
//!
//! Numbers are written in the shortest decimal form that is read back to the same bits. Whoever writes prints a
//! [`TrajectoryHeader`] and then each [`Sample`], a line end after each; whoever reads gives a [`TrajectoryReader`] line by
//! line. Words are separated by any number of spaces, and a line may end as on Windows.

use core::fmt;
use core::str::FromStr;

use crate::plan::{MAX_STEPS, PERIOD_US_MAX, PERIOD_US_MIN, StartPose};
use crate::pose::Pose;

/// First word of every file.
pub const FORMAT_NAME: &str = "powderline-executed";

/// The format version that this crate writes, and the only one that it reads.
pub const FORMAT_VERSION: u32 = 1;

/// Last tick that a motion can have: the longest plan, and ten seconds at the shortest period in which the arm comes to rest.
pub const MAX_TICK: u32 = MAX_STEPS + 100_000;

/// No line is longer, its end not counted; a reader may cut a longer one after one byte more.
pub const MAX_LINE_BYTES: usize = 256;

/// How far an anchor may be from the plan's start pose, metres.
pub const ANCHOR_TOLERANCE_M: f64 = 0.5e-3;

/// How far an anchor may be turned from the plan's start pose, radians.
pub const ANCHOR_TOLERANCE_RAD: f64 = 5e-3;

/// How far the norm of an orientation may be from 1.
const UNIT_TOLERANCE: f64 = 1e-9;

/// As long as the longest number that is written.
const EXCERPT_BYTES: usize = 24;

/// Coordinates in the order of a line.
const COORDINATES: [&str; 7] = ["x", "y", "z", "qw", "qx", "qy", "qz"];

/// Which motion it is. Displays as the first three lines, without the last line end.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TrajectoryHeader {
    /// Content hash of the plan that was played.
    pub plan_hash: u64,
    /// Period of the arm's clock, microseconds.
    pub period_us: u32,
}

impl fmt::Display for TrajectoryHeader {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { plan_hash, period_us } = self;
        write!(f, "{FORMAT_NAME} {FORMAT_VERSION}\nplan {plan_hash:016x}\nperiod_us {period_us}")
    }
}

/// Where the tool was at one tick. Displays as one line, without its end.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// Tick of the arm's clock; 0 is the anchor.
    pub tick: u32,
    /// Pose of the tool in the world.
    pub pose: Pose,
}

impl fmt::Display for Sample {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let StartPose { position_m, orientation_wxyz } = StartPose::from(&self.pose);
        write!(f, "{}", self.tick)?;
        // The debug form has an exponent where there would be many zeros otherwise.
        position_m.iter().chain(&orientation_wxyz).try_for_each(|value| write!(f, " {value:?}"))
    }
}

/// What the next line is to be.
#[derive(Clone, Copy, Debug)]
enum Expected {
    Version,
    Plan,
    Period { plan_hash: u64 },
    Sample { header: TrajectoryHeader, tick: u32 },
}

/// Takes a file line by line.
#[derive(Clone, Copy, Debug)]
pub struct TrajectoryReader {
    /// Lines taken so far.
    lines: u32,
    expected: Expected,
}

impl Default for TrajectoryReader {
    fn default() -> Self {
        Self { lines: 0, expected: Expected::Version }
    }
}

impl TrajectoryReader {
    /// Which motion it is, once the first three lines are there.
    #[must_use]
    pub fn header(&self) -> Option<TrajectoryHeader> {
        match self.expected {
            Expected::Sample { header, .. } => Some(header),
            Expected::Version | Expected::Plan | Expected::Period { .. } => None,
        }
    }

    /// Takes the next line, with or without its end; a sample, if the line is one.
    ///
    /// # Errors
    /// The first thing that is wrong with the line. There is no point in going on then.
    pub fn line(&mut self, line: &[u8]) -> Result<Option<Sample>, TrajectoryError> {
        self.lines = self.lines.saturating_add(1);
        let line = line.strip_suffix(b"\n").unwrap_or(line);
        let mut words = Words { line: self.lines, rest: line };
        if matches!(self.expected, Expected::Version) {
            // Whether it is a file of ours at all is told before anything else.
            words.format_name()?;
        }
        if line.len() > MAX_LINE_BYTES {
            return Err(TrajectoryError::LineTooLong { line: self.lines });
        }
        let (next, sample) = self.read(&mut words)?;
        words.end()?;
        self.expected = next;
        Ok(sample)
    }

    fn read(&self, words: &mut Words<'_>) -> Result<(Expected, Option<Sample>), TrajectoryError> {
        match self.expected {
            Expected::Version => {
                words.version()?;
                Ok((Expected::Plan, None))
            }
            Expected::Plan => Ok((Expected::Period { plan_hash: words.plan_hash()? }, None)),
            Expected::Period { plan_hash } => {
                let header = TrajectoryHeader { plan_hash, period_us: words.period_us()? };
                Ok((Expected::Sample { header, tick: 0 }, None))
            }
            Expected::Sample { header, tick } => {
                let sample = words.sample(tick)?;
                Ok((Expected::Sample { header, tick: tick.saturating_add(1) }, Some(sample)))
            }
        }
    }

    /// Says that no line is left.
    ///
    /// # Errors
    /// The file ends before the first sample.
    pub fn finish(self) -> Result<TrajectoryHeader, TrajectoryError> {
        let wanted = match self.expected {
            Expected::Version => return Err(TrajectoryError::Empty),
            Expected::Plan => "the plan's content hash",
            Expected::Period { .. } => "the control period",
            Expected::Sample { tick: 0, .. } => "the sample of tick 0",
            Expected::Sample { header, .. } => return Ok(header),
        };
        Err(TrajectoryError::EndsEarly { lines: self.lines, wanted })
    }
}

/// The words of one line that are still to be read.
struct Words<'a> {
    line: u32,
    rest: &'a [u8],
}

impl<'a> Words<'a> {
    /// The next word; empty at the end of the line.
    fn next(&mut self) -> &'a [u8] {
        let start = self.rest.trim_ascii_start();
        let length = start.iter().position(u8::is_ascii_whitespace).unwrap_or(start.len());
        let (word, rest) = start.split_at_checked(length).unwrap_or((start, &[]));
        self.rest = rest;
        word
    }

    fn field(&mut self, field: &'static str) -> Result<&'a [u8], TrajectoryError> {
        match self.next() {
            [] => Err(TrajectoryError::Missing { line: self.line, field }),
            word => Ok(word),
        }
    }

    fn parsed<T: FromStr>(
        &mut self,
        field: &'static str,
        wanted: &'static str,
    ) -> Result<T, TrajectoryError> {
        let word = self.field(field)?;
        let value = core::str::from_utf8(word).ok().and_then(|text| text.parse().ok());
        value.ok_or_else(|| self.malformed(field, word, wanted))
    }

    fn malformed(&self, field: &'static str, word: &[u8], wanted: &'static str) -> TrajectoryError {
        TrajectoryError::Malformed { line: self.line, field, found: Excerpt::new(word), wanted }
    }

    fn format_name(&mut self) -> Result<(), TrajectoryError> {
        match self.next() {
            name if name == FORMAT_NAME.as_bytes() => Ok(()),
            other => Err(TrajectoryError::NotATrajectory { found: Excerpt::new(other) }),
        }
    }

    fn version(&mut self) -> Result<(), TrajectoryError> {
        match self.parsed("version", "a whole number")? {
            FORMAT_VERSION => Ok(()),
            found => Err(TrajectoryError::Version { found }),
        }
    }

    fn keyword(&mut self, wanted: &'static str) -> Result<(), TrajectoryError> {
        match self.next() {
            word if word == wanted.as_bytes() => Ok(()),
            other => Err(TrajectoryError::Keyword { line: self.line, found: Excerpt::new(other), wanted }),
        }
    }

    fn plan_hash(&mut self) -> Result<u64, TrajectoryError> {
        self.keyword("plan")?;
        let word = self.field("content hash")?;
        // `from_str_radix` alone would take a sign, and fewer digits.
        let digits = word.len() == 16 && word.iter().all(u8::is_ascii_hexdigit);
        let text = core::str::from_utf8(word).ok().filter(|_| digits);
        text.and_then(|text| u64::from_str_radix(text, 16).ok())
            .ok_or_else(|| self.malformed("content hash", word, "16 hexadecimal digits"))
    }

    fn period_us(&mut self) -> Result<u32, TrajectoryError> {
        self.keyword("period_us")?;
        let found = self.parsed("period", "a whole number of microseconds")?;
        if (PERIOD_US_MIN..=PERIOD_US_MAX).contains(&found) {
            Ok(found)
        } else {
            Err(TrajectoryError::Period { found })
        }
    }

    fn sample(&mut self, expected: u32) -> Result<Sample, TrajectoryError> {
        let line = self.line;
        let tick = self.parsed("tick", "a whole number")?;
        if tick != expected {
            return Err(TrajectoryError::Tick { line, found: tick, expected });
        }
        if tick > MAX_TICK {
            return Err(TrajectoryError::TooLong { line });
        }
        let mut values = [0.0; 7];
        for (value, field) in values.iter_mut().zip(COORDINATES) {
            *value = self.coordinate(field)?;
        }
        let [x, y, z, qw, qx, qy, qz] = values;
        let norm = libm::sqrt(qw * qw + qx * qx + qy * qy + qz * qz);
        if libm::fabs(norm - 1.0) > UNIT_TOLERANCE {
            return Err(TrajectoryError::NotUnit { line, norm });
        }
        let pose = StartPose { position_m: [x, y, z], orientation_wxyz: [qw, qx, qy, qz] };
        Ok(Sample { tick, pose: pose.pose() })
    }

    fn coordinate(&mut self, field: &'static str) -> Result<f64, TrajectoryError> {
        let mut ahead = Words { ..*self };
        let value: f64 = self.parsed(field, "a decimal number")?;
        if value.is_finite() {
            Ok(value)
        } else {
            Err(TrajectoryError::NotFinite { line: self.line, field, found: Excerpt::new(ahead.next()) })
        }
    }

    fn end(&mut self) -> Result<(), TrajectoryError> {
        match self.next() {
            [] => Ok(()),
            word => Err(TrajectoryError::Surplus { line: self.line, found: Excerpt::new(word) }),
        }
    }
}

/// The beginning of a word that was found, for an error to show. Displays with everything escaped that is not printable.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Excerpt {
    bytes: [u8; EXCERPT_BYTES],
    /// Of the whole word.
    length: usize,
}

impl Excerpt {
    /// The first bytes of `word`.
    #[must_use]
    pub fn new(word: &[u8]) -> Self {
        let mut bytes = [0; EXCERPT_BYTES];
        for (byte, found) in bytes.iter_mut().zip(word) {
            *byte = *found;
        }
        Self { bytes, length: word.len() }
    }
}

impl fmt::Display for Excerpt {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let shown = self.bytes.get(..self.length).unwrap_or(&self.bytes);
        let dots = if self.length > EXCERPT_BYTES { ".." } else { "" };
        write!(f, "{}{dots}", shown.escape_ascii())
    }
}

/// Why text is no executed motion. Lines are counted from 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum TrajectoryError {
    /// Not a single line.
    Empty,
    /// The first word is not the format's.
    NotATrajectory {
        /// The first word.
        found: Excerpt,
    },
    /// Another format version.
    Version {
        /// Version of the file.
        found: u32,
    },
    /// No line is that long.
    LineTooLong {
        /// Line.
        line: u32,
    },
    /// A line of the header begins with another word.
    Keyword {
        /// Line.
        line: u32,
        /// Its first word.
        found: Excerpt,
        /// The word that belongs there.
        wanted: &'static str,
    },
    /// A line ends too soon.
    Missing {
        /// Line.
        line: u32,
        /// What should come next.
        field: &'static str,
    },
    /// A line goes on for too long.
    Surplus {
        /// Line.
        line: u32,
        /// The first word too many.
        found: Excerpt,
    },
    /// A word cannot be read.
    Malformed {
        /// Line.
        line: u32,
        /// What it should be.
        field: &'static str,
        /// The word.
        found: Excerpt,
        /// What would be right.
        wanted: &'static str,
    },
    /// A coordinate is NaN, infinite or too large for a number.
    NotFinite {
        /// Line.
        line: u32,
        /// Which.
        field: &'static str,
        /// As it is written.
        found: Excerpt,
    },
    /// The period is outside its range.
    Period {
        /// Microseconds.
        found: u32,
    },
    /// A tick does not follow the one before.
    Tick {
        /// Line.
        line: u32,
        /// Tick of the sample.
        found: u32,
        /// The tick whose turn it is.
        expected: u32,
    },
    /// More samples than a motion can have.
    TooLong {
        /// Line of the first one too many.
        line: u32,
    },
    /// An orientation is no rotation.
    NotUnit {
        /// Line.
        line: u32,
        /// Norm of the quaternion.
        norm: f64,
    },
    /// The file ends before the first sample.
    EndsEarly {
        /// Lines that are there.
        lines: u32,
        /// What should come next.
        wanted: &'static str,
    },
}

impl fmt::Display for TrajectoryError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::Empty => {
                write!(f, "it is empty, but its first line must be `{FORMAT_NAME} {FORMAT_VERSION}`")
            }
            Self::NotATrajectory { found } => {
                write!(f, "it begins with `{found}`, but an executed motion begins with `{FORMAT_NAME}`")
            }
            Self::Version { found } => write!(
                f,
                "it has format version {found}, but this program reads version {FORMAT_VERSION} of `{FORMAT_NAME}` only"
            ),
            Self::LineTooLong { line } => {
                write!(f, "its line {line} is longer than {MAX_LINE_BYTES} bytes, but none has that many")
            }
            Self::Keyword { line, found, wanted } => {
                write!(f, "its line {line} begins with `{found}`, but must begin with `{wanted}`")
            }
            Self::Missing { line, field } => write!(f, "its line {line} ends where its {field} should stand"),
            Self::Surplus { line, found } => {
                write!(f, "its line {line} goes on with `{found}`, but should be at its end")
            }
            Self::Malformed { line, field, found, wanted } => {
                write!(f, "in line {line} the {field} is `{found}`, but must be {wanted}")
            }
            Self::NotFinite { line, field, found } => {
                write!(f, "in line {line} {field} is `{found}`, but must be a finite number")
            }
            Self::Period { found } => write!(
                f,
                "its period is {found} us, but must lie between {PERIOD_US_MIN} and {PERIOD_US_MAX} us"
            ),
            Self::Tick { line, found, expected: 0 } => {
                write!(f, "in line {line} the tick is {found}, but the first sample must be that of tick 0")
            }
            Self::Tick { line, found, expected } => write!(
                f,
                "in line {line} the tick is {found}, but tick {expected} must follow tick {}",
                expected.saturating_sub(1)
            ),
            Self::TooLong { line } => {
                write!(f, "it goes on in line {line} after tick {MAX_TICK}, but no motion is longer")
            }
            Self::NotUnit { line, norm } => {
                write!(f, "in line {line} the quaternion has a norm of {norm:?}, but must have norm 1")
            }
            Self::EndsEarly { lines, wanted } => {
                write!(f, "it ends after line {lines}, where {wanted} must follow")
            }
        }
    }
}

impl core::error::Error for TrajectoryError {}
