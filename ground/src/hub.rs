//! The only fan-out: what one vehicle sends reaches every viewer from here, and nowhere else.
//!
//! For each vehicle the hub keeps the latest message of every topic, a bounded history, and one
//! bounded queue per viewer. Live frames are gathered for at most [`FLUSH_EVERY`] and then shared,
//! reference-counted, with all viewers as one codec batch: twenty viewers cost twenty queue entries,
//! not twenty copies. Nothing here waits for a viewer, a disk or an agent.

mod health;
mod history;
#[cfg(feature = "many")]
mod relayed;
mod thinned;
mod vehicle;
mod viewer;

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use plumbline_proto::codec::{Batch, Frame};
use plumbline_proto::{Kind, Message, v1};
use plumbline_rest::ground::AtGround;

use crate::agent_link::CommandSender;
use crate::agent_link::clock::wall_us;
use crate::sync::{lock, wall_time_us};
pub use history::{MAX_BYTES as MAX_HISTORY_BYTES, MAX_SECONDS as MAX_HISTORY_SECONDS};
#[cfg(feature = "many")]
pub(crate) use relayed::Linked;
pub use vehicle::SILENT_AFTER;
use vehicle::Vehicle;
pub use viewer::{MAX_QUEUED_BYTES, Shared, ViewerQueue};

/// How long live frames are gathered into one WebSocket message. Per-message cost dominates the
/// browser's decoding, and 10 ms is a third of the delay the page may have in total.
pub const FLUSH_EVERY: Duration = Duration::from_millis(10);
/// A vehicle that is not connected and unseen for this long is forgotten.
pub const FORGOTTEN_AFTER: Duration = Duration::from_secs(24 * 3600);
/// Most vehicles; the one unseen for longest gives way to a new one.
pub const MAX_VEHICLES: usize = 64;
/// Most bytes of history, all vehicles together.
const ALL_HISTORIES: usize = 256 << 20;

/// The latest messages, histories and viewers of all vehicles.
#[derive(Debug, Default)]
pub struct Hub {
    vehicles: Mutex<BTreeMap<String, Vehicle>>,
    /// Messages that viewers were too slow for, since the start.
    dropped: Arc<AtomicU64>,
}

/// What a list of vehicles shows.
#[derive(Debug, Clone)]
pub struct VehicleInfo {
    /// Agent id.
    pub id: String,
    /// Is the link up?
    pub connected: bool,
    /// Boot of the agent.
    pub boot_id: u64,
    /// Version of the agent.
    pub version: String,
    /// Latest description.
    pub description: Option<v1::Description>,
    /// Latest status.
    pub status: Option<v1::Status>,
    /// The ground that its link ends at; `None` where that is this one.
    pub ground: Option<AtGround>,
}

/// Why a vehicle cannot be commanded.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum VehicleError {
    /// No agent of this name was ever seen.
    #[error("vehicle {0:?} is not known")]
    Unknown(String),
    /// The link is down.
    #[error("vehicle {0:?} is not connected")]
    Disconnected(String),
    /// Its link ends at another ground.
    #[error("vehicle {vehicle:?} is flown from ground {:?} {}: here it is looked at, and its motors can be cut", .ground.name, .ground.address)]
    Elsewhere {
        /// The vehicle.
        vehicle: String,
        /// Where it is flown from.
        ground: AtGround,
    },
}

/// One viewer: what it is sent at once, then its queue.
#[derive(Debug)]
pub struct Viewer {
    /// Latest messages, then history: to be sent before anything of `queue`.
    pub backlog: Vec<Shared>,
    /// Live batches.
    pub queue: Arc<ViewerQueue>,
}

impl Hub {
    /// An agent said hello. A new boot forgets the old one: its times and sequence numbers start again.
    pub fn connected(&self, id: &str, boot_id: u64, boot_wall_time_us: u64, version: &str, commands: CommandSender) {
        self.linked(id, boot_id, |vehicle| {
            vehicle.boot_wall_time_us = boot_wall_time_us;
            version.clone_into(&mut vehicle.version);
            vehicle.ground = None;
            vehicle.commands = Some(commands);
        });
    }

