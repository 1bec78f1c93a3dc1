//! The wire as it is typed on the command line.
//!
//! | typed                            | what it is                                                       |
//! |----------------------------------|------------------------------------------------------------------|
//! | `sim`                            | an arm inside the same process                                   |
//! | `can:IFACE[@BITRATE]`            | classic CAN on a SocketCAN interface                             |
//! | `canfd:IFACE[@NOMINAL/DATA]`     | CAN FD on a SocketCAN interface                                  |
//! | `serial:DEVICE[@BAUD]`           | a serial line, [`DEFAULT_BAUD`] unless it is said                |
//! | `pty`                            | a new pseudo-terminal, to be opened by the other program         |
//!
//! Rates are bits per second: `500000`, `500k`, `1M`. A CAN interface has its rates from the system; typed ones are
//! compared with those, and stand in for them where the interface has none.

use std::fmt;
use std::path::PathBuf;
use std::str::FromStr;

use thiserror::Error;

/// Rate of a serial line for which none is typed, baud.
pub const DEFAULT_BAUD: u32 = 921_600;

/// Rates of classic CAN and of the arbitration phase of CAN FD, bits per second (ISO 11898-2).
const NOMINAL_BIT_S: std::ops::RangeInclusive<u32> = 10_000..=1_000_000;
/// Rates of the data phase of CAN FD, bits per second; 8 Mbit/s is the most that transceivers are made for.
const DATA_BIT_S: std::ops::RangeInclusive<u32> = 10_000..=8_000_000;
/// Rates of serial lines, baud.
const BAUD: std::ops::RangeInclusive<u32> = 9_600..=12_000_000;
/// Longest name of an interface, bytes (`IFNAMSIZ` less its zero).
const MAX_INTERFACE: usize = 15;

/// The wire between executor and arm.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Link {
    /// An arm inside the same process.
    Sim,
    /// Classic CAN.
    Can {
        /// Name of the interface.
        interface: String,
        /// Rate that it is expected to have, bits per second.
        bit_s: Option<u32>,
    },
    /// CAN FD.
    CanFd {
        /// Name of the interface.
        interface: String,
        /// Rates that it is expected to have: arbitration and data, bits per second.
        bit_s: Option<(u32, u32)>,
    },
    /// A serial line.
    Serial {
        /// The device.
        device: PathBuf,
        /// Its rate, baud.
        baud: u32,
    },
    /// A new pseudo-terminal.
    Pty,
}

/// Why an address is not one.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum LinkParseError {
    /// No kind of wire.
    #[error(
        "\"{0}\" is no wire: it is sim, can:IFACE[@BITRATE], canfd:IFACE[@NOMINAL/DATA], serial:DEVICE[@BAUD] or pty"
    )]
    Kind(String),
    /// An interface cannot be called that.
    #[error(
        "\"{0}\" names no network interface: a name has 1 to 15 characters without space or slash, as in can:can0"
    )]
    Interface(String),
    /// A serial line without a device.
    #[error("a serial line needs its device, as in serial:/dev/ttyUSB0@{DEFAULT_BAUD}")]
    Device,
    /// Not a number.
    #[error("\"{0}\" is no rate: it is a whole number of bits per second, as in 500000, 500k or 1M")]
    Rate(String),
    /// A number outside the range.
    #[error("{what} of {given} bit/s is out of range: it lies between {least} and {most} bit/s")]
    Range {
        /// Of what.
        what: &'static str,
        /// As typed, bits per second.
        given: u32,
        /// Least.
        least: u32,
        /// Most.
        most: u32,
    },
    /// One rate where two are needed.
    #[error("CAN FD has two rates, of arbitration and of data, as in canfd:can0@1M/5M, not \"{0}\"")]
    OneRate(String),
    /// Data slower than arbitration.
    #[error(
        "the data rate of {data} bit/s is below the arbitration rate of {nominal} bit/s: it is at least as high"
    )]
    SlowData {
        /// Arbitration, bits per second.
        nominal: u32,
        /// Data, bits per second.
        data: u32,
    },
}

impl FromStr for Link {
    type Err = LinkParseError;

    fn from_str(typed: &str) -> Result<Self, LinkParseError> {
        match typed.split_once(':') {
            None if typed == "sim" => Ok(Self::Sim),
            None if typed == "pty" => Ok(Self::Pty),
            Some(("can", rest)) => parse_can(rest),
            Some(("canfd", rest)) => parse_canfd(rest),
            Some(("serial", rest)) => parse_serial(rest),
            _ => Err(LinkParseError::Kind(typed.to_owned())),
        }
    }
}

