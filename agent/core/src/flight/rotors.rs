//! Does every rotor give the thrust that its command should? Found from gyroscopes and accelerometers alone: no speed of a
//! motor is measured.
//!
//! r = (ω̇ − J⁻¹(Σ eᵢtᵢcᵢ − ω × Jω), f_z − Σ eᵢtᵢ/m), both through 1/(T s + 1): torque and thrust innovation. The first needs
//! no derivative: ż = J⁻¹(…) + r, r = (ω − z)/T. A rotor that gives the part ε in place of e moves r by (ε − e) sᵢ, its
//! *signature* sᵢ = tᵢ (J⁻¹cᵢ, 1/m) through the same lag; at hover a loss ℓ is Δω̇ = mgℓL/(4J), Δf_z = gℓ/4.
//!
//! What lasts since the flight began (centre of mass, mass, thrust curves) is the mean b, learned, as is the variance R.
//! For each rotor a CUSUM (Page 1954) of the log-likelihood ratio of a loss ℓ₀ against none, g ← max(0, g + ℓ₀ sᵀR⁻¹(b − r) −
//! ½ ℓ₀² sᵀR⁻¹s) per 2T, that being how long r stays alike. Above its limit the loss is estimated from where the sum
//! began, ℓ = Σ sᵀR⁻¹(b − r) / Σ sᵀR⁻¹s, and the rotor is isolated when its signature explains what is seen, better than that of any
//! other, and the thrust misses what the torque says, or, on strings, which may take it up, the torque about z does. From then on its e
//! follows r, back to 1 where the fault ends.
//!
//! | symbol | meaning | unit |
//! |---|---|---|
//! | tᵢ | thrust of a healthy rotor by the applied commands, through motor lag and battery | N |
//! | cᵢ | torque of rotor i per thrust, body FLU | m |
//! | ω, f_z | body rates and specific force along body z, median of all IMUs | rad/s, m/s² |
//!
//! Nothing is looked for where something else holds the vehicle up, near where it took off, and before r was quiet for
//! two seconds. A loss that comes slower than b is learned is not found, nor one that was there at take-off.

use nalgebra::{Vector3, Vector4};

use super::{Failsafe, Flight, Phase, RigKind};
use crate::event::{EventKind, Severity, text};
use crate::model::airframe::Airframe;
use crate::model::motor::Rotors;
use crate::supervisor::monitor::DESCENDS;
use crate::supervisor::severity;
use crate::types::{GRAVITY_MPS2, MotorCommand, ROTORS};

/// T, s: shorter, aliased vibration is most of r.
const LAG_S: f64 = 0.05;
/// Filters and transport of gyroscopes, and that of commands, s.
const SENSING_S: f64 = 0.012;
/// The mean follows with this time constant, s …
const MEAN_S: f64 = 4.0;
/// … and is one after so long, s.
const LEARNED_S: f64 = 2.0;
/// Least sigma of r: what the model leaves out in a calm flight, rad/s² and m/s².
pub const SIGMA: Vector4<f64> = Vector4::new(0.5, 0.5, 0.3, 0.2);
/// ℓ₀.
pub const LOSS: f64 = 0.1;
/// Limit of the sums: none of 120 drawn clean flights of a minute in `datasheet` passed it, nor with half the ℓ₀.
pub const LIMIT: f64 = 20.0;
/// Above this part of it nothing is learned.
const DOUBT: f64 = 0.25;
/// A sum grows by so much at most in 2T.
const GROWTH: f64 = 40.0;
/// The next best rotor is this much less likely, as a logarithm.
const ODDS: f64 = 5.0;
/// So much may be left unexplained, of what is explained.
const UNEXPLAINED: f64 = 0.5;
/// The thrust misses at least so much of what the torque says, and what the torque about z says is no further from it, …
const MISSING: f64 = 0.4;
/// … and so many sigmas more: a push at one arm has its torque, and no less thrust.
const MISSING_SIGMAS: f64 = 0.25;
/// Strings push so as they become taut: there the thrust must have told the loss to so many sigmas, squared, which takes a while where it
/// vibrates.
const TOLD: f64 = 2.0;
/// … or its torque about z, where strings take up the thrust that misses: to so many sigmas, squared, and as the rest of its torque, of which
/// so much may be left unexplained.
const TOLD_BY_YAW: f64 = 9.0;
const UNEXPLAINED_BY_YAW: f64 = 0.05;
/// Smallest loss that is told.
const LEAST_LOSS: f64 = 0.04;
/// The estimate of an isolated rotor follows with this time constant, s.
const FOLLOW_S: f64 = 0.2;
/// From here on, for so long (s), a rotor counts as healthy again.
const HEALTHY: f64 = 0.97;
const HEALTHY_S: f64 = 1.0;
/// Held up by more than this, of g, on a mean of so many seconds, something else than rotors carries it.
const HELD: f64 = 0.08;
const HELD_S: f64 = 0.25;
/// So long after that nothing is summed up, s; what was learned before stays.
const RELEASED_S: f64 = 0.1;
/// Rotors that carry less than this part of the weight say little, and something else may carry the rest.
const CARRIES: f64 = 0.75;
/// Thrust that each rotor must be able to give to fly on, of a quarter of the weight …
const FLIES: f64 = 1.15;
/// … and to come down on. Between, the vehicle sinks level.
const SINKS: f64 = 0.75;
/// An estimate this old is good enough to cut on, s.
const SETTLED_S: f64 = 0.1;

