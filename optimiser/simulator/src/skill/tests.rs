use super::*;
use crate::scene::{PathSplines, Profile, Timing};
use powderline_shared::{displacement::pose_at, pose::exp_so3};
use proptest::prelude::*;

const KINDS: [(Timing, Profile); 4] = [
    (Timing::Continuous, Profile::MinimumJerk),
    (Timing::Continuous, Profile::ConstantSpeed),
    (Timing::Rounded, Profile::MinimumJerk),
    (Timing::Rounded, Profile::ConstantSpeed),
];

fn skill(timing: Timing, profile: Profile) -> Skill {
    Skill {
        scooping_depth_m: [0.006, 0.020],
        scooping_angle_deg: [0.0, 100.0],
        lift_height_m: [0.02, 0.09],
        transport_displacement_m: [0.04, 0.16],
        pouring_angle_deg: [20.0, 160.0],
        initial_theta: [[-1.0, 1.0]; 5],
        heading_deg: 0.0,
        approach_m: 0.02,
        sweep_m: 0.03,
        linear_speed_m_s: 0.1,
        angular_speed_rad_s: 1.5,
        overlap: 0.0,
        timing,
        profile,
        path: PathSplines::default(),
    }
}

fn time() -> Time {
    Time { control_period_us: 10_000, substeps: 20, horizon_steps: 900, settle_s: 0.5 }
}

fn limits() -> Limits {
    Limits {
        workspace_min_m: [-1.0; 3],
        workspace_max_m: [1.0; 3],
        linear_velocity_m_s: 0.25,
        linear_acceleration_m_s2: 1.5,
        linear_jerk_m_s3: 30.0,
        angular_velocity_rad_s: 4.0,
        angular_acceleration_rad_s2: 25.0,
        angular_jerk_rad_s3: 500.0,
    }
}

/// Opens half-way between straight up and its heading, so that no axis is special.
fn tool() -> Tool {
    let mut tool = Scene::load("bench").unwrap().into_spec().tool;
    tool.start_position_m = [0.1, -0.2, 0.3];
    tool.start_pitch_deg = 30.0;
    tool
}

fn map(timing: Timing, profile: Profile) -> SkillMap {
    SkillMap::from_parts(&skill(timing, profile), &time(), &limits(), &tool())
}

fn overlapping(timing: Timing, overlap: f64) -> SkillMap {
    let skill = Skill { overlap, ..skill(timing, Profile::MinimumJerk) };
    SkillMap::from_parts(&skill, &time(), &limits(), &tool())
}

fn any_theta() -> impl Strategy<Value = Theta> {
    prop::array::uniform5(-1.0..=1.0f64).prop_map(theta)
}

fn theta(components: [f64; 5]) -> Theta {
    Theta::new(components).unwrap()
}

/// Sum of the controls from the start: displacement of the origin and (the axis never turning)
/// rotation vector.
fn total(controls: &[Control]) -> Control {
    controls.iter().fold([0.0; 6], |sum, step| std::array::from_fn(|k| sum[k] + step[k]))
}

fn norm(v: &[f64]) -> f64 {
    v.iter().map(|x| x * x).sum::<f64>().sqrt()
}

fn close(a: f64, b: f64, tolerance: f64) -> bool {
    (a - b).abs() <= tolerance
}

/// Controls of the steps that lie wholly inside the segment.
fn inside<'a>(map: &SkillMap, controls: &'a [Control], theta: &Theta, kind: SegmentKind) -> &'a [Control] {
    let span = *map.segments(theta).iter().find(|span| span.kind == kind).unwrap();
    let tick = |time_s: f64| time_s / 0.01;
    &controls[(tick(span.start_s) - 1e-9).ceil() as usize..(tick(span.end_s) + 1e-9).floor() as usize]
}

#[test]
fn theta_maps_affinely_and_exactly_at_the_ends() {
    let map = map(Timing::Continuous, Profile::MinimumJerk);
    assert_eq!(map.parameters(&theta([-1.0; 5])).map(f64::to_bits), map.bounds.map(|b| b[0].to_bits()));
    assert_eq!(map.parameters(&theta([1.0; 5])).map(f64::to_bits), map.bounds.map(|b| b[1].to_bits()));
    assert!(close(map.parameters(&theta([0.5; 5]))[0], 0.0165, 1e-15));
}

