//! Rules about places, with turned and round containers and the box scoop.

use powderline_simulator::scene::{
    Container, ContainerShape, FillShape, Gate, GateOpening, GateShape, Scene, SceneError, SceneSpec,
    ToolShape,
};

fn bench() -> SceneSpec {
    Scene::load("bench").unwrap().into_spec()
}

/// The field that a scene is refused for, if it is.
fn refused_field(scene: &SceneSpec) -> Option<String> {
    match scene.clone().validate_as("scene") {
        Ok(_) => None,
        Err(SceneError::Invalid { field, .. }) => Some(field),
        Err(other) => panic!("{other}"),
    }
}

/// The same bench turned by a quarter: x becomes y, y becomes -x.
fn quarter_turn(scene: &mut SceneSpec) {
    let depth_m = scene.domain.size_m[1];
    let turn = |[x, y, z]: [f64; 3]| [depth_m - y, x, z];
    let [low, high] = [scene.powder.fill_min_m, scene.powder.fill_max_m].map(turn);
    scene.powder.fill_min_m = [high[0], low[1], low[2]];
    scene.powder.fill_max_m = [low[0], high[1], high[2]];
    let [low, high] = [scene.limits.workspace_min_m, scene.limits.workspace_max_m].map(turn);
    scene.limits.workspace_min_m = [high[0], low[1], low[2]];
    scene.limits.workspace_max_m = [low[0], high[1], high[2]];
    for container in &mut scene.containers {
        container.position_m = turn(container.position_m);
        container.yaw_deg = 90.0;
    }
    scene.tool.start_position_m = turn(scene.tool.start_position_m);
    scene.objective.p_target_m = turn(scene.objective.p_target_m);
    scene.domain.size_m.swap(0, 1);
    scene.skill.heading_deg = 90.0;
}

#[test]
fn a_turned_bench_is_as_valid_and_as_invalid() {
    let mut scene = bench();
    quarter_turn(&mut scene);
    assert_eq!(refused_field(&scene), None);
    scene.skill.sweep_m = 0.030;
    let sentence = "scene: skill.sweep_m is 0.03, but while scooping along skill.heading_deg = 90 the tool would go 0.0075 m \
                    into the +x wall of container \"source\", turned by 90 degrees; a shorter sweep or a start further back \
                    would be right";
    assert_eq!(scene.clone().validate_as("scene").unwrap_err().to_string(), sentence);
}

#[test]
fn a_wall_beside_the_way_is_not_said_to_be_ahead() {
    let mut scene = bench();
    // 20 mm of bowl at y = 58 mm, and 20 mm of sweep, of which 6.8 mm go sideways: 4.8 mm into the wall at 80 mm.
    scene.skill.heading_deg = 20.0;
    scene.tool.start_position_m[1] = 0.058;
    let sentence = scene.clone().validate_as("scene").unwrap_err().to_string();
    let about =
        "would go 0.0048 m into the +y wall of container \"source\"; a start so much further from that wall";
    assert!(sentence.contains(about), "{sentence}");
}

#[test]
fn a_container_turned_out_of_line_still_counts_whole() {
    let mut scene = bench();
    // Across the diagonal the target's outer half width is 51 mm: out at y = 48 + 51.
    scene.containers[1].yaw_deg = 45.0;
    assert_eq!(refused_field(&scene).as_deref(), Some("container \"target\".position_m"));
    scene.domain.size_m[1] = 0.104;
    assert_eq!(refused_field(&scene).as_deref(), Some("container \"target\".position_m"));
    // 36 + 51 mm apart and both inside: valid.
    scene.domain.size_m[1] = 0.128;
    for container in &mut scene.containers {
        container.position_m[1] = 0.064;
    }
    scene.powder.fill_min_m[1] = 0.032;
    scene.powder.fill_max_m[1] = 0.096;
    scene.tool.start_position_m[1] = 0.064;
    assert_eq!(refused_field(&scene), None);
    scene.containers[1].position_m[0] = 0.056 + 0.036 + 0.050;
    assert_eq!(refused_field(&scene).as_deref(), Some("container \"target\".position_m"));
}

