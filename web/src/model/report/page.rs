//! The report as HTML: the body for the page, and the same as a document that needs nothing else.

use std::fmt::Write;

use super::{Attack, Ranked, Report, Spread, armed_s, step_spreads};
use crate::model::{
    axis::{TimeAxis, ValueAxis},
    configuration::Row,
    curves::Curve,
    decimate::{Decimated, Joined, decimate},
    format::{NONE, clock, count, fixed, signed},
    listing,
    live::Live,
    names,
    series::Series,
};
use crate::palette::{self, Ink};

/// The style of the report, on the page and alone.
const STYLE: &str = include_str!("../../../report.css");

/// Text that means nothing but itself.
fn plain(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

/// A whole document around the body.
pub fn document(title: &str, body: &str) -> String {
    let title = plain(title);
    format!(
        "<!doctype html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"><meta name=\"viewport\" \
         content=\"width=device-width, initial-scale=1\"><title>{title}</title><style>{STYLE}</style></head>\
         <body class=\"report-alone\"><article class=\"report\">{body}</article></body></html>\n"
    )
}

/// A table: heads, rows, and whether each column is of numbers.
fn table(caption: &str, heads: &[(&str, bool)], rows: &[Vec<String>], foot: Option<Vec<String>>) -> String {
    let class = |i: usize| if heads.get(i).is_some_and(|(_, number)| *number) { " class=\"num\"" } else { "" };
    let mut out = format!("<table><caption>{}</caption><thead><tr>", plain(caption));
    for (i, (head, _)) in heads.iter().enumerate() {
        let _ = write!(out, "<th scope=\"col\"{}>{}</th>", class(i), plain(head));
    }
    out += "</tr></thead><tbody>";
    let line = |cells: &Vec<String>| {
        let cells = cells.iter().enumerate().map(|(i, cell)| format!("<td{}>{}</td>", class(i), plain(cell)));
        format!("<tr>{}</tr>", cells.collect::<String>())
    };
    out += &rows.iter().map(line).collect::<String>();
    out += "</tbody>";
    if let Some(foot) = foot {
        let _ = write!(out, "<tfoot>{}</tfoot>", line(&foot));
    }
    out += "</table>";
    out
}

fn maybe(value: Option<f64>, decimals: usize) -> String {
    value.map_or_else(|| NONE.to_owned(), |v| fixed(v, decimals))
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

fn steps(report: &Report) -> String {
    let steps = &report.flight.steps;
    if steps.is_empty() {
        return "<p>No step of the altitude setpoint.</p>".to_owned();
    }
    let heads = [
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
    table(caption, &heads, &steps.iter().map(row).collect::<Vec<_>>(), Some(foot))
}

fn attacks(report: &Report) -> String {
    if report.attacks.is_empty() {
        return "<p>No attack altered a sample.</p>".to_owned();
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
    let heads = [
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
    table(caption, &heads, &report.attacks.iter().map(row).collect::<Vec<_>>(), None)
}

fn ranking(report: &Report) -> String {
    if report.ranking.is_empty() {
        return "<p>No truth in this flight: nothing to rank estimators by.</p>".to_owned();
    }
    let pair =
        |values: Option<[f64; 2]>| values.map_or_else(|| [NONE; 2].map(str::to_owned), |v| v.map(|v| fixed(v, 1)));
    let row = |(i, r): (usize, &Ranked)| {
        let ([rms, largest], [tilt, yaw]) = (pair(r.altitude_mm), pair(r.attitude_mrad));
        vec![(i + 1).to_string(), names::estimator_numbered(r.number).to_owned(), rms, largest, tilt, yaw]
    };
    let heads = [
        ("rank", true),
        ("estimator", false),
        ("altitude RMS mm", true),
        ("largest mm", true),
        ("roll and pitch RMS mrad", true),
        ("yaw RMS mrad", true),
    ];
    let rows: Vec<_> = report.ranking.iter().enumerate().map(row).collect();
    table("Estimate minus truth while armed, from an estimator's first estimate on.", &heads, &rows, None)
}

fn rows(caption: &str, rows: &[Row]) -> String {
    let cells: Vec<_> = rows.iter().map(|(name, value)| vec![name.clone(), value.clone()]).collect();
    table(caption, &[("what", false), ("value", false)], &cells, None)
}

/// A curve of a figure: its name, its samples, its colour, dashed?
struct Line<'a> {
    name: String,
    series: &'a Series,
    ink: Ink,
    dashed: bool,
}

/// Size of a figure, its margins left and below, px.
const FIGURE: [f64; 4] = [860.0, 230.0, 46.0, 20.0];

/// So many times the range of the curve that leads is shown of the others.
const REACH: f64 = 4.0;

/// A figure; where a line `leads`, those that leave its range many times over run along the edge.
fn figure(title: &str, unit: &str, lines: &[Line<'_>], live: &Live, leads: Option<Curve>) -> String {
    let Some(span) = live.curves.time_span_s() else { return String::new() };
    let axis = TimeAxis::new(span.start, span.end.max(span.start + 1e-3));
    let [width, height, left, below] = FIGURE;
    let (w, h) = (width - left - 6.0, height - below - 6.0);
    let extents = lines.iter().map(|l| l.series.extent_between(axis.start_s, axis.end_s)).filter(|e| !e.is_empty());
    let (low, high) = extents.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), e| {
        (low.min(f64::from(e.min)), high.max(f64::from(e.max)))
    });
    if low > high {
        return String::new();
    }
    let leader = leads.and_then(|curve| live.curves.get(curve)).zip(armed_s(live));
    let own = leader.map(|(series, (start_s, end_s))| series.extent_between(start_s, end_s));
    let reach = own.filter(|e| !e.is_empty()).map_or(f64::INFINITY, |e| REACH * f64::from(e.max.max(-e.min)).max(1.0));
    let (low, high) = (low.max(-reach), high.min(reach));
    let values = ValueAxis::fit(low, high, 1e-3, None);
    let x = |time_s: f64| left + axis.fraction(time_s).clamp(0.0, 1.0) * w;
    let y = |value: f64| 6.0 + (1.0 - values.fraction(value).clamp(0.0, 1.0)) * h;
    let mut out = format!(
        "<figure><figcaption>{} <small>{}</small></figcaption><svg viewBox=\"0 0 {width} {height}\" role=\"img\" aria-label=\"{}\">",
        plain(title),
        plain(unit),
        plain(title)
    );
    for span in live.log.attacks.iter().filter(|s| s.seen) {
        let (a, b) = (x(span.start_s), x(span.end_s));
        let _ = write!(
            out,
            "<rect class=\"attacked\" x=\"{a:.1}\" y=\"6\" width=\"{:.1}\" height=\"{h:.1}\"/>",
            (b - a).max(1.0)
        );
    }
    for tick in values.ticks(h, 36.0) {
        let at = y(tick.value);
        let _ = write!(
            out,
            "<path class=\"grid\" d=\"M{left} {at:.1}H{:.1}\"/><text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"end\">{}</text>",
            left + w,
            left - 6.0,
            at + 4.0,
            tick.label
        );
    }
    let ticks = axis.ticks(w, 90.0, axis.start_s);
    for (i, tick) in ticks.iter().enumerate() {
        let at = x(tick.value);
        let end = if i + 1 == ticks.len() { " min" } else { "" };
        let _ = write!(
            out,
            "<path class=\"grid\" d=\"M{at:.1} 6V{:.1}\"/><text x=\"{at:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{}{end}</text>",
            6.0 + h,
            height - 4.0,
            tick.label
        );
    }
    for line in lines {
        let dash = if line.dashed { " stroke-dasharray=\"6 4\"" } else { "" };
        let d = path(line.series, axis, w, |column, value| [left + f64::from(column), y(f64::from(value))]);
        let _ = write!(out, "<path class=\"line\" style=\"stroke:{}\"{dash} d=\"{d}\"/>", line.ink.css());
    }
    out += "</svg><ul class=\"key\">";
    for line in lines {
        let kind = if line.dashed { "dashed" } else { "" };
        let _ = write!(
            out,
            "<li><i class=\"{kind}\" style=\"border-color:{}\"></i>{}</li>",
            line.ink.css(),
            plain(&line.name)
        );
    }
    out += "</ul></figure>";
    out
}

/// A curve as an SVG path of one point, or one smallest and largest, per column.
fn path(series: &Series, axis: TimeAxis, columns: f64, place: impl Fn(f32, f32) -> [f64; 2]) -> String {
    let mut decimated = Decimated::default();
    decimate(series, axis.start_s, axis.end_s, columns as usize, Joined::Straight, &mut decimated);
    let mut out = String::new();
    for run in &decimated.runs {
        let mut pen = 'M';
        for point in decimated.points.get(run.clone()).unwrap_or_default() {
            let mut to = |value: f32| {
                let [x, y] = place(point.x, value);
                let _ = write!(out, "{pen}{x:.1} {y:.1}");
                pen = 'L';
            };
            to(point.low);
            if point.high != point.low {
                to(point.high);
            }
        }
    }
    out
}

fn figures(live: &Live) -> String {
    let in_loop = live.in_loop();
    let line = |name: &str, curve: Curve, ink: Ink, dashed: bool| {
        live.curves.get(curve).map(|series| Line { name: name.to_owned(), series, ink, dashed })
    };
    let altitude: Vec<_> = [
        line("setpoint", Curve::SetpointAltitude, palette::SETPOINT, false),
        line("truth", Curve::TruthAltitude, palette::TRUTH, true),
        line("estimate in the loop", Curve::Altitude(in_loop), palette::IN_LOOP, false),
    ]
    .into_iter()
    .flatten()
    .collect();
    let errors: Vec<_> = live
        .curves
        .error_names(None)
        .filter_map(|(curve, n)| line(names::estimator_numbered(n), curve, palette::estimator(n, in_loop), false))
        .collect();
    let against =
        if live.curves.has_truth() { "Altitude: estimate minus truth" } else { "Altitude: estimate minus setpoint" };
    let leads = Some(Curve::AltitudeError(in_loop));
    figure("Altitude", "m", &altitude, live, None) + &figure(against, "mm", &errors, live, leads)
}

impl Report {
    /// The body of the report, with its figures; `offset_min` is how far the reader's clock is behind UTC.
    pub fn html(&self, live: &Live, offset_min: i64) -> String {
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
        let mut out = format!("<h1>{}</h1><p class=\"lead\">{}</p>", plain(flight.title()), plain(&self.sentence));
        if !flight.notes.trim().is_empty() {
            let _ = write!(out, "<p class=\"notes\">{}</p>", plain(&flight.notes));
        }
        out += &figures(live);
        let mut section = |title: &str, body: String| {
            let _ = write!(out, "<section tabindex=\"0\" aria-label=\"{title}\"><h2>{title}</h2>{body}</section>");
        };
        section("Steps", steps(self));
        section("Attacks", attacks(self));
        section("Estimators", ranking(self));
        section("Recording", rows("", &[facts, self.versions.clone()].concat()));
        section("Configuration", rows("", &self.vehicle));
        let none = || "<p>The recording does not say.</p>".to_owned();
        section("Controller", if self.gains.is_empty() { none() } else { rows("", &self.gains) });
        section(
            "Scenario",
            if self.scenario.is_empty() { none() } else { format!("<pre>{}</pre>", plain(&self.scenario)) },
        );
        out
    }
}