/// What speaks for a loss of one rotor since its sum began.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
struct Evidence {
    sum: f64,
    /// Σ sᵀR⁻¹s, Σ sᵀR⁻¹(b − r), Σ (b − r)ᵀR⁻¹(b − r), and the first two of the thrust alone, and of the torque about z.
    ss: f64,
    sr: f64,
    rr: f64,
    thrust: (f64, f64),
    yaw: (f64, f64),
    /// Of its signature since then, N.
    lagged_n: f64,
    /// How many 2T.
    lasts: f64,
}

impl Evidence {
    /// Twice the logarithm of how much likelier the estimated loss is than none.
    fn explained(&self) -> f64 {
        if self.ss > 0.0 { self.sr.max(0.0).powi(2) / self.ss } else { 0.0 }
    }

    fn loss(&self) -> f64 {
        if self.ss > 0.0 { self.sr / self.ss } else { 0.0 }
    }

    /// Do torque and thrust both look like it, or on `strings`, which may take up what misses, and where that about z
    /// is `calm`, all of the torque?
    fn fits(&self, strings: bool, calm: bool) -> bool {
        let (loss, explained) = (self.loss(), self.explained());
        let unexplained = self.rr - explained - 4.0 * self.lasts;
        let ((ss, sr), (zz, zr)) = (self.thrust, self.yaw);
        let missing = ss > 0.0 && sr / ss > MISSING * loss + MISSING_SIGMAS / ss.sqrt();
        let by_thrust = missing && (!strings || ss * loss.powi(2) > TOLD);
        // Strings that lift more than what misses became taut by themselves.
        let taken_up = sr > -MISSING * loss * ss && unexplained < UNEXPLAINED_BY_YAW * explained;
        let turns = zz * loss.powi(2) > TOLD_BY_YAW && (zr - loss * zz).abs() < MISSING * loss * zz;
        let by_yaw = strings && calm && taken_up && turns;
        loss > LEAST_LOSS && unexplained < UNEXPLAINED * explained && (by_thrust || by_yaw)
    }
}

/// A rotor that is isolated.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
struct Isolated {
    lasts_s: f64,
    healthy_s: f64,
}

/// Something to tell.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Found {
    /// A rotor, from 0, gives less.
    Weak(usize),
    /// It gives all of its thrust again.
    Healthy(usize),
}

/// The observer. Flat: each is a quantity of the module's description.
#[derive(Debug, Clone)]
pub struct RotorWatch {
    /// Angular acceleration FLU and specific force along z per thrust of each rotor.
    columns: [Vector4<f64>; ROTORS],
    inertia_kgm2: Vector3<f64>,
    rotors: Rotors,
    /// tᵢ as the sensors see it, and through T, N.
    thrust_n: [f64; ROTORS],
    lagged_n: [f64; ROTORS],
    /// z, rad/s.
    predicted_radps: Option<Vector3<f64>>,
    innovation: Vector4<f64>,
    /// Thrust innovation, slower, and for how long something still counts as holding the vehicle, s.
    held_mps2: f64,
    held_s: f64,
    mean: Vector4<f64>,
    variance: Vector4<f64>,
    learned_s: f64,
    evidence: [Evidence; ROTORS],
    effectiveness: [f64; ROTORS],
    isolated: [Option<Isolated>; ROTORS],
}

