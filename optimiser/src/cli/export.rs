//! `optimise export`: the motion of a plan for robots and other programs, and the powder for those who ask for it.

mod destination;
mod program;

use super::{
    CliError, Context, PrecisionArg, Resources,
    arm_words::{ArmUse, clearance_words},
    film::Film,
    motion::{MotionArgs, Task, scene_found},
    run::safe_name,
};
use crate::report::folder::SCENE;
use clap::{Args, ValueEnum, builder::PossibleValuesParser, builder::TypedValueParser};
use destination::{Destination, STDOUT};
use powderline_shared::{
    arm::{ArmKind, Joints},
    limits::PeakUse,
    plan::{
        PlanHeader,
        file::{parse_plan, read_plan_file},
    },
    pose::Pose,
};
use powderline_simulator::{
    arm::{self, ArmMotion, Around, CYCLE_US, Figures, Mount, Surroundings, Transit},
    scene::{Gate, Scene, figures::about},
};
use powderline_view::{
    Bench,
    export::{Format, Series},
    motion::{Motion, mcap, table, urscript},
};
use program::{Program, TransitUse};
use serde::Serialize;
use std::{
    io::{self, Write},
    path::{Path, PathBuf},
};

/// What links keep from what is known around them, where no scene's arm says how much, metres.
const CLEARANCE_M: f64 = 0.02;

/// Control steps from one frame of powder to the next.
const DEFAULT_EVERY: u32 = 2;

const FORMATS: &str = "\
A motion (nothing is simulated; one file, beside the plan unless --out says where):
  urscript  program for a UR e-Series controller, PolyScope 5.9 or later, with the ways to the start and back; needs an arm
  csv       table, a row for each tick of the plan: time_s; x_m y_m z_m qw qx qy qz, the tool in the world;
            vx_m_s vy_m_s vz_m_s wx_rad_s wy_rad_s wz_rad_s, its velocities along the world's axes;
            with an arm joint1_rad .. joint6_rad and joint1_rad_s .. joint6_rad_s
  json      one object: plan, scene, period, arm, and the table's columns by name under \"motion\"
  mcap      ROS 2 messages: /tool_pose, /tf; with an arm /joint_trajectory, /joint_states; with --particles /powder
Powder (simulated for it, which takes as long as `optimise simulate`; many files, a folder):
  vtk       XML PolyData and a collection of it, for ParaView
  ply       binary PLY, for MeshLab
  csv       with --particles: tables of particles and tool, instead of the motion's

The arm is the one of the scene's [arm], as the plan has it. Another one is given by --arm, --base and --tool, such as the
one of the scene `bench`:
  optimise export PLAN --format urscript --arm ur5e --base 0.26,-0.8,-0.1,0,0,-90 --tool 0,0,0.2,90,0,-90";

/// Arguments of `optimise export`.
#[derive(Clone, Debug, Args)]
#[command(after_help = FORMATS)]
pub(super) struct ExportArgs {
    /// The plan
    #[arg(value_name = "PLAN", required_unless_present_any = ["plan_option", "theta"])]
    pub plan: Option<PathBuf>,
    /// The same
    #[arg(long = "plan", value_name = "FILE", hide = true, conflicts_with = "plan")]
    pub plan_option: Option<PathBuf>,
    /// What to write, see below
    #[arg(long, value_enum)]
    pub format: FormatArg,
    /// File, - for standard output, or the powder's folder [default: beside the plan; for powder export/<scene>-<format>]
    #[arg(long, value_name = "PATH", allow_hyphen_values = true)]
    pub out: Option<PathBuf>,
    /// Write over a file that is there
    #[arg(long)]
    pub force: bool,
    /// Print what was written as one JSON object
    #[arg(long)]
    pub json: bool,
    /// The arm.
    #[command(flatten)]
    pub arm: ArmArgs,
    /// The powder.
    #[command(flatten)]
    pub powder: PowderArgs,
}

