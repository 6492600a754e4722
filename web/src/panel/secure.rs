//! The secure estimator's account: attacked set over time, margins, certificate, audit, tracking error.
//!
//! It stands in the place of the residuals, on the same time axis. [Clinic] Table 1 is the limit it is judged
//! by: tracking error under attack at most 1.2 e*, e* being the error of the same flight without attack.

use leptos::prelude::*;
use plumbline_proto::v1::{self, Decoder, DecoderStatus, FlagReason, SecureFallback, SensorKind};
use plumbline_rest::command as rest;
use serde_json::json;

use super::{plot::Plot, residuals::EvidenceSwitch};
use crate::{
    ctx::ctx,
    deck::{Deck, Picture, Source, deck},
    model::{
        curves::{Curve, suspicion},
        format::{self, NONE},
        names,
    },
};

/// [Clinic] Table 1: largest e / e* that still counts as recovered.
const RATIO_LIMIT: f64 = 1.2;
/// A gap above this is no certificate any more.
const GAP_GOOD: f64 = 1e-6;

/// The programs that can be chosen in flight.
const DECODERS: [Decoder; 4] = [Decoder::L2, Decoder::L1, Decoder::L2Split, Decoder::L1Split];

/// The program being solved: chosen live, told of a recording.
#[component]
fn DecoderChoice(deck: Deck, newest: Memo<Option<v1::SecureStatus>>) -> impl IntoView {
    let now = Memo::new(move |_| newest.get().map_or(Decoder::Unspecified, |s| s.decoder()));
    if deck.source == Source::Recorded {
        return view! { <span class="quiet" aria-label="Decoder">{move || now.get().title()}</span> }.into_any();
    }
    let ctx = ctx();
    let choose = move |list: web_sys::HtmlSelectElement| {
        let value = list.value();
        // It shows what is in use: the other one once the vehicle solves it.
        list.set_value(&(now.get_untracked() as i32).to_string());
        let Some(decoder) = value.parse().ok().and_then(|n: i32| Decoder::try_from(n).ok()) else { return };
        let what = format!("Decoder {}", decoder.title());
        ctx.command(what, "POST", "decoder", json!(rest::Decoder { decoder: names::decoder_json(decoder) }));
    };
    view! {
        <select
            class="small"
            aria-label="Decoder"
            title="Norm over time; split: position and orientation apart, as in [Clinic] 3.4.1"
            prop:value=move || (now.get() as i32).to_string()
            on:change:target=move |e| choose(e.target())
        >
            {DECODERS.map(|d| view! {
                <option value=(d as i32).to_string() selected=move || now.get() == d>{d.title()}</option>
            }).collect_view()}
        </select>
    }
    .into_any()
}

fn kind(sensor: i32) -> SensorKind {
    SensorKind::try_from(sensor).unwrap_or_default()
}

/// Why a sensor is flagged, in a word or two.
fn reason(reason: FlagReason) -> &'static str {
    match reason {
        FlagReason::None => "",
        FlagReason::Window => "in the window",
        FlagReason::Drift => "drifting",
        FlagReason::Stuck => "stuck",
        FlagReason::Stamp => "stamped as of another time",
    }
}

fn status(status: DecoderStatus) -> (&'static str, &'static str) {
    match status {
        DecoderStatus::Unspecified => ("quiet", NONE),
        DecoderStatus::Filling => ("quiet", "window filling"),
        DecoderStatus::Solved => ("good", "solved"),
        DecoderStatus::MaxIterations => ("warn", "iteration limit"),
        DecoderStatus::MaxTime => ("warn", "deadline came first"),
        DecoderStatus::Stalled => ("warn", "no further decrease"),
        DecoderStatus::Unobservable => ("bad", "not observable"),
        DecoderStatus::OutsideModel => ("bad", "outside the linear model"),
    }
}

