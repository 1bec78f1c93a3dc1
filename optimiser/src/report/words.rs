//! Numbers in words.

use powderline_shared::plan::SkillParameter;
pub(crate) use powderline_simulator::scene::figures::{count, grouped};

/// A duration to the precision that a waiting person needs.
pub(crate) fn duration(seconds: f64) -> String {
    let whole = seconds.max(0.0).round() as u64;
    match whole {
        0..60 => format!("{whole} s"),
        60..3600 => format!("{} min", (whole + 30) / 60),
        _ => format!("{} h {:02} min", whole / 3600, whole % 3600 / 60),
    }
}

/// The value of a skill parameter, metres or radians, as people say it: millimetres and degrees.
pub(crate) fn parameter(which: SkillParameter, value: f64) -> String {
    if which.is_angle() { format!("{:.1} deg", value.to_degrees()) } else { format!("{:.1} mm", 1e3 * value) }
}

/// A text that begins with a capital.
pub(crate) fn capitalised(text: &str) -> String {
    let mut letters = text.chars();
    letters.next().map_or(String::new(), |first| first.to_uppercase().chain(letters).collect())
}

/// Bytes as hexadecimal digits.
pub(crate) fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_in_words() {
        assert_eq!(duration(12.4), "12 s");
        assert_eq!(duration(100.0), "2 min");
        assert_eq!(duration(7260.0), "2 h 01 min");
        assert_eq!(parameter(SkillParameter::ScoopingDepth, 0.0123), "12.3 mm");
        assert_eq!(parameter(SkillParameter::PouringAngle, 1.0), "57.3 deg");
        assert_eq!(hex(&[0, 255]), "00ff");
    }
}
