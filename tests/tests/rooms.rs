//! The order of the agent's rooms, as ARCHITECTURE.md gives it, against the source text; and the picture of them.
//!
//! Source text is read without comments and without the `#[cfg(test)]` part that ends a file. `cargo xtask bless`
//! redraws the picture.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod source;

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write as _;
use std::path::Path;

use source::{code, root, rust_files};

/// Crates and their rooms, the lowest first: each room may use those before it, and no other. A crate without rooms
/// is one itself.
const CRATES: [(&str, &str, &[&str]); 7] = [
    (
        "plumbline-core",
        "agent/core/src",
        &[
            "types",
            "event",
            "frames",
            "linalg",
            "model",
            "sensor",
            "calibration",
            "attack",
            "estimate",
            "control",
            "mix",
            "supervisor",
            "command",
            "flight",
            "vehicle",
        ],
    ),
    ("plumbline-devices", "agent/devices/src", &[]),
    ("plumbline-sim", "agent/sim/src", &[]),
    ("plumbline-hil", "agent/hil/src", &[]),
    ("plumbline-link", "agent/link/src", &[]),
    ("plumbline-analysis", "agent/analysis/src", &["recordings", "design", "envelope", "offline"]),
    ("plumbline-agent", "agent/src", &["link", "log", "telemetry", "config", "runner", "cli"]),
];
const PICTURE: &str = "docs/rooms.svg";

/// A room: its crate, and its name there (empty where the crate is one room).
type Room = (&'static str, &'static str);

/// Every room, the lowest first.
fn order() -> Vec<Room> {
    let rooms = |(name, _, rooms): &(&'static str, &'static str, &'static [&'static str])| -> Vec<Room> {
        if rooms.is_empty() { vec![(*name, "")] } else { rooms.iter().map(|room| (*name, *room)).collect() }
    };
    CRATES.iter().flat_map(rooms).collect()
}

/// The identifier at the start of `text`.
fn identifier(text: &str) -> &str {
    text.split(|c: char| !c.is_alphanumeric() && c != '_').next().unwrap_or_default()
}

/// The first names of every path in `{a::b, c::{d, e}}`, or of the one path there is.
fn heads(text: &str) -> Vec<&str> {
    let Some(group) = text.strip_prefix('{') else { return vec![identifier(text)] };
    let (mut depth, mut begin, mut heads) = (0, 0, Vec::new());
    for (at, c) in group.char_indices() {
        match c {
            '{' => depth += 1,
            '}' if depth > 0 => depth -= 1,
            ',' | '}' if depth == 0 => {
                heads.push(identifier(group[begin..at].trim_start()));
                begin = at + 1;
                if c == '}' {
                    break;
                }
            }
            _ => {}
        }
    }
    heads
}

/// The rooms that `file` of the crate `own` names, `depth` modules below the crate's root.
fn named(own: &'static str, depth: usize, file: &Path) -> BTreeSet<Room> {
    let text: String = code(file).into_iter().map(|(_, line)| line + "\n").collect();
    let mut found = BTreeSet::new();
    let mut add = |name: &'static str, head: &str| {
        // The agent re-exports the rooms of the core and of the analysis, and the simulator.
        let known = order().into_iter().rev().find(|(of, room)| {
            let exported = ["plumbline-core", "plumbline-analysis"].contains(of);
            let here = *of == name || (name == "plumbline-agent" && exported);
            here && (*room == head || room.is_empty())
        });
        let simulator = (name == "plumbline-agent" && head == "sim").then_some(("plumbline-sim", ""));
        found.extend(simulator.or(known));
    };
    for (name, _, _) in CRATES {
        for (at, word) in text.match_indices(&name.replace('-', "_")) {
            let after = &text[at + word.len()..];
            heads(after.strip_prefix("::").unwrap_or_default()).iter().for_each(|head| add(name, head));
        }
    }
    let to_root = "super::".repeat(depth);
    for word in ["crate::", &to_root] {
        for (at, _) in text.match_indices(word) {
            let longer = text[..at].ends_with("super::") || text[at + word.len()..].starts_with("super::");
            if !longer {
                heads(&text[at + word.len()..]).iter().for_each(|head| add(own, head));
            }
        }
    }
    found
}

