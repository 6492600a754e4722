//! The wire rig: the simulator behind pseudo-terminals and a socket that speak every device's own protocol, byte for byte.
//!
//! The agent flies it with `--vehicle hardware` through the drivers that it would fly a real one with, in real time. Devices
//! have clocks that drift, send their frames in pieces, damage some, can be unplugged, plugged in again, or made to hang.
//! Whatever gives the pulses goes on with its last ones for ever, as real chips do.
//!
//! - [`wiring`]: which devices there are, where, and the configuration that fits.
//! - [`speak`]: those that talk on a UART. [`chips`], [`bus`]: those that answer by registers. [`capture`]: motion capture.
//! - [`pwm`]: the kernel's PWM.

#![cfg_attr(test, allow(clippy::unwrap_used, clippy::expect_used, clippy::panic))]

mod bus;
mod capture;
mod chips;
mod pwm;
mod speak;
mod uart;
mod wiring;

use std::collections::VecDeque;
use std::io;
use std::net::{Ipv4Addr, UdpSocket};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicU8, Ordering};
use std::sync::mpsc::{Sender, channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use nalgebra::Rotation3;
use plumbline_core::sensor::{HeightSample, ImuSample, PairVisitor, Registered, SensorFrame};
use plumbline_core::types::{MotorCommand, ROTORS};
use plumbline_core::vehicle::{Truth, Vehicle as _};
use plumbline_devices::reading::ImuReading;
use plumbline_proto::ids::SensorId;
use plumbline_sim::{Scenario, SimVehicle};

use bus::Placed;
use capture::Capture;
use chips::{Bmp280, Bno055, Bno055OnBus, Chip, Icm, Inertial, Ms5611, Pwm, Voltmeter};
pub use wiring::{Attached, Drive, Speaks, Wire, Wiring};

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

/// What the simulated sensors measured in a tick, and the truth beside it.
#[derive(Debug, Clone, Copy)]
struct Measured {
    frame: SensorFrame,
    truth: Truth,
}

impl Measured {
    fn imu(&self, index: usize) -> Option<ImuSample> {
        self.frame.imus.get(index).copied().flatten()
    }

    fn height(&self, index: usize) -> Option<HeightSample> {
        self.frame.heights.get(index).copied().flatten()
    }

    /// Has it a new sample of one of these sensors?
    fn has(&self, sensors: &[SensorId]) -> bool {
        struct Look<'a>(&'a [SensorId], bool);
        impl PairVisitor for Look<'_> {
            fn pair<S: Registered>(&mut self, sensor: SensorId, _: &S, _: Option<&S>) {
                self.1 |= self.0.contains(&sensor);
            }
        }
        let mut look = Look(sensors, false);
        self.frame.visit_beside(&self.frame, &mut look);
        look.1
    }
}

/// What a chip that is asked finds: the last tick that had a new sample of its sensor.
type Latest = Arc<Mutex<Option<Measured>>>;

/// A sample of an IMU as its device sent it, whole and undamaged.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sent {
    /// Which IMU, from 0.
    pub imu: usize,
    /// What a host reads of it, in the device's own axes.
    pub reading: ImuReading,
}

/// A scan as its scanner sent it, whole and undamaged.
#[derive(Debug, Clone, PartialEq)]
pub struct SentScan {
    /// Which height, from 0.
    pub height: usize,
    /// The scanner's own clock, ms.
    pub stamp_ms: u32,
    /// mm, from the first step on.
    pub ranges_mm: Box<[u16]>,
}

/// What happened on the wires, and when; the last [`KEPT`].
type Kept<T> = Arc<Mutex<VecDeque<(Instant, T)>>>;
/// Pulses as they were set.
type PulseLog = Kept<[f64; ROTORS]>;

/// A device that is attached, its plug, and the ports of its datagrams: the agent's own and the server's.
#[derive(Debug, Clone)]
struct Device {
    attached: Attached,
    plug: Arc<AtomicU8>,
    ports: [u16; 2],
}

/// The rig, running. Ends when it is dropped.
#[derive(Debug)]
pub struct WireRig {
    folder: PathBuf,
    scenario: Scenario,
    wiring: Wiring,
    devices: Vec<Device>,
    motors: Arc<AtomicU8>,
    pwm: pwm::Seen,
    pulses: PulseLog,
    truths: Kept<Truth>,
    sent: Kept<Sent>,
    scans: Kept<SentScan>,
    stop: Arc<AtomicBool>,
    threads: Vec<JoinHandle<()>>,
}

