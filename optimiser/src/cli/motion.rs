//! Which motion a command is about: a skill, a plan, or what an arm made of a plan.

use super::{
    CliError, Resources, Setup,
    executed::{Executed, ExecutedReport},
    options::{DEFAULT_PRECISION, PrecisionArg},
};
use crate::report::{folder, view, words::hex};
use clap::Args;
use powderline_shared::{
    arm::ArmKind,
    displacement::{Displacement, pose_at},
    limits::Limits,
    plan::{
        PlanHeader, Precision,
        file::{parse_plan, read_plan_file},
    },
    pose::Pose,
};
use powderline_simulator::{
    arm::{ArmMotion, CYCLE_US, Mount, Refusal, Surroundings, ToolPath},
    rollout::Evaluation,
    scene::{DEFAULT_SCENE, EMBEDDED_SCENES, Obstacle, Scene},
    skill::{Collision, LSB, QuantisedControls, SkillMap, Splines, Theta, collision, controls_of},
};
use std::path::{Path, PathBuf};

/// Arguments of commands that are about one motion.
#[derive(Clone, Debug, Args)]
#[group(id = "motion", required = true, multiple = false, args = ["theta", "plan"])]
pub(super) struct MotionArgs {
    /// Scene: an embedded name or a TOML file [default: the scene that the plan was made for, if it is the scene.toml beside it
    /// or an embedded one; bench for a skill]
    #[arg(value_name = "SCENE")]
    pub scene: Option<String>,
    /// Skill: depth, scoop angle, lift, transport, pour angle, each in [-1, 1]
    #[arg(long, value_name = "A,B,C,D,E", allow_hyphen_values = true)]
    pub theta: Option<String>,
    /// Plan to simulate again
    #[arg(long, value_name = "FILE")]
    pub plan: Option<PathBuf>,
    /// Motion that the arm made of the plan, as recorded: simulate the powder under that, beside the plan's prediction
    #[arg(long, value_name = "FILE", requires = "plan", conflicts_with = "theta")]
    pub executed: Option<PathBuf>,
    /// Seed of the packing [default: the scene's powder.seed; a plan brings its own]
    #[arg(long, value_name = "N", conflicts_with = "plan")]
    pub seed: Option<u64>,
    /// Precision of the simulation [default: f32; a plan brings its own]
    #[arg(long, conflicts_with = "plan")]
    pub precision: Option<PrecisionArg>,
    /// Threads and memory.
    #[command(flatten)]
    pub resources: Resources,
}

impl MotionArgs {
    /// Of a plan, in the scene that it was made for.
    pub(super) fn of_plan(plan: &Path, resources: Resources) -> Self {
        let plan = Some(plan.to_owned());
        Self { scene: None, theta: None, plan, executed: None, seed: None, precision: None, resources }
    }
}

/// What is to be simulated.
pub(super) struct Task {
    /// The bench.
    pub scene: Scene,
    /// How it is simulated.
    pub setup: Setup,
    /// What the tool does.
    pub motion: Motion,
}

/// What the tool does.
pub(super) enum Motion {
    /// With what is added to its motion, if anything is.
    Skill(Theta, Option<Splines>),
    Plan {
        header: Box<PlanHeader>,
        content_hash: u64,
        controls: Vec<Displacement>,
    },
    /// With the poses of the plan, at its beginning and after each of its steps.
    Executed {
        header: Box<PlanHeader>,
        content_hash: u64,
        executed: Box<Executed>,
        planned: Vec<Pose>,
    },
}

/// Whether a simulation of a plan's motion came to the very bits that the plan says of itself.
pub(super) fn is_reproduced(header: &PlanHeader, found: &Evaluation) -> bool {
    found.loss.to_bits() == header.predicted.loss_m.to_bits() && found.census == header.predicted.census
}

/// What is said where it is not.
pub(super) const NOT_REPRODUCED: &str = "the plan's loss and amount were not reproduced";

impl Task {
    /// What there is to know of a motion that an arm made of a plan.
    pub(super) fn executed(&self) -> Option<&ExecutedReport> {
        match &self.motion {
            Motion::Executed { executed, .. } => Some(&executed.report),
            _ => None,
        }
    }

