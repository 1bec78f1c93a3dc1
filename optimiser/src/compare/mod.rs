//! Ways to search, side by side, each with the same number of rollouts.
//!
//! Nothing here simulates or touches a file: [`Track`] holds what a search simulated, [`Comparison`] judges tracks.
//!
//! What a motion costs is counted in *rollouts*, those of the scene itself. By number a motion in the coarse world counts as
//! [`COARSE_ROLLOUT`], and an adjoint as [`Adjoint`]s are measured to cost, beside the rollout that it is the adjoint of: that is when a search has
//! had its budget, the same on any machine. By processor time it counts as it was measured, over the mean of the plain rollouts of all
//! tracks of the same seed. What a search has achieved by then is the skill with the lowest loss, of those that it has simulated in the scene
//! itself: what one would send to the arm if it ended there, and the tool met no container.

pub mod figure;
mod summary;

pub use summary::{Row, summarise};

use crate::{
    optim::{Adjoint, Method, World},
    report::{amounts::Amounts, tries::Try},
};

/// A motion in the coarse world, in rollouts, as processors measure it on `bench`, `vial` and `bench-small` (0.30, 0.33, 0.23).
pub const COARSE_ROLLOUT: f64 = 0.3;

/// An adjoint, in rollouts, beside the one that it is the adjoint of: as `optimise gradcheck bench-small --skills 20` measures them
/// (6.9 and 4.6 with that one).
pub const EXACT_ADJOINT: f64 = 6.0;
/// See [`EXACT_ADJOINT`].
pub const RESTARTED_ADJOINT: f64 = 4.0;

/// What a motion costs, by number, in rollouts.
fn cost(one: &Try) -> f64 {
    let adjoint = match one.adjoint {
        None => 0.0,
        Some(Adjoint::Exact) => EXACT_ADJOINT,
        Some(Adjoint::Restarted) => RESTARTED_ADJOINT,
    };
    adjoint + if one.world == World::Coarse { COARSE_ROLLOUT } else { 1.0 }
}

/// What motions cost together, by number, in rollouts.
pub fn cost_of<'a>(tries: impl IntoIterator<Item = &'a Try>) -> f64 {
    tries.into_iter().map(cost).sum()
}

/// What one search simulated, from one seed.
#[derive(Clone, Debug, PartialEq)]
pub struct Track {
    /// The search.
    pub method: Method,
    /// Seed of packing and search.
    pub seed: u64,
    /// In the order of simulation.
    pub tries: Vec<Try>,
}

/// The best skill of a track so far.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Best<'a> {
    /// What it cost until then, by number, rollouts.
    pub rollouts: f64,
    /// The same by processor time.
    pub by_time: f64,
    /// Processor time until then, seconds.
    pub cpu_seconds: f64,
    /// The skill.
    pub one: &'a Try,
}

impl Track {
    /// The best skill after each motion, from the first in the scene itself on; `rollout_s` is the processor time of one.
    pub fn bests(&self, rollout_s: f64) -> Vec<Best<'_>> {
        let mut bests: Vec<Best<'_>> = Vec::new();
        let (mut rollouts, mut cpu_seconds) = (0.0, 0.0);
        for one in &self.tries {
            rollouts += cost(one);
            cpu_seconds += one.cpu_seconds;
            let before = bests.last().map(|best| best.one);
            let is_better = |other: &Try| one.world == World::Fine && one.loss < other.loss;
            let best = match before {
                Some(before) if !is_better(before) => before,
                None if one.world == World::Coarse => continue,
                _ => one,
            };
            bests.push(Best { rollouts, by_time: cpu_seconds / rollout_s, cpu_seconds, one: best });
        }
        bests
    }
}

/// All tracks, and what they are measured by.
#[derive(Clone, Debug)]
pub struct Comparison {
    /// The scene's name.
    pub scene: String,
    /// What is wanted, and what particles weigh.
    pub amounts: Amounts,
    /// Rollouts after which searches are judged, rising; they end with the last.
    pub budgets: Vec<u32>,
    /// The tracks.
    pub tracks: Vec<Track>,
}

/// A way to count.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Count {
    /// By number.
    Number,
    /// By processor time.
    Time,
}

impl Best<'_> {
    /// What it cost until then, rollouts.
    pub fn cost(&self, count: Count) -> f64 {
        match count {
            Count::Number => self.rollouts,
            Count::Time => self.by_time,
        }
    }
}

