//! A whole rollout: settling, the motion, the loss, and the way back.

use powderline_shared::displacement::Displacement;
use powderline_shared::pose::Pose;

use crate::memory::{BRANCHES, STANDING_STATES, fixed_bytes, grown};
use crate::mpm::Model;
use crate::mpm::contact::MotionBar;
use crate::mpm::laps::{Laps, Stage};
use crate::mpm::layout::Lost;
use crate::mpm::particles::{Group, LANES, Particles, set_vec};
use crate::mpm::substep::{OnGrid, State, Workspace, unsort_bar};
use crate::real::Real;
use crate::rollout::branches::{self, Family};
use crate::rollout::path::{Path, resting};
use crate::rollout::schedule::{Action, advances, schedule};
use crate::rollout::{
    Destination, Evaluate, Evaluation, Look, Progress, RolloutError, Shot, Slope, Take, loss, outcome,
    thread_pool,
};
use crate::scene::Scene;
use crate::skill::{Control, SkillMap, Theta, displacement};

/// Work of one adjoint substep in units of a forward one, for the progress bar.
const ADJOINT_WORK: u64 = 3;

/// Powder and tool at one moment of a rollout.
pub(crate) struct Moment<T> {
    state: State<T>,
    tool: Pose,
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
    /// States that earlier gradients kept. They stay: what one thread frees, the allocator keeps for that thread,
    /// and the next gradient may be run by another.
    spare: Vec<Kept<T>>,
    packing: Vec<[f64; 3]>,
    pool: rayon::ThreadPool,
    memory_bytes: u64,
    /// States to keep at most, whatever memory would allow.
    most_kept: usize,
}

/// A state on the way of a gradient.
struct Kept<T> {
    /// The substep that begins there.
    step: usize,
    state: State<T>,
    /// What was on the grid in that substep, if `has_grid`.
    on_grid: OnGrid<T>,
    has_grid: bool,
}

impl<T: Real> Kept<T> {
    fn first(state: State<T>) -> Self {
        Self { step: 0, state, on_grid: OnGrid::default(), has_grid: false }
    }

    fn grid(&self) -> Option<&OnGrid<T>> {
        self.has_grid.then_some(&self.on_grid)
    }
}

