//! Small chips on I²C that are asked again and again: barometers, the battery's voltage.

use std::time::{Duration, Instant};

use super::{Driver, Heard, Outlet};
use crate::fault::{DeviceError, Fault};
use crate::port::{Bus, PortName};
use crate::protocol::ina;
use crate::protocol::pressure::{bmp280, ms5611};
use crate::reading::Reading;

/// An MS5611 converts at its finest within this.
const CONVERSION: Duration = Duration::from_micros(9_100);

/// Which chip.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Chip {
    /// Its calibration.
    Ms5611([u16; 8]),
    /// Its calibration.
    Bmp280([u8; 24]),
    /// Volts at its bus input for one at the battery's terminals are found by this divider.
    Ina219,
    /// The same.
    Ina226,
}

/// One chip on a bus.
pub struct Registers {
    port: PortName,
    address: u8,
    chip: Chip,
    period: Duration,
    /// Voltage of the battery for one volt at the chip.
    divider: f64,
    bus: Option<Box<dyn Bus>>,
}

impl Registers {
    /// `chip` on `port`, closed, to be read `rate_hz` times a second.
    pub fn new(port: PortName, address: u8, chip: Chip, rate_hz: f64, divider: f64) -> Self {
        let period = Duration::from_secs_f64(1.0 / rate_hz);
        Self { port, address, chip, period, divider, bus: None }
    }

    fn transfer(&mut self, write: &[u8], read: &mut [u8]) -> Result<(), DeviceError> {
        let Some(bus) = &mut self.bus else { return Ok(()) };
        bus.transfer(self.address, write, read).map_err(|error| self.port.error(error))
    }

    fn word(&mut self, register: u8) -> Result<u16, DeviceError> {
        let mut word = [0; 2];
        self.transfer(&[register], &mut word)?;
        Ok(u16::from_be_bytes(word))
    }

    fn converted(&mut self, command: u8) -> Result<u32, DeviceError> {
        self.transfer(&[command], &mut [])?;
        std::thread::sleep(CONVERSION);
        let mut raw = [0; 3];
        self.transfer(&[ms5611::READ], &mut raw)?;
        let [a, b, c] = raw;
        Ok(u32::from_be_bytes([0, a, b, c]))
    }

    fn measure(&mut self) -> Result<Reading, DeviceError> {
        const NOT_DONE: Fault = Fault::Malformed("conversion that was not done");
        match self.chip {
            Chip::Ms5611(prom) => {
                let [pressure, temperature] = ms5611::CONVERT;
                let (temperature, pressure) = (self.converted(temperature)?, self.converted(pressure)?);
                if pressure == 0 || temperature == 0 {
                    return Err(NOT_DONE.into());
                }
                Ok(Reading::Barometer(ms5611::compensate(&prom, pressure, temperature)))
            }
            Chip::Bmp280(calibration) => {
                let mut data = [0; 6];
                self.transfer(&[bmp280::DATA], &mut data)?;
                // Either of the two alone may be measured so.
                if data == bmp280::EMPTY {
                    return Err(NOT_DONE.into());
                }
                Ok(Reading::Barometer(bmp280::compensate(&calibration, &data)))
            }
            Chip::Ina219 => {
                let volts = ina::ina219_v(self.word(ina::BUS_VOLTAGE)?).ok_or(Fault::Malformed("voltage: overflow"))?;
                Ok(Reading::Battery(volts * self.divider))
            }
            Chip::Ina226 => Ok(Reading::Battery(ina::ina226_v(self.word(ina::BUS_VOLTAGE)?) * self.divider)),
        }
    }
}

impl Driver for Registers {
    fn open(&mut self) -> Result<(), DeviceError> {
        self.bus = Some(self.port.open_bus()?);
        let wrong =
            |what, value: u16, expected| Err(DeviceError::Wrong { what, value: format!("{value:#x}"), expected });
        match self.chip {
            Chip::Ms5611(_) => {
                self.transfer(&[ms5611::RESET], &mut [])?;
                std::thread::sleep(Duration::from_millis(5));
                let mut prom = [0; 8];
                for (index, word) in (0_u8..).zip(&mut prom) {
                    *word = self.word(ms5611::PROM + 2 * index)?;
                }
                ms5611::check(&prom)?;
                self.chip = Chip::Ms5611(prom);
            }
            Chip::Bmp280(_) => {
                let (mut id, mut calibration) = ([0], [0; 24]);
                self.transfer(&[bmp280::ID], &mut id)?;
                if id != [bmp280::IDENTITY] {
                    return wrong("identity", id[0].into(), "0x58, a BMP280's");
                }
                self.transfer(&[bmp280::CALIBRATION], &mut calibration)?;
                let [control, setting] = bmp280::SETTING;
                self.transfer(&[bmp280::CONTROL, control, bmp280::CONTROL + 1, setting], &mut [])?;
                self.chip = Chip::Bmp280(calibration);
            }
            Chip::Ina219 => {
                let found = self.word(ina::CONFIGURATION)?;
                if found != ina::INA219_RESET {
                    return wrong("configuration register", found, "0x399f, an INA219's after its reset");
                }
            }
            Chip::Ina226 => {
                let found = self.word(ina::MANUFACTURER)?;
                if found != ina::TI {
                    return wrong("manufacturer", found, "0x5449, an INA226's");
                }
            }
        }
        Ok(())
    }

    fn period(&self) -> Option<Duration> {
        Some(self.period)
    }

    fn poll(&mut self, out: &mut Outlet<'_>) -> Result<(), DeviceError> {
        let begun = Instant::now();
        let reading = match self.measure() {
            Ok(reading) => reading,
            Err(DeviceError::Frame(fault)) => {
                out(Err(fault));
                return Ok(());
            }
            Err(error) => return Err(error),
        };
        let at = Instant::now();
        // In the middle of what was converted and read.
        let after_us = -0.5e6 * at.duration_since(begun).as_secs_f64();
        out(Ok(Heard { at, stamp: None, after_us, reading }));
        Ok(())
    }

    fn close(&mut self) {
        self.bus = None;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Answers everything with these registers.
    struct Holds([u8; 6]);

    impl Bus for Holds {
        fn transfer(&mut self, _address: u8, _write: &[u8], read: &mut [u8]) -> std::io::Result<()> {
            read.copy_from_slice(&self.0);
            Ok(())
        }
    }

    #[test]
    fn a_bmp280_that_was_reset_gives_no_reading() {
        for (data, measured) in [(bmp280::EMPTY, false), ([0x65, 0x5A, 0xC0, 0x80, 0, 0], true)] {
            let port = PortName::parse("/dev/i2c-1").unwrap();
            let mut chip = Registers::new(port, 0x76, Chip::Bmp280([1; 24]), 50.0, 1.0);
            chip.bus = Some(Box::new(Holds(data)));
            let mut heard = Vec::new();
            chip.poll(&mut |outcome| heard.push(outcome.is_ok())).unwrap();
            assert_eq!(heard, [measured], "{data:x?}");
        }
    }
}
