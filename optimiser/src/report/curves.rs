//! `curves.svg`: loss, indicator and theta against the epoch, one above the other.

use crate::optim::EpochRecord;
use plotters::{
    coord::{Shift, types::RangedCoordf64},
    prelude::*,
};
use powderline_shared::plan::SKILL_PARAMETERS;
use std::ops::Range;
use thiserror::Error;

const SIZE: (u32, u32) = (860, 960);
const FONT: &str = "Helvetica, Arial, sans-serif";
const INK: RGBColor = RGBColor(40, 44, 52);
const FAINT: RGBColor = RGBColor(225, 228, 232);
const CURRICULUM: RGBColor = RGBColor(246, 243, 234);
const BEST: RGBColor = RGBColor(190, 60, 50);
/// Okabe and Ito's colours, told apart by all kinds of eyes.
const COLOURS: [RGBColor; 5] = [
    RGBColor(0, 114, 178),
    RGBColor(213, 94, 0),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
    RGBColor(140, 110, 20),
];

/// The curves could not be drawn.
#[derive(Debug, Error)]
#[error("the curves cannot be drawn: {0}")]
pub struct CurvesError(String);

/// What the curves show.
#[derive(Clone, Copy, Debug)]
pub struct Curves<'a> {
    /// Heading.
    pub title: &'a str,
    /// The evaluated epochs.
    pub history: &'a [EpochRecord],
    /// Epochs of the run.
    pub epochs: u32,
    /// Epochs in which only depth, angle and lift change.
    pub curriculum_epochs: u32,
    /// The epoch of the lowest loss.
    pub best: Option<&'a EpochRecord>,
}

type Area<'s> = DrawingArea<SVGBackend<'s>, Shift>;
type Chart<'a, 's> = ChartContext<'a, SVGBackend<'s>, Cartesian2d<RangedCoordf64, RangedCoordf64>>;
type Drawn = Result<(), Box<dyn std::error::Error>>;

/// One line of a panel.
struct Line {
    label: Option<&'static str>,
    colour: RGBColor,
    points: Vec<(f64, f64)>,
}

struct Panel {
    caption: &'static str,
    values: Range<f64>,
    lines: Vec<Line>,
    epoch_axis: bool,
}

impl Curves<'_> {
    /// The drawing as SVG text.
    ///
    /// # Errors
    /// The drawing library refuses.
    pub fn to_svg(&self) -> Result<String, CurvesError> {
        let mut svg = String::new();
        self.draw(&mut svg).map_err(|error| CurvesError(error.to_string()))?;
        Ok(svg)
    }

    fn draw(&self, svg: &mut String) -> Drawn {
        let root = SVGBackend::with_string(svg, SIZE).into_drawing_area();
        root.fill(&WHITE)?;
        let body = root.titled(self.title, (FONT, 20).into_font().color(&INK))?;
        let (upper, theta) = body.split_vertically(560);
        let (loss, indicator) = upper.split_vertically(290);
        self.panel(&loss, &self.single("loss (m)", COLOURS[0], |record| record.loss))?;
        self.panel(
            &indicator,
            &self.single("indicator: particles still missing", COLOURS[1], |r| r.indicator as f64),
        )?;
        self.panel(&theta, &self.theta())?;
        root.present()?;
        Ok(())
    }

    fn points(&self, value: impl Fn(&EpochRecord) -> f64) -> Vec<(f64, f64)> {
        self.history.iter().map(|record| (f64::from(record.epoch), value(record))).collect()
    }

    fn single(&self, caption: &'static str, colour: RGBColor, value: impl Fn(&EpochRecord) -> f64) -> Panel {
        let points = self.points(value);
        let values = padded(points.iter().map(|point| point.1));
        Panel { caption, values, lines: vec![Line { label: None, colour, points }], epoch_axis: false }
    }

    fn theta(&self) -> Panel {
        let line = |k: usize| Line {
            label: Some(SKILL_PARAMETERS[k].0),
            colour: COLOURS[k],
            points: self.points(|record| record.theta[k]),
        };
        Panel { caption: "theta", values: -1.08..1.08, lines: (0..5).map(line).collect(), epoch_axis: true }
    }

    fn panel(&self, area: &Area<'_>, panel: &Panel) -> Drawn {
        let mut chart = ChartBuilder::on(area)
            .caption(panel.caption, (FONT, 15).into_font().color(&INK))
            .margin_left(12)
            .margin_right(24)
            .margin_bottom(6)
            .x_label_area_size(if panel.epoch_axis { 42 } else { 26 })
            .y_label_area_size(64)
            .build_cartesian_2d(0.0..f64::from(self.epochs.max(1)), panel.values.clone())?;
        self.background(&mut chart, panel)?;
        chart
            .configure_mesh()
            .disable_x_mesh()
            .bold_line_style(FAINT)
            .light_line_style(TRANSPARENT)
            .axis_style(INK)
            .x_desc(if panel.epoch_axis { "epoch" } else { "" })
            .x_labels(self.epochs.clamp(1, 15) as usize + 1)
            .x_label_formatter(&|x| format!("{x:.0}"))
            .y_labels(6)
            .label_style((FONT, 13).into_font().color(&INK))
            .draw()?;
        for line in &panel.lines {
            draw_line(&mut chart, line)?;
        }
        if panel.lines.iter().any(|line| line.label.is_some()) {
            legend(&mut chart)?;
        }
        Ok(())
    }

    /// The curriculum's epochs shaded, the best epoch marked.
    fn background(&self, chart: &mut Chart<'_, '_>, panel: &Panel) -> Drawn {
        let Range { start, end } = panel.values;
        let curriculum = f64::from(self.curriculum_epochs.min(self.epochs));
        chart.draw_series([Rectangle::new([(0.0, start), (curriculum, end)], CURRICULUM.filled())])?;
        if let Some(best) = self.best {
            let epoch = f64::from(best.epoch);
            chart.draw_series([PathElement::new([(epoch, start), (epoch, end)], BEST.mix(0.6))])?;
        }
        Ok(())
    }
}

