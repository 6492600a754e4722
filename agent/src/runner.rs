//! The flight thread: keeps the pace, passes commands between ticks, hands every tick on.
//!
//! ```text
//! wait for the frame's time ─► commands, certified gains ─► Flight::step ─► Vehicle::actuate ─► telemetry
//! ```
//! Time comes from [`SensorFrame::time`](crate::vehicle::SensorFrame) and nowhere else; the clock of
//! the machine only decides when the next frame is asked for. Nothing in the loop waits for a lock
//! that a slow thread could hold, for a disk or for the radio.

pub mod auditor;
pub mod bounding;
pub mod certifier;
pub mod challenge;
pub mod keeper;
mod motor_watch;
pub mod pace;
pub mod stop;
mod timing;
mod uplane;
mod worker;

use std::path::PathBuf;
use std::sync::atomic::Ordering;
use std::sync::{Arc, LazyLock};
use std::time::{Duration, Instant};

use plumbline_devices::scheduling;
use plumbline_proto::time::FlightTime;
use rtrb::Consumer;

use crate::attack::Schedule;
use crate::command::Command;
use crate::estimate::secure::DEADLINE_US;
use crate::event::{EventKind, Severity, text};
use crate::flight::Flight;
use crate::link::LinkState;
use crate::link::clock::FlightClock;
use crate::link::inbound::Inbound;
use crate::log::LogState;
use crate::sensor::MAX_IMUS;
use crate::sim::script::Script;
use crate::telemetry::{Around, Replay, Telemetry};
use crate::vehicle::calibrated::CalibratedVehicle;
use crate::vehicle::{Awaited, MOTOR_TIMEOUT_S, RecordedControl, Vehicle, VehicleError};

use auditor::Auditor;
use bounding::Bounding;
use certifier::Certifier;
use challenge::Challenges;
use keeper::Keeper;
use motor_watch::MotorWatch;
use pace::{Pace, Pacer};
use stop::Stop;
use timing::Timing;

/// Most commands obeyed between two ticks.
pub const COMMANDS_PER_TICK: usize = 16;
/// How often commands are looked for while time stands still.
const STANDSTILL: Duration = Duration::from_millis(5);
/// How often a status is sent while time stands still.
const STANDSTILL_STATUS: Duration = Duration::from_millis(100);
/// At full speed the flight waits for the log while its ring takes less than this: what no clock drives
/// need not lose messages to a slow disk.
const LOG_ROOM_BYTES: usize = 256 << 10;
/// Longest wait for the log in one tick; a disk that is slower than this has failed.
const LOG_WAIT: Duration = Duration::from_secs(2);
/// Longest time given to stop the motors when the program ends.
const DISARM_WAIT: Duration = Duration::from_secs(1);
/// A landing that was asked for by a signal ends with a cut after this much flight time, s.
const LANDING_MAX_S: f64 = 60.0;
/// How often devices are looked at.
const DEVICES_S: f64 = 0.2;

/// How the runner behaves.
#[derive(Debug, Clone)]
pub struct RunnerOptions {
    /// How fast time runs.
    pub pace: Pace,
    /// Ends here, if anywhere.
    pub end: Option<FlightTime>,
    /// Commands given by themselves.
    pub script: Option<Script>,
    /// Run on the first tick on which somebody is there (a ground, or the program itself).
    pub attacks: Option<Schedule>,
    /// The program stands in for the ground: scripted flights, replays without a ground. Such a replay is
    /// recorded from its first tick, as it would have no other effect; so is what an autopilot of its own flies.
    pub own_operator: bool,
    /// Stay when the recording has ended, for somebody to look at.
    pub stay: bool,
    /// Ask for real-time priority.
    pub real_time: bool,
    /// How the attack envelope is bounded, where that is demanded.
    pub bounding: Option<Bounding>,
    /// Where calibrations that a command puts to use are kept for the next start; nowhere for a vehicle that is not really there.
    pub calibrations: Option<PathBuf>,
}

/// Where the runner meets the link and the log.
#[derive(Debug, Default)]
pub struct RunnerPorts {
    /// Commands.
    pub inbound: Option<Consumer<Inbound>>,
    /// State of the link.
    pub link: Option<Arc<LinkState>>,
    /// State of the log.
    pub log: Option<Arc<LogState>>,
    /// Flight time for others.
    pub clock: Arc<FlightClock>,
    /// When flight time is zero; `None`: the first tick is on time.
    pub zero: Option<Instant>,
}

