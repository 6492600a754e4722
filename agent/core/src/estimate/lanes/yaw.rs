//! Yaw where neither field nor pose tells it and GNSS shows it: a mixture over yaw (`yaw_mixture.rs`) runs beside the lanes, on
//! the median of the IMUs, as it does beside `ekf_bias`.
//!
//! Linearised about a yaw that may be wrong by 180° lanes would take what GNSS tells of the horizontal for tilt and bias, and
//! become sure of them. So they are told nothing of it: horizontal position, velocity and attitude of all lanes are those of
//! the mixture, and what tells them apart are the vertical and the vote.

use super::slot::Slot;
use super::{Lanes, SLOT_S, median_six, part};
use crate::estimate::ekf_bias::yaw::follow;
use crate::estimate::yaw_mixture::YawMixture;

/// See the module.
#[derive(Debug, Default)]
pub struct Yaw {
    /// By field or pose.
    pub known: bool,
    mixture: YawMixture,
}

impl Lanes {
    /// Shows the mixture a slot: from the first on, since start-up itself takes a second.
    pub(super) fn feed_mixture(&mut self, slot: &Slot) {
        self.aided.yaw.known |= slot.pose.is_some();
        if self.aided.yaw.known {
            return;
        }
        let mixture = &mut self.aided.yaw.mixture;
        let median = median_six(slot.imus.iter().flatten());
        if median.iter().all(|x| x.is_finite()) {
            mixture.push(SLOT_S, &part(&median, 3), &part(&median, 0));
        }
        if let Some(sample) = slot.gnss.filter(|sample| sample.position_enu_m.iter().all(|x| x.is_finite())) {
            let gnss = &self.model.gnss;
            mixture.take(slot.end(), &sample, gnss.position(&sample, 0).sigma, gnss.velocity.sigma);
        }
    }

    /// In a slot in which nothing but the mixture measures the yaw.
    pub(super) fn follow_mixture(&mut self) {
        let Yaw { known, mixture } = &self.aided.yaw;
        let Some(found) = mixture.horizontal().filter(|_| !known) else { return };
        let world_from_body = mixture.world_from_body();
        for lane in &mut self.lanes {
            follow(&found, &world_from_body, &mut lane.at, &mut lane.p);
        }
    }
}
