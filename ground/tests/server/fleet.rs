//! Grounds that share vehicles and flights: NATS, PostgreSQL and the storage are real servers, and all of them are killed.

use std::collections::BTreeSet;
use std::path::Path;
use std::process::Command;
use std::time::{Duration, Instant};

use plumbline_ground::{Fleet, GroundConfig};
use plumbline_proto::v1::command::Body;
use plumbline_proto::{Kind, v1};
use serde_json::Value;

use crate::common::agent::Agent;
use crate::common::servers::{Bucket, Nats, PATIENCE, Postgres, Process, drawn, free_port, listens};
use crate::common::{Ground, Response};

fn config(data: &Path, fleet: Fleet) -> GroundConfig {
    std::fs::create_dir_all(data).unwrap();
    let mut config = GroundConfig::new(data);
    config.settle_after = Duration::from_millis(700);
    config.backfill_after = Duration::from_millis(100);
    config.reserve_bytes = 1;
    config.fleet = Some(fleet);
    config
}

/// A ground called `name` in a folder of that name.
async fn sharing(folder: &Path, name: &str, storage: &Path, database: &str) -> Ground {
    let archive = Some((storage.to_str().unwrap().to_owned(), database.to_owned()));
    let fleet = Fleet { name: name.into(), archive, ..Fleet::default() };
    Ground::start_with(config(&folder.join(name), fleet)).await
}

async fn flown(agent: &mut Agent, ground: &Ground, id: &str) {
    let first = agent.begin(id).await;
    agent.fly(60).await;
    let last = agent.end(id, first);
    agent.send([last], false).await;
    ground.wait_json(&format!("/api/v1/flights/{id}"), |f| f["completeness"] == "complete").await;
}

