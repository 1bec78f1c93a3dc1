//! Controlword and statusword, with the bits of CiA 402.
//!
//! | bit of the statusword | meaning                                                                              |
//! |-----------------------|--------------------------------------------------------------------------------------|
//! | 0..=3, 5, 6           | state                                                                                |
//! | 4                     | voltage enabled: switched on, operation enabled, and while stopping                  |
//! | 10                    | target reached: the arm stands still                                                 |
//! | 8, 14                 | both: the arm is in a session; neither: it is in none (manufacturer specific)         |
//! | 12, 13                | phase in operation enabled: 0 armed, 1 streaming, 2 completing, 3 holding             |
//!
//! Where CiA 402 leaves a bit open, it is 0; a word with any other bit set is refused, for the reader would not know what
//! its writer meant by it.

use super::state::{Command, Phase, State};

const TARGET_REACHED: u16 = 1 << 10;
/// Two bits, so that no single wrong bit makes one of the other.
const IN_SESSION: u16 = (1 << 8) | (1 << 14);
const PHASE_SHIFT: u32 = 12;
const PHASE_MASK: u16 = 0b11 << PHASE_SHIFT;

/// What a statusword says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StatusBits {
    /// State.
    pub state: State,
    /// Phase; `None` outside [`State::OperationEnabled`].
    pub phase: Option<Phase>,
    /// Whether the arm stands still.
    pub standstill: bool,
    /// Whether the arm is in a session, the one that its reader has to be in too.
    pub in_session: bool,
}

/// The controlword of a command.
#[must_use]
pub const fn controlword(command: Command) -> u16 {
    match command {
        Command::DisableVoltage => 0x0000,
        Command::QuickStop => 0x0002,
        Command::Shutdown => 0x0006,
        Command::SwitchOn => 0x0007,
        Command::EnableOperation => 0x000F,
        Command::FaultReset => 0x0080,
    }
}

/// The command of a controlword, if it is one of those that [`controlword`] makes.
#[must_use]
pub fn command(word: u16) -> Option<Command> {
    Command::ALL.into_iter().find(|command| controlword(*command) == word)
}

/// The bits of a statusword that stand for the state.
#[must_use]
pub const fn state_bits(state: State) -> u16 {
    match state {
        State::NotReadyToSwitchOn => 0x00,
        State::SwitchOnDisabled => 0x40,
        State::ReadyToSwitchOn => 0x21,
        State::SwitchedOn => 0x33,
        State::OperationEnabled => 0x37,
        State::QuickStopActive => 0x17,
        State::FaultReactionActive => 0x1F,
        State::Fault => 0x08,
    }
}

const fn phase_bits(phase: Phase) -> u16 {
    match phase {
        Phase::Armed => 0,
        Phase::Streaming => 1 << PHASE_SHIFT,
        Phase::Completing => 2 << PHASE_SHIFT,
        Phase::Holding => 3 << PHASE_SHIFT,
    }
}

/// The statusword. A phase outside operation enabled is left out, none in it is [`Phase::Armed`].
#[must_use]
pub fn statusword(bits: StatusBits) -> u16 {
    let phase = bits.phase.filter(|_| bits.state == State::OperationEnabled);
    let standstill = if bits.standstill { TARGET_REACHED } else { 0 };
    let session = if bits.in_session { IN_SESSION } else { 0 };
    state_bits(bits.state) | phase.map_or(0, phase_bits) | standstill | session
}

/// What a statusword says, if it is one of those that [`statusword`] makes.
#[must_use]
pub fn status(word: u16) -> Option<StatusBits> {
    let standstill = word & TARGET_REACHED != 0;
    let in_session = match word & IN_SESSION {
        IN_SESSION => true,
        0 => false,
        _ => return None,
    };
    let rest = word & !(TARGET_REACHED | PHASE_MASK | IN_SESSION);
    let state = State::ALL.into_iter().find(|state| state_bits(*state) == rest)?;
    let phase = match state {
        State::OperationEnabled => Some(phase(word & PHASE_MASK)?),
        _ if word & PHASE_MASK == 0 => None,
        _ => return None,
    };
    Some(StatusBits { state, phase, standstill, in_session })
}

fn phase(bits: u16) -> Option<Phase> {
    [Phase::Armed, Phase::Streaming, Phase::Completing, Phase::Holding]
        .into_iter()
        .find(|phase| phase_bits(*phase) == bits)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Masks and values of CiA 402, statusword (0x6041), in the order of [`State::ALL`].
    const CIA_402: [(u16, u16); 8] = [
        (0x4F, 0x00),
        (0x4F, 0x40),
        (0x6F, 0x21),
        (0x6F, 0x23),
        (0x6F, 0x27),
        (0x6F, 0x07),
        (0x4F, 0x0F),
        (0x4F, 0x08),
    ];

    #[test]
    fn a_drive_tool_reads_each_state() {
        for (i, state) in State::ALL.into_iter().enumerate() {
            let word = state_bits(state);
            for (j, (mask, value)) in CIA_402.into_iter().enumerate() {
                assert_eq!(word & mask == value, i == j, "{}", state.name());
            }
        }
    }

    #[test]
    fn every_word_is_refused_or_made_again() {
        let mut read = 0;
        for word in 0..=u16::MAX {
            if let Some(bits) = status(word) {
                assert_eq!(statusword(bits), word);
                read += 1;
            }
        }
        assert_eq!(read, (7 + 4) * 2 * 2);
        let commands = (0..=u16::MAX).filter_map(|word| command(word).map(|command| (word, command)));
        assert_eq!(commands.filter(|(word, command)| controlword(*command) == *word).count(), 6);
    }
}
