//! A whole rollout: settling, the motion, the loss, and the way back.

use std::ops::ControlFlow;

use powderline_shared::displacement::Displacement;
use powderline_shared::pose::Pose;

use crate::memory::{BRANCHES, Budget, default_min_checkpoints};
use crate::mpm::Model;
use crate::mpm::bodies::{Bodies, Moment};
use crate::mpm::contact::BodyStateBar;
use crate::mpm::particles::{Group, LANES, Particles, set_vec};
use crate::mpm::sort::EscapedParticle;
use crate::mpm::spare::{BufferPool, fit, state_bytes};
use crate::mpm::substep::{OnGrid, State, Workspace};
use crate::mpm::timings::{Stage, StageTimings};
use crate::real::Real;
use crate::rollout::branches::{self, Batch, Worker};
use crate::rollout::path::{PoseBar, Trajectory, resting};
use crate::rollout::restart::{Cut, CutReport, Restarted, Restarts, held_by_tool, shares};
use crate::rollout::schedule::{Action, advances, schedule};
use crate::rollout::{
    CostsFn, Destination, DisplacementGradient, Evaluation, LossFn, Observer, Recording, RolloutError,
    Simulate, SimulatorSettings, Snapshot, Tick, Watch, go_on, loss,
    outcome::{self, Grains},
    quiet, thread_pool,
};
use crate::scene::Scene;
use crate::skill::{Control, SkillMap, Theta, ThetaGradient};

/// Memory of each worker when there are several, in settled states: its current state, its workspace, its sort buffers, the layout
/// that a sort replaces and the one that it makes; twice as large once the powder has spread and lies on both sides of walls.
const WORKER_STATES: u64 = 10;

/// Work of one adjoint substep in units of a forward one, for the progress bar.
const ADJOINT_WORK: u64 = 3;

/// Control steps of a rollout that the gradient of one takes, for the progress bar.
const GRADIENT_STEPS: usize = 5;

/// Powder and tool at one moment of a motion that is made piece by piece: what comes next may depend on what the powder does. See
/// [`Simulator::begin`].
pub struct RolloutState<T: Real> {
    state: State<T>,
    tool: Pose,
    /// Substeps of the motion that are done.
    done: usize,
}

/// Simulator of one scene in one precision.
pub struct Simulator<T: Real> {
    scene: Scene,
    skill: SkillMap,
    anchor: Pose,
    model: Model<T>,
    workspace: Workspace<T>,
    /// Settled powder; computed by the first rollout.
    settled: Option<State<T>>,
    packing: Vec<[f64; 3]>,
    pool: rayon::ThreadPool,
    /// Workers for motions side by side; made when first needed.
    workers: Vec<Worker<T>>,
    budget: Budget,
    /// States to keep at most, whatever memory would allow.
    max_checkpoints: usize,
    watch: Watch,
}

/// A state on the way of a gradient.
struct Checkpoint<T> {
    /// The substep that begins there.
    step: usize,
    state: State<T>,
    /// What was on the grid in that substep, where the next state is kept too.
    on_grid: Option<OnGrid<T>>,
}

fn narrow(rows: Vec<[f64; 3]>) -> Vec<[f32; 3]> {
    rows.into_iter().map(|row| row.map(|x| x as f32)).collect()
}

impl<T: Real> RolloutState<T> {
    /// The tool.
    pub fn tool(&self) -> &Pose {
        &self.tool
    }

    /// Particles in the order of the packing, metres.
    pub fn positions_m(&self) -> Vec<[f32; 3]> {
        narrow(self.state.particles.positions_by_id())
    }

    /// Their velocities, m/s.
    pub fn velocities_m_s(&self) -> Vec<[f32; 3]> {
        narrow(self.state.particles.velocities_by_id())
    }

    /// Shows it to an observer.
    fn show(&self, step: usize, observer: Observer<'_>) -> ControlFlow<()> {
        observer(&Snapshot {
            step,
            tool: self.tool,
            positions_m: &self.positions_m(),
            velocities_m_s: &self.velocities_m_s(),
        })
    }

    /// Blocks whose powder sleeps.
    #[cfg(test)]
    pub(crate) fn sleepers(&self) -> usize {
        self.state.sleepers().filter(|asleep| *asleep).count()
    }

    /// Blocks of the grid that hold particles, and lanes of their groups, particles in them or not.
    pub(crate) fn blocks_and_lanes(&self) -> (usize, usize) {
        (self.state.layout.blocks.len(), self.state.particles.groups.len() * LANES)
    }
}

impl<T: Real> Simulator<T> {
    /// The simulator of a scene with the powder's state in numbers of this precision.
    ///
    /// # Errors
    /// [`RolloutError::Threads`] if the threads cannot be started.
    pub fn new(scene: &Scene, settings: &SimulatorSettings) -> Result<Self, RolloutError> {
        let pool = thread_pool(settings.thread_count())?;
        Ok(Self::with_packing(
            scene,
            scene.particle_positions_m(settings.seed_of(scene)),
            pool,
            settings.memory_bytes,
        ))
    }

    /// `memory_bytes` bounds what the whole process uses while a gradient is computed.
    pub(crate) fn with_packing(
        scene: &Scene,
        packing: Vec<[f64; 3]>,
        pool: rayon::ThreadPool,
        memory_bytes: u64,
    ) -> Self {
        let skill = SkillMap::new(scene);
        let budget = Budget::new::<T>(memory_bytes, scene, pool.current_num_threads());
        Self {
            scene: scene.clone(),
            anchor: *skill.start_pose(),
            skill,
            model: Model::new(scene),
            workspace: Workspace::new(),
            settled: None,
            packing,
            pool,
            workers: Vec::new(),
            budget,
            max_checkpoints: usize::MAX,
            watch: Watch::default(),
        }
    }

