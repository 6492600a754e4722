//! The heart: one tick, and the commands between ticks.
//!
//! [`Flight::step`] is the whole tick: no I/O, no clock, no allocation. What may happen between
//! ticks is in `flight/orders.rs`, what the flight does by itself in `flight/guard.rs`
//! (modes, failsafes) and `flight/landing.rs`.

mod config;
mod guard;
mod landing;
mod orders;
mod path;
pub mod report;
mod rotors;
mod status;
mod support;
pub mod watermark;

use arrayvec::ArrayVec;
use plumbline_proto::ids::{GainsRevision, SensorId};
use plumbline_proto::time::FlightTime;
use plumbline_proto::v1::SensorKind;

use crate::attack::{Injector, MAX_ATTACKS, Phase as AttackPhase, Progress};
use crate::control::gains::{Certified, Examiner, GainsError};
use crate::control::in_loop::InLoop;
use crate::control::setpoint::Profile;
use crate::control::step_response::StepMeter;
use crate::estimate::bank::{Bank, BankError, Judge, build};
use crate::estimate::lanes::Lanes;
use crate::estimate::secure::Secure;
use crate::estimate::{Estimate, Estimator, Health, Motion};
use crate::event::{Event, EventKind, EventQueue, Severity, Text, text};
use crate::frames::roll_pitch_yaw;
use crate::mix::{Mixed, Mixer};
use crate::sensor::SensorFrame;
use crate::supervisor::{Agreement, Monitor, Watchdog};
use crate::types::{Actuation, EstimatorKind, Loops, Mode, MotorCommand, ROTORS, Setpoint, TICK_RATE_HZ, Wrench};

use path::Path;
use support::Support;
use watermark::{Block, Watermark};

pub use config::{AttackPolicy, EnvelopeDemand, FlightConfig, RigKind};
pub use report::{Check, Failsafe, FlightStatus, Guide, StepReport};
pub use rotors::{
    LIMIT as ROTOR_LIMIT, LOSS as ROTOR_LOSS, RotorWatch, SIGMA as ROTOR_SIGMA, information as rotor_information,
};

