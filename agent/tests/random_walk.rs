//! Random sequences of commands, faults and recoveries, and what must hold in every tick whatever they are.
//!
//! A hundred walks; `cargo xtask chaos sensors` flies ten thousand and more, from any seed.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod common;
mod walk;

use plumbline_agent::flight::Failsafe;
use walk::{Seen, walk};

/// Walks of an ordinary run.
const WALKS: u64 = 100;

#[test]
fn whatever_happens_the_invariants_hold() {
    let (mut all, mut broken) = (Seen::default(), Vec::new());
    for walked in (1..=WALKS).map(walk) {
        match walked {
            Ok(seen) => {
                all.failsafes.extend(seen.failsafes);
                all.flown_s += seen.flown_s;
            }
            Err(what) => broken.push(what),
        }
    }
    let names: Vec<_> = all.failsafes.iter().filter_map(|f| Failsafe::try_from(*f).ok()).collect();
    println!("{WALKS} walks, {:.0} s in the air, {} broken, failsafes {names:?}", all.flown_s, broken.len());
    assert!(
        broken.is_empty(),
        "{} of {WALKS}:\n{}",
        broken.len(),
        broken.iter().take(3).map(String::as_str).collect::<String>()
    );
    assert!(all.flown_s > WALKS as f64, "the walks hardly fly: {:.0} s", all.flown_s);
    assert!(names.len() >= 12, "few failsafes were met: {names:?}");
}
