//! What the executor counts and measures of a session.

use powderline_shared::displacement::{Lsb, Setpoint, displacement_between};
use powderline_shared::pose::norm;

/// Counts and measurements; counts stay at their largest value.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Telemetry {
    /// Tick of the last setpoint sent.
    pub sent: u32,
    /// Setpoints sent again because the arm did not have them.
    pub resent: u32,
    /// Requests made again because nothing had come of them.
    pub retries: u32,
    /// Setpoints that were not there when the arm needed them, as it says.
    pub lost: u16,
    /// Messages that the arm has dropped since its power on, as it says.
    pub dropped: u16,
    /// Shortest time from saying something to hearing of it, microseconds. Larger than any time before anything was heard.
    pub quickest_us: u64,
    /// Longest time from saying something to hearing of it, microseconds: waiting for the arm's next report included.
    pub round_trip_us: u64,
    /// Largest distance of the arm from where it was due, metres.
    pub tracking_m: f64,
    /// Largest angle of the arm from where it was due, radians.
    pub tracking_rad: f64,
}

impl Default for Telemetry {
    fn default() -> Self {
        Self {
            sent: 0,
            resent: 0,
            retries: 0,
            lost: 0,
            dropped: 0,
            quickest_us: u64::MAX,
            round_trip_us: 0,
            tracking_m: 0.0,
            tracking_rad: 0.0,
        }
    }
}

impl Telemetry {
    pub(crate) fn handle_round_trip(&mut self, time_us: u64) {
        self.quickest_us = self.quickest_us.min(time_us);
        self.round_trip_us = self.round_trip_us.max(time_us);
    }

    pub(crate) fn handle_tracking(&mut self, sent: Setpoint, reached: Setpoint, lsb: Lsb) {
        let off = displacement_between(sent, reached, lsb);
        self.tracking_m = self.tracking_m.max(norm(&off.translation()));
        self.tracking_rad = self.tracking_rad.max(norm(&off.rotation()));
    }
}
