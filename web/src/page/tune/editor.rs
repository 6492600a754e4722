//! The design as sliders and exact fields.

use leptos::prelude::*;
use plumbline_rest::design::Controller;

use super::Bench;
use crate::model::{
    format,
    tuning::{Draft, INPUTS, STATES, same, short, slider_place, slider_value, title},
};

/// Which number of a draft a row edits.
#[derive(Debug, Clone, PartialEq)]
enum Place {
    State(usize),
    Input(usize),
    Parameter(String),
}

impl Place {
    fn read(&self, draft: &Draft) -> Option<f64> {
        match self {
            Self::State(i) => draft.states.get(*i).copied(),
            Self::Input(i) => draft.inputs.get(*i).copied(),
            Self::Parameter(name) => draft.parameters.get(name).copied(),
        }
    }

    fn write(&self, draft: &mut Draft, value: f64) {
        let slot = match self {
            Self::State(i) => draft.states.get_mut(*i),
            Self::Input(i) => draft.inputs.get_mut(*i),
            Self::Parameter(name) => draft.parameters.get_mut(name),
        };
        if let Some(slot) = slot {
            *slot = value;
        }
    }
}

/// A row: what it is called, its unit, page units of one wire unit, the middle of its slider, its limits.
#[derive(Debug, Clone, PartialEq)]
struct Row {
    place: Place,
    name: String,
    unit: String,
    factor: f64,
    middle: f64,
    limits: Option<[f64; 2]>,
}

/// Rows of a kind: states, inputs, parameters.
fn rows(kind: &Controller) -> [Vec<Row>; 3] {
    let defaults = Draft::default_of(kind);
    let weight = |place: Place, (name, unit, factor): (&str, &str, f64)| {
        let middle = place.read(&defaults).filter(|v| v.is_finite()).unwrap_or(1.0) * factor;
        Row { place, name: name.to_owned(), unit: unit.to_owned(), factor, middle, limits: None }
    };
    let states = (0..defaults.states.len().min(STATES.len())).map(|i| weight(Place::State(i), STATES[i]));
    let inputs = (0..defaults.inputs.len().min(INPUTS.len())).map(|i| weight(Place::Input(i), INPUTS[i]));
    let parameters = kind.parameters.iter().map(|p| Row {
        place: Place::Parameter(p.name.clone()),
        name: p.name.replace('_', " "),
        unit: p.unit.clone(),
        factor: 1.0,
        middle: p.value,
        limits: Some([p.min, p.max]),
    });
    [states.collect(), inputs.collect(), parameters.collect()]
}

impl Row {
    fn slider(&self, shown: f64) -> f64 {
        match self.limits {
            // Zero and signs have no logarithm.
            Some([low, high]) if self.middle <= 0.0 => (shown - low) / (high - low).max(1e-12),
            _ => slider_place(shown, self.middle),
        }
    }

    fn value_at(&self, place: f64) -> f64 {
        match self.limits {
            Some([low, high]) if self.middle <= 0.0 => low + place * (high - low),
            Some([low, high]) => slider_value(place, self.middle).clamp(low, high),
            None => slider_value(place, self.middle),
        }
    }

    /// What was typed, in page units. Empty is no cost at all, where that makes sense.
    fn parse(&self, text: &str) -> Result<f64, String> {
        if matches!(self.place, Place::State(_)) && matches!(text.trim(), "" | "–" | "-") {
            return Ok(f64::INFINITY);
        }
        let value = format::parse_number(text)?;
        match self.limits {
            Some([low, high]) if !(low..=high).contains(&value) => {
                Err(format!("{} is not {} to {} {}", short(value), short(low), short(high), self.unit))
            }
            None if value <= 0.0 => Err(format!("{} {} is no deviation, it must be above 0", short(value), self.unit)),
            _ => Ok(value),
        }
    }
}

/// Choice of controller and its numbers.
#[component]
pub(super) fn Editor() -> impl IntoView {
    let bench: Bench = expect_context();
    let kind = Memo::new(move |_| bench.kind());
    let choose = move |name: String| {
        let kinds = bench.kinds.get_untracked();
        let Some(kind) = kinds.iter().find(|k| k.controller == name) else { return };
        let mut made = Draft::default_of(kind);
        // Weights carry over between controllers that come from weights.
        if let Some(old) = bench.draft.get_untracked().filter(|d| !d.states.is_empty() && !made.states.is_empty()) {
            (made.states, made.inputs) = (old.states, old.inputs);
        }
        bench.draft.set(Some(made));
    };
    let defaults = move |_| {
        if let Some(kind) = kind.get_untracked() {
            bench.draft.set(Some(Draft::default_of(&kind)));
        }
    };
    view! {
        <section class="card tune-editor" aria-label="Design">
            <header>
                <h2 class="visually-hidden"><label for="controller">"Controller"</label></h2>
                <select
                    id="controller"
                    disabled=move || bench.kinds.with(Vec::is_empty)
                    on:change:target=move |e| choose(e.target().value())
                >
                    {move || bench.kinds.get().into_iter().map(|k| {
                        let name = k.controller.clone();
                        view! { <option value=k.controller.clone() selected=move || kind.get().is_some_and(|k| k.controller == name)>{title(&k.controller)}</option> }
                    }).collect::<Vec<_>>()}
                </select>
                <button type="button" class="small push" title="Back to the gains that fly" on:click=move |_| bench.take_in_use()>"In use"</button>
                <button type="button" class="small" title="Bryson's rule: each deviation as large as it may be" on:click=defaults>"Defaults"</button>
            </header>
            <div class="tune-rows">
                {move || kind.get().map(|kind| {
                    let [states, inputs, parameters] = rows(&kind);
                    view! {
                        <Group title="Largest deviation of" hint="A weight is 1/deviation²: smaller is held tighter. Empty: costs nothing." rows=states />
                        <Group title="Largest use of" hint="Smaller spares the motors." rows=inputs />
                        <Group title="Parameters" hint="" rows=parameters />
                    }
                })}
            </div>
        </section>
    }
}

