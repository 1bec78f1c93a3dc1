//! `PROTOCOL.md` says what the code does.

use powderline_shared::fault::FaultCode;
use powderline_shared::plan::PlanReader;
use powderline_shared::wire::auth::MOST_WRONG_TAGS;
use powderline_shared::wire::frame::{Dialect, Frame};
use powderline_shared::wire::ids;
use powderline_shared::wire::load::Medium;
use powderline_shared::wire::message::{DEPTH, FromArm, HEARTBEAT_US, PROTOCOL_VERSION};
use powderline_shared::wire::serial::to_line;
use powderline_shared::wire::state::{Command, Event, Phase, State, TRANSITIONS};
use powderline_shared::wire::words::{StatusBits, controlword, state_bits, statusword};

use siphasher::sip128::SipHasher24;

use crate::golden;
use crate::samples::{self, CONTEXT, frames_from_arm};

const DOCUMENT: &str = include_str!("../../PROTOCOL.md");

/// Rows of the table under a heading, without its head; cells trimmed.
fn table(heading: &str, index: usize) -> Vec<Vec<&'static str>> {
    let (_, section) = DOCUMENT.split_once(&format!("\n{heading}\n")).unwrap();
    let lines: Vec<&str> = section.lines().collect();
    let blocks = lines.split(|line| !line.starts_with('|')).filter(|block| !block.is_empty());
    let rows = blocks.skip(index).map(|block| block.iter().skip(2)).next().unwrap();
    rows.map(|row| row.trim_matches('|').split('|').map(str::trim).collect()).collect()
}

/// Compares a table with what it should be; shows all of what it should be.
fn assert_table(heading: &str, index: usize, expected: &[Vec<String>]) {
    let should = || {
        let rows = expected.iter().map(|row| format!("| {} |", row.join(" | ")));
        rows.collect::<Vec<_>>().join("\n")
    };
    assert!(table(heading, index) == *expected, "the table under {heading} should be\n{}", should());
}

fn command_name(command: Command) -> &'static str {
    match command {
        Command::Shutdown => "shutdown",
        Command::SwitchOn => "switch on",
        Command::EnableOperation => "enable operation",
        Command::DisableVoltage => "disable voltage",
        Command::QuickStop => "quick stop",
        Command::FaultReset => "fault reset",
    }
}

#[test]
fn states() {
    let rows = TRANSITIONS.map(|line| {
        let event = match line.event {
            Event::Automatic => "automatic",
            Event::Command(command) => command_name(command),
            Event::FaultFound => "fault found",
        };
        let still = if line.at_standstill { "yes" } else { "no" };
        [&line.number.to_string(), line.from.name(), event, line.to.name(), still].map(String::from).to_vec()
    });
    assert_table("### States", 0, &rows);
}

#[test]
fn fault_codes() {
    let row = |code: &FaultCode| vec![code.number().to_string(), code.sentence().to_string()];
    let rows: Vec<_> = FaultCode::ALL.iter().map(row).collect();
    assert_table("### Fault codes", 0, &rows);
}

#[test]
fn words() {
    let mut commands = Command::ALL.map(|command| (controlword(command), command_name(command)));
    commands.sort_unstable();
    let rows = commands.map(|(word, name)| vec![format!("{word:#06x}").replace('f', "F"), name.to_string()]);
    assert_table("### Controlword", 0, &rows);

    let word = |text: &str| u16::from_str_radix(text.trim_start_matches("0x"), 16).unwrap();
    let rows = table("### Statusword", 0);
    for (row, state) in rows.iter().zip(State::ALL) {
        assert_eq!((word(row[0]), row[2]), (state_bits(state), state.name()));
    }
    let bits =
        StatusBits { state: State::OperationEnabled, phase: None, standstill: false, in_session: false };
    let added = |bits| statusword(bits) - state_bits(State::OperationEnabled);
    let phases = [Phase::Armed, Phase::Streaming, Phase::Completing, Phase::Holding];
    let mut expected = vec![added(StatusBits { standstill: true, ..bits })];
    expected.extend(phases.map(|phase| added(StatusBits { phase: Some(phase), ..bits })));
    expected.push(added(StatusBits { in_session: true, ..bits }));
    assert!(rows[8..].iter().map(|row| word(row[0])).eq(expected));
}