fn fallback(fallback: SecureFallback) -> &'static str {
    match fallback {
        SecureFallback::None => "",
        SecureFallback::Anytime => "last iterate used",
        SecureFallback::PreviousSet => "attacked set of before",
        SecureFallback::Prediction => "prediction only",
    }
}

/// One figure of the certificate: name, value, class, explanation.
type Figure = (String, String, &'static str, &'static str);

/// e / e*, once both are known.
fn ratio(s: &v1::SecureStatus) -> Option<f64> {
    let (e, reference) = (s.tracking_error_m?, s.reference_error_m?);
    (reference > 0.0).then(|| e / reference)
}

/// Flagged sensors named in one sentence; more are only counted.
const NAMED: usize = 3;

/// What it comes to, in one sentence, and how good that is.
fn sentence(s: &v1::SecureStatus) -> (String, &'static str) {
    match s.status() {
        DecoderStatus::Unspecified | DecoderStatus::Filling => {
            return ("The first window is filling: nothing can be isolated yet.".to_owned(), "quiet");
        }
        bad @ (DecoderStatus::Unobservable | DecoderStatus::OutsideModel) => {
            return (format!("Nothing can be isolated: the window is {}.", status(bad).1), "bad");
        }
        _ => {}
    }
    let flagged: Vec<_> = s.sensors.iter().filter(|x| x.flagged).collect();
    let known = s.sensors.iter().filter(|x| x.present || x.flagged).count();
    let mut names: Vec<_> = flagged.iter().take(NAMED).map(|x| names::instance(kind(x.sensor), x.instance)).collect();
    if flagged.len() > NAMED {
        names.push(format!("{} more", flagged.len() - NAMED));
    }
    let who = match flagged.len() {
        0 => format!("No sensor of {known} is excluded"),
        n => format!("{n} of {known} sensors excluded ({})", names.join(", ")),
    };
    let height = s.height_bound_m.map_or_else(
        || "no bound is promised for the height".to_owned(),
        |bound| format!("height good to ±{} mm", format::fixed(bound * 1e3, 0)),
    );
    let lost = s.margins.iter().any(|m| m.margin <= 0);
    let class = if lost {
        "bad"
    } else if flagged.is_empty() {
        "good"
    } else {
        "warn"
    };
    (format!("{who}; {height}."), class)
}

/// The margin of a type as a figure: what it is made of, and what it means.
fn margin_figure(m: &v1::SecureMargin) -> Figure {
    let class = if m.margin > 0 { "" } else { "bad" };
    let what = format!("{} present − 2 · {} excluded = {}", m.present, m.flagged, m.margin);
    (format!("{} margin", names::sensor(kind(m.sensor))), what, class, "0 or less promises nothing for this type")
}

/// What was learned of stamps.
fn delay_figure(of: &str, delay_s: f64) -> Figure {
    let late = if delay_s < 0.0 { "early" } else { "late" };
    let what = format!("{} ms {late}", format::fixed(1e3 * delay_s.abs(), 0));
    (format!("{of} stamps"), what, "", "Learned from how the vehicle moves, and taken off")
}

/// How many more sensors of a type may be attacked before their majority no longer tells which: (text, class).
fn margin(m: &v1::SecureMargin) -> (String, &'static str) {
    let name = names::sensor(kind(m.sensor));
    match m.margin {
        left @ 1.. => (format!("{name}: {} more may be attacked", (left - 1) / 2), "good"),
        _ => (format!("{name}: which are attacked cannot be told"), "bad"),
    }
}

