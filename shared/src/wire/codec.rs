//! Messages to frames, and back.
//!
//! Classic frames hold the low 16 bits of each count and the low 8 of the tick. A decoder rebuilds the whole numbers as
//! those nearest to a reference, the setpoint of the nearest tick that it knows, and the checksum, which covers the whole
//! numbers, tells whether it rebuilt them right. So a decoder must not miss more than 32.767 mm, 327.67 mrad or 127 ticks of
//! a motion in a row.

use heapless::Vec;

use super::auth::Rolls;
use super::checksum::{Context, sum32};
use super::frame::{Dialect, Frame};
use super::handshake::{FromArmRecord, Reassembly, Segments, ToArmRecord};
use super::history::{Had, Half, Halves, Met, Part, Track};
use super::message::{FromArm, NO_SESSION, Status, ToArm};
pub use super::rejected::Rejected;
use super::words::{self, StatusBits};
use super::{classic, fd, ids};
use crate::displacement::Setpoint;

/// Ticks within which a report tells best where the arm is at another: setpoints are that far apart at most.
const NEAR_TICKS: u32 = 3;

/// Data of [`ToArm::Stop`].
const STOP_WORD: &[u8; 4] = b"STOP";

/// The messages that one frame completes: none yet, one, or a setpoint with the one before it, which had been lost.
pub type Decoded<M> = Vec<M, 2>;

/// The frames of one message, in the order in which they are to be sent.
#[derive(Clone, Debug, Default)]
pub struct Frames {
    first: Option<Frame>,
    second: Option<Frame>,
    segments: Option<Segments>,
}

impl Frames {
    fn one(frame: Frame) -> Self {
        Self { first: Some(frame), ..Self::default() }
    }

    fn two([first, second]: [Frame; 2]) -> Self {
        Self { first: Some(first), second: Some(second), segments: None }
    }

    fn record(segments: Segments) -> Self {
        Self { segments: Some(segments), ..Self::default() }
    }
}

impl Iterator for Frames {
    type Item = Frame;

    fn next(&mut self) -> Option<Frame> {
        self.first.take().or_else(|| self.second.take()).or_else(|| self.segments.as_mut()?.next())
    }
}

/// Puts messages into frames.
///
/// A message must be of the context's session or of none; nobody can read one of any other session.
#[derive(Clone, Debug)]
pub struct Encoder {
    dialect: Dialect,
    /// The setpoint of the highest tick sent in a session: the displacement of the next one starts there.
    newest: Option<(Context, Setpoint)>,
    /// What was counted of the session.
    said: (Context, Rolls),
}

impl Encoder {
    /// An encoder that has sent nothing.
    #[must_use]
    pub const fn new(dialect: Dialect) -> Self {
        Self { dialect, newest: None, said: (Context::NONE, Rolls::NONE) }
    }

    /// How it puts messages into frames.
    #[must_use]
    pub const fn dialect(&self) -> Dialect {
        self.dialect
    }

    /// Frames of a message to the arm.
    #[must_use]
    pub fn to_arm(&mut self, context: &Context, message: &ToArm) -> Frames {
        match (*message, self.dialect) {
            (ToArm::Open(request), _) => self.request(&ToArmRecord::Open(request)),
            (ToArm::OpenKeyed(request, proof), _) => self.request(&ToArmRecord::OpenKeyed(request, proof)),
            (ToArm::Setpoint { session, setpoint }, Dialect::Classic) => {
                Frames::two(classic::pair([ids::SETPOINT_T, ids::SETPOINT_R], &context.of(session), setpoint))
            }
            (ToArm::Setpoint { session, setpoint }, Dialect::Fd) => {
                let context = context.of(session);
                let displacement = self.displacement(&context, setpoint);
                Frames::one(fd::setpoint(&context, setpoint, displacement))
            }
            (ToArm::Control { session, command }, dialect) => {
                let (context, word) = (context.of(session), words::controlword(command));
                let count = self.count(ids::CONTROL, &context);
                Frames::one(match dialect {
                    Dialect::Classic => classic::control(&context, count, word),
                    Dialect::Fd => fd::control(&context, count, word),
                })
            }
            (ToArm::Heartbeat { session }, dialect) => {
                let context = context.of(session);
                let count = self.count(ids::HEARTBEAT_TO_ARM, &context);
                Frames::one(match dialect {
                    Dialect::Classic => classic::heartbeat_to_arm(&context, count),
                    Dialect::Fd => fd::heartbeat_to_arm(&context, count),
                })
            }
            (ToArm::Stop, _) => Frames::one(Frame { id: ids::STOP, data: Vec::from_array(*STOP_WORD) }),
        }
    }

