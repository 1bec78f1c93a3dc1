//! `optimise validate`: what it says of a table. That the table is right is tested where it is measured.

use super::*;
use crate::cli::validate::{judged, text};
use powderline_simulator::validate::{Record, Scope, Table, Verdict};

fn table() -> Table {
    Record::committed(Scope::Short).table
}

/// The first line that holds, and its name.
fn breaking(table: &mut Table, verdict: Verdict, into: Verdict) -> String {
    let line = table.lines.iter_mut().find(|line| line.verdict == verdict).unwrap();
    line.verdict = into;
    line.sentence = "It is broken.".into();
    line.name.clone()
}

#[test]
fn every_line_is_printed_with_all_that_belongs_to_it() {
    let table = table();
    let out = text(&table, &[]);
    assert!(out.starts_with(&format!("The powder of bench. {}\n", table.summary())), "{out}");
    for line in &table.lines {
        let row = out.lines().find(|row| row.starts_with(&format!("  {} ", line.name))).unwrap();
        assert!(row.contains(&line.measured_words()) && row.ends_with(line.verdict.words()), "{row}");
        for said in [&line.source, &line.why, &line.sentence, &line.group] {
            assert!(out.contains(said.as_str()), "{said}");
        }
    }
    // Columns stand below each other.
    let rows = out.lines().filter(|row| row.starts_with("  ") && !row.starts_with("   "));
    let ends: Vec<usize> = rows.map(|row| row.find(" to ").unwrap()).collect();
    assert!(ends.iter().max().unwrap() - ends.iter().min().unwrap() < 8, "{ends:?}");
}

#[test]
fn what_no_longer_holds_is_said_first() {
    let before = table();
    let mut now = before.clone();
    let lost = breaking(&mut now, Verdict::Holds, Verdict::FallsShort);
    let loose = breaking(&mut now, Verdict::FailsAsItMust, Verdict::DoesNotFail);
    let no_longer = now.no_longer_good(&before);
    assert_eq!(no_longer, [lost.clone(), loose.clone()]);
    let out = text(&now, &no_longer);
    let mut lines = out.lines();
    assert_eq!(lines.next().unwrap(), format!("No longer holds: {lost}."));
    assert_eq!(lines.next().unwrap(), format!("No longer holds: {loose}."));
    assert_eq!(lines.next().unwrap(), format!("Does not fail, and must: {loose}."));
    let sentence = judged(&no_longer, std::slice::from_ref(&loose)).unwrap();
    assert_eq!(
        sentence,
        format!(
            "what held before no longer holds: {lost}; {loose}. And what is broken on purpose is not noticed: {loose}"
        )
    );
    assert_eq!(judged(&[], &[]), None);
}

/// Only what takes no time is measured before somebody stops it.
fn stopped(more: &[&str]) -> Done {
    let interrupt = Interrupt::default();
    interrupt.request();
    let (mut out, err) = (Vec::new(), Buffer::default());
    let mut context = Context {
        factory: &|_, _| Err(RolloutError::Stopped),
        interrupt,
        out: &mut out,
        err: err.clone().into(),
        live: false,
    };
    let arguments = ["optimise", "validate", "--threads", "1"].iter().chain(more);
    let result = execute(arguments, &mut context);
    let err = read(&err) + &result.as_ref().map_or_else(CliError::to_string, |()| String::new());
    Done { code: result.map_or_else(|error| error.code(), |()| 0), out: String::from_utf8(out).unwrap(), err }
}

#[test]
fn a_table_that_is_not_whole_says_so_first_and_is_not_kept() {
    let place = Place::new();
    let folder = place.text("kept");
    let done = stopped(&["--write", &folder]);
    assert!(done.code == 130 && done.err.contains("lines are measured"), "{}", done.err);
    assert!(
        done.out.starts_with("Not whole: stopped on request: ") && done.out.contains("key 20 deg"),
        "{}",
        done.out
    );
    assert_eq!(fs::read_dir(&folder).unwrap().count(), 0);
    let object: Value = serde_json::from_str(&stopped(&["--json"]).out).unwrap();
    assert!(object["failure"].as_str().is_some_and(|why| why.contains("lines are measured")), "{object}");
    let (lines, wanted) = (object["lines"].as_array().unwrap(), object["wanted"].as_u64().unwrap());
    assert!(!lines.is_empty() && (lines.len() as u64) < wanted);
    assert_eq!(object["no_longer_holds"], serde_json::json!([]));
    assert_eq!(object["lines"][0]["unit"], "deg");
}

#[test]
fn what_cannot_be_written_or_read_is_refused_before_anything_is_measured() {
    let place = Place::new();
    fs::write(place.path("file"), "").unwrap();
    let done = optimise(&["validate", "--write", &place.text("file/folder")]);
    assert_sentence(&done, 1, "cannot be written");
    assert_sentence(&optimise(&["validate", "bnch"]), 2, "did you mean `bench`?");
}

#[test]
fn some_lines_can_be_measured_without_the_others() {
    let done = optimise(&["validate", "--only", "Triaxial Compression, key 2", "--threads", "1"]);
    assert_eq!(done.code, 0, "{}", done.err);
    let (out, ends) = (&done.out, "key 20 deg");
    assert!(out.contains(ends) && out.contains("key 25 deg") && !out.contains("key 30 deg"), "{out}");
    let whole =
        "The powder of bench. Of 3 lines 0 fall short, 2 hold, and of 1 control 1 fails, as it must.\n";
    assert!(out.starts_with(whole), "{out}");
    for (words, scope, more) in [
        ("spoon", "--short", "14 with --full have"),
        ("sponn", "--full", "the groups are: friction angle of one particle; "),
    ] {
        let done = optimise(&["validate", scope, "--only", words]);
        assert_sentence(&done, 2, &format!("--only is `{words}`, but no line"));
        assert!(done.err.contains(more), "{}", done.err);
    }
}
