//! What a tick has to say, encoded once: the only outbound converter.
//!
//! Every message gets a sequence number (from 1 each boot) and is written, as one codec frame, into
//! the ring of the radio and, while a flight is recorded, into the ring of the onboard log: the same
//! bytes. Messages are built in structs that are kept, encoded into buffers that are kept, and
//! written without waiting; a ring that is full refuses the newest message, which is counted.
//!
//! | topic | when |
//! |---|---|
//! | sensors, estimate and residuals in the loop, control | every tick they exist in |
//! | other estimates | 25 Hz; their residuals with them, those of slow sensors at once |
//! | secure | with every window decoded (25 Hz) |
//! | truth | 100 Hz |
//! | step response, events, acknowledgements | as they happen |
//! | status | 10 Hz and on change |
//! | attacks | 1 Hz and on change |
//! | gains | on change, on connect, at the start of a flight, every 10 s |
//! | devices | on connect, at the start of a flight, 1 Hz |
//! | description | on connect, at the start of a flight, every 5 s |

mod convert;
mod devices;
mod kept;
mod outlet;
mod recording;
mod secure;

use arrayvec::ArrayVec;
use plumbline_proto::ids::{CommandId, SensorId};
use plumbline_proto::time::{FlightTime, WallTime};
use plumbline_proto::{Kind, SCHEMA, v1};

use crate::calibration::Calibration;
use crate::estimate::Estimate;
use crate::estimate::secure::suite::{Promise, SuiteError};
use crate::event::{Event, EventKind, Severity, text};
use crate::flight::Flight;
use crate::sensor::suite::Description as SensorDescription;
use crate::sensor::{MAX_SENSORS, PairVisitor, Registered, SensorFrame, Wires};
use crate::sim::rig::{Line, MAX_STRINGS};
use crate::types::{Actuation, EstimatorKind};
use crate::vehicle::{AutopilotState, RecordedControl, Truth};

pub use convert::wire_attack;
use kept::Kept;
pub use outlet::Outlet;
use outlet::Outlets;
pub use recording::Recording;
use secure::Tracking;

/// Residuals of one message: as many as fit into a datagram.
pub const RESIDUALS_PER_MESSAGE: usize = 20;

const OTHER_ESTIMATES_S: f64 = 0.04;
const TRUTH_S: f64 = 0.01;
const STATUS_S: f64 = 0.1;
const ATTACKS_S: f64 = 1.0;
const GAINS_S: f64 = 10.0;
const DESCRIPTION_S: f64 = 5.0;

/// What does not change while the agent runs.
#[derive(Debug, Clone)]
pub struct Identification {
    /// Name of this agent.
    pub agent_id: String,
    /// Changes with every start.
    pub boot_id: u64,
    /// Wall time at flight time zero.
    pub boot_wall_time: WallTime,
    /// sim, replay, hardware, mavlink, px4 or ardupilot.
    pub vehicle: &'static str,
    /// Name of the rig.
    pub rig: String,
    /// The scenario file, TOML; empty when there is none.
    pub scenario: String,
    /// Seed of the scenario.
    pub seed: u64,
    /// File that is replayed; empty otherwise.
    pub source_file: String,
    /// The sensors.
    pub sensors: ArrayVec<SensorDescription, MAX_SENSORS>,
    /// The strings of the rig.
    pub strings: ArrayVec<Line, MAX_STRINGS>,
    /// What the suite promises at hover, or why it promises nothing; `None` where it is not known.
    pub promise: Option<Result<Promise, SuiteError>>,
}

/// How the ticks keep their time, over the last second.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct TickStats {
    /// Ticks a second.
    pub rate_hz: f64,
    /// Work in a tick, median, µs.
    pub work_p50_us: f64,
    /// Work in a tick, 99th percentile, µs.
    pub work_p99_us: f64,
    /// |start − due|, 99th percentile, µs.
    pub jitter_p99_us: f64,
}

