//! Table 1 in closed loop: altitude steps on the nonlinear simulator, with and without secure estimation.
//!
//! Three pilots fly the same seeds: the plain EKF (gates and votes open), the tuned EKF with gates and votes
//! (specific force as input, so disturbances are in it), and the secure estimator. e is the rms of true
//! altitude − setpoint; e* is the plain EKF's without attack, same rig and seed.

use plumbline_agent::estimate::EstimatorKind;
use plumbline_agent::flight::{Flight, FlightConfig};
use plumbline_agent::vehicle::sim::{Scenario, SimVehicle};
use plumbline_agent::vehicle::suite::Suite;
use plumbline_agent::vehicle::{MAX_HEIGHTS, MAX_IMUS, Vehicle};
use plumbline_proto::ids::SensorId;
use plumbline_proto::v1::SensorKind;
use plumbline_tests::report::{Plot, Report, Series};
use serde_json::json;

use crate::{Effort, median, parallel, worst};

const ATTACK_S: (f64, f64) = (9.0, 27.0);
const JUDGED_FROM_S: f64 = 8.0;
const STEPS: &str = "name = \"table_1\"\nduration_s = 30\n\
    [[script]]\nat_s = 3\ndo = \"arm\"\n[[script]]\nat_s = 4\ndo = \"mode\"\nmode = \"altitude_hold\"\n\
    [[script]]\nat_s = 5\ndo = \"setpoint\"\naltitude_m = 0.5\n[[script]]\nat_s = 12\ndo = \"setpoint\"\naltitude_m = 1.0\n\
    [[script]]\nat_s = 20\ndo = \"setpoint\"\naltitude_m = 0.6\n";
/// Strings go taut at 0.3 m, the ground is met at 0.11 m: steps down to both and up again.
const CONTACTS: &str = "name = \"contacts\"\nduration_s = 30\n\
    [[script]]\nat_s = 3\ndo = \"arm\"\n[[script]]\nat_s = 4\ndo = \"mode\"\nmode = \"altitude_hold\"\n\
    [[script]]\nat_s = 5\ndo = \"setpoint\"\naltitude_m = 0.6\n[[script]]\nat_s = 11\ndo = \"setpoint\"\naltitude_m = LOW\n\
    [[script]]\nat_s = 14\ndo = \"setpoint\"\naltitude_m = 0.7\n[[script]]\nat_s = 20\ndo = \"setpoint\"\naltitude_m = LOW\n\
    [[script]]\nat_s = 23\ndo = \"setpoint\"\naltitude_m = 0.6\n";
const RIGS: [(&str, &str); 2] = [
    ("strings", "[rig.hanging_strings]\nmode = \"flight\"\nheight_m = 0.3\n"),
    ("free", "[rig.free]\nheight_m = 0.0\n"),
];
const LIES: [&str; 5] = ["zero", "bias", "ramp", "random", "replay"];
const PLACES: [&str; 3] = ["height", "imu_and_height", "minority_of_5"];
const PILOTS: [&str; 3] = ["plain", "gated", "secure"];

/// One flight to fly.
#[derive(Clone)]
struct Plan {
    text: String,
    heights: usize,
    imus: usize,
    seed: u64,
    pilot: &'static str,
    attacked: Vec<SensorId>,
    keep_track: bool,
}

#[derive(Clone, Default)]
struct Outcome {
    error_m: f64,
    /// From the onset to the first flag of every attacked sensor, s.
    delays_s: Vec<f64>,
    missed: usize,
    /// Flags raised on honest sensors, and the longest, s.
    false_flags: usize,
    longest_false_s: f64,
    /// (t, true z, setpoint).
    track: Vec<(f64, f64, f64)>,
}

