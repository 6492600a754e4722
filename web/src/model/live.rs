//! What the page knows of one vehicle: the newest message of every topic, the curves of the charts,
//! the attacks and steps seen. Fed with the ground's batches; knows no socket and no clock.
//!
//! A recorded flight is read by the same code: see [`Live::recorded`].

use std::collections::{BTreeMap, HashMap, VecDeque};

use plumbline_proto::{
    Kind, Message, codec,
    v1::{self, EstimatorKind, Reception},
};

use super::{
    clock::Clock,
    curves::{Curve, Curves},
    spans::Spans,
    topic::Topic,
};

/// Events kept for the log; the oldest go first.
const MAX_EVENTS: usize = 400;
/// Steps kept; the oldest go first.
const MAX_STEPS: usize = 200;

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
    /// Link as the ground sees it (wall time).
    pub link: Option<v1::LinkStatus>,
    /// Recording as the ground sees it.
    pub recording: Option<v1::RecordingStatus>,
    /// Who holds control.
    pub lease: Option<v1::ControlLease>,
    /// Steps of the setpoint, oldest first.
    pub steps: VecDeque<v1::StepResponse>,
    /// Events, oldest first.
    pub events: VecDeque<v1::Event>,
    /// Number of events seen since the page opened; tells a reader that there are new ones.
    pub events_seen: u64,
    /// Attacks by time, for shading.
    pub spans: Spans,
    /// Curves of the charts.
    pub curves: Curves,
    /// Flight time now.
    pub clock: Clock,
    /// Newest flight time seen, µs.
    pub newest_us: u64,
    /// Frames this build could not read, and why the last one could not be.
    pub unreadable: u64,
    /// Reason of the newest unreadable frame.
    pub unreadable_reason: String,
    charted: HashMap<(u16, u16), u64>,
    /// Newest flight time before the connection that is open now.
    connected_from_us: u64,
    boot_wall_us: u64,
    recorded: bool,
}

impl Live {
    /// For a recorded flight: nothing is forgotten, nothing is a snapshot.
    pub fn recorded() -> Self {
        Self { recorded: true, curves: Curves::unbounded(), ..Self::default() }
    }

    /// A new connection begins: what was missed since the last one comes apart, see [`Live::fill`].
    pub fn connection_opened(&mut self) {
        self.connected_from_us = self.newest_us;
    }

    /// What the ground says of the past of a vehicle, to be read in pieces and then laid under the live data.
    pub fn past() -> Self {
        Self { recorded: true, curves: Curves::short(), ..Self::default() }
    }

    /// Lays the past under what has come through the connection that is open now: curves grow backwards, to what was
    /// there before it; newest values stay as they are.
    pub fn fill(&mut self, past: Self) {
        if past.newest_us > self.newest_us {
            // Another boot: its times are on another axis.
            return;
        }
        self.curves.fill(self.connected_from_us as f64 * 1e-6, &past.curves);
        self.spans.fill(past.spans);
        past.events.into_iter().for_each(|event| self.event(event));
        past.steps.into_iter().for_each(|step| self.step(step));
    }

    /// Is the newest message of this topic too old to be shown as what is? Never of a recording that is flown again.
    pub fn is_old<T>(&self, topic: &Topic<T>, local_ms: f64) -> bool {
        let now_us = self.clock.flight_now_us(local_ms).unwrap_or(self.newest_us as f64);
        topic.get().is_some() && !self.is_replay() && topic.is_stale(now_us)
    }

    /// How old the newest message is, s; `None` before the first one, and for a recording that is flown again, which
    /// may stand still.
    pub fn age_s(&self, local_ms: f64) -> Option<f64> {
        let now_us = self.clock.flight_now_us(local_ms).filter(|_| self.newest_us > 0 && !self.is_replay())?;
        Some(((now_us - self.newest_us as f64) * 1e-6).max(0.0))
    }

