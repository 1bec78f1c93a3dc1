//! One motion, simulated frame by frame for pictures, pages and exports.

use std::ops::ControlFlow;

use super::{
    CliError, Context, Progress,
    motion::{ArmShown, Motion, NOT_REPRODUCED, Task, collision_words, is_reproduced},
};
use crate::report::{amounts::Amounts, view};
use powderline_shared::{displacement::Displacement, pose::Pose};
use powderline_simulator::{
    rollout::{Evaluation, Recording, RolloutError, Snapshot, Workload},
    skill::SkillMap,
};
use powderline_view::{Bench, Frame, Sink, ViewError};

/// A motion that is to be looked at.
pub(super) struct Film<'a> {
    task: &'a Task,
    anchor: Pose,
    controls: Vec<Displacement>,
    /// Planned poses at the beginning and after each control step, where the motion is an executed one.
    planned: Option<&'a [Pose]>,
    /// Control steps from one frame to the next.
    every: usize,
    /// The arm, if it is to be seen and there is one.
    arm: Option<ArmShown>,
}

impl<'a> Film<'a> {
    /// With frames about `period_s` apart: every so many control steps, every one at least. `besides_bytes` is what is made of
    /// such a bench beside the simulation. To be called before anything is written: it refuses what memory does not hold.
    ///
    /// # Errors
    /// The skill is no motion, or the memory will not do.
    pub(super) fn new(
        task: &'a Task,
        period_s: f64,
        besides_bytes: fn(&Bench) -> u64,
    ) -> Result<Self, CliError> {
        let map = SkillMap::new(&task.scene);
        let start = *map.start_pose();
        let (anchor, controls, planned) = match &task.motion {
            Motion::Skill(theta, splines) => (start, map.motion(theta, splines.as_ref())?, None),
            Motion::Plan { controls, .. } => (start, controls.clone(), None),
            Motion::Executed { executed, planned, .. } => {
                (executed.anchor, executed.controls.clone(), Some(planned.as_slice()))
            }
        };
        let every = (period_s / task.scene.time.control_period_s()).round().max(1.0) as usize;
        let film = Self { task, anchor, controls, planned, every, arm: None };
        task.setup.check_memory(&task.scene, Workload::Single, besides_bytes(&film.bench()))?;
        Ok(film)
    }

    /// The same with the arm that makes the motion, if the scene or the plan says which.
    pub(super) fn with_arm(mut self) -> Self {
        self.arm = self.task.arm_shown(self.poses());
        self
    }

    /// What is to be said of the arm, if it is not as it should be.
    pub(super) fn arm_remark(&self) -> Option<&str> {
        self.arm.as_ref()?.remark.as_deref()
    }

    /// Why the motion cannot be made as it is shown: one sentence each.
    pub(super) fn obstacles(&self) -> Vec<String> {
        let collision = self.task.collision().map(|collision| format!("{}.", collision_words(&collision)));
        collision.into_iter().chain(self.arm_remark().map(String::from)).collect()
    }

    /// That what was seen is not what the plan says of itself, if it is not.
    pub(super) fn disagreement(&self, found: &Evaluation) -> Option<String> {
        let Motion::Plan { header, .. } = &self.task.motion else { return None };
        (!is_reproduced(header, found)).then(|| {
            let amounts = Amounts::from(&self.task.scene);
            let [says, brings] = [header.predicted.census, found.census]
                .map(|census| amounts.powder(census.target));
            format!(
                "{NOT_REPRODUCED}: it says {says}, and here it brings {brings}; a plan of another version has to be made anew."
            )
        })
    }

    /// Length of the motion, seconds.
    pub(super) fn duration_s(&self) -> f64 {
        self.controls.len() as f64 * self.task.scene.time.control_period_s()
    }

    /// What will be seen.
    pub(super) fn bench(&self) -> Bench {
        let scene = &self.task.scene;
        let period_s = self.every as f64 * scene.time.control_period_s();
        let bench = view::bench(scene, &self.poses(), self.controls.len() / self.every + 1, period_s);
        Bench { arm: self.arm.as_ref().and_then(|shown| shown.arm.clone()), ..bench }
    }

    /// Where the tool is at the beginning and after each control step.
    fn poses(&self) -> Vec<Pose> {
        let next = |pose: &mut Pose, control: &Displacement| {
            *pose = pose.displaced(control);
            Some(*pose)
        };
        std::iter::once(self.anchor).chain(self.controls.iter().scan(self.anchor, next)).collect()
    }

    /// Simulates, and shows every frame to the sink.
    ///
    /// # Errors
    /// The simulation's, or the sink's.
    pub(super) fn shoot(
        &self,
        sink: &mut (dyn Sink + Send),
        context: &mut Context<'_>,
    ) -> Result<Evaluation, CliError> {
        let Self { task, anchor, controls, planned, every, .. } = self;
        let mut simulator = (context.factory)(&task.scene, &task.setup)?;
        let progress = Progress::new(&context.err, context.live);
        simulator.set_progress(progress.watch(&context.interrupt));
        let warn = |sentence: &String| progress.line(&format!("Warning: {sentence}"));
        self.obstacles().iter().for_each(warn);
        progress.begin("simulating", 0, &[]);
        let mut refusal = None;
        let mut observer = |snapshot: &Snapshot<'_>| {
            let frame = Frame {
                index: snapshot.step / every,
                time_s: snapshot.step as f64 * task.scene.time.control_period_s(),
                tool: snapshot.tool,
                // A tool that has come to the plan's end is to stay there.
                planned: planned.map(|poses| poses[snapshot.step.min(poses.len() - 1)]),
                positions_m: snapshot.positions_m,
                velocities_m_s: snapshot.velocities_m_s,
            };
            refusal = sink.frame(&frame).err();
            if refusal.is_none() { ControlFlow::Continue(()) } else { ControlFlow::Break(()) }
        };
        let recording = Recording { anchor, controls, every: *every };
        let recorded = simulator.record(&recording, &mut observer);
        progress.clear();
        match (recorded, refusal) {
            (_, Some(refusal)) => Err(refusal.into()),
            (Err(error), None) => Err(RolloutError::into(error)),
            (Ok((evaluation, destinations)), None) => {
                self.disagreement(&evaluation).iter().for_each(warn);
                sink.finish(&destinations)?;
                Ok(evaluation)
            }
        }
    }
}

impl From<ViewError> for CliError {
    fn from(error: ViewError) -> Self {
        match error {
            ViewError::File { .. } => Self::Failed(error.to_string()),
            ViewError::Stopped => Self::Interrupted(error.to_string()),
            _ => Self::Input(error.to_string()),
        }
    }
}