/// Why a flight cannot be set up.
#[derive(Debug, thiserror::Error)]
pub enum FlightError {
    /// The tick rate is outside 50 to 1000 Hz.
    #[error("tick rate {0} Hz is outside 50 to 1000 Hz")]
    TickRate(f64),
    /// The estimators do not fit.
    #[error(transparent)]
    Bank(#[from] BankError),
    /// The weights to start with do not give usable gains.
    #[error("starting gains: {0}")]
    Gains(#[from] GainsError),
    /// The rotors cannot give every wrench.
    #[error("airframe {0}: its rotors cannot give thrust and all three torques")]
    Allocation(String),
    /// No altitude is within the limits.
    #[error("limits.altitude_min_m = {least_m} is not below {most_m}: limits.altitude_max_m, or the rig's reach")]
    Altitudes {
        /// Lowest altitude setpoint, m.
        least_m: f64,
        /// Highest, m.
        most_m: f64,
    },
}

/// How far along a flight is.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Phase {
    /// Motors idle (or off while disarmed), waiting for something to do.
    Idle { since: FlightTime },
    /// Under control.
    Flying,
    /// Down after a landing.
    Landed { since: FlightTime },
}

/// What watches, and what it decided.
#[derive(Debug)]
struct Supervision {
    watchdog: Watchdog,
    agreement: Agreement,
    monitor: Monitor,
    failsafe: Failsafe,
    failsafe_reason: Text,
    cut_latched: bool,
    /// Descending on attitude alone since.
    blind_since: Option<FlightTime>,
    /// Hold was left because the horizontal position was lost.
    position_lost: bool,
    /// The controller's last output was no number.
    wrench_invalid: bool,
    /// Bound of the attack envelope, m (`None`: there is none), or why it is not known, of the gains in use.
    envelope: Option<Result<Option<f64>, Text>>,
}

/// Where the vehicle is to go, and how far it came.
#[derive(Debug)]
struct Guidance {
    profile: Profile,
    /// What the operator asks for, within limits.
    target: Setpoint,
    /// An altitude was asked for since the target was taken from where the vehicle is.
    altitude_asked: bool,
    path: Option<Path>,
    /// Thrust and climb have looked like standing since.
    quiet_since: Option<FlightTime>,
    /// As low as where it took off, not turning, rising or sinking, since.
    low_since: Option<FlightTime>,
    /// When it sank last, by accelerometers and raw heights.
    sank: Option<FlightTime>,
    /// Raw height where it took off, m.
    takeoff_height_m: Option<f64>,
    /// Thrust that hovers, learned in flight, N.
    hover_thrust_n: f64,
    meter: StepMeter,
}

/// Signs of life: of the tick, the link, the operator, the battery, the onboard log.
#[derive(Debug, Default)]
struct Liveness {
    ticked: Option<FlightTime>,
    heartbeat: Option<FlightTime>,
    /// Last sign of life of the operator; `None` while none was given since the motors stood.
    operator: Option<FlightTime>,
    /// When the battery was measured last, and its voltage then, V: thrust goes on by it, however old it is.
    battery: Option<(FlightTime, f64)>,
    /// Charge left, 0..1, averaged over the sag of manoeuvres: the last that was known.
    charge: Option<f64>,
    log_error: Option<Text>,
    /// How many devices there are, and what is wrong with the first that gives no readings; `None` where none is there.
    devices: Option<(usize, Option<Text>)>,
    deadline_misses: u64,
}

/// What was told last of what changes often.
#[derive(Debug, Default)]
struct Told {
    /// Of each attack when its schedule was accepted, and its phase.
    attack_phases: ArrayVec<(FlightTime, AttackPhase), MAX_ATTACKS>,
    attack_changes: u64,
    meter_sent: FlightTime,
    setpoint_told: FlightTime,
    battery_silent: bool,
    watermark: Option<(FlightTime, Block)>,
}

/// One vehicle's flight code: the parts of a tick in their order, and the state between ticks; a field for each, hence so many.
#[derive(Debug)]
pub struct Flight {
    config: FlightConfig,
    attacks: Injector,
    bank: Bank,
    support: Support,
    rotors: RotorWatch,
    /// The mixer knows of a weak rotor.
    rotors_made_up: bool,
    gains: Certified,
    controller: InLoop,
    mixer: Mixer,
    mode: Mode,
    phase: Phase,
    supervision: Supervision,
    guidance: Guidance,
    watermark: Option<Box<Watermark>>,
    liveness: Liveness,
    told: Told,
    events: EventQueue,
    report: StepReport,
}

impl Flight {
    /// A disarmed flight with the estimators of its configuration.
    ///
    /// # Errors
    /// [`FlightError`] naming what does not fit.
    pub fn new(config: FlightConfig) -> Result<Self, FlightError> {
        let assumed = config.assumptions();
        let estimators = config.estimators.iter().map(|&kind| build(kind, &assumed)).collect::<Result<_, _>>()?;
        Self::with_estimators(config, estimators)
    }

    /// A disarmed flight with these `estimators` (tests, experiments).
    ///
    /// # Errors
    /// [`FlightError`] naming what does not fit.
    pub fn with_estimators(config: FlightConfig, estimators: Vec<Box<dyn Estimator>>) -> Result<Self, FlightError> {
        if !TICK_RATE_HZ.contains(&config.tick_rate_hz) {
            return Err(FlightError::TickRate(config.tick_rate_hz));
        }
        let (least_m, most_m) = (config.limits.altitude_min_m, config.altitude_max_m());
        if least_m >= most_m {
            return Err(FlightError::Altitudes { least_m, most_m });
        }
        let examiner = Examiner::new(&config.airframe, 1.0 / config.tick_rate_hz, config.margins)?;
        let gains = examiner.certify(&config.design, GainsRevision(0))?;
        let weight_n = config.airframe.weight_n();
        let mixer = Mixer::new(&config.airframe, config.rig.thrust_ceiling_n(weight_n))
            .ok_or_else(|| FlightError::Allocation(config.airframe.name.clone()))?;
        let mut bank = Bank::new(estimators, config.in_loop)?;
        config.decoder.map_or(Ok(()), |decoder| bank.use_decoder(decoder))?;
        let mut spared = config.independent.clone();
        if config.actuation == Actuation::Pose {
            // No command of ours reaches a motor there.
            spared.extend((1_u8..).take(ROTORS).map(|rotor| SensorId::new(SensorKind::Rotor, rotor)));
        }
        Ok(Self {
            attacks: Injector::new(config.attacks.bounds, config.attacks.enabled, &config.sensors).sparing(&spared),
            bank,
            support: Support::default(),
            rotors: RotorWatch::new(&config.airframe),
            rotors_made_up: false,
            controller: InLoop::new(gains.law.clone()),
            gains,
            mixer,
            mode: Mode::Disarmed,
            phase: Phase::Idle { since: FlightTime(0) },
            supervision: Supervision {
                watchdog: Watchdog::new(&config.independent),
                agreement: Agreement::default(),
                monitor: Monitor::new(config.failsafe),
                failsafe: Failsafe::None,
                failsafe_reason: Text::new(),
                cut_latched: false,
                blind_since: None,
                position_lost: false,
                wrench_invalid: false,
                envelope: None,
            },
            guidance: Guidance {
                profile: Profile::default(),
                target: Setpoint::default(),
                altitude_asked: false,
                path: None,
                quiet_since: None,
                low_since: None,
                sank: None,
                takeoff_height_m: None,
                hover_thrust_n: weight_n,
                meter: StepMeter::default(),
            },
            watermark: config.watermark.map(|settings| {
                let airframe = &config.airframe;
                let lag_s = 0.5 * (airframe.motor_rise_time_constant_s + airframe.motor_fall_time_constant_s);
                Box::new(Watermark::new(settings, 1.0 / config.tick_rate_hz, lag_s))
            }),
            liveness: Liveness::default(),
            told: Told::default(),
            events: EventQueue::default(),
            report: StepReport { mode: Mode::Disarmed, ..StepReport::default() },
            config,
        })
    }

