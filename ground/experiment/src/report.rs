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

/// A row of cells for each condition; a cell is text with what stands small beside it, as HTML.
struct Table {
    heads: Vec<String>,
    /// So many columns are text: the levels of factors, and what follows them.
    texts: usize,
    rows: Vec<Vec<String>>,
}

impl Table {
    fn new(results: &Results, more: &[String]) -> Self {
        let heads = results.factors.iter().chain(more).map(|name| escape(name)).collect();
        Self { heads, texts: results.factors.len(), rows: Vec::new() }
    }

    fn row(&mut self, condition: &Condition, cells: impl IntoIterator<Item = String>) {
        self.rows.push(condition.levels.iter().map(|level| escape(level)).chain(cells).collect());
    }

    /// The table, and as a file of this name for LaTeX.
    fn put(&self, out: &mut String, name: &str, caption: &str) {
        let link = kept(&format!("{name}.tex"), "application/x-tex", &self.latex(caption), "LaTeX");
        let _ = write!(out, "<p>{caption} {link}</p>\n<div class=wide><table><thead><tr>");
        out.extend(self.heads.iter().map(|head| format!("<th>{head}</th>")));
        out.push_str("</tr></thead><tbody>\n");
        for row in &self.rows {
            let class = |at: usize| if at < self.texts { "" } else { " class=n" };
            let cells = row.iter().enumerate().map(|(at, cell)| format!("<td{}>{cell}</td>", class(at)));
            let _ = writeln!(out, "<tr>{}</tr>", cells.collect::<String>());
        }
        out.push_str("</tbody></table></div>\n");
    }

    /// With the rules of booktabs.
    fn latex(&self, caption: &str) -> String {
        let line = |cells: &[String]| {
            format!("    {} \\\\\n", cells.iter().map(|cell| tex(cell)).collect::<Vec<_>>().join(" & "))
        };
        let columns: String = (0..self.heads.len()).map(|at| if at < self.texts { 'l' } else { 'r' }).collect();
        format!(
            "% \\usepackage{{booktabs}}\n\\begin{{table}}\n  \\centering\n  \\begin{{tabular}}{{{columns}}}\n    \\toprule\n{}    \
             \\midrule\n{}    \\bottomrule\n  \\end{{tabular}}\n  \\caption{{{}}}\n\\end{{table}}\n",
            line(&self.heads),
            self.rows.iter().map(|row| line(row)).collect::<String>(),
            tex(caption),
        )
    }
}

/// A cell as LaTeX has it.
fn tex(html: &str) -> String {
    let (mut out, mut rest) = (String::new(), html);
    // Longer ones first, where one begins with another.
    const AS: [(&str, &str); 24] = [
        ("<small>", "{\\scriptsize "),
        ("</small>", "}"),
        ("&lt;", "$<$"),
        ("&gt;", "$>$"),
        ("&quot;", "''"),
        ("&amp;", "\\&"),
        ("&", "\\&"),
        ("%", "\\%"),
        ("$", "\\$"),
        ("#", "\\#"),
        ("_", "\\_"),
        ("{", "\\{"),
        ("}", "\\}"),
        ("\\", "\\textbackslash{}"),
        ("~", "\\textasciitilde{}"),
        ("^", "\\textasciicircum{}"),
        ("–", "--"),
        ("…", "\\dots{}"),
        ("·", "$\\cdot$"),
        ("±", "$\\pm$"),
        ("µ", "$\\mu$"),
        ("σ", "$\\sigma$"),
        ("²", "$^2$"),
        ("°", "$^\\circ$"),
    ];
    while let Some(letter) = rest.chars().next() {
        let (written, len) = match AS.into_iter().find(|(from, _)| rest.starts_with(from)) {
            Some((from, to)) => (to.to_owned(), from.len()),
            None => (letter.to_string(), letter.len_utf8()),
        };
        out.push_str(&written);
        rest = rest.get(len..).unwrap_or_default();
    }
    out
}

/// A link that keeps a text as a file, without anything from elsewhere.
fn kept(name: &str, kind: &str, text: &str, label: &str) -> String {
    let mut data = String::with_capacity(2 * text.len());
    for byte in text.bytes() {
        match byte {
            b'A'..=b'Z' | b'a'..=b'z' | b'0'..=b'9' | b'.' | b'-' | b'=' | b':' | b'/' | b',' | b'(' | b')' => {
                data.push(char::from(byte));
            }
            _ => {
                let _ = write!(data, "%{byte:02X}");
            }
        }
    }
    format!("<a download=\"{}\" href=\"data:{kind};charset=utf-8,{data}\">{label}</a>", escape(name))
}

