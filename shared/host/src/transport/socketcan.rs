//! SocketCAN, classic and FD.

use std::io;
use std::os::fd::{AsFd, BorrowedFd};

use heapless::Vec;
use libc::{CAN_EFF_FLAG, CAN_RTR_FLAG};
use powderline_shared::wire::frame::{Dialect, Frame, MAX_DATA};
use rustix::net::sockopt;
use socketcan::errors::ControllerProblems;

use socketcan::id::{CAN_ERR_MASK, FdFlags};
use socketcan::{
    CanAddr, CanAnyFrame, CanDataFrame, CanErrorFrame, CanFdFrame, CanFdSocket, CanFrame, CanSocket,
    CanTimestamps, EmbeddedFrame, ErrorCause, Id, IoResult, Socket, SocketOptions, StandardId,
};

use super::{BusEvent, Incoming, LinkError, Received, Sent, Transport};
use crate::clock;
use crate::interface::Interface;
use crate::wait::Interest;

/// Receive buffer asked for, bytes. A vcan drops without a word when it is full; this holds some 4,000 frames.
const RECEIVE_BUFFER: usize = 4 << 20;
/// Foreign frames skipped by one call: a node that babbles must not hold up the control cycle.
const MAX_SKIPPED: usize = 64;

/// A raw CAN socket on one interface.
///
/// Extended and remote frames are kept out by the kernel's filter. Frames sent here are not received here, but other
/// programs on this machine see them (the socket's loopback stays on: on a vcan nobody would get anything without it).
#[derive(Debug)]
pub struct SocketCan {
    interface: String,
    /// The controller has said that it is off the bus, and not yet that it is back. The kernel would go on taking frames
    /// into its queue, to send them when they are long out of date.
    off_bus: bool,
    socket: Kind,
}

#[derive(Debug)]
enum Kind {
    Classic(CanSocket),
    Fd(CanFdSocket),
}

impl SocketCan {
    /// Opens an interface. An FD socket receives classic frames too, whatever sent them.
    ///
    /// # Errors
    /// If there is no CAN, no such interface, or it is down or without FD.
    pub fn open(interface: &str, dialect: Dialect) -> Result<Self, LinkError> {
        let address = CanAddr::new(Self::checked(interface, dialect)?);
        let socket = match dialect {
            Dialect::Classic => CanSocket::open_addr(&address).map(Kind::Classic),
            Dialect::Fd => CanFdSocket::open_addr(&address).map(Kind::Fd),
        };
        let can = Self {
            socket: socket.map_err(|error| failure(interface, error))?,
            interface: interface.to_owned(),
            off_bus: false,
        };
        can.set_up().map_err(|error| failure(interface, error))?;
        Ok(can)
    }

    /// The index of an interface that can be used.
    fn checked(interface: &str, dialect: Dialect) -> Result<u32, LinkError> {
        // Without CAN in the kernel there is no interface either; which of the two is missing must not be guessed.
        CanSocket::open_iface(0).map_err(|error| failure(interface, error))?;
        let found = Interface::query(interface)?;
        let name = || interface.to_owned();
        if !found.is_can {
            return Err(LinkError::NotCan { interface: name() });
        }
        if !found.is_up {
            return Err(LinkError::Down { interface: name() });
        }
        if found.is_off_bus {
            return Err(LinkError::BusOff { interface: name() });
        }
        if dialect == Dialect::Fd && !found.carries_fd() {
            return Err(LinkError::NotFd { interface: name() });
        }
        Ok(found.index)
    }

    fn set_up(&self) -> io::Result<()> {
        match &self.socket {
            Kind::Classic(socket) => set_options(socket),
            Kind::Fd(socket) => set_options(socket),
        }?;
        // More than the system's limit takes a privilege; what is granted without it will do on a real bus.
        if sockopt::set_socket_recv_buffer_size_force(self.fd(), RECEIVE_BUFFER).is_err() {
            sockopt::set_socket_recv_buffer_size(self.fd(), RECEIVE_BUFFER)?;
        }
        Ok(())
    }