    /// Where the motion takes the tool through a container or a gate, of which the simulation says nothing.
    pub(super) fn collision(&self) -> Option<Collision> {
        let map = SkillMap::new(&self.scene);
        let start = map.start_pose();
        match &self.motion {
            Motion::Skill(theta, splines) => {
                let controls = map.motion(theta, splines.as_ref()).ok()?;
                collision(&self.scene, start, &QuantisedControls::new(&controls).ok()?.controls)
            }
            Motion::Plan { controls, .. } => collision(&self.scene, start, controls),
            Motion::Executed { executed, .. } => collision(&self.scene, &executed.anchor, &executed.controls),
        }
    }
}

/// An arm that is to be seen making a motion, and what is to be said of it.
pub(super) struct ArmShown {
    /// None where it cannot.
    pub arm: Option<powderline_view::arm::Arm>,
    /// One sentence, if it is not as it should be.
    pub remark: Option<String>,
}

/// What a motion that is looked at need not keep: it is what it is. Whether an arm can make it is another question.
const ANY: Limits = Limits {
    workspace_min_m: [f64::MIN; 3],
    workspace_max_m: [f64::MAX; 3],
    linear_velocity_m_s: f64::MAX,
    linear_acceleration_m_s2: f64::MAX,
    linear_jerk_m_s3: f64::MAX,
    angular_velocity_rad_s: f64::MAX,
    angular_acceleration_rad_s2: f64::MAX,
    angular_jerk_rad_s3: f64::MAX,
};

impl Task {
    /// The arm that makes the motion: the plan's, or that of the scene; none if there is neither.
    fn mount(&self) -> Option<Mount> {
        let of_scene = self.scene.arm.as_ref();
        match &self.motion {
            Motion::Skill(..) => of_scene.map(Mount::of),
            Motion::Plan { header, .. } | Motion::Executed { header, .. } => {
                Some(Mount::of_plan(&header.arm?, of_scene.map(|arm| arm.clearance_m)))
            }
        }
    }

    /// The arm, with the tool at these poses from tick to tick. One that comes too near to something, or passes through itself, is shown doing that.
    pub(super) fn arm_shown(&self, poses: Vec<Pose>) -> Option<ArmShown> {
        let mount = self.mount()?;
        let around = Surroundings::of_scene(&self.scene, view::table_m(&self.scene));
        let path = ToolPath { period_us: self.scene.time.control_period_us, lsb: LSB, limits: ANY, poses };
        let made = |mount: &Mount| ArmMotion::new(&path, mount, &around, CYCLE_US);
        // The posture of the refusal, as far as that can be had.
        let near = |mount: &Mount| made(&Mount { clearance_m: None, ..*mount });
        let anyhow = |mount: &Mount| ArmMotion::through_anything(&path, mount, &around, CYCLE_US);
        let (made, near) = match made(&mount) {
            Err(refusal @ Refusal::TooNear { .. }) => {
                (near(&mount).or_else(|_| anyhow(&mount)), Some(refusal))
            }
            Err(refusal @ Refusal::SelfCollision { .. }) => (anyhow(&mount), Some(refusal)),
            made => (made, None),
        };
        let label = ArmKind::label(mount.kind);
        let remark = match (&made, near) {
            (Err(refusal), _) => {
                Some(format!("No arm is drawn, for the {label} cannot make this motion: {refusal}."))
            }
            (Ok(_), Some(refusal)) => {
                Some(format!("The {label} is drawn, though it could not make this motion: {refusal}."))
            }
            (Ok(_), None) => None,
        };
        let arm = made.ok().map(|motion| view::arm(&self.scene, motion, path.clone()));
        Some(ArmShown { arm, remark })
    }
}

/// A collision as one sentence without its end.
pub(super) fn collision_words(collision: &Collision) -> String {
    match collision.obstacle {
        Obstacle::Border => {
            format!("{collision}: an arm can do that, but what comes of it there is not simulated")
        }
        _ => format!("{collision}: the simulated tool can do that, an arm cannot"),
    }
}

impl MotionArgs {
    /// What the arguments ask for.
    ///
    /// # Errors
    /// One sentence.
    pub(super) fn task(&self) -> Result<Task, CliError> {
        match (&self.plan, &self.theta) {
            (Some(plan), _) => self.plan_task(plan),
            (None, theta) => self.skill_task(theta.as_deref().unwrap_or_default()),
        }
    }

    fn skill_task(&self, theta: &str) -> Result<Task, CliError> {
        let theta = parse_theta(theta)?;
        let scene = Scene::load(self.scene.as_deref().unwrap_or(DEFAULT_SCENE))?;
        // Refused here, before anything is simulated.
        SkillMap::new(&scene).controls(&theta)?;
        let precision = self.precision.map_or(DEFAULT_PRECISION, Precision::from);
        let setup = self.resources.setup(self.seed.unwrap_or(scene.powder.seed), precision);
        Ok(Task { scene, setup, motion: Motion::Skill(theta, None) })
    }

