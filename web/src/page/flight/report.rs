//! The report of a flight: to read, to print, to keep as one file.

use leptos::prelude::*;
use plumbline_rest::flight::{Figures, Flight};

use crate::{
    app::GroundState,
    ctx::{Ctx, ctx},
    event::Failure,
    model::{
        report::{Report, document, figures},
        route::Route,
    },
    net,
    page::flights::local_offset_min,
    panel::{toolbar::Link, waiting::Waiting},
};

use super::{NoFlight, detail};

/// A report as it is kept.
#[derive(Clone)]
struct Written {
    title: String,
    body: String,
    latex: String,
    /// Name and picture of each figure.
    figures: Vec<(String, String)>,
}

/// Reads what charts show of the recording and what the ground found in all of it, and writes its report; `told` is told which
/// share has been read.
async fn written(ctx: Ctx, id: &str, told: impl Fn(f64)) -> Result<Written, Failure> {
    let flight: Flight = net::json("GET", &format!("/api/v1/flights/{id}"), None, "").await?;
    let length_s = flight.duration_s.max(1e-3);
    let mut live = detail::overview(id, length_s, |covered_s| told(covered_s / length_s)).await?;
    let found: Figures = net::json("GET", &format!("/api/v1/flights/{id}/figures"), None, "").await?;
    live.curves.set_errors(&found);
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
    let report = Report::of(flight, &live, &found, versions);
    let offset_min = local_offset_min();
    Ok(Written {
        title,
        body: report.html(&live, offset_min),
        latex: report.latex(offset_min),
        figures: figures(&live).iter().map(|figure| (figure.title.clone(), figure.svg())).collect(),
    })
}

/// The page.
#[component]
pub fn ReportPage(
    /// Of which flight.
    id: String,
) -> impl IntoView {
    let ctx = ctx();
    let report = RwSignal::new(None::<Result<Written, Failure>>);
    let share = RwSignal::new(None::<f64>);
    {
        let id = id.clone();
        leptos::task::spawn_local(async move {
            let told = move |part| {
                let _ = share.try_set(Some(part));
            };
            let written = written(ctx, &id, told).await;
            report.try_set(Some(written));
        });
    }
    let file = StoredValue::new(format!("report-{id}"));
    let save = move |ending: &str, kind: &str, text: fn(&Written) -> String| {
        report.with_untracked(|r| {
            if let Some(Ok(written)) = r {
                net::save(&format!("{}.{ending}", file.get_value()), kind, &text(written));
            }
        })
    };
    let pictures = move || {
        report.with(|r| r.as_ref().and_then(|r| r.as_ref().ok()).map(|r| r.figures.clone()).unwrap_or_default())
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
                <button type="button" disabled=move || !ready.get() on:click=move |_| save("html", "text/html", |r| document(&r.title, &r.body))>"Save as HTML"</button>
                <button type="button" disabled=move || !ready.get() title="Every table, for booktabs" on:click=move |_| save("tex", "application/x-tex", |r| r.latex.clone())>"LaTeX tables"</button>
                {move || pictures().into_iter().enumerate().map(|(i, (name, svg))| {
                    let number = i + 1;
                    let drawn = svg.clone();
                    view! {
                        <button type="button" title=format!("{name}, as a picture") on:click=move |_| net::save(&format!("{}-{number}.svg", file.get_value()), "image/svg+xml", &svg)>{format!("Figure {number} SVG")}</button>
                        <button type="button" title=format!("{name}, as a picture") aria-label=format!("Figure {number} PNG") on:click=move |_| net::save_png(&format!("{}-{number}.png", file.get_value()), &drawn)>"PNG"</button>
                    }
                }).collect_view()}
            </div>
            {move || report.with(|r| match r {
                None => view! { <Waiting text="Reading the recording…" share /> }.into_any(),
                Some(Err(failure)) if failure.status == 404 => view! { <NoFlight id=id.clone() /> }.into_any(),
                Some(Err(failure)) => view! { <p class="banner bad" role="alert"><b>"No report: "</b>{failure.text.clone()}</p> }.into_any(),
                Some(Ok(written)) => view! { <article class="report" inner_html=written.body.clone()></article> }.into_any(),
            })}
        </main>
    }
}
