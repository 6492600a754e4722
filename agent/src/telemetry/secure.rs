//! The secure estimator's account into its message, and the altitude it is flown with: e and e* of [Clinic] Table 1.

use plumbline_proto::time::FlightTime;
use plumbline_proto::v1;

use super::Audit;
use crate::estimate::bank::Judge;
use crate::estimate::fdir::isolation::{FlagReason, KINDS, MAX_DEVICES};
use crate::estimate::secure::Secure;
use crate::flight::Flight;
use crate::types::Mode;
use crate::vehicle::RecordedControl;

/// e is taken over this long, s.
const WINDOW_S: f64 = 10.0;

/// rms of altitude − setpoint while altitude is controlled: over the last seconds (e), and over all the time
/// in which nothing was flagged (e*). By the estimate in the loop: the vehicle has no truth.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Tracking {
    recent_m2: Option<f64>,
    clean_m2: f64,
    clean_ticks: f64,
    last: Option<FlightTime>,
}

impl Tracking {
    /// One tick of `flight`, or of the recording that is flown again.
    pub(super) fn tick(&mut self, flight: &Flight, judge: Judge<'_>, recorded: Option<&RecordedControl>) {
        let report = flight.report();
        let now = report.sensed.time;
        let dt_s = self.last.map_or(0.0, |last| now.seconds_since(last)).clamp(0.0, 0.1);
        self.last = Some(now);
        let (mode, armed, setpoint) = recorded
            .map_or((report.mode, report.armed, &report.setpoint), |then| (then.mode, then.armed, &then.setpoint));
        if !armed || !matches!(mode, Mode::AltitudeHold | Mode::Hold | Mode::Land) {
            *self = Self { last: self.last, ..Self::default() };
            return;
        }
        let Some(estimate) = flight.estimate_in_loop() else { return };
        let square = (estimate.motion_or_rest().position_enu_m.z - setpoint.position_enu_m.z).powi(2);
        if !square.is_finite() {
            return;
        }
        let recent = self.recent_m2.get_or_insert(square);
        *recent += (square - *recent) * (dt_s / WINDOW_S).min(1.0);
        if judge.isolation().devices().iter().all(|d| d.flagged.is_none()) {
            self.clean_ticks += 1.0;
            self.clean_m2 += (square - self.clean_m2) / self.clean_ticks;
        }
    }

    fn error_m(&self) -> Option<f64> {
        self.recent_m2.map(f64::sqrt)
    }

    fn reference_m(&self) -> Option<f64> {
        (self.clean_ticks > 0.0).then(|| self.clean_m2.sqrt())
    }
}

/// A message with room for every sensor.
pub(super) fn with_room() -> v1::SecureStatus {
    v1::SecureStatus {
        sensors: Vec::with_capacity(MAX_DEVICES),
        margins: Vec::with_capacity(KINDS.len()),
        ..v1::SecureStatus::default()
    }
}

pub(super) fn fill(
    into: &mut v1::SecureStatus,
    now: FlightTime,
    judge: Judge<'_>,
    tracking: &Tracking,
    audit: Option<Audit>,
) {
    let window = judge.window();
    into.time_us = now.0;
    into.set_status(window.status);
    into.set_fallback(window.fallback);
    into.sensors.clear();
    into.sensors.extend(judge.isolation().devices().iter().map(|d| v1::SecureSensor {
        sensor: d.sensor.kind as i32,
        instance: u32::from(d.sensor.instance),
        present: d.present,
        flagged: d.flagged.is_some(),
        reason: d.flagged.map_or(FlagReason::None, |(_, reason)| reason) as i32,
        window_ratio: d.evidence.window_ratio,
        drift_ratio: d.evidence.drift_ratio,
        flagged_since_us: d.flagged.map_or(0, |(since, _)| since.0),
    }));
    into.margins.clear();
    let margins = KINDS.iter().map(|kind| judge.isolation().margin(*kind)).filter(|m| m.present > 0);
    into.margins.extend(margins.map(|m| v1::SecureMargin {
        sensor: m.kind as i32,
        present: m.present as u32,
        flagged: m.flagged as u32,
        margin: m.margin(),
    }));
    into.objective = window.objective;
    into.lower_bound = window.lower_bound;
    let gap = (window.objective - window.lower_bound).max(0.0);
    into.gap = if window.objective > 0.0 { gap / window.objective } else { 0.0 };
    into.iterations = window.iterations;
    into.solve_time_us = window.solve_time_us;
    into.audit_difference = audit.map(|a| a.difference);
    into.audit_time_us = audit.map_or(0, |a| a.time.0);
    into.decoded_height_m = window.height_m;
    into.tracking_error_m = tracking.error_m();
    into.reference_error_m = tracking.reference_m();
    into.height_bound_m = judge.height_bound_m();
    let shaken = judge.shaken();
    into.accel_noise_mps2 = shaken.map(|shaken| shaken.noise_mps2);
    into.accel_rectified_mps2 = shaken.map(|shaken| shaken.rectified_mps2);
    let delays = judge.delays();
    (into.height_delay_s, into.pose_delay_s) = (delays.heights_s, delays.pose_s);
    // What only the decoder of a window has.
    let secure = judge.secure();
    into.disturbance_enu_n = secure.map(|secure| {
        let d = secure.disturbance_enu_n();
        v1::Vector3 { x: d.x, y: d.y, z: d.z }
    });
    into.resets = secure.map_or(0, Secure::resets);
    into.set_decoder(secure.map_or(v1::Decoder::Unspecified, Secure::decoder));
    into.window_slots = secure.map_or(0, |secure| secure.slots() as u32);
}
