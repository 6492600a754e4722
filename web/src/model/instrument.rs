//! What the instruments beside the charts show: one attitude, one altitude, one set of motors.

use plumbline_proto::v1;

use super::{
    curves::{Axis, Curve, DEGREES, Horizontal, Way},
    live::Live,
};

/// Where a recording begins the instruments show what comes first, at most so much later, s.
const FIRST_S: f64 = 0.25;

/// Values of one moment; `None` where nothing is known.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Instrument {
    /// Roll, pitch, yaw, ° (FLU, as on the wire: pitch positive nose down).
    pub roll_pitch_yaw_deg: Option<[f64; 3]>,
    /// Altitude, m.
    pub altitude_m: Option<f64>,
    /// Vertical speed, m/s.
    pub climb_mps: Option<f64>,
    /// Altitude setpoint, m.
    pub setpoint_m: Option<f64>,
    /// Position, m, east and north, where something measures it.
    pub east_north_m: Option<[f64; 2]>,
    /// Motors as applied, 0..1.
    pub motors: Vec<f64>,
    /// Any motor at its limit?
    pub saturated: bool,
    /// Attitude as a quaternion w, x, y, z.
    pub world_from_body: Option<[f64; 4]>,
    /// Age of the estimate, s.
    pub age_s: Option<f64>,
    /// Is the estimate too old to be used?
    pub stale: bool,
    /// What the estimator says of itself.
    pub health: v1::Health,
}

impl Instrument {
    /// Newest values, at flight time `now_us`.
    pub fn newest(live: &Live, now_us: f64) -> Self {
        let mut out = Self { stale: true, ..Self::default() };
        if let Some(topic) = live.estimate() {
            out.age_s = topic.age_s(now_us);
            out.stale = topic.is_stale(now_us);
            if let Some(estimate) = topic.get() {
                let angles = estimate.roll_pitch_yaw_rad;
                out.roll_pitch_yaw_deg = angles.map(|a| [a.x * DEGREES, a.y * DEGREES, a.z * DEGREES]);
                out.altitude_m = estimate.position_enu_m.map(|p| p.z);
                out.east_north_m = estimate.position_enu_m.filter(|_| estimate.horizontal_known).map(|p| [p.x, p.y]);
                out.climb_mps = estimate.velocity_enu_mps.map(|v| v.z);
                out.world_from_body = estimate.world_from_body.map(|q| [q.w, q.x, q.y, q.z]);
                out.health = estimate.health();
            }
        }
        if let Some(control) = live.control.get() {
            out.setpoint_m = control.setpoint.as_ref().and_then(|s| s.altitude_m);
            out.motors = control.motor_applied.clone();
            out.saturated = control.saturated;
        }
        out
    }

    /// Values of a recorded flight at `time_s`, read from its curves.
    pub fn at(live: &Live, time_s: f64) -> Self {
        let estimator = live.in_loop();
        let at = |curve, time_s| live.curves.value_at(curve, time_s);
        let read = |curve| at(curve, time_s).or_else(|| at(curve, time_s + FIRST_S));
        let angle = |axis| read(Curve::Attitude(estimator, axis));
        let angles = match (angle(Axis::Roll), angle(Axis::Pitch), angle(Axis::Yaw)) {
            (Some(roll), Some(pitch), Some(yaw)) => Some([roll, pitch, yaw]),
            _ => None,
        };
        Self {
            stale: angles.is_none(),
            world_from_body: angles.map(|[r, p, y]| quaternion(r / DEGREES, p / DEGREES, y / DEGREES)),
            roll_pitch_yaw_deg: angles,
            altitude_m: read(Curve::Altitude(estimator)),
            climb_mps: read(Curve::Velocity(estimator, Way::Up)),
            setpoint_m: read(Curve::SetpointAltitude),
            east_north_m: read(Curve::Plane(Horizontal::East))
                .zip(read(Curve::Plane(Horizontal::North)))
                .map(Into::into),
            motors: (0..8).map_while(|i| read(Curve::Motor(i))).collect(),
            saturated: false,
            age_s: None,
            health: v1::Health::Unspecified,
        }
    }
}

/// The quaternion w, x, y, z of yaw, pitch, roll (ZYX), rad.
pub fn quaternion(roll: f64, pitch: f64, yaw: f64) -> [f64; 4] {
    let ((sr, cr), (sp, cp), (sy, cy)) = ((roll / 2.0).sin_cos(), (pitch / 2.0).sin_cos(), (yaw / 2.0).sin_cos());
    [cr * cp * cy + sr * sp * sy, sr * cp * cy - cr * sp * sy, cr * sp * cy + sr * cp * sy, cr * cp * sy - sr * sp * cy]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::live::append;
    use plumbline_proto::Kind;

    fn flight() -> Live {
        let mut live = Live::recorded();
        let mut batch = Vec::new();
        for i in 0..10_u64 {
            let estimate = v1::Estimate {
                time_us: i * 100_000,
                in_loop: true,
                position_enu_m: Some(v1::Vector3 { x: 1.0, y: 2.0, z: i as f64 }),
                roll_pitch_yaw_rad: Some(v1::Vector3 { x: 0.0, y: 0.0, z: 1.0 }),
                ..Default::default()
            };
            append(&mut batch, Kind::Estimate, 1, i + 1, i * 100_000, &estimate);
        }
        live.ingest(&batch, 0.0).unwrap();
        live
    }

    #[test]
    fn newest_and_past_values_come_from_the_same_flight() {
        let live = flight();
        let newest = Instrument::newest(&live, 900_000.0);
        assert_eq!((newest.altitude_m, newest.stale, newest.age_s), (Some(9.0), false, Some(0.0)));
        assert!(Instrument::newest(&live, 5e6).stale);
        let past = Instrument::at(&live, 0.45);
        assert_eq!(past.altitude_m, Some(4.0));
        let q = past.world_from_body.unwrap();
        assert!((q[3] - 0.5_f64.sin()).abs() < 1e-6);
    }

    #[test]
    fn nothing_is_not_zero() {
        let nothing = Instrument::newest(&Live::default(), 0.0);
        assert!(nothing.stale && nothing.altitude_m.is_none() && nothing.motors.is_empty());
    }
}
