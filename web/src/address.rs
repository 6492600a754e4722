//! What the page's address keeps behind its path: a view survives a reload, and can be sent to somebody.

use leptos::prelude::window;

/// Every value that it has of a name.
pub fn all(name: &str) -> Vec<String> {
    let search = window().location().search().unwrap_or_default();
    let params = web_sys::UrlSearchParams::new_with_str(&search).ok();
    let values = params.map(|params| params.get_all(name)).unwrap_or_default();
    values.iter().filter_map(|value| value.as_string()).collect()
}

/// Writes this in place of what it has, without a page of its own in the history.
pub fn keep(query: &[(&str, String)]) {
    let path = window().location().pathname().unwrap_or_default();
    let part = |(name, text): &(&str, String)| format!("{name}={}", js_sys::encode_uri_component(text));
    let parts: Vec<_> = query.iter().map(part).collect();
    let mark = if parts.is_empty() { "" } else { "?" };
    if let Ok(history) = window().history() {
        let address = format!("{path}{mark}{}", parts.join("&"));
        // Refused where the browser has had too many: what is shown stays as it is.
        let _ = history.replace_state_with_url(&wasm_bindgen::JsValue::NULL, "", Some(&address));
    }
}
