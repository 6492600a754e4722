//! The first flight, step by step, over whatever page is shown; left at any time.

use leptos::prelude::*;

use crate::{
    ctx::{Ctx, ctx},
    model::{
        guide::{Guide, STEPS, Seen},
        route::Route,
    },
    store,
};

/// Begins it, on Fly.
pub fn begin(ctx: Ctx) {
    ctx.help.set(false);
    ctx.led.set(None);
    ctx.go(Route::Fly);
    ctx.guide.set(Some(Guide::default()));
}

/// The steps, with what the present one asks for.
#[component]
pub fn FirstFlight() -> impl IntoView {
    let ctx = ctx();
    let at = Memo::new(move |_| ctx.guide.get().map(|guide| guide.at));
    Effect::new(move |_| store::keep_guide(at.get()));
    Effect::new(move |_| {
        if at.get().is_none() {
            return;
        }
        let reads = matches!(ctx.route.get(), Route::Flight(_) | Route::Report(_));
        let seen = ctx.live(|live| Seen::of(live, reads));
        let mut guide = ctx.guide.get_untracked().unwrap_or_default();
        let before = guide;
        guide.go_on(&seen);
        if guide != before {
            ctx.guide.set(Some(guide));
        }
    });
    view! {
        {move || at.get().map(|at| view! {
            <aside class="card first-flight" aria-label="First flight">
                <header>
                    <h2>"First flight"</h2>
                    <span class="quiet num">{if at < STEPS.len() { format!("{} of {}", at + 1, STEPS.len()) } else { "done".to_owned() }}</span>
                    <button type="button" class="plain" aria-label="Leave the first flight" on:click=move |_| ctx.guide.set(None)>"×"</button>
                </header>
                <ol aria-live="polite">
                    {STEPS.into_iter().enumerate().map(|(n, (title, how))| view! {
                        <li class:done={n < at} aria-current=(n == at).then_some("step")>
                            <b>{title}</b>
                            {(n == at).then(|| view! { <p>{how}</p> })}
                        </li>
                    }).collect::<Vec<_>>()}
                </ol>
            </aside>
        })}
    }
}
