//! A recording flown again: its samples come back, its motors are those of the recording.

use plumbline_core::sensor::SensorFrame;
use plumbline_core::types::MotorCommand;
use plumbline_core::vehicle::{Recorded, RecordedControl, Truth, Vehicle, VehicleError};

use super::{RecordedTick, Recording, RecordingInfo};

/// Which of the recorded samples are flown.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Samples {
    /// As the estimators received them then, attacks included.
    #[default]
    Received,
    /// As they were sensed: clean, ready for another attack schedule.
    Sensed,
}

/// A recording as a vehicle.
#[derive(Debug)]
pub struct ReplayVehicle {
    recording: Recording,
    samples: Samples,
    tick: RecordedTick,
    command: MotorCommand,
}

impl ReplayVehicle {
    /// Flies `recording` from its first tick.
    pub fn new(recording: Recording, samples: Samples) -> Self {
        Self { recording, samples, tick: RecordedTick::default(), command: MotorCommand::default() }
    }

    /// What the recording holds.
    pub fn info(&self) -> &RecordingInfo {
        self.recording.info()
    }
}

impl Vehicle for ReplayVehicle {
    fn sense(&mut self) -> Result<SensorFrame, VehicleError> {
        self.tick = self.recording.next_tick().ok_or(VehicleError::Finished(self.recording.info().span.1))?;
        Ok(self.tick.sensed)
    }

    /// The recorded command, whatever is asked; the last known one where this tick has none.
    fn actuate(&mut self, _command: &MotorCommand) -> Result<MotorCommand, VehicleError> {
        self.command = self.tick.applied.unwrap_or(self.command);
        Ok(self.command)
    }

    fn truth(&self) -> Option<Truth> {
        self.tick.truth
    }

    fn recorded(&self) -> Option<&dyn Recorded> {
        Some(self)
    }
}

impl Recorded for ReplayVehicle {
    fn progress(&self) -> f64 {
        self.recording.progress()
    }

    fn reception(&self) -> Option<SensorFrame> {
        self.tick.received.filter(|_| self.samples == Samples::Received)
    }

    /// What a recording does not know is unknown, and not what the watching flight would do.
    fn control(&self) -> RecordedControl {
        let control = self.tick.control.unwrap_or_else(RecordedControl::unknown);
        let motors_known = self.recording.info().has_motors;
        // Formats with motors but without orders: what was applied is what was asked for.
        let command = if self.tick.control.is_some_and(|c| c.motors_known) { control.command } else { self.command };
        RecordedControl { motors_known, command, ..control }
    }
}
