use super::*;
use plumbline_proto::v1::{Reception, SensorKind};

fn estimate(time_us: u64, z: f64) -> v1::Estimate {
    v1::Estimate {
        time_us,
        in_loop: true,
        position_enu_m: Some(v1::Vector3 { x: 0.0, y: 0.0, z }),
        roll_pitch_yaw_rad: Some(v1::Vector3::default()),
        ..Default::default()
    }
}

fn batch(range: std::ops::Range<u64>) -> Vec<u8> {
    let mut out = Vec::new();
    for i in range {
        append(&mut out, Kind::Estimate, 1, i, i * 10_000, &estimate(i * 10_000, i as f64 * 0.01));
    }
    out
}

#[test]
fn the_newest_state_is_shown_at_once_and_the_past_is_laid_under_it() {
    let past_of = |boot, range| {
        let mut past = Live::past(boot);
        past.ingest(&batch(range), 0.0).unwrap();
        past
    };
    let past = |range| past_of(0, range);
    let mut live = Live::default();
    live.connection_opened();
    // GIVEN the newest state and some live data
    live.ingest(&batch(500..501), 1.0).unwrap();
    assert_eq!(live.estimate().unwrap().get().unwrap().time_us, 500 * 10_000);
    live.ingest(&batch(501..520), 1.0).unwrap();
    // WHEN the past arrives, which also holds what came meanwhile
    live.fill(past(100..510));
    // THEN each sample is there once, and the newest is still the newest
    assert_eq!(live.curves.len(Curve::Altitude(1)), 420);
    assert_eq!(live.estimate().unwrap().get().unwrap().time_us, 519 * 10_000);
    // WHEN more of the past is asked for
    live.fill(past(1..510));
    assert_eq!(live.curves.len(Curve::Altitude(1)), 519);
    // WHEN the socket was lost for a tenth of a second
    live.connection_opened();
    live.ingest(&batch(530..535), 2.0).unwrap();
    assert_eq!(live.curves.len(Curve::Altitude(1)), 524);
    live.fill(past(300..532));
    // THEN only what was missed is added
    assert_eq!(live.curves.len(Curve::Altitude(1)), 534);
    // WHEN the vehicle was started again meanwhile, THEN another boot's past is not mixed in
    live.fill(past_of(7, 530..550));
    assert_eq!(live.curves.len(Curve::Altitude(1)), 534);
}

#[test]
fn the_age_is_that_of_what_is_here_and_not_of_what_the_ground_has() {
    let mut live = Live::default();
    let link = |newest_time_us| {
        let mut out = Vec::new();
        let status = v1::LinkStatus { connected: true, age_ms: 5.0, newest_time_us, ..Default::default() };
        append(&mut out, Kind::Link, 0, 0, 0, &status);
        out
    };
    assert_eq!(live.age_s(0.0), None);
    // GIVEN a page that has read up to 1 s, and a ground that has 4 s
    live.ingest(&link(4_000_000), 100.0).unwrap();
    live.ingest(&batch(1..101), 100.0).unwrap();
    assert!((live.age_s(100.0).unwrap() - 3.005).abs() < 1e-9);
    // WHEN the page catches up
    live.ingest(&batch(101..401), 100.0).unwrap();
    assert!((live.age_s(100.0).unwrap() - 0.005).abs() < 1e-9);
}

/// What a vehicle says of itself: number of its boot and wall time it began at, µs.
fn description(boot_id: u64, boot_wall_time_us: u64) -> Vec<u8> {
    let mut out = Vec::new();
    let description = v1::Description { boot_id, boot_wall_time_us, ..Default::default() };
    append(&mut out, Kind::Description, 0, 1, 10, &description);
    out
}

