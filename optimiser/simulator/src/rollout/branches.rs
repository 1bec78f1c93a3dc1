//! Many motions from one start, side by side.
//!
//! Skills that differ in one parameter begin alike: until the first control in which they differ they are one
//! rollout, which is computed once; gates, which go by time, part nobody. What has changed is shared out among workers, each with threads of its own; that
//! uses processors better than all of them on one rollout, and changes no bit.

use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};

use crate::mpm::Model;
use crate::mpm::sort::EscapedParticle;
use crate::mpm::spare::BufferPool;
use crate::mpm::substep::{State, Workspace};
use crate::real::Real;
use crate::rollout::path::Trajectory;
use crate::rollout::{Evaluation, RolloutError, Tick, thread_pool};

/// A worker: threads of its own, and what their substeps need.
pub(crate) struct Worker<T> {
    pub(crate) pool: rayon::ThreadPool,
    pub(crate) workspace: Workspace<T>,
}

impl<T: Real> Worker<T> {
    pub(crate) fn new(threads: usize) -> Result<Self, RolloutError> {
        Ok(Self { pool: thread_pool(threads)?, workspace: Workspace::new() })
    }
}

/// What all motions have in common.
pub(crate) struct Batch<'a, T> {
    pub(crate) model: &'a Model<T>,
    /// As many controls each.
    pub(crate) paths: &'a [Trajectory],
    /// Turns what went wrong in a substep into an error.
    pub(crate) lost: &'a (dyn Fn(usize, EscapedParticle, &State<T>) -> RolloutError + Sync),
    /// What a path has achieved, by the state at its end.
    pub(crate) judge: &'a (dyn Fn(&Trajectory, &State<T>) -> Evaluation + Sync),
}

/// Motions that have been the same so far.
struct Branch<T> {
    state: State<T>,
    /// Control steps done.
    step: usize,
    /// Indices of the motions, at least one.
    members: Vec<usize>,
}

/// Branches that wait for a worker, and how far everything is.
struct Queue<'p, T> {
    waiting: Vec<Branch<T>>,
    /// Memory of states.
    spare: &'p mut BufferPool<T>,
    /// Branches in the hands of workers.
    running: usize,
    ends: Vec<Option<Result<Evaluation, RolloutError>>>,
    progress: Tick<'p>,
    done: u64,
    total: u64,
    stopped: bool,
    /// Not even one worker could be started.
    refused: bool,
}

/// Ends everything if its worker panics, so that nobody waits for what that worker had in hands.
struct StopOnPanic<'a, 'p, T> {
    work: &'a Mutex<Queue<'p, T>>,
    changed: &'a Condvar,
}

impl<T> Drop for StopOnPanic<'_, '_, T> {
    fn drop(&mut self) {
        if std::thread::panicking() {
            lock(self.work).stopped = true;
            self.changed.notify_all();
        }
    }
}

/// Workers for so many threads and motions, if they may take `free_bytes` and one of several takes `per_worker`.
pub(crate) fn worker_count(threads: usize, motions: usize, free_bytes: u64, per_worker: u64) -> usize {
    threads.min(motions).min((free_bytes / per_worker.max(1)) as usize).max(1)
}

/// What all paths achieve, in order. `workers` are the workers' threads and what they need, at least one.
pub(crate) fn run<T: Real>(
    batch: &Batch<'_, T>,
    start: State<T>,
    workers: Vec<(&rayon::ThreadPool, &mut Workspace<T>)>,
    spare: &mut BufferPool<T>,
    progress: Tick<'_>,
) -> Result<Vec<Evaluation>, RolloutError> {
    let members: Vec<usize> = (0..batch.paths.len()).collect();
    let total = batch.steps(0, &members);
    let work = Mutex::new(Queue {
        waiting: vec![Branch { state: start, step: 0, members }],
        spare,
        running: 0,
        ends: batch.paths.iter().map(|_| None).collect(),
        progress,
        done: 0,
        total,
        stopped: false,
        refused: false,
    });
    let changed = Condvar::new();
    std::thread::scope(|scope| {
        for (started, (pool, workspace)) in workers.into_iter().enumerate() {
            let (work, changed) = (&work, &changed);
            let worker = move || pool.install(|| batch.work(workspace, work, changed));
            let thread = std::thread::Builder::new().spawn_scoped(scope, worker);
            // One worker is enough to get everything done.
            if thread.is_err() && started == 0 {
                lock(work).refused = true;
            }
        }
    });
    let work = work.into_inner().unwrap_or_else(PoisonError::into_inner);
    if work.refused {
        return Err(RolloutError::Threads { threads: 1 });
    }
    if work.stopped {
        return Err(RolloutError::Stopped);
    }
    work.ends.into_iter().map(|end| end.expect("every branch was followed to its end")).collect()
}

fn lock<'a, 'p, T>(work: &'a Mutex<Queue<'p, T>>) -> MutexGuard<'a, Queue<'p, T>> {
    work.lock().unwrap_or_else(PoisonError::into_inner)
}

