//! GIVEN the simulator behind ports that speak each device's protocol WHEN the agent flies it through the real drivers THEN it
//! steps and lands as without wires, devices unplugged do what the failsafe table says, and a killed agent's motors stand.

use std::path::Path;
use std::time::{Duration, Instant};

use plumbline_agent::sim::Scenario;
use plumbline_devices::scheduling;
use plumbline_proto::v1;
use plumbline_support::calibrations::accelerometer;
use plumbline_wires::{Drive, PULSES_US, Plug, WireRig, Wiring};

use crate::ports::{PORTS_LATE, Ports, WIRE_FLIGHTS};
use crate::{Agent, KEPT, PATIENCE};

/// The everyday altitude, step and landing, with time for ports to open and ESCs to arm.
pub const SCENARIO: &str = r#"
name = "wires"
seed = 1
duration_s = 46
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

/// Height 2 half a metre too high, from holding 0.5 m to the landing.
const ATTACK: &str = r#"
[[attack]]
sensor = "height"
instance = 2
kind = "bias"
start_s = 16
duration_s = 22
magnitude = 0.5
"#;

/// Held altitude, m: what the bench's flights without wires keep, and 2 cm for laser and clock of the wires.
pub const HOLDING_M: f64 = 0.05;
/// What the motors' own time-out promises.
const MOTORS_STAND: Duration = Duration::from_millis(100);
/// Silence after which an IMU counts as lost.
const IMU_SILENT: Duration = Duration::from_millis(80);

/// The rig of `scenario`. As in its own program, its devices keep their time under any load: the thread that starts it hands its
/// priority down, and is none that other tests run on.
pub fn rig(scenario: &str, folder: &Path, wiring: &Wiring) -> WireRig {
    let start = || {
        scheduling::ask_for_real_time(scheduling::FLIGHT);
        WireRig::start(&Scenario::from_toml(scenario).unwrap(), folder, wiring).unwrap()
    };
    std::thread::scope(|scope| scope.spawn(start).join()).unwrap()
}

pub struct Flown {
    pub rig: WireRig,
    pub agent: Agent,
}

impl Flown {
    fn start(attacks: &str) -> Self {
        Self::on(&Wiring::usual(), SCENARIO, attacks)
    }

    /// The script of `scenario` flown through the devices of `wiring`.
    pub fn on(wiring: &Wiring, scenario: &str, attacks: &str) -> Self {
        Self::within(tempfile::tempdir().unwrap(), wiring, scenario, attacks)
    }

    /// The same, in a folder with something in it.
    fn within(folder: tempfile::TempDir, wiring: &Wiring, scenario: &str, attacks: &str) -> Self {
        let rig = rig(scenario, folder.path(), wiring);
        let agent = Agent::start(folder, "hardware", &rig.configuration(), scenario, attacks);
        Self { rig, agent }
    }

    pub fn wait(&mut self, what: &str, done: impl Fn(&Self) -> bool) {
        let begun = Instant::now();
        while !done(self) {
            let (late, ended) = (begun.elapsed() > PATIENCE, self.agent.ended());
            assert!(!late && ended.is_none(), "{what}: {ended:?}\n{}\n{}", self.agent.said(), self.course());
            std::thread::sleep(Duration::from_millis(20));
        }
    }

    /// Largest distance from `altitude_m` in the last two seconds.
    pub fn off(&self, altitude_m: f64) -> f64 {
        let truths = self.rig.truths();
        if truths.len() < 400 {
            return f64::INFINITY;
        }
        let last = truths.iter().rev().take(400);
        last.map(|(_, truth)| (truth.position_enu_m.z - altitude_m).abs()).fold(0.0, f64::max)
    }

    /// Altitude and first pulse, once a second.
    pub fn course(&self) -> String {
        let pulses = self.rig.pulses();
        let seconds = self.rig.truths();
        let altitudes: Vec<String> =
            seconds.iter().step_by(200).map(|(_, truth)| format!("{:.2}", truth.position_enu_m.z)).collect();
        let highest = pulses.iter().map(|(_, widths)| widths[0]).fold(0.0, f64::max);
        format!("{} pulses, highest {highest:.0} µs; altitude {}", pulses.len(), altitudes.join(" "))
    }

