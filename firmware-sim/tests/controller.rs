//! The controller on its own, driven by hand: no line of the executor is involved.

use nalgebra::Vector3;
use powderline_firmware_sim::arm::Arm;
use powderline_firmware_sim::arm::servo::Lag;
use powderline_firmware_sim::controller::{
    ArmConfig, Controller, DEFAULT_WATCHDOG_US, LONGEST_PERIOD_US, Tick,
};
use powderline_firmware_sim::stop::GENTLE_STOP_US;
use powderline_shared::arm::ArmModel;
use powderline_shared::displacement::{Displacement, Lsb, Setpoint, pose_at};
use powderline_shared::fault::FaultCode;
use powderline_shared::limits::{Limits, Motion};
use powderline_shared::pose::Pose;
use powderline_shared::wire::Context;
use powderline_shared::wire::message::{
    BRIDGED_TICKS, DEPTH, FromArm, NO_SESSION, OpenRequest, PROTOCOL_VERSION, Refusal, Status, ToArm,
};
use powderline_shared::wire::state::{Command, Event, Phase, State, transition};

const PERIOD_US: u32 = 10_000;
const SESSION: u16 = 7;
const END: u32 = 100;
const START_LEVEL: u16 = 4;

fn start() -> Pose {
    Pose { position_m: Vector3::new(0.3, 0.1, 0.2), ..Pose::identity() }
}

fn limits() -> Limits {
    Limits {
        workspace_min_m: [0.0; 3],
        workspace_max_m: [0.6; 3],
        linear_velocity_m_s: 0.5,
        linear_acceleration_m_s2: 2.0,
        linear_jerk_m_s3: 40.0,
        angular_velocity_rad_s: 2.0,
        angular_acceleration_rad_s2: 10.0,
        angular_jerk_rad_s3: 200.0,
    }
}

fn request() -> OpenRequest {
    OpenRequest {
        version: PROTOCOL_VERSION,
        session: SESSION,
        plan_hash: 1,
        period_us: PERIOD_US,
        end_tick: END,
        lsb: Lsb::default(),
        limits: limits(),
        start_level: START_LEVEL,
        reset_nonce: 0,
    }
}

fn is_opened(bench: &Bench, of: u16) -> bool {
    bench.messages.iter().any(|message| matches!(message, FromArm::Opened { session, .. } if *session == of))
}

/// What the arm has said that it can be reset by.
fn latched_nonce(bench: &Bench) -> u32 {
    let nonce = bench.messages.iter().rev().find_map(|message| match message {
        FromArm::Refused { reason: Refusal::Latched { nonce, .. }, .. } => Some(*nonce),
        _ => None,
    });
    nonce.unwrap()
}

fn smooth(s: f64) -> f64 {
    let s = s.min(1.0);
    s * s * s * (10.0 + s * (6.0 * s - 15.0))
}

/// 0.2 m and 0.5 rad in `END` ticks.
fn setpoint(tick: u32) -> Setpoint {
    setpoint_of(tick, 0.2, 0.5)
}

fn setpoint_of(tick: u32, length_m: f64, angle_rad: f64) -> Setpoint {
    let s = smooth(f64::from(tick) / f64::from(END));
    let cumulative =
        Displacement { translation_m: [length_m * s, 0.0, 0.0], rotation_rad: [0.0, angle_rad * s, 0.0] };
    Setpoint::from_cumulative(tick, &cumulative, Lsb::default()).unwrap()
}

/// A controller under virtual time, and an observer who knows nothing but where the arm is at each tick.
struct Bench {
    arm: Controller,
    now_us: u64,
    seen: Motion,
    peak: [f64; 6],
    messages: Vec<FromArm>,
    /// Whether the executor sends signs of life.
    alive: bool,
}

impl Bench {
    fn new() -> Self {
        let arm = Controller::new(ArmConfig { limits: limits(), ..ArmConfig::ideal(start()) });
        Self {
            arm,
            now_us: 0,
            seen: Motion::at_rest(start()),
            peak: [0.0; 6],
            messages: Vec::new(),
            alive: true,
        }
    }

    fn enabled() -> Self {
        Self::enabled_with(request())
    }

    fn enabled_with(request: OpenRequest) -> Self {
        let mut bench = Self::new();
        bench.tell(ToArm::Open(request));
        for command in [Command::Shutdown, Command::SwitchOn, Command::EnableOperation] {
            bench.command(command);
        }
        assert_eq!(bench.arm.state(), State::OperationEnabled);
        bench
    }

    fn tell(&mut self, message: ToArm) {
        self.arm.handle_message(self.now_us, &message);
        self.messages.extend(std::iter::from_fn(|| self.arm.poll(self.now_us)));
    }

    fn command(&mut self, command: Command) {
        self.tell(ToArm::Control { session: SESSION, command });
    }

    fn set(&mut self, setpoint: Setpoint) {
        self.tell(ToArm::Setpoint { session: SESSION, setpoint });
    }

    /// One period passes; the observer takes note.
    fn period(&mut self) {
        self.now_us += u64::from(PERIOD_US);
        if self.alive {
            self.arm.handle_message(self.now_us, &ToArm::Heartbeat { session: SESSION });
        }
        self.messages.extend(std::iter::from_fn(|| self.arm.poll(self.now_us)));
        self.seen = self.seen.moved_to(self.arm.pose(), PERIOD_US);
        for (peak, value) in self.peak.iter_mut().zip(self.seen.norms()) {
            *peak = peak.max(value);
        }
    }

    /// Streams `setpoint(tick)` where it gives one, four ticks ahead.
    fn stream(&mut self, last_tick: u32, setpoint: impl Fn(u32) -> Option<Setpoint>) {
        let ahead = u32::from(START_LEVEL);
        (1..=ahead).filter_map(&setpoint).for_each(|setpoint| self.set(setpoint));
        for tick in ahead + 1..=last_tick + ahead + 8 {
            self.period();
            if tick <= last_tick {
                setpoint(tick).into_iter().for_each(|setpoint| self.set(setpoint));
            }
        }
    }

    fn rest(&mut self) {
        for _ in 0..200 {
            self.period();
        }
        assert!(self.arm.status().standstill);
    }

    /// One period in tenths; in none of them the arm may move more than half a millimetre.
    fn tick_without_jumps(&mut self, tick: u32) {
        for _ in 0..10 {
            let before = self.arm.pose();
            self.now_us += u64::from(PERIOD_US) / 10;
            while self.arm.poll(self.now_us).is_some() {}
            let moved = before.displacement_to(&self.arm.pose()).translation().norm();
            assert!(moved <= 0.5 * 1e-3, "{moved} m in a tenth of tick {tick}");
        }
    }

    fn assert_limits_kept(&self) {
        // What rounding to the LSB can add, see `limits`.
        let noise = [2e-5, 4e-3, 0.7, 2e-5, 4e-3, 0.7];
        for (((limit, bound), value), noise) in
            limits().derivative_bounds().into_iter().zip(self.peak).zip(noise)
        {
            assert!(value <= bound + noise, "{limit}: {value} > {bound}");
        }
    }

    fn fault(&self) -> Option<FaultCode> {
        self.arm.fault().map(|fault| fault.code)
    }
}

