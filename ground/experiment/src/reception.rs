//! What stands between the sensors and the estimator, and who flies: the agent as it is shipped, or what anyone would try first.

use plumbline_agent::attack::{Attack, Injector, Schedule};
use plumbline_agent::command::Command;
use plumbline_agent::flight::{Flight, FlightError};
use plumbline_agent::sensor::SensorFrame;
use plumbline_agent::sensor::imu::ImuSample;
use plumbline_agent::types::MotorCommand;
use plumbline_proto::time::FlightTime;
use plumbline_proto::v1::SensorKind;

use crate::draw::median;
use crate::flight::{FlyError, Setup};
use crate::monitor::{FRESH_S, Monitor, Test};
use crate::selector::Selector;

/// What the estimator receives.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Reception {
    /// What the attacks leave.
    #[default]
    All,
    /// The same, by somebody who knows: sensors are withheld while they are attacked; those of a recording, whose attack is received
    /// again, from its onset on.
    Oracle,
    /// One IMU and one height in the place of all, each the median of what is received.
    Median,
    /// Without the sensors that a detector excludes.
    Detected(Test),
    /// An estimator for each IMU, with every other sensor; the one in the loop is chosen as PX4's EKF2 does.
    EkfPerImu,
}

impl Reception {
    /// Name in a plan.
    pub const NAMED: [(&'static str, Self); 6] = [
        ("all", Self::All),
        ("oracle", Self::Oracle),
        ("median", Self::Median),
        ("chi_square", Self::Detected(Test::ChiSquare)),
        ("cusum", Self::Detected(Test::Cusum)),
        ("ekf_per_imu", Self::EkfPerImu),
    ];
}

/// The attacks of a flight that are `of` a kind, and what they follow.
fn schedule(setup: &Setup, of: impl Fn(&Attack) -> bool) -> Schedule {
    let attacks = setup.attacks.iter().copied().filter(of).collect();
    let mut schedule = Schedule { id: 1, attacks, sequences: setup.sequences.clone() };
    let Schedule { attacks, sequences, .. } = &mut schedule;
    sequences.retain(|sequence| attacks.iter().any(|attack| attack.id == sequence.attack));
    schedule
}

fn on_rotor(attack: &Attack) -> bool {
    attack.sensor.kind == SensorKind::Rotor
}

/// What the agent's own injector does: all of it where nothing stands before the estimator; else what the motors are told, for nobody
/// stands before those.
pub(crate) fn injected(setup: &Setup) -> Schedule {
    schedule(setup, |attack| setup.reception == Reception::All || on_rotor(attack))
}

/// Makes of what is sensed what is received.
pub(crate) struct Receiver<'a> {
    setup: &'a Setup,
    /// When onsets count from.
    begin: FlightTime,
    /// Where somebody stands between sensors and estimator, the attack comes before them.
    injector: Injector,
    monitor: Monitor,
    medians: Medians,
}

impl<'a> Receiver<'a> {
    pub(crate) fn new(setup: &'a Setup, begin: FlightTime) -> Result<Self, FlyError> {
        let mut injector = Injector::new(setup.config.attacks.bounds, true, &setup.config.sensors);
        if !matches!(setup.reception, Reception::All | Reception::Oracle) {
            let uploaded = injector.upload(&schedule(setup, |attack| !on_rotor(attack)), begin);
            uploaded.map_err(|error| FlyError::Attacks(error.to_string()))?;
        }
        Ok(Self { setup, begin, injector, monitor: Monitor::since(begin), medians: Medians::default() })
    }

    pub(crate) fn receives(&mut self, sensed: &SensorFrame, flight: &Flight) -> SensorFrame {
        let frame = self.injector.apply(sensed);
        match self.setup.reception {
            Reception::All | Reception::EkfPerImu => frame,
            Reception::Oracle => {
                let t = frame.time.seconds_since(self.begin);
                let given = self.setup.attacks.iter().map(|a| (a.sensor, a.start_s..a.start_s + a.duration_s));
                // Of a sensor that was attacked then a recording has the onset, and no end.
                let then = self.setup.recording.iter().flat_map(|recorded| &recorded.attacked);
                let then = then.map(|(sensor, onset_s)| (*sensor, *onset_s..f64::INFINITY));
                let mut frame = frame;
                for (attacked, _) in given.chain(then).filter(|(_, during_s)| during_s.contains(&t)) {
                    frame.withhold(|sensor| sensor == attacked);
                }
                frame
            }
            Reception::Median => self.medians.of(&frame),
            Reception::Detected(test) => {
                self.monitor.take(&frame, altitude_m(flight));
                self.monitor.without(test, frame)
            }
        }
    }
}

