//! Single moments.

use std::path::PathBuf;

use super::{Camera, Look, Moment, Painter};
use crate::{Bench, Destination, Frame, Sink, ViewError};

/// Keeps the frames nearest to chosen times, and writes each as `NAME-0001.230s.png` when all is over.
pub struct Stills {
    painter: Painter,
    folder: PathBuf,
    name: String,
    /// Each chosen time with the nearest frame so far.
    kept: Vec<(f64, Option<Moment>)>,
    written: Vec<PathBuf>,
}

impl Stills {
    /// For files in `folder`, which is made, that begin with `name`. Of two frames as near, the earlier one is kept.
    ///
    /// # Errors
    /// If a number of the camera or the look is out of its range, or a time is none.
    pub fn new(
        bench: &Bench,
        camera: &Camera,
        look: &Look,
        folder: impl Into<PathBuf>,
        name: &str,
        times_s: &[f64],
    ) -> Result<Self, ViewError> {
        if let Some(time_s) = times_s.iter().find(|time_s| !time_s.is_finite()) {
            let what = format!("a picture at {time_s} s");
            return Err(ViewError::Setting { what, wanted: "it must be a time of the motion, in seconds" });
        }
        let painter = Painter::new(bench, camera, look)?;
        let kept = times_s.iter().map(|time_s| (*time_s, None)).collect();
        Ok(Self { painter, folder: folder.into(), name: name.to_owned(), kept, written: Vec::new() })
    }

    /// The files, once finished.
    #[must_use]
    pub fn written(&self) -> &[PathBuf] {
        &self.written
    }
}

impl Sink for Stills {
    fn frame(&mut self, frame: &Frame<'_>) -> Result<(), ViewError> {
        for (time_s, kept) in &mut self.kept {
            let distance = (frame.time_s - *time_s).abs();
            if kept.as_ref().is_none_or(|kept| distance < (kept.time_s - *time_s).abs()) {
                *kept = Some(Moment::from(frame));
            }
        }
        Ok(())
    }

    fn finish(&mut self, destinations: &[Destination]) -> Result<(), ViewError> {
        for moment in self.kept.iter().filter_map(|(_, kept)| kept.as_ref()) {
            let path = self.folder.join(format!("{}-{:08.3}s.png", self.name, moment.time_s));
            // Two chosen times may have the same frame.
            if !self.written.contains(&path) {
                self.painter.paint(moment, destinations).write(&path)?;
                self.written.push(path);
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::picture::encode::decoded;
    use crate::picture::sample::{bench, frame, look, positions};

    fn stills(folder: &std::path::Path, times_s: &[f64]) -> Result<Stills, ViewError> {
        Stills::new(&bench(), &Camera::default(), &look(), folder, "view", times_s)
    }

    #[test]
    fn the_nearest_frames_are_written_under_their_times() {
        let folder = tempfile::tempdir().expect("a folder");
        // The second is as near to two frames, the third has the same as the second, the last is after the end.
        let mut stills = stills(folder.path(), &[0.1, 0.375, 0.24, 99.0]).expect("times");
        for index in 0..7 {
            stills.frame(&frame(index, &positions(index))).expect("a frame");
        }
        assert!(stills.written().is_empty());
        stills.finish(&[]).expect("pictures");
        let names = ["view-0000.000s.png", "view-0000.250s.png", "view-0001.500s.png"];
        assert_eq!(stills.written(), names.map(|name| folder.path().join(name)));
        assert_eq!(std::fs::read_dir(folder.path()).expect("the folder").count(), 3);
        let painter = Painter::new(&bench(), &Camera::default(), &look()).expect("settings");
        for (name, index) in names.iter().zip([0, 1, 6]) {
            let bytes = std::fs::read(folder.path().join(name)).expect("a picture");
            assert!(decoded(&bytes) == painter.draw(&frame(index, &positions(index)), &[]), "{name}");
        }
    }

    #[test]
    fn a_time_that_is_none_is_refused() {
        let error = stills("unused".as_ref(), &[0.0, f64::NAN]).map(drop).expect_err("no time");
        assert_eq!(error.to_string(), "a picture at NaN s: it must be a time of the motion, in seconds");
    }
}
