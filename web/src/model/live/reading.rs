//! How messages become state: one batch, one frame, one message at a time.

use std::collections::HashMap;

use plumbline_proto::{
    DecodeError, Kind, codec,
    v1::{self, Reception},
};

use super::Live;
use crate::model::{clock::Clock, curves::Curve, format};

/// So much the voltage of a battery trembles, V.
const VOLTS_BAND: f64 = 0.08;

/// How far reading has come.
#[derive(Debug, Default)]
pub(super) struct Reading {
    /// The boot of what was read, see [`Live::boot`].
    boot: u64,
    /// Newest flight time before the connection that is open now.
    pub(super) connected_from_us: u64,
    /// Newest sequence number on the curves, by kind and instance.
    charted: HashMap<(u16, u16), u64>,
    recorded: bool,
    unreadable: u64,
    unreadable_reason: String,
}

impl Reading {
    /// Of a recorded flight, or of the past of a boot.
    pub(super) fn recorded(boot: u64) -> Self {
        Self { boot, recorded: true, ..Self::default() }
    }

    /// May this frame extend its curve? A repeated one may not: each connection begins with the newest of every topic.
    fn extends_curve(&mut self, frame: &codec::Frame<'_>) -> bool {
        if self.recorded {
            return true;
        }
        let charted = self.charted.entry((frame.kind, frame.instance)).or_insert(0);
        let new = frame.sequence > *charted;
        *charted = frame.sequence.max(*charted);
        new
    }
}

/// What tells one start of a vehicle from another. Agents that send no number of their boot are known by the wall time
/// they began at, which does not change while they run either.
fn boot(description: &v1::Description) -> u64 {
    if description.boot_id == 0 { description.boot_wall_time_us } else { description.boot_id }
}

impl Live {
    /// The start of the vehicle that this is known of; 0 before it has described itself.
    pub fn boot(&self) -> u64 {
        self.reading.boot
    }

    /// Frames this build could not read, and why the last one could not be.
    pub fn unreadable(&self) -> (u64, &str) {
        (self.reading.unreadable, &self.reading.unreadable_reason)
    }

    /// A new connection begins: what was missed since the last one comes apart, see [`Live::fill`].
    pub fn connection_opened(&mut self) {
        self.reading.connected_from_us = self.clock.newest_us();
    }

    /// Reads one batch that arrived at `local_ms` of the browser's monotonic clock.
    ///
    /// # Errors
    /// When it is no batch of this schema; frames before a broken one are kept.
    pub fn ingest(&mut self, batch: &[u8], local_ms: f64) -> Result<(), DecodeError> {
        for frame in codec::decode_batch(batch)? {
            self.frame(&frame?, local_ms);
        }
        if !self.reading.recorded {
            self.clock.arrived(local_ms);
        }
        Ok(())
    }

    /// Reads one message, as [`Live::ingest`] does those of a batch.
    pub fn frame(&mut self, frame: &codec::Frame<'_>, local_ms: f64) {
        // Kinds newer than this build are skipped: the contract says so.
        let Some(kind) = frame.known_kind() else { return };
        let read = if kind.is_ground_made() {
            self.ground_message(kind, frame, local_ms)
        } else {
            self.clock.seen(frame.time_us);
            self.message(kind, frame)
        };
        if let Err(error) = read {
            self.reading.unreadable += 1;
            self.reading.unreadable_reason = error.to_string();
        }
    }

    /// What the ground says.
    fn ground_message(&mut self, kind: Kind, frame: &codec::Frame<'_>, local_ms: f64) -> Result<(), DecodeError> {
        match kind {
            Kind::Link => {
                let link: v1::LinkStatus = frame.message()?;
                if self.is_replay() {
                    // It may stand still, or run faster than time.
                    self.clock.forget_measurements();
                }
                if link.newest_time_us > 0 {
                    self.clock.measure(link.newest_time_us, link.age_ms, local_ms);
                }
                self.ground.link = Some(link);
            }
            Kind::Recording => self.ground.recording = Some(frame.message()?),
            Kind::Lease => self.ground.lease = Some(frame.message()?),
            _ => {}
        }
        Ok(())
    }

