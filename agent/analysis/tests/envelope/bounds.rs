//! The attack envelope against its prototype, and against other people's solver.

use plumbline_analysis::envelope::flying::Regime;
use plumbline_analysis::envelope::program::{Memory, Program, Statistic};
use plumbline_analysis::envelope::prototype::Prototype;
use plumbline_analysis::envelope::sets::{Asked, Verdict, verdict};
use plumbline_analysis::envelope::{Deviation, EnvelopeError, Model, Response, Signal, program, recession_mps};
use plumbline_core::sensor::suite::Suite;
use plumbline_proto::ids::SensorId;
use plumbline_rest::envelope::{EnvelopeMultiplier, EnvelopeQuestion, EnvelopeSet, Swing};
use rand::{RngExt as _, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;

fn of(lasers: usize, attacked: usize, imus: usize, gate_only: bool) -> Prototype {
    let (attacked_lasers, attacked_imus) = ((0..attacked).collect(), (0..imus).collect());
    Prototype { lasers, attacked_lasers, attacked_imus, gate_only }
}

/// The table of the prototype, cm over 10 s, and beside it with sample gates only.
const TABLE: [(usize, usize, usize, f64, f64); 8] = [
    (3, 1, 0, 4.8, 14.1),
    (3, 2, 0, 9.5, 18.5),
    (5, 1, 0, 2.9, 6.2),
    (5, 2, 0, 7.5, 16.3),
    (5, 4, 0, 11.3, 17.9),
    (3, 0, 1, 8.7, 73.0),
    (3, 0, 2, 25.0, 74.0),
    (3, 1, 1, 13.5, 73.0),
];

#[test]
fn the_table_of_the_prototype() {
    for (lasers, attacked, imus, voted, gated) in TABLE {
        for (gate_only, expected) in [(false, voted), (true, gated)] {
            let model = of(lasers, attacked, imus, gate_only);
            let bound = program(&model, 10.0, Deviation::Place).unwrap().solve().unwrap();
            let (upper, reached) = (100.0 * bound.upper, 100.0 * bound.reached);
            println!(
                "{attacked} of {lasers}, {imus} IMUs, gates only {gate_only}: {reached:.3} to {upper:.3} cm (prototype {expected}), {} steps, {:?}",
                bound.steps, bound.binding
            );
            assert!((upper / expected - 1.0).abs() < 0.05, "{upper} cm, prototype {expected}");
            assert!(reached > 0.99 * upper && reached <= upper, "{reached} {upper}");
        }
    }
}

/// Ten drawn cases of `tests/python/make_envelope.py`: model and solver are other people's.
#[test]
fn ten_drawn_cases_are_those_of_cvxpy() {
    let text = include_str!("../../../../tests/fixtures/reference/envelope_cvxpy.json");
    let recorded: serde_json::Value = serde_json::from_str(text).unwrap();
    let cases = recorded["cases"].as_array().unwrap();
    assert_eq!(cases.len(), 10);
    for case in cases {
        let count = |key: &str| case[key].as_u64().unwrap() as usize;
        let model = of(count("lasers"), count("attacked"), count("imus"), case["gate_only"].as_bool().unwrap());
        let horizon_s = case["horizon_s"].as_f64().unwrap();
        let bound = program(&model, horizon_s, Deviation::Place).unwrap().solve().unwrap();
        let theirs = case["altitude_m"].as_f64().unwrap();
        println!("{case}: {} to {}", bound.reached, bound.upper);
        assert!(bound.reached <= theirs * 1.001 && bound.upper >= theirs * 0.999, "{case}: {bound:?}");
        assert!((bound.upper / theirs - 1.0).abs() < 0.002, "{case}: {}", bound.upper);
    }
}

#[test]
fn all_lasers_have_no_end_and_two_of_three_have() {
    let silent_mps = recession_mps(&of(3, 3, 0, false)).unwrap().unwrap();
    println!("all lasers drift with {silent_mps:.4} m/s for ever");
    assert!(silent_mps > 0.001);
    assert_eq!(recession_mps(&of(3, 2, 0, false)).unwrap(), None);
}

/// A model that is followed for every sample.
struct Followed<'a>(&'a dyn Model);

