//! The estimator `secure` at rest, under attack, and over gaps.

use super::super::decode::GAP;
use super::*;
use crate::sensor::{HeightSample, ImuSample};
use nalgebra::Vector3;

/// Bounded pseudo-noise of unit variance.
fn noise(k: u64, i: u64) -> f64 {
    1.414 * ((k * 7919 + i * 104_729) as f64 * 0.618).sin()
}

/// A vehicle at rest at 0.5 m: four IMUs, and heights that read `heights[i]` more.
fn frame(k: u64, heights: &[f64]) -> SensorFrame {
    let time = FlightTime(k * 5000);
    let mut frame = SensorFrame { time, ..SensorFrame::default() };
    for (i, imu) in frame.imus.iter_mut().enumerate().take(4).filter(|(i, _)| k % 2 == *i as u64 % 2) {
        let n = |a: u64| noise(k, 10 * i as u64 + a);
        *imu = Some(ImuSample {
            time,
            gyro_radps: Vector3::new(n(0), n(1), n(2)) * 0.003,
            accel_mps2: Vector3::new(n(3) * 0.05, n(4) * 0.05, 9.81 + n(5) * 0.05),
            mag_ut: Some(Vector3::new(0.0, 20.0, -40.0)),
            temperature_c: 20.0,
        });
    }
    for (i, (slot, more)) in frame.heights.iter_mut().zip(heights).enumerate() {
        if k % 20 == 7 * i as u64 {
            *slot = Some(HeightSample { time, height_m: 0.5 + more + 0.005 * noise(k, 50 + i as u64) });
        }
    }
    frame
}

fn secure() -> Secure {
    Secure::new(SensorModel::default(), &Airframe::iris(), SLOTS).unwrap()
}

fn fly(secure: &mut Secure, from_s: f64, to_s: f64, heights: &[f64]) {
    for k in (from_s * 200.0) as u64..(to_s * 200.0) as u64 {
        secure.step(&frame(k, heights), &MotorCommand::default());
    }
}

#[test]
fn at_rest_it_decodes_the_height_with_a_bound_and_flags_none() {
    let mut s = secure();
    fly(&mut s, 0.0, 8.0, &[0.0; 3]);
    assert_eq!(s.window().status, DecoderStatus::Solved);
    assert!((s.window().height_m - 0.5).abs() < s.height_bound_m().unwrap(), "{:?}", s.window());
    assert!(s.window().objective - s.window().lower_bound <= 2.0 * GAP * s.window().objective);
    assert!(s.isolation().devices().iter().all(|d| d.flagged.is_none()));
    assert_eq!(s.estimate().health, Health::Healthy);
    assert_eq!(s.isolation().margin(SensorKind::Height).margin(), 3);
}

#[test]
fn an_attack_is_flagged_and_the_bound_follows_what_remains() {
    let mut s = secure();
    fly(&mut s, 0.0, 6.0, &[0.0; 3]);
    fly(&mut s, 6.0, 8.0, &[0.0, 0.3, 0.0]);
    assert!(s.isolation().is_flagged(SensorId::new(SensorKind::Height, 2)));
    assert!((s.estimate().altitude_m().unwrap() - 0.5).abs() < 0.02, "{}", s.estimate().altitude_m().unwrap());
    assert_eq!(s.isolation().margin(SensorKind::Height).margin(), 1);
    // A second attack: nothing is promised any more.
    fly(&mut s, 8.0, 10.0, &[0.4, 0.3, 0.0]);
    assert!(s.height_bound_m().is_none(), "{:?}", s.isolation().devices());
}

#[test]
fn an_excluded_height_takes_its_baseline_with_it() {
    let mut s = secure();
    let mut mean = |from: u64, to: u64, heights: &[f64]| {
        let estimated =
            (from..to).map(|k| s.step(&frame(k, heights), &MotorCommand::default()).motion.unwrap().position_enu_m.z);
        let last = estimated.skip((to - from) as usize - 400);
        (last.sum::<f64>() / 400.0, s.isolation().margin(SensorKind::Height).flagged)
    };
    let (before, none) = mean(0, 2400, &[0.008, -0.002, 0.0]);
    let (after, flagged) = mean(2400, 3400, &[0.508, -0.002, 0.0]);
    assert_eq!((none, flagged), (0, 1));
    // About their mean, not about that of the remaining two, 3 mm lower.
    assert!((before - 0.502).abs() < 1.5e-3 && (after - before).abs() < 1.5e-3, "{before} {after}");
}

#[test]
fn an_imu_that_drifted_is_excluded_from_the_last_moments_as_well() {
    // A ramp of 0.5 m/s³ upward in IMU 2 from 6 s on, until a while after it is excluded.
    let flown = |ramp: f64| {
        let mut s = secure();
        let attacked = SensorId::new(SensorKind::Imu, 2);
        let mut excluded_at = None;
        for k in 0..1800 {
            let mut frame = frame(k, &[0.0; 3]);
            let t = k as f64 * 0.005;
            if let Some(imu) = &mut frame.imus[1] {
                imu.accel_mps2.z += ramp * (t - 6.0).max(0.0);
            }
            s.step(&frame, &MotorCommand::default());
            if s.isolation().excluded().contains(attacked) {
                excluded_at = excluded_at.or(Some(t));
            }
        }
        (s.estimate().clone(), excluded_at, s.rewinds())
    };
    let (clean, never, none) = flown(0.0);
    let (ramped, at, rewinds) = flown(0.5);
    assert!(never.is_none() && none == 0 && rewinds >= 1, "{never:?} {none} {rewinds}");
    assert!(at.unwrap() < 8.0, "{at:?}");
    let bias = (ramped.accel_bias_mps2.unwrap().z - clean.accel_bias_mps2.unwrap().z).abs();
    let climb = ramped.motion.unwrap().velocity_enu_mps.z.abs();
    assert!(bias < 0.02 && climb < 0.01, "{bias} {climb}");
}