    /// One tick. `report.command` goes to `Vehicle::actuate`; what comes back to [`Flight::applied`].
    pub fn step(&mut self, sensed: &SensorFrame) -> &StepReport {
        self.step_received(sensed, sensed)
    }

    /// One tick of a recording whose estimators `received` something else than was `sensed`; attacks of this
    /// flight come on top.
    pub fn step_received(&mut self, sensed: &SensorFrame, received: &SensorFrame) -> &StepReport {
        let dt_s = self.tick(sensed);
        let received = self.attacks.apply(received);
        self.supervision.watchdog.step(&received, dt_s);
        if !self.armed() {
            self.supervision.agreement.step(&received);
        }
        self.bank.step(&received, &self.report.applied, dt_s);
        self.guard(sensed.time);
        let voltage_v = self.liveness.battery.map(|(_, v)| v).filter(|v| *v > 0.0);
        let voltage_ratio = voltage_v.map_or(1.0, |v| v / self.config.airframe.battery.nominal_v());
        let flying = self.phase == Phase::Flying;
        self.support.step(&self.config.airframe, &received, &self.report.applied, voltage_ratio, flying, dt_s);
        self.watch_rotors(voltage_ratio, dt_s);
        let (wrench, mixed) = self.drive(dt_s);
        self.controller.applied(&wrench, &mixed.given, self.support_n());
        self.hear_watermark(&received, &mixed);
        self.write_report(sensed, received, wrench, mixed);
        &self.report
    }

    /// What the vehicle says it applied. Of a motor that an attack told something else, what it was to be told: nobody
    /// downstream may know.
    pub fn applied(&mut self, applied: MotorCommand) {
        self.report.applied = applied;
        let told = self.report.command.throttle.iter().zip(&self.report.commanded.throttle);
        for (applied, (told, commanded)) in self.report.applied.throttle.iter_mut().zip(told) {
            if told != commanded {
                *applied = commanded.clamp(0.0, 1.0);
            }
        }
    }

    /// An authenticated sign of life from the ground.
    pub fn heartbeat(&mut self, now: FlightTime) {
        self.liveness.heartbeat = Some(now);
    }

    /// The operator's page answered the challenge of `at`. Once there is a sign of life, it must go on while armed; what
    /// was seen of a page before arming demands nothing.
    pub fn operator_alive(&mut self, at: FlightTime) {
        if self.armed() {
            self.liveness.operator = self.liveness.operator.max(Some(at));
        }
    }

    /// `count` control ticks were not begun in time, or not at all.
    pub fn ticks_lost(&mut self, now: FlightTime, count: u32) {
        self.liveness.deadline_misses += u64::from(count);
        self.supervision.monitor.ticks_lost(now, count);
    }

    /// Health of the onboard log, a condition for arming; `Some` is what is wrong with it.
    pub fn log_health(&mut self, error: Option<&str>) {
        self.liveness.log_error = error.map(|e| text(format_args!("{e}")));
    }

    /// Devices of a vehicle that is there, a condition for arming: how many, and the first that gives no readings, with why.
    pub fn device_health(&mut self, count: usize, silent: Option<Text>) {
        self.liveness.devices = Some((count, silent));
    }

    /// Hands over every event since the last call, oldest first.
    pub fn drain_events(&mut self, take: impl FnMut(&Event)) {
        self.events.drain(self.report.sensed.time, take);
    }

