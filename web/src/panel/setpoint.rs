//! Altitude setpoint: steps, presets, an exact field; and a card for what else the mode takes.

use leptos::prelude::*;
use plumbline_proto::v1::Mode;
use serde_json::json;

use super::paths::{PathForm, PathsButton};
use super::top_view::TopView;
use crate::{
    ctx::ctx,
    event::Tone,
    model::{curves::DEGREES, format},
};

/// Altitudes one press away, m.
const PRESETS_M: [f64; 3] = [0.5, 0.8, 1.0];
/// One press of a step button or an arrow key, m.
pub const STEP_M: f64 = 0.1;

/// The next altitude on the grid of [`STEP_M`] above or below `from_m`.
pub fn stepped(from_m: f64, up: bool) -> f64 {
    // What lies on the grid, but for rounding, moves by a whole step.
    const SLACK: f64 = 1e-6;
    let steps = from_m / STEP_M;
    (if up { (steps + SLACK).floor() + 1.0 } else { (steps - SLACK).ceil() - 1.0 }) * STEP_M
}

/// The setpoint card.
#[component]
pub fn SetpointCard() -> impl IntoView {
    let ctx = ctx();
    let typed = RwSignal::new(String::new());
    let paths = RwSignal::new(false);
    let replayed = Memo::new(move |_| ctx.live(|live| live.is_replay()));
    let in_use = Memo::new(move |_| ctx.live(|live| live.setpoint_m()));
    let old = Memo::new(move |_| ctx.is_old(|live| &live.control));
    let limits = Memo::new(move |_| {
        ctx.live(|live| live.description.get().and_then(|d| d.limits).map(|l| (l.altitude_min_m, l.altitude_max_m)))
    });
    let set = move |e: leptos::ev::SubmitEvent| {
        e.prevent_default();
        match format::parse_number(&typed.get_untracked()) {
            Ok(value) => {
                ctx.set_altitude(value);
                typed.set(String::new());
            }
            Err(error) => ctx.tell(Tone::Error, format!("Setpoint: {error}")),
        }
    };
    view! {
        <section class="card setpoint" aria-label="Setpoint">
            <header>
                <h2>"Setpoint"</h2>
                <Show when=move || !replayed.get()><PathsButton open=paths /></Show>
                <output class="big num" class:stale=old aria-label="Altitude setpoint in use">{move || format::maybe(in_use.get(), 2)} <small>"m"</small></output>
            </header>
            <Show when=move || !replayed.get()>
                <div class="buttons steps-row">
                    <button type="button" aria-label="Altitude down 0.1 m" title="Down 0.1 m (↓)" on:click=move |_| ctx.step_altitude(false)>"−0.1"</button>
                    <button type="button" aria-label="Altitude up 0.1 m" title="Up 0.1 m (↑)" on:click=move |_| ctx.step_altitude(true)>"+0.1"</button>
                    {PRESETS_M.into_iter().map(|p| view! {
                        <button
                            type="button"
                            class="num"
                            aria-label=format!("Altitude {p:.1} m")
                            aria-pressed=move || in_use.get().is_some_and(|s| (s - p).abs() < 1e-6).to_string()
                            on:click=move |_| ctx.set_altitude(p)
                        >{format!("{p:.1}")}</button>
                    }).collect::<Vec<_>>()}
                </div>
                <form class="exact" on:submit=set>
                    <input
                        type="text"
                        inputmode="decimal"
                        autocomplete="off"
                        aria-label="Exact altitude in metres"
                        placeholder=move || limits.get().map_or_else(|| "exact, m".to_owned(), |(low, high)| {
                            format!("{} – {} m", format::fixed(low, 2), format::fixed(high, 2))
                        })
                        prop:value=typed
                        on:input:target=move |e| typed.set(e.target().value())
                    />
                    <button type="submit">"Set"</button>
                </form>
                <PathForm open=paths />
            </Show>
        </section>
    }
}

