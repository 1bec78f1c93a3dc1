//! Damaged and hostile frames.

use powderline_shared::displacement::Setpoint;
use powderline_shared::fault::Reported;
use powderline_shared::wire::codec::{FromArmDecoder, Rejected, ToArmDecoder};
use powderline_shared::wire::frame::{Dialect, Frame, MAX_ID};
use powderline_shared::wire::message::{FromArm, ToArm};
use proptest::prelude::*;

use crate::samples::{self, SESSION, arm, executor, frames_from_arm, frames_to_arm};

/// Every frame that differs from this one by one bit of its data or of its identifier.
fn flips(frame: &Frame) -> impl Iterator<Item = Frame> {
    let data = (0..frame.data.len() * 8).map(|bit| {
        let mut flipped = frame.clone();
        flipped.data[bit / 8] ^= 1 << (bit % 8);
        flipped
    });
    let id = (0..11).map(|bit| Frame { id: frame.id ^ (1 << bit), data: frame.data.clone() });
    data.chain(id)
}

/// Every frame that ends sooner.
fn truncations(frame: &Frame) -> impl Iterator<Item = Frame> {
    (0..frame.data.len()).map(|length| Frame::new(frame.id, &frame.data[..length]).unwrap())
}

/// Lets `handle` hear the frames of one message, one of them damaged in each possible way; what it then hears must be
/// the message or nothing.
fn damage_each<D: Clone, M: Copy + PartialEq + std::fmt::Debug>(
    decoder: &D,
    frames: &[Frame],
    message: M,
    handle: impl Fn(&mut D, &Frame) -> Result<heapless::Vec<M, 2>, Rejected>,
) -> usize {
    let mut accepted = 0;
    for (index, frame) in frames.iter().enumerate() {
        for damaged in flips(frame).chain(truncations(frame)) {
            let mut decoder = decoder.clone();
            let arrivals = frames[..index].iter().chain([&damaged]).chain(&frames[index + 1..]);
            for heard in arrivals.flat_map(|frame| handle(&mut decoder, frame).unwrap_or_default()) {
                assert_eq!(heard, message, "{damaged:?}");
                accepted += 1;
            }
        }
    }
    accepted
}

/// The last segment of an FD record may lose padding and say the same.
fn may_lose_padding(dialect: Dialect, record: bool) -> bool {
    record && dialect == Dialect::Fd
}

#[test]
fn no_single_flip_or_truncation_says_something_else() {
    for dialect in Dialect::ALL {
        let mut decoder = arm(dialect);
        for (name, message) in samples::to_arm(dialect) {
            let frames = frames_to_arm(dialect, &[message]);
            let accepted =
                damage_each(&decoder, &frames, message, |decoder, frame| decoder.handle_frame(frame));
            let record = matches!(message, ToArm::Open(_));
            assert!(accepted == 0 || may_lose_padding(dialect, record), "{dialect:?} {name}: {accepted}");
            // So that the next setpoint is within reach.
            for frame in frames {
                decoder.handle_frame(&frame).unwrap();
            }
        }
        let mut decoder = executor(dialect);
        for (name, message) in samples::from_arm() {
            let frames = frames_from_arm(dialect, &[message]);
            let accepted =
                damage_each(&decoder, &frames, message, |decoder, frame| decoder.handle_frame(frame));
            let record = matches!(
                message,
                FromArm::Opened { .. } | FromArm::Refused { .. } | FromArm::Anchored { .. }
            );
            assert!(accepted == 0 || may_lose_padding(dialect, record), "{dialect:?} {name}: {accepted}");
            for frame in frames {
                decoder.handle_frame(&frame).unwrap();
            }
        }
    }
}

fn with_flips(frame: &Frame, bits: &[usize]) -> Frame {
    let mut damaged = frame.clone();
    bits.iter().for_each(|bit| damaged.data[bit / 8] ^= 1 << (bit % 8));
    damaged
}

