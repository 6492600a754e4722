//! The filter in a small world of its own: smooth known motion, white noise of known size.

pub(in crate::estimate) mod world;

use self::world::{Course, HOVER, LIVELY, RATE_HZ, World, errors, height_residual, tilt_error};
use super::*;
use crate::estimate::Channel;
use crate::sensor::barometer;
use crate::sensor::{BarometerSample, CameraRangesSample, GnssSample, HeightSample, ImuSample, MocapPoseSample};
use crate::vehicle::Truth;

/// Noise exactly as simulated, nothing assumed on top.
fn exact() -> SensorModel {
    let mut model = SensorModel::default();
    (model.imus.gyro.common_noise_density, model.imus.accel.common_noise_density) = (0.0, 0.0);
    model
}

#[test]
fn errors_are_as_large_as_p_says_and_biases_converge() {
    // 15 error states without those of barometers: the mean NEES of a consistent filter is 15. Over 16 runs × 20 samples its own
    // standard deviation is about 1 (samples of one run are correlated), so 12 to 18 is ±3σ.
    const LOW: f64 = 12.0;
    const HIGH: f64 = 18.0;
    let (mut sum, mut count) = (0.0, 0.0);
    for seed in 0..16 {
        let mut world = World::new(LIVELY, seed);
        let mut filter = EkfBias::new(exact());
        for k in 0..(30.0 * RATE_HZ) as usize {
            let (mut frame, truth) = world.frame(false);
            world.mocap(&mut frame, &truth);
            filter.step(&frame, &MotorCommand::default());
            if k > 4000 && k % 100 == 0 {
                let x = errors(&filter, &world, &truth);
                let p = filter.covariance().fixed_view::<15, 15>(0, 0).into_owned();
                sum += x.dot(&p.cholesky().unwrap().solve(&x));
                count += 1.0;
            }
        }
        let x = errors(&filter, &world, &world.truth());
        assert!(x.fixed_rows::<3>(9).amax() < 0.03, "accelerometer bias error {}", x.fixed_rows::<3>(9));
        assert!(x.fixed_rows::<3>(12).amax() < 0.002, "gyroscope bias error {}", x.fixed_rows::<3>(12));
        assert_eq!(filter.estimate().health, Health::Healthy);
    }
    let nees = sum / count;
    println!("mean NEES {nees:.2} of 15");
    assert!((LOW..HIGH).contains(&nees), "mean NEES {nees}");
}

#[test]
fn transition_matches_finite_differences() {
    // GIVEN a state and one shifted along each error state, WHEN both are propagated 5 ms, THEN they
    // differ by that column of Φ, read from P = eᵢeᵢᵀ propagated without noise.
    const STEP: f64 = 1e-5;
    let mut quiet = exact();
    for quantity in [&mut quiet.imus.gyro, &mut quiet.imus.accel] {
        (quantity.noise_density, quantity.bias_walk) = (0.0, 0.0);
    }
    quiet.barometers.walk = 0.0;
    let start = || {
        let mut f = EkfBias::new(quiet.clone());
        f.state.kinematics = Kinematics {
            position_enu_m: Vector3::new(1.0, 2.0, 3.0),
            velocity_enu_mps: Vector3::new(-0.5, 0.2, 1.0),
            world_from_body: UnitQuaternion::from_euler_angles(0.4, -0.3, 1.9),
        };
        f.state.accel_bias_mps2 = Vector3::new(0.1, 0.0, -0.2);
        f
    };
    let (rate, force) = (Vector3::new(0.5, -1.0, 0.7), Vector3::new(1.0, -2.0, 10.5));
    let mut reference = start();
    reference.propagate(0.005, &rate, &force, 0.0);
    for i in 0..covariance::N {
        let mut e = ErrorState::zeros();
        e[i] = 1.0;
        let mut shifted = start();
        shifted.inject(&(e * STEP));
        shifted.propagate(0.005, &rate, &force, 0.0);
        let (a, b) = (&shifted.state, &reference.state);
        let mut numeric = ErrorState::zeros();
        let mut set = |at: usize, v: Vector3<f64>| numeric.fixed_rows_mut::<3>(at).copy_from(&(v / STEP));
        set(ix::POSITION, a.kinematics.position_enu_m - b.kinematics.position_enu_m);
        set(ix::VELOCITY, a.kinematics.velocity_enu_mps - b.kinematics.velocity_enu_mps);
        let turn = a.kinematics.world_from_body * b.kinematics.world_from_body.inverse();
        set(ix::ATTITUDE, turn.scaled_axis());
        set(ix::ACCEL_BIAS, a.accel_bias_mps2 - b.accel_bias_mps2);
        set(ix::GYRO_BIAS, a.gyro_bias_radps - b.gyro_bias_radps);
        for k in 0..MAX_BAROMETERS {
            numeric[ix::BAROMETER + k] = (a.barometer_offset_m[k] - b.barometer_offset_m[k]) / STEP;
        }
        let mut f = start();
        f.p = e * e.transpose();
        f.propagate(0.005, &rate, &force, 0.0);
        // Third-order terms of a 5 ms step at 12 m/s² and 1.3 rad/s.
        assert!((f.p - numeric * numeric.transpose()).amax() < 2e-4, "state {i}: {}", f.p.column(i));
    }
}

