//! Segments laid end to end, and the motion they make.
//!
//! The whole motion lives in three coordinates of the tool's origin: forward along the heading, up, and pitch
//! about the horizontal axis perpendicular to the heading (positive: the opening tilts towards the heading). The
//! pitch axis never turns, so rotations about it add: that is composition on SO(3) without rounding.

use super::{
    duration::{Leg, Pace, continuous_s, rounded_steps},
    profile::position,
    real::SkillScalar,
};
use crate::scene::{Profile, Timing};

/// Forward (metres), up (metres) and pitch (radians), from the start pose.
pub(super) type Coordinates<S> = [S; 3];

/// What a segment does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum SegmentKind {
    /// Down from the start pose to the powder's surface.
    Approach,
    /// Further down, by the scooping depth.
    Insert,
    /// The opening comes up by the scooping angle while the tool sweeps forward.
    Scoop,
    /// Straight up by the lift height.
    Lift,
    /// Along the heading by the transport displacement.
    Transport,
    /// The opening tilts forward by the pouring angle.
    Pour,
}

/// Travel of one segment: translation along one direction, rotation, or both.
#[derive(Clone, Copy)]
pub(super) struct Travel<S> {
    pub(super) kind: SegmentKind,
    pub(super) forward: Option<S>,
    pub(super) up: Option<S>,
    pub(super) pitch: Option<S>,
}

impl<S: SkillScalar> Travel<S> {
    fn coordinates(&self) -> Coordinates<S> {
        [self.forward, self.up, self.pitch].map(|travel| travel.unwrap_or(S::constant(0.0)))
    }
}

/// How travels become a motion in time.
#[derive(Clone, Copy, Debug)]
pub(super) struct TimeParametrisation {
    pub(super) linear: Pace,
    pub(super) angular: Pace,
    pub(super) timing: Timing,
    pub(super) profile: Profile,
    pub(super) period_s: f64,
    pub(super) horizon_steps: u32,
}

/// A travel with its place in time.
#[derive(Clone, Copy)]
pub(super) struct Segment<S> {
    pub(super) kind: SegmentKind,
    pub(super) start_s: S,
    pub(super) duration_s: S,
    travel: Coordinates<S>,
}

impl<S: SkillScalar> Segment<S> {
    pub(super) fn end_s(&self) -> S {
        self.start_s + self.duration_s
    }

    /// Fraction of the travel covered at `time_s`; a segment of no duration is a step.
    fn progress(&self, profile: Profile, time_s: f64) -> S {
        let elapsed = S::constant(time_s) - self.start_s;
        if elapsed.value() <= 0.0 {
            S::constant(0.0)
        } else if elapsed.value() >= self.duration_s.value() {
            S::constant(1.0)
        } else {
            position(profile, elapsed / self.duration_s)
        }
    }
}

impl TimeParametrisation {
    /// Lays travels end to end from time zero.
    pub(super) fn schedule<S: SkillScalar>(&self, travels: &[Travel<S>]) -> Vec<Segment<S>> {
        let mut start_s = S::constant(0.0);
        let mut steps = 0;
        let mut segments = Vec::with_capacity(travels.len());
        for travel in travels {
            let duration_s = match self.timing {
                Timing::Continuous => continuous_s(self.profile, &self.legs(travel)),
                Timing::Rounded => {
                    let n = rounded_steps(self.profile, &self.legs(travel), self.period_s);
                    // Counted from zero: sums of rounded products would drift off the control ticks.
                    start_s = S::constant(steps as f64 * self.period_s);
                    steps += n;
                    S::constant(n as f64 * self.period_s)
                }
            };
            segments.push(Segment { kind: travel.kind, start_s, duration_s, travel: travel.coordinates() });
            start_s = start_s + duration_s;
        }
        segments
    }

    fn legs<S: SkillScalar>(&self, travel: &Travel<S>) -> Vec<Leg<S>> {
        let leg = |travel: Option<S>, pace| travel.map(|travel| Leg { travel, pace });
        [leg(travel.forward, self.linear), leg(travel.up, self.linear), leg(travel.pitch, self.angular)]
            .into_iter()
            .flatten()
            .collect()
    }

    /// Coordinates at every control tick `0..=horizon_steps`.
    pub(super) fn sample<S: SkillScalar>(&self, segments: &[Segment<S>]) -> Vec<Coordinates<S>> {
        (0..=self.horizon_steps)
            .map(|tick| {
                // A hair early would be one tick late: the end of a rounded segment is a tick exactly.
                let time_s = f64::from(tick) * self.period_s;
                let mut at = [S::constant(0.0); 3];
                for segment in segments {
                    let progress = segment.progress(self.profile, time_s);
                    at = std::array::from_fn(|k| at[k] + segment.travel[k] * progress);
                }
                at
            })
            .collect()
    }
}