/// Arguments about the arm.
#[derive(Clone, Debug, Args)]
#[command(next_help_heading = "Arm")]
pub(super) struct ArmArgs {
    /// Arm that makes the motion: adds its joints, and checks that it can [default: the plan's own]
    #[arg(long, requires_all = ["base", "tool"], value_parser = kinds())]
    pub arm: Option<ArmKind>,
    /// Its base in the scene's world: position in metres; roll, pitch, yaw in degrees (about the fixed x, y, z in turn)
    #[arg(long, value_name = "X,Y,Z,R,P,Y", allow_hyphen_values = true, requires = "arm", value_parser = parse_pose)]
    pub base: Option<Pose>,
    /// The plan's tool frame in the flange, likewise
    #[arg(long, value_name = "X,Y,Z,R,P,Y", allow_hyphen_values = true, requires = "arm", value_parser = parse_pose)]
    pub tool: Option<Pose>,
    /// Joints near which to begin, degrees [default: the posture with the largest margins, by joints, singularities and
    /// clearance]
    #[arg(long, value_name = "J1,..,J6", allow_hyphen_values = true, value_parser = parse_joints)]
    pub near: Option<[f64; 6]>,
    /// Height of the table beneath arm and bench, metres, in the scene's world: a motion that takes a link nearer to anything than
    /// the scene's arm.clearance_m, or 20 mm, is refused [default: the scene's, or that of the base; where the plan's scene is not
    /// known either, links that pass through something are said]
    #[arg(long, value_name = "Z", allow_hyphen_values = true, value_parser = parse_height)]
    pub table: Option<f64>,
    /// Setpoints a second of a URScript program; a whole part of 500 [default: 500, the e-Series' own]
    #[arg(long, value_name = "HZ", value_parser = parse_rate)]
    pub rate: Option<u32>,
    /// Joints at which the arm is before a URScript program and after it, degrees [default: above the start]
    #[arg(long, value_name = "J1,..,J6", allow_hyphen_values = true, value_parser = parse_joints)]
    pub home: Option<[f64; 6]>,
    /// Share of full speed at which a URScript program goes, 0.01 to 1: the same path, to look whether it is free before
    /// there is powder [default: 1]
    #[arg(long, value_name = "SHARE", value_parser = parse_speed)]
    pub speed: Option<f64>,
}

/// Arguments about the powder.
#[derive(Clone, Debug, Args)]
#[command(next_help_heading = "Powder")]
pub(super) struct PowderArgs {
    /// Write the powder: with csv instead of the motion, with mcap beside it
    #[arg(long)]
    pub particles: bool,
    /// Every so many control steps; 1 writes them all [default: 2]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    pub every: Option<u32>,
    /// Scene: an embedded name or a TOML file [default: the scene.toml beside the plan, otherwise bench]
    #[arg(long, value_name = "SCENE")]
    pub scene: Option<String>,
    /// Powder of a skill instead of a plan: depth, scoop angle, lift, transport, pour angle, each in [-1, 1]
    #[arg(long, value_name = "A,B,C,D,E", allow_hyphen_values = true, conflicts_with_all = ["plan", "plan_option"])]
    pub theta: Option<String>,
    /// Powder under the motion that the arm made of the plan, as recorded
    #[arg(long, value_name = "FILE", conflicts_with = "theta")]
    pub executed: Option<PathBuf>,
    /// Seed of a skill's packing [default: the scene's powder.seed]
    #[arg(long, value_name = "N", conflicts_with_all = ["plan", "plan_option"])]
    pub seed: Option<u64>,
    /// Precision of a skill's simulation [default: f32]
    #[arg(long, conflicts_with_all = ["plan", "plan_option"])]
    pub precision: Option<PrecisionArg>,
    /// Threads and memory.
    #[command(flatten)]
    pub resources: Resources,
}

/// What is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(super) enum FormatArg {
    Urscript,
    Csv,
    Json,
    Mcap,
    Vtk,
    Ply,
}

