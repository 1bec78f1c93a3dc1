//! Logs in the format of candump's `-l` and canplayer, from can-utils.
//!
//! ```text
//! (1436509052.249713) vcan0 201#11223344      classic: identifier, data
//! (1436509052.449847) vcan0 201##1AABB        CAN FD: identifier, flags (1: bit rate switch, 2: error state), data
//! # The arm stopped by fault 131.             a remark, which canplayer skips
//! ```
//!
//! Extended (8 digits), remote (`123#R`) and error frames are read as what they are, since a log of a real bus may hold
//! them; they never become a [`Frame`].

use std::fmt;
use std::io::{self, Write};

use heapless::Vec;
use powderline_shared::wire::frame::{Dialect, Frame, MAX_DATA};
use thiserror::Error;

/// Most data bytes of a classic frame.
const MAX_CLASSIC_DATA: usize = 8;
/// Set in the identifier of an error frame (`CAN_ERR_FLAG`).
const ERROR_FLAG: u32 = 0x2000_0000;

/// One line of a log.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Record {
    /// When, microseconds; since when is the writer's choice.
    pub at_us: u64,
    /// Interface.
    pub interface: String,
    /// What was on the wire.
    pub content: Content,
}

/// What was on the wire.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Content {
    /// A data frame with an 11-bit identifier.
    Frame {
        /// The frame.
        frame: Frame,
        /// How it was sent.
        dialect: Dialect,
    },
    /// A frame with a 29-bit identifier.
    Extended {
        /// Identifier.
        id: u32,
    },
    /// A remote frame.
    Remote {
        /// Identifier.
        id: u32,
    },
    /// An error frame.
    Error {
        /// What it is about, `CAN_ERR_..` of `linux/can/error.h`.
        class: u32,
    },
}

/// Why a line is none of a log.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum ParseError {
    /// The three fields.
    #[error("a line has a time, an interface and a frame, as in \"(1436509052.249713) can0 201#11223344\"")]
    Fields,
    /// The time.
    #[error("the time is seconds and six digits of microseconds in parentheses, as in (1436509052.249713)")]
    Time,
    /// No separator.
    #[error(
        "a frame has a # between identifier and data (## before the flags of CAN FD), as in 201#11223344"
    )]
    Separator,
    /// The identifier.
    #[error("an identifier has 3 hexadecimal digits up to 7FF, or 8 of an extended or error frame")]
    Identifier,
    /// The flags of CAN FD.
    #[error("a CAN FD frame has one hexadecimal digit of flags after its ##, as in 201##1AABB")]
    Flags,
    /// The data.
    #[error("data are pairs of hexadecimal digits, at most 8 of them (64 in CAN FD)")]
    Data,
}

/// A line that is no line of a log.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[error("line {number}: {error}")]
pub struct LineError {
    /// Which, from 1.
    pub number: usize,
    /// Why.
    pub error: ParseError,
}

/// Reads a log, line by line. As canplayer does, it skips lines that do not begin with a time.
pub fn read(log: &str) -> impl Iterator<Item = Result<Record, LineError>> + '_ {
    log.lines().enumerate().filter(|(_, line)| line.starts_with('(')).map(|(index, line)| {
        parse_line(line).map_err(|error| LineError { number: index.saturating_add(1), error })
    })
}

/// Reads one line.
///
/// # Errors
/// If it is no line of a log.
pub fn parse_line(line: &str) -> Result<Record, ParseError> {
    let mut fields = line.split_ascii_whitespace();
    let (Some(time), Some(interface), Some(frame)) = (fields.next(), fields.next(), fields.next()) else {
        return Err(ParseError::Fields);
    };
    // candump may add the direction: R (received) or T (sent here).
    if !matches!((fields.next(), fields.next()), (None | Some("R" | "T"), None)) {
        return Err(ParseError::Fields);
    }
    Ok(Record { at_us: parse_time(time)?, interface: interface.to_owned(), content: parse_content(frame)? })
}

fn parse_time(time: &str) -> Result<u64, ParseError> {
    let inner = time.strip_prefix('(').and_then(|time| time.strip_suffix(')'));
    let (seconds, micros) = inner.and_then(|inner| inner.split_once('.')).ok_or(ParseError::Time)?;
    let digits = |text: &str| text.bytes().all(|byte| byte.is_ascii_digit());
    if micros.len() != 6 || !digits(micros) || !digits(seconds) {
        return Err(ParseError::Time);
    }
    let seconds: u64 = seconds.parse().map_err(|_| ParseError::Time)?;
    let micros: u64 = micros.parse().map_err(|_| ParseError::Time)?;
    seconds.checked_mul(1_000_000).and_then(|whole| whole.checked_add(micros)).ok_or(ParseError::Time)
}

