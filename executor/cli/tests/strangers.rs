//! What somebody else on the wire does, or says once more: a stop on the way up stays a stop, a session that is over stops nobody,
//! and an arm that brakes does not seem to stand.

mod common;

use common::{header, one_move, plan_bytes};
use powderline_executor::{Action, Config, Executor, Outcome};
use powderline_firmware_sim::controller::{ArmConfig, Controller};
use powderline_shared::fault::{Fault, FaultCode, Reported};
use powderline_shared::plan::PlanReader;
use powderline_shared::wire::message::{FromArm, Heartbeat, NO_SESSION, Refusal, Status, ToArm};
use powderline_shared::wire::state::{Command, Phase, State};

/// An arm where the plan begins, and an executor that is to play it.
fn at_start<'p>(plan: &PlanReader<'p>) -> (Controller, Executor<'p>) {
    let arm = Controller::new(ArmConfig::ideal(plan.header().start_pose()));
    (arm, Executor::new(0, plan, Config::default()))
}

/// What an executor has to say at this moment; how it has ended, if it has.
fn spoken(executor: &mut Executor<'_>, now_us: u64, mut say: impl FnMut(ToArm)) -> Option<Outcome> {
    loop {
        match executor.poll(now_us) {
            Action::Send(message) => say(message),
            Action::Wait => return None,
            Action::Finished(outcome) => return Some(outcome),
        }
    }
}

fn own_status(message: &FromArm) -> Option<Status> {
    match message {
        FromArm::Status(status) if status.session != NO_SESSION => Some(*status),
        _ => None,
    }
}

#[test]
fn an_arm_that_somebody_stops_on_its_way_up_is_not_led_up_again() {
    let bytes = plan_bytes(&header(), &one_move());
    let plan = PlanReader::new(&bytes).unwrap();
    // None: as soon as the session is open, before the arm has been asked for anything.
    for stopped_after in [None, Some(Command::Shutdown), Some(Command::SwitchOn)] {
        let (mut arm, mut executor) = at_start(&plan);
        let (mut now_us, mut enabled, mut stops) = (0, false, 0);
        let outcome = loop {
            while let Some(message) = arm.poll(now_us) {
                enabled |= own_status(&message).is_some_and(|status| status.state == State::OperationEnabled);
                executor.handle_message(now_us, &message);
            }
            let mut told = Vec::new();
            let said = spoken(&mut executor, now_us, |message| {
                arm.handle_message(now_us, &message);
                let asked = match message {
                    ToArm::Control { command, .. } => stopped_after == Some(command),
                    ToArm::Open(_) => stopped_after.is_none(),
                    _ => false,
                };
                if asked && stops == 0 {
                    // The arm tells of its step before somebody stops it.
                    told.extend(std::iter::from_fn(|| arm.poll(now_us)));
                    arm.handle_message(now_us, &ToArm::Stop);
                    stops += 1;
                }
            });
            told.iter().for_each(|message| executor.handle_message(now_us, message));
            if let Some(outcome) = said {
                break outcome;
            }
            now_us += 1_000;
            assert!(now_us < 30_000_000, "the session never ends");
        };
        let Outcome::Stopped { fault, standstill } = outcome else { panic!("{outcome:?}") };
        assert!(!enabled && stops == 1, "{stopped_after:?}");
        assert_eq!((fault.code, standstill), (FaultCode::SoftwareStop, true), "{stopped_after:?}");
        // It stays stopped, whoever comes next.
        assert_eq!(arm.state(), State::QuickStopActive, "{stopped_after:?}");
    }
}

