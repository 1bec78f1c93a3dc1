//! How much of a bus a session takes, at the worst.
//!
//! | symbol | meaning                                                                                              |
//! |--------|------------------------------------------------------------------------------------------------------|
//! | s      | data bytes of a frame                                                                                |
//! | classic | `47 + 8 s + floor((34 + 8 s - 1) / 4)` bits, interframe space and stuff bits counted (R. Davis, A. Burns, R. Bril, J. Lukkien, "Controller Area Network (CAN) schedulability analysis: Refuted, revisited and revised", Real-Time Systems 35, 2007) |
//! | FD, nominal rate | `17 + 4` from start of frame to bit rate switch, with stuff bits; `13` from CRC delimiter to interframe space (fields of ISO 11898-1:2015, to the safe side where the rate changes within a bit) |
//! | FD, data rate | `5 + 8 s` for error state, length and data, stuff bits so that there are `floor((22 + 8 s - 1) / 4)` up to there, and `27` (s <= 16) or `32` for stuff count and CRC with their fixed stuff bits |
//! | serial | `10` bits for each byte: start, 8 data, stop; `s + 4` bytes: identifier, COBS, delimiter             |
//!
//! Counted is what a session sends all the time: setpoint, status and actual displacement at every tick; both heartbeats,
//! with a status, an actual displacement and a fault, every [`HEARTBEAT_US`]. Setpoints that are sent again are not.

use super::message::HEARTBEAT_US;

const MICROSECONDS_PER_SECOND: f64 = 1e6;

/// What carries the frames, with its rate or rates in bits per second.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Medium {
    /// Classic CAN: both directions on one bus.
    Classic {
        /// Bit rate.
        bit_s: f64,
    },
    /// CAN FD: both directions on one bus.
    Fd {
        /// Bit rate of arbitration.
        nominal_bit_s: f64,
        /// Bit rate of data.
        data_bit_s: f64,
    },
    /// Serial line: a wire for each direction.
    Serial {
        /// Symbols, which are bits, per second.
        bit_s: f64,
    },
}

/// Data bytes of what is sent in one direction.
struct Traffic {
    per_tick: &'static [u8],
    per_heartbeat: &'static [u8],
}

const CLASSIC_TO_ARM: Traffic = Traffic { per_tick: &[8, 8], per_heartbeat: &[7] };
const CLASSIC_FROM_ARM: Traffic = Traffic { per_tick: &[8, 8, 8], per_heartbeat: &[8, 8, 8, 8, 8] };
const FD_TO_ARM: Traffic = Traffic { per_tick: &[48], per_heartbeat: &[12] };
const FD_FROM_ARM: Traffic = Traffic { per_tick: &[20, 48], per_heartbeat: &[16, 20, 48, 16] };

impl Medium {
    /// Most of the medium that a session with this control period can take, per cent; the busier wire of a serial line.
    /// Above 100 the session does not fit. A rate of 0 has no room for anything: infinity.
    #[must_use]
    pub fn load_percent(self, period_us: u32) -> f64 {
        let busy = |traffic: &Traffic| self.busy_share(traffic, f64::from(period_us));
        100.0
            * match self {
                Self::Classic { .. } => busy(&CLASSIC_TO_ARM) + busy(&CLASSIC_FROM_ARM),
                Self::Fd { .. } => busy(&FD_TO_ARM) + busy(&FD_FROM_ARM),
                Self::Serial { .. } => libm::fmax(busy(&FD_TO_ARM), busy(&FD_FROM_ARM)),
            }
    }

    /// Seconds of each second in which the traffic is on the wire.
    fn busy_share(self, traffic: &Traffic, period_us: f64) -> f64 {
        let sum = |lengths: &[u8]| lengths.iter().map(|bytes| self.frame_s(*bytes)).sum::<f64>();
        #[expect(clippy::cast_precision_loss, reason = "a tenth of a second in microseconds")]
        let heartbeat_us = HEARTBEAT_US as f64;
        MICROSECONDS_PER_SECOND
            * (sum(traffic.per_tick) / period_us + sum(traffic.per_heartbeat) / heartbeat_us)
    }

