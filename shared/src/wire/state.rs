//! The arm's states, with the names and transition numbers of CiA 402.
//!
//! The table is data: tests hold the executor's way up and the arm's own, independent state machine against it.
//! It is CiA 402-style, not a claim of conformance. Two deliberate restrictions: transition 16 (quick stop back to
//! operation) does not exist, since a stop is latched; and power is never taken from a moving arm, so transitions that
//! leave operation enabled other than by a stop need standstill.

use serde::{Deserialize, Serialize};

/// State of the arm's controller.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum State {
    /// Starting up.
    NotReadyToSwitchOn,
    /// Started; power may not be switched on.
    SwitchOnDisabled,
    /// Power may be switched on.
    ReadyToSwitchOn,
    /// Powered, holding its brakes.
    SwitchedOn,
    /// Follows setpoints.
    OperationEnabled,
    /// Decelerating, or standing after it, by command.
    QuickStopActive,
    /// Decelerating because of a fault.
    FaultReactionActive,
    /// Standing; a fault is latched.
    Fault,
}

impl State {
    /// All states.
    pub const ALL: [Self; 8] = [
        Self::NotReadyToSwitchOn,
        Self::SwitchOnDisabled,
        Self::ReadyToSwitchOn,
        Self::SwitchedOn,
        Self::OperationEnabled,
        Self::QuickStopActive,
        Self::FaultReactionActive,
        Self::Fault,
    ];

    /// The name in CiA 402.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::NotReadyToSwitchOn => "not ready to switch on",
            Self::SwitchOnDisabled => "switch on disabled",
            Self::ReadyToSwitchOn => "ready to switch on",
            Self::SwitchedOn => "switched on",
            Self::OperationEnabled => "operation enabled",
            Self::QuickStopActive => "quick stop active",
            Self::FaultReactionActive => "fault reaction active",
            Self::Fault => "fault",
        }
    }
}

/// What a controller does inside [`State::OperationEnabled`], in the order in which it comes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub enum Phase {
    /// Anchored, at rest, waiting for the first setpoints.
    Armed,
    /// Following setpoints.
    Streaming,
    /// Following the last setpoints; all have arrived.
    Completing,
    /// At rest on the last setpoint.
    Holding,
}

/// Command from the executor.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Command {
    /// Towards ready to switch on.
    Shutdown,
    /// Towards switched on, from either side: CiA 402's "switch on" and "disable operation" are one and the same.
    SwitchOn,
    /// Towards operation enabled.
    EnableOperation,
    /// Back to switch on disabled.
    DisableVoltage,
    /// Decelerate and stand.
    QuickStop,
    /// Leave the latched fault.
    FaultReset,
}

impl Command {
    /// All commands.
    pub const ALL: [Self; 6] = [
        Self::Shutdown,
        Self::SwitchOn,
        Self::EnableOperation,
        Self::DisableVoltage,
        Self::QuickStop,
        Self::FaultReset,
    ];
}

/// What makes a state change.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Event {
    /// The controller itself: started up, or deceleration finished.
    Automatic,
    /// A command.
    Command(Command),
    /// A fault was found.
    FaultFound,
}

/// One line of the table.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Transition {
    /// Number in CiA 402.
    pub number: u8,
    /// Before.
    pub from: State,
    /// Why.
    pub event: Event,
    /// After.
    pub to: State,
    /// Only while the arm stands still; a moving arm makes a quick stop instead.
    pub at_standstill: bool,
}

/// All transitions but 0 (power on) and 13, which leads from any state to fault reaction.
pub const TRANSITIONS: [Transition; 16] = {
    use Command as C;
    use State as S;
    [
        line(1, S::NotReadyToSwitchOn, Event::Automatic, S::SwitchOnDisabled),
        line(2, S::SwitchOnDisabled, Event::Command(C::Shutdown), S::ReadyToSwitchOn),
        line(3, S::ReadyToSwitchOn, Event::Command(C::SwitchOn), S::SwitchedOn),
        line(4, S::SwitchedOn, Event::Command(C::EnableOperation), S::OperationEnabled),
        still(5, S::OperationEnabled, Event::Command(C::SwitchOn), S::SwitchedOn),
        line(6, S::SwitchedOn, Event::Command(C::Shutdown), S::ReadyToSwitchOn),
        line(7, S::ReadyToSwitchOn, Event::Command(C::DisableVoltage), S::SwitchOnDisabled),
        line(7, S::ReadyToSwitchOn, Event::Command(C::QuickStop), S::SwitchOnDisabled),
        still(8, S::OperationEnabled, Event::Command(C::Shutdown), S::ReadyToSwitchOn),
        still(9, S::OperationEnabled, Event::Command(C::DisableVoltage), S::SwitchOnDisabled),
        line(10, S::SwitchedOn, Event::Command(C::DisableVoltage), S::SwitchOnDisabled),
        line(10, S::SwitchedOn, Event::Command(C::QuickStop), S::SwitchOnDisabled),
        line(11, S::OperationEnabled, Event::Command(C::QuickStop), S::QuickStopActive),
        still(12, S::QuickStopActive, Event::Command(C::DisableVoltage), S::SwitchOnDisabled),
        line(14, S::FaultReactionActive, Event::Automatic, S::Fault),
        line(15, S::Fault, Event::Command(C::FaultReset), S::SwitchOnDisabled),
    ]
};

const fn line(number: u8, from: State, event: Event, to: State) -> Transition {
    Transition { number, from, event, to, at_standstill: false }
}

const fn still(number: u8, from: State, event: Event, to: State) -> Transition {
    Transition { number, from, event, to, at_standstill: true }
}

/// The transition that an event causes, if any.
#[must_use]
pub fn transition(from: State, event: Event) -> Option<Transition> {
    if event == Event::FaultFound {
        return fault_transition(from);
    }
    TRANSITIONS.into_iter().find(|line| line.from == from && line.event == event)
}

/// Transition 13. A fault is latched once; a second one changes nothing.
fn fault_transition(from: State) -> Option<Transition> {
    let latched = matches!(from, State::FaultReactionActive | State::Fault);
    (!latched).then(|| line(13, from, Event::FaultFound, State::FaultReactionActive))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_rise_and_no_line_is_ambiguous() {
        assert!(TRANSITIONS.windows(2).all(|pair| matches!(pair, [a, b] if a.number <= b.number)));
        for (i, a) in TRANSITIONS.iter().enumerate() {
            assert!(TRANSITIONS.iter().skip(i + 1).all(|b| (a.from, a.event) != (b.from, b.event)));
        }
    }

    #[test]
    fn operation_is_reached_through_switched_on_only() {
        for from in State::ALL {
            for command in Command::ALL {
                let to = transition(from, Event::Command(command)).map(|line| line.to);
                assert_eq!(
                    to == Some(State::OperationEnabled),
                    from == State::SwitchedOn && command == Command::EnableOperation
                );
            }
        }
    }

    #[test]
    fn every_state_has_a_way_out_and_a_fault_only_by_reset() {
        for from in State::ALL {
            assert!(TRANSITIONS.iter().any(|line| line.from == from), "{}", from.name());
        }
        let out_of_fault =
            Command::ALL.map(|command| transition(State::Fault, Event::Command(command)).is_some());
        assert_eq!(out_of_fault.iter().filter(|found| **found).count(), 1);
        assert!(transition(State::Fault, Event::Command(Command::FaultReset)).is_some());
        assert_eq!(transition(State::Fault, Event::FaultFound), None);
    }
}
