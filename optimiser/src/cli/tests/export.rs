//! `optimise export`: motions, and powder with the stand-in, whose powder is two particles.

use super::*;
use powderline_shared::plan::PlanHeader;
use powderline_simulator::scene::{Gate, GateOpening, GateShape, SceneSpec};

/// A plan of 100 ticks that an arm can make, pinned where plans are at home.
const GOLDEN: &[u8] = include_bytes!("../../../../shared/tests/golden/plan-v4.plan");

/// An arm that can make it.
const ARM: [&str; 6] = ["--arm", "ur5e", "--base", "0.6,0.25,0,0,0,0", "--tool", "0,0,0.1,20,0,0"];

/// A place with the plan in it.
fn with_plan() -> (Place, String) {
    let place = Place::new();
    fs::write(place.path("skill.plan"), GOLDEN).unwrap();
    let plan = place.text("skill.plan");
    (place, plan)
}

fn export(plan: &str, format: &str, more: &[&str]) -> Done {
    optimise(&[&["export", plan, "--format", format], more].concat())
}

// --- motions ---

#[test]
fn a_motion_is_written_beside_its_plan_in_every_format() {
    for (format, name, begins) in [
        ("csv", "skill.csv", "time_s,x_m,"),
        ("json", "skill.json", "{\"plan_hash\":\""),
        ("mcap", "skill.mcap", "MCAP"),
        ("urscript", "skill.script", "# Motion of Powderline's plan "),
    ] {
        let (place, plan) = with_plan();
        let done = export(&plan, format, &ARM);
        assert_eq!(done.code, 0, "{format}: {}", done.err);
        assert!(done.out.contains(name) && done.out.contains("100 ticks of 10 ms, 1.00 s."), "{}", done.out);
        let said = "The UR5e reaches forward, elbow up, wrist 2 at a positive angle. Its forearm comes nearest to anything: ";
        assert!(done.out.contains(said), "{}", done.out);
        assert_eq!(names(&place).len(), 2);
        let bytes = fs::read(place.path(name)).unwrap();
        assert!(String::from_utf8_lossy(&bytes[..40]).contains(begins), "{format}");
    }
}

#[test]
fn what_was_written_is_said_in_json_too() {
    let (place, plan) = with_plan();
    let done = export(&plan, "csv", &[&ARM[..], &["--json"]].concat());
    let said: serde_json::Value = serde_json::from_str(&done.out).unwrap();
    assert_eq!(said["path"], place.text("skill.csv"));
    assert_eq!((&said["format"], &said["motion"]["ticks"]), (&"csv".into(), &100.into()));
    assert!(said["arm"]["limit_use"]["linear_velocity"].as_f64().is_some_and(|share| share <= 1.0), "{said}");
    assert!(said["powder"].is_null());
    // Of the arm it says what a motion in JSON says, and more.
    let motion: Value =
        serde_json::from_str(&export(&plan, "json", &[&ARM[..], &["--out", "-"]].concat()).out).unwrap();
    assert_eq!((&motion["arm"]["model"], &motion["arm"]["elbow_up"]), (&"ur5e".into(), &true.into()));
    for (key, value) in motion["arm"].as_object().unwrap() {
        assert_eq!(&said["arm"][key], value, "{key}");
    }
    let both = export(&plan, "csv", &["--json", "--out", "-"]);
    assert!(both.code == 2 && both.err.contains("would both go to standard output"), "{}", both.err);
}

#[test]
fn without_an_arm_there_are_no_joints() {
    let (place, plan) = with_plan();
    fs::write(&plan, golden_with(|header| PlanHeader { arm: None, ..header })).unwrap();
    assert_eq!(export(&plan, "csv", &[]).code, 0);
    let table = fs::read_to_string(place.path("skill.csv")).unwrap();
    assert!(!table.contains("joint") && table.lines().count() == 102);
    for (format, more, about) in [
        ("urscript", &[][..], "--format urscript needs an arm, and "),
        ("json", &["--near", "1,2,3,4,5,6"], "--near needs an arm"),
        ("mcap", &["--table", "-0.1"], "skill.plan was made for a scene without [arm]"),
    ] {
        assert_sentence(&export(&plan, format, more), 2, about);
    }
}

