//! Devices and motors as a vehicle.
//!
//! A frame holds what arrived since the one before; of several samples of one sensor the newest. What a device measures in
//! its own axes and at its own place is turned into the body frame here: mounting angles, the place of a height, what tilt
//! makes of it, degrees of latitude.

use std::sync::Arc;
use std::time::Duration;

use nalgebra::{Quaternion, Rotation3, UnitQuaternion, Vector3};
use plumbline_core::estimate::vqf::{Vqf, VqfOptions};
use plumbline_core::event::{Severity, Text, text};
use plumbline_core::flight::Guide;
use plumbline_core::model::geodesy::{Geodetic, Projection as _, TangentPlane};
use plumbline_core::sensor::{
    AnySample, BarometerSample, GnssSample, HeightSample, ImuSample, MocapPoseSample, SensorFrame,
};
use plumbline_core::types::MotorCommand;
use plumbline_core::vehicle::{AutopilotState, Awaited, DeviceState, MotorStop, Scan, Vehicle, VehicleError};
use plumbline_proto::time::FlightTime;

use crate::following::Following;
use crate::motors::Motors;
use crate::protocol::scan_height;
use crate::reader::{Arrived, Notice, Reader, Zero};
use crate::reading::{RangeReading, Reading};

/// Of a vehicle whose flight time is told no rate.
const TICK: Duration = Duration::from_millis(5);
/// A voltage counts for this long, s.
const VOLTAGE_S: f64 = 1.0;

/// Where a device sits and which places of a frame it fills.
#[derive(Debug, Clone)]
pub struct Mounted {
    /// For people.
    pub name: String,
    /// Where it is attached.
    pub port: String,
    /// Place of its samples of any kind in the frame: instance less 1.
    pub index: usize,
    /// Place of its pressure, for a device that has both.
    pub barometer: usize,
    /// Its axes in the body.
    pub body_from_sensor: Rotation3<f64>,
    /// Where it sits, FLU from the centre of mass, m.
    pub position_flu_m: Vector3<f64>,
    /// Where a GNSS receiver's local metres are zero; the first fix when absent.
    pub origin: Option<TangentPlane>,
    /// ENU from the axes of a motion-capture system.
    pub world_from_mocap: UnitQuaternion<f64>,
}

/// A quadrotor that is really there.
pub struct HardwareVehicle {
    devices: Vec<(Mounted, Reader)>,
    motors: Arc<dyn Motors>,
    tick_us: u64,
    next: FlightTime,
    zero: Zero,
    following: Following,
    level: Level,
    voltage: Option<(FlightTime, f64)>,
}

/// Attitude from the first IMU alone, for what tilt makes of a height.
struct Level {
    filter: Vqf,
    last: Option<FlightTime>,
}

impl Level {
    fn push(&mut self, sample: &ImuSample) {
        let since = self.last.map_or(0.0, |last| sample.time.seconds_since(last));
        if self.last.is_none() || since > 0.0 {
            self.filter.push(since.clamp(1e-4, 0.1), &sample.gyro_radps, &sample.accel_mps2, None);
            self.last = Some(sample.time);
        }
    }

    /// The world's vertical in the body frame.
    fn up_flu(&self) -> Vector3<f64> {
        self.filter.world_from_body().inverse() * Vector3::z()
    }
}

impl HardwareVehicle {
    /// Of `devices` and `motors`, at the ticks of `zero`, which are moved to where samples are young.
    pub fn new(devices: Vec<(Mounted, Reader)>, motors: Arc<dyn Motors>, zero: Zero) -> Self {
        let tick = zero.tick().unwrap_or(TICK);
        let options = VqfOptions { period_s: 0.01, use_mag: false, declination_rad: 0.0 };
        Self {
            devices,
            motors,
            tick_us: (1e6 * tick.as_secs_f64()).round() as u64,
            next: FlightTime(0),
            zero,
            following: Following::new(tick.as_secs_f64()),
            level: Level { filter: Vqf::new(options), last: None },
            voltage: None,
        }
    }

