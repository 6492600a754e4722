use plumbline_proto::ids::SensorId;
use plumbline_proto::v1::SensorKind;

use super::*;

const BASE: &str = r#"name = "a"
repeats = 2
[scenario]
duration_s = 30
[attack]
sensor = "height"
kind = "bias"
magnitude = 0.2
"#;

/// Of a flight that is down before the last of the onsets that may be drawn.
const LANDS: &str = "duration_s = 30\nscript = [{ at_s = 18, do = \"mode\", mode = \"land\" }]";

fn refused(text: &str) -> PlanError {
    Plan::from_toml(text).map(|plan| plan.flights()).expect_err(text)
}

#[test]
fn what_cannot_be_flown_is_refused_with_its_line_and_value() {
    let with = |more: &str| format!("{BASE}{more}");
    for (text, line, expected) in [
        (with("[[factor]]\nkey = \"atack.size\"\nvalues = [1]\n"), 10, "\"atack.size\""),
        (with("[[factor]]\nkey = \"attack.flavour\"\nvalues = [1]\n"), 10, "flavour"),
        (with("[[factor]]\nkey = \"attack.magnitude\"\nvalues = []\n"), 11, "values = []"),
        (with("[[factor]]\nkey = \"attack.magnitude\"\nvalues = [0.1, nan]\n"), 11, "nan is not a finite number"),
        (with("[[factor]]\nkey = \"attack.magnitude\"\nvalues = [0.1, 99.0]\n"), 10, "99"),
        (with("[[factor]]\nkey = \"attack.magnitude\"\nrange = [2.0, 1.0]\n"), 11, "[2, 1]"),
        (with("[[factor]]\nkey = \"attack.magnitude\"\nrange = [0.1, 1.0]\n"), 10, "grid"),
        (with("[[factor]]\nkey = \"attack.sensor\"\nvalues = [\"height\", \"gnss\"]\n"), 10, "no gnss 1"),
        (with("[[factor]]\nkey = \"attack.sensor\"\nvalues = [\"nose\"]\n"), 10, "nose"),
        (with("[[factor]]\nkey = \"agent.estimators.in_loop\"\nvalues = [\"oracle\"]\n"), 10, "oracle"),
        (with("[[factor]]\nkey = \"agent.calibrations\"\nvalues = [[\"a.json\"], []]\n"), 10, "calibrations: flights"),
        (with("[[factor]]\nkey = \"scenario.world\"\nvalues = [\"mars\"]\n"), 10, "mars"),
        (with("[[factor]]\nkey = \"scenario.seed\"\nvalues = [1]\n"), 10, "scenario.seed"),
        (with("[[condition]]\n\"attack.instance\" = 9\n"), 9, "height 9"),
        (BASE.replace("repeats = 2", "repeats = 1000000000"), 2, "1000000000 flights"),
        (BASE.replace("repeats = 2", "repeats = 0"), 2, "no flight"),
        (BASE.replace("repeats = 2", "repeats = -3"), 2, "-3"),
        (BASE.replace("repeats = 2", "repeets = 2"), 2, "repeets"),
        (BASE.replace("repeats = 2", "design = \"spiral\""), 2, "spiral"),
        (BASE.replace("repeats = 2", "design = \"draws\""), 2, "samples is absent"),
        (BASE.replace("repeats = 2", "samples = 5"), 2, "samples = 5"),
        (BASE.replace("name = \"a\"", "name = \"a b\""), 1, "a b"),
        (BASE.replace("duration_s = 30", "duration_s = nan"), 4, "nan"),
        (BASE.replace("duration_s = 30", "durations = 30"), 4, "durations"),
        (BASE.replace("duration_s = 30", "duration_s = 10"), 4, "duration_s = 10"),
        (BASE.replace("duration_s = 30", "duration_s = 21"), 4, "which may be at 22 s"),
        (BASE.replace("duration_s = 30", LANDS), 5, "the script ends the flight at 18 s, before an onset"),
        (BASE.replace("duration_s = 30", "tick_rate_hz = 20"), 4, "tick_rate_hz = 20"),
        (BASE.replace("magnitude = 0.2", "magnitude = 50"), 8, "50"),
        (BASE.replace("kind = \"bias\"", "kind = \"tickle\""), 7, "tickle"),
        (with("[stop]\ninterval = 0.1\nmeasure = \"beauty\"\n"), 9, "beauty"),
        (with("[baseline]\n\"attack.kind\" = \"none\"\n"), 9, "no level"),
        ("name = ".into(), 1, ""),
    ] {
        let error = refused(&text);
        assert!(error.message.contains(expected), "{text}\ngives: {error}");
        assert_eq!(error.line, line, "{text}\ngives: {error}");
    }
}

