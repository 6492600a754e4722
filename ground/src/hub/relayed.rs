//! What grounds pass on of their vehicles, as their hubs give and take it.

use std::time::{Duration, Instant};

use plumbline_proto::codec::{Batch, Frame};
use plumbline_proto::{Kind, Message as _, v1};
use plumbline_rest::ground::AtGround;
use serde::{Deserialize, Serialize};

use super::vehicle::Vehicle;
use super::{Hub, Shared};
use crate::agent_link::CommandSender;
use crate::sync::lock;

/// What another ground has to know of a vehicle that is linked to this one.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct Linked {
    pub(crate) id: String,
    pub(crate) boot_id: u64,
    pub(crate) boot_wall_time_us: u64,
    pub(crate) version: String,
    pub(crate) round_trip_ms: f64,
    pub(crate) clock_offset_us: f64,
    /// Since anything came from it.
    pub(crate) silent_ms: u64,
}

impl Hub {
    /// The vehicles that are linked to this ground.
    pub(crate) fn linked_here(&self) -> Vec<Linked> {
        let vehicles = lock(&self.vehicles);
        let here = vehicles.iter().filter(|(_, vehicle)| vehicle.ground.is_none() && vehicle.linked());
        let linked = |(id, vehicle): (&String, &Vehicle)| Linked {
            id: id.clone(),
            boot_id: vehicle.boot_id,
            boot_wall_time_us: vehicle.boot_wall_time_us,
            version: vehicle.version.clone(),
            round_trip_ms: vehicle.health.round_trip_ms,
            clock_offset_us: vehicle.health.clock_offset_us,
            silent_ms: u64::try_from(vehicle.heard.elapsed().as_millis()).unwrap_or(u64::MAX),
        };
        here.map(linked).collect()
    }

    /// The latest of every topic.
    pub(crate) fn latest_of_all(&self, id: &str) -> Option<Shared> {
        Some(lock(&self.vehicles).get(id)?.snapshot(None))
    }

    /// `ground` has this vehicle; `commands` leads there. Answers `false`, and changes nothing, where its link ends here.
    pub(crate) fn linked_at(&self, ground: &AtGround, told: &Linked, commands: Option<CommandSender>) -> bool {
        if lock(&self.vehicles).get(&told.id).is_some_and(|vehicle| vehicle.ground.is_none() && vehicle.linked()) {
            return false;
        }
        self.linked(&told.id, told.boot_id, |vehicle| {
            vehicle.boot_wall_time_us = told.boot_wall_time_us;
            vehicle.version.clone_from(&told.version);
            vehicle.health.round_trip_ms = told.round_trip_ms;
            vehicle.health.clock_offset_us = told.clock_offset_us;
            vehicle.ground = Some(ground.clone());
            if commands.is_some() {
                vehicle.commands = commands;
            }
            vehicle.heard = Instant::now().checked_sub(Duration::from_millis(told.silent_ms)).unwrap_or(vehicle.heard);
        });
        true
    }

    /// Takes what `ground` passes on of a vehicle; `kept` is what that ground remembers, of which only topics count that are new here.
    pub(crate) fn passed_on(&self, ground: &str, id: &str, batch: &Batch, kept: bool) {
        let now = Instant::now();
        let mut vehicles = lock(&self.vehicles);
        let Some(vehicle) = vehicles.get_mut(id) else { return };
        if vehicle.ground.as_ref().is_none_or(|own| own.name != ground) {
            return;
        }
        vehicle.heard = now;
        vehicle.health.roll(now);
        for frame in batch.frames() {
            if kept && vehicle.knows(&frame) {
                continue;
            }
            match frame.known_kind() {
                // Each ground measures the way to itself.
                Some(Kind::Link) => {}
                Some(Kind::Lease) => {
                    let Ok(lease) = frame.message::<v1::ControlLease>() else { continue };
                    let payload = named(lease, ground).encode_to_vec();
                    vehicle.take(&Frame { payload: &payload, ..frame }, now);
                }
                Some(kind) if kind.is_ground_made() => vehicle.take(&frame, now),
                _ => {
                    if !kept {
                        vehicle.health.observe(&frame);
                    }
                    vehicle.take(&frame, now);
                }
            }
        }
    }
}

/// Whoever holds control holds it there: a person of the same name here does not.
fn named(mut lease: v1::ControlLease, ground: &str) -> v1::ControlLease {
    for who in [&mut lease.holder, &mut lease.taken_from] {
        if !who.is_empty() {
            *who = format!("{who} at {ground}");
        }
    }
    lease
}
