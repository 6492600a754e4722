//! The report of a flight: what happened, in figures. `page` writes it as a document of its own.

mod page;

use plumbline_rest::flight::{AttackEffect, Figures, Flight, Step};

use super::{
    configuration::{self, Row},
    curves::Demand,
    draft::subject,
    format::{clock, fixed, plural},
    live::Live,
    names,
};

pub use page::{document, figures};

/// What an attack did.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Attack {
    /// "height 2: bias +0.5 m"
    pub what: String,
    /// Onset and end, s of the report.
    pub span_s: [f64; 2],
    /// How it ended.
    pub phase: &'static str,
    /// Onset to isolation by the secure estimator, s.
    pub isolated_after_s: Option<f64>,
    /// Onset to the first sample that the estimator in the loop rejected, s.
    pub rejected_after_s: Option<f64>,
    /// Largest deviation of the altitude from its setpoint while it was on and two seconds after, m.
    pub largest_m: Option<f64>,
    /// RMS of that deviation meanwhile, and in as long a time before, m.
    pub rms_m: [Option<f64>; 2],
    /// Healthy sensors that the secure estimator excluded meanwhile.
    pub false_exclusions: Vec<String>,
}

/// What an estimator was off by.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Ranked {
    /// Its number.
    pub number: u16,
    /// RMS and largest error of the altitude, mm.
    pub altitude_mm: Option<[f64; 2]>,
    /// RMS of roll and pitch together, and of yaw, mrad.
    pub attitude_mrad: Option<[f64; 2]>,
}

/// How an autopilot took over what it was asked for, rad/s or 0..1.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Followed {
    /// What.
    pub demand: Demand,
    /// RMS of what was asked.
    pub asked_rms: f64,
    /// Largest and RMS of what it said it aims at, less what was asked in the same tick; absent where it never said.
    pub off: Option<[f64; 2]>,
}

/// Mean, standard deviation and number of some values.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Spread {
    /// Mean.
    pub mean: f64,
    /// Standard deviation of the sample; absent of one value.
    pub sigma: Option<f64>,
    /// Values.
    pub count: usize,
}

/// A flight in figures.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Report {
    /// As the ground has it.
    pub flight: Flight,
    /// What happened.
    pub sentence: String,
    /// Each attack that altered a sample.
    pub attacks: Vec<Attack>,
    /// Did the secure estimator run?
    pub secure: bool,
    /// Best altitude first; empty where no truth is known.
    pub ranking: Vec<Ranked>,
    /// What an autopilot was asked for, and did; empty where the motors are commanded.
    pub autopilot: Vec<Followed>,
    /// What it was flown with.
    pub vehicle: Vec<Row>,
    /// And with which gains.
    pub gains: Vec<Row>,
    /// The scenario as it was given.
    pub scenario: String,
    /// Versions of what wrote this.
    pub versions: Vec<Row>,
}

/// Mean ± σ of what is known.
pub fn spread(values: impl Iterator<Item = Option<f64>>) -> Option<Spread> {
    let known: Vec<f64> = values.flatten().filter(|v| v.is_finite()).collect();
    let count = known.len();
    if count == 0 {
        return None;
    }
    let mean = known.iter().sum::<f64>() / count as f64;
    let squares: f64 = known.iter().map(|v| (v - mean).powi(2)).sum();
    Some(Spread { mean, sigma: (count > 1).then(|| (squares / (count - 1) as f64).sqrt()), count })
}

/// The columns of the step table, each over all steps: rise, overshoot, settling, error in mm.
pub fn step_spreads(steps: &[Step]) -> [Option<Spread>; 4] {
    [
        spread(steps.iter().map(|s| s.rise_time_s)),
        spread(steps.iter().map(|s| Some(s.overshoot_percent))),
        spread(steps.iter().map(|s| s.settling_time_s.filter(|_| !s.interrupted))),
        spread(steps.iter().map(|s| s.steady_error_m.filter(|_| !s.interrupted).map(|e| e * 1e3))),
    ]
}

fn attacks(live: &Live, found: &Figures, begin_s: f64) -> Vec<Attack> {
    // What was over before it began is told in its first status, and is another flight's.
    let spans: Vec<_> = live.log.attacks.between(begin_s, f64::INFINITY).filter(|s| s.seen).collect();
    let one = |span: &&super::spans::Span| {
        let a = &span.attack;
        let (start_s, end_s) = (span.start_s, span.end_s);
        let of = |effect: &&AttackEffect| (effect.accepted_time_us, effect.id) == (span.accepted_us, a.id);
        let effect = found.attacks.iter().find(of).cloned().unwrap_or_default();
        let attacked_then = |key: &(i32, u32)| {
            spans
                .iter()
                .any(|s| (s.attack.sensor, s.attack.instance) == *key && s.start_s <= end_s && s.end_s >= start_s)
        };
        let name = |(kind, number): (i32, u32)| names::instance(kind.try_into().unwrap_or_default(), number);
        let excluded = effect.excluded.iter().map(|[kind, number]| (*kind as i32, *number));
        Attack {
            what: subject(a.sensor(), a.instance, a.channel(), a.kind(), a.magnitude, live.description.get()),
            span_s: [start_s - begin_s, end_s - begin_s],
            phase: names::phase(span.phase),
            isolated_after_s: effect.isolated_after_s,
            rejected_after_s: effect.rejected_after_s,
            largest_m: effect.deviation_m.map(|[largest, _]| largest),
            rms_m: [effect.deviation_m.map(|[_, rms]| rms), effect.rms_before_m],
            false_exclusions: excluded.filter(|key| !attacked_then(key)).map(name).collect(),
        }
    };
    let mut all: Vec<Attack> = spans.iter().map(one).collect();
    all.sort_by(|a, b| a.span_s[0].total_cmp(&b.span_s[0]));
    all
}

