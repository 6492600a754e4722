use super::*;
use crate::recorder::{Completeness, Flight};
use std::time::Duration;

const DAY_US: u64 = 86_400_000_000;

fn flight(id: &str, day: u64, size_bytes: u64) -> Flight {
    let started_unix_us = day * DAY_US;
    Flight { id: id.into(), started_unix_us, size_bytes, completeness: Completeness::Complete, ..Flight::default() }
}

fn ids(flights: &[Flight], policy: &Retention) -> Vec<String> {
    due(flights, &BTreeMap::new(), policy, 100 * DAY_US).into_iter().map(|due| due.id).collect()
}

#[test]
fn what_is_recorded_incomplete_or_named_is_never_due() {
    let mut flights: Vec<_> = (0..6).map(|n| flight(&format!("f{n}"), 10 + n, 100)).collect();
    flights[0].completeness = Completeness::Recording;
    flights[1].completeness = Completeness::Truncated;
    flights[2].name = "figure 3".into();
    flights[3].notes = "bumped".into();
    let day = Duration::from_secs(86_400);
    let none = Retention::default();
    assert!(!none.limits() && ids(&flights, &none).is_empty());
    assert_eq!(ids(&flights, &Retention { age: Some(day), ..none.clone() }), ["f4", "f5"]);
    assert!(ids(&flights, &Retention { age: Some(day * 91), ..none.clone() }).is_empty());
    // Of 600 bytes those that may go do not suffice.
    assert_eq!(ids(&flights, &Retention { bytes: Some(50), ..none.clone() }), ["f4", "f5"]);
    assert_eq!(ids(&flights, &Retention { bytes: Some(500), ..none.clone() }), ["f4"]);
    assert!(ids(&flights, &Retention { bytes: Some(600), ..none }).is_empty());
}

#[test]
fn a_flight_is_no_older_than_its_file() {
    let flights = [flight("clock-behind", 10, 100), flight("old", 20, 100)];
    let written_us = BTreeMap::from([("clock-behind".to_owned(), 99 * DAY_US), ("old".to_owned(), 20 * DAY_US)]);
    let month = Retention { age: Some(Duration::from_secs(30 * 86_400)), ..Retention::default() };
    for policy in [month, Retention { bytes: Some(100), ..Retention::default() }] {
        let due: Vec<_> = due(&flights, &written_us, &policy, 100 * DAY_US).into_iter().map(|due| due.id).collect();
        assert_eq!(due, ["old"]);
    }
}

fn folders() -> (tempfile::TempDir, PathBuf, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let (data, backup) = (folder.path().join("data"), folder.path().join("backup"));
    fs::create_dir_all(data.join("flights")).unwrap();
    for (name, text) in [("a.mcap", "flight a"), ("a.json", "{}"), ("b.mcap", "flight b"), ("c.001.part", "half")] {
        fs::write(data.join("flights").join(name), text).unwrap();
    }
    (folder, data, backup)
}

#[test]
fn a_backup_is_whole_checked_and_put_back_and_nothing_is_replaced() {
    let (_folder, data, backup) = folders();
    let old = std::time::UNIX_EPOCH + Duration::from_secs(86_400);
    File::options().write(true).open(data.join("flights/a.mcap")).unwrap().set_modified(old).unwrap();
    let first = back_up(&data, &backup, &[]).unwrap();
    assert_eq!(first.copied, ["a.mcap", "a.json", "b.mcap"]);
    assert_eq!(first.left[0].0, "c");
    let again = back_up(&data, &backup, &["a".into()]).unwrap();
    assert_eq!((again.copied.len(), again.same), (0, 2));
    assert_eq!(check(&backup).unwrap(), (3, vec![]));
    fs::write(data.join("flights/b.mcap"), "filled since").unwrap();
    assert_eq!(back_up(&data, &backup, &[]).unwrap().copied, ["b.mcap"]);
    fs::remove_file(data.join("flights/a.mcap")).unwrap();
    fs::remove_file(data.join("flights/a.json")).unwrap();
    let back = restore(&backup, &data, &[]).unwrap();
    assert_eq!(back.copied, ["a.json", "a.mcap"]);
    assert_eq!(back.left, [("b.mcap".to_owned(), "it is there already".to_owned())]);
    assert_eq!(fs::read(data.join("flights/a.mcap")).unwrap(), b"flight a");
    let modified = fs::metadata(data.join("flights/a.mcap")).unwrap().modified().unwrap();
    assert_eq!(modified, old, "none becomes younger by that");
    assert!(matches!(restore(&backup, &data, &["z".into()]), Err(RecordingError::Unknown(id)) if id == "z"));
}

#[test]
fn what_a_backup_lost_or_changed_is_named_and_not_put_back() {
    let (_folder, data, backup) = folders();
    back_up(&data, &backup, &[]).unwrap();
    fs::write(backup.join("a.mcap"), "flight A").unwrap();
    fs::remove_file(backup.join("b.mcap")).unwrap();
    let (whole, wrong) = check(&backup).unwrap();
    assert_eq!(whole, 1);
    assert!(wrong[0].starts_with("a.mcap: has ") && wrong[1].contains("b.mcap"), "{wrong:?}");
    fs::remove_file(data.join("flights/a.mcap")).unwrap();
    fs::remove_file(data.join("flights/a.json")).unwrap();
    let error = restore(&backup, &data, &["a".into()]).unwrap_err().to_string();
    assert!(error.contains("a.mcap: has "), "{error}");
    assert!(!data.join("flights/a.mcap").exists());
    let left: Vec<_> = fs::read_dir(data.join("flights")).unwrap().flatten().map(|e| e.file_name()).collect();
    assert!(!left.iter().any(|name| name.to_string_lossy().ends_with(".tmp")), "{left:?}");
    for line in ["no hash", &format!("{}  ../a.mcap", "0".repeat(64)), &format!("{}  a.mcap", "0".repeat(63))] {
        fs::write(backup.join(SUMS), line).unwrap();
        let error = check(&backup).unwrap_err().to_string();
        assert!(error.contains("line 1"), "{error}");
    }
}

#[test]
fn a_backup_is_what_sha256sum_reads() {
    let (_folder, data, backup) = folders();
    back_up(&data, &backup, &[]).unwrap();
    let ran = std::process::Command::new("sha256sum").args(["--check", "--strict", SUMS]).current_dir(&backup).output();
    let Ok(ran) = ran else {
        println!("skipped: no sha256sum");
        return;
    };
    assert!(ran.status.success(), "{}", String::from_utf8_lossy(&ran.stdout));
}