    fn request(&mut self, record: &ToArmRecord) -> Frames {
        self.newest = None;
        Frames::record(Segments::new(ids::HANDSHAKE_TO_ARM, self.dialect, record))
    }

    /// The count of the next command or heartbeat of a session.
    fn count(&mut self, id: u16, context: &Context) -> u32 {
        if self.said.0 != *context {
            self.said = (*context, Rolls::default());
        }
        self.said.1.next(id, context)
    }

    /// Frames of a message from the arm.
    #[must_use]
    pub fn from_arm(&self, context: &Context, message: &FromArm) -> Frames {
        match (message, self.dialect) {
            (FromArm::Opened { session, nonce, digest }, _) => {
                self.answer(&FromArmRecord::Opened { session: *session, nonce: *nonce, digest: *digest })
            }
            (FromArm::OpenedKeyed { session, nonce, digest, tag }, _) => {
                let (session, nonce, digest, tag) = (*session, *nonce, *digest, *tag);
                self.answer(&FromArmRecord::OpenedKeyed { session, nonce, digest, tag })
            }
            (FromArm::Refused { session, reason }, _) => {
                self.answer(&FromArmRecord::Refused { session: *session, reason: *reason })
            }
            (FromArm::Anchored { session, pose }, _) => {
                self.answer(&FromArmRecord::anchored(&context.of(*session), pose))
            }
            (FromArm::Status(status), dialect) => {
                let (context, word) = (context.of(status.session), statusword_of(status));
                Frames::one(match dialect {
                    Dialect::Classic => classic::status(&context, word, status),
                    Dialect::Fd => fd::status(&context, word, status),
                })
            }
            (FromArm::Actual { session, reached }, Dialect::Classic) => {
                Frames::two(classic::pair([ids::ACTUAL_T, ids::ACTUAL_R], &context.of(*session), *reached))
            }
            (FromArm::Actual { session, reached }, Dialect::Fd) => {
                Frames::one(fd::actual(&context.of(*session), *reached))
            }
            (FromArm::Fault { session, fault }, Dialect::Classic) => {
                Frames::one(classic::fault(&context.of(*session), *fault))
            }
            (FromArm::Fault { session, fault }, Dialect::Fd) => {
                Frames::one(fd::fault(&context.of(*session), *fault))
            }
            (FromArm::Heartbeat(heartbeat), Dialect::Classic) => {
                Frames::one(classic::heartbeat_from_arm(&context.of(heartbeat.session), heartbeat))
            }
            (FromArm::Heartbeat(heartbeat), Dialect::Fd) => {
                Frames::one(fd::heartbeat_from_arm(&context.of(heartbeat.session), heartbeat))
            }
        }
    }

    fn answer(&self, record: &FromArmRecord) -> Frames {
        Frames::record(Segments::new(ids::HANDSHAKE_FROM_ARM, self.dialect, record))
    }

    /// Counts since the setpoint of the tick before, if that is known and they all fit.
    fn displacement(&mut self, context: &Context, setpoint: Setpoint) -> Option<[i16; 6]> {
        let newest =
            self.newest.filter(|(of, _)| of == context).map_or(Setpoint::ANCHOR, |(_, newest)| newest);
        if setpoint.tick >= newest.tick {
            self.newest = Some((*context, setpoint));
        }
        let before = if setpoint.tick == 1 { Setpoint::ANCHOR } else { newest };
        if before.tick.checked_add(1) != Some(setpoint.tick) {
            return None;
        }
        let mut displacement = [0; 6];
        for ((value, new), old) in displacement.iter_mut().zip(setpoint.counts).zip(before.counts) {
            *value = i16::try_from(new.checked_sub(old)?).ok()?;
        }
        Some(displacement)
    }
}

