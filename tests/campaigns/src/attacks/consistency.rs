//! Is each estimator as uncertain as it says? Squared errors over their variances (NEES), per scalar, in every world.
//!
//! One instant of each flight, so that flights are independent: with all of them right, the mean of N values of χ²(1) lies
//! within 1 ± 1.96 √(2/N) in 95 of 100 (Bar-Shalom, Li, Kirubarajan 2001, 5.4.2). The lanes fly, which fly in every world;
//! the others run beside them and receive the same.

use std::collections::BTreeMap;

use nalgebra::Vector3;
use plumbline_agent::estimate::Estimate;
use plumbline_agent::estimate::filter::consistency::error;
use plumbline_agent::sensor::measure::Kinematics;
use plumbline_agent::types::EstimatorKind;
use plumbline_agent::vehicle::Truth;
use plumbline_experiment::draw::{median, parallel};
use plumbline_experiment::flight::fly_watched;
use plumbline_support::effort::Effort;
use plumbline_tests::report::{Report, ReportError};
use serde_json::json;

use super::case::{Case, Pilot};

/// The instant of flight of each seed, s: after steps, and on the way of one.
const AT_S: (f64, f64) = (14.0, 38.0);
const WORLDS: [&str; 3] = ["bench", "datasheet", "harsh"];
const QUANTITIES: [&str; 3] = ["altitude", "climb", "tilt"];

/// Error and one-sigma of each quantity, m, m/s and rad; the tilt's is about the world's x axis.
fn errors(estimate: &Estimate, truth: &Truth) -> [Option<(f64, f64)>; 3] {
    let motion = estimate.motion.filter(|motion| motion.altitude_known);
    let of = |off: f64, sigma: Option<Vector3<f64>>| sigma.filter(|s| s.z > 0.0).map(|s| (off, s.z));
    let Truth { position_enu_m, velocity_enu_mps, world_from_body, .. } = *truth;
    let off = error(&Kinematics { position_enu_m, velocity_enu_mps, world_from_body }, &estimate.kinematics());
    [
        motion.and_then(|m| of(off[2], m.position_sigma_m)),
        motion.and_then(|m| of(off[5], m.velocity_sigma_mps)),
        estimate.attitude_sigma_rad.filter(|s| s.x > 0.0).map(|s| (off[6], s.x)),
    ]
}

type Errors = Vec<(EstimatorKind, [Option<(f64, f64)>; 3])>;

pub fn consistency(report: &mut Report, effort: &Effort) -> Result<(), ReportError> {
    report.heading("As uncertain as they say");
    let mut rows = Vec::new();
    for world in WORLDS {
        let case = Case { world, ..Case::ALL[0] };
        let flown: Vec<Errors> = parallel(effort.flights as usize, |i| {
            let seed = effort.seed_base + i as u64;
            let mut setup = Pilot::LANES.setup(&case.scenario(seed), &[], 0.0);
            setup.config = setup.config.with_every_estimator();
            let at_s = AT_S.0 + (AT_S.1 - AT_S.0) * (seed as f64 * 0.618_034).fract();
            let mut errors_at = Errors::new();
            fly_watched(&setup, |flight, truth| {
                if errors_at.is_empty() && flight.report().sensed.time.as_seconds() >= at_s {
                    errors_at = flight.estimates().map(|(kind, estimate)| (kind, errors(estimate, truth))).collect();
                }
            })
            .unwrap();
            errors_at
        });
        let mut all: BTreeMap<(&str, usize), Vec<(f64, f64)>> = BTreeMap::new();
        for (kind, errors) in flown.iter().flatten() {
            for (quantity, error) in errors.iter().enumerate() {
                all.entry((kind.as_str_name(), quantity)).or_default().extend(error);
            }
        }
        for ((name, quantity), errors) in all.into_iter().filter(|(_, errors)| !errors.is_empty()) {
            let name = name.trim_start_matches("ESTIMATOR_KIND_").to_lowercase();
            let n = errors.len() as f64;
            let nees = errors.iter().map(|(off, sigma)| (off / sigma).powi(2)).sum::<f64>() / n;
            let band = 1.96 * (2.0 / n).sqrt();
            let rms = (errors.iter().map(|(off, _)| off * off).sum::<f64>() / n).sqrt();
            let sigma = median(&errors.iter().map(|(_, sigma)| *sigma).collect::<Vec<_>>());
            let holds = (nees - 1.0).abs() <= band;
            report.value(
                &format!("nees/{world}/{name}/{}", QUANTITIES[quantity]),
                nees,
                "1",
                json!({ "seed_base": effort.seed_base, "flights": errors.len(), "band": [1.0 - band, 1.0 + band],
                    "error_rms": rms, "sigma_median": sigma, "holds": holds }),
            );
            let told = |value: f64| format!("{:.1}", 1e3 * value);
            let quantity = QUANTITIES[quantity].to_owned();
            rows.push(vec![world.into(), name, quantity, format!("{nees:.2}"), told(rms), told(sigma), n.to_string()]);
        }
    }
    let headers = ["world", "estimator", "quantity", "NEES", "error rms, 10⁻³", "σ median, 10⁻³", "flights"];
    report.table("consistency", "Mean of squared error over variance; 1 is right", &headers, &rows)
}