/// GIVEN a vehicle that tilts as it flies WHEN its accelerometers read an acceleration upward for seconds that is none THEN heights put the
/// climb right, and it is not taken for tilt.
#[test]
fn what_vibration_looks_like_upward_is_not_taken_for_tilt() {
    let mut world = World::new(LIVELY, 11);
    let mut filter = EkfBias::new(SensorModel::default());
    let mut worst_rad: f64 = 0.0;
    for k in 0..(20.0 * RATE_HZ) as usize {
        let t = k as f64 / RATE_HZ;
        let (mut frame, truth) = world.frame(true);
        world.heights(&mut frame, &truth, 0.0);
        if (8.0..14.0).contains(&t) {
            for imu in frame.imus.iter_mut().flatten() {
                imu.accel_mps2.z += if ((t * 1.5) as u64).is_multiple_of(2) { 5.0 } else { -5.0 };
            }
        }
        let estimate = filter.step(&frame, &MotorCommand { throttle: [0.5; 4] });
        if t > 5.0 {
            worst_rad = worst_rad.max(tilt_error(estimate, &truth));
        }
    }
    assert!(worst_rad < 0.2, "{worst_rad} rad");
}

#[test]
fn one_attacked_height_of_three_never_wins() {
    for ramp_mps in [0.0, 0.02, 0.2] {
        let mut world = World::new(Course { position_m: 0.5, tilt_rad: 0.1, yaw_radps: 0.0 }, 7);
        world.imus = 4;
        let mut filter = EkfBias::new(SensorModel::default());
        let mut worst: f64 = 0.0;
        let mut seen_after = None;
        for k in 0..(40.0 * RATE_HZ) as usize {
            let t = k as f64 / RATE_HZ;
            // From 10 s on: a step of 0.5 m, or a ramp up to 0.5 m.
            let attack = if t < 10.0 {
                0.0
            } else if ramp_mps == 0.0 {
                0.5
            } else {
                (ramp_mps * (t - 10.0)).min(0.5)
            };
            let (mut frame, truth) = world.frame(true);
            world.heights(&mut frame, &truth, attack);
            let e = filter.step(&frame, &MotorCommand { throttle: [0.5; 4] });
            if t > 5.0 {
                worst = worst.max((e.kinematics().position_enu_m.z - truth.position_enu_m.z).abs());
            }
            if let Some(r) = height_residual(e, 2) {
                // An attack within the gate of one sample cannot be distinguished from noise; twice that must be detected.
                if attack > 0.15 {
                    assert!(r.ratio() > 1.0 && !r.accepted, "attack {attack} at {t}: ratio {}", r.ratio());
                    seen_after.get_or_insert(t - 10.0);
                }
                if t < 10.0 {
                    assert!(r.accepted, "a healthy height rejected at {t}: ratio {}", r.ratio());
                }
            }
            if t > 10.0
                && let (Some(first), Some(third)) = (height_residual(e, 1), height_residual(e, 3))
            {
                assert!(first.accepted && third.accepted, "healthy heights rejected at {t}");
            }
        }
        println!("ramp {ramp_mps} m/s: worst altitude error {:.1} mm, seen from {seen_after:?} s", worst * 1e3);
        assert!(worst < 0.06, "altitude moved by {worst}");
        assert_eq!(filter.estimate().health, Health::Healthy);
    }
}

