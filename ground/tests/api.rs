//! The API as tools meet it: its description, its errors, pages of a list, tags, and what watches over the ground.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod common;

use common::Ground;
use plumbline_ground::GroundConfig;

#[tokio::test(flavor = "multi_thread")]
async fn the_description_is_served_to_programs_and_people_and_once_only_to_whoever_has_it() {
    let folder = tempfile::tempdir().unwrap();
    let ground = Ground::start(folder.path()).await;
    let first = ground.get("/api/v1/openapi.json").await;
    assert_eq!((first.status, first.json()["openapi"].as_str()), (200, Some("3.1.0")));
    assert!(first.json()["paths"]["/api/v1/vehicles/{id}/cut"]["post"]["responses"]["404"].is_object());
    let tag = first.header("etag").expect("a tag").to_owned();
    for (known, status) in [(tag.as_str(), 304), ("\"other\"", 200), (&format!("\"a\", W/{tag}"), 304), ("*", 304)] {
        let again = ground.request_as("GET", "/api/v1/openapi.json", "", &[("if-none-match", known)]).await;
        assert_eq!((again.status, again.body.is_empty()), (status, status == 304), "{known}");
        assert_eq!(again.header("etag"), Some(tag.as_str()));
    }
    let page = ground.get("/api/v1/docs").await;
    assert!(page.text().contains("/api/v1/flights/{id}/csv"), "{}", page.status);
    ground.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn every_error_is_a_problem_with_a_code() {
    let folder = tempfile::tempdir().unwrap();
    let ground = Ground::start(folder.path()).await;
    for (method, path, body, status, code, named) in [
        ("GET", "/api/v1/flights?limit=0", "", 422, "invalid", "limit 0"),
        ("GET", "/api/v1/flights?limit=many", "", 422, "invalid", "limit"),
        ("GET", "/api/v1/flights?colour=red", "", 422, "invalid", "colour"),
        ("GET", "/api/v1/flights?sort=weight", "", 422, "invalid", "weight"),
        ("GET", "/api/v1/audit?limit=-1", "", 422, "invalid", "limit"),
        ("GET", "/api/v1/flights/%ff", "", 422, "invalid", "UTF-8"),
        ("GET", "/api/v1/flights/none", "", 404, "not_found", "none"),
        ("GET", "/api/v1/vehicles/x/live", "", 426, "upgrade_required", "WebSocket"),
        ("GET", "/api/flights", "", 404, "not_found", "/api/v1/docs"),
        ("PUT", "/api/v1/flights", "", 405, "method_not_allowed", "PUT"),
        ("POST", "/api/v1/vehicles/x/arm", "{}", 404, "not_found", "x"),
        ("POST", "/api/v1/pairing", "{\"code\":\"ABCD-EFGH\"}", 503, "unavailable", "link"),
    ] {
        let answer = ground.request(method, path, body).await;
        assert_eq!(answer.status, status, "{method} {path}: {}", answer.text());
        let problem = answer.json();
        assert_eq!(
            (problem["code"].as_str(), problem["status"].as_u64()),
            (Some(code), Some(status.into())),
            "{problem}"
        );
        assert!(answer.error().contains(named), "{problem}");
        assert!(status != 405 || answer.header("allow").is_some(), "{}", answer.head);
    }
    ground.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_long_list_comes_in_pages_that_can_be_searched_and_ordered() {
    let folder = tempfile::tempdir().unwrap();
    let ground = Ground::start(folder.path()).await;
    let mut agent = ground.agent("iris-1", 1).await;
    for n in 0..5 {
        let first = agent.begin(&format!("f{n}")).await;
        agent.fly(5 + n).await;
        let last = agent.end(&format!("f{n}"), first);
        agent.send([last], false).await;
    }
    let whole = |list: &serde_json::Value| list["ready"] == true && list["total"] == 5;
    ground.wait_json("/api/v1/flights", whole).await;
    ground
        .wait_json("/api/v1/flights", |list| {
            list["flights"].as_array().is_some_and(|all| all.iter().all(|flight| flight["completeness"] == "complete"))
        })
        .await;
    let ids = async |query: &str| {
        let list = ground.json(&format!("/api/v1/flights?{query}")).await;
        let ids: Vec<_> =
            list["flights"].as_array().unwrap().iter().map(|f| f["id"].as_str().unwrap().to_owned()).collect();
        (ids.join(" "), list["total"].as_u64().unwrap())
    };
    assert_eq!(ids("sort=duration&descending=false&limit=2").await, ("f0 f1".into(), 5));
    assert_eq!(ids("sort=duration&descending=false&limit=2&offset=4").await, ("f4".into(), 5));
    assert_eq!(ids("sort=name&descending=true&limit=1").await, ("f4".into(), 5));
    assert_eq!(ids("search=iris%20f3").await, ("f3".into(), 1));
    assert_eq!(ids("search=nothing").await, (String::new(), 0));
    ground.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn whoever_watches_over_the_ground_is_answered() {
    let folder = tempfile::tempdir().unwrap();
    let ground = Ground::start(folder.path()).await;
    let mut agent = ground.agent("iris-1", 1).await;
    agent.fly(3).await;
    assert_eq!(ground.get("/healthz").await.text(), "ok\n");
    let begun = std::time::Instant::now();
    while ground.get("/readyz").await.status != 200 {
        assert!(begun.elapsed() < common::PATIENCE, "{}", ground.get("/readyz").await.text());
        tokio::time::sleep(std::time::Duration::from_millis(20)).await;
    }
    ground.wait_json("/api/v1/vehicles", |v| v[0]["connected"] == true).await;
    let metrics = ground.get("/metrics").await;
    assert_eq!(metrics.header("content-type"), Some("text/plain; version=0.0.4; charset=utf-8"));
    let text = metrics.text();
    for line in
        ["plumbline_vehicle_connected{vehicle=\"iris-1\"} 1", "plumbline_recorder_healthy 1", "plumbline_viewers 0"]
    {
        assert!(text.lines().any(|known| known == line), "{line}: {text}");
    }
    // Every line is a comment or `name[{label}] number`; no family is told twice.
    let mut families = std::collections::BTreeSet::new();
    for line in text.lines() {
        match line.strip_prefix("# TYPE ") {
            Some(family) => assert!(families.insert(family.to_owned()), "{family} twice"),
            None if line.starts_with("# HELP ") => {}
            None => assert!(line.rsplit_once(' ').is_some_and(|(_, value)| value.parse::<f64>().is_ok()), "{line}"),
        }
    }
    assert!(families.len() > 15, "{families:?}");
    let numbered = ground.request_as("GET", "/healthz", "", &[("x-request-id", "run-7")]).await;
    assert_eq!(numbered.header("x-request-id"), Some("run-7"));
    assert!(ground.get("/healthz").await.header("x-request-id").is_some_and(|id| id.parse::<u64>().is_ok()));
    ground.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_ground_that_cannot_record_says_that_it_is_not_ready() {
    let folder = tempfile::tempdir().unwrap();
    let mut config = GroundConfig::new(folder.path());
    // No disk has so much.
    config.reserve_bytes = u64::MAX;
    let ground = Ground::start_with(config).await;
    let mut agent = ground.agent("iris-1", 1).await;
    agent.begin("f1").await;
    agent.fly(10).await;
    let begun = std::time::Instant::now();
    loop {
        let answer = ground.get("/readyz").await;
        if answer.status == 503 && answer.error().contains("recorded") {
            assert_eq!(answer.json()["code"], "unavailable");
            break;
        }
        assert!(begun.elapsed() < common::PATIENCE, "{}", answer.text());
        tokio::time::sleep(std::time::Duration::from_millis(20)).await;
    }
    assert_eq!(ground.get("/healthz").await.status, 200);
    ground.stop().await;
}
