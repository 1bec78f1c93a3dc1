//! The wire: frames on their way, with what happens to them there.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use powderline_shared::wire::frame::Frame;

use super::dice::Dice;

/// Who a frame is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Side {
    /// The arm.
    Arm,
    /// All executors.
    Executors,
}

/// What may happen to each frame in one direction.
#[derive(Clone, Copy, Debug, Default)]
pub struct Line {
    /// Probability to be lost.
    pub drop: f64,
    /// Probability to arrive twice.
    pub duplicate: f64,
    /// Probability to arrive damaged, past the checks that the bus itself makes.
    pub corrupt: f64,
    /// Probability that the second half of a pair is lost.
    pub split: f64,
    /// Shortest and longest delay, microseconds. Frames overtake each other when they differ.
    pub delay_us: (u64, u64),
}

/// Counts of what has happened to frames.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct BusCounts {
    /// Frames given to the bus.
    pub frames: u64,
    /// Lost.
    pub dropped: u64,
    /// Delivered twice.
    pub duplicated: u64,
    /// Damaged.
    pub corrupted: u64,
    /// Pairs of which one half was lost.
    pub split: u64,
}

#[derive(Clone, Debug, PartialEq, Eq)]
struct InFlight {
    at_us: u64,
    number: u64,
    to: Side,
    /// Index of the executor that sent it; `None` for the arm and for strangers.
    from: Option<usize>,
    frame: Frame,
}

impl Ord for InFlight {
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        (self.at_us, self.number).cmp(&(other.at_us, other.number))
    }
}

impl PartialOrd for InFlight {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}

/// A frame that has arrived.
#[derive(Clone, Debug)]
pub struct Arrival {
    /// For whom.
    pub to: Side,
    /// Index of the executor that sent it; `None` for the arm and for strangers.
    pub from: Option<usize>,
    /// The frame, damaged or not.
    pub frame: Frame,
}

/// The wire.
#[derive(Clone, Debug, Default)]
pub struct Bus {
    in_flight: BinaryHeap<Reverse<InFlight>>,
    /// When the last piece of a record arrives, to the arm and to executors.
    record_us: [u64; 2],
    number: u64,
    /// What has happened.
    pub counts: BusCounts,
}

/// Identifiers of the second halves of pairs.
const SECOND_HALVES: [u16; 2] = [0x301, 0x381];

/// Identifiers of the pieces of handshake records, to the arm and to executors. These arrive in the order that they were
/// sent in, as all frames of one identifier do on a real wire: of a dozen pieces in any order hardly ever a record is made,
/// and what comes after the handshake would go untried. Cyclic frames have to bear what no wire does to them.
const RECORD_PIECES: [u16; 2] = [0x601, 0x581];

impl Bus {
    /// A frame is sent.
    pub fn send(
        &mut self,
        now_us: u64,
        dice: &mut Dice,
        line: &Line,
        to: Side,
        from: Option<usize>,
        frame: Frame,
    ) {
        self.counts.frames = self.counts.frames.saturating_add(1);
        if dice.chance(line.drop) {
            self.counts.dropped = self.counts.dropped.saturating_add(1);
            return;
        }
        if SECOND_HALVES.contains(&frame.id) && dice.chance(line.split) {
            self.counts.split = self.counts.split.saturating_add(1);
            return;
        }
        if dice.chance(line.duplicate) {
            self.counts.duplicated = self.counts.duplicated.saturating_add(1);
            self.deliver(now_us, dice, line, to, from, frame.clone());
        }
        let mut frame = frame;
        if dice.chance(line.corrupt) {
            self.counts.corrupted = self.counts.corrupted.saturating_add(1);
            damage(dice, &mut frame);
        }
        self.deliver(now_us, dice, line, to, from, frame);
    }

    fn deliver(
        &mut self,
        now_us: u64,
        dice: &mut Dice,
        line: &Line,
        to: Side,
        from: Option<usize>,
        frame: Frame,
    ) {
        let (shortest_us, longest_us) = line.delay_us;
        let mut at_us = now_us.saturating_add(dice.between(shortest_us, longest_us));
        if let Some(way) = RECORD_PIECES.iter().position(|id| *id == frame.id)
            && let Some(record_us) = self.record_us.get_mut(way)
        {
            at_us = at_us.max(*record_us);
            *record_us = at_us;
        }
        self.number = self.number.saturating_add(1);
        self.in_flight.push(Reverse(InFlight { at_us, number: self.number, to, from, frame }));
    }

    /// When the next frame arrives.
    #[must_use]
    pub fn next_us(&self) -> Option<u64> {
        self.in_flight.peek().map(|Reverse(next)| next.at_us)
    }

    /// The next frame that has arrived by now.
    pub fn arrival(&mut self, now_us: u64) -> Option<Arrival> {
        self.next_us().filter(|next_us| *next_us <= now_us)?;
        let Reverse(InFlight { to, from, frame, .. }) = self.in_flight.pop()?;
        Some(Arrival { to, from, frame })
    }

    /// All that is on its way is lost.
    pub fn clear(&mut self) {
        self.in_flight.clear();
    }
}

/// One to three bits flip, or the whole of the data becomes noise, or some of it is missing.
fn damage(dice: &mut Dice, frame: &mut Frame) {
    let length = u64::try_from(frame.data.len()).unwrap_or(0);
    if length == 0 {
        return;
    }
    match dice.between(0, 9) {
        0 => frame.data.iter_mut().for_each(|byte| *byte = dice.number().to_le_bytes()[0]),
        1 => {
            let kept = usize::try_from(dice.between(0, length.saturating_sub(1))).unwrap_or(0);
            frame.data.truncate(kept);
        }
        flips => {
            for _ in 0..flips.min(3) {
                let place = usize::try_from(dice.between(0, length.saturating_sub(1))).unwrap_or(0);
                let bit = dice.between(0, 7);
                frame.data.iter_mut().skip(place).take(1).for_each(|byte| *byte ^= 1 << bit);
            }
        }
    }
}