fn table(out: &mut String, results: &Results) {
    out.push_str("<h2>Conditions</h2>\n");
    let mut columns: Vec<String> = ["flights", "lost", "detected", "expected", "tick, µs"].map(str::to_owned).into();
    let measured: Vec<usize> = (0..MEASURES.len())
        .filter(|at| {
            results.conditions.iter().any(|condition| condition.measures.get(*at).is_some_and(Option::is_some))
        })
        .collect();
    columns.extend(measured.iter().filter_map(|at| MEASURES.get(*at)).map(|measure| measure.name.to_owned()));
    let mut table = Table::new(results, &columns);
    for condition in &results.conditions {
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
        let values = measured.iter().map(|at| {
            let spread = condition.measures.get(*at).and_then(Option::as_ref);
            spread.map_or("–".into(), |spread| median(spread.median, spread.interval, None))
        });
        let told = [condition.flights.to_string(), lost, detected, expected, tick];
        table.row(condition, told.into_iter().chain(values));
    }
    table.put(
        out,
        "conditions",
        "Median and its 95 % interval, which takes six flights. tick: the agent's, median … 99 of 100, on the machine that flew it.",
    );
    out.push_str("<dl>");
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
    out.push_str("<h2>Paired differences</h2>\n");
    let mut columns: Vec<String> = ["against", "pairs"].map(str::to_owned).into();
    columns.extend(SHOWN.map(str::to_owned));
    let mut table = Table::new(results, &columns);
    table.texts += 1;
    for condition in results.conditions.iter().filter(compared) {
        let any = condition.differences.iter().flatten().next();
        let baseline = any.and_then(|any| results.conditions.iter().find(|other| other.number == any.baseline));
        let against = baseline.map(label).unwrap_or_default();
        let values = SHOWN.map(|name| {
            let difference = condition.differences.get(place(name)).and_then(Option::as_ref);
            difference.map_or("–".into(), |d| median(d.median, d.interval, d.effect))
        });
        table.row(condition, [escape(&against), any.map_or(0, |any| any.pairs).to_string()].into_iter().chain(values));
    }
    table.put(
        out,
        "differences",
        "Each flight less the flight of the same seed in the condition compared with: median, its 95 % interval, which takes six pairs, \
         and the mean by the standard deviation (d).",
    );
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
        "<h2>{name}</h2>\n{}",
        svg::figure(
            name,
            &svg::boxes(name, &columns),
            &format!(
                "{}: quartiles and median, whiskers to the least and the most of flights not lost, their density behind; each dot is a \
                 flight and opens it.",
                escape(about)
            )
        ),
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_table_is_kept_for_latex_as_it_is_shown() {
        let results = Results { factors: vec!["attack.magnitude_m".into()], ..Results::default() };
        let mut table = Table::new(&results, &["altitude_m".into()]);
        let condition = Condition { levels: vec!["a & b < 0.5".into()], ..Condition::default() };
        table.row(&condition, ["0.2 <small>0.1 … 0.3</small>".to_owned()]);
        let text = table.latex("95 % interval");
        assert!(
            text.contains("\\begin{tabular}{lr}\n    \\toprule\n    attack.magnitude\\_m & altitude\\_m \\\\\n"),
            "{text}"
        );
        assert!(
            text.contains("    a \\& b $<$ 0.5 & 0.2 {\\scriptsize 0.1 \\dots{} 0.3} \\\\\n    \\bottomrule"),
            "{text}"
        );
        assert!(text.contains("\\caption{95 \\% interval}"), "{text}");
        let mut out = String::new();
        table.put(&mut out, "conditions", "95 % interval");
        assert!(out.contains("<td>a &amp; b &lt; 0.5</td><td class=n>0.2 <small>"), "{out}");
        let kept = out.split_once("href=\"data:application/x-tex;charset=utf-8,").unwrap().1.split_once('"').unwrap().0;
        let read = kept.split('%').enumerate().fold(Vec::new(), |mut read, (n, part)| {
            let (code, rest) = if n == 0 { ("", part) } else { part.split_at(2) };
            read.extend(u8::from_str_radix(code, 16));
            read.extend(rest.bytes());
            read
        });
        assert_eq!(String::from_utf8(read).unwrap(), text);
    }
}
