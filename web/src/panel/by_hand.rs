//! Through the flights of an experiment that is flown by hand, over whatever page is shown; left at any time, and gone on with on
//! any day.

use std::time::Duration;

use leptos::prelude::*;
use plumbline_rest::experiment::{ByHand, FlownByHand, NextByHand, Said};
use plumbline_rest::flight::{Completeness, Flight};
use serde_json::json;

use crate::{
    ctx::{Ctx, ctx, every},
    event::Event,
    model::{
        by_hand::{At, Led, STEPS, Seen},
        format,
        route::Route,
    },
    net,
    panel::toolbar::Link,
    store,
};

/// What is next is asked for again after this.
const PERIOD: Duration = Duration::from_secs(2);

fn address(experiment: &str) -> String {
    format!("/api/v1/experiments/{experiment}/by-hand")
}

/// Leads through the flights of this experiment, on Fly.
pub fn begin(ctx: Ctx, experiment: String) {
    ctx.guide.set(None);
    ctx.go(Route::Fly);
    ctx.led.set(Some(Led::through(experiment)));
}

fn change(ctx: Ctx, with: impl Fn(&mut Led)) {
    ctx.led.update(|led| led.iter_mut().for_each(with));
}

/// The steps, with what the present one asks for.
#[component]
pub fn FlightsByHand() -> impl IntoView {
    let ctx = ctx();
    let experiment = Memo::new(move |_| ctx.led.with(|led| led.as_ref().map(|led| led.experiment.clone())));
    Effect::new(move |_| ctx.led.with(store::keep_led));
    // Remade for another experiment, and not for another step.
    move || experiment.get().map(|id| view! { <Leading id /> })
}

