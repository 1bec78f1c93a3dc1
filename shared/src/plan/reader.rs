//! Reading a plan from a byte slice, without memory of its own.

use super::{
    Crc32, FORMAT_VERSION, Fnv1a64, MAGIC, MAX_FILE_BYTES, PREFIX_BYTES, PlanError, PlanHeader, SUFFIX_BYTES,
};
use crate::displacement::{Lsb, Setpoint, StepCounts, pose_at};
use crate::limits::{LimitChecker, PeakUse, Violation};
use crate::pose::Pose;

/// A plan whose every byte has been checked.
#[derive(Clone, Copy, Debug)]
pub struct PlanReader<'a> {
    header: PlanHeader,
    body: &'a [u8],
    end: Setpoint,
    content_hash: u64,
}

impl<'a> PlanReader<'a> {
    /// Checks all of `bytes` once: magic, version, checksum, header, and that exactly the promised steps follow, each
    /// leading to a setpoint that can be represented.
    ///
    /// Whether the motion keeps its limits is a question of its own: [`PlanReader::check_limits`].
    ///
    /// # Errors
    /// The first thing that is wrong, from front to back, but the checksum before anything that it covers and explains.
    pub fn new(bytes: &'a [u8]) -> Result<Self, PlanError> {
        let payload = checked_payload(bytes)?;
        let (header, body) =
            postcard::take_from_bytes::<PlanHeader>(payload).map_err(|_| PlanError::Header)?;
        header.validate()?;
        let end = checked_end(&header, body)?;
        let mut hash = Fnv1a64::default();
        hash.update(bytes);
        Ok(Self { header, body, end, content_hash: hash.value() })
    }

    /// What the plan says about itself.
    #[must_use]
    pub fn header(&self) -> &PlanHeader {
        &self.header
    }

    /// FNV-1a over the whole file; names the plan on the wire and in reports.
    #[must_use]
    pub fn content_hash(&self) -> u64 {
        self.content_hash
    }

    /// The last setpoint.
    #[must_use]
    pub fn end_setpoint(&self) -> Setpoint {
        self.end
    }

    /// Pose at the end, for an arm that stood at the plan's start pose.
    #[must_use]
    pub fn end_pose(&self) -> Pose {
        pose_at(&self.header.start_pose(), self.end, self.header.lsb)
    }

    /// The steps, from the first.
    #[must_use]
    pub fn steps(&self) -> Steps<'a> {
        Steps { body: self.body, remaining: self.header.step_count }
    }

    /// The setpoints of ticks 1 to `step_count`.
    #[must_use]
    pub fn setpoints(&self) -> Setpoints<'a> {
        Setpoints { steps: self.steps(), lsb: self.header.lsb, last: Setpoint::ANCHOR }
    }

    /// Checks the whole motion, from rest at the start pose to rest at the end, against the plan's own limits.
    ///
    /// # Errors
    /// The first limit broken.
    pub fn check_limits(&self) -> Result<PeakUse, Violation> {
        let PlanHeader { limits, lsb, control_period_us, .. } = self.header;
        let start = self.header.start_pose();
        let mut checker = LimitChecker::new(limits, lsb, control_period_us, start);
        for setpoint in self.setpoints() {
            checker.check(pose_at(&start, setpoint, lsb))?;
        }
        checker.finish()?;
        Ok(checker.peak_use())
    }
}

/// Iterator over the steps of a plan.
#[derive(Clone, Debug)]
pub struct Steps<'a> {
    body: &'a [u8],
    remaining: u32,
}

impl Iterator for Steps<'_> {
    type Item = StepCounts;

    fn next(&mut self) -> Option<StepCounts> {
        self.remaining = self.remaining.checked_sub(1)?;
        let (step, rest) = postcard::take_from_bytes(self.body).ok()?;
        self.body = rest;
        Some(step)
    }
}

/// Iterator over the setpoints of a plan.
#[derive(Clone, Debug)]
pub struct Setpoints<'a> {
    steps: Steps<'a>,
    lsb: Lsb,
    last: Setpoint,
}

impl Iterator for Setpoints<'_> {
    type Item = Setpoint;

    fn next(&mut self) -> Option<Setpoint> {
        let step = self.steps.next()?;
        self.last = self.last.stepped(step, self.lsb).ok()?;
        Some(self.last)
    }
}

/// Header and body, after magic, version and checksum have been found right.
fn checked_payload(bytes: &[u8]) -> Result<&[u8], PlanError> {
    if bytes.len() > MAX_FILE_BYTES {
        return Err(PlanError::TooLong { bytes: bytes.len() as u64 });
    }
    let too_short =
        PlanError::TooShort { bytes: bytes.len(), least: PREFIX_BYTES.saturating_add(SUFFIX_BYTES) };
    let (magic, after_magic) = bytes.split_first_chunk::<8>().ok_or(too_short)?;
    if *magic != MAGIC {
        return Err(PlanError::NotAPlan { found: *magic });
    }
    let (version, _) = after_magic.split_first_chunk::<2>().ok_or(too_short)?;
    let found = u16::from_le_bytes(*version);
    if found != FORMAT_VERSION {
        return Err(PlanError::Version { found });
    }
    let (covered, stored) = bytes.split_last_chunk::<SUFFIX_BYTES>().ok_or(too_short)?;
    let payload = covered.get(PREFIX_BYTES..).ok_or(too_short)?;
    let mut crc = Crc32::default();
    crc.update(covered);
    let (stored, computed) = (u32::from_le_bytes(*stored), crc.value());
    if stored != computed {
        return Err(PlanError::Checksum { stored, computed });
    }
    Ok(payload)
}

/// Walks all steps; the last setpoint if there are exactly as many as promised.
fn checked_end(header: &PlanHeader, mut body: &[u8]) -> Result<Setpoint, PlanError> {
    let mut last = Setpoint::ANCHOR;
    for step in 1..=header.step_count {
        let (counts, rest) = postcard::take_from_bytes(body)
            .map_err(|_| PlanError::Step { step, step_count: header.step_count })?;
        last = last.stepped(counts, header.lsb)?;
        body = rest;
    }
    if body.is_empty() { Ok(last) } else { Err(PlanError::TrailingBytes { bytes: body.len() }) }
}
