//! Sessions between ends that have a key: what was not made with it says nothing.

use powderline_shared::wire::Context;
use powderline_shared::wire::auth::{Key, MOST_WRONG_TAGS, TagWatch};
use powderline_shared::wire::codec::{Encoder, FromArmDecoder, Rejected, ToArmDecoder};
use powderline_shared::wire::frame::{Dialect, Frame};
use powderline_shared::wire::ids;
use powderline_shared::wire::message::{FromArm, OpenRequest, ToArm};
use powderline_shared::wire::state::Command;

use crate::samples::{self, CONTEXT, NONCE, OWN_NONCE, SESSION, heard, key, keyed, open_request};

fn arm(dialect: Dialect, context: Context) -> ToArmDecoder {
    let mut decoder = ToArmDecoder::new(dialect);
    decoder.set_context(context);
    decoder
}

fn executor(dialect: Dialect, context: Context) -> FromArmDecoder {
    let mut decoder = FromArmDecoder::new(dialect);
    decoder.set_context(context);
    decoder
}

fn to_arm(dialect: Dialect, context: Context) -> Vec<Frame> {
    let mut encoder = Encoder::new(dialect);
    let messages = samples::to_arm_keyed(dialect);
    messages.iter().flat_map(|(_, message)| encoder.to_arm(&context, message)).collect()
}

/// Without what is of no session.
fn from_arm(dialect: Dialect, context: Context) -> Vec<Frame> {
    let encoder = Encoder::new(dialect);
    let messages = samples::from_arm_keyed();
    let ours = messages.iter().filter(|(name, _)| !name.contains("without session"));
    ours.flat_map(|(_, message)| encoder.from_arm(&context, message)).collect()
}

#[test]
fn everything_survives() {
    for dialect in Dialect::ALL {
        let mut decoder = arm(dialect, keyed());
        let found = heard(&to_arm(dialect, keyed()), |frame| decoder.handle_frame(frame));
        assert!(found.iter().eq(samples::to_arm_keyed(dialect).iter().map(|(_, message)| message)));
        let mut decoder = executor(dialect, keyed());
        let found = heard(&from_arm(dialect, keyed()), |frame| decoder.handle_frame(frame));
        let said = samples::from_arm_keyed();
        let ours = said.iter().filter(|(name, _)| !name.contains("without session"));
        assert!(found.iter().eq(ours.map(|(_, message)| message)), "{dialect:?}");
    }
}

/// Of these frames, how many a decoder takes that is of a session; records and the stop, which are of none, left out.
fn taken<T>(frames: &[Frame], mut handle: impl FnMut(&Frame) -> Result<T, Rejected>) -> usize {
    let cyclic =
        |frame: &&Frame| ![ids::HANDSHAKE_TO_ARM, ids::HANDSHAKE_FROM_ARM, ids::STOP].contains(&frame.id);
    frames.iter().filter(cyclic).filter(|frame| handle(frame).is_ok()).count()
}

#[test]
fn without_the_key_nothing_is_understood() {
    let request = open_request(Dialect::Classic);
    let other = Key::new(&[9; 32]);
    let foreign = [
        CONTEXT,
        CONTEXT.with_key(other.session(&request, OWN_NONCE, NONCE)),
        // The key of another session of the same ends: by the one's nonce, the other's, or what was agreed on.
        CONTEXT.with_key(key().session(&request, OWN_NONCE + 1, NONCE)),
        CONTEXT.with_key(key().session(&request, OWN_NONCE, NONCE + 1)),
        CONTEXT.with_key(key().session(&OpenRequest { end_tick: 1, ..request }, OWN_NONCE, NONCE)),
    ];
    for dialect in Dialect::ALL {
        // With 8 bits, one of 256 passes; a whole setpoint has 16.
        let most = if dialect == Dialect::Classic { 2 } else { 0 };
        for context in foreign {
            for (ours, theirs) in [(keyed(), context), (context, keyed())] {
                let (mut arm, mut executor) = (arm(dialect, ours), executor(dialect, ours));
                let frames = to_arm(dialect, theirs);
                assert!(taken(&frames, |frame| arm.handle_frame(frame)) <= most, "{dialect:?}");
                let frames = from_arm(dialect, theirs);
                assert!(taken(&frames, |frame| executor.handle_frame(frame)) <= most, "{dialect:?}");
            }
        }
    }
}

