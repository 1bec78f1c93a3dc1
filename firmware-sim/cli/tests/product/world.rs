//! The product: one arm, up to two executors, and what is on its way between them.
//!
//! What a machine says at one moment is a burst. A burst is delivered, lost, delivered twice and overtaken as a whole, or
//! with one of its messages lost, or last message first.

mod laws;

use std::collections::VecDeque;
use std::fmt::Debug;
use std::hash::{DefaultHasher, Hash, Hasher};
use std::sync::Arc;

use powderline_executor::{Action, Config, Executor, Outcome};
use powderline_firmware_sim::controller::{ArmConfig, Controller, DEFAULT_WATCHDOG_US};
use powderline_firmware_sim_cli::link::motion::{self, Move};
use powderline_shared::displacement::Axis;
use powderline_shared::fault::FaultCode;
use powderline_shared::plan::PlanReader;
use powderline_shared::pose::Pose;
use powderline_shared::wire::message::{FromArm, NO_SESSION, ToArm};
use powderline_shared::wire::state::{Command, State};

use crate::projection::{Present, field, hash_of};
use laws::Look;

/// Bursts under way in each direction; the oldest is lost if there is one more.
const UNDER_WAY: usize = 3;

/// Executors that there may be in a run, those that have ended counted.
const MOST_STARTED: u8 = 3;

/// When executors give up a handshake, microseconds.
const HANDSHAKE_US: u64 = 600_000;

/// Setpoints ahead of the arm's clock.
const LOOK_AHEAD: u16 = 4;

/// The two plans, which lead from the same start along different axes.
pub(crate) struct Scene {
    plans: [Vec<u8>; 2],
    period_us: u32,
}

/// Axis along which each plan leads.
const AXES: [Axis; 2] = [Axis::X, Axis::Y];

impl Scene {
    /// Plans of so many steps, each of so many microseconds. Time goes on in halves of a step. They are fast enough that an arm
    /// which was held up is still braking when its controller wakes up.
    pub(crate) fn new(period_us: u32, steps: u32) -> Self {
        let plans = [[0.008, 0.0, 0.0], [0.0, 0.008, 0.0]].map(|translation_m| {
            let part = Move { translation_m, rotation_rad: [0.0; 3], steps };
            motion::plan_bytes(&motion::start(), motion::limits(), period_us, &[part])
        });
        Self { plans, period_us }
    }

    /// The plan of a slot.
    fn plan(&self, slot: usize) -> PlanReader<'_> {
        PlanReader::new(&self.plans[slot]).expect("a plan of our own")
    }

    fn present(&self, now_us: u64) -> Present {
        Present { now_us, grid_us: u64::from(self.period_us) / 2, horizon_us: HANDSHAKE_US }
    }
}

/// Session number that the executor of a slot begins with. One that is started again takes the same.
fn session_of(slot: usize) -> u16 {
    [0x0100, 0x0200][slot]
}

/// The slot whose executor a session is; one that the arm knows to be over takes the next number.
fn slot_of(session: u16) -> Option<usize> {
    (0..2).find(|slot| (session_of(*slot)..session_of(*slot) + 0x100).contains(&session))
}

/// Something that happens.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Step {
    /// The oldest burst on its way to the arm arrives.
    ToArm(Manner),
    /// The oldest burst on its way from the arm arrives at all executors.
    FromArm(Manner),
    /// The oldest burst on its way to the arm is overtaken by the next.
    ToArmOvertaken,
    /// The oldest burst on its way from the arm is overtaken by the next.
    FromArmOvertaken,
    /// A broken node repeats what an executor has said before, the one of this number.
    Replay(u8),
    /// Time goes on to the next deadline of anybody.
    Time,
    /// A watchdog time goes by in which the wire carries nothing.
    WireCut,
    /// A watchdog time goes by in which no executor runs.
    ExecutorsFrozen,
    /// So many periods go by in which the arm's controller does not run.
    ArmFrozen(u8),
    /// An executor dies.
    Kill(usize),
    /// An executor starts.
    Start {
        /// Which.
        slot: usize,
        /// Whether it resets an arm that is latched.
        reset: bool,
    },
    /// A third node commands without a session.
    Stranger(Command),
    /// A third node sends the stop frame.
    StopFrame,
    /// A person stops the executor's motion.
    Stop(usize),
    /// A person stops it as fast as the arm can.
    HardStop(usize),
    /// An executor is told that the wire is gone.
    LinkLost(usize),
}