fn draw_line(chart: &mut Chart<'_, '_>, line: &Line) -> Drawn {
    let colour = line.colour;
    let drawn = chart.draw_series(LineSeries::new(line.points.iter().copied(), colour.stroke_width(2)))?;
    if let Some(label) = line.label {
        drawn
            .label(label)
            .legend(move |(x, y)| PathElement::new([(x, y), (x + 18, y)], colour.stroke_width(2)));
    }
    chart.draw_series(line.points.iter().map(|&point| Circle::new(point, 2, colour.filled())))?;
    Ok(())
}

fn legend<'a, 's: 'a>(chart: &mut Chart<'a, 's>) -> Drawn {
    chart
        .configure_series_labels()
        .position(SeriesLabelPosition::LowerRight)
        .background_style(WHITE.mix(0.85))
        .border_style(FAINT)
        .label_font((FONT, 13).into_font().color(&INK))
        .draw()?;
    Ok(())
}

/// The range of the values with a margin, never empty.
fn padded(values: impl Iterator<Item = f64>) -> Range<f64> {
    let (low, high) =
        values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (low.min(v), high.max(v)));
    if low > high {
        return 0.0..1.0;
    }
    let margin = 0.08 * (high - low) + 1e-6 * high.abs().max(1.0);
    low - margin..high + margin
}

#[cfg(test)]
mod tests {
    use super::*;

    fn record(epoch: u32) -> EpochRecord {
        let fall = 0.9f64.powi(epoch as i32);
        EpochRecord {
            epoch,
            loss: 1100.0 + 100.0 * fall,
            indicator: (800.0 * fall) as i64,
            transported: 10,
            spilled: 1,
            theta: std::array::from_fn(|k| (0.1 * f64::from(epoch) + k as f64).sin()),
            gradient: None,
            seconds: 1.0,
        }
    }

    fn svg(epochs: u32) -> String {
        let history: Vec<_> = (0..epochs).map(record).collect();
        let best = history.last();
        let curves =
            Curves { title: "bench, seed 1", history: &history, epochs: 30, curriculum_epochs: 15, best };
        curves.to_svg().unwrap()
    }

    #[test]
    fn draws_all_panels_at_any_time() {
        for epochs in [0, 1, 2, 31] {
            let svg = svg(epochs);
            for text in ["bench, seed 1", "loss (m)", "indicator", "theta", "pouring angle", "epoch"] {
                assert!(svg.contains(text), "{text} after {epochs} epochs");
            }
            assert!(svg.trim_end().ends_with("</svg>") && !svg.contains("NaN"));
        }
    }

    #[test]
    fn same_history_gives_the_same_bytes() {
        assert_eq!(svg(31), svg(31));
    }

    #[test]
    fn ranges_are_never_empty() {
        for values in [vec![], vec![3.0], vec![0.0, 0.0], vec![-1e9, 1e9]] {
            let Range { start, end } = padded(values.into_iter());
            assert!(start < end);
        }
    }
}
