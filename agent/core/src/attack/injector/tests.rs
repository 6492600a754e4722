use super::*;
use crate::attack::Channel;
use crate::sensor::{HeightSample, ImuSample, MocapPoseSample};
use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use plumbline_proto::v1::SensorKind;

const SENSORS: &[SensorId] =
    &[SensorId::new(SensorKind::Height, 1), SensorId::new(SensorKind::Height, 2), SensorId::new(SensorKind::Imu, 1)];

fn attack(kind: Kind, magnitude: f64) -> Attack {
    Attack {
        id: 1,
        sensor: SensorId::new(SensorKind::Height, 2),
        channel: Channel::All,
        kind,
        start_s: 5.0,
        duration_s: 10.0,
        magnitude,
        seed: 7,
    }
}

/// Heights are a ramp of 0.1 m/s at 10 Hz: height(t) = 0.1 t. Returns height 2 as received.
fn fly(injector: &mut Injector, from_s: f64, to_s: f64) -> Vec<(f64, Option<f64>)> {
    let mut out = Vec::new();
    for tick in (from_s * 10.0) as u64..(to_s * 10.0) as u64 {
        let time = FlightTime(tick * 100_000);
        let sample = Some(HeightSample { time, height_m: time.as_seconds() * 0.1 });
        let mut frame = SensorFrame { time, ..Default::default() };
        frame.heights[0] = sample;
        frame.heights[1] = sample;
        let received = injector.apply(&frame);
        assert_eq!(received.heights[0], sample, "height 1 is not attacked");
        out.push((time.as_seconds(), received.heights[1].map(|h| h.height_m)));
    }
    out
}

fn run(kind: Kind, magnitude: f64) -> Vec<(f64, Option<f64>)> {
    let mut injector = Injector::new(Bounds::default(), true, SENSORS);
    let mut schedule = Schedule { id: 3, ..Default::default() };
    schedule.attacks.push(attack(kind, magnitude));
    injector.upload(&schedule, FlightTime(0)).unwrap();
    assert_eq!(injector.state()[0].phase, Phase::Accepted);
    let out = fly(&mut injector, 0.0, 20.0);
    let progress = injector.state()[0];
    assert_eq!(progress.phase, Phase::Done);
    // A ramp is zero at its onset: the first altered sample is the second.
    let first = if matches!(kind, Kind::Ramp | Kind::Parabola) { 5_100_000 } else { 5_000_000 };
    assert_eq!(progress.active, (kind != Kind::Dropout).then_some(FlightTime(first)).or(progress.active));
    assert_eq!(progress.ended, Some(FlightTime(15_000_000)));
    for (t, value) in &out {
        if !(5.0..15.0).contains(t) {
            assert!((value.unwrap() - 0.1 * t).abs() < 1e-12, "altered outside its span at {t}");
        }
    }
    out.into_iter().filter(|(t, _)| (5.0..15.0).contains(t)).collect()
}

fn check(kind: Kind, magnitude: f64, expected: impl Fn(f64) -> f64) {
    for (t, value) in run(kind, magnitude) {
        let value = value.unwrap();
        assert!((value - expected(t)).abs() < 1e-9, "{kind:?} at {t} s: {value}, expected {}", expected(t));
    }
}

#[test]
fn deterministic_kinds_do_what_they_say_inside_their_span_only() {
    check(Kind::Zero, 0.0, |_| 0.0);
    check(Kind::Bias, 0.5, |t| 0.1 * t + 0.5);
    check(Kind::Ramp, 0.2, |t| 0.1 * t + 0.2 * (t - 5.0));
    check(Kind::Parabola, 0.2, |t| 0.1 * t + 0.1 * (t - 5.0).powi(2));
    check(Kind::Scale, -2.0, |t| -0.2 * t);
    check(Kind::SignFlip, 0.0, |t| -0.1 * t);
    check(Kind::Freeze, 0.0, |_| 0.49);
    check(Kind::Delay, 1.0, |t| 0.1 * (t - 1.0));
    // The two seconds before onset, again and again.
    check(Kind::Replay, 2.0, |t| 0.1 * (3.0 + (((t - 5.0) * 10.0).round() as u64 % 20) as f64 / 10.0));
    // No more than there were.
    check(Kind::Replay, 8.0, |t| 0.1 * (((t - 5.0) * 10.0).round() as u64 % 50) as f64 / 10.0);
}

