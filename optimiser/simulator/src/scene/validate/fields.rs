//! The range of every single field, as documented at the field.

use super::checker::{Checked, Checker, Range, container_paths, gate_paths};
use crate::scene::figures::plain;
use crate::scene::{
    Arm, Container, ContainerShape, Cuboid, Domain, Flow, Gate, GateOpening, GateShape, Limits, MAX_CUBOIDS,
    Objective, Observation, Optimiser, Powder, Quantity, Scene, Skill, Time, Tool, ToolShape, Transfer,
};
use powderline_shared::plan::{PERIOD_US_MAX, PERIOD_US_MIN};

const FRICTION: Range = Range::closed(0.0, 2.0);
const WORLD_M: Range = Range::closed(-10.0, 10.0);
const TURN_DEG: Range = Range::closed(-360.0, 360.0);

/// Checks every field on its own.
pub(super) fn check(checker: &Checker<'_>, scene: &Scene) -> Checked {
    checker.name("name", &scene.name)?;
    domain(checker, &scene.domain)?;
    powder(checker, &scene.powder)?;
    time(checker, &scene.time)?;
    for (path, one) in container_paths(&scene.containers).iter().zip(&scene.containers) {
        container(checker, path, one, scene.domain.cell_m)?;
    }
    for (path, one) in gate_paths(&scene.gates).iter().zip(&scene.gates) {
        gate(checker, path, one, scene.domain.cell_m)?;
    }
    tool(checker, &scene.tool, scene.domain.cell_m)?;
    skill(checker, &scene.skill)?;
    limits(checker, &scene.limits)?;
    scene.arm.as_ref().map_or(Ok(()), |one| arm(checker, one))?;
    objective(checker, &scene.objective)?;
    optimiser(checker, &scene.optimiser)
}

fn domain(checker: &Checker<'_>, domain: &Domain) -> Checked {
    checker.vector("domain.size_m", &domain.size_m, Range::closed(0.01, 10.0))?;
    checker.number("domain.cell_m", domain.cell_m, Range::closed(1e-4, 0.1))?;
    checker.vector("domain.gravity_m_s2", &domain.gravity_m_s2, Range::closed(-100.0, 100.0))?;
    checker.number("domain.friction", domain.friction, FRICTION)?;
    checker.number("domain.contact_band_cells", domain.contact_band_cells, Range::closed(0.01, 2.0))?;
    checker.number("domain.sleep_speed_m_s", domain.sleep_speed_m_s, Range::closed(0.0, 0.01))
}

fn powder(checker: &Checker<'_>, powder: &Powder) -> Checked {
    checker.vector("powder.fill_min_m", &powder.fill_min_m, WORLD_M)?;
    checker.vector("powder.fill_max_m", &powder.fill_max_m, WORLD_M)?;
    checker.count("powder.particles_per_cell", powder.particles_per_cell, 1, 64)?;
    checker.number("powder.youngs_modulus_pa", powder.youngs_modulus_pa, Range::closed(100.0, 1e9))?;
    checker.number("powder.poissons_ratio", powder.poissons_ratio, Range::closed(0.0, 0.49))?;
    checker.number("powder.density_kg_m3", powder.density_kg_m3, Range::closed(10.0, 25_000.0))?;
    checker.number("powder.friction_angle_deg", powder.friction_angle_deg, Range::closed(0.0, 60.0))?;
    if let Some(Flow { grain_diameter_m, grain_density_kg_m3 }) = powder.flow {
        checker.number("powder.flow.grain_diameter_m", grain_diameter_m, Range::closed(1e-6, 0.01))?;
        checker.number(
            "powder.flow.grain_density_kg_m3",
            grain_density_kg_m3,
            Range::closed(10.0, 25_000.0),
        )?;
    }
    if let Some(Transfer { residue_time_s }) = powder.transfer {
        checker.number("powder.transfer.residue_time_s", residue_time_s, Range::closed(1e-4, 10.0))?;
    }
    checker.number("powder.cohesion_pa", powder.cohesion_pa, Range::closed(0.0, 1e5))?;
    if let Some(strength_pa) = powder.tensile_strength_pa {
        checker.number("powder.tensile_strength_pa", strength_pa, Range::closed(0.0, 1e7))?;
    }
    checker.number("powder.viscosity_pa_s", powder.viscosity_pa_s, Range::closed(0.0, 100.0))
}

