//! What the fuzz targets have in common: seeds, bytes as frames, and checksums made right so that what they guard is
//! reached.

use powderline_shared::wire::Context;
use powderline_shared::wire::codec::{FromArmDecoder, ToArmDecoder};
use powderline_shared::wire::frame::{Dialect, Frame};
use powderline_shared::wire::ids;
use std::path::PathBuf;

/// Session of all targets, and of the golden frames.
pub const CONTEXT: Context = Context { session: 0x1234, seal: 0xcef0_4bf9_5369_9a72, key: None };

/// The plan whose bytes are pinned.
pub const GOLDEN_PLAN: &[u8] = include_bytes!("../../../shared/tests/golden/plan-v4.plan");

const GOLDEN_CLASSIC: &str = include_str!("../../../shared/tests/golden/wire-v3-classic.txt");
const GOLDEN_FD: &str = include_str!("../../../shared/tests/golden/wire-v3-fd.txt");

const IDS: [u16; 12] = [
    ids::STOP,
    ids::FAULT,
    ids::STATUS,
    ids::SETPOINT_T,
    ids::ACTUAL_T,
    ids::SETPOINT_R,
    ids::ACTUAL_R,
    ids::CONTROL,
    ids::HANDSHAKE_FROM_ARM,
    ids::HANDSHAKE_TO_ARM,
    ids::HEARTBEAT_FROM_ARM,
    ids::HEARTBEAT_TO_ARM,
];

/// Writes seeds into the folder that libFuzzer was given for its corpus, if it was given one: the first argument that is
/// no flag. What was found by earlier runs stays.
///
/// # Panics
/// The folder cannot be written.
pub fn plant(seeds: impl IntoIterator<Item = Vec<u8>>) {
    let corpus = std::env::args_os().skip(1).map(PathBuf::from).find(|path| path.is_dir());
    let Some(corpus) = corpus else { return };
    for (number, seed) in seeds.into_iter().enumerate() {
        std::fs::write(corpus.join(format!("seed-{number}")), seed).expect("a corpus can be written");
    }
}

/// Frames from bytes: one that chooses the identifier, one for the length, data; and so on.
pub fn frames(mut bytes: &[u8]) -> impl Iterator<Item = Frame> {
    std::iter::from_fn(move || {
        let ([choice, length], rest) = bytes.split_first_chunk::<2>()?;
        let (data, rest) = rest.split_at(usize::from(*length).min(64).min(rest.len()));
        bytes = rest;
        Frame::new(IDS[usize::from(*choice) % IDS.len()], data)
    })
}

/// The bytes that [`frames`] makes these frames of.
pub fn bytes_of(frames: &[Frame]) -> Vec<u8> {
    let bytes = |frame: &Frame| {
        let choice = IDS.iter().position(|id| *id == frame.id).expect("golden frames have known identifiers");
        [&[choice as u8, frame.data.len() as u8], &frame.data[..]].concat()
    };
    frames.iter().flat_map(bytes).collect()
}

/// Seeds from frames: each message alone, and all in their order.
pub fn message_seeds(messages: &[Vec<Frame>]) -> Vec<Vec<u8>> {
    messages.iter().map(|frames| bytes_of(frames)).chain([bytes_of(&messages.concat())]).collect()
}

/// The frames whose bytes are pinned, in one message after the other. `way` is `to` or `from`, as seen by the arm.
///
/// # Panics
/// The file is not as it is written, or of another session: no seed would get past its checksum.
pub fn golden(dialect: Dialect, way: &str) -> Vec<Vec<Frame>> {
    let text = match dialect {
        Dialect::Classic => GOLDEN_CLASSIC,
        Dialect::Fd => GOLDEN_FD,
    };
    let ours = format!("session {:#06x}, seal {:#018x}.", CONTEXT.session, CONTEXT.seal);
    assert!(
        text.lines().next().is_some_and(|first| first.ends_with(&ours)),
        "golden frames are not of {ours}"
    );
    let sections = text.split("\n# ").filter(|section| section.starts_with(&format!("{way} arm")));
    let messages = sections.map(|section| {
        let lines = section.lines().skip(1).filter(|line| !line.is_empty());
        lines.map(|line| candump_frame(line).expect("golden frames are as candump writes them")).collect()
    });
    messages.collect()
}

/// A frame as candump writes it: `601#0076`, and `601##10076` on CAN FD.
fn candump_frame(line: &str) -> Option<Frame> {
    let (id, data) = line.split_once("##1").or_else(|| line.split_once('#'))?;
    let bytes = data.as_bytes().chunks(2).map(|digits| {
        let digits = std::str::from_utf8(digits).ok()?;
        u8::from_str_radix(digits, 16).ok()
    });
    Frame::new(u16::from_str_radix(id, 16).ok()?, &bytes.collect::<Option<Vec<u8>>>()?)
}

/// The frame with its first four bytes replaced by the checksum of FD frames, for the session that it names.
pub fn sealed_fd(frame: &Frame) -> Frame {
    let mut sealed = frame.clone();
    if sealed.data.len() < 12 {
        return sealed;
    }
    let seal = if sealed.data[8..10] == [0, 0] { 0 } else { CONTEXT.seal };
    let covered = [&frame.id.to_le_bytes()[..], &seal.to_le_bytes(), &frame.data[4..]].concat();
    sealed.data[..4].copy_from_slice(&crc32(&covered).to_le_bytes());
    sealed
}

/// CRC-32/ISO-HDLC.
pub fn crc32(bytes: &[u8]) -> u32 {
    // Its table takes longer to make than a frame takes to check.
    static CRC: crc::Crc<u32> = crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC);
    CRC.checksum(bytes)
}

/// An arm's decoder in the session.
pub fn arm(dialect: Dialect) -> ToArmDecoder {
    let mut decoder = ToArmDecoder::new(dialect);
    decoder.set_context(CONTEXT);
    decoder
}

/// An executor's decoder in the session.
pub fn executor(dialect: Dialect) -> FromArmDecoder {
    let mut decoder = FromArmDecoder::new(dialect);
    decoder.set_context(CONTEXT);
    decoder
}

/// What every refusal is: one line, without control characters, of a length that a person reads.
///
/// # Panics
/// It is not.
pub fn assert_sentence(refusal: &impl std::fmt::Display) {
    let sentence = refusal.to_string();
    assert!(!sentence.is_empty() && sentence.len() < 20_000, "{} bytes", sentence.len());
    assert!(!sentence.contains(char::is_control), "{sentence:?}");
}
