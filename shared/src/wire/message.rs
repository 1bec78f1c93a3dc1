//! Messages between executor and arm, as values; `PROTOCOL.md` has them as bytes.
//!
//! | from     | message                | when                                                                    |
//! |----------|------------------------|-------------------------------------------------------------------------|
//! | executor | [`ToArm::Open`]        | first: which plan, at which period, how long, within which limits       |
//! | arm      | [`FromArm::Opened`]    | the session is accepted ([`FromArm::Refused`]: it is not, and why)      |
//! | executor | [`ToArm::Control`]     | to walk through the [`state`](super::state)s; each is answered by a status |
//! | arm      | [`FromArm::Anchored`]  | operation enabled: the pose X0 that all setpoints start from            |
//! | executor | [`ToArm::Setpoint`]    | each cumulative, each with the tick it belongs to, as credit allows     |
//! | arm      | [`FromArm::Status`]    | on every change, at every tick, and with every heartbeat                |
//! | arm      | [`FromArm::Actual`]    | at every tick, and with every heartbeat: where it really is             |
//! | arm      | [`FromArm::Fault`]     | when a fault is latched, and with every heartbeat while it is           |
//! | both     | `Heartbeat`            | every [`HEARTBEAT_US`]                                                  |
//! | anybody  | [`ToArm::Stop`]        | to stop the arm, whoever moves it                                       |
//!
//! # Ticks
//! The arm starts its clock, tick 0, when `start_level` setpoints are there. It takes setpoint k at tick k - 1 and reaches
//! it at tick k. A setpoint may be sent while its tick is at most [`Status::credit_until`], which is absolute, so that
//! neither loss nor repetition of a report can inflate it. [`Status::have`] tells which setpoints are there: one that was
//! sent and is not there is sent again, in time.

use serde::{Deserialize, Serialize};

use super::auth::{Proof, Tag};
use super::handshake;
use super::state::{Command, Phase, State};
use crate::displacement::{Lsb, Setpoint};
use crate::fault::Reported;
use crate::limits::Limits;
use crate::pose::Pose;

/// Version of the messages; both ends must have the same.
pub const PROTOCOL_VERSION: u16 = 3;

/// Session number that stands for no session.
pub const NO_SESSION: u16 = 0;

/// Setpoints after the one taken last that an arm has room for: one for each bit of [`Status::have`].
pub const DEPTH: u32 = 16;

/// Setpoints in a row that may be missing before an arm gives up: so far it goes on by itself, beginning to stop.
pub const BRIDGED_TICKS: u32 = 2;

/// Time between two heartbeats of either end, microseconds.
pub const HEARTBEAT_US: u64 = 100_000;

/// From executor to arm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ToArm {
    /// Opens a session.
    Open(OpenRequest),
    /// Opens a session with an arm that has the same key.
    OpenKeyed(OpenRequest, Proof),
    /// Asks for a state.
    Control {
        /// Session it belongs to.
        session: u16,
        /// What is asked.
        command: Command,
    },
    /// Where to be at a tick.
    Setpoint {
        /// Session it belongs to.
        session: u16,
        /// Tick and cumulative displacement from the anchor.
        setpoint: Setpoint,
    },
    /// The executor is alive.
    Heartbeat {
        /// Its session.
        session: u16,
    },
    /// Stop, as fast as the arm can. No session is asked for: whoever sees a reason may send it.
    Stop,
}

/// What the executor is about to play.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct OpenRequest {
    /// See [`PROTOCOL_VERSION`].
    pub version: u16,
    /// Number that all messages of this session carry; not [`NO_SESSION`].
    pub session: u16,
    /// Content hash of the plan.
    pub plan_hash: u64,
    /// Control period, microseconds.
    pub period_us: u32,
    /// Tick of the last setpoint.
    pub end_tick: u32,
    /// What one count is worth on the wire.
    pub lsb: Lsb,
    /// Limits of the plan; the arm keeps the tighter of these and its own.
    pub limits: Limits,
    /// Setpoints that must be there before the arm starts its clock.
    pub start_level: u16,
    /// What the arm has given out in [`Refusal::Latched`], to reset it: somebody has looked at it and says so. Otherwise 0.
    pub reset_nonce: u32,
}

impl OpenRequest {
    /// A digest of all that is asked for: FNV-1a over the body of its record.
    #[must_use]
    pub fn digest(&self) -> u64 {
        handshake::digest(self)
    }
}

