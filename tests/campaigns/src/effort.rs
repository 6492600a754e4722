//! What is asked of a campaign of drawn flights: `--flights N`, `--seed-base N`, `--world NAME`, `--only NAME`,
//! `--quick`.

use std::collections::BTreeSet;
use std::sync::Mutex;

/// Options with a value, and one without.
const OPTIONS: [&str; 4] = ["--flights", "--seed-base", "--world", "--only"];
const QUICK: &str = "--quick";

pub struct Effort {
    pub flights: u64,
    pub seed_base: u64,
    /// The world to fly in, where it is for the asker to choose.
    pub world: String,
    only: Option<String>,
    /// Parts that were asked about.
    parts: Mutex<BTreeSet<String>>,
}

impl Effort {
    /// As the arguments say; else so many flights, and so many with `--quick`, from seed 1000.
    pub fn asked(flights: [u64; 2]) -> Self {
        Self::asked_from(flights, 1_000)
    }

    /// The same from another seed.
    pub fn asked_from([flights, quick]: [u64; 2], seed: u64) -> Self {
        let arguments: Vec<String> = std::env::args().skip(2).collect();
        let mut rest = arguments.iter();
        while let Some(argument) = rest.next() {
            let known = argument == QUICK || OPTIONS.contains(&argument.as_str()) && rest.next().is_some();
            assert!(known, "{argument}: there is {QUICK}, and with a value {}", OPTIONS.join(", "));
        }
        let value = |name: &str| arguments.iter().position(|a| a == name).and_then(|i| arguments.get(i + 1));
        let number = |name: &str, default| {
            value(name).map_or(default, |text| text.parse().unwrap_or_else(|_| panic!("{name} {text}: not a number")))
        };
        let default = if arguments.iter().any(|a| a == QUICK) { quick } else { flights };
        Self {
            flights: number("--flights", default),
            seed_base: number("--seed-base", seed),
            world: value("--world").cloned().unwrap_or_else(|| "datasheet".into()),
            only: value("--only").cloned(),
            parts: Mutex::default(),
        }
    }

    /// The same, so many flights of every part.
    pub fn of(&self, flights: u64) -> Self {
        let Self { seed_base, world, .. } = self;
        Self { flights, seed_base: *seed_base, world: world.clone(), only: None, parts: Mutex::default() }
    }

    /// Is this part to be flown?
    pub fn wants(&self, name: &str) -> bool {
        self.parts.lock().unwrap().insert(name.to_owned());
        self.only.as_deref().is_none_or(|only| only == name)
    }

    /// At the end, once every part was asked about: that which is wanted was one of them.
    pub fn is_done(&self) {
        let parts = self.parts.lock().unwrap();
        let there = self.only.as_ref().is_none_or(|only| parts.is_empty() || parts.contains(only));
        let names = parts.iter().map(String::as_str).collect::<Vec<_>>().join(", ");
        assert!(there, "--only {}: there is {names}", self.only.as_deref().unwrap_or_default());
    }
}
