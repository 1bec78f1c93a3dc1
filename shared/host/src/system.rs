//! The system calls that no crate wraps safely.
#![expect(
    unsafe_code,
    reason = "two calls of the kernel that the safe wrappers leave out, each with plain integers"
)]

use std::io;
use std::os::fd::AsFd;

use rustix::ioctl;

/// Schedules the calling thread first in, first out; threads that it starts later are scheduled as usual.
pub(crate) fn schedule_fifo(priority: u8) -> io::Result<()> {
    let parameters = libc::sched_param { sched_priority: i32::from(priority) };
    let policy = libc::SCHED_FIFO | libc::SCHED_RESET_ON_FORK;
    // SAFETY: the pointer is to a live, initialised `sched_param`, which the kernel only reads; 0 is the calling thread.
    let answer = unsafe { libc::sched_setscheduler(0, policy, &raw const parameters) };
    if answer == 0 { Ok(()) } else { Err(io::Error::last_os_error()) }
}

#[expect(
    clippy::cast_possible_truncation,
    reason = "the kernel's request codes have 32 bits, whatever C calls them"
)]
const TIOCOUTQ: ioctl::Opcode = libc::TIOCOUTQ as ioctl::Opcode;

/// Bytes that a terminal's driver holds and has not sent yet.
pub(crate) fn bytes_to_be_sent(terminal: impl AsFd) -> io::Result<usize> {
    // SAFETY: TIOCOUTQ takes a pointer to a C int and fills it, which is what the getter is made for.
    let held: libc::c_int = unsafe { ioctl::ioctl(terminal, ioctl::Getter::<TIOCOUTQ, libc::c_int>::new()) }?;
    Ok(usize::try_from(held).unwrap_or(0))
}
