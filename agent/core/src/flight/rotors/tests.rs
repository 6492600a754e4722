use super::*;
use rand::{RngExt as _, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;

const DT_S: f64 = 0.005;

/// A vehicle that hovers under a crude attitude loop of its own, each rotor giving `parts` of its thrust.
struct Hover {
    airframe: Airframe,
    watch: RotorWatch,
    rates: Vector3<f64>,
    tilt: Vector3<f64>,
    rotors: Rotors,
    applied: MotorCommand,
    rng: Xoshiro256PlusPlus,
    /// A hand's torque, N m, and force, N.
    torque: Vector3<f64>,
    force_n: f64,
    /// Hangs on strings; and what its accelerometers are shaken by beside their noise, from end to end, m/s².
    strings: bool,
    shaken_mps2: f64,
}

impl Hover {
    fn new(seed: u64) -> Self {
        let airframe = Airframe::iris();
        let applied = MotorCommand { throttle: [airframe.hover_command(); ROTORS] };
        Self {
            watch: RotorWatch::new(&airframe),
            airframe,
            rates: Vector3::zeros(),
            tilt: Vector3::zeros(),
            rotors: Rotors::default(),
            applied,
            rng: Xoshiro256PlusPlus::seed_from_u64(seed),
            torque: Vector3::zeros(),
            force_n: 0.0,
            strings: false,
            shaken_mps2: 0.0,
        }
    }

    /// So many seconds; when something was found first, s from their begin.
    fn fly(&mut self, seconds: f64, parts: [f64; ROTORS], free: bool) -> Option<(f64, Found)> {
        let mut first = None;
        for tick in 0..(seconds / DT_S) as usize {
            self.rotors.step(&self.airframe, &self.applied.throttle, 1.0, DT_S);
            let speeds: Vec<f64> =
                self.rotors.speed_radps().iter().zip(parts).map(|(speed, part)| speed * f64::sqrt(part)).collect();
            let wrench = self.airframe.wrench(&[speeds[0], speeds[1], speeds[2], speeds[3]]);
            let inertia = self.airframe.inertia_kgm2;
            self.rates += (wrench.torque_flu_nm + self.torque).component_div(&inertia) * DT_S;
            self.tilt += self.rates * DT_S;
            let mut noise = |size: f64| size * (self.rng.random::<f64>() - 0.5);
            let seen = Seen {
                airframe: &self.airframe,
                rates_radps: self.rates + Vector3::new(noise(0.02), noise(0.02), noise(0.01)),
                force_mps2: (wrench.thrust_n + self.force_n) / self.airframe.mass_kg + noise(0.5 + self.shaken_mps2),
                applied: &self.applied,
                voltage_ratio: 1.0,
                free,
                strings: self.strings,
                dt_s: DT_S,
            };
            let found = self.watch.step(&seen);
            first = first.or_else(|| found.map(|found| (tick as f64 * DT_S, found)));
            let mut mixer = crate::mix::Mixer::new(&self.airframe, f64::INFINITY).unwrap();
            mixer.weaken(self.watch.effectiveness());
            let torque = (self.tilt * -60.0 - self.rates * 12.0).component_mul(&inertia);
            let asked = crate::types::Wrench { thrust_n: self.airframe.weight_n(), torque_flu_nm: torque };
            self.applied = mixer.mix(&asked).command;
        }
        first
    }
}

#[test]
fn a_loss_is_isolated_estimated_and_its_end_is_seen() {
    for rotor in 0..ROTORS {
        for (loss, strings) in [(0.2, false), (0.2, true), (0.5, false), (0.5, true)] {
            let mut hover = Hover::new(rotor as u64);
            hover.strings = strings;
            assert_eq!(hover.fly(5.0, [1.0; ROTORS], true), None, "nothing is lost yet");
            let mut parts = [1.0; ROTORS];
            parts[rotor] -= loss;
            let (after_s, found) = hover.fly(2.0, parts, true).unwrap();
            assert!(after_s < 0.3 && found == Found::Weak(rotor), "rotor {rotor}, {loss}: {found:?} after {after_s} s");
            let told = hover.watch.effectiveness()[rotor];
            assert!((told - parts[rotor]).abs() < 0.03, "rotor {rotor}: {told}, gives {}", parts[rotor]);
            let (_, found) = hover.fly(4.0, [1.0; ROTORS], true).unwrap();
            assert_eq!((found, *hover.watch.effectiveness()), (Found::Healthy(rotor), [1.0; ROTORS]));
        }
    }
}

#[test]
fn what_is_no_loss_is_not_taken_for_one() {
    let pushes = [
        (Vector3::new(0.3, 0.0, 0.0), 0.0),
        (Vector3::new(0.0, -0.3, 0.0), 0.0),
        (Vector3::new(0.3, 0.2, 0.0), 0.0),
        // A string at one arm: what it lifts and turns is that of a rotor that gives more on the other side.
        (Vector3::new(0.2, -0.12, 0.0), 0.9),
        (Vector3::zeros(), -2.0),
    ];
    for (torque, force_n) in pushes {
        let mut hover = Hover::new(9);
        hover.fly(5.0, [1.0; ROTORS], true);
        (hover.torque, hover.force_n) = (torque, force_n);
        assert_eq!(hover.fly(3.0, [1.0; ROTORS], true), None, "{torque:?} N m, {force_n} N");
    }
}

/// GIVEN a rotor that loses a fifth WHEN something takes up the thrust that misses THEN on strings its torque about z tells it, and where there
/// are none, or without that torque, it is somebody's push.
#[test]
fn a_loss_that_strings_take_up_is_told_by_its_torque_about_z() {
    for rotor in 0..ROTORS {
        let found = |strings: bool, yaws: bool| {
            let mut hover = Hover::new(20 + rotor as u64);
            hover.strings = strings;
            hover.fly(5.0, [1.0; ROTORS], true);
            let lost_n = 0.2 * hover.airframe.weight_n() / ROTORS as f64;
            let column = hover.airframe.allocation().column(rotor).into_owned();
            hover.force_n = lost_n;
            hover.torque.z = if yaws { 0.0 } else { lost_n * column[3] };
            let mut parts = [1.0; ROTORS];
            parts[rotor] = 0.8;
            hover.fly(2.0, parts, true)
        };
        let told = found(true, true);
        assert!(told.is_some_and(|(after_s, found)| after_s < 0.5 && found == Found::Weak(rotor)), "{rotor}: {told:?}");
        assert_eq!((found(false, true), found(true, false)), (None, None), "rotor {rotor}");
    }
}

#[test]
fn a_vehicle_that_is_held_is_not_judged_and_a_sensor_that_is_no_number_leaves_no_trace() {
    let mut hover = Hover::new(3);
    hover.fly(5.0, [1.0; ROTORS], false);
    assert!(!hover.watch.watches());
    assert_eq!(hover.fly(1.0, [0.5, 1.0, 1.0, 1.0], false), None);
    let mut hover = Hover::new(4);
    hover.fly(5.0, [1.0; ROTORS], true);
    let rates = hover.rates;
    hover.rates = Vector3::repeat(f64::NAN);
    hover.fly(DT_S, [1.0; ROTORS], true);
    (hover.rates, hover.tilt) = (rates, Vector3::zeros());
    hover.applied = MotorCommand { throttle: [hover.airframe.hover_command(); ROTORS] };
    assert_eq!(hover.fly(3.0, [1.0; ROTORS], true), None);
    assert!(hover.watch.watches());
}

/// GIVEN a vehicle that a string held for a moment WHEN a rotor weakens half a second later THEN it is isolated as ever.
#[test]
fn what_was_learned_outlives_a_taut_string() {
    let mut hover = Hover::new(5);
    hover.fly(5.0, [1.0; ROTORS], true);
    hover.force_n = 0.2 * hover.airframe.weight_n();
    assert_eq!(hover.fly(0.5, [1.0; ROTORS], true), None);
    assert!(hover.watch.held_s > 0.0);
    hover.force_n = 0.0;
    assert_eq!(hover.fly(0.6, [1.0; ROTORS], true), None);
    let (after_s, found) = hover.fly(2.0, [1.0, 0.8, 1.0, 1.0], true).unwrap();
    assert!(after_s < 0.3 && found == Found::Weak(1), "{found:?} after {after_s} s");
}

/// GIVEN a vehicle whose accelerometers vibrate WHEN a string becomes taut for a fifth of a second THEN no rotor is taken for weak, as one
/// would be were it not known to hang on strings.
#[test]
fn a_string_that_jerks_is_no_rotor_where_the_thrust_vibrates() {
    let is_taken = |strings: bool, seed: u64| {
        let mut hover = Hover::new(seed);
        (hover.strings, hover.shaken_mps2) = (strings, 30.0);
        assert_eq!(hover.fly(5.0, [1.0; ROTORS], true), None, "{seed}");
        (hover.torque, hover.force_n) = (Vector3::new(0.3, -0.2, 0.0), 2.0);
        let jerk = hover.fly(0.2, [1.0; ROTORS], true);
        (hover.torque, hover.force_n) = (Vector3::zeros(), 0.0);
        jerk.or(hover.fly(0.5, [1.0; ROTORS], true)).is_some()
    };
    let [without, with] = [false, true].map(|strings| (0..40).filter(|seed| is_taken(strings, *seed)).count());
    assert!(without > 0 && with == 0, "{without} {with}");
}