    /// Reads one batch that arrived at `local_ms` of the browser's monotonic clock.
    ///
    /// # Errors
    /// When it is no batch of this schema; frames before a broken one are kept.
    pub fn ingest(&mut self, batch: &[u8], local_ms: f64) -> Result<(), plumbline_proto::DecodeError> {
        for frame in codec::decode_batch(batch)? {
            self.frame(&frame?, local_ms);
        }
        if self.newest_us > 0 && !self.recorded {
            self.clock.arrived(self.newest_us, local_ms);
        }
        Ok(())
    }

    /// Reads one message, as [`Live::ingest`] does those of a batch.
    pub fn frame(&mut self, frame: &codec::Frame<'_>, local_ms: f64) {
        // Kinds newer than this build are skipped: the contract says so.
        let Some(kind) = frame.known_kind() else { return };
        if let Err(error) = self.message(kind, frame, local_ms) {
            self.unreadable += 1;
            self.unreadable_reason = error.to_string();
        }
    }

    /// May this frame extend its curve? A repeated one may not: each connection begins with the newest of every topic.
    fn extends_curve(&mut self, frame: &codec::Frame<'_>) -> bool {
        if self.recorded {
            return true;
        }
        let charted = self.charted.entry((frame.kind, frame.instance)).or_insert(0);
        let new = frame.sequence > *charted;
        *charted = frame.sequence.max(*charted);
        new
    }

    fn message(
        &mut self,
        kind: Kind,
        frame: &codec::Frame<'_>,
        local_ms: f64,
    ) -> Result<(), plumbline_proto::DecodeError> {
        if !kind.is_ground_made() {
            self.newest_us = self.newest_us.max(frame.time_us);
        }
        match kind {
            Kind::Description => {
                let description: v1::Description = frame.message()?;
                self.rebooted(description.boot_wall_time_us, frame.time_us);
                self.description.set(description, frame.time_us);
            }
            Kind::Status => {
                let status: v1::Status = frame.message()?;
                if self.extends_curve(frame) {
                    self.curves.push_status(&status);
                }
                self.status.set(status, frame.time_us);
            }
            Kind::Gains => self.gains.set(frame.message()?, frame.time_us),
            Kind::Attacks => {
                let state: v1::AttackState = frame.message()?;
                self.spans.update(&state);
                self.attacks.set(state, frame.time_us);
            }
            Kind::Event => self.event(frame.message()?),
            Kind::StepResponse => self.step(frame.message()?),
            Kind::Control => {
                let control: v1::Control = frame.message()?;
                if self.extends_curve(frame) {
                    self.curves.push_control(&control);
                }
                self.control.set(control, frame.time_us);
            }
            Kind::Truth => {
                let truth: v1::Truth = frame.message()?;
                if self.extends_curve(frame) {
                    self.curves.push_truth(&truth);
                }
                self.truth.set(truth, frame.time_us);
            }
            Kind::Estimate => {
                let estimate: v1::Estimate = frame.message()?;
                if self.extends_curve(frame) {
                    self.curves.push_estimate(frame.instance, &estimate);
                }
                self.estimates.entry(frame.instance).or_default().set(estimate, frame.time_us);
            }
            Kind::Residuals => {
                let residuals: v1::Residuals = frame.message()?;
                if self.extends_curve(frame) {
                    self.curves.push_residuals(frame.instance, &residuals);
                }
                for residual in residuals.residuals {
                    let key = (frame.instance, residual.sensor, residual.instance, residual.channel);
                    self.residuals.entry(key).or_default().set(residual, frame.time_us);
                }
            }
            Kind::Height => {
                let sample: v1::HeightSample = frame.message()?;
                if self.extends_curve(frame) {
                    // What the estimators were given: under attack, the lie.
                    let received = match sample.reception() {
                        Reception::AsSensed => Some(sample.sensed_m),
                        Reception::Altered => sample.received_m,
                        Reception::Dropped => None,
                    };
                    if let Some(height) = received {
                        self.curves.push(Curve::Height(frame.instance), sample.time_us, height);
                    }
                }
            }
            Kind::Secure => {
                let status: v1::SecureStatus = frame.message()?;
                if self.extends_curve(frame) {
                    self.curves.push_secure(&status);
                }
                self.secure.set(status, frame.time_us);
            }
            Kind::Link => {
                let link: v1::LinkStatus = frame.message()?;
                if self.is_replay() {
                    // It may stand still, or run faster than time.
                    self.clock = Clock::default();
                }
                if link.newest_time_us > 0 {
                    self.clock.measure(link.newest_time_us, link.age_ms, local_ms);
                }
                self.link = Some(link);
            }
            Kind::Recording => self.recording = Some(frame.message()?),
            Kind::Lease => self.lease = Some(frame.message()?),
            // Answers, marks, and the samples of sensors that no instrument shows.
            _ => {}
        }
        Ok(())
    }

