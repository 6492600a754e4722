use nalgebra::Vector3;

use super::*;
use crate::estimate::Health;
use crate::estimate::ekf_bias::tests::world::{Course, HOVER, LIVELY, World};
use crate::estimate::fdir::isolation::SensorSet;
use crate::frames::{roll_pitch_yaw, tilt_rad, wrap_pi};
use crate::sensor::{HeightSample, MocapPoseSample};
use crate::vehicle::Truth;
use plumbline_proto::ids::SensorId;
use plumbline_proto::v1::SensorKind;

/// Four IMUs, three lasers of 8 mm at 10 Hz, and motion capture where `pose`.
struct Flying {
    world: World,
    lanes: Lanes,
    pose: bool,
}

impl Flying {
    fn new(course: Course, seed: u64, pose: bool) -> Self {
        let mut world = World::new(course, seed);
        world.imus = 4;
        Self { world, lanes: Lanes::new(SensorModel::default(), &Airframe::iris()), pose }
    }

    /// Until `t_s`; `attack` alters each frame. Largest errors of altitude, m, and tilt, rad, on the way.
    fn until(&mut self, t_s: f64, attack: impl Fn(&mut SensorFrame)) -> (f64, f64) {
        let (mut altitude_m, mut tilt) = (0.0f64, 0.0f64);
        while self.world.time().as_seconds() < t_s {
            let (mut frame, truth) = self.world.frame(true);
            for i in 0..3u64 {
                if (self.world.tick + 7 * i).is_multiple_of(20) {
                    let height_m = truth.position_enu_m.z + self.world.scalar(0.008);
                    frame.heights[i as usize] = Some(HeightSample { time: frame.time, height_m });
                }
            }
            if self.pose && self.world.tick.is_multiple_of(4) {
                let Truth { time, position_enu_m, world_from_body, .. } = truth;
                frame.mocap_pose = Some(MocapPoseSample { time, position_enu_m, world_from_body });
            }
            attack(&mut frame);
            let estimate = self.lanes.step(&frame, &MotorCommand::default());
            let motion = estimate.motion_or_rest();
            altitude_m = altitude_m.max((motion.position_enu_m.z - truth.position_enu_m.z).abs());
            let (up, true_up) = (estimate.world_from_body * Vector3::z(), truth.world_from_body * Vector3::z());
            tilt = tilt.max(up.angle(&true_up));
        }
        (altitude_m, tilt)
    }

    fn announced(&self) -> SensorSet {
        let mut set = SensorSet::default();
        let flagged = self.lanes.isolation().devices().iter().filter(|device| device.flagged.is_some());
        flagged.for_each(|device| set.add(device.sensor));
        set
    }
}

fn one(kind: SensorKind, instance: u8) -> SensorSet {
    let mut set = SensorSet::default();
    set.add(SensorId::new(kind, instance));
    set
}

#[test]
fn it_follows_lively_motion_and_predicts_to_now() {
    let mut flying = Flying::new(LIVELY, 3, true);
    flying.until(8.0, |_| {});
    let (altitude_m, tilt) = flying.until(20.0, |_| {});
    // A horizon 100 ms back, not brought to now, would be 40 mm and 4° off here.
    assert!(altitude_m < 0.02 && tilt < 2f64.to_radians(), "{altitude_m} m, {}°", tilt.to_degrees());
    assert!(flying.announced().is_empty());
}

#[test]
fn hovering_without_motion_capture_altitude_and_tilt_are_kept() {
    let mut flying = Flying::new(HOVER, 4, false);
    flying.until(8.0, |_| {});
    let (altitude_m, tilt) = flying.until(30.0, |_| {});
    assert!(altitude_m < 0.02 && tilt < 1.5f64.to_radians(), "{altitude_m} m, {}°", tilt.to_degrees());
    assert_eq!(flying.lanes.estimate().health, Health::Healthy);
    let weights = flying.lanes.weights();
    assert!((weights.iter().sum::<f64>() - 1.0).abs() < 1e-9 && weights[4] == 0.0, "{weights:?}");
}

