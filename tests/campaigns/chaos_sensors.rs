//! Random walks of commands, faults and recoveries through the failsafe table: `PLUMBLINE_ROUNDS` of them, from
//! `PLUMBLINE_SEED` on. Sensors, battery, motors, link, operator and flight thread are really lost in the simulator.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

#[path = "../../agent/tests/common/mod.rs"]
mod common;
#[path = "chaos/figures.rs"]
mod figures;
#[path = "../../agent/tests/walk/mod.rs"]
mod walk;

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};

use figures::{Figures, setting};
use plumbline_proto::v1::Failsafe;
use serde_json::json;

fn main() -> std::process::ExitCode {
    let (walks, seed) = (setting("PLUMBLINE_ROUNDS", 10_000), setting("PLUMBLINE_SEED", 1));
    let mut figures = Figures::new("sensors", seed);
    let (next, flown) = (AtomicU64::new(0), Mutex::new((0.0, BTreeMap::<String, u64>::new(), Vec::new())));
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    std::thread::scope(|scope| {
        for _ in 0..threads {
            scope.spawn(|| {
                loop {
                    let n = next.fetch_add(1, Ordering::Relaxed);
                    if n >= walks {
                        return;
                    }
                    let walked = walk::walk(seed + n);
                    let mut flown = flown.lock().unwrap_or_else(PoisonError::into_inner);
                    match walked {
                        Ok(seen) => {
                            flown.0 += seen.flown_s;
                            for failsafe in seen.failsafes.iter().filter_map(|f| Failsafe::try_from(*f).ok()) {
                                *flown.1.entry(format!("{failsafe:?}")).or_default() += 1;
                            }
                        }
                        Err(broken) => flown.2.push(broken),
                    }
                }
            });
        }
    });
    let (flown_s, met, broken) = flown.into_inner().unwrap_or_else(PoisonError::into_inner);
    figures.tell("walks", walks as f64, "walks", json!({ "met_in_walks": met }));
    figures.tell("in_the_air", flown_s, "s", json!({}));
    let first: Vec<_> = broken.iter().take(5).map(String::as_str).collect();
    figures.at_most("invariants_broken", broken.len() as f64, 0.0, "walks", json!({ "first": first }));
    figures.finish()
}
