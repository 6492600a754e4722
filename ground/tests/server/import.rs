//! Recordings from elsewhere become flights.

use plumbline_ground::GroundConfig;
use plumbline_proto::{Kind, v1};

use crate::common::{Ground, Response, mcap_counts};
use plumbline_analysis::recordings::shared;

/// A ground whose index is in line with its files.
async fn started(folder: &std::path::Path) -> Ground {
    let ground = Ground::start(folder).await;
    ground.wait_json("/api/v1/flights", |flights| flights["ready"] == true).await;
    ground
}

/// Name and content.
type File<'a> = (&'a str, &'a [u8]);

/// Sends files as a browser's form does.
async fn send(ground: &Ground, files: &[File<'_>]) -> Response {
    let mut body = Vec::new();
    for (name, bytes) in files {
        let head = format!("--b\r\nContent-Disposition: form-data; name=\"file\"; filename=\"{name}\"\r\n\r\n");
        body.extend(head.as_bytes());
        body.extend(*bytes);
        body.extend(b"\r\n");
    }
    body.extend(b"--b--\r\n");
    ground.request_with("POST", "/api/v1/flights", "multipart/form-data; boundary=b", &body, &[]).await
}

/// The bytes of a flight that was recorded by another ground.
async fn recorded_elsewhere() -> Vec<u8> {
    let folder = tempfile::tempdir().unwrap();
    let ground = started(folder.path()).await;
    let mut agent = ground.agent("iris-7", 1).await;
    agent.describe().await;
    let first = agent.begin("f7").await;
    for _ in 0..400 {
        let tick = agent.tick();
        agent.send(tick, false).await;
    }
    let last = agent.end("f7", first);
    agent.send([last], false).await;
    ground.wait_json("/api/v1/flights/f7", |f| f["completeness"] == "complete").await;
    let file = ground.get("/api/v1/flights/f7/mcap").await.body;
    ground.stop().await;
    file
}

#[tokio::test(flavor = "multi_thread")]
async fn a_flight_of_another_ground_is_the_same_here_and_comes_once() {
    let file = recorded_elsewhere().await;
    let folder = tempfile::tempdir().unwrap();
    let ground = started(folder.path()).await;
    let taken = send(&ground, &[("other.mcap", &file)]).await;
    assert_eq!(taken.status, 201, "{}", taken.text());
    assert_eq!(taken.json(), serde_json::json!({ "flight": "f7", "already": false, "notes": [] }));
    let flight = ground.json("/api/v1/flights/f7").await;
    assert_eq!((flight["vehicle_id"].as_str(), flight["completeness"].as_str()), (Some("iris-7"), Some("complete")));
    assert_eq!(flight["notes"], "imported from other.mcap", "so that retention keeps it");
    assert_eq!(ground.get("/api/v1/flights/f7/mcap").await.body, file, "byte for byte");

    let again = send(&ground, &[("renamed.mcap", &file)]).await;
    assert_eq!((again.status, &again.json()["already"]), (200, &true.into()));
    assert_eq!(ground.json("/api/v1/flights").await["total"], 1);
    assert_eq!(ground.json("/api/v1/flights/f7").await["notes"], "imported from other.mcap", "nothing was changed");
    ground.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_flight_cut_in_the_middle_is_repaired_and_says_so() {
    let file = recorded_elsewhere().await;
    let folder = tempfile::tempdir().unwrap();
    let ground = started(folder.path()).await;
    // Into the index at its end: every message is there. And to where no chunk is whole.
    let taken = send(&ground, &[("cut.mcap", &file[..file.len() - 20])]).await;
    assert_eq!(taken.status, 201, "{}", taken.text());
    assert_eq!(taken.json()["notes"][0], "repaired: it ends in the middle, as a crash leaves it");
    let here = ground.get("/api/v1/flights/f7/mcap").await.body;
    assert_eq!(mcap_counts(&here), mcap_counts(&file));
    assert_eq!(ground.request("DELETE", "/api/v1/flights/f7", "").await.status, 204);
    let nothing = send(&ground, &[("begun.mcap", &file[..600])]).await;
    assert_eq!(nothing.status, 422);
    assert!(nothing.error().contains("no message of \"begun.mcap\" can be read"), "{}", nothing.error());
    assert_eq!(ground.json("/api/v1/flights").await["total"], 0);
    ground.stop().await;
}

/// A minute of a BROAD trial in which nothing moves.
fn at_rest(seconds: usize) -> String {
    let mut table =
        "t_s,gx_rad_s,gy_rad_s,gz_rad_s,ax_m_s2,ay_m_s2,az_m_s2,mx_uT,my_uT,mz_uT,ref_qw,ref_qx,ref_qy,ref_qz,\
                     ref_px_m,ref_py_m,ref_pz_m,movement\n"
            .to_owned();
    for sample in 0..seconds * 100 {
        table += &format!("{:.2},0,0,0,0,0,9.81,0,20,-40,1,0,0,0,0,0,0.5,1\n", sample as f64 * 0.01);
    }
    table
}

#[tokio::test(flavor = "multi_thread")]
async fn another_programs_recording_is_flown_through_every_estimator() {
    let folder = tempfile::tempdir().unwrap();
    let ground = started(folder.path()).await;
    let table = at_rest(20);
    let taken = send(&ground, &[("01 rest.csv", table.as_bytes())]).await;
    assert_eq!(taken.status, 201, "{}", taken.text());
    let id = taken.json()["flight"].as_str().unwrap().to_owned();
    let flight = ground.json(&format!("/api/v1/flights/{id}")).await;
    assert_eq!((flight["name"].as_str(), flight["vehicle_id"].as_str()), (Some("01 rest.csv"), Some("01-rest")));
    assert_eq!(flight["completeness"], "complete");
    assert!((flight["duration_s"].as_f64().unwrap() - 20.0).abs() < 0.1, "{}", flight["duration_s"]);
    assert!(flight["notes"].as_str().unwrap().starts_with("imported from 01 rest.csv (broad), SHA-256 "), "{flight}");
    let counts = mcap_counts(&ground.get(&format!("/api/v1/flights/{id}/mcap")).await.body);
    let of = |kind: Kind, instance| counts.get(&kind.topic(instance)).copied().unwrap_or_default();
    assert!(of(Kind::Imu, 1) >= 1990, "{counts:?}");
    for estimator in [v1::EstimatorKind::EkfBias, v1::EstimatorKind::Vqf, v1::EstimatorKind::Complementary] {
        assert!(of(Kind::Estimate, estimator as u16) >= 500, "{estimator:?}: {counts:?}");
    }
    assert!(of(Kind::Truth, 0) >= 500, "its reference is the truth: {counts:?}");

    let again = send(&ground, &[("copy.csv", table.as_bytes())]).await;
    assert_eq!((again.status, again.json()["flight"].as_str()), (200, Some(id.as_str())), "known by its content");
    ground.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_is_no_recording_is_said_with_its_name_and_leaves_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let ground = started(folder.path()).await;
    let table = at_rest(1);
    let bad_row = table.clone() + "1.00,0,0,zero,0,0,9.8,0,20,-40,1,0,0,0,0,0,0.5,0\n";
    let half = "t_s,gx_rad_s\n0,1\n";
    let cases: [(&[File<'_>], &str); 10] = [
        (&[], "there is no file in the form"),
        (&[("empty.ulg", b"")], "empty.ulg: an empty file; supported are Plumbline flight files"),
        (&[("notes.txt", b"hello\n")], "notes.txt: a file that begins with \"hello\""),
        (&[("half.csv", half.as_bytes())], "half.csv: no column \"gy_rad_s\""),
        (&[("row.csv", bad_row.as_bytes())], "row.csv: line 102: gz_rad_s is \"zero\""),
        (&[("other.mcap", b"\x89MCAP0\r\n\x01")], "no message of \"other.mcap\" can be read"),
        (&[("log.ulg", b"ULog\x01\x12\x35\x01short")], "log.ulg"),
        (&[("walk/a.csv", b"1"), ("walk/b.csv", b"2")], "walk: a folder without IMU_1.csv and GT.csv"),
        (&[("a.csv", b"1"), ("a.csv", b"2")], "\"a.csv\" is in it twice"),
        (&[("../..", b"1")], "\"../..\" is no name of a file"),
    ];
    for (files, expected) in cases {
        let refused = send(&ground, files).await;
        assert_eq!(refused.status, 422, "{expected}: {}", refused.text());
        assert!(refused.error().contains(expected), "{expected}: {}", refused.error());
        assert!(!refused.error().contains("incoming"), "the folder is nobody's business: {}", refused.error());
    }
    let form = ground.request("POST", "/api/v1/flights", "{}").await;
    assert_eq!(form.status, 422, "{}", form.text());
    let left: Vec<_> = std::fs::read_dir(folder.path().join("flights")).unwrap().flatten().collect();
    assert!(left.is_empty(), "{left:?}");
    ground.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_full_disk_takes_nothing_in_and_says_how_much_is_free() {
    let folder = tempfile::tempdir().unwrap();
    let mut config = GroundConfig::new(folder.path());
    config.reserve_bytes = u64::MAX / 2;
    let ground = Ground::start_with(config).await;
    ground.wait_json("/api/v1/flights", |flights| flights["ready"] == true).await;
    let refused = send(&ground, &[("01 rest.csv", at_rest(1).as_bytes())]).await;
    assert_eq!(refused.status, 503, "{}", refused.text());
    assert!(refused.error().contains("bytes are free"), "{}", refused.error());
    ground.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn real_recordings_of_four_programs_become_flights() {
    let folder = tempfile::tempdir().unwrap();
    let ground = started(folder.path()).await;
    let cases = [
        ("px4_ulog/test_ulog.ulg", "px4-ulog", 1),
        ("broad_imu_mocap/02_undisturbed_slow_rotation_B.csv.gz", "broad", 1),
        ("rotorpy_sim/hummingbird_lissajous.csv.gz", "rotorpy", 1),
        ("phantom4_4imu_rtk/Horizontal_path_1", "phantom4", 4),
    ];
    for (path, format, imus) in cases {
        let Some(path) = shared(&format!("data/{path}")) else { return };
        let name = path.file_name().unwrap().to_str().unwrap();
        let inside = |file: &std::path::Path| format!("{name}/{}", file.file_name().unwrap().to_str().unwrap());
        let files: Vec<(String, Vec<u8>)> = if path.is_dir() {
            let files =
                std::fs::read_dir(&path).unwrap().map(|entry| entry.unwrap().path()).filter(|path| path.is_file());
            files.map(|file| (inside(&file), std::fs::read(&file).unwrap())).collect()
        } else {
            vec![(name.to_owned(), std::fs::read(&path).unwrap())]
        };
        let sent: Vec<File<'_>> = files.iter().map(|(name, bytes)| (name.as_str(), bytes.as_slice())).collect();
        let taken = send(&ground, &sent).await;
        assert_eq!(taken.status, 201, "{name}: {}", taken.text());
        let id = taken.json()["flight"].as_str().unwrap().to_owned();
        let flight = ground.json(&format!("/api/v1/flights/{id}")).await;
        let expected = format!("imported from {name} ({format}), SHA-256 ");
        assert!(flight["notes"].as_str().unwrap().starts_with(&expected), "{}", flight["notes"]);
        assert_eq!((flight["name"].as_str(), flight["completeness"].as_str()), (Some(name), Some("complete")));
        let counts = mcap_counts(&ground.get(&format!("/api/v1/flights/{id}/mcap")).await.body);
        let sensors = (1..=8).filter(|instance| counts.contains_key(&Kind::Imu.topic(*instance))).count();
        assert_eq!(sensors, imus, "{name}: {counts:?}");
        assert!(counts[&Kind::Estimate.topic(v1::EstimatorKind::EkfBias as u16)] > 500, "{name}: {counts:?}");
    }
    ground.stop().await;
}
