//! What is asked of a campaign of drawn flights: `--flights N`, `--seed-base N`, `--world NAME`, `--only NAME`,
//! `--quick`.

pub struct Effort {
    pub flights: u64,
    pub seed_base: u64,
    /// The world to fly in, where it is for the asker to choose.
    pub world: String,
    pub only: Option<String>,
}

impl Effort {
    /// As the arguments say; else so many flights, and so many with `--quick`, from seed 1000.
    pub fn asked(flights: [u64; 2]) -> Self {
        Self::asked_from(flights, 1_000)
    }

    /// The same from another seed.
    pub fn asked_from([flights, quick]: [u64; 2], seed: u64) -> Self {
        let arguments: Vec<String> = std::env::args().collect();
        let value = |name: &str| arguments.iter().position(|a| a == name).and_then(|i| arguments.get(i + 1));
        let number = |name: &str, default| {
            value(name).map_or(default, |text| text.parse().unwrap_or_else(|_| panic!("{name} {text}: not a number")))
        };
        let default = if arguments.iter().any(|a| a == "--quick") { quick } else { flights };
        Self {
            flights: number("--flights", default),
            seed_base: number("--seed-base", seed),
            world: value("--world").cloned().unwrap_or_else(|| "datasheet".into()),
            only: value("--only").cloned(),
        }
    }

    pub fn wants(&self, name: &str) -> bool {
        self.only.as_deref().is_none_or(|only| only == name)
    }
}
