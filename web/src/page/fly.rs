//! Fly: the everyday screen.

use leptos::prelude::*;
use plumbline_rest::ground::AtGround;

use super::numbers::Numbers;
use crate::{
    app::{GroundState, Socket},
    ctx::{Ctx, Graphics, ctx},
    panel::{
        alarms::{Guarded, StatusLine},
        arming::ArmingCard,
        attacks::AttacksCard,
        charts::Charts,
        cursors::CursorsCard,
        envelope::EnvelopeBand,
        estimator::EstimatorCard,
        gamepad::GamepadCard,
        horizon::HorizonCard,
        lanes::Lanes,
        layouts,
        readouts::Readouts,
        replay::ReplayCard,
        setpoint::{ModeFields, SetpointCard},
        signals::Messages,
        simulator::SimulatorCard,
        top_view::FromAbove,
    },
};

/// What stands between the operator and a flying vehicle.
#[derive(Debug, Clone, PartialEq, Eq)]
enum Obstacle {
    Ground(String),
    NoVehicle,
    Disconnected(String),
    NoData,
}

fn obstacle(ctx: Ctx) -> Option<Obstacle> {
    let has_data = ctx.live(|live| live.clock.newest_us() > 0);
    let link_down = ctx.live(|live| live.ground.link.as_ref().is_some_and(|l| !l.connected));
    ctx.app(|app| {
        if let GroundState::Down(why) = &app.ground {
            return Some(Obstacle::Ground(why.clone()));
        }
        match (&app.vehicles, &app.vehicle) {
            (Some(all), None) if all.is_empty() => Some(Obstacle::NoVehicle),
            (_, Some(id)) if link_down || app.listed().is_some_and(|v| !v.connected) => {
                Some(Obstacle::Disconnected(id.clone()))
            }
            (_, Some(_)) if !has_data && app.socket == Socket::Open => Some(Obstacle::NoData),
            (_, None) if app.vehicles.is_none() => None,
            _ => None,
        }
    })
}

/// One line above the charts that says what is wrong and what to do.
#[component]
fn Banner() -> impl IntoView {
    let ctx = ctx();
    let state = Memo::new(move |_| obstacle(ctx));
    let off = Memo::new(move |_| match ctx.graphics.get() {
        Graphics::Off(why) => Some(why),
        _ => None,
    });
    let elsewhere = Memo::new(move |_| ctx.app(|app| app.elsewhere().cloned()));
    let lost = Memo::new(move |_| ctx.graphics.get() == Graphics::Lost);
    view! {
        <div class="banners" role="status">
            {move || state.get().map(|what| match what {
                Obstacle::Ground(why) => view! {
                    <p class="banner bad"><b>"No ground station."</b> {format!(" {why}. Start it with ")} <code>"plumbline-ground"</code> " (or everything at once with " <code>"cargo xtask run"</code> "). This page reconnects by itself."</p>
                }.into_any(),
                Obstacle::NoVehicle => view! {
                    <p class="banner"><b>"No vehicle yet."</b> " Start a simulated one with " <code>"plumbline-agent --vehicle sim"</code> "; a real one connects by itself once it is paired. It appears here within two seconds."</p>
                }.into_any(),
                Obstacle::Disconnected(id) => view! {
                    <p class="banner bad"><b>{format!("{id} is not connected.")}</b> " Values below are its last ones, and they are greyed. It reconnects by itself; a simulated one starts with " <code>"plumbline-agent --vehicle sim"</code> "."</p>
                }.into_any(),
                Obstacle::NoData => view! {
                    <p class="banner"><b>"Connected, no telemetry yet."</b> " Waiting for the vehicle's first message."</p>
                }.into_any(),
            })}
            {move || elsewhere.get().map(|AtGround { name, address }| view! {
                <p class="banner"><b>{format!("Flown from ground {name}.")}</b> " Here it is looked at, and its motors can be cut. Everything else is commanded at " <a href=address.clone() rel="external">{address.clone()}</a> "."</p>
            })}
            {move || lost.get().then(|| view! {
                <p class="banner"><b>"Charts are gone for the moment:"</b> " the browser took the graphics away. They come back by themselves; numbers and controls work."</p>
            })}
            {move || off.get().map(|why| view! {
                <p class="banner"><b>"Numbers only:"</b> {format!(" no charts ({why}). Everything still controls and cuts.")}</p>
            })}
        </div>
    }
}

/// The Fly page.
#[component]
pub fn Fly() -> impl IntoView {
    let ctx = ctx();
    if let Some(deck) = ctx.live_deck.get_value() {
        provide_context(deck);
        provide_context(Messages::Vehicle(ctx.app));
        layouts::begin(deck);
        ctx.deck.set(Some(deck));
    }
    let drawn = Memo::new(move |_| !matches!(ctx.graphics.get(), Graphics::Off(_)));
    view! {
        <main class="fly" id="main">
            <h1 class="visually-hidden">"Fly"</h1>
            <Banner />
            <StatusLine />
            <div class="left">
                <Show when=move || drawn.get()><HorizonCard /></Show>
                <Readouts />
                <FromAbove />
                <CursorsCard />
            </div>
            <div class="centre">
                {move || if drawn.get() {
                    view! {
                        <Lanes />
                        <EnvelopeBand />
                        <Charts />
                    }.into_any()
                } else {
                    view! { <Numbers /> }.into_any()
                }}
            </div>
            <div class="right">
                <Guarded>
                    <ReplayCard />
                    <SetpointCard />
                    <ArmingCard />
                    <GamepadCard />
                    <AttacksCard />
                    <EstimatorCard />
                    <SimulatorCard />
                    <ModeFields />
                </Guarded>
            </div>
        </main>
    }
}