    /// Lets every estimator's step be timed with `stopwatch`, a count of nanoseconds: the flight code has no
    /// clock of its own, and nothing it does depends on this one.
    pub fn time_steps_with(&mut self, stopwatch: fn() -> u64) {
        self.bank.time_steps_with(stopwatch);
    }

    /// Limits what an estimator may take, µs, where it can give up early; see [`Bank::limit_steps`].
    pub fn limit_steps(&mut self, stopwatch: fn() -> u64, limit_us: Option<u64>) {
        self.bank.limit_steps(stopwatch, limit_us);
    }

    /// The secure estimator, where it runs.
    pub fn secure(&self) -> Option<&Secure> {
        self.bank.secure()
    }

    /// The estimator by lanes, where it runs.
    pub fn lanes(&self) -> Option<&Lanes> {
        self.bank.lanes()
    }

    /// Who judges the sensors, where one of the estimators does.
    pub fn judge(&self) -> Option<Judge<'_>> {
        self.bank.judge()
    }

    /// How long the last step of the estimator of `kind` took, µs; zero when it is not timed.
    pub fn step_time_us(&self, kind: EstimatorKind) -> f64 {
        self.bank.step_time_us(kind)
    }

    /// Every estimator's own estimate.
    pub fn estimates(&self) -> impl Iterator<Item = (EstimatorKind, &Estimate)> {
        self.bank.estimates()
    }

    /// Kind of the estimator in the loop.
    pub fn estimator_in_loop(&self) -> EstimatorKind {
        self.bank.in_loop_kind()
    }

    /// The own estimate of the one in the loop.
    pub fn estimate_in_loop(&self) -> Option<&Estimate> {
        let in_loop = self.estimator_in_loop();
        self.estimates().find_map(|(kind, estimate)| (kind == in_loop).then_some(estimate))
    }

    /// The last tick.
    pub fn report(&self) -> &StepReport {
        &self.report
    }

