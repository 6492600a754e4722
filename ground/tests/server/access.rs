//! Who may do what: every route of the table × every role × own, foreign and no Origin × no session.

use std::path::Path;
use std::time::{Duration, Instant};

use crate::common::viewer::Viewer;
use crate::common::{Ground, Response};
use futures_util::StreamExt as _;
use plumbline_ground::people::{Access, Accounts, Role};
use plumbline_ground::{GroundConfig, GroundError, access_table};
use serde_json::Value;

const PASSWORD: &str = "a long enough password";
const ROLES: [Role; 4] = Role::ALL;

fn accounts(folder: &Path) {
    ROLES.iter().for_each(|role| Accounts::of(folder).add(role.name(), *role, PASSWORD).unwrap());
}

/// The session cookie of an account.
async fn sign_in(ground: &Ground, name: &str) -> String {
    let body = serde_json::json!({ "name": name, "password": PASSWORD }).to_string();
    let answer = ground.request("POST", "/api/v1/session", &body).await;
    assert_eq!(answer.status, 200, "{}", answer.text());
    let cookie = answer.header("set-cookie").expect("a cookie");
    assert!(cookie.contains("HttpOnly") && cookie.contains("SameSite=Strict"), "{cookie}");
    cookie.split(';').next().unwrap().to_owned()
}

async fn ask(
    ground: &Ground,
    (method, path): (&str, &str),
    cookie: Option<&str>,
    origin: Option<&str>,
    header: bool,
) -> Response {
    let method = method.to_ascii_uppercase();
    let mut headers = Vec::new();
    headers.extend(cookie.map(|cookie| ("cookie", cookie)));
    headers.extend(origin.map(|origin| ("origin", origin)));
    if header {
        headers.push(("x-plumbline-operator", "page"));
    }
    ground.request_as(&method, path, "{}", &headers).await
}

