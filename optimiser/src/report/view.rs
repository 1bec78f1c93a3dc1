//! A scene as pictures, pages and exports show it.

use nalgebra::{Isometry3, Vector3};
use powderline_shared::pose::Pose;
use powderline_simulator::arm::{ArmMotion, ToolPath};
use powderline_simulator::scene::{Container, ContainerShape, Gate, GateShape, Scene, Tool, ToolShape};
use powderline_view::{Bench, Role, arm::Arm, extent::Extent, mesh::Mesh};

/// What stands and moves in a scene, with the tool at these poses, for so many frames.
pub fn bench(scene: &Scene, poses: &[Pose], frames: usize, period_s: f64) -> Bench {
    let bench = Bench {
        name: scene.name.clone(),
        size_m: scene.domain.size_m,
        extent: Extent::of_volume(scene.domain.size_m),
        cell_m: scene.domain.cell_m,
        containers: scene.containers.iter().map(|container| drawn(scene, container)).collect(),
        gates: scene.gates.iter().map(gate).collect(),
        tool: tool(&scene.tool),
        arm: None,
        target_m: scene.objective.p_target_m,
        particles: scene.particle_count(),
        period_s,
        frames,
    };
    bench.framed(poses)
}

/// The arm of a scene, making a motion, with what holds the tool.
pub fn arm(scene: &Scene, motion: ArmMotion, path: ToolPath) -> Arm {
    let [_, held_m] = scene.tool.handle_axis_m();
    let bracket_radius_m = scene.tool.handle.radius_m;
    Arm { motion, path, table_m: table_m(scene), held_m, bracket_radius_m }
}

/// Top of the table that a scene's arm and bench stand on, metres; the bench's floor if nothing says otherwise.
pub fn table_m(scene: &Scene) -> f64 {
    scene.arm.as_ref().map_or(0.0, |arm| arm.table_height_m)
}

fn drawn(scene: &Scene, container: &Container) -> powderline_view::Container {
    let Container { name, position_m, yaw_deg, wall_thickness_m, .. } = container;
    let mesh = match container.shape {
        ContainerShape::Box { inner_size_m } => Mesh::open_box(inner_size_m, *wall_thickness_m),
        ContainerShape::SlottedBox { inner_size_m, slot_width_m } => {
            Mesh::slotted_box(inner_size_m, slot_width_m, *wall_thickness_m)
        }
        ContainerShape::Cylinder { inner_radius_m, inner_height_m } => {
            Mesh::open_cylinder(inner_radius_m, inner_height_m, *wall_thickness_m)
        }
        ContainerShape::Silo { inner_radius_m, inner_height_m, outlet_radius_m } => {
            Mesh::silo(inner_radius_m, inner_height_m, outlet_radius_m, *wall_thickness_m)
        }
        ContainerShape::Hopper { inner_radius_m, inner_height_m, outlet_radius_m, half_angle_deg } => {
            let lean_rad = half_angle_deg.to_radians();
            Mesh::hopper(inner_radius_m, inner_height_m, outlet_radius_m, lean_rad, *wall_thickness_m)
        }
    };
    let place = Isometry3::new((*position_m).into(), Vector3::z() * yaw_deg.to_radians());
    let role = match name {
        name if *name == scene.objective.source => Role::Source,
        name if *name == scene.objective.target => Role::Target,
        _ => Role::Bystander,
    };
    powderline_view::Container { name: name.clone(), role, mesh: mesh.moved(&place) }
}

fn gate(gate: &Gate) -> powderline_view::Gate {
    let mesh = match gate.shape {
        GateShape::Box { size_m: [x, y, z] } => Mesh::block([-0.5 * x, -0.5 * y, 0.0], [0.5 * x, 0.5 * y, z]),
        GateShape::Tube { inner_radius_m, height_m, wall_thickness_m } => {
            Mesh::pipe(inner_radius_m, height_m, wall_thickness_m)
        }
    };
    let place = Isometry3::new(gate.position_m.into(), Vector3::z() * gate.yaw_deg.to_radians());
    powderline_view::Gate { law: gate.clone(), mesh: mesh.moved(&place) }
}

