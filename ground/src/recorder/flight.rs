//! What is known of one recorded flight, learnt from its messages.

use std::collections::BTreeMap;

use plumbline_proto::{Kind, Message, v1};
pub use plumbline_rest::flight::{Completeness, Flight, FlownAttack, Step};

use super::outline::Outline;
use crate::attack_plan::planned;
use crate::names::JsonName;

/// Samples further apart than this are not compared, µs.
const COMPARE_WITHIN_US: u64 = 100_000;

/// Learns a flight from its messages, in any order, each once.
#[derive(Debug, Clone, Default)]
pub struct Learner {
    counts: BTreeMap<String, u64>,
    messages: u64,
    times_us: Option<(u64, u64)>,
    description: Option<v1::Description>,
    steps: BTreeMap<u32, v1::StepResponse>,
    attacks: BTreeMap<(u32, u32), v1::AttackProgress>,
    truth: Option<(u64, f64)>,
    estimate: Option<(u64, f64)>,
    squared_truth: (f64, u64),
    squared_estimate: (f64, u64),
    outline_of_truth: Outline,
    outline_of_estimate: Outline,
    /// From the marks among the messages.
    pub first_sequence: Option<u64>,
    /// From the closing mark.
    pub last_sequence: Option<u64>,
    /// Whose marks count; empty where the file does not say.
    flight_id: String,
}

/// Does a mark stand where it says? It is the first or the last message of its flight itself, so that no mark can speak
/// of messages that came after it, or take away some that came before.
pub fn in_place(mark: &v1::FlightMark, sequence: u64) -> bool {
    mark.first_sequence <= sequence && mark.last_sequence.unwrap_or(mark.first_sequence) == sequence
}

impl Learner {
    /// Of the flight with this id.
    pub fn of(flight_id: &str) -> Self {
        Self { flight_id: flight_id.to_owned(), ..Self::default() }
    }

    /// Takes one message; its sequence number is 0 where the file has none.
    pub fn observe(&mut self, topic: &str, sequence: u64, time_us: u64, payload: &[u8]) {
        self.messages += 1;
        match self.counts.get_mut(topic) {
            Some(count) => *count += 1,
            None => {
                self.counts.insert(topic.to_owned(), 1);
            }
        }
        let (first, last) = self.times_us.unwrap_or((time_us, time_us));
        self.times_us = Some((first.min(time_us), last.max(time_us)));
        match Kind::from_topic(topic).map(|(kind, _)| kind) {
            Some(Kind::Control) => self.control(time_us, payload),
            Some(Kind::Estimate) => {
                if let Ok(m) = v1::Estimate::decode(payload)
                    && m.in_loop
                    && let Some(position) = m.position_enu_m
                {
                    self.estimate = Some((time_us, position.z));
                    self.outline_of_estimate.take(time_us, position.z);
                }
            }
            Some(Kind::Truth) => {
                if let Ok(m) = v1::Truth::decode(payload)
                    && let Some(position) = m.position_enu_m
                {
                    self.truth = Some((time_us, position.z));
                    self.outline_of_truth.take(time_us, position.z);
                }
            }
            Some(Kind::Description) => {
                if let Ok(m) = v1::Description::decode(payload) {
                    self.description = Some(m);
                }
            }
            Some(Kind::StepResponse) => {
                if let Ok(m) = v1::StepResponse::decode(payload)
                    && self.steps.get(&m.step).is_none_or(|known| known.time_us <= m.time_us)
                {
                    self.steps.insert(m.step, m);
                }
            }
            Some(Kind::Attacks) => self.attack_state(payload),
            Some(Kind::Flight) => {
                if let Ok(m) = v1::FlightMark::decode(payload)
                    && (self.flight_id.is_empty() || m.flight_id == self.flight_id)
                    && in_place(&m, sequence)
                {
                    self.first_sequence = Some(m.first_sequence);
                    self.last_sequence = m.last_sequence.or(self.last_sequence);
                }
            }
            _ => {}
        }
    }