/// What it looks at in a tick.
#[derive(Debug, Clone, Copy)]
pub(super) struct Seen<'a> {
    pub airframe: &'a Airframe,
    pub rates_radps: Vector3<f64>,
    /// Specific force along body z, m/s².
    pub force_mps2: f64,
    pub applied: &'a MotorCommand,
    pub voltage_ratio: f64,
    /// In the air, away from where it took off.
    pub free: bool,
    /// Are there strings that may hold it?
    pub strings: bool,
    pub dt_s: f64,
}

impl RotorWatch {
    /// Of `airframe`.
    pub fn new(airframe: &Airframe) -> Self {
        let allocation = airframe.allocation();
        let inertia = airframe.inertia_kgm2;
        let per = Vector4::new(inertia.x, inertia.y, inertia.z, airframe.mass_kg);
        let column = |i: usize| {
            let c = allocation.column(i);
            Vector4::new(c[1], c[2], c[3], c[0]).component_div(&per)
        };
        Self {
            columns: std::array::from_fn(column),
            inertia_kgm2: inertia,
            rotors: Rotors::default(),
            thrust_n: [0.0; ROTORS],
            lagged_n: [0.0; ROTORS],
            predicted_radps: None,
            innovation: Vector4::zeros(),
            held_mps2: 0.0,
            held_s: 0.0,
            mean: Vector4::zeros(),
            variance: Vector4::zeros(),
            learned_s: 0.0,
            evidence: [Evidence::default(); ROTORS],
            effectiveness: [1.0; ROTORS],
            isolated: [None; ROTORS],
        }
    }

    /// Part of the thrust that each rotor gives, 1 where nothing is isolated.
    pub fn effectiveness(&self) -> &[f64; ROTORS] {
        &self.effectiveness
    }

    /// Would a fault be found now?
    pub fn watches(&self) -> bool {
        self.learned_s >= LEARNED_S
    }

    /// Sigma of torque (rad/s², FLU) and thrust (m/s²) innovation, as used.
    pub fn sigma(&self) -> Vector4<f64> {
        self.variance.zip_map(&SIGMA, |variance, least| variance.max(least * least).sqrt())
    }

    /// Is any rotor isolated?
    fn any_isolated(&self) -> bool {
        self.isolated.iter().any(Option::is_some)
    }

    /// Takes a tick.
    pub(super) fn step(&mut self, seen: &Seen<'_>) -> Option<Found> {
        self.innovate(seen);
        if !seen.free || !self.innovation.iter().all(|r| r.is_finite()) {
            self.begin();
            return None;
        }
        self.held_mps2 += (self.innovation.w - self.held_mps2) * (seen.dt_s / (HELD_S + seen.dt_s));
        if self.held_mps2 > HELD * GRAVITY_MPS2 && !self.any_isolated() {
            self.held_s = RELEASED_S;
        }
        if self.held_s > 0.0 {
            self.held_s -= seen.dt_s;
            // What lasts since the flight began is no other for a string that was taut.
            if self.watches() {
                self.evidence = Default::default()
            } else {
                self.begin()
            }
            return None;
        }
        let deviation = self.mean - self.innovation;
        self.learn(seen.dt_s, &deviation);
        if !self.watches() {
            return None;
        }
        self.sum_up(seen.dt_s, &deviation);
        self.isolate(seen.strings).or_else(|| self.follow(seen.dt_s, &deviation))
    }

    /// Forgets what was summed up, and what was learned where nothing is isolated: what comes next is something else.
    fn begin(&mut self) {
        self.evidence = [Evidence::default(); ROTORS];
        if !self.any_isolated() {
            (self.learned_s, self.mean, self.variance) = (0.0, Vector4::zeros(), Vector4::zeros());
        }
    }

    /// Torque and thrust innovation.
    fn innovate(&mut self, seen: &Seen<'_>) {
        let (airframe, dt_s, rates) = (seen.airframe, seen.dt_s, seen.rates_radps);
        self.rotors.step(airframe, &seen.applied.throttle, seen.voltage_ratio, dt_s);
        let gain = (dt_s / LAG_S).min(0.5);
        let mut predicted = Vector4::zeros();
        for (i, speed) in self.rotors.speed_radps().iter().enumerate() {
            let now_n = airframe.thrust_coefficient_ns2 * speed * speed;
            self.thrust_n[i] += (now_n - self.thrust_n[i]) * (dt_s / (SENSING_S + dt_s));
            self.lagged_n[i] += (self.thrust_n[i] - self.lagged_n[i]) * gain;
            predicted += self.columns[i] * (self.effectiveness[i] * self.thrust_n[i]);
        }
        let spinning = rates.cross(&self.inertia_kgm2.component_mul(&rates)).component_div(&self.inertia_kgm2);
        let torque = predicted.xyz() - spinning;
        let before = self.predicted_radps.filter(|z| z.iter().all(|z| z.is_finite())).unwrap_or(rates);
        let moved = before + (torque + self.innovation.xyz()) * dt_s;
        let turning = (rates - moved) * (gain / dt_s);
        let lifting = self.innovation.w + (seen.force_mps2 - predicted.w - self.innovation.w) * gain;
        self.predicted_radps = Some(moved);
        self.innovation = Vector4::new(turning.x, turning.y, turning.z, lifting);
        if !self.innovation.iter().all(|r| r.is_finite()) {
            (self.predicted_radps, self.innovation, self.held_mps2) = (None, Vector4::zeros(), 0.0);
        }
    }