/// The upper two bits of each field of which the rest is not sent. Whoever is less than half their worth off the reference
/// rebuilds the rest wrongly only if one of them is wrong.
fn carrying(id: u16) -> &'static [[usize; 2]] {
    match id {
        0x201 | 0x301 | 0x281 | 0x381 => &[[14, 15], [30, 31], [46, 47], [54, 55]],
        0x181 => &[[30, 31]],
        0x081 => &[[54, 55]],
        _ => &[],
    }
}

/// In how many fields these bits may change what is rebuilt.
fn carries(id: u16, bits: &[usize]) -> usize {
    carrying(id).iter().filter(|field| field.iter().any(|bit| bits.contains(bit))).count()
}

/// Whether these bits make a status or fault of the session one of none, or the other way round; it is read by another key then.
fn changes_session(id: u16, bits: &[usize]) -> bool {
    let marks = match id {
        0x181 => [8, 14],
        0x081 => [0, 1],
        _ => return false,
    };
    bits.len() > marks.len() && marks.iter().all(|bit| bits.contains(bit))
}

/// How many were not found of those for which nothing is promised.
#[derive(Default)]
struct Doubtful {
    passed: usize,
    of: usize,
}

impl Doubtful {
    /// Lets each one, two and up to `most` bits of a classic frame be wrong. All are found that are fewer than four together with
    /// the fields that they carry in.
    fn flip_few(&mut self, frame: &Frame, most: usize, passes: impl Fn(&Frame) -> bool) {
        let bits = frame.data.len() * 8;
        let mut flip = |flipped: &[usize]| {
            let is_doubtful =
                flipped.len() + carries(frame.id, flipped) >= 4 || changes_session(frame.id, flipped);
            let passed = passes(&with_flips(frame, flipped));
            assert!(!passed || is_doubtful, "{frame:?} {flipped:?}");
            self.passed += usize::from(passed);
            self.of += usize::from(is_doubtful);
        };
        for first in 0..bits {
            flip(&[first]);
            for second in first + 1..bits {
                flip(&[first, second]);
                (second + 1..bits).filter(|_| most > 2).for_each(|third| flip(&[first, second, third]));
            }
        }
    }

    /// As rarely as a checksum of 8 bits, of which one is known to be right, misses anything.
    #[track_caller]
    fn assert_few(&self) {
        assert!(self.of > 5_000 && self.passed * 100 < self.of, "{} of {}", self.passed, self.of);
    }
}

/// All that goes to and fro, but for records, which have a checksum of 32 bits, and for halves.
#[test]
fn three_wrong_bits_of_a_classic_frame_are_found() {
    let classic = Dialect::Classic;
    let mut doubtful = Doubtful::default();
    let decoder = arm(classic);
    for (_, message) in samples::to_arm(classic) {
        if matches!(message, ToArm::Control { .. } | ToArm::Heartbeat { .. } | ToArm::Stop) {
            let frame = &frames_to_arm(classic, &[message])[0];
            doubtful.flip_few(frame, 3, |damaged| decoder.clone().handle_frame(damaged).is_ok());
        }
    }
    assert_eq!(doubtful.of, 0);
    let decoder = executor(classic);
    for (_, message) in samples::from_arm() {
        if matches!(message, FromArm::Status(_) | FromArm::Fault { .. } | FromArm::Heartbeat(_)) {
            let frame = &frames_from_arm(classic, &[message])[0];
            doubtful.flip_few(frame, 3, |damaged| decoder.clone().handle_frame(damaged).is_ok());
        }
    }
    doubtful.assert_few();
}