/// From arm to executor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum FromArm {
    /// The session is open.
    Opened {
        /// Its number.
        session: u16,
        /// The arm's own, of this opening alone: all that follows is sealed with it.
        nonce: u32,
        /// Of the request that it accepted, [`OpenRequest::digest`].
        digest: u64,
    },
    /// The session is open, with a key.
    OpenedKeyed {
        /// Its number.
        session: u16,
        /// The arm's own, of this opening alone.
        nonce: u32,
        /// Of the request that it accepted.
        digest: u64,
        /// [`Key::answer`](super::auth::Key::answer).
        tag: Tag,
    },
    /// The session is not opened.
    Refused {
        /// The number asked for.
        session: u16,
        /// Why.
        reason: Refusal,
    },
    /// Operation is enabled at this pose.
    Anchored {
        /// Session.
        session: u16,
        /// X0; numbers as they were sent, which may be no pose ([`Pose::is_proper`]).
        pose: Pose,
    },
    /// Progress and state.
    Status(Status),
    /// Where the arm really is.
    Actual {
        /// Session.
        session: u16,
        /// The tick that it has just been due to reach; displacement from the anchor, rounded to the LSB of the wire.
        reached: Setpoint,
    },
    /// A fault is latched.
    Fault {
        /// Session in which it was found, or [`NO_SESSION`].
        session: u16,
        /// Which.
        fault: Reported,
    },
    /// The arm is alive.
    Heartbeat(Heartbeat),
}

/// Why an arm does not open a session.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Refusal {
    /// The arm speaks another version.
    Version {
        /// Version of the arm.
        arm: u16,
    },
    /// Another session is open.
    Busy,
    /// A session of this number was closed not long ago, or is latched.
    Closed,
    /// A stop or a fault is latched.
    Latched {
        /// Which.
        fault: Reported,
        /// Whoever resets it has to give this back, [`OpenRequest::reset_nonce`].
        nonce: u32,
    },
    /// The control period is outside the arm's range.
    Period,
    /// Session number, LSB, end tick, start level or limits have no meaning.
    Meaningless,
    /// One count is worth so much that rounding to counts would go far beyond the arm's own limits.
    Coarse,
    /// One count is not worth what it is on this wire.
    Counts,
    /// The arm has a key, and was asked without.
    KeyWanted,
    /// The arm has no key, and was asked with one.
    Keyless,
    /// The arm has another key, or the request is not what was sent.
    KeyOther,
}

impl core::fmt::Display for Refusal {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Version { arm } => {
                write!(f, "the arm speaks protocol version {arm}, the executor version {PROTOCOL_VERSION}")
            }
            Self::Busy => f.write_str("the arm is in another session"),
            Self::Closed => f.write_str("the arm has closed this session; another one needs another number"),
            Self::Latched { fault, .. } => {
                write!(
                    f,
                    "the arm has stopped ({fault}); look at it first, then --reset takes it out of that"
                )
            }
            Self::Period => f.write_str("the arm cannot keep the plan's control period"),
            Self::Meaningless => f.write_str("the session's numbers have no meaning to the arm"),
            Self::Counts => f.write_str("one count is worth something else on this wire"),
            Self::KeyWanted => {
                f.write_str("the arm has a key and was asked without; give --key FILE with the same")
            }
            Self::Keyless => {
                f.write_str("the arm has no key and was asked with one; start it with the same --key FILE")
            }
            Self::KeyOther => f.write_str("the arm has another key; both ends need the same --key FILE"),
            Self::Coarse => f.write_str(
                "one count on this wire is too coarse for the arm's limits at this control period",
            ),
        }
    }
}

/// Progress and state of the arm.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Status {
    /// Open session, or [`NO_SESSION`].
    pub session: u16,
    /// State.
    pub state: State,
    /// What it does in operation enabled; `None` in any other state.
    pub phase: Option<Phase>,
    /// Whether the arm stands still.
    pub standstill: bool,
    /// Last setpoint taken.
    pub applied_tick: u32,
    /// Bit i: the setpoint of tick `applied_tick + 1 + i` is there.
    pub have: u16,
    /// Counts the reports, so that an old one is known as such.
    pub counter: u8,
}

impl Status {
    /// Last tick for which the arm has room; none before it is anchored.
    #[must_use]
    pub fn credit_until(&self) -> u32 {
        self.phase.map_or(0, |_| self.applied_tick.saturating_add(DEPTH))
    }

    /// Setpoints waiting.
    #[must_use]
    pub fn buffered(&self) -> u32 {
        self.have.count_ones()
    }
}

/// Sign of life of the arm, with counts that nobody needs in a hurry.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Heartbeat {
    /// Open session, or [`NO_SESSION`].
    pub session: u16,
    /// Setpoints of the session that were not there when they were needed; stays at its largest value.
    pub lost: u16,
    /// Messages dropped since power on: stale, repeated, of another session or damaged; stays at its largest value.
    pub dropped: u16,
}