    fn learn(&mut self, dt_s: f64, deviation: &Vector4<f64>) {
        let doubtful = self.evidence.iter().any(|e| e.sum > DOUBT * LIMIT);
        if self.any_isolated() || (doubtful && self.watches()) {
            return;
        }
        self.learned_s += dt_s;
        let share = dt_s / self.learned_s.min(MEAN_S);
        self.mean -= deviation * share;
        self.variance += (deviation.component_mul(deviation) - self.variance) * share;
    }

    fn sum_up(&mut self, dt_s: f64, deviation: &Vector4<f64>) {
        let lift_mps2: f64 = self.columns.iter().zip(self.lagged_n).map(|(column, n)| column.w * n).sum();
        if lift_mps2 < CARRIES * GRAVITY_MPS2 {
            self.evidence = [Evidence::default(); ROTORS];
            return;
        }
        let sigma = self.sigma();
        let r = deviation.component_div(&sigma);
        let part = dt_s / (2.0 * LAG_S);
        for (i, e) in self.evidence.iter_mut().enumerate() {
            let column = self.columns[i].component_div(&sigma);
            let s = column * self.lagged_n[i];
            let grows = (LOSS * s.dot(&r) - 0.5 * LOSS * LOSS * s.norm_squared()).min(GROWTH);
            let sum = e.sum + part * grows;
            if sum <= 0.0 || self.isolated[i].is_some() {
                *e = Evidence::default();
                continue;
            }
            e.sum = sum.min(10.0 * LIMIT);
            e.lagged_n += (self.thrust_n[i] - e.lagged_n) * (dt_s / LAG_S).min(0.5);
            let s = column * e.lagged_n;
            e.ss += part * s.norm_squared();
            e.sr += part * s.dot(&r);
            e.rr += part * r.norm_squared();
            e.thrust.0 += part * s.w * s.w;
            e.thrust.1 += part * s.w * r.w;
            e.yaw.0 += part * s.z * s.z;
            e.yaw.1 += part * s.z * r.z;
            e.lasts += part;
        }
    }

    /// The rotor whose loss is beyond doubt.
    fn isolate(&mut self, strings: bool) -> Option<Found> {
        let above = |e: &Evidence| e.sum > LIMIT && e.explained() > 2.0 * LIMIT;
        let (i, best) = self.evidence.iter().enumerate().filter(|(_, e)| above(e)).max_by(|a, b| {
            let (a, b) = (a.1.explained(), b.1.explained());
            a.total_cmp(&b)
        })?;
        let calm = self.variance.z <= SIGMA.z * SIGMA.z;
        let others = self.evidence.iter().enumerate().filter(|(j, _)| *j != i);
        let next = others.map(|(_, e)| e.explained()).fold(0.0, f64::max);
        if best.explained() < next + 2.0 * ODDS || !best.fits(strings, calm) {
            return None;
        }
        let loss = best.loss().min(self.effectiveness[i]);
        // As if it had been known from the beginning of the sum on.
        let known = self.columns[i] * (loss * best.lagged_n);
        self.innovation += known;
        self.predicted_radps = self.predicted_radps.map(|z| z - known.xyz() * LAG_S);
        self.effectiveness[i] -= loss;
        self.isolated[i] = Some(Isolated::default());
        self.evidence = [Evidence::default(); ROTORS];
        Some(Found::Weak(i))
    }

