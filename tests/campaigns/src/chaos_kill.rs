//! Random kill −9 of ground and agent in flight: `PLUMBLINE_ROUNDS` of them, chosen by `PLUMBLINE_SEED`.

use super::figures::{Figures, quantile, setting};
use plumbline_support::kill;
use plumbline_support::system::{free_port, options};
use plumbline_tests::harness::SystemOptions;
use serde_json::json;

/// The promise: a kill costs at most the last flush.
const TAIL_MAX_MS: f64 = 250.0;

pub fn run() -> std::process::ExitCode {
    let (rounds, seed) = (setting("PLUMBLINE_ROUNDS", 20), setting("PLUMBLINE_SEED", 1));
    let mut figures = Figures::new("kill", seed);
    let folder = tempfile::tempdir().unwrap();
    let options = SystemOptions { port: free_port(), ..options(folder.path()) };
    let mut tally = kill::run(&options, rounds, seed);
    let kills = json!({ "rounds": tally.rounds, "ground": tally.ground_kills, "agent": tally.agent_kills,
        "armed": tally.in_flight });
    for (name, tails) in [("ground", &mut tally.ground_tails_ms), ("agent", &mut tally.agent_tails_ms)] {
        if tails.is_empty() {
            continue;
        }
        let (median, most) = (quantile(tails, 0.5), quantile(tails, 1.0));
        figures.at_most(&format!("{name}_oldest_lost"), most, TAIL_MAX_MS, "ms", json!({ "median": median.round() }));
    }
    figures.tell("opened_by_python", tally.opened as f64, "files", kills);
    figures.at_most("faults", tally.faults.len() as f64, 0.0, "faults", json!({ "first": tally.faults.first() }));
    tally.faults.iter().for_each(|fault| eprintln!("{fault}"));
    figures.finish()
}
