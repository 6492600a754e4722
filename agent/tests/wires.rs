//! GIVEN the simulator behind ports that speak each device's protocol WHEN the agent flies it through the real drivers THEN it
//! steps and lands as without wires, a device unplugged comes back, and a killed agent's motors stand.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::path::Path;
use std::process::{Child, Command};
use std::sync::Mutex;
use std::time::{Duration, Instant};

use plumbline_agent::sim::Scenario;
use plumbline_wires::{PULSES_US, Plug, WireRig};

/// The everyday altitude, step and landing, with time for ports to open and ESCs to arm.
const SCENARIO: &str = r#"
name = "wires"
seed = 1
duration_s = 60
airframe = "iris"
[rig.hanging_strings]
[suite]
preset = "string_rig"
[battery]
charge = 0.95
[[script]]
at_s = 6
do = "arm"
[[script]]
at_s = 7
do = "mode"
mode = "altitude_hold"
[[script]]
at_s = 8
do = "setpoint"
altitude_m = 0.5
[[script]]
at_s = 24
do = "setpoint"
altitude_m = 0.8
[[script]]
at_s = 38
do = "mode"
mode = "land"
"#;

/// Held altitude, m: what the bench's flights without wires keep, and 2 cm for laser and clock of the wires.
const HOLDING_M: f64 = 0.05;
/// Longest wait for anything, on a machine that compiles beside us.
const PATIENCE: Duration = Duration::from_secs(90);
/// What the motors' own time-out promises.
const MOTORS_STAND: Duration = Duration::from_millis(100);
/// One flight at a time: each needs the processor at its own time.
static ALONE: Mutex<()> = Mutex::new(());

struct Flown {
    rig: WireRig,
    agent: Child,
    folder: tempfile::TempDir,
}

impl Flown {
    fn start() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        std::fs::write(at("wires.toml"), SCENARIO).unwrap();
        let rig = WireRig::start(&Scenario::from_toml(SCENARIO).unwrap(), folder.path()).unwrap();
        std::fs::write(at("agent.toml"), rig.configuration()).unwrap();
        let agent = Command::new(env!("CARGO_BIN_EXE_plumbline-agent"))
            .args(["--vehicle", "hardware", "--ground", "none", "--script", "--config"])
            .arg(at("agent.toml"))
            .arg("--scenario")
            .arg(at("wires.toml"))
            .arg("--log")
            .arg(at("log"))
            .arg("--identity")
            .arg(at("identity"))
            .stderr(std::fs::File::create(at("said")).unwrap())
            .spawn()
            .unwrap();
        Self { rig, agent, folder }
    }

    fn said(&self) -> String {
        said(self.folder.path())
    }

    fn wait(&mut self, what: &str, mut done: impl FnMut(&mut Self) -> bool) {
        let begun = Instant::now();
        while !done(self) {
            let ended = self.agent.try_wait().unwrap();
            let late = begun.elapsed() > PATIENCE;
            assert!(!late && ended.is_none(), "{what}: {ended:?}\n{}\n{}", self.said(), self.course());
            std::thread::sleep(Duration::from_millis(20));
        }
    }

    /// Largest distance from `altitude_m` in the last two seconds.
    fn off(&self, altitude_m: f64) -> f64 {
        let truths = self.rig.truths();
        if truths.len() < 400 {
            return f64::INFINITY;
        }
        let last = truths.iter().rev().take(400);
        last.map(|truth| (truth.position_enu_m.z - altitude_m).abs()).fold(0.0, f64::max)
    }

    /// Altitude and first pulse, once a second.
    fn course(&self) -> String {
        let pulses = self.rig.pulses();
        let seconds = self.rig.truths();
        let altitudes: Vec<String> =
            seconds.iter().step_by(200).map(|truth| format!("{:.2}", truth.position_enu_m.z)).collect();
        let highest = pulses.iter().map(|(_, widths)| widths[0]).fold(0.0, f64::max);
        format!("{} pulses, highest {highest:.0} µs; altitude {}", pulses.len(), altitudes.join(" "))
    }

    fn hold(&mut self, altitude_m: f64) {
        self.wait(&format!("holds {altitude_m} m"), |flown| flown.off(altitude_m) < HOLDING_M);
    }
}

fn said(folder: &Path) -> String {
    std::fs::read_to_string(folder.join("said")).unwrap_or_default()
}

impl Drop for Flown {
    fn drop(&mut self) {
        let _ = self.agent.kill();
        let _ = self.agent.wait();
    }
}

#[test]
fn altitude_steps_through_the_drivers_with_a_height_unplugged_in_flight() {
    let _alone = ALONE.lock();
    let mut flown = Flown::start();
    flown.hold(0.5);
    flown.rig.plug("height1", Plug::Out);
    flown.wait("height1 lost", |flown| flown.said().contains("device lost"));
    assert!(flown.off(0.5) < 2.0 * HOLDING_M, "two heights are left: {} m off", flown.off(0.5));
    flown.rig.plug("height1", Plug::In);
    let ups = |flown: &Flown| flown.said().matches("device up").count();
    flown.wait("height1 is back", |flown| ups(flown) == 9);
    flown.hold(0.8);
    let truths = flown.rig.truths();
    let held: Vec<f64> = truths.iter().rev().take(400).map(|truth| truth.position_enu_m.z).collect();
    let mean = held.iter().sum::<f64>() / held.len() as f64;
    let spread = (held.iter().map(|z| (z - mean).powi(2)).sum::<f64>() / held.len() as f64).sqrt();
    println!("holds 0.8 m at {mean:.4} m ± {spread:.4} m through the wires");
    flown.said().lines().filter(|line| line.contains("device")).for_each(|line| println!("{line}"));
    // Lands by its script, and stands still.
    let begun = Instant::now();
    while flown.agent.try_wait().unwrap().is_none() {
        assert!(begun.elapsed() < PATIENCE, "the script's end: {}", flown.said());
        std::thread::sleep(Duration::from_millis(50));
    }
    assert!(flown.agent.wait().unwrap().success(), "{}", flown.said());
    let still = flown.rig.pulses().last().unwrap().1;
    assert!(still.iter().all(|us| (us - PULSES_US[0]).abs() < 1.0), "{still:?}");
}

#[test]
fn the_motors_of_a_killed_agent_stand_within_their_time_out() {
    let _alone = ALONE.lock();
    let mut flown = Flown::start();
    flown.hold(0.5);
    let turning = |widths: &[f64; 4]| widths.iter().all(|us| *us > PULSES_US[0] + 50.0);
    assert!(turning(&flown.rig.pulses().last().unwrap().1));
    let killed = Instant::now();
    flown.agent.kill().unwrap();
    let stands = |flown: &Flown| {
        flown.rig.pulses().last().is_some_and(|(_, widths)| widths.iter().all(|us| *us < PULSES_US[0] + 3.0))
    };
    while !stands(&flown) {
        assert!(killed.elapsed() < PATIENCE, "nobody stopped the motors");
        std::thread::sleep(Duration::from_millis(1));
    }
    let took = flown.rig.pulses().last().unwrap().0 - killed;
    println!("motors stand {:.1} ms after SIGKILL", took.as_secs_f64() * 1e3);
    assert!(took < MOTORS_STAND, "{took:?}");
}
