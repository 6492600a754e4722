//! Certified gains as the message that reports them.

use std::fmt::Write as _;

use plumbline_proto::time::FlightTime;
use plumbline_proto::v1;

use super::{Certified, INPUT_NAMES};
use crate::control::Controller as _;
use crate::control::tuning::parameters;

impl Certified {
    /// As in use at `time`. Nothing is allocated where `into` has held gains before: what owns memory is kept.
    pub fn to_wire(&self, time: FlightTime, into: &mut v1::GainsInUse) {
        into.time_us = time.0;
        into.revision = self.revision.0;
        into.sha256.clear();
        for byte in self.sha256 {
            let _ = write!(into.sha256, "{byte:02x}");
        }
        self.controller().clone_into(&mut into.controller);
        into.kind = self.law.kind() as i32;
        let weights = into.weights.get_or_insert_default();
        // A K given outright comes from no weights.
        let of = if self.design.k.is_none() { Some(&self.design.weights) } else { None };
        of.map_or(&[] as &[f64], |w| &w.state).clone_into(&mut weights.state_weight);
        of.map_or(&[] as &[f64], |w| &w.input).clone_into(&mut weights.input_weight);
        let k = self.law.gains();
        for (into, k) in [&mut into.k, &mut into.k_attitude].into_iter().zip([k.map(|k| k[0]), k.map(|k| k[1])]) {
            let into = into.get_or_insert_default();
            (into.rows, into.columns) = k.map_or((0, 0), |k| (k.nrows() as u32, k.ncols() as u32));
            // The wire is row-major, nalgebra column-major.
            k.map(|k| k.transpose()).as_ref().map_or(&[] as &[f64], |k| k.as_slice()).clone_into(&mut into.values);
        }
        into.slowest_pole_per_s = self.margins.slowest_pole_per_s;
        let table = parameters(self.design.kind);
        into.parameters.resize_with(table.len(), v1::Parameter::default);
        for ((into, parameter), value) in into.parameters.iter_mut().zip(table).zip(&self.design.parameters) {
            parameter.name.clone_into(&mut into.name);
            into.value = *value;
        }
        into.margins.resize_with(INPUT_NAMES.len(), v1::LoopMargins::default);
        for ((into, name), found) in into.margins.iter_mut().zip(INPUT_NAMES).zip(&self.margins.loops) {
            name.clone_into(&mut into.input);
            into.gain_up = found.gain_up;
            into.gain_down = found.gain_down;
            into.phase_rad = found.phase_rad;
            into.delay_s = found.delay_s;
            into.crossover_radps = found.crossover_radps;
            into.peak_sensitivity = found.peak_sensitivity;
        }
        self.policy.name.clone_into(&mut into.margin_policy);
    }
}
