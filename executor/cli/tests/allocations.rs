//! The executor's core asks for no memory while it plays a plan: counted, call by call, over whole sessions. (`tests/no_std`
//! shows that it can do without an allocator; this shows that it uses none where there is one.)

mod common;

use allocation_counter::measure;
use common::{header, one_move, plan_bytes};
use powderline_executor::recorder::Recorder;
use powderline_executor::{Config, Endpoint, FrameAction, Outcome};
use powderline_firmware_sim::controller::{ArmConfig, Controller};
use powderline_firmware_sim::endpoint::Endpoint as ArmEndpoint;
use powderline_shared::fault::FaultCode;
use powderline_shared::plan::PlanReader;
use powderline_shared::wire::frame::{Dialect, Frame};

/// How often both ends are looked after, microseconds.
const STEP_US: usize = 1_000;

/// No session here takes longer, microseconds.
const LONGEST_US: u64 = 10_000_000;

/// A session, with what either end has asked of the allocator.
#[derive(Default)]
struct Session {
    outcome: Option<Outcome>,
    executor: u64,
    arm: u64,
    setpoints: u32,
    resent: u32,
}

/// Runs a part of one end and adds its allocations to a count.
fn counted<T>(count: &mut u64, work: impl FnOnce() -> T) -> T {
    let mut result = None;
    *count += measure(|| result = Some(work())).count_total;
    result.expect("it was run")
}

/// Plays a plan. `drops` says which of the executor's frames are lost, `stops_at_us` when a person stops it.
fn play(bytes: &[u8], dialect: Dialect, drops: impl Fn(u32) -> bool, stops_at_us: Option<u64>) -> Session {
    let mut session = Session::default();
    let count = &mut session.executor;
    let plan = counted(count, || PlanReader::new(bytes).unwrap());
    counted(count, || plan.check_limits().unwrap());
    let mut endpoint = counted(count, || Endpoint::new(0, &plan, dialect, Config::default()));
    let mut recorder = counted(count, Recorder::<64>::new);
    let arm = Controller::new(ArmConfig::ideal(plan.header().start_pose()));
    let mut arm = ArmEndpoint::new(arm, dialect);
    let mut sent = 0;
    for now_us in (0..LONGEST_US).step_by(STEP_US) {
        while let Some(frame) = counted(&mut session.arm, || arm.poll(now_us)) {
            hear(&mut session.executor, &mut endpoint, &mut recorder, now_us, &frame);
        }
        if stops_at_us == Some(now_us) {
            counted(&mut session.executor, || endpoint.executor_mut().handle_stop(now_us));
        }
        loop {
            match counted(&mut session.executor, || endpoint.poll(now_us)) {
                FrameAction::Send(frame) => {
                    counted(&mut session.executor, || recorder.record(now_us, &frame));
                    sent += 1;
                    if !drops(sent) {
                        counted(&mut session.arm, || arm.handle_frame(now_us, &frame));
                    }
                }
                FrameAction::Wait => break,
                FrameAction::Finished(outcome) => {
                    let telemetry = counted(&mut session.executor, || endpoint.executor().telemetry());
                    session.outcome = Some(outcome);
                    (session.setpoints, session.resent) = (telemetry.sent, telemetry.resent);
                    return session;
                }
            }
        }
        counted(&mut session.executor, || endpoint.poll_at());
    }
    session
}

fn hear(
    count: &mut u64,
    endpoint: &mut Endpoint<'_>,
    recorder: &mut Recorder<64>,
    now_us: u64,
    frame: &Frame,
) {
    counted(count, || recorder.record(now_us, frame));
    counted(count, || endpoint.handle_frame(now_us, frame)).unwrap();
}

#[test]
fn what_is_allocated_is_counted() {
    let mut count = 0;
    counted(&mut count, || std::hint::black_box(vec![1_u8; 3]));
    assert_eq!(count, 1);
}

#[test]
fn a_whole_session_allocates_nothing_in_the_executor() {
    let bytes = plan_bytes(&header(), &one_move());
    for dialect in Dialect::ALL {
        let session = play(&bytes, dialect, |_| false, None);
        assert_eq!((session.outcome, session.setpoints), (Some(Outcome::Completed), 120));
        assert_eq!(session.executor, 0, "{dialect:?}");
        // The simulated arm, which runs on hosts only, is not held to it.
        println!("{dialect:?}: executor {} allocations, simulated arm {}", session.executor, session.arm);
    }
}

#[test]
fn nor_does_one_that_loses_frames() {
    let bytes = plan_bytes(&header(), &one_move());
    for dialect in Dialect::ALL {
        // Not each ninth: a classic request has 18 segments, of which it would always lose the same two.
        let session = play(&bytes, dialect, |sent| sent % 7 == 0, None);
        assert_eq!(session.outcome, Some(Outcome::Completed));
        assert!(session.resent > 5, "{}", session.resent);
        assert_eq!(session.executor, 0, "{dialect:?}");
    }
}

#[test]
fn nor_does_a_stop() {
    let bytes = plan_bytes(&header(), &one_move());
    for dialect in Dialect::ALL {
        let session = play(&bytes, dialect, |_| false, Some(700_000));
        let Some(Outcome::Stopped { fault, standstill: true }) = session.outcome else {
            panic!("{:?}", session.outcome)
        };
        assert_eq!((fault.code, session.executor), (FaultCode::OperatorStop, 0), "{dialect:?}");
    }
}
