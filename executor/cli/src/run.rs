//! Executor and simulated arm in one process, joined without a wire; and what there is to know after any run.
//!
//! Both see the scheduled moments, never the lateness of the process that they share: under the wall clock the motion is
//! the same, bit for bit, as under virtual time.

use powderline_executor::belief::Doubt;
use powderline_executor::{Action, Config, Executor, Outcome, Telemetry};
use powderline_firmware_sim::clock::VirtualClock;
use powderline_firmware_sim::controller::{ArmConfig, Controller};
use powderline_host::jitter::JitterSummary;
pub use powderline_host::signals::StopWish;
use powderline_host::wait::Interest;
use powderline_shared::displacement::{Lsb, Setpoint};
use powderline_shared::fault::Reported;
use powderline_shared::limits::{PeakUse, Violation};
use powderline_shared::plan::PlanReader;
use powderline_shared::pose::Pose;
use powderline_shared::wire::message::{Refusal, Status};
use serde::Serialize;

use crate::pace::Pace;

/// What there is to know after a run.
#[derive(Clone, Debug)]
pub struct RunResult {
    /// How it ended.
    pub outcome: Outcome,
    /// The arm's last report in the session.
    pub arm: Option<Status>,
    /// Where the arm has said to be, from its anchor.
    pub reached: Option<Setpoint>,
    /// What one of its counts is worth.
    pub lsb: Lsb,
    /// Where the arm stands, as far as is known.
    pub final_pose: Option<Pose>,
    /// What the executor has counted and measured.
    pub telemetry: Telemetry,
    /// Use of the plan's limits by what was sent.
    pub peak_use: PeakUse,
    /// The numbers behind a limit fault, whoever found it.
    pub violation: Option<Violation>,
    /// Why the arm refused the session; none once it has opened it.
    pub refusal: Option<Refusal>,
    /// Whether that is a stop which came after a person had said that what there was may be reset.
    pub is_stopped_anew: bool,
    /// The stop that the arm had latched and was reset from.
    pub reset_from: Option<Reported>,
    /// Why the arm was not believed.
    pub doubt: Option<Doubt>,
    /// From begin to end, microseconds; in virtual time, of that.
    pub duration_us: u64,
    /// Under the wall clock: how late the process woke up.
    pub jitter: Option<JitterSummary>,
    /// On a wire: what became of frames.
    pub frames: Option<FrameCounts>,
    /// On a wire: what is to be said of it.
    pub wire: Option<String>,
}

/// What became of frames.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct FrameCounts {
    /// Given to the wire.
    pub sent: u32,
    /// Received.
    pub received: u32,
    /// Received, and dropped: damaged, of another session, or of nobody known.
    pub rejected: u32,
    /// Of these, those that were not made with the key of the session.
    pub wrong_tags: u32,
    /// Given up because the wire had no room for too long.
    pub not_taken: u64,
    /// Pieces of a serial line that were no frames.
    pub garbled: u64,
}

/// What a person may see and do during a run.
pub trait Observer {
    /// Called after every exchange with the arm's last status; what the person wishes by now.
    fn observe(&mut self, now_us: u64, arm: &Status) -> StopWish;

    /// What to wait for, so that a wish is seen at once.
    fn interest(&self) -> Option<Interest<'_>> {
        None
    }
}

/// Sees nothing, stops nothing.
#[derive(Clone, Copy, Debug, Default)]
pub struct Unattended;

impl Observer for Unattended {
    fn observe(&mut self, _now_us: u64, _arm: &Status) -> StopWish {
        StopWish::None
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
    let mut wish = StopWish::None;
    loop {
        let now_us = clock.now_us();
        if let Some(outcome) = exchange(now_us, &mut executor, &mut arm) {
            return RunResult {
                outcome,
                arm: executor.session_status(),
                reached: executor.reached(),
                lsb: config.lsb.unwrap_or(plan.header().lsb),
                final_pose: Some(arm.pose()),
                telemetry: executor.telemetry(),
                peak_use: executor.peak_use(),
                violation: executor.violation().or(arm.violation()),
                refusal: executor.refusal(),
                is_stopped_anew: executor.is_stopped_anew(),
                reset_from: executor.reset_from(),
                doubt: executor.doubt(),
                duration_us: now_us,
                jitter: pace.jitter(),
                frames: None,
                wire: None,
            };
        }
        let wished = observer.observe(now_us, &executor.arm_status().copied().unwrap_or(arm.status()));
        if wished > wish {
            wish = wished;
            match wish {
                StopWish::None => {}
                StopWish::Controlled => executor.handle_stop(now_us),
                StopWish::Immediate => executor.handle_hard_stop(now_us),
            }
        }
        let next_us = executor.poll_at().map_or(now_us, |executor_us| executor_us.min(arm.poll_at()));
        // What is due already, such as the message of a stop that has just been asked for, is exchanged at once.
        let next_us = next_us.max(now_us);
        pace.wait_until(next_us);
        clock.advance_to(next_us);
    }
}

/// Passes messages to and fro until both wait; the outcome, if the session is over.
fn exchange(now_us: u64, executor: &mut Executor<'_>, arm: &mut Controller) -> Option<Outcome> {
    loop {
        let mut quiet = true;
        while let Some(message) = arm.poll(now_us) {
            executor.handle_message(now_us, &message);
            quiet = false;
        }
        match executor.poll(now_us) {
            Action::Send(message) => arm.handle_message(now_us, &message),
            Action::Finished(outcome) => return Some(outcome),
            Action::Wait if quiet => return None,
            Action::Wait => {}
        }
    }
}