#[test]
fn designs_make_the_conditions_they_say() {
    let grid = "[[factor]]\nkey = \"attack.kind\"\nvalues = [\"none\", \"bias\"]\n[[factor]]\nkey = \"attack.magnitude\"\n\
                values = [0.1, 0.2, 0.5]\n";
    let plan = Plan::from_toml(&format!("{BASE}{grid}")).unwrap();
    assert_eq!((plan.conditions(), plan.flights()), (6, 12));
    let shown = |plan: &Plan, number| -> Vec<String> {
        plan.levels(number).iter().map(|level| crate::summary::shown(level.as_ref())).collect()
    };
    assert_eq!(shown(&plan, 0), ["none", "0.1"]);
    assert_eq!(shown(&plan, 5), ["bias", "0.5"]);
    // Repeats fill evenly, each with its own seed.
    assert_eq!((plan.place(7), plan.seed_of(1)), ((1, 1), 2));
    assert_eq!((plan.baseline_of(0), plan.baseline_of(5)), (None, Some(0)));
    let paired = Plan::from_toml(&format!("{BASE}{grid}[baseline]\n\"attack.kind\" = \"none\"\n")).unwrap();
    assert_eq!((paired.baseline_of(5), paired.baseline_of(2)), (Some(2), None));

    let list = "[[condition]]\n\"attack.instance\" = 1\n[[condition]]\n\"scenario.world\" = \"datasheet\"\n";
    let plan = Plan::from_toml(&format!("{BASE}{list}")).unwrap();
    assert_eq!(
        (shown(&plan, 0), shown(&plan, 1)),
        (vec!["1".into(), String::new()], vec![String::new(), "datasheet".into()])
    );

    let sampled = "[[factor]]\nkey = \"attack.magnitude\"\nrange = [0.01, 1.0]\nlog = true\n[[factor]]\n\
                   key = \"attack.instance\"\nvalues = [1, 2]\n";
    for design in ["latin_hypercube", "draws"] {
        let head = BASE.replace("repeats = 2", &format!("design = \"{design}\"\nsamples = 40"));
        let plan = Plan::from_toml(&format!("{head}{sampled}")).unwrap();
        let sizes: Vec<f64> = (0..40).filter_map(|n| plan.levels(n)[0].as_ref()?.as_float()).collect();
        assert!(sizes.iter().all(|size| (0.01..=1.0).contains(size)) && sizes.len() == 40);
        let mut strata: Vec<usize> = sizes.iter().map(|size| ((size / 0.01).log10() * 20.0) as usize).collect();
        strata.sort_unstable();
        let each_once = strata == (0..40).collect::<Vec<_>>();
        assert_eq!(each_once, design == "latin_hypercube", "{design}: {strata:?}");
        let first =
            (0..40).filter(|n| plan.levels(*n)[1].as_ref().and_then(toml::Value::as_integer) == Some(1)).count();
        assert!(if each_once { first == 20 } else { (8..=32).contains(&first) }, "{design}: {first}");
    }
}

#[test]
fn the_same_part_of_a_flight_is_judged_whatever_is_done_to_its_sensors() {
    let sensors: Vec<_> = (1..=4)
        .flat_map(|instance| [SensorKind::Imu, SensorKind::Height].map(|kind| SensorId::new(kind, instance)))
        .collect();
    let onset_s = |attack: &str, seed: u64| {
        let table = toml::from_str(&format!("[attack]\n{attack}\n")).unwrap();
        let (attacked, _) = condition::attack_of(&table).unwrap();
        attacked.attacks(&sensors, seed).iter().map(|attack| attack.start_s).fold(f64::INFINITY, f64::min)
    };
    for seed in 0..20 {
        for (sensor, kinds) in [
            ("height", &["drawn", "colluding", "bias"][..]),
            ("imu", &["drawn", "zero"][..]),
            ("any", &["drawn"][..]),
            ("imu_and_height", &["drawn"][..]),
        ] {
            let of = |kind: &str| onset_s(&format!("sensor = \"{sensor}\"\nkind = \"{kind}\""), seed);
            assert!((14.0..22.0).contains(&of("none")), "{sensor}: {}", of("none"));
            assert!(kinds.iter().all(|kind| of(kind) == of("none")), "{sensor}, seed {seed}");
        }
        let two = |kind: &str| onset_s(&format!("sensor = \"height\"\ncount = 2\nkind = \"{kind}\""), seed);
        assert_eq!((two("drawn"), two("colluding")), (two("none"), two("none")), "seed {seed}");
    }
}

#[test]
fn the_hash_is_that_of_the_content() {
    let of = |text: &str| Plan::from_toml(text).unwrap().hash();
    assert_eq!(of(BASE), of(&BASE.replace("repeats = 2", "# so many\nrepeats  =  2")));
    assert_ne!(of(BASE), of(&BASE.replace("repeats = 2", "repeats = 3")));
    assert_ne!(of(BASE), of(&BASE.replace("0.2", "0.25")));
}

