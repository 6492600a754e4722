//! Paths over time: circle, sine, square, heave (\[Umasankar\] flies hover, circle and sine), and a list of
//! altitudes.
//!
//! A path begins softly: its own time runs from standstill to full speed within `SOFT_START_S`, so that
//! position and velocity are continuous. Velocity and acceleration are fed forward.

use std::fmt;

use arrayvec::ArrayVec;
use nalgebra::Vector3;

use super::setpoint::{Limits, rests_at};

/// Most altitudes of a list.
pub const MAX_ALTITUDES: usize = 16;
/// The path's own time reaches full speed after this long, s.
const SOFT_START_S: f64 = 2.0;
/// Largest horizontal speed and acceleration of a path, m/s, m/s².
const SPEED_MAX_MPS: f64 = 2.0;
const ACCELERATION_MAX_MPS2: f64 = 2.5;
/// Points of a soft start and one turn that are looked at before a path is flown: more than 100 of a turn.
const CHECKED: u32 = 400;
/// Longest path, s.
const DURATION_MAX_S: f64 = 3600.0;
/// Fastest turn or swing, s.
const PERIOD_MIN_S: f64 = 1.0;

/// A path from its start.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Shape {
    /// A circle through the start, to its north, counter-clockwise.
    Circle {
        /// m.
        radius_m: f64,
        /// Of one turn, s.
        period_s: f64,
    },
    /// Eastward at constant speed, swinging north and south.
    Sine {
        /// m.
        amplitude_m: f64,
        /// Of one swing, s.
        period_s: f64,
        /// m/s.
        speed_mps: f64,
    },
    /// A square with the start at its south-west corner, counter-clockwise at constant speed.
    Square {
        /// m.
        side_m: f64,
        /// Of one turn, s.
        period_s: f64,
    },
    /// Up and down about the start.
    Heave {
        /// m.
        amplitude_m: f64,
        /// Of one swing, s.
        period_s: f64,
    },
}

impl Shape {
    /// Displacement from the start after `t_s`, ENU, m.
    pub fn displacement_m(&self, t_s: f64) -> Vector3<f64> {
        let angle = |period_s: f64| std::f64::consts::TAU * t_s / period_s;
        match *self {
            Self::Circle { radius_m, period_s } => {
                let a = angle(period_s);
                Vector3::new(radius_m * a.sin(), radius_m * (1.0 - a.cos()), 0.0)
            }
            Self::Sine { amplitude_m, period_s, speed_mps } => {
                Vector3::new(speed_mps * t_s, amplitude_m * angle(period_s).sin(), 0.0)
            }
            Self::Square { side_m, period_s } => {
                let leg = 4.0 * (t_s / period_s).rem_euclid(1.0);
                let along = |from: f64| side_m * (leg - from).clamp(0.0, 1.0);
                Vector3::new(along(0.0) - along(2.0), along(1.0) - along(3.0), 0.0)
            }
            Self::Heave { amplitude_m, period_s } => Vector3::new(0.0, 0.0, amplitude_m * angle(period_s).sin()),
        }
    }

    /// Velocity (m/s) and acceleration (m/s²) after `t_s`, ENU; a square's corners have none.
    pub fn motion(&self, t_s: f64) -> (Vector3<f64>, Vector3<f64>) {
        let turn = |period_s: f64| {
            let w = std::f64::consts::TAU / period_s;
            (w, w * t_s)
        };
        match *self {
            Self::Circle { radius_m: r, period_s } => {
                let (w, a) = turn(period_s);
                let (sin, cos) = a.sin_cos();
                (Vector3::new(cos, sin, 0.0) * (r * w), Vector3::new(-sin, cos, 0.0) * (r * w * w))
            }
            Self::Sine { amplitude_m, period_s, speed_mps } => {
                let (w, a) = turn(period_s);
                let (sin, cos) = a.sin_cos();
                (
                    Vector3::new(speed_mps, amplitude_m * w * cos, 0.0),
                    Vector3::new(0.0, -amplitude_m * w * w * sin, 0.0),
                )
            }
            Self::Square { side_m, period_s } => {
                let speed = 4.0 * side_m / period_s;
                let leg = (4.0 * (t_s / period_s).rem_euclid(1.0)) as usize;
                let way = [Vector3::x(), Vector3::y(), -Vector3::x(), -Vector3::y()];
                (way.get(leg).copied().unwrap_or_default() * speed, Vector3::zeros())
            }
            Self::Heave { amplitude_m, period_s } => {
                let (w, a) = turn(period_s);
                (Vector3::z() * (amplitude_m * w * a.cos()), Vector3::z() * (-amplitude_m * w * w * a.sin()))
            }
        }
    }

