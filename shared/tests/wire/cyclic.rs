//! Setpoints and reports under loss, repetition and reordering; sessions that are not this one.

use powderline_shared::displacement::{Lsb, Setpoint};
use powderline_shared::limits::Limits;
use powderline_shared::wire::Context;
use powderline_shared::wire::codec::{Encoder, Rejected, ToArmDecoder};
use powderline_shared::wire::frame::{Dialect, Frame};
use powderline_shared::wire::message::{FromArm, NO_SESSION, OpenRequest, ToArm};
use powderline_shared::wire::state::Command;
use proptest::prelude::*;

use crate::samples::{
    self, CONTEXT, SESSION, arm, executor, frames_from_arm, frames_to_arm, heard, setpoint,
};

fn halves(tick: u32, count: i32) -> [Frame; 2] {
    frames_to_arm(Dialect::Classic, &[setpoint(tick, [count; 6])]).try_into().unwrap()
}

#[test]
fn a_half_alone_moves_nothing() {
    let mut decoder = arm(Dialect::Classic);
    for tick in 1..=20 {
        let [translation, rotation] = halves(tick, 5);
        let sent = if tick % 2 == 0 { translation } else { rotation };
        assert_eq!(decoder.handle_frame(&sent).unwrap().len(), 0);
    }
}

#[test]
fn halves_of_different_ticks_are_no_pair() {
    let mut decoder = arm(Dialect::Classic);
    let ([first, _], [_, second]) = (halves(1, 5), halves(2, 5));
    assert!(heard(&[first, second], |frame| decoder.handle_frame(frame)).is_empty());
    // Nor are those whose ticks differ by what the frames do not hold.
    let ([_, far], [near, _]) = (halves(1 + 256, 5), halves(1, 5));
    assert!(heard(&[near], |frame| decoder.handle_frame(frame)).is_empty());
    assert_eq!(decoder.handle_frame(&far), Err(Rejected::Checksum { id: 0x301 }));
}

#[test]
fn a_repeated_half_is_harmless() {
    let mut decoder = arm(Dialect::Classic);
    let [translation, rotation] = halves(1, 5);
    let frames = [&translation, &translation, &rotation, &rotation, &translation].map(Clone::clone);
    let message = setpoint(1, [5; 6]);
    // The last two are a whole setpoint again: what to make of that is for the arm to know.
    assert_eq!(heard(&frames, |frame| decoder.handle_frame(frame)), [message, message]);
}

#[test]
fn a_contradiction_is_refused_and_healed_by_sending_again() {
    let mut decoder = arm(Dialect::Classic);
    let ([one, _], [other, rotation]) = (halves(1, 5), halves(1, 6));
    assert!(decoder.handle_frame(&one).unwrap().is_empty());
    assert_eq!(decoder.handle_frame(&other), Err(Rejected::Contradiction { id: 0x201, tick: 1 }));
    assert!(decoder.handle_frame(&rotation).unwrap().is_empty());
    assert_eq!(*decoder.handle_frame(&other).unwrap(), [setpoint(1, [6; 6])]);
}

#[test]
fn counts_are_rebuilt_within_the_window_and_refused_beyond() {
    for (by, within) in [(32_767, true), (-32_768, true), (32_768, false), (-32_769, false), (65_536, false)]
    {
        for start in [[0; 6], [1_000_000; 6], [-77_777; 6]] {
            let mut decoder = arm(Dialect::Classic);
            let mut at = Setpoint::ANCHOR;
            while at.counts != start {
                at.tick += 1;
                at.counts = at.counts.map(|count| count + (start[0] - count).clamp(-30_000, 30_000));
                let frames = frames_to_arm(Dialect::Classic, &[setpoint(at.tick, at.counts)]);
                assert_eq!(heard(&frames, |frame| decoder.handle_frame(frame)).len(), 1);
            }
            let next = setpoint(at.tick + 1, at.counts.map(|count| count + by));
            let frames = frames_to_arm(Dialect::Classic, &[next]);
            let found: Vec<_> = frames.iter().map(|frame| decoder.handle_frame(frame)).collect();
            if within {
                assert_eq!(found[1].as_deref(), Ok(&[next][..]), "{by}");
            } else {
                let refused = [0x201, 0x301].map(|id| Err(Rejected::Checksum { id }));
                assert_eq!(found, refused, "{by}");
            }
        }
    }
}