    /// What an autopilot whose own controller flies is given in this tick; `None` where the estimate in the loop carries no
    /// flight: altitude or horizontal position not known, or not to be trusted.
    pub fn guide(&self) -> Option<Guide<'_>> {
        let estimate = self.bank.in_loop();
        let carries = estimate.health != Health::Initialising
            && estimate.altitude_known()
            && estimate.horizontal_known()
            && self.supervision.blind_since.is_none();
        let flying = self.phase == Phase::Flying;
        carries.then(|| Guide { estimate, setpoint: flying.then_some(&self.report.setpoint) })
    }

    /// Failsafe acting now.
    pub fn failsafe(&self) -> Failsafe {
        self.supervision.failsafe
    }

    /// Revision of the gains in use.
    pub fn gains_revision(&self) -> GainsRevision {
        self.gains.revision
    }

    /// The configuration it was built from.
    pub fn config(&self) -> &FlightConfig {
        &self.config
    }

    /// Progress of the attack schedule.
    pub fn attack_state(&self) -> &[Progress] {
        self.attacks.state()
    }

    /// Who watches the rotors, to read.
    pub fn rotors(&self) -> &RotorWatch {
        &self.rotors
    }

    /// The attack injector, to read.
    pub fn attacks(&self) -> &Injector {
        &self.attacks
    }

    /// Time since the tick before, s; the nominal period at the first tick or after a jump.
    fn tick(&mut self, sensed: &SensorFrame) -> f64 {
        let nominal = 1.0 / self.config.tick_rate_hz;
        let dt_s = self.liveness.ticked.map_or(nominal, |last| sensed.time.seconds_since(last));
        self.liveness.ticked = Some(sensed.time);
        let dt_s = if dt_s > 0.0 && dt_s < 10.0 * nominal { dt_s } else { nominal };
        if let Some(v) = sensed.battery_v.filter(|v| v.is_finite()) {
            self.liveness.battery = Some((sensed.time, v));
        }
        self.mixer.battery(sensed.battery_v, dt_s);
        self.follow_charge(sensed.time, dt_s);
        dt_s
    }

    /// What else holds the vehicle up above its setpoint, N: it does not sink, however little is asked for. To land it
    /// must come to ask for little.
    fn support_n(&self) -> f64 {
        let above = self.motion().position_enu_m.z > self.guidance.profile.setpoint().position_enu_m.z;
        let holding = matches!(self.mode, Mode::AltitudeHold | Mode::Hold);
        if above && holding { self.support.force_n() } else { 0.0 }
    }

    /// Setpoint ─► controller ─► mixer, as the phase allows.
    fn drive(&mut self, dt_s: f64) -> (Wrench, Mixed) {
        let nothing = Mixed::default();
        if !self.armed() {
            self.follow_estimate();
            return (Wrench::default(), nothing);
        }
        if self.phase != Phase::Flying {
            self.follow_estimate();
            return (Wrench::default(), Mixed { command: self.mixer.idle(), ..nothing });
        }
        let setpoint = self.setpoint_now(dt_s);
        let altitude = self.loops().altitude;
        let mut wrench = match self.supervision.blind_since {
            None => self.controller.control(self.bank.in_loop(), &setpoint, self.loops(), dt_s),
            // Attitude from the watchdog; its yaw is zero, so the yaw error is too.
            Some(_) => {
                let estimate = Estimate {
                    world_from_body: self.supervision.watchdog.attitude(),
                    body_rates_radps: self.supervision.watchdog.rates_radps(),
                    ..Estimate::default()
                };
                let level = Setpoint { throttle: self.blind_throttle(), ..Setpoint::default() };
                self.controller.control(&estimate, &level, Loops::default(), dt_s)
            }
        };
        if let Some(watermark) = self.watermark.as_mut().filter(|_| altitude) {
            wrench.thrust_n += self.config.airframe.mass_kg * watermark.draw();
        }
        let mixed = self.mixer.mix(&wrench);
        if mixed.invalid && !self.supervision.wrench_invalid {
            let line = text(format_args!("controller output is not a number: least thrust until it is"));
            self.event(Severity::Critical, EventKind::Failsafe, line);
        }
        self.supervision.wrench_invalid = mixed.invalid;
        self.learn_hover(&mixed, dt_s);
        (wrench, mixed)
    }

    fn write_report(&mut self, sensed: &SensorFrame, received: SensorFrame, wrench: Wrench, mixed: Mixed) {
        let now = sensed.time;
        let setpoint = *self.guidance.profile.setpoint();
        let altitude_m = self.motion().position_enu_m.z;
        let response = if self.phase == Phase::Flying && self.loops().altitude {
            self.guidance.meter.update(now, altitude_m, setpoint.position_enu_m.z)
        } else {
            self.guidance.meter.ended()
        };
        let due = now.seconds_since(self.told.meter_sent) >= 0.1;
        let response = response.filter(|r| due || r.finished);
        if response.is_some() {
            self.told.meter_sent = now;
        }
        let flying = self.phase == Phase::Flying;
        let reached = self.attacks.apply_command(&self.config.airframe, &mixed.command, flying, now);
        self.report = StepReport {
            sensed: *sensed,
            received,
            mode: self.mode,
            armed: self.armed(),
            setpoint,
            wrench,
            given: mixed.given,
            commanded: mixed.command,
            command: reached,
            applied: self.report.applied,
            saturated: mixed.saturated,
            integrator: self.controller.integrator(),
            step_response: response,
        };
    }

    /// Are the motors allowed to turn?
    fn armed(&self) -> bool {
        !matches!(self.mode, Mode::Disarmed | Mode::Cut | Mode::Unspecified)
    }

    /// Which errors the loop closes now.
    fn loops(&self) -> Loops {
        let altitude =
            matches!(self.mode, Mode::AltitudeHold | Mode::Hold | Mode::Land) && self.supervision.blind_since.is_none();
        let horizontal = altitude
            && matches!(self.mode, Mode::Hold | Mode::Land)
            && self.bank.in_loop().horizontal_known()
            && self.config.rig.can_lift();
        Loops { horizontal, altitude }
    }

    /// While nothing is controlled the profile stays where the vehicle is, and integrators at zero.
    fn follow_estimate(&mut self) {
        self.controller.reset();
        self.guidance.profile.restart(self.here());
    }

    /// Motion by the estimator in the loop.
    fn motion(&self) -> Motion {
        self.bank.in_loop().motion_or_rest()
    }

    /// Where the vehicle is, level, as a setpoint.
    fn here(&self) -> Setpoint {
        let yaw = roll_pitch_yaw(&self.bank.in_loop().world_from_body).z;
        Setpoint {
            position_enu_m: self.motion().position_enu_m,
            roll_pitch_yaw_rad: nalgebra::Vector3::new(0.0, 0.0, yaw),
            throttle: self.report.given.thrust_n / self.config.airframe.weight_n(),
            ..Setpoint::default()
        }
    }

    fn event(&mut self, severity: Severity, kind: EventKind, text: Text) {
        self.events.push(Event { time: self.liveness.ticked.unwrap_or_default(), severity, kind, text });
    }
}