    /// Does it need the horizontal position?
    pub fn horizontal(&self) -> bool {
        !matches!(self, Self::Heave { .. })
    }

    /// Name, and its numbers, for checks.
    fn numbers(&self) -> (&'static str, f64, f64, f64) {
        match *self {
            Self::Circle { radius_m, period_s } => ("radius_m", radius_m, period_s, 0.0),
            Self::Sine { amplitude_m, period_s, speed_mps } => ("amplitude_m", amplitude_m, period_s, speed_mps),
            Self::Square { side_m, period_s } => ("side_m", side_m, period_s, 0.0),
            Self::Heave { amplitude_m, period_s } => ("amplitude_m", amplitude_m, period_s, 0.0),
        }
    }
}

/// For people.
impl fmt::Display for Shape {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Circle { radius_m, period_s } => write!(f, "circle of {radius_m} m radius, {period_s} s a turn"),
            Self::Sine { amplitude_m, period_s, speed_mps } => {
                write!(f, "sine of {amplitude_m} m, {period_s} s a swing, at {speed_mps} m/s")
            }
            Self::Square { side_m, period_s } => write!(f, "square of {side_m} m, {period_s} s a turn"),
            Self::Heave { amplitude_m, period_s } => write!(f, "heave of {amplitude_m} m, {period_s} s a swing"),
        }
    }
}

/// What is flown.
#[derive(Debug, Clone, PartialEq)]
pub enum Trajectory {
    /// A shape from where the setpoint is.
    Shape {
        /// Which.
        shape: Shape,
        /// How long, s; until stopped when zero.
        duration_s: f64,
    },
    /// Altitudes one after the other, m, each for `hold_s`.
    Altitudes {
        /// m.
        altitude_m: ArrayVec<f64, MAX_ALTITUDES>,
        /// s.
        hold_s: f64,
    },
}

/// Why a trajectory is not flown.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum TrajectoryError {
    /// A number is out of its range.
    #[error("{name} is {value}: it must be {least} to {most}")]
    Value {
        /// Which.
        name: &'static str,
        /// The offending value.
        value: f64,
        /// Least.
        least: f64,
        /// Most.
        most: f64,
    },
    /// It leaves the limits.
    #[error("the path reaches {name} {value:.2} {unit}, limit {limit} {unit}")]
    Leaves {
        /// Of what.
        name: &'static str,
        /// How far.
        value: f64,
        /// How far it may.
        limit: f64,
        /// Unit of both.
        unit: &'static str,
    },
    /// No altitude is given.
    #[error("the list of altitudes is empty")]
    Empty,
}

/// Position, velocity and acceleration of a moment, ENU.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Moment {
    /// m.
    pub position_enu_m: Vector3<f64>,
    /// m/s.
    pub velocity_enu_mps: Vector3<f64>,
    /// m/s².
    pub acceleration_enu_mps2: Vector3<f64>,
}

/// `shape` from `from_enu_m`, `t_s` after its soft start began.
pub fn moment(shape: &Shape, from_enu_m: &Vector3<f64>, t_s: f64) -> Moment {
    // The path's own time, its rate and the change of that.
    let (time, rate, change) = if t_s < SOFT_START_S {
        (0.5 * t_s * t_s / SOFT_START_S, t_s / SOFT_START_S, 1.0 / SOFT_START_S)
    } else {
        (t_s - 0.5 * SOFT_START_S, 1.0, 0.0)
    };
    let (velocity, acceleration) = shape.motion(time);
    Moment {
        position_enu_m: from_enu_m + shape.displacement_m(time),
        velocity_enu_mps: velocity * rate,
        acceleration_enu_mps2: acceleration * (rate * rate) + velocity * change,
    }
}