    /// The devices.
    pub fn devices(&self) -> impl Iterator<Item = (&Mounted, &Reader)> {
        self.devices.iter().map(|(mounted, reader)| (mounted, reader))
    }
}

impl Vehicle for HardwareVehicle {
    fn awaited(&mut self) -> Option<Awaited> {
        let set_back_ns = self.following.step_ns();
        self.zero.set_back(set_back_ns);
        Some(Awaited { time: self.next, set_back_ns })
    }

    fn sense(&mut self) -> Result<SensorFrame, VehicleError> {
        let mut frame = SensorFrame { time: self.next, ..SensorFrame::default() };
        self.next = FlightTime(self.next.0 + self.tick_us);
        let Self { devices, level, voltage, following, .. } = self;
        for (number, (mounted, reader)) in devices.iter_mut().enumerate() {
            let mut inertial = false;
            while let Some(mut arrived) = reader.pop() {
                arrived.time = arrived.time.min(frame.time);
                inertial |= matches!(arrived.reading, Reading::Imu(_));
                if let Reading::Battery(volts) = arrived.reading {
                    *voltage = Some((arrived.time, volts));
                } else if let Some((index, sample)) = sample(mounted, level, &arrived) {
                    frame.put(index, sample);
                }
            }
            if inertial && reader.talks() {
                following.sample(number, frame.time.seconds_since(reader.state().last()));
            }
        }
        frame.battery_v = voltage.filter(|(time, _)| frame.time.seconds_since(*time) <= VOLTAGE_S).map(|(_, v)| v);
        Ok(frame)
    }

    fn guide(&mut self, guide: Option<&Guide<'_>>) {
        self.motors.guide(guide);
    }

    fn autopilot(&self) -> Option<AutopilotState> {
        self.motors.autopilot()
    }

    fn actuate(&mut self, command: &MotorCommand) -> Result<MotorCommand, VehicleError> {
        let clipped = command.throttle.map(|t| if t.is_nan() { 0.0 } else { t.clamp(0.0, 1.0) });
        let gone = |error: std::io::Error| VehicleError::Invalid { what: "motors".into(), reason: error.to_string() };
        self.motors.send(&MotorCommand { throttle: clipped }).map_err(gone)
    }

    fn motor_stop(&self) -> Option<Arc<dyn MotorStop>> {
        Some(self.motors.clone())
    }

    /// Whole ticks, as the readers ask by them: by what is left the next one is late.
    fn pass_over(&mut self, gap_s: f64) -> f64 {
        let gap_us = if gap_s > 0.0 { (gap_s.min(86_400.0) * 1e6) as u64 } else { 0 };
        let passed_us = gap_us - gap_us % self.tick_us;
        self.next = FlightTime(self.next.0 + passed_us);
        passed_us as f64 * 1e-6
    }

    fn device(&mut self, index: usize) -> Option<DeviceState<'_>> {
        let (mounted, reader) = self.devices.get_mut(index)?;
        let (health, rate_hz) = (reader.state().health(), reader.rate_hz(self.next));
        let age_s = || self.next.seconds_since(FlightTime(health.last_us)).max(0.0);
        Some(DeviceState {
            name: &mounted.name,
            port: &mounted.port,
            up: health.up,
            rate_hz,
            age_s: (health.last_us > 0).then(age_s),
            jitter_us: (health.jitter_us > 0.0).then_some(health.jitter_us),
            round_trip_us: (health.round_trip_us > 0.0).then_some(health.round_trip_us),
            clock_offset_us: (health.round_trip_us > 0.0).then_some(health.clock_offset_us),
            faults: health.faults,
            given_up: health.given_up,
            opened: health.opened,
            reason: health.reason,
        })
    }

    fn scans(&mut self, each: &mut dyn FnMut(Scan<'_>)) {
        for (mounted, reader) in &mut self.devices {
            while let Some((time, scanned)) = reader.scan() {
                let body_from_scanner = UnitQuaternion::from_rotation_matrix(&mounted.body_from_sensor);
                each(Scan {
                    instance: mounted.index as u16 + 1,
                    time,
                    device_time_ms: scanned.stamp_ms,
                    first_angle_rad: scan_height::angle_rad(0),
                    step_angle_rad: scan_height::STEP_RAD,
                    ranges_mm: &scanned.ranges_mm,
                    position_flu_m: mounted.position_flu_m,
                    body_from_scan: body_from_scanner * scanner_from_scan(),
                });
            }
        }
    }

    fn notice(&mut self) -> Option<(Severity, Text)> {
        self.devices.iter_mut().find_map(|(mounted, reader)| {
            let name = &mounted.name;
            Some(match reader.notice()? {
                Notice::Up => (Severity::Info, text(format_args!("{name} gives readings"))),
                Notice::Lost(reason) => (Severity::Warning, text(format_args!("{name} lost: {reason}"))),
                Notice::Clock(jumped_s) => {
                    let (by_s, way) = (jumped_s.abs(), if jumped_s < 0.0 { "back" } else { "forward" });
                    (Severity::Warning, text(format_args!("{name}: its clock jumped {way} by {by_s:.3} s")))
                }
            })
        })
    }
}