    /// The settled powder under a tool that waits at `anchor`, the scene's start pose as a rule
    /// ([`SkillMap::start_pose`]): the beginning of a motion that [`Self::advance`] makes piece by piece.
    ///
    /// # Errors
    /// See [`RolloutError`].
    pub fn begin(&mut self, anchor: &Pose) -> Result<RolloutState<T>, RolloutError> {
        self.watched(|s, tick| s.initial_state_under(anchor, tick))
    }

    /// Makes these control steps. In pieces a motion comes to the same bits as whole.
    ///
    /// # Errors
    /// See [`RolloutError`]; the state is as it was then. Control steps are counted from the beginning of the motion.
    pub fn advance(
        &mut self,
        state: &mut RolloutState<T>,
        controls: &[Displacement],
    ) -> Result<(), RolloutError> {
        let steps = state.done / self.scene.time.substeps as usize;
        let next = self.watched(|s, tick| s.advanced(state, controls, tick));
        let next = next.map_err(|error| error.later_by(steps))?;
        self.recycle(std::mem::replace(state, next));
        Ok(())
    }

    /// Keeps no more states than this at a time while a gradient is computed, even if memory would allow more.
    pub(crate) fn set_max_checkpoints(&mut self, states: usize) {
        self.max_checkpoints = states;
    }

    /// What each stage of the substeps to come takes.
    pub(crate) fn timings(&mut self) -> &mut StageTimings {
        &mut self.workspace.timings
    }

