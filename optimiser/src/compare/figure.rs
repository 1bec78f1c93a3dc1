//! The figure of a comparison: what is missing against rollouts by number, and the loss against rollouts by processor time.

use super::{Best, Comparison, Count, summary::spread};
use crate::optim::Method;
use crate::report::ink::{self, Axis, COLOURS, Chart, Drawn, FONT, INK};
use crate::report::words::count;
use plotters::{backend::DrawingBackend, coord::Shift, element::DashedPathElement, prelude::*};
use thiserror::Error;

/// Width and height, pixels.
const SIZE: (u32, u32) = (1120, 460);

/// Width of a curve, pixels.
const WIDTH: u32 = 3;

/// Of a curve that is dashed, pixels.
const DASH_PX: u32 = 7;
const GAP_PX: u32 = 5;

/// Height of the legend's lines.
const LEGEND_LINE: i32 = 20;

/// The figure could not be drawn.
#[derive(Debug, Error)]
#[error("the figure cannot be drawn: {0}")]
pub struct FigureError(String);

/// Mean and spread over the seeds along a curve.
pub(crate) struct Band {
    pub(crate) name: String,
    colour: RGBColor,
    /// The colours come round again.
    dashed: bool,
    /// Place on the axis, mean, spread.
    pub(crate) points: Vec<[f64; 3]>,
}

/// One of the two halves.
pub(crate) struct Panel {
    pub(crate) x_name: &'static str,
    pub(crate) y_name: &'static str,
    pub(crate) log_if_wide: bool,
    pub(crate) bands: Vec<Band>,
}

impl Comparison {
    /// The figure as SVG text.
    ///
    /// # Errors
    /// The drawing library refuses.
    pub fn to_svg(&self) -> Result<String, FigureError> {
        let mut svg = String::new();
        self.draw(SVGBackend::with_string(&mut svg, self.size()).into_drawing_area())?;
        Ok(svg)
    }

    /// The figure as a PNG file.
    ///
    /// # Errors
    /// The drawing library refuses.
    pub fn to_png(&self) -> Result<Vec<u8>, FigureError> {
        let (width, height) = self.size();
        let mut pixels = vec![255; 3 * (width * height) as usize];
        self.draw(BitMapBackend::with_buffer(&mut pixels, (width, height)).into_drawing_area())?;
        let mut file = Vec::new();
        let failed = |error: png::EncodingError| FigureError(error.to_string());
        let mut encoder = png::Encoder::new(&mut file, width, height);
        encoder.set_color(png::ColorType::Rgb);
        encoder.write_header().and_then(|mut png| png.write_image_data(&pixels)).map_err(failed)?;
        Ok(file)
    }

    fn size(&self) -> (u32, u32) {
        (SIZE.0, SIZE.1 + (LEGEND_LINE * self.legend_lines()) as u32)
    }

    fn legend_lines(&self) -> i32 {
        (self.methods().len() as i32 + 2) / 3
    }

    fn draw<B: DrawingBackend>(&self, root: DrawingArea<B, Shift>) -> Result<(), FigureError> {
        ink::prepare();
        self.draw_panels(&root).map_err(|error| FigureError(error.to_string()))
    }

    fn draw_panels<B: DrawingBackend>(&self, root: &DrawingArea<B, Shift>) -> Drawn<B> {
        root.fill(&WHITE)?;
        let seeds = self.methods().first().map_or(0, |method| self.tracks_of(*method).count());
        let title = format!(
            "{}: best skill so far, mean and standard deviation over {}",
            self.scene,
            count(seeds as i64, "seed")
        );
        let body = root.margin(10, 6, 8, 14).titled(&title, (FONT, 18).into_font().color(&INK))?;
        let (charts, legend) = body.split_vertically(SIZE.1 - 60);
        let (left, right) = charts.split_horizontally(SIZE.0 / 2);
        let by_number = self.by_number();
        draw_panel(&left, &by_number)?;
        draw_panel(&right, &self.by_time())?;
        draw_legend(&legend, &by_number.bands)?;
        root.present()
    }

    /// What the best skill misses, against rollouts by number.
    pub(crate) fn by_number(&self) -> Panel {
        let grams = |best: &Best<'_>| 1e3 * self.amounts.particle_mass_kg * (best.one.indicator as f64).abs();
        Panel {
            x_name: "rollouts, by number",
            y_name: "powder that is missing or too much (g)",
            log_if_wide: false,
            bands: self.bands(Count::Number, &grams),
        }
    }

    /// Loss against rollouts by processor time.
    pub(crate) fn by_time(&self) -> Panel {
        Panel {
            x_name: "rollouts, by processor time",
            y_name: "lowest loss (m)",
            log_if_wide: true,
            bands: self.bands(Count::Time, &|best| best.one.loss),
        }
    }