impl<T: Real> Moment<T> {
    /// Lets somebody look at it.
    fn show(&self, step: usize, look: Look<'_>) -> bool {
        let particles = &self.state.particles;
        let narrow = |rows: Vec<[f64; 3]>| -> Vec<[f32; 3]> {
            rows.into_iter().map(|row| row.map(|x| x as f32)).collect()
        };
        let positions_m = narrow(particles.positions_by_id());
        let velocities_m_s = narrow(particles.velocities_by_id());
        look(&Shot { step, tool: self.tool, positions_m: &positions_m, velocities_m_s: &velocities_m_s })
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
    /// `memory_bytes` bounds what the whole process uses while a gradient is computed.
    pub(crate) fn new(
        scene: &Scene,
        packing: Vec<[f64; 3]>,
        pool: rayon::ThreadPool,
        memory_bytes: u64,
    ) -> Self {
        let skill = SkillMap::new(scene);
        Self {
            scene: scene.clone(),
            anchor: *skill.start_pose(),
            skill,
            model: Model::new(scene),
            workspace: Workspace::new(),
            settled: None,
            spare: Vec::new(),
            packing,
            pool,
            memory_bytes,
            most_kept: usize::MAX,
        }
    }

    /// Keeps no more states than this at a time while a gradient is computed, even if memory would allow more.
    pub(crate) fn keep_at_most(&mut self, states: usize) {
        self.most_kept = states;
    }

    /// What each stage of the substeps to come takes.
    pub(crate) fn laps(&mut self) -> &mut Laps {
        &mut self.workspace.laps
    }

    /// Runs some stages by themselves, for what they take.
    pub(crate) fn alone(&mut self, moment: &Moment<T>) -> Result<(), RolloutError> {
        let lost = |r: &Rollout<'_, T>, lost| lost_error(r.scene, 0, lost, Some(&moment.state));
        let job = |r: &mut Rollout<'_, T>| r.workspace.alone(r.model, &moment.state).map_err(|l| lost(r, l));
        self.in_pool(job, &mut |_, _| true)
    }

    fn path(&self, anchor: Pose, controls: Vec<Displacement>) -> Path {
        Path::new(anchor, controls, self.scene.time.substeps, self.scene.time.control_period_s())
    }

    /// The settled powder under the tool's start pose.
    pub(crate) fn beginning(&mut self, progress: Progress<'_>) -> Result<Moment<T>, RolloutError> {
        let tool = self.anchor;
        Ok(Moment { state: self.in_pool(|r| r.settled(), progress)?, tool })
    }

    /// The settled powder under a tool that waits at `tool`.
    fn beginning_under(&mut self, tool: &Pose, progress: Progress<'_>) -> Result<Moment<T>, RolloutError> {
        if *tool == self.anchor {
            return self.beginning(progress);
        }
        Ok(Moment { state: self.in_pool(|r| r.settle_under(tool), progress)?, tool: *tool })
    }

    /// The moment after the given controls.
    pub(crate) fn after(
        &mut self,
        from: &Moment<T>,
        controls: &[Displacement],
        progress: Progress<'_>,
    ) -> Result<Moment<T>, RolloutError> {
        let path = self.path(from.tool, controls.to_vec());
        let state = self.in_pool(|r| r.forward(from.state.clone(), &path), progress)?;
        Ok(Moment { state, tool: path.end().unwrap_or(from.tool) })
    }

    /// What has been achieved at a moment.
    pub(crate) fn judge(&self, moment: &Moment<T>) -> Evaluation {
        evaluation(&self.scene, &moment.state.particles.positions_by_id(), &moment.tool).0
    }

    /// Evaluation after the given controls, and the loss's cotangents of the controls.
    pub(crate) fn control_gradient(
        &mut self,
        from: &Moment<T>,
        controls: &[Displacement],
        progress: Progress<'_>,
    ) -> Result<(Evaluation, Vec<Control>), RolloutError> {
        let path = self.path(from.tool, controls.to_vec());
        self.in_pool(|r| r.gradient(from.state.clone(), &path), progress)
    }

    /// Evaluations after each of several control sequences of one length, side by side.
    pub(crate) fn evaluate_motions(
        &self,
        from: &Moment<T>,
        motions: Vec<Vec<Displacement>>,
        progress: Progress<'_>,
    ) -> Result<Vec<Evaluation>, RolloutError> {
        if motions.is_empty() {
            return Ok(Vec::new());
        }
        let paths: Vec<Path> = motions.into_iter().map(|controls| self.path(from.tool, controls)).collect();
        let pools = self.worker_pools(paths.len(), &from.state)?;
        let lost = |substep, lost, state: &State<T>| lost_error(&self.scene, substep, lost, Some(state));
        let family = Family { model: &self.model, paths: &paths, lost: &lost };
        let ends = branches::run(&family, from.state.clone(), &pools, progress)?;
        let judge = |(state, path): (State<T>, &Path)| {
            let tool = path.end().unwrap_or(from.tool);
            self.judge(&Moment { state, tool })
        };
        Ok(ends.into_iter().zip(&paths).map(judge).collect())
    }

    /// Threads for rollouts side by side: as many workers as there are threads, motions, and memory for.
    fn worker_pools(&self, motions: usize, state: &State<T>) -> Result<Vec<rayon::ThreadPool>, RolloutError> {
        let threads = self.pool.current_num_threads();
        let kept = self.spare.len();
        let free = slots(&self.scene, self.memory_bytes, state, &self.workspace).saturating_sub(kept);
        let per_worker = 2 + self.workspace.bytes() / state.bytes().max(1);
        let workers = branches::worker_count(threads, motions, free, per_worker);
        (0..workers).map(|_| thread_pool(threads / workers)).collect()
    }

    /// Runs in the simulator's own threads.
    fn in_pool<R: Send>(
        &mut self,
        job: impl FnOnce(&mut Rollout<'_, T>) -> R + Send,
        progress: Progress<'_>,
    ) -> R {
        let mut rollout = Rollout {
            scene: &self.scene,
            anchor: &self.anchor,
            model: &self.model,
            workspace: &mut self.workspace,
            settled: &mut self.settled,
            spare: &mut self.spare,
            packing: &self.packing,
            memory_bytes: self.memory_bytes,
            most_kept: self.most_kept,
            progress,
        };
        self.pool.install(|| job(&mut rollout))
    }

    /// Positions (m) after the given controls, in the order of the packing.
    ///
    /// # Errors
    /// See [`RolloutError`].
    pub fn final_positions(
        &mut self,
        controls: &[Displacement],
        progress: Progress<'_>,
    ) -> Result<Vec<[f64; 3]>, RolloutError> {
        let start = self.beginning(progress)?;
        Ok(self.after(&start, controls, progress)?.state.particles.positions_by_id())
    }
}

impl<T: Real> Evaluate for Simulator<T> {
    fn evaluate(
        &mut self,
        theta: &Theta,
        want_gradient: bool,
        progress: Progress<'_>,
    ) -> Result<Evaluation, RolloutError> {
        if !want_gradient {
            let controls: Vec<_> = self.skill.controls(theta)?.iter().map(displacement).collect();
            return self.simulate(&controls, progress);
        }
        let linear = self.skill.linearise(theta)?;
        let controls: Vec<_> = linear.controls.iter().map(displacement).collect();
        let start = self.beginning(progress)?;
        let (mut evaluation, bars) = self.control_gradient(&start, &controls, progress)?;
        evaluation.gradient = Some(linear.pull_back(&bars));
        Ok(evaluation)
    }

    fn evaluate_all(
        &mut self,
        thetas: &[Theta],
        progress: Progress<'_>,
    ) -> Result<Vec<Evaluation>, RolloutError> {
        let controls = |theta: &Theta| -> Result<Vec<_>, RolloutError> {
            Ok(self.skill.controls(theta)?.iter().map(displacement).collect())
        };
        let motions = thetas.iter().map(controls).collect::<Result<_, _>>()?;
        let start = self.beginning(progress)?;
        self.evaluate_motions(&start, motions, progress)
    }

    fn simulate(
        &mut self,
        controls: &[Displacement],
        progress: Progress<'_>,
    ) -> Result<Evaluation, RolloutError> {
        let anchor = self.anchor;
        self.simulate_from(&anchor, controls, progress)
    }

    fn gradient_of(
        &mut self,
        controls: &[Displacement],
        progress: Progress<'_>,
    ) -> Result<(Evaluation, Vec<Slope>), RolloutError> {
        let start = self.beginning(progress)?;
        let (evaluation, bars) = self.control_gradient(&start, controls, progress)?;
        Ok((evaluation, bars.into_iter().map(Slope::from).collect()))
    }

    fn simulate_from(
        &mut self,
        anchor: &Pose,
        controls: &[Displacement],
        progress: Progress<'_>,
    ) -> Result<Evaluation, RolloutError> {
        let start = self.beginning_under(anchor, progress)?;
        let end = self.after(&start, controls, progress)?;
        Ok(self.judge(&end))
    }

    fn record(
        &mut self,
        take: &Take<'_>,
        look: Look<'_>,
        progress: Progress<'_>,
    ) -> Result<(Evaluation, Vec<Destination>), RolloutError> {
        let mut moment = self.beginning_under(take.anchor, progress)?;
        let (total, mut step) = (take.controls.len(), 0);
        let mut shown = take.controls.chunks(take.every.max(1)).peekable();
        loop {
            if !moment.show(step, look) {
                return Err(RolloutError::Stopped);
            }
            // What is left after the last shot belongs to the motion all the same.
            let whole = shown.next_if(|controls| controls.len() == take.every.max(1));
            let Some(controls) = whole else { break };
            let next = self.after(&moment, controls, &mut |_, _| true);
            moment = next.map_err(|error| error.later_by(step))?;
            step += controls.len();
            if !progress(step as u64, total as u64) {
                return Err(RolloutError::Stopped);
            }
        }
        let end = self.after(&moment, &take.controls[step..], &mut |_, _| true);
        let end = end.map_err(|error| error.later_by(step))?;
        let positions = end.state.particles.positions_by_id();
        Ok((self.judge(&end), outcome::destinations(&self.scene, &positions, &end.tool)))
    }
}

fn evaluation(scene: &Scene, positions: &[[f64; 3]], tool: &Pose) -> (Evaluation, Vec<[f64; 3]>) {
    let (loss, gradient) = loss::loss(scene, positions);
    let census = outcome::census(scene, positions, tool);
    let evaluation = Evaluation {
        loss,
        indicator: scene.target_count() as i64 - i64::from(census.transported),
        transported: census.transported,
        spilled: census.spilled,
        on_tool: census.on_tool,
        gradient: None,
    };
    (evaluation, gradient)
}

/// What became of a particle that the grid cannot hold.
fn lost_error<T: Real>(scene: &Scene, substep: usize, lost: Lost, state: Option<&State<T>>) -> RolloutError {
    let n = scene.time.substeps as usize;
    let (step, substep) = ((substep / n) as u32, (substep % n) as u32);
    let finite = state.is_none_or(|s| {
        s.particles
            .living()
            .find(|(_, _, id)| *id == lost.particle)
            .is_none_or(|(g, l, _)| s.particles.groups[g].rows().all(|row| row[l].is_finite()))
    });
    if finite {
        RolloutError::Escaped { step, substep, particle: lost.particle }
    } else {
        RolloutError::NonFinite { stage: "grid to particle", step, substep, particle: lost.particle }
    }
}

/// Borrowed parts of a simulator during one rollout.
struct Rollout<'a, T: Real> {
    scene: &'a Scene,
    anchor: &'a Pose,
    model: &'a Model<T>,
    workspace: &'a mut Workspace<T>,
    settled: &'a mut Option<State<T>>,
    spare: &'a mut Vec<Kept<T>>,
    packing: &'a [[f64; 3]],
    memory_bytes: u64,
    most_kept: usize,
    progress: Progress<'a>,
}

impl<T: Real> Rollout<'_, T> {
    fn report(&mut self, done: u64, total: u64) -> Result<(), RolloutError> {
        if (self.progress)(done, total) { Ok(()) } else { Err(RolloutError::Stopped) }
    }

