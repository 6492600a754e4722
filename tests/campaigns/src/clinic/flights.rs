//! Table 1 in closed loop: altitude steps on the nonlinear simulator, with and without secure estimation.
//!
//! Six pilots fly the same seeds:
//!
//! | pilot | what |
//! |---|---|
//! | plain | the EKF, gates and votes open: everything that arrives is averaged |
//! | augmented | the filter behind the decoder (specific force as input, so that strings and ground are in it), no gate, no vote, no decoder, its noise tuned on clean flights of other seeds |
//! | gated | the EKF that flies by default, with its gates and votes |
//! | decoder | the source's scheme: window decoder, identification and the filter on what is clean |
//! | lanes | the secure estimator that flies by default |
//! | oracle | lanes, which never hear the attacked sensors while they attack: what no identification can beat but by filtering better |
//!
//! e is the rms of true altitude − setpoint, always; e* is the plain EKF's without attack, same rig and seed. A pilot that
//! loses altitude hold is judged by the script's altitude from then on.

use plumbline_proto::ids::SensorId;
use plumbline_proto::v1::SensorKind;
use plumbline_tests::report::{Plot, Report, Series};
use serde_json::json;

use super::Effort;
use super::flight::{
    ATTACK_S, CLEAR_M, FREE, GROUND, Outcome, PILOTS, Pilot, Plan, RIGS, STEPS, STRINGS, TAUT, Tuning, fly,
};
use plumbline_experiment::draw::{median, parallel, worst};

const ATTACKS: [&str; 5] = ["zero", "bias", "ramp", "random", "replay"];
const PLACES: [&str; 4] = ["height", "imu_and_height", "minority_of_5", "height_of_2"];
/// The pilots' names, and where the two that are judged stand among them.
const NAMES: [&str; PILOTS] = ["plain", "augmented", "gated", "decoder", "lanes", "oracle"];
const DECODER: usize = 3;
const LANES: usize = 4;
/// [Clinic] Table 1: with attack and secure estimation at most this, median over the seeds …
const WITH: f64 = 1.2;
/// … and worst …
const WORST: f64 = 1.4;
/// … and without it more than this.
const WITHOUT: f64 = 5.0;
/// Strings and ground, against the undisturbed flight.
const DISTURBED: f64 = 1.3;
/// A healthy sensor may be flagged so long, s.
const FALSE_FLAG_S: f64 = 0.5;

pub fn run(report: &mut Report, effort: &Effort) {
    let tuning = tune(report, effort);
    table_1(report, effort, tuning);
    majority(report, effort);
    contacts(report, effort);
    ten_minutes(report, effort);
    tracks(report, effort, tuning);
}

/// The noise with which the augmented filter estimates altitude best on clean flights, on seeds that no table flies.
fn tune(report: &mut Report, effort: &Effort) -> Tuning {
    const SEEDS: usize = 3;
    report.heading("The augmented filter's noise");
    let choices: Vec<Tuning> = [0.3, 0.6, 1.0, 2.0, 4.0]
        .into_iter()
        .flat_map(|height| [0.3, 1.0, 3.0, 10.0].map(|accel| Tuning { height, accel }))
        .collect();
    let all = parallel(choices.len() * RIGS.len() * SEEDS, |i| {
        let (choice, rest) = (choices[i / (RIGS.len() * SEEDS)], i % (RIGS.len() * SEEDS));
        let plan = Plan::new(
            RIGS[rest / SEEDS].1,
            STEPS,
            effort.flown.seed(901 + (rest % SEEDS) as u64),
            Pilot::Augmented(choice),
        );
        fly(&Plan { world: effort.flown.world.clone(), ..plan })
    });
    let scores: Vec<f64> = all
        .chunks(RIGS.len() * SEEDS)
        .map(|flights| median(&flights.iter().map(|o| o.estimate_m).collect::<Vec<_>>()))
        .collect();
    let best = (0..choices.len()).min_by(|a, b| scores[*a].total_cmp(&scores[*b])).unwrap();
    let Tuning { height, accel } = choices[best];
    let untouched = choices.iter().position(|c| *c == Tuning { height: 1.0, accel: 1.0 }).unwrap();
    report.value(
        "augmented/estimate",
        1e3 * scores[best],
        "mm rms",
        json!({ "height_sigma_factor": height, "accel_noise_factor": accel, "untuned_mm": 1e3 * scores[untouched],
            "choices": choices.len(), "flights_each": RIGS.len() * SEEDS }),
    );
    choices[best]
}

