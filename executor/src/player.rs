//! Reads setpoints off a plan, one at a time.

use powderline_shared::displacement::Setpoint;
use powderline_shared::plan::{PlanReader, Setpoints};

/// The next setpoint of a plan, and where it ends.
#[derive(Clone, Debug)]
pub struct Player<'a> {
    setpoints: Setpoints<'a>,
    next: Option<Setpoint>,
    end: Setpoint,
}

impl<'a> Player<'a> {
    /// Before the first setpoint.
    #[must_use]
    pub fn new(plan: &PlanReader<'a>) -> Self {
        let mut setpoints = plan.setpoints();
        let next = setpoints.next();
        Self { setpoints, next, end: plan.end_setpoint() }
    }

    /// The setpoint to send next; `None` after the last.
    #[must_use]
    pub fn peek(&self) -> Option<Setpoint> {
        self.next
    }

    /// Goes on to the setpoint after.
    pub fn advance(&mut self) {
        self.next = self.setpoints.next();
    }

    /// The last setpoint of the plan.
    #[must_use]
    pub fn end(&self) -> Setpoint {
        self.end
    }
}
