//! One run: executors, wire and arm, each with its own clock, and whatever happens to them.

use std::collections::VecDeque;

use powderline_executor::{Config, Endpoint as ExecutorEndpoint, FrameAction, Outcome, Telemetry};
use powderline_firmware_sim::controller::{ArmConfig, Controller};
use powderline_firmware_sim::endpoint::Endpoint as ArmEndpoint;
use powderline_shared::fault::Fault;
use powderline_shared::plan::PlanReader;
use powderline_shared::wire::Context;
use powderline_shared::wire::codec::Encoder;
use powderline_shared::wire::frame::{Dialect, Frame};
use powderline_shared::wire::message::ToArm;

use super::bus::{Arrival, Bus, BusCounts, Line, Side};
use super::dice::Dice;
use super::faults::{Event, Faults, Planned};
use super::motion;
use super::witness::{Breach, Witness, silence_bound_us};

/// A run that is not over by then never will be, microseconds.
const LONGEST_RUN_US: u64 = 60_000_000;

/// Frames that a babbling node remembers.
const MEMORY: usize = 256;

/// What is known after a run.
#[derive(Clone, Debug)]
pub struct RunOutcome {
    /// How the sessions of the first executor and its restarts ended, in order; `None` for one that died.
    pub outcomes: Vec<Option<Outcome>>,
    /// What the arm latched first, if anything.
    pub arm_fault: Option<Fault>,
    /// What may never happen, and did.
    pub breaches: Vec<Breach>,
    /// Longest time from the last that was heard of an executor to standstill, microseconds.
    pub worst_silence_us: u64,
    /// Largest distance of the final pose from the plan's end, LSB of the wire, of a completed plan.
    pub end_error_lsb: Option<f64>,
    /// What the first executor counted.
    pub telemetry: Telemetry,
    /// What happened to frames.
    pub bus: BusCounts,
    /// Events that took place.
    pub events: Vec<Event>,
    /// Frames that a babbling node sent, and that a full queue did not take.
    pub babbled: u64,
    /// Frames that a full queue did not take.
    pub not_taken: u64,
    /// Length of the run, microseconds of true time.
    pub duration_us: u64,
}

/// One line of a run's log.
#[derive(Clone, Debug)]
pub enum Logged {
    /// A frame as it was sent.
    Frame(Frame),
    /// Something that happened.
    Remark(String),
}

/// A clock that runs so many parts per million faster than true time.
#[derive(Clone, Copy, Debug)]
struct Clock {
    ppm: i64,
}

impl Clock {
    fn rate(self) -> u64 {
        1_000_000_u64.saturating_add_signed(self.ppm)
    }

    fn local_us(self, true_us: u64) -> u64 {
        true_us.saturating_mul(self.rate()) / 1_000_000
    }

    /// The first moment at which the clock shows at least this.
    fn true_us(self, local_us: u64) -> u64 {
        local_us.saturating_mul(1_000_000).div_ceil(self.rate())
    }
}

struct Node<'p> {
    plan: usize,
    endpoint: Option<ExecutorEndpoint<'p>>,
    starts_at_us: Option<u64>,
    resets: bool,
    frozen_until_us: u64,
    inbox: VecDeque<Frame>,
}

/// The whole of a run.
pub struct World<'p> {
    faults: &'p Faults,
    plans: [&'p PlanReader<'p>; 2],
    dice: Dice,
    now_us: u64,
    bus: Bus,
    nodes: Vec<Node<'p>>,
    executor_clock: Clock,
    arm_clock: Clock,
    arm: ArmEndpoint,
    arm_frozen_until_us: u64,
    arm_off_until_us: Option<u64>,
    arm_inbox: VecDeque<Frame>,
    witness: Witness,
    next_event: usize,
    cut_until_us: u64,
    frozen_for_us: u64,
    full_until_us: u64,
    babble_until_us: u64,
    babble_at_us: u64,
    memory: VecDeque<Frame>,
    quiet_since_us: Option<u64>,
    log: Option<Vec<(u64, Logged)>>,
    result: RunOutcome,
}