#[test]
fn identifiers_and_lengths() {
    let rows = table("## Identifiers", 0);
    let known = [
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
    for (row, id) in rows.iter().zip(known) {
        assert_eq!(row[0].to_lowercase(), format!("{id:#05x}"));
        for (dialect, lengths) in [(Dialect::Classic, row[3]), (Dialect::Fd, row[4])] {
            let sent = golden_frames(dialect).into_iter().filter(|frame| frame.id == id);
            let (least, most) = lengths.split_once(" to ").unwrap_or((lengths, lengths));
            let Ok(least) = least.parse() else {
                assert_eq!(sent.count(), 0);
                continue;
            };
            let range = least..=most.parse::<usize>().unwrap();
            assert!(sent.map(|frame| frame.data.len()).all(|length| range.contains(&length)), "{id:#x}");
        }
    }
    assert_eq!(rows.len(), known.len());
}

#[test]
fn numbers_in_the_text() {
    assert!(DOCUMENT.starts_with(&format!("# The wire, protocol version {PROTOCOL_VERSION}\n")));
    assert!(DOCUMENT.contains(&format!("room for the {DEPTH} setpoints")));
    assert!(DOCUMENT.contains(&format!("heartbeat every {} ms", HEARTBEAT_US / 1_000)));
    for (row, dialect) in table("## Conventions", 0).iter().zip(Dialect::ALL) {
        let lsb = dialect.lsb();
        let micro = |nano: u32| f64::from(nano) / 1e3;
        assert_eq!(row[1], format!("{} um", micro(lsb.translation_nm)));
        assert_eq!(row[2], format!("{} urad", micro(lsb.rotation_nrad)));
    }
}

/// The variants of the records, which come first in the body and, for refusals, after the session of two bytes.
#[test]
fn variants() {
    let bodies = |wanted: fn(&FromArm) -> Option<String>| {
        let messages = samples::from_arm().into_iter().map(|(_, message)| message);
        let named = messages.filter_map(move |message| wanted(&message).map(|name| (message, name)));
        named.map(|(message, name)| {
            (frames_from_arm(Dialect::Fd, &[message]).remove(0).data[3..].to_vec(), name)
        })
    };
    let name = |shown: String| shown.split([' ', '{']).next().unwrap().to_string();
    let rows = |index| {
        let rows = table("## Handshake", index).into_iter();
        rows.map(|row| (row[0].parse::<u8>().unwrap(), row[1].to_string())).collect::<Vec<_>>()
    };
    let reasons: Vec<_> = bodies(|message| match message {
        FromArm::Refused { reason, .. } => Some(format!("{reason:?}")),
        _ => None,
    })
    .map(|(body, shown)| (body[3], name(shown)))
    .collect();
    assert_eq!(rows(3), reasons);
    let mut records: Vec<_> = bodies(|message| match message {
        FromArm::Opened { .. } | FromArm::Refused { .. } | FromArm::Anchored { .. } => {
            Some(format!("{message:?}"))
        }
        _ => None,
    })
    .map(|(body, shown)| (body[0], name(shown)))
    .collect();
    records.dedup();
    assert_eq!(rows(2), records);
    // Those of a session with a key are the first of each kind there.
    let keyed: Vec<_> = [ids::HANDSHAKE_TO_ARM, ids::HANDSHAKE_FROM_ARM]
        .into_iter()
        .flat_map(|id| golden_frames(Dialect::Fd).into_iter().filter(move |frame| frame.id == id))
        .filter(|frame| frame.data[0] & 0x3F == 0)
        .map(|frame| (frame.id, frame.data[3]))
        .collect();
    for row in table("## With a key", 0) {
        let (variant, id) = (row[0].parse().unwrap(), u16::from_str_radix(&row[2][2..], 16).unwrap());
        assert_eq!(keyed.iter().filter(|found| **found == (id, variant)).count(), 1, "{}", row[1]);
    }
    let row = ["after **", "frames with a wrong 8-bit tag**"].join(&format!("{MOST_WRONG_TAGS} "));
    assert!(DOCUMENT.contains(&row));
}

#[test]
fn loads() {
    let media = [
        Medium::Classic { bit_s: 500e3 },
        Medium::Classic { bit_s: 1e6 },
        Medium::Fd { nominal_bit_s: 1e6, data_bit_s: 5e6 },
        Medium::Serial { bit_s: 921_600.0 },
    ];
    for (row, medium) in table("## Bus load", 0).iter().zip(media) {
        let found =
            [10_000, 4_000, 2_000, 1_000].map(|period_us| format!("{:.1} %", medium.load_percent(period_us)));
        assert_eq!(row[1..], found);
    }
}

/// Reads a plan by the table, row by row, and nothing else; to its last byte.
#[test]
fn plan_files() {
    let file = include_bytes!("../golden/plan-v4.plan");
    let plan = PlanReader::new(file).unwrap();
    let mut walk = Walk { rest: file, numbers: Vec::new() };
    for row in table("## Plan files", 0) {
        let steps = walk.numbers.get(PLAN_STEPS).map_or(1, |steps| *steps as usize);
        match row[1].split(':').next().unwrap() {
            "of each step" => walk.take(row[0], steps),
            _ => walk.take(row[0], 1),
        }
    }
    assert!(walk.rest.is_empty() && plan.header().arm.is_some() && plan.header().finer.is_some());
    let of_steps = 6 * plan.header().step_count as usize;
    let (before, [crc]) = walk.numbers.split_at(walk.numbers.len() - 1) else { unreachable!() };
    assert_eq!(*crc as u32, crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC).checksum(&file[..file.len() - 4]));
    let steps = &before[before.len() - of_steps..];
    let ends: [i64; 6] = std::array::from_fn(|axis| steps.iter().skip(axis).step_by(6).sum());
    assert_eq!(ends, plan.end_setpoint().counts.map(i64::from));
    assert_eq!(before[PLAN_STEPS - 1], i64::from(plan.header().control_period_us));
}