    /// Runs some stages in isolation, to time them.
    pub(crate) fn alone(&mut self, state: &RolloutState<T>) -> Result<(), RolloutError> {
        let lost = |r: &Rollout<'_, T>, lost| lost_error(r.scene, 0, lost, Some(&state.state));
        let job = |r: &mut Rollout<'_, T>| {
            let bodies = r.at_rest(&state.tool);
            r.workspace.alone(r.model, &bodies, &state.state).map_err(|l| lost(r, l))
        };
        self.in_pool(job, &mut quiet)
    }

    fn path(&self, from: &RolloutState<T>, controls: Vec<Displacement>) -> Result<Trajectory, RolloutError> {
        let time = &self.scene.time;
        let path = Trajectory::new(from.done, from.tool, controls, time.substeps, time.control_period_s());
        match path.first_not_finite() {
            None => Ok(path),
            Some(step) => Err(RolloutError::Motion { step: step as u32 }),
        }
    }

    /// The settled powder under the tool's start pose.
    pub(crate) fn initial_state(&mut self, progress: Tick<'_>) -> Result<RolloutState<T>, RolloutError> {
        let tool = self.anchor;
        Ok(RolloutState { state: self.in_pool(|r| r.settled(), progress)?, tool, done: 0 })
    }

    /// The settled powder under a tool that waits at `tool`.
    fn initial_state_under(
        &mut self,
        tool: &Pose,
        progress: Tick<'_>,
    ) -> Result<RolloutState<T>, RolloutError> {
        if *tool == self.anchor {
            return self.initial_state(progress);
        }
        let state = self.in_pool(|r| r.settle_under(tool), progress)?;
        Ok(RolloutState { state, tool: *tool, done: 0 })
    }

    /// The state after the given controls.
    pub(crate) fn advanced(
        &mut self,
        from: &RolloutState<T>,
        controls: &[Displacement],
        progress: Tick<'_>,
    ) -> Result<RolloutState<T>, RolloutError> {
        let path = self.path(from, controls.to_vec())?;
        let state = self.in_pool(|r| r.forward(&from.state, &path), progress)?;
        Ok(RolloutState { state, tool: path.end().unwrap_or(from.tool), done: path.ends_after() })
    }

    /// Takes the memory of a state that is no longer needed.
    fn recycle(&mut self, state: RolloutState<T>) {
        state.state.recycle_into(&mut self.workspace.spare);
    }

    /// What has been achieved if the motion ends here.
    pub fn judge(&self, state: &RolloutState<T>) -> Evaluation {
        evaluation(&self.scene, &state.state.particles, &state.tool).0
    }

    /// Evaluation after the given controls, and the loss's cotangents of the controls.
    pub(crate) fn control_gradient(
        &mut self,
        from: &RolloutState<T>,
        controls: &[Displacement],
        progress: Tick<'_>,
    ) -> Result<(Evaluation, Vec<Control>), RolloutError> {
        let (evaluation, bars, _) = self.control_gradient_of(Asked::default(), from, controls, progress)?;
        Ok((evaluation, bars))
    }

    /// The same of another loss, or by another adjoint.
    fn control_gradient_of(
        &mut self,
        asked: Asked<'_>,
        from: &RolloutState<T>,
        controls: &[Displacement],
        progress: Tick<'_>,
    ) -> Result<(Evaluation, Vec<Control>, Vec<CutReport>), RolloutError> {
        let path = self.path(from, controls.to_vec())?;
        let reserved_bytes = self.bytes_of_workers_to_come();
        self.in_pool_for(asked, |r| r.gradient(&from.state, &path, reserved_bytes), progress)
    }

    /// The same by the adjoint that restarts. On the part of the motion on which the tool carries powder there is none: there, tool and
    /// powder are one body, and what moving it costs is measured.
    fn restarted(
        &mut self,
        start: &RolloutState<T>,
        controls: &[Displacement],
        (restarts, costs): (&Restarts, Option<CostsFn<'_>>),
        progress: Tick<'_>,
    ) -> Result<(Evaluation, Vec<Control>, Vec<CutReport>), RolloutError> {
        let asked = Asked { restarts: Some(restarts), costs, ..Asked::default() };
        let Some(carrying) = restarts.carrying.as_ref().filter(|carrying| carrying.fits(controls.len()))
        else {
            return self.control_gradient_of(asked, start, controls, progress);
        };
        let (from, over, steps) = (carrying.from, &carrying.over, controls.len());
        // In control steps of a rollout.
        let branched = 2 * carrying.ways.len() * (steps - over.start);
        let total = (steps + branched + GRADIENT_STEPS * from) as u64;
        let mut part = |before: usize, work: usize, done: u64, of: u64| {
            progress(before as u64 * 1000 + work as u64 * 1000 * done / of.max(1), total * 1000)
        };
        let before = self.advanced(start, &controls[..over.start], &mut |d, t| part(0, over.start, d, t))?;
        let mut on_body = vec![self.on_tool(&before, restarts)];
        let mut end = self.copied(&before);
        for step in over.start..steps {
            let next = self.advanced(&end, &controls[step..=step], &mut |d, t| part(step, 1, d, t));
            let next = next.map_err(|error| error.later_by(step))?;
            self.recycle(std::mem::replace(&mut end, next));
            on_body.push(self.on_tool(&end, restarts));
        }
        let (evaluation, values) = judged(&self.scene, &end.state.particles, &end.tool, costs);
        self.recycle(end);
        let rest = |way: &Displacement, sign: f64| carrying.moved(controls, way, sign)[over.start..].to_vec();
        let branches = carrying.ways.iter().flat_map(|way| [rest(way, 1.0), rest(way, -1.0)]).collect();
        let model = self.model.with_sleep_speed(carrying.sleep_speed_m_s);
        let ends = self.evaluate_motions_by((Some(&model), costs), &before, branches, &mut |d, t| {
            part(steps, branched, d, t)
        });
        self.recycle(before);
        let ends = ends.map_err(|error| error.later_by(over.start))?;
        let ends: Vec<[f64; 2]> = ends.chunks_exact(2).map(|ends| [ends[0].loss, ends[1].loss]).collect();
        let body = carrying.body(&ends);
        let asked = Asked { goes_on: Some(GoesOn { values: &values, body }), ..asked };
        let work = GRADIENT_STEPS * from;
        let digging = self.control_gradient_of(asked, start, &controls[..from], &mut |d, t| {
            part(steps + branched, work, d, t)
        });
        let (_, mut bars, cuts) = digging?;
        bars.extend(carrying.controls(&body, &shares(&on_body), steps));
        Ok((evaluation, bars, cuts))
    }

    /// Grains on the tool.
    fn on_tool(&self, at: &RolloutState<T>, restarts: &Restarts) -> u32 {
        let positions = at.state.particles.positions_by_id();
        held_by_tool(&self.scene, &at.tool, &positions, restarts.room_m)
    }

    fn copied(&mut self, from: &RolloutState<T>) -> RolloutState<T> {
        RolloutState { state: from.state.copied(&mut self.workspace.spare), ..*from }
    }

    /// Evaluations after each of several control sequences of one length, side by side.
    pub(crate) fn evaluate_motions(
        &mut self,
        from: &RolloutState<T>,
        motions: Vec<Vec<Displacement>>,
        progress: Tick<'_>,
    ) -> Result<Vec<Evaluation>, RolloutError> {
        self.evaluate_motions_by((None, None), from, motions, progress)
    }

    /// The same by another model of the powder and another loss, if there are such.
    fn evaluate_motions_by(
        &mut self,
        (other, costs): (Option<&Model<T>>, Option<CostsFn<'_>>),
        from: &RolloutState<T>,
        motions: Vec<Vec<Displacement>>,
        progress: Tick<'_>,
    ) -> Result<Vec<Evaluation>, RolloutError> {
        if motions.is_empty() {
            return Ok(Vec::new());
        }
        let first = motions[0].len();
        if let Some(other) = motions.iter().map(Vec::len).find(|other| *other != first) {
            return Err(RolloutError::Lengths { first, other });
        }
        let paths = motions.into_iter().map(|controls| self.path(from, controls));
        let paths: Vec<Trajectory> = paths.collect::<Result<_, _>>()?;
        let count = self.worker_count(paths.len());
        self.ensure_workers(count)?;
        let Self { scene, model, pool, workspace, workers, .. } = self;
        let model = other.unwrap_or(model);
        let start = from.state.copied(&mut workspace.spare);
        let lost = |substep, lost, state: &State<T>| lost_error(scene, substep, lost, Some(state));
        let judge = |path: &Trajectory, state: &State<T>| {
            let tool = path.end().unwrap_or(from.tool);
            let (mut found, _) = evaluation(scene, &state.particles, &tool);
            if let Some(costs) = costs {
                let positions = state.particles.positions_by_id();
                found.loss = costs(&positions, &mut vec![0.0; positions.len()]);
            }
            found
        };
        let batch = Batch { model, paths: &paths, lost: &lost, judge: &judge };
        let mut spare = std::mem::replace(&mut workspace.spare, BufferPool::empty());
        let all = workers.iter_mut().map(|worker| (&worker.pool, &mut worker.workspace));
        let workers = if count == 1 { vec![(&*pool, &mut *workspace)] } else { all.collect() };
        let evaluations = branches::run(&batch, start, workers, &mut spare, progress);
        workspace.spare = spare;
        evaluations
    }

    /// Workers for so many motions, bounded by threads and memory. A function of its inputs alone, since the budget has
    /// already set their memory aside.
    fn worker_count(&self, motions: usize) -> usize {
        let per_worker = self.settled.as_ref().map_or(0, |state| state.bytes(&self.model)) * WORKER_STATES;
        branches::worker_count(
            self.pool.current_num_threads(),
            motions,
            self.budget.for_workers(),
            per_worker,
        )
    }

    /// Gets so many workers. They and their threads stay: what one thread frees, the allocator keeps for that thread.
    fn ensure_workers(&mut self, workers: usize) -> Result<(), RolloutError> {
        if workers > 1 && self.workers.len() != workers {
            let threads = self.pool.current_num_threads() / workers;
            self.workers.clear();
            self.workers = (0..workers).map(|_| Worker::new(threads)).collect::<Result<_, _>>()?;
        }
        Ok(())
    }

    /// What workers will hold that are not there yet.
    fn bytes_of_workers_to_come(&self) -> u64 {
        let per_worker = self.settled.as_ref().map_or(0, |state| state.bytes(&self.model)) * WORKER_STATES;
        let workers = self.worker_count(BRANCHES as usize);
        if workers == 1 { 0 } else { workers.saturating_sub(self.workers.len()) as u64 * per_worker }
    }

    /// Runs in the simulator's own threads.
    fn in_pool<R: Send>(
        &mut self,
        job: impl FnOnce(&mut Rollout<'_, T>) -> R + Send,
        progress: Tick<'_>,
    ) -> R {
        self.in_pool_for(Asked::default(), job, progress)
    }

    /// The same for a gradient.
    fn in_pool_for<R: Send>(
        &mut self,
        asked: Asked<'_>,
        job: impl FnOnce(&mut Rollout<'_, T>) -> R + Send,
        progress: Tick<'_>,
    ) -> R {
        let mut rollout = Rollout {
            scene: &self.scene,
            anchor: &self.anchor,
            model: &self.model,
            workspace: &mut self.workspace,
            settled: &mut self.settled,
            budget: &self.budget,
            packing: &self.packing,
            max_checkpoints: self.max_checkpoints,
            asked,
            progress,
        };
        in_first(&self.pool, || job(&mut rollout))
    }
}

impl<T: Real> Simulator<T> {
    /// Does something whose progress is told.
    pub(crate) fn watched<R>(&mut self, job: impl FnOnce(&mut Self, Tick<'_>) -> R) -> R {
        let mut watch = std::mem::take(&mut self.watch);
        let found = job(self, &mut |done, total| watch.tell(done, total));
        self.watch = watch;
        found
    }

    fn gradient(
        &mut self,
        controls: &[Displacement],
        asked: Asked<'_>,
    ) -> Result<(Evaluation, Vec<DisplacementGradient>), RolloutError> {
        self.watched(|s, tick| {
            let start = s.initial_state(tick)?;
            let found = s.control_gradient_of(asked, &start, controls, tick);
            s.recycle(start);
            found.map(|(evaluation, bars, _)| (evaluation, by_displacement(bars)))
        })
    }

    fn restarted_gradient(
        &mut self,
        controls: &[Displacement],
        restarts: &Restarts,
        costs: Option<CostsFn<'_>>,
    ) -> Result<(Evaluation, Vec<DisplacementGradient>, Vec<CutReport>), RolloutError> {
        self.watched(|s, tick| {
            let start = s.initial_state(tick)?;
            let found = s.restarted(&start, controls, (restarts, costs), tick);
            s.recycle(start);
            found.map(|(evaluation, bars, cuts)| (evaluation, by_displacement(bars), cuts))
        })
    }

    fn recorded(
        &mut self,
        recording: &Recording<'_>,
        observer: Observer<'_>,
        progress: Tick<'_>,
    ) -> Result<(Evaluation, Vec<Destination>), RolloutError> {
        let mut state = self.initial_state_under(recording.anchor, progress)?;
        let (total, mut step) = (recording.controls.len(), 0);
        let mut shown = recording.controls.chunks(recording.every.max(1)).peekable();
        // In thousandths of a control step.
        let mut part = |before: usize, steps: usize, done: u64, of: u64| {
            progress(before as u64 * 1000 + steps as u64 * 1000 * done / of.max(1), total as u64 * 1000)
        };
        loop {
            go_on(state.show(step, observer))?;
            // What is left after the last snapshot belongs to the motion all the same.
            let whole = shown.next_if(|controls| controls.len() == recording.every.max(1));
            let Some(controls) = whole else { break };
            let next = self.advanced(&state, controls, &mut |d, t| part(step, controls.len(), d, t));
            self.recycle(std::mem::replace(&mut state, next.map_err(|error| error.later_by(step))?));
            step += controls.len();
        }
        let left = &recording.controls[step..];
        let end = self.advanced(&state, left, &mut |d, t| part(step, left.len(), d, t));
        let end = end.map_err(|error| error.later_by(step))?;
        let (positions, velocities) = where_and_how_fast(&end.state.particles);
        let grains = Grains { positions: &positions, velocities: &velocities };
        Ok((self.judge(&end), outcome::destinations(&self.scene, grains, &end.tool)))
    }
}

fn by_displacement(bars: Vec<Control>) -> Vec<DisplacementGradient> {
    bars.into_iter().map(DisplacementGradient::from).collect()
}

impl<T: Real> Simulate for Simulator<T> {
    fn watch(&mut self) -> &mut Watch {
        &mut self.watch
    }

    fn evaluate(&mut self, theta: &Theta) -> Result<Evaluation, RolloutError> {
        let controls: Vec<_> = self.skill.controls(theta)?;
        self.simulate(&controls)
    }

    fn evaluate_all(&mut self, thetas: &[Theta]) -> Result<Vec<Evaluation>, RolloutError> {
        let controls = |theta: &Theta| -> Result<Vec<_>, RolloutError> { Ok(self.skill.controls(theta)?) };
        let motions: Vec<_> = thetas.iter().map(controls).collect::<Result<_, _>>()?;
        self.simulate_all(&motions)
    }

    fn evaluate_with_gradient(&mut self, theta: &Theta) -> Result<(Evaluation, ThetaGradient), RolloutError> {
        let linear = self.skill.linearise(theta)?;
        let (evaluation, gradient) = self.gradient(&linear.controls, Asked::default())?;
        Ok((evaluation, linear.pull_back(&gradient)))
    }

    fn evaluate_restarted(&mut self, theta: &Theta, restarts: &Restarts) -> Result<Restarted, RolloutError> {
        let linear = self.skill.linearise(theta)?;
        let (evaluation, by_displacement, mut cuts) =
            self.restarted_gradient(&linear.controls, restarts, None)?;
        let gradient = linear.pull_back(&by_displacement);
        cuts.reverse();
        let steps = cuts.iter().map(|cut| cut.step);
        let all = by_displacement.len();
        let ends: Vec<usize> = std::iter::once(0).chain(steps).chain([all]).collect();
        let share = |ends: &[usize]| {
            let mut share = vec![DisplacementGradient::default(); all];
            share[ends[0]..ends[1]].copy_from_slice(&by_displacement[ends[0]..ends[1]]);
            linear.pull_back(&share)
        };
        let shares = ends.windows(2).map(share).collect();
        Ok(Restarted { evaluation, gradient, cuts, shares, by_displacement })
    }

    fn simulate(&mut self, controls: &[Displacement]) -> Result<Evaluation, RolloutError> {
        let anchor = self.anchor;
        self.simulate_from(&anchor, controls)
    }

    fn simulate_all(&mut self, motions: &[Vec<Displacement>]) -> Result<Vec<Evaluation>, RolloutError> {
        self.watched(|s, tick| {
            let start = s.initial_state(tick)?;
            let evaluations = s.evaluate_motions(&start, motions.to_vec(), tick);
            s.recycle(start);
            evaluations
        })
    }

    fn simulate_from(
        &mut self,
        anchor: &Pose,
        controls: &[Displacement],
    ) -> Result<Evaluation, RolloutError> {
        let end = self.watched(|s, tick| {
            let start = s.initial_state_under(anchor, tick)?;
            let end = s.advanced(&start, controls, tick);
            s.recycle(start);
            end
        })?;
        let evaluation = self.judge(&end);
        self.recycle(end);
        Ok(evaluation)
    }

    fn simulate_with_gradient(
        &mut self,
        controls: &[Displacement],
    ) -> Result<(Evaluation, Vec<DisplacementGradient>), RolloutError> {
        self.gradient(controls, Asked::default())
    }

    fn simulate_restarted(
        &mut self,
        controls: &[Displacement],
        restarts: &Restarts,
    ) -> Result<(Evaluation, Vec<DisplacementGradient>), RolloutError> {
        let (evaluation, gradient, _) = self.restarted_gradient(controls, restarts, None)?;
        Ok((evaluation, gradient))
    }

    fn gradient_of_custom_loss(
        &mut self,
        controls: &[Displacement],
        loss: LossFn<'_>,
    ) -> Result<(f64, Vec<DisplacementGradient>), RolloutError> {
        let (evaluation, gradient) =
            self.gradient(controls, Asked { loss: Some(loss), ..Asked::default() })?;
        Ok((evaluation.loss, gradient))
    }

    fn restarted_gradient_of_custom_loss(
        &mut self,
        controls: &[Displacement],
        costs: CostsFn<'_>,
        restarts: &Restarts,
    ) -> Result<(f64, Vec<DisplacementGradient>), RolloutError> {
        let (evaluation, gradient, _) = self.restarted_gradient(controls, restarts, Some(costs))?;
        Ok((evaluation.loss, gradient))
    }

    fn final_positions_m(&mut self, controls: &[Displacement]) -> Result<Vec<[f64; 3]>, RolloutError> {
        self.watched(|s, tick| {
            let start = s.initial_state(tick)?;
            Ok(s.advanced(&start, controls, tick)?.state.particles.positions_by_id())
        })
    }

    fn record(
        &mut self,
        recording: &Recording<'_>,
        observer: Observer<'_>,
    ) -> Result<(Evaluation, Vec<Destination>), RolloutError> {
        self.watched(|s, tick| s.recorded(recording, observer, tick))
    }
}

/// What the particles have achieved, and the derivative of the loss with respect to their positions.
fn evaluation<T: Real>(scene: &Scene, particles: &Particles<T>, tool: &Pose) -> (Evaluation, Vec<[f64; 3]>) {
    let (positions, velocities) = where_and_how_fast(particles);
    let (loss, gradient) = loss::loss(scene, &positions);
    let census = outcome::census(scene, Grains { positions: &positions, velocities: &velocities }, tool);
    let indicator = scene.target_count() as i64 - i64::from(census.target);
    (Evaluation { loss, indicator, census }, gradient)
}

/// Positions (m) and velocities (m/s), by identity.
fn where_and_how_fast<T: Real>(particles: &Particles<T>) -> (Vec<[f64; 3]>, Vec<[f64; 3]>) {
    (particles.positions_by_id(), particles.velocities_by_id())
}

/// What became of a particle that the grid cannot hold.
fn lost_error<T: Real>(
    scene: &Scene,
    substep: usize,
    lost: EscapedParticle,
    state: Option<&State<T>>,
) -> RolloutError {
    let n = scene.time.substeps as usize;
    let (step, substep) = ((substep / n) as u32, (substep % n) as u32);
    let finite = state.is_none_or(|s| {
        s.particles
            .occupied()
            .find(|(_, _, id)| *id == lost.particle)
            .is_none_or(|(g, l, _)| s.particles.groups[g].rows().all(|row| row[l].is_finite()))
    });
    if finite {
        RolloutError::Escaped { step, substep, particle: lost.particle }
    } else {
        RolloutError::NonFinite { stage: "grid to particle", step, substep, particle: lost.particle }
    }
}

/// What was achieved, and what each particle costs, metres, by identity: by the scene's loss or another one.
fn judged<T: Real>(
    scene: &Scene,
    particles: &Particles<T>,
    tool: &Pose,
    costs: Option<CostsFn<'_>>,
) -> (Evaluation, Vec<Option<f64>>) {
    let positions = particles.positions_by_id();
    let (mut found, _) = evaluation(scene, particles, tool);
    let Some(costs) = costs else { return (found, loss::values(scene, &positions)) };
    let mut values = vec![0.0; positions.len()];
    found.loss = costs(&positions, &mut values);
    (found, values.into_iter().map(Some).collect())
}

/// Borrowed parts of a simulator during one rollout.
struct Rollout<'a, T: Real> {
    scene: &'a Scene,
    anchor: &'a Pose,
    model: &'a Model<T>,
    workspace: &'a mut Workspace<T>,
    settled: &'a mut Option<State<T>>,
    budget: &'a Budget,
    packing: &'a [[f64; 3]],
    max_checkpoints: usize,
    asked: Asked<'a>,
    progress: Tick<'a>,
}

/// What a gradient is asked for, if it is not the scene's loss and the exact adjoint.
#[derive(Clone, Copy, Default)]
struct Asked<'a> {
    loss: Option<LossFn<'a>>,
    restarts: Option<&'a Restarts>,
    costs: Option<CostsFn<'a>>,
    goes_on: Option<GoesOn<'a>>,
}

/// What is known of the motion after the part that is to be gone back through.
#[derive(Clone, Copy)]
struct GoesOn<'a> {
    /// What each grain costs at the end, by identity, metres.
    values: &'a [Option<f64>],
    /// What the pose of tool and powder, as one body, has.
    body: PoseBar,
}

/// Where the way back has got to.
struct Retreat<T> {
    evaluation: Evaluation,
    /// What each grain costs at the end, by identity, metres; empty if nobody asks.
    values: Vec<Option<f64>>,
    /// Cotangents of the particles.
    bar: Vec<Group<T>>,
    /// That of the tool's pose to go on with.
    pose: PoseBar,
    /// What happened at the cuts, the last one first.
    cuts: Vec<CutReport>,
}

impl<T: Real> Rollout<'_, T> {
    fn report(&mut self, done: u64, total: u64) -> Result<(), RolloutError> {
        go_on((self.progress)(done, total))
    }

    /// The powder at rest under the tool's start pose.
    fn settled(&mut self) -> Result<State<T>, RolloutError> {
        let state = match self.settled.take() {
            Some(state) => state,
            None => self.settle_under(self.anchor)?,
        };
        let copy = state.copied(&mut self.workspace.spare);
        *self.settled = Some(state);
        Ok(copy)
    }

    /// The powder at rest under a tool that stands still.
    fn settle_under(&mut self, tool: &Pose) -> Result<State<T>, RolloutError> {
        self.settled_powder_under(tool).map_err(|error| match error {
            error if error.is_of_motion() => RolloutError::Settling(Box::new(error)),
            error => error,
        })
    }

    fn settled_powder_under(&mut self, tool: &Pose) -> Result<State<T>, RolloutError> {
        let (particles, bodies) = (Particles::at_rest(self.packing), self.at_rest(tool));
        let mut state = State::new(self.model, &bodies, &particles)
            .map_err(|l| lost_error::<T>(self.scene, 0, l, None))?;
        let per_step = self.scene.time.substeps as usize;
        for substep in 0..self.scene.time.settle_steps() as usize * per_step {
            if substep.is_multiple_of(per_step) {
                // Only to ask whether to go on: the rollout's own work is counted from its beginning.
                self.report(0, 1)?;
            }
            self.step(&mut state, substep, &bodies)?;
        }
        Ok(state)
    }

    /// A tool that stands still, and the gates before the motion.
    fn at_rest(&self, tool: &Pose) -> Bodies<T> {
        Bodies { tool: resting(tool), gates: self.model.gates.at(Moment::Settling) }
    }

    fn step(&mut self, state: &mut State<T>, substep: usize, bodies: &Bodies<T>) -> Result<(), RolloutError> {
        match self.workspace.substep(self.model, bodies, state) {
            Ok(()) => Ok(()),
            Err(lost) => Err(lost_error(self.scene, substep, lost, Some(state))),
        }
    }

    fn step_to(
        &mut self,
        from: &State<T>,
        substep: usize,
        bodies: &Bodies<T>,
        to: &mut State<T>,
    ) -> Result<(), RolloutError> {
        let advanced = self.workspace.substep_to(self.model, bodies, from, to);
        advanced.map_err(|lost| lost_error(self.scene, substep, lost, Some(to)))
    }

    fn forward(&mut self, start: &State<T>, path: &Trajectory) -> Result<State<T>, RolloutError> {
        let mut state = start.copied(&mut self.workspace.spare);
        let total = path.len() as u64;
        for substep in 0..path.len() {
            if substep.is_multiple_of(self.scene.time.substeps as usize) {
                self.report(substep as u64, total)?;
            }
            self.step(&mut state, substep, &path.bodies(&self.model.gates, substep))?;
        }
        self.report(total, total)?;
        Ok(state)
    }

    /// `reserved_bytes` are left for what comes later.
    fn gradient(
        &mut self,
        start: &State<T>,
        path: &Trajectory,
        reserved_bytes: u64,
    ) -> Result<(Evaluation, Vec<Control>, Vec<CutReport>), RolloutError> {
        self.workspace.prepare(self.model, start);
        // The state at work is the last one kept, until it is advanced: then it is `working`.
        let copy = start.copied(&mut self.workspace.spare);
        let mut kept = vec![Checkpoint { step: 0, state: copy, on_grid: None }];
        let mut working = start.copied(&mut self.workspace.spare);
        let slots = self.slots(&kept, path, reserved_bytes);
        let total = advances(schedule(path.len(), slots)) + ADJOINT_WORK * path.len() as u64;
        let mut done = 0;
        let mut back = path.pull_back();
        let mut end: Option<Retreat<T>> = None;
        let lacks_residue = self.asked.restarts.is_some_and(|restarts| !restarts.through_residue);
        let without_residue = lacks_residue.then(|| self.model.without_residue());
        let model_back = without_residue.as_ref().unwrap_or(self.model);
        let (mut at, mut is_kept) = (0, true);
        let mut schedule = schedule(path.len(), slots);
        while let Some(action) = schedule.next() {
            let last = kept.last_mut().expect("the schedule keeps the first state");
            match action {
                Action::Restore => (at, is_kept) = (last.step, true),
                Action::Advance(count) => {
                    for _ in 0..count {
                        let bodies = path.bodies(&self.model.gates, at);
                        if is_kept {
                            self.step_to(&last.state, at, &bodies, &mut working)?;
                        } else {
                            self.step(&mut working, at, &bodies)?;
                        }
                        (at, is_kept) = (at + 1, false);
                        done += 1;
                        self.report(done.min(total), total)?;
                    }
                }
                Action::Store => {
                    if last.step + 1 == at {
                        last.on_grid = Some(std::mem::replace(&mut self.workspace.on_grid, OnGrid::empty()));
                    }
                    let state = std::mem::replace(&mut working, State::empty());
                    kept.push(Checkpoint { step: at, state, on_grid: None });
                    is_kept = true;
                    schedule.limit(self.slots(&kept, path, reserved_bytes));
                }
                Action::Discard => kept.pop().into_iter().for_each(|kept| self.recycle_checkpoint(kept)),
                Action::Adjoint(step) => {
                    let (state, grid) =
                        if is_kept { (&last.state, last.on_grid.as_ref()) } else { (&working, None) };
                    let mut retreat = match end.take() {
                        Some(end) => end,
                        None => {
                            let end = self.end_of(path, state)?;
                            back.go_on_with(&end.pose);
                            end
                        }
                    };
                    let bar = &mut retreat.bar;
                    let bodies = path.bodies(&self.model.gates, step);
                    let tool_bar = self.workspace.substep_adjoint(model_back, &bodies, state, grid, bar);
                    self.check_finite(step, &tool_bar, state, bar)?;
                    back.take(step, tool_bar);
                    self.workspace.timings.skip();
                    if self.restarts_before(step) {
                        retreat.pose = back.pose_bar();
                        self.restart(path, step, state, &mut retreat, false);
                        back.go_on_with(&retreat.pose);
                    }
                    self.workspace.sort_adjoint(state, &mut retreat.bar);
                    end = Some(retreat);
                    self.workspace.timings.mark(Stage::SortAdjoint);
                    done += ADJOINT_WORK;
                    self.report(done.min(total), total)?;
                }
            }
        }
        let Retreat { evaluation, bar, cuts, .. } = match end {
            Some(end) => end,
            // A motion of no step ends where it began.
            None => self.end_of(path, &kept[0].state)?,
        };
        self.workspace.bar = bar;
        working.recycle_into(&mut self.workspace.spare);
        kept.into_iter().for_each(|kept| self.recycle_checkpoint(kept));
        Ok((evaluation, back.finished(), cuts))
    }

    /// States that may be kept at a time, those that are kept among them: as many as memory allows if the next ones are as large as
    /// the last one, and enough for an end in reasonable time.
    fn slots(&self, kept: &[Checkpoint<T>], path: &Trajectory, reserved_bytes: u64) -> usize {
        let spare = &self.workspace.spare;
        let size = kept[kept.len() - 1].state.size(self.model);
        let in_states = spare.bytes() + kept.len() as u64 * state_bytes::<T>(size);
        let left = self.budget.left(in_states).saturating_sub(reserved_bytes);
        let more = spare.states(size, left);
        // One of them is for the state at work, which may grow.
        (kept.len() + more.saturating_sub(1))
            .max(default_min_checkpoints(path.len()))
            .min(self.max_checkpoints)
    }

    fn recycle_checkpoint(&mut self, kept: Checkpoint<T>) {
        kept.state.recycle_into(&mut self.workspace.spare);
        kept.on_grid.into_iter().for_each(|grid| grid.recycle_into(&mut self.workspace.spare));
    }

    /// Whether the adjoint restarts where this substep begins.
    fn restarts_before(&self, substep: usize) -> bool {
        let n = self.scene.time.substeps as usize;
        let asked = |restarts: &Restarts| restarts.steps.contains(&(substep / n));
        substep > 0 && substep.is_multiple_of(n) && self.asked.restarts.is_some_and(asked)
    }

    /// Restarts the adjoint; `state` is that at the beginning of the substep, whose order the cotangents have. The pose's cotangent is
    /// that of the tool, or of tool and powder as one `body`.
    fn restart(
        &mut self,
        path: &Trajectory,
        substep: usize,
        state: &State<T>,
        retreat: &mut Retreat<T>,
        body: bool,
    ) {
        let Some(restarts) = self.asked.restarts else { return };
        let mut state = state.copied(&mut self.workspace.spare);
        state.fill();
        let step = substep / self.scene.time.substeps as usize;
        let cut = Cut {
            scene: self.scene,
            model: self.model,
            bodies: &path.bodies(&self.model.gates, substep - 1),
            tool: path.pose_before(step),
            step,
            restarts,
        };
        let pose = (&retreat.pose, body);
        let (pose, report) = cut.restart(&state.particles, &retreat.values, &mut retreat.bar, pose);
        retreat.pose = pose;
        retreat.cuts.push(report);
        state.recycle_into(&mut self.workspace.spare);
    }

    /// Last step, loss, and the loss's cotangent in the order of the last step's particles; or, where the motion goes on, what is
    /// known of that.
    fn end_of(&mut self, path: &Trajectory, state: &State<T>) -> Result<Retreat<T>, RolloutError> {
        let mut state = state.copied(&mut self.workspace.spare);
        state.fill();
        if let Some(last) = path.len().checked_sub(1) {
            self.step(&mut state, last, &path.bodies(&self.model.gates, last))?;
        }
        let mut retreat = self.loss_of(path, &state);
        if let Some(GoesOn { values, body }) = self.asked.goes_on {
            (retreat.values, retreat.pose) = (values.to_vec(), body);
            self.restart(path, path.len(), &state, &mut retreat, true);
        }
        self.workspace.sort_adjoint(&state, &mut retreat.bar);
        state.recycle_into(&mut self.workspace.spare);
        Ok(retreat)
    }

    /// Loss at the end, and the cotangents of particles there.
    fn loss_of(&mut self, path: &Trajectory, state: &State<T>) -> Retreat<T> {
        let (mut evaluation, mut gradient) =
            evaluation(self.scene, &state.particles, &path.end().unwrap_or(*self.anchor));
        if let Some(loss) = self.asked.loss {
            let positions = state.particles.positions_by_id();
            gradient = vec![[0.0; 3]; positions.len()];
            evaluation.loss = loss(&positions, &mut gradient);
        }
        let mut values = Vec::new();
        if let Some(costs) = self.asked.costs.filter(|_| self.asked.goes_on.is_none()) {
            let tool = path.end().unwrap_or(*self.anchor);
            (evaluation, values) = judged(self.scene, &state.particles, &tool, Some(costs));
        } else if self.asked.restarts.is_some() {
            values = loss::values(self.scene, &state.particles.positions_by_id());
        }
        if let (Some(restarts), Some(tool)) = (self.asked.restarts, path.end())
            && (restarts.begins_with_slopes || self.asked.costs.is_some())
        {
            let bodies = &path.bodies(&self.model.gates, path.len() - 1);
            let cut =
                Cut { scene: self.scene, model: self.model, bodies, tool, step: path.steps(), restarts };
            gradient = cut.slopes(&state.particles.positions_by_id(), &values);
        }
        let mut bar = std::mem::take(&mut self.workspace.bar);
        fit(&mut bar, state.particles.groups.len(), Group::ZERO);
        bar.fill(Group::ZERO);
        for (g, l, id) in state.particles.occupied() {
            set_vec(&mut bar[g].x, l, gradient[id as usize].map(T::from_f64));
        }
        Retreat { evaluation, values, bar, pose: PoseBar::default(), cuts: Vec::new() }
    }

    /// Particles are searched once per control step, and whenever the tool's cotangent, a sum over all contacts, is not finite.
    fn check_finite(
        &self,
        step: usize,
        tool: &BodyStateBar,
        state: &State<T>,
        bar: &[Group<T>],
    ) -> Result<(), RolloutError> {
        let n = self.scene.time.substeps as usize;
        let tool_finite = tool.position.iter().chain(&tool.rotation).all(|x| x.is_finite());
        if tool_finite && !step.is_multiple_of(n) {
            return Ok(());
        }
        for (g, l, particle) in state.particles.occupied() {
            if !bar[g].rows().all(|row| row[l].is_finite()) {
                let (step, substep) = ((step / n) as u32, (step % n) as u32);
                return Err(RolloutError::NonFinite { stage: "the adjoint", step, substep, particle });
            }
        }
        Ok(())
    }
}

/// Runs in the first thread of a pool. What one thread frees, the allocator keeps for that thread: by `install`, which takes any
/// thread, runs of `bench-small` within 64 MiB peaked at 60 to 69 MiB with two threads and at 70 to 74 MiB with eight; by this at
/// 59 to 60 MiB and at 61 to 62 MiB.
fn in_first<R: Send>(pool: &rayon::ThreadPool, job: impl FnOnce() -> R + Send) -> R {
    let job = std::sync::Mutex::new(Some(job));
    let take = || job.lock().unwrap_or_else(std::sync::PoisonError::into_inner).take();
    let results = pool.broadcast(|thread| if thread.index() == 0 { take().map(|job| job()) } else { None });
    results.into_iter().flatten().next().expect("every pool has a first thread")
}
