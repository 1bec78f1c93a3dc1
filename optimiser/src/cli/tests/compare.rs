//! `optimise compare` with the stand-in.

use super::*;
use crate::compare::ADJOINT_ROLLOUTS;
use crate::report::folder::COMPARISON;
use powderline_simulator::scene::GradientEstimator;

const METHODS: &str = "gradient,gradient-steps,sac,cma-es,random";

fn arguments<'a>(folder: &'a str, more: &[&'a str]) -> Vec<&'a str> {
    let mut all = vec!["compare", "bench-small", "--methods", METHODS, "--seeds", "1,2", "--epochs", "3"];
    all.extend(["--rollouts-per-epoch", "5", "--out", folder]);
    all.extend(more);
    all
}

/// What was tried, without the wall times.
fn tries(folder: &str, track: &str) -> Vec<Value> {
    let text = fs::read_to_string(Path::new(folder).join(track).join("tries.jsonl")).unwrap();
    let parse = |line| {
        let mut value: Value = serde_json::from_str(line).unwrap();
        value.as_object_mut().unwrap().remove("seconds").unwrap();
        value
    };
    text.lines().map(parse).collect()
}

fn assert_same(folder: &str, other: &str) {
    for seed in [1, 2] {
        for method in ["gradient-steps", "sac", "cma-es", "random"] {
            let track = format!("{method}-seed{seed}");
            assert_eq!(tries(folder, &track), tries(other, &track), "{track}");
        }
        let gradient = |folder: &str| format!("{folder}/gradient-seed{seed}");
        assert_eq!(metrics(&gradient(folder)), metrics(&gradient(other)));
    }
    assert_eq!(bytes(folder, CURVES), bytes(other, CURVES));
}

#[test]
fn a_comparison_leaves_figure_table_and_summary() {
    let place = Place::new();
    let folder = place.text("comparison");
    let done = optimise(&arguments(&folder, &["--budget-factor", "2"]));
    assert_eq!(done.code, 0, "{}", done.err);
    for file in [SCENE, COMPARISON, CURVES, "curves.png", "comparison.csv", "summary.md"] {
        assert!(Path::new(&folder).join(file).is_file(), "{file}");
    }
    let summary = String::from_utf8(bytes(&folder, "summary.md")).unwrap();
    assert!(done.out.contains(&summary), "{}", done.out);
    let again = optimise(&["compare", "--resume", &folder, "--json"]);
    let report: Value = serde_json::from_str(&again.out).unwrap();
    let named: Vec<&str> =
        report["rows"].as_array().unwrap().iter().map(|row| row["name"].as_str().unwrap()).collect();
    assert!(report["folder"] == *folder && report["seeds"] == serde_json::json!([1, 2]), "{report}");
    let rows: Vec<&str> =
        summary.lines().skip(2).map(|line| line.split('|').nth(1).unwrap().trim()).collect();
    assert_eq!(named, rows);
    // A heading, a line below it, two gradients, and three methods with their budget and twice that.
    assert_eq!(summary.lines().count(), 2 + 2 + 3 * 2, "{summary}");
    let widths: Vec<usize> = summary.lines().map(str::len).collect();
    assert!(widths.iter().all(|width| *width == widths[0]), "{summary}");
    for seed in [1, 2] {
        for method in ["sac", "cma-es", "random"] {
            assert_eq!(tries(&folder, &format!("{method}-seed{seed}")).len(), 4 * 5 * 2);
        }
        assert_eq!(metrics(&format!("{folder}/gradient-seed{seed}")).len(), 4);
        assert_eq!(tries(&folder, &format!("gradient-steps-seed{seed}")).len(), 4);
        assert!(Path::new(&folder).join(format!("gradient-seed{seed}")).join(PLAN).is_file());
    }
    let table = String::from_utf8(bytes(&folder, "comparison.csv")).unwrap();
    assert_eq!(table.lines().count(), 1 + 2 * (2 * 4 + 3 * 40));
    // Without a skill, five cells are empty.
    let widths: Vec<usize> = table.lines().map(|line| line.split(',').count()).collect();
    assert!(widths.iter().all(|width| *width == widths[0]), "{table}");
    let steps: Vec<&str> = table.lines().filter(|line| line.starts_with("gradient-steps,")).collect();
    assert!(steps.len() == 8 && steps.iter().all(|line| line.ends_with(",,,,,")), "{table}");
}

#[test]
fn a_comparison_interrupted_again_and_again_has_the_same_bits() {
    let place = Place::new();
    let [whole, folder] = ["whole", "parts"].map(|name| place.text(name));
    assert_eq!(optimise(&arguments(&whole, &[])).code, 0);
    let mut done = optimise_for(20, &arguments(&folder, &[]));
    let mut resumptions = 0;
    while done.code == 130 && resumptions < 1000 {
        assert!(done.err.contains(&format!("compare --resume {folder}")), "{}", done.err);
        // Enough for the longest epoch, or for a generation.
        done = optimise_for(14 * TICKS, &["compare", "--resume", &folder]);
        resumptions += 1;
    }
    assert!(done.code == 0 && resumptions > 3, "{} after {resumptions}", done.err);
    assert_same(&folder, &whole);
}

#[test]
fn a_prolonged_comparison_has_the_bits_of_a_longer_one() {
    let place = Place::new();
    let [long, short] = ["long", "short"].map(|name| place.text(name));
    let mut longer = arguments(&long, &[]);
    let at = longer.iter().position(|argument| *argument == "3").unwrap();
    longer[at] = "5";
    assert_eq!(optimise(&longer).code, 0);
    assert_eq!(optimise(&arguments(&short, &[])).code, 0);
    let done = optimise(&["compare", "--resume", &short, "--epochs", "5"]);
    assert_eq!(done.code, 0, "{}", done.err);
    assert_same(&short, &long);
    let done = optimise(&["compare", "--resume", &short, "--epochs", "4"]);
    assert_sentence(&done, 2, "it can only be prolonged");
}

#[test]
fn variants_of_the_gradient_differ_in_what_they_are_called_by() {
    let place = Place::new();
    let folder = place.text("variants");
    let methods = "gradient,gradient-curriculum,gradient-rounded,gradient-mixed,gradient-restarted,\
                   gradient-differences,gradient-adjoint";
    let done = optimise(&[
        "compare",
        "bench-small",
        "--methods",
        methods,
        "--seeds",
        "4",
        "--epochs",
        "4",
        "--out",
        &folder,
    ]);
    assert_eq!(done.code, 0, "{}", done.err);
    let scene = |method: &str| Scene::load(&format!("{folder}/{method}-seed4/scene.toml")).unwrap();
    let usual = scene("gradient");
    assert_eq!(usual.optimiser.curriculum_epochs, 0);
    assert_eq!(scene("gradient-curriculum").optimiser.curriculum_epochs, usual.optimiser.epochs / 2);
    assert_ne!(scene("gradient-rounded").skill.timing, usual.skill.timing);
    for (method, gradient) in [
        ("gradient-mixed", GradientEstimator::Mixed),
        ("gradient-restarted", GradientEstimator::Restarted),
        ("gradient-differences", GradientEstimator::Differences),
        ("gradient-adjoint", GradientEstimator::Adjoint),
    ] {
        assert_eq!(scene(method).optimiser.gradient, gradient, "{method}");
        let first = &metrics(&format!("{folder}/{method}-seed4"))[0];
        let (adjoint, differences) = (&first["adjoint"][0], &first["differences"][0]);
        assert_eq!(adjoint.is_null(), gradient == GradientEstimator::Differences, "{method}");
        assert_eq!(differences.is_null(), gradient == GradientEstimator::Adjoint, "{method}");
    }
    let theta = |method: &str| metrics(&format!("{folder}/{method}-seed4"))[1]["theta"][4].clone();
    assert_ne!(theta("gradient-curriculum"), theta("gradient"));
}

#[test]
fn what_makes_no_comparison_is_refused() {
    let place = Place::new();
    let folder = place.text("comparison");
    let compare = |more: &[&str]| {
        let all: Vec<&str> =
            ["compare", "bench-small", "--out", &folder].iter().chain(more).copied().collect();
        optimise(&all)
    };
    assert_sentence(&compare(&["--seeds", "1,2,1"]), 2, "--seeds names 1 twice");
    assert_sentence(&compare(&["--methods", "random,random"]), 2, "--methods names Random twice");
    assert_sentence(&compare(&["--epochs", "200000"]), 2, "at most 100000");
    let many = ["--epochs", "99999", "--rollouts-per-epoch", "9999"];
    assert_sentence(&compare(&many), 2, "at most 1000000");
    assert!(!Path::new(&folder).exists());
    assert_sentence(&optimise(&["compare", "--resume", &folder]), 2, "holds nothing to resume");
    fs::create_dir(&folder).unwrap();
    assert_sentence(&optimise(&["compare", "--resume", &folder]), 2, COMPARISON);
}

#[test]
fn a_comparison_that_was_changed_is_refused() {
    let place = Place::new();
    let folder = place.text("comparison");
    let begin =
        ["compare", "bench-small", "--methods", "random", "--seeds", "1", "--epochs", "2", "--out", &folder];
    assert_eq!(optimise(&begin).code, 0);
    assert_sentence(&optimise(&begin), 2, "already holds");
    let change = |file: &str, from: &str, to: &str| {
        let path = Path::new(&folder).join(file);
        let text = fs::read_to_string(&path).unwrap();
        assert!(text.contains(from), "{text}");
        fs::write(&path, text.replacen(from, to, 1)).unwrap();
        let done = optimise(&["compare", "--resume", &folder]);
        fs::write(&path, text).unwrap();
        done
    };
    assert_sentence(&change(SCENE, "friction = 0.4", "friction = 0.3"), 2, "no longer the scene");
    assert_sentence(&change(COMPARISON, "\"random\"", "\"luck\""), 2, COMPARISON);
    assert_sentence(&change("random-seed1/tries.jsonl", "\"loss\":", "\"los\":"), 2, "line 1");
    assert_sentence(&change("random-seed1/tries.jsonl", "\"theta\":[", "\"theta\":[0.125,"), 2, "line 1");
    let text = fs::read_to_string(Path::new(&folder).join("random-seed1/tries.jsonl")).unwrap();
    let first = &text[text.find("\"theta\":[").unwrap()..text.find(',').unwrap()];
    let done = change("random-seed1/tries.jsonl", first, "\"theta\":[0.123");
    assert_sentence(&done, 2, "does not ask for");
    // A line that was not finished is evaluated again.
    let path = Path::new(&folder).join("random-seed1/tries.jsonl");
    let whole = tries(&folder, "random-seed1");
    let text = fs::read_to_string(&path).unwrap();
    fs::write(&path, &text[..text.len() - 20]).unwrap();
    assert_eq!(optimise(&["compare", "--resume", &folder]).code, 0);
    assert_eq!(tries(&folder, "random-seed1"), whole);
}

fn steps<'a>(folder: &'a str, epochs: &'a str) -> Vec<&'a str> {
    let all = ["compare", "bench-small", "--methods", "gradient-steps", "--seeds", "1,2", "--epochs", epochs];
    [&all[..], &["--out", folder]].concat()
}

#[test]
fn displacements_begin_with_the_loss_of_the_skill_and_descend_although_powder_escapes() {
    let place = Place::new();
    let folder = place.text("steps");
    let done = optimise(&steps(&folder, "20"));
    assert_eq!(done.code, 0, "{}", done.err);
    assert!(done.err.contains("epoch  20/20"), "{}", done.err);
    assert!(done.err.contains("left the simulated volume"), "{}", done.err);
    assert!(done.err.contains("back to the best motion, with half the learning rate"), "{}", done.err);
    let skills = place.text("skills");
    let arguments = ["--methods", "gradient", "--seeds", "1,2", "--epochs", "0", "--out", &skills];
    assert_eq!(optimise(&[&["compare", "bench-small"], &arguments[..]].concat()).code, 0);
    for seed in [1, 2] {
        let tries = tries(&folder, &format!("gradient-steps-seed{seed}"));
        let losses: Vec<f64> = tries.iter().map(|one| one["loss"].as_f64().unwrap()).collect();
        let skill = &metrics(&format!("{skills}/gradient-seed{seed}"))[0];
        assert_eq!(skill["loss"].as_f64().unwrap().to_bits(), losses[0].to_bits());
        assert!(losses[20] < losses[0] - 1e-4, "{losses:?}");
        assert_eq!(tries[20]["rollouts"], 21 * (1 + ADJOINT_ROLLOUTS));
    }
    // The page has nothing to replay, and says what there is.
    assert_eq!(optimise(&["report", &folder]).code, 0);
}

#[test]
fn a_search_over_displacements_is_prolonged_and_goes_on_from_what_it_saved() {
    let place = Place::new();
    let [long, short] = ["long", "short"].map(|name| place.text(name));
    assert_eq!(optimise(&steps(&long, "20")).code, 0);
    let mut done = optimise_for(4 * TICKS + 1, &steps(&short, "11"));
    let mut resumptions = 0;
    while done.code == 130 && resumptions < 100 {
        done = optimise_for(5 * TICKS, &["compare", "--resume", &short]);
        resumptions += 1;
    }
    assert!(done.code == 0 && resumptions > 2, "{} after {resumptions}", done.err);
    // What stands beside the state is put right by it.
    fs::write(Path::new(&short).join("gradient-steps-seed1/tries.jsonl"), "").unwrap();
    assert_eq!(optimise(&["compare", "--resume", &short, "--epochs", "20"]).code, 0);
    for track in ["gradient-steps-seed1", "gradient-steps-seed2"] {
        assert_eq!(tries(&short, track), tries(&long, track));
    }
    assert_eq!(bytes(&short, CURVES), bytes(&long, CURVES));
}

#[test]
fn a_state_of_displacements_that_was_changed_is_refused() {
    let place = Place::new();
    let folder = place.text("steps");
    assert_eq!(optimise(&steps(&folder, "2")).code, 0);
    let whole = bytes(&folder, "gradient-steps-seed1/state");
    let mut flipped = whole.clone();
    flipped[1000] ^= 1;
    for (broken, about) in [
        (whole[..whole.len() / 2].to_vec(), "damaged"),
        (flipped, "damaged"),
        (b"{}".to_vec(), "not a state file"),
        (bytes(&folder, "gradient-steps-seed2/state"), "another scene, seed or precision"),
    ] {
        fs::write(Path::new(&folder).join("gradient-steps-seed1/state"), &broken).unwrap();
        let done = optimise(&["compare", "--resume", &folder]);
        assert_sentence(&done, 2, about);
        assert!(done.err.contains("gradient-steps-seed1/state cannot be resumed from"), "{}", done.err);
    }
}
