//! How far an arm may be from where it is due: the following error (CiA 402, object 0x6065), axis by axis.
//!
//! | symbol | identifier                  | meaning                                                          |
//! |--------|-----------------------------|------------------------------------------------------------------|
//! | e      | `off`                       | where the arm is, minus where it is due, along or about an axis  |
//! | v      | `velocity`                  | how fast it is due to move along or about that axis              |
//! | e0     | `linear_m`, `angular_rad`   | how far it may be off at rest                                    |
//! | T      | `lag_s`                     | how late it may be                                               |
//!
//! ```text
//! |e| <= e0 + T |v|
//! ```
//!
//! An arm of first-order joints with a time constant tau is behind by tau v, so a constant bound would have to be as wide as
//! the fastest motion wants it, and would find nothing in a slow one. One report that is off may be a frame that was damaged and
//! passed its checksum; two of three are not.

use core::fmt;

use crate::displacement::Axis;

/// What a report that is off counts, and from which sum on the arm is astray; one that is not off takes one away.
const OFF: u8 = 2;
const ASTRAY: u8 = 3;

/// See the head of this file.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Following {
    /// Along each axis, metres.
    pub linear_m: f64,
    /// About each axis, radians.
    pub angular_rad: f64,
    /// Seconds.
    pub lag_s: f64,
}

impl Default for Following {
    /// 2 mm and 20 mrad at rest, and 30 ms: three time constants of the simulated arms' drives.
    fn default() -> Self {
        Self { linear_m: 2e-3, angular_rad: 20e-3, lag_s: 30e-3 }
    }
}

impl Following {
    /// The first axis along which the arm is too far off; six values each, of [`Axis::ALL`], m or rad and m/s or rad/s.
    #[must_use]
    pub fn excess(&self, tick: u32, off: [f64; 6], velocity: [f64; 6]) -> Option<Astray> {
        let at_rest = [[self.linear_m; 3], [self.angular_rad; 3]];
        let values = Axis::ALL.into_iter().zip(off).zip(velocity).zip(at_rest.into_iter().flatten());
        let mut astray = values.map(|(((axis, off), velocity), at_rest)| Astray {
            axis,
            tick,
            off: libm::fabs(off),
            bound: at_rest + self.lag_s * libm::fabs(velocity),
        });
        // Not a number is not within the bound either.
        astray.find(|astray| astray.off > astray.bound || astray.off.is_nan())
    }
}

/// The arm is too far from where it is due.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Astray {
    /// Along or about which axis.
    pub axis: Axis,
    /// At which tick.
    pub tick: u32,
    /// How far, m or rad.
    pub off: f64,
    /// How far it may be at that speed, m or rad.
    pub bound: f64,
}

impl fmt::Display for Astray {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { axis, tick, off, bound } = self;
        let unit = match axis {
            Axis::X | Axis::Y | Axis::Z => "mm",
            Axis::Rx | Axis::Ry | Axis::Rz => "mrad",
        };
        let (off, bound) = (1e3 * off, 1e3 * bound);
        write!(
            f,
            "at tick {tick} it was {off:.3} {unit} off in {axis}, and may be {bound:.3} {unit} at that speed"
        )
    }
}

/// Watches reports for an arm that is astray.
#[derive(Clone, Copy, Debug, Default)]
pub struct FollowingWatch {
    following: Following,
    strikes: u8,
}

impl FollowingWatch {
    /// Has seen nothing.
    #[must_use]
    pub fn new(following: Following) -> Self {
        Self { following, strikes: 0 }
    }

    /// Takes in how far the arm was off at a tick, as [`Following::excess`] does.
    ///
    /// # Errors
    /// The arm is astray.
    pub fn check(&mut self, tick: u32, off: [f64; 6], velocity: [f64; 6]) -> Result<(), Astray> {
        let Some(astray) = self.following.excess(tick, off, velocity) else {
            self.strikes = self.strikes.saturating_sub(1);
            return Ok(());
        };
        self.strikes = self.strikes.saturating_add(OFF);
        if self.strikes >= ASTRAY { Err(astray) } else { Ok(()) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::string::ToString;

    const STILL: [f64; 6] = [0.0; 6];

    fn off(axis: usize, by: f64) -> [f64; 6] {
        let mut off = STILL;
        off.iter_mut().skip(axis).take(1).for_each(|off| *off = by);
        off
    }

    #[test]
    fn each_axis_has_its_bound_and_speed_widens_it() {
        let following = Following::default();
        for (axis, bound) in [2e-3, 2e-3, 2e-3, 20e-3, 20e-3, 20e-3].into_iter().enumerate() {
            for sign in [1.0, -1.0] {
                assert_eq!(following.excess(7, off(axis, sign * 0.99 * bound), STILL), None);
                let astray = following.excess(7, off(axis, sign * 1.01 * bound), STILL).unwrap();
                assert_eq!((astray.axis, astray.tick), (Axis::ALL.into_iter().nth(axis).unwrap(), 7));
                // At 1 m/s or rad/s it may be 30 ms late.
                assert_eq!(
                    following.excess(7, off(axis, sign * (0.99 * bound + 0.03)), off(axis, -1.0)),
                    None
                );
                assert!(
                    following.excess(7, off(axis, sign * (1.01 * bound + 0.03)), off(axis, 1.0)).is_some()
                );
            }
        }
        assert!(following.excess(7, off(4, f64::NAN), STILL).is_some());
    }

    #[test]
    fn one_report_is_none_and_two_of_three_are() {
        let far = off(1, 5e-3);
        let mut watch = FollowingWatch::default();
        for tick in 0..30 {
            let off = if tick % 3 == 0 { far } else { STILL };
            assert_eq!(watch.check(tick, off, STILL), Ok(()));
        }
        let mut watch = FollowingWatch::default();
        assert_eq!(watch.check(0, far, STILL), Ok(()));
        assert_eq!(watch.check(1, STILL, STILL), Ok(()));
        let astray = watch.check(2, far, STILL).unwrap_err();
        assert_eq!(
            astray.to_string(),
            "at tick 2 it was 5.000 mm off in y, and may be 2.000 mm at that speed"
        );
    }
}