fn arm(checker: &Checker<'_>, arm: &Arm) -> Checked {
    checker.vector("arm.base_position_m", &arm.base_position_m, WORLD_M)?;
    checker.vector("arm.base_rotation_deg", &arm.base_rotation_deg, TURN_DEG)?;
    checker.vector("arm.tool_position_m", &arm.tool_position_m, Range::closed(-1.0, 1.0))?;
    checker.vector("arm.tool_rotation_deg", &arm.tool_rotation_deg, TURN_DEG)?;
    checker.number("arm.table_height_m", arm.table_height_m, Range::closed(-10.0, 0.0))?;
    checker.number("arm.clearance_m", arm.clearance_m, Range::closed(0.0, 1.0))?;
    let carries_kg = arm.kind.figures().payload_kg;
    let payload_kg = arm.payload_kg.unwrap_or(0.0);
    checker.number("arm.payload_kg", payload_kg, Range::closed(0.0, carries_kg))
}

fn time(checker: &Checker<'_>, time: &Time) -> Checked {
    checker.count("time.control_period_us", time.control_period_us, PERIOD_US_MIN, PERIOD_US_MAX)?;
    checker.count("time.substeps", time.substeps, 1, 10_000)?;
    checker.count("time.horizon_steps", time.horizon_steps, 1, 100_000)?;
    checker.number("time.settle_s", time.settle_s, Range::closed(0.0, 60.0))
}

fn container(checker: &Checker<'_>, path: &str, container: &Container, cell_m: f64) -> Checked {
    let field = |name: &str| format!("{path}.{name}");
    let inner = Range::closed(cell_m, 10.0);
    checker.name(&field("name"), &container.name)?;
    checker.vector(&field("position_m"), &container.position_m, WORLD_M)?;
    checker.number(&field("yaw_deg"), container.yaw_deg, TURN_DEG)?;
    wall(checker, &field("wall_thickness_m"), container.wall_thickness_m, cell_m)?;
    checker.number(&field("friction"), container.friction, FRICTION)?;
    match &container.shape {
        ContainerShape::Box { inner_size_m } => {
            checker.vector(&field("shape.inner_size_m"), inner_size_m, inner)
        }
        ContainerShape::Cylinder { inner_radius_m, inner_height_m } => {
            checker.number(&field("shape.inner_radius_m"), *inner_radius_m, inner)?;
            checker.number(&field("shape.inner_height_m"), *inner_height_m, inner)
        }
    }
}

fn gate(checker: &Checker<'_>, path: &str, gate: &Gate, cell_m: f64) -> Checked {
    let field = |name: &str| format!("{path}.{name}");
    checker.name(&field("name"), &gate.name)?;
    checker.vector(&field("position_m"), &gate.position_m, WORLD_M)?;
    checker.number(&field("yaw_deg"), gate.yaw_deg, TURN_DEG)?;
    checker.number(&field("friction"), gate.friction, FRICTION)?;
    checker.number(&field("opens_at_s"), gate.opens_at_s, Range::closed(0.0, 1e4))?;
    match &gate.shape {
        GateShape::Box { size_m } => {
            checker.vector(&field("shape.size_m"), size_m, Range::above(0.0, 10.0))?;
            wall(checker, &field("shape.size_m"), gate.shape.least_thickness_m(), cell_m)?;
        }
        GateShape::Tube { inner_radius_m, height_m, wall_thickness_m } => {
            let inner = Range::closed(cell_m, 10.0);
            checker.number(&field("shape.inner_radius_m"), *inner_radius_m, inner)?;
            checker.number(&field("shape.height_m"), *height_m, inner)?;
            wall(checker, &field("shape.wall_thickness_m"), *wall_thickness_m, cell_m)?;
        }
    }
    match &gate.opening {
        GateOpening::Vanish {} => Ok(()),
        GateOpening::Slide { velocity_m_s, travel_m } => {
            checker.vector(&field("opening.velocity_m_s"), velocity_m_s, Range::closed(-10.0, 10.0))?;
            checker.number(&field("opening.travel_m"), *travel_m, Range::above(0.0, 10.0))
        }
    }
}