    /// Flight time starts again with each boot: nothing of the boot before can stay on the same axis.
    fn rebooted(&mut self, boot_wall_us: u64, time_us: u64) {
        if self.recorded {
            return;
        }
        if self.boot_wall_us != 0 && boot_wall_us.abs_diff(self.boot_wall_us) > 5_000_000 {
            let (link, recording, lease) = (self.link.take(), self.recording.take(), self.lease.take());
            let events_seen = self.events_seen;
            *self = Self { link, recording, lease, events_seen, newest_us: time_us, ..Self::default() };
        }
        self.boot_wall_us = boot_wall_us;
    }

    fn event(&mut self, event: v1::Event) {
        let known = self.events.iter().rev().take(64).any(|e| e.time_us == event.time_us && e.text == event.text);
        if known {
            return;
        }
        // History may bring older events after the snapshot's newest one.
        let at = self.events.iter().rposition(|e| e.time_us <= event.time_us).map_or(0, |i| i + 1);
        self.events.insert(at, event);
        self.events_seen += 1;
        if !self.recorded && self.events.len() > MAX_EVENTS {
            self.events.pop_front();
        }
    }

    fn step(&mut self, step: v1::StepResponse) {
        match self.steps.iter_mut().find(|s| s.start_time_us == step.start_time_us) {
            Some(known) if known.time_us <= step.time_us => *known = step,
            Some(_) => {}
            None => {
                let at = self.steps.iter().rposition(|s| s.start_time_us < step.start_time_us).map_or(0, |i| i + 1);
                self.steps.insert(at, step);
                if !self.recorded && self.steps.len() > MAX_STEPS {
                    self.steps.pop_front();
                }
            }
        }
    }

    /// Who holds control; empty: nobody.
    pub fn holder(&self) -> &str {
        self.lease.as_ref().map_or("", |lease| lease.holder.as_str())
    }

