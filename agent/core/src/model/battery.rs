//! A lithium-polymer pack: open-circuit voltage falls with charge, and sags with current.
//!
//! V = cells · v(s) − R I − U, with s the charge left (0..1) and v(s) a piecewise line through the usual
//! discharge curve of a LiPo cell; the polarisation U follows R₁ I with a time constant, where a pack has one. The current follows from the rotors' ideal induced power
//! P = Σ T^1.5 / √(2 ρ A) (momentum theory): I = P / (η V) + I₀. Assumes one temperature and a healthy pack.

use serde::Deserialize;

/// Nominal voltage of one cell, V.
pub const CELL_NOMINAL_V: f64 = 3.7;
/// Ideal induced power over electrical power: figure of merit of a small propeller in hover (0.69, UIUC static data)
/// times motor and speed controller (0.76).
pub const EFFICIENCY: f64 = 0.52;
/// Draw of the electronics, A (chosen).
const ELECTRONICS_A: f64 = 0.6;
/// Open-circuit voltage of a cell against the charge left.
const CELL_CURVE: [(f64, f64); 9] = [
    (0.0, 2.50),
    (0.02, 3.20),
    (0.05, 3.50),
    (0.10, 3.65),
    (0.20, 3.72),
    (0.40, 3.79),
    (0.60, 3.88),
    (0.80, 4.02),
    (1.0, 4.20),
];

/// What is printed on the pack, and its resistance.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BatteryPack {
    /// Cells in series.
    pub cells: u32,
    /// Capacity, Ah.
    pub capacity_ah: f64,
    /// Resistance of pack and leads, Ω.
    pub internal_resistance_ohm: f64,
}

impl BatteryPack {
    /// A pack of `cells` in series.
    pub const fn lipo(cells: u32, capacity_ah: f64, internal_resistance_ohm: f64) -> Self {
        Self { cells, capacity_ah, internal_resistance_ohm }
    }

    /// Voltage at which motor curves are measured, V.
    pub fn nominal_v(&self) -> f64 {
        f64::from(self.cells) * CELL_NOMINAL_V
    }

    /// Open-circuit voltage with `charge` (0..1) left, V.
    pub fn open_circuit_v(&self, charge: f64) -> f64 {
        f64::from(self.cells) * interpolate(charge, CELL_CURVE.iter().copied())
    }

    /// What the electronics take, W.
    pub fn electronics_w(&self) -> f64 {
        ELECTRONICS_A * self.nominal_v()
    }

    /// Current drawn at `voltage_v` while the rotors' ideal induced power is `induced_power_w`, A.
    pub fn current_a(&self, induced_power_w: f64, voltage_v: f64) -> f64 {
        let power_w = induced_power_w.max(0.0) / EFFICIENCY + self.electronics_w();
        if voltage_v > 0.0 { power_w / voltage_v } else { 0.0 }
    }

    /// Charge left (0..1) as read from the voltage with `current_a` flowing (0 when unknown).
    pub fn charge_from_voltage(&self, voltage_v: f64, current_a: f64) -> f64 {
        let cell_v = (voltage_v + self.internal_resistance_ohm * current_a) / f64::from(self.cells);
        interpolate(cell_v, CELL_CURVE.iter().map(|&(charge, v)| (v, charge)))
    }
}

/// Points of a discharge curve.
const CURVE_POINTS: usize = CELL_CURVE.len() + 1;

/// A pack being discharged.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Battery {
    pack: BatteryPack,
    curve: [(f64, f64); CURVE_POINTS],
    /// R₁, Ω, and its time constant, s.
    polarised: (f64, f64),
    polarisation_v: f64,
    charge: f64,
    voltage_v: f64,
    current_a: f64,
}

impl Battery {
    /// `pack` with `charge` (clipped to 0..1) left and no load.
    pub fn new(pack: BatteryPack, charge: f64) -> Self {
        let charge = charge.clamp(0.0, 1.0);
        let curve = std::array::from_fn(|i| CELL_CURVE[i.min(CELL_CURVE.len() - 1)]);
        let voltage_v = pack.open_circuit_v(charge);
        Self { pack, curve, polarised: (0.0, 1.0), polarisation_v: 0.0, charge, voltage_v, current_a: 0.0 }
    }

    /// The same with a curve measured at five charges from 0.2 on, V a cell, and with a polarisation of `ohm` that
    /// follows the current with `time_constant_s`.
    pub fn measured(mut self, charge: [f64; 5], cell_v: [f64; 5], ohm: f64, time_constant_s: f64) -> Self {
        let kept = CELL_CURVE.iter().filter(|(c, _)| *c < charge[0]);
        let last = CELL_CURVE.iter().filter(|(c, _)| *c > charge[4]);
        let points = kept.copied().chain(charge.into_iter().zip(cell_v)).chain(last.copied());
        self.curve.iter_mut().zip(points).for_each(|(to, from)| *to = from);
        self.polarised = (ohm, time_constant_s);
        self.voltage_v = self.open_circuit_v();
        self
    }

    fn open_circuit_v(&self) -> f64 {
        f64::from(self.pack.cells) * interpolate(self.charge, self.curve.iter().copied())
    }

    /// Draws what an ideal induced power of `induced_power_w` takes for `dt_s`.
    pub fn draw(&mut self, induced_power_w: f64, dt_s: f64) {
        let open_v = self.open_circuit_v() - self.polarisation_v;
        let r = self.pack.internal_resistance_ohm;
        let power_w = induced_power_w.max(0.0) / EFFICIENCY + self.pack.electronics_w();
        // V = V₀ − R P / V: the larger root; past the power the pack can give, the half-voltage point.
        let root = (open_v * open_v - 4.0 * r * power_w).max(0.0).sqrt();
        self.voltage_v = 0.5 * (open_v + root);
        self.current_a = self.pack.current_a(induced_power_w, self.voltage_v);
        let (ohm, time_constant_s) = self.polarised;
        self.polarisation_v += (ohm * self.current_a - self.polarisation_v) * (1.0 - (-dt_s / time_constant_s).exp());
        let used = self.current_a * dt_s / (3600.0 * self.pack.capacity_ah);
        self.charge = (self.charge - used).max(0.0);
    }

