//! Handshake records in pieces.

use powderline_shared::wire::codec::{FromArmDecoder, Rejected, ToArmDecoder};
use powderline_shared::wire::frame::{Dialect, Frame};
use powderline_shared::wire::message::{FromArm, OpenRequest, ToArm};
use proptest::prelude::*;

use crate::samples::{self, frames_to_arm};

const SEGMENT: Rejected = Rejected::Segment { id: 0x601 };
const RECORD: Rejected = Rejected::Record { id: 0x601 };

fn open(dialect: Dialect) -> (ToArm, Vec<Frame>) {
    let (_, message) = samples::to_arm(dialect).remove(0);
    (message, frames_to_arm(dialect, &[message]))
}

fn segment(index: u8, payload: &[u8]) -> Frame {
    Frame::new(0x601, &[&[index], payload].concat()).unwrap()
}

#[test]
fn segments_are_full_but_for_the_last() {
    for (dialect, full, count) in [(Dialect::Classic, 8, 18), (Dialect::Fd, 64, 2)] {
        let (_, frames) = open(dialect);
        assert_eq!(frames.len(), count);
        let (last, others) = frames.split_last().unwrap();
        assert!(others.iter().all(|frame| frame.data.len() == full));
        let indices: Vec<u8> = others.iter().map(|frame| frame.data[0]).collect();
        assert!(indices.iter().copied().eq(0..u8::try_from(count - 1).unwrap()));
        assert_eq!(usize::from(last.data[0]), 0x80 + count - 1);
        assert!(last.data.len() <= full);
    }
}

fn deliver(decoder: &mut ToArmDecoder, frames: &[Frame]) -> Vec<ToArm> {
    samples::heard(frames, |frame| decoder.handle_frame(frame))
}

#[test]
fn order_and_repetition_do_not_matter() {
    for dialect in Dialect::ALL {
        let (message, frames) = open(dialect);
        for index in 0..frames.len() {
            let mut repeated = frames.clone();
            repeated.insert(index, frames[index].clone());
            let mut rotated = frames.clone();
            rotated.rotate_left(index);
            let reversed: Vec<Frame> = rotated.iter().rev().cloned().collect();
            for (what, sent) in [("repeated", repeated), ("rotated", rotated), ("reversed", reversed)] {
                let heard = deliver(&mut ToArmDecoder::new(dialect), &sent);
                assert_eq!(heard, [message], "{dialect:?} {what} {index}");
            }
        }
    }
}

#[test]
fn what_was_lost_is_filled_in_by_the_next_request() {
    for dialect in Dialect::ALL {
        let (message, frames) = open(dialect);
        for index in 0..frames.len() {
            let mut decoder = ToArmDecoder::new(dialect);
            let mut lost = frames.clone();
            let missing = lost.remove(index);
            assert_eq!(deliver(&mut decoder, &lost), []);
            assert_eq!(deliver(&mut decoder, &lost), [], "nothing makes up for what never came");
            assert_eq!(deliver(&mut decoder, &[missing]), [message]);
            // Nothing is left of it.
            assert_eq!(deliver(&mut decoder, &lost), []);
        }
    }
}

/// The request with another last field: only its last segment differs, in FD its second and last.
fn another(dialect: Dialect, start_level: u16) -> (ToArm, Vec<Frame>) {
    let (ToArm::Open(request), _) = open(dialect) else { unreachable!() };
    let message = ToArm::Open(OpenRequest { start_level, ..request });
    (message, frames_to_arm(dialect, &[message]))
}

#[test]
fn another_record_begins_with_the_segment_that_differs() {
    for dialect in Dialect::ALL {
        let ((_, first), (message, second)) = (another(dialect, 3), another(dialect, 5));
        let (last, begin) = second.split_last().unwrap();
        let mut decoder = ToArmDecoder::new(dialect);
        // The end of the first is known, and one that both have in common is missing.
        assert_eq!(deliver(&mut decoder, &first[1..]), []);
        assert_eq!(deliver(&mut decoder, std::slice::from_ref(last)), []);
        assert_eq!(deliver(&mut decoder, begin), [message], "{dialect:?}");
    }
}

