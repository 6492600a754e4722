//! Second-order Butterworth low-pass, started with the mean of its first time constant (Laidig & Seel 2023,
//! section 3.2: no transient from a wrong initial state).

use std::f64::consts::{PI, SQRT_2};

use nalgebra::SVector;

/// Low-pass of `N` values sampled at a constant rate.
#[derive(Debug, Clone)]
pub struct LowPass<const N: usize> {
    tau_s: f64,
    period_s: f64,
    b0: f64,
    a: [f64; 2],
    sum: SVector<f64, N>,
    samples: f64,
    running: bool,
    state: [SVector<f64, N>; 2],
    output: SVector<f64, N>,
}

impl<const N: usize> LowPass<N> {
    /// Time constant `tau_s` for samples `period_s` apart.
    pub fn new(tau_s: f64, period_s: f64) -> Self {
        let zero = SVector::zeros();
        let mut filter = Self {
            tau_s,
            period_s,
            b0: 0.0,
            a: [0.0; 2],
            sum: zero,
            samples: 0.0,
            running: false,
            state: [zero; 2],
            output: zero,
        };
        filter.retune(period_s);
        filter
    }

    /// For samples `period_s` apart from now on; the output does not jump.
    pub fn retune(&mut self, period_s: f64) {
        self.period_s = period_s;
        // Cut-off √2/(2πτ): the step response has about the time constant τ.
        let cutoff_hz = SQRT_2 / (2.0 * PI * self.tau_s);
        let c = (PI * cutoff_hz * period_s).min(1.5).tan();
        let d = c * c + SQRT_2 * c + 1.0;
        self.b0 = c * c / d;
        self.a = [2.0 * (c * c - 1.0) / d, (1.0 - SQRT_2 * c + c * c) / d];
        if self.running {
            self.settle(self.output);
        }
    }

    /// As if `value` had come in for ever.
    fn settle(&mut self, value: SVector<f64, N>) {
        self.state = [value * (1.0 - self.b0), value * (self.b0 - self.a[1])];
        self.output = value;
        self.running = true;
    }

    /// Takes one sample; the output.
    pub fn push(&mut self, x: SVector<f64, N>) -> SVector<f64, N> {
        if !self.running {
            self.sum += x;
            self.samples += 1.0;
            self.output = self.sum / self.samples;
            if self.samples * self.period_s >= self.tau_s {
                self.settle(self.output);
            }
            return self.output;
        }
        // Transposed direct form II with b = b0 [1, 2, 1].
        let y = x * self.b0 + self.state[0];
        self.state[0] = x * (2.0 * self.b0) - y * self.a[0] + self.state[1];
        self.state[1] = x * self.b0 - y * self.a[1];
        self.output = y;
        y
    }

    /// The last output.
    pub fn output(&self) -> SVector<f64, N> {
        self.output
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_constant_comes_out_unchanged_from_the_first_sample() {
        let mut filter = LowPass::<1>::new(3.0, 0.01);
        for k in 0..2000 {
            if k == 700 {
                filter.retune(0.005);
            }
            assert!((filter.push(SVector::from([4.2])).x - 4.2).abs() < 1e-9);
        }
    }

    #[test]
    fn a_step_is_followed_within_a_few_time_constants() {
        let mut filter = LowPass::<1>::new(0.5, 0.01);
        for _ in 0..100 {
            filter.push(SVector::from([0.0]));
        }
        let mut at = Vec::new();
        for _ in 0..400 {
            at.push(filter.push(SVector::from([1.0])).x);
        }
        assert!(at[50] > 0.3 && at[50] < 0.9 && (at[399] - 1.0).abs() < 1e-3, "{} {}", at[50], at[399]);
    }
}
