//! What goes wrong in a run, drawn from its seed.

use powderline_shared::wire::frame::Dialect;

use super::bus::Line;
use super::dice::Dice;

/// Something that happens at a moment.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Event {
    /// The executor's process does not run for a while.
    ExecutorFrozen,
    /// The arm's controller does not run for a while.
    ArmFrozen,
    /// The executor dies, and is started again with a new session, perhaps by somebody who resets the arm.
    ExecutorRestarts,
    /// The same, but with another plan.
    WrongPlan,
    /// The arm loses its power, falls into its brakes, and starts again.
    ArmRestarts,
    /// The bus carries nothing for a while, and the executor is told.
    BusOff,
    /// The same, and the executor is not told.
    WireCut,
    /// The executor's queue to the bus is full for a while: most of what it sends is not taken.
    QueueFull,
    /// A broken node fills the bus with rubbish and with frames that it has heard before.
    Babble,
    /// Another executor wants the same arm.
    ForeignSession,
    /// A person asks for a stop.
    OperatorStop,
    /// A person asks for a stop twice.
    HardStop,
    /// Some other node sends the stop frame.
    StopFrame,
}

impl Event {
    /// All of them.
    pub const ALL: [Self; 13] = [
        Self::ExecutorFrozen,
        Self::ArmFrozen,
        Self::ExecutorRestarts,
        Self::WrongPlan,
        Self::ArmRestarts,
        Self::BusOff,
        Self::WireCut,
        Self::QueueFull,
        Self::Babble,
        Self::ForeignSession,
        Self::OperatorStop,
        Self::HardStop,
        Self::StopFrame,
    ];

    /// For a table.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::ExecutorFrozen => "frozen executor",
            Self::ArmFrozen => "frozen arm",
            Self::ExecutorRestarts => "executor restarted",
            Self::WrongPlan => "executor restarted with another plan",
            Self::ArmRestarts => "arm without power, restarted",
            Self::BusOff => "bus-off",
            Self::WireCut => "wire cut",
            Self::QueueFull => "queue full (ENOBUFS)",
            Self::Babble => "babbling node",
            Self::ForeignSession => "foreign session",
            Self::OperatorStop => "controlled stop by a person",
            Self::HardStop => "immediate stop by a person",
            Self::StopFrame => "stop frame of another node",
        }
    }
}

/// An event, when, and for how long.
#[derive(Clone, Copy, Debug)]
pub struct Planned {
    /// What.
    pub event: Event,
    /// When, microseconds of true time.
    pub at_us: u64,
    /// For how long, microseconds.
    pub for_us: u64,
}

/// Everything that goes wrong in a run.
#[derive(Clone, Debug)]
pub struct Faults {
    /// How messages are put into frames.
    pub dialect: Dialect,
    /// Control period of the plan, microseconds.
    pub period_us: u32,
    /// From executors to the arm.
    pub to_arm: Line,
    /// From the arm to the executors.
    pub from_arm: Line,
    /// How much faster than true time the executor's clock runs, parts per million.
    pub executor_ppm: i64,
    /// The same for the arm's.
    pub arm_ppm: i64,
    /// What happens, in the order of time.
    pub events: Vec<Planned>,
}

impl Faults {
    /// None at all.
    #[must_use]
    pub fn none(dialect: Dialect, period_us: u32) -> Self {
        let line = Line { delay_us: (100, 300), ..Line::default() };
        Self {
            dialect,
            period_us,
            to_arm: line,
            from_arm: line,
            executor_ppm: 0,
            arm_ppm: 0,
            events: Vec::new(),
        }
    }

    /// Drawn by chance: from runs with hardly a fault to runs with everything at once.
    pub fn random(dice: &mut Dice) -> Self {
        let dialect = dice.pick(&[Dialect::Classic, Dialect::Fd]);
        let period_us = match dialect {
            Dialect::Classic => dice.pick(&[5_000, 10_000, 10_000, 20_000]),
            Dialect::Fd => dice.pick(&[2_000, 5_000, 10_000, 10_000, 20_000]),
        };
        let severity = dice.pick(&[0.0, 0.1, 0.3, 1.0]);
        let (to_arm, from_arm) = (random_line(dice, severity), random_line(dice, severity));
        let drift = |dice: &mut Dice| i64::try_from(dice.between(0, 1_000)).unwrap_or(0).saturating_sub(500);
        let (executor_ppm, arm_ppm) = (drift(dice), drift(dice));
        let count = dice.pick(&[0, 0, 1, 1, 1, 2, 3, 5]);
        let mut events: Vec<_> = (0..count).map(|_| random_event(dice)).collect();
        events.sort_by_key(|planned| planned.at_us);
        Self { dialect, period_us, to_arm, from_arm, executor_ppm, arm_ppm, events }
    }

    /// Whether nothing goes wrong that a session would not get over without notice: nobody interferes, nothing is lost,
    /// doubled or damaged, and everything arrives within a control period.
    #[must_use]
    pub fn is_gentle(&self) -> bool {
        let is_gentle = |line: &Line| {
            let (_, longest_us) = line.delay_us;
            let rates = [line.drop, line.duplicate, line.corrupt, line.split];
            rates.iter().all(|rate| *rate <= 0.0) && longest_us <= u64::from(self.period_us)
        };
        self.events.is_empty() && is_gentle(&self.to_arm) && is_gentle(&self.from_arm)
    }
}

fn random_line(dice: &mut Dice, severity: f64) -> Line {
    let mut rate = |most: f64| if dice.chance(0.5) { 0.0 } else { severity * most * dice.share() };
    let (drop, duplicate, corrupt, split) = (rate(0.2), rate(0.2), rate(0.05), rate(0.1));
    let shortest_us = dice.pick(&[0, 100, 1_000, 10_000, 50_000]);
    let jitter_us = dice.pick(&[0, 200, 5_000, 30_000]);
    Line { drop, duplicate, corrupt, split, delay_us: (shortest_us, shortest_us.saturating_add(jitter_us)) }
}

fn random_event(dice: &mut Dice) -> Planned {
    let longest_us = dice.pick(&[5_000, 50_000, 500_000, 2_000_000]);
    Planned {
        event: dice.pick(&Event::ALL),
        at_us: dice.between(0, 2_500_000),
        for_us: dice.between(1_000, longest_us),
    }
}
