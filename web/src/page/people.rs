//! People: who is signed in from where, and, for admins, the accounts.

use leptos::prelude::*;
use plumbline_rest::people::{
    AccountChange, Code, Confirmation, NewAccount, NewAuthenticator, People, Role, Session, SignedIn,
};
use serde_json::{Value, json};

use crate::{
    ctx::{Ctx, ctx},
    model::format,
    net,
    panel::hold::HoldButton,
};

const PEOPLE: &str = "/api/v1/people";

/// What came of the last change, or why it was refused.
type Outcome = Option<Result<String, String>>;

/// Sends a change and says what came of it beside the form that asked for it, where no notice covers the form; then
/// `after`.
fn change(
    ctx: Ctx,
    outcome: RwSignal<Outcome>,
    (method, url): (&'static str, String),
    body: Option<Value>,
    done: String,
    after: impl Fn() + 'static,
) {
    let operator = ctx.operator();
    leptos::task::spawn_local(async move {
        let answer = net::json::<Value>(method, &url, body.map(|body| body.to_string()), &operator).await;
        // The card may be gone by now.
        outcome.try_set(Some(answer.map(|_| done).map_err(|failure| failure.text)));
        after();
    });
}

/// The line that says it.
#[component]
fn Said(outcome: RwSignal<Outcome>) -> impl IntoView {
    let text = move || match outcome.get() {
        None => String::new(),
        Some(Ok(done)) => done,
        Some(Err(why)) => format!("Refused: {why}"),
    };
    let refused = move || outcome.with(|o| matches!(o, Some(Err(_))));
    view! { <p class="said" class:bad=refused role="status">{text}</p> }
}

/// The card of people on the Setup page.
#[component]
pub fn PeopleCard() -> impl IntoView {
    let ctx = ctx();
    let people = RwSignal::new(People::default());
    let trouble = RwSignal::new(String::new());
    let role = Memo::new(move |_| ctx.session.with(|session| session.role));
    let account = Memo::new(move |_| ctx.session.with(|session| session.name.is_some()));
    let admin = move || role.get() == Some(Role::Admin);
    let load = move || {
        let url = if role.get_untracked() == Some(Role::Admin) { PEOPLE } else { "/api/v1/sessions" };
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
    let outcome = RwSignal::new(None);
    let end = move |session: SignedIn| {
        let done = format!("Session of {} ended", session.account);
        change(ctx, outcome, ("DELETE", format!("/api/v1/sessions/{}", session.id)), None, done, load);
    };
    view! {
        <section class="card facts" aria-label="People">
            <header><h2>"People"</h2></header>
            {move || (!trouble.with(String::is_empty)).then(|| view! { <p class="bad" role="alert">{trouble.get()}</p> })}
            {move || admin().then(|| view! { <Accounts people load=Callback::new(move |()| load()) /> })}
            {move || account.get().then(|| view! { <TwoSteps /> })}
            <h3>"Signed in"</h3>
            {move || people.with(|p| p.sessions.is_empty()).then(|| view! { <p class="quiet">"Nobody: no account is needed on this machine, or none is in use."</p> })}
            <table class="dense people">
                <tbody>{move || people.get().sessions.into_iter().map(|session| {
                    let now_s = net::unix_s();
                    let ending = session.clone();
                    view! {
                        <tr>
                            <th scope="row">{session.account.clone()}</th>
                            <td>{session.from.clone()}</td>
                            <td class="num">{format!("{} ago", format::age(now_s - session.begun_s as f64))}</td>
                            <td><button type="button" aria-label=format!("End the session of {} from {}", session.account, session.from)
                                on:click=move |_| end(ending.clone())>"End"</button></td>
                        </tr>
                    }
                }).collect::<Vec<_>>()}</tbody>
            </table>
            <Said outcome />
        </section>
    }
}

/// The second step of signing in of whoever is signed in: set up with a code as its proof, given up with one.
#[component]
fn TwoSteps() -> impl IntoView {
    const URL: &str = "/api/v1/session/authenticator";
    let ctx = ctx();
    let (new, code) = (RwSignal::new(None::<NewAuthenticator>), RwSignal::new(String::new()));
    let outcome = RwSignal::new(None);
    let on = Memo::new(move |_| ctx.session.with(|session| session.two_steps));
    let offer = move |_| {
        leptos::task::spawn_local(async move {
            match net::json::<NewAuthenticator>("POST", URL, None, &ctx.operator()).await {
                Ok(offered) => new.set(Some(offered)),
                Err(failure) => drop(outcome.try_set(Some(Err(failure.text)))),
            }
        });
    };
    let again = move || {
        code.set(String::new());
        leptos::task::spawn_local(async move {
            if let Ok(session) = net::json("GET", "/api/v1/session", None, "").await {
                let session: Session = session;
                if session.two_steps {
                    new.set(None);
                }
                ctx.session.set(session);
            }
        });
    };
    let confirm = move |event: leptos::ev::SubmitEvent| {
        event.prevent_default();
        let code = code.get_untracked();
        let (method, body, done) = match new.get_untracked() {
            Some(new) => {
                ("PUT", json!(Confirmation { secret: new.secret, code }), "You sign in by two steps from now on")
            }
            None => ("DELETE", json!(Code { code }), "Your password is enough from now on"),
        };
        change(ctx, outcome, (method, URL.to_owned()), Some(body), done.to_owned(), again);
    };
    let field = move |label: &'static str| {
        view! {
            <form class="fields" aria-label="Authenticator" on:submit=confirm>
                <label class="field"><span>"Code that it shows now"</span>
                    <input type="text" inputmode="numeric" autocomplete="one-time-code" required
                        prop:value=code on:input:target=move |e| code.set(e.target().value()) /></label>
                <button type="submit">{label}</button>
            </form>
        }
    };
    view! {
        <h3>"Second step"</h3>
        {move || match (on.get(), new.get()) {
            (true, _) => view! {
                <p class="quiet">"You sign in with a password and a code of your authenticator."</p>
                {field("Use the password alone")}
            }.into_any(),
            (false, None) => view! {
                <p class="quiet">"A password is enough to sign in as you. An authenticator on your phone makes it two steps."</p>
                <button type="button" on:click=offer>"Set up an authenticator"</button>
            }.into_any(),
            (false, Some(new)) => view! {
                <p>"Scan this with your authenticator, or " <a href=new.url>"open it here"</a>", or type "<code>{new.secret}</code></p>
                <div class="qr" role="img" aria-label="QR code of the secret" inner_html=new.svg></div>
                {field("Sign in by two steps")}
            }.into_any(),
        }}
        <Said outcome />
    }
}

/// What admins manage.
#[component]
fn Accounts(people: RwSignal<People>, load: Callback<()>) -> impl IntoView {
    let ctx = ctx();
    let (name, password, role) =
        (RwSignal::new(String::new()), RwSignal::new(String::new()), RwSignal::new(Role::Operator));
    let outcome = RwSignal::new(None);
    let add = move |event: leptos::ev::SubmitEvent| {
        event.prevent_default();
        let body = json!(NewAccount {
            name: name.get_untracked(),
            role: role.get_untracked(),
            password: password.get_untracked()
        });
        let done = format!("Account {} made", name.get_untracked());
        password.set(String::new());
        change(ctx, outcome, ("POST", PEOPLE.to_owned()), Some(body), done, move || load.run(()));
    };
    let rows = move || {
        people.get().accounts.into_iter().map(|account| {
            let url = format!("{PEOPLE}/{}", account.name);
            let url = StoredValue::new(url);
            let who = StoredValue::new(account.name.clone());
            let current = account.role;
            let set_role = move |list: web_sys::HtmlSelectElement| {
                let name = list.value();
                // It shows the role that counts: the other one once the ground says so.
                list.set_value(current.name());
                let Some(role) = Role::named(&name) else { return };
                let done = format!("{} is {name} now", who.get_value());
                change(ctx, outcome, ("PATCH", url.get_value()), Some(json!(AccountChange { role: Some(role), ..AccountChange::default() })), done, move || load.run(()));
            };
            let remove = Callback::new(move |()| {
                let done = format!("Account {} removed", who.get_value());
                change(ctx, outcome, ("DELETE", url.get_value()), None, done, move || load.run(()));
            });
            view! {
                <tr>
                    <th scope="row">{account.name.clone()}</th>
                    <td><select aria-label=format!("Role of {}", account.name) prop:value=current.name() on:change:target=move |e| set_role(e.target())>
                        {Role::ALL.map(|r| view! { <option value={r.name()} selected={r == current}>{r.name()}</option> }).collect_view()}
                    </select></td>
                    <td><HoldButton label="Remove" class="warn delete" action=remove /></td>
                </tr>
            }
        }).collect::<Vec<_>>()
    };
    view! {
        <table class="dense people"><tbody>{rows}</tbody></table>
        <form class="fields" aria-label="New account" on:submit=add>
            <label class="field"><span>"Name"</span>
                <input type="text" autocomplete="off" required prop:value=name on:input:target=move |e| name.set(e.target().value()) /></label>
            <label class="field"><span>"Password"</span>
                <input type="password" autocomplete="new-password" required minlength="10" prop:value=password on:input:target=move |e| password.set(e.target().value()) /></label>
            <label class="field"><span>"Role"</span>
                <select on:change:target=move |e| role.set(Role::named(&e.target().value()).unwrap_or(Role::Viewer))>
                    {Role::ALL.map(|r| view! { <option value={r.name()} selected={r == Role::Operator}>{r.name()}</option> }).collect_view()}
                </select></label>
            <button type="submit">"Add account"</button>
        </form>
        <Said outcome />
    }
}
