//! Truth ─► samples: rates, phases, delays, drop-outs, and the errors of each sensor.
//!
//! A sensor samples on the first tick at or after its due time and stamps that tick's time; a delayed sample
//! is delivered later with the stamp of its measurement. What a driver and its calibration would remove
//! (mounting angles, lever of a laser) is removed here; what they cannot know stays in.

use arrayvec::ArrayVec;
use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};
use plumbline_proto::{ids::SensorId, time::FlightTime, v1::SensorKind};

use super::noise::{ScalarError, Stream};
use super::site::Site;
use super::world::World;
use crate::frames::tilt_rad;
use crate::model::rigid_body::rotate;
use crate::vehicle::suite::{self, MAX_UNDER_WAY, Quality, Suite, Timing};
use crate::vehicle::{
    BarometerSample, CAMERAS, CameraRangesSample, GnssSample, HeightSample, ImuSample, MAX_BAROMETERS, MAX_HEIGHTS,
    MAX_IMUS, MocapPoseSample, SensorFrame,
};

/// Reflective markers, FLU from the centroid, m ([Umasankar] Table 1).
const MARKERS_FLU_M: [[f64; 3]; 4] = [[0.105, 0.0, 0.0], [0.0, 0.060, 0.0], [-0.115, 0.0, 0.0], [0.0, -0.060, 0.0]];
/// A sensor warms up by this much, °C …
const WARM_UP_C: f64 = 12.0;
/// … with this time constant, s (both chosen).
const WARM_UP_S: f64 = 180.0;

/// A stretch of time during which one sensor, or all of a kind, gives nothing.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Outage {
    /// The sensor.
    pub sensor: SensorId,
    /// When, s.
    pub start_s: f64,
    /// How long, s.
    pub duration_s: f64,
}

/// Decides which ticks a sensor samples at, and carries its samples until they are delivered.
#[derive(Debug, Clone)]
struct Clock<T> {
    sensor: SensorId,
    timing: Timing,
    taken: u64,
    due_us: u64,
    delay_us: u64,
    under_way: ArrayVec<(u64, T), MAX_UNDER_WAY>,
    stream: Stream,
}

impl<T: Copy> Clock<T> {
    fn new(kind: SensorKind, index: usize, timing: Timing, seed: u64) -> Self {
        let sensor = SensorId::new(kind, index as u8 + 1);
        let mut clock = Self {
            sensor,
            timing,
            taken: 0,
            due_us: 0,
            delay_us: (timing.delay_s * 1e6).round() as u64,
            under_way: ArrayVec::new(),
            stream: Stream::new(seed, &sensor.to_string()),
        };
        clock.plan();
        clock
    }

    fn plan(&mut self) {
        self.due_us = ((self.timing.phase_s + self.taken as f64 / self.timing.rate_hz) * 1e6).round() as u64;
    }

    /// The sample that arrives at this tick. `measure` runs when one is due.
    fn tick(
        &mut self,
        time: FlightTime,
        outages: &[Outage],
        measure: impl FnOnce(&mut Stream) -> Option<T>,
    ) -> Option<T> {
        let mut fresh = None;
        if time.0 >= self.due_us {
            while time.0 >= self.due_us {
                self.taken += 1;
                self.plan();
            }
            // The draws happen whether or not the sample arrives: losing one changes no other.
            let lost = self.timing.dropout > 0.0 && self.stream.uniform() < self.timing.dropout;
            fresh = measure(&mut self.stream);
            let now_s = time.as_seconds();
            let out = outages
                .iter()
                .any(|o| o.sensor == self.sensor && now_s >= o.start_s && now_s < o.start_s + o.duration_s);
            if lost || out {
                fresh = None;
            }
        }
        if self.delay_us == 0 {
            return fresh;
        }
        // Bound: the suite's check keeps fewer than MAX_UNDER_WAY under way; were it full, the newest is lost.
        if let Some(sample) = fresh {
            let _ = self.under_way.try_push((time.0 + self.delay_us, sample));
        }
        match self.under_way.first() {
            Some((arrival, _)) if *arrival <= time.0 => self.under_way.pop_at(0).map(|(_, sample)| sample),
            _ => None,
        }
    }
}