/// On a way past multiples of 65,536 counts and 256 ticks, where what is not sent changes. The other half is right: nothing but
/// this checksum is between a wrong setpoint and the arm.
#[test]
fn two_wrong_bits_of_half_a_setpoint_or_report_are_found() {
    let classic = Dialect::Classic;
    let mut doubtful = Doubtful::default();
    let (mut to, mut from) = (arm(classic), executor(classic));
    for step in 1_i32..=150 {
        // No 20 of these are 16,384 counts apart, and no two 64 ticks.
        let counts = [700, -701, 37, -499, 650, 3].map(|count| count * step);
        let (tick, most) = (step.unsigned_abs() * 5, if step % 50 == 0 { 3 } else { 2 });
        let reached = Setpoint { tick, counts };
        let setpoint = frames_to_arm(classic, &[ToArm::Setpoint { session: SESSION, setpoint: reached }]);
        let actual = frames_from_arm(classic, &[FromArm::Actual { session: SESSION, reached }]);
        for half in &setpoint {
            doubtful.flip_few(half, most, |damaged| to.clone().handle_frame(damaged).is_ok());
        }
        for half in &actual {
            doubtful.flip_few(half, most, |damaged| from.clone().handle_frame(damaged).is_ok());
        }
        setpoint.iter().for_each(|half| drop(to.handle_frame(half).unwrap()));
        actual.iter().for_each(|half| drop(from.handle_frame(half).unwrap()));
        from.expect(reached);
    }
    doubtful.assert_few();
}

#[test]
fn a_frame_of_another_direction_or_dialect_is_unknown() {
    for dialect in Dialect::ALL {
        let known_to_arm =
            |id| !matches!(arm(dialect).handle_frame(&frame(id)), Err(Rejected::UnknownId { .. }));
        let known_to_executor =
            |id| !matches!(executor(dialect).handle_frame(&frame(id)), Err(Rejected::UnknownId { .. }));
        let to_arm: Vec<u16> = (0..=MAX_ID).filter(|id| known_to_arm(*id)).collect();
        let from_arm: Vec<u16> = (0..=MAX_ID).filter(|id| known_to_executor(*id)).collect();
        if dialect == Dialect::Classic {
            assert_eq!(to_arm, [0x001, 0x201, 0x301, 0x401, 0x601, 0x77F]);
            assert_eq!(from_arm, [0x081, 0x181, 0x281, 0x381, 0x581, 0x701]);
        } else {
            assert_eq!(to_arm, [0x001, 0x201, 0x401, 0x601, 0x77F]);
            assert_eq!(from_arm, [0x081, 0x181, 0x281, 0x581, 0x701]);
        }
    }
}

fn frame(id: u16) -> Frame {
    Frame::new(id, b"SP").unwrap()
}

#[test]
fn a_stop_is_four_letters_on_every_wire() {
    for dialect in Dialect::ALL {
        let hear = |data: &[u8]| ToArmDecoder::new(dialect).handle_frame(&Frame::new(1, data).unwrap());
        assert_eq!(hear(b"STOP").as_deref(), Ok(&[ToArm::Stop][..]));
        assert_eq!(hear(b"STOp"), Err(Rejected::Checksum { id: 1 }));
        assert_eq!(hear(b"STOPP"), Err(Rejected::Length { id: 1, len: 5 }));
        assert_eq!(hear(b""), Err(Rejected::Length { id: 1, len: 0 }));
    }
}

/// The frame with its bytes changed and its checksum made right again, as a writer of another version might.
fn resealed_fd(frame: &Frame, change: impl Fn(&mut [u8])) -> Frame {
    let mut data = frame.data.to_vec();
    change(&mut data);
    let crc = crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC);
    let mut digest = crc.digest();
    digest.update(&frame.id.to_le_bytes());
    digest.update(&samples::CONTEXT.seal.to_le_bytes());
    digest.update(&data[4..]);
    let crc = digest.finalize();
    data[..4].copy_from_slice(&crc.to_le_bytes());
    Frame::new(frame.id, &data).unwrap()
}

/// The same for a classic frame whose checksum covers byte 2 of the key.
fn resealed_classic(frame: &Frame, tick: u32, change: impl Fn(&mut [u8])) -> Frame {
    let mut data = frame.data.to_vec();
    change(&mut data);
    let crc = crc::Crc::<u8>::new(&crc::CRC_8_AUTOSAR);
    let mut digest = crc.digest();
    digest.update(&frame.id.to_le_bytes());
    let [.., key] = samples::CONTEXT.key();
    digest.update(&[key]);
    // The upper half of a tick below 65,536.
    assert!(tick >> 16 == 0);
    digest.update(&[0, 0]);
    let last = data.len() - 1;
    digest.update(&data[..last]);
    data[last] = digest.finalize();
    Frame::new(frame.id, &data).unwrap()
}

