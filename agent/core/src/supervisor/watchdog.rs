//! Tilt, rate, height and place straight from the sensors: the median over instances, an attitude filter of its own
//! (`estimate/vqf`, without magnetometer), no estimator.
//!
//! It receives what the estimators receive: a vehicle that is really attacked has no other samples. Where the
//! configuration names independent sensors it reads only those of that kind; nothing can be injected into them.

use arrayvec::ArrayVec;
use nalgebra::{UnitQuaternion, Vector3};
use plumbline_proto::ids::SensorId;
use plumbline_proto::time::FlightTime;
use plumbline_proto::v1::SensorKind;

use crate::estimate::median;
use crate::estimate::vqf::{Vqf, VqfOptions};
use crate::frames::tilt_rad;
use crate::sensor::{MAX_HEIGHTS, MAX_IMUS, SensorFrame};
use crate::types::GRAVITY_MPS2;

/// Heights and places older than this are forgotten, s.
const MEASURED_MAX_AGE_S: f64 = 0.5;
/// Their slopes are taken over at least this long, s: shorter, they are noise.
const SLOPE_BASELINE_S: f64 = 0.08;
/// A value further from where the last ones lead, m, is taken when so many in a row are: a beam meets a string, a leg or a net for a
/// scan or two, a camera takes one marker for another.
const SPURIOUS_M: f64 = 0.2;
const LASTING: u8 = 3;
/// The climb by the accelerometers is corrected by this part of its difference from each slope …
const COAST_SHARE: f64 = 0.3;
/// … and is worth something this long after the last one, s.
const COAST_MAX_S: f64 = 8.0;
/// A sample takes part in the median this long, s: IMUs sample in turns at 100 Hz and faster.
const IMU_MEMORY_S: f64 = 0.015;
/// Specific forces further from 1 g than this fraction say nothing of the vertical.
const ACCEL_TRUST: f64 = 0.2;

/// Angular rate and specific force of one IMU, body FLU, rad/s and m/s².
type Inertial = (Vector3<f64>, Vector3<f64>);

/// Last height of one laser, or place along one axis, and how it changes.
#[derive(Debug, Clone, Copy)]
struct Measured {
    time: FlightTime,
    value_m: f64,
    /// Where its present slope is measured from.
    from: (FlightTime, f64),
    slope_mps: Option<f64>,
    /// So many since were not taken.
    spurious: u8,
}

impl Measured {
    fn first(time: FlightTime, value_m: f64) -> Self {
        Self { time, value_m, from: (time, value_m), slope_mps: None, spurious: 0 }
    }

    /// Where the last values lead at `time`, m.
    fn led_m(&self, time: FlightTime) -> f64 {
        self.value_m + self.slope_mps.unwrap_or(0.0) * time.seconds_since(self.time)
    }

    fn then(self, time: FlightTime, value_m: f64) -> Self {
        if (value_m - self.led_m(time)).abs() > SPURIOUS_M {
            let spurious = self.spurious + 1;
            return if spurious < LASTING { Self { spurious, ..self } } else { Self::first(time, value_m) };
        }
        self.led(time, value_m)
    }

    fn led(self, time: FlightTime, value_m: f64) -> Self {
        let (since, from_m) = self.from;
        let baseline_s = time.seconds_since(since);
        if baseline_s < SLOPE_BASELINE_S {
            return Self { time, value_m, spurious: 0, ..self };
        }
        let slope_mps = Some((value_m - from_m) / baseline_s);
        Self { time, value_m, from: (time, value_m), slope_mps, spurious: 0 }
    }

    /// Takes `new` where there is one, and forgets what is too old.
    fn take(kept: &mut Option<Self>, new: Option<f64>, time: FlightTime) {
        if kept.is_some_and(|last| time.seconds_since(last.time) > MEASURED_MAX_AGE_S) {
            *kept = None;
        }
        if let Some(value_m) = new.filter(|value| value.is_finite()) {
            *kept = Some(kept.map_or(Self::first(time, value_m), |last| last.then(time, value_m)));
        }
    }
}

