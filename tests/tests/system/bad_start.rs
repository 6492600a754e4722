//! What cannot work says so at once, with the offending value, and disturbs nobody.

use std::io::{BufRead as _, BufReader, PipeReader, Write as _};
use std::os::fd::AsRawFd as _;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::Instant;

use plumbline_support::system::{PATIENCE, Rig, options, scenario};
use plumbline_tests::harness::{Agent, Api, Process, Vehicle, wait_until};

/// Runs a program that must end by itself with an error; what it said.
fn refused(name: &str, command: Command) -> String {
    let mut process = Process::start(name, command, false).unwrap();
    let begun = Instant::now();
    let status = wait_until(PATIENCE, || process.ended());
    assert!(status.is_some_and(|status| !status.success()), "{name} after {:?}: {status:?}", begun.elapsed());
    // Until its outputs are closed: nothing it said is missed.
    let _ = process.wait_for(PATIENCE, |_| None::<()>);
    process.last_lines(50)
}

#[test]
fn an_occupied_port_is_named() {
    let rig = Rig::start(&scenario("altitude_step"));
    let folder = tempfile::tempdir().unwrap();
    let options = options(folder.path());
    let address = rig.api().address.to_string();
    let mut page = Command::new(&options.binaries.ground);
    page.args(["--listen", &address, "--agent-listen", "127.0.0.1:0", "--data"]).arg(folder.path());
    let said = refused("second ground", page);
    assert!(said.contains(&address), "{said}");
    let link = rig.system().ground.link.to_string();
    let mut agents = Command::new(&options.binaries.ground);
    agents.args(["--listen", "127.0.0.1:0", "--agent-listen", &link, "--data"]).arg(folder.path());
    let said = refused("third ground", agents);
    assert!(said.contains(&link), "{said}");
    rig.stop();
}

#[test]
fn a_data_folder_that_is_a_file_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("not-a-folder");
    std::fs::write(&file, b"").unwrap();
    let mut ground = Command::new(options(folder.path()).binaries.ground);
    ground.args(["--listen", "127.0.0.1:0", "--agent-listen", "127.0.0.1:0", "--data"]).arg(&file);
    let said = refused("ground", ground);
    assert!(said.contains("not-a-folder"), "{said}");
}

/// Identity and log of an agent without a configuration file.
fn keep_in(agent: &mut Command, folder: &Path) {
    agent.arg("--identity").arg(folder.join("identity")).arg("--log").arg(folder.join("log"));
}

/// An agent that has nothing to fly, and no ground to tell.
fn agent(folder: &Path, arguments: &[&str]) -> Command {
    let mut agent = Command::new(options(folder).binaries.agent);
    agent.args(arguments).args(["--ground", "127.0.0.1:9"]);
    keep_in(&mut agent, folder);
    agent
}

#[test]
fn a_file_that_is_no_recording_is_named_with_the_reason() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("holiday.jpg");
    std::fs::write(&file, b"\xff\xd8\xff\xe0 certainly no flight").unwrap();
    let file = file.to_str().unwrap();
    let said = refused("agent", agent(folder.path(), &["--vehicle", "replay", file]));
    assert!(said.contains("holiday.jpg"), "{said}");
    let said = refused("agent", agent(folder.path(), &["--vehicle", "replay", "/nowhere/at-all.mcap"]));
    assert!(said.contains("/nowhere/at-all.mcap"), "{said}");
}

#[test]
fn a_scenario_with_a_wrong_value_names_key_and_value() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("wrong.toml");
    std::fs::write(&file, "name = \"wrong\"\ntick_rate_hz = 12\n").unwrap();
    let file = file.to_str().unwrap();
    let said = refused("agent", agent(folder.path(), &["--vehicle", "sim", "--scenario", file]));
    assert!(said.contains("tick_rate_hz") && said.contains("12"), "{said}");
}

#[test]
fn a_second_agent_of_the_same_name_is_refused_and_the_first_flies_on() {
    // GIVEN a flying vehicle
    let rig = Rig::start(&scenario("altitude_step"));
    rig.fly_to(0.5);
    let vehicles = || rig.api().get_json("/api/v1/vehicles").unwrap();
    let boot = vehicles()[0]["boot_id"].clone();
    // WHEN another agent with its name, as well trusted, connects
    let folder = tempfile::tempdir().unwrap();
    let impostor =
        Agent::start(&options(folder.path()), &rig.system().agent.id, &scenario("hover"), &rig.system().ground)
            .unwrap();
    let mut live = rig.live();
    live.step_response(0.5);
    // THEN the list still holds the first, armed and connected, and its recording is whole
    let vehicles = vehicles();
    assert_eq!(vehicles.as_array().unwrap().len(), 1, "{vehicles}");
    assert_eq!(vehicles[0]["boot_id"], boot);
    assert_eq!((&vehicles[0]["connected"], &vehicles[0]["armed"]), (&true.into(), &true.into()), "{vehicles}");
    drop(impostor);
    rig.disarm();
    assert_eq!(rig.finished_flight()["missing"], 0);
    rig.stop();
}

