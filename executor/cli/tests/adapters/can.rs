//! A CAN controller in memory: three mailboxes, of which the most urgent frame leaves first.

use std::cell::RefCell;
use std::collections::VecDeque;
use std::rc::Rc;

use embedded_can::{ErrorKind, ExtendedId, Id, StandardId};
use powderline_executor::adapters::can::{CanWire, DIALECT};
use powderline_shared::wire::ids;

use super::*;

const MAILBOXES: usize = 3;

/// Frames of the executor that the bus has time for in a step, when nobody else talks: at 1 Mbit/s.
const FRAMES_IN_STEP: usize = 2;

/// Steps for which somebody else talks now and then: a control period.
const BUSY_STEPS: usize = 40;

#[derive(Clone, Debug)]
struct CanFrame {
    id: Id,
    remote: bool,
    data: Vec<u8>,
}

impl embedded_can::Frame for CanFrame {
    fn new(id: impl Into<Id>, data: &[u8]) -> Option<Self> {
        (data.len() <= 8).then(|| Self { id: id.into(), remote: false, data: data.to_vec() })
    }

    fn new_remote(id: impl Into<Id>, _: usize) -> Option<Self> {
        Some(Self { id: id.into(), remote: true, data: Vec::new() })
    }

    fn is_extended(&self) -> bool {
        matches!(self.id, Id::Extended(_))
    }

    fn is_remote_frame(&self) -> bool {
        self.remote
    }

    fn id(&self) -> Id {
        self.id
    }

    fn dlc(&self) -> usize {
        self.data.len()
    }

    fn data(&self) -> &[u8] {
        &self.data
    }
}

impl CanFrame {
    fn standard(&self) -> u16 {
        let Id::Standard(id) = self.id else { panic!("the executor sends no extended frames") };
        id.as_raw()
    }
}

struct State {
    mailboxes: Vec<CanFrame>,
    received: VecDeque<CanFrame>,
    dice: Dice,
    /// One call in so many finds no room, or nothing, without a reason; none if 0.
    refuses_one_in: usize,
    /// What receiving fails with, once each.
    receive_errors: VecDeque<ErrorKind>,
    /// What every call to send fails with.
    transmit_error: Option<ErrorKind>,
    /// Identifiers from which on no frame leaves, since somebody else keeps the bus busy.
    blocked_from: u16,
    /// Steps until somebody else talks, and for how many then.
    busy_in: usize,
    busy_for: usize,
    has_refused: bool,
    refused: u32,
    replaced: u32,
}

impl State {
    fn new(seed: u64, refuses_one_in: usize) -> Rc<RefCell<Self>> {
        Rc::new(RefCell::new(Self {
            mailboxes: Vec::new(),
            received: VecDeque::new(),
            dice: Dice(seed),
            refuses_one_in,
            receive_errors: VecDeque::new(),
            transmit_error: None,
            blocked_from: 0x800,
            busy_in: 0,
            busy_for: BUSY_STEPS,
            has_refused: false,
            refused: 0,
            replaced: 0,
        }))
    }

    fn refuses(&mut self) -> bool {
        self.refuses_one_in > 0 && self.dice.one_in(self.refuses_one_in)
    }

    fn transmit(&mut self, frame: &CanFrame) -> nb::Result<Option<CanFrame>, ErrorKind> {
        if let Some(error) = self.transmit_error {
            return Err(nb::Error::Other(error));
        }
        let result = self.take(frame);
        self.has_refused = !matches!(result, Ok(None));
        result
    }

    fn take(&mut self, frame: &CanFrame) -> nb::Result<Option<CanFrame>, ErrorKind> {
        if self.mailboxes.len() < MAILBOXES && !self.refuses() {
            self.mailboxes.push(frame.clone());
            return Ok(None);
        }
        let least = (0..self.mailboxes.len()).max_by_key(|at| (self.mailboxes[*at].standard(), *at));
        match least {
            Some(at) if self.mailboxes[at].standard() > frame.standard() => {
                self.replaced += 1;
                let replaced = self.mailboxes.remove(at);
                self.mailboxes.push(frame.clone());
                Ok(Some(replaced))
            }
            _ => {
                self.refused += 1;
                Err(nb::Error::WouldBlock)
            }
        }
    }

    fn receive(&mut self) -> nb::Result<CanFrame, ErrorKind> {
        if let Some(error) = self.receive_errors.pop_front() {
            return Err(nb::Error::Other(error));
        }
        if self.refuses() {
            return Err(nb::Error::WouldBlock);
        }
        self.received.pop_front().ok_or(nb::Error::WouldBlock)
    }

