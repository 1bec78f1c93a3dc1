//! The driver loop of `execute` on a wire whose transmit queue is full: at most one frame waits, and a stop passes it.

mod common;

use std::cell::Cell;
use std::io::{Read, Write};
use std::os::fd::AsFd;
use std::os::unix::net::UnixStream;
use std::rc::Rc;
use std::thread;
use std::time::Duration;

use common::{Move, header, one_move, plan_bytes};
use powderline_executor::{Config, Outcome};
use powderline_executor_cli::run::{Observer, RunResult, StopWish};
use powderline_executor_cli::wire::{FlightRecorder, play};
use powderline_firmware_sim::controller::{ArmConfig, Controller};
use powderline_firmware_sim::endpoint::Endpoint as ArmEndpoint;
use powderline_host::clock;
use powderline_host::transport::{Incoming, LinkError, Received, Sent, Transport};
use powderline_host::wait::Interest;
use powderline_shared::fault::FaultCode;
use powderline_shared::plan::{PlanHeader, PlanReader};
use powderline_shared::wire::frame::{Dialect, Frame};
use powderline_shared::wire::message::Status;

/// A wire to an arm in the same process, which takes nothing while it is full.
struct Clogged {
    arm: ArmEndpoint,
    start_us: u64,
    is_full: Rc<Cell<bool>>,
    /// Frames that were taken after it was full, the first ones first.
    taken_after: Vec<Frame>,
    was_full: bool,
    refused: u32,
    /// A byte every millisecond: the arm has time to say something.
    bell: UnixStream,
    /// Up to when time has passed for the arm.
    passed_us: u64,
    /// When the process is kept from its work, in the middle of a turn.
    nap_us: Option<u64>,
    /// When the device is gone, and how often it was asked since. Like a terminal that is hung up it says that there is something.
    gone_us: Option<u64>,
    asked_since: u32,
}

impl Clogged {
    fn now_us(&self) -> u64 {
        clock::now_us() - self.start_us
    }
}

impl Transport for Clogged {
    fn dialect(&self) -> Dialect {
        Dialect::Classic
    }

    fn send(&mut self, frame: &Frame) -> Result<Sent, LinkError> {
        if self.is_full.get() {
            self.was_full = true;
            self.refused += 1;
            return Ok(Sent::Busy);
        }
        if self.was_full {
            self.taken_after.push(frame.clone());
        }
        self.arm.handle_frame(self.passed_us, frame);
        Ok(Sent::Done)
    }

    fn receive(&mut self) -> Result<Option<Received>, LinkError> {
        if self.gone_us.is_some_and(|gone_us| self.now_us() > gone_us) {
            self.asked_since += 1;
            return Err(LinkError::Gone { link: "wire".into() });
        }
        let _ = self.bell.read(&mut [0; 64]);
        if self.nap_us.is_some_and(|nap_us| self.now_us() > nap_us) {
            self.nap_us = None;
            thread::sleep(Duration::from_millis(120));
        }
        let now_us = self.now_us();
        // In small steps, so that an arm whose process was held up by this machine does not stop for that.
        let mut frame = self.arm.poll(self.passed_us);
        while frame.is_none() && self.passed_us < now_us {
            self.passed_us = now_us.min(self.passed_us + 5_000);
            frame = self.arm.poll(self.passed_us);
        }
        Ok(frame.map(|frame| Received { at_us: clock::now_us(), what: Incoming::Frame(frame) }))
    }

    fn interest(&self) -> Option<Interest<'_>> {
        Some(Interest { fd: self.bell.as_fd(), writable: false })
    }
}

/// Clogs the wire from a tick on, for a time, and then asks for a stop.
struct Person {
    is_full: Rc<Cell<bool>>,
    wish: StopWish,
    full_since_us: Option<u64>,
    full_for_us: u64,
}

impl Observer for Person {
    fn observe(&mut self, now_us: u64, arm: &Status) -> StopWish {
        if arm.applied_tick >= 10 && self.full_since_us.is_none() {
            self.full_since_us = Some(now_us);
            self.is_full.set(true);
        }
        let Some(since_us) = self.full_since_us else { return StopWish::None };
        if now_us >= since_us + self.full_for_us {
            self.is_full.set(false);
        }
        // In the middle of it.
        if now_us >= since_us + self.full_for_us / 2 { self.wish } else { StopWish::None }
    }
}

