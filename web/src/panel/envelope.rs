//! The attack envelope: on Setup a row for each set of attacked sensors and what a sensor more would buy, on the arming card
//! the same in a line, on Tune that of the design beside the gains in use, on Fly the bound of now. Asked anew with every
//! other vehicle, sensors and gains; the ground keeps the answers.

use leptos::prelude::*;
use plumbline_rest::design::Design;
use plumbline_rest::envelope::{Envelope, EnvelopeQuestion};
use serde_json::json;

use crate::{
    ctx::ctx,
    model::envelope::{Of, Table, line, of_one_m, price, rows},
    net,
};

/// An answer, or why there is none; `None` until it comes.
type Answer = Option<Result<Envelope, String>>;

async fn ask(vehicle: &str, question: &EnvelopeQuestion) -> Result<Envelope, String> {
    let url = format!("/api/v1/envelope?vehicle={}", String::from(js_sys::encode_uri_component(vehicle)));
    let body = Some(json!(question).to_string());
    net::json::<Envelope>("POST", &url, body, "").await.map_err(|failure| failure.text)
}

/// A vehicle, its start, how many sensors it has, its gains.
type About = (String, (u64, usize, Option<String>));

/// What every answer follows from.
fn about() -> Memo<Option<About>> {
    let ctx = ctx();
    Memo::new(move |_| {
        let told = ctx.live(|live| {
            let gains = live.gains.get().map(|gains| gains.sha256.clone());
            live.description.get().map(|told| (told.boot_id, told.sensors.len(), gains))
        });
        ctx.app(|app| app.vehicle.clone()).zip(told)
    })
}

/// Answers to `questions`, asked again whenever one of them or what they are about is another.
fn answers(questions: Signal<Vec<EnvelopeQuestion>>) -> RwSignal<Vec<Answer>> {
    let (about, asked) = (about(), StoredValue::new(0_u64));
    let found = RwSignal::new(Vec::new());
    Effect::new(move |_| {
        let number = asked.get_value() + 1;
        asked.set_value(number);
        let questions = questions.get();
        found.set(vec![None; questions.len()]);
        let Some((id, _)) = about.get() else { return };
        leptos::task::spawn_local(async move {
            for (place, question) in questions.iter().enumerate() {
                let answer = ask(&id, question).await;
                // An older question's answer says nothing about the gains of now; the card may be gone.
                if asked.try_get_value() != Some(number) {
                    return;
                }
                found.try_update(|all| all.get_mut(place).map(|place| *place = Some(answer)));
            }
        });
    });
    found
}

fn answer(found: RwSignal<Vec<Answer>>, place: usize) -> Answer {
    found.with(|all| all.get(place).cloned().flatten())
}

/// The card on Setup.
#[component]
pub fn EnvelopeCard() -> impl IntoView {
    let about = about();
    let more =
        |kind: &str| EnvelopeQuestion { most: Some(1), more: Some(kind.to_owned()), ..EnvelopeQuestion::default() };
    let questions = vec![EnvelopeQuestion::default(), more("height"), more("imu"), more("pose")];
    let found = answers(Signal::derive(move || questions.clone()));
    let prices = move |before: &Envelope| {
        let of = |(place, kind)| answer(found, place).and_then(Result::ok).map(|after| price(kind, before, &after));
        [(1, "height"), (2, "imu"), (3, "pose")].into_iter().filter_map(of).collect::<Vec<_>>()
    };
    view! {
        <section class="card facts" aria-label="Attack envelope">
            <header><h2>"Attack envelope"</h2><span class="quiet push">"about hover, before flight"</span></header>
            {move || match answer(found, 0) {
                None if about.get().is_none() => view! { <p class="quiet">"Told of a vehicle that knows its sensor suite."</p> }.into_any(),
                None => view! { <p class="quiet">"Computing…"</p> }.into_any(),
                Some(Err(why)) => view! { <p class="bad">{format!("No envelope: {why}.")}</p> }.into_any(),
                Some(Ok(envelope)) => view! {
                    <p>{format!(
                        "Whoever adds what they like to the samples of these sensors for {} s, without one being excluded, moves the altitude of the linearised loop with lanes and the gains in use at most so far; for longer, further. Noise, wind and the error of the estimate come on top. Where IMUs vibrate, one of them goes further: the lines on Fly follow the noise that is measured.",
                        envelope.horizon_s,
                    )}</p>
                    <table class="dense">
                        <thead><tr><th>"attacked"</th><th class="num">"altitude, at most"</th><th>"held by"</th></tr></thead>
                        <tbody>{rows(&envelope).into_iter().map(|row| view! {
                            <tr>
                                <th scope="row">{row.attacked}</th>
                                <td class="num" class:bad=row.unbounded>{row.bound}</td>
                                <td>{row.held}</td>
                            </tr>
                        }).collect::<Vec<_>>()}</tbody>
                    </table>
                    {prices(&envelope).into_iter().map(|text| view! { <p class="quiet num">{text}</p> }).collect::<Vec<_>>()}
                }.into_any(),
            }}
        </section>
    }
}

