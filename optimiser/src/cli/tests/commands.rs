//! What the program says of itself, and how it is asked.

use super::*;
use powderline_simulator::scene::{EMBEDDED_SCENES, embedded_scene};

fn json(done: &Done) -> Value {
    assert_eq!(done.out.lines().count(), 1, "{}", done.out);
    serde_json::from_str(&done.out).unwrap()
}

#[test]
fn the_scenes_are_listed_a_line_each() {
    let done = optimise(&["scenes"]);
    let lines: Vec<&str> = done.out.lines().skip(1).collect();
    assert_eq!(lines.len(), EMBEDDED_SCENES.len(), "{}", done.out);
    for (line, (name, _)) in lines.iter().zip(EMBEDDED_SCENES) {
        let scene = Scene::load(name).unwrap();
        let [particles, wanted] = [scene.particle_count(), scene.target_count()].map(|n| grouped(n as i64));
        assert_eq!(
            line.split_whitespace().take(3).collect::<Vec<_>>(),
            [name, &particles, &wanted],
            "{line}"
        );
    }
    assert!(lines[1].contains("1.6 g") && lines[1].contains("A small bench"), "{}", lines[1]);
    let report = json(&optimise(&["scenes", "--json"]));
    assert_eq!(report["scenes"][0]["particles"], 11_264);
    assert_eq!(report["scenes"].as_array().unwrap().len(), EMBEDDED_SCENES.len());
}

#[test]
fn a_new_scene_is_the_commented_one_under_another_name() {
    let place = Place::new();
    let file = place.text("my bench.toml");
    let done = optimise(&["new", &file]);
    assert_eq!(done.code, 0, "{}", done.err);
    // What it says to type next is to be typed in a shell.
    assert!(done.out.ends_with(&format!("check '{file}'\n")), "{}", done.out);
    let (text, bench) = (fs::read_to_string(&file).unwrap(), embedded_scene("bench").unwrap());
    let changed: Vec<_> = text.lines().zip(bench.lines()).filter(|(new, old)| new != old).collect();
    assert_eq!((changed.len(), text.lines().count()), (1, bench.lines().count()), "{changed:?}");
    assert_eq!(changed[0].0, "name = \"my bench\" # shown in reports; 1 to 64 printable characters");
    assert_eq!(optimise(&["check", &file]).code, 0);

    assert_sentence(&optimise(&["new", &file]), 2, "is there already and is not overwritten");
    assert_eq!(fs::read_to_string(&file).unwrap(), text);
    assert_sentence(&optimise(&["new", &place.text("no/such/folder.toml")]), 1, "cannot be written");
    assert_sentence(&optimise(&["new", "bench-fine"]), 2, "such as my-bench-fine.toml");
}

#[test]
fn a_new_scene_begins_from_any_shipped_one() {
    let place = Place::new();
    for (name, _) in EMBEDDED_SCENES {
        let file = place.text(&format!("from-{name}.toml"));
        let report = json(&optimise(&["new", &file, "--from", name, "--json"]));
        assert_eq!((&report["from"], &report["name"]), (&name.into(), &format!("from-{name}").into()));
        let (new, old) = (Scene::load(&file).unwrap(), Scene::load(name).unwrap());
        assert_eq!(new.with(|spec| spec.name = name.into()), Ok(old));
        // Of the files that explain it, there may be none where the program is.
        assert!(!fs::read_to_string(&file).unwrap().contains("bench.toml"), "{name}");
    }
    let file = place.text("none.toml");
    assert_sentence(&optimise(&["new", &file, "--from", "bench-smal"]), 2, "did you mean bench-small?");
    assert!(!Path::new(&file).exists());
}

#[test]
fn a_mistyped_command_is_not_taken_for_a_scene() {
    for (arguments, meant) in [
        (&["chek"][..], "`chek`; did you mean the command `check`?"),
        (&["simulat", "--theta", "0,0,0,0,0"], "did you mean the command `simulate`?"),
        (&["raport", "runs/x"], "did you mean the command `report`?"),
        (
            &["bnch"],
            "called `bnch`; the embedded scenes are bench, bench-small, bench-fine, vial, workcell; did you mean `bench`?",
        ),
        (&["kitchen"], "the embedded scenes are bench, bench-small, bench-fine, vial, workcell"),
    ] {
        assert_sentence(&optimise(arguments), 2, meant);
    }
}

#[test]
fn what_is_no_mistyped_command_is_left_alone() {
    let place = Place::new();
    assert!(mistyped(Some(&"raport".into())).is_err());
    for word in ["report", "help", "bench-smal", "--seed", "raport.toml", place.text("").as_str()] {
        assert_eq!(mistyped(Some(&word.into())), Ok(()), "{word}");
    }
    assert_eq!(mistyped(None), Ok(()));
}

#[test]
fn where_nobody_reads_the_command_ends_and_says_nothing() {
    for arguments in [&["check"][..], &["check", "--json"], &["scenes"], &["completions", "zsh"]] {
        assert_unread(arguments);
    }
}

