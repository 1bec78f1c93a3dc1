//! What all drawings have in common: fonts, colours, axes.

use plotters::{
    backend::DrawingBackend,
    chart::ChartContext,
    coord::{
        cartesian::Cartesian2d,
        ranged1d::{KeyPointHint, NoDefaultFormatting, Ranged, ValueFormatter},
        types::RangedCoordf64,
    },
    drawing::DrawingAreaErrorKind,
    style::{FontStyle, IntoFont, RGBColor, TRANSPARENT, register_font},
};
use std::{ops::Range, sync::Once};

pub(crate) const FONT: &str = "DejaVu Sans, Helvetica, Arial, sans-serif";
pub(crate) const INK: RGBColor = RGBColor(40, 44, 52);
pub(crate) const FAINT: RGBColor = RGBColor(225, 228, 232);
/// Okabe and Ito's colours, told apart by all kinds of eyes.
pub(crate) const COLOURS: [RGBColor; 7] = [
    RGBColor(0, 114, 178),
    RGBColor(213, 94, 0),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
    RGBColor(140, 110, 20),
    RGBColor(86, 180, 233),
    RGBColor(90, 90, 90),
];

/// Values that span more than this are drawn on a logarithmic axis.
const WIDE: f64 = 10.0;

/// Values below this are zero but for rounding, and have no place on a logarithmic axis.
const LEAST_LOGARITHMIC: f64 = 1e-12;

/// What an error of drawing on `B` is.
pub(crate) type Drawn<B> = Result<(), DrawingAreaErrorKind<<B as DrawingBackend>::ErrorType>>;
/// A chart between two axes.
pub(crate) type Chart<'a, B> = ChartContext<'a, B, Cartesian2d<Axis, Axis>>;

/// To be called before anything is drawn: text is measured and drawn with a font that the program brings.
pub(crate) fn prepare() {
    static ONCE: Once = Once::new();
    ONCE.call_once(|| {
        // The font is whole; without it drawing would say so.
        let _ = register_font(FONT, FontStyle::Normal, dejavu::sans::regular());
    });
}

/// An axis whose marks stand exactly at the numbers that they bear: 1, 2 or 5 times a power of ten apart.
#[derive(Clone, Debug)]
pub(crate) struct Axis {
    range: Range<f64>,
    /// Values, and how they are written.
    marks: Vec<(f64, String)>,
    is_log: bool,
}

impl Axis {
    /// From 0 to `end`, with about so many marks.
    pub(crate) fn from_zero(end: f64, count: usize, is_whole: bool) -> Self {
        let range = 0.0..end.max(1.0);
        Self { marks: linear_marks(&range, count, is_whole), range, is_log: false }
    }

    /// Around the values, with a margin of at least `least_margin`.
    pub(crate) fn around(values: impl Iterator<Item = f64>, least_margin: f64, is_whole: bool) -> Self {
        let range = padded(values, least_margin);
        Self { marks: linear_marks(&range, 6, is_whole), range, is_log: false }
    }

    /// Around the values, with that margin at least; logarithmic if they are above zero, rounding left aside, and span more than a
    /// decade, otherwise around what is drawn `beside` them too.
    pub(crate) fn log_if_wide(
        values: impl Iterator<Item = f64> + Clone,
        least_margin: f64,
        beside: impl Iterator<Item = f64>,
    ) -> Self {
        let ends = |(low, high): (f64, f64), value: f64| (low.min(value), high.max(value));
        let (low, high) = values.clone().fold((f64::INFINITY, f64::NEG_INFINITY), ends);
        // Without values, the lowest is infinite.
        if !(low >= LEAST_LOGARITHMIC && high > WIDE * low) {
            return Self::around(values.chain(beside), least_margin, false);
        }
        let range = between_marks(low, high);
        Self { marks: log_marks(&range), range, is_log: true }
    }

    /// To be said beside the axis' name.
    pub(crate) fn note(&self) -> &'static str {
        if self.is_log { ", logarithmic scale" } else { "" }
    }
}

impl Ranged for Axis {
    type FormatOption = NoDefaultFormatting;
    type ValueType = f64;

    /// What has no logarithm lies at the lower end of a logarithmic axis.
    fn map(&self, value: &f64, limit: (i32, i32)) -> i32 {
        let Range { start, end } = self.range;
        if self.is_log {
            let place = value.max(start).log10();
            return RangedCoordf64::from(start.log10()..end.log10()).map(&place, limit);
        }
        RangedCoordf64::from(start..end).map(value, limit)
    }

    fn key_points<Hint: KeyPointHint>(&self, _: Hint) -> Vec<f64> {
        self.marks.iter().map(|mark| mark.0).collect()
    }

