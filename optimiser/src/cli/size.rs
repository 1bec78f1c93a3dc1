//! Sizes as people write them: `128MiB`, `2GiB`, `500MB`.

use powderline_simulator::memory::available_bytes;

/// Bytes of a size with an optional unit, decimal (kB, MB, GB, TB) or binary (KiB, MiB, GiB, TiB).
///
/// # Errors
/// A sentence about what is wrong.
pub fn parse_size(text: &str) -> Result<u64, String> {
    let text = text.trim();
    let split = text.find(|c: char| !c.is_ascii_digit() && c != '.').unwrap_or(text.len());
    let (number, unit) = text.split_at(split);
    let number: f64 =
        number.parse().map_err(|_| format!("`{text}` is not a size like 128MiB, 2GiB or 500MB"))?;
    let factor: f64 = match unit.trim().to_ascii_lowercase().as_str() {
        "" | "b" => 1.0,
        "kb" => 1e3,
        "mb" => 1e6,
        "gb" => 1e9,
        "tb" => 1e12,
        "kib" | "k" => 1024.0,
        "mib" | "m" => 1024.0 * 1024.0,
        "gib" | "g" => 1024.0 * 1024.0 * 1024.0,
        "tib" | "t" => 1024.0 * 1024.0 * 1024.0 * 1024.0,
        _ => {
            return Err(format!(
                "`{unit}` is not a unit of size; use one of B, kB, MB, GB, TB, KiB, MiB, GiB, TiB"
            ));
        }
    };
    let bytes = number * factor;
    if !(1.0..=MOST_BYTES as f64).contains(&bytes) {
        return Err(format!("`{text}` is not a size that a machine has"));
    }
    Ok(bytes as u64)
}

/// Beyond it whole bytes are no longer told apart, and no machine is so large.
const MOST_BYTES: u64 = 1 << 53;

/// Most memory to use.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Memory {
    /// So many bytes.
    Bytes(u64),
    /// What the machine has available.
    Available,
}

impl Memory {
    /// In bytes, now. Of what is available a tenth is left to others; where the system does not say how much that is, there is no
    /// bound.
    pub fn bytes(self) -> u64 {
        match self {
            Self::Bytes(bytes) => bytes,
            Self::Available => available_bytes().map_or(MOST_BYTES, |bytes| bytes / 10 * 9),
        }
    }
}

/// A size, or `none`.
///
/// # Errors
/// A sentence about what is wrong.
pub(super) fn parse_memory(text: &str) -> Result<Memory, String> {
    if text.trim().eq_ignore_ascii_case("none") {
        return Ok(Memory::Available);
    }
    parse_size(text)
        .map(Memory::Bytes)
        .map_err(|error| format!("{error}; or `none` for as much as is useful"))
}

/// A size in the largest binary unit that leaves a number above one.
pub fn format_size(bytes: u64) -> String {
    let units = [("GiB", 30), ("MiB", 20), ("KiB", 10)];
    match units.iter().find(|(_, shift)| bytes >> shift > 0) {
        Some((unit, shift)) => format!("{:.1} {unit}", bytes as f64 / (1u64 << shift) as f64),
        None => format!("{bytes} B"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_in_all_units() {
        for (text, bytes) in [
            ("128MiB", 128 << 20),
            ("2GiB", 2 << 30),
            ("500MB", 500_000_000),
            ("1.5 GiB", 3 << 29),
            ("4096", 4096),
            ("64k", 65536),
            ("1TB", 1_000_000_000_000),
        ] {
            assert_eq!(parse_size(text), Ok(bytes), "{text}");
        }
    }

    #[test]
    fn what_is_no_size_is_refused() {
        for text in ["", "MiB", "-1MiB", "1.2.3MB", "5 parsecs", "0", "1e9", "99999999TiB", "nan"] {
            assert!(parse_size(text).is_err(), "{text}");
        }
    }

    #[test]
    fn none_is_what_the_machine_has() {
        assert_eq!(parse_memory("64MiB"), Ok(Memory::Bytes(64 << 20)));
        assert_eq!(parse_memory("None"), Ok(Memory::Available));
        assert!(parse_memory("nothing").is_err_and(|error| error.contains("or `none`")));
        assert!((1 << 20..1 << 50).contains(&Memory::Available.bytes()));
    }

    #[test]
    fn formats() {
        assert_eq!(format_size(1 << 30), "1.0 GiB");
        assert_eq!(format_size(1536), "1.5 KiB");
        assert_eq!(format_size(12), "12 B");
    }
}
