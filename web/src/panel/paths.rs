//! Paths: shapes and lists of altitudes, from where the setpoint is. What is refused is said beside the form.

use leptos::prelude::*;
use serde_json::json;

use crate::{
    ctx::ctx,
    model::{
        live::Live,
        path::{Form, Shape, plain},
    },
};

/// The path being flown, in the vehicle's own words: the last event that begins one, unless something ended it.
fn flown(live: &Live) -> Option<String> {
    for event in live.log.events.iter().rev() {
        match event.kind.as_str() {
            "setpoint" => {
                if let Some(what) = event.text.strip_prefix("path begins: ") {
                    // "circle of 1 m radius, …"
                    return Some(what.split(" of ").next().unwrap_or(what).to_owned());
                }
                if event.text.starts_with("path") {
                    return None;
                }
            }
            "mode" | "armed" | "failsafe" => return None,
            _ => {}
        }
    }
    None
}

/// The button that opens the form below, named after what is flown.
#[component]
pub fn PathsButton(
    /// Is the form open?
    open: RwSignal<bool>,
) -> impl IntoView {
    let ctx = ctx();
    let flying = Memo::new(move |_| ctx.live(flown));
    view! {
        <button
            type="button"
            class="small"
            aria-expanded=move || open.get().to_string()
            aria-controls="path-form"
            title="Circle, sine, square, heave, or a list of altitudes, from where the setpoint is"
            on:click=move |_| open.update(|open| *open = !*open)
        >{move || flying.get().map_or_else(|| "Paths".to_owned(), |path| format!("Path: {path}"))}</button>
    }
}

/// What is to be flown, and the way to end it.
#[component]
pub fn PathForm(
    /// Shown?
    open: RwSignal<bool>,
) -> impl IntoView {
    let ctx = ctx();
    let flying = Memo::new(move |_| ctx.live(flown));
    let form = RwSignal::new(Form::default());
    let refusal = RwSignal::new(None::<String>);
    let mode = Memo::new(move |_| ctx.live(Live::mode));
    let shape = Memo::new(move |_| form.with(|f| f.shape));
    let unfit = Memo::new(move |_| shape.get().unfit(mode.get()));
    // What is being mended is not refused yet.
    Effect::new(move |_| {
        form.track();
        refusal.set(None);
    });
    let fly = move |e: leptos::ev::SubmitEvent| {
        e.prevent_default();
        let checked = ctx
            .live
            .with_value(|live| form.get_untracked().check(live.description.get().and_then(|d| d.limits.as_ref())));
        match checked {
            Ok(path) => {
                let what = format!("Path {}", shape.get_untracked().name());
                let told = move |answer: Result<(), &str>| {
                    refusal.try_set(answer.err().map(plain));
                };
                ctx.command_then(what, "POST", "trajectory", json!(path), told);
            }
            Err(why) => refusal.set(Some(why)),
        }
    };
    let stop = move |_| ctx.command("Stop path", "DELETE", "trajectory", json!({}));
    let choose = move |name: String| {
        let chosen = Shape::ALL.into_iter().find(|s| s.json() == name);
        form.update(|f| f.shape = chosen.unwrap_or_default());
    };
    view! {
        <form class="path-form" id="path-form" aria-label="Path" hidden=move || !open.get() on:submit=fly>
            <label class="field wide"><span>"shape"</span>
                <select on:change:target=move |e| choose(e.target().value())>
                    {Shape::ALL.map(|s| view! { <option value=s.json() selected=move || shape.get() == s>{s.name()}</option> }).collect_view()}
                </select>
            </label>
            {move || numbers(form, shape.get())}
            <p class="quiet wide">{move || shape.get().help()} " " {move || unfit.get()}</p>
            <div class="buttons wide">
                <button type="submit" disabled=move || unfit.get().is_some()>"Fly path"</button>
                <button type="button" disabled=move || flying.get().is_none() on:click=stop>"Stop"</button>
            </div>
            <p class="bad wide" role="alert">{move || refusal.get()}</p>
        </form>
    }
}

/// The fields of a shape.
fn numbers(form: RwSignal<Form>, shape: Shape) -> AnyView {
    let field = move |label: &'static str, unit: &'static str, text: fn(&mut Form) -> &mut String| {
        view! {
            <label class="field" class:wide=shape == Shape::Altitudes && label == "altitudes">
                <span>{label} " " <small>{unit}</small></span>
                <input
                    type="text" autocomplete="off"
                    prop:value=move || text(&mut form.get()).clone()
                    on:input:target=move |e| form.update(|f| *text(f) = e.target().value())
                />
            </label>
        }
    };
    if shape == Shape::Altitudes {
        let altitudes = field("altitudes", "m, with blanks between", |f| &mut f.altitudes);
        return view! { {altitudes} {field("time at each", "s", |f| &mut f.hold)} }.into_any();
    }
    let sine = shape == Shape::Sine;
    view! {
        {field(shape.size(), "m", |f| &mut f.size)}
        {field("period", "s", |f| &mut f.period)}
        {sine.then(|| field("speed", "m/s", |f| &mut f.speed))}
        {field("duration", "s", |f| &mut f.duration)}
    }
    .into_any()
}

#[cfg(test)]
mod tests {
    use super::*;
    use plumbline_proto::v1::Event;

    #[test]
    fn a_path_lasts_until_it_ends_or_something_else_begins() {
        let mut live = Live::default();
        let mut say = |time_us: u64, kind: &str, text: &str| {
            live.log.event(Event { time_us, kind: kind.into(), text: text.into(), ..Event::default() });
            flown(&live)
        };
        assert_eq!(say(1, "setpoint", "path begins: heave of 0.2 m, 8 s a swing").as_deref(), Some("heave"));
        assert_eq!(say(2, "warning", "a gust").as_deref(), Some("heave"));
        assert_eq!(say(3, "setpoint", "path ended"), None);
        assert_eq!(say(4, "setpoint", "path begins: 3 altitudes, 8 s each").as_deref(), Some("3 altitudes, 8 s each"));
        assert_eq!(say(5, "mode", "mode land"), None);
    }
}
