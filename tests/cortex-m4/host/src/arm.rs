//! The simulated arm at the other end of the serial line.

use std::io::{ErrorKind, Read, Write};
use std::os::unix::net::UnixStream;
use std::thread;
use std::time::{Duration, Instant};

use anyhow::{Context as _, Result, bail, ensure};
use powderline_firmware_sim::controller::{ArmConfig, Controller};
use powderline_firmware_sim::endpoint::Endpoint;
use powderline_shared::plan::PlanReader;
use powderline_shared::pose::norm;
use powderline_shared::wire::frame::Dialect;
use powderline_shared::wire::message::Status;
use powderline_shared::wire::serial::{LineReader, to_line};
use powderline_shared::wire::state::Phase;

/// How long QEMU may take to open its socket.
const OPENING: Duration = Duration::from_secs(20);

/// Time between two looks at line and arm.
const TURN: Duration = Duration::from_millis(1);

/// What rounding leaves of a distance from the last setpoint: half an LSB of 0.1 um or 0.1 urad on each axis.
const END_TOLERANCE: f64 = 1e-7;

/// Plays the arm until the firmware has gone.
pub(crate) fn play(socket: &str, plan: &PlanReader<'_>) -> Result<()> {
    let mut line = connect(socket)?;
    line.set_nonblocking(true)?;
    let controller = Controller::new(ArmConfig::ideal(plan.header().start_pose()));
    let mut arm = Endpoint::new(controller, Dialect::Fd);
    let mut reader = LineReader::new();
    let mut clock = Clock::new();
    let mut chunk = [0; 4096];
    loop {
        let now_us = clock.now_us(&arm.controller().status());
        match line.read(&mut chunk) {
            Ok(0) => break,
            Ok(count) => {
                for frame in chunk.iter().take(count).filter_map(|byte| reader.push(*byte)?.ok()) {
                    arm.handle_frame(now_us, &frame);
                }
            }
            Err(error) if error.kind() == ErrorKind::WouldBlock => thread::sleep(TURN),
            // The firmware ends without having heard the arm's last words.
            Err(error) if error.kind() == ErrorKind::ConnectionReset => break,
            Err(error) => return Err(error).context("cannot read the serial line"),
        }
        while let Some(frame) = arm.poll(now_us) {
            if !send(&mut line, &to_line(&frame))? {
                return judge(arm.controller(), plan);
            }
        }
    }
    judge(arm.controller(), plan)
}

fn connect(socket: &str) -> Result<UnixStream> {
    let began = Instant::now();
    loop {
        match UnixStream::connect(socket) {
            Ok(line) => return Ok(line),
            Err(error) if began.elapsed() > OPENING => {
                return Err(error).with_context(|| format!("nobody opened {socket}"));
            }
            Err(_) => thread::sleep(TURN),
        }
    }
}

/// Whether there is still somebody to hear it.
fn send(line: &mut UnixStream, mut bytes: &[u8]) -> Result<bool> {
    while !bytes.is_empty() {
        match line.write(bytes) {
            Ok(count) => bytes = bytes.get(count..).unwrap_or_default(),
            Err(error) if error.kind() == ErrorKind::WouldBlock => thread::sleep(TURN),
            Err(error) if error.kind() == ErrorKind::BrokenPipe => return Ok(false),
            Err(error) => return Err(error).context("cannot write to the serial line"),
        }
    }
    Ok(true)
}

fn judge(controller: &Controller, plan: &PlanReader<'_>) -> Result<()> {
    if let Some(fault) = controller.fault() {
        bail!("the arm stopped: {fault}");
    }
    let off = controller.pose().displacement_to(&plan.end_pose());
    let (off_m, off_rad) = (norm(&off.translation()), norm(&off.rotation()));
    ensure!(
        off_m <= END_TOLERANCE && off_rad <= END_TOLERANCE,
        "the arm stands {off_m} m and {off_rad} rad from the end of the plan"
    );
    println!("arm: dropped={} off_m={off_m:e} off_rad={off_rad:e}", controller.dropped());
    Ok(())
}

/// The arm's clock. The emulated processor shares this machine with whatever else runs on it, and proves what it does, not
/// how fast: so the clock waits, up to a limit, while a setpoint is due that has not come, and never leaps.
struct Clock {
    seen: Instant,
    now: Duration,
    waited: Duration,
}

impl Clock {
    const LONGEST_STEP: Duration = Duration::from_millis(5);
    const PATIENCE: Duration = Duration::from_secs(2);

    fn new() -> Self {
        Self { seen: Instant::now(), now: Duration::ZERO, waited: Duration::ZERO }
    }

    fn now_us(&mut self, arm: &Status) -> u64 {
        let passed = self.seen.elapsed();
        self.seen += passed;
        let due = arm.phase == Some(Phase::Streaming) && arm.have & 1 == 0;
        self.waited = if due { self.waited + passed } else { Duration::ZERO };
        if !due || self.waited > Self::PATIENCE {
            self.now += passed.min(Self::LONGEST_STEP);
        }
        u64::try_from(self.now.as_micros()).unwrap_or(u64::MAX)
    }
}
