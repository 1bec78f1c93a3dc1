//! `optimise validate` as a program: the short table is what it was.

use std::process::{Command, Output};

use powderline_simulator::validate::{Record, Scope, Table};

/// What makes the table anew that is compared with.
const MAKE: &str = "optimise validate --short --write optimiser/simulator/validation --commit HASH";

fn optimise(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_optimise")).args(arguments).output().unwrap()
}

#[test]
fn the_short_table_is_the_committed_one_to_every_digit() {
    let output = optimise(&["validate", "--short", "--json"]);
    let said = String::from_utf8(output.stdout).unwrap();
    assert_eq!(said.lines().count(), 1, "one object and nothing else");
    let now: Table = serde_json::from_str(&said).unwrap();
    let before = Record::committed(Scope::Short).table;
    for line in &now.lines {
        let was = before.line(&line.name);
        assert!(
            was == Some(line),
            "it is {line:?}\nand was {was:?}\nIf that is meant, make the table anew: {MAKE}"
        );
    }
    assert!(now == before, "lines are missing, or their order has changed; make the table anew: {MAKE}");
    assert_eq!((output.status.code(), output.stderr.as_slice()), (Some(0), &b""[..]));
}
