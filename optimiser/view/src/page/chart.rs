//! Curves, and what stands out in them. The page's script reads the fields by their names.

use serde::Serialize;

/// Curves over one axis.
///
/// Where all x are whole numbers, so are the marks of the axis; the same goes for y.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Chart {
    /// Heading.
    pub title: String,
    /// What x is, with its unit.
    pub x_label: String,
    /// What y is, with its unit.
    pub y_label: String,
    /// How y goes up.
    pub y_scale: Scale,
    /// Curves, in the order of their colours; after six, colours come again, dashed.
    pub series: Vec<Series>,
    /// Places on the x axis that stand out.
    pub marks: Vec<(f64, Mark)>,
    /// A part of the x axis that stands out.
    pub shade: Option<Shade>,
}

impl Chart {
    /// A chart of what its fields say, linear, in which nothing stands out.
    #[must_use]
    pub fn new(title: &str, x_label: &str, y_label: &str, series: Vec<Series>) -> Self {
        let [title, x_label, y_label] = [title, x_label, y_label].map(String::from);
        Self { title, x_label, y_label, series, ..Self::default() }
    }

    /// With another scale for y.
    #[must_use]
    pub fn scaled(self, y_scale: Scale) -> Self {
        Self { y_scale, ..self }
    }

    /// With one more mark, at every curve's point of this x.
    #[must_use]
    pub fn marked(mut self, x: f64, mark: Mark) -> Self {
        self.marks.push((x, mark));
        self
    }

    /// With a shaded part, and what the legend says of it.
    #[must_use]
    pub fn shaded(self, from: f64, to: f64, label: &str) -> Self {
        Self { shade: Some(Shade { from, to, label: label.into() }), ..self }
    }
}

/// How an axis goes up.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Scale {
    /// Equal steps for equal differences.
    #[default]
    Linear,
    /// Equal steps for equal ratios, if the curves are above zero and span more than a decade; said at the axis.
    LogIfWide,
    /// Equal steps for equal differences, from 0 to 1.
    Share,
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
    /// Number of its colour, for what appears in several charts; by default, its place in this one.
    pub colour: Option<usize>,
    /// Only something to hold the other curves against: drawn dotted and grey, without marks.
    pub reference: bool,
}

impl Series {
    /// A curve without a band.
    #[must_use]
    pub fn new(name: &str, points: Vec<[f64; 2]>) -> Self {
        Self { name: name.into(), points, ..Self::default() }
    }

    /// A curve that others are held against.
    #[must_use]
    pub fn reference(name: &str, points: Vec<[f64; 2]>) -> Self {
        Self { reference: true, ..Self::new(name, points) }
    }

    /// In the colour of this number.
    #[must_use]
    pub fn coloured(self, colour: usize) -> Self {
        Self { colour: Some(colour), ..self }
    }
}

/// A part of the x axis.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Shade {
    /// Where it begins.
    pub from: f64,
    /// Where it ends.
    pub to: f64,
    /// What the legend says.
    pub label: String,
}

/// Why a point of a curve or a row of a table stands out.
#[derive(Clone, Debug, Serialize)]
pub struct Mark {
    /// Which sign it gets.
    pub kind: MarkKind,
    /// A word or two: stand in the legend, and in a table's row.
    pub label: String,
    /// More of it, or nothing: stands where the reader points, and in a table's row.
    pub note: String,
}

/// Signs of marks.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum MarkKind {
    /// What was chosen: a ring, with the label beside it.
    Chosen,
    /// What might have been: a cross.
    PassedOver,
}

impl Mark {
    /// What became the plan.
    #[must_use]
    pub fn shipped() -> Self {
        Self { kind: MarkKind::Chosen, label: "shipped".into(), note: String::new() }
    }

    /// What the plan was made of, and is no more.
    #[must_use]
    pub fn corrected() -> Self {
        let note = "the plan is that skill, corrected by what it brings on smaller cells";
        Self { kind: MarkKind::Chosen, label: "corrected".into(), note: note.into() }
    }

    /// What did not, and why.
    #[must_use]
    pub fn passed_over(reason: &str) -> Self {
        Self { kind: MarkKind::PassedOver, label: "passed over".into(), note: reason.into() }
    }

    /// What is replayed, of several that might have been.
    #[must_use]
    pub fn replayed() -> Self {
        Self { kind: MarkKind::Chosen, label: "replayed".into(), note: String::new() }
    }
}