    /// What isolated rotors give now.
    fn follow(&mut self, dt_s: f64, deviation: &Vector4<f64>) -> Option<Found> {
        let sigma = self.sigma();
        let r = deviation.component_div(&sigma);
        let mut found = None;
        for (i, isolated) in self.isolated.iter_mut().enumerate() {
            let Some(state) = isolated else { continue };
            let s = self.columns[i].component_div(&sigma) * self.lagged_n[i];
            let less = if s.norm_squared() > 1.0 { s.dot(&r) / s.norm_squared() } else { 0.0 };
            self.effectiveness[i] = (self.effectiveness[i] - less * (dt_s / FOLLOW_S).min(0.5)).clamp(0.0, 1.0);
            state.lasts_s += dt_s;
            state.healthy_s = if self.effectiveness[i] > HEALTHY { state.healthy_s + dt_s } else { 0.0 };
            if state.healthy_s > HEALTHY_S {
                (*isolated, self.effectiveness[i]) = (None, 1.0);
                found = Some(Found::Healthy(i));
            }
        }
        found
    }

    /// The weakest of the isolated rotors whose estimate has settled, and its part.
    fn weakest(&self) -> Option<(usize, f64)> {
        let settled = self.isolated.iter().map(|isolated| isolated.is_some_and(|i| i.lasts_s >= SETTLED_S));
        let each = settled.zip(self.effectiveness).enumerate().filter(|(_, (settled, _))| *settled);
        each.map(|(i, (_, part))| (i, part)).min_by(|a, b| a.1.total_cmp(&b.1))
    }
}

/// Information on the effectiveness of `rotor` (from 0) of a hovering `airframe` in a second of innovations of these sigmas
/// (rad/s² FLU, m/s²): sᵀR⁻¹s / 2T.
pub fn information(airframe: &Airframe, rotor: usize, sigma: &[f64; 4]) -> f64 {
    let columns = RotorWatch::new(airframe).columns;
    let hover_n = airframe.weight_n() / ROTORS as f64;
    let column = columns.get(rotor).map_or_else(Vector4::zeros, |column| column.component_div(&Vector4::from(*sigma)));
    (column * hover_n).norm_squared() / (2.0 * LAG_S)
}

impl Flight {
    /// Looks after the rotors, makes up for one that is weak, and ends a flight that cannot go on.
    pub(super) fn watch_rotors(&mut self, voltage_ratio: f64, dt_s: f64) {
        let flying = self.phase == Phase::Flying;
        // A taut tether pulls down and turns, as a rotor does that gives less.
        let apart = self.config.rig.can_lift() && !matches!(self.config.rig, RigKind::Tethered { .. });
        let free = flying && apart && !self.at_takeoff_height();
        let watchdog = &self.supervision.watchdog;
        let seen = Seen {
            airframe: &self.config.airframe,
            rates_radps: watchdog.rates_radps(),
            force_mps2: watchdog.force_mps2().z,
            applied: &self.report.applied,
            voltage_ratio,
            free,
            strings: matches!(self.config.rig, RigKind::StringsFlight { .. }),
            dt_s,
        };
        if let Some(found) = self.rotors.step(&seen) {
            self.tell_rotor(found);
        }
        if self.rotors.any_isolated() || self.rotors_made_up {
            self.mixer.weaken(self.rotors.effectiveness());
            self.rotors_made_up = self.rotors.any_isolated();
        }
        let Some((i, part)) = self.rotors.weakest().filter(|_| flying) else { return };
        let share = part * self.mixer.range_n().1 * ROTORS as f64 / self.config.airframe.weight_n();
        let (rotor, percent) = (i + 1, 100.0 * part);
        let most = 100.0 * share;
        if share < SINKS {
            let reason = text(format_args!(
                "rotor {rotor} gives {percent:.0} % of its thrust, at most {most:.0} % of what hovers: motors cut"
            ));
            self.act(Failsafe::RotorCut, reason);
        } else if share < FLIES && severity(self.supervision.failsafe) < DESCENDS {
            let reason = text(format_args!(
                "rotor {rotor} gives {percent:.0} % of its thrust, at most {most:.0} % of what hovers: descending"
            ));
            self.act(Failsafe::RotorDescend, reason);
        }
    }

    fn tell_rotor(&mut self, found: Found) {
        let (severity, line) = match found {
            Found::Weak(i) => {
                let part = self.rotors.effectiveness.get(i).copied().unwrap_or(f64::NAN);
                let line = text(format_args!("rotor {} gives {:.0} % of its thrust: made up for", i + 1, 100.0 * part));
                (Severity::Critical, line)
            }
            Found::Healthy(i) => (Severity::Info, text(format_args!("rotor {} gives all of its thrust again", i + 1))),
        };
        self.event(severity, EventKind::Warning, line);
    }
}

#[cfg(test)]
mod tests;