/// What follows from the samples, worked out once a tick and asked for many times.
#[derive(Debug, Clone, Copy, Default)]
struct Judged {
    world_from_body: UnitQuaternion<f64>,
    tilt_rad: f64,
    height_m: Option<f64>,
    climb_mps: Option<f64>,
}

/// See the module.
#[derive(Debug, Clone)]
pub struct Watchdog {
    filter: Vqf,
    judged: Judged,
    rates_radps: Vector3<f64>,
    force_mps2: Vector3<f64>,
    since_imu_s: f64,
    imu_time: Option<FlightTime>,
    imus: [Option<(FlightTime, Inertial)>; MAX_IMUS],
    heights: [Option<Measured>; MAX_HEIGHTS],
    /// East, north and up by motion capture.
    places: [Option<Measured>; 3],
    altitude_time: Option<FlightTime>,
    /// Climb by the accelerometers since the last slope of the heights, m/s, and when that was.
    coasting: Option<(FlightTime, f64)>,
    reads_imu: [bool; MAX_IMUS],
    reads_height: [bool; MAX_HEIGHTS],
}

/// The instances of `kind` to read: the independent ones, or all where none is named.
fn instances<const N: usize>(kind: SensorKind, independent: &[SensorId]) -> [bool; N] {
    let named: [bool; N] =
        std::array::from_fn(|i| independent.iter().any(|s| s.kind == kind && usize::from(s.instance) == i + 1));
    if named.contains(&true) { named } else { [true; N] }
}

impl Watchdog {
    /// With these `independent` sensors; none: it reads all.
    pub fn new(independent: &[SensorId]) -> Self {
        Self {
            filter: Vqf::new(VqfOptions { use_mag: false, ..VqfOptions::default() }),
            judged: Judged::default(),
            rates_radps: Vector3::zeros(),
            force_mps2: Vector3::zeros(),
            since_imu_s: 0.0,
            imu_time: None,
            imus: [None; MAX_IMUS],
            heights: [None; MAX_HEIGHTS],
            places: [None; 3],
            altitude_time: None,
            coasting: None,
            reads_imu: instances(SensorKind::Imu, independent),
            reads_height: instances(SensorKind::Height, independent),
        }
    }

    /// Takes the frame received.
    pub fn step(&mut self, received: &SensorFrame, dt_s: f64) {
        self.since_imu_s += dt_s;
        self.take_imus(received);
        let measured = received.heights.iter().any(Option::is_some)
            || received.gnss.is_some()
            || received.mocap_pose.is_some()
            || received.camera_ranges.is_some();
        self.altitude_time = if measured { Some(received.time) } else { self.altitude_time };
        for ((kept, new), reads) in self.heights.iter_mut().zip(&received.heights).zip(self.reads_height) {
            Measured::take(kept, new.filter(|_| reads).map(|h| h.height_m), received.time);
        }
        for (axis, kept) in self.places.iter_mut().enumerate() {
            let place_m = received.mocap_pose.and_then(|pose| pose.position_enu_m.get(axis).copied());
            Measured::take(kept, place_m, received.time);
        }
        // Motion capture speaks where no laser does.
        let lasers = self.heights.iter().flatten().count();
        let heights = || self.heights.iter().flatten().chain(self.places[2].iter().filter(|_| lasers == 0));
        self.judged.height_m = Some(median(heights().map(|h| h.value_m))).filter(|height| height.is_finite());
        self.judged.climb_mps = Some(median(heights().filter_map(|h| h.slope_mps))).filter(|climb| climb.is_finite());
        let new = received.heights.iter().any(Option::is_some) || lasers == 0 && received.mocap_pose.is_some();
        if let Some(slope_mps) = self.climb_mps().filter(|_| new) {
            let before_mps = self.coasting.map_or(slope_mps, |(_, climb_mps)| climb_mps);
            self.coasting = Some((received.time, before_mps + COAST_SHARE * (slope_mps - before_mps)));
        }
    }

