//! Which states of a rollout are kept, and which are computed again on the way back.
//!
//! Binomial checkpointing (Griewank and Walther 2000, Algorithm 799 "revolve"): with `c` kept states and at most `r`
//! passes over any step, `binomial(c + r, c)` steps can be reversed. With many slots this is "keep every
//! step", with fewer "keep every k-th"; all are the same rule.

/// One thing to do; the driver has a stack of kept states and one working state.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Action {
    /// Copy the top of the stack to the working state.
    Restore,
    /// Advance the working state by this many steps.
    Advance(usize),
    /// Push a copy of the working state.
    Store,
    /// Adjoint of this step; the working state is the one at its beginning.
    Adjoint(usize),
    /// Pop the stack.
    Discard,
}

/// Actions that reverse `steps` steps with `slots` kept states, the initial one included; at least one slot is
/// taken. The initial state is on the stack at the beginning.
pub(crate) fn schedule(steps: usize, slots: usize) -> Schedule {
    Schedule { slots, kept: vec![0], end: steps, next: Next::Restore }
}

/// The actions of a schedule, one by one: in full they would be longer than the motion.
pub(crate) struct Schedule {
    slots: usize,
    /// The steps whose states are on the stack.
    kept: Vec<usize>,
    /// Steps that are still to be reversed.
    end: usize,
    next: Next,
}

impl Schedule {
    /// From now on with so many slots. Where they are fewer than the states that are kept, no more are kept until
    /// enough of these are dropped.
    pub(crate) fn limit(&mut self, slots: usize) {
        self.slots = slots;
    }
}

enum Next {
    Restore,
    /// Advance, or reverse if this is the last step, from here.
    GoOn(usize),
    Store(usize),
}

impl Iterator for Schedule {
    type Item = Action;

    fn next(&mut self) -> Option<Action> {
        match self.next {
            Next::Restore => {
                let top = *self.kept.last().filter(|_| self.end > 0)?;
                if top >= self.end {
                    self.kept.pop();
                    return Some(Action::Discard);
                }
                self.next = Next::GoOn(top);
                Some(Action::Restore)
            }
            Next::GoOn(at) if at + 1 < self.end => {
                let free = self.slots.saturating_sub(self.kept.len());
                let last = self.end - 1;
                let step = if free == 0 { last - at } else { split(self.end - at, free) };
                let at = at + step;
                self.next = if free > 0 && at < last { Next::Store(at) } else { Next::GoOn(at) };
                Some(Action::Advance(step))
            }
            Next::GoOn(_) => {
                self.end -= 1;
                self.next = Next::Restore;
                Some(Action::Adjoint(self.end))
            }
            Next::Store(at) => {
                self.kept.push(at);
                self.next = Next::GoOn(at);
                Some(Action::Store)
            }
        }
    }
}

/// How far to advance before keeping the next state, when `length` steps remain to be reversed and `free` slots
/// are left: the left part must be reversible with one pass less, the right part with one slot less. As far as that allows:
/// slots are then taken as late as they can be, and should memory turn out to be for fewer, little was built on them.
fn split(length: usize, free: usize) -> usize {
    let mut passes = 1;
    while reversible(free + 1, passes) < length as f64 {
        passes += 1;
    }
    let left = reversible(free + 1, passes - 1).min(length as f64 - reversible(free, passes - 1));
    (left as usize).clamp(1, length - 1)
}

/// Steps that `slots` kept states and `passes` passes reverse: `binomial(slots + passes, slots)`.
fn reversible(slots: usize, passes: usize) -> f64 {
    (1..=passes).fold(1.0, |b, k| b * (slots + k) as f64 / k as f64)
}

/// Steps that a schedule advances.
pub(crate) fn advances(actions: Schedule) -> u64 {
    actions.map(|a| if let Action::Advance(n) = a { n as u64 } else { 0 }).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Follows the actions with integers for states.
    fn replay(steps: usize, slots: usize) -> u64 {
        let mut stack = vec![0usize];
        let mut working = usize::MAX;
        let mut next = steps;
        for action in schedule(steps, slots) {
            match action {
                Action::Restore => working = stack[stack.len() - 1],
                Action::Advance(n) => working += n,
                Action::Store => stack.push(working),
                Action::Adjoint(k) => {
                    assert_eq!((working, k + 1), (k, next));
                    next = k;
                }
                Action::Discard => {
                    stack.pop();
                }
            }
            assert!(stack.len() <= slots.max(1));
        }
        assert_eq!(next, 0);
        advances(schedule(steps, slots))
    }

    #[test]
    fn every_step_is_reversed_once_from_its_own_state() {
        for steps in [0, 1, 2, 3, 10, 57, 300] {
            for slots in [1, 2, 3, 5, 8, 64, 1000] {
                replay(steps, slots);
            }
        }
    }

    #[test]
    fn work_is_linear_with_enough_slots_and_binomial_with_few() {
        assert_eq!(replay(500, 500), 499);
        assert_eq!(replay(100, 1), 99 * 100 / 2);
        // With c slots and length binomial(c + r, c) revolve's optimum is r l - binomial(c + r, r - 1):
        // here c = 4, r = 3, l = 35.
        assert_eq!(replay(35, 4), 3 * 35 - 21);
        // Twice the square root of the length costs about one more pass.
        assert!(replay(10_000, 200) < 2 * 10_000);
    }

    /// Advances where the last states are `growth` times as large as the first, and all may take as much as `slots` of the first.
    fn replay_growing(steps: usize, slots: usize, growth: f64) -> u64 {
        let size = |step: usize| 1.0 + (growth - 1.0) * step as f64 / steps as f64;
        let (mut kept, mut at, mut advanced, mut largest) = (vec![0], 0, 0, 1.0f64);
        let mut schedule = schedule(steps, slots);
        while let Some(action) = schedule.next() {
            match action {
                Action::Restore => at = kept[kept.len() - 1],
                Action::Advance(count) => (at, advanced) = (at + count, advanced + count as u64),
                Action::Store => kept.push(at),
                Action::Discard => at = kept.pop().unwrap(),
                Action::Adjoint(_) => {}
            }
            largest = largest.max(size(at));
            schedule.limit((slots as f64 / largest) as usize);
            assert!(kept.iter().map(|step| size(*step)).sum::<f64>() <= slots as f64);
        }
        advanced
    }

    #[test]
    fn states_that_grow_on_the_way_leave_fewer_slots_and_cost_little() {
        for (slots, growth) in [(60, 1.4), (140, 1.4), (400, 1.4), (400, 3.0)] {
            let (even, growing) = (replay(10_000, slots), replay_growing(10_000, slots, growth));
            let last = replay(10_000, (slots as f64 / growth) as usize);
            println!("{slots} slots, {growth} times: {even} advances, growing {growing}, all large {last}");
            assert!(growing <= last + last / 5);
        }
    }
}
