//! Writing a plan, step by step, to wherever bytes go.

use core::fmt;

use super::{
    Crc32, FORMAT_VERSION, Fnv1a64, MAGIC, MAX_HEADER_BYTES, MAX_STEP_BYTES, PREFIX_BYTES, PlanError,
    PlanHeader, SUFFIX_BYTES,
};
use crate::displacement::{Setpoint, StepCounts};

/// Where a plan's bytes go. Any `FnMut(&[u8]) -> Result<(), E>` is one; a host appends to a vector:
///
/// ```
/// # use powderline_shared::plan::Sink;
/// let mut bytes = Vec::new();
/// let mut sink = |part: &[u8]| {
///     bytes.extend_from_slice(part);
///     Ok::<(), core::convert::Infallible>(())
/// };
/// sink.put(b"plan").unwrap();
/// # assert_eq!(bytes, b"plan");
/// ```
pub trait Sink {
    /// Why bytes could not be taken.
    type Error;

    /// Takes all of `bytes`.
    ///
    /// # Errors
    /// Whatever keeps the sink from taking them.
    fn put(&mut self, bytes: &[u8]) -> Result<(), Self::Error>;
}

impl<F, E> Sink for F
where
    F: FnMut(&[u8]) -> Result<(), E>,
{
    type Error = E;

    fn put(&mut self, bytes: &[u8]) -> Result<(), E> {
        self(bytes)
    }
}

/// A slice that is filled from its front.
#[derive(Debug)]
pub struct SliceSink<'a> {
    free: &'a mut [u8],
}

impl<'a> SliceSink<'a> {
    /// Fills `buffer`.
    pub fn new(buffer: &'a mut [u8]) -> Self {
        Self { free: buffer }
    }
}

/// A [`SliceSink`] is full.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SliceFull;

impl fmt::Display for SliceFull {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("the buffer is too small for the plan")
    }
}

impl core::error::Error for SliceFull {}

impl Sink for SliceSink<'_> {
    type Error = SliceFull;

    fn put(&mut self, bytes: &[u8]) -> Result<(), SliceFull> {
        let free = core::mem::take(&mut self.free);
        let (target, rest) = free.split_at_mut_checked(bytes.len()).ok_or(SliceFull)?;
        target.copy_from_slice(bytes);
        self.free = rest;
        Ok(())
    }
}

/// Why a plan was not written.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum WriteError<E> {
    /// It would not be a plan.
    Plan(PlanError),
    /// The sink refused.
    Sink(E),
}

impl<E> From<PlanError> for WriteError<E> {
    fn from(error: PlanError) -> Self {
        Self::Plan(error)
    }
}

impl<E: fmt::Display> fmt::Display for WriteError<E> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Plan(error) => error.fmt(f),
            Self::Sink(error) => error.fmt(f),
        }
    }
}

impl<E: fmt::Debug + fmt::Display> core::error::Error for WriteError<E> {}

/// A finished plan.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PlanSummary {
    /// Length of the file.
    pub bytes: usize,
    /// See [`PlanReader::content_hash`](super::PlanReader::content_hash).
    pub content_hash: u64,
    /// The last setpoint.
    pub end: Setpoint,
}

/// Writes header, steps and checksum in this order; refuses what a reader would refuse.
#[derive(Debug)]
pub struct PlanWriter<S> {
    sink: S,
    header: PlanHeader,
    last: Setpoint,
    crc: Crc32,
    hash: Fnv1a64,
    bytes: usize,
}

impl<S: Sink> PlanWriter<S> {
    /// Checks and writes the header.
    ///
    /// # Errors
    /// A header that no reader would accept, or a sink that refuses.
    pub fn new(sink: S, header: &PlanHeader) -> Result<Self, WriteError<S::Error>> {
        header.validate()?;
        let mut writer = Self {
            sink,
            header: *header,
            last: Setpoint::ANCHOR,
            crc: Crc32::default(),
            hash: Fnv1a64::default(),
            bytes: 0,
        };
        let mut buffer = [0; MAX_HEADER_BYTES];
        let encoded = postcard::to_slice(header, &mut buffer).map_err(|_| PlanError::Header)?;
        writer.put(&MAGIC)?;
        writer.put(&FORMAT_VERSION.to_le_bytes())?;
        writer.put(encoded)?;
        Ok(writer)
    }

    /// Writes one step.
    ///
    /// # Errors
    /// A step too many, one that leads to no setpoint, or a sink that refuses.
    pub fn step(&mut self, step: StepCounts) -> Result<(), WriteError<S::Error>> {
        let next = self.last.stepped(step, self.header.lsb).map_err(PlanError::from)?;
        if next.tick > self.header.step_count {
            return Err(self.miscounted(next.tick));
        }
        let mut buffer = [0; MAX_STEP_BYTES];
        let encoded = postcard::to_slice(&step, &mut buffer)
            .map_err(|_| PlanError::Step { step: next.tick, step_count: self.header.step_count })?;
        self.put(encoded)?;
        self.last = next;
        Ok(())
    }

    /// Writes the checksum.
    ///
    /// # Errors
    /// Fewer steps than the header promises, or a sink that refuses.
    pub fn finish(mut self) -> Result<PlanSummary, WriteError<S::Error>> {
        if self.last.tick != self.header.step_count {
            return Err(self.miscounted(self.last.tick));
        }
        let checksum = self.crc.value().to_le_bytes();
        self.put(&checksum)?;
        Ok(PlanSummary { bytes: self.bytes, content_hash: self.hash.value(), end: self.last })
    }

    fn miscounted(&self, given: u32) -> WriteError<S::Error> {
        WriteError::Plan(PlanError::StepCount { given, promised: self.header.step_count })
    }

    fn put(&mut self, bytes: &[u8]) -> Result<(), WriteError<S::Error>> {
        self.crc.update(bytes);
        self.hash.update(bytes);
        self.bytes = self.bytes.saturating_add(bytes.len());
        self.sink.put(bytes).map_err(WriteError::Sink)
    }
}

// A plan of the most steps, each of the most bytes, still is below the bound that readers refuse at.
const _: () = assert!(
    PREFIX_BYTES + MAX_HEADER_BYTES + super::MAX_STEPS as usize * MAX_STEP_BYTES + SUFFIX_BYTES
        <= super::MAX_FILE_BYTES
);