impl<T: Real> Batch<'_, T> {
    /// Worker loop: takes a branch, advances it until its members diverge or end, queues the branches that result.
    fn work(&self, workspace: &mut Workspace<T>, work: &Mutex<Queue<'_, T>>, changed: &Condvar) {
        let _alarm = StopOnPanic { work, changed };
        let mut guard = lock(work);
        loop {
            if guard.stopped || (guard.waiting.is_empty() && guard.running == 0) {
                changed.notify_all();
                return;
            }
            let Some(branch) = guard.waiting.pop() else {
                guard = changed.wait(guard).unwrap_or_else(PoisonError::into_inner);
                continue;
            };
            guard.running += 1;
            drop(guard);
            let members = branch.members.clone();
            let followed = self.follow(branch, workspace, work);
            let followed = followed.map(|branch| (self.judged(&branch), branch));
            guard = lock(work);
            guard.running -= 1;
            match followed {
                Ok((Some(evaluations), branch)) => {
                    for (member, evaluation) in branch.members.into_iter().zip(evaluations) {
                        guard.ends[member] = Some(Ok(evaluation));
                    }
                    branch.state.recycle_into(guard.spare);
                }
                Ok((None, branch)) => {
                    let changed = self.part(branch, guard.spare);
                    guard.waiting.extend(changed);
                }
                Err(RolloutError::Stopped) => guard.stopped = true,
                Err(error) => members.iter().for_each(|m| guard.ends[*m] = Some(Err(error.clone()))),
            }
            changed.notify_all();
        }
    }

    /// What a branch's members have achieved, if it has come to the end.
    fn judged(&self, branch: &Branch<T>) -> Option<Vec<Evaluation>> {
        let judge = |member: &usize| (self.judge)(&self.paths[*member], &branch.state);
        (branch.step == self.length()).then(|| branch.members.iter().map(judge).collect())
    }

    fn length(&self) -> usize {
        self.paths.first().map_or(0, Trajectory::steps)
    }

    /// Advances a branch to where its members part, or to the end.
    fn follow(
        &self,
        mut branch: Branch<T>,
        workspace: &mut Workspace<T>,
        work: &Mutex<Queue<'_, T>>,
    ) -> Result<Branch<T>, RolloutError> {
        let path = &self.paths[branch.members[0]];
        let end = self.divergence_step(branch.step, &branch.members);
        for step in branch.step..end {
            for substep in path.substeps_of(step) {
                workspace
                    .substep(self.model, &path.bodies(&self.model.gates, substep), &mut branch.state)
                    .map_err(|lost| (self.lost)(substep, lost, &branch.state))?;
            }
            let mut guard = lock(work);
            guard.done += 1;
            let Queue { progress, done, total, stopped, .. } = &mut *guard;
            if *stopped || progress(*done, *total).is_break() {
                return Err(RolloutError::Stopped);
            }
        }
        branch.step = end;
        Ok(branch)
    }

    /// The first step, not before `from`, whose controls are not the same bits in all members.
    fn divergence_step(&self, from: usize, members: &[usize]) -> usize {
        let first = &self.paths[members[0]];
        let same = |step: &usize| {
            members.iter().all(|m| self.paths[*m].control_bits(*step) == first.control_bits(*step))
        };
        (from..self.length()).find(|step| !same(step)).unwrap_or(self.length())
    }

    /// Members that go on alike, in order; the largest group last, because most work hangs on it.
    fn groups(&self, step: usize, members: &[usize]) -> Vec<Vec<usize>> {
        let mut groups: Vec<Vec<usize>> = Vec::new();
        for member in members {
            let control = |m: usize| self.paths[m].control_bits(step);
            match groups.iter_mut().find(|group| control(group[0]) == control(*member)) {
                Some(group) => group.push(*member),
                None => groups.push(vec![*member]),
            }
        }
        groups.sort_by_key(Vec::len);
        groups
    }

    /// The last one goes on in the memory of the branch that they part from.
    fn part(&self, branch: Branch<T>, spare: &mut BufferPool<T>) -> Vec<Branch<T>> {
        let Branch { state, step, members } = branch;
        let mut groups = self.groups(step, &members);
        let last = groups.pop();
        let others = groups.into_iter().map(|members| Branch { state: state.copied(spare), step, members });
        let mut changed: Vec<_> = others.collect();
        changed.extend(last.map(|members| Branch { state, step, members }));
        changed
    }

    /// Control steps to be simulated from a step on.
    fn steps(&self, from: usize, members: &[usize]) -> u64 {
        let end = self.divergence_step(from, members);
        let rest = if end == self.length() { Vec::new() } else { self.groups(end, members) };
        (end - from) as u64 + rest.iter().map(|group| self.steps(end, group)).sum::<u64>()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn workers_are_bounded_by_threads_motions_and_memory() {
        assert_eq!(worker_count(4, 11, 1000, 5), 4);
        assert_eq!(worker_count(16, 7, 1000, 5), 7);
        assert_eq!(worker_count(16, 11, 19, 5), 3);
        assert_eq!(worker_count(16, 11, 0, 5), 1);
    }
}
