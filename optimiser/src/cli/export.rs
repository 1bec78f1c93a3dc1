//! `optimise export`: a motion as files for other programs.

use super::{CliError, Context, film::Film, motion::MotionArgs, run::safe_name};
use clap::{Args, ValueEnum};
use powderline_view::export::{Format, Series};
use std::path::{Path, PathBuf};

/// Arguments of `optimise export`.
#[derive(Clone, Debug, Args)]
pub(super) struct ExportArgs {
    /// The motion.
    #[command(flatten)]
    pub motion: MotionArgs,
    /// For which programs
    #[arg(long, value_enum)]
    pub format: FormatArg,
    /// Every so many control steps; 1 writes them all
    #[arg(long, value_name = "N", default_value = "2", value_parser = clap::value_parser!(u32).range(1..))]
    pub every: u32,
    /// Folder to write into, without a series in this format [default: export/<scene>-<format>]
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
}

/// A format of particle series.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(super) enum FormatArg {
    /// XML PolyData and a collection of it, for ParaView
    Vtk,
    /// Binary PLY, for MeshLab
    Ply,
    /// Tables, for pandas and spreadsheets
    Csv,
}

impl FormatArg {
    fn name(self) -> &'static str {
        match self {
            Self::Vtk => "vtk",
            Self::Ply => "ply",
            Self::Csv => "csv",
        }
    }
}

impl From<FormatArg> for Format {
    fn from(argument: FormatArg) -> Self {
        match argument {
            FormatArg::Vtk => Self::Vtk,
            FormatArg::Ply => Self::Ply,
            FormatArg::Csv => Self::Csv,
        }
    }
}

/// Runs the command.
///
/// # Errors
/// One sentence.
pub(super) fn execute(arguments: &ExportArgs, context: &mut Context<'_>) -> Result<(), CliError> {
    let task = arguments.motion.task()?;
    let film = Film::new(&task, f64::from(arguments.every) * task.scene.time.control_period_s())?;
    let bench = film.bench();
    let usual =
        || Path::new("export").join(format!("{}-{}", safe_name(&bench.name), arguments.format.name()));
    let folder = arguments.out.clone().unwrap_or_else(usual);
    let mut series = Series::new(&bench, arguments.format.into(), &folder, 1)?;
    film.shoot(&mut series, context)?;
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
