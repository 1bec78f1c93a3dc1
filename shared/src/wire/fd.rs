//! The cyclic frames of CAN FD, which serial lines carry too: a header of 12 bytes, the first four of them the checksum.

use super::checksum::{Context, sum32};
use super::fields::{Put, Take};
use super::frame::Frame;
use super::ids;
use super::message::{FromArm, Heartbeat, NO_SESSION, Status, ToArm};
use super::rejected::Rejected;
use super::words::{self, StatusBits};
use crate::displacement::Setpoint;
use crate::fault::Reported;

/// Flag of a setpoint: its displacement is valid.
const DISPLACEMENT_VALID: u8 = 1;

/// The kind of a cyclic frame: its identifier, type and length.
#[derive(Clone, Copy)]
struct Kind {
    id: u16,
    number: u8,
    length: usize,
}

const SETPOINT: Kind = Kind { id: ids::SETPOINT_T, number: 1, length: 48 };
const ACTUAL: Kind = Kind { id: ids::ACTUAL_T, number: 2, length: 48 };
const CONTROL: Kind = Kind { id: ids::CONTROL, number: 3, length: 16 };
const STATUS: Kind = Kind { id: ids::STATUS, number: 4, length: 20 };
const FAULT: Kind = Kind { id: ids::FAULT, number: 5, length: 16 };
const HEARTBEAT_TO_ARM: Kind = Kind { id: ids::HEARTBEAT_TO_ARM, number: 6, length: 12 };
const HEARTBEAT_FROM_ARM: Kind = Kind { id: ids::HEARTBEAT_FROM_ARM, number: 7, length: 16 };

/// What a frame begins with beside its kind.
#[derive(Default)]
struct Head {
    tick: u32,
    flags: u8,
    /// Covered by a tag, and not sent.
    count: u32,
}

impl Head {
    fn at(tick: u32) -> Self {
        Self { tick, ..Self::default() }
    }

    fn counted(count: u32) -> Self {
        Self { count, ..Self::default() }
    }
}

fn sealed(kind: Kind, context: &Context, head: &Head, body: &Put) -> Frame {
    let Head { tick, flags, count } = *head;
    let covered = Put::new().u32(tick).u16(context.session).u8(kind.number).u8(flags).bytes(body.as_slice());
    let crc = sum32(kind.id, context, count, covered.as_slice());
    Put::new().u32(crc).bytes(covered.as_slice()).into_frame(kind.id)
}

/// Header and body of a frame whose checksum holds.
struct Opened<'a> {
    id: u16,
    session: u16,
    tick: u32,
    flags: u8,
    body: Take<'a>,
}

impl Opened<'_> {
    fn check_flags(&self, known: u8) -> Result<(), Rejected> {
        self.zero(self.flags & !known)
    }

    fn check_no_tick(&self) -> Result<(), Rejected> {
        self.zero(self.tick)
    }

    /// Reserved fields are 0, so that they can mean something one day.
    fn zero<T: Default + PartialEq>(&self, reserved: T) -> Result<(), Rejected> {
        if reserved == T::default() { Ok(()) } else { Err(Rejected::Reserved { id: self.id }) }
    }
}

/// Opens a frame if its checksum is right for its session.
fn open(
    kind: Kind,
    frame: &Frame,
    mut is_right: impl FnMut(u16, &[u8], u32) -> bool,
) -> Result<Opened<'_>, Rejected> {
    let mut take = Take(&frame.data);
    let fields = (|| {
        let crc = take.u32()?;
        let covered = take.0;
        Some((crc, covered, take.u32()?, take.u16()?, take.u8()?, take.u8()?))
    })();
    let (crc, covered, tick, session, number, flags) =
        fields.filter(|_| frame.data.len() == kind.length).ok_or_else(|| Rejected::length(frame))?;
    if !is_right(session, covered, crc) {
        return Err(Rejected::Checksum { id: frame.id });
    }
    if number != kind.number {
        return Err(Rejected::Type { id: frame.id, number });
    }
    Ok(Opened { id: frame.id, session, tick, flags, body: take })
}

/// Fields of a frame whose length has been checked always suffice.
fn complete<T>(fields: Option<T>, frame: &Frame) -> Result<T, Rejected> {
    fields.ok_or_else(|| Rejected::length(frame))
}

pub(super) fn setpoint(context: &Context, setpoint: Setpoint, displacement: Option<[i16; 6]>) -> Frame {
    let flags = if displacement.is_some() { DISPLACEMENT_VALID } else { 0 };
    sealed(
        SETPOINT,
        context,
        &Head { flags, ..Head::at(setpoint.tick) },
        &counts_and_displacement(setpoint, displacement),
    )
}

pub(super) fn actual(context: &Context, reached: Setpoint) -> Frame {
    sealed(ACTUAL, context, &Head::at(reached.tick), &counts_and_displacement(reached, None))
}

fn counts_and_displacement(setpoint: Setpoint, displacement: Option<[i16; 6]>) -> Put {
    let counts = Put::new().counts(&setpoint.counts);
    let displacement = displacement.unwrap_or_default();
    displacement.into_iter().fold(counts, |put, value| put.bytes(&value.to_le_bytes()))
}