    fn fd(&self) -> BorrowedFd<'_> {
        match &self.socket {
            Kind::Classic(socket) => socket.as_fd(),
            Kind::Fd(socket) => socket.as_fd(),
        }
    }

    fn read(&self) -> IoResult<(CanAnyFrame, CanTimestamps)> {
        match &self.socket {
            Kind::Classic(socket) => {
                socket.read_frame_with_timestamps().map(|(frame, stamps)| (any(frame), stamps))
            }
            Kind::Fd(socket) => socket.read_frame_with_timestamps(),
        }
    }

    fn note(&mut self, what: &Incoming) {
        match what {
            Incoming::Event(BusEvent::BusOff) => self.off_bus = true,
            Incoming::Event(BusEvent::Restarted | BusEvent::ErrorActive) => self.off_bus = false,
            _ => {}
        }
    }

    /// Writes a frame; `None` if this wire never carries it.
    fn write(&self, frame: &Frame) -> Option<IoResult<()>> {
        let id = StandardId::new(frame.id)?;
        match &self.socket {
            Kind::Classic(socket) => {
                let frame = CanDataFrame::new(id, &frame.data)?;
                Some(socket.write_frame(&CanFrame::Data(frame)))
            }
            Kind::Fd(socket) => {
                // The crate would lengthen the frame; the receiver must get the length that was sent.
                CanFdFrame::is_valid_data_len(frame.data.len()).then_some(())?;
                let frame = CanFdFrame::with_flags(id, &frame.data, FdFlags::BRS)?;
                Some(socket.write_frame(&CanAnyFrame::Fd(frame)))
            }
        }
    }
}

fn set_options(socket: &impl SocketOptionsOf) -> io::Result<()> {
    socket.set_filters(&[(0, CAN_EFF_FLAG | CAN_RTR_FLAG)])?;
    socket.set_error_filter(CAN_ERR_MASK)?;
    socket.set_recv_own_msgs(false)?;
    socket.set_recv_timestamp(true)?;
    socket.set_nonblocking(true)
}

/// Both kinds of socket.
trait SocketOptionsOf: Socket + SocketOptions {}
impl<S: Socket + SocketOptions> SocketOptionsOf for S {}

fn any(frame: CanFrame) -> CanAnyFrame {
    match frame {
        CanFrame::Data(frame) => frame.into(),
        CanFrame::Remote(frame) => frame.into(),
        CanFrame::Error(frame) => frame.into(),
    }
}

/// `None` for frames that are not Powderline's kind.
fn incoming(frame: CanAnyFrame) -> Option<Incoming> {
    match frame {
        CanAnyFrame::Normal(frame) => data_frame(frame.id(), frame.data()),
        CanAnyFrame::Fd(frame) => data_frame(frame.id(), frame.data()),
        CanAnyFrame::Error(frame) => Some(Incoming::Event(gravest(frame))),
        CanAnyFrame::Remote(_) => None,
    }
}

fn data_frame(id: Id, data: &[u8]) -> Option<Incoming> {
    let Id::Standard(id) = id else { return None };
    let data: Vec<u8, MAX_DATA> = Vec::from_slice(data).ok()?;
    Some(Incoming::Frame(Frame { id: id.as_raw(), data }))
}

fn gravest(frame: CanErrorFrame) -> BusEvent {
    frame.into_error().into_iter().map(event).min().unwrap_or(BusEvent::BusError)
}

fn event(cause: ErrorCause) -> BusEvent {
    match cause {
        ErrorCause::BusOff => BusEvent::BusOff,
        ErrorCause::Restarted => BusEvent::Restarted,
        ErrorCause::NoAck => BusEvent::NoAck,
        ErrorCause::Controller(problems) => controller_event(problems),
        _ => BusEvent::BusError,
    }
}

fn controller_event(problems: ControllerProblems) -> BusEvent {
    use ControllerProblems as P;
    for (flags, event) in [
        (P::RX_OVERFLOW | P::TX_OVERFLOW, BusEvent::Overflow),
        (P::RX_PASSIVE | P::TX_PASSIVE, BusEvent::ErrorPassive),
        (P::RX_WARNING | P::TX_WARNING, BusEvent::Warning),
        (P::ACTIVE, BusEvent::ErrorActive),
    ] {
        if problems.intersects(flags) {
            return event;
        }
    }
    BusEvent::BusError
}

