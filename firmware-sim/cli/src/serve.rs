//! The simulated arm at the end of a wire.

use std::collections::VecDeque;
use std::io;

use anyhow::Context as _;
use powderline_firmware_sim::controller::{ArmConfig, Controller, Tick};
use powderline_firmware_sim::endpoint::Endpoint;
use powderline_host::clock;
use powderline_host::link::Link;
use powderline_host::signals::{Signals, StopWish};
use powderline_host::transport::{self, BUSY_US, Incoming, LinkError, Sent, Transport};
use powderline_host::wait::wait_until;
use powderline_shared::fault::Fault;
use powderline_shared::plan::StartPose;
use powderline_shared::pose::Pose;
use powderline_shared::trajectory::MAX_TICK;
use powderline_shared::wire::Context;
use powderline_shared::wire::frame::Frame;
use powderline_shared::wire::message::{Refusal, ToArm};
use powderline_shared::wire::state::{Phase, State};

/// Frames that wait for room on the wire; the oldest give way, for the newest say more.
const QUEUE: usize = 64;

/// Frames that are taken in before what is due is done.
const MOST_RECEIVED: u32 = 256;

/// How long to go on after the last session, microseconds: some heartbeats.
const LINGER_US: u64 = 500_000;

/// Time between two attempts to open a wire that has failed, microseconds.
const REOPEN_US: u64 = 250_000;

/// Where the scene `bench` begins; the end-to-end tests hold the two together.
#[must_use]
pub fn bench_start() -> Pose {
    let (sine, cosine) = (START_PITCH_RAD / 2.0).sin_cos();
    let orientation_wxyz = [cosine, 0.0, sine, 0.0];
    StartPose { position_m: [0.0455, 0.048, 0.066], orientation_wxyz }.pose()
}

const START_PITCH_RAD: f64 = 80.0 / 180.0 * std::f64::consts::PI;

/// What to serve, and how.
#[derive(Debug)]
pub struct Options {
    /// The wire.
    pub on: Link,
    /// The arm.
    pub arm: ArmConfig,
    /// Whether to end with the first session that has moved the arm.
    pub once: bool,
}

/// What a person gets told while the arm is served.
pub trait Announcer {
    /// One line.
    fn say(&mut self, line: &str);
    /// A motion is over: the name of its plan, its period, and the pose at each tick, the anchor first.
    ///
    /// # Errors
    /// If it cannot be written down.
    fn executed(&mut self, plan_hash: u64, period_us: u32, poses: &[Pose]) -> anyhow::Result<()>;
}

/// Serves until a person ends it.
///
/// # Errors
/// If the wire cannot be opened, or something cannot be written.
pub fn serve(options: &Options, announcer: &mut impl Announcer) -> anyhow::Result<()> {
    let wire =
        transport::open(&options.on)?.context("firmware-sim needs a wire: can, canfd, serial or pty")?;
    let signals = Signals::install().context("Ctrl-C cannot be caught")?;
    let controller = Controller::new(options.arm);
    let endpoint = Endpoint::new(controller, wire.dialect());
    let position = endpoint.controller().pose().position_m;
    let to =
        wire.other_end().map_or_else(|| options.on.to_string(), |path| format!("serial:{}", path.display()));
    announcer.say(&format!(
        "The arm stands at ({:.4}, {:.4}, {:.4}) m and listens on {to}; Ctrl-C ends it.",
        position.x, position.y, position.z
    ));
    if options.arm.key.is_some() {
        announcer.say("It moves only for whoever has the key; a stop frame is anybody's.");
    }
    let mut server = Server {
        options,
        wire: Some(wire),
        reopen_at_us: 0,
        signals,
        endpoint,
        queue: VecDeque::new(),
        busy: false,
        is_flooded: false,
        told: Told::default(),
        motions: Vec::new(),
        wish: StopWish::None,
        start_us: clock::now_us(),
        passed_us: 0,
        done_since_us: None,
    };
    server.run(announcer)
}

/// What has been said already.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Told {
    state: Option<State>,
    phase: Option<Phase>,
    session: Option<Opening>,
    fault: Option<Fault>,
    /// What was refused because of the key.
    key_refusal: Option<(u16, Refusal)>,
}