#[test]
fn a_plan_brings_its_own_arm() {
    let (place, plan) = with_plan();
    let header = |more: &[&str]| {
        let done = export(&plan, "urscript", &[more, &["--force"]].concat());
        assert_eq!(done.code, 0, "{}", done.err);
        // What it says of base, tool and first joints; digits behind these know how the angles were given.
        fs::read_to_string(place.path("skill.script"))
            .unwrap()
            .lines()
            .take(12)
            .collect::<Vec<_>>()
            .join("\n")
    };
    assert_eq!(header(&[]), header(&ARM));
    let moved = header(&["--arm", "ur5e", "--base", "0.6,0.2,0,0,0,0", "--tool", "0,0,0.1,20,0,0"]);
    assert!(
        header(&[]).contains("p[0.6, 0.25, 0.0, 0.0, 0.0, 0.0]")
            && moved.contains("p[0.6, 0.2, 0.0, 0.0, 0.0, 0.0]"),
        "{moved}"
    );
}

#[test]
fn a_program_begins_at_a_home_that_it_can_leave() {
    let place = Place::new();
    let plan = format!("{}/skill.plan", place.finished("run", 1));
    let program = |more: &[&str]| export(&plan, "urscript", &[more, &["--force"]].concat());
    let said = program(&["--home=-20,-80,100,-45,100,0", "--speed", "0.1"]);
    assert_eq!(said.code, 0, "{}", said.err);
    assert!(
        said.out.contains("The program begins and ends at its home, goes across with the tool "),
        "{}",
        said.out
    );
    assert!(
        said.out.contains(" mm high and turns it back above the target; on these ways its "),
        "{}",
        said.out
    );
    assert!(said.out.contains("It goes at 10 % of full speed; powder behaves"), "{}", said.out);
    let said: Value = serde_json::from_str(&program(&["--json"]).out).unwrap();
    let transit = &said["transit"];
    assert_eq!((&transit["speed"], &transit["turn_back_above"]), (&1.0.into(), &"target".into()));
    assert!(transit["distance_m"].as_f64().unwrap() > 0.02, "{transit}");

    let low = program(&["--home", "0,0,0,0,0,0"]);
    assert_sentence(
        &low,
        2,
        "skill.plan gets no program: on the straight way of all joints from --home to above the start its wrist 2 ",
    );
    assert_sentence(&low, 2, "another --home would be right");
    let far = program(&["--home", "0,400,0,0,0,0"]);
    assert_sentence(
        &far,
        2,
        "joint 2 of --home is 400.0 degrees, and turns 360.0 to either side at the most",
    );

    // Nobody knows what is there where no scene is known.
    let (other, alone) = with_plan();
    let done = export(&alone, "urscript", &[]);
    assert!(done.out.contains("Without the plan's scene nobody has looked"), "{}", done.out);
    let said: Value = serde_json::from_str(&export(&alone, "urscript", &["--force", "--json"]).out).unwrap();
    assert_eq!((&said["transit"]["knows_scene"], &transit["knows_scene"]), (&false.into(), &true.into()));
    let script = fs::read_to_string(other.path("skill.script")).unwrap();
    assert!(script.contains("# NOT LOOKED AT: "), "{script:.2000}");
    // What lies beside a plan and is another scene is not passed over in silence.
    fs::write(other.path("scene.toml"), Scene::load("vial").unwrap().to_toml()).unwrap();
    assert_sentence(&export(&alone, "urscript", &["--force"]), 2, "was made for another scene than ");
    // Between fewer setpoints than ticks nobody looks.
    assert_sentence(&program(&["--rate", "50"]), 2, "--rate is 50, but ");
    assert_sentence(&program(&["--rate", "50"]), 2, "skill.plan has 100 ticks a second, and what is between");
}

