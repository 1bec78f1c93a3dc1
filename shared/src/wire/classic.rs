//! The cyclic frames of classic CAN: at most 8 bytes, the last of them the checksum, or the last four of what enables an arm and
//! keeps it so.

use super::checksum::{Context, sum8, sum8_counts, sum32};
use super::fields::{Put, Take, low8, low16, nearest_with_low8, nearest_with_low16};
use super::frame::Frame;
use super::history::{Half, Part};
use super::ids;
use super::message::{FromArm, Heartbeat, NO_SESSION, Status, ToArm};
use super::rejected::Rejected;
use super::words::{self, StatusBits};
use crate::displacement::Setpoint;
use crate::fault::Reported;

/// NMT state "operational" in a heartbeat (CiA 301).
const OPERATIONAL: u8 = 0x05;
/// EMCY error codes: device specific (CiA 301), of a session or of none. They differ by two bits, so that no single wrong
/// bit makes one of the other.
const OF_SESSION: u16 = 0xFF03;
const OF_NO_SESSION: u16 = 0xFF00;
/// EMCY error register: generic error, manufacturer specific error (CiA 301, object 0x1001).
const ERROR_REGISTER: u8 = 0x81;

/// Appends the checksum.
fn sealed(id: u16, context: &Context, tick: u32, payload: Put) -> Frame {
    let crc = sum8(id, context, tick, payload.as_slice());
    payload.u8(crc).into_frame(id)
}

/// Appends four bytes of checksum.
fn sealed_well(id: u16, context: &Context, count: u32, payload: Put) -> Frame {
    let crc = sum32(id, context, count, payload.as_slice());
    payload.u32(crc).into_frame(id)
}

/// The bytes before a checksum of four bytes of a frame that has the length it must have, if that is right for its session.
fn opened_well<const N: usize>(
    frame: &Frame,
    mut is_right: impl FnMut(u16, &[u8], u32) -> bool,
    session_of: impl Fn(&[u8; N]) -> u16,
) -> Result<[u8; N], Rejected> {
    let parts = frame.data.split_first_chunk::<N>();
    let (payload, crc) = parts
        .and_then(|(payload, crc)| Some((payload, u32::from_le_bytes(crc.try_into().ok()?))))
        .ok_or_else(|| Rejected::length(frame))?;
    if is_right(session_of(payload), payload, crc) {
        Ok(*payload)
    } else {
        Err(Rejected::Checksum { id: frame.id })
    }
}

/// The bytes before the checksum of a frame that has the length it must have.
fn parts(frame: &Frame, length: usize) -> Result<(&[u8], u8), Rejected> {
    match frame.data.split_last() {
        Some((crc, payload)) if frame.data.len() == length => Ok((payload, *crc)),
        _ => Err(Rejected::length(frame)),
    }
}

/// Fields of a payload whose length has been checked always suffice.
fn complete<T>(fields: Option<T>, frame: &Frame) -> Result<T, Rejected> {
    fields.ok_or_else(|| Rejected::length(frame))
}

/// The two frames of a setpoint or an actual displacement.
pub(super) fn pair(ids: [u16; 2], context: &Context, setpoint: Setpoint) -> [Frame; 2] {
    let [x, y, z, rx, ry, rz] = setpoint.counts;
    let [translation, rotation] = ids;
    [
        half_frame(translation, context, setpoint.tick, [x, y, z]),
        half_frame(rotation, context, setpoint.tick, [rx, ry, rz]),
    ]
}

fn half_frame(id: u16, context: &Context, tick: u32, counts: [i32; 3]) -> Frame {
    let crc = sum8_counts(id, context, tick, counts);
    let low = counts.into_iter().fold(Put::new(), |put, count| put.u16(low16(count.cast_unsigned())));
    low.u8(low8(tick)).u8(crc).into_frame(id)
}

