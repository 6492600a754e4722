//! The report as HTML: the body for the page, and the same as a document that needs nothing else.

use std::fmt::Write;

use super::{Attack, Followed, Ranked, Report, Spread, armed_s, step_spreads};
use crate::model::{
    axis::{TimeAxis, ValueAxis},
    configuration::Row,
    curves::{Axis, Curve, Demand},
    figure::{Figure, Line, plain},
    format::{NONE, clock, count, fixed, maybe, signed},
    listing,
    live::Live,
    names,
};
use crate::palette;

/// The style of the report, on the page and alone.
const STYLE: &str = include_str!("../../../report.css");

/// A whole document around the body.
pub fn document(title: &str, body: &str) -> String {
    let title = plain(title);
    format!(
        "<!doctype html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"><meta name=\"viewport\" \
         content=\"width=device-width, initial-scale=1\"><title>{title}</title><style>{STYLE}</style></head>\
         <body class=\"report-alone\"><article class=\"report\">{body}</article></body></html>\n"
    )
}

/// A table: what each column is headed by, and whether it is of numbers; rows, and a last one that sums them up.
struct Table {
    caption: String,
    heads: Vec<(&'static str, bool)>,
    rows: Vec<Vec<String>>,
    foot: Option<Vec<String>>,
}

impl Table {
    fn html(&self) -> String {
        let class = |i: usize| if self.heads.get(i).is_some_and(|(_, number)| *number) { " class=\"num\"" } else { "" };
        let mut out = format!("<table><caption>{}</caption><thead><tr>", plain(&self.caption));
        for (i, (head, _)) in self.heads.iter().enumerate() {
            let _ = write!(out, "<th scope=\"col\"{}>{}</th>", class(i), plain(head));
        }
        out += "</tr></thead><tbody>";
        let line = |cells: &Vec<String>| {
            let cells = cells.iter().enumerate().map(|(i, cell)| format!("<td{}>{}</td>", class(i), plain(cell)));
            format!("<tr>{}</tr>", cells.collect::<String>())
        };
        out += &self.rows.iter().map(line).collect::<String>();
        out += "</tbody>";
        if let Some(foot) = &self.foot {
            let _ = write!(out, "<tfoot>{}</tfoot>", line(foot));
        }
        out += "</table>";
        out
    }

    /// With the rules of booktabs.
    fn latex(&self, title: &str) -> String {
        let columns: String = self.heads.iter().map(|(_, number)| if *number { 'r' } else { 'l' }).collect();
        let line = |cells: &mut dyn Iterator<Item = &str>| {
            format!("    {} \\\\\n", cells.map(tex).collect::<Vec<_>>().join(" & "))
        };
        let mut out = format!("\\begin{{table}}\n  \\centering\n  \\begin{{tabular}}{{{columns}}}\n    \\toprule\n");
        out += &line(&mut self.heads.iter().map(|(head, _)| *head));
        out += "    \\midrule\n";
        for row in &self.rows {
            out += &line(&mut row.iter().map(String::as_str));
        }
        if let Some(foot) = &self.foot {
            out += "    \\midrule\n";
            out += &line(&mut foot.iter().map(String::as_str));
        }
        out += "    \\bottomrule\n  \\end{tabular}\n";
        let caption = if self.caption.is_empty() { title.to_owned() } else { format!("{title}. {}", self.caption) };
        let _ = write!(out, "  \\caption{{{}}}\n\\end{{table}}\n", tex(&caption));
        out
    }
}

/// Text as LaTeX has it.
fn tex(text: &str) -> String {
    let mut out = String::new();
    for letter in text.chars() {
        match letter {
            '&' | '%' | '$' | '#' | '_' | '{' | '}' => out.extend(['\\', letter]),
            '\\' => out += "\\textbackslash{}",
            '~' => out += "\\textasciitilde{}",
            '^' => out += "\\textasciicircum{}",
            '\u{2212}' => out += "$-$",
            '±' => out += "$\\pm$",
            'σ' => out += "$\\sigma$",
            'χ' => out += "$\\chi$",
            'Δ' => out += "$\\Delta$",
            '→' => out += "$\\to$",
            '×' => out += "$\\times$",
            '·' => out += "$\\cdot$",
            '°' => out += "$^\\circ$",
            '²' => out += "$^2$",
            '∞' => out += "$\\infty$",
            '∫' => out += "$\\int$",
            'µ' | 'μ' => out += "$\\mu$",
            '—' => out += "---",
            '–' => out += "--",
            _ => out.push(letter),
        }
    }
    out
}

/// "0.42 ± 0.03"
fn spread_text(spread: Option<Spread>, decimals: usize) -> String {
    match spread {
        None => NONE.to_owned(),
        Some(Spread { mean, sigma: Some(sigma), .. }) => {
            format!("{} ± {}", fixed(mean, decimals), fixed(sigma, decimals))
        }
        Some(Spread { mean, .. }) => fixed(mean, decimals),
    }
}

fn steps(report: &Report) -> Result<Table, &'static str> {
    let steps = &report.flight.steps;
    if steps.is_empty() {
        return Err("No step of the altitude setpoint.");
    }
    let heads = vec![
        ("at s", true),
        ("from m", true),
        ("to m", true),
        ("rise s", true),
        ("overshoot %", true),
        ("settling s", true),
        ("error mm", true),
    ];
    let row = |s: &plumbline_rest::flight::Step| {
        let settled = |text: String| if s.interrupted { "interrupted".to_owned() } else { text };
        vec![
            fixed(s.start_s, 1),
            fixed(s.from_m, 2),
            fixed(s.to_m, 2),
            maybe(s.rise_time_s, 2),
            fixed(s.overshoot_percent, 1),
            settled(maybe(s.settling_time_s, 2)),
            s.steady_error_m.filter(|_| !s.interrupted).map_or_else(|| NONE.to_owned(), |e| signed(e * 1e3, 1)),
        ]
    };
    let [rise, overshoot, settling, error] = step_spreads(steps);
    let foot = vec![
        "mean ± σ".to_owned(),
        String::new(),
        String::new(),
        spread_text(rise, 2),
        spread_text(overshoot, 1),
        spread_text(settling, 2),
        spread_text(error, 1),
    ];
    let caption = "Rise is 10 % to 90 % of the step; settling is into the band for good; the error is the mean of the last second.";
    Ok(Table { caption: caption.to_owned(), heads, rows: steps.iter().map(row).collect(), foot: Some(foot) })
}

