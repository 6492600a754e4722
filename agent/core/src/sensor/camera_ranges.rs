//! Ranges from the motion-capture cameras (\[Umasankar\] Eq. 13).
//!
//! Range from a motion-capture camera to the markers' centroid: y = ‖p − c‖ (\[Umasankar\] Eq. 13).
//!
//! The mean of the four marker ranges is not the centroid's range (errata 9, up to 2.54 mm): the sample
//! here is the centroid's.

use nalgebra::{Matrix3, Vector3};
use plumbline_proto::{Kind, time::FlightTime, v1};
use serde::Deserialize;

use super::measure::{Kinematics, Row};
use super::sample::{Quantity, Sample, Scalars};
use super::suite::{self, Checker, Quality, Sheet, SuiteError, Timing};
use super::wire::{self, Received};
use crate::types::CAMERAS;

/// Ranges from the motion-capture cameras to the markers' centroid.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CameraRangesSample {
    /// When they were measured.
    pub time: FlightTime,
    /// One range per camera, m.
    pub range_m: [f64; CAMERAS],
}

impl Sample for CameraRangesSample {
    const TOPIC: Kind = Kind::CameraRanges;
    const KIND: v1::SensorKind = v1::SensorKind::CameraRanges;
    const QUANTITIES: &'static [Quantity] = &[Quantity { name: "range", unit: "m", scalars: CAMERAS, named: false }];
    type Wire = v1::CameraRangesSample;
    type Sheet = CameraRanges;
    type Model = CameraRangesModel;

    fn model(sheets: &[CameraRanges]) -> CameraRangesModel {
        sheets.first().map_or(
            CameraRangesModel {
                cameras_enu_m: corners(),
                // The rated one and three exaggerated ([Umasankar], Results).
                sigma_m: [1.5e-3, 15e-3, 2e-3, 100e-3],
                gate: 5.0,
            },
            |s| CameraRangesModel {
                cameras_enu_m: s.cameras_enu_m,
                sigma_m: [s.range.total_sigma().max(1e-4); CAMERAS],
                gate: s.range.gate_sigmas,
            },
        )
    }

    fn time(&self) -> FlightTime {
        self.time
    }

    fn with_time(self, time: FlightTime) -> Self {
        Self { time, ..self }
    }

    fn scalars(&self) -> Scalars {
        let mut values = Scalars::default();
        values[..CAMERAS].copy_from_slice(&self.range_m);
        values
    }

    fn with_scalars(mut self, values: &Scalars) -> Self {
        self.range_m.copy_from_slice(&values[..CAMERAS]);
        self
    }

    fn wire_with_room() -> v1::CameraRangesSample {
        let range = || Some(v1::CameraRangesReading { range_m: Vec::with_capacity(CAMERAS) });
        v1::CameraRangesSample { sensed: range(), received: range(), ..v1::CameraRangesSample::default() }
    }

    fn to_wire(&self, received: Option<&Self>, into: &mut v1::CameraRangesSample) {
        let put = |reading: &mut v1::CameraRangesReading, s: &Self| {
            reading.range_m.clear();
            reading.range_m.extend_from_slice(&s.range_m);
        };
        into.time_us = self.time.0;
        into.received_time_us = wire::received_time_us(self, received);
        put(into.sensed.get_or_insert_default(), self);
        match received {
            Some(received) if !received.is_same(self) => {
                into.set_reception(v1::Reception::Altered);
                put(into.received.get_or_insert_default(), received);
            }
            other => {
                let how = if other.is_some() { v1::Reception::AsSensed } else { v1::Reception::Dropped };
                into.set_reception(how);
                into.received = None;
            }
        }
    }

    fn from_wire(m: v1::CameraRangesSample) -> Option<(Self, Received<Self>)> {
        let time = FlightTime(m.time_us);
        let both = wire::sample(m.reception(), m.sensed, m.received, |r: v1::CameraRangesReading| {
            Some(Self { time, range_m: r.range_m.first_chunk().copied()? })
        })?;
        Some(wire::stamped(both, m.received_time_us))
    }
}

/// What estimators assume of camera ranges.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CameraRangesModel {
    /// Cameras in the world frame ENU, m.
    pub cameras_enu_m: [Vector3<f64>; CAMERAS],
    /// One-sigma of each range, m.
    pub sigma_m: [f64; CAMERAS],
    /// Gate of each, in sigmas of its innovation.
    pub gate: f64,
}

/// Cameras of [Umasankar] Table 2, ENU, m.
fn corners() -> [Vector3<f64>; CAMERAS] {
    [(10.0, 10.0), (-10.0, 10.0), (-10.0, -10.0), (10.0, -10.0)].map(|(x, y)| Vector3::new(x, y, 10.0))
}

