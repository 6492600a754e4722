//! Who may use a route: every one of the table passes here, after the [guard](super::guard) has looked at Host and Origin.
//!
//! A session cookie is sent by the browser on its own account, so what it changes needs more than the cookie: the Origin
//! of this page (checked by the guard, required here) and a header that no foreign page can set without being allowed to.

use std::sync::Arc;

use axum::body::{Body, to_bytes};
use axum::extract::connect_info::ConnectInfo;
use axum::extract::{MatchedPath, Request, State};
use axum::http::{HeaderMap, Method, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};

use http_body_util::LengthLimitError;

use super::App;
use super::error::ApiError;
use super::operator::{self, Operator, Signed};
use crate::audit::{Deed, redacted};
use crate::front::{Peer, Place};
use crate::people::{Access, COOKIE, Person, SessionKey, Token};
use crate::sync::wall_time_us;

/// The session token that a request shows.
pub(crate) fn token(headers: &HeaderMap) -> Option<Token> {
    let cookies = headers.get_all(header::COOKIE).iter().filter_map(|value| value.to_str().ok());
    let mut pairs = cookies.flat_map(|line| line.split(';')).filter_map(|pair| pair.trim().split_once('='));
    pairs.find(|(name, _)| *name == COOKIE).and_then(|(_, value)| Token::from_cookie(value))
}

/// Lets a request through when `need` is met, and writes down what it changed, or that it was refused.
pub(crate) async fn admit(
    State((app, need, limit)): State<(App, Access, usize)>,
    mut request: Request,
    next: Next,
) -> Response {
    let mut deed = deed(&request);
    let (session, by_ticket) = match shown(&app, &request) {
        Ok(shown) => shown,
        Err(error) => return refuse(&app, deed, error),
    };
    let shown = (session.as_ref(), by_ticket);
    let admitted = permit(&app, need, request.method(), request.headers(), shown).and_then(|person| {
        let who = match person.as_ref().and_then(|person| person.account.clone()) {
            Some(account) => account,
            None if is_cut(&request) => {
                operator::called(request.headers()).unwrap_or_else(|_| operator::UNNAMED.into())
            }
            None => operator::called(request.headers())?,
        };
        Ok((person, who))
    });
    let person;
    (person, deed.who) = match admitted {
        Ok(admitted) => admitted,
        Err(error) => return refuse(&app, deed, error),
    };
    deed.role = person.as_ref().map_or("nobody", |person| person.role.name());
    // Whoever is known keeps their connection when there are too many clients.
    if let Some(place) = request.extensions().get::<Arc<Place>>().filter(|_| need != Access::Open) {
        place.keep(&deed.who);
    }
    if let Some(person) = person {
        request.extensions_mut().insert(Signed(person));
    }
    let operator = Operator::new(deed.who.clone(), request.headers());
    request.extensions_mut().insert(operator);
    if let Some(session) = session {
        request.extensions_mut().insert(session);
    }
    // Whoever holds a ticket may be anybody: that it was used is written down.
    if by_ticket {
        let response = next.run(request).await;
        app.audit.record(Deed { status: response.status().as_u16(), ..deed });
        return response;
    }
    // Signing in and out write their own lines, without the password.
    if need == Access::Open || !changes(request.method()) {
        return next.run(request).await;
    }
    // What may be large is read by its handler, as it comes.
    if limit > super::MAX_BODY {
        let response = next.run(request).await;
        app.audit.record(Deed { status: response.status().as_u16(), ..deed });
        return response;
    }
    let (parts, body) = request.into_parts();
    // One byte more than allowed passes here, so that the handler's own limit answers.
    let bytes = match to_bytes(body, limit + 1).await {
        Ok(bytes) => bytes,
        Err(error) => {
            let too_large =
                std::error::Error::source(&error).is_some_and(<dyn std::error::Error>::is::<LengthLimitError>);
            let error = if too_large {
                ApiError::TooLarge(format!("the body is larger than {limit} bytes"))
            } else {
                ApiError::Late(format!("the body did not come: {error}"))
            };
            return refuse(&app, deed, error);
        }
    };
    deed.body = redacted(&bytes);
    let response = next.run(Request::from_parts(parts, Body::from(bytes))).await;
    app.audit.record(Deed { status: response.status().as_u16(), ..deed });
    response
}

/// Answers a request that is refused, and has it written down.
pub(super) fn refuse(app: &App, deed: Deed, error: ApiError) -> Response {
    let response = error.into_response();
    app.audit.refuse(Deed { status: response.status().as_u16(), ..deed });
    response
}

/// What is known of a request before anybody is.
pub(super) fn deed(request: &Request) -> Deed {
    Deed {
        unix_us: wall_time_us(),
        who: String::new(),
        role: "nobody",
        from: from(request),
        method: crate::names::clip(request.method().as_str()),
        path: crate::names::clip(request.uri().path()),
        body: String::new(),
        status: 0,
        times: 1,
    }
}

/// The motors are cut whatever somebody is called.
fn is_cut(request: &Request) -> bool {
    request.extensions().get::<MatchedPath>().is_some_and(|path| path.as_str() == super::CUT)
}

fn changes(method: &Method) -> bool {
    !matches!(*method, Method::GET | Method::HEAD | Method::OPTIONS)
}

/// Address of a request, for the audit log.
fn from(request: &Request) -> String {
    request.extensions().get::<ConnectInfo<Peer>>().map_or_else(String::new, |info| info.0.0.ip().to_string())
}

/// The session that a request shows, and whether by a ticket: on the one route of programs that cannot sign in.
fn shown(app: &App, request: &Request) -> Result<(Option<SessionKey>, bool), ApiError> {
    let taken = request.extensions().get::<MatchedPath>().is_some_and(|path| path.as_str() == super::FOXGLOVE);
    let ticket = request.uri().query().unwrap_or_default().split('&').find_map(|pair| pair.strip_prefix("ticket="));
    let ticket = ticket.filter(|_| taken && request.method() == Method::GET && app.people.sign_in_needed());
    let Some(ticket) = ticket else { return Ok((token(request.headers()).map(|token| token.key()), false)) };
    let session = app.people.redeem(ticket, request.uri().path());
    let session = session.ok_or_else(|| {
        ApiError::SignIn("this ticket is none, was used, or has expired: ask for another address".into())
    })?;
    Ok((Some(session), true))
}

fn permit(
    app: &App,
    need: Access,
    method: &Method,
    headers: &HeaderMap,
    (session, by_ticket): (Option<&SessionKey>, bool),
) -> Result<Option<Person>, ApiError> {
    let person = app.people.person_of(session);
    if need == Access::Open {
        return Ok(person);
    }
    let Some(person) = person else {
        return Err(ApiError::SignIn("sign in first".into()));
    };
    if !need.open_to(person.role) {
        let (role, least) = (person.role.name(), need.least().name());
        return Err(ApiError::Foreign(format!("a {role} may not do this; it needs the role {least}")));
    }
    let by_cookie = person.account.is_some() && !by_ticket;
    let upgrade = headers.contains_key(header::UPGRADE);
    if by_cookie && (changes(method) || upgrade) && !headers.contains_key(header::ORIGIN) {
        return Err(ApiError::Foreign("a request by session needs the Origin of this page".into()));
    }
    if by_cookie && changes(method) && !headers.contains_key(operator::HEADER) {
        return Err(ApiError::Foreign(format!("a request by session needs the header {}", operator::HEADER)));
    }
    Ok(Some(person))
}
