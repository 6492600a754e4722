//! The wire rig: the simulator behind pseudo-terminals and a socket that speak every device's own protocol, byte for byte.
//!
//! The agent flies it with `--vehicle hardware` through the drivers that it would fly a real one with, in real time. Devices
//! have clocks that drift, send their frames in pieces, damage some, can be unplugged, plugged in again, or made to hang.
//! The emulated PWM chip goes on with its last pulses for ever, as a real one does.

#![cfg_attr(test, allow(clippy::unwrap_used, clippy::expect_used, clippy::panic))]

mod bus;
mod speak;
mod uart;

use std::collections::VecDeque;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicU8, Ordering};
use std::sync::mpsc::{Sender, channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use nalgebra::Rotation3;
use plumbline_core::sensor::{BarometerSample, HeightSample, ImuSample, SensorFrame};
use plumbline_core::types::{MotorCommand, ROTORS};
use plumbline_core::vehicle::{Truth, Vehicle as _};
use plumbline_devices::reading::ImuReading;
use plumbline_sim::{Scenario, SimVehicle};

use bus::Chips;
pub use speak::Speaks;

/// Ticks of truth, pulses and samples that are kept: five minutes at 200 Hz; the oldest give way.
const KEPT: usize = 60_000;

/// Pulses of command 0 and 1 at the emulated ESCs, µs.
pub const PULSES_US: [f64; 2] = [1000.0, 2000.0];

/// Whether a device answers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub enum Plug {
    /// It does.
    In = 0,
    /// Its port is gone.
    Out = 1,
    /// Its port is there, and silent.
    Hanging = 2,
}

/// A device of the rig.
#[derive(Debug, Clone)]
pub struct Device {
    /// Name in the configuration, and of its port's link in the folder.
    pub name: String,
    /// Its protocol.
    pub speaks: Speaks,
    /// Which IMU or height it is, from 0.
    pub index: usize,
    plug: Arc<AtomicU8>,
}

/// What one of the simulated sensors measured, and the truth beside it.
#[derive(Debug, Clone, Copy)]
struct Measured {
    imu: Option<ImuSample>,
    height: Option<HeightSample>,
    barometer: Option<BarometerSample>,
    truth: Truth,
}

/// A sample of an IMU as its device sent it, whole and undamaged.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sent {
    /// Which IMU, from 0.
    pub imu: usize,
    /// What a host reads of it, in the device's own axes.
    pub reading: ImuReading,
}

/// What happened on the wires, and when; the last [`KEPT`].
type Kept<T> = Arc<Mutex<VecDeque<(Instant, T)>>>;
/// Pulses as they were set.
type PulseLog = Kept<[f64; ROTORS]>;

/// The rig, running. Ends when it is dropped.
#[derive(Debug)]
pub struct WireRig {
    folder: PathBuf,
    scenario: Scenario,
    devices: Vec<Device>,
    chips: Chips,
    truths: Kept<Truth>,
    sent: Kept<Sent>,
    stop: Arc<AtomicBool>,
    threads: Vec<JoinHandle<()>>,
}

impl WireRig {
    /// Starts `scenario` behind ports in `folder`: three BNO055 and a Mongoose (the fourth IMU, and the barometer), two
    /// Hokuyo and a TFmini, a PCA9685 and an INA226.
    ///
    /// # Errors
    /// A port or a thread cannot be made, or the scenario is none.
    pub fn start(scenario: &Scenario, folder: &Path) -> io::Result<Self> {
        use Speaks::{Bno055, Hokuyo, Mongoose, Tfmini};
        let device = |(name, speaks, index): (&str, Speaks, usize)| Device {
            name: name.to_owned(),
            speaks,
            index,
            plug: plugged_in(),
        };
        let devices: Vec<Device> = [
            ("imu1", Bno055, 0),
            ("imu2", Bno055, 1),
            ("imu3", Bno055, 2),
            ("imu4", Mongoose, 3),
            ("height1", Hokuyo, 0),
            ("height2", Hokuyo, 1),
            ("height3", Tfmini, 2),
        ]
        .into_iter()
        .map(device)
        .collect();
        let stop = Arc::new(AtomicBool::new(false));
        let (motors, battery) = (plugged_in(), plugged_in());
        let chips = Chips { pulses: PulseLog::default(), voltage: Arc::default(), motors, battery };
        let mut threads = vec![bus::serve(&folder.join("bus"), &chips, stop.clone())?];
        let (mut outlets, sent) = (Vec::new(), Kept::default());
        for device in &devices {
            let (outlet, inlet) = channel();
            let emulated = speak::Emulated::new(device, scenario, folder, sent.clone());
            let (stop, plug) = (stop.clone(), device.plug.clone());
            let run = move || emulated.run(&inlet, &plug, &stop);
            threads.push(std::thread::Builder::new().name(device.name.clone()).spawn(run)?);
            outlets.push((device.clone(), outlet));
        }
        let vehicle = SimVehicle::new(scenario).map_err(|error| io::Error::other(error.to_string()))?;
        let truths = Kept::default();
        let world = World { vehicle, outlets, chips: chips.clone(), truths: truths.clone(), tick_s: scenario.tick_s() };
        let until = stop.clone();
        threads.push(std::thread::Builder::new().name("world".into()).spawn(move || world.run(&until))?);
        let (folder, scenario) = (folder.to_owned(), scenario.clone());
        Ok(Self { folder, scenario, devices, chips, truths, sent, stop, threads })
    }

