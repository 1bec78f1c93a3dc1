//! The setpoints on their way, and those that the arm is at: it says where it was at a tick after it has granted the place of
//! that tick to a later one, so twice its depth is kept.

use powderline_shared::displacement::Setpoint;
use powderline_shared::wire::message::DEPTH;

/// One setpoint on its way.
#[derive(Clone, Copy, Debug)]
struct Sent {
    setpoint: Setpoint,
    at_us: u64,
    /// Not for the first time.
    again: bool,
    arrived: bool,
}

/// Ticks that are kept: those that the arm can have room for, and as many before them.
const KEPT: u32 = 2 * DEPTH;

/// One slot for each tick that is kept.
#[derive(Clone, Debug, Default)]
pub struct Window {
    slots: [Option<Sent>; KEPT as usize],
}

impl Window {
    /// A setpoint leaves, for the first time or again.
    pub fn sent(&mut self, now_us: u64, setpoint: Setpoint) {
        let slot = (setpoint.tick % KEPT) as usize;
        if let Some(slot) = self.slots.get_mut(slot) {
            let again = slot.is_some_and(|sent| sent.setpoint.tick == setpoint.tick);
            *slot = Some(Sent { setpoint, at_us: now_us, again, arrived: false });
        }
    }

    /// Notes what the arm says it has: all up to `applied_tick`, and those in the mask `have` after it. The longest time
    /// from sending one until this news of it, microseconds; one that was sent twice does not tell which of them it is.
    pub fn arrived(&mut self, now_us: u64, applied_tick: u32, have: u16) -> Option<u64> {
        let news = self.slots.iter_mut().flatten().filter(|sent| {
            !sent.arrived
                && (sent.setpoint.tick <= applied_tick || has(sent.setpoint.tick, applied_tick, have))
        });
        let round_trips = news.filter_map(|sent| {
            sent.arrived = true;
            (!sent.again).then(|| now_us.saturating_sub(sent.at_us))
        });
        round_trips.max()
    }

    /// The first setpoint that should have arrived by now, and has not: `overtaken_us` have passed since it was sent if one
    /// that was sent later has arrived, `overdue_us` if not.
    #[must_use]
    pub fn missing(&self, now_us: u64, overtaken_us: u64, overdue_us: u64) -> Option<Setpoint> {
        let slots = || self.slots.iter().flatten();
        let latest_us = slots().filter(|sent| sent.arrived).map(|sent| sent.at_us).max();
        let missing = slots().filter(|sent| {
            let overtaken = latest_us.is_some_and(|latest_us| sent.at_us < latest_us);
            let wait_us = if overtaken { overtaken_us.min(overdue_us) } else { overdue_us };
            !sent.arrived && sent.at_us.saturating_add(wait_us) <= now_us
        });
        missing.map(|sent| sent.setpoint).min_by_key(|setpoint| setpoint.tick)
    }

    /// What was sent for a tick, if it is not too long ago.
    #[must_use]
    pub fn setpoint(&self, tick: u32) -> Option<Setpoint> {
        let kept = self.slots.get((tick % KEPT) as usize).copied().flatten();
        kept.map(|sent| sent.setpoint).filter(|setpoint| setpoint.tick == tick)
    }
}

fn has(tick: u32, applied_tick: u32, have: u16) -> bool {
    let bit = tick.checked_sub(applied_tick).and_then(|ahead| ahead.checked_sub(1));
    bit.is_some_and(|bit| u32::from(have).checked_shr(bit).is_some_and(|rest| rest & 1 == 1))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn setpoint(tick: u32) -> Setpoint {
        Setpoint { tick, counts: [7; 6] }
    }

    #[test]
    fn what_the_arm_does_not_have_is_missing_once_it_had_time_to_arrive() {
        let mut window = Window::default();
        for tick in 1..=4 {
            window.sent(u64::from(tick), setpoint(tick));
        }
        assert_eq!(window.arrived(100, 1, 0b101), Some(99));
        assert_eq!(window.missing(100, 99, 99), None);
        assert_eq!(window.missing(103, 100, 100), Some(setpoint(3)));
        window.sent(103, setpoint(3));
        assert_eq!(window.missing(150, 100, 100), None);
        assert_eq!(window.arrived(160, 3, 0b1), None);
        assert_eq!(window.missing(9_000, 0, 0), None);
    }

    #[test]
    fn one_that_was_overtaken_is_missing_sooner_than_the_last_one() {
        let mut window = Window::default();
        for tick in 1..=3 {
            window.sent(u64::from(tick), setpoint(tick));
        }
        assert_eq!(window.arrived(100, 0, 0b010), Some(98));
        assert_eq!(window.missing(100, 10, 1_000), Some(setpoint(1)));
        window.sent(100, setpoint(1));
        assert_eq!(window.missing(1_002, 10, 1_000), None);
        assert_eq!(window.missing(1_003, 10, 1_000), Some(setpoint(3)));
    }

    #[test]
    fn an_old_tick_gives_way_to_the_one_that_needs_its_place() {
        let mut window = Window::default();
        window.sent(0, setpoint(2));
        // The arm may have granted its whole depth before it says where it was.
        window.sent(1, setpoint(2 + DEPTH));
        assert_eq!(window.setpoint(2), Some(setpoint(2)));
        window.sent(2, setpoint(2 + KEPT));
        assert_eq!(window.setpoint(2), None);
        assert_eq!(window.setpoint(2 + KEPT), Some(setpoint(2 + KEPT)));
    }

    #[test]
    fn bits_beyond_the_mask_are_not_set() {
        assert!(has(16, 0, 0x8000) && !has(17, 0, 0xFFFF) && !has(3, 3, 0xFFFF) && !has(2, 3, 0xFFFF));
    }
}
