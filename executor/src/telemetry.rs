//! What the executor counts and measures of a session.

use powderline_shared::displacement::Displacement;
use powderline_shared::pose::norm;

use crate::round_trip::RoundTrip;

/// Counts and measurements; counts stay at their largest value.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Telemetry {
    /// Tick of the last setpoint sent.
    pub sent: u32,
    /// How long after its moment it left, microseconds; `None` before the arm's clock is known.
    pub late_us: Option<u64>,
    /// Setpoints sent again because the arm did not have them.
    pub resent: u32,
    /// Requests made again because nothing had come of them.
    pub retries: u32,
    /// Setpoints that were not there when the arm needed them, as it says.
    pub lost: u16,
    /// Messages that the arm has dropped since its power on, as it says.
    pub dropped: u16,
    /// From saying something to hearing of it; waiting for the arm's next report included.
    pub round_trip: RoundTrip,
    /// Ticks at which the arm said where it was, and were compared with what was sent for them.
    pub tracked: u32,
    /// Largest distance of the arm from where it was due, metres.
    pub tracking_m: f64,
    /// Largest angle of the arm from where it was due, radians.
    pub tracking_rad: f64,
}

impl Telemetry {
    /// `first`: nothing has been compared at this tick before.
    pub(crate) fn handle_tracking(&mut self, off: &Displacement, first: bool) {
        self.tracked = self.tracked.saturating_add(u32::from(first));
        self.tracking_m = self.tracking_m.max(norm(&off.translation()));
        self.tracking_rad = self.tracking_rad.max(norm(&off.rotation()));
    }
}