impl Model for Followed<'_> {
    fn attacked(&self) -> Vec<(SensorId, f64, f64)> {
        self.0.attacked()
    }

    fn squares(&self) -> Vec<(&'static str, Memory)> {
        self.0.squares()
    }

    fn respond(
        &self,
        horizon_s: f64,
        width: usize,
        attack: &dyn Fn(SensorId, usize) -> Signal,
    ) -> Result<Response, EnvelopeError> {
        self.0.respond(horizon_s, width, attack)
    }
}

#[test]
fn what_one_period_tells_is_what_following_every_sample_tells() {
    let asked = asked(EnvelopeQuestion::default()).unwrap();
    for (names, regime) in [(["height 2", "imu 1"], Regime::Full), (["height 1", "height 3"], Regime::Outvoted)] {
        let set: Vec<SensorId> = names.iter().map(|name| name.parse().unwrap()).collect();
        let model = asked.flying.attacked(&set, regime).unwrap();
        assert!(model.period_s(3.02) < 1.0);
        for deviation in [Deviation::Place, Deviation::Speed] {
            let short = program(&model, 3.02, deviation).unwrap();
            let long = program(&Followed(&model), 3.02, deviation).unwrap();
            assert!((&short.objective - &long.objective).amax() < 1e-12 * long.objective.amax());
            assert_eq!((short.statistics.len(), &short.most), (long.statistics.len(), &long.most));
            for (a, b) in short.statistics.iter().zip(&long.statistics) {
                assert_eq!((a.detector, a.sensor, a.time_s, a.limit), (b.detector, b.sensor, b.time_s, b.limit));
                assert!((&a.row - &b.row).amax() <= 1e-12 * b.row.amax(), "{a:?} {b:?}");
            }
        }
    }
}

fn asked(question: EnvelopeQuestion) -> Result<Asked, EnvelopeError> {
    Asked::new(&question, None)
}

fn refused(question: EnvelopeQuestion) -> String {
    asked(question).unwrap_err().to_string()
}

/// Largest objective, by a solver that knows nothing of ours.
fn by_clarabel(program: &Program) -> f64 {
    use clarabel::algebra::CscMatrix;
    use clarabel::solver::{DefaultSettings, DefaultSolver, IPSolver, SolverStatus, SupportedConeT};
    let n = program.objective.len();
    let (mut i, mut j, mut v, mut rhs) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    let one = |most: &f64, column: usize| (*most, vec![(column, 1.0)]);
    let bounds = program.most.iter().zip(0..).map(|(most, column)| one(most, column));
    let limits = program.statistics.iter().map(|s| (s.limit, (0..n).zip(s.row.iter().copied()).collect::<Vec<_>>()));
    for (limit, row) in bounds.chain(limits) {
        for sign in [1.0, -1.0] {
            for (column, x) in row.iter().filter(|(_, x)| *x != 0.0) {
                i.push(rhs.len());
                j.push(*column);
                v.push(sign * x / limit);
            }
            rhs.push(1.0);
        }
    }
    let mut cones = vec![SupportedConeT::NonnegativeConeT(rhs.len())];
    // A sum of squares at each time: a cone each.
    for end in &program.statistics {
        let Some((_, memory)) = program.squares.iter().find(|(detector, _)| *detector == end.detector) else {
            continue;
        };
        let mine = program.statistics.iter().filter(|s| (s.detector, s.sensor) == (end.detector, end.sensor));
        let counted = mine.map(|s| (s, memory.weight(end.time_s - s.time_s))).filter(|(_, weight)| *weight > 0.0);
        let before = rhs.len();
        rhs.push(1.0);
        for (s, weight) in counted {
            for (column, x) in s.row.iter().enumerate().filter(|(_, x)| **x != 0.0) {
                i.push(rhs.len());
                j.push(column);
                v.push(weight.sqrt() * x / s.limit);
            }
            rhs.push(0.0);
        }
        cones.push(SupportedConeT::SecondOrderConeT(rhs.len() - before));
    }
    let a = CscMatrix::new_from_triplets(rhs.len(), n, i, j, v);
    let c: Vec<f64> = program.objective.iter().map(|c| -c).collect();
    let settings = DefaultSettings { verbose: false, ..DefaultSettings::default() };
    let mut solver = DefaultSolver::new(&CscMatrix::zeros((n, n)), &c, &a, &rhs, &cones, settings).unwrap();
    solver.solve();
    assert_eq!(solver.solution.status, SolverStatus::Solved);
    -solver.solution.obj_val
}

