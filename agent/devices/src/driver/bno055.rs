//! BNO055 on UART or I²C: raw nine axes at a rate of our own.

use std::time::{Duration, Instant};

use super::{Driver, Heard, Outlet};
use crate::fault::{DeviceError, Fault};
use crate::framer::Framer;
use crate::port::{Bus, PortName, Stream};
use crate::protocol::bno055::{self, DATA_LENGTH, UartReplies, UartReply, register};
use crate::reading::Reading;

/// An answer is there within this; the chip itself waits 30 ms between characters.
const PATIENCE: Duration = Duration::from_millis(100);
/// After a change to or from configuration (data sheet table 3-6: 19 ms, 7 ms).
const CHANGE: Duration = Duration::from_millis(25);
/// Reads that fail one after another before the chip is given up: on UART it misses one now and then.
const FAILURES_MAX: u32 = 10;
/// How often temperature and errors are asked for.
const SLOW: Duration = Duration::from_secs(1);

/// Its registers, whatever leads to them.
enum Way {
    Uart(Box<dyn Stream>, Box<Framer<UartReplies>>),
    I2c(Box<dyn Bus>, u8),
}

impl Way {
    fn read(&mut self, port: &PortName, register: u8, into: &mut [u8]) -> Result<(), DeviceError> {
        match self {
            Self::I2c(bus, address) => bus.transfer(*address, &[register], into).map_err(|error| port.error(error)),
            Self::Uart(stream, framer) => {
                let request = bno055::encode_read(register, into.len() as u8);
                match answer(port, stream.as_mut(), framer, &request, into.len())? {
                    UartReply::Data(data) => into.iter_mut().zip(data).for_each(|(to, from)| *to = from),
                    UartReply::Written => return Err(Fault::Malformed("answer to a read").into()),
                }
                Ok(())
            }
        }
    }

    fn write(&mut self, port: &PortName, register: u8, value: u8) -> Result<(), DeviceError> {
        match self {
            Self::I2c(bus, address) => {
                bus.transfer(*address, &[register, value], &mut []).map_err(|error| port.error(error))
            }
            Self::Uart(stream, framer) => {
                answer(port, stream.as_mut(), framer, &[0xAA, 0x00, register, 1, value], 0).map(drop)
            }
        }
    }
}

/// Sends a request and waits for its answer.
fn answer(
    port: &PortName,
    stream: &mut dyn Stream,
    framer: &mut Framer<UartReplies>,
    request: &[u8],
    expected: usize,
) -> Result<UartReply, DeviceError> {
    framer.clear();
    framer.protocol_mut().expected = expected;
    stream.write(request).map_err(|error| port.error(error))?;
    let begun = Instant::now();
    let mut bytes = [0; 64];
    while begun.elapsed() < PATIENCE {
        let count = stream.read(&mut bytes).map_err(|error| port.error(error))?;
        let _ = framer.fill(bytes.get(..count).unwrap_or_default());
        if let Some(outcome) = framer.next() {
            return Ok(outcome?);
        }
    }
    Err(DeviceError::Silent { what: "answer of a BNO055", seconds: PATIENCE.as_secs_f64() })
}

/// The IMU.
pub struct Bno055 {
    port: PortName,
    address: u8,
    period: Duration,
    way: Option<Way>,
    slow_due: Instant,
    temperature_c: f64,
    failures: u32,
}

impl Bno055 {
    /// On `port`, closed, to be read `rate_hz` times a second; `address` counts on I²C only.
    pub fn new(port: PortName, address: u8, rate_hz: f64) -> Self {
        let now = Instant::now();
        Self {
            port,
            address,
            period: Duration::from_secs_f64(1.0 / rate_hz),
            way: None,
            slow_due: now,
            temperature_c: f64::NAN,
            failures: 0,
        }
    }