/// A session as it was opened.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Opening {
    session: u16,
    plan_hash: u64,
    context: Context,
}

/// What the arm has made of a session. It keeps whose it is: that session may be over, and another one open, before anybody
/// is told.
struct Executed {
    context: Context,
    plan_hash: u64,
    period_us: u32,
    /// Where the arm was at each tick, the anchor first.
    poses: Vec<Pose>,
}

struct Server<'o> {
    options: &'o Options,
    wire: Option<Box<dyn Transport>>,
    reopen_at_us: u64,
    signals: Signals,
    endpoint: Endpoint,
    queue: VecDeque<Frame>,
    /// Whether the wire had no room the last time.
    busy: bool,
    /// Whether there is more to be taken in than one turn does.
    is_flooded: bool,
    told: Told,
    /// Those that nobody has been told of yet; the last one may be under way.
    motions: Vec<Executed>,
    wish: StopWish,
    /// The arm's clock begins here.
    start_us: u64,
    /// Up to when time has passed for the arm.
    passed_us: u64,
    /// Since when there has been nothing more to do.
    done_since_us: Option<u64>,
}

impl Server<'_> {
    fn run(&mut self, announcer: &mut impl Announcer) -> anyhow::Result<()> {
        loop {
            let result = self.exchange();
            self.mind_wire(result, announcer);
            self.tell(announcer)?;
            if self.is_over() {
                // A motion that a person has ended is told of, too.
                return self.tell(announcer);
            }
            self.wait().context("waiting failed")?;
        }
    }

    fn now_us(&self) -> u64 {
        clock::now_us().saturating_sub(self.start_us)
    }

    /// Takes in what has arrived, hands out what there is to say.
    fn exchange(&mut self) -> Result<(), LinkError> {
        let Some(mut wire) = self.wire.take() else {
            self.is_flooded = false;
            self.passed_us = self.now_us();
            self.collect(self.passed_us);
            self.queue.clear();
            return Ok(());
        };
        let result = self.exchange_on(wire.as_mut());
        self.wire = Some(wire);
        result
    }

    fn exchange_on(&mut self, wire: &mut dyn Transport) -> Result<(), LinkError> {
        // In the order and at the moments of arrival, as far as they are known: should this process have been held up, the
        // arm hears everything in time all the same.
        // Whoever floods the wire does not keep the arm from its own time, nor from a person's wish.
        self.is_flooded = true;
        for _ in 0..MOST_RECEIVED {
            let Some(received) = wire.receive()? else {
                self.is_flooded = false;
                break;
            };
            if let Incoming::Frame(frame) = received.what {
                let arrived_us =
                    received.at_us.saturating_sub(self.start_us).clamp(self.passed_us, self.now_us());
                self.passed_us = arrived_us;
                self.endpoint.handle_frame(arrived_us, &frame);
                self.collect(arrived_us);
            }
        }
        self.passed_us = self.now_us();
        self.collect(self.passed_us);
        self.busy = false;
        while let Some(frame) = self.queue.front() {
            if wire.send(frame)? == Sent::Busy {
                self.busy = true;
                break;
            }
            self.queue.pop_front();
        }
        Ok(())
    }

    /// Whatever the arm says now. What it does must not wait for room on the wire.
    fn collect(&mut self, now_us: u64) {
        while let Some(frame) = self.endpoint.poll(now_us) {
            if self.queue.len() >= QUEUE {
                self.queue.pop_front();
            }
            self.queue.push_back(frame);
        }
        for Tick { context, plan_hash, period_us, pose, .. } in self.endpoint.controller_mut().take_ticks() {
            // In each session there is one motion at the most.
            match self.motions.last_mut() {
                // No reader takes more.
                Some(motion) if motion.context == context && motion.poses.len() > MAX_TICK as usize => {}
                Some(motion) if motion.context == context => motion.poses.push(pose),
                _ => self.motions.push(Executed { context, plan_hash, period_us, poses: vec![pose] }),
            }
        }
    }

    /// A wire that fails is no reason for the arm to end: it stops by itself, and the wire is opened anew.
    fn mind_wire(&mut self, result: Result<(), LinkError>, announcer: &mut impl Announcer) {
        if let Err(error) = result {
            announcer.say(&format!("The wire failed: {error}."));
            self.wire = None;
            self.reopen_at_us = self.now_us().saturating_add(REOPEN_US);
        }
        if self.wire.is_some() || self.now_us() < self.reopen_at_us {
            return;
        }
        match transport::open(&self.options.on) {
            Ok(wire) => {
                self.wire = wire;
                announcer.say("The wire is there again.");
            }
            Err(_) => self.reopen_at_us = self.now_us().saturating_add(REOPEN_US),
        }
    }

    /// Says what has changed, and writes down motions that have come to their end.
    fn tell(&mut self, announcer: &mut impl Announcer) -> anyhow::Result<()> {
        let controller = self.endpoint.controller();
        let status = controller.status();
        let now = Told {
            state: Some(status.state),
            phase: status.phase,
            session: controller.request().map(|request| Opening {
                session: request.session,
                plan_hash: request.plan_hash,
                context: controller.context(),
            }),
            fault: controller.fault(),
            key_refusal: controller.key_refusal(),
        };
        let (before, period_us) = (self.told, controller.period_us());
        self.told = now;
        if let Some(opening) = now.session.filter(|_| before.session != now.session) {
            let (session, hash) = (opening.session, opening.plan_hash);
            announcer.say(&format!("Session {session:#06x}: plan {hash:016x}, {period_us} us a tick."));
        }
        if let Some((session, reason)) = now.key_refusal.filter(|_| before.key_refusal != now.key_refusal) {
            announcer.say(&format!("Session {session:#06x} is refused: {reason}."));
        }
        if let Some(fault) = now.fault.filter(|_| before.fault != now.fault) {
            announcer.say(&format!("Stopping: {fault}"));
        }
        if before.state != now.state || before.phase != now.phase {
            let phase = now.phase.map_or("", |phase| match phase {
                Phase::Armed => ", armed",
                Phase::Streaming => ", following setpoints",
                Phase::Completing => ", following the last setpoints",
                Phase::Holding => ", holding the last setpoint",
            });
            announcer.say(&format!("State: {}{phase}.", status.state.name()));
        }
        // A disk may keep it waiting, and an executor counts on being heard: not before it has let the arm go.
        let under_way = usize::from(!status.standstill || status.state == State::OperationEnabled);
        let done = self.motions.len().saturating_sub(under_way);
        for Executed { plan_hash, period_us, poses, .. } in self.motions.drain(..done) {
            announcer.executed(plan_hash, period_us, &poses)?;
        }
        Ok(())
    }

    /// A person's wish to end stops a moving arm first; asked again, it ends the program at once.
    fn is_over(&mut self) -> bool {
        let wish = self.signals.wish();
        if wish > self.wish && wish == StopWish::Controlled {
            let now_us = self.now_us();
            self.endpoint.controller_mut().handle_message(now_us, &ToArm::Stop);
        }
        self.wish = wish;
        let stands = self.endpoint.controller().status().standstill;
        let closed = self.endpoint.controller().context() == Context::NONE || self.told.fault.is_some();
        let done = self.options.once && self.endpoint.controller().has_moved() && closed;
        // For a while yet it goes on saying how it ended.
        let now_us = self.now_us();
        self.done_since_us = self.done_since_us.or(done.then_some(now_us));
        let done = self.done_since_us.is_some_and(|since_us| now_us > since_us.saturating_add(LINGER_US));
        wish == StopWish::Immediate || (stands && (wish == StopWish::Controlled || done))
    }

    fn wait(&mut self) -> io::Result<()> {
        if self.is_flooded {
            return Ok(());
        }
        let mut wake_us = self.endpoint.poll_at();
        if self.wire.is_none() {
            wake_us = wake_us.min(self.reopen_at_us);
        }
        let moment_us = self.start_us.saturating_add(wake_us);
        let retry_us = clock::now_us().saturating_add(BUSY_US);
        let moment_us = if self.busy { moment_us.min(retry_us) } else { moment_us };
        let wire = self.wire.as_ref().and_then(|wire| wire.interest());
        wait_until(Some(moment_us), [wire, Some(self.signals.interest())]).map(drop)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use powderline_host::transport::Received;
    use powderline_host::wait::Interest;
    use powderline_shared::displacement::Setpoint;
    use powderline_shared::wire::codec::Encoder;
    use powderline_shared::wire::frame::Dialect;
    use powderline_shared::wire::message::{OpenRequest, PROTOCOL_VERSION};
    use powderline_shared::wire::state::Command;

    const PERIOD_US: u32 = 10_000;
    const END: u32 = 4;
    /// The anchor, four setpoints, and three more at rest.
    const TICKS: usize = 8;

    /// A wire on which all this has arrived, at the moments that stand beside it.
    struct Written<I>(I);

    impl<I: Iterator<Item = Received>> Transport for Written<I> {
        fn dialect(&self) -> Dialect {
            Dialect::Fd
        }
        fn send(&mut self, _: &Frame) -> Result<Sent, LinkError> {
            Ok(Sent::Done)
        }
        fn receive(&mut self) -> Result<Option<Received>, LinkError> {
            Ok(self.0.next())
        }
        fn interest(&self) -> Option<Interest<'_>> {
            None
        }
    }

    #[derive(Default)]
    struct Notes(Vec<(u64, u32, usize)>);

    impl Announcer for Notes {
        fn say(&mut self, _: &str) {}
        fn executed(&mut self, plan_hash: u64, period_us: u32, poses: &[Pose]) -> anyhow::Result<()> {
            self.0.push((plan_hash, period_us, poses.len()));
            Ok(())
        }
    }

    /// An executor, and the arm's server: what it writes arrives at once, with the next exchange.
    struct Bench<'o> {
        server: Server<'o>,
        encoder: Encoder,
        written: VecDeque<Received>,
        at_us: u64,
        notes: Notes,
    }

    fn options() -> Options {
        let arm = ArmConfig { watchdog_us: 10_000_000, ..ArmConfig::ideal(bench_start()) };
        Options { on: Link::Sim, arm, once: false }
    }

    fn request(session: u16, period_us: u32) -> OpenRequest {
        OpenRequest {
            version: PROTOCOL_VERSION,
            session,
            plan_hash: u64::from(session),
            period_us,
            end_tick: END,
            lsb: Dialect::Fd.lsb(),
            limits: ArmConfig::ideal(bench_start()).limits,
            start_level: END as u16,
            reset_nonce: 0,
        }
    }

    impl<'o> Bench<'o> {
        fn new(options: &'o Options) -> Self {
            let server = Server {
                options,
                wire: None,
                reopen_at_us: u64::MAX,
                signals: Signals::install().unwrap(),
                endpoint: Endpoint::new(Controller::new(options.arm), Dialect::Fd),
                queue: VecDeque::new(),
                busy: false,
                is_flooded: false,
                told: Told::default(),
                motions: Vec::new(),
                wish: StopWish::None,
                start_us: clock::now_us(),
                passed_us: 0,
                done_since_us: None,
            };
            let (encoder, written) = (Encoder::new(Dialect::Fd), VecDeque::new());
            Self { server, encoder, written, at_us: 0, notes: Notes::default() }
        }

        fn write(&mut self, message: &ToArm) {
            let context = self.server.endpoint.controller().context();
            let at_us = self.at_us;
            let frames = self.encoder.to_arm(&context, message);
            self.written.extend(frames.map(|frame| Received { at_us, what: Incoming::Frame(frame) }));
        }

        fn command(&mut self, command: Command) {
            let session = self.server.endpoint.controller().context().session;
            self.write(&ToArm::Control { session, command });
        }

        fn setpoints(&mut self) {
            let session = self.server.endpoint.controller().context().session;
            for tick in 1..=END {
                self.write(&ToArm::Setpoint { session, setpoint: Setpoint { tick, counts: [0; 6] } });
            }
        }

        /// So many control periods pass, with a sign of life in each.
        fn let_pass(&mut self, periods: u32) {
            let session = self.server.endpoint.controller().context().session;
            for _ in 0..periods {
                self.at_us += u64::from(PERIOD_US);
                self.write(&ToArm::Heartbeat { session });
            }
        }

        /// All that was written arrives within one exchange; the clock is at the last of it.
        fn exchange(&mut self) {
            // Nothing of the real time that has passed meanwhile.
            let offset_us = clock::now_us() - self.at_us;
            self.written.iter_mut().for_each(|received| received.at_us += offset_us);
            self.server.start_us = offset_us;
            self.server.wire = Some(Box::new(Written(std::mem::take(&mut self.written).into_iter())));
            self.server.exchange().unwrap();
            self.server.tell(&mut self.notes).unwrap();
            self.at_us = self.server.passed_us;
        }

        fn open(&mut self, session: u16, period_us: u32) {
            self.write(&ToArm::Open(request(session, period_us)));
            self.exchange();
            assert_eq!(self.server.endpoint.controller().context().session, session);
        }

        fn start(&mut self) {
            [Command::Shutdown, Command::SwitchOn, Command::EnableOperation]
                .into_iter()
                .for_each(|command| self.command(command));
            self.setpoints();
            self.exchange();
            assert!(!self.server.endpoint.controller().status().standstill);
        }
    }

    /// Whose motion it was is known even where the session ends, and another one begins, before anybody is told.
    #[test]
    fn a_wire_that_is_flooded_does_not_keep_the_arm_from_its_own_time() {
        let options = options();
        let mut bench = Bench::new(&options);
        let stop = Encoder::new(Dialect::Fd).to_arm(&Context::NONE, &ToArm::Stop).next().unwrap();
        let flood =
            std::iter::repeat_with(move || Received { at_us: 0, what: Incoming::Frame(stop.clone()) });
        bench.server.wire = Some(Box::new(Written(flood)));
        bench.server.exchange().unwrap();
        // There is more, so that nobody sleeps before that is taken in.
        assert!(bench.server.is_flooded);
        bench.server.wait().unwrap();
        assert_eq!(bench.server.queue.len(), 0, "what the arm says leaves meanwhile");
        bench.exchange();
        assert!(!bench.server.is_flooded);
    }

    #[test]
    fn a_motion_is_written_down_as_that_of_the_session_that_made_it() {
        for next in [false, true] {
            let options = options();
            let mut bench = Bench::new(&options);
            bench.open(7, PERIOD_US);
            bench.start();
            assert_eq!(bench.notes.0, []);
            bench.let_pass(20);
            bench.command(Command::Shutdown);
            if next {
                bench.write(&ToArm::Open(request(8, 3 * PERIOD_US)));
            }
            bench.exchange();
            let open = bench.server.endpoint.controller().context().session;
            assert_eq!(open, if next { 8 } else { 0 });
            assert_eq!(bench.notes.0, [(7, PERIOD_US, TICKS)]);
        }
    }

    #[test]
    fn each_motion_is_one_by_itself_though_the_next_one_is_under_way() {
        let options = options();
        let mut bench = Bench::new(&options);
        bench.open(7, PERIOD_US);
        bench.start();
        bench.let_pass(20);
        bench.command(Command::Shutdown);
        bench.exchange();
        bench.open(8, PERIOD_US);
        bench.start();
        assert_eq!(bench.notes.0, [(7, PERIOD_US, TICKS)]);
        bench.let_pass(20);
        bench.exchange();
        // It stands, and its executor has not let it go yet.
        assert_eq!(bench.notes.0, [(7, PERIOD_US, TICKS)]);
        bench.command(Command::Shutdown);
        bench.exchange();
        assert_eq!(bench.notes.0, [(7, PERIOD_US, TICKS), (8, PERIOD_US, TICKS)]);
    }

    #[test]
    fn a_motion_that_nobody_has_let_go_is_told_of_when_a_person_ends_the_program() {
        let options = options();
        let mut bench = Bench::new(&options);
        bench.open(7, PERIOD_US);
        bench.start();
        bench.let_pass(20);
        bench.exchange();
        assert_eq!(bench.notes.0, []);
        let process = std::process::id().to_string();
        let press = std::process::Command::new("sh").args(["-c", "kill -INT \"$0\"", &process]).status();
        assert!(press.unwrap().success());
        bench.server.run(&mut bench.notes).unwrap();
        assert_eq!(bench.notes.0, [(7, PERIOD_US, TICKS)]);
    }
}