#[test]
fn another_solver_finds_the_same_optima() {
    let posed = asked(EnvelopeQuestion { more: Some("pose".into()), ..EnvelopeQuestion::default() }).unwrap();
    let asked = asked(EnvelopeQuestion::default()).unwrap();
    for n in 0..13usize {
        let deviation = if n == 4 { Deviation::Speed } else { Deviation::Place };
        let horizon_s = if n < 10 { 3.0 + 0.2 * n as f64 } else { 3.0 };
        let program = if n % 2 == 0 && n < 10 {
            program(&of(3 + n % 4, 1 + n % 3, n % 3, n == 8), horizon_s, deviation)
        } else {
            let set = match n {
                9 => &asked.flying.sensors[..2],
                // Squares of the vote and of evidence.
                10 => &asked.flying.sensors[3..4],
                11 | 12 => &asked.flying.sensors[4..6],
                _ => &asked.flying.sensors[n % 3..=n % 3],
            };
            let regime = if n == 9 { Regime::Outvoted } else { Regime::Full };
            let flying = if n == 12 { &posed.flying } else { &asked.flying };
            program(&flying.attacked(set, regime).unwrap(), horizon_s, deviation)
        }
        .unwrap();
        let (bound, theirs) = (program.solve().unwrap(), by_clarabel(&program));
        println!("{n}, {horizon_s} s: {} ≤ {theirs} ≤ {}", bound.reached, bound.upper);
        assert!(bound.reached <= theirs * (1.0 + 1e-6) && theirs <= bound.upper * (1.0 + 1e-6), "{n}: {theirs}");
        assert!(bound.upper < 1.002 * theirs, "{n}: {theirs}, {}", bound.upper);
    }
}

#[test]
fn every_set_of_two_of_the_default_suite_has_a_bound_and_all_heights_have_none() {
    let answer = asked(EnvelopeQuestion { climb: true, ..EnvelopeQuestion::default() })
        .unwrap()
        .answer(|set| {
            println!("{set:?}");
            true
        })
        .unwrap();
    assert_eq!(answer.sets.len(), 7 + 21 + 1);
    let (all, bounded) = answer.sets.split_last().unwrap();
    assert_eq!(all.sensors, ["height 1", "height 2", "height 3"]);
    assert!(all.altitude_m.is_none() && all.drift_mps.is_some_and(|drift| drift > 0.001));
    for set in bounded {
        let (upper, reached) = (set.altitude_m.unwrap(), set.reached_m.unwrap());
        assert!(reached > 0.0 && reached <= upper && reached > 0.99 * upper, "{set:?}");
        assert!(set.climb_mps.is_some() && set.binding.is_some() && set.drift_mps.is_none(), "{set:?}");
    }
    // What is alike has one program: one IMU, two of them, each height with one of them.
    assert_eq!(answer.sets.iter().filter(|set| set.took_ms > 0.0).count(), 3 + 1 + 3 + 1 + 3 + 1);
    // Whoever has one sensor more can do as much.
    let of = |names: &[&str]| answer.sets.iter().find(|set| set.sensors == names).unwrap().altitude_m.unwrap();
    assert!(of(&["height 1", "height 2"]) > of(&["height 1"]).max(of(&["height 2"])));
    assert!(of(&["imu 1", "imu 2"]) > of(&["imu 1"]) && of(&["height 1", "imu 1"]) > of(&["height 1"]));
}

