//! The API as tools meet it: its description, its errors, pages of a list, tags, and what watches over the ground.

use crate::common::Ground;
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

/// GIVEN a ground with a vehicle WHEN every list and every thing of it is read that the description has as JSON THEN each has
/// its tag, and is not sent to whoever shows that.
#[tokio::test(flavor = "multi_thread")]
async fn every_answer_in_json_has_the_tag_that_the_description_promises() {
    let folder = tempfile::tempdir().unwrap();
    let ground = Ground::start(folder.path()).await;
    let mut agent = ground.agent("iris-1", 1).await;
    agent.describe().await;
    ground.wait_json("/api/v1/vehicles", |v| v[0]["rig"] == "strings").await;
    let document = ground.json("/api/v1/openapi.json").await;
    let mut tagged = Vec::new();
    for (path, methods) in document["paths"].as_object().unwrap() {
        let answer = &methods["get"]["responses"]["200"];
        if answer["content"]["application/json"].is_null() {
            continue;
        }
        assert_eq!(answer["headers"]["ETag"]["required"], true, "{path}");
        assert!(methods["get"]["responses"]["304"].is_object(), "{path}");
        let path = path.replace("/vehicles/{id}", "/vehicles/iris-1");
        let first = ground.get(&path).await;
        // What is not there, or needs a query, is refused.
        if first.status != 200 {
            continue;
        }
        let tag = first.header("etag").unwrap_or_else(|| panic!("{path} has no tag")).to_owned();
        assert!(first.header("cache-control").is_some_and(|told| told.contains("no-cache")), "{}", first.head);
        // What changes by the moment has another one by now: the list of flights says how much of the disk is free.
        if !["/api/v1/ground", "/api/v1/vehicles", "/api/v1/flights"].contains(&path.as_str()) {
            let again = ground.request_as("GET", &path, "", &[("if-none-match", &tag)]).await;
            assert_eq!((again.status, again.body.is_empty()), (304, true), "{path}");
        }
        tagged.push(path);
    }
    for path in ["/api/v1/vehicles/iris-1/lease", "/api/v1/flights", "/api/v1/audit", "/api/v1/session"] {
        assert!(tagged.iter().any(|known| known == path), "{path}: {tagged:?}");
    }
    let download = &document["paths"]["/api/v1/flights/{id}/mcap"]["get"];
    for status in ["200", "206", "304", "416"] {
        assert!(download["responses"][status].is_object(), "{status}");
    }
    let names: Vec<_> = download["parameters"].as_array().unwrap().iter().filter_map(|p| p["name"].as_str()).collect();
    for name in ["range", "if-range", "if-none-match"] {
        assert!(names.contains(&name), "{names:?}");
    }
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
        ("GET", "/api/v1/audit?limit=1001", "", 422, "invalid", "limit 1001"),
        ("GET", "/api/v1/audit?page=2", "", 422, "invalid", "page"),
        ("GET", "/api/v1/experiments?limit=0", "", 422, "invalid", "limit 0"),
        ("GET", "/api/v1/calibrations?offset=-1", "", 422, "invalid", "offset"),
        ("GET", "/api/v1/flights?from_unix_us=today", "", 422, "invalid", "from_unix_us"),
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
    assert_eq!(ids("vehicle=iris-1&sort=name&descending=false").await, ("f0 f1 f2 f3 f4".into(), 5));
    assert_eq!(ids("vehicle=iris").await, (String::new(), 0));
    let begun =
        async |id: &str| ground.json(&format!("/api/v1/flights/{id}")).await["started_unix_us"].as_u64().unwrap();
    let (from, to) = (begun("f1").await, begun("f3").await);
    assert_eq!(ids(&format!("from_unix_us={from}&to_unix_us={to}&descending=false")).await, ("f1 f2".into(), 2));
    // Every deed of the tests so far was a question: one that changes something is a line, and pages of it follow each other.
    for n in 0..3 {
        ground.request("PATCH", "/api/v1/flights/f0", &format!("{{\"name\":\"n{n}\"}}")).await;
    }
    let deeds = async |query: &str| {
        let list = ground.json(&format!("/api/v1/audit?{query}")).await;
        let bodies = list["deeds"].as_array().unwrap().iter().map(|deed| deed["body"].as_str().unwrap().to_owned());
        bodies.collect::<Vec<_>>().join(" ")
    };
    let begun = std::time::Instant::now();
    while deeds("limit=1").await != r#"{"name":"n2"}"# {
        assert!(begun.elapsed() < crate::common::PATIENCE, "{}", deeds("").await);
        tokio::time::sleep(std::time::Duration::from_millis(20)).await;
    }
    assert_eq!(deeds("limit=2&offset=1").await, r#"{"name":"n0"} {"name":"n1"}"#);
    assert_eq!(deeds("offset=3").await, "");
    assert_eq!(deeds("search=Flights/F0+n1").await, r#"{"name":"n1"}"#);
    assert_eq!(deeds("search=flights/f0&limit=1&offset=2").await, r#"{"name":"n0"}"#);
    assert_eq!(deeds("search=nobody").await, "");
    ground.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn whoever_watches_over_the_ground_is_answered() {
    let folder = tempfile::tempdir().unwrap();
    let ground = Ground::start(folder.path()).await;
    let mut agent = ground.agent("iris-1", 1).await;
    agent.fly(3).await;
    assert_eq!(ground.get("/healthz").await.text(), "ok\n");
    ground.wait_ready().await;
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

/// GIVEN a command without an answer, a live view and refused requests WHEN figures are asked THEN each is told.
#[tokio::test(flavor = "multi_thread")]
async fn what_waits_and_what_is_answered_is_told() {
    let folder = tempfile::tempdir().unwrap();
    let ground = Ground::start(folder.path()).await;
    let mut agent = ground.agent("iris-1", 1).await;
    let viewer = ground.view("iris-1", 0).await;
    for name in ["viewer_queued_bytes", "viewer_dropped_total", "foxglove_dropped_total", "downloads_open"] {
        assert!(ground.figure(name).await >= 0.0, "{name}");
    }
    assert_eq!((ground.figure("viewers").await, ground.figure("commands_waiting").await), (1.0, 0.0));
    assert_eq!(ground.figure("experiments_running").await, 0.0);
    let ask = async {
        let answer = ground.request("POST", "/api/v1/vehicles/iris-1/arm", "{}").await;
        assert_eq!(answer.status, 200, "{}", answer.text());
    };
    let watch = async {
        let command = agent.command().await;
        assert_eq!(ground.figure("commands_waiting").await, 1.0);
        agent.ack(command.command_id, plumbline_proto::v1::AckStage::Accepted, "").await;
    };
    tokio::join!(ask, watch);
    assert_eq!(ground.figure("commands_waiting").await, 0.0);
    let of = async |class: &str| ground.figure(&format!("http_requests_total{{status=\"{class}\"}}")).await;
    let (upgraded, refused, before) = (of("1xx").await, of("4xx").await, of("2xx").await);
    assert_eq!((upgraded, of("5xx").await), (1.0, 0.0));
    for path in ["/api/v1/flights/none", "/api/v1/flights?limit=0"] {
        ground.get(path).await;
    }
    assert_eq!(of("4xx").await, refused + 2.0);
    // Every figure above was an answer as well.
    assert_eq!(of("2xx").await, before + 3.0);
    viewer.close().await;
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
        assert!(begun.elapsed() < crate::common::PATIENCE, "{}", answer.text());
        tokio::time::sleep(std::time::Duration::from_millis(20)).await;
    }
    assert_eq!(ground.get("/healthz").await.status, 200);
    ground.stop().await;
}
