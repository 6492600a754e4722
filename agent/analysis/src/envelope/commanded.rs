//! Attacks that may reach the rotors as well as sensors, and what nobody healthy sees of them.
//!
//! | state | meaning | unit |
//! |---|---|---|
//! | z, v | altitude and climb | m, m/s |
//! | T | what the rotors give, behind the motors' lag, per mass | m/s² |
//! | w | a force that nobody commands and nothing else tells: wind, mass | m/s² |
//! | bᵢ | bias of accelerometer i, which the lanes find | m/s² |
//!
//! ż = v, v̇ = −kv + T + w, Ṫ = (d − T)/τ, ẇ = ḃᵢ = 0; a height reads z, accelerometer i reads v̇ + bᵢ. d is what is added to the thrust of all
//! rotors alike. An attacked sensor is told what it would read without the attack, so estimator, law and commands are those of that flight
//! while the healthy sensors read what they would too. From d and the first state to healthy samples no gain has a say in the
//! zeros: they are invariant under output injection, which estimator and law are \[Teixeira et al. 2015, IV\].
//!
//! Samples come at times of their own: the system is that of one period of the healthy heights, of tick after tick for accelerometers
//! (lifted), the thrust held between two samples of a height. One period begins with a sample of the first healthy height.

use nalgebra::{DMatrix, DVector, RowDVector, SymmetricEigen};
use plumbline_core::estimate::lanes::linear::SLOT;
use plumbline_core::model::airframe::Airframe;
use plumbline_core::model::discretize::zero_order_hold;
use plumbline_core::model::linearize::{hover, ix};
use plumbline_core::model::state_space::StateSpace;
use plumbline_core::model::zeros::{Nulling, ZeroDynamics, nulling};
use plumbline_proto::ids::SensorId;
use plumbline_proto::v1::SensorKind;

use super::EnvelopeError;
use super::flying::{Loop, repeating};

/// Places of the states.
const Z: usize = 0;
const V: usize = 1;
const T: usize = 2;
const W: usize = 3;
/// How much is too much of each state at the onset, where it would be a step: m, m/s, m/s², m/s²; of a bias as of z.
const STEP: [f64; 4] = [1e-3, 1e-2, 1.0, 1.0];
/// From its onset to its end an attack grows by no more: before, it is nothing.
const GROWTH: f64 = 1e12;
/// What is left of an attack that dies away.
const DIES: f64 = 0.5;
/// A direction that moves the altitude by less than this part of its size moves nothing.
const STILL: f64 = 1e-9;

/// The altitude, and who is attacked.
#[derive(Debug, Clone)]
pub(super) struct Commanded {
    /// Of a tick: A, and B of d.
    a: DMatrix<f64>,
    b: DVector<f64>,
    /// v̇ of the states.
    force: RowDVector<f64>,
    drag_per_s: f64,
    lag_s: f64,
    pub(super) tick_s: f64,
    /// Heights: number, rate, Hz, time of the first sample, s, attacked?
    heights: Vec<(SensorId, f64, f64, bool)>,
    /// IMUs, attacked?
    imus: Vec<(SensorId, bool)>,
    rotors: bool,
}

/// What an attack does, tick after tick from its onset on.
#[derive(Debug, Clone, Default)]
pub(super) struct Course {
    /// Added to the thrust, m/s².
    pub(super) thrust_mps2: Vec<f64>,
    /// Added to each sensor attacked, m and m/s².
    pub(super) added: Vec<(SensorId, Vec<f64>)>,
    /// What the thrust alone makes of the altitude, m, …
    pub(super) altitude_m: Vec<f64>,
    /// … and of the specific force, m/s².
    pub(super) force_mps2: Vec<f64>,
}

impl Course {
    /// The same, `part` times as large.
    pub(super) fn times(mut self, part: f64) -> Self {
        let each = self.added.iter_mut().map(|(_, values)| values);
        let own = [&mut self.thrust_mps2, &mut self.altitude_m, &mut self.force_mps2];
        each.chain(own).flatten().for_each(|value| *value *= part);
        self
    }

    /// What comes of `sensor` in the place of what it would read, m or m/s².
    pub(super) fn received(&self, sensor: SensorId) -> Vec<f64> {
        let moved = if sensor.kind == SensorKind::Imu { &self.force_mps2 } else { &self.altitude_m };
        let added = self.added.iter().find(|(of, _)| *of == sensor).map(|(_, values)| values);
        let of =
            |(i, moved): (usize, &f64)| moved + added.and_then(|values| values.get(i)).copied().unwrap_or_default();
        moved.iter().enumerate().map(of).collect()
    }

