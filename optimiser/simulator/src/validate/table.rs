//! The table: what a line says, what it is compared with, and how it is written.

use serde::{Deserialize, Serialize};

use crate::validate::Scope;
use crate::validate::case::{Claim, Found, Halt};

/// How far a number agrees with its reference.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// It lies within the tolerance.
    Holds,
    /// It does not.
    FallsShort,
    /// A control: something is broken on purpose, and the number lies outside the tolerance.
    FailsAsItMust,
    /// A control that lies within it: the line that it is the control of proves nothing.
    DoesNotFail,
}

impl Verdict {
    /// As it is, or as it has to be.
    pub fn is_good(self) -> bool {
        matches!(self, Self::Holds | Self::FailsAsItMust)
    }

    /// In words.
    pub fn words(self) -> &'static str {
        match self {
            Self::Holds => "holds",
            Self::FallsShort => "falls short",
            Self::FailsAsItMust => "fails, as it must",
            Self::DoesNotFail => "does not fail, and must",
        }
    }
}

/// One number, what it should be, and who says so.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct Line {
    /// What kind of measurement it is.
    pub group: String,
    /// What is measured; no two lines have the same.
    pub name: String,
    /// The number, of four digits; the median if there are several seeds. None if the powder could not be
    /// simulated.
    pub measured: Option<f64>,
    /// Of several seeds the number that is farthest from the reference: the one that is judged.
    pub worst: Option<f64>,
    /// Empty for a ratio.
    pub unit: String,
    /// What it should be.
    pub reference: f64,
    /// Where the reference comes from.
    pub source: String,
    /// Lowest and highest number that will do.
    pub tolerance: [f64; 2],
    /// Why these.
    pub why: String,
    /// What comes of it.
    pub verdict: Verdict,
    /// What is wrong, in a sentence; empty where nothing is.
    pub sentence: String,
}

impl Line {
    /// What was found with each seed; `None` if not all were measured.
    pub(super) fn new(claim: &Claim, found: &[Result<f64, Halt>]) -> Option<Self> {
        let mut numbers = Vec::with_capacity(found.len());
        let mut failure = None;
        for found in found {
            match found {
                Ok(number) if number.is_finite() => numbers.push(readable(*number, claim.tolerance)),
                Ok(_) => failure = Some("what it left could not be measured".to_owned()),
                Err(Halt::Failed(what)) => failure = Some(what.clone()),
                Err(Halt::Stopped) => return None,
            }
        }
        numbers.sort_by(f64::total_cmp);
        let far = |number: &f64| (number - claim.reference).abs();
        let worst = numbers.iter().copied().max_by(|a, b| far(a).total_cmp(&far(b)));
        let worst = worst.filter(|_| failure.is_none());
        let [low, high] = claim.tolerance;
        let within = worst.is_some_and(|worst| (low..=high).contains(&worst));
        let verdict = match (claim.control, within) {
            (false, true) => Verdict::Holds,
            (false, false) => Verdict::FallsShort,
            (true, false) if worst.is_some() => Verdict::FailsAsItMust,
            (true, _) => Verdict::DoesNotFail,
        };
        let sentence = match (verdict, failure, worst) {
            (Verdict::FallsShort | Verdict::DoesNotFail, Some(what), _) => {
                format!("Nothing was measured: {what}.")
            }
            (Verdict::FallsShort, _, Some(worst)) => sentence(claim, worst),
            (Verdict::DoesNotFail, ..) => "What was broken on purpose is not noticed.".into(),
            _ => String::new(),
        };
        Some(Self {
            group: claim.group.into(),
            name: claim.name.clone(),
            measured: worst.map(|_| numbers[numbers.len() / 2]),
            worst: worst.filter(|_| found.len() > 1),
            unit: claim.unit.into(),
            reference: rounded(claim.reference, 4),
            source: claim.source.into(),
            tolerance: claim.tolerance.map(|end| rounded(end, 4)),
            why: claim.why.into(),
            verdict,
            sentence,
        })
    }
}