    /// Makes room for a vehicle and begins its boot, where it is new; then `link` says how it is reached.
    fn linked(&self, id: &str, boot_id: u64, link: impl FnOnce(&mut Vehicle)) {
        let now = Instant::now();
        let mut vehicles = lock(&self.vehicles);
        if !vehicles.contains_key(id) {
            let silent = vehicles.iter().filter(|(_, vehicle)| !vehicle.linked()).min_by_key(|(_, v)| v.heard);
            if let Some(oldest) = silent.map(|(id, _)| id.clone()).filter(|_| vehicles.len() >= MAX_VEHICLES) {
                vehicles.remove(&oldest);
            }
            vehicles.insert(id.to_owned(), Vehicle::new(boot_id, now));
            share(&mut vehicles, now);
        }
        let Some(vehicle) = vehicles.get_mut(id) else { return };
        if vehicle.boot_id != boot_id {
            vehicle.reboot(boot_id, now);
        }
        vehicle.heard = now;
        link(vehicle);
    }

    /// Lets go of histories that are over, and of vehicles unseen for [`FORGOTTEN_AFTER`].
    pub fn expire(&self, now: Instant) {
        let mut vehicles = lock(&self.vehicles);
        let before = vehicles.len();
        vehicles.retain(|_, vehicle| {
            vehicle.linked()
                || vehicle.queues().next().is_some()
                || now.saturating_duration_since(vehicle.heard) < FORGOTTEN_AFTER
        });
        vehicles.values_mut().for_each(|vehicle| vehicle.history.trim(now));
        if vehicles.len() < before {
            share(&mut vehicles, now);
        }
    }

    /// The link to an agent is lost. What it said stays visible, with its age.
    pub fn disconnected(&self, id: &str) {
        if let Some(vehicle) = lock(&self.vehicles).get_mut(id) {
            // A session that was replaced by a newer one must not close the newer one.
            if vehicle.commands.as_ref().is_some_and(CommandSender::is_closed) {
                vehicle.commands = None;
            }
        }
    }

    /// Round trip and clock offset, measured by the link.
    pub fn stats(&self, id: &str, round_trip_ms: f64, clock_offset_us: f64) {
        if let Some(vehicle) = lock(&self.vehicles).get_mut(id) {
            vehicle.heard = Instant::now();
            vehicle.health.round_trip_ms = round_trip_ms;
            vehicle.health.clock_offset_us = clock_offset_us;
        }
    }

    /// Takes one live batch and returns the acknowledgements in it.
    pub fn batch(&self, id: &str, batch: &Batch) -> Vec<v1::Ack> {
        let now = Instant::now();
        let mut acks = Vec::new();
        let mut vehicles = lock(&self.vehicles);
        let Some(vehicle) = vehicles.get_mut(id) else { return acks };
        vehicle.heard = now;
        vehicle.health.roll(now);
        for frame in batch.frames() {
            if frame.known_kind().is_some_and(Kind::is_ground_made) {
                // Only the ground speaks of leases, links and recordings.
                continue;
            }
            vehicle.health.observe(&frame);
            if frame.known_kind() == Some(Kind::Ack) {
                acks.extend(frame.message::<v1::Ack>());
            }
            vehicle.take(&frame, now);
        }
        acks
    }

    /// Sends a message made by the ground to the viewers of `id`.
    pub fn publish<M: Message>(&self, id: &str, kind: Kind, message: &M) {
        if let Some(vehicle) = lock(&self.vehicles).get_mut(id) {
            let payload = message.encode_to_vec();
            let frame =
                Frame { kind: kind.to_wire(), instance: 0, sequence: 0, time_us: wall_time_us(), payload: &payload };
            vehicle.take(&frame, Instant::now());
        }
    }

    /// Shares what was gathered with the viewers. Called every [`FLUSH_EVERY`].
    pub fn flush(&self) {
        let now = Instant::now();
        for vehicle in lock(&self.vehicles).values_mut() {
            vehicle.flush(now);
        }
    }

    /// A new viewer of `id`: `history` back, then live, with no gap and no repetition between them; thinned to what a
    /// page shows, or every message.
    ///
    /// # Errors
    /// [`VehicleError::Unknown`].
    pub fn subscribe(&self, id: &str, history: Duration, thinned: bool) -> Result<Viewer, VehicleError> {
        let now = Instant::now();
        let mut vehicles = lock(&self.vehicles);
        let vehicle = vehicles.get_mut(id).ok_or_else(|| VehicleError::Unknown(id.to_owned()))?;
        vehicle.flush(now);
        let start = now.checked_sub(history.min(Duration::from_secs(MAX_HISTORY_SECONDS))).unwrap_or(now);
        let (oldest, past) = vehicle.history.since(start);
        let mut backlog = vec![vehicle.snapshot(oldest)];
        backlog.extend(past);
        let queue = Arc::new(ViewerQueue::new(self.dropped.clone()));
        vehicle.watch(&queue, thinned);
        Ok(Viewer { backlog, queue })
    }