/// GIVEN lasers that sample at moments drawn for each, on ticks, WHEN one is attacked, or one and an IMU, THEN what is told is no less than
/// what these moments allow; and moments matter.
#[test]
fn a_bound_holds_whenever_the_heights_sample() {
    let mut dice = Xoshiro256PlusPlus::seed_from_u64(5);
    for (names, draws) in [(&["height 1"][..], 20), (&["height 3"], 20), (&["height 1", "imu 1"], 8)] {
        let of = |suite: Suite| {
            let sensors = Some(names.iter().map(|name| (*name).to_owned()).collect());
            Asked::new(&EnvelopeQuestion { sensors, ..EnvelopeQuestion::default() }, Some(suite)).unwrap()
        };
        let told = of(Suite::string_rig()).answer(|_| true).unwrap().sets[0].altitude_m.unwrap();
        let drawn = (0..draws).map(|_| {
            let mut suite = Suite::string_rig();
            suite.heights.iter_mut().for_each(|h| h.timing.phase_s = 0.005 * f64::from(dice.random_range(0..20_u8)));
            let asked = of(suite);
            let found = verdict(&asked.flying, &asked.sets[0], 10.0, Deviation::Place).unwrap();
            let Verdict::Bounded(bound, _) = found.verdict else { panic!("{names:?} has no bound") };
            bound.upper
        });
        let (least, most) = drawn.fold((f64::INFINITY, 0.0_f64), |(l, m), own| (l.min(own), m.max(own)));
        println!("{names:?}: {least:.4} to {most:.4} m, told {told:.4}");
        assert!(most <= 1.01 * told && least < 0.9 * told, "{names:?}: {least} to {most} of {told}");
    }
}

#[test]
fn the_bound_is_the_sum_of_the_certificate_told_and_the_sequence_told_reaches_what_it_says() {
    for (names, regime) in [
        (&["height 2"][..], Regime::Full),
        (&["imu 1"], Regime::Full),
        (&["imu 1", "imu 2"], Regime::Full),
        (&["height 1", "height 2"], Regime::Outvoted),
    ] {
        let sensors = Some(names.iter().map(|name| (*name).to_owned()).collect());
        let question = EnvelopeQuestion { sensors, proof: true, horizon_s: Some(5.0), ..EnvelopeQuestion::default() };
        let asked = asked(question).unwrap();
        let set = asked.answer(|_| true).unwrap().sets.remove(0);
        let told = set.certificate.unwrap();
        let sum: f64 = told.multipliers.iter().map(|one| one.multiplier.abs() * one.limit).sum();
        assert!(((sum + told.added_m) / set.altitude_m.unwrap() - 1.0).abs() < 1e-9, "{names:?}: {sum}");
        assert_eq!(told.regime, if regime == Regime::Full { "full" } else { "outvoted" });
        // The rest is what they leave of c, in the program as it stands.
        let flying = asked.flying.at_worst_moments(&asked.sets[0]);
        let model = flying.attacked(&asked.sets[0], regime).unwrap();
        let program = program(&model, told.end_s, Deviation::Place).unwrap();
        let found = verdict(&flying, &asked.sets[0], 5.0, Deviation::Place).unwrap();
        let Verdict::Bounded(bound, _) = found.verdict else { panic!("{names:?} has no bound") };
        let mut left = program.objective.clone();
        for (one, of) in told.multipliers.iter().zip(&bound.certificate) {
            assert_eq!((one.multiplier, one.statistics), (of.value, of.of.len()));
            let mut row = Signal::zeros(left.len());
            for (place, part) in &of.of {
                let statistic = &program.statistics[*place];
                assert_eq!((statistic.detector, statistic.sensor), (of.detector, of.sensor));
                row.axpy(*part, &statistic.row, 1.0);
            }
            assert_eq!(one.row, row.as_slice());
            left.axpy(-one.multiplier, &row, 1.0);
        }
        assert_eq!((told.objective.as_slice(), &told.most), (program.objective.as_slice(), &program.most));
        let cut = |one: &EnvelopeMultiplier| one.statistics > 1;
        assert_eq!(told.multipliers.iter().any(cut), names.contains(&"imu 1"), "{names:?}");
        let rest: f64 = left.iter().zip(&program.most).map(|(left, most)| left.abs() * most).sum();
        assert!((rest - told.added_m).abs() < 1e-9 * set.altitude_m.unwrap(), "{names:?}: {rest} {}", told.added_m);
        // The sequence is silent, but for the reach, whose limit is proved apart, and goes so far.
        let attack = Signal::from_iterator(
            program.objective.len(),
            set.attack
                .iter()
                .flat_map(|one| one.values.iter().take((told.end_s / one.period_s + 1e-9) as usize).copied()),
        );
        assert!((program.objective.dot(&attack) / set.reached_m.unwrap() - 1.0).abs() < 1e-9);
        let loud = |s: &&Statistic| s.detector != "height reach" && s.row.dot(&attack).abs() > s.limit * (1.0 + 1e-6);
        assert!(!program.statistics.iter().any(|s| loud(&s)), "{names:?}");
    }
}