/// What else the mode takes, when it takes it. A card of its own, below the others: those stay where they are.
#[component]
pub fn ModeFields() -> impl IntoView {
    let ctx = ctx();
    let mode = Memo::new(move |_| {
        ctx.live(|live| {
            let mode = live.status.get().map_or(Mode::Unspecified, |s| s.mode());
            if live.is_replay() { Mode::Unspecified } else { mode }
        })
    });
    let card = |name, about: &'static str, picture: Option<AnyView>, entries| {
        view! {
            <section class="card setpoint" aria-label=name><header><h2>{name}</h2><span class="quiet">{about}</span></header>{picture}<Fields name entries /></section>
        }
    };
    move || match mode.get() {
        Mode::Hold => {
            card("Position", "from above, north up", Some(view! { <TopView /> }.into_any()), &POSITION).into_any()
        }
        Mode::Stabilise => card("Attitude and thrust", "", None, &ATTITUDE).into_any(),
        _ => ().into_any(),
    }
}

/// A number that the setpoint of a mode takes: name on the page, unit there, name on the wire, wire units of one.
type Entry = (&'static str, &'static str, &'static str, f64);

/// Position and yaw, in hold.
const POSITION: [Entry; 3] =
    [("east", "m", "x_m", 1.0), ("north", "m", "y_m", 1.0), ("yaw", "°", "yaw_rad", 1.0 / DEGREES)];
/// Attitude and thrust, in stabilise.
const ATTITUDE: [Entry; 3] = [
    ("roll", "°", "roll_rad", 1.0 / DEGREES),
    ("pitch", "°", "pitch_rad", 1.0 / DEGREES),
    ("thrust", "% weight", "throttle", 0.01),
];

/// The given fields as JSON; empty ones keep their value on the vehicle.
fn body(entries: &[Entry], texts: &[String]) -> Result<serde_json::Value, String> {
    let mut out = serde_json::Map::new();
    for ((_, _, key, factor), text) in entries.iter().zip(texts) {
        if !text.trim().is_empty() {
            out.insert((*key).to_owned(), json!(format::parse_number(text)? * factor));
        }
    }
    if out.is_empty() { Err("no value is given".to_owned()) } else { Ok(out.into()) }
}

/// A row of number fields, sent together.
#[component]
fn Fields(name: &'static str, entries: &'static [Entry]) -> impl IntoView {
    let ctx = ctx();
    let texts: Vec<RwSignal<String>> = entries.iter().map(|_| RwSignal::new(String::new())).collect();
    let typed = texts.clone();
    let send = move |e: leptos::ev::SubmitEvent| {
        e.prevent_default();
        let texts: Vec<String> = typed.iter().map(|text| text.get_untracked()).collect();
        match body(entries, &texts) {
            Ok(body) => ctx.command(name, "POST", "setpoint", body),
            Err(error) => ctx.tell(Tone::Error, format!("{name}: {error}")),
        }
    };
    view! {
        <form class="fields" aria-label=name on:submit=send>
            {entries.iter().zip(texts).map(|((label, unit, ..), text)| view! {
                <label class="field">
                    <span>{*label} " " <small>{*unit}</small></span>
                    <input type="text" inputmode="decimal" autocomplete="off" prop:value=text on:input:target=move |e| text.set(e.target().value()) />
                </label>
            }).collect::<Vec<_>>()}
            <button type="submit">"Go"</button>
        </form>
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steps_end_on_the_grid() {
        let near = |a: f64, b: f64| assert!((a - b).abs() < 1e-9, "{a} {b}");
        near(stepped(stepped(stepped(0.5, true), true), true), 0.8);
        near(stepped(0.83, true), 0.9);
        near(stepped(0.83, false), 0.8);
        near(stepped(0.8 - 1e-9, true), 0.9);
        near(stepped(0.1, false), 0.0);
    }

    #[test]
    fn empty_fields_keep_their_value_and_degrees_become_radians() {
        let texts = ["1,5", " ", "180"].map(str::to_owned);
        let value = body(&POSITION, &texts).unwrap();
        assert_eq!(value["x_m"], 1.5);
        assert!(value.get("y_m").is_none());
        assert!((value["yaw_rad"].as_f64().unwrap() - std::f64::consts::PI).abs() < 1e-12);
        assert!(body(&POSITION, &[const { String::new() }; 3]).is_err());
        assert!(body(&ATTITUDE, &["a".to_owned()]).unwrap_err().contains('a'));
    }
}
