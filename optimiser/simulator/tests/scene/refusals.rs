//! Every bad scene is refused with one sentence that names the file, the field, its value and what would be right.

use powderline_simulator::scene::{Profile, Scene, SceneError, SceneSpec};

/// The valid scene that every case spoils in one place.
const BASE: &str = include_str!("base.toml");

/// What replaces what in `base.toml`, and the refusal after the file's name.
type Case = (&'static str, &'static str, &'static str);

fn base() -> SceneSpec {
    Scene::from_toml("base.toml", BASE).unwrap().into_spec()
}

fn refusal(text: &str) -> String {
    Scene::from_toml("bad.toml", text).expect_err("the scene should be refused").to_string()
}

fn check_all(cases: &[Case]) {
    check_all_of(BASE, cases);
}

fn check_all_of(base: &str, cases: &[Case]) {
    for (from, to, expected) in cases {
        assert!(base.contains(from), "base.toml does not hold {from}");
        let found = refusal(&base.replacen(from, to, 1));
        assert_eq!(found, format!("bad.toml{expected}"), "after {to}");
    }
}

/// What is not TOML, or not the shape of a scene.
#[rustfmt::skip]
const STRUCTURE: &[Case] = &[
    (
        "youngs_modulus_pa = 1.0e4",
        "youngs_modulus = 1.0e4",
        ": powder.youngs_modulus at line 18: unknown field `youngs_modulus`; did you mean `youngs_modulus_pa`? Possible are `fill_min_m`, `fill_max_m`, `fill_shape`, `particles_per_cell`, `seed`, `youngs_modulus_pa`, `poissons_ratio`, `density_kg_m3`, `friction_angle_deg`, `flow`, `yield`, `volume_correction`, `loosening_strain`, `transfer`, `cohesion_pa`, `tensile_strength_pa`, `viscosity_pa_s`",
    ),
    (
        "yield = \"drucker_prager\"",
        "yield = \"matsuoka\"",
        ": powder.yield at line 22: unknown variant `matsuoka`; did you mean `matsuoka_nakai`? Possible are `drucker_prager`, `matsuoka_nakai`",
    ),
    (
        "cohesion_pa = 0.0\n",
        "#",
        ": powder at line 13: missing field `cohesion_pa`; in the scene `bench` it is: cohesion_pa = 0.0 # Mohr-Coulomb cohesion; 0 (dry) to 1e5",
    ),
    (
        "youngs_modulus_pa = 1.0e4",
        r#"youngs_modulus_pa = "soft""#,
        r#": powder.youngs_modulus_pa at line 18: invalid type: string "soft", expected a number"#,
    ),
    (
        "youngs_modulus_pa = 1.0e4",
        "youngs_modulus_pa = ",
        " is not valid TOML at line 18, column 21: string values must be quoted, expected literal string",
    ),
    (
        "youngs_modulus_pa = 1.0e4",
        "youngs_modulus_pa = 1.0e4\nyoungs_modulus_pa = 1.0e4",
        " is not valid TOML at line 19, column 1: duplicate key",
    ),
    (
        "youngs_modulus_pa = 1.0e4",
        "youngs_modulus_pa = 1.0e999",
        ": powder.youngs_modulus_pa at line 18: number too large, expected at most 1.79e308",
    ),
    (
        "substeps = 20",
        "substeps = -20",
        ": time.substeps at line 29: invalid value: integer `-20`, expected a whole number from 0 to 4294967295",
    ),
    (
        "substeps = 20",
        "substeps = 20.5",
        ": time.substeps at line 29: invalid type: floating point `20.5`, expected a whole number from 0 to 4294967295",
    ),
    (
        "seed = 1",
        "seed = 18446744073709551616",
        ": powder.seed at line 17: invalid type: integer `18446744073709551616`, expected a whole number from 0 to 18446744073709551615",
    ),
    (
        "size_m = [0.256, 0.096, 0.208]",
        "size_m = [0.256, 0.096]",
        ": domain.size_m at line 6: invalid length 2, expected a list of 3",
    ),
    (
        "size_m = [0.256, 0.096, 0.208]",
        "size_m = [0.256, 0.096, 0.208, 1.0]",
        ": domain.size_m at line 6: invalid length 4, expected a list of 3",
    ),
    (
        "size_m = [0.256, 0.096, 0.208]",
        "size_m = [0.256, true, 0.208]",
        ": domain.size_m[1] at line 6: invalid type: boolean `true`, expected a number",
    ),
    (
        "size_m = [0.256, 0.096, 0.208]",
        "size_m = 0.256",
        ": domain.size_m at line 6: invalid type: floating point `0.256`, expected a list of 3",
    ),
    (
        r#"shape = { kind = "box", inner_size_m = [0.064, 0.064, 0.030] }"#,
        r#"shape = { kind = "sphere" }"#,
        r#": container "source".shape.kind at line 39: unknown variant `sphere`, expected one of `box`, `cylinder`, `silo`, `hopper`, `slotted_box`"#,
    ),
    (
        r#"shape = { kind = "box", inner_size_m = [0.064, 0.064, 0.030] }"#,
        r#"shape = { kind = "box" }"#,
        r#": container "source".shape at line 39: missing field `inner_size_m`; in the scene `bench` it is: shape = { kind = "box", inner_size_m = [0.064, 0.064, 0.030] } # each at least one cell, at most 10"#,
    ),
    (
        r#"shape = { kind = "box", inner_size_m = [0.064, 0.064, 0.030] }"#,
        r#"shape = "box""#,
        r#": container "source".shape at line 39: invalid type: string "box", expected a table with a `kind`; in the scene `bench` it is: shape = { kind = "box", inner_size_m = [0.064, 0.064, 0.030] } # each at least one cell, at most 10"#,
    ),
    (
        r#"shape = { kind = "box", inner_size_m = [0.064, 0.064, 0.030] }"#,
        r#"shape = { kind = "box", inner_size_m = [0.064, 0.064, 0.030], lid = true }"#,
        r#": container "source".shape at line 39: unknown field `lid`, expected `inner_size_m`"#,
    ),
    (
        r#"timing = "continuous""#,
        r#"timing = "exact""#,
        ": skill.timing at line 73: unknown variant `exact`, expected `rounded` or `continuous`",
    ),
    (
        "norm = \"euclidean\"",
        "norm = \"euclidian\"",
        ": objective.norm at line 92: unknown variant `euclidian`; did you mean `euclidean`? Possible are `euclidean`, `l1`",
    ),
    (
        r#"aim = "amount""#,
        r#"aim = "amout""#,
        ": objective.aim at line 91: unknown variant `amout`; did you mean `amount`? Possible are `amount`, `all`",
    ),
    (
        r#"shape = { kind = "bowl", inner_radius_m = 0.016 }"#,
        r#"shape = { kind = "bowll", inner_radius_m = 0.016 }"#,
        ": tool.shape.kind at line 50: unknown variant `bowll`; did you mean `bowl`? Possible are `bowl`, `box_scoop`, `cuboids`",
    ),
    (
        r#"shape = { kind = "bowl", inner_radius_m = 0.016 }"#,
        r#"shape = "bowll""#,
        r#": tool.shape at line 50: invalid type: string "bowll", expected a table with a `kind`; in the scene `bench` it is: shape = { kind = "bowl", inner_radius_m = 0.016 } # hemisphere; at least one cell, at most 1"#,
    ),
    (
        "amount = { particles = 850 }",
        "amount = 850",
        ": objective.amount at line 90: invalid type: integer `850`, expected a table",
    ),
    (
        "cohesion_pa = 0.0",
        "cell_m = 0.004",
        ": powder.cell_m at line 24: unknown field `cell_m`; that key belongs into [domain]",
    ),
    (
        "amount = { particles = 850 }",
        "amount = { particles = 850, mass_kg = 1.0 }",
        ": objective.amount at line 90: both `mass_kg` and `particles` are given; one of them would be right",
    ),
    (
        "amount = { particles = 850 }",
        "amount = { grains = 850 }",
        ": objective.amount.grains at line 90: unknown field `grains`, expected one of `mass_kg`, `particles`, `tolerance`",
    ),
    (
        "[objective]",
        "[objectives]",
        ": objectives at line 86: unknown field `objectives`; did you mean `objective`? Possible are `name`, `domain`, `powder`, `time`, `container`, `gate`, `tool`, `skill`, `limits`, `arm`, `objective`",
    ),
    (
        "[objective]",
        "[objective",
        " is not valid TOML at line 86, column 11: unclosed table, expected `]`",
    ),
    (
        "[objective]",
        "[optimiser]\nepochs = 10\n\n[objective]",
        ": optimiser at line 86: a scene no longer says how it is searched; without this table it would be right, and `optimise run --help` says what can be chosen instead",
    ),
    (
        "[tool]",
        "[[tool]]",
        ": tool at line 49: invalid type: a list, expected a single table",
    ),
    (
        "[domain]",
        "domain = 3\n[other]",
        ": domain at line 5: invalid type: integer `3`, expected a table",
    ),
];

/// One number or name out of its range.
#[rustfmt::skip]
const SINGLE_FIELDS: &[Case] = &[
    (
        r#"name = "base""#,
        r#"name = """#,
        r#": name is "", but it must have 1 to 64 printable characters"#,
    ),
    (
        r#"name = "base""#,
        r#"name = "a\tb""#,
        r#": name is "a\tb", but it must have 1 to 64 printable characters"#,
    ),
    (
        "cell_m = 0.004",
        "cell_m = nan",
        ": domain.cell_m is nan, but it must be from 0.0001 to 0.1",
    ),
    (
        "cell_m = 0.004",
        "cell_m = inf",
        ": domain.cell_m is inf, but it must be from 0.0001 to 0.1",
    ),
    (
        "cell_m = 0.004",
        "cell_m = -0.004",
        ": domain.cell_m is -0.004, but it must be from 0.0001 to 0.1",
    ),
    (
        "cell_m = 0.004",
        "cell_m = 0.0",
        ": domain.cell_m is 0, but it must be from 0.0001 to 0.1",
    ),
    (
        "cell_m = 0.004",
        "cell_m = 1e300",
        ": domain.cell_m is 1e300, but it must be from 0.0001 to 0.1",
    ),
    (
        "cell_m = 0.004",
        "cell_m = 4",
        ": domain.cell_m is 4, but it must be from 0.0001 to 0.1; did you mean metres, that is 0.004?",
    ),
    (
        "size_m = [0.256, 0.096, 0.208]",
        "size_m = [256, 96, 208]",
        ": domain.size_m[0] is 256, but it must be from 0.01 to 10; did you mean metres, that is 0.256?",
    ),
    (
        "position_m = [0.176, 0.048, 0.004]",
        "position_m = [176, 48, 4]",
        r#": container "target".position_m[0] is 176, but it must be from -10 to 10; did you mean metres, that is 0.176?"#,
    ),
    (
        "lift_height_m = [0.020, 0.090]",
        "lift_height_m = [20.0, 90.0]",
        ": skill.lift_height_m[0] is 20, but it must be from 0.001 to 5; did you mean metres, that is 0.02?",
    ),
    (
        "linear_velocity_m_s = 0.3",
        "linear_velocity_m_s = 300.0",
        ": limits.linear_velocity_m_s is 300, but it must be from 0.001 to 100",
    ),
    (
        "size_m = [0.256, 0.096, 0.208]",
        "size_m = [0.256, 0.096, -inf]",
        ": domain.size_m[2] is -inf, but it must be from 0.01 to 10",
    ),
    (
        "gravity_m_s2 = [0.0, 0.0, -9.81]",
        "gravity_m_s2 = [0.0, 0.0, -981.0]",
        ": domain.gravity_m_s2[2] is -981, but it must be from -100 to 100",
    ),
    (
        "contact_band_cells = 0.25",
        "contact_band_cells = 0.0",
        ": domain.contact_band_cells is 0, but it must be from 0.01 to 2",
    ),
    (
        "contact_band_cells = 0.25",
        "contact_band_cells = 0.25\nwalls = \"two_side\"",
        ": domain.walls at line 11: unknown variant `two_side`; did you mean `two_sided`? Possible are `shared`, `two_sided`",
    ),
    (
        "sleep_speed_m_s = 0.0002",
        "sleep_speed_m_s = 0.2",
        ": domain.sleep_speed_m_s is 0.2, but it must be from 0 to 0.01",
    ),
    (
        "sleep_speed_m_s = 0.0002",
        "sleep_speed_m_s = 0.0002\nsleep_by = \"mean\"",
        ": domain.sleep_by at line 12: unknown variant `mean`; did you mean `mean_square`? Possible are `largest`, `mean_square`",
    ),
    (
        "sleep_speed_m_s = 0.0002",
        "sleep_speed_m_s = 0.0002\nsleepers = \"sitll\"",
        ": domain.sleepers at line 12: unknown variant `sitll`; did you mean `still`? Possible are `moving`, `still`",
    ),
    (
        "particles_per_cell = 8",
        "particles_per_cell = 0",
        ": powder.particles_per_cell is 0, but it must be from 1 to 64",
    ),
    (
        "youngs_modulus_pa = 1.0e4",
        "youngs_modulus_pa = -1.0e4",
        ": powder.youngs_modulus_pa is -10000, but it must be from 100 to 1e9",
    ),
    (
        "youngs_modulus_pa = 1.0e4",
        "youngs_modulus_pa = nan",
        ": powder.youngs_modulus_pa is nan, but it must be from 100 to 1e9",
    ),
    (
        "youngs_modulus_pa = 1.0e4",
        "youngs_modulus_pa = 7.0e10",
        ": powder.youngs_modulus_pa is 7e10, but it must be from 100 to 1e9",
    ),
    (
        "poissons_ratio = 0.2",
        "poissons_ratio = 0.5",
        ": powder.poissons_ratio is 0.5, but it must be from 0 to 0.49",
    ),
    (
        "density_kg_m3 = 1000.0",
        "density_kg_m3 = 0.0",
        ": powder.density_kg_m3 is 0, but it must be from 10 to 25000",
    ),
    // No length, though its name ends like one's.
    (
        "density_kg_m3 = 1000.0",
        "density_kg_m3 = 1e5",
        ": powder.density_kg_m3 is 100000, but it must be from 10 to 25000",
    ),
    (
        "friction_angle_deg = 35.0",
        "friction_angle_deg = 90.0",
        ": powder.friction_angle_deg is 90, but it must be from 0 to 60",
    ),
    (
        "friction_angle_deg = 35.0",
        "friction_angle_deg = 40.0",
        ": powder.friction_angle_deg is 40, but a Drucker-Prager cone that steep carries tension in triaxial extension; at most 36.8 would be right, or powder.yield = \"matsuoka_nakai\"",
    ),
    (
        "cohesion_pa = 0.0",
        "cohesion_pa = -1.0",
        ": powder.cohesion_pa is -1, but it must be from 0 to 100000",
    ),
    (
        "cohesion_pa = 0.0",
        "cohesion_pa = 7.0\ntensile_strength_pa = 12.0",
        ": powder.tensile_strength_pa is 12, but with this cohesion and friction angle the apex of the yield surface is at a tension of 9.997; at most that would be right",
    ),
    (
        "cohesion_pa = 0.0",
        "cohesion_pa = 7.0\ntensile_strength_pa = -1.0",
        ": powder.tensile_strength_pa is -1, but it must be from 0 to 1e7",
    ),
    (
        "cohesion_pa = 0.0",
        "cohesion_pa = 0.0\nflow = { grain_diameter_m = 0.5, grain_density_kg_m3 = 1667.0 }",
        ": powder.flow.grain_diameter_m is 0.5, but it must be from 1e-6 to 0.01; did you mean metres, that is 0.0005?",
    ),
    (
        "cohesion_pa = 0.0",
        "cohesion_pa = 0.0\nflow = { grain_diameter_m = 0.0005, grain_density_kg_m3 = 0.0 }",
        ": powder.flow.grain_density_kg_m3 is 0, but it must be from 10 to 25000",
    ),
    (
        "friction_angle_deg = 35.0",
        "friction_angle_deg = 36.0\nflow = { grain_diameter_m = 0.0005, grain_density_kg_m3 = 1667.0 }",
        ": powder.friction_angle_deg is 36, but a Drucker-Prager cone that steep, and with powder.flow steeper at rest, carries tension in triaxial extension; at most 35.2 would be right, or powder.yield = \"matsuoka_nakai\"",
    ),
    (
        "cohesion_pa = 0.0",
        "cohesion_pa = 0.0\nloosening_strain = 0.0",
        ": powder.loosening_strain is 0, but it must be from 0.001 to 100",
    ),
    (
        "cohesion_pa = 0.0",
        "cohesion_pa = 0.0\nloosening_strain = 101.0",
        ": powder.loosening_strain is 101, but it must be from 0.001 to 100",
    ),
    (
        "cohesion_pa = 0.0",
        "cohesion_pa = 0.0\nloosening_strain = 1.0",
        ": powder.loosening_strain is 1, but with powder.volume_correction = \"strain\" nothing is loosened; powder.volume_correction = \"grid\" would be right, or no such key",
    ),
    (
        "cohesion_pa = 0.0",
        "cohesion_pa = 0.0\ntransfer = { residue_time_s = 0.0 }",
        ": powder.transfer.residue_time_s is 0, but it must be from 0.0001 to 10",
    ),
    (
        "cohesion_pa = 0.0",
        "cohesion_pa = 0.0\ntransfer = { residue_time_ms = 50 }",
        ": powder.transfer.residue_time_ms at line 25: unknown field `residue_time_ms`; did you mean `residue_time_s`?",
    ),
    (
        "viscosity_pa_s = 0.08",
        "viscosity_pa_s = -0.1",
        ": powder.viscosity_pa_s is -0.1, but it must be from 0 to 100",
    ),
    (
        "viscosity_pa_s = 0.08",
        "viscosity_pa_s = 10.0",
        ": powder.viscosity_pa_s is 10, but 8 * viscosity * dt_sub / (density * cell^2) is then 2.5 and must be at most 0.5; at most 2 would be right",
    ),
    (
        "control_period_us = 10000",
        "control_period_us = 0",
        ": time.control_period_us is 0, but it must be from 100 to 100000",
    ),
    (
        "substeps = 20",
        "substeps = 0",
        ": time.substeps is 0, but it must be from 1 to 10000",
    ),
    (
        "horizon_steps = 500",
        "horizon_steps = 100001",
        ": time.horizon_steps is 100001, but it must be from 1 to 100000",
    ),
    (
        "settle_s = 0.2",
        "settle_s = -0.2",
        ": time.settle_s is -0.2, but it must be from 0 to 60",
    ),
    (
        "wall_thickness_m = 0.004",
        "wall_thickness_m = 0.0015",
        r#": container "source".wall_thickness_m is 0.0015, but it must be at least half a cell, 0.002 for domain.cell_m = 0.004"#,
    ),
    (
        r#"shape = { kind = "bowl", inner_radius_m = 0.016 }"#,
        r#"shape = { kind = "cuboids", cuboid = [] }"#,
        ": tool.shape.cuboid is 0 cuboids, but 1 to 64 cuboids would be right",
    ),
    (
        r#"shape = { kind = "bowl", inner_radius_m = 0.016 }"#,
        r#"shape = { kind = "cuboids", cuboid = [{ centre_m = [0, 0, 0], size_m = [0.02, 0.02, 0.001] }] }"#,
        ": tool.shape.cuboid[0].size_m is 0.001, but it must be at least half a cell, 0.002 for domain.cell_m = 0.004",
    ),
    (
        r#"shape = { kind = "bowl", inner_radius_m = 0.016 }"#,
        r#"shape = { kind = "cuboids", cuboid = [{ centre_m = [0, 0, 2], size_m = [0.02, 0.02, 0.004] }] }"#,
        ": tool.shape.cuboid[0].centre_m[2] is 2, but it must be from -1 to 1; did you mean metres, that is 0.002?",
    ),
    (
        r#"shape = { kind = "bowl", inner_radius_m = 0.016 }"#,
        r#"shape = { kind = "cuboids", cuboid = [{ centre_m = [0, 0, 0], size_m = [0.02, 0.02, 0.004], turned_deg = 3 }] }"#,
        ": tool.shape at line 50: unknown field `turned_deg`, expected one of `centre_m`, `size_m`, `rotation_deg`",
    ),
    (
        "inner_radius_m = 0.016 }\nwall_thickness_m = 0.004",
        "inner_radius_m = 0.016 }\nwall_thickness_m = 0.0",
        ": tool.wall_thickness_m is 0, but it must be above 0 and at most 1",
    ),
    (
        r#"shape = { kind = "box", inner_size_m = [0.064, 0.064, 0.030] }"#,
        r#"shape = { kind = "silo", inner_radius_m = 0.032, inner_height_m = 0.030, outlet_radius_m = 0.033 }"#,
        r#": container "source".shape.outlet_radius_m is 0.033, but it must be from 0.004 to 0.032"#,
    ),
    (
        r#"shape = { kind = "box", inner_size_m = [0.064, 0.064, 0.030] }"#,
        r#"shape = { kind = "silo", inner_radius_m = 0.032, inner_height_m = 0.030, outlet_radius_m = 0.003 }"#,
        r#": container "source".shape.outlet_radius_m is 0.003, but it must be from 0.004 to 0.032"#,
    ),
    (
        r#"shape = { kind = "box", inner_size_m = [0.064, 0.064, 0.030] }"#,
        r#"shape = { kind = "hopper", inner_radius_m = 0.032, inner_height_m = 0.030, outlet_radius_m = 0.030, half_angle_deg = 45 }"#,
        r#": container "source".shape.outlet_radius_m is 0.03, but it must be from 0.004 to 0.028"#,
    ),
    (
        r#"shape = { kind = "box", inner_size_m = [0.064, 0.064, 0.030] }"#,
        r#"shape = { kind = "hopper", inner_radius_m = 0.032, inner_height_m = 0.030, outlet_radius_m = 0.012, half_angle_deg = 90 }"#,
        r#": container "source".shape.half_angle_deg is 90, but it must be from 5 to 85"#,
    ),
    (
        r#"shape = { kind = "box", inner_size_m = [0.064, 0.064, 0.030] }"#,
        r#"shape = { kind = "hopper", inner_radius_m = 0.032, inner_height_m = 0.019, outlet_radius_m = 0.012, half_angle_deg = 45 }"#,
        r#": container "source".shape.inner_height_m is 0.019, but it must be from 0.02 to 10"#,
    ),
    (
        r#"shape = { kind = "box", inner_size_m = [0.064, 0.064, 0.030] }"#,
        r#"shape = { kind = "slotted_box", inner_size_m = [0.064, 0.064, 0.030], slot_width_m = 0.065 }"#,
        r#": container "source".shape.slot_width_m is 0.065, but it must be from 0.004 to 0.064"#,
    ),
    (
        r#"shape = { kind = "box", inner_size_m = [0.064, 0.064, 0.030] }"#,
        r#"shape = { kind = "box", inner_size_m = [0.064, 0.064, 0.0] }"#,
        r#": container "source".shape.inner_size_m[2] is 0, but it must be from 0.004 to 10"#,
    ),
    (
        r#"shape = { kind = "box", inner_size_m = [0.064, 0.064, 0.030] }"#,
        r#"shape = { kind = "cylinder", inner_radius_m = -0.032, inner_height_m = 0.030 }"#,
        r#": container "source".shape.inner_radius_m is -0.032, but it must be from 0.004 to 10"#,
    ),
    (
        "yaw_deg = 0.0",
        "yaw_deg = 1000.0",
        r#": container "source".yaw_deg is 1000, but it must be from -360 to 360"#,
    ),
    (
        "inner_radius_m = 0.016 }",
        "inner_radius_m = 0.001 }",
        ": tool.shape.inner_radius_m is 0.001, but it must be from 0.004 to 1",
    ),
    (
        r#"shape = { kind = "bowl", inner_radius_m = 0.016 }"#,
        r#"shape = { kind = "box_scoop", inner_size_m = [0.030, 0.003, 0.016] }"#,
        ": tool.shape.inner_size_m[1] is 0.003, but it must be from 0.004 to 1",
    ),
    (
        "start_pitch_deg = 50.0",
        "start_pitch_deg = 91.0",
        ": tool.start_pitch_deg is 91, but it must be from -90 to 90",
    ),
    (
        "length_m = 0.05",
        "length_m = 0.0",
        ": tool.handle.length_m is 0, but it must be from 0.001 to 1",
    ),
    (
        "radius_m = 0.004",
        "radius_m = 0.0009",
        ": tool.handle.radius_m is 0.0009, but it must be from 0.001 to 0.1",
    ),
    (
        "rise_deg = 75.0",
        "rise_deg = nan",
        ": tool.handle.rise_deg is nan, but it must be from -90 to 90",
    ),
    (
        "scooping_depth_m = [0.002, 0.020]",
        "scooping_depth_m = [0.020, 0.002]",
        ": skill.scooping_depth_m is [0.02, 0.002], but the first number must not exceed the second",
    ),
    (
        "scooping_angle_deg = [10.0, 100.0]",
        "scooping_angle_deg = [0.0, 100.0]",
        ": skill.scooping_angle_deg[0] is 0, but it must be from 1 to 180",
    ),
    (
        "initial_theta = [[-0.5, 0.5], [-0.5, 0.5]",
        "initial_theta = [[-0.5, 0.5], [-1.5, 0.5]",
        ": skill.initial_theta[1][0] is -1.5, but it must be from -1 to 1",
    ),
    (
        "initial_theta = [[-0.5, 0.5], [-0.5, 0.5]",
        "initial_theta = [[-0.5, 0.5], [0.5, -0.5]",
        ": skill.initial_theta[1] is [0.5, -0.5], but the first number must not exceed the second",
    ),
    (
        "linear_speed_m_s = 0.14",
        "linear_speed_m_s = 0.0",
        ": skill.linear_speed_m_s is 0, but it must be from 0.001 to 5",
    ),
    (
        "angular_speed_rad_s = 1.6",
        "angular_speed_rad_s = inf",
        ": skill.angular_speed_rad_s is inf, but it must be from 0.01 to 50",
    ),
    (
        "linear_jerk_m_s3 = 600.0",
        "linear_jerk_m_s3 = 0.0",
        ": limits.linear_jerk_m_s3 is 0, but it must be from 0.001 to 1e7",
    ),
    (
        "pouring_angle_deg = [30.0, 160.0]",
        "pouring_angle_deg = [30.0, 360.0]",
        ": skill.pouring_angle_deg[1] is 360, but it must be from 1 to 180",
    ),
];

/// Fields at odds with each other.
#[rustfmt::skip]
const RULES_BETWEEN_FIELDS: &[Case] = &[
    (
        "youngs_modulus_pa = 1.0e4",
        "youngs_modulus_pa = 1.0e5",
        ": powder.youngs_modulus_pa is 100000, but the CFL number sqrt(P-wave modulus / density) * dt_sub / cell is then 1.32 and must be at most 0.5; time.substeps of at least 53 or powder.youngs_modulus_pa of at most 14400 would be right",
    ),
    (
        "substeps = 20",
        "substeps = 10",
        ": powder.youngs_modulus_pa is 10000, but the CFL number sqrt(P-wave modulus / density) * dt_sub / cell is then 0.833 and must be at most 0.5; time.substeps of at least 17 or powder.youngs_modulus_pa of at most 3600 would be right",
    ),
    (
        "cell_m = 0.004",
        "cell_m = 0.0002",
        ": domain.cell_m is 0.0002, but that makes 6.79e8 grid cells, padding included, and at most 67108864 are allowed; about 0.0005 would be right",
    ),
    (
        "size_m = [0.256, 0.096, 0.208]",
        "size_m = [10.0, 10.0, 10.0]",
        ": domain.cell_m is 0.004, but that makes 1.59e10 grid cells, padding included, and at most 67108864 are allowed; about 0.028 would be right",
    ),
    (
        "fill_max_m = [0.088, 0.080, 0.026]",
        "fill_max_m = [0.088, 0.080, 0.004]",
        ": powder.fill_max_m is [0.088, 0.08, 0.004], but it must exceed powder.fill_min_m = [0.024, 0.016, 0.004] in every component",
    ),
    (
        "fill_max_m = [0.088, 0.080, 0.026]",
        "fill_max_m = [0.0241, 0.0161, 0.0041]",
        ": powder.fill_max_m is [0.0241, 0.0161, 0.0041], but the box from powder.fill_min_m to there is smaller than a particle; a larger box would be right",
    ),
    (
        "fill_max_m = [0.088, 0.080, 0.026]",
        "fill_max_m = [0.090, 0.080, 0.026]",
        r#": powder.fill_min_m is [0.024, 0.016, 0.004] and powder.fill_max_m [0.09, 0.08, 0.026], but that box goes 0.002 m into the +x wall of container "source"; clear of it would be right"#,
    ),
    (
        "fill_min_m = [0.024, 0.016, 0.004]",
        "fill_min_m = [0.024, 0.016, 0.003]",
        r#": powder.fill_min_m is [0.024, 0.016, 0.003] and powder.fill_max_m [0.088, 0.08, 0.026], but that box goes 0.001 m into the floor of container "source"; clear of it would be right"#,
    ),
    (
        "fill_max_m = [0.088, 0.080, 0.026]",
        "fill_max_m = [0.088, 0.080, 0.3]",
        ": powder.fill_max_m is [0.088, 0.08, 0.3], but the powder would then reach z = 0.3, outside the domain, which goes from 0 to 0.208",
    ),
    (
        "fill_min_m = [0.024, 0.016, 0.004]",
        "fill_min_m = [-0.024, 0.016, 0.004]",
        ": powder.fill_min_m is [-0.024, 0.016, 0.004], but the powder would then reach x = -0.024, outside the domain, which goes from 0 to 0.256",
    ),
    (
        "position_m = [0.176, 0.048, 0.004]",
        "position_m = [0.120, 0.048, 0.004]",
        r#": container "target".position_m is [0.12, 0.048, 0.004], but there it overlaps container "source" by 0.008 m; they must stand apart"#,
    ),
    (
        "position_m = [0.176, 0.048, 0.004]",
        "position_m = [0.240, 0.048, 0.004]",
        r#": container "target".position_m is [0.24, 0.048, 0.004], but the container would then reach x = 0.276, outside the domain, which goes from 0 to 0.256"#,
    ),
    (
        "position_m = [0.176, 0.048, 0.004]",
        "position_m = [0.176, 0.048, 0.003]",
        r#": container "target".position_m is [0.176, 0.048, 0.003], but the container would then reach z = -0.001, outside the domain, which goes from 0 to 0.208"#,
    ),
    (
        r#"name = "target""#,
        r#"name = "source""#,
        r#": container[1].name is "source", but another container has that name already; every container needs its own"#,
    ),
    (
        r#"source = "source""#,
        r#"source = "sauce""#,
        r#": objective.source is "sauce", but the containers are "source", "target"; did you mean `source`?"#,
    ),
    (
        r#"target = "target""#,
        r#"target = "target box""#,
        r#": objective.target is "target box", but the containers are "source", "target"; did you mean `target`?"#,
    ),
    (
        r#"target = "target""#,
        r#"target = "source""#,
        r#": objective.target is "source", but that is objective.source; the target must be another container"#,
    ),
    (
        "p_target_m = [0.176, 0.048, 0.010]",
        "p_target_m = [0.176, 0.048, -0.010]",
        ": objective.p_target_m is [0.176, 0.048, -0.01], but it must lie in the domain, which goes from [0, 0, 0] to [0.256, 0.096, 0.208]",
    ),
    (
        "p_target_m = [0.176, 0.048, 0.010]",
        "p_target_m = [0.056, 0.048, 0.010]",
        ": objective.p_target_m is [0.056, 0.048, 0.01], but that is inside the source, where too much powder costs nothing; a point in the target container would be right",
    ),
    (
        "amount = { particles = 850 }",
        "amount = { particles = 0 }",
        ": objective.amount.particles is 0, but it must be from 1 to 11264",
    ),
    (
        "amount = { particles = 850 }",
        "amount = { particles = 11265 }",
        ": objective.amount.particles is 11265, but it must be from 1 to 11264",
    ),
    (
        "amount = { particles = 850 }",
        "amount = { mass_kg = 0.1 }",
        ": objective.amount.mass_kg is 0.1, but the scene holds no more than 0.09011 kg of powder",
    ),
    (
        "amount = { particles = 850 }",
        "amount = { mass_kg = 9.6 }",
        ": objective.amount.mass_kg is 9.6, but the scene holds no more than 0.09011 kg of powder; did you mean kilograms, that is 0.0096?",
    ),
    (
        "amount = { particles = 850 }",
        "amount = { mass_kg = nan }",
        ": objective.amount.mass_kg is nan, but it must be above 0 and at most 1000000",
    ),
    (
        r#"timing = "continuous""#,
        "timing = \"continuous\"\noverlap = 1.5",
        ": skill.overlap is 1.5, but it must be from 0 to 1",
    ),
    (
        "[limits]",
        "[skill.path]\nknots = 0\n[limits]",
        ": skill.path.knots is 0, but it must be from 1 to 64",
    ),
    (
        "[limits]",
        "[skill.path]\nfreedoms = []\n[limits]",
        ": skill.path.freedoms is [], but it must name one freedom or more, each of them once",
    ),
    (
        "[limits]",
        "[skill.path]\nfreedoms = [\"up\", \"yaw\", \"up\"]\n[limits]",
        ": skill.path.freedoms is [\"up\", \"yaw\", \"up\"], but it must name one freedom or more, each of them once",
    ),
    (
        r#"observation = { kind = "all" }"#,
        "observation = { kind = \"all\" }\nlost_weight = -1.0",
        ": objective.lost_weight is -1, but it must be from 0 to 100",
    ),
    (
        r#"observation = { kind = "all" }"#,
        r#"observation = { kind = "subsample", particles = 20000 }"#,
        ": objective.observation.particles is 20000, but it must be from 1 to 11264",
    ),
    (
        r#"observation = { kind = "all" }"#,
        r#"observation = { kind = "visible_from_above", pixel_m = 0.0 }"#,
        ": objective.observation.pixel_m is 0, but it must be from 0.0001 to 0.1",
    ),
    (
        r#"observation = { kind = "all" }"#,
        r#"observation = { kind = "visible_from_above", pixel_m = 0.004 }"#,
        ": objective.aim is \"amount\", but a view from above tells no amount; \"all\" would be right, or an observation that is not visible_from_above",
    ),
    (
        "start_position_m = [0.048, 0.048, 0.066]",
        "start_position_m = [0.010, 0.048, 0.066]",
        ": tool.start_position_m is [0.01, 0.048, 0.066], but the tool would then reach x = -0.01, outside the domain, which goes from 0 to 0.256",
    ),
    (
        "start_position_m = [0.048, 0.048, 0.066]",
        "start_position_m = [0.048, 0.048, 0.180]",
        ": tool.start_position_m is [0.048, 0.048, 0.18], but the tool's handle would then reach z = 0.2418, outside the domain, which goes from 0 to 0.208",
    ),
    (
        "start_position_m = [0.048, 0.048, 0.066]",
        "start_position_m = [0.048, 0.048, 0.040]",
        ": tool.start_position_m is [0.048, 0.048, 0.04], but there the tool overlaps the powder; it must start clear",
    ),
    (
        "start_position_m = [0.048, 0.048, 0.066]",
        "start_position_m = [0.090, 0.048, 0.050]",
        r#": tool.start_position_m is [0.09, 0.048, 0.05], but there the tool overlaps the +x wall of container "source"; it must start clear"#,
    ),
    (
        "approach_m = 0.020",
        "approach_m = 0.025",
        r#": skill.scooping_depth_m is [0.002, 0.02], but at the deepest scoop the tool would go 0.003 m below the floor of container "source"; at most 0.017 would be right"#,
    ),
    (
        "approach_m = 0.020",
        "approach_m = 0.050",
        r#": skill.scooping_depth_m is [0.002, 0.02], but at the deepest scoop the tool would go 0.028 m below the floor of container "source"; a tool.start_position_m that is 0.028 m higher, or a skill.approach_m that is so much shorter, would be right"#,
    ),
    (
        "start_position_m = [0.048, 0.048, 0.066]",
        "start_position_m = [0.038, 0.048, 0.066]",
        r#": tool.start_position_m is [0.038, 0.048, 0.066], but on its way down from there the tool would go 0.006 m into the -x wall of container "source"; a start further inside would be right"#,
    ),
    (
        "sweep_m = 0.016",
        "sweep_m = 0.030",
        r#": skill.sweep_m is 0.03, but while scooping along skill.heading_deg = 0 the tool would go 0.01 m into the +x wall of container "source"; a shorter sweep or a start further back would be right"#,
    ),
    (
        "workspace_max_m = [0.236, 0.076, 0.180]",
        "workspace_max_m = [0.236, 0.010, 0.180]",
        ": limits.workspace_max_m is [0.236, 0.01, 0.18], but it must exceed limits.workspace_min_m = [0.02, 0.02, 0.02] in every component",
    ),
    (
        "workspace_max_m = [0.236, 0.076, 0.180]",
        "workspace_max_m = [0.236, 0.076, 0.130]",
        ": skill.lift_height_m is [0.02, 0.09], but the tool's origin would then be at z = 0.134, outside the limits' workspace, which goes from 0.02 to 0.13",
    ),
    (
        "workspace_max_m = [0.236, 0.076, 0.180]",
        "workspace_max_m = [0.200, 0.076, 0.180]",
        ": skill.transport_displacement_m is [0.06, 0.16], but the tool's origin would then be at x = 0.224, outside the limits' workspace, which goes from 0.02 to 0.2",
    ),
    (
        "workspace_min_m = [0.020, 0.020, 0.020]",
        "workspace_min_m = [0.020, 0.020, 0.030]",
        ": skill.scooping_depth_m is [0.002, 0.02], but the tool's origin would then be at z = 0.026, outside the limits' workspace, which goes from 0.03 to 0.18",
    ),
    (
        "heading_deg = 0.0",
        "heading_deg = 90.0",
        r#": skill.sweep_m is 0.016, but while scooping along skill.heading_deg = 90 the tool would go 0.004 m into the +y wall of container "source"; a shorter sweep or a start further back would be right"#,
    ),
    (
        "yaw_deg = 0.0",
        "yaw_deg = 8.0",
        r#": powder.fill_min_m is [0.024, 0.016, 0.004] and powder.fill_max_m [0.088, 0.08, 0.026], but that box goes 0.0041 m into the +y wall of container "source", turned by 8 degrees; clear of it would be right"#,
    ),
    (
        r#"shape = { kind = "box", inner_size_m = [0.064, 0.064, 0.030] }"#,
        r#"shape = { kind = "cylinder", inner_radius_m = 0.036, inner_height_m = 0.030 }"#,
        r#": powder.fill_min_m is [0.024, 0.016, 0.004] and powder.fill_max_m [0.088, 0.08, 0.026], but that box goes 0.0092 m into the wall of container "source" at 138 degrees from +x; clear of it would be right"#,
    ),
    (
        "transport_displacement_m = [0.060, 0.160]",
        "transport_displacement_m = [0.060, 0.170]",
        ": time.horizon_steps is 500, but that is 5 s and the longest skill within the bounds takes 5.011 s; at least 502 would be right",
    ),
    (
        "lift_height_m = [0.020, 0.090]",
        "lift_height_m = [0.020, 0.190]",
        ": skill.lift_height_m is [0.02, 0.19], but the tool's origin would then be at z = 0.234, outside the limits' workspace, which goes from 0.02 to 0.18",
    ),
    (
        "substeps = 20\nhorizon_steps = 500",
        "substeps = 2000\nhorizon_steps = 100000",
        ": time.substeps is 2000, but with 100020 control steps, settling included, that makes 200040000 substeps and at most 100000000 are allowed; at most 999 would be right",
    ),
    (
        "horizon_steps = 500",
        "horizon_steps = 400",
        ": time.horizon_steps is 400, but that is 4 s and the longest skill within the bounds takes 4.94 s; at least 494 would be right",
    ),
];

/// What `base.toml` gets where gates are spoiled: a plate over the bed that slides away, and a tube in the target.
const GATES: &str = r#"
[[gate]]
name = "lid"
position_m = [0.056, 0.072, 0.030]
yaw_deg = 90.0
friction = 0.4
opens_at_s = 0.5
shape = { kind = "box", size_m = [0.016, 0.048, 0.004] }
opening = { kind = "slide", velocity_m_s = [0.3, 0.0, 0.4], travel_m = 0.05 }

[[gate]]
name = "ring"
position_m = [0.176, 0.048, 0.004]
yaw_deg = 0.0
friction = 0.3
opens_at_s = 0.0
shape = { kind = "tube", inner_radius_m = 0.012, height_m = 0.020, wall_thickness_m = 0.003 }
opening = { kind = "vanish" }
"#;

/// A gate, or the column, that cannot be.
#[rustfmt::skip]
const GATES_AND_COLUMNS: &[Case] = &[
    (
        r#"kind = "tube", inner_radius_m"#,
        r#"kind = "pipe", inner_radius_m"#,
        r#": gate "ring".shape.kind at line 110: unknown variant `pipe`, expected `box` or `tube`"#,
    ),
    (
        r#"opening = { kind = "vanish" }"#,
        r#"opening = "vanish""#,
        r#": gate "ring".opening at line 111: invalid type: string "vanish", expected a table with a `kind`"#,
    ),
    (
        r#"shape = { kind = "box", size_m = [0.016, 0.048, 0.004] }"#,
        r#"shape = 3"#,
        r#": gate "lid".shape at line 101: invalid type: integer `3`, expected a table with a `kind`"#,
    ),
    (
        r#"opening = { kind = "vanish" }"#,
        r#"opening = { kind = "vanish", travel_m = 0.1 }"#,
        r#": gate "ring".opening at line 111: unknown field `travel_m`, there are no fields"#,
    ),
    (
        "[[gate]]\nname = \"lid\"",
        "[gate]\nname = \"lid\"",
        " is not valid TOML at line 104, column 3: duplicate key",
    ),
    (
        "opens_at_s = 0.5
",
        "",
        r#": gate "lid" at line 95: missing field `opens_at_s`"#,
    ),
    (
        r#"name = "ring""#,
        r#"name = """#,
        r#": gate[1].name is "", but it must have 1 to 64 printable characters"#,
    ),
    (
        r#"name = "ring""#,
        r#"name = "lid""#,
        r#": gate[1].name is "lid", but another gate has that name already; every gate needs its own"#,
    ),
    (
        "position_m = [0.056, 0.072, 0.030]",
        "position_m = [56.0, 72.0, 30.0]",
        r#": gate "lid".position_m[0] is 56, but it must be from -10 to 10; did you mean metres, that is 0.056?"#,
    ),
    (
        "yaw_deg = 90.0",
        "yaw_deg = 900.0",
        r#": gate "lid".yaw_deg is 900, but it must be from -360 to 360"#,
    ),
    (
        "friction = 0.3",
        "friction = -0.3",
        r#": gate "ring".friction is -0.3, but it must be from 0 to 2"#,
    ),
    (
        "opens_at_s = 0.5",
        "opens_at_s = -0.5",
        r#": gate "lid".opens_at_s is -0.5, but it must be from 0 to 10000"#,
    ),
    (
        "size_m = [0.016, 0.048, 0.004]",
        "size_m = [0.016, 48.0, 0.004]",
        r#": gate "lid".shape.size_m[1] is 48, but it must be above 0 and at most 10; did you mean metres, that is 0.048?"#,
    ),
    (
        "size_m = [0.016, 0.048, 0.004]",
        "size_m = [0.016, 0.048, 0.001]",
        r#": gate "lid".shape.size_m is 0.001, but it must be at least half a cell, 0.002 for domain.cell_m = 0.004"#,
    ),
    (
        "inner_radius_m = 0.012",
        "inner_radius_m = 0.003",
        r#": gate "ring".shape.inner_radius_m is 0.003, but it must be from 0.004 to 10"#,
    ),
    (
        "height_m = 0.020",
        "height_m = 0.0",
        r#": gate "ring".shape.height_m is 0, but it must be from 0.004 to 10"#,
    ),
    (
        "wall_thickness_m = 0.003",
        "wall_thickness_m = 0.0015",
        r#": gate "ring".shape.wall_thickness_m is 0.0015, but it must be at least half a cell, 0.002 for domain.cell_m = 0.004"#,
    ),
    (
        "velocity_m_s = [0.3, 0.0, 0.4]",
        "velocity_m_s = [0.3, nan, 0.4]",
        r#": gate "lid".opening.velocity_m_s[1] is nan, but it must be from -10 to 10"#,
    ),
    (
        "velocity_m_s = [0.3, 0.0, 0.4]",
        "velocity_m_s = [0.0, 0.0, 0.0]",
        r#": gate "lid".opening.velocity_m_s is [0, 0, 0], but a gate that slides has to move; a velocity, or a gate that vanishes would be right"#,
    ),
    (
        "velocity_m_s = [0.3, 0.0, 0.4]",
        "velocity_m_s = [3.0, 0.0, 4.0]",
        r#": gate "lid".opening.velocity_m_s is [3, 0, 4], but that takes it 0.625 cells in a substep, and more than 0.5 would take it over powder; at most 4 m/s would be right"#,
    ),
    (
        "travel_m = 0.05",
        "travel_m = 0.0",
        r#": gate "lid".opening.travel_m is 0, but it must be above 0 and at most 10"#,
    ),
    (
        "position_m = [0.056, 0.072, 0.030]",
        "position_m = [0.056, 0.092, 0.030]",
        r#": gate "lid".position_m is [0.056, 0.092, 0.03], but the shut gate would then reach y = 0.1, outside the domain, which goes from 0 to 0.096"#,
    ),
    (
        "position_m = [0.056, 0.072, 0.030]",
        "position_m = [0.056, 0.072, 0.020]",
        r#": gate "lid".position_m is [0.056, 0.072, 0.02], but there, shut, it overlaps the powder, a box from [0.024, 0.016, 0.004] to [0.088, 0.08, 0.026]; beside or around it would be right"#,
    ),
    (
        "position_m = [0.056, 0.072, 0.030]",
        "position_m = [0.056, 0.048, 0.080]",
        ": tool.start_position_m is [0.048, 0.048, 0.066], but there the tool overlaps gate \"lid\", which is shut then; it must start clear",
    ),
    (
        "fill_max_m = [0.088, 0.080, 0.026]",
        "fill_max_m = [0.088, 0.076, 0.026]\nfill_shape = \"cylinder\"",
        r#": powder.fill_shape is "cylinder", but the box from powder.fill_min_m to powder.fill_max_m is 0.064 m long in x and 0.06 m in y; the same in both would be right"#,
    ),
    (
        "fill_max_m = [0.088, 0.080, 0.026]",
        "fill_max_m = [0.090, 0.082, 0.026]\nfill_shape = \"cylinder\"",
        r#": powder.fill_min_m is [0.024, 0.016, 0.004] and powder.fill_max_m [0.09, 0.082, 0.026], but that column goes 0.002 m into the +y wall of container "source"; clear of it would be right"#,
    ),
    (
        "fill_max_m = [0.088, 0.080, 0.026]",
        "fill_max_m = [0.088, 0.080, 0.026]\nfill_shape = \"sphere\"",
        ": powder.fill_shape at line 16: unknown variant `sphere`, expected `box` or `cylinder`",
    ),
];

#[test]
fn gates_and_columns_are_refused() {
    let base = format!("{BASE}{GATES}");
    assert_eq!(Scene::from_toml("base.toml", &base).map(|scene| scene.gates.len()), Ok(2));
    check_all_of(&base, GATES_AND_COLUMNS);
}

/// What `base.toml` gets where the arm is spoiled.
const ARM: &str = r#"
[arm]
kind = "ur5e"
base_position_m = [0.26, -0.8, -0.1]
base_rotation_deg = [0.0, 0.0, -90.0]
tool_position_m = [0.0, 0.0, 0.2]
tool_rotation_deg = [90.0, 0.0, -90.0]
posture = { shoulder = "forward", elbow = "up", wrist = "positive" }
table_height_m = -0.1
clearance_m = 0.02
payload_kg = 0.4
"#;

#[rustfmt::skip]
const ARMS: &[Case] = &[
    ("[0.26, -0.8, -0.1]", "[0.26, -800, -0.1]", ": arm.base_position_m[1] is -800, but it must be from -10 to 10; did you mean metres, that is -0.8?"),
    ("[0.0, 0.0, -90.0]", "[0.0, 0.0, nan]", ": arm.base_rotation_deg[2] is nan, but it must be from -360 to 360"),
    ("[0.0, 0.0, 0.2]", "[0.0, 0.0, 2.0]", ": arm.tool_position_m[2] is 2, but it must be from -1 to 1; did you mean metres, that is 0.002?"),
    ("[90.0, 0.0, -90.0]", "[900.0, 0.0, -90.0]", ": arm.tool_rotation_deg[0] is 900, but it must be from -360 to 360"),
    ("table_height_m = -0.1", "table_height_m = 0.1", ": arm.table_height_m is 0.1, but it must be from -10 to 0"),
    ("clearance_m = 0.02", "clearance_m = -0.02", ": arm.clearance_m is -0.02, but it must be from 0 to 1"),
    ("payload_kg = 0.4", "payload_kg = 5.1", ": arm.payload_kg is 5.1, but it must be from 0 to 5"),
    (", wrist = \"positive\"", "", ": arm.posture at line 101: missing field `wrist`; in the scene `bench` it is: posture = { shoulder = \"forward\", elbow = \"up\", wrist = \"positive\" }"),
    ("shoulder = \"forward\"", "shoulder = \"left\"", ": arm.posture.shoulder at line 101: unknown variant `left`, expected `forward` or `backward`"),
];

#[test]
fn arms_are_refused() {
    let base = format!("{BASE}{ARM}");
    assert!(Scene::from_toml("base.toml", &base).is_ok_and(|scene| scene.arm.is_some()));
    check_all_of(&base, ARMS);
    let unknown = refusal(&base.replacen("\"ur5e\"", "\"ur5\"", 1));
    assert!(
        unknown.contains("arm.kind") && unknown.contains("`ur5`; did you mean `ur5e`? Possible are"),
        "{unknown}"
    );
}

#[test]
fn seventeen_gates_are_refused() {
    let mut scene = Scene::from_toml("base.toml", &format!("{BASE}{GATES}")).unwrap().into_spec();
    scene.gates = vec![scene.gates[1].clone(); 17];
    assert_eq!(
        scene.validate_as("bad.toml").unwrap_err().to_string(),
        "bad.toml: gate is a list of 17, but a scene has at most 16 gates"
    );
}

#[test]
fn structure_are_refused() {
    check_all(STRUCTURE);
}

#[test]
fn single_fields_are_refused() {
    check_all(SINGLE_FIELDS);
}

#[test]
fn rules_between_fields_are_refused() {
    check_all(RULES_BETWEEN_FIELDS);
}

#[test]
fn constant_speed_above_the_limit_is_refused() {
    let mut scene = base();
    scene.skill.profile = Profile::ConstantSpeed;
    scene.limits.linear_velocity_m_s = 0.1;
    assert_eq!(
        scene.validate_as("bad.toml").unwrap_err().to_string(),
        "bad.toml: skill.linear_speed_m_s is 0.14, but limits.linear_velocity_m_s = 0.1 allows no more with \
         profile = \"constant_speed\""
    );
}

#[test]
fn constant_speed_that_overlaps_is_refused() {
    let mut scene = base();
    scene.skill.profile = Profile::ConstantSpeed;
    scene.skill.overlap = 0.5;
    assert_eq!(
        scene.validate_as("bad.toml").unwrap_err().to_string(),
        "bad.toml: skill.overlap is 0.5, but with profile = \"constant_speed\" both speeds would add up; 0, or \
         profile = \"minimum_jerk\", would be right"
    );
}

#[test]
fn all_that_is_wrong_is_said_at_once() {
    let mut scene = base();
    scene.powder.density_kg_m3 = -1.0;
    scene.domain.gravity_m_s2 = [f64::NAN, 0.0, -981.0];
    scene.skill.lift_height_m = [0.2, 0.1];
    let several = "bad.toml: domain.gravity_m_s2[0] is nan, but it must be from -100 to 100\n\
                   bad.toml: powder.density_kg_m3 is -1, but it must be from 10 to 25000\n\
                   bad.toml: skill.lift_height_m is [0.2, 0.1], but the first number must not exceed the second";
    assert_eq!(scene.validate_as("bad.toml").unwrap_err().to_string(), several);
    // Rules between fields that do not build on each other.
    let mut scene = base();
    scene.time.substeps = 1;
    scene.powder.viscosity_pa_s = 100.0;
    let error = scene.validate_as("bad.toml").unwrap_err();
    assert!(matches!(&error, SceneError::Several(all) if all.len() == 2), "{error}");
}

#[test]
fn a_scene_without_a_file_goes_by_its_name() {
    let mut scene = base();
    scene.time.settle_s = -1.0;
    let sentence = |spec: SceneSpec| spec.validate().unwrap_err().to_string();
    let right = "time.settle_s is -1, but it must be from 0 to 60";
    assert_eq!(sentence(scene.clone()), format!("scene {:?}: {right}", scene.name));
    scene.name.clear();
    assert!(sentence(scene).starts_with("the scene: name is \"\", but"));
}

#[test]
fn one_container_or_seventeen_are_refused() {
    let base = base();
    for count in [1, 17] {
        let mut scene = base.clone();
        scene.containers = vec![base.containers[0].clone(); count];
        assert_eq!(
            scene.validate_as("bad.toml").unwrap_err().to_string(),
            format!(
                "bad.toml: container is a list of {count}, but a scene has 2 to 16 containers, one of them the \
                 source and one the target"
            )
        );
    }
}

#[test]
fn too_many_particles_are_refused() {
    let mut scene = base();
    scene.domain.cell_m = 0.0006;
    scene.powder.particles_per_cell = 64;
    scene.time.substeps = 400;
    assert_eq!(
        scene.validate_as("bad.toml").unwrap_err().to_string(),
        "bad.toml: domain.cell_m is 0.0006, but that makes 2.67e7 particles and at most 4000000 are allowed; about \
         0.0013 would be right"
    );
}

#[test]
fn text_without_content_is_empty() {
    for text in ["", "\n \t\r\n", "# only a remark\n"] {
        assert_eq!(
            refusal(text),
            "bad.toml is empty; a scene in TOML would be right (`optimise new FILE` writes an example)"
        );
    }
}

#[test]
fn truncated_text_is_refused_at_every_line_and_within() {
    let whole = base().to_toml();
    let body = whole.trim_end();
    // The last line's number stays a number when its end is cut off, so stop before that line.
    let end = body.rfind('\n').unwrap();
    for length in (0..end).filter(|length| body.is_char_boundary(*length)).step_by(7) {
        let sentence = refusal(&body[..length]);
        assert!(sentence.starts_with("bad.toml") && !sentence.contains('\n'), "{length}: {sentence}");
    }
}

#[test]
fn arbitrary_bytes_and_deep_nesting_are_refused_in_one_line() {
    let nested = format!("x = {}", "[".repeat(100_000));
    for text in ["\0\0\0\0", "\u{7f}ELF", "= = =", "[[[[", &nested, "\"a\\u001b[31m\\nb\" = 1"] {
        let sentence = refusal(text);
        assert!(sentence.starts_with("bad.toml") && sentence.len() < 1000, "{sentence}");
        assert!(!sentence.chars().any(char::is_control), "{sentence:?}");
    }
}
