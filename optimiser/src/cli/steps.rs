//! The search over displacements, as `optimise compare` runs it.

use super::{CliError, Context, Progress, Setup, run};
use crate::{
    compare::{
        Method, Track, Try,
        steps::{Origin, StepTrack},
    },
    optim::{EpochRecord, steps::StepRule},
    report::amounts::Amounts,
    report::folder::{RunFolder, STATE, TRIES},
    report::words::{count, duration},
};
use powderline_simulator::{
    rollout::{DisplacementGradient, Evaluation, RolloutError, Simulate, Workload},
    scene::Scene,
};
use std::path::Path;

/// A search on its way.
struct Stepping<'a> {
    folder: RunFolder,
    scene: &'a Scene,
    rule: StepRule,
    track: StepTrack,
    /// Updates to make, beside the evaluation before the first.
    epochs: u32,
}

/// The track of a search that is begun, gone on with, or only looked at, in its folder.
///
/// # Errors
/// One sentence; everything evaluated before is saved.
pub(super) fn completed(
    scene: &Scene,
    setup: &Setup,
    epochs: u32,
    path: &Path,
    context: &mut Context<'_>,
) -> Result<Track, CliError> {
    let folder = RunFolder::take(path)?;
    let (seed, precision) = (setup.settings.seed, setup.precision);
    let track = saved(&folder, scene, Origin { scene: scene.digest(), seed, precision })?;
    let mut stepping = Stepping { folder, scene, rule: scene.into(), track, epochs };
    // The state leads: what another session wrote beside it may have a line too many or too few.
    let lines: String = stepping.track.tries.iter().map(run::json_line).collect();
    stepping.folder.replace(TRIES, lines.as_bytes())?;
    if !stepping.is_done() {
        setup.check_memory(scene, Workload::Gradient, 0)?;
        let simulator = (context.factory)(scene, setup)?;
        stepping.go_on(simulator, context)?;
    }
    Ok(Track { method: Method::GradientSteps, seed, tries: stepping.track.tries })
}

/// What an earlier session has left, or else a beginning.
fn saved(folder: &RunFolder, scene: &Scene, origin: Origin) -> Result<StepTrack, CliError> {
    let file = folder.file(STATE);
    if !file.exists() {
        return Ok(StepTrack::new(scene, origin)?);
    }
    let refused = |why: String| CliError::Input(format!("{} cannot be resumed from: {why}", file.display()));
    let track = StepTrack::from_bytes(&folder.read(STATE)?, scene).map_err(|e| refused(e.to_string()))?;
    if track.origin != origin {
        return Err(refused("it was begun with another scene, seed or precision".into()));
    }
    Ok(track)
}

impl Stepping<'_> {
    fn is_done(&self) -> bool {
        self.track.tries.len() > self.epochs as usize
    }

    fn go_on(&mut self, mut simulator: Box<dyn Simulate>, context: &mut Context<'_>) -> Result<(), CliError> {
        let progress = Progress::new(&context.err, context.live);
        simulator.set_progress(progress.watch(&context.interrupt));
        let name = Method::GradientSteps.name();
        let seed = self.track.origin.seed;
        progress.line(&format!(
            "{}: {name}, seed {seed}, {}, into {}",
            self.scene.name,
            count(self.epochs.into(), "epoch"),
            self.folder.path().display()
        ));
        while !self.is_done() {
            let result = self.epoch(simulator.as_mut(), &progress);
            progress.clear();
            result?;
        }
        if let Some(best) = self.track.best() {
            progress.line(&format!(
                "{name}, seed {seed}: lowest loss {:.3} m ({} arrive), {}",
                best.loss,
                Amounts::from(self.scene).powder(best.census.target),
                duration(self.track.tries.last().map_or(0.0, |last| last.seconds))
            ));
        }
        Ok(())
    }

    fn epoch(&mut self, simulator: &mut dyn Simulate, progress: &Progress) -> Result<(), CliError> {
        let (epoch, epochs) = (self.track.tries.len() as u32, self.epochs);
        let history = records(&self.track.tries);
        progress.begin(&format!("epoch {epoch}/{epochs}"), epochs - epoch, &history);
        let found = simulator.simulate_with_gradient(self.track.search().controls());
        let seconds = (progress.seconds() * 1e3).round() / 1e3;
        if let Some(error) = self.take(found, seconds)? {
            progress.line(&format!("{error}; back to the best motion, with half the learning rate"));
        }
        let history = records(&self.track.tries);
        if let Some(record) = history.last() {
            progress.epoch(record, &self.scene.into(), [epochs; 2], &history);
        }
        self.folder.replace(STATE, &self.track.to_bytes())?;
        let line = self.track.tries.last().map(run::json_line).unwrap_or_default();
        Ok(self.folder.append(TRIES, line.as_bytes())?)
    }

    /// Hands the search what was found; why the motion has no loss, if that is what was found.
    fn take(
        &mut self,
        found: Result<(Evaluation, Vec<DisplacementGradient>), RolloutError>,
        seconds: f64,
    ) -> Result<Option<CliError>, CliError> {
        let lost = match found {
            Ok(found) if self.track.take(&self.rule, Some(&found), seconds) => return Ok(None),
            Ok(_) => CliError::Failed("the loss or its gradient is not finite".into()),
            Err(error @ (RolloutError::Escaped { .. } | RolloutError::NonFinite { .. })) => error.into(),
            Err(error) => return Err(error.into()),
        };
        if self.track.take(&self.rule, None, seconds) { Ok(Some(lost)) } else { Err(lost) }
    }
}

/// The epochs as the progress shows them, which has no room for a motion.
fn records(tries: &[Try]) -> Vec<EpochRecord> {
    let mut before = 0.0;
    let record = |(epoch, one): (u32, &Try)| {
        let Try { loss, indicator, census, .. } = *one;
        let seconds = one.seconds - std::mem::replace(&mut before, one.seconds);
        EpochRecord { epoch, loss, indicator, census, seconds, ..EpochRecord::default() }
    };
    (0..).zip(tries).map(record).collect()
}
