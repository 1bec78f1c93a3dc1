//! `optimise render`: pictures and animations of a motion, without a graphics card or a browser.

use super::{CliError, Context, film::Film, motion::MotionArgs, run::safe_name};
use clap::{Args, ValueEnum};
use powderline_view::{
    Bench, Destination, Frame, Sink, ViewError,
    picture::{Animation, Camera, Colouring, Containers, Look, Stills},
};
use serde::Serialize;
use std::path::{Path, PathBuf};

/// Pictures of a motion when none are asked for.
const PICTURES: usize = 6;

/// Arguments of `optimise render`.
#[derive(Clone, Debug, Args)]
pub(super) struct RenderArgs {
    /// The motion.
    #[command(flatten)]
    pub motion: MotionArgs,
    /// Moments to draw, seconds from the beginning [default: six over the whole motion, unless there is an --animation]
    #[arg(long, value_name = "S,..", value_delimiter = ',', allow_hyphen_values = true)]
    pub at: Vec<f64>,
    /// Animation of the whole motion, a .gif, .png or .apng file; may be given more than once
    #[arg(long, value_name = "FILE")]
    pub animation: Vec<PathBuf>,
    /// Pictures a second of the animation
    #[arg(long, value_name = "N", default_value = "25")]
    pub rate: f64,
    /// What the powder's colour says
    #[arg(long, value_enum, default_value = "plain")]
    pub colour: Colour,
    /// Walls are cut open instead of translucent
    #[arg(long)]
    pub cut: bool,
    /// Without the arm of the scene or the plan
    #[arg(long)]
    pub no_arm: bool,
    /// The axes of the tool's frame and of the flange's, as [arm] has them: red x, green y, blue z
    #[arg(long)]
    pub axes: bool,
    /// What the picture shows at zoom 1
    #[arg(long, value_enum, default_value = "bench")]
    pub frame: Framing,
    /// Width and height, pixels
    #[arg(long, value_name = "WxH", default_value = "1280x960", value_parser = parse_size)]
    pub size: [usize; 2],
    /// Direction from which the bench is seen, degrees: 0 from -y, 90 from +x [default: a little aside from the front, or where
    /// there is an arm, from the side opposite to it]
    #[arg(long, value_name = "DEG", allow_hyphen_values = true)]
    pub azimuth: Option<f64>,
    /// Height from which it is seen, degrees above the horizon
    #[arg(long, value_name = "DEG", allow_hyphen_values = true)]
    pub elevation: Option<f64>,
    /// How many times nearer
    #[arg(long, value_name = "TIMES")]
    pub zoom: Option<f64>,
    /// Folder for the pictures
    #[arg(long, value_name = "DIR", default_value = "pictures")]
    pub out: PathBuf,
    /// Print one JSON object
    #[arg(long)]
    pub json: bool,
}

#[derive(Serialize)]
struct Report<'a> {
    files: Vec<&'a Path>,
    /// The arm that is drawn.
    arm: Option<&'static str>,
    /// What there is to be said of it.
    remark: Option<&'a str>,
    /// What makes the command fail, if anything does: then these are the files that there are.
    failure: Option<String>,
}

/// What a picture shows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(super) enum Framing {
    /// Containers, gates and the tool's whole motion; the arm as far as it reaches in
    Bench,
    /// The arm too, from its base on, wherever it goes
    All,
}

/// What the powder's colour says.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(super) enum Colour {
    /// Nothing
    Plain,
    /// How fast it moves
    Speed,
    /// How high it is
    Height,
    /// Where it is in the end
    Destination,
}

/// Faster powder has the colour of this speed, m/s.
const FAST_M_S: f64 = 0.5;

/// Both kinds of pictures, of one simulation.
struct Both {
    stills: Option<Stills>,
    animation: Option<Animation>,
    /// Whether the animation is written.
    is_animated: bool,
}

impl Sink for Both {
    fn frame(&mut self, frame: &Frame<'_>) -> Result<(), ViewError> {
        self.stills.as_mut().map_or(Ok(()), |stills| stills.frame(frame))?;
        self.animation.as_mut().map_or(Ok(()), |animation| animation.frame(frame))
    }

