//! The lanes about hover, for whoever asks what an attack could do: the vertical map of a slot by finite differences of the
//! lane that flies, and the limits of its judges, each the constant in use.

use nalgebra::{SMatrix, UnitQuaternion, Vector3};
use plumbline_proto::time::FlightTime;
use plumbline_proto::v1::SensorKind;

use super::evidence::{self, Heard};
use super::heights::{self, Heights};
use super::integral::Six;
use super::lane::Lane;
pub use super::noise::Shaken;
use super::rows::{self, Around, Correction, Unaided};
use super::slot::Slot;
use super::{HORIZON_US, SLOT_S, SLOT_US, noise, predictor, rates, split, vote};
use crate::estimate::aiding::{VELOCITY, XYZ};
use crate::estimate::ekf_bias::covariance::ix;
use crate::estimate::{Residual, Residuals};
use crate::sensor::gnss::GnssSample;
use crate::sensor::measure::Kinematics;
use crate::sensor::mocap_pose::MocapPoseSample;
use crate::sensor::{MAX_HEIGHTS, SensorModel};

/// Altitude, climb and bias of the accelerometer's z.
pub const STATES: usize = 3;
/// What measures along z: each height, the altitude by motion capture (m), the climb by GNSS (m/s).
pub const ROWS: usize = MAX_HEIGHTS + 2;
/// Place of motion capture among them, and of GNSS.
pub const POSE: usize = MAX_HEIGHTS;
/// See [`POSE`].
pub const GNSS: usize = MAX_HEIGHTS + 1;
/// After a slot: those three, then the innovation of each row.
pub const OUTPUTS: usize = STATES + ROWS;
/// Before it: those three, the mean specific force along z, each row as measured.
pub const INPUTS: usize = STATES + 1 + ROWS;

/// A slot, s, and how far the fusion horizon lies back, s.
pub const SLOT: f64 = SLOT_S;
/// See [`SLOT`].
pub const HORIZON_S: f64 = 1e-6 * HORIZON_US as f64;

/// One slot of a lane at hover.
#[derive(Debug, Clone)]
pub struct SlotMap {
    /// Outputs from inputs: m, m/s, m/s².
    pub map: SMatrix<f64, OUTPUTS, INPUTS>,
    /// One-sigma of the innovation of each row that was sampled, m and m/s.
    pub sigma_m: [Option<f64>; ROWS],
}

/// Limits of the judges of heights; see `heights.rs` and `split.rs`.
pub mod of_heights {
    use super::{heights, rows, split};
    /// Means of so many samples, and one-sigma of each, m.
    pub const MEANS: [(usize, f64); 2] = [(heights::SHORT, heights::SIGMA_M[0]), (heights::KEPT, heights::SIGMA_M[1])];
    /// Sigmas beyond which a laser weighs less, and beyond which it is excluded.
    pub const SOFT: f64 = heights::SOFT;
    /// See [`SOFT`].
    pub const LIMIT: f64 = heights::LIMIT;
    /// Sigmas beyond which a mean pulls the centre no more.
    pub const PULL: f64 = heights::PULL;
    /// What is known of the centre without a laser, m.
    pub const PRIOR_M: f64 = heights::PRIOR_M;
    /// Furthest that a sample reaches from the median, m.
    pub const REACH_M: f64 = heights::REACH_M;
    /// Beyond so many σ of its innovation a sample counts less.
    pub const KNEE: f64 = rows::KNEE;
    /// Lasers that differ by more have parted, m.
    pub const GAP_M: f64 = split::GAP_M;
    /// Slots between two decodes.
    pub const EVERY: usize = heights::EVERY as usize;

    /// Part of a deviation that is learned as an offset at each decode, …
    pub const LEARNED: f64 = heights::GAINS.1;
    /// … of that so much as a scale, for each m from …
    pub const SCALE_SHARE: f64 = heights::SCALE_SHARE;
    /// … this altitude, m.
    pub const PIVOT_M: f64 = heights::PIVOT_M;
}

