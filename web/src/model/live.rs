//! What the page knows of one vehicle: the newest message of every topic, the curves of the charts,
//! the attacks and steps seen. Fed with the ground's batches (`reading.rs`); knows no socket and no clock.
//!
//! A recorded flight is read by the same code: see [`Live::recorded`].

mod log;
mod reading;

use std::collections::BTreeMap;

use plumbline_proto::v1::{self, EstimatorKind};
#[cfg(test)]
use plumbline_proto::{Kind, Message, codec};

pub use self::log::{Log, State};
use self::reading::Reading;
use super::{
    clock::Clock,
    curves::{Curve, Curves, GAP_S},
    topic::Topic,
};

/// A curve has ended after this long at the latest, s, however far apart its last samples are: an outage is no period.
const SLOWEST_S: f64 = 5.0;

/// What the ground itself says of a vehicle; it does not end with a boot.
#[derive(Debug, Default)]
pub struct GroundView {
    /// Link as the ground sees it (wall time).
    pub link: Option<v1::LinkStatus>,
    /// Recording as the ground sees it.
    pub recording: Option<v1::RecordingStatus>,
    /// Who holds control.
    pub lease: Option<v1::ControlLease>,
}

/// Everything known of one vehicle.
#[derive(Debug, Default)]
pub struct Live {
    /// Who and what flies.
    pub description: Topic<v1::Description>,
    /// State of the agent.
    pub status: Topic<v1::Status>,
    /// Gains in use.
    pub gains: Topic<v1::GainsInUse>,
    /// The secure estimator's account of itself.
    pub secure: Topic<v1::SecureStatus>,
    /// The attack schedule.
    pub attacks: Topic<v1::AttackState>,
    /// Newest tick of the controller.
    pub control: Topic<v1::Control>,
    /// Truth, where it is known.
    pub truth: Topic<v1::Truth>,
    /// Newest estimate of each estimator, by its number.
    pub estimates: BTreeMap<u16, Topic<v1::Estimate>>,
    /// Newest residual of each scalar, by estimator, sensor kind, instance and channel.
    pub residuals: BTreeMap<(u16, i32, u32, i32), Topic<v1::Residual>>,
    /// How each device of a real vehicle is doing, by its place in the configuration.
    pub devices: BTreeMap<u16, Topic<v1::DeviceState>>,
    /// What the ground says.
    pub ground: GroundView,
    /// What happened.
    pub log: Log,
    /// Curves of the charts.
    pub curves: Curves,
    /// Bounds of the attack envelope, as things are now.
    pub reach: Option<super::envelope::Table>,
    /// Flight time: the newest seen, and now.
    pub clock: Clock,
    /// Of the battery, as it is shown.
    volts: f64,
    reading: Reading,
}

impl Live {
    /// For a recorded flight: nothing is forgotten, nothing is a snapshot.
    pub fn recorded() -> Self {
        Self { log: Log::unbounded(), curves: Curves::unbounded(), reading: Reading::recorded(0), ..Self::default() }
    }

    /// What the ground says of the past of a vehicle since boot `boot` (see [`Live::boot`]; 0: of whatever boot it is in),
    /// to be read in pieces and then laid under the live data.
    pub fn past(boot: u64) -> Self {
        Self { log: Log::unbounded(), curves: Curves::short(), reading: Reading::recorded(boot), ..Self::default() }
    }

    /// Lays the past under what has come through the connection that is open now: curves grow backwards, to what was
    /// there before it; newest values stay as they are.
    pub fn fill(&mut self, past: Self) {
        if past.boot() != 0 && past.boot() != self.boot() {
            // Its times are on another axis.
            return;
        }
        self.curves.fill(self.reading.connected_from_us as f64 * 1e-6, &past.curves);
        self.log.fill(past.log);
    }

    /// Is the newest message of this topic too old to be shown as what is? Never of a recording that is flown again.
    pub fn is_old<T>(&self, topic: &Topic<T>, local_ms: f64) -> bool {
        topic.get().is_some() && !self.is_replay() && topic.is_stale(self.clock.now_us(local_ms))
    }

    /// How old the newest message is, s; `None` before the first one, and for a recording that is flown again, which
    /// may stand still.
    pub fn age_s(&self, local_ms: f64) -> Option<f64> {
        let newest_us = self.clock.newest_us();
        let now_us = self.clock.flight_now_us(local_ms).filter(|_| newest_us > 0 && !self.is_replay())?;
        Some(((now_us - newest_us as f64) * 1e-6).max(0.0))
    }

    /// Mode of flight; unspecified before the first status.
    pub fn mode(&self) -> v1::Mode {
        self.status.get().map_or(v1::Mode::Unspecified, |status| status.mode())
    }

    /// Who holds control; empty: nobody.
    pub fn holder(&self) -> &str {
        self.ground.lease.as_ref().map_or("", |lease| lease.holder.as_str())
    }

    /// The altitude setpoint in use, m: where the profile is, not where it goes.
    pub fn setpoint_m(&self) -> Option<f64> {
        self.control.get().and_then(|c| c.setpoint.as_ref()).and_then(|s| s.altitude_m)
    }

    /// Voltage of the battery without the trembling of its last digit, V; `None` without a battery.
    pub fn battery_v(&self) -> Option<f64> {
        self.status.get().filter(|status| status.battery_v > 0.0).map(|_| self.volts)
    }

    /// Is a recording flown again?
    pub fn is_replay(&self) -> bool {
        self.description.get().is_some_and(|d| d.vehicle == "replay")
    }

