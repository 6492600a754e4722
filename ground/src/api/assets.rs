//! The page: files of `web/dist`, built into the binary, precompressed.
//!
//! `name.br` beside or instead of `name` is its brotli form. A client that does not accept brotli
//! (browsers do not, over plain HTTP to another machine) gets the identity form, unpacked here when
//! only the other exists.

use std::borrow::Cow;
use std::io::Read as _;

use axum::body::Body;
use axum::extract::State;
use axum::http::{HeaderMap, HeaderValue, Method, StatusCode, Uri, header};
use axum::response::{IntoResponse, Redirect, Response};
use rust_embed::RustEmbed;

use super::App;
use super::access::token;
use super::error::ApiError;

#[derive(RustEmbed)]
#[folder = "../web/dist"]
struct Dist;

/// Largest file unpacked for a client without brotli.
const MAX_UNPACKED: u64 = 64 << 20;
/// Pages that are the same document: the page routes by itself.
const PAGES: [&str; 7] = ["", "flights", "experiments", "tune", "calibrate", "setup", "index.html"];

const NOT_BUILT: &str = "<!doctype html><meta charset=utf-8><title>Plumbline</title>\
<style>body{font:16px system-ui;max-width:40em;margin:4em auto;padding:0 1em}code{background:#8882;padding:.1em .3em}</style>\
<h1>The page is not built into this ground</h1>\
<p>The ground runs, records and answers its API, but it was compiled before the page was. From the repository, run</p>\
<p><code>cargo xtask web</code> and then <code>cargo build --release -p plumbline-ground</code></p>\
<p>or <code>cargo xtask run</code>, which does both and starts a simulated quadrotor.</p>\
<p>The API: <a href=/api/v1/ground>/api/v1/ground</a>, <a href=/api/v1/vehicles>/api/v1/vehicles</a>, <a href=/api/v1/flights>/api/v1/flights</a>.</p>";

/// Anything that is no route: the page and its files. The files are nobody's secret; the page itself sends people
/// without a session to sign in.
pub(crate) async fn serve(State(app): State<App>, method: Method, uri: Uri, headers: HeaderMap) -> Response {
    if !matches!(method, Method::GET | Method::HEAD) {
        return ApiError::Method(format!("{} has no {method}", crate::names::clip(uri.path()))).into_response();
    }
    let path = uri.path().trim_matches('/');
    let flight = path.strip_prefix("flights/").map(|id| id.strip_suffix("/report").unwrap_or(id));
    let page = PAGES.contains(&path) || flight.is_some_and(|id| !id.contains('/'));
    // Who mistyped an address is told by the page; a program gets its error.
    let mistyped = !page && wants_page(&headers) && !is_there(path);
    if (page || mistyped) && app.people.person(token(&headers).as_ref()).is_none() {
        return Redirect::to("/login").into_response();
    }
    let name = if page || mistyped { "index.html" } else { path };
    match find(name, accepts_brotli(&headers)) {
        Ok(Some(asset)) if mistyped => (StatusCode::NOT_FOUND, respond(name, asset, &HeaderMap::new())).into_response(),
        Ok(Some(asset)) => respond(name, asset, &headers),
        Ok(None) if page => (
            StatusCode::OK,
            [(header::CONTENT_TYPE, "text/html; charset=utf-8"), (header::CACHE_CONTROL, "no-cache")],
            NOT_BUILT,
        )
            .into_response(),
        Ok(None) => ApiError::NotFound(format!("there is no {}", crate::names::clip(uri.path()))).into_response(),
        Err(error) => ApiError::Broken(format!("{name}: {error}")).into_response(),
    }
}

/// Is the page built into this program?
pub fn page_is_built() -> bool {
    is_there("index.html")
}

fn is_there(name: &str) -> bool {
    Dist::get(name).is_some() || Dist::get(&format!("{name}.br")).is_some()
}

/// Does a person ask, from a browser's address bar or a link?
fn wants_page(headers: &HeaderMap) -> bool {
    headers.get(header::ACCEPT).and_then(|v| v.to_str().ok()).is_some_and(|accepts| accepts.contains("text/html"))
}

struct Asset {
    content: Cow<'static, [u8]>,
    hash: [u8; 32],
    brotli: bool,
    varies: bool,
}