/// One row of Table 1.
#[derive(Clone, Copy)]
struct Cell {
    rig: (&'static str, &'static str),
    place: &'static str,
    attack: &'static str,
}

impl Cell {
    /// The flights that e* comes from.
    fn is_reference_of(&self, other: &Cell) -> bool {
        let of = |place: &str| [2, 5].into_iter().find(|count| place.ends_with(&format!("_of_{count}")));
        self.rig.0 == other.rig.0 && self.attack == "none" && of(self.place) == of(other.place)
    }

    /// What is asked of median and worst ratio, and of the ratio without secure estimation.
    fn limits(&self) -> (Option<f64>, Option<f64>, Option<f64>) {
        match (self.place, self.attack) {
            ("none" | "none_of_5" | "none_of_2", _) => (Some(WITH), None, None),
            ("height", _) => (Some(WITH), Some(WORST), Some(WITHOUT)),
            ("imu_and_height", attack) if attack != "replay" => (Some(WITH), None, None),
            // Replay on an IMU and a height, 40 % of five, and one of his two lasers, which have no majority: as measured.
            _ => (None, None, None),
        }
    }
}

fn table_1(report: &mut Report, effort: &Effort, tuning: Tuning) {
    report.heading("Table 1 in closed loop");
    let pilots = Pilot::every(tuning);
    let seeds = effort.seeds();
    let mut cells: Vec<Cell> = Vec::new();
    for rig in RIGS {
        cells.extend(["none", "none_of_5", "none_of_2"].map(|place| Cell { rig, place, attack: "none" }));
        cells.extend(PLACES.iter().flat_map(|place| ATTACKS.map(|attack| Cell { rig, place, attack })));
    }
    let all = parallel(cells.len() * pilots.len() * seeds, |i| {
        let (cell, rest) = (cells[i / (pilots.len() * seeds)], i % (pilots.len() * seeds));
        let plan = effort.plan(cell.rig.1, STEPS, rest % seeds, pilots[rest / seeds]);
        fly(&plan.under_attack(cell.place, cell.attack))
    });
    let pilots_of = |cell: usize| -> [&[Outcome]; PILOTS] {
        std::array::from_fn(|pilot| {
            let first = (cell * pilots.len() + pilot) * seeds;
            &all[first..first + seeds]
        })
    };
    let mut rows = Vec::new();
    for (c, cell) in cells.iter().enumerate() {
        let clean = cells.iter().position(|other| other.is_reference_of(cell)).unwrap();
        let (flown, clean) = (pilots_of(c), pilots_of(clean));
        rows.push(row(report, cell, &flown, &clean));
    }
    let headers = [
        "rig",
        "attacked",
        "attack",
        "plain EKF, e*",
        "augmented, e*",
        "gated EKF, e*",
        "decoder, e*",
        "decoder worst, e*",
        "lanes, e*",
        "lanes worst, e*",
        "oracle, e*",
        "oracle worst, e*",
        "lanes, tuned e*",
        "estimate, mm rms",
        "detected after, s",
        "missed",
        "false flags",
        "longest, s",
        "with · worst · without",
    ];
    report
        .table(
            "table_1",
            "Medians over the seeds of e/e*, e the true altitude less the setpoint. Limits: with secure estimation (decoder, lanes) at most \
             1.2 (worst seed of an attacked height 1.4), without it (plain EKF) above 5. The oracle never hears who is attacked. \
             Tuned e* is the augmented filter's without attack. Detection and flags are the lanes'. \
             An operator with the stick keeps the vehicle over its place, as in every campaign: left alone it drifts into its strings, \
             which hold the altitude for whoever estimates it badly. A flight that lost its hold is measured to its end.",
            &headers,
            &rows,
        )
        .unwrap();
}