#[test]
fn ticks_are_rebuilt_across_many_lost_ones() {
    let mut decoder = arm(Dialect::Classic);
    for tick in [127, 254, 381, 300, 508] {
        let frames = halves(tick, 5);
        assert_eq!(heard(&frames, |frame| decoder.handle_frame(frame)), [setpoint(tick, [5; 6])]);
    }
    let [translation, _] = halves(508 + 128, 5);
    assert_eq!(decoder.handle_frame(&translation), Err(Rejected::Checksum { id: 0x201 }));
}

#[test]
fn a_report_is_found_again_by_what_was_sent() {
    let far = FromArm::Actual { session: SESSION, reached: Setpoint { tick: 900, counts: [90_000; 6] } };
    let frames = frames_from_arm(Dialect::Classic, &[far]);
    let mut decoder = executor(Dialect::Classic);
    assert_eq!(decoder.handle_frame(&frames[0]), Err(Rejected::Checksum { id: 0x281 }));
    decoder.expect(Setpoint { tick: 916, counts: [100_000; 6] });
    assert_eq!(heard(&frames, |frame| decoder.handle_frame(frame)), [far]);
    // From then on the report itself is the reference.
    decoder.expect(Setpoint::ANCHOR);
    assert_eq!(heard(&frames, |frame| decoder.handle_frame(frame)), [far]);
}

#[test]
fn an_arm_that_stands_may_report_one_tick_with_other_counts() {
    let actual =
        |count| FromArm::Actual { session: SESSION, reached: Setpoint { tick: 3, counts: [count; 6] } };
    let mut decoder = executor(Dialect::Classic);
    let lost = frames_from_arm(Dialect::Classic, &[actual(1)]);
    assert!(heard(&lost[..1], |frame| decoder.handle_frame(frame)).is_empty());
    let frames = frames_from_arm(Dialect::Classic, &[actual(2)]);
    assert_eq!(heard(&frames, |frame| decoder.handle_frame(frame)), [actual(2)]);
}

#[test]
fn one_lost_fd_frame_is_made_good_by_the_next() {
    let at = |tick: u32| setpoint(tick, [i32::try_from(tick).unwrap() * 30_000; 6]);
    let frames = frames_to_arm(Dialect::Fd, &[at(1), at(2), at(3), at(4), at(5), at(6)]);
    let mut decoder = arm(Dialect::Fd);
    let mut take = |index: usize| decoder.handle_frame(&frames[index]).unwrap().to_vec();
    assert_eq!(take(1), [at(1), at(2)]);
    assert_eq!(take(2), [at(3)]);
    // Two in a row: only the second can be rebuilt; the first comes late and is still taken.
    assert_eq!(take(5), [at(5), at(6)]);
    assert_eq!(take(3), [at(4)]);
    // It had been rebuilt already: that it comes itself is a repetition like any other.
    assert_eq!(take(4), [at(5)]);
}

#[test]
fn a_displacement_that_does_not_fit_is_left_out() {
    let sent = [setpoint(1, [0; 6]), setpoint(2, [40_000, 0, 0, 0, 0, 0]), setpoint(9, [40_000; 6])];
    let frames = frames_to_arm(Dialect::Fd, &sent);
    let flags: Vec<u8> = frames.iter().map(|frame| frame.data[11]).collect();
    assert_eq!(flags, [1, 0, 0]);
    let mut decoder = arm(Dialect::Fd);
    assert_eq!(heard(&frames, |frame| decoder.handle_frame(frame)), sent);
    assert_eq!(*arm(Dialect::Fd).handle_frame(&frames[1]).unwrap(), [sent[1]]);
}

#[test]
fn sending_an_old_setpoint_again_does_not_spoil_the_next_displacement() {
    let at = |tick: u32| setpoint(tick, [i32::try_from(tick).unwrap() * 100; 6]);
    let frames = frames_to_arm(Dialect::Fd, &[at(1), at(2), at(3), at(1), at(2), at(4)]);
    let flags: Vec<u8> = frames.iter().map(|frame| frame.data[11]).collect();
    assert_eq!(flags, [1, 1, 1, 1, 0, 1]);
    assert_eq!(*arm(Dialect::Fd).handle_frame(&frames[5]).unwrap(), [at(3), at(4)]);
}

#[test]
fn a_new_session_of_the_same_number_starts_at_its_anchor() {
    let mut encoder = Encoder::new(Dialect::Fd);
    let (_, open) = samples::to_arm(Dialect::Fd).remove(0);
    for message in [open, setpoint(1, [7; 6]), setpoint(2, [7; 6]), open] {
        assert!(encoder.to_arm(&CONTEXT, &message).count() > 0);
    }
    let frame = encoder.to_arm(&CONTEXT, &setpoint(3, [9; 6])).next().unwrap();
    assert_eq!(frame.data[11], 0);
}

