//! Guided: the ground takes samples of a vehicle in somebody's hands, and this shows what it still asks for.

use std::time::Duration;

use leptos::prelude::*;
use plumbline_proto::v1::SensorKind;
use plumbline_rest::calibration::{Aim, Fit, Taken, Taking};
use serde_json::{Value, json};

use super::Bench;
use crate::{
    ctx::every,
    model::{
        calibration::KINDS,
        guided::{Half, Tile, cells, now, place, tiles, told, turn_deg},
    },
    net,
};

/// How far it has come is asked this often.
const EVERY: Duration = Duration::from_millis(300);

/// What is being taken of the vehicle shown.
#[derive(Clone, Copy)]
struct Hands {
    bench: Bench,
    imu: RwSignal<usize>,
    /// What was taken so far; `None` while nothing is.
    taken: RwSignal<Option<Taken>>,
    refused: RwSignal<String>,
    asking: StoredValue<bool>,
}

impl Hands {
    fn address(self) -> Option<String> {
        let id = self.bench.vehicle.get_untracked()?;
        Some(format!("/api/v1/vehicles/{}/calibration", js_sys::encode_uri_component(&id)))
    }

    fn show(self, taken: Taken) {
        let _ = self.taken.try_set((!taken.kind.is_empty()).then_some(taken));
    }

    fn ask(self) {
        let Some(address) = self.address().filter(|_| !self.asking.get_value()) else { return };
        self.asking.set_value(true);
        leptos::task::spawn_local(async move {
            let answer = net::json::<Taken>("GET", &address, None, "").await;
            self.asking.try_set_value(false);
            // Of the vehicle that is shown still.
            if self.bench.vehicle.try_get_untracked().is_some() && self.address().as_ref() == Some(&address) {
                match answer {
                    Ok(taken) => self.show(taken),
                    // Said by the bar above; what was taken is with the ground.
                    Err(failure) => drop(self.refused.try_set(failure.text)),
                }
            }
        });
    }

    /// Asks for something that changes what is taken.
    fn change(self, method: &'static str, body: Option<Value>) {
        let Some(address) = self.address() else { return };
        self.refused.set(String::new());
        leptos::task::spawn_local(async move {
            let operator = self.bench.ctx.operator();
            let answer = net::json::<Taken>(method, &address, body.map(|b| b.to_string()), &operator).await;
            match answer {
                Ok(taken) => self.show(taken),
                Err(failure) => drop(self.refused.try_set(failure.text)),
            }
        });
    }

    fn begin(self, kind: &str) {
        let asked = Taking { kind: kind.to_owned(), imu: Some(self.imu.get_untracked()) };
        self.change("POST", Some(json!(asked)));
    }

    fn fit(self, kind: &str) {
        let accelerometer = self.bench.accelerometer.get_untracked();
        let fit = Fit {
            kind: kind.to_owned(),
            vehicle: self.bench.vehicle.get_untracked(),
            accelerometer: (kind == "gyroscope" && !accelerometer.is_empty()).then_some(accelerometer),
            ..Fit::default()
        };
        // What was refused is taken on.
        self.bench.ask(fit, move |fitted| {
            if fitted {
                self.change("DELETE", None);
            }
        });
    }
}