#[test]
fn a_failure_is_an_object_too() {
    for (arguments, code, about) in [
        (&["check", "bnch", "--json"][..], 2, "did you mean `bench`?"),
        (&["gradcheck", "bnch", "--json"], 2, "no file called `bnch`"),
        (&["validate", "bnch", "--json"], 2, "did you mean `bench`?"),
        (&["simulate", "bench", "--theta", "0,0,0,0", "--json"], 2, "there are 4"),
        (&["render", "bench", "--theta", "0,0,0,0,0", "--at", "99", "--json"], 2, "--at asks for 99 s"),
        (&["compare", "bench", "--seeds", "1,1", "--json"], 2, "twice"),
        (&["bench", "--grid", "15", "--json"], 2, "--grid is a number"),
        (&["new", "bench", "--json"], 2, "my-bench.toml"),
    ] {
        let done = optimise(arguments);
        let object = json(&done);
        assert_eq!((done.code, &object["exit_code"]), (code, &code.into()), "{arguments:?}");
        assert!(object["error"].as_str().unwrap().contains(about), "{object}");
        // The same sentence for whoever watches.
        assert_eq!(object["error"], done.err.lines().last().unwrap());
    }
}

#[test]
fn a_plan_that_is_not_reproduced_is_one_object() {
    let place = Place::new();
    let folder = place.finished("run", 1);
    let path = Path::new(&folder).join(PLAN);
    predict_otherwise(&path);
    let done = optimise(&["simulate", "--plan", path.to_str().unwrap(), "--json"]);
    assert_eq!((done.code, &json(&done)["plan"]["reproduced"]), (1, &false.into()), "{}", done.out);
    // A stop does not hide it, nor is hidden by it.
    let stopped = optimise_for(8, &["simulate", "--plan", path.to_str().unwrap(), "--packings", "3"]);
    let both = "were not reproduced; stopped after 1 of 3 other packings";
    assert!(stopped.code == 1 && stopped.err.contains(both), "{}", stopped.err);
}

/// Changes what a plan says of itself by the last bit.
fn predict_otherwise(path: &Path) {
    let mut plan = fs::read(path).unwrap();
    let reported = PlanReader::new(&plan).unwrap().header().predicted.loss_m.to_le_bytes();
    let at = plan.windows(8).position(|bytes| bytes == reported).unwrap();
    plan[at] ^= 1;
    let end = plan.len() - 4;
    let mut checksum = powderline_shared::plan::Crc32::default();
    checksum.update(&plan[..end]);
    plan[end..].copy_from_slice(&checksum.value().to_le_bytes());
    fs::write(path, plan).unwrap();
}

/// Nor does its page read like a success.
#[test]
fn what_is_seen_of_a_plan_is_held_against_what_it_says() {
    let place = Place::new();
    let folder = place.finished("run", 1);
    let words = "were not reproduced: it says ";
    let report = || json(&optimise(&["report", &folder, "--json"]));
    assert_eq!(report()["remarks"], serde_json::json!([]));
    predict_otherwise(&Path::new(&folder).join(PLAN));
    let remarks = report()["remarks"].as_array().unwrap().clone();
    assert!(remarks.len() == 1 && remarks[0].as_str().unwrap().contains(words), "{remarks:?}");
    let done = optimise(&["report", &folder]);
    assert!(
        done.code == 0 && done.err.contains("Warning: the plan's loss and amount were not"),
        "{}",
        done.err
    );
    let page = String::from_utf8(bytes(&folder, "report.html")).unwrap();
    assert!(page.contains("But: The plan") && page.contains(words), "it reads like a success");
    let plan = format!("{folder}/{PLAN}");
    let drawn = optimise(&["render", "--plan", &plan, "--size", "64x48", "--out", &place.text("pictures")]);
    assert!(drawn.code == 0 && drawn.err.contains(words), "{}", drawn.err);
}

#[test]
fn completions_and_pages_know_every_command() {
    let place = Place::new();
    let script = optimise(&["completions", "bash"]).out;
    let folder = place.text("man1");
    let done = optimise(&["man", &folder]);
    assert_eq!(done.code, 0, "{}", done.err);
    let pages: Vec<&str> = done.out.lines().collect();
    let commands: Vec<String> =
        Cli::command().get_subcommands().map(|command| command.get_name().to_owned()).collect();
    assert_eq!(pages.len(), 1 + commands.len(), "{}", done.out);
    for command in &commands {
        assert!(script.contains(&format!("optimise,{command})")), "{command}");
        let page = fs::read_to_string(format!("{folder}/optimise-{command}.1")).unwrap();
        assert!(pages.contains(&format!("{folder}/optimise-{command}.1").as_str()) && page.contains(".TH"));
    }
    assert_eq!(fs::read_dir(&folder).unwrap().count(), pages.len());
    assert!(fs::read_to_string(format!("{folder}/optimise.1")).unwrap().contains("Optimises a skill"));
}

#[test]
fn commands_take_json() {
    // What a shell reads has no other form.
    let all = Cli::command();
    for command in all.get_subcommands().filter(|command| command.get_name() != "completions") {
        let json = command.get_arguments().any(|argument| argument.get_id() == "json");
        assert!(json, "{}", command.get_name());
    }
}
