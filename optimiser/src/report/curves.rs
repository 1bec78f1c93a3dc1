//! `curves.svg`: loss, indicator and theta against the epoch, one above the other.

use super::ink::{self, COLOURS, FAINT, FONT, INK, decimals, padded};
use crate::optim::EpochRecord;
use plotters::{
    coord::{Shift, types::RangedCoordf64},
    prelude::*,
};
use powderline_shared::plan::SKILL_PARAMETERS;
use std::ops::Range;
use thiserror::Error;

const SIZE: (u32, u32) = (960, 960);
/// Width of the column beside the panels.
const SIDE: u32 = 190;
const CURRICULUM: RGBColor = RGBColor(246, 243, 234);
const BEST: RGBColor = RGBColor(190, 60, 50);
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
    /// The epoch of the lowest loss whose motion the arm may perform.
    pub best: Option<&'a EpochRecord>,
}

type Area<'s> = DrawingArea<SVGBackend<'s>, Shift>;
type Chart<'a, 's> = ChartContext<'a, SVGBackend<'s>, Cartesian2d<RangedCoordf64, RangedCoordf64>>;
type Drawn = Result<(), Box<dyn std::error::Error>>;

/// One line of a panel, and what stands beside the panel in its colour.
struct Line {
    note: String,
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
        ink::prepare();
        let root = SVGBackend::with_string(svg, SIZE).into_drawing_area();
        root.fill(&WHITE)?;
        let body = root.margin(12, 6, 0, 0).titled(self.title, (FONT, 20).into_font().color(&INK))?;
        let (upper, theta) = body.split_vertically(556);
        let (loss, indicator) = upper.split_vertically(286);
        let loss_note = self.best.map(|best| format!("lowest: {:.3} m", best.loss)).unwrap_or_default();
        let indicator_note =
            self.best.map(|best| format!("at lowest loss: {}", best.indicator)).unwrap_or_default();
        self.panel(&loss, &self.single("loss (m)", COLOURS[0], loss_note, 0.0, |record| record.loss))?;
        let missing = |record: &EpochRecord| record.indicator as f64;
        let caption = "indicator (particles still missing)";
        self.panel(&indicator, &self.single(caption, COLOURS[1], indicator_note, 1.0, missing))?;
        self.panel(&theta, &self.theta())?;
        root.present()?;
        Ok(())
    }

    fn points(&self, value: impl Fn(&EpochRecord) -> f64) -> Vec<(f64, f64)> {
        self.history.iter().map(|record| (f64::from(record.epoch), value(record))).collect()
    }

    fn single(
        &self,
        caption: &'static str,
        colour: RGBColor,
        note: String,
        least_margin: f64,
        value: impl Fn(&EpochRecord) -> f64,
    ) -> Panel {
        let points = self.points(value);
        let values = padded(points.iter().map(|point| point.1), least_margin);
        Panel { caption, values, lines: vec![Line { note, colour, points }], epoch_axis: false }
    }

    fn theta(&self) -> Panel {
        let line = |k: usize| Line {
            note: SKILL_PARAMETERS[k].0.into(),
            colour: COLOURS[k],
            points: self.points(|record| record.theta[k]),
        };
        Panel { caption: "theta", values: -1.08..1.08, lines: (0..5).map(line).collect(), epoch_axis: true }
    }

    fn panel(&self, area: &Area<'_>, panel: &Panel) -> Drawn {
        let (plot, side) = area.split_horizontally(SIZE.0 - SIDE);
        let mut chart = ChartBuilder::on(&plot)
            .caption(panel.caption, (FONT, 15).into_font().color(&INK))
            .margin_left(12)
            .margin_right(10)
            .margin_bottom(6)
            .x_label_area_size(if panel.epoch_axis { 42 } else { 26 })
            .y_label_area_size(64)
            .build_cartesian_2d(0.0..f64::from(self.epochs.max(1)), panel.values.clone())?;
        self.background(&mut chart, panel)?;
        let decimals = decimals(&panel.values);
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
            .y_label_formatter(&|y| format!("{y:.decimals$}"))
            .label_style((FONT, 13).into_font().color(&INK))
            .draw()?;
        for line in &panel.lines {
            draw_line(&mut chart, line)?;
        }
        self.notes(&side, panel)
    }

    /// The curriculum's epochs shaded, the best epoch marked.
    fn background(&self, chart: &mut Chart<'_, '_>, panel: &Panel) -> Drawn {
        let Range { start, end } = panel.values;
        let curriculum = f64::from(self.curriculum_epochs.min(self.epochs));
        chart.draw_series([Rectangle::new([(0.0, start), (curriculum, end)], CURRICULUM.filled())])?;
        if let Some(best) = self.best {
            let epoch = f64::from(best.epoch);
            chart.draw_series([PathElement::new([(epoch, start), (epoch, end)], BEST.mix(0.7))])?;
        }
        Ok(())
    }

    /// What the colours mean, beside the panel.
    fn notes(&self, side: &Area<'_>, panel: &Panel) -> Drawn {
        let font = || (FONT, 13).into_font();
        let mut y = 44;
        for line in &panel.lines {
            side.draw(&PathElement::new([(0, y + 6), (18, y + 6)], line.colour.stroke_width(3)))?;
            side.draw(&Text::new(line.note.clone(), (26, y), font().color(&INK)))?;
            y += 22;
        }
        if panel.epoch_axis {
            side.draw(&Rectangle::new([(0, y + 12), (18, y + 26)], CURRICULUM.filled()))?;
            side.draw(&Text::new("only depth, angle, lift", (26, y + 14), font().color(&INK)))?;
            side.draw(&PathElement::new([(9, y + 36), (9, y + 50)], BEST.mix(0.7)))?;
            side.draw(&Text::new(self.best_note(), (26, y + 38), font().color(&INK)))?;
        }
        Ok(())
    }

    fn best_note(&self) -> String {
        self.best.map_or_else(String::new, |best| format!("lowest loss: epoch {}", best.epoch))
    }
}

fn draw_line(chart: &mut Chart<'_, '_>, line: &Line) -> Drawn {
    chart.draw_series(LineSeries::new(line.points.iter().copied(), line.colour.stroke_width(2)))?;
    chart.draw_series(line.points.iter().map(|&point| Circle::new(point, 2, line.colour.filled())))?;
    Ok(())
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
            seconds: 1.0,
            ..EpochRecord::default()
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
}
