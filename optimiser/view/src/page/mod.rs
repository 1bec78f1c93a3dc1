//! One HTML file that holds everything: numbers, curves, and a replay in 3-D of powder and tool.
//!
//! It asks for nothing over a network and opens from disk. A page needs no replay.
//!
//! ```
//! use powderline_view::page::{Chart, Figure, Mark, Page, Scale, Series, Tone};
//!
//! # fn main() -> Result<(), powderline_view::ViewError> {
//! # let folder = tempfile::tempdir().expect("a folder");
//! # let path = folder.path().join("report.html");
//! let loss = Series::new("loss", vec![[0.0, 95.5], [1.0, 40.2], [2.0, 15.2], [3.0, 14.9]]);
//! let chart = Chart::new("Loss", "epoch", "loss, m", vec![loss])
//!     .scaled(Scale::LogIfWide)
//!     .marked(2.0, Mark::shipped())
//!     .marked(3.0, Mark::passed_over("the tool would pass through container \"target\" at 3.21 s"))
//!     .shaded(0.0, 2.0, "only depth, angle and lift change");
//! let page = Page {
//!     title: "bench, seed 1".into(),
//!     verdict: Some((Tone::Bad, "Misses the wanted amount by 7 %.".into())),
//!     figures: vec![
//!         Figure::new("Wanted", "9.60 g"),
//!         Figure::new("Arrives", "8.93 g").with_note("1,116 of 1,200 particles"),
//!         Figure::new("Error", "-7 %").toned(Tone::Bad),
//!     ],
//!     charts: vec![chart],
//!     facts: vec![("Scene".into(), "bench".into())],
//!     ..Page::default()
//! };
//! page.write(&path)
//! # }
//! ```
//!
//! A replay comes from a [`Recorder`], which takes the frames like every other [`Sink`](crate::Sink):
//! `page.replay = recorder.into_replay()`.

mod chart;
mod html;
mod replay;

use std::fs;
use std::io::Write as _;
use std::path::{Path, PathBuf};

use crate::ViewError;
pub use chart::{Chart, Mark, MarkKind, Scale, Series, Shade};
pub use replay::{BUDGET_BYTES, Recorder, Replay};

/// What a page shows, from top to bottom. Texts are texts: nothing in them is taken for HTML.
#[derive(Clone, Debug, Default)]
pub struct Page {
    /// Heading, and name of the window.
    pub title: String,
    /// What is to be known before everything else, in one sentence, and whether it is good.
    pub verdict: Option<(Tone, String)>,
    /// Numbers shown large.
    pub figures: Vec<Figure>,
    /// Powder and tool in motion.
    pub replay: Option<Replay>,
    /// What is replayed: plan or motion as executed, epoch, method, seed. Shown above the replay.
    pub replay_shows: String,
    /// Curves.
    pub charts: Vec<Chart>,
    /// Tables whose cells are coloured by how good they are.
    pub heat_maps: Vec<HeatMap>,
    /// What all of it is about and comes from, each with its name: scene, powder, limits, digest, versions, date.
    pub facts: Vec<(String, String)>,
    /// More numbers.
    pub tables: Vec<Table>,
    /// Paragraphs at the end.
    pub notes: Vec<String>,
}

/// Whether something is as it was wanted. Said by colour and by a sign, so that no reader depends on the colour.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Tone {
    /// As wanted.
    Good,
    /// Not as wanted.
    Bad,
    /// Neither.
    #[default]
    Plain,
}

/// A number at the top of a page.
#[derive(Clone, Debug, Default)]
pub struct Figure {
    /// What it is.
    pub name: String,
    /// The number with its unit.
    pub value: String,
    /// Small print below, or nothing.
    pub note: String,
    /// Whether it is a good one.
    pub tone: Tone,
}

impl Figure {
    /// A figure that is neither good nor bad, with nothing below.
    #[must_use]
    pub fn new(name: &str, value: &str) -> Self {
        Self { name: name.into(), value: value.into(), ..Self::default() }
    }

