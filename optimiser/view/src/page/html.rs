//! The page's text. Scripts and styles are files of `assets/page`; the library of `assets/three` goes in deflated.

use std::fmt::Write as _;
use std::io::Write as _;

use base64::Engine as _;
use flate2::{Compression, write::ZlibEncoder};
use serde::Serialize;

use super::{Figure, Heat, HeatMap, Mark, MarkKind, Page, Replay, Row, Table, Tone};

const STYLE: &str = include_str!("../../assets/page/style.css");
const CHARTS_SCRIPT: &str = include_str!("../../assets/page/charts.js");
const REPLAY_SECTION: &str = include_str!("../../assets/page/replay.html");
const POWDER_SCRIPT: &str = include_str!("../../assets/page/powder.js");
const VIEWER_SCRIPT: &str = include_str!("../../assets/page/viewer.js");

/// Files of the library, with the `id` by which the viewer finds them.
const LIBRARY: [(&str, &str); 3] = [
    ("three-core", include_str!("../../assets/three/three.core.min.js")),
    ("three-module", include_str!("../../assets/three/three.module.min.js")),
    ("three-orbit", include_str!("../../assets/three/OrbitControls.js")),
];
const LIBRARY_LICENCE: &str = include_str!("../../assets/three/LICENSE");

/// The browser itself sees to it that the page asks for nothing.
const POLICY: &str = "default-src 'none'; style-src 'unsafe-inline'; script-src 'unsafe-inline' blob:; \
                      img-src data: blob:";

pub(super) fn page(page: &Page) -> String {
    let title = escaped(&page.title);
    let mut html = format!(
        "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
         <meta http-equiv=\"Content-Security-Policy\" content=\"{POLICY}\">\n\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n\
         <meta name=\"color-scheme\" content=\"light dark\">\n\
         <title>{title}</title>\n<link rel=\"icon\" href=\"data:,\">\n<style>\n{STYLE}</style>\n</head>\n<body>\n\
         <header>\n<h1>{title}</h1>\n{}{}</header>\n<main>\n",
        page.verdict.as_ref().map(verdict).unwrap_or_default(),
        figures(&page.figures),
    );
    if page.replay.is_some() {
        html += &REPLAY_SECTION.replace("{shows}", &escaped(&page.replay_shows));
    }
    if !page.charts.is_empty() {
        html += "<section id=\"charts\" class=\"charts\" aria-label=\"Charts\">\
                 <noscript>Curves and replay need JavaScript.</noscript></section>\n";
    }
    html += &page.heat_maps.iter().map(heat_map).collect::<String>();
    html += &tables(page);
    if !page.notes.is_empty() {
        let paragraphs: String =
            page.notes.iter().map(|note| format!("<p>{}</p>\n", escaped(note))).collect();
        let _ = write!(html, "<section class=\"notes\" aria-label=\"Notes\">\n{paragraphs}</section>\n");
    }
    html += "</main>\n";
    html += &footer(page.replay.is_some());
    if !page.charts.is_empty() {
        html += &data("charts-data", &page.charts);
        html += &script(CHARTS_SCRIPT);
    }
    if let Some(replay) = &page.replay {
        html += &replay_parts(replay);
    }
    html + "</body>\n</html>\n"
}

/// What the replay is made of: data, library and scripts.
fn replay_parts(replay: &Replay) -> String {
    let library: String = LIBRARY.iter().map(|(id, text)| blob(id, &deflated(text))).collect();
    data("replay-data", &replay.about)
        + &blob("replay-powder", &replay.powder)
        + &library
        + &script(&format!("{POWDER_SCRIPT}\n{VIEWER_SCRIPT}"))
}

fn verdict((tone, text): &(Tone, String)) -> String {
    format!("<p class=\"verdict {}\">{}</p>\n", tone_class(*tone), escaped(text))
}