/// On its way up, and when it is let go at the end; whatever becomes of the frames that bear the reason.
#[test]
fn a_stop_ends_the_motion_though_its_reason_is_lost() {
    let bytes = plan_bytes(&header(), &one_move());
    let plan = PlanReader::new(&bytes).unwrap();
    for at_end in [false, true] {
        let (mut arm, mut executor) = at_start(&plan);
        let (mut now_us, mut stopped_us) = (0, None);
        let outcome = loop {
            while let Some(message) = arm.poll(now_us) {
                if !matches!(message, FromArm::Fault { .. }) {
                    executor.handle_message(now_us, &message);
                }
            }
            let said = spoken(&mut executor, now_us, |message| {
                let holds = arm.status().phase == Some(Phase::Holding);
                let lets_go = matches!(message, ToArm::Control { command: Command::Shutdown, .. });
                if lets_go && holds == at_end && stopped_us.is_none() {
                    arm.handle_message(now_us, &ToArm::Stop);
                    stopped_us = Some(now_us);
                }
                arm.handle_message(now_us, &message);
            });
            if let Some(outcome) = said {
                break outcome;
            }
            now_us += 1_000;
            assert!(now_us < 30_000_000, "the session never ends");
        };
        let Outcome::Stopped { fault, standstill } = outcome else { panic!("{outcome:?}") };
        assert_eq!((fault.code, standstill), (FaultCode::StateUnexpected, true), "{at_end}");
        let took_us = now_us - stopped_us.expect("it was stopped");
        assert!(took_us < 1_000_000, "{at_end}: {took_us}");
    }
}

/// A person has looked at what had stopped the arm, and not at what stops it while the answer is waited for.
#[test]
fn a_reset_takes_the_arm_out_of_no_stop_that_came_after_it_was_asked_for() {
    let bytes = plan_bytes(&header(), &one_move());
    let plan = PlanReader::new(&bytes).unwrap();
    let fault: Reported = Fault { code: FaultCode::SoftwareStop, tick: 0 }.into();
    let latched = |nonce| Refusal::Latched { fault, nonce };
    let heard = |reasons: &[Refusal]| {
        let mut executor = Executor::new(0, &plan, Config { reset: true, ..Config::default() });
        for (number, reason) in (0..).zip(reasons) {
            let mut session = None;
            spoken(&mut executor, number * 100_000, |message| match message {
                ToArm::Open(request) => session = Some(request.session),
                other => panic!("{other:?}"),
            });
            let session = session.expect("it asks once more");
            executor.handle_message(number * 100_000, &FromArm::Refused { session, reason: *reason });
        }
        let mut resets = Vec::new();
        let end = spoken(&mut executor, 900_000, |message| match message {
            ToArm::Open(request) => resets.push(request.reset_nonce),
            other => panic!("{other:?}"),
        });
        // At once, and again.
        resets.dedup();
        assert_eq!(executor.is_stopped_anew(), end.is_some());
        (resets, end)
    };
    assert_eq!(heard(&[latched(7)]), (vec![7], None));
    // It moves yet, and says so again.
    assert_eq!(heard(&[latched(7), latched(7)]), (vec![7], None));
    assert_eq!(heard(&[Refusal::Closed, latched(7)]), (vec![7], None));
    let refused = Some(Outcome::Stopped {
        fault: Fault { code: FaultCode::SessionRefused, tick: 0 },
        standstill: false,
    });
    for since in [[Refusal::Busy, latched(7)], [latched(7), latched(8)]] {
        assert_eq!(heard(&since), (vec![], refused), "{since:?}");
    }
}

/// It was suspended, lost the arm by that, and comes back while somebody else moves it.
#[test]
fn an_executor_whose_session_is_over_stops_nobody_elses_motion() {
    let bytes = plan_bytes(&header(), &one_move());
    let plan = PlanReader::new(&bytes).unwrap();
    let (mut arm, mut suspended) = at_start(&plan);
    // It goes slowly, from where the arm has come to.
    let slowly = || Config {
        session: 2,
        reset: true,
        period_us: Some(40_000),
        anchor_tolerance_m: 0.05,
        anchor_tolerance_rad: 0.5,
        ..Config::default()
    };
    let (mut other, mut began_us) = (Executor::new(0, &plan, slowly()), None);
    let (mut now_us, mut unheard, mut ends) = (0, Vec::new(), [None, None]);
    while ends.contains(&None) {
        let moves_there = other.last_sent().is_some_and(|sent| sent.tick > 5);
        let is_suspended =
            suspended.session_status().is_some_and(|status| status.applied_tick > 0) && !moves_there;
        while let Some(message) = arm.poll(now_us) {
            let latched =
                matches!(message, FromArm::Status(Status { state: State::Fault, standstill: true, .. }));
            if latched && began_us.is_none() {
                other = Executor::new(now_us, &plan, slowly());
                began_us = Some(now_us);
            }
            other.handle_message(now_us, &message);
            unheard.push(message);
        }
        if !is_suspended && ends[0].is_none() {
            unheard.drain(..).for_each(|message| suspended.handle_message(now_us, &message));
            ends[0] = spoken(&mut suspended, now_us, |message| arm.handle_message(now_us, &message));
        }
        if began_us.is_some() && ends[1].is_none() {
            ends[1] = spoken(&mut other, now_us, |message| arm.handle_message(now_us, &message));
        }
        now_us += 1_000;
        assert!(now_us < 60_000_000, "a session never ends: {ends:?}");
    }
    assert_eq!(ends[1], Some(Outcome::Completed));
    assert!(matches!(ends[0], Some(Outcome::Stopped { .. })), "{ends:?}");
}

