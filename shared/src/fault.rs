//! Faults: stable numbers and one plain sentence each.
//!
//! A number, once given, is never reused. The hundreds are bands:
//!
//! | band | about                                                     |
//! |------|-----------------------------------------------------------|
//! | 1xx  | the stream of setpoints                                   |
//! | 2xx  | limits, found by the executor before sending              |
//! | 3xx  | limits, found by the arm's controller on receiving        |
//! | 4xx  | session, handshake and states                             |
//! | 5xx  | a person's decision                                       |

use core::fmt;

use serde::{Deserialize, Serialize};

use crate::limits::Limit;

/// Who found that a limit is broken.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Side {
    /// The executor, before sending.
    Executor,
    /// The arm's controller, on receiving.
    Arm,
}

macro_rules! fault_codes {
    ($($(#[$doc:meta])* $name:ident = $code:literal, $sentence:literal;)*) => {
        /// What stopped a motion.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
        #[repr(u16)]
        #[serde(into = "u16", try_from = "u16")]
        pub enum FaultCode {
            $(#[doc = $sentence] $(#[$doc])* $name = $code,)*
        }

        impl FaultCode {
            /// All codes, in the order of their numbers.
            pub const ALL: &'static [Self] = &[$(Self::$name),*];

            /// The code's stable number.
            #[must_use]
            pub const fn number(self) -> u16 {
                match self { $(Self::$name => $code,)* }
            }

            /// One plain sentence.
            #[must_use]
            pub const fn sentence(self) -> &'static str {
                match self { $(Self::$name => $sentence,)* }
            }
        }

        impl TryFrom<u16> for FaultCode {
            type Error = UnknownFaultCode;

            fn try_from(number: u16) -> Result<Self, UnknownFaultCode> {
                match number {
                    $($code => Ok(Self::$name),)*
                    _ => Err(UnknownFaultCode(number)),
                }
            }
        }
    };
}

fault_codes! {
    SetpointMissing = 101, "The next setpoint had not arrived when the arm needed it.";
    SetpointRepeated = 102, "A setpoint arrived a second time with different content.";
    SetpointBeyondCredit = 103, "A setpoint arrived for which the arm had granted no credit.";
    SetpointPastEnd = 104, "A setpoint arrived for a tick after the announced end of the plan.";
    SetpointNotRepresentable = 105, "A setpoint held a rotation of pi or more, or a jump across it.";
    ArmSilent = 111, "The arm's controller stopped reporting.";
    LinkLost = 112, "The wire to the arm is gone.";
    ArmStalled = 113, "The arm reports, but no longer moves on to the next setpoint.";
    ArmTickImpossible = 114, "The arm reported a tick that it cannot be at.";
    ArmAstray = 115, "The arm was too far from where it was due.";
    PlanUnreadable = 121, "The plan in memory could not be read to its end.";
    ExecutorSilent = 131, "The executor stopped sending signs of life.";
    ArmOverrun = 132, "The arm's controller was held up for too long while it moved.";

    GuardWorkspace = 201, "The executor refused a setpoint outside the workspace.";
    GuardLinearVelocity = 202, "The executor refused a setpoint that breaks the limit on linear velocity.";
    GuardLinearAcceleration = 203, "The executor refused a setpoint that breaks the limit on linear acceleration.";
    GuardLinearJerk = 204, "The executor refused a setpoint that breaks the limit on linear jerk.";
    GuardAngularVelocity = 205, "The executor refused a setpoint that breaks the limit on angular velocity.";
    GuardAngularAcceleration = 206, "The executor refused a setpoint that breaks the limit on angular acceleration.";
    GuardAngularJerk = 207, "The executor refused a setpoint that breaks the limit on angular jerk.";

    ArmWorkspace = 301, "The arm refused a setpoint outside its workspace.";
    ArmLinearVelocity = 302, "The arm refused a setpoint that breaks its limit on linear velocity.";
    ArmLinearAcceleration = 303, "The arm refused a setpoint that breaks its limit on linear acceleration.";
    ArmLinearJerk = 304, "The arm refused a setpoint that breaks its limit on linear jerk.";
    ArmAngularVelocity = 305, "The arm refused a setpoint that breaks its limit on angular velocity.";
    ArmAngularAcceleration = 306, "The arm refused a setpoint that breaks its limit on angular acceleration.";
    ArmAngularJerk = 307, "The arm refused a setpoint that breaks its limit on angular jerk.";
    ArmUnreachable = 311, "A pose was commanded that the arm cannot reach.";
    ArmJointLimit = 312, "A pose was commanded for which a joint of the arm would turn beyond its range.";
    ArmJointSpeed = 313, "A pose was commanded for which a joint of the arm would turn faster than it can.";
    ArmSingular = 314, "The arm came too near to a singularity.";
    ArmFollowing = 315, "The arm did not follow its own commands closely enough.";

    SessionRefused = 401, "The arm refused the session.";
    AnchorElsewhere = 402, "The arm stands too far from the start pose of the plan.";
    StateUnexpected = 403, "The arm left the state that the session needs.";
    HandshakeTimeout = 404, "The arm did not take the next step of the handshake in time.";
    StopCommanded = 405, "The executor asked the arm for a quick stop.";
    EndElsewhere = 406, "The arm came to rest elsewhere than at the end of the plan.";
    ArmFaultUnknown = 407, "The arm reported a fault that this version does not know.";
    AnchorMeaningless = 408, "The arm reported an anchor that is no pose.";
    ArmDuplicate = 409, "Another arm speaks on this wire.";
    OpenedOther = 410, "The arm opened the session for something else than was asked for.";
    WrongTags = 411, "Too many frames came that were not made with the key.";
    ArmUnproven = 412, "The arm's answer was not made with the key.";

    OperatorStop = 501, "A person stopped the motion.";
    SoftwareStop = 502, "A stop frame was sent to the arm.";
}

impl FaultCode {
    /// The code for a broken limit.
    #[must_use]
    pub const fn from_limit(limit: Limit, side: Side) -> Self {
        match (side, limit) {
            (Side::Executor, Limit::Workspace(_)) => Self::GuardWorkspace,
            (Side::Executor, Limit::LinearVelocity) => Self::GuardLinearVelocity,
            (Side::Executor, Limit::LinearAcceleration) => Self::GuardLinearAcceleration,
            (Side::Executor, Limit::LinearJerk) => Self::GuardLinearJerk,
            (Side::Executor, Limit::AngularVelocity) => Self::GuardAngularVelocity,
            (Side::Executor, Limit::AngularAcceleration) => Self::GuardAngularAcceleration,
            (Side::Executor, Limit::AngularJerk) => Self::GuardAngularJerk,
            (Side::Arm, Limit::Workspace(_)) => Self::ArmWorkspace,
            (Side::Arm, Limit::LinearVelocity) => Self::ArmLinearVelocity,
            (Side::Arm, Limit::LinearAcceleration) => Self::ArmLinearAcceleration,
            (Side::Arm, Limit::LinearJerk) => Self::ArmLinearJerk,
            (Side::Arm, Limit::AngularVelocity) => Self::ArmAngularVelocity,
            (Side::Arm, Limit::AngularAcceleration) => Self::ArmAngularAcceleration,
            (Side::Arm, Limit::AngularJerk) => Self::ArmAngularJerk,
        }
    }
}

impl From<FaultCode> for u16 {
    fn from(code: FaultCode) -> Self {
        code.number()
    }
}

impl fmt::Display for FaultCode {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.sentence())
    }
}