#[test]
fn a_request_and_its_answer_are_proven_in_every_field() {
    let request = open_request(Dialect::Fd);
    let proof = key().prove(&request, OWN_NONCE);
    assert!(key().proves(&request, &proof) && !Key::new(&[9; 32]).proves(&request, &proof));
    let mut later = proof;
    later.nonce += 1;
    assert!(!key().proves(&request, &later));
    for bit in 0..64 {
        let mut flipped = proof;
        flipped.tag.0[bit / 8] ^= 1 << (bit % 8);
        assert!(!key().proves(&request, &flipped));
    }
    let answer = key().answer(&request, OWN_NONCE, NONCE);
    let mut others = vec![
        key().answer(&request, OWN_NONCE + 1, NONCE),
        key().answer(&request, OWN_NONCE, NONCE + 1),
        Key::new(&[9; 32]).answer(&request, OWN_NONCE, NONCE),
        proof.tag,
    ];
    for other in [
        OpenRequest { session: 9, ..request },
        OpenRequest { plan_hash: 9, ..request },
        OpenRequest { end_tick: 9, ..request },
        OpenRequest { reset_nonce: 9, ..request },
    ] {
        assert!(!key().proves(&other, &proof));
        others.push(key().answer(&other, OWN_NONCE, NONCE));
    }
    assert!(others.iter().all(|other| *other != answer));
}

#[test]
fn an_anchor_needs_its_tag() {
    let (_, anchored) = samples::from_arm().into_iter().find(|(name, _)| name == "anchored").unwrap();
    for dialect in Dialect::ALL {
        let said = |context: Context| Encoder::new(dialect).from_arm(&context, &anchored).collect::<Vec<_>>();
        let hear = |ours: Context, frames: &[Frame]| {
            let mut decoder = executor(dialect, ours);
            frames.iter().map(|frame| decoder.handle_frame(frame)).last().unwrap()
        };
        assert_eq!(hear(keyed(), &said(keyed())).unwrap(), [anchored]);
        let refused = Err(Rejected::Checksum { id: ids::HANDSHAKE_FROM_ARM });
        assert_eq!(hear(keyed(), &said(CONTEXT)), refused);
        assert_eq!(hear(CONTEXT, &said(keyed())), refused);
        // With a tag, but by another key: all else about it is right, its checksum too.
        let other = Key::new(&[9; 32]).session(&open_request(Dialect::Classic), OWN_NONCE, NONCE);
        assert_eq!(hear(keyed(), &said(CONTEXT.with_key(other))), refused);
    }
}

#[test]
fn a_command_or_heartbeat_is_believed_once() {
    let messages = [
        ToArm::Control { session: SESSION, command: Command::SwitchOn },
        ToArm::Heartbeat { session: SESSION },
    ];
    for dialect in Dialect::ALL {
        for message in messages {
            let (mut encoder, mut decoder) = (Encoder::new(dialect), arm(dialect, keyed()));
            let frames: Vec<Frame> = (0..40).flat_map(|_| encoder.to_arm(&keyed(), &message)).collect();
            let mut heard = |at: usize| decoder.handle_frame(&frames[at]).is_ok();
            // Again, after some that were lost, out of order, and after more than may be lost.
            let found = [0, 0, 1, 5, 4, 5, 39, 37, 38].map(&mut heard);
            assert_eq!(found, [true, false, true, true, false, false, false, true, true]);
        }
    }
}

#[test]
fn a_command_of_the_session_that_is_over_is_heard_once() {
    for dialect in Dialect::ALL {
        let (mut encoder, mut decoder) = (Encoder::new(dialect), arm(dialect, keyed()));
        let command = ToArm::Control { session: SESSION, command: Command::Shutdown };
        let [first, second] = [0, 1].map(|_| encoder.to_arm(&keyed(), &command).next().unwrap());
        assert!(decoder.handle_frame(&first).is_ok());
        decoder.set_context(Context::NONE);
        assert!(decoder.handle_frame(&first).is_err(), "said again");
        assert_eq!(decoder.handle_frame(&second).unwrap(), [command]);
        assert!(decoder.handle_frame(&second).is_err(), "said again");
    }
}

