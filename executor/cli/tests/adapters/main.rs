//! Whole plans through the adapters for embedded devices, to the simulated arm, over virtual time. The devices, in memory,
//! have no room now and then, take things in parts, give frames back, and break.

mod can;
#[path = "../common/mod.rs"]
mod common;
mod serial;

use std::cell::Cell;

use common::{header, one_move, plan_bytes};
use powderline_executor::adapters::Turn;
use powderline_executor::{Config, Endpoint, Outcome};
use powderline_firmware_sim::controller::{ArmConfig, Controller};
use powderline_firmware_sim::endpoint::Endpoint as ArmEndpoint;
use powderline_shared::displacement::{Axis, Lsb};
use powderline_shared::fault::FaultCode;
use powderline_shared::plan::PlanReader;
use powderline_shared::wire::frame::{Dialect, Frame};

/// How often the devices are looked after, microseconds.
const STEP_US: u64 = 250;

/// No session here takes longer, microseconds.
const LONGEST_US: u64 = 10_000_000;

/// Seeds of what the devices refuse.
const SEEDS: std::ops::Range<u64> = 0..20;

/// A turn that has begun, and then gets no processor: what it reads was said after it had looked at the clock.
const HELD_UP_US: std::ops::Range<u64> = 700_000..760_000;

/// An adapter with its device.
trait Wire {
    fn turn(&mut self, now_us: &dyn Fn() -> u64, endpoint: &mut Endpoint<'_>) -> Turn;
    /// Whether something waits to be fetched.
    fn has_arrived(&self) -> bool;
    /// Whether the device has last refused something, or taken it in part.
    fn has_refused(&self) -> bool;
    /// What the device sends in a step.
    fn leaves(&mut self) -> Vec<Frame>;
    /// What the arm has said reaches the device.
    fn arrives(&mut self, frame: &Frame);
}

/// A session that is over, or was given up.
struct Played {
    outcome: Option<Outcome>,
    arm: Controller,
    /// Frames that left, and that arrived, as the endpoint counts them; and those that it could not read.
    counts: [u32; 3],
    /// Frames that reached the arm.
    heard: u32,
    /// Where the arm stands minus where the plan ends, LSB of the wire.
    error_lsb: [f64; 6],
}

impl Played {
    fn fault(&self) -> Option<(FaultCode, bool)> {
        match self.outcome? {
            Outcome::Completed => None,
            Outcome::Stopped { fault, standstill } => Some((fault.code, standstill)),
        }
    }

    fn assert_arrived(&self) {
        assert_eq!(self.outcome, Some(Outcome::Completed));
        let error = self.error_lsb;
        assert!(error.iter().all(|error| error.abs() <= 0.5 * (1.0 + 1e-6)), "{error:?} LSB");
        let [sent, _, rejected] = self.counts;
        assert_eq!((self.heard, rejected), (sent, 0), "frames were lost or damaged");
        assert_eq!(self.arm.lost(), 0, "setpoints came too late");
    }
}

fn plan() -> Vec<u8> {
    plan_bytes(&header(), &one_move())
}

/// Plays the plan; `intervene` is called in each step, and says whether the endpoint needs a turn because of it.
fn play(
    bytes: &[u8],
    dialect: Dialect,
    wire: &mut impl Wire,
    intervene: impl FnMut(u64, &mut Endpoint<'_>) -> bool,
) -> Played {
    play_held_up(bytes, dialect, wire, 0..0, intervene)
}

/// The same with a turn that looks at the clock, and is then kept from its work for a while.
fn play_held_up(
    bytes: &[u8],
    dialect: Dialect,
    wire: &mut impl Wire,
    held_up_us: std::ops::Range<u64>,
    mut intervene: impl FnMut(u64, &mut Endpoint<'_>) -> bool,
) -> Played {
    let plan = PlanReader::new(bytes).unwrap();
    let mut endpoint = Endpoint::new(0, &plan, dialect, Config::default());
    let mut arm = ArmEndpoint::new(Controller::new(ArmConfig::ideal(plan.header().start_pose())), dialect);
    let (mut outcome, mut heard, mut idle) = (None, 0, false);
    for now_us in (0..LONGEST_US).step_by(STEP_US as usize) {
        for frame in wire.leaves() {
            heard += 1;
            arm.handle_frame(now_us, &frame);
        }
        while let Some(frame) = arm.poll(now_us) {
            wire.arrives(&frame);
        }
        if held_up_us.contains(&now_us) {
            continue;
        }
        let looks = Cell::new(0);
        let clock = || match looks.replace(1) {
            0 if now_us == held_up_us.end && now_us > 0 => held_up_us.start,
            _ => now_us,
        };
        let wanted = intervene(now_us, &mut endpoint);
        // An idle adapter is left alone until something is due, as it says that it may be.
        let due = endpoint.poll_at().is_none_or(|at_us| at_us <= now_us);
        if idle && !wanted && !due && !wire.has_arrived() {
            continue;
        }
        match wire.turn(&clock, &mut endpoint) {
            Turn::Finished(how) => {
                outcome.get_or_insert(how);
            }
            turn => idle = turn == Turn::Idle,
        }
        assert!(!idle || !wire.has_refused(), "what was refused is to be tried again soon");
        // The arm is given the time to stop by itself.
        let arm = arm.controller();
        if outcome.is_some() && (outcome == Some(Outcome::Completed) || arm.status().standstill) {
            break;
        }
    }
    Played {
        outcome,
        arm: arm.controller().clone(),
        counts: endpoint.frame_counts(),
        heard,
        error_lsb: error_lsb(&plan, arm.controller(), dialect.lsb()),
    }
}

/// Component by component, as setpoints are rounded.
fn error_lsb(plan: &PlanReader<'_>, arm: &Controller, lsb: Lsb) -> [f64; 6] {
    let end = plan.end_setpoint().cumulative(plan.header().lsb).components();
    let mut error = plan.header().start_pose().displacement_to(&arm.pose()).components();
    for ((error, end), axis) in error.iter_mut().zip(end).zip(Axis::ALL) {
        *error = (*error - end) / lsb.of(axis);
    }
    error
}

fn play_undisturbed(dialect: Dialect, wire: &mut impl Wire) -> Played {
    play(&plan(), dialect, wire, |_, _| false)
}

/// Numbers from a seed (Knuth's constants for 64 bits).
#[derive(Debug)]
struct Dice(u64);

impl Dice {
    fn below(&mut self, bound: usize) -> usize {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) as usize % bound
    }

    fn one_in(&mut self, many: usize) -> bool {
        self.below(many) == 0
    }
}
