//! Two experiments on one page: what differs between them, condition by condition and flight by flight.

use std::fmt::Write as _;

use super::{Links, SHOWN, STYLE, escape, median, number, place};
use crate::compare::{self, Comparison, Pair};
use crate::store::{Experiment, StoreError};

/// Flights listed that went another way.
const TURNED: usize = 50;

/// What `second` differs from `first` in, as one HTML file. Flights lead to the ground at `address`.
///
/// # Errors
/// [`StoreError::Io`].
pub fn compare(first: &Experiment, second: &Experiment, address: &str) -> Result<String, StoreError> {
    let comparison = compare::compare(first, second)?;
    let both = [first, second];
    let links = both.map(|experiment| Links { address: address.trim_end_matches('/'), experiment });
    let title = if first.plan.name == second.plan.name {
        escape(&first.plan.name)
    } else {
        format!("{} and {}", escape(&first.plan.name), escape(&second.plan.name))
    };
    let mut out = format!(
        "<!doctype html>\n<html lang=en><meta charset=utf-8><meta name=viewport content=\"width=device-width\">\n\
         <title>{title}: what changed</title><style>{STYLE}</style>\n<h1>{title}: what changed</h1>\n"
    );
    for (which, experiment) in ["First", "Second"].iter().zip(both) {
        let _ = writeln!(
            out,
            "<p>{which}: <a href=\"{}/api/v1/experiments/{id}/report.html\">{id}</a>, program <code>{}</code>, {} of {} \
             flights.</p>",
            escape(address.trim_end_matches('/')),
            escape(&experiment.identity.program),
            experiment.done(),
            experiment.identity.flights,
            id = experiment.id,
        );
    }
    verdict(&mut out, &comparison);
    plans(&mut out, &comparison);
    conditions(&mut out, first, &comparison);
    turned(&mut out, &comparison, &links);
    out.push_str("</html>\n");
    Ok(out)
}

fn verdict(out: &mut String, comparison: &Comparison) {
    let pairs: u64 = comparison.conditions.iter().map(|pair| pair.pairs).sum();
    let same: u64 = comparison.conditions.iter().map(|pair| pair.same).sum();
    let program = if comparison.programs { "another program" } else { "the same program" };
    let plan = if comparison.plans.is_empty() { "the same plan" } else { "another plan" };
    let _ = writeln!(
        out,
        "<p><b>{program}, {plan}: {same} of {pairs} flights of the same condition and seed are the same bit for bit.</b></p>"
    );
    let [ours, theirs] = comparison.alone;
    if ours + theirs > 0 {
        let _ = writeln!(out, "<p>{ours} conditions have flights in the first alone, {theirs} in the second.</p>");
    }
}

fn plans(out: &mut String, comparison: &Comparison) {
    if comparison.plans.is_empty() {
        return;
    }
    out.push_str("<h2>Plans</h2>\n<div class=wide><table><thead><tr><th>key<th>first<th>second</tr></thead><tbody>\n");
    for (key, first, second) in &comparison.plans {
        let cell = |text: &str| if text.is_empty() { "–".to_owned() } else { escape(text) };
        let _ = writeln!(out, "<tr><td><code>{}</code><td>{}<td>{}</tr>", escape(key), cell(first), cell(second));
    }
    out.push_str("</tbody></table></div>\n");
}

fn conditions(out: &mut String, first: &Experiment, comparison: &Comparison) {
    out.push_str(
        "<h2>Conditions</h2>\n<p>Of flights of the same seed: how many are the same, lost and detected in the first → in the second; \
         of each measure the medians, and the second less the first, flight by flight: median, its 95 % interval, which takes six pairs, \
         and the mean by the standard deviation (d). A difference whose interval does not hold zero is in bold.</p>\n<div class=wide><table><thead><tr>",
    );
    let keys = first.plan.factors.iter().map(|factor| factor.key.as_str());
    for name in keys.chain(["pairs", "same", "lost", "detected"]).chain(SHOWN) {
        let _ = write!(out, "<th>{}</th>", escape(name));
    }
    out.push_str("</tr></thead><tbody>\n");
    for pair in &comparison.conditions {
        out.push_str("<tr>");
        for level in &pair.levels {
            let _ = write!(out, "<td>{}</td>", escape(level));
        }
        let ([lost, lost_then], detected) = (pair.lost, pair.detected);
        let detected = detected.map_or("–".into(), |[before, then]| format!("{before} → {then}"));
        let _ = write!(
            out,
            "<td class=n>{}</td><td class=n>{}</td><td class=n>{lost} → {lost_then}</td><td class=n>{detected}</td>",
            pair.pairs, pair.same
        );
        for name in SHOWN {
            let _ = write!(out, "<td class=n>{}</td>", measure(pair, name));
        }
        out.push_str("</tr>\n");
    }
    out.push_str("</tbody></table></div>\n");
}

fn measure(pair: &Pair, name: &str) -> String {
    let Some(compared) = pair.measures.get(place(name)).and_then(Option::as_ref) else { return "–".into() };
    let ([before, then], difference) = (compared.medians, &compared.difference);
    let differs = difference.interval.is_some_and(|[low, high]| low > 0.0 || high < 0.0);
    let (open, close) = if differs { ("<b>", "</b>") } else { ("", "") };
    let less = median(difference.median, difference.interval, difference.effect);
    format!("{} → {}<br>{open}{less}{close}", number(before), number(then))
}

fn turned(out: &mut String, comparison: &Comparison, links: &[Links<'_>; 2]) {
    let all = || comparison.conditions.iter().flat_map(|pair| pair.turned.iter().map(move |turned| (pair, turned)));
    let count = all().count();
    if count == 0 {
        return;
    }
    let _ = write!(
        out,
        "<h2>Flights that went another way</h2>\n<p>{count} of them; the first {} are listed.</p>\n<div class=wide><table><thead><tr>\
         <th>condition<th>seed<th>first<th>second</tr></thead><tbody>\n",
        count.min(TURNED)
    );
    for (pair, turned) in all().take(TURNED) {
        let _ = write!(out, "<tr><td>{}<td class=n>{}", escape(&pair.levels.join(" · ")), turned.seed);
        for ((link, index), went) in links.iter().zip(turned.index).zip(&turned.went) {
            let went = escape(went);
            // Only the program that flew it flies it again.
            let _ = match link.experiment.own() {
                Ok(()) => write!(out, "<td><a href=\"{}\">{went}</a>", link.of(index)),
                Err(_) => write!(out, "<td>{went}"),
            };
        }
        out.push_str("</tr>\n");
    }
    out.push_str("</tbody></table></div>\n");
}