#[test]
fn a_whole_motion_ends_on_its_last_setpoint() {
    let mut bench = Bench::enabled();
    let anchor = bench.messages.iter().find_map(|message| match message {
        FromArm::Anchored { pose, session: SESSION } => Some(*pose),
        _ => None,
    });
    assert_eq!(anchor, Some(start()));
    bench.stream(END, |tick| Some(setpoint(tick)));
    assert_eq!(bench.arm.pose(), pose_at(&start(), setpoint(END), Lsb::default()));
    let status = bench.arm.status();
    assert_eq!((status.phase, status.applied_tick, bench.arm.lost()), (Some(Phase::Holding), END, 0));
    assert_eq!(bench.fault(), None);
    bench.assert_limits_kept();
    bench.command(Command::Shutdown);
    assert_eq!(bench.arm.state(), State::ReadyToSwitchOn);
}

#[test]
fn phases_follow_each_other() {
    let mut bench = Bench::enabled();
    bench.stream(END, |tick| Some(setpoint(tick)));
    let mut phases: Vec<_> = bench
        .messages
        .iter()
        .filter_map(|message| if let FromArm::Status(status) = message { status.phase } else { None })
        .collect();
    phases.dedup();
    assert_eq!(phases, [Phase::Armed, Phase::Streaming, Phase::Completing, Phase::Holding]);
}

#[test]
fn nothing_moves_without_a_session_and_enabled_operation() {
    let mut bench = Bench::new();
    bench.command(Command::Shutdown);
    assert_eq!(bench.arm.state(), State::SwitchOnDisabled);
    bench.tell(ToArm::Open(request()));
    (1..10).for_each(|tick| bench.set(setpoint(tick)));
    bench.rest();
    assert_eq!(bench.arm.pose(), start());
    assert_eq!(bench.arm.dropped(), 10);
}

#[test]
fn another_session_moves_nothing() {
    let mut bench = Bench::enabled();
    for tick in 1..10 {
        bench.tell(ToArm::Setpoint { session: SESSION + 1, setpoint: setpoint(tick) });
    }
    bench.tell(ToArm::Control { session: SESSION + 1, command: Command::QuickStop });
    bench.tell(ToArm::Open(OpenRequest { session: SESSION + 1, ..request() }));
    let refused = FromArm::Refused { session: SESSION + 1, reason: Refusal::Busy };
    assert!(bench.messages.contains(&refused));
    bench.rest();
    assert_eq!((bench.arm.pose(), bench.arm.state()), (start(), State::OperationEnabled));
}

#[test]
fn an_arm_that_is_not_latched_obeys_its_own_session_only() {
    for (session, steps) in
        [NO_SESSION, SESSION + 1].into_iter().flat_map(|session| (0..=4).map(move |n| (session, n)))
    {
        let mut bench = Bench::new();
        bench.tell(ToArm::Open(request()));
        let up = [Command::Shutdown, Command::SwitchOn, Command::EnableOperation];
        up.iter().take(steps).for_each(|command| bench.command(*command));
        if steps > up.len() {
            (1..=DEPTH).for_each(|tick| bench.set(setpoint(tick)));
            (0..5).for_each(|_| bench.period());
            assert!(!bench.arm.status().standstill);
        }
        let (before, dropped) = (bench.arm.status(), bench.arm.dropped());
        Command::ALL.into_iter().for_each(|command| bench.tell(ToArm::Control { session, command }));
        bench.tell(ToArm::Open(OpenRequest { session: SESSION + 1, ..request() }));
        assert!(bench.messages.contains(&FromArm::Refused { session: SESSION + 1, reason: Refusal::Busy }));
        let after = Status { counter: before.counter, ..bench.arm.status() };
        assert_eq!((after, usize::from(bench.arm.dropped() - dropped)), (before, Command::ALL.len()));
    }
}

#[test]
fn another_executors_signs_of_life_do_not_keep_a_session() {
    let mut bench = Bench::enabled();
    bench.alive = false;
    for _ in 0..DEFAULT_WATCHDOG_US / u64::from(PERIOD_US) {
        bench.tell(ToArm::Heartbeat { session: SESSION + 1 });
        bench.tell(ToArm::Setpoint { session: SESSION + 1, setpoint: setpoint(1) });
        bench.tell(ToArm::Control { session: NO_SESSION, command: Command::FaultReset });
        bench.period();
    }
    assert_eq!(bench.fault(), Some(FaultCode::ExecutorSilent));
}

#[test]
fn sessions_that_do_not_fit_are_refused() {
    let fine = request();
    let no_limits = Limits { linear_jerk_m_s3: f64::NAN, ..limits() };
    let cases = [
        (OpenRequest { version: PROTOCOL_VERSION + 1, ..fine }, Refusal::Version { arm: PROTOCOL_VERSION }),
        (OpenRequest { period_us: 1, ..fine }, Refusal::Period),
        (OpenRequest { period_us: LONGEST_PERIOD_US + 1, ..fine }, Refusal::Period),
        (OpenRequest { session: 0, ..fine }, Refusal::Meaningless),
        (OpenRequest { end_tick: 0, ..fine }, Refusal::Meaningless),
        (OpenRequest { start_level: 0, ..fine }, Refusal::Meaningless),
        (OpenRequest { start_level: 17, ..fine }, Refusal::Meaningless),
        (OpenRequest { limits: no_limits, ..fine }, Refusal::Meaningless),
        (OpenRequest { lsb: Lsb { translation_nm: 0, rotation_nrad: 1 }, ..fine }, Refusal::Meaningless),
    ];
    for (request, reason) in cases {
        let mut bench = Bench::new();
        bench.tell(ToArm::Open(request));
        assert!(bench.messages.contains(&FromArm::Refused { session: request.session, reason }));
    }
}

/// At 10 ms rounding to q adds 4 sqrt(3) q / h^3 = 6.93 q / us^3 to the jerk; a fifth of 40 m/s^3 is reached at 1.143 um, a
/// fifth of 200 rad/s^3 at 5.716 urad.
#[test]
fn an_lsb_that_would_stretch_the_arms_own_limits_by_more_than_a_fifth_is_refused() {
    let refused = FromArm::Refused { session: SESSION, reason: Refusal::Coarse };
    let cases = [
        (Lsb { translation_nm: 1_140, rotation_nrad: 100 }, None),
        (Lsb { translation_nm: 1_146, rotation_nrad: 100 }, Some(refused)),
        (Lsb { translation_nm: 100, rotation_nrad: 5_710 }, None),
        (Lsb { translation_nm: 100, rotation_nrad: 5_720 }, Some(refused)),
    ];
    for (lsb, answer) in cases {
        // The session's own limits are what they may be; only the arm's count here.
        let mut bench = Bench::new();
        bench.tell(ToArm::Open(OpenRequest { lsb, ..request() }));
        assert_eq!(is_opened(&bench, SESSION), answer.is_none(), "{lsb:?}");
        assert!(
            answer.is_none_or(|refused| bench.messages.contains(&refused)),
            "{lsb:?}: {:?}",
            bench.messages
        );
    }
}