/// Which of the whole numbers of a plan is that of its steps: after version, program, seed, precision, path and period.
const PLAN_STEPS: usize = 8;

/// What is left of a file, and the whole numbers of what has been taken.
struct Walk<'a> {
    rest: &'a [u8],
    numbers: Vec<i64>,
}

impl Walk<'_> {
    /// So many fields of a type, that many times.
    fn take(&mut self, kind: &str, times: usize) {
        let (many, kind) = kind.split_once(' ').unwrap_or(("1", kind));
        for _ in 0..times * many.parse::<usize>().unwrap() {
            let number = match kind {
                "byte" | "bytes" => return self.skip(times * many.parse::<usize>().unwrap()),
                "f64" => {
                    self.skip(8);
                    continue;
                }
                "u16" => self.whole(2),
                "u32" => self.whole(4),
                "varint" => self.varint(),
                "zigzag" => {
                    let number = self.varint();
                    (number >> 1) ^ -(number & 1)
                }
                _ => panic!("{kind}"),
            };
            self.numbers.push(number);
        }
    }

    fn skip(&mut self, many: usize) {
        self.rest = &self.rest[many..];
    }

    fn whole(&mut self, many: usize) -> i64 {
        let value = self.rest[..many].iter().rev().fold(0, |value, byte| value << 8 | i64::from(*byte));
        self.skip(many);
        value
    }

    fn varint(&mut self) -> i64 {
        let many = self.rest.iter().position(|byte| byte & 0x80 == 0).unwrap() + 1;
        let value =
            self.rest[..many].iter().rev().fold(0_u64, |value, byte| value << 7 | u64::from(byte & 0x7F));
        self.skip(many);
        value.cast_signed()
    }
}

fn bytes(hex: &str) -> Vec<u8> {
    let digits: String = hex.split_whitespace().collect();
    (0..digits.len()).step_by(2).map(|at| u8::from_str_radix(&digits[at..at + 2], 16).unwrap()).collect()
}

/// A frame from candump's notation.
fn frame(text: &str) -> (Dialect, Frame) {
    let (id, data) = text.split_once('#').unwrap();
    let id = u16::from_str_radix(id, 16).unwrap();
    let (dialect, data) =
        data.strip_prefix("#1").map_or((Dialect::Classic, data), |data| (Dialect::Fd, data));
    (dialect, Frame::new(id, &bytes(data)).unwrap())
}

fn golden_frames(dialect: Dialect) -> Vec<Frame> {
    let lines = golden::files(dialect).into_iter().flat_map(str::lines);
    lines.filter(|line| line.contains('#') && !line.starts_with('#')).map(|line| frame(line).1).collect()
}