/// A tag is no code: it promises nothing of single bits, but that one of 256 passes, or of 2^32.
#[test]
fn a_flipped_bit_is_found_as_surely_as_the_tag_is_long() {
    for dialect in Dialect::ALL {
        let (mut flipped, mut passed) = (0, 0);
        let mut decoder = arm(dialect, keyed());
        for frame in to_arm(dialect, keyed()) {
            let cyclic = [ids::SETPOINT_T, ids::SETPOINT_R, ids::CONTROL, ids::HEARTBEAT_TO_ARM];
            for bit in (0..8 * frame.data.len()).filter(|_| cyclic.contains(&frame.id)) {
                let mut wrong = frame.clone();
                wrong.data[bit / 8] ^= 1 << (bit % 8);
                flipped += 1;
                passed += usize::from(decoder.clone().handle_frame(&wrong).is_ok());
            }
            decoder.handle_frame(&frame).unwrap();
        }
        let most = if dialect == Dialect::Classic { 2 * flipped / 256 } else { 0 };
        assert!(passed <= most, "{dialect:?}: {passed} of {flipped}");
    }
}

#[test]
fn guesses_are_counted_where_guessing_pays() {
    let wrong = |id| Rejected::Checksum { id };
    let notes = |dialect, context: Context, rejected: Rejected| {
        let mut watch = TagWatch::default();
        (1..=MOST_WRONG_TAGS).find(|_| watch.is_too_many(dialect, &context, &rejected))
    };
    for id in
        [ids::SETPOINT_T, ids::SETPOINT_R, ids::STATUS, ids::ACTUAL_T, ids::FAULT, ids::HEARTBEAT_FROM_ARM]
    {
        assert_eq!(notes(Dialect::Classic, keyed(), wrong(id)), Some(MOST_WRONG_TAGS));
        assert_eq!(notes(Dialect::Fd, keyed(), wrong(id)), None);
        assert_eq!(notes(Dialect::Classic, CONTEXT, wrong(id)), None);
    }
    for id in [ids::CONTROL, ids::HEARTBEAT_TO_ARM, ids::HANDSHAKE_TO_ARM] {
        assert_eq!(notes(Dialect::Classic, keyed(), wrong(id)), None);
    }
    assert_eq!(notes(Dialect::Classic, keyed(), Rejected::UnknownId { id: 5 }), None);
    // Another session begins anew.
    let mut watch = TagWatch::default();
    let other = CONTEXT.with_key(key().session(&open_request(Dialect::Fd), OWN_NONCE, NONCE));
    for _ in 1..MOST_WRONG_TAGS {
        assert!(!watch.is_too_many(Dialect::Classic, &keyed(), &wrong(ids::SETPOINT_T)));
    }
    assert!(!watch.is_too_many(Dialect::Classic, &other, &wrong(ids::SETPOINT_T)));
}

#[test]
fn neither_end_takes_what_has_no_key_for_what_has_one() {
    for dialect in Dialect::ALL {
        let request = open_request(dialect);
        let frames: Vec<Frame> =
            Encoder::new(dialect).to_arm(&Context::NONE, &ToArm::Open(request)).collect();
        let mut decoder = ToArmDecoder::new(dialect);
        assert_eq!(heard(&frames, |frame| decoder.handle_frame(frame)), [ToArm::Open(request)]);
        let proven = ToArm::OpenKeyed(request, key().prove(&request, OWN_NONCE));
        let frames: Vec<Frame> = Encoder::new(dialect).to_arm(&Context::NONE, &proven).collect();
        assert_eq!(heard(&frames, |frame| decoder.handle_frame(frame)), [proven]);
        let opened = FromArm::Opened { session: SESSION, nonce: NONCE, digest: request.digest() };
        let frames: Vec<Frame> = Encoder::new(dialect).from_arm(&Context::NONE, &opened).collect();
        let mut decoder = FromArmDecoder::new(dialect);
        assert_eq!(heard(&frames, |frame| decoder.handle_frame(frame)), [opened]);
    }
}
