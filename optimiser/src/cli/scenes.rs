//! `optimise scenes`: what comes with the program.

use super::{CliError, Context};
use crate::report::words::grouped;
use clap::Args;
use powderline_simulator::scene::{EMBEDDED_SCENES, Scene, figures::about};
use serde::Serialize;

/// Arguments of `optimise scenes`.
#[derive(Clone, Debug, Args)]
pub(super) struct ScenesArgs {
    /// Print one JSON object
    #[arg(long)]
    pub json: bool,
}

#[derive(Serialize)]
struct Report {
    scenes: Vec<Row>,
}

#[derive(Serialize)]
struct Row {
    name: &'static str,
    /// What is in it.
    about: String,
    particles: usize,
    particle_mass_kg: f64,
    /// Particles wanted in the target container.
    target_particles: usize,
}

/// Runs the command.
///
/// # Errors
/// One sentence.
pub(super) fn execute(arguments: &ScenesArgs, context: &mut Context<'_>) -> Result<(), CliError> {
    let rows = EMBEDDED_SCENES.into_iter().map(|(name, text)| Row::new(name, text));
    let scenes = rows.collect::<Result<Vec<Row>, CliError>>()?;
    if arguments.json {
        return context.json(&Report { scenes });
    }
    writeln!(context.out, "{:<12}{:>10}  {:<18}what is in it", "scene", "particles", "wanted")?;
    for row in &scenes {
        writeln!(context.out, "{}", row.line())?;
    }
    Ok(())
}

impl Row {
    fn new(name: &'static str, text: &str) -> Result<Self, CliError> {
        let scene = Scene::from_toml(name, text)?;
        Ok(Self {
            name,
            about: first_remark(text),
            particles: scene.particle_count(),
            particle_mass_kg: scene.particle_mass_kg(),
            target_particles: scene.target_count(),
        })
    }

    fn line(&self) -> String {
        let wanted = self.target_particles;
        let wanted_g = about(1e3 * self.particle_mass_kg * wanted as f64, 3);
        let wanted = format!("{} ({wanted_g} g)", grouped(wanted as i64));
        format!("{:<12}{:>10}  {wanted:<18}{}", self.name, grouped(self.particles as i64), self.about)
    }
}

/// The first line of a scene's text, which says what the scene is.
fn first_remark(text: &str) -> String {
    text.lines().next().unwrap_or_default().trim_start_matches(['#', ' ']).into()
}
