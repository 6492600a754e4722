//! A ground and a vehicle, paired with each other.

use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, Instant};

use super::{Api, Binaries, Process};
use crate::xtask::XtaskError;

/// Either program says what it listens on, or is in the list of vehicles, well within this.
const START: Duration = Duration::from_secs(20);
/// After Ctrl-C recordings are finished and connections closed within this.
/// A vehicle in flight lands first: from the highest limit that takes ten seconds.
const STOP: Duration = Duration::from_secs(30);
const POLL: Duration = Duration::from_millis(25);

/// What flies.
#[derive(Debug, Clone)]
pub enum Vehicle {
    /// The simulator under this scenario.
    Simulated {
        /// Scenario file (TOML).
        scenario: PathBuf,
    },
    /// The same behind ports that speak each device's own protocol, flown through the real drivers.
    OnWires {
        /// Scenario file (TOML).
        scenario: PathBuf,
        /// Its devices, by a name that `plumbline-wires` knows.
        wiring: String,
    },
    /// A recording, flown again.
    Replayed {
        /// The recording.
        file: PathBuf,
        /// Times real time; `0` begins standing still, `max` is as fast as possible.
        speed: String,
    },
}

/// How to start a [`System`].
#[derive(Debug, Clone)]
pub struct Options {
    /// The programs.
    pub binaries: Binaries,
    /// Folder for recordings, identities and the onboard log; a `ground.toml` in it is the ground's configuration.
    pub data: PathBuf,
    /// Port of the page; 0 for any free one. The agents' port is free unless this one is given, and then the next.
    pub port: u16,
    /// Echo what both programs say.
    pub echo: bool,
}

/// A running ground.
#[derive(Debug)]
pub struct Ground {
    /// The process.
    pub process: Process,
    /// Its HTTP interface.
    pub api: Api,
    /// Where agents connect.
    pub link: SocketAddr,
    /// Folder of its link identity.
    pub identity: PathBuf,
}

/// A running agent.
#[derive(Debug)]
pub struct Agent {
    /// The process.
    pub process: Process,
    /// Its name.
    pub id: String,
    /// Folder of its link identity.
    pub identity: PathBuf,
    /// The wire rig that it flies, for [`Vehicle::OnWires`].
    pub rig: Option<Process>,
}

/// Ground and agent, paired.
#[derive(Debug)]
pub struct System {
    /// The ground.
    pub ground: Ground,
    /// The agent.
    pub agent: Agent,
}

impl System {
    /// Starts both and waits until the ground lists the vehicle as connected.
    ///
    /// # Errors
    /// Either did not start, or they did not find each other; with their last lines.
    pub fn start(options: &Options, vehicle: &Vehicle) -> Result<Self, XtaskError> {
        let ground = Ground::start(options)?;
        let agent = Agent::start(options, "iris-1", vehicle, &ground)?;
        Ok(Self { ground, agent })
    }

    /// The ground's HTTP interface.
    pub fn api(&self) -> &Api {
        &self.ground.api
    }

    /// Path of a route of our vehicle.
    pub fn vehicle(&self, route: &str) -> String {
        format!("/api/v1/vehicles/{}/{route}", self.agent.id)
    }

    /// Ends both as Ctrl-C would, the vehicle first so that its recording is complete.
    ///
    /// # Errors
    /// One of them had to be killed, or ended with an error.
    pub fn stop(mut self) -> Result<(), XtaskError> {
        let agent = end(&mut self.agent.process);
        let ground = end(&mut self.ground.process);
        let rig = self.agent.rig.as_mut().map_or(Ok(()), end);
        agent.and(ground).and(rig)
    }
}

fn end(process: &mut Process) -> Result<(), XtaskError> {
    let status = process.interrupt(STOP)?;
    if status.success() {
        Ok(())
    } else {
        let lines = process.last_lines(20);
        Err(XtaskError::Other(format!("{} ended with {status} after Ctrl-C:\n{lines}", process.name)))
    }
}

impl Ground {
    /// Starts a ground and waits until it listens.
    ///
    /// # Errors
    /// It did not start; with its last lines.
    pub fn start(options: &Options) -> Result<Self, XtaskError> {
        let data = options.data.join("ground");
        let identity = data.join("identity");
        let mut command = Command::new(&options.binaries.ground);
        let link_port = if options.port == 0 { 0 } else { options.port + 1 };
        command.arg("--listen").arg(format!("127.0.0.1:{}", options.port));
        command.arg("--agent-listen").arg(format!("127.0.0.1:{link_port}"));
        command.arg("--data").arg(&data);
        let config = options.data.join("ground.toml");
        if config.exists() {
            command.arg("--config").arg(config);
        }
        let mut process = Process::start("ground", command, options.echo)?;
        let page = process.wait_for(START, |line| address_after(line, "Plumbline is at http://"))?;
        let link = process.wait_for(START, |line| address_after(line, "agents connect to udp://"))?;
        let api = Api { address: page, operator: "system-test".into() };
        Ok(Self { process, api, link, identity })
    }
}