/// Range to `camera_enu_m` and its gradient ∂r/∂p (a unit vector; zero at the camera itself).
pub fn predict(position_enu_m: &Vector3<f64>, camera_enu_m: &Vector3<f64>) -> (f64, Vector3<f64>) {
    let d = position_enu_m - camera_enu_m;
    let range_m = d.norm();
    if range_m > 1e-9 { (range_m, d / range_m) } else { (0.0, Vector3::zeros()) }
}

/// Row of one range.
pub fn range(state: &Kinematics, camera_enu_m: &Vector3<f64>, range_m: f64) -> Row {
    let (predicted, gradient) = predict(&state.position_enu_m, camera_enu_m);
    Row::new(range_m - predicted).position(gradient)
}

/// Position from four ranges by Gauss–Newton, started in the middle of the floor; `None` when it does not
/// settle or a range is not finite.
pub fn trilaterate(
    cameras_enu_m: &[Vector3<f64>; CAMERAS],
    range_m: &[f64; CAMERAS],
    sigma_m: &[f64; CAMERAS],
) -> Option<Vector3<f64>> {
    let mut p = cameras_enu_m.iter().sum::<Vector3<f64>>() / CAMERAS as f64;
    p.z = 1.0;
    for _ in 0..20 {
        let mut information = Matrix3::zeros();
        let mut right = Vector3::zeros();
        for ((range, camera), sigma) in range_m.iter().zip(cameras_enu_m).zip(sigma_m) {
            let (predicted, gradient) = predict(&p, camera);
            let w = 1.0 / (sigma * sigma);
            information += gradient * gradient.transpose() * w;
            right += gradient * (range - predicted) * w;
        }
        let step = information.cholesky()?.solve(&right);
        p += step;
        if step.norm() < 1e-6 {
            return p.iter().all(|x| x.is_finite()).then_some(p);
        }
    }
    None
}

/// Ranges to the motion-capture cameras (\[Umasankar\] Eq. 13).
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CameraRanges {
    /// For people.
    pub name: String,
    /// When it samples.
    pub timing: Timing,
    /// Where the cameras are, ENU, m.
    pub cameras_enu_m: [Vector3<f64>; CAMERAS],
    /// Range, m.
    pub range: Quality,
    /// Deliver the mean of the four marker ranges, as a real system does, instead of the range to the
    /// centroid: up to 2.5 mm apart (ERRATA \[Umasankar\] 9).
    #[serde(default)]
    pub marker_mean: bool,
}

impl Sheet for CameraRanges {
    /// Four cameras at (±10, ±10, 10) m, 120 Hz, 1.5 mm (\[Umasankar\] Table 2 and its Vicon data sheet).
    fn typical(_instance: usize) -> Self {
        Self {
            name: "camera ranges 1".into(),
            timing: Timing::at(120.0),
            cameras_enu_m: corners(),
            range: Quality::white(0.0015),
            marker_mean: false,
        }
    }

    suite::named_and_timed!();

    fn qualities(&mut self, each: &mut dyn FnMut(&'static str, &mut Quality)) {
        each("range", &mut self.range);
    }

    fn check(&self, check: &Checker, key: &str) -> Result<(), SuiteError> {
        for (i, camera) in self.cameras_enu_m.iter().enumerate() {
            check.vector(key, &format!("cameras_enu_m[{i}]"), camera)?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::super::measure::check;
    use super::*;

    #[test]
    fn jacobian_matches_differences() {
        check::jacobian(&check::state(), |s| range(s, &Vector3::new(10.0, -10.0, 10.0), 17.0), 1e-7);
        let at_camera = range(&check::state(), &check::state().position_enu_m, 1.0);
        assert!(at_camera.innovation.is_finite() && at_camera.d_position.norm() == 0.0);
    }

    #[test]
    fn four_ranges_give_the_position() {
        let o = CameraRangesSample::model(&[]);
        for p in [Vector3::new(0.3, -2.0, 1.2), Vector3::new(-4.0, 5.0, 0.0), Vector3::new(6.0, 1.0, 3.0)] {
            let ranges = o.cameras_enu_m.map(|c| (p - c).norm());
            let found = trilaterate(&o.cameras_enu_m, &ranges, &o.sigma_m).unwrap();
            assert!((found - p).norm() < 1e-6, "{found} for {p}");
            assert!(trilaterate(&o.cameras_enu_m, &[f64::NAN, 1.0, 1.0, 1.0], &o.sigma_m).is_none());
        }
    }
}