fn parse_can(rest: &str) -> Result<Link, LinkParseError> {
    let (interface, rate) = interface_and_rest(rest)?;
    let bit_s = rate.map(|rate| in_range("a bit rate", parse_rate(rate)?, &NOMINAL_BIT_S)).transpose()?;
    Ok(Link::Can { interface, bit_s })
}

fn parse_canfd(rest: &str) -> Result<Link, LinkParseError> {
    let (interface, rates) = interface_and_rest(rest)?;
    let bit_s = rates.map(parse_two_rates).transpose()?;
    Ok(Link::CanFd { interface, bit_s })
}

fn parse_two_rates(rates: &str) -> Result<(u32, u32), LinkParseError> {
    let (nominal, data) = rates.split_once('/').ok_or_else(|| LinkParseError::OneRate(rates.to_owned()))?;
    let nominal = in_range("an arbitration rate", parse_rate(nominal)?, &NOMINAL_BIT_S)?;
    let data = in_range("a data rate", parse_rate(data)?, &DATA_BIT_S)?;
    if data < nominal {
        return Err(LinkParseError::SlowData { nominal, data });
    }
    Ok((nominal, data))
}

fn parse_serial(rest: &str) -> Result<Link, LinkParseError> {
    // Names below /dev/serial/by-id may hold an @ themselves: what follows the last one is a rate if it begins as one.
    let typed_rate = rest.rsplit_once('@').filter(|(_, rate)| rate.starts_with(|c: char| c.is_ascii_digit()));
    let (device, baud) = match typed_rate {
        Some((device, rate)) => (device, in_range("a serial rate", parse_rate(rate)?, &BAUD)?),
        None => (rest, DEFAULT_BAUD),
    };
    if device.is_empty() {
        return Err(LinkParseError::Device);
    }
    Ok(Link::Serial { device: device.into(), baud })
}

fn interface_and_rest(rest: &str) -> Result<(String, Option<&str>), LinkParseError> {
    let (name, rate) = rest.split_once('@').map_or((rest, None), |(name, rate)| (name, Some(rate)));
    let plain = name.bytes().all(|byte| byte.is_ascii_graphic() && byte != b'/');
    if name.is_empty() || name.len() > MAX_INTERFACE || !plain {
        return Err(LinkParseError::Interface(name.to_owned()));
    }
    Ok((name.to_owned(), rate))
}

/// Bits per second from `500000`, `500k` or `1M`.
///
/// # Errors
/// If it is none of these or does not fit 32 bits.
pub fn parse_rate(typed: &str) -> Result<u32, LinkParseError> {
    let (digits, unit) = match typed.as_bytes().last() {
        Some(b'k') => (typed.trim_end_matches('k'), 1_000),
        Some(b'M') => (typed.trim_end_matches('M'), 1_000_000),
        _ => (typed, 1),
    };
    let one_unit = typed.len().saturating_sub(digits.len()) <= 1;
    let plain = one_unit && !digits.is_empty() && digits.bytes().all(|byte| byte.is_ascii_digit());
    let number = plain.then(|| digits.parse::<u32>().ok()?.checked_mul(unit)).flatten();
    number.ok_or_else(|| LinkParseError::Rate(typed.to_owned()))
}

fn in_range(
    what: &'static str,
    given: u32,
    range: &std::ops::RangeInclusive<u32>,
) -> Result<u32, LinkParseError> {
    if range.contains(&given) {
        return Ok(given);
    }
    Err(LinkParseError::Range { what, given, least: *range.start(), most: *range.end() })
}

/// The shortest way to type a rate.
struct Rate(u32);

impl fmt::Display for Rate {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.0 {
            0 => f.write_str("0"),
            bit_s if bit_s.is_multiple_of(1_000_000) => write!(f, "{}M", bit_s / 1_000_000),
            bit_s if bit_s.is_multiple_of(1_000) => write!(f, "{}k", bit_s / 1_000),
            bit_s => write!(f, "{bit_s}"),
        }
    }
}