/// The same for a classic frame with four bytes of checksum.
fn resealed_well(frame: &Frame, change: impl Fn(&mut [u8])) -> Frame {
    let mut data = frame.data.to_vec();
    change(&mut data);
    let payload = data.len() - 4;
    let crc = crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC);
    let mut digest = crc.digest();
    digest.update(&frame.id.to_le_bytes());
    digest.update(&samples::CONTEXT.seal.to_le_bytes());
    digest.update(&data[..payload]);
    let crc = digest.finalize();
    data[payload..].copy_from_slice(&crc.to_le_bytes());
    Frame::new(frame.id, &data).unwrap()
}

fn sample_to_arm(dialect: Dialect, name: &str) -> Frame {
    let (_, message) = samples::to_arm(dialect).into_iter().find(|(found, _)| found == name).unwrap();
    frames_to_arm(dialect, &[message]).remove(0)
}

fn sample_from_arm(dialect: Dialect, name: &str) -> Frame {
    let (_, message) = samples::from_arm().into_iter().find(|(found, _)| found == name).unwrap();
    frames_from_arm(dialect, &[message]).remove(0)
}

#[test]
fn an_unknown_word_is_named_though_its_checksum_is_right() {
    use Dialect::{Classic, Fd};
    let control = sample_to_arm(Classic, "control Shutdown");
    let found = arm(Classic).handle_frame(&resealed_well(&control, |data| data[0] = 0x1F));
    assert_eq!(found, Err(Rejected::Word { id: 0x401, word: 0x001F }));
    let found =
        arm(Fd).handle_frame(&resealed_fd(&sample_to_arm(Fd, "control Shutdown"), |data| data[12] = 0x1F));
    assert_eq!(found, Err(Rejected::Word { id: 0x401, word: 0x001F }));

    let heartbeat = sample_to_arm(Classic, "heartbeat");
    let found = arm(Classic).handle_frame(&resealed_well(&heartbeat, |data| data[0] = 0x7F));
    assert_eq!(found, Err(Rejected::Word { id: 0x77F, word: 0x7F }));

    let status = sample_from_arm(Classic, "status Streaming");
    let found = executor(Classic).handle_frame(&resealed_classic(&status, 41, |data| data[0] ^= 0x80));
    assert_eq!(found, Err(Rejected::Word { id: 0x181, word: 0x51B7 }));
    let status = sample_from_arm(Fd, "status Streaming");
    let found = executor(Fd).handle_frame(&resealed_fd(&status, |data| data[12] ^= 0x80));
    assert_eq!(found, Err(Rejected::Word { id: 0x181, word: 0x51B7 }));

    // A fault of a later version is one all the same.
    let later = FromArm::Fault { session: SESSION, fault: Reported { number: 99, tick: 41 } };
    let fault = sample_from_arm(Classic, "fault");
    let found = executor(Classic).handle_frame(&resealed_classic(&fault, 41, |data| data[3] = 99));
    assert_eq!(found.as_deref(), Ok(&[later][..]));
    let found = executor(Classic).handle_frame(&resealed_classic(&fault, 41, |data| data[2] = 0));
    assert_eq!(found, Err(Rejected::Word { id: 0x081, word: 0xFF03 }));
    let found = executor(Fd).handle_frame(&resealed_fd(&sample_from_arm(Fd, "fault"), |data| data[12] = 99));
    assert_eq!(found.as_deref(), Ok(&[later][..]));
}