impl WireRig {
    /// Starts `scenario`, with whatever `wiring` needs besides, behind ports in `folder` and on the loopback.
    ///
    /// # Errors
    /// A port or a thread cannot be made, or the scenario is none.
    pub fn start(scenario: &Scenario, folder: &Path, wiring: &Wiring) -> io::Result<Self> {
        let scenario = wiring.completed(scenario.clone());
        let (stop, motors, voltage) = (Arc::new(AtomicBool::new(false)), plugged_in(), Arc::<Mutex<f64>>::default());
        let (pulses, sent, truths) = (PulseLog::default(), Kept::default(), Kept::default());
        let scans = Kept::<SentScan>::default();
        let (mut devices, mut outlets, mut chips, mut threads) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
        for attached in &wiring.devices {
            let (plug, mut ports) = (plugged_in(), [0; 2]);
            let inertial = || Inertial {
                index: attached.index(),
                body_from_sensor: body_from_sensor(&attached.place(&scenario)[1]),
                sent: sent.clone(),
            };
            let named = std::thread::Builder::new().name(attached.name.into());
            let (until, plugged) = (stop.clone(), plug.clone());
            let outlet = match attached.wire {
                Wire::Uart => {
                    let (outlet, inlet) = channel();
                    let emulated = speak::Emulated::new(
                        attached,
                        &scenario,
                        folder,
                        inertial(),
                        wiring.record_scans.then(|| scans.clone()),
                    );
                    threads.push(named.spawn(move || emulated.run(&inlet, &plugged, &until))?);
                    Outlet::Queue(outlet)
                }
                Wire::Datagrams => {
                    let (outlet, inlet) = channel();
                    // A port that is free now: the agent's, until it binds it.
                    let own = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0))?.local_addr()?.port();
                    let rate_hz = scenario.suite.mocap_pose.as_ref().map_or(100.0, |sheet| sheet.timing.rate_hz);
                    let server = Capture::new(attached.speaks, own, rate_hz)?;
                    ports = [own, server.port()?];
                    threads.push(named.spawn(move || server.run(&inlet, &plugged, &until))?);
                    Outlet::Queue(outlet)
                }
                Wire::Bus(address) => {
                    let latest = Latest::default();
                    let chip = chip(attached, latest.clone(), inertial(), voltage.clone())?;
                    chips.push(Placed { address, plug: plugged, chip: Mutex::new(chip) });
                    Outlet::Latest(latest)
                }
            };
            outlets.push((attached.ids().collect(), outlet));
            devices.push(Device { attached: *attached, plug, ports });
        }
        let pwm = pwm::Seen::default();
        match wiring.drive {
            Drive::Pca9685 => {
                let chip = Box::new(Pwm::new(pulses.clone()));
                chips.push(Placed { address: wiring::PWM, plug: motors.clone(), chip: Mutex::new(chip) });
            }
            Drive::Sysfs => {
                let chip = folder.join("pwmchip0");
                threads.push(pwm::serve(chip, pulses.clone(), motors.clone(), pwm.clone(), stop.clone())?);
            }
        }
        threads.push(bus::serve(&folder.join("bus"), chips, stop.clone())?);
        let vehicle = SimVehicle::new(&scenario).map_err(|error| io::Error::other(error.to_string()))?;
        let world = World {
            vehicle,
            outlets,
            pulses: pulses.clone(),
            voltage,
            truths: Kept::clone(&truths),
            tick_s: scenario.tick_s(),
        };
        let until = stop.clone();
        threads.push(std::thread::Builder::new().name("world".into()).spawn(move || world.run(&until))?);
        let (folder, wiring) = (folder.to_owned(), wiring.clone());
        Ok(Self { folder, scenario, wiring, devices, motors, pwm, pulses, truths, sent, scans, stop, threads })
    }

    /// What is simulated: the scenario, with whatever the wiring needs besides.
    pub fn scenario(&self) -> &Scenario {
        &self.scenario
    }

    /// The agent's configuration for it: devices, motors, and attacks allowed, as nothing can fall.
    pub fn configuration(&self) -> String {
        let ports: Vec<[u16; 2]> = self.devices.iter().map(|device| device.ports).collect();
        self.wiring.configuration(&self.scenario, &self.folder, &ports)
    }

    /// Unplugs the device `name`, plugs it in, lets it hang; nothing where there is none. What gives the pulses is called
    /// `motors`.
    pub fn plug(&self, name: &str, plug: Plug) {
        let devices = self.devices.iter().map(|device| (device.attached.name, &device.plug));
        let found = devices.chain([("motors", &self.motors)]).find(|(known, _)| *known == name);
        found.into_iter().for_each(|(_, of)| of.store(plug as u8, Ordering::Release));
    }

    /// Of the kernel's PWM: values that it would have refused, and the longest period that was set, µs.
    pub fn pwm(&self) -> (u64, f64) {
        (self.pwm.refused.load(Ordering::Relaxed), self.pwm.period_ns.load(Ordering::Relaxed) as f64 * 1e-3)
    }

    /// The pulses set, and when: those of the last minutes.
    pub fn pulses(&self) -> Vec<(Instant, [f64; ROTORS])> {
        lock(&self.pulses).iter().copied().collect()
    }

    /// The truth of every tick of the last minutes, and when it was.
    pub fn truths(&self) -> Vec<(Instant, Truth)> {
        lock(&self.truths).iter().copied().collect()
    }

    /// The samples that IMUs sent, and when the last byte of each went out: those of the last minutes.
    pub fn sent(&self) -> Vec<(Instant, Sent)> {
        lock(&self.sent).iter().copied().collect()
    }

    /// The scans that scanners sent, where they are recorded: those of the last minutes.
    pub fn scans(&self) -> Vec<SentScan> {
        lock(&self.scans).iter().map(|(_, scan)| scan.clone()).collect()
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

/// The chip that `attached` is.
fn chip(
    attached: &Attached,
    latest: Latest,
    inertial: Inertial,
    voltage: Arc<Mutex<f64>>,
) -> io::Result<Box<dyn Chip>> {
    let index = attached.index();
    Ok(match attached.speaks {
        Speaks::Bno055 => Box::new(Bno055OnBus { registers: Bno055::new(), latest, inertial }),
        Speaks::Invensense => Box::new(Icm::new(latest, inertial)),
        Speaks::Ms5611 => Box::new(Ms5611::new(latest, index)),
        Speaks::Bmp280 => Box::new(Bmp280::new(latest, index)),
        Speaks::Ina219 | Speaks::Ina226 => Box::new(Voltmeter { speaks: attached.speaks, voltage }),
        other => return Err(io::Error::other(format!("{other:?} is no chip on a bus"))),
    })
}

/// Where the samples of a device go.
enum Outlet {
    /// To one that talks.
    Queue(Sender<Measured>),
    /// To one that is asked.
    Latest(Latest),
}

/// The simulator in real time.
struct World {
    vehicle: SimVehicle,
    outlets: Vec<(Vec<SensorId>, Outlet)>,
    pulses: PulseLog,
    voltage: Arc<Mutex<f64>>,
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
            let widths = lock(&self.pulses).back().map_or([still; ROTORS], |(_, widths)| *widths);
            // An ESC stands still a little above the pulse that says so.
            let throttle =
                widths.map(|us| if us < still + 3.0 { 0.0 } else { ((us - still) / (full - still)).min(1.0) });
            let moved = self.vehicle.actuate(&MotorCommand { throttle }).and_then(|_| self.vehicle.sense());
            let (Ok(frame), Some(truth)) = (moved, self.vehicle.truth()) else { return };
            self.hand_out(&Measured { frame, truth });
        }
    }

    fn hand_out(&self, measured: &Measured) {
        keep(&self.truths, measured.truth);
        if let Some(volts) = measured.frame.battery_v {
            *lock(&self.voltage) = volts;
        }
        for (_, outlet) in self.outlets.iter().filter(|(sensors, _)| measured.has(sensors)) {
            match outlet {
                Outlet::Queue(queue) => drop(queue.send(*measured)),
                Outlet::Latest(latest) => *lock(latest) = Some(*measured),
            }
        }
    }
}

/// A device's axes in the body.
fn body_from_sensor(rpy: &nalgebra::Vector3<f64>) -> Rotation3<f64> {
    Rotation3::from_euler_angles(rpy.x, rpy.y, rpy.z)
}
