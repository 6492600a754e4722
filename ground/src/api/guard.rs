//! Every request passes here: is it meant for this ground, and does it come from its own page?
//!
//! - `Host` must be an IP address, `localhost`, or a configured name. A foreign page that rebinds
//!   its own name to this machine is refused, because its name is not one of these.
//! - `Origin`, which browsers send with every WebSocket, every writing request and every request of a
//!   foreign page, must be that same host, by TLS where TLS is on. Its absence means no foreign page; what a
//!   session changes needs it (see [`super::access`]). The Foxglove link is opened to configured origins, too: what shows
//!   it is a page of others.

use std::sync::atomic::{AtomicU64, Ordering};

use axum::extract::{Request, State};
use axum::http::{HeaderMap, HeaderValue, Method, Uri, header};
use axum::middleware::Next;
use axum::response::Response;
use tracing::Instrument as _;

use super::error::ApiError;
use super::{App, access};

/// Where the number of a request stands, asked and answered.
const REQUEST_ID: &str = "x-request-id";
/// How the one address ends that pages of others may open.
const FOXGLOVE: &str = "/foxglove";

pub(crate) async fn guard(State(app): State<App>, request: Request, next: Next) -> Response {
    let id = number(request.headers());
    let span = tracing::info_span!("request", %id, method = %request.method(), path = %request.uri().path());
    let mut response = answer(app.clone(), request, next).instrument(span).await;
    app.counts.answered(response.status());
    if let Ok(id) = HeaderValue::from_str(&id) {
        response.headers_mut().insert(REQUEST_ID, id);
    }
    response
}

async fn answer(app: App, request: Request, next: Next) -> Response {
    let host = match check(&app, request.method(), request.uri(), request.headers()) {
        Ok(host) => host,
        Err(error) => return access::refuse(&app, access::deed(&request), error),
    };
    let mut response = next.run(request).await;
    secure(response.headers_mut(), &host, app.secure());
    response
}

/// By what the log and the client name a request: the client's own number, where it is one, else ours.
fn number(headers: &HeaderMap) -> String {
    static NEXT: AtomicU64 = AtomicU64::new(1);
    let theirs = headers.get(REQUEST_ID).and_then(|id| id.to_str().ok());
    let plain = |id: &&str| (1..=64).contains(&id.len()) && id.bytes().all(|b| b.is_ascii_alphanumeric() || b == b'-');
    theirs.filter(plain).map_or_else(|| NEXT.fetch_add(1, Ordering::Relaxed).to_string(), str::to_owned)
}

fn check(app: &App, method: &Method, uri: &Uri, headers: &HeaderMap) -> Result<String, ApiError> {
    let mut hosts = headers.get_all(header::HOST).iter();
    let host = match (hosts.next(), hosts.next()) {
        (Some(host), None) => host.to_str().ok(),
        (None, _) => uri.authority().map(|authority| authority.as_str()),
        _ => None,
    };
    let host = host.ok_or_else(|| ApiError::Foreign("one Host header is needed".into()))?;
    if !known_host(host, &app.config.allowed_hosts) {
        return Err(ApiError::Foreign(format!("host {host:?} is not served here")));
    }
    let foxglove = *method == Method::GET && uri.path().ends_with(FOXGLOVE);
    let others = if foxglove { app.config.allowed_origins.as_slice() } else { &[] };
    if !known_origin(headers, host, app.secure(), others) {
        let (origin, nor) = (headers.get(header::ORIGIN), if foxglove { ", nor one of allow_origins" } else { "" });
        return Err(ApiError::Foreign(format!("origin {origin:?} is not this ground's page{nor}")));
    }
    Ok(host.to_owned())
}

/// Is the host an address, `localhost`, or one of `allowed`?
fn known_host(host: &str, allowed: &[String]) -> bool {
    let Ok(authority) = host.parse::<axum::http::uri::Authority>() else { return false };
    let name = authority.host();
    let bare = name.trim_start_matches('[').trim_end_matches(']');
    name.eq_ignore_ascii_case("localhost")
        || bare.parse::<std::net::IpAddr>().is_ok()
        || allowed.iter().any(|known| known.eq_ignore_ascii_case(name))
}

