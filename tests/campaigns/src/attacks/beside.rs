//! Where the lanes are no better than another estimator, said in words that no one had to write.

use std::fmt::Write as _;

use super::case::Pilot;

/// How a row went for one estimator.
#[derive(Debug, Clone)]
pub struct Told {
    pub case: &'static str,
    pub pilot: Pilot,
    /// e/e*: median, 95 %, worst of the flights not lost.
    pub altitude: [f64; 3],
    pub lost: usize,
}

/// What of a row is compared.
const MEASURES: [&str; 4] = ["median", "95 %", "worst", "lost"];

/// In which of the rows the lanes are no better than `pilot`, and in what; `None` where it flew none of them.
pub fn no_better(all: &[Told], pilot: Pilot) -> Option<String> {
    let of = |pilot: Pilot| move |told: &&Told| told.pilot == pilot;
    let mut rows = String::new();
    let mut flown = 0;
    for other in all.iter().filter(of(pilot)) {
        let Some(lanes) = all.iter().filter(of(Pilot::LANES)).find(|told| told.case == other.case) else { continue };
        flown += 1;
        // Of nothing that was kept there is no figure: then the lost say it.
        let errors = lanes.altitude.iter().zip(&other.altitude).map(|(lanes, other)| lanes >= other);
        let worse = errors.chain([lanes.lost > other.lost]);
        let in_what: Vec<_> =
            MEASURES.into_iter().zip(worse).filter(|(_, worse)| *worse).map(|(name, _)| name).collect();
        if !in_what.is_empty() {
            let name = other.case.replace('_', " ");
            let separator = if rows.is_empty() { "" } else { "; " };
            let _ = write!(rows, "{separator}{name} ({})", in_what.join(", "));
        }
    }
    let name = pilot.name();
    match (flown, rows.as_str()) {
        (0, _) => None,
        (_, "") => Some(format!("Lanes are better than {name} in each of {flown} rows, and lose no more flights.")),
        (_, rows) => Some(format!("Lanes are no better than {name} in: {rows}.")),
    }
}
