//! The secure estimator in the loop: attacks are found, healthy sensors are not excluded, the altitude is kept.

use std::collections::BTreeMap;

use plumbline_agent::sim::Scenario;
use plumbline_agent::types::EstimatorKind;
use plumbline_proto::ids::SensorId;
use plumbline_support::flown::Flown;

/// Altitude steps on the string rig.
const STEPS: &str = r#"
name = "secure"
duration_s = 30
[[script]]
at_s = 3
do = "arm"
[[script]]
at_s = 4
do = "mode"
mode = "altitude_hold"
[[script]]
at_s = 5
do = "setpoint"
altitude_m = 0.5
[[script]]
at_s = 12
do = "setpoint"
altitude_m = 1.0
[[script]]
at_s = 20
do = "setpoint"
altitude_m = 0.6
"#;
/// Tracking is judged from here on, s.
const JUDGED_FROM_S: f64 = 8.0;

struct Outcome {
    /// rms of true altitude − setpoint, m.
    error_m: f64,
    /// How long each sensor was flagged, s, and when first.
    flagged: BTreeMap<String, (f64, f64)>,
    log: String,
}

fn fly(attack: &str, seed: u64, in_loop: EstimatorKind) -> Outcome {
    let mut scenario = Scenario::from_toml(&format!("{STEPS}{attack}")).unwrap();
    scenario.seed = seed;
    let mut config = scenario.flight_config();
    config.estimators = vec![EstimatorKind::EkfBias, EstimatorKind::Secure];
    config.in_loop = in_loop;
    let end = scenario.duration_s;
    let mut flown = Flown::with_config(scenario, config);
    let mut flagged = BTreeMap::<String, (f64, f64)>::new();
    while flown.vehicle.time().as_seconds() < end {
        flown.tick();
        let now = flown.vehicle.time().as_seconds();
        let secure = flown.flight.secure().unwrap();
        for device in secure.isolation().devices().iter().filter(|d| d.flagged.is_some()) {
            let name = |s: SensorId| s.to_string();
            flagged.entry(name(device.sensor)).or_insert((0.0, now)).0 += 0.005;
        }
    }
    let judged: Vec<f64> = flown
        .since(JUDGED_FROM_S)
        .map(|r| (r.truth.position_enu_m.z - r.report.setpoint.position_enu_m.z).powi(2))
        .collect();
    Outcome { error_m: (judged.iter().sum::<f64>() / judged.len() as f64).sqrt(), flagged, log: flown.log() }
}

fn attack(sensor: &str, kind: &str, magnitude: f64, more: &str) -> String {
    let (name, instance) = sensor.split_once(' ').unwrap();
    format!(
        "[[attack]]\nsensor = \"{name}\"\ninstance = {instance}\nkind = \"{kind}\"\nstart_s = 9\nduration_s = 18\n\
         magnitude = {magnitude}\n{more}\n"
    )
}

/// [Clinic] Table 1: at most this times the error without attack (1.2 is the median's over many seeds; one is
/// flown here, so the worst seed's).
const TABLE_1_WORST: f64 = 1.4;

#[test]
fn without_attack_the_secure_estimator_flies_as_well_and_flags_none() {
    let plain = fly("", 1, EstimatorKind::EkfBias);
    let secure = fly("", 1, EstimatorKind::Secure);
    assert!(secure.error_m <= 1.2 * plain.error_m, "{} against {}\n{}", secure.error_m, plain.error_m, secure.log);
    assert!(secure.flagged.is_empty() && plain.flagged.is_empty(), "{:?} {:?}", secure.flagged, plain.flagged);
}

#[test]
fn one_of_three_heights_attacked_in_every_way_is_isolated() {
    let clean = fly("", 2, EstimatorKind::EkfBias);
    for (kind, magnitude, within_s) in [
        ("zero", 0.0, 0.2),
        ("bias", 0.5, 0.2),
        ("ramp", 0.1, 1.5),
        ("noise", 0.5, 0.5),
        ("freeze", 0.0, 1.5),
        ("replay", 3.0, 5.0),
    ] {
        let out = fly(&attack("height 2", kind, magnitude, ""), 2, EstimatorKind::Secure);
        let limit_m = TABLE_1_WORST * clean.error_m;
        assert!(out.error_m <= limit_m, "{kind}: {} against {limit_m}\n{}", out.error_m, out.log);
        let found = out.flagged.get("height 2").unwrap_or_else(|| panic!("{kind}: not found\n{}", out.log));
        assert!((9.0..9.0 + within_s).contains(&found.1), "{kind}: found at {found:?}");
        assert_eq!(out.flagged.len(), 1, "{kind}: {:?}", out.flagged);
    }
}

#[test]
fn one_imu_and_one_height_attacked_together_are_isolated() {
    let clean = fly("", 1, EstimatorKind::EkfBias);
    let attacks = attack("height 2", "bias", 0.5, "") + &attack("imu 2", "bias", 2.0, "channel = \"accel\"");
    let out = fly(&attacks, 1, EstimatorKind::Secure);
    assert!(out.error_m <= TABLE_1_WORST * clean.error_m, "{} against {}\n{}", out.error_m, clean.error_m, out.log);
    for name in ["height 2", "imu 2"] {
        assert!(out.flagged.get(name).is_some_and(|f| f.1 < 9.3), "{name}: {:?}", out.flagged);
    }
}