impl Comparison {
    /// The methods, in the order of their first tracks.
    pub fn methods(&self) -> Vec<Method> {
        let mut methods: Vec<Method> = Vec::new();
        for track in &self.tracks {
            if !methods.contains(&track.method) {
                methods.push(track.method);
            }
        }
        methods
    }

    /// Tracks of a method, one for each seed.
    pub fn tracks_of(&self, method: Method) -> impl Iterator<Item = &Track> {
        self.tracks.iter().filter(move |track| track.method == method)
    }

    /// Processor time of a rollout of a seed, seconds; 1 where none was measured.
    pub fn rollout_s(&self, seed: u64) -> f64 {
        let plain = |one: &&Try| one.world == World::Fine && one.adjoint.is_none();
        let tracks = self.tracks.iter().filter(|track| track.seed == seed);
        let (mut count, mut sum) = (0.0, 0.0);
        for one in tracks.flat_map(|track| track.tries.iter().filter(plain)) {
            (count, sum) = (count + 1.0, sum + one.cpu_seconds);
        }
        if sum > 0.0 { sum / count } else { 1.0 }
    }

    /// The best skills of a track as it went on.
    pub fn bests<'a>(&self, track: &'a Track) -> Vec<Best<'a>> {
        track.bests(self.rollout_s(track.seed))
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use powderline_simulator::{rollout::Census, scene::Scene};

    pub(crate) fn at(loss: f64) -> Try {
        let census = Census { target: (100.0 - loss) as u32, ..Census::default() };
        Try {
            epoch: 0,
            theta: vec![0.0; 5],
            splines: None,
            world: World::Fine,
            rounded: false,
            adjoint: None,
            loss,
            indicator: 100 - i64::from(census.target),
            census,
            gradient: None,
            cpu_seconds: 2.0,
        }
    }

    pub(super) fn track(method: Method, seed: u64, losses: &[f64]) -> Track {
        Track { method, seed, tries: losses.iter().map(|loss| at(*loss)).collect() }
    }

    pub(super) fn comparison() -> Comparison {
        Comparison {
            scene: "bench".into(),
            amounts: (&Scene::load("bench").unwrap()).into(),
            budgets: vec![2, 6],
            tracks: vec![
                track(Method::Surrogate, 1, &[50.0, 40.0, 45.0, 45.0, 45.0, 45.0]),
                track(Method::Surrogate, 2, &[60.0, 40.0, 30.0, 35.0, 35.0, 35.0]),
                track(Method::Random, 1, &[90.0, 89.0, 88.0, 87.0, 86.0, 85.0]),
                track(Method::Random, 2, &[70.0; 6]),
            ],
        }
    }

    #[test]
    fn the_best_so_far_counts() {
        let comparison = comparison();
        let track = &comparison.tracks[0];
        let bests: Vec<(f64, f64)> =
            comparison.bests(track).iter().map(|best| (best.rollouts, best.one.loss)).collect();
        assert_eq!(bests[..3], [(1.0, 50.0), (2.0, 40.0), (3.0, 40.0)]);
        assert_eq!(comparison.methods(), [Method::Surrogate, Method::Random]);
    }

    #[test]
    fn coarse_motions_and_adjoints_count_as_they_are_measured_and_coarse_losses_for_nothing() {
        let mut track = track(Method::Surrogate, 1, &[9.0, 50.0, 40.0, 45.0]);
        track.tries[0].world = World::Coarse;
        track.tries[0].cpu_seconds = 0.5;
        track.tries[2].adjoint = Some(Adjoint::Restarted);
        track.tries[2].cpu_seconds = 11.0;
        track.tries[3].adjoint = Some(Adjoint::Exact);
        let comparison = Comparison { tracks: vec![track], ..comparison() };
        let bests = comparison.bests(&comparison.tracks[0]);
        let costs = |count| bests.iter().map(|best| best.cost(count)).collect::<Vec<_>>();
        assert_eq!(costs(Count::Number), [1.3, 6.3, 13.3]);
        // A plain rollout takes two seconds.
        assert_eq!(costs(Count::Time), [1.25, 6.75, 7.75]);
        assert_eq!(bests.iter().map(|best| best.one.loss).collect::<Vec<_>>(), [50.0, 40.0, 40.0]);
    }
}
