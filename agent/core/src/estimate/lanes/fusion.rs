//! One slot: every lane predicts and is corrected, all are judged, weighted and fused.

use nalgebra::{UnitQuaternion, Vector3};
use plumbline_proto::time::FlightTime;

use super::evidence::Heard;
use super::integral::{Integral, Six};
use super::predictor::Mixture;
use super::rows::{Around, Correction, Unaided};
use super::slot::Slot;
use super::start::Found;
use super::{LANES, Lanes, PerLane, SLOT_S, noise, part};
use crate::estimate::aiding::idle::{POSITION_SIGMA_M, UNKNOWN_YAW_SIGMA_RAD};
use crate::estimate::ekf_bias::aiding::{HORIZONTAL_MEMORY_S, VERTICAL_MEMORY_S};
use crate::estimate::ekf_bias::align;
use crate::estimate::{Residuals, median};
use crate::frames::tilt_rad;
use crate::sensor::MAX_HEIGHTS;
use crate::sensor::measure::Kinematics;

/// Offsets and noise are learned fast for so long in the air, and no height is excluded for so long, s.
const LEARNING_S: f64 = 7.0;
const JUDGING_S: f64 = 3.0;
/// So many slots of too little thrust do not end a flight: 0.3 s.
const CARRIED_SLOTS: u32 = 8;
/// At rest the specific force differs from g by less, m/s², and the rate is less, rad/s.
const REST: (f64, f64) = (0.6, 0.06);
/// Slots at rest before it counts.
const REST_SLOTS: u32 = 25;
/// A lane whose IMU is silent for so many slots is not there; when it is heard again it begins again from the others.
const SILENT_SLOTS: u32 = 25;
/// What is known of the altitude at start without a laser's offset, m.
const ALTITUDE_SIGMA_M: f64 = 0.3;
/// Motion capture tells the yaw for so long, s: no magnetometer is asked.
const POSE_MEMORY_S: f64 = 1.0;
/// A lane further from the heaviest in altitude, m, or climb, m/s, weighs nothing.
const AWAY: (f64, f64) = (0.5, 1.0);
/// Lanes that weigh at least so much contradict each other where none of them has all others nearer than this in tilt, rad.
const WEIGHTY: f64 = 0.15;
const CONTRADICTION_RAD: f64 = 0.2;
/// Part of how far apart they are, and of what they rectify, that is learned from slot to slot as usual: 8 s.
const USUAL_GAIN: f64 = 0.005;

/// How far the tilts of all lie about the one that is nearest to all, rad: half of how far they are apart where they lie about a middle,
/// and all of it where two of four stand against the others.
fn apart_rad<'a>(attitudes: impl Iterator<Item = &'a UnitQuaternion<f64>> + Clone) -> f64 {
    let from = |one: &UnitQuaternion<f64>| {
        let inverse = one.inverse();
        attitudes.clone().map(|other| tilt_rad(&(inverse * other))).fold(0.0, f64::max)
    };
    attitudes.clone().map(from).reduce(f64::min).unwrap_or_default()
}

impl Lanes {
    /// Takes a closed slot.
    pub(super) fn advance(&mut self, slot: &Slot) {
        self.report.count += 1;
        self.count(slot);
        self.feed_mixture(slot);
        if let Some(start) = &mut self.start {
            if let Some(found) = start.take(slot, &self.model.imus) {
                self.begin(&found, slot);
            }
            return;
        }
        let slot = &self.delays.restamp(slot);
        let learning = f64::from(self.clock.flown) * SLOT_S < LEARNING_S;
        self.judges.noise.take(&slot.imus, learning);
        self.judges.vote.take(&slot.imus);
        let beyond_m = self.compare_heights(slot);
        self.note(slot);
        let heard = self.correct(slot, beyond_m);
        self.follow_mixture();
        self.judges.evidence.take(&heard);
        self.fuse();
        self.judge_heights(slot, learning);
        self.heal(learning);
        self.account(slot);
        self.rebase(slot);
    }

