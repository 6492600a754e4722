//! The invariants of ARCHITECTURE.md that manifests and source text can show.
//!
//! Source text is read without comments and without the `#[cfg(test)]` part that ends a file.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::process::Command;

use serde_json::Value;

const MEMBERS: [&str; 5] = ["agent", "ground", "proto", "tests", "web"];

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap().to_path_buf()
}

/// What cargo knows of the workspace's own packages, by name.
fn packages() -> BTreeMap<String, Value> {
    let cargo = std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into());
    let metadata = Command::new(cargo)
        .args(["metadata", "--no-deps", "--format-version", "1", "--locked", "--offline"])
        .current_dir(root())
        .output()
        .unwrap();
    assert!(metadata.status.success(), "{}", String::from_utf8_lossy(&metadata.stderr));
    let metadata: Value = serde_json::from_slice(&metadata.stdout).unwrap();
    let packages = metadata["packages"].as_array().unwrap().iter();
    packages.map(|package| (package["name"].as_str().unwrap().to_owned(), package.clone())).collect()
}

/// Files that git tracks or would track, relative to the root.
fn files() -> Vec<PathBuf> {
    let listed = Command::new("git")
        .args(["ls-files", "-z", "--cached", "--others", "--exclude-standard"])
        .current_dir(root())
        .output()
        .expect("git lists the tree");
    assert!(listed.status.success(), "{}", String::from_utf8_lossy(&listed.stderr));
    let names = String::from_utf8(listed.stdout).unwrap();
    let files: BTreeSet<_> = names.split('\0').filter(|name| !name.is_empty()).map(PathBuf::from).collect();
    files.into_iter().filter(|file| root().join(file).is_file()).collect()
}

/// Rust files under any of these files or folders, relative to the root.
fn rust_files(under: &[&str]) -> Vec<PathBuf> {
    let inside = |file: &PathBuf| under.iter().any(|place| file.starts_with(place));
    let test = |file: &PathBuf| file.file_name().is_some_and(|name| name == "tests.rs");
    let rust = |file: &PathBuf| file.extension().is_some_and(|extension| extension == "rs");
    files().into_iter().filter(rust).filter(inside).filter(|file| !test(file)).collect()
}

/// Lines of product code with their numbers: comments, and everything from a `#[cfg(test)] mod … {` on, left out.
fn code(file: &Path) -> Vec<(usize, String)> {
    let text = std::fs::read_to_string(root().join(file)).unwrap();
    let mut lines = Vec::new();
    let mut testing = false;
    for (index, line) in text.lines().enumerate() {
        if line.trim() == "#[cfg(test)]" {
            testing = true;
        } else if testing && line.contains("mod ") && line.ends_with('{') {
            break;
        } else {
            testing = false;
        }
        let code = line.split("//").next().unwrap_or_default();
        lines.push((index + 1, code.to_owned()));
    }
    lines
}

/// Every place under `rooms` whose code holds one of the `words`.
fn found(rooms: &[&str], words: &[&str]) -> Vec<String> {
    let mut found = Vec::new();
    for file in rust_files(rooms) {
        for (number, line) in code(&file) {
            for word in words.iter().filter(|word| line.contains(**word)) {
                found.push(format!("{}:{number}: `{word}` in `{}`", file.display(), line.trim()));
            }
        }
    }
    found
}

/// Places that may, each with its reason.
const EXCEPTIONS: [(&str, &str); 1] = [
    // Solves problems from files for the comparison with the references; no part of a flight.
    ("agent/src/estimate/secure/offline.rs", ""),
];

fn assert_nowhere(rooms: &[&str], words: &[&str], why: &str) {
    let excused =
        |place: &String| EXCEPTIONS.iter().any(|(file, word)| place.starts_with(file) && place.contains(word));
    let found: Vec<_> = found(rooms, words).into_iter().filter(|place| !excused(place)).collect();
    assert!(found.is_empty(), "{why}:\n{}", found.join("\n"));
}

