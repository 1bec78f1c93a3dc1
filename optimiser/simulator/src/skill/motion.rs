//! Segments laid end to end, and the motion they make.
//!
//! The whole motion lives in three coordinates of the tool's origin: forward along the heading, up, and pitch
//! about the horizontal axis perpendicular to the heading (positive: the opening tilts towards the heading). The
//! pitch axis never turns, so rotations about it add: that is composition on SO(3) without rounding.
//!
//! With an overlap o the transport begins before the lift ends, and the pour before the transport does, by
//!
//! ```text
//! o T1 T2 / (T1 + T2)
//! ```
//!
//! of the durations T1 and T2 of the two: less than either, and smooth in both. What they travel adds up.

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

impl SegmentKind {
    /// Whether it may begin before the one before it ends: not as long as the tool is in the bed.
    fn begins_early(self) -> bool {
        matches!(self, Self::Transport | Self::Pour)
    }
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
    /// 0 to 1; see the module.
    pub(super) overlap: f64,
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
    /// Lays travels end to end from time zero, or a little over each other.
    pub(super) fn schedule<S: SkillScalar>(&self, travels: &[Travel<S>]) -> Vec<Segment<S>> {
        let mut steps = 0;
        let mut segments: Vec<Segment<S>> = Vec::with_capacity(travels.len());
        for travel in travels {
            let before = segments.last().filter(|_| travel.kind.begins_early());
            let end_s = segments.last().map_or(S::constant(0.0), Segment::end_s);
            let (start_s, duration_s) = match self.timing {
                Timing::Continuous => {
                    let duration_s = continuous_s(self.profile, &self.legs(travel));
                    let early_s = before.map(|before| self.early(before.duration_s, duration_s));
                    (early_s.map_or(end_s, |early_s| end_s - early_s), duration_s)
                }
                Timing::Rounded => {
                    let n = rounded_steps(self.profile, &self.legs(travel), self.period_s);
                    let duration_s = S::constant(n as f64 * self.period_s);
                    let early_s = before.map(|before| self.early(before.duration_s, duration_s).value());
                    let early = libm::round(early_s.unwrap_or_default() / self.period_s) as u64;
                    // Counted from zero: sums of rounded products would drift off the control ticks.
                    let start = steps - early;
                    steps = start + n;
                    (S::constant(start as f64 * self.period_s), duration_s)
                }
            };
            segments.push(Segment { kind: travel.kind, start_s, duration_s, travel: travel.coordinates() });
        }
        segments
    }

    /// How far one segment begins before the one before it ends, of their durations.
    fn early<S: SkillScalar>(&self, before: S, duration: S) -> S {
        let both = before + duration;
        // Neither takes any time.
        if both.value() <= 0.0 {
            return S::constant(0.0);
        }
        S::constant(self.overlap) * before * duration / both
    }

    fn legs<S: SkillScalar>(&self, travel: &Travel<S>) -> Vec<Leg<S>> {
        let leg = |travel: Option<S>, pace| travel.map(|travel| Leg { travel, pace });
        let shares = matches!(travel.kind, SegmentKind::Lift | SegmentKind::Transport) && self.overlap > 0.0;
        let linear = if shares { self.linear.of_two_at_once() } else { self.linear };
        [leg(travel.forward, linear), leg(travel.up, linear), leg(travel.pitch, self.angular)]
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
