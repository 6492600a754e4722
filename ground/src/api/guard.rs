//! Every request passes here: is it meant for this ground, and does it come from its own page?
//!
//! - `Host` must be an IP address, `localhost`, or a configured name. A foreign page that rebinds
//!   its own name to this machine is refused, because its name is not one of these.
//! - `Origin`, which browsers send with every WebSocket, every writing request and every request of a
//!   foreign page, must be that same host, by TLS where TLS is on. Its absence means no foreign page; what a
//!   session changes needs it (see [`super::access`]).

use axum::extract::{Request, State};
use axum::http::{HeaderMap, HeaderValue, Uri, header};
use axum::middleware::Next;
use axum::response::Response;

use super::error::ApiError;
use super::{App, access};

pub(crate) async fn guard(State(app): State<App>, request: Request, next: Next) -> Response {
    let host = match check(&app, request.uri(), request.headers()) {
        Ok(host) => host,
        Err(error) => return access::refuse(&app, access::deed(&request), error),
    };
    let mut response = next.run(request).await;
    secure(response.headers_mut(), &host, app.secure());
    response
}

fn check(app: &App, uri: &Uri, headers: &HeaderMap) -> Result<String, ApiError> {
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
    if !own_origin(headers, host, app.secure()) {
        let origin = headers.get(header::ORIGIN);
        return Err(ApiError::Foreign(format!("origin {origin:?} is not this ground's page")));
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

/// Is there no Origin, or exactly one that names this host?
fn own_origin(headers: &HeaderMap, host: &str, secure: bool) -> bool {
    let mut origins = headers.get_all(header::ORIGIN).iter();
    match (origins.next(), origins.next()) {
        (None, _) => true,
        (Some(origin), None) => origin.to_str().is_ok_and(|origin| {
            let rest = origin.strip_prefix(if secure { "https://" } else { "http://" });
            rest.is_some_and(|rest| rest.eq_ignore_ascii_case(host))
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
    fn the_origin_must_be_the_host() {
        let origin = |values: &[&'static str]| {
            let mut headers = HeaderMap::new();
            for value in values {
                headers.append(header::ORIGIN, HeaderValue::from_static(value));
            }
            own_origin(&headers, "127.0.0.1:4747", false)
        };
        assert!(origin(&[]));
        assert!(origin(&["http://127.0.0.1:4747"]));
        for bad in ["http://127.0.0.1:3000", "http://localhost:4747", "null", "file://", "http://127.0.0.1:4747.evil"] {
            assert!(!origin(&[bad]), "{bad}");
        }
        assert!(!origin(&["http://127.0.0.1:4747", "http://127.0.0.1:4747"]));
    }
}
