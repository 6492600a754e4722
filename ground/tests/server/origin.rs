//! Only the ground's own page may open the live view or write.

use crate::common::Ground;
use crate::common::viewer::Viewer;

#[tokio::test(flavor = "multi_thread")]
async fn foreign_pages_can_neither_watch_nor_write() {
    let folder = tempfile::tempdir().unwrap();
    let ground = Ground::start(folder.path()).await;
    let mut agent = ground.agent("iris-1", 1).await;
    ground.wait_json("/api/v1/vehicles", |v| v[0]["connected"] == true).await;
    let own = format!("http://{}", ground.address);
    let other_port = format!("http://127.0.0.1:{}", ground.address.port().wrapping_add(1));

    for origin in ["http://evil.example", "null", &other_port] {
        for (method, path) in [
            ("POST", "/api/v1/vehicles/iris-1/arm"),
            ("POST", "/api/v1/vehicles/iris-1/cut"),
            ("PUT", "/api/v1/vehicles/iris-1/lease"),
            ("DELETE", "/api/v1/vehicles/iris-1/attacks"),
            ("PATCH", "/api/v1/flights/x"),
            ("DELETE", "/api/v1/flights/x"),
        ] {
            let answer = ground.request_as(method, path, "{}", &[("origin", origin)]).await;
            assert_eq!(answer.status, 403, "{method} {path} from {origin}: {}", answer.text());
        }
        let url = format!("ws://{}/api/v1/vehicles/iris-1/live", ground.address);
        let refused = Viewer::connect(&url, Some(origin)).await;
        match refused {
            Err(tokio_tungstenite::tungstenite::Error::Http(response)) => assert_eq!(response.status(), 403),
            Err(other) => panic!("{origin}: {other}"),
            Ok(_) => panic!("{origin} may watch"),
        }
    }
    assert!(agent.outgoing.try_recv().is_err(), "no command got through");

    let url = format!("ws://{}/api/v1/vehicles/iris-1/live", ground.address);
    assert!(Viewer::connect(&url, Some(&own)).await.is_ok());
    let arm = "/api/v1/vehicles/iris-1/arm";
    let headers = [("origin", own.as_str())];
    let (answer, _) = tokio::join!(ground.request_as("POST", arm, "{}", &headers), agent.accept());
    assert_eq!(answer.status, 200);
    ground.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_rebound_name_is_refused_even_for_reading() {
    let folder = tempfile::tempdir().unwrap();
    let mut config = plumbline_ground::GroundConfig::new(folder.path());
    config.allowed_hosts = vec!["bench.lab".into()];
    let ground = Ground::start_with(config).await;
    let port = ground.address.port();
    let evil = format!("evil.example:{port}");
    let origin = format!("http://{evil}");
    let answer = ground.request_as("GET", "/api/v1/vehicles", "", &[("host", &evil), ("origin", &origin)]).await;
    assert_eq!(answer.status, 403);
    for good in [format!("localhost:{port}"), format!("bench.lab:{port}"), format!("[::1]:{port}")] {
        assert_eq!(ground.request_as("GET", "/api/v1/vehicles", "", &[("host", &good)]).await.status, 200, "{good}");
    }
    let two = ground.request_as("GET", "/api/v1/vehicles", "", &[("host", "localhost"), ("host", &evil)]).await;
    assert!(two.status == 403 || two.status == 400, "{}", two.status);
    ground.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn answers_carry_the_security_headers_and_the_page_explains_itself() {
    let folder = tempfile::tempdir().unwrap();
    let ground = Ground::start(folder.path()).await;
    for path in ["/", "/flights", "/flights/abc", "/setup"] {
        let page = ground.get(path).await;
        assert_eq!(page.status, 200, "{path}");
        assert_eq!(page.header("content-type"), Some("text/html; charset=utf-8"));
        let policy = page.header("content-security-policy").unwrap();
        assert!(policy.contains("script-src 'self' 'wasm-unsafe-eval';"), "{policy}");
        assert!(policy.contains(&format!("ws://{}", ground.address)), "{policy}");
        assert_eq!(page.header("x-content-type-options"), Some("nosniff"));
    }
    for path in ["/nothing.js", "/../Cargo.toml", "/api/v1/nothing"] {
        let answer = ground.get(path).await;
        assert_eq!(answer.status, 404, "{path}");
        assert!(answer.error().contains("there is no"));
    }
    assert_eq!(ground.request("POST", "/", "").await.status, 405);
    ground.stop().await;
}