/// Limits of the judges of IMUs; see `vote.rs`, `evidence.rs` and `noise.rs`.
pub mod of_imus {
    use super::{Shaken, evidence, noise, predictor, vote};
    /// How far an accelerometer counts from the median of all before anybody has judged it, m/s².
    pub fn reach_mps2(shaken: &Shaken) -> f64 {
        predictor::REACH.0.max(predictor::SHAKEN * noise::shaken_mps2(shaken.rectified_mps2))
    }
    /// The same of a gyroscope, rad/s, where they are not shaken.
    pub const REACH_RADPS: f64 = predictor::REACH.1;
    /// Slots that the vote compares.
    pub const SLOTS: usize = vote::SLOTS;
    /// Beyond so many times the usual deviation mean and root mean square count.
    pub const LIMITS: (f64, f64) = vote::LIMITS;
    /// No usual deviation of an accelerometer is taken for smaller, m/s².
    pub const USUAL_MPS2: f64 = vote::FLOOR.0;
    /// Part of a bias that the vote learns from slot to slot.
    pub const LEARNED: f64 = vote::GAINS.1;
    /// Evidence Σ (r²/s − 1) beyond which a lane weighs less.
    pub const EVIDENCE: f64 = evidence::DEAD / evidence::SHARE;
    /// Within which evidence is forgotten, s.
    pub const MEMORY_S: f64 = evidence::MEMORY_S;
    /// No accelerometer is taken for better, m/s².
    pub const NOISE_MPS2: f64 = noise::FLOOR.0;
    /// Slots of the means whose noise is measured.
    pub const NOISE_SLOTS: u32 = noise::SLOTS;
    /// No usual deviation of a gyroscope is taken for smaller, rad/s.
    pub const USUAL_RADPS: f64 = vote::FLOOR.1;
    /// A lane tilted further from the median one weighs less, rad.
    pub const APART_RAD: f64 = evidence::TILT_DEG * std::f64::consts::PI / 180.0;
}

/// What brings attitude and rate to now; see `rates.rs`.
pub mod of_rates {
    use super::rates;
    /// δ, s.
    pub const LATE_S: f64 = rates::LATE_S;
    /// T, s.
    pub const FORGOTTEN_S: f64 = rates::FORGOTTEN_S;
}

/// The errors of what is vertical.
const VERTICAL: [usize; STATES] = [ix::POSITION + 2, ix::VELOCITY + 2, ix::ACCEL_BIAS + 2];
/// Slots after which gains are steady.
const STEADY: u64 = 750;

/// A lane at hover, at rest at `z_m`.
pub(super) struct Hovering<'a> {
    model: &'a SensorModel,
    heights: Heights,
    pub(super) lane: Lane,
    sigma: Six,
    z_m: f64,
    /// Drag over mass, 1/s, where it is used.
    drag: Option<f64>,
    /// Part of the specific force along the thrust that is commanded.
    share: f64,
}

impl<'a> Hovering<'a> {
    /// With heights that weigh `heights`.
    pub(super) fn new(
        model: &'a SensorModel,
        heights: &[f64; MAX_HEIGHTS],
        shaken: &Shaken,
        z_m: f64,
        drag: Option<f64>,
    ) -> Self {
        let at = Kinematics {
            position_enu_m: Vector3::z() * z_m,
            velocity_enu_mps: Vector3::zeros(),
            world_from_body: UnitQuaternion::identity(),
        };
        let mut lane = Lane::new(Vector3::zeros(), model.imus.gravity_mps2);
        lane.begin(&at, &Six::zeros(), [0.1, 0.1, 0.01, 0.1, 1e-3], model);
        let (accel, gyro) = (shaken.noise_mps2.max(noise::FLOOR.0), noise::FLOOR.1);
        let sigma = Six::new(accel, accel, shaken.taken(shaken.noise_mps2), gyro, gyro, gyro);
        let (heights, share) = (Heights::weighing(heights), 1.0 - shaken.own());
        Self { model, heights, lane, sigma, z_m, drag, share }
    }

    /// One slot, with these means less gravity, which the thrust as commanded tells as well, but for what a bias is taken for.
    pub(super) fn step(&self, lane: &mut Lane, slot: &Slot, mut mean: Six, unaided: Option<Unaided>) -> Residuals {
        mean[2] += self.model.imus.gravity_mps2 + self.share * lane.accel_bias.z;
        lane.predict(slot.end(), &mean, &self.sigma, self.model);
        let around = Around {
            model: self.model,
            heights: &self.heights,
            beyond_m: [0.0; MAX_HEIGHTS],
            field_ut: None,
            drag: self.drag,
            barometers: false,
            wash_sigma_m: 0.0,
            yaw_known: true,
            gnss_height_m: None,
            unaided,
        };
        let mut residuals = Residuals::new();
        let mut correction = Correction { lane, heard: Heard::default(), residuals: &mut residuals, named: true };
        correction.take(slot, &around, &self.sigma);
        residuals
    }

