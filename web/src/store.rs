//! What the browser keeps for the page: choices, never truth. All of it may be missing.

use leptos::prelude::window;

use crate::{
    model::{
        by_hand::Led,
        curves::Group,
        draft::{Draft, Row},
        guide::Guide,
        layout::{self, Layout, Saved},
        operator,
    },
    net::Early,
};

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

/// Groups of curves that legends unfold: as left, else none.
pub fn unfolded() -> Vec<Group> {
    get("unfolded").map_or_else(|| Layout::default().unfolded, |names| layout::groups_of(&names))
}

/// Keeps them.
pub fn keep_unfolded(groups: &[Group]) {
    set("unfolded", &layout::group_names(groups));
}

/// Layouts kept under names.
pub fn layouts() -> Vec<Saved> {
    get("layouts").and_then(|text| serde_json::from_str(&text).ok()).unwrap_or_default()
}

/// Keeps them.
pub fn keep_layouts(all: &[Saved]) {
    set("layouts", &serde_json::to_string(all).unwrap_or_default());
}

/// This page's name towards the ground: the operator's, and what tells this tab from others. `early.js` chose it; it
/// lives as long as the tab and survives a reload.
pub fn operator() -> String {
    session().and_then(|s| s.get_item(&key("operator")).ok().flatten()).or_else(Early::operator).unwrap_or_default()
}

/// Another name for the operator; answers this page's.
pub fn rename(name: &str) -> String {
    let name = operator::cleaned(name);
    let operator = operator::renamed(&operator(), &name);
    set("name", &name);
    if let Some(storage) = session() {
        // A forbidden storage costs the name after a reload, nothing else.
        let _ = storage.set_item(&key("operator"), &operator);
    }
    operator
}

/// How far the first flight had come; `None` where it was left, or never begun.
pub fn guide() -> Option<Guide> {
    get("guide")?.parse().ok().map(Guide::at)
}

/// Keeps its step.
pub fn keep_guide(at: Option<usize>) {
    set("guide", &at.map_or_else(String::new, |at| at.to_string()));
}

/// The flight by hand that somebody is led through.
pub fn led() -> Option<Led> {
    serde_json::from_str(&get("led")?).ok()
}

/// Keeps it.
pub fn keep_led(led: &Option<Led>) {
    set("led", &led.as_ref().and_then(|led| serde_json::to_string(led).ok()).unwrap_or_default());
}

/// The attacks that were being written.
pub fn drafts() -> Vec<Draft> {
    let text = session().and_then(|s| s.get_item(&key("drafts")).ok().flatten()).unwrap_or_default();
    let rows: Vec<Row> = serde_json::from_str(&text).unwrap_or_default();
    rows.into_iter().filter_map(Draft::from_row).collect()
}

/// Keeps them over a reload.
pub fn keep_drafts(drafts: &[Draft]) {
    let rows: Vec<Row> = drafts.iter().map(Draft::row).collect();
    if let (Some(storage), Ok(text)) = (session(), serde_json::to_string(&rows)) {
        // A full or forbidden storage costs the drafts of a reload, nothing else.
        let _ = storage.set_item(&key("drafts"), &text);
    }
}

fn session() -> Option<web_sys::Storage> {
    window().session_storage().ok().flatten()
}

/// Dark page: as chosen, else as the system prefers.
pub fn dark() -> bool {
    match get("theme").as_deref() {
        Some("dark") => true,
        Some("light") => false,
        _ => window().match_media("(prefers-color-scheme: dark)").ok().flatten().is_some_and(|m| m.matches()),
    }
}