#[test]
fn each_limit_is_kept_by_the_arm_alone() {
    let fine = limits();
    let cases = [
        (Limits { workspace_max_m: [0.4, 0.6, 0.6], ..fine }, FaultCode::ArmWorkspace),
        (Limits { linear_velocity_m_s: 0.3, ..fine }, FaultCode::ArmLinearVelocity),
        (Limits { linear_acceleration_m_s2: 1.0, ..fine }, FaultCode::ArmLinearAcceleration),
        (Limits { linear_jerk_m_s3: 8.0, ..fine }, FaultCode::ArmLinearJerk),
        (Limits { angular_velocity_rad_s: 0.8, ..fine }, FaultCode::ArmAngularVelocity),
        (Limits { angular_acceleration_rad_s2: 2.0, ..fine }, FaultCode::ArmAngularAcceleration),
        (Limits { angular_jerk_rad_s3: 20.0, ..fine }, FaultCode::ArmAngularJerk),
    ];
    for (tight, code) in cases {
        // Once as the session's limits, once as the arm's own.
        for own in [false, true] {
            let session = if own { fine } else { tight };
            let mut bench = Bench::new();
            bench.arm = Controller::new(ArmConfig {
                limits: if own { tight } else { fine },
                ..ArmConfig::ideal(start())
            });
            bench.tell(ToArm::Open(OpenRequest { limits: session, ..request() }));
            for command in [Command::Shutdown, Command::SwitchOn, Command::EnableOperation] {
                bench.command(command);
            }
            bench.stream(END, |tick| Some(setpoint(tick)));
            bench.rest();
            assert_eq!((bench.fault(), bench.arm.state()), (Some(code), State::Fault));
            assert!(bench.arm.violation().is_some());
            bench.assert_limits_kept();
        }
    }
}

#[test]
fn a_single_lost_setpoint_heals_with_the_next() {
    for lost in (6..END).step_by(7) {
        let mut bench = Bench::enabled();
        bench.stream(END, |tick| (tick != lost).then(|| setpoint(tick)));
        assert_eq!(bench.fault(), None, "lost {lost}");
        assert_eq!(bench.arm.lost(), 1);
        assert_eq!(bench.arm.pose(), pose_at(&start(), setpoint(END), Lsb::default()));
        bench.assert_limits_kept();
    }
}

/// Tick 40 is lost; the setpoint two ticks after it is off by so many counts along x.
#[test]
fn a_loss_does_not_excuse_a_bad_setpoint_after_it() {
    let cases = [
        (1_000_000, FaultCode::ArmLinearVelocity),
        (4_000_000, FaultCode::ArmWorkspace),
        // Half a millimetre: too hard, but that may be the loss.
        (5_000, FaultCode::SetpointMissing),
    ];
    for (off, code) in cases {
        let mut bench = Bench::enabled();
        bench.stream(END, |tick| {
            let mut setpoint = setpoint(tick);
            setpoint.counts[0] += if tick == 42 { off } else { 0 };
            (tick != 40).then_some(setpoint)
        });
        bench.rest();
        assert_eq!(bench.fault(), Some(code), "{off} counts");
        bench.assert_limits_kept();
    }
}

#[test]
fn silence_is_a_latched_stop_within_limits() {
    for silent_from in (5..=END).step_by(5).chain([END - 1]) {
        let mut bench = Bench::enabled();
        bench.stream(END, |tick| (tick < silent_from).then(|| setpoint(tick)));
        bench.rest();
        assert_eq!(bench.arm.state(), State::Fault, "silent from {silent_from}");
        let fault = bench.arm.fault().unwrap();
        let latched_at = END.min(silent_from - 1 + BRIDGED_TICKS);
        assert_eq!((fault.code, fault.tick), (FaultCode::SetpointMissing, latched_at));
        bench.assert_limits_kept();
    }
}

#[test]
fn a_setpoint_that_is_late_at_rest_does_no_harm() {
    // A dwell: 60 ticks on the spot; two setpoints in it come late.
    let dwell = |tick: u32| Setpoint { tick, counts: [0; 6] };
    let mut bench = Bench::enabled();
    (1..=4).for_each(|tick| bench.set(dwell(tick)));
    for _ in 0..5 {
        bench.period();
    }
    assert_eq!(bench.arm.state(), State::OperationEnabled);
    bench.set(dwell(5));
    (6..=20).for_each(|tick| bench.set(dwell(tick)));
    bench.period();
    let status = bench.arm.status();
    assert_eq!((status.state, bench.arm.lost(), bench.arm.dropped()), (State::OperationEnabled, 2, 2));
}

#[test]
fn a_latched_stop_needs_reset_new_session_and_new_anchor() {
    let mut bench = Bench::enabled();
    bench.stream(END, |tick| (tick < 50).then(|| setpoint(tick)));
    bench.rest();
    let stopped_at = bench.arm.pose();
    for command in [Command::Shutdown, Command::SwitchOn, Command::EnableOperation, Command::QuickStop] {
        bench.command(command);
    }
    bench.tell(ToArm::Open(OpenRequest { session: 8, ..request() }));
    (50..60).for_each(|tick| bench.set(setpoint(tick)));
    bench.rest();
    assert_eq!((bench.arm.state(), bench.arm.pose()), (State::Fault, stopped_at));
    bench.command(Command::FaultReset);
    assert_eq!(bench.arm.status().session, 0);
    bench.tell(ToArm::Open(OpenRequest { session: 8, ..request() }));
    for command in [Command::Shutdown, Command::SwitchOn, Command::EnableOperation] {
        bench.tell(ToArm::Control { session: 8, command });
    }
    assert!(bench.messages.contains(&FromArm::Anchored { session: 8, pose: stopped_at }));
}

#[test]
fn a_commanded_stop_keeps_limits_at_any_moment() {
    for after in (1..END).step_by(3) {
        let mut bench = Bench::enabled();
        (1..=DEPTH).for_each(|tick| bench.set(setpoint(tick)));
        for tick in 1..=after {
            bench.period();
            let ahead = tick + DEPTH;
            if ahead <= END {
                bench.set(setpoint(ahead));
            }
        }
        // Whatever takes power away from a moving arm is a quick stop first.
        let commands = [Command::QuickStop, Command::DisableVoltage, Command::Shutdown, Command::SwitchOn];
        bench.command(commands[after as usize % 4]);
        assert_eq!(bench.arm.state(), State::QuickStopActive);
        bench.command(Command::EnableOperation);
        bench.rest();
        assert_eq!(
            (bench.arm.state(), bench.fault()),
            (State::QuickStopActive, Some(FaultCode::StopCommanded))
        );
        bench.assert_limits_kept();
        bench.command(Command::DisableVoltage);
        assert_eq!(bench.arm.state(), State::SwitchOnDisabled);
    }
}

const SLOW_END: u32 = 1_000;

/// A session that hardly accelerates, and hardly brakes.
fn slow_request() -> OpenRequest {
    let slow = Limits { linear_acceleration_m_s2: 0.015, linear_jerk_m_s3: 1.0, ..limits() };
    OpenRequest { limits: slow, end_tick: SLOW_END, ..request() }
}

/// 0.2 m in `SLOW_END` ticks.
fn slow_setpoint(tick: u32) -> Setpoint {
    let translation_m = [0.2 * smooth(f64::from(tick) / f64::from(SLOW_END)), 0.0, 0.0];
    let cumulative = Displacement { translation_m, ..Displacement::default() };
    Setpoint::from_cumulative(tick, &cumulative, Lsb::default()).unwrap()
}

#[test]
fn a_slow_session_does_not_make_a_slow_stop() {
    let nonsense = Setpoint { tick: SLOW_END + 1, counts: [0; 6] };
    for code in [FaultCode::StopCommanded, FaultCode::SetpointPastEnd, FaultCode::SetpointMissing] {
        let mut bench = Bench::enabled_with(slow_request());
        (1..=4).for_each(|tick| bench.set(slow_setpoint(tick)));
        for tick in 5..500 {
            bench.period();
            bench.set(slow_setpoint(tick));
        }
        assert!(bench.arm.motion().linear.velocity.norm() > 0.03);
        match code {
            FaultCode::StopCommanded => bench.command(Command::QuickStop),
            FaultCode::SetpointPastEnd => bench.set(nonsense),
            _ => {}
        }
        while bench.arm.state() == State::OperationEnabled {
            bench.period();
        }
        let latched_us = bench.now_us;
        while !bench.arm.status().standstill {
            bench.period();
        }
        assert_eq!(bench.fault(), Some(code));
        let took_us = bench.now_us - latched_us;
        assert!(took_us <= u64::from(GENTLE_STOP_US + PERIOD_US), "{code:?}: {took_us} us");
        bench.assert_limits_kept();
    }
}