/// How a burst arrives.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Manner {
    /// As it was sent.
    Whole,
    /// Not at all.
    Lost,
    /// Without its message of this number.
    Without(u8),
    /// Last message first.
    Backwards,
    /// And once more later.
    Twice,
}

/// What a machine has said at a moment, and the hash of it.
#[derive(Clone, Debug)]
struct Burst<T> {
    messages: Vec<T>,
    hash: u64,
}

/// A machine, if it runs, and the hash of its projection.
#[derive(Clone)]
struct Part<M> {
    machine: Option<Arc<M>>,
    hash: u64,
    /// Whether anything has happened to it since it was hashed.
    touched: bool,
}

impl<M: Clone + Debug> Part<M> {
    fn running(machine: M) -> Self {
        Self { machine: Some(Arc::new(machine)), hash: 0, touched: true }
    }

    fn gone() -> Self {
        Self { machine: None, hash: 0, touched: false }
    }

    fn touch(&mut self) -> Option<&mut M> {
        self.touched = self.machine.is_some();
        self.machine.as_mut().map(Arc::make_mut)
    }

    fn settle(&mut self, present: &Present) {
        if self.touched {
            self.hash = self.machine.as_ref().map_or(0, |machine| hash_of(&**machine, present));
            self.touched = false;
        }
    }
}

/// A state of the product.
#[derive(Clone)]
pub(crate) struct World<'p> {
    scene: &'p Scene,
    now_us: u64,
    arm: Part<Controller>,
    nodes: [Part<Executor<'p>>; 2],
    to_arm: VecDeque<Arc<Burst<ToArm>>>,
    from_arm: VecDeque<Arc<Burst<FromArm>>>,
    started: u8,
    /// Everything that executors have said, but heartbeats, once.
    said: Arc<Vec<ToArm>>,
    /// The session that was enabled last, and where.
    anchored: Option<(u16, Pose)>,
    /// Sessions that are over, where they were anchored, and where they left the arm: their end may hear of it late.
    left: Vec<(u16, Pose, Pose)>,
    /// Sessions whose executor has said, at its end, that the arm stands.
    at_rest: Vec<u16>,
    /// Not part of the state: what came of the step that led here.
    pub(crate) report: Report,
}

/// What came of a step.
#[derive(Clone, Debug, Default)]
pub(crate) struct Report {
    /// What may never happen, and did.
    pub(crate) breaches: Vec<String>,
    /// How executors ended.
    pub(crate) endings: Vec<Outcome>,
}

impl<'p> World<'p> {
    /// The arm has power, the first executor is about to open its session.
    pub(crate) fn new(scene: &'p Scene) -> Self {
        let arm = Controller::new(ArmConfig::ideal(motion::start()));
        let mut world = Self {
            scene,
            now_us: 0,
            arm: Part::running(arm),
            nodes: [Part::gone(), Part::gone()],
            to_arm: VecDeque::new(),
            from_arm: VecDeque::new(),
            started: 0,
            said: Arc::default(),
            anchored: None,
            left: Vec::new(),
            at_rest: Vec::new(),
            report: Report::default(),
        };
        world.start(0, false);
        world.settle();
        world
    }

    /// Everything that counts.
    pub(crate) fn hash(&self) -> u64 {
        let mut hasher = DefaultHasher::new();
        (self.arm.hash, self.started, self.said.len(), &self.at_rest).hash(&mut hasher);
        self.nodes.iter().for_each(|node| node.hash.hash(&mut hasher));
        self.to_arm.iter().for_each(|burst| burst.hash.hash(&mut hasher));
        hasher.write_u8(0);
        for burst in &self.from_arm {
            burst.hash.hash(&mut hasher);
            self.news(burst).for_each(|news| news.hash(&mut hasher));
        }
        hasher.finish()
    }

    /// For each report under way and each executor, whether the executor will take it for news.
    fn news<'a>(&'a self, burst: &'a Burst<FromArm>) -> impl Iterator<Item = bool> + 'a {
        let counters = burst.messages.iter().filter_map(|message| match message {
            FromArm::Status(status) => Some(status.counter),
            _ => None,
        });
        counters.flat_map(|counter| {
            self.executors().map(move |(_, executor)| {
                let known = executor.session_status();
                known.is_none_or(|known| (1..128).contains(&counter.wrapping_sub(known.counter)))
            })
        })
    }

    /// The hash of the arm alone, and what it is doing.
    pub(crate) fn arm_in_short(&self) -> (u64, State, Option<FaultCode>) {
        (self.arm.hash, self.arm().state(), self.arm().fault().map(|fault| fault.code))
    }