/// Walls much thinner than a cell would let powder through.
fn wall(checker: &Checker<'_>, field: &str, thickness_m: f64, cell_m: f64) -> Checked {
    checker.number(field, thickness_m, Range::above(0.0, 1.0))?;
    let least_m = 0.5 * cell_m;
    if thickness_m >= least_m * (1.0 - 1e-9) {
        return Ok(());
    }
    Err(checker.invalid(
        field,
        plain(thickness_m),
        format!("it must be at least half a cell, {} for domain.cell_m = {}", plain(least_m), plain(cell_m)),
    ))
}

fn tool(checker: &Checker<'_>, tool: &Tool, cell_m: f64) -> Checked {
    let inner = Range::closed(cell_m, 1.0);
    match &tool.shape {
        ToolShape::Bowl { inner_radius_m } => {
            checker.number("tool.shape.inner_radius_m", *inner_radius_m, inner)?;
        }
        ToolShape::BoxScoop { inner_size_m } => {
            checker.vector("tool.shape.inner_size_m", inner_size_m, inner)?;
        }
        ToolShape::Cuboids { cuboid } => cuboids(checker, cuboid, cell_m)?,
    }
    wall(checker, "tool.wall_thickness_m", tool.wall_thickness_m, cell_m)?;
    checker.number("tool.friction", tool.friction, FRICTION)?;
    checker.vector("tool.start_position_m", &tool.start_position_m, WORLD_M)?;
    checker.number("tool.start_pitch_deg", tool.start_pitch_deg, Range::closed(-90.0, 90.0))?;
    checker.number("tool.handle.length_m", tool.handle.length_m, Range::closed(0.001, 1.0))?;
    checker.number("tool.handle.radius_m", tool.handle.radius_m, Range::closed(0.25 * cell_m, 0.1))?;
    checker.number("tool.handle.rise_deg", tool.handle.rise_deg, Range::closed(-90.0, 90.0))
}

fn cuboids(checker: &Checker<'_>, cuboids: &[Cuboid], cell_m: f64) -> Checked {
    if cuboids.is_empty() || cuboids.len() > MAX_CUBOIDS {
        let right = format!("1 to {MAX_CUBOIDS} cuboids would be right");
        return Err(checker.invalid("tool.shape.cuboid", format!("{} cuboids", cuboids.len()), right));
    }
    for (index, cuboid) in cuboids.iter().enumerate() {
        let field = |name: &str| format!("tool.shape.cuboid[{index}].{name}");
        checker.vector(&field("centre_m"), &cuboid.centre_m, Range::closed(-1.0, 1.0))?;
        let least = cuboid.size_m.iter().copied().fold(f64::INFINITY, f64::min);
        checker.vector(&field("size_m"), &cuboid.size_m, Range::above(0.0, 1.0))?;
        wall(checker, &field("size_m"), least, cell_m)?;
        checker.vector(&field("rotation_deg"), &cuboid.rotation_deg, TURN_DEG)?;
    }
    Ok(())
}