/// What came of one cell, of each pilot's flights, beside the flights without attack: a line of the report, and the row.
fn row(report: &mut Report, cell: &Cell, flown: &[&[Outcome]; PILOTS], clean: &[&[Outcome]; PILOTS]) -> Vec<String> {
    let over = |flown: &[Outcome], star: &[Outcome]| -> Vec<f64> {
        flown.iter().zip(star).map(|(o, star)| o.error_m / star.error_m).collect()
    };
    let ratios: [Vec<f64>; PILOTS] = std::array::from_fn(|pilot| over(flown[pilot], clean[0]));
    let against_tuned = median(&over(flown[LANES], clean[1]));
    let secure = flown[LANES];
    let delays: Vec<f64> = secure.iter().flat_map(|o| o.delays_s.iter().copied()).collect();
    let missed: usize = secure.iter().map(|o| o.missed).sum();
    let false_flags: usize = secure.iter().map(|o| o.false_flags).sum();
    let false_exclusions: Vec<String> =
        secure.iter().flat_map(|o| o.false_exclusions.iter().map(SensorId::to_string)).collect();
    let longest = worst(&secure.iter().map(|o| o.longest_false_s).collect::<Vec<_>>());
    let star: Vec<f64> = clean[0].iter().map(|o| o.error_m).collect();
    let estimate_mm = 1e3 * median(&secure.iter().map(|o| o.estimate_m).collect::<Vec<_>>());
    let lost = flown.map(|flights| flights.iter().filter(|o| o.lost).count());
    let limits = cell.limits();
    let met = |pilot: usize| {
        [
            limits.0.map(|limit| median(&ratios[pilot]) <= limit),
            limits.1.map(|limit| worst(&ratios[pilot]) <= limit),
            limits.2.map(|limit| median(&ratios[0]) > limit),
        ]
    };
    let all: serde_json::Map<_, _> = NAMES
        .iter()
        .zip(&ratios)
        .zip(lost)
        .map(|((name, ratios), lost)| {
            ((*name).to_owned(), json!({ "median": median(ratios), "worst": worst(ratios), "lost_hold": lost }))
        })
        .collect();
    report.value(
        &format!("table_1/{}/{}/{}", cell.rig.0, cell.place, cell.attack),
        median(&ratios[LANES]),
        "e*",
        json!({ "worst": worst(&ratios[LANES]), "pilots": all, "e_star_m": median(&star),
            "median_against_tuned_e_star": against_tuned, "estimate_rms_mm": estimate_mm,
            "detection_s": median(&delays), "missed": missed, "false_flags": false_flags, "false_exclusions": false_exclusions,
            "longest_false_flag_s": longest, "seeds": secure.len(),
            "limit": limits.0, "limit_worst": limits.1, "limit_without": limits.2,
            "met": met(LANES), "met_by_decoder": met(DECODER) }),
    );
    let number = |v: f64| if v.is_finite() { format!("{v:.2}") } else { "-".to_owned() };
    vec![
        cell.rig.0.to_owned(),
        cell.place.to_owned(),
        cell.attack.to_owned(),
        number(median(&ratios[0])),
        number(median(&ratios[1])),
        number(median(&ratios[2])),
        number(median(&ratios[DECODER])),
        number(worst(&ratios[DECODER])),
        number(median(&ratios[LANES])),
        number(worst(&ratios[LANES])),
        number(median(&ratios[5])),
        number(worst(&ratios[5])),
        number(against_tuned),
        number(estimate_mm),
        number(median(&delays)),
        missed.to_string(),
        false_flags.to_string(),
        number(longest),
        verdict(&met(LANES)),
    ]
}

/// "met", "missed" or "-" where nothing is asked, one for each limit.
fn verdict(met: &[Option<bool>]) -> String {
    let word = |m: &Option<bool>| m.map_or("-", |m| if m { "met" } else { "missed" });
    met.iter().map(word).collect::<Vec<_>>().join(" · ")
}

/// More and more of five heights attack together: up to two are recovered, three and more are the majority.
fn majority(report: &mut Report, effort: &Effort) {
    report.heading("Up to all heights compromised, in closed loop");
    let seeds = effort.seeds().min(8);
    let all = parallel(6 * seeds, |i| {
        let plan = effort.plan(STRINGS.1, STEPS, i % seeds, Pilot::Lanes).under_attack("none_of_5", "bias");
        fly(&Plan { attacked: (1..=(i / seeds) as u8).map(|h| SensorId::new(SensorKind::Height, h)).collect(), ..plan })
    });
    let of = |attacked: usize| all[attacked * seeds..(attacked + 1) * seeds].iter().zip(&all[..seeds]);
    let ratio = |attacked: usize| median(&of(attacked).map(|(o, clean)| o.error_m / clean.error_m).collect::<Vec<_>>());
    for attacked in 1..=5 {
        let expected = if 2 * attacked > 5 { "no promise" } else { "recovered" };
        report.value(
            &format!("majority/{attacked}_of_5"),
            ratio(attacked),
            "e*",
            json!({ "theory": expected, "seeds": seeds }),
        );
    }
    let plot = Plot::new("Heights attacked by the same 0.5 m", "attacked of 5", "e / e*")
        .with(Series::line("lanes", (0..=5).map(|attacked| (attacked as f64, ratio(attacked))).collect()));
    report.figure("majority", "Medians; theory: recovered below half, not beyond.", &plot).unwrap();
}