    /// Longest time that a frame of so many data bytes takes, seconds.
    #[must_use]
    pub fn frame_s(self, bytes: u8) -> f64 {
        match self {
            Self::Classic { bit_s } => f64::from(classic_bits(bytes)) / bit_s,
            Self::Fd { nominal_bit_s, data_bit_s } => {
                let (nominal, data) = fd_bits(bytes);
                f64::from(nominal) / nominal_bit_s + f64::from(data) / data_bit_s
            }
            Self::Serial { bit_s } => f64::from(serial_bits(bytes)) / bit_s,
        }
    }
}

/// Bits of data.
fn data_bits(bytes: u8) -> u32 {
    u32::from(bytes).saturating_mul(8)
}

/// Most stuff bits in so many bits: one after each four but the first.
fn stuff_bits(bits: u32) -> u32 {
    bits.saturating_sub(1) >> 2
}

/// Most bits of a classic frame.
fn classic_bits(bytes: u8) -> u32 {
    let stuffed = data_bits(bytes).saturating_add(34);
    stuffed.saturating_add(stuff_bits(stuffed)).saturating_add(13)
}

/// Most bits of a CAN FD frame, at the nominal rate and at the data rate.
fn fd_bits(bytes: u8) -> (u32, u32) {
    const ARBITRATION: u32 = 17;
    let nominal = ARBITRATION.saturating_add(stuff_bits(ARBITRATION)).saturating_add(13);
    let content = data_bits(bytes).saturating_add(5);
    let stuff = stuff_bits(content.saturating_add(ARBITRATION)).saturating_sub(stuff_bits(ARBITRATION));
    let crc = if bytes <= 16 { 27 } else { 32 };
    (nominal, content.saturating_add(stuff).saturating_add(crc))
}

