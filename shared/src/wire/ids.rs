//! Identifiers: the predefined connection set of CANopen (CiA 301), node 1 the arm, node 0x7F the executor.
//!
//! The lower the number, the sooner a bus lets the frame through: a stop before a fault, a fault before a report, a
//! report before a setpoint.

/// To the arm: stop. Not a safety function.
pub const STOP: u16 = 0x001;
/// From the arm: a fault is latched (EMCY).
pub const FAULT: u16 = 0x081;
/// From the arm: status (TPDO 1).
pub const STATUS: u16 = 0x181;
/// To the arm: translation of a setpoint, or all of it in CAN FD (RPDO 1).
pub const SETPOINT_T: u16 = 0x201;
/// From the arm: translation of the actual displacement, or all of it in CAN FD (TPDO 2).
pub const ACTUAL_T: u16 = 0x281;
/// To the arm: rotation of a setpoint (RPDO 2).
pub const SETPOINT_R: u16 = 0x301;
/// From the arm: rotation of the actual displacement (TPDO 3).
pub const ACTUAL_R: u16 = 0x381;
/// To the arm: controlword (RPDO 3).
pub const CONTROL: u16 = 0x401;
/// From the arm: handshake (SDO server).
pub const HANDSHAKE_FROM_ARM: u16 = 0x581;
/// To the arm: handshake (SDO client).
pub const HANDSHAKE_TO_ARM: u16 = 0x601;
/// From the arm: heartbeat.
pub const HEARTBEAT_FROM_ARM: u16 = 0x701;
/// To the arm: heartbeat.
pub const HEARTBEAT_TO_ARM: u16 = 0x77F;

/// Whether the checksum of a classic frame has 8 bits: all have but those that enable an arm and keep it so, and handshakes.
pub(super) fn is_short(id: u16) -> bool {
    !matches!(id, CONTROL | HEARTBEAT_TO_ARM | HANDSHAKE_TO_ARM | HANDSHAKE_FROM_ARM | STOP)
}