    fn slot(&self, number: u64, ages_s: &[Option<f64>; ROWS], off: &[f64; ROWS]) -> Slot {
        let mut slot = Slot { number, ..Slot::default() };
        let end_us = slot.end().0;
        let time = |age_s: f64| FlightTime(end_us.saturating_sub((1e6 * age_s).round() as u64));
        for ((place, age_s), off_m) in slot.heights.iter_mut().zip(ages_s).zip(off) {
            *place = age_s.map(|age_s| (time(age_s), self.z_m + off_m));
        }
        let up = Vector3::z;
        slot.pose = ages_s[POSE].map(|age_s| posed(time(age_s), up() * (self.z_m + off[POSE]), &Vector3::zeros()));
        // Of its position nothing is used along z where heights tell more.
        slot.gnss = ages_s[GNSS].map(|age_s| located(time(age_s), up() * self.z_m, up() * off[GNSS], 1.0));
        slot
    }

    /// The lane, outputs for these inputs, each a deviation from hover, and residuals.
    fn outputs(
        &self,
        number: u64,
        ages_s: &[Option<f64>; ROWS],
        x: &[f64; INPUTS],
    ) -> (Lane, [f64; OUTPUTS], Residuals) {
        let mut lane = self.lane.clone();
        lane.at.position_enu_m.z += x[0];
        lane.at.velocity_enu_mps.z += x[1];
        lane.accel_bias.z += x[2];
        let off = std::array::from_fn(|i| x[STATES + 1 + i]);
        let mean = Six::new(0.0, 0.0, x[STATES], 0.0, 0.0, 0.0);
        let residuals = self.step(&mut lane, &self.slot(number, ages_s, &off), mean, None);
        let mut out = [0.0; OUTPUTS];
        out[0] = lane.at.position_enu_m.z - self.z_m;
        out[1] = lane.at.velocity_enu_mps.z;
        out[2] = lane.accel_bias.z;
        for residual in &residuals {
            if let Some(row) = row_of(residual) {
                out[STATES + row] = residual.innovation;
            }
        }
        (lane, out, residuals)
    }

    /// Takes every error for known but those `kept`.
    fn forget_all_but(&mut self, kept: &[usize]) {
        for i in (0..self.lane.p.nrows()).filter(|i| !kept.contains(i)) {
            self.lane.p.row_mut(i).fill(0.0);
            self.lane.p.column_mut(i).fill(0.0);
        }
    }

    /// Maps of `period` slots, covariance steady, and their residuals: finite differences of `outputs`, which tells the lane after a slot
    /// for these inputs. Of the errors only those `kept` matter, and nothing aids the rest.
    pub(super) fn maps<const O: usize, const I: usize>(
        &mut self,
        period: usize,
        kept: &[usize],
        outputs: impl Fn(&Self, u64, &[f64; I]) -> (Lane, [f64; O], Residuals),
    ) -> Vec<(SMatrix<f64, O, I>, Residuals)> {
        const STEP: f64 = 1e-4;
        let period = period.max(1) as u64;
        let steady = STEADY.next_multiple_of(period);
        let mut maps = Vec::new();
        for number in 0..steady + period {
            self.forget_all_but(kept);
            let (after, _, residuals) = outputs(self, number, &[0.0; I]);
            if number >= steady {
                let mut map = SMatrix::<f64, O, I>::zeros();
                for column in 0..I {
                    let one = |sign: f64| {
                        let mut x = [0.0; I];
                        x[column] = sign * STEP;
                        outputs(self, number, &x).1
                    };
                    let (up, down) = (one(1.0), one(-1.0));
                    (0..O).for_each(|row| map[(row, column)] = (up[row] - down[row]) / (2.0 * STEP));
                }
                maps.push((map, residuals));
            }
            self.lane = after;
        }
        maps
    }
}