impl FormatArg {
    fn name(self) -> &'static str {
        match self {
            Self::Urscript => "urscript",
            Self::Csv => "csv",
            Self::Json => "json",
            Self::Mcap => "mcap",
            Self::Vtk => "vtk",
            Self::Ply => "ply",
        }
    }

    /// Ending of a motion's file.
    fn ending(self) -> &'static str {
        if self == Self::Urscript { "script" } else { self.name() }
    }
}

/// Runs the command.
///
/// # Errors
/// One sentence.
pub(super) fn execute(arguments: &ExportArgs, context: &mut Context<'_>) -> Result<(), CliError> {
    arguments.check()?;
    match arguments.series() {
        Some(format) => arguments.write_series(format, context),
        None => arguments.write_motion(context),
    }
}

impl ExportArgs {
    /// Refuses what does not go together, before any file is read.
    fn check(&self) -> Result<(), CliError> {
        use FormatArg::{Json, Urscript};
        let Self { format, arm, powder, .. } = self;
        let (is_series, to_stdout) =
            (self.series().is_some(), self.out.as_deref() == Some(Path::new(STDOUT)));
        let has_powder = is_series || powder.particles;
        let name = format.name();
        let sentence = match () {
            () if matches!(format, Urscript | Json) && powder.particles => {
                format!("--particles goes with csv, mcap, vtk and ply, but {name} holds a motion alone")
            }
            () if is_series && arm.arm.is_some() => {
                "--arm goes with a motion (urscript, csv, json, mcap), not with files of powder".into()
            }
            () if *format != Urscript && arm.rate.is_some() => {
                format!("--rate goes with urscript, but {name} has the ticks of the plan")
            }
            () if *format != Urscript && (arm.home.is_some() || arm.speed.is_some()) => {
                format!("--home and --speed go with urscript, but {name} has the motion alone, at the plan's speed")
            }
            () if !is_series && (powder.theta.is_some() || powder.executed.is_some()) => {
                "--theta and --executed go with files of powder (vtk, ply, csv with --particles); a motion is that of a plan"
                    .into()
            }
            () if !has_powder && powder.every.is_some() => {
                "--every goes with powder, but a motion has every tick of the plan".into()
            }
            () if has_powder && to_stdout => {
                "powder goes into files, not to standard output: name where by --out".into()
            }
            () if self.json && to_stdout => {
                "--json and the motion would both go to standard output: name a file by --out".into()
            }
            () if is_series && self.force => {
                "--force writes over a file, but powder takes a folder: name one without a series by --out".into()
            }
            () => return Ok(()),
        };
        Err(CliError::Input(sentence))
    }

    /// The kind of files that hold powder alone, if it is that.
    fn series(&self) -> Option<Format> {
        match self.format {
            FormatArg::Vtk => Some(Format::Vtk),
            FormatArg::Ply => Some(Format::Ply),
            FormatArg::Csv if self.powder.particles => Some(Format::Csv),
            FormatArg::Csv | FormatArg::Urscript | FormatArg::Json | FormatArg::Mcap => None,
        }
    }

    fn plan(&self) -> Option<&Path> {
        self.plan.as_deref().or(self.plan_option.as_deref())
    }

    /// What is to be simulated.
    fn task(&self) -> Result<Task, CliError> {
        let PowderArgs { scene, theta, executed, seed, precision, resources, .. } = self.powder.clone();
        let plan = self.plan().map(Path::to_path_buf);
        MotionArgs { scene, theta, plan, executed, seed, precision, resources }.task()
    }

