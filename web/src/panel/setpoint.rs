//! Altitude setpoint: steps, presets, an exact field; what else the mode takes, when it takes it.

use leptos::prelude::*;
use plumbline_proto::v1::Mode;
use serde_json::json;

use crate::{
    ctx::ctx,
    event::Tone,
    model::{curves::DEGREES, format},
};

/// Altitudes one press away, m.
const PRESETS_M: [f64; 3] = [0.5, 0.8, 1.0];
/// One press of a step button or an arrow key, m.
pub const STEP_M: f64 = 0.1;

/// The setpoint card.
#[component]
pub fn SetpointCard() -> impl IntoView {
    let ctx = ctx();
    let typed = RwSignal::new(String::new());
    let in_use = Memo::new(move |_| {
        ctx.live(|live| live.control.get().and_then(|c| c.setpoint.as_ref()).and_then(|s| s.altitude_m))
    });
    let mode = Memo::new(move |_| ctx.live(|live| live.status.get().map_or(Mode::Unspecified, |s| s.mode())));
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
                <output class="big num" aria-label="Altitude setpoint in use">{move || format::maybe(in_use.get(), 2)} <small>"m"</small></output>
            </header>
            <div class="buttons steps-row">
                <button type="button" aria-label="Altitude down 0.1 m" title="Down 0.1 m (↓)" on:click=move |_| ctx.step_altitude(-STEP_M)>"−0.1"</button>
                <button type="button" aria-label="Altitude up 0.1 m" title="Up 0.1 m (↑)" on:click=move |_| ctx.step_altitude(STEP_M)>"+0.1"</button>
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
            {move || match mode.get() {
                Mode::Hold => view! { <Position /> }.into_any(),
                Mode::Stabilise => view! { <Attitude /> }.into_any(),
                _ => ().into_any(),
            }}
        </section>
    }
}

/// A small number field with its own unit.
#[component]
fn Field(label: &'static str, unit: &'static str, value: RwSignal<String>) -> impl IntoView {
    view! {
        <label class="field">
            <span>{label} <small>{unit}</small></span>
            <input type="text" inputmode="decimal" autocomplete="off" prop:value=value on:input:target=move |e| value.set(e.target().value()) />
        </label>
    }
}

/// The given fields as JSON; empty ones keep their value on the vehicle.
fn body(fields: &[(&str, String, f64)]) -> Result<serde_json::Value, String> {
    let mut out = serde_json::Map::new();
    for (name, text, factor) in fields {
        if !text.trim().is_empty() {
            let value = format::parse_number(text)?;
            out.insert((*name).to_owned(), json!(value * factor));
        }
    }
    if out.is_empty() { Err("no value is given".to_owned()) } else { Ok(out.into()) }
}

/// Position and yaw, in hold.
#[component]
fn Position() -> impl IntoView {
    let ctx = ctx();
    let (x, y, yaw) = (RwSignal::new(String::new()), RwSignal::new(String::new()), RwSignal::new(String::new()));
    let send = move |e: leptos::ev::SubmitEvent| {
        e.prevent_default();
        let fields = [
            ("x_m", x.get_untracked(), 1.0),
            ("y_m", y.get_untracked(), 1.0),
            ("yaw_rad", yaw.get_untracked(), 1.0 / DEGREES),
        ];
        match body(&fields) {
            Ok(body) => ctx.command("Position", "POST", "setpoint", body),
            Err(error) => ctx.tell(Tone::Error, format!("Position: {error}")),
        }
    };
    view! {
        <form class="fields" on:submit=send>
            <Field label="east" unit="m" value=x />
            <Field label="north" unit="m" value=y />
            <Field label="yaw" unit="°" value=yaw />
            <button type="submit">"Go"</button>
        </form>
    }
}

/// Attitude and thrust, in stabilise.
#[component]
fn Attitude() -> impl IntoView {
    let ctx = ctx();
    let (roll, pitch, throttle) =
        (RwSignal::new(String::new()), RwSignal::new(String::new()), RwSignal::new(String::new()));
    let send = move |e: leptos::ev::SubmitEvent| {
        e.prevent_default();
        let fields = [
            ("roll_rad", roll.get_untracked(), 1.0 / DEGREES),
            ("pitch_rad", pitch.get_untracked(), 1.0 / DEGREES),
            ("throttle", throttle.get_untracked(), 0.01),
        ];
        match body(&fields) {
            Ok(body) => ctx.command("Attitude", "POST", "setpoint", body),
            Err(error) => ctx.tell(Tone::Error, format!("Attitude: {error}")),
        }
    };
    view! {
        <form class="fields" on:submit=send>
            <Field label="roll" unit="°" value=roll />
            <Field label="pitch" unit="°" value=pitch />
            <Field label="thrust" unit="% weight" value=throttle />
            <button type="submit">"Go"</button>
        </form>
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn empty_fields_keep_their_value_and_degrees_become_radians() {
        let fields = [
            ("x_m", "1,5".to_owned(), 1.0),
            ("y_m", " ".to_owned(), 1.0),
            ("yaw_rad", "180".to_owned(), 1.0 / DEGREES),
        ];
        let value = body(&fields).unwrap();
        assert_eq!(value["x_m"], 1.5);
        assert!(value.get("y_m").is_none());
        assert!((value["yaw_rad"].as_f64().unwrap() - std::f64::consts::PI).abs() < 1e-12);
        assert!(body(&[("x_m", String::new(), 1.0)]).is_err());
        assert!(body(&[("x_m", "a".to_owned(), 1.0)]).unwrap_err().contains('a'));
    }
}
