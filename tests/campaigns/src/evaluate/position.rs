//! Position, velocity and biases against truth.

use nalgebra::Vector3;
use plumbline_agent::estimate::vqf::{Vqf, VqfOptions};
use plumbline_agent::frames::from_roll_pitch_yaw;
use plumbline_support::effort::Effort;
use plumbline_tests::report::ReportError;

use super::scored::{Scored, Target};
use super::{entries, stem};

/// Seeds of the noise added to GNSS.
const SEEDS: [u64; 3] = [1, 2, 3];
/// The vendor's own attitude is used from here on, s.
const SETTLED_S: f64 = 3.0;

/// RotorPy: bias EKF against a simulation that nobody here wrote.
pub fn rotorpy(scored: &mut Scored) -> Result<(), ReportError> {
    scored.report.heading("RotorPy: accelerometer bias, inclination, velocity");
    let Some(logs) = entries("data/rotorpy_sim", |path| path.to_string_lossy().contains(".csv")) else {
        scored.skipped("rotorpy", "data/rotorpy_sim is absent");
        return Ok(());
    };
    let mut traces = Vec::new();
    for log in &logs {
        let name = stem(log);
        let (score, _) = scored.estimate(log, "ekf-bias", |_| {});
        match true_bias(&log.with_file_name(format!("{name}_params.json"))) {
            Some(bias) => {
                let error = (score.accel_bias_mps2() - bias).amax();
                scored.value(&format!("rotorpy/{name}/accel_bias"), error, "m/s²", Target::Most(0.03));
            }
            None => scored.skipped(&format!("rotorpy/{name}/accel_bias"), "its parameters are absent"),
        }
        if let (Some(attitude), Some(velocity)) = (score.attitude_deg(), score.velocity_mps()) {
            scored.value(&format!("rotorpy/{name}/inclination"), attitude[2], "deg", Target::Most(0.5));
            // Half of what a constant-velocity filter on motion capture alone reaches.
            scored.value(&format!("rotorpy/{name}/velocity"), velocity, "m/s", Target::Most(0.085));
        }
        traces.push((name, score.trace().to_vec()));
    }
    scored.trace("rotorpy_position", "RotorPy: position error", "m", &traces, |s| s.position_m)?;
    scored.trace("rotorpy_inclination", "RotorPy: inclination error", "deg", &traces, |s| Some(s.inclination_deg))
}

fn true_bias(path: &std::path::Path) -> Option<Vector3<f64>> {
    let json: serde_json::Value = serde_json::from_str(&std::fs::read_to_string(path).ok()?).ok()?;
    let list: Vec<f64> = serde_json::from_value(json["accel_initial_bias"].clone()).ok()?;
    (list.len() == 3).then(|| Vector3::from_column_slice(&list))
}

/// Phantom 4: RTK thinned to 1 Hz with 0.5 m of noise, no magnetometer; and each IMU against its vendor's filter.
pub fn phantom4(scored: &mut Scored, effort: &Effort) -> Result<(), ReportError> {
    let seeds = SEEDS.map(|own| effort.seed(own));
    scored.report.heading("Phantom 4: position at 1 Hz GNSS with 0.5 m of noise, heading found by itself");
    scored.report.paragraph(
        "Peers: constant-velocity Kalman filter 1.63 m, IMU and GNSS Kalman filter 1.23 m (helped by the true heading). \
         The clocks of IMU and RTK of some paths differ by up to 0.7 s: the reader lays them onto one another by the inclination that \
         both devices saw, before any estimator runs; heading takes no part in it.",
    );
    let Some(paths) = entries("data/phantom4_4imu_rtk", |path| path.join("IMU_1.csv").is_file()) else {
        scored.skipped("phantom4", "data/phantom4_4imu_rtk is absent");
        return Ok(());
    };
    for (estimator, limit) in [("ekf-bias", Some(1.2)), ("lanes", None), ("ekf-hybrid", None), ("ukf", None)] {
        let mut traces = Vec::new();
        let mut squares = 0.0;
        let mut latest = 0.0_f64;
        for path in &paths {
            let mut square = 0.0;
            for seed in seeds {
                let (score, _) = scored.estimate(path, estimator, |args| {
                    (args.gnss_rate, args.gnss_noise, args.seed) = (Some(1.0), Some(0.5), Some(seed));
                });
                square += score.position_m().unwrap_or(f64::NAN).powi(2) / SEEDS.len() as f64;
                latest = latest.max(score.initialised_s().unwrap_or(f64::INFINITY));
                if seed == seeds[0] {
                    traces.push((stem(path), score.trace().to_vec()));
                }
            }
            let name = format!("phantom4/{estimator}/position/{}", stem(path));
            scored.value(&name, square.sqrt(), "m", Target::Peer(None));
            squares += square.sqrt();
        }
        let target = limit.map_or(Target::Peer(Some(1.23)), Target::Most);
        scored.value(&format!("phantom4/{estimator}/position/mean"), squares / paths.len() as f64, "m", target);
        scored.value(&format!("phantom4/{estimator}/initialised_latest"), latest, "s", Target::Peer(None));
        let caption = format!("Phantom 4, {estimator}: position error, seed {}", seeds[0]);
        scored.trace(&format!("phantom4_{estimator}_position"), &caption, "m", &traces, |s| s.position_m)?;
    }
    scored.report.heading("Phantom 4: inclination of each IMU against its vendor's filter");
    for path in &paths {
        for imu in 1..=4 {
            if let Some(error) = against_vendor(&path.join(format!("IMU_{imu}.csv"))) {
                // VQF: 1.5 to 8.0 degrees.
                scored.value(
                    &format!("phantom4/inclination/{}/imu_{imu}", stem(path)),
                    error,
                    "deg",
                    Target::Peer(None),
                );
            }
        }
    }
    Ok(())
}

/// RMS inclination between our attitude filter on one IMU alone and the vendor's Euler angles, degrees.
fn against_vendor(file: &std::path::Path) -> Option<f64> {
    let mut reader = csv::ReaderBuilder::new().trim(csv::Trim::All).from_path(file).ok()?;
    let mut filter = Vqf::new(VqfOptions { use_mag: false, ..VqfOptions::default() });
    let (mut sum, mut count, mut last) = (0.0, 0.0, None);
    for record in reader.records() {
        let v: Vec<f64> = record.ok()?.iter().filter_map(|x| x.parse().ok()).collect();
        let [t, ex, ey, _, ax, ay, az, gx, gy, gz] = v[..] else { return None };
        let dt_s = last.map_or(0.0, |before| t - before);
        last = Some(t);
        let gyro = Vector3::new(gx, gy, gz).map(f64::to_radians);
        filter.push(dt_s, &gyro, &Vector3::new(ax, ay, az), None);
        if t > SETTLED_S {
            let vendor = from_roll_pitch_yaw(&Vector3::new(ex.to_radians(), ey.to_radians(), 0.0));
            let up = |q: &nalgebra::UnitQuaternion<f64>| q.inverse() * Vector3::z();
            sum += up(&vendor).angle(&up(&filter.world_from_body())).to_degrees().powi(2);
            count += 1.0;
        }
    }
    (count > 0.0).then(|| f64::sqrt(sum / count))
}
