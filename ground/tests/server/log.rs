//! The log as a program writes it: lines of JSON where that is asked for, and in each the request that it is about.

use std::io::{BufRead as _, BufReader, Read as _, Write as _};
use std::net::TcpStream;
use std::path::Path;
use std::process::{Command, Stdio};

use crate::common::Response;
use serde_json::Value;

/// What a ground logs that is started so, refuses one request with the number `run-7`, and is ended.
fn logged(data: &Path, options: &[&str]) -> String {
    let mut ground = Command::new(env!("CARGO_BIN_EXE_plumbline-ground"))
        .args(["--listen", "127.0.0.1:0", "--agent-listen", "127.0.0.1:0", "--data"])
        .arg(data)
        .args(options)
        .env_remove("RUST_LOG")
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut told = BufReader::new(ground.stdout.take().unwrap());
    let mut line = String::new();
    told.read_line(&mut line).unwrap();
    let address = line.trim().strip_prefix("Plumbline is at http://").and_then(|rest| rest.strip_suffix('/'));
    let mut stream = TcpStream::connect(address.expect("an address")).unwrap();
    let request =
        "GET /api/v1/ground HTTP/1.1\r\nhost: evil.example\r\nx-request-id: run-7\r\nconnection: close\r\n\r\n";
    stream.write_all(request.as_bytes()).unwrap();
    let mut raw = Vec::new();
    stream.read_to_end(&mut raw).unwrap();
    let answer = Response::parse(&raw);
    assert_eq!((answer.status, answer.header("x-request-id")), (403, Some("run-7")), "{}", answer.text());
    // As a service manager ends it: what waits to be written is.
    assert!(Command::new("kill").arg(ground.id().to_string()).status().unwrap().success());
    let mut log = String::new();
    ground.stderr.take().unwrap().read_to_string(&mut log).unwrap();
    assert!(ground.wait().unwrap().success(), "{log}");
    log
}

#[test]
fn a_line_has_the_number_of_its_request_and_is_json_where_that_is_asked_for() {
    let folder = tempfile::tempdir().unwrap();
    let text = logged(&folder.path().join("text"), &[]);
    let refused = text.lines().find(|line| line.contains("refused")).expect("a line of the refusal");
    assert!(refused.contains("id=run-7") && refused.contains("path=/api/v1/ground"), "{refused}");
    assert!(serde_json::from_str::<Value>(refused).is_err(), "text where nothing is said");

    let json = logged(&folder.path().join("json"), &["--json-log"]);
    let lines: Vec<Value> =
        json.lines().map(|line| serde_json::from_str(line).unwrap_or_else(|error| panic!("{error}: {line}"))).collect();
    let refused = lines.iter().find(|line| line["fields"]["message"] == "refused").expect("a line of the refusal");
    assert_eq!((&refused["level"], &refused["fields"]["status"]), (&"WARN".into(), &403.into()), "{refused}");
    assert_eq!((&refused["span"]["name"], &refused["span"]["id"]), (&"request".into(), &"run-7".into()), "{refused}");
    let others = lines.iter().filter(|line| line["span"]["id"] == "run-7").count();
    assert!(others < lines.len(), "not every line is about it");
}
