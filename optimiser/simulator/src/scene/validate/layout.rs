//! Sizes that follow from the fields, and the places of containers, powder and tool at the start.

use super::checker::{Checked, Checker, container_paths};
use crate::scene::closest_match::did_you_mean;
use crate::scene::error::MAX_NAME_CHARS;
use crate::scene::figures::{about, above, at_most, list, plain};
use crate::scene::solid::{Hull, TOUCH_M, Vec3};
use crate::scene::{
    BLOCK_CELLS, FillShape, MAX_CELLS, MAX_CFL, MAX_PARTICLES, MAX_SUBSTEPS, MAX_VISCOUS_LOSS, PlacedTool,
    Scene, VolumeCorrection, YieldSurface,
};

/// World directions with the name of their coordinate and their sign.
pub(super) const SIDES: [(Vec3, usize); 6] = [
    ([-1.0, 0.0, 0.0], 0),
    ([1.0, 0.0, 0.0], 0),
    ([0.0, -1.0, 0.0], 1),
    ([0.0, 1.0, 0.0], 1),
    ([0.0, 0.0, -1.0], 2),
    ([0.0, 0.0, 1.0], 2),
];

/// Names of the coordinates.
pub(super) const AXIS_NAMES: [&str; 3] = ["x", "y", "z"];

/// Grid cells and particles within what the program is made for.
pub(super) fn check_size(checker: &Checker<'_>, scene: &Scene) -> Checked {
    for axis in 0..3 {
        if scene.powder.fill_min_m[axis] >= scene.powder.fill_max_m[axis] {
            return Err(checker.invalid(
                "powder.fill_max_m",
                list(&scene.powder.fill_max_m),
                format!(
                    "it must exceed powder.fill_min_m = {} in every component",
                    list(&scene.powder.fill_min_m)
                ),
            ));
        }
    }
    check_fill_shape(checker, scene)?;
    let cells = scene.block_counts().iter().map(|blocks| (blocks * BLOCK_CELLS) as f64).product::<f64>();
    too_many(checker, scene, cells, MAX_CELLS as f64, "grid cells, padding included,")?;
    too_many(checker, scene, scene.particle_count() as f64, MAX_PARTICLES as f64, "particles")?;
    if scene.particle_count() == 0 {
        return Err(checker.invalid(
            "powder.fill_max_m",
            list(&scene.powder.fill_max_m),
            "the box from powder.fill_min_m to there is smaller than a particle; a larger box would be right",
        ));
    }
    Ok(())
}

/// A round column is as long as wide.
fn check_fill_shape(checker: &Checker<'_>, scene: &Scene) -> Checked {
    let [length_m, width_m, _] = scene.powder.fill_size_m();
    // The extents are differences of rounded numbers.
    let is_round = (length_m - width_m).abs() <= TOUCH_M;
    if scene.powder.fill_shape == FillShape::Box || is_round {
        return Ok(());
    }
    Err(checker.invalid(
        "powder.fill_shape",
        "\"cylinder\"",
        format!(
            "the box from powder.fill_min_m to powder.fill_max_m is {} m long in x and {} m in y; the same in both would be \
             right",
            about(length_m, 4),
            about(width_m, 4)
        ),
    ))
}

fn too_many(checker: &Checker<'_>, scene: &Scene, count: f64, limit: f64, what: &str) -> Checked {
    if count <= limit {
        return Ok(());
    }
    let cell_m = scene.domain.cell_m;
    // Half as much again as the count alone asks for covers the padding and is quick to try.
    let right_m = cell_m * (1.5 * count / limit).cbrt();
    Err(checker.invalid(
        "domain.cell_m",
        plain(cell_m),
        format!(
            "that makes {} {what} and at most {limit} are allowed; about {} would be right",
            about(count, 3),
            about(right_m, 2)
        ),
    ))
}

/// Substeps of a rollout.
pub(super) fn check_substeps(checker: &Checker<'_>, scene: &Scene) -> Checked {
    let steps = u64::from(scene.time.horizon_steps) + u64::from(scene.time.settle_steps());
    let substeps = steps * u64::from(scene.time.substeps);
    if substeps <= MAX_SUBSTEPS {
        return Ok(());
    }
    Err(checker.invalid(
        "time.substeps",
        scene.time.substeps,
        format!(
            "with {steps} control steps, settling included, that makes {substeps} substeps and at most {MAX_SUBSTEPS} \
             are allowed; at most {} would be right",
            (MAX_SUBSTEPS / steps).max(1)
        ),
    ))
}