/// Contexts that must understand nothing of [`CONTEXT`]; two have byte 1 of the key in common with it.
fn foreign() -> [Context; 4] {
    let Context { session, seal, .. } = CONTEXT;
    [
        Context { session: session + 1, ..CONTEXT },
        Context { seal: seal ^ 1, ..CONTEXT },
        Context { session: session ^ 0x8000, seal: !seal, ..CONTEXT },
        Context::NONE,
    ]
}

/// Whether a frame of [`CONTEXT`] fails in another one: but for rotation halves, which then wait in vain.
fn is_damage(dialect: Dialect, frame: &Frame, context: Context) -> bool {
    let ([_, own, _], [_, other, _]) = (CONTEXT.key(), context.key());
    let rotation = [0x301, 0x381].contains(&frame.id);
    !(dialect == Dialect::Classic && rotation && own == other)
}

fn assert_not_understood<M: std::fmt::Debug>(
    dialect: Dialect,
    context: Context,
    frame: &Frame,
    found: Result<heapless::Vec<M, 2>, Rejected>,
) {
    match found {
        Err(rejected) => assert_eq!(rejected, Rejected::Checksum { id: frame.id }, "{dialect:?} {context:?}"),
        Ok(heard) => {
            assert!(heard.is_empty() && !is_damage(dialect, frame, context), "{dialect:?} {context:?}");
        }
    }
}

#[test]
fn sessions_that_could_be_taken_for_each_other_are_known_as_such() {
    assert!(CONTEXT.is_usable());
    assert!(foreign().iter().all(|context| !CONTEXT.resembles(context)));
    assert!(foreign().iter().any(|context| !is_damage(Dialect::Classic, &halves(1, 5)[1], *context)));
}

#[test]
fn another_session_or_plan_is_damage() {
    for dialect in Dialect::ALL {
        for context in foreign() {
            let mut decoder = ToArmDecoder::new(dialect);
            decoder.set_context(context);
            let messages = [setpoint(1, [5; 6]), ToArm::Heartbeat { session: SESSION }, control(SESSION)];
            for frame in frames_to_arm(dialect, &messages) {
                assert_not_understood(dialect, context, &frame, decoder.handle_frame(&frame));
            }
            let mut decoder = powderline_shared::wire::codec::FromArmDecoder::new(dialect);
            decoder.set_context(context);
            let messages: Vec<FromArm> =
                samples::from_arm().into_iter().map(|(_, message)| message).collect();
            for message in messages.into_iter().filter(|message| session_of(message) == Some(SESSION)) {
                for frame in frames_from_arm(dialect, &[message]) {
                    assert_not_understood(dialect, context, &frame, decoder.handle_frame(&frame));
                }
            }
        }
    }
}

fn control(session: u16) -> ToArm {
    ToArm::Control { session, command: Command::FaultReset }
}

/// Session of a message that depends on one.
fn session_of(message: &FromArm) -> Option<u16> {
    match message {
        FromArm::Status(status) => Some(status.session),
        FromArm::Actual { session, .. } | FromArm::Fault { session, .. } => Some(*session),
        FromArm::Heartbeat(heartbeat) => Some(heartbeat.session),
        FromArm::Opened { .. }
        | FromArm::OpenedKeyed { .. }
        | FromArm::Refused { .. }
        | FromArm::Anchored { .. } => None,
    }
}

#[test]
fn anybody_may_stop_an_arm_and_nothing_more() {
    for dialect in Dialect::ALL {
        let mut decoder = arm(dialect);
        let found = heard(&frames_to_arm(dialect, &[ToArm::Stop]), |frame| decoder.handle_frame(frame));
        assert_eq!(found, [ToArm::Stop]);
        let setpoint = Setpoint { tick: 1, counts: [0; 6] };
        let messages = [
            control(NO_SESSION),
            ToArm::Setpoint { session: NO_SESSION, setpoint },
            ToArm::Heartbeat { session: NO_SESSION },
        ];
        for frame in frames_to_arm(dialect, &messages) {
            assert_eq!(decoder.handle_frame(&frame), Err(Rejected::Checksum { id: frame.id }));
        }
    }
}