    /// With small print below it.
    #[must_use]
    pub fn with_note(self, note: &str) -> Self {
        Self { note: note.into(), ..self }
    }

    /// Shown as good or bad.
    #[must_use]
    pub fn toned(self, tone: Tone) -> Self {
        Self { tone, ..self }
    }
}

/// A table. Columns whose cells are all numbers, but the first column, stand to the right.
#[derive(Clone, Debug, Default)]
pub struct Table {
    /// Caption.
    pub title: String,
    /// Name of each column, with its unit.
    pub columns: Vec<String>,
    /// Cells, row by row; the first of each names its row.
    pub rows: Vec<Row>,
}

/// A table whose cells are coloured.
#[derive(Clone, Debug, Default)]
pub struct HeatMap {
    /// Caption.
    pub title: String,
    /// What rows and columns are, such as `powder`, `amount`.
    pub axes: [String; 2],
    /// Name of each column.
    pub columns: Vec<String>,
    /// Name of each row, and its cells, one for each column; none where there is nothing.
    pub rows: Vec<(String, Vec<Option<Heat>>)>,
}

/// A cell of a heat map.
#[derive(Clone, Debug, Default)]
pub struct Heat {
    /// What it says.
    pub text: String,
    /// More of it, or nothing, in small print.
    pub note: String,
    /// Which colour.
    pub tone: Tone,
    /// How much of it, from 0 to 1.
    pub strength: f64,
}

/// A row of a table.
#[derive(Clone, Debug, Default)]
pub struct Row {
    /// One for each column.
    pub cells: Vec<String>,
    /// Where the row's name leads, an address relative to the page.
    pub link: Option<String>,
    /// What makes the row stand out; said in a last column of its own.
    pub mark: Option<Mark>,
}

impl From<Vec<String>> for Row {
    /// A row like any other.
    fn from(cells: Vec<String>) -> Self {
        Self { cells, ..Self::default() }
    }
}

impl Row {
    /// The row, marked, if there is a mark.
    #[must_use]
    pub fn marked(self, mark: Option<Mark>) -> Self {
        Self { mark, ..self }
    }

    /// The row, leading there, if it leads anywhere.
    #[must_use]
    pub fn linked(self, link: Option<String>) -> Self {
        Self { link, ..self }
    }
}

impl Page {
    /// The page as HTML.
    #[must_use]
    pub fn to_html(&self) -> String {
        html::page(self)
    }

    /// Writes the page to a file: beside it first, and then in its place, so that nobody finds half of one.
    ///
    /// # Errors
    /// The system's, with the file's name.
    pub fn write(&self, path: &Path) -> Result<(), ViewError> {
        let part = part_of(path);
        let written = write_through(&part, self.to_html().as_bytes()).and_then(|()| fs::rename(&part, path));
        written.map_err(|source| {
            // It may not even be there.
            let _ = fs::remove_file(&part);
            ViewError::File { path: path.into(), source }
        })
    }
}

/// The file's name while it is being written.
fn part_of(path: &Path) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(".part");
    name.into()
}

fn write_through(path: &Path, bytes: &[u8]) -> std::io::Result<()> {
    let mut file = fs::File::create(path)?;
    file.write_all(bytes)?;
    file.sync_all()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pages_are_written_whole_or_not_at_all() {
        let folder = tempfile::tempdir().expect("a folder");
        let page = Page { title: "Title".into(), ..Page::default() };
        let path = folder.path().join("report.html");
        page.write(&path).expect("a page");
        page.write(&path).expect("a page in place of a page");
        assert_eq!(fs::read_to_string(&path).expect("the page"), page.to_html());
        assert_eq!(fs::read_dir(folder.path()).expect("the folder").count(), 1);

        fs::create_dir_all(folder.path().join("taken/inner")).expect("a folder");
        let taken = folder.path().join("taken");
        let error = page.write(&taken).expect_err("a folder is there").to_string();
        assert!(error.contains("taken cannot be written"), "{error}");
        assert!(!part_of(&taken).exists());
    }
}
