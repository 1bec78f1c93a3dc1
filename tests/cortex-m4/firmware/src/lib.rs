//! What the two programs share: the plan in flash, the clock, the serial line, the stack's high-water mark and the
//! report over semihosting.
//!
//! | program   | the arm                                   | time                                               |
//! |-----------|-------------------------------------------|----------------------------------------------------|
//! | `figures` | an echo in the same program               | a number; the clock counts instructions (`-icount`) |
//! | `stream`  | simulated, at the other end of the UART   | `SysTick`                                          |
#![no_std]

use core::panic::PanicInfo;

pub mod clock;
pub mod report;
pub mod stack;
pub mod uart;

/// The plan, where a microcontroller has it: in flash.
pub static PLAN: &[u8] = include_bytes!(concat!(env!("OUT_DIR"), "/plan"));

/// The number of the session; any but 0.
pub const SESSION: u16 = 7;

#[cfg(feature = "prove-no-panic")]
#[panic_handler]
fn panic(_: &PanicInfo<'_>) -> ! {
    unsafe extern "C" {
        /// Nowhere defined: what refers to it does not link.
        safe fn a_panic_can_be_reached() -> !;
    }
    a_panic_can_be_reached()
}

#[cfg(not(feature = "prove-no-panic"))]
#[panic_handler]
fn panic(_: &PanicInfo<'_>) -> ! {
    report::fail("panic")
}

/// With `plant-panic`: an index that no optimiser can vouch for.
pub fn planted_panic() {
    #[cfg(feature = "plant-panic")]
    {
        let index = core::hint::black_box(PLAN.len());
        core::hint::black_box(PLAN[index]);
    }
}