fn triple(quality: Quality, timing: &Timing, stream: &mut Stream) -> [ScalarError; 3] {
    std::array::from_fn(|_| ScalarError::new(quality, timing.period_s(), stream))
}

fn read3(errors: &mut [ScalarError; 3], truth: &Vector3<f64>, stream: &mut Stream) -> Vector3<f64> {
    let [x, y, z] = errors;
    Vector3::new(x.read(truth.x, stream), y.read(truth.y, stream), z.read(truth.z, stream))
}

#[derive(Debug, Clone)]
struct Imu {
    clock: Clock<ImuSample>,
    position_flu_m: Vector3<f64>,
    body_from_sensor: Rotation3<f64>,
    gyro: [ScalarError; 3],
    accel: [ScalarError; 3],
    mag: Option<[ScalarError; 3]>,
    distort: Distort,
}

/// [`suite::Distortion`] as matrices.
#[derive(Debug, Clone, Copy)]
struct Distort {
    gyro: Matrix3<f64>,
    accel: Matrix3<f64>,
    mag: Matrix3<f64>,
    hard_iron_ut: Vector3<f64>,
}

#[derive(Debug, Clone)]
struct Height {
    clock: Clock<HeightSample>,
    spec: suite::Height,
    error: ScalarError,
}

#[derive(Debug, Clone)]
struct Barometer {
    clock: Clock<BarometerSample>,
    drift_pa_per_c: f64,
    error: ScalarError,
}

#[derive(Debug, Clone)]
struct Gnss {
    clock: Clock<GnssSample>,
    spec: suite::Gnss,
    position: [ScalarError; 3],
    velocity: [ScalarError; 3],
}

#[derive(Debug, Clone)]
struct MocapPose {
    clock: Clock<MocapPoseSample>,
    position: [ScalarError; 3],
    attitude: [ScalarError; 3],
}

#[derive(Debug, Clone)]
struct CameraRanges {
    clock: Clock<CameraRangesSample>,
    spec: suite::CameraRanges,
    error: [ScalarError; CAMERAS],
}

/// Every sensor of the suite.
#[derive(Debug, Clone)]
pub struct Sensors {
    site: Site,
    outages: Vec<Outage>,
    imus: ArrayVec<Imu, MAX_IMUS>,
    heights: ArrayVec<Height, MAX_HEIGHTS>,
    barometers: ArrayVec<Barometer, MAX_BAROMETERS>,
    gnss: Option<Gnss>,
    mocap_pose: Option<MocapPose>,
    camera_ranges: Option<CameraRanges>,
    battery: Option<(f64, Stream)>,
}

