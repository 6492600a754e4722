//! Who is trusted changes in flight, with the commands the manual names: revoked, trusted again, new certificates on
//! either side. Whoever is trusted no more is refused and counted; the vehicle flies on and comes back by itself.

use std::path::Path;
use std::process::Command;
use std::time::{Duration, Instant};

use plumbline_support::system::{Live, PATIENCE, free_port, options, scenario};
use plumbline_tests::harness::{Agent, Ground, Process, SystemOptions, wait_until};
use serde_json::{Value, json};

/// Revoked connections end within a second; and what a machine that compiles beside us adds to it.
const REVOKED_WITHIN: Duration = Duration::from_secs(3);

/// Runs `PROGRAM identity …` on the folder of an identity; the fingerprint it prints.
fn identity(program: &Path, folder: &Path, arguments: &[&str]) -> String {
    let ran = Command::new(program).arg("identity").arg("--identity").arg(folder).args(arguments).output().unwrap();
    assert!(ran.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&ran.stderr));
    String::from_utf8(ran.stdout).unwrap().trim().to_owned()
}

fn vehicle(ground: &Ground) -> Option<Value> {
    let vehicles = ground.api.get_json("/api/v1/vehicles").ok()?;
    vehicles.as_array()?.iter().find(|vehicle| vehicle["id"] == "iris-1").cloned()
}

fn connected(ground: &Ground) -> bool {
    vehicle(ground).is_some_and(|vehicle| vehicle["connected"] == true)
}

/// Peers that the ground has refused since its start.
fn refused(ground: &Ground) -> u64 {
    ground.api.get_json("/api/v1/ground").unwrap()["refused_peers"].as_u64().expect("a count")
}

fn wait_for_refusals(ground: &Ground, before: u64) {
    let counted = wait_until(PATIENCE, || (refused(ground) > before).then_some(()));
    assert!(counted.is_some(), "nobody was refused");
    assert!(!connected(ground), "refused and connected");
}

/// Waits for a status sensed after `after_us`; its time since boot, µs.
fn status_after(ground: &Ground, after_us: u64) -> u64 {
    let mut live = Live::connect(&ground.api, "/api/v1/vehicles/iris-1/live?history=0");
    live.status("a later status", |status| status.time_us > after_us).time_us
}

/// An identity with the certificate of before a rotation.
fn former(folder: &Path, to: &Path) {
    std::fs::create_dir_all(to).unwrap();
    std::fs::copy(folder.join("peers"), to.join("peers")).unwrap();
    for name in ["cert.pem", "key.pem"] {
        std::fs::copy(folder.join(format!("{name}.old")), to.join(name)).unwrap();
    }
}

#[test]
fn trust_is_revoked_renewed_and_rotated_in_flight() {
    let folder = tempfile::tempdir().unwrap();
    let options = SystemOptions { port: free_port(), ..options(folder.path()) };
    let ground_program = options.binaries.ground.clone();
    let agent_program = options.binaries.agent.clone();
    let mut ground = Ground::start(&options).unwrap();
    let mut agent = Agent::start(&options, "iris-1", &scenario("altitude_step"), &ground).unwrap();
    let boot = vehicle(&ground).unwrap()["boot_id"].clone();
    let arm = || ground.api.send("POST", "/api/v1/vehicles/iris-1/arm", &json!({})).unwrap().status == 200;
    wait_until(PATIENCE, || arm().then_some(())).expect("armed");
    let armed_us = status_after(&ground, 0);

    // GIVEN a vehicle in flight WHEN the ground trusts it no more
    let of_agent = identity(&agent_program, &agent.identity, &[]);
    let begun = Instant::now();
    identity(&ground_program, &ground.identity, &["--revoke", "iris-1"]);
    // THEN its connection ends, and it is refused and counted whenever it knocks
    wait_until(PATIENCE, || (!connected(&ground)).then_some(())).expect("cut off");
    assert!(begun.elapsed() < REVOKED_WITHIN, "still connected after {:?}", begun.elapsed());
    wait_for_refusals(&ground, 0);
    // WHEN it is trusted again THEN it comes back by itself, the same boot, flown on meanwhile
    identity(&ground_program, &ground.identity, &["--trust", &of_agent, "--name", "iris-1"]);
    agent.wait_until_connected(&ground.api).unwrap();
    assert_eq!(vehicle(&ground).unwrap()["boot_id"], boot);
    status_after(&ground, armed_us + 1_000_000);

    // WHEN the ground makes itself a new certificate and starts again
    let old_ground = identity(&ground_program, &ground.identity, &[]);
    let new_ground = identity(&ground_program, &ground.identity, &["--rotate"]);
    assert_ne!(old_ground, new_ground);
    ground.process.interrupt(PATIENCE).unwrap();
    drop(ground);
    let ground = Ground::start(&options).unwrap();
    // THEN the agent refuses what it does not know, says so, and flies on
    let refusal = |line: &str| line.contains("unpaired peer refused").then_some(());
    agent.process.wait_for(PATIENCE, refusal).unwrap();
    assert!(!connected(&ground) && agent.process.ended().is_none());
    // AND comes back when it is told of the new one; the old one it is told to forget
    identity(&agent_program, &agent.identity, &["--trust", &new_ground, "--name", "ground"]);
    identity(&agent_program, &agent.identity, &["--revoke", &old_ground]);
    agent.wait_until_connected(&ground.api).unwrap();
    assert_eq!(vehicle(&ground).unwrap()["boot_id"], boot, "the agent was not started again");

    // WHEN the agent makes itself a new certificate and starts again THEN the ground refuses and counts it
    let new_agent = identity(&agent_program, &agent.identity, &["--rotate"]);
    assert_ne!(new_agent, of_agent);
    agent.process.interrupt(PATIENCE).unwrap();
    let before = refused(&ground);
    let start = |identity: &Path| {
        let mut command = Command::new(&agent_program);
        command.arg("--config").arg(options.data.join("iris-1/agent.toml")).arg("--identity").arg(identity);
        command.args(["--vehicle", "sim"]);
        Process::start("iris-1", command, false).unwrap()
    };
    let renewed = start(&agent.identity);
    wait_for_refusals(&ground, before);
    // AND serves it once it is told of the new one
    identity(&ground_program, &ground.identity, &["--revoke", &of_agent]);
    identity(&ground_program, &ground.identity, &["--trust", &new_agent, "--name", "iris-1"]);
    wait_until(PATIENCE, || connected(&ground).then_some(())).expect("the renewed agent");
    drop(renewed);
    // AND the old certificate, wherever it has got to, opens nothing any more
    wait_until(PATIENCE, || (!connected(&ground)).then_some(())).expect("gone");
    let before = refused(&ground);
    let stolen = folder.path().join("stolen");
    former(&agent.identity, &stolen);
    let _thief = start(&stolen);
    wait_for_refusals(&ground, before);
}