    /// The largest part of the thrust.
    pub(super) fn most_mps2(&self) -> f64 {
        self.thrust_mps2.iter().fold(0.0, |most, d| most.max(d.abs()))
    }
}

/// What there is of zero dynamics.
#[derive(Debug, Clone)]
pub(super) enum Found {
    /// An attack, of any size; the zeros it comes of.
    Attack(Course, String),
    /// None, and why not.
    None(String),
}

impl Commanded {
    /// The altitude of `airframe` with the sensors of `flying`; `set` of them and, with `rotors`, all rotors are attacked.
    pub(super) fn new(
        flying: &Loop,
        airframe: &Airframe,
        set: &[SensorId],
        rotors: bool,
        tick_s: f64,
    ) -> Result<Self, EnvelopeError> {
        let of = |kind: SensorKind| flying.sensors.iter().copied().filter(move |sensor| sensor.kind == kind);
        let imus: Vec<_> = of(SensorKind::Imu).map(|sensor| (sensor, set.contains(&sensor))).collect();
        let timed = |sensor: SensorId| {
            let (rate_hz, phase_s) = flying.timing.get(usize::from(sensor.instance) - 1).copied().flatten()?;
            Some((sensor, rate_hz, phase_s, set.contains(&sensor)))
        };
        let heights = of(SensorKind::Height).filter_map(timed).collect();
        let n = W + 1 + imus.len();
        let drag_per_s = -hover(airframe).a[(ix::VZ, ix::VZ)];
        let lag_s = 0.5 * (airframe.motor_rise_time_constant_s + airframe.motor_fall_time_constant_s);
        let (mut a, mut b) = (DMatrix::zeros(n, n), DMatrix::zeros(n, 1));
        a[(Z, V)] = 1.0;
        (a[(V, V)], a[(V, T)], a[(V, W)]) = (-drag_per_s, 1.0, 1.0);
        (a[(T, T)], b[(T, 0)]) = (-1.0 / lag_s, 1.0 / lag_s);
        let force = a.row(V).into_owned();
        let held = zero_order_hold(&a, &b, tick_s)?;
        Ok(Self {
            a: held.a,
            b: held.b.column(0).into_owned(),
            force,
            drag_per_s,
            lag_s,
            tick_s,
            heights,
            imus,
            rotors,
        })
    }

    /// Ticks of one period of the healthy heights, of a held thrust, and from a period of the flight to where one begins here.
    fn period(&self) -> Result<(usize, usize, f64), EnvelopeError> {
        let healthy = || self.heights.iter().filter(|(.., attacked)| !attacked);
        let Some((_, _, phase_s, _)) = healthy().next() else {
            let slot = (SLOT / self.tick_s).round() as usize;
            return Ok((slot, slot, 0.0));
        };
        let whole =
            (repeating(healthy().map(|(_, rate_hz, ..)| *rate_hz))? as f64 * SLOT / self.tick_s).round() as usize;
        let samples = |ticks: usize, rate_hz: f64| ticks as f64 * self.tick_s * rate_hz;
        let repeats = |ticks: &usize| {
            healthy().all(|(_, rate_hz, ..)| {
                let samples = samples(*ticks, *rate_hz);
                samples > 0.5 && (samples - samples.round()).abs() < 1e-6
            })
        };
        let period = (1..=whole).find(repeats).unwrap_or(whole);
        let fastest_hz = healthy().map(|(_, rate_hz, ..)| *rate_hz).fold(0.0, f64::max);
        let holds = samples(period, fastest_hz).round().max(1.0) as usize;
        let hold = if period.is_multiple_of(holds) { period / holds } else { period };
        Ok((period, hold, *phase_s))
    }

    /// One period as a sampled system: from the state at its beginning and each held thrust to what healthy sensors read in it.
    /// Also the altitude at each tick, from both.
    fn lifted(&self, period: usize, hold: usize, begins_s: f64) -> (StateSpace, DMatrix<f64>) {
        let n = self.a.nrows();
        let m = if self.rotors { period / hold } else { 0 };
        let mut x = DMatrix::identity(n, n + m);
        let (mut rows, mut altitudes) = (Vec::new(), DMatrix::zeros(period, n + m));
        for tick in 0..period {
            altitudes.row_mut(tick).copy_from(&x.row(Z));
            let time_s = begins_s + tick as f64 * self.tick_s;
            for (_, rate_hz, phase_s, _) in self.heights.iter().filter(|(.., attacked)| !attacked) {
                let samples = (time_s - phase_s) * rate_hz;
                // Half a tick: samples fall between ticks too.
                if (samples - samples.round()).abs() < 0.5 * self.tick_s * rate_hz - 1e-9 {
                    rows.push(x.row(Z).into_owned());
                }
            }
            let force = &self.force * &x;
            for (i, _) in self.imus.iter().enumerate().filter(|(_, (_, attacked))| !attacked) {
                rows.push(&force + x.row(W + 1 + i));
            }
            x = &self.a * x;
            if self.rotors {
                let mut held = x.column_mut(n + tick / hold);
                held += &self.b;
            }
        }
        let outputs = DMatrix::from_fn(rows.len(), n + m, |row, column| rows[row][column]);
        let split = |of: &DMatrix<f64>| (of.columns(0, n).into_owned(), of.columns(n, m).into_owned());
        let ((a, b), (c, d)) = (split(&x), split(&outputs));
        (StateSpace { a, b, c, d }, altitudes)
    }

