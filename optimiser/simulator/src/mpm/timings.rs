//! What each stage of a substep costs, read off between the stages as they run.
//!
//! A gauge is anything that only grows: the time, or operations counted. Without one nothing is read or kept.

/// A stage of a substep, forward or adjoint.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Stage {
    /// Finding out which particles share which part of the grid; most substeps need none.
    Sort,
    /// Trial strain, return map and scatter.
    ParticlesToGrid,
    /// Sum of the tiles, gravity, contact at nodes.
    GridUpdate,
    /// Gather, contact at particles, advection.
    GridToParticles,
    /// Adjoint of [`Self::GridToParticles`].
    GridToParticlesAdjoint,
    /// Adjoint of [`Self::GridUpdate`].
    GridUpdateAdjoint,
    /// Adjoint of [`Self::ParticlesToGrid`].
    ParticlesToGridAdjoint,
    /// Adjoint of [`Self::Sort`].
    SortAdjoint,
    /// Trial strain and return map by themselves.
    ReturnMap,
    /// Adjoint of [`Self::ReturnMap`].
    ReturnMapAdjoint,
}

/// How many stages there are.
pub(crate) const STAGES: usize = 10;

/// What a gauge shows: wall and processor nanoseconds, or operations and how many of them are divisions and square roots.
pub(crate) type Reading = [u64; 2];

/// Gives a reading; never less than before.
pub(crate) type Gauge = fn() -> Reading;

/// What runs through stages.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Pass {
    /// A substep.
    Forward,
    /// A substep's adjoint, with what it computes again of the substep.
    Adjoint,
    /// Stages by themselves, see `Workspace::alone`.
    Alone,
}

/// One pass, and what each stage took of it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PassTimings {
    pub(crate) pass: Pass,
    pub(crate) stages: [Reading; STAGES],
}

/// The passes since a gauge was set.
#[derive(Debug, Default)]
pub(crate) struct StageTimings {
    gauge: Option<Gauge>,
    last: Reading,
    timings: Vec<PassTimings>,
}

impl StageTimings {
    /// Begins to keep timings.
    pub(crate) fn follow(&mut self, gauge: Gauge) {
        self.gauge = Some(gauge);
        self.timings.clear();
    }

    /// Ends it, and gives what was kept.
    pub(crate) fn take(&mut self) -> Vec<PassTimings> {
        self.gauge = None;
        std::mem::take(&mut self.timings)
    }

    /// A pass begins.
    pub(crate) fn begin(&mut self, pass: Pass) {
        if self.gauge.is_some() {
            self.timings.push(PassTimings { pass, stages: [[0; 2]; STAGES] });
            self.skip();
        }
    }

    /// What was done since the last reading belongs to no stage.
    pub(crate) fn skip(&mut self) {
        if let Some(gauge) = self.gauge {
            self.last = gauge();
        }
    }

    /// What was done since the last reading was this stage of the present pass.
    pub(crate) fn mark(&mut self, stage: Stage) {
        let (Some(gauge), Some(lap)) = (self.gauge, self.timings.last_mut()) else { return };
        let now = gauge();
        for (sum, (now, last)) in lap.stages[stage as usize].iter_mut().zip(now.iter().zip(self.last)) {
            *sum += now - last;
        }
        self.last = now;
    }
}
