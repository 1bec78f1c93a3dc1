//! What is claimed before anything is measured, how it is measured, and how all of it is run.

use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};

use crate::rollout::{RolloutError, Tick, thread_pool};

/// Why a measurement came to no end.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Halt {
    /// Asked to.
    Stopped,
    /// The powder could not be simulated: what happened.
    Failed(String),
}

impl From<RolloutError> for Halt {
    fn from(error: RolloutError) -> Self {
        match error {
            RolloutError::Stopped => Self::Stopped,
            error => Self::Failed(error.to_string()),
        }
    }
}

/// One line, before it is measured.
#[derive(Clone, Debug)]
pub(super) struct Claim {
    pub(super) group: &'static str,
    /// What is measured; no two lines have the same.
    pub(super) name: String,
    /// Empty for a ratio.
    pub(super) unit: &'static str,
    pub(super) reference: f64,
    /// Lowest and highest value that will do.
    pub(super) tolerance: [f64; 2],
    pub(super) source: &'static str,
    /// Why that tolerance.
    pub(super) why: &'static str,
    /// What is wrong where the number is too low, and where it is too high: the end of a sentence whose
    /// beginning is the name.
    pub(super) wrong: [&'static str; 2],
    /// Something is broken on purpose: the number must lie outside.
    pub(super) control: bool,
}

impl Claim {
    /// The same with what lies so far from the reference.
    pub(super) fn within(mut self, distance: f64) -> Self {
        self.tolerance = [self.reference - distance, self.reference + distance];
        self
    }

    /// The same with what lies within such a share of the reference.
    pub(super) fn within_share(self, share: f64) -> Self {
        let distance = share * self.reference;
        self.within(distance)
    }
}

/// Measures the numbers of a case's claims, for one seed.
type Measure<'a> = Box<dyn Fn(u64, &Meter<'_>) -> Result<Vec<f64>, Halt> + Send + Sync + 'a>;

/// Lines that are measured together.
pub(super) struct Case<'a> {
    pub(super) claims: Vec<Claim>,
    /// Repeated with so many seeds, from 1 on.
    pub(super) seeds: u64,
    /// Particles times substeps of one seed, roughly.
    pub(super) work: f64,
    pub(super) measure: Measure<'a>,
}

/// What a case's claims were found to be with one seed.
pub(super) type Found = Result<Vec<f64>, Halt>;

/// Everybody's progress.
struct Watched<'a> {
    progress: Mutex<Tick<'a>>,
    done: AtomicU64,
    total: u64,
    stopped: AtomicBool,
}

/// Counts the work of one job, and says when to stop.
pub(super) struct Meter<'a> {
    watched: Option<&'a Watched<'a>>,
    allowance: u64,
    spent: AtomicU64,
}

impl Meter<'_> {
    /// One that counts for nobody.
    #[cfg(test)]
    pub(super) fn unwatched() -> Self {
        Self { watched: None, allowance: 0, spent: AtomicU64::new(0) }
    }

    /// Tells that so many particles go on by a substep each.
    pub(super) fn spend(&self, units: u64) -> Result<(), Halt> {
        let before = self.spent.fetch_add(units, Ordering::Relaxed);
        self.tell(self.allowance.saturating_sub(before).min(units))
    }

    /// Tells the rest of what was allowed.
    fn finish(&self) -> Result<(), Halt> {
        self.tell(self.allowance.saturating_sub(self.spent.load(Ordering::Relaxed)))
    }

    fn tell(&self, units: u64) -> Result<(), Halt> {
        let Some(watched) = self.watched else { return Ok(()) };
        let done = watched.done.fetch_add(units, Ordering::Relaxed) + units;
        // Whoever finds somebody else telling need not wait: it is told again soon.
        if let Ok(mut progress) = watched.progress.try_lock()
            && progress(done.min(watched.total), watched.total).is_break()
        {
            watched.stopped.store(true, Ordering::Relaxed);
        }
        if watched.stopped.load(Ordering::Relaxed) { Err(Halt::Stopped) } else { Ok(()) }
    }
}