fn aside(axis: &str, more: Option<&str>) -> EnvelopeQuestion {
    EnvelopeQuestion { axis: Some(axis.into()), more: more.map(Into::into), ..EnvelopeQuestion::default() }
}

#[test]
fn every_set_has_a_tilt_and_a_velocity_or_nobody_who_judges_it() {
    let mut tilts = Vec::new();
    for (axis, more) in [("x", None), ("x", Some("gnss")), ("x", Some("pose")), ("y", None)] {
        let tell = |set: &EnvelopeSet| {
            println!("{axis} {more:?} {set:?}");
            true
        };
        let answer = asked(aside(axis, more)).unwrap().answer(tell).unwrap();
        let of = |names: &[&str]| answer.sets.iter().find(|set| set.sensors == names).unwrap();
        let one = of(&["imu 1"]);
        assert!(one.reached.is_some_and(|part| part > 0.5 && part <= 1.0), "{one:?}");
        assert!(one.tilt_rad.is_some_and(|tilt| tilt > 1e-3 && tilt < 0.1) && one.velocity_mps.is_some(), "{one:?}");
        // Position is told where something measures it, and who attacks that is judged by nobody; so are two of four IMUs without it.
        assert_eq!(one.position_m.is_some(), more.is_some());
        // Two of four jump before anything tells them from the others.
        let two = of(&["imu 1", "imu 2"]);
        assert!(two.tilt_rad.is_none() && two.binding.is_none(), "{two:?}");
        if let Some(more) = more {
            let name = if more == "pose" { "mocap pose 1" } else { "gnss 1" };
            let aid = of(&[name]);
            assert!(aid.tilt_rad.is_none() && aid.position_m.is_none() && aid.binding.is_none(), "{aid:?}");
        }
        tilts.push(one.tilt_rad.unwrap());
    }
    // Axes differ by their inertia alone, which the gains make up for.
    assert!((tilts[3] / tilts[0] - 1.0).abs() < 0.01, "{tilts:?}");
}

#[test]
fn horizontal_programs_are_those_of_another_solver() {
    let imu = ["imu 1".parse().unwrap()];
    let swing = Some(Swing { amplitude_m: 0.5, period_s: 4.0 });
    for (axis, more, swing, deviation) in [
        ("x", None, None, Deviation::Tilt),
        ("y", Some("pose"), None, Deviation::Place),
        ("y", Some("pose"), swing, Deviation::Place),
        ("x", Some("gnss"), None, Deviation::Speed),
    ] {
        let asked = asked(EnvelopeQuestion { swing, ..aside(axis, more) }).unwrap();
        let program = asked.lateral.unwrap().program(&imu, 3.0, deviation, 2).unwrap().unwrap();
        let (bound, theirs) = (program.solve().unwrap(), by_clarabel(&program));
        println!("{axis} {more:?} {deviation:?}: {} ≤ {theirs} ≤ {}", bound.reached, bound.upper);
        assert!(bound.reached <= theirs * (1.0 + 1e-6) && theirs <= bound.upper * (1.0 + 1e-6));
        assert!(bound.upper < 1.002 * theirs, "{theirs}, {}", bound.upper);
    }
}

