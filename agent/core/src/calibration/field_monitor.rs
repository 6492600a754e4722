//! Does a magnetometer's calibration still fit? Judged in flight by the strength of the calibrated field, and
//! repaired where a hard iron that came or went explains the misfit.
//!
//! | symbol | meaning | unit |
//! |---|---|---|
//! | c | calibrated field, turning with the body | µT |
//! | d, P | hard iron that the calibration does not know of, its covariance | µT, µT² |
//! | F, σ | strength and misfit of one sample, from the calibration | µT |
//! | ν | innovation F − |c − d|, one scalar: H = −(c − d)/|c − d| | µT |
//!
//! A Kalman filter over d: turning, the three parts are seen one after the other. The mean of ν²/S over
//! `MEMORY_S` says whether the calibration fits; when it does not, P is opened and d is found anew. Until it is,
//! and has explained `PROBATION` directions, the samples are withheld: a wrong heading is worse than none. A field
//! that no constant d explains (a magnet in the room) stays withheld.

use nalgebra::{Matrix3, Vector3};

use super::magnetometer::FieldModel;

/// Memory of the consistency, s.
const MEMORY_S: f64 = 1.0;
/// Mean of ν²/S above which the calibration no longer fits.
const MISFIT: f64 = 6.0;
/// Single innovations count at most this much.
const MISFIT_CAP: f64 = 50.0;
/// The field of a room differs from place to place by this fraction of F.
const ROOM: f64 = 0.03;
/// A hard iron found anew is on probation for so many directions …
const PROBATION: u32 = 100;
/// … and is trusted when the mean of ν²/S over this many …
const TRUST_MEMORY: f64 = 50.0;
/// … is at most this.
const TRUST: f64 = 2.0;
/// Hard iron drifts by this in a second, µT.
const WALK_UT: f64 = 0.02;
/// What the calibration leaves of hard iron, one-sigma, µT.
const START_SIGMA_UT: f64 = 0.5;
/// Opened to this fraction of F when it no longer fits.
const OPENED: f64 = 0.3;
/// Known well enough to be used: this fraction of F, all directions together.
const USABLE: f64 = 0.06;
/// A sample counts when its direction is this far from the last that did, rad: errors of one place are common.
const APART_RAD: f64 = 0.07;
/// A magnet on the vehicle is weaker than this fraction of F; more is a magnet in the room.
const HARD_MAX: f64 = 1.5;

/// The state of one magnetometer's calibration.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FieldMonitor {
    model: FieldModel,
    offset_ut: Vector3<f64>,
    covariance: Matrix3<f64>,
    misfit: f64,
    /// Mean of ν²/S over directions, and how many of the probation are left.
    doubt: f64,
    probation: u32,
    last_s: Option<f64>,
    counted: Option<Vector3<f64>>,
    refits: u32,
    withheld: u64,
    samples: u64,
}

impl FieldMonitor {
    /// Trusts `model`.
    pub fn new(model: FieldModel) -> Self {
        Self {
            model,
            offset_ut: Vector3::zeros(),
            covariance: Matrix3::identity() * START_SIGMA_UT.powi(2),
            misfit: 1.0,
            doubt: 1.0,
            probation: 0,
            last_s: None,
            counted: None,
            refits: 0,
            withheld: 0,
            samples: 0,
        }
    }

    /// The calibrated field for a reading at `time_s`; `None` while the calibration does not fit.
    pub fn apply(&mut self, time_s: f64, reading_ut: &Vector3<f64>) -> Option<Vector3<f64>> {
        let field = self.model.triad.apply(reading_ut);
        self.samples += 1;
        if !field.iter().all(|v| v.is_finite()) {
            self.withheld += 1;
            return None;
        }
        let dt = self.last_s.map_or(0.0, |before| (time_s - before).clamp(0.0, 1.0));
        self.last_s = Some(time_s);
        self.covariance += Matrix3::identity() * (WALK_UT * WALK_UT * dt);
        let r = self.model.sigma_ut.powi(2) + (ROOM * self.model.field_ut).powi(2);
        let (innovation, h, mut s) = self.innovation(&field, r);
        let normalised = (innovation * innovation / s).min(MISFIT_CAP);
        self.misfit += (dt / MEMORY_S).min(1.0) * (normalised - self.misfit);
        let opened = (OPENED * self.model.field_ut).powi(2);
        if self.misfit > MISFIT && self.covariance.trace() < opened {
            self.open(opened);
            self.refits += 1;
            s = (self.covariance * h).dot(&h) + r;
        }
        if self.counted.is_none_or(|at| at.angle(&field) > APART_RAD) {
            self.counted = Some(field);
            self.doubt += (normalised - self.doubt) / TRUST_MEMORY;
            self.probation = match self.probation {
                // The last one is left when it explains what it sees.
                0 => 0,
                1 if self.doubt > TRUST => 1,
                left => left - 1,
            };
            let gain = self.covariance * h / s;
            self.offset_ut += gain * innovation;
            let kh = gain * (self.covariance * h).transpose();
            self.covariance -= kh;
            self.covariance = (self.covariance + self.covariance.transpose()) * 0.5;
            let most = HARD_MAX * self.model.field_ut;
            if self.offset_ut.norm() > most {
                self.offset_ut = Vector3::zeros();
                self.open(opened);
            }
        }
        if self.fits() {
            Some(field - self.offset_ut)
        } else {
            self.withheld += 1;
            None
        }
    }

