//! The report of an experiment: one HTML file with everything in it, no script. Each dot is a link to its flight.

mod curves;
mod svg;
mod versus;

pub use versus::compare;

use std::fmt::Write as _;

use plumbline_rest::experiment::{Condition, Flight, Results};

use crate::row::{MEASURES, Row};
use crate::store::{Experiment, StoreError, write_whole};
use crate::summary;

/// What a report shows of each condition, by the names of measures.
const SHOWN: [&str; 4] = ["altitude_m", "tilt_rad", "delay_s", "false_longest_s"];
/// Most conditions drawn side by side; the table has all.
const DRAWN: usize = 60;
/// Most dots of a condition.
const DOTS: usize = 200;
/// Flights listed as the worst.
const WORST: usize = 20;

const STYLE: &str = "\
:root{color-scheme:light dark;--ink:#1b1f24;--soft:#5b6570;--line:#d5dae0;--paper:#fff;--mark:#0072b2;--lost:#d55e00}\
@media(prefers-color-scheme:dark){:root{--ink:#e6e9ed;--soft:#9aa4af;--line:#3a424b;--paper:#14181d;--mark:#56b4e9;--lost:#e69f00}}\
body{font:15px/1.5 system-ui,sans-serif;color:var(--ink);background:var(--paper);max-width:1100px;margin:2rem auto;padding:0 1rem}\
h1{font-size:1.5rem}h2{font-size:1.15rem;margin-top:2.5rem;border-bottom:1px solid var(--line)}\
figure{margin:1rem 0}figcaption{color:var(--soft)}svg{max-width:100%;height:auto}svg text{fill:var(--ink);font-size:12px}\
svg .axis{stroke:var(--line)}svg .box{fill:none;stroke:var(--ink)}svg .violin{fill:var(--mark);fill-opacity:.14}svg .dot{fill:var(--mark);fill-opacity:.45}\
svg a:hover .dot,svg a:focus .dot{fill-opacity:1;stroke:var(--ink)}svg .lost{fill:var(--lost)}\
table{border-collapse:collapse;font-variant-numeric:tabular-nums;margin:1rem 0}\
th,td{padding:.15rem .6rem;border-bottom:1px solid var(--line);text-align:left;vertical-align:top}td.n{text-align:right;white-space:nowrap}\
.wide{overflow-x:auto}small{color:var(--soft)}a{color:var(--mark)}pre{overflow-x:auto;border:1px solid var(--line);padding:.5rem}";

/// Text as HTML text.
pub(crate) fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

/// Writes `report.html` into the experiment's folder. Dots lead to the ground at `address`, where the experiment is.
///
/// # Errors
/// [`StoreError::Io`].
pub fn write(experiment: &Experiment, address: &str) -> Result<std::path::PathBuf, StoreError> {
    let path = experiment.folder.join("report.html");
    write_whole(&path, page(experiment, address)?.as_bytes())?;
    Ok(path)
}

/// The report as it is now.
///
/// # Errors
/// [`StoreError::Io`].
pub fn page(experiment: &Experiment, address: &str) -> Result<String, StoreError> {
    let results = summary::results(experiment)?;
    let rows = experiment.rows()?;
    let links = Links { address: address.trim_end_matches('/'), experiment };
    let (plan, identity) = (&experiment.plan, &experiment.identity);
    let title = escape(&plan.name);
    let mut out = format!(
        "<!doctype html>\n<html lang=en><meta charset=utf-8><meta name=viewport content=\"width=device-width\">\n\
         <title>{title}</title><style>{STYLE}</style>\n<h1>{title}</h1>\n<p>{}</p>\n\
         <p>{} of {} flights; seed {} and on, the same for each condition. Plan and program <code>{}</code>, program \
         <code>{}</code>. Errors are those of flights that were not lost, from the onset of the attack on.</p>\n",
        escape(&plan.description),
        rows.len(),
        identity.flights,
        plan.seed,
        escape(&identity.hash),
        escape(&identity.program),
    );
    for note in &results.notes {
        let _ = writeln!(out, "<p>{}</p>", escape(note));
    }
    table(&mut out, &results);
    differences(&mut out, &results);
    for name in SHOWN {
        boxes(&mut out, &results, &rows, name, &links);
    }
    curves::detected(&mut out, experiment, &results);
    expected(&mut out, &results);
    curves::roc(&mut out, experiment, &results, &rows);
    curves::over_time(&mut out, experiment, &results);
    worst(&mut out, &results, experiment, &links)?;
    let _ = write!(out, "<h2>Plan</h2>\n<pre>{}</pre>\n</html>\n", escape(&plan.text));
    Ok(out)
}

/// Where a dot leads.
struct Links<'a> {
    address: &'a str,
    experiment: &'a Experiment,
}

impl Links<'_> {
    fn of(&self, index: u64) -> String {
        format!("{}/api/v1/experiments/{}/flights/{index}/open", escape(self.address), self.experiment.id)
    }
}

