//! Truth ─► samples: rates, phases, delays, drop-outs, and the errors of each sensor.
//!
//! One file a kind, registered in the list below. A sensor samples on the first tick at or after its due time and stamps
//! that tick's time; a delayed sample is delivered later with the stamp of its measurement. What a driver and its
//! calibration would remove (mounting angles, lever of a laser) is removed here; what they cannot know stays in.

mod barometer;
mod camera_ranges;
mod field;
mod gnss;
mod height;
mod imu;
mod mocap_pose;

use arrayvec::ArrayVec;
use nalgebra::Vector3;
use plumbline_core::sensor::noise::{ScalarError, Stream};
use plumbline_core::sensor::sample::Sample;
use plumbline_core::sensor::suite::{MAX_UNDER_WAY, Quality, Sheet, Timing};
use plumbline_core::sensor::{MAX_BAROMETERS, MAX_HEIGHTS, MAX_IMUS, Registered, SensorFrame};
use plumbline_proto::{ids::SensorId, time::FlightTime};

use super::conditions::{Conditions, QUIET};
use super::scenario::Scenario;
use super::site::Site;
use super::vibration::Vibration;
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
            surroundings: Option<Surroundings>,
            $($field: $units,)*
            battery: Option<(Voltmeter, Stream)>,
        }

        impl Sensors {
            /// The sensors of `scenario`; its seed draws their biases and their noise.
            pub fn new(scenario: &Scenario) -> Self {
                let mut suite = scenario.suite.clone();
                if scenario.ideal {
                    suite.sheets_mut(|_, sheet| quieten(sheet));
                }
                let seed = scenario.seed;
                let surroundings = scenario.conditions.as_ref().map(|c| Surroundings::new(c, scenario));
                let around = surroundings.as_ref();
                Self {
                    site: scenario.site,
                    outages: scenario.outages.clone(),
                    $($field: (1..).zip(suite.$field.iter()).map(|(i, sheet)| Unit::new(i, sheet, seed, around)).collect(),)*
                    battery: suite.battery_sigma_v.map(|sigma_v| {
                        let mut stream = Stream::new(seed, "battery");
                        (Voltmeter::new(sigma_v, around, &mut stream), stream)
                    }),
                    surroundings,
                }
            }

            /// Everything that arrives at `time`. Never allocates.
            pub fn sense(&mut self, world: &World, time: FlightTime) -> SensorFrame {
                let mut frame = SensorFrame { time, ..SensorFrame::default() };
                let (warm_up_c, warm_up_s) = self.surroundings.as_ref().map_or((WARM_UP_C, WARM_UP_S), Surroundings::warm_up);
                let mut warm_c = warm_up_c * (1.0 - (-time.as_seconds() / warm_up_s).exp());
                if let Some(around) = &mut self.surroundings {
                    around.vibration.step(world.rotor_speed_radps(), around.tick_s);
                    warm_c += around.cooled_k(world);
                }
                let now = Now { time, world, site: &self.site, warm_c, around: self.surroundings.as_ref() };
                let outages = self.outages.as_slice();
                $(tick(&mut self.$field, &now, outages, &mut frame);)*
                if let Some((voltmeter, stream)) = &mut self.battery {
                    frame.battery_v = Some(voltmeter.gain * world.battery_v() + voltmeter.sigma_v * stream.normal());
                }
                frame
            }
        }
    };
}

/// What is left of noise, and no bias.
fn quieten(sheet: &mut dyn Sheet) {
    sheet.qualities(&mut |_, quality| {
        quality.sigma *= QUIET;
        (quality.bias_sigma, quality.bias_walk, quality.resolution) = (0.0, 0.0, 0.0);
    });
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
    around: Option<&'a Surroundings>,
}

/// What a world does to all its sensors.
#[derive(Debug, Clone)]
struct Surroundings {
    conditions: Conditions,
    vibration: Vibration,
    tick_s: f64,
    seed: u64,
    /// By how much the rotors' wash warms, K.
    wash_k: f64,
}

/// How fast the wash of the rotors cools a sensor, s.
const WASH_S: f64 = 30.0;

/// What reads the battery.
#[derive(Debug, Clone, Copy)]
struct Voltmeter {
    gain: f64,
    sigma_v: f64,
}

impl Voltmeter {
    fn new(sigma_v: f64, around: Option<&Surroundings>, stream: &mut Stream) -> Self {
        let Some(around) = around else { return Self { gain: 1.0, sigma_v } };
        let c = &around.conditions.battery;
        Self { gain: 1.0 + c.voltage_gain_sigma * stream.normal(), sigma_v: c.voltage_noise_v }
    }
}

impl Surroundings {
    fn new(conditions: &Conditions, scenario: &Scenario) -> Self {
        let vibration = Vibration::new(conditions.vibration.clone(), scenario.seed);
        let (tick_s, seed) = (scenario.tick_s(), scenario.seed);
        Self { conditions: conditions.clone(), vibration, tick_s, seed, wash_k: 0.0 }
    }

    /// One tick in the wash of rotors that turn as in `world`: what it adds to a sensor's temperature, K.
    fn cooled_k(&mut self, world: &World) -> f64 {
        let airframe = world.airframe();
        let carried = airframe.wrench(world.rotor_speed_radps()).thrust_n / airframe.weight_n();
        let end_k = self.conditions.temperature.rotor_wash_step_k * carried.clamp(0.0, 1.0);
        self.wash_k += (end_k - self.wash_k) * (1.0 - (-self.tick_s / WASH_S).exp());
        self.wash_k
    }