#[test]
fn noise_and_dropout_have_their_statistics_and_repeat_with_their_seed() {
    let noise = run(Kind::Noise, 0.3);
    let n = noise.len() as f64;
    let variance = noise.iter().map(|(t, v)| (v.unwrap() - 0.1 * t).powi(2)).sum::<f64>() / n;
    assert!((0.2..0.4).contains(&variance.sqrt()), "sigma {}", variance.sqrt());
    assert_eq!(noise, run(Kind::Noise, 0.3));
    let lost = run(Kind::Dropout, 0.5).iter().filter(|(_, v)| v.is_none()).count();
    assert!((30..70).contains(&lost), "{lost} of 100 dropped");
}

#[test]
fn a_bias_follows_its_sequence_within_the_bounds_and_ends_with_its_table() {
    let mut injector = Injector::new(Bounds::default(), true, SENSORS);
    let sequence = |attack, period_s, values: &[f64]| Sequence { attack, period_s, values: values.to_vec() };
    let with = |sequence: Sequence| {
        let mut schedule = Schedule { id: 3, ..Default::default() };
        schedule.attacks.push(attack(Kind::Bias, 0.5));
        schedule.sequences.push(sequence);
        schedule
    };
    let id = attack(Kind::Bias, 0.5).id;
    for (bad, expected) in [
        (sequence(id + 1, 0.1, &[1.0]), "there is no such attack"),
        (sequence(id, 0.0, &[1.0]), "sequence period (s) 0 is outside 0.001 to 10"),
        (sequence(id, 0.1, &[1.0, -1.5]), "value of a sequence -1.5 is outside -1 to 1"),
        (sequence(id, 0.1, &[f64::NAN]), "NaN"),
        (sequence(id, 0.1, &[]), "values of a sequence 0"),
    ] {
        let error = injector.upload(&with(bad), FlightTime(0)).unwrap_err().to_string();
        assert!(error.contains(expected), "{error}");
    }
    injector.upload(&with(sequence(id, 1.0, &[1.0, -0.5, 0.25])), FlightTime(0)).unwrap();
    for (t, value) in fly(&mut injector, 0.0, 12.0) {
        let added = match t - 5.0 + 1e-6 {
            x if x < 0.0 => 0.0,
            x if x < 1.0 => 0.5,
            x if x < 2.0 => -0.25,
            x if x < 3.0 => 0.125,
            _ => 0.0,
        };
        assert!((value.unwrap() - 0.1 * t - added).abs() < 1e-9, "{t} s: {value:?}, {added}");
    }
    assert_eq!(injector.abort(FlightTime(12_000_000)), 1);
}

#[test]
fn abort_ends_everything_at_once() {
    let mut injector = Injector::new(Bounds::default(), true, SENSORS);
    let mut schedule = Schedule::default();
    schedule.attacks.push(attack(Kind::Bias, 0.5));
    injector.upload(&schedule, FlightTime(0)).unwrap();
    fly(&mut injector, 0.0, 7.0);
    assert!(injector.any_active());
    assert_eq!(injector.abort(FlightTime(7_000_000)), 1);
    for (t, value) in fly(&mut injector, 7.0, 9.0) {
        assert!((value.unwrap() - 0.1 * t).abs() < 1e-12);
    }
    assert_eq!(injector.state()[0].phase, Phase::Aborted);
    assert_eq!(injector.abort(FlightTime(9_000_000)), 0);
}

#[test]
fn schedules_out_of_bounds_are_refused_with_the_value_and_change_nothing() {
    let mut injector = Injector::new(Bounds::default(), true, SENSORS);
    let mut refuse = |change: fn(&mut Attack), expected: &str| {
        let mut bad = attack(Kind::Bias, 0.5);
        change(&mut bad);
        let mut schedule = Schedule::default();
        schedule.attacks.push(bad);
        let error = injector.upload(&schedule, FlightTime(0)).unwrap_err().to_string();
        assert!(error.contains(expected), "{error}");
        assert!(injector.state().is_empty());
    };
    refuse(|a| a.magnitude = f64::NAN, "NaN");
    refuse(|a| a.magnitude = 6.0, "magnitude 6 is outside -5 to 5");
    refuse(|a| a.duration_s = 1e9, "duration (s) 1000000000");
    refuse(|a| a.start_s = -1.0, "start (s) -1");
    refuse(|a| a.sensor = SensorId::new(SensorKind::Height, 9), "no height 9");
    refuse(|a| a.channel = Channel::Gyro, "Gyro of height 2");
    refuse(|a| a.sensor = SensorId::new(SensorKind::Imu, 1), "Bias cannot cover All of imu 1");
    let mut off = Injector::new(Bounds::default(), false, SENSORS);
    assert_eq!(off.upload(&Schedule::default(), FlightTime(0)), Err(AttackError::Disabled));
}

