//! The subcommands as a user calls them: JSON lines on stdout, errors on stderr with exit code 1.

use std::process::{Command, Output};

use plumbline_agent::recordings::shared;
use plumbline_proto::{Message as _, v1};
use serde_json::Value;

fn agent(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_plumbline-agent")).args(arguments).env("RUST_LOG", "warn").output().unwrap()
}

fn lines(output: &Output) -> Vec<Value> {
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let text = std::str::from_utf8(&output.stdout).unwrap();
    text.lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}

fn entries(matrix: &Value) -> Vec<f64> {
    matrix.as_array().unwrap().iter().flat_map(|row| row.as_array().unwrap()).map(|x| x.as_f64().unwrap()).collect()
}

#[test]
fn riccati_cases_agree_with_the_reference() {
    let folder = tempfile::tempdir().unwrap();
    for file in ["reference/riccati_iris_hover.json", "reference/riccati_random.json"] {
        let Some(path) = shared(file) else { return };
        let all: Value = serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap();
        for equation in ["care", "dare"] {
            let cases: Vec<&Value> =
                all["cases"].as_array().unwrap().iter().filter(|case| case["kind"] == equation).collect();
            assert!(cases.len() >= 3, "{file} {equation}: {} cases", cases.len());
            let input = folder.path().join("cases.json");
            std::fs::write(&input, serde_json::json!({ "cases": cases }).to_string()).unwrap();
            let answers = lines(&agent(&[equation, "--input", input.to_str().unwrap()]));
            assert_eq!(answers.len(), cases.len());
            for (case, answer) in cases.iter().zip(&answers) {
                let (expected, found) = (entries(&case["P"]), entries(&answer["P"]));
                let norm = expected.iter().map(|x| x * x).sum::<f64>().sqrt();
                let error = expected.iter().zip(&found).map(|(a, b)| (a - b) * (a - b)).sum::<f64>().sqrt() / norm;
                // What a good solver in double reaches, as the reference says.
                let tolerance = (30.0 * case["scipy_rel_err_vs_ref"].as_f64().unwrap_or(0.0)).max(1e-9);
                assert!(error <= tolerance, "{file} {}: P is off by {error:.1e} of its norm", case["name"]);
            }
        }
    }
}

#[test]
fn a_reader_that_has_enough_ends_a_tool_without_a_word() {
    let folder = tempfile::tempdir().unwrap();
    let identity = folder.path().join("identity");
    for arguments in [&["observability"][..], &["identity", "--identity", identity.to_str().unwrap()]] {
        let (reader, writer) = std::io::pipe().unwrap();
        drop(reader);
        let mut command = Command::new(env!("CARGO_BIN_EXE_plumbline-agent"));
        let output = command.args(arguments).env("RUST_LOG", "warn").stdout(writer).output().unwrap();
        assert_eq!(output.status.code(), Some(141), "{arguments:?}");
        assert!(output.stderr.is_empty(), "{}", String::from_utf8_lossy(&output.stderr));
    }
}

#[test]
fn windows_decode_to_the_reference_optimum() {
    let Some(path) = shared("reference/sse_windows.json") else { return };
    let reference: Value = serde_json::from_str(&std::fs::read_to_string(&path).unwrap()).unwrap();
    let cases = reference["cases"].as_array().unwrap();
    for program in ["l2", "l1"] {
        for engine in ["newton", "clarabel"] {
            let arguments = ["decode", "--input", path.to_str().unwrap(), "--program", program, "--engine", engine];
            let answers = lines(&agent(&arguments));
            assert_eq!(answers.len(), cases.len());
            for (case, answer) in cases.iter().zip(&answers) {
                let expected = case[format!("{program}_objective")].as_f64().unwrap();
                let found = answer["objective"].as_f64().unwrap_or(f64::NAN);
                assert!(
                    (found - expected).abs() <= 1e-6 * expected.abs(),
                    "{program} {engine}: {answer} for {expected}"
                );
            }
        }
    }
}

#[test]
fn an_estimate_prints_its_score_and_writes_its_table() {
    let Some(path) = shared("data/px4_ulog/sample_logging_tagged_and_default_params.ulg") else { return };
    let folder = tempfile::tempdir().unwrap();
    let table = folder.path().join("out.csv");
    let arguments = ["--input", path.to_str().unwrap(), "--output", table.to_str().unwrap()];
    let scores = lines(&agent(&[&["estimate", "--estimator", "ekf-bias"][..], &arguments].concat()));
    assert_eq!((scores.len(), scores[0]["ticks"].as_u64()), (1, Some(2028)), "{scores:?}");
    assert!(scores[0]["inclination_rmse_deg"].as_f64().unwrap() < 1.0, "{}", scores[0]);
    assert_eq!(std::fs::read_to_string(table).unwrap().lines().count(), 2029);
}

