//! `curves.svg`: loss, powder that arrives and skill against the epoch, one above the other.

use super::amounts::Amounts;
use super::finding::Outcome;
use super::ink::{self, Axis, COLOURS, FONT, INK};
use crate::optim::{EpochRecord, World};
use plotters::{
    coord::{Shift, ranged1d::Ranged},
    prelude::*,
};
use powderline_shared::plan::SkillParameter;
use powderline_simulator::{scene::figures::mass, skill::SkillMap};
use std::{collections::HashSet, ops::Range};
use thiserror::Error;

const SIZE: (u32, u32) = (960, 1120);
/// Width of the column beside the panels.
const SIDE: u32 = 200;
/// Height of the lines below the panels.
const LEGEND: u32 = 62;
const COARSE: RGBColor = RGBColor(248, 243, 228);
/// Room above and below curves that hardly change, of their height.
const LEAST_MARGIN: f64 = 0.01;
/// More epochs than this are counted, not listed.
const MAX_LISTED: usize = 6;

/// The curves could not be drawn.
#[derive(Debug, Error)]
#[error("the curves cannot be drawn: {0}")]
pub struct CurvesError(String);

/// What the curves show.
#[derive(Clone, Copy, Debug)]
pub struct Curves<'a> {
    /// Heading, and the line below it.
    pub title: [&'a str; 2],
    /// The evaluated epochs.
    pub history: &'a [EpochRecord],
    /// Epochs of the run.
    pub epochs: u32,
    /// The epoch whose skill is the plan: of those that the arm may perform, the best.
    pub shipped: Option<u32>,
    /// What the plan brings, as the search left it; the epoch's own figures are those before its motion was rounded.
    pub plan: Option<&'a Outcome>,
    /// Whether the plan was changed after that, by what it brings on smaller cells.
    pub corrected: bool,
    /// Better epochs whose skill the arm may not perform.
    pub passed_over: &'a [u32],
    /// What theta means in metres and radians.
    pub map: &'a SkillMap,
    /// What is wanted, and what particles weigh.
    pub amounts: &'a Amounts,
}

type Area<'s> = DrawingArea<SVGBackend<'s>, Shift>;
type Chart<'a, 's> = ink::Chart<'a, SVGBackend<'s>>;
type Drawn = Result<(), Box<dyn std::error::Error>>;

/// One line of a panel, and what stands beside the panel in its colour.
struct Line {
    note: String,
    /// What the plan has of it, where the epoch's own figure is another one.
    of_plan: Option<f64>,
    /// Of the epochs, so that some stand out; not of what they are held against.
    marked: bool,
    colour: RGBColor,
    points: Vec<(f64, f64)>,
}

