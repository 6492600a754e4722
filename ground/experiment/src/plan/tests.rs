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