fn tone_class(tone: Tone) -> &'static str {
    match tone {
        Tone::Good => "good",
        Tone::Bad => "bad",
        Tone::Plain => "plain",
    }
}

fn figures(figures: &[Figure]) -> String {
    if figures.is_empty() {
        return String::new();
    }
    let note = |note: &str| match note {
        "" => String::new(),
        note => format!("<dd class=\"small\">{}</dd>", escaped(note)),
    };
    let entry = |figure: &Figure| {
        format!(
            "<div class=\"{}\"><dt>{}</dt><dd>{}</dd>{}</div>\n",
            tone_class(figure.tone),
            escaped(&figure.name),
            escaped(&figure.value),
            note(&figure.note)
        )
    };
    format!("<dl class=\"figures\">\n{}</dl>\n", figures.iter().map(entry).collect::<String>())
}

fn tables(page: &Page) -> String {
    let tables: String = page.tables.iter().map(table).collect();
    if tables.is_empty() && page.facts.is_empty() {
        return String::new();
    }
    format!("<div class=\"tables\">\n{}{tables}</div>\n", facts(&page.facts))
}

fn facts(facts: &[(String, String)]) -> String {
    if facts.is_empty() {
        return String::new();
    }
    let entry = |(name, value): &(String, String)| {
        format!("<div><dt>{}</dt><dd>{}</dd></div>\n", escaped(name), escaped(value))
    };
    format!(
        "<section class=\"facts\" aria-labelledby=\"facts-title\">\n<h2 id=\"facts-title\">What this is</h2>\n\
         <dl>\n{}</dl>\n</section>\n",
        facts.iter().map(entry).collect::<String>()
    )
}

fn table(table: &Table) -> String {
    let is_marked = table.rows.iter().any(|row| row.mark.is_some());
    let class = |column: usize| if is_numeric(table, column) { " class=\"number\"" } else { "" };
    // Where there is no room for a head, each cell says what it is.
    let is_wide = table.columns.len() + usize::from(is_marked) > 4;
    let name = |column: usize| match table.columns.get(column) {
        Some(name) if is_wide => format!(" data-name=\"{}\"", escaped(name)),
        _ => String::new(),
    };
    let head = |(column, name): (usize, &String)| {
        format!("<th scope=\"col\"{}>{}</th>", class(column), escaped(name))
    };
    let cell = |row: &Row, column: usize, text: &str| match (column, &row.link) {
        (0, None) => format!("<th scope=\"row\"{}>{}</th>", name(column), escaped(text)),
        (0, Some(link)) => {
            let link = escaped(link);
            format!("<th scope=\"row\"{}><a href=\"{link}\">{}</a></th>", name(column), escaped(text))
        }
        _ => format!("<td{}{}>{}</td>", class(column), name(column), escaped(text)),
    };
    let row = |row: &Row| {
        let cells: String = (0..).zip(&row.cells).map(|(column, text)| cell(row, column, text)).collect();
        let remark = if is_marked { remark(row.mark.as_ref()) } else { String::new() };
        format!("<tr{}>{cells}{remark}</tr>\n", row.mark.as_ref().map(mark_class).unwrap_or_default())
    };
    // Many columns need the whole width.
    let width = if is_wide { " wide" } else { "" };
    format!(
        "<section class=\"table{width}\" tabindex=\"0\" aria-label=\"{title}\">\n<h2>{title}</h2>\n<table>\n\
         <thead><tr>{}{}</tr></thead>\n<tbody>\n{}</tbody>\n</table>\n</section>\n",
        table.columns.iter().enumerate().map(head).collect::<String>(),
        if is_marked { "<th scope=\"col\">remark</th>" } else { "" },
        table.rows.iter().map(row).collect::<String>(),
        title = escaped(&table.title),
    )
}

