//! The range of every single field, as documented at the field.

use super::checker::{Checker, Range, TURN_DEG, container_paths, gate_paths};
use super::found::Found;
use crate::scene::{
    Arm, Container, ContainerShape, Domain, Flow, Gate, GateOpening, GateShape, Limits, MAX_KNOTS, Objective,
    Observation, Powder, Quantity, SceneError, SceneSpec, Skill, Time, Tool, Transfer,
};
use crate::skill::Freedom;
use powderline_shared::plan::{PERIOD_US_MAX, PERIOD_US_MIN};

const CELL_M: Range = Range::closed(1e-4, 0.1);
const FRICTION: Range = Range::closed(0.0, 2.0);
const WORLD_M: Range = Range::closed(-10.0, 10.0);

/// Checks every field on its own, and gives all that is wrong.
pub(super) fn check(checker: &Checker<'_>, scene: &SceneSpec) -> Vec<SceneError> {
    let found = &mut Found { checker, errors: Vec::new() };
    found.name("name", &scene.name);
    domain(found, &scene.domain);
    // What is wrong with the cell is not said again of all that is measured by it.
    let cell_m = if CELL_M.contains(scene.domain.cell_m) { scene.domain.cell_m } else { 0.0 };
    powder(found, &scene.powder);
    time(found, &scene.time);
    for (path, one) in container_paths(&scene.containers).iter().zip(&scene.containers) {
        container(found, path, one, cell_m);
    }
    for (path, one) in gate_paths(&scene.gates).iter().zip(&scene.gates) {
        gate(found, path, one, cell_m);
    }
    tool(found, &scene.tool, cell_m);
    skill(found, &scene.skill);
    limits(found, &scene.limits);
    if let Some(one) = &scene.arm {
        arm(found, one);
    }
    objective(found, &scene.objective);
    std::mem::take(&mut found.errors)
}

fn domain(found: &mut Found<'_>, domain: &Domain) {
    found.vector("domain.size_m", &domain.size_m, Range::closed(0.01, 10.0));
    found.number("domain.cell_m", domain.cell_m, CELL_M);
    found.vector("domain.gravity_m_s2", &domain.gravity_m_s2, Range::closed(-100.0, 100.0));
    found.number("domain.friction", domain.friction, FRICTION);
    found.number("domain.contact_band_cells", domain.contact_band_cells, Range::closed(0.01, 2.0));
    found.number("domain.sleep_speed_m_s", domain.sleep_speed_m_s, Range::closed(0.0, 0.01));
}

fn powder(found: &mut Found<'_>, powder: &Powder) {
    found.vector("powder.fill_min_m", &powder.fill_min_m, WORLD_M);
    found.vector("powder.fill_max_m", &powder.fill_max_m, WORLD_M);
    found.count("powder.particles_per_cell", powder.particles_per_cell, 1, 64);
    found.number("powder.youngs_modulus_pa", powder.youngs_modulus_pa, Range::closed(100.0, 1e9));
    found.number("powder.poissons_ratio", powder.poissons_ratio, Range::closed(0.0, 0.49));
    found.number("powder.density_kg_m3", powder.density_kg_m3, Range::closed(10.0, 25_000.0));
    found.number("powder.friction_angle_deg", powder.friction_angle_deg, Range::closed(0.0, 60.0));
    if let Some(Flow { grain_diameter_m, grain_density_kg_m3 }) = powder.flow {
        found.number("powder.flow.grain_diameter_m", grain_diameter_m, Range::closed(1e-6, 0.01));
        found.number("powder.flow.grain_density_kg_m3", grain_density_kg_m3, Range::closed(10.0, 25_000.0));
    }
    if let Some(strain) = powder.loosening_strain {
        found.number("powder.loosening_strain", strain, Range::closed(0.001, 100.0));
    }
    if let Some(Transfer { residue_time_s }) = powder.transfer {
        found.number("powder.transfer.residue_time_s", residue_time_s, Range::closed(1e-4, 10.0));
    }
    found.number("powder.cohesion_pa", powder.cohesion_pa, Range::closed(0.0, 1e5));
    if let Some(strength_pa) = powder.tensile_strength_pa {
        found.number("powder.tensile_strength_pa", strength_pa, Range::closed(0.0, 1e7));
    }
    found.number("powder.viscosity_pa_s", powder.viscosity_pa_s, Range::closed(0.0, 100.0));
}

fn arm(found: &mut Found<'_>, arm: &Arm) {
    found.vector("arm.base_position_m", &arm.base_position_m, WORLD_M);
    found.vector("arm.base_rotation_deg", &arm.base_rotation_deg, TURN_DEG);
    found.vector("arm.tool_position_m", &arm.tool_position_m, Range::closed(-1.0, 1.0));
    found.vector("arm.tool_rotation_deg", &arm.tool_rotation_deg, TURN_DEG);
    found.number("arm.table_height_m", arm.table_height_m, Range::closed(-10.0, 0.0));
    found.number("arm.clearance_m", arm.clearance_m, Range::closed(0.0, 1.0));
    let carries_kg = arm.kind.figures().payload_kg;
    let payload_kg = arm.payload_kg.unwrap_or(0.0);
    found.number("arm.payload_kg", payload_kg, Range::closed(0.0, carries_kg));
}