/// A gate that opens by the clock does not wait for a tool that is slower, and an arm carries no more than it can.
#[test]
fn what_goes_by_the_clock_or_is_too_heavy_gets_no_program() {
    let place = Place::new();
    let changed = |spec: &mut SceneSpec| {
        spec.arm.as_mut().unwrap().payload_kg = Some(2.9);
        spec.gates = vec![Gate {
            name: "lid".into(),
            position_m: [0.17, 0.02, 0.11],
            yaw_deg: 0.0,
            friction: 0.4,
            opens_at_s: 0.05,
            shape: GateShape::Box { size_m: [0.01, 0.01, 0.01] },
            opening: GateOpening::Vanish {},
        }];
    };
    let scene = Scene::load("bench-small").unwrap().with(changed).unwrap();
    fs::write(place.path("gated.toml"), scene.to_toml()).unwrap();
    let (file, folder) = (place.text("gated.toml"), place.text("run"));
    let search = ["--method", "mixed", "--no-refine", "--epochs", "1", "--out", &folder];
    assert!(optimise(&[&[file.as_str()][..], &search].concat()).is_finished());
    let plan = format!("{folder}/skill.plan");
    let full = export(&plan, "urscript", &[]);
    assert!(full.code == 0, "{}", full.err);
    let slow = export(&plan, "urscript", &["--force", "--speed", "0.5"]);
    assert_sentence(&slow, 2, "--speed is 0.5, but gate \"lid\" opens by the clock, 0.05 s after");
}

#[test]
fn links_stay_clear_of_what_the_scene_has() {
    let place = Place::new();
    let plan = format!("{}/skill.plan", place.finished("run", 1));
    let said = export(
        &plan,
        "csv",
        &["--arm", "ur3e", "--base", "0.22,-0.5,-0.1,0,0,-90", "--tool", "0,0,0.05,90,0,-90"],
    );
    assert!(
        said.code == 2 && said.err.contains("mm deep in container \"source\", and 20.0 mm is the least"),
        "{}",
        said.err
    );
    // Nor does it take an arm of the scene's own for that.
    let scene = Scene::load("bench-small").unwrap().with(|spec| spec.arm = None).unwrap();
    fs::write(place.path("armless.toml"), scene.to_toml()).unwrap();
    let (file, folder) = (place.text("armless.toml"), place.text("armless"));
    let search = ["--method", "mixed", "--no-refine", "--epochs", "1", "--out", &folder];
    assert!(optimise(&[&[file.as_str()][..], &search].concat()).is_finished());
    let near = ["--arm", "ur3e", "--base", "0.22,-0.5,-0.1,0,0,-90", "--tool", "0,0,0.05,90,0,-90"];
    let said = export(&format!("{folder}/skill.plan"), "urscript", &near);
    assert!(said.code == 2 && said.err.contains("mm deep in container \"source\""), "{}", said.err);
}

/// What goes faster than a controller of UR is written as it is, but for a program.
#[test]
fn a_plan_of_shorter_ticks_is_exported() {
    let (_place, plan) = with_plan();
    let quick = golden_with(|header| {
        let powderline_shared::limits::Limits { workspace_min_m, workspace_max_m, .. } = header.limits;
        let limits = powderline_shared::limits::Limits {
            workspace_min_m,
            workspace_max_m,
            linear_velocity_m_s: 1e3 * header.limits.linear_velocity_m_s,
            linear_acceleration_m_s2: 1e3 * header.limits.linear_acceleration_m_s2,
            linear_jerk_m_s3: 1e4 * header.limits.linear_jerk_m_s3,
            angular_velocity_rad_s: 1e3 * header.limits.angular_velocity_rad_s,
            angular_acceleration_rad_s2: 1e3 * header.limits.angular_acceleration_rad_s2,
            angular_jerk_rad_s3: 1e4 * header.limits.angular_jerk_rad_s3,
        };
        PlanHeader { control_period_us: 1_000, limits, arm: None, ..header }
    });
    fs::write(&plan, quick).unwrap();
    for format in ["csv", "json", "mcap"] {
        let done = export(&plan, format, &[]);
        assert_eq!(done.code, 0, "{}", done.err);
    }
    assert_sentence(&export(&plan, "urscript", &ARM), 2, "takes no more than 500 setpoints");
}

#[test]
fn standard_output_holds_the_motion_and_nothing_else() {
    let (place, plan) = with_plan();
    let done = export(&plan, "json", &[&ARM[..], &["--out", "-"]].concat());
    assert_eq!(done.code, 0, "{}", done.err);
    assert_eq!(serde_json::from_str::<Value>(&done.out).unwrap()["steps"], 100);
    assert!(done.err.starts_with("standard output: 100 ticks"), "{}", done.err);
    assert_eq!(names(&place), ["skill.plan"]);
}