fn statusword_of(status: &Status) -> u16 {
    let Status { session, state, phase, standstill, .. } = *status;
    words::statusword(StatusBits { state, phase, standstill, in_session: session != NO_SESSION })
}

/// The context of a session that was sent in the clear, at an end that is in `own`: its own, or none.
fn own_or_none(own: Context, session: u16) -> Option<Context> {
    [own, Context::NONE].into_iter().find(|context| context.session == session)
}

/// Whether a checksum is right, of a frame that has no count.
fn is_sum(id: u16, context: Option<Context>, covered: &[u8], sum: u32) -> bool {
    context.is_some_and(|context| sum32(id, &context, 0, covered) == sum)
}

/// The context of a session that was sent in the clear, at an end that listens to its own session only.
fn own_only(own: Context, session: u16) -> Option<Context> {
    (own.session == session).then_some(own)
}

fn one<M>(message: M) -> Decoded<M> {
    Vec::from_array([message])
}

/// The arm's side: frames to messages.
#[derive(Clone, Debug)]
pub struct ToArmDecoder {
    dialect: Dialect,
    context: Context,
    /// What was counted of it.
    heard: Rolls,
    /// The session before, of which commands are heard yet: they are answered, and change nothing.
    over: (Context, Rolls),
    /// The decoded setpoints.
    track: Track,
    halves: Halves,
    had: Had,
    reassembly: Reassembly,
}

impl ToArmDecoder {
    /// A decoder without a session.
    #[must_use]
    pub fn new(dialect: Dialect) -> Self {
        Self {
            dialect,
            context: Context::NONE,
            heard: Rolls::default(),
            over: (Context::NONE, Rolls::default()),
            track: Track::default(),
            halves: Halves::default(),
            had: Had::default(),
            reassembly: Reassembly::default(),
        }
    }

    /// Enters a session, or leaves it with [`Context::NONE`]. Half setpoints and references of another session are
    /// forgotten; a handshake record, which belongs to none, is not.
    pub fn set_context(&mut self, context: Context) {
        let context = context.normalised();
        if context != self.context {
            let reassembly = core::mem::take(&mut self.reassembly);
            let over = if self.context == Context::NONE { self.over } else { (self.context, self.heard) };
            *self = Self { context, over, reassembly, ..Self::new(self.dialect) };
        }
    }

    /// Takes one frame.
    ///
    /// # Errors
    /// Why the frame says nothing. The decoder goes on as if it had not come; but a record that is complete and damaged is
    /// given up.
    pub fn handle_frame(&mut self, frame: &Frame) -> Result<Decoded<ToArm>, Rejected> {
        match (frame.id, self.dialect) {
            (ids::STOP, _) => stop(frame).map(one),
            (ids::HANDSHAKE_TO_ARM, dialect) => {
                let record: Option<ToArmRecord> = self.reassembly.handle(dialect, frame)?;
                Ok(record.map_or_else(Vec::new, |record| one(record.into_message())))
            }
            (ids::SETPOINT_T, Dialect::Classic) => self.half(frame, Part::Translation),
            (ids::SETPOINT_R, Dialect::Classic) => self.half(frame, Part::Rotation),
            (ids::SETPOINT_T, Dialect::Fd) => self.setpoint(frame),
            (ids::CONTROL, Dialect::Classic) => classic::read_control(frame, self.command_of(frame)).map(one),
            (ids::CONTROL, Dialect::Fd) => fd::read_control(frame, self.command_of(frame)).map(one),
            (ids::HEARTBEAT_TO_ARM, Dialect::Classic) => {
                classic::read_heartbeat_to_arm(frame, self.heartbeat_of(frame)).map(one)
            }
            (ids::HEARTBEAT_TO_ARM, Dialect::Fd) => {
                fd::read_heartbeat_to_arm(frame, self.heartbeat_of(frame)).map(one)
            }
            (id, _) => Err(Rejected::UnknownId { id }),
        }
    }

