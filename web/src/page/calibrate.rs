//! Calibrate: guidance for each kind, a fit from a flight, a table or a vehicle in somebody's hands, its picture, and what is kept.

mod guided;
mod in_use;

use leptos::prelude::*;
use plumbline_rest::calibration::{Calibration, Calibrations, Fit, Picture};
use plumbline_rest::flight::{Flight, Flights};
use serde_json::json;
use wasm_bindgen_futures::JsFuture;

use crate::{
    ctx::{Ctx, ctx},
    event::Tone,
    model::{
        calibration::{KINDS, Kind, drawn},
        format, listing,
        tuning::short,
    },
    net,
    page::flights::local_offset_min,
    palette,
    panel::{
        sketch::{Dot, Drawing, Sketch, Trace},
        waiting::Waiting,
    },
};

/// What the parts of the page share.
#[derive(Clone, Copy)]
struct Bench {
    ctx: Ctx,
    /// The vehicle shown.
    vehicle: Memo<Option<String>>,
    kind: RwSignal<Kind>,
    /// Flight to fit from; empty for a table.
    flight: RwSignal<String>,
    imu: RwSignal<usize>,
    from_s: RwSignal<String>,
    to_s: RwSignal<String>,
    accelerometer: RwSignal<String>,
    /// Name and text of a chosen table.
    table: RwSignal<Option<(String, String)>>,
    flights: RwSignal<Vec<Flight>>,
    kept: RwSignal<Vec<Calibration>>,
    shown: RwSignal<Option<Result<Calibration, String>>>,
    busy: RwSignal<bool>,
}

impl Bench {
    /// Why the vehicle is not taken in hand, nor calibrated otherwise; `None` where it is.
    fn hindrance(self) -> Option<String> {
        let Some(id) = self.vehicle.get() else {
            return Some("No vehicle is connected: Fly says how to start one.".to_owned());
        };
        let lost = self.ctx.live(|live| live.ground.link.as_ref().is_none_or(|link| !link.connected));
        let armed = self.ctx.live(|live| live.status.get().is_some_and(|status| status.armed));
        if lost {
            Some(format!("The link to {id} is lost."))
        } else if armed {
            Some(format!("{id} is armed: disarm it first."))
        } else {
            None
        }
    }

    fn reload(self) {
        leptos::task::spawn_local(async move {
            if let Ok(list) = net::json::<Calibrations>("GET", "/api/v1/calibrations", None, "").await {
                let _ = self.kept.try_set(list.calibrations);
            }
            if let Ok(list) = net::json::<Flights>("GET", "/api/v1/flights?limit=1000", None, "").await {
                let _ = self.flights.try_set(list.flights);
            }
        });
    }

    /// The question, or what is missing in it.
    fn question(self) -> Result<Fit, String> {
        let kind = self.kind.get_untracked();
        let number = |text: RwSignal<String>| {
            let text = text.get_untracked();
            if text.trim().is_empty() { Ok(None) } else { format::parse_number(&text).map(Some) }
        };
        let mut fit = Fit { kind: kind.name.into(), ..Fit::default() };
        let flight = self.flight.get_untracked();
        match self.table.get_untracked() {
            _ if kind.from_flight && !flight.is_empty() => {
                fit.flight = Some(flight);
                fit.imu = Some(self.imu.get_untracked());
            }
            Some((name, text)) => {
                fit.name = Some(name);
                fit.csv = Some(text);
            }
            _ if kind.example.is_empty() => return Err("choose a flight".into()),
            None if kind.from_flight => return Err("choose a flight, or open a table".into()),
            None => return Err("open a table first".into()),
        }
        (fit.from_s, fit.to_s) = (number(self.from_s)?, number(self.to_s)?);
        let accelerometer = self.accelerometer.get_untracked();
        if kind.name == "gyroscope" && !accelerometer.is_empty() {
            fit.accelerometer = Some(accelerometer);
        }
        Ok(fit)
    }

    fn fit(self) {
        let body = match self.question() {
            Ok(body) => body,
            Err(missing) => {
                self.shown.set(Some(Err(missing)));
                return;
            }
        };
        self.ask(body, |_| {});
    }

