//! A plan over a real wire: the executor's core between a clock and a transport.

use std::io;

use powderline_executor::adapters::{Device, Gone, Turn, turn};
use powderline_executor::recorder::Recorder;
use powderline_executor::{Config, Endpoint};
use powderline_host::clock;
use powderline_host::interface::Interface;
use powderline_host::jitter::Jitter;
use powderline_host::link::Link;
use powderline_host::transport::{BUSY_US, BusEvent, Incoming, LinkError, Sent, Transport};
use powderline_host::wait::{Interest, wait_until};
use powderline_shared::plan::PlanReader;
use powderline_shared::wire::frame::{Dialect, Frame};
use powderline_shared::wire::load::Medium;
use powderline_shared::wire::message::{NO_SESSION, Status};
use powderline_shared::wire::state::State;

use crate::run::{FrameCounts, Observer, RunResult, StopWish};

/// Frames that the flight recorder keeps.
pub const RECORDED: usize = 4096;

/// The recorder of a session.
pub type FlightRecorder = Recorder<RECORDED>;

/// What carries the frames, with its rates as far as they are known, and the rates typed with it.
///
/// # Errors
/// Rates that are typed and are not those of the interface.
pub fn medium(link: &Link) -> Result<Option<Medium>, LinkError> {
    Ok(match link {
        Link::Sim | Link::Pty => None,
        Link::Can { interface, bit_s } => {
            let (nominal, _) = Interface::query(interface)?.agree(interface, *bit_s, None)?;
            nominal.map(|bit_s| Medium::Classic { bit_s: f64::from(bit_s) })
        }
        Link::CanFd { interface, bit_s } => {
            let (nominal, data) = (bit_s.map(|(nominal, _)| nominal), bit_s.map(|(_, data)| data));
            let (nominal, data) = Interface::query(interface)?.agree(interface, nominal, data)?;
            nominal.zip(data).map(|(nominal, data)| Medium::Fd {
                nominal_bit_s: f64::from(nominal),
                data_bit_s: f64::from(data),
            })
        }
        Link::Serial { baud, .. } => Some(Medium::Serial { bit_s: f64::from(*baud) }),
    })
}

/// Plays a plan over a wire until the session is over. Every frame that is sent or received goes to `recorder`.
///
/// # Errors
/// If it cannot be waited for the wire.
pub fn play(
    plan: &PlanReader<'_>,
    config: Config,
    wire: &mut dyn Transport,
    recorder: &mut FlightRecorder,
    observer: &mut impl Observer,
) -> io::Result<RunResult> {
    let start_us = clock::now_us();
    let period_us = config.period_us.unwrap_or(plan.header().control_period_us);
    let mut player = Player {
        endpoint: Endpoint::new(0, plan, wire.dialect(), config),
        dialect: wire.dialect(),
        wire: Wired {
            wire,
            recorder,
            waiting: None,
            last_sent: 0,
            // A tenth of a period is what a smooth motion forgives.
            jitter: Jitter::new(u64::from(period_us) / 10),
            not_taken: 0,
            gravest: None,
            failure: None,
        },
        start_us,
        wish: StopWish::None,
    };
    player.run(observer)
}

struct Player<'p, 'w> {
    endpoint: Endpoint<'p>,
    dialect: Dialect,
    wire: Wired<'w>,
    start_us: u64,
    wish: StopWish,
}

impl Player<'_, '_> {
    fn run(&mut self, observer: &mut impl Observer) -> io::Result<RunResult> {
        loop {
            let start_us = self.start_us;
            let now_us = || clock::now_us().saturating_sub(start_us);
            let turn = turn(&mut self.wire, now_us, &mut self.endpoint);
            if let Turn::Finished(outcome) = turn {
                return Ok(self.result(outcome));
            }
            self.obey(observer);
            self.wait(turn, observer)?;
        }
    }

    fn now_us(&self) -> u64 {
        clock::now_us().saturating_sub(self.start_us)
    }

    fn obey(&mut self, observer: &mut impl Observer) {
        let none = Status {
            session: NO_SESSION,
            state: State::NotReadyToSwitchOn,
            phase: None,
            standstill: false,
            applied_tick: 0,
            have: 0,
            counter: 0,
        };
        let now_us = self.now_us();
        let status = self.endpoint.executor().arm_status().copied().unwrap_or(none);
        let wish = observer.observe(now_us, &status);
        if wish > self.wish {
            self.wish = wish;
            match wish {
                StopWish::None => {}
                StopWish::Controlled => self.endpoint.executor_mut().handle_stop(now_us),
                StopWish::Immediate => self.endpoint.executor_mut().handle_hard_stop(now_us),
            }
        }
    }