impl Line {
    /// The number with its unit, and the worst one where there are several.
    pub fn measured_words(&self) -> String {
        match (self.measured, self.worst) {
            (None, _) => "nothing".into(),
            (Some(median), None) => quantity(median, &self.unit),
            (Some(median), Some(worst)) => {
                format!("{}, at worst {}", figure(median), quantity(worst, &self.unit))
            }
        }
    }
}

/// What is wrong with a number outside the tolerance, and by how much.
fn sentence(claim: &Claim, number: f64) -> String {
    let wrong = claim.wrong[usize::from(number > claim.reference)];
    let by = (number - claim.reference).abs();
    let by = match claim.unit {
        "" if claim.reference != 0.0 => format!("{:.0} %", 100.0 * by / claim.reference.abs()),
        unit => quantity(rounded(by, 2), unit),
    };
    format!("{}.", wrong.replace("{}", &by))
}

/// So many digits.
fn rounded(number: f64, digits: usize) -> f64 {
    // Adding 0 makes nothing of a negative nothing.
    format!("{number:.*e}", digits - 1).parse().unwrap_or(number) + 0.0
}

/// Four digits, and nothing for what the tolerance cannot see.
fn readable(number: f64, [low, high]: [f64; 2]) -> f64 {
    if number.abs() < 1e-4 * (high - low) { 0.0 } else { rounded(number, 4) }
}

/// A number of four digits as people write it.
pub fn figure(number: f64) -> String {
    let size = number.abs();
    if size != 0.0 && !(1e-3..1e5).contains(&size) { format!("{number:e}") } else { format!("{number}") }
}

/// A number with its unit.
pub fn quantity(number: f64, unit: &str) -> String {
    [&figure(number), unit].join(if unit.is_empty() { "" } else { " " })
}

/// Puts groups together, and in them what has the same source and reason; otherwise everything stays in its
/// order.
fn arrange(lines: &mut [Line]) {
    let keys: Vec<_> =
        lines.iter().map(|line| (line.group.clone(), line.source.clone(), line.why.clone())).collect();
    lines.sort_by_cached_key(|line| {
        let group = keys.iter().position(|key| key.0 == line.group);
        (
            group,
            keys.iter().position(|key| (&key.0, &key.1, &key.2) == (&line.group, &line.source, &line.why)),
        )
    });
}

/// Whether one of these names has these words in it, capital letters or not.
pub(super) fn has(words: &str, names: [&str; 2]) -> bool {
    names.iter().any(|name| name.to_lowercase().contains(&words.to_lowercase()))
}

/// All lines of one scene's powder.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct Table {
    /// Whose law of the powder and numerics it is.
    pub scene: String,
    /// Which lines were to be measured.
    pub scope: Scope,
    /// [`crate::PHYSICS_VERSION`]
    pub physics: u32,
    /// How many lines were to be measured: fewer are there if it was stopped.
    pub wanted: usize,
    /// The lines, by group.
    pub lines: Vec<Line>,
}

impl Table {
    pub(super) fn new(scene: &str, scope: Scope, measured: &[(Vec<Claim>, Vec<Found>)]) -> Self {
        let mut lines = Vec::new();
        for (claims, found) in measured {
            for (index, claim) in claims.iter().enumerate() {
                let of_line =
                    |found: &Found| found.as_ref().map(|numbers| numbers[index]).map_err(Halt::clone);
                lines.extend(Line::new(claim, &found.iter().map(of_line).collect::<Vec<_>>()));
            }
        }
        arrange(&mut lines);
        Self {
            scene: scene.into(),
            scope,
            physics: crate::PHYSICS_VERSION,
            wanted: measured.iter().map(|(claims, _)| claims.len()).sum(),
            lines,
        }
    }

    /// Whether all lines are there.
    pub fn is_whole(&self) -> bool {
        self.lines.len() == self.wanted
    }

    /// Lines of one verdict.
    pub fn with(&self, verdict: Verdict) -> impl Iterator<Item = &Line> {
        self.lines.iter().filter(move |line| line.verdict == verdict)
    }