impl Trajectory {
    /// Moments of a shape from `from_enu_m` that stand for all of it: the soft start, one turn, which every other turn is
    /// like, and the end; what moves on is farthest there. Of a list there are none.
    pub fn moments(&self, from_enu_m: &Vector3<f64>) -> impl Iterator<Item = Moment> {
        let (shape, turn_s) = match self {
            Self::Shape { shape, .. } => (Some(shape), SOFT_START_S + shape.numbers().2),
            Self::Altitudes { .. } => (None, 0.0),
        };
        let span_s = self.end_s().map_or(turn_s, |end_s| turn_s.min(end_s));
        let times = (0..=CHECKED).map(move |step| span_s * f64::from(step) / f64::from(CHECKED)).chain(self.end_s());
        shape.into_iter().flat_map(move |shape| times.clone().map(move |t_s| moment(shape, from_enu_m, t_s)))
    }

    /// When a shape ends by itself, s.
    fn end_s(&self) -> Option<f64> {
        match self {
            Self::Shape { duration_s, .. } => Some(*duration_s).filter(|duration_s| *duration_s > 0.0),
            Self::Altitudes { .. } => None,
        }
    }

    /// Is it all finite, within the limits and not too fast, when it begins at `from_enu_m`?
    ///
    /// # Errors
    /// [`TrajectoryError`] with the offending value.
    pub fn check(
        &self,
        from_enu_m: &Vector3<f64>,
        limits: &Limits,
        altitude_max_m: f64,
    ) -> Result<(), TrajectoryError> {
        let within = |name, value: f64, least: f64, most: f64| {
            if (least..=most).contains(&value) {
                Ok(())
            } else {
                Err(TrajectoryError::Value { name, value, least, most })
            }
        };
        let leaves = |name, value: f64, limit: f64, unit| {
            if value > limit { Err(TrajectoryError::Leaves { name, value, limit, unit }) } else { Ok(()) }
        };
        match self {
            Self::Altitudes { altitude_m, hold_s } => {
                if altitude_m.is_empty() {
                    return Err(TrajectoryError::Empty);
                }
                within("hold_s", *hold_s, PERIOD_MIN_S, DURATION_MAX_S)?;
                altitude_m.iter().try_for_each(|z| within("altitude_m", *z, limits.altitude_min_m, altitude_max_m))
            }
            Self::Shape { shape, duration_s } => {
                let (name, size, period_s, speed_mps) = shape.numbers();
                within(name, size, 0.01, 2.0 * limits.lateral_max_m.max(altitude_max_m.min(1e3)))?;
                within("period_s", period_s, PERIOD_MIN_S, DURATION_MAX_S)?;
                within("speed_mps", speed_mps, -SPEED_MAX_MPS, SPEED_MAX_MPS)?;
                // A sine that moves on must end; every other path comes back.
                let least = if speed_mps == 0.0 { 0.0 } else { f64::MIN_POSITIVE };
                within("duration_s", *duration_s, least, DURATION_MAX_S)?;
                let inside = |p: &Vector3<f64>| -> Result<(), TrajectoryError> {
                    if shape.horizontal() {
                        leaves("x", p.x.abs(), limits.lateral_max_m, "m")?;
                        leaves("y", p.y.abs(), limits.lateral_max_m, "m")
                    } else {
                        leaves("altitude", p.z, altitude_max_m, "m")?;
                        leaves("depth", -p.z, -limits.altitude_min_m, "m")
                    }
                };
                for m in self.moments(from_enu_m) {
                    inside(&m.position_enu_m)?;
                    let v = m.velocity_enu_mps;
                    if shape.horizontal() {
                        leaves("speed", v.xy().norm(), SPEED_MAX_MPS, "m/s")?;
                        leaves("acceleration", m.acceleration_enu_mps2.xy().norm(), ACCELERATION_MAX_MPS2, "m/s²")?;
                    } else {
                        leaves("climb", v.z, limits.climb_max_mps, "m/s")?;
                        leaves("descent", -v.z, limits.descent_max_mps, "m/s")?;
                    }
                }
                // Behind its end it still brakes.
                self.end_s().map_or(Ok(()), |end_s| {
                    let end = moment(shape, from_enu_m, end_s);
                    inside(&rests_at(&end.position_enu_m, &end.velocity_enu_mps))
                })
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SHAPES: [Shape; 4] = [
        Shape::Circle { radius_m: 1.0, period_s: 8.0 },
        Shape::Square { side_m: 1.0, period_s: 8.0 },
        Shape::Heave { amplitude_m: 1.0, period_s: 8.0 },
        Shape::Sine { amplitude_m: 0.5, period_s: 4.0, speed_mps: 0.3 },
    ];

    #[test]
    fn shapes_start_at_their_start_and_close() {
        for shape in &SHAPES[..3] {
            assert!(shape.displacement_m(0.0).norm() < 1e-12);
            assert!(shape.displacement_m(8.0).norm() < 1e-9, "{shape:?}");
        }
        let square = Shape::Square { side_m: 2.0, period_s: 8.0 };
        for (t, x, y) in [(1.0, 1.0, 0.0), (2.0, 2.0, 0.0), (3.0, 2.0, 1.0), (5.0, 1.0, 2.0), (7.0, 0.0, 1.0)] {
            assert!((square.displacement_m(t) - Vector3::new(x, y, 0.0)).norm() < 1e-12, "at {t}");
        }
        let circle = Shape::Circle { radius_m: 1.5, period_s: 8.0 };
        assert!((circle.displacement_m(4.0) - Vector3::new(0.0, 3.0, 0.0)).norm() < 1e-12);
    }

    #[test]
    fn velocity_and_acceleration_are_the_derivatives_soft_start_included() {
        let h = 1e-5;
        for shape in SHAPES {
            for t in [0.5, 1.3, 2.9, 5.1, 9.7] {
                let at = |t| moment(&shape, &Vector3::new(0.3, -0.2, 1.0), t);
                let (before, now, after) = (at(t - h), at(t), at(t + h));
                let v = (after.position_enu_m - before.position_enu_m) / (2.0 * h);
                let a = (after.velocity_enu_mps - before.velocity_enu_mps) / (2.0 * h);
                assert!((v - now.velocity_enu_mps).norm() < 1e-6, "{shape:?} at {t}");
                assert!((a - now.acceleration_enu_mps2).norm() < 1e-6, "{shape:?} at {t}");
            }
            assert!(moment(&shape, &Vector3::zeros(), 0.0).velocity_enu_mps.norm() < 1e-12);
        }
    }

    #[test]
    fn what_leaves_the_limits_or_is_too_fast_is_refused_with_its_value() {
        let limits = Limits::default();
        let check = |shape, duration_s| {
            let path = Trajectory::Shape { shape, duration_s };
            path.check(&Vector3::new(0.0, 0.0, 1.0), &limits, 2.0).map_err(|e| e.to_string())
        };
        assert!(check(SHAPES[0], 0.0).is_ok() && check(SHAPES[1], 20.0).is_ok());
        let circle = |radius_m, period_s| check(Shape::Circle { radius_m, period_s }, 0.0).unwrap_err();
        assert!(circle(1.5, 30.0).starts_with("the path reaches y 2.0"), "{}", circle(1.5, 30.0));
        assert!(circle(1.0, 2.0).contains("speed") || circle(1.0, 2.0).contains("acceleration"));
        assert_eq!(circle(f64::NAN, 8.0), "radius_m is NaN: it must be 0.01 to 4");
        assert!(check(SHAPES[3], 0.0).unwrap_err().starts_with("duration_s is 0"));
        assert!(check(SHAPES[3], 60.0).unwrap_err().contains("reaches x"));
        // Too far in every turn, however many there are.
        for duration_s in [0.0, 9.0, 3600.0] {
            let deep = check(Shape::Heave { amplitude_m: 1.1, period_s: 9.0 }, duration_s).unwrap_err();
            assert!(deep.starts_with("the path reaches"), "{deep}");
        }
        assert!(check(Shape::Heave { amplitude_m: 0.5, period_s: 9.0 }, 3600.0).is_ok());
        // It ends inside at 1 m/s, and comes to rest half a metre behind.
        let fast = Shape::Sine { amplitude_m: 0.1, period_s: 9.0, speed_mps: 1.0 };
        assert!(check(fast, 2.4).is_ok());
        assert!(check(fast, 2.9).unwrap_err().starts_with("the path reaches x 2.4"), "{:?}", check(fast, 2.9));
        let list = |z: &[f64]| Trajectory::Altitudes { altitude_m: z.iter().copied().collect(), hold_s: 5.0 };
        let check = |z: &[f64]| list(z).check(&Vector3::zeros(), &limits, 1.5).map_err(|e| e.to_string());
        assert!(check(&[0.5, 1.0]).is_ok());
        assert_eq!(check(&[0.5, 1.6]).unwrap_err(), "altitude_m is 1.6: it must be 0 to 1.5");
        assert!(check(&[]).is_err());
    }
}