#[test]
fn a_height_attacked_from_the_first_sample_is_rejected() {
    let mut world = World::new(HOVER, 11);
    let mut filter = EkfBias::new(SensorModel::default());
    for k in 0..2000 {
        let (mut frame, truth) = world.frame(true);
        world.heights(&mut frame, &truth, -0.8);
        let e = filter.step(&frame, &MotorCommand::default());
        if k > 400 {
            assert!((e.kinematics().position_enu_m.z - truth.position_enu_m.z).abs() < 0.05);
            assert!(height_residual(e, 2).is_none_or(|r| r.ratio() > 1.0));
        }
    }
}

#[test]
fn a_new_floor_pulls_the_estimate_over_within_two_seconds_when_most_heights_say_so() {
    let mut world = World::new(HOVER, 5);
    let mut filter = EkfBias::new(SensorModel::default());
    let mut reset_at = None;
    for k in 0..(20.0 * RATE_HZ) as usize {
        let t = k as f64 / RATE_HZ;
        let (mut frame, mut truth) = world.frame(true);
        if t > 10.0 {
            truth.position_enu_m.z -= 0.7; // over a table
        }
        world.heights(&mut frame, &truth, 0.0);
        let e = filter.step(&frame, &MotorCommand::default());
        if t > 10.0 && (e.kinematics().position_enu_m.z - truth.position_enu_m.z).abs() < 0.05 {
            reset_at.get_or_insert(t - 10.0);
        }
    }
    let after = reset_at.unwrap();
    assert!((0.3..2.0).contains(&after), "recovered after {after} s");
    assert_eq!(filter.estimate().health, Health::Healthy);
}

#[test]
fn a_blow_that_the_samples_show_wrongly_does_not_shut_the_right_place_out() {
    // One sample shows 100 m/s² that were over before the next: 1 m/s or more that never was.
    let mut world = World::new(HOVER, 7);
    let mut filter = EkfBias::new(SensorModel::default());
    let (mut off_mps, mut refused): (f64, usize) = (0.0, 0);
    for k in 0..(12.0 * RATE_HZ) as usize {
        let t = k as f64 / RATE_HZ;
        let (mut frame, truth) = world.frame(false);
        if k == (10.0 * RATE_HZ) as usize {
            let samples = frame.imus.iter_mut().flatten();
            samples.for_each(|s| s.accel_mps2.x += 100.0);
        }
        world.mocap(&mut frame, &truth);
        let e = filter.step(&frame, &MotorCommand::default());
        if t > 10.0 {
            refused += e.residuals.iter().filter(|r| r.channel == Channel::X && !r.accepted).count();
        }
        if t > 10.2 {
            off_mps = off_mps.max((e.kinematics().velocity_enu_mps - truth.velocity_enu_mps).norm());
        }
    }
    assert_eq!(refused, 0, "the place was refused");
    assert!(off_mps < 0.2, "velocity is {off_mps} m/s off");
}

#[test]
fn on_strings_tilt_velocity_and_position_stay_bounded_for_ten_minutes() {
    // Nothing horizontal is measured; the vehicle swings and the biases are unknown.
    let mut world = World::new(Course { position_m: 0.3, tilt_rad: 0.1, yaw_radps: 0.0 }, 3);
    world.imus = 4;
    let mut filter = EkfBias::new(SensorModel::default());
    let (mut tilt, mut speed, mut place): (f64, f64, f64) = (0.0, 0.0, 0.0);
    for k in 0..(600.0 * RATE_HZ) as usize {
        let (mut frame, truth) = world.frame(true);
        world.heights(&mut frame, &truth, 0.0);
        let e = filter.step(&frame, &MotorCommand { throttle: [0.5; 4] });
        if k > 4000 {
            tilt = tilt.max(tilt_error(e, &truth));
            speed = speed.max((e.kinematics().velocity_enu_mps - truth.velocity_enu_mps).norm());
            place = place.max((e.kinematics().position_enu_m - truth.position_enu_m).norm());
            assert!(!e.horizontal_known());
        }
    }
    println!(
        "10 min without horizontal aiding: tilt {:.2}°, velocity {speed:.2} m/s, position {place:.2} m",
        tilt.to_degrees()
    );
    assert!(tilt < 0.03 && speed < 0.5 && place < 2.0, "tilt {tilt} speed {speed} place {place}");
}

