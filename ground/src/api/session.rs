//! Signing in and out: JSON for pages and scripts, and a plain form that works before the page is loaded.

use std::net::IpAddr;

use axum::Json;
use axum::extract::connect_info::ConnectInfo;
use axum::extract::{FromRequestParts, State};
use axum::http::request::Parts;
use axum::http::{HeaderMap, HeaderValue, StatusCode, header};
use axum::response::{Html, IntoResponse, Redirect, Response};
use plumbline_rest::people::{Code, Confirmation, Credentials, NewAuthenticator, Session};

use super::App;
use super::access::token;
use super::body::Body;
use super::error::ApiError;
use super::operator::Signed;
use crate::audit::Deed;
use crate::front::Peer;
use crate::people::{AccountError, Authenticator, COOKIE, Person, SESSION_LONGEST_S, SignInError, Token};
use crate::sync::wall_time_us;

/// Address of the client, where it is known.
pub(crate) struct From(Option<IpAddr>);

impl<S: Sync> FromRequestParts<S> for From {
    type Rejection = ApiError;

    async fn from_request_parts(parts: &mut Parts, _: &S) -> Result<Self, ApiError> {
        Ok(Self(parts.extensions.get::<ConnectInfo<Peer>>().map(|info| info.0.0.ip())))
    }
}

pub(crate) async fn show(State(app): State<App>, headers: HeaderMap) -> Json<Session> {
    let person = app.people.person(token(&headers).as_ref());
    let name = person.as_ref().and_then(|person| person.account.clone());
    Json(Session {
        sign_in_needed: app.people.sign_in_needed(),
        signed_in: person.is_some(),
        two_steps: name.as_ref().is_some_and(|name| two_steps(&app, name)),
        name,
        role: person.map(|person| person.role),
    })
}

fn two_steps(app: &App, name: &str) -> bool {
    let accounts = app.people.accounts().known();
    accounts.is_some_and(|all| all.iter().any(|account| account.name == name && account.two_steps()))
}

pub(crate) async fn begin(
    State(app): State<App>,
    from: From,
    Body(credentials): Body<Credentials>,
) -> Result<Response, ApiError> {
    let (token, person) = sign_in(&app, &from, credentials).await?;
    let two_steps = two_steps(&app, person.account.as_deref().unwrap_or_default());
    let body =
        Session { sign_in_needed: true, signed_in: true, name: person.account, role: Some(person.role), two_steps };
    Ok((StatusCode::OK, cookie(&app, token.as_str(), SESSION_LONGEST_S), Json(body)).into_response())
}

pub(crate) async fn end(State(app): State<App>, from: From, headers: HeaderMap) -> Response {
    sign_out(&app, &from, &headers).await;
    (StatusCode::NO_CONTENT, cookie(&app, "", 0)).into_response()
}

/// The account that asks; without one there is nothing to set up.
fn account(person: Person) -> Result<String, ApiError> {
    person.account.ok_or_else(|| ApiError::Conflict("no account is signed in".into()))
}

/// A new authenticator; it counts once a code of it has come back ([`confirm`]).
pub(crate) async fn offer(Signed(person): Signed) -> Result<Json<NewAuthenticator>, ApiError> {
    let new = Authenticator::new(&account(person)?)?;
    Ok(Json(NewAuthenticator { secret: new.secret(), url: new.url(), svg: new.picture() }))
}

/// From now on this account signs in by two steps. One that does already gives its authenticator up first ([`one_step`]).
pub(crate) async fn confirm(
    State(app): State<App>,
    Signed(person): Signed,
    Body(asked): Body<Confirmation>,
) -> Result<StatusCode, ApiError> {
    let name = account(person)?;
    let authenticator = Authenticator::of(&name, &asked.secret)?;
    authenticator.step(&asked.code, wall_time_us() / 1_000_000).ok_or(AccountError::Code)?;
    app.people.change(move |accounts| accounts.set_totp(&name, Some(&authenticator))).await?;
    Ok(StatusCode::NO_CONTENT)
}

