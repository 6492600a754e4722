//! Samples into slots of 40 ms by the time they were taken; a slot is closed once the fusion horizon has passed its end.

use nalgebra::Vector3;
use plumbline_proto::time::FlightTime;

use super::integral::{Integral, Six};
use super::stamps::{Stamps, from_elsewhere};
use super::{HORIZON_US, LANES, PerLane, SLOT_US};
use crate::estimate::median;
use crate::sensor::{GnssSample, MAX_BAROMETERS, MAX_HEIGHTS, MocapPoseSample, SensorFrame};

/// Slots open at a time: those of the horizon, and the present one.
const OPEN: usize = 4;

/// What was sampled in one slot; of each sensor but the IMUs the last sample.
#[derive(Debug, Clone, Copy, Default)]
pub struct Slot {
    /// Its number: it begins at so many times 40 ms.
    pub number: u64,
    /// Mean of each IMU.
    pub imus: PerLane<Option<Six>>,
    /// How much each IMU was shaken.
    pub roughness: PerLane<Option<Six>>,
    /// Does an IMU repeat itself?
    pub stuck: PerLane<bool>,
    /// Magnetic field, median of the magnetometers, body FLU, µT.
    pub field_ut: Option<Vector3<f64>>,
    /// Laser heights, m.
    pub heights: [Option<(FlightTime, f64)>; MAX_HEIGHTS],
    /// Pressures, Pa, with the temperature the sample tells.
    pub barometers: [Option<crate::sensor::BarometerSample>; MAX_BAROMETERS],
    /// Motion capture.
    pub pose: Option<MocapPoseSample>,
    /// GNSS.
    pub gnss: Option<GnssSample>,
    /// Thrust as commanded, over the mass, m/s²; its mean.
    pub thrust_mps2: f64,
    /// Did the motors stand all the time?
    pub standing: bool,
}

impl Slot {
    /// Its end.
    pub fn end(&self) -> FlightTime {
        FlightTime((self.number + 1) * SLOT_US)
    }

    /// How long before its end `time` was, s: see [`age_s`].
    pub fn age_s(&self, time: FlightTime) -> f64 {
        age_s(self.end(), time)
    }
}

/// How long before `end` `time` was, s; less than nothing of what is known to be stamped too early.
pub(super) fn age_s(end: FlightTime, time: FlightTime) -> f64 {
    end.seconds_since(time).clamp(-0.1, 0.5)
}

#[derive(Debug, Clone, Copy)]
struct Open {
    slot: Slot,
    fields: PerLane<(Vector3<f64>, f64)>,
    thrust: (f64, f64),
}

impl Open {
    fn new(number: u64) -> Self {
        let slot = Slot { number, standing: true, ..Slot::default() };
        Self { slot, fields: [(Vector3::zeros(), 0.0); LANES], thrust: (0.0, 0.0) }
    }
}

/// See the module.
#[derive(Debug, Clone)]
pub struct Slots {
    integrals: PerLane<Integral>,
    /// Who tells times that cannot be.
    pub imu_stamps: Stamps<LANES>,
    /// And which heights do.
    pub height_stamps: Stamps<MAX_HEIGHTS>,
    open: [Open; OPEN],
    /// Number of the next to be closed; `None` before the first frame.
    next: Option<u64>,
}

impl Slots {
    /// None open.
    pub fn new() -> Self {
        Self {
            integrals: std::array::from_fn(|_| Integral::new()),
            imu_stamps: Stamps::IMUS,
            height_stamps: Stamps::HEIGHTS,
            open: std::array::from_fn(|_| Open::new(0)),
            next: None,
        }
    }

    /// The integrals of the IMUs.
    pub fn integrals(&self) -> &PerLane<Integral> {
        &self.integrals
    }

    /// The open slot of a sample of `time`: its own, or the oldest where that is closed already.
    fn of(&mut self, time: FlightTime) -> Option<&mut Open> {
        let next = self.next?;
        let number = (time.0 / SLOT_US).clamp(next, next + OPEN as u64 - 1);
        self.open.get_mut((number % OPEN as u64) as usize)
    }

