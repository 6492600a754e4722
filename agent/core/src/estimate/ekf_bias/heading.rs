//! Magnetic headings: yaw alone.

use arrayvec::ArrayVec;
use nalgebra::Vector3;
use plumbline_proto::ids::SensorId;
use plumbline_proto::time::FlightTime;
use plumbline_proto::v1::SensorKind;

use super::EkfBias;
use super::aiding::{finite, row};
use super::covariance::{Covariance, N, ix};
use crate::estimate::aiding::freshness::{Freshness, RECOVERY_S};
use crate::estimate::filter::kalman::forget;
use crate::estimate::filter::row::ScalarRow;
use crate::estimate::{Channel, median};
use crate::frames::wrap_pi;
use crate::sensor::heading::{self, Heading};
use crate::sensor::{Accuracy, MAX_IMUS, SensorFrame};

/// Headings of one instance are taken at most this often, s.
const HEADING_PERIOD_S: f64 = 0.1;

/// The magnetometers.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Headings {
    freshness: Freshness,
    latest: [Option<FlightTime>; MAX_IMUS],
    /// Strength of the field each measured first, µT.
    strength_ut: [Option<f64>; MAX_IMUS],
}

/// The row of a heading that corrects yaw alone: roll and pitch, which a field bent by motors and iron would pull along, are
/// left alone; their error enters the variance instead.
pub fn yaw_row(of: (SensorId, Channel), heading: &Heading, noise: Accuracy, p: &Covariance) -> ScalarRow<N> {
    let mut row = row(of, &heading.row, noise, 0.0);
    let tilt = Vector3::new(heading.row.d_attitude.x, heading.row.d_attitude.y, 0.0);
    let p_tilt = p.fixed_view::<3, 3>(ix::ATTITUDE, ix::ATTITUDE);
    row.variance += (tilt.transpose() * p_tilt * tilt).x;
    row.h[ix::ATTITUDE] = 0.0;
    row.h[ix::ATTITUDE + 1] = 0.0;
    row
}

impl EkfBias {
    pub(super) fn aid_headings(&mut self, frame: &SensorFrame) {
        let model = self.model.imus.mag;
        let mut arrived: ArrayVec<(usize, f64), MAX_IMUS> = ArrayVec::new();
        for (i, imu) in frame.imus.iter().enumerate() {
            let Some(field) = imu.and_then(|s| s.mag_ut).filter(finite) else { continue };
            if self.aided.headings.latest[i].is_some_and(|t| frame.time.seconds_since(t) < HEADING_PERIOD_S - 1e-4) {
                continue;
            }
            let at = &self.state.kinematics;
            if let Some(heading) = heading::heading(at, &field, model.declination_rad) {
                self.aided.headings.latest[i] = Some(frame.time);
                arrived.push((i, heading.row.innovation));
            }
        }
        let Some(&(_, first)) = arrived.first() else { return };
        if !self.yaw_known {
            // The first magnetometers after a start without one: about one of them, for they may lie on both sides of ±π.
            self.turn(first + median(arrived.iter().map(|(_, y)| wrap_pi(y - first))));
            forget(&mut self.p, ix::ATTITUDE + 2, super::align::YAW_SIGMA_FIELD_RAD.powi(2));
            self.yaw_known = true;
        }
        let centre = if arrived.len() == 2 { 0.0 } else { median(arrived.iter().map(|(_, y)| *y)) };
        arrived.sort_unstable_by(|a, b| wrap_pi(a.1 - centre).abs().total_cmp(&wrap_pi(b.1 - centre).abs()));
        let mut used = false;
        let mut undisturbed = false;
        for (i, _) in arrived {
            let Some(field) = frame.imus[i].and_then(|s| s.mag_ut) else { continue };
            let at = &self.state.kinematics;
            let Some(heading) = heading::heading(at, &field, model.declination_rad) else { continue };
            let strength = *self.aided.headings.strength_ut[i].get_or_insert_with(|| field.norm());
            let disturbed = (field.norm() / strength - 1.0).abs() > model.field_tolerance;
            let sigma = (model.sigma_ut / heading.horizontal_ut).hypot(model.floor_rad);
            let noise = Accuracy { sigma, gate: model.gate };
            let of = (SensorId::new(SensorKind::Imu, i as u8 + 1), Channel::Heading);
            let mut row = yaw_row(of, &heading, noise, &self.p);
            row.refused = disturbed;
            undisturbed |= !disturbed;
            used |= self.correct(&row);
        }
        if used || undisturbed {
            self.aided.headings.freshness.note(frame.time, used);
        }
        if !used && undisturbed && self.aided.headings.freshness.rejected_s(frame.time) > 5.0 * RECOVERY_S {
            // A field of the right strength that has pointed elsewhere for long: let yaw's variance
            // grow by 1°/√s until the gate lets it in. Gyroscopes hold yaw much longer than an iron
            // shelf passes by.
            let z = ix::ATTITUDE + 2;
            self.p[(z, z)] += 0.0175f64.powi(2) * HEADING_PERIOD_S;
        }
    }
}