/// Courant condition.
pub(super) fn check_cfl(checker: &Checker<'_>, scene: &Scene) -> Checked {
    let cfl = scene.cfl_number();
    if cfl <= MAX_CFL {
        return Ok(());
    }
    let modulus_pa = scene.powder.youngs_modulus_pa;
    let substeps = (f64::from(scene.time.substeps) * cfl / MAX_CFL).ceil();
    Err(checker.invalid(
        "powder.youngs_modulus_pa",
        plain(modulus_pa),
        format!(
            "the CFL number sqrt(P-wave modulus / density) * dt_sub / cell is then {} and must be at most {}; \
             time.substeps of at least {} or powder.youngs_modulus_pa of at most {} would be right",
            above(cfl, MAX_CFL),
            MAX_CFL,
            about(substeps, 12),
            at_most(modulus_pa * (MAX_CFL / cfl).powi(2))
        ),
    ))
}

/// Steepest friction angle of a Drucker-Prager cone, degrees: the sine of 36.87 degrees is 0.6, from which on a stress on it
/// has a tensile principal value in triaxial extension.
const MAX_ROUND_CONE_DEG: f64 = 36.8;

/// The same with two angles: at rest the cone's slope `6 s/(3 - s)`, with the sine `s` of the friction angle, is 1.05 times as
/// large, and 1.5 at most.
const MAX_ROUND_CONE_AT_REST_DEG: f64 = 35.2;

/// What the powder's numbers have to do with each other.
pub(super) fn check_powder_law(checker: &Checker<'_>, scene: &Scene) -> Checked {
    let powder = &scene.powder;
    let loss = scene.viscous_loss();
    if loss > MAX_VISCOUS_LOSS {
        return Err(checker.invalid(
            "powder.viscosity_pa_s",
            plain(powder.viscosity_pa_s),
            format!(
                "8 * viscosity * dt_sub / (density * cell^2) is then {} and must be at most {MAX_VISCOUS_LOSS}; \
                 at most {} would be right",
                above(loss, MAX_VISCOUS_LOSS),
                at_most(powder.viscosity_pa_s * MAX_VISCOUS_LOSS / loss)
            ),
        ));
    }
    let steepest = if powder.flow.is_some() { MAX_ROUND_CONE_AT_REST_DEG } else { MAX_ROUND_CONE_DEG };
    if powder.yield_surface == YieldSurface::DruckerPrager && powder.friction_angle_deg > steepest {
        return Err(checker.invalid(
            "powder.friction_angle_deg",
            plain(powder.friction_angle_deg),
            format!(
                "a Drucker-Prager cone that steep{} carries tension in triaxial extension; at most {} would be right, or \
                 powder.yield = \"matsuoka_nakai\"",
                if powder.flow.is_some() { ", and with powder.flow steeper at rest," } else { "" },
                plain(steepest)
            ),
        ));
    }
    if powder.cohesion_pa > 0.0 && powder.friction_angle_deg < 1.0 {
        return Err(checker.invalid(
            "powder.cohesion_pa",
            plain(powder.cohesion_pa),
            format!(
                "cohesion needs a friction angle of at least 1 and powder.friction_angle_deg is {}",
                plain(powder.friction_angle_deg)
            ),
        ));
    }
    if let Some(strain) =
        powder.loosening_strain.filter(|_| powder.volume_correction != VolumeCorrection::Grid)
    {
        return Err(checker.invalid(
            "powder.loosening_strain",
            plain(strain),
            "with powder.volume_correction = \"strain\" nothing is loosened; powder.volume_correction = \"grid\" would be right, or no \
             such key",
        ));
    }
    let apex_pa = powder.apex_tension_pa();
    match powder.tensile_strength_pa {
        Some(strength_pa) if strength_pa > apex_pa * (1.0 + 1e-9) => Err(checker.invalid(
            "powder.tensile_strength_pa",
            plain(strength_pa),
            format!(
                "with this cohesion and friction angle the apex of the yield surface is at a tension of {}; at most that would \
                 be right",
                about(apex_pa, 4)
            ),
        )),
        _ => Ok(()),
    }
}