    /// Until it has landed, by its script or as the signal asked, and the agent has ended.
    pub fn land(&mut self) {
        assert!(self.agent.end().success(), "{}", self.agent.said());
        let still = self.rig.pulses().last().unwrap().1;
        assert!(still.iter().all(|us| (us - PULSES_US[0]).abs() < 1.0), "{still:?}");
    }

    /// Until every motor stands, for as long as anybody waits; how long after `from`.
    pub fn stands(&self, from: Instant) -> Duration {
        let stands = |widths: &[f64; 4]| widths.iter().all(|us| *us < PULSES_US[0] + 3.0);
        loop {
            if let Some((at, _)) = self.rig.pulses().last().filter(|(_, widths)| stands(widths)) {
                return at.saturating_duration_since(from);
            }
            assert!(from.elapsed() < PATIENCE, "nobody stopped the motors: {}", self.agent.said());
            std::thread::sleep(Duration::from_millis(1));
        }
    }

    pub fn hold(&mut self, altitude_m: f64) {
        self.wait(&format!("holds {altitude_m} m"), |flown| flown.off(altitude_m) < HOLDING_M);
    }
}

/// Flies `test`. Its ports are pseudo terminals, which the kernel's workers serve after everything else on a busy machine: one that
/// fails while another such port was late is none, and is flown again.
pub fn in_time(test: impl Fn()) {
    let watch = || {
        let ports = Ports::watch().unwrap();
        move || ports.worst()
    };
    unless_late("a port beside the wire rig's", watch, test);
}

/// Flies `test`. One that fails while `what` was late is none, and is flown again; `watch` begins to look at it, and what it gives says
/// how late it was at most.
pub fn unless_late<Late: FnOnce() -> Duration>(what: &str, watch: impl Fn() -> Late, test: impl Fn()) {
    for flight in 1.. {
        let late = watch();
        let failed = std::panic::catch_unwind(std::panic::AssertUnwindSafe(&test)).err();
        let late = late();
        match failed {
            None => return,
            Some(failure) if late < PORTS_LATE || flight == WIRE_FLIGHTS => std::panic::resume_unwind(failure),
            Some(_) => eprintln!("{what} was {} ms late: flown again", late.as_millis()),
        }
    }
}

#[test]
fn altitude_steps_through_the_drivers_with_a_height_unplugged_in_flight() {
    in_time(|| {
        // It flies with a calibration of before, which changes nothing.
        let folder = tempfile::tempdir().unwrap();
        keep(&folder, "accelerometer-1.json", &accelerometer(1, [1.0; 3]).to_value().to_string());
        let mut flown = Flown::within(folder, &Wiring::usual(), SCENARIO, "");
        flown.hold(0.5);
        flown.rig.plug("height1", Plug::Out);
        flown.wait("height1 lost", |flown| flown.agent.lost("height1"));
        // Longer than the second between two states of a device.
        std::thread::sleep(Duration::from_millis(1500));
        assert!(flown.off(0.5) < 2.0 * HOLDING_M, "two heights are left: {} m off", flown.off(0.5));
        flown.rig.plug("height1", Plug::In);
        flown.wait("height1 is back", |flown| flown.agent.ups() == 9);
        flown.hold(0.8);
        let truths = flown.rig.truths();
        let held: Vec<f64> = truths.iter().rev().take(400).map(|(_, truth)| truth.position_enu_m.z).collect();
        let mean = held.iter().sum::<f64>() / held.len() as f64;
        let spread = (held.iter().map(|z| (z - mean).powi(2)).sum::<f64>() / held.len() as f64).sqrt();
        println!("holds 0.8 m at {mean:.4} m ± {spread:.4} m through the wires");
        flown.agent.said().lines().filter(|line| line.contains("device")).for_each(|line| println!("{line}"));
        flown.land();
        let description: v1::Description = flown.agent.recorded("/description").pop().unwrap();
        let used: Vec<_> = description.calibrations.iter().map(|used| (used.kind.as_str(), used.imu)).collect();
        assert_eq!(used, [("accelerometer", 1)]);
        // The flight file tells of it: as an event, and in the state of that device, the fifth.
        flown.agent.assert_told(&["height1 lost", "height1 gives readings"]);
        let states: Vec<v1::DeviceState> = flown.agent.recorded("/device/5");
        assert!(states.iter().all(|state| state.name == "height1" && state.port.ends_with("/height1")), "{states:?}");
        let (first, last) = (states.first().unwrap(), states.last().unwrap());
        assert!(first.up && last.up && last.opened > first.opened, "{states:?}");
        assert!(states.iter().any(|state| !state.up && !state.reason.is_empty()), "{states:?}");
        assert!((last.rate_hz - 10.0).abs() < 3.0 && last.age_s.is_some_and(|age_s| age_s < 1.0), "{last:?}");
    });
}