    /// How many lines there are of each kind, in a sentence.
    pub fn summary(&self) -> String {
        let count = |verdict| self.with(verdict).count();
        let verb =
            |count: usize, one: &str, more: &str| format!("{count} {}", if count == 1 { one } else { more });
        let (failing, loose) = (count(Verdict::FailsAsItMust), count(Verdict::DoesNotFail));
        let end = if loose > 0 { format!("; {}", verb(loose, "does not", "do not")) } else { String::new() };
        format!(
            "Of {} lines {}, {}, and of {} {}{end}.",
            self.lines.len(),
            verb(count(Verdict::FallsShort), "falls short", "fall short"),
            verb(count(Verdict::Holds), "holds", "hold"),
            verb(failing + loose, "control", "controls"),
            verb(failing, "fails, as it must", "fail, as they must"),
        )
    }

    /// The line of this name.
    pub fn line(&self, name: &str) -> Option<&Line> {
        self.lines.iter().find(|line| line.name == name)
    }

    /// The table of those lines that have these words in their name or that of their group.
    #[must_use]
    pub fn only(mut self, words: &str) -> Self {
        self.lines.retain(|line| has(words, [&line.group, &line.name]));
        self.wanted = self.lines.len();
        self
    }

    /// Names of the lines that were as they should be in another table and are not so here; in a whole table
    /// those that are not there count, too.
    pub fn no_longer_good(&self, before: &Self) -> Vec<String> {
        let was_good = before.lines.iter().filter(|line| line.verdict.is_good());
        let lost = was_good.filter(|was| match self.line(&was.name) {
            Some(line) => !line.verdict.is_good(),
            None => self.is_whole(),
        });
        lost.map(|line| line.name.clone()).collect()
    }