/// How it went.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Summary {
    /// Ticks flown.
    pub ticks: u64,
    /// Time of the last one.
    pub time: FlightTime,
    /// Messages made.
    pub messages: u64,
    /// Deadlines missed.
    pub deadline_misses: u64,
    /// Wall time it took, s.
    pub wall_s: f64,
}

/// One flight thread.
pub struct Runner {
    vehicle: CalibratedVehicle,
    flight: Flight,
    telemetry: Telemetry,
    options: RunnerOptions,
    ports: RunnerPorts,
    beside: Beside,
    pacer: Pacer,
    timing: Timing,
    heard: Heard,
    log_health: LogHealth,
    /// Calibrated magnetometers that stopped fitting, as last told.
    unfit: [bool; MAX_IMUS],
    scripted: Option<FlightTime>,
    /// When devices were last looked at.
    devices: Option<FlightTime>,
    ending: Ending,
    ticks: u64,
    deadline_misses: u64,
}

/// The threads beside the flight thread.
struct Beside {
    certifier: Option<Certifier>,
    auditor: Option<Auditor>,
    motor_watch: Option<MotorWatch>,
    keeper: Option<Keeper>,
}

impl Beside {
    /// Starts those that this flight needs; one that cannot be had is logged, and done without.
    fn start(flight: &Flight, vehicle: &dyn Vehicle, options: &RunnerOptions) -> Self {
        let config = flight.config();
        let bounding = options.bounding.clone().map(|bounding| (bounding, flight.gains_in_use().clone()));
        let certifier = Certifier::start(&config.airframe, 1.0 / config.tick_rate_hz, config.margins, bounding)
            .inspect_err(|error| tracing::error!(%error, "new gains cannot be certified"))
            .ok();
        let auditor = flight.secure().and_then(|_| {
            Auditor::start().inspect_err(|error| tracing::error!(%error, "the decoder is not audited")).ok()
        });
        let motors = if options.pace == Pace::Times(1.0) { vehicle.motor_stop() } else { None };
        let motor_watch = motors.and_then(|motors| {
            MotorWatch::start(motors, Duration::from_secs_f64(MOTOR_TIMEOUT_S), options.real_time)
                .inspect_err(|error| tracing::error!(%error, "nothing watches over the flight thread"))
                .ok()
        });
        let keeper = options.calibrations.clone().and_then(|folder| {
            Keeper::start(folder).inspect_err(|error| tracing::error!(%error, "calibrations cannot be kept")).ok()
        });
        Self { certifier, auditor, motor_watch, keeper }
    }
}

/// What has been heard of the ground and of its operator.
#[derive(Debug, Default)]
struct Heard {
    heartbeats: u64,
    challenges: Challenges,
    /// The last challenge answered.
    answered: u64,
}

/// The onboard log, as last looked at.
#[derive(Debug)]
struct LogHealth {
    changes: u64,
    error: Option<String>,
}

/// How far the end has come.
#[derive(Debug, Default)]
struct Ending {
    /// The recording has no more ticks.
    recording_over: bool,
    /// How often the program was asked to end, as obeyed.
    obeyed: u8,
    /// Flight time of the last time.
    since: FlightTime,
}

impl Runner {
    /// Ready to fly.
    pub fn new(
        vehicle: impl Into<CalibratedVehicle>,
        mut flight: Flight,
        mut telemetry: Telemetry,
        options: RunnerOptions,
        ports: RunnerPorts,
    ) -> Self {
        let vehicle = vehicle.into();
        time_steps(&mut flight, options.pace);
        let mut pacer = Pacer::new(options.pace);
        telemetry.calibrations(vehicle.calibration());
        if let Some(zero) = ports.zero {
            pacer.begin_at(zero, &ports.clock);
        }
        Self {
            // Before real-time priority is asked for: the threads would inherit it.
            beside: Beside::start(&flight, vehicle.inner(), &options),
            pacer,
            timing: Timing::new(flight.config().tick_rate_hz),
            vehicle,
            flight,
            telemetry,
            options,
            ports,
            heard: Heard::default(),
            // Differs from every state, so that the first tick looks.
            log_health: LogHealth { changes: u64::MAX, error: None },
            unfit: [false; MAX_IMUS],
            scripted: None,
            devices: None,
            ending: Ending::default(),
            ticks: 0,
            deadline_misses: 0,
        }
    }

