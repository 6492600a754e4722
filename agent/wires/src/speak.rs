//! Devices on a UART: those that talk, and a BNO055, which answers.

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicU8, Ordering};
use std::sync::mpsc::{Receiver, TryRecvError};
use std::time::Duration;

use nalgebra::Vector3;
use plumbline_core::sensor::noise::Stream;
use plumbline_core::sensor::{BarometerSample, GnssSample, HeightSample};
use plumbline_devices::framer::Framer;
use plumbline_devices::protocol::bno055::{self, UartRequest, UartRequests, register};
use plumbline_devices::protocol::mongoose::{self, MongooseReading};
use plumbline_devices::protocol::{nmea, scan_height, scip, tfmini, ubx};
use plumbline_devices::reading::{BarometerReading, FixReading, ImuReading};
use plumbline_proto::time::FlightTime;
use plumbline_sim::Scenario;

use crate::chips::{Bno055, Inertial};
use crate::uart::Uart;
use crate::wiring::{Attached, Speaks};
use crate::{Kept, Measured, Plug, SentScan, keep};

/// One frame in so many is damaged.
const DAMAGED: u64 = 97;
/// One frame in so many comes in two pieces.
const IN_PIECES: u64 = 7;
/// Pause between the pieces.
const PAUSE: Duration = Duration::from_millis(2);
/// How fast the clocks of devices with an own one run: 80 ppm fast.
const SKEW: f64 = 80e-6;
/// Scatter of one range of a scan, m.
const RANGE_SIGMA_M: f64 = 0.01;

/// A device and what it keeps.
pub struct Emulated {
    speaks: Speaks,
    inertial: Inertial,
    link: PathBuf,
    position_flu_m: Vector3<f64>,
    noise: Stream,
    frames: u64,
    registers: Bno055,
    requests: Framer<UartRequests>,
    line: Vec<u8>,
    streaming: bool,
    scans: Option<Kept<SentScan>>,
    latest: Option<Measured>,
    /// Of a device that has a barometer: it samples at other ticks than the IMU beside it.
    barometer: Option<BarometerSample>,
}

impl Emulated {
    /// `device` of the vehicle of `scenario`, its port in `folder`; `inertial` is what it is as an IMU; scans are written
    /// down in `scans`.
    pub fn new(
        device: &Attached,
        scenario: &Scenario,
        folder: &Path,
        inertial: Inertial,
        scans: Option<Kept<SentScan>>,
    ) -> Self {
        let [position_flu_m, _] = device.place(scenario);
        Self {
            speaks: device.speaks,
            inertial,
            link: folder.join(device.name),
            position_flu_m,
            noise: Stream::new(scenario.seed, &format!("wire {}", device.name)),
            frames: 0,
            registers: Bno055::new(),
            requests: Framer::new(UartRequests),
            line: Vec::new(),
            streaming: false,
            scans,
            latest: None,
            barometer: None,
        }
    }

    /// Until `stop`.
    pub fn run(mut self, inlet: &Receiver<Measured>, plug: &AtomicU8, stop: &AtomicBool) {
        let mut uart = None;
        while !stop.load(Ordering::Acquire) {
            let state = plug.load(Ordering::Acquire);
            if state == Plug::Out as u8 {
                uart = None;
                (self.streaming, self.line) = (false, Vec::new());
            } else if uart.is_none() {
                uart = Uart::plug_in(&self.link).ok();
            }
            let mut fresh = Vec::new();
            loop {
                match inlet.try_recv() {
                    Ok(measured) => fresh.push(measured),
                    Err(TryRecvError::Empty) => break,
                    Err(TryRecvError::Disconnected) => return,
                }
            }
            self.latest = fresh.last().copied().or(self.latest);
            for measured in &fresh {
                self.barometer = measured.frame.barometers.first().copied().flatten().or(self.barometer);
            }
            let Some(open) = &uart else {
                std::thread::sleep(Duration::from_millis(5));
                continue;
            };
            let mut bytes = [0; 256];
            let count = open.read(&mut bytes);
            if state == Plug::Hanging as u8 {
                continue;
            }
            self.hear(open, bytes.get(..count).unwrap_or_default());
            fresh.iter().for_each(|measured| self.talk(open, measured));
        }
    }

    /// Sends a frame, which may hold a sample of an IMU; some in two pieces, some damaged.
    fn send(&mut self, uart: &Uart, mut frame: Vec<u8>, may_damage: bool, sample: Option<ImuReading>) {
        self.frames += 1;
        let damaged = may_damage && self.frames.is_multiple_of(DAMAGED);
        if damaged {
            let at = frame.len() / 2;
            frame[at] ^= 0x04;
        }
        let mut last = &frame[..];
        if self.frames.is_multiple_of(IN_PIECES) {
            let (first, second) = frame.split_at(frame.len() / 3);
            uart.write(first);
            std::thread::sleep(PAUSE);
            last = second;
        }
        if let Some(reading) = sample.filter(|_| !damaged) {
            self.inertial.sent(reading);
        }
        uart.write(last);
    }

    /// Distance below the device along the vertical, and the vertical in its axes.
    fn below(&self, sample: &HeightSample, measured: &Measured) -> (f64, Vector3<f64>) {
        // The simulated driver has added the mounting as if level.
        let own_m = sample.height_m + self.position_flu_m.z;
        (own_m, measured.truth.world_from_body.inverse() * Vector3::z())
    }