#[test]
fn powder_must_fit_into_a_round_source_with_its_corners() {
    let mut scene = bench();
    scene.containers[0].shape = ContainerShape::Cylinder { inner_radius_m: 0.036, inner_height_m: 0.030 };
    assert_eq!(refused_field(&scene).as_deref(), Some("powder.fill_min_m"));
    scene.powder.fill_min_m = [0.032, 0.024, 0.004];
    scene.powder.fill_max_m = [0.080, 0.072, 0.026];
    assert_eq!(refused_field(&scene), None);
}

#[test]
fn a_round_wall_is_met_where_its_radius_says() {
    let mut scene = bench();
    scene.powder.fill_min_m = [0.040, 0.032, 0.004];
    scene.powder.fill_max_m = [0.072, 0.064, 0.026];
    let mut refused_with_radius = |inner_radius_m| {
        scene.containers[0].shape = ContainerShape::Cylinder { inner_radius_m, inner_height_m: 0.030 };
        refused_field(&scene)
    };
    // The bowl's 20 mm and the 10.5 mm that its middle starts behind the container's need 30.5 mm.
    assert_eq!(refused_with_radius(0.0307), None);
    assert_eq!(refused_with_radius(0.0303).as_deref(), Some("tool.start_position_m"));
    let sentence = scene.clone().validate_as("scene").unwrap_err().to_string();
    let about =
        "into the wall of container \"source\" at 183 degrees from +x; a start further inside would be right";
    assert!(sentence.contains(about), "{sentence}");
}

#[test]
fn a_box_scoop_is_judged_by_its_corners() {
    let mut scene = bench();
    scene.tool.shape = ToolShape::BoxScoop { inner_size_m: [0.020, 0.020, 0.012] };
    assert_eq!(refused_field(&scene), None);
    // Wider than the source box, walls included: 64 mm inner width, 2 x 4 mm of walls.
    scene.tool.shape = ToolShape::BoxScoop { inner_size_m: [0.020, 0.057, 0.012] };
    assert_eq!(refused_field(&scene).as_deref(), Some("tool.start_position_m"));
}

#[test]
fn a_column_is_as_wide_as_the_round_source_that_holds_it() {
    let mut scene = bench();
    scene.containers[0].shape = ContainerShape::Cylinder { inner_radius_m: 0.032, inner_height_m: 0.030 };
    assert_eq!(refused_field(&scene).as_deref(), Some("powder.fill_min_m"));
    scene.powder.fill_shape = FillShape::Cylinder;
    assert_eq!(refused_field(&scene), None);
    scene.powder.fill_max_m[0] += 0.0001;
    scene.powder.fill_max_m[1] += 0.0001;
    assert_eq!(refused_field(&scene).as_deref(), Some("powder.fill_min_m"));
    // A box that is turned by 45 degrees holds it as well as one that is not.
    let mut scene = bench();
    scene.powder.fill_shape = FillShape::Cylinder;
    scene.containers[0].yaw_deg = 45.0;
    let sentence = scene.clone().validate_as("scene").map_err(|error| error.to_string());
    assert!(sentence.is_err_and(|sentence| !sentence.contains("powder")));
}

#[test]
fn powder_starts_anywhere_but_in_walls_and_floors() {
    let mut scene = bench();
    let mut refusal = |min_m, max_m| {
        (scene.powder.fill_min_m, scene.powder.fill_max_m) = (min_m, max_m);
        scene.clone().validate_as("scene").err().map(|error| error.to_string())
    };
    for (min_m, max_m, what) in [
        ([0.024, 0.016, 0.004], [0.088, 0.080, 0.040], "heaped above the rim"),
        ([0.040, 0.020, 0.120], [0.088, 0.080, 0.150], "above the source and the tool"),
        ([0.100, 0.016, 0.000], [0.132, 0.080, 0.020], "on the bench top between the containers"),
        ([0.180, 0.016, 0.004], [0.208, 0.080, 0.044], "in the target"),
        ([0.144, 0.008, 0.060], [0.240, 0.088, 0.080], "above the target, and wider"),
    ] {
        assert_eq!(refusal(min_m, max_m), None, "{what}");
    }
    for (min_m, max_m, what) in [
        (
            [0.100, 0.016, 0.000],
            [0.142, 0.080, 0.020],
            "0.002 m into the -x wall of container \"target\"; clear",
        ),
        (
            [0.160, 0.016, 0.003],
            [0.208, 0.080, 0.020],
            "0.001 m into the floor of container \"target\"; clear",
        ),
        ([0.100, 0.016, 0.000], [0.252, 0.080, 0.060], "wall of container \"target\"; clear"),
        ([0.100, 0.016, 0.190], [0.252, 0.080, 0.210], "outside the domain"),
        ([0.040, 0.016, 0.060], [0.080, 0.080, 0.100], "the tool overlaps the powder"),
    ] {
        let found = refusal(min_m, max_m).unwrap_or_default();
        assert!(found.contains(what), "{found}");
    }
}