#[test]
fn samples_that_are_not_finite_are_skipped() {
    let mut world = World::new(LIVELY, 9);
    let mut filter = EkfBias::new(SensorModel::default());
    let nan = f64::NAN;
    for k in 0..6000 {
        let (mut frame, truth) = world.frame(true);
        world.heights(&mut frame, &truth, 0.0);
        world.mocap(&mut frame, &truth);
        match k % 7 {
            0 => frame.heights[0] = Some(HeightSample { time: truth.time, height_m: nan }),
            1 => frame.imus[1] = frame.imus[0].map(|s| ImuSample { gyro_radps: Vector3::new(nan, 0.0, 0.0), ..s }),
            2 => {
                frame.barometers[0] = Some(BarometerSample { time: truth.time, pressure_pa: -1.0, temperature_c: nan })
            }
            3 => frame.camera_ranges = Some(CameraRangesSample { time: truth.time, range_m: [nan; 4] }),
            4 => {
                frame.mocap_pose = Some(MocapPoseSample {
                    time: truth.time,
                    position_enu_m: Vector3::new(nan, nan, nan),
                    world_from_body: UnitQuaternion::identity(),
                });
            }
            5 => {
                world.gnss(&mut frame, &truth, 1.0);
                if let Some(g) = &mut frame.gnss {
                    g.velocity_enu_mps.x = f64::INFINITY;
                    g.horizontal_sigma_m = nan;
                }
            }
            _ => frame.imus[0] = frame.imus[0].map(|s| ImuSample { mag_ut: Some(Vector3::repeat(nan)), ..s }),
        }
        let e = filter.step(&frame, &MotorCommand::default());
        assert!(e.kinematics().position_enu_m.iter().chain(e.world_from_body.coords.iter()).all(|x| x.is_finite()));
        assert!(e.residuals.iter().all(|r| r.innovation.is_finite() && r.sigma.is_finite()));
        if k > 2000 {
            assert!((e.kinematics().position_enu_m - truth.position_enu_m).norm() < 0.1);
            assert_ne!(e.health, Health::Initialising);
        }
    }
}

#[test]
fn starts_in_motion() {
    // GIVEN lively motion from the first sample, WHEN GNSS at 5 Hz and a magnetometer help, THEN tilt is
    // known to 2° and velocity to 0.3 m/s within 10 s, in every one of eight starts.
    for seed in 0..8 {
        let mut world = World::new(LIVELY, 100 + seed);
        world.tick = seed * 137;
        let mut filter = EkfBias::new(SensorModel::default());
        for k in 0..(20.0 * RATE_HZ) as usize {
            let (mut frame, truth) = world.frame(true);
            if world.every(5.0) {
                world.gnss(&mut frame, &truth, 0.5);
            }
            let e = filter.step(&frame, &MotorCommand { throttle: [0.5; 4] });
            if k == 2 {
                assert_eq!(e.health, Health::Initialising);
            }
            if k as f64 > 10.0 * RATE_HZ {
                assert!(tilt_error(e, &truth) < 0.035, "seed {seed}: tilt error {} at {k}", tilt_error(e, &truth));
                assert!((e.kinematics().velocity_enu_mps - truth.velocity_enu_mps).norm() < 0.3, "seed {seed} at {k}");
                assert!(e.horizontal_known());
            }
        }
    }
}

#[test]
fn late_gnss_is_compared_with_its_own_time() {
    // 150 ms at up to 1.4 m/s are 0.2 m if ignored.
    let mut worst = [0.0f64; 2];
    for (case, stamp_is_known) in [true, false].into_iter().enumerate() {
        let mut world = World::new(LIVELY, 21);
        let mut model = SensorModel::default();
        model.gnss.floor_m = 0.01;
        let mut filter = EkfBias::new(model);
        let mut waiting: std::collections::VecDeque<GnssSample> = std::collections::VecDeque::new();
        for k in 0..(30.0 * RATE_HZ) as usize {
            let (mut frame, truth) = world.frame(true);
            if world.every(10.0) {
                world.gnss(&mut frame, &truth, 0.02);
                waiting.push_back(frame.gnss.take().unwrap());
            }
            if let Some(sample) = waiting.front().copied()
                && truth.time.seconds_since(sample.time) >= 0.15
            {
                waiting.pop_front();
                frame.gnss = Some(GnssSample { time: if stamp_is_known { sample.time } else { frame.time }, ..sample });
            }
            let e = filter.step(&frame, &MotorCommand::default());
            if k > 3000 {
                worst[case] = worst[case].max((e.kinematics().position_enu_m - truth.position_enu_m).norm());
            }
        }
    }
    println!("GNSS 150 ms late: worst error {:.3} m with its time, {:.3} m without", worst[0], worst[1]);
    assert!(worst[0] < 0.06 && worst[0] < 0.4 * worst[1], "{worst:?}");
}