    fn take_imus(&mut self, received: &SensorFrame) {
        let mut fresh = false;
        for ((kept, new), reads) in self.imus.iter_mut().zip(&received.imus).zip(self.reads_imu) {
            let finite = |v: &Vector3<f64>| v.iter().all(|x| x.is_finite());
            let Some(new) = new.filter(|s| reads && finite(&s.gyro_radps) && finite(&s.accel_mps2)) else { continue };
            let sample = (new.gyro_radps, new.accel_mps2);
            // An IMU that repeats itself to the last bit is stuck: its noise alone changes every sample.
            fresh |= kept.is_none_or(|(_, before)| before != sample);
            *kept = Some((received.time, sample));
        }
        if !fresh {
            return;
        }
        let lately = |time: &FlightTime| (0.0..=IMU_MEMORY_S).contains(&received.time.seconds_since(*time));
        let latest: ArrayVec<Inertial, MAX_IMUS> =
            self.imus.iter().flatten().filter(|(time, _)| lately(time)).map(|(_, sample)| *sample).collect();
        let gyro = Vector3::from_fn(|axis, _| median(latest.iter().map(|(gyro, _)| gyro[axis])));
        let accel = Vector3::from_fn(|axis, _| median(latest.iter().map(|(_, accel)| accel[axis])));
        let since_s = if self.imu_time.is_some() { self.since_imu_s } else { 0.0 };
        // In a flip the thrust is along body z and far from 1 g: the gyroscope alone is right then.
        let near_1_g = (accel.norm() / GRAVITY_MPS2 - 1.0).abs() < ACCEL_TRUST;
        let force = if near_1_g { accel } else { Vector3::zeros() };
        self.filter.push(since_s, &gyro, &force, None);
        self.judged.world_from_body = self.filter.world_from_body();
        self.judged.tilt_rad = tilt_rad(&self.judged.world_from_body);
        let lift_mps2 = (self.judged.world_from_body * accel).z - GRAVITY_MPS2;
        let lasting = self.coasting.filter(|(from, _)| received.time.seconds_since(*from) < COAST_MAX_S);
        self.coasting = lasting.map(|(from, climb_mps)| (from, climb_mps + lift_mps2 * since_s));
        (self.rates_radps, self.force_mps2) = (gyro, accel);
        (self.imu_time, self.since_imu_s) = (Some(received.time), 0.0);
    }

    /// Angle between body z and the vertical, rad; zero before the first sample.
    pub fn tilt_rad(&self) -> f64 {
        self.judged.tilt_rad
    }

    /// Angle between its vertical and that of `attitude`, rad; infinite before the first sample.
    pub fn disagreement_rad(&self, attitude: &UnitQuaternion<f64>) -> f64 {
        if self.imu_time.is_none() {
            return f64::INFINITY;
        }
        self.up_flu().angle(&(attitude.inverse() * Vector3::z()))
    }

    /// World z seen from the body.
    fn up_flu(&self) -> Vector3<f64> {
        self.judged.world_from_body.inverse() * Vector3::z()
    }

    /// Body rates, median over the IMUs, rad/s.
    pub fn rates_radps(&self) -> Vector3<f64> {
        self.rates_radps
    }

    /// Specific force, body FLU, median over the IMUs, m/s².
    pub fn force_mps2(&self) -> Vector3<f64> {
        self.force_mps2
    }

    /// Attitude with yaw zero, for a descent without estimator.
    pub fn attitude(&self) -> UnitQuaternion<f64> {
        let up = self.up_flu();
        UnitQuaternion::from_euler_angles(up.y.atan2(up.z), (-up.x).clamp(-1.0, 1.0).asin(), 0.0)
    }

    /// The highest of the raw heights, m.
    pub fn highest_m(&self) -> Option<f64> {
        self.heights.iter().flatten().map(|h| h.value_m).reduce(f64::max)
    }

    /// Median of the heights of the last half second, m; by motion capture where no laser measured one.
    pub fn height_m(&self) -> Option<f64> {
        self.judged.height_m
    }

