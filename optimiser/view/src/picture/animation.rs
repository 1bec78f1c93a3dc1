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

/// Browsers play a picture of a GIF file that is shown for less than two hundredths of a second for ten.
const FASTEST_PER_S: f64 = 50.0;

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
        check_names(files)?;
        if !(1.0..=FASTEST_PER_S).contains(&frames_per_s) {
            let what = format!("{frames_per_s} pictures a second");
            return Err(ViewError::Setting { what, wanted: "it must be 1 to 50" });
        }
        if !(1e-6..=60.0).contains(&bench.period_s) {
            let what = format!("{} s from one frame to the next", bench.period_s);
            return Err(ViewError::Setting { what, wanted: "it must be 0.000001 to 60" });
        }
        let painter = Painter::new(bench, camera, look)?;
        let every = every(bench.period_s, frames_per_s);
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

/// Which frames are kept for about so many pictures a second: never more than browsers play.
fn every(period_s: f64, frames_per_s: f64) -> usize {
    let nearest = (1.0 / (frames_per_s * period_s)).round();
    // Less than a frame's millionth is not time but arithmetic.
    let fewest = (1.0 / (FASTEST_PER_S * period_s) - 1e-6).ceil();
    nearest.max(fewest).max(1.0) as usize
}

/// Two files of one name would be written into each other.
fn check_names(files: &[PathBuf]) -> Result<(), ViewError> {
    files.iter().try_for_each(|path| Kind::of(path).map(drop))?;
    match files.iter().enumerate().find(|(index, path)| files[..*index].contains(path)) {
        None => Ok(()),
        Some((_, path)) => Err(ViewError::Setting {
            what: path.display().to_string(),
            wanted: "each animation must have a name of its own",
        }),
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
        whole?.into_iter().try_for_each(crate::whole::Whole::commit)
    }
}

#[cfg(test)]
mod tests {
    use std::fs::{self, File};
    use std::io::BufReader;
    use std::path::Path;

    use super::*;
    use crate::picture::Image;
    use crate::picture::sample::{bench, frame, look, positions};

    const FRAMES: usize = 21;

    /// Plays all frames: two pictures a second of a motion with four frames a second.
    fn play(files: &[PathBuf], progress: Option<Progress>) -> Result<(), ViewError> {
        let mut animation = Animation::new(&bench(), &Camera::default(), &look(), 2.0, files)?;
        if let Some(progress) = progress {
            animation = animation.with_progress(progress);
        }
        for index in 0..FRAMES {
            animation.frame(&frame(index, &positions(index)))?;
        }
        animation.finish(&[])
    }

    fn directly(index: usize) -> Image {
        let painter = Painter::new(&bench(), &Camera::default(), &look()).expect("settings");
        painter.draw(&frame(index, &positions(index)), &[])
    }

    /// Lays a rectangle of pixels over what is shown, as a viewer does.
    fn lay(shown: &mut Image, corner: [usize; 2], width: usize, rgba: &[u8]) {
        for (at, [red, green, blue, cover]) in rgba.as_chunks::<4>().0.iter().enumerate() {
            shown.blend([corner[0] + at % width, corner[1] + at / width], [*red, *green, *blue], *cover);
        }
    }

    fn blank() -> Image {
        Image { width_px: 96, height_px: 72, rgb: vec![0; 3 * 96 * 72] }
    }

    /// Mean and largest difference of the channels.
    fn difference(one: &Image, other: &Image) -> (f64, u8) {
        let pairs = || one.rgb.iter().zip(&other.rgb).map(|(one, other)| one.abs_diff(*other));
        (pairs().map(f64::from).sum::<f64>() / one.rgb.len() as f64, pairs().max().unwrap_or(0))
    }