/// Nor does it make the arm give up at the first setpoint that is lost.
#[test]
fn two_setpoints_lost_in_a_slow_session_heal() {
    let mut bench = Bench::enabled_with(slow_request());
    bench.stream(SLOW_END, |tick| (!(300..302).contains(&tick)).then(|| slow_setpoint(tick)));
    assert_eq!((bench.fault(), bench.arm.lost()), (None, 2));
}

#[test]
fn setpoints_without_sense_stop_the_arm() {
    let turned = Setpoint { tick: 6, counts: [0, 0, 0, 0, 31_500_000, 0] };
    let changed = Setpoint { counts: [1; 6], ..setpoint(4) };
    let cases = [
        (changed, FaultCode::SetpointRepeated),
        (setpoint(DEPTH + 3), FaultCode::SetpointBeyondCredit),
        (Setpoint { tick: END + 1, counts: [0; 6] }, FaultCode::SetpointPastEnd),
        (turned, FaultCode::SetpointNotRepresentable),
    ];
    for (bad, code) in cases {
        let mut bench = Bench::enabled();
        (1..=5).for_each(|tick| bench.set(setpoint(tick)));
        bench.period();
        bench.set(bad);
        bench.rest();
        assert_eq!((bench.fault(), bench.arm.state()), (Some(code), State::Fault));
        bench.assert_limits_kept();
    }
}

#[test]
fn a_motion_that_ends_without_coming_to_rest_is_stopped() {
    let mut bench = Bench::enabled_with(OpenRequest { end_tick: 50, ..request() });
    bench.stream(50, |tick| Some(setpoint(tick)));
    bench.rest();
    assert_eq!((bench.fault(), bench.arm.state()), (Some(FaultCode::ArmLinearAcceleration), State::Fault));
    bench.assert_limits_kept();
}

#[test]
fn between_ticks_the_arm_moves_without_jumps() {
    let mut bench = Bench::enabled();
    (1..=DEPTH).for_each(|tick| bench.set(setpoint(tick)));
    for tick in 1..END {
        bench.tick_without_jumps(tick);
        if tick + DEPTH <= END {
            bench.set(setpoint(tick + DEPTH));
        }
    }
}

#[test]
fn a_setpoint_that_will_be_refused_does_not_bend_the_path_before_it() {
    const BAD: u32 = 40;
    // A jump of 0.1 m among setpoints that are all within limits.
    let sent = |tick| {
        let mut setpoint = setpoint(tick);
        setpoint.counts[0] += if tick == BAD { 1_000_000 } else { 0 };
        setpoint
    };
    let mut bench = Bench::enabled();
    (1..=DEPTH).for_each(|tick| bench.set(sent(tick)));
    for tick in 1..END {
        bench.tick_without_jumps(tick);
        bench.set(sent((tick + DEPTH).min(END)));
    }
    assert_eq!((bench.fault(), bench.arm.state()), (Some(FaultCode::ArmLinearVelocity), State::Fault));
    assert_eq!(bench.arm.fault().map(|fault| fault.tick), Some(BAD - 1));
}

/// The controller's own transitions against the table that all share.
#[test]
fn states_follow_the_table() {
    let up = [Command::Shutdown, Command::SwitchOn, Command::EnableOperation];
    for command in Command::ALL {
        for steps in 0..=3 {
            let mut bench = Bench::new();
            bench.tell(ToArm::Open(request()));
            up[..steps].iter().for_each(|command| bench.command(*command));
            assert_obeys(&mut bench, command);
        }
        for moving in [false, true] {
            let mut stopping = Bench::enabled();
            (1..=DEPTH).for_each(|tick| stopping.set(setpoint(tick)));
            (0..10).for_each(|_| stopping.period());
            stopping.set(Setpoint { tick: END + 1, counts: [0; 6] });
            assert_eq!(stopping.arm.state(), State::FaultReactionActive);
            if !moving {
                stopping.rest();
                assert_eq!(stopping.arm.state(), State::Fault);
            }
            assert_obeys(&mut stopping, command);

            let mut running = Bench::enabled();
            (1..=DEPTH).for_each(|tick| running.set(setpoint(tick)));
            (0..10).for_each(|_| running.period());
            running.command(Command::QuickStop);
            assert!(!running.arm.status().standstill);
            if !moving {
                running.rest();
            }
            assert_obeys(&mut running, command);
        }
    }
}

fn assert_obeys(bench: &mut Bench, command: Command) {
    let (from, still) = (bench.arm.state(), bench.arm.status().standstill);
    let line = transition(from, Event::Command(command)).filter(|line| still || !line.at_standstill);
    bench.command(command);
    assert_eq!(bench.arm.state(), line.map_or(from, |line| line.to), "{} on {command:?}", from.name());
}

#[test]
fn what_a_session_has_said_before_does_not_move_the_arm_once_more() {
    for last_tick in [0, END] {
        let mut bench = Bench::enabled();
        bench.stream(END, |tick| (tick <= last_tick).then(|| setpoint(tick)));
        bench.rest();
        assert_eq!(bench.arm.state(), State::OperationEnabled);
        let end = bench.arm.pose();
        // Disable operation, and the way up again, by the very messages of the session.
        bench.command(Command::SwitchOn);
        assert_eq!((bench.arm.state(), bench.arm.status().session), (State::SwitchedOn, NO_SESSION));
        bench.tell(ToArm::Open(request()));
        assert!(bench.messages.contains(&FromArm::Refused { session: SESSION, reason: Refusal::Closed }));
        bench.command(Command::EnableOperation);
        (1..=DEPTH).for_each(|tick| bench.set(setpoint(tick)));
        (0..20).for_each(|_| bench.period());
        assert_eq!((bench.arm.pose(), bench.arm.anchor()), (end, None));
        // Nor does it keep its power.
        (0..20).for_each(|_| bench.period());
        assert_eq!(bench.arm.state(), State::SwitchOnDisabled);
        bench.tell(ToArm::Open(OpenRequest { session: SESSION + 1, ..request() }));
        assert_eq!(bench.arm.status().session, SESSION + 1);
    }
}

#[test]
fn power_that_a_session_leaves_on_is_not_the_next_ones() {
    let mut bench = Bench::enabled();
    bench.stream(END, |tick| Some(setpoint(tick)));
    bench.rest();
    bench.command(Command::SwitchOn);
    assert_eq!((bench.arm.state(), bench.arm.status().session), (State::SwitchedOn, NO_SESSION));
    bench.tell(ToArm::Open(OpenRequest { session: SESSION + 1, ..request() }));
    let status = bench.arm.status();
    assert_eq!((status.session, status.state), (SESSION + 1, State::SwitchOnDisabled));
}

/// A session that nobody keeps up, until it is over.
fn open_and_leave(bench: &mut Bench, request: OpenRequest) {
    bench.tell(ToArm::Open(request));
    assert_eq!(bench.arm.context().session, request.session);
    bench.alive = false;
    (0..31).for_each(|_| bench.period());
    assert_eq!(bench.arm.context(), Context::NONE);
}