/// What the runner adds to a status.
#[derive(Debug, Clone, Copy, Default)]
pub struct Around<'a> {
    /// Timing of the ticks.
    pub ticks: TickStats,
    /// Messages the radio gave up, beyond those its ring refused.
    pub radio_dropped: u64,
    /// What is wrong with the onboard log.
    pub log_error: Option<&'a str>,
    /// Sessions of the link so far; a new one is told everything.
    pub connections: u64,
    /// What the operator's page has to answer.
    pub challenge: u64,
    /// A recording is flown: nothing can be armed.
    pub replay: Option<Replay>,
    /// What the autopilot does that flies the vehicle by itself: nothing can be armed here either.
    pub piloted: Option<RecordedControl>,
    /// What the audit of the flying decoder said last.
    pub audit: Option<Audit>,
    /// The autopilot in front of the motors.
    pub autopilot: Option<AutopilotState>,
}

/// How a recording is flown.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Replay {
    /// Times real time, 0 while standing.
    pub speed: f64,
    /// How much of it is flown, 0 to 1.
    pub progress: f64,
    /// What the recorded flight did in this tick.
    pub recorded: RecordedControl,
}

impl Around<'_> {
    /// What flies, where this flight code only watches.
    fn watched(&self) -> Option<&RecordedControl> {
        self.replay.as_ref().map(|replay| &replay.recorded).or(self.piloted.as_ref())
    }
}

/// A decoded window, solved again by Clarabel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Audit {
    /// Time of the window.
    pub time: FlightTime,
    /// |flying − Clarabel| / Clarabel, of the objective.
    pub difference: f64,
}

/// Turns ticks into messages.
#[derive(Debug)]
pub struct Telemetry {
    outlets: Outlets,
    recording: Recording,
    kept: Kept,
    description: v1::Description,
    due: Due,
    connections: u64,
    attack_changes: u64,
    gains_revision: Option<u32>,
    status_key: Option<StatusKey>,
    tracking: Tracking,
    windows: u64,
}

/// When each slow topic was sent last.
#[derive(Debug, Default)]
struct Due {
    others: Option<FlightTime>,
    truth: Option<FlightTime>,
    status: Option<FlightTime>,
    attacks: Option<FlightTime>,
    gains: Option<FlightTime>,
    description: Option<FlightTime>,
    devices: Option<FlightTime>,
}

/// A change of any of these is worth a status at once.
type StatusKey = (v1::Mode, bool, v1::Failsafe, bool, EstimatorKind, bool);

fn due(last: &mut Option<FlightTime>, now: FlightTime, period_s: f64) -> bool {
    // Half a millisecond of slack, so that a period of whole ticks is not missed by rounding.
    let due = last.is_none_or(|last| now.seconds_since(last) >= period_s - 5e-4 || now < last);
    if due {
        *last = Some(now);
    }
    due
}

impl Telemetry {
    /// Telemetry into these outlets.
    pub fn new(identification: Identification, flight: &Flight, link: Option<Outlet>, log: Option<Outlet>) -> Self {
        let recording = Recording::new(&identification);
        Self {
            outlets: Outlets::new(link, log),
            recording,
            kept: Kept::with_room(),
            description: describe(&identification, flight),
            due: Due::default(),
            connections: 0,
            attack_changes: 0,
            gains_revision: None,
            status_key: None,
            tracking: Tracking::default(),
            windows: 0,
        }
    }

    /// What corrects the samples has changed: told with the next tick. Disarmed only, as it allocates.
    pub fn calibrations(&mut self, calibration: &Calibration) {
        self.description.calibrations = calibration.used().iter().map(convert::calibration_in_use).collect();
        self.due.description = None;
    }

