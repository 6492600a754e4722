//! The flight thread: keeps the pace, passes commands between ticks, hands every tick on.
//!
//! ```text
//! wait for the frame's time ─► commands, certified gains ─► Flight::step ─► Vehicle::actuate ─► telemetry
//! ```
//! Time comes from [`SensorFrame::time`](crate::vehicle::SensorFrame) and nowhere else; the clock of
//! the machine only decides when the next frame is asked for. Nothing in the loop waits for a lock
//! that a slow thread could hold, for a disk or for the radio.

pub mod auditor;
pub mod certifier;
pub mod challenge;
mod motor_watch;
pub mod pace;
pub mod stop;
mod timing;

use std::sync::atomic::Ordering;
use std::sync::{Arc, LazyLock};
use std::time::{Duration, Instant};

use plumbline_proto::time::FlightTime;
use rtrb::Consumer;

use crate::attack::Schedule;
use crate::command::Command;
use crate::control::gains::refusal;
use crate::estimate::secure::DEADLINE_US;
use crate::event::{EventKind, Severity, Text, text};
use crate::flight::Flight;
use crate::link::LinkState;
use crate::link::clock::FlightClock;
use crate::link::inbound::{Inbound, ReplayRate, Request};
use crate::log::LogState;
use crate::sensor::MAX_IMUS;
use crate::sim::script::Script;
use crate::telemetry::{Around, Telemetry};
use crate::vehicle::{MOTOR_TIMEOUT_S, RecordedControl, Service, Vehicle, VehicleError};

use auditor::Auditor;
use certifier::{Answer, Certifier};
use challenge::Challenges;
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
/// Priority of the flight thread, where it is granted.
const PRIORITY: i32 = 50;

/// How the runner behaves.
#[derive(Debug, Clone)]
pub struct RunnerOptions {
    /// How fast time runs.
    pub pace: Pace,
    /// The vehicle can be paused, stepped and sped up.
    pub replay: bool,
    /// Ends here, if anywhere.
    pub end: Option<FlightTime>,
    /// Commands given by themselves.
    pub script: Option<Script>,
    /// Run on the first tick on which somebody is there (a ground, or the program itself).
    pub attacks: Option<Schedule>,
    /// The program stands in for the ground: scripted flights, replays without a ground. Such a replay is
    /// recorded from its first tick, as it would have no other effect.
    pub own_operator: bool,
    /// Stay when the recording has ended, for somebody to look at.
    pub stay: bool,
    /// Ask for real-time priority.
    pub real_time: bool,
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
    vehicle: Box<dyn Vehicle>,
    flight: Flight,
    telemetry: Telemetry,
    options: RunnerOptions,
    ports: RunnerPorts,
    certifier: Option<Certifier>,
    auditor: Option<Auditor>,
    motor_watch: Option<MotorWatch>,
    pacer: Pacer,
    timing: Timing,
    heartbeats: u64,
    challenges: Challenges,
    answered: u64,
    log_changes: u64,
    log_error: Option<String>,
    /// Calibrated magnetometers that stopped fitting, as last told.
    unfit: [bool; MAX_IMUS],
    scripted: Option<FlightTime>,
    ended: bool,
    /// How often the end was asked for, as obeyed, and since when.
    ending: (u8, FlightTime),
    ticks: u64,
    deadline_misses: u64,
}

