//! What others wrote and we ship: its licences, where it comes from, and what is there twice.
//!
//! Read from `cargo metadata` without a network, for the platform that the tests run on, and from `Cargo.lock` for all.
//! Whether a version was yanked, or an advisory stands against it, only an online database tells (`cargo deny`).
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod source;

use std::collections::{BTreeMap, BTreeSet};
use std::process::Command;

use serde_json::Value;
use source::root;

/// Licences that ask for no more than their text beside the programs.
const LICENCES: [&str; 11] = [
    "0BSD",
    "Apache-2.0",
    "BSD-2-Clause",
    "BSD-3-Clause",
    "BSL-1.0",
    "CC0-1.0",
    "ISC",
    "MIT",
    "Unicode-3.0",
    "Unlicense",
    "Zlib",
];

/// What is there in more than one incompatible version, and whose doing it is: none is ours to mend, and each goes from
/// here as soon as it is gone.
const TWICE: [(&str, &[&str]); 11] = [
    (
        "RustCrypto changes generations: argon2, spake2 and axum are of the old one",
        &["block-buffer", "cpufeatures", "crypto-common", "digest", "hmac", "sha1", "sha2"],
    ),
    ("random numbers: argon2, spake2 and tungstenite 0.29 are behind", &["getrandom", "rand", "rand_core"]),
    ("axum holds tungstenite back", &["tokio-tungstenite", "tungstenite"]),
    ("nalgebra knows every version of glam", &["glam"]),
    (
        "clarabel is behind",
        &["darling", "darling_core", "darling_macro", "itertools", "strsim", "thiserror", "thiserror-impl"],
    ),
    ("procedural macros change syn, at build time only", &["syn", "synstructure"]),
    ("hash maps inside others", &["foldhash", "hashbrown", "rustc-hash"]),
    ("leptos and its configuration", &["convert_case"]),
    ("pem, beside everybody else", &["base64"]),
    ("prost-build and leptos, at build time only", &["prettyplease"]),
    ("error messages of protox and naga", &["unicode-width"]),
];

/// Packages that are compiled for this platform.
fn packages() -> Vec<Value> {
    let version = Command::new("rustc").arg("-vV").output().unwrap();
    let version = String::from_utf8(version.stdout).unwrap();
    let host = version.lines().find_map(|line| line.strip_prefix("host: ")).unwrap();
    let cargo = std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into());
    let metadata = Command::new(cargo)
        .args(["metadata", "--format-version", "1", "--locked", "--offline", "--filter-platform", host])
        .current_dir(root())
        .output()
        .unwrap();
    assert!(metadata.status.success(), "{}", String::from_utf8_lossy(&metadata.stderr));
    let metadata: Value = serde_json::from_slice(&metadata.stdout).unwrap();
    let nodes = metadata["resolve"]["nodes"].as_array().unwrap();
    let used: BTreeSet<&str> = nodes.iter().map(|node| node["id"].as_str().unwrap()).collect();
    let all = metadata["packages"].as_array().unwrap().iter();
    all.filter(|package| used.contains(package["id"].as_str().unwrap())).cloned().collect()
}

fn name(package: &Value) -> String {
    format!("{} {}", package["name"].as_str().unwrap(), package["version"].as_str().unwrap())
}

/// Is an SPDX expression satisfied by the licences allowed? The old `A/B` means `A OR B`.
fn allowed(expression: &str) -> bool {
    let spaced = expression.replace('/', " OR ").replace('(', " ( ").replace(')', " ) ");
    let words: Vec<&str> = spaced.split_whitespace().collect();
    let mut at = 0;
    let holds = either(&words, &mut at);
    holds && at == words.len()
}

fn either(words: &[&str], at: &mut usize) -> bool {
    let mut holds = both(words, at);
    while words.get(*at) == Some(&"OR") {
        *at += 1;
        holds |= both(words, at);
    }
    holds
}

fn both(words: &[&str], at: &mut usize) -> bool {
    let mut holds = one(words, at);
    while words.get(*at) == Some(&"AND") {
        *at += 1;
        holds &= one(words, at);
    }
    holds
}

fn one(words: &[&str], at: &mut usize) -> bool {
    let Some(word) = words.get(*at) else { return false };
    *at += 1;
    if *word == "(" {
        let holds = either(words, at);
        *at += 1;
        return holds;
    }
    // An exception only allows more.
    if words.get(*at) == Some(&"WITH") {
        *at += 2;
    }
    LICENCES.contains(word)
}

#[test]
fn expressions_are_read_as_spdx_does() {
    for fine in ["MIT", "MIT/GPL-3.0", "(MIT OR Apache-2.0) AND Unicode-3.0", "Apache-2.0 WITH LLVM-exception"] {
        assert!(allowed(fine), "{fine}");
    }
    for not in ["GPL-3.0", "MIT AND GPL-3.0", "(MIT AND AGPL-3.0) OR GPL-2.0", "", "MIT MIT"] {
        assert!(!allowed(not), "{not}");
    }
}

#[test]
fn every_licence_is_one_of_those_allowed() {
    let licence = |package: &Value| package["license"].as_str().unwrap_or_default().to_owned();
    let others: Vec<_> = packages().iter().filter(|p| !allowed(&licence(p))).map(|p| (name(p), licence(p))).collect();
    assert!(others.is_empty(), "not among {LICENCES:?}: {others:#?}");
}

#[test]
fn everything_comes_from_the_registry_or_is_ours() {
    let lock = std::fs::read_to_string(root().join("Cargo.lock")).unwrap();
    let entries: Vec<_> = lock.split("[[package]]").skip(1).collect();
    assert!(entries.len() > 300, "{} entries", entries.len());
    for entry in entries {
        let field =
            |key: &str| entry.lines().find_map(|line| line.strip_prefix(&format!("{key} = "))).unwrap_or_default();
        let (name, source) = (field("name").trim_matches('"'), field("source").trim_matches('"'));
        if source.is_empty() {
            assert!(name.starts_with("plumbline-"), "{name} comes from a path");
        } else {
            assert!(source.starts_with("registry+"), "{name} comes from {source}");
            assert!(!field("checksum").is_empty(), "{name} has no checksum");
        }
    }
}

#[test]
fn nothing_is_there_twice_without_a_reason() {
    // Cargo's idea of compatible: the first number that is not zero.
    let line = |version: &str| {
        let mut numbers = version.split(['.', '-', '+']);
        let first = numbers.next().unwrap().to_owned();
        if first == "0" { format!("0.{}", numbers.next().unwrap()) } else { first }
    };
    let mut lines: BTreeMap<String, BTreeSet<String>> = BTreeMap::new();
    for package in packages() {
        let version = line(package["version"].as_str().unwrap());
        lines.entry(package["name"].as_str().unwrap().to_owned()).or_default().insert(version);
    }
    let twice: BTreeMap<_, _> = lines.into_iter().filter(|(_, lines)| lines.len() > 1).collect();
    let known: BTreeSet<&str> = TWICE.iter().flat_map(|(_, names)| names.iter().copied()).collect();
    let new: Vec<_> = twice.iter().filter(|(name, _)| !known.contains(name.as_str())).collect();
    assert!(new.is_empty(), "in several versions, and no reason is given: {new:?}");
    let gone: Vec<_> = known.iter().filter(|name| !twice.contains_key(**name)).collect();
    assert!(gone.is_empty(), "no longer there twice: {gone:?}");
}