#[test]
fn a_calibration_is_written_and_summed_up() {
    let folder = tempfile::tempdir().unwrap();
    let (table, json) = (folder.path().join("bench.csv"), folder.path().join("motor.json"));
    std::fs::write(&table, "command,rpm\n0.2,2000\n0.4,3200\n0.6,4400\n0.9,6200\n").unwrap();
    let (input, output) = (table.to_str().unwrap(), json.to_str().unwrap());
    let told = lines(&agent(&["calibrate", "motor-curve", "--input", input, "--output", output]));
    assert_eq!((told.len(), told[0]["kind"].as_str()), (1, Some("motor-curve")), "{told:?}");
    let file: Value = serde_json::from_str(&std::fs::read_to_string(&json).unwrap()).unwrap();
    assert_eq!(file["parameters"], told[0]["parameters"]);
    assert!(file["date"].as_str().unwrap().ends_with('Z') && file["picture"].as_array().unwrap().len() == 2);
    // 6000 rev/min from command 0 to 1.
    let slope = file["parameters"][1]["value"].as_f64().unwrap();
    assert!((slope - 6000.0 * std::f64::consts::TAU / 60.0).abs() < 1e-6, "{slope}");
}

#[test]
fn what_cannot_be_done_is_told_on_stderr_with_exit_code_1() {
    let folder = tempfile::tempdir().unwrap();
    let text = folder.path().join("letter.txt");
    std::fs::write(&text, "Dear sensors,\n").unwrap();
    let text = text.to_str().unwrap();
    let log = folder.path().join("log");
    let log = log.to_str().unwrap();
    for (arguments, expected) in [
        (&["care", "--input", text][..], "not JSON"),
        (&["dare", "--input", "absent.json"], "absent.json"),
        (&["decode", "--input", text], "letter.txt"),
        (&["estimate", "--input", text, "--estimator", "ekf-bias", "--output", text], "begins with \"Dear sensors,\""),
        (&["calibrate", "thrust", "--input", text, "--output", log], "letter.txt: no column speed_radps or rpm"),
        (&["calibrate", "allan", "--input", "absent.csv", "--output", log], "absent.csv"),
        (&["--vehicle", "replay", text, "--ground", "none", "--log", log], "supported are Plumbline flight files"),
        (&["--vehicle", "replay", "absent.mcap", "--ground", "none", "--log", log], "absent.mcap"),
        (&["--vehicle", "replay", "--ground", "none", "--log", log], "needs a file"),
    ] {
        let output = agent(arguments);
        let told = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(1), "{arguments:?}: {told}");
        assert!(told.contains(expected), "{arguments:?}: {told}");
        assert!(output.stdout.is_empty(), "{arguments:?}");
    }
}