#[test]
fn a_closed_pipe_is_no_failure() {
    let (_place, plan) = with_plan();
    for format in ["csv", "json", "mcap"] {
        assert_unread(&["export", &plan, "--format", format, "--out", "-"]);
    }
}

#[test]
fn a_file_that_is_there_stays_unless_it_is_to_be_replaced() {
    let (place, plan) = with_plan();
    fs::write(place.path("skill.csv"), "mine").unwrap();
    assert_sentence(&export(&plan, "csv", &[]), 2, "is there already; name another file by --out");
    assert_eq!(fs::read_to_string(place.path("skill.csv")).unwrap(), "mine");
    let done = export(&plan, "csv", &["--force"]);
    assert_eq!(done.code, 0, "{}", done.err);
    assert!(fs::read_to_string(place.path("skill.csv")).unwrap().starts_with("time_s"));
    // Neither a folder nor a device is replaced, whatever is asked.
    let folder = place.text("folder");
    fs::create_dir(&folder).unwrap();
    assert_sentence(&export(&plan, "csv", &["--force", "--out", &folder]), 2, "is a folder");
    #[cfg(unix)]
    assert_sentence(&export(&plan, "csv", &["--force", "--out", "/dev/null"]), 2, "is no ordinary file");
}

#[test]
fn a_file_that_cannot_be_written_is_said() {
    let (place, plan) = with_plan();
    fs::write(place.path("file"), "no folder").unwrap();
    let out = place.text("file/skill.csv");
    assert_sentence(&export(&plan, "csv", &["--out", &out]), 1, "cannot be written");
    assert_eq!(names(&place), ["file", "skill.plan"]);
}

#[test]
fn what_is_no_plan_is_refused() {
    let (place, plan) = with_plan();
    assert_sentence(&export(&place.text("none.plan"), "csv", &[]), 2, "none.plan: there is no such file");
    fs::write(&plan, &GOLDEN[..GOLDEN.len() - 7]).unwrap();
    assert_sentence(&export(&plan, "csv", &[]), 2, "not a usable plan: its checksum is");
    fs::write(&plan, "a text").unwrap();
    assert_sentence(&export(&plan, "csv", &[]), 2, "not a usable plan");
    assert_eq!(names(&place), ["skill.plan"]);
}

#[test]
fn a_plan_of_another_scene_is_refused_where_a_scene_is_given() {
    let (place, plan) = with_plan();
    assert_sentence(&export(&plan, "csv", &["--scene", "bench"]), 2, "was made for another scene than bench");
    assert_sentence(
        &export(&plan, "mcap", &["--particles"]),
        2,
        "is not beside it, nor is it an embedded one",
    );
    assert_eq!(names(&place), ["skill.plan"]);
}

#[test]
fn a_plan_longer_than_a_controller_takes_is_refused_for_a_program_alone() {
    let (place, plan) = with_plan();
    fs::write(&plan, long_plan(10_001)).unwrap();
    assert_sentence(&export(&plan, "urscript", &ARM), 2, "has 10001 ticks");
    let done = export(&plan, "csv", &[]);
    assert_eq!(done.code, 0, "{}", done.err);
    assert_eq!(names(&place), ["skill.csv", "skill.plan"]);
}

/// The golden plan with more ticks at its end, in which nothing moves.
fn long_plan(ticks: u32) -> Vec<u8> {
    golden_with(|header| PlanHeader { step_count: ticks, ..header })
}

/// The golden plan under another header, with as many ticks as that says.
fn golden_with(change: impl Fn(PlanHeader) -> PlanHeader) -> Vec<u8> {
    let golden = PlanReader::new(GOLDEN).unwrap();
    let header = change(*golden.header());
    let mut bytes = Vec::new();
    let sink = |part: &[u8]| {
        bytes.extend_from_slice(part);
        Ok::<(), std::convert::Infallible>(())
    };
    let mut writer = powderline_shared::plan::PlanWriter::new(sink, &header).unwrap();
    for step in golden.steps().chain(std::iter::repeat([0; 6])).take(header.step_count as usize) {
        writer.step(step).unwrap();
    }
    writer.finish().unwrap();
    bytes
}

