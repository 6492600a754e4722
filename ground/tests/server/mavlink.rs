//! The vehicles as a MAVLink ground control station meets them.

use std::net::{SocketAddr, UdpSocket};
use std::path::Path;
use std::time::{Duration, Instant};

use crate::common::agent::Agent;
use crate::common::{Ground, PATIENCE};
use mavlink::dialects::common::*;
use mavlink::{MAVLinkV2MessageRaw, MavHeader, MavlinkReader};
use plumbline_ground::agent_link::Outgoing;
use plumbline_ground::people::{Accounts, Role};
use plumbline_ground::{GroundConfig, Mavlink};
use plumbline_link::signing;
use plumbline_proto::v1::command::Body;
use plumbline_proto::{Kind, v1};
use plumbline_support::files;
use tokio::sync::watch;
use tokio::task::JoinHandle;

const PASSWORD: &str = "a long enough password";

async fn ground(folder: &Path, station: SocketAddr, account: Option<&str>) -> Ground {
    let mut config = GroundConfig::new(folder);
    config.reserve_bytes = 1;
    config.mavlink = Some(Mavlink { station, account: account.map(str::to_owned), key: None });
    Ground::start_with(config).await
}

/// Flies, says who it is, accepts every command; what it was asked, and how often somebody was alive, when told to stop.
async fn attended(mut agent: Agent, mut stop: watch::Receiver<bool>) -> (Vec<Body>, usize) {
    let weights = v1::LqrWeights { state_weight: vec![2.5; 16], input_weight: vec![0.5; 4] };
    let gains = v1::GainsInUse { revision: 7, weights: Some(weights), ..Default::default() };
    let (mut asked, mut alive) = (Vec::new(), 0);
    let mut tick = tokio::time::interval(Duration::from_millis(20));
    let mut ticks = 0_u64;
    loop {
        tokio::select! {
            _ = tick.tick() => {
                agent.fly(4).await;
                if ticks.is_multiple_of(10) {
                    let armed = asked.iter().any(|body| matches!(body, Body::Arm(_)));
                    let status = v1::Status {
                        time_us: agent.time_us, mode: v1::Mode::AltitudeHold as i32, armed, battery_v: 15.2,
                        battery_fraction: 0.75, estimator_in_loop: v1::EstimatorKind::EkfBias as i32, challenge: 42,
                        ..Default::default()
                    };
                    agent.say(Kind::Status, 0, &status).await;
                    agent.say(Kind::Gains, 0, &gains).await;
                }
                ticks += 1;
            }
            Some(outgoing) = agent.outgoing.recv() => match outgoing {
                Outgoing::Command(command) => {
                    agent.ack(command.command_id, v1::AckStage::Accepted, "done").await;
                    asked.extend(command.body);
                }
                Outgoing::OperatorAlive(challenge) => {
                    assert_eq!(challenge, 42);
                    alive += 1;
                }
                _ => {}
            },
            _ = stop.changed() => return (asked, alive),
        }
    }
}

/// An attended agent of this ground: what ends it, and what comes of it.
async fn fly(ground: &Ground) -> (watch::Sender<bool>, JoinHandle<(Vec<Body>, usize)>) {
    let agent = ground.agent("iris-1", 1).await;
    let (stop, stopped) = watch::channel(false);
    (stop, tokio::spawn(attended(agent, stopped)))
}