#[test]
fn constant_speed_segments_move_at_their_speeds_in_their_directions() {
    let theta = theta([0.1, 0.2, -0.3, 0.4, 0.5]);
    for timing in [Timing::Continuous, Timing::Rounded] {
        let map = map(timing, Profile::ConstantSpeed);
        let controls = map.control_vectors(&theta).unwrap();
        let moves = [
            (SegmentKind::Approach, [0.0, 0.0, -0.001, 0.0, 0.0, 0.0]),
            (SegmentKind::Insert, [0.0, 0.0, -0.001, 0.0, 0.0, 0.0]),
            (SegmentKind::Lift, [0.0, 0.0, 0.001, 0.0, 0.0, 0.0]),
            (SegmentKind::Transport, [0.001, 0.0, 0.0, 0.0, 0.0, 0.0]),
            (SegmentKind::Pour, [0.0, 0.0, 0.0, 0.0, 0.015, 0.0]),
        ];
        for (kind, step) in moves {
            // A rounded count changes the step by at most half a step in the segment's count.
            let steps = inside(&map, &controls, &theta, kind);
            let tolerance = if timing == Timing::Rounded { 0.6 / steps.len() as f64 } else { 1e-11 };
            for control in steps {
                for (found, wanted) in control.iter().zip(step) {
                    assert!(
                        close(*found, wanted, wanted.abs() * tolerance + 1e-15),
                        "{kind:?} {found} {wanted}"
                    );
                }
            }
        }
    }
}

#[test]
fn continuous_constant_speed_ends_its_segments_at_the_sums_of_distance_over_speed() {
    let theta = theta([0.1, 0.2, -0.3, 0.4, 0.5]);
    let map = map(Timing::Continuous, Profile::ConstantSpeed);
    let [depth, scoop, lift, transport, pour] = map.parameters(&theta);
    let scoop_s = ((0.03f64 / 0.1).powi(16) + (scoop / 1.5).powi(16)).powf(1.0 / 16.0);
    let durations = [0.2, depth / 0.1, scoop_s, lift / 0.1, transport / 0.1, pour / 1.5];
    let mut end_s = 0.0;
    for (span, duration_s) in map.segments(&theta).iter().zip(durations) {
        assert!(close(span.start_s, end_s, 1e-14));
        end_s += duration_s;
        assert!(close(span.end_s, end_s, 1e-14));
    }
}

#[test]
fn rounded_constant_speed_takes_the_papers_step_counts() {
    let theta = theta([0.1, 0.2, -0.31, 0.4, 0.5]);
    let map = map(Timing::Rounded, Profile::ConstantSpeed);
    let [depth, scoop, lift, transport, pour] = map.parameters(&theta);
    let counts = [20.0, (depth / 0.001).round(), (scoop / 0.015).round(), (lift / 0.001).round()];
    let counts = [&counts[..], &[(transport / 0.001).round(), (pour / 0.015).round()]].concat();
    let mut end = 0.0;
    for (span, count) in map.segments(&theta).iter().zip(counts) {
        end += count;
        assert!(close(span.end_s, end * 0.01, 1e-12), "{span:?} {end}");
    }
}

#[test]
fn minimum_jerk_segment_follows_the_quintic() {
    let theta = theta([0.3; 5]);
    for timing in [Timing::Continuous, Timing::Rounded] {
        let map = map(timing, Profile::MinimumJerk);
        let controls = map.control_vectors(&theta).unwrap();
        let span = map.segments(&theta)[4];
        let quintic = |t: f64| {
            let r = ((t - span.start_s) / (span.end_s - span.start_s)).clamp(0.0, 1.0);
            10.0 * r.powi(3) - 15.0 * r.powi(4) + 6.0 * r.powi(5)
        };
        let transport = map.parameters(&theta)[3];
        for (i, control) in controls.iter().enumerate() {
            let time = i as f64 * 0.01;
            if time >= span.start_s && time + 0.01 <= span.end_s {
                let step = transport * (quintic(time + 0.01) - quintic(time));
                assert!(close(control[0], step, 1e-14), "{i}");
            }
        }
    }
}

