//! A serial port in memory: buffers of a UART, filled and emptied at the pace of the line.

use std::cell::RefCell;
use std::collections::VecDeque;
use std::rc::Rc;

use embedded_io::{ErrorKind, ErrorType, Read, ReadReady, Write, WriteReady};
use powderline_executor::adapters::serial::{DIALECT, SerialWire};
use powderline_shared::wire::serial::{LineReader, to_line};

use super::*;

/// Bytes that a UART holds in each direction.
const BUFFER: usize = 16;

/// Bytes that the line carries in a step, in each direction: 460,800 bit/s. A setpoint takes five steps.
const BYTES_IN_STEP: usize = 11;

struct State {
    to_line: VecDeque<u8>,
    from_line: VecDeque<u8>,
    /// What the arm has said and the line has not carried yet.
    on_the_way: VecDeque<u8>,
    dice: Dice,
    /// One question in so many is answered by "not ready" without a reason; none if 0.
    refuses_one_in: usize,
    /// Whether the port has just said that it would not wait.
    may_read: bool,
    may_write: bool,
    /// What reading fails with, once each.
    read_errors: VecDeque<ErrorKind>,
    /// What every call to write fails with.
    write_error: Option<ErrorKind>,
    /// Reads as ended.
    ended: bool,
    has_refused: bool,
    refused: u32,
    /// Writes that took less than there was.
    short: u32,
}

impl State {
    fn new(seed: u64, refuses_one_in: usize) -> Rc<RefCell<Self>> {
        Rc::new(RefCell::new(Self {
            to_line: VecDeque::new(),
            from_line: VecDeque::new(),
            on_the_way: VecDeque::new(),
            dice: Dice(seed),
            refuses_one_in,
            may_read: false,
            may_write: false,
            read_errors: VecDeque::new(),
            write_error: None,
            ended: false,
            has_refused: false,
            refused: 0,
            short: 0,
        }))
    }

    fn refuses(&mut self) -> bool {
        let refuses = self.refuses_one_in > 0 && self.dice.one_in(self.refuses_one_in);
        self.refused += u32::from(refuses);
        refuses
    }

    /// At least one byte, at most so many.
    fn part_of(&mut self, most: usize) -> usize {
        if self.refuses_one_in == 0 { most } else { 1 + self.dice.below(most) }
    }
}

/// The driver: what an executor's firmware has.
struct Port(Rc<RefCell<State>>);

impl ErrorType for Port {
    type Error = ErrorKind;
}

impl ReadReady for Port {
    fn read_ready(&mut self) -> Result<bool, ErrorKind> {
        let mut state = self.0.borrow_mut();
        let something = state.ended || !state.from_line.is_empty() || !state.read_errors.is_empty();
        state.may_read = something && !state.refuses();
        Ok(state.may_read)
    }
}

impl Read for Port {
    fn read(&mut self, buffer: &mut [u8]) -> Result<usize, ErrorKind> {
        let mut state = self.0.borrow_mut();
        assert!(std::mem::take(&mut state.may_read), "reading would wait");
        if let Some(error) = state.read_errors.pop_front() {
            return Err(error);
        }
        if state.ended {
            return Ok(0);
        }
        let most = buffer.len().min(state.from_line.len());
        let count = state.part_of(most);
        buffer.iter_mut().zip(state.from_line.drain(..count)).for_each(|(place, byte)| *place = byte);
        Ok(count)
    }
}

impl WriteReady for Port {
    fn write_ready(&mut self) -> Result<bool, ErrorKind> {
        let mut state = self.0.borrow_mut();
        state.may_write = state.to_line.len() < BUFFER && !state.refuses();
        state.has_refused = !state.may_write;
        Ok(state.may_write)
    }
}

