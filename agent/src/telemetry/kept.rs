//! The messages that are filled anew each tick.

use plumbline_proto::v1;

use super::{RESIDUALS_PER_MESSAGE, secure};
use crate::attack::MAX_ATTACKS;
use crate::control::tuning::MAX_PARAMETERS;
use crate::event::Text;
use crate::flight::report::MAX_CHECKS;
use crate::sensor::Wires;

/// Ranges of a scan.
const MAX_RANGES: usize = 1024;
/// Motors, strings, integrators, cameras: no list of a tick is longer.
const MAX_ROTORS_AND_STRINGS: usize = 8;

/// Messages that own memory, kept from tick to tick.
#[derive(Debug)]
pub(super) struct Kept {
    pub control: v1::Control,
    pub residuals: v1::Residuals,
    pub samples: Wires,
    pub truth: v1::Truth,
    pub status: v1::Status,
    pub attacks: v1::AttackState,
    pub gains: v1::GainsInUse,
    pub event: v1::Event,
    pub ack: v1::Ack,
    pub device: v1::DeviceState,
    pub scan: v1::Scan,
    pub secure: v1::SecureStatus,
}

impl Kept {
    /// With room for the longest text and list, so that no tick allocates.
    pub fn with_room() -> Self {
        let text = || String::with_capacity(Text::new().capacity());
        let four = || Vec::with_capacity(MAX_ROTORS_AND_STRINGS);
        let matrix = || Some(v1::Matrix { values: Vec::with_capacity(64), ..v1::Matrix::default() });
        let weights = v1::LqrWeights { state_weight: Vec::with_capacity(16), input_weight: Vec::with_capacity(4) };
        let check = || v1::Check { name: text(), passed: false, reason: text() };
        Self {
            control: v1::Control {
                motor_command: four(),
                motor_applied: four(),
                motor_attacked: four(),
                integrator: four(),
                autopilot: Some(v1::AutopilotControl { motor_output: four(), ..v1::AutopilotControl::default() }),
                ..v1::Control::default()
            },
            residuals: v1::Residuals {
                residuals: Vec::with_capacity(RESIDUALS_PER_MESSAGE),
                ..v1::Residuals::default()
            },
            samples: Wires::with_room(),
            truth: v1::Truth { rotor_speed_radps: four(), string_tension_n: four(), ..v1::Truth::default() },
            status: v1::Status {
                failsafe_reason: text(),
                checks: (0..MAX_CHECKS).map(|_| check()).collect(),
                flight_id: text(),
                log_error: text(),
                rotor_effectiveness: four(),
                ..v1::Status::default()
            },
            attacks: v1::AttackState { attacks: Vec::with_capacity(MAX_ATTACKS), ..v1::AttackState::default() },
            gains: v1::GainsInUse {
                sha256: text(),
                controller: text(),
                weights: Some(weights),
                k: matrix(),
                k_attitude: matrix(),
                parameters: (0..MAX_PARAMETERS).map(|_| v1::Parameter { name: text(), value: 0.0 }).collect(),
                margins: (0..4).map(|_| v1::LoopMargins { input: text(), ..v1::LoopMargins::default() }).collect(),
                margin_policy: text(),
                ..v1::GainsInUse::default()
            },
            event: v1::Event { kind: text(), text: text(), ..v1::Event::default() },
            ack: v1::Ack { reason: text(), ..v1::Ack::default() },
            device: v1::DeviceState { name: text(), port: text(), reason: text(), ..v1::DeviceState::default() },
            scan: v1::Scan { range_mm: Vec::with_capacity(MAX_RANGES), ..v1::Scan::default() },
            secure: secure::with_room(),
        }
    }
}
