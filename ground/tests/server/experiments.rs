//! Experiments over HTTP: sized, refused with the line, flown, stopped, gone on with, read, opened.

use std::path::Path;
use std::sync::atomic::AtomicBool;
use std::time::{Duration, Instant};

use crate::common::servers::{Process, drawn};
use crate::common::{Ground, PATIENCE, Response, exchange};
use plumbline_experiment::plan::Plan;
use plumbline_experiment::row::{ROW_BYTES, Row};
use plumbline_experiment::run::{Ended, Options, run};
use plumbline_experiment::store::Experiment;
use serde_json::json;

const PLAN: &str = r#"
name = "over_http"
repeats = 3
[scenario]
duration_s = 16
rig = { hanging_strings = { mode = "flight", height_m = 0.3 } }
script = [
  { at_s = 3, do = "arm" }, { at_s = 4, do = "mode", mode = "altitude_hold" },
  { at_s = 5, do = "setpoint", altitude_m = 0.9 },
]
[[factor]]
key = "agent.estimators.in_loop"
values = ["ekf_bias", "lanes"]
"#;

fn asked(plan: &str) -> String {
    json!({ "plan": plan }).to_string()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_plan_is_sized_flown_read_and_one_of_its_flights_opened() {
    let folder = tempfile::tempdir().unwrap();
    let ground = Ground::start(folder.path()).await;
    assert_eq!(ground.json("/api/v1/experiments").await, json!({ "experiments": [], "total": 0 }));
    // GIVEN a plan WHEN its size is asked THEN nothing is kept
    let size = ground.request("POST", "/api/v1/experiments/size", &asked(PLAN)).await.json();
    assert_eq!((size["conditions"].as_u64(), size["flights"].as_u64()), (Some(2), Some(6)));
    assert!(size["expected_s"].as_f64().unwrap() > 0.0, "{size}");
    assert_eq!(ground.json("/api/v1/experiments").await, json!({ "experiments": [], "total": 0 }));

    // WHEN it is flown THEN it completes, and each flight is there once
    let made = ground.request("POST", "/api/v1/experiments", &asked(PLAN)).await;
    assert_eq!(made.status, 201, "{}", made.text());
    let id = made.json()["id"].as_str().unwrap().to_owned();
    assert_eq!(made.json()["id"], size["id"]);
    let at = format!("/api/v1/experiments/{id}");
    let results = loop {
        // Minutes on a machine that has much else to do.
        let results = ground.json(&at).await;
        if results["state"]["running"] == false {
            break results;
        }
        tokio::time::sleep(std::time::Duration::from_millis(100)).await;
    };
    assert_eq!((results["state"]["done"].as_u64(), &results["state"]["error"]), (Some(6), &json!(null)), "{results}");
    assert_eq!(results["factors"], json!(["agent.estimators.in_loop"]));
    assert_eq!(results["conditions"][1]["levels"], json!(["lanes"]));
    assert_eq!(results["conditions"][1]["measures"][0]["count"], 3);
    assert_eq!(results["conditions"][1]["differences"][0]["pairs"], 3);
    let [median_us, of_99_us] = [0, 1].map(|at| results["conditions"][1]["tick_us"][at].as_f64().unwrap());
    assert!(0.5 < median_us && median_us <= of_99_us && of_99_us < 1e5, "{results}");
    let flights = ground.json(&format!("{at}/flights?from=1&count=2&condition=1")).await;
    assert_eq!((flights["total"].as_u64(), flights["flights"].as_array().unwrap().len()), (Some(3), 2));
    assert_eq!((flights["flights"][0]["index"].as_u64(), flights["flights"][0]["seed"].as_u64()), (Some(3), Some(2)));

    // WHEN one is opened, by two at once, THEN it is among the flights, as often as one likes
    let path = format!("{at}/flights/3");
    let (opened, beside) = tokio::join!(ground.request("POST", &path, ""), ground.request("POST", &path, ""));
    for opened in [&opened, &beside] {
        assert_eq!(opened.status, 200, "{}", opened.text());
    }
    assert_eq!(opened.json(), beside.json());
    let flight = opened.json()["flight"].as_str().unwrap().to_owned();
    assert_eq!(ground.json(&format!("/api/v1/flights/{flight}")).await["completeness"], "complete");
    let go = ground.get(&format!("{at}/flights/3/open")).await;
    assert_eq!((go.status, go.header("location")), (303, Some(format!("/flights/{flight}").as_str())));
    let foreign = [("sec-fetch-site", "cross-site"), ("sec-fetch-mode", "no-cors")];
    assert_eq!(ground.request_as("GET", &format!("{at}/flights/3/open"), "", &foreign).await.status, 403);
    assert_eq!(ground.json("/api/v1/flights").await["flights"].as_array().unwrap().len(), 1);
    assert_eq!(ground.request("POST", &format!("{at}/flights/6"), "").await.status, 404);
    let mut kept = std::fs::read_dir(folder.path().join(format!("experiments/{id}"))).unwrap().flatten();
    assert!(kept.all(|entry| !entry.path().is_dir()), "an opening leaves nothing behind");

    // THEN its files can be had
    assert_eq!(ground.get(&format!("{at}/plan.toml")).await.text(), PLAN);
    assert!(ground.get(&format!("{at}/report.html")).await.text().contains("6 of 6 flights"));
    let table = ground.get(&format!("{at}/flights.parquet")).await;
    assert!(table.body.starts_with(b"PAR1"));
    let known = [("if-none-match", table.header("etag").expect("a tag"))];
    let written = std::fs::metadata(folder.path().join(format!("experiments/{id}/flights.parquet"))).unwrap();
    let again = ground.request_as("GET", &format!("{at}/flights.parquet"), "", &known).await;
    assert_eq!((again.status, again.body.is_empty()), (304, true));
    let now = std::fs::metadata(folder.path().join(format!("experiments/{id}/flights.parquet"))).unwrap();
    assert_eq!(now.modified().unwrap(), written.modified().unwrap(), "it is not made again");
    let listed = ground.json("/api/v1/experiments?limit=1").await;
    assert_eq!((&listed["total"], &listed["experiments"][0]["id"]), (&json!(1), &json!(id)));
    assert_eq!(ground.json("/api/v1/experiments?offset=1").await, json!({ "experiments": [], "total": 1 }));
    assert_eq!(ground.json("/api/v1/experiments?search=nowhere").await, json!({ "experiments": [], "total": 0 }));
    assert_eq!(ground.json(&format!("/api/v1/experiments?search={id}")).await["total"], 1);
    let against = ground.get(&format!("{at}/against/{id}")).await.text();
    assert!(against.contains("6 of 6 flights of the same condition and seed are the same bit for bit"), "{against}");
    assert_eq!(ground.get(&format!("{at}/against/none")).await.status, 404);
    assert_eq!(ground.get("/api/v1/experiments/none").await.status, 404);
    ground.stop().await;
    let audit = std::fs::read_to_string(folder.path().join("audit.jsonl")).unwrap();
    let went = |line: &&str| line.contains("/flights/3/open") && line.contains("303");
    assert_eq!(audit.lines().filter(went).count(), 1, "{audit}");
}

#[tokio::test(flavor = "multi_thread")]
async fn one_is_flown_at_a_time_and_a_ground_that_ends_loses_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let long = PLAN.replace("repeats = 3", "repeats = 10000");
    let ground = Ground::start(folder.path()).await;
    let bad = ground.request("POST", "/api/v1/experiments", &asked(&PLAN.replace("\"lanes\"", "\"nose\""))).await;
    assert_eq!(
        (bad.status, bad.error().contains("line 12"), bad.error().contains("nose")),
        (422, true, true),
        "{}",
        bad.error()
    );
    let id =
        ground.request("POST", "/api/v1/experiments", &asked(&long)).await.json()["id"].as_str().unwrap().to_owned();
    assert_eq!(ground.figure("experiments_running").await, 1.0);
    let second = ground.request("POST", "/api/v1/experiments", &asked(PLAN)).await;
    assert_eq!((second.status, second.error().contains(&id)), (409, true), "{}", second.error());
    // WHEN it is stopped and started again THEN it goes on
    let at = format!("/api/v1/experiments/{id}");
    ground.wait_json(&at, |results| results["state"]["done"].as_u64() > Some(0)).await;
    assert_eq!(ground.request("POST", &format!("{at}/stop"), "").await.status, 200);
    let stopped = ground.wait_json(&at, |results| results["state"]["running"] == false).await;
    assert_eq!(ground.figure("experiments_running").await, 0.0);
    let done = stopped["state"]["done"].as_u64().unwrap();
    assert_eq!(ground.request("POST", &format!("{at}/start"), "").await.status, 200);
    ground.wait_json(&at, |results| results["state"]["done"].as_u64() > Some(done)).await;
    // WHEN the ground ends in the middle THEN the next one has every flight that was finished
    ground.stop().await;
    let ground = Ground::start(folder.path()).await;
    let state = ground.json(&at).await["state"].clone();
    assert!(state["done"].as_u64() > Some(done) && state["running"] == false && state["own"] == true, "{state}");
    ground.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn recorded_flights_are_flown_again_under_other_estimators() {
    let folder = tempfile::tempdir().unwrap();
    let ground = Ground::start(folder.path()).await;
    // GIVEN a flight in the archive
    let one = PLAN.replace("repeats = 3", "repeats = 1").replace("\"ekf_bias\", \"lanes\"", "\"lanes\"");
    let one = one.replace("duration_s = 16", "duration_s = 24");
    let finished = |results: &serde_json::Value| results["state"]["done"] == results["state"]["flights"];
    let fly = async |plan: &str| {
        let made = ground.request("POST", "/api/v1/experiments", &asked(plan)).await;
        assert_eq!(made.status, 201, "{}", made.text());
        let at = format!("/api/v1/experiments/{}", made.json()["id"].as_str().unwrap());
        ground.wait_json(&at, |results| finished(results) && results["state"]["running"] == false).await;
        at
    };
    let at = fly(&one).await;
    let opened = ground.request("POST", &format!("{at}/flights/0"), "").await.json();
    let flight = opened["flight"].as_str().unwrap().to_owned();
    // WHEN a plan names it THEN it is flown under each estimator, and each row opens as a flight of its own
    let again = format!(
        "name = \"again\"\n[[factor]]\nkey = \"recording\"\nvalues = [\"{flight}\"]\n[[factor]]\n\
         key = \"agent.estimators.in_loop\"\nvalues = [\"ekf_bias\", \"lanes\"]\n"
    );
    let at = fly(&again).await;
    let results = ground.json(&at).await;
    assert_eq!(results["conditions"][1]["levels"], json!([flight, "lanes"]));
    assert!(results["notes"][0].as_str().unwrap().contains("Recordings flown again"), "{results}");
    let of = |condition: usize, name: &str| {
        let measures = results["measures"].as_array().unwrap();
        let measure = measures.iter().position(|measure| measure["name"] == name).unwrap();
        results["conditions"][condition]["measures"][measure]["median"].as_f64()
    };
    assert!(of(0, "altitude_m").is_some() && of(0, "altitude_m") == of(1, "altitude_m"), "{results}");
    assert!(of(0, "estimate_m").is_some() && of(0, "estimate_m") != of(1, "estimate_m"), "{results}");
    let opened = ground.request("POST", &format!("{at}/flights/1"), "").await;
    assert_eq!(opened.status, 200, "{}", opened.text());
    let id = opened.json()["flight"].as_str().unwrap().to_owned();
    let shown = ground.json(&format!("/api/v1/flights/{id}")).await;
    assert_eq!((&shown["vehicle"], &shown["completeness"]), (&json!("replay"), &json!("complete")), "{shown}");
    // THEN over the network nothing but flights can be named
    for name in ["nobody", "/etc/hostname", "../flights/x"] {
        let refused = ground.request("POST", "/api/v1/experiments", &asked(&again.replace(&flight, name))).await;
        assert_eq!((refused.status, refused.error().contains("line 3")), (422, true), "{}", refused.error());
        assert!(refused.error().contains("not the id of a finished flight of this ground"), "{}", refused.error());
    }
    ground.stop().await;
}

#[test]
fn a_disk_that_is_full_ends_a_run_with_the_file_and_costs_nothing_that_was_flown() {
    // GIVEN a folder where no file may be longer than 2 KiB: 16 flights need 3
    const ROOM: u64 = 2048;
    const { assert!(ROOM < 16 * ROW_BYTES as u64) };
    let folder = tempfile::tempdir().unwrap();
    let text = PLAN.replace("repeats = 3", "repeats = 8");
    let (file, data) = (folder.path().join("plan.toml"), folder.path().join("data"));
    std::fs::write(&file, &text).unwrap();
    let flown = |limit: &str| {
        let script = format!("{limit} exec \"$0\" experiment run \"$1\" --data \"$2\"");
        let mut command = std::process::Command::new("sh");
        command.arg("-c").arg(script).arg(env!("CARGO_BIN_EXE_plumbline-ground")).arg(&file).arg(&data);
        command.output().unwrap()
    };
    // WHEN it is flown THEN it ends and names the file; every whole row is kept
    let full = flown("trap '' XFSZ; ulimit -f 4;");
    let said = String::from_utf8_lossy(&full.stderr).into_owned();
    assert!(!full.status.success() && said.contains("flights.rows"), "{said}");
    let plan = || Plan::from_toml(&text).unwrap();
    let experiment = Experiment::create(&Experiment::root(&data), plan()).unwrap();
    assert_eq!(experiment.rows().unwrap().len() as u64, ROOM / ROW_BYTES as u64);
    // WHEN there is room again THEN the rest is flown, and all is as it would have been
    let rest = flown("");
    assert!(rest.status.success(), "{}", String::from_utf8_lossy(&rest.stderr));
    assert!(experiment.rows().unwrap() == undisturbed(folder.path(), plan()) && experiment.done() == 16);
}

/// Rows of a run that nobody disturbs.
fn undisturbed(folder: &Path, plan: Plan) -> Vec<Row> {
    let experiment = Experiment::create(&folder.join("undisturbed"), plan).unwrap();
    let ended = run(&experiment, &Options::default(), &AtomicBool::new(false), |_, _| {}).unwrap();
    assert_eq!(ended, Ended::Complete);
    experiment.rows().unwrap()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_ground_that_is_killed_while_it_flies_has_every_flight_once_and_the_same() {
    // Kills of a campaign's rounds; a few of them in a test.
    let rounds: u64 = std::env::var("PLUMBLINE_ROUNDS").map_or(3, |rounds| rounds.parse().unwrap());
    let folder = tempfile::tempdir().unwrap();
    let plan = || Plan::from_toml(&PLAN.replace("repeats = 3", "repeats = 15")).unwrap();
    let expected = undisturbed(folder.path(), plan());
    let (mut kills, mut attempts, mut dice) = (0, 0, drawn());
    while kills < rounds {
        attempts += 1;
        let data = folder.path().join(format!("data-{attempts}"));
        let experiment = Experiment::create(&Experiment::root(&data), plan()).unwrap();
        let start = format!("/api/v1/experiments/{}/start", experiment.id);
        while experiment.done() < expected.len() as u64 {
            let address = std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
            let mut command = std::process::Command::new(env!("CARGO_BIN_EXE_plumbline-ground"));
            command.args(["--listen", &address.to_string(), "--agent-listen", "127.0.0.1:0", "--data"]).arg(&data);
            let ground = Process::start(&mut command);
            let begun = Instant::now();
            let mut stream = loop {
                match tokio::net::TcpStream::connect(address).await {
                    Ok(stream) => break stream,
                    Err(error) => assert!(begun.elapsed() < PATIENCE, "{error}"),
                }
                tokio::time::sleep(Duration::from_millis(20)).await;
            };
            let head =
                format!("POST {start} HTTP/1.1\r\nhost: {address}\r\nconnection: close\r\ncontent-length: 0\r\n\r\n");
            let answer = Response::parse(&exchange(&mut stream, &head).await);
            assert_eq!(answer.status, 200, "{}", answer.text());
            // WHEN it is killed in the middle of a flight, every time at another place
            let before = experiment.done();
            while experiment.done() == before || (kills == rounds && experiment.done() < expected.len() as u64) {
                assert!(begun.elapsed() < 6 * PATIENCE, "{} flights after {kills} kills", experiment.done());
                tokio::time::sleep(Duration::from_millis(5 + (90.0 * dice.uniform()) as u64)).await;
            }
            drop(ground);
            kills = (kills + 1).min(rounds);
        }
        // THEN every flight is there once, and is the same
        assert!(experiment.rows().unwrap() == expected, "a row differs");
        assert_eq!(experiment.done(), expected.len() as u64, "a flight is there twice");
    }
    println!("{kills} kills over {attempts} experiments of {} flights", expected.len());
}
