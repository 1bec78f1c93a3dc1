//! A plan over a real wire: the executor's core between a clock and a transport.

use std::collections::VecDeque;
use std::io;

use powderline_executor::recorder::Recorder;
use powderline_executor::{Config, Endpoint, FrameAction};
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

/// Frames that wait for room on the wire; the oldest give way, for the newest say more.
const QUEUE: usize = 64;

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
        wire,
        recorder,
        queue: VecDeque::new(),
        start_us,
        // A tenth of a period is what a smooth motion forgives.
        jitter: Jitter::new(u64::from(period_us) / 10),
        wish: StopWish::None,
        busy: false,
        not_taken: 0,
        events: Vec::new(),
        failure: None,
    };
    player.run(observer)
}

struct Player<'p, 'w> {
    endpoint: Endpoint<'p>,
    dialect: Dialect,
    wire: &'w mut dyn Transport,
    recorder: &'w mut FlightRecorder,
    queue: VecDeque<Frame>,
    start_us: u64,
    jitter: Jitter,
    wish: StopWish,
    /// Whether the wire had no room the last time.
    busy: bool,
    not_taken: u64,
    events: Vec<BusEvent>,
    failure: Option<LinkError>,
}

impl Player<'_, '_> {
    fn run(&mut self, observer: &mut impl Observer) -> io::Result<RunResult> {
        loop {
            self.receive();
            let outcome = loop {
                let sent_before = self.endpoint.executor().telemetry().sent;
                match self.endpoint.poll(self.now_us()) {
                    FrameAction::Send(frame) => {
                        self.note_lateness(sent_before);
                        self.enqueue(frame);
                    }
                    FrameAction::Wait => break None,
                    FrameAction::Finished(outcome) => break Some(outcome),
                }
            };
            self.send();
            if let Some(outcome) = outcome {
                return Ok(self.result(outcome));
            }
            self.obey(observer);
            self.wait(observer)?;
        }
    }

    fn now_us(&self) -> u64 {
        clock::now_us().saturating_sub(self.start_us)
    }

    fn receive(&mut self) {
        loop {
            match self.wire.receive() {
                Ok(Some(received)) => match received.what {
                    Incoming::Frame(frame) => {
                        self.recorder.record(received.at_us, &frame);
                        // What cannot be understood is dropped, and counted there.
                        let _ = self.endpoint.handle_frame(self.now_us(), &frame);
                    }
                    Incoming::Event(event) => self.handle_event(event),
                },
                Ok(None) => return,
                Err(error) => return self.fail(error),
            }
        }
    }

    fn handle_event(&mut self, event: BusEvent) {
        if self.events.last() != Some(&event) {
            self.events.push(event);
        }
        if event.ends_session() {
            let now_us = self.now_us();
            self.endpoint.executor_mut().handle_link_lost(now_us);
        }
    }

    /// The first failure is the reason; the session goes on asking for a stop, should the wire come back.
    fn fail(&mut self, error: LinkError) {
        let now_us = self.now_us();
        self.endpoint.executor_mut().handle_link_lost(now_us);
        self.failure.get_or_insert(error);
    }

    /// One cycle for each setpoint: how long after its moment it leaves for the first time.
    fn note_lateness(&mut self, sent_before: u32) {
        let telemetry = self.endpoint.executor().telemetry();
        if telemetry.sent != sent_before {
            telemetry.late_us.into_iter().for_each(|late_us| self.jitter.record(late_us));
        }
    }

    fn enqueue(&mut self, frame: Frame) {
        if self.queue.len() >= QUEUE {
            self.queue.pop_front();
            self.not_taken = self.not_taken.saturating_add(1);
        }
        self.queue.push_back(frame);
    }

    fn send(&mut self) {
        self.busy = false;
        while let Some(frame) = self.queue.front() {
            match self.wire.send(frame) {
                Ok(Sent::Done) => self.recorder.record(clock::now_us(), frame),
                Ok(Sent::Busy) => {
                    self.busy = true;
                    return;
                }
                Err(error) => self.fail(error),
            }
            self.queue.pop_front();
        }
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

    fn wait(&mut self, observer: &impl Observer) -> io::Result<()> {
        let due_us = self.endpoint.poll_at().unwrap_or(0).saturating_add(self.start_us);
        let retry_us = clock::now_us().saturating_add(BUSY_US);
        let moment_us = if self.busy { due_us.min(retry_us) } else { due_us };
        let interests: [Option<Interest<'_>>; 2] = [self.wire.interest(), observer.interest()];
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
            doubt: executor.doubt(),
            duration_us: self.now_us(),
            jitter: self.jitter.summary(),
            frames: Some(FrameCounts {
                sent,
                received,
                rejected,
                not_taken: self.not_taken,
                garbled: self.wire.garbled(),
            }),
            wire: self.failure.take().map(|error| error.to_string()).or_else(|| self.gravest_event()),
        }
    }

    fn gravest_event(&self) -> Option<String> {
        self.events.iter().min().map(|event| event.sentence().to_owned())
    }
}
