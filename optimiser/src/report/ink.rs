//! What all drawings have in common: fonts, colours, ranges.

use plotters::style::{FontStyle, RGBColor, register_font};
use std::ops::Range;
use std::sync::Once;

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

/// To be called before anything is drawn: text is measured and drawn with a font that the program brings.
pub(crate) fn prepare() {
    static ONCE: Once = Once::new();
    ONCE.call_once(|| {
        // The font is whole; without it drawing would say so.
        let _ = register_font(FONT, FontStyle::Normal, dejavu::sans::regular());
    });
}

/// Digits after the point that tell the marks of an axis apart.
pub(crate) fn decimals(values: &Range<f64>) -> usize {
    let mark = (values.end - values.start) / 10.0;
    (-mark.log10()).ceil().clamp(0.0, 6.0) as usize
}

/// The range of the values with a margin, never empty.
pub(crate) fn padded(values: impl Iterator<Item = f64>, least_margin: f64) -> Range<f64> {
    let (low, high) =
        values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (low.min(v), high.max(v)));
    if low > high {
        return 0.0..1.0;
    }
    let margin = (0.08 * (high - low) + 1e-5 * high.abs().max(1.0)).max(least_margin);
    low - margin..high + margin
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranges_are_never_empty() {
        for values in [vec![], vec![3.0], vec![0.0, 0.0], vec![-1e9, 1e9]] {
            let Range { start, end } = padded(values.into_iter(), 0.0);
            assert!(start < end);
        }
    }
}
