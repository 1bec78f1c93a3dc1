//! Whole motions.

use std::path::PathBuf;

use rayon::prelude::*;

use super::encode::{Kind, Movie, palette};
use super::{Camera, Look, Moment, Painter};
use crate::{Bench, Destination, Frame, Sink, ViewError};

/// Pictures drawn at a time.
const BATCH: usize = 8;

/// Pictures that the palette of a GIF file is made from.
const SAMPLES: usize = 8;

/// How long the last picture is shown before the motion begins again, seconds.
const REST_S: f64 = 1.0;

/// Is told how many pictures of how many are drawn; says whether to go on.
pub type Progress = Box<dyn FnMut(usize, usize) -> bool + Send>;

/// Keeps every k-th frame, and writes them as animated PNG or GIF files when all is over.
///
/// They are played as fast as the motion was; the last picture stays for a second. A kept frame takes 16 bytes a particle.
pub struct Animation {
    painter: Painter,
    files: Vec<PathBuf>,
    every: usize,
    period_s: f64,
    kept: Vec<Moment>,
    progress: Option<Progress>,
}

impl Animation {
    /// For about so many pictures a second, 1 to 50 (browsers play GIF files no faster), as files whose names end in
    /// `.gif`, `.png` or `.apng`: the picture is drawn once for all of them.
    ///
    /// # Errors
    /// If a number is out of its range, or a name ends otherwise.
    pub fn new(
        bench: &Bench,
        camera: &Camera,
        look: &Look,
        frames_per_s: f64,
        files: &[PathBuf],
    ) -> Result<Self, ViewError> {
        files.iter().try_for_each(|path| Kind::of(path).map(drop))?;
        if !(1.0..=50.0).contains(&frames_per_s) {
            let what = format!("{frames_per_s} pictures a second");
            return Err(ViewError::Setting { what, wanted: "it must be 1 to 50" });
        }
        if !(1e-6..=60.0).contains(&bench.period_s) {
            let what = format!("{} s from one frame to the next", bench.period_s);
            return Err(ViewError::Setting { what, wanted: "it must be 0.000001 to 60" });
        }
        let painter = Painter::new(bench, camera, look)?;
        let every = ((1.0 / (frames_per_s * bench.period_s)).round() as usize).max(1);
        let period_s = every as f64 * bench.period_s;
        Ok(Self { painter, files: files.to_vec(), every, period_s, kept: Vec::new(), progress: None })
    }

    /// With someone to tell of the progress; where the answer is `false`, [`Sink::finish`] fails with
    /// [`ViewError::Stopped`], and there is no file.
    #[must_use]
    pub fn with_progress(mut self, progress: Progress) -> Self {
        self.progress = Some(progress);
        self
    }

    /// Colours for a GIF file, from a few pictures.
    fn palette(&self, destinations: &[Destination]) -> Vec<super::Rgb> {
        let step = self.kept.len().div_ceil(SAMPLES).max(1);
        // Those from the middle of each stretch.
        let chosen: Vec<_> = self.kept.iter().skip(step / 2).step_by(step).collect();
        let painter = &self.painter;
        let images: Vec<_> =
            chosen.into_par_iter().map(|moment| painter.paint(moment, destinations)).collect();
        palette(&images, self.painter.look.background)
    }
}

impl Sink for Animation {
    fn frame(&mut self, frame: &Frame<'_>) -> Result<(), ViewError> {
        if frame.index.is_multiple_of(self.every) {
            self.kept.push(Moment::from(frame));
        }
        Ok(())
    }

    fn finish(&mut self, destinations: &[Destination]) -> Result<(), ViewError> {
        if self.kept.is_empty() {
            return Err(ViewError::Setting {
                what: "an animation of no frames".to_owned(),
                wanted: "there must be one",
            });
        }
        let is_gif = |path: &PathBuf| Kind::of(path).is_ok_and(|kind| kind == Kind::Gif);
        let colours = if self.files.iter().any(is_gif) { self.palette(destinations) } else { Vec::new() };
        let mut shown_s = vec![self.period_s; self.kept.len()];
        shown_s[self.kept.len() - 1] += REST_S;
        let size_px = [self.painter.look.width_px, self.painter.look.height_px];
        let mut movies = Vec::new();
        for path in &self.files {
            movies.push(Movie::new(path, size_px, &shown_s, &colours)?);
        }
        let mut done = 0;
        for batch in self.kept.chunks(BATCH) {
            let painter = &self.painter;
            let images: Vec<_> = batch.par_iter().map(|moment| painter.paint(moment, destinations)).collect();
            for image in &images {
                movies.iter_mut().try_for_each(|movie| movie.add(image))?;
            }
            done += batch.len();
            if self.progress.as_mut().is_some_and(|progress| !progress(done, self.kept.len())) {
                return Err(ViewError::Stopped);
            }
        }
        let whole: Result<Vec<_>, _> = movies.into_iter().map(Movie::finish).collect();
        whole?.into_iter().try_for_each(super::encode::Whole::commit)
    }
}