#[test]
fn what_is_closed_stays_closed_while_others_come_and_go() {
    let mut bench = Bench::new();
    let sessions = [SESSION, SESSION + 1, SESSION + 2];
    sessions
        .iter()
        .for_each(|session| open_and_leave(&mut bench, OpenRequest { session: *session, ..request() }));
    for session in sessions {
        bench.tell(ToArm::Open(OpenRequest { session, ..request() }));
        assert!(bench.messages.contains(&FromArm::Refused { session, reason: Refusal::Closed }), "{session}");
        assert_eq!(bench.arm.context(), Context::NONE);
    }
}

#[test]
fn no_frame_of_a_session_passes_for_one_of_the_last_or_of_none() {
    let mut bench = Bench::new();
    let mut contexts = Vec::new();
    for session in 1..2_000 {
        bench.tell(ToArm::Open(OpenRequest { session, ..request() }));
        let context = bench.arm.context();
        assert!(context.session == session && context.is_usable(), "{context:?}");
        let last = contexts.iter().rev().take(16);
        assert!(last.into_iter().all(|before| !context.resembles(before)), "{context:?}");
        contexts.push(context);
        bench.alive = false;
        (0..31).for_each(|_| bench.period());
        assert_eq!(bench.arm.context(), Context::NONE);
    }
}

#[test]
fn a_request_that_differs_in_anything_does_not_replace_the_one_that_is_open() {
    let mut bench = Bench::new();
    bench.tell(ToArm::Open(request()));
    let context = bench.arm.context();
    bench.command(Command::Shutdown);
    let tight = Limits { linear_velocity_m_s: 0.1, ..limits() };
    for other in [
        OpenRequest { lsb: Lsb { translation_nm: 1_000, rotation_nrad: 10_000 }, ..request() },
        OpenRequest { plan_hash: 9, ..request() },
        OpenRequest { period_us: 20_000, ..request() },
        OpenRequest { end_tick: END + 1, ..request() },
        OpenRequest { limits: tight, ..request() },
        OpenRequest { start_level: 5, ..request() },
    ] {
        bench.messages.clear();
        bench.tell(ToArm::Open(other));
        assert!(bench.messages.contains(&FromArm::Refused { session: SESSION, reason: Refusal::Busy }));
        assert_eq!((bench.arm.context(), bench.arm.state()), (context, State::ReadyToSwitchOn));
    }
    // The same once more is answered once more, and changes nothing.
    bench.messages.clear();
    bench.tell(ToArm::Open(request()));
    assert!(is_opened(&bench, SESSION));
    assert_eq!((bench.arm.context(), bench.arm.state()), (context, State::ReadyToSwitchOn));
}

#[test]
fn counts_are_those_of_the_wire() {
    for (lsb, answer) in
        [(Lsb::default(), None), (Lsb { translation_nm: 99, ..Lsb::default() }, Some(Refusal::Counts))]
    {
        let mut bench = Bench::new();
        bench.arm.set_counts(Lsb::default());
        bench.tell(ToArm::Open(OpenRequest { lsb, ..request() }));
        assert_eq!(is_opened(&bench, SESSION), answer.is_none());
        let refused = answer.map(|reason| FromArm::Refused { session: SESSION, reason });
        assert!(refused.is_none_or(|refused| bench.messages.contains(&refused)));
    }
}

#[test]
fn whoever_asks_a_session_that_is_over_hears_how_it_ended() {
    let mut bench = Bench::enabled();
    bench.stream(END, |tick| Some(setpoint(tick)));
    bench.messages.clear();
    bench.command(Command::Shutdown);
    let farewells = |bench: &Bench| {
        let of_session = |message: &&FromArm| {
            matches!(message, FromArm::Status(status) if status.session == SESSION
            && status.state == State::ReadyToSwitchOn && status.standstill && status.applied_tick == END)
        };
        bench.messages.iter().filter(of_session).count()
    };
    assert_eq!((farewells(&bench), bench.arm.context()), (1, Context::NONE));
    Command::ALL.into_iter().for_each(|command| bench.command(command));
    assert_eq!((farewells(&bench), bench.arm.state()), (1 + Command::ALL.len(), State::ReadyToSwitchOn));
}

#[test]
fn a_session_that_is_over_is_not_told_that_an_arm_stands_which_moves_in_another() {
    let mut bench = Bench::enabled();
    bench.command(Command::Shutdown);
    let next = OpenRequest { session: SESSION + 1, ..request() };
    bench.tell(ToArm::Open(next));
    for command in [Command::SwitchOn, Command::EnableOperation] {
        bench.tell(ToArm::Control { session: next.session, command });
    }
    let says_that_it_stands = |bench: &mut Bench| {
        bench.messages.clear();
        bench.command(Command::QuickStop);
        let status = bench.messages.iter().find_map(|message| match message {
            FromArm::Status(status) if status.session == SESSION => Some(*status),
            _ => None,
        });
        status.unwrap().standstill
    };
    assert!(says_that_it_stands(&mut bench));
    for tick in 1..=DEPTH {
        bench.tell(ToArm::Setpoint { session: next.session, setpoint: setpoint(tick) });
    }
    bench.period();
    assert!(!bench.arm.status().standstill);
    assert!(!says_that_it_stands(&mut bench));
}

#[test]
fn setpoints_before_operation_is_enabled_move_nothing() {
    let up = [Command::Shutdown, Command::SwitchOn];
    for steps in 0..=up.len() {
        let mut bench = Bench::new();
        bench.tell(ToArm::Open(request()));
        up[..steps].iter().for_each(|command| bench.command(*command));
        let (state, pose) = (bench.arm.state(), bench.arm.pose());
        for tick in 1..=DEPTH {
            bench.set(setpoint(tick));
            bench.period();
        }
        assert_eq!((bench.arm.state(), bench.arm.pose(), bench.arm.has_moved()), (state, pose, false));
        assert!(bench.arm.status().standstill);
    }
}

#[test]
fn a_session_that_is_not_heard_of_is_over() {
    // Standing with power, armed: a fault. Without power: the session is closed, and another may come.
    for steps in 0..=3 {
        let mut bench = Bench::new();
        bench.alive = false;
        bench.tell(ToArm::Open(request()));
        let up = [Command::Shutdown, Command::SwitchOn, Command::EnableOperation];
        up[..steps].iter().for_each(|command| bench.command(*command));
        (0..29).for_each(|_| bench.period());
        assert_eq!((bench.arm.context().session, bench.fault()), (SESSION, None));
        bench.period();
        if steps == 3 {
            assert_eq!((bench.arm.state(), bench.fault()), (State::Fault, Some(FaultCode::ExecutorSilent)));
            continue;
        }
        assert_eq!((bench.arm.state(), bench.arm.context()), (State::SwitchOnDisabled, Context::NONE));
        bench.tell(ToArm::Open(OpenRequest { session: SESSION + 1, ..request() }));
        assert!(is_opened(&bench, SESSION + 1));
    }
}