    fn plan_task(&self, path: &Path) -> Result<Task, CliError> {
        let bytes = read_plan_file(path)?;
        let plan = parse_plan(path, &bytes)?;
        let (header, content_hash) = (*plan.header(), plan.content_hash());
        let scene = match &self.scene {
            Some(name) => scene_given(name, path, &header)?,
            None => scene_found(path, &header)?,
        };
        let setup = self.resources.setup(header.seed, header.precision);
        let header = Box::new(header);
        let motion = match &self.executed {
            None => {
                let controls = controls_of(&plan.setpoints().collect::<Vec<_>>(), header.lsb);
                Motion::Plan { header, content_hash, controls }
            }
            Some(path) => {
                let executed = Box::new(Executed::read(path, &plan, &scene)?);
                let start = header.start_pose();
                let poses = plan.setpoints().map(|setpoint| pose_at(&start, setpoint, header.lsb));
                let planned = std::iter::once(start).chain(poses).collect();
                Motion::Executed { header, content_hash, executed, planned }
            }
        };
        Ok(Task { scene, setup, motion })
    }
}

/// The scene that was named, if it is the plan's.
fn scene_given(name: &str, plan: &Path, header: &PlanHeader) -> Result<Scene, CliError> {
    let scene = Scene::load(name)?;
    if scene.digest() == header.scene_digest {
        return Ok(scene);
    }
    let [wanted, found] = [header.scene_digest, scene.digest()].map(|digest| hex(&digest[..4]));
    let plan = plan.display();
    Err(CliError::Input(format!(
        "{plan} was made for another scene than {name} (digest {wanted}, not {found})"
    )))
}

/// The plan's scene, if it is beside the plan or embedded.
pub fn scene_of_plan(plan: &Path, header: &PlanHeader) -> Option<Scene> {
    scene_found(plan, header).ok()
}

/// The embedded scene that the plan was made for, if it is one.
pub fn embedded_scene_of_plan(header: &PlanHeader) -> Option<Scene> {
    let mut embedded = EMBEDDED_SCENES.into_iter().filter_map(|(name, _)| Scene::load(name).ok());
    embedded.find(|scene| scene.digest() == header.scene_digest)
}

/// The plan's scene: that beside it, or else the embedded one that it was made for, wherever the plan is now.
///
/// # Errors
/// There is none, or what lies beside the plan is another one.
pub(super) fn scene_found(plan: &Path, header: &PlanHeader) -> Result<Scene, CliError> {
    // A bare `scene.toml` is fine: no embedded scene has a dot in its name.
    let beside = plan.with_file_name(folder::SCENE);
    let beside = beside.exists().then(|| scene_given(&beside.to_string_lossy(), plan, header));
    if let Some(Ok(scene)) = beside {
        return Ok(scene);
    }
    if let Some(scene) = embedded_scene_of_plan(header) {
        return Ok(scene);
    }
    let wanted = hex(&header.scene_digest[..4]);
    let (plan, scene) = (plan.display(), folder::SCENE);
    Err(match beside {
        Some(Err(error)) => {
            error.with_remark(
                "nor is it an embedded one; the scene.toml of its run would be right, and if it is that, the plan is of a \
                 version whose digests have another form, and has to be made anew",
            )
        }
        _ => CliError::Input(format!(
            "the scene that {plan} was made for (digest {wanted}) is not beside it, nor is it an embedded one; the {scene} of \
             its run would be right, beside it or as SCENE, as in `optimise simulate SCENE --plan {plan}`"
        )),
    })
}

/// Five numbers in [-1, 1], separated by commas.
pub(super) fn parse_theta(text: &str) -> Result<Theta, CliError> {
    let wrong = |why: &str| {
        CliError::Input(format!(
            "--theta is `{text}`, but five numbers in [-1, 1], separated by commas, would be right: {why}"
        ))
    };
    let numbers = text
        .split(',')
        .map(|part| part.trim().parse().map_err(|_| wrong(&format!("`{}` is no number", part.trim()))))
        .collect::<Result<Vec<f64>, _>>()?;
    let five: [f64; 5] =
        numbers.try_into().map_err(|numbers: Vec<f64>| wrong(&format!("there are {}", numbers.len())))?;
    Ok(Theta::new(five)?)
}
