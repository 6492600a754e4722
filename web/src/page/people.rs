//! People: who is signed in from where, and, for admins, the accounts.

use leptos::prelude::*;
use serde_json::{Value, json};

use crate::{
    ctx::{Ctx, ctx},
    event::Tone,
    model::{
        api::{People, SignedIn},
        format,
    },
    net,
    panel::hold::HoldButton,
};

const ROLES: [&str; 4] = ["viewer", "operator", "attacker", "admin"];
const PEOPLE: &str = "/api/people";

/// Sends a change and says what came of it; then `after`.
fn change(
    ctx: Ctx,
    (method, url): (&'static str, String),
    body: Option<Value>,
    done: String,
    after: impl Fn() + 'static,
) {
    let operator = ctx.operator();
    leptos::task::spawn_local(async move {
        match net::json::<Value>(method, &url, body.map(|body| body.to_string()), &operator).await {
            Ok(_) => ctx.tell(Tone::Done, done),
            Err(failure) => ctx.tell(Tone::Error, format!("Refused: {}", failure.text)),
        }
        after();
    });
}

/// The card of people on the Setup page.
#[component]
pub fn PeopleCard() -> impl IntoView {
    let ctx = ctx();
    let people = RwSignal::new(People::default());
    let trouble = RwSignal::new(String::new());
    let role = Memo::new(move |_| ctx.session.with(|session| session.role.clone()));
    let admin = move || role.get().as_deref() == Some("admin");
    let load = move || {
        let url = if role.get_untracked().as_deref() == Some("admin") { PEOPLE } else { "/api/sessions" };
        leptos::task::spawn_local(async move {
            match net::json::<People>("GET", url, None, "").await {
                Ok(found) => {
                    people.try_set(found);
                    trouble.try_set(String::new());
                }
                Err(failure) => drop(trouble.try_set(failure.text)),
            }
        });
    };
    Effect::new(move |_| {
        if role.get().is_some() {
            load();
        }
    });
    let end = move |session: SignedIn| {
        let done = format!("Session of {} ended", session.account);
        change(ctx, ("DELETE", format!("/api/sessions/{}", session.id)), None, done, load);
    };
    view! {
        <section class="card facts wide" aria-label="People">
            <header><h2>"People"</h2></header>
            {move || (!trouble.with(String::is_empty)).then(|| view! { <p class="bad" role="alert">{trouble.get()}</p> })}
            {move || admin().then(|| view! { <Accounts people load=Callback::new(move |()| load()) /> })}
            <h3>"Signed in"</h3>
            {move || people.with(|p| p.sessions.is_empty()).then(|| view! { <p class="quiet">"Nobody: no account is needed on this machine, or none is in use."</p> })}
            <table class="dense">
                <tbody>{move || people.get().sessions.into_iter().map(|session| {
                    let now_s = net::unix_s();
                    let ending = session.clone();
                    view! {
                        <tr>
                            <th scope="row">{session.account.clone()}</th>
                            <td>{session.from.clone()}</td>
                            <td class="num">{format!("{} ago", format::age(now_s - session.begun_s))}</td>
                            <td><button type="button" aria-label=format!("End the session of {} from {}", session.account, session.from)
                                on:click=move |_| end(ending.clone())>"End"</button></td>
                        </tr>
                    }
                }).collect::<Vec<_>>()}</tbody>
            </table>
        </section>
    }
}

/// What admins manage.
#[component]
fn Accounts(people: RwSignal<People>, load: Callback<()>) -> impl IntoView {
    let ctx = ctx();
    let (name, password, role) =
        (RwSignal::new(String::new()), RwSignal::new(String::new()), RwSignal::new("operator"));
    let add = move |event: leptos::ev::SubmitEvent| {
        event.prevent_default();
        let body =
            json!({ "name": name.get_untracked(), "role": role.get_untracked(), "password": password.get_untracked() });
        let done = format!("Account {} made", name.get_untracked());
        password.set(String::new());
        change(ctx, ("POST", PEOPLE.to_owned()), Some(body), done, move || load.run(()));
    };
    let rows = move || {
        people.get().accounts.into_iter().map(|account| {
            let url = format!("{PEOPLE}/{}", account.name);
            let url = StoredValue::new(url);
            let who = StoredValue::new(account.name.clone());
            let set_role = move |role: String| {
                let done = format!("{} is {role} now", who.get_value());
                change(ctx, ("PATCH", url.get_value()), Some(json!({ "role": role })), done, move || load.run(()));
            };
            let remove = Callback::new(move |()| {
                let done = format!("Account {} removed", who.get_value());
                change(ctx, ("DELETE", url.get_value()), None, done, move || load.run(()));
            });
            let current = account.role.clone();
            view! {
                <tr>
                    <th scope="row">{account.name.clone()}</th>
                    <td><select aria-label=format!("Role of {}", account.name) on:change:target=move |e| set_role(e.target().value())>
                        {ROLES.iter().map(|r| view! { <option value={*r} selected={*r == current}>{*r}</option> }).collect::<Vec<_>>()}
                    </select></td>
                    <td><HoldButton label="Remove" class="warn" action=remove /></td>
                </tr>
            }
        }).collect::<Vec<_>>()
    };
    view! {
        <table class="dense"><tbody>{rows}</tbody></table>
        <form class="fields" aria-label="New account" on:submit=add>
            <label class="field"><span>"Name"</span>
                <input type="text" autocomplete="off" required prop:value=name on:input:target=move |e| name.set(e.target().value()) /></label>
            <label class="field"><span>"Password"</span>
                <input type="password" autocomplete="new-password" required minlength="10" prop:value=password on:input:target=move |e| password.set(e.target().value()) /></label>
            <label class="field"><span>"Role"</span>
                <select on:change:target=move |e| role.set(ROLES.iter().find(|r| **r == e.target().value()).copied().unwrap_or("viewer"))>
                    {ROLES.iter().map(|r| view! { <option value={*r} selected={*r == "operator"}>{*r}</option> }).collect::<Vec<_>>()}
                </select></label>
            <button type="submit">"Add account"</button>
        </form>
    }
}
