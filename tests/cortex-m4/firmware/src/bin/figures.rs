//! What the core costs and whether it computes what the host does. Nothing outside can change a figure: the arm is an
//! echo in this program and its time is a number, so that each run under `-icount shift=10` gives the same line.
#![no_std]
#![no_main]

use core::hint::black_box;

use cortex_m::peripheral::Peripherals;
use cortex_m_rt::entry;
use heapless::Deque;
use powderline_cortex_m4::clock::{Clock, instructions};
use powderline_cortex_m4::report::{Report, fail};
use powderline_cortex_m4::{PLAN, SESSION, planted_panic, stack};
use powderline_cortex_m4_common::{PoseBits, pose_bits};
use powderline_executor::{Config, Endpoint, FrameAction, Outcome};
use powderline_shared::displacement::Setpoint;
use powderline_shared::limits::PeakUse;
use powderline_shared::plan::{PlanReader, StartPose};
use powderline_shared::pose::Pose;
use powderline_shared::wire::Context;
use powderline_shared::wire::codec::{Encoder, Frames, ToArmDecoder};
use powderline_shared::wire::frame::{Dialect, Frame};
use powderline_shared::wire::ids;
use powderline_shared::wire::message::{DEPTH, FromArm, NO_SESSION, Status, ToArm};
use powderline_shared::wire::state::{Command, Event, Phase, State, transition};

/// Messages of the echo that wait to be heard.
const MESSAGES: usize = 8;

