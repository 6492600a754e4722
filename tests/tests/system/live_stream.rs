//! Viewers: what they are told first, that they miss nothing, and that a stalled one is alone with it.

use std::collections::BTreeSet;
use std::io::{Read, Write};
use std::net::TcpStream;
use std::time::{Duration, Instant};

use plumbline_proto::{Kind, v1};
use plumbline_support::system::{Live, PATIENCE, Rig, scenario};
use serde_json::json;

#[test]
fn a_viewer_learns_everything_in_its_first_two_seconds() {
    let rig = Rig::start(&scenario("altitude_step"));
    let kinds = BTreeSet::from([
        Kind::Description,
        Kind::Status,
        Kind::Gains,
        Kind::Attacks,
        Kind::Estimate,
        Kind::Residuals,
        Kind::Control,
        Kind::Height,
        Kind::Imu,
        Kind::Truth,
        Kind::Link,
        Kind::Recording,
    ]);
    // Two of three: a machine that compiles beside us has other things to do as well.
    let learns = |_| {
        let opened = Instant::now();
        let mut live = rig.live();
        let mut missing = kinds.clone();
        while !missing.is_empty() && opened.elapsed() < Duration::from_secs(2) {
            let frame = live.frame();
            missing.retain(|kind| !frame.is(*kind));
        }
        missing
    };
    let missing: Vec<_> = (0..3).map(learns).collect();
    assert!(missing.iter().filter(|missing| missing.is_empty()).count() >= 2, "still nothing of {missing:?}");
    rig.stop();
}

/// Sequence numbers of frames the agent made, seen in `span` and from its middle until shortly before its end: the
/// snapshot comes first, in any order, and what travels on a stream may come before or after its neighbours.
fn sequences(live: &mut Live, span: Duration) -> Vec<u64> {
    let begin = Instant::now();
    let mut seen = Vec::new();
    while begin.elapsed() < span {
        let frame = live.frame();
        if frame.sequence > 0 {
            seen.push(frame.sequence);
        }
    }
    let (first, last) = (seen[seen.len() / 2], seen[seen.len() * 9 / 10]);
    seen.retain(|sequence| (first..=last).contains(sequence));
    seen
}

#[test]
fn a_stalled_viewer_costs_the_others_and_the_recording_nothing() {
    // GIVEN a flight with two viewers, one of whom never reads
    let rig = Rig::start(&scenario("altitude_step"));
    let _stalled = rig.live();
    let mut live = rig.live();
    rig.fly_to(0.5);
    // WHEN a third viewer watches for a few seconds
    let mut seen = sequences(&mut live, Duration::from_secs(6));
    // THEN nothing that came over the link is missing, doubled or late for it
    seen.sort_unstable();
    let span = seen.last().unwrap() - seen.first().unwrap() + 1;
    assert!(span > 500, "only {span} messages in two seconds");
    let doubled = seen.len();
    seen.dedup();
    assert_eq!(seen.len(), doubled, "messages came twice");
    let missing = span - seen.len() as u64;
    // The median, as what is sent may wait for the processor now and then.
    let link = |_| live.until(PATIENCE, "link status", |frame| frame.message::<v1::LinkStatus>(Kind::Link));
    let links: Vec<_> = (0..5).map(link).collect();
    let mut ages_ms: Vec<f64> = links.iter().map(|link| link.age_ms).collect();
    ages_ms.sort_by(f64::total_cmp);
    assert!(ages_ms[2] < 200.0, "{ages_ms:?}");
    assert!(links.iter().all(|link| link.viewer_dropped == 0), "{links:?}");
    // AND the recording is complete
    rig.disarm();
    let flight = rig.finished_flight();
    assert_eq!(flight["missing"], 0);
    // Live messages travel in datagrams, of which one may be lost: the recording has it from the agent's log, viewers do not.
    let lost = flight["filled"].as_u64().unwrap();
    assert!(missing <= lost, "{missing} of {span} messages are missing, and the link lost {lost}");
    rig.stop();
}

#[test]
fn a_page_of_another_origin_can_neither_watch_nor_write() {
    let rig = Rig::start(&scenario("altitude_step"));
    let address = rig.api().address;
    for origin in ["http://evil.example", "null", "http://127.0.0.1:1"] {
        let upgrade = format!(
            "GET {} HTTP/1.1\r\nHost: {address}\r\nOrigin: {origin}\r\nConnection: Upgrade\r\nUpgrade: websocket\r\n\
             Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n",
            rig.system().vehicle("live")
        );
        let mut stream = TcpStream::connect(address).unwrap();
        stream.set_read_timeout(Some(PATIENCE)).unwrap();
        stream.write_all(upgrade.as_bytes()).unwrap();
        let mut answer = [0; 12];
        stream.read_exact(&mut answer).unwrap();
        assert_eq!(&answer, b"HTTP/1.1 403", "{origin}");
        let arm = rig.system().vehicle("arm");
        let reply = rig.api().request("POST", &arm, Some(b"{}"), &[("Origin", origin)]).unwrap();
        assert_eq!(reply.status, 403, "{origin}: {}", reply.text());
    }
    rig.stop();
}

#[test]
fn one_operator_at_a_time_and_the_cut_is_everybodys() {
    // GIVEN an operator who took control by arming
    let rig = Rig::start(&scenario("altitude_step"));
    rig.fly_to(0.5);
    let mut live = rig.live();
    let lease = live.until(PATIENCE, "lease", |frame| frame.message::<v1::ControlLease>(Kind::Lease));
    assert_eq!(lease.holder, rig.api().operator);
    let other = plumbline_tests::harness::Api { operator: "somebody-else".into(), ..rig.api().clone() };
    // WHEN another one commands THEN it is refused, and nothing changed
    let reply = other.send("POST", &rig.system().vehicle("setpoint"), &json!({ "altitude_m": 0.9 })).unwrap();
    assert_eq!(reply.status, 423, "{}", reply.text());
    // WHEN the other cuts the motors THEN they are cut, and stay cut
    let cut = other.send("POST", &rig.system().vehicle("cut"), &json!({})).unwrap();
    assert_eq!(cut.status, 200, "{}", cut.text());
    let status = live.status("latched cut", |status| status.cut_latched);
    assert_eq!((status.mode(), status.armed), (v1::Mode::Cut, false));
    let arm = rig.api().send("POST", &rig.system().vehicle("arm"), &json!({})).unwrap();
    assert_eq!(arm.status, 409, "{}", arm.text());
    rig.stop();
}