/// Plays `plans[0]` on a simulated arm while `faults` happen; `plans[1]` is the wrong one. With the log, if it is wanted.
#[must_use]
pub fn run(
    dice: Dice,
    faults: &Faults,
    plans: [&PlanReader<'_>; 2],
    logged: bool,
) -> (RunOutcome, Vec<(u64, Logged)>) {
    let mut world = World::new(dice, faults, plans, logged);
    while !world.is_over() {
        world.step();
    }
    world.finish();
    (world.result, world.log.unwrap_or_default())
}

fn arm_config() -> ArmConfig {
    ArmConfig::ideal(motion::start())
}

impl<'p> World<'p> {
    fn new(dice: Dice, faults: &'p Faults, plans: [&'p PlanReader<'p>; 2], logged: bool) -> Self {
        let config = arm_config();
        let controller = Controller::new(config);
        let witness = Witness::new(&controller, faults.dialect.lsb(), config.limits);
        let mut world = Self {
            faults,
            plans,
            dice,
            now_us: 0,
            bus: Bus::default(),
            nodes: Vec::new(),
            executor_clock: Clock { ppm: faults.executor_ppm },
            arm_clock: Clock { ppm: faults.arm_ppm },
            arm: ArmEndpoint::new(controller, faults.dialect),
            arm_frozen_until_us: 0,
            arm_off_until_us: None,
            arm_inbox: VecDeque::new(),
            witness,
            next_event: 0,
            cut_until_us: 0,
            frozen_for_us: 0,
            full_until_us: 0,
            babble_until_us: 0,
            babble_at_us: 0,
            memory: VecDeque::new(),
            quiet_since_us: None,
            log: logged.then(Vec::new),
            result: RunOutcome {
                outcomes: Vec::new(),
                arm_fault: None,
                breaches: Vec::new(),
                worst_silence_us: 0,
                end_error_lsb: None,
                telemetry: Telemetry::default(),
                bus: BusCounts::default(),
                events: Vec::new(),
                babbled: 0,
                not_taken: 0,
                duration_us: 0,
            },
        };
        world.add_node(0, 0, false);
        world
    }

    fn add_node(&mut self, plan: usize, starts_at_us: u64, resets: bool) {
        self.nodes.push(Node {
            plan,
            endpoint: None,
            starts_at_us: Some(starts_at_us),
            resets,
            frozen_until_us: 0,
            inbox: VecDeque::new(),
        });
    }

    // --- time ---

    fn step(&mut self) {
        self.begin_events();
        self.babble();
        self.power_arm();
        while self.exchange() {}
        self.now_us = self.next_us().max(self.now_us.saturating_add(1));
    }

    fn next_us(&self) -> u64 {
        let arm_us = match self.arm_off_until_us {
            Some(until_us) => until_us,
            None => self.arm_clock.true_us(self.arm.poll_at()).max(self.arm_frozen_until_us),
        };
        let nodes = self.nodes.iter().filter_map(|node| match (&node.endpoint, node.starts_at_us) {
            (Some(endpoint), _) => {
                endpoint.poll_at().map(|at_us| self.executor_clock.true_us(at_us).max(node.frozen_until_us))
            }
            (None, starts_at_us) => starts_at_us,
        });
        let event_us = self.faults.events.get(self.next_event).map(|planned| planned.at_us);
        let babble_us = (self.babble_at_us < self.babble_until_us).then_some(self.babble_at_us);
        nodes.chain(event_us).chain(babble_us).chain(self.bus.next_us()).fold(arm_us, u64::min)
    }

    /// Everybody is gone, nothing more will happen, and the arm has been alone for longer than it may move then.
    fn is_over(&mut self) -> bool {
        let busy = self.next_event < self.faults.events.len()
            || self.nodes.iter().any(|node| node.endpoint.is_some() || node.starts_at_us.is_some())
            || self.now_us < self.babble_until_us
            || self.now_us < self.cut_until_us
            || self.arm_off_until_us.is_some()
            || self.now_us < self.arm_frozen_until_us;
        if busy {
            self.quiet_since_us = None;
            return self.now_us > LONGEST_RUN_US;
        }
        let since_us = *self.quiet_since_us.get_or_insert(self.now_us);
        let alone_us = self.now_us.saturating_sub(since_us);
        let bound_us = silence_bound_us(self.faults.period_us).saturating_mul(11) / 10;
        alone_us > bound_us || self.now_us > LONGEST_RUN_US
    }

    /// The arm's clock. At a moment that the arm waits for it shows that moment, and not the microsecond after.
    fn arm_us(&self) -> u64 {
        let local_us = self.arm_clock.local_us(self.now_us);
        let due_us = self.arm.poll_at();
        if due_us <= local_us && local_us.saturating_sub(due_us) <= 2 { due_us } else { local_us }
    }

    // --- frames ---

    /// Everybody handles what has arrived and says what there is to say; whether anything happened.
    fn exchange(&mut self) -> bool {
        let mut active = self.poll_arm();
        while let Some(arrival) = self.bus.arrival(self.now_us) {
            self.arrive(arrival);
            active = true;
        }
        for index in 0..self.nodes.len() {
            active |= self.poll_node(index);
        }
        active
    }

    fn arrive(&mut self, arrival: Arrival) {
        let Arrival { to, from, frame } = arrival;
        if self.memory.len() >= MEMORY {
            self.memory.pop_front();
        }
        self.memory.push_back(frame.clone());
        match to {
            Side::Arm if self.arm_off_until_us.is_some() => {}
            Side::Arm => {
                if self.speaks_for_session(from) {
                    let arm_us = self.arm_us();
                    self.witness.heard(arm_us);
                }
                self.arm_inbox.push_back(frame);
            }
            Side::Executors => {
                let running = self.nodes.iter_mut().filter(|node| node.endpoint.is_some());
                running.for_each(|node| node.inbox.push_back(frame.clone()));
            }
        }
    }

    fn speaks_for_session(&self, from: Option<usize>) -> bool {
        let context = self.arm.controller().context();
        let endpoint = from.and_then(|index| self.nodes.get(index)).and_then(|node| node.endpoint.as_ref());
        context != Context::NONE && endpoint.is_some_and(|endpoint| endpoint.executor().context() == context)
    }

    fn poll_arm(&mut self) -> bool {
        if self.arm_off_until_us.is_some() || self.now_us < self.arm_frozen_until_us {
            return false;
        }
        let arm_us = self.arm_us();
        let mut said = Vec::new();
        said.extend(std::iter::from_fn(|| self.arm.poll(arm_us)));
        self.look(arm_us);
        while let Some(frame) = self.arm_inbox.pop_front() {
            let arm_us = self.arm_us();
            self.arm.handle_frame(arm_us, &frame);
            said.extend(std::iter::from_fn(|| self.arm.poll(arm_us)));
            self.look(arm_us);
        }
        let active = !said.is_empty();
        for frame in said {
            self.send(self.faults.from_arm, Side::Executors, None, frame);
        }
        active
    }

    fn look(&mut self, arm_us: u64) {
        self.witness.look(self.now_us, arm_us, self.arm.controller());
        if self.result.arm_fault.is_none() {
            self.result.arm_fault = self.arm.controller().fault();
        }
    }

    fn poll_node(&mut self, index: usize) -> bool {
        self.start_node(index);
        let local_us = self.executor_clock.local_us(self.now_us);
        let now_us = self.now_us;
        let Some(node) = self.nodes.get_mut(index) else { return false };
        let Some(endpoint) = node.endpoint.as_mut().filter(|_| node.frozen_until_us <= now_us) else {
            return false;
        };
        let mut active = false;
        while let Some(frame) = node.inbox.pop_front() {
            // Whatever cannot be understood is dropped, and counted there.
            let _ = endpoint.handle_frame(local_us, &frame);
            active = true;
        }
        let action = endpoint.poll(local_us);
        let (session, sent) = (endpoint.executor().session(), endpoint.executor().last_sent());
        sent.into_iter().for_each(|setpoint| self.witness.setpoint_sent(session, setpoint));
        match action {
            FrameAction::Send(frame) => {
                if now_us < self.full_until_us && self.dice.chance(0.7) {
                    self.result.not_taken = self.result.not_taken.saturating_add(1);
                } else {
                    self.send(self.faults.to_arm, Side::Arm, Some(index), frame);
                }
                true
            }
            FrameAction::Wait => active,
            FrameAction::Finished(outcome) => {
                self.finish_node(index, Some(outcome));
                true
            }
        }
    }

    fn start_node(&mut self, index: usize) {
        let now_us = self.now_us;
        let local_us = self.executor_clock.local_us(now_us);
        let Some(node) = self.nodes.get_mut(index) else { return };
        let due = node.endpoint.is_none() && node.starts_at_us.is_some_and(|at_us| at_us <= now_us);
        let Some(plan) = self.plans.get(node.plan).filter(|_| due) else { return };
        node.starts_at_us = None;
        let session = u16::try_from(self.dice.between(1, u64::from(u16::MAX))).unwrap_or(1);
        let config = Config { session, reset: node.resets, ..Config::default() };
        node.endpoint = Some(ExecutorEndpoint::new(local_us, plan, self.faults.dialect, config));
        self.remark(format!("executor {index} starts session {session:#06x}"));
    }

    fn finish_node(&mut self, index: usize, outcome: Option<Outcome>) {
        let Some(node) = self.nodes.get_mut(index) else { return };
        let Some(endpoint) = node.endpoint.take() else { return };
        node.inbox.clear();
        let plan = self.plans.get(node.plan).copied();
        let session = endpoint.executor().session();
        let arm = self.arm.controller();
        match (outcome, plan) {
            (Some(Outcome::Completed), Some(plan)) => {
                let (end, lsb) = (plan.end_setpoint(), plan.header().lsb);
                let error = self.witness.completed(self.now_us, arm, session, end, lsb);
                self.result.end_error_lsb = Some(self.result.end_error_lsb.unwrap_or(0.0).max(error));
            }
            (Some(Outcome::Stopped { standstill: true, .. }), _) => {
                // News is as old as the wire is long, and older if nobody was there to hear it.
                let (_, delay_us) = self.faults.from_arm.delay_us;
                self.witness.said_to_stand(self.now_us, delay_us.saturating_add(self.frozen_for_us));
            }
            _ => {}
        }
        self.remark(format!("executor {index} ends: {outcome:?}"));
        if index == 0 {
            self.result.outcomes.push(outcome);
            self.result.telemetry = endpoint.executor().telemetry();
        }
    }

    fn send(&mut self, line: Line, to: Side, from: Option<usize>, frame: Frame) {
        self.log_frame(&frame);
        if self.now_us < self.cut_until_us {
            self.bus.counts.frames = self.bus.counts.frames.saturating_add(1);
            self.bus.counts.dropped = self.bus.counts.dropped.saturating_add(1);
            return;
        }
        self.bus.send(self.now_us, &mut self.dice, &line, to, from, frame);
    }

    // --- events ---

    fn begin_events(&mut self) {
        while let Some(planned) =
            self.faults.events.get(self.next_event).filter(|next| next.at_us <= self.now_us)
        {
            self.next_event = self.next_event.saturating_add(1);
            self.remark(format!("{} for {} us", planned.event.name(), planned.for_us));
            self.result.events.push(planned.event);
            self.begin(planned);
        }
    }

    fn begin(&mut self, planned: &Planned) {
        let until_us = self.now_us.saturating_add(planned.for_us);
        let local_us = self.executor_clock.local_us(self.now_us);
        match planned.event {
            Event::ExecutorFrozen => {
                self.frozen_for_us = self.frozen_for_us.saturating_add(planned.for_us);
                self.nodes.iter_mut().take(1).for_each(|node| node.frozen_until_us = until_us);
            }
            Event::ArmFrozen => {
                self.arm_frozen_until_us = until_us;
                self.witness.held_up(planned.for_us.saturating_mul(1_001) / 1_000);
            }
            Event::ExecutorRestarts => self.restart_executor(until_us, None),
            Event::WrongPlan => self.restart_executor(until_us, Some(1)),
            Event::ArmRestarts => self.arm_off_until_us = Some(until_us),
            Event::BusOff => {
                self.cut_until_us = until_us;
                self.with_executor(|endpoint| endpoint.executor_mut().handle_link_lost(local_us));
            }
            Event::WireCut => self.cut_until_us = until_us,
            Event::QueueFull => self.full_until_us = until_us,
            Event::Babble => {
                self.babble_until_us = until_us;
                self.babble_at_us = self.now_us;
            }
            Event::ForeignSession => {
                let resets = self.dice.chance(0.3);
                self.add_node(1, self.now_us, resets);
            }
            Event::OperatorStop => {
                self.with_executor(|endpoint| endpoint.executor_mut().handle_stop(local_us))
            }
            Event::HardStop => {
                self.with_executor(|endpoint| endpoint.executor_mut().handle_hard_stop(local_us))
            }
            Event::StopFrame => {
                let frames = Encoder::new(self.faults.dialect).to_arm(&Context::NONE, &ToArm::Stop);
                frames.for_each(|frame| self.send(self.faults.to_arm, Side::Arm, None, frame));
            }
        }
    }

    /// The first executor's state machine, unless its process does not run.
    fn with_executor(&mut self, act: impl Fn(&mut ExecutorEndpoint<'p>)) {
        let now_us = self.now_us;
        let first = self.nodes.first_mut().filter(|node| node.frozen_until_us <= now_us);
        first.and_then(|node| node.endpoint.as_mut()).into_iter().for_each(act);
    }

    fn restart_executor(&mut self, at_us: u64, plan: Option<usize>) {
        self.finish_node(0, None);
        let resets = self.dice.chance(0.5);
        let Some(node) = self.nodes.first_mut() else { return };
        node.starts_at_us = Some(at_us);
        node.resets = resets;
        node.plan = plan.unwrap_or(node.plan);
    }

    /// Without power the arm falls into its brakes; with it, another controller starts.
    fn power_arm(&mut self) {
        let Some(until_us) = self.arm_off_until_us else { return };
        self.arm_inbox.clear();
        if until_us > self.now_us {
            return;
        }
        self.arm_off_until_us = None;
        let pose = self.arm.controller().pose();
        let nonce_seed = self.dice.number();
        let mut controller = Controller::new(ArmConfig { nonce_seed, ..ArmConfig::ideal(pose) });
        // Whatever its clock shows, nothing has happened yet.
        controller.let_pass(self.arm_clock.local_us(self.now_us));
        self.arm = ArmEndpoint::new(controller, self.faults.dialect);
        self.witness.restarted(self.arm.controller());
    }

    fn babble(&mut self) {
        if self.babble_at_us > self.now_us || self.now_us >= self.babble_until_us {
            return;
        }
        self.babble_at_us = self.now_us.saturating_add(self.dice.between(50, 1_000));
        self.result.babbled = self.result.babbled.saturating_add(1);
        let frame = self.rubbish();
        let to = if self.dice.chance(0.5) { Side::Arm } else { Side::Executors };
        self.send(Line::default(), to, None, frame);
    }

    /// A frame heard before, or one with a known identifier and any content. A stop frame is not rubbish.
    fn rubbish(&mut self) -> Frame {
        let count = u64::try_from(self.memory.len()).unwrap_or(0);
        if count > 0 && self.dice.chance(0.5) {
            let index = usize::try_from(self.dice.between(0, count.saturating_sub(1))).unwrap_or(0);
            return self.memory.get(index).cloned().unwrap_or_else(|| self.noise());
        }
        self.noise()
    }

    fn noise(&mut self) -> Frame {
        const IDS: [u16; 11] = [0x081, 0x181, 0x201, 0x301, 0x401, 0x281, 0x381, 0x581, 0x601, 0x701, 0x77F];
        let id = self.dice.pick(&IDS);
        let lengths: &[usize] = match self.faults.dialect {
            Dialect::Classic => &[0, 4, 5, 8, 8, 8],
            Dialect::Fd => &[0, 8, 12, 16, 20, 48, 64],
        };
        let length = self.dice.pick(lengths);
        let data = (0..length).map(|_| self.dice.number().to_le_bytes()[0]).collect();
        Frame { id, data }
    }

    fn log_frame(&mut self, frame: &Frame) {
        if let Some(log) = &mut self.log {
            log.push((self.now_us, Logged::Frame(frame.clone())));
        }
    }

    fn remark(&mut self, text: String) {
        if let Some(log) = &mut self.log {
            log.push((self.now_us, Logged::Remark(text)));
        }
    }

    // --- the end ---

    fn finish(&mut self) {
        if self.now_us > LONGEST_RUN_US {
            self.witness.breach(self.now_us, String::from("the run never ends"));
        }
        self.witness.over(self.now_us, self.arm.controller());
        if self.faults.is_gentle() && self.result.outcomes != [Some(Outcome::Completed)] {
            let what = format!("nothing went wrong, but the session ended with {:?}", self.result.outcomes);
            self.witness.breach(self.now_us, what);
        }
        self.find_way_out();
        self.result.duration_us = self.now_us;
        self.result.bus = self.bus.counts;
        self.result.worst_silence_us = self.witness.worst_silence_us;
        self.result.breaches = std::mem::take(&mut self.witness.breaches);
        for breach in self.result.breaches.clone() {
            self.remark(format!("BREACH at {} us: {}", breach.at_us, breach.what));
        }
    }

    /// Whatever has happened: over a wire in order, a person can reset the arm, and it performs a plan again.
    fn find_way_out(&mut self) {
        self.bus.clear();
        let mut arm_us = self.arm_us();
        let stay = motion::Move { translation_m: [0.0; 3], rotation_rad: [0.0; 3], steps: 3 };
        let bytes = motion::plan_bytes(
            &self.arm.controller().pose(),
            motion::limits(),
            self.faults.period_us,
            &[stay],
        );
        let Ok(plan) = PlanReader::new(&bytes) else { return };
        let session = u16::try_from(self.dice.between(1, u64::from(u16::MAX))).unwrap_or(1);
        let config = Config { session, reset: true, ..Config::default() };
        let mut executor = ExecutorEndpoint::new(arm_us, &plan, self.faults.dialect, config);
        let until_us = arm_us.saturating_add(LONGEST_RUN_US);
        let outcome = loop {
            if arm_us > until_us {
                let what = String::from("after a reset the arm plays for ever");
                return self.witness.breach(self.now_us, what);
            }
            while let Some(frame) = self.arm.poll(arm_us) {
                self.log_frame(&frame);
                let _ = executor.handle_frame(arm_us, &frame);
            }
            match executor.poll(arm_us) {
                FrameAction::Send(frame) => {
                    self.log_frame(&frame);
                    self.arm.handle_frame(arm_us, &frame);
                }
                FrameAction::Finished(outcome) => break outcome,
                FrameAction::Wait => {
                    let next_us = executor.poll_at().map_or(arm_us, |at_us| at_us.min(self.arm.poll_at()));
                    arm_us = next_us.max(arm_us.saturating_add(1));
                }
            }
        };
        if outcome != Outcome::Completed {
            self.witness.breach(self.now_us, format!("after a reset the arm does not play: {outcome:?}"));
        }
    }
}