fn heat_map(map: &HeatMap) -> String {
    let head = |name: &String| format!("<th scope=\"col\">{}</th>", escaped(name));
    let cell = |cell: &Option<Heat>| match cell {
        None => "<td></td>".into(),
        Some(Heat { text, note, tone, strength }) => format!(
            "<td class=\"{}\" style=\"--heat:{:.0}%\">{}<small>{}</small></td>",
            tone_class(*tone),
            // Enough to be told from nothing, and not so much that the text could not be read.
            12.0 + 43.0 * strength.clamp(0.0, 1.0),
            escaped(text),
            escaped(note)
        ),
    };
    let row = |(name, cells): &(String, Vec<Option<Heat>>)| {
        let cells: String = cells.iter().map(cell).collect();
        format!("<tr><th scope=\"row\">{}</th>{cells}</tr>\n", escaped(name))
    };
    let [down, along] = &map.axes;
    format!(
        "<section class=\"table heat\" tabindex=\"0\" aria-label=\"{title}\">\n<h2>{title}</h2>\n<table>\n\
         <thead><tr><th>{} \\ {}</th>{}</tr></thead>\n<tbody>\n{}</tbody>\n</table>\n</section>\n",
        escaped(down),
        escaped(along),
        map.columns.iter().map(head).collect::<String>(),
        map.rows.iter().map(row).collect::<String>(),
        title = escaped(&map.title),
    )
}

fn mark_class(mark: &Mark) -> &'static str {
    match mark.kind {
        MarkKind::Chosen => " class=\"chosen\"",
        MarkKind::PassedOver => " class=\"passed-over\"",
    }
}

/// Why a row stands out, in the last column.
fn remark(mark: Option<&Mark>) -> String {
    let told = |mark: &Mark| {
        let note = if mark.note.is_empty() { String::new() } else { format!(": {}", escaped(&mark.note)) };
        format!("<b>{}</b>{note}", escaped(&mark.label))
    };
    format!("<td class=\"remark\">{}</td>", mark.map(told).unwrap_or_default())
}

/// Whether every cell begins like a number, or is empty or a dash.
fn is_numeric(table: &Table, column: usize) -> bool {
    let numeric = |cell: &String| {
        let text = cell.trim_start_matches(['+', '-', '−', '–', '—', '±', '<', '>', '≈', ' ']);
        text.is_empty() || text.starts_with(|first: char| first.is_ascii_digit())
    };
    column > 0 && table.rows.iter().filter_map(|row| row.cells.get(column)).all(numeric)
}

fn footer(with_library: bool) -> String {
    let version = env!("CARGO_PKG_VERSION");
    let licence = match with_library {
        true => format!(
            "<details><summary>Licence of three.js, which draws the replay</summary>\n<pre>{}</pre></details>\n",
            escaped(LIBRARY_LICENCE)
        ),
        false => String::new(),
    };
    format!("<footer>\n<p>Powderline {version}</p>\n{licence}</footer>\n")
}

/// Text as text, between tags or in quotes.
fn escaped(text: &str) -> String {
    let mut safe = String::with_capacity(text.len());
    for letter in text.chars() {
        match letter {
            '&' => safe += "&amp;",
            '<' => safe += "&lt;",
            '>' => safe += "&gt;",
            '"' => safe += "&quot;",
            '\'' => safe += "&#39;",
            _ => safe.push(letter),
        }
    }
    safe
}

/// Data for a script. `<` only occurs within strings of JSON, where it may be written so: nothing ends the element.
fn data(id: &str, value: &impl Serialize) -> String {
    // Only maps with keys that are not strings fail, and there are none.
    let json = serde_json::to_string(value).unwrap_or_default().replace('<', "\\u003c");
    format!("<script type=\"application/json\" id=\"{id}\">{json}</script>\n")
}

/// Base64 for a script.
fn blob(id: &str, base64: &str) -> String {
    format!("<script type=\"application/octet-stream\" id=\"{id}\">{base64}</script>\n")
}

fn script(text: &str) -> String {
    format!("<script type=\"module\">\n{text}</script>\n")
}

