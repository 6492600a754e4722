//! The Foxglove WebSocket protocol, as a client meets it.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod common;

use common::{Ground, PATIENCE};
use futures_util::{SinkExt as _, StreamExt as _};
use plumbline_proto::{Kind, Message as _, v1};
use serde_json::{Value, json};
use tokio::net::TcpStream;
use tokio_tungstenite::tungstenite::client::IntoClientRequest as _;
use tokio_tungstenite::tungstenite::{Error, Message};
use tokio_tungstenite::{MaybeTlsStream, WebSocketStream, connect_async};

type Socket = WebSocketStream<MaybeTlsStream<TcpStream>>;

async fn connect(ground: &Ground, vehicle: &str, protocols: Option<&str>) -> Result<(Socket, String), u16> {
    let url = format!("ws://{}/api/v1/vehicles/{vehicle}/foxglove", ground.address);
    let mut request = url.into_client_request().unwrap();
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
    assert_eq!((first["op"].as_str(), &first["capabilities"]), (Some("serverInfo"), &json!([])));
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
        (common::agent::BOOT_WALL_US + heights[0].1.time_us, 0.81)
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
        (r#"{"op":"advertise","channels":[]}"#, "read only"),
    ] {
        ask(&mut socket, text).await;
        let told = status(&mut socket).await;
        assert!(told.contains(named), "{text}: {told}");
    }
    socket.send(Message::binary(vec![1, 2, 3])).await.unwrap();
    assert!(status(&mut socket).await.contains("binary"));
    ask(&mut socket, &" ".repeat(100_000)).await;
    let ended = async { while matches!(socket.next().await, Some(Ok(message)) if !message.is_close()) {} };
    tokio::time::timeout(PATIENCE, ended).await.expect("too large a request ends the socket");
    assert_eq!(ground.get("/healthz").await.status, 200);
    ground.stop().await;
}