impl Runner {
    /// Ready to fly.
    pub fn new(
        vehicle: Box<dyn Vehicle>,
        mut flight: Flight,
        telemetry: Telemetry,
        options: RunnerOptions,
        ports: RunnerPorts,
    ) -> Self {
        let tick_rate_hz = flight.config().tick_rate_hz;
        time_steps(&mut flight, options.pace);
        // Before real-time priority is asked for: the thread would inherit it.
        let certifier = Certifier::start(&flight.config().airframe, 1.0 / tick_rate_hz, flight.config().margins)
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
        let mut pacer = Pacer::new(options.pace);
        if let Some(zero) = ports.zero {
            pacer.begin_at(zero, &ports.clock);
        }
        Self {
            auditor,
            motor_watch,
            certifier,
            pacer,
            timing: Timing::new(tick_rate_hz),
            vehicle,
            flight,
            telemetry,
            options,
            ports,
            heartbeats: 0,
            challenges: Challenges::default(),
            answered: 0,
            // Differs from every state, so that the first tick looks.
            log_changes: u64::MAX,
            log_error: None,
            unfit: [false; MAX_IMUS],
            scripted: None,
            ended: false,
            ending: (0, FlightTime(0)),
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
            pace::ask_for_real_time(PRIORITY);
        }
        let begun = Instant::now();
        let outcome = self.fly(stop);
        let outcome = outcome.and_then(|()| self.disarm());
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
            if self.ended || self.pacer.stands_still() {
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
                    self.ended = true;
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
        if !self.flight.report().armed || self.ended || self.pacer.stands_still() {
            return true;
        }
        let (obeyed, since) = self.ending;
        let too_long = obeyed == 1 && self.now().seconds_since(since) > LANDING_MAX_S;
        let due = if too_long { 2 } else { asked.min(2) };
        if due > obeyed {
            self.flight.shutdown(due > 1, "the program was asked to end");
            self.ending = (due, self.now());
        }
        false
    }

    /// Waits for the tick of `time`. After a silence longer than the motors' time-out the flight is told, and the vehicle
    /// passes over what went by.
    fn wait_for(&mut self, time: FlightTime) -> (Option<Instant>, Instant) {
        let due = self.pacer.wait_for(time, &self.ports.clock);
        let started = Instant::now();
        let mut silent_s = due.map_or(0.0, |due| started.saturating_duration_since(due).as_secs_f64());
        if let Some(watch) = &self.motor_watch {
            if watch.stopped() {
                silent_s = silent_s.max(2.0 * MOTOR_TIMEOUT_S);
            }
            watch.mark(self.flight.report().armed);
        }
        if silent_s > MOTOR_TIMEOUT_S && self.pacer.is_real_time() {
            self.flight.stalled(silent_s);
            let passed = Duration::from_secs_f64(self.vehicle.pass_over(silent_s));
            self.pacer.begin_anew(started, time + passed, &self.ports.clock);
        }
        (due, started)
    }

    fn tick(&mut self) -> Result<(), VehicleError> {
        let frame = self.vehicle.sense()?;
        self.magnetometers(frame.time);
        let (due, started) = self.wait_for(frame.time);
        self.ports.clock.tick(frame.time);
        self.commands(frame.time);
        self.certified(frame.time);
        self.heartbeat(frame.time);
        self.script(frame.time);
        self.log_health();

        let received = self.vehicle.recorded_reception();
        let command = self.flight.step_received(&frame, received.as_ref().unwrap_or(&frame)).command;
        let applied = self.vehicle.actuate(&command)?;
        self.flight.applied(applied);
        if self.ticks == 0 && self.options.replay && self.options.own_operator {
            self.telemetry.record(frame.time, true, false);
        }
        self.wait_for_log();
        let truth = self.vehicle.truth();
        let audit = match (&mut self.auditor, self.flight.secure()) {
            (Some(auditor), Some(secure)) => auditor.tick(frame.time, secure),
            _ => None,
        };
        let around = Around {
            challenge: self.challenges.current(frame.time),
            audit,
            ..around(&self.timing, &self.ports, self.log_error.as_deref(), self.replay_state())
        };
        self.telemetry.tick(&mut self.flight, truth.as_ref(), &around);

        self.ticks += 1;
        let lost = self.timing.tick(due, started, Instant::now());
        if lost > 0 && self.pacer.is_real_time() {
            self.deadline_misses += u64::from(lost);
            self.flight.ticks_lost(frame.time, lost);
        }
        Ok(())
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
        while stop.asked() == 0 && (self.ended || self.pacer.stands_still()) {
            self.commands(self.now());
            self.certified(self.now());
            self.log_health();
            if told.elapsed() >= STANDSTILL_STATUS {
                told = Instant::now();
                let around = around(&self.timing, &self.ports, self.log_error.as_deref(), self.replay_state());
                self.telemetry.status_now(&self.flight, &around);
            }
            std::thread::sleep(STANDSTILL);
        }
    }

    fn commands(&mut self, now: FlightTime) {
        for _ in 0..COMMANDS_PER_TICK {
            let Some(inbound) = self.ports.inbound.as_mut().and_then(|queue| queue.pop().ok()) else { return };
            match inbound.request {
                Request::Flight(command) if self.options.replay && controls(&command) => {
                    let reason = "a recording is flown: its motors and setpoints are those of then";
                    self.telemetry.ack(now, inbound.id, false, reason);
                }
                Request::Flight(command) => {
                    let ack = self.flight.apply(&command, now);
                    self.telemetry.ack(now, inbound.id, ack.accepted, &ack.reason);
                }
                Request::Gains { revision, proposal } => {
                    // Answered when they are in use, or refused.
                    let asked = match &mut self.certifier {
                        Some(certifier) => certifier.ask(inbound.id, revision, &proposal),
                        None => Err("gains cannot be certified: no thread for it"),
                    };
                    if let Err(reason) = asked {
                        self.telemetry.ack(now, inbound.id, false, reason);
                    }
                }
                Request::Recording(on) => {
                    let armed = self.flight.report().armed;
                    let (accepted, reason) = self.telemetry.record(now, on, armed);
                    self.telemetry.ack(now, inbound.id, accepted, reason);
                }
                Request::Replay(rate) => {
                    let (accepted, reason) = self.replay(rate);
                    self.telemetry.ack(now, inbound.id, accepted, reason);
                }
                Request::Simulator(service) => {
                    let (accepted, reason) = self.serve(service, now);
                    self.telemetry.ack(now, inbound.id, accepted, &reason);
                }
                Request::Refused(reason) => self.telemetry.ack(now, inbound.id, false, &reason),
            }
        }
    }

    /// Gains that have been examined since the last tick.
    fn certified(&mut self, now: FlightTime) {
        while let Some(Answer { id, revision, outcome }) = self.certifier.as_mut().and_then(Certifier::answer) {
            let (accepted, reason) = match outcome {
                Ok(gains) => {
                    let ack = self.flight.apply(&Command::UseGains(gains), now);
                    (ack.accepted, ack.reason)
                }
                Err(error) => {
                    let reason = refusal(revision, &error);
                    self.telemetry.event(now, Severity::Warning, EventKind::Gains, format_args!("{reason}"));
                    (false, reason)
                }
            };
            self.telemetry.ack(now, id, accepted, &reason);
        }
    }

    /// What only a simulated vehicle can be given.
    fn serve(&mut self, service: Service, now: FlightTime) -> (bool, Text) {
        let armed = self.flight.report().armed;
        if service.reset && armed {
            return (false, text(format_args!("armed: land or cut first")));
        }
        if !self.vehicle.serve(service) {
            return (false, text(format_args!("only a simulated vehicle can be given this")));
        }
        if !service.reset {
            return (true, text(format_args!("a full battery")));
        }
        let ack = self.flight.apply(&Command::BeginAnew, now);
        time_steps(&mut self.flight, self.options.pace);
        (ack.accepted, ack.reason)
    }

    fn replay(&mut self, rate: ReplayRate) -> (bool, &'static str) {
        if !self.options.replay {
            return (false, "only a recording can be paused, stepped or sped up");
        }
        if self.ended {
            return (false, "the recording has ended");
        }
        self.pacer.set(if rate.speed > 0.0 { Pace::Times(rate.speed) } else { Pace::Stepped });
        self.pacer.allow(rate.step);
        (true, if rate.speed > 0.0 { "playing" } else { "standing" })
    }

    fn replay_state(&self) -> Option<ReplayState> {
        self.options.replay.then(|| ReplayState {
            speed: if self.ended { 0.0 } else { self.pacer.speed() },
            progress: self.vehicle.progress().unwrap_or(0.0),
            recorded: self.vehicle.recorded_control(),
        })
    }

    fn script(&mut self, now: FlightTime) {
        let Some(script) = &self.options.script else { return };
        let flight = &mut self.flight;
        let telemetry = &mut self.telemetry;
        script.commands(self.scripted, now, |command| {
            let ack = flight.apply(command, now);
            // A trajectory gives a setpoint every tick; only refusals are worth a line.
            if !ack.accepted {
                telemetry.event(now, Severity::Warning, EventKind::Warning, format_args!("script: {}", ack.reason));
            }
        });
        self.scripted = Some(now);
    }

    fn heartbeat(&mut self, now: FlightTime) {
        let answered = self.ports.link.as_ref().map_or(0, |link| link.answered.load(Ordering::Acquire));
        if answered != self.answered {
            self.answered = answered;
            if let Some(at) = self.challenges.answered(answered) {
                self.flight.operator_alive(at);
            }
        }
        let heartbeats = self.ports.link.as_ref().map_or(0, |link| link.heartbeats.load(Ordering::Acquire));
        if heartbeats == self.heartbeats && !self.options.own_operator {
            return;
        }
        self.heartbeats = heartbeats;
        self.flight.heartbeat(now);
        // Attacks end on link loss, so they begin with the link.
        if let Some(schedule) = self.options.attacks.take() {
            let ack = self.flight.apply(&Command::Attack(schedule), now);
            let severity = if ack.accepted { Severity::Info } else { Severity::Warning };
            self.telemetry.event(now, severity, EventKind::Attack, format_args!("attack schedule: {}", ack.reason));
        }
    }

    fn log_health(&mut self) {
        if let Some(log) = &self.ports.log
            && log.changes() != self.log_changes
        {
            self.log_changes = log.changes();
            self.log_error = log.error();
            self.flight.log_health(self.log_error.as_deref());
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

/// Would the command move something? A recording's motors cannot be.
fn controls(command: &Command) -> bool {
    !matches!(
        command,
        Command::Attack(_) | Command::AbortAttacks | Command::SelectEstimator(_) | Command::SelectDecoder(_)
    )
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

/// Where a replay stands.
#[derive(Debug, Clone, Copy)]
struct ReplayState {
    speed: f64,
    progress: f64,
    recorded: Option<RecordedControl>,
}

fn around<'a>(
    timing: &Timing,
    ports: &RunnerPorts,
    log_error: Option<&'a str>,
    replay: Option<ReplayState>,
) -> Around<'a> {
    let link = ports.link.as_deref();
    Around {
        ticks: timing.stats(),
        radio_dropped: link.map_or(0, |link| link.dropped.load(Ordering::Relaxed)),
        log_error,
        connections: link.map_or(0, |link| link.connections.load(Ordering::Acquire)),
        challenge: 0,
        replay_speed: replay.map_or(0.0, |replay| replay.speed),
        replay_progress: replay.map_or(0.0, |replay| replay.progress),
        replay: replay.is_some(),
        recorded: replay.and_then(|replay| replay.recorded),
        audit: None,
    }
}