#[test]
fn setpoints_that_are_said_again_keep_no_arm_enabled() {
    // Less than starts its clock; then an arm at rest on the last setpoint.
    for (ticks, again) in [(START_LEVEL as u32 - 1, 1), (END, END)] {
        let mut bench = Bench::enabled();
        bench.stream(ticks, |tick| (tick <= ticks).then(|| setpoint(tick)));
        (0..20).for_each(|_| bench.period());
        assert_eq!((bench.arm.state(), bench.arm.status().standstill), (State::OperationEnabled, true));
        bench.alive = false;
        let silent_us = bench.now_us;
        while bench.arm.state() == State::OperationEnabled {
            bench.set(setpoint(again));
            bench.period();
            assert!(bench.now_us - silent_us <= DEFAULT_WATCHDOG_US, "after {ticks}");
        }
        assert_eq!(bench.fault(), Some(FaultCode::ExecutorSilent));
    }
}

#[test]
fn an_executor_that_falls_silent_stops_the_arm_though_it_has_setpoints_left() {
    let mut bench = Bench::enabled_with(OpenRequest { period_us: 100_000, end_tick: 20, ..request() });
    bench.alive = false;
    let setpoint = |tick| Setpoint { tick, counts: [(tick * tick * 400) as i32, 0, 0, 0, 0, 0] };
    (1..=DEPTH).for_each(|tick| bench.set(setpoint(tick)));
    let silent_us = bench.now_us;
    while bench.arm.state() == State::OperationEnabled {
        bench.now_us += 1_000;
        bench.arm.poll(bench.now_us);
    }
    assert_eq!(bench.fault(), Some(FaultCode::ExecutorSilent));
    assert_eq!(bench.now_us - silent_us, DEFAULT_WATCHDOG_US);
}

#[test]
fn holding_at_the_end_without_an_executor_is_a_fault_too() {
    let mut bench = Bench::enabled();
    bench.stream(END, |tick| Some(setpoint(tick)));
    assert_eq!(bench.arm.status().phase, Some(Phase::Holding));
    bench.alive = false;
    bench.rest();
    assert_eq!((bench.arm.state(), bench.fault()), (State::Fault, Some(FaultCode::ExecutorSilent)));
}

#[test]
fn a_latched_stop_is_left_by_an_explicit_reset_at_standstill_only_and_by_any_session_that_knows_of_it() {
    let stops = [
        (ToArm::Stop, State::QuickStopActive, Command::DisableVoltage),
        (
            ToArm::Setpoint { session: SESSION, setpoint: Setpoint { tick: END + 1, counts: [0; 6] } },
            State::Fault,
            Command::FaultReset,
        ),
    ];
    for (stop, latched, reset) in stops {
        let mut bench = Bench::enabled();
        (1..=DEPTH).for_each(|tick| bench.set(setpoint(tick)));
        (0..10).for_each(|_| bench.period());
        bench.tell(stop);
        let ask = |reset_nonce| ToArm::Open(OpenRequest { session: SESSION + 1, reset_nonce, ..request() });
        bench.tell(ask(0));
        let nonce = latched_nonce(&bench);
        bench.tell(ask(nonce));
        assert!(bench.arm.fault().is_some() && !bench.arm.status().standstill);
        bench.rest();
        assert_eq!(bench.arm.state(), latched);
        // Nothing that anybody could have recorded, or made up, resets it.
        for command in Command::ALL {
            bench.tell(ToArm::Control { session: NO_SESSION, command });
            assert_eq!(bench.arm.state(), latched);
        }
        for wrong in [0, 1, nonce ^ 1] {
            bench.tell(ask(wrong));
            assert_eq!(bench.arm.state(), latched);
        }
        bench.tell(ask(nonce));
        assert_eq!((bench.arm.state(), bench.arm.fault()), (State::SwitchOnDisabled, None));
        // The old session is gone; a new one starts from where the arm is, and what has reset this stop resets no other.
        assert!(is_opened(&bench, SESSION + 1));
        bench.command(Command::Shutdown);
        assert_eq!(bench.arm.state(), State::SwitchOnDisabled);
        let up = [Command::Shutdown, Command::SwitchOn, Command::EnableOperation];
        up.iter().for_each(|command| bench.tell(ToArm::Control { session: SESSION + 1, command: *command }));
        bench.tell(ToArm::Stop);
        bench.tell(ask(nonce));
        assert_eq!(bench.arm.state(), State::QuickStopActive);
        // In the session itself, the command of the states does it.
        let mut bench = Bench::enabled();
        bench.tell(stop);
        bench.command(reset);
        assert_eq!((bench.arm.state(), bench.arm.fault()), (State::SwitchOnDisabled, None));
    }
}

#[test]
fn a_stop_frame_stops_harder_than_a_quick_stop() {
    let ticks_to_rest = |stop: ToArm| {
        let slow = Limits { linear_acceleration_m_s2: 1.5, angular_acceleration_rad_s2: 4.0, ..limits() };
        let mut bench = Bench::new();
        let own = limits();
        bench.arm = Controller::new(ArmConfig { limits: own, ..ArmConfig::ideal(start()) });
        bench.tell(ToArm::Open(OpenRequest { limits: slow, ..request() }));
        [Command::Shutdown, Command::SwitchOn, Command::EnableOperation]
            .iter()
            .for_each(|command| bench.command(*command));
        (1..=DEPTH).for_each(|tick| bench.set(setpoint(tick)));
        for tick in 1..30 {
            bench.period();
            bench.set(setpoint(tick + DEPTH));
        }
        bench.tell(stop);
        let begun_us = bench.now_us;
        while !bench.arm.status().standstill {
            bench.period();
        }
        bench.assert_limits_kept();
        (bench.now_us - begun_us) / u64::from(PERIOD_US)
    };
    let (soft, hard) = (
        ticks_to_rest(ToArm::Control { session: SESSION, command: Command::QuickStop }),
        ticks_to_rest(ToArm::Stop),
    );
    assert!(hard < soft, "{hard} ticks, {soft} by quick stop");
}

/// On its way, at its fastest after 50 ticks.
fn under_way(ticks: u32) -> Bench {
    let mut bench = Bench::enabled();
    (1..=DEPTH).for_each(|tick| bench.set(setpoint(tick)));
    for tick in 1..=ticks {
        bench.period();
        bench.set(setpoint((tick + DEPTH).min(END)));
    }
    bench
}

/// Nobody has looked at the arm for so long.
fn hold_up(bench: &mut Bench, held_up_us: u64) {
    bench.now_us += held_up_us;
    bench.tell(ToArm::Heartbeat { session: SESSION });
}

/// Whatever the moment, a controller that wakes up finds the arm where one is that was stopped when it was last looked at, and
/// braked under its controller's eyes.
#[test]
fn an_arm_whose_controller_is_held_up_brakes_without_it() {
    let period_us = u64::from(PERIOD_US);
    for (ticks, held_up) in
        (1..END - 5).step_by(7).flat_map(|ticks| [4, 15, 300].map(|held_up| (ticks, held_up)))
    {
        for stopped_before in [false, true] {
            let (mut bench, mut twin) = (under_way(ticks), under_way(ticks));
            twin.command(Command::QuickStop);
            if stopped_before {
                bench.command(Command::QuickStop);
            }
            hold_up(&mut bench, held_up * period_us);
            (0..held_up).for_each(|_| twin.period());
            let wanted = if stopped_before { FaultCode::StopCommanded } else { FaultCode::ArmOverrun };
            assert_eq!(bench.fault(), Some(wanted));
            for _ in 0..100 {
                assert_eq!(bench.arm.pose(), twin.arm.pose(), "held up for {held_up} ticks after {ticks}");
                assert_eq!(bench.arm.status().standstill, twin.arm.status().standstill);
                bench.period();
                twin.period();
            }
            assert!(bench.arm.status().standstill);
            twin.assert_limits_kept();
        }
    }
}