#[test]
fn every_plan_of_the_repository_can_be_flown() {
    let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/scenarios/plans");
    let mut plans = 0;
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let plan = Plan::from_toml(&std::fs::read_to_string(&path).unwrap());
        let plan = plan.unwrap_or_else(|error| panic!("{}: {error}", path.display()));
        assert_eq!(path.file_stem().unwrap().to_str().unwrap(), plan.name);
        plans += 1;
    }
    assert!(plans > 0);
}

const BY_HAND: &str = r#"name = "a"
repeats = 3
[by_hand]
vehicle = "iris-1"
altitude_m = [0.5, 0.8, 0.5]
hold_s = 10
[agent]
estimators = { in_loop = "lanes" }
[attack]
sensor = "height"
kind = "bias"
magnitude = 0.2
start_s = 5
"#;

#[test]
fn what_cannot_be_flown_by_hand_is_refused_with_its_line_and_value() {
    let with = |more: &str| format!("{BY_HAND}{more}");
    for (text, line, expected) in [
        (BY_HAND.replace("\"iris-1\"", "\"\""), 4, "vehicle = \"\""),
        (BY_HAND.replace("[0.5, 0.8, 0.5]", "[]"), 5, "altitude_m has 0 altitudes"),
        (BY_HAND.replace("0.8", "-0.8"), 5, "altitude_m = -0.8"),
        (BY_HAND.replace("hold_s = 10", "hold_s = 0.1"), 6, "hold_s = 0.1"),
        (BY_HAND.replace("hold_s = 10", "holds = 10"), 6, "holds"),
        (BY_HAND.replace("in_loop = \"lanes\"", "run = [\"ukf\"]"), 8, "of a vehicle only estimators.in_loop"),
        (BY_HAND.replace("{ in_loop = \"lanes\" }", "{ in_loop = \"nose\" }"), 7, "nose"),
        (BY_HAND.replace("hold_s = 10", "hold_s = 4"), 5, "3 of 4 s are 12 s, and flights are judged from 12 s on"),
        (BY_HAND.replace("\"height\"", "\"rotor\""), 10, "the reader of recordings finds no rotor's onset"),
        (BY_HAND.replace("start_s = 5", "start_s = 31"), 5, "an onset may be at 31 s"),
        (BY_HAND.replace("repeats = 3", "repeats = 1001"), 2, "1001 flights, more than 1000"),
        (with("[scenario]\nduration_s = 20\n"), 14, "flown by hand instead"),
        (with("[[factor]]\nkey = \"recording\"\nvalues = [\"f\"]\n"), 15, "not the id of a finished flight"),
        (with("[[factor]]\nkey = \"by_hand.colour\"\nvalues = [1]\n"), 15, "colour"),
        (with("[[factor]]\nkey = \"reception\"\nvalues = [\"median\"]\n"), 15, "nothing stands before"),
    ] {
        let library = Library::archive(std::path::Path::new("none"));
        let error = Plan::over(&text, &library).map(|plan| plan.flights()).expect_err(&text);
        assert!(error.message.contains(expected), "{text}\ngives: {error}");
        assert_eq!(error.line, line, "{text}\ngives: {error}");
    }
}

#[test]
fn flights_by_hand_come_block_by_block_in_an_order_of_the_seed() {
    let text = format!("{BY_HAND}[[factor]]\nkey = \"attack.magnitude\"\nvalues = [0.1, 0.2, 0.3, 0.4]\n");
    let plan = Plan::from_toml(&text).unwrap();
    let order = crate::by_hand::order(&plan);
    assert_eq!((order.len(), order.clone()), (12, crate::by_hand::order(&plan)));
    for (block, flights) in order.chunks(4).enumerate() {
        let mut sorted = flights.to_vec();
        sorted.sort_unstable();
        assert_eq!(sorted, (0..4).map(|condition| block as u64 * 4 + condition).collect::<Vec<_>>());
    }
    let blocks: Vec<Vec<u64>> = order.chunks(4).map(|block| block.iter().map(|index| index % 4).collect()).collect();
    assert!(blocks.iter().any(|block| *block != blocks[0]), "each block is drawn for itself: {blocks:?}");
    let seeded = Plan::from_toml(&text.replace("repeats = 3", "repeats = 3\nseed = 9")).unwrap();
    assert_ne!(crate::by_hand::order(&seeded), order);
    // Drawn on the sensors that the vehicle has.
    let heights: Vec<_> = (1..=5).map(|instance| SensorId::new(SensorKind::Height, instance)).collect();
    let by_hand = plan.by_hand(1).unwrap();
    let attacks = by_hand.attacks(&heights, 3).unwrap();
    assert_eq!((attacks.len(), attacks[0].start_s, attacks[0].magnitude.abs()), (1, 5.0, 0.2));
    assert!(by_hand.attacks(&heights[..0], 3).unwrap_err().contains("iris-1 has no height"));
}
