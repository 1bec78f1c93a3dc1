//! What became of a case.

use crate::report::{amounts::Amounts, finding};
use powderline_simulator::{rollout::Evaluation, skill::Theta};
use serde::{Deserialize, Serialize};

/// What became of a case, as its folder keeps it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Outcome {
    /// What it is of, see [`super::Case::key`].
    pub key: String,
    /// What was found, or why nothing was.
    #[serde(flatten)]
    pub end: End,
}

/// How a case ended.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum End {
    /// As it should.
    Found(Found),
    /// In one sentence.
    Error(String),
}

/// Whether a case came to what was wanted.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Status {
    /// It came to nothing.
    Failed,
    /// What arrives is off by more than the tolerance.
    Missed,
    /// Nobody judges: one rollout of a skill that is given, or a bench that wants as much as can be had.
    Done,
    /// What arrives is what was wanted.
    Met,
}

impl Status {
    /// As the table has it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Failed => "failed",
            Self::Missed => "missed",
            Self::Done => "done",
            Self::Met => "met",
        }
    }
}

/// What a case found.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Found {
    /// Wanted in the target container, kilogram.
    pub wanted_kg: f64,
    /// What arrives there: by the plan as shipped, on the smallest cells on which it was looked at, or by the rollout.
    pub mass_kg: f64,
    /// What arrives on the bench's own cells.
    pub own_mass_kg: f64,
    /// How far that is off, relative: negative where powder is missing.
    pub miss: f64,
    /// Whether that is within the tolerance; none where nobody judges.
    pub met: Option<bool>,
    /// What is on rims, spilled or in flight, kilogram.
    pub lost_kg: f64,
    /// Loss on the bench's own cells, metres: one of smaller particles is a sum over more of them.
    pub loss_m: f64,
    /// The skill.
    pub theta: Theta,
    /// Last epoch of the search, and the one that became the plan.
    pub epochs: Option<[u32; 2]>,
    /// What names the plan: its content hash, hexadecimal.
    pub plan: Option<String>,
}

impl Found {
    /// Of one rollout.
    pub fn of_rollout(amounts: &Amounts, theta: Theta, found: &Evaluation) -> Self {
        Self::of(amounts, theta, &finding::Outcome::of_evaluation(amounts, found))
    }

    /// Of what a motion brings.
    pub fn of(amounts: &Amounts, theta: Theta, outcome: &finding::Outcome) -> Self {
        let finding::Outcome { mass_kg, miss, lost_kg, loss_m, .. } = *outcome;
        let wanted_kg = amounts.wanted_kg;
        Self {
            wanted_kg,
            mass_kg,
            own_mass_kg: mass_kg,
            miss,
            met: None,
            lost_kg,
            loss_m,
            theta,
            epochs: None,
            plan: None,
        }
    }

    /// Whether it is what was wanted.
    pub fn status(&self) -> Status {
        match self.met {
            Some(true) => Status::Met,
            Some(false) => Status::Missed,
            None => Status::Done,
        }
    }
}

impl Outcome {
    /// What was found.
    pub fn found(&self) -> Option<&Found> {
        match &self.end {
            End::Found(found) => Some(found),
            End::Error(_) => None,
        }
    }

    /// Why nothing was found.
    pub fn error(&self) -> Option<&str> {
        match &self.end {
            End::Found(_) => None,
            End::Error(why) => Some(why),
        }
    }

    /// Whether it came to what was wanted.
    pub fn status(&self) -> Status {
        self.found().map_or(Status::Failed, Found::status)
    }
}