#[test]
fn a_controller_that_was_held_up_stops_instead_of_catching_up() {
    for held_up_us in [20_000, 20_001, 150_000, 3_000_000] {
        let mut bench = under_way(29);
        bench.arm.take_ticks().for_each(drop);
        let before = bench.arm.pose();
        hold_up(&mut bench, held_up_us + u64::from(PERIOD_US));
        if held_up_us <= 20_000 {
            assert_eq!(bench.fault(), None);
            continue;
        }
        assert_eq!(bench.fault(), Some(FaultCode::ArmOverrun));
        let woken_at = bench.arm.pose();
        bench.rest();
        assert_eq!(bench.arm.state(), State::Fault);
        // What is written down has each tick, those too that nobody saw.
        let mut seen = under_way(29).seen;
        let (mut peak, mut ticks, mut stands_at) = ([0.0_f64; 6], 0, before);
        for tick in bench.arm.take_ticks() {
            seen = seen.moved_to(tick.pose, PERIOD_US);
            std::iter::zip(&mut peak, seen.norms()).for_each(|(peak, value)| *peak = peak.max(value));
            (ticks, stands_at) = (ticks + 1, tick.pose);
        }
        assert!((20..GENTLE_STOP_US / PERIOD_US + 3).contains(&ticks), "{ticks}");
        assert_eq!(stands_at, bench.arm.pose());
        Bench { peak, ..bench }.assert_limits_kept();
        // By then it has long stood.
        assert!(held_up_us < 1_000_000 || woken_at == stands_at);
    }
}

#[test]
fn an_armed_arm_says_what_it_has_and_repeats_its_anchor() {
    let mut bench = Bench::enabled();
    bench.messages.clear();
    bench.set(setpoint(1));
    bench.set(setpoint(3));
    assert!(matches!(bench.messages.last(), Some(FromArm::Status(status)) if status.have == 0b101));
    bench.messages.clear();
    bench.command(Command::EnableOperation);
    assert!(bench.messages.contains(&FromArm::Anchored { session: SESSION, pose: start() }));
    assert_eq!(bench.arm.status().have, 0b101);
}

#[test]
fn at_rest_the_arm_repeats_all_that_may_have_been_missed() {
    let mut bench = Bench::enabled();
    bench.stream(END, |tick| Some(setpoint(tick)));
    bench.messages.clear();
    (0..10).for_each(|_| bench.period());
    let end = setpoint(END);
    assert!(bench.messages.contains(&FromArm::Actual { session: SESSION, reached: end }));
    assert!(bench.messages.iter().any(|message| matches!(message, FromArm::Heartbeat(_))));
    let holding = |message: &FromArm| matches!(message, FromArm::Status(status) if status.phase == Some(Phase::Holding));
    assert!(bench.messages.iter().any(holding));
    bench.tell(ToArm::Stop);
    bench.messages.clear();
    (0..10).for_each(|_| bench.period());
    let fault = bench.arm.fault().unwrap();
    assert!(bench.messages.contains(&FromArm::Fault { session: SESSION, fault: fault.into() }));
}

#[test]
fn an_arm_that_does_not_follow_its_commands_stops_by_itself() {
    // Drives of 10 ms are the simulated arms' own; with 1 s an arm hardly moves.
    for (time_constant_s, found) in [(0.010, None), (1.0, Some(FaultCode::ArmFollowing))] {
        let arm = Arm::new(ArmModel::bench(), Lag { time_constant_s }, over_the_bench()).unwrap();
        let mut bench = Bench::new();
        bench.arm = Controller::new(ArmConfig { arm, ..ArmConfig::ideal(over_the_bench()) });
        let wide = Limits { workspace_min_m: [-1.0; 3], ..limits() };
        bench.tell(ToArm::Open(OpenRequest { limits: wide, ..request() }));
        [Command::Shutdown, Command::SwitchOn, Command::EnableOperation]
            .iter()
            .for_each(|command| bench.command(*command));
        (1..=DEPTH).for_each(|tick| bench.set(setpoint_of(tick, 0.1, 0.5)));
        for tick in 1..END + 20 {
            bench.period();
            bench.set(setpoint_of((tick + DEPTH).min(END), 0.1, 0.5));
        }
        assert_eq!(bench.fault(), found, "{time_constant_s} s");
        if found.is_some() {
            assert_eq!(bench.arm.state(), State::Fault);
            // It has not come to where its stop ended, and does not creep there either.
            let stands_at = bench.arm.pose();
            bench.rest();
            assert_eq!(bench.arm.pose(), stands_at);
        }
    }
}

/// Over the default bench, as the arm's model is mounted.
fn over_the_bench() -> Pose {
    Pose { position_m: Vector3::new(0.05, 0.04, 0.12), ..Pose::identity() }
}

#[test]
fn an_arm_with_joints_that_lag_settles_on_the_last_setpoint_before_it_says_so() {
    let mut bench = Bench::new();
    bench.arm = Controller::new(ArmConfig::jointed(ArmModel::bench(), over_the_bench()).unwrap());
    let wide = Limits { workspace_min_m: [-1.0; 3], ..limits() };
    bench.tell(ToArm::Open(OpenRequest { limits: wide, ..request() }));
    [Command::Shutdown, Command::SwitchOn, Command::EnableOperation]
        .iter()
        .for_each(|command| bench.command(*command));
    let mut late_m = 0.0_f64;
    (1..=DEPTH).for_each(|tick| bench.set(setpoint_of(tick, 0.1, 0.5)));
    for tick in 1..END + 20 {
        bench.period();
        bench.set(setpoint_of((tick + DEPTH).min(END), 0.1, 0.5));
        let due = pose_at(&over_the_bench(), setpoint_of(tick.min(END), 0.1, 0.5), Lsb::default());
        late_m = late_m.max(due.displacement_to(&bench.arm.pose()).translation().norm());
    }
    assert_eq!((bench.fault(), bench.arm.status().phase), (None, Some(Phase::Holding)));
    // It was late by about its time constant times its speed, 10 ms of 0.19 m/s at the most, and arrived.
    assert!((1e-3..3e-3).contains(&late_m), "{late_m}");
    let reached = bench.messages.iter().rev().find_map(|message| match message {
        FromArm::Actual { reached, .. } => Some(*reached),
        _ => None,
    });
    assert_eq!(reached, Some(setpoint_of(END, 0.1, 0.5)));
}

/// How time passes for an arm between two setpoints: when it is looked at, in tenths of a period, and how long whoever looks
/// at it stays away once it stops, periods.
#[derive(Clone, Copy, Debug)]
struct Looks {
    tenths: &'static [u64],
    away: u64,
}

const LOOKS: [Looks; 4] = [
    Looks { tenths: &[10], away: 1 },
    Looks { tenths: &[5, 10], away: 1 },
    Looks { tenths: &[1, 2, 3, 4, 5, 6, 7, 8, 9, 10], away: 10 },
    Looks { tenths: &[10], away: 10 },
];

/// An arm with joints, on its way over the bench.
struct Jointed {
    bench: Bench,
    model: ArmModel,
    looks: Looks,
    length_m: f64,
    angle_rad: f64,
    ticks: u32,
    sent: u32,
}

impl Jointed {
    fn new(
        (model, lag): (ArmModel, Lag),
        (length_m, angle_rad): (f64, f64),
        ticks: u32,
        looks: Looks,
    ) -> Self {
        let arm = Arm::new(model, lag, over_the_bench()).unwrap();
        let mut bench = Bench::new();
        bench.arm = Controller::new(ArmConfig { arm, ..ArmConfig::ideal(over_the_bench()) });
        bench.arm.take_ticks().for_each(drop);
        let mut jointed = Self { bench, model, looks, length_m, angle_rad, ticks, sent: 0 };
        jointed.enable(SESSION);
        jointed
    }