/// Transport and pour begin early, everything else and all durations stay; the lift and the transport are a little slower where
/// their accelerations count.
#[test]
fn with_an_overlap_transport_and_pour_begin_before_what_is_before_them_ends() {
    let theta = theta([0.1, 0.2, -0.3, 0.4, 0.5]);
    for (timing, tolerance_s) in [(Timing::Continuous, 1e-12), (Timing::Rounded, 0.005 + 1e-12)] {
        let [one_by_one, overlapping] = [1e-12, 0.7].map(|overlap| overlapping(timing, overlap));
        let [before, after] = [&one_by_one, &overlapping].map(|map| map.segments(&theta));
        let duration_s = |span: &SegmentSpan| span.end_s - span.start_s;
        for (k, span) in after.iter().enumerate() {
            assert!(close(duration_s(span), duration_s(&before[k]), 1e-12), "{span:?}");
            let early_s = if k == 0 { 0.0 } else { after[k - 1].end_s - span.start_s };
            let wanted_s = match k {
                4 | 5 => 0.7 / (1.0 / duration_s(&after[k - 1]) + 1.0 / duration_s(span)),
                _ => 0.0,
            };
            assert!(close(early_s, wanted_s, tolerance_s), "{timing:?} {span:?} {early_s} {wanted_s}");
        }
        assert!(after[5].end_s < before[5].end_s - 0.3);
    }
}

#[test]
fn motion_longer_than_the_horizon_is_refused_with_both_times() {
    for (timing, profile) in KINDS {
        let short = Time { horizon_steps: 100, ..time() };
        let map = SkillMap::from_parts(&skill(timing, profile), &short, &limits(), &tool());
        let error = map.control_vectors(&Theta::MIDDLE).unwrap_err();
        let SkillError::TooLong { motion_s, horizon_s } = error else { panic!("{error}") };
        assert!(motion_s > 2.0 && close(horizon_s, 1.0, 1e-12));
    }
}

#[test]
fn motion_that_just_fits_the_horizon_is_accepted() {
    let rounded = map(Timing::Rounded, Profile::MinimumJerk);
    let end_s = rounded.segments(&theta([0.5; 5])).last().unwrap().end_s;
    let fitting = Time { horizon_steps: (end_s / 0.01).round() as u32, ..time() };
    let map =
        SkillMap::from_parts(&skill(Timing::Rounded, Profile::MinimumJerk), &fitting, &limits(), &tool());
    let full = total(&rounded.control_vectors(&theta([0.5; 5])).unwrap());
    let fitted = total(&map.control_vectors(&theta([0.5; 5])).unwrap());
    assert_eq!(full.map(f64::to_bits), fitted.map(f64::to_bits));
}

#[test]
fn every_skill_of_every_shipped_scene_is_a_motion_within_its_limits() {
    for (name, _) in crate::scene::EMBEDDED_SCENES {
        let scene = Scene::load(name).unwrap();
        let map = SkillMap::new(&scene);
        map.check_all_corners().unwrap_or_else(|error| panic!("{name}: {error}"));
        let longest_s = map.segments(&theta([1.0; 5])).last().unwrap().end_s;
        println!("{name}: {longest_s:.3} s of {:.3} s", scene.time.horizon_s());
    }
}

#[test]
fn limits_that_a_skill_breaks_are_named_with_the_corner() {
    let mut scene = Scene::load("bench-small").unwrap();
    scene.limits.workspace_max_m[0] -= 0.05;
    let error = SkillMap::new(&scene).check_all_corners().unwrap_err().to_string();
    assert!(error.contains("theta = [") && error.contains("x position"), "{error}");
    scene = Scene::load("bench-small").unwrap();
    scene.skill.profile = Profile::ConstantSpeed;
    let error = SkillMap::new(&scene).check_all_corners().unwrap_err().to_string();
    assert!(error.contains("linear acceleration"), "{error}");
}

