//! Offset and skew of clocks that drift, roll over and jump.

use plumbline_core::sensor::noise::Stream;
use plumbline_devices::clock::{DeviceClock, Stamp};

/// Frames of a clock that runs `skew` fast, seen through jittery delays; the largest error after `settle_s`.
fn worst_us(skew: f64, jitter_us: f64, roll_over: u64, settle_s: f64) -> (f64, DeviceClock) {
    let mut clock = DeviceClock::default();
    let mut noise = Stream::new(1, "clock");
    let mut worst: f64 = 0.0;
    for frame in 0..3_000_u64 {
        let true_us = frame as f64 * 10_000.0 + 5e6;
        let ticks = (true_us * (1.0 + skew)).round() as u64 % roll_over;
        let arrival_us = true_us + 300.0 + jitter_us * noise.normal().abs();
        let mapped = clock.map(Stamp { ticks, tick_us: 1.0, roll_over }, arrival_us);
        assert_eq!(mapped.jumped_s, None, "frame {frame}");
        assert!(mapped.time_us <= arrival_us);
        if true_us > 5e6 + settle_s * 1e6 {
            worst = worst.max((mapped.time_us - true_us - 300.0).abs());
        }
    }
    (worst, clock)
}

#[test]
fn offset_and_skew_are_found_through_jitter_and_roll_over() {
    for (skew, jitter_us, limit_us) in [(0.0, 500.0, 120.0), (50e-6, 500.0, 150.0), (-0.01, 500.0, 300.0)] {
        let (worst, clock) = worst_us(skew, jitter_us, 1 << 24, 6.0);
        println!(
            "skew {skew}: worst {worst:.0} µs, skew found {:.1e}, jitter {:.0} µs",
            clock.skew(),
            clock.jitter_us()
        );
        assert!(worst < limit_us, "skew {skew}: {worst} µs");
        assert!((clock.skew() + skew / (1.0 + skew)).abs() < 3e-5, "{} against {skew}", clock.skew());
        assert!((0.3 * jitter_us..jitter_us).contains(&clock.jitter_us()), "{}", clock.jitter_us());
    }
}

#[test]
fn a_clock_that_jumps_back_is_told_once_and_followed() {
    let mut clock = DeviceClock::default();
    let at = |ticks: u64| Stamp { ticks, tick_us: 1e3, roll_over: 1 << 24 };
    for k in 0..500 {
        assert_eq!(clock.map(at(100_000 + 10 * k), 1e4 * k as f64).jumped_s, None);
    }
    // 60 s back.
    let mapped = clock.map(at(45_000), 5e6);
    assert!((mapped.jumped_s.unwrap() + 60.0).abs() < 0.1, "{mapped:?}");
    assert_eq!(mapped.time_us, 5e6);
    let after = clock.map(at(45_010), 5.01e6);
    assert_eq!((after.jumped_s, after.time_us), (None, 5.01e6));
}

/// Each way takes 20 ms, and the way there at times less.
#[test]
fn a_latency_that_is_the_same_both_ways_is_found_where_the_clock_can_be_asked() {
    const LATENCY_US: f64 = 20e3;
    let mut clock = DeviceClock::default();
    let mut noise = Stream::new(3, "exchange");
    let theirs = |ours_us: f64| (ours_us * (1.0 + 40e-6) + 7e9) as u64;
    let stamp = |ours_us: f64, tick_us: f64| Stamp {
        ticks: (theirs(ours_us) as f64 / tick_us) as u64,
        tick_us,
        roll_over: 1 << 62,
    };
    let mut worst_us: f64 = 0.0;
    for frame in 0..4_000_u64 {
        let true_us = frame as f64 * 5_000.0 + 5e6;
        let mut delay = || LATENCY_US + 2e3 * noise.normal().abs();
        if frame % 100 == 50 {
            let (asked_us, there_us) = (true_us, true_us + delay());
            clock.answered(stamp(there_us, 1e-3), asked_us, there_us + delay());
        }
        let mapped = clock.map(stamp(true_us, 1.0), true_us + delay());
        assert_eq!(mapped.jumped_s, None);
        if frame > 1_000 {
            worst_us = worst_us.max((mapped.time_us - true_us).abs());
        }
    }
    let (round_trip_us, offset_us) = clock.offset().unwrap();
    println!("round trip {round_trip_us:.0} µs, worst {worst_us:.0} µs, offset {offset_us:.0} µs");
    assert!((2.0 * LATENCY_US..2.3 * LATENCY_US).contains(&round_trip_us), "{round_trip_us}");
    assert!(worst_us < 1_000.0, "20 ms of latency, all but {worst_us} µs of it found");
    assert!((offset_us - 7e9).abs() < 3e3, "{offset_us}");
}