/// Which rooms each room uses, and the file that says so.
fn uses() -> BTreeMap<(Room, Room), String> {
    let mut uses = BTreeMap::new();
    for (name, folder, rooms) in CRATES {
        for file in rust_files(&[folder]) {
            let inside = file.strip_prefix(folder).unwrap();
            let parts: Vec<_> = inside.iter().map(|part| part.to_str().unwrap()).collect();
            let first = parts[0].trim_end_matches(".rs");
            if matches!(first, "lib" | "main") && !rooms.is_empty() {
                continue;
            }
            let room = rooms.iter().find(|room| **room == first);
            let from = match room {
                Some(room) => (name, *room),
                None => {
                    assert!(rooms.is_empty(), "{} lies in no room of {name}", file.display());
                    (name, "")
                }
            };
            let depth = parts.len() - usize::from(parts.last() == Some(&"mod.rs"));
            for to in named(name, depth, &file).into_iter().filter(|to| *to != from) {
                uses.entry((from, to)).or_insert_with(|| file.display().to_string());
            }
        }
    }
    uses
}

#[test]
fn each_room_uses_only_those_below_it() {
    let order = order();
    let rank = |room: &Room| order.iter().position(|other| other == room).unwrap();
    let uses = uses();
    assert!(uses.len() > 60, "the rooms have moved: {} uses found", uses.len());
    let wrong: Vec<_> = uses.iter().filter(|((from, to), _)| rank(to) > rank(from)).collect();
    assert!(wrong.is_empty(), "a room uses one above it: {wrong:#?}");
}

#[test]
fn the_architecture_gives_the_same_order() {
    let text = std::fs::read_to_string(root().join("ARCHITECTURE.md")).unwrap();
    for (name, folder, rooms) in CRATES {
        let rooms: Vec<_> = rooms.iter().map(|room| format!("`{room}`")).collect();
        let rooms = if rooms.is_empty() { "one room".to_owned() } else { rooms.join(", ") };
        let line = format!("| `{name}` (`{}`) | {rooms} |", folder.trim_end_matches("/src"));
        assert!(text.lines().any(|written| written == line), "ARCHITECTURE.md lacks the line\n{line}");
    }
}

#[test]
fn the_picture_of_the_rooms_is_the_real_one() {
    let (file, drawn) = (root().join(PICTURE), picture());
    if std::env::var_os("PLUMBLINE_BLESS").is_some() {
        std::fs::write(&file, &drawn).unwrap();
    }
    let committed = std::fs::read_to_string(&file).unwrap_or_default();
    assert!(committed == drawn, "{PICTURE} is not what the modules are; `cargo xtask bless` redraws it");
}

/// Rooms in their order, the lowest at the foot; an arc leads from each room down to one that it uses.
fn picture() -> String {
    const ROW: usize = 30;
    const LEFT: usize = 350;
    const WIDTH: usize = 260;
    let mut order = order();
    order.reverse();
    let y = |room: &Room| 40 + ROW * order.iter().position(|other| other == room).unwrap();
    let colour = |name: &str| match name {
        "plumbline-core" => "#2f6f4f",
        "plumbline-sim" => "#8a5a00",
        "plumbline-devices" => "#6b6b00",
        "plumbline-hil" => "#00696b",
        "plumbline-link" => "#5b3f8c",
        "plumbline-analysis" => "#8c2f39",
        _ => "#1f5f8b",
    };
    let height = 40 + ROW * order.len();
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {} {height}\" font-family=\"sans-serif\" \
         font-size=\"13\">\n<title>Rooms of the agent: each uses only rooms below it</title>\n\
         <rect width=\"100%\" height=\"100%\" fill=\"#ffffff\"/>\n",
        LEFT + WIDTH
    );
    for (from, to) in uses().keys() {
        let (a, b) = (y(from), y(to));
        let reach = LEFT - 20 - a.abs_diff(b) * 3 / 8;
        writeln!(
            svg,
            "<path d=\"M{LEFT} {a}C{reach} {a} {reach} {b} {LEFT} {b}\" fill=\"none\" stroke=\"{}\" \
             stroke-opacity=\"0.45\"/>",
            colour(from.0)
        )
        .unwrap();
    }
    for room in &order {
        let (top, middle, text) = (y(room) - 11, y(room) + 4, LEFT + 10);
        let label = if room.1.is_empty() { room.0.to_owned() } else { format!("{} · {}", room.1, room.0) };
        writeln!(
            svg,
            "<rect x=\"{LEFT}\" y=\"{top}\" width=\"{}\" height=\"22\" rx=\"4\" fill=\"{}\"/>\
             <text x=\"{text}\" y=\"{middle}\" fill=\"#ffffff\">{label}</text>",
            WIDTH - 20,
            colour(room.0)
        )
        .unwrap();
    }
    svg + "</svg>\n"
}