/// Is there no Origin, or exactly one, which names this host or is among `others`?
fn known_origin(headers: &HeaderMap, host: &str, secure: bool, others: &[String]) -> bool {
    let mut origins = headers.get_all(header::ORIGIN).iter();
    match (origins.next(), origins.next()) {
        (None, _) => true,
        (Some(origin), None) => origin.to_str().is_ok_and(|origin| {
            let rest = origin.strip_prefix(if secure { "https://" } else { "http://" });
            rest.is_some_and(|rest| rest.eq_ignore_ascii_case(host))
                || others.iter().any(|other| other.eq_ignore_ascii_case(origin))
        }),
        _ => false,
    }
}

fn secure(headers: &mut HeaderMap, host: &str, tls: bool) {
    let socket = if tls { "wss" } else { "ws" };
    // 'wasm-unsafe-eval' lets WebAssembly compile and nothing else; style attributes are set by the
    // page's framework; some browsers do not count ws: as 'self'.
    let policy = format!(
        "default-src 'none'; script-src 'self' 'wasm-unsafe-eval'; style-src 'self' 'unsafe-inline'; \
         img-src 'self' data: blob:; font-src 'self'; connect-src 'self' {socket}://{host}; \
         worker-src 'self'; manifest-src 'self'; base-uri 'none'; form-action 'self'; frame-ancestors 'none'"
    );
    if let Ok(policy) = HeaderValue::from_str(&policy) {
        headers.insert(header::CONTENT_SECURITY_POLICY, policy);
    }
    headers.insert(header::X_CONTENT_TYPE_OPTIONS, HeaderValue::from_static("nosniff"));
    headers.insert(header::X_FRAME_OPTIONS, HeaderValue::from_static("DENY"));
    headers.insert(header::REFERRER_POLICY, HeaderValue::from_static("same-origin"));
    headers.insert("cross-origin-opener-policy", HeaderValue::from_static("same-origin"));
    headers.insert("cross-origin-resource-policy", HeaderValue::from_static("same-origin"));
    if tls {
        headers.insert(header::STRICT_TRANSPORT_SECURITY, HeaderValue::from_static("max-age=31536000"));
    }
    headers.entry(header::CACHE_CONTROL).or_insert(HeaderValue::from_static("no-store"));
}

#[cfg(test)]
mod tests {
    use super::*;

    fn among(values: &[&'static str], others: &[String]) -> bool {
        let mut headers = HeaderMap::new();
        for value in values {
            headers.append(header::ORIGIN, HeaderValue::from_static(value));
        }
        known_origin(&headers, "127.0.0.1:4747", false, others)
    }

    #[test]
    fn only_addresses_localhost_and_configured_names_are_hosts() {
        let allowed = ["bench.lab".to_owned()];
        for good in ["127.0.0.1:4747", "localhost", "[::1]:4747", "10.0.0.7:80", "bench.lab:4747"] {
            assert!(known_host(good, &allowed), "{good}");
        }
        for bad in ["evil.example:4747", "localhost.evil.example", "", "127.0.0.1.evil.example", "a b"] {
            assert!(!known_host(bad, &allowed), "{bad}");
        }
    }

    #[test]
    fn a_request_has_the_number_its_client_gave_it_or_one_of_its_own() {
        let of = |id: &'static str| {
            number(&HeaderMap::from_iter([(REQUEST_ID.parse().unwrap(), HeaderValue::from_static(id))]))
        };
        assert_eq!(of("run-7"), "run-7");
        for odd in ["", "a b", "a\"b", "{}"] {
            assert!(of(odd).parse::<u64>().is_ok(), "{odd}");
        }
        assert_ne!(number(&HeaderMap::new()), number(&HeaderMap::new()));
    }

    #[test]
    fn the_origin_must_be_the_host() {
        let origin = |values: &[&'static str]| among(values, &[]);
        assert!(origin(&[]));
        assert!(origin(&["http://127.0.0.1:4747"]));
        for bad in ["http://127.0.0.1:3000", "http://localhost:4747", "null", "file://", "http://127.0.0.1:4747.evil"] {
            assert!(!origin(&[bad]), "{bad}");
        }
        assert!(!origin(&["http://127.0.0.1:4747", "http://127.0.0.1:4747"]));
    }

    #[test]
    fn a_configured_origin_is_one_and_the_same() {
        let allowed = ["https://app.foxglove.dev".to_owned(), "file://".to_owned()];
        let among = |values: &[&'static str]| among(values, &allowed);
        assert!(among(&["https://app.foxglove.dev"]) && among(&["file://"]));
        assert!(
            !among(&["https://app.foxglove.dev.evil"]) && !among(&["http://app.foxglove.dev"]) && !among(&["null"])
        );
        assert!(!among(&["file://", "file://"]));
    }
}
