//! What is asked of a campaign that draws: `--seed-base N`, and where it knows them `--flights N`, `--world NAME`,
//! `--only NAME`, `--quick`. What it does not know it refuses.

use std::collections::BTreeSet;
use std::sync::Mutex;

const FLIGHTS: &str = "--flights";
const SEED_BASE: &str = "--seed-base";
const WORLD: &str = "--world";
const ONLY: &str = "--only";
const QUICK: &str = "--quick";
/// In which world, where nobody says.
const DATASHEET: &str = "datasheet";

/// What a campaign can be asked.
#[derive(Debug, Clone, Copy)]
pub struct Knows {
    /// The first seed, unless another is asked for.
    pub seed: u64,
    /// Flights of each row, and with `--quick`; `None` where their number is not for the asker to choose.
    pub flights: Option<[u64; 2]>,
    /// Can the world be chosen?
    pub worlds: bool,
    /// Has it parts that can be flown alone?
    pub parts: bool,
}

impl Knows {
    /// The names of its options.
    fn options(&self) -> impl Iterator<Item = &'static str> {
        let flights = self.flights.is_some();
        let all = [(SEED_BASE, true), (FLIGHTS, flights), (QUICK, flights), (WORLD, self.worlds), (ONLY, self.parts)];
        all.into_iter().filter_map(|(name, known)| known.then_some(name))
    }
}

/// See the module.
#[derive(Debug)]
pub struct Effort {
    /// Flights of each row.
    pub flights: u64,
    /// Seed of the first.
    pub seed_base: u64,
    /// The world to fly in, where it is for the asker to choose.
    pub world: String,
    /// Less of everything?
    pub quick: bool,
    /// The first seed where no other is asked for.
    usual: u64,
    only: Option<String>,
    /// Parts that were asked about.
    parts: Mutex<BTreeSet<String>>,
}

impl Effort {
    /// As the arguments say; else so many flights, and so many with `--quick`, from seed 1000, some part of it.
    pub fn asked(flights: [u64; 2]) -> Self {
        Self::of_program(Knows { seed: 1_000, flights: Some(flights), worlds: false, parts: true })
    }

    /// As the program's arguments say; ends it with the reason where they cannot be followed.
    pub fn of_program(knows: Knows) -> Self {
        let arguments: Vec<String> = std::env::args().skip(2).collect();
        Self::read(&arguments, knows).unwrap_or_else(|reason| {
            eprintln!("{reason}");
            std::process::exit(2)
        })
    }

    /// As `arguments` say.
    ///
    /// # Errors
    /// An option that this campaign does not know, has no value, or is no number.
    pub fn read(arguments: &[String], knows: Knows) -> Result<Self, String> {
        let [flights, fewer] = knows.flights.unwrap_or_default();
        let mut effort = Self {
            flights,
            seed_base: knows.seed,
            world: DATASHEET.into(),
            quick: false,
            usual: knows.seed,
            only: None,
            parts: Mutex::default(),
        };
        let mut given = None;
        let mut rest = arguments.iter();
        while let Some(name) = rest.next() {
            if !knows.options().any(|known| known == name) {
                let known: Vec<_> = knows.options().collect();
                return Err(format!("{name}: not known here; there is {}", known.join(", ")));
            }
            if name == QUICK {
                (effort.quick, effort.flights) = (true, fewer);
                continue;
            }
            let value = rest.next().ok_or_else(|| format!("{name}: no value"))?;
            let number = || value.parse::<u64>().map_err(|_| format!("{name} {value}: not a number"));
            match name.as_str() {
                FLIGHTS => given = Some(number()?),
                SEED_BASE => effort.seed_base = number()?,
                WORLD => effort.world.clone_from(value),
                _ => effort.only = Some(value.clone()),
            }
        }
        effort.flights = given.unwrap_or(effort.flights);
        Ok(effort)
    }

    /// The same, so many flights of every part.
    pub fn of(&self, flights: u64) -> Self {
        let Self { seed_base, quick, usual, ref world, .. } = *self;
        Self { flights, seed_base, world: world.clone(), quick, usual, only: None, parts: Mutex::default() }
    }

    /// The seed of what has one of its own, `own`: as far from it as the first seed is from the usual first one.
    pub fn seed(&self, own: u64) -> u64 {
        own.wrapping_add(self.seed_base.wrapping_sub(self.usual))
    }

    /// Is this part to be flown?
    pub fn wants(&self, name: &str) -> bool {
        self.parts.lock().unwrap().insert(name.to_owned());
        self.only.as_deref().is_none_or(|only| only == name)
    }

    /// At the end, once every part was asked about: that which is wanted was one of them.
    pub fn is_done(&self) {
        let parts = self.parts.lock().unwrap();
        let there = self.only.as_ref().is_none_or(|only| parts.contains(only));
        let names = parts.iter().map(String::as_str).collect::<Vec<_>>().join(", ");
        assert!(there, "--only {}: there is {names}", self.only.as_deref().unwrap_or_default());
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ALL: Knows = Knows { seed: 1_000, flights: Some([100, 10]), worlds: true, parts: true };
    const SEEDS: Knows = Knows { seed: 0, flights: None, worlds: false, parts: false };

    fn read(arguments: &str, knows: Knows) -> Result<Effort, String> {
        Effort::read(&arguments.split_whitespace().map(str::to_owned).collect::<Vec<_>>(), knows)
    }

    #[test]
    fn every_seed_moves_with_the_first_one() {
        for (arguments, knows, seeds) in
            [("", ALL, [1_000, 7]), ("--seed-base 1003", ALL, [1_003, 10]), ("--seed-base 5", SEEDS, [5, 12])]
        {
            let effort = read(arguments, knows).unwrap();
            assert_eq!([effort.seed_base, effort.seed(7)], seeds, "{arguments}");
        }
        // Below the usual one as well, and back.
        let effort = read("--seed-base 1", ALL).unwrap();
        assert_eq!(effort.of(3).seed(1_000), 1);
    }

    #[test]
    fn the_order_of_options_does_not_matter() {
        for arguments in ["--flights 3 --quick --world harsh --only a", "--only a --world harsh --quick --flights 3"] {
            let effort = read(arguments, ALL).unwrap();
            assert_eq!((effort.flights, effort.quick, effort.world.as_str()), (3, true, "harsh"));
            assert!(effort.wants("a") && !effort.wants("b"));
        }
        assert_eq!(read("--quick", ALL).unwrap().flights, 10);
        assert_eq!((read("", ALL).unwrap().flights, read("", ALL).unwrap().world.as_str()), (100, "datasheet"));
    }

    #[test]
    fn what_is_not_known_is_refused_by_name() {
        for (arguments, knows, reason) in [
            ("--seeds 3", ALL, "--seeds: not known here; there is --seed-base, --flights, --quick, --world, --only"),
            ("--flights 3", SEEDS, "--flights: not known here; there is --seed-base"),
            ("--quick", SEEDS, "--quick: not known here; there is --seed-base"),
            ("--world harsh", SEEDS, "--world: not known here; there is --seed-base"),
            ("--seed-base", ALL, "--seed-base: no value"),
            ("--seed-base one", ALL, "--seed-base one: not a number"),
        ] {
            assert_eq!(read(arguments, knows).unwrap_err(), reason);
        }
    }

    #[test]
    #[should_panic(expected = "--only c: there is a, b")]
    fn a_part_that_is_not_there_is_refused() {
        let effort = read("--only c", ALL).unwrap();
        assert!(!effort.wants("a") && !effort.wants("b"));
        effort.is_done();
    }
}