    /// Messages that viewers were too slow for, all viewers together, since the start.
    pub fn dropped(&self) -> u64 {
        self.dropped.load(Ordering::Relaxed)
    }

    /// Bytes waiting for viewers, all of them together.
    pub fn queued_bytes(&self) -> usize {
        let vehicles = lock(&self.vehicles);
        let queues = vehicles.values().flat_map(Vehicle::queues);
        queues.map(|queue| queue.queued_bytes()).sum()
    }

    /// The batches of the last `history`, oldest first, each shared and none copied.
    ///
    /// # Errors
    /// [`VehicleError::Unknown`].
    pub fn past(&self, id: &str, history: Duration) -> Result<Vec<Shared>, VehicleError> {
        let vehicles = lock(&self.vehicles);
        let vehicle = vehicles.get(id).ok_or_else(|| VehicleError::Unknown(id.to_owned()))?;
        let now = Instant::now();
        Ok(vehicle.history.since(now.checked_sub(history).unwrap_or(now)).1)
    }

    /// The link as seen now; `missing` and `viewer_dropped` are for the caller to fill.
    pub fn link_status(&self, id: &str) -> Option<v1::LinkStatus> {
        // The clock that the offset is measured against: a step of the machine's own is no age of data.
        let now = Instant::now();
        let wall_time_us = wall_us(now);
        let mut vehicles = lock(&self.vehicles);
        let vehicle = vehicles.get_mut(id)?;
        vehicle.health.roll(now);
        let health = &vehicle.health;
        Some(v1::LinkStatus {
            wall_time_us,
            connected: vehicle.connected(),
            age_ms: health.age_ms(vehicle.boot_wall_time_us, wall_time_us),
            round_trip_ms: health.round_trip_ms,
            clock_offset_us: health.clock_offset_us,
            rate_hz: health.rate_hz(),
            loss_percent: health.loss_percent(),
            received: health.received,
            missing: 0,
            viewer_dropped: 0,
            newest_time_us: health.newest_time_us.unwrap_or_default(),
        })
    }

    /// The way down to `id`.
    ///
    /// # Errors
    /// [`VehicleError`] when it is unknown or not connected.
    pub fn commands(&self, id: &str) -> Result<CommandSender, VehicleError> {
        let vehicles = lock(&self.vehicles);
        let vehicle = vehicles.get(id).ok_or_else(|| VehicleError::Unknown(id.to_owned()))?;
        let live = vehicle.commands.as_ref().filter(|c| !c.is_closed());
        live.cloned().ok_or_else(|| VehicleError::Disconnected(id.to_owned()))
    }

    /// The ground that the link of `id` ends at; `None` where that is this one.
    pub(crate) fn ground_of(&self, id: &str) -> Option<AtGround> {
        lock(&self.vehicles).get(id)?.ground.clone()
    }

    /// Is `id` commanded from here?
    ///
    /// # Errors
    /// [`VehicleError`] when it is not known, or is commanded from another ground.
    pub(crate) fn commanded_here(&self, id: &str) -> Result<(), VehicleError> {
        let vehicles = lock(&self.vehicles);
        let vehicle = vehicles.get(id).ok_or_else(|| VehicleError::Unknown(id.to_owned()))?;
        let elsewhere = |ground| VehicleError::Elsewhere { vehicle: id.to_owned(), ground };
        vehicle.ground.clone().map_or(Ok(()), |ground| Err(elsewhere(ground)))
    }

    /// The latest message of one topic, decoded.
    pub fn latest<M: Message + Default>(&self, id: &str, kind: Kind) -> Option<M> {
        lock(&self.vehicles).get(id)?.latest_message(kind)
    }

    /// Is this vehicle known?
    pub fn knows(&self, id: &str) -> bool {
        lock(&self.vehicles).contains_key(id)
    }

    /// Names of all vehicles seen.
    pub fn ids(&self) -> Vec<String> {
        lock(&self.vehicles).keys().cloned().collect()
    }

    /// All vehicles seen.
    pub fn list(&self) -> Vec<VehicleInfo> {
        let vehicles = lock(&self.vehicles);
        let info = |(id, vehicle): (&String, &Vehicle)| VehicleInfo {
            id: id.clone(),
            connected: vehicle.connected(),
            boot_id: vehicle.boot_id,
            version: vehicle.version.clone(),
            description: vehicle.latest_message(Kind::Description),
            status: vehicle.latest_message(Kind::Status),
            ground: vehicle.ground.clone(),
        };
        vehicles.iter().map(info).collect()
    }
}