fn skill(checker: &Checker<'_>, skill: &Skill) -> Checked {
    let angle = Range::closed(1.0, 180.0);
    let travel = Range::closed(0.001, 5.0);
    checker.bounds("skill.scooping_depth_m", skill.scooping_depth_m, Range::closed(1e-4, 1.0))?;
    checker.bounds("skill.scooping_angle_deg", skill.scooping_angle_deg, angle)?;
    checker.bounds("skill.lift_height_m", skill.lift_height_m, travel)?;
    checker.bounds("skill.transport_displacement_m", skill.transport_displacement_m, travel)?;
    checker.bounds("skill.pouring_angle_deg", skill.pouring_angle_deg, angle)?;
    for (index, bounds) in skill.initial_theta.iter().enumerate() {
        checker.bounds(&format!("skill.initial_theta[{index}]"), *bounds, Range::closed(-1.0, 1.0))?;
    }
    checker.number("skill.heading_deg", skill.heading_deg, TURN_DEG)?;
    checker.number("skill.approach_m", skill.approach_m, Range::closed(1e-4, 1.0))?;
    checker.number("skill.sweep_m", skill.sweep_m, Range::closed(0.0, 1.0))?;
    checker.number("skill.linear_speed_m_s", skill.linear_speed_m_s, Range::closed(0.001, 5.0))?;
    checker.number("skill.angular_speed_rad_s", skill.angular_speed_rad_s, Range::closed(0.01, 50.0))
}

fn limits(checker: &Checker<'_>, limits: &Limits) -> Checked {
    checker.vector("limits.workspace_min_m", &limits.workspace_min_m, WORLD_M)?;
    checker.vector("limits.workspace_max_m", &limits.workspace_max_m, WORLD_M)?;
    for (name, value, high) in [
        ("linear_velocity_m_s", limits.linear_velocity_m_s, 100.0),
        ("linear_acceleration_m_s2", limits.linear_acceleration_m_s2, 1e4),
        ("linear_jerk_m_s3", limits.linear_jerk_m_s3, 1e7),
        ("angular_velocity_rad_s", limits.angular_velocity_rad_s, 1e3),
        ("angular_acceleration_rad_s2", limits.angular_acceleration_rad_s2, 1e5),
        ("angular_jerk_rad_s3", limits.angular_jerk_rad_s3, 1e8),
    ] {
        checker.number(&format!("limits.{name}"), value, Range::closed(0.001, high))?;
    }
    Ok(())
}

fn objective(checker: &Checker<'_>, objective: &Objective) -> Checked {
    checker.vector("objective.p_target_m", &objective.p_target_m, WORLD_M)?;
    if let Quantity::MassKg(mass_kg) = objective.amount.wanted {
        checker.number("objective.amount.mass_kg", mass_kg, Range::above(0.0, 1e6))?;
    }
    checker.number("objective.amount.tolerance", objective.amount.tolerance, Range::closed(0.0, 1.0))?;
    checker.number("objective.lost_weight", objective.lost_weight, Range::closed(0.0, 100.0))?;
    if let Observation::VisibleFromAbove { pixel_m } = objective.observation {
        checker.number("objective.observation.pixel_m", pixel_m, Range::closed(1e-4, 0.1))?;
    }
    Ok(())
}

fn optimiser(checker: &Checker<'_>, optimiser: &Optimiser) -> Checked {
    checker.count("optimiser.epochs", optimiser.epochs, 1, 100_000)?;
    checker.count("optimiser.curriculum_epochs", optimiser.curriculum_epochs, 0, 100_000)?;
    checker.count("optimiser.patience_epochs", optimiser.patience_epochs, 0, 100_000)?;
    checker.number("optimiser.learning_rate", optimiser.learning_rate, Range::above(0.0, 10.0))?;
    checker.number("optimiser.beta", optimiser.beta, Range::below(0.0, 1.0))?;
    checker.number("optimiser.epsilon", optimiser.epsilon, Range::above(0.0, 1.0))?;
    checker.number("optimiser.difference_half_step", optimiser.difference_half_step, Range::above(0.0, 0.5))
}