fn failure(interface: &str, error: io::Error) -> LinkError {
    let name = interface.to_owned();
    match error.raw_os_error() {
        Some(libc::EAFNOSUPPORT | libc::EPROTONOSUPPORT | libc::ESOCKTNOSUPPORT) => LinkError::NoCan,
        Some(libc::ENETDOWN) => LinkError::Down { interface: name },
        Some(libc::ENODEV | libc::ENXIO) => LinkError::Gone { link: name },
        _ => LinkError::system(name, error),
    }
}

impl Transport for SocketCan {
    fn dialect(&self) -> Dialect {
        match self.socket {
            Kind::Classic(_) => Dialect::Classic,
            Kind::Fd(_) => Dialect::Fd,
        }
    }

    fn send(&mut self, frame: &Frame) -> Result<Sent, LinkError> {
        if self.off_bus {
            return Err(LinkError::BusOff { interface: self.interface.clone() });
        }
        let unsendable =
            || LinkError::Unsendable { link: self.interface.clone(), id: frame.id, length: frame.data.len() };
        match self.write(frame).ok_or_else(unsendable)? {
            Ok(()) => Ok(Sent::Done),
            Err(error) if matches!(error.raw_os_error(), Some(libc::ENOBUFS | libc::EAGAIN)) => {
                Ok(Sent::Busy)
            }
            // The interface has lost its CAN FD since it was opened.
            Err(error)
                if self.dialect() == Dialect::Fd
                    && matches!(error.raw_os_error(), Some(libc::EINVAL | libc::EMSGSIZE)) =>
            {
                Err(LinkError::NotFd { interface: self.interface.clone() })
            }
            Err(error) => Err(failure(&self.interface, error)),
        }
    }

    fn receive(&mut self) -> Result<Option<Received>, LinkError> {
        for _ in 0..MAX_SKIPPED {
            match self.read() {
                Ok((frame, stamps)) => {
                    if let Some(what) = incoming(frame) {
                        self.note(&what);
                        let at_us = stamps.socket.map_or_else(clock::now_us, clock::monotonic_us_of);
                        return Ok(Some(Received { at_us, what }));
                    }
                }
                Err(error) => match error.kind() {
                    io::ErrorKind::WouldBlock => return Ok(None),
                    io::ErrorKind::Interrupted => {}
                    _ => {
                        // An interface that was down comes up with a restarted controller.
                        self.off_bus = false;
                        return Err(failure(&self.interface, error));
                    }
                },
            }
        }
        Ok(None)
    }

    fn interest(&self) -> Option<Interest<'_>> {
        Some(Interest { fd: self.fd(), writable: false })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn error_frame(class: u32, data: &[u8; 8]) -> BusEvent {
        gravest(CanErrorFrame::new_error(class, data).unwrap())
    }

    #[test]
    fn error_frames_become_the_gravest_event_in_them() {
        let controller = |bits| [0, bits, 0, 0, 0, 0, 0, 0];
        for (class, data, event) in [
            (libc::CAN_ERR_BUSOFF, [0; 8], BusEvent::BusOff),
            (libc::CAN_ERR_RESTARTED, [0; 8], BusEvent::Restarted),
            (libc::CAN_ERR_ACK, [0; 8], BusEvent::NoAck),
            (libc::CAN_ERR_CRTL, controller(0x01), BusEvent::Overflow),
            (libc::CAN_ERR_CRTL, controller(0x10), BusEvent::ErrorPassive),
            (libc::CAN_ERR_CRTL, controller(0x20 | 0x08), BusEvent::ErrorPassive),
            (libc::CAN_ERR_CRTL, controller(0x04), BusEvent::Warning),
            (libc::CAN_ERR_CRTL, controller(0x40), BusEvent::ErrorActive),
            (libc::CAN_ERR_ACK | libc::CAN_ERR_BUSERROR, [0; 8], BusEvent::NoAck),
            (libc::CAN_ERR_BUSOFF | libc::CAN_ERR_CRTL, controller(0x20), BusEvent::BusOff),
            (libc::CAN_ERR_PROT, [0; 8], BusEvent::BusError),
        ] {
            assert_eq!(error_frame(class, &data), event, "{class:#x} {data:?}");
        }
    }

    #[test]
    fn only_leaving_the_bus_and_restarting_end_a_session() {
        assert!(BusEvent::BusOff.ends_session() && BusEvent::Restarted.ends_session());
        assert!(!BusEvent::ErrorPassive.ends_session() && !BusEvent::NoAck.ends_session());
    }
}