    /// Lines of one group after the other, and within them those with the same source and the same reason
    /// together.
    pub fn blocks(&self) -> impl Iterator<Item = &[Line]> {
        self.lines.chunk_by(|a, b| (&a.group, &a.source, &a.why) == (&b.group, &b.source, &b.why))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn claim(name: &str, control: bool) -> Claim {
        Claim {
            group: "group",
            name: name.into(),
            unit: "",
            reference: 2.0,
            tolerance: [1.5, 2.5],
            source: "source",
            why: "why",
            wrong: ["It is {} too low", "It is {} too high"],
            control,
        }
    }

    fn line(control: bool, found: &[f64]) -> Line {
        let found: Vec<_> = found.iter().map(|number| Ok(*number)).collect();
        Line::new(&claim("line", control), &found).unwrap()
    }

    #[test]
    fn lines_are_named_by_their_group_or_themselves() {
        let names = ["what a spoon holds", "heaped Bowl"];
        for (words, want) in
            [("spoon", true), ("bowl", true), ("SPOON H", true), ("", true), ("scoop", false)]
        {
            assert_eq!(has(words, names), want, "{words}");
        }
    }

    #[test]
    fn a_line_is_judged_by_its_worst_seed_and_shows_the_median() {
        let good = line(false, &[2.123_456]);
        assert_eq!((good.measured, good.worst, good.verdict), (Some(2.123), None, Verdict::Holds));
        assert_eq!((good.sentence.as_str(), good.measured_words().as_str()), ("", "2.123"));
        let bad = line(false, &[2.1, 1.0, 2.4]);
        assert_eq!((bad.measured, bad.worst, bad.verdict), (Some(2.1), Some(1.0), Verdict::FallsShort));
        assert_eq!(
            (bad.sentence.as_str(), bad.measured_words().as_str()),
            ("It is 50 % too low.", "2.1, at worst 1")
        );
        assert_eq!(line(false, &[2.1, 3.0]).sentence, "It is 50 % too high.");
        // Both ends belong to what will do.
        assert!([1.5, 2.5].iter().all(|end| line(false, &[*end]).verdict == Verdict::Holds));
    }

    #[test]
    fn a_control_has_to_fail_and_by_a_number() {
        assert_eq!(line(true, &[3.0]).verdict, Verdict::FailsAsItMust);
        let loose = line(true, &[2.0]);
        assert_eq!(loose.verdict, Verdict::DoesNotFail);
        assert!(!loose.verdict.is_good() && loose.sentence.contains("not noticed"));
        // Powder that blows up is no proof.
        assert_eq!(line(true, &[f64::NAN]).verdict, Verdict::DoesNotFail);
    }

    #[test]
    fn what_could_not_be_simulated_falls_short_and_says_why() {
        let gone = [Ok(2.0), Err(Halt::Failed("particle 3 left".into()))];
        let line = Line::new(&claim("line", false), &gone).unwrap();
        assert_eq!((line.measured, line.verdict), (None, Verdict::FallsShort));
        assert_eq!(line.sentence, "Nothing was measured: particle 3 left.");
        assert_eq!(line.measured_words(), "nothing");
        assert_eq!(Line::new(&claim("line", false), &[Ok(2.0), Err(Halt::Stopped)]), None);
    }

    #[test]
    fn numbers_have_four_digits() {
        for (number, words) in [
            (0.123_456, "0.1235"),
            (123_456.0, "1.235e5"),
            (1234.56, "1235"),
            (-0.000_123_456, "-1.235e-4"),
            (0.0, "0"),
            (100.0, "100"),
        ] {
            assert_eq!(figure(rounded(number, 4)), words);
        }
        assert_eq!((quantity(2.0, "deg"), quantity(2.0, "")), ("2 deg".into(), "2".into()));
        // What is nothing beside the tolerance is nothing, and without a sign.
        assert_eq!(figure(readable(-1e-9, [-0.1, 0.1])), "0");
        assert_eq!(figure(readable(-1e-3, [-0.1, 0.1])), "-0.001");
        assert_eq!(figure(rounded(-0.0, 4)), "0");
    }

    fn table(lines: &[(&str, f64, bool)], wanted: usize) -> Table {
        let cases: Vec<_> = lines
            .iter()
            .map(|(name, number, control)| (vec![claim(name, *control)], vec![Ok(vec![*number])]))
            .collect();
        Table { wanted, ..Table::new("scene", Scope::Short, &cases) }
    }

    #[test]
    fn what_no_longer_holds_is_named_and_what_never_did_is_not() {
        let before = table(&[("a", 2.0, false), ("b", 9.0, false), ("c", 9.0, true), ("d", 2.0, false)], 4);
        let after = table(&[("a", 9.0, false), ("b", 8.0, false), ("c", 2.0, true), ("new", 9.0, false)], 4);
        assert_eq!(after.no_longer_good(&before), ["a", "c", "d"]);
        // What is not there yet is not lost.
        let unfinished = Table { wanted: 5, ..after };
        assert_eq!(unfinished.no_longer_good(&before), ["a", "c"]);
        assert_eq!(before.no_longer_good(&before), [""; 0]);
    }

    #[test]
    fn lines_stand_by_group_and_source_in_their_order() {
        let place = |name: &str, group, source| Claim { group, source, ..claim(name, false) };
        let claims = vec![
            place("1", "x", "s"),
            place("2", "y", "s"),
            place("3", "x", "t"),
            place("4", "x", "s"),
            place("5", "y", "s"),
        ];
        let table = Table::new("scene", Scope::Full, &[(claims, vec![Ok(vec![2.0; 5])])]);
        let blocks: Vec<Vec<&str>> =
            table.blocks().map(|block| block.iter().map(|line| line.name.as_str()).collect()).collect();
        assert_eq!(blocks, [vec!["1", "4"], vec!["3"], vec!["2", "5"]]);
    }

    #[test]
    fn lines_of_a_case_that_was_stopped_are_missing() {
        let cases = [
            (vec![claim("a", false)], vec![Ok(vec![2.0])]),
            (vec![claim("b", false)], vec![Ok(vec![2.0]), Err(Halt::Stopped)]),
        ];
        let table = Table::new("scene", Scope::Short, &cases);
        assert_eq!((table.lines.len(), table.wanted, table.is_whole()), (1, 2, false));
    }

    #[test]
    fn the_summary_counts_every_line() {
        let lines =
            [("a", 2.0, false), ("b", 9.0, false), ("c", 9.0, true), ("d", 2.0, true), ("e", 2.0, false)];
        let words = "Of 5 lines 1 falls short, 2 hold, and of 2 controls 1 fails, as it must; 1 does not.";
        assert_eq!(table(&lines, 5).summary(), words);
        let words = "Of 3 lines 1 falls short, 1 holds, and of 1 control 1 fails, as it must.";
        assert_eq!(table(&lines[..3], 3).summary(), words);
    }
}