    fn range(&self) -> Range<f64> {
        self.range.clone()
    }
}

impl ValueFormatter<f64> for Axis {
    fn format_ext(&self, value: &f64) -> String {
        let off = |mark: &&(f64, String)| (mark.0 - value).abs();
        let nearest = self.marks.iter().min_by(|a, b| off(a).total_cmp(&off(b)));
        nearest.map(|mark| mark.1.clone()).unwrap_or_default()
    }
}

/// Draws both axes with lines across the chart.
pub(crate) fn draw_axes<B: DrawingBackend>(
    chart: &mut Chart<'_, B>,
    [x_name, y_name]: [&str; 2],
) -> Drawn<B> {
    chart
        .configure_mesh()
        .disable_x_mesh()
        .bold_line_style(FAINT)
        .light_line_style(TRANSPARENT)
        .axis_style(INK)
        .x_desc(x_name)
        .y_desc(y_name)
        .axis_desc_style((FONT, 15).into_font().color(&INK))
        .label_style((FONT, 14).into_font().color(&INK))
        .draw()
}

/// Multiples of a step of 1, 2 or 5 times a power of ten, with as many decimals as the step has.
fn linear_marks(range: &Range<f64>, count: usize, is_whole: bool) -> Vec<(f64, String)> {
    let rough = (range.end - range.start) / count.max(1) as f64;
    let mut power = rough.log10().floor() as i32;
    // Between two steps the border is their geometric mean.
    let mut digit = match rough / 10f64.powi(power) {
        below if below < 2f64.sqrt() => 1.0,
        below if below < 10f64.sqrt() => 2.0,
        below if below < 50f64.sqrt() => 5.0,
        _ => 10.0,
    };
    if digit > 9.0 {
        (digit, power) = (1.0, power + 1);
    }
    if is_whole && power < 0 {
        (digit, power) = (1.0, 0);
    }
    let decimals = (-power).max(0);
    // Divided, for a negative power of ten is no exact number.
    let at = |index: i64| match power {
        0.. => index as f64 * digit * 10f64.powi(power),
        _ => index as f64 * digit / 10f64.powi(decimals),
    };
    let step = at(1);
    let [first, last] = [(range.start / step).ceil(), (range.end / step).floor()].map(|end| end as i64);
    (first..=last).map(|index| (at(index), format!("{:.*}", decimals as usize, at(index)))).collect()
}

/// From the mark below to the mark above, with a little room, so that the lowest values too lie between two numbers.
fn between_marks(low: f64, high: f64) -> Range<f64> {
    const ROOM: f64 = 0.02;
    let digits = || log_digits(low, high).iter().copied().chain([10.0]);
    let near = |value: f64| digits().map(move |digit| digit * 10f64.powf(value.log10().floor()));
    let below = near(low).filter(|mark| *mark <= low).fold(0.1 * low, f64::max);
    let above = near(high).filter(|mark| *mark >= high).fold(10.0 * high, f64::min);
    let room = (above / below).powf(ROOM);
    below / room..above * room
}

/// What the marks of a logarithmic axis are powers of ten times of: 1, 2 and 5, or only 1, if there are many.
fn log_digits(low: f64, high: f64) -> &'static [f64] {
    const MANY: f64 = 1e3;
    if high > MANY * low { &[1.0] } else { &[1.0, 2.0, 5.0] }
}

/// 1, 2 and 5 times powers of ten, or only those, if there are many.
fn log_marks(range: &Range<f64>) -> Vec<(f64, String)> {
    let digits = log_digits(range.start, range.end);
    let powers = range.start.log10().floor() as i32..=range.end.log10().floor() as i32;
    let mark = |power: i32, digit: f64| {
        let decimals = (-power).max(0);
        let value = if power < 0 { digit / 10f64.powi(decimals) } else { digit * 10f64.powi(power) };
        (value, format!("{value:.*}", decimals as usize))
    };
    let marks = powers.flat_map(|power| digits.iter().map(move |digit| mark(power, *digit)));
    marks.filter(|(value, _)| range.contains(value)).collect()
}