fn attacks(report: &Report) -> Result<Table, &'static str> {
    if report.attacks.is_empty() {
        return Err("No attack altered a sample.");
    }
    let after = |value: Option<f64>, ran: bool| match value {
        Some(s) => fixed(s, 2),
        None if ran => "never".to_owned(),
        None => NONE.to_owned(),
    };
    let row = |a: &Attack| {
        let mm = |m: Option<f64>| maybe(m.map(|m| m * 1e3), 1);
        vec![
            a.what.clone(),
            fixed(a.span_s[0], 1),
            fixed(a.span_s[1], 1),
            a.phase.to_owned(),
            after(a.isolated_after_s, report.secure),
            after(a.rejected_after_s, true),
            mm(a.largest_m),
            mm(a.rms_m[0]),
            mm(a.rms_m[1]),
            match (report.secure, a.false_exclusions.as_slice()) {
                (false, _) => NONE.to_owned(),
                (true, []) => "none".to_owned(),
                (true, names) => names.join(", "),
            },
        ]
    };
    let heads = vec![
        ("attack", false),
        ("from s", true),
        ("to s", true),
        ("ended", false),
        ("isolated after s", true),
        ("rejected after s", true),
        ("largest deviation mm", true),
        ("RMS mm", true),
        ("RMS before mm", true),
        ("false exclusions", false),
    ];
    let caption = "Isolated: by the secure estimator. Rejected: first sample outside the gate of the estimator in the loop. \
                   Deviation: altitude minus setpoint, while the attack was on and 2 s after.";
    Ok(Table { caption: caption.to_owned(), heads, rows: report.attacks.iter().map(row).collect(), foot: None })
}

fn ranking(report: &Report) -> Result<Table, &'static str> {
    if report.ranking.is_empty() {
        return Err("No truth in this flight: nothing to rank estimators by.");
    }
    let pair =
        |values: Option<[f64; 2]>| values.map_or_else(|| [NONE; 2].map(str::to_owned), |v| v.map(|v| fixed(v, 1)));
    let row = |(i, r): (usize, &Ranked)| {
        let ([rms, largest], [tilt, yaw]) = (pair(r.altitude_mm), pair(r.attitude_mrad));
        vec![(i + 1).to_string(), names::estimator_numbered(r.number).to_owned(), rms, largest, tilt, yaw]
    };
    let heads = vec![
        ("rank", true),
        ("estimator", false),
        ("altitude RMS mm", true),
        ("largest mm", true),
        ("roll and pitch RMS mrad", true),
        ("yaw RMS mrad", true),
    ];
    let rows: Vec<_> = report.ranking.iter().enumerate().map(row).collect();
    let caption = "Estimate minus truth while armed, from an estimator's first estimate on.".to_owned();
    Ok(Table { caption, heads, rows, foot: None })
}