fn figures(s: &v1::SecureStatus) -> Vec<Figure> {
    let ratio = ratio(s);
    let mut figures = vec![
        (
            "error e".into(),
            format::millimetres(s.tracking_error_m, 1),
            "",
            "RMS of altitude minus setpoint over the last 10 s",
        ),
        ("e* unattacked".into(), format::millimetres(s.reference_error_m, 1), "", "The same while nothing was flagged"),
        (
            "e / e*".into(),
            format!("{} of {RATIO_LIMIT}", format::maybe(ratio, 2)),
            if ratio.is_none_or(|r| r <= RATIO_LIMIT) { "good" } else { "bad" },
            "[Clinic] Table 1: at most 1.2 under attack",
        ),
        (
            "height bound".into(),
            s.height_bound_m.map_or_else(|| "no promise".to_owned(), |b| format!("±{} mm", format::fixed(b * 1e3, 0))),
            "",
            "Most that the altitude is off by while fewer than half of the heights are attacked",
        ),
    ];
    figures.extend(s.margins.iter().map(margin_figure));
    let delays = [("height", s.height_delay_s), ("motion capture", s.pose_delay_s)];
    figures.extend(delays.into_iter().filter_map(|(of, delay_s)| Some(delay_figure(of, delay_s?))));
    if s.window_slots > 0 {
        figures.extend(of_window(s));
    }
    figures
}

/// What only an estimator that decodes a window has.
fn of_window(s: &v1::SecureStatus) -> [Figure; 6] {
    let (class, said) = status(s.status());
    let decoder = match fallback(s.fallback()) {
        "" => format!("{said}, T = {}", s.window_slots),
        extra => format!("{said}, {extra}"),
    };
    let force = s.disturbance_enu_n.map_or_else(|| NONE.to_owned(), |f| format!("{} N up", format::signed(f.z, 2)));
    let audit = s.audit_difference.map_or_else(|| NONE.to_owned(), |d| format!("{d:.0e}"));
    [
        ("decoder".into(), decoder, class, "How the last window ended, and its slots of 40 ms"),
        (
            "optimality gap".into(),
            format!("{:.0e}", s.gap),
            if s.gap <= GAP_GOOD { "good" } else { "warn" },
            "Certified: how far from optimal at most. It certifies optimality, not truth",
        ),
        (
            "solved in".into(),
            format!("{} µs, {} it.", format::fixed(s.solve_time_us, 0), s.iterations),
            "",
            "Decoding and identification, with Newton iterations",
        ),
        (
            "audit".into(),
            audit,
            if s.audit_difference.is_none_or(|d| d < 1e-4) { "" } else { "bad" },
            "Relative difference to Clarabel on the same window, once a second",
        ),
        ("disturbance".into(), force, "", "Force that neither motors nor gravity explain: strings, ground, wind"),
        ("resets".into(), s.resets.to_string(), "", "Filter resets to the decoder since boot"),
    ]
}

/// What is known of the rotors: a sentence and its class; nothing from agents that do not look after them.
pub fn rotors(s: &v1::Status) -> Option<(String, &'static str)> {
    let weak: Vec<_> = s
        .rotor_effectiveness
        .iter()
        .zip(1..)
        .filter(|(part, _)| **part < 1.0)
        .map(|(part, rotor)| format!("rotor {rotor} gives {} % of its thrust", format::fixed(100.0 * part, 0)))
        .collect();
    match (s.rotor_effectiveness.is_empty(), weak.is_empty()) {
        (true, _) => None,
        (_, false) => Some((weak.join(", "), "bad")),
        _ if s.rotors_watched => Some(("rotors: no loss found".to_owned(), "")),
        _ => Some((
            "rotors: not watched on the ground, held up, or in the first seconds of a flight".to_owned(),
            "quiet",
        )),
    }
}