    fn bands(&self, count: Count, value: &dyn Fn(&Best<'_>) -> f64) -> Vec<Band> {
        let band = |(place, method): (usize, Method)| {
            let tracks: Vec<Vec<Best<'_>>> = self.tracks_of(method).map(|track| self.bests(track)).collect();
            Band {
                name: method.name().into(),
                colour: COLOURS[place % COLOURS.len()],
                dashed: place >= COLOURS.len(),
                points: points(&tracks, count, value),
            }
        };
        self.methods().into_iter().enumerate().map(band).collect()
    }
}

/// Mean and spread over the tracks, wherever one of them has got farther and all have begun, up to where the first of them ends.
fn points(tracks: &[Vec<Best<'_>>], count: Count, value: &dyn Fn(&Best<'_>) -> f64) -> Vec<[f64; 3]> {
    let ends = tracks.iter().map(|bests| bests.last().map_or(0.0, |best| best.cost(count)));
    let end = ends.fold(f64::INFINITY, f64::min);
    let mut places: Vec<f64> =
        tracks.iter().flatten().map(|best| best.cost(count)).filter(|x| *x <= end).collect();
    places.sort_by(f64::total_cmp);
    places.dedup();
    let at = |x: f64| {
        let last =
            |bests: &Vec<Best<'_>>| bests.iter().take_while(|best| best.cost(count) <= x).last().map(value);
        point(x, tracks.iter().map(last).collect())
    };
    places.into_iter().filter_map(at).collect()
}

/// A place with mean and spread of the values there; none if one is missing.
fn point(x: f64, values: Option<Vec<f64>>) -> Option<[f64; 3]> {
    let values = values.filter(|values| !values.is_empty())?;
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    Some([x, mean, spread(&values)])
}

fn draw_panel<B: DrawingBackend>(area: &DrawingArea<B, Shift>, panel: &Panel) -> Drawn<B> {
    let points = || panel.bands.iter().flat_map(|band| &band.points);
    let bands = points().flat_map(|[_, mean, spread]| [mean - spread, mean + spread]);
    let values = match panel.log_if_wide {
        // What lies a deviation below the mean may have no logarithm: the means decide.
        true => Axis::log_if_wide(points().map(|point| point[1]), 0.0, bands),
        false => Axis::around(bands, 0.0, false),
    };
    let y_name = format!("{}{}", panel.y_name, values.note());
    let along = Axis::from_zero(points().map(|point| point[0]).fold(1.0, f64::max), 8, true);
    let mut chart = ChartBuilder::on(area)
        .margin_left(6)
        .margin_right(16)
        .x_label_area_size(40)
        .y_label_area_size(70)
        .build_cartesian_2d(along, values)?;
    ink::draw_axes(&mut chart, [panel.x_name, &y_name])?;
    for band in &panel.bands {
        draw_band(&mut chart, band)?;
    }
    Ok(())
}

fn draw_band<B: DrawingBackend>(chart: &mut Chart<'_, B>, band: &Band) -> Drawn<B> {
    let above = band.points.iter().map(|[x, mean, spread]| (*x, mean + spread));
    let below = band.points.iter().rev().map(|[x, mean, spread]| (*x, mean - spread));
    chart.draw_series([Polygon::new(above.chain(below).collect::<Vec<_>>(), band.colour.mix(0.15))])?;
    let line = band.points.iter().map(|[x, mean, _]| (*x, *mean));
    let style = band.colour.stroke_width(WIDTH);
    if band.dashed {
        chart.draw_series(DashedLineSeries::new(line, DASH_PX, GAP_PX, style))?;
    } else {
        chart.draw_series(LineSeries::new(line, style))?;
    }
    Ok(())
}

fn draw_legend<B: DrawingBackend>(area: &DrawingArea<B, Shift>, bands: &[Band]) -> Drawn<B> {
    let column = SIZE.0 as i32 / 3;
    for (index, band) in (0..).zip(bands) {
        let (x, y) = (80 + column * (index % 3), LEGEND_LINE * (index / 3) + 8);
        let style = band.colour.stroke_width(WIDTH);
        let line = [(x, y + 7), (x + 26, y + 7)];
        if band.dashed {
            area.draw(&DashedPathElement::new(line, DASH_PX, GAP_PX, style))?;
        } else {
            area.draw(&PathElement::new(line, style))?;
        }
        area.draw(&Text::new(band.name.clone(), (x + 34, y), (FONT, 14).into_font().color(&INK)))?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use clap::ValueEnum;

    use super::super::tests::{comparison, track};
    use super::*;

    #[test]
    fn the_figure_names_its_curves_and_axes() {
        let svg = comparison().to_svg().unwrap();
        for text in ["bench", "surrogate", "random", "by number", "by processor time", "loss", "over 2 seeds"]
        {
            assert!(svg.contains(text), "{text}");
        }
        assert!(svg.trim_end().ends_with("</svg>") && !svg.contains("NaN"));
        assert_eq!(svg, comparison().to_svg().unwrap());
    }

    #[test]
    fn no_two_methods_look_alike() {
        let methods = Method::value_variants();
        let tracks = methods.iter().map(|method| track(*method, 1, &[50.0, 40.0])).collect();
        let comparison = Comparison { tracks, ..comparison() };
        let bands = comparison.by_number().bands;
        let mut looks: Vec<_> = bands.iter().map(|band| (band.colour.rgb(), band.dashed)).collect();
        looks.sort_unstable();
        looks.dedup();
        assert_eq!(looks.len(), methods.len());
    }

    #[test]
    fn the_picture_holds_the_colours_of_its_curves() {
        let comparison = comparison();
        let png = comparison.to_png().unwrap();
        let mut reader = png::Decoder::new(std::io::Cursor::new(&png)).read_info().unwrap();
        let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
        reader.next_frame(&mut pixels).unwrap();
        assert_eq!((reader.info().width, reader.info().height), comparison.size());
        for RGBColor(r, g, b) in &COLOURS[..2] {
            assert!(pixels.chunks(3).filter(|pixel| *pixel == [*r, *g, *b]).count() > 500);
        }
    }

    #[test]
    fn a_comparison_that_has_just_begun_is_drawn() {
        let mut comparison = comparison();
        comparison.tracks.iter_mut().for_each(|track| track.tries.clear());
        comparison.to_svg().unwrap();
        comparison.tracks.clear();
        comparison.to_svg().unwrap();
        comparison.to_png().unwrap();
    }
}
