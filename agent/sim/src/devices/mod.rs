//! Truth ─► samples: rates, phases, delays, drop-outs, and the errors of each sensor.
//!
//! One file a kind, registered in the list below. A sensor samples on the first tick at or after its due time and stamps
//! that tick's time; a delayed sample is delivered later with the stamp of its measurement. What a driver and its
//! calibration would remove (mounting angles, lever of a laser) is removed here; what they cannot know stays in.

mod barometer;
mod camera_ranges;
mod gnss;
mod height;
mod imu;
mod mocap_pose;

use arrayvec::ArrayVec;
use nalgebra::Vector3;
use plumbline_core::sensor::noise::{ScalarError, Stream};
use plumbline_core::sensor::sample::Sample;
use plumbline_core::sensor::suite::{MAX_UNDER_WAY, Quality, Sheet, Suite, Timing};
use plumbline_core::sensor::{MAX_BAROMETERS, MAX_HEIGHTS, MAX_IMUS, Registered, SensorFrame};
use plumbline_proto::{ids::SensorId, time::FlightTime};

use super::site::Site;
use super::world::World;

/// A sensor warms up by this much, °C …
const WARM_UP_C: f64 = 12.0;
/// … with this time constant, s (both chosen).
const WARM_UP_S: f64 = 180.0;

/// Keeps the units of each kind of the suite, and lets those that are due measure.
macro_rules! devices {
    ($($field:ident: $units:ty;)*) => {
        /// Every sensor of the suite.
        #[derive(Debug, Clone)]
        pub struct Sensors {
            site: Site,
            outages: Vec<Outage>,
            $($field: $units,)*
            battery: Option<(f64, Stream)>,
        }

        impl Sensors {
            /// The sensors of `suite` at `site`; `seed` draws their biases and their noise.
            pub fn new(suite: &Suite, site: Site, outages: &[Outage], seed: u64) -> Self {
                Self {
                    site,
                    outages: outages.to_vec(),
                    $($field: (1..).zip(suite.$field.iter()).map(|(i, sheet)| Unit::new(i, sheet, seed)).collect(),)*
                    battery: suite.battery_sigma_v.map(|sigma| (sigma, Stream::new(seed, "battery"))),
                }
            }

            /// Everything that arrives at `time`. Never allocates.
            pub fn sense(&mut self, world: &World, time: FlightTime) -> SensorFrame {
                let mut frame = SensorFrame { time, ..SensorFrame::default() };
                let warm_c = WARM_UP_C * (1.0 - (-time.as_seconds() / WARM_UP_S).exp());
                let now = Now { time, world, site: &self.site, warm_c };
                let outages = self.outages.as_slice();
                $(tick(&mut self.$field, &now, outages, &mut frame);)*
                if let Some((sigma, stream)) = &mut self.battery {
                    frame.battery_v = Some(world.battery_v() + *sigma * stream.normal());
                }
                frame
            }
        }
    };
}

devices! {
    imus: ArrayVec<Unit<imu::Imu>, MAX_IMUS>;
    heights: ArrayVec<Unit<height::Height>, MAX_HEIGHTS>;
    barometers: ArrayVec<Unit<barometer::Barometer>, MAX_BAROMETERS>;
    gnss: ArrayVec<Unit<gnss::Gnss>, 1>;
    mocap_pose: ArrayVec<Unit<mocap_pose::MocapPose>, 1>;
    camera_ranges: ArrayVec<Unit<camera_ranges::CameraRanges>, 1>;
}

/// What a device can measure.
struct Now<'a> {
    time: FlightTime,
    world: &'a World,
    site: &'a Site,
    /// By how much electronics are warmer than the air, °C.
    warm_c: f64,
}

impl Now<'_> {
    /// Temperature of a sensor, °C.
    fn temperature_c(&self) -> f64 {
        self.site.temperature_c + self.warm_c
    }
}

/// A simulated device of one kind.
trait Device {
    /// Its samples.
    type Sample: Registered;

    /// A unit of this data sheet; `stream` draws its biases.
    fn new(sheet: &<Self::Sample as Sample>::Sheet, stream: &mut Stream) -> Self;