#[test]
fn camera_ranges_alone_find_the_position() {
    let mut world = World::new(LIVELY, 31);
    let mut filter = EkfBias::new(SensorModel::default());
    for k in 0..(20.0 * RATE_HZ) as usize {
        let (mut frame, truth) = world.frame(true);
        if world.every(20.0) {
            let o = SensorModel::default();
            let mut range_m = [0.0; 4];
            for (i, r) in range_m.iter_mut().enumerate() {
                *r = (truth.position_enu_m - o.camera_ranges.cameras_enu_m[i]).norm()
                    + world.scalar(o.camera_ranges.sigma_m[i]);
            }
            frame.camera_ranges = Some(CameraRangesSample { time: truth.time, range_m });
        }
        let e = filter.step(&frame, &MotorCommand::default());
        if k > 2000 {
            assert!((e.kinematics().position_enu_m - truth.position_enu_m).norm() < 0.1, "at {k}");
        }
    }
}

#[test]
fn a_barometer_that_jumps_moves_its_offset_not_the_altitude() {
    let mut world = World::new(HOVER, 41);
    let mut filter = EkfBias::new(SensorModel::default());
    for k in 0..(30.0 * RATE_HZ) as usize {
        let t = k as f64 / RATE_HZ;
        let (mut frame, truth) = world.frame(true);
        world.heights(&mut frame, &truth, 0.0);
        if world.every(50.0) {
            let door = if t > 10.0 { 3.0 } else { 0.0 };
            let altitude = truth.position_enu_m.z + 120.0 + door + world.scalar(0.15);
            let pressure_pa = barometer::pressure_pa(altitude, barometer::STANDARD_PRESSURE_PA);
            frame.barometers[0] = Some(BarometerSample { time: truth.time, pressure_pa, temperature_c: 20.0 });
        }
        let e = filter.step(&frame, &MotorCommand::default());
        if t > 3.0 {
            assert!((e.kinematics().position_enu_m.z - truth.position_enu_m.z).abs() < 0.05, "at {t}");
        }
    }
    assert!((filter.state.barometer_offset_m[0] - 123.0).abs() < 0.2, "{:?}", filter.state.barometer_offset_m);
}

#[test]
fn a_wrong_magnet_is_refused_and_yaw_holds() {
    let mut world = World::new(Course { position_m: 0.3, tilt_rad: 0.1, yaw_radps: 0.5 }, 51);
    world.imus = 4;
    let mut filter = EkfBias::new(SensorModel::default());
    for k in 0..(40.0 * RATE_HZ) as usize {
        let (mut frame, truth) = world.frame(true);
        world.heights(&mut frame, &truth, 0.0);
        if k > 4000
            && let Some(imu) = &mut frame.imus[2]
        {
            // A magnet beside IMU 3: strength doubles.
            imu.mag_ut = imu.mag_ut.map(|m| m + Vector3::new(60.0, 0.0, 0.0));
        }
        let e = filter.step(&frame, &MotorCommand { throttle: [0.5; 4] });
        if k > 4000 {
            let yaw = (truth.world_from_body * e.world_from_body.inverse()).scaled_axis().z;
            assert!(yaw.abs() < 0.05, "yaw error {yaw} at {k}");
            assert!(e.residuals.iter().all(|r| r.channel != Channel::Heading || r.sensor.instance != 3 || !r.accepted));
        }
    }
}

#[test]
fn a_majority_of_no_imus_is_degraded_and_silence_too() {
    let mut world = World::new(HOVER, 61);
    let mut filter = EkfBias::new(SensorModel::default());
    for _ in 0..1000 {
        let (mut frame, truth) = world.frame(true);
        world.heights(&mut frame, &truth, 0.0);
        filter.step(&frame, &MotorCommand::default());
    }
    assert_eq!(filter.estimate().health, Health::Healthy);
    for _ in 0..60 {
        let (mut frame, _) = world.frame(true);
        frame.imus.fill(None);
        filter.step(&frame, &MotorCommand::default());
    }
    assert_eq!(filter.estimate().health, Health::Degraded);
    // IMUs return, heights do not.
    for _ in 0..(3.0 * RATE_HZ) as usize {
        let (frame, _) = world.frame(true);
        filter.step(&frame, &MotorCommand::default());
    }
    assert_eq!(filter.estimate().health, Health::Degraded);
}