    /// What the vehicle says.
    fn message(&mut self, kind: Kind, frame: &codec::Frame<'_>) -> Result<(), DecodeError> {
        match kind {
            Kind::Description => {
                let description: v1::Description = frame.message()?;
                self.booted(boot(&description), frame.time_us);
                self.description.set(description, frame.time_us);
            }
            Kind::Device => self.devices.entry(frame.instance).or_default().set(frame.message()?, frame.time_us),
            Kind::Gains => {
                let gains: v1::GainsInUse = frame.message()?;
                self.log.gains(gains.clone());
                self.gains.set(gains, frame.time_us);
            }
            Kind::Attacks => {
                let state: v1::AttackState = frame.message()?;
                self.log.attacks.update(&state);
                self.attacks.set(state, frame.time_us);
            }
            Kind::Event => self.log.event(frame.message()?),
            Kind::StepResponse => self.log.step(frame.message()?),
            _ => return self.sample(kind, frame),
        }
        Ok(())
    }

    /// A message that is plotted, too.
    fn sample(&mut self, kind: Kind, frame: &codec::Frame<'_>) -> Result<(), DecodeError> {
        let (instance, time_us) = (frame.instance, frame.time_us);
        let new = self.reading.extends_curve(frame);
        match kind {
            Kind::Status => {
                let status: v1::Status = frame.message()?;
                if new {
                    self.curves.push_status(&status);
                    self.log.status(&status);
                }
                self.volts = format::steady(self.volts, status.battery_v, VOLTS_BAND);
                self.status.set(status, time_us);
            }
            Kind::Control => {
                let control: v1::Control = frame.message()?;
                if new {
                    self.curves.push_control(&control);
                }
                self.control.set(control, time_us);
            }
            Kind::Truth => {
                let truth: v1::Truth = frame.message()?;
                if new {
                    self.curves.push_truth(&truth);
                }
                self.truth.set(truth, time_us);
            }
            Kind::Estimate => {
                let estimate: v1::Estimate = frame.message()?;
                if new {
                    self.curves.push_estimate(instance, &estimate);
                }
                self.estimates.entry(instance).or_default().set(estimate, time_us);
            }
            Kind::Residuals => {
                let residuals: v1::Residuals = frame.message()?;
                if new {
                    self.curves.push_residuals(instance, &residuals);
                }
                for residual in residuals.residuals {
                    let key = (instance, residual.sensor, residual.instance, residual.channel);
                    self.residuals.entry(key).or_default().set(residual, time_us);
                }
            }
            Kind::Height => {
                let sample: v1::HeightSample = frame.message()?;
                if let Some(height) = received(&sample).filter(|_| new) {
                    self.curves.push(Curve::Height(instance), sample.time_us, height);
                }
            }
            Kind::Secure => {
                let status: v1::SecureStatus = frame.message()?;
                if new {
                    self.curves.push_secure(&status);
                    let in_loop = self.in_loop();
                    if let Some(bound_m) = self.reach.as_ref().and_then(|reach| reach.bound_now_m(&status, in_loop)) {
                        self.curves.push_reach(in_loop, status.time_us, bound_m);
                    }
                }
                self.secure.set(status, time_us);
            }
            // Answers, marks, and the samples of sensors that no instrument shows.
            _ => {}
        }
        Ok(())
    }

    /// Flight time starts again with each boot: nothing of the boot before can stay on the same axis.
    fn booted(&mut self, boot: u64, time_us: u64) {
        if self.reading.recorded {
            return;
        }
        if self.reading.boot != 0 && boot != self.reading.boot {
            let (ground, log) = (std::mem::take(&mut self.ground), self.log.emptied());
            *self = Self { ground, log, clock: Clock::starting_at(time_us), ..Self::default() };
        }
        self.reading.boot = boot;
    }
}

/// The height that the estimators were given, m: under attack the altered one, and none where it was dropped.
fn received(sample: &v1::HeightSample) -> Option<f64> {
    match sample.reception() {
        Reception::AsSensed => Some(sample.sensed_m),
        Reception::Altered => sample.received_m,
        Reception::Dropped => None,
    }
}