    /// Everything about one tick.
    pub fn tick(&mut self, flight: &mut Flight, truth: Option<&Truth>, around: &Around<'_>) {
        let now = flight.report().sensed.time;
        if self.connections != around.connections {
            self.connections = around.connections;
            self.tell_everything_again();
        }
        let armed = flight.report().armed;
        if let Some(reason) = self.recording.wants_to_begin(armed) {
            self.begin_flight(now, reason);
        }

        self.sensors(&flight.report().sensed, &flight.report().received);
        self.estimates(flight, now);
        self.secure(flight, now, around);
        self.control(flight, around);
        if let Some(truth) = truth
            && due(&mut self.due.truth, now, TRUTH_S)
        {
            convert::truth(&mut self.kept.truth, truth);
            self.outlets.send(Kind::Truth, 0, now, &self.kept.truth);
        }
        let step_response = around.watched().map_or(&flight.report().step_response, |then| &then.step_response);
        if let Some(response) = step_response {
            self.outlets.send(Kind::StepResponse, 0, now, &convert::step_response(now, response));
        }
        self.slow(flight, now, around);
        let Self { outlets, kept, .. } = self;
        flight.drain_events(|event| {
            convert::event(&mut kept.event, event);
            outlets.send(Kind::Event, 0, event.time, &kept.event);
        });
        if let Some(reason) = self.recording.wants_to_end(armed, now) {
            self.end_flight(now, reason);
        }
    }

    /// The answer to a command.
    pub fn ack(&mut self, now: FlightTime, id: CommandId, accepted: bool, reason: &str) {
        let ack = &mut self.kept.ack;
        ack.time_us = now.0;
        ack.command_id = id.0;
        let stage = if accepted { v1::AckStage::Accepted } else { v1::AckStage::Rejected };
        ack.set_stage(stage);
        convert::set(&mut ack.reason, reason);
        self.outlets.send(Kind::Ack, 0, now, ack);
    }

    /// Something the runner has to say.
    pub fn event(&mut self, now: FlightTime, severity: Severity, kind: EventKind, what: std::fmt::Arguments<'_>) {
        convert::event(&mut self.kept.event, &Event { time: now, severity, kind, text: text(what) });
        self.outlets.send(Kind::Event, 0, now, &self.kept.event);
    }

    /// A status outside of any tick, while time stands still.
    pub fn status_now(&mut self, flight: &Flight, around: &Around<'_>) {
        if self.connections != around.connections {
            self.connections = around.connections;
            self.tell_everything_again();
        }
        let now = flight.report().sensed.time;
        self.due.status = None;
        self.slow(flight, now, around);
    }

    /// Starts or stops a recording by hand; answers with what was done.
    pub fn record(&mut self, now: FlightTime, on: bool, armed: bool) -> (bool, &'static str) {
        match (on, self.recording.is_open()) {
            (true, true) => (true, "already recording"),
            (true, false) => {
                self.recording.by_hand(true);
                self.begin_flight(now, "operator");
                (true, "recording")
            }
            (false, false) => (true, "not recording"),
            (false, true) if armed => (false, "armed flights are always recorded; disarm first"),
            (false, true) => {
                self.recording.by_hand(false);
                self.end_flight(now, "operator");
                (true, "recording stopped")
            }
        }
    }

    /// Closes an open flight: the agent ends.
    pub fn shutdown(&mut self, now: FlightTime) {
        if self.recording.is_open() {
            self.end_flight(now, "shutdown");
        }
    }

    /// Last sequence number given.
    pub fn sequence(&self) -> u64 {
        self.outlets.sequence()
    }

    /// The flight being recorded.
    pub fn recording(&self) -> &Recording {
        &self.recording
    }

    /// Bytes that the ring of the log still takes; `None` where nothing is being logged.
    pub fn log_room(&self) -> Option<usize> {
        self.outlets.log_room()
    }

    /// Messages refused by the rings: of the radio, of the log.
    pub fn refused(&self) -> (u64, u64) {
        self.outlets.refused()
    }

    fn tell_everything_again(&mut self) {
        self.due = Due::default();
        self.gains_revision = None;
    }

    fn begin_flight(&mut self, now: FlightTime, reason: &str) {
        let mark = self.recording.begin(now, self.outlets.sequence() + 1, reason);
        self.outlets.recording = true;
        self.outlets.send(Kind::Flight, 0, now, mark);
        // The file explains itself from its first messages on.
        self.tell_everything_again();
    }