    /// Flies until the end, the end of the recording, or `stop`, which lands first and cuts when asked twice; disarms and
    /// closes the flight.
    ///
    /// # Errors
    /// [`VehicleError`] when the vehicle fails; the flight is closed all the same.
    pub fn run(&mut self, stop: &Stop) -> Result<Summary, VehicleError> {
        if self.options.real_time {
            scheduling::ask_for_real_time(scheduling::FLIGHT);
        }
        let begun = Instant::now();
        let outcome = self.fly(stop);
        let outcome = outcome.and_then(|()| self.disarm());
        if let Err(error) = &outcome {
            let what = format_args!("the vehicle can be flown no longer: {error}");
            self.telemetry.event(self.now(), Severity::Critical, EventKind::Failsafe, what);
        }
        self.telemetry.shutdown(self.now());
        self.ports.clock.stop();
        outcome.map(|()| Summary {
            ticks: self.ticks,
            time: self.now(),
            messages: self.telemetry.sequence(),
            deadline_misses: self.deadline_misses,
            wall_s: begun.elapsed().as_secs_f64(),
        })
    }

    /// The flight, to look at.
    pub fn flight(&self) -> &Flight {
        &self.flight
    }

    fn now(&self) -> FlightTime {
        self.flight.report().sensed.time
    }

    fn fly(&mut self, stop: &Stop) -> Result<(), VehicleError> {
        while !self.may_end(stop.asked()) {
            if self.ending.recording_over || self.pacer.stands_still() {
                self.stand_still(stop);
                continue;
            }
            match self.tick() {
                Ok(()) => {}
                Err(VehicleError::Finished(time)) => {
                    self.telemetry.event(
                        self.now(),
                        Severity::Info,
                        EventKind::Recording,
                        format_args!("the recording ends at {time}"),
                    );
                    if !self.options.stay {
                        return Ok(());
                    }
                    self.ending.recording_over = true;
                }
                Err(error) => return Err(error),
            }
            if self.options.end.is_some_and(|end| self.now() >= end) {
                return Ok(());
            }
        }
        Ok(())
    }

    /// Asked to end: lands what flies, cuts when asked again or when that takes too long. True once nothing is armed, or
    /// time stands still.
    fn may_end(&mut self, asked: u8) -> bool {
        if asked == 0 {
            return false;
        }
        if !self.flight.report().armed || self.ending.recording_over || self.pacer.stands_still() {
            return true;
        }
        let too_long = self.ending.obeyed == 1 && self.now().seconds_since(self.ending.since) > LANDING_MAX_S;
        let due = if too_long { 2 } else { asked.min(2) };
        if due > self.ending.obeyed {
            self.flight.shutdown(due > 1, "the program was asked to end");
            self.ending.obeyed = due;
            self.ending.since = self.now();
        }
        false
    }

    /// Waits for the tick of `time`. After a silence longer than the motors' time-out the flight is told, and the vehicle
    /// passes over what went by.
    fn wait_for(&mut self, time: FlightTime) -> (Option<Instant>, Instant) {
        let due = self.pacer.wait_for(time, &self.ports.clock);
        let started = Instant::now();
        let late_s = due.map_or(0.0, |due| started.saturating_duration_since(due).as_secs_f64());
        // What the watch has stopped counts as silent for long enough; flight time goes on by what really went by.
        let mut silent_s = late_s;
        if let Some(watch) = &self.beside.motor_watch {
            if watch.stopped() {
                silent_s = silent_s.max(2.0 * MOTOR_TIMEOUT_S);
            }
            watch.mark(self.flight.report().armed);
        }
        if silent_s > MOTOR_TIMEOUT_S && self.pacer.is_real_time() {
            self.flight.stalled(silent_s);
            let passed = Duration::from_secs_f64(self.vehicle.inner_mut().pass_over(late_s));
            // Ticks stay on their grid, as samples are asked for by it; what passes over less begins here.
            let tick = Duration::from_secs_f64(1.0 / self.flight.config().tick_rate_hz);
            let on_grid = due.map(|due| due + passed).filter(|at| started.saturating_duration_since(*at) < tick);
            self.pacer.begin_anew(on_grid.unwrap_or(started), time + passed, &self.ports.clock);
        }
        (due, started)
    }