    fn count(&mut self, slot: &Slot) {
        for (i, mean) in slot.imus.iter().enumerate() {
            let silent = &mut self.fused.silent[i];
            if mean.is_none() {
                *silent = silent.saturating_add(1);
            } else if std::mem::take(silent) > SILENT_SLOTS && self.start.is_none() {
                // Its state is that of when it fell silent.
                self.begin_again(i);
            }
        }
        let g = self.model.imus.gravity_mps2;
        let size = |first: usize| median(slot.imus.iter().flatten().map(|mean| part(mean, first).norm()));
        let shaken = median(slot.roughness.iter().flatten().map(|roughness| part(roughness, 0).amax()));
        let quiet = shaken < 3.0 * self.model.imus.accel.sigma;
        let still = slot.standing && quiet && (size(0) - g).abs() < REST.0 && size(3) < REST.1;
        self.clock.resting = if still { self.clock.resting.saturating_add(1) } else { 0 };
        let flies = self.thrust.flies(slot.thrust_mps2);
        self.clock.unladen = if flies { 0 } else { self.clock.unladen.saturating_add(1) };
        // A recording that does not tell what the motors did flies when it moves.
        if flies || slot.standing && !still {
            if self.clock.flown == 0 {
                // Running motors are another world: what was quiet before says nothing.
                self.judges.noise = super::Noise::new();
                self.judges.evidence.forgive();
            }
            self.clock.flown = self.clock.flown.saturating_add(1);
        }
    }

    fn begin(&mut self, found: &Found, slot: &Slot) {
        let mut at = Kinematics {
            position_enu_m: self.aided.idle.anchor,
            velocity_enu_mps: Vector3::zeros(),
            world_from_body: found.aligned.world_from_body,
        };
        at.position_enu_m.z = found.altitude_m.unwrap_or(at.position_enu_m.z);
        let z = if found.altitude_m.is_some() { ALTITUDE_SIGMA_M } else { POSITION_SIGMA_M };
        let yaw = if found.field_ut.is_some() { align::YAW_SIGMA_FIELD_RAD } else { UNKNOWN_YAW_SIGMA_RAD };
        let (tilt, gyro_bias, velocity) = match found.aligned.at_rest {
            true => (align::TILT_SIGMA_REST_RAD, align::GYRO_BIAS_SIGMA_REST_RADPS, 0.1),
            false => (align::TILT_SIGMA_MOVING_RAD, self.model.imus.gyro.bias_prior, 3.0),
        };
        for (lane, biases) in self.lanes.iter_mut().zip(&found.biases) {
            lane.begin(&at, biases, [POSITION_SIGMA_M, velocity, tilt, yaw, gyro_bias], &self.model);
            lane.p[(2, 2)] = z * z;
        }
        self.aided.yaw.known |= found.field_ut.is_some();
        self.aided.field_ut = found.field_ut.map(|field| field.norm());
        self.start = None;
        self.judges.evidence.forgive();
        let there = slot.imus.map(|mean| f64::from(u8::from(mean.is_some())));
        let count: f64 = there.iter().sum();
        let weights = there.map(|one| one / count.max(1.0));
        self.fused.mixture = Mixture { weights, biases: found.biases, ..Mixture::new() };
        self.fused.at = at;
        self.rebase(slot);
    }

    /// Lasers that step, against what the IMUs felt; what each reads beyond its reach, m.
    fn compare_heights(&mut self, slot: &Slot) -> [f64; MAX_HEIGHTS] {
        let Kinematics { position_enu_m, velocity_enu_mps, world_from_body } = self.fused.at;
        let mut felt = self.common(&slot.imus);
        let up = |felt: &Six| (world_from_body * part(felt, 0)).z - self.model.imus.gravity_mps2;
        let by_imus_mps2 = up(&felt);
        felt[2] += self.fused.mixture.thrust * (slot.thrust_mps2 - felt[2]);
        let up_mps2 = up(&felt);
        let climb_mps = velocity_enu_mps.z + up_mps2 * SLOT_S;
        let z_m = position_enu_m.z + 0.5 * (velocity_enu_mps.z + climb_mps) * SLOT_S;
        let heights = &mut self.judges.heights;
        let mut samples = slot.heights;
        for (i, place) in samples.iter_mut().enumerate() {
            let Some((time, height_m)) = place else { continue };
            *height_m -= heights.off_m(i, z_m);
            if !heights.admit(i, *height_m - (z_m - climb_mps * slot.age_s(*time)), *time) {
                *place = None;
            }
        }
        let by_thrust = self.fused.mixture.thrust;
        heights.split.take(slot.end(), (z_m, climb_mps), (up_mps2, by_thrust), &samples);
        // What stands on the floor, its motors idling or not, tells no delay.
        let idles = self.clock.resting > 0 || !slot.standing && self.clock.unladen >= CARRIED_SLOTS;
        if !idles {
            let sound = std::array::from_fn(|i| samples[i].filter(|_| heights.weight(i) >= 1.0));
            let pose = slot.pose.map(|pose| (pose.time, pose.position_enu_m.z));
            self.delays.take(slot.end(), (by_imus_mps2, by_thrust), &sound, pose);
        }
        let mut beyond_m = [0.0; MAX_HEIGHTS];
        for (i, (beyond_m, sample)) in beyond_m.iter_mut().zip(samples).enumerate() {
            let Some((time, height_m)) = sample else { continue };
            *beyond_m = heights.beyond_reach_m(i, height_m - (z_m - climb_mps * slot.age_s(time)), time);
        }
        beyond_m
    }