/// Bits of a frame on a serial line.
fn serial_bits(bytes: u8) -> u32 {
    u32::from(bytes).saturating_add(4).saturating_mul(10)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::displacement::Setpoint;
    use crate::fault::{Fault, FaultCode};
    use crate::wire::checksum::Context;
    use crate::wire::codec::{Encoder, Frames};
    use crate::wire::frame::Dialect;
    use crate::wire::message::{FromArm, Heartbeat, Status, ToArm};
    use crate::wire::serial::to_line;
    use crate::wire::state::{Phase, State};
    use std::vec::Vec;

    const CLASSIC_500K: Medium = Medium::Classic { bit_s: 500e3 };
    const CLASSIC_1M: Medium = Medium::Classic { bit_s: 1e6 };
    const FD_1M_5M: Medium = Medium::Fd { nominal_bit_s: 1e6, data_bit_s: 5e6 };
    const SERIAL_921600: Medium = Medium::Serial { bit_s: 921_600.0 };

    #[test]
    fn frames_are_as_long_as_published() {
        // Davis et al. 2007: 55 + 10 s bits for 11-bit identifiers.
        for (bytes, bits) in (0..=8).zip((55..).step_by(10)) {
            assert_eq!(classic_bits(bytes), bits);
        }
        assert_eq!(fd_bits(8), (34, 113));
        assert_eq!(fd_bits(48), (34, 518));
        assert_eq!(fd_bits(64), (34, 678));
        assert_eq!(serial_bits(48), 520);
    }

    /// Stuff bits of a stream, inserted one by one: after five equal bits, the inserted one counted, comes the opposite.
    fn stuffed(bits: impl Iterator<Item = bool>) -> u32 {
        let (mut run, mut last, mut inserted) = (0_u32, None, 0_u32);
        for bit in bits {
            run = if last == Some(bit) { run.saturating_add(1) } else { 1 };
            last = Some(bit);
            if run == 5 {
                (run, last, inserted) = (1, Some(!bit), inserted.saturating_add(1));
            }
        }
        inserted
    }

    #[test]
    fn no_stream_is_stuffed_more_often() {
        // The worst: each inserted bit begins the next run.
        for length in 1..=100_u32 {
            let worst = (0..length).map(|bit| bit > 0 && (bit - 1) / 4 % 2 == 1);
            assert_eq!(stuffed(worst), stuff_bits(length));
        }
        for pattern in 0..1_u32 << 18 {
            assert!(stuffed((0..18).map(|bit| pattern >> bit & 1 == 1)) <= stuff_bits(18));
        }
    }

    fn lengths(frames: impl Iterator<Item = Frames>) -> Vec<u8> {
        frames.flatten().map(|frame| u8::try_from(frame.data.len()).unwrap()).collect()
    }

    #[test]
    fn the_traffic_is_what_the_codec_sends() {
        let status = FromArm::Status(Status {
            session: 1,
            state: State::OperationEnabled,
            phase: Some(Phase::Streaming),
            standstill: false,
            applied_tick: 1,
            have: 1,
            counter: 1,
        });
        let actual = FromArm::Actual { session: 1, reached: Setpoint::ANCHOR };
        let fault =
            FromArm::Fault { session: 1, fault: Fault { code: FaultCode::OperatorStop, tick: 1 }.into() };
        let heartbeat = FromArm::Heartbeat(Heartbeat { session: 1, lost: 0, dropped: 0 });
        let context = Context { session: 1, seal: 1, key: None };
        for (dialect, to_arm, from_arm) in
            [(Dialect::Classic, CLASSIC_TO_ARM, CLASSIC_FROM_ARM), (Dialect::Fd, FD_TO_ARM, FD_FROM_ARM)]
        {
            let mut encoder = Encoder::new(dialect);
            let from = |messages: &[FromArm]| {
                lengths(messages.iter().map(|message| Encoder::new(dialect).from_arm(&context, message)))
            };
            let mut to = |message: ToArm| lengths([encoder.to_arm(&context, &message)].into_iter());
            assert_eq!(to(ToArm::Setpoint { session: 1, setpoint: Setpoint::ANCHOR }), to_arm.per_tick);
            assert_eq!(to(ToArm::Heartbeat { session: 1 }), to_arm.per_heartbeat);
            assert_eq!(from(&[status, actual]), from_arm.per_tick);
            assert_eq!(from(&[heartbeat, status, actual, fault]), from_arm.per_heartbeat);
            for frame in encoder.from_arm(&context, &actual) {
                let bytes = u8::try_from(frame.data.len()).unwrap();
                assert_eq!(to_line(&frame).len() * 10, serial_bits(bytes) as usize);
            }
        }
    }

    fn assert_load(medium: Medium, period_us: u32, expected_percent: f64) {
        let found = medium.load_percent(period_us);
        assert!((found - expected_percent).abs() < 0.05, "{medium:?} {period_us} us: {found} %");
    }

    #[test]
    fn loads_of_common_buses() {
        // By hand, classic, 100 Hz: 5 frames of 135 bits per tick and 125 + 5 * 135 bits per heartbeat, 75,500 bit/s.
        assert_load(CLASSIC_500K, 10_000, 15.10);
        assert_load(CLASSIC_1M, 10_000, 7.55);
        assert_load(CLASSIC_500K, 1_000, 136.60);
        assert_load(CLASSIC_1M, 1_000, 68.30);
        // FD: frames of 48 and 20 bytes take at most 137.6 us and 81.6 us.
        assert_load(FD_1M_5M, 10_000, 4.00);
        assert_load(FD_1M_5M, 1_000, 36.11);
        // Serial, from the arm: 520 and 240 bits per tick.
        assert_load(SERIAL_921600, 10_000, 9.51);
        assert_load(SERIAL_921600, 1_000, 83.72);
    }

    #[test]
    fn no_rate_has_no_room() {
        assert!(Medium::Classic { bit_s: 0.0 }.load_percent(10_000).is_infinite());
        assert!(CLASSIC_500K.load_percent(0).is_infinite());
    }
}