    /// How far sensors warm up, °C, and how fast, s.
    fn warm_up(&self) -> (f64, f64) {
        let t = &self.conditions.temperature;
        (t.warm_up_k, t.warm_up_time_constant_s)
    }
}

impl Now<'_> {
    /// Temperature of a sensor, °C.
    fn temperature_c(&self) -> f64 {
        self.site.temperature_c + self.warm_c
    }
}

/// A simulated device of one kind.
trait Device: Sized {
    /// Its samples.
    type Sample: Registered;

    /// A unit of this data sheet; `stream` draws its biases.
    fn new(sheet: &<Self::Sample as Sample>::Sheet, stream: &mut Stream) -> Self;

    /// The same unit in a world; `stream` draws what that world makes of it.
    fn within(self, _around: &Surroundings, _stream: &mut Stream) -> Self {
        self
    }

    /// How its samples travel in a world.
    fn transport(_conditions: &Conditions) -> Option<Transport> {
        None
    }

    /// How often it measures in a world, where that is not what its data sheet says, s.
    fn period_s(_conditions: &Conditions) -> Option<f64> {
        None
    }

    /// Goes on by one tick, before it measures.
    fn tick(&mut self, _now: &Now<'_>) {}

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
    fn new(instance: u8, sheet: &<D::Sample as Sample>::Sheet, seed: u64, around: Option<&Surroundings>) -> Self {
        let sensor = SensorId::new(D::Sample::KIND, instance);
        let mut clock = Clock::new(sensor, *sheet.timing(), seed);
        let mut device = D::new(sheet, &mut clock.stream);
        if let Some(around) = around {
            let mut stream = Stream::new(around.seed, &format!("{sensor} in a world"));
            device = device.within(around, &mut stream);
            clock.transport = D::transport(&around.conditions).map(|transport| (transport, Way::new(stream)));
            if let Some(period_s) = D::period_s(&around.conditions) {
                clock.timing.rate_hz = 1.0 / period_s;
                clock.plan();
            }
        }
        Self { device, clock }
    }
}

/// How samples reach the flight loop: late, sometimes later, sometimes not.
#[derive(Debug, Clone, Copy, Default)]
struct Transport {
    delay_s: f64,
    /// One sigma of what comes on top of the delay; it only ever comes later.
    jitter_s: f64,
    /// Of single samples, 0..1.
    missing_fraction: f64,
    /// Stretches without any: how often, 1/s, and how long, s, at most or in the mean.
    gap_rate_per_s: f64,
    gap_max_s: f64,
    /// The delay is another one from time to time: how often, 1/s, and by how much it is longer at most, s.
    jump_rate_per_s: f64,
    jump_s: f64,
}

/// The way of one sensor's samples.
#[derive(Debug, Clone)]
struct Way {
    stream: Stream,
    gap_until_us: u64,
    last_arrival_us: u64,
    jumped_s: f64,
}

impl Way {
    fn new(stream: Stream) -> Self {
        Self { stream, gap_until_us: 0, last_arrival_us: 0, jumped_s: 0.0 }
    }

    /// When the sample of `time` arrives, µs; `None` when it is lost. Draws the same numbers either way.
    fn arrival_us(&mut self, time: FlightTime, period_s: f64, by: &Transport) -> Option<u64> {
        let [missing, gap, length] = std::array::from_fn(|_| self.stream.uniform());
        if by.jump_rate_per_s > 0.0 {
            let [jumps, far] = std::array::from_fn(|_| self.stream.uniform());
            if jumps < by.jump_rate_per_s * period_s {
                self.jumped_s = by.jump_s * far;
            }
        }
        let late_s = by.delay_s + self.jumped_s + by.jitter_s * self.stream.normal().abs();
        if gap < by.gap_rate_per_s * period_s {
            self.gap_until_us = time.0 + (1e6 * by.gap_max_s * length) as u64;
        }
        if missing < by.missing_fraction || time.0 < self.gap_until_us {
            return None;
        }
        self.last_arrival_us = self.last_arrival_us.max(time.0 + (1e6 * late_s) as u64);
        Some(self.last_arrival_us)
    }
}

/// Puts what arrives of one kind into its places.
fn tick<D: Device>(units: &mut [Unit<D>], now: &Now<'_>, outages: &[Outage], frame: &mut SensorFrame) {
    for (Unit { clock, device }, place) in units.iter_mut().zip(D::Sample::places_mut(frame)) {
        device.tick(now);
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
    transport: Option<(Transport, Way)>,
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
            transport: None,
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
        let (mut fresh, mut arrival_us) = (None, time.0 + self.delay_us);
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
            if let Some((transport, way)) = &mut self.transport {
                match way.arrival_us(time, self.timing.period_s(), transport) {
                    Some(us) => arrival_us = us.max(arrival_us),
                    None => fresh = None,
                }
            }
        }
        if self.delay_us == 0 && self.transport.is_none() {
            return fresh;
        }
        // Bound: the suite's check keeps fewer than MAX_UNDER_WAY under way; were it full, the newest is lost.
        if let Some(sample) = fresh {
            let _ = self.under_way.try_push((arrival_us, sample));
        }
        match self.under_way.first() {
            Some((arrival, _)) if *arrival <= time.0 => self.under_way.pop_at(0).map(|(_, sample)| sample),
            _ => None,
        }
    }
}

fn normal3(stream: &mut Stream) -> Vector3<f64> {
    Vector3::new(stream.normal(), stream.normal(), stream.normal())
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