    /// Frames of other nodes beside each of the arm's: same numbers, same data, and none of the executor's business.
    fn arrives(&mut self, frame: &Frame) {
        let id = StandardId::new(frame.id).unwrap();
        let extended = Id::Extended(ExtendedId::new(u32::from(frame.id)).unwrap());
        self.received.push_back(CanFrame { id: extended, remote: false, data: frame.data.to_vec() });
        self.received.push_back(CanFrame { id: Id::Standard(id), remote: true, data: Vec::new() });
        self.received.push_back(CanFrame { id: Id::Standard(id), remote: false, data: frame.data.to_vec() });
    }

    /// What the bus has time for in a step.
    fn leaves(&mut self) -> Vec<Frame> {
        let frames = if self.is_busy() { 0 } else { FRAMES_IN_STEP };
        std::iter::from_fn(|| self.most_urgent()).take(frames).collect()
    }

    /// Whether somebody else talks in this step.
    fn is_busy(&mut self) -> bool {
        if self.refuses_one_in == 0 {
            return false;
        }
        if self.busy_in > 0 {
            self.busy_in -= 1;
            return false;
        }
        self.busy_for -= 1;
        if self.busy_for == 0 {
            self.busy_in = BUSY_STEPS + self.dice.below(2 * BUSY_STEPS);
            self.busy_for = BUSY_STEPS;
        }
        true
    }

    /// Of equal ones, the first.
    fn most_urgent(&mut self) -> Option<Frame> {
        let most = (0..self.mailboxes.len()).min_by_key(|at| (self.mailboxes[*at].standard(), *at))?;
        if self.mailboxes[most].standard() >= self.blocked_from {
            return None;
        }
        let frame = self.mailboxes.remove(most);
        Frame::new(frame.standard(), &frame.data)
    }
}

/// The driver: what an executor's firmware has.
struct Driver(Rc<RefCell<State>>);

impl embedded_can::nb::Can for Driver {
    type Frame = CanFrame;
    type Error = ErrorKind;

    fn transmit(&mut self, frame: &CanFrame) -> nb::Result<Option<CanFrame>, ErrorKind> {
        self.0.borrow_mut().transmit(frame)
    }

    fn receive(&mut self) -> nb::Result<CanFrame, ErrorKind> {
        self.0.borrow_mut().receive()
    }
}

struct Bus {
    wire: CanWire<Driver>,
    state: Rc<RefCell<State>>,
}

impl Bus {
    fn new(state: Rc<RefCell<State>>) -> Self {
        Self { wire: CanWire::new(Driver(Rc::clone(&state))), state }
    }
}

impl Wire for Bus {
    fn turn(&mut self, now_us: &dyn Fn() -> u64, endpoint: &mut Endpoint<'_>) -> Turn {
        self.wire.turn(now_us, endpoint)
    }

    fn has_arrived(&self) -> bool {
        let state = self.state.borrow();
        !state.received.is_empty() || !state.receive_errors.is_empty()
    }

    fn has_refused(&self) -> bool {
        self.state.borrow().has_refused
    }

    fn leaves(&mut self) -> Vec<Frame> {
        self.state.borrow_mut().leaves()
    }

    fn arrives(&mut self, frame: &Frame) {
        self.state.borrow_mut().arrives(frame);
    }
}

#[test]
fn a_plan_arrives_over_a_controller_that_refuses_and_gives_back() {
    let (mut refused, mut replaced) = (0, 0);
    for seed in SEEDS {
        let state = State::new(seed, 3);
        play_undisturbed(DIALECT, &mut Bus::new(Rc::clone(&state))).assert_arrived();
        refused += state.borrow().refused;
        replaced += state.borrow().replaced;
    }
    assert!(refused > 2_000 && replaced > 100, "{refused} {replaced}");
}

#[test]
fn an_arm_is_not_ahead_of_its_time_for_a_turn_that_was_held_up() {
    let mut bus = Bus::new(State::new(1, 0));
    play_held_up(&plan(), DIALECT, &mut bus, HELD_UP_US, |_, _| false).assert_arrived();
}

#[test]
fn an_error_of_the_controller_is_a_lost_link_and_a_stop() {
    for kind in [ErrorKind::Bit, ErrorKind::Acknowledge, ErrorKind::Other] {
        let state = State::new(1, 0);
        let mut bus = Bus::new(Rc::clone(&state));
        let played = play(&plan(), DIALECT, &mut bus, |now_us, _| {
            let breaks = now_us == 700_000;
            if breaks {
                state.borrow_mut().receive_errors.push_back(kind);
            }
            breaks
        });
        // It was one error, so the stop that is asked for gets through.
        assert_eq!(played.fault(), Some((FaultCode::LinkLost, true)));
        assert_eq!(bus.wire.failure(), Some(&kind));
        assert_eq!(played.arm.fault().map(|fault| fault.code), Some(FaultCode::StopCommanded));
        assert!(played.arm.has_moved() && played.arm.status().standstill);
    }
}

