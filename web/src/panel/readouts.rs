//! Numbers: aligned, with unit and sign; grey with their age when old; "—" when unknown.

use leptos::prelude::*;
use plumbline_proto::v1::Health;

use crate::{
    deck::{Source, deck},
    model::{format, instrument::Instrument},
};

fn row(
    label: &'static str,
    unit: &'static str,
    read: impl Fn(&Instrument) -> Option<String> + Send + Sync + Copy + 'static,
) -> impl IntoView {
    let deck = deck();
    let text = Memo::new(move |_| read(&deck.instrument()).unwrap_or_else(|| format::NONE.to_owned()));
    view! {
        <div class="readout">
            <dt>{label}</dt>
            <dd class="num">{text}</dd>
            <dd class="unit">{unit}</dd>
        </div>
    }
}

/// The numbers of the newest estimate.
#[component]
pub fn Readouts() -> impl IntoView {
    let deck = deck();
    let stale = Memo::new(move |_| deck.instrument().stale);
    // Which moment is shown, for whoever wants to know how old it is.
    let shown_us = move || deck.read(|live| live.estimate().and_then(|t| t.time_us()));
    let angle = |i: usize| {
        move |s: &Instrument| s.roll_pitch_yaw_deg.and_then(|a| a.get(i).copied()).map(|v| format::signed(v, 1))
    };
    let state = Memo::new(move |_| {
        let i = deck.instrument();
        match (i.age_s, i.stale, i.health) {
            (None, _, _) if deck.source == Source::Live => "no estimate yet".to_owned(),
            (Some(age), true, _) => format!("{} old", format::age(age)),
            (_, _, Health::Initialising) => "initialising".to_owned(),
            (_, _, Health::Degraded) => "degraded".to_owned(),
            _ => String::new(),
        }
    });
    let bad = Memo::new(move |_| deck.instrument().health == Health::Degraded);
    // Of their range, %.
    let motors = Memo::new(move |_| deck.instrument().motors.iter().map(|m| (m * 100.0).round()).collect::<Vec<_>>());
    let count = Memo::new(move |_| motors.with(Vec::len).max(4));
    let saturated = Memo::new(move |_| deck.instrument().saturated);
    view! {
        <section class="card readouts" class:stale=stale aria-label="Readouts" data-time-us=shown_us>
            <header>
                <h2>"Estimate"</h2>
                <span class="state num" class:bad=bad>{state}</span>
            </header>
            <dl>
                {row("roll", "°", angle(0))}
                {row("pitch", "°", angle(1))}
                {row("yaw", "°", angle(2))}
                {row("altitude", "m", |i| i.altitude_m.map(|a| format::fixed(a, 3)))}
                {row("climb", "m/s", |i| i.climb_mps.map(|c| format::signed(c, 2)))}
                {row("east", "m", |i| i.east_north_m.map(|p| format::signed(p[0], 2)))}
                {row("north", "m", |i| i.east_north_m.map(|p| format::signed(p[1], 2)))}
            </dl>
            <div class="motors-now" role="img" aria-label=move || {
                let all: Vec<String> = motors.get().iter().map(|m| format!("{m:.0} %")).collect();
                if all.is_empty() { "Motors: unknown".to_owned() } else { format!("Motors: {}", all.join(", ")) }
            }>
                <span class="motors-name">"motors"</span>
                {move || (0..count.get()).map(|i| {
                    let level = Memo::new(move |_| motors.with(|all| all.get(i).copied()));
                    view! {
                        <span class="motor" class:saturated=saturated>
                            <i style=move || format!("height:{:.0}%", level.get().unwrap_or(0.0).clamp(0.0, 100.0))></i>
                            <b class="num">{move || level.get().map_or_else(|| format::NONE.to_owned(), |l| format!("{l:.0}"))}</b>
                        </span>
                    }
                }).collect::<Vec<_>>()}
            </div>
        </section>
    }
}
