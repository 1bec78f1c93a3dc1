//! The page of a campaign: what came of it, a heat map, and all cases, the worst first.

use super::{Campaign, Case, Found, Outcome, Setting, Status, table::counts};
use crate::report::{amounts::percent, words::grouped};
use powderline_simulator::scene::figures::{count, mass};
use powderline_view::page::{Figure, Heat, HeatMap, Mark, MarkKind, Page, Row, Table, Tone};

/// Most rows of the page's table; the worst come first, and all are in the file beside it.
const MAX_ROWS: usize = 1_000;

/// Most columns of a heat map.
const MAX_COLUMNS: usize = 24;

/// The page; an outcome for each case, none for one that has not been run. `link` says where a case's report is, if there is one.
pub fn page(
    campaign: &Campaign,
    outcomes: &[Option<Outcome>],
    link: &dyn Fn(&Case<'_>) -> Option<String>,
) -> Page {
    let cases: Vec<(Case<'_>, &Outcome)> = campaign
        .cases()
        .zip(outcomes)
        .filter_map(|(case, outcome)| Some((case, outcome.as_ref()?)))
        .collect();
    let mut notes = vec![format!(
        "A result depends on its case alone, not on where or in which order cases were run. All of them, with every number, are in \
         {TABLE_FILE} beside this page."
    )];
    if cases.len() > MAX_ROWS {
        notes.push(format!(
            "Of {} cases the worst {} are shown.",
            grouped(cases.len() as i64),
            grouped(MAX_ROWS as i64)
        ));
    }
    Page {
        title: campaign.file().name.clone(),
        verdict: Some(verdict(campaign, outcomes)),
        figures: figures(campaign, outcomes),
        heat_maps: heat_map(campaign, outcomes).into_iter().collect(),
        tables: vec![rows(campaign, cases, link)],
        facts: facts(campaign),
        notes,
        ..Page::default()
    }
}

/// The table's file, beside the page.
pub const TABLE_FILE: &str = "table.parquet";

/// What is to be known first, in one sentence, and whether it is good.
pub fn verdict(campaign: &Campaign, outcomes: &[Option<Outcome>]) -> (Tone, String) {
    let [(_, failed), (_, missed), (_, done), (_, met)] = counts(outcomes);
    let open = outcomes.len() - failed - missed - done - met;
    let parts = [
        (failed, "failed"),
        (missed, "miss the wanted amount"),
        (open, "are still to be done"),
        (met, "bring it within the tolerance"),
        (done, if campaign.is_of_rollouts() { "are simulated" } else { "are done" }),
    ];
    let parts: Vec<String> = parts
        .iter()
        .filter(|(number, _)| *number > 0)
        .map(|(number, what)| format!("{} {what}", grouped(*number as i64)))
        .collect();
    let tone = match (failed + missed, open) {
        (0, 0) if !campaign.is_of_rollouts() => Tone::Good,
        (0, _) => Tone::Plain,
        _ => Tone::Bad,
    };
    (tone, format!("Of {}, {}.", count(outcomes.len() as i64, "case"), parts.join(", ")))
}

fn figures(campaign: &Campaign, outcomes: &[Option<Outcome>]) -> Vec<Figure> {
    let [(_, failed), (_, missed), (_, done), (_, met)] = counts(outcomes);
    let finished = failed + missed + done + met;
    let mut misses: Vec<f64> =
        outcomes.iter().flatten().filter_map(|o| Some(o.found()?.miss.abs())).collect();
    misses.sort_by(f64::total_cmp);
    let number = |name: &str, value: usize| Figure::new(name, &grouped(value as i64));
    let mut figures = vec![number("Cases", outcomes.len())];
    if finished < outcomes.len() {
        figures.push(number("Finished", finished));
    }
    // Where as much as can be had is wanted, nobody judges.
    if !campaign.is_of_rollouts() && met + missed > 0 {
        figures.push(number("Within the tolerance", met).toned(if met > 0 {
            Tone::Good
        } else {
            Tone::Plain
        }));
        figures.push(number("Missed", missed).toned(if missed > 0 { Tone::Bad } else { Tone::Plain }));
    }
    figures.push(number("Failed", failed).toned(if failed > 0 { Tone::Bad } else { Tone::Plain }));
    if let Some(worst) = misses.last() {
        let middle = median(&misses);
        figures.push(
            Figure::new("Median miss", &percent(middle)).with_note(&format!("the worst {}", percent(*worst))),
        );
    }
    figures
}

fn facts(campaign: &Campaign) -> Vec<(String, String)> {
    let file = campaign.file();
    let names =
        |names: Vec<String>, own: &str| if names.is_empty() { own.to_owned() } else { names.join(", ") };
    let powders = file.powder.iter().map(|powder| powder.name.clone()).collect();
    let amounts = file.amounts_kg.iter().map(|kg| mass(*kg)).collect();
    let mut facts = vec![
        ("Benches", campaign.benches().iter().map(|bench| bench.name.clone()).collect::<Vec<_>>().join(", ")),
        ("Powders", names(powders, "each bench's own")),
        ("Amounts", names(amounts, "each bench's own")),
        ("Seeds", grouped(file.seeds.len() as i64)),
    ];
    if let Some(draws) = &file.draws {
        let what = draws.powder.keys().cloned().collect::<Vec<_>>().join(", ");
        facts.push(("Draws", format!("{} of {what}", grouped(draws.count.into()))));
    }
    facts.push(match file.theta {
        Some(theta) => ("Each case", format!("one rollout of theta = {theta:?}")),
        None => ("Each case", "a search".into()),
    });
    facts.into_iter().map(|(name, value)| (name.into(), value)).collect()
}

/// How bad a case is: what failed comes first, then what is off by most.
fn badness(outcome: &Outcome) -> f64 {
    outcome.found().map_or(f64::INFINITY, |found| found.miss.abs())
}

fn rows(
    campaign: &Campaign,
    mut cases: Vec<(Case<'_>, &Outcome)>,
    link: &dyn Fn(&Case<'_>) -> Option<String>,
) -> Table {
    cases.sort_by(|(_, a), (_, b)| badness(b).total_cmp(&badness(a)));
    let signed = |miss: f64| format!("{}{}", if miss > 0.0 { "+" } else { "" }, percent(miss));
    let cell = |outcome: &Outcome, text: &dyn Fn(&Found) -> String| outcome.found().map_or("-".into(), text);
    let of_search = !campaign.is_of_rollouts();
    let row = |(case, outcome): &(Case<'_>, &Outcome)| {
        let mut cells = vec![
            case.name.clone(),
            cell(outcome, &|found| mass(found.wanted_kg)),
            cell(outcome, &|found| mass(found.mass_kg)),
            cell(outcome, &|found| signed(found.miss)),
            cell(outcome, &|found| mass(found.lost_kg)),
            cell(outcome, &|found| format!("{:.3}", found.loss_m)),
        ];
        if of_search {
            cells.push(cell(outcome, &|found| found.epochs.map_or("-".into(), |[last, _]| last.to_string())));
        }
        let mark = match outcome.status() {
            Status::Failed => Some(Mark {
                kind: MarkKind::PassedOver,
                label: "failed".into(),
                note: outcome.error().unwrap_or_default().into(),
            }),
            Status::Missed => {
                Some(Mark { kind: MarkKind::PassedOver, label: "missed".into(), note: String::new() })
            }
            Status::Done | Status::Met => None,
        };
        Row::from(cells).marked(mark).linked(link(case))
    };
    let mut columns = vec!["case", "wanted", "arrives", "miss", "lost", "loss, m"];
    columns.extend(of_search.then_some("epochs"));
    Table {
        title: "Cases, the worst first".into(),
        columns: columns.into_iter().map(String::from).collect(),
        rows: cases.iter().take(MAX_ROWS).map(row).collect(),
    }
}

/// Powders against amounts, for each bench: of each the median miss over draws and seeds. Nothing where a table of one cell would be
/// all, or one too wide.
fn heat_map(campaign: &Campaign, outcomes: &[Option<Outcome>]) -> Option<HeatMap> {
    let file = campaign.file();
    let by_seed = file.amounts_kg.len() < 2 && campaign.setting(0).draw.is_none();
    let seeds = file.seeds.len();
    let columns: Vec<String> = match by_seed {
        true => (0..seeds.min(1 + MAX_COLUMNS as u64))
            .map(|index| format!("seed {}", campaign.case(index).seed))
            .collect(),
        false if file.amounts_kg.is_empty() => vec!["all draws".into()],
        false => file.amounts_kg.iter().map(|kg| mass(*kg)).collect(),
    };
    let several = campaign.benches().len() > 1;
    let name = |setting: &Setting<'_>| match setting.powder() {
        Some(powder) if several => format!("{}, {powder}", setting.bench()),
        Some(powder) => powder.to_owned(),
        None => setting.bench().to_owned(),
    };
    let row_count = campaign.benches().len() * file.powder.len().max(1);
    if columns.len() > MAX_COLUMNS || columns.len() * row_count < 2 {
        return None;
    }
    let column_of = |case: &Case<'_>| match by_seed {
        true => (case.index % seeds) as usize,
        false => file.amounts_kg.iter().position(|kg| Some(*kg) == case.setting.amount_kg).unwrap_or(0),
    };
    let mut cells: Vec<Vec<Vec<&Outcome>>> = vec![vec![Vec::new(); columns.len()]; row_count];
    let mut names = vec![String::new(); row_count];
    let per_row = campaign.case_count() / row_count as u64;
    for (case, outcome) in campaign.cases().zip(outcomes) {
        let row = (case.index / per_row) as usize;
        if names[row].is_empty() {
            names[row] = name(&case.setting);
        }
        cells[row][column_of(&case)].extend(outcome);
    }
    let rows = names
        .into_iter()
        .zip(cells)
        .map(|(name, row)| (name, row.into_iter().map(|cell| heat(&cell)).collect()));
    Some(HeatMap {
        title: "Miss, the median of each cell".into(),
        axes: [
            if file.powder.is_empty() { "bench" } else { "powder" }.into(),
            if by_seed { "seed" } else { "amount" }.into(),
        ],
        columns,
        rows: rows.collect(),
    })
}

/// Of numbers in order, at least one: the middle one, or the mean of the two in the middle.
fn median(ordered: &[f64]) -> f64 {
    let half = ordered.len() / 2;
    if ordered.len() % 2 == 1 { ordered[half] } else { 0.5 * (ordered[half - 1] + ordered[half]) }
}

/// What several cases came to.
fn heat(cases: &[&Outcome]) -> Option<Heat> {
    let misses: Vec<f64> = cases.iter().filter_map(|outcome| Some(outcome.found()?.miss)).collect();
    let failed = cases.len() - misses.len();
    if cases.is_empty() {
        return None;
    }
    if misses.is_empty() {
        return Some(Heat { text: "failed".into(), tone: Tone::Bad, strength: 1.0, ..Heat::default() });
    }
    let mut sizes: Vec<f64> = misses.iter().map(|miss| miss.abs()).collect();
    sizes.sort_by(f64::total_cmp);
    let median = median(&sizes);
    let number_of = |status: Status| cases.iter().filter(|outcome| outcome.status() == status).count();
    let met = number_of(Status::Met);
    // Nobody judges a rollout of a skill that was given, nor one of which as much as can be had is wanted.
    let is_judged = met + number_of(Status::Missed) > 0;
    let mut note =
        if is_judged { format!("{met} of {} met", cases.len()) } else { count(cases.len() as i64, "case") };
    if failed > 0 {
        note += &format!(", {failed} failed");
    }
    let sign = match median > 0.0 {
        false => "",
        true if misses.iter().all(|miss| *miss >= 0.0) => "+",
        true if misses.iter().all(|miss| *miss <= 0.0) => "-",
        true => "±",
    };
    Some(Heat {
        text: format!("{sign}{}", percent(median)),
        note,
        tone: match is_judged {
            true if met == cases.len() => Tone::Good,
            true => Tone::Bad,
            false => Tone::Plain,
        },
        // Small misses are told apart, and large ones too: a root.
        strength: if met == cases.len() { 1.0 } else { median.sqrt() },
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::campaign::{End, Found};
    use crate::report::amounts::Amounts;
    use powderline_simulator::{rollout::Census, rollout::Evaluation, scene::Scene, skill::Theta};

    /// Nobody judges where as much as can be had is wanted, or where a skill is given.
    #[test]
    fn a_cell_is_good_or_bad_only_where_somebody_judges() {
        let amounts = Amounts::from(&Scene::load("bench").unwrap());
        let census = Census { target: 900, ..Census::default() };
        let found = Found::of_rollout(&amounts, Theta::MIDDLE, &Evaluation::new(1.0, 300, census));
        let of = |met: Option<bool>| Outcome {
            key: String::new(),
            end: End::Found(Found { met, ..found.clone() }),
        };
        let failed = Outcome { key: String::new(), end: End::Error("no".into()) };
        let cell = |outcomes: &[&Outcome]| heat(outcomes).map(|heat| (heat.tone, heat.note));
        let (done, met, missed) = (of(None), of(Some(true)), of(Some(false)));
        for (outcomes, tone, note) in [
            ([&done, &done], Tone::Plain, "2 cases"),
            ([&met, &met], Tone::Good, "2 of 2 met"),
            ([&met, &missed], Tone::Bad, "1 of 2 met"),
            ([&met, &failed], Tone::Bad, "1 of 2 met, 1 failed"),
            ([&done, &failed], Tone::Plain, "2 cases, 1 failed"),
        ] {
            assert_eq!(cell(&outcomes), Some((tone, note.to_owned())));
        }
        assert_eq!(cell(&[&failed]), Some((Tone::Bad, String::new())));
    }

    #[test]
    fn a_cell_has_the_median_of_how_far_its_cases_are_off() {
        let amounts = Amounts::from(&Scene::load("bench").unwrap());
        let text = |arrive: &[u32]| {
            let outcome = |target: &u32| {
                let census = Census { target: *target, ..Census::default() };
                let found = Found::of_rollout(&amounts, Theta::MIDDLE, &Evaluation::new(1.0, 300, census));
                Outcome { key: String::new(), end: End::Found(found) }
            };
            let outcomes: Vec<Outcome> = arrive.iter().map(outcome).collect();
            heat(&outcomes.iter().collect::<Vec<_>>()).unwrap().text
        };
        // 1,200 are wanted.
        assert_eq!(text(&[1188, 1680]), "±20 %");
        assert_eq!(text(&[1320, 1440]), "+15 %");
        assert_eq!(text(&[1080, 1188, 600]), "-10 %");
        assert_eq!(text(&[1200]), "0 %");
    }
}