    fn film<'a>(&self, task: &'a Task) -> Result<Film<'a>, CliError> {
        let every = f64::from(self.powder.every.unwrap_or(DEFAULT_EVERY));
        Film::new(task, every * task.scene.time.control_period_s(), |_| 0)
    }

    fn write_series(&self, format: Format, context: &mut Context<'_>) -> Result<(), CliError> {
        let task = self.task()?;
        let film = self.film(&task)?;
        let bench = film.bench();
        let usual = || Path::new("export").join(format!("{}-{}", safe_name(&bench.name), self.format.name()));
        let folder = self.out.clone().unwrap_or_else(usual);
        let mut series = Series::new(&bench, format, &folder, 1)?;
        film.shoot(&mut series, context)?;
        if self.json {
            let powder = Some(Frames::from(&bench));
            let name = self.format.name();
            return context.json(&Exported {
                path: &folder,
                format: name,
                motion: None,
                powder,
                arm: None,
                transit: None,
            });
        }
        writeln!(
            context.out,
            "{} frames of {} particles, {} s apart, are in {}.",
            bench.frames,
            bench.particles,
            bench.period_s,
            folder.display()
        )?;
        Ok(())
    }

    fn write_motion(&self, context: &mut Context<'_>) -> Result<(), CliError> {
        let plan = self.plan().unwrap_or(Path::new(""));
        let (motion, program) = self.motion(plan)?;
        let task = (self.powder.particles || self.powder.scene.is_some()).then(|| self.task()).transpose()?;
        let usual = || plan.with_extension(self.format.ending());
        let destination = Destination::new(self.out.clone().unwrap_or_else(usual), self.force)?;
        let powder = match task.filter(|_| self.powder.particles) {
            Some(task) => {
                let film = self.film(&task)?;
                destination.record(&motion, &film, context)?;
                Some(Frames::from(&film.bench()))
            }
            None => {
                destination.write(context.out, |out| self.write_to(out, &motion, program.as_ref()))?;
                None
            }
        };
        if self.json {
            let arm = motion.arm.as_ref().map(ArmUse::from);
            let (path, format) = (destination.path(), self.format.name());
            let motion = Some(Ticks::from(&motion));
            let transit = program.as_ref().map(TransitUse::from);
            return context.json(&Exported { path, format, motion, powder, arm, transit });
        }
        let written = powder.map_or(String::new(), |Frames { frames, particles, .. }| {
            format!(", with {frames} frames of {particles} particles")
        });
        let around = program.as_ref().map_or(String::new(), Program::text);
        let text = format!("{destination}: {}{written}.\n{}{around}", ticks(&motion), self.text(&motion));
        let words =
            if destination.is_stdout() { &mut context.err as &mut dyn Write } else { &mut *context.out };
        words.write_all(text.as_bytes())?;
        Ok(())
    }

    /// The motion of the plan, and of the arm where there is one; and what a program makes around it, if it is one.
    fn motion(&self, path: &Path) -> Result<(Motion, Option<Program>), CliError> {
        let wrong = |why: String| CliError::Input(format!("{} {why}", path.display()));
        let bytes = read_plan_file(path)?;
        let plan = parse_plan(path, &bytes)?;
        let broken = |violation| wrong(format!("breaks its own limits: {violation}; make it anew"));
        let mut motion = Motion::new(&plan).map_err(broken)?;
        if self.format == FormatArg::Urscript && motion.path.last_tick() > urscript::MAX_TICKS {
            return Err(wrong(format!(
                "has {} ticks, but a URScript program of more than {} is more than a controller loads; write mcap or csv \
                 and send that by UR's ROS driver or RTDE",
                motion.path.last_tick(),
                urscript::MAX_TICKS
            )));
        }
        let cycle_us = self.arm.cycle_us(&motion);
        if self.format == FormatArg::Urscript && motion.path.period_us < CYCLE_US {
            return Err(wrong(format!(
                "has {} ticks a second, but UR's controller takes no more than {} setpoints; a plan of a scene with \
                 time.control_period_us = {CYCLE_US} at least would be right",
                1_000_000 / motion.path.period_us,
                1_000_000 / CYCLE_US
            )));
        }
        if cycle_us > motion.path.period_us {
            let [asked, ticks] = [cycle_us, motion.path.period_us].map(|period_us| 1_000_000 / period_us);
            return Err(CliError::Input(format!(
                "--rate is {asked}, but {} has {ticks} ticks a second, and what is between fewer setpoints nobody looks at; {ticks} or \
                 more would be right",
                path.display()
            )));
        }
        let Some(setting) = self.setting(path, plan.header())? else { return Ok((motion, None)) };
        let Setting { mount, surroundings, .. } = &setting;
        let arm = ArmMotion::new(&motion.path, mount, surroundings, cycle_us).map_err(|refusal| {
            let how =
                if self.arm.arm.is_some() { "; --base, --tool, --near, --rate say otherwise" } else { "" };
            wrong(format!("is no motion for this arm: {refusal}{how}"))
        })?;
        let program =
            (self.format == FormatArg::Urscript).then(|| self.program(path, &motion, &arm, &setting));
        let program = program.transpose()?;
        motion.arm = Some(arm);
        Ok((motion, program))
    }

    /// The arm that is asked for, or else the plan's own, and what is around it.
    fn setting(&self, path: &Path, header: &PlanHeader) -> Result<Option<Setting>, CliError> {
        let scene = match &self.powder.scene {
            Some(_) => Some(self.task()?.scene),
            None => match scene_found(path, header) {
                Ok(scene) => Some(scene),
                // What lies beside the plan and is not its scene is no scene that is not known.
                Err(error) if path.with_file_name(SCENE).exists() => return Err(error),
                Err(_) => None,
            },
        };
        let scene = match (self.arm.table, scene) {
            // The table that is named, for the tool as for the links.
            (Some(table_m), Some(scene)) if scene.arm.is_some() => Some(scene.with(|spec| {
                spec.arm.iter_mut().for_each(|arm| arm.table_height_m = table_m);
            })?),
            (_, scene) => scene,
        };
        let Some(mount) = self.arm.mount(header, scene.as_ref()) else {
            return match self.needs_arm() {
                Some(what) => Err(CliError::Input(format!(
                    "{what} needs an arm, and {} was made for a scene without [arm]: give --arm, --base X,Y,Z,R,P,Y and --tool \
                     X,Y,Z,R,P,Y",
                    path.display()
                ))),
                None => Ok(None),
            };
        };
        let surroundings = self.arm.surroundings(scene.as_ref(), &mount);
        Ok(Some(Setting { mount, surroundings, scene }))
    }

    /// What a program makes around the motion.
    fn program(
        &self,
        path: &Path,
        motion: &Motion,
        arm: &ArmMotion,
        setting: &Setting,
    ) -> Result<Program, CliError> {
        let Setting { mount, surroundings, scene } = setting;
        let scene = scene.as_ref();
        let home = self.arm.home.map(|joints| joints.map(f64::to_radians));
        let cycle_us = self.arm.cycle_us(motion);
        let around = Around { mount, surroundings, scene, home, cycle_us };
        let transit = Transit::new(&motion.path, arm, &around)
            .map_err(|error| CliError::Input(format!("{} gets no program: {error}", path.display())))?;
        let payload_kg = scene.and_then(|scene| scene.arm.as_ref()?.payload_kg);
        let (label, most_kg) = (mount.kind.label(), mount.kind.figures().payload_kg);
        if let Some(payload_kg) = payload_kg.filter(|payload_kg| *payload_kg > most_kg) {
            return Err(CliError::Input(format!(
                "the scene's arm.payload_kg is {payload_kg}, but the {label} of --arm carries {most_kg} kg at the most"
            )));
        }
        let speed = self.arm.speed.unwrap_or(1.0);
        let opens = |gate: &&Gate| gate.opens_at_s < motion.path.duration_s();
        let gate = scene.and_then(|scene| scene.gates.iter().find(opens)).filter(|_| speed < 1.0);
        if let Some(gate) = gate {
            return Err(CliError::Input(format!(
                "--speed is {speed}, but gate {:?} opens by the clock, {} s after the motion's start, and a slower tool would meet it \
                 elsewhere; no --speed would be right",
                gate.name,
                about(gate.opens_at_s, 3)
            )));
        }
        Ok(Program { transit, payload_kg, speed, knows_scene: scene.is_some() })
    }

    /// What was asked for that goes with an arm only.
    fn needs_arm(&self) -> Option<&'static str> {
        let ArmArgs { near, table, rate, .. } = self.arm;
        match () {
            // And with it --home and --speed.
            () if self.format == FormatArg::Urscript => Some("--format urscript"),
            () if near.is_some() => Some("--near"),
            () if table.is_some() => Some("--table"),
            () if rate.is_some() => Some("--rate"),
            () => None,
        }
    }

    fn write_to(&self, out: &mut dyn Write, motion: &Motion, program: Option<&Program>) -> io::Result<()> {
        match (self.format, &motion.arm, program) {
            (_, Some(arm), Some(Program { transit, payload_kg, speed, knows_scene })) => {
                let (speed, payload_kg) = (*speed, *payload_kg);
                let cycle_us = self.arm.cycle_us(motion);
                let knows_scene = *knows_scene;
                urscript::Program { motion, arm, transit, cycle_us, speed, payload_kg, knows_scene }
                    .write(out)
            }
            (FormatArg::Json, ..) => table::write_json(out, motion),
            (FormatArg::Mcap, ..) => mcap::write(out, motion),
            _ => table::write_csv(out, motion),
        }
    }

    /// Sentences on what the arm has to do.
    fn text(&self, motion: &Motion) -> String {
        let Some(ArmMotion { model, figures, .. }) = &motion.arm else { return String::new() };
        let Figures { fastest_joint, speed_rad_s, singular_joint, margin, limit_use, .. } = figures;
        let share = 100.0 * speed_rad_s / model.joint_speed_rad_s[fastest_joint - 1];
        let percent = |share: f64| format!("{:.0} %", 100.0 * share);
        let PeakUse {
            linear_velocity,
            linear_acceleration,
            linear_jerk,
            angular_velocity,
            angular_acceleration,
            angular_jerk,
        } = *limit_use;
        format!(
            "The {} {}. {}\n\
             Joint {fastest_joint} comes nearest to its speed, {speed_rad_s:.2} rad/s \
             ({share:.0} %); joint {singular_joint} nearest to a singularity, {margin:.2} (1 is best, {:.2} the least).\n\
             Looked at every {} ms it uses, of the plan's limits: linear velocity {}, acceleration {}, jerk {}; angular \
             velocity {}, acceleration {}, jerk {}.\n",
            model.kind.label(),
            model.posture,
            clearance_words(figures),
            model.singularity_margin,
            f64::from(self.arm.cycle_us(motion)) / 1e3,
            percent(linear_velocity),
            percent(linear_acceleration),
            percent(linear_jerk),
            percent(angular_velocity),
            percent(angular_acceleration),
            percent(angular_jerk),
        )
    }
}