/// None where the motors are commanded.
fn autopilot(report: &Report) -> Option<Table> {
    let row = |f: &Followed| {
        let what = match f.demand {
            Demand::Rate(axis) => format!("{} rate, rad/s", axis.name()),
            Demand::Thrust => "thrust, 0 to 1".to_owned(),
        };
        let [largest, off] = f.off.map_or([None; 2], |off| off.map(Some));
        vec![what, fixed(f.asked_rms, 3), maybe(off, 3), maybe(largest, 3)]
    };
    let heads = vec![("asked for", false), ("asked RMS", true), ("aimed at less asked, RMS", true), ("largest", true)];
    let caption =
        "What the autopilot was asked for in each tick while armed, and what it said last that its own loops aim at.";
    let rows: Vec<_> = report.autopilot.iter().map(row).collect();
    (!rows.is_empty()).then(|| Table { caption: caption.to_owned(), heads, rows, foot: None })
}

fn rows(rows: &[Row]) -> Result<Table, &'static str> {
    if rows.is_empty() {
        return Err("The recording does not say.");
    }
    let rows = rows.iter().map(|(name, value)| vec![name.clone(), value.clone()]).collect();
    Ok(Table { caption: String::new(), heads: vec![("what", false), ("value", false)], rows, foot: None })
}

/// So many times the range of the curve that leads is shown of the others.
const REACH: f64 = 4.0;

/// A figure; where a line `leads`, those that leave its range many times over run along the edge.
fn figure<'a>(
    title: &str,
    unit: &str,
    lines: Vec<Line<'a>>,
    live: &'a Live,
    leads: Option<Curve>,
) -> Option<Figure<'a>> {
    let span = live.curves.time_span_s()?;
    let time = TimeAxis::new(span.start, span.end.max(span.start + 1e-3));
    let extents = lines.iter().map(|l| l.series.extent_between(time.start_s, time.end_s)).filter(|e| !e.is_empty());
    let (low, high) = extents.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), e| {
        (low.min(f64::from(e.min)), high.max(f64::from(e.max)))
    });
    if low > high {
        return None;
    }
    let leader = leads.and_then(|curve| live.curves.get(curve)).zip(armed_s(live));
    let own = leader.map(|(series, (start_s, end_s))| series.extent_between(start_s, end_s));
    let reach = own.filter(|e| !e.is_empty()).map_or(f64::INFINITY, |e| REACH * f64::from(e.max.max(-e.min)).max(1.0));
    let values = ValueAxis::fit(low.max(-reach), high.min(reach), 1e-3, None);
    let seen = live.log.attacks.between(time.start_s, time.end_s).filter(|s| s.seen);
    let attacked = seen.map(|s| (s.start_s, s.end_s)).collect();
    Some(Figure {
        title: title.to_owned(),
        unit: unit.to_owned(),
        time,
        origin_s: time.start_s,
        values,
        attacked,
        lines,
    })
}

/// The figures of a report.
pub fn figures(live: &Live) -> Vec<Figure<'_>> {
    let in_loop = live.in_loop();
    let line = |name: &str, curve: Curve| {
        let stroke = palette::stroke(curve, in_loop);
        live.curves.get(curve).map(|series| Line { name: name.to_owned(), series, stroke })
    };
    let altitude: Vec<_> = [
        line("setpoint", Curve::SetpointAltitude),
        line("truth", Curve::TruthAltitude),
        line("estimate in the loop", Curve::Altitude(in_loop)),
    ]
    .into_iter()
    .flatten()
    .collect();
    let errors: Vec<_> =
        live.curves.error_names(None).filter_map(|(curve, n)| line(names::estimator_numbered(n), curve)).collect();
    let against =
        if live.curves.has_truth() { "Altitude: estimate minus truth" } else { "Altitude: estimate minus setpoint" };
    let leads = Some(Curve::AltitudeError(in_loop));
    let rates = Axis::ALL.into_iter().flat_map(|axis| {
        let demand = Demand::Rate(axis);
        let name = axis.name();
        [
            line(&format!("{name} asked"), Curve::Asked(demand)),
            line(&format!("{name} aimed at"), Curve::AimedAt(demand)),
        ]
    });
    [
        figure("Altitude", "m", altitude, live, None),
        figure(against, "mm", errors, live, leads),
        figure("Rates asked of the autopilot", "rad/s", rates.flatten().collect(), live, None),
    ]
    .into_iter()
    .flatten()
    .collect()
}