    /// What this slot aids.
    fn note(&mut self, slot: &Slot) {
        let end = slot.end();
        if slot.pose.is_some() {
            self.aided.pose.note(end, true);
        }
        if slot.pose.is_some() || slot.gnss.is_some() {
            self.aided.horizontal.note(end, true);
        }
        let used = |(i, height): (usize, &Option<_>)| height.is_some() && self.judges.heights.weight(i) > 0.0;
        if slot.heights.iter().enumerate().any(used) {
            self.aided.heights.note(end, true);
        }
        let other = slot.barometers.iter().any(Option::is_some) && !self.aided.heights.ever();
        if self.aided.heights.within(end, 0.0) || slot.pose.is_some() || other {
            self.aided.vertical.note(end, true);
        }
    }

    /// Predicts and corrects every lane; what each makes of the slot.
    fn correct(&mut self, slot: &Slot, beyond_m: [f64; MAX_HEIGHTS]) -> PerLane<Option<Heard>> {
        let end = slot.end();
        let unaided = self.unaided(end);
        let resting = self.clock.resting > REST_SLOTS;
        let gnss_height_m = self.gnss_height_m(slot, resting);
        let wash_sigma_m = self.aided.floor.wash_sigma_m(self.fused.at.position_enu_m.z, resting);
        let pose = self.aided.pose.within(end, POSE_MEMORY_S);
        let felt = |axis: usize| median(slot.imus.iter().flatten().map(|mean| mean[axis]));
        let felt_mps2 = Vector3::from_fn(|axis, _| felt(axis));
        let imus = slot.imus.iter().flatten().count();
        let bias_mps2 = self.model.imus.accel.bias_prior / (imus.max(1) as f64).sqrt();
        let speed_mps = self.fused.at.world_from_body.inverse() * self.fused.at.velocity_enu_mps;
        let drag = self.thrust.drag(slot.thrust_mps2, &felt_mps2, &speed_mps, bias_mps2);
        let around = Around {
            model: &self.model,
            heights: &self.judges.heights,
            beyond_m,
            field_ut: self.aided.field_ut.filter(|_| !pose),
            drag,
            barometers: !self.aided.heights.ever(),
            wash_sigma_m,
            gnss_height_m,
            yaw_known: self.aided.yaw.known,
            unaided,
        };
        let common = self.common(&slot.imus);
        let shaken = super::median_six(slot.roughness.iter().flatten()).map(|s| if s.is_finite() { s } else { 0.0 });
        let rectified = noise::rectified(&shaken);
        // Vibration goes on; a jolt, as when strings or the floor catch the vehicle, is over with its slot, and not of the thrust. Without a
        // height nothing would correct what vibration that begins rectifies in that slot.
        let (squares, before_mps2) = (&mut self.fused.rectified_squares, &mut self.fused.rectified_before_mps2);
        let lasting_mps2 = match self.aided.heights.ever() {
            true => rectified[2].min(before_mps2.max(squares.z.sqrt())),
            false => rectified[2],
        };
        *before_mps2 = rectified[2];
        *squares += (part(&rectified.component_mul(&rectified), 0) - *squares) * USUAL_GAIN;
        let carried = self.clock.unladen < CARRIED_SLOTS;
        let beside_mps2 = self.thrust.beside_mps2(slot.thrust_mps2, felt_mps2.z);
        let share = if carried { noise::share(lasting_mps2, beside_mps2) } else { 0.0 };
        self.fused.mixture = Mixture { thrust: share, ..self.fused.mixture.shaken(&shaken) };
        let mut scratch = Residuals::new();
        let mut heard = [None; LANES];
        let mut corrected_mps = 0.0;
        for (i, (lane, heard)) in self.lanes.iter_mut().zip(&mut heard).enumerate() {
            if self.fused.silent[i] > SILENT_SLOTS {
                continue;
            }
            let mut sigma = self.judges.noise.of(i).zip_map(&rectified, f64::hypot);
            sigma[2] = noise::mixed(sigma[2], share);
            // Without a sample of its own it goes on with the others'.
            let mut mean = slot.imus[i].unwrap_or_else(|| common + lane.biases());
            mean[2] += share * (slot.thrust_mps2 - (mean[2] - lane.accel_bias.z));
            lane.predict(end, &mean, &sigma, &self.model);
            let named = i == self.fused.best;
            let residuals = if named { &mut self.estimate.residuals } else { &mut scratch };
            let climb_mps = lane.at.velocity_enu_mps.z;
            let mut correction = Correction { lane, heard: Heard::default(), residuals, named };
            correction.take(slot, &around, &sigma);
            let Heard { surprise, rows, .. } = correction.heard;
            let up = lane.at.world_from_body * Vector3::z();
            if lane.is_sound() {
                corrected_mps += self.fused.mixture.weights[i] * (lane.at.velocity_enu_mps.z - climb_mps);
                *heard = Some(Heard { surprise, rows, stuck: slot.stuck[i], up, z_m: lane.at.position_enu_m.z });
            } else {
                let best = self.fused.at;
                lane.begin(&best, &Six::zeros(), [1.0, 0.5, 0.1, 0.2, 0.01], &self.model);
            }
        }
        self.thrust.learn(corrected_mps, share, slot.thrust_mps2);
        heard
    }