fn fly(plan: &Plan) -> Outcome {
    let mut scenario = Scenario::from_toml(&plan.text).unwrap_or_else(|e| panic!("{e}\n{}", plan.text));
    scenario.seed = plan.seed;
    let mut suite = Suite::string_rig();
    suite.heights.clear();
    (1..=plan.heights).for_each(|i| suite.heights.push(Suite::laser(i, plan.heights)));
    suite.imus.clear();
    (1..=plan.imus).for_each(|i| suite.imus.push(Suite::imu_unit(i)));
    // Attacks were checked against the scenario's own suite: sensors 1 and 2 are in every one.
    scenario.suite = suite;
    let mut config = FlightConfig::for_scenario(&scenario);
    let kind = if plan.pilot == "secure" { EstimatorKind::Secure } else { EstimatorKind::EkfBias };
    config.estimators = vec![kind];
    config.in_loop = kind;
    if plan.pilot == "plain" {
        const OPEN: f64 = 1e9;
        let gates = &mut config.ekf.gates;
        for gate in [&mut gates.heading, &mut gates.height, &mut gates.barometer] {
            *gate = OPEN;
        }
        (config.ekf.gyro_vote.gate, config.ekf.accel_vote.gate) = (OPEN, OPEN);
    }
    let mut vehicle = SimVehicle::new(&scenario).unwrap();
    let mut flight = Flight::new(config).unwrap();
    let mut outcome = Outcome::default();
    let (mut sum, mut count) = (0.0, 0.0);
    let mut before = None;
    let mut flagged: Vec<(SensorId, f64)> = Vec::new();
    let mut found: Vec<SensorId> = Vec::new();
    let ticks = (scenario.duration_s * scenario.tick_rate_hz) as usize;
    for _ in 0..ticks {
        let frame = vehicle.sense().unwrap();
        let now = frame.time;
        flight.heartbeat(now);
        scenario.script.commands(before, now, |c| {
            let _ = flight.apply(c, now);
        });
        before = Some(now);
        let command = flight.step(&frame).command;
        let applied = vehicle.actuate(&command).unwrap();
        flight.applied(applied);
        let t = now.as_seconds();
        let (z, setpoint) = (vehicle.truth().unwrap().position_enu_m.z, flight.report().setpoint.position_enu_m.z);
        if t >= JUDGED_FROM_S {
            sum += (z - setpoint).powi(2);
            count += 1.0;
        }
        if plan.keep_track {
            outcome.track.push((t, z, setpoint));
        }
        let Some(secure) = flight.secure() else { continue };
        for device in secure.identifier().devices() {
            let known = flagged.iter().position(|(id, _)| *id == device.sensor);
            match (device.flagged.is_some(), known) {
                (true, None) => {
                    flagged.push((device.sensor, t));
                    let attacked = plan.attacked.contains(&device.sensor) && t >= ATTACK_S.0;
                    if attacked && !found.contains(&device.sensor) {
                        found.push(device.sensor);
                        outcome.delays_s.push(t - ATTACK_S.0);
                    }
                    outcome.false_flags += usize::from(!attacked);
                }
                (false, Some(at)) => {
                    flagged.remove(at);
                }
                _ => {}
            }
            if let Some((_, since)) = flagged.iter().find(|(id, _)| *id == device.sensor && !plan.attacked.contains(id))
            {
                outcome.longest_false_s = outcome.longest_false_s.max(t - since);
            }
        }
    }
    outcome.missed = plan.attacked.len() - found.len();
    outcome.error_m = (sum / count).sqrt();
    outcome
}

fn attack(sensor: SensorId, lie: &str) -> String {
    let imu = sensor.kind == SensorKind::Imu;
    let (kind, magnitude, channel) = match (lie, imu) {
        ("zero", true) => ("zero", 0.0, "all"),
        ("zero", false) => ("zero", 0.0, "all"),
        ("bias", true) => ("bias", 2.0, "accel"),
        ("bias", false) => ("bias", 0.5, "all"),
        ("ramp", true) => ("ramp", 0.5, "accel"),
        ("ramp", false) => ("ramp", 0.1, "all"),
        ("random", true) => ("noise", 2.0, "accel"),
        ("random", false) => ("noise", 0.5, "all"),
        _ => ("replay", 3.0, "all"),
    };
    let name = if imu { "imu" } else { "height" };
    format!(
        "[[attack]]\nsensor = \"{name}\"\ninstance = {}\nkind = \"{kind}\"\nchannel = \"{channel}\"\nstart_s = {}\n\
         duration_s = {}\nmagnitude = {magnitude}\n",
        sensor.instance,
        ATTACK_S.0,
        ATTACK_S.1 - ATTACK_S.0
    )
}