    /// The powder at rest under the tool's start pose.
    fn settled(&mut self) -> Result<State<T>, RolloutError> {
        if let Some(state) = &self.settled {
            return Ok(state.clone());
        }
        let state = self.settle_under(self.anchor)?;
        *self.settled = Some(state.clone());
        Ok(state)
    }

    /// The powder at rest under a tool that stands still.
    fn settle_under(&mut self, tool: &Pose) -> Result<State<T>, RolloutError> {
        let particles = Particles::at_rest(self.packing);
        let mut state =
            State::new(self.model, &particles).map_err(|l| lost_error::<T>(self.scene, 0, l, None))?;
        let tool = resting(tool);
        let per_step = self.scene.time.substeps as usize;
        for substep in 0..self.scene.time.settle_steps() as usize * per_step {
            if substep.is_multiple_of(per_step) {
                // Only to ask whether to go on: the rollout's own work is counted from its beginning.
                self.report(0, 1)?;
            }
            self.step(&mut state, substep, &tool)?;
        }
        Ok(state)
    }

    fn step(
        &mut self,
        state: &mut State<T>,
        substep: usize,
        tool: &crate::mpm::contact::Motion<T>,
    ) -> Result<(), RolloutError> {
        match self.workspace.advance(self.model, tool, state) {
            Ok(()) => Ok(()),
            Err(lost) => Err(lost_error(self.scene, substep, lost, Some(state))),
        }
    }