/// One half, rebuilt as near to the reference as can be.
pub(super) fn half(
    frame: &Frame,
    part: Part,
    context: &Context,
    tick_reference: u32,
    reference: impl Fn(u32) -> Setpoint,
) -> Result<Half, Rejected> {
    let (payload, crc) = parts(frame, 8)?;
    let mut take = Take(payload);
    let fields = (|| Some(([take.u16()?, take.u16()?, take.u16()?], take.u8()?)))();
    let (low, tick) = complete(fields, frame)?;
    let tick = nearest_with_low8(tick_reference, tick);
    let [x, y, z, rx, ry, rz] = reference(tick).counts;
    let mut counts = match part {
        Part::Translation => [x, y, z],
        Part::Rotation => [rx, ry, rz],
    };
    for (count, low) in counts.iter_mut().zip(low) {
        *count = nearest_with_low16(count.cast_unsigned(), low).cast_signed();
    }
    if sum8_counts(frame.id, context, tick, counts) != crc {
        return Err(Rejected::Checksum { id: frame.id });
    }
    Ok(Half { session: context.session, tick, counts })
}

pub(super) fn control(context: &Context, count: u32, word: u16) -> Frame {
    sealed_well(ids::CONTROL, context, count, Put::new().u16(word).u16(context.session))
}

pub(super) fn heartbeat_to_arm(context: &Context, count: u32) -> Frame {
    sealed_well(ids::HEARTBEAT_TO_ARM, context, count, Put::new().u8(OPERATIONAL).u16(context.session))
}

pub(super) fn heartbeat_from_arm(context: &Context, heartbeat: &Heartbeat) -> Frame {
    let payload = Put::new().u8(OPERATIONAL).u16(context.session).u16(heartbeat.lost).u16(heartbeat.dropped);
    sealed(ids::HEARTBEAT_FROM_ARM, context, 0, payload)
}

/// What a reader without a session can know of a tick: up to 65,535, which then stands for anything later.
fn sent_tick(context: &Context, tick: u32) -> u32 {
    if context.session == NO_SESSION { tick.min(u32::from(u16::MAX)) } else { tick }
}

fn read_tick(context: &Context, reference: u32, low: u16) -> u32 {
    if context.session == NO_SESSION { u32::from(low) } else { nearest_with_low16(reference, low) }
}

pub(super) fn status(context: &Context, word: u16, status: &Status) -> Frame {
    let tick = sent_tick(context, status.applied_tick);
    let payload = Put::new().u16(word).u16(low16(tick)).u16(status.have).u8(status.counter);
    sealed(ids::STATUS, context, tick, payload)
}

pub(super) fn fault(context: &Context, fault: Reported) -> Frame {
    let tick = sent_tick(context, fault.tick);
    let error = if context.session == NO_SESSION { OF_NO_SESSION } else { OF_SESSION };
    let payload = Put::new().u16(error).u8(ERROR_REGISTER).u16(fault.number).u16(low16(tick));
    sealed(ids::FAULT, context, tick, payload)
}

/// Session and tick of a status or a fault, if its checksum holds. Both say whether they are of a session; trying their
/// reader's and then none would let one wrong bit in four through, as one of the other.
fn found(
    frame: &Frame,
    (payload, crc): (&[u8], u8),
    low: u16,
    context: &Context,
    reference: u32,
) -> Result<(u16, u32), Rejected> {
    let tick = read_tick(context, reference, low);
    if sum8(frame.id, context, tick, payload) != crc {
        return Err(Rejected::Checksum { id: frame.id });
    }
    Ok((context.session, tick))
}

/// Whose context to read a frame with that is of a session, or of none.
fn context_of(frame: &Frame, own: &Context, of_session: bool) -> Result<Context, Rejected> {
    match (of_session, own.session) {
        (true, NO_SESSION) => Err(Rejected::Checksum { id: frame.id }),
        (true, _) => Ok(*own),
        (false, _) => Ok(Context::NONE),
    }
}

