//! How true the powder is: a table that says line by line what is measured, what it should be, who says so,
//! how near is near enough and why, and where the powder falls short.
//!
//! # How to read it
//!
//! `optimise validate` measures the powder's law and the numerics of a scene: of `[powder]` everything but
//! where it lies, its friction angle, stiffness and cohesion, of `[domain]` the contact's band and the speed
//! of sleepers. Geometry, cell, floor, friction angle and stiffness belong to each line, the powder is dry,
//! and the references are those of dry sand. So the same table can be made of any scene, and what a change of
//! the law is worth shows in it.
//!
//! References and tolerances were written down before anything was measured, but for the spoons (what they hold on cells of 4 and 2 mm was
//! known, that the finest bowl's is too much, and that after 3 s there is less on the coarsest), and for walls and rest, of which tests had
//! figures. A line that is repeated with
//! several seeds shows the median and is judged by its worst seed. The numbers depend on nothing but the
//! scene: not on the machine, nor on the threads.
//!
//! Most tolerances are those of experiments, so that a line that falls short is powder that a person could
//! tell from sand by looking. What falls short is no failure of the command; what held in the table that came
//! with the program ([`Record::committed`]) and does not hold now is. Of another scene than the default one
//! nobody knows what held before.
//!
//! The controls are lines in which something is broken on purpose. They have to fail: a control that holds
//! says that the line which it is made of would hold whatever the powder does, and counts as much as a line
//! that no longer holds.
//!
//! # How it is measured
//!
//! | Lines | Where | How |
//! |---|---|---|
//! | one particle | `element.rs` | the return map alone, strained in small steps, sides at constant pressure |
//! | collapse, energy | `column.rs` | a cylinder, free of stress and without a tube, that begins to fall at once; looked at after 0.8 s |
//! | heaps | `heap.rs` | a stream from just above the top that the heap should have, on a plate of friction 1 |
//! | packing | `packing.rs` | a stream into a box; the heap that a skill leaves in the target of the default scene; particles counted in balls that have powder on all sides |
//! | silos | `silo.rs` | a cylinder full of powder with a hole in its floor, or at the end of a cone; what flows through from 3 to 7 times `sqrt(D/g)` on; or a box with a slot in its floor, from 2 to 4 times `sqrt(B/g)` on |
//! | silo filled slowly | `janssen.rs` | a stream into a cylinder; mean of the vertical stress in layers one cell thick |
//! | walls | `walls.rs` | a bed that gravity presses on a thin wall, and a layer behind it with and without that bed; a layer that falls off a wall |
//! | rest | `rest.rs` | beds and a collapsed column for 10.6 s |
//! | spoons | `spoon.rs` | a pipe full of powder, drawn up above the spoon until it runs over; looked at when it has, and 3 s later, as a heap that is awake flattens |
//! | weight, incline | `statics.rs` | a bed between walls without friction, mean over half a second, as it swings; a block under tilted gravity, its middle third |
//! | independence | `independence.rs` | one of the columns, with another time step, stiffness, number format |
//! | controls | `controls.rs` | lines of the others, broken |
//!
//! Run-out is measured twice: by the radius that holds 99 % of the powder, and by the outermost radius at
//! which the deposit is one particle spacing thick. On six cells per radius the second one is the coarser.
//! The height is that of the surface within 0.6 radii, continued to the axis by a straight line, as the tip
//! itself is thinner than a cell. Powder that lies too loosely makes heaps higher and run-outs longer than
//! its mass would: the packing is a line of its own.
//!
//! # What it shows
//!
#![doc = include_str!("../../validation/full.md")]

mod case;
mod column;
mod controls;
mod element;
mod heap;
mod independence;
mod janssen;
mod measures;
mod packing;
mod pour;
mod record;
mod rest;
mod rig;
mod silo;
mod spoon;
mod statics;
mod table;
mod walls;

use serde::{Deserialize, Serialize};

use crate::rollout::{RolloutError, Tick};
use crate::scene::Scene;

pub use record::Record;
pub use table::{Line, Table, Verdict, figure, quantity};

/// Which lines are measured.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Scope {
    /// Those that take little: one seed, six cells per radius.
    Short,
    /// All of them, stochastic ones with three seeds.
    Full,
}

impl Scope {
    /// As a flag of the command, without its dashes.
    pub fn name(self) -> &'static str {
        match self {
            Self::Short => "short",
            Self::Full => "full",
        }
    }

    fn seeds(self) -> u64 {
        if self == Self::Full { 3 } else { 1 }
    }
}

/// Measures the powder of a scene: the lines that have `only` in their name or that of their group, all lines if it is empty. `progress`
/// is told work done and in total, from any of the threads; where it breaks off, lines that are not done are missing in the table.
///
/// # Errors
/// [`RolloutError::Threads`]
pub fn run(
    scene: &Scene,
    scope: Scope,
    only: &str,
    threads: usize,
    progress: Tick<'_>,
) -> Result<Table, RolloutError> {
    let is_asked_for = |claim: &case::Claim| table::has(only, [claim.group, &claim.name]);
    let mut cases = cases(scene, scope);
    cases.retain(|case| case.claims.iter().any(is_asked_for));
    let wanted = cases.iter().flat_map(|case| &case.claims).filter(|claim| is_asked_for(claim)).count();
    let found = case::run(&cases, threads, progress)?;
    let measured: Vec<_> = cases.into_iter().map(|case| case.claims).zip(found).collect();
    // Some are measured together with others.
    Ok(Table { wanted, ..Table::new(&scene.name, scope, &measured).only(only) })
}

/// Everything that is claimed and how it is measured.
fn cases(scene: &Scene, scope: Scope) -> Vec<case::Case<'_>> {
    [
        element::cases(scene),
        column::cases(scene, scope),
        heap::cases(scene, scope),
        statics::cases(scene),
        packing::cases(scene, scope),
        silo::cases(scene, scope),
        janssen::cases(scene, scope),
        walls::cases(scene, scope),
        rest::cases(scene, scope),
        spoon::cases(scene, scope),
        independence::cases(scene, scope),
        controls::cases(scene),
    ]
    .into_iter()
    .flatten()
    .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{DEFAULT_SCENE, EMBEDDED_SCENES};

    #[test]
    fn every_line_can_be_read_and_can_fail() {
        let scene = Scene::load(DEFAULT_SCENE).unwrap();
        for scope in [Scope::Short, Scope::Full] {
            for claim in cases(&scene, scope).iter().flat_map(|case| &case.claims) {
                let [low, high] = claim.tolerance;
                assert!(low < high && (low..=high).contains(&claim.reference), "{}", claim.name);
                assert!(claim.name.len() <= 60, "{} is too long for its column", claim.name);
                assert!(!claim.source.is_empty() && !claim.why.is_empty(), "{}", claim.name);
                assert!(claim.wrong.iter().all(|words| words.is_empty() || words.contains("{}")));
            }
        }
    }

    #[test]
    fn any_scenes_powder_can_be_measured() {
        for (name, _) in EMBEDDED_SCENES {
            let scene = Scene::load(name).unwrap();
            assert!(cases(&scene, Scope::Full).iter().all(|case| case.work.is_finite() && case.work >= 0.0));
        }
    }
}
