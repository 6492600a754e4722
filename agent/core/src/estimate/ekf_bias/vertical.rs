//! Laser heights and barometers.

use arrayvec::ArrayVec;
use nalgebra::Vector3;
use plumbline_proto::ids::SensorId;
use plumbline_proto::time::FlightTime;
use plumbline_proto::v1::SensorKind;

use super::EkfBias;
use super::aiding::{VERTICAL_MEMORY_S, row};
use super::covariance::{augment_barometer, ix};
use crate::estimate::aiding::freshness::{Freshness, RECOVERY_S};
use crate::estimate::filter::kalman::forget;
use crate::estimate::{Channel, median};
use crate::sensor::Accuracy;
use crate::sensor::{MAX_BAROMETERS, MAX_HEIGHTS, SensorFrame};
use crate::sensor::{barometer, height};

/// Heights older than this do not take part in deciding where the floor is, s.
const HEIGHT_FRESH_S: f64 = 0.3;

/// What heights correct. Vibration that shows as an acceleration upward would be taken for tilt, which makes little of it: lost within
/// seconds, and certain of itself.
const VERTICAL: [usize; 5] = [ix::POSITION + 2, ix::VELOCITY + 2, ix::ACCEL_BIAS + 2, ix::BAROMETER, ix::BAROMETER + 1];

/// Laser heights.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Heights {
    pub freshness: Freshness,
    pub present: bool,
    /// Time of the first.
    pub since: Option<FlightTime>,
    /// Sigmas beyond which one is taken as if it were so far from the median; `None` for no limit.
    pub reach: Option<f64>,
    /// Time and innovation of the last of each, against the sum of corrections.
    latest: [Option<(FlightTime, f64)>; MAX_HEIGHTS],
}

/// Barometers; each has an offset among the states once it is known.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Barometers {
    freshness: [Freshness; MAX_BAROMETERS],
    known: [bool; MAX_BAROMETERS],
    pub present: bool,
}

impl Barometers {
    /// Offsets are found again.
    pub fn forget(&mut self) {
        self.known = [false; MAX_BAROMETERS];
    }
}

impl EkfBias {
    /// Innovations of the heights that arrived; kept, so that it is known after alignment which of them agree.
    pub(super) fn take_heights(&mut self, frame: &SensorFrame) -> ArrayVec<(usize, f64), MAX_HEIGHTS> {
        let mut arrived: ArrayVec<(usize, f64), MAX_HEIGHTS> = ArrayVec::new();
        for (i, sample) in frame.heights.iter().enumerate() {
            let Some(sample) = sample.filter(|s| s.height_m.is_finite()) else { continue };
            let innovation = sample.height_m - self.past(sample.time, frame.time).0.position_enu_m.z;
            arrived.push((i, innovation));
            // Kept against the sum of corrections, so that it stays comparable after more of them.
            self.aided.heights.latest[i] = Some((frame.time, innovation + self.history.vertical_corrections().0));
        }
        if !arrived.is_empty() {
            self.aided.heights.present = true;
            self.aided.heights.since.get_or_insert(frame.time);
        }
        arrived
    }

    pub(super) fn aid_heights(&mut self, frame: &SensorFrame) {
        let mut arrived = self.take_heights(frame);
        if arrived.is_empty() {
            return;
        }
        if !self.aided.heights.freshness.ever() {
            // All of them before one is used: instances may report in turns.
            if self.aided.heights.since.is_none_or(|since| frame.time.seconds_since(since) < HEIGHT_FRESH_S) {
                return;
            }
            self.recover_height(frame.time, true);
        }
        let centre = if arrived.len() == 2 { 0.0 } else { median(arrived.iter().map(|(_, y)| *y)) };
        arrived.sort_unstable_by(|a, b| (a.1 - centre).abs().total_cmp(&(b.1 - centre).abs()));
        let noise = self.model.heights;
        let mut used = false;
        for (i, _) in arrived {
            let Some(sample) = frame.heights[i] else { continue };
            let (past, delay_s) = self.past(sample.time, frame.time);
            let measured = height::height(&past, sample.height_m);
            let of = (SensorId::new(SensorKind::Height, i as u8 + 1), Channel::Height);
            let mut row = row(of, &measured, noise, delay_s);
            row.innovation -= self.beyond_reach(i, frame.time);
            row.refused = self.contradicted(i, frame.time);
            row.corrects = Some(&VERTICAL);
            // Not one that most of the others agree with: then it is the estimate that is off, and a hard gate would
            // lock all of them out.
            used |= if self.agreed(i, frame.time) { self.correct_past_gate(&row) } else { self.correct(&row) };
        }
        self.aided.heights.freshness.note(frame.time, used);
        if used {
            self.aided.vertical.note(frame.time, true);
        } else if self.aided.heights.freshness.rejected_s(frame.time) > RECOVERY_S {
            self.recover_height(frame.time, false);
        }
    }

    /// Innovations of the recent heights, as they would be now.
    fn fresh_heights(&self, now: FlightTime) -> ArrayVec<(usize, f64), MAX_HEIGHTS> {
        let fresh = |(i, last): (usize, &Option<(FlightTime, f64)>)| {
            last.filter(|(time, _)| now.seconds_since(*time) < HEIGHT_FRESH_S)
                .map(|(_, y)| (i, y - self.history.vertical_corrections().0))
        };
        self.aided.heights.latest.iter().enumerate().filter_map(fresh).collect()
    }