    /// Height over the floor by GNSS, m: none beside lasers, and beside a barometer none at rest.
    fn gnss_height_m(&mut self, slot: &Slot, resting: bool) -> Option<f64> {
        let gnss_m = slot.gnss.filter(|_| !self.aided.heights.ever())?.position_enu_m.z;
        if !self.has_barometer() && slot.barometers.iter().all(Option::is_none) {
            return Some(gnss_m);
        }
        self.aided.floor.height_m(gnss_m, self.fused.at.position_enu_m.z, resting)
    }

    fn has_barometer(&self) -> bool {
        self.lanes.iter().any(|lane| lane.barometer_offset_m.iter().any(Option::is_some))
    }

    /// What no sensor measures, where that is due.
    fn unaided(&mut self, end: FlightTime) -> Option<Unaided> {
        let horizontal = !self.aided.horizontal.within(end, HORIZONTAL_MEMORY_S);
        let vertical = !self.aided.vertical.within(end, VERTICAL_MEMORY_S);
        let axes = [horizontal, horizontal, vertical];
        let resting = self.clock.resting > REST_SLOTS;
        let standing = resting && self.has_barometer() && !self.aided.heights.ever();
        for (axis, unknown) in axes.into_iter().enumerate() {
            if !(unknown || axis == 2 && standing) {
                self.aided.idle.anchor[axis] = self.fused.at.position_enu_m[axis];
            }
        }
        let anchor = self.aided.idle.anchor;
        let due = self.aided.idle.due(end).filter(|_| resting || axes.contains(&true));
        due.map(|since_s| Unaided { since_s, axes, resting, standing, anchor })
    }

    /// Weighted mean of the IMUs less their biases; a vehicle that does not move where there is none.
    pub(super) fn common(&self, means: &PerLane<Option<Six>>) -> Six {
        let told = std::array::from_fn(|i| means[i].map(|mean| mean - self.lanes[i].biases()));
        if let Some(mean) = self.fused.mixture.mean(&told, 1.0) {
            return mean;
        }
        let up = self.fused.at.world_from_body.inverse() * Vector3::z() * self.model.imus.gravity_mps2;
        Six::new(up.x, up.y, up.z, 0.0, 0.0, 0.0)
    }

