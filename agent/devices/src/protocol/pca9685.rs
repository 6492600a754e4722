//! NXP PCA9685: sixteen pulses at one rate, 12 bit each.

/// Mode 1.
pub const MODE1: u8 = 0x00;
/// Registers count up by themselves; not asleep.
pub const AWAKE: u8 = 0x20;
/// The same, asleep: only then the rate can be set.
pub const ASLEEP: u8 = 0x30;
/// First of four bytes a channel: on (low, high), off (low, high).
pub const CHANNELS: u8 = 0x06;
/// Divider of the internal clock.
pub const PRESCALE: u8 = 0xFE;
/// Internal clock, Hz.
const CLOCK_HZ: f64 = 25e6;
const STEPS: f64 = 4096.0;

/// The divider for about `rate_hz`.
pub fn prescale(rate_hz: f64) -> u8 {
    ((CLOCK_HZ / (STEPS * rate_hz)).round() - 1.0).clamp(3.0, 255.0) as u8
}

/// The rate that a divider gives, Hz.
pub fn rate_hz(prescale: u8) -> f64 {
    CLOCK_HZ / (STEPS * (f64::from(prescale) + 1.0))
}

/// The four bytes of a channel for a pulse of `width_us` at that divider.
pub fn encode_channel(width_us: f64, prescale: u8) -> [u8; 4] {
    let steps = (width_us * 1e-6 * rate_hz(prescale) * STEPS).round().clamp(0.0, STEPS - 1.0);
    let [low, high] = (steps as u16).to_le_bytes();
    [0, 0, low, high]
}

/// The pulse of a channel's four bytes, µs; 0 where it is off.
pub fn decode_channel(bytes: [u8; 4], prescale: u8) -> f64 {
    let [_, _, low, high] = bytes;
    if high & 0x10 != 0 {
        return 0.0;
    }
    f64::from(u16::from_le_bytes([low, high & 0xf])) / STEPS / rate_hz(prescale) * 1e6
}