#[test]
fn the_sessions_seal_is_that_of_its_request_and_nonce() {
    let request = samples::open_request(Dialect::Classic);
    assert_eq!(Context::sealed(&request, samples::NONCE), CONTEXT);
    // Every field of it, and the nonce.
    let OpenRequest { lsb, limits, .. } = request;
    let others = [
        OpenRequest { version: 9, ..request },
        OpenRequest { session: 9, ..request },
        OpenRequest { plan_hash: 9, ..request },
        OpenRequest { period_us: 9, ..request },
        OpenRequest { end_tick: 9, ..request },
        OpenRequest { lsb: Lsb { translation_nm: 9, ..lsb }, ..request },
        OpenRequest { limits: Limits { linear_jerk_m_s3: 9.0, ..limits }, ..request },
        OpenRequest { start_level: 9, ..request },
        OpenRequest { reset_nonce: 9, ..request },
    ];
    for other in others {
        assert_ne!(other.digest(), request.digest());
        assert_ne!(Context::sealed(&other, samples::NONCE).seal, CONTEXT.seal);
    }
    assert_ne!(Context::sealed(&request, samples::NONCE + 1).seal, CONTEXT.seal);
}

#[test]
fn a_command_of_the_session_that_is_over_is_heard_and_nothing_else_of_it() {
    for dialect in Dialect::ALL {
        let mut decoder = arm(dialect);
        for context in [Context::NONE, Context { session: 9, ..CONTEXT }] {
            decoder.set_context(context);
            let frames = frames_to_arm(dialect, &[control(SESSION)]);
            assert_eq!(heard(&frames, |frame| decoder.handle_frame(frame)), [control(SESSION)]);
            let messages = [setpoint(1, [5; 6]), ToArm::Heartbeat { session: SESSION }];
            for frame in frames_to_arm(dialect, &messages) {
                assert!(decoder.handle_frame(&frame).is_err(), "{dialect:?}");
            }
        }
        decoder.set_context(Context { session: 10, ..CONTEXT });
        let frames = frames_to_arm(dialect, &[control(SESSION)]);
        assert!(frames.iter().all(|frame| decoder.handle_frame(frame).is_err()));
    }
}

#[test]
fn a_change_of_session_forgets_halves_and_references() {
    let mut decoder = arm(Dialect::Classic);
    let frames = frames_to_arm(Dialect::Classic, &[setpoint(1, [30_000; 6]), setpoint(2, [60_000; 6])]);
    assert_eq!(heard(&frames[..3], |frame| decoder.handle_frame(frame)).len(), 1);
    // The same context again is no change.
    decoder.set_context(CONTEXT);
    assert_eq!(heard(&frames[3..], |frame| decoder.handle_frame(frame)).len(), 1);
    decoder.set_context(Context::NONE);
    decoder.set_context(CONTEXT);
    assert_eq!(decoder.handle_frame(&frames[2]), Err(Rejected::Checksum { id: 0x201 }));
}

proptest! {
    /// Whatever a bus loses, repeats and reorders within a few frames, nothing is heard that was not said.
    #[test]
    fn nothing_is_heard_that_was_not_said(
        steps in prop::collection::vec((any::<[i8; 6]>(), 0..4_usize, -0.45..3.0_f64), 1..100),
        fd: bool,
    ) {
        let dialect = if fd { Dialect::Fd } else { Dialect::Classic };
        let (mut at, mut said) = (Setpoint::ANCHOR, Vec::new());
        for (step, ..) in &steps {
            at.tick += 1;
            for (count, step) in at.counts.iter_mut().zip(step) {
                *count += i32::from(*step) * 16;
            }
            said.push(setpoint(at.tick, at.counts));
        }
        let frames = frames_to_arm(dialect, &said);
        // Each frame arrives so many times, so much later than its place.
        let mut arrivals: Vec<(f64, Frame)> = Vec::new();
        for (index, frame) in frames.into_iter().enumerate() {
            let (_, times, late) = steps[(index * 7) % steps.len()];
            for repeat in 0..times {
                let place = f64::from(u32::try_from(index).unwrap()) + late * f64::from(u32::try_from(repeat).unwrap() + 1);
                arrivals.push((place, frame.clone()));
            }
        }
        arrivals.sort_by(|a, b| a.0.total_cmp(&b.0));
        let mut decoder = arm(dialect);
        for (_, frame) in arrivals {
            for message in decoder.handle_frame(&frame).unwrap_or_default() {
                prop_assert!(said.contains(&message), "{:?}", message);
            }
        }
    }
}