    #[test]
    fn an_animated_png_file_shows_every_kept_frame_for_its_time() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("motion.apng");
        play(std::slice::from_ref(&path), None).expect("an animation");
        let file = BufReader::new(File::open(path).expect("the file"));
        let mut reader = png::Decoder::new(file).read_info().expect("a PNG file");
        assert_eq!(reader.info().size(), (96, 72));
        assert_eq!(reader.info().animation_control().expect("an animation").num_frames, 11);
        let mut shown = blank();
        let mut rgba = vec![0; reader.output_buffer_size().expect("a size")];
        for picture in 0..11 {
            let info = reader.next_frame(&mut rgba).expect("a picture");
            let control = *reader.info().frame_control().expect("a picture's time");
            let expected_ms = if picture == 10 { 1500 } else { 500 };
            assert_eq!((control.delay_num, control.delay_den), (expected_ms, 1000), "picture {picture}");
            let corner = [control.x_offset as usize, control.y_offset as usize];
            lay(&mut shown, corner, info.width as usize, &rgba[..info.buffer_size()]);
            let (_, most) = difference(&shown, &directly(2 * picture));
            assert!(most <= 2, "picture {picture} is {most} off");
        }
    }

    #[test]
    fn a_gif_file_shows_every_kept_frame_for_its_time() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("motion.gif");
        play(std::slice::from_ref(&path), None).expect("an animation");
        let mut options = gif::DecodeOptions::new();
        options.set_color_output(gif::ColorOutput::RGBA);
        let mut reader = options.read_info(File::open(path).expect("the file")).expect("a GIF file");
        assert_eq!((reader.width(), reader.height()), (96, 72));
        let (mut shown, mut delays_cs) = (blank(), Vec::new());
        while let Some(picture) = reader.read_next_frame().expect("a picture") {
            let corner = [picture.left as usize, picture.top as usize];
            lay(&mut shown, corner, picture.width as usize, &picture.buffer);
            let (mean, _) = difference(&shown, &directly(2 * delays_cs.len()));
            assert!(mean < 4.0, "picture {} is {mean} off", delays_cs.len());
            delays_cs.push(picture.delay);
        }
        assert_eq!(reader.repeat(), gif::Repeat::Infinite);
        assert_eq!(delays_cs, [50, 50, 50, 50, 50, 50, 50, 50, 50, 50, 150]);
    }

    fn names(folder: &Path) -> Vec<String> {
        let entries = fs::read_dir(folder).expect("the folder");
        let mut names: Vec<_> = entries
            .map(|entry| entry.expect("an entry").file_name().to_string_lossy().into_owned())
            .collect();
        names.sort();
        names
    }

    #[test]
    fn who_is_told_of_the_progress_can_stop_it_and_no_file_is_left() {
        let folder = tempfile::tempdir().expect("a folder");
        let files = ["a.gif", "b.png"].map(|name| folder.path().join(name));
        for last in [1, 2] {
            let mut calls = 0;
            let progress = move |done, all| {
                assert!(done <= all && all == 11);
                calls += 1;
                calls < last
            };
            let error = play(&files, Some(Box::new(progress))).expect_err("stopped");
            assert!(matches!(error, ViewError::Stopped), "{error:?}");
            assert_eq!(names(folder.path()), [""; 0]);
        }
        play(&files, Some(Box::new(|_, _| true))).expect("animations");
        assert_eq!(names(folder.path()), ["a.gif", "b.png"]);
    }

    #[test]
    fn the_same_bytes_come_twice_and_with_any_number_of_threads() {
        let folder = tempfile::tempdir().expect("a folder");
        let bytes = [1, 1, 2].map(|threads| {
            let files = ["a.gif", "b.png"].map(|name| folder.path().join(name));
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
            pool.install(|| play(&files, None)).expect("animations");
            files.map(|path| fs::read(path).expect("a file"))
        });
        assert!(bytes[0] == bytes[1], "written twice");
        assert!(bytes[0] == bytes[2], "written with two threads");
    }

    #[test]
    fn no_picture_follows_faster_than_browsers_play() {
        // Half as many as wanted, as fifty a second are the most, and two thirds of 0.02 s are too few.
        assert_eq!(
            [every(0.015, 50.0), every(0.01, 50.0), every(0.02, 50.0), every(0.1, 50.0)],
            [2, 2, 1, 1]
        );
        assert_eq!([every(0.01, 25.0), every(0.01, 30.0), every(0.25, 2.0)], [4, 3, 2]);
    }

    #[test]
    fn settings_out_of_range_are_refused_with_one_sentence() {
        let refused = |frames_per_s, period_s, names: &[&str], says: &str| {
            let bench = Bench { period_s, ..bench() };
            let files: Vec<_> = names.iter().map(PathBuf::from).collect();
            let animation = Animation::new(&bench, &Camera::default(), &look(), frames_per_s, &files);
            let sentence = animation.map(drop).expect_err(says).to_string();
            assert!(sentence.contains(says) && !sentence.contains('\n'), "{sentence}");
        };
        for frames_per_s in [0.0, 51.0, -1.0, f64::NAN] {
            refused(frames_per_s, 0.25, &["a.gif"], "pictures a second: it must be 1 to 50");
        }
        refused(2.0, 0.0, &["a.gif"], "from one frame to the next");
        refused(2.0, 0.25, &["a.mp4"], "a.mp4: the name of an animation must end in");
        refused(2.0, 0.25, &["a.gif", "a.png", "a.gif"], "a.gif: each animation must have a name");
        let mut empty = Animation::new(&bench(), &Camera::default(), &look(), 2.0, &[]).expect("settings");
        assert!(empty.finish(&[]).expect_err("no frame").to_string().contains("there must be one"));
    }
}
