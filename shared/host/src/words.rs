//! Numbers in sentences.

/// A number of things: `1 frame`, `2 frames`.
#[must_use]
pub fn counted(number: impl Into<u64>, one: &str, more: &str) -> String {
    let number: u64 = number.into();
    format!("{number} {}", if number == 1 { one } else { more })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_thing_is_no_plural() {
        let words = [0_u32, 1, 2].map(|number| counted(number, "breach", "breaches"));
        assert_eq!(words, ["0 breaches", "1 breach", "2 breaches"]);
    }
}
