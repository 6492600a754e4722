//! Attitude on the single-axis rig and on strings, against [Paternain] VIII-A and B.

use plumbline_agent::frames::{roll_pitch_yaw, wrap_pi};
use plumbline_support::flown::{check, expect, scenario};

/// Recovery from a held angle: time from 90 % to 10 % of it, and the largest swing past zero.
fn recovery(samples: &[(f64, f64)], released_s: f64) -> Option<(f64, f64)> {
    let after: Vec<_> = samples.iter().filter(|s| s.0 >= released_s).collect();
    let start = after.first()?.1;
    let sign = start.signum();
    let high = after.iter().find(|s| sign * s.1 <= 0.9 * start.abs())?.0;
    let low = after.iter().find(|s| sign * s.1 <= 0.1 * start.abs())?.0;
    let past = after.iter().map(|s| -sign * s.1).fold(0.0, f64::max);
    Some((low - high, past))
}

#[test]
fn a_roll_of_twenty_degrees_is_recovered_as_fast_as_paternain() {
    for seed in 1..=3 {
        let toml = scenario("single_axis_roll").replace("seed = 1", &format!("seed = {seed}"));
        check(&toml, |f| {
            let samples: Vec<_> = f.rows.iter().map(|r| (r.t_s, roll_pitch_yaw(&r.truth.world_from_body).x)).collect();
            let held = samples.iter().find(|s| s.0 >= 8.39).map_or(0.0, |s| s.1);
            expect((held - 0.349).abs() < 0.02, || format!("held at {:.1}°", held.to_degrees()))?;
            let (rise, past) = recovery(&samples, 8.4).ok_or("never recovers")?;
            println!("seed {seed}: rise {rise:.3} s, overshoot {:.2}°", past.to_degrees());
            expect(rise <= 0.4, || format!("rise {rise:.3} s"))?;
            expect(past.to_degrees() <= 4.0, || format!("overshoot {:.2}°", past.to_degrees()))?;
            let end = f.since(13.0).map(|r| roll_pitch_yaw(&r.truth.world_from_body).x.abs()).fold(0.0, f64::max);
            expect(end.to_degrees() < 2.0, || format!("still {:.2}° off", end.to_degrees()))
        });
    }
}

#[test]
fn yaw_on_one_string_is_recovered_as_fast_as_paternain() {
    check(&scenario("string_yaw"), |f| {
        let before = f.rows.iter().rfind(|r| r.t_s < 10.0).map_or(0.0, |r| roll_pitch_yaw(&r.truth.world_from_body).z);
        let samples: Vec<_> =
            f.rows.iter().map(|r| (r.t_s, wrap_pi(roll_pitch_yaw(&r.truth.world_from_body).z - before))).collect();
        let (rise, past) = recovery(&samples, 11.2).ok_or("never recovers")?;
        let start = samples.iter().find(|s| s.0 >= 11.2).map_or(0.0, |s| s.1);
        let percent = 100.0 * past / start.abs();
        println!("yaw from {:.2} rad: rise {rise:.2} s, overshoot {percent:.1} %", start);
        expect(rise <= 1.6, || format!("rise {rise:.2} s"))?;
        expect(percent <= 13.0, || format!("overshoot {percent:.1} %"))?;
        let heaviest = f.rows.iter().map(|r| r.report.given.thrust_n).fold(0.0, f64::max);
        expect(heaviest <= 0.9 * 1.545 * 9.81 + 1e-9, || format!("thrust {heaviest:.2} N reaches lift-off"))
    });
}