/// A number that is no fault code of this version.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct UnknownFaultCode(pub u16);

impl fmt::Display for UnknownFaultCode {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} is not a fault code of this version", self.0)
    }
}

impl core::error::Error for UnknownFaultCode {}

/// A latched fault: what, and at which tick.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Fault {
    /// What stopped the motion.
    pub code: FaultCode,
    /// The tick concerned.
    pub tick: u32,
}

impl fmt::Display for Fault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "fault {} at tick {}: {}", self.code.number(), self.tick, self.code)
    }
}

impl core::error::Error for Fault {}

/// A fault as an arm reports it: by a number, which may be of a later version.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Reported {
    /// What stopped the motion.
    pub number: u16,
    /// The tick concerned.
    pub tick: u32,
}

impl Reported {
    /// The fault of this number.
    ///
    /// # Errors
    /// This version has none.
    pub fn known(&self) -> Result<Fault, UnknownFaultCode> {
        FaultCode::try_from(self.number).map(|code| Fault { code, tick: self.tick })
    }
}

impl From<Fault> for Reported {
    fn from(fault: Fault) -> Self {
        Self { number: fault.code.number(), tick: fault.tick }
    }
}

impl fmt::Display for Reported {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.known() {
            Ok(fault) => fault.fmt(f),
            Err(_) => {
                write!(f, "fault {} at tick {}, which this version does not know", self.number, self.tick)
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::string::ToString;

    #[test]
    fn numbers_are_pinned_and_sentences_are_sentences() {
        let numbers = [
            101, 102, 103, 104, 105, 111, 112, 113, 114, 115, 121, 131, 132, 201, 202, 203, 204, 205, 206,
            207, 301, 302, 303, 304, 305, 306, 307, 311, 312, 313, 314, 315, 401, 402, 403, 404, 405, 406,
            407, 408, 409, 410, 411, 412, 501, 502,
        ];
        assert!(FaultCode::ALL.iter().map(|code| code.number()).eq(numbers));
        for code in FaultCode::ALL {
            assert_eq!(FaultCode::try_from(code.number()), Ok(*code));
            let sentence = code.to_string();
            assert!(sentence.ends_with('.') && sentence.matches('.').count() == 1, "{sentence}");
        }
        assert_eq!(FaultCode::try_from(100), Err(UnknownFaultCode(100)));
    }

    #[test]
    fn limits_map_to_the_same_place_in_both_bands() {
        for limit in [Limit::LinearVelocity, Limit::LinearJerk, Limit::AngularAcceleration] {
            let sides = [Side::Executor, Side::Arm].map(|side| FaultCode::from_limit(limit, side).number());
            assert_eq!(sides.map(|number| number % 100).first(), sides.map(|number| number % 100).last());
        }
    }
}