/// The card; nothing for kinds whose samples are not taken by hand.
#[component]
pub(super) fn Guided() -> impl IntoView {
    let bench: Bench = expect_context();
    let vehicle = bench.vehicle;
    let hands = Hands {
        bench,
        imu: RwSignal::new(1),
        taken: RwSignal::new(None),
        refused: RwSignal::new(String::new()),
        asking: StoredValue::new(false),
    };
    Effect::new(move |_| {
        vehicle.track();
        hands.taken.set(None);
        hands.refused.set(String::new());
        hands.ask();
    });
    let beat = move || {
        if hands.taken.with_untracked(Option::is_some) {
            hands.ask();
        }
    };
    every(EVERY, beat);
    let running = Memo::new(move |_| hands.taken.with(|taken| taken.as_ref().map(|taken| taken.kind.clone())));
    // What is being taken is what the page is about, after a reload too.
    Effect::new(move |_| {
        if let Some(kind) = running.get().and_then(|name| KINDS.into_iter().find(|kind| kind.name == name)) {
            bench.kind.set(kind);
        }
    });
    let offered = Memo::new(move |_| !bench.kind.get().by_hand.is_empty() || running.get().is_some());
    view! {
        <Show when=move || offered.get()>
            <section class="card facts guided" aria-label="Guided calibration">
                <header><h2>"Guided, with the vehicle in your hands"</h2><span class="quiet one-line">{vehicle}</span></header>
                {move || match running.get() {
                    None => view! { <Begin hands /> }.into_any(),
                    Some(kind) => view! { <Running hands kind /> }.into_any(),
                }}
                {move || Some(hands.refused.get()).filter(|why| !why.is_empty()).map(|why| view! { <p class="bad" role="alert">{why}</p> })}
            </section>
        </Show>
    }
}

/// Before: what will be asked, of which IMU.
#[component]
fn Begin(hands: Hands) -> impl IntoView {
    let Hands { bench, imu, .. } = hands;
    let imus = Memo::new(move |_| {
        let of = |description: &plumbline_proto::v1::Description| {
            let imus = description.sensors.iter().filter(|sensor| sensor.kind() == SensorKind::Imu);
            imus.map(|sensor| sensor.instance as usize).collect::<Vec<_>>()
        };
        bench.ctx.live(|live| live.description.get().map(of).unwrap_or_default())
    });
    let hindrance = Memo::new(move |_| bench.hindrance());
    let choice = move || {
        let options = imus.get().into_iter().map(
            |n| view! { <option value=n.to_string() selected=move || imu.get() == n>{format!("IMU {n}")}</option> },
        );
        view! {
            <select aria-label="IMU to calibrate" on:change:target=move |e| imu.set(e.target().value().parse().unwrap_or(1))>{options.collect::<Vec<_>>()}</select>
        }
    };
    view! {
        <p>{move || bench.kind.get().by_hand}</p>
        <p class="quiet">"The ground takes the samples and says at once what the fit still asks for. A calibration of this sensor that is in use is stopped first: the samples would be corrected by it."</p>
        <div class="row">
            <Show when=move || imus.with(|all| all.len() > 1)>{choice}</Show>
            <button type="button" disabled=move || hindrance.with(Option::is_some) on:click=move |_| hands.begin(bench.kind.get_untracked().name)>"Begin"</button>
            <span class="warn" role="status">{hindrance}</span>
        </div>
    }
}

/// Meanwhile: what is there and what is missing.
#[component]
fn Running(hands: Hands, kind: String) -> impl IntoView {
    let bench = hands.bench;
    let title = KINDS.iter().find(|k| k.name == kind).map_or(kind.clone(), |k| k.title.to_owned());
    let kind = StoredValue::new(kind);
    let taken = Memo::new(move |_| hands.taken.get().unwrap_or_default());
    let words = Memo::new(move |_| taken.with(now));
    let hindered = Memo::new(move |_| taken.with(|taken| !taken.problem.is_empty()));
    let ready = Memo::new(move |_| taken.with(|taken| taken.ready));
    let imu = Memo::new(move |_| taken.with(|taken| taken.imu));
    let aims = Memo::new(move |_| taken.with(|taken| taken.aims.clone()));
    let poses = Memo::new(move |_| taken.with(|taken| taken.up.map(|_| (tiles(taken), taken.still))));
    let sphere = Memo::new(move |_| taken.with(|taken| !taken.sectors.is_empty()));
    let left = move || taken.with(|taken| format!("{} samples, {:.0} s", taken.samples, taken.span_s));
    view! {
        <p class="num"><b>{title} {move || format!(", IMU {}", imu.get())}</b> " " <span class="quiet">{left}</span></p>
        <p class="guided-now" role="status" class:warn=hindered>{words}</p>
        {move || poses.get().map(|(tiles, still)| view! { <Poses tiles still /> })}
        <Show when=move || sphere.get()><Sphere taken /></Show>
        <ul class="aims">{move || aims.get().into_iter().map(counted).collect::<Vec<_>>()}</ul>
        <div class="row">
            <button type="button" class="go" disabled=move || !ready.get() || bench.busy.get() on:click=move |_| kind.with_value(|kind| hands.fit(kind))>"Fit what was taken"</button>
            <button type="button" on:click=move |_| kind.with_value(|kind| hands.begin(kind))>"Begin anew"</button>
            <button type="button" on:click=move |_| hands.change("DELETE", None)>"Give up"</button>
        </div>
    }
}