fn place(name: &str) -> usize {
    MEASURES.iter().position(|measure| measure.name == name).unwrap_or_default()
}

/// Three significant digits.
pub(crate) fn number(value: f64) -> String {
    if value == 0.0 || !value.is_finite() {
        return if value.is_finite() { "0".into() } else { "–".into() };
    }
    let digits = (2 - value.abs().log10().floor() as i32).clamp(0, 9) as usize;
    format!("{value:.digits$}")
}

/// A median and what stands small beside it: its interval, and the effect where there is one.
fn median(median: f64, interval: Option<[f64; 2]>, effect: Option<f64>) -> String {
    let interval = interval.map_or("no interval".into(), |[low, high]| format!("{} … {}", number(low), number(high)));
    let effect = effect.map_or(String::new(), |effect| format!(", d {}", number(effect)));
    format!("{} <small>{interval}{effect}</small>", number(median))
}

fn label(condition: &Condition) -> String {
    let levels: Vec<_> = condition.levels.iter().filter(|level| !level.is_empty()).cloned().collect();
    if levels.is_empty() { format!("condition {}", condition.number) } else { levels.join(" · ") }
}

fn head(out: &mut String, results: &Results, more: &[String]) {
    out.push_str("<div class=wide><table><thead><tr>");
    for name in results.factors.iter().chain(more) {
        let _ = write!(out, "<th>{}</th>", escape(name));
    }
    out.push_str("</tr></thead><tbody>\n");
}

fn levels(out: &mut String, condition: &Condition) {
    out.push_str("<tr>");
    for level in &condition.levels {
        let _ = write!(out, "<td>{}</td>", escape(level));
    }
}

fn table(out: &mut String, results: &Results) {
    out.push_str("<h2>Conditions</h2>\n<p>Median and its 95 % interval, which takes six flights. tick: the agent's, median … 99 of 100, on the machine that flew it.</p>\n");
    let mut columns: Vec<String> = ["flights", "lost", "detected", "expected", "tick, µs"].map(str::to_owned).into();
    let measured: Vec<usize> = (0..MEASURES.len())
        .filter(|at| {
            results.conditions.iter().any(|condition| condition.measures.get(*at).is_some_and(Option::is_some))
        })
        .collect();
    columns.extend(measured.iter().filter_map(|at| MEASURES.get(*at)).map(|measure| measure.name.to_owned()));
    head(out, results, &columns);
    for condition in &results.conditions {
        levels(out, condition);
        let why: Vec<_> = condition.lost.iter().map(|(why, count)| format!("{count} {why}")).collect();
        let detected = condition.detected.map_or("–".into(), |part| {
            let [low, high] = part.interval;
            format!("{}/{} <small>{low:.2} … {high:.2}</small>", part.count, part.of)
        });
        let lost = if why.is_empty() { "0".into() } else { escape(&why.join(", ")) };
        let expected = condition.expected.as_ref().map_or("–".into(), |expected| {
            let differs = if expected.differs { " <small>differs</small>" } else { "" };
            expected.probability.map_or("not known".into(), |probability| format!("{probability:.2}{differs}"))
        });
        let tick = condition
            .tick_us
            .map_or("–".into(), |[median, of_99]| format!("{median:.0} <small>… {of_99:.0}</small>"));
        let _ = write!(
            out,
            "<td class=n>{}</td><td class=n>{lost}</td><td class=n>{detected}</td><td class=n>{expected}</td><td class=n>{tick}</td>",
            condition.flights
        );
        for at in &measured {
            let spread = condition.measures.get(*at).and_then(Option::as_ref);
            let cell = spread.map_or("–".into(), |spread| median(spread.median, spread.interval, None));
            let _ = write!(out, "<td class=n>{cell}</td>");
        }
        out.push_str("</tr>\n");
    }
    out.push_str("</tbody></table></div>\n<dl>");
    for measure in measured.iter().filter_map(|at| MEASURES.get(*at)) {
        let _ = write!(out, "<dt><code>{}</code></dt><dd>{}</dd>", measure.name, escape(measure.about));
    }
    out.push_str("</dl>\n");
}

/// What the model expects where the flights differ from it, and why it is not known elsewhere.
fn expected(out: &mut String, results: &Results) {
    let said: Vec<_> =
        results.conditions.iter().filter_map(|condition| Some((condition, condition.beside()?))).collect();
    if said.is_empty() {
        return;
    }
    out.push_str(
        "<h2>Expected</h2>\n<p>Part of the flights in which the attacked sensor is excluded, by the model: lanes in the loop, at rest \
         about hover, white noise, 200 flights drawn.</p>\n<ul>",
    );
    for (condition, says) in said.iter().take(DRAWN) {
        let differs = condition.expected.as_ref().is_some_and(|expected| expected.differs);
        let (b, end) = if differs { ("<b>", "</b>") } else { ("", "") };
        let _ = writeln!(out, "<li>{b}{}: {}{end}</li>", escape(&label(condition)), escape(says));
    }
    out.push_str("</ul>\n");
}

