//! Devices as they answer.

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicU8, Ordering};
use std::sync::mpsc::{Receiver, TryRecvError};
use std::time::Duration;

use nalgebra::{Rotation3, Vector3};
use plumbline_core::sensor::noise::Stream;
use plumbline_core::sensor::{HeightSample, ImuSample};
use plumbline_devices::framer::Framer;
use plumbline_devices::protocol::bno055::{self, UartRequest, UartRequests, register};
use plumbline_devices::protocol::mongoose::{self, MongooseReading};
use plumbline_devices::protocol::{scan_height, scip, tfmini};
use plumbline_devices::reading::{BarometerReading, ImuReading};
use plumbline_sim::Scenario;

use crate::uart::Uart;
use crate::{Device, Kept, Measured, Plug, Sent, body_from_sensor, keep};

/// What a device speaks.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Speaks {
    /// An IMU that answers.
    Bno055,
    /// An IMU with barometer that talks.
    Mongoose,
    /// A scanner that streams once it is asked to.
    Hokuyo,
    /// A beam that talks.
    Tfmini,
}

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

/// Where device `index` sits in the scenario's vehicle, and how it is turned.
pub fn place(speaks: Speaks, index: usize, scenario: &Scenario) -> (Vector3<f64>, Vector3<f64>) {
    let suite = &scenario.suite;
    let of_imu = || suite.imus.get(index).map(|imu| (imu.position_flu_m, imu.mounting_rpy_rad));
    let of_height = || suite.heights.get(index).map(|height| (height.position_flu_m, Vector3::zeros()));
    match speaks {
        Speaks::Bno055 | Speaks::Mongoose => of_imu(),
        Speaks::Hokuyo | Speaks::Tfmini => of_height(),
    }
    .unwrap_or_default()
}

/// A device and what it keeps.
pub struct Emulated {
    speaks: Speaks,
    index: usize,
    link: PathBuf,
    position_flu_m: Vector3<f64>,
    body_from_sensor: Rotation3<f64>,
    noise: Stream,
    frames: u64,
    registers: [u8; 128],
    requests: Framer<UartRequests>,
    line: Vec<u8>,
    streaming: bool,
    latest: Option<Measured>,
    sent: Kept<Sent>,
}

impl Emulated {
    /// `device` of the vehicle of `scenario`, its port in `folder`; samples of IMUs are written down in `sent`.
    pub fn new(device: &Device, scenario: &Scenario, folder: &Path, sent: Kept<Sent>) -> Self {
        let (position_flu_m, rpy) = place(device.speaks, device.index, scenario);
        let mut registers = [0; 128];
        registers.iter_mut().zip(bno055::IDENTITY).for_each(|(to, from)| *to = from);
        registers[usize::from(register::ST_RESULT)] = bno055::SELF_TEST_PASSED;
        Self {
            speaks: device.speaks,
            index: device.index,
            link: folder.join(&device.name),
            position_flu_m,
            body_from_sensor: body_from_sensor(&rpy),
            noise: Stream::new(scenario.seed, &format!("wire {}", device.name)),
            frames: 0,
            registers,
            requests: Framer::new(UartRequests),
            line: Vec::new(),
            streaming: false,
            latest: None,
            sent,
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
            keep(&self.sent, Sent { imu: self.index, reading });
        }
        uart.write(last);
    }

    /// In the device's own axes.
    fn imu(&self, sample: &ImuSample) -> ImuReading {
        let turn = self.body_from_sensor.inverse();
        ImuReading {
            gyro_radps: turn * sample.gyro_radps,
            accel_mps2: turn * sample.accel_mps2,
            mag_ut: sample.mag_ut.map(|field| turn * field),
            temperature_c: sample.temperature_c,
        }
    }

    /// Distance below the device along the vertical, and the vertical in its axes.
    fn below(&self, sample: &HeightSample, measured: &Measured) -> (f64, Vector3<f64>) {
        // The simulated driver has added the mounting as if level.
        let own_m = sample.height_m + self.position_flu_m.z;
        (own_m, measured.truth.world_from_body.inverse() * Vector3::z())
    }

