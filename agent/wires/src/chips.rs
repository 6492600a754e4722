//! Chips that answer by their registers, on the bus or, a BNO055, on a UART.

use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use nalgebra::Rotation3;
use plumbline_core::sensor::ImuSample;
use plumbline_core::types::ROTORS;
use plumbline_devices::protocol::bno055::{self, register};
use plumbline_devices::protocol::invensense::{self, Thermometer};
use plumbline_devices::protocol::pressure::{bmp280, ms5611};
use plumbline_devices::protocol::{ina, pca9685};
use plumbline_devices::reading::{BarometerReading, ImuReading};

use crate::wiring::Speaks;
use crate::{Kept, Latest, PulseLog, Sent, keep, lock};

/// One chip.
pub trait Chip: Send {
    /// Takes what is written and gives as much as is read; false where it does not acknowledge.
    fn transfer(&mut self, write: &[u8], read: &mut [u8]) -> bool;
}

/// Registers from the first on.
fn fill(read: &mut [u8], from: &[u8]) {
    read.iter_mut().zip(from).for_each(|(to, from)| *to = *from);
}

/// The PWM chip.
pub struct Pwm {
    registers: [u8; 256],
    pulses: PulseLog,
}

impl Pwm {
    /// That writes its pulses down.
    pub fn new(pulses: PulseLog) -> Self {
        Self { registers: [0; 256], pulses }
    }
}

impl Chip for Pwm {
    fn transfer(&mut self, write: &[u8], read: &mut [u8]) -> bool {
        let Some((first, data)) = write.split_first() else { return true };
        let counts_up = self.registers[usize::from(pca9685::MODE1)] & 0x20 != 0;
        let mut at = usize::from(*first);
        for byte in data {
            self.registers[at & 0xff] = *byte;
            at += usize::from(counts_up || data.len() == 1);
        }
        for (offset, byte) in read.iter_mut().enumerate() {
            *byte = self.registers[(usize::from(*first) + offset) & 0xff];
        }
        if *first >= pca9685::CHANNELS && *first < pca9685::PRESCALE && !data.is_empty() {
            let prescale = self.registers[usize::from(pca9685::PRESCALE)];
            let width = |motor: usize| {
                let from = usize::from(pca9685::CHANNELS) + 4 * motor;
                let r = &self.registers;
                pca9685::decode_channel([r[from], r[from + 1], r[from + 2], r[from + 3]], prescale)
            };
            let widths: [f64; ROTORS] = std::array::from_fn(width);
            keep(&self.pulses, widths);
        }
        true
    }
}

/// A voltmeter.
pub struct Voltmeter {
    /// Which.
    pub speaks: Speaks,
    /// Of the battery, V.
    pub voltage: Arc<Mutex<f64>>,
}

impl Chip for Voltmeter {
    fn transfer(&mut self, write: &[u8], read: &mut [u8]) -> bool {
        let volts = *lock(&self.voltage);
        let word = match (self.speaks, write.first().copied()) {
            (Speaks::Ina219, Some(ina::CONFIGURATION)) => ina::INA219_RESET,
            (Speaks::Ina219, Some(ina::BUS_VOLTAGE)) => ina::encode_ina219(volts),
            (Speaks::Ina226, Some(ina::MANUFACTURER)) => ina::TI,
            (Speaks::Ina226, Some(ina::BUS_VOLTAGE)) => ina::encode_ina226(volts),
            _ => 0,
        };
        fill(read, &word.to_be_bytes());
        true
    }
}

/// What an IMU knows of the world, in its own axes.
pub struct Inertial {
    /// Which IMU, from 0.
    pub index: usize,
    /// Its axes in the body.
    pub body_from_sensor: Rotation3<f64>,
    /// Samples that went out.
    pub sent: Kept<Sent>,
}

impl Inertial {
    /// `sample` in the device's axes.
    pub fn reading(&self, sample: &ImuSample) -> ImuReading {
        let turn = self.body_from_sensor.inverse();
        ImuReading {
            gyro_radps: turn * sample.gyro_radps,
            accel_mps2: turn * sample.accel_mps2,
            mag_ut: sample.mag_ut.map(|field| turn * field),
            temperature_c: sample.temperature_c,
        }
    }

    /// Writes down what went out.
    pub fn sent(&self, reading: ImuReading) {
        keep(&self.sent, Sent { imu: self.index, reading });
    }
}