#[test]
fn designs_become_certified_gains_that_read_back() {
    let folder = tempfile::tempdir().unwrap();
    let output = folder.path().join("gains.json");
    let output = output.to_str().unwrap();
    let design = |controller: &str, more: &[&str]| {
        let arguments = ["design", "--airframe", "iris", "--controller", controller, "--output", output];
        agent(&[&arguments[..], more].concat())
    };
    for controller in ["lqr", "lqi", "lqg", "hinf", "pid"] {
        let done = design(controller, &[]);
        assert!(done.status.success(), "{controller}: {}", String::from_utf8_lossy(&done.stderr));
        let first: Value = serde_json::from_str(&std::fs::read_to_string(output).unwrap()).unwrap();
        assert_eq!(first["certificate"]["policy"], "standard");
        // What was written is a design itself.
        let again = folder.path().join("again.json");
        std::fs::copy(output, &again).unwrap();
        let done = design(controller, &["--weights", again.to_str().unwrap()]);
        assert!(done.status.success(), "{controller}: {}", String::from_utf8_lossy(&done.stderr));
        let second: Value = serde_json::from_str(&std::fs::read_to_string(output).unwrap()).unwrap();
        assert_eq!(first["certificate"]["sha256"], second["certificate"]["sha256"], "{controller}");
    }
    let weights = folder.path().join("weights.json");
    for (controller, text, mentions) in [
        ("magic", "{}", "\"magic\" is not known"),
        ("pid", r#"{"parameters": {"tilt_p": -1}}"#, "tilt_p is -1"),
        ("pid", r#"{"parameters": {"tolt_p": 1}}"#, "tolt_p"),
        ("lqr", r#"{"state_weight": [1, 2], "input_weight": [1, 1, 1, 1]}"#, "state_weight has 2 values"),
        ("lqr", r#"{"controller": "pid"}"#, "the weights are for controller \"pid\""),
        ("lqi", r#"{"colour": 1}"#, "colour"),
        ("pid", r#"{"parameters": {"tilt_p": 49, "tilt_rate_p": 99}}"#, "grows at 14.791 1/s"),
    ] {
        std::fs::write(&weights, text).unwrap();
        let done = design(controller, &["--weights", weights.to_str().unwrap()]);
        let stderr = String::from_utf8_lossy(&done.stderr);
        assert!(!done.status.success() && stderr.contains(mentions), "{text}: {stderr}");
    }
}

#[test]
fn a_suite_is_judged_before_it_flies() {
    let report = |arguments: &[&str]| -> Value {
        let output = agent(&[&["observability"], arguments].concat());
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        serde_json::from_slice(&output.stdout).unwrap()
    };
    let clinic = report(&["--suite", "clinic"]);
    let figures = ["rows", "rank", "correctable_attacks"].map(|name| clinic[name].as_u64().unwrap());
    assert_eq!((figures, clinic["binding_state"].as_str().unwrap()), ([38, 10, 0], "z"));
    assert_eq!(report(&["--suite", "clinic-3"])["correctable_attacks"], 1);
    assert_eq!(report(&["--suite", "default", "--trim", "circle:2,1.5"])["rank"], 10);
    for (arguments, expected) in [
        (["--suite", "umasankar"], "does not observe z"),
        (["--suite", "nowhere.toml"], "nowhere.toml: neither a file nor one of"),
        (["--trim", "loop:3"], "--trim loop:3: not hover"),
    ] {
        let output = agent(&[&["observability"], &arguments[..]].concat());
        let message = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(!output.status.success() && message.contains(expected), "{message}");
    }
}

#[test]
fn a_recorded_flight_is_estimated_and_flown_again_under_every_decoder() {
    // GIVEN a recorded flight in which height 2 is attacked.
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let scenario = path("attack.toml");
    let text = "name = \"attack\"\nduration_s = 16\n[[script]]\nat_s = 3\ndo = \"arm\"\n[[script]]\nat_s = 4\ndo = \"mode\"\n\
                mode = \"altitude_hold\"\n[[script]]\nat_s = 5\ndo = \"setpoint\"\naltitude_m = 0.6\n[[attack]]\n\
                sensor = \"height\"\ninstance = 2\nkind = \"bias\"\nstart_s = 9\nduration_s = 5\nmagnitude = 0.5\n";
    std::fs::write(&scenario, text).unwrap();
    let fly = |log: &str, more: &[&str]| {
        let (log, identity) = (path(log), path("identity"));
        let common = ["--ground", "none", "--speed", "max", "--log", &log, "--identity", &identity];
        let output = agent(&[&common, more].concat());
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        let file = std::fs::read_dir(&log).unwrap().next().unwrap().unwrap().path();
        file.to_str().unwrap().to_owned()
    };
    let flown = fly("first", &["--scenario", &scenario, "--script", "--estimator", "secure"]);
    let estimate = |arguments: &[&str]| {
        let out = path("out.csv");
        agent(&[&["estimate", "--input", &flown, "--output", &out], arguments].concat())
    };
    // WHEN it is estimated THEN the attacked sensor is flagged within a second, and no other.
    for decoder in ["l2", "l1", "l2_split", "l1_split"] {
        let score = &lines(&estimate(&["--estimator", "secure", "--decoder", decoder]))[0];
        let flags = score["flagged"].as_array().unwrap();
        assert!(!flags.is_empty() && flags.iter().all(|f| f["sensor"] == "height 2"), "{decoder}: {flags:?}");
        let since_s = flags[0]["since_s"].as_f64().unwrap();
        assert!((9.0..10.0).contains(&since_s), "{decoder}: {flags:?}");
        let z = score["position_rmse_xyz_m"][2].as_f64().unwrap();
        assert!(z < 0.03, "{decoder}: {z} m");
    }
    // AND through a window of half the slots, or twice.
    for slots in ["5", "20"] {
        let score = &lines(&estimate(&["--estimator", "secure", "--window", slots]))[0];
        let flags = score["flagged"].as_array().unwrap();
        assert!(!flags.is_empty() && flags.iter().all(|f| f["sensor"] == "height 2"), "{slots} slots: {flags:?}");
    }
    assert!(lines(&estimate(&["--estimator", "ekf-bias"]))[0]["flagged"].is_null());
    // AND it is flown again under another decoder and through another window, which the new recording tells.
    let config = path("agent.toml");
    std::fs::write(&config, "[estimators]\nwindow = 15\n").unwrap();
    let other = ["--estimator", "secure", "--decoder", "l1_split", "--config", &config];
    let again = fly("again", &[&["--vehicle", "replay", &flown], &other[..]].concat());
    let bytes = std::fs::read(again).unwrap();
    let told: Vec<_> = mcap::MessageStream::new(&bytes)
        .unwrap()
        .map(Result::unwrap)
        .filter(|message| message.channel.topic == "/secure")
        .map(|message| v1::SecureStatus::decode(&*message.data).unwrap())
        .collect();
    let other = |s: &v1::SecureStatus| s.decoder() == v1::Decoder::L1Split && s.window_slots == 15;
    assert!(told.len() > 100 && told.iter().all(other), "{}", told.len());
    assert!(told.iter().any(|s| s.sensors.iter().any(|d| d.flagged)));
    for (arguments, expected) in [
        (["--estimator", "secure", "--decoder", "l3"], "--decoder l3: not l2, l1"),
        (["--estimator", "ukf", "--decoder", "l1"], "--decoder l1: ukf solves none"),
        (["--estimator", "secure", "--window", "51"], "--window 51: not 5 to 50 slots"),
        (["--estimator", "ukf", "--window", "5"], "--window 5: ukf has none"),
    ] {
        let output = estimate(&arguments);
        let message = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(!output.status.success() && message.contains(expected), "{message}");
    }
}