/// GIVEN a vehicle in flight WHEN pymavlink attaches THEN it reads the flight, and what it orders is done.
#[tokio::test(flavor = "multi_thread")]
async fn pymavlink_reads_a_flight_and_commands_it() {
    let Some(python) = files::python_with("pymavlink.mavutil") else { return };
    let port = UdpSocket::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    let folder = tempfile::tempdir().unwrap();
    let ground = ground(folder.path(), SocketAddr::from(([127, 0, 0, 1], port)), None).await;
    let (stop, flying) = fly(&ground).await;
    let read = move || files::mavlink_by(&python, port);
    let found = tokio::task::spawn_blocking(read).await.unwrap().unwrap();
    stop.send_replace(true);
    let (asked, alive) = flying.await.unwrap();
    println!("pymavlink {}", found["version"]);
    let number = |key: &str| found[key].as_f64().unwrap_or_else(|| panic!("{key}: {found}"));
    assert_eq!([number("system"), number("autopilot"), number("type")], [1.0, 0.0, 2.0]);
    let yaw = found["attitude"][2].as_f64().unwrap();
    assert!((yaw - std::f64::consts::FRAC_PI_2).abs() < 1e-3, "east is a quarter turn from north: {yaw}");
    assert_eq!(found["attitude_rising"], true);
    assert!((number("down_m") + 0.9).abs() < 1e-6 && found["north_known"] == false, "{found}");
    assert_eq!(found["battery"], serde_json::json!([15_200, 75]));
    assert_eq!(found["parameters"].as_object().unwrap().len(), 21);
    assert_eq!([&found["parameters"]["GAINS_REVISION"], &found["parameters"]["LQR_STATE_16"]], [7.0, 2.5]);
    assert_eq!(
        [number("after_set"), number("mission"), number("version_asked"), number("unknown")],
        [7.0, 0.0, 0.0, 3.0]
    );
    for order in ["arm", "mode", "land", "disarm", "cut"] {
        assert_eq!(number(order), 0.0, "{order}: {found}");
    }
    assert_eq!((found["armed_shown"].as_bool(), number("mode_shown")), (Some(true), 3.0));
    let texts = found["texts"].to_string();
    assert!(!texts.contains("refused"), "{texts}");
    let altitude = asked.iter().find_map(|body| match body {
        Body::Setpoint(setpoint) => setpoint.altitude_m,
        _ => None,
    });
    assert!((altitude.unwrap() - 1.25).abs() < 1e-6);
    let held = asked.iter().any(|body| matches!(body, Body::SetMode(m) if m.mode == v1::Mode::AltitudeHold as i32));
    assert!(held && asked.iter().any(|body| matches!(body, Body::CutMotors(_))), "{asked:?}");
    assert!(alive >= 1, "a heartbeat of whoever holds control is a sign of life");
    ground.stop().await;
    let audit = std::fs::read_to_string(folder.path().join("audit.jsonl")).unwrap();
    assert!(audit.lines().any(|line| line.contains("MAVLINK") && line.contains("/arm")), "{audit}");
}

/// A sign-in reads the accounts anew, which are otherwise looked at some times a second.
async fn accounts_are_seen(ground: &Ground) {
    let body = serde_json::json!({ "name": "root", "password": PASSWORD }).to_string();
    let signed = ground.request("POST", "/api/v1/session", &body).await;
    assert_eq!(signed.status, 200, "{}", signed.text());
}

/// What another station got of the ground: see `tests/browser/stations.py`.
type Got = Result<serde_json::Value, String>;

/// What `station` got as a viewer, then as an operator, and what the vehicle was asked; `None` where it is not there.
async fn attaches(station: &'static str, module: &str) -> Option<([serde_json::Value; 2], Vec<Body>)> {
    let python = files::python_with(module)?;
    let port = UdpSocket::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    let folder = tempfile::tempdir().unwrap();
    let accounts = Accounts::of(folder.path());
    for (name, role) in [("root", Role::Admin), ("gcs", Role::Viewer)] {
        accounts.add(name, role, PASSWORD).unwrap();
    }
    let ground = ground(folder.path(), SocketAddr::from(([127, 0, 0, 1], port)), Some("gcs")).await;
    let (stop, flying) = fly(&ground).await;
    let attach = || -> Got { tokio::task::block_in_place(|| files::station_by(&python, station, port)) };
    let viewer = attach();
    accounts.change("gcs", Some(Role::Operator), None).unwrap();
    accounts_are_seen(&ground).await;
    let got = [viewer, attach()].map(Result::unwrap);
    stop.send_replace(true);
    let (asked, _) = flying.await.unwrap();
    ground.stop().await;
    println!("{station} {}: {got:?}", got[0]["version"]);
    Some((got, asked))
}