/// Containers: how many, their names, inside the domain, clear of each other.
pub(super) fn check_containers(checker: &Checker<'_>, scene: &Scene) -> Checked {
    let containers = &scene.containers;
    if !(2..=16).contains(&containers.len()) {
        return Err(checker.invalid(
            "container",
            format!("a list of {}", containers.len()),
            "a scene has 2 to 16 containers, one of them the source and one the target",
        ));
    }
    for (index, (path, container)) in container_paths(containers).iter().zip(containers).enumerate() {
        let field = |name: &str| format!("{path}.{name}");
        if containers[..index].iter().any(|other| other.name == container.name) {
            return Err(checker.invalid(
                field("name"),
                format!("{:?}", container.name),
                "another container has that name already; every container needs its own",
            ));
        }
        let outer = container.outer();
        inside_domain(
            checker,
            scene,
            &field("position_m"),
            &container.position_m,
            "the container",
            |direction| outer.support(direction),
        )?;
        if let Some(other) = containers[..index].iter().find(|other| !container.is_apart(other)) {
            return Err(checker.invalid(
                field("position_m"),
                list(&container.position_m),
                format!(
                    "there it overlaps container {:?} by {} m; they must stand apart",
                    other.name,
                    about(outer.overlap_m(&other.outer()), 2)
                ),
            ));
        }
    }
    Ok(())
}

/// Refuses what reaches out of the simulated volume.
pub(super) fn inside_domain(
    checker: &Checker<'_>,
    scene: &Scene,
    field: &str,
    value: &[f64],
    what: &str,
    support: impl Fn(Vec3) -> f64,
) -> Checked {
    for (direction, axis) in SIDES {
        let sign = direction[axis];
        let side_m = sign * support(direction);
        let size_m = scene.domain.size_m[axis];
        if !(-TOUCH_M..=size_m + TOUCH_M).contains(&side_m) {
            return Err(checker.invalid(
                field,
                list(value),
                format!(
                    "{what} would then reach {} = {}, outside the domain, which goes from 0 to {}",
                    AXIS_NAMES[axis],
                    about(side_m, 4),
                    plain(size_m)
                ),
            ));
        }
    }
    Ok(())
}

/// Source, target, target point and amount.
pub(super) fn check_objective(checker: &Checker<'_>, scene: &Scene) -> Checked {
    use crate::scene::{Aim, Observation, Quantity};
    let objective = &scene.objective;
    named_container(checker, scene, "objective.source", &objective.source)?;
    named_container(checker, scene, "objective.target", &objective.target)?;
    if objective.source == objective.target {
        return Err(checker.invalid(
            "objective.target",
            format!("{:?}", objective.target),
            "that is objective.source; the target must be another container",
        ));
    }
    let p_target = objective.p_target_m;
    if (0..3).any(|axis| !(0.0..=scene.domain.size_m[axis]).contains(&p_target[axis])) {
        return Err(checker.invalid(
            "objective.p_target_m",
            list(&p_target),
            format!("it must lie in the domain, which goes from [0, 0, 0] to {}", list(&scene.domain.size_m)),
        ));
    }
    if objective.aim == Aim::Amount && scene.source().holds_point(p_target) {
        return Err(checker.invalid(
            "objective.p_target_m",
            list(&p_target),
            "that is inside the source, where too much powder costs nothing; a point in the target container would be right",
        ));
    }
    let count = scene.particle_count();
    let whole_kg = count as f64 * scene.particle_mass_kg();
    let particles = |field: &str, particles: u32| {
        checker.count(field, particles, 1, u32::try_from(count).unwrap_or(u32::MAX))
    };
    match objective.amount.wanted {
        Quantity::Particles(wanted) => particles("objective.amount.particles", wanted)?,
        Quantity::MassKg(wanted_kg) if wanted_kg > whole_kg * (1.0 + 1e-9) => {
            let in_kg = 1e-3 * wanted_kg;
            // Ten times as much as there is was hardly meant.
            let meant = if in_kg <= whole_kg && wanted_kg > 10.0 * whole_kg {
                format!("; did you mean kilograms, that is {}?", about(in_kg, 6))
            } else {
                String::new()
            };
            return Err(checker.invalid(
                "objective.amount.mass_kg",
                plain(wanted_kg),
                format!("the scene holds no more than {} kg of powder{meant}", about(whole_kg, 4)),
            ));
        }
        Quantity::MassKg(_) => {}
    }
    match objective.observation {
        Observation::Subsample { particles: size } => particles("objective.observation.particles", size),
        Observation::VisibleFromAbove { .. } if objective.aim == Aim::Amount => Err(checker.invalid(
            "objective.aim",
            "\"amount\"".to_owned(),
            "a view from above tells no amount; \"all\" would be right, or an observation that is not visible_from_above",
        )),
        Observation::All | Observation::VisibleFromAbove { .. } => Ok(()),
    }
}

