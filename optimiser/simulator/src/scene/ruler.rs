//! An extent that is looked at part by part.

/// Parts that an extent is cut into, along each axis.
const PARTS: usize = 48;
/// Most parts where thin walls ask for more.
const MOST_PARTS: usize = 1000;

/// An extent in equal parts.
#[derive(Clone, Copy)]
pub(super) struct Ruler {
    from_m: f64,
    pub(super) step_m: f64,
    pub(super) parts: usize,
}

impl Ruler {
    pub(super) fn new(extent_m: [f64; 2]) -> Self {
        Self::in_parts(extent_m, PARTS)
    }

    /// An extent that has one part more at its upper end.
    pub(super) fn with_one_more([from_m, to_m]: [f64; 2]) -> [f64; 2] {
        [from_m, to_m + (to_m - from_m) / (PARTS - 1) as f64]
    }

    fn in_parts([from_m, to_m]: [f64; 2], parts: usize) -> Self {
        Self { from_m, step_m: (to_m - from_m) / parts as f64, parts }
    }

    /// In parts of at most so many metres.
    pub(super) fn fine(extent_m: [f64; 2], most_m: f64) -> Self {
        let parts = ((extent_m[1] - extent_m[0]) / most_m).ceil() as usize;
        Self::in_parts(extent_m, parts.clamp(PARTS, MOST_PARTS))
    }

    /// The middle of a part.
    pub(super) fn at(&self, index: usize) -> f64 {
        self.from_m + (index as f64 + 0.5) * self.step_m
    }

    pub(super) fn middles(self) -> impl Iterator<Item = f64> {
        (0..self.parts).map(move |index| self.at(index))
    }
}