/// A scanner looks along −z of its axes, and its angles go from there to −y: half a turn about the bisector of x and −z.
fn scanner_from_scan() -> UnitQuaternion<f64> {
    let half = std::f64::consts::FRAC_1_SQRT_2;
    UnitQuaternion::new_unchecked(Quaternion::new(0.0, half, 0.0, -half))
}

/// A reading in the body's terms, and its place in the frame.
fn sample(mounted: &mut Mounted, level: &mut Level, arrived: &Arrived) -> Option<(usize, AnySample)> {
    let time = arrived.time;
    let body = &mounted.body_from_sensor;
    let sample = match arrived.reading {
        Reading::Imu(imu) => {
            let sample = ImuSample {
                time,
                gyro_radps: body * imu.gyro_radps,
                accel_mps2: body * imu.accel_mps2,
                mag_ut: imu.mag_ut.map(|field| body * field),
                temperature_c: imu.temperature_c,
            };
            if mounted.index == 0 {
                level.push(&sample);
            }
            AnySample::Imu(sample)
        }
        Reading::Barometer(b) => {
            let sample = BarometerSample { time, pressure_pa: b.pressure_pa, temperature_c: b.temperature_c };
            return Some((mounted.barometer, AnySample::Barometer(sample)));
        }
        Reading::Range(range) => {
            AnySample::Height(HeightSample { time, height_m: height_m(mounted, &range, &level.up_flu())? })
        }
        Reading::Fix(fix) => {
            let [latitude_deg, longitude_deg, altitude_m] = fix.geodetic;
            let place = Geodetic::from_degrees(latitude_deg, longitude_deg, altitude_m);
            let plane = mounted.origin.get_or_insert_with(|| TangentPlane::new(place));
            AnySample::Gnss(GnssSample {
                time,
                position_enu_m: plane.enu_m(&place),
                velocity_enu_mps: fix.velocity_enu_mps,
                geodetic: fix.geodetic,
                horizontal_sigma_m: fix.horizontal_sigma_m,
                vertical_sigma_m: fix.vertical_sigma_m,
                satellites: fix.satellites,
            })
        }
        Reading::Pose(pose) => {
            let world = mounted.world_from_mocap;
            let body_in_mocap = pose.attitude * UnitQuaternion::from_rotation_matrix(&body.inverse());
            let world_from_body = world * body_in_mocap;
            AnySample::MocapPose(MocapPoseSample {
                time,
                position_enu_m: world * pose.position_m - world_from_body * mounted.position_flu_m,
                world_from_body,
            })
        }
        Reading::Battery(_) => return None,
    };
    Some((mounted.index, sample))
}

