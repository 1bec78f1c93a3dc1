//! The flight recorder: the last frames of a session, in memory of fixed size, to be read when something has gone wrong.

use heapless::Deque;
use powderline_shared::wire::frame::Frame;

/// A frame, and when it was sent or received.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Recorded {
    /// Microseconds, by the clock of whoever records.
    pub at_us: u64,
    /// The frame; its identifier tells the direction.
    pub frame: Frame,
}

/// The last `N` frames.
#[derive(Clone, Debug, Default)]
pub struct Recorder<const N: usize> {
    frames: Deque<Recorded, N>,
    forgotten: u64,
}

impl<const N: usize> Recorder<N> {
    /// Nothing recorded yet.
    #[must_use]
    pub const fn new() -> Self {
        Self { frames: Deque::new(), forgotten: 0 }
    }

    /// Records a frame; the oldest gives way.
    pub fn record(&mut self, at_us: u64, frame: &Frame) {
        if self.frames.is_full() {
            self.frames.pop_front();
            self.forgotten = self.forgotten.saturating_add(1);
        }
        // There is room after one was taken out, unless there is room for none at all.
        let _ = self.frames.push_back(Recorded { at_us, frame: frame.clone() });
    }

    /// What is kept, the oldest first.
    pub fn frames(&self) -> impl Iterator<Item = &Recorded> {
        self.frames.iter()
    }

    /// How many frames were recorded before those that are kept.
    #[must_use]
    pub fn forgotten(&self) -> u64 {
        self.forgotten
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    #[test]
    fn the_last_frames_are_kept_in_order() {
        let mut recorder = Recorder::<3>::new();
        for id in 0..5 {
            recorder.record(u64::from(id) * 10, &Frame { id, data: heapless::Vec::new() });
        }
        let kept: Vec<_> = recorder.frames().map(|recorded| (recorded.at_us, recorded.frame.id)).collect();
        assert_eq!((kept, recorder.forgotten()), (std::vec![(20, 2), (30, 3), (40, 4)], 2));
    }
}