    /// Has the ground fit; `then` is told whether it did.
    fn ask(self, body: Fit, then: impl FnOnce(bool) + 'static) {
        self.busy.set(true);
        leptos::task::spawn_local(async move {
            let operator = self.ctx.operator();
            let answer =
                net::json::<Calibration>("POST", "/api/v1/calibrations", Some(json!(body).to_string()), &operator)
                    .await;
            let _ = self.busy.try_set(false);
            then(answer.is_ok());
            let _ = self.shown.try_set(Some(answer.map_err(|failure| failure.text)));
            self.reload();
        });
    }

    fn show(self, id: String) {
        leptos::task::spawn_local(async move {
            let id = String::from(js_sys::encode_uri_component(&id));
            let answer = net::json::<Calibration>("GET", &format!("/api/v1/calibrations/{id}"), None, "").await;
            let _ = self.shown.try_set(Some(answer.map_err(|failure| failure.text)));
        });
    }

    fn open(self, input: web_sys::HtmlInputElement) {
        let Some(file) = input.files().and_then(|files| files.get(0)) else { return };
        leptos::task::spawn_local(async move {
            match JsFuture::from(file.text()).await.ok().and_then(|text| text.as_string()) {
                Some(text) => {
                    let _ = self.table.try_set(Some((file.name(), text)));
                    let _ = self.flight.try_set(String::new());
                }
                None => self.ctx.tell(Tone::Error, format!("{} cannot be read as text", file.name())),
            }
            input.set_value("");
        });
    }
}

/// The Calibrate page.
#[component]
pub fn Calibrate() -> impl IntoView {
    let ctx = ctx();
    let bench = Bench {
        ctx,
        vehicle: Memo::new(move |_| ctx.app(|app| app.vehicle.clone())),
        kind: RwSignal::new(KINDS[2]),
        flight: RwSignal::new(String::new()),
        imu: RwSignal::new(1),
        from_s: RwSignal::new(String::new()),
        to_s: RwSignal::new(String::new()),
        accelerometer: RwSignal::new(String::new()),
        table: RwSignal::new(None),
        flights: RwSignal::new(Vec::new()),
        kept: RwSignal::new(Vec::new()),
        shown: RwSignal::new(None),
        busy: RwSignal::new(false),
    };
    provide_context(bench);
    bench.reload();
    view! {
        <main class="sheet" id="main">
            <div class="sheet-head"><h1>"Calibrate"</h1></div>
            <div class="calibrate">
                <div class="calibrate-side"><Form /><Kept /></div>
                <div class="calibrate-side"><guided::Guided /><Outcome /></div>
            </div>
        </main>
    }
}