/// One line for the arming card, asked for once `open`.
#[component]
pub fn EnvelopeLine(
    /// Is anybody looking?
    open: RwSignal<bool>,
) -> impl IntoView {
    let wanted = Memo::new(move |_| open.get());
    let found =
        answers(Signal::derive(move || if wanted.get() { vec![EnvelopeQuestion::default()] } else { Vec::new() }));
    let text = move || match answer(found, 0) {
        None => "…".to_owned(),
        Some(Err(why)) => format!("no bound: {why}"),
        Some(Ok(envelope)) => format!("within {} s {}; longer ones further", envelope.horizon_s, line(&envelope)),
    };
    view! { <p class="quiet num">"Unseen attacks, with lanes: " {text}</p> }
}

/// The envelope of a design beside that of the gains in use.
#[component]
pub fn EnvelopeBeside(
    /// Once it has stood still.
    design: Signal<Option<Design>>,
) -> impl IntoView {
    let of = |design: Design| EnvelopeQuestion { design, most: Some(1), ..EnvelopeQuestion::default() };
    let found = answers(Signal::derive(move || {
        design.get().map(|design| vec![of(Design::default()), of(design)]).unwrap_or_default()
    }));
    view! {
        <section class="card facts" aria-label="Attack envelope of the design">
            <header><h2>"Attack envelope" <small>"at most, within 10 s"</small></h2></header>
            {move || match (answer(found, 0), answer(found, 1)) {
                (_, None) => view! { <p class="quiet">"…"</p> }.into_any(),
                (_, Some(Err(why))) => view! { <p class="bad">{format!("No envelope: {why}.")}</p> }.into_any(),
                (old, Some(Ok(new))) => {
                    let old = old.and_then(Result::ok).map(|old| rows(&old)).unwrap_or_default();
                    let before = move |attacked: &str| {
                        let found = old.iter().find(|row| row.attacked == attacked);
                        found.map_or_else(|| "–".to_owned(), |row| row.bound.clone())
                    };
                    view! {
                        <table class="dense">
                            <thead><tr><th>"attacked"</th><th class="num">"in use"</th><th class="num">"design"</th></tr></thead>
                            <tbody>{rows(&new).into_iter().map(|row| view! {
                                <tr><th scope="row">{row.attacked.clone()}</th><td class="num">{before(&row.attacked)}</td><td class="num">{row.bound.clone()}</td></tr>
                            }).collect::<Vec<_>>()}</tbody>
                        </table>
                    }.into_any()
                }
            }}
        </section>
    }
}

/// Keeps the table of bounds that the band on Fly is read from: one for what is excluded now. Nothing is shown here.
#[component]
pub fn EnvelopeBand() -> impl IntoView {
    let ctx = ctx();
    let of = Memo::new(move |_| ctx.live(|live| Of::now(live.secure.get()?, live.in_loop())));
    let found = answers(Signal::derive(move || of.get().map(|of| of.questions()).unwrap_or_default()));
    Effect::new(move |_| {
        let bounds =
            found.with(|all| all.iter().map(|of| of_one_m(of.as_ref()?.as_ref().ok()?)).collect::<Option<Vec<_>>>());
        let table = bounds.zip(of.get_untracked()).filter(|(bounds, _)| !bounds.is_empty());
        let table = table.map(|(bounds, of)| Table::new(of, &bounds));
        ctx.live.update_value(|live| live.reach = table);
    });
}