#[component]
fn Leading(id: String) -> impl IntoView {
    let ctx = ctx();
    let id = StoredValue::new(id);
    let told = RwSignal::new(None::<Result<ByHand, String>>);
    // When the present rest is over, s since the epoch.
    let rested_at = RwSignal::new(f64::INFINITY);
    let take = move |answer: Result<ByHand, String>| {
        if let Ok(ByHand { next: Some(next), .. }) = &answer {
            rested_at.try_set(net::unix_s() + next.rest_left_s);
        }
        told.try_set(Some(answer));
    };
    let ask = move || {
        leptos::task::spawn_local(async move {
            let Some(address) = id.try_with_value(|id| address(id)) else { return };
            take(net::json("GET", &address, None, "").await.map_err(|failure| failure.text));
        });
    };
    ask();
    every(PERIOD, ask);
    // What rests is told by the clock: another answer about the same flight changes nothing here.
    let next = Memo::new(move |_| match told.get() {
        Some(Ok(told)) => told.next.map(|next| NextByHand { rest_left_s: 0.0, ..next }),
        _ => None,
    });
    Effect::new(move |_| {
        let seen = ctx.live(Seen::of);
        let (Some(next), Some(led)) = (next.get(), ctx.led.get_untracked()) else { return };
        // What another vehicle does is no step of this flight.
        if ctx.app(|app| app.vehicle.as_ref() != Some(&next.vehicle)) {
            return;
        }
        let mut after = led.clone();
        after.go_on(&next, &seen, net::unix_s() >= rested_at.get());
        if after != led {
            ctx.led.set(Some(after));
        }
    });
    let at = Memo::new(move |_| ctx.led.with(|led| led.as_ref().map(|led| led.at).unwrap_or_default()));
    let refused = RwSignal::new(String::new());
    let say = move |accepted: bool, reason: String| {
        let (Some(led), Some(next)) = (ctx.led.get_untracked(), next.get_untracked()) else { return };
        leptos::task::spawn_local(async move {
            let said = Said { index: next.index, flight: led.flight, accepted, reason };
            let answer =
                net::json::<ByHand>("POST", &address(&led.experiment), Some(json!(said).to_string()), &ctx.operator())
                    .await;
            match answer {
                Ok(told) => {
                    refused.try_set(String::new());
                    take(Ok(told));
                    let goes_on =
                        ctx.led.with_untracked(|now| now.as_ref().is_some_and(|now| now.experiment == led.experiment));
                    if goes_on {
                        ctx.led.set(Some(Led::through(led.experiment)));
                    }
                }
                Err(failure) => {
                    refused.try_set(failure.text);
                }
            }
        });
    };
    let steps = move |next: NextByHand| {
        let levels = next.levels.iter().map(|level| view! { <li>{level.clone()}</li> }).collect::<Vec<_>>();
        let lacks = next.lacks.clone();
        let next = StoredValue::new(next);
        let of = move |n: usize| {
            match n {
            0 => view! { <p class="num">{move || { ctx.tick.track(); let left_s = (rested_at.get() - net::unix_s()).max(0.0); format!("{} left", format::age(left_s)) }}</p> }.into_any(),
            1 => view! { <SetUp next /> }.into_any(),
            3 => view! { <Fly next /> }.into_any(),
            5 => view! { <Say say /> <p class="bad" role="alert">{refused}</p> }.into_any(),
            _ => ().into_any(),
        }
        };
        view! {
            <ul class="levels num">{levels}</ul>
            {move || {
                let vehicle = next.with_value(|next| next.vehicle.clone());
                let other = ctx.app(|app| app.vehicle.as_ref() != Some(&vehicle));
                let choose = vehicle.clone();
                other.then(|| view! { <p><button type="button" on:click=move |_| ctx.dispatch(Event::Choose(choose.clone()))>{format!("Show {vehicle}")}</button></p> })
            }}
            {(!lacks.is_empty()).then(|| view! { <p class="bad" role="alert">{lacks}</p> })}
            <ol aria-live="polite">
                {STEPS.into_iter().enumerate().map(|(n, (title, how))| view! {
                    <li class:done=move || { n < at.get().step() } aria-current=move || (n == at.get().step()).then_some("step")>
                        <b>{title}</b>
                        {move || (n == at.get().step()).then(|| view! { <p>{how}</p> {of(n)} })}
                    </li>
                }).collect::<Vec<_>>()}
            </ol>
        }
    };
    let place = move || next.get().map(|next| format!("{} of {}", next.place, next.flights));
    view! {
        <aside class="card first-flight by-hand" aria-label="Flight by hand">
            <header>
                <h2>"Flight"</h2>
                <span class="quiet num">{place}</span>
                <button type="button" class="plain" aria-label="Leave the flights by hand; the experiment keeps what was flown" on:click=move |_| ctx.led.set(None)>"×"</button>
            </header>
            {move || match told.get() {
                None => view! { <p class="quiet">"asking…"</p> }.into_any(),
                Some(Err(why)) => view! { <p class="bad" role="alert">{why}</p> }.into_any(),
                Some(Ok(ByHand { next: None, .. })) => view! { <p>"Every flight of the plan is accepted. " <Link to=Route::Experiments>"Read the results"</Link></p> }.into_any(),
                Some(Ok(ByHand { said, .. })) => said.last().map(|last| view! { <p class="quiet">{spoken(last)}</p> }).into_any(),
            }}
            {move || next.get().map(steps)}
        </aside>
    }
}

/// "last: accepted", or why it was void.
fn spoken(last: &FlownByHand) -> String {
    if last.accepted { "last flight: accepted".to_owned() } else { format!("last flight: void, {}", last.reason) }
}

/// Sends what this flight needs, unless it is so already.
#[component]
fn SetUp(next: StoredValue<NextByHand>) -> impl IntoView {
    let ctx = ctx();
    let send = move |_| {
        let NextByHand { estimator, gains, .. } = next.get_value();
        ctx.command("Estimator", "POST", "estimator", json!({ "estimator": estimator }));
        if let Some(revision) = gains {
            ctx.command_then("Gains", "POST", "gains/revert", json!({ "revision": revision }), move |answer| {
                if answer.is_ok() {
                    change(ctx, |led| led.gains = true);
                }
            });
        }
    };
    let wanted = move || {
        let NextByHand { estimator, gains, .. } = next.get_value();
        let gains = gains.map_or_else(String::new, |revision| format!(", gains {revision}"));
        format!("{estimator}{gains}")
    };
    view! {
        <p class="num">{wanted}</p>
        <button type="button" on:click=send>"Set up"</button>
    }
}