fn contacts(report: &mut Report, effort: &Effort) {
    report.heading("String taut and slack, ground contact");
    report.paragraph(
        "Setpoints that taut strings or the ground do not let the vehicle down to count whole: e has them in it, that of the \
         undisturbed flight, half a metre higher, has not.",
    );
    let seeds = effort.seeds();
    for (name, rig, profile) in [("strings", STRINGS.1, TAUT), ("ground", FREE.1, GROUND)] {
        let all = parallel(3 * seeds, |i| {
            let n = i % seeds;
            match i / seeds {
                0 => fly(&effort.plan(FREE.1, profile, n, Pilot::Plain).raised(CLEAR_M)),
                1 => fly(&effort.plan(rig, profile, n, Pilot::Plain)),
                _ => fly(&effort.plan(rig, profile, n, Pilot::Lanes)),
            }
        });
        let over = |of: usize| -> Vec<f64> {
            (0..seeds).map(|s| all[2 * seeds + s].error_m / all[of * seeds + s].error_m).collect()
        };
        let secure = &all[2 * seeds..];
        let longest = worst(&secure.iter().map(|o| o.longest_false_s).collect::<Vec<_>>());
        let flags: usize = secure.iter().map(|o| o.false_flags).sum();
        let false_exclusions: Vec<String> =
            secure.iter().flat_map(|o| o.false_exclusions.iter().map(SensorId::to_string)).collect();
        let (undisturbed, plain) = (over(0), over(1));
        report.value(
            &format!("contacts/{name}"),
            median(&undisturbed),
            "undisturbed e*",
            json!({ "worst": worst(&undisturbed), "against_plain_same_flight": median(&plain),
                "estimate_rms_mm": 1e3 * median(&secure.iter().map(|o| o.estimate_m).collect::<Vec<_>>()),
                "undisturbed_e_star_m": median(&all[..seeds].iter().map(|o| o.error_m).collect::<Vec<_>>()),
                "false_flags": flags, "false_exclusions": false_exclusions, "longest_false_flag_s": longest,
                "limit": DISTURBED, "met": median(&undisturbed) <= DISTURBED, "limit_flag_s": FALSE_FLAG_S,
                "met_flag": longest <= FALSE_FLAG_S, "seeds": seeds }),
        );
    }
}

fn ten_minutes(report: &mut Report, effort: &Effort) {
    report.heading("Ten minutes without attack");
    let mut profile = STEPS.to_vec();
    profile.extend((0..55).map(|k| (30.0 + 10.0 * k as f64, [0.8, 0.5, 1.0, 0.6][k % 4])));
    let flights = effort.seeds().min(6);
    let all = parallel(flights, |i| {
        fly(&Plan { duration_s: 600.0, ..effort.plan(STRINGS.1, &profile, 100 + i, Pilot::Lanes) })
    });
    let flags: Vec<f64> = all.iter().map(|o| o.false_flags as f64).collect();
    let false_exclusions: Vec<String> =
        all.iter().flat_map(|o| o.false_exclusions.iter().map(SensorId::to_string)).collect();
    report.value(
        "ten_minutes/false_flags",
        worst(&flags),
        "flags",
        json!({ "median": median(&flags), "false_exclusions": false_exclusions, "limit": 1, "met": worst(&flags) <= 1.0,
            "lost_hold": all.iter().filter(|o| o.lost).count(), "flights": flights }),
    );
}

fn tracks(report: &mut Report, effort: &Effort, tuning: Tuning) {
    for attack in ["bias", "ramp", "replay"] {
        let mut plot =
            Plot::new(&format!("One of three heights: {attack}"), "t, s", "altitude, m").band(ATTACK_S.0, ATTACK_S.1);
        let pilots = Pilot::every(tuning);
        let flown = parallel(pilots.len(), |i| {
            let plan = effort.plan(STRINGS.1, STEPS, 0, pilots[i]).under_attack("height", attack);
            fly(&Plan { keep_track: true, ..plan })
        });
        let line = |o: &Outcome, pick: fn(&(f64, f64, f64)) -> f64| {
            o.track.iter().step_by(4).map(|p| (p.0, pick(p))).collect()
        };
        plot = plot.with(Series::dashed("setpoint", line(&flown[LANES], |p| p.2)));
        for (name, outcome) in NAMES.iter().zip(&flown) {
            plot = plot.with(Series::line(name, line(outcome, |p| p.1)));
        }
        report
            .figure(&format!("track_{attack}"), "True altitude on the string rig; the attack is shaded.", &plot)
            .unwrap();
    }
}