/// Height of the centre of mass: the distance along the world's vertical, plus the lever. `None` beyond 60° of tilt.
fn height_m(mounted: &Mounted, range: &RangeReading, up_flu: &Vector3<f64>) -> Option<f64> {
    let up = mounted.body_from_sensor.inverse() * up_flu;
    // A beam looks along −z of its own axes; a scan lies in its y-z plane and finds the vertical there.
    let factor = if range.scanned { up.yz().norm() } else { up.z };
    (factor > 0.5).then(|| range.distance_m * factor - up_flu.dot(&mounted.position_flu_m))
}

#[cfg(test)]
mod tests {
    use std::os::unix::net::UnixStream;
    use std::time::Instant;

    use super::*;
    use crate::motors::GuardLine;

    /// GIVEN a tick that begins late by no whole number of them WHEN that is passed over THEN the tick is one of those that the
    /// readers ask by, and flight time is what it was.
    #[test]
    fn a_silence_is_passed_over_in_whole_ticks() {
        let (near, _far) = UnixStream::pair().unwrap();
        let due = Instant::now();
        let zero = Zero::ticking(200.0);
        zero.set(due);
        let mut vehicle = HardwareVehicle::new(Vec::new(), Arc::new(GuardLine::new(near).unwrap()), zero.clone());
        let started = due + Duration::from_millis(118);
        assert!((vehicle.pass_over(0.118) - 0.115).abs() < 1e-9);
        assert_eq!(vehicle.sense().unwrap().time, FlightTime(115_000));
        assert!((zero.micros(started).unwrap() - 118_000.0).abs() < 2.0, "{:?}", zero.micros(started));
        let (tick, _) = zero.nearest_tick(due + Duration::from_millis(116)).unwrap();
        assert!((zero.micros(tick).unwrap() - 115_000.0).abs() < 2.0, "{:?}", tick - due);
    }

    fn mounted(position_flu_m: Vector3<f64>) -> Mounted {
        Mounted {
            name: "height 1".into(),
            port: String::new(),
            index: 0,
            barometer: 0,
            body_from_sensor: Rotation3::identity(),
            position_flu_m,
            origin: None,
            world_from_mocap: UnitQuaternion::identity(),
        }
    }

    #[test]
    fn the_axes_of_a_scan_are_those_of_its_ranges() {
        // Rolled to its left, y up, a scanner sees the floor on its right: at the angle where its range is the shortest.
        let up: Vector3<f64> = UnitQuaternion::from_euler_angles(0.2, 0.0, 0.0).inverse() * Vector3::z();
        let ranges = scan_height::encode(1.0, up.y.atan2(up.z), 4.0, || 0.0);
        let nearest = ranges.iter().enumerate().filter(|(_, mm)| **mm > 0).min_by_key(|(_, mm)| **mm).unwrap().0;
        let (sin, cos) = scan_height::angle_rad(nearest).sin_cos();
        let beam = scanner_from_scan() * Vector3::new(cos, sin, 0.0);
        assert!((beam + up).norm() < 0.05, "{beam} down {}", -up);
    }

    #[test]
    fn slant_and_lever_are_removed_from_heights() {
        let arm = Vector3::new(0.08, -0.03, -0.05);
        for (roll, pitch) in [(0.0, 0.0), (0.2, 0.0), (0.0, -0.3), (0.15, 0.25)] {
            let attitude = UnitQuaternion::from_euler_angles(roll, pitch, 0.7);
            let up = attitude.inverse() * Vector3::z();
            let own_m = 1.3 + (attitude * arm).z;
            // Along the beam, and to the floor's line in the plane of a scan.
            let beam = RangeReading { distance_m: own_m / up.z, scanned: false, sigma_m: 0.0 };
            let scan = RangeReading { distance_m: own_m / up.yz().norm(), scanned: true, sigma_m: 0.0 };
            for range in [beam, scan] {
                let height = height_m(&mounted(arm), &range, &up).unwrap();
                assert!((height - 1.3).abs() < 1e-9, "roll {roll} pitch {pitch}: {height}");
            }
        }
        let range = RangeReading { distance_m: 1.0, scanned: false, sigma_m: 0.0 };
        assert_eq!(height_m(&mounted(arm), &range, &Vector3::x()), None, "on its side");
    }
}