#[test]
fn a_record_of_another_length_begins_anew() {
    let (message, frames) = open(Dialect::Classic);
    let full = |index: u8, last: bool| segment(index | if last { 0x80 } else { 0 }, &[0xAA; 7]);
    let ends_sooner = [full(0, false), full(16, true)];
    let goes_on_longer = [full(0, false), full(20, true)];
    // Known to end elsewhere; known to go on where this one ends; known to end there with another length.
    for before in [&ends_sooner[..], &goes_on_longer, &[full(18, false)], &[full(17, true)]] {
        let mut decoder = ToArmDecoder::new(Dialect::Classic);
        assert_eq!(deliver(&mut decoder, before), []);
        let mut sent = frames.clone();
        sent.rotate_right(1);
        assert_eq!(deliver(&mut decoder, &sent), [message], "{before:?}");
    }
    // One that comes after what was thought to be the last.
    let mut decoder = ToArmDecoder::new(Dialect::Classic);
    assert_eq!(deliver(&mut decoder, &[full(3, true)]), []);
    let mut sent = frames.clone();
    sent.rotate_left(4);
    assert_eq!(deliver(&mut decoder, &sent), [message]);
}

#[test]
fn a_damaged_record_is_given_up_and_the_next_one_taken() {
    let (message, frames) = open(Dialect::Classic);
    let mut damaged = frames.clone();
    damaged[5].data[3] ^= 1;
    let mut decoder = ToArmDecoder::new(Dialect::Classic);
    let (last, begin) = damaged.split_last().unwrap();
    assert_eq!(deliver(&mut decoder, begin), []);
    assert_eq!(decoder.handle_frame(last), Err(RECORD));
    assert_eq!(deliver(&mut decoder, &frames), [message]);
}

/// Numbers that look random, always the same: xorshift64* (S. Vigna, ACM Transactions on Mathematical Software 42(4), 2016).
struct Dice(u64);

impl Dice {
    fn below(&mut self, bound: usize) -> usize {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        let high = self.0.wrapping_mul(0x2545_F491_4F6C_DD1D) >> 33;
        usize::try_from(high).unwrap() % bound
    }

    fn shuffle(&mut self, frames: &mut [Frame]) {
        for left in (2..=frames.len()).rev() {
            frames.swap(left - 1, self.below(left));
        }
    }
}

/// A fifth of all segments is lost and the rest comes in any order. With n segments a record is there after k requests
/// with the probability (1 - 0.2^k)^n; all at once, which is what it took before, has 0.8^n.
#[test]
fn a_fifth_of_the_segments_may_be_lost_and_all_be_out_of_order() {
    const RECORDS: usize = 1_000;
    for (dialect, most_on_average) in [(Dialect::Classic, 3.1), (Dialect::Fd, 1.8)] {
        let (message, frames) = open(dialect);
        let mut dice = Dice(0x9E37_79B9_7F4A_7C15);
        let (mut requests, mut most) = (0, 0);
        for _ in 0..RECORDS {
            let mut decoder = ToArmDecoder::new(dialect);
            let mut asked = 0;
            let mut heard = Vec::new();
            while heard.is_empty() {
                asked += 1;
                let mut sent = frames.clone();
                dice.shuffle(&mut sent);
                sent.retain(|_| dice.below(5) > 0);
                heard = deliver(&mut decoder, &sent);
            }
            assert_eq!(heard, [message]);
            requests += asked;
            most = most.max(asked);
        }
        let average = f64::from(requests) / f64::from(u32::try_from(RECORDS).unwrap());
        println!("{dialect:?}, {} segments: {average} requests, at most {most}", frames.len());
        assert!(average < most_on_average && most <= 8, "{dialect:?}: {average} on average, at most {most}");
    }
}

#[test]
fn segments_that_make_no_sense_are_refused() {
    let mut classic = ToArmDecoder::new(Dialect::Classic);
    for data in
        [&[][..], &[0x00], &[0x80], &[0x00, 1, 2], &[0x40, 1, 2, 3, 4, 5, 6, 7], &[0x7F; 8], &[0x00; 9]]
    {
        assert_eq!(classic.handle_frame(&Frame::new(0x601, data).unwrap()), Err(SEGMENT), "{data:?}");
    }
    let mut fd = ToArmDecoder::new(Dialect::Fd);
    for data in [&[0x00; 48][..], &[0x80; 33], &[0x80; 9], &[0xC0; 64]] {
        assert_eq!(fd.handle_frame(&Frame::new(0x601, data).unwrap()), Err(SEGMENT), "{data:?}");
    }
}

