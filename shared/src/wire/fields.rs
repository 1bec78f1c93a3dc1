//! Little-endian fields, one after the other.

use heapless::Vec;

use super::frame::{Frame, MAX_DATA, append};

/// Builds the data of a frame, or what is no longer than that. Every layout is a constant of at most 64 bytes, so nothing is ever cut
/// off, which is asserted where assertions are; golden tests pin each of them.
pub(super) struct Put(Vec<u8, MAX_DATA>);

impl Put {
    pub(super) fn new() -> Self {
        Self(Vec::new())
    }

    pub(super) fn bytes(mut self, bytes: &[u8]) -> Self {
        let fits = append(&mut self.0, bytes);
        debug_assert!(fits.is_some(), "longer than a frame");
        self
    }

    pub(super) fn u8(self, value: u8) -> Self {
        self.bytes(&[value])
    }

    pub(super) fn u16(self, value: u16) -> Self {
        self.bytes(&value.to_le_bytes())
    }

    pub(super) fn u32(self, value: u32) -> Self {
        self.bytes(&value.to_le_bytes())
    }

    pub(super) fn counts(self, counts: &[i32]) -> Self {
        counts.iter().fold(self, |put, count| put.bytes(&count.to_le_bytes()))
    }

    pub(super) fn as_slice(&self) -> &[u8] {
        &self.0
    }

    pub(super) fn into_frame(self, id: u16) -> Frame {
        Frame { id, data: self.0 }
    }
}

/// Takes data apart, from the front; `None` when there are no more.
pub(super) struct Take<'a>(pub(super) &'a [u8]);

impl Take<'_> {
    pub(super) fn array<const N: usize>(&mut self) -> Option<[u8; N]> {
        let (first, rest) = self.0.split_first_chunk::<N>()?;
        self.0 = rest;
        Some(*first)
    }

    pub(super) fn u8(&mut self) -> Option<u8> {
        self.array().map(u8::from_le_bytes)
    }

    pub(super) fn u16(&mut self) -> Option<u16> {
        self.array().map(u16::from_le_bytes)
    }

    pub(super) fn u32(&mut self) -> Option<u32> {
        self.array().map(u32::from_le_bytes)
    }

    pub(super) fn counts<const N: usize>(&mut self) -> Option<[i32; N]> {
        let mut counts = [0; N];
        for count in &mut counts {
            *count = self.array().map(i32::from_le_bytes)?;
        }
        Some(counts)
    }

    pub(super) fn displacements(&mut self) -> Option<[i16; 6]> {
        let mut displacements = [0; 6];
        for value in &mut displacements {
            *value = self.array().map(i16::from_le_bytes)?;
        }
        Some(displacements)
    }
}

/// Low 8 bits.
pub(super) fn low8(value: u32) -> u8 {
    let [low, ..] = value.to_le_bytes();
    low
}

/// Low 16 bits.
pub(super) fn low16(value: u32) -> u16 {
    let [low, high, ..] = value.to_le_bytes();
    u16::from_le_bytes([low, high])
}

/// The number with these low 8 bits that is nearest to `reference` (modulo 2^32; 128 away counts as below).
pub(super) fn nearest_with_low8(reference: u32, low: u8) -> u32 {
    let difference = low.wrapping_sub(low8(reference)).cast_signed();
    reference.wrapping_add_signed(i32::from(difference))
}

/// The number with these low 16 bits that is nearest to `reference` (modulo 2^32; 32,768 away counts as below).
pub(super) fn nearest_with_low16(reference: u32, low: u16) -> u32 {
    let difference = low.wrapping_sub(low16(reference)).cast_signed();
    reference.wrapping_add_signed(i32::from(difference))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn the_ends_of_the_window() {
        assert_eq!(nearest_with_low8(300, low8(300 + 127)), 427);
        assert_eq!(nearest_with_low8(300, low8(300 - 128)), 172);
        assert_eq!(nearest_with_low16(100_000, low16(132_767)), 132_767);
        assert_eq!(nearest_with_low16(100_000, low16(67_232)), 67_232);
        assert_eq!(nearest_with_low16(5, 0xFFFF), u32::MAX);
    }

    proptest! {
        #[test]
        fn whatever_is_near_is_found(reference: u32, by: i16, little: i8) {
            let value = reference.wrapping_add_signed(i32::from(by));
            prop_assert_eq!(nearest_with_low16(reference, low16(value)), value);
            let value = reference.wrapping_add_signed(i32::from(little));
            prop_assert_eq!(nearest_with_low8(reference, low8(value)), value);
        }
    }
}
