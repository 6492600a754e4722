//! Our filters against the independent references: the same logs, the same recipe, another program.

use nalgebra::{DMatrix, SMatrix, SVector};
use plumbline_agent::estimate::Residuals;
use plumbline_agent::estimate::constant_acceleration::ConstantAcceleration;
use plumbline_agent::estimate::filter::lqe;
use plumbline_agent::recordings::shared;
use plumbline_agent::sensor::Accuracy;
use serde_json::Value;

use super::scored::{Scored, Target};

/// Camera rates of the references, Hz.
const RATES_HZ: [usize; 3] = [120, 12, 1];
/// Paths of the logs.
const PATHS: [&str; 3] = ["hover", "circle", "sine"];

pub fn golden(scored: &mut Scored) {
    scored.report.heading("Parity with independent references");
    let read = |file: &str| -> Option<Value> {
        let text = std::fs::read_to_string(shared(&format!("reference/{file}"))?).ok()?;
        Some(serde_json::from_str(&text).unwrap())
    };
    match read("mocap_filter_golden.json") {
        Some(json) => filters(scored, &json),
        None => scored.skipped("golden/mocap", "reference/mocap_filter_golden.json is absent"),
    }
    match (shared("reference/point_mass_kf.csv"), read("point_mass_kf.json")) {
        (Some(csv), Some(json)) => {
            scored.value("golden/point_mass", point_mass(&csv), "m, m/s, m/s²", Target::Most(1e-9));
            let [a, c, q, r] = ["Gamma", "H", "Q", "R"].map(|key| matrix(&json[key]));
            let found = lqe::discrete(&a, &c, &q, &r).unwrap();
            let error = relative(&found.gain, &matrix(&json["K_filter_ss"]));
            scored.value("golden/steady_gain/point_mass", error, "relative", Target::Most(1e-8));
        }
        _ => scored.skipped("golden/point_mass", "reference/point_mass_kf.* are absent"),
    }
    match read("lqg.json") {
        Some(json) => {
            let d = &json["discrete_100Hz"];
            let [a, q, r] = ["Ad", "Qe_d", "Re_d"].map(|key| matrix(&d[key]));
            let found = lqe::discrete(&a, &matrix(&json["C"]), &q, &r).unwrap();
            let error = relative(&found.gain, &matrix(&d["filter_gain_Lf"]));
            scored.value("golden/steady_gain/lqg", error, "relative", Target::Most(1e-8));
        }
        None => scored.skipped("golden/steady_gain/lqg", "reference/lqg.json is absent"),
    }
}

/// The CLI's own output against the estimates of the reference, each second.
fn filters(scored: &mut Scored, json: &Value) {
    for (ours, theirs) in [("ekf-hybrid", "ekf"), ("ukf", "ukf")] {
        for rate in RATES_HZ {
            let mut worst: Option<f64> = None;
            for path in PATHS {
                let Some(log) = shared(&format!("reference/mocap_log_{path}.csv")) else { continue };
                let (_, csv) = scored.estimate(&log, ours, |args| args.rate = Some(rate));
                let rows: Vec<Vec<f64>> = rows(&csv);
                let expected = json["rates"][rate.to_string()][path][theirs].as_array().unwrap();
                for (k, state) in expected.iter().enumerate() {
                    for axis in 0..3 {
                        let difference = rows[120 * (k + 1) - 1][1 + axis] - state[axis].as_f64().unwrap();
                        worst = Some(worse(worst.unwrap_or_default(), difference));
                    }
                }
            }
            let name = format!("golden/{ours}/{rate}_hz");
            match worst {
                Some(worst) => scored.value(&name, worst, "m", Target::Most(1e-6)),
                None => scored.skipped(&name, "reference/mocap_log_*.csv are absent"),
            }
        }
    }
}

/// Largest difference of any state over the reference's run.
fn point_mass(csv: &std::path::Path) -> f64 {
    let mut filter = ConstantAcceleration::new(SVector::zeros(), SMatrix::identity(), 1.0);
    let mut worst = 0.0_f64;
    for v in rows(csv) {
        filter.predict(0.02);
        for (k, (state, sigma)) in [(0, 3.0), (1, 3.0), (2, 0.5), (6, 0.2), (7, 0.2), (8, 0.2)].into_iter().enumerate()
        {
            filter.correct(state, v[1 + k], Accuracy::ungated(sigma), None, &mut Residuals::new());
        }
        worst = filter.x.iter().zip(&v[16..25]).fold(worst, |worst, (ours, theirs)| worse(worst, ours - theirs));
    }
    worst
}

/// The largest difference with one more; what is no number is further off than any.
fn worse(worst: f64, difference: f64) -> f64 {
    if difference.is_finite() { worst.max(difference.abs()) } else { f64::INFINITY }
}

fn rows(csv: &std::path::Path) -> Vec<Vec<f64>> {
    let mut reader = csv::Reader::from_path(csv).unwrap();
    reader.records().map(|row| row.unwrap().iter().map(|v| v.parse().unwrap()).collect()).collect()
}

fn matrix(value: &Value) -> DMatrix<f64> {
    let rows: Vec<Vec<f64>> = serde_json::from_value(value.clone()).unwrap();
    DMatrix::from_fn(rows.len(), rows[0].len(), |i, j| rows[i][j])
}

fn relative(found: &DMatrix<f64>, expected: &DMatrix<f64>) -> f64 {
    (found - expected).iter().copied().fold(0.0, worse) / expected.amax()
}