/// An arm, and what is around it as far as it is known.
struct Setting {
    mount: Mount,
    surroundings: Surroundings,
    scene: Option<Scene>,
}

/// What was written, as JSON.
#[derive(Debug, Serialize)]
struct Exported<'a> {
    path: &'a Path,
    format: &'static str,
    motion: Option<Ticks>,
    powder: Option<Frames>,
    arm: Option<ArmUse>,
    transit: Option<TransitUse>,
}

/// A motion's length.
#[derive(Debug, Serialize)]
struct Ticks {
    ticks: usize,
    period_us: u32,
    duration_s: f64,
}

impl From<&Motion> for Ticks {
    fn from(motion: &Motion) -> Self {
        Self {
            ticks: motion.path.last_tick(),
            period_us: motion.path.period_us,
            duration_s: motion.path.duration_s(),
        }
    }
}

/// A series of powder.
#[derive(Clone, Copy, Debug, Serialize)]
struct Frames {
    frames: usize,
    particles: usize,
    period_s: f64,
}

impl From<&Bench> for Frames {
    fn from(bench: &Bench) -> Self {
        Self { frames: bench.frames, particles: bench.particles, period_s: bench.period_s }
    }
}

fn ticks(motion: &Motion) -> String {
    format!(
        "{} ticks of {} ms, {:.2} s",
        motion.path.last_tick(),
        motion.path.period_us as f64 / 1e3,
        motion.path.duration_s()
    )
}