fn deflated(text: &str) -> String {
    let mut encoder = ZlibEncoder::new(Vec::new(), Compression::best());
    // Into memory: this cannot fail.
    let _ = encoder.write_all(text.as_bytes());
    base64::engine::general_purpose::STANDARD.encode(encoder.finish().unwrap_or_default())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::page::{Chart, Series};

    const NASTY: &str = "</script><script>alert('\"&\")</script><!-- &amp;";

    #[test]
    fn texts_of_the_caller_stay_texts() {
        let chart = Chart::new(NASTY, NASTY, NASTY, vec![Series::new(NASTY, vec![[0.0, f64::NAN]])]);
        let nasty = Page {
            title: NASTY.into(),
            verdict: Some((Tone::Bad, NASTY.into())),
            figures: vec![Figure::new(NASTY, NASTY).with_note(NASTY)],
            replay: None,
            replay_shows: NASTY.into(),
            charts: vec![chart.marked(0.0, Mark::passed_over(NASTY)).shaded(0.0, 1.0, NASTY)],
            heat_maps: vec![HeatMap {
                title: NASTY.into(),
                axes: [NASTY, NASTY].map(String::from),
                columns: vec![NASTY.into()],
                rows: vec![(
                    NASTY.into(),
                    vec![Some(Heat { text: NASTY.into(), note: NASTY.into(), ..Heat::default() })],
                )],
            }],
            tables: vec![Table {
                title: NASTY.into(),
                columns: vec![NASTY.into()],
                rows: vec![
                    Row::from(vec![NASTY.into(); 2])
                        .marked(Some(Mark::passed_over(NASTY)))
                        .linked(Some(NASTY.into())),
                ],
            }],
            facts: vec![(NASTY.into(), NASTY.into())],
            notes: vec![NASTY.into()],
        };
        let html = page(&nasty);
        assert!(!html.contains("<script>alert"));
        // Between tags apostrophes are written as entities; as they are only within the data.
        let outside: String = html
            .split("<script")
            .map(|part| part.split_once("</script>").map_or(part, |(_, rest)| rest))
            .collect();
        assert!(!outside.contains("alert('"), "an apostrophe came through");
        // The chart's data and the charts' script; nothing else opens or closes one.
        assert_eq!(html.matches("<script").count(), 2);
        assert_eq!(html.matches("</script").count(), 2);
        assert!(!html.contains("<!-- "));
    }

    #[test]
    fn data_come_back_as_they_were() {
        let element = data("x", &[NASTY]);
        let json = element
            .split_once('>')
            .and_then(|(_, rest)| rest.rsplit_once("</script>"))
            .expect("an element")
            .0;
        let texts: Vec<String> = serde_json::from_str(json).expect("JSON");
        assert_eq!(texts, [NASTY]);
        assert!(data("x", &[[f64::NAN, f64::INFINITY]]).contains("[null,null]"));
    }

    #[test]
    fn own_scripts_end_where_they_should() {
        for text in [CHARTS_SCRIPT, POWDER_SCRIPT, VIEWER_SCRIPT] {
            assert!(!text.contains("</script") && !text.contains("<!--"));
        }
        assert!(!STYLE.contains("</style"));
    }

    #[test]
    fn numbers_stand_to_the_right() {
        let rows = [["CMA-ES", "12.5 m", "fast"], ["random", "−3", "-"], ["grid", "", "2"]];
        let rows = rows.map(|row| Row::from(row.map(String::from).to_vec())).to_vec();
        let table = Table { rows, ..Table::default() };
        assert_eq!([0, 1, 2].map(|column| is_numeric(&table, column)), [false, true, false]);
    }

    #[test]
    fn a_page_without_a_replay_is_small() {
        let html = page(&Page { title: "Methods".into(), ..Page::default() });
        assert!(html.len() < 32_000 && !html.contains("<canvas"), "{}", html.len());
    }
}