/// A program whose log goes into a pipe that is full and that nobody reads. Killed when it is dropped.
struct Muted {
    child: Child,
    _log: PipeReader,
}

impl Drop for Muted {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn mute(mut command: Command) -> Muted {
    let (reader, mut writer) = std::io::pipe().unwrap();
    // SAFETY: the pipe is open; its size becomes that of a page, and is answered.
    let size = unsafe { libc::fcntl(writer.as_raw_fd(), libc::F_SETPIPE_SZ, 4096) };
    writer.write_all(&vec![b'.'; usize::try_from(size).unwrap()]).unwrap();
    let child = command.stdout(Stdio::piped()).stderr(writer).stdin(Stdio::null()).spawn().unwrap();
    Muted { child, _log: reader }
}

#[test]
fn a_terminal_that_takes_no_more_lines_holds_up_neither_ground_nor_agent() {
    let folder = tempfile::tempdir().unwrap();
    let mut ground = Command::new(options(folder.path()).binaries.ground);
    ground.args(["--listen", "127.0.0.1:0", "--agent-listen", "127.0.0.1:0", "--data"]).arg(folder.path().join("data"));
    let mut ground = mute(ground);
    let mut said = String::new();
    let mut stdout = BufReader::new(ground.child.stdout.take().unwrap());
    stdout.read_line(&mut said).unwrap();
    let address = said.trim().split("http://").nth(1).unwrap().trim_end_matches('/').parse().unwrap();
    let api = Api { address, operator: "test".into() };
    let begun = Instant::now();
    (0..200).for_each(|_| assert_eq!(api.get("/api/v1/ground").unwrap().status, 200));
    assert!(begun.elapsed() < PATIENCE, "{:?}", begun.elapsed());

    let Vehicle::Simulated { scenario } = scenario("hover") else { unreachable!() };
    let mut scripted = Command::new(options(folder.path()).binaries.agent);
    scripted.args(["--vehicle", "sim", "--script", "--ground", "none", "--speed", "max", "--scenario"]).arg(scenario);
    keep_in(&mut scripted, folder.path());
    let mut agent = mute(scripted);
    let ended = wait_until(PATIENCE, || agent.child.try_wait().unwrap());
    assert!(ended.is_some_and(|status| status.success()), "the flight stands still: {ended:?}");
}

#[test]
fn nobody_gets_in_unpaired() {
    // GIVEN a ground with a paired vehicle
    let rig = Rig::start(&scenario("altitude_step"));
    // WHEN an agent knocks that knows it, and that it does not know
    let folder = tempfile::tempdir().unwrap();
    let program = options(folder.path()).binaries.agent;
    let fingerprint = std::fs::read_to_string(rig.system().ground.identity.join("fingerprint")).unwrap();
    let mut knowing = Command::new(&program);
    knowing.arg("identity").arg("--identity").arg(folder.path().join("identity")).args(["--trust", fingerprint.trim()]);
    assert!(knowing.output().unwrap().status.success());
    let mut stranger = Command::new(program);
    let Vehicle::Simulated { scenario } = scenario("hover") else { unreachable!() };
    stranger.args(["--vehicle", "sim", "--scenario"]).arg(scenario).args(["--id", "stranger", "--ground"]);
    stranger.arg(rig.system().ground.link.to_string());
    keep_in(&mut stranger, folder.path());
    let mut stranger = Process::start("stranger", stranger, false).unwrap();
    let refused = wait_until(PATIENCE, || {
        let ground = rig.api().get_json("/api/v1/ground").unwrap();
        (ground["refused_peers"].as_u64() > Some(0)).then_some(())
    });
    assert!(refused.is_some(), "it was not heard: {}", stranger.last_lines(10));
    // THEN it is refused, and never shows
    let vehicles = rig.api().get_json("/api/v1/vehicles").unwrap();
    assert!(vehicles.as_array().unwrap().iter().all(|vehicle| vehicle["id"] != "stranger"), "{vehicles}");
    assert!(stranger.ended().is_none(), "an agent keeps trying: {}", stranger.last_lines(10));
    rig.stop();
}
