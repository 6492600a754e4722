//! The report of a flight: to read, to print, to keep as one file.

use leptos::prelude::*;
use plumbline_rest::flight::Flight;

use crate::{
    app::GroundState,
    ctx::{Ctx, ctx},
    event::Failure,
    model::{
        report::{Report, document},
        route::Route,
    },
    net,
    page::flights::local_offset_min,
    panel::toolbar::Link,
};

use super::{NoFlight, load_kinds};

/// Kinds that figures are made of.
const KINDS: &str = "estimate,control,truth,residuals,status,attacks,event,step,description,secure,gains";

/// The body of the report and the name of its file.
async fn written(ctx: Ctx, id: &str) -> Result<(String, String), Failure> {
    let flight: Flight = net::json("GET", &format!("/api/v1/flights/{id}"), None, "").await?;
    let mut live = load_kinds(id, KINDS).await?;
    live.curves.follow_errors();
    let ground = ctx.app.with_value(|app| match &app.ground {
        GroundState::Up(ground) => ground.version.clone(),
        _ => String::new(),
    });
    let versions = vec![
        ("page".to_owned(), env!("CARGO_PKG_VERSION").to_owned()),
        ("ground".to_owned(), ground),
        ("agent".to_owned(), flight.agent_version.clone()),
    ];
    let title = flight.title().to_owned();
    Ok((title, Report::of(flight, &live, versions).html(&live, local_offset_min())))
}

/// The page.
#[component]
pub fn ReportPage(
    /// Of which flight.
    id: String,
) -> impl IntoView {
    let ctx = ctx();
    let report = RwSignal::new(None::<Result<(String, String), Failure>>);
    {
        let id = id.clone();
        leptos::task::spawn_local(async move {
            let written = written(ctx, &id).await;
            report.try_set(Some(written));
        });
    }
    let file = format!("report-{id}.html");
    let save = move |_| {
        report.with_untracked(|r| {
            if let Some(Ok((title, body))) = r {
                net::save(&file, "text/html", &document(title, body));
            }
        })
    };
    let print = move |_| {
        // A browser that cannot print says so itself.
        let _ = window().print();
    };
    let ready = Memo::new(move |_| report.with(|r| matches!(r, Some(Ok(_)))));
    let flight = Route::Flight(id.clone());
    view! {
        <main class="sheet" id="main">
            <div class="sheet-head no-print">
                <Link to=flight>"← Flight"</Link>
                <b>"Report"</b>
                <button type="button" class="push" disabled=move || !ready.get() on:click=print>"Print"</button>
                <button type="button" disabled=move || !ready.get() on:click=save>"Save as HTML"</button>
            </div>
            {move || report.with(|r| match r {
                None => view! { <p class="banner" role="status">"Reading the recording…"</p> }.into_any(),
                Some(Err(failure)) if failure.status == 404 => view! { <NoFlight id=id.clone() /> }.into_any(),
                Some(Err(failure)) => view! { <p class="banner bad" role="alert"><b>"No report: "</b>{failure.text.clone()}</p> }.into_any(),
                Some(Ok((_, body))) => view! { <article class="report" inner_html=body.clone()></article> }.into_any(),
            })}
        </main>
    }
}
