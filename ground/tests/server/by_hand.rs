//! Experiments that an operator flies: what is next, what is said of a flight, and what an accepted one is worth.

use serde_json::{Value, json};

use crate::common::Ground;

const FLOWN: &str = r#"
name = "flown"
repeats = 2
[scenario]
duration_s = 16
rig = { hanging_strings = { mode = "flight", height_m = 0.3 } }
script = [
  { at_s = 3, do = "arm" }, { at_s = 4, do = "mode", mode = "altitude_hold" },
  { at_s = 5, do = "setpoint", altitude_m = 0.9 },
]
[agent]
estimators = { in_loop = "lanes" }
[attack]
sensor = "height"
kind = "bias"
magnitude = 0.2
start_s = 10.0
"#;

fn plan(vehicles: &[String]) -> String {
    format!(
        "name = \"by_hand\"\nseed = 4\n[by_hand]\nvehicle = \"\"\naltitude_m = [0.5, 0.9]\nhold_s = 8\nrest_s = 3600\n[agent]\n\
         estimators = {{ in_loop = \"lanes\" }}\n[attack]\nsensor = \"height\"\nkind = \"bias\"\nmagnitude = 0.2\nstart_s = 6\n\
         [[factor]]\nkey = \"by_hand.vehicle\"\nvalues = {vehicles:?}\n"
    )
}

async fn asked(ground: &Ground, plan: &str) -> Value {
    let made = ground.request("POST", "/api/v1/experiments", &json!({ "plan": plan }).to_string()).await;
    assert_eq!(made.status, 201, "{}", made.text());
    made.json()
}

/// Two recordings, each of a vehicle of its own: their ids, and the vehicles.
async fn recorded(ground: &Ground) -> [(String, String); 2] {
    ground.wait_json("/api/v1/flights", |flights| flights["ready"] == true).await;
    let id = asked(ground, FLOWN).await["id"].as_str().unwrap().to_owned();
    let mut recorded = [const { (String::new(), String::new()) }; 2];
    loop {
        let state = ground.json(&format!("/api/v1/experiments/{id}")).await["state"].clone();
        if state["running"] == false {
            assert_eq!(state["done"], 2, "{state}");
            break;
        }
        tokio::time::sleep(std::time::Duration::from_millis(100)).await;
    }
    for (index, (flight, vehicle)) in recorded.iter_mut().enumerate() {
        let opened = ground.request("POST", &format!("/api/v1/experiments/{id}/flights/{index}"), "").await.json();
        opened["flight"].as_str().unwrap().clone_into(flight);
        let known = ground.json(&format!("/api/v1/flights/{flight}")).await;
        known["vehicle_id"].as_str().unwrap().clone_into(vehicle);
    }
    recorded
}