#[component]
fn Group(title: &'static str, hint: &'static str, rows: Vec<Row>) -> impl IntoView {
    if rows.is_empty() {
        return ().into_any();
    }
    view! {
        <fieldset>
            <legend title=hint>{title}</legend>
            {rows.into_iter().map(|row| view! { <Field row /> }).collect::<Vec<_>>()}
        </fieldset>
    }
    .into_any()
}

/// One number: slider and exact field.
#[component]
fn Field(row: Row) -> impl IntoView {
    let bench: Bench = expect_context();
    let row = StoredValue::new(row);
    let (name, unit) = row.with_value(|r| (r.name.clone(), r.unit.clone()));
    let value = Memo::new(move |_| {
        let read = |draft: &Draft| row.with_value(|r| r.place.read(draft).map(|v| v * r.factor));
        bench.draft.with(|draft| draft.as_ref().and_then(read)).unwrap_or(f64::NAN)
    });
    let set = move |shown: f64| bench.change(|draft| row.with_value(|r| r.place.write(draft, shown / r.factor)));
    let text = move || {
        let value = value.get();
        if value.is_infinite() { String::new() } else { short(value) }
    };
    let typed = move |e: leptos::ev::Event| {
        use wasm_bindgen::JsCast;
        let Some(input) = e.target().and_then(|t| t.dyn_into::<web_sys::HtmlInputElement>().ok()) else { return };
        match row.with_value(|r| r.parse(&input.value())) {
            Ok(value) => set(value),
            Err(error) => {
                let name = row.with_value(|r| r.name.clone());
                bench.ctx.tell(crate::event::Tone::Error, format!("{name}: {error}"));
                input.set_value(&text());
            }
        }
    };
    // What it is in use, where that is another number.
    let used = Memo::new(move |_| {
        let used = bench.used().and_then(|used| row.with_value(|r| r.place.read(&used).map(|v| v * r.factor)))?;
        (!same(used, value.get())).then_some(used)
    });
    let label = format!("{name}, {unit}");
    view! {
        <div class="tune-field" class:changed=move || used.with(Option::is_some)>
            <span class="tune-name">{name.clone()}
                {move || used.get().map(|used| {
                    let told = row.with_value(|r| format!("in use: {} {}", short(used), r.unit));
                    view! { <b title=told.clone()>" •"<span class="visually-hidden">{told.clone()}</span></b> }
                })}
            </span>
            <input
                type="range"
                min="0"
                max="1"
                step="0.002"
                aria-label=format!("{name} slider")
                aria-valuetext=move || format!("{} {}", text(), row.with_value(|r| r.unit.clone()))
                prop:value=move || row.with_value(|r| r.slider(value.get())).to_string()
                on:input:target=move |e| {
                    if let Ok(place) = e.target().value().parse::<f64>() {
                        set(row.with_value(|r| r.value_at(place)));
                    }
                }
            />
            <input type="text" inputmode="decimal" autocomplete="off" placeholder="free" aria-label=label prop:value=text on:change=typed />
            <span class="unit">{unit}</span>
        </div>
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use plumbline_rest::design::Parameter;

    #[test]
    fn rows_take_degrees_and_refuse_what_is_no_deviation() {
        let gain = Parameter { name: "tilt_p".into(), unit: "1/s".into(), min: 0.0, max: 50.0, value: 7.0 };
        let kind = Controller {
            weighted: true,
            state_weight: Some(vec![1.0; 16]),
            input_weight: Some(vec![1.0; 4]),
            parameters: vec![gain],
            ..Controller::default()
        };
        let [states, inputs, parameters] = rows(&kind);
        assert_eq!((states.len(), inputs.len(), parameters.len()), (16, 4, 1));
        assert!((states[6].middle - 57.2958).abs() < 1e-3 && states[6].unit == "°");
        assert!(states[0].parse("").unwrap().is_infinite() && inputs[0].parse("").is_err());
        assert!(states[0].parse("-1").unwrap_err().contains("-1"));
        assert!(parameters[0].parse("60").unwrap_err().contains("60 is not 0 to 50 1/s"));
        let place = parameters[0].slider(14.0);
        assert!((parameters[0].value_at(place) - 14.0).abs() < 0.1);
    }
}