/// It reads where the vehicle is; a viewer is refused, an operator obeyed, and the vehicle hears of nothing else.
fn reads_and_is_refused((got, asked): ([serde_json::Value; 2], Vec<Body>)) {
    for found in &got {
        let number = |key: &str| found[key].as_f64().unwrap_or_else(|| panic!("{key}: {found}"));
        assert!(
            (number("yaw") - std::f64::consts::FRAC_PI_2).abs() < 1e-3,
            "east is a quarter turn from north: {found}"
        );
        assert!((number("down_m") + 0.9).abs() < 1e-6 && (number("battery_v") - 15.2).abs() < 1e-6, "{found}");
    }
    for (found, answer) in got.iter().zip(["DENIED", "ACCEPTED"]) {
        for order in ["arm", "land", "cut"] {
            assert_eq!(found[order], answer, "{order}: {found}");
        }
    }
    let wanted = [
        asked.iter().any(|body| matches!(body, Body::Arm(_))),
        asked.iter().any(|body| matches!(body, Body::SetMode(mode) if mode.mode == v1::Mode::Land as i32)),
        asked.iter().any(|body| matches!(body, Body::CutMotors(_))),
    ];
    assert!(wanted == [true; 3] && asked.len() == 3, "{asked:?}");
}

/// GIVEN a vehicle in flight WHEN MAVProxy attaches THEN it reads it, and may what its account may.
#[tokio::test(flavor = "multi_thread")]
async fn mavproxy_reads_a_flight_and_may_what_its_account_may() {
    if let Some(found) = attaches("mavproxy", "MAVProxy").await {
        reads_and_is_refused(found);
    }
}

/// The same with MAVSDK.
#[tokio::test(flavor = "multi_thread")]
async fn mavsdk_reads_a_flight_and_may_what_its_account_may() {
    if let Some(found) = attaches("mavsdk", "mavsdk").await {
        reads_and_is_refused(found);
    }
}

/// GIVEN a key WHEN a station orders unsigned, with another key, with the key, and with what it sent before THEN one order is
/// done, the others are counted, and the flight can be read by all.
#[tokio::test(flavor = "multi_thread")]
async fn only_what_is_signed_with_the_key_is_an_order() {
    let Some(python) = files::python_with("pymavlink.mavutil") else { return };
    let port = UdpSocket::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    let folder = tempfile::tempdir().unwrap();
    let key = folder.path().join("signing");
    std::fs::write(&key, (0..32).collect::<Vec<u8>>()).unwrap();
    let mut config = GroundConfig::new(folder.path());
    config.reserve_bytes = 1;
    let station = SocketAddr::from(([127, 0, 0, 1], port));
    config.mavlink = Some(Mavlink { station, account: None, key: Some(signing::read_key(&key).unwrap()) });
    let ground = Ground::start_with(config).await;
    let (stop, flying) = fly(&ground).await;
    let attach = move || files::station_by(&python, "pymavlink", port);
    let found = tokio::task::spawn_blocking(attach).await.unwrap().unwrap();
    let metrics = ground.get("/metrics").await.text();
    stop.send_replace(true);
    let (asked, _) = flying.await.unwrap();
    ground.stop().await;
    println!("{found}");
    assert!((found["yaw"].as_f64().unwrap() - std::f64::consts::FRAC_PI_2).abs() < 1e-3, "{found}");
    for refused in ["unsigned", "wrong", "again"] {
        assert!(found[refused][0].is_null(), "{refused}: {found}");
        assert!(found[refused][1].to_string().contains("not signed with the configured key"), "{refused}: {found}");
    }
    assert_eq!(found["right"][0], 0, "{found}");
    assert!(found["verified"].as_u64().unwrap() > 10, "{found}");
    assert!(matches!(asked.as_slice(), [Body::Arm(_)]), "{asked:?}");
    let counted = metrics.lines().find_map(|line| line.strip_prefix("plumbline_mavlink_refused_total "));
    assert!(counted.unwrap().parse::<f64>().unwrap() >= 3.0, "{counted:?}");
}

/// A station by the crate alone.
struct Gcs {
    socket: UdpSocket,
    ground: Option<SocketAddr>,
}

impl Gcs {
    fn new() -> Self {
        let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
        socket.set_read_timeout(Some(Duration::from_millis(100))).unwrap();
        Self { socket, ground: None }
    }

    fn address(&self) -> SocketAddr {
        self.socket.local_addr().unwrap()
    }

