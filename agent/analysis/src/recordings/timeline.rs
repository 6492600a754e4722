//! Samples of a whole recording in time order, cut into ticks.

use std::path::Path;
use std::sync::Arc;

use plumbline_core::control::step_response::StepResponse;
use plumbline_core::sensor::AnySample;
use plumbline_core::types::MotorCommand;
use plumbline_core::vehicle::Truth;
use plumbline_proto::{ids::SensorId, time::FlightTime, v1};

use super::{Format, RecordedControl, RecordedSensor, RecordedTick, RecordingError, RecordingInfo, noise};

/// Something a recording says at one time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Item {
    /// A sample of the instance with this index, from 0.
    Sensed(usize, AnySample),
    /// What the estimators got instead; `None` with the sensor when it was withheld.
    Received(SensorId, Option<AnySample>),
    Applied(MotorCommand),
    Truth(Truth),
    Control(RecordedControl),
    StepResponse(StepResponse),
    Battery(f64),
    /// Ends the tick: everything since the tick before belongs to it.
    Tick,
}

/// A recording being played; a clone plays the same samples, which are there once.
#[derive(Debug, Clone)]
pub struct Recording {
    info: RecordingInfo,
    items: Arc<[(FlightTime, Item)]>,
    next: usize,
}

/// Gathers the items of a recording in any order.
#[derive(Debug, Default)]
pub(super) struct Builder {
    items: Vec<(FlightTime, Item)>,
    pub airframe: Option<String>,
    pub scenario: Option<String>,
    /// Of the place, rad, where the recording says.
    pub declination_rad: Option<f64>,
    /// Calibrations that corrected its samples.
    pub calibrations: Vec<v1::CalibrationInUse>,
    pub notes: Vec<String>,
}

impl Builder {
    pub fn push(&mut self, time: FlightTime, item: Item) {
        self.items.push((time, item));
    }

    /// Makes every time `by_us` earlier.
    pub fn shift(&mut self, by_us: u64) {
        for (time, _) in &mut self.items {
            time.0 = time.0.saturating_sub(by_us);
        }
    }

    /// Sorts by time; items of one time keep the order in which they were pushed, ticks last.
    ///
    /// A tick at each sample of IMU 1 is added where the format has no ticks of its own.
    pub fn finish(mut self, path: &Path, format: Format) -> Result<Recording, RecordingError> {
        if !self.items.iter().any(|(_, item)| matches!(item, Item::Tick)) {
            let imu_1 = |item: &Item| matches!(item, Item::Sensed(0, AnySample::Imu(_)));
            let ticks: Vec<_> =
                self.items.iter().filter(|(_, item)| imu_1(item)).map(|(t, _)| (*t, Item::Tick)).collect();
            self.items.extend(ticks);
        }
        self.items.sort_by_key(|(time, item)| (*time, matches!(item, Item::Tick)));
        let mut ticks = self.items.iter().filter(|(_, item)| matches!(item, Item::Tick)).map(|(time, _)| *time);
        let Some(first) = ticks.next() else {
            return Err(RecordingError::malformed(path, "no sample of an IMU and no tick in it: nothing to fly"));
        };
        let (last, count) = ticks.fold((first, 1), |(_, n), time| (time, n + 1));
        let duration_s = last.seconds_since(first);
        let mut sensors: Vec<(SensorId, usize)> = Vec::new();
        let (mut has_truth, mut has_motors) = (false, false);
        let mut attacked: Vec<(SensorId, FlightTime)> = Vec::new();
        for (time, item) in &self.items {
            match item {
                Item::Sensed(index, sample) => {
                    let id = SensorId::new(sample.kind(), *index as u8 + 1);
                    match sensors.iter_mut().find(|(known, _)| *known == id) {
                        Some((_, n)) => *n += 1,
                        None => sensors.push((id, 1)),
                    }
                }
                Item::Received(id, _) if !attacked.iter().any(|(known, _)| known == id) => attacked.push((*id, *time)),
                Item::Truth(_) => has_truth = true,
                Item::Applied(_) => has_motors = true,
                _ => {}
            }
        }
        sensors.sort_by_key(|(id, _)| (id.kind as i32, id.instance));
        let rate = |n: usize| if duration_s > 0.0 { n as f64 / duration_s } else { 0.0 };
        let info = RecordingInfo {
            source: path.to_owned(),
            format,
            span: (first, last),
            ticks: count,
            sensors: sensors.into_iter().map(|(id, n)| RecordedSensor { id, rate_hz: rate(n) }).collect(),
            imu_noise: noise::of(self.items.iter().map(|(_, item)| item)),
            has_truth,
            has_motors,
            attacked,
            airframe: self.airframe,
            scenario: self.scenario,
            declination_rad: self.declination_rad,
            calibrations: self.calibrations,
            notes: self.notes,
        };
        Ok(Recording { info, items: self.items.into(), next: 0 })
    }
}

impl Recording {
    /// What it holds.
    pub fn info(&self) -> &RecordingInfo {
        &self.info
    }

    /// Fraction played, 0 to 1.
    pub fn progress(&self) -> f64 {
        self.next as f64 / self.items.len().max(1) as f64
    }

    /// Starts again from the beginning.
    pub fn rewind(&mut self) {
        self.next = 0;
    }

    /// The next tick; `None` at the end. Samples that arrived between two ticks come with the later
    /// one; of two samples of one sensor the later is kept.
    pub fn next_tick(&mut self) -> Option<RecordedTick> {
        let mut tick = RecordedTick::default();
        let mut step_response = None;
        while let Some((time, item)) = self.items.get(self.next).copied() {
            self.next += 1;
            match item {
                Item::Sensed(index, sample) => {
                    tick.sensed.put(index, sample);
                    if let Some(received) = &mut tick.received {
                        received.put(index, sample);
                    }
                }
                Item::Received(sensor, sample) => {
                    let received = tick.received.get_or_insert(tick.sensed);
                    match sample {
                        Some(sample) => received.put(usize::from(sensor.instance.saturating_sub(1)), sample),
                        None => received.withhold(|withheld| withheld == sensor),
                    }
                }
                Item::Applied(command) => tick.applied = Some(command),
                Item::Truth(truth) => tick.truth = Some(truth),
                Item::Control(control) => tick.control = Some(control),
                Item::StepResponse(response) => step_response = Some(response),
                Item::Battery(volts) => tick.sensed.battery_v = Some(volts),
                Item::Tick => {
                    tick.sensed.time = time;
                    if let Some(control) = &mut tick.control {
                        control.step_response = step_response;
                    }
                    if let Some(received) = &mut tick.received {
                        received.time = time;
                        received.battery_v = tick.sensed.battery_v;
                    }
                    return Some(tick);
                }
            }
        }
        None
    }
}