    fn tick(&mut self) -> Result<(), VehicleError> {
        let awaited = self.vehicle.inner_mut().awaited().map(|Awaited { time, set_back_ns }| {
            self.pacer.set_back(set_back_ns, &self.ports.clock);
            self.wait_for(time)
        });
        let frame = self.vehicle.sense()?;
        self.magnetometers(frame.time);
        let (due, started) = match awaited {
            Some(waited) => waited,
            None => self.wait_for(frame.time),
        };
        while let Some((severity, said)) = self.vehicle.inner_mut().notice() {
            self.telemetry.event(frame.time, severity, EventKind::Warning, format_args!("{said}"));
        }
        self.ports.clock.tick(frame.time);
        self.commands(frame.time);
        self.certified(frame.time);
        self.kept(frame.time);
        self.heartbeat(frame.time);
        self.script(frame.time);
        self.log_health();
        self.device_health(frame.time);

        let received = self.vehicle.reception().unwrap_or(&frame);
        let command = self.flight.step_received(&frame, received).command;
        self.vehicle.inner_mut().guide(self.flight.guide().as_ref());
        if let Some(piloted) = self.vehicle.inner_mut().piloted() {
            piloted.receive(&self.flight.report().received);
        }
        let applied = self.vehicle.inner_mut().actuate(&command)?;
        self.flight.applied(applied);
        let piloted = self.piloted(frame.time);
        let replayed = self.vehicle.inner().recorded().is_some() && self.options.own_operator;
        if self.ticks == 0 && (replayed || piloted.is_some()) {
            self.telemetry.record(frame.time, true, false);
        }
        self.wait_for_log();
        let truth = self.vehicle.inner().truth();
        let audit = match (&mut self.beside.auditor, self.flight.secure()) {
            (Some(auditor), Some(secure)) => auditor.tick(frame.time, secure),
            _ => None,
        };
        let around = Around {
            challenge: self.heard.challenges.current(frame.time),
            audit,
            autopilot: self.vehicle.inner().autopilot(),
            piloted,
            ..around(&self.timing, &self.ports, self.log_health.error.as_deref(), self.replay_state())
        };
        self.telemetry.tick(&mut self.flight, truth.as_ref(), &around);
        self.telemetry.devices(frame.time, self.vehicle.inner_mut());
        self.telemetry.scans(self.vehicle.inner_mut());

        self.ticks += 1;
        let lost = self.timing.tick(due, started, Instant::now());
        if lost > 0 && self.pacer.is_real_time() {
            self.deadline_misses += u64::from(lost);
            self.flight.ticks_lost(frame.time, lost);
        }
        Ok(())
    }

    /// What the autopilot does that flies the vehicle by itself. Estimators begin anew with one that was started anew.
    fn piloted(&mut self, now: FlightTime) -> Option<RecordedControl> {
        let piloted = self.vehicle.inner_mut().piloted()?;
        let (control, anew) = (piloted.control(), piloted.began_anew());
        if anew {
            self.flight.apply(&Command::BeginAnew, now);
            time_steps(&mut self.flight, self.options.pace);
        }
        Some(control)
    }

    /// A device that gives nothing, or is another one, keeps the vehicle from arming.
    fn device_health(&mut self, now: FlightTime) {
        if self.devices.is_some_and(|last| now.seconds_since(last) < DEVICES_S) {
            return;
        }
        self.devices = Some(now);
        let (mut count, mut silent) = (0, None);
        while let Some(state) = self.vehicle.inner_mut().device(count) {
            if !state.up && silent.is_none() {
                let reason = if state.reason.is_empty() { "no reading yet" } else { state.reason.as_str() };
                silent = Some(text(format_args!("{}: {reason}", state.name)));
            }
            count += 1;
        }
        if count > 0 {
            self.flight.device_health(count, silent);
        }
    }

