//! Handshake records in pieces.

use powderline_shared::wire::codec::{Decoded, FromArmDecoder, Rejected, ToArmDecoder};
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

#[test]
fn a_lost_repeated_or_swapped_segment_gives_the_record_up_and_the_next_is_taken() {
    for dialect in Dialect::ALL {
        let (message, frames) = open(dialect);
        for index in 0..frames.len() {
            let mut lost = frames.clone();
            lost.remove(index);
            let mut repeated = frames.clone();
            repeated.insert(index, frames[index].clone());
            let mut swapped = frames.clone();
            swapped.swap(index, (index + 1) % frames.len());
            let mut decoder = ToArmDecoder::new(dialect);
            for (what, broken) in [("lost", lost), ("repeated", repeated), ("swapped", swapped)] {
                let found: Vec<Result<Decoded<ToArm>, Rejected>> =
                    broken.iter().map(|frame| decoder.handle_frame(frame)).collect();
                let heard = found.iter().flatten().map(|messages| messages.len()).sum::<usize>();
                // The first said twice is begun anew; the last said twice has been heard before it is surplus.
                let whole = what == "repeated" && (index == 0 || index == frames.len() - 1);
                // The last lost is not missed until the next record begins.
                let silent = whole && index == 0 || what == "lost" && index == frames.len() - 1;
                assert_eq!(heard, usize::from(whole), "{dialect:?} {what} {index}");
                assert_eq!(found.iter().any(Result::is_err), !silent, "{dialect:?} {what} {index}");
                let again: Vec<ToArm> =
                    frames.iter().flat_map(|frame| decoder.handle_frame(frame).unwrap()).collect();
                assert_eq!(again, [message]);
            }
        }
    }
}

#[test]
fn segments_that_make_no_sense_are_refused() {
    let mut classic = ToArmDecoder::new(Dialect::Classic);
    for data in
        [&[][..], &[0x00], &[0x80], &[0x00, 1, 2], &[0x40, 1, 2, 3, 4, 5, 6, 7], &[0x01; 8], &[0x00; 9]]
    {
        assert_eq!(classic.handle_frame(&Frame::new(0x601, data).unwrap()), Err(SEGMENT), "{data:?}");
    }
    let mut fd = ToArmDecoder::new(Dialect::Fd);
    for data in [&[0x00; 48][..], &[0x80; 33], &[0x80; 9], &[0xC0; 64]] {
        assert_eq!(fd.handle_frame(&Frame::new(0x601, data).unwrap()), Err(SEGMENT), "{data:?}");
    }
}

#[test]
fn a_record_longer_than_any_is_given_up() {
    let mut decoder = ToArmDecoder::new(Dialect::Classic);
    let found: Vec<_> = (0..=0x3F).map(|index| decoder.handle_frame(&segment(index, &[0; 7]))).collect();
    assert!(found[..36].iter().all(Result::is_ok));
    assert!(found[36..].iter().all(|found| *found == Err(SEGMENT)));
    let mut decoder = ToArmDecoder::new(Dialect::Fd);
    let found: Vec<_> = (0..=0x3F).map(|index| decoder.handle_frame(&segment(index, &[0; 63]))).collect();
    assert!(found[..4].iter().all(Result::is_ok));
    assert!(found[4..].iter().all(|found| *found == Err(SEGMENT)));
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
    let message = FromArm::Opened { session: samples::SESSION };
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
        let records: Vec<(ToArm, Vec<Frame>)> = (0..3).map(|start_level| {
            let (_, message) = samples::to_arm(Dialect::Classic).remove(0);
            let ToArm::Open(request) = message else { unreachable!() };
            let message = ToArm::Open(OpenRequest { start_level, ..request });
            (message, frames_to_arm(Dialect::Classic, &[message]))
        }).collect();
        let mut decoder = ToArmDecoder::new(Dialect::Classic);
        for (which, from) in picks {
            let (message, frames) = &records[usize::from(which)];
            for frame in frames.iter().skip(from).take(run) {
                for heard in decoder.handle_frame(frame).into_iter().flatten() {
                    prop_assert_eq!(heard, *message);
                }
            }
        }
    }
}