/// Kind, guidance, data.
#[component]
fn Form() -> impl IntoView {
    let bench: Bench = expect_context();
    let choose = move |name: String| {
        if let Some(kind) = KINDS.into_iter().find(|k| k.name == name) {
            bench.kind.set(kind);
        }
    };
    let file = NodeRef::<leptos::html::Input>::new();
    let needs_imu = move || bench.kind.get().from_flight && !bench.flight.get().is_empty();
    let accelerometers = move || {
        bench
            .kept
            .get()
            .into_iter()
            .filter(|c| c.kind == "accelerometer")
            .map(|c| view! { <option value=c.id.clone()>{c.id.clone()}</option> })
            .collect::<Vec<_>>()
    };
    let field = move |label: &'static str, unit: &'static str, value: RwSignal<String>| {
        view! {
            <label class="field"><span>{label} " " <small>{unit}</small></span>
                <input type="text" inputmode="decimal" autocomplete="off" prop:value=value on:input:target=move |e| value.set(e.target().value()) />
            </label>
        }
    };
    view! {
        <section class="card facts" aria-label="New calibration">
            <header><h2><label for="calibration-kind">"What"</label></h2></header>
            <select id="calibration-kind" on:change:target=move |e| choose(e.target().value())>
                {KINDS.map(|k| view! { <option value=k.name selected=move || bench.kind.get() == k>{k.title}</option> }).collect_view()}
            </select>
            <ol class="guidance">
                {move || bench.kind.get().guidance.iter().map(|g| view! { <li>{*g}</li> }).collect::<Vec<_>>()}
            </ol>
            <Show when=move || bench.kind.get().from_flight>
                <label class="field"><span>"flight"</span>
                    <select on:change:target=move |e| { bench.flight.set(e.target().value()); bench.table.set(None); }>
                        <option value="">"– choose a recording –"</option>
                        {move || bench.flights.get().into_iter().map(|f| {
                            let id = f.id.clone();
                            let text = format!("{} · {}", listing::when(f.started_unix_us, local_offset_min()), f.title());
                            view! { <option value=f.id.clone() selected=move || bench.flight.get() == id>{text}</option> }
                        }).collect::<Vec<_>>()}
                    </select>
                </label>
            </Show>
            <div class="row" hidden=move || bench.kind.get().example.is_empty()>
                <button type="button" on:click=move |_| if let Some(input) = file.get_untracked() { input.click() }>"Open table (CSV)…"</button>
                <button type="button" title="The columns that are read, with some rows" on:click=move |_| example(bench.kind.get_untracked())>"Example table"</button>
                <span class="quiet one-line">{move || bench.table.get().map(|(name, _)| name)}</span>
                <input type="file" accept=".csv,text/csv,.txt" hidden aria-label="Table" node_ref=file on:change:target=move |e| bench.open(e.target()) />
            </div>
            <Show when=needs_imu>
                <div class="fields">
                    <label class="field"><span>"IMU"</span>
                        <select on:change:target=move |e| bench.imu.set(e.target().value().parse().unwrap_or(1))>
                            {(1..=5).map(|n| view! { <option value=n.to_string()>{n}</option> }).collect::<Vec<_>>()}
                        </select>
                    </label>
                    {field("from", "s", bench.from_s)}
                    {field("to", "s", bench.to_s)}
                </div>
            </Show>
            <Show when=move || bench.kind.get().name == "gyroscope">
                <label class="field"><span>"accelerometer calibration"</span>
                    <select on:change:target=move |e| bench.accelerometer.set(e.target().value())>
                        <option value="">"none yet"</option>
                        {accelerometers}
                    </select>
                </label>
            </Show>
            <button type="button" class="fit" disabled=bench.busy on:click=move |_| bench.fit()>"Fit and keep"</button>
            <Show when=move || bench.busy.get()><Waiting text="The ground fits…" /></Show>
        </section>
    }
}

/// Gives the example table of `kind`.
fn example(kind: Kind) {
    net::save(&format!("{}-example.csv", kind.name), "text/csv", kind.example);
}

/// Calibrations kept by the ground.
#[component]
fn Kept() -> impl IntoView {
    let bench: Bench = expect_context();
    view! {
        <section class="card facts" aria-label="Kept calibrations">
            <header><h2>"Kept"</h2></header>
            {move || {
                let all = bench.kept.get();
                if all.is_empty() {
                    return view! { <p class="quiet">"None yet. Record while you follow the guidance above, then choose the recording and fit."</p> }.into_any();
                }
                all.into_iter().map(|c| {
                    let id = c.id.clone();
                    let residual = c.residual.value.map_or_else(String::new, |v| format!("{} {}", short(v), c.residual.unit));
                    view! {
                        <div class="kept-row">
                            <button type="button" class="plain" title=c.input.clone() on:click=move |_| bench.show(id.clone())>{c.kind.clone()} {c.sensor.map(|n| format!(" {n}"))}</button>
                            <span class="quiet num one-line">{c.date.clone()}</span>
                            <span class="num push">{residual}</span>
                        </div>
                    }
                }).collect::<Vec<_>>().into_any()
            }}
            <in_use::InUse />
        </section>
    }
}

/// Of what is drawn, in the order of the picture.
fn colors() -> impl Iterator<Item = &'static str> {
    [palette::SENSOR_1, palette::IN_LOOP, palette::OTHER_1, palette::OTHER_2].map(palette::Ink::css).into_iter().cycle()
}

fn drawing(picture: &Picture) -> Drawing {
    let mut out = Drawing { least: [1e-9, 1e-9], ..Drawing::default() };
    for (series, color) in picture.series.iter().zip(colors()) {
        let points = drawn(series, picture.log);
        if series.line {
            out.traces.push(Trace { points, color, dashed: false });
        } else {
            let finite = points.into_iter().filter(|p| p.iter().all(|v| v.is_finite()));
            out.dots.extend(finite.map(|at| Dot { at, color, cross: false }));
        }
    }
    let name = |text: &str| if picture.log { format!("log₁₀ {text}") } else { text.to_owned() };
    out.units = [name(&picture.x), name(&picture.y)];
    out
}