/// A pipe that stands on the source's floor.
fn pipe(inner_radius_m: f64) -> Gate {
    Gate {
        name: "pipe".into(),
        position_m: [0.056, 0.048, 0.004],
        yaw_deg: 10.0,
        friction: 0.4,
        opens_at_s: 0.1,
        shape: GateShape::Tube { inner_radius_m, height_m: 0.024, wall_thickness_m: 0.004 },
        opening: GateOpening::Vanish {},
    }
}

/// The bench with a column of powder of 12 mm radius in the middle of the source.
fn column() -> SceneSpec {
    let mut scene = bench();
    scene.powder.fill_min_m = [0.044, 0.036, 0.004];
    scene.powder.fill_max_m = [0.068, 0.060, 0.026];
    scene.powder.fill_shape = FillShape::Cylinder;
    scene
}

#[test]
fn a_pipe_stands_around_the_powder_or_clear_of_it() {
    let mut scene = column();
    let mut refused_with_radius = |inner_radius_m| {
        scene.gates = vec![pipe(inner_radius_m)];
        refused_field(&scene)
    };
    assert_eq!(refused_with_radius(0.012), None);
    assert_eq!(refused_with_radius(0.0119).as_deref(), Some("gate \"pipe\".position_m"));
    // Of the box as long as wide the edges are the farthest out.
    scene.powder.fill_shape = FillShape::Box;
    let mut refused_with_radius = |inner_radius_m| {
        scene.gates = vec![pipe(inner_radius_m)];
        refused_field(&scene)
    };
    assert_eq!(refused_with_radius(0.017), None);
    assert_eq!(refused_with_radius(0.0169).as_deref(), Some("gate \"pipe\".position_m"));
    // Beside it, and above it.
    scene.gates = vec![pipe(0.004)];
    assert_eq!(refused_field(&scene).as_deref(), Some("gate \"pipe\".position_m"));
    scene.gates[0].position_m = [0.080, 0.048, 0.004];
    assert_eq!(refused_field(&scene), None);
    scene.gates[0].position_m = [0.080, 0.048, 0.026];
    assert_eq!(refused_field(&scene), None);
}

#[test]
fn a_plate_touches_a_column_but_does_not_cut_into_it() {
    let mut scene = column();
    let plate = |yaw_deg: f64, off_m: f64| {
        let (sin, cos) = yaw_deg.to_radians().sin_cos();
        Gate {
            position_m: [0.056 + off_m * cos, 0.048 + off_m * sin, 0.004],
            yaw_deg,
            shape: GateShape::Box { size_m: [0.004, 0.024, 0.024] },
            ..pipe(0.0)
        }
    };
    for yaw_deg in [0.0, 30.0, 77.0] {
        scene.gates = vec![plate(yaw_deg, 0.014 + 1e-9)];
        assert_eq!(refused_field(&scene), None, "{yaw_deg}");
        scene.gates = vec![plate(yaw_deg, 0.0139)];
        assert_eq!(refused_field(&scene).as_deref(), Some("gate \"pipe\".position_m"), "{yaw_deg}");
    }
}

#[test]
fn shut_gates_may_lie_in_walls_and_in_each_other_and_slide_out_of_the_domain() {
    let mut scene = column();
    let plate = Gate {
        name: "slide".into(),
        position_m: [0.086, 0.048, 0.004],
        shape: GateShape::Box { size_m: [0.012, 0.080, 0.004] },
        opening: GateOpening::Slide { velocity_m_s: [0.0, 2.0, 0.0], travel_m: 1.0 },
        yaw_deg: 0.0,
        ..pipe(0.0)
    };
    scene.gates = vec![pipe(0.024), plate];
    assert_eq!(refused_field(&scene), None);
}