    /// Whether a command's checksum is right: in its own session, or in the one that is over, whose end may not have heard of that.
    fn command_of(&mut self, frame: &Frame) -> impl FnMut(u16, &[u8], u32) -> bool {
        let id = frame.id;
        let (over, heard_over) = &mut self.over;
        let mut known = [(self.context, &mut self.heard), (*over, heard_over)];
        move |session, covered, sum| {
            let of = |context: &Context| context.session == session && session != NO_SESSION;
            known.iter_mut().find(|(context, _)| of(context)).is_some_and(|(context, heard)| {
                heard.is_next(id, context, |count| sum32(id, context, count, covered) == sum)
            })
        }
    }

    /// Whether a heartbeat's checksum is right.
    fn heartbeat_of(&mut self, frame: &Frame) -> impl FnMut(u16, &[u8], u32) -> bool {
        let (id, own, heard) = (frame.id, self.context, &mut self.heard);
        move |session, covered, sum| {
            own_only(own, session).is_some_and(|context| {
                heard.is_next(id, &context, |count| sum32(id, &context, count, covered) == sum)
            })
        }
    }

    fn half(&mut self, frame: &Frame, part: Part) -> Result<Decoded<ToArm>, Rejected> {
        let reference = |tick| self.track.nearest(tick);
        let half = classic::half(frame, part, &self.context, self.had.newest(), reference)?;
        match self.halves.meet(part, half) {
            Met::Waits => Ok(Vec::new()),
            Met::Replaced => {
                // Neither can be trusted, and a setpoint is sent again if it is missing.
                self.halves.forget(&half);
                Err(Rejected::Contradiction { id: frame.id, tick: half.tick })
            }
            Met::Pair(counts) => Ok(one(self.found(Setpoint { tick: half.tick, counts }))),
        }
    }

    fn setpoint(&mut self, frame: &Frame) -> Result<Decoded<ToArm>, Rejected> {
        let own = self.context;
        let (_, setpoint, displacement) = fd::read_setpoint(frame, |session, covered, sum| {
            is_sum(frame.id, own_only(own, session), covered, sum)
        })?;
        let before = displacement.and_then(|displacement| before(setpoint, displacement));
        let lost = before.filter(|before| !self.had.contains(before.tick));
        let lost = lost.map(|lost| self.found(lost));
        let setpoint = self.found(setpoint);
        Ok(lost.map_or_else(|| one(setpoint), |lost| Vec::from_array([lost, setpoint])))
    }

    fn found(&mut self, setpoint: Setpoint) -> ToArm {
        self.track.note(setpoint);
        self.had.note(setpoint.tick);
        ToArm::Setpoint { session: self.context.session, setpoint }
    }
}

/// The setpoint one tick earlier.
fn before(setpoint: Setpoint, displacement: [i16; 6]) -> Option<Setpoint> {
    let mut counts = setpoint.counts;
    for (count, displacement) in counts.iter_mut().zip(displacement) {
        *count = count.checked_sub(i32::from(displacement))?;
    }
    Some(Setpoint { tick: setpoint.tick.checked_sub(1)?, counts })
}

fn stop(frame: &Frame) -> Result<ToArm, Rejected> {
    if frame.data.len() != STOP_WORD.len() {
        return Err(Rejected::length(frame));
    }
    if frame.data.as_slice() == STOP_WORD {
        Ok(ToArm::Stop)
    } else {
        Err(Rejected::Checksum { id: frame.id })
    }
}

/// The executor's side: frames to messages.
#[derive(Clone, Debug)]
pub struct FromArmDecoder {
    dialect: Dialect,
    context: Context,
    /// The actual displacement decoded last.
    actual: Setpoint,
    /// The setpoints sent.
    sent: Track,
    /// The highest of their ticks.
    newest: u32,
    /// The tick of the status decoded last.
    tick: u32,
    halves: Halves,
    reassembly: Reassembly,
}

impl FromArmDecoder {
    /// A decoder without a session.
    #[must_use]
    pub fn new(dialect: Dialect) -> Self {
        Self {
            dialect,
            context: Context::NONE,
            actual: Setpoint::ANCHOR,
            sent: Track::default(),
            newest: 0,
            tick: 0,
            halves: Halves::default(),
            reassembly: Reassembly::default(),
        }
    }

