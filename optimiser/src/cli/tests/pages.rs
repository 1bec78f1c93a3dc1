//! `optimise report`, `render` and `export` with the stand-in, whose powder is two particles.

use super::*;

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
    for text in ["bench-small, seed 4", "Indicator", "pouring angle", "Epochs", "Spilled"] {
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
    assert!(fs::read_to_string(&out).unwrap().contains("as executed"));
}

#[test]
fn a_comparison_becomes_a_page() {
    let place = Place::new();
    let folder = place.text("comparison");
    let methods = "gradient,cma-es";
    let begin =
        ["compare", "bench-small", "--methods", methods, "--seeds", "4", "--epochs", "2", "--out", &folder];
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
    let metrics = Path::new(&folder).join(METRICS);
    fs::write(&metrics, "{\"epoch\":").unwrap();
    assert_sentence(&optimise(&["report", &folder]), 2, "line 1");
    let place = Place::new();
    let folder = place.finished("run", 1);
    let done = optimise(&["report", &folder, "--out", &place.text("no/folder/report.html")]);
    assert_sentence(&done, 1, "report.html");
}