/// The stretch of a recording in which the vehicle was armed, s of flight time; all of it where that is not known. A vehicle
/// that was let fall is no estimator's fault.
pub fn armed_s(live: &Live) -> Option<(f64, f64)> {
    let span = live.curves.time_span_s()?;
    let mut marks = live.log.events.iter().filter(|e| e.kind == "armed").map(|e| e.time_us as f64 * 1e-6);
    let first = marks.next();
    match (first, marks.next_back()) {
        (Some(first), Some(last)) => Some((first.max(span.start), last.min(span.end))),
        _ => Some((span.start, span.end)),
    }
}

/// The estimators by the error of their altitude while armed.
fn ranking(found: &Figures) -> Vec<Ranked> {
    let known = found.estimators.iter().filter(|_| found.truth);
    let mut all: Vec<Ranked> = known
        .map(|of| Ranked {
            number: of.estimator,
            altitude_mm: of.altitude_mm,
            attitude_mrad: of.attitude_mrad.map(|[roll, pitch, yaw]| [roll.hypot(pitch), yaw]),
        })
        .collect();
    let order = |r: &Ranked| r.altitude_mm.map_or(f64::INFINITY, |[rms, _]| rms);
    all.sort_by(|a, b| order(a).total_cmp(&order(b)));
    all
}

/// What an autopilot in front of the motors was asked for while armed, and what it said of that.
fn autopilot(found: &Figures) -> Vec<Followed> {
    let told = Demand::ALL.into_iter().zip(&found.autopilot);
    let followed = told.filter_map(|(demand, of)| Some(Followed { demand, asked_rms: of.asked_rms?, off: of.off }));
    followed.collect()
}

/// One sentence for each thing that happened.
fn sentence(flight: &Flight, live: &Live, attacks: &[Attack], secure: bool) -> String {
    let kind = if flight.vehicle == "sim" { "simulated" } else { flight.vehicle.as_str() };
    let rig = if flight.rig.is_empty() { String::new() } else { format!(", {}", flight.rig.replace('_', " ")) };
    let mut out = format!("{} ({kind}{rig}) flew for {} min", flight.vehicle_id, clock(flight.duration_s));
    if !flight.steps.is_empty() {
        out += &format!(" with {} of altitude", plural(flight.steps.len() as u64, "step"));
    }
    if let Some(off) = flight.tracking_rms_m {
        out += &format!(", {} mm RMS off its setpoint", fixed(off * 1e3, 1));
    }
    out += match attacks.len() {
        0 => ". No sensor was attacked.",
        1 => ". One attack altered a sensor: ",
        _ => ". Attacks altered sensors: ",
    };
    let told: Vec<String> = attacks.iter().map(|a| told(a, secure)).collect();
    out += &told.join("; ");
    if !told.is_empty() {
        out.push('.');
    }
    let failsafe = live.log.events.iter().find(|e| e.kind == "failsafe");
    out += &failsafe.map_or_else(|| " No failsafe acted.".to_owned(), |e| format!(" A failsafe acted: {}.", e.text));
    out
}

fn told(attack: &Attack, secure: bool) -> String {
    let mut out = format!("{} for {} s", attack.what, fixed(attack.span_s[1] - attack.span_s[0], 1));
    match (attack.isolated_after_s, attack.rejected_after_s) {
        (Some(s), _) => out += &format!(", isolated after {} s", fixed(s, 2)),
        (None, Some(s)) => out += &format!(", first rejected after {} s", fixed(s, 2)),
        (None, None) if secure => out += ", never isolated",
        (None, None) => out += ", never rejected",
    }
    if let Some(largest) = attack.largest_m {
        out += &format!(", altitude off by {} mm at most", fixed(largest * 1e3, 0));
    }
    out
}

impl Report {
    /// Of a flight whose charts are in `live`, and what the ground found in all of it; `versions` of what writes it.
    pub fn of(flight: Flight, live: &Live, found: &Figures, versions: Vec<Row>) -> Self {
        let begin_s = live.curves.time_span_s().map_or(0.0, |s| s.start);
        let attacks = attacks(live, found, begin_s);
        let secure = !live.suspicion_rows().is_empty();
        Self {
            sentence: sentence(&flight, live, &attacks, secure),
            secure,
            ranking: ranking(found),
            autopilot: autopilot(found),
            vehicle: configuration::vehicle(&flight, live),
            gains: configuration::gains(live),
            scenario: live.description.get().map(|d| d.scenario.clone()).unwrap_or_default(),
            attacks,
            flight,
            versions,
        }
    }
}

#[cfg(test)]
mod tests;