    fn wait(&mut self, turn: Turn, observer: &impl Observer) -> io::Result<()> {
        // One that is gone has no room either, and may say for ever that there is something to fetch.
        let gone = self.wire.failure.is_some();
        let busy = self.wire.waiting.is_some() || gone;
        if turn == Turn::Unfinished && !busy {
            return Ok(());
        }
        let due_us = self.endpoint.poll_at().unwrap_or(0).saturating_add(self.start_us);
        let retry_us = clock::now_us().saturating_add(BUSY_US);
        // What is due has no room: only time helps, or what arrives.
        let moment_us = if busy { retry_us } else { due_us };
        let wire = if gone { None } else { self.wire.wire.interest() };
        let interests: [Option<Interest<'_>>; 2] = [wire, observer.interest()];
        wait_until(Some(moment_us), interests).map(drop)
    }

    fn result(&mut self, outcome: powderline_executor::Outcome) -> RunResult {
        let executor = self.endpoint.executor();
        let [sent, received, rejected] = self.endpoint.frame_counts();
        RunResult {
            outcome,
            arm: executor.session_status(),
            reached: executor.reached(),
            lsb: self.dialect.lsb(),
            final_pose: executor.actual_pose(),
            telemetry: executor.telemetry(),
            peak_use: executor.peak_use(),
            violation: executor.violation(),
            refusal: executor.refusal(),
            is_stopped_anew: executor.is_stopped_anew(),
            reset_from: executor.reset_from(),
            doubt: executor.doubt(),
            duration_us: self.now_us(),
            jitter: self.wire.jitter.summary(),
            frames: Some(FrameCounts {
                sent,
                received,
                rejected,
                wrong_tags: self.endpoint.wrong_tags(),
                not_taken: self.wire.not_taken,
                garbled: self.wire.wire.garbled(),
            }),
            wire: self
                .wire
                .failure
                .take()
                .map(|error| error.to_string())
                .or_else(|| self.wire.gravest_event()),
        }
    }
}

/// A wire of this machine, as the driver loop wants it: at most one frame waits for room, and a stop takes its place.
struct Wired<'w> {
    wire: &'w mut dyn Transport,
    recorder: &'w mut FlightRecorder,
    waiting: Option<Frame>,
    /// The last setpoint that was given out for the first time.
    last_sent: u32,
    jitter: Jitter,
    not_taken: u64,
    gravest: Option<BusEvent>,
    failure: Option<LinkError>,
}

impl Wired<'_> {
    fn handle_event(&mut self, event: BusEvent) -> Result<(), Gone> {
        self.gravest = Some(self.gravest.map_or(event, |gravest| gravest.min(event)));
        if event.ends_session() { Err(Gone) } else { Ok(()) }
    }

    /// The first failure is the reason; the session goes on asking for a stop, should the wire come back.
    fn fail(&mut self, error: LinkError) -> Gone {
        self.failure.get_or_insert(error);
        Gone
    }

    fn gravest_event(&self) -> Option<String> {
        self.gravest.map(|event| event.sentence().to_owned())
    }
}

impl Device for Wired<'_> {
    fn fetch(&mut self, mut heard: impl FnMut(&Frame)) -> Result<bool, Gone> {
        match self.wire.receive() {
            Ok(Some(received)) => match received.what {
                Incoming::Frame(frame) => {
                    self.recorder.record(received.at_us, &frame);
                    heard(&frame);
                }
                Incoming::Event(event) => self.handle_event(event)?,
            },
            Ok(None) => return Ok(false),
            Err(error) => return Err(self.fail(error)),
        }
        Ok(true)
    }

    fn make_room(&mut self) -> Result<bool, Gone> {
        let Some(frame) = self.waiting.take() else { return Ok(true) };
        match self.wire.send(&frame) {
            Ok(Sent::Done) => self.recorder.record(clock::now_us(), &frame),
            Ok(Sent::Busy) => self.waiting = Some(frame),
            // Given up: what it said is said again, should the wire come back.
            Err(error) => return Err(self.fail(error)),
        }
        Ok(self.waiting.is_none())
    }

    fn put(&mut self, frame: &Frame) -> Result<(), Gone> {
        if self.waiting.replace(frame.clone()).is_some() {
            self.not_taken = self.not_taken.saturating_add(1);
        }
        Ok(())
    }

    /// One cycle for each setpoint: how long after its moment it leaves for the first time.
    fn look(&mut self, endpoint: &Endpoint<'_>) {
        let telemetry = endpoint.executor().telemetry();
        if telemetry.sent != self.last_sent {
            self.last_sent = telemetry.sent;
            telemetry.late_us.into_iter().for_each(|late_us| self.jitter.record(late_us));
        }
    }
}
