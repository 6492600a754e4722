//! Heading: magnetic disturbance rejection (Laidig & Seel 2023, section 3.6).
//!
//! The magnetometer corrects heading alone, slowly, and not at all while the field's strength and dip differ from those
//! of the reference field. Deviation: before there is one (the paper wants fast turning, which a vehicle on strings
//! never does) a field that has been steady for five seconds is followed, at half the speed.

use nalgebra::{Vector2, Vector3};

use super::DEGREE;
use crate::estimate::filter::low_pass::LowPass;
use crate::frames::wrap_pi;

/// Low-pass of the field's strength and dip before they are judged, s.
const FIELD_TAU_S: f64 = 0.05;
/// Time constant of the reference field, s.
const FIELD_REFERENCE_TAU_S: f64 = 20.0;
/// Strength may differ by this fraction …
const FIELD_STRENGTH: f64 = 0.1;
/// … and dip by this, rad.
const FIELD_DIP_RAD: f64 = 10.0 * DEGREE;
/// A field becomes the reference after agreeing with itself this long while turning, s …
const FIELD_NEW_S: f64 = 20.0;
/// … at first this long, s …
const FIELD_FIRST_S: f64 = 5.0;
/// … counting only times of turning at least this fast, rad/s.
const FIELD_TURNING_RADPS: f64 = 20.0 * DEGREE;
/// The field must fit for this long before it is trusted again, s.
const FIELD_FIT_S: f64 = 0.5;
/// A disturbed field is rejected altogether this long, then followed more slowly by `FIELD_SLOWER`, s.
const FIELD_REJECT_S: f64 = 60.0;
const FIELD_SLOWER: f64 = 2.0;

/// δ, and how it is corrected.
#[derive(Debug, Clone)]
pub(super) struct Heading {
    delta_rad: f64,
    field: LowPass<2>,
    reference: Reference,
    rejected_s: f64,
    start_gain: f64,
    disagreement_rad: f64,
    /// Since the last sample.
    since_s: f64,
}

/// The reference field, strength (µT) and dip (rad), and the candidate that may replace it.
#[derive(Debug, Clone)]
struct Reference {
    field: Vector2<f64>,
    candidate: Vector2<f64>,
    candidate_s: f64,
    steady_s: f64,
    fit_s: f64,
    disturbed: bool,
}

impl Heading {
    pub fn new(period_s: f64) -> Self {
        Self {
            delta_rad: 0.0,
            field: LowPass::new(FIELD_TAU_S, period_s),
            reference: Reference {
                field: Vector2::zeros(),
                candidate: Vector2::zeros(),
                candidate_s: 0.0,
                steady_s: 0.0,
                fit_s: 0.0,
                disturbed: true,
            },
            rejected_s: 0.0,
            start_gain: 1.0,
            disagreement_rad: 0.0,
            since_s: 0.0,
        }
    }

    pub fn delta_rad(&self) -> f64 {
        self.delta_rad
    }

    pub fn disturbed(&self) -> bool {
        self.reference.disturbed
    }

    pub fn disagreement_rad(&self) -> f64 {
        self.disagreement_rad
    }

    pub fn wait(&mut self, dt_s: f64) {
        self.since_s += dt_s;
    }

    /// Takes a sample, turned into the level frame, and the slow rate of the vehicle.
    pub fn push(&mut self, level: &Vector3<f64>, slow_rate: &Vector3<f64>, tau_s: f64) {
        let strength = level.norm();
        if strength == 0.0 || !strength.is_finite() {
            return;
        }
        let t = self.since_s.clamp(1e-4, 1.0);
        self.since_s = 0.0;
        let now = self.field.push(Vector2::new(strength, -(level.z / strength).clamp(-1.0, 1.0).asin()));
        self.reference.check(&now, slow_rate, t);

        self.disagreement_rad = wrap_pi(level.x.atan2(level.y) - self.delta_rad);
        let mut gain = 1.0 - (-t / tau_s).exp();
        if self.reference.disturbed {
            // A vehicle that never turns fast finds no reference: it follows what has been steady from the start.
            let steady = !self.reference.known() && self.reference.steady_s >= FIELD_FIRST_S;
            if self.rejected_s <= FIELD_REJECT_S && !steady {
                self.rejected_s += t;
                gain = 0.0;
            } else {
                gain /= FIELD_SLOWER;
            }
        } else {
            self.rejected_s = (self.rejected_s - FIELD_SLOWER * t).max(0.0);
        }
        // At start a plain mean: 1, 1/2, 1/3, … until that is slower than the time constant.
        if self.start_gain > 0.0 {
            gain = gain.max(self.start_gain);
            self.start_gain = self.start_gain / (self.start_gain + 1.0);
            if self.start_gain * tau_s < t {
                self.start_gain = 0.0;
            }
        }
        self.delta_rad = wrap_pi(self.delta_rad + gain * self.disagreement_rad);
    }
}

impl Reference {
    /// Has there been one?
    fn known(&self) -> bool {
        self.field.x != 0.0
    }

    /// Does the field fit the reference field, or another that has been steady for long?
    fn check(&mut self, now: &Vector2<f64>, slow_rate: &Vector3<f64>, t: f64) {
        let fits = |other: &Vector2<f64>| {
            (now.x - other.x).abs() < FIELD_STRENGTH * other.x && (now.y - other.y).abs() < FIELD_DIP_RAD
        };
        let gain = 1.0 - (-t / FIELD_REFERENCE_TAU_S).exp();
        if fits(&self.field) {
            self.fit_s += t;
            if self.fit_s >= FIELD_FIT_S {
                self.disturbed = false;
                self.field += gain * (now - self.field);
            }
        } else {
            self.fit_s = 0.0;
            self.disturbed = true;
        }
        if fits(&self.candidate) {
            self.steady_s += t;
            if slow_rate.norm() >= FIELD_TURNING_RADPS {
                self.candidate_s += t;
            }
            self.candidate += gain * (now - self.candidate);
            let wait = if self.known() { FIELD_NEW_S } else { FIELD_FIRST_S };
            if self.disturbed && self.candidate_s >= wait {
                self.field = self.candidate;
                self.disturbed = false;
                self.fit_s = FIELD_FIT_S;
            }
        } else {
            self.candidate_s = 0.0;
            self.steady_s = 0.0;
            self.candidate = *now;
        }
    }
}