fn parse_content(text: &str) -> Result<Content, ParseError> {
    let (id, rest) = text.split_once('#').ok_or(ParseError::Separator)?;
    let number = parse_hex(id).ok_or(ParseError::Identifier)?;
    let extended = id.len() == 8;
    if !extended && (id.len() != 3 || number > 0x7FF) {
        return Err(ParseError::Identifier);
    }
    let (dialect, data) = match rest.strip_prefix('#') {
        Some(rest) => (Dialect::Fd, after_flags(rest)?),
        None => (Dialect::Classic, rest),
    };
    if dialect == Dialect::Classic && data.starts_with('R') {
        return Ok(Content::Remote { id: number });
    }
    let data = parse_data(data, dialect)?;
    match u16::try_from(number) {
        Ok(id) if !extended => Ok(Content::Frame { frame: Frame { id, data }, dialect }),
        _ if number & ERROR_FLAG != 0 => Ok(Content::Error { class: number & !ERROR_FLAG }),
        _ => Ok(Content::Extended { id: number }),
    }
}

fn parse_hex(digits: &str) -> Option<u32> {
    let plain = digits.bytes().all(|byte| byte.is_ascii_hexdigit());
    plain.then(|| u32::from_str_radix(digits, 16).ok()).flatten()
}

fn after_flags(rest: &str) -> Result<&str, ParseError> {
    let mut characters = rest.chars();
    match characters.next() {
        Some(flags) if flags.is_ascii_hexdigit() => Ok(characters.as_str()),
        _ => Err(ParseError::Flags),
    }
}

fn parse_data(digits: &str, dialect: Dialect) -> Result<Vec<u8, MAX_DATA>, ParseError> {
    // candump marks the length code of a full classic frame behind an underscore, if it is above 8.
    let digits = digits.split_once('_').map_or(digits, |(digits, _)| digits);
    let most = match dialect {
        Dialect::Classic => MAX_CLASSIC_DATA,
        Dialect::Fd => MAX_DATA,
    };
    let (pairs, odd) = digits.as_bytes().as_chunks::<2>();
    if !odd.is_empty() || pairs.len() > most {
        return Err(ParseError::Data);
    }
    pairs.iter().map(|pair| parse_byte(*pair).ok_or(ParseError::Data)).collect()
}

fn parse_byte(pair: [u8; 2]) -> Option<u8> {
    let [high, low] = pair.map(|digit| char::from(digit).to_digit(16));
    u8::try_from(high?.checked_mul(16)?.checked_add(low?)?).ok()
}

impl fmt::Display for Record {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "({:010}.{:06}) {} ", self.at_us / 1_000_000, self.at_us % 1_000_000, self.interface)?;
        match &self.content {
            Content::Frame { frame, dialect } => write!(f, "{}", Logged { frame, dialect: *dialect }),
            Content::Extended { id } => write!(f, "{id:08X}#"),
            Content::Remote { id } if *id > 0x7FF => write!(f, "{id:08X}#R"),
            Content::Remote { id } => write!(f, "{id:03X}#R"),
            Content::Error { class } => write!(f, "{:08X}#0000000000000000", class | ERROR_FLAG),
        }
    }
}

/// A frame as it stands in a log.
struct Logged<'a> {
    frame: &'a Frame,
    dialect: Dialect,
}

impl fmt::Display for Logged<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        // Frames of CAN FD are sent with the bit rate switch.
        let separator = match self.dialect {
            Dialect::Classic => "#",
            Dialect::Fd => "##1",
        };
        write!(f, "{:03X}{separator}", self.frame.id)?;
        self.frame.data.iter().try_for_each(|byte| write!(f, "{byte:02X}"))
    }
}

/// Writes a log of one wire.
#[derive(Debug)]
pub struct Writer<W> {
    sink: W,
    interface: String,
    dialect: Dialect,
}

impl<W: Write> Writer<W> {
    /// Writes to `sink`. `interface` is a CAN interface's name; for another wire use one, such as `serial0`, that has no
    /// space and no slash.
    pub fn new(sink: W, interface: &str, dialect: Dialect) -> Self {
        let interface = interface.replace(|c: char| c.is_whitespace() || c == '/', "_");
        Self { sink, interface, dialect }
    }

    /// Writes a frame.
    ///
    /// # Errors
    /// If the sink fails.
    pub fn frame(&mut self, at_us: u64, frame: &Frame) -> io::Result<()> {
        let (seconds, micros) = (at_us / 1_000_000, at_us % 1_000_000);
        let logged = Logged { frame, dialect: self.dialect };
        writeln!(self.sink, "({seconds:010}.{micros:06}) {} {logged}", self.interface)
    }

    /// Writes a remark, each line of it behind a `#`.
    ///
    /// # Errors
    /// If the sink fails.
    pub fn remark(&mut self, text: &str) -> io::Result<()> {
        text.lines().try_for_each(|line| writeln!(self.sink, "# {line}"))
    }