    fn end_flight(&mut self, now: FlightTime, reason: &str) {
        let mark = self.recording.end(now, self.outlets.sequence() + 1, reason);
        self.outlets.send(Kind::Flight, 0, now, mark);
        self.outlets.recording = false;
        self.due.status = None;
    }

    fn sensors(&mut self, sensed: &SensorFrame, received: &SensorFrame) {
        struct Send<'a>(&'a mut Outlets, &'a mut Wires);
        impl PairVisitor for Send<'_> {
            fn pair<S: Registered>(&mut self, sensor: SensorId, sensed: &S, received: Option<&S>) {
                let message = S::wire(self.1);
                sensed.to_wire(received, message);
                self.0.send(S::TOPIC, u16::from(sensor.instance), sensed.time(), message);
            }
        }
        sensed.visit_beside(received, &mut Send(&mut self.outlets, &mut self.kept.samples));
    }

    fn estimates(&mut self, flight: &Flight, now: FlightTime) {
        let others = due(&mut self.due.others, now, OTHER_ESTIMATES_S);
        let in_loop = flight.estimator_in_loop();
        for (kind, estimate) in flight.estimates() {
            let instance = kind as u16;
            if kind == in_loop || others {
                self.outlets.send(
                    Kind::Estimate,
                    instance,
                    now,
                    &convert::estimate(now, kind, estimate, kind == in_loop, flight.step_time_us(kind)),
                );
            }
            self.residuals(kind, estimate, now, kind == in_loop || others);
        }
    }

    /// `all`: those of the inertial sensors too, which come with every tick.
    fn residuals(&mut self, kind: EstimatorKind, estimate: &Estimate, now: FlightTime, all: bool) {
        let message = &mut self.kept.residuals;
        message.time_us = now.0;
        message.set_estimator(kind);
        message.residuals.clear();
        let wanted = |residual: &&crate::estimate::Residual| all || residual.sensor.kind != v1::SensorKind::Imu;
        for residual in estimate.residuals.iter().filter(wanted) {
            message.residuals.push(convert::residual(residual));
            if message.residuals.len() == RESIDUALS_PER_MESSAGE {
                self.outlets.send(Kind::Residuals, kind as u16, now, message);
                message.residuals.clear();
            }
        }
        if !message.residuals.is_empty() {
            self.outlets.send(Kind::Residuals, kind as u16, now, message);
        }
    }

    /// With every window decoded.
    fn secure(&mut self, flight: &Flight, now: FlightTime, around: &Around<'_>) {
        let Some(judge) = flight.judge() else { return };
        self.tracking.tick(flight, judge, around.watched());
        if self.windows != judge.window().count {
            self.windows = judge.window().count;
            secure::fill(&mut self.kept.secure, now, judge, &self.tracking, around.audit);
            self.outlets.send(Kind::Secure, 0, now, &self.kept.secure);
        }
    }

    fn control(&mut self, flight: &Flight, around: &Around<'_>) {
        let report = flight.report();
        convert::control(&mut self.kept.control, report, around.watched());
        match (&around.autopilot, &mut self.kept.control.autopilot) {
            (Some(state), Some(into)) => convert::autopilot(into, state),
            // There is one from the first tick on, or never.
            (_, into) => *into = None,
        }
        self.outlets.send(Kind::Control, 0, report.sensed.time, &self.kept.control);
    }

    fn slow(&mut self, flight: &Flight, now: FlightTime, around: &Around<'_>) {
        if due(&mut self.due.description, now, DESCRIPTION_S) {
            self.description.time_us = now.0;
            self.outlets.send(Kind::Description, 0, now, &self.description);
        }
        let revision = flight.gains_revision().0;
        if self.gains_revision != Some(revision) || due(&mut self.due.gains, now, GAINS_S) {
            self.gains_revision = Some(revision);
            self.due.gains = Some(now);
            flight.gains_in_use().to_wire(now, &mut self.kept.gains);
            self.outlets.send(Kind::Gains, 0, now, &self.kept.gains);
        }
        let attacks = flight.attacks();
        if self.attack_changes != attacks.changes() || due(&mut self.due.attacks, now, ATTACKS_S) {
            self.attack_changes = attacks.changes();
            self.due.attacks = Some(now);
            convert::attacks(&mut self.kept.attacks, now, attacks);
            self.outlets.send(Kind::Attacks, 0, now, &self.kept.attacks);
        }
        let report = flight.report();
        let (mode, armed) = around.watched().map_or((report.mode, report.armed), |then| (then.mode, then.armed));
        let key = (
            mode,
            armed,
            flight.failsafe(),
            self.recording.is_open(),
            flight.estimator_in_loop(),
            around.log_error.is_some(),
        );
        if self.status_key != Some(key) || due(&mut self.due.status, now, STATUS_S) {
            self.status_key = Some(key);
            self.due.status = Some(now);
            self.status(flight, now, around);
        }
    }

    fn status(&mut self, flight: &Flight, now: FlightTime, around: &Around<'_>) {
        let (link_refused, log_refused) = self.outlets.refused();
        let status = &mut self.kept.status;
        convert::flight_status(status, &flight.status());
        convert::rotors(status, flight.rotors());
        if let Some(replay) = &around.replay {
            convert::replay_status(status, replay);
        }
        if let Some(control) = &around.piloted {
            let reason = "an autopilot of its own flies the vehicle: arm it there";
            convert::watched_status(status, control, "autopilot", reason);
        }
        status.time_us = now.0;
        convert::set(&mut status.flight_id, self.recording.flight_id());
        status.flight_start_us = self.recording.start().map_or(0, |start| start.0);
        status.log_healthy = around.log_error.is_none() && log_refused == 0;
        convert::set(&mut status.log_error, around.log_error.unwrap_or_default());
        if log_refused > 0 && around.log_error.is_none() {
            use std::fmt::Write;
            let _ = write!(status.log_error, "{log_refused} messages lost: the disk is too slow");
        }
        status.tick_rate_hz = around.ticks.rate_hz;
        status.tick_time_p50_us = around.ticks.work_p50_us;
        status.tick_time_p99_us = around.ticks.work_p99_us;
        status.tick_jitter_p99_us = around.ticks.jitter_p99_us;
        status.telemetry_dropped = link_refused + around.radio_dropped;
        status.challenge = around.challenge;
        self.outlets.send(Kind::Status, 0, now, status);
    }
}

