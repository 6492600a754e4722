//! Vehicles whose link ends at another ground: what that ground passes on, beside what arrives here itself.

use plumbline_rest::ground::AtGround;

use super::{Hub, VehicleError};
use crate::sync::lock;

impl Hub {
    /// The ground that the link of `id` ends at; `None` where that is this one.
    pub(crate) fn ground_of(&self, id: &str) -> Option<AtGround> {
        lock(&self.vehicles).get(id)?.ground.clone()
    }

    /// Is `id` commanded from here?
    ///
    /// # Errors
    /// [`VehicleError`] when it is not known, or is commanded from another ground.
    pub(crate) fn commanded_here(&self, id: &str) -> Result<(), VehicleError> {
        match lock(&self.vehicles).get(id) {
            None => Err(VehicleError::Unknown(id.to_owned())),
            Some(vehicle) => match vehicle.ground.clone() {
                Some(ground) => Err(VehicleError::Elsewhere { vehicle: id.to_owned(), ground }),
                None => Ok(()),
            },
        }
    }
}
