//! What is allowed in a scene but worth knowing.

use super::figures::{about, list, mass};
use super::solid::{Hull, Vec3, dot};
use super::{Container, ContainerShape, Objective, PlacedTool, Powder, Scene, SleepBy, Walls};

/// Gap between expectation and geometry that is worth a remark, in cells.
const REMARKABLE_CELLS: f64 = 0.25;

/// Cells in a radius from which on a column runs out as far as sand does and an amount hardly depends on the cell any more.
const CELLS_PER_RADIUS: f64 = 12.0;

/// Distance of a face from nodes, and from the middle between two, that lets powder sink, in cells.
const BADLY_PLACED_CELLS: f64 = 0.1;

impl Scene {
    /// Sentences about a valid scene that may hide a mistake: powder that starts outside the source, a start height at odds with the
    /// approach, faces that the grid holds badly, a target point that is not in the target, cells too coarse for the tool, bonds that never break, and a base that
    /// stands in something.
    pub fn warnings(&self) -> Vec<String> {
        [
            self.remark_powder(),
            self.remark_approach(),
            self.remark_faces(),
            self.remark_target(),
            self.remark_cells(),
            self.remark_bond(),
            self.remark_base(),
        ]
        .into_iter()
        .flatten()
        .collect()
    }

    /// A grain by itself then pulls at the nodes around it for ever, so that its affine velocity only grows; where its own velocity is kept
    /// as well, the adjoint grows with it, by a sixth in each substep on the scene `vial`.
    fn remark_bond(&self) -> Option<String> {
        let powder = &self.powder;
        // Half of the apex's is typical; at small angles the apex is far away.
        let strength_pa = powder.cohesion_pa.min(0.5 * powder.apex_tension_pa());
        (powder.transfer.is_some() && powder.cohesion_pa > 0.0 && powder.tensile_strength_pa.is_none()).then(|| {
            format!(
                "powder.cohesion_pa is {} without powder.tensile_strength_pa: with powder.transfer single grains then pull at their \
                 surroundings for ever, which the gradient may not outlast; powder.tensile_strength_pa = {} would be right",
                about(powder.cohesion_pa, 3),
                about(strength_pa, 2)
            )
        })
    }

    /// The column from base to shoulder is no link, so that nobody else looks where it is.
    fn remark_base(&self) -> Option<String> {
        let arm = self.arm.as_ref()?;
        let (foot, figures) = (arm.base_position_m, arm.kind.figures());
        let radius_m = figures.column_radius_m;
        let [(sr, cr), (sp, cp), (sy, cy)] = arm.base_rotation_deg.map(|deg| libm::sincos(deg.to_radians()));
        let up = [cy * sp * cr + sy * sr, sy * sp * cr - cy * sr, cp * cr];
        let column = |d: Vec3| {
            let along = dot(up, d);
            dot(foot, d)
                + (along * figures.d1_m).max(0.0)
                + radius_m * libm::sqrt((dot(d, d) - along * along).max(0.0))
        };
        let [x, y, _] = self.domain.size_m;
        let block = (arm.table_height_m < 0.0).then(|| {
            let hull = Hull::aligned_box([0.0, 0.0, arm.table_height_m], [x, y, 0.0]);
            ("the block that the simulated volume stands on".to_owned(), hull)
        });
        let containers = self.containers.iter().map(|one| (format!("container {:?}", one.name), one.outer()));
        let (what, _) = block.into_iter().chain(containers).find(|(_, hull)| !hull.clear_of(column))?;
        Some(format!(
            "arm.base_position_m = {} puts the arm's base, taken for a column {} mm wide, into {what}; farther away would be right",
            list(&foot),
            about(2e3 * radius_m, 3)
        ))
    }

    fn remark_powder(&self) -> Option<String> {
        let Powder { fill_min_m, fill_max_m, seed, .. } = &self.powder;
        let source = self.containers.iter().find(|container| container.name == self.objective.source)?;
        if source.holds_powder(&self.powder) {
            return None;
        }
        let positions = self.particle_positions_m(*seed);
        let outside = positions.iter().filter(|p| !source.holds_point(**p)).count();
        Some(format!(
            "powder.fill_min_m = {} and powder.fill_max_m = {} let {} of {} start outside the source {:?}: it falls from there before \
             and while the tool moves, depths are measured from a surface skill.approach_m below the start, and what ends in no \
             container counts as on rims or spilled",
            list(fill_min_m),
            list(fill_max_m),
            mass(outside as f64 * self.particle_mass_kg()),
            mass(positions.len() as f64 * self.particle_mass_kg()),
            source.name
        ))
    }