/// The secure card.
#[component]
pub fn SecureCard() -> impl IntoView {
    let deck = deck();
    let newest = Memo::new(move |_| deck.read(|live| live.secure.get().cloned()));
    let old = Memo::new(move |_| deck.is_old(|live| &live.secure));
    let margins = move || {
        newest
            .get()
            .map(|s| s.margins)
            .unwrap_or_default()
            .into_iter()
            .map(|m| {
                let (text, class) = margin(&m);
                view! { <li class=format!("num {class}")>{text}</li> }
            })
            .collect::<Vec<_>>()
    };
    view! {
        <section class="card chart residuals secure" class:stale=old aria-label="Secure estimation">
            <header>
                <h2>"Attacked set"</h2>
                <ul class="legend heat-key" aria-label="Colours">
                    <li><span class="heat raised"></span>"suspect"</li>
                    <li><span class="heat rejected"></span>"isolated: excluded"</li>
                </ul>
                <span class="push"></span>
                <Show when=move || newest.get().is_some_and(|s| s.window_slots > 0)><DecoderChoice deck newest /></Show>
                <span class="buttons-row"><EvidenceSwitch /></span>
            </header>
            <Show when=move || newest.with(Option::is_some)>
                <div class="secure-sentence">
                    {move || newest.get().map(|s| {
                        let (text, class) = sentence(&s);
                        view! { <p class=format!("num {class}")>{text}</p> }
                    })}
                    <ul class="legend margins" aria-label="Margins">{margins}</ul>
                    <details>
                        <summary>"Details"</summary>
                        <dl class="secure-figures" tabindex="0" aria-label="Details of the secure estimator">
                            {move || newest.get().map(|s| figures(&s)).unwrap_or_default().into_iter().map(|(name, value, class, why)| view! {
                                <div><dt>{name}</dt><dd class=format!("num {class}")>{value}</dd><dd class="quiet">{why}</dd></div>
                            }).collect::<Vec<_>>()}
                        </dl>
                    </details>
                </div>
            </Show>
            {move || deck.read(|live| live.status.get().and_then(rotors)).map(|(text, class)| view! {
                <p class=format!("num {class}") title="Thrust of each rotor as torque and vertical force say it; no speed of a motor is read">{text}</p>
            })}
            <div class="res-body">
                <Sensors deck newest />
                <Plot picture=Picture::Suspicion values=false label="Suspicion of each sensor over time; above 1 it is isolated and excluded" />
                <Show when=move || newest.get().is_none()>
                    <p class="empty">"No secure estimator runs here. Choose it under Estimator: it isolates attacked sensors and flies on the rest."</p>
                </Show>
            </div>
        </section>
    }
}