/// Registers of a BNO055.
pub struct Bno055([u8; 128]);

impl Bno055 {
    /// As after power-on.
    pub fn new() -> Self {
        let mut registers = [0; 128];
        fill(&mut registers, &bno055::IDENTITY);
        registers[usize::from(register::ST_RESULT)] = bno055::SELF_TEST_PASSED;
        Self(registers)
    }

    fn second_page(&self) -> bool {
        self.0[usize::from(register::PAGE_ID)] == 1
    }

    /// What is read from register `from` on, while `reading` is what it measures; and that, where all nine axes are read.
    pub fn read(&mut self, from: u8, read: &mut [u8], reading: Option<ImuReading>) -> Option<ImuReading> {
        let raw = self.0[usize::from(register::OPR_MODE)] == bno055::MODE_AMG && !self.second_page();
        let mut seen = None;
        if let Some(reading) = reading.filter(|_| raw) {
            let data = bno055::encode_data(&reading);
            seen = Some(bno055::decode_data(&data, reading.temperature_c));
            fill(&mut self.0[usize::from(register::DATA)..], &data);
            self.0[usize::from(register::TEMP)] = reading.temperature_c as i8 as u8;
        }
        fill(read, &self.0[usize::from(from & 0x7f)..]);
        seen.filter(|_| from == register::DATA && read.len() == bno055::DATA_LENGTH)
    }

    /// Writes one register.
    pub fn write(&mut self, to: u8, value: u8) {
        if to == register::PAGE_ID || !self.second_page() {
            self.0[usize::from(to & 0x7f)] = value;
        }
    }
}

/// A BNO055 on the bus.
pub struct Bno055OnBus {
    /// Its registers.
    pub registers: Bno055,
    /// What it measures.
    pub latest: Latest,
    /// Its axes.
    pub inertial: Inertial,
}

impl Chip for Bno055OnBus {
    fn transfer(&mut self, write: &[u8], read: &mut [u8]) -> bool {
        let Some((register, data)) = write.split_first() else { return true };
        (*register..).zip(data).for_each(|(to, value)| self.registers.write(to, *value));
        if !read.is_empty() {
            let sample = lock(&self.latest).and_then(|measured| measured.imu(self.inertial.index));
            let reading = sample.map(|sample| self.inertial.reading(&sample));
            if let Some(seen) = self.registers.read(*register, read, reading) {
                self.inertial.sent(seen);
            }
        }
        true
    }
}

/// Identity of an ICM-20602.
const ICM_20602: u8 = 0x12;
/// Its power register after a reset: asleep.
const ASLEEP: u8 = 0x41;

/// An ICM-20602.
pub struct Icm {
    registers: [u8; 128],
    thermometer: Option<Thermometer>,
    latest: Latest,
    inertial: Inertial,
}

impl Icm {
    /// As after power-on.
    pub fn new(latest: Latest, inertial: Inertial) -> Self {
        let mut chip = Self { registers: [0; 128], thermometer: invensense::chip(ICM_20602), latest, inertial };
        chip.reset();
        chip
    }

    fn reset(&mut self) {
        self.registers = [0; 128];
        self.registers[usize::from(invensense::register::WHO_AM_I)] = ICM_20602;
        self.registers[usize::from(invensense::register::PWR_MGMT_1)] = ASLEEP;
    }

    fn awake(&self) -> bool {
        self.registers[usize::from(invensense::register::PWR_MGMT_1)] & 0x40 == 0
    }
}

impl Chip for Icm {
    fn transfer(&mut self, write: &[u8], read: &mut [u8]) -> bool {
        let Some((first, data)) = write.split_first() else { return true };
        for (to, value) in (*first..).zip(data) {
            match (to, *value) {
                (invensense::register::PWR_MGMT_1, value) if value & invensense::RESET != 0 => self.reset(),
                (invensense::register::WHO_AM_I, _) => {}
                (to, value) => self.registers[usize::from(to & 0x7f)] = value,
            }
        }
        let burst = *first == invensense::register::DATA && read.len() == invensense::DATA_LENGTH;
        let sample = lock(&self.latest).and_then(|measured| measured.imu(self.inertial.index));
        if let (Some(sample), Some(thermometer), true) = (sample, &self.thermometer, burst && self.awake()) {
            // While asleep the last sample stands.
            let data = invensense::encode(&self.inertial.reading(&sample), thermometer);
            fill(&mut self.registers[usize::from(invensense::register::DATA)..], &data);
            self.inertial.sent(invensense::decode(&data, thermometer));
        }
        fill(read, &self.registers[usize::from(*first & 0x7f)..]);
        true
    }
}

