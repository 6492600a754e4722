//! Attitude against optical references and autopilots.

use std::path::PathBuf;

use plumbline_agent::offline::ErrorSample;
use plumbline_tests::report::ReportError;

use super::scored::{Scored, Target};
use super::{entries, stem};

/// The trials that the peers were measured on, by the number their names begin with.
const PEERS_TRIALS: [&str; 6] = ["02", "06", "11", "15", "28", "33"];

/// BROAD: VQF, nine and six axes, and the attitude EKF over every trial found.
pub fn broad(scored: &mut Scored) -> Result<(), ReportError> {
    scored.report.heading("BROAD: attitude against optical motion capture");
    scored.report.paragraph(
        "Root mean square over the rows the data set scores (movement = 1). Peers in real time: VQF 2.74°/2.65°/0.66° \
         (total, heading, inclination), Madgwick 7.18°/6.39°/2.96°; without magnetometer VQF 0.66°. Offline, from \
         both directions, over all seven: VQF 2.20°/2.13°/0.50°.",
    );
    let Some(trials) = entries("data/broad_imu_mocap", |path| path.to_string_lossy().contains(".csv")) else {
        scored.skipped("broad", "data/broad_imu_mocap is absent");
        return Ok(());
    };
    let of_peers = |path: &PathBuf| PEERS_TRIALS.iter().any(|number| stem(path).starts_with(number));
    for (axes, estimator, sensors, limits) in [
        ("nine_axes", "vqf", &[][..], [Some(2.8), Some(2.7), Some(0.7)]),
        ("six_axes", "vqf", &["imu"][..], [None, None, Some(0.7)]),
        ("attitude_ekf", "attitude-ekf", &[][..], [Some(1.2), Some(1.1), Some(0.6)]),
        // Offline VQF, over all seven: 2.20°, 2.13°, 0.50°.
        ("attitude_ekf_smoothed", "attitude-ekf", &[][..], [Some(1.2), Some(1.1), Some(0.55)]),
    ] {
        let mut sums = [[0.0; 3]; 2];
        let mut counts = [0.0; 2];
        let mut traces: Vec<(String, Vec<ErrorSample>)> = Vec::new();
        for trial in &trials {
            let chosen = |args: &mut plumbline_agent::offline::EstimateArgs| {
                args.sensors = sensors.iter().map(|s| (*s).to_owned()).collect();
                args.smooth = axes.ends_with("smoothed");
            };
            let (score, _) = scored.estimate(trial, estimator, chosen);
            let errors = score.attitude_deg().unwrap();
            for i in (0..3).filter(|i| limits[*i].is_some()) {
                let name = format!("broad/{axes}/{}/{}", stem(trial), NAMES[i]);
                scored.value(&name, errors[i], "deg", Target::Peer(None));
            }
            for (set, counted) in [true, of_peers(trial)].into_iter().enumerate().filter(|(_, counted)| *counted) {
                let _ = counted;
                counts[set] += 1.0;
                (0..3).for_each(|i| sums[set][i] += errors[i]);
            }
            traces.push((stem(trial), score.trace().to_vec()));
        }
        for (set, which) in ["all", "peers_trials"].into_iter().enumerate().filter(|(set, _)| counts[*set] > 0.0) {
            for i in (0..3).filter(|i| limits[*i].is_some()) {
                let name = format!("broad/{axes}/mean_of_{which}/{}", NAMES[i]);
                // The promise is about the trials that the peers were measured on.
                let target = limits[i].filter(|_| set == 1).map_or(Target::Peer(None), Target::Most);
                scored.value(&name, sums[set][i] / counts[set], "deg", target);
            }
        }
        let caption = format!("BROAD, {}: inclination error", axes.replace('_', " "));
        scored.trace(&format!("broad_{axes}_inclination"), &caption, "deg", &traces, |s| Some(s.inclination_deg))?;
        if axes == "nine_axes" {
            scored
                .trace("broad_heading", "BROAD, nine axes: heading error", "deg", &traces, |s| Some(s.heading_deg))?;
        }
    }
    Ok(())
}

const NAMES: [&str; 3] = ["total", "heading", "inclination"];

/// PX4 logs that carry a truth: the EKF in the loop.
pub fn px4(scored: &mut Scored) -> Result<(), ReportError> {
    scored.report.heading("PX4 logs with a truth");
    let Some(logs) = entries("data/px4_ulog", |path| path.extension().is_some_and(|e| e == "ulg")) else {
        scored.skipped("px4_ulog", "data/px4_ulog is absent");
        return Ok(());
    };
    let mut traces = Vec::new();
    for log in &logs {
        let (score, _) = scored.estimate(log, "ekf-bias", |_| {});
        match score.attitude_deg() {
            Some([total, heading, inclination]) => {
                // PX4's own EKF2 on the truth-bearing log: 0.24°.
                for (name, value, peer) in
                    [("total", total, Some(0.24)), ("heading", heading, None), ("inclination", inclination, None)]
                {
                    scored.value(&format!("px4_ulog/{}/{name}", stem(log)), value, "deg", Target::Peer(peer));
                }
                traces.push((stem(log), score.trace().to_vec()));
            }
            None => scored.skipped(&format!("px4_ulog/{}", stem(log)), "no truth in it"),
        }
    }
    scored.trace("px4_inclination", "PX4: inclination error", "deg", &traces, |s| Some(s.inclination_deg))
}
