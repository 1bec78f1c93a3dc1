//! A scene as pictures, pages and exports show it.

use nalgebra::{Isometry3, Vector3};
use powderline_simulator::scene::{Container, ContainerShape, Gate, GateShape, Scene, Tool, ToolShape};
use powderline_view::{Bench, Role, mesh::Mesh};

/// What stands and moves in a scene, for so many particles and frames.
pub fn bench(scene: &Scene, particles: usize, frames: usize, period_s: f64) -> Bench {
    Bench {
        name: scene.name.clone(),
        size_m: scene.domain.size_m,
        cell_m: scene.domain.cell_m,
        containers: scene.containers.iter().map(|container| drawn(scene, container)).collect(),
        gates: scene.gates.iter().map(gate).collect(),
        tool: tool(&scene.tool),
        target_m: scene.objective.p_target_m,
        particles,
        period_s,
        frames,
    }
}

fn drawn(scene: &Scene, container: &Container) -> powderline_view::Container {
    let Container { name, position_m, yaw_deg, wall_thickness_m, .. } = container;
    let mesh = match container.shape {
        ContainerShape::Box { inner_size_m } => Mesh::open_box(inner_size_m, *wall_thickness_m),
        ContainerShape::Cylinder { inner_radius_m, inner_height_m } => {
            Mesh::open_cylinder(inner_radius_m, inner_height_m, *wall_thickness_m)
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

    #[test]
    fn cuboids_are_drawn_where_they_stand() {
        let mut scene = Scene::load("bench").unwrap();
        let handle = bench(&scene, 1, 1, 0.01).tool;
        let one = Cuboid {
            centre_m: [0.0, 0.0, -0.01],
            size_m: [0.02, 0.03, 0.004],
            rotation_deg: [30.0, -20.0, 70.0],
        };
        scene.tool.shape = ToolShape::Cuboids { cuboid: vec![one] };
        let drawn = bench(&scene, 1, 1, 0.01).tool;
        assert_ne!(drawn.points_m, handle.points_m);
        let rod = Mesh::capsule([0.0; 3], [1.0; 3], 0.1).points_m.len();
        assert_eq!(drawn.points_m[rod..], one.corners_m());
        // Its corners are joined as its edges are: the faces enclose it, seen from outside.
        let volume_m3 = Mesh::cuboid(one.corners_m()).volume_m3();
        assert!((volume_m3 / (0.02 * 0.03 * 0.004) - 1.0).abs() < 1e-9, "{volume_m3}");
    }

    #[test]
    fn gates_are_drawn_where_they_are_shut() {
        let mut scene = Scene::load("bench").unwrap();
        let plate = Gate {
            name: "plate".into(),
            position_m: [0.1, 0.05, 0.02],
            yaw_deg: 90.0,
            friction: 0.4,
            opens_at_s: 1.0,
            shape: GateShape::Box { size_m: [0.03, 0.004, 0.02] },
            opening: GateOpening::Vanish {},
        };
        let tube = GateShape::Tube { inner_radius_m: 0.01, height_m: 0.03, wall_thickness_m: 0.002 };
        scene.gates = vec![plate.clone(), Gate { shape: tube, ..plate }];
        let drawn = bench(&scene, 1, 1, 0.01).gates;
        let extent = |mesh: &Mesh, axis: usize| {
            let along = || mesh.points_m.iter().map(|point| point[axis]);
            [along().fold(f64::MAX, f64::min), along().fold(f64::MIN, f64::max)]
        };
        let wanted =
            [[[0.098, 0.102], [0.035, 0.065], [0.02, 0.04]], [[0.088, 0.112], [0.038, 0.062], [0.02, 0.05]]];
        for (gate, wanted) in drawn.iter().zip(wanted) {
            for (axis, ends) in wanted.into_iter().enumerate() {
                let found = extent(&gate.at(0.0).unwrap(), axis);
                assert!((0..2).all(|end| (found[end] - ends[end]).abs() < 1e-9), "{found:?} {ends:?}");
            }
            assert!(gate.mesh.volume_m3() > 0.0 && gate.at(1.0).is_none());
        }
    }

    #[test]
    fn every_shipped_scene_is_drawn_within_its_volume() {
        for (name, _) in EMBEDDED_SCENES {
            let scene = Scene::load(name).unwrap();
            let bench = bench(&scene, 1, 1, 0.01);
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