    /// The slot and the hash of each executor that runs.
    pub(crate) fn executor_hashes(&self) -> impl Iterator<Item = (usize, u64)> {
        self.executors().map(|(slot, _)| (slot, self.nodes[slot].hash))
    }

    /// Stage of the executor of a slot.
    pub(crate) fn stage(&self, slot: usize) -> String {
        let text = self.nodes[slot].machine.as_ref().map(|executor| format!("{executor:?}"));
        text.as_deref().and_then(|text| field(text, "stage")).map(String::from).unwrap_or_default()
    }

    fn arm(&self) -> &Controller {
        self.arm.machine.as_deref().expect("the arm always has power")
    }

    fn executors(&self) -> impl Iterator<Item = (usize, &Executor<'p>)> {
        self.nodes.iter().enumerate().filter_map(|(slot, node)| Some((slot, node.machine.as_deref()?)))
    }

    /// For a path: the arm, the executors, what is under way.
    pub(crate) fn describe(&self) -> String {
        let status = self.arm().status();
        let executors = self.executors().map(|(slot, _)| format!(", executor {slot} {}", self.stage(slot)));
        let to_arm = self.to_arm.iter().map(|burst| in_short(&burst.messages));
        let from_arm = self.from_arm.iter().map(|burst| in_short(&burst.messages));
        format!(
            "{:>9} us  {} {}, session {:#06x}, tick {}, have {:#b}, {:?}{}\n{:14}to arm {}; from arm {}",
            self.now_us,
            status.state.name(),
            if status.standstill { "(stands)" } else { "(moves)" },
            status.session,
            status.applied_tick,
            status.have,
            self.arm().fault().map(|fault| fault.code),
            executors.collect::<String>(),
            "",
            to_arm.collect::<Vec<_>>().join(" "),
            from_arm.collect::<Vec<_>>().join(" "),
        )
    }

    // --- what may happen ---

    /// What happens on a wire in order, with nobody interfering: each burst arrives, in any order of the two directions,
    /// and time goes on when there is none.
    pub(crate) fn regular_steps(&self) -> Vec<Step> {
        let to_arm = (!self.to_arm.is_empty()).then_some(Step::ToArm(Manner::Whole));
        let from_arm = (!self.from_arm.is_empty()).then_some(Step::FromArm(Manner::Whole));
        let time = (to_arm.is_none() && from_arm.is_none()).then_some(Step::Time);
        [to_arm, from_arm, time].into_iter().flatten().collect()
    }

    /// What else a wire may do.
    pub(crate) fn wire_deviations(&self) -> Vec<Step> {
        let mut steps = Vec::new();
        if !(self.to_arm.is_empty() && self.from_arm.is_empty()) {
            steps.push(Step::Time);
        }
        steps.extend(manners(&self.to_arm).into_iter().map(Step::ToArm));
        steps.extend(manners(&self.from_arm).into_iter().map(Step::FromArm));
        steps.extend((self.to_arm.len() > 1).then_some(Step::ToArmOvertaken));
        steps.extend((self.from_arm.len() > 1).then_some(Step::FromArmOvertaken));
        steps
    }

    /// What people, processes and other nodes may do.
    pub(crate) fn interferences(&self) -> Vec<Step> {
        let mut steps = vec![Step::WireCut, Step::ArmFrozen(2), Step::ArmFrozen(4), Step::StopFrame];
        steps.extend(Command::ALL.map(Step::Stranger));
        steps.extend((0..).zip(self.said.iter()).map(|(number, _)| Step::Replay(number)));
        for (slot, _) in self.executors() {
            steps.extend([Step::Kill(slot), Step::Stop(slot), Step::HardStop(slot), Step::LinkLost(slot)]);
        }
        steps.extend(self.executors().next().map(|_| Step::ExecutorsFrozen));
        if self.started < MOST_STARTED {
            let free = (0..2).filter(|slot| self.nodes[*slot].machine.is_none());
            steps.extend(free.flat_map(|slot| [false, true].map(|reset| Step::Start { slot, reset })));
        }
        steps
    }