    fn control(&mut self, time_us: u64, payload: &[u8]) {
        let Ok(m) = v1::Control::decode(payload) else { return };
        let holding = matches!(v1::Mode::try_from(m.mode), Ok(v1::Mode::AltitudeHold | v1::Mode::Hold));
        let Some(altitude) = m.setpoint.and_then(|s| s.altitude_m).filter(|_| holding && m.armed) else { return };
        let near = |sample: Option<(u64, f64)>| {
            sample.filter(|(t, _)| t.abs_diff(time_us) < COMPARE_WITHIN_US).map(|(_, z)| (altitude - z).powi(2))
        };
        for (squared, sum) in
            [(near(self.truth), &mut self.squared_truth), (near(self.estimate), &mut self.squared_estimate)]
        {
            if let Some(squared) = squared.filter(|s| s.is_finite()) {
                sum.0 += squared;
                sum.1 += 1;
            }
        }
    }

    fn attack_state(&mut self, payload: &[u8]) {
        let Ok(state) = v1::AttackState::decode(payload) else { return };
        for progress in state.attacks {
            let Some(attack) = &progress.attack else { continue };
            let key = (state.schedule_id, attack.id);
            // Phases only advance: an older state that was filled in later does not turn them back.
            if self.attacks.get(&key).is_none_or(|known| known.phase <= progress.phase) {
                self.attacks.insert(key, progress);
            }
        }
    }

    /// Takes in what was learnt from other messages of the same flight.
    pub fn absorb(&mut self, other: &Self) {
        self.messages += other.messages;
        for (topic, count) in &other.counts {
            *self.counts.entry(topic.clone()).or_default() += count;
        }
        self.times_us = match (self.times_us, other.times_us) {
            (Some((a, b)), Some((c, d))) => Some((a.min(c), b.max(d))),
            (mine, theirs) => mine.or(theirs),
        };
        if self.description.is_none() {
            self.description.clone_from(&other.description);
        }
        for (step, response) in &other.steps {
            if self.steps.get(step).is_none_or(|known| known.time_us < response.time_us) {
                self.steps.insert(*step, *response);
            }
        }
        for (key, progress) in &other.attacks {
            if self.attacks.get(key).is_none_or(|known| known.phase < progress.phase) {
                self.attacks.insert(*key, *progress);
            }
        }
        for (sum, theirs) in
            [(&mut self.squared_truth, other.squared_truth), (&mut self.squared_estimate, other.squared_estimate)]
        {
            sum.0 += theirs.0;
            sum.1 += theirs.1;
        }
        self.outline_of_truth.absorb(&other.outline_of_truth);
        self.outline_of_estimate.absorb(&other.outline_of_estimate);
        self.first_sequence = self.first_sequence.or(other.first_sequence);
        self.last_sequence = self.last_sequence.or(other.last_sequence);
    }

    /// Messages seen.
    pub fn messages(&self) -> u64 {
        self.messages
    }

    /// First and last time, µs since boot.
    pub fn times_us(&self) -> Option<(u64, u64)> {
        self.times_us
    }

