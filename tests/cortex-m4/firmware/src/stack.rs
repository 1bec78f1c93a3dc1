//! How much of the stack has been used: `cortex-m-rt` has painted it before `main`.

use core::ptr;

unsafe extern "C" {
    static _stack_start: u32;
    static _stack_end: u32;
}

/// What `cortex-m-rt` paints with.
const PAINT: u32 = 0xcccc_cccc;

/// Bytes between the start of the stack and the deepest word that is no longer as painted.
pub fn most_used_bytes() -> u32 {
    let mut at = &raw const _stack_end;
    let start = &raw const _stack_start;
    // SAFETY: both ends are the linker's, and all words between are RAM that nothing but the stack uses; the read is
    // volatile because the paint is written behind the compiler's back.
    while at < start && unsafe { ptr::read_volatile(at) } == PAINT {
        at = at.wrapping_add(1);
    }
    (start.addr() as u32).wrapping_sub(at.addr() as u32)
}
