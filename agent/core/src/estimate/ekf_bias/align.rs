//! Start-up: attitude and gyroscope bias from the first half second at rest, or the second, or the first second in motion.
//!
//! The gyroscope is integrated from the first sample (start_from_body); specific force and field are turned
//! into the frame of the start and averaged there, so that turning does not smear them. At rest the mean
//! rate is the bias. In motion the mean force is gravity plus (v₁ − v₀)/T, unknown without velocity: the
//! tilt is then certain to `TILT_SIGMA_MOVING_RAD` only and the filter does the rest.

use nalgebra::{UnitQuaternion, Vector3};

use crate::model::attitude;

/// Averaging time at rest, s.
const REST_S: f64 = 0.5;
/// Averaging time in motion, s.
const MOVING_S: f64 = 1.0;
/// At rest the rate, bias included, stays below this, rad/s.
const REST_RATE_RADPS: f64 = 0.08;
/// … and scatters less than this, rad/s.
const REST_RATE_SCATTER_RADPS: f64 = 0.03;
/// … and the specific force scatters less than this, m/s².
const REST_FORCE_SCATTER_MPS2: f64 = 0.3;
/// … about a mean this close to g, m/s².
const REST_FORCE_ERROR_MPS2: f64 = 0.6;
/// One-sigma of roll and pitch after a start at rest, rad (0.2 m/s² of accelerometer bias are 0.02 rad).
pub const TILT_SIGMA_REST_RAD: f64 = 0.025;
/// One-sigma of roll and pitch after a start in motion, rad.
pub const TILT_SIGMA_MOVING_RAD: f64 = 0.2;
/// One-sigma of the gyroscope bias after a start at rest, rad/s: a slow swing looks like a bias.
pub const GYRO_BIAS_SIGMA_REST_RADPS: f64 = 0.01;
/// One-sigma of yaw with a magnetometer, rad.
pub const YAW_SIGMA_FIELD_RAD: f64 = 0.1;

/// What start-up found.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Aligned {
    /// Attitude now.
    pub world_from_body: UnitQuaternion<f64>,
    /// Gyroscope bias, rad/s; zero when not at rest.
    pub gyro_bias_radps: Vector3<f64>,
    /// Was the vehicle at rest?
    pub at_rest: bool,
    /// Strength of the field, µT, when there was one with a horizontal part.
    pub field_ut: Option<f64>,
}

/// Averages until the attitude is known.
#[derive(Debug, Clone)]
pub struct Alignment {
    elapsed_s: f64,
    start_from_body: UnitQuaternion<f64>,
    samples: f64,
    force_start: Vector3<f64>,
    fields: f64,
    field_start: Vector3<f64>,
    half: Half,
}

/// Sums over half a second.
#[derive(Debug, Clone, Default)]
struct Half {
    from_s: f64,
    samples: f64,
    rate: Vector3<f64>,
    rate_squared: Vector3<f64>,
    force: Vector3<f64>,
    force_squared: Vector3<f64>,
}

impl Half {
    fn push(&mut self, gyro_radps: &Vector3<f64>, force_mps2: &Vector3<f64>) {
        self.samples += 1.0;
        self.rate += gyro_radps;
        self.rate_squared += gyro_radps.component_mul(gyro_radps);
        self.force += force_mps2;
        self.force_squared += force_mps2.component_mul(force_mps2);
    }

    /// Mean rate and specific force, if it was at rest.
    fn at_rest(&self, gravity_mps2: f64) -> Option<(Vector3<f64>, Vector3<f64>)> {
        let (rate, force) = (self.rate / self.samples, self.force / self.samples);
        let scatter = |squared: &Vector3<f64>, mean: &Vector3<f64>| {
            (squared / self.samples - mean.component_mul(mean)).map(|v| v.max(0.0).sqrt()).max()
        };
        let rests = rate.norm() < REST_RATE_RADPS
            && scatter(&self.rate_squared, &rate) < REST_RATE_SCATTER_RADPS
            && scatter(&self.force_squared, &force) < REST_FORCE_SCATTER_MPS2
            && (force.norm() - gravity_mps2).abs() < REST_FORCE_ERROR_MPS2;
        rests.then_some((rate, force))
    }
}

impl Alignment {
    /// Nothing seen yet.
    pub fn new() -> Self {
        Self {
            elapsed_s: 0.0,
            start_from_body: UnitQuaternion::identity(),
            samples: 0.0,
            force_start: Vector3::zeros(),
            fields: 0.0,
            field_start: Vector3::zeros(),
            half: Half::default(),
        }
    }