fn named_container(checker: &Checker<'_>, scene: &Scene, field: &str, name: &str) -> Checked {
    if scene.containers.iter().any(|container| container.name == name) {
        return Ok(());
    }
    let known: Vec<String> =
        scene.containers.iter().map(|container| format!("{:?}", container.name)).collect();
    let meant = did_you_mean(name, scene.containers.iter().map(|container| container.name.as_str()));
    let shown: String = name.chars().take(MAX_NAME_CHARS).collect();
    Err(checker.invalid(
        field,
        format!("{shown:?}"),
        format!("the containers are {}{meant}", known.join(", ")),
    ))
}

/// Powder inside the domain and in nobody's wall or floor. In which container it starts, or whether in any, is its own affair.
pub(super) fn check_powder(checker: &Checker<'_>, scene: &Scene) -> Checked {
    let powder = &scene.powder;
    let below_zero = powder.fill_min_m.iter().any(|low| *low < -TOUCH_M);
    let (field, value) = if below_zero {
        ("powder.fill_min_m", powder.fill_min_m)
    } else {
        ("powder.fill_max_m", powder.fill_max_m)
    };
    inside_domain(checker, scene, field, &value, "the powder", |direction| powder.fill_support(direction))?;
    let Some((solid, depth_m)) = scene.containers.iter().find_map(|container| container.powder_in(powder))
    else {
        return Ok(());
    };
    let filled = match powder.fill_shape {
        FillShape::Box => "box",
        FillShape::Cylinder => "column",
    };
    Err(checker.invalid(
        "powder.fill_min_m",
        format!("{} and powder.fill_max_m {}", list(&powder.fill_min_m), list(&powder.fill_max_m)),
        format!("that {filled} goes {} m into the {solid}; clear of it would be right", about(depth_m, 2)),
    ))
}

/// Tool at its start pose: inside the domain, clear of powder, containers and shut gates.
pub(super) fn check_start(checker: &Checker<'_>, scene: &Scene) -> Checked {
    let start = scene.tool.start_position_m;
    let tool = PlacedTool::new(scene, start, scene.tool.start_pitch_deg);
    let field = "tool.start_position_m";
    inside_domain(checker, scene, field, &start, "the tool", |direction| tool.body_support(direction))?;
    inside_domain(checker, scene, field, &start, "the tool's handle", |direction| {
        tool.handle_support(direction)
    })?;
    let overlap = |what: String| {
        Err(checker.invalid(
            field,
            list(&start),
            format!("there the tool overlaps {what}; it must start clear"),
        ))
    };
    let clears = |solid: &Hull| tool.body_clears(solid) && tool.handle_clears(solid);
    if !clears(&scene.powder.fill_hull()) {
        return overlap("the powder".to_owned());
    }
    for one in &scene.containers {
        if let Some(wall) = one.walls().iter().find(|wall| !wall.is_clear(clears)) {
            return overlap(format!("the {}", wall.name));
        }
        if one.pieces().iter().any(|piece| !clears(piece)) {
            return overlap(format!("the {} of container {:?}", one.below(), one.name));
        }
    }
    for gate in &scene.gates {
        if !gate.pieces().iter().all(clears) {
            return overlap(format!("gate {:?}, which is shut then", gate.name));
        }
    }
    Ok(())
}