#[test]
fn a_controller_that_sends_no_more_is_a_lost_link_and_the_arm_stops_by_itself() {
    let state = State::new(1, 0);
    let mut bus = Bus::new(Rc::clone(&state));
    let played = play(&plan(), DIALECT, &mut bus, |now_us, _| {
        if now_us == 700_000 {
            state.borrow_mut().transmit_error = Some(ErrorKind::Other);
        }
        false
    });
    assert_eq!(played.fault(), Some((FaultCode::LinkLost, true)));
    assert_eq!(bus.wire.failure(), Some(&ErrorKind::Other));
    assert_eq!(played.arm.fault().map(|fault| fault.code), Some(FaultCode::SetpointMissing));
}

#[test]
fn the_stop_gets_through_once_a_controller_recovers() {
    let state = State::new(1, 0);
    let played = play(&plan(), DIALECT, &mut Bus::new(Rc::clone(&state)), |now_us, _| {
        let fails = (700_000..720_000).contains(&now_us);
        state.borrow_mut().transmit_error = fails.then_some(ErrorKind::Other);
        false
    });
    assert_eq!(played.fault(), Some((FaultCode::LinkLost, true)));
    assert_eq!(played.arm.fault().map(|fault| fault.code), Some(FaultCode::StopCommanded));
}

#[test]
fn an_overrun_costs_frames_and_no_session() {
    let state = State::new(1, 0);
    let mut bus = Bus::new(Rc::clone(&state));
    let played = play(&plan(), DIALECT, &mut bus, |now_us, _| {
        let overruns = now_us % 100_000 == 0;
        if overruns {
            state.borrow_mut().receive_errors.push_back(ErrorKind::Overrun);
        }
        overruns
    });
    played.assert_arrived();
    assert!(bus.wire.harmless_errors() > 10 && bus.wire.failure().is_none());
}

#[test]
fn what_a_driver_mends_by_itself_can_be_tolerated() {
    let state = State::new(1, 0);
    state.borrow_mut().receive_errors.extend([ErrorKind::Crc, ErrorKind::Form]);
    let mut bus = Bus::new(state);
    bus.wire = bus.wire.tolerating(|error| matches!(error, ErrorKind::Crc | ErrorKind::Form));
    play_undisturbed(DIALECT, &mut bus).assert_arrived();
    assert_eq!(bus.wire.harmless_errors(), 2);
}

#[test]
fn a_controller_without_room_from_the_start_is_given_up() {
    let state = State::new(1, 0);
    state.borrow_mut().blocked_from = 0;
    let played = play_undisturbed(DIALECT, &mut Bus::new(state));
    assert_eq!(played.fault(), Some((FaultCode::HandshakeTimeout, false)));
    assert_eq!(played.heard, 0);
}

#[test]
fn a_stop_frame_goes_before_all_that_waits_for_a_busy_bus() {
    let state = State::new(1, 0);
    let mut pressed = false;
    let played = play(&plan(), DIALECT, &mut Bus::new(Rc::clone(&state)), |now_us, endpoint| {
        if now_us < 700_000 {
            return false;
        }
        // Somebody talks all the time, more urgently than all but the stop frame.
        state.borrow_mut().blocked_from = 0x100;
        let presses = state.borrow().has_refused && !pressed;
        if presses {
            pressed = true;
            endpoint.executor_mut().handle_hard_stop(now_us);
        }
        presses
    });
    assert!(pressed);
    assert_eq!(played.fault(), Some((FaultCode::OperatorStop, true)));
    assert_eq!(played.arm.fault().map(|fault| fault.code), Some(FaultCode::SoftwareStop));
}

#[test]
fn a_babbling_node_does_not_keep_the_turn_from_ending() {
    let bytes = plan();
    let plan = PlanReader::new(&bytes).unwrap();
    let mut endpoint = Endpoint::new(0, &plan, DIALECT, Config::default());
    let state = State::new(1, 0);
    let babble =
        CanFrame { id: StandardId::new(ids::STATUS).unwrap().into(), remote: false, data: vec![0; 8] };
    state.borrow_mut().received.extend(std::iter::repeat_n(babble, 1_000));
    let mut bus = Bus::new(state);
    let mut turns = 0;
    while bus.turn(&|| 0, &mut endpoint) == Turn::Unfinished {
        bus.leaves();
        turns += 1;
        // What there is to say is said meanwhile: with two or three frames a turn, all of Open.
        assert!(turns != 10 || endpoint.frame_counts()[0] == 18, "{}", endpoint.frame_counts()[0]);
    }
    assert!(turns > 10);
    assert_eq!(endpoint.frame_counts(), [18, 1_000, 1_000]);
}

#[test]
fn an_endpoint_of_the_other_dialect_loses_the_link_at_once() {
    let played = play_undisturbed(Dialect::Fd, &mut Bus::new(State::new(1, 0)));
    assert_eq!(played.fault(), Some((FaultCode::LinkLost, false)));
    assert!(!played.arm.has_moved());
}