    /// The altitude setpoint in use, m: where the profile is, not where it goes.
    pub fn setpoint_m(&self) -> Option<f64> {
        self.control.get().and_then(|c| c.setpoint.as_ref()).and_then(|s| s.altitude_m)
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
        let judged = self.curves.names().filter_map(|c| match c {
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

    /// The residual with the largest ratio of one sensor instance, fresh ones before stale ones.
    pub fn worst_residual(&self, estimator: u16, sensor: i32, instance: u32) -> Option<(&v1::Residual, u64)> {
        let range = (estimator, sensor, instance, i32::MIN)..=(estimator, sensor, instance, i32::MAX);
        let newest = self.residuals.range(range.clone()).filter_map(|(_, t)| t.time_us()).max()?;
        self.residuals
            .range(range)
            .filter_map(|(_, topic)| Some((topic.get()?, topic.time_us()?)))
            .filter(|(_, time)| newest - time < 1_000_000)
            .max_by(|(a, _), (b, _)| a.ratio.total_cmp(&b.ratio))
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
    /// outage shows as a gap and not as an empty chart.
    pub fn edge_us(&self, local_ms: f64) -> f64 {
        let newest = self.newest_us as f64;
        let replayed = self.description.get().is_some_and(|d| d.vehicle == "replay");
        if replayed {
            return newest;
        }
        self.clock.flight_now_us(local_ms).map_or(newest, |now| now.clamp(newest, newest + 2e6))
    }
}

/// Encodes one message as a frame; for tests and for the flight page's fixtures.
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
mod tests {
    use super::*;
    use plumbline_proto::v1::SensorKind;

    fn estimate(time_us: u64, z: f64) -> v1::Estimate {
        v1::Estimate {
            time_us,
            in_loop: true,
            position_enu_m: Some(v1::Vector3 { x: 0.0, y: 0.0, z }),
            roll_pitch_yaw_rad: Some(v1::Vector3::default()),
            ..Default::default()
        }
    }

    fn batch(range: std::ops::Range<u64>) -> Vec<u8> {
        let mut out = Vec::new();
        for i in range {
            append(&mut out, Kind::Estimate, 1, i, i * 10_000, &estimate(i * 10_000, i as f64 * 0.01));
        }
        out
    }

    #[test]
    fn the_newest_state_is_shown_at_once_and_the_past_is_laid_under_it() {
        let past = |range| {
            let mut past = Live::past();
            past.ingest(&batch(range), 0.0).unwrap();
            past
        };
        let mut live = Live::default();
        live.connection_opened();
        // GIVEN the newest state and some live data
        live.ingest(&batch(500..501), 1.0).unwrap();
        assert_eq!(live.estimate().unwrap().get().unwrap().time_us, 500 * 10_000);
        live.ingest(&batch(501..520), 1.0).unwrap();
        // WHEN the past arrives, which also holds what came meanwhile
        live.fill(past(100..510));
        // THEN each sample is there once, and the newest is still the newest
        assert_eq!(live.curves.len(Curve::Altitude(1)), 420);
        assert_eq!(live.estimate().unwrap().get().unwrap().time_us, 519 * 10_000);
        // WHEN more of the past is asked for
        live.fill(past(1..510));
        assert_eq!(live.curves.len(Curve::Altitude(1)), 519);
        // WHEN the socket was lost for a tenth of a second
        live.connection_opened();
        live.ingest(&batch(530..535), 2.0).unwrap();
        assert_eq!(live.curves.len(Curve::Altitude(1)), 524);
        live.fill(past(300..532));
        // THEN only what was missed is added
        assert_eq!(live.curves.len(Curve::Altitude(1)), 534);
        // WHEN the vehicle was started again meanwhile, THEN another boot's past is not mixed in
        live.fill(past(1000..1100));
        assert_eq!(live.curves.len(Curve::Altitude(1)), 534);
    }

    #[test]
    fn the_age_is_that_of_what_is_here_and_not_of_what_the_ground_has() {
        let mut live = Live::default();
        let link = |newest_time_us| {
            let mut out = Vec::new();
            let status = v1::LinkStatus { connected: true, age_ms: 5.0, newest_time_us, ..Default::default() };
            append(&mut out, Kind::Link, 0, 0, 0, &status);
            out
        };
        assert_eq!(live.age_s(0.0), None);
        // GIVEN a page that has read up to 1 s, and a ground that has 4 s
        live.ingest(&link(4_000_000), 100.0).unwrap();
        live.ingest(&batch(1..101), 100.0).unwrap();
        assert!((live.age_s(100.0).unwrap() - 3.005).abs() < 1e-9);
        // WHEN the page catches up
        live.ingest(&batch(101..401), 100.0).unwrap();
        assert!((live.age_s(100.0).unwrap() - 0.005).abs() < 1e-9);
    }

    #[test]
    fn a_reboot_clears_the_axis_but_not_the_link() {
        let mut live = Live::default();
        let mut first = Vec::new();
        append(
            &mut first,
            Kind::Description,
            0,
            1,
            10,
            &v1::Description { boot_wall_time_us: 1_000_000_000, ..Default::default() },
        );
        append(&mut first, Kind::Link, 0, 0, 0, &v1::LinkStatus { connected: true, ..Default::default() });
        live.ingest(&first, 0.0).unwrap();
        live.ingest(&batch(1..10), 0.0).unwrap();
        assert!(live.curves.len(Curve::Altitude(1)) > 0);
        let mut second = Vec::new();
        append(
            &mut second,
            Kind::Description,
            0,
            1,
            10,
            &v1::Description { boot_wall_time_us: 2_000_000_000, ..Default::default() },
        );
        live.ingest(&second, 0.0).unwrap();
        assert_eq!(live.curves.len(Curve::Altitude(1)), 0);
        assert!(live.estimate().is_none() && live.link.is_some());
    }

    #[test]
    fn broken_frames_are_counted_and_do_no_harm() {
        let mut live = Live::default();
        let mut out = Vec::new();
        codec::begin_batch(&mut out);
        codec::Frame { kind: Kind::Status.to_wire(), instance: 0, sequence: 1, time_us: 1, payload: &[0xff; 7] }
            .encode(&mut out);
        codec::Frame { kind: 9999, instance: 0, sequence: 2, time_us: 1, payload: b"x" }.encode(&mut out);
        live.ingest(&out, 0.0).unwrap();
        assert_eq!(live.unreadable, 1);
        assert!(live.ingest(b"\x50\x63", 0.0).unwrap_err().to_string().contains("schema 99"));
    }

    #[test]
    fn an_altered_height_is_charted_as_received_and_a_dropped_one_not_at_all() {
        let mut live = Live::recorded();
        let mut out = Vec::new();
        let altered =
            v1::HeightSample { time_us: 1, reception: Reception::Altered.into(), sensed_m: 0.5, received_m: Some(1.0) };
        let dropped =
            v1::HeightSample { time_us: 2, reception: Reception::Dropped.into(), sensed_m: 0.5, received_m: None };
        append(&mut out, Kind::Height, 2, 1, 1, &altered);
        append(&mut out, Kind::Height, 2, 2, 2, &dropped);
        live.ingest(&out, 0.0).unwrap();
        assert_eq!(live.curves.len(Curve::Height(2)), 1);
        assert_eq!(live.curves.value_at(Curve::Height(2), 1e-6), Some(1.0));
    }

    #[test]
    fn worst_channel_of_an_instance_and_rows_in_order() {
        let mut live = Live::recorded();
        let residual = |sensor: SensorKind, instance, channel, ratio| v1::Residual {
            sensor: sensor.into(),
            instance,
            channel,
            ratio,
            gate: 1.0,
            innovation: ratio,
            ..Default::default()
        };
        let message = v1::Residuals {
            time_us: 5,
            estimator: 1,
            residuals: vec![
                residual(SensorKind::Imu, 1, 7, 0.2),
                residual(SensorKind::Imu, 1, 8, 0.9),
                residual(SensorKind::Height, 2, 11, 1.4),
            ],
        };
        let mut out = Vec::new();
        append(&mut out, Kind::Residuals, 1, 1, 5, &message);
        live.ingest(&out, 0.0).unwrap();
        assert_eq!(live.residual_rows(1), vec![(SensorKind::Height as i32, 2), (SensorKind::Imu as i32, 1)]);
        let (worst, _) = live.worst_residual(1, SensorKind::Imu as i32, 1).unwrap();
        assert_eq!((worst.channel, worst.ratio), (8, 0.9));
        assert!(live.worst_residual(2, 1, 1).is_none());
    }

    #[test]
    fn steps_update_in_place_and_events_do_not_repeat() {
        let mut live = Live::default();
        let mut out = Vec::new();
        for rise in [None, Some(0.4)] {
            let step =
                v1::StepResponse { time_us: 10, step: 1, start_time_us: 5, rise_time_s: rise, ..Default::default() };
            append(&mut out, Kind::StepResponse, 0, 1, 10, &step);
        }
        for _ in 0..2 {
            append(
                &mut out,
                Kind::Event,
                0,
                3,
                11,
                &v1::Event { time_us: 11, text: "armed".into(), ..Default::default() },
            );
        }
        live.ingest(&out, 0.0).unwrap();
        assert_eq!(live.steps.len(), 1);
        assert_eq!(live.steps[0].rise_time_s, Some(0.4));
        assert_eq!(live.events.len(), 1);
    }

    #[test]
    fn the_edge_stands_still_in_an_outage() {
        let mut live = Live::default();
        live.ingest(&batch(1..101), 1000.0).unwrap();
        assert_eq!(live.edge_us(1000.0), 1_000_000.0);
        assert_eq!(live.edge_us(1500.0), 1_500_000.0);
        assert_eq!(live.edge_us(60_000.0), 3_000_000.0);
    }
}