#[entry]
fn main() -> ! {
    let Some(peripherals) = Peripherals::take() else { fail("the peripherals are taken") };
    let clock = Clock::start(peripherals.SYST);
    planted_panic();

    let (plan, reading) = timed(&clock, || PlanReader::new(black_box(PLAN)));
    let Ok(plan) = plan else { fail("the plan in flash is none") };
    let (checked, checking) = timed(&clock, || plan.check_limits());
    let Ok(peak) = checked else { fail("the plan breaks its own limits") };
    let (poses, walking) = timed(&clock, || pose_bits(&plan));

    let mut polls = Polls::default();
    let sent = play(&clock, &plan, &mut polls);
    if sent != plan.header().step_count {
        fail("not every setpoint was sent");
    }

    let mut report = Report::new("figures:");
    report
        .number("steps", u64::from(plan.header().step_count))
        .number("plan_bytes", PLAN.len() as u64)
        .number("read_instructions", reading)
        .number("check_instructions", checking)
        .number("pose_instructions", walking / u64::from(plan.header().step_count.max(1)));
    polls.setpoint.report(&mut report, ["setpoint_poll_least", "setpoint_poll_mean", "setpoint_poll_most"]);
    polls.idle.report(&mut report, ["idle_poll_least", "idle_poll_mean", "idle_poll_most"]);
    polls.heard.report(&mut report, ["message_least", "message_mean", "message_most"]);
    report
        .number("poll_at_instructions", polls.poll_at)
        .number("endpoint_bytes", size_of::<Endpoint<'_>>() as u64)
        .number("stack_bytes", u64::from(stack::most_used_bytes()));
    report_bits(&mut report, &poses, &peak);
    report.succeed()
}

fn report_bits(report: &mut Report, poses: &PoseBits, peak: &PeakUse) {
    report.bits("poses", poses.all);
    for (name, bits) in ["x", "y", "z", "qw", "qx", "qy", "qz"].into_iter().zip(poses.end) {
        report.bits(name, bits);
    }
    report.bits("peak_jerk", peak.linear_jerk.to_bits());
}

/// Plays the whole plan to the echo; the highest tick that was sent.
fn play(clock: &Clock, plan: &PlanReader<'_>, polls: &mut Polls) -> u32 {
    let period_us = u64::from(plan.header().control_period_us);
    let mut echo = Echo::new(plan);
    let config = Config { session: SESSION, ..Config::default() };
    let mut endpoint = Endpoint::new(0, plan, Dialect::Fd, black_box(config));
    // The plan, the way up and down, and time to spare.
    for period in 0..u64::from(plan.header().step_count).wrapping_add(200) {
        let now_us = period.wrapping_mul(period_us);
        echo.tick();
        loop {
            while let Some(frame) = echo.frame() {
                let (heard, cost) = timed(clock, || endpoint.handle_frame(now_us, &frame));
                if heard.is_err() {
                    fail("the executor does not understand the echo");
                }
                polls.heard.add(cost);
            }
            let (action, cost) = timed(clock, || endpoint.poll(now_us));
            match action {
                FrameAction::Send(frame) => {
                    if frame.id == ids::SETPOINT_T {
                        polls.setpoint.add(cost);
                    }
                    echo.hear(&frame);
                }
                FrameAction::Wait => {
                    polls.idle.add(cost);
                    polls.poll_at = polls.poll_at.max(timed(clock, || black_box(endpoint.poll_at())).1);
                    break;
                }
                FrameAction::Finished(Outcome::Completed) => return endpoint.executor().telemetry().sent,
                FrameAction::Finished(Outcome::Stopped { .. }) => fail("the session was stopped"),
            }
        }
    }
    fail("the session did not end")
}

fn timed<T>(clock: &Clock, work: impl FnOnce() -> T) -> (T, u64) {
    let before = clock.counts();
    let result = work();
    (result, instructions(clock.counts().wrapping_sub(before)))
}

/// Instructions by what was done.
#[derive(Default)]
struct Polls {
    setpoint: Costs,
    idle: Costs,
    heard: Costs,
    poll_at: u64,
}

#[derive(Default)]
struct Costs {
    count: u64,
    sum: u64,
    least: u64,
    most: u64,
}

impl Costs {
    fn add(&mut self, cost: u64) {
        self.least = if self.count == 0 { cost } else { self.least.min(cost) };
        self.most = self.most.max(cost);
        self.sum = self.sum.wrapping_add(cost);
        self.count = self.count.wrapping_add(1);
    }

    fn report(&self, report: &mut Report, [least, mean, most]: [&str; 3]) {
        report.number(least, self.least).number(mean, self.sum / self.count.max(1)).number(most, self.most);
    }
}

/// Of the one session.
const NONCE: u32 = 1;

/// An arm that believes everything and is where it is told to be: it costs next to nothing and says what a real one would
/// say in good order.
struct Echo {
    start: Pose,
    end_tick: u32,
    state: State,
    session: u16,
    waiting: Deque<Setpoint, { DEPTH as usize }>,
    reached: Setpoint,
    counter: u8,
    context: Context,
    encoder: Encoder,
    decoder: ToArmDecoder,
    messages: Deque<FromArm, MESSAGES>,
    leaving: Frames,
}

impl Echo {
    fn new(plan: &PlanReader<'_>) -> Self {
        Self {
            start: StartPose::from(&plan.header().start_pose()).pose(),
            end_tick: plan.header().step_count,
            state: State::SwitchOnDisabled,
            session: NO_SESSION,
            waiting: Deque::new(),
            reached: Setpoint::ANCHOR,
            counter: 0,
            context: Context::NONE,
            encoder: Encoder::new(Dialect::Fd),
            decoder: ToArmDecoder::new(Dialect::Fd),
            messages: Deque::new(),
            leaving: Frames::default(),
        }
    }

    fn hear(&mut self, frame: &Frame) {
        let Ok(messages) = self.decoder.handle_frame(frame) else {
            fail("the echo does not understand the executor")
        };
        messages.iter().for_each(|message| self.obey(message));
    }

    fn obey(&mut self, message: &ToArm) {
        match *message {
            ToArm::Open(request) => {
                self.session = request.session;
                self.context = Context::sealed(&request, NONCE);
                self.decoder.set_context(self.context);
                let (session, digest) = (request.session, request.digest());
                self.say(FromArm::Opened { session, nonce: NONCE, digest });
                self.say_status();
            }
            ToArm::Control { command, .. } => self.control(command),
            ToArm::Setpoint { setpoint, .. } => {
                if self.waiting.push_back(setpoint).is_err() {
                    fail("a setpoint came without credit");
                }
            }
            ToArm::Heartbeat { .. } => {}
            ToArm::Stop | ToArm::OpenKeyed(..) => fail("a stop was sent, or a key was used"),
        }
    }

    fn control(&mut self, command: Command) {
        if let Some(line) = transition(self.state, Event::Command(command)) {
            self.state = line.to;
        }
        if self.state == State::OperationEnabled {
            self.say(FromArm::Anchored { session: self.session, pose: self.start });
        }
        self.say_status();
    }

    fn frame(&mut self) -> Option<Frame> {
        loop {
            if let Some(frame) = self.leaving.next() {
                return Some(frame);
            }
            let message = self.messages.pop_front()?;
            self.leaving = self.encoder.from_arm(&self.context, &message);
        }
    }

    /// One control period later.
    fn tick(&mut self) {
        if let Some(setpoint) = self.waiting.pop_front() {
            self.reached = setpoint;
        }
        if self.state == State::OperationEnabled {
            self.say(FromArm::Actual { session: self.session, reached: self.reached });
            self.say_status();
        }
    }

    fn say_status(&mut self) {
        self.counter = self.counter.wrapping_add(1);
        let waiting = self.waiting.len() as u32;
        let enabled = self.state == State::OperationEnabled;
        self.say(FromArm::Status(Status {
            session: self.session,
            state: self.state,
            phase: enabled.then_some(match self.reached.tick {
                0 => Phase::Armed,
                tick if tick == self.end_tick => Phase::Holding,
                _ => Phase::Streaming,
            }),
            standstill: !enabled || waiting == 0,
            applied_tick: self.reached.tick,
            have: 1_u16.checked_shl(waiting).map_or(u16::MAX, |bit| bit.wrapping_sub(1)),
            counter: self.counter,
        }));
    }

    fn say(&mut self, message: FromArm) {
        if self.messages.push_back(message).is_err() {
            fail("the executor does not listen");
        }
    }
}