    /// Enters a session, or leaves it with [`Context::NONE`]. Half displacements and references of another session are
    /// forgotten; a handshake record, which belongs to none, is not.
    pub fn set_context(&mut self, context: Context) {
        let context = context.normalised();
        if context != self.context {
            let reassembly = core::mem::take(&mut self.reassembly);
            *self = Self { context, reassembly, ..Self::new(self.dialect) };
        }
    }

    /// Tells which setpoint is sent: where the arm must nearly be at that tick, should reports have been lost.
    pub fn expect(&mut self, setpoint: Setpoint) {
        self.sent.note(setpoint);
        self.newest = self.newest.max(setpoint.tick);
    }

    /// Takes one frame.
    ///
    /// # Errors
    /// Why the frame says nothing. The decoder goes on as if it had not come; but a record that is complete and damaged is
    /// given up.
    pub fn handle_frame(&mut self, frame: &Frame) -> Result<Decoded<FromArm>, Rejected> {
        let own = self.context;
        let accepted = |session| own_or_none(own, session);
        let is_right = |session, covered: &[u8], sum| is_sum(frame.id, accepted(session), covered, sum);
        match (frame.id, self.dialect) {
            (ids::HANDSHAKE_FROM_ARM, dialect) => self.record(frame, dialect),
            (ids::STATUS, Dialect::Classic) => self.status(frame),
            (ids::STATUS, Dialect::Fd) => fd::read_status(frame, is_right).map(one),
            (ids::ACTUAL_T, Dialect::Classic) => self.half(frame, Part::Translation),
            (ids::ACTUAL_R, Dialect::Classic) => self.half(frame, Part::Rotation),
            (ids::ACTUAL_T, Dialect::Fd) => fd::read_actual(frame, is_right).map(one),
            (ids::FAULT, Dialect::Classic) => {
                classic::read_fault(frame, &own, self.tick_reference()).map(one)
            }
            (ids::FAULT, Dialect::Fd) => fd::read_fault(frame, is_right).map(one),
            (ids::HEARTBEAT_FROM_ARM, Dialect::Classic) => {
                classic::read_heartbeat_from_arm(frame, accepted).map(one)
            }
            (ids::HEARTBEAT_FROM_ARM, Dialect::Fd) => fd::read_heartbeat_from_arm(frame, is_right).map(one),
            (id, _) => Err(Rejected::UnknownId { id }),
        }
    }

    fn record(&mut self, frame: &Frame, dialect: Dialect) -> Result<Decoded<FromArm>, Rejected> {
        let Some(record) = self.reassembly.handle::<FromArmRecord>(dialect, frame)? else {
            return Ok(Vec::new());
        };
        record.into_message(&self.context).map(one).ok_or(Rejected::Checksum { id: frame.id })
    }

    fn tick_reference(&self) -> u32 {
        self.tick.max(self.newest)
    }

    /// What the actual displacement of a tick must be near to: the last one, or, if that is some ticks old, the setpoint
    /// nearest to the tick. (Trying both would take a wrong bit in one for the right bit in the other too often.)
    fn actual_reference(&self, tick: u32) -> Setpoint {
        let sent = self.sent.nearest(tick);
        let away = tick.abs_diff(self.actual.tick);
        if away <= NEAR_TICKS.max(tick.abs_diff(sent.tick)) { self.actual } else { sent }
    }

    fn status(&mut self, frame: &Frame) -> Result<Decoded<FromArm>, Rejected> {
        let message = classic::read_status(frame, &self.context, self.tick_reference())?;
        if let FromArm::Status(status) = &message
            && status.session == self.context.session
        {
            self.tick = status.applied_tick;
        }
        Ok(one(message))
    }

    fn half(&mut self, frame: &Frame, part: Part) -> Result<Decoded<FromArm>, Rejected> {
        let reference = |tick| self.actual_reference(tick);
        let latest = self.tick_reference().max(self.actual.tick);
        let half = classic::half(frame, part, &self.context, latest, reference)?;
        let Half { session, tick, .. } = half;
        match self.halves.meet(part, half) {
            // An arm that stands reports one tick again and again, and not always quite the same counts.
            Met::Waits | Met::Replaced => Ok(Vec::new()),
            Met::Pair(counts) => {
                let reached = Setpoint { tick, counts };
                self.actual = reached;
                Ok(one(FromArm::Actual { session, reached }))
            }
        }
    }
}