    /// The state after a step.
    pub(crate) fn after(&self, step: Step) -> Self {
        let mut next = Self { report: Report::default(), ..self.clone() };
        match step {
            Step::ToArm(manner) => {
                for message in arrived(&mut next.to_arm, manner) {
                    next.tell_arm(&message);
                }
            }
            Step::FromArm(manner) => {
                for message in arrived(&mut next.from_arm, manner) {
                    next.tell_executors(&message);
                }
            }
            Step::ToArmOvertaken => next.to_arm.swap(0, 1),
            Step::FromArmOvertaken => next.from_arm.swap(0, 1),
            Step::Replay(number) => {
                let message = next.said.get(usize::from(number)).copied();
                message.into_iter().for_each(|message| next.tell_arm(&message));
            }
            Step::Time => next.pass_time(next.next_us()),
            Step::WireCut => next.cut_wire(DEFAULT_WATCHDOG_US),
            Step::ExecutorsFrozen => next.freeze_executors(DEFAULT_WATCHDOG_US),
            Step::ArmFrozen(periods) => next.freeze_arm(u64::from(periods) * u64::from(self.scene.period_us)),
            Step::Kill(slot) => next.nodes[slot] = Part::gone(),
            Step::Start { slot, reset } => next.start(slot, reset),
            Step::Stranger(command) => next.tell_arm(&ToArm::Control { session: NO_SESSION, command }),
            Step::StopFrame => next.tell_arm(&ToArm::Stop),
            Step::Stop(slot) => next.with_executor(slot, |executor, now_us| executor.handle_stop(now_us)),
            Step::HardStop(slot) => {
                next.with_executor(slot, |executor, now_us| executor.handle_hard_stop(now_us));
            }
            Step::LinkLost(slot) => {
                next.with_executor(slot, |executor, now_us| executor.handle_link_lost(now_us));
            }
        }
        next.settle();
        next
    }

    fn start(&mut self, slot: usize, reset: bool) {
        // So few setpoints ahead that the arm starts before it has the whole plan, and may miss the rest.
        let config = Config {
            session: session_of(slot),
            reset,
            handshake_us: HANDSHAKE_US,
            look_ahead: LOOK_AHEAD,
            ..Config::default()
        };
        // What the one before has said about the session binds the next no more.
        self.at_rest.retain(|session| slot_of(*session) != Some(slot));
        self.nodes[slot] = Part::running(Executor::new(self.now_us, &self.scene.plan(slot), config));
        self.started += 1;
    }

    // --- time ---

    /// The next deadline of anybody, on the grid.
    fn next_us(&self) -> u64 {
        let executors = self.executors().filter_map(|(_, executor)| executor.poll_at());
        let grid_us = u64::from(self.scene.period_us) / 2;
        let next_us = executors.fold(self.arm().poll_at(), u64::min).max(self.now_us + 1);
        next_us.div_ceil(grid_us) * grid_us
    }

    fn pass_time(&mut self, until_us: u64) {
        self.now_us = until_us;
        self.nodes.iter_mut().for_each(|node| node.touched = node.machine.is_some());
        self.with_arm(None, |arm, now_us| arm.let_pass(now_us));
    }

    fn cut_wire(&mut self, for_us: u64) {
        let until_us = self.now_us + for_us;
        while self.now_us < until_us {
            self.pass_time(self.next_us().min(until_us));
            self.settle();
            self.to_arm.clear();
            self.from_arm.clear();
        }
    }

    fn freeze_executors(&mut self, for_us: u64) {
        let until_us = self.now_us + for_us;
        while self.now_us < until_us {
            self.pass_time(self.next_us().min(until_us));
            self.poll_arm();
        }
    }

    fn freeze_arm(&mut self, for_us: u64) {
        let until_us = self.now_us + for_us;
        while self.now_us < until_us {
            self.now_us = self.next_us().min(until_us);
            self.nodes.iter_mut().for_each(|node| node.touched = node.machine.is_some());
            self.poll_executors();
        }
        self.pass_time(until_us);
    }

    // --- the machines ---

    fn tell_arm(&mut self, message: &ToArm) {
        self.with_arm(Some(message), |arm, now_us| arm.handle_message(now_us, message));
    }

    fn tell_executors(&mut self, message: &FromArm) {
        for slot in 0..self.nodes.len() {
            self.with_executor(slot, |executor, now_us| executor.handle_message(now_us, message));
        }
    }