/// Uploads the attacks, then the path.
#[component]
fn Fly(next: StoredValue<NextByHand>) -> impl IntoView {
    let ctx = ctx();
    let begun = move || ctx.led.with(|led| led.as_ref().is_some_and(|led| matches!(led.at, At::Flying(_))));
    let path = move || {
        let NextByHand { path, .. } = next.get_value();
        ctx.command_then("Profile", "POST", "trajectory", json!(path), move |answer| {
            if answer.is_ok() {
                let now_us = ctx.seen_us();
                change(ctx, |led| led.at = At::Flying(now_us));
            }
        });
    };
    let fly = move |_| {
        let attacks = next.with_value(|next| next.attacks.clone());
        if attacks.is_empty() {
            return path();
        }
        ctx.command_then("Attacks", "PUT", "attacks", json!({ "attacks": attacks }), move |answer| {
            if answer.is_ok() {
                path();
            }
        });
    };
    let left = move || {
        let seen = ctx.live(Seen::of);
        let left_s = ctx.led.with(|led| led.as_ref().map(|led| next.with_value(|next| led.left_s(next, &seen))));
        format!("{} left", format::age(left_s.unwrap_or(0.0)))
    };
    let told = move || {
        next.with_value(|next| {
            let altitudes = next.path.altitude_m.iter().map(|m| format::fixed(*m, 2)).collect::<Vec<_>>().join(", ");
            let attacks = format::plural(next.attacks.len() as u64, "attack");
            format!("{altitudes} m; {attacks}")
        })
    };
    view! {
        <p class="num">{told}</p>
        {move || if begun() {
            view! { <p class="num">{left}</p> }.into_any()
        } else {
            view! { <button type="button" on:click=fly>"Fly the profile"</button> }.into_any()
        }}
    }
}

/// Whether it counts, with what was measured of it.
#[component]
fn Say(say: impl Fn(bool, String) + Copy + 'static) -> impl IntoView {
    let ctx = ctx();
    let flight = RwSignal::new(None::<Flight>);
    let early = ctx.led.with_untracked(|led| led.as_ref().is_some_and(|led| led.early));
    let reason = RwSignal::new(if early { "it ended before its profile did".to_owned() } else { String::new() });
    let look = move || {
        let id = ctx.led.with_untracked(|led| led.as_ref().map(|led| led.flight.clone())).unwrap_or_default();
        // Nothing was recorded where nothing was flown.
        if id.is_empty() {
            return;
        }
        leptos::task::spawn_local(async move {
            if let Ok(found) = net::json::<Flight>("GET", &format!("/api/v1/flights/{id}"), None, "").await {
                flight.try_set(Some(found));
            }
        });
    };
    look();
    every(PERIOD, look);
    let whole = move || {
        flight.with(|flight| {
            flight
                .as_ref()
                .is_some_and(|flight| !matches!(flight.completeness, Completeness::Recording | Completeness::Filling))
        })
    };
    let measured = move || {
        flight.get().map(|flight| {
            let rms = format::millimetres(flight.tracking_rms_m, 1);
            let state = flight.completeness.name();
            view! {
                <p class="num">
                    <Link to=Route::Flight(flight.id.clone())>"the flight"</Link>
                    {format!(": {}, error RMS {rms}, {state}", format::clock(flight.duration_s))}
                </p>
            }
        })
    };
    view! {
        {measured}
        <button type="button" disabled=move || !whole() on:click=move |_| say(true, String::new())>"Accept"</button>
        <label class="field"><span>"or void, because"</span>
            <input type="text" autocomplete="off" maxlength="200" prop:value=move || reason.get() on:input:target=move |e| reason.set(e.target().value()) />
        </label>
        <button type="button" disabled=move || reason.with(|reason| reason.trim().is_empty()) on:click=move |_| say(false, reason.get_untracked())>"Void"</button>
    }
}