    /// Takes what arrived, and the thrust per mass as commanded; `standing`: no motor turns.
    pub fn gather(&mut self, frame: &SensorFrame, thrust_mps2: f64, standing: bool) {
        if self.next.is_none() {
            let first = frame.time.0.saturating_sub(HORIZON_US) / SLOT_US;
            self.next = Some(first);
            (first..first + OPEN as u64)
                .for_each(|number| self.open[(number % OPEN as u64) as usize] = Open::new(number));
        }
        for (i, sample) in frame.imus.iter().enumerate() {
            let Some(sample) = sample.filter(|sample| self.imu_stamps.admit(i, sample.time, frame.time)) else {
                continue;
            };
            if let Some(integral) = self.integrals.get_mut(i) {
                integral.take(&sample);
            }
            let field = sample.mag_ut.filter(|field| field.iter().all(|x| x.is_finite()));
            if let Some((field, (sum, count))) = field.zip(self.of(sample.time).and_then(|open| open.fields.get_mut(i)))
            {
                *sum += field;
                *count += 1.0;
            }
        }
        for (i, sample) in frame.heights.iter().enumerate() {
            let Some(sample) = sample.filter(|sample| sample.height_m.is_finite()) else { continue };
            if !self.height_stamps.admit(i, sample.time, frame.time) {
                continue;
            }
            if let Some(place) = self.of(sample.time).and_then(|open| open.slot.heights.get_mut(i)) {
                *place = Some((sample.time, sample.height_m));
            }
        }
        for (i, sample) in frame.barometers.iter().enumerate() {
            let Some(sample) = sample.filter(|sample| sample.pressure_pa.is_finite()) else { continue };
            if !from_elsewhere(sample.time, frame.time) {
                continue;
            }
            if let Some(place) = self.of(sample.time).and_then(|open| open.slot.barometers.get_mut(i)) {
                *place = Some(sample);
            }
        }
        let sound = |sample: &MocapPoseSample| {
            from_elsewhere(sample.time, frame.time)
                && sample.position_enu_m.iter().chain(sample.world_from_body.coords.iter()).all(|x| x.is_finite())
        };
        if let Some((pose, open)) = frame.mocap_pose.filter(sound).and_then(|p| Some((p, self.of(p.time)?))) {
            open.slot.pose = Some(pose);
        }
        let finite = |sample: &GnssSample| {
            from_elsewhere(sample.time, frame.time) && sample.position_enu_m.iter().all(|x| x.is_finite())
        };
        if let Some((gnss, open)) = frame.gnss.filter(finite).and_then(|g| Some((g, self.of(g.time)?))) {
            open.slot.gnss = Some(gnss);
        }
        if let Some(open) = self.of(frame.time) {
            open.thrust = (open.thrust.0 + thrust_mps2, open.thrust.1 + 1.0);
            open.slot.standing &= standing;
        }
    }

    /// The oldest open slot, once `now` is the horizon past its end.
    pub fn close(&mut self, now: FlightTime) -> Option<Slot> {
        let number = self.next?;
        if now.0 < (number + 1) * SLOT_US + HORIZON_US {
            return None;
        }
        let open = self.open.get_mut((number % OPEN as u64) as usize)?;
        let mut slot = open.slot;
        slot.number = number;
        let sampled = || open.fields.iter().filter(|(_, count)| *count > 0.0);
        let axis = |axis: usize, _| median(sampled().map(|(sum, count)| sum[axis] / count));
        slot.field_ut = sampled().next().map(|_| Vector3::from_fn(axis));
        slot.thrust_mps2 = open.thrust.0 / open.thrust.1.max(1.0);
        slot.imus = std::array::from_fn(|i| self.integrals.get(i).and_then(|integral| integral.mean(number)));
        slot.roughness = std::array::from_fn(|i| self.integrals.get(i).and_then(|integral| integral.roughness(number)));
        slot.stuck = std::array::from_fn(|i| self.integrals.get(i).is_some_and(Integral::is_stuck));
        *open = Open::new(number + OPEN as u64);
        self.next = Some(number + 1);
        Some(slot)
    }
}