#[test]
fn travels_of_zero_are_motions() {
    for (timing, profile) in KINDS {
        let still = Skill { sweep_m: 0.0, approach_m: 0.0, ..skill(timing, profile) };
        let map = SkillMap::from_parts(&still, &time(), &limits(), &tool());
        let at = map.linearise(&theta([-1.0; 5])).unwrap();
        assert!(at.controls.iter().flat_map(|control| control.components()).all(|value| value.is_finite()));
        assert!(at.jacobian.iter().flatten().flatten().all(|value| value.is_finite()));
    }
}

#[test]
fn the_scoop_kink_of_constant_speed_is_rounded_off_from_above() {
    // Sweep and rotation take equally long: the duration is 2^(1/16) times either.
    let equal = Skill {
        scooping_angle_deg: [0.45f64.to_degrees(); 2],
        ..skill(Timing::Continuous, Profile::ConstantSpeed)
    };
    let span = SkillMap::from_parts(&equal, &time(), &limits(), &tool()).segments(&Theta::MIDDLE)[2];
    assert!(close(span.end_s - span.start_s, 0.3 * 2f64.powf(1.0 / 16.0), 1e-12));
}

/// Remainder of the linear model after a step of length `h` along `direction`.
fn remainder(map: &SkillMap, from: &[f64; 5], direction: &[f64; 5], h: f64) -> f64 {
    let at = map.linearise(&theta(*from)).unwrap();
    let moved = theta(std::array::from_fn(|k| from[k] + h * direction[k]));
    let moved = map.control_vectors(&moved).unwrap();
    let squares = moved.iter().zip(&at.controls).zip(&at.jacobian).map(|((moved, control), jacobian)| {
        let control = control.components();
        let residual = |row: usize| {
            let linear: f64 = (0..5).map(|k| jacobian[row][k] * direction[k]).sum();
            moved[row] - control[row] - h * linear
        };
        (0..6).map(|row| residual(row).powi(2)).sum::<f64>()
    });
    squares.sum::<f64>().sqrt()
}

#[test]
fn taylor_remainder_of_the_smooth_mapping_falls_with_slope_two() {
    let map = map(Timing::Continuous, Profile::MinimumJerk);
    let (theta, direction) = ([0.1, -0.2, 0.3, 0.15, -0.4], [0.5, -0.7, 0.3, 0.6, 0.4]);
    let remainders: Vec<f64> =
        (0..5).map(|k| remainder(&map, &theta, &direction, 1e-2 * 0.5f64.powi(k))).collect();
    for pair in remainders.windows(2) {
        let slope = (pair[0] / pair[1]).log2();
        assert!((slope - 2.0).abs() < 0.1, "slope {slope}: {remainders:?}");
    }
}

/// Constant speed makes the mapping piecewise linear but for the scoop's duration, rounded timing
/// linear as long as no count flips: the remainder, rather than falling with slope 2, is next to
/// nothing.
#[test]
fn taylor_remainder_of_the_piecewise_linear_mappings_is_second_order_or_rounding() {
    let (theta, direction) = ([0.1, -0.2, 0.3, 0.15, -0.4], [0.5, -0.7, 0.3, 0.6, 0.4]);
    for (timing, profile) in &KINDS[1..] {
        let map = map(*timing, *profile);
        for h in [1e-4, 1e-5, 1e-6] {
            let remainder = remainder(&map, &theta, &direction, h);
            assert!(remainder <= 0.1 * h * h + 1e-14, "{timing:?} {profile:?} {h}: {remainder}");
        }
    }
}

