//! Whose motor is which rotor.
//!
//! PX4 (quad-X, `CA_ROTOR0` to `CA_ROTOR3`) and ArduPilot (`FRAME_TYPE` 1, X) number a quadrotor's motors alike. Seen from
//! above:
//!
//! | motor | place | turns |
//! |---|---|---|
//! | 1 | front right | counter-clockwise |
//! | 2 | rear left | counter-clockwise |
//! | 3 | front left | clockwise |
//! | 4 | rear right | clockwise |

use plumbline_core::model::airframe::{Airframe, Spin};
use plumbline_core::types::ROTORS;

/// Place, signs of x and y (FLU), spin of each motor.
const MOTORS: [(&str, f64, f64, Spin); ROTORS] = [
    ("front right", 1.0, -1.0, Spin::CounterClockwise),
    ("rear left", -1.0, 1.0, Spin::CounterClockwise),
    ("front left", 1.0, 1.0, Spin::Clockwise),
    ("rear right", -1.0, -1.0, Spin::Clockwise),
];

/// A rotor nearer to an axis than this part of its arm is on that axis.
const ON_AXIS: f64 = 0.2;

/// Why an airframe is no quad-X of PX4 and ArduPilot.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum QuadXError {
    /// No rotor there.
    #[error(
        "airframe {airframe}: no rotor {place}, where motor {motor} of a quad-X is; the rotors (x, y in m, FLU) are at {rotors}"
    )]
    NoRotor {
        /// Airframe.
        airframe: String,
        /// Where.
        place: &'static str,
        /// Whose, from 1.
        motor: usize,
        /// Where there are rotors.
        rotors: String,
    },
    /// It turns the other way.
    #[error("airframe {airframe}: rotor {rotor} ({place}) turns {spin:?}, motor {motor} of a quad-X the other way")]
    Spin {
        /// Airframe.
        airframe: String,
        /// Which, from 1.
        rotor: usize,
        /// Where.
        place: &'static str,
        /// Its spin.
        spin: Spin,
        /// Whose, from 1.
        motor: usize,
    },
}

/// The index of the rotor of `airframe` that each motor of a quad-X turns.
///
/// # Errors
/// [`QuadXError`] for an airframe that is none.
pub fn rotors(airframe: &Airframe) -> Result<[usize; ROTORS], QuadXError> {
    let mut found = [0; ROTORS];
    for (motor, (found, (place, ahead, left, spin))) in found.iter_mut().zip(MOTORS).enumerate() {
        let rotor = airframe.rotors.iter().position(|rotor| {
            let hub = rotor.position_flu_m.xy();
            let near = ON_AXIS * hub.norm();
            hub.x * ahead > near && hub.y * left > near
        });
        let Some(rotor) = rotor else {
            let places = airframe.rotors.iter().map(|rotor| {
                let hub = rotor.position_flu_m;
                format!("({:.2}, {:.2})", hub.x, hub.y)
            });
            let rotors = places.collect::<Vec<_>>().join(", ");
            return Err(QuadXError::NoRotor { airframe: airframe.name.clone(), place, motor: motor + 1, rotors });
        };
        let own = airframe.rotors[rotor].spin;
        if own != spin {
            let airframe = airframe.name.clone();
            return Err(QuadXError::Spin { airframe, rotor: rotor + 1, place, spin: own, motor: motor + 1 });
        }
        *found = rotor;
    }
    Ok(found)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn motors_find_their_rotors_by_place_in_whatever_order() {
        assert_eq!(rotors(&Airframe::iris()).unwrap(), [0, 1, 2, 3]);
        let mut turned = Airframe::iris();
        turned.rotors.rotate_left(1);
        assert_eq!(rotors(&turned).unwrap(), [3, 0, 1, 2]);
    }

    #[test]
    fn another_frame_or_spin_is_refused_by_name() {
        let plus = rotors(&Airframe::paternain()).unwrap_err().to_string();
        assert!(plus.contains("no rotor front right") && plus.contains("(0.31, 0.00)"), "{plus}");
        let mut reversed = Airframe::iris();
        for rotor in &mut reversed.rotors {
            rotor.spin = match rotor.spin {
                Spin::Clockwise => Spin::CounterClockwise,
                Spin::CounterClockwise => Spin::Clockwise,
            };
        }
        let reversed = rotors(&reversed).unwrap_err().to_string();
        assert!(reversed.contains("rotor 1 (front right) turns Clockwise"), "{reversed}");
    }
}