#[tokio::test(flavor = "multi_thread")]
async fn flights_by_hand_are_led_through_in_a_drawn_order_and_count_when_accepted() {
    let folder = tempfile::tempdir().unwrap();
    let ground = Ground::start(folder.path()).await;
    let flights = recorded(&ground).await;
    let vehicles: Vec<_> = flights.iter().map(|(_, vehicle)| vehicle.clone()).collect();
    // GIVEN a plan that is flown by hand WHEN it is kept THEN nothing flies
    let size =
        ground.request("POST", "/api/v1/experiments/size", &json!({ "plan": plan(&vehicles) }).to_string()).await;
    assert_eq!((&size.json()["by_hand"], size.json()["expected_s"].as_f64()), (&json!(true), Some(2.0 * 3616.0)));
    let state = asked(&ground, &plan(&vehicles)).await;
    assert_eq!((&state["by_hand"], &state["running"], &state["flights"]), (&json!(true), &json!(false), &json!(2)));
    let at = format!("/api/v1/experiments/{}", state["id"].as_str().unwrap());
    let started = ground.request("POST", &format!("{at}/start"), "").await;
    assert_eq!((started.status, started.error().contains("is flown by hand")), (409, true), "{}", started.text());

    // THEN the next one is told: on which vehicle, with what, and what is lacking
    let by_hand = format!("{at}/by-hand");
    let next = ground.json(&by_hand).await["next"].clone();
    let index = next["index"].as_u64().unwrap() as usize;
    assert_eq!(
        (&next["place"], &next["vehicle"], &next["estimator"]),
        (&json!(1), &json!(vehicles[index]), &json!("lanes"))
    );
    assert_eq!((&next["rest_left_s"], &next["lasts_s"], &next["gains"]), (&json!(0.0), &json!(16.0), &json!(null)));
    assert_eq!(next["path"], json!({ "shape": "altitudes", "altitude_m": [0.5, 0.9], "hold_s": 8.0 }));
    assert!(next["lacks"].as_str().unwrap().contains("was not seen yet"), "{next}");
    let agent = {
        let mut agent = ground.agent(&vehicles[index], 1).await;
        agent.describe().await;
        agent
    };
    let next = ground.wait_json(&by_hand, |told| told["next"]["lacks"] == "").await["next"].clone();
    let attack = &next["attacks"][0];
    assert_eq!(
        (&attack["sensor"], &attack["kind"], &attack["start_s"]),
        (&json!("height"), &json!("bias"), &json!(6.0))
    );
    assert_eq!(attack["magnitude"].as_f64().unwrap().abs(), 0.2, "its sign is drawn");

    // WHEN something is said of a flight THEN it is kept with who said it, and only an accepted one counts
    let say = async |index: usize, flight: &str, accepted: bool, reason: &str| {
        let said = json!({ "index": index, "flight": flight, "accepted": accepted, "reason": reason });
        let who = [("x-plumbline-operator", "ada")];
        ground.request_as("POST", &by_hand, &said.to_string(), &who).await
    };
    let [own, other] = [&flights[index].0, &flights[1 - index].0];
    assert_eq!(say(index, own, false, " ").await.error(), "say why the flight is void");
    let void = say(index, own, false, "a string slipped").await.json();
    assert_eq!((&void["said"][0]["reason"], &void["said"][0]["who"]), (&json!("a string slipped"), &json!("ada")));
    assert_eq!(void["next"]["index"], index, "it is flown again");
    assert!(void["next"]["rest_left_s"].as_f64().unwrap() > 0.0, "{void}");
    let foreign = say(index, other, true, "").await;
    assert_eq!((foreign.status, foreign.error().contains("the plan is of")), (422, true), "{}", foreign.text());
    assert_eq!(say(index, "none", true, "").await.status, 404);
    assert_eq!(say(7, own, true, "").await.status, 404);
    let accepted = say(index, own, true, "").await;
    assert_eq!((accepted.status, &accepted.json()["next"]["place"]), (200, &json!(2)), "{}", accepted.text());
    let taken = say(index, own, true, "").await;
    assert_eq!((taken.status, taken.error().contains("void that first")), (409, true), "{}", taken.text());

    // THEN it is measured as any recording is, and its dot is the flight itself
    let results = ground.json(&at).await;
    assert_eq!(
        (&results["state"]["done"], results["conditions"].as_array().unwrap().len()),
        (&json!(1), 1),
        "{results}"
    );
    let altitude = &results["conditions"][0]["measures"][0];
    assert_eq!(altitude["count"], 1);
    assert!((0.0005..0.1).contains(&altitude["median"].as_f64().unwrap()), "{altitude}");
    let dot = ground.request("POST", &format!("{at}/flights/{index}"), "").await;
    assert_eq!(dot.json(), json!({ "flight": own }));
    let noted = ground.json(&format!("/api/v1/flights/{own}")).await["notes"].as_str().unwrap().to_owned();
    assert!(
        noted.ends_with(&format!("flight {index}: accepted")) && noted.contains("void, a string slipped"),
        "{noted}"
    );
    assert!(ground.get(&format!("{at}/report.html")).await.text().contains("1 of 2 flights"));

    // WHEN it is void after all THEN it counts no more; accepted again it does
    assert_eq!(say(index, own, false, "wrong propeller").await.json()["next"]["index"], index);
    assert_eq!(ground.json(&at).await["state"]["done"], 0);
    assert_eq!(ground.json(&at).await["conditions"], json!([]));
    assert_eq!(say(index, own, true, "").await.status, 200);
    let last = say(1 - index, other, true, "").await;
    assert_eq!((last.status, &last.json()["next"]), (200, &json!(null)), "{}", last.text());
    assert_eq!(ground.json(&at).await["state"]["done"], 2);
    drop(agent);
    ground.stop().await;

    // THEN another day finds it as it was, with a line torn by a kill passed over
    let journal = folder.path().join(format!("experiments/{}/by_hand.jsonl", state["id"].as_str().unwrap()));
    let torn = std::fs::read_to_string(&journal).unwrap() + "{\"index\":0,\"fli";
    std::fs::write(&journal, torn).unwrap();
    let ground = Ground::start(folder.path()).await;
    assert_eq!(ground.json(&by_hand).await["said"].as_array().unwrap().len(), 5);
    assert_eq!(ground.json(&at).await["state"]["done"], 2);
    let late = json!({ "index": 0, "flight": flights[0].0, "accepted": false, "reason": "late" }).to_string();
    let void = ground.request("POST", &by_hand, &late).await;
    assert_eq!(void.json()["said"].as_array().unwrap().len(), 6, "a new line begins behind the torn one");
    ground.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_simulated_experiment_has_nothing_by_hand() {
    let folder = tempfile::tempdir().unwrap();
    let ground = Ground::start(folder.path()).await;
    let id = asked(&ground, FLOWN).await["id"].as_str().unwrap().to_owned();
    let at = format!("/api/v1/experiments/{id}");
    let asked = ground.get(&format!("{at}/by-hand")).await;
    assert_eq!((asked.status, asked.error().contains("is not flown by hand")), (404, true), "{}", asked.text());
    let said = json!({ "index": 0, "flight": "f", "accepted": false, "reason": "no" }).to_string();
    assert_eq!(ground.request("POST", &format!("{at}/by-hand"), &said).await.status, 404);
    ground.stop().await;
}