fn counted(aim: Aim) -> impl IntoView {
    let enough = aim.found >= aim.needed;
    view! {
        <li class:done=enough>
            <span>{told(&aim)}</span>
            <progress max=aim.best.to_string() value=aim.found.min(aim.best).to_string() aria-label=aim.what></progress>
        </li>
    }
}

/// The poses asked for, and the one it is in.
#[component]
fn Poses(tiles: Vec<Tile>, still: f64) -> impl IntoView {
    let one = |tile: Tile| {
        let turned = tile.face.map_or(-35.0, turn_deg);
        // Left and right are seen from behind, everything else from the left: the nose is on the left then.
        let nose = tile.face.is_none_or(|face| face < 4);
        let state = if tile.done { "held" } else { "missing" };
        view! {
            <li class:done=tile.done aria-current=tile.now.then_some("true")>
                <svg viewBox="-20 -20 40 40" aria-hidden="true">
                    <g transform=format!("rotate({turned})")>
                        <path d="M-12 0H12M-10 0V6M10 0V6M-10 0V-4M10 0V-4M-17 -4H-3M3 -4H17"></path>
                        {nose.then(|| view! { <circle cx="-13" cy="0" r="3"></circle> })}
                    </g>
                </svg>
                <span>{tile.name} <span class="visually-hidden">{format!(": {state}")}</span></span>
                {tile.now.then(|| view! { <progress max="1" value=still.to_string() aria-label="Held still"></progress> })}
            </li>
        }
    };
    view! { <ul class="poses">{tiles.into_iter().map(one).collect::<Vec<_>>()}</ul> }
}

/// From where the field has come: the sphere about the vehicle, its upper half and its lower half as one looks down on it.
#[component]
fn Sphere(taken: Memo<Taken>) -> impl IntoView {
    let disc = move |half: Half, name: &'static str| {
        let body = move || {
            let (cells, dot) =
                taken.with(|taken| (cells(taken.bands as usize, &taken.sectors), taken.field.map(place)));
            let dot =
                dot.filter(|(of, _)| *of == half).map(|(_, [x, y])| view! { <circle cx=x cy=y r="0.07"></circle> });
            let cells = cells.into_iter().filter(|cell| cell.half == half);
            view! {
                {cells.map(|cell| view! { <path d=cell.path class:seen=cell.seen></path> }).collect::<Vec<_>>()}
                {dot}
            }
        };
        let label = Memo::new(move |_| {
            taken.with(|taken| {
                let cells = cells(taken.bands as usize, &taken.sectors);
                let seen: Vec<bool> = cells.iter().filter(|cell| cell.half == half).map(|cell| cell.seen).collect();
                format!("{name}: {} of {} sectors seen", seen.iter().filter(|seen| **seen).count(), seen.len())
            })
        });
        view! {
            <figure>
                <svg viewBox="-1.04 -1.04 2.08 2.08" role="img" aria-label=label>{body}</svg>
                <figcaption>{name}</figcaption>
            </figure>
        }
    };
    view! {
        <div class="sphere">
            {disc(Half::Upper, "above it")}
            {disc(Half::Lower, "below it")}
            <p class="quiet">"Directions from which the field has come, seen by the vehicle: ahead is up, its left is left. The dot is where it comes from now."</p>
        </div>
    }
}
