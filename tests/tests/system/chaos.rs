//! The fast part of `cargo xtask chaos kill`: a few kills, each file whole afterwards.

use plumbline_support::kill;
use plumbline_support::system::{free_port, options};
use plumbline_tests::harness::SystemOptions;

/// The promise, here as in the campaign.
const TAIL_MAX_MS: f64 = 250.0;
/// One kill of the four may find this instead: a machine that compiles beside us stops everybody for a moment.
const TAIL_MAX_ONCE_MS: f64 = 1000.0;

#[test]
fn a_kill_costs_no_more_than_the_last_flush() {
    // GIVEN a flight WHEN ground or agent is killed, four times
    let folder = tempfile::tempdir().unwrap();
    let options = SystemOptions { port: free_port(), ..options(folder.path()) };
    let tally = kill::run(&options, 4, 7);
    // THEN files, index and the third-party reader agree, and what was flushed is there
    assert!(tally.faults.is_empty(), "{:#?}", tally.faults);
    assert!(tally.ground_kills > 0 && tally.agent_kills > 0, "{tally:?}");
    let tails_ms = [tally.ground_tails_ms.as_slice(), &tally.agent_tails_ms].concat();
    let late = tails_ms.iter().filter(|tail_ms| **tail_ms > TAIL_MAX_MS).count();
    assert!(late <= 1 && tails_ms.iter().all(|tail_ms| *tail_ms <= TAIL_MAX_ONCE_MS), "{tally:?}");
}