    /// The zero dynamics from rotors to healthy samples, and the attack along that which moves the altitude most at the end of `horizon_s`,
    /// of any size.
    ///
    /// # Errors
    /// [`EnvelopeError`].
    pub(super) fn zero_dynamics(&self, horizon_s: f64) -> Result<Found, EnvelopeError> {
        let (period, hold, begins_s) = self.period()?;
        let (system, altitudes) = self.lifted(period, hold, begins_s);
        let of = match nulling(&system)? {
            Nulling::Dynamics(of) => of,
            Nulling::Free(_) => {
                let why =
                    "whatever is added to the thrust, no healthy sensor is left to see it: that is a covert attack";
                return Ok(Found::None(why.to_owned()));
            }
        };
        if of.zeros.is_empty() {
            let why = "from the rotors and the first state to what healthy sensors read there is no zero";
            return Ok(Found::None(why.to_owned()));
        }
        let period_s = period as f64 * self.tick_s;
        let zeros = told(&of, period_s);
        let periods = (horizon_s / period_s + 1e-9).floor() as usize;
        let largest = of.zeros.iter().map(|zero| zero.norm()).fold(0.0, f64::max);
        let longest = if largest > 1.0 { (GROWTH.ln() / largest.ln()).max(1.0) as usize } else { usize::MAX };
        let periods = periods.clamp(1, longest);
        let moves = altitudes.columns(0, system.a.nrows()) * &of.basis
            + altitudes.columns(system.a.nrows(), system.b.ncols()) * &of.input;
        let Some(weighed) = weighed(&of) else { return Ok(Found::None(format!("{zeros}: none moves anything"))) };
        let furthest = |after: usize| {
            let moved = &moves * of.next.pow(after as u32) * &weighed;
            let found = SymmetricEigen::new(moved.tr_mul(&moved));
            let at = found.eigenvalues.imax();
            (found.eigenvalues[at].max(0.0).sqrt(), &weighed * found.eigenvectors.column(at))
        };
        let (first, _) = furthest(0);
        let (last, begin) = furthest(periods - 1);
        if first.max(last) < STILL {
            return Ok(Found::None(format!(
                "{zeros}: none of them moves the vehicle, a constant bias or force is learned"
            )));
        }
        if last < DIES * first {
            return Ok(Found::None(format!("{zeros}: within the unit circle, what is added along them dies away")));
        }
        Ok(Found::Attack(self.along(&of, begin, periods, (period, hold)), zeros))
    }

    /// The course along zero dynamics from ξ = `begin` on.
    fn along(&self, of: &ZeroDynamics, begin: DVector<f64>, periods: usize, (period, hold): (usize, usize)) -> Course {
        let mut held = Vec::new();
        let (mut xi, mut states) = (begin, Vec::new());
        for _ in 0..periods {
            states.push(&of.basis * &xi);
            held.extend((&of.input * &xi).iter().copied());
            xi = &of.next * xi;
        }
        let thrust = |tick: usize| held.get(tick / hold).copied().unwrap_or_default();
        let mut course = self.moved((0..periods * period).map(thrust));
        // What the dynamics themselves have the attacked sensors read, from their own first state.
        let mut read: Vec<(f64, DVector<f64>)> = Vec::new();
        for (number, state) in states.into_iter().enumerate() {
            let mut x = state;
            for tick in number * period..(number + 1) * period {
                read.push(((&self.force * &x)[0], x.clone()));
                x = &self.a * x + &self.b * thrust(tick);
            }
        }
        let heights = self.heights.iter().filter(|(.., attacked)| *attacked).map(|(sensor, ..)| (*sensor, None));
        let imus = self.imus.iter().enumerate().filter(|(_, (_, attacked))| *attacked);
        for (sensor, place) in heights.chain(imus.map(|(i, (sensor, _))| (*sensor, Some(W + 1 + i)))) {
            let of = |(force, x): &(f64, DVector<f64>)| -place.map_or(x[Z], |place| force + x[place]);
            course.added.push((sensor, read.iter().map(of).collect()));
        }
        course
    }

