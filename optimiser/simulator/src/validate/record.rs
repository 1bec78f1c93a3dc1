//! Tables that are kept: what they were made by, and how they are written.

use std::fmt::Write;

use serde::{Deserialize, Serialize};

use crate::validate::{Line, Scope, Table, figure, quantity};

/// A table in a file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct Record {
    /// The command that made it.
    pub command: String,
    /// The commit that was measured, as whoever gave the command said.
    pub commit: String,
    /// What it found.
    #[serde(flatten)]
    pub table: Table,
}

impl Record {
    /// A table with its origin.
    pub fn new(command: &str, commit: &str, table: Table) -> Self {
        Self { command: command.into(), commit: commit.into(), table }
    }

    /// The table of the default scene that came with the program: what held when it was made has to hold now.
    pub fn committed(scope: Scope) -> Self {
        let text = match scope {
            Scope::Short => include_str!("../../validation/short.json"),
            Scope::Full => include_str!("../../validation/full.json"),
        };
        serde_json::from_str(text).expect("written by this program")
    }

    /// The file's text.
    pub fn json(&self) -> String {
        serde_json::to_string_pretty(self).expect("numbers and strings") + "\n"
    }

    /// The same for people, what falls short first.
    pub fn markdown(&self) -> String {
        let mut out = String::new();
        // Writing to a string does not fail.
        let _ = self.write(&mut out);
        out
    }

    fn write(&self, out: &mut String) -> std::fmt::Result {
        let Self { command, commit, table } = self;
        writeln!(out, "`{command}` of commit {commit} made this.")?;
        writeln!(out, "\n{}\n", table.summary())?;
        let bad = table.lines.iter().filter(|line| !line.verdict.is_good());
        for line in bad {
            writeln!(out, "- {}: {}", line.name, line.sentence)?;
        }
        let mut group = "";
        for block in table.blocks() {
            if group != block[0].group {
                group = &block[0].group;
                writeln!(out, "\n## {}", capital(group))?;
            }
            writeln!(out, "\n| | measured | reference | tolerance | |\n|---|---|---|---|---|")?;
            block.iter().try_for_each(|line| writeln!(out, "{}", row(line)))?;
            writeln!(out, "\nReference: {}. Tolerance: {}.", block[0].source, block[0].why)?;
        }
        Ok(())
    }
}

fn row(line: &Line) -> String {
    let Line { name, unit, reference, tolerance: [low, high], verdict, .. } = line;
    let verdict = verdict.words();
    let verdict = if line.verdict.is_good() { verdict.to_owned() } else { format!("**{verdict}**") };
    format!(
        "| {name} | {} | {} | {} to {} | {verdict} |",
        line.measured_words(),
        quantity(*reference, unit),
        figure(*low),
        figure(*high)
    )
}

fn capital(words: &str) -> String {
    let mut letters = words.chars();
    letters.next().map_or(String::new(), |first| first.to_uppercase().chain(letters).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    #[test]
    fn what_is_committed_is_whole_and_comes_back_as_it_was_written() {
        for scope in [Scope::Short, Scope::Full] {
            let record = Record::committed(scope);
            let table = &record.table;
            assert!(table.is_whole() && table.scope == scope && table.wanted > 50, "{}", table.wanted);
            let names: BTreeSet<_> = table.lines.iter().map(|line| &line.name).collect();
            assert_eq!(names.len(), table.lines.len(), "two lines have the same name");
            assert_eq!(serde_json::from_str::<Record>(&record.json()).unwrap(), record);
        }
        let short = Record::committed(Scope::Short).table;
        let full = Record::committed(Scope::Full).table;
        assert!(
            short.lines.iter().all(|line| full.line(&line.name).is_some()),
            "all that is short is in full"
        );
    }

    #[test]
    fn the_page_is_that_of_the_committed_table() {
        let record = Record::committed(Scope::Full);
        // Not printed: it is long.
        assert!(
            record.markdown() == include_str!("../../validation/full.md"),
            "full.md is not what full.json says"
        );
    }

    #[test]
    fn the_page_says_what_falls_short_before_any_table() {
        let record = Record::committed(Scope::Full);
        let page = record.markdown();
        let (list, tables) = page.split_once("\n## ").unwrap();
        for line in &record.table.lines {
            assert!(list.contains(&line.sentence), "{}", line.name);
            assert_eq!(
                list.contains(&format!("- {}: ", line.name)),
                !line.verdict.is_good(),
                "{}",
                line.name
            );
            assert!(tables.contains(&format!("\n| {} | ", line.name)), "{}", line.name);
            assert!(tables.contains(&line.source) && tables.contains(&line.why), "{}", line.name);
        }
    }
}