/// From now on its password is enough; a code is asked for, so that a page left open is not.
pub(crate) async fn one_step(
    State(app): State<App>,
    Signed(person): Signed,
    from: From,
    Body(asked): Body<Code>,
) -> Result<StatusCode, ApiError> {
    let name = account(person)?;
    if !app.people.confirmed(from.0, &name, &asked.code)? {
        return Err(AccountError::Code.into());
    }
    app.people.change(move |accounts| accounts.set_totp(&name, None)).await?;
    Ok(StatusCode::NO_CONTENT)
}

async fn sign_out(app: &App, from: &From, headers: &HeaderMap) {
    let Some(token) = token(headers) else { return };
    if let Some(Person { account: Some(who), role }) = app.people.person(Some(&token)) {
        app.audit.record(deed(from, "DELETE", &who, role.name(), 204));
    }
    app.people.sign_out(&token).await;
}

/// The form, for people without a session; with one, the way out.
pub(crate) async fn page(State(app): State<App>, headers: HeaderMap) -> Response {
    match app.people.person(token(&headers).as_ref()) {
        Some(Person { account: None, .. }) => Redirect::to("/").into_response(),
        Some(Person { account: Some(name), role }) => Html(form_out(&name, role.name())).into_response(),
        None => Html(form_in("")).into_response(),
    }
}

pub(crate) async fn page_in(State(app): State<App>, from: From, body: axum::body::Bytes) -> Response {
    let field = |wanted: &str| {
        let mut fields = body.split(|byte| *byte == b'&').filter_map(|pair| {
            let at = pair.iter().position(|byte| *byte == b'=')?;
            Some((pair.get(..at)?, pair.get(at + 1..)?))
        });
        fields.find(|(name, _)| *name == wanted.as_bytes()).map_or_else(String::new, |(_, value)| unescape(value))
    };
    let credentials = Credentials { name: field("name"), password: field("password"), code: field("code") };
    match sign_in(&app, &from, credentials).await {
        Ok((token, _)) => (cookie(&app, token.as_str(), SESSION_LONGEST_S), Redirect::to("/")).into_response(),
        Err(error) => {
            let ((status, _), text) = (error.kind(), error.text());
            (status, Html(form_in(&text))).into_response()
        }
    }
}

pub(crate) async fn page_out(State(app): State<App>, from: From, headers: HeaderMap) -> Response {
    sign_out(&app, &from, &headers).await;
    (cookie(&app, "", 0), Redirect::to("/login")).into_response()
}

async fn sign_in(app: &App, from: &From, credentials: Credentials) -> Result<(Token, Person), ApiError> {
    let Credentials { name, password, code } = credentials;
    let outcome = app.people.sign_in(from.0, &name, password, &code).await;
    match &outcome {
        Ok((_, person)) => app.audit.record(deed(from, "POST", &name, person.role.name(), 200)),
        Err(error) => {
            let status = if matches!(error, SignInError::Wrong | SignInError::CodeNeeded) { 401 } else { 429 };
            app.audit.refuse(deed(from, "POST", &name, "nobody", status));
        }
    }
    Ok(outcome?)
}

impl std::convert::From<SignInError> for ApiError {
    fn from(error: SignInError) -> Self {
        match error {
            SignInError::Wrong | SignInError::CodeNeeded => Self::SignIn(error.to_string()),
            SignInError::Throttled(seconds) => Self::Throttled(seconds, error.to_string()),
            SignInError::Busy => Self::Throttled(1, error.to_string()),
            SignInError::Broken(_) => Self::Broken(error.to_string()),
        }
    }
}

fn deed(from: &From, method: &str, who: &str, role: &'static str, status: u16) -> Deed {
    Deed {
        unix_us: wall_time_us(),
        who: crate::names::clip(who),
        role,
        from: from.0.map_or_else(String::new, |from| from.to_string()),
        method: method.to_owned(),
        path: "/api/v1/session".into(),
        body: String::new(),
        status,
        times: 1,
    }
}

fn cookie(app: &App, value: &str, seconds: u64) -> HeaderMap {
    let secure = if app.secure() { "; Secure" } else { "" };
    let line = format!("{COOKIE}={value}; Path=/; HttpOnly; SameSite=Strict; Max-Age={seconds}{secure}");
    let mut headers = HeaderMap::new();
    if let Ok(line) = HeaderValue::from_str(&line) {
        headers.insert(header::SET_COOKIE, line);
    }
    headers
}