impl fmt::Display for Link {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Sim => f.write_str("sim"),
            Self::Pty => f.write_str("pty"),
            Self::Can { interface, bit_s: None } => write!(f, "can:{interface}"),
            Self::Can { interface, bit_s: Some(bit_s) } => write!(f, "can:{interface}@{}", Rate(*bit_s)),
            Self::CanFd { interface, bit_s: None } => write!(f, "canfd:{interface}"),
            Self::CanFd { interface, bit_s: Some((nominal, data)) } => {
                write!(f, "canfd:{interface}@{}/{}", Rate(*nominal), Rate(*data))
            }
            Self::Serial { device, baud } => write!(f, "serial:{}@{baud}", device.display()),
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn can(interface: &str, bit_s: Option<u32>) -> Link {
        Link::Can { interface: interface.to_owned(), bit_s }
    }

    fn canfd(interface: &str, bit_s: Option<(u32, u32)>) -> Link {
        Link::CanFd { interface: interface.to_owned(), bit_s }
    }

    fn serial(device: &str, baud: u32) -> Link {
        Link::Serial { device: device.into(), baud }
    }

    #[test]
    fn every_kind_of_wire_is_read_and_written() {
        let by_id = "/dev/serial/by-id/usb-a@b:c-if00";
        for (typed, link, written) in [
            ("sim", Link::Sim, "sim"),
            ("pty", Link::Pty, "pty"),
            ("can:can0", can("can0", None), "can:can0"),
            ("can:vcan0@500000", can("vcan0", Some(500_000)), "can:vcan0@500k"),
            ("can:can0@83333", can("can0", Some(83_333)), "can:can0@83333"),
            ("can:can0@1M", can("can0", Some(1_000_000)), "can:can0@1M"),
            ("canfd:can0", canfd("can0", None), "canfd:can0"),
            ("canfd:can0@500k/2M", canfd("can0", Some((500_000, 2_000_000))), "canfd:can0@500k/2M"),
            ("serial:/dev/ttyUSB0", serial("/dev/ttyUSB0", 921_600), "serial:/dev/ttyUSB0@921600"),
            ("serial:/dev/ttyS0@3M", serial("/dev/ttyS0", 3_000_000), "serial:/dev/ttyS0@3000000"),
            (&format!("serial:{by_id}"), serial(by_id, DEFAULT_BAUD), &format!("serial:{by_id}@921600")),
        ] {
            assert_eq!(typed.parse::<Link>().as_ref(), Ok(&link), "{typed}");
            assert_eq!(link.to_string(), written);
            assert_eq!(written.parse::<Link>(), Ok(link), "{written}");
        }
    }

    #[test]
    fn what_is_wrong_is_said_with_what_would_be_right() {
        for (typed, words) in [
            ("", "sim, can:IFACE"),
            ("Sim", "\"Sim\" is no wire"),
            ("vcan0", "can:IFACE[@BITRATE]"),
            ("pty:x", "is no wire"),
            ("can:", "1 to 15 characters"),
            ("can:can 0", "without space"),
            ("can:a/b", "slash"),
            ("can:abcdefghijklmnop", "abcdefghijklmnop"),
            ("can:can0@", "\"\" is no rate"),
            ("can:can0@fast", "500k or 1M"),
            ("can:can0@5kk", "\"5kk\" is no rate"),
            ("can:can0@-1", "no rate"),
            ("can:can0@9999999M", "no rate"),
            ("can:can0@2M", "between 10000 and 1000000"),
            ("canfd:can0@1M", "as in canfd:can0@1M/5M"),
            ("canfd:can0@1M/500k", "at least as high"),
            ("canfd:can0@1M/9M", "a data rate of 9000000 bit/s"),
            ("serial:", "needs its device"),
            ("serial:@9600", "needs its device"),
            ("serial:/dev/ttyS0@300", "between 9600"),
            ("serial:/dev/ttyS0@9600x", "no rate"),
        ] {
            let error = typed.parse::<Link>().unwrap_err().to_string();
            assert!(error.contains(words), "{typed}: {error}");
            assert!(!error.contains('\n') && !error.ends_with('.'), "{error}");
        }
    }

    proptest! {
        #[test]
        fn anything_typed_is_a_link_or_an_error(typed in "(can:|canfd:|serial:|)\\PC{0,20}") {
            if let Ok(link) = typed.parse::<Link>() {
                prop_assert_eq!(link.to_string().parse::<Link>(), Ok(link));
            }
        }
    }
}