struct Panel {
    caption: &'static str,
    values: Axis,
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
        let [heading, below] = self.title;
        let body = root.margin(12, 6, 0, 0).titled(heading, (FONT, 22).into_font().color(&INK))?;
        let body = body.titled(below, (FONT, 15).into_font().color(&INK))?;
        let (mut rest, legend) = body.split_vertically(body.dim_in_pixel().1 - LEGEND);
        let panels = [self.loss(), self.arrival(), self.skill("mm"), self.skill("deg")];
        let height = (rest.dim_in_pixel().1 - 16) / panels.len() as u32;
        for panel in &panels {
            // The last one has the axis' name below it, and all that is left.
            let height = if panel.epoch_axis { rest.dim_in_pixel().1 } else { height };
            let (area, below) = rest.split_vertically(height);
            self.panel(&area, panel)?;
            rest = below;
        }
        self.legend(&legend)?;
        root.present()?;
        Ok(())
    }

    fn points(&self, value: impl Fn(&EpochRecord) -> f64) -> Vec<(f64, f64)> {
        self.history.iter().map(|record| (f64::from(record.epoch), value(record))).collect()
    }

    fn shipped(&self) -> Option<&EpochRecord> {
        self.history.iter().find(|record| Some(record.epoch) == self.shipped)
    }

    fn note(&self, value: impl Fn(&Outcome) -> String) -> String {
        let best = self.shipped().map(|record| Outcome::of_epoch(self.amounts, record));
        match (self.plan, best) {
            (Some(plan), _) if self.corrected => format!("as found: {}", value(plan)),
            (Some(plan), _) => format!("the plan: {}", value(plan)),
            (None, Some(best)) => format!("best so far: {}", value(&best)),
            (None, None) => String::new(),
        }
    }

    fn loss(&self) -> Panel {
        let points = self.points(|record| record.loss);
        let of_plan = self.plan.map(|plan| plan.loss_m);
        let all = points.iter().map(|point| point.1).chain(of_plan);
        let flat = all.clone().fold(0.0, f64::max) * LEAST_MARGIN;
        let values = Axis::log_if_wide(all, flat, std::iter::empty());
        let note = self.note(|found| format!("{:.3} m", found.loss_m));
        let lines = vec![Line { marked: true, note, of_plan, colour: COLOURS[0], points }];
        Panel { caption: "loss (m)", values, lines, epoch_axis: false }
    }

    fn arrival(&self) -> Panel {
        let arrives = self.points(|record| 1e3 * self.amounts.kg(record.census.target));
        // From end to end: one epoch makes no line.
        let wanted: Vec<_> =
            [0.0, self.axis().range().end].map(|epoch| (epoch, 1e3 * self.amounts.wanted_kg)).to_vec();
        let of_plan = self.plan.map(|plan| 1e3 * plan.mass_kg);
        let all = arrives.iter().chain(&wanted).map(|point| point.1).chain(of_plan);
        let values = Axis::around(all, 0.01 * 1e3 * self.amounts.wanted_kg, false);
        let note = self.note(|found| mass(found.mass_kg));
        let lines = vec![
            Line {
                marked: false,
                of_plan: None,
                note: format!("wanted: {}", mass(self.amounts.wanted_kg)),
                colour: COLOURS[6],
                points: wanted,
            },
            Line { marked: true, note, of_plan, colour: COLOURS[1], points: arrives },
        ];
        Panel { caption: "powder that arrives (g)", values, lines, epoch_axis: false }
    }

    /// The parameters of one unit.
    fn skill(&self, unit: &str) -> Panel {
        let (caption, factor) = match unit {
            "mm" => ("skill: lengths (mm)", 1e3),
            _ => ("skill: angles (deg)", 1f64.to_degrees()),
        };
        let is_here = |parameter: &SkillParameter| parameter.is_angle() == (unit == "deg");
        let line = |parameter: SkillParameter| Line {
            marked: true,
            of_plan: None,
            note: parameter.name().into(),
            colour: COLOURS[parameter.index()],
            points: self.points(|record| factor * self.map.parameters(&record.theta)[parameter.index()]),
        };
        let lines: Vec<Line> = SkillParameter::ALL.into_iter().filter(is_here).map(line).collect();
        let values = lines.iter().flat_map(|line| &line.points).map(|point| point.1);
        Panel { caption, values: Axis::around(values, 1.0, false), lines, epoch_axis: unit == "deg" }
    }

    /// From where to where the epochs are of the coarse world: they come first.
    fn coarse(&self) -> Option<[f64; 2]> {
        let last = self.history.iter().rev().find(|record| record.world == World::Coarse)?.epoch;
        let next = self.history.iter().any(|record| record.epoch > last);
        Some([0.0, f64::from(last) + if next { 0.5 } else { 0.0 }])
    }

    /// The epochs.
    fn axis(&self) -> Axis {
        Axis::from_zero(f64::from(self.epochs), 15, true)
    }

    fn panel(&self, area: &Area<'_>, panel: &Panel) -> Drawn {
        let (plot, side) = area.split_horizontally(SIZE.0 - SIDE);
        let epochs = self.axis();
        let caption = format!("{}{}", panel.caption, panel.values.note());
        let mut chart = ChartBuilder::on(&plot)
            .caption(caption, (FONT, 17).into_font().color(&INK))
            .margin_left(12)
            .margin_right(10)
            .margin_bottom(6)
            .x_label_area_size(if panel.epoch_axis { 42 } else { 26 })
            .y_label_area_size(64)
            .build_cartesian_2d(epochs, panel.values.clone())?;
        self.background(&mut chart, panel)?;
        let x_name = if panel.epoch_axis { "epoch" } else { "" };
        ink::draw_axes(&mut chart, [x_name, ""])?;
        for line in &panel.lines {
            self.line(&mut chart, line)?;
        }
        notes(&side, panel)
    }

    /// Epochs in the coarse world shaded, a line at the epoch that is shipped.
    fn background(&self, chart: &mut Chart<'_, '_>, panel: &Panel) -> Drawn {
        let Range { start, end } = panel.values.range();
        if let Some([from, to]) = self.coarse() {
            chart.draw_series([Rectangle::new([(from, start), (to, end)], COARSE.filled())])?;
        }
        if let Some(shipped) = self.shipped() {
            let epoch = f64::from(shipped.epoch);
            chart.draw_series([PathElement::new([(epoch, start), (epoch, end)], INK.mix(0.35))])?;
        }
        Ok(())
    }

    /// A line with its points: a ring about the one that is shipped, where the plan is; crosses over those passed over.
    fn line(&self, chart: &mut Chart<'_, '_>, line: &Line) -> Drawn {
        let points = || line.points.iter().copied();
        chart.draw_series(LineSeries::new(points(), line.colour.stroke_width(2)))?;
        if !line.marked {
            return Ok(());
        }
        chart.draw_series(points().map(|point| Circle::new(point, 2, line.colour.filled())))?;
        let passed_over: HashSet<u32> = self.passed_over.iter().copied().collect();
        for (record, point) in self.history.iter().zip(points()) {
            if Some(record.epoch) == self.shipped {
                let of_plan = (point.0, line.of_plan.unwrap_or(point.1));
                chart.draw_series([Circle::new(of_plan, 6, INK.stroke_width(2))])?;
            } else if passed_over.contains(&record.epoch) {
                chart.draw_series([Cross::new(point, 5, INK.stroke_width(2))])?;
            }
        }
        Ok(())
    }

    /// What the signs mean, below the panels.
    fn legend(&self, area: &Area<'_>) -> Drawn {
        const LINE: i32 = 24;
        let font = || (FONT, 15).into_font().color(&INK);
        let (mut x, mut y) = (76, 10);
        if let Some(shipped) = self.shipped() {
            area.draw(&Circle::new((x + 9, y + 7), 6, INK.stroke_width(2)))?;
            // A plan's motion is rounded to whole counts, and no epoch's is.
            let is_other = self.plan.is_some() && !shipped.rounded;
            let rounded = if is_other { "; curves before rounding" } else { "" };
            let what = match self.plan {
                Some(_) if self.corrected => "corrected",
                Some(_) => "shipped",
                None => "best so far",
            };
            area.draw(&Text::new(format!("{what}: epoch {}{rounded}", shipped.epoch), (x + 26, y), font()))?;
            x += if is_other { 360 } else { 190 };
        }
        if !self.passed_over.is_empty() {
            area.draw(&Cross::new((x + 9, y + 7), 5, INK.stroke_width(2)))?;
            area.draw(&Text::new(self.passed_over_note(), (x + 26, y), font()))?;
        }
        if self.coarse().is_some() {
            (x, y) = (76, y + LINE);
            let words = "in a coarse copy of the scene, the best of each epoch's skills";
            area.draw(&Rectangle::new([(x, y), (x + 18, y + 14)], COARSE.filled()))?;
            area.draw(&Text::new(words, (x + 26, y), font()))?;
        }
        Ok(())
    }

    fn passed_over_note(&self) -> String {
        const WHY: &str = "the arm may not perform it";
        match self.passed_over {
            [one] => format!("passed over, as {WHY}: epoch {one}"),
            some if some.len() <= MAX_LISTED => {
                let list: Vec<String> = some.iter().map(u32::to_string).collect();
                format!("passed over, as {WHY}: epochs {}", list.join(", "))
            }
            many => format!("passed over, as {WHY}: {} epochs", many.len()),
        }
    }
}

