//! Vibration of the rotors, as the inertial sensors feel it.
//!
//! a = Σ_r g_r [A₁ sin(θ_r + φ) + A₂ sin(2 θ_r + φ′)] + structure + white, with g = (ω / ω_ref)² u_r and slow modulation
//! of all of it. Each part is √s common to all sensors and √(1 − s) a sensor's own. The tones pass through the sensor's
//! filter H as H(jω) at the rotor's frequency and are taken at the very instant of the sample, so that **a rotor at 88 Hz
//! shows at 12 Hz** in samples at 100 Hz without any fast integration. The other parts are made at the flight loop's rate.
//! Measured on four IMUs of a Phantom 4: see `worlds/*.toml`.

use std::f64::consts::{SQRT_2, TAU};

use nalgebra::Complex;
use plumbline_core::sensor::noise::Stream;
use plumbline_core::types::ROTORS;

use super::conditions;

/// Gyroscope x y z, accelerometer x y z.
const AXES: usize = 6;
/// Once and twice a revolution.
const HARMONICS: [f64; 2] = [1.0, 2.0];

/// A second-order filter in discrete time, transposed direct form II.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Biquad {
    b: [f64; 3],
    a: [f64; 2],
    state: [f64; 2],
}

impl Biquad {
    /// Butterworth low-pass at `cutoff_hz` for samples at `rate_hz`, by the bilinear transform; above 0.45 of the rate it
    /// passes all.
    pub(crate) fn low_pass(cutoff_hz: f64, rate_hz: f64) -> Self {
        if cutoff_hz >= 0.45 * rate_hz {
            return Self { b: [1.0, 0.0, 0.0], a: [0.0; 2], state: [0.0; 2] };
        }
        let k = (0.5 * TAU * cutoff_hz / rate_hz).tan();
        let scale = 1.0 / (1.0 + SQRT_2 * k + k * k);
        let b = k * k * scale;
        Self {
            b: [b, 2.0 * b, b],
            a: [2.0 * (k * k - 1.0) * scale, (1.0 - SQRT_2 * k + k * k) * scale],
            state: [0.0; 2],
        }
    }

    /// Butterworth high-pass.
    fn high_pass(cutoff_hz: f64, rate_hz: f64) -> Self {
        let k = (0.5 * TAU * cutoff_hz / rate_hz).tan();
        let scale = 1.0 / (1.0 + SQRT_2 * k + k * k);
        let a = [2.0 * (k * k - 1.0) * scale, (1.0 - SQRT_2 * k + k * k) * scale];
        Self { b: [scale, -2.0 * scale, scale], a, state: [0.0; 2] }
    }

    /// A low-pass that has seen nothing but `x` for long.
    pub(crate) fn settle(&mut self, x: f64) {
        self.state[1] = (self.b[2] - self.a[1]) * x;
        self.state[0] = (self.b[1] - self.a[0]) * x + self.state[1];
    }

    /// The next output.
    pub(crate) fn step(&mut self, x: f64) -> f64 {
        let y = self.b[0] * x + self.state[0];
        self.state[0] = self.b[1] * x - self.a[0] * y + self.state[1];
        self.state[1] = self.b[2] * x - self.a[1] * y;
        y
    }
}

/// A Gauss–Markov process of one sigma.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Slow {
    value: f64,
}

impl Slow {
    /// One that has run for long.
    pub(crate) fn begun(stream: &mut Stream) -> Self {
        Self { value: stream.normal() }
    }

    /// Where it stands.
    pub(crate) fn value(&self) -> f64 {
        self.value
    }

    /// After `dt_s` with this time constant.
    pub(crate) fn step(&mut self, dt_s: f64, time_constant_s: f64, stream: &mut Stream) -> f64 {
        let keep = (-dt_s / time_constant_s).exp();
        self.value = keep * self.value + (1.0 - keep * keep).sqrt() * stream.normal();
        self.value
    }
}

/// What all sensors of a vehicle share.
#[derive(Debug, Clone)]
pub(crate) struct Vibration {
    conditions: conditions::Vibration,
    rotors: Rotors,
    stream: Stream,
    modulation: Slow,
    /// Common white noise of each axis, one sigma, new at each tick.
    white: [f64; AXES],
    /// Phases of the common tones.
    phases: Phases,
}

/// Angle, speed and strength of each rotor.
#[derive(Debug, Clone, Copy)]
struct Rotors {
    angle_rad: [f64; ROTORS],
    speed_radps: [f64; ROTORS],
    unbalance: [f64; ROTORS],
    modulation: f64,
    reference_radps: f64,
}

impl Rotors {
    fn gain(&self, rotor: usize) -> f64 {
        self.modulation * (self.speed_radps[rotor] / self.reference_radps).powi(2)
    }

    /// Mean over the rotors of the gain, for what no single rotor makes.
    fn level(&self) -> f64 {
        (0..ROTORS).map(|rotor| self.gain(rotor)).sum::<f64>() / ROTORS as f64
    }
}

/// e^{jφ} of each tone.
type Phases = [[[Complex<f64>; HARMONICS.len()]; ROTORS]; AXES];

fn phases(stream: &mut Stream) -> Phases {
    std::array::from_fn(|_| {
        std::array::from_fn(|_| std::array::from_fn(|_| Complex::from_polar(1.0, TAU * stream.uniform())))
    })
}