    fn finish(&mut self, destinations: &[Destination]) -> Result<(), ViewError> {
        // The one does not take the other along.
        let stills = self.stills.as_mut().map_or(Ok(()), |stills| stills.finish(destinations));
        let animation = self.animation.as_mut().map_or(Ok(()), |animation| animation.finish(destinations));
        self.is_animated = animation.is_ok();
        stills.and(animation)
    }
}

/// Runs the command.
///
/// # Errors
/// One sentence.
pub(super) fn execute(arguments: &RenderArgs, context: &mut Context<'_>) -> Result<(), CliError> {
    let task = arguments.motion.task()?;
    // Every control step: what moment is nearest to the one that was asked for is seen then.
    let film = Film::new(&task, 0.0, |_| 0)?;
    let film = if arguments.no_arm { film } else { film.with_arm() };
    let bench = film.bench();
    let look = arguments.look(&bench);
    let bench = if arguments.frame == Framing::All { bench.framed_with_arm() } else { bench };
    let camera = arguments.camera(&bench);
    let times = arguments.times(film.duration_s())?;
    let stills = (!times.is_empty())
        .then(|| Stills::new(&bench, &camera, &look, &arguments.out, &safe_name(&bench.name), &times))
        .transpose()?;
    let files = &arguments.animation;
    let interrupt = context.interrupt.clone();
    let watch = move |_, _| !interrupt.is_requested();
    let animation = (!files.is_empty())
        .then(|| Animation::new(&bench, &camera, &look, arguments.rate, files))
        .transpose()?
        .map(|animation| animation.with_progress(Box::new(watch)));
    let mut both = Both { stills, animation, is_animated: false };
    let shot = film.shoot(&mut both, context).map(|_| ());
    let animations = files.iter().filter(|_| both.is_animated);
    let written: Vec<&Path> = both
        .stills
        .iter()
        .flat_map(|stills| stills.written())
        .chain(animations)
        .map(PathBuf::as_path)
        .collect();
    if written.is_empty() {
        return shot;
    }
    if arguments.json {
        let arm = bench.arm.as_ref().map(|arm| arm.motion.model.kind.name());
        let failure = shot.as_ref().err().map(ToString::to_string);
        context.json(&Report { files: written, arm, remark: film.arm_remark(), failure })?;
        return shot;
    }
    for path in written {
        writeln!(context.out, "{}", path.display())?;
    }
    shot
}

impl RenderArgs {
    fn times(&self, duration_s: f64) -> Result<Vec<f64>, CliError> {
        if let Some(time_s) = self.at.iter().find(|time_s| !(0.0..=duration_s + 1e-9).contains(*time_s)) {
            return Err(CliError::Input(format!(
                "--at asks for {time_s} s, but the motion goes from 0 to {duration_s} s"
            )));
        }
        if !self.at.is_empty() || !self.animation.is_empty() {
            return Ok(self.at.clone());
        }
        Ok((1..=PICTURES).map(|index| duration_s * index as f64 / PICTURES as f64).collect())
    }

    fn camera(&self, bench: &Bench) -> Camera {
        let usual = Camera::default();
        Camera {
            azimuth_deg: self.azimuth.unwrap_or(bench.front_deg() + usual.azimuth_deg),
            elevation_deg: self.elevation.unwrap_or(usual.elevation_deg),
            zoom: self.zoom.unwrap_or(usual.zoom),
            ..usual
        }
    }

    fn look(&self, bench: &Bench) -> Look {
        let usual = Look::default();
        let [width_px, height_px] = self.size;
        let colouring = match self.colour {
            Colour::Plain => usual.colouring,
            Colour::Speed => Colouring::Speed { max_m_s: FAST_M_S },
            Colour::Height => Colouring::Height { max_m: bench.extent.high_m[2] },
            Colour::Destination => Colouring::Destination,
        };
        let containers = if self.cut { Containers::CutOpen } else { usual.containers };
        Look { width_px, height_px, colouring, containers, axes: self.axes, ..usual }
    }
}

/// Two whole numbers with an x between them.
fn parse_size(text: &str) -> Result<[usize; 2], String> {
    let numbers =
        text.split_once('x').and_then(|(width, height)| Some([width.parse().ok()?, height.parse().ok()?]));
    numbers.ok_or_else(|| "width and height in pixels, such as 1280x960, would be right".into())
}