/// A row per sensor: name, why it is flagged, how suspect it is.
#[component]
fn Sensors(deck: Deck, newest: Memo<Option<v1::SecureStatus>>) -> impl IntoView {
    let rows = Memo::new(move |_| deck.read(|live| live.suspicion_rows()));
    let row = move |(sensor, instance): (i32, u32)| {
        let now = Memo::new(move |_| {
            newest.get().and_then(|s| s.sensors.into_iter().find(|x| (x.sensor, x.instance) == (sensor, instance)))
        });
        let ratio = Memo::new(move |_| match deck.reading_s() {
            Some(time) => deck.read(|live| live.curves.value_at(Curve::Suspicion(sensor, instance), time)),
            None => now.get().filter(|s| s.present).map(|s| suspicion(&s)),
        });
        let flagged = move || ratio.get().is_some_and(|r| r > 1.0);
        let why = move || match now.get() {
            Some(s) if deck.source == Source::Live && s.flagged => reason(s.reason()),
            Some(s) if deck.source == Source::Live && !s.present => "absent",
            _ => "",
        };
        view! {
            <li class="res-row">
                <span class="res-name"><span>{names::instance(kind(sensor), instance)}</span><span class="res-channel">{why}</span></span>
                <span class="res-value num" class:rejected=flagged class:none=move || ratio.get().is_none()>
                    {move || format::maybe(ratio.get().map(|r| r.min(99.99)), 2)}
                </span>
            </li>
        }
    };
    view! {
        <ul class="res-list" style=move || format!("--rows:{}", rows.get().len().max(1))>
            <For each=move || rows.get() key=|r| *r children=row />
        </ul>
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stamps_are_told_once_they_are_learned() {
        let named = |s: &v1::SecureStatus| {
            let of = |(name, what, ..): Figure| name.ends_with("stamps").then(|| format!("{name} {what}"));
            figures(s).into_iter().filter_map(of).collect::<Vec<_>>()
        };
        assert!(named(&v1::SecureStatus::default()).is_empty());
        let learned =
            v1::SecureStatus { height_delay_s: Some(-0.0312), pose_delay_s: Some(0.004), ..Default::default() };
        assert_eq!(named(&learned), ["height stamps 31 ms early", "motion capture stamps 4 ms late"]);
    }

    #[test]
    fn one_sentence_says_who_is_excluded_and_what_the_height_is_good_for() {
        let sensor = |instance, flagged| v1::SecureSensor {
            sensor: SensorKind::Height.into(),
            instance,
            present: true,
            flagged,
            ..Default::default()
        };
        let margin_of = |present, flagged| v1::SecureMargin {
            sensor: SensorKind::Height.into(),
            present,
            flagged,
            margin: present as i32 - 2 * flagged as i32,
        };
        let mut s = v1::SecureStatus {
            sensors: (1..=5).map(|i| sensor(i, false)).collect(),
            margins: vec![margin_of(5, 0)],
            height_bound_m: Some(0.056),
            ..Default::default()
        };
        assert_eq!(sentence(&s).1, "quiet");
        s.set_status(DecoderStatus::Solved);
        assert_eq!(sentence(&s), ("No sensor of 5 is excluded; height good to ±56 mm.".to_owned(), "good"));
        s.sensors[1].flagged = true;
        s.margins = vec![margin_of(5, 1)];
        assert_eq!(sentence(&s).0, "1 of 5 sensors excluded (height 2); height good to ±56 mm.");
        assert_eq!(margin(&s.margins[0]), ("height: 1 more may be attacked".to_owned(), "good"));
        s.sensors.iter_mut().take(4).for_each(|x| x.flagged = true);
        (s.margins, s.height_bound_m) = (vec![margin_of(5, 4)], None);
        let (text, class) = sentence(&s);
        assert_eq!(
            text,
            "4 of 5 sensors excluded (height 1, height 2, height 3, 1 more); no bound is promised for the height."
        );
        assert_eq!((class, margin(&s.margins[0]).1), ("bad", "bad"));
        s.set_status(DecoderStatus::OutsideModel);
        assert_eq!(sentence(&s).0, "Nothing can be isolated: the window is outside the linear model.");
    }

    #[test]
    fn a_weak_rotor_is_named_with_what_it_gives() {
        let mut s = v1::Status::default();
        assert_eq!(rotors(&s), None);
        s.rotor_effectiveness = vec![1.0; 4];
        assert!(rotors(&s).unwrap().0.contains("not watched"));
        s.rotors_watched = true;
        assert_eq!(rotors(&s).unwrap().0, "rotors: no loss found");
        s.rotor_effectiveness[1] = 0.796;
        assert_eq!(rotors(&s), Some(("rotor 2 gives 80 % of its thrust".to_owned(), "bad")));
    }

    #[test]
    fn the_ratio_needs_both_errors_and_is_judged_by_table_1() {
        let mut s = v1::SecureStatus { tracking_error_m: Some(0.03), ..Default::default() };
        assert_eq!(ratio(&s), None);
        s.reference_error_m = Some(0.02);
        let found = figures(&s).into_iter().find(|f| f.0 == "e / e*").unwrap();
        assert_eq!((found.1.as_str(), found.2), ("1.50 of 1.2", "bad"));
        s.set_status(DecoderStatus::MaxTime);
        s.set_fallback(SecureFallback::Anytime);
        assert!(figures(&s).iter().all(|f| f.0 != "decoder"), "an estimator without a window has no decoder");
        s.window_slots = 10;
        let decoder = figures(&s).into_iter().find(|f| f.0 == "decoder").unwrap();
        assert_eq!(decoder.1, "deadline came first, last iterate used");
    }
}