    /// Takes one sample, `dt_s` after the one before; `Some` when the attitude is known.
    pub fn push(
        &mut self,
        dt_s: f64,
        gyro_radps: &Vector3<f64>,
        force_mps2: &Vector3<f64>,
        field_ut: Option<&Vector3<f64>>,
        gravity_mps2: f64,
        declination_rad: f64,
    ) -> Option<Aligned> {
        if self.samples > 0.0 {
            self.elapsed_s += dt_s;
            self.start_from_body *= UnitQuaternion::from_scaled_axis(gyro_radps * dt_s);
        }
        self.samples += 1.0;
        self.force_start += self.start_from_body * force_mps2;
        self.half.push(gyro_radps, force_mps2);
        if let Some(field) = field_ut {
            self.fields += 1.0;
            self.field_start += self.start_from_body * field;
        }
        if self.elapsed_s - self.half.from_s < REST_S - 1e-9 {
            return None;
        }

        if let Some((mean_rate, mean_force)) = self.half.at_rest(gravity_mps2) {
            // What was integrated as motion was bias.
            let field = (self.fields > 0.0).then(|| self.start_from_body.inverse() * self.field_start / self.fields);
            let world_from_body = attitude::from_gravity_and_field(&mean_force, field.as_ref(), declination_rad);
            return Some(Aligned {
                world_from_body,
                gyro_bias_radps: mean_rate,
                at_rest: true,
                field_ut: usable(field, &world_from_body),
            });
        }
        if self.elapsed_s < MOVING_S - 1e-9 {
            self.half = Half { from_s: self.elapsed_s, ..Half::default() };
            return None;
        }
        let field = (self.fields > 0.0).then(|| self.field_start / self.fields);
        let force = self.force_start / self.samples;
        if force.norm() < 0.2 * gravity_mps2 {
            // Falling: no direction is up. Keep averaging from here.
            *self = Self::new();
            return None;
        }
        let world_from_start = attitude::from_gravity_and_field(&force, field.as_ref(), declination_rad);
        Some(Aligned {
            world_from_body: world_from_start * self.start_from_body,
            gyro_bias_radps: Vector3::zeros(),
            at_rest: false,
            field_ut: usable(field, &world_from_start),
        })
    }
}

/// Strength of a field that has a horizontal part.
fn usable(field: Option<Vector3<f64>>, world_from_frame: &UnitQuaternion<f64>) -> Option<f64> {
    field.and_then(|f| {
        let level = world_from_frame * f;
        (level.x.hypot(level.y) > 0.1 * level.norm()).then(|| f.norm())
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frames::roll_pitch_yaw;

    const FIELD_ENU: Vector3<f64> = Vector3::new(0.0, 20.0, -42.0);

    #[test]
    fn at_rest_the_mean_rate_is_the_bias() {
        let q = UnitQuaternion::from_euler_angles(0.1, -0.2, 1.0);
        let bias = Vector3::new(0.01, -0.02, 0.005);
        let mut a = Alignment::new();
        let force = q.inverse() * Vector3::new(0.0, 0.0, 9.81);
        let field = q.inverse() * FIELD_ENU;
        let found = (0..200).find_map(|_| a.push(0.005, &bias, &force, Some(&field), 9.81, 0.0)).unwrap();
        assert!(found.at_rest && (found.gyro_bias_radps - bias).norm() < 1e-12);
        assert!(found.world_from_body.angle_to(&q) < 0.01);
        assert!((found.field_ut.unwrap() - FIELD_ENU.norm()).abs() < 0.5);
    }

    /// GIVEN a vehicle at rest whose first sample is none, or that was touched, WHEN it aligns THEN it is at rest by its second half second.
    #[test]
    fn what_disturbs_the_first_moment_makes_no_start_in_motion() {
        let mut a = Alignment::new();
        let force = |k: u32| if k == 0 { Vector3::zeros() } else { Vector3::z() * 9.81 };
        let bias = Vector3::new(0.01, -0.02, 0.005);
        let found = (0..201).find_map(|k| a.push(0.005, &bias, &force(k), None, 9.81, 0.0).map(|found| (k, found)));
        let (k, found) = found.unwrap();
        assert!(found.at_rest && (200..=201).contains(&k), "{k} {found:?}");
        assert!((found.gyro_bias_radps - bias).norm() < 1e-12 && found.world_from_body.angle() < 1e-9);
    }

    #[test]
    fn turning_at_one_radian_per_second_does_not_smear() {
        // GIVEN a vehicle yawing at 1 rad/s while rolling, WHEN aligned in motion, THEN the attitude is that
        // of the last sample, not of the middle of the window.
        let (mut q, rate) = (UnitQuaternion::from_euler_angles(0.3, 0.1, -2.0), Vector3::new(0.2, 0.0, 1.0));
        let mut a = Alignment::new();
        let mut found = None;
        while found.is_none() {
            let force = q.inverse() * Vector3::new(0.0, 0.0, 9.81);
            let field = q.inverse() * FIELD_ENU;
            found = a.push(0.005, &rate, &force, Some(&field), 9.81, 0.0);
            if found.is_none() {
                q *= UnitQuaternion::from_scaled_axis(rate * 0.005);
            }
        }
        let found = found.unwrap();
        assert!(!found.at_rest);
        assert!(found.world_from_body.angle_to(&q) < 0.01, "{}", roll_pitch_yaw(&found.world_from_body));
    }

    #[test]
    fn falling_freely_gives_no_attitude() {
        let mut a = Alignment::new();
        for _ in 0..1000 {
            assert!(a.push(0.005, &Vector3::x(), &Vector3::zeros(), None, 9.81, 0.0).is_none());
        }
    }
}