    fn remark_approach(&self) -> Option<String> {
        let source = self.containers.iter().find(|container| container.name == self.objective.source)?;
        if !source.holds_powder(&self.powder) {
            // Nobody knows where its surface will be.
            return None;
        }
        let start = PlacedTool::new(self, self.tool.start_position_m, self.tool.start_pitch_deg);
        let lowest_m = -start.body_support([0.0, 0.0, -1.0]) - self.skill.approach_m;
        let above_m = lowest_m - self.powder.fill_max_m[2];
        (above_m.abs() > REMARKABLE_CELLS * self.domain.cell_m).then(|| {
            format!(
                "after skill.approach_m the tool's lowest point is {} mm {} the powder's surface, which depths are \
                 measured from",
                about(1e3 * above_m.abs(), 3),
                if above_m > 0.0 { "above" } else { "below" }
            )
        })
    }

    fn remark_target(&self) -> Option<String> {
        let Objective { target, p_target_m, .. } = &self.objective;
        let container = self.containers.iter().find(|container| container.name == *target)?;
        let nearest_m = container.nearest_m(p_target_m);
        let off_m = [0, 1, 2].map(|axis| nearest_m[axis] - p_target_m[axis]);
        let off_m = libm::hypot(libm::hypot(off_m[0], off_m[1]), off_m[2]);
        (off_m > container.wall_thickness_m).then(|| {
            format!(
                "objective.p_target_m, which powder is drawn to, is {} mm outside the target {target:?}; {} would be the \
                 nearest point inside",
                about(1e3 * off_m, 3),
                list(&nearest_m.map(|x| (1e4 * x).round() / 1e4))
            )
        })
    }

    fn remark_cells(&self) -> Option<String> {
        let radius_m = self.tool.with_body(|body| body.half_width_m());
        let cells = radius_m / self.domain.cell_m;
        (cells < CELLS_PER_RADIUS - 1e-6).then(|| {
            format!(
                "the tool is {} cells in radius: with fewer than {} the amount that arrives depends on the cell, so simulate the \
                 skill once more in a scene with domain.cell_m = {} and time.substeps = {} before you believe it; cells of {} m \
                 would be right",
                about(cells, 2),
                about(CELLS_PER_RADIUS, 2),
                about(0.5 * self.domain.cell_m, 3),
                2 * self.time.substeps,
                about(radius_m / CELLS_PER_RADIUS, 2)
            )
        })
    }

    /// Of walls with two sides, and powder that sleeps by the mean, beds stay where they are, wherever the faces lie.
    fn remark_faces(&self) -> Option<String> {
        let domain = &self.domain;
        let sleeps = domain.sleep_by == SleepBy::MeanSquare && domain.sleep_speed_m_s > 0.0;
        if domain.walls == Walls::TwoSided && sleeps {
            return None;
        }
        let cell_m = domain.cell_m;
        let (container, face_m) = self.containers.iter().find_map(|container| {
            let badly = |face_m: &f64| {
                let halves = 2.0 * face_m / cell_m;
                0.5 * (halves - halves.round()).abs() > BADLY_PLACED_CELLS
            };
            container.faces_m().into_iter().find(badly).map(|face_m| (container, face_m))
        })?;
        Some(format!(
            "a face of container {:?} at {} mm lies neither on the grid's nodes nor midway between two, so powder at \
             rest on it sinks by some per cent a second; multiples of {} mm would be right, or domain.walls = \"two_sided\" with \
             domain.sleep_by = \"mean_square\"",
            container.name,
            about(1e3 * face_m, 4),
            about(1e3 * 0.5 * cell_m, 4)
        ))
    }
}