fn pressure(latest: &Latest, index: usize) -> BarometerReading {
    let sample = lock(latest).and_then(|measured| measured.frame.barometers.get(index).copied().flatten());
    sample.map_or(BarometerReading { pressure_pa: 101_325.0, temperature_c: 20.0 }, |sample| BarometerReading {
        pressure_pa: sample.pressure_pa,
        temperature_c: sample.temperature_c,
    })
}

/// A conversion of the MS5611 at its finest takes this long at least (data sheet: 7.40 to 9.04 ms).
const CONVERSION: Duration = Duration::from_micros(7_400);

/// An MS5611.
pub struct Ms5611 {
    prom: [u16; 8],
    latest: Latest,
    index: usize,
    /// What was converted, and since when.
    converting: Option<(Instant, u32)>,
}

impl Ms5611 {
    /// With the calibration of its data sheet's example.
    pub fn new(latest: Latest, index: usize) -> Self {
        let mut prom = [0, 40_127, 36_924, 23_317, 23_282, 33_464, 28_312, 0];
        prom[7] |= ms5611::crc4(&prom);
        Self { prom, latest, index, converting: None }
    }
}

impl Chip for Ms5611 {
    fn transfer(&mut self, write: &[u8], read: &mut [u8]) -> bool {
        let [of_pressure, of_temperature] = ms5611::CONVERT;
        match write {
            [command] if *command == of_pressure || *command == of_temperature => {
                let raw = ms5611::encode(&self.prom, &pressure(&self.latest, self.index));
                self.converting = Some((Instant::now(), raw[usize::from(*command == of_temperature)]));
            }
            [ms5611::READ] => {
                // Read too early, or twice, it gives zero.
                let done = self.converting.take().filter(|(begun, _)| begun.elapsed() >= CONVERSION);
                fill(read, &done.map_or([0; 4], |(_, raw)| raw.to_be_bytes())[1..]);
            }
            [ms5611::RESET] => self.converting = None,
            [command @ ms5611::PROM..=0xAE] => {
                fill(read, &self.prom[usize::from(command - ms5611::PROM) / 2].to_be_bytes());
            }
            _ => {}
        }
        true
    }
}

/// A BMP280.
pub struct Bmp280 {
    registers: [u8; 256],
    latest: Latest,
    index: usize,
}

impl Bmp280 {
    /// With the calibration of its data sheet's example.
    pub fn new(latest: Latest, index: usize) -> Self {
        const WORDS: [i32; 12] =
            [27_504, 26_435, -1_000, 36_477, -10_685, 3_024, 2_855, 140, -7, 15_500, -14_600, 6_000];
        let mut registers = [0; 256];
        registers[usize::from(bmp280::ID)] = bmp280::IDENTITY;
        let bytes: Vec<u8> = WORDS.iter().flat_map(|word| (*word as u16).to_le_bytes()).collect();
        fill(&mut registers[usize::from(bmp280::CALIBRATION)..], &bytes);
        Self { registers, latest, index }
    }
}

impl Chip for Bmp280 {
    fn transfer(&mut self, write: &[u8], read: &mut [u8]) -> bool {
        // Pairs of register and value; what is left over says where to read.
        let mut pairs = write.chunks_exact(2);
        for pair in &mut pairs {
            self.registers[usize::from(pair[0])] = pair[1];
        }
        let [from] = *pairs.remainder() else { return true };
        let normal_mode = self.registers[usize::from(bmp280::CONTROL)] & 3 == 3;
        if from == bmp280::DATA && normal_mode {
            let at = usize::from(bmp280::CALIBRATION);
            let mut calibration = [0; 24];
            calibration.copy_from_slice(&self.registers[at..at + 24]);
            let data = bmp280::encode(&calibration, &pressure(&self.latest, self.index));
            fill(&mut self.registers[usize::from(bmp280::DATA)..], &data);
        }
        fill(read, &self.registers[usize::from(from)..]);
        true
    }
}