    /// Do most of the heights read as their median does, or are there fewer than three?
    pub fn heights_agree(&self, now: FlightTime) -> bool {
        let heights = || self.heights.iter().flatten().map(|h| h.led_m(now));
        let (count, middle_m) = (heights().count(), median(heights()));
        count < 3 || 2 * heights().filter(|led_m| (led_m - middle_m).abs() < SPURIOUS_M).count() > count
    }

    /// Median of the slopes of these heights, m/s.
    pub fn climb_mps(&self) -> Option<f64> {
        self.judged.climb_mps
    }

    /// Place along `axis` (0 east, 1 north) as motion capture measured it within the last half second, m, and its slope, m/s.
    pub fn place(&self, axis: usize) -> Option<(f64, f64)> {
        let place = self.places.get(axis).copied().flatten()?;
        Some((place.value_m, place.slope_mps.unwrap_or(0.0)))
    }

    /// Climb by the accelerometers, m/s, from the last slope of the heights on, for as long as that is worth something.
    pub fn coasting_mps(&self) -> Option<f64> {
        self.coasting.map(|(_, climb_mps)| climb_mps)
    }

    /// Time since a fresh IMU sample, s; infinite before the first.
    pub fn imu_age_s(&self, now: FlightTime) -> f64 {
        self.imu_time.map_or(f64::INFINITY, |time| now.seconds_since(time))
    }

    /// Time since anything measured an altitude, s; infinite before the first. A barometer's drifts, and counts as none.
    pub fn altitude_age_s(&self, now: FlightTime) -> f64 {
        self.altitude_time.map_or(f64::INFINITY, |time| now.seconds_since(time))
    }

