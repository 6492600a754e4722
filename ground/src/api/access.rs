//! Who may use a route: every one of the table passes here, after the [guard](super::guard) has looked at Host and Origin.
//!
//! A session cookie is sent by the browser on its own account, so what it changes needs more than the cookie: the Origin
//! of this page (checked by the guard, required here) and a header that no foreign page can set without being allowed to.

use axum::body::{Body, to_bytes};
use axum::extract::connect_info::ConnectInfo;
use axum::extract::{Request, State};
use axum::http::{HeaderMap, Method, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};

use super::App;
use super::error::ApiError;
use super::operator::{self, Operator};
use crate::audit::Deed;
use crate::front::Peer;
use crate::people::{Access, COOKIE, Person, Token};
use crate::sync::wall_time_us;

/// Bodies up to this length are written into the audit log.
const AUDITED_BODY: usize = 1024;

/// The session token that a request shows.
pub(crate) fn token(headers: &HeaderMap) -> Option<Token> {
    let cookies = headers.get_all(header::COOKIE).iter().filter_map(|value| value.to_str().ok());
    let mut pairs = cookies.flat_map(|line| line.split(';')).filter_map(|pair| pair.trim().split_once('='));
    pairs.find(|(name, _)| *name == COOKIE).and_then(|(_, value)| Token::from_cookie(value))
}

/// Lets a request through when `need` is met, and writes down what it changed.
pub(crate) async fn admit(
    State((app, need, limit)): State<(App, Access, usize)>,
    mut request: Request,
    next: Next,
) -> Response {
    let person = match permit(&app, need, request.method(), request.headers()) {
        Ok(person) => person,
        Err(error) => return error.into_response(),
    };
    let called = match operator::called(request.headers()) {
        Ok(called) => called,
        Err(error) => return error.into_response(),
    };
    let name = person.as_ref().and_then(|person| person.account.clone()).unwrap_or(called);
    request.extensions_mut().insert(Operator(name.clone()));
    // Signing in and out write their own lines, without the password.
    if need == Access::Open || !changes(request.method()) {
        return next.run(request).await;
    }
    let mut deed = Deed {
        unix_us: wall_time_us(),
        who: name,
        role: person.map_or("nobody", |person| person.role.name()),
        from: from(&request),
        method: request.method().to_string(),
        path: crate::names::clip(request.uri().path()),
        body: String::new(),
        status: 0,
    };
    let (parts, body) = request.into_parts();
    // One byte more than allowed passes here, so that the handler's own limit answers.
    let Ok(bytes) = to_bytes(body, limit + 1).await else {
        let too_large = ApiError::TooLarge(format!("the body is larger than {limit} bytes"));
        deed.status = 413;
        app.audit.record(deed);
        return too_large.into_response();
    };
    if bytes.len() <= AUDITED_BODY {
        deed.body = String::from_utf8_lossy(&bytes).into_owned();
    }
    let response = next.run(Request::from_parts(parts, Body::from(bytes))).await;
    deed.status = response.status().as_u16();
    app.audit.record(deed);
    response
}

fn changes(method: &Method) -> bool {
    !matches!(*method, Method::GET | Method::HEAD | Method::OPTIONS)
}

/// Address of a request, for the audit log.
pub(crate) fn from(request: &Request) -> String {
    request.extensions().get::<ConnectInfo<Peer>>().map_or_else(String::new, |info| info.0.0.ip().to_string())
}

fn permit(app: &App, need: Access, method: &Method, headers: &HeaderMap) -> Result<Option<Person>, ApiError> {
    let person = app.people.person(token(headers).as_ref());
    if need == Access::Open {
        return Ok(person);
    }
    let Some(person) = person else {
        return Err(ApiError::SignIn("sign in first".into()));
    };
    if !person.role.may(need) {
        let (role, least) = (person.role.name(), need.least().name());
        return Err(ApiError::Foreign(format!("a {role} may not do this; it needs the role {least}")));
    }
    let by_cookie = person.account.is_some();
    let upgrade = headers.contains_key(header::UPGRADE);
    if by_cookie && (changes(method) || upgrade) && !headers.contains_key(header::ORIGIN) {
        return Err(ApiError::Foreign("a request by session needs the Origin of this page".into()));
    }
    if by_cookie && changes(method) && !headers.contains_key(operator::HEADER) {
        return Err(ApiError::Foreign(format!("a request by session needs the header {}", operator::HEADER)));
    }
    Ok(Some(person))
}
