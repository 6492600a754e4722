//! Barometers: TE MS5611 and Bosch BMP280, their compensation as the data sheets give it.

use crate::fault::Fault;
use crate::framer::le;
use crate::reading::BarometerReading;

/// The least raw value of so many bits that reaches something; all of them where none does.
fn least(bits: u32, reaches: impl Fn(u32) -> bool) -> u32 {
    let (mut low, mut high) = (0, (1 << bits) - 1);
    while low < high {
        let middle = low + (high - low) / 2;
        if reaches(middle) { high = middle } else { low = middle + 1 }
    }
    low
}

/// MS5611: commands.
pub mod ms5611 {
    use super::{BarometerReading, Fault, least};

    /// Reset; 2.8 ms.
    pub const RESET: u8 = 0x1E;
    /// First of eight words of factory calibration.
    pub const PROM: u8 = 0xA0;
    /// Converts pressure, temperature (oversampling 4096: 9.04 ms).
    pub const CONVERT: [u8; 2] = [0x48, 0x58];
    /// Reads what was converted, three bytes.
    pub const READ: u8 = 0x00;

    /// Checks the four bits of checksum in the last of the eight words (AN520).
    ///
    /// # Errors
    /// The checksum is another one, or nothing is there.
    pub fn check(prom: &[u16; 8]) -> Result<(), Fault> {
        // A bus that is held low passes the checksum.
        if prom.iter().all(|word| *word == 0) {
            return Err(Fault::Malformed("calibration: nothing but zeros"));
        }
        let got = prom[7] & 0xf;
        let expected = crc4(prom);
        if expected == got { Ok(()) } else { Err(Fault::Checksum { expected: expected.into(), got: got.into() }) }
    }

    /// The checksum of AN520.
    pub fn crc4(prom: &[u16; 8]) -> u16 {
        let mut remainder = 0_u16;
        for (index, word) in prom.iter().enumerate() {
            let word = if index == 7 { word & 0xff00 } else { *word };
            for byte in word.to_be_bytes() {
                remainder ^= u16::from(byte);
                for _ in 0..8 {
                    remainder = if remainder & 0x8000 != 0 { (remainder << 1) ^ 0x3000 } else { remainder << 1 };
                }
            }
        }
        remainder >> 12 & 0xf
    }

    /// Raw pressure and temperature of a reading: what [`compensate`] finds it in again.
    pub fn encode(prom: &[u16; 8], reading: &BarometerReading) -> [u32; 2] {
        let raw_t = least(24, |raw| compensate(prom, 0, raw).temperature_c >= reading.temperature_c);
        [least(24, |raw| compensate(prom, raw, raw_t).pressure_pa >= reading.pressure_pa), raw_t]
    }

    /// Pressure and temperature of raw values (24 bit), second order included.
    pub fn compensate(prom: &[u16; 8], raw_pressure: u32, raw_temperature: u32) -> BarometerReading {
        let c = prom.map(i64::from);
        let (d1, d2) = (i64::from(raw_pressure), i64::from(raw_temperature));
        let dt = d2 - (c[5] << 8);
        let mut temperature = 2000 + ((dt * c[6]) >> 23);
        let mut off = (c[2] << 16) + ((c[4] * dt) >> 7);
        let mut sens = (c[1] << 15) + ((c[3] * dt) >> 8);
        if temperature < 2000 {
            let below = (temperature - 2000).pow(2);
            let (mut off2, mut sens2) = (5 * below / 2, 5 * below / 4);
            if temperature < -1500 {
                let far = (temperature + 1500).pow(2);
                off2 += 7 * far;
                sens2 += 11 * far / 2;
            }
            temperature -= (dt * dt) >> 31;
            off -= off2;
            sens -= sens2;
        }
        let pressure = (((d1 * sens) >> 21) - off) >> 15;
        BarometerReading { pressure_pa: pressure as f64, temperature_c: temperature as f64 * 0.01 }
    }
}

/// BMP280: registers.
pub mod bmp280 {
    use super::{BarometerReading, le, least};

    /// Identity, 0x58.
    pub const ID: u8 = 0xD0;
    /// What it holds.
    pub const IDENTITY: u8 = 0x58;
    /// Factory calibration, 24 bytes.
    pub const CALIBRATION: u8 = 0x88;
    /// Oversampling and mode; then filter and standby.
    pub const CONTROL: u8 = 0xF4;
    /// Temperature × 1, pressure × 8, normal mode; no standby, filter off.
    pub const SETTING: [u8; 2] = [0x33, 0x00];
    /// Pressure and temperature, 20 bit each, in six bytes.
    pub const DATA: u8 = 0xF7;

    /// The data registers before anything was converted, as after a reset.
    pub const EMPTY: [u8; 6] = [0x80, 0, 0, 0x80, 0, 0];

    /// The data registers of a reading: what [`compensate`] finds it in again.
    pub fn encode(calibration: &[u8; 24], reading: &BarometerReading) -> [u8; 6] {
        let data = |raw_p: u32, raw_t: u32| {
            let [p, t] = [raw_p, raw_t].map(|raw| (raw << 4).to_be_bytes());
            [p[1], p[2], p[3], t[1], t[2], t[3]]
        };
        let seen = |raw_p, raw_t| compensate(calibration, &data(raw_p, raw_t));
        let raw_t = least(20, |raw| seen(0, raw).temperature_c >= reading.temperature_c);
        // The more pressure, the less its register holds.
        let raw_p = least(20, |raw| seen(raw, raw_t).pressure_pa <= reading.pressure_pa);
        data(raw_p, raw_t)
    }

    /// Pressure and temperature of the data registers (3.11.3, in floating point as 8.1).
    pub fn compensate(calibration: &[u8; 24], data: &[u8; 6]) -> BarometerReading {
        let unsigned = |index: usize| f64::from(le::u16(calibration, 2 * index));
        let signed = |index: usize| f64::from(le::i16(calibration, 2 * index));
        let raw = |at: usize| {
            let [msb, lsb, xlsb] = le::bytes(data, at);
            f64::from((u32::from(msb) << 12) | (u32::from(lsb) << 4) | (u32::from(xlsb) >> 4))
        };
        let (raw_p, raw_t) = (raw(0), raw(3));
        let (t1, t2, t3) = (unsigned(0), signed(1), signed(2));
        let fine = (raw_t / 16_384.0 - t1 / 1024.0) * t2 + (raw_t / 131_072.0 - t1 / 8192.0).powi(2) * t3;
        let mut v1 = fine / 2.0 - 64_000.0;
        let mut v2 = v1 * v1 * signed(8) / 32_768.0 + v1 * signed(7) * 2.0;
        v2 = v2 / 4.0 + signed(6) * 65_536.0;
        v1 = (signed(5) * v1 * v1 / 524_288.0 + signed(4) * v1) / 524_288.0;
        v1 = (1.0 + v1 / 32_768.0) * unsigned(3);
        let mut p = (1_048_576.0 - raw_p - v2 / 4096.0) * 6250.0 / v1;
        p += (signed(11) * p * p / 2_147_483_648.0 + p * signed(10) / 32_768.0 + signed(9)) / 16.0;
        BarometerReading { pressure_pa: p, temperature_c: fine / 5120.0 }
    }
}
