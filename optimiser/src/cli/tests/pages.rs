//! `optimise report` and `render` with the stand-in, whose powder is two particles.

use super::*;
use powderline_simulator::scene::Arm;

fn page(folder: &str) -> String {
    String::from_utf8(bytes(folder, "report.html")).unwrap()
}

#[test]
fn a_run_becomes_a_page_with_curves_table_and_replay() {
    let place = Place::new();
    let folder = place.finished("run", 3);
    let done = optimise(&["report", &folder]);
    assert_eq!(done.code, 0, "{}", done.err);
    assert!(done.out.contains("report.html"), "{}", done.out);
    let page = page(&folder);
    for text in [
        "\"arm\":{\"name\":\"UR3e\"",
        "bench-small, seed 4",
        "Powder that arrives",
        "pouring angle",
        "Epochs",
        "Lost",
    ] {
        assert!(page.contains(text), "{text}");
    }
    let with_replay = page.len();
    assert_eq!(optimise(&["report", &folder, "--no-replay"]).code, 0);
    assert!(self::page(&folder).len() < with_replay - 1000);
}

#[test]
fn a_plan_becomes_a_page_with_the_arms_motion_over_it() {
    let arm = Performed::new();
    assert_eq!(arm.simulate(&[]).code, 0);
    let executed = arm.place.text("executed.txt");
    let out = arm.place.text("page.html");
    let done = optimise(&["report", &arm.plan, "--executed", &executed, "--out", &out]);
    assert_eq!(done.code, 0, "{}", done.err);
    assert!(fs::read_to_string(&out).unwrap().contains("As executed."));
    assert!(
        done.out.contains("As executed.") && done.out.contains("The arm was off the plan by"),
        "{}",
        done.out
    );
    let report = optimise(&["report", &arm.plan, "--executed", &executed, "--out", &out, "--json"]);
    let report: Value = serde_json::from_str(&report.out).unwrap();
    assert_eq!(report["executed"]["executed_steps"], arm.steps());
}

/// The search's plan is written before it is looked at on smaller cells, which takes long.
#[test]
fn a_run_that_is_not_finished_shows_the_plan_that_there_is() {
    let place = Place::new();
    let folder = place.finished("run", 2);
    let done = optimise_for(6, &["--resume", &folder, "--epochs", "30"]);
    assert_eq!(done.code, 130, "{}", done.err);
    let words = "The run is not finished; the plan as it is now: ";
    let done = optimise(&["report", &folder]);
    assert!(done.code == 0 && done.out.contains(words), "{}", done.out);
    assert!(page(&folder).contains(words), "it says that there is none");
    fs::remove_file(Path::new(&folder).join(PLAN)).unwrap();
    let nothing = place.text("nothing.txt");
    let done = optimise(&["report", &folder, "--executed", &nothing]);
    assert_sentence(&done, 2, "has no plan yet that it could be of");
    assert_eq!(optimise(&["report", &folder]).code, 0);
    assert!(page(&folder).contains("there is no plan yet"));
}

#[test]
fn a_comparison_becomes_a_page() {
    let place = Place::new();
    let folder = place.text("comparison");
    let methods = "mixed,cma-es";
    let begin = [
        "compare",
        "bench-small",
        "--methods",
        methods,
        "--seeds",
        "4",
        "--rollouts",
        "20",
        "--out",
        &folder,
    ];
    assert_eq!(optimise(&begin).code, 0);
    assert_eq!(optimise(&["report", &folder]).code, 0);
    let page = page(&folder);
    for text in ["comparison of methods", "cma-es", "rollouts to 90 %", "Lowest loss so far"] {
        assert!(page.contains(text), "{text}");
    }
}

#[test]
fn what_cannot_be_reported_is_refused() {
    let place = Place::new();
    let empty = place.text("empty");
    fs::create_dir(&empty).unwrap();
    assert_sentence(&optimise(&["report", &empty]), 2, "holds neither a run");
    assert_sentence(&optimise(&["report", &place.text("nothing")]), 2, "nothing");
    let folder = place.finished("run", 1);
    fs::write(Path::new(&folder).join(STATE), "{\"epoch\":").unwrap();
    assert_sentence(&optimise(&["report", &folder]), 2, "it is not a state file");
    let place = Place::new();
    let folder = place.finished("run", 1);
    assert_sentence(
        &optimise(&["report", &folder, "--out", &folder]),
        2,
        "is a folder; the name of the page",
    );
    let new = place.text("no/folder/yet.html");
    assert_eq!(optimise(&["report", &folder, "--no-replay", "--out", &new]).code, 0);
    assert!(Path::new(&new).is_file());
}

#[test]
fn a_skill_is_drawn_at_chosen_moments_and_as_a_whole() {
    let place = Place::new();
    let (folder, movie) = (place.text("pictures"), place.text("skill.gif"));
    let skill = ["render", "bench-small", "--theta", "0,0,0,0,0", "--size", "64x48"];
    let moments =
        ["--at", "0.5,1.004", "--out", &folder, "--animation", &movie, "--rate", "5", "--colour", "speed"];
    let done = optimise(&[&skill[..], &moments].concat());
    assert_eq!(done.code, 0, "{}", done.err);
    let names: Vec<&str> = done.out.lines().collect();
    assert_eq!(names.len(), 3, "{}", done.out);
    assert!(names[1].ends_with("bench-small-0001.000s.png"), "{}", names[1]);
    assert!(names.iter().all(|name| Path::new(name).is_file()));
    let done = optimise(&[&skill[..], &moments, &["--json"]].concat());
    let report: Value = serde_json::from_str(&done.out).unwrap();
    let wanted = serde_json::json!({ "files": names, "arm": "ur3e", "remark": null, "failure": null });
    assert_eq!(report, wanted);
    // Without moments there are six.
    let folder = place.text("more");
    let done = optimise(&[&skill[..], &["--out", &folder, "--cut"]].concat());
    assert_eq!((done.code, done.out.lines().count()), (0, 6), "{}", done.err);
}

