//! Setpoints that wait for their tick.

use powderline_shared::displacement::Setpoint;
use powderline_shared::wire::message::DEPTH;

/// Why a setpoint is not kept.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Refused {
    /// Its tick has been taken already; harmless.
    Stale,
    /// It is there already, the same; harmless.
    Same,
    /// It is there already, with other content.
    Different,
    /// Beyond the room granted.
    BeyondCredit,
}

/// One slot for each of the next [`DEPTH`] ticks.
#[derive(Clone, Debug, Default)]
pub struct SetpointBuffer {
    slots: [Option<Setpoint>; DEPTH as usize],
}

impl SetpointBuffer {
    /// Keeps a setpoint for a tick after `applied`.
    ///
    /// # Errors
    /// Why it is not kept.
    pub fn insert(&mut self, setpoint: Setpoint, applied: u32) -> Result<(), Refused> {
        if setpoint.tick <= applied {
            return Err(Refused::Stale);
        }
        if setpoint.tick.saturating_sub(applied) > DEPTH {
            return Err(Refused::BeyondCredit);
        }
        let Some(slot) = self.slot(setpoint.tick) else { return Err(Refused::BeyondCredit) };
        match slot {
            Some(kept) if *kept == setpoint => Err(Refused::Same),
            Some(kept) if kept.tick == setpoint.tick => Err(Refused::Different),
            _ => {
                *slot = Some(setpoint);
                Ok(())
            }
        }
    }

    /// The setpoint of a tick, left in place.
    #[must_use]
    pub fn peek(&self, tick: u32) -> Option<Setpoint> {
        let kept = self.slots.get(Self::index(tick)).copied().flatten();
        kept.filter(|setpoint| setpoint.tick == tick)
    }

    /// The setpoint of a tick, taken out.
    pub fn take(&mut self, tick: u32) -> Option<Setpoint> {
        self.slot(tick)?.take_if(|setpoint| setpoint.tick == tick)
    }

    /// How many wait for a tick after `applied`.
    #[must_use]
    pub fn count_after(&self, applied: u32) -> u16 {
        let waiting = self.slots.iter().flatten().filter(|setpoint| setpoint.tick > applied);
        waiting.fold(0, |count: u16, _| count.saturating_add(1))
    }

    /// Bit i: the setpoint of tick `applied + 1 + i` is there.
    #[must_use]
    pub fn have_after(&self, applied: u32) -> u16 {
        let bits = (0..DEPTH).map(|ahead| {
            let tick = applied.saturating_add(1).saturating_add(ahead);
            u16::from(self.peek(tick).is_some()) << ahead
        });
        bits.fold(0, |mask, bit| mask | bit)
    }

    /// Where a tick's setpoint belongs; there is always such a place.
    fn slot(&mut self, tick: u32) -> Option<&mut Option<Setpoint>> {
        self.slots.get_mut(Self::index(tick))
    }

    fn index(tick: u32) -> usize {
        (tick % DEPTH) as usize
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn setpoint(tick: u32, x: i32) -> Setpoint {
        Setpoint { tick, counts: [x, 0, 0, 0, 0, 0] }
    }

    #[test]
    fn order_does_not_matter_and_repetition_is_harmless() {
        let mut buffer = SetpointBuffer::default();
        for tick in [3, 1, 2] {
            assert_eq!(buffer.insert(setpoint(tick, 5), 0), Ok(()));
            assert_eq!(buffer.insert(setpoint(tick, 5), 0), Err(Refused::Same));
        }
        assert_eq!((buffer.count_after(0), buffer.have_after(0), buffer.have_after(1)), (3, 0b111, 0b11));
        assert_eq!(buffer.take(1), Some(setpoint(1, 5)));
        assert_eq!(buffer.take(1), None);
        assert_eq!(buffer.insert(setpoint(1, 5), 1), Err(Refused::Stale));
    }

    #[test]
    fn a_changed_setpoint_and_one_without_credit_are_refused() {
        let mut buffer = SetpointBuffer::default();
        buffer.insert(setpoint(1, 5), 0).unwrap();
        assert_eq!(buffer.insert(setpoint(1, 6), 0), Err(Refused::Different));
        assert_eq!(buffer.insert(setpoint(DEPTH, 0), 0), Ok(()));
        assert_eq!(buffer.insert(setpoint(DEPTH + 1, 0), 0), Err(Refused::BeyondCredit));
        assert_eq!(buffer.insert(setpoint(u32::MAX, 0), 0), Err(Refused::BeyondCredit));
    }

    #[test]
    fn what_was_never_taken_makes_room_in_the_next_round() {
        let mut buffer = SetpointBuffer::default();
        buffer.insert(setpoint(1, 5), 0).unwrap();
        buffer.insert(setpoint(1 + DEPTH, 7), 1).unwrap();
        assert_eq!(buffer.peek(1), None);
        assert_eq!(buffer.take(1 + DEPTH), Some(setpoint(1 + DEPTH, 7)));
    }
}
