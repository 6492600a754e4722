//! Altitude on the string rig and in free flight: the figures that must be reached.

use plumbline_agent::command::{Command, SetpointChange};
use plumbline_agent::types::Mode;
use plumbline_support::flown::{Flown, check, expect, scenario};

/// 0.5 → 1.0 m settles within ±5 cm in this time, s.
const SETTLING_S: f64 = 4.0;
/// … and overshoots less than this, per cent.
const OVERSHOOT_PERCENT: f64 = 15.0;

#[test]
fn string_rig_step_of_half_a_metre_settles_whatever_the_seed() {
    for seed in 1..=5 {
        let toml = scenario("altitude_step").replace("seed = 1", &format!("seed = {seed}"));
        let mut flown = Flown::new(&toml);
        flown.until(14.9);
        let to = SetpointChange { altitude_m: Some(1.0), ..SetpointChange::default() };
        assert!(flown.command(Command::Setpoint(to)).accepted);
        // The script's own step to 0.8 m at 15 s is left out: fly without script.
        flown.scenario.script = Default::default();
        flown.until(22.0);
        let step = flown.steps.last().unwrap();
        println!("seed {seed}: {step:?}");
        assert!((step.from_m - 0.5).abs() < 1e-9 && (step.to_m - 1.0).abs() < 1e-9);
        assert!(step.settling_time_s.is_some_and(|s| s <= SETTLING_S), "seed {seed}: {}", flown.log());
        assert!(step.overshoot_percent <= OVERSHOOT_PERCENT, "seed {seed}: {}", flown.log());
        // The estimate does not flatter itself: the truth settles too.
        let off = flown.since(14.9 + SETTLING_S).map(|r| (r.truth.position_enu_m.z - 1.0).abs()).fold(0.0, f64::max);
        assert!(off < 0.06, "seed {seed}: the truth is {off:.3} m off after {SETTLING_S} s");
    }
}

#[test]
fn the_whole_string_rig_scenario_flies_lands_and_disarms() {
    let flown = check(&scenario("altitude_step"), |f| {
        expect(f.steps.len() == 4, || format!("{} steps measured", f.steps.len()))?;
        expect(f.acks.iter().all(|a| a.1.accepted), || "a command was refused".into())?;
        expect(!f.last().report.armed, || "still armed".into())?;
        let tension: f64 = f.last().truth.string_tension_n.iter().sum();
        expect(tension > 10.0, || format!("hangs with {tension:.1} N only"))
    });
    println!("{}", flown.log());
}

#[test]
fn another_mode_ends_the_measurement_of_a_step_as_it_stands() {
    let mut f = Flown::new(&scenario("altitude_step"));
    f.until(15.5);
    assert!(f.command(Command::SetMode(Mode::Land)).accepted);
    f.tick();
    let step = *f.steps.last().unwrap();
    assert!(step.to_m == 0.8 && step.finished && step.interrupted, "{step:?}");
    f.until(17.0);
    assert_eq!(f.steps.last(), Some(&step));
}

#[test]
fn take_off_to_one_metre_overshoots_less_than_ten_centimetres() {
    for seed in 1..=3 {
        let toml = scenario("takeoff").replace("seed = 1", &format!("seed = {seed}"));
        check(&toml, |f| {
            let highest = f.rows.iter().map(|r| r.truth.position_enu_m.z).fold(0.0, f64::max);
            println!("seed {seed}: highest {highest:.3} m, {:?}", f.steps);
            expect(highest <= 1.1, || format!("rises to {highest:.3} m"))?;
            let last = f.last().truth.position_enu_m;
            expect((last.z - 1.0).abs() < 0.05 && last.xy().norm() < 0.1, || format!("ends at {last}"))
        });
    }
}
