//! Every state within so many deviations from a regular run, each visited once.

use std::collections::{BTreeSet, HashSet};
use std::fmt;
use std::sync::Mutex;

use powderline_executor::Outcome;
use powderline_shared::fault::FaultCode;
use powderline_shared::wire::state::State;
use rayon::prelude::*;

use crate::world::{Scene, Step, World};

/// Breaches of different kinds that are kept, with their paths.
const KEPT_BREACHES: usize = 8;

/// Which deviations there are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Deviations {
    /// Those of the wire.
    Wire,
    /// Those of the wire, of people, of processes and of other nodes.
    All,
}

/// What was found.
#[derive(Debug, Default)]
pub(crate) struct Found {
    /// Distinct states that take 0, 1, 2.. deviations.
    pub(crate) states: Vec<usize>,
    /// Steps from one state to another or the same.
    pub(crate) transitions: usize,
    /// Distinct states of the arm, from each of which there is a way out.
    pub(crate) arms: usize,
    /// Distinct states of an executor, in each of which it ends if it hears nothing more.
    pub(crate) executors: usize,
    /// The arm's states seen.
    pub(crate) arm_states: HashSet<State>,
    /// What the arm was seen to latch.
    pub(crate) arm_faults: HashSet<FaultCode>,
    /// The executors' stages seen.
    pub(crate) stages: BTreeSet<String>,
    /// Why executors were seen to end; `None` stands for a completed plan.
    pub(crate) endings: HashSet<Option<FaultCode>>,
    /// What may never happen, and did.
    pub(crate) breach_count: usize,
    /// The first breach of each kind, with the path to it.
    pub(crate) breaches: Vec<String>,
}

/// How a state was found first.
struct Way {
    from: usize,
    step: Step,
}

struct Search<'p> {
    scene: &'p Scene,
    kind: Deviations,
    known: HashSet<u64>,
    ways: Vec<Way>,
    arms: Mutex<HashSet<u64>>,
    executors: Mutex<HashSet<(usize, u64)>>,
    breach_kinds: BTreeSet<String>,
    found: Found,
}

/// A state and its number.
type Numbered<'p> = (usize, World<'p>);