#[test]
fn what_cannot_be_bounded_says_why_with_the_value() {
    let question = EnvelopeQuestion::default;
    let of = |names: &[&str]| Some(names.iter().map(|name| (*name).to_owned()).collect::<Vec<_>>());
    assert_eq!(
        refused(EnvelopeQuestion { sensors: of(&["height 9"]), ..question() }),
        "sensor height 9 is not one that this loop uses: height 1, height 2, height 3, imu 1, imu 2, imu 3, imu 4"
    );
    assert!(
        refused(EnvelopeQuestion { sensors: of(&["sonar"]), ..question() }).starts_with("sensor sonar is not one that")
    );
    assert_eq!(
        refused(EnvelopeQuestion { sensors: of(&["height 1", "height 1"]), ..question() }),
        "sensors names height 1 twice"
    );
    assert_eq!(refused(EnvelopeQuestion { most: Some(8), ..question() }), "a set of 8 sensors: this loop uses 7");
    assert!(refused(EnvelopeQuestion { suite: Some("moon".into()), ..question() }).contains("\"moon\""));
    assert!(refused(EnvelopeQuestion { horizon_s: Some(1e9), ..question() }).contains("1000000000"));
    let three = EnvelopeQuestion { sensors: of(&["imu 1", "imu 2", "imu 3"]), horizon_s: Some(20.0), ..question() };
    let refusal = asked(three).unwrap().answer(|_| true).unwrap_err().to_string();
    assert_eq!(refusal, "what the set may add over the horizon, values, is 1500, it must be at most 1000");
    assert!(refused(aside("w", None)).contains("axis is \"w\""));
    for unnamed in [question(), EnvelopeQuestion { sensors: of(&["imu 1"]), ..aside("x", None) }] {
        let refusal = refused(EnvelopeQuestion { proof: true, ..unnamed });
        assert_eq!(refusal, "proof is true, it is told of one set of `sensors` along z");
    }
    assert_eq!(
        refused(EnvelopeQuestion { more: Some("sonar".into()), ..question() }),
        "more is \"sonar\", it must be height, imu, gnss or pose"
    );
    let swinging = |more: Option<&str>, amplitude_m: f64, period_s: f64| {
        refused(EnvelopeQuestion { swing: Some(Swing { amplitude_m, period_s }), ..aside("x", more) })
    };
    assert!(swinging(None, 0.5, 4.0).starts_with("sensors that measure the position is 0"));
    assert!(swinging(Some("pose"), 2.0, 4.0).starts_with("amplitude_m is 2"));
    assert!(swinging(Some("pose"), 0.5, 4.01).starts_with("period_s is 4.01"));
    let located = EnvelopeQuestion { sensors: of(&["height 1"]), ..aside("x", Some("gnss")) };
    assert!(refused(located).ends_with("imu 1, imu 2, imu 3, imu 4, gnss 1"));
    assert!(refused(EnvelopeQuestion { noise_mps2: Some(-1.0), ..question() }).contains("-1"));
    let mut unstable = question();
    unstable.design.tick_rate_hz = Some(200.0);
    let mut k = vec![vec![0.0; 16]; 4];
    // Pushes away from the setpoint.
    k[0][2] = -50.0;
    (unstable.design.k, unstable.design.k_attitude) = (Some(k.clone()), Some(k));
    let told = refused(unstable);
    assert!(told.starts_with("these gains do not stabilise: the slowest pole is at +"), "{told}");
    let mut odd = question();
    odd.design.tick_rate_hz = Some(333.0);
    assert_eq!(refused(odd), "tick_rate_hz is 333, it must be such that 40 ms are whole ticks");
}