    fn wait<T>(&mut self, what: &str, mut wanted: impl FnMut(&MavMessage) -> Option<T>) -> T {
        let begun = Instant::now();
        let mut datagram = [0; 4096];
        loop {
            assert!(begun.elapsed() < PATIENCE, "no {what}");
            let Ok((length, from)) = self.socket.recv_from(&mut datagram) else { continue };
            self.ground = Some(from);
            let mut reader = MavlinkReader::new(&datagram[..length]);
            while let Ok((_, message)) = reader.read_any_message::<MavMessage>() {
                if let Some(found) = wanted(&message) {
                    return found;
                }
            }
        }
    }

    fn send(&self, from: &UdpSocket, command: MavCmd, param1: f32) {
        let default = COMMAND_LONG_DATA::DEFAULT;
        let order = COMMAND_LONG_DATA { target_system: 1, target_component: 1, command, param1, ..default };
        let mut raw = MAVLinkV2MessageRaw::new();
        let header = MavHeader { system_id: 255, component_id: 190, sequence: 0 };
        raw.serialize_message(header, &MavMessage::COMMAND_LONG(order));
        from.send_to(raw.raw_bytes(), self.ground.unwrap()).unwrap();
    }

    fn order(&mut self, command: MavCmd, param1: f32) -> (MavResult, String) {
        self.send(&self.socket, command, param1);
        let result = self.wait("acknowledgement", |message| match message {
            MavMessage::COMMAND_ACK(ack) if ack.command == command => Some(ack.result),
            _ => None,
        });
        if result == MavResult::MAV_RESULT_ACCEPTED {
            return (result, String::new());
        }
        let text = self.wait("reason", |message| match message {
            MavMessage::STATUSTEXT(text) => text.text.to_str().ok().map(str::to_owned),
            _ => None,
        });
        (result, text)
    }
}

/// GIVEN accounts WHEN a station orders THEN role and lease decide, and only the station configured is heard.
#[tokio::test(flavor = "multi_thread")]
async fn a_station_may_what_its_account_may() {
    const ARM: MavCmd = MavCmd::MAV_CMD_COMPONENT_ARM_DISARM;
    const CUT: MavCmd = MavCmd::MAV_CMD_DO_FLIGHTTERMINATION;
    let folder = tempfile::tempdir().unwrap();
    let accounts = Accounts::of(folder.path());
    for (name, role) in [("root", Role::Admin), ("gcs", Role::Viewer)] {
        accounts.add(name, role, PASSWORD).unwrap();
    }
    let mut gcs = Gcs::new();
    let ground = ground(folder.path(), gcs.address(), Some("gcs")).await;
    let (stop, flying) = fly(&ground).await;
    let seen = || tokio::runtime::Handle::current().block_on(accounts_are_seen(&ground));
    let results = tokio::task::block_in_place(|| {
        gcs.wait("heartbeat", |message| matches!(message, MavMessage::HEARTBEAT(_)).then_some(()));
        let mut results = vec![gcs.order(ARM, 1.0), gcs.order(CUT, 1.0)];
        accounts.change("gcs", Some(Role::Operator), None).unwrap();
        seen();
        results.push(gcs.order(ARM, 1.0));
        // A stranger on the same machine is not heard: only the order after it is answered.
        gcs.send(&UdpSocket::bind("127.0.0.1:0").unwrap(), ARM, 0.0);
        results.push(gcs.order(CUT, 1.0));
        accounts.remove("gcs").unwrap();
        seen();
        results.push(gcs.order(ARM, 1.0));
        results
    });
    stop.send_replace(true);
    let (asked, _) = flying.await.unwrap();
    let [viewer_arms, viewer_cuts, operator_arms, operator_cuts, nobody_arms] = results.as_slice() else {
        panic!("{results:?}")
    };
    for refused in [viewer_arms, viewer_cuts, nobody_arms] {
        assert_eq!(refused.0, MavResult::MAV_RESULT_DENIED, "{results:?}");
        assert!(refused.1.starts_with("a viewer may not do this"), "{results:?}");
    }
    assert_eq!([operator_arms.0, operator_cuts.0], [MavResult::MAV_RESULT_ACCEPTED; 2], "{results:?}");
    assert!(matches!(asked.as_slice(), [Body::Arm(_), Body::CutMotors(_)]), "{asked:?}");
    ground.stop().await;
    let audit = std::fs::read_to_string(folder.path().join("audit.jsonl")).unwrap();
    let lines = |status: &str| audit.lines().filter(|l| l.contains("MAVLINK") && l.contains(status)).count();
    assert!(lines("\"status\":403") >= 1 && lines("\"status\":200") == 2, "{audit}");
}