    /// Fills in what the messages say; identity, ranges and sizes are the caller's.
    pub fn describe(&self, flight: &mut Flight, boot_wall_time_us: u64) {
        let (first, last) = self.times_us.unwrap_or_default();
        let description = self.description.clone().unwrap_or_default();
        let since_start = |time_us: f64| (time_us - first as f64) * 1e-6;
        flight.vehicle = description.vehicle;
        flight.rig = description.rig;
        flight.airframe = description.airframe;
        flight.seed = description.seed;
        flight.agent_version = description.agent_version;
        flight.started_unix_us = boot_wall_time_us.saturating_add(first);
        flight.duration_s = last.saturating_sub(first) as f64 * 1e-6;
        flight.messages = self.messages;
        flight.counts = self.counts.clone();
        let (sum, n) = if self.squared_truth.1 > 0 { self.squared_truth } else { self.squared_estimate };
        flight.tracking_rms_m = (n > 0).then(|| (sum / n as f64).sqrt());
        flight.outline = self.outline_of_truth.describe(first).or_else(|| self.outline_of_estimate.describe(first));
        let step = |m: &v1::StepResponse| Step {
            start_s: since_start(m.start_time_us as f64),
            from_m: m.from_m,
            to_m: m.to_m,
            rise_time_s: m.rise_time_s,
            overshoot_percent: m.overshoot_percent,
            settling_time_s: m.settling_time_s,
            steady_error_m: m.steady_error_m,
            interrupted: m.interrupted,
        };
        flight.steps = self.steps.values().map(step).collect();
        let flown = |progress: &v1::AttackProgress| {
            let attack = progress.attack.unwrap_or_default();
            let begins = progress
                .active_time_us
                .map_or(progress.accepted_time_us as f64 + attack.start_s * 1e6, |active| active as f64);
            let mut planned = planned(&attack);
            planned.start_s = since_start(begins);
            FlownAttack { planned, phase: v1::AttackPhase::json_name_of(progress.phase) }
        };
        // The state of the attacks tells of the last schedule for long: what ended before the flight is none of it.
        let before = |progress: &&v1::AttackProgress| progress.ended_time_us.is_some_and(|ended| ended < first);
        flight.attacks = self.attacks.values().filter(|progress| !before(progress)).map(flown).collect();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steps_attacks_and_tracking_are_learnt_from_the_messages() {
        let mut learner = Learner::default();
        let control = |time_us: u64| v1::Control {
            time_us,
            mode: v1::Mode::AltitudeHold as i32,
            armed: true,
            setpoint: Some(v1::Setpoint { altitude_m: Some(1.0), ..Default::default() }),
            ..Default::default()
        };
        let estimate = v1::Estimate {
            in_loop: true,
            position_enu_m: Some(v1::Vector3 { x: 0.0, y: 0.0, z: 0.9 }),
            ..Default::default()
        };
        learner.observe("/estimate/1", 1, 2_000_000, &estimate.encode_to_vec());
        learner.observe("/control", 1, 2_000_000, &control(2_000_000).encode_to_vec());
        learner.observe("/control", 1, 9_000_000, &control(9_000_000).encode_to_vec());
        let step = |time_us, overshoot_percent| v1::StepResponse {
            time_us,
            step: 1,
            start_time_us: 3_000_000,
            from_m: 0.5,
            to_m: 1.0,
            overshoot_percent,
            ..Default::default()
        };
        learner.observe("/step", 1, 5_000_000, &step(5_000_000, 8.0).encode_to_vec());
        learner.observe("/step", 1, 4_000_000, &step(4_000_000, 1.0).encode_to_vec());
        let attack =
            v1::Attack { id: 1, sensor: 2, instance: 2, kind: 2, start_s: 5.0, duration_s: 1.0, ..Default::default() };
        let state = |phase: v1::AttackPhase| v1::AttackState {
            schedule_id: 1,
            attacks: vec![v1::AttackProgress {
                attack: Some(attack),
                phase: phase as i32,
                accepted_time_us: 2_500_000,
                ..Default::default()
            }],
            ..Default::default()
        };
        learner.observe("/attacks", 1, 8_000_000, &state(v1::AttackPhase::Done).encode_to_vec());
        learner.observe("/attacks", 1, 7_000_000, &state(v1::AttackPhase::Active).encode_to_vec());
        let before = v1::AttackProgress { ended_time_us: Some(1_999_999), ..state(v1::AttackPhase::Done).attacks[0] };
        let before = v1::AttackState { schedule_id: 7, attacks: vec![before], ..Default::default() };
        learner.observe("/attacks", 1, 2_000_000, &before.encode_to_vec());
        let mut flight = Flight::default();
        learner.describe(&mut flight, 1_000_000_000);
        assert_eq!(flight.attacks.len(), 1, "one ended before the flight began");
        assert_eq!((flight.started_unix_us, flight.duration_s), (1_002_000_000, 7.0));
        assert!((flight.tracking_rms_m.unwrap() - 0.1).abs() < 1e-12, "the estimate 7 s away is not compared");
        assert_eq!((flight.steps.len(), flight.steps[0].start_s, flight.steps[0].overshoot_percent), (1, 1.0, 8.0));
        assert_eq!((flight.attacks[0].phase.as_str(), flight.attacks[0].planned.start_s), ("done", 5.5));
        assert_eq!(flight.counts["/control"], 2);
        assert_eq!(flight.outline.unwrap().altitude_cm, [Some([90, 90])]);
    }
}