/// Runs all cases, side by side on so many threads, each by one of them: what is found does not depend on
/// their number. Of each case, what was found with its seeds; where `progress` broke off,
/// [`Halt::Stopped`].
pub(super) fn run(
    cases: &[Case<'_>],
    threads: usize,
    progress: Tick<'_>,
) -> Result<Vec<Vec<Found>>, RolloutError> {
    let units = |case: &Case<'_>| (case.work as u64).max(1);
    let watched = Watched {
        progress: Mutex::new(progress),
        done: AtomicU64::new(0),
        total: cases.iter().map(|case| case.seeds * units(case)).sum(),
        stopped: AtomicBool::new(false),
    };
    let seeds = |case: &Case<'_>| 0..case.seeds as usize;
    let mut jobs: Vec<(usize, usize)> =
        (0..cases.len()).flat_map(|case| seeds(&cases[case]).map(move |seed| (case, seed))).collect();
    // What takes no time is there at once; then the longest first, so that in the end no thread is left alone
    // with one.
    let rank = |(case, _): &(usize, usize)| match cases[*case].work {
        work if work > 0.0 => -work,
        _ => f64::NEG_INFINITY,
    };
    jobs.sort_by(|a, b| rank(a).total_cmp(&rank(b)));
    let next = AtomicUsize::new(0);
    let work = |pool: rayon::ThreadPool| {
        let mut done = Vec::new();
        while let Some((case, seed)) = jobs.get(next.fetch_add(1, Ordering::Relaxed)) {
            let allowance = units(&cases[*case]);
            let meter = Meter { watched: Some(&watched), allowance, spent: AtomicU64::new(0) };
            let found = pool.install(|| (cases[*case].measure)(*seed as u64 + 1, &meter));
            done.push((*case, *seed, found));
            if meter.finish().is_err() {
                break;
            }
        }
        done
    };
    let mut found: Vec<Vec<Found>> =
        cases.iter().map(|case| seeds(case).map(|_| Err(Halt::Stopped)).collect()).collect();
    let pools = (0..threads.clamp(1, jobs.len().max(1))).map(|_| thread_pool(1));
    let pools = pools.collect::<Result<Vec<_>, _>>()?;
    std::thread::scope(|scope| {
        let workers: Vec<_> = pools.into_iter().map(|pool| scope.spawn(|| work(pool))).collect();
        for worker in workers {
            let done = worker.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic));
            done.into_iter().for_each(|(case, seed, result)| found[case][seed] = result);
        }
    });
    Ok(found)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::ops::ControlFlow;

    /// A case that takes its work in ten steps and finds seed and name.
    fn case(number: u64, seeds: u64) -> Case<'static> {
        let measure = move |seed, meter: &Meter<'_>| {
            (0..10).try_for_each(|_| meter.spend(10))?;
            match seed {
                9 => Err(Halt::Failed("gone".into())),
                _ => Ok(vec![(10 * number + seed) as f64]),
            }
        };
        Case { claims: Vec::new(), seeds, work: 100.0, measure: Box::new(measure) }
    }

    #[test]
    fn what_is_found_does_not_depend_on_the_threads() {
        let cases = [case(1, 2), case(2, 1), case(3, 9)];
        for threads in [1, 2, 7] {
            let (mut last, mut total) = (0, 0);
            let found = run(&cases, threads, &mut |done, all| {
                (last, total) = (last.max(done), all);
                ControlFlow::Continue(())
            });
            let found = found.unwrap();
            assert_eq!(found[0], [Ok(vec![11.0]), Ok(vec![12.0])], "{threads}");
            assert_eq!(found[1], [Ok(vec![21.0])]);
            assert_eq!(found[2][8], Err(Halt::Failed("gone".into())));
            assert!(total == 1200 && last <= total && (threads > 1 || last == total), "{last} of {total}");
        }
    }

    #[test]
    fn what_is_done_when_it_is_stopped_stays() {
        let found = run(&[case(1, 1), case(2, 1)], 1, &mut |done, _| {
            if done < 150 { ControlFlow::Continue(()) } else { ControlFlow::Break(()) }
        })
        .unwrap();
        assert_eq!(found, [[Ok(vec![11.0])], [Err(Halt::Stopped)]]);
    }

    #[test]
    fn who_spends_more_than_expected_is_told_no_more_than_that() {
        let greedy = Case {
            work: 15.0,
            measure: Box::new(|_, meter| (0..10).try_for_each(|_| meter.spend(10)).map(|()| vec![0.0])),
            ..case(1, 1)
        };
        let mut told = Vec::new();
        run(&[greedy], 1, &mut |done, total| {
            told.push((done, total));
            ControlFlow::Continue(())
        })
        .unwrap();
        assert_eq!((told[0], told[1], told[told.len() - 1]), ((10, 15), (15, 15), (15, 15)));
    }
}