#[test]
fn an_imu_channel_leaves_the_others_alone() {
    let mut injector = Injector::new(Bounds::default(), true, SENSORS);
    let mut schedule = Schedule::default();
    schedule.attacks.push(Attack {
        sensor: SensorId::new(SensorKind::Imu, 1),
        channel: Channel::GyroAxis(1),
        start_s: 0.0,
        ..attack(Kind::Bias, 0.25)
    });
    injector.upload(&schedule, FlightTime(0)).unwrap();
    let sample = ImuSample {
        time: FlightTime(0),
        gyro_radps: Vector3::new(0.1, 0.2, 0.3),
        accel_mps2: Vector3::new(0.0, 0.0, 9.81),
        mag_ut: None,
        temperature_c: 25.0,
    };
    let mut frame = SensorFrame::default();
    frame.imus[0] = Some(sample);
    let received = injector.apply(&frame).imus[0].unwrap();
    let expected = ImuSample { gyro_radps: Vector3::new(0.1, 0.45, 0.3), ..sample };
    assert_eq!(received, expected);
}

#[test]
fn an_imu_keeps_the_field_that_not_every_sample_carries() {
    // One shifted by an odd number of samples meets one without a field.
    for (kind, magnitude) in [(Kind::Freeze, 0.0), (Kind::Replay, 0.21), (Kind::Delay, 0.11)] {
        let mut injector = Injector::new(Bounds::default(), true, SENSORS);
        let mut schedule = Schedule::default();
        let sensor = SensorId::new(SensorKind::Imu, 1);
        schedule.attacks.push(Attack { sensor, start_s: 0.5, ..attack(kind, magnitude) });
        injector.upload(&schedule, FlightTime(0)).unwrap();
        for tick in 0..100_u64 {
            let time = FlightTime(tick * 10_000);
            let mag_ut = tick.is_multiple_of(2).then_some(Vector3::new(0.0, 22.0, -40.0));
            let (gyro_radps, accel_mps2) = (Vector3::x() * tick as f64, Vector3::z() * 9.81);
            let mut frame = SensorFrame { time, ..Default::default() };
            frame.imus[0] = Some(ImuSample { time, gyro_radps, accel_mps2, mag_ut, temperature_c: 25.0 });
            let received = injector.apply(&frame).imus[0].unwrap();
            assert_eq!(received.mag_ut, mag_ut, "{kind:?} at tick {tick}");
            assert_eq!(received.gyro_radps == gyro_radps, tick < 50, "{kind:?} at tick {tick}");
        }
    }
}

#[test]
fn a_sample_that_holds_what_is_no_number_passes_as_it_is() {
    let mut injector = Injector::new(Bounds::default(), true, SENSORS);
    let nan = f64::NAN;
    let world_from_body = UnitQuaternion::new_unchecked(Quaternion::new(nan, nan, nan, nan));
    let sample = MocapPoseSample { time: FlightTime(0), position_enu_m: Vector3::repeat(nan), world_from_body };
    let received = injector.apply(&SensorFrame { mocap_pose: Some(sample), ..Default::default() });
    assert!(received.mocap_pose.unwrap().world_from_body.coords.iter().all(|x| x.is_nan()));
}

/// Commands at 100 Hz that ask rotors for `asked(t)` of their full thrust; what reaches rotor 2, as the same.
fn drive(injector: &mut Injector, airframe: &Airframe, flying: bool, asked: impl Fn(f64) -> f64) -> Vec<(f64, f64)> {
    let (curve, full) = (airframe.motor_curve, airframe.motor_curve.full_speed_radps());
    let mut out = Vec::new();
    for tick in 0..200_u64 {
        let time = FlightTime(tick * 10_000);
        let command = MotorCommand { throttle: [curve.command(full * asked(time.as_seconds()).sqrt(), 1.0); ROTORS] };
        injector.apply(&SensorFrame { time, ..Default::default() });
        let reached = injector.apply_command(airframe, &command, flying, time);
        for other in [0, 2, 3] {
            assert_eq!(reached.throttle[other].to_bits(), command.throttle[other].to_bits());
        }
        out.push((time.as_seconds(), (curve.speed_radps(reached.throttle[1], 1.0) / full).powi(2)));
    }
    out
}

