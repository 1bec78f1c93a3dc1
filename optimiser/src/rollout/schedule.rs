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
    Keep,
    /// Adjoint of this step; the working state is the one at its beginning.
    Reverse(usize),
    /// Pop the stack.
    Drop,
}

/// Actions that reverse `steps` steps with `slots` kept states, the initial one included; at least one slot is
/// taken. The initial state is on the stack at the beginning.
pub(crate) fn schedule(steps: usize, slots: usize) -> Vec<Action> {
    let mut actions = Vec::new();
    let mut kept = vec![0usize];
    let mut end = steps;
    while end > 0 {
        let top = *kept.last().expect("the initial state stays until the end");
        if top >= end {
            kept.pop();
            actions.push(Action::Drop);
            continue;
        }
        actions.push(Action::Restore);
        let mut at = top;
        while at + 1 < end {
            let free = slots.saturating_sub(kept.len());
            let step = if free == 0 { end - 1 - at } else { split(end - at, free) };
            actions.push(Action::Advance(step));
            at += step;
            if free > 0 && at + 1 < end {
                kept.push(at);
                actions.push(Action::Keep);
            }
        }
        end -= 1;
        actions.push(Action::Reverse(end));
    }
    actions
}

/// How far to advance before keeping the next state, when `length` steps remain to be reversed and `free` slots
/// are left: the left part must be reversible with one pass less, the right part with one slot less.
fn split(length: usize, free: usize) -> usize {
    let mut passes = 1;
    while reversible(free + 1, passes) < length as f64 {
        passes += 1;
    }
    let right = reversible(free, passes).min(length as f64) as usize;
    let left = if passes >= 2 { reversible(free + 1, passes - 2) as usize } else { 1 };
    left.max(length - right).clamp(1, length - 1)
}

/// Steps that `slots` kept states and `passes` passes reverse: `binomial(slots + passes, slots)`.
fn reversible(slots: usize, passes: usize) -> f64 {
    (1..=passes).fold(1.0, |b, k| b * (slots + k) as f64 / k as f64)
}

/// Steps advanced by a schedule.
pub(crate) fn advances(actions: &[Action]) -> u64 {
    actions.iter().map(|a| if let Action::Advance(n) = a { *n as u64 } else { 0 }).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Follows the actions with integers for states.
    fn replay(steps: usize, slots: usize) -> u64 {
        let actions = schedule(steps, slots);
        let mut stack = vec![0usize];
        let mut working = usize::MAX;
        let mut next = steps;
        for action in &actions {
            match action {
                Action::Restore => working = stack[stack.len() - 1],
                Action::Advance(n) => working += n,
                Action::Keep => stack.push(working),
                Action::Reverse(k) => {
                    assert_eq!((working, k + 1), (*k, next));
                    next = *k;
                }
                Action::Drop => {
                    stack.pop();
                }
            }
            assert!(stack.len() <= slots.max(1));
        }
        assert_eq!(next, 0);
        advances(&actions)
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
}
