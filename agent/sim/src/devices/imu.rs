//! A simulated IMU: off-centre, turned, distorted; in a world also shaken, filtered, clipped, warmed and on a clock of its own.

use nalgebra::{Matrix3, Rotation3, Vector3};
use plumbline_core::model::rigid_body::rotate;
use plumbline_core::sensor::ImuSample;
use plumbline_core::sensor::imu::{self, Distortion};
use plumbline_core::sensor::noise::{ScalarError, Stream};
use plumbline_core::sensor::suite::Quality;
use plumbline_core::types::GRAVITY_MPS2;

use super::{Device, Now, Surroundings, Transport, read3, triple};
use crate::conditions::Conditions;
use crate::vibration::{Biquad, Felt};

#[derive(Debug, Clone)]
pub(super) struct Imu {
    position_flu_m: Vector3<f64>,
    pub(super) body_from_sensor: Rotation3<f64>,
    pub(super) gyro: [ScalarError; 3],
    pub(super) accel: [ScalarError; 3],
    mag: Option<[ScalarError; 3]>,
    distort: Distort,
    period_s: f64,
    real: Option<Real>,
}

/// [`Distortion`] as matrices.
#[derive(Debug, Clone, Copy)]
struct Distort {
    gyro: Matrix3<f64>,
    accel: Matrix3<f64>,
    mag: Matrix3<f64>,
    hard_iron_ut: Vector3<f64>,
}

impl Device for Imu {
    type Sample = ImuSample;

    fn new(s: &imu::Imu, stream: &mut Stream) -> Self {
        let rpy = s.mounting_rpy_rad;
        Self {
            position_flu_m: s.position_flu_m,
            body_from_sensor: Rotation3::from_euler_angles(rpy.x, rpy.y, rpy.z),
            gyro: triple(s.gyro, &s.timing, stream),
            accel: triple(s.accel, &s.timing, stream),
            mag: s.mag.map(|q| triple(q, &s.timing, stream)),
            distort: Distort {
                gyro: Distortion::matrix(&s.distortion.gyro),
                accel: Distortion::matrix(&s.distortion.accel),
                mag: Distortion::matrix(&s.distortion.mag),
                hard_iron_ut: Vector3::from(s.distortion.hard_iron_ut),
            },
            period_s: s.timing.period_s(),
            real: None,
        }
    }

    fn within(mut self, around: &Surroundings, stream: &mut Stream) -> Self {
        let c = &around.conditions.imu;
        let white = |density: f64, cutoff_hz: f64| density * (BUTTERWORTH_BAND * cutoff_hz).sqrt();
        let accel = Quality {
            sigma: white(c.acc_density_mps2_per_sqrthz, c.acc_lowpass_hz),
            bias_sigma: c.acc_bias_left_after_calibration_mps2,
            bias_walk: c.acc_walk_mps2_per_sqrts,
            resolution: c.acc_lsb_mps2,
            range: c.acc_range_mps2,
            ..*self.accel[0].quality()
        };
        let gyro = Quality {
            sigma: white(c.gyr_density_radps_per_sqrthz, c.gyr_lowpass_hz),
            bias_sigma: c.gyr_bias_sigma_radps,
            bias_walk: c.gyr_walk_radps_per_sqrts,
            resolution: c.gyr_lsb_radps,
            ..*self.gyro[0].quality()
        };
        let period_s = self.period_s;
        self.accel = std::array::from_fn(|_| ScalarError::new(accel, period_s, stream));
        self.gyro = std::array::from_fn(|_| ScalarError::new(gyro, period_s, stream));
        if let Some(mag) = &mut self.mag {
            let quality = Quality { sigma: c.mag_sigma_ut, resolution: c.mag_lsb_ut, ..*mag[0].quality() };
            *mag = std::array::from_fn(|_| ScalarError::new(quality, period_s, stream));
        }
        let errors = &around.conditions.airframe_errors;
        self.position_flu_m += normal3(stream) * errors.imu_lever_error_sigma_m;
        self.real = Some(Real::new(around, period_s, stream));
        self
    }

    fn transport(conditions: &Conditions) -> Option<Transport> {
        let c = &conditions.imu;
        Some(Transport {
            delay_s: c.transport_delay_s,
            jitter_s: 0.0,
            missing_fraction: c.missing_fraction,
            gap_rate_per_s: c.gap_rate_per_s,
            gap_max_s: c.gap_max_s,
        })
    }

    fn tick(&mut self, now: &Now<'_>) {
        let (w, force) = self.motion(now);
        let sensor_from_body = self.body_from_sensor.inverse();
        if let (Some(real), Some(around)) = (&mut self.real, now.around) {
            // Vibration is given in body axes.
            let turn = |v: Vector3<f64>| sensor_from_body * v;
            real.tick(now, around, (self.distort.gyro * turn(w), self.distort.accel * turn(force)), &turn);
            real.sample(now, around, (&mut self.gyro, &mut self.accel), &turn);
        }
    }

