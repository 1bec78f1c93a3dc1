//! What two states of a machine have to differ in to count as two.
//!
//! A machine is read off its `Debug` text, so that a field that is added to it is part of the projection without anybody
//! thinking of it; what is left out is listed here, by name. Moments become distances from now, in steps of the grid of
//! time: a machine that does the same thing later is the same.

use std::cell::RefCell;
use std::fmt::{Debug, Write};
use std::hash::{DefaultHasher, Hasher};

/// Fields that are left out.
const LEFT_OUT: [&str; 38] = [
    // Constant, or said by other fields already.
    "own_limits",
    "limits",
    "header",
    "plan_hash",
    "setpoints",
    "guard",
    "checker",
    "doubt",
    "digest",
    // Numbers that are drawn anew each time; that nothing else is taken for them, the wire's own tests show.
    "seal",
    "nonce",
    "nonces",
    "challenge",
    "reset_nonce",
    "following",
    // Real numbers: where the arm is and how fast it moves. Kept is its phase of motion: which setpoint it has taken, how
    // many it has bridged, how many ticks it has braked, and of how many.
    "arm",
    "path",
    "motion",
    "pose",
    "v0",
    "a0",
    "anchor",
    "violation",
    "received",
    "tracked",
    "tracking_m",
    "tracking_rad",
    // Numbers that only grow. Of `counter`, the world keeps whether a report under way is news.
    "counter",
    "dropped",
    "lost",
    "resent",
    "retries",
    "echo_until",
    // Round trips, and when the executor thinks that the arm's clock has started: they decide when setpoints beyond the look-ahead leave,
    // and the plans here are hardly longer than that.
    "round_trip",
    "round_trip_us",
    "start_us",
    "asked_us",
    // When the arm was looked at last.
    "followed_us",
];

/// Fields that are moments to come, microseconds; how long ago one is does not matter.
const DEADLINES: [&str; 6] =
    ["give_up_at_us", "heartbeat_at_us", "next_tick_us", "resend_at_us", "retry_at_us", "stop_ends_at_us"];

/// Fields that are moments past, microseconds.
const EVENTS: [&str; 8] = [
    "at_us",
    "heard_us",
    "own_heartbeat_us",
    "progress_us",
    "reported_us",
    "resting_since_us",
    "stands_since_us",
    "stranger_us",
];

/// Now, and the grid of time, microseconds.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Present {
    /// The moment that others are told from.
    pub(crate) now_us: u64,
    /// Step of the grid.
    pub(crate) grid_us: u64,
    /// What is further away than this is as good as never, or as ever.
    pub(crate) horizon_us: u64,
}

impl Present {
    /// Steps from now to a deadline.
    fn until(&self, moment_us: u64) -> u64 {
        moment_us.saturating_sub(self.now_us).min(self.horizon_us).div_ceil(self.grid_us)
    }

    /// Steps from an event to now.
    fn since(&self, moment_us: u64) -> u64 {
        self.now_us.saturating_sub(moment_us).min(self.horizon_us).div_ceil(self.grid_us)
    }
}

/// The hash of a machine's projection.
pub(crate) fn hash_of(machine: &impl Debug, present: &Present) -> u64 {
    thread_local! { static TEXT: RefCell<String> = const { RefCell::new(String::new()) } }
    TEXT.with_borrow_mut(|text| {
        text.clear();
        let _ = write!(text, "{machine:?}");
        let mut hasher = DefaultHasher::new();
        project(text, present, |kept| hasher.write(kept));
        hasher.finish()
    })
}

/// What is said of a field of simple content in a `Debug` text.
pub(crate) fn field<'t>(text: &'t str, name: &str) -> Option<&'t str> {
    let value = text.split_once(&format!(" {name}: "))?.1;
    value.split([' ', ',', '(']).next()
}

fn project(text: &str, present: &Present, mut keep: impl FnMut(&[u8])) {
    let bytes = text.as_bytes();
    let (mut kept_to, mut at) = (0, 0);
    while let Some(byte) = bytes.get(at) {
        if !byte.is_ascii_lowercase() {
            at += 1;
            continue;
        }
        let name_end = at + bytes[at..].iter().take_while(|byte| is_of_name(**byte)).count();
        let is_field = bytes[name_end..].starts_with(b": ") && (at == 0 || !is_of_name(bytes[at - 1]));
        let name = &text[at..name_end];
        let steps = is_field.then(|| steps_of(name)).flatten();
        if is_field && (steps.is_some() || LEFT_OUT.contains(&name)) {
            let end = name_end + 2 + length_of_value(&bytes[name_end + 2..]);
            keep(&bytes[kept_to..at]);
            if let (Some(steps), Some(moment_us)) = (steps, number_in(&text[name_end + 2..end])) {
                keep(name.as_bytes());
                keep(&[b'0' + u8::try_from(steps(present, moment_us)).unwrap_or(u8::MAX - b'0')]);
            }
            (kept_to, at) = (end, end);
        } else {
            at = name_end;
        }
    }
    keep(&bytes[kept_to..]);
}

fn steps_of(name: &str) -> Option<fn(&Present, u64) -> u64> {
    if DEADLINES.contains(&name) {
        Some(Present::until)
    } else if EVENTS.contains(&name) {
        Some(Present::since)
    } else {
        None
    }
}

fn is_of_name(byte: u8) -> bool {
    byte.is_ascii_alphanumeric() || byte == b'_'
}

/// Up to the comma or bracket that ends the field.
fn length_of_value(bytes: &[u8]) -> usize {
    let mut depth = 0_u32;
    for (at, byte) in bytes.iter().enumerate() {
        match byte {
            b'{' | b'[' | b'(' => depth += 1,
            b'}' | b']' | b')' if depth == 0 => return at,
            b'}' | b']' | b')' => depth -= 1,
            b',' if depth == 0 => return at,
            _ => {}
        }
    }
    bytes.len()
}

/// The number of `N` or `Some(N)`.
fn number_in(value: &str) -> Option<u64> {
    let digits = value.trim_start_matches("Some(").trim_end_matches([')', ' ']);
    digits.parse().ok()
}

#[test]
fn fields_are_left_out_and_moments_are_distances() {
    let present = Present { now_us: 1_000, grid_us: 50, horizon_us: 600 };
    let read = |text: &str| {
        let mut kept = Vec::new();
        project(text, &present, |part| kept.extend_from_slice(part));
        kept
    };
    let same = |a: &str, b: &str| read(a) == read(b);
    assert_eq!(
        read("A { state: Fault, path: B { x: [1, 2] }, slots: [None] }"),
        b"A { state: Fault, , slots: [None] }"
    );
    assert_eq!(read("A { heard_us: 900, x: 1 }"), b"A { heard_us2, x: 1 }");
    assert!(
        same("A { heard_us: 900 }", "A { heard_us: 910 }")
            && !same("A { heard_us: 900 }", "A { heard_us: 950 }")
    );
    assert!(
        same("A { heard_us: 0 }", "A { heard_us: 300 }")
            && !same("A { heard_us: 1000 }", "A { heard_us: 900 }")
    );
    assert!(
        same("A { retry_at_us: 20 }", "A { retry_at_us: 1000 }")
            && !same("A { retry_at_us: 1001 }", "A { retry_at_us: 1000 }")
    );
    assert!(!same("A { next_tick_us: None }", "A { next_tick_us: Some(1000) }"));
    assert_eq!(field("A { x: 1, stage: Done(Completed), y: 2 }", "stage"), Some("Done"));
}