/// The hopper of the guide over the target of `bench`: 24 mm inside, a cone of 27.7 mm, a hole of 8 mm at a height of 124 mm.
fn with_hopper() -> SceneSpec {
    let mut scene = bench();
    scene.arm = None;
    scene.containers.push(Container {
        name: "hopper".into(),
        position_m: [0.176, 0.048, 0.124],
        yaw_deg: 0.0,
        wall_thickness_m: 0.004,
        friction: 0.4,
        shape: ContainerShape::Hopper {
            inner_radius_m: 0.024,
            inner_height_m: 0.060,
            outlet_radius_m: 0.008,
            half_angle_deg: 30.0,
        },
    });
    scene
}

#[test]
fn powder_starts_in_a_cone_as_far_out_as_there_is_room() {
    let refused = |radius_m: f64, low_m: f64, high_m: f64| {
        let mut scene = with_hopper();
        scene.powder.fill_shape = FillShape::Cylinder;
        scene.powder.fill_min_m = [0.176 - radius_m, 0.048 - radius_m, low_m];
        scene.powder.fill_max_m = [0.176 + radius_m, 0.048 + radius_m, high_m];
        scene.validate_as("scene").err().map(|error| error.to_string())
    };
    // 16 mm above the hole there is room for 17.24 mm.
    assert_eq!(refused(0.0172, 0.140, 0.180), None);
    let sentence = refused(0.0174, 0.140, 0.180).unwrap();
    assert!(
        sentence.contains("that column goes 0.00014 m into the cone of container \"hopper\""),
        "{sentence}"
    );
    // Heaped above the rim; from the hole on; and from below it.
    assert_eq!(refused(0.0172, 0.140, 0.195), None);
    assert_eq!(refused(0.0079, 0.124, 0.180), None);
    let sentence = refused(0.0079, 0.110, 0.180).unwrap();
    assert!(sentence.contains("into the cone of container \"hopper\""), "{sentence}");
    // In the cylinder it is the wall that counts.
    assert_eq!(refused(0.0239, 0.152, 0.180), None);
    let sentence = refused(0.0245, 0.152, 0.180).unwrap();
    assert!(sentence.contains("wall of container \"hopper\""), "{sentence}");
}

#[test]
fn a_funnel_may_stand_in_the_mouth_of_another_container() {
    let refused = |low_m: f64, inner_height_m: f64| {
        let mut scene = with_hopper();
        let ContainerShape::Hopper { inner_height_m: height, .. } = &mut scene.containers[2].shape else {
            panic!("a hopper")
        };
        *height = inner_height_m;
        scene.containers[1].shape = ContainerShape::Cylinder { inner_radius_m: 0.016, inner_height_m: 0.040 };
        scene.containers[2].position_m[2] = low_m;
        refused_field(&scene)
    };
    // The vial's rim is at 44 mm, and its inner edge 16 mm from the axis; the cone is as wide outside 5.86 mm above the hole.
    for height in [0.060, 0.02771] {
        assert_eq!(refused(0.0392, height), None);
        assert_eq!(refused(0.0377, height).as_deref(), Some("container \"hopper\".position_m"));
    }
}

#[test]
fn a_tool_keeps_out_of_a_cone() {
    // Its cone ends at a height of 52.5 mm, and the deepest scoop is 20 mm below the powder's surface.
    let refused = |surface_m: f64| {
        let mut scene = with_hopper();
        scene.containers.swap_remove(0);
        let source = &mut scene.containers[0];
        source.name = "source".into();
        source.position_m = [0.056, 0.048, 0.004];
        if let ContainerShape::Hopper { inner_radius_m, inner_height_m, .. } = &mut source.shape {
            (*inner_radius_m, *inner_height_m) = (0.036, 0.080);
        }
        scene.powder.fill_shape = FillShape::Cylinder;
        scene.powder.fill_min_m = [0.028, 0.020, 0.0525];
        scene.powder.fill_max_m = [0.084, 0.076, surface_m];
        scene.tool.start_position_m[2] = surface_m + 0.040;
        scene.validate_as("scene").err().map(|error| error.to_string()).unwrap_or_default()
    };
    let sentence = refused(0.070);
    let about = "would go 0.0025 m below the upper end of the cone of container \"source\"";
    assert!(sentence.contains(about), "{sentence}");
    let sentence = refused(0.0726);
    assert!(!sentence.contains("cone"), "{sentence}");
}