#[test]
fn reserved_fields_and_types_are_checked() {
    use Dialect::Fd;
    let hear = |frame: &Frame| arm(Fd).handle_frame(frame).unwrap_err();
    let cases: [(&str, &[usize]); 3] = [
        ("control Shutdown", &[4, 7, 11, 14, 15]),
        ("heartbeat", &[4, 11]),
        ("setpoint tick 100", &[11, 36, 47]),
    ];
    for (name, reserved) in cases {
        let frame = sample_to_arm(Fd, name);
        for byte in reserved {
            let changed = resealed_fd(&frame, |data| data[*byte] = 2);
            assert_eq!(hear(&changed), Rejected::Reserved { id: frame.id }, "{name} {byte}");
        }
        let changed = resealed_fd(&frame, |data| data[10] = 9);
        assert_eq!(hear(&changed), Rejected::Type { id: frame.id, number: 9 });
    }
    let hear = |frame: &Frame| executor(Fd).handle_frame(frame).unwrap_err();
    let cases: [(&str, &[usize]); 4] = [
        ("status Streaming", &[11, 17, 18, 19]),
        ("actual tick 100", &[11, 36, 47]),
        ("fault", &[11, 14, 15]),
        ("heartbeat", &[4, 11]),
    ];
    for (name, reserved) in cases {
        let frame = sample_from_arm(Fd, name);
        for byte in reserved {
            let changed = resealed_fd(&frame, |data| data[*byte] = 1);
            assert_eq!(hear(&changed), Rejected::Reserved { id: frame.id }, "{name} {byte}");
        }
        let changed = resealed_fd(&frame, |data| data[10] = 9);
        assert_eq!(hear(&changed), Rejected::Type { id: frame.id, number: 9 });
    }
}

#[test]
fn every_reason_is_a_sentence_with_its_numbers() {
    let reasons = [
        Rejected::UnknownId { id: 0x123 },
        Rejected::Length { id: 0x123, len: 7 },
        Rejected::Checksum { id: 0x123 },
        Rejected::Type { id: 0x123, number: 7 },
        Rejected::Reserved { id: 0x123 },
        Rejected::Word { id: 0x123, word: 7 },
        Rejected::Contradiction { id: 0x123, tick: 7 },
        Rejected::Segment { id: 0x123 },
        Rejected::Record { id: 0x123 },
    ];
    for reason in reasons {
        let sentence = reason.to_string();
        assert!(sentence.contains("0x123") && !sentence.ends_with('.'), "{sentence}");
    }
}

/// Identifiers of the protocol, more often than others.
fn ids() -> impl Strategy<Value = u16> {
    let known = vec![0x001, 0x081, 0x181, 0x201, 0x281, 0x301, 0x381, 0x401, 0x581, 0x601, 0x701, 0x77F];
    prop_oneof![4 => prop::sample::select(known), 1 => any::<u16>()]
}

proptest! {
    /// With 8 bits of checksum one random frame in 256 passes; with 32 none does in a lifetime of tests.
    #[test]
    fn random_frames_never_panic_and_never_pass_for_fd(
        frames in prop::collection::vec((ids(), prop::collection::vec(any::<u8>(), 0..=64)), 0..100),
    ) {
        let (mut classic_arm, mut classic_executor) = (arm(Dialect::Classic), executor(Dialect::Classic));
        let (mut fd_arm, mut fd_executor) = (arm(Dialect::Fd), executor(Dialect::Fd));
        for (id, data) in frames {
            let Some(frame) = Frame::new(id, &data) else { continue };
            let _ = classic_arm.handle_frame(&frame);
            let _ = classic_executor.handle_frame(&frame);
            prop_assert!(fd_arm.handle_frame(&frame).is_ok_and(|heard| heard.is_empty()) || fd_arm.handle_frame(&frame).is_err());
            prop_assert!(fd_executor.handle_frame(&frame).map_or(true, |heard| heard.is_empty()));
        }
    }
}

#[test]
fn decoders_are_small() {
    // They live in a microcontroller's static memory.
    assert!(size_of::<ToArmDecoder>() <= 1280, "{}", size_of::<ToArmDecoder>());
    assert!(size_of::<FromArmDecoder>() <= 1280, "{}", size_of::<FromArmDecoder>());
}