fn differences(out: &mut String, results: &Results) {
    let compared = |condition: &&Condition| condition.differences.iter().any(Option::is_some);
    if !results.conditions.iter().any(|condition| compared(&condition)) {
        return;
    }
    out.push_str(
        "<h2>Paired differences</h2>\n<p>Each flight less the flight of the same seed in the condition compared with: median, its \
         95 % interval, which takes six pairs, and the mean by the standard deviation (d).</p>\n",
    );
    let mut columns: Vec<String> = ["against", "pairs"].map(str::to_owned).into();
    columns.extend(SHOWN.map(str::to_owned));
    head(out, results, &columns);
    for condition in results.conditions.iter().filter(compared) {
        levels(out, condition);
        let any = condition.differences.iter().flatten().next();
        let baseline = any.and_then(|any| results.conditions.iter().find(|other| other.number == any.baseline));
        let against = baseline.map(label).unwrap_or_default();
        let _ = write!(out, "<td>{}</td><td class=n>{}</td>", escape(&against), any.map_or(0, |any| any.pairs));
        for name in SHOWN {
            let difference = condition.differences.get(place(name)).and_then(Option::as_ref);
            let cell = difference.map_or("–".into(), |d| median(d.median, d.interval, d.effect));
            let _ = write!(out, "<td class=n>{cell}</td>");
        }
        out.push_str("</tr>\n");
    }
    out.push_str("</tbody></table></div>\n");
}

fn boxes(out: &mut String, results: &Results, rows: &[Row], name: &str, links: &Links<'_>) {
    let at = place(name);
    let plan = &links.experiment.plan;
    let drawn: Vec<_> =
        results.conditions.iter().filter(|c| c.measures.get(at).is_some_and(Option::is_some)).take(DRAWN).collect();
    if drawn.is_empty() {
        return;
    }
    let columns = drawn.iter().map(|condition| {
        let of = || rows.iter().filter(|row| plan.place(row.index.into()).0 == condition.number);
        let finite = |row: &Row| row.values.get(at).copied().filter(|value| value.is_finite());
        let dots = of().filter_map(|row| {
            finite(row).map(|value| svg::Dot {
                value,
                lost: !row.lost().is_empty(),
                link: links.of(row.index.into()),
                says: format!(
                    "flight {}, seed {}: {name} = {} {}",
                    row.index,
                    plan.seed_of(plan.place(row.index.into()).1),
                    number(value),
                    row.lost()
                ),
            })
        });
        svg::Column {
            label: label(condition),
            spread: condition.measures.get(at).copied().flatten(),
            values: of().filter(|row| row.lost().is_empty()).filter_map(finite).collect(),
            dots: dots.take(DOTS).collect(),
        }
    });
    let columns: Vec<_> = columns.collect();
    let about = MEASURES.get(at).map_or("", |measure| measure.about);
    let _ = write!(
        out,
        "<h2>{name}</h2>\n<figure>{}<figcaption>{}: quartiles and median, whiskers to the least and the most of flights not lost, \
         their density behind; each dot is a flight and opens it.</figcaption></figure>\n",
        svg::boxes(name, &columns),
        escape(about),
    );
}

fn worst(out: &mut String, results: &Results, experiment: &Experiment, links: &Links<'_>) -> Result<(), StoreError> {
    let mut flights = summary::flights(experiment, 0, usize::MAX, None)?.flights;
    let most = place("altitude_most_m");
    let key = |flight: &Flight| (!flight.lost.is_empty(), flight.values.get(most).copied().flatten().unwrap_or(0.0));
    flights.sort_by(|a, b| {
        let ((lost_a, most_a), (lost_b, most_b)) = (key(a), key(b));
        lost_b.cmp(&lost_a).then(most_b.total_cmp(&most_a))
    });
    out.push_str(
        "<h2>Worst flights</h2>\n<div class=wide><table><thead><tr><th>flight</th><th>seed</th><th>condition</th>",
    );
    out.push_str("<th>lost</th><th>altitude_m</th><th>most</th></tr></thead><tbody>\n");
    for flight in flights.iter().take(WORST) {
        let condition = results.conditions.iter().find(|condition| condition.number == flight.condition);
        let value = |at: usize| flight.values.get(at).copied().flatten().map_or("–".into(), number);
        let _ = writeln!(
            out,
            "<tr><td class=n><a href=\"{}\">{}</a></td><td class=n>{}</td><td>{}</td><td>{}</td><td class=n>{}</td><td class=n>{}</td></tr>",
            links.of(flight.index),
            flight.index,
            flight.seed,
            escape(&condition.map(label).unwrap_or_default()),
            escape(&flight.lost),
            value(place("altitude_m")),
            value(most),
        );
    }
    out.push_str("</tbody></table></div>\n");
    Ok(())
}
