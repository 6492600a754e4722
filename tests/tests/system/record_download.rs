//! Recording is on by default; what is downloaded is what was promised, whoever reads it.

use plumbline_support::files;
use plumbline_support::system::{Rig, options, promised_counts, scenario};
use serde_json::{Value, json};

#[test]
fn a_flight_is_recorded_listed_downloaded_renamed_and_deleted() {
    // GIVEN a short flight on the strings
    let rig = Rig::start(&scenario("altitude_step"));
    let mut live = rig.live();
    rig.fly_to(0.5);
    live.step_response(0.5);
    // Long enough that an estimator that starts in it without knowing anything is not judged by its start alone.
    rig.command("POST", "setpoint", json!({ "altitude_m": 0.8 }));
    live.step_response(0.8);
    rig.disarm();
    // THEN it is in the list, complete, with what happened in it
    let flight = rig.finished_flight();
    let id = flight["id"].as_str().unwrap().to_owned();
    assert_eq!(flight["missing"], 0, "{flight}");
    assert!(flight["duration_s"].as_f64().unwrap() > 1.0, "{flight}");
    assert!(flight["steps"].as_array().is_some_and(|steps| !steps.is_empty()), "{flight}");
    let promised = promised_counts(&flight);
    for topic in ["/estimate/1", "/residuals/1", "/control", "/sensor/height/2", "/sensor/imu/1", "/status", "/truth"] {
        assert!(promised.get(topic).is_some_and(|count| *count > 0), "nothing of {topic}: {promised:?}");
    }
    // AND its file holds exactly the promised messages, for our reader and for a stranger's
    let route = |part: &str| format!("/api/v1/flights/{id}{part}");
    let file = rig.api().get(&route("/mcap")).unwrap();
    assert_eq!(file.status, 200);
    assert!(file.header("content-disposition").is_some_and(|value| value.contains(".mcap")), "{:?}", file.headers);
    assert_eq!(files::counts(&file.body), promised);
    let path = rig.folder.path().join("downloaded.mcap");
    std::fs::write(&path, &file.body).unwrap();
    if let Some(python) = files::python() {
        assert_eq!(files::counts_by(&python, &path).unwrap(), promised);
    }
    // AND every message of one topic is a row of its CSV; the wide one has a row per control tick, thinned to 100 Hz
    let rows = |part: &str| {
        let reply = rig.api().get(&route(part)).unwrap();
        assert_eq!(reply.status, 200, "{}", reply.text());
        let text = reply.text();
        let mut lines = text.lines();
        let columns = lines.next().unwrap().split(',').count();
        assert!(columns > 3, "{text:.200}");
        lines.count() as u64
    };
    assert_eq!(rows("/csv?topic=/estimate/1"), promised["/estimate/1"]);
    let wide = rows("/csv");
    assert!(wide > promised["/control"] / 4 && wide <= promised["/control"], "{wide} rows of {promised:?}");
    // AND an estimator run over it again is as good as in flight; what cannot be is refused with the reason
    let again = rig.api().get_json(&route("/estimate?estimator=ekf_bias")).unwrap();
    let column = |name: &str| again[name].as_array().unwrap().len();
    assert!(column("time_s") > 20, "{again}");
    for name in ["altitude_m", "roll_rad", "pitch_rad", "yaw_rad"] {
        assert_eq!(column(name), column("time_s"), "{name}");
    }
    let worst_m = again["score"]["position_rmse_xyz_m"][2].as_f64().unwrap();
    assert!(worst_m < 0.05, "{}", again["score"]);
    let blind = rig.api().get_json(&route("/estimate?estimator=attitude&sensors=imu")).unwrap();
    assert!(blind["altitude_m"].as_array().unwrap().iter().all(Value::is_null), "{blind}");
    for (query, status, named) in [
        ("?estimator=soup", 422, "soup"),
        ("?estimator=ukf&sensors=imu,gnss", 422, "gnss"),
        ("?estimator=ukf&sensors=height", 422, "imu"),
        ("", 422, "estimator"),
    ] {
        let reply = rig.api().get(&route(&format!("/estimate{query}"))).unwrap();
        assert_eq!(reply.status, status, "{query}: {}", reply.text());
        assert!(reply.text().contains(named), "{query}: {}", reply.text());
    }
    // WHEN it is renamed and annotated THEN that is kept
    let change = json!({ "name": "string test 1", "notes": "first of the day" });
    rig.api().command("PATCH", &route(""), &change).unwrap();
    let kept = rig.api().get_json(&route("")).unwrap();
    assert_eq!((kept["name"].as_str(), kept["notes"].as_str()), (Some("string test 1"), Some("first of the day")));
    // WHEN it is deleted THEN it is gone
    let deleted = rig.api().send("DELETE", &route(""), &json!({})).unwrap();
    assert!((200..300).contains(&deleted.status), "{} {}", deleted.status, deleted.text());
    assert_eq!(rig.api().get(&route("/mcap")).unwrap().status, 404);
    let list: Value = rig.api().get_json("/api/v1/flights?limit=1000").unwrap();
    assert_eq!(list["flights"], json!([]));
    rig.stop();
}

#[test]
fn flights_outlive_the_ground() {
    // GIVEN a flight, and both programs stopped
    let rig = Rig::start(&scenario("altitude_step"));
    rig.fly_to(0.5);
    rig.live().step_response(0.5);
    rig.disarm();
    let flight = rig.finished_flight();
    let folder = rig.stop();
    // WHEN they are started again on the same folder
    let system = plumbline_tests::harness::System::start(&options(folder.path()), &scenario("altitude_step")).unwrap();
    // THEN the flight is still there, the same
    let listed = system.api().get_json("/api/v1/flights?limit=1000").unwrap();
    assert_eq!(listed["flights"][0]["id"], flight["id"]);
    assert_eq!(promised_counts(&listed["flights"][0]), promised_counts(&flight));
    system.stop().unwrap();
}
