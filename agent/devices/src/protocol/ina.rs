//! TI INA219 and INA226: voltage of the battery. Registers are big-endian words.

/// Bus voltage of both.
pub const BUS_VOLTAGE: u8 = 0x02;
/// INA226: the maker, "TI".
pub const MANUFACTURER: u8 = 0xFE;
/// What it holds.
pub const TI: u16 = 0x5449;
/// INA219: configuration, and what it holds after a reset.
pub const CONFIGURATION: u8 = 0x00;
/// INA219 after a reset: 32 V range.
pub const INA219_RESET: u16 = 0x399F;

/// Volts of the bus register of an INA219: 4 mV from bit 3 on; `None` where its overflow flag is set.
pub fn ina219_v(word: u16) -> Option<f64> {
    (word & 1 == 0).then(|| f64::from(word >> 3) * 4e-3)
}

/// Volts of the bus register of an INA226: 1.25 mV.
pub fn ina226_v(word: u16) -> f64 {
    f64::from(word & 0x7fff) * 1.25e-3
}

/// The bus register of an INA219 at this voltage, its conversion done.
pub fn encode_ina219(voltage_v: f64) -> u16 {
    (((voltage_v / 4e-3).round() as u16) << 3) | 2
}

/// The bus register of an INA226 at this voltage.
pub fn encode_ina226(voltage_v: f64) -> u16 {
    (voltage_v / 1.25e-3).round() as u16 & 0x7fff
}
