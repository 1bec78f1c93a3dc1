//! Masses in words.

use core::fmt::{self, Write};
use heapless::String;

/// Longest number in digits, sign and point: four significant digits after the zeros of the smallest double, cut off before.
const DIGITS: usize = 32;
/// Most decimals: below a picogram nobody doses.
const MAX_DECIMALS: usize = 9;

/// A mass in kilogram, shown to four significant digits as people dose it: in grams, below one gram in milligrams.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mass(pub f64);

impl fmt::Display for Mass {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let milligrams = self.0 * 1e6;
        // What rounds to a gram is one.
        let (value, unit) =
            if milligrams.abs() < 999.95 { (milligrams, "mg") } else { (milligrams * 1e-3, "g") };
        let mut digits: String<DIGITS> = String::new();
        let text = match write!(digits, "{value:.*}", decimals(value)) {
            Ok(()) if digits.contains('.') => digits.trim_end_matches('0').trim_end_matches('.'),
            Ok(()) => digits.as_str(),
            // Too long for a mass of anything.
            Err(_) => return write!(f, "{value:e} {unit}"),
        };
        write!(f, "{} {unit}", if text == "-0" { "0" } else { text })
    }
}

/// Decimals that make four significant digits.
fn decimals(value: f64) -> usize {
    let (mut below, mut decimals) = (10.0, 3_usize);
    while value.abs() >= below && decimals > 0 {
        below *= 10.0;
        decimals = decimals.saturating_sub(1);
    }
    let mut above = 1.0;
    while value.abs() < above && decimals < MAX_DECIMALS {
        above *= 0.1;
        decimals = decimals.saturating_add(1);
    }
    decimals
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::string::ToString;

    #[test]
    fn four_digits_in_grams_or_milligrams() {
        for (kg, shown) in [
            (0.0, "0 mg"),
            (-0.0, "0 mg"),
            (8e-6, "8 mg"),
            (1.536e-4, "153.6 mg"),
            (2.0925e-6, "2.092 mg"),
            (0.999_96e-3, "1 g"),
            (0.009_584, "9.584 g"),
            (0.010_816, "10.82 g"),
            (0.030_000_1, "30 g"),
            (1.25, "1250 g"),
            (123.456, "123456 g"),
            (1.25e-12, "0.00000125 mg"),
            (-0.000_5, "-500 mg"),
        ] {
            assert_eq!(Mass(kg).to_string(), shown);
        }
        assert!(Mass(1e300).to_string().contains('e'));
        assert_eq!(Mass(f64::NAN).to_string(), "NaN g");
    }
}
