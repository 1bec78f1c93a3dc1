//! What a decoder remembers: halves that wait for their other half, and which setpoints have been.

use super::message::DEPTH;
use crate::displacement::Setpoint;

/// Setpoints remembered: as many as an arm has room for, and some that it has taken already.
const REMEMBERED: u32 = DEPTH + 4;

/// Halves of one kind that wait; one for each of the ticks that are usually under way at a time.
const WAITING: usize = 4;

/// Translation or rotation of one tick.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Half {
    pub(super) session: u16,
    pub(super) tick: u32,
    pub(super) counts: [i32; 3],
}

impl Half {
    fn belongs_to(&self, other: &Self) -> bool {
        (self.session, self.tick) == (other.session, other.tick)
    }
}

/// Which half of a pair.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Part {
    Translation,
    Rotation,
}

/// What became of a half.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Met {
    /// It waits.
    Waits,
    /// It waits, in the place of one of the same tick that said something else.
    Replaced,
    /// Its other half was there; the six counts.
    Pair([i32; 6]),
}

/// The halves that wait.
#[derive(Clone, Debug, Default)]
pub(super) struct Halves {
    translations: Waiting,
    rotations: Waiting,
}

impl Halves {
    pub(super) fn meet(&mut self, part: Part, half: Half) -> Met {
        let (own, other) = match part {
            Part::Translation => (&mut self.translations, &mut self.rotations),
            Part::Rotation => (&mut self.rotations, &mut self.translations),
        };
        let before = own.take(&half);
        if before.is_some_and(|before| before != half) {
            own.add(half);
            return Met::Replaced;
        }
        let Some(found) = other.take(&half) else {
            own.add(half);
            return Met::Waits;
        };
        let ([x, y, z], [rx, ry, rz]) = match part {
            Part::Translation => (half.counts, found.counts),
            Part::Rotation => (found.counts, half.counts),
        };
        Met::Pair([x, y, z, rx, ry, rz])
    }

    /// Forgets whatever waits for this half's tick.
    pub(super) fn forget(&mut self, half: &Half) {
        self.translations.take(half);
        self.rotations.take(half);
    }
}

/// Halves of one kind, the latest first; with gaps where one has been taken.
#[derive(Clone, Debug, Default)]
struct Waiting([Option<Half>; WAITING]);

impl Waiting {
    /// Takes out the half of the same tick and session.
    fn take(&mut self, like: &Half) -> Option<Half> {
        self.0.iter_mut().find_map(|slot| slot.take_if(|half| half.belongs_to(like)))
    }

    /// Puts a half in front. The others move back as far as the first gap; without one the last goes.
    fn add(&mut self, half: Half) {
        let mut moved = Some(half);
        for slot in &mut self.0 {
            core::mem::swap(slot, &mut moved);
            if moved.is_none() {
                break;
            }
        }
    }
}

/// The setpoints of the last ticks, which others are told from; at first the anchor.
#[derive(Clone, Debug)]
pub(super) struct Track([Setpoint; REMEMBERED as usize]);

impl Default for Track {
    fn default() -> Self {
        Self([Setpoint::ANCHOR; REMEMBERED as usize])
    }
}

impl Track {
    pub(super) fn note(&mut self, setpoint: Setpoint) {
        if let Some(slot) = self.0.get_mut((setpoint.tick % REMEMBERED) as usize) {
            *slot = setpoint;
        }
    }

    /// The one whose tick is nearest, the earlier of two.
    pub(super) fn nearest(&self, tick: u32) -> Setpoint {
        let nearest = self.0.iter().min_by_key(|setpoint| (setpoint.tick.abs_diff(tick), setpoint.tick));
        nearest.copied().unwrap_or(Setpoint::ANCHOR)
    }
}

/// Which ticks have been decoded: the newest, and whether each of the 63 before it has.
#[derive(Clone, Copy, Debug)]
pub(super) struct Had {
    newest: u32,
    /// Bit i: tick `newest - i`.
    ticks: u64,
}

impl Default for Had {
    /// The anchor needs no decoding.
    fn default() -> Self {
        Self { newest: 0, ticks: 1 }
    }
}

impl Had {
    pub(super) fn note(&mut self, tick: u32) {
        if let Some(ahead) = tick.checked_sub(self.newest) {
            self.ticks = self.ticks.checked_shl(ahead).unwrap_or(0) | 1;
            self.newest = tick;
        } else {
            self.ticks |= self.bit(tick);
        }
    }

    pub(super) fn newest(&self) -> u32 {
        self.newest
    }

    /// Whether a tick has been decoded, or is so old that nobody waits for it.
    pub(super) fn contains(&self, tick: u32) -> bool {
        tick <= self.newest && (self.bit(tick) == 0 || self.ticks & self.bit(tick) != 0)
    }

    /// 0 for a tick that is too old.
    fn bit(&self, tick: u32) -> u64 {
        1u64.checked_shl(self.newest.saturating_sub(tick)).unwrap_or(0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn half(tick: u32, count: i32) -> Half {
        Half { session: 1, tick, counts: [count; 3] }
    }

    #[test]
    fn halves_meet_in_either_order_with_others_in_between() {
        let mut halves = Halves::default();
        assert_eq!(halves.meet(Part::Rotation, half(1, 10)), Met::Waits);
        assert_eq!(halves.meet(Part::Translation, half(2, 2)), Met::Waits);
        assert_eq!(halves.meet(Part::Translation, half(2, 2)), Met::Waits);
        assert_eq!(halves.meet(Part::Translation, half(1, 1)), Met::Pair([1, 1, 1, 10, 10, 10]));
        assert_eq!(halves.meet(Part::Rotation, half(2, 20)), Met::Pair([2, 2, 2, 20, 20, 20]));
    }

    #[test]
    fn the_oldest_goes_when_too_many_wait() {
        let mut halves = Halves::default();
        for tick in 1..=5 {
            assert_eq!(halves.meet(Part::Translation, half(tick, 0)), Met::Waits);
        }
        assert_eq!(halves.meet(Part::Rotation, half(1, 0)), Met::Waits);
        assert_eq!(halves.meet(Part::Rotation, half(2, 0)), Met::Pair([0; 6]));
    }

    #[test]
    fn sessions_and_contradictions_do_not_mix() {
        let mut halves = Halves::default();
        halves.meet(Part::Translation, half(1, 1));
        let foreign = Half { session: 2, ..half(1, 1) };
        assert_eq!(halves.meet(Part::Rotation, foreign), Met::Waits);
        assert_eq!(halves.meet(Part::Translation, half(1, 3)), Met::Replaced);
        halves.forget(&half(1, 0));
        assert_eq!(halves.meet(Part::Rotation, half(1, 1)), Met::Waits);
    }

    #[test]
    fn ticks_are_remembered_for_a_while() {
        let mut had = Had::default();
        assert!(had.contains(0) && !had.contains(1));
        had.note(2);
        assert!(!had.contains(1) && had.contains(2) && !had.contains(3));
        had.note(1);
        assert!(had.contains(1));
        had.note(200);
        assert!(had.contains(1) && !had.contains(137) && had.contains(136) && !had.contains(199));
        had.note(u32::MAX);
        assert!(had.contains(5) && had.contains(u32::MAX));
    }
}