    /// What a device says by itself.
    fn talk(&mut self, uart: &Uart, measured: &Measured) {
        let device_us = measured.truth.time.0 as f64 * (1.0 + SKEW) + 12_345_678.0;
        match (self.speaks, &measured.imu, &measured.height) {
            (Speaks::Mongoose, Some(sample), _) => {
                let barometer =
                    measured.barometer.map_or(BarometerReading { pressure_pa: 101_325.0, temperature_c: 20.0 }, |b| {
                        BarometerReading { pressure_pa: b.pressure_pa, temperature_c: b.temperature_c }
                    });
                let reading = MongooseReading {
                    sequence: self.frames as u8,
                    stamp_us: device_us as u64 as u32,
                    imu: self.imu(sample),
                    barometer,
                };
                let frame = mongoose::encode(&reading);
                self.send(uart, frame.to_vec(), true, mongoose::decode(&frame).ok().map(|reading| reading.imu));
            }
            (Speaks::Tfmini, _, Some(sample)) => {
                let (own_m, up) = self.below(sample, measured);
                let frame = tfmini::encode((own_m / up.z).clamp(0.0, 12.0), 1200, 30.0);
                self.send(uart, frame.to_vec(), true, None);
            }
            (Speaks::Hokuyo, _, Some(sample)) if self.streaming => {
                let (own_m, up) = self.below(sample, measured);
                let noise = &mut self.noise;
                let perpendicular_m = own_m / up.yz().norm();
                let ranges =
                    scan_height::encode(perpendicular_m, up.y.atan2(up.z), 4.0, || RANGE_SIGMA_M * noise.normal());
                // The stamp is the turn's begin; the floor was passed later.
                let after_ms = 1e2 * scip::FRONT_STEP as f64 / scip::STEPS_PER_TURN as f64;
                let stamp_ms = (device_us * 1e-3 - after_ms).max(0.0) as u32;
                let command = String::from_utf8_lossy(scip::STREAM.trim_ascii_end()).into_owned();
                self.send(uart, scip::encode_scan(&command, stamp_ms, &ranges), true, None);
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
            Speaks::Mongoose | Speaks::Tfmini => {}
        }
    }

    fn answer(&mut self, uart: &Uart, request: &UartRequest) {
        match *request {
            UartRequest::Read(from, length) => {
                let second_page = self.registers[usize::from(register::PAGE_ID)] == 1;
                let raw = self.registers[usize::from(register::OPR_MODE)] == bno055::MODE_AMG && !second_page;
                let mut read = None;
                if let Some(sample) = self.latest.and_then(|measured| measured.imu).filter(|_| raw) {
                    let reading = self.imu(&sample);
                    let data = bno055::encode_data(&reading);
                    read = Some(bno055::decode_data(&data, reading.temperature_c));
                    let place = self.registers.iter_mut().skip(usize::from(register::DATA));
                    place.zip(data).for_each(|(to, from)| *to = from);
                    self.registers[usize::from(register::TEMP)] = reading.temperature_c as i8 as u8;
                }
                let data: Vec<u8> =
                    self.registers.iter().skip(usize::from(from)).take(usize::from(length)).copied().collect();
                // Its UART misses a request now and then.
                let answer = [&[0xBB, length][..], &data].concat();
                let whole = from == register::DATA && usize::from(length) == bno055::DATA_LENGTH;
                if self.frames % DAMAGED == DAMAGED - 1 && whole {
                    self.send(uart, vec![0xEE, 0x07], false, None);
                } else {
                    self.send(uart, answer, false, read.filter(|_| whole));
                }
            }
            UartRequest::Write(to, value) => {
                let second_page = self.registers[usize::from(register::PAGE_ID)] == 1;
                if to == register::PAGE_ID || !second_page {
                    self.registers[usize::from(to & 0x7f)] = value;
                }
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
