//! Who is told how far a simulator is, and may stop it.

use std::ops::ControlFlow;

use crate::rollout::{RolloutError, Simulate};

/// Is told now and then what share of the present call is done, from 0 to 1. [`ControlFlow::Break`] ends the call with
/// [`RolloutError::Stopped`].
pub type ProgressFn = Box<dyn FnMut(f64) -> ControlFlow<()> + Send>;

/// Is told work units done and in total on the way through one call. [`ControlFlow::Break`] ends it.
pub type Tick<'a> = &'a mut (dyn FnMut(u64, u64) -> ControlFlow<()> + Send);

/// Nobody is told.
pub(crate) fn quiet(_: u64, _: u64) -> ControlFlow<()> {
    ControlFlow::Continue(())
}

/// Who watches a simulator.
pub struct Watch {
    tell: ProgressFn,
    span: [f64; 2],
}

impl Default for Watch {
    /// Nobody.
    fn default() -> Self {
        Self { tell: Box::new(|_| ControlFlow::Continue(())), span: [0.0, 1.0] }
    }
}

impl Watch {
    /// From now on this is told instead.
    pub fn set(&mut self, tell: ProgressFn) {
        *self = Self { tell, ..Self::default() };
    }

    /// What is told from now on are shares of what was told so far; returns what [`Self::leave`] takes. See [`part`].
    pub fn enter(&mut self, [from, to]: [f64; 2]) -> [f64; 2] {
        let [start, end] = self.span;
        let at = |share: f64| start + (end - start) * share;
        std::mem::replace(&mut self.span, [at(from), at(to)])
    }

    /// The part is over.
    pub fn leave(&mut self, outer: [f64; 2]) {
        self.span = outer;
    }

    /// Tells work units done and in total.
    pub fn tell(&mut self, done: u64, total: u64) -> ControlFlow<()> {
        let [start, end] = self.span;
        let share = (done as f64 / total.max(1) as f64).min(1.0);
        (self.tell)(start + (end - start) * share)
    }

    /// The same in a function that can fail.
    ///
    /// # Errors
    /// [`RolloutError::Stopped`] where that is answered.
    pub fn check(&mut self, done: u64, total: u64) -> Result<(), RolloutError> {
        go_on(self.tell(done, total))
    }
}

/// Calls that are a part of a larger job: what is told meanwhile are shares of that, from the first to the second of these.
pub fn part<R>(
    simulator: &mut dyn Simulate,
    shares: [f64; 2],
    calls: impl FnOnce(&mut dyn Simulate) -> R,
) -> R {
    let outer = simulator.watch().enter(shares);
    let found = calls(simulator);
    simulator.watch().leave(outer);
    found
}

/// [`RolloutError::Stopped`] for a break.
pub(crate) fn go_on(answer: ControlFlow<()>) -> Result<(), RolloutError> {
    if answer.is_break() { Err(RolloutError::Stopped) } else { Ok(()) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::{Arc, Mutex};

    #[test]
    fn parts_of_parts_are_told_as_shares_of_the_whole() {
        let told = Arc::new(Mutex::new(Vec::new()));
        let mut watch = Watch::default();
        assert_eq!(watch.tell(1, 2), ControlFlow::Continue(()));
        let into = told.clone();
        watch.set(Box::new(move |share| {
            into.lock().unwrap().push((100.0 * share).round() as u32);
            if share > 0.99 { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
        }));
        let whole = watch.enter([0.5, 0.7]);
        let part = watch.enter([0.5, 1.0]);
        assert!(watch.check(1, 2).is_ok() && watch.check(5, 2).is_ok());
        watch.leave(part);
        assert!(watch.check(0, 0).is_ok());
        watch.leave(whole);
        assert_eq!(watch.check(2, 2), Err(RolloutError::Stopped));
        assert_eq!(*told.lock().unwrap(), [65, 70, 50, 100]);
    }
}
