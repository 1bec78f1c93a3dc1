//! Executor and simulated arm in one process, joined without a wire.
//!
//! Both see the scheduled moments, never the lateness of the process that they share: under the wall clock the motion is
//! the same, bit for bit, as under virtual time.

use powderline_firmware_sim::clock::VirtualClock;
use powderline_firmware_sim::controller::{ArmConfig, Controller};
use powderline_shared::limits::{PeakUse, Violation};
use powderline_shared::plan::PlanReader;
use powderline_shared::pose::Pose;
use powderline_shared::wire::message::{Refusal, Status};

use crate::pace::Pace;
use powderline_executor::{Action, Config, Executor, Outcome, Telemetry};

/// What there is to know after a run.
#[derive(Clone, Copy, Debug)]
pub struct RunResult {
    /// How it ended.
    pub outcome: Outcome,
    /// The arm's last report in the session.
    pub arm: Status,
    /// Where the arm really stands.
    pub final_pose: Pose,
    /// What the executor has counted and measured.
    pub telemetry: Telemetry,
    /// Use of the plan's limits by what was sent.
    pub peak_use: PeakUse,
    /// The numbers behind a limit fault, whoever found it.
    pub violation: Option<Violation>,
    /// Why the arm refused the session.
    pub refusal: Option<Refusal>,
    /// Scheduled time from begin to end, microseconds.
    pub duration_us: u64,
    /// Under the wall clock: how late the process was at the worst, microseconds.
    pub worst_lateness_us: Option<u64>,
}

/// What a person may see and do during a run.
pub trait Observer {
    /// Called after every exchange; `true` asks for a controlled stop.
    fn observe(&mut self, now_us: u64, arm: &Status) -> bool;
}

/// Sees nothing, stops nothing.
#[derive(Clone, Copy, Debug, Default)]
pub struct Unattended;

impl Observer for Unattended {
    fn observe(&mut self, _now_us: u64, _arm: &Status) -> bool {
        false
    }
}

/// Plays a plan on a simulated arm until the session is over.
pub fn play(
    plan: &PlanReader<'_>,
    config: Config,
    arm: ArmConfig,
    pace: &mut impl Pace,
    observer: &mut impl Observer,
) -> RunResult {
    let mut clock = VirtualClock::default();
    let mut arm = Controller::new(arm);
    let mut executor = Executor::new(clock.now_us(), plan, config);
    let mut last_report = arm.status();
    loop {
        let now_us = clock.now_us();
        if let Some(outcome) = exchange(now_us, config.session, &mut executor, &mut arm, &mut last_report) {
            return RunResult {
                outcome,
                arm: last_report,
                final_pose: arm.pose(),
                telemetry: executor.telemetry(),
                peak_use: executor.peak_use(),
                violation: executor.violation().or(arm.violation()),
                refusal: executor.refusal(),
                duration_us: now_us,
                worst_lateness_us: pace.worst_lateness_us(),
            };
        }
        if observer.observe(now_us, &last_report) {
            executor.handle_stop(now_us);
        }
        let next_us = executor.poll_at().map_or(now_us, |executor_us| executor_us.min(arm.poll_at()));
        // What is due already, such as the message of a stop that has just been asked for, is exchanged at once.
        let next_us = next_us.max(now_us);
        pace.wait_until(next_us);
        clock.advance_to(next_us);
    }
}

/// Passes messages to and fro until both wait; the outcome, if the session is over.
fn exchange(
    now_us: u64,
    session: u16,
    executor: &mut Executor<'_>,
    arm: &mut Controller,
    last_report: &mut Status,
) -> Option<Outcome> {
    loop {
        let mut quiet = true;
        while let Some(message) = arm.poll(now_us) {
            executor.handle_message(now_us, &message);
            quiet = false;
        }
        if let Some(status) = executor.arm_status().filter(|status| status.session == session) {
            *last_report = *status;
        }
        match executor.poll(now_us) {
            Action::Send(message) => arm.handle_message(now_us, &message),
            Action::Finished(outcome) => return Some(outcome),
            Action::Wait if quiet => return None,
            Action::Wait => {}
        }
    }
}