impl ArmArgs {
    /// The arm that is asked for, or else the plan's own, in the posture that it was found possible in.
    fn mount(&self, header: &PlanHeader, scene: Option<&Scene>) -> Option<Mount> {
        let near = self.near.map(|joints| joints.map(f64::to_radians));
        let of_scene = scene.and_then(|scene| scene.arm.as_ref());
        // What is kept of something that is known.
        let is_known = self.table.is_some() || scene.is_some();
        let clearance_m = of_scene.map(|arm| arm.clearance_m).or(is_known.then_some(CLEARANCE_M));
        if let (Some(kind), Some(world_from_base), Some(flange_from_tool)) = (self.arm, self.base, self.tool)
        {
            return Some(Mount { kind, world_from_base, flange_from_tool, posture: None, near, clearance_m });
        }
        let mount = Mount::of_plan(&header.arm?, clearance_m);
        Some(Mount { posture: mount.posture.filter(|_| near.is_none()), near, ..mount })
    }

    /// Table, containers and gates, as far as they are known. A table of which nobody says how high it is is as high as the base that stands
    /// on it, and no higher than the bench.
    fn surroundings(&self, scene: Option<&Scene>, mount: &Mount) -> Surroundings {
        let of_scene = scene.and_then(|scene| scene.arm.as_ref()).map(|arm| arm.table_height_m);
        let of_base = mount.world_from_base.position_m[2].min(0.0);
        let table_m = self.table.or(of_scene).unwrap_or(of_base);
        scene.map_or_else(|| Surroundings::table(table_m), |scene| Surroundings::of_scene(scene, table_m))
    }