    /// The agent's configuration for it: devices, motors, and attacks allowed, as nothing can fall.
    pub fn configuration(&self) -> String {
        let mut text = "[rig.hanging_strings]\n\n[attacks]\nenabled = true\n".to_owned();
        let folder = self.folder.display();
        for Device { name, speaks, index, .. } in &self.devices {
            let (driver, rate_hz, sensors) = match speaks {
                Speaks::Bno055 => ("bno055", 100, format!("\"imu {}\"", index + 1)),
                Speaks::Mongoose => ("mongoose", 100, format!("\"imu {}\", \"barometer 1\"", index + 1)),
                Speaks::Hokuyo => ("hokuyo", 10, format!("\"height {}\"", index + 1)),
                Speaks::Tfmini => ("tfmini", 10, format!("\"height {}\"", index + 1)),
            };
            let (position, mounting) = speak::place(*speaks, *index, &self.scenario);
            text += &format!(
                "\n[[device]]\nname = \"{name}\"\ndriver = \"{driver}\"\nport = \"{folder}/{name}\"\nsensors = [{sensors}]\n\
                 rate_hz = {rate_hz}\nposition_flu_m = {:?}\nmounting_rpy_rad = {:?}\n",
                position.as_slice(),
                mounting.as_slice()
            );
        }
        text + &format!(
            "\n[[device]]\nname = \"battery\"\ndriver = \"ina226\"\nport = \"unix:{folder}/bus\"\naddress = 65\n\n\
             [motors]\ndriver = \"pca9685\"\nport = \"unix:{folder}/bus\"\narming_s = 1.0\n"
        )
    }

    /// Unplugs the device `name`, plugs it in, lets it hang; nothing where there is none. Chips of the bus, `motors` and
    /// `battery`, answer or do not.
    pub fn plug(&self, name: &str, plug: Plug) {
        let ports = self.devices.iter().map(|device| (device.name.as_str(), &device.plug));
        let chips = [("motors", &self.chips.motors), ("battery", &self.chips.battery)];
        let found = ports.chain(chips).find(|(known, _)| *known == name);
        found.into_iter().for_each(|(_, of)| of.store(plug as u8, Ordering::Release));
    }

    /// The pulses set, and when: those of the last minutes.
    pub fn pulses(&self) -> Vec<(Instant, [f64; ROTORS])> {
        lock(&self.chips.pulses).iter().copied().collect()
    }

    /// The truth of every tick of the last minutes, and when it was.
    pub fn truths(&self) -> Vec<(Instant, Truth)> {
        lock(&self.truths).iter().copied().collect()
    }

    /// The samples that IMUs sent, and when the last byte of each went out: those of the last minutes.
    pub fn sent(&self) -> Vec<(Instant, Sent)> {
        lock(&self.sent).iter().copied().collect()
    }
}

impl Drop for WireRig {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Release);
        for thread in self.threads.drain(..) {
            let _ = thread.join();
        }
    }
}

/// Adds what happens now; beyond [`KEPT`] the oldest gives way.
fn keep<T>(all: &Mutex<VecDeque<(Instant, T)>>, newest: T) {
    let mut all = lock(all);
    if all.len() >= KEPT {
        all.pop_front();
    }
    all.push_back((Instant::now(), newest));
}

fn plugged_in() -> Arc<AtomicU8> {
    Arc::new(AtomicU8::new(Plug::In as u8))
}

fn lock<T>(mutex: &Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The simulator in real time.
struct World {
    vehicle: SimVehicle,
    outlets: Vec<(Device, Sender<Measured>)>,
    chips: Chips,
    truths: Kept<Truth>,
    tick_s: f64,
}

impl World {
    fn run(mut self, stop: &AtomicBool) {
        let begun = Instant::now();
        let mut ticks = 0.0;
        while !stop.load(Ordering::Acquire) {
            let due = begun + Duration::from_secs_f64(ticks * self.tick_s);
            std::thread::sleep(due.saturating_duration_since(Instant::now()));
            ticks += 1.0;
            let [still, full] = PULSES_US;
            let widths = lock(&self.chips.pulses).back().map_or([still; ROTORS], |(_, widths)| *widths);
            // An ESC stands still a little above the pulse that says so.
            let throttle =
                widths.map(|us| if us < still + 3.0 { 0.0 } else { ((us - still) / (full - still)).min(1.0) });
            let moved = self.vehicle.actuate(&MotorCommand { throttle }).and_then(|_| self.vehicle.sense());
            let (Ok(frame), Some(truth)) = (moved, self.vehicle.truth()) else { return };
            self.hand_out(&frame, truth);
        }
    }

    fn hand_out(&self, frame: &SensorFrame, truth: Truth) {
        keep(&self.truths, truth);
        if let Some(volts) = frame.battery_v {
            *lock(&self.chips.voltage) = volts;
        }
        for (device, outlet) in &self.outlets {
            let at = |is: bool| if is { device.index } else { usize::MAX };
            let looks_down = matches!(device.speaks, Speaks::Hokuyo | Speaks::Tfmini);
            let measured = Measured {
                imu: frame.imus.get(at(!looks_down)).copied().flatten(),
                height: frame.heights.get(at(looks_down)).copied().flatten(),
                barometer: frame.barometers.first().copied().flatten(),
                truth,
            };
            if measured.imu.is_some() || measured.height.is_some() {
                let _ = outlet.send(measured);
            }
        }
    }
}

/// A device's axes in the body.
fn body_from_sensor(rpy: &nalgebra::Vector3<f64>) -> Rotation3<f64> {
    Rotation3::from_euler_angles(rpy.x, rpy.y, rpy.z)
}