#[test]
fn a_base_out_of_reach_is_refused_with_time_value_limit_and_remedy() {
    let (place, plan) = with_plan();
    let far = ["--arm", "ur5e", "--base", "3,0,0,0,0,0", "--tool", "0,0,0,0,0,0"];
    for format in ["urscript", "csv", "json", "mcap"] {
        let done = export(&plan, format, &far);
        assert_sentence(&done, 2, "is no motion for this arm: at 0.000 s the wrist would be 2.");
        assert_sentence(&done, 2, "m from the shoulder, and can be 0.8172 m at the most");
        assert_sentence(&done, 2, "put the base at least");
        assert_sentence(&done, 2, "--base, --tool, --near, --rate say otherwise");
    }
    assert_eq!(names(&place), ["skill.plan"]);
}

#[test]
fn what_does_not_go_together_is_refused_before_anything_is_read() {
    for (format, more, about) in [
        ("json", &["--particles"][..], "json holds a motion alone"),
        ("urscript", &[&ARM[..], &["--particles"]].concat(), "urscript holds a motion alone"),
        ("vtk", &ARM, "--arm goes with a motion"),
        ("csv", &[&ARM[..], &["--particles"]].concat(), "--arm goes with a motion"),
        ("csv", &[&ARM[..], &["--rate", "125"]].concat(), "--rate goes with urscript"),
        ("mcap", &["--home", "0,0,0,0,0,0"], "--home and --speed go with urscript"),
        ("json", &["--speed", "0.1"], "--home and --speed go with urscript"),
        ("csv", &["--executed", "x"], "--theta and --executed go with files of powder"),
        ("mcap", &["--particles", "--executed", "x"], "--theta and --executed go with files of powder"),
        ("csv", &["--every", "3"], "--every goes with powder"),
        ("mcap", &["--particles", "--out", "-"], "powder goes into files"),
        ("ply", &["--out", "-"], "powder goes into files"),
        ("ply", &["--force"], "powder takes a folder"),
    ] {
        assert_sentence(&export("no such plan", format, more), 2, about);
    }
}

// --- powder ---

#[test]
fn powder_is_written_in_every_format_and_never_over_another() {
    let place = Place::new();
    let plan = format!("{}/skill.plan", place.finished("run", 1));
    for (format, files) in [
        ("csv", ["particles.csv", "tool.csv", "destinations.csv"]),
        ("ply", ["powder-0000.ply", "tool-0000.ply", "containers.ply"]),
        ("vtk", ["series.pvd", "powder-0000.vtp", "containers.vtp"]),
    ] {
        let folder = place.text(format);
        let export = || self::export(&plan, format, &["--particles", "--every", "33", "--out", &folder]);
        let done = export();
        assert_eq!(done.code, 0, "{}", done.err);
        assert!(done.out.contains("11 frames of"), "{}", done.out);
        for file in files {
            assert!(Path::new(&folder).join(file).is_file(), "{format}: {file}");
        }
        assert_sentence(&export(), 2, &folder);
    }
}

#[test]
fn messages_hold_the_powder_too_and_are_not_left_half_written() {
    let place = Place::new();
    let plan = format!("{}/skill.plan", place.finished("run", 1));
    let out = place.text("powder.mcap");
    let words = ["export", &plan, "--format", "mcap", "--particles", "--out", &out];
    let interrupted = optimise_for(1, &words);
    assert_sentence(&interrupted, 130, "stopped");
    assert_eq!(names(&place), ["run"]);
    let done = optimise(&words);
    assert_eq!(done.code, 0, "{}", done.err);
    assert!(done.out.contains("with 166 frames of"), "{}", done.out);
    let topics = String::from_utf8_lossy(&fs::read(&out).unwrap()).matches("/powder").count();
    assert!(topics >= 1);
}

#[test]
fn the_powder_of_a_skill_needs_no_plan() {
    let place = Place::new();
    let skill = |theta, folder: &str| {
        let begin = ["export", "--scene", "bench-small", "--format", "csv", "--particles", "--theta", theta];
        optimise(&[&begin[..], &["--every", "33", "--out", folder]].concat())
    };
    let done = skill("0,0,0,0,0", &place.text("yes"));
    assert_eq!(done.code, 0, "{}", done.err);
    assert_sentence(&skill("2,0,0,0,0", &place.text("no")), 2, "theta");
    assert!(!place.path("no").exists());
}