#[test]
fn a_segment_beyond_the_longest_record_is_refused() {
    let mut decoder = ToArmDecoder::new(Dialect::Classic);
    let found: Vec<_> = (0..=0x7F).map(|index| decoder.handle_frame(&segment(index, &[0; 7]))).collect();
    assert!(found[..36].iter().all(Result::is_ok));
    assert!(found[36..].iter().all(|found| *found == Err(SEGMENT)));
    let mut decoder = ToArmDecoder::new(Dialect::Fd);
    let found: Vec<_> = (0..=0x7F).map(|index| decoder.handle_frame(&segment(index, &[0; 63]))).collect();
    assert!(found[..4].iter().all(Result::is_ok));
    assert!(found[4..].iter().all(|found| *found == Err(SEGMENT)));
    // The last may be there where a full one has no room.
    for (dialect, index, most) in [(Dialect::Classic, 36, 4), (Dialect::Fd, 4, 4)] {
        let end = |length| ToArmDecoder::new(dialect).handle_frame(&segment(0x80 | index, &vec![0; length]));
        assert_eq!((end(most).as_deref(), end(most + 1)), (Ok(&[][..]), Err(SEGMENT)));
    }
}

#[test]
fn a_length_that_lies_is_refused() {
    for length in [0_u16, 1, 5, 0x00FF, 0x7FFF, 0xFFFF] {
        let mut data = length.to_le_bytes().to_vec();
        data.extend([1, 2, 3, 4, 5]);
        let mut decoder = ToArmDecoder::new(Dialect::Classic);
        assert_eq!(decoder.handle_frame(&segment(0x80, &data)), Err(RECORD), "{length}");
    }
    for short in [&[1_u8][..], &[1, 0], &[1, 0, 0]] {
        assert_eq!(ToArmDecoder::new(Dialect::Classic).handle_frame(&segment(0x80, short)), Err(RECORD));
    }
}

/// A record of `body` whose checksum is right.
fn sealed(body: &[u8]) -> Vec<u8> {
    let mut record = u16::try_from(body.len()).unwrap().to_le_bytes().to_vec();
    record.extend(body);
    let crc = crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC).checksum(&record);
    record.extend(crc.to_le_bytes());
    record
}

#[test]
fn a_body_that_is_no_request_is_refused_though_its_checksum_is_right() {
    let fd = |record: &[u8]| {
        let mut data = record.to_vec();
        while Frame::new(0, &data).is_some() && ![7, 11, 15, 19, 23, 31, 47, 63].contains(&data.len()) {
            data.push(0);
        }
        ToArmDecoder::new(Dialect::Fd).handle_frame(&segment(0x80, &data))
    };
    for body in [&[][..], &[0], &[1], &[0xFF; 12], &[0x80; 40]] {
        assert_eq!(fd(&sealed(body)), Err(RECORD), "{body:?}");
    }
}

#[test]
fn padding_is_zeros_and_no_longer_than_needed() {
    let message = FromArm::Refused {
        session: samples::SESSION,
        reason: powderline_shared::wire::message::Refusal::Busy,
    };
    let frame = samples::frames_from_arm(Dialect::Fd, &[message]).remove(0);
    assert_eq!(frame.data.len(), 12);
    let take =
        |data: &[u8]| FromArmDecoder::new(Dialect::Fd).handle_frame(&Frame::new(frame.id, data).unwrap());
    assert_eq!(take(&frame.data).as_deref(), Ok(&[message][..]));
    let mut set = frame.data.clone();
    *set.last_mut().unwrap() = 1;
    assert_eq!(take(&set), Err(Rejected::Record { id: 0x581 }));
    let mut long = frame.data.to_vec();
    long.resize(32, 0);
    assert_eq!(take(&long), Err(Rejected::Record { id: 0x581 }));
}

#[test]
fn a_handshake_goes_on_across_a_change_of_session() {
    let (message, frames) = open(Dialect::Classic);
    let mut decoder = samples::arm(Dialect::Classic);
    let (begin, end) = frames.split_at(9);
    assert!(samples::heard(begin, |frame| decoder.handle_frame(frame)).is_empty());
    decoder.set_context(powderline_shared::wire::Context::NONE);
    assert_eq!(samples::heard(end, |frame| decoder.handle_frame(frame)), [message]);
}

proptest! {
    /// Segments of several records, some lost, some repeated: what is heard is one of the records, whole.
    #[test]
    fn only_whole_records_are_heard(picks in prop::collection::vec((0..3_u16, 0..30_usize), 0..200), run in 1..25_usize) {
        let records: Vec<(ToArm, Vec<Frame>)> = (0..3).map(|level| another(Dialect::Classic, level)).collect();
        let mut decoder = ToArmDecoder::new(Dialect::Classic);
        for (which, from) in picks {
            let (_, frames) = &records[usize::from(which)];
            for frame in frames.iter().skip(from).take(run) {
                for heard in decoder.handle_frame(frame).into_iter().flatten() {
                    // Not always this one: what it has in common with another may complete that.
                    prop_assert!(records.iter().any(|(message, _)| heard == *message));
                }
            }
        }
    }
}