impl Vibration {
    /// With these numbers; `seed` draws unbalance and phases.
    pub(crate) fn new(conditions: conditions::Vibration, seed: u64) -> Self {
        let mut stream = Stream::new(seed, "vibration");
        let sigma = conditions.rotor_unbalance_sigma;
        let rotors = Rotors {
            angle_rad: std::array::from_fn(|_| TAU * stream.uniform()),
            speed_radps: [0.0; ROTORS],
            unbalance: std::array::from_fn(|_| (sigma * stream.normal() - sigma * sigma).exp()),
            modulation: 1.0,
            reference_radps: TAU * conditions.reference_rotor_hz,
        };
        let phases = phases(&mut stream);
        Self { conditions, rotors, stream, modulation: Slow::default(), white: [0.0; AXES], phases }
    }

    /// After `dt_s` with rotors that turn at `speed_radps` at its end.
    pub(crate) fn step(&mut self, speed_radps: &[f64; ROTORS], dt_s: f64) {
        for (angle, (now, before)) in
            self.rotors.angle_rad.iter_mut().zip(speed_radps.iter().zip(self.rotors.speed_radps))
        {
            *angle = (*angle + 0.5 * (now + before) * dt_s) % TAU;
        }
        self.rotors.speed_radps = *speed_radps;
        let sigma = self.conditions.amplitude_modulation_sigma;
        let tau = self.conditions.amplitude_modulation_time_constant_s;
        self.rotors.modulation = (sigma * self.modulation.step(dt_s, tau, &mut self.stream) - sigma * sigma).exp();
        self.white = std::array::from_fn(|_| self.stream.normal());
    }

    /// One sensor's own share; `stream` draws its phases, its filters cut at these frequencies and run at `rate_hz`.
    pub(crate) fn felt(&self, gyro_cutoff_hz: f64, accel_cutoff_hz: f64, rate_hz: f64, stream: &mut Stream) -> Felt {
        let c = &self.conditions;
        let s = c.shared_power_fraction;
        let own = phases(stream);
        let once = |axis: usize| if axis < 3 { c.gyr_1p_radps[axis] } else { c.acc_1p_mps2[axis - 3] };
        let twice = |axis: usize| if axis < 3 { c.gyr_2p_radps[axis] } else { c.acc_2p_mps2[axis - 3] };
        let tones = std::array::from_fn(|axis| {
            std::array::from_fn(|rotor| {
                std::array::from_fn(|harmonic| {
                    let amplitude = if harmonic == 0 { once(axis) } else { twice(axis) } * self.rotors.unbalance[rotor];
                    let common = self.phases[axis][rotor][harmonic] * s.sqrt();
                    (common + own[axis][rotor][harmonic] * (1.0 - s).sqrt()) * amplitude
                })
            })
        });
        let density = |axis: usize| {
            if axis < 3 { c.gyr_broadband_radps_per_sqrthz[axis] } else { c.acc_broadband_mps2_per_sqrthz[axis - 3] }
        };
        let structure = |axis: usize| if axis < 3 { 0.0 } else { c.acc_structure_mps2_per_sqrthz[axis - 3] };
        let nyquist = (0.5 * rate_hz).sqrt();
        let [low_hz, high_hz] = c.structure_band_hz;
        Felt {
            tones,
            cutoff_hz: [gyro_cutoff_hz, accel_cutoff_hz],
            white: std::array::from_fn(|axis| density(axis) * nyquist),
            structure: std::array::from_fn(|axis| structure(axis) * nyquist),
            band: [[Biquad::high_pass(low_hz, rate_hz), Biquad::low_pass(high_hz, rate_hz)]; AXES],
            common: [s.sqrt(), (1.0 - s).sqrt()],
        }
    }
}

/// The vibration of one sensor.
#[derive(Debug, Clone)]
pub(crate) struct Felt {
    /// Amplitude and phase of each tone.
    tones: Phases,
    /// Of the gyroscope's and the accelerometer's filter.
    cutoff_hz: [f64; 2],
    /// One sigma at the flight loop's rate.
    white: [f64; AXES],
    structure: [f64; AXES],
    band: [[Biquad; 2]; AXES],
    /// Shares of common and own noise.
    common: [f64; 2],
}

impl Felt {
    /// White noise and structure of a new tick, before the sensor's filter.
    pub(crate) fn noise(&mut self, vibration: &Vibration, stream: &mut Stream) -> [f64; AXES] {
        let level = vibration.rotors.level();
        std::array::from_fn(|axis| {
            let n = self.common[0] * vibration.white[axis] + self.common[1] * stream.normal();
            let [high, low] = &mut self.band[axis];
            level * (self.white[axis] * n + low.step(high.step(self.structure[axis] * n)))
        })
    }

    /// The tones `back_s` before now: behind the sensor's filter, and before it.
    pub(crate) fn tones(&self, vibration: &Vibration, back_s: f64) -> ([f64; AXES], [f64; AXES]) {
        let (mut behind, mut before) = ([0.0; AXES], [0.0; AXES]);
        for rotor in 0..ROTORS {
            let (speed, gain) = (vibration.rotors.speed_radps[rotor], vibration.rotors.gain(rotor));
            if gain == 0.0 {
                continue;
            }
            let angle = vibration.rotors.angle_rad[rotor] - speed * back_s;
            for (h, harmonic) in HARMONICS.into_iter().enumerate() {
                let turning = Complex::from_polar(gain, harmonic * angle);
                let filtered = self.cutoff_hz.map(|hz| turning * response(harmonic * speed / TAU, hz));
                for axis in 0..AXES {
                    let tone = self.tones[axis][rotor][h];
                    before[axis] += (turning * tone).im;
                    behind[axis] += (filtered[axis / 3] * tone).im;
                }
            }
        }
        (behind, before)
    }
}

/// Of a second-order Butterworth low-pass.
fn response(frequency_hz: f64, cutoff_hz: f64) -> Complex<f64> {
    let r = frequency_hz / cutoff_hz;
    Complex::new(1.0 - r * r, SQRT_2 * r).inv()
}

#[cfg(test)]
mod tests;