impl Report {
    /// Its tables by their titles, or why there is none; `offset_min` is how far the reader's clock is behind UTC.
    fn tables(&self, offset_min: i64) -> Vec<(&'static str, Result<Table, &'static str>)> {
        let flight = &self.flight;
        let missing = if flight.missing == 0 { "none".to_owned() } else { count(flight.missing) };
        let facts: Vec<Row> = [
            ("flight", flight.id.clone()),
            ("begun", listing::when(flight.started_unix_us, offset_min)),
            ("duration", format!("{} min", clock(flight.duration_s))),
            (
                "recording",
                format!("{}, {} messages, missing: {missing}", flight.completeness.name(), count(flight.messages)),
            ),
        ]
        .map(|(name, value)| (name.to_owned(), value))
        .into();
        let flown = [("Steps", steps(self)), ("Attacks", attacks(self)), ("Estimators", ranking(self))];
        let set_up = [
            ("Recording", rows(&[facts, self.versions.clone()].concat())),
            ("Configuration", rows(&self.vehicle)),
            ("Controller", rows(&self.gains)),
        ];
        let autopilot = autopilot(self).map(|table| ("Autopilot", Ok(table)));
        flown.into_iter().chain(autopilot).chain(set_up).collect()
    }

    /// The body of the report, with its figures.
    pub fn html(&self, live: &Live, offset_min: i64) -> String {
        let flight = &self.flight;
        let mut out = format!("<h1>{}</h1><p class=\"lead\">{}</p>", plain(flight.title()), plain(&self.sentence));
        if !flight.notes.trim().is_empty() {
            let _ = write!(out, "<p class=\"notes\">{}</p>", plain(&flight.notes));
        }
        out += &figures(live).iter().map(Figure::html).collect::<String>();
        let mut section = |title: &str, body: String| {
            let _ = write!(out, "<section tabindex=\"0\" aria-label=\"{title}\"><h2>{title}</h2>{body}</section>");
        };
        for (title, table) in self.tables(offset_min) {
            section(title, table.map_or_else(|none| format!("<p>{none}</p>"), |table| table.html()));
        }
        section(
            "Scenario",
            match self.scenario.as_str() {
                "" => "<p>The recording does not say.</p>".to_owned(),
                scenario => format!("<pre>{}</pre>", plain(scenario)),
            },
        );
        out
    }

    /// Its tables for a LaTeX document that uses booktabs.
    pub fn latex(&self, offset_min: i64) -> String {
        let mut out = format!("% {}\n% \\usepackage{{booktabs}}\n", self.flight.id);
        for (title, table) in self.tables(offset_min) {
            if let Ok(table) = table {
                let _ = write!(out, "\n{}", table.latex(title));
            }
        }
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_table_is_latex_with_booktabs_and_what_means_something_there_is_escaped() {
        let table = Table {
            caption: "10 % to 90 % of the step.".into(),
            heads: vec![("rise s", true), ("who_what", false)],
            rows: vec![vec!["0.42".into(), "height 2: bias \u{2212}0.5 m & more".into()]],
            foot: Some(vec!["0.4 ± 0.1".into(), NONE.into()]),
        };
        let text = table.latex("Steps");
        assert!(
            text.contains("\\begin{tabular}{rl}\n    \\toprule\n    rise s & who\\_what \\\\\n    \\midrule\n"),
            "{text}"
        );
        assert!(text.contains("    0.42 & height 2: bias $-$0.5 m \\& more \\\\\n    \\midrule\n    0.4 $\\pm$ 0.1 & --- \\\\\n    \\bottomrule"), "{text}");
        assert!(text.contains("\\caption{Steps. 10 \\% to 90 \\% of the step.}"), "{text}");
        assert_eq!(tex("a\\b^2~{x}"), "a\\textbackslash{}b\\textasciicircum{}2\\textasciitilde{}\\{x\\}");
    }
}