    /// The estimator in the loop, by its number; 0 when nothing says.
    pub fn in_loop(&self) -> u16 {
        if let Some(status) = self.status.get()
            && status.estimator_in_loop != 0
        {
            return status.estimator_in_loop as u16;
        }
        let flagged = self.estimates.iter().find(|(_, t)| t.get().is_some_and(|e| e.in_loop));
        flagged.or_else(|| self.estimates.iter().next()).map_or(0, |(number, _)| *number)
    }

    /// The newest estimate of the estimator in the loop.
    pub fn estimate(&self) -> Option<&Topic<v1::Estimate>> {
        self.estimates.get(&self.in_loop())
    }

    /// The sensor instances that the secure estimator judges, in the suite's order.
    pub fn suspicion_rows(&self) -> Vec<(i32, u32)> {
        let all = self.curves.names_between(Curve::Suspicion(i32::MIN, 0), Curve::Suspicion(i32::MAX, u32::MAX));
        let judged = all.filter_map(|c| match c {
            Curve::Suspicion(sensor, instance) => Some((sensor, instance)),
            _ => None,
        });
        let mut rows: Vec<(i32, u32)> = judged.collect();
        rows.sort_by_key(suite_order);
        rows
    }

    /// The sensor instances that have residuals under `estimator`, in the suite's order.
    pub fn residual_rows(&self, estimator: u16) -> Vec<(i32, u32)> {
        let mut rows: Vec<(i32, u32)> = Vec::new();
        for (number, sensor, instance, _) in self.residuals.keys() {
            if *number == estimator && !rows.contains(&(*sensor, *instance)) {
                rows.push((*sensor, *instance));
            }
        }
        rows.sort_by_key(suite_order);
        rows
    }

    /// The residual with the largest ratio of one sensor instance, fresh ones before stale ones; and whether the sensor has
    /// fallen silent since.
    pub fn worst_residual(
        &self,
        estimator: u16,
        sensor: i32,
        instance: u32,
        local_ms: f64,
    ) -> Option<(&v1::Residual, bool)> {
        let range = (estimator, sensor, instance, i32::MIN)..=(estimator, sensor, instance, i32::MAX);
        let newest = self.residuals.range(range.clone()).filter_map(|(_, t)| t.time_us()).max()?;
        let (topic, worst) = self
            .residuals
            .range(range)
            .filter_map(|(_, topic)| Some((topic, topic.get()?)))
            .filter(|(topic, _)| topic.time_us().is_some_and(|time_us| newest - time_us < 1_000_000))
            .max_by(|(_, a), (_, b)| a.ratio.total_cmp(&b.ratio))?;
        Some((worst, self.is_past(newest as f64 * 1e-6, GAP_S, local_ms) && self.is_old(topic, local_ms)))
    }

    /// Has nothing come of this curve for longer than its line bridges, and three times as long as between its last two samples?
    pub fn has_ended(&self, curve: Curve, local_ms: f64) -> bool {
        let Some(series) = self.curves.get(curve) else { return false };
        let Some((last_s, _)) = series.last() else { return false };
        let before = series.end().checked_sub(2).and_then(|number| series.get(number));
        let slow_s = before.map_or(0.0, |(before_s, _)| 3.0 * (last_s - before_s)).min(SLOWEST_S);
        self.is_past(last_s, series.max_gap_s().max(slow_s), local_ms)
    }

    /// Is `time_s` longer ago than `gap_s`? Nothing is of a recording that is flown again.
    fn is_past(&self, time_s: f64, gap_s: f64, local_ms: f64) -> bool {
        !self.is_replay() && self.clock.now_us(local_ms) * 1e-6 - time_s > gap_s
    }

    /// Estimators that this vehicle offers.
    pub fn offered_estimators(&self) -> Vec<EstimatorKind> {
        self.description
            .get()
            .map(|d| d.estimators().filter(|k| *k != EstimatorKind::Unspecified).collect())
            .unwrap_or_default()
    }

    /// Flight time of the right edge of the live charts, µs, at `local_ms`.
    ///
    /// Glides with the clock while data arrives; stands two seconds after the last message, so that an
    /// outage shows as a gap and not as an empty chart. 0 before the first one, whatever the ground says of the time.
    pub fn edge_us(&self, local_ms: f64) -> f64 {
        let newest = self.clock.newest_us() as f64;
        if newest == 0.0 || self.is_replay() {
            return newest;
        }
        self.clock.flight_now_us(local_ms).map_or(newest, |now| now.clamp(newest, newest + 2e6))
    }
}

/// Encodes one message as a frame.
#[cfg(test)]
pub fn append<M: Message>(batch: &mut Vec<u8>, kind: Kind, instance: u16, sequence: u64, time_us: u64, message: &M) {
    if batch.is_empty() {
        codec::begin_batch(batch);
    }
    codec::encode_message(batch, kind, instance, sequence, time_us, message);
}

/// Heights first: they are what altitude tests watch; then IMUs, then the rest.
fn suite_order((sensor, instance): &(i32, u32)) -> (u8, i32, u32) {
    let rank = match v1::SensorKind::try_from(*sensor) {
        Ok(v1::SensorKind::Height) => 0,
        Ok(v1::SensorKind::Imu) => 1,
        Ok(v1::SensorKind::Barometer) => 2,
        _ => 3,
    };
    (rank, *sensor, *instance)
}

#[cfg(test)]
mod tests;