/// The workspace's own packages that `package` builds with (not its tests').
fn own_dependencies(package: &Value) -> BTreeSet<String> {
    let dependencies = package["dependencies"].as_array().unwrap().iter();
    dependencies
        .filter(|dependency| dependency["kind"] != "dev")
        .map(|dependency| dependency["name"].as_str().unwrap().to_owned())
        .filter(|name| name.starts_with("plumbline-"))
        .collect()
}

#[test]
fn the_members_are_exactly_the_five_rooms() {
    let packages = packages();
    let folders: BTreeSet<String> = packages
        .values()
        .map(|package| Path::new(package["manifest_path"].as_str().unwrap()).parent().unwrap().to_path_buf())
        .map(|folder| folder.strip_prefix(root()).unwrap().display().to_string())
        .collect();
    assert_eq!(folders, BTreeSet::from(MEMBERS.map(str::to_owned)));
    for folder in MEMBERS {
        assert!(packages.contains_key(&format!("plumbline-{folder}")), "{folder}");
    }
    let top: BTreeSet<String> = files()
        .iter()
        .filter(|file| file.components().count() > 1)
        .map(|file| file.components().next().unwrap().as_os_str().to_string_lossy().into_owned())
        .filter(|folder| !folder.starts_with('.') && folder != "docs")
        .collect();
    assert_eq!(top, BTreeSet::from(MEMBERS.map(str::to_owned)), "a folder beside the members");
}

#[test]
fn members_know_only_those_below_them() {
    let packages = packages();
    let knows = |name: &str| own_dependencies(&packages[name]);
    let names = |names: &[&str]| names.iter().map(|name| (*name).to_owned()).collect::<BTreeSet<_>>();
    assert_eq!(knows("plumbline-proto"), names(&[]), "the contract knows nobody");
    assert_eq!(knows("plumbline-agent"), names(&["plumbline-proto"]));
    assert_eq!(knows("plumbline-web"), names(&["plumbline-proto"]), "the page speaks the contract only");
    assert_eq!(knows("plumbline-ground"), names(&["plumbline-agent", "plumbline-proto"]));
}

#[test]
fn the_required_packages_are_in_use() {
    let packages = packages();
    let used: BTreeSet<&str> = packages
        .values()
        .flat_map(|package| package["dependencies"].as_array().unwrap())
        .map(|dependency| dependency["name"].as_str().unwrap())
        .collect();
    for required in ["axum", "tokio", "wgpu", "nalgebra", "serde_json"] {
        assert!(used.contains(required), "{required} is not used");
    }
}

/// Rooms that compute: same input, same output, on any machine and in a replay.
const PURE: [&str; 9] = [
    "agent/src/flight.rs",
    "agent/src/flight",
    "agent/src/model",
    "agent/src/linalg",
    "agent/src/calibration",
    "agent/src/attack",
    "agent/src/estimate",
    "agent/src/control",
    "agent/src/mix.rs",
];

#[test]
fn what_computes_has_no_runtime_socket_clock_file_or_global_random_state() {
    let forbidden = [
        "tokio",
        "quinn",
        "std::net",
        "std::fs",
        "std::io::",
        "std::env",
        "std::thread",
        "Instant",
        "SystemTime",
        "rand::rng()",
        "thread_rng",
        "rand::random",
        "from_os_rng",
        "SysRng",
        "OsRng",
        "thread_local!",
        "static mut",
        "LazyLock",
        "OnceLock",
        "tracing::",
        "println!",
    ];
    assert!(rust_files(&PURE).len() > 10, "the rooms have moved: {:?}", rust_files(&PURE));
    assert_nowhere(&PURE, &forbidden, "a pure room reaches outside");
}

#[test]
fn downstream_of_the_attack_nobody_knows_of_it_or_sees_truth() {
    let rooms = ["agent/src/estimate", "agent/src/control", "agent/src/mix.rs"];
    let forbidden = ["attack::", "::attack", "sim::", "::sim", "Truth", "truth()"];
    assert_nowhere(&rooms, &forbidden, "estimate and control may not know");
}