    /// What this thrust, tick after tick, makes of a vehicle at rest.
    fn moved(&self, thrust_mps2: impl Iterator<Item = f64>) -> Course {
        let (mut x, mut course) = (DVector::zeros(self.a.nrows()), Course::default());
        for d in thrust_mps2 {
            course.altitude_m.push(x[Z]);
            course.force_mps2.push((&self.force * &x)[0]);
            course.thrust_mps2.push(d);
            x = &self.a * x + &self.b * d;
        }
        course
    }

    /// A covert motion \[Smith 2011\]: the rotors are told to go up by a horizon's smooth step, with `accel_mps2` at most, and from what each
    /// attacked sensor reads the model's response to that is taken off.
    pub(super) fn covert(&self, accel_mps2: f64, horizon_s: f64) -> Course {
        // s = 10u³ − 15u⁴ + 6u⁵ begins and ends at rest; |s″| ≤ 10/√3.
        let size_m = accel_mps2 * horizon_s * horizon_s * 3.0_f64.sqrt() / 10.0;
        let thrust = |tick: usize| {
            // Held for a tick: its middle counts.
            let u = (tick as f64 + 0.5) * self.tick_s / horizon_s;
            let (v, a, j) = (
                (30.0 * u.powi(2) - 60.0 * u.powi(3) + 30.0 * u.powi(4)) * size_m / horizon_s,
                (60.0 * u - 180.0 * u.powi(2) + 120.0 * u.powi(3)) * size_m / horizon_s.powi(2),
                (60.0 - 360.0 * u + 360.0 * u.powi(2)) * size_m / horizon_s.powi(3),
            );
            let (k, lag_s) = (self.drag_per_s, self.lag_s);
            (a + k * v) + lag_s * (j + k * a)
        };
        let mut course = self.moved((0..(horizon_s / self.tick_s).round() as usize).map(thrust));
        let of = |moved: &[f64]| moved.iter().map(|moved| -moved).collect::<Vec<_>>();
        let (heights, imus) = (of(&course.altitude_m), of(&course.force_mps2));
        let attacked =
            self.heights.iter().filter(|(.., attacked)| *attacked).map(|(sensor, ..)| (*sensor, heights.clone()));
        course.added.extend(attacked);
        let attacked = self.imus.iter().filter(|(_, attacked)| *attacked).map(|(sensor, _)| (*sensor, imus.clone()));
        course.added.extend(attacked);
        course
    }

    /// Between two values of a thrust that is held, s, and the sensor whose samples it is held between.
    pub(super) fn held(&self) -> Result<(f64, Option<SensorId>), EnvelopeError> {
        let (_, hold, _) = self.period()?;
        let first = self.heights.iter().find(|(.., attacked)| !attacked).map(|(sensor, ..)| *sensor);
        Ok((hold as f64 * self.tick_s, first))
    }
}

/// ξ of each unit of a state that begins without a step: (VᵀS⁻²V)^(−½), S the steps that are too much.
fn weighed(of: &ZeroDynamics) -> Option<DMatrix<f64>> {
    let per = DVector::from_fn(of.basis.nrows(), |row, _| 1.0 / STEP.get(row).unwrap_or(&STEP[0]));
    let scaled = DMatrix::from_diagonal(&per) * &of.basis;
    let lower = scaled.tr_mul(&scaled).cholesky()?.l();
    lower.transpose().try_inverse()
}

/// "the zeros of 100 ms are −1.72, −0.05".
fn told(of: &ZeroDynamics, period_s: f64) -> String {
    let number = |x: f64| format!("{x:.2}").replace('-', "−");
    let mut each: Vec<(String, usize)> = Vec::new();
    for zero in of.zeros.iter().filter(|zero| zero.im >= -1e-3) {
        let text =
            if zero.im > 1e-3 { format!("{} ± {}i", number(zero.re), number(zero.im)) } else { number(zero.re) };
        match each.iter_mut().find(|(known, _)| *known == text) {
            Some((_, count)) => *count += 1,
            None => each.push((text, 1)),
        }
    }
    let each = each.into_iter().map(|(text, count)| if count > 1 { format!("{text} ({count} times)") } else { text });
    format!("zeros of a period of {:.0} ms: {}", 1e3 * period_s, each.collect::<Vec<_>>().join(", "))
}