#[test]
fn a_reboot_clears_the_axis_but_not_the_link() {
    // (before, after, another boot?): the wall clock may be set at any time, and means a boot to agents of old only.
    let cases = [
        ((1, 1_000_000_000), (2, 1_000_000_100), true),
        ((1, 1_000_000_000), (1, 1_000_000_000), false),
        ((1, 1_000_000_000), (1, 9_000_000_000), false),
        ((0, 1_000_000_000), (0, 1_000_000_000), false),
        ((0, 1_000_000_000), (0, 1_000_000_100), true),
    ];
    for (before, after, another) in cases {
        let mut live = Live::default();
        live.ingest(&description(before.0, before.1), 0.0).unwrap();
        let mut link = Vec::new();
        append(&mut link, Kind::Link, 0, 0, 0, &v1::LinkStatus { connected: true, ..Default::default() });
        live.ingest(&link, 0.0).unwrap();
        live.ingest(&batch(1..10), 0.0).unwrap();
        live.ingest(&description(after.0, after.1), 0.0).unwrap();
        assert_eq!(live.curves.len(Curve::Altitude(1)), if another { 0 } else { 9 }, "{before:?} then {after:?}");
        assert_eq!(live.estimate().is_none(), another);
        assert_eq!(live.clock.newest_us(), if another { 10 } else { 90_000 });
        assert!(live.ground.link.is_some());
    }
}

#[test]
fn broken_frames_are_counted_and_do_no_harm() {
    let mut live = Live::default();
    let mut out = Vec::new();
    codec::begin_batch(&mut out);
    codec::Frame { kind: Kind::Status.to_wire(), instance: 0, sequence: 1, time_us: 1, payload: &[0xff; 7] }
        .encode(&mut out);
    codec::Frame { kind: 9999, instance: 0, sequence: 2, time_us: 1, payload: b"x" }.encode(&mut out);
    live.ingest(&out, 0.0).unwrap();
    assert_eq!(live.unreadable().0, 1);
    assert!(live.ingest(b"\x50\x63", 0.0).unwrap_err().to_string().contains("schema 99"));
}

#[test]
fn an_altered_height_is_charted_as_received_and_a_dropped_one_not_at_all() {
    let mut live = Live::recorded();
    let mut out = Vec::new();
    let altered = v1::HeightSample {
        time_us: 1,
        reception: Reception::Altered.into(),
        sensed_m: 0.5,
        received_m: Some(1.0),
        ..Default::default()
    };
    let dropped =
        v1::HeightSample { time_us: 2, reception: Reception::Dropped.into(), sensed_m: 0.5, ..Default::default() };
    append(&mut out, Kind::Height, 2, 1, 1, &altered);
    append(&mut out, Kind::Height, 2, 2, 2, &dropped);
    live.ingest(&out, 0.0).unwrap();
    assert_eq!(live.curves.len(Curve::Height(2)), 1);
    assert_eq!(live.curves.value_at(Curve::Height(2), 1e-6), Some(1.0));
}

#[test]
fn worst_channel_of_an_instance_and_rows_in_order() {
    let mut live = Live::recorded();
    let residual = |sensor: SensorKind, instance, channel, ratio| v1::Residual {
        sensor: sensor.into(),
        instance,
        channel,
        ratio,
        gate: 1.0,
        innovation: ratio,
        ..Default::default()
    };
    let message = v1::Residuals {
        time_us: 5,
        estimator: 1,
        residuals: vec![
            residual(SensorKind::Imu, 1, 7, 0.2),
            residual(SensorKind::Imu, 1, 8, 0.9),
            residual(SensorKind::Height, 2, 11, 1.4),
        ],
    };
    let mut out = Vec::new();
    append(&mut out, Kind::Residuals, 1, 1, 5, &message);
    live.ingest(&out, 0.0).unwrap();
    assert_eq!(live.residual_rows(1), vec![(SensorKind::Height as i32, 2), (SensorKind::Imu as i32, 1)]);
    let (worst, _) = live.worst_residual(1, SensorKind::Imu as i32, 1, 0.0).unwrap();
    assert_eq!((worst.channel, worst.ratio), (8, 0.9));
    assert!(live.worst_residual(2, 1, 1, 0.0).is_none());
}