    /// Forgets what was estimated of d.
    fn open(&mut self, variance: f64) {
        self.covariance = Matrix3::identity() * variance;
        self.misfit = 1.0;
        self.doubt = 3.0 * TRUST;
        self.probation = PROBATION;
        self.counted = None;
    }

    /// Innovation F − |c − d|, its H and S.
    fn innovation(&self, field: &Vector3<f64>, r: f64) -> (f64, Vector3<f64>, f64) {
        let left = field - self.offset_ut;
        let h = -left.try_normalize(1e-9).unwrap_or_else(Vector3::x);
        (self.model.field_ut - left.norm(), h, (self.covariance * h).dot(&h) + r)
    }

    /// Does the calibration, with what was learnt since, describe the field now?
    pub fn fits(&self) -> bool {
        self.probation == 0 && self.misfit <= MISFIT && self.covariance.trace().sqrt() <= USABLE * self.model.field_ut
    }

    /// Hard iron found since the calibration, µT.
    pub fn hard_iron_since_ut(&self) -> Vector3<f64> {
        self.offset_ut
    }

    /// How often the calibration stopped fitting.
    pub fn refits(&self) -> u32 {
        self.refits
    }

    /// Samples withheld, of how many.
    pub fn withheld(&self) -> (u64, u64) {
        (self.withheld, self.samples)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibration::inertial::Triad;
    use nalgebra::UnitQuaternion;

    const FIELD: [f64; 3] = [0.0, 20.0, -40.0];

    fn model() -> FieldModel {
        FieldModel { triad: Triad::identity(), field_ut: Vector3::from(FIELD).norm(), sigma_ut: 0.6 }
    }

    /// The field in a body that tumbles, t seconds on.
    fn tumbling(t: f64) -> Vector3<f64> {
        let turn = UnitQuaternion::from_euler_angles(1.2 * (0.9 * t).sin(), 1.1 * (0.7 * t).cos(), 0.8 * t);
        turn.inverse_transform_vector(&Vector3::from(FIELD))
    }

    #[test]
    fn a_calibration_that_fits_is_left_alone() {
        let mut monitor = FieldMonitor::new(model());
        for k in 0..3000 {
            let t = f64::from(k) * 0.01;
            let found = monitor.apply(t, &tumbling(t)).expect("never withheld");
            assert!((found - tumbling(t)).norm() < 1.0);
        }
        assert!(monitor.fits() && monitor.refits() == 0 && monitor.withheld() == (0, 3000));
    }

    #[test]
    fn a_magnet_that_comes_is_noticed_and_learnt() {
        let magnet = Vector3::new(-3.0, 5.0, 14.0);
        let mut monitor = FieldMonitor::new(model());
        let (mut noticed, mut back) = (None, None);
        for k in 0..6000 {
            let t = f64::from(k) * 0.01;
            let there = if t < 20.0 { Vector3::zeros() } else { magnet };
            let found = monitor.apply(t, &(tumbling(t) + there));
            if t > 20.0 && found.is_none() {
                noticed.get_or_insert(t);
            }
            if noticed.is_some() && found.is_some() && back.is_none() {
                back = Some(t);
            }
        }
        assert!(noticed.unwrap() < 21.5, "{noticed:?}");
        assert!(back.unwrap() < 40.0, "{back:?}");
        assert!((monitor.hard_iron_since_ut() - magnet).norm() < 1.0, "{}", monitor.hard_iron_since_ut());
    }

    #[test]
    fn a_field_that_no_hard_iron_explains_is_withheld() {
        let mut monitor = FieldMonitor::new(model());
        for k in 0..6000 {
            let t = f64::from(k) * 0.01;
            // A magnet in the room: strength changes with the place, not with the attitude.
            let scale = 1.0 + 0.6 * (0.53 * t).sin();
            monitor.apply(t, &(tumbling(t) * scale));
        }
        let (withheld, of) = monitor.withheld();
        assert!(withheld * 2 > of, "{withheld} of {of}");
        assert_eq!(monitor.apply(100.0, &Vector3::repeat(f64::NAN)), None);
    }
}