/// A setpoint, and the displacement of its tick if it is valid.
pub(super) fn read_setpoint(
    frame: &Frame,
    is_right: impl FnMut(u16, &[u8], u32) -> bool,
) -> Result<(u16, Setpoint, Option<[i16; 6]>), Rejected> {
    let mut opened = open(SETPOINT, frame, is_right)?;
    opened.check_flags(DISPLACEMENT_VALID)?;
    let fields = (|| Some((opened.body.counts()?, opened.body.displacements()?)))();
    let (counts, displacement) = complete(fields, frame)?;
    let setpoint = Setpoint { tick: opened.tick, counts };
    if opened.flags == DISPLACEMENT_VALID {
        return Ok((opened.session, setpoint, Some(displacement)));
    }
    opened.zero(displacement)?;
    Ok((opened.session, setpoint, None))
}

pub(super) fn read_actual(
    frame: &Frame,
    is_right: impl FnMut(u16, &[u8], u32) -> bool,
) -> Result<FromArm, Rejected> {
    let mut opened = open(ACTUAL, frame, is_right)?;
    opened.check_flags(0)?;
    let fields = (|| Some((opened.body.counts()?, opened.body.displacements()?)))();
    let (counts, displacement) = complete(fields, frame)?;
    opened.zero(displacement)?;
    Ok(FromArm::Actual { session: opened.session, reached: Setpoint { tick: opened.tick, counts } })
}

pub(super) fn control(context: &Context, count: u32, word: u16) -> Frame {
    sealed(CONTROL, context, &Head::counted(count), &Put::new().u16(word).u16(0))
}

pub(super) fn read_control(
    frame: &Frame,
    is_right: impl FnMut(u16, &[u8], u32) -> bool,
) -> Result<ToArm, Rejected> {
    let mut opened = open(CONTROL, frame, is_right)?;
    opened.check_flags(0)?;
    opened.check_no_tick()?;
    let (word, reserved) = complete((|| Some((opened.body.u16()?, opened.body.u16()?)))(), frame)?;
    opened.zero(reserved)?;
    let command = words::command(word).ok_or(Rejected::Word { id: frame.id, word })?;
    Ok(ToArm::Control { session: opened.session, command })
}

pub(super) fn status(context: &Context, word: u16, status: &Status) -> Frame {
    let body = Put::new().u16(word).u16(status.have).u8(status.counter).bytes(&[0; 3]);
    sealed(STATUS, context, &Head::at(status.applied_tick), &body)
}

pub(super) fn read_status(
    frame: &Frame,
    is_right: impl FnMut(u16, &[u8], u32) -> bool,
) -> Result<FromArm, Rejected> {
    let mut opened = open(STATUS, frame, is_right)?;
    opened.check_flags(0)?;
    let body = &mut opened.body;
    let fields = (|| Some((body.u16()?, body.u16()?, body.u8()?, body.array::<3>()?)))();
    let (word, have, counter, reserved) = complete(fields, frame)?;
    opened.zero(reserved)?;
    let Opened { session, tick: applied_tick, .. } = opened;
    let StatusBits { state, phase, standstill, .. } = words::status(word)
        .filter(|bits| bits.in_session == (session != NO_SESSION))
        .ok_or(Rejected::Word { id: frame.id, word })?;
    Ok(FromArm::Status(Status { session, state, phase, standstill, applied_tick, have, counter }))
}

pub(super) fn fault(context: &Context, fault: Reported) -> Frame {
    sealed(FAULT, context, &Head::at(fault.tick), &Put::new().u16(fault.number).u16(0))
}

pub(super) fn read_fault(
    frame: &Frame,
    is_right: impl FnMut(u16, &[u8], u32) -> bool,
) -> Result<FromArm, Rejected> {
    let mut opened = open(FAULT, frame, is_right)?;
    opened.check_flags(0)?;
    let (number, reserved) = complete((|| Some((opened.body.u16()?, opened.body.u16()?)))(), frame)?;
    opened.zero(reserved)?;
    Ok(FromArm::Fault { session: opened.session, fault: Reported { number, tick: opened.tick } })
}

pub(super) fn heartbeat_to_arm(context: &Context, count: u32) -> Frame {
    sealed(HEARTBEAT_TO_ARM, context, &Head::counted(count), &Put::new())
}

pub(super) fn read_heartbeat_to_arm(
    frame: &Frame,
    is_right: impl FnMut(u16, &[u8], u32) -> bool,
) -> Result<ToArm, Rejected> {
    let opened = open(HEARTBEAT_TO_ARM, frame, is_right)?;
    opened.check_flags(0)?;
    opened.check_no_tick()?;
    Ok(ToArm::Heartbeat { session: opened.session })
}

pub(super) fn heartbeat_from_arm(context: &Context, heartbeat: &Heartbeat) -> Frame {
    sealed(
        HEARTBEAT_FROM_ARM,
        context,
        &Head::default(),
        &Put::new().u16(heartbeat.lost).u16(heartbeat.dropped),
    )
}

pub(super) fn read_heartbeat_from_arm(
    frame: &Frame,
    is_right: impl FnMut(u16, &[u8], u32) -> bool,
) -> Result<FromArm, Rejected> {
    let mut opened = open(HEARTBEAT_FROM_ARM, frame, is_right)?;
    opened.check_flags(0)?;
    opened.check_no_tick()?;
    let (lost, dropped) = complete((|| Some((opened.body.u16()?, opened.body.u16()?)))(), frame)?;
    Ok(FromArm::Heartbeat(Heartbeat { session: opened.session, lost, dropped }))
}
