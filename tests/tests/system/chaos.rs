//! The fast part of `cargo xtask chaos kill`: a few kills, each file whole afterwards.

use plumbline_support::kill;
use plumbline_support::system::{free_port, options};
use plumbline_tests::harness::SystemOptions;

/// The promise, here as in the campaign.
const TAIL_MAX_MS: f64 = 250.0;

#[test]
fn a_kill_costs_no_more_than_the_last_flush() {
    // GIVEN a flight WHEN ground or agent is killed, four times
    let folder = tempfile::tempdir().unwrap();
    let options = SystemOptions { port: free_port(), ..options(folder.path()) };
    let tally = kill::run(&options, 4, 7);
    // THEN files, index and the third-party reader agree, and what was flushed is there
    assert!(tally.faults.is_empty(), "{:#?}", tally.faults);
    assert!(tally.ground_kills > 0 && tally.agent_kills > 0, "{tally:?}");
    let most = tally.ground_tails_ms.iter().chain(&tally.agent_tails_ms).fold(0.0_f64, |most, tail| most.max(*tail));
    assert!(most <= TAIL_MAX_MS, "{tally:?}");
}
