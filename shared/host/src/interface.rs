//! What the kernel says of a network interface: whether it is CAN, up, has CAN FD, and its bit rates.
//!
//! One rtnetlink question and its answer, by hand: struct layouts and numbers are those of `linux/netlink.h`,
//! `linux/rtnetlink.h`, `linux/if_link.h` and `linux/can/netlink.h`; all values have the host's byte order.

use std::io;

use rustix::net::{AddressFamily, RecvFlags, SendFlags, SocketFlags, SocketType, recv, send, socket_with};

use crate::error::LinkError;

const RTM_NEWLINK: u16 = 16;
const RTM_GETLINK: u16 = 18;
const NLMSG_ERROR: u16 = 2;
const NLM_F_REQUEST: u16 = 1;
const IFLA_IFNAME: u16 = 3;
const IFLA_MTU: u16 = 4;
const IFLA_LINKINFO: u16 = 18;
const IFLA_INFO_DATA: u16 = 2;
const IFLA_CAN_BITTIMING: u16 = 1;
const IFLA_CAN_STATE: u16 = 4;
const IFLA_CAN_DATA_BITTIMING: u16 = 9;
/// Flags in an attribute's type: nested, byte order.
const TYPE_MASK: u16 = 0x3FFF;
const ARPHRD_CAN: u16 = 280;
const IFF_UP: u32 = 1;
const CAN_STATE_BUS_OFF: u32 = 3;
/// `sizeof(struct canfd_frame)`: the MTU of an interface that carries CAN FD.
const CANFD_MTU: u32 = 72;
/// `sizeof(struct nlmsghdr)` and `sizeof(struct ifinfomsg)`, bytes.
const HEADER: usize = 16;

/// A network interface.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Interface {
    /// Its number.
    pub index: u32,
    /// Whether it carries CAN frames.
    pub is_can: bool,
    /// Whether it is up.
    pub is_up: bool,
    /// Whether its controller has left the bus.
    pub is_off_bus: bool,
    /// Largest frame that it carries, bytes of the kernel's struct.
    pub mtu: u32,
    /// Rate of classic CAN, or of the arbitration phase, bits per second; a vcan has none.
    pub nominal_bit_s: Option<u32>,
    /// Rate of the data phase of CAN FD, bits per second.
    pub data_bit_s: Option<u32>,
}

impl Interface {
    /// Asks the kernel.
    ///
    /// # Errors
    /// If there is no such interface.
    pub fn query(name: &str) -> Result<Self, LinkError> {
        let system = |error: io::Error| match error.raw_os_error() {
            Some(libc::ENODEV | libc::EINVAL | libc::ERANGE) => {
                LinkError::NoInterface { interface: name.to_owned() }
            }
            _ => LinkError::system(name, error),
        };
        let answer = ask(name).map_err(system)?;
        parse(&answer).map_err(system)
    }

    /// Whether it carries CAN FD.
    #[must_use]
    pub const fn carries_fd(&self) -> bool {
        self.mtu >= CANFD_MTU
    }

    /// Holds typed rates, bits per second, against those of the interface; gives the true ones, as far as they are known.
    ///
    /// # Errors
    /// If the two differ.
    pub fn agree(
        &self,
        name: &str,
        typed_nominal: Option<u32>,
        typed_data: Option<u32>,
    ) -> Result<(Option<u32>, Option<u32>), LinkError> {
        let nominal = agreed(name, typed_nominal, self.nominal_bit_s)?;
        Ok((nominal, agreed(name, typed_data, self.data_bit_s)?))
    }
}

fn agreed(name: &str, typed: Option<u32>, kernel: Option<u32>) -> Result<Option<u32>, LinkError> {
    match (typed, kernel) {
        (Some(typed), Some(kernel)) if typed != kernel => {
            Err(LinkError::OtherRate { interface: name.to_owned(), typed, kernel })
        }
        _ => Ok(kernel.or(typed)),
    }
}