#[test]
fn own_types_of_the_agent_are_no_wire_types() {
    let mut found = Vec::new();
    for file in rust_files(&["agent/src"]) {
        for (number, line) in code(&file) {
            let words: Vec<_> = line.split(|c: char| !c.is_alphanumeric()).collect();
            if line.contains("derive(") && (words.contains(&"Serialize") || words.contains(&"Message")) {
                found.push(format!("{}:{number}: {}", file.display(), line.trim()));
            }
        }
    }
    assert!(found.is_empty(), "telemetry.rs converts, types do not derive it:\n{}", found.join("\n"));
}

#[test]
fn the_lints_against_panics_stay_on_in_library_code() {
    for folder in MEMBERS {
        let manifest = std::fs::read_to_string(root().join(folder).join("Cargo.toml")).unwrap();
        assert!(
            manifest.contains("[lints]\nworkspace = true"),
            "{folder}/Cargo.toml does not take the workspace's lints"
        );
    }
    let manifest = std::fs::read_to_string(root().join("Cargo.toml")).unwrap();
    for lint in ["unwrap_used", "expect_used", "panic"] {
        assert!(manifest.contains(&format!("{lint} = \"deny\"")), "{lint} is not denied");
        let mut off = Vec::new();
        for file in rust_files(&["agent/src", "ground/src", "proto/src", "web/src", "tests/src"]) {
            for (number, line) in code(&file) {
                let allows = line.contains("allow(") && line.contains(&format!("clippy::{lint}"));
                let in_tests = line.contains("cfg_attr(test,") || line.contains("cfg_attr(\n    test,");
                if allows && !in_tests {
                    off.push(format!("{}:{number}: {}", file.display(), line.trim()));
                }
            }
        }
        assert!(off.is_empty(), "{lint} is allowed outside tests:\n{}", off.join("\n"));
    }
}

#[test]
fn the_tree_names_no_machine_and_no_registry() {
    // Written in halves, so that this file does not hold what it looks for.
    let halves = [
        ("/ro", "ot/"),
        ("/ho", "me/"),
        ("/wo", "rk/"),
        ("/Use", "rs/"),
        ("index.crates", ".io"),
        ("static.crates", ".io"),
        ("registry.npmjs", ".org"),
        ("pypi", ".org"),
        ("deb.debian", ".org"),
        ("replace", "-with"),
    ];
    let forbidden: Vec<String> = halves.iter().map(|(a, b)| format!("{a}{b}")).collect();
    let mut found = Vec::new();
    for file in files() {
        let Ok(text) = std::fs::read_to_string(root().join(&file)) else { continue };
        for (index, line) in text.lines().enumerate() {
            for word in forbidden.iter().filter(|word| line.contains(word.as_str())) {
                found.push(format!("{}:{}: {word}", file.display(), index + 1));
            }
        }
    }
    assert!(found.is_empty(), "{}", found.join("\n"));
    let lock = std::fs::read_to_string(root().join("Cargo.lock")).unwrap();
    let sources: BTreeSet<&str> = lock.lines().filter(|line| line.starts_with("source = ")).collect();
    assert!(sources.len() <= 1, "Cargo.lock has more than one source: {sources:?}");
}

#[test]
fn no_toolchain_file_asks_for_what_a_machine_may_lack() {
    for name in ["rust-toolchain.toml", "rust-toolchain"] {
        if let Ok(text) = std::fs::read_to_string(root().join(name)) {
            assert!(!text.contains("targets"), "{name} lists targets: rustup would fetch them before cargo starts");
            assert!(!text.contains("channel"), "{name} pins a channel");
        }
    }
}

#[test]
fn ground_and_page_hold_no_copy_of_the_agents_mathematics() {
    let words = ["fn riccati", "fn dare", "fn care", "fn lqr", "struct Ekf", "fn rk4"];
    assert_nowhere(&["ground/src", "web/src"], &words, "one implementation, in the agent's library");
}