fn keep(folder: &tempfile::TempDir, name: &str, text: &str) {
    std::fs::create_dir_all(folder.path().join(KEPT)).unwrap();
    std::fs::write(folder.path().join(KEPT).join(name), text).unwrap();
}

#[test]
fn with_a_calibration_that_cannot_be_read_nothing_is_started() {
    let folder = tempfile::tempdir().unwrap();
    keep(&folder, "gyroscope-2.json", "{\"schema\": 1");
    let rig = rig(SCENARIO, folder.path(), &Wiring::usual());
    let mut agent = Agent::start(folder, "hardware", &rig.configuration(), SCENARIO, "");
    assert!(!agent.end().success());
    assert!(agent.said().contains("gyroscope-2.json") && !agent.said().contains("device up"), "{}", agent.said());
}

#[test]
fn one_of_three_heights_attacked_through_the_drivers_moves_nothing() {
    in_time(|| {
        let mut flown = Flown::start(ATTACK);
        flown.hold(0.5);
        flown.hold(0.8);
        std::thread::sleep(Duration::from_secs(3));
        // Half a metre of one height in three would be 17 cm of their mean.
        assert!(flown.off(0.8) < HOLDING_M, "{} m off", flown.off(0.8));
        println!("holds 0.8 m within {:.4} m with height 2 attacked", flown.off(0.8));
        flown.agent.signal(libc::SIGINT);
        flown.land();
        let attacks: Vec<v1::AttackState> = flown.agent.recorded("/attacks");
        let altered = attacks.iter().flat_map(|state| &state.attacks).map(|attack| attack.altered_samples).max();
        assert!(altered.is_some_and(|samples| samples > 100), "{altered:?} samples altered");
    });
}

/// By a PCA9685, and by the kernel's PWM.
fn each_drive(test: impl Fn(&Wiring)) {
    for drive in [Drive::Pca9685, Drive::Sysfs] {
        in_time(|| test(&Wiring { drive, ..Wiring::usual() }));
    }
}

#[test]
fn the_motors_of_a_killed_agent_stand_within_their_time_out() {
    each_drive(|wiring| {
        let mut flown = Flown::on(wiring, SCENARIO, "");
        flown.hold(0.5);
        let turning = |widths: &[f64; 4]| widths.iter().all(|us| *us > PULSES_US[0] + 50.0);
        assert!(turning(&flown.rig.pulses().last().unwrap().1));
        let killed = Instant::now();
        flown.agent.signal(libc::SIGKILL);
        let took = flown.stands(killed);
        println!("motors stand {:.1} ms after SIGKILL, by {:?}", took.as_secs_f64() * 1e3, wiring.drive);
        assert!(took < MOTORS_STAND, "{took:?}");
        if wiring.drive == Drive::Sysfs {
            assert_eq!(flown.rig.pwm(), (0, 2500.0), "nothing refused, 400 Hz");
        }
    });
}