impl Agent {
    /// Starts an agent, pairs it with `ground`, and waits until the ground lists it as connected.
    ///
    /// # Errors
    /// It did not start or did not connect; with its last lines.
    pub fn start(options: &Options, id: &str, vehicle: &Vehicle, ground: &Ground) -> Result<Self, XtaskError> {
        let data = options.data.join(id);
        let identity = data.join("identity");
        let config = data.join("agent.toml");
        std::fs::create_dir_all(&data).map_err(XtaskError::file(&data))?;
        let mut text = agent_toml(id, ground.link, &identity, &data.join("log"));
        let mut rig = None;
        if let Vehicle::OnWires { scenario, wiring } = vehicle {
            let (process, devices) = wire_rig(options, &data.join("wires"), scenario, wiring)?;
            (rig, text) = (Some(process), text + &devices);
        }
        std::fs::write(&config, text).map_err(XtaskError::file(&config))?;
        let mut command = Command::new(&options.binaries.agent);
        command.arg("--config").arg(&config);
        match vehicle {
            Vehicle::OnWires { .. } => command.args(["--vehicle", "hardware"]),
            Vehicle::Simulated { scenario } => command.args(["--vehicle", "sim", "--scenario"]).arg(scenario),
            Vehicle::Replayed { file, speed } => {
                command.args(["--vehicle", "replay"]).arg(file).arg("--speed").arg(speed)
            }
        };
        pair(&options.binaries.agent, &identity, id, &ground.identity)?;
        let process = Process::start(id, command, options.echo)?;
        let mut agent = Self { process, id: id.to_owned(), identity, rig };
        agent.wait_until_connected(&ground.api)?;
        Ok(agent)
    }

    /// Waits until `api`'s ground lists it as connected.
    ///
    /// # Errors
    /// It does not; with its last lines.
    pub fn wait_until_connected(&mut self, api: &Api) -> Result<(), XtaskError> {
        let listed = wait_until(START, || {
            let vehicles = api.get_json("/api/v1/vehicles").unwrap_or_default();
            let mut vehicles = vehicles.as_array().cloned().unwrap_or_default().into_iter();
            vehicles.any(|vehicle| vehicle["id"] == self.id.as_str() && vehicle["connected"] == true).then_some(())
        });
        listed.ok_or_else(|| {
            let lines = self.process.last_lines(20);
            XtaskError::Other(format!("{} is not connected after {START:?}; its last lines:\n{lines}", self.id))
        })
    }
}

/// Starts the wire rig; returns what of the agent's configuration describes its devices and motors.
fn wire_rig(options: &Options, folder: &Path, scenario: &Path, wiring: &str) -> Result<(Process, String), XtaskError> {
    let mut command = Command::new(&options.binaries.wires);
    command.arg(folder).arg(scenario).arg(wiring);
    let mut process = Process::start("wires", command, options.echo)?;
    process.wait_for(START, |line| line.contains("--vehicle hardware").then_some(()))?;
    let file = folder.join("agent.toml");
    let devices = std::fs::read_to_string(&file).map_err(XtaskError::file(&file))?;
    Ok((process, format!("\n{devices}")))
}

/// What a real vehicle's configuration would say.
fn agent_toml(id: &str, ground: SocketAddr, identity: &Path, log: &Path) -> String {
    // A JSON string is a TOML basic string.
    let quoted = |path: &Path| serde_json::Value::from(path.display().to_string()).to_string();
    format!(
        "id = \"{id}\"\nground = \"{ground}\"\nidentity = {}\n\n[log]\nfolder = {}\n",
        quoted(identity),
        quoted(log)
    )
}

/// The address that follows `lead`.
/// The address that follows `lead` in a line.
pub fn address_after(line: &str, lead: &str) -> Option<SocketAddr> {
    let rest = line.split(lead).nth(1)?;
    let end = rest.find(|c: char| !(c.is_ascii_hexdigit() || ".:[]".contains(c))).unwrap_or(rest.len());
    rest.get(..end)?.parse().ok()
}

/// Asks again until there is an answer or `limit` has passed.
pub fn wait_until<T>(limit: Duration, mut ask: impl FnMut() -> Option<T>) -> Option<T> {
    let until = Instant::now() + limit;
    loop {
        let answer = ask();
        if answer.is_some() || Instant::now() >= until {
            return answer;
        }
        std::thread::sleep(POLL);
    }
}

/// Carries each side's fingerprint into the other's list of peers, as the README tells to do by hand:
/// before the agent starts, so that its first knock is answered.
fn pair(program: &Path, agent: &Path, id: &str, ground: &Path) -> Result<(), XtaskError> {
    let of_ground = fingerprint(ground)?;
    let mut command = Command::new(program);
    command.arg("identity").arg("--identity").arg(agent).args(["--trust", &of_ground]);
    let output = command.output().map_err(XtaskError::file(program))?;
    if !output.status.success() {
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        return Err(XtaskError::Other(format!("the agent's identity could not be made: {said}")));
    }
    trust(ground, &fingerprint(agent)?, id)
}

/// The ground makes its identity when it starts.
fn fingerprint(identity: &Path) -> Result<String, XtaskError> {
    let file = identity.join("fingerprint");
    let read =
        || std::fs::read_to_string(&file).ok().map(|text| text.trim().to_owned()).filter(|text| !text.is_empty());
    wait_until(START, read).ok_or_else(|| XtaskError::Other(format!("{} has not appeared", file.display())))
}

fn trust(identity: &Path, fingerprint: &str, name: &str) -> Result<(), XtaskError> {
    let file = identity.join("peers");
    let mut peers = std::fs::read_to_string(&file).unwrap_or_default();
    if peers.contains(fingerprint) {
        return Ok(());
    }
    if !peers.is_empty() && !peers.ends_with('\n') {
        peers.push('\n');
    }
    peers.push_str(&format!("{fingerprint} {name}\n"));
    std::fs::write(&file, peers).map_err(XtaskError::file(&file))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_are_found_in_what_the_programs_say() {
        let line = "Plumbline is at http://127.0.0.1:4747/";
        assert_eq!(address_after(line, "http://").unwrap().port(), 4747);
        assert_eq!(address_after("agents connect to udp://[::1]:4748", "udp://").unwrap().port(), 4748);
        assert!(address_after(line, "https://").is_none());
    }
}