    fn set_up(&mut self, way: &mut Way) -> Result<(), DeviceError> {
        use register::{CHIP_ID, CONFIG, OPR_MODE, PAGE_ID, PWR_MODE, ST_RESULT, UNIT_SEL};
        let port = &self.port;
        way.write(port, PAGE_ID, 0)?;
        let mut identity = [0; 4];
        way.read(port, CHIP_ID, &mut identity)?;
        if identity != bno055::IDENTITY {
            let value = format!("{identity:#04x?}").replace(['\n', ' '], "");
            return Err(DeviceError::Wrong { what: "identity", value, expected: "a0 fb 32 0f, a BNO055's" });
        }
        let mut one = [0];
        way.read(port, ST_RESULT, &mut one)?;
        if one[0] & bno055::SELF_TEST_PASSED != bno055::SELF_TEST_PASSED {
            return Err(Fault::Reported { what: "self-test result", code: one[0].into() }.into());
        }
        way.write(port, OPR_MODE, bno055::MODE_CONFIG)?;
        std::thread::sleep(CHANGE);
        way.write(port, PWR_MODE, bno055::POWER_NORMAL)?;
        way.write(port, UNIT_SEL, bno055::UNITS)?;
        way.write(port, PAGE_ID, 1)?;
        for (at, value) in (CONFIG..).zip(bno055::RANGES) {
            way.write(port, at, value)?;
        }
        way.write(port, PAGE_ID, 0)?;
        way.write(port, OPR_MODE, bno055::MODE_AMG)?;
        std::thread::sleep(CHANGE);
        for (at, what, expected, name) in [
            (UNIT_SEL, "unit register", bno055::UNITS, "0 (m/s², °/s, °C)"),
            (PWR_MODE, "power register", bno055::POWER_NORMAL, "0 (normal)"),
            (OPR_MODE, "mode register", bno055::MODE_AMG, "7 (raw nine axes)"),
        ] {
            way.read(port, at, &mut one)?;
            if one[0] != expected {
                return Err(DeviceError::Wrong { what, value: one[0].to_string(), expected: name });
            }
        }
        Ok(())
    }

    /// What is asked every [`SLOW`].
    fn slow(&mut self) -> Result<(), DeviceError> {
        let Some(way) = &mut self.way else { return Ok(()) };
        self.slow_due = Instant::now() + SLOW;
        let mut slow = [0];
        if way.read(&self.port, register::TEMP, &mut slow).is_ok() {
            self.temperature_c = f64::from(i8::from_le_bytes(slow));
        }
        if way.read(&self.port, register::SYS_ERR, &mut slow).is_ok() && slow != [0] {
            return Err(Fault::Reported { what: "system error", code: slow[0].into() }.into());
        }
        Ok(())
    }
}

impl Driver for Bno055 {
    fn open(&mut self) -> Result<(), DeviceError> {
        let mut way = match &self.port {
            PortName::Serial(_) => {
                Way::Uart(self.port.open_serial(115_200)?, Box::new(Framer::new(UartReplies::default())))
            }
            _ => Way::I2c(self.port.open_bus()?, self.address),
        };
        self.set_up(&mut way)?;
        self.way = Some(way);
        self.failures = 0;
        self.slow()
    }

    fn period(&self) -> Option<Duration> {
        Some(self.period)
    }

    fn poll(&mut self, out: &mut Outlet<'_>) -> Result<(), DeviceError> {
        let Some(way) = &mut self.way else { return Ok(()) };
        let begun = Instant::now();
        let mut data = [0; DATA_LENGTH];
        match way.read(&self.port, register::DATA, &mut data) {
            Ok(()) => {
                self.failures = 0;
                // The registers were read when the request was there, not when the answer was.
                let after_us = -1e6 * begun.elapsed().as_secs_f64();
                let reading = Reading::Imu(bno055::decode_data(&data, self.temperature_c));
                out(Ok(Heard { at: Instant::now(), stamp: None, after_us, reading }));
                // Behind what is waited for.
                if self.slow_due <= begun { self.slow() } else { Ok(()) }
            }
            Err(DeviceError::Frame(fault)) if self.failures < FAILURES_MAX => {
                self.failures += 1;
                out(Err(fault));
                Ok(())
            }
            Err(DeviceError::Silent { .. }) if self.failures < 2 => {
                self.failures += 1;
                out(Err(Fault::Malformed("answer that never ended")));
                Ok(())
            }
            Err(error) => Err(error),
        }
    }

    fn close(&mut self) {
        self.way = None;
    }
}
