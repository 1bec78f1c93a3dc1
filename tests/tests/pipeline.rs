//! From a scene to a motion that the simulated arm performs.

use powderline_simulator::scene::{Aim, Amount, Quantity, Scene};
use serde_json::Value;

use crate::programs::{EXECUTE, OPTIMISE, Place, assert_same_bits, metrics, run};

#[test]
fn a_skill_is_optimised_played_and_reproduced_with_the_same_bits_for_any_number_of_threads() {
    let place = Place::new();
    let [folder, alone] = ["two-threads", "one-thread"].map(|name| place.path(name));
    let epochs = ["run", "bench-small", "--no-refine", "--epochs", "2"];
    run(OPTIMISE, &[&epochs[..], &["--threads", "2", "--out", &folder]].concat()).finished();
    run(OPTIMISE, &[&epochs[..], &["--threads", "1", "--out", &alone]].concat()).finished();
    assert_same_bits(&folder, &alone);

    let plan = &format!("{folder}/skill.plan");
    let played = run(EXECUTE, &[plan, "--json"]).json();
    assert_eq!((&played["completed"], &played["within_half_lsb"]), (&true.into(), &true.into()));
    let errors = played["error_lsb"].as_array().unwrap();
    assert_eq!(errors.len(), 6);
    assert!(errors.iter().all(|error| error.as_f64().unwrap().abs() <= 0.5), "{errors:?}");
    // It is the scene's own arm that plays it, and its joints lag.
    assert_eq!(played["plan"]["arm"]["kind"], "ur3e");
    assert!(played["stream"]["tracking_m"].as_f64().unwrap() > 1e-4, "{}", played["stream"]);

    let again = run(OPTIMISE, &["simulate", "--plan", plan, "--threads", "1", "--json"]).json();
    assert_eq!(again["plan"]["reproduced"], true);
    let inspected = run(OPTIMISE, &["inspect", plan, "--json"]).json();
    for (name, others) in [
        (
            "loss_m",
            [
                &again["plan"]["predicted"]["loss_m"],
                &inspected["predicted"]["loss_m"],
                &played["plan"]["predicted"]["loss_m"],
            ],
        ),
        (
            "indicator",
            [
                &again["plan"]["predicted"]["indicator"],
                &inspected["predicted"]["indicator"],
                &played["plan"]["predicted"]["indicator"],
            ],
        ),
    ] {
        assert!(others.iter().all(|other| **other == again[name]), "{name}: {} and {others:?}", again[name]);
    }
    assert_eq!(played["plan"]["content_hash"], inspected["content_hash"]);

    // All powder is accounted for, in the same numbers wherever they are said.
    let census = &again["census"];
    assert_eq!((census, census), (&inspected["predicted"]["census"], &played["plan"]["predicted"]["census"]));
    let places = census.as_object().unwrap();
    let checked = run(OPTIMISE, &["check", "bench-small", "--json"]).json();
    assert_eq!(places.len(), 6);
    assert_eq!(places.values().filter_map(Value::as_u64).sum::<u64>(), checked["particles"]);

    // It looked at the coarse copy first, and the powder moved.
    let lines: Vec<Value> = metrics(&folder).iter().map(|l| serde_json::from_str(l).unwrap()).collect();
    let epochs: Vec<_> = lines.iter().map(|line| line["epoch"].as_u64().unwrap()).collect();
    assert_eq!(epochs, [0, 1, 2]);
    let worlds: Vec<_> = lines.iter().map(|line| line["world"].as_str().unwrap()).collect();
    assert_eq!(worlds, ["coarse", "coarse", "fine"]);
    assert_ne!(lines[1]["theta"], lines[0]["theta"]);
    assert_ne!(lines[1]["loss"], lines[0]["loss"]);
}

#[test]
fn the_wanted_amount_arrives_and_no_more() {
    let place = Place::new();
    let mut scene = Scene::load(&place.tiny()).unwrap().into_spec();
    // Half of what the spoon holds.
    scene.objective.amount = Amount::new(Quantity::Particles(16));
    let [amount, all] = [Aim::Amount, Aim::All].map(|aim| {
        scene.objective.aim = aim;
        let file = place.write("wanted.toml", scene.to_toml().as_bytes());
        let folder = place.path(if aim == Aim::All { "all" } else { "amount" });
        run(OPTIMISE, &[&file, "--no-refine", "--epochs", "12", "--out", &folder]).finished();
        let plan = run(OPTIMISE, &["inspect", &format!("{folder}/skill.plan"), "--json"]).json();
        plan["predicted"]["indicator"].as_i64().unwrap()
    });
    // Of so few grains in so coarse cells, within a quarter.
    assert!(amount.abs() <= 4 && all <= -10, "{amount} {all}");
}

#[test]
fn the_gradient_agrees_with_differences_in_all_five_parameters() {
    let place = Place::new();
    let report = run(OPTIMISE, &["gradcheck", &place.tiny(), "--short", "--json"]).json();
    let mut at_work = [0; 5];
    for window in report["windows"].as_array().unwrap() {
        for (k, component) in window["components"].as_array().unwrap().iter().enumerate() {
            if let Some(error) = component["error"].as_f64() {
                assert!(error < 1e-4, "{error} in component {k} of {window}");
                at_work[k] += usize::from(component["adjoint"].as_f64() != Some(0.0));
            }
        }
    }
    assert!(at_work.iter().all(|count| *count > 0), "{at_work:?}");
}

#[test]
fn a_finished_run_is_taken_further_to_the_bits_of_a_longer_one() {
    let place = Place::new();
    let long = place.tiny_run("long", 2);
    let folder = place.tiny_run("short", 1);
    run(OPTIMISE, &["--resume", &folder, "--epochs", "2"]).finished();
    assert_same_bits(&folder, &long);
}

#[test]
fn gradients_of_drawn_skills_are_held_against_slopes_with_the_same_bits_for_any_threads() {
    let place = Place::new();
    // With eight to a cell few skills deliver as many particles as a gradient needs.
    let tiny = place.tiny_with(16);
    let table = |threads: &str, memory: &str| {
        let asked = ["gradcheck", &tiny, "--skills", "2", "--packings", "2", "--json"];
        let mut report =
            run(OPTIMISE, &[&asked[..], &["--threads", threads, "--memory", memory]].concat()).json();
        for cost in ["exact_in_rollouts", "restarted_in_rollouts"] {
            assert!(report["summary"][cost].as_f64().unwrap() > 1.0, "{report}");
            report["summary"][cost].take();
        }
        for skill in report["skills"].as_array_mut().unwrap() {
            skill["packings"].as_array_mut().unwrap().iter_mut().for_each(|one| drop(one["seconds"].take()));
        }
        report
    };
    let report = table("1", "1GiB");
    let skills = report["skills"].as_array().unwrap();
    assert_eq!(skills.len(), 2);
    for skill in skills {
        assert_eq!(skill["packings"].as_array().unwrap().len(), 2);
        assert_ne!(skill["exact"], skill["restarted"]);
        assert_ne!(skill["packings"][0]["slope"], skill["packings"][1]["slope"]);
    }
    assert_eq!(report["summary"]["restarted"]["signs"].as_array().unwrap().len(), 5);
    assert!(report["summary"]["constant"]["residual_cosine"].is_null());
    assert_eq!(report, table("2", "64MiB"));
}