impl Write for Port {
    fn write(&mut self, bytes: &[u8]) -> Result<usize, ErrorKind> {
        let mut state = self.0.borrow_mut();
        assert!(std::mem::take(&mut state.may_write), "writing would wait");
        if let Some(error) = state.write_error {
            return Err(error);
        }
        let most = bytes.len().min(BUFFER - state.to_line.len());
        let count = state.part_of(most);
        state.has_refused = count < bytes.len();
        state.short += u32::from(state.has_refused);
        state.to_line.extend(&bytes[..count]);
        Ok(count)
    }

    fn flush(&mut self) -> Result<(), ErrorKind> {
        panic!("flushing waits")
    }
}

struct Line {
    wire: SerialWire<Port>,
    state: Rc<RefCell<State>>,
    /// The arm's.
    reader: LineReader,
    garbled: u32,
}

impl Line {
    fn new(state: Rc<RefCell<State>>) -> Self {
        let mut reader = LineReader::new();
        // What a line can hold before anybody speaks.
        b"login: ".iter().for_each(|byte| assert!(reader.push(*byte).is_none()));
        Self { wire: SerialWire::new(Port(Rc::clone(&state))), state, reader, garbled: 0 }
    }
}

impl Wire for Line {
    fn turn(&mut self, now_us: &dyn Fn() -> u64, endpoint: &mut Endpoint<'_>) -> Turn {
        self.wire.turn(now_us, endpoint)
    }

    fn has_arrived(&self) -> bool {
        let state = self.state.borrow();
        !state.from_line.is_empty() || !state.read_errors.is_empty()
    }

    fn has_refused(&self) -> bool {
        self.state.borrow().has_refused
    }

    fn leaves(&mut self) -> Vec<Frame> {
        let mut state = self.state.borrow_mut();
        let count = state.on_the_way.len().min(BYTES_IN_STEP);
        let arrived: Vec<u8> = state.on_the_way.drain(..count).collect();
        state.from_line.extend(arrived);
        let count = state.to_line.len().min(BYTES_IN_STEP);
        let read = state.to_line.drain(..count).filter_map(|byte| self.reader.push(byte));
        let (frames, errors): (Vec<_>, Vec<_>) = read.partition(Result::is_ok);
        self.garbled += u32::try_from(errors.len()).unwrap();
        frames.into_iter().flatten().collect()
    }

    fn arrives(&mut self, frame: &Frame) {
        self.state.borrow_mut().on_the_way.extend(to_line(frame));
    }
}

#[test]
fn a_plan_arrives_over_a_port_that_refuses_and_takes_frames_in_parts() {
    for seed in SEEDS {
        let state = State::new(seed, 4);
        let mut line = Line::new(Rc::clone(&state));
        let played = play_undisturbed(DIALECT, &mut line);
        played.assert_arrived();
        // Only what the line held before the first frame.
        assert_eq!((line.garbled, line.wire.garbled()), (1, 0));
        let state = state.borrow();
        assert!(state.refused > 100 && state.short > 100, "{} {}", state.refused, state.short);
    }
}

#[test]
fn an_arm_is_not_ahead_of_its_time_for_a_turn_that_was_held_up() {
    let mut line = Line::new(State::new(1, 0));
    play_held_up(&plan(), DIALECT, &mut line, HELD_UP_US, |_, _| false).assert_arrived();
}

#[test]
fn an_error_of_the_port_is_a_lost_link_and_a_stop() {
    let state = State::new(1, 0);
    let mut line = Line::new(Rc::clone(&state));
    let played = play(&plan(), DIALECT, &mut line, |now_us, _| {
        let breaks = now_us == 700_000;
        if breaks {
            state.borrow_mut().read_errors.push_back(ErrorKind::Other);
        }
        breaks
    });
    // It was one error, so the stop that is asked for gets through.
    assert_eq!(played.fault(), Some((FaultCode::LinkLost, true)));
    assert_eq!(line.wire.failure(), Some(&ErrorKind::Other));
    assert_eq!(played.arm.fault().map(|fault| fault.code), Some(FaultCode::StopCommanded));
    assert!(played.arm.has_moved() && played.arm.status().standstill);
}