fn bell() -> UnixStream {
    let (bell, mut rope) = UnixStream::pair().unwrap();
    bell.set_nonblocking(true).unwrap();
    thread::spawn(move || {
        while rope.write_all(&[0]).is_ok() {
            thread::sleep(Duration::from_millis(1));
        }
    });
    bell
}

fn played(wish: StopWish, full_for_us: u64) -> (RunResult, Clogged) {
    played_with(wish, full_for_us, None, None)
}

fn played_with(
    wish: StopWish,
    full_for_us: u64,
    nap_us: Option<u64>,
    gone_us: Option<u64>,
) -> (RunResult, Clogged) {
    let slow = Move { steps: 100, ..one_move().remove(0) };
    let bytes = plan_bytes(&PlanHeader { control_period_us: 20_000, ..header() }, &[slow]);
    let plan = PlanReader::new(&bytes).unwrap();
    let arm = ArmConfig { watchdog_us: 3_000_000, ..ArmConfig::ideal(plan.header().start_pose()) };
    let is_full = Rc::new(Cell::new(false));
    let mut wire = Clogged {
        arm: ArmEndpoint::new(Controller::new(arm), Dialect::Classic),
        start_us: clock::now_us(),
        is_full: Rc::clone(&is_full),
        taken_after: Vec::new(),
        was_full: false,
        refused: 0,
        bell: bell(),
        passed_us: 0,
        nap_us,
        gone_us,
        asked_since: 0,
    };
    let mut person = Person { is_full, wish, full_since_us: None, full_for_us };
    let config = Config { silence_us: 2_000_000, ..Config::default() };
    let result = play(&plan, config, &mut wire, &mut FlightRecorder::default(), &mut person).unwrap();
    (result, wire)
}

/// What is read after a pause was said during it: the arm is not ahead of its time.
#[test]
fn an_executor_that_was_kept_from_its_work_does_not_doubt_the_arm_for_that() {
    let (result, wire) = played_with(StopWish::None, 0, Some(700_000), None);
    assert_eq!((result.outcome, result.doubt), (Outcome::Completed, None));
    assert_eq!(wire.nap_us, None);
}

/// It waits for a device that may come back, and looks for it a thousand times a second, not as often as a processor can.
#[test]
fn a_wire_that_is_gone_is_not_asked_without_a_pause() {
    let (result, wire) = played_with(StopWish::None, 0, None, Some(500_000));
    let Outcome::Stopped { fault, standstill } = result.outcome else { panic!("{:?}", result.outcome) };
    assert_eq!((fault.code, standstill), (FaultCode::LinkLost, false));
    assert!((2..50_000).contains(&wire.asked_since), "{}", wire.asked_since);
}

#[test]
fn a_hard_stop_passes_what_waits_for_room() {
    let (result, wire) = played(StopWish::Immediate, 200_000);
    assert!(wire.refused > 0 && wire.was_full);
    assert_eq!(wire.taken_after.first().map(|frame| frame.id), Some(0x001), "{:?}", wire.taken_after);
    let Outcome::Stopped { fault, standstill } = result.outcome else { panic!("{:?}", result.outcome) };
    assert_eq!((fault.code, standstill), (FaultCode::OperatorStop, true));
}

#[test]
fn a_controlled_stop_waits_behind_one_frame_at_most() {
    let (result, wire) = played(StopWish::Controlled, 200_000);
    let control = wire.taken_after.iter().position(|frame| frame.id == 0x401);
    // One that waited, and the other half of a setpoint that was cut in two.
    assert!(control.is_some_and(|place| place <= 2), "{:?}", wire.taken_after);
    let setpoints = wire.taken_after.iter().filter(|frame| matches!(frame.id, 0x201 | 0x301)).count();
    assert!(setpoints <= 2, "{:?}", wire.taken_after);
    let Outcome::Stopped { fault, .. } = result.outcome else { panic!("{:?}", result.outcome) };
    assert_eq!(fault.code, FaultCode::OperatorStop);
}

#[test]
fn a_queue_that_is_full_for_a_moment_costs_nothing() {
    let (result, wire) = played(StopWish::None, 60_000);
    assert!(wire.refused > 0);
    assert_eq!((result.outcome, result.telemetry.lost), (Outcome::Completed, 0));
}