/// The maps of the slots of one cycle, covariance steady: `ages_s` tells for each slot of it how long before the slot's end each
/// row was sampled, s; the heights weigh `weights`, at altitude `z_m`. Of what is added to an accelerometer alone [`Shaken::own`] counts.
pub fn cycle(
    model: &SensorModel,
    ages_s: &[[Option<f64>; ROWS]],
    weights: &[f64; MAX_HEIGHTS],
    shaken: &Shaken,
    z_m: f64,
) -> Vec<SlotMap> {
    let mut hovering = Hovering::new(model, weights, shaken, z_m, None);
    let period = ages_s.len().max(1);
    let outputs = |hovering: &Hovering, number: u64, x: &[f64; INPUTS]| {
        let none = [None; ROWS];
        hovering.outputs(number, ages_s.get(number as usize % period).unwrap_or(&none), x)
    };
    let maps = hovering.maps(period, &VERTICAL, outputs);
    maps.into_iter().map(|(map, residuals)| SlotMap { map, sigma_m: sigmas(&residuals) }).collect()
}

/// What the lane of an attacked IMU differs from those of healthy ones by in a slot.
#[derive(Debug, Clone, Copy, Default)]
pub struct Differing {
    /// Of each row that was sampled: what its innovation differs by, and the one-sigma that the lane gives it, m and m/s.
    pub innovations: [Option<(f64, f64)>; ROWS],
    /// What its bias of the accelerometer's z differs by, m/s².
    pub bias_mps2: f64,
}

/// What the lanes have measured of their accelerometers along z when an attack begins; see `noise.rs`.
#[derive(Debug, Clone, Copy)]
pub struct Measured {
    /// Of the others.
    pub shaken: Shaken,
    /// Noise of the one attacked, m/s².
    pub noise_mps2: f64,
    /// Slots since the begin of the mean that the onset falls into.
    pub begin: u32,
}

/// The lane that flies, under `added_mps2` to the mean specific force along z of each slot; everything else as for [`cycle`], steady when
/// it begins. Its noise is `measured` on as in flight: the step of a bias is taken for noise for a while, which gives heights more weight.
pub fn differing(
    model: &SensorModel,
    ages_s: &[[Option<f64>; ROWS]],
    weights: &[f64; MAX_HEIGHTS],
    measured: &Measured,
    z_m: f64,
    added_mps2: &[f64],
) -> Vec<Differing> {
    let noise = noise_course(measured, added_mps2);
    let begin = Shaken { noise_mps2: noise.first().copied().unwrap_or_default(), ..measured.shaken };
    let mut hovering = Hovering::new(model, weights, &begin, z_m, None);
    let period = ages_s.len().max(1);
    let none = [None; ROWS];
    let ages = |number: u64| ages_s.get(number as usize % period).unwrap_or(&none);
    let outputs = |hovering: &Hovering, number: u64, x: &[f64; INPUTS]| hovering.outputs(number, ages(number), x);
    hovering.maps(period, &VERTICAL, outputs);
    let after = |(number, (added, sigma)): (usize, (&f64, &f64))| {
        hovering.forget_all_but(&VERTICAL);
        hovering.sigma[2] = measured.shaken.taken(*sigma);
        let mut x = [0.0; INPUTS];
        x[STATES] = *added * measured.shaken.own();
        // The cycle begins with the attack.
        let (lane, out, residuals) = hovering.outputs(number as u64, ages(number as u64), &x);
        hovering.lane = lane;
        let sigmas = sigmas(&residuals);
        let innovation = |i: usize| Some((*out.get(STATES + i)?, *sigmas.get(i)?.as_ref()?));
        Differing { innovations: std::array::from_fn(innovation), bias_mps2: out[2] }
    };
    added_mps2.iter().zip(&noise).enumerate().map(after).collect()
}

/// Noise that a lane takes its accelerometer for in each slot, `measured` before `added_mps2` to the mean of each, m/s².
pub fn noise_course(measured: &Measured, added_mps2: &[f64]) -> Vec<f64> {
    let (typical, mut sigma) = (measured.shaken.noise_mps2, measured.noise_mps2);
    let (mut sum, mut before, mut slots) = (0.0, 0.0, measured.begin);
    let after = |added: &f64| {
        let taken = noise::taken(sigma, typical);
        (sum, slots) = (sum + added, slots + 1);
        if slots >= noise::SLOTS {
            let mean = sum / f64::from(slots);
            sigma = noise::followed(sigma, typical, mean - before);
            (sum, slots, before) = (0.0, 0, mean);
        }
        taken
    };
    added_mps2.iter().map(after).collect()
}

