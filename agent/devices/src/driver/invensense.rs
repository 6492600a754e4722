//! InvenSense MPU and ICM on I²C or SPI: a burst of all axes at a rate of our own.

use std::time::{Duration, Instant};

use super::{Driver, Heard, Outlet};
use crate::fault::{DeviceError, Fault};
use crate::port::{Bus, PortName};
use crate::protocol::invensense::{self, AWAKE, DATA_LENGTH, RESET, SETTING, Thermometer, register};
use crate::reading::Reading;

/// After a reset (register map 4.28: 100 ms), and after waking up (gyroscope's start, 35 ms).
const RESTART: [Duration; 2] = [Duration::from_millis(100), Duration::from_millis(40)];
/// How often it is asked whether it is awake still: a dip of its supply puts it to sleep, with its last sample standing.
const LOOK: Duration = Duration::from_secs(1);

/// The IMU.
pub struct Invensense {
    port: PortName,
    address: u8,
    period: Duration,
    open: Option<(Box<dyn Bus>, Thermometer)>,
    look_due: Instant,
}

impl Invensense {
    /// At `address` of `port`, closed, to be read `rate_hz` times a second.
    pub fn new(port: PortName, address: u8, rate_hz: f64) -> Self {
        let (now, period) = (Instant::now(), Duration::from_secs_f64(1.0 / rate_hz));
        Self { port, address, period, open: None, look_due: now }
    }

    /// Identifies the chip behind `bus` and sets it up.
    fn set_up(&self, bus: &mut dyn Bus) -> Result<Thermometer, DeviceError> {
        let Self { port, address, .. } = self;
        let mut transfer =
            |write: &[u8], read: &mut [u8]| bus.transfer(*address, write, read).map_err(|error| port.error(error));
        let mut identity = [0];
        transfer(&[register::WHO_AM_I], &mut identity)?;
        let [identity] = identity;
        let Some(thermometer) = invensense::chip(identity) else {
            let expected = "68, 70, 71, 73, 12, af or 98: an MPU-6050, 6500, 9250, 9255, ICM-20602, 20608 or 20689";
            return Err(DeviceError::Wrong { what: "identity", value: format!("{identity:02x}"), expected });
        };
        let [reset, wake] = RESTART;
        transfer(&[register::PWR_MGMT_1, RESET], &mut [])?;
        std::thread::sleep(reset);
        transfer(&[register::PWR_MGMT_1, AWAKE], &mut [])?;
        std::thread::sleep(wake);
        if matches!(port, PortName::Spi(_)) {
            transfer(&invensense::without_i2c(identity), &mut [])?;
        }
        for (at, value) in (register::SMPLRT_DIV..).zip(SETTING) {
            transfer(&[at, value], &mut [])?;
        }
        let mut set = [0; SETTING.len()];
        transfer(&[register::SMPLRT_DIV], &mut set)?;
        if set != SETTING {
            let value = format!("{set:02x?}");
            return Err(DeviceError::Wrong { what: "range registers", value, expected: "[00, 02, 18, 18, 02]" });
        }
        Ok(thermometer)
    }
}

impl Driver for Invensense {
    fn open(&mut self) -> Result<(), DeviceError> {
        let mut bus = self.port.open_bus()?;
        let thermometer = self.set_up(bus.as_mut())?;
        self.open = Some((bus, thermometer));
        self.look_due = Instant::now() + LOOK;
        Ok(())
    }

    fn period(&self) -> Option<Duration> {
        Some(self.period)
    }

    fn poll(&mut self, out: &mut Outlet<'_>) -> Result<(), DeviceError> {
        let Some((bus, thermometer)) = &mut self.open else { return Ok(()) };
        let mut read = |register: u8, into: &mut [u8]| {
            bus.transfer(self.address, &[register], into).map_err(|error| self.port.error(error))
        };
        let begun = Instant::now();
        let mut data = [0; DATA_LENGTH];
        read(register::DATA, &mut data)?;
        let at = Instant::now();
        // The registers were latched when the address was there, not when the last byte was.
        let after_us = -1e6 * at.duration_since(begun).as_secs_f64();
        let reading = Reading::Imu(invensense::decode(&data, thermometer));
        out(Ok(Heard { at, stamp: None, after_us, reading }));
        // Behind what is waited for.
        if at >= self.look_due {
            self.look_due = at + LOOK;
            let mut power = [0];
            read(register::PWR_MGMT_1, &mut power)?;
            if power != [AWAKE] {
                return Err(Fault::Reported { what: "power register", code: power[0].into() }.into());
            }
        }
        Ok(())
    }

    fn close(&mut self) {
        self.open = None;
    }
}
