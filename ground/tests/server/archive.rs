//! Many flights at once: the tar of them, and what retention deletes.

use std::path::Path;
use std::process::Command;
use std::time::Duration;

use crate::common::Ground;
use plumbline_ground::GroundConfig;
use plumbline_ground::recorder::archive;

async fn flown(ground: &Ground, ids: &[&str]) {
    let mut agent = ground.agent("iris-1", 1).await;
    for id in ids {
        let first = agent.begin(id).await;
        agent.fly(40).await;
        let last = agent.end(id, first);
        agent.send([last], false).await;
        ground.wait_json(&format!("/api/v1/flights/{id}"), |f| f["completeness"] == "complete").await;
    }
}

fn unpack(tar: &Path, folder: &Path) -> bool {
    std::fs::create_dir_all(folder).unwrap();
    Command::new("tar").arg("xf").arg(tar).arg("-C").arg(folder).status().is_ok_and(|status| status.success())
}

/// GIVEN flights in a tar WHEN it is unpacked THEN it is a backup, which a ground that lost them takes back.
#[tokio::test(flavor = "multi_thread")]
async fn a_tar_of_flights_is_a_backup_that_is_put_back() {
    let folder = tempfile::tempdir().unwrap();
    let data = folder.path().join("data");
    std::fs::create_dir(&data).unwrap();
    let ground = Ground::start(&data).await;
    flown(&ground, &["f1", "f2"]).await;
    ground.request("PATCH", "/api/v1/flights/f2", r#"{"name":"figure 3"}"#).await;
    for (query, status, named) in [
        ("", 422, "ids"),
        ("?ids=", 422, "0 flights"),
        ("?ids=f1,none", 404, "none"),
        ("?ids=f1&format=zip", 422, "format"),
    ] {
        let answer = ground.get(&format!("/api/v1/archive{query}")).await;
        assert!(answer.status == status && answer.error().contains(named), "{query}: {}", answer.text());
    }
    let answer = ground.get("/api/v1/archive?ids=f2,f1,f1").await;
    assert_eq!(answer.header("content-disposition"), Some("attachment; filename=\"flights.tar\""));
    let served = ground.get("/api/v1/flights/f1/mcap").await.body;
    let (tar, unpacked) = (folder.path().join("flights.tar"), folder.path().join("unpacked"));
    std::fs::write(&tar, &answer.body).unwrap();
    assert!(unpack(&tar, &unpacked), "tar reads it");
    assert_eq!(archive::check(&unpacked).unwrap(), (3, vec![]));
    assert_eq!(std::fs::read(unpacked.join("f1.mcap")).unwrap(), served);
    let held = archive::restore(&unpacked, &data, &[]).unwrap_err().to_string();
    assert!(held.contains("in use by another ground"), "{held}");
    for id in ["f1", "f2"] {
        assert_eq!(ground.request("DELETE", &format!("/api/v1/flights/{id}"), "").await.status, 204);
    }
    ground.stop().await;
    let restored = archive::restore(&unpacked, &data, &["f2".into()]).unwrap();
    assert_eq!(restored.copied, ["f2.json", "f2.mcap"]);
    let ground = Ground::start(&data).await;
    let flight = ground.wait_json("/api/v1/flights/f2", |f| f["completeness"] == "complete").await;
    assert_eq!(flight["name"], "figure 3");
    // What is not there is known once the index has been put in line with the files.
    ground.wait_ready().await;
    assert_eq!(ground.get("/api/v1/flights/f1").await.status, 404);
    ground.stop().await;
}

/// GIVEN flights WHEN a tar of their tables is asked for THEN each is what is served alone, under its hash, and none is a backup.
#[tokio::test(flavor = "multi_thread")]
async fn a_tar_holds_tables_where_they_are_asked_for() {
    let folder = tempfile::tempdir().unwrap();
    let data = folder.path().join("data");
    std::fs::create_dir(&data).unwrap();
    let ground = Ground::start(&data).await;
    flown(&ground, &["f1", "f2"]).await;
    for (format, ending) in [("csv", "csv"), ("parquet", "parquet"), ("mat", "mat"), ("foxglove", "foxglove.mcap")] {
        let answer = ground.get(&format!("/api/v1/archive?ids=f1,f2&format={format}")).await;
        assert_eq!(answer.status, 200, "{format}: {}", answer.text());
        let (tar, unpacked) = (folder.path().join("tables.tar"), folder.path().join(format));
        std::fs::write(&tar, &answer.body).unwrap();
        assert!(unpack(&tar, &unpacked), "{format}: tar reads it");
        for id in ["f1", "f2"] {
            let served = ground.get(&format!("/api/v1/flights/{id}/{format}")).await.body;
            let file = format!("{id}.{ending}");
            assert!(std::fs::read(unpacked.join(&file)).unwrap() == served, "{file}");
        }
        let sums = Command::new("sha256sum").args(["--check", "SHA256SUMS"]).current_dir(&unpacked).output().unwrap();
        assert!(sums.status.success(), "{}", String::from_utf8_lossy(&sums.stdout));
        let refused = archive::restore(&unpacked, &folder.path().join("new"), &[]).unwrap_err().to_string();
        assert!(!refused.is_empty() && !folder.path().join("new/flights").exists(), "{refused}");
    }
    let answer = ground.get("/api/v1/archive?ids=f1&format=mcap").await;
    assert_eq!(answer.body, ground.get("/api/v1/archive?ids=f1").await.body);
    ground.stop().await;
}

/// GIVEN a limit and a backup that lacks a flight WHEN retention looks THEN it tells first, and deletes what is in the backup and has no name.
#[tokio::test(flavor = "multi_thread")]
async fn retention_tells_before_it_deletes_and_spares_what_is_named_or_in_no_backup() {
    let folder = tempfile::tempdir().unwrap();
    let (data, backup) = (folder.path().join("data"), folder.path().join("backup"));
    std::fs::create_dir(&data).unwrap();
    let ground = Ground::start(&data).await;
    flown(&ground, &["gone", "named", "unsaved"]).await;
    ground.request("PATCH", "/api/v1/flights/named", r#"{"name":"figure 3"}"#).await;
    ground.stop().await;
    archive::back_up(&data, &backup, &["gone".into(), "named".into()]).unwrap();

    let mut config = GroundConfig::new(&data);
    config.reserve_bytes = 1;
    config.retention.bytes = Some(1);
    config.retention.backup = Some(backup);
    config.retention.notice = Duration::from_millis(1500);
    config.retention.every = Duration::from_millis(100);
    let ground = Ground::start_with(config).await;
    let due = ground.wait_json("/api/v1/archive/due", |due| due[0]["deleted_unix_us"].is_u64()).await;
    let ids: Vec<_> = due.as_array().unwrap().iter().map(|due| due["id"].as_str().unwrap()).collect();
    assert_eq!(ids, ["gone", "unsaved"]);
    // The flight says so itself, as long as it is there; what is named does not go.
    let gone = ground.json("/api/v1/flights/gone").await;
    assert_eq!(gone["deleted_unix_us"], due[0]["deleted_unix_us"], "told, and there");
    assert!(ground.json("/api/v1/flights/named").await["deleted_unix_us"].is_null());
    ground.wait_json("/api/v1/flights", |flights| flights["total"] == 2).await;
    let left = ground.json("/api/v1/flights").await;
    let left: Vec<_> = left["flights"].as_array().unwrap().iter().map(|f| f["id"].clone()).collect();
    assert!(!left.contains(&"gone".into()), "{left:?}");
    ground
        .wait_json("/api/v1/audit", |log| {
            let deeds =
                log["deeds"].as_array().into_iter().flatten().filter(|deed| deed["path"] == "/api/v1/flights/gone");
            deeds.map(|deed| deed["method"].as_str().unwrap_or_default().to_owned()).collect::<Vec<_>>()
                == ["DUE", "DELETE"]
        })
        .await;
    ground.stop().await;
}

/// GIVEN an age at which flights are deleted, and a vehicle whose clock is behind by years WHEN its flight is listed THEN it says when that
/// is, from when it landed here, until it has a note.
#[tokio::test(flavor = "multi_thread")]
async fn a_flight_says_when_it_is_deleted() {
    const DAY: Duration = Duration::from_secs(86_400);
    let folder = tempfile::tempdir().unwrap();
    let mut config = GroundConfig::new(folder.path());
    config.reserve_bytes = 1;
    config.retention.age = Some(36_500 * DAY);
    config.retention.notice = 2 * DAY;
    let ground = Ground::start_with(config).await;
    flown(&ground, &["one"]).await;
    let listed = ground.json("/api/v1/flights").await["flights"][0].clone();
    let written = std::fs::metadata(folder.path().join("flights/one.mcap")).unwrap().modified().unwrap();
    let written_s = written.duration_since(std::time::UNIX_EPOCH).unwrap().as_secs_f64();
    let deleted_us = listed["deleted_unix_us"].as_f64().unwrap_or_else(|| panic!("{listed}"));
    let kept_s = deleted_us * 1e-6 - written_s;
    assert!((kept_s - 36_502.0 * DAY.as_secs_f64()).abs() < 1.0, "{kept_s} s");
    let noted = ground.request("PATCH", "/api/v1/flights/one", r#"{"notes":"bumped"}"#).await;
    assert!(noted.status == 200 && noted.text().contains("\"deleted_unix_us\":null"), "{}", noted.text());
    assert!(ground.json("/api/v1/flights/one").await["deleted_unix_us"].is_null());
    ground.stop().await;
}

/// GIVEN a backup that cannot be written, or whose files are cut THEN that is said, and the next backup heals what was cut.
#[test]
fn a_backup_that_cannot_be_written_or_is_cut_says_so_and_loses_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let (data, backup) = (folder.path().join("data"), folder.path().join("backup"));
    let flights = data.join("flights");
    std::fs::create_dir_all(&flights).unwrap();
    for name in ["a.mcap", "b.mcap"] {
        std::fs::write(flights.join(name), format!("flight of {name}")).unwrap();
    }
    let file = folder.path().join("a file");
    std::fs::write(&file, "").unwrap();
    let error = archive::back_up(&data, &file.join("backup"), &[]).unwrap_err().to_string();
    assert!(error.contains("a file"), "{error}");
    archive::back_up(&data, &backup, &[]).unwrap();
    std::fs::write(backup.join("b.mcap"), "flig").unwrap();
    let (_, wrong) = archive::check(&backup).unwrap();
    assert!(wrong.len() == 1 && wrong[0].starts_with("b.mcap: has "), "{wrong:?}");
    assert_eq!(archive::back_up(&data, &backup, &[]).unwrap().copied, ["b.mcap"]);
    let sums = backup.join("SHA256SUMS");
    let text = std::fs::read_to_string(&sums).unwrap();
    std::fs::write(&sums, &text[..text.len() - 40]).unwrap();
    let error = archive::check(&backup).unwrap_err().to_string();
    assert!(error.contains("SHA256SUMS") && error.contains("line"), "{error}");
    assert_eq!(std::fs::read(flights.join("b.mcap")).unwrap(), b"flight of b.mcap");
}