/// The range of the values with a margin, never empty.
fn padded(values: impl Iterator<Item = f64>, least_margin: f64) -> Range<f64> {
    let (low, high) =
        values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (low.min(v), high.max(v)));
    if low > high {
        return 0.0..1.0;
    }
    let margin = (0.08 * (high - low) + 1e-5 * high.abs().max(1.0)).max(least_margin);
    low - margin..high + margin
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Numbers that stand in a drawing, as (x, y, number), in pixels.
    pub(crate) fn numbers(svg: &str) -> Vec<(f64, f64, f64)> {
        let attribute = |tag: &str, name: &str| -> Option<f64> {
            tag.split_once(&format!(" {name}=\""))?.1.split_once('"')?.0.parse().ok()
        };
        let texts = svg.split("<text").skip(1).filter_map(|text| text.split_once('>'));
        let number = |(tag, rest): (&str, &str)| {
            let value = rest.split_once('<')?.0.trim().parse().ok()?;
            Some((attribute(tag, "x")?, attribute(tag, "y")?, value))
        };
        texts.filter_map(number).collect()
    }

    /// Fails unless marks are where they say, by a straight line through the first and the last, within a pixel.
    pub(crate) fn assert_straight(marks: &[(f64, f64)]) {
        let ([(from_px, from), ..], Some((to_px, to))) = (marks, marks.last()) else { panic!("no marks") };
        assert!(marks.len() > 1 && to > from, "{marks:?}");
        for (px, value) in marks {
            let expected = from_px + (to_px - from_px) * (value - from) / (to - from);
            assert!((px - expected).abs() <= 1.01, "{value} stands at {px}, not at {expected}: {marks:?}");
        }
    }

    fn bears(axis: &Axis) -> Vec<&str> {
        axis.marks.iter().map(|mark| mark.1.as_str()).collect()
    }

    #[test]
    fn ranges_are_never_empty() {
        for values in [vec![], vec![3.0], vec![0.0, 0.0], vec![-1e9, 1e9]] {
            let Range { start, end } = padded(values.into_iter(), 0.0);
            assert!(start < end);
        }
    }

    #[test]
    fn marks_are_even_numbers() {
        assert_eq!(bears(&Axis::from_zero(5.0, 15, true)), ["0", "1", "2", "3", "4", "5"]);
        assert_eq!(bears(&Axis::from_zero(1.0, 15, true)), ["0", "1"]);
        assert_eq!(bears(&Axis::from_zero(30.0, 8, true)), ["0", "5", "10", "15", "20", "25", "30"]);
        let around = |values: &[f64]| Axis::around(values.iter().copied(), 0.0, false);
        assert_eq!(bears(&around(&[1.8, 11.3])), ["2", "4", "6", "8", "10", "12"]);
        assert_eq!(
            bears(&around(&[-0.31, 0.42])),
            ["-0.3", "-0.2", "-0.1", "0.0", "0.1", "0.2", "0.3", "0.4"]
        );
        assert_eq!(bears(&around(&[1e-3, 1.4e-3])), ["0.0010", "0.0011", "0.0012", "0.0013", "0.0014"]);
        let log = |values: &[f64]| Axis::log_if_wide(values.iter().copied(), 0.0, std::iter::empty());
        assert_eq!(bears(&log(&[1.5, 95.5])), ["1", "2", "5", "10", "20", "50", "100"]);
        assert_eq!(bears(&log(&[0.02, 900.0])), ["0.01", "0.1", "1", "10", "100", "1000"]);
        assert_eq!(bears(&log(&[15.0, 95.5])), bears(&around(&[15.0, 95.5])));
        assert!(log(&[]).note().is_empty() && log(&[0.0, 95.0]).note().is_empty());
        // As small as a float can be: such a number has no power of ten below it.
        assert!(log(&[5e-324, 95.0]).note().is_empty() && log(&[1e-12, 1e12]).marks.len() == 25);
        let wide = log(&[1.0, 20.0]);
        let at = |value: f64| wide.map(&value, (0, 1000));
        assert!(at(-3.0) == 0 && at(f64::MIN_POSITIVE) == 0);
        assert!((at(10.0) - at(2.0)).abs_diff(at(5.0) - at(1.0)) <= 1);
    }

    proptest! {
        #[test]
        fn labels_are_where_they_say(low in -1e6..1e6f64, exponent in -6..6, is_whole: bool, is_log: bool) {
            let high = low + 10f64.powi(exponent) * 3.7;
            let axis = match is_log {
                true => {
                    let values = [low.abs() + 1e-3, low.abs() + 10f64.powi(exponent)];
                    Axis::log_if_wide(values.into_iter(), 0.0, std::iter::empty())
                }
                false => Axis::around([low, high].into_iter(), 0.0, is_whole),
            };
            for (value, label) in &axis.marks {
                let written: f64 = label.parse().unwrap();
                prop_assert!((written - value).abs() <= 1e-12 * value.abs(), "{label} at {value}");
                prop_assert!(axis.range.contains(value) && &axis.format_ext(value) == label);
                prop_assert!(!is_whole || is_log || !label.contains('.'), "{label}");
            }
            prop_assert!(axis.marks.len() <= 14, "{:?}", axis.marks);
            prop_assert!(axis.marks.len() >= 2 || (is_whole && high - low < 2.0), "{:?}", axis.marks);
        }
    }
}