    fn fuse(&mut self) {
        let votes = self.judges.vote.against(&self.judges.evidence.are_present());
        let mut weights = self.judges.evidence.weights(&votes);
        let heaviest = weights.iter().enumerate().max_by(|a, b| a.1.total_cmp(b.1));
        let best = heaviest.map_or(0, |(i, _)| i);
        let Some(Kinematics { position_enu_m: place, velocity_enu_mps: speed, world_from_body: reference }) =
            self.lanes.get(best).map(|lane| lane.at)
        else {
            return;
        };
        // However little it weighs, one that falls would draw the mean along.
        let away = |at: &Kinematics| {
            (at.position_enu_m.z - place.z).abs() > AWAY.0 || (at.velocity_enu_mps.z - speed.z).abs() > AWAY.1
        };
        for (weight, _) in weights.iter_mut().zip(&self.lanes).filter(|(_, lane)| away(&lane.at)) {
            *weight = 0.0;
        }
        let sum: f64 = weights.iter().sum();
        weights.iter_mut().for_each(|weight| *weight /= sum.max(f64::MIN_POSITIVE));
        let mut at = Kinematics {
            position_enu_m: Vector3::zeros(),
            velocity_enu_mps: Vector3::zeros(),
            world_from_body: reference,
        };
        let mut turned = Vector3::zeros();
        for (lane, weight) in self.lanes.iter().zip(weights).filter(|(_, weight)| *weight > 0.0) {
            at.position_enu_m += lane.at.position_enu_m * weight;
            at.velocity_enu_mps += lane.at.velocity_enu_mps * weight;
            turned += (lane.at.world_from_body * reference.inverse()).scaled_axis() * weight;
        }
        at.world_from_body = UnitQuaternion::from_scaled_axis(turned) * reference;
        if weights.iter().sum::<f64>() > 0.5 {
            self.fused.at = at;
            self.fused.mixture.weights = weights;
            self.fused.best = best;
        }
        let weighty = self.lanes.iter().zip(weights).filter(|(_, weight)| *weight > WEIGHTY);
        let most_rad = apart_rad(weighty.map(|(lane, _)| &lane.at.world_from_body));
        // Where all are surprised by more than they expect, or have long been apart, they differ by more.
        let usual_rad = &mut self.fused.usual_rad;
        let limit_rad = CONTRADICTION_RAD * self.judges.evidence.average().sqrt() + *usual_rad;
        *usual_rad += USUAL_GAIN * (most_rad.min(CONTRADICTION_RAD) - *usual_rad);
        self.fused.contradicted = if most_rad > limit_rad { self.fused.contradicted.saturating_add(1) } else { 0 };
    }

    fn judge_heights(&mut self, slot: &Slot, learning: bool) {
        let Kinematics { position_enu_m, velocity_enu_mps, .. } = self.fused.at;
        for (i, sample) in slot.heights.iter().enumerate() {
            let Some((time, height_m)) = *sample else { continue };
            let z_m = position_enu_m.z - velocity_enu_mps.z * slot.age_s(time);
            let off_m = self.judges.heights.off_m(i, z_m);
            self.judges.heights.take(i, time, height_m - off_m - z_m);
        }
        let judging = f64::from(self.clock.flown) * SLOT_S > JUDGING_S;
        let _ = self.judges.heights.decode(slot.end(), position_enu_m.z, learning, judging);
    }

    /// Biases are learned by those in no doubt; a lane long excluded begins again from the others.
    fn heal(&mut self, learning: bool) {
        let present = self.judges.evidence.are_present();
        let there = |i: usize| present[i].then(|| self.lanes[i].biases());
        let biases: PerLane<Option<Six>> = std::array::from_fn(there);
        let doubted: PerLane<bool> = std::array::from_fn(|i| self.judges.evidence.is_doubted(i));
        self.judges.vote.learn(&biases, &doubted, learning);
        let best = self.fused.best;
        for i in (0..LANES).filter(|i| *i != best) {
            if self.judges.evidence.is_to_heal(i) {
                self.begin_again(i);
            }
        }
        self.fused.mixture.biases = std::array::from_fn(|i| self.lanes[i].biases());
    }

    /// This lane begins again from the best one.
    fn begin_again(&mut self, i: usize) {
        let biases = self.judges.vote.bias(i).unwrap_or_else(Six::zeros);
        let (at, from) = (self.fused.at, self.lanes[self.fused.best].clone());
        self.lanes[i].heal(&from, &at, &biases);
        self.judges.evidence.healed(i);
    }

    fn rebase(&mut self, slot: &Slot) {
        let of = |integral: &Integral| integral.total_at(slot.number + 1);
        let integrals = self.slots.integrals();
        let totals = std::array::from_fn(|i| integrals.get(i).and_then(of));
        self.predictor.rebase(slot.end(), &self.fused.at, &totals, &self.fused.mixture);
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::*;

    #[test]
    fn two_against_two_contradict_and_those_about_a_middle_do_not() {
        let apart = |rolls_rad: [f64; 4]| {
            let attitudes = rolls_rad.map(|roll| UnitQuaternion::from_scaled_axis(Vector3::x() * roll));
            apart_rad(attitudes.iter())
        };
        for (rolls_rad, found_rad) in
            [([0.0, 0.01, 0.39, 0.4], 0.39), ([0.0, 0.4, 0.4, 0.4], 0.4), ([-0.2, 0.0, 0.0, 0.2], 0.2), ([0.3; 4], 0.0)]
        {
            assert!((apart(rolls_rad) - found_rad).abs() < 1e-9, "{rolls_rad:?}: {}", apart(rolls_rad));
        }
        assert_eq!(apart_rad([].iter()), 0.0);
    }
}