    /// How many laser heights arrived within the last half second.
    pub fn heights_fresh(&self) -> usize {
        self.heights.iter().flatten().count()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sensor::{HeightSample, ImuSample, MocapPoseSample};

    const DT_S: f64 = 0.005;

    fn imu(time: FlightTime, gyro: Vector3<f64>, accel: Vector3<f64>) -> ImuSample {
        ImuSample { time, gyro_radps: gyro, accel_mps2: accel, mag_ut: None, temperature_c: 20.0 }
    }

    /// A roll of 1 rad/s for a second in which IMU 3 and height 2 are faulty; all IMUs sample at once, or in turns.
    fn rolled(independent: &[SensorId], in_turns: bool) -> (Watchdog, f64) {
        let mut watchdog = Watchdog::new(independent);
        let mut tilt = 0.0;
        for k in 0..200_u64 {
            let mut frame = SensorFrame { time: FlightTime(k * 5000), ..SensorFrame::default() };
            for (n, slot) in frame.imus.iter_mut().enumerate().take(4) {
                if in_turns && n as u64 % 2 != k % 2 {
                    continue;
                }
                let fault = if n == 2 { 50.0 } else { 0.0 };
                // In flight only the thrust is felt: along body z, whatever the tilt.
                let noise = 1e-6 * (k * 7 % 5) as f64;
                let accel = Vector3::new(fault, 0.0, 14.0 + noise);
                *slot = Some(imu(frame.time, Vector3::new(1.0 + fault, 0.0, fault), accel));
            }
            for (slot, height_m) in frame.heights.iter_mut().zip([1.0, 9.0, 1.1]) {
                *slot = Some(HeightSample { time: frame.time, height_m });
            }
            watchdog.step(&frame, DT_S);
            tilt += DT_S;
        }
        (watchdog, tilt)
    }

    #[test]
    fn follows_a_roll_with_one_faulty_imu_also_when_imus_sample_in_turns() {
        for in_turns in [false, true] {
            let (watchdog, tilt) = rolled(&[], in_turns);
            assert!((watchdog.tilt_rad() - tilt).abs() < 0.02, "{} after {tilt}", watchdog.tilt_rad());
            let (roll, pitch, _) = watchdog.attitude().euler_angles();
            assert!((roll - tilt).abs() < 0.02 && pitch.abs() < 1e-6);
            assert_eq!(watchdog.height_m(), Some(1.1));
        }
    }

    #[test]
    fn heights_are_forgotten_and_a_stuck_imu_is_not_fresh() {
        let (mut watchdog, _) = rolled(&[], false);
        let stuck = |time: u64| {
            let mut frame = SensorFrame { time: FlightTime(time), ..SensorFrame::default() };
            frame.imus[0] = Some(imu(frame.time, Vector3::zeros(), Vector3::z()));
            frame
        };
        for k in 0..20 {
            watchdog.step(&stuck(1_000_000 + 5000 * k), DT_S);
        }
        assert!((watchdog.imu_age_s(FlightTime(1_095_000)) - 0.095).abs() < 1e-9, "fresh at its first sample only");
        watchdog.step(&SensorFrame { time: FlightTime(3_000_000), ..SensorFrame::default() }, DT_S);
        assert_eq!((watchdog.height_m(), watchdog.heights_fresh()), (None, 0));
    }

    #[test]
    fn a_climb_is_the_median_slope_at_any_rate_of_the_lasers() {
        for every in [1, 20] {
            let mut watchdog = Watchdog::new(&[]);
            for k in 0..400_u64 {
                let mut frame = SensorFrame { time: FlightTime(k * 5000), ..SensorFrame::default() };
                let t_s = frame.time.as_seconds();
                for (n, slot) in frame.heights.iter_mut().enumerate().take(3) {
                    if (k + 7 * n as u64).is_multiple_of(every) {
                        let height_m = if n == 1 { 5.0 - 9.0 * t_s } else { 1.0 + 0.7 * t_s };
                        *slot = Some(HeightSample { time: frame.time, height_m });
                    }
                }
                watchdog.step(&frame, DT_S);
            }
            assert!((watchdog.climb_mps().unwrap() - 0.7).abs() < 1e-6, "{:?}", watchdog.climb_mps());
            assert!((watchdog.coasting_mps().unwrap() - 0.7).abs() < 1e-3, "{:?}", watchdog.coasting_mps());
            // Without heights it falls at 0.5 m/s² for a second; what is older than eight is worth nothing.
            for k in 400..2001_u64 {
                let mut frame = SensorFrame { time: FlightTime(k * 5000), ..SensorFrame::default() };
                let force = Vector3::new(0.0, 0.0, GRAVITY_MPS2 - 0.5 + 1e-6 * (k % 2) as f64);
                frame.imus[0] = Some(imu(frame.time, Vector3::zeros(), force));
                watchdog.step(&frame, DT_S);
                if k == 600 {
                    assert_eq!(watchdog.climb_mps(), None);
                    let climb_mps = watchdog.coasting_mps().unwrap();
                    assert!((climb_mps - 0.2).abs() < 0.01, "{climb_mps} m/s");
                }
            }
            assert_eq!(watchdog.coasting_mps(), None);
        }
    }

    /// GIVEN lasers at 10 Hz that sample in turns WHEN one of three is attacked and the beam of another meets something THEN they do not agree;
    /// two that read the same do, however fast they climb, and so do fewer than three.
    #[test]
    fn two_that_read_nothing_alike_are_no_majority() {
        let agree = |reads: &[fn(f64) -> f64]| {
            let mut watchdog = Watchdog::new(&[]);
            let mut now = FlightTime(0);
            for tick in 0..200_u64 {
                now = FlightTime(tick * 5000);
                let mut frame = SensorFrame { time: now, ..SensorFrame::default() };
                for (i, read) in reads.iter().enumerate().filter(|(i, _)| tick % 20 == 6 * *i as u64) {
                    frame.heights[i] = Some(HeightSample { time: now, height_m: read(now.as_seconds()) });
                }
                watchdog.step(&frame, DT_S);
            }
            watchdog.heights_agree(now)
        };
        assert!(!agree(&[|_| 0.0, |_| 0.4, |_| 1.2]));
        assert!(agree(&[|_| 0.0, |_| 1.15, |_| 1.2]) && agree(&[|_| 0.0, |t| 4.0 * t, |t| 4.0 * t]));
        assert!(agree(&[|_| 0.0, |_| 1.2]) && agree(&[|_| 0.4]) && agree(&[]));
        assert!(!agree(&[|_| 0.0, |_| 0.5, |_| 1.0, |_| 1.1]));
    }

    /// GIVEN three lasers at 10 Hz WHEN the beams of two meet something for two scans THEN the height stays, and a third scan is taken.
    #[test]
    fn what_a_beam_meets_for_a_scan_or_two_is_no_height() {
        let mut watchdog = Watchdog::new(&[]);
        let mut height_m = |scan: u64, reads_m: [f64; 3]| {
            let mut frame = SensorFrame { time: FlightTime(scan * 100_000), ..SensorFrame::default() };
            for (slot, height_m) in frame.heights.iter_mut().zip(reads_m) {
                *slot = Some(HeightSample { time: frame.time, height_m });
            }
            watchdog.step(&frame, 0.1);
            watchdog.height_m().unwrap()
        };
        // A climb of 2 m/s meanwhile is none.
        let climbing = |scan: u64| 1.0 + 0.2 * scan as f64;
        for scan in 0..20 {
            let z_m = climbing(scan);
            let meets = scan % 10 == 5 || scan % 10 == 6;
            let found_m = height_m(scan, [z_m, if meets { 0.3 } else { z_m }, if meets { 0.4 } else { z_m }]);
            assert!((found_m - z_m).abs() < 0.41, "{scan}: {found_m} at {z_m}");
        }
        let found_m = (20..24).map(|scan| height_m(scan, [climbing(scan), 0.3, 0.3])).last();
        assert_eq!(found_m, Some(0.3));
    }

    #[test]
    fn a_place_is_the_last_one_measured_with_its_slope_and_is_forgotten() {
        let mut watchdog = Watchdog::new(&[]);
        for k in 0..100_u64 {
            let mut frame = SensorFrame { time: FlightTime(k * 5000), ..SensorFrame::default() };
            let (t_s, time) = (frame.time.as_seconds(), frame.time);
            let position_enu_m = Vector3::new(1.5 * t_s, if k == 60 { f64::NAN } else { 2.0 - t_s }, 1.0);
            let pose = MocapPoseSample { time, position_enu_m, world_from_body: UnitQuaternion::identity() };
            frame.mocap_pose = (k % 2 == 0).then_some(pose);
            watchdog.step(&frame, DT_S);
        }
        let ((east_m, east_mps), (north_m, north_mps)) = (watchdog.place(0).unwrap(), watchdog.place(1).unwrap());
        assert!((east_m - 0.735).abs() < 1e-9 && (east_mps - 1.5).abs() < 1e-6, "{east_m} m, {east_mps} m/s");
        assert!((north_m - 1.51).abs() < 1e-9 && (north_mps + 1.0).abs() < 1e-6, "{north_m} m, {north_mps} m/s");
        // Where no laser measures, its height is the height; a laser comes first.
        assert_eq!((watchdog.height_m(), watchdog.climb_mps(), watchdog.heights_fresh()), (Some(1.0), Some(0.0), 0));
        let mut frame = SensorFrame { time: FlightTime(500_000), ..SensorFrame::default() };
        frame.heights[1] = Some(HeightSample { time: frame.time, height_m: 0.4 });
        watchdog.step(&frame, DT_S);
        assert_eq!((watchdog.height_m(), watchdog.climb_mps()), (Some(0.4), None));
        watchdog.step(&SensorFrame { time: FlightTime(1_000_000), ..SensorFrame::default() }, DT_S);
        assert_eq!((watchdog.place(0), watchdog.place(2)), (None, None));
    }

    #[test]
    fn only_independent_sensors_are_read_where_they_are_named() {
        let named = [SensorId::new(SensorKind::Imu, 4), SensorId::new(SensorKind::Height, 1)];
        let (watchdog, tilt) = rolled(&named, false);
        assert!((watchdog.tilt_rad() - tilt).abs() < 0.02);
        assert_eq!((watchdog.height_m(), watchdog.heights_fresh()), (Some(1.0), 1));
        let faulty = [SensorId::new(SensorKind::Height, 2)];
        assert_eq!(rolled(&faulty, false).0.height_m(), Some(9.0), "named, it is read whatever it says");
    }
}