#[derive(Default)]
struct Checked {
    frames: usize,
    crc8: usize,
    crc32: usize,
    keys: usize,
    records: usize,
    lines: usize,
    tags: usize,
}

/// Every example is a frame that the codec makes (the golden files are what it makes), and every checksum in it is the
/// one of what it says to be covered.
#[test]
fn examples() {
    let mut checked = Checked::default();
    let (mut last, mut covered, mut record) = (None::<Frame>, Vec::new(), Vec::new());
    let mut secret = [0; 16];
    let in_code = DOCUMENT.split("```").skip(1).step_by(2).flat_map(str::lines);
    for line in in_code.filter(|line| !line.is_empty() && *line != "text") {
        let (key, value) = line.split_once(' ').unwrap();
        match key {
            "frame" => {
                let (dialect, found) = frame(value.trim());
                assert!(golden_frames(dialect).contains(&found), "{line}");
                checked.frames += 1;
                check_segment(&record, dialect, &found);
                last = Some(found);
            }
            "covered" => covered = bytes(value),
            "crc-8" => {
                assert_eq!(
                    bytes(value),
                    [crc::Crc::<u8>::new(&crc::CRC_8_AUTOSAR).checksum(&covered)],
                    "{line}"
                );
                assert_eq!(last.as_ref().unwrap().data.last(), bytes(value).last(), "{line}");
                assert_eq!(covered[..2], last.as_ref().unwrap().id.to_le_bytes());
                checked.crc8 += 1;
            }
            "secret" => {
                secret = bytes(value).try_into().unwrap();
                last = None;
            }
            "tag" => {
                let hash = u128::from(SipHasher24::new_with_key(&secret).hash(&covered)).to_le_bytes();
                let tag = bytes(value);
                assert!(hash.starts_with(&tag), "{line} should be {hash:02X?}");
                // In front of an FD frame, at the end of a classic one; or of no frame.
                assert!(last.as_ref().is_none_or(|frame| match frame.data.len() {
                    9.. => frame.data.starts_with(&tag) && covered[6..] == frame.data[4..],
                    _ => frame.data.ends_with(&tag),
                }));
                checked.tags += 1;
            }
            "session" => covered = bytes(value),
            "key" => {
                let crc = crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC).checksum(&covered);
                assert_eq!(bytes(value), crc.to_le_bytes()[..3]);
                assert_eq!(bytes(value), CONTEXT.key());
                checked.keys += 1;
            }
            "record" => {
                record = bytes(value);
                covered.clear();
            }
            "crc-32" => {
                let whole = if covered.is_empty() { &record } else { &covered };
                let crc = crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC).checksum(whole).to_le_bytes();
                assert_eq!(bytes(value), crc, "{line}");
                if covered.is_empty() {
                    record.extend(crc);
                    checked.records += 1;
                } else {
                    // In front of an FD frame, at the end of a classic one.
                    let data = &last.as_ref().unwrap().data;
                    let parts =
                        if data.len() > 8 { [&crc[..], &covered[10..]] } else { [&covered[10..], &crc[..]] };
                    assert_eq!(**data, *parts.concat(), "{line}");
                    checked.crc32 += 1;
                }
            }
            "line" => {
                assert_eq!(*to_line(last.as_ref().unwrap()), *bytes(value));
                checked.lines += 1;
            }
            _ => panic!("{line}"),
        }
    }
    let Checked { frames, crc8, crc32, keys, records, lines, tags } = checked;
    assert_eq!((frames, crc8, crc32, keys, records, lines, tags), (32, 7, 4, 1, 4, 1, 9));
}

/// A segment holds the bytes of the record that its index stands for.
fn check_segment(record: &[u8], dialect: Dialect, frame: &Frame) {
    if ![ids::HANDSHAKE_FROM_ARM, ids::HANDSHAKE_TO_ARM].contains(&frame.id) {
        return;
    }
    let at = usize::from(frame.data[0] & 0x3F) * (dialect.max_data() - 1);
    assert!(record[at..].starts_with(&frame.data[1..]));
    assert_eq!(frame.data[0] & 0x80 != 0, at + frame.data.len() - 1 == record.len());
}
