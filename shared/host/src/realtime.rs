//! Real-time scheduling: asks the system for what a control cycle wants, and says what it granted.
//!
//! | asked for          | against                                                                      |
//! |--------------------|------------------------------------------------------------------------------|
//! | `SCHED_FIFO`       | other programs running first                                                 |
//! | `mlockall`         | waiting for memory to come back from disk                                    |
//! | touched stack      | waiting for memory on its first use                                          |
//! | timer slack of 1 ns | timers put together with later ones (a thread without `SCHED_FIFO` only)    |
//!
//! Nothing of it is needed for a motion to be right: setpoints carry their ticks, and one that comes too late is missing.
//! On which processors the thread runs is left to whoever starts the program (`taskset`).

use std::fmt;
use std::io;
use std::num::NonZeroU64;

use rustix::mm::{MlockAllFlags, mlockall};
use rustix::process::{Resource, getrlimit};
use rustix::thread::{CapabilitySet, capabilities, set_current_timer_slack};
use serde::{Serialize, Serializer};

use crate::system;

/// Stack touched in advance, bytes: more than a control cycle uses, less than a thread has.
const STACK: usize = 256 * 1024;
/// Every page is at least this large, bytes.
const PAGE: usize = 4096;

/// Whether the system did what it was asked.
#[derive(Debug)]
pub enum Grant {
    /// It did.
    Granted,
    /// It did in part: what is missing.
    Partly(&'static str),
    /// It did not, for this reason.
    Refused(io::Error),
    /// It was not asked.
    NotAsked,
}

impl Grant {
    fn of(result: Result<(), impl Into<io::Error>>) -> Self {
        result.map_or_else(|error| Self::Refused(error.into()), |()| Self::Granted)
    }

    /// Whether the system did all that it was asked.
    #[must_use]
    pub fn is_granted(&self) -> bool {
        matches!(self, Self::Granted)
    }
}

impl fmt::Display for Grant {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Granted => f.write_str("granted"),
            Self::Partly(missing) => write!(f, "granted in part ({missing})"),
            Self::Refused(error) => write!(f, "not granted ({error})"),
            Self::NotAsked => f.write_str("not asked for"),
        }
    }
}

impl Serialize for Grant {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

/// What the system granted.
#[derive(Debug, Serialize)]
pub struct Granted {
    /// Priority asked for.
    pub priority: Option<u8>,
    /// `SCHED_FIFO` for the calling thread.
    pub scheduling: Grant,
    /// `mlockall` for the process.
    pub memory: Grant,
    /// Timer slack of 1 ns for the calling thread.
    pub timer_slack: Grant,
}

/// Prepares the calling thread for a control cycle. `priority` is that of `SCHED_FIFO`, 1..=99; `None` leaves the thread
/// scheduled as it is. Threads that it starts later are scheduled as usual.
#[must_use]
pub fn prepare(priority: Option<u8>) -> Granted {
    let memory = lock_memory();
    touch_stack();
    Granted {
        priority,
        scheduling: priority.map_or(Grant::NotAsked, |priority| Grant::of(system::schedule_fifo(priority))),
        memory,
        timer_slack: Grant::of(set_current_timer_slack(NonZeroU64::new(1))),
    }
}

/// Locks what memory there is; what is still to come only where no limit stands against it: beyond the limit the system
/// would refuse that memory altogether, and the process would die of it.
fn lock_memory() -> Grant {
    if may_lock_without_limit() {
        return Grant::of(mlockall(MlockAllFlags::CURRENT | MlockAllFlags::FUTURE));
    }
    match mlockall(MlockAllFlags::CURRENT) {
        Ok(()) => {
            Grant::Partly("memory taken from now on may be swapped: `ulimit -l unlimited` lifts the limit")
        }
        Err(error) => Grant::Refused(error.into()),
    }
}

fn may_lock_without_limit() -> bool {
    let privileged = capabilities(None).is_ok_and(|sets| sets.effective.contains(CapabilitySet::IPC_LOCK));
    privileged || getrlimit(Resource::Memlock).current.is_none()
}

#[inline(never)]
fn touch_stack() {
    let mut stack = [0_u8; STACK];
    for byte in stack.iter_mut().step_by(PAGE) {
        *byte = std::hint::black_box(1);
    }
    std::hint::black_box(&mut stack);
}

/// One line each, and what would help where something was refused.
impl fmt::Display for Granted {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.priority {
            Some(priority) => write!(f, "SCHED_FIFO, priority {priority}: {}", self.scheduling)?,
            None => write!(f, "SCHED_FIFO: {}", self.scheduling)?,
        }
        if matches!(self.scheduling, Grant::Refused(_)) {
            f.write_str("; `ulimit -r 99` or CAP_SYS_NICE would allow it, for priorities of 1 to 99")?;
        }
        write!(f, "\nmemory locked: {}", self.memory)?;
        if matches!(self.memory, Grant::Refused(_)) {
            f.write_str("; `ulimit -l unlimited` or CAP_IPC_LOCK would allow it")?;
        }
        write!(f, "\ntimer slack of 1 ns: {}", self.timer_slack)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_granted_and_what_is_not_is_said_in_one_line_each() {
        // Priority 100 does not exist, so that this is refused whoever runs the test.
        let granted = prepare(Some(100));
        assert!(matches!(granted.scheduling, Grant::Refused(_)));
        assert!(granted.timer_slack.is_granted());
        let text = granted.to_string();
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(lines.len(), 3, "{text}");
        assert!(lines[0].starts_with("SCHED_FIFO, priority 100: not granted (Invalid argument"), "{text}");
        assert!(lines[0].contains("priorities of 1 to 99"), "{text}");
        assert_eq!(lines[2], "timer slack of 1 ns: granted");
        let json = serde_json::to_value(&granted).unwrap();
        assert_eq!(json["timer_slack"], "granted");
    }

    #[test]
    fn without_a_priority_scheduling_stays_as_it_is() {
        let text = std::thread::spawn(|| prepare(None).to_string()).join().unwrap();
        assert!(text.starts_with("SCHED_FIFO: not asked for\n"), "{text}");
    }

    #[test]
    fn a_priority_that_is_granted_is_the_threads_own() {
        let granted = std::thread::spawn(|| {
            let granted = prepare(Some(1));
            // The kernel's own account of this thread and of one started by it.
            let stat = std::fs::read_to_string("/proc/thread-self/stat").unwrap();
            let child = std::thread::spawn(|| std::fs::read_to_string("/proc/thread-self/stat").unwrap());
            (granted.scheduling.is_granted(), policy(&stat), policy(&child.join().unwrap()))
        });
        let (granted, own, child) = granted.join().unwrap();
        assert_eq!(own, if granted { "1" } else { "0" });
        assert_eq!(child, "0");
    }

    /// Field 41 of proc(5)'s stat: the scheduling policy.
    fn policy(stat: &str) -> String {
        let after_name = stat.rsplit_once(')').unwrap().1;
        after_name.split_whitespace().nth(38).unwrap().to_owned()
    }
}