/// Picture and numbers of the calibration shown.
#[component]
fn Outcome() -> impl IntoView {
    let bench: Bench = expect_context();
    view! {
        <section class="card facts fit-result" aria-label="Fit" aria-live="polite">
            <h2 class="visually-hidden">"Fit"</h2>
            {move || match bench.shown.get() {
                None => view! { <p class="quiet blank">"The picture of the fit comes here: the samples before and after, what is left, and every parameter with its uncertainty."</p> }.into_any(),
                Some(Err(why)) => view! { <p class="bad blank" role="alert">{why}</p> }.into_any(),
                Some(Ok(c)) => view! { <Result calibration=c /> }.into_any(),
            }}
        </section>
    }
}

#[component]
fn Result(calibration: Calibration) -> impl IntoView {
    let c = calibration;
    let title = KINDS.iter().find(|k| k.name == c.kind).map_or(c.kind.clone(), |k| k.title.to_owned());
    let residual =
        c.residual.value.map_or_else(|| format::NONE.to_owned(), |v| format!("{} {}", short(v), c.residual.unit));
    view! {
        <header><h2>{title} {c.sensor.map(|n| format!(", IMU {n}"))}</h2><span class="quiet num">{c.date.clone()}</span>
            <a class="button push" href=format!("/api/v1/calibrations/{}", c.id) download=format!("{}.json", c.id)>"JSON"</a></header>
        <p class="num">"Left after the fit: " <b>{residual}</b> {format!(" from {} samples of {}", format::count(c.samples), c.input)}</p>
        <div class="pictures">
            {c.picture.iter().map(|p| {
                let drawing = drawing(p);
                let names = p.series.iter().zip(colors());
                view! {
                    <figure>
                        <figcaption><b>{p.title.clone()}</b>
                            <ul class="legend">{names.map(|(s, color)| view! { <li><i class="swatch" style=format!("--swatch:{color}")></i>{s.name.clone()}</li> }).collect::<Vec<_>>()}</ul>
                        </figcaption>
                        <Sketch label=p.title.clone() drawing=Signal::derive(move || drawing.clone()) size=[360.0, 240.0] />
                    </figure>
                }
            }).collect::<Vec<_>>()}
            <div class="numbers">
                <table class="dense">
                    <thead><tr><th>"parameter"</th><th class="num">"value"</th><th class="num">"± 1σ"</th><th>"unit"</th></tr></thead>
                    <tbody>
                        {c.parameters.iter().map(|p| view! {
                            <tr><td>{p.name.replace('_', " ")}</td><td class="num">{precise(p.value)}</td><td class="num">{p.sigma.map_or_else(|| format::NONE.to_owned(), short)}</td><td>{p.unit.clone()}</td></tr>
                        }).collect::<Vec<_>>()}
                    </tbody>
                </table>
            </div>
        </div>
        <in_use::Use id=c.id.clone() kind=c.kind.clone() imu=c.sensor.map_or(1, u32::from) date=c.date.clone() />
        <ul class="notes-list">{c.notes.iter().map(|n| view! { <li>{n.clone()}</li> }).collect::<Vec<_>>()}</ul>
    }
}

/// Five digits, whatever the size.
fn precise(value: f64) -> String {
    if value != 0.0 && !(1e-4..1e6).contains(&value.abs()) { format!("{value:.4e}") } else { format!("{value:.5}") }
}

#[cfg(test)]
mod tests {
    use super::*;
    use plumbline_rest::calibration::Series;

    #[test]
    fn samples_are_dots_and_fits_are_lines() {
        let points = vec![[Some(1.0), Some(10.0)], [Some(2.0), None]];
        let series = |line| Series { name: String::new(), line, points: points.clone() };
        let picture =
            Picture { x: "s".into(), log: true, series: vec![series(false), series(true)], ..Picture::default() };
        let made = drawing(&picture);
        assert_eq!((made.dots.len(), made.traces.len(), made.units[0].as_str()), (1, 1, "log₁₀ s"));
        assert_eq!((precise(1.616e-5), precise(0.5)), ("1.6160e-5".into(), "0.50000".into()));
    }
}