/// As soon as the server does it: one that was killed recovers first.
async fn execute(postgres: &Postgres, text: &str) {
    let begun = Instant::now();
    loop {
        let done = async {
            let (client, connection) =
                tokio_postgres::connect(&postgres.url("postgres"), tokio_postgres::NoTls).await?;
            tokio::spawn(connection);
            client.batch_execute(text).await
        };
        match done.await {
            Ok(()) => return,
            Err(error) => assert!(begun.elapsed() < PATIENCE, "{text}: {error}"),
        }
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
}

fn names(storage: &Path) -> Vec<String> {
    let mut names: Vec<String> =
        std::fs::read_dir(storage).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

/// GIVEN two grounds with one archive WHEN one records THEN the other lists, opens, annotates and deletes; and an index that is away,
/// or new, costs nothing.
#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn what_one_ground_records_is_listed_opened_annotated_and_deleted_at_another() {
    let folder = tempfile::tempdir().unwrap();
    let Some(mut postgres) = Postgres::start(folder.path()) else { return };
    let storage = folder.path().join("storage");
    let east = sharing(folder.path(), "east", &storage, &postgres.url("postgres")).await;
    let west = sharing(folder.path(), "west", &storage, &postgres.url("postgres")).await;
    let mut agent = east.agent("iris-1", 1).await;
    flown(&mut agent, &east, "f1").await;
    flown(&mut agent, &east, "f2").await;

    let (f1, f2) = ("/api/v1/flights/f1", "/api/v1/flights/f2");
    let there = west.wait_json(f1, |f| f["away"] == true).await;
    let own = east.json(f1).await;
    for key in ["messages", "duration_s", "counts", "size_bytes", "completeness", "steps"] {
        assert_eq!(there[key], own[key], "{key}");
    }
    assert_eq!((&there["ground"], &own["away"]), (&Value::from("east"), &Value::from(false)));
    west.wait_json(f2, |f| f["away"] == true).await;
    // Without a copy: in the index, for all.
    assert_eq!(west.request("PATCH", f2, r#"{"name":"windy"}"#).await.status, 200);
    east.wait_json(f2, |f| f["name"] == "windy").await;
    // A plan over recordings names one that is not here yet: it is fetched.
    let plan = "name = \"again\"\nrepeats = 1\nrecording = \"f1\"\n[[factor]]\nkey = \"agent.estimators.in_loop\"\nvalues = [\"lanes\"]\n";
    let asked = serde_json::json!({ "plan": plan }).to_string();
    let sized = west.request("POST", "/api/v1/experiments/size", &asked).await;
    assert!(!sized.text().contains("not the id of a finished flight"), "{}", sized.text());
    assert_eq!((&west.json(f1).await["away"], &west.json(f2).await["away"]), (&Value::from(false), &Value::from(true)));
    // Opened, it is here, byte for byte; annotated on either side.
    let served = east.get(&format!("{f1}/mcap")).await.body;
    assert!(west.get(&format!("{f1}/mcap")).await.body == served && !served.is_empty());
    assert_eq!(west.json(f1).await["away"], false);
    assert_eq!(west.request("PATCH", f1, r#"{"name":"step","notes":"by west"}"#).await.status, 200);
    east.wait_json(f1, |f| f["notes"] == "by west").await;
    assert_eq!(east.request("PATCH", f1, r#"{"notes":"by east"}"#).await.status, 200);
    west.wait_json(f1, |f| f["notes"] == "by east" && f["name"] == "step").await;
    let listed = west.json("/api/v1/flights").await;
    let listed: Vec<_> = listed["flights"].as_array().unwrap().iter().map(|f| f["id"].as_str().unwrap()).collect();
    assert_eq!(listed, ["f2", "f1"]);

    // GIVEN no index THEN flights are recorded and listed, nothing is deleted, and why is said; what waited follows.
    postgres.kill();
    flown(&mut agent, &east, "f3").await;
    let told = east.wait_json("/api/v1/ground", |g| g["fleet"]["archive_error"].is_string()).await;
    assert!(told["fleet"]["archive_error"].as_str().unwrap().contains("PostgreSQL at 127.0.0.1/postgres"), "{told}");
    let refused = west.request("DELETE", f1, "").await;
    assert!(refused.status == 503 && refused.error().contains("PostgreSQL"), "{}", refused.text());
    assert_eq!(west.json(f1).await["name"], "step");
    postgres.start_again();
    west.wait_json("/api/v1/flights/f3", |f| f["away"] == true).await;

    // Deleted at one it is nowhere.
    assert_eq!(west.request("DELETE", f1, "").await.status, 204);
    assert_eq!(west.get(f1).await.status, 404);
    let begun = Instant::now();
    while east.get(f1).await.status != 404 {
        assert!(begun.elapsed() < PATIENCE);
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
    assert_eq!(west.request("DELETE", f2, "").await.status, 204, "of which it never had a copy");
    let kept = names(&storage);
    assert!(kept.len() == 2 && kept[0].starts_with("f3-") && kept[1] == "f3.json", "{kept:?}");
    east.stop().await;
    west.stop().await;

    // GIVEN another database, empty WHEN any ground comes THEN the index is made again from the storage.
    execute(&postgres, "CREATE DATABASE second").await;
    let north = sharing(folder.path(), "north", &storage, &postgres.url("second")).await;
    let there = north.wait_json("/api/v1/flights/f3", |f| f["away"] == true).await;
    assert_eq!(there["ground"], "east");
    // A file that was spoilt is not taken for the flight.
    std::fs::write(storage.join(&kept[0]), b"spoilt").unwrap();
    let refused = north.get("/api/v1/flights/f3/mcap").await;
    assert!(refused.status == 503 && refused.error().contains("has SHA-256"), "{}", refused.text());
    assert_eq!(north.json("/api/v1/flights/f3").await["away"], true);
    north.stop().await;
}

async fn cut(ground: &Ground) -> Response {
    ground.request("POST", "/api/v1/vehicles/iris-1/cut", "{}").await
}

/// GIVEN a vehicle at one ground WHEN another looks THEN it sees every message, is refused every command by name, and can cut the
/// motors; NATS that is away ends only that, and a vehicle that moves is flown where it is.
#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn a_vehicle_is_seen_from_another_ground_which_can_cut_its_motors_and_nothing_else() {
    let folder = tempfile::tempdir().unwrap();
    let Some(mut nats) = Nats::start(folder.path()) else { return };
    let url = nats.url();
    let start = async |name: &str, data: &str| {
        let address = format!("http://{name}.lab/");
        let fleet = Fleet { name: name.into(), address, nats: Some(url.clone()), archive: None };
        Ground::start_with(config(&folder.path().join(data), fleet)).await
    };
    let (east, west) = (start("east", "east").await, start("west", "west").await);
    let mut agent = east.agent("iris-1", 1).await;
    agent.describe().await;
    agent.fly(2).await;
    // What was said before it looked is known as well.
    let mut view = west.view("iris-1", 0).await;
    let description: v1::Description = view.next_of(Kind::Description).await.message();
    assert_eq!(description.airframe, "iris");
    let first = agent.sequence + 1;
    agent.fly(200).await;
    let mut seen = BTreeSet::new();
    let begun = Instant::now();
    while seen.last() != Some(&agent.sequence) {
        assert!(
            begun.elapsed() < PATIENCE,
            "{} messages, the last {:?} of {}",
            seen.len(),
            seen.last(),
            agent.sequence
        );
        let got = view.next().await;
        if got.kind == Some(Kind::Control) {
            let control: v1::Control = got.message();
            assert_eq!(control.time_us, got.time_us);
        }
        if got.sequence >= first {
            seen.insert(got.sequence);
        }
    }
    assert_eq!(seen.len() as u64, agent.sequence + 1 - first, "every message");
    let listed = west.json("/api/v1/vehicles").await;
    assert_eq!((&listed[0]["connected"], &listed[0]["ground"]["name"]), (&Value::from(true), &Value::from("east")));
    west.wait_json("/api/v1/ground", |g| g["fleet"]["grounds"] == serde_json::json!(["east"])).await;

    // Commands are refused with the ground that they belong to; so is control, which is seen.
    for (method, path, body) in [
        ("POST", "arm", "{}"),
        ("POST", "setpoint", r#"{"altitude_m":1}"#),
        ("PUT", "lease", "{}"),
        ("POST", "mode", r#"{"mode":"land"}"#),
    ] {
        let refused = west.request(method, &format!("/api/v1/vehicles/iris-1/{path}"), body).await;
        let says = refused.error();
        assert!(refused.status == 409 && says.contains("\"east\" http://east.lab/"), "{path}: {says}");
    }
    assert_eq!(east.request("PUT", "/api/v1/vehicles/iris-1/lease", "{}").await.status, 200);
    let holder = east.json("/api/v1/vehicles/iris-1/lease").await["holder"].as_str().unwrap().to_owned();
    west.wait_json("/api/v1/vehicles/iris-1/lease", |l| l["holder"] == format!("{holder} at east")).await;

    // The cut goes there, and its answer comes back.
    let (answer, command) = tokio::join!(cut(&west), agent.accept());
    assert_eq!(command.body, Some(Body::CutMotors(v1::CutMotors {})));
    assert!(command.operator.ends_with(" at west"), "{}", command.operator);
    assert_eq!(answer.status, 200, "{}", answer.text());
    // Under load as well: within the time that a command has, behind what another vehicle sends as fast as it can.
    let mut other = east.agent("iris-2", 1).await;
    let ((answer, command), ()) = tokio::join!(async { tokio::join!(cut(&west), agent.accept()) }, other.fly(4000));
    assert_eq!((answer.status, command.body), (200, Some(Body::CutMotors(v1::CutMotors {}))));
    other.disconnect().await;
    let refusing = async {
        let command = agent.command().await;
        agent.ack(command.command_id, v1::AckStage::Rejected, "no motors").await;
    };
    let (answer, ()) = tokio::join!(cut(&west), refusing);
    assert!(answer.status == 409 && answer.error().contains("no motors"), "{}", answer.text());
    let audit = east.json("/api/v1/audit").await.to_string();
    assert!(audit.contains("FLEET") && audit.contains("at west"), "{audit}");

    // WHEN NATS goes THEN what is seen is said to be old, the ground of the vehicle flies on, and all is there when it comes back.
    nats.kill();
    west.wait_json("/api/v1/vehicles", |v| v[0]["connected"] == false).await;
    let late = cut(&west).await;
    assert!(matches!(late.status, 409 | 503 | 504), "{}", late.text());
    agent.fly(5).await;
    east.wait_json("/api/v1/vehicles", |v| v[0]["connected"] == true).await;
    west.wait_json("/api/v1/ground", |g| g["fleet"]["live_error"].is_string()).await;
    nats.start_again();
    let moving = async {
        loop {
            agent.fly(1).await;
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
    };
    tokio::select! {
        _ = west.wait_json("/api/v1/vehicles", |v| v[0]["connected"] == true) => {}
        () = moving => {}
    }

    // WHEN the vehicle comes to the other ground THEN it is flown from there.
    agent.disconnect().await;
    agent.reconnect(west.link.clone()).await;
    west.wait_json("/api/v1/vehicles", |v| v[0]["connected"] == true && v[0].get("ground").is_none()).await;
    let (answer, command) = tokio::join!(west.request("POST", "/api/v1/vehicles/iris-1/disarm", "{}"), agent.accept());
    assert_eq!((answer.status, command.body), (200, Some(Body::Disarm(v1::Disarm {}))));
    east.wait_json("/api/v1/vehicles", |v| v[0]["ground"]["name"] == "west").await;

    // Two of one name do not hear each other, which is said.
    let twin = start("east", "twin").await;
    east.wait_json("/api/v1/ground", |g| {
        g["fleet"]["live_error"].as_str().is_some_and(|says| says.contains("another ground is called \"east\""))
    })
    .await;
    for ground in [east, west, twin] {
        ground.stop().await;
    }
}

/// A ground as a process, which can be killed.
struct Killed<'a> {
    process: Process,
    port: u16,
    data: std::path::PathBuf,
    file: std::path::PathBuf,
    bucket: &'a Bucket,
}

impl<'a> Killed<'a> {
    fn start(folder: &Path, name: &str, postgres: &Postgres, bucket: &'a Bucket) -> Self {
        let (data, file, port) = (folder.join(name), folder.join(format!("{name}.toml")), free_port());
        std::fs::create_dir_all(&data).unwrap();
        let text = format!(
            "listen = \"127.0.0.1:{port}\"\nagent_listen = \"127.0.0.1:0\"\ndata = {data:?}\nfleet_name = \"{name}\"\n\
             fleet_archive = \"s3://flights/lab\"\nfleet_index = \"{}\"\n",
            postgres.url("postgres")
        );
        std::fs::write(&file, text).unwrap();
        let mut killed = Self { process: Process::start(&mut Command::new("true")), port, data, file, bucket };
        killed.start_again();
        killed
    }

    fn start_again(&mut self) {
        let mut command = Command::new(env!("CARGO_BIN_EXE_plumbline-ground"));
        self.process = Process::start(command.arg("--config").arg(&self.file).envs(self.bucket.settings()));
        listens(self.port);
    }
}

/// GIVEN two grounds with flights of their own WHEN grounds, index and storage are killed while these are shared THEN every flight is
/// in the archive once and whole, and both grounds list them all.
#[test]
fn grounds_index_and_storage_are_killed_and_every_flight_is_in_the_archive_once() {
    const FLIGHTS: usize = 12;
    let folder = tempfile::tempdir().unwrap();
    let (Some(mut postgres), Some(bucket)) = (Postgres::start(folder.path()), Bucket::start("flights")) else { return };
    bucket.make();
    let rounds: usize = std::env::var("PLUMBLINE_ROUNDS").map_or(8, |rounds| rounds.parse().unwrap());
    let runtime = tokio::runtime::Runtime::new().unwrap();
    // Flights as a ground leaves them, of one that shares nothing.
    let made = folder.path().join("made");
    std::fs::create_dir(&made).unwrap();
    runtime.block_on(async {
        let ground = Ground::start(&made).await;
        let mut agent = ground.agent("iris-1", 1).await;
        for n in 0..2 * FLIGHTS {
            flown(&mut agent, &ground, &format!("f{n:02}")).await;
        }
        ground.stop().await;
    });
    for (n, name) in (0..2 * FLIGHTS).zip(["east", "west"].into_iter().cycle()) {
        let flights = folder.path().join(name).join("flights");
        std::fs::create_dir_all(&flights).unwrap();
        let file = format!("f{n:02}.mcap");
        std::fs::rename(made.join("flights").join(&file), flights.join(&file)).unwrap();
    }
    let mut grounds = ["east", "west"].map(|name| Killed::start(folder.path(), name, &postgres, &bucket));
    let mut dice = drawn();
    for _ in 0..rounds {
        std::thread::sleep(Duration::from_millis(120 + (400.0 * dice.uniform()) as u64));
        match (4.0 * dice.uniform()) as u64 {
            0 => grounds[0].process.kill(),
            1 => {
                postgres.kill();
                postgres.start_again();
            }
            2 => grounds[1].process.kill(),
            _ => {
                // The storage is lost, and its index with it: it is put back from what the grounds have.
                for ground in &mut grounds {
                    ground.process.kill();
                    std::fs::remove_file(ground.data.join("fleet.sqlite")).unwrap_or_default();
                }
                bucket.delete();
                bucket.make();
                postgres.kill();
                postgres.start_again();
                runtime.block_on(execute(&postgres, "DROP TABLE IF EXISTS plumbline_flights, plumbline_database"));
            }
        }
        for ground in &mut grounds {
            if ground.process.0.try_wait().unwrap().is_some() {
                ground.start_again();
            }
        }
    }
    let begun = Instant::now();
    let keys = loop {
        let keys = bucket.keys();
        if keys.len() >= 4 * FLIGHTS {
            break keys;
        }
        assert!(begun.elapsed() < PATIENCE, "{keys:?}");
        std::thread::sleep(Duration::from_millis(200));
    };
    let stems: BTreeSet<&str> = keys.iter().filter_map(|key| key.strip_prefix("lab/")?.strip_suffix(".json")).collect();
    assert_eq!((keys.len(), stems.len()), (4 * FLIGHTS, 2 * FLIGHTS), "each once, with its entry: {keys:?}");
    // Each ground fetches what the other has, byte for byte.
    for ground in &grounds {
        let address = format!("127.0.0.1:{}", ground.port);
        for n in 0..2 * FLIGHTS {
            let bytes = runtime.block_on(async {
                let begun = Instant::now();
                loop {
                    let mut stream = tokio::net::TcpStream::connect(&address).await.unwrap();
                    let request = format!(
                        "GET /api/v1/flights/f{n:02}/mcap HTTP/1.1\r\nhost: {address}\r\nconnection: close\r\n\r\n"
                    );
                    let answer = Response::parse(&crate::common::exchange(&mut stream, &request).await);
                    if answer.status == 200 {
                        return answer.body;
                    }
                    assert!(begun.elapsed() < PATIENCE, "f{n:02}: {}", answer.text());
                    tokio::time::sleep(Duration::from_millis(100)).await;
                }
            });
            let own = grounds.iter().map(|g| g.data.join(format!("flights/f{n:02}.mcap"))).find(|path| path.exists());
            assert!(std::fs::read(own.unwrap()).unwrap() == bytes, "f{n:02}");
        }
    }
    println!("{rounds} kills, {} flights", 2 * FLIGHTS);

    // What the doctor says of its servers, one there and one away.
    postgres.kill();
    let mut doctor = Command::new(env!("CARGO_BIN_EXE_plumbline-ground"));
    let told = doctor.arg("doctor").arg("--config").arg(&grounds[0].file).envs(bucket.settings()).output().unwrap();
    let told = String::from_utf8(told.stdout).unwrap();
    assert!(told.contains(&format!("ok       fleet: s3://flights/lab has {} files", 4 * FLIGHTS)), "{told}");
    assert!(told.contains("warning  fleet: PostgreSQL at 127.0.0.1/postgres: "), "{told}");
}