fn ask(name: &str) -> io::Result<Vec<u8>> {
    let socket = socket_with(AddressFamily::NETLINK, SocketType::RAW, SocketFlags::CLOEXEC, None)?;
    // A netlink socket that is bound to nobody speaks to the kernel, which answers within the call.
    send(&socket, &question(name), SendFlags::empty())?;
    let mut answer = vec![0; 32 * 1024];
    let (_, length) = recv(&socket, answer.as_mut_slice(), RecvFlags::TRUNC)?;
    if length > answer.len() {
        return Err(io::ErrorKind::InvalidData.into());
    }
    answer.truncate(length);
    Ok(answer)
}

fn question(name: &str) -> Vec<u8> {
    let attribute = attribute(IFLA_IFNAME, &[name.as_bytes(), &[0]].concat());
    let length = (2_usize.saturating_mul(HEADER)).saturating_add(attribute.len());
    let length = u32::try_from(length).unwrap_or(u32::MAX);
    let mut message = Vec::new();
    message.extend(length.to_ne_bytes());
    message.extend(RTM_GETLINK.to_ne_bytes());
    message.extend(NLM_F_REQUEST.to_ne_bytes());
    message.extend([0; 8]); // sequence and port: one question, one answer
    message.extend([0; HEADER]); // ifinfomsg: nothing but the name is known
    message.extend(attribute);
    message
}

/// Length, type, value, and zeros up to a multiple of four bytes.
fn attribute(kind: u16, value: &[u8]) -> Vec<u8> {
    let length = u16::try_from(value.len().saturating_add(4)).unwrap_or(u16::MAX);
    let mut bytes = [length.to_ne_bytes(), kind.to_ne_bytes()].concat();
    bytes.extend(value);
    bytes.resize(bytes.len().next_multiple_of(4), 0);
    bytes
}

fn parse(answer: &[u8]) -> io::Result<Interface> {
    let unknown = || io::Error::from(io::ErrorKind::InvalidData);
    let kind = u16_at(answer, 4).ok_or_else(unknown)?;
    let body = answer.get(HEADER..).ok_or_else(unknown)?;
    if kind == NLMSG_ERROR {
        let error = u32_at(body, 0).ok_or_else(unknown)?;
        return Err(io::Error::from_raw_os_error(error.cast_signed().wrapping_neg()));
    }
    if kind != RTM_NEWLINK {
        return Err(unknown());
    }
    link(body).ok_or_else(unknown)
}

/// Reads `ifinfomsg` and what follows.
fn link(body: &[u8]) -> Option<Interface> {
    let attributes = body.get(HEADER..)?;
    let can = find(attributes, IFLA_LINKINFO).and_then(|info| find(info, IFLA_INFO_DATA));
    // The rate is the first member of struct can_bittiming; 0 is none.
    let rate = |kind| can.and_then(|can| u32_at(find(can, kind)?, 0)).filter(|bit_s| *bit_s != 0);
    let state = can.and_then(|can| u32_at(find(can, IFLA_CAN_STATE)?, 0));
    Some(Interface {
        index: u32_at(body, 4)?,
        is_can: u16_at(body, 2)? == ARPHRD_CAN,
        is_up: u32_at(body, 8)? & IFF_UP != 0,
        is_off_bus: state == Some(CAN_STATE_BUS_OFF),
        mtu: u32_at(find(attributes, IFLA_MTU)?, 0)?,
        nominal_bit_s: rate(IFLA_CAN_BITTIMING),
        data_bit_s: rate(IFLA_CAN_DATA_BITTIMING),
    })
}

/// The value of the first attribute of a kind.
fn find(mut attributes: &[u8], kind: u16) -> Option<&[u8]> {
    loop {
        let length = usize::from(u16_at(attributes, 0)?);
        let value = attributes.get(4..length)?;
        if u16_at(attributes, 2)? & TYPE_MASK == kind {
            return Some(value);
        }
        attributes = attributes.get(length.next_multiple_of(4)..)?;
    }
}

fn u16_at(bytes: &[u8], at: usize) -> Option<u16> {
    Some(u16::from_ne_bytes(*bytes.get(at..)?.first_chunk()?))
}