#[test]
fn what_cannot_be_drawn_is_refused() {
    let place = Place::new();
    let folder = place.text("pictures");
    let render = |more: &[&str]| {
        optimise(&[&["render", "bench-small", "--theta", "0,0,0,0,0", "--out", &folder], more].concat())
    };
    assert_sentence(&render(&["--size", "9x9"]), 2, "9");
    assert_sentence(&render(&["--animation", "skill.avi"]), 2, "skill.avi");
    assert_sentence(&render(&["--animation", "skill.gif", "--rate", "1000"]), 2, "1000");
    assert_sentence(&render(&["--at", "NaN"]), 2, "NaN");
    assert_sentence(&render(&["--at", "-1"]), 2, "from 0 to 3.3");
    assert_sentence(&render(&["--at", "1,99"]), 2, "from 0 to 3.3");
    assert_sentence(&render(&["--zoom", "0"]), 2, "zoom 0.01 to 1000");
    fs::write(&folder, "a file").unwrap();
    assert_sentence(&render(&["--at", "1", "--size", "32x32"]), 1, "pictures");
    // The animation is written all the same, and said to be.
    let movie = place.text("skill.gif");
    let both = ["--at", "1", "--size", "32x32", "--animation", &movie, "--rate", "5"];
    let done = render(&both);
    assert!(
        done.code == 1 && done.err.contains("pictures") && done.out == format!("{movie}\n"),
        "{}",
        done.out
    );
    let report: Value = serde_json::from_str(&render(&[&both[..], &["--json"]].concat()).out).unwrap();
    assert_eq!((&report["files"], report["failure"].is_string()), (&serde_json::json!([movie]), true));
    let interrupted = optimise_for(1, &["render", "bench-small", "--theta", "0,0,0,0,0", "--out", &folder]);
    assert_sentence(&interrupted, 130, "stopped");
}

/// The scene `bench-small` with another arm.
fn with_arm(place: &Place, change: impl Fn(&mut Arm)) -> String {
    let mut scene = Scene::load("bench-small").unwrap().into_spec();
    change(scene.arm.as_mut().unwrap());
    let file = place.text("moved.toml");
    fs::write(&file, scene.to_toml()).unwrap();
    file
}

#[test]
fn the_arm_is_drawn_unless_it_cannot_or_is_not_wanted() {
    let place = Place::new();
    let folder = place.text("pictures");
    let render = |scene: &str, more: &[&str]| {
        let usual = [
            "render",
            scene,
            "--theta",
            "0,0,0,0,0",
            "--size",
            "64x48",
            "--at",
            "1",
            "--json",
            "--out",
            &folder,
        ];
        let done = optimise(&[&usual, more].concat());
        assert_eq!(done.code, 0, "{}", done.err);
        let report: Value = serde_json::from_str(&done.out).unwrap();
        let picture = fs::read(report["files"][0].as_str().unwrap()).unwrap();
        (report, done.err, picture)
    };
    let (report, _, drawn) = render("bench-small", &[]);
    assert_eq!((report["arm"].as_str(), report["remark"].as_str()), (Some("ur3e"), None));
    let (report, _, whole) = render("bench-small", &["--frame", "all", "--axes"]);
    assert_eq!(report["arm"], "ur3e");
    let (report, _, without) = render("bench-small", &["--no-arm"]);
    assert!(report["arm"].is_null() && report["remark"].is_null());
    assert!(drawn != without && drawn != whole && whole != without);
    // Out of reach: said, and drawn as without an arm.
    let (report, err, away) = render(&with_arm(&place, |arm| arm.base_position_m[1] = -2.0), &[]);
    let remark = report["remark"].as_str().unwrap();
    assert!(
        report["arm"].is_null() && remark.starts_with("No arm is drawn, for the UR3e cannot make"),
        "{remark}"
    );
    assert!(err.contains(remark) && away == without, "{err}");
    // Nearer to something than it should be: drawn as it is, and said.
    let (report, _, near) = render(&with_arm(&place, |arm| arm.clearance_m = 0.5), &[]);
    let remark = report["remark"].as_str().unwrap();
    assert!(remark.starts_with("The UR3e is drawn, though it could not make this motion"), "{remark}");
    assert!(report["arm"] == "ur3e" && near == drawn);
    // Where the tool is held within the arm likewise; that no plan can come of it, `check` says first.
    let within = with_arm(&place, |arm| {
        (arm.base_position_m[1], arm.tool_position_m) = (-0.2, [0.0, 0.0, -0.1]);
    });
    let remark = render(&within, &[]).0["remark"].as_str().unwrap().to_owned();
    assert!(
        remark.starts_with("The UR3e is drawn, though it could not make this motion: at 0.000 s the tool's ")
            && remark.contains(" would pass through the arm's wrist ")
            && remark.ends_with(
                "the tool held farther away from the flange, or turned otherwise in it, would be right."
            ),
        "{remark}"
    );
    let checked = optimise(&["check", &within]);
    assert!(
        checked.code == 2 && checked.err.contains(" would pass through the arm's wrist "),
        "{}",
        checked.err
    );
}