#[test]
fn a_false_imu_is_excluded_announced_and_taken_back_afterwards() {
    for (name, attack) in [
        ("accelerometer", (|s: &mut crate::sensor::ImuSample| s.accel_mps2.z += 2.0) as fn(&mut _)),
        ("gyroscope", |s: &mut crate::sensor::ImuSample| s.gyro_radps.y += 0.3),
    ] {
        let mut flying = Flying::new(HOVER, 5, true);
        flying.until(10.0, |_| {});
        let (altitude_m, tilt) = flying.until(16.0, |frame| frame.imus[1].iter_mut().for_each(attack));
        assert_eq!(flying.announced(), one(SensorKind::Imu, 2), "{name}");
        assert!(altitude_m < 0.03 && tilt < 2f64.to_radians(), "{name}: {altitude_m} m, {}°", tilt.to_degrees());
        assert!(flying.lanes.weights()[1] < 0.01, "{name}: {:?}", flying.lanes.weights());
        flying.until(26.0, |_| {});
        assert!(flying.announced().is_empty(), "{name}");
    }
}

#[test]
fn an_imu_that_reads_upside_down_moves_nothing_however_long() {
    let mut flying = Flying::new(HOVER, 7, false);
    flying.until(10.0, |_| {});
    let (altitude_m, tilt) = flying.until(40.0, |frame| {
        frame.imus[1].iter_mut().for_each(|s| (s.accel_mps2, s.gyro_radps) = (-s.accel_mps2, -s.gyro_radps));
    });
    assert_eq!(flying.announced(), one(SensorKind::Imu, 2));
    assert!(altitude_m < 0.05 && tilt < 2f64.to_radians(), "{altitude_m} m, {}°", tilt.to_degrees());
}

#[test]
fn whoever_tells_times_that_cannot_be_is_excluded_and_moves_nothing() {
    let shifted = |time: &mut FlightTime, by_us: i64| time.0 = time.0.saturating_add_signed(by_us);
    for by_us in [-1_500_000, -500_000, 500_000, 1_500_000] {
        let mut flying = Flying::new(LIVELY, 8, false);
        flying.until(10.0, |_| {});
        let (altitude_m, _) = flying.until(20.0, |frame| {
            frame.heights[1].iter_mut().for_each(|sample| shifted(&mut sample.time, by_us));
        });
        assert_eq!(flying.announced(), one(SensorKind::Height, 2), "{by_us} µs");
        assert!(altitude_m < 0.06, "height, {by_us} µs: {altitude_m} m");
        flying.until(22.0, |_| {});
        assert!(flying.announced().is_empty(), "taken back");
        let (altitude_m, tilt) = flying.until(32.0, |frame| {
            frame.imus[1].iter_mut().for_each(|sample| shifted(&mut sample.time, by_us));
        });
        assert_eq!(flying.announced(), one(SensorKind::Imu, 2), "{by_us} µs");
        assert!(altitude_m < 0.06 && tilt < 3f64.to_radians(), "IMU, {by_us} µs: {altitude_m} m, {tilt} rad");
    }
}

#[test]
fn what_is_excluded_counts_for_almost_nothing_and_the_rest_does_not() {
    let counts = |flying: &Flying, kind, of: u8| {
        (1..=of).map(|i| flying.lanes.counts(SensorId::new(kind, i))).collect::<Vec<_>>()
    };
    let mut flying = Flying::new(HOVER, 7, false);
    assert!(counts(&flying, SensorKind::Imu, 4).into_iter().all(|counts| counts == 1.0), "no estimate yet");
    flying.until(10.0, |_| {});
    for kind in [SensorKind::Imu, SensorKind::Height, SensorKind::Barometer] {
        assert!(counts(&flying, kind, 3).into_iter().all(|counts| counts > 0.1), "{kind:?}");
    }
    // A step of a laser is refused before anything is announced.
    flying.until(10.25, |frame| frame.heights[2].iter_mut().for_each(|s| s.height_m += 0.4));
    let heights = counts(&flying, SensorKind::Height, 3);
    assert!(flying.announced().is_empty() && heights[2] == 0.0 && heights[0] > 0.1, "{heights:?}");
    let mut flying = Flying::new(HOVER, 7, false);
    flying.until(10.0, |_| {});
    flying.until(14.0, |frame| frame.imus[1].iter_mut().for_each(|s| s.accel_mps2.z += 5.0));
    let imus = counts(&flying, SensorKind::Imu, 4);
    assert!(imus[1] < 0.01 && [0, 2, 3].iter().all(|i| imus[*i] > 0.1), "{imus:?}");
}

