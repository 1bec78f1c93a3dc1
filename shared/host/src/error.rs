//! Why a wire cannot be used.

use std::io;
use std::path::PathBuf;

use thiserror::Error;

/// Why a wire cannot be used: one sentence that says what would be right.
#[derive(Debug, Error)]
pub enum LinkError {
    /// The kernel was built without CAN, or its module is missing.
    #[error(
        "this kernel has no CAN: load its modules by `modprobe can_raw`, or use a serial line, a pty or the arm in the same \
         process"
    )]
    NoCan,
    /// No such interface.
    #[error("there is no interface {interface}: `ip link` lists those there are")]
    NoInterface {
        /// As typed.
        interface: String,
    },
    /// An interface of another kind.
    #[error(
        "{interface} is no CAN interface: `ip link show type can` and `ip link show type vcan` list those"
    )]
    NotCan {
        /// As typed.
        interface: String,
    },
    /// An interface without CAN FD.
    #[error(
        "{interface} carries classic frames only: write can:{interface}, or switch CAN FD on (`ip link set {interface} type \
         can fd on`, for a vcan `ip link set {interface} mtu 72`)"
    )]
    NotFd {
        /// As typed.
        interface: String,
    },
    /// An interface that is down.
    #[error("{interface} is down: it comes up by `ip link set {interface} up`")]
    Down {
        /// As typed.
        interface: String,
    },
    /// A controller that has left the bus.
    #[error(
        "{interface} has left the bus after too many errors (bus-off): check wiring, termination and bit rate, then restart \
         it by `ip link set {interface} type can restart` or by taking it down and up"
    )]
    BusOff {
        /// As typed.
        interface: String,
    },
    /// Interface or device was there and is no more.
    #[error("{link} is gone: it was unplugged or removed while it was in use")]
    Gone {
        /// Interface or device.
        link: String,
    },
    /// Typed and true rates differ.
    #[error(
        "{interface} runs at {kernel} bit/s, not at the {typed} bit/s that were asked for: change one of the two"
    )]
    OtherRate {
        /// As typed.
        interface: String,
        /// As typed, bits per second.
        typed: u32,
        /// As the system has it, bits per second.
        kernel: u32,
    },
    /// No such device.
    #[error("there is no device {}: a serial line is something like /dev/ttyUSB0", device.display())]
    NoDevice {
        /// As typed.
        device: PathBuf,
    },
    /// A device that may not be opened.
    #[error("{} may not be opened by this user: join the group that owns it, usually dialout", device.display())]
    Permission {
        /// As typed.
        device: PathBuf,
    },
    /// A device that another program has.
    #[error("{} is in use by another program: end that one first", device.display())]
    InUse {
        /// As typed.
        device: PathBuf,
    },
    /// A file that is no serial line.
    #[error("{} is no serial line: it is a file of another kind", device.display())]
    NotSerial {
        /// As typed.
        device: PathBuf,
    },
    /// A rate that the device does not have.
    #[error("{} does not run at {typed} baud, it would fall back to {offered}: choose a rate that it has", device.display())]
    Baud {
        /// As typed.
        device: PathBuf,
        /// As typed, baud.
        typed: u32,
        /// What the device would take instead, baud.
        offered: u32,
    },
    /// A frame that this wire never carries.
    #[error("{link} carries no frame with identifier {id:#05X} and {length} bytes of data")]
    Unsendable {
        /// Interface or device.
        link: String,
        /// Identifier.
        id: u16,
        /// Data, bytes.
        length: usize,
    },
    /// Anything else, in the system's words.
    #[error("{link} cannot be used: {error}")]
    System {
        /// Interface or device.
        link: String,
        /// In the system's words.
        error: io::Error,
    },
}

impl LinkError {
    pub(crate) fn system(link: impl Into<String>, error: impl Into<io::Error>) -> Self {
        Self::System { link: link.into(), error: error.into() }
    }
}