    fn step_to(
        &mut self,
        from: &State<T>,
        substep: usize,
        tool: &crate::mpm::contact::Motion<T>,
        to: &mut State<T>,
    ) -> Result<(), RolloutError> {
        let advanced = self.workspace.advance_to(self.model, tool, from, to);
        advanced.map_err(|lost| lost_error(self.scene, substep, lost, Some(to)))
    }

    fn forward(&mut self, mut state: State<T>, path: &Path) -> Result<State<T>, RolloutError> {
        let total = path.len() as u64;
        for substep in 0..path.len() {
            if substep.is_multiple_of(self.scene.time.substeps as usize) {
                self.report(substep as u64, total)?;
            }
            self.step(&mut state, substep, &path.motion(substep))?;
        }
        self.report(total, total)?;
        Ok(state)
    }

    fn gradient(&mut self, start: State<T>, path: &Path) -> Result<(Evaluation, Vec<Control>), RolloutError> {
        let slots = slots(self.scene, self.memory_bytes, &start, self.workspace).min(self.most_kept);
        let total = advances(schedule(path.len(), slots)) + ADJOINT_WORK * path.len() as u64;
        let mut done = 0;
        let mut back = path.pull_back();
        let mut end: Option<(Evaluation, Vec<Group<T>>)> = None;
        // The state at work is the last one kept, until it is advanced: then it is `working`.
        let mut kept = vec![Kept::first(start)];
        let mut working = State::none();
        let (mut at, mut is_kept) = (0, true);
        for action in schedule(path.len(), slots) {
            let last = kept.last_mut().expect("the schedule keeps the first state");
            match action {
                Action::Restore => (at, is_kept) = (last.step, true),
                Action::Advance(count) => {
                    for _ in 0..count {
                        if is_kept {
                            self.step_to(&last.state, at, &path.motion(at), &mut working)?;
                        } else {
                            self.step(&mut working, at, &path.motion(at))?;
                        }
                        (at, is_kept) = (at + 1, false);
                        done += 1;
                        self.report(done, total)?;
                    }
                }
                Action::Keep => {
                    if last.step + 1 == at {
                        std::mem::swap(&mut last.on_grid, &mut self.workspace.on_grid);
                        last.has_grid = true;
                    }
                    // Memory of dropped states is used again: fresh pages cost more than what is done with them.
                    let spare = self.spare.pop().unwrap_or_else(|| Kept::first(State::none()));
                    let state = std::mem::replace(&mut working, spare.state);
                    kept.push(Kept { step: at, state, on_grid: spare.on_grid, has_grid: false });
                    is_kept = true;
                }
                Action::Drop => self.spare.extend(kept.pop()),
                Action::Reverse(step) => {
                    let (state, grid) = if is_kept { (&last.state, last.grid()) } else { (&working, None) };
                    let (evaluation, mut bar) = match end.take() {
                        Some(end) => end,
                        None => self.end_of(path, state)?,
                    };
                    let tool_bar =
                        self.workspace.retreat(self.model, &path.motion(step), state, grid, &mut bar);
                    self.check_finite(step, &tool_bar, state, &bar)?;
                    back.take(step, tool_bar);
                    self.workspace.laps.skip();
                    end = Some((evaluation, unsort_bar(state, bar)));
                    self.workspace.laps.mark(Stage::Unsort);
                    done += ADJOINT_WORK;
                    self.report(done, total)?;
                }
            }
        }
        let evaluation = match end {
            Some((evaluation, _)) => evaluation,
            // A motion of no step ends where it began.
            None => self.end_of(path, &kept[0].state)?.0,
        };
        self.spare.append(&mut kept);
        Ok((evaluation, back.finished()))
    }

