//! Numbers in messages.

use powderline_shared::mass::Mass;

/// A number as a person would write it into the file.
pub fn plain(value: f64) -> String {
    let magnitude = value.abs();
    if value.is_nan() {
        "nan".to_owned()
    } else if value.is_infinite() || magnitude < f64::MIN_POSITIVE || (1e-4..1e7).contains(&magnitude) {
        value.to_string()
    } else {
        format!("{value:e}")
    }
}

/// Numbers as a list in TOML.
pub fn list(values: &[f64]) -> String {
    format!("[{}]", values.iter().map(|value| plain(*value)).collect::<Vec<_>>().join(", "))
}

/// A computed number, to `digits` significant digits.
pub fn about(value: f64, digits: usize) -> String {
    plain(format!("{value:.*e}", digits.saturating_sub(1)).parse().unwrap_or(value))
}

/// A computed number that is above a limit, to three significant digits, or as many as show that it is.
pub(crate) fn above(value: f64, limit: f64) -> String {
    let is_above = |text: &String| text.parse::<f64>().is_ok_and(|number| number > limit);
    (3..17).map(|digits| about(value, digits)).find(is_above).unwrap_or_else(|| plain(value))
}

/// A mass as people dose it, to four significant digits: grams, milligrams below one gram.
pub fn mass(kg: f64) -> String {
    Mass(kg).to_string()
}

/// A computed upper limit, rounded down to three significant digits so that it may be taken as it stands.
pub fn at_most(value: f64) -> String {
    if value <= 0.0 || !value.is_finite() {
        return plain(value);
    }
    let unit = 10f64.powf(value.log10().floor() - 2.0);
    // The small surplus keeps a limit that is itself a round number.
    about((value / unit + 1e-6).floor() * unit, 3)
}

/// A whole number with its thousands set apart.
pub fn grouped(number: i64) -> String {
    let digits = number.unsigned_abs().to_string();
    let mut text = String::new();
    for (position, digit) in digits.chars().enumerate() {
        if position > 0 && (digits.len() - position).is_multiple_of(3) {
            text.push(',');
        }
        text.push(digit);
    }
    if number < 0 { format!("-{text}") } else { text }
}

/// A number of things, `noun` being one of them: `1 particle`, `1,200 particles`.
pub fn count(number: i64, noun: &str) -> String {
    format!("{} {noun}{}", grouped(number), if number == 1 { "" } else { "s" })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn thousands_are_set_apart() {
        assert_eq!(["0", "999", "1,000", "-12,345,678"], [0, 999, 1000, -12_345_678].map(grouped)[..]);
    }

    #[test]
    fn what_is_above_a_limit_reads_so() {
        assert_eq!([above(1.3178, 0.5), above(0.500_01, 0.5)], ["1.32", "0.50001"]);
    }

    #[test]
    fn one_thing_is_no_plural() {
        assert_eq!(
            ["0 particles", "1 particle", "1,200 particles", "-1 particles"],
            [0, 1, 1200, -1].map(|number| count(number, "particle"))[..]
        );
    }

    #[test]
    fn numbers_read_like_those_in_a_file() {
        assert_eq!(plain(0.004), "0.004");
        assert_eq!(plain(1e300), "1e300");
        assert_eq!(plain(-0.00001), "-1e-5");
        assert_eq!(plain(f64::NAN), "nan");
        assert_eq!(plain(f64::NEG_INFINITY), "-inf");
        assert_eq!(plain(0.0), "0");
        assert_eq!(about(0.123_456, 3), "0.123");
        assert_eq!(at_most(14_399.9), "14300");
        assert_eq!(at_most(0.02), "0.02");
        assert_eq!(at_most(0.019_99), "0.0199");
    }
}