impl Container {
    /// Coordinates of the inner floor and, where they are square to the grid, of the inner walls, metres.
    fn faces_m(&self) -> Vec<f64> {
        let [x, y, z] = self.position_m;
        let quarters = self.yaw_deg / 90.0;
        let square = (quarters - quarters.round()).abs() < 1e-9;
        match self.shape {
            ContainerShape::Box { inner_size_m: [length, width, _] }
            | ContainerShape::SlottedBox { inner_size_m: [length, width, _], .. }
                if square =>
            {
                let turned = quarters.round().rem_euclid(2.0) > 0.5;
                let (hx, hy) = if turned { (0.5 * width, 0.5 * length) } else { (0.5 * length, 0.5 * width) };
                vec![z, x - hx, x + hx, y - hy, y + hy]
            }
            // Where it ends is a hole.
            ContainerShape::Hopper { .. } => Vec::new(),
            _ => vec![z],
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_target_point_outside_the_target_is_remarked() {
        for name in ["bench", "bench-small", "bench-fine", "vial", "workcell"] {
            assert_eq!(Scene::load(name).unwrap().remark_target(), None, "{name}");
        }
        let mut scene = Scene::load("vial").unwrap();
        scene.objective.p_target_m[0] += 0.28;
        let remark = scene.remark_target().unwrap();
        assert!(remark.contains("mm outside the target \"vial\"; ["), "{remark}");
    }

    #[test]
    fn powder_that_starts_outside_the_source_is_remarked() {
        for name in ["bench", "bench-small", "bench-fine", "vial", "workcell"] {
            assert_eq!(Scene::load(name).unwrap().remark_powder(), None, "{name}");
        }
        // Half of it above the rim.
        let mut scene = Scene::load("bench").unwrap();
        scene.powder.fill_min_m[2] = 0.030;
        scene.powder.fill_max_m[2] = 0.038;
        let remark = scene.remark_powder().unwrap();
        let about = "let 16.38 g of 32.77 g start outside the source \"source\"";
        assert!(remark.contains(about), "{remark}");
        assert_eq!(scene.remark_approach(), None);
    }

    #[test]
    fn a_base_in_the_bench_is_remarked() {
        let at = |base_position_m: [f64; 3], base_rotation_deg: [f64; 3]| {
            let mut scene = Scene::load("bench").unwrap();
            let arm = scene.arm.as_mut().unwrap();
            (arm.base_position_m, arm.base_rotation_deg) = (base_position_m, base_rotation_deg);
            scene.remark_base()
        };
        for (position_m, rotation_deg, into) in [
            ([0.128, 0.048, -0.1], [0.0; 3], Some("into the block")),
            // The column is 190 mm wide.
            ([0.128, -0.094, -0.1], [0.0; 3], Some("into the block")),
            ([0.128, -0.096, -0.1], [0.0; 3], None),
            // On the bench, between the containers or not; over them, hanging.
            ([0.100, 0.048, 0.0], [0.0; 3], Some("into container \"source\"")),
            ([0.128, 0.048, 0.9], [180.0, 0.0, 0.0], None),
            ([0.128, 0.048, 0.05], [0.0; 3], None),
        ] {
            let remark = at(position_m, rotation_deg);
            assert_eq!(remark.is_some(), into.is_some(), "{position_m:?} {remark:?}");
            assert!(remark.unwrap_or_default().contains(into.unwrap_or_default()));
        }
        for name in ["bench", "bench-small", "bench-fine", "vial", "workcell"] {
            assert_eq!(Scene::load(name).unwrap().remark_base(), None, "{name}");
        }
    }

    #[test]
    fn cells_too_coarse_for_the_tool_are_remarked() {
        let mut scene = Scene::load("bench").unwrap();
        let remark = scene.remark_cells().unwrap();
        assert!(
            remark.contains("4 cells in radius")
                && remark.contains("time.substeps = 40 before")
                && remark.contains("cells of 0.0013 m would"),
            "{remark}"
        );
        scene.domain.cell_m = 0.016 / 12.0;
        assert_eq!(scene.remark_cells(), None);
    }

    #[test]
    fn bonds_that_never_break_are_remarked() {
        for name in ["bench", "bench-small", "bench-fine", "vial", "workcell"] {
            assert_eq!(Scene::load(name).unwrap().remark_bond(), None, "{name}");
        }
        // What is said to be right is taken, whatever the angle.
        for (angle_deg, right) in [(33.0, "3.1"), (60.0, "1.1"), (1.0, "5")] {
            let mut scene = Scene::load("vial").unwrap();
            scene.powder.transfer = Scene::load("bench").unwrap().powder.transfer;
            scene.powder.friction_angle_deg = angle_deg;
            scene.powder.tensile_strength_pa = None;
            let remark = scene.remark_bond().unwrap();
            assert!(remark.contains(&format!("tensile_strength_pa = {right} would")), "{remark}");
            scene.powder.tensile_strength_pa = Some(right.parse().unwrap());
            scene.clone().into_spec().validate_as("vial.toml").unwrap();
            assert_eq!(scene.remark_bond(), None);
        }
    }

    #[test]
    fn faces_between_nodes_are_remarked() {
        let mut scene = Scene::load("bench").unwrap();
        scene.domain.walls = Walls::Shared;
        assert_eq!(scene.remark_faces(), None);
        scene.containers[1].position_m[0] += 0.001;
        scene.domain.walls = Walls::TwoSided;
        assert_eq!(scene.remark_faces(), None);
        // Without sleep by the mean it sinks there, too.
        scene.domain.sleep_by = SleepBy::Largest;
        assert!(scene.remark_faces().is_some());
        scene.domain.walls = Walls::Shared;
        let remark = scene.remark_faces().unwrap();
        assert!(remark.contains("\"target\" at 145 mm") && remark.contains("multiples of 2 mm"), "{remark}");
        scene.containers[1].yaw_deg = 30.0;
        assert_eq!(scene.remark_faces(), None);
        scene.containers[1].position_m[2] += 0.0011;
        assert!(scene.remark_faces().unwrap().contains("at 5.1 mm"));
    }
}