/// The colours of the page (`web/style.css`), which is not there yet.
pub(super) const STYLE: &str = "<style>\
:root{color-scheme:light dark;--page:#f3f4f6;--card:#fff;--edge:#d5d9df;--control:#fff;--control-edge:#b9c0c9;--ink:#1c2128;\
--quiet:#59626e;--focus:#0072b2;--on-focus:#fff;--bad:#b3261e;--bad-fill:#fbe4e1}\
@media(prefers-color-scheme:dark){:root{--page:#0f1216;--card:#161a20;--edge:#272d36;--control:#1e242c;--control-edge:#3c4551;\
--ink:#e8ecf1;--quiet:#a0a9b5;--focus:#56b4e9;--on-focus:#0f1216;--bad:#ff8a80;--bad-fill:#3a1a18}}\
*{box-sizing:border-box}html{background:var(--page);color:var(--ink);font:15px/1.4 system-ui,sans-serif}\
body{max-width:22rem;margin:14vh auto;padding:0 1rem}\
main{background:var(--card);border:1px solid var(--edge);border-radius:7px;padding:1.25rem 1.5rem 1.5rem}\
h1{font-size:1.35rem;margin:0 0 1rem}p{margin:0 0 1rem}a{color:var(--focus)}label{display:block;margin:0 0 1rem;color:var(--quiet)}\
input,button{font:inherit;border-radius:5px;min-height:38px;width:100%}\
input{display:block;margin-top:.25rem;padding:.4rem .6rem;color:var(--ink);background:var(--control);border:1px solid var(--control-edge)}\
button{border:0;background:var(--focus);color:var(--on-focus);font-weight:600;cursor:pointer}\
:focus-visible{outline:2px solid var(--focus);outline-offset:2px}\
[role=alert]{color:var(--bad);background:var(--bad-fill);border-radius:5px;padding:.5rem .75rem}</style>";

fn document(title: &str, body: &str) -> String {
    format!(
        "<!doctype html><html lang=en><meta charset=utf-8><meta name=viewport content=\"width=device-width\">\
         <title>{title} – Plumbline</title>{STYLE}<main><h1>Plumbline</h1>{body}</main></html>"
    )
}

fn form_in(trouble: &str) -> String {
    let trouble = if trouble.is_empty() { String::new() } else { format!("<p role=alert>{}</p>", escape(trouble)) };
    document(
        "Sign in",
        &format!(
            "{trouble}<form method=post action=/login>\
             <label>Name<input name=name autocomplete=username required autofocus></label>\
             <label>Password<input name=password type=password autocomplete=current-password required></label>\
             <label>Code of your authenticator, if you have set one up\
             <input name=code inputmode=numeric autocomplete=one-time-code></label>\
             <button>Sign in</button></form>"
        ),
    )
}

fn form_out(name: &str, role: &str) -> String {
    document(
        "Sign out",
        &format!(
            "<p>Signed in as <b>{}</b>, {role}. <a href=/>To the page</a></p>\
             <form method=post action=/logout><button>Sign out</button></form>",
            escape(name)
        ),
    )
}

pub(super) fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

/// One value of a form: `+` is a space, `%41` is `A`.
fn unescape(value: &[u8]) -> String {
    let mut bytes = Vec::with_capacity(value.len());
    let mut rest = value.iter().copied();
    while let Some(byte) = rest.next() {
        bytes.push(match byte {
            b'+' => b' ',
            b'%' => {
                let digits = [rest.next(), rest.next()].map(|d| d.and_then(|d| char::from(d).to_digit(16)));
                match digits {
                    [Some(high), Some(low)] => (high * 16 + low) as u8,
                    _ => b'?',
                }
            }
            other => other,
        });
    }
    String::from_utf8_lossy(&bytes).into_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn form_values_are_unescaped_and_names_are_escaped() {
        assert_eq!(unescape(b"a+b%26c%C3%A9"), "a b&cé");
        assert_eq!(unescape(b"%4"), "?");
        assert!(form_in("<script>").contains("&lt;script&gt;"));
    }
}