    fn with_executor(&mut self, slot: usize, act: impl Fn(&mut Executor<'p>, u64)) {
        let now_us = self.now_us;
        self.nodes[slot].touch().into_iter().for_each(|executor| act(executor, now_us));
    }

    fn with_arm(&mut self, message: Option<&ToArm>, act: impl Fn(&mut Controller, u64)) {
        let (now_us, before) = (self.now_us, Look::at(self.arm()));
        self.arm.touch().into_iter().for_each(|arm| act(arm, now_us));
        self.watch(&before, message);
    }

    /// Everybody to whom something has happened says what there is to say.
    fn settle(&mut self) {
        self.poll_arm();
        self.poll_executors();
        let present = self.scene.present(self.now_us);
        self.arm.settle(&present);
        self.nodes.iter_mut().for_each(|node| node.settle(&present));
    }

    fn poll_arm(&mut self) {
        let now_us = self.now_us;
        let Some(arm) = self.arm.machine.as_mut().filter(|_| self.arm.touched) else { return };
        let arm = Arc::make_mut(arm);
        let said = std::iter::from_fn(|| arm.poll(now_us)).collect();
        self.from_arm.extend(self.burst(said));
        overflow(&mut self.from_arm);
    }

    fn poll_executors(&mut self) {
        for slot in 0..self.nodes.len() {
            if self.nodes[slot].touched {
                self.poll_executor(slot);
            }
        }
    }

    fn poll_executor(&mut self, slot: usize) {
        let now_us = self.now_us;
        let Some(executor) = self.nodes[slot].touch() else { return };
        let mut said = Vec::new();
        let ending = loop {
            match executor.poll(now_us) {
                Action::Send(message) => said.push(message),
                Action::Wait => break None,
                Action::Finished(outcome) => break Some((executor.session(), outcome)),
            }
        };
        let restless = ending.is_none() && executor.poll_at().is_none_or(|at_us| at_us <= now_us);
        if restless {
            self.breach(format!("executor {slot} waits for a moment that has passed"));
        }
        self.remember(&said);
        self.to_arm.extend(self.burst(said));
        overflow(&mut self.to_arm);
        if let Some((session, outcome)) = ending {
            self.nodes[slot] = Part::gone();
            self.report.endings.push(outcome);
            self.watch_ending(slot, session, outcome);
        }
    }

    fn remember(&mut self, said: &[ToArm]) {
        for message in said {
            let heartbeat = matches!(message, ToArm::Heartbeat { .. });
            if !heartbeat && !self.said.contains(message) {
                Arc::make_mut(&mut self.said).push(*message);
            }
        }
    }

    fn burst<T: Debug>(&self, messages: Vec<T>) -> Option<Arc<Burst<T>>> {
        let hash = hash_of(&messages, &self.scene.present(0));
        (!messages.is_empty()).then(|| Arc::new(Burst { messages, hash }))
    }
}

/// What was said, with the numbers that tell one message from another.
fn in_short<T: Debug>(messages: &[T]) -> String {
    let short = messages.iter().map(|message| {
        let text = format!("{message:?}");
        let name = text.split([' ', '(']).next().unwrap_or_default();
        let tells = ["command", "tick", "session", "state", "counter"];
        let told = tells.iter().filter_map(|tell| Some(format!(" {}", field(&text, tell)?)));
        format!("{name}{}", told.collect::<String>())
    });
    format!("[{}]", short.collect::<Vec<_>>().join(", "))
}

fn overflow<T>(queue: &mut VecDeque<T>) {
    while queue.len() > UNDER_WAY {
        queue.pop_front();
    }
}

/// In what other manners the oldest burst may arrive.
fn manners<T>(queue: &VecDeque<Arc<Burst<T>>>) -> Vec<Manner> {
    let Some(oldest) = queue.front() else { return Vec::new() };
    let mut manners = vec![Manner::Lost, Manner::Twice];
    if oldest.messages.len() > 1 {
        let last = u8::try_from(oldest.messages.len()).unwrap_or(u8::MAX);
        manners.push(Manner::Backwards);
        manners.extend((0..last).map(Manner::Without));
    }
    manners
}

/// Takes what arrives off a queue.
fn arrived<T: Clone>(queue: &mut VecDeque<Arc<Burst<T>>>, manner: Manner) -> Vec<T> {
    let Some(burst) = queue.pop_front() else { return Vec::new() };
    let all = burst.messages.iter().cloned();
    match manner {
        Manner::Whole => all.collect(),
        Manner::Lost => Vec::new(),
        Manner::Without(missing) => {
            (0..).zip(all).filter(|(number, _)| *number != missing).map(|(_, message)| message).collect()
        }
        Manner::Backwards => all.rev().collect(),
        Manner::Twice => {
            queue.push_back(Arc::clone(&burst));
            all.collect()
        }
    }
}
