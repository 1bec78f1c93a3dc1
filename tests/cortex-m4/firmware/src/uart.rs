//! UART 0 of the board, a CMSDK APB UART ("Cortex-M System Design Kit", ARM DDI 0479, chapter 4.3), polled.

use core::ptr;

const BASE: usize = 0x4000_4000;

// Registers, by their distance from the base, in bytes.
const DATA: usize = 0x00;
const STATE: usize = 0x04;
const CTRL: usize = 0x08;
const BAUDDIV: usize = 0x10;

const STATE_TX_FULL: u32 = 1 << 0;
const STATE_RX_FULL: u32 = 1 << 1;
const CTRL_TX_ENABLE: u32 = 1 << 0;
const CTRL_RX_ENABLE: u32 = 1 << 1;

/// 25 MHz by 27: 925,926 bit/s, within 0.5 % of the 921,600 that design and PC know.
const DIVIDER: u32 = 27;

/// The serial line.
pub struct Uart(());

impl Uart {
    /// Switches both directions on, without interrupts.
    ///
    /// # Safety
    /// There must be no other, since two would take bytes from each other.
    pub unsafe fn new() -> Self {
        write(BAUDDIV, DIVIDER);
        write(CTRL, CTRL_TX_ENABLE | CTRL_RX_ENABLE);
        Self(())
    }

    /// The byte that has arrived.
    pub fn receive(&mut self) -> Option<u8> {
        if read(STATE) & STATE_RX_FULL == 0 {
            return None;
        }
        Some(read(DATA) as u8)
    }

    /// Waits until there is room, then sends.
    pub fn send(&mut self, bytes: &[u8]) {
        for byte in bytes {
            while read(STATE) & STATE_TX_FULL != 0 {}
            write(DATA, u32::from(*byte));
        }
    }
}

fn read(register: usize) -> u32 {
    // SAFETY: a register of the UART, aligned; reading one has no effect beyond the UART.
    unsafe { ptr::read_volatile(ptr::with_exposed_provenance(BASE + register)) }
}

fn write(register: usize, value: u32) {
    // SAFETY: a register of the UART, aligned; it has no access to memory.
    unsafe { ptr::write_volatile(ptr::with_exposed_provenance_mut(BASE + register), value) }
}
