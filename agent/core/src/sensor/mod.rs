//! Sensors: what their samples hold, what arrives in a tick, and what a data sheet says of them.
//!
//! One file a kind: its sample with scalars, quantities and wire form, its measurement model and what estimators assume of
//! it, and its data sheet. The table below registers it; its device is the simulator's. Everything is SI, calibrated, in the body
//! frame FLU or the world frame ENU; NED, FRD and degrees stay inside the driver that speaks them.

pub mod barometer;
pub mod camera_ranges;
pub mod gnss;
pub mod heading;
pub mod height;
pub mod imu;
pub mod measure;
pub mod mocap_pose;
pub mod noise;
pub mod sample;
pub mod suite;
mod table;
pub mod wire;

use plumbline_proto::{Kind, Message, ids::SensorId, time::FlightTime, v1::SensorKind};
use serde::Deserialize;

pub use barometer::BarometerSample;
pub use camera_ranges::CameraRangesSample;
pub use gnss::GnssSample;
pub use height::HeightSample;
pub use imu::ImuSample;
pub use mocap_pose::MocapPoseSample;

pub use sample::Accuracy;

use sample::{Places, Quantity, Sample};
use suite::{Fill, Sheet, key};
use wire::Received;

/// Most sensors of one kind that a frame can carry.
pub const MAX_IMUS: usize = 5;
/// Most laser heights.
pub const MAX_HEIGHTS: usize = 5;
/// Most barometers.
pub const MAX_BAROMETERS: usize = 2;

table::sensors! {
    /// IMUs; index 0 is instance 1.
    imus: [Option<ImuSample>; MAX_IMUS] => Imu(ImuSample);
    /// Laser heights.
    heights: [Option<HeightSample>; MAX_HEIGHTS] => Height(HeightSample);
    /// Barometers.
    barometers: [Option<BarometerSample>; MAX_BAROMETERS] => Barometer(BarometerSample);
    /// GNSS.
    gnss: Option<GnssSample> => Gnss(GnssSample);
    /// Motion-capture pose.
    mocap_pose: Option<MocapPoseSample> => MocapPose(MocapPoseSample);
    /// Motion-capture camera ranges.
    camera_ranges: Option<CameraRangesSample> => CameraRanges(CameraRangesSample);
}

/// A sample with a place in the frame.
pub trait Registered: Sample {
    /// Its places in a frame; index 0 is instance 1.
    fn places(frame: &SensorFrame) -> &[Option<Self>];
    /// The same, to alter.
    fn places_mut(frame: &mut SensorFrame) -> &mut [Option<Self>];
    /// Its kept message.
    fn wire(wires: &mut Wires) -> &mut Self::Wire;
    /// As a sample of any kind.
    fn any(self) -> AnySample;
}

/// Something to do with the place of every sensor, whatever its kind.
pub trait Visitor {
    /// The place of `sensor`.
    fn place<S: Registered>(&mut self, sensor: SensorId, place: &mut Option<S>);
}

/// Something to do with every sample sensed, beside what was received in its place.
pub trait PairVisitor {
    /// A sample of `sensor`.
    fn pair<S: Registered>(&mut self, sensor: SensorId, sensed: &S, received: Option<&S>);
}

impl SensorFrame {
    /// Empties the place of every sensor that `unwanted` names.
    pub fn withhold(&mut self, unwanted: impl Fn(SensorId) -> bool) {
        struct Withhold<F>(F);
        impl<F: Fn(SensorId) -> bool> Visitor for Withhold<F> {
            fn place<S: Registered>(&mut self, sensor: SensorId, place: &mut Option<S>) {
                if self.0(sensor) {
                    *place = None;
                }
            }
        }
        self.visit(&mut Withhold(unwanted));
    }
}

fn decode<S: Registered>(message: &[u8]) -> Option<(AnySample, Received<AnySample>)> {
    let (sensed, received) = S::from_wire(S::Wire::decode(message).ok()?)?;
    let received = match received {
        Received::AsSensed => Received::AsSensed,
        Received::Instead(sample) => Received::Instead(sample.map(S::any)),
    };
    Some((sensed.any(), received))
}
