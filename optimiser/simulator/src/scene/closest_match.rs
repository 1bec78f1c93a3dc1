//! Suggestions for misspelt words.

/// How alike two words must be, from 0 to 1 by Jaro's measure, as clap has it for options.
const ALIKE: f64 = 0.7;

/// The one of `known` that is most like `word`; none if nothing is like it.
pub fn closest_match<'a>(word: &str, known: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    let likeness = |candidate: &str| strsim::jaro(&word.to_lowercase(), &candidate.to_lowercase());
    let alike = known.into_iter().map(|candidate| (candidate, likeness(candidate)));
    let alike = alike.filter(|(_, likeness)| *likeness > ALIKE);
    alike.max_by(|(_, a), (_, b)| a.total_cmp(b)).map(|(candidate, _)| candidate)
}

/// The question that ends a refusal of `word`, after a semicolon; empty if nothing is like it.
pub(super) fn did_you_mean<'a>(word: &str, known: impl IntoIterator<Item = &'a str>) -> String {
    closest_match(word, known).map_or_else(String::new, |meant| format!("; did you mean `{meant}`?"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_likest_word_is_meant_or_none() {
        let known = ["bench", "bench-small", "bench-fine"];
        for (word, meant) in [("bnch", "bench"), ("BENCH", "bench"), ("bench_smal", "bench-small")] {
            assert_eq!(closest_match(word, known), Some(meant), "{word}");
        }
        for word in ["", "x", "fine-bench", "kitchen sink"] {
            assert_eq!(did_you_mean(word, known), "", "{word}");
        }
        assert_eq!(did_you_mean("amout", ["amount", "all"]), "; did you mean `amount`?");
    }
}
