//! Between two ticks: commands, certified gains, heartbeats and the script reach the flight.

use std::sync::atomic::Ordering;

use plumbline_proto::time::FlightTime;

use super::certifier::{Answer, Certifier};
use super::keeper::Keeper;
use super::pace::Pace;
use super::{COMMANDS_PER_TICK, Runner, time_steps};
use crate::command::Command;
use crate::control::gains::refusal;
use crate::event::{EventKind, Severity, Text, text};
use crate::link::inbound::{Calibrating, ReplayRate, Request};
use crate::sensor::MAX_IMUS;
use crate::vehicle::Service;

impl Runner {
    pub(super) fn commands(&mut self, now: FlightTime) {
        for _ in 0..COMMANDS_PER_TICK {
            let Some(inbound) = self.ports.inbound.as_mut().and_then(|queue| queue.pop().ok()) else { return };
            match inbound.request {
                Request::Flight(command) => {
                    let (accepted, reason) = self.obey(&command, now);
                    self.telemetry.ack(now, inbound.id, accepted, &reason);
                }
                Request::Gains { revision, proposal } => {
                    // Answered when they are in use, or refused.
                    let asked = match &mut self.beside.certifier {
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
                Request::Calibration(asked) => {
                    let (accepted, reason) = self.calibrate(asked, now);
                    self.telemetry.ack(now, inbound.id, accepted, &reason);
                }
                Request::Refused(reason) => self.telemetry.ack(now, inbound.id, false, &reason),
            }
        }
    }

    /// Applies a command, unless it would move, or attack, what is only watched here.
    fn obey(&mut self, command: &Command, now: FlightTime) -> (bool, Text) {
        if let Some(reason) = self.in_vain(command) {
            return (false, reason);
        }
        let ack = self.flight.apply(command, now);
        (ack.accepted, ack.reason)
    }

    /// Why a command would have no effect on a vehicle that somebody else flies.
    fn in_vain(&mut self, command: &Command) -> Option<Text> {
        let vehicle = self.vehicle.inner_mut();
        if vehicle.recorded().is_some() && controls(command) {
            return Some(text(format_args!("a recording is flown: its motors and setpoints are those of then")));
        }
        let piloted = vehicle.piloted()?;
        if controls(command) {
            return Some(text(format_args!("an autopilot of its own flies the vehicle: command it there")));
        }
        let Command::Attack(schedule) = command else { return None };
        let attack = schedule.attacks.iter().find(|attack| !piloted.reaches(attack.sensor))?;
        Some(text(format_args!("attack {}: {} has no way to the autopilot", attack.id, attack.sensor)))
    }

    /// Gains that have been examined since the last tick.
    pub(super) fn certified(&mut self, now: FlightTime) {
        while let Some(Answer { id, revision, outcome }) = self.beside.certifier.as_mut().and_then(Certifier::answer) {
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
        while let Some((revision, bound_m)) = self.beside.certifier.as_mut().and_then(Certifier::bounded) {
            self.flight.envelope_bounded(revision, bound_m);
        }
    }

    /// What only a simulated vehicle can be given.
    fn serve(&mut self, service: Service, now: FlightTime) -> (bool, Text) {
        let armed = self.flight.report().armed;
        if service.reset && armed {
            return (false, text(format_args!("armed: land or cut first")));
        }
        let Some(simulated) = self.vehicle.inner_mut().simulated() else {
            return (false, text(format_args!("only a simulated vehicle can be given this")));
        };
        simulated.serve(service);
        if !service.reset {
            return (true, text(format_args!("a full battery")));
        }
        let ack = self.flight.apply(&Command::BeginAnew, now);
        time_steps(&mut self.flight, self.options.pace);
        (ack.accepted, ack.reason)
    }

    /// Another correction of the samples: what the estimators learnt of the old ones is of no use.
    fn calibrate(&mut self, asked: Calibrating, now: FlightTime) -> (bool, Text) {
        if self.flight.report().armed {
            return (false, text(format_args!("armed: land and disarm first")));
        }
        if self.vehicle.inner().recorded().is_some() {
            return (false, text(format_args!("a recording is flown: its samples are those of then")));
        }
        let (kind, imu, done) = match &asked {
            Calibrating::Use { correction, .. } => {
                let (kind, imu) = correction.of_what();
                (kind, imu, self.vehicle.put(correction).map(|()| "is in use"))
            }
            Calibrating::Drop { kind, imu } => {
                (*kind, *imu, self.vehicle.take(*kind, *imu).map(|()| "is no longer used"))
            }
        };
        let done = match done {
            Ok(done) => done,
            Err(reason) => return (false, text(format_args!("{reason}"))),
        };
        self.unfit = [false; MAX_IMUS];
        let ack = self.flight.apply(&Command::Recalibrated, now);
        if !ack.accepted {
            let what = format_args!("estimators go on with what they learnt of other samples: {}", ack.reason);
            self.telemetry.event(now, Severity::Warning, EventKind::Estimator, what);
        }
        time_steps(&mut self.flight, self.options.pace);
        self.telemetry.calibrations(self.vehicle.calibration());
        let kept = match &mut self.beside.keeper {
            Some(keeper) => keeper.keep(kind, imu, asked).map(|()| ""),
            None => Ok(" until the agent stops"),
        };
        let kind = kind.name();
        let (severity, said) = match kept {
            Ok(until) => (Severity::Info, text(format_args!("IMU {imu}: {kind} calibration {done}{until}"))),
            Err(why) => {
                (Severity::Warning, text(format_args!("IMU {imu}: {kind} calibration {done}, but not kept: {why}")))
            }
        };
        self.telemetry.event(now, severity, EventKind::Estimator, format_args!("{said}"));
        (true, said)
    }

    /// What became of calibrations that were to be kept.
    pub(super) fn kept(&mut self, now: FlightTime) {
        while let Some(problem) = self.beside.keeper.as_mut().and_then(Keeper::problem) {
            self.telemetry.event(now, Severity::Warning, EventKind::Estimator, format_args!("{problem}"));
        }
    }

    fn replay(&mut self, rate: ReplayRate) -> (bool, &'static str) {
        if self.vehicle.inner().recorded().is_none() {
            return (false, "only a recording can be paused, stepped or sped up");
        }
        if self.ending.recording_over {
            return (false, "the recording has ended");
        }
        self.pacer.set(if rate.speed > 0.0 { Pace::Times(rate.speed) } else { Pace::Stepped });
        self.pacer.allow(rate.step);
        (true, if rate.speed > 0.0 { "playing" } else { "standing" })
    }

    pub(super) fn script(&mut self, now: FlightTime) {
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

    pub(super) fn heartbeat(&mut self, now: FlightTime) {
        let answered = self.ports.link.as_ref().map_or(0, |link| link.answered.load(Ordering::Acquire));
        if answered != self.heard.answered {
            self.heard.answered = answered;
            if let Some(at) = self.heard.challenges.answered(answered) {
                self.flight.operator_alive(at);
            }
        }
        let heartbeats = self.ports.link.as_ref().map_or(0, |link| link.heartbeats.load(Ordering::Acquire));
        if heartbeats == self.heard.heartbeats && !self.options.own_operator {
            return;
        }
        self.heard.heartbeats = heartbeats;
        self.flight.heartbeat(now);
        // Attacks end on link loss, so they begin with the link.
        if let Some(schedule) = self.options.attacks.take() {
            let (accepted, reason) = self.obey(&Command::Attack(schedule), now);
            let severity = if accepted { Severity::Info } else { Severity::Warning };
            self.telemetry.event(now, severity, EventKind::Attack, format_args!("attack schedule: {reason}"));
        }
    }
}

/// Would the command move something? A recording's motors cannot be.
fn controls(command: &Command) -> bool {
    !matches!(
        command,
        Command::Attack(_) | Command::AbortAttacks | Command::SelectEstimator(_) | Command::SelectDecoder(_)
    )
}