    /// Voltage at the terminals, V.
    pub fn voltage_v(&self) -> f64 {
        self.voltage_v
    }

    /// Current drawn, A.
    pub fn current_a(&self) -> f64 {
        self.current_a
    }

    /// Charge left, 0..1.
    pub fn charge(&self) -> f64 {
        self.charge
    }

    /// Terminal over nominal voltage: what a motor's speed scales with.
    pub fn voltage_ratio(&self) -> f64 {
        self.voltage_v / self.pack.nominal_v()
    }
}

/// Piecewise line through ascending `points`, held beyond the ends.
fn interpolate(x: f64, points: impl Iterator<Item = (f64, f64)>) -> f64 {
    let mut before: Option<(f64, f64)> = None;
    for (x1, y1) in points {
        if x <= x1 {
            return match before {
                Some((x0, y0)) => y0 + (y1 - y0) * (x - x0) / (x1 - x0),
                None => y1,
            };
        }
        before = Some((x1, y1));
    }
    before.map_or(0.0, |(_, y)| y)
}

#[cfg(test)]
mod tests {
    use super::*;

    const PACK: BatteryPack = BatteryPack::lipo(3, 5.1, 0.015);

    #[test]
    fn charge_is_read_through_the_sag() {
        for (charge, power_w) in [(0.9, 0.0), (0.9, 150.0), (0.5, 150.0), (0.3, 60.0)] {
            let mut battery = Battery::new(PACK, charge);
            battery.draw(power_w, 0.005);
            let current_a = PACK.current_a(power_w, battery.voltage_v());
            let read = PACK.charge_from_voltage(battery.voltage_v(), current_a);
            assert!((read - charge).abs() < 1e-4, "{charge} under {power_w} W reads {read}");
        }
    }

    #[test]
    fn sags_under_load_and_recovers() {
        let mut battery = Battery::new(PACK, 1.0);
        assert!((battery.voltage_v() - 12.6).abs() < 1e-12);
        battery.draw(200.0, 0.005);
        let loaded = battery.voltage_v();
        // P = V I holds, and V = V0 - R I.
        assert!((12.6 - 0.015 * battery.current_a() - loaded).abs() < 1e-6, "{loaded}");
        assert!(loaded < 12.3);
        battery.draw(0.0, 0.005);
        assert!(battery.voltage_v() > 12.5);
    }

    /// GIVEN a pack whose curve and polarisation were measured WHEN it is loaded THEN it sags at once by R I, further by R₁ I
    /// with the time constant, and recovers as slowly.
    #[test]
    fn a_measured_pack_sags_at_once_and_then_slowly() {
        let (charge, cell_v) = ([0.2, 0.4, 0.6, 0.8, 0.95], [3.687, 3.755, 3.871, 4.018, 4.132]);
        let mut battery = Battery::new(PACK, 0.6).measured(charge, cell_v, 0.018, 5.0);
        assert!((battery.voltage_v() - 3.0 * 3.871).abs() < 1e-9);
        battery.draw(100.0, 0.005);
        let at_once = battery.voltage_v();
        assert!((3.0 * 3.871 - 0.015 * battery.current_a() - at_once).abs() < 1e-4, "{at_once}");
        (0..1000).for_each(|_| battery.draw(100.0, 0.005));
        // 5 s later: what its charge has lost, and 1 − 1/e of R₁ I. At the same power more current flows as it sags.
        let used_v = 3.0 * (3.871 - 3.755) / 0.2 * (0.6 - battery.charge());
        let more_v = at_once - battery.voltage_v() - used_v;
        assert!((more_v / (0.018 * battery.current_a()) - 0.632).abs() < 0.03, "{more_v}");
        battery.draw(0.0, 0.005);
        assert!(battery.voltage_v() < 3.0 * 3.871 - 0.1);
        for (s, volts) in charge.into_iter().zip(cell_v) {
            let full = Battery::new(PACK, s).measured(charge, cell_v, 0.018, 5.0);
            assert!((full.voltage_v() - 3.0 * volts).abs() < 1e-9);
        }
        let ends = [0.0, 1.0].map(|s| Battery::new(PACK, s).measured(charge, cell_v, 0.018, 5.0).voltage_v());
        assert_eq!(ends, [7.5, 4.2 * 3.0]);
    }

    #[test]
    fn empties_in_the_time_its_capacity_says() {
        let mut battery = Battery::new(PACK, 1.0);
        let mut seconds = 0.0;
        let mut ampere_hours = 0.0;
        while battery.charge() > 0.0 {
            battery.draw(120.0, 0.5);
            ampere_hours += battery.current_a() * 0.5 / 3600.0;
            seconds += 0.5;
            assert!(seconds < 7200.0);
        }
        assert!((ampere_hours - 5.1).abs() < 0.01, "{ampere_hours}");
    }

    #[test]
    fn charge_is_read_back_from_voltage() {
        for charge in [0.05, 0.3, 0.77, 1.0] {
            assert!((PACK.charge_from_voltage(PACK.open_circuit_v(charge), 0.0) - charge).abs() < 1e-9);
        }
        assert_eq!(PACK.charge_from_voltage(1.0, 0.0), 0.0);
    }
}