#[test]
fn what_a_silent_sensor_said_last_is_old_and_what_others_say_is_not() {
    let mut live = Live::default();
    let mut feed = |instances: &[u32], range: std::ops::Range<u64>| {
        let mut out = Vec::new();
        let end_ms = (range.end - 1) as f64 * 100.0;
        for i in range {
            let of = |instance| v1::Residual { sensor: 2, instance, ratio: 0.4, ..Default::default() };
            let residuals = instances.iter().copied().map(of).collect();
            let message = v1::Residuals { time_us: i * 100_000, estimator: 1, residuals };
            append(&mut out, Kind::Residuals, 1, i, i * 100_000, &message);
        }
        live.ingest(&out, end_ms).unwrap();
        [1, 2].map(|instance| {
            let residual = live.worst_residual(1, 2, instance, end_ms).unwrap();
            (residual.0.ratio, residual.1, live.has_ended(Curve::Worst(1, 2, instance), end_ms))
        })
    };
    // GIVEN two sensors; WHEN one falls silent, THEN what it said last is old after a second
    assert_eq!(feed(&[1, 2], 1..20), [(0.4, false, false); 2]);
    assert_eq!(feed(&[1], 20..28), [(0.4, false, false); 2]);
    assert_eq!(feed(&[1], 28..31), [(0.4, false, false), (0.4, true, true)]);
    // WHEN it is back, THEN it counts again
    assert_eq!(feed(&[1, 2], 31..32), [(0.4, false, false); 2]);
}

#[test]
fn a_slow_sensor_is_not_silent_between_two_samples_and_no_outage_makes_it_slower() {
    let mut live = Live::default();
    let mut ended_after = |times_s: &[u64], later_s: f64| {
        let mut out = Vec::new();
        let mut end_ms = 0.0;
        for time_s in times_s {
            let residuals = vec![v1::Residual { sensor: 2, instance: 1, ratio: 0.4, ..Default::default() }];
            let message = v1::Residuals { time_us: time_s * 1_000_000, estimator: 1, residuals };
            append(&mut out, Kind::Residuals, 1, *time_s, time_s * 1_000_000, &message);
            end_ms = *time_s as f64 * 1e3;
        }
        live.ingest(&out, end_ms).unwrap();
        [0.0, later_s].map(|later_s| live.has_ended(Curve::Worst(1, 2, 1), end_ms + 1e3 * (1.2 + later_s)))
    };
    // GIVEN a sample a second; WHEN the next is overdue by two, THEN it has ended
    assert_eq!(ended_after(&[1, 2, 3], 2.0), [false, true]);
    // WHEN one comes after a minute, and no other
    assert_eq!(ended_after(&[63], 4.0), [false, true]);
}

#[test]
fn steps_update_in_place_and_events_do_not_repeat() {
    let mut live = Live::default();
    let mut out = Vec::new();
    for rise in [None, Some(0.4)] {
        let step = v1::StepResponse { time_us: 10, step: 1, start_time_us: 5, rise_time_s: rise, ..Default::default() };
        append(&mut out, Kind::StepResponse, 0, 1, 10, &step);
    }
    for _ in 0..2 {
        append(&mut out, Kind::Event, 0, 3, 11, &v1::Event { time_us: 11, text: "armed".into(), ..Default::default() });
    }
    live.ingest(&out, 0.0).unwrap();
    assert_eq!(live.log.steps.len(), 1);
    assert_eq!(live.log.steps[0].rise_time_s, Some(0.4));
    assert_eq!(live.log.events.len(), 1);
}

#[test]
fn the_edge_stands_still_in_an_outage() {
    let mut live = Live::default();
    live.clock.measure(200_000_000, 10.0, 900.0);
    assert_eq!(live.edge_us(900.0), 0.0, "nothing has come yet");
    live.clock = Default::default();
    live.ingest(&batch(1..101), 1000.0).unwrap();
    assert_eq!(live.edge_us(1000.0), 1_000_000.0);
    assert_eq!(live.edge_us(1500.0), 1_500_000.0);
    assert_eq!(live.edge_us(60_000.0), 3_000_000.0);
}