    /// One reading; `None` when it sees nothing. Draws the same numbers either way.
    fn measure(&mut self, now: &Now<'_>, stream: &mut Stream) -> Option<Self::Sample>;
}

/// A device with the clock that drives it.
#[derive(Debug, Clone)]
struct Unit<D: Device> {
    clock: Clock<D::Sample>,
    device: D,
}

impl<D: Device> Unit<D> {
    fn new(instance: u8, sheet: &<D::Sample as Sample>::Sheet, seed: u64) -> Self {
        let mut clock = Clock::new(SensorId::new(D::Sample::KIND, instance), *sheet.timing(), seed);
        Self { device: D::new(sheet, &mut clock.stream), clock }
    }
}

/// Puts what arrives of one kind into its places.
fn tick<D: Device>(units: &mut [Unit<D>], now: &Now<'_>, outages: &[Outage], frame: &mut SensorFrame) {
    for (Unit { clock, device }, place) in units.iter_mut().zip(D::Sample::places_mut(frame)) {
        *place = clock.tick(now.time, outages, |stream| device.measure(now, stream));
    }
}

/// A stretch of time during which one sensor, or all of a kind, gives nothing.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Outage {
    /// The sensor.
    pub sensor: SensorId,
    /// When, s.
    pub start_s: f64,
    /// How long, s.
    pub duration_s: f64,
}

/// Decides which ticks a sensor samples at, and carries its samples until they are delivered.
#[derive(Debug, Clone)]
struct Clock<T> {
    sensor: SensorId,
    timing: Timing,
    taken: u64,
    due_us: u64,
    delay_us: u64,
    under_way: ArrayVec<(u64, T), MAX_UNDER_WAY>,
    stream: Stream,
}

impl<T: Copy> Clock<T> {
    fn new(sensor: SensorId, timing: Timing, seed: u64) -> Self {
        let mut clock = Self {
            sensor,
            timing,
            taken: 0,
            due_us: 0,
            delay_us: (timing.delay_s * 1e6).round() as u64,
            under_way: ArrayVec::new(),
            stream: Stream::new(seed, &sensor.to_string()),
        };
        clock.plan();
        clock
    }

    fn plan(&mut self) {
        self.due_us = ((self.timing.phase_s + self.taken as f64 / self.timing.rate_hz) * 1e6).round() as u64;
    }

    /// The sample that arrives at this tick. `measure` runs when one is due.
    fn tick(
        &mut self,
        time: FlightTime,
        outages: &[Outage],
        measure: impl FnOnce(&mut Stream) -> Option<T>,
    ) -> Option<T> {
        let mut fresh = None;
        if time.0 >= self.due_us {
            while time.0 >= self.due_us {
                self.taken += 1;
                self.plan();
            }
            // The draws happen whether or not the sample arrives: losing one changes no other.
            let lost = self.timing.dropout > 0.0 && self.stream.uniform() < self.timing.dropout;
            fresh = measure(&mut self.stream);
            let now_s = time.as_seconds();
            let out = outages
                .iter()
                .any(|o| o.sensor == self.sensor && now_s >= o.start_s && now_s < o.start_s + o.duration_s);
            if lost || out {
                fresh = None;
            }
        }
        if self.delay_us == 0 {
            return fresh;
        }
        // Bound: the suite's check keeps fewer than MAX_UNDER_WAY under way; were it full, the newest is lost.
        if let Some(sample) = fresh {
            let _ = self.under_way.try_push((time.0 + self.delay_us, sample));
        }
        match self.under_way.first() {
            Some((arrival, _)) if *arrival <= time.0 => self.under_way.pop_at(0).map(|(_, sample)| sample),
            _ => None,
        }
    }
}

fn triple(quality: Quality, timing: &Timing, stream: &mut Stream) -> [ScalarError; 3] {
    std::array::from_fn(|_| ScalarError::new(quality, timing.period_s(), stream))
}

fn read3(errors: &mut [ScalarError; 3], truth: &Vector3<f64>, stream: &mut Stream) -> Vector3<f64> {
    let [x, y, z] = errors;
    Vector3::new(x.read(truth.x, stream), y.read(truth.y, stream), z.read(truth.z, stream))
}

impl Sensors {
    /// Bias of the accelerometer of IMU `index` (from 0) now, body FLU, m/s²: for tests.
    pub fn accel_bias_mps2(&self, index: usize) -> Option<Vector3<f64>> {
        let imu = &self.imus.get(index)?.device;
        let [x, y, z] = &imu.accel;
        Some(imu.body_from_sensor * Vector3::new(x.bias(), y.bias(), z.bias()))
    }

    /// Bias of the gyroscope of IMU `index` (from 0) now, body FLU, rad/s: for tests.
    pub fn gyro_bias_radps(&self, index: usize) -> Option<Vector3<f64>> {
        let imu = &self.imus.get(index)?.device;
        let [x, y, z] = &imu.gyro;
        Some(imu.body_from_sensor * Vector3::new(x.bias(), y.bias(), z.bias()))
    }
}