    /// Gives the sink back.
    pub fn into_inner(self) -> W {
        self.sink
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn made(id: u16, data: &[u8], dialect: Dialect) -> Content {
        Content::Frame { frame: Frame { id, data: Vec::from_slice(data).unwrap() }, dialect }
    }

    #[test]
    fn lines_of_candump_are_read_and_written_as_they_are() {
        for (line, at_us, content) in [
            (
                "(1436509052.249713) vcan0 044#2A366C2BBA",
                1_436_509_052_249_713,
                made(0x044, &[0x2A, 0x36, 0x6C, 0x2B, 0xBA], Dialect::Classic),
            ),
            (
                "(1436509053.850870) can0 7FF##1AABB",
                1_436_509_053_850_870,
                made(0x7FF, &[0xAA, 0xBB], Dialect::Fd),
            ),
            ("(0000000000.000001) can0 001#", 1, made(0x001, &[], Dialect::Classic)),
            (
                "(1436509053.000002) can0 12345678#",
                1_436_509_053_000_002,
                Content::Extended { id: 0x1234_5678 },
            ),
            ("(1436509053.000002) can0 123#R", 1_436_509_053_000_002, Content::Remote { id: 0x123 }),
            (
                "(1436509053.000002) can0 20000040#0000000000000000",
                1_436_509_053_000_002,
                Content::Error { class: 0x40 },
            ),
        ] {
            let record = parse_line(line).unwrap();
            assert_eq!((record.at_us, &record.content), (at_us, &content), "{line}");
            assert_eq!(record.to_string(), line);
        }
        let directed = parse_line("(1.000000) can0 201##0aabb R").unwrap();
        assert_eq!(directed.content, made(0x201, &[0xAA, 0xBB], Dialect::Fd));
        assert_eq!(
            parse_line("(1.000000) can0 123#R5").unwrap().content,
            Content::Remote { id: 0x123 },
            "a remote frame may ask for a length"
        );
        assert!(parse_line("(1.000000) can0 123#1122334455667788_9").is_ok());
    }

    #[test]
    fn what_is_wrong_with_a_line_is_said() {
        for (line, error) in [
            ("(1.000000) can0", ParseError::Fields),
            ("(1.000000) can0 123#11 X", ParseError::Fields),
            ("(1.000000) can0 123#11 R 1", ParseError::Fields),
            ("1.000000 can0 123#11", ParseError::Time),
            ("(1.00000) can0 123#11", ParseError::Time),
            ("(-1.000000) can0 123#11", ParseError::Time),
            ("(99999999999999999999.000000) can0 123#11", ParseError::Time),
            ("(1.000000) can0 123", ParseError::Separator),
            ("(1.000000) can0 12#11", ParseError::Identifier),
            ("(1.000000) can0 800#11", ParseError::Identifier),
            ("(1.000000) can0 +12#11", ParseError::Identifier),
            ("(1.000000) can0 123##", ParseError::Flags),
            ("(1.000000) can0 123##x11", ParseError::Flags),
            ("(1.000000) can0 123#1", ParseError::Data),
            ("(1.000000) can0 123#+1", ParseError::Data),
            ("(1.000000) can0 123#é", ParseError::Data),
            ("(1.000000) can0 123#112233445566778899", ParseError::Data),
        ] {
            assert_eq!(parse_line(line), Err(error), "{line}");
        }
    }

    #[test]
    fn a_log_is_written_with_remarks_and_read_without_them() {
        let mut writer = Writer::new(std::vec::Vec::new(), "/dev/tty USB0", Dialect::Fd);
        let frame = Frame { id: 0x181, data: Vec::from_slice(&[0, 255]).unwrap() };
        writer.frame(12_000_034, &frame).unwrap();
        writer.remark("The arm stopped.\nSecond line").unwrap();
        let log = String::from_utf8(writer.into_inner()).unwrap();
        assert_eq!(log, "(0000000012.000034) _dev_tty_USB0 181##100FF\n# The arm stopped.\n# Second line\n");
        let records: Result<std::vec::Vec<_>, _> = read(&log).collect();
        let content = Content::Frame { frame, dialect: Dialect::Fd };
        let interface = "_dev_tty_USB0".to_owned();
        assert_eq!(records, Ok(vec![Record { at_us: 12_000_034, interface, content }]));
        let error = read("\n(1.000000) can0 123#1\n").next().unwrap().unwrap_err();
        assert!(error.to_string().starts_with("line 2: data are pairs"), "{error}");
    }

    proptest! {
        #[test]
        fn any_line_is_a_record_or_an_error(line in "\\(\\PC{0,40}") {
            if let Ok(record) = parse_line(&line) {
                prop_assert!(parse_line(&record.to_string()).is_ok());
            }
        }

        #[test]
        fn every_frame_comes_back(at_us in any::<u64>(), id in 0_u16..=0x7FF, data in prop::collection::vec(any::<u8>(), 0..=64)) {
            let content = made(id, &data, Dialect::Fd);
            let record = Record { at_us, interface: "can0".to_owned(), content };
            prop_assert_eq!(parse_line(&record.to_string()), Ok(record));
        }
    }
}
