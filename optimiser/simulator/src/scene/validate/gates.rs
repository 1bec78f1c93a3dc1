//! Gates: how many, their names, where they are while they are shut, how fast they open.

use super::checker::{Checked, Checker, gate_paths};
use super::layout::inside_domain;
use crate::scene::figures::{about, at_most, list};
use crate::scene::{FillShape, Gate, GateOpening, MAX_GATES, Scene};

/// How far a gate may move in a substep, in cells: further, and it would jump over powder.
const MOST_CELLS: f64 = 0.5;

/// All gates. Where one goes when it opens is its own affair, and shut ones may overlap each other and containers.
pub(super) fn check(checker: &Checker<'_>, scene: &Scene) -> Checked {
    let gates = &scene.gates;
    if gates.len() > MAX_GATES {
        return Err(checker.invalid(
            "gate",
            format!("a list of {}", gates.len()),
            format!("a scene has at most {MAX_GATES} gates"),
        ));
    }
    for (index, (path, gate)) in gate_paths(gates).iter().zip(gates).enumerate() {
        if gates[..index].iter().any(|other| other.name == gate.name) {
            return Err(checker.invalid(
                format!("{path}.name"),
                format!("{:?}", gate.name),
                "another gate has that name already; every gate needs its own",
            ));
        }
        check_place(checker, scene, &format!("{path}.position_m"), gate)?;
        check_speed(checker, scene, &format!("{path}.opening.velocity_m_s"), gate)?;
    }
    Ok(())
}

fn check_place(checker: &Checker<'_>, scene: &Scene, field: &str, gate: &Gate) -> Checked {
    let (outer, powder) = (gate.outer(), &scene.powder);
    inside_domain(checker, scene, field, &gate.position_m, "the shut gate", |direction| {
        outer.support(direction)
    })?;
    if gate.clear_of_powder(powder) {
        return Ok(());
    }
    let filled = match powder.fill_shape {
        FillShape::Box => "box",
        FillShape::Cylinder => "column",
    };
    Err(checker.invalid(
        field,
        list(&gate.position_m),
        format!(
            "there, shut, it overlaps the powder, a {filled} from {} to {}; beside or around it would be right",
            list(&powder.fill_min_m),
            list(&powder.fill_max_m)
        ),
    ))
}

fn check_speed(checker: &Checker<'_>, scene: &Scene, field: &str, gate: &Gate) -> Checked {
    let GateOpening::Slide { velocity_m_s, .. } = gate.opening else { return Ok(()) };
    let speed_m_s = gate.opening.speed_m_s();
    if speed_m_s < f64::MIN_POSITIVE {
        return Err(checker.invalid(
            field,
            list(&velocity_m_s),
            "a gate that slides has to move; a velocity, or a gate that vanishes would be right",
        ));
    }
    let cells = speed_m_s * scene.time.substep_s() / scene.domain.cell_m;
    if cells <= MOST_CELLS {
        return Ok(());
    }
    Err(checker.invalid(
        field,
        list(&velocity_m_s),
        format!(
            "that takes it {} cells in a substep, and more than {MOST_CELLS} would take it over powder; at most {} m/s \
             would be right",
            about(cells, 3),
            at_most(speed_m_s * MOST_CELLS / cells)
        ),
    ))
}