#[test]
fn a_port_that_sends_no_more_is_a_lost_link_and_the_arm_stops_by_itself() {
    let state = State::new(1, 0);
    let mut line = Line::new(Rc::clone(&state));
    let played = play(&plan(), DIALECT, &mut line, |now_us, _| {
        if now_us == 700_000 {
            state.borrow_mut().write_error = Some(ErrorKind::BrokenPipe);
        }
        false
    });
    assert_eq!(played.fault(), Some((FaultCode::LinkLost, true)));
    assert_eq!(line.wire.failure(), Some(&ErrorKind::BrokenPipe));
    assert_eq!(played.arm.fault().map(|fault| fault.code), Some(FaultCode::SetpointMissing));
}

#[test]
fn the_stop_gets_through_once_a_port_recovers() {
    for seed in SEEDS {
        let state = State::new(seed, 4);
        let mut line = Line::new(Rc::clone(&state));
        let played = play(&plan(), DIALECT, &mut line, |now_us, _| {
            let fails = (700_000..720_000).contains(&now_us);
            state.borrow_mut().write_error = fails.then_some(ErrorKind::TimedOut);
            false
        });
        assert_eq!(played.fault(), Some((FaultCode::LinkLost, true)));
        assert_eq!(played.arm.fault().map(|fault| fault.code), Some(FaultCode::StopCommanded));
    }
}

#[test]
fn a_port_that_ends_is_a_lost_link() {
    let state = State::new(1, 0);
    let mut line = Line::new(Rc::clone(&state));
    let played = play(&plan(), DIALECT, &mut line, |now_us, _| {
        state.borrow_mut().ended |= now_us == 700_000;
        false
    });
    // Nothing is heard any more, so nobody knows.
    assert_eq!(played.fault(), Some((FaultCode::LinkLost, false)));
    assert_eq!(line.wire.failure(), None);
    assert!(played.arm.status().standstill);
}

#[test]
fn what_costs_no_more_than_bytes_can_be_tolerated() {
    let state = State::new(1, 0);
    state.borrow_mut().read_errors.extend([ErrorKind::Interrupted, ErrorKind::InvalidData]);
    let mut line = Line::new(state);
    line.wire =
        line.wire.tolerating(|error| matches!(error, ErrorKind::Interrupted | ErrorKind::InvalidData));
    play_undisturbed(DIALECT, &mut line).assert_arrived();
    assert_eq!(line.wire.harmless_errors(), 2);
}

#[test]
fn a_port_without_room_does_not_hold_up_the_session() {
    let state = State::new(1, 0);
    state.borrow_mut().to_line.extend([0; BUFFER]);
    let mut line = Line::new(Rc::clone(&state));
    let played = play(&plan(), DIALECT, &mut line, |_, _| {
        // Full again, whatever the line has taken.
        let mut state = state.borrow_mut();
        let missing = BUFFER - state.to_line.len();
        state.to_line.extend(std::iter::repeat_n(0, missing));
        true
    });
    assert_eq!(played.fault(), Some((FaultCode::HandshakeTimeout, false)));
    assert_eq!(played.heard, 0);
}

#[test]
fn a_stop_waits_for_no_more_than_the_frame_before_it() {
    for seed in SEEDS {
        let state = State::new(seed, 4);
        let mut line = Line::new(Rc::clone(&state));
        let mut pressed = false;
        let played = play(&plan(), DIALECT, &mut line, |now_us, endpoint| {
            // In the middle of a frame, for most seeds.
            let speaks = !state.borrow().to_line.is_empty();
            let presses = now_us >= 700_000 && speaks && !pressed;
            if presses {
                pressed = true;
                endpoint.executor_mut().handle_hard_stop(now_us);
            }
            presses
        });
        assert!(pressed);
        assert_eq!(played.fault(), Some((FaultCode::OperatorStop, true)));
        assert_eq!(played.arm.fault().map(|fault| fault.code), Some(FaultCode::SoftwareStop));
        assert_eq!(line.garbled, 1);
    }
}