fn time(found: &mut Found<'_>, time: &Time) {
    found.count("time.control_period_us", time.control_period_us, PERIOD_US_MIN, PERIOD_US_MAX);
    found.count("time.substeps", time.substeps, 1, 10_000);
    found.count("time.horizon_steps", time.horizon_steps, 1, 100_000);
    found.number("time.settle_s", time.settle_s, Range::closed(0.0, 60.0));
}

fn container(found: &mut Found<'_>, path: &str, container: &Container, cell_m: f64) {
    let field = |name: &str| format!("{path}.{name}");
    let inner = Range::closed(cell_m, 10.0);
    found.name(&field("name"), &container.name);
    found.vector(&field("position_m"), &container.position_m, WORLD_M);
    found.number(&field("yaw_deg"), container.yaw_deg, TURN_DEG);
    found.wall(&field("wall_thickness_m"), container.wall_thickness_m, cell_m);
    found.number(&field("friction"), container.friction, FRICTION);
    match &container.shape {
        ContainerShape::Box { inner_size_m } => {
            found.vector(&field("shape.inner_size_m"), inner_size_m, inner);
        }
        ContainerShape::SlottedBox { inner_size_m, slot_width_m } => {
            found.vector(&field("shape.inner_size_m"), inner_size_m, inner);
            let slot = Range::closed(cell_m, inner_size_m[0]);
            found.number(&field("shape.slot_width_m"), *slot_width_m, slot);
        }
        ContainerShape::Cylinder { inner_radius_m, inner_height_m } => {
            found.number(&field("shape.inner_radius_m"), *inner_radius_m, inner);
            found.number(&field("shape.inner_height_m"), *inner_height_m, inner);
        }
        ContainerShape::Silo { inner_radius_m, inner_height_m, outlet_radius_m } => {
            found.number(&field("shape.inner_radius_m"), *inner_radius_m, inner);
            found.number(&field("shape.inner_height_m"), *inner_height_m, inner);
            let outlet = Range::closed(cell_m, *inner_radius_m);
            found.number(&field("shape.outlet_radius_m"), *outlet_radius_m, outlet);
        }
        ContainerShape::Hopper { inner_radius_m, inner_height_m, outlet_radius_m, half_angle_deg } => {
            let (wide, leaning) = (Range::closed(2.0 * cell_m, 10.0), Range::closed(5.0, 85.0));
            found.number(&field("shape.inner_radius_m"), *inner_radius_m, wide);
            found.number(&field("shape.half_angle_deg"), *half_angle_deg, leaning);
            // What the others have to fit is asked of what is right by itself.
            let is_wide = (2.0 * cell_m..=10.0).contains(inner_radius_m);
            let outlet = if is_wide { Range::closed(cell_m, inner_radius_m - cell_m) } else { inner };
            found.number(&field("shape.outlet_radius_m"), *outlet_radius_m, outlet);
            let has_cone = is_wide
                && (cell_m..=inner_radius_m - cell_m).contains(outlet_radius_m)
                && (5.0..=85.0).contains(half_angle_deg);
            // To four digits, so that a funnel's may be written as it is asked for.
            let cone_m = if has_cone { container.shape.cone_height_m() } else { cell_m };
            let least: f64 = format!("{cone_m:.3e}").parse().unwrap_or(cone_m);
            let inner = Range::closed(least.max(cell_m), 10.0);
            found.number(&field("shape.inner_height_m"), *inner_height_m, inner);
        }
    }
}

fn gate(found: &mut Found<'_>, path: &str, gate: &Gate, cell_m: f64) {
    let field = |name: &str| format!("{path}.{name}");
    found.name(&field("name"), &gate.name);
    found.vector(&field("position_m"), &gate.position_m, WORLD_M);
    found.number(&field("yaw_deg"), gate.yaw_deg, TURN_DEG);
    found.number(&field("friction"), gate.friction, FRICTION);
    found.number(&field("opens_at_s"), gate.opens_at_s, Range::closed(0.0, 1e4));
    match &gate.shape {
        GateShape::Box { size_m } => {
            if found.vector(&field("shape.size_m"), size_m, Range::above(0.0, 10.0)) {
                found.thick(&field("shape.size_m"), gate.shape.least_thickness_m(), cell_m);
            }
        }
        GateShape::Tube { inner_radius_m, height_m, wall_thickness_m } => {
            let inner = Range::closed(cell_m, 10.0);
            found.number(&field("shape.inner_radius_m"), *inner_radius_m, inner);
            found.number(&field("shape.height_m"), *height_m, inner);
            found.wall(&field("shape.wall_thickness_m"), *wall_thickness_m, cell_m);
        }
    }
    match &gate.opening {
        GateOpening::Vanish {} => {}
        GateOpening::Slide { velocity_m_s, travel_m } => {
            found.vector(&field("opening.velocity_m_s"), velocity_m_s, Range::closed(-10.0, 10.0));
            found.number(&field("opening.travel_m"), *travel_m, Range::above(0.0, 10.0));
        }
    }
}

