//! A small bench and its frames, for tests.

use powderline_shared::arm::ArmModel;
use powderline_shared::limits::Limits;
use powderline_shared::pose::Pose;
use powderline_simulator::arm::{ArmMotion, CYCLE_US, Mount, Surroundings, ToolPath};
use powderline_simulator::scene::{GateOpening, GateShape};
use powderline_simulator::skill::LSB;

use super::{Colouring, Containers, Look};
use crate::arm::Arm;
use crate::extent::Extent;
use crate::mesh::Mesh;
use crate::{Bench, Container, Frame, Gate, Role};

/// One box and a bowl; a frame every quarter of a second, which binary numbers hold exactly.
pub(crate) fn bench() -> Bench {
    let mesh =
        Mesh::open_box([0.05, 0.05, 0.02], 0.004).moved(&nalgebra::Isometry3::translation(0.05, 0.05, 0.004));
    Bench {
        name: "sample".to_owned(),
        size_m: [0.1, 0.1, 0.1],
        extent: Extent { low_m: [0.0; 3], high_m: [0.1; 3] },
        cell_m: 0.01,
        containers: vec![Container { name: "source".to_owned(), role: Role::Source, mesh }],
        gates: vec![gate()],
        tool: Mesh::bowl(0.012, 0.002),
        arm: None,
        target_m: [0.05; 3],
        particles: 3,
        period_s: 0.25,
        frames: 21,
    }
}

/// The arm of the scene `bench` with a tool that goes 20 mm along x in 0.2 s, its handle above it.
pub(crate) fn arm() -> Arm {
    let ArmModel { kind, world_from_base, flange_from_tool, posture, .. } = ArmModel::bench();
    let mount = Mount {
        kind,
        world_from_base,
        flange_from_tool,
        posture: Some(posture),
        near: None,
        clearance_m: None,
    };
    let pose = |tick: u32| Pose {
        position_m: nalgebra::Vector3::new(0.05 + 1e-3 * f64::from(tick), 0.05, 0.08),
        ..Pose::identity()
    };
    let any = 1e6;
    let limits = Limits {
        workspace_min_m: [-any; 3],
        workspace_max_m: [any; 3],
        linear_velocity_m_s: any,
        linear_acceleration_m_s2: any,
        linear_jerk_m_s3: any,
        angular_velocity_rad_s: any,
        angular_acceleration_rad_s2: any,
        angular_jerk_rad_s3: any,
    };
    let path = ToolPath { period_us: 10_000, lsb: LSB, limits, poses: (0..=20).map(pose).collect() };
    let motion = ArmMotion::new(&path, &mount, &Surroundings::table(-0.1), CYCLE_US).expect("within reach");
    Arm { motion, path, table_m: -0.1, held_m: [-0.02, 0.0, 0.04], bracket_radius_m: 0.004 }
}

/// A plate before the box that is gone from frame 3 on.
pub(crate) fn gate() -> Gate {
    let law = powderline_simulator::scene::Gate {
        name: "lid".to_owned(),
        position_m: [0.05, 0.02, 0.0],
        yaw_deg: 0.0,
        friction: 0.4,
        opens_at_s: 0.75,
        shape: GateShape::Box { size_m: [0.04, 0.004, 0.03] },
        opening: GateOpening::Vanish {},
    };
    let mesh = Mesh::block([0.03, 0.018, 0.0], [0.07, 0.022, 0.03]);
    Gate { law, mesh }
}

/// A small picture with everything in it.
pub(crate) fn look() -> Look {
    Look { width_px: 96, height_px: 72, containers: Containers::Translucent, ..Look::default() }
}

/// A picture of nothing but grey floor and spheres of a colour.
pub(crate) fn bare(colouring: Colouring) -> Look {
    let background = [200; 3];
    Look { width_px: 320, height_px: 240, colouring, background, grains: 1, labels: false, ..Look::default() }
}

/// Particles of a frame, which move with it.
pub(crate) fn positions(index: usize) -> [[f32; 3]; 3] {
    [0.03, 0.05, 0.07].map(|x| [x, 0.05, 0.01 + 0.004 * index as f32])
}

pub(crate) fn frame(index: usize, positions_m: &[[f32; 3]]) -> Frame<'_> {
    let mut tool = Pose::identity();
    tool.position_m = nalgebra::Vector3::new(0.05, 0.05, 0.08);
    Frame { index, time_s: 0.25 * index as f64, tool, planned: None, positions_m, velocities_m_s: &[] }
}