fn attacked(place: &str) -> Vec<SensorId> {
    let height = |i| SensorId::new(SensorKind::Height, i);
    let imu = |i| SensorId::new(SensorKind::Imu, i);
    match place {
        "height" => vec![height(2)],
        "imu_and_height" => vec![height(2), imu(2)],
        "minority_of_5" => vec![height(1), height(2), imu(1), imu(2)],
        _ => Vec::new(),
    }
}

fn plan(rig: &str, place: &str, lie: &str, seed: u64, pilot: &'static str) -> Plan {
    let attacked = attacked(place);
    let attacks: String = attacked.iter().map(|sensor| attack(*sensor, lie)).collect();
    let five = place == "minority_of_5" || place == "none_of_5";
    Plan {
        text: format!("{STEPS}{rig}{attacks}"),
        heights: if five { 5 } else { 3 },
        imus: if five { 5 } else { 4 },
        seed,
        pilot,
        attacked,
        keep_track: false,
    }
}

pub fn run(report: &mut Report, effort: &Effort) {
    table_1(report, effort);
    contacts(report, effort);
    ten_minutes(report, effort);
    tracks(report);
}

fn table_1(report: &mut Report, effort: &Effort) {
    if MAX_IMUS.min(MAX_HEIGHTS) < 5 {
        report.skipped("table_1/minority_of_5", "a frame carries at most four sensors of a kind");
    }
    report.heading("Table 1 in closed loop");
    let seeds = effort.seeds as usize;
    let mut cells: Vec<(&str, &str, &str, &str)> = Vec::new();
    for (name, rig) in RIGS {
        cells.push((name, rig, "none", "none"));
        if MAX_IMUS.min(MAX_HEIGHTS) >= 5 {
            cells.push((name, rig, "none_of_5", "none"));
        }
        // The frame of this build may carry four of a kind only.
        let places = PLACES.iter().filter(|place| **place != "minority_of_5" || MAX_IMUS.min(MAX_HEIGHTS) >= 5);
        cells.extend(places.flat_map(|place| LIES.iter().map(move |lie| (name, rig, *place, *lie))));
    }
    let all = parallel(cells.len() * PILOTS.len() * seeds, |i| {
        let (cell, rest) = (cells[i / (PILOTS.len() * seeds)], i % (PILOTS.len() * seeds));
        fly(&plan(cell.1, cell.2, cell.3, 1 + (rest % seeds) as u64, PILOTS[rest / seeds]))
    });
    let of = |cell: usize, pilot: usize| {
        let first = (cell * PILOTS.len() + pilot) * seeds;
        &all[first..first + seeds]
    };
    let mut rows = Vec::new();
    for (c, (rig, _, place, lie)) in cells.iter().enumerate() {
        let five = *place == "minority_of_5" || *place == "none_of_5";
        let clean = cells.iter().position(|x| x.0 == *rig && x.2 == if five { "none_of_5" } else { "none" }).unwrap();
        let ratios = |pilot: usize| -> Vec<f64> {
            of(c, pilot).iter().zip(of(clean, 0)).map(|(o, star)| o.error_m / star.error_m).collect()
        };
        let secure = of(c, 2);
        let delays: Vec<f64> = secure.iter().flat_map(|o| o.delays_s.iter().copied()).collect();
        let missed: usize = secure.iter().map(|o| o.missed).sum();
        let false_flags: usize = secure.iter().map(|o| o.false_flags).sum();
        let longest = worst(&secure.iter().map(|o| o.longest_false_s).collect::<Vec<_>>());
        let [plain, gated, own] = [0, 1, 2].map(ratios);
        let star: Vec<f64> = of(clean, 0).iter().map(|o| o.error_m).collect();
        report.value(
            &format!("table_1/{rig}/{place}/{lie}"),
            median(&own),
            "e*",
            json!({ "worst": worst(&own), "plain_median": median(&plain), "plain_worst": worst(&plain),
                "gated_median": median(&gated), "gated_worst": worst(&gated), "e_star_m": median(&star),
                "detection_s": median(&delays), "missed": missed, "false_flags": false_flags,
                "longest_false_flag_s": longest, "seeds": seeds }),
        );
        let number = |v: f64| if v.is_finite() { format!("{v:.2}") } else { "-".to_owned() };
        rows.push(vec![
            (*rig).to_owned(),
            (*place).to_owned(),
            (*lie).to_owned(),
            number(median(&plain)),
            number(median(&gated)),
            number(median(&own)),
            number(worst(&own)),
            number(median(&delays)),
            missed.to_string(),
            false_flags.to_string(),
            number(longest),
        ]);
    }
    let headers = [
        "rig",
        "attacked",
        "attack",
        "plain EKF, e*",
        "gated EKF, e*",
        "secure, e*",
        "secure worst",
        "detected after, s",
        "missed",
        "false flags",
        "longest, s",
    ];
    report
        .table(
            "table_1",
            "Medians over the seeds of e/e*; [Clinic] Table 1 asks for at most 1.2 with, above 5 without.",
            &headers,
            &rows,
        )
        .unwrap();
}

