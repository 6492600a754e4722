//! A simulated IMU: off-centre, turned, distorted; in a world also shaken, filtered, clipped, warmed and on a clock of its own.

use nalgebra::{Matrix3, Rotation3, Vector3};
use plumbline_core::model::rigid_body::rotate;
use plumbline_core::sensor::ImuSample;
use plumbline_core::sensor::imu::{self, Distortion};
use plumbline_core::sensor::noise::{ScalarError, Stream};
use plumbline_core::sensor::suite::Quality;
use plumbline_core::types::GRAVITY_MPS2;

use super::field::Field;
use super::{Device, Now, Surroundings, Transport, normal3, read3, triple};
use crate::conditions::Conditions;
use crate::vibration::{Biquad, Felt, Slow};
use plumbline_proto::time::FlightTime;

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
            // It walks about a middle, which is added before the filter.
            bias_walk: 0.0,
            resolution: c.acc_lsb_mps2,
            range: c.acc_range_mps2,
            ..*self.accel[0].quality()
        };
        let gyro = Quality {
            sigma: white(c.gyr_density_radps_per_sqrthz, c.gyr_lowpass_hz),
            bias_sigma: c.gyr_bias_sigma_radps,
            bias_walk: 0.0,
            resolution: c.gyr_lsb_radps,
            ..*self.gyro[0].quality()
        };
        let period_s = self.period_s;
        self.accel = std::array::from_fn(|_| ScalarError::new(accel, period_s, stream));
        self.gyro = std::array::from_fn(|_| ScalarError::new(gyro, period_s, stream));
        if let Some(mag) = &mut self.mag {
            // What was measured at rest was rounded already, which is a noise of q/√12.
            let sigma = (c.mag_sigma_ut.powi(2) - c.mag_lsb_ut.powi(2) / 12.0).max(0.0).sqrt();
            let quality = Quality { sigma, resolution: c.mag_lsb_ut, ..*mag[0].quality() };
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
            ..Transport::default()
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
        // It is slower than the rest: between two of its own samples the last one is read again.
        let again = real.as_mut().and_then(|real| real.magnetic.latest_ut.filter(|_| !real.magnetic.due(now.time)));
        let mag_ut = again.or_else(|| {
            let errors = mag.as_mut()?;
            let disturbed = real.as_ref().map_or_else(Vector3::zeros, |real| {
                real.magnetic.disturbed_ut(now) + *body_from_sensor * (real.magnetic.per_kelvin_ut * now.warm_c)
            });
            let field = rotate(&x.world_from_body.conjugate(), &now.site.magnetic_field_enu_ut) + disturbed;
            let seen = distort.mag * (sensor_from_body * field) + distort.hard_iron_ut;
            Some(*body_from_sensor * read3(errors, &seen, stream))
        });
        if let Some(real) = real {
            real.magnetic.latest_ut = mag_ut;
        }
        Some(ImuSample {
            time: real.as_mut().map_or(now.time, |real| real.stamp(now.time)),
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

/// One sigma of |n₁| − |n₂|, normal: √(2 (1 − 2/π)).
const INTERVAL_SIGMA: f64 = 0.8525;

/// What a world adds to an IMU.
#[derive(Debug, Clone)]
struct Real {
    stream: Stream,
    felt: Felt,
    /// The sensor's own filter of rate and force.
    filters: [[Biquad; 3]; 2],
    /// Behind it; `None` before the first tick.
    filtered: Option<[Vector3<f64>; 2]>,
    /// Scale, cross-axis and mounting.
    gain: [Matrix3<f64>; 2],
    /// Of the accelerometer's scale, 1/K.
    scale_per_k: f64,
    offset_per_k: [Vector3<f64>; 2],
    g_sensitivity: Matrix3<f64>,
    range_mps2: f64,
    /// Of a force, what it reads too much, by its square over the range.
    nonlinearity: Vector3<f64>,
    /// What vibration adds to the mean, by its square, s²/m.
    rectification_s2pm: f64,
    /// Biases walk about the one of switching on: of one sigma each, and how fast.
    walk: [[Slow; 3]; 2],
    walk_sigma: [f64; 2],
    walk_s: [f64; 2],
    /// Gyroscope and accelerometer sample by their own clocks; whoever reads them gets the latest: repeats and skips.
    period_s: [f64; 2],
    next_s: [f64; 2],
    latest: (Vector3<f64>, Vector3<f64>),
    magnetic: Magnetic,
    /// Stamps are those of its reader, which is early by as much, s, and this one sigma more.
    offset_s: f64,
    read_jitter_s: f64,
}

/// What disturbs the magnetic field where it sits.
#[derive(Debug, Clone)]
struct Magnetic {
    /// Of the motors' current, body axes, µT/A.
    per_ampere_ut: Vector3<f64>,
    /// Of the iron in the room, µT.
    room: Field,
    /// Its own axes, µT/K.
    per_kelvin_ut: Vector3<f64>,
    period_s: f64,
    next_s: f64,
    latest_ut: Option<Vector3<f64>>,
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
            filtered: None,
            gain,
            scale_per_k: c.acc_tcs_per_k * stream.normal(),
            offset_per_k,
            g_sensitivity: matrix3(stream, g, g),
            range_mps2: c.acc_range_mps2,
            nonlinearity: normal3(stream) * c.acc_nonlinearity_fraction / c.acc_range_mps2,
            rectification_s2pm: c.acc_rectification_mps2_per_mps2sq,
            walk: Default::default(),
            // A Gauss–Markov process that begins as this walk.
            walk_sigma: [
                c.gyr_walk_radps_per_sqrts * (0.5 * c.gyr_walk_time_constant_s).sqrt(),
                c.acc_walk_mps2_per_sqrts * (0.5 * c.acc_walk_time_constant_s).sqrt(),
            ],
            walk_s: [c.gyr_walk_time_constant_s, c.acc_walk_time_constant_s],
            period_s: std::array::from_fn(|_| period_s * (1.0 + c.sample_clock_error_sigma * stream.normal())),
            // It was switched on long before.
            next_s: std::array::from_fn(|_| period_s * (stream.uniform() - 1.0)),
            latest: (Vector3::zeros(), Vector3::zeros()),
            magnetic: Magnetic::new(around, stream),
            offset_s: around.conditions.clocks.imu_to_imu_offset_s * stream.normal().abs(),
            // One sigma of its intervals: a stamp is off by the absolute value of a normal number, an interval by the difference
            // of two such.
            read_jitter_s: c.read_jitter_s / INTERVAL_SIGMA,
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
        let walked = std::array::from_fn::<Vector3<f64>, 2, _>(|half| {
            let [sigma, time_constant_s] = [self.walk_sigma[half], self.walk_s[half]];
            Vector3::from_fn(|k, _| sigma * self.walk[half][k].step(around.tick_s, time_constant_s, &mut self.stream))
        });
        let force = self.gain[1] * force * (1.0 + self.scale_per_k * warm_k) + self.offset_per_k[1] * warm_k;
        let bent = self.nonlinearity.component_mul(&force.component_mul(&force));
        let force = force + bent + walked[1];
        let rate = self.gain[0] * rate + self.offset_per_k[0] * warm_k + self.g_sensitivity * force + walked[0];
        let shaken = accel_noise + turn(halves(&unfiltered)[1]);
        let whole = force + shaken;
        let cut_off = whole.map(|a| a.clamp(-self.range_mps2, self.range_mps2)) - whole;
        let force = force + self.rectification_s2pm * shaken.component_mul(&shaken);
        let inputs = [rate + gyro_noise, force + accel_noise + cut_off];
        if self.filtered.is_none() {
            for (filter, rest) in self.filters.iter_mut().flatten().zip([rate, force].iter().flatten()) {
                filter.settle(*rest);
            }
        }
        self.filtered = Some(std::array::from_fn(|half| {
            Vector3::from_fn(|axis, _| self.filters[half][axis].step(inputs[half][axis]))
        }));
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
        let felt = &self.felt;
        let [tones_of_gyro, tones_of_accel] = std::array::from_fn(|half| {
            let next_s = &mut self.next_s[half];
            if now_s < *next_s {
                return None;
            }
            let back_s = (now_s - *next_s).min(around.tick_s);
            while *next_s <= now_s {
                *next_s += self.period_s[half];
            }
            Some(turn(halves(&felt.tones(&around.vibration, back_s).0)[half]))
        });
        let Some([rate, force]) = self.filtered else { return };
        if let Some(tones) = tones_of_gyro {
            self.latest.0 = read3(gyro, &(rate + tones), &mut self.stream);
        }
        if let Some(tones) = tones_of_accel {
            self.latest.1 = read3(accel, &(force + tones), &mut self.stream);
        }
    }

    /// What its reader says of a sample of now: never later than it was, and less than half a period early.
    fn stamp(&mut self, now: FlightTime) -> FlightTime {
        let early_s = self.offset_s + self.read_jitter_s * self.stream.normal().abs();
        FlightTime(now.0.saturating_sub((1e6 * early_s.min(0.45 * self.period_s[0])) as u64))
    }
}

/// Gyroscope and accelerometer.
fn halves(v: &[f64; 6]) -> [Vector3<f64>; 2] {
    [Vector3::new(v[0], v[1], v[2]), Vector3::new(v[3], v[4], v[5])]
}

impl Magnetic {
    fn new(around: &Surroundings, stream: &mut Stream) -> Self {
        let (c, imu) = (&around.conditions.magnetic, &around.conditions.imu);
        let direction = normal3(stream);
        // One room for all.
        let mut room = Stream::new(around.seed, "room");
        let period_s = 1.0 / imu.mag_rate_hz;
        Self {
            per_ampere_ut: direction.try_normalize(0.0).unwrap_or_else(Vector3::x) * c.motor_ut_per_a,
            room: Field::new(c.indoor_anomaly_sigma_ut, c.indoor_anomaly_length_m, &mut room),
            per_kelvin_ut: normal3(stream) * imu.mag_tco_ut_per_k,
            period_s,
            next_s: period_s * stream.uniform(),
            latest_ut: None,
        }
    }

    /// Has it a sample of its own since it was read last?
    fn due(&mut self, now: FlightTime) -> bool {
        let due = now.as_seconds() >= self.next_s;
        while self.next_s <= now.as_seconds() {
            self.next_s += self.period_s;
        }
        due
    }

    /// What the motors' current and the room add to the field, body axes, µT.
    fn disturbed_ut(&self, now: &Now<'_>) -> Vector3<f64> {
        let x = now.world.body();
        let room = self.room.at(&x.position_enu_m);
        rotate(&x.world_from_body.conjugate(), &room) + self.per_ampere_ut * now.world.battery().current_a()
    }
}

#[cfg(test)]
mod tests {
    use plumbline_core::sensor::ImuSample;
    use plumbline_core::types::MotorCommand;
    use plumbline_core::vehicle::Vehicle as _;

    use crate::{Scenario, SimVehicle};

    /// The first IMU's samples in a world for so long, with every motor told `throttle` on a stand.
    fn samples(world: &str, seconds: f64, throttle: f64) -> Vec<ImuSample> {
        let toml = format!(
            "name = \"imu\"\nworld = \"{world}\"\n[rig.single_axis]\naxis = \"roll\"\nheight_m = 1.0\ncg_below_pivot_m = 0.01\n\
             [suite]\npreset = \"string_rig\"\n"
        );
        let mut vehicle = SimVehicle::new(&Scenario::from_toml(&toml).unwrap()).unwrap();
        let mut all = Vec::new();
        while vehicle.time().as_seconds() < seconds {
            let frame = vehicle.sense().unwrap();
            vehicle.actuate(&MotorCommand { throttle: [throttle; 4] }).unwrap();
            all.extend(frame.imus[0].inspect(|sample| assert!(sample.time <= frame.time)));
        }
        all
    }

    /// GIVEN a world WHEN an IMU is read at 100 Hz THEN its stamps run forwards, early by its reader's jitter, and its
    /// magnetometer has a value of its own 20 times a second.
    #[test]
    fn in_a_world_stamps_jitter_and_a_slow_magnetometer_is_read_again() {
        let all = samples("harsh", 20.0, 0.0);
        assert!(all.windows(2).all(|w| w[0].time < w[1].time));
        let off_ticks = all.iter().filter(|s| s.time.0 % 5_000 != 0).count();
        assert!(off_ticks > all.len() * 9 / 10, "{off_ticks}");
        let fresh =
            |all: &[ImuSample]| all.windows(2).filter(|w| w[0].mag_ut != w[1].mag_ut).count() as f64 / all.len() as f64;
        assert!((0.18..0.23).contains(&fresh(&all)), "{}", fresh(&all));
        let bench = samples("bench", 2.0, 0.0);
        assert!(fresh(&bench) > 0.9 && bench.iter().all(|s| s.time.0 % 5_000 == 0), "{}", fresh(&bench));
    }

    /// GIVEN a vehicle at rest WHEN an IMU is read first THEN it tells what it felt long before, not what its filter begins with.
    #[test]
    fn an_imu_was_switched_on_before_it_is_read() {
        for world in ["bench", "datasheet", "harsh"] {
            let all = samples(world, 0.5, 0.0);
            let far = all.iter().find(|s| (s.accel_mps2.norm() - 9.81).abs() > 0.7 || s.gyro_radps.norm() == 0.0);
            assert!(far.is_none(), "{world}: {far:?}");
        }
    }

    /// GIVEN rotors that carry the vehicle THEN their wash cools its sensors, by 5 K within 30 s of two thirds.
    #[test]
    fn the_rotors_wash_cools_a_sensor() {
        let [standing, turning] = [0.0, 0.75].map(|throttle| samples("harsh", 30.0, throttle));
        let [standing_c, turning_c] = [standing, turning].map(|all| all[all.len() - 1].temperature_c);
        assert!((standing_c - turning_c - 5.0 * 0.632).abs() < 0.3, "{standing_c} {turning_c}");
    }
}