    /// Tells when a magnetometer's calibration stops fitting, and when it does again.
    fn magnetometers(&mut self, now: FlightTime) {
        for field in self.vehicle.fields() {
            let Some(unfit) = field.imu.checked_sub(1).and_then(|index| self.unfit.get_mut(index)) else { continue };
            if *unfit != field.fits {
                continue;
            }
            *unfit = !field.fits;
            let number = field.imu;
            let (severity, said) = if field.fits {
                let more_ut = field.hard_iron_since_ut.norm();
                let said = text(format_args!("fits again, with {more_ut:.1} µT of hard iron more; calibrate it anew"));
                (Severity::Info, said)
            } else {
                let said = text(format_args!("no longer fits its calibration and is withheld: a magnet came near it"));
                (Severity::Warning, said)
            };
            self.telemetry.event(now, severity, EventKind::Estimator, format_args!("magnetometer {number} {said}"));
        }
    }

    /// Only as fast as possible is fast enough to overrun the log.
    fn wait_for_log(&self) {
        if !self.pacer.is_free() {
            return;
        }
        let begun = Instant::now();
        while self.telemetry.log_room().is_some_and(|room| room < LOG_ROOM_BYTES) && begun.elapsed() < LOG_WAIT {
            std::thread::sleep(Duration::from_millis(1));
        }
    }

    /// Commands, but no time.
    fn stand_still(&mut self, stop: &Stop) {
        let mut told = Instant::now();
        while stop.asked() == 0 && (self.ending.recording_over || self.pacer.stands_still()) {
            self.commands(self.now());
            self.certified(self.now());
            self.log_health();
            if told.elapsed() >= STANDSTILL_STATUS {
                told = Instant::now();
                let around = around(&self.timing, &self.ports, self.log_health.error.as_deref(), self.replay_state());
                self.telemetry.status_now(&self.flight, &around);
            }
            std::thread::sleep(STANDSTILL);
        }
    }

    fn replay_state(&self) -> Option<Replay> {
        let recording = self.vehicle.inner().recorded()?;
        Some(Replay {
            speed: if self.ending.recording_over { 0.0 } else { self.pacer.speed() },
            progress: recording.progress(),
            recorded: recording.control(),
        })
    }

    fn log_health(&mut self) {
        if let Some(log) = &self.ports.log
            && log.changes() != self.log_health.changes
        {
            self.log_health.changes = log.changes();
            self.log_health.error = log.error();
            self.flight.log_health(self.log_health.error.as_deref());
        }
    }

    /// Stops the motors of a vehicle that is still armed, whatever it takes.
    fn disarm(&mut self) -> Result<(), VehicleError> {
        if !self.flight.report().armed {
            return Ok(());
        }
        let now = self.now();
        if !self.flight.apply(&Command::Disarm, now).accepted {
            // In the air. The program ends: there is nobody left to fly it.
            self.flight.shutdown(true, "the program ends in flight");
        }
        let begun = Instant::now();
        while self.flight.report().armed && begun.elapsed() < DISARM_WAIT {
            match self.tick() {
                Ok(()) => {}
                Err(VehicleError::Finished(_)) => return Ok(()),
                Err(error) => return Err(error),
            }
        }
        Ok(())
    }
}

/// Gives the estimators a clock for their own cost.
fn time_steps(flight: &mut Flight, pace: Pace) {
    flight.time_steps_with(stopwatch);
    // Only real time has deadlines: everything else must repeat bit by bit.
    if pace == Pace::Times(1.0) {
        flight.limit_steps(stopwatch, Some(DEADLINE_US));
    }
}

/// Nanoseconds since the first call.
fn stopwatch() -> u64 {
    static START: LazyLock<Instant> = LazyLock::new(Instant::now);
    START.elapsed().as_nanos() as u64
}

fn around<'a>(timing: &Timing, ports: &RunnerPorts, log_error: Option<&'a str>, replay: Option<Replay>) -> Around<'a> {
    let link = ports.link.as_deref();
    Around {
        ticks: timing.stats(),
        radio_dropped: link.map_or(0, |link| link.dropped.load(Ordering::Relaxed)),
        log_error,
        connections: link.map_or(0, |link| link.connections.load(Ordering::Acquire)),
        challenge: 0,
        replay,
        piloted: None,
        audit: None,
        autopilot: None,
    }
}
