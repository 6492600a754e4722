//! What the vehicle shown flies with: one press puts a kept calibration to use, one stops that.

use leptos::prelude::*;
use plumbline_proto::v1::CalibrationInUse;
use plumbline_rest::calibration::Using;
use serde_json::json;

use super::Bench;
use crate::model::{
    calibration::{corrects, named},
    live::Live,
};

/// Calibrations that the vehicle says it flies with.
fn told(bench: Bench) -> Memo<Vec<CalibrationInUse>> {
    Memo::new(move |_| {
        bench.ctx.live(|live| live.description.get().map(|told| told.calibrations.clone()).unwrap_or_default())
    })
}

/// Those in use, each with the way out of it.
#[component]
pub(super) fn InUse() -> impl IntoView {
    let bench: Bench = expect_context();
    let Bench { ctx, vehicle, .. } = bench;
    let all = told(bench);
    let why_not = Memo::new(move |_| bench.hindrance().or_else(|| ctx.refusal()));
    let row = move |used: CalibrationInUse| {
        let what = named(&used.kind, used.imu);
        let label = format!("Stop using the {what} calibration");
        let action = format!("calibrations/{}/{}", used.kind, used.imu);
        let stop = move |_| ctx.command("Calibration", "DELETE", &action, json!({}));
        view! {
            <div class="kept-row">
                <span title=used.input.clone()>{what}</span>
                <span class="quiet num one-line">{used.date.clone()}</span>
                {if used.configured {
                    view! { <span class="quiet push">"by configuration"</span> }.into_any()
                } else {
                    view! { <button type="button" class="push" aria-label=label title=why_not disabled=move || why_not.with(Option::is_some) on:click=stop>"Stop using"</button> }.into_any()
                }}
            </div>
        }
    };
    view! {
        <Show when=move || vehicle.with(Option::is_some)>
            <h3>{move || format!("In use on {}", vehicle.get().unwrap_or_default())}</h3>
            {move || if all.with(Vec::is_empty) {
                view! { <p class="quiet">"None: readings pass as the sensors give them."</p> }.into_any()
            } else {
                all.get().into_iter().map(row).collect::<Vec<_>>().into_any()
            }}
        </Show>
    }
}

/// The press that puts the calibration shown to use, or why there is none.
#[component]
pub(super) fn Use(id: String, kind: String, imu: u32, date: String) -> impl IntoView {
    let bench: Bench = expect_context();
    let Bench { ctx, vehicle, .. } = bench;
    if kind == "allan" {
        return view! { <p class="quiet">"It tells of noise and corrects nothing: compare it with the data sheet of the sensor."</p> }.into_any();
    }
    // Its notes say where they belong.
    if kind == "delays" {
        return ().into_any();
    }
    if !corrects(&kind) {
        let line = format!("calibrations = [\"{id}.json\"]");
        return view! {
            <p class="quiet">"It changes the vehicle that gains are made for: keep the JSON beside the agent, list it in its configuration and start it again: " <code>{line}</code></p>
        }
        .into_any();
    }
    let all = told(bench);
    let taken =
        Memo::new(move |_| all.with(|all| all.iter().find(|used| used.kind == kind && used.imu == imu).cloned()));
    let why = Memo::new(move |_| {
        let in_use = taken.get().map(|used| match used.date {
            of if of == date => "It is in use.".to_owned(),
            of => format!("That of {of} is in use: stop using it first."),
        });
        let recorded =
            ctx.live(Live::is_replay).then(|| "A recording is flown: its samples are those of then.".to_owned());
        bench.hindrance().or(recorded).or(in_use).or_else(|| ctx.refusal())
    });
    let id = StoredValue::new(id);
    let put = move |_| {
        let asked = Using { calibration: id.get_value() };
        ctx.command("Calibration", "POST", "calibrations", json!(asked));
    };
    view! {
        <div class="row">
            <button type="button" class="go" disabled=move || why.with(Option::is_some) on:click=put>
                {move || format!("Use on {}", vehicle.get().unwrap_or_else(|| "a vehicle".into()))}
            </button>
            <span class="quiet" role="status">{why}</span>
        </div>
    }
    .into_any()
}
