//! The Foxglove WebSocket protocol, as a client meets it.

use crate::common::{Ground, PATIENCE};
use futures_util::{SinkExt as _, StreamExt as _};
use plumbline_ground::people::{Accounts, Role};
use plumbline_proto::v1::command::Body;
use plumbline_proto::{Kind, Message as _, v1};
use serde_json::{Value, json};
use tokio::net::TcpStream;
use tokio_tungstenite::tungstenite::client::IntoClientRequest as _;
use tokio_tungstenite::tungstenite::{Error, Message};
use tokio_tungstenite::{MaybeTlsStream, WebSocketStream, connect_async};

type Socket = WebSocketStream<MaybeTlsStream<TcpStream>>;

async fn connect(ground: &Ground, vehicle: &str, protocols: Option<&str>) -> Result<(Socket, String), u16> {
    connect_with(ground, &format!("{vehicle}/foxglove"), protocols, &[]).await
}

async fn connect_with(
    ground: &Ground,
    path: &str,
    protocols: Option<&str>,
    headers: &[(&'static str, String)],
) -> Result<(Socket, String), u16> {
    let url = format!("ws://{}/api/v1/vehicles/{path}", ground.address);
    let mut request = url.into_client_request().unwrap();
    for (name, value) in headers {
        request.headers_mut().insert(*name, value.parse().unwrap());
    }
    if let Some(protocols) = protocols {
        request.headers_mut().insert("sec-websocket-protocol", protocols.parse().unwrap());
    }
    match connect_async(request).await {
        Ok((socket, answer)) => Ok((socket, answer.headers()["sec-websocket-protocol"].to_str().unwrap().to_owned())),
        Err(Error::Http(answer)) => Err(answer.status().as_u16()),
        Err(other) => panic!("{other}"),
    }
}

/// What comes next: text as JSON, or a message of a subscription with its time and payload.
async fn next(socket: &mut Socket) -> Result<Value, (u32, u64, Vec<u8>)> {
    loop {
        let message = tokio::time::timeout(PATIENCE, socket.next()).await.expect("in time").expect("open").unwrap();
        match message {
            Message::Text(text) => return Ok(serde_json::from_str(&text).unwrap()),
            Message::Binary(data) => {
                assert_eq!(data[0], 1, "message data");
                let number = u32::from_le_bytes(data[1..5].try_into().unwrap());
                return Err((number, u64::from_le_bytes(data[5..13].try_into().unwrap()), data[13..].to_vec()));
            }
            _ => {}
        }
    }
}

async fn ask(socket: &mut Socket, text: &str) {
    socket.send(Message::text(text)).await.unwrap();
}

async fn status(socket: &mut Socket) -> String {
    loop {
        if let Ok(told) = next(socket).await
            && told["op"] == "status"
        {
            return told["message"].as_str().unwrap().to_owned();
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_client_is_offered_every_topic_and_sent_what_it_subscribes_to() {
    let folder = tempfile::tempdir().unwrap();
    let ground = Ground::start(folder.path()).await;
    let mut agent = ground.agent("iris-1", 1).await;
    agent.describe().await;
    ground.wait_json("/api/v1/vehicles", |v| v[0]["rig"] == "strings").await;
    let (mut socket, spoken) = connect(&ground, "iris-1", Some("foxglove.websocket.v1")).await.unwrap();
    assert_eq!(spoken, "foxglove.websocket.v1");
    let first = next(&mut socket).await.unwrap();
    let capabilities = json!(["parameters", "services"]);
    assert_eq!((first["op"].as_str(), &first["capabilities"]), (Some("serverInfo"), &capabilities));
    assert_eq!(next(&mut socket).await.unwrap()["op"], "advertiseServices");
    let mut channels = std::collections::BTreeMap::new();
    agent.fly(2).await;
    while !["/description", "/estimate/1", "/sensor/height/2", "/control", "/tf", "/scene"]
        .iter()
        .all(|topic| channels.contains_key(*topic))
    {
        let told = next(&mut socket).await.unwrap();
        assert_eq!(told["op"], "advertise", "nothing is sent before it is asked for");
        for channel in told["channels"].as_array().unwrap() {
            channels.insert(channel["topic"].as_str().unwrap().to_owned(), channel.clone());
        }
    }
    let height = &channels["/sensor/height/2"];
    assert_eq!(
        ["encoding", "schemaName", "schemaEncoding"].map(|key| height[key].as_str().unwrap()),
        ["protobuf", "plumbline.v1.HeightSample", "protobuf"]
    );
    assert_eq!(channels["/tf"]["schemaName"], "foxglove.FrameTransform");
    // WHEN heights, the description and the transform are asked for THEN they come, the same bytes, and nothing else does
    let asked: Vec<_> = ["/sensor/height/2", "/description", "/tf"]
        .iter()
        .enumerate()
        .map(|(n, topic)| json!({ "id": n, "channelId": channels[*topic]["id"] }))
        .collect();
    ask(&mut socket, &json!({ "op": "subscribe", "subscriptions": asked }).to_string()).await;
    let described = next(&mut socket).await.unwrap_err();
    assert_eq!(described.0, 1, "what is rare is sent at once");
    assert_eq!(v1::Description::decode(described.2.as_slice()).unwrap().rig, "strings");
    agent.fly(5).await;
    let (mut heights, mut transforms) = (Vec::new(), 0);
    while heights.len() < 5 || transforms < 5 {
        match next(&mut socket).await {
            Err((0, time_ns, payload)) => {
                heights.push((time_ns, v1::HeightSample::decode(payload.as_slice()).unwrap()))
            }
            Err((2, _, payload)) => {
                let transform: Value = serde_json::from_slice(&payload).unwrap();
                assert_eq!(
                    (transform["child_frame_id"].as_str(), transform["translation"]["z"].as_f64()),
                    (Some("base_link"), Some(0.9))
                );
                transforms += 1;
            }
            other => panic!("{other:?}"),
        }
    }
    assert_eq!(
        (heights[0].0 / 1000, heights[0].1.sensed_m),
        (crate::common::agent::BOOT_WALL_US + heights[0].1.time_us, 0.81)
    );
    // WHEN it goes on with the heights alone THEN transforms end, and an event is not lost among them
    ask(&mut socket, r#"{"op":"unsubscribe","subscriptionIds":[2]}"#).await;
    ask(&mut socket, r#"{"op":"unsubscribe","subscriptionIds":[77]}"#).await;
    assert!(status(&mut socket).await.contains("77"));
    agent.fly(3).await;
    agent.say(Kind::Event, 0, &v1::Event { kind: "mode".into(), text: "hold".into(), ..Default::default() }).await;
    let mut seen = 0;
    loop {
        match next(&mut socket).await {
            Err((0, ..)) => seen += 1,
            Ok(told) if told["channels"][0]["topic"] == "/event" => break,
            Ok(told) if told["op"] == "advertise" => {}
            other => panic!("{other:?}"),
        }
    }
    assert!(seen <= 3, "{seen} heights");
    ground.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_is_wrong_is_answered_and_nothing_breaks() {
    let folder = tempfile::tempdir().unwrap();
    let ground = Ground::start(folder.path()).await;
    let mut agent = ground.agent("iris-1", 1).await;
    agent.describe().await;
    ground.wait_json("/api/v1/vehicles", |v| v[0]["rig"] == "strings").await;
    assert_eq!(connect(&ground, "iris-1", None).await.unwrap_err(), 426);
    assert_eq!(connect(&ground, "iris-1", Some("foxglove.websocket.v0")).await.unwrap_err(), 426);
    assert_eq!(connect(&ground, "nobody", Some("foxglove.sdk.v1")).await.unwrap_err(), 404);
    let (mut socket, spoken) =
        connect(&ground, "iris-1", Some("foxglove.websocket.v1, foxglove.sdk.v1")).await.unwrap();
    assert_eq!(spoken, "foxglove.sdk.v1");
    for (text, named) in [
        ("{", "cannot be read"),
        ("[]", "cannot be read"),
        (r#"{"op":"subscribe"}"#, "cannot be read"),
        (r#"{"op":"subscribe","subscriptions":[{"id":-1,"channelId":1}]}"#, "cannot be read"),
        (r#"{"op":"subscribe","subscriptions":[{"id":1,"channelId":12345}]}"#, "no channel 12345"),
        (r#"{"op":"setParameters","parameters":[{"name":"gain","value":1}]}"#, "read only"),
        (r#"{"op":"advertise","channels":[]}"#, "not done here"),
        (r#"{"op":"getParameters","parameterNames":7}"#, "cannot be read"),
    ] {
        ask(&mut socket, text).await;
        let told = status(&mut socket).await;
        assert!(told.contains(named), "{text}: {told}");
    }
    for (bytes, named) in [
        (vec![1, 2, 3], "no messages of clients"),
        (vec![77], "opcode 77"),
        (vec![], "empty"),
        (vec![2, 1, 0, 0, 0, 1, 0], "cut short"),
    ] {
        socket.send(Message::binary(bytes)).await.unwrap();
        assert!(status(&mut socket).await.contains(named), "{named}");
    }
    ask(&mut socket, &" ".repeat(100_000)).await;
    let ended = async { while matches!(socket.next().await, Some(Ok(message)) if !message.is_close()) {} };
    tokio::time::timeout(PATIENCE, ended).await.expect("too large a request ends the socket");
    assert_eq!(ground.get("/healthz").await.status, 200);
    ground.stop().await;
}

/// A call as the protocol writes it.
fn call(service: u32, id: u32, encoding: &str, payload: &str) -> Message {
    let mut bytes = vec![2];
    for number in [service, id, encoding.len() as u32] {
        bytes.extend_from_slice(&number.to_le_bytes());
    }
    bytes.extend_from_slice(encoding.as_bytes());
    bytes.extend_from_slice(payload.as_bytes());
    Message::binary(bytes)
}

/// The answer to call `id`: what was done, or why it was not.
async fn answer(socket: &mut Socket, id: u32) -> Result<Value, String> {
    loop {
        let message = tokio::time::timeout(PATIENCE, socket.next()).await.expect("in time").expect("open").unwrap();
        match message {
            Message::Binary(data) if data[0] == 3 => {
                assert_eq!((&data[5..9], &data[9..17]), (&id.to_le_bytes()[..], &b"\x04\0\0\0json"[..]));
                return Ok(serde_json::from_slice(&data[17..]).unwrap());
            }
            Message::Text(text) => {
                let told: Value = serde_json::from_str(&text).unwrap();
                if told["op"] == "serviceCallFailure" {
                    assert_eq!(told["callId"], id);
                    return Err(told["message"].as_str().unwrap().to_owned());
                }
            }
            _ => {}
        }
    }
}

/// GIVEN ann in control WHEN services are called THEN she is served, another is told who holds control, and both may cut.
#[tokio::test(flavor = "multi_thread")]
async fn services_are_commands_under_the_lease() {
    let folder = tempfile::tempdir().unwrap();
    let ground = Ground::start(folder.path()).await;
    let mut agent = ground.agent("iris-1", 1).await;
    agent.describe().await;
    let gains = v1::GainsInUse { revision: 7, controller: "lqr_integral".into(), ..Default::default() };
    agent.say(Kind::Gains, 0, &gains).await;
    ground.wait_json("/api/v1/vehicles", |v| v[0]["rig"] == "strings").await;
    let join = |name: &'static str| {
        let path = format!("iris-1/foxglove?operator={name}");
        let ground = &ground;
        async move { connect_with(ground, &path, Some("foxglove.sdk.v1"), &[]).await.unwrap().0 }
    };
    let (mut ann, mut bob) = (join("ann").await, join("bob").await);
    // Parameters: what is asked for, and nothing is set.
    ask(&mut ann, r#"{"op":"getParameters","parameterNames":["gains.revision","nothing"],"id":"a"}"#).await;
    let read = loop {
        let told = next(&mut ann).await.unwrap();
        if told["op"] == "parameterValues" {
            break told;
        }
    };
    let revision = json!([{ "name": "gains.revision", "value": 7, "type": "float64" }]);
    assert_eq!((&read["id"], &read["parameters"]), (&json!("a"), &revision));
    ask(&mut ann, r#"{"op":"setParameters","parameters":[{"name":"gains.revision","value":8}],"id":"b"}"#).await;
    assert!(status(&mut ann).await.contains("read only"));
    let kept = next(&mut ann).await.unwrap();
    assert_eq!((&kept["id"], &kept["parameters"]), (&json!("b"), &revision), "as it was");
    // What is wrong is answered call by call, before anything is sent to the vehicle.
    for (number, (message, named)) in [
        (call(9, 0, "json", "{}"), "no service 9"),
        (call(1, 1, "ros1", "{}"), "json is"),
        (call(1, 2, "json", "{\"mode\""), "EOF"),
        (call(1, 3, "json", "{\"mode\":\"fly\"}"), "not known"),
        (call(1, 4, "json", "{\"mode\":\"cut\"}"), "cannot be asked for"),
        (call(2, 5, "json", "{}"), "no field"),
        (call(2, 6, "json", "{\"altitude_m\":1e999}"), "out of range"),
        (call(2, 7, "json", "{\"altitude\":1}"), "unknown field"),
    ]
    .into_iter()
    .enumerate()
    {
        ann.send(message).await.unwrap();
        let why = answer(&mut ann, number as u32).await.unwrap_err();
        assert!(why.contains(named), "{named}: {why}");
    }
    // WHEN ann calls THEN she takes control as by the first command of any client, and the vehicle answers her
    ann.send(call(1, 20, "json", r#"{"mode":"hold"}"#)).await.unwrap();
    let asked = agent.accept().await;
    assert!(matches!(asked.body, Some(Body::SetMode(m)) if m.mode == v1::Mode::Hold as i32), "{asked:?}");
    let done = answer(&mut ann, 20).await.unwrap();
    assert_eq!((&done["stage"], &done["reason"]), (&json!("accepted"), &json!("done")));
    ann.send(call(2, 21, "json", r#"{"altitude_m":0.8}"#)).await.unwrap();
    let asked = agent.command().await;
    agent.ack(asked.command_id, v1::AckStage::Rejected, "altitude 0.8 m: disarmed").await;
    assert_eq!(answer(&mut ann, 21).await.unwrap_err(), "altitude 0.8 m: disarmed");
    // WHEN bob calls THEN he is refused by the lease, and may cut, even by a call that is otherwise nonsense
    bob.send(call(2, 22, "json", r#"{"altitude_m":0.5}"#)).await.unwrap();
    let why = answer(&mut bob, 22).await.unwrap_err();
    assert!(why.contains("ann") && why.contains("holds control"), "{why}");
    bob.send(call(3, 23, "cbor", "!")).await.unwrap();
    let asked = agent.accept().await;
    assert!(matches!(asked.body, Some(Body::CutMotors(_))), "{asked:?}");
    assert_eq!(answer(&mut bob, 23).await.unwrap()["stage"], "accepted");
    let odd = connect_with(&ground, "iris-1/foxglove?operator=", Some("foxglove.sdk.v1"), &[]).await;
    assert_eq!(odd.map(drop).unwrap_err(), 422);
    ground.stop().await;
    let audit = std::fs::read_to_string(folder.path().join("audit.jsonl")).unwrap();
    let lines: Vec<_> = audit.lines().filter(|line| line.contains("FOXGLOVE")).collect();
    assert!(lines.iter().any(|line| line.contains("/cut") && line.contains("bob")), "{audit}");
    assert!(lines.iter().any(|line| line.contains("423") && line.contains("altitude_m")), "{audit}");
}

/// GIVEN a signed-in viewer WHEN services are called THEN they are refused by the role, which counts as it is now.
#[tokio::test(flavor = "multi_thread")]
async fn a_viewer_is_refused_the_services() {
    const PASSWORD: &str = "a long enough password";
    let folder = tempfile::tempdir().unwrap();
    let accounts = Accounts::of(folder.path());
    for (name, role) in [("root", Role::Admin), ("vic", Role::Viewer)] {
        accounts.add(name, role, PASSWORD).unwrap();
    }
    let ground = Ground::start(folder.path()).await;
    let mut agent = ground.agent("iris-1", 1).await;
    agent.describe().await;
    let body = json!({ "name": "vic", "password": PASSWORD }).to_string();
    let signed = ground.request("POST", "/api/v1/session", &body).await;
    let cookie = signed.header("set-cookie").unwrap().split(';').next().unwrap().to_owned();
    let path = "iris-1/foxglove?operator=root";
    assert_eq!(connect_with(&ground, path, Some("foxglove.sdk.v1"), &[]).await.map(drop).unwrap_err(), 401);
    let own = [("cookie", cookie), ("origin", format!("http://{}", ground.address))];
    let (mut socket, _) = connect_with(&ground, path, Some("foxglove.sdk.v1"), &own).await.unwrap();
    for (number, message) in
        [call(1, 0, "json", r#"{"mode":"hold"}"#), call(2, 1, "json", r#"{"altitude_m":1}"#), call(3, 2, "json", "{}")]
            .into_iter()
            .enumerate()
    {
        socket.send(message).await.unwrap();
        let why = answer(&mut socket, number as u32).await.unwrap_err();
        assert_eq!(why, "a viewer may not do this; it needs the role operator");
    }
    accounts.change("vic", Some(Role::Operator), None).unwrap();
    // Whoever signs in has the accounts read anew, which are otherwise looked at some times a second.
    assert_eq!(ground.request("POST", "/api/v1/session", &body).await.status, 200);
    socket.send(call(3, 3, "json", "{}")).await.unwrap();
    let asked = agent.accept().await;
    assert!(matches!(asked.body, Some(Body::CutMotors(_))), "{asked:?}");
    assert_eq!(answer(&mut socket, 3).await.unwrap()["stage"], "accepted");
    ground.stop().await;
    let audit = std::fs::read_to_string(folder.path().join("audit.jsonl")).unwrap();
    let by = |status: &str| {
        audit.lines().filter(|l| l.contains("FOXGLOVE") && l.contains("vic") && l.contains(status)).count()
    };
    assert!(by("\"status\":403") >= 1 && by("\"status\":200") == 1, "{audit}");
    assert!(!audit.contains("\"who\":\"root\""), "the account counts, not what the address says: {audit}");
}

/// GIVEN people who sign in WHEN a program without a session opens the address that one of them asked for THEN it has their role, once
/// and while their session lasts.
#[tokio::test(flavor = "multi_thread")]
async fn a_ticket_opens_the_link_once_with_the_role_of_who_asked() {
    const PASSWORD: &str = "a long enough password";
    let folder = tempfile::tempdir().unwrap();
    let accounts = Accounts::of(folder.path());
    for (name, role) in [("root", Role::Admin), ("vic", Role::Viewer), ("ola", Role::Operator)] {
        accounts.add(name, role, PASSWORD).unwrap();
    }
    let ground = Ground::start(folder.path()).await;
    let mut agent = ground.agent("iris-1", 1).await;
    agent.describe().await;
    let other = ground.agent("iris-2", 2).await;
    let sign_in = async |name: &str| {
        let body = json!({ "name": name, "password": PASSWORD }).to_string();
        let signed = ground.request("POST", "/api/v1/session", &body).await;
        signed.header("set-cookie").unwrap().split(';').next().unwrap().to_owned()
    };
    let origin = format!("http://{}", ground.address);
    let ask = async |cookie: &str| {
        let headers = [("cookie", cookie), ("origin", origin.as_str()), ("x-plumbline-operator", "me")];
        let answer = ground.request_as("POST", "/api/v1/vehicles/iris-1/foxglove", "", &headers).await;
        assert_eq!(answer.status, 200, "{}", answer.text());
        let told: Value = serde_json::from_slice(&answer.body).unwrap();
        assert_eq!(told["valid_s"], 300);
        let url = told["url"].as_str().unwrap().to_owned();
        let token = cookie.split('=').nth(1).unwrap();
        assert!(!url.contains(token), "the token of the session is in no address");
        url.strip_prefix(&format!("ws://{}/api/v1/vehicles/", ground.address)).unwrap().to_owned()
    };
    let open =
        async |path: &str| connect_with(&ground, path, Some("foxglove.sdk.v1"), &[]).await.map(|(socket, _)| socket);

    // WHEN nobody is signed in THEN there is no address, and none of what is not a ticket opens the link.
    let told = ground.request("POST", "/api/v1/vehicles/iris-1/foxglove", "").await;
    assert_eq!(told.status, 401, "{}", told.text());
    for garbage in ["", "x", &"0".repeat(64)] {
        assert_eq!(open(&format!("iris-1/foxglove?ticket={garbage}")).await.map(drop).unwrap_err(), 401, "{garbage}");
    }

    let vic = sign_in("vic").await;
    let path = ask(&vic).await;
    let ticket = path.split('?').nth(1).unwrap();
    assert_eq!(open(&format!("iris-2/foxglove?{ticket}")).await.map(drop).unwrap_err(), 401, "of another vehicle");
    assert_eq!(open(&format!("iris-1/live?{ticket}")).await.map(drop).unwrap_err(), 401, "of another route");
    let mut socket = open(&path).await.unwrap();
    socket.send(call(3, 0, "json", "{}")).await.unwrap();
    let why = answer(&mut socket, 0).await.unwrap_err();
    assert_eq!(why, "a viewer may not do this; it needs the role operator");
    assert_eq!(open(&path).await.map(drop).unwrap_err(), 401, "used");

    let ola = sign_in("ola").await;
    let (first, second) = (ask(&ola).await, ask(&ola).await);
    let mut socket = open(&first).await.unwrap();
    socket.send(call(3, 1, "json", "{}")).await.unwrap();
    let asked = agent.accept().await;
    assert!(matches!(asked.body, Some(Body::CutMotors(_))), "{asked:?}");
    assert_eq!(answer(&mut socket, 1).await.unwrap()["stage"], "accepted");

    // WHEN she signs out THEN what waits opens nothing, and what is open is closed.
    let headers = [("cookie", ola.as_str()), ("origin", origin.as_str()), ("x-plumbline-operator", "me")];
    assert_eq!(ground.request_as("DELETE", "/api/v1/session", "", &headers).await.status, 204);
    assert_eq!(open(&second).await.map(drop).unwrap_err(), 401, "the session has ended");
    let ended = async { while matches!(socket.next().await, Some(Ok(message)) if !message.is_close()) {} };
    tokio::time::timeout(PATIENCE, ended).await.expect("the link ends with the session");
    drop(other);
    ground.stop().await;
    let audit = std::fs::read_to_string(folder.path().join("audit.jsonl")).unwrap();
    let count = |who: &str, method: &str, status: &str| {
        let of = |line: &&str| [who, method, status, "/foxglove"].iter().all(|part| line.contains(part));
        audit.lines().filter(of).count()
    };
    assert_eq!(count("\"ola\"", "\"POST\"", "200"), 2, "{audit}");
    assert_eq!((count("\"ola\"", "\"GET\"", "101"), count("\"vic\"", "\"GET\"", "101")), (1, 1), "{audit}");
    assert!(count("", "\"GET\"", "401") >= 1 && !audit.contains("ticket="), "{audit}");
}

/// GIVEN nobody who must sign in WHEN the address is asked for THEN it needs no ticket.
#[tokio::test(flavor = "multi_thread")]
async fn an_address_needs_no_ticket_where_nobody_signs_in() {
    let folder = tempfile::tempdir().unwrap();
    let ground = Ground::start(folder.path()).await;
    let _agent = ground.agent("iris-1", 1).await;
    ground.wait_json("/api/v1/vehicles", |v| v[0]["id"] == "iris-1").await;
    let told = ground.request("POST", "/api/v1/vehicles/iris-1/foxglove", "").await;
    let told: Value = serde_json::from_slice(&told.body).unwrap();
    let url = format!("ws://{}/api/v1/vehicles/iris-1/foxglove", ground.address);
    assert_eq!(told, json!({ "url": url, "valid_s": null }));
    assert_eq!(ground.request("POST", "/api/v1/vehicles/nobody/foxglove", "").await.status, 404);
    connect(&ground, "iris-1", Some("foxglove.sdk.v1")).await.unwrap();
    ground.stop().await;
}

/// GIVEN a ground that knows a page of others WHEN that page opens the link THEN it is served, and no other page is; the rest of the API
/// stays closed to it.
#[tokio::test(flavor = "multi_thread")]
async fn a_page_of_others_is_served_where_it_is_allowed() {
    let folder = tempfile::tempdir().unwrap();
    let mut config = plumbline_ground::GroundConfig::new(folder.path());
    config.allowed_origins = vec!["https://app.foxglove.dev".into()];
    config.reserve_bytes = 1;
    let ground = Ground::start_with(config).await;
    let _agent = ground.agent("iris-1", 7).await;
    let from = |origin: &str, path: &'static str| {
        let headers = [("origin", origin.to_owned())];
        let ground = &ground;
        async move { connect_with(ground, path, Some("foxglove.websocket.v1"), &headers).await.map(|_| ()) }
    };
    assert_eq!(from("https://app.foxglove.dev", "iris-1/foxglove").await, Ok(()));
    assert_eq!(from("https://elsewhere.dev", "iris-1/foxglove").await, Err(403));
    assert_eq!(from("null", "iris-1/foxglove").await, Err(403));
    assert_eq!(from("https://app.foxglove.dev", "iris-1/live").await, Err(403));
    let theirs = [("origin", "https://app.foxglove.dev")];
    let asked = ground.request_as("POST", "/api/v1/vehicles/iris-1/foxglove", "", &theirs).await;
    assert_eq!(asked.status, 403, "an address is asked for by our own page");
}