proptest! {
    #[test]
    fn jacobian_agrees_with_central_differences(
        from in prop::array::uniform5(-0.99..0.99f64),
        overlap in 0.0..=1.0f64,
    ) {
        let map = overlapping(Timing::Continuous, overlap);
        let at = map.linearise(&theta(from)).unwrap();
        let h = 1e-5;
        for parameter in SkillParameter::ALL {
            let k = parameter.index();
            let shifted = |sign: f64| map.control_vectors(&theta(from).moved(parameter, sign * h)).unwrap();
            let (up, down) = (shifted(1.0), shifted(-1.0));
            for i in 0..at.controls.len() {
                for row in 0..6 {
                    let difference = (up[i][row] - down[i][row]) / (2.0 * h);
                    prop_assert!(close(at.jacobian[i][row][k], difference, 1e-7));
                }
            }
        }
    }

    #[test]
    fn linearised_controls_are_the_controls(theta in any_theta()) {
        for (timing, profile) in KINDS {
            let map = map(timing, profile);
            prop_assert_eq!(map.linearise(&theta).unwrap().controls, map.controls(&theta).unwrap());
        }
    }

    #[test]
    fn ends_where_the_parameters_say(
        theta in any_theta(),
        heading_deg in -180.0..180.0f64,
        overlap in 0.0..=1.0f64,
    ) {
        for (timing, profile) in KINDS {
            let skill = Skill { heading_deg, overlap, ..skill(timing, profile) };
            let map = SkillMap::from_parts(&skill, &time(), &limits(), &tool());
            let [depth, scoop, lift, transport, pour] = map.parameters(&theta);
            let (sin, cos) = heading_deg.to_radians().sin_cos();
            let (forward, pitch) = (0.03 + transport, pour - scoop);
            let wanted = [forward * cos, forward * sin, lift - depth - 0.02, -pitch * sin, pitch * cos, 0.0];
            let found = total(&map.control_vectors(&theta).unwrap());
            for (found, wanted) in found.iter().zip(wanted) {
                prop_assert!(close(*found, wanted, 1e-13));
            }
        }
    }

    #[test]
    fn composed_controls_end_at_the_pose_that_the_parameters_say(
        theta in any_theta(),
        heading_deg in -180.0..180.0f64,
    ) {
        for (timing, profile) in KINDS {
            let skill = Skill { heading_deg, ..skill(timing, profile) };
            let map = SkillMap::from_parts(&skill, &time(), &limits(), &tool());
            let [depth, scoop, lift, transport, pour] = map.parameters(&theta);
            let controls = map.control_vectors(&theta).unwrap();
            let moved = |pose: Pose, control: &Control| pose.displaced(&Displacement::from(*control));
            let end = controls.iter().fold(*map.start_pose(), moved);
            // In the tool's words: the same place, the opening tilted by start pitch - scoop + pour.
            let heading = exp_so3(&[0.0, 0.0, heading_deg.to_radians()].into());
            let pitch = 30f64.to_radians() - scoop + pour;
            let heading = Pose { position_m: map.start_pose().position_m, orientation: heading };
            let wanted = Pose {
                position_m: heading.world_from_tool(&[0.03 + transport, 0.0, lift - depth - 0.02].into()),
                orientation: heading.orientation * exp_so3(&[0.0, pitch, 0.0].into()),
            };
            let error = end.displacement_to(&wanted).components();
            prop_assert!(norm(&error) < 1e-12, "{error:?}");
        }
    }

    #[test]
    fn quantised_motion_is_within_half_an_lsb_everywhere(
        theta in any_theta(),
        heading_deg in -180.0..180.0f64,
    ) {
        for (timing, profile) in KINDS {
            let skill = Skill { heading_deg, ..skill(timing, profile) };
            let map = SkillMap::from_parts(&skill, &time(), &limits(), &tool());
            let controls = map.control_vectors(&theta).unwrap();
            let quantised = QuantisedControls::new(&map.controls(&theta).unwrap()).unwrap();
            prop_assert_eq!(quantised.steps.len(), controls.len());
            let mut performed = *map.start_pose();
            for i in 0..controls.len() {
                // One axis of rotation: the cumulative rotation vector is the sum of the steps'.
                let exact = total(&controls[..=i]);
                let found = quantised.setpoints[i].cumulative(LSB).components();
                for k in 0..6 {
                    prop_assert!(close(found[k], exact[k], 0.5e-7 * (1.0 + 1e-5)));
                }
                performed = performed.displaced(&quantised.controls[i]);
            }
            let commanded = pose_at(map.start_pose(), *quantised.setpoints.last().unwrap(), LSB);
            prop_assert!(norm(&performed.displacement_to(&commanded).components()) < 1e-12);
        }
    }

    #[test]
    fn minimum_jerk_keeps_the_limits_by_construction(
        theta in any_theta(),
        speed in 0.02..0.24f64,
        overlap in 0.0..=1.0f64,
    ) {
        for timing in [Timing::Continuous, Timing::Rounded] {
            let skill = Skill { linear_speed_m_s: speed, overlap, ..skill(timing, Profile::MinimumJerk) };
            let slow = Time { horizon_steps: 4000, ..time() };
            let map = SkillMap::from_parts(&skill, &slow, &limits(), &tool());
            let controls = map.control_vectors(&theta).unwrap();
            let quantised = QuantisedControls::new(&map.controls(&theta).unwrap()).unwrap();
            prop_assert!(map.check_limits(&quantised).is_ok());
            let (translation, rotation): (Vec<[f64; 3]>, Vec<[f64; 3]>) =
                controls.iter().map(|c| ([c[0], c[1], c[2]], [c[3], c[4], c[5]])).unzip();
            let l = limits();
            let linear = [l.linear_velocity_m_s, l.linear_acceleration_m_s2, l.linear_jerk_m_s3];
            let angular = [l.angular_velocity_rad_s, l.angular_acceleration_rad_s2, l.angular_jerk_rad_s3];
            for (steps, limits) in [(translation, linear), (rotation, angular)] {
                for (peak, limit) in peaks(&steps).into_iter().zip(limits) {
                    prop_assert!(peak <= limit * (1.0 + 1e-9), "{timing:?} {peak} {limit}");
                }
            }
        }
    }

    #[test]
    fn pull_back_is_the_transpose_of_the_jacobian(
        theta in any_theta(),
        direction in prop::array::uniform5(-1.0..=1.0f64),
        seed in any::<u64>(),
    ) {
        let at = map(Timing::Continuous, Profile::MinimumJerk).linearise(&theta).unwrap();
        let phase = (seed % 1000) as f64;
        let bar = |i: usize| std::array::from_fn(|k| libm::sin(phase + 0.7 * i as f64 + 1.9 * k as f64));
        let bars: Vec<Control> = (0..at.controls.len()).map(bar).collect();
        let pushed: f64 = at.jacobian.iter().zip(&bars).map(|(jacobian, bar)| {
            let along = |row: usize| (0..5).map(|k| jacobian[row][k] * direction[k]).sum::<f64>();
            (0..6).map(|row| bar[row] * along(row)).sum::<f64>()
        }).sum();
        let gradient: Vec<_> = bars.into_iter().map(DisplacementGradient::from).collect();
        let pulled: f64 = at.pull_back(&gradient).iter().zip(direction).map(|(bar, d)| bar * d).sum();
        prop_assert!(close(pushed, pulled, 1e-12 * (1.0 + pushed.abs())));
    }
}

/// Largest first, second and third differences over the control period, from rest to rest.
fn peaks(steps: &[[f64; 3]]) -> [f64; 3] {
    let rest = [[0.0; 3]; 3];
    let mut rates: Vec<[f64; 3]> = [&rest[..], steps, &rest[..]].concat();
    rates.iter_mut().flatten().for_each(|value| *value /= 0.01);
    std::array::from_fn(|order| {
        if order > 0 {
            rates = rates.windows(2).map(|w| std::array::from_fn(|k| (w[1][k] - w[0][k]) / 0.01)).collect();
        }
        rates.iter().map(|rate| norm(rate)).fold(0.0, f64::max)
    })
}

#[test]
fn theta_is_found_from_metres_and_radians() {
    let map = SkillMap::new(&Scene::load("bench").unwrap());
    let components = [0.3, -0.7, 1.0, -1.0, 0.0];
    let found = map.theta(&map.parameters(&theta(components)));
    assert!(components.iter().zip(found).all(|(a, b)| (a - b).abs() < 1e-12), "{found:?}");
}
