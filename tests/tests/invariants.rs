//! The invariants of ARCHITECTURE.md that manifests and source text can show.
//!
//! Source text is read without comments and without the `#[cfg(test)]` part that ends a file.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod source;

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::process::Command;

use serde_json::Value;
use source::{code, files, root, rust_files};

const MEMBERS: [&str; 5] = ["agent", "ground", "proto", "tests", "web"];

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

fn assert_nowhere(rooms: &[&str], words: &[&str], why: &str) {
    let found = found(rooms, words);
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
fn the_top_level_is_exactly_the_five_members_and_crates_nest_only_under_them() {
    let packages = packages();
    let folder_of = |package: &Value| {
        let manifest = Path::new(package["manifest_path"].as_str().unwrap());
        manifest.parent().unwrap().strip_prefix(root()).unwrap().display().to_string()
    };
    let mut found: BTreeSet<_> = packages.iter().map(|(name, package)| (name.clone(), folder_of(package))).collect();
    for member in MEMBERS {
        assert!(found.remove(&(format!("plumbline-{member}"), member.to_owned())), "{member}");
    }
    // A nested crate is named after its folder, below a member.
    for (name, folder) in found {
        let (member, nested) = folder.split_once('/').unwrap_or_default();
        assert!(MEMBERS.contains(&member) && name == format!("plumbline-{nested}"), "{name} lies in {folder}");
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
fn crates_know_only_those_below_them() {
    let packages = packages();
    let knows = |name: &str| own_dependencies(&packages[name]);
    let names = |names: &[&str]| names.iter().map(|name| format!("plumbline-{name}")).collect::<BTreeSet<_>>();
    assert_eq!(knows("plumbline-proto"), names(&[]), "the contract knows nobody");
    assert_eq!(knows("plumbline-core"), names(&["proto"]), "what computes knows the contract only");
    assert_eq!(knows("plumbline-link"), names(&["proto"]), "the radio knows no vehicle");
    assert_eq!(knows("plumbline-sim"), names(&["core", "proto"]));
    assert_eq!(knows("plumbline-devices"), names(&["core", "proto"]), "a driver knows no simulator and no radio");
    assert_eq!(
        knows("plumbline-hil"),
        names(&["core", "devices", "proto", "sim"]),
        "who flies the simulator knows no flight thread and no radio"
    );
    assert_eq!(
        knows("plumbline-wires"),
        names(&["core", "devices", "proto", "sim"]),
        "the wire rig meets the agent on its ports only"
    );
    assert_eq!(knows("plumbline-file"), names(&[]), "the format of a flight file knows no vehicle");
    assert_eq!(knows("plumbline-analysis"), names(&["core", "file", "proto", "rest"]), "no flight thread, no socket");
    assert_eq!(
        knows("plumbline-agent"),
        names(&["analysis", "core", "devices", "file", "hil", "link", "proto", "rest", "sim"])
    );
    assert_eq!(knows("plumbline-rest"), names(&[]), "the contract of the HTTP API knows nobody");
    assert_eq!(knows("plumbline-web"), names(&["proto", "raster", "rest"]), "the page speaks the contracts, and draws");
    assert_eq!(knows("plumbline-raster"), names(&[]), "triangles to pixels know no page");
    assert_eq!(knows("plumbline-worker"), names(&["raster"]), "the page's worker draws, and knows nothing else");
    assert_eq!(
        knows("plumbline-experiment"),
        names(&["agent", "file", "proto", "rest"]),
        "it flies the agent, and serves nobody"
    );
    let ground = names(&["analysis", "core", "experiment", "file", "link", "proto", "rest"]);
    assert_eq!(knows("plumbline-ground"), ground, "only experiments fly a vehicle");
}

#[test]
fn the_core_is_built_without_runtime_sockets_or_files() {
    let packages = packages();
    let core = packages["plumbline-core"]["dependencies"].as_array().unwrap().iter();
    let used: BTreeSet<&str> = core.map(|dependency| dependency["name"].as_str().unwrap()).collect();
    for outside in ["tokio", "quinn", "mcap", "rtrb", "libc", "tracing", "prost", "rustls"] {
        assert!(!used.contains(outside), "plumbline-core depends on {outside}");
    }
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

/// What computes: same input, same output, on any machine and in a replay.
const PURE: [&str; 1] = ["agent/core/src"];

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
    let rooms = ["agent/core/src/estimate", "agent/core/src/control", "agent/core/src/mix.rs"];
    let forbidden = ["attack::", "::attack", "sim::", "::sim", "Truth", "truth()"];
    assert_nowhere(&rooms, &forbidden, "estimate and control may not know");
}

#[test]
fn own_types_of_the_agent_are_no_wire_types() {
    let mut found = Vec::new();
    for file in rust_files(&["agent"]) {
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
    for folder in MEMBERS.into_iter().chain([
        "agent/analysis",
        "agent/core",
        "agent/devices",
        "agent/hil",
        "agent/link",
        "agent/sim",
        "ground/experiment",
        "agent/wires",
        "proto/file",
        "proto/rest",
    ]) {
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
        for file in rust_files(&[
            "agent/src",
            "agent/analysis/src",
            "agent/core/src",
            "agent/devices/src",
            "agent/hil/src",
            "agent/link/src",
            "agent/sim/src",
            "agent/wires/src",
            "ground/src",
            "ground/experiment/src",
            "proto/src",
            "proto/file/src",
            "proto/rest/src",
            "web/src",
            "tests/src",
        ]) {
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

/// The glossary of ARCHITECTURE.md says what to write instead: faulty or attacked, healthy, excluded, isolated, baseline,
/// consensus.
#[test]
fn private_words_for_faults_stay_out() {
    // Beginnings of words, in halves, so that this file does not hold what it looks for.
    let halves = [
        ("li", "ar"),
        ("ly", "ing"),
        ("be", "liev"),
        ("acc", "us"),
        ("bal", "lot"),
        ("hon", "est"),
        ("bl", "am"),
        ("inno", "cent"),
    ];
    let begins: Vec<String> = halves.iter().map(|(a, b)| format!("{a}{b}")).collect();
    let text = ["rs", "md", "proto", "toml", "wgsl", "css", "ts", "mjs"];
    let mut found = Vec::new();
    for file in files() {
        let prose = file.extension().is_some_and(|e| text.iter().any(|known| e == *known));
        // What was released said so in its own words.
        if !prose || file.ends_with("CHANGELOG.md") {
            continue;
        }
        let Ok(text) = std::fs::read_to_string(root().join(&file)) else { continue };
        for (index, line) in text.lines().enumerate() {
            let words = line.split(|c: char| !c.is_alphabetic()).map(str::to_lowercase);
            for word in words.filter(|word| begins.iter().any(|begin| word.starts_with(begin.as_str()))) {
                found.push(format!("{}:{}: {word}", file.display(), index + 1));
            }
        }
    }
    assert!(found.is_empty(), "{}", found.join("\n"));
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