/// What the colours mean, beside the panel.
fn notes(side: &Area<'_>, panel: &Panel) -> Drawn {
    for (y, line) in (44..).step_by(24).zip(&panel.lines).filter(|(_, line)| !line.note.is_empty()) {
        side.draw(&PathElement::new([(0, y + 6), (18, y + 6)], line.colour.stroke_width(3)))?;
        side.draw(&Text::new(line.note.clone(), (26, y), (FONT, 15).into_font().color(&INK)))?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::ink::tests::assert_straight;
    use super::*;
    use powderline_simulator::{rollout::Census, scene::Scene, skill::Theta};

    fn record(epoch: u32, from: f64) -> EpochRecord {
        let fall = 0.8f64.powi(epoch as i32);
        EpochRecord {
            epoch,
            loss: 1.5 + from * fall,
            indicator: (800.0 * fall) as i64,
            census: Census { target: 10, spilled: 1, ..Census::default() },
            theta: Theta::clamped(std::array::from_fn(|k| (0.1 * f64::from(epoch) + k as f64).sin())),
            world: if epoch < 2 { World::Coarse } else { World::Fine },
            seconds: 1.0,
            ..EpochRecord::default()
        }
    }

    fn svg(evaluated: u32, epochs: u32, from: f64) -> String {
        svg_with(evaluated, epochs, from, None)
    }

    fn svg_with(evaluated: u32, epochs: u32, from: f64, loss_of_plan_m: Option<f64>) -> String {
        let history: Vec<_> = (0..evaluated).map(|epoch| record(epoch, from)).collect();
        let scene = Scene::load("bench").unwrap();
        let (map, amounts) = (SkillMap::new(&scene), Amounts::from(&scene));
        let census = Census { target: 10, spilled: 1, ..Census::default() };
        let plan = loss_of_plan_m.map(|loss_m| Outcome::new(&amounts, census, loss_m));
        let curves = Curves {
            title: ["bench, seed 1", "The plan brings nothing."],
            history: &history,
            epochs,
            shipped: evaluated.checked_sub(2),
            plan: plan.as_ref(),
            corrected: false,
            passed_over: if evaluated > 0 { &[evaluated - 1] } else { &[] },
            map: &map,
            amounts: &amounts,
        };
        curves.to_svg().unwrap()
    }

    #[test]
    fn lengths_and_angles_have_a_panel_each() {
        let scene = Scene::load("bench").unwrap();
        let (map, amounts) = (SkillMap::new(&scene), Amounts::from(&scene));
        let curves = Curves {
            title: ["", ""],
            history: &[record(0, 1.0)],
            epochs: 1,
            shipped: None,
            plan: None,
            corrected: false,
            passed_over: &[],
            map: &map,
            amounts: &amounts,
        };
        let names =
            |unit| curves.skill(unit).lines.iter().map(|line| line.note.to_string()).collect::<Vec<_>>();
        assert_eq!(names("mm"), ["scooping depth", "lift height", "transport displacement"]);
        assert_eq!(names("deg"), ["scooping angle", "pouring angle"]);
    }

    #[test]
    fn draws_all_panels_at_any_time() {
        for epochs in [0, 1, 2, 31] {
            let svg = svg(epochs, 30, 1100.0);
            for text in [
                "bench, seed 1",
                "loss (m)",
                "arrives (g)",
                "wanted: 9.6 g",
                "(mm)",
                "(deg)",
                "pouring angle",
                "epoch",
            ] {
                assert!(svg.contains(text), "{text} after {epochs} epochs");
            }
            assert!(svg.trim_end().ends_with("</svg>") && !svg.contains("NaN"));
        }
    }

    #[test]
    fn same_history_gives_the_same_bytes() {
        assert_eq!(svg(31, 30, 1100.0), svg(31, 30, 1100.0));
    }

    #[test]
    fn what_stands_out_is_said_and_marked_in_every_curve() {
        let svg = svg(31, 30, 1100.0);
        for text in [
            "best so far: epoch 29",
            "passed over, as the arm may not perform it: epoch 30",
            "in a coarse copy of the scene",
        ] {
            assert!(svg.contains(text), "{text}");
        }
        // Seven curves and the legend.
        assert_eq!(svg.matches("r=\"6\"").count(), 8);
        let shipped = svg_with(31, 30, 1100.0, Some(1.0));
        assert!(shipped.contains("shipped: epoch 29") && !shipped.contains("best so far"));
    }

    /// The plan's figures stand beside the panel, and so the ring does where they are, within the panel.
    #[test]
    fn the_ring_is_where_the_plan_is() {
        let rings = |loss_m| -> Vec<f64> {
            let svg = svg_with(3, 3, 1.0, loss_m);
            assert_eq!(svg.contains("curves before rounding"), loss_m.is_some());
            let ring = |tag: &str| tag.split_once("cy=\"")?.1.split_once('"')?.0.parse().ok();
            svg.split("<circle").filter(|tag| tag.contains("r=\"6\"")).filter_map(ring).collect()
        };
        let (own, lower) = (rings(None), rings(Some(0.5)));
        assert!(lower[0] > own[0] + 20.0 && lower[0] < own[1], "{own:?} {lower:?}");
        assert_eq!(own[1..], lower[1..]);
    }

    #[test]
    fn one_epoch_has_an_axis_that_can_be_read() {
        let svg = svg(1, 1, 5.7);
        // 7.2 m: no marks of hundredths of a millimetre.
        assert!(svg.contains(">\n7.2\n") || svg.contains(">\n7.20\n"), "{svg}");
    }

    #[test]
    fn marks_stand_where_their_numbers_say() {
        for (epochs, from) in [(5, 8.0), (20, 100.0), (10, 1.0), (30, 1100.0)] {
            let svg = svg(epochs + 1, epochs, from);
            let is_log = svg.contains("logarithmic");
            assert_eq!(is_log, from > 50.0);
            let numbers = super::ink::tests::numbers(&svg);
            let left = numbers.iter().map(|number| number.0).fold(f64::INFINITY, f64::min);
            let (upwards, along): (Vec<(f64, f64, f64)>, Vec<_>) =
                numbers.into_iter().partition(|number| number.0 < left + 2.0);
            let mut top = 0.0;
            let rows: Vec<_> = along.chunk_by(|a, b| (a.1 - b.1).abs() < 1.0).collect();
            assert_eq!(rows.len(), 4, "{along:?}");
            for (panel, row) in rows.iter().enumerate() {
                let epochs: Vec<_> = row.iter().map(|(x, _, epoch)| (*x, *epoch)).collect();
                assert_straight(&epochs);
                assert!(epochs.iter().all(|(_, epoch)| epoch.fract().abs() < 1e-12), "{epochs:?}");
                let bottom = row[0].1;
                let here = upwards.iter().filter(|(_, y, _)| (top..bottom).contains(y));
                let place = |value: f64| if is_log && panel == 0 { value.log10() } else { value };
                assert_straight(&here.map(|(_, y, value)| (*y, place(*value))).collect::<Vec<_>>());
                top = bottom;
            }
        }
    }
}