    /// From setpoint to setpoint; what is between ticks is looked at as often.
    fn cycle_us(&self, motion: &Motion) -> u32 {
        self.rate.map_or(CYCLE_US.min(motion.path.period_us), |rate| 1_000_000 / rate)
    }
}

/// Numbers with commas between them, as many as have `names`.
fn parse_numbers<const N: usize>(text: &str, names: &str) -> Result<[f64; N], String> {
    let right = || format!("{N} numbers with commas between them would be right: {names}");
    let number = |part: &str| {
        let part = part.trim();
        part.parse()
            .ok()
            .filter(|number: &f64| number.is_finite())
            .ok_or(format!("`{part}` is no number; {}", right()))
    };
    let numbers = text.split(',').map(number).collect::<Result<Vec<f64>, _>>()?;
    numbers.try_into().map_err(|numbers: Vec<f64>| format!("there are {}; {}", numbers.len(), right()))
}

fn parse_pose(text: &str) -> Result<Pose, String> {
    let [x, y, z, roll, pitch, yaw] =
        parse_numbers(text, "x, y, z in metres, then roll, pitch, yaw in degrees")?;
    Ok(arm::pose([x, y, z], [roll, pitch, yaw]))
}

/// Arms by their names.
fn kinds() -> impl TypedValueParser<Value = ArmKind> {
    let named = |name: String| ArmKind::ALL.into_iter().find(|kind| kind.name() == name);
    PossibleValuesParser::new(ArmKind::ALL.map(ArmKind::name))
        .map(move |name| named(name).expect("one of the possible values"))
}

fn parse_joints(text: &str) -> Result<Joints, String> {
    parse_numbers(text, "degrees, from the base to the flange")
}

fn parse_speed(text: &str) -> Result<f64, String> {
    let least = urscript::LEAST_SPEED;
    let share = text.parse().ok().filter(|share| (least..=1.0).contains(share));
    share.ok_or(format!("a share of full speed from {least} to 1 would be right, such as 0.1"))
}

fn parse_height(text: &str) -> Result<f64, String> {
    let height = text.parse().ok().filter(|height: &f64| (-10.0..=0.0).contains(height));
    height.ok_or("a height in metres from -10 to 0, the bench's, would be right".into())
}

fn parse_rate(text: &str) -> Result<u32, String> {
    let most = urscript::CONTROLLER_HZ;
    let rate = text.parse().ok().filter(|rate| (1..=most).contains(rate) && most.is_multiple_of(*rate));
    rate.ok_or(format!(
        "the controller takes {most} setpoints a second or a whole part of that: 500, 250, 125, 100, 50, ..."
    ))
}