#[test]
fn switching_in_flight_starts_from_the_other_estimate() {
    let mut world = World::new(LIVELY, 71);
    let mut first = EkfBias::new(SensorModel::default());
    for _ in 0..4000 {
        let (mut frame, truth) = world.frame(true);
        world.mocap(&mut frame, &truth);
        first.step(&frame, &MotorCommand::default());
    }
    let mut second = EkfBias::new(SensorModel::default());
    second.reset_to(first.estimate());
    for _ in 0..1000 {
        let (mut frame, truth) = world.frame(true);
        world.mocap(&mut frame, &truth);
        let e = second.step(&frame, &MotorCommand::default());
        assert!((e.kinematics().position_enu_m - truth.position_enu_m).norm() < 0.05 && tilt_error(e, &truth) < 0.05);
        assert_ne!(e.health, Health::Initialising);
    }
}

#[test]
fn the_first_magnetometers_after_a_start_without_one_find_a_yaw_half_a_turn_off() {
    for started_again in [false, true] {
        let mut world = World::new(HOVER, 13);
        world.imus = 2;
        let mut filter = EkfBias::new(SensorModel::default());
        let yaw_off = |filter: &EkfBias, truth: &Truth| {
            let estimated = filter.estimate().world_from_body;
            crate::frames::roll_pitch_yaw(&(truth.world_from_body * estimated.inverse())).z
        };
        for _ in 0..400 {
            let (frame, _) = world.frame(false);
            filter.step(&frame, &MotorCommand::default());
        }
        if started_again {
            let own = filter.estimate().clone();
            filter.reset_to(&own);
        }
        filter.turn(yaw_off(&filter, &world.truth()) + std::f64::consts::PI);
        let (mut frame, truth) = world.frame(true);
        // One on either side of ±180°.
        for (imu, aside_rad) in frame.imus.iter_mut().flatten().zip([0.1, -0.1]) {
            let turned = UnitQuaternion::from_scaled_axis(Vector3::z() * aside_rad) * truth.world_from_body;
            imu.mag_ut = Some(turned.inverse() * Vector3::new(0.0, 22.0, -40.0));
        }
        filter.step(&frame, &MotorCommand::default());
        let off = yaw_off(&filter, &truth).abs();
        assert!(off < 0.2, "{off} rad, started again: {started_again}");
    }
}

#[test]
fn without_magnetometer_fixes_once_a_second_show_the_place() {
    // GIVEN a vehicle first seen in mid-flight, at an unknown yaw, WHEN there is nothing but an IMU and a fix
    // of 0.5 m once a second, THEN it says where it is after a second, well within fifteen (the yaw is tested with
    // the mixture itself).
    const PLACE_M: f64 = 5.0;
    const SETTLED_S: f64 = 15.0;
    for (seed, start_s) in [(1, 0.0), (2, 3.1), (3, 7.7), (4, 11.0)] {
        let mut world = World::new(Course { position_m: 1.5, tilt_rad: 0.2, yaw_radps: 0.3 }, seed);
        world.tick = (start_s * RATE_HZ) as u64;
        let mut filter = EkfBias::new(SensorModel::default());
        let mut yaw_error = f64::NAN;
        for k in 0..(25.0 * RATE_HZ) as usize {
            let (mut frame, truth) = world.frame(false);
            if k.is_multiple_of(RATE_HZ as usize) {
                world.gnss(&mut frame, &truth, 0.5);
                frame.gnss.as_mut().unwrap().velocity_enu_mps = Vector3::repeat(f64::NAN);
            }
            let e = filter.step(&frame, &MotorCommand { throttle: [0.5; 4] });
            if k > (1.2 * RATE_HZ) as usize {
                let off = (e.kinematics().position_enu_m - truth.position_enu_m).norm();
                let t = k as f64 / RATE_HZ;
                assert!(t < SETTLED_S || off < PLACE_M, "seed {seed}: {off:.2} m off at {t:.1} s");
                assert!(e.horizontal_known() && e.health != Health::Initialising);
            }
            let turned = truth.world_from_body * e.world_from_body.inverse();
            yaw_error = crate::frames::wrap_pi(2.0 * turned.k.atan2(turned.w)).abs();
        }
        println!("seed {seed}: yaw {:.1}° off after 25 s", yaw_error.to_degrees());
    }
}