/// It answers in a session that it has closed meanwhile, and says otherwise that it is in none: that is one arm, not two.
#[test]
fn an_arm_that_has_closed_the_session_is_no_other_arm() {
    let bytes = plan_bytes(&header(), &one_move());
    let plan = PlanReader::new(&bytes).unwrap();
    let (mut arm, mut executor) = at_start(&plan);
    let mut now_us = 0;
    let mut status = loop {
        while let Some(message) = arm.poll(now_us) {
            executor.handle_message(now_us, &message);
        }
        if let Some(status) = executor.session_status() {
            break status;
        }
        assert_eq!(spoken(&mut executor, now_us, |message| arm.handle_message(now_us, &message)), None);
        now_us += 1_000;
        assert!(now_us < 1_000_000, "it is never opened");
    };
    let outcome = loop {
        now_us += 100_000;
        status.counter = status.counter.wrapping_add(1);
        executor.handle_message(now_us, &FromArm::Status(status));
        executor.handle_message(
            now_us,
            &FromArm::Heartbeat(Heartbeat { session: NO_SESSION, lost: 0, dropped: 0 }),
        );
        if let Some(outcome) = spoken(&mut executor, now_us, |_| ()) {
            break outcome;
        }
        assert!(now_us < 30_000_000, "the session never ends");
    };
    let Outcome::Stopped { fault, .. } = outcome else { panic!("{outcome:?}") };
    assert_eq!(fault.code, FaultCode::HandshakeTimeout);
}

/// By a node that repeats what it has heard, at a moment at which its counters are news.
#[test]
fn what_an_arm_said_on_its_way_up_is_no_standstill_when_somebody_says_it_again() {
    let bytes = plan_bytes(&header(), &one_move());
    let plan = PlanReader::new(&bytes).unwrap();
    let (mut arm, mut executor) = at_start(&plan);
    let (mut now_us, mut early, mut last) = (0, None, None);
    const STOP_US: u64 = 600_000;
    let outcome = loop {
        while let Some(message) = arm.poll(now_us) {
            if let Some(status) = own_status(&message) {
                last = Some(status);
                if status.state == State::ReadyToSwitchOn {
                    early = early.or(Some(status));
                }
            }
            executor.handle_message(now_us, &message);
        }
        if now_us == STOP_US {
            executor.handle_stop(now_us);
        }
        if let Some((number, early)) =
            (0..20u8).find(|number| now_us == STOP_US + 1_000 + u64::from(*number) * 10_000).zip(early)
        {
            let counter = last.map_or(0, |last| last.counter).wrapping_add(40 + number);
            executor.handle_message(now_us, &FromArm::Status(Status { counter, ..early }));
        }
        if let Some(outcome) = spoken(&mut executor, now_us, |message| arm.handle_message(now_us, &message)) {
            break outcome;
        }
        now_us += 1_000;
        assert!(now_us < 30_000_000, "the session never ends");
    };
    let Outcome::Stopped { fault, standstill } = outcome else { panic!("{outcome:?}") };
    assert!(early.is_some_and(|status| status.standstill));
    assert_eq!((fault.code, standstill), (FaultCode::OperatorStop, true));
    // And so it is.
    assert!(
        last.is_some_and(|status| status.standstill && status.state == State::QuickStopActive),
        "{last:?}"
    );
}