#[test]
fn a_constant_difference_learned_at_rest_excludes_none_in_vibration() {
    let mut s = secure();
    for k in 0..4000 {
        let mut frame = frame(k, &[0.0; 3]);
        let vibration = if k < 1200 { 0.0 } else { noise(k, 99) };
        for (i, imu) in frame.imus.iter_mut().enumerate().filter_map(|(i, imu)| Some((i, imu.as_mut()?))) {
            imu.accel_mps2.z += vibration + if i == 2 { 0.3 } else { 0.0 };
        }
        s.step(&frame, &MotorCommand::default());
        assert!(s.isolation().excluded().is_empty(), "{k}: {:?}", s.isolation().devices());
    }
}

#[test]
fn every_decoder_finds_the_attack_and_a_change_of_decoder_keeps_the_attacked_set() {
    for decoder in [Decoder::L2, Decoder::L1, Decoder::L2Split, Decoder::L1Split] {
        let mut s = secure();
        s.use_decoder(decoder);
        fly(&mut s, 0.0, 6.0, &[0.0; 3]);
        assert_eq!(s.window().status, DecoderStatus::Solved, "{decoder:?}");
        assert!((s.window().height_m - 0.5).abs() < 0.01, "{decoder:?}: {:?}", s.window());
        assert!(s.isolation().devices().iter().all(|d| d.flagged.is_none()), "{decoder:?}");
        fly(&mut s, 6.0, 8.0, &[0.0, 0.3, 0.0]);
        let flagged = |s: &Secure| s.isolation().devices().iter().filter(|d| d.flagged.is_some()).count();
        let attacked = SensorId::new(SensorKind::Height, 2);
        assert!(s.isolation().is_flagged(attacked) && flagged(&s) == 1, "{decoder:?}");
        let other = if decoder == Decoder::L2 { Decoder::L1Split } else { Decoder::L2 };
        s.use_decoder(other);
        fly(&mut s, 8.0, 9.0, &[0.0, 0.3, 0.0]);
        assert_eq!((s.decoder(), s.window().status), (other, DecoderStatus::Solved));
        assert!(s.isolation().is_flagged(attacked) && flagged(&s) == 1, "{decoder:?} to {other:?}");
    }
}

#[test]
fn windows_of_any_length_find_the_attack_and_nothing_else() {
    for slots in [SLOTS_MIN, 20, SLOTS_MAX] {
        let mut s = Secure::new(SensorModel::default(), &Airframe::iris(), slots).unwrap();
        fly(&mut s, 0.0, 8.0, &[0.0; 3]);
        assert_eq!(s.window().status, DecoderStatus::Solved, "{slots} slots");
        assert!(s.isolation().devices().iter().all(|d| d.flagged.is_none()), "{slots} slots");
        fly(&mut s, 8.0, 11.0, &[0.0, 0.3, 0.0]);
        let flagged: Vec<_> = s.isolation().devices().iter().filter(|d| d.flagged.is_some()).collect();
        assert!(
            flagged.len() == 1 && flagged[0].sensor == SensorId::new(SensorKind::Height, 2),
            "{slots}: {flagged:?}"
        );
        assert!(
            (s.estimate().altitude_m().unwrap() - 0.5).abs() < 0.01,
            "{slots}: {}",
            s.estimate().altitude_m().unwrap()
        );
    }
    for slots in [SLOTS_MIN - 1, SLOTS_MAX + 1] {
        assert!(Secure::new(SensorModel::default(), &Airframe::iris(), slots).is_err());
    }
}

#[test]
fn two_heights_that_contradict_each_other_promise_nothing() {
    let mut s = secure();
    fly(&mut s, 0.0, 6.0, &[0.0; 2]);
    assert!(s.height_bound_m().is_none(), "two heights guarantee nothing");
    fly(&mut s, 6.0, 9.0, &[0.0, 0.1]);
    let flagged = s.isolation().margin(SensorKind::Height).flagged;
    assert!(flagged <= 1, "{:?}", s.isolation().devices());
    assert!(s.height_bound_m().is_none());
}

#[test]
fn garbage_gaps_and_time_running_backwards_never_panic_nor_poison_the_estimate() {
    let mut s = secure();
    fly(&mut s, 0.0, 5.0, &[0.0; 3]);
    for k in 1000..1100 {
        let mut bad = frame(k, &[f64::NAN, f64::INFINITY, -1e300]);
        bad.imus.iter_mut().flatten().for_each(|imu| imu.gyro_radps.x = f64::NAN);
        s.step(&bad, &MotorCommand { throttle: [f64::NAN; 4] });
    }
    assert!(s.estimate().motion.unwrap().position_enu_m.iter().all(|v| v.is_finite()));
    assert!(s.disturbance_enu_n().iter().all(|v| v.is_finite()));
    fly(&mut s, 2.0, 2.1, &[0.0; 3]);
    assert_eq!(s.window().status, DecoderStatus::Filling, "time went backwards: another flight's window is void");
    for k in 0..200 {
        let empty = SensorFrame { time: FlightTime(3_000_000 + k * 5000), ..SensorFrame::default() };
        s.step(&empty, &MotorCommand::default());
    }
    assert_eq!(s.estimate().health, Health::Degraded);
    assert_eq!(s.window().fallback, SecureFallback::Prediction);
    let never = secure().step(&SensorFrame::default(), &MotorCommand::default()).health;
    assert_eq!(never, Health::Initialising);
}
