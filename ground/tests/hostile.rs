//! The cut, the sign of life and whoever holds control get through, whatever other clients do.
//!
//! Each test is one load that held up the cut for seconds, or had it refused. How fast the cut is beneath such loads is
//! measured by `cargo xtask chaos clients`.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

#[path = "server/common/mod.rs"]
mod common;

use std::io::Write as _;
use std::os::unix::fs::OpenOptionsExt as _;
use std::path::Path;
use std::time::{Duration, Instant};

use common::agent::Agent;
use common::viewer::{Viewer, frames};
use common::{Ground, PATIENCE, Response, mcap_counts};
use plumbline_ground::people::{Accounts, Role};
use plumbline_ground::{GroundConfig, front};
use plumbline_proto::v1::{self, command};
use tokio::io::AsyncWriteExt as _;
use tokio::net::TcpStream;

const PASSWORD: &str = "correct horse battery";

/// Signs in; the cookie.
async fn sign_in(ground: &Ground, name: &str) -> String {
    let body = format!(r#"{{"name":"{name}","password":"{PASSWORD}"}}"#);
    let answer = ground.request("POST", "/api/v1/session", &body).await;
    assert_eq!(answer.status, 200, "{}", answer.text());
    answer.header("set-cookie").unwrap().split(';').next().unwrap().to_owned()
}

/// Cuts as the person with this cookie.
async fn cut(ground: &Ground, cookie: &str) -> Response {
    let origin = format!("http://{}", ground.address);
    let headers = [("cookie", cookie), ("origin", origin.as_str()), ("x-plumbline-operator", "page")];
    ground.request_as("POST", "/api/v1/vehicles/iris-1/cut", "{}", &headers).await
}

/// A pipe instead of a file: whoever opens it for writing waits until it is read, as for a disk that does not answer.
fn stall(path: &Path) {
    let made = std::process::Command::new("mkfifo").arg(path).status().unwrap();
    assert!(made.success());
}

#[tokio::test(flavor = "multi_thread")]
async fn a_disk_that_does_not_tell_the_accounts_holds_up_nobody() {
    let folder = tempfile::tempdir().unwrap();
    Accounts::of(folder.path()).add("ann", Role::Operator, PASSWORD).unwrap();
    let ground = Ground::start(folder.path()).await;
    let mut agent = ground.agent("iris-1", 1).await;
    let cookie = sign_in(&ground, "ann").await;
    // GIVEN accounts that are being read from a disk that does not answer
    let file = folder.path().join("people/accounts.json");
    let kept = std::fs::read(&file).unwrap();
    std::fs::remove_file(&file).unwrap();
    stall(&file);
    let begun = Instant::now();
    let mut pipe = loop {
        // Refused for as long as nobody reads.
        match std::fs::File::options().write(true).custom_flags(libc::O_NONBLOCK).open(&file) {
            Ok(pipe) => break pipe,
            Err(error) => assert!(begun.elapsed() < PATIENCE, "nobody looks: {error}"),
        }
        tokio::time::sleep(Duration::from_millis(10)).await;
    };
    // WHEN whoever is signed in cuts THEN it is done
    let cuts = async { tokio::join!(cut(&ground, &cookie), agent.accept()) };
    let (answer, command) = tokio::time::timeout(PATIENCE, cuts).await.expect("a cut");
    assert_eq!(answer.status, 200, "{}", answer.text());
    assert!(matches!(command.body, Some(command::Body::CutMotors(_))));
    // The next look finds a file.
    std::fs::remove_file(&file).unwrap();
    std::fs::write(&file, &kept).unwrap();
    pipe.write_all(&kept).unwrap();
    drop(pipe);
    ground.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_sign_in_that_waits_for_the_disk_holds_up_nobody_else() {
    let folder = tempfile::tempdir().unwrap();
    let accounts = Accounts::of(folder.path());
    accounts.add("ann", Role::Operator, PASSWORD).unwrap();
    accounts.add("bob", Role::Viewer, PASSWORD).unwrap();
    let ground = Ground::start(folder.path()).await;
    let mut agent = ground.agent("iris-1", 1).await;
    let begun = Instant::now();
    let cookie = sign_in(&ground, "ann").await;
    let checked_within = 5 * begun.elapsed();
    // GIVEN a disk that takes the sessions of nobody any more
    let stalled = folder.path().join("people/sessions.json.tmp");
    stall(&stalled);
    // WHEN somebody signs in, and their session waits for the disk
    let mut bob = Box::pin(sign_in(&ground, "bob"));
    // THEN cuts go through meanwhile, for longer than it takes to check a password and begin a session
    let cuts = async {
        let begun = Instant::now();
        while begun.elapsed() < checked_within {
            let (answer, command) = tokio::join!(cut(&ground, &cookie), agent.accept());
            assert_eq!(answer.status, 200, "{}", answer.text());
            assert!(matches!(command.body, Some(command::Body::CutMotors(_))));
        }
    };
    tokio::select! {
        _ = bob.as_mut() => panic!("signed in, although the session cannot be written"),
        () = cuts => {}
    }
    // AND when the disk answers, the sign-in is
    let reader = std::thread::spawn(move || std::fs::read(stalled));
    bob.await;
    reader.join().unwrap().unwrap();
    ground.stop().await;
}

/// Cuts on the loopback, where nobody signs in.
async fn cut_here(ground: &Ground, agent: &mut Agent) {
    let cut = async { tokio::join!(ground.request("POST", "/api/v1/vehicles/iris-1/cut", "{}"), agent.accept()) };
    let (answer, command) = tokio::time::timeout(PATIENCE, cut).await.expect("a cut");
    assert_eq!(answer.status, 200, "{}", answer.text());
    assert!(matches!(command.body, Some(command::Body::CutMotors(_))), "{command:?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn half_sent_requests_take_no_place_of_the_cut() {
    let folder = tempfile::tempdir().unwrap();
    let ground = Ground::start(folder.path()).await;
    let mut agent = ground.agent("iris-1", 1).await;
    ground.wait_json("/api/v1/vehicles", |v| v[0]["connected"] == true).await;
    // GIVEN more half-sent requests than there are places
    let mut half = Vec::new();
    for _ in 0..front::MAX_CONNECTIONS + 100 {
        let mut stream = TcpStream::connect(ground.address).await.unwrap();
        stream.write_all(b"POST /api/v1/vehicles/iris-1/cut HTTP/1.1\r\n").await.unwrap();
        half.push(stream);
    }
    // WHEN somebody cuts THEN it is done
    cut_here(&ground, &mut agent).await;
    drop(half);
    ground.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn silent_connections_keep_nobody_from_a_handshake() {
    let folder = tempfile::tempdir().unwrap();
    Accounts::of(folder.path()).add("ann", Role::Operator, PASSWORD).unwrap();
    let (certificate, key) = front::own(&folder.path().join("tls"), &["localhost".into()]).unwrap();
    let mut config = GroundConfig::new(folder.path());
    config.tls = Some(front::tls(&certificate, &key).unwrap().0);
    let ground = Ground::start_on(config, "127.0.0.1:0").await;
    let mut silent = Vec::new();
    for _ in 0..300 {
        silent.push(TcpStream::connect(ground.address).await.unwrap());
    }
    // A handshake may take ten seconds: beside each other, not one after the other.
    let asked = async {
        let mut stream = common::tls(&ground, &certificate).await;
        let request = format!("GET /api/v1/session HTTP/1.1\r\nhost: {}\r\nconnection: close\r\n\r\n", ground.address);
        Response::parse(&common::exchange(&mut stream, &request).await)
    };
    assert_eq!(tokio::time::timeout(PATIENCE, asked).await.expect("an answer").status, 200);
    drop(silent);
    ground.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn whoever_holds_control_may_reload_behind_any_number_of_viewers() {
    let folder = tempfile::tempdir().unwrap();
    let ground = Ground::start(folder.path()).await;
    let mut agent = ground.agent("iris-1", 1).await;
    ground.wait_json("/api/v1/vehicles", |v| v[0]["connected"] == true).await;
    let url = |who: &str| format!("ws://{}/api/v1/vehicles/iris-1/live?operator={who}", ground.address);
    let mut crowd = Vec::new();
    let refused = loop {
        match Viewer::connect(&url(&format!("viewer-{}", crowd.len())), None).await {
            Ok(viewer) => crowd.push(viewer),
            Err(error) => break error.to_string(),
        }
    };
    assert!(refused.contains("503"), "{refused}");
    let headers = [("x-plumbline-operator", "page")];
    let arm = ground.request_as("POST", "/api/v1/vehicles/iris-1/disarm", "{}", &headers);
    assert_eq!(tokio::join!(arm, agent.accept()).0.status, 200);
    let reloaded = Viewer::connect(&url("page"), None).await;
    assert!(reloaded.is_ok(), "{:?}", reloaded.err());
    drop((crowd, reloaded));
    ground.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_cut_goes_past_the_commands_that_wait() {
    let folder = tempfile::tempdir().unwrap();
    let mut config = GroundConfig::new(folder.path());
    config.command_timeout = PATIENCE;
    let ground = Ground::start_with(config).await;
    let mut agent = ground.agent("iris-1", 1).await;
    ground.wait_json("/api/v1/vehicles", |v| v[0]["connected"] == true).await;
    // GIVEN an operator with as many commands waiting as there may be, more than the link's queue takes
    let flood = (0..300).map(|_| ground.request("POST", "/api/v1/vehicles/iris-1/disarm", "{}"));
    let mut flood = Box::pin(futures_util::future::select_all(flood.map(Box::pin)));
    let (refused, _, rest) = flood.as_mut().await;
    assert_eq!(refused.status, 503, "the first answer says that there are too many");
    // WHEN the same operator cuts THEN the vehicle hears it and the answer comes, whatever else waits
    let heard = async {
        loop {
            let command = agent.command().await;
            if matches!(command.body, Some(command::Body::CutMotors(_))) {
                break agent.ack(command.command_id, v1::AckStage::Accepted, "done").await;
            }
        }
    };
    let cut = async { tokio::join!(ground.request("POST", "/api/v1/vehicles/iris-1/cut", "{}"), heard) };
    tokio::select! {
        (answer, ()) = cut => assert_eq!(answer.status, 200, "{}", answer.text()),
        _ = futures_util::future::join_all(rest) => panic!("the flood was answered before the cut"),
    }
    drop(flood);
    ground.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_flight_in_progress_is_served_as_it_is_and_a_download_of_it_goes_on() {
    let folder = tempfile::tempdir().unwrap();
    let ground = Ground::start(folder.path()).await;
    let mut agent = ground.agent("iris-1", 1).await;
    let first = agent.begin("f1").await;
    let fly = async |ground: &Ground, agent: &mut Agent| {
        agent.fly(40).await;
        let sent = agent.sequence + 1 - first;
        ground.wait_json("/api/v1/flights/f1", |f| f["messages"].as_u64() >= Some(sent)).await;
    };
    fly(&ground, &mut agent).await;
    // GIVEN a download that broke off in the middle
    let path = "/api/v1/flights/f1/mcap";
    let whole = ground.get(path).await;
    let tag = whole.header("etag").expect("a tag").to_owned();
    assert_eq!((whole.status, whole.header("accept-ranges")), (200, Some("bytes")));
    let ranged =
        async |range: &str, tag: &str| ground.request_as("GET", path, "", &[("range", range), ("if-range", tag)]).await;
    let part = ranged("bytes=10-99", &tag).await;
    assert_eq!((part.status, part.body.as_slice()), (206, &whole.body[10..100]));
    let expected = format!("bytes 10-99/{}", whole.body.len());
    assert_eq!(part.header("content-range"), Some(expected.as_str()));
    // WHEN the flight has grown THEN the rest is that of the same file, and a download of now has more
    fly(&ground, &mut agent).await;
    let rest = ranged(&format!("bytes={}-", whole.body.len() / 2), &tag).await;
    assert_eq!((rest.status, rest.body.as_slice()), (206, &whole.body[whole.body.len() / 2..]));
    let grown = ground.get(path).await;
    assert!(grown.body.len() > whole.body.len() && grown.header("etag") != Some(tag.as_str()));
    let asked = async |range: &str| ground.request_as("GET", path, "", &[("range", range)]).await;
    let length = grown.body.len();
    for beyond in ["bytes=999999999-", "bytes=999999999-9999999999", "bytes=-0", &format!("bytes={length}-")] {
        let answer = asked(beyond).await;
        assert_eq!(answer.status, 416, "{beyond}");
        assert!(answer.error().contains(&format!("{length} bytes")), "{}", answer.text());
        assert_eq!(answer.json()["code"], "range_not_satisfiable");
        assert_eq!(answer.header("content-range"), Some(format!("bytes */{length}").as_str()), "{beyond}");
    }
    // What is no range of bytes, and several, is passed over.
    for range in ["bytes=z", "bytes=9-2", "bytes=", "bytes=--1", "bytes=+1-2", "lines=1-2", "z", "bytes=1-2,5-6"] {
        let answer = asked(range).await;
        assert_eq!((answer.status, answer.header("content-range")), (200, None), "{range}");
        assert!(answer.body == grown.body, "{range}");
    }
    for (range, from, until) in
        [("bytes=-7", length - 7, length), ("bytes=5-999999999", 5, length), ("bytes=0-0", 0, 1)]
    {
        let answer = asked(range).await;
        assert_eq!((answer.status, answer.body.as_slice()), (206, &grown.body[from..until]), "{range}");
    }
    // Whoever has it already is sent nothing, whatever range of it is asked for.
    let now = grown.header("etag").unwrap();
    for (known, status) in
        [(now.to_owned(), 304), (format!("\"a\", W/{now}"), 304), ("*".into(), 304), (tag.clone(), 206)]
    {
        let headers = [("range", "bytes=0-0"), ("if-none-match", known.as_str())];
        let answer = ground.request_as("GET", path, "", &headers).await;
        assert_eq!((answer.status, answer.header("etag")), (status, Some(now)), "{known}");
    }
    // AND nothing was written to the disk for any of them
    let names: Vec<_> =
        std::fs::read_dir(folder.path().join("flights")).unwrap().flatten().map(|e| e.file_name()).collect();
    assert_eq!(names, ["f1.001.part"]);
    // AND when it is finished, another file is sent, as a whole
    let last = agent.end("f1", first);
    agent.send([last], false).await;
    ground.wait_json("/api/v1/flights/f1", |f| f["completeness"] == "complete").await;
    let finished = ranged("bytes=10-99", &tag).await;
    assert_eq!((finished.status, finished.header("content-range")), (200, None));
    ground.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_flight_in_several_parts_is_one_file_with_each_message_once() {
    let folder = tempfile::tempdir().unwrap();
    let ground = Ground::start(folder.path()).await;
    let mut agent = ground.agent("iris-1", 1).await;
    let first = agent.begin("f1").await;
    let fly = async |ground: &Ground, agent: &mut Agent| {
        agent.fly(40).await;
        ground
            .wait_json("/api/v1/flights/f1", |f| f["last_sequence"].is_null() && f["messages"].as_u64() > Some(0))
            .await;
    };
    fly(&ground, &mut agent).await;
    ground.stop().await;
    // GIVEN a ground that was started again in flight: a file and a part of the same flight
    let ground = Ground::start(folder.path()).await;
    agent.reconnect(ground.link.clone()).await;
    agent.status("f1", 0).await;
    fly(&ground, &mut agent).await;
    let all = agent.sequence + 1 - first;
    ground.wait_json("/api/v1/flights/f1", |f| f["messages"].as_u64() >= Some(all)).await;
    // THEN it is read as one file, each message once, in the order of time
    let got = frames(&ground.get("/api/v1/flights/f1/frames").await.body);
    let sequences: Vec<u64> = got.iter().map(|frame| frame.sequence).collect();
    assert_eq!(sequences.len() as u64, all);
    assert!(sequences.is_sorted());
    let file = ground.get("/api/v1/flights/f1/mcap").await;
    assert!(mcap_counts(&file.body).values().sum::<u64>() >= all);
    ground.stop().await;
}
