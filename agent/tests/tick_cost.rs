//! How long a tick takes, and how much faster than real time a flight is. A measurement:
//! `cargo test --release -p plumbline-agent --test tick_cost -- --ignored --nocapture`.
#![allow(clippy::unwrap_used)]

mod common;

use std::time::Instant;

use common::{Flown, scenario};
use plumbline_agent::vehicle::Vehicle;

#[test]
#[ignore = "a measurement"]
fn tick_cost() {
    let mut f = Flown::new(&scenario("altitude_step"));
    let script = f.scenario.script.clone();
    let mut times = Vec::new();
    let mut before = None;
    let whole = Instant::now();
    while f.vehicle.time().as_seconds() < 45.0 {
        let frame = f.vehicle.sense().unwrap();
        f.flight.heartbeat(frame.time);
        script.commands(before, frame.time, |c| {
            f.flight.apply(c, frame.time);
        });
        before = Some(frame.time);
        let start = Instant::now();
        let command = f.flight.step(&frame).command;
        times.push(start.elapsed().as_secs_f64() * 1e6);
        let applied = f.vehicle.actuate(&command).unwrap();
        f.flight.applied(applied);
    }
    let speed = f.vehicle.time().as_seconds() / whole.elapsed().as_secs_f64();
    times.sort_by(f64::total_cmp);
    println!(
        "{{\"bench\":\"agent\",\"name\":\"tick\",\"median_us\":{:.2},\"p99_us\":{:.2},\"times_real_time\":{:.0}}}",
        times[times.len() / 2],
        times[times.len() * 99 / 100],
        speed
    );
}

#[test]
#[ignore = "a measurement"]
fn riccati_cost() {
    use nalgebra::DMatrix;
    use plumbline_agent::control::gains::certify;
    use plumbline_agent::control::lqr_integral::Weights;
    use plumbline_agent::control::tuning::Design;
    use plumbline_agent::linalg::care;
    use plumbline_agent::model::airframe::Airframe;
    use plumbline_agent::model::linearize::hover;
    use plumbline_proto::ids::GainsRevision;

    let median = |mut run: Box<dyn FnMut()>| {
        let mut times: Vec<f64> = (0..101)
            .map(|_| {
                let start = Instant::now();
                run();
                start.elapsed().as_secs_f64() * 1e6
            })
            .collect();
        times.sort_by(f64::total_cmp);
        times[50]
    };
    let airframe = Airframe::iris();
    let linear = hover(&airframe);
    for n in [12, 16] {
        let mut a = DMatrix::zeros(n, n);
        let mut b = DMatrix::zeros(n, 4);
        a.view_mut((0, 0), (12, 12)).copy_from(&linear.a);
        b.view_mut((0, 0), (12, 4)).copy_from(&linear.b);
        for (i, state) in [0, 1, 2, 8].into_iter().enumerate().filter(|(i, _)| 12 + i < n) {
            a[(12 + i, state)] = 1.0;
        }
        let (q, r) = (DMatrix::identity(n, n), DMatrix::identity(4, 4));
        let time = median(Box::new(move || {
            care(&a, &b, &q, &r).unwrap();
        }));
        println!("{{\"bench\":\"control\",\"name\":\"care_{n}\",\"value\":{time:.0},\"unit\":\"us\"}}");
    }
    let design = Design::from_weights(Weights::for_airframe(&airframe));
    let time = median(Box::new(move || {
        certify(&airframe, 0.005, &design, GainsRevision(1)).unwrap();
    }));
    println!("{{\"bench\":\"control\",\"name\":\"certify\",\"value\":{time:.0},\"unit\":\"us\"}}");
}