/// Its place among the rows.
fn row_of(residual: &Residual) -> Option<usize> {
    let height = usize::from(residual.sensor.instance.checked_sub(1)?);
    match (residual.sensor.kind, residual.channel) {
        (SensorKind::Height, _) => Some(height).filter(|i| *i < MAX_HEIGHTS),
        (SensorKind::MocapPose, channel) if channel == XYZ[2] => Some(POSE),
        (SensorKind::Gnss, channel) if channel == VELOCITY[2] => Some(GNSS),
        _ => None,
    }
}

/// One-sigma of the innovation of each row.
fn sigmas(residuals: &Residuals) -> [Option<f64>; ROWS] {
    let of = |row: usize| residuals.iter().find(|residual| row_of(residual) == Some(row));
    std::array::from_fn(|row| of(row).map(|residual| residual.sigma))
}

/// Slots after which cycles of so many slots `each` repeat together.
pub fn together(each: &[usize]) -> usize {
    each.iter().fold(1, |all, own| {
        let own = (*own).max(1);
        (1..=own).map(|times| times * all).find(|slots| slots.is_multiple_of(own)).unwrap_or(all * own)
    })
}

/// A pose that motion capture measured.
pub(super) fn posed(time: FlightTime, place: Vector3<f64>, angle: &Vector3<f64>) -> MocapPoseSample {
    MocapPoseSample { time, position_enu_m: place, world_from_body: UnitQuaternion::from_scaled_axis(*angle) }
}

/// What a GNSS receiver of this horizontal one-sigma, m, measured.
pub(super) fn located(time: FlightTime, place: Vector3<f64>, speed: Vector3<f64>, sigma_m: f64) -> GnssSample {
    GnssSample {
        time,
        position_enu_m: place,
        velocity_enu_mps: speed,
        geodetic: [0.0; 3],
        horizontal_sigma_m: sigma_m,
        vertical_sigma_m: sigma_m,
        satellites: 0,
    }
}

/// Number of the slot that a sample at `time_s` belongs to, and how long before its end it was, s.
pub fn slot_of(time_s: f64) -> (usize, f64) {
    let number = (time_s / SLOT_S + 1e-9).floor().max(0.0) as usize;
    (number, (number as f64 + 1.0) * (1e-6 * SLOT_US as f64) - time_s)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_slot_moves_by_its_force_and_towards_its_heights() {
        let model = SensorModel::default();
        let mut ages = [[None; ROWS]; 5];
        (ages[3][POSE], ages[4][GNSS]) = (Some(0.01), Some(0.02));
        (ages[0][0], ages[2][0]) = (Some(0.04), Some(0.02));
        let maps = cycle(&model, &ages, &[1.0; MAX_HEIGHTS], &Shaken::default(), 1.0);
        assert_eq!(maps.len(), 5);
        // Without a sample it is the motion alone.
        let free = &maps[1].map;
        let close = |a: f64, b: f64| assert!((a - b).abs() < 1e-6, "{a} {b}");
        close(free[(0, 0)], 1.0);
        close(free[(0, 1)], SLOT_S);
        close(free[(1, 3)], SLOT_S);
        close(free[(1, 2)], -SLOT_S);
        assert!(maps[1].sigma_m[0].is_none() && maps[0].sigma_m[0].is_some_and(|s| s > 0.025));
        // A height pulls, and its innovation is what it measures less what was predicted.
        let seen = &maps[2].map;
        let gain = seen[(0, STATES + 1)];
        assert!(gain > 0.01 && gain < 0.9, "{gain}");
        close(seen[(STATES, STATES + 1)], 1.0);
        close(seen[(STATES, 0)], -1.0);
        close(seen[(0, 0)] + gain, 1.0);
        // Motion capture pulls harder, GNSS at the climb.
        let (posed, timed) = (&maps[3].map, &maps[4].map);
        assert!(posed[(0, STATES + 1 + POSE)] > 2.0 * gain, "{posed:.3}");
        close(posed[(STATES + POSE, STATES + 1 + POSE)], 1.0);
        assert!(timed[(1, STATES + 1 + GNSS)] > 0.01 && maps[4].sigma_m[GNSS].is_some(), "{timed:.3}");
    }
}