fn describe(identification: &Identification, flight: &Flight) -> v1::Description {
    let config = flight.config();
    v1::Description {
        time_us: 0,
        agent_id: identification.agent_id.clone(),
        agent_version: env!("CARGO_PKG_VERSION").to_owned(),
        schema: u32::from(SCHEMA),
        vehicle: identification.vehicle.to_owned(),
        airframe: config.airframe.name.clone(),
        mass_kg: config.airframe.mass_kg,
        rig: identification.rig.clone(),
        scenario: identification.scenario.clone(),
        seed: identification.seed,
        tick_rate_hz: config.tick_rate_hz,
        sensors: identification
            .sensors
            .iter()
            .map(|sensor| convert::sensor_description(sensor, &config.attacks.bounds))
            .collect(),
        estimators: config.estimators.iter().map(|kind| *kind as i32).collect(),
        limits: Some(convert::limits(config)),
        attacks_enabled: config.attacks.enabled,
        boot_wall_time_us: identification.boot_wall_time.0,
        source_file: identification.source_file.clone(),
        rotors: config.airframe.rotors.iter().map(convert::rotor_description).collect(),
        strings: identification.strings.iter().map(convert::string_description).collect(),
        observability: identification.promise.as_ref().map(convert::observability),
        boot_id: identification.boot_id,
        calibrations: Vec::new(),
        declination_rad: Some(config.sensor_model.imus.mag.declination_rad),
        actuation: config.actuation.name().to_owned(),
        actuators: (1_u8..)
            .take(if config.actuation == Actuation::Pose { 0 } else { config.airframe.rotors.len() })
            .map(|i| convert::actuator_description(i, config))
            .collect(),
    }
}

#[cfg(test)]
mod tests;