#[test]
fn an_imu_that_was_silent_does_not_bring_back_the_yaw_it_had_then() {
    let mut flying = Flying::new(Course { yaw_radps: 0.4, ..HOVER }, 9, false);
    let yaw_off = |flying: &Flying| {
        let estimated = flying.lanes.estimate().world_from_body;
        roll_pitch_yaw(&(flying.world.truth().world_from_body * estimated.inverse())).z
    };
    // Nothing but the gyroscopes tells the yaw.
    let without_field = |frame: &mut SensorFrame| frame.imus.iter_mut().flatten().for_each(|s| s.mag_ut = None);
    flying.until(8.0, without_field);
    flying.until(12.0, |frame| {
        without_field(frame);
        frame.imus[1] = None;
    });
    let before = yaw_off(&flying);
    flying.until(13.0, without_field);
    // The vehicle turned by 92° meanwhile.
    let moved = wrap_pi(yaw_off(&flying) - before).abs();
    assert!(moved < 2f64.to_radians(), "{}°", moved.to_degrees());
    assert!(flying.lanes.weights()[1] > 0.1, "{:?}", flying.lanes.weights());
}

#[test]
fn the_altitude_keeps_the_bound_that_is_announced_while_one_height_is_attacked_and_two_alone_promise_none() {
    // What it may be taught, by an offset that grows by 2 mm/s, and what it is told at once.
    for (drift_mps, step_m) in [(0.0, 0.0), (0.002, 0.0), (0.0, 0.5), (0.0, 0.04)] {
        let mut flying = Flying::new(HOVER, 8, false);
        flying.until(10.0, |_| {});
        for t_s in 11..50 {
            let off_m = step_m + drift_mps * (f64::from(t_s) - 10.0);
            let (altitude_m, _) =
                flying.until(f64::from(t_s), |frame| frame.heights[2].iter_mut().for_each(|s| s.height_m += off_m));
            if let Some(bound_m) = flying.lanes.height_bound_m() {
                assert!(altitude_m < bound_m && bound_m < 0.12, "{t_s} s: {altitude_m} m, bound {bound_m} m");
            }
        }
        assert!(flying.lanes.height_bound_m().is_some());
        flying.until(53.0, |frame| frame.heights[2] = None);
        assert_eq!(flying.lanes.height_bound_m(), None, "two heights promise nothing");
    }
}

#[test]
fn nothing_that_is_no_number_and_no_time_that_goes_back_stops_it() {
    let mut flying = Flying::new(HOVER, 6, false);
    flying.until(6.0, |frame| {
        let nothing = Vector3::repeat(f64::NAN);
        if frame.time.0.is_multiple_of(35_000) {
            frame.imus[0].iter_mut().for_each(|s| s.accel_mps2 = nothing);
            frame.heights[0].iter_mut().for_each(|s| s.height_m = f64::INFINITY);
        }
    });
    assert_eq!(flying.lanes.estimate().health, Health::Healthy);
    // The IMUs are silent: degraded, and still numbers.
    flying.until(7.0, |frame| frame.imus = [None; MAX_IMUS]);
    assert_eq!(flying.lanes.estimate().health, Health::Degraded);
    assert!(tilt_rad(&flying.lanes.estimate().world_from_body) < 0.5);
    // Another flight.
    flying.world.tick = 0;
    flying.until(0.1, |_| {});
    assert_eq!(flying.lanes.estimate().health, Health::Initialising);
    let (altitude_m, _) = flying.until(9.0, |_| {});
    assert!(flying.lanes.estimate().health == Health::Healthy && altitude_m < 2.0, "{altitude_m}");
}