#[test]
fn an_agent_that_stops_costs_its_motors_and_they_stay_cut() {
    in_time(|| {
        let mut flown = Flown::start("");
        flown.hold(0.5);
        let stopped = Instant::now();
        flown.agent.signal(libc::SIGSTOP);
        let took = flown.stands(stopped);
        println!("motors stand {:.1} ms after SIGSTOP", took.as_secs_f64() * 1e3);
        assert!(took < MOTORS_STAND, "{took:?}");
        std::thread::sleep(Duration::from_millis(300));
        flown.agent.signal(libc::SIGCONT);
        std::thread::sleep(Duration::from_secs(1));
        assert_eq!(flown.stands(stopped), took, "no pulse since");
        flown.agent.signal(libc::SIGINT);
        flown.land();
        flown.agent.assert_told(&["flight thread silent"]);
    });
}

#[test]
fn one_device_of_each_kind_is_lost_in_flight_and_comes_back_and_without_any_height_it_descends() {
    in_time(|| {
        let mut flown = Flown::start("");
        flown.hold(0.5);
        // One that answers, one that talks and brings the barometer, a beam, the voltage.
        let lost = ["imu2", "imu4", "height3", "battery"];
        for (name, plug) in lost.into_iter().zip([Plug::Out, Plug::Hanging, Plug::Hanging, Plug::Out]) {
            flown.rig.plug(name, plug);
        }
        flown.wait("four lost", |flown| lost.iter().all(|name| flown.agent.lost(name)));
        assert!(flown.off(0.5) < 2.0 * HOLDING_M, "{} m off", flown.off(0.5));
        lost.iter().for_each(|name| flown.rig.plug(name, Plug::In));
        flown.wait("four back", |flown| flown.agent.ups() == 8 + lost.len());
        flown.hold(0.8);
        let heights = ["height1", "height2", "height3"];
        heights.iter().for_each(|name| flown.rig.plug(name, Plug::Out));
        flown.stands(Instant::now());
        flown.agent.signal(libc::SIGINT);
        flown.land();
        flown.agent.assert_told(&["no height any more", "height1 lost", "height2 lost"]);
        for name in lost {
            flown.agent.assert_told(&[&format!("{name} lost"), &format!("{name} gives readings")]);
        }
        let lowest = flown.rig.truths().last().unwrap().1.position_enu_m.z;
        assert!(lowest < 0.4, "it hangs on its strings again, at {lowest:.2} m");
    });
}

#[test]
fn without_any_imu_the_motors_are_cut() {
    in_time(|| {
        let mut flown = Flown::start("");
        flown.hold(0.5);
        let unplugged = Instant::now();
        ["imu1", "imu2", "imu3", "imu4"].iter().for_each(|name| flown.rig.plug(name, Plug::Out));
        let took = flown.stands(unplugged);
        println!("motors stand {:.1} ms after the last IMU went", took.as_secs_f64() * 1e3);
        // On ports as late as they may be, and with the time that motors have to stand.
        assert!(took < IMU_SILENT + PORTS_LATE + MOTORS_STAND, "{took:?}");
        flown.agent.signal(libc::SIGINT);
        flown.land();
        flown.agent.assert_told(&["imu1 lost", "imu4 lost", "no fresh IMU sample"]);
    });
}

#[test]
fn motors_that_do_not_answer_for_a_moment_fly_on_and_longer_they_stop_once_they_do() {
    each_drive(|wiring| {
        let mut flown = Flown::on(wiring, SCENARIO, "");
        flown.hold(0.5);
        flown.rig.plug("motors", Plug::Out);
        std::thread::sleep(Duration::from_millis(20));
        flown.rig.plug("motors", Plug::In);
        std::thread::sleep(Duration::from_millis(500));
        assert!(flown.off(0.5) < 2.0 * HOLDING_M, "{} m off", flown.off(0.5));
        flown.rig.plug("motors", Plug::Out);
        assert!(!flown.agent.end().success(), "{}", flown.agent.said());
        flown.rig.plug("motors", Plug::In);
        flown.stands(Instant::now());
        flown.agent.assert_told(&["the vehicle can be flown no longer"]);
    });
}
