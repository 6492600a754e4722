//! What the page's address keeps behind its path: a view survives a reload, and can be sent to somebody.

use leptos::prelude::window;

/// Every value that it has of a name.
pub fn all(name: &str) -> Vec<String> {
    let search = window().location().search().unwrap_or_default();
    let params = web_sys::UrlSearchParams::new_with_str(&search).ok();
    let values = params.map(|params| params.get_all(name)).unwrap_or_default();
    values.iter().filter_map(|value| value.as_string()).collect()
}

/// What is said of drawing, in any address: it stays.
const DRAWING: &str = "graphics=";

/// Writes this in place of what it has, without a page of its own in the history.
pub fn keep<N: AsRef<str>>(query: &[(N, String)]) {
    if let Ok(history) = window().history() {
        let address = with(query);
        // Refused where the browser has had too many: what is shown stays as it is.
        let _ = history.replace_state_with_url(&wasm_bindgen::JsValue::NULL, "", Some(&address));
    }
}

/// The address of this page with another query.
pub fn with<N: AsRef<str>>(query: &[(N, String)]) -> String {
    let location = window().location();
    let (path, search) = (location.pathname().unwrap_or_default(), location.search().unwrap_or_default());
    let drawing = search.trim_start_matches('?').split('&').filter(|part| part.starts_with(DRAWING)).map(str::to_owned);
    let part = |(name, text): &(N, String)| format!("{}={}", name.as_ref(), js_sys::encode_uri_component(text));
    let parts: Vec<_> = drawing.chain(query.iter().map(part)).collect();
    let mark = if parts.is_empty() { "" } else { "?" };
    format!("{path}{mark}{}", parts.join("&"))
}