/// Altitude of the estimator in the loop, where it knows one, ENU, m.
pub fn altitude_m(flight: &Flight) -> Option<f64> {
    flight.estimate_in_loop()?.motion.filter(|motion| motion.altitude_known).map(|motion| motion.position_enu_m.z)
}

/// The agent's flight, or one for each IMU of which one is chosen.
pub(crate) struct Flights {
    /// At least one.
    all: Vec<Flight>,
    selector: Option<Selector>,
}

impl Flights {
    pub(crate) fn new(setup: &Setup) -> Result<Self, FlightError> {
        let many = setup.reception == Reception::EkfPerImu;
        let imus = setup.config.sensors.iter().filter(|sensor| sensor.kind == SensorKind::Imu).count();
        let count = if many { imus.max(1) } else { 1 };
        let all = (0..count).map(|_| Flight::new(setup.config.clone())).collect::<Result<Vec<_>, _>>()?;
        Ok(Self { all, selector: many.then(|| Selector::new(count)) })
    }

    /// The one that flies.
    pub(crate) fn chosen(&mut self) -> &mut Flight {
        let chosen = self.selector.as_ref().map_or(0, Selector::chosen);
        &mut self.all[chosen]
    }

    pub(crate) fn each(&mut self, of: impl FnMut(&mut Flight)) {
        self.all.iter_mut().for_each(of);
    }

    /// Has each attacked so.
    ///
    /// # Errors
    /// Why it is refused.
    pub(crate) fn attack(&mut self, schedule: Schedule, now: FlightTime) -> Result<(), FlyError> {
        if schedule.attacks.is_empty() {
            return Ok(());
        }
        let command = Command::Attack(schedule);
        self.all.iter_mut().try_for_each(|flight| {
            let ack = flight.apply(&command, now);
            if ack.accepted { Ok(()) } else { Err(FlyError::Attacks(ack.reason.to_string())) }
        })
    }

    pub(crate) fn apply(&mut self, command: &Command, now: FlightTime) {
        self.each(|flight| {
            let _ = flight.apply(command, now);
        });
    }

    pub(crate) fn step(&mut self, sensed: &SensorFrame, received: &SensorFrame) -> MotorCommand {
        let Some(selector) = &mut self.selector else { return self.chosen().step_received(sensed, received).command };
        for (i, flight) in self.all.iter_mut().enumerate() {
            let mut own = *received;
            own.imus.iter_mut().enumerate().filter(|(other, _)| *other != i).for_each(|(_, imu)| *imu = None);
            flight.step_received(sensed, &own);
        }
        selector.take(received, &self.all);
        self.chosen().report().command
    }
}

/// One IMU and one height in the place of all: the median of what is fresh, component by component.
#[derive(Default)]
struct Medians {
    last: SensorFrame,
}

impl Medians {
    fn of(&mut self, frame: &SensorFrame) -> SensorFrame {
        self.last.imus.iter_mut().zip(&frame.imus).filter(|(_, new)| new.is_some()).for_each(|(old, new)| *old = *new);
        let heights = self.last.heights.iter_mut().zip(&frame.heights);
        heights.filter(|(_, new)| new.is_some()).for_each(|(old, new)| *old = *new);
        let mut out = *frame;
        let fresh: Vec<ImuSample> =
            self.last.imus.iter().flatten().filter(|s| frame.time.seconds_since(s.time) < FRESH_S).copied().collect();
        let anew = out.imus.iter().any(Option::is_some);
        out.imus = Default::default();
        if let Some(newest) = fresh.iter().max_by_key(|s| s.time).filter(|_| anew) {
            let of =
                |value: &dyn Fn(&ImuSample) -> Option<f64>| median(&fresh.iter().filter_map(value).collect::<Vec<_>>());
            let mut sample = *newest;
            for axis in 0..3 {
                sample.gyro_radps[axis] = of(&|s| Some(s.gyro_radps[axis]));
                sample.accel_mps2[axis] = of(&|s| Some(s.accel_mps2[axis]));
                if let Some(mag) = &mut sample.mag_ut {
                    mag[axis] = of(&|s| s.mag_ut.map(|m| m[axis]));
                }
            }
            out.imus[0] = Some(sample);
        }
        let anew = out.heights.iter().flatten().next().copied();
        out.heights = Default::default();
        if let Some(mut newest) = anew {
            // Lasers take turns: each counts until its next scan.
            let fresh =
                self.last.heights.iter().flatten().filter(|s| frame.time.seconds_since(s.time) < 10.0 * FRESH_S);
            newest.height_m = median(&fresh.map(|s| s.height_m).collect::<Vec<_>>());
            out.heights[0] = Some(newest);
        }
        out
    }
}