fn contacts(report: &mut Report, effort: &Effort) {
    report.heading("String taut and slack, ground contact");
    for ((rig, text), low) in RIGS.iter().zip(["0.3", "0.05"]) {
        let seeds = effort.seeds as usize;
        let all = parallel(2 * seeds, |i| {
            let contacts = CONTACTS.replace("LOW", low);
            let base = plan(text, "none", "none", 1 + (i % seeds) as u64, PILOTS[2 * (i / seeds)]);
            fly(&Plan { text: format!("{contacts}{text}"), ..base })
        });
        let (plain, secure) = all.split_at(seeds);
        let ratios: Vec<f64> = secure.iter().zip(plain).map(|(s, p)| s.error_m / p.error_m).collect();
        let longest = worst(&secure.iter().map(|o| o.longest_false_s).collect::<Vec<_>>());
        let flags: usize = secure.iter().map(|o| o.false_flags).sum();
        report.value(
            &format!("contacts/{rig}"),
            median(&ratios),
            "e*",
            json!({ "worst": worst(&ratios), "false_flags": flags, "longest_false_flag_s": longest, "limit": 1.3, "seeds": seeds }),
        );
    }
}

fn ten_minutes(report: &mut Report, effort: &Effort) {
    report.heading("Ten minutes without attack");
    let mut text = STEPS.replace("duration_s = 30", "duration_s = 600");
    for k in 0..55 {
        let altitude = [0.8, 0.5, 1.0, 0.6][k % 4];
        text += &format!("[[script]]\nat_s = {}\ndo = \"setpoint\"\naltitude_m = {altitude}\n", 30 + 10 * k);
    }
    let flights = effort.seeds.min(6) as usize;
    let all = parallel(flights, |i| {
        let base = plan(RIGS[0].1, "none", "none", 101 + i as u64, "secure");
        fly(&Plan { text: format!("{text}{}", RIGS[0].1), ..base })
    });
    let flags: Vec<f64> = all.iter().map(|o| o.false_flags as f64).collect();
    report.value(
        "ten_minutes/false_flags",
        worst(&flags),
        "flags",
        json!({ "median": median(&flags), "limit": 1, "flights": flights }),
    );
}

fn tracks(report: &mut Report) {
    for lie in ["bias", "replay"] {
        let mut plot =
            Plot::new(&format!("One of three heights: {lie}"), "t, s", "altitude, m").band(ATTACK_S.0, ATTACK_S.1);
        let flown =
            parallel(PILOTS.len(), |i| fly(&Plan { keep_track: true, ..plan(RIGS[0].1, "height", lie, 1, PILOTS[i]) }));
        let line = |o: &Outcome, pick: fn(&(f64, f64, f64)) -> f64| {
            o.track.iter().step_by(4).map(|p| (p.0, pick(p))).collect()
        };
        plot = plot.with(Series::dashed("setpoint", line(&flown[2], |p| p.2)));
        for (name, outcome) in PILOTS.iter().zip(&flown) {
            plot = plot.with(Series::line(name, line(outcome, |p| p.1)));
        }
        report
            .figure(&format!("track_{lie}"), "True altitude on the string rig; the attack is shaded.", &plot)
            .unwrap();
    }
}
