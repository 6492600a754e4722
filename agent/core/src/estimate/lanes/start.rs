//! Where the lanes begin: one attitude for all, from the median of the IMUs, and what each IMU is off by against it.

use nalgebra::Vector3;

use super::integral::Six;
use super::slot::Slot;
use super::{LANES, PerLane, SLOT_S, median_six};
use crate::estimate::ekf_bias::align::{Aligned, Alignment};
use crate::estimate::median;
use crate::sensor::MAX_HEIGHTS;
use crate::sensor::imu::ImuModel;

/// What was found.
#[derive(Debug, Clone, Copy)]
pub struct Found {
    /// Attitude and whether it was at rest.
    pub aligned: Aligned,
    /// Biases of each IMU.
    pub biases: PerLane<Six>,
    /// Altitude by the lasers, m.
    pub altitude_m: Option<f64>,
    /// Mean magnetic field, body FLU, µT.
    pub field_ut: Option<Vector3<f64>>,
}

/// See the module.
#[derive(Debug, Clone)]
pub struct Start {
    alignment: Alignment,
    sums: PerLane<(Six, f64)>,
    centre: (Six, f64),
    field: (Vector3<f64>, f64),
    heights: [Option<f64>; MAX_HEIGHTS],
}

impl Start {
    /// Nothing seen yet.
    pub fn new() -> Self {
        Self {
            alignment: Alignment::new(),
            sums: [(Six::zeros(), 0.0); LANES],
            centre: (Six::zeros(), 0.0),
            field: (Vector3::zeros(), 0.0),
            heights: [None; MAX_HEIGHTS],
        }
    }

    /// Takes a slot; `Some` when the attitude is known.
    pub fn take(&mut self, slot: &Slot, model: &ImuModel) -> Option<Found> {
        for (kept, height) in self.heights.iter_mut().zip(&slot.heights) {
            *kept = height.map(|(_, height_m)| height_m).or(*kept);
        }
        slot.imus.iter().flatten().next()?;
        for ((sum, count), mean) in self.sums.iter_mut().zip(&slot.imus) {
            if let Some(mean) = mean {
                *sum += mean;
                *count += 1.0;
            }
        }
        let centre = median_six(slot.imus.iter().flatten());
        self.centre = (self.centre.0 + centre, self.centre.1 + 1.0);
        if let Some(field) = slot.field_ut {
            self.field = (self.field.0 + field, self.field.1 + 1.0);
        }
        let (force, rate) = (centre.fixed_rows::<3>(0).into_owned(), centre.fixed_rows::<3>(3).into_owned());
        let field = slot.field_ut.as_ref();
        let (g, declination) = (model.gravity_mps2, model.mag.declination_rad);
        let aligned = self.alignment.push(SLOT_S, &rate, &force, field, g, declination)?;
        let at_rest = {
            let up: Vector3<f64> = aligned.world_from_body.inverse() * Vector3::z() * g;
            Six::new(up.x, up.y, up.z, 0.0, 0.0, 0.0)
        };
        let expected = if aligned.at_rest { at_rest } else { self.centre.0 / self.centre.1 };
        let own = |(sum, count): (Six, f64)| if count > 0.0 { sum / count - expected } else { Six::zeros() };
        let altitude_m = median(self.heights.iter().flatten().copied());
        Some(Found {
            aligned,
            biases: self.sums.map(own),
            altitude_m: Some(altitude_m).filter(|altitude_m| altitude_m.is_finite()),
            field_ut: (self.field.1 > 0.0 && aligned.field_ut.is_some()).then(|| self.field.0 / self.field.1),
        })
    }
}
