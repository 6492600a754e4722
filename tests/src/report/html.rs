//! The page around the plots: one file, no script, light and dark.

use serde_json::Value;

const STYLE: &str = "\
:root{color-scheme:light dark;--ink:#1b1f24;--soft:#5b6570;--line:#d5dae0;--paper:#fff}\
@media(prefers-color-scheme:dark){:root{--ink:#e6e9ed;--soft:#9aa4af;--line:#3a424b;--paper:#14181d}}\
body{font:15px/1.5 system-ui,sans-serif;color:var(--ink);background:var(--paper);max-width:1000px;margin:2rem auto;padding:0 1rem}\
h1{font-size:1.5rem}h2{font-size:1.15rem;margin-top:2.5rem;border-bottom:1px solid var(--line)}\
figure{margin:1rem 0}figure svg{max-width:100%;height:auto;background:#fff;border:1px solid var(--line)}\
figcaption,caption{color:var(--soft);text-align:left;padding:.25rem 0}\
table{border-collapse:collapse;font-variant-numeric:tabular-nums;margin:1rem 0}\
th,td{padding:.2rem .7rem;border-bottom:1px solid var(--line);text-align:left}td.n{text-align:right}\
.wide{overflow-x:auto}.skipped{color:var(--soft)}";

/// Text as HTML text.
pub fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

/// One cell of a CSV file, quoted where needed.
pub fn csv_cell(text: &str) -> String {
    if text.contains([',', '"', '\n']) { format!("\"{}\"", text.replace('"', "\"\"")) } else { text.to_owned() }
}

/// A table with its caption; numbers to the right.
pub fn table(stem: &str, caption: &str, headers: &[&str], rows: &[Vec<String>]) -> String {
    let numeric = |cell: &str| cell.trim_start_matches(['-', '+', '−']).starts_with(|c: char| c.is_ascii_digit());
    let head: String = headers.iter().map(|text| format!("<th>{}</th>", escape(text))).collect();
    let body: String = rows
        .iter()
        .map(|row| {
            let cells = row.iter().map(|cell| {
                let class = if numeric(cell) { " class=n" } else { "" };
                format!("<td{class}>{}</td>", escape(cell))
            });
            format!("<tr>{}</tr>\n", cells.collect::<String>())
        })
        .collect();
    let caption = escape(caption);
    let csv = if stem.is_empty() { String::new() } else { format!(" <a href=\"{stem}.csv\">CSV</a>") };
    format!(
        "<div class=wide><table><caption>{caption}{csv}</caption><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>\n"
    )
}

/// The whole page; every value measured stands in a table at its end.
pub fn page(title: &str, body: &str, values: &[Value]) -> String {
    let text = |value: Option<&Value>| match value {
        Some(Value::String(text)) => text.clone(),
        Some(Value::Number(number)) => number.as_f64().map_or_else(|| number.to_string(), significant),
        Some(Value::Null) | None => "—".to_owned(),
        Some(other) => other.to_string(),
    };
    let rows: Vec<Vec<String>> = values
        .iter()
        .filter(|line| line.get("skipped").is_none())
        .map(|line| {
            let known = ["name", "value", "unit"];
            let rest = line.as_object().into_iter().flatten();
            let more = rest.filter(|(key, _)| !known.contains(&key.as_str()));
            let more: Vec<_> = more.map(|(key, value)| format!("{key} {}", text(Some(value)))).collect();
            vec![text(line.get("name")), text(line.get("value")), text(line.get("unit")), more.join(", ")]
        })
        .collect();
    let all = table(
        "",
        "Every figure of this run; the same lines are in values.jsonl.",
        &["name", "value", "unit", "beside it"],
        &rows,
    );
    let title = escape(title);
    format!(
        "<!doctype html>\n<html lang=en><meta charset=utf-8><meta name=viewport content=\"width=device-width\">\n\
         <title>{title}</title><style>{STYLE}</style>\n<h1>{title}</h1>\n{body}<h2>Values</h2>\n{all}</html>\n"
    )
}

/// Five significant digits.
fn significant(value: f64) -> String {
    if value == 0.0 || !value.is_finite() {
        return value.to_string();
    }
    let digits = (4 - value.abs().log10().floor() as i32).clamp(0, 12) as usize;
    if !(1e-6..1e9).contains(&value.abs()) {
        return format!("{value:.4e}");
    }
    let text = format!("{value:.digits$}");
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_owned() } else { text }
}
