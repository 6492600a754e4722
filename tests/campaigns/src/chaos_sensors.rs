//! Random walks of commands, faults and recoveries through the failsafe table: `PLUMBLINE_ROUNDS` of them, from
//! `PLUMBLINE_SEED` on. Sensors, battery, motors, link, operator and flight thread are really lost in the simulator.
//! The EKF and the lanes fly by turns. Beside each walk a flight with everything in order tries to leave its box: every mode on every rig in turn.

use std::collections::BTreeMap;

use super::figures::{Figures, setting};
use plumbline_experiment::draw::parallel;
use plumbline_proto::v1::Failsafe;
use plumbline_support::walk::edge::edge;
use plumbline_support::walk::{MARGIN_M, PILOTS, Seen, walk};
use serde_json::json;

pub fn run() -> std::process::ExitCode {
    let (walks, seed) = (setting("PLUMBLINE_ROUNDS", 10_000), setting("PLUMBLINE_SEED", 1));
    let mut figures = Figures::new("sensors", seed);
    let all = parallel(walks as usize, |n| {
        let seed = seed + n as u64;
        let pilot = PILOTS[n % PILOTS.len()];
        (walk(seed, pilot), edge(seed as usize, seed, pilot))
    });
    let mut flown = Flown { beyond_m: (f64::NEG_INFINITY, f64::NEG_INFINITY), ..Flown::default() };
    all.into_iter().for_each(|(walked, edged)| flown.add(walked, edged));
    let first = |broken: &[String]| json!({ "first": broken.iter().take(5).collect::<Vec<_>>() });
    figures.tell("walks", walks as f64, "walks", json!({ "met_in_walks": flown.met }));
    figures.tell("in_the_air", flown.walked_s, "s", json!({}));
    figures.at_most("invariants_broken", flown.broken.len() as f64, 0.0, "walks", first(&flown.broken));
    figures.tell("edge_in_the_air", flown.edged_s, "s", json!({ "flights": walks }));
    figures.at_most("above_the_limit", flown.beyond_m.0, MARGIN_M, "m", json!({}));
    figures.at_most("aside_of_the_limit", flown.beyond_m.1, MARGIN_M, "m", json!({}));
    figures.at_most("boxes_left", flown.left.len() as f64, 0.0, "flights", first(&flown.left));
    figures.finish()
}

/// What all flights together came to.
#[derive(Default)]
struct Flown {
    walked_s: f64,
    met: BTreeMap<String, u64>,
    broken: Vec<String>,
    edged_s: f64,
    /// Farthest beyond the limits of altitude and place, of flights that stayed inside.
    beyond_m: (f64, f64),
    left: Vec<String>,
}

impl Flown {
    fn add(&mut self, walked: Result<Seen, String>, edged: Result<((f64, f64), Seen), String>) {
        match walked {
            Ok(seen) => {
                self.walked_s += seen.flown_s;
                for failsafe in seen.failsafes.iter().filter_map(|f| Failsafe::try_from(*f).ok()) {
                    *self.met.entry(format!("{failsafe:?}")).or_default() += 1;
                }
            }
            Err(broken) => self.broken.push(broken),
        }
        match edged {
            Ok(((above_m, aside_m), seen)) => {
                self.edged_s += seen.flown_s;
                self.beyond_m = (self.beyond_m.0.max(above_m), self.beyond_m.1.max(aside_m));
            }
            Err(left) => self.left.push(left),
        }
    }
}