    fn measure(&mut self, now: &Now<'_>, stream: &mut Stream) -> Option<ImuSample> {
        let (w, force) = self.motion(now);
        let Self { body_from_sensor, gyro, accel, mag, distort, real, .. } = self;
        let x = now.world.body();
        let sensor_from_body = body_from_sensor.inverse();
        let (gyro, accel) = match real {
            Some(real) => real.latest,
            None => (
                read3(gyro, &(distort.gyro * (sensor_from_body * w)), stream),
                read3(accel, &(distort.accel * (sensor_from_body * force)), stream),
            ),
        };
        let mag_ut = mag.as_mut().map(|errors| {
            let disturbed = real.as_ref().map_or_else(Vector3::zeros, |real| real.magnetic_ut(now));
            let field = rotate(&x.world_from_body.conjugate(), &now.site.magnetic_field_enu_ut) + disturbed;
            let seen = distort.mag * (sensor_from_body * field) + distort.hard_iron_ut;
            *body_from_sensor * read3(errors, &seen, stream)
        });
        Some(ImuSample {
            time: now.time,
            gyro_radps: *body_from_sensor * gyro,
            accel_mps2: *body_from_sensor * accel,
            mag_ut,
            temperature_c: now.temperature_c(),
        })
    }
}

impl Imu {
    /// Rate and specific force where it sits, body axes: at r from the centre of mass a + α × r + ω × (ω × r).
    fn motion(&self, now: &Now<'_>) -> (Vector3<f64>, Vector3<f64>) {
        let (w, r) = (now.world.body().body_rates_radps, self.position_flu_m);
        let force = now.world.specific_force_flu_mps2()
            + now.world.angular_acceleration_radps2().cross(&r)
            + w.cross(&w.cross(&r));
        (w, force)
    }
}

/// Noise bandwidth of a second-order Butterworth low-pass over its cut-off.
const BUTTERWORTH_BAND: f64 = 1.11;

/// What a world adds to an IMU.
#[derive(Debug, Clone)]
struct Real {
    stream: Stream,
    felt: Felt,
    /// The sensor's own filter of rate and force.
    filters: [[Biquad; 3]; 2],
    /// Behind it.
    filtered: [Vector3<f64>; 2],
    /// Scale, cross-axis and mounting.
    gain: [Matrix3<f64>; 2],
    /// Of the accelerometer's scale, 1/K.
    scale_per_k: f64,
    offset_per_k: [Vector3<f64>; 2],
    g_sensitivity: Matrix3<f64>,
    range_mps2: f64,
    /// The sensor samples by its own clock; whoever reads it gets the latest: repeats and skips.
    period_s: f64,
    next_s: f64,
    latest: (Vector3<f64>, Vector3<f64>),
    magnetic: Magnetic,
}

/// What disturbs the magnetic field where it sits.
#[derive(Debug, Clone)]
struct Magnetic {
    /// Of the motors' current, body axes, µT/A.
    per_ampere_ut: Vector3<f64>,
    /// Waves that make up the field of the room: wave vector (1/m), phase, amplitude (µT).
    room: [(Vector3<f64>, f64, Vector3<f64>); WAVES],
}

const WAVES: usize = 8;

fn normal3(stream: &mut Stream) -> Vector3<f64> {
    Vector3::new(stream.normal(), stream.normal(), stream.normal())
}

fn matrix3(stream: &mut Stream, diagonal: f64, off_diagonal: f64) -> Matrix3<f64> {
    Matrix3::from_fn(|i, j| if i == j { diagonal } else { off_diagonal } * stream.normal())
}

impl Real {
    fn new(around: &Surroundings, period_s: f64, stream: &mut Stream) -> Self {
        let (c, errors) = (&around.conditions.imu, &around.conditions.airframe_errors);
        let rate_hz = 1.0 / around.tick_s;
        // Misalignment of the whole unit, and what its axes are off.
        let turned = Rotation3::new(normal3(stream) * errors.imu_misalignment_sigma_rad).into_inner();
        let mut gain = |scale: f64| turned * (Matrix3::identity() + matrix3(stream, scale, c.acc_cross_axis));
        // Turned over at rest, as for its bias, an accelerometer shows its scale: what is left is as much at 1 g.
        let gain = [gain(c.gyr_scale_sigma), gain(c.acc_bias_left_after_calibration_mps2 / GRAVITY_MPS2)];
        let offset_per_k = [normal3(stream) * c.gyr_tco_radps_per_k, normal3(stream) * c.acc_tco_mps2_per_k];
        let g = c.gyr_g_sensitivity_radps_per_mps2;
        Self {
            felt: around.vibration.felt(c.gyr_lowpass_hz, c.acc_lowpass_hz, rate_hz, stream),
            filters: [c.gyr_lowpass_hz, c.acc_lowpass_hz].map(|hz| [Biquad::low_pass(hz, rate_hz); 3]),
            filtered: [Vector3::zeros(); 2],
            gain,
            scale_per_k: c.acc_tcs_per_k * stream.normal(),
            offset_per_k,
            g_sensitivity: matrix3(stream, g, g),
            range_mps2: c.acc_range_mps2,
            period_s: period_s * (1.0 + c.sample_clock_error_sigma * stream.normal()),
            next_s: period_s * stream.uniform(),
            latest: (Vector3::zeros(), Vector3::zeros()),
            magnetic: Magnetic::new(around, stream),
            stream: stream.clone(),
        }
    }