fn u32_at(bytes: &[u8], at: usize) -> Option<u32> {
    Some(u32::from_ne_bytes(*bytes.get(at..)?.first_chunk()?))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// The answer about an interface, as the kernel writes it.
    fn answer(kind: u16, flags: u32, attributes: &[Vec<u8>]) -> Vec<u8> {
        let mut body = vec![0, 0];
        body.extend(kind.to_ne_bytes());
        body.extend(7_u32.to_ne_bytes());
        body.extend(flags.to_ne_bytes());
        body.extend([0; 4]);
        body.extend(attributes.concat());
        let length = u32::try_from(HEADER + body.len()).unwrap();
        let mut message = length.to_ne_bytes().to_vec();
        message.extend(RTM_NEWLINK.to_ne_bytes());
        message.extend([0; 10]);
        message.extend(body);
        message
    }

    fn rate(kind: u16, bit_s: u32) -> Vec<u8> {
        attribute(kind, &[bit_s.to_ne_bytes(), [9; 4]].concat())
    }

    fn can_info(rates: &[Vec<u8>]) -> Vec<u8> {
        let data = attribute(IFLA_INFO_DATA | 0x8000, &rates.concat());
        attribute(IFLA_LINKINFO, &[attribute(1, b"can\0"), data].concat())
    }

    #[test]
    fn rates_and_state_are_read() {
        let mtu = attribute(IFLA_MTU, &72_u32.to_ne_bytes());
        let name = attribute(IFLA_IFNAME, b"can0\0");
        let info = can_info(&[rate(IFLA_CAN_BITTIMING, 500_000), rate(IFLA_CAN_DATA_BITTIMING, 2_000_000)]);
        let found = parse(&answer(ARPHRD_CAN, IFF_UP, &[name.clone(), mtu.clone(), info])).unwrap();
        assert_eq!((found.index, found.is_can, found.is_up, found.carries_fd()), (7, true, true, true));
        assert_eq!((found.nominal_bit_s, found.data_bit_s), (Some(500_000), Some(2_000_000)));
        let unset = can_info(&[rate(IFLA_CAN_BITTIMING, 0)]);
        let found = parse(&answer(1, 0, &[name, mtu, unset])).unwrap();
        assert_eq!(
            (found.is_can, found.is_up, found.nominal_bit_s, found.data_bit_s),
            (false, false, None, None)
        );
    }

    #[test]
    fn the_loopback_interface_is_there_and_is_no_can() {
        let found = Interface::query("lo").unwrap();
        assert_eq!(found.index, 1);
        assert!(!found.is_can && found.nominal_bit_s.is_none());
    }

    #[test]
    fn an_interface_that_is_not_there_is_named() {
        for name in ["nocan7", "a-name-that-is-far-too-long-for-an-interface"] {
            let error = Interface::query(name).unwrap_err();
            assert!(matches!(error, LinkError::NoInterface { .. }), "{error}");
            assert!(error.to_string().contains(name));
        }
    }

    #[test]
    fn typed_rates_are_held_against_the_true_ones() {
        let found = parse(&answer(
            ARPHRD_CAN,
            IFF_UP,
            &[attribute(IFLA_MTU, &16_u32.to_ne_bytes()), can_info(&[rate(IFLA_CAN_BITTIMING, 250_000)])],
        ))
        .unwrap();
        assert_eq!(found.agree("can0", None, None).unwrap(), (Some(250_000), None));
        assert_eq!(found.agree("can0", Some(250_000), Some(5)).unwrap(), (Some(250_000), Some(5)));
        let error = found.agree("can0", Some(500_000), None).unwrap_err().to_string();
        assert!(error.contains("runs at 250000 bit/s, not at the 500000 bit/s"), "{error}");
    }

    proptest! {
        #[test]
        fn no_answer_is_too_odd(bytes in prop::collection::vec(any::<u8>(), 0..200)) {
            let _ = parse(&bytes);
            let whole = [answer(ARPHRD_CAN, IFF_UP, &[]), bytes].concat();
            let _ = parse(&whole);
        }
    }
}