impl Sensors {
    /// The sensors of `suite` at `site`; `seed` draws their biases and their noise.
    pub fn new(suite: &Suite, site: Site, outages: &[Outage], seed: u64) -> Self {
        let imu = |(i, s): (usize, &suite::Imu)| {
            let mut clock = Clock::new(SensorKind::Imu, i, s.timing, seed);
            let rpy = s.mounting_rpy_rad;
            Imu {
                position_flu_m: s.position_flu_m,
                body_from_sensor: Rotation3::from_euler_angles(rpy.x, rpy.y, rpy.z),
                gyro: triple(s.gyro, &s.timing, &mut clock.stream),
                accel: triple(s.accel, &s.timing, &mut clock.stream),
                mag: s.mag.map(|q| triple(q, &s.timing, &mut clock.stream)),
                distort: Distort {
                    gyro: suite::Distortion::matrix(&s.distortion.gyro),
                    accel: suite::Distortion::matrix(&s.distortion.accel),
                    mag: suite::Distortion::matrix(&s.distortion.mag),
                    hard_iron_ut: Vector3::from(s.distortion.hard_iron_ut),
                },
                clock,
            }
        };
        let height = |(i, s): (usize, &suite::Height)| {
            let mut clock = Clock::new(SensorKind::Height, i, s.timing, seed);
            // Its range is checked before the reading, not cut.
            let quality = Quality { range: f64::MAX, ..s.height };
            let error = ScalarError::new(quality, s.timing.period_s(), &mut clock.stream);
            Height { error, spec: s.clone(), clock }
        };
        let barometer = |(i, s): (usize, &suite::Barometer)| {
            let mut clock = Clock::new(SensorKind::Barometer, i, s.timing, seed);
            let error = ScalarError::new(s.pressure, s.timing.period_s(), &mut clock.stream);
            Barometer { error, drift_pa_per_c: s.drift_pa_per_c, clock }
        };
        let gnss = |s: &suite::Gnss| {
            let mut clock = Clock::new(SensorKind::Gnss, 0, s.timing, seed);
            let [x, y, _] = triple(s.horizontal, &s.timing, &mut clock.stream);
            let z = ScalarError::new(s.vertical, s.timing.period_s(), &mut clock.stream);
            let velocity = triple(s.velocity, &s.timing, &mut clock.stream);
            Gnss { position: [x, y, z], velocity, spec: s.clone(), clock }
        };
        let mocap = |s: &suite::MocapPose| {
            let mut clock = Clock::new(SensorKind::MocapPose, 0, s.timing, seed);
            let position = triple(s.position, &s.timing, &mut clock.stream);
            let attitude = triple(s.attitude, &s.timing, &mut clock.stream);
            MocapPose { position, attitude, clock }
        };
        let ranges = |s: &suite::CameraRanges| {
            let mut clock = Clock::new(SensorKind::CameraRanges, 0, s.timing, seed);
            let period_s = s.timing.period_s();
            let error = std::array::from_fn(|_| ScalarError::new(s.range, period_s, &mut clock.stream));
            CameraRanges { error, spec: s.clone(), clock }
        };
        Self {
            site,
            outages: outages.to_vec(),
            imus: suite.imus.iter().enumerate().map(imu).collect(),
            heights: suite.heights.iter().enumerate().map(height).collect(),
            barometers: suite.barometers.iter().enumerate().map(barometer).collect(),
            gnss: suite.gnss.as_ref().map(gnss),
            mocap_pose: suite.mocap_pose.as_ref().map(mocap),
            camera_ranges: suite.camera_ranges.as_ref().map(ranges),
            battery: suite.battery_sigma_v.map(|sigma| (sigma, Stream::new(seed, "battery"))),
        }
    }