#[test]
fn rotors_lose_thrust_stick_lag_and_keep_what_they_were_told_last() {
    let asked = |t: f64| 0.5 + 0.1 * t;
    let on_rotor = |kind, magnitude| Attack {
        sensor: SensorId::new(SensorKind::Rotor, 2),
        start_s: 0.5,
        duration_s: 1.0,
        ..attack(kind, magnitude)
    };
    type Expected = fn(f64) -> f64;
    let cases: [(Kind, f64, Expected); 6] = [
        (Kind::Scale, 0.8, |asked| 0.8 * asked),
        (Kind::Bias, -0.1, |asked| asked - 0.1),
        (Kind::Zero, 0.0, |_| 0.0),
        (Kind::Freeze, 0.0, |_| 0.549),
        (Kind::Delay, 0.2, |asked| asked - 0.02),
        (Kind::Dropout, 1.0, |_| 0.549),
    ];
    let airframe = Airframe::iris();
    for (kind, magnitude, expected) in cases {
        for flying in [true, false] {
            let mut injector = Injector::new(Bounds::default(), true, SENSORS);
            let mut schedule = Schedule::default();
            schedule.attacks.push(on_rotor(kind, magnitude));
            injector.upload(&schedule, FlightTime(0)).unwrap();
            for (t, reached) in drive(&mut injector, &airframe, flying, asked) {
                let attacked = flying && (0.5..1.5).contains(&t);
                let expected = if attacked { expected(asked(t)) } else { asked(t) };
                assert!((reached - expected).abs() < 1e-9, "{kind:?} at {t} s: {reached}, expected {expected}");
            }
            let progress = injector.state()[0];
            assert_eq!(
                (progress.phase, progress.altered_samples),
                (Phase::Done, if flying { 100 } else { 0 }),
                "{kind:?}"
            );
        }
    }
}

#[test]
fn only_rotors_that_there_are_can_be_attacked_and_by_no_more_than_their_full_thrust() {
    let mut injector = Injector::new(Bounds::default(), true, SENSORS);
    for (instance, kind, magnitude, complaint) in [
        (5, Kind::Bias, 0.1, "no rotor 5"),
        (0, Kind::Bias, 0.1, "no rotor 0"),
        (1, Kind::Bias, 1.5, "outside -1 to 1"),
        (1, Kind::TimeShift, 0.1, "TimeShift cannot cover All of rotor 1"),
    ] {
        let mut schedule = Schedule::default();
        let sensor = SensorId::new(SensorKind::Rotor, instance);
        schedule.attacks.push(Attack { sensor, ..attack(kind, magnitude) });
        let error = injector.upload(&schedule, FlightTime(0)).unwrap_err().to_string();
        assert!(error.contains(complaint), "{error}");
    }
}

#[test]
fn a_time_shift_alters_the_stamp_alone_and_never_below_zero() {
    for (magnitude, expected) in [(0.3, 6_300_000), (-0.3, 5_700_000), (-2.0, 4_000_000)] {
        let mut injector = Injector::new(Bounds::default(), true, SENSORS);
        let mut schedule = Schedule::default();
        schedule.attacks.push(attack(Kind::TimeShift, magnitude));
        injector.upload(&schedule, FlightTime(0)).unwrap();
        let sample = Some(HeightSample { time: FlightTime(6_000_000), height_m: 0.5 });
        let mut frame = SensorFrame { time: FlightTime(6_000_000), ..Default::default() };
        (frame.heights[0], frame.heights[1]) = (sample, sample);
        let received = injector.apply(&frame).heights;
        assert_eq!(received[1], Some(HeightSample { time: FlightTime(expected), height_m: 0.5 }));
        assert_eq!((received[0], injector.state()[0].altered_samples), (sample, 1));
    }
    let mut injector = Injector::new(Bounds::default(), true, SENSORS);
    let mut schedule = Schedule::default();
    schedule.attacks.push(attack(Kind::TimeShift, 2.1));
    let refused = injector.upload(&schedule, FlightTime(0)).unwrap_err().to_string();
    assert!(refused.contains("time shift (s) 2.1 is outside -2 to 2"), "{refused}");
}