/// Gives each vehicle its share of the memory for histories.
fn share(vehicles: &mut BTreeMap<String, Vehicle>, now: Instant) {
    let bytes = ALL_HISTORIES / vehicles.len().max(1);
    vehicles.values_mut().for_each(|vehicle| vehicle.history.keep(bytes, now));
}

#[cfg(test)]
mod tests {
    use plumbline_proto::codec;

    use super::*;

    fn batch(sequence: u64, kind: Kind) -> Batch {
        let mut out = Vec::new();
        codec::begin_batch(&mut out);
        codec::encode_message(&mut out, kind, 0, sequence, sequence * 10, &v1::Control::default());
        Batch::parse(out.into()).unwrap()
    }

    fn sequences(shared: &Shared) -> Vec<u64> {
        codec::decode_batch(&shared.batch).unwrap().map(|f| f.unwrap().sequence).collect()
    }

    #[tokio::test]
    async fn history_and_live_meet_without_gap_or_repetition() {
        let hub = Hub::default();
        hub.connected("a", 1, 0, "0", CommandSender::channel().0);
        hub.batch("a", &batch(1, Kind::Control));
        hub.flush();
        hub.batch("a", &batch(2, Kind::Control));
        let viewer = hub.subscribe("a", Duration::from_secs(60), false).unwrap();
        hub.batch("a", &batch(3, Kind::Control));
        hub.flush();
        let mut seen: Vec<u64> = viewer.backlog.iter().flat_map(sequences).collect();
        seen.extend(sequences(&viewer.queue.next().await));
        assert_eq!(seen, [1, 2, 3]);
        let without = hub.subscribe("a", Duration::ZERO, false).unwrap();
        let first: Vec<u64> = without.backlog.iter().flat_map(sequences).collect();
        assert_eq!(first, [3], "without history the latest sample is in the snapshot");
        hub.batch("a", &batch(4, Kind::Status));
        let without = hub.subscribe("a", Duration::ZERO, false).unwrap();
        let first: Vec<u64> = without.backlog.iter().flat_map(sequences).collect();
        assert_eq!(first, [3, 4], "what was gathered for others, too, and once");
    }

    #[test]
    fn vehicles_are_forgotten_and_their_number_and_memory_are_bounded() {
        let hub = Hub::default();
        let later = |seconds| Instant::now() + Duration::from_secs(seconds);
        let (here, _here_end) = CommandSender::channel();
        hub.connected("here", 1, 0, "0", here);
        for n in 0..3 * MAX_VEHICLES {
            hub.connected(&n.to_string(), 1, 0, "0", CommandSender::channel().0);
        }
        assert_eq!(hub.list().len(), MAX_VEHICLES);
        assert!(hub.knows("here") && hub.knows("191") && !hub.knows("0"));
        hub.batch("191", &batch(1, Kind::Control));
        hub.flush();
        let held = || lock(&hub.vehicles)["191"].history.since(Instant::now() - Duration::from_secs(1)).1.len();
        assert_eq!(held(), 1);
        hub.expire(later(MAX_HISTORY_SECONDS + 1));
        assert_eq!((held(), hub.list().len()), (0, MAX_VEHICLES), "its history is over, its last state is kept");
        let viewer = hub.subscribe("190", Duration::ZERO, true).unwrap();
        hub.expire(later(FORGOTTEN_AFTER.as_secs() + 1));
        assert_eq!(hub.ids(), ["190", "here"], "who is watched or connected stays");
        drop(viewer);
    }

    #[test]
    fn a_new_boot_forgets_the_old_one_and_a_stale_goodbye_is_ignored() {
        let hub = Hub::default();
        let (old, _old_end) = CommandSender::channel();
        hub.connected("a", 1, 0, "0", old);
        hub.batch("a", &batch(9, Kind::Control));
        let (new, new_end) = CommandSender::channel();
        hub.connected("a", 2, 0, "0", new);
        hub.disconnected("a");
        assert!(hub.commands("a").is_ok());
        assert!(hub.subscribe("a", Duration::from_secs(9), false).unwrap().backlog.iter().all(|s| s.messages == 0));
        drop(new_end);
        assert_eq!(hub.commands("a").unwrap_err(), VehicleError::Disconnected("a".into()));
    }

    #[test]
    fn ground_kinds_are_refused() {
        let hub = Hub::default();
        hub.connected("a", 1, 0, "0", CommandSender::channel().0);
        hub.batch("a", &batch(1, Kind::Control));
        hub.batch("a", &batch(2, Kind::Lease));
        assert!(hub.latest::<v1::Control>("a", Kind::Control).is_some());
        assert!(hub.latest::<v1::ControlLease>("a", Kind::Lease).is_none());
    }
}
