//! What a set of sensors can promise before it flies: observability, and how many attacks are correctable.
//!
//! The ten states of \[Clinic\] 3.1 (z, velocity, roll pitch yaw, body rates) about a trim point, in the heading
//! frame; one row for every scalar a sensor gives. Attacks on q sensors are correctable exactly when the
//! state stays observable without any 2q of them (Fawzi, Tabuada and Diggavi 2014, Prop. 2); equal rows are
//! indistinguishable, so whole groups of them are removed, and every combination of groups is tried.
//!
//! | symbol | meaning | shape |
//! |---|---|---|
//! | A, B | ẋ = A x + B u about the trim; u = thrust, torques | 10 × 10, 10 × 4 |
//! | c | row of one scalar | 10 |
//! | s | most sensors that may be removed, whichever they are | |
//! | q = ⌊s/2⌋ | correctable attacks | |

use nalgebra::{DMatrix, SMatrix, SVector, Vector3};
use plumbline_proto::v1::SensorKind;

use super::window::{Model, Row, Window};
use super::{SecureError, newton::Settings};
use crate::frames::from_roll_pitch_yaw;
use crate::linalg::LinalgError;
use crate::model::airframe::Airframe;
use crate::model::discretize::zero_order_hold;
use crate::model::linearize::{self, linearize};
use crate::model::trim::Trim;
use crate::sensor::suite::{Quality, Suite, Timing};

/// States.
pub const STATES: usize = 10;
/// Their names, in order.
pub const NAMES: [&str; STATES] = ["z", "vx", "vy", "vz", "roll", "pitch", "yaw", "p", "q", "r"];
/// Where they are in the twelve states of `model::linearize`.
const FROM: [usize; STATES] = [
    linearize::ix::Z,
    linearize::ix::VX,
    linearize::ix::VY,
    linearize::ix::VZ,
    linearize::ix::ROLL,
    linearize::ix::PITCH,
    linearize::ix::YAW,
    linearize::ix::P,
    linearize::ix::Q,
    linearize::ix::R,
];
/// A direction seen less than this, against the largest, is not seen.
const SEEN: f64 = 1e-7;
/// Most groups of equal rows: every combination of them is tried.
pub const MAX_GROUPS: usize = 18;

/// One scalar of one sensor.
#[derive(Debug, Clone, PartialEq)]
pub struct Scalar {
    /// Which sensor.
    pub kind: SensorKind,
    /// Instance, from 1.
    pub instance: usize,
    /// What it measures, for people.
    pub name: &'static str,
    /// Its row.
    pub c: SVector<f64, STATES>,
    /// One-sigma of one sample.
    pub sigma: f64,
    /// When it samples.
    pub timing: Timing,
}

/// Ten states about a trim point, and the scalars that see them.
#[derive(Debug, Clone, PartialEq)]
pub struct Observed {
    /// ẋ = A x + B u.
    pub a: SMatrix<f64, STATES, STATES>,
    /// Thrust and torques.
    pub b: SMatrix<f64, STATES, 4>,
    /// Every scalar.
    pub scalars: Vec<Scalar>,
}

/// What a suite promises.
#[derive(Debug, Clone, PartialEq)]
pub struct Promise {
    /// Rank of the observability matrix.
    pub rank: usize,
    /// States that are not determined.
    pub unobserved: Vec<usize>,
    /// Scalars of all sensors.
    pub rows: usize,
    /// Scalars to remove until each state is no longer determined.
    pub to_lose: [usize; STATES],
    /// Most scalars that may be removed, whichever they are.
    pub sparse: usize,
    /// Correctable attacks on any scalars.
    pub correctable: usize,
    /// State that is lost first.
    pub binding: usize,
    /// For each type: scalars of it, and correctable attacks if only they are attacked.
    pub kinds: Vec<(SensorKind, usize, usize)>,
}