    /// Last step, loss, and the loss's cotangent in the order of the last step's particles.
    fn end_of(&mut self, path: &Path, state: &State<T>) -> Result<(Evaluation, Vec<Group<T>>), RolloutError> {
        let mut state = state.clone();
        state.fill();
        if let Some(last) = path.len().checked_sub(1) {
            self.step(&mut state, last, &path.motion(last))?;
        }
        let positions = state.particles.positions_by_id();
        let (evaluation, gradient) = evaluation(self.scene, &positions, &path.end().unwrap_or(*self.anchor));
        let mut bar = vec![Group::ZERO; state.particles.groups.len()];
        for (g, l, id) in state.particles.living() {
            set_vec(&mut bar[g].x, l, gradient[id as usize].map(T::of));
        }
        Ok((evaluation, unsort_bar(&state, bar)))
    }

    /// The sum of everything that touched the tool shows whether a number went astray; only then is it looked for.
    fn check_finite(
        &self,
        step: usize,
        tool: &MotionBar,
        state: &State<T>,
        bar: &[Group<T>],
    ) -> Result<(), RolloutError> {
        let n = self.scene.time.substeps as usize;
        let tool_finite = tool.position.iter().chain(&tool.rotation).all(|x| x.is_finite());
        if tool_finite && !step.is_multiple_of(n) {
            return Ok(());
        }
        for (g, l, particle) in state.particles.living() {
            if !bar[g].rows().all(|row| row[l].is_finite()) {
                let (step, substep) = ((step / n) as u32, (step % n) as u32);
                return Err(RolloutError::NonFinite { stage: "the adjoint", step, substep, particle });
            }
        }
        Ok(())
    }
}

/// Kept states that a memory budget allows.
fn slots<T: Real>(scene: &Scene, memory_bytes: u64, state: &State<T>, workspace: &Workspace<T>) -> usize {
    let per_state = state.bytes() as u64;
    // Beside the kept states live those of rollouts side by side, and two workers' workspaces.
    let side_by_side = BRANCHES * per_state + 2 * workspace.bytes() as u64;
    let fixed = fixed_bytes(scene) + STANDING_STATES * per_state + workspace.bytes() as u64 + side_by_side;
    let free = memory_bytes.saturating_sub(fixed);
    ((free / grown(per_state).max(1)) as usize).max(2)
}
