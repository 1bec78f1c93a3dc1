//! One HTML file that holds everything: numbers, curves, and a replay in 3-D of powder and tool.
//!
//! It asks for nothing over a network and opens from disk. A page needs no replay.
//!
//! ```
//! use powderline_view::page::{Chart, Page, Series};
//!
//! # fn main() -> Result<(), powderline_view::ViewError> {
//! # let folder = tempfile::tempdir().expect("a folder");
//! # let path = folder.path().join("report.html");
//! let loss = Series::new("gradient", vec![[0.0, 1344.6], [1.0, 1301.2]]);
//! let page = Page {
//!     title: "bench, seed 1".into(),
//!     summary: vec![("Loss".into(), "1301.2 m".into())],
//!     charts: vec![Chart::new("Loss", "epoch", "loss, m", vec![loss])],
//!     ..Page::default()
//! };
//! page.write(&path)
//! # }
//! ```
//!
//! A replay comes from a [`Recorder`], which takes the frames like every other [`Sink`](crate::Sink):
//! `page.replay = recorder.into_replay()`.

mod html;
mod replay;

use std::fs;
use std::io::Write as _;
use std::path::{Path, PathBuf};

use serde::Serialize;

use crate::ViewError;
pub use replay::{BUDGET_BYTES, Recorder, Replay};

/// What a page shows, from top to bottom. Texts are texts: nothing in them is taken for HTML.
#[derive(Clone, Debug, Default)]
pub struct Page {
    /// Heading, and name of the window.
    pub title: String,
    /// What each number is, and the number with its unit; shown large.
    pub summary: Vec<(String, String)>,
    /// Powder and tool in motion.
    pub replay: Option<Replay>,
    /// Curves.
    pub charts: Vec<Chart>,
    /// More numbers.
    pub tables: Vec<Table>,
    /// Paragraphs at the end.
    pub notes: Vec<String>,
}

/// A table. Columns whose cells are all numbers, but the first column, stand to the right.
#[derive(Clone, Debug, Default)]
pub struct Table {
    /// Caption.
    pub title: String,
    /// Name of each column, with its unit.
    pub columns: Vec<String>,
    /// Cells, row by row; the first of each names its row.
    pub rows: Vec<Vec<String>>,
}

/// Curves over one axis.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Chart {
    /// Heading.
    pub title: String,
    /// What x is, with its unit.
    pub x_label: String,
    /// What y is, with its unit.
    pub y_label: String,
    /// Curves, in the order of their colours; after six, colours come again, dashed.
    pub series: Vec<Series>,
}

impl Chart {
    /// A chart of what its fields say.
    #[must_use]
    pub fn new(title: &str, x_label: &str, y_label: &str, series: Vec<Series>) -> Self {
        Self { title: title.into(), x_label: x_label.into(), y_label: y_label.into(), series }
    }
}

/// A curve.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Series {
    /// Its name in the legend.
    pub name: String,
    /// x and y, x ascending. A y that is not a number leaves a gap.
    pub points: Vec<[f64; 2]>,
    /// Lowest and highest y at each of the points, drawn as a band behind the curve.
    pub band: Option<Vec<[f64; 2]>>,
}

impl Series {
    /// A curve without a band.
    #[must_use]
    pub fn new(name: &str, points: Vec<[f64; 2]>) -> Self {
        Self { name: name.into(), points, band: None }
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