/// Why there is no report.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum SuiteError {
    /// States that nothing sees, or that nothing can tell apart.
    #[error("the suite does not observe {}: add a sensor that sees it (rank {rank} of {STATES})", names(.unobserved))]
    Unobservable {
        /// The states.
        unobserved: Vec<usize>,
        /// Rank.
        rank: usize,
    },
    /// Too many different rows.
    #[error("{0} different rows: every combination of at most {MAX_GROUPS} can be tried")]
    Groups(usize),
    /// The model cannot be sampled.
    #[error(transparent)]
    Sampling(#[from] LinalgError),
    /// The window cannot be built.
    #[error(transparent)]
    Window(#[from] SecureError),
}

fn names(states: &[usize]) -> String {
    states.iter().filter_map(|s| NAMES.get(*s).copied()).collect::<Vec<_>>().join(", ")
}

impl Observed {
    /// The sensors of `suite` on `airframe` about `trim`.
    ///
    /// Heights and barometers see z, gyroscopes p q r, magnetometers yaw (levelled), GNSS z and velocity,
    /// motion capture z and angles. Accelerometers see what neither thrust nor gravity gives: drag
    /// (\[Clinic\] Eq. 2), −k_d/m Rᵀv, and through it the velocity; nothing is integrated.
    pub fn of(suite: &Suite, airframe: &Airframe, trim: &Trim) -> Self {
        let mut observed = Self::at(airframe, trim);
        let drag = airframe.linear_drag_nspm / airframe.mass_kg;
        let one = |state: usize| {
            let mut c = SVector::zeros();
            c[state] = 1.0;
            c
        };
        let mut add = |kind, index: usize, name, c, quality: &Quality, timing: &Timing| {
            let sigma = quality.total_sigma();
            observed.scalars.push(Scalar { kind, instance: index + 1, name, c, sigma, timing: *timing });
        };
        for (i, s) in suite.heights.iter().enumerate() {
            add(SensorKind::Height, i, "height", one(0), &s.height, &s.timing);
        }
        for (i, s) in suite.barometers.iter().enumerate() {
            let altitude = Quality { sigma: s.pressure.sigma / 11.8, resolution: 0.0, ..s.pressure };
            add(SensorKind::Barometer, i, "pressure altitude", one(0), &altitude, &s.timing);
        }
        for (i, s) in suite.imus.iter().enumerate() {
            for (axis, name) in ["gyro x", "gyro y", "gyro z"].into_iter().enumerate() {
                add(SensorKind::Imu, i, name, one(7 + axis), &s.gyro, &s.timing);
            }
            for (axis, name) in ["accel x", "accel y", "accel z"].into_iter().enumerate() {
                add(SensorKind::Imu, i, name, drag_row(trim, drag, axis), &s.accel, &s.timing);
            }
            if let Some(mag) = &s.mag {
                // Some 20 µT of horizontal field make an angle of a field.
                let angle = Quality { sigma: mag.total_sigma() / 20.0, resolution: 0.0, ..*mag };
                add(SensorKind::Imu, i, "heading", one(6), &angle, &s.timing);
            }
        }
        if let Some(s) = &suite.gnss {
            add(SensorKind::Gnss, 0, "altitude", one(0), &s.vertical, &s.timing);
            for (axis, name) in ["vx", "vy", "vz"].into_iter().enumerate() {
                add(SensorKind::Gnss, 0, name, one(1 + axis), &s.velocity, &s.timing);
            }
        }
        if let Some(s) = &suite.mocap_pose {
            add(SensorKind::MocapPose, 0, "z", one(0), &s.position, &s.timing);
            for (axis, name) in ["roll", "pitch", "yaw"].into_iter().enumerate() {
                add(SensorKind::MocapPose, 0, name, one(4 + axis), &s.attitude, &s.timing);
            }
        }
        observed
    }

    /// What `suite` promises on `airframe` at hover.
    ///
    /// # Errors
    /// As [`Self::promise`].
    pub fn promise_at_hover(suite: &Suite, airframe: &Airframe) -> Result<Promise, SuiteError> {
        Self::of(suite, airframe, &Trim::hover(airframe)).promise()
    }

    /// The suite of \[Clinic\] Eq. 18: `heights` lasers and four units that each give velocity, angles and rates,
    /// 38 rows with two lasers. Velocities there are integrated accelerations, which we never fly.
    pub fn clinic(heights: usize, airframe: &Airframe, trim: &Trim) -> Self {
        let mut observed = Self::at(airframe, trim);
        let timing = Timing { rate_hz: 25.0, phase_s: 0.0, delay_s: 0.0, dropout: 0.0 };
        let mut add = |kind, index: usize, state: usize, sigma| {
            let mut c = SVector::zeros();
            c[state] = 1.0;
            observed.scalars.push(Scalar { kind, instance: index + 1, name: NAMES[state], c, sigma, timing });
        };
        (0..heights).for_each(|i| add(SensorKind::Height, i, 0, 0.01));
        for unit in 0..4 {
            (1..STATES).for_each(|state| add(SensorKind::Imu, unit, state, if state < 4 { 0.05 } else { 0.02 }));
        }
        observed
    }

    fn at(airframe: &Airframe, trim: &Trim) -> Self {
        let linear = linearize(airframe, trim);
        Self {
            a: SMatrix::from_fn(|i, j| linear.a[(FROM[i], FROM[j])]),
            b: SMatrix::from_fn(|i, j| linear.b[(FROM[i], j)]),
            scalars: Vec::new(),
        }
    }

    /// The model sampled every `period_s`: A and B over one slot.
    ///
    /// # Errors
    /// When the exponential overflows.
    pub fn sampled(
        &self,
        period_s: f64,
    ) -> Result<(SMatrix<f64, STATES, STATES>, SMatrix<f64, STATES, 4>), LinalgError> {
        let a = DMatrix::from_fn(STATES, STATES, |i, j| self.a[(i, j)]);
        let b = DMatrix::from_fn(STATES, 4, |i, j| self.b[(i, j)]);
        let sampled = zero_order_hold(&a, &b, period_s)?;
        Ok((SMatrix::from_fn(|i, j| sampled.a[(i, j)]), SMatrix::from_fn(|i, j| sampled.b[(i, j)])))
    }

    /// A window over `slots` slots of `period_s` with white process noise `q` per slot.
    ///
    /// # Errors
    /// A model that cannot be sampled, a row without noise.
    pub fn window(
        &self,
        slots: usize,
        period_s: f64,
        q: SMatrix<f64, STATES, STATES>,
        settings: Settings,
    ) -> Result<Window<STATES>, SuiteError> {
        let model = Model { a: self.sampled(period_s)?.0, q };
        let mut rows: Vec<Row<STATES>> = Vec::new();
        let mut kinds = Vec::with_capacity(self.scalars.len());
        for scalar in &self.scalars {
            let row = Row { c: scalar.c, sigma: scalar.sigma, bias_sigma: 0.0 };
            let known = rows.iter().position(|r| *r == row);
            kinds.push(known.unwrap_or(rows.len()));
            if known.is_none() {
                rows.push(row);
            }
        }
        Ok(Window::new(&model, &rows, &kinds, slots, settings)?)
    }

    /// Slots of a window that each scalar fills, one bit each (bit k: k slots before the end), for every
    /// sampling phase: the patterns repeat after as many slots as there are entries.
    pub fn phases(&self, slots: usize, period_s: f64, phases: usize) -> Vec<Vec<u128>> {
        let filled = |scalar: &Scalar, slot: i64| {
            let (from, to) = (slot as f64 * period_s, (slot + 1) as f64 * period_s);
            let first = ((from - scalar.timing.phase_s) * scalar.timing.rate_hz - 1e-9).ceil();
            scalar.timing.phase_s + first / scalar.timing.rate_hz < to - 1e-9
        };
        let mask = |scalar: &Scalar, end: i64| {
            (0..slots.min(128)).fold(0_u128, |mask, k| mask | u128::from(filled(scalar, end - k as i64)) << k)
        };
        (0..phases).map(|end| self.scalars.iter().map(|s| mask(s, (slots + end) as i64)).collect()).collect()
    }

    /// What the suite promises.
    ///
    /// # Errors
    /// [`SuiteError::Unobservable`] naming the states, [`SuiteError::Groups`].
    pub fn promise(&self) -> Result<Promise, SuiteError> {
        let mut groups: Vec<(SVector<f64, STATES>, Vec<usize>)> = Vec::new();
        for (index, scalar) in self.scalars.iter().enumerate() {
            let size = scalar.c.norm();
            if size <= SEEN {
                continue;
            }
            let c = scalar.c / size;
            match groups.iter_mut().find(|(row, _)| (row.dot(&c).abs() - 1.0).abs() < 1e-9) {
                Some((_, members)) => members.push(index),
                None => groups.push((c, vec![index])),
            }
        }
        if groups.len() > MAX_GROUPS {
            return Err(SuiteError::Groups(groups.len()));
        }
        let (rank, unobserved) = self.determined(groups.iter().map(|(c, _)| *c));
        if !unobserved.is_empty() {
            return Err(SuiteError::Unobservable { unobserved, rank });
        }
        let mut to_lose = [self.scalars.len(); STATES];
        let types: Vec<SensorKind> = self.scalars.iter().fold(Vec::new(), |mut types, s| {
            if !types.contains(&s.kind) {
                types.push(s.kind);
            }
            types
        });
        let of_kind = |kind: SensorKind| self.scalars.iter().filter(|s| s.kind == kind).count();
        // Removing every scalar of a type may lose nothing: then any number of attacks on it is correctable.
        let mut kind_to_lose: Vec<Option<usize>> = vec![None; types.len()];
        for removed in 1_u32..1 << groups.len() {
            let gone = |g: usize| removed >> g & 1 == 1;
            let count: usize = groups.iter().enumerate().filter(|(g, _)| gone(*g)).map(|(_, (_, m))| m.len()).sum();
            if count > to_lose.iter().copied().max().unwrap_or_default() && kind_to_lose.iter().all(Option::is_some) {
                continue;
            }
            let rest = groups.iter().enumerate().filter(|(g, _)| !gone(*g)).map(|(_, (c, _))| *c);
            let lost = self.determined(rest).1;
            if lost.is_empty() {
                continue;
            }
            lost.iter().for_each(|state| to_lose[*state] = to_lose[*state].min(count));
            let members = || groups.iter().enumerate().filter(|(g, _)| gone(*g)).flat_map(|(_, (_, m))| m);
            for (kind, least) in types.iter().zip(&mut kind_to_lose) {
                if members().all(|i| self.scalars.get(*i).is_some_and(|s| s.kind == *kind)) {
                    *least = Some(least.map_or(count, |least| least.min(count)));
                }
            }
        }
        let binding = (0..STATES).min_by_key(|s| to_lose[*s]).unwrap_or_default();
        let sparse = to_lose[binding].saturating_sub(1);
        let kinds = types.iter().zip(&kind_to_lose).map(|(kind, least)| {
            let all = of_kind(*kind);
            (*kind, all, least.map_or(all, |least| (least - 1) / 2))
        });
        Ok(Promise {
            rank,
            unobserved,
            rows: self.scalars.len(),
            to_lose,
            sparse,
            correctable: sparse / 2,
            binding,
            kinds: kinds.collect(),
        })
    }

    /// Rank of the observability matrix of `rows`, and the states that its row space does not hold.
    fn determined(&self, rows: impl Iterator<Item = SVector<f64, STATES>>) -> (usize, Vec<usize>) {
        // Time in units that make A's entries comparable: gravity and drag are of order 1 to 10 per second.
        let scale = 1.0 / self.a.norm().max(1.0);
        let mut basis: Vec<SVector<f64, STATES>> = Vec::with_capacity(STATES);
        let mut front: Vec<SVector<f64, STATES>> = rows.collect();
        let reduce = |basis: &[SVector<f64, STATES>], v: &SVector<f64, STATES>| {
            let mut rest = *v;
            for _ in 0..2 {
                basis.iter().for_each(|b| rest -= b * b.dot(&rest));
            }
            rest
        };
        for _ in 0..STATES {
            let mut next = Vec::new();
            for row in &front {
                let rest = reduce(&basis, row);
                if rest.norm() > SEEN * row.norm().max(SEEN) && basis.len() < STATES {
                    let unit = rest.normalize();
                    basis.push(unit);
                    // Only what is new can bring new directions: the span is A-invariant once nothing is.
                    next.push(self.a.transpose() * unit * scale);
                }
            }
            front = next;
            if front.is_empty() {
                break;
            }
        }
        let unseen = |state: &usize| reduce(&basis, &SVector::from_fn(|i, _| f64::from(i == *state))).norm() > 1e-5;
        (basis.len(), (0..STATES).filter(unseen).collect())
    }
}

/// ∂(−k_d/m Rᵀ v)/∂x of one body axis at the trim, by central differences (exact to rounding for our needs).
fn drag_row(trim: &Trim, drag: f64, axis: usize) -> SVector<f64, STATES> {
    const STEP: f64 = 1e-5;
    let force = |v: Vector3<f64>, angles: Vector3<f64>| -drag * (from_roll_pitch_yaw(&angles).inverse() * v)[axis];
    let (v, angles) = (trim.velocity_enu_mps, trim.roll_pitch_yaw_rad);
    let mut c = SVector::<f64, STATES>::zeros();
    for k in 0..3 {
        let step = Vector3::from_fn(|i, _| if i == k { STEP } else { 0.0 });
        c[1 + k] = (force(v + step, angles) - force(v - step, angles)) / (2.0 * STEP);
        c[4 + k] = (force(v, angles + step) - force(v, angles - step)) / (2.0 * STEP);
    }
    // Differences of zeros leave rounding behind.
    c.map(|x| if x.abs() < 1e-9 { 0.0 } else { x })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn clinic(heights: usize) -> Observed {
        let airframe = Airframe::clinic();
        Observed::clinic(heights, &airframe, &Trim::hover(&airframe))
    }

    /// Scalars to remove for each state: reference clinic_linear_models.json, quad10 hover per_state.
    #[test]
    fn the_clinic_suite_promises_what_the_reference_says() {
        let promise = clinic(2).promise().unwrap();
        assert_eq!((promise.rank, promise.sparse, promise.correctable), (10, 1, 0));
        assert_eq!(promise.to_lose, [2, 4, 4, 6, 8, 8, 4, 12, 12, 8]);
        assert_eq!(NAMES[promise.binding], "z");
        // A third laser corrects one attack ([Clinic] Fig. 10).
        let promise = clinic(3).promise().unwrap();
        assert_eq!((promise.to_lose[0], promise.correctable), (3, 1));
        let heights = promise.kinds.iter().find(|k| k.0 == SensorKind::Height).unwrap();
        assert_eq!((heights.1, heights.2), (3, 1));
    }

    #[test]
    fn the_default_rig_sees_velocity_by_drag_alone_and_corrects_one_attack() {
        let airframe = Airframe::iris();
        for trim in [
            Trim::hover(&airframe),
            Trim::straight(&airframe, Vector3::new(3.0, 0.0, 0.0)),
            Trim::circle(&airframe, 2.0, 1.5),
        ] {
            let observed = Observed::of(&Suite::string_rig(), &airframe, &trim);
            assert_eq!(observed.scalars.len(), 3 + 1 + 4 * 7);
            let promise = observed.promise().unwrap();
            assert!(promise.rank == 10 && promise.correctable >= 1, "{promise:?}");
        }
        let mut still = airframe.clone();
        still.linear_drag_nspm = 0.0;
        let error = Observed::of(&Suite::string_rig(), &still, &Trim::hover(&still)).promise().unwrap_err();
        assert!(error.to_string().contains("vx, vy, roll, pitch"), "{error}");
    }

    #[test]
    fn a_suite_without_heights_or_magnetometers_is_refused_with_the_state() {
        let airframe = Airframe::iris();
        let trim = Trim::hover(&airframe);
        let mut suite = Suite::string_rig();
        suite.heights.clear();
        suite.barometers.clear();
        let error = Observed::of(&suite, &airframe, &trim).promise().unwrap_err().to_string();
        assert!(error.contains("does not observe z"), "{error}");
        let mut suite = Suite::string_rig();
        suite.imus.iter_mut().for_each(|imu| imu.mag = None);
        let error = Observed::of(&suite, &airframe, &trim).promise().unwrap_err().to_string();
        assert!(error.contains("yaw"), "{error}");
        assert!(Observed::of(&Suite::empty(), &airframe, &trim).promise().is_err());
    }

    #[test]
    fn phases_follow_rates_and_stagger() {
        let airframe = Airframe::iris();
        let observed = Observed::of(&Suite::string_rig(), &airframe, &Trim::hover(&airframe));
        let phases = observed.phases(10, 0.04, 5);
        // Lasers at 10 Hz fill two slots of five, IMUs all of them.
        for masks in &phases {
            assert!(masks.iter().take(3).all(|m| m.count_ones() == 4), "{masks:?}");
            assert!(masks.iter().skip(3).all(|m| m.count_ones() == 10));
        }
        assert_ne!(phases[0], phases[1]);
        let next = observed.phases(10, 0.04, 6);
        assert_eq!(next[0], next[5]);
    }

    #[test]
    fn the_hover_model_is_the_reference() {
        let Some(path) = crate::shared::shared("reference/clinic_linear_models.json") else { return };
        let text = std::fs::read_to_string(path).unwrap();
        let json: serde_json::Value = serde_json::from_str(&text).unwrap();
        let (a, _) = clinic(2).sampled(0.05).unwrap();
        for i in 0..STATES {
            for j in 0..STATES {
                let expected = json["quad10"]["hover"]["c2d_0.05"]["Ad"][i][j].as_f64().unwrap();
                assert!((a[(i, j)] - expected).abs() < 1e-12, "A[{i}][{j}] {} against {expected}", a[(i, j)]);
            }
        }
    }
}