    fn enable(&mut self, session: u16) {
        let wide = Limits {
            workspace_min_m: [-2.0; 3],
            workspace_max_m: [2.0; 3],
            linear_velocity_m_s: 3.0,
            linear_acceleration_m_s2: 9.0,
            linear_jerk_m_s3: 400.0,
            angular_velocity_rad_s: 6.0,
            angular_acceleration_rad_s2: 40.0,
            angular_jerk_rad_s3: 2_000.0,
        };
        self.bench.tell(ToArm::Open(OpenRequest {
            limits: wide,
            session,
            end_tick: self.ticks,
            ..request()
        }));
        for command in [Command::Shutdown, Command::SwitchOn, Command::EnableOperation] {
            self.bench.tell(ToArm::Control { session, command });
        }
        assert_eq!(self.bench.arm.state(), State::OperationEnabled);
    }

    fn send(&mut self, upto: u32) {
        while self.sent < upto.min(self.ticks) {
            self.sent += 1;
            let s = smooth(f64::from(self.sent) / f64::from(self.ticks));
            let cumulative = Displacement {
                translation_m: [self.length_m * s, 0.0, 0.0],
                rotation_rad: [0.0, self.angle_rad * s, 0.0],
            };
            self.bench.set(Setpoint::from_cumulative(self.sent, &cumulative, Lsb::default()).unwrap());
        }
    }

    /// So many ticks, or until something stops it.
    fn go(&mut self, ticks: u32) {
        self.send(DEPTH);
        for tick in 1..=ticks {
            let begun_us = self.bench.now_us;
            for tenth in self.looks.tenths {
                self.bench.now_us = begun_us + tenth * u64::from(PERIOD_US) / 10;
                self.bench.tell(ToArm::Heartbeat { session: SESSION });
            }
            if self.bench.arm.state() != State::OperationEnabled {
                return;
            }
            self.send(tick + DEPTH);
        }
    }

    /// Until long after it stands; from then on it may settle by a fraction of a count, and no more.
    fn stand(&mut self) -> Pose {
        let mut stands_at = None;
        for _ in 0..200 / self.looks.away {
            self.bench.now_us += self.looks.away * u64::from(PERIOD_US);
            self.bench.tell(ToArm::Heartbeat { session: SESSION });
            if self.bench.arm.status().standstill {
                let pose = self.bench.arm.pose();
                let moved = stands_at.get_or_insert(pose).displacement_to(&pose);
                assert!(moved.components().iter().all(|x| x.abs() < 1e-7), "{moved:?} after it stood");
            }
        }
        stands_at.unwrap()
    }

    /// At each tick the most that a joint turned at, as a share of its speed, and sped up or slowed down with, rad/s^2.
    fn hardness(&mut self) -> Vec<[f64; 2]> {
        let h = f64::from(PERIOD_US) / 1e6;
        let (mut last, mut speeds) = (None, [0.0; 6]);
        let hardness = |tick: Tick| {
            let joints = tick.joints.unwrap();
            let moves = std::iter::zip(last.replace(joints).unwrap_or(joints), joints);
            let mut hardness = [0.0_f64; 2];
            for (((from, to), bound), speed) in moves.zip(self.model.joint_speed_rad_s).zip(&mut speeds) {
                let before = std::mem::replace(speed, (to - from) / h);
                hardness[0] = hardness[0].max(speed.abs() / bound);
                hardness[1] = hardness[1].max((*speed - before).abs() / h);
            }
            hardness
        };
        self.bench.arm.take_ticks().map(hardness).collect()
    }

    /// No joint turns faster than it may, nor brakes harder than the arm's own limit of 50 rad/s^2, or than the motion was at its
    /// hardest.
    fn assert_smooth(&mut self) {
        let taken = self.bench.arm.fault().unwrap().tick as usize;
        let hardness = self.hardness();
        let hardest = hardness.iter().take(taken + 2).fold(50.0_f64, |most, [_, of]| most.max(*of));
        for (tick, [speed, acceleration]) in hardness.iter().enumerate() {
            let smooth = *speed <= 1.0 && *acceleration <= hardest;
            assert!(smooth, "{speed} of its speed, {acceleration} rad/s^2 at {tick}, stopped at {taken}");
        }
    }
}

#[test]
fn what_the_joints_cannot_do_stops_the_arm_with_their_reason() {
    // Pitch is one joint, which turns at pi rad/s at the most: here at 4.8 and at 3.5 at its fastest. Then a metre to the side,
    // with joints for which nothing is too fast; less far and more slowly; and pitch with a joint that does not turn so far.
    let short = ArmModel { joint_range_rad: [2.5; 6], ..ArmModel::bench() };
    let fast = ArmModel { joint_speed_rad_s: [1e3; 6], ..ArmModel::bench() };
    let cases = [
        ((ArmModel::bench(), Lag::default()), (0.0, 1.8), 70, FaultCode::ArmJointSpeed),
        ((ArmModel::bench(), Lag::NONE), (0.0, 1.8), 96, FaultCode::ArmJointSpeed),
        ((fast, Lag::NONE), (1.0, 0.0), 100, FaultCode::ArmUnreachable),
        ((ArmModel::bench(), Lag::default()), (0.83, 0.0), 900, FaultCode::ArmSingular),
        ((short, Lag::default()), (0.0, -1.6), 100, FaultCode::ArmJointLimit),
    ];
    for (arm, way, ticks, code) in cases {
        let mut faults = Vec::new();
        for looks in LOOKS {
            let mut arm = Jointed::new(arm, way, ticks, looks);
            arm.go(ticks);
            let stands_at = arm.stand();
            assert_eq!((arm.bench.fault(), arm.bench.arm.state()), (Some(code), State::Fault), "{looks:?}");
            arm.assert_smooth();
            faults.push(arm.bench.arm.fault());
            // Nor does it leap when the next session takes it over.
            arm.bench.command(Command::FaultReset);
            arm.enable(SESSION + 1);
            (0..20).for_each(|_| arm.bench.period());
            let moved = stands_at.displacement_to(&arm.bench.arm.pose());
            assert!(moved.components().iter().all(|x| x.abs() < 1e-7), "{moved:?}");
        }
        // Whoever looks, and when, has no say in it.
        faults.dedup();
        assert_eq!(faults.len(), 1, "{faults:?}");
    }
}

#[test]
fn a_commanded_stop_keeps_what_the_joints_can_at_any_moment() {
    // At its fastest 3.1 rad/s of pi; and up to the tick from which on it would be faster. A stop while it speeds up must not be.
    let slow = (1..END).step_by(3).map(|after| (1.655, END, after));
    let fast = (1..=19).map(|after| (1.8, 70, after));
    for (angle_rad, ticks, after) in slow.chain(fast) {
        for looks in LOOKS {
            for stop in [ToArm::Stop, ToArm::Control { session: SESSION, command: Command::QuickStop }] {
                let arm = (ArmModel::bench(), Lag::default());
                let mut arm = Jointed::new(arm, (0.0, angle_rad), ticks, looks);
                arm.go(after);
                arm.bench.tell(stop);
                arm.stand();
                assert_eq!(arm.bench.arm.state(), State::QuickStopActive);
                arm.assert_smooth();
            }
        }
    }
}