fn tool(found: &mut Found<'_>, tool: &Tool, cell_m: f64) {
    tool.with_body(|body| body.check(found, cell_m));
    found.wall("tool.wall_thickness_m", tool.wall_thickness_m, cell_m);
    found.number("tool.friction", tool.friction, FRICTION);
    found.vector("tool.start_position_m", &tool.start_position_m, WORLD_M);
    found.number("tool.start_pitch_deg", tool.start_pitch_deg, Range::closed(-90.0, 90.0));
    found.number("tool.handle.length_m", tool.handle.length_m, Range::closed(0.001, 1.0));
    found.number("tool.handle.radius_m", tool.handle.radius_m, Range::closed(0.25 * cell_m, 0.1));
    found.number("tool.handle.rise_deg", tool.handle.rise_deg, Range::closed(-90.0, 90.0));
}

fn skill(found: &mut Found<'_>, skill: &Skill) {
    let angle = Range::closed(1.0, 180.0);
    let travel = Range::closed(0.001, 5.0);
    found.bounds("skill.scooping_depth_m", skill.scooping_depth_m, Range::closed(1e-4, 1.0));
    found.bounds("skill.scooping_angle_deg", skill.scooping_angle_deg, angle);
    found.bounds("skill.lift_height_m", skill.lift_height_m, travel);
    found.bounds("skill.transport_displacement_m", skill.transport_displacement_m, travel);
    found.bounds("skill.pouring_angle_deg", skill.pouring_angle_deg, angle);
    for (index, bounds) in skill.initial_theta.iter().enumerate() {
        found.bounds(&format!("skill.initial_theta[{index}]"), *bounds, Range::closed(-1.0, 1.0));
    }
    found.number("skill.heading_deg", skill.heading_deg, TURN_DEG);
    found.number("skill.approach_m", skill.approach_m, Range::closed(1e-4, 1.0));
    found.number("skill.sweep_m", skill.sweep_m, Range::closed(0.0, 1.0));
    found.number("skill.linear_speed_m_s", skill.linear_speed_m_s, Range::closed(0.001, 5.0));
    found.number("skill.angular_speed_rad_s", skill.angular_speed_rad_s, Range::closed(0.01, 50.0));
    found.number("skill.overlap", skill.overlap, Range::closed(0.0, 1.0));
    found.count("skill.path.knots", skill.path.knots, 1, MAX_KNOTS);
    let freedoms = &skill.path.freedoms;
    let is_double = |(index, freedom): (usize, &Freedom)| freedoms[..index].contains(freedom);
    if freedoms.is_empty() || freedoms.iter().enumerate().any(is_double) {
        let names = toml::Value::try_from(freedoms)
            .map_or_else(|_| format!("{freedoms:?}"), |names| names.to_string());
        found.refuse(
            "skill.path.freedoms",
            names,
            "it must name one freedom or more, each of them once".into(),
        );
    }
}

fn limits(found: &mut Found<'_>, limits: &Limits) {
    found.vector("limits.workspace_min_m", &limits.workspace_min_m, WORLD_M);
    found.vector("limits.workspace_max_m", &limits.workspace_max_m, WORLD_M);
    for (name, value, high) in [
        ("linear_velocity_m_s", limits.linear_velocity_m_s, 100.0),
        ("linear_acceleration_m_s2", limits.linear_acceleration_m_s2, 1e4),
        ("linear_jerk_m_s3", limits.linear_jerk_m_s3, 1e7),
        ("angular_velocity_rad_s", limits.angular_velocity_rad_s, 1e3),
        ("angular_acceleration_rad_s2", limits.angular_acceleration_rad_s2, 1e5),
        ("angular_jerk_rad_s3", limits.angular_jerk_rad_s3, 1e8),
    ] {
        found.number(&format!("limits.{name}"), value, Range::closed(0.001, high));
    }
}

fn objective(found: &mut Found<'_>, objective: &Objective) {
    found.vector("objective.p_target_m", &objective.p_target_m, WORLD_M);
    if let Quantity::MassKg(mass_kg) = objective.amount.wanted {
        found.number("objective.amount.mass_kg", mass_kg, Range::above(0.0, 1e6));
    }
    found.number("objective.amount.tolerance", objective.amount.tolerance, Range::closed(0.0, 1.0));
    found.number("objective.lost_weight", objective.lost_weight, Range::closed(0.0, 100.0));
    if let Observation::VisibleFromAbove { pixel_m } = objective.observation {
        found.number("objective.observation.pixel_m", pixel_m, Range::closed(1e-4, 0.1));
    }
}
