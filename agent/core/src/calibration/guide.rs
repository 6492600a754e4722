//! How far the taking of samples by hand has come, counted by the fits themselves: what is asked of whoever turns the vehicle is
//! what will be asked of the samples.

use nalgebra::Vector3;

use super::inertial::Triad;
use super::samples::Sample;
use super::{CalibrationError, Kind, inertial, magnetometer};
use crate::types::GRAVITY_MPS2;

/// Something that a fit counts.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Aim {
    /// Of what, in the words of its refusal.
    pub what: &'static str,
    /// How many there are.
    pub found: usize,
    /// With fewer the fit refuses.
    pub needed: usize,
    /// From here on more of them determine no more parameters.
    pub best: usize,
}

/// What was taken so far. Directions are unit vectors in the body frame FLU.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Progress {
    /// What the fit counts; empty before the first sample.
    pub aims: Vec<Aim>,
    /// What the fit cannot tell yet, although all that it counts is there: more of the same mends that.
    pub undetermined: Option<CalibrationError>,
    /// How long the vehicle has been held still by now, as a share of what makes a pose, 0 to 1.
    pub still: f64,
    /// Where up is now; absent where no pose is asked for.
    pub up: Option<Vector3<f64>>,
    /// Where up was in each pose that counts, in the order they were taken.
    pub poses: Vec<Vector3<f64>>,
    /// Where the field points now, hard iron taken out once it is known; absent where no field is asked for.
    pub field: Option<Vector3<f64>>,
    /// The sphere of directions is cut into so many bands of one height, from −z to z.
    pub bands: usize,
    /// Which sectors of it were seen: band by band, in each from −π to π about z.
    pub sectors: Vec<bool>,
}

impl Progress {
    /// Is everything there without which the fit refuses?
    pub fn is_ready(&self) -> bool {
        self.is_counted() && self.undetermined.is_none()
    }

    fn is_counted(&self) -> bool {
        !self.aims.is_empty() && self.aims.iter().all(|aim| aim.found >= aim.needed)
    }
}

/// Can samples of this kind be taken by hand, with guidance?
pub fn is_guided(kind: Kind) -> bool {
    matches!(kind, Kind::Accelerometer | Kind::Gyroscope | Kind::Magnetometer)
}

/// How far samples of one IMU are from what the fit of this kind asks for; empty for a kind that is not guided.
///
/// # Errors
/// [`CalibrationError`]: NaN, saturation, time that runs backwards, as the fit refuses them.
pub fn progress(kind: Kind, samples: &[Sample]) -> Result<Progress, CalibrationError> {
    let mut progress = match kind {
        Kind::Accelerometer => inertial::poses_taken(samples)?,
        Kind::Gyroscope => inertial::turns_taken(samples)?,
        Kind::Magnetometer => magnetometer::directions_taken(samples)?,
        _ => Progress::default(),
    };
    if progress.is_counted() {
        let fitted = match kind {
            Kind::Accelerometer => inertial::accelerometer(samples, GRAVITY_MPS2),
            Kind::Gyroscope => inertial::gyroscope(samples, &Triad::identity()),
            _ => magnetometer::magnetometer(samples),
        };
        progress.undetermined = fitted.err().filter(is_mended_by_more);
    }
    Ok(progress)
}

/// A sensor in another field, or one that no model describes, is not: of that the fit itself tells.
fn is_mended_by_more(error: &CalibrationError) -> bool {
    use CalibrationError::{Singular, TooFew, TooSmall, Undetermined};
    matches!(error, TooFew { .. } | TooSmall { .. } | Undetermined { .. } | Singular(_))
}