/// GIVEN somebody else in control WHEN a station arms THEN it is refused by the lease, and may still cut.
#[tokio::test(flavor = "multi_thread")]
async fn control_held_by_another_is_not_taken() {
    let folder = tempfile::tempdir().unwrap();
    let mut gcs = Gcs::new();
    let ground = ground(folder.path(), gcs.address(), None).await;
    let (stop, flying) = fly(&ground).await;
    ground.wait_json("/api/v1/vehicles", |v| v[0]["connected"] == true).await;
    let taken =
        ground.request_as("PUT", "/api/v1/vehicles/iris-1/lease", "{}", &[("x-plumbline-operator", "ann")]).await;
    assert_eq!(taken.status, 200, "{}", taken.text());
    let orders = tokio::task::spawn_blocking(move || {
        gcs.wait("heartbeat", |message| matches!(message, MavMessage::HEARTBEAT(_)).then_some(()));
        [(MavCmd::MAV_CMD_COMPONENT_ARM_DISARM, 1.0), (MavCmd::MAV_CMD_DO_FLIGHTTERMINATION, 1.0)]
            .map(|(command, param1)| gcs.order(command, param1))
    });
    let [arm, cut] = orders.await.unwrap();
    stop.send_replace(true);
    let (asked, _) = flying.await.unwrap();
    assert_eq!((arm.0, arm.1.contains("holds control")), (MavResult::MAV_RESULT_DENIED, true), "{}", arm.1);
    assert_eq!(cut.0, MavResult::MAV_RESULT_ACCEPTED);
    assert!(matches!(asked.as_slice(), [Body::CutMotors(_)]), "{asked:?}");
    ground.stop().await;
}

/// GIVEN a station WHEN it sends noise, half a message, a wrong checksum and an old protocol's frame THEN none of it is an order,
/// and the next whole one is done.
#[tokio::test(flavor = "multi_thread")]
async fn what_is_no_message_is_no_order() {
    const CUT: MavCmd = MavCmd::MAV_CMD_DO_FLIGHTTERMINATION;
    let folder = tempfile::tempdir().unwrap();
    let mut gcs = Gcs::new();
    let ground = ground(folder.path(), gcs.address(), None).await;
    let (stop, flying) = fly(&ground).await;
    let disarmed = tokio::task::spawn_blocking(move || {
        gcs.wait("heartbeat", |message| matches!(message, MavMessage::HEARTBEAT(_)).then_some(()));
        let cut = COMMAND_LONG_DATA {
            target_system: 1,
            target_component: 1,
            command: CUT,
            param1: 1.0,
            ..COMMAND_LONG_DATA::DEFAULT
        };
        let mut raw = MAVLinkV2MessageRaw::new();
        raw.serialize_message(
            MavHeader { system_id: 255, component_id: 190, sequence: 0 },
            &MavMessage::COMMAND_LONG(cut),
        );
        let whole = raw.raw_bytes().to_vec();
        let mut damaged = whole.clone();
        *damaged.last_mut().unwrap() ^= 0x55;
        let mut version_one = whole.clone();
        version_one[0] = 0xfe;
        let half = whole[..whole.len() / 2].to_vec();
        for wrong in [vec![], vec![0; 4000], half, damaged, version_one, b"GET / HTTP/1.1\r\n\r\n".to_vec()] {
            gcs.socket.send_to(&wrong, gcs.ground.unwrap()).unwrap();
        }
        gcs.order(MavCmd::MAV_CMD_COMPONENT_ARM_DISARM, 0.0)
    });
    let disarmed = disarmed.await.unwrap();
    stop.send_replace(true);
    let (asked, _) = flying.await.unwrap();
    assert_eq!(disarmed.0, MavResult::MAV_RESULT_ACCEPTED, "{}", disarmed.1);
    assert!(matches!(asked.as_slice(), [Body::Disarm(_)]), "{asked:?}");
    ground.stop().await;
}
