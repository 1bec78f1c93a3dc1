//! One round of a loop over each adapter, on devices that nobody has plugged in.

use core::convert::Infallible;

use embedded_can::Id;
use embedded_io::{ErrorType, Read, ReadReady, Write, WriteReady};
use powderline_executor::Endpoint;
use powderline_executor::adapters::Turn;
use powderline_executor::adapters::can::CanWire;
use powderline_executor::adapters::serial::SerialWire;

/// A frame of the CAN controller.
pub struct CanFrame {
    id: Id,
    data: [u8; 8],
    length: usize,
}

impl embedded_can::Frame for CanFrame {
    fn new(id: impl Into<Id>, data: &[u8]) -> Option<Self> {
        let mut frame = Self { id: id.into(), data: [0; 8], length: data.len() };
        frame.data.get_mut(..data.len())?.iter_mut().zip(data).for_each(|(place, byte)| *place = *byte);
        Some(frame)
    }

    fn new_remote(_: impl Into<Id>, _: usize) -> Option<Self> {
        None
    }

    fn is_extended(&self) -> bool {
        matches!(self.id, Id::Extended(_))
    }

    fn is_remote_frame(&self) -> bool {
        false
    }

    fn id(&self) -> Id {
        self.id
    }

    fn dlc(&self) -> usize {
        self.length
    }

    fn data(&self) -> &[u8] {
        self.data.get(..self.length).unwrap_or_default()
    }
}

/// A CAN controller without room, and without anything to hear.
pub struct Controller;

impl embedded_can::nb::Can for Controller {
    type Frame = CanFrame;
    type Error = Infallible;

    fn transmit(&mut self, _: &CanFrame) -> nb::Result<Option<CanFrame>, Infallible> {
        Err(nb::Error::WouldBlock)
    }

    fn receive(&mut self) -> nb::Result<CanFrame, Infallible> {
        Err(nb::Error::WouldBlock)
    }
}

/// A UART that sends all that it is given, and hears nothing.
pub struct Uart;

impl ErrorType for Uart {
    type Error = Infallible;
}

impl ReadReady for Uart {
    fn read_ready(&mut self) -> Result<bool, Infallible> {
        Ok(false)
    }
}

impl Read for Uart {
    fn read(&mut self, _: &mut [u8]) -> Result<usize, Infallible> {
        Ok(0)
    }
}

impl WriteReady for Uart {
    fn write_ready(&mut self) -> Result<bool, Infallible> {
        Ok(true)
    }
}

impl Write for Uart {
    fn write(&mut self, bytes: &[u8]) -> Result<usize, Infallible> {
        Ok(bytes.len())
    }

    fn flush(&mut self) -> Result<(), Infallible> {
        Ok(())
    }
}

/// One turn of the loop over CAN.
pub fn can_turn(wire: &mut CanWire<Controller>, now_us: u64, endpoint: &mut Endpoint<'_>) -> Turn {
    wire.turn(|| now_us, endpoint)
}

/// One turn of the loop over a serial line.
pub fn serial_turn(wire: &mut SerialWire<Uart>, now_us: u64, endpoint: &mut Endpoint<'_>) -> Turn {
    wire.turn(|| now_us, endpoint)
}
