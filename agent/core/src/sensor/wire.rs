//! The parts that the messages of the sensors have in common.

use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use plumbline_proto::time::FlightTime;
use plumbline_proto::v1::{self, Reception};

use super::sample::Sample;

/// What the estimators received of a sample sensed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Received<S> {
    /// The very sample.
    AsSensed,
    /// Another one, or none: an attack altered or withheld it.
    Instead(Option<S>),
}

/// How what was received relates to what was sensed; the received reading only where it differs.
pub fn reception<S: Sample, R>(sensed: &S, received: Option<&S>, reading: impl Fn(&S) -> R) -> (i32, Option<R>) {
    match received {
        None => (Reception::Dropped as i32, None),
        Some(received) if received.is_same(sensed) => (Reception::AsSensed as i32, None),
        Some(received) => (Reception::Altered as i32, Some(reading(received))),
    }
}

/// The inverse: the sample sensed and what was received, from the readings of a message.
pub fn sample<R, S>(
    reception: Reception,
    sensed: Option<R>,
    received: Option<R>,
    make: impl Fn(R) -> Option<S>,
) -> Option<(S, Received<S>)> {
    let received = match reception {
        Reception::AsSensed => Received::AsSensed,
        Reception::Altered => Received::Instead(Some(make(received?)?)),
        Reception::Dropped => Received::Instead(None),
    };
    Some((make(sensed?)?, received))
}

/// Stamp of what was received, where it is another than that of what was sensed, µs.
pub fn received_time_us<S: Sample>(sensed: &S, received: Option<&S>) -> Option<u64> {
    received.map(|received| received.time().0).filter(|time_us| *time_us != sensed.time().0)
}

/// The inverse: what was received has the stamp told.
pub fn stamped<S: Sample>((sensed, received): (S, Received<S>), time_us: Option<u64>) -> (S, Received<S>) {
    let received = match (received, time_us) {
        (Received::Instead(Some(received)), Some(time_us)) => {
            Received::Instead(Some(received.with_time(FlightTime(time_us))))
        }
        (received, _) => received,
    };
    (sensed, received)
}

/// Time and message of a sample, in its `impl Sample`: the message holds a reading as sensed and, where it differs, one as
/// received. `$reading` makes it of a sample, `$sample` the inverse (`None` where a part is missing).
macro_rules! message {
    ($message:ident of $reading_type:ident, $reading:expr, $sample:expr) => {
        type Wire = v1::$message;

        fn time(&self) -> FlightTime {
            self.time
        }

        fn with_time(self, time: FlightTime) -> Self {
            Self { time, ..self }
        }

        fn to_wire(&self, received: Option<&Self>, into: &mut v1::$message) {
            let reading: fn(&Self) -> v1::$reading_type = $reading;
            let received_time_us = wire::received_time_us(self, received);
            let (reception, received) = wire::reception(self, received, reading);
            let (time_us, sensed) = (self.time.0, Some(reading(self)));
            *into = v1::$message { time_us, reception, sensed, received, received_time_us };
        }

        fn from_wire(m: v1::$message) -> Option<(Self, Received<Self>)> {
            let sample: fn(FlightTime, v1::$reading_type) -> Option<Self> = $sample;
            let time = FlightTime(m.time_us);
            let both = wire::sample(m.reception(), m.sensed, m.received, |reading| sample(time, reading))?;
            Some(wire::stamped(both, m.received_time_us))
        }
    };
}
pub(super) use message;

/// A vector for the wire; always there.
pub fn vector(v: &Vector3<f64>) -> Option<v1::Vector3> {
    Some(v1::Vector3 { x: v.x, y: v.y, z: v.z })
}

/// A vector from the wire.
pub fn xyz(v: &v1::Vector3) -> Vector3<f64> {
    Vector3::new(v.x, v.y, v.z)
}

/// A quaternion for the wire; always there.
pub fn quaternion(q: &UnitQuaternion<f64>) -> Option<v1::Quaternion> {
    Some(v1::Quaternion { w: q.w, x: q.i, y: q.j, z: q.k })
}

/// The unit quaternion with exactly these components, so that a replay repeats every bit; `None` where they are not
/// of unit length.
pub fn unit_quaternion(q: &v1::Quaternion) -> Option<UnitQuaternion<f64>> {
    let q = Quaternion::new(q.w, q.x, q.y, q.z);
    ((q.norm() - 1.0).abs() < 1e-6).then(|| UnitQuaternion::new_unchecked(q))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sensor::{CameraRangesSample, HeightSample};

    #[test]
    fn a_sample_that_holds_what_is_no_number_is_received_as_sensed() {
        let told = |sensed_m: f64, received_m: f64| {
            let [sensed, received] =
                [sensed_m, received_m].map(|height_m| HeightSample { time: FlightTime(1), height_m });
            reception(&sensed, Some(&received), |s| s.height_m).0
        };
        assert_eq!([told(1.0, 1.0), told(f64::NAN, f64::NAN)], [Reception::AsSensed as i32; 2]);
        let altered = [told(1.0, 2.0), told(f64::NAN, 1.0), told(1.0, f64::NAN)];
        assert_eq!(altered, [Reception::Altered as i32; 3]);
        let ranges = CameraRangesSample { time: FlightTime(1), range_m: [f64::NAN, 1.0, 2.0, 3.0] };
        let mut message = CameraRangesSample::wire_with_room();
        ranges.to_wire(Some(&ranges), &mut message);
        assert_eq!(message.reception(), Reception::AsSensed);
    }
}
