//! What the executor's core costs in each control period: `cargo bench -p powderline-executor-cli`.
//!
//! A plan is played once to the simulated arm, over virtual time, and what the arm says in each control period is written
//! down. The executor is then given the same frames at the same times, again and again: nothing of the arm is measured.
//!
//! | figure    | what is done                                                              |
//! |-----------|---------------------------------------------------------------------------|
//! | `idle`    | one poll while streaming, with nothing to do                              |
//! | `poll_at` | asking when to poll next                                                  |
//! | `cycle`   | all of a control period                                                   |
//!
//! In a control period the arm's displacement and status are taken in, one setpoint is read off the plan, guarded, encoded
//! and handed out, and a last poll finds nothing more to do; in one of ten there are also the heartbeats of both ends, and a
//! second status. Overflow is checked, as in the program.
#![expect(missing_docs, reason = "what the macros of criterion write has none")]

#[path = "../tests/common/mod.rs"]
mod common;

use std::hint::black_box;
use std::time::{Duration, Instant};

use common::{header, one_move, plan_bytes};
use criterion::{Criterion, criterion_group, criterion_main};
use powderline_executor::{Config, Endpoint, FrameAction, Outcome};
use powderline_firmware_sim::controller::{ArmConfig, Controller};
use powderline_firmware_sim::endpoint::Endpoint as ArmEndpoint;
use powderline_shared::plan::PlanReader;
use powderline_shared::wire::frame::{Dialect, Frame};
use powderline_shared::wire::ids;
use powderline_shared::wire::state::Phase;

/// A control period of a session.
struct Cycle {
    now_us: u64,
    /// What the arm says.
    heard: Vec<Frame>,
    /// How many frames the executor says.
    said: usize,
}

/// The part of a session in which every control period is like the other, and the executor before it.
struct Stream<'p> {
    endpoint: Endpoint<'p>,
    cycles: Vec<Cycle>,
}

/// Plays the plan to the simulated arm.
fn record<'p>(plan: &PlanReader<'p>, dialect: Dialect) -> Stream<'p> {
    let arm = Controller::new(ArmConfig::ideal(plan.header().start_pose()));
    let mut arm = ArmEndpoint::new(arm, dialect);
    let mut endpoint = Endpoint::new(0, plan, dialect, Config::default());
    let (mut start, mut cycles, mut now_us) = (None, Vec::new(), 0);
    loop {
        let before = endpoint.clone();
        let heard: Vec<Frame> = std::iter::from_fn(|| arm.poll(now_us)).collect();
        for frame in &heard {
            endpoint.handle_frame(now_us, frame).expect("the arm speaks the same language");
        }
        let (mut setpoints, mut said) = (0, 0);
        loop {
            match endpoint.poll(now_us) {
                FrameAction::Send(frame) => {
                    setpoints += u32::from(frame.id == ids::SETPOINT_T);
                    said += 1;
                    arm.handle_frame(now_us, &frame);
                }
                FrameAction::Wait => break,
                FrameAction::Finished(Outcome::Completed) => {
                    return Stream { endpoint: start.expect("it has streamed"), cycles };
                }
                FrameAction::Finished(Outcome::Stopped { fault, .. }) => panic!("stopped: {fault}"),
            }
        }
        if streams(&before) && streams(&endpoint) {
            let of = |id| heard.iter().filter(|frame| frame.id == id).count();
            assert!(of(ids::STATUS) >= 1, "no status at {now_us} us");
            assert_eq!((of(ids::ACTUAL_T), setpoints), (1, 1), "at {now_us} us");
            start.get_or_insert(before);
            cycles.push(Cycle { now_us, heard, said });
        }
        now_us += u64::from(plan.header().control_period_us);
    }
}

fn streams(endpoint: &Endpoint<'_>) -> bool {
    endpoint.executor().session_status().is_some_and(|status| status.phase == Some(Phase::Streaming))
}

/// Gives the executor what the arm says in a cycle, and takes what it says itself; how many frames that is.
fn run(endpoint: &mut Endpoint<'_>, cycle: &Cycle) -> usize {
    for frame in &cycle.heard {
        let _ = black_box(endpoint.handle_frame(cycle.now_us, black_box(frame)));
    }
    let mut said = 0;
    while let FrameAction::Send(frame) = endpoint.poll(cycle.now_us) {
        black_box(&frame);
        said += 1;
    }
    said
}

/// The executor after some of the cycles. It must say there what it said to the arm, or something else would be measured.
fn after<'p>(stream: &Stream<'p>, cycles: usize) -> Endpoint<'p> {
    let mut endpoint = stream.endpoint.clone();
    for cycle in stream.cycles.iter().take(cycles) {
        assert_eq!(run(&mut endpoint, cycle), cycle.said);
    }
    endpoint
}

fn time_cycles(stream: &Stream<'_>, iterations: u64) -> Duration {
    let (mut left, mut time) = (usize::try_from(iterations).expect("fewer than that"), Duration::ZERO);
    while left > 0 {
        let mut endpoint = stream.endpoint.clone();
        let some = left.min(stream.cycles.len());
        let began = Instant::now();
        for cycle in stream.cycles.iter().take(some) {
            black_box(run(&mut endpoint, cycle));
        }
        time += began.elapsed();
        left -= some;
    }
    time
}

fn executor(criterion: &mut Criterion) {
    let moves = [one_move(), one_move(), one_move()].concat();
    let bytes = plan_bytes(&header(), &moves);
    let plan = PlanReader::new(&bytes).expect("the plan is one");
    for (dialect, name) in [(Dialect::Classic, "classic"), (Dialect::Fd, "FD")] {
        let stream = record(&plan, dialect);
        assert!(stream.cycles.len() > 300, "{} cycles", stream.cycles.len());
        after(&stream, stream.cycles.len());
        let middle = stream.cycles.len() / 2;
        let (mut idle, now_us) = (after(&stream, middle), stream.cycles[middle - 1].now_us);
        assert_eq!(idle.poll(now_us), FrameAction::Wait);

        let mut group = criterion.benchmark_group(name);
        group.bench_function("idle", |bencher| bencher.iter(|| idle.poll(black_box(now_us))));
        group.bench_function("poll_at", |bencher| bencher.iter(|| black_box(&idle).poll_at()));
        group.bench_function("cycle", |bencher| {
            bencher.iter_custom(|iterations| time_cycles(&stream, iterations));
        });
        group.finish();
    }
}

criterion_group! {
    name = benches;
    config = Criterion::default()
        .warm_up_time(Duration::from_secs(1))
        .measurement_time(Duration::from_secs(3));
    targets = executor
}
criterion_main!(benches);