fn find(name: &str, brotli: bool) -> std::io::Result<Option<Asset>> {
    let packed = Dist::get(&format!("{name}.br"));
    let plain = Dist::get(name);
    let varies = packed.is_some();
    Ok(match (packed, plain) {
        (Some(packed), _) if brotli => {
            Some(Asset { content: packed.data, hash: packed.metadata.sha256_hash(), brotli: true, varies })
        }
        (_, Some(plain)) => {
            Some(Asset { content: plain.data, hash: plain.metadata.sha256_hash(), brotli: false, varies })
        }
        (Some(packed), None) => {
            let mut content = Vec::new();
            let unpacker = brotli_decompressor::Decompressor::new(packed.data.as_ref(), 4096);
            unpacker.take(MAX_UNPACKED).read_to_end(&mut content)?;
            Some(Asset { content: content.into(), hash: packed.metadata.sha256_hash(), brotli: false, varies })
        }
        (None, None) => None,
    })
}

fn respond(name: &str, asset: Asset, headers: &HeaderMap) -> Response {
    let hash: String = asset.hash.iter().take(12).map(|b| format!("{b:02x}")).collect();
    let etag = format!("\"{hash}{}\"", if asset.brotli { "-br" } else { "" });
    let mut answer = HeaderMap::new();
    let mut set = |key: header::HeaderName, value: &str| {
        if let Ok(value) = HeaderValue::from_str(value) {
            answer.insert(key, value);
        }
    };
    set(header::ETAG, &etag);
    set(header::CACHE_CONTROL, if hashed(name) { "public, max-age=31536000, immutable" } else { "no-cache" });
    if asset.varies {
        set(header::VARY, "accept-encoding");
    }
    let known = headers.get(header::IF_NONE_MATCH).and_then(|v| v.to_str().ok());
    if known.is_some_and(|known| known.split(',').any(|tag| tag.trim() == etag)) {
        return (StatusCode::NOT_MODIFIED, answer).into_response();
    }
    set(header::CONTENT_TYPE, mime(name));
    if asset.brotli {
        set(header::CONTENT_ENCODING, "br");
    }
    (StatusCode::OK, answer, Body::from(asset.content.into_owned())).into_response()
}

/// Does the name carry a hash of its content: `app-0123456789abcdef.js`, `app.01234567.wasm`,
/// `app-0123456789abcdef_bg.wasm`?
fn hashed(name: &str) -> bool {
    let file = name.rsplit('/').next().unwrap_or(name);
    let words = file.split(|c: char| !c.is_ascii_alphanumeric());
    words
        .into_iter()
        .any(|w| w.len() >= 8 && w.bytes().all(|b| b.is_ascii_hexdigit()) && w.bytes().any(|b| b.is_ascii_digit()))
}

fn accepts_brotli(headers: &HeaderMap) -> bool {
    headers.get_all(header::ACCEPT_ENCODING).iter().filter_map(|v| v.to_str().ok()).flat_map(|v| v.split(',')).any(
        |offer| {
            let mut parts = offer.split(';').map(str::trim);
            let name = parts.next().unwrap_or_default();
            let refused = parts.any(|p| p.strip_prefix("q=").is_some_and(|q| q.parse() == Ok(0.0)));
            name.eq_ignore_ascii_case("br") && !refused
        },
    )
}

fn mime(name: &str) -> &'static str {
    match name.rsplit('.').next().unwrap_or_default() {
        "html" => "text/html; charset=utf-8",
        "js" | "mjs" => "text/javascript; charset=utf-8",
        "wasm" => "application/wasm",
        "css" => "text/css; charset=utf-8",
        "svg" => "image/svg+xml",
        "png" => "image/png",
        "ico" => "image/x-icon",
        "woff2" => "font/woff2",
        "json" | "map" => "application/json",
        "webmanifest" => "application/manifest+json",
        "txt" => "text/plain; charset=utf-8",
        _ => "application/octet-stream",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hashes_in_names_are_recognised() {
        for yes in ["app-0123456789abcdef.js", "assets/app.0a1b2c3d.wasm", "app-0123456789abcdef_bg.wasm"] {
            assert!(hashed(yes), "{yes}");
        }
        for no in ["index.html", "plumbline_web.js", "style.css", "deadbeef.css"] {
            assert!(!hashed(no), "{no}");
        }
    }

    #[test]
    fn brotli_is_used_only_where_accepted() {
        let accepts = |value: &'static str| {
            accepts_brotli(&HeaderMap::from_iter([(header::ACCEPT_ENCODING, HeaderValue::from_static(value))]))
        };
        assert!(accepts("gzip, deflate, br"));
        assert!(accepts("br;q=0.5"));
        assert!(!accepts("gzip, br;q=0"));
        assert!(!accepts("gzip"));
        assert!(!accepts_brotli(&HeaderMap::new()));
    }
}