    /// One tick of what its filters see: motion, noise, and what the range cuts off.
    fn tick(
        &mut self,
        now: &Now<'_>,
        around: &Surroundings,
        (rate, force): (Vector3<f64>, Vector3<f64>),
        turn: &impl Fn(Vector3<f64>) -> Vector3<f64>,
    ) {
        let noise = self.felt.noise(&around.vibration, &mut self.stream);
        let (_, unfiltered) = self.felt.tones(&around.vibration, 0.0);
        let [gyro_noise, accel_noise] = halves(&noise).map(turn);
        let warm_k = now.warm_c;
        let force = self.gain[1] * force * (1.0 + self.scale_per_k * warm_k) + self.offset_per_k[1] * warm_k;
        let rate = self.gain[0] * rate + self.offset_per_k[0] * warm_k + self.g_sensitivity * force;
        let whole = force + accel_noise + turn(halves(&unfiltered)[1]);
        let cut_off = whole.map(|a| a.clamp(-self.range_mps2, self.range_mps2)) - whole;
        let inputs = [rate + gyro_noise, force + accel_noise + cut_off];
        for ((filters, input), filtered) in self.filters.iter_mut().zip(inputs).zip(&mut self.filtered) {
            *filtered = Vector3::from_fn(|axis, _| filters[axis].step(input[axis]));
        }
    }

    /// Samples when its own clock says so.
    fn sample(
        &mut self,
        now: &Now<'_>,
        around: &Surroundings,
        (gyro, accel): (&mut [ScalarError; 3], &mut [ScalarError; 3]),
        turn: &impl Fn(Vector3<f64>) -> Vector3<f64>,
    ) {
        let now_s = now.time.as_seconds();
        if now_s < self.next_s {
            return;
        }
        let back_s = (now_s - self.next_s).min(around.tick_s);
        while self.next_s <= now_s {
            self.next_s += self.period_s;
        }
        let (tones, _) = self.felt.tones(&around.vibration, back_s);
        let [gyro_tones, accel_tones] = halves(&tones).map(turn);
        let [rate, force] = self.filtered;
        self.latest = (
            read3(gyro, &(rate + gyro_tones), &mut self.stream),
            read3(accel, &(force + accel_tones), &mut self.stream),
        );
    }

    /// What the motors' current and the room add to the field, body axes, µT.
    fn magnetic_ut(&self, now: &Now<'_>) -> Vector3<f64> {
        let x = now.world.body();
        let room = self.magnetic.room.iter().fold(Vector3::zeros(), |sum, (k, phase, amplitude)| {
            sum + amplitude * (k.dot(&x.position_enu_m) + phase).cos()
        });
        rotate(&x.world_from_body.conjugate(), &room) + self.magnetic.per_ampere_ut * now.world.battery().current_a()
    }
}

/// Gyroscope and accelerometer.
fn halves(v: &[f64; 6]) -> [Vector3<f64>; 2] {
    [Vector3::new(v[0], v[1], v[2]), Vector3::new(v[3], v[4], v[5])]
}

impl Magnetic {
    fn new(around: &Surroundings, stream: &mut Stream) -> Self {
        let c = &around.conditions.magnetic;
        // One room for all.
        let mut room = Stream::new(around.seed, "room");
        let direction = normal3(stream);
        let amplitude_ut = c.indoor_anomaly_sigma_ut * (2.0 / WAVES as f64).sqrt();
        // A random field of correlation exp(−d² / 2 L²): its waves are normal with 1/L.
        let wave = |stream: &mut Stream| {
            let k = normal3(stream) / c.indoor_anomaly_length_m;
            (k, std::f64::consts::TAU * stream.uniform(), normal3(stream) * amplitude_ut)
        };
        Self {
            per_ampere_ut: direction.try_normalize(0.0).unwrap_or_else(Vector3::x) * c.motor_ut_per_a,
            room: std::array::from_fn(|_| wave(&mut room)),
        }
    }
}
