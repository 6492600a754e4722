//! What the browser keeps for the page: choices, never truth. All of it may be missing.

use leptos::prelude::window;

fn key(name: &str) -> String {
    format!("plumbline.{name}")
}

/// A choice made before.
pub fn get(name: &str) -> Option<String> {
    window().local_storage().ok().flatten()?.get_item(&key(name)).ok().flatten()
}

/// Keeps a choice.
pub fn set(name: &str, value: &str) {
    if let Ok(Some(storage)) = window().local_storage() {
        // A full or forbidden storage costs the choice, nothing else.
        let _ = storage.set_item(&key(name), value);
    }
}

/// This page's name towards the ground: lives as long as the browser tab, survives a reload.
pub fn operator() -> String {
    let storage = window().session_storage().ok().flatten();
    let kept = storage.as_ref().and_then(|s| s.get_item(&key("operator")).ok().flatten());
    kept.unwrap_or_else(|| {
        let fresh = format!("page-{:08x}", (js_sys::Math::random() * 4_294_967_296.0) as u32);
        if let Some(storage) = storage {
            let _ = storage.set_item(&key("operator"), &fresh);
        }
        fresh
    })
}

/// Dark page: as chosen, else as the system prefers.
pub fn dark() -> bool {
    match get("theme").as_deref() {
        Some("dark") => true,
        Some("light") => false,
        _ => window().match_media("(prefers-color-scheme: dark)").ok().flatten().is_some_and(|m| m.matches()),
    }
}