fn tool(tool: &Tool) -> Mesh {
    let [from, to] = tool.handle_axis_m();
    let handle = Mesh::capsule(from, to, tool.handle.radius_m);
    match &tool.shape {
        ToolShape::Bowl { inner_radius_m } => Mesh::bowl(*inner_radius_m, tool.wall_thickness_m).and(handle),
        ToolShape::BoxScoop { inner_size_m } => {
            Mesh::box_scoop(*inner_size_m, tool.wall_thickness_m).and(handle)
        }
        ToolShape::Cuboids { cuboid } => {
            cuboid.iter().map(|block| Mesh::cuboid(block.corners_m())).fold(handle, Mesh::and)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use powderline_simulator::scene::{Cuboid, EMBEDDED_SCENES, GateOpening};
    use powderline_simulator::skill::{SkillMap, Theta};
    use powderline_view::Frame;
    use powderline_view::picture::{Camera, Image, Look, Painter};

    #[test]
    fn a_silo_is_drawn_with_its_hole() {
        let scene = Scene::load("vial").unwrap();
        let volume_m3 = |shape: ContainerShape| {
            drawn(&scene, &Container { shape, ..scene.containers[1].clone() }).mesh.volume_m3()
        };
        let (inner_radius_m, inner_height_m, outlet_radius_m) = (0.012, 0.03, 0.006);
        let whole = volume_m3(ContainerShape::Cylinder { inner_radius_m, inner_height_m });
        let silo = volume_m3(ContainerShape::Silo { inner_radius_m, inner_height_m, outlet_radius_m });
        let hole = std::f64::consts::PI * outlet_radius_m.powi(2) * scene.containers[1].wall_thickness_m;
        assert!(((whole - silo) / hole - 1.0).abs() < 0.01, "{whole} {silo} {hole}");
    }

    #[test]
    fn a_slotted_box_is_drawn_with_its_slot() {
        let scene = Scene::load("bench").unwrap();
        let volume_m3 = |shape: ContainerShape| {
            drawn(&scene, &Container { shape, ..scene.containers[1].clone() }).mesh.volume_m3()
        };
        let (inner_size_m, slot_width_m) = ([0.06, 0.04, 0.03], 0.01);
        let whole = volume_m3(ContainerShape::Box { inner_size_m });
        let slotted = volume_m3(ContainerShape::SlottedBox { inner_size_m, slot_width_m });
        let slot = slot_width_m * inner_size_m[1] * scene.containers[1].wall_thickness_m;
        assert!(((whole - slotted) / slot - 1.0).abs() < 1e-9, "{whole} {slotted} {slot}");
    }

    #[test]
    fn a_hopper_is_drawn_with_its_cone() {
        let scene = Scene::load("vial").unwrap();
        let (inner_radius_m, inner_height_m, outlet_radius_m, half_angle_deg) = (0.012, 0.03, 0.006, 30.0);
        let shape =
            ContainerShape::Hopper { inner_radius_m, inner_height_m, outlet_radius_m, half_angle_deg };
        let container = Container { shape, ..scene.containers[1].clone() };
        let (mesh, wall) = (drawn(&scene, &container).mesh, container.wall_thickness_m);
        let up = |p: &[f64; 3]| p[2] - container.position_m[2];
        let away = |p: &[f64; 3]| (p[0] - container.position_m[0]).hypot(p[1] - container.position_m[1]);
        let lowest = mesh.points_m.iter().map(up).fold(f64::MAX, f64::min);
        let widest = mesh.points_m.iter().map(away).fold(0.0, f64::max);
        // The cone's lower edge is across its wall.
        assert!((lowest + 0.5 * wall).abs() < 1e-9 && (widest - inner_radius_m - wall).abs() < 1e-9);
        let narrowest = mesh.points_m.iter().map(away).fold(f64::MAX, f64::min);
        assert!((narrowest - outlet_radius_m).abs() < 1e-9, "{narrowest}");
    }

    #[test]
    fn cuboids_are_drawn_where_they_stand() {
        let scene = Scene::load("bench").unwrap();
        let handle = bench(&scene, &[], 1, 0.01).tool;
        let one = Cuboid {
            centre_m: [0.0, 0.0, -0.01],
            size_m: [0.02, 0.03, 0.004],
            rotation_deg: [30.0, -20.0, 70.0],
        };
        let scene = scene.with(|spec| {
            spec.tool.shape = ToolShape::Cuboids { cuboid: vec![one] };
            spec.skill.scooping_depth_m = [0.002, 0.010];
        });
        let scene = scene.unwrap();
        let drawn = bench(&scene, &[], 1, 0.01).tool;
        assert_ne!(drawn.points_m, handle.points_m);
        let rod = Mesh::capsule([0.0; 3], [1.0; 3], 0.1).points_m.len();
        assert_eq!(drawn.points_m[rod..], one.corners_m());
        // Its corners are joined as its edges are: the faces enclose it, seen from outside.
        let volume_m3 = Mesh::cuboid(one.corners_m()).volume_m3();
        assert!((volume_m3 / (0.02 * 0.03 * 0.004) - 1.0).abs() < 1e-9, "{volume_m3}");
    }

    #[test]
    fn gates_are_drawn_where_they_are_shut() {
        let plate = Gate {
            name: "plate".into(),
            position_m: [0.12, 0.05, 0.02],
            yaw_deg: 90.0,
            friction: 0.4,
            opens_at_s: 1.0,
            shape: GateShape::Box { size_m: [0.03, 0.004, 0.02] },
            opening: GateOpening::Vanish {},
        };
        let tube = GateShape::Tube { inner_radius_m: 0.01, height_m: 0.03, wall_thickness_m: 0.002 };
        let gates = vec![plate.clone(), Gate { name: "tube".into(), shape: tube, ..plate }];
        let scene = Scene::load("bench").unwrap().with(|spec| spec.gates = gates).unwrap();
        let drawn = bench(&scene, &[], 1, 0.01).gates;
        let extent = |mesh: &Mesh, axis: usize| {
            let along = || mesh.points_m.iter().map(|point| point[axis]);
            [along().fold(f64::MAX, f64::min), along().fold(f64::MIN, f64::max)]
        };
        let wanted =
            [[[0.118, 0.122], [0.035, 0.065], [0.02, 0.04]], [[0.108, 0.132], [0.038, 0.062], [0.02, 0.05]]];
        for (gate, wanted) in drawn.iter().zip(wanted) {
            for (axis, ends) in wanted.into_iter().enumerate() {
                let found = extent(&gate.at(0.0).unwrap(), axis);
                assert!((0..2).all(|end| (found[end] - ends[end]).abs() < 1e-9), "{found:?} {ends:?}");
            }
            assert!(gate.mesh.volume_m3() > 0.0 && gate.at(1.0).is_none());
        }
    }

    /// A bench with its skill in the middle of all ranges, somewhere in a volume.
    fn placed(size_m: Option<[f64; 3]>, by_m: [f64; 3]) -> Bench {
        let mut scene = Scene::load("bench").unwrap().into_spec();
        scene.domain.size_m = size_m.unwrap_or(scene.domain.size_m);
        let moved = |at: &mut [f64; 3]| (0..3).for_each(|axis| at[axis] += by_m[axis]);
        scene.containers.iter_mut().for_each(|container| moved(&mut container.position_m));
        let (powder, limits) = (&mut scene.powder, &mut scene.limits);
        for at in [
            &mut scene.tool.start_position_m,
            &mut scene.objective.p_target_m,
            &mut powder.fill_min_m,
            &mut powder.fill_max_m,
            &mut limits.workspace_min_m,
            &mut limits.workspace_max_m,
        ] {
            moved(at);
        }
        let scene = scene.validate().unwrap();
        let map = SkillMap::new(&scene);
        let controls = map.controls(&Theta::MIDDLE).unwrap();
        let next = |pose: &mut Pose, control: &_| {
            *pose = pose.displaced(control);
            Some(*pose)
        };
        let poses: Vec<Pose> = controls.iter().scan(*map.start_pose(), next).collect();
        bench(&scene, &poses, 1, 0.01)
    }

    #[test]
    fn a_bench_in_a_large_volume_is_framed_as_in_its_own() {
        let look = Look { width_px: 320, height_px: 240, labels: false, ..Look::default() };
        let drawn = |bench: &Bench, at: [f64; 3]| {
            let tool = Pose { position_m: at.into(), ..Pose::identity() };
            let nothing: &[[f32; 3]] = &[];
            let frame = Frame {
                index: 0,
                time_s: 0.0,
                tool,
                planned: None,
                positions_m: nothing,
                velocities_m_s: nothing,
            };
            Painter::new(bench, &Camera::default(), &look).unwrap().draw(&frame, &[])
        };
        // Columns and rows at which something else than the empty floor begins and ends.
        let ends = |image: &Image| {
            let is_drawn = |pixel: usize| image.rgb[3 * pixel..][..3].iter().any(|part| *part < 215);
            let drawn = || (0..image.width_px * image.height_px).filter(|pixel| is_drawn(*pixel));
            let [columns, rows] = [|at: usize| at % 320, |at: usize| at / 320]
                .map(|place| [drawn().map(place).min().unwrap(), drawn().map(place).max().unwrap()]);
            [columns, rows]
        };
        let by_m = [0.4, 0.5, 0.0];
        let start = Scene::load("bench").unwrap().tool.start_position_m;
        let own = ends(&drawn(&placed(None, [0.0; 3]), start));
        let large =
            ends(&drawn(&placed(Some([1.0; 3]), by_m), std::array::from_fn(|axis| start[axis] + by_m[axis])));
        for (own, large) in own.iter().flatten().zip(large.iter().flatten()) {
            assert!(own.abs_diff(*large) <= 2, "{own} {large}");
        }
        let [columns, _] = own;
        assert!(columns[1] - columns[0] > 200, "{columns:?} of 320");
    }

    #[test]
    fn every_shipped_scene_is_drawn_within_its_volume() {
        for (name, _) in EMBEDDED_SCENES {
            let scene = Scene::load(name).unwrap();
            let bench = bench(&scene, &[], 1, 0.01);
            assert_eq!(bench.containers.iter().filter(|c| c.role == Role::Source).count(), 1);
            assert_eq!(bench.containers.iter().filter(|c| c.role == Role::Target).count(), 1);
            for container in &bench.containers {
                let inside =
                    |point: &[f64; 3]| (0..3).all(|i| (-1e-9..=scene.domain.size_m[i]).contains(&point[i]));
                assert!(container.mesh.points_m.iter().all(inside), "{name}: {}", container.name);
            }
            // The body reaches down as far as the simulator says.
            let lowest = bench.tool.points_m.iter().map(|point| point[2]).fold(f64::MAX, f64::min);
            assert!((lowest + scene.tool.body_depth_m()).abs() < 1e-9, "{name}: {lowest}");
        }
    }
}