#[tokio::test(flavor = "multi_thread")]
async fn every_route_lets_in_whom_the_table_says_and_nobody_else() {
    let folder = tempfile::tempdir().unwrap();
    accounts(folder.path());
    let ground = Ground::start(folder.path()).await;
    let own = format!("http://{}", ground.address);
    let mut sessions = vec![(None, None)];
    for role in ROLES {
        sessions.push((Some(role), Some(sign_in(&ground, role.name()).await)));
    }
    let mut asked = 0;
    for (method, path, need) in access_table() {
        // Neither exists: whoever is let in is answered something else than 401 or 403, and nothing happens.
        let path = path.replace("{id}", "nobody");
        let changes = method != "get";
        for (role, cookie) in &sessions {
            for (origin, foreign) in
                [(Some(own.as_str()), false), (None, false), (Some("http://evil.example"), true), (Some("null"), true)]
            {
                // What signs in and out would end or exhaust the sessions of this test.
                let cookie = cookie.as_deref().filter(|_| need != Access::Open);
                let answer = ask(&ground, (method, &path), cookie, origin, true).await;
                asked += 1;
                let what = format!("{method} {path} ({need:?}) as {role:?} from {origin:?}: {}", answer.status);
                if foreign {
                    assert_eq!(answer.status, 403, "{what}");
                } else if need == Access::Open {
                    assert_ne!(answer.status, 403, "{what}");
                } else {
                    let expected = match role {
                        None => Some(401),
                        Some(role) if !need.open_to(*role) => Some(403),
                        Some(_) if changes && origin.is_none() => Some(403),
                        Some(_) => None,
                    };
                    match expected {
                        Some(status) => assert_eq!(answer.status, status, "{what}"),
                        None => assert!(![401, 403].contains(&answer.status), "{what}: {}", answer.text()),
                    }
                }
            }
            // A form of a foreign page can set no header: the Origin of this page alone changes nothing.
            if changes && need != Access::Open && cookie.is_some() {
                let answer = ask(&ground, (method, &path), cookie.as_deref(), Some(&own), false).await;
                assert_eq!(answer.status, 403, "{method} {path} as {role:?} without its header");
            }
        }
    }
    assert!(asked > 600, "{asked} requests");
    // Beyond the table there is nothing, for anyone.
    let admin = sessions.last().and_then(|(_, cookie)| cookie.clone());
    for path in ["/api/v1/persons", "/api/v1/vehicles/iris-1/fire", "/api/v1/flights/x/y", "/api/vehicles"] {
        assert_eq!(ask(&ground, ("get", path), admin.as_deref(), None, true).await.status, 404, "{path}");
    }
    // The page itself shows the way; its files are public.
    let page = ground.get("/").await;
    assert_eq!((page.status, page.header("location")), (303, Some("/login")));
    assert!(ground.get("/login").await.text().contains("type=password"));
    ground.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn the_live_view_needs_a_session_and_its_origin() {
    let folder = tempfile::tempdir().unwrap();
    accounts(folder.path());
    let ground = Ground::start(folder.path()).await;
    let _agent = ground.agent("iris-1", 1).await;
    let cookie = sign_in(&ground, "viewer").await;
    let own = format!("http://{}", ground.address);
    let url = format!("ws://{}/api/v1/vehicles/iris-1/live", ground.address);
    for (cookie, origin, status) in [
        (None, Some(own.as_str()), 401),
        (Some(cookie.as_str()), None, 403),
        (Some(cookie.as_str()), Some("http://evil.example"), 403),
    ] {
        match Viewer::connect_as(&url, origin, cookie).await {
            Err(tokio_tungstenite::tungstenite::Error::Http(response)) => assert_eq!(response.status(), status),
            Err(other) => panic!("{other}"),
            Ok(_) => panic!("{origin:?} may watch"),
        }
    }
    let begun = std::time::Instant::now();
    while Viewer::connect_as(&url, Some(&own), Some(&cookie)).await.is_err() {
        assert!(begun.elapsed() < crate::common::PATIENCE);
        tokio::time::sleep(std::time::Duration::from_millis(20)).await;
    }
    ground.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn deeds_are_written_down_under_the_account_and_the_cut_needs_no_lease() {
    let folder = tempfile::tempdir().unwrap();
    accounts(folder.path());
    let ground = Ground::start(folder.path()).await;
    let mut agent = ground.agent("iris-1", 1).await;
    let own = format!("http://{}", ground.address);
    let (ann, bob, admin) =
        (sign_in(&ground, "operator").await, sign_in(&ground, "attacker").await, sign_in(&ground, "admin").await);
    // Under another name in the header: the account counts.
    let take = ask(&ground, ("put", "/api/v1/vehicles/iris-1/lease"), Some(&ann), Some(&own), true).await;
    assert_eq!(take.json()["holder"], "operator", "{}", take.text());
    let held = ask(&ground, ("post", "/api/v1/vehicles/iris-1/arm"), Some(&bob), Some(&own), true).await;
    assert_eq!((held.status, held.json()["holder"].as_str()), (423, Some("operator")));
    let cut = ask(&ground, ("post", "/api/v1/vehicles/iris-1/cut"), Some(&bob), Some(&own), true);
    let (cut, _) = tokio::join!(cut, agent.accept());
    assert_eq!(cut.status, 200, "{}", cut.text());
    let taken = ask(&ground, ("put", "/api/v1/vehicles/iris-1/lease"), Some(&bob), Some(&own), true).await;
    assert_eq!(taken.json()["taken_from"], "operator");
    // A secret sent, a request refused, and somebody who leaves.
    let headers = [("cookie", admin.as_str()), ("origin", own.as_str()), ("x-plumbline-operator", "page")];
    let pairing = ground.request_as("POST", "/api/v1/pairing", r#"{"code":"ABCD-EFGH"}"#, &headers).await;
    assert_eq!(pairing.status, 503);
    assert_eq!(ask(&ground, ("get", "/api/v1/audit"), Some(&bob), Some(&own), true).await.status, 403);
    assert_eq!(ask(&ground, ("delete", "/api/v1/session"), Some(&bob), Some(&own), true).await.status, 204);
    let begun = std::time::Instant::now();
    let deeds = loop {
        let answer = ask(&ground, ("get", "/api/v1/audit?limit=100"), Some(&admin), Some(&own), true).await;
        let deeds = answer.json()["deeds"].as_array().cloned().unwrap();
        if deeds.len() >= 10 {
            break deeds;
        }
        assert!(begun.elapsed() < crate::common::PATIENCE, "{deeds:?}");
        tokio::time::sleep(std::time::Duration::from_millis(10)).await;
    };
    let line = |who: &str, path: &str| {
        let path = format!("/api/v1/vehicles/iris-1/{path}");
        deeds.iter().find(|deed| deed["who"] == who && deed["path"] == path.as_str()).cloned()
    };
    assert_eq!(line("attacker", "arm").unwrap()["status"], 423);
    assert_eq!(line("attacker", "cut").unwrap()["status"], 200);
    let lease = line("operator", "lease").unwrap();
    assert_eq!((lease["role"].as_str(), lease["from"].as_str()), (Some("operator"), Some("127.0.0.1")));
    assert_eq!(deeds.iter().filter(|deed| deed["path"] == "/api/v1/session").count(), 4);
    let left = deeds.iter().find(|deed| deed["method"] == "DELETE" && deed["path"] == "/api/v1/session").unwrap();
    assert_eq!((left["who"].as_str(), left["role"].as_str()), (Some("attacker"), Some("attacker")));
    assert!(deeds.iter().any(|deed| deed["path"] == "/api/v1/audit" && deed["status"] == 403));
    let text = std::fs::read_to_string(folder.path().join("audit.jsonl")).unwrap();
    assert!(!text.contains(PASSWORD) && !text.contains("EFGH") && text.contains("redacted"));
    ground.stop().await;
    let verdict = plumbline_ground::audit::verify(folder.path()).unwrap();
    assert!(verdict.broken.is_none() && verdict.chained >= 10, "{verdict:?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_removed_account_loses_its_socket_and_control_at_once() {
    let folder = tempfile::tempdir().unwrap();
    accounts(folder.path());
    let ground = Ground::start(folder.path()).await;
    let _agent = ground.agent("iris-1", 1).await;
    let own = format!("http://{}", ground.address);
    let (ann, admin) = (sign_in(&ground, "operator").await, sign_in(&ground, "admin").await);
    // GIVEN an operator who watches and is in control
    let url = format!("ws://{}/api/v1/vehicles/iris-1/live", ground.address);
    let begun = Instant::now();
    let mut viewer = loop {
        match Viewer::connect_as(&url, Some(&own), Some(&ann)).await {
            Ok(viewer) => break viewer,
            Err(error) => assert!(begun.elapsed() < crate::common::PATIENCE, "{error}"),
        }
        tokio::time::sleep(Duration::from_millis(20)).await;
    };
    let take = ask(&ground, ("put", "/api/v1/vehicles/iris-1/lease"), Some(&ann), Some(&own), true).await;
    assert_eq!(take.status, 200, "{}", take.text());
    let people = ask(&ground, ("get", "/api/v1/people"), Some(&admin), Some(&own), true).await.json();
    assert_eq!(people["accounts"].as_array().unwrap().len(), ROLES.len());
    assert_eq!(people["sessions"].as_array().unwrap().len(), 2);
    let mine = ask(&ground, ("get", "/api/v1/sessions"), Some(&ann), Some(&own), true).await.json();
    assert_eq!((mine["sessions"][0]["account"].as_str(), &mine["sessions"][1]), (Some("operator"), &Value::Null));
    // WHEN an admin removes the account
    let gone = ask(&ground, ("delete", "/api/v1/people/operator"), Some(&admin), Some(&own), true).await;
    assert_eq!(gone.status, 204, "{}", gone.text());
    let begun = Instant::now();
    // THEN the socket ends, and control with it
    let ended = async { while matches!(viewer.socket.next().await, Some(Ok(message)) if !message.is_close()) {} };
    tokio::time::timeout(crate::common::PATIENCE, ended).await.expect("the socket ends");
    loop {
        let lease = ask(&ground, ("get", "/api/v1/vehicles/iris-1/lease"), Some(&admin), Some(&own), true).await;
        if lease.json()["holder"].is_null() {
            break;
        }
        assert!(begun.elapsed() < crate::common::PATIENCE, "{}", lease.text());
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    // Promised is a second; a busy machine may take another.
    assert!(begun.elapsed() < Duration::from_secs(2), "{:?}", begun.elapsed());
    assert_eq!(ask(&ground, ("get", "/api/v1/vehicles"), Some(&ann), Some(&own), true).await.status, 401);
    let last = ask(&ground, ("delete", "/api/v1/people/admin"), Some(&admin), Some(&own), true).await;
    assert_eq!(last.status, 409, "{}", last.text());
    ground.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn refused_sign_ins_fill_no_log() {
    let folder = tempfile::tempdir().unwrap();
    accounts(folder.path());
    let ground = Ground::start(folder.path()).await;
    for n in 0..300 {
        let body = serde_json::json!({ "name": format!("guess{n}"), "password": PASSWORD }).to_string();
        let status = ground.request("POST", "/api/v1/session", &body).await.status;
        assert!([401, 429].contains(&status), "{status}");
    }
    ground.stop().await;
    let text = std::fs::read_to_string(folder.path().join("audit.jsonl")).unwrap();
    assert!(text.lines().count() <= 4 && text.contains("\"times\""), "{text}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_network_is_served_by_tls_to_accounts_only() {
    let folder = tempfile::tempdir().unwrap();
    let names = ["localhost".to_owned()];
    let (certificate, key) = plumbline_ground::front::own(&folder.path().join("tls"), &names).unwrap();
    let (tls, _) = plumbline_ground::front::tls(&certificate, &key).unwrap();
    let start = |config: GroundConfig| async move {
        let listener = tokio::net::TcpListener::bind("0.0.0.0:0").await.unwrap();
        let (_link, events) = tokio::sync::mpsc::channel(1);
        plumbline_ground::run(config, listener, events, std::future::pending()).await.unwrap_err()
    };
    let plain = GroundConfig::new(folder.path());
    let mut secure = GroundConfig::new(folder.path());
    secure.tls = Some(tls);
    assert!(matches!(start(plain).await, GroundError::NoTls { .. }));
    let error = start(secure.clone()).await;
    assert!(error.to_string().contains("plumbline-ground account add"), "{error}");

    accounts(folder.path());
    let ground = Ground::start_on(secure, "0.0.0.0:0").await;
    let host = format!("localhost:{}", ground.address.port());
    // Without TLS there is no answer at all.
    let mut stream = tokio::net::TcpStream::connect(("127.0.0.1", ground.address.port())).await.unwrap();
    let request = format!("GET / HTTP/1.1\r\nhost: {host}\r\nconnection: close\r\n\r\n");
    assert!(!crate::common::exchange(&mut stream, &request).await.starts_with(b"HTTP"));
    let mut tls = crate::common::tls(&ground, &certificate).await;
    let body = format!("{{\"name\":\"admin\",\"password\":\"{PASSWORD}\"}}");
    let request = format!(
        "POST /api/v1/session HTTP/1.1\r\nhost: {host}\r\norigin: https://{host}\r\nconnection: close\r\n\
         content-type: application/json\r\ncontent-length: {}\r\n\r\n{body}",
        body.len()
    );
    let answer = Response::parse(&crate::common::exchange(&mut tls, &request).await);
    assert_eq!(answer.status, 200, "{}", answer.text());
    assert!(answer.header("set-cookie").unwrap().contains("; Secure"));
    assert!(answer.header("strict-transport-security").is_some());
    assert!(answer.header("content-security-policy").unwrap().contains(&format!("wss://{host}")));
    // The Origin has to be the secure one.
    let mut tls = crate::common::tls(&ground, &certificate).await;
    let plain = request.replace("origin: https", "origin: http");
    assert_eq!(Response::parse(&crate::common::exchange(&mut tls, &plain).await).status, 403);
    ground.stop().await;
}