pub(super) fn read_status(frame: &Frame, own: &Context, reference: u32) -> Result<FromArm, Rejected> {
    let (payload, crc) = parts(frame, 8)?;
    let mut take = Take(payload);
    let fields = (|| Some((take.u16()?, take.u16()?, take.u16()?, take.u8()?)))();
    let (word, low, have, counter) = complete(fields, frame)?;
    let StatusBits { state, phase, standstill, in_session } =
        words::status(word).ok_or(Rejected::Word { id: frame.id, word })?;
    let context = context_of(frame, own, in_session)?;
    let (session, applied_tick) = found(frame, (payload, crc), low, &context, reference)?;
    Ok(FromArm::Status(Status { session, state, phase, standstill, applied_tick, have, counter }))
}

pub(super) fn read_fault(frame: &Frame, own: &Context, reference: u32) -> Result<FromArm, Rejected> {
    let (payload, crc) = parts(frame, 8)?;
    let mut take = Take(payload);
    let fields = (|| Some((take.u16()?, take.u8()?, take.u16()?, take.u16()?)))();
    let (error, register, number, low) = complete(fields, frame)?;
    let in_session = match (error, register) {
        (OF_SESSION, ERROR_REGISTER) => true,
        (OF_NO_SESSION, ERROR_REGISTER) => false,
        _ => return Err(Rejected::Word { id: frame.id, word: error }),
    };
    let context = context_of(frame, own, in_session)?;
    let (session, tick) = found(frame, (payload, crc), low, &context, reference)?;
    Ok(FromArm::Fault { session, fault: Reported { number, tick } })
}

/// Whether the checksum of a frame without tick holds; its session has been sent.
fn check(frame: &Frame, payload: &[u8], crc: u8, context: Option<Context>) -> Result<(), Rejected> {
    let right = context.is_some_and(|context| sum8(frame.id, &context, 0, payload) == crc);
    if right { Ok(()) } else { Err(Rejected::Checksum { id: frame.id }) }
}

fn check_operational(frame: &Frame, state: u8) -> Result<(), Rejected> {
    if state == OPERATIONAL { Ok(()) } else { Err(Rejected::Word { id: frame.id, word: u16::from(state) }) }
}

pub(super) fn read_control(
    frame: &Frame,
    is_right: impl FnMut(u16, &[u8], u32) -> bool,
) -> Result<ToArm, Rejected> {
    let payload = opened_well::<4>(frame, is_right, |[_, _, low, high]| u16::from_le_bytes([*low, *high]))?;
    let [low, high, session_low, session_high] = payload;
    let (word, session) = (u16::from_le_bytes([low, high]), u16::from_le_bytes([session_low, session_high]));
    let command = words::command(word).ok_or(Rejected::Word { id: frame.id, word })?;
    Ok(ToArm::Control { session, command })
}

pub(super) fn read_heartbeat_to_arm(
    frame: &Frame,
    is_right: impl FnMut(u16, &[u8], u32) -> bool,
) -> Result<ToArm, Rejected> {
    let [state, low, high] =
        opened_well::<3>(frame, is_right, |[_, low, high]| u16::from_le_bytes([*low, *high]))?;
    check_operational(frame, state)?;
    Ok(ToArm::Heartbeat { session: u16::from_le_bytes([low, high]) })
}

pub(super) fn read_heartbeat_from_arm(
    frame: &Frame,
    accepted: impl Fn(u16) -> Option<Context>,
) -> Result<FromArm, Rejected> {
    let (payload, crc) = parts(frame, 8)?;
    let mut take = Take(payload);
    let fields = (|| Some((take.u8()?, take.u16()?, take.u16()?, take.u16()?)))();
    let (state, session, lost, dropped) = complete(fields, frame)?;
    check(frame, payload, crc, accepted(session))?;
    check_operational(frame, state)?;
    Ok(FromArm::Heartbeat(Heartbeat { session, lost, dropped }))
}