    /// How far two healthy recent heights may differ, m.
    fn heights_differ_m(&self) -> f64 {
        // Samples up to 0.3 s apart in a climb predicted to 0.2 m/s: another 6 cm.
        std::f64::consts::SQRT_2 * self.model.heights.gate * self.model.heights.sigma + 0.06
    }

    /// How much further height `i` lies from the median of at least three than it can reach, m.
    fn beyond_reach(&self, i: usize, now: FlightTime) -> f64 {
        let Some(reach) = self.aided.heights.reach.map(|reach| reach * self.model.heights.sigma) else { return 0.0 };
        let fresh = self.fresh_heights(now);
        let centre = median(fresh.iter().map(|(_, y)| *y));
        let own = fresh.iter().find(|(k, _)| *k == i).filter(|_| fresh.len() >= 3);
        own.map_or(0.0, |(_, y)| (y - centre) - (y - centre).clamp(-reach, reach))
    }

    /// Does height `i` contradict the median of at least three? It is then refused even where the gate,
    /// wide after a silence or already dragged along, would let it in.
    fn contradicted(&self, i: usize, now: FlightTime) -> bool {
        let fresh = self.fresh_heights(now);
        let centre = median(fresh.iter().map(|(_, y)| *y));
        fresh.len() >= 3 && fresh.iter().any(|(k, y)| *k == i && (y - centre).abs() > self.heights_differ_m())
    }

    /// Is height `i` one of several recent ones, more than half of all, that agree with each other?
    fn agreed(&self, i: usize, now: FlightTime) -> bool {
        let fresh = self.fresh_heights(now);
        let near = self.heights_differ_m();
        let Some((_, own)) = fresh.iter().find(|(k, _)| *k == i) else { return false };
        let agree = fresh.iter().filter(|(_, y)| (y - own).abs() <= near).count();
        agree >= 2 && 2 * agree > fresh.len()
    }

    /// Every height has been rejected for long (or none has been used yet): the floor is where most of them
    /// agree that it is. One alone is used only if nothing else measures the altitude.
    fn recover_height(&mut self, now: FlightTime, first: bool) {
        let fresh = self.fresh_heights(now);
        let centre = median(fresh.iter().map(|(_, y)| *y));
        let near = self.heights_differ_m();
        let agree = fresh.iter().filter(|(_, y)| (y - centre).abs() <= near).count();
        let majority = agree >= 2 && 2 * agree > fresh.len();
        let alone = fresh.len() == 1
            && (first || !(self.aided.vertical.within(now, VERTICAL_MEMORY_S) || self.aided.barometers.present));
        // Two that differ from the first sample on: nothing can choose; the middle is taken, and their rejections
        // degrade the estimate.
        if majority || alone || first {
            self.shift(Vector3::new(0.0, 0.0, centre));
            forget(&mut self.p, ix::POSITION + 2, near * near);
            if !first {
                let v = ix::VELOCITY + 2;
                self.p[(v, v)] += 0.5;
            }
            self.aided.barometers.forget();
            self.aided.heights.freshness.note(now, true);
            self.aided.vertical.note(now, true);
        }
    }

    pub(super) fn aid_barometers(&mut self, frame: &SensorFrame) {
        let resting = self.rests();
        for (i, sample) in frame.barometers.iter().enumerate() {
            let Some(sample) = sample else { continue };
            let altitude = self.model.barometers.altitude_m(sample);
            if !altitude.is_finite() {
                continue;
            }
            self.aided.barometers.present = true;
            let (past, delay_s) = self.past(sample.time, frame.time);
            let noise = self.model.barometers.altitude;
            let state = ix::BAROMETER + i;
            if !self.aided.barometers.known[i] {
                self.aided.barometers.known[i] = true;
                self.state.barometer_offset_m[i] = altitude - past.position_enu_m.z;
                augment_barometer(&mut self.p, state, noise.sigma * noise.sigma);
                continue;
            }
            let wash_m = self.aided.floor.wash_sigma_m(past.position_enu_m.z, resting);
            // Where lasers hold the altitude the wash goes into the offset.
            let wash_m = if self.aided.heights.present { 0.0 } else { wash_m };
            let noise = Accuracy { sigma: noise.sigma.hypot(wash_m), ..noise };
            let measured = barometer::altitude(&past, altitude, self.state.barometer_offset_m[i]);
            let of = (SensorId::new(SensorKind::Barometer, i as u8 + 1), Channel::PressureAltitude);
            let mut row = row(of, &measured, noise, delay_s);
            row.h[state] = 1.0;
            row.corrects = Some(&VERTICAL);
            let used = self.correct(&row);
            self.aided.barometers.freshness[i].note(frame.time, used);
            if used {
                if !self.aided.heights.present {
                    self.aided.vertical.note(frame.time, true);
                }
            } else if self.aided.barometers.freshness[i].rejected_s(frame.time) > RECOVERY_S {
                // A door opened: the offset is new, the altitude is not.
                self.state.barometer_offset_m[i] = altitude - past.position_enu_m.z;
                augment_barometer(&mut self.p, state, noise.sigma * noise.sigma);
                self.aided.barometers.freshness[i].note(frame.time, true);
            }
        }
    }
}