    /// What a device says by itself.
    fn talk(&mut self, uart: &Uart, measured: &Measured) {
        let index = self.inertial.index;
        let (imu, height) = (measured.imu(index), measured.height(index));
        match (self.speaks, imu, height, measured.frame.gnss) {
            (Speaks::Mongoose, Some(sample), ..) => {
                let unheard = BarometerReading { pressure_pa: 101_325.0, temperature_c: 20.0 };
                let barometer = self.barometer.map_or(unheard, |b| BarometerReading {
                    pressure_pa: b.pressure_pa,
                    temperature_c: b.temperature_c,
                });
                let reading = MongooseReading {
                    sequence: self.frames as u8,
                    stamp_us: device_us(sample.time) as u64 as u32,
                    imu: self.inertial.reading(&sample),
                    barometer,
                };
                let frame = mongoose::encode(&reading);
                self.send(uart, frame.to_vec(), true, mongoose::decode(&frame).ok().map(|reading| reading.imu));
            }
            (Speaks::Tfmini, _, Some(sample), _) => {
                let (own_m, up) = self.below(&sample, measured);
                let frame = tfmini::encode((own_m / up.z).clamp(0.0, 12.0), 1200, 30.0);
                self.send(uart, frame.to_vec(), true, None);
            }
            (Speaks::Hokuyo, _, Some(sample), _) if self.streaming => {
                let (own_m, up) = self.below(&sample, measured);
                let noise = &mut self.noise;
                let perpendicular_m = own_m / up.yz().norm();
                let ranges =
                    scan_height::encode(perpendicular_m, up.y.atan2(up.z), 4.0, || RANGE_SIGMA_M * noise.normal());
                // The stamp is the turn's begin; the floor was passed later.
                let after_ms = 1e2 * scip::FRONT_STEP as f64 / scip::STEPS_PER_TURN as f64;
                let stamp_ms = (device_us(sample.time) * 1e-3 - after_ms).max(0.0) as u32;
                let command = String::from_utf8_lossy(scip::STREAM.trim_ascii_end()).into_owned();
                if let Some(scans) = self.scans.as_ref().filter(|_| !(self.frames + 1).is_multiple_of(DAMAGED)) {
                    let stamp_ms = stamp_ms % scip::ROLL_OVER_MS;
                    keep(scans, SentScan { height: index, stamp_ms, ranges_mm: Box::from(ranges) });
                }
                self.send(uart, scip::encode_scan(&command, stamp_ms, &ranges), true, None);
            }
            (Speaks::Ubx | Speaks::Nmea, _, _, Some(sample)) => {
                let (seconds, fix) = fix(&sample);
                let sentences = nmea::encode(seconds, &fix).into_bytes();
                let frame = if self.speaks == Speaks::Ubx {
                    let pvt = ubx::encode_nav_pvt((seconds * 1e3).round() as u32, &fix);
                    [&pvt[..], &sentences].concat()
                } else {
                    sentences
                };
                self.send(uart, frame, true, None);
            }
            _ => {}
        }
    }

    /// What a device is asked.
    fn hear(&mut self, uart: &Uart, bytes: &[u8]) {
        match self.speaks {
            Speaks::Bno055 => {
                let mut asked = Vec::new();
                self.requests.push(bytes, |request| asked.extend(request.ok()));
                asked.into_iter().for_each(|request| self.answer(uart, &request));
            }
            Speaks::Hokuyo => {
                self.line.extend(bytes);
                while let Some(end) = self.line.iter().position(|b| *b == b'\n') {
                    let line: Vec<u8> = self.line.drain(..=end).collect();
                    self.command(uart, String::from_utf8_lossy(&line).trim());
                }
            }
            _ => {}
        }
    }

    fn answer(&mut self, uart: &Uart, request: &UartRequest) {
        match *request {
            UartRequest::Read(from, length) => {
                let sample = self.latest.and_then(|measured| measured.imu(self.inertial.index));
                let reading = sample.map(|sample| self.inertial.reading(&sample));
                let mut data = vec![0; usize::from(length)];
                let read = self.registers.read(from, &mut data, reading);
                // Its UART misses a request now and then.
                let answer = [&[0xBB, length][..], &data].concat();
                let whole = from == register::DATA && usize::from(length) == bno055::DATA_LENGTH;
                if self.frames % DAMAGED == DAMAGED - 1 && whole {
                    self.send(uart, vec![0xEE, 0x07], false, None);
                } else {
                    self.send(uart, answer, false, read);
                }
            }
            UartRequest::Write(to, value) => {
                self.registers.write(to, value);
                uart.write(&[0xEE, 0x01]);
            }
        }
    }

    fn command(&mut self, uart: &Uart, command: &str) {
        let identity = scip::identity("H1510998");
        let lines: Vec<&str> = identity.iter().map(|line| line.as_str()).collect();
        let reply = match command {
            "VV" => scip::encode_reply(command, "00", &lines),
            "SCIP2.0" | "BM" => scip::encode_reply(command, "00", &[]),
            "QT" => {
                self.streaming = false;
                scip::encode_reply(command, "00", &[])
            }
            _ if command.starts_with("MD") => {
                self.streaming = true;
                scip::encode_reply(command, "00", &[])
            }
            _ => scip::encode_reply(command, "0E", &[]),
        };
        uart.write(&reply);
    }
}

/// A device's own clock at flight time `time`, µs.
fn device_us(time: FlightTime) -> f64 {
    time.0 as f64 * (1.0 + SKEW) + 12_345_678.0
}

/// A fix as a receiver has it, and its time of the day, s: noon, when the rig began.
fn fix(sample: &GnssSample) -> (f64, FixReading) {
    let fix = FixReading {
        geodetic: sample.geodetic,
        velocity_enu_mps: sample.velocity_enu_mps,
        horizontal_sigma_m: sample.horizontal_sigma_m,
        vertical_sigma_m: sample.vertical_sigma_m,
        satellites: sample.satellites,
    };
    (43_200.0 + sample.time.as_seconds(), fix)
}