    /// Everything that arrives at `time`. Never allocates.
    pub fn sense(&mut self, world: &World, time: FlightTime) -> SensorFrame {
        let mut frame = SensorFrame { time, ..SensorFrame::default() };
        let x = world.body();
        let q = x.world_from_body;
        let site = &self.site;
        let outages = self.outages.as_slice();
        let warm_c = WARM_UP_C * (1.0 - (-time.as_seconds() / WARM_UP_S).exp());
        let temperature_c = site.temperature_c + warm_c;
        let w = x.body_rates_radps;

        for (imu, slot) in self.imus.iter_mut().zip(&mut frame.imus) {
            let Imu { clock, position_flu_m, body_from_sensor, gyro, accel, mag, distort } = imu;
            *slot = clock.tick(time, outages, |stream| {
                // At r from the centre of mass: a + α × r + ω × (ω × r).
                let r = &*position_flu_m;
                let force = world.specific_force_flu_mps2()
                    + world.angular_acceleration_radps2().cross(r)
                    + w.cross(&w.cross(r));
                let sensor_from_body = body_from_sensor.inverse();
                let gyro = read3(gyro, &(distort.gyro * (sensor_from_body * w)), stream);
                let accel = read3(accel, &(distort.accel * (sensor_from_body * force)), stream);
                let mag_ut = mag.as_mut().map(|errors| {
                    let field = rotate(&q.conjugate(), &site.magnetic_field_enu_ut);
                    let seen = distort.mag * (sensor_from_body * field) + distort.hard_iron_ut;
                    *body_from_sensor * read3(errors, &seen, stream)
                });
                Some(ImuSample {
                    time,
                    gyro_radps: *body_from_sensor * gyro,
                    accel_mps2: *body_from_sensor * accel,
                    mag_ut,
                    temperature_c,
                })
            });
        }
        let attitude = x.attitude();
        for (height, slot) in self.heights.iter_mut().zip(&mut frame.heights) {
            let Height { clock, spec, error } = height;
            *slot = clock.tick(time, outages, |stream| {
                // The scan finds the vertical, so the unit's own height is measured; the driver adds its
                // mounting as if level. The lever's share of a tilt (millimetres) stays in.
                let own_m = x.position_enu_m.z + rotate(&q, &spec.position_flu_m).z;
                let reading_m = error.read(own_m, stream);
                let seen = (spec.nearest_m..=spec.height.range).contains(&reading_m)
                    && tilt_rad(&attitude) <= spec.tilt_max_rad;
                seen.then(|| HeightSample { time, height_m: reading_m - spec.position_flu_m.z })
            });
        }
        for (barometer, slot) in self.barometers.iter_mut().zip(&mut frame.barometers) {
            let Barometer { clock, drift_pa_per_c, error } = barometer;
            *slot = clock.tick(time, outages, |stream| {
                let truth_pa = site.pressure_pa(x.position_enu_m.z) + *drift_pa_per_c * warm_c;
                Some(BarometerSample { time, pressure_pa: error.read(truth_pa, stream), temperature_c })
            });
        }
        if let Some(Gnss { clock, spec, position, velocity }) = &mut self.gnss {
            frame.gnss = clock.tick(time, outages, |stream| {
                let position_enu_m = read3(position, &x.position_enu_m, stream);
                let horizontal = spec.horizontal.sigma.hypot(spec.horizontal.bias_sigma);
                let vertical = spec.vertical.sigma.hypot(spec.vertical.bias_sigma);
                Some(GnssSample {
                    time,
                    position_enu_m,
                    velocity_enu_mps: read3(velocity, &x.velocity_enu_mps, stream),
                    geodetic: site.geodetic(&position_enu_m),
                    horizontal_sigma_m: horizontal,
                    vertical_sigma_m: vertical,
                    satellites: 11,
                })
            });
        }
        if let Some(MocapPose { clock, position, attitude: errors }) = &mut self.mocap_pose {
            frame.mocap_pose = clock.tick(time, outages, |stream| {
                let error = read3(errors, &Vector3::zeros(), stream);
                Some(MocapPoseSample {
                    time,
                    position_enu_m: read3(position, &x.position_enu_m, stream),
                    world_from_body: UnitQuaternion::from_scaled_axis(error) * attitude,
                })
            });
        }
        if let Some(CameraRanges { clock, spec, error }) = &mut self.camera_ranges {
            frame.camera_ranges = clock.tick(time, outages, |stream| {
                let mut range_m = [0.0; CAMERAS];
                for ((range, camera), error) in range_m.iter_mut().zip(&spec.cameras_enu_m).zip(error) {
                    let to_camera = x.position_enu_m - camera;
                    let truth = if spec.marker_mean {
                        let marker = |m: &[f64; 3]| (to_camera + rotate(&q, &Vector3::from(*m))).norm();
                        MARKERS_FLU_M.iter().map(marker).sum::<f64>() / 4.0
                    } else {
                        to_camera.norm()
                    };
                    *range = error.read(truth, stream);
                }
                Some(CameraRangesSample { time, range_m })
            });
        }
        if let Some((sigma, stream)) = &mut self.battery {
            frame.battery_v = Some(world.battery_v() + *sigma * stream.normal());
        }
        frame
    }

    /// Bias of the accelerometer of IMU `index` (from 0) now, body FLU, m/s²: for tests.
    pub fn accel_bias_mps2(&self, index: usize) -> Option<Vector3<f64>> {
        let imu = self.imus.get(index)?;
        let [x, y, z] = &imu.accel;
        Some(imu.body_from_sensor * Vector3::new(x.bias(), y.bias(), z.bias()))
    }

    /// Bias of the gyroscope of IMU `index` (from 0) now, body FLU, rad/s: for tests.
    pub fn gyro_bias_radps(&self, index: usize) -> Option<Vector3<f64>> {
        let imu = self.imus.get(index)?;
        let [x, y, z] = &imu.gyro;
        Some(imu.body_from_sensor * Vector3::new(x.bias(), y.bias(), z.bias()))
    }
}
