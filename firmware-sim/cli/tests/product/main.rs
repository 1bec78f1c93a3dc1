//! A search over the product of the two state machines, message by message, for what may never happen.
//!
//! The world is one arm, up to two executors of different plans (three in the course of a run, each begun anew with the
//! session number that its predecessor had), at most three bursts of messages under way in each direction, and a time
//! that goes on to the next deadline of anybody, on a grid of half a control period. Messages are values; the codec has
//! no part in it. The plans have four to six setpoints, so that all of a session fits into the search: handshake, the
//! way up, streaming, the end, leaving, and every stop on the way.
//!
//! A regular run delivers each burst, in any order of the two directions, and lets time pass when nothing is under way.
//! Everything else is a deviation: a burst lost, or one message of it, delivered backwards, twice, or overtaken by the
//! next; time that passes while messages are under way; a watchdog time of silence on the wire, or of frozen executors;
//! an arm held up; an executor killed or begun, with and without reset; a command without a session, a stop frame, or
//! anything that an executor has said before, from a third node; an operator's stop, soft or hard; an executor told that
//! the wire is gone.
//!
//! **Exhaustive**: every regular run with up to two deviations of any kind, at any moment, for a slow clock (whose control
//! period is that of the heartbeat) and a fast one; and with up to four deviations of the wire alone.
//! **Abstracted**: two states are one if they agree in everything but the fields that [`projection`] leaves out by name:
//! real numbers, counts that only grow, and estimates of round trips; of what was said before, how much it is. The search
//! goes on from the one found first.
//!
//! Searched for, each printed with the steps that lead there:
//!
//! | what may never happen  | statement                                                                                 |
//! |------------------------|-------------------------------------------------------------------------------------------|
//! | motion without power   | the arm moves, or its clock runs, outside operation enabled, quick stop and fault reaction |
//! | two sessions, one arm  | a pose off the way of the anchored session's plan; a setpoint that is not its plan's; a session that gives way to another, is anchored twice, or moves after its executor has said that the arm stands |
//! | a latched stop left    | other than by a reset of a standing arm                                                   |
//! | a stop without reason  | a latched state without a latched fault                                                   |
//! | a false ending         | "completed" elsewhere than at the plan's end; "stands" while the arm moves                |
//! | no way out             | after silence, a reset without a session and a new executor, over a wire in order, do not end in a completed plan, or in "stands elsewhere" where it does |
//! | a stranger obeyed      | a command of anybody but the session, other than to leave a latched stop                  |
//! | no end, no rest        | an executor that hears nothing more goes on for ever; one that waits asks to be woken at once |

mod projection;
mod search;
mod world;

use std::collections::HashSet;

use powderline_shared::fault::FaultCode;
use powderline_shared::wire::state::State;
use search::{Deviations, Found};
use world::Scene;

/// Without optimisation there is time for one deviation less.
const OPTIMISED: bool = !cfg!(debug_assertions);

/// So many deviations, or one less.
fn most(deviations: usize) -> usize {
    if OPTIMISED { deviations } else { deviations.saturating_sub(1) }
}

fn assert_nothing_found(name: &str, found: &Found, least_states: usize) {
    println!("{name}: {found}");
    assert_eq!(found.breach_count, 0, "{found}");
    let states: usize = found.states.iter().sum();
    assert!(states >= if OPTIMISED { least_states } else { least_states / 50 }, "only {states} states");
    let arm_states: HashSet<_> =
        State::ALL.into_iter().filter(|state| *state != State::NotReadyToSwitchOn).collect();
    assert_eq!(found.arm_states, arm_states);
    let stages: Vec<_> = found.stages.iter().map(String::as_str).collect();
    assert_eq!(stages, ["Enabling", "Leaving", "Opening", "Stopping", "Streaming"]);
}

fn assert_seen<T: std::fmt::Debug + Eq + std::hash::Hash>(seen: &HashSet<T>, wanted: &[T]) {
    let missing: Vec<_> = wanted.iter().filter(|one| !seen.contains(one)).collect();
    assert!(missing.is_empty(), "never seen: {missing:?}");
}

/// Ways to end that take no more than one deviation.
const ENDINGS: [Option<FaultCode>; 10] = [
    None,
    Some(FaultCode::ArmSilent),
    Some(FaultCode::ExecutorSilent),
    Some(FaultCode::LinkLost),
    Some(FaultCode::SessionRefused),
    Some(FaultCode::AnchorElsewhere),
    Some(FaultCode::StateUnexpected),
    Some(FaultCode::HandshakeTimeout),
    Some(FaultCode::OperatorStop),
    Some(FaultCode::SoftwareStop),
];

/// What the arm latches within one deviation.
const ARM_FAULTS: [FaultCode; 4] =
    [FaultCode::ExecutorSilent, FaultCode::ArmOverrun, FaultCode::StopCommanded, FaultCode::SoftwareStop];

#[test]
fn two_deviations_of_any_kind_at_a_slow_clock() {
    let found = search::run(&Scene::new(100_000, 5), Deviations::All, most(2));
    assert_nothing_found("slow clock", &found, 120_000);
    assert_seen(&found.endings, &ENDINGS);
    assert_seen(&found.arm_faults, &ARM_FAULTS);
}

#[test]
fn two_deviations_of_any_kind_at_a_fast_clock() {
    let found = search::run(&Scene::new(20_000, 6), Deviations::All, most(2));
    assert_nothing_found("fast clock", &found, 120_000);
    assert_seen(&found.arm_faults, &ARM_FAULTS);
    if OPTIMISED {
        assert_seen(&found.arm_faults, &[FaultCode::SetpointMissing]);
    }
}

#[test]
fn four_deviations_of_the_wire() {
    let found = search::run(&Scene::new(100_000, 4), Deviations::Wire, most(4));
    assert_nothing_found("wire alone", &found, 100_000);
    assert_seen(&found.endings, &[None, Some(FaultCode::ArmSilent), Some(FaultCode::HandshakeTimeout)]);
}