/// What is found out about a state.
struct Expanded<'p> {
    number: usize,
    breaches: Vec<String>,
    stages: Vec<String>,
    regular: Vec<(Step, u64, World<'p>)>,
    deviating: Vec<(Step, u64, World<'p>)>,
}

/// Visits every state within `most` deviations.
pub(crate) fn run(scene: &Scene, kind: Deviations, most: usize) -> Found {
    let root = World::new(scene);
    let mut search = Search {
        scene,
        kind,
        known: HashSet::from([root.hash()]),
        ways: vec![Way { from: 0, step: Step::Time }],
        arms: Mutex::default(),
        executors: Mutex::default(),
        breach_kinds: BTreeSet::new(),
        found: Found::default(),
    };
    let mut begin = vec![(0, root)];
    for deviations in 0..=most {
        begin = search.visit(begin, deviations < most);
    }
    let Search { arms, executors, found, .. } = search;
    Found { arms: count(arms), executors: count(executors), ..found }
}

fn count<T>(known: Mutex<HashSet<T>>) -> usize {
    known.into_inner().map_or(0, |known| known.len())
}

impl<'p> Search<'p> {
    /// Visits all states that are reached from these by regular steps; those that are one deviation further.
    fn visit(&mut self, begin: Vec<Numbered<'p>>, deviates: bool) -> Vec<Numbered<'p>> {
        let (mut wave, mut further, mut count) = (begin, Vec::new(), 0);
        while !wave.is_empty() {
            count += wave.len();
            // In parallel, but taken in the order of their numbers: each run finds the same.
            let expanded: Vec<_> =
                wave.par_iter().map(|(number, world)| self.expanded(*number, world, deviates)).collect();
            wave = Vec::new();
            for Expanded { number, breaches, stages, regular, deviating } in expanded {
                breaches.iter().for_each(|breach| self.breach(number, None, breach));
                self.found.stages.extend(stages);
                self.take(number, regular, &mut wave);
                self.take(number, deviating, &mut further);
            }
        }
        self.found.states.push(count);
        further
    }

    fn expanded(&self, number: usize, world: &World<'p>, deviates: bool) -> Expanded<'p> {
        let (mut breaches, mut stages) = (Vec::new(), Vec::new());
        if is_new(&self.arms, world.arm_in_short().0) {
            breaches.extend(world.find_way_out().err());
        }
        for (slot, _) in world.executor_hashes().filter(|executor| is_new(&self.executors, *executor)) {
            breaches.extend(world.let_end(slot).err());
            stages.push(world.stage(slot));
        }
        let all = |steps: Vec<Step>| {
            let after = |step| {
                let next = world.after(step);
                (step, next.hash(), next)
            };
            steps.into_iter().map(after).collect::<Vec<_>>()
        };
        let mut deviations = if deviates { world.wire_deviations() } else { Vec::new() };
        if deviates && self.kind == Deviations::All {
            deviations.extend(world.interferences());
        }
        Expanded { number, breaches, stages, regular: all(world.regular_steps()), deviating: all(deviations) }
    }

    fn take(&mut self, from: usize, after: Vec<(Step, u64, World<'p>)>, wave: &mut Vec<Numbered<'p>>) {
        for (step, hash, world) in after {
            self.note(from, step, &world);
            if self.known.insert(hash) {
                wave.push((self.ways.len(), world));
                self.ways.push(Way { from, step });
            }
        }
    }

    fn note(&mut self, from: usize, step: Step, world: &World<'_>) {
        let (_, state, fault) = world.arm_in_short();
        self.found.transitions += 1;
        self.found.arm_states.insert(state);
        self.found.arm_faults.extend(fault);
        self.found.endings.extend(world.report.endings.iter().map(|ending| match ending {
            Outcome::Completed => None,
            Outcome::Stopped { fault, .. } => Some(fault.code),
        }));
        world.report.breaches.iter().for_each(|breach| self.breach(from, Some(step), breach));
    }

    fn breach(&mut self, number: usize, step: Option<Step>, what: &str) {
        self.found.breach_count += 1;
        let kind = what.chars().filter(|char| !char.is_ascii_digit()).collect();
        if self.breach_kinds.len() < KEPT_BREACHES && self.breach_kinds.insert(kind) {
            self.found.breaches.push(format!("{what}\n{}", self.path(number, step)));
        }
    }

    /// The way to a state and one step further, with every state on it.
    fn path(&self, number: usize, last: Option<Step>) -> String {
        let ways = std::iter::successors(Some(number), |at| Some(self.ways.get(*at)?.from));
        let steps: Vec<_> =
            ways.take_while(|at| *at > 0).filter_map(|at| Some(self.ways.get(at)?.step)).collect();
        let mut world = World::new(self.scene);
        let mut lines = vec![world.describe()];
        for step in steps.into_iter().rev().chain(last) {
            world = world.after(step);
            lines.push(format!("  {step:?}\n{}", world.describe()));
        }
        lines.join("\n")
    }
}

fn is_new<T: std::hash::Hash + Eq>(known: &Mutex<HashSet<T>>, one: T) -> bool {
    known.lock().is_ok_and(|mut known| known.insert(one))
}

impl fmt::Display for Found {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            f,
            "{} states ({:?} by deviations), {} transitions; {} states of the arm, {} of an executor",
            self.states.iter().sum::<usize>(),
            self.states,
            self.transitions,
            self.arms,
            self.executors
        )?;
        writeln!(f, "{} breaches of what may never happen", self.breach_count)?;
        self.breaches.iter().try_for_each(|breach| writeln!(f, "\n{breach}"))
    }
}
