//! The files of the flights that go on, and the disk they are on.

use std::path::Path;
use std::time::{Duration, Instant};

use plumbline_proto::codec::Frame;

use super::Worker;
use crate::recorder::explain;
use crate::recorder::folder::free_bytes;
use crate::recorder::writer::FlightWriter;

/// A file that failed is tried again after this long.
const RETRY_AFTER: Duration = Duration::from_secs(1);

impl Worker {
    pub(super) fn record(&mut self, id: &str, frame: &Frame<'_>, backfill: bool, now: Instant) {
        if !self.ready_to_write(id, now) {
            return;
        }
        let Some(track) = self.tracks.get_mut(id) else { return };
        let topic = self.topics.entry((frame.kind, frame.instance)).or_insert_with(|| {
            frame.known_kind().map_or_else(
                || format!("/unknown/{}/{}", frame.kind, frame.instance),
                |kind| kind.topic(frame.instance),
            )
        });
        if let Err(error) = track.write(frame, topic, backfill, now) {
            self.failed(id, &explain(&error), now);
        }
    }

    /// Opens the file of a flight where none is open. `false` while nothing can be written.
    fn ready_to_write(&mut self, id: &str, now: Instant) -> bool {
        let Some(track) = self.tracks.get_mut(id) else { return false };
        if track.output.writer.is_some() {
            return true;
        }
        if track.output.retry.is_some_and(|at| now < at) {
            return false;
        }
        let path = self.store.part_path(id, track.output.part);
        track.output.part += 1;
        let created = self.store.probe().map_err(|e| e.to_string()).and_then(|()| {
            let free = free_bytes(self.store.folder());
            if free < self.config.reserve_bytes {
                return Err(low_space(self.store.folder(), free, self.config.reserve_bytes));
            }
            FlightWriter::create(&path, &track.identity, &self.syncer)
                .map_err(|e| format!("{}: {}", path.display(), explain(&e)))
        });
        match created {
            Ok(writer) => {
                track.output.writer = Some((path, writer));
                track.output.retry = None;
                self.shared.recover();
                true
            }
            Err(error) => {
                track.output.retry = Some(now + RETRY_AFTER);
                self.shared.complain(&error);
                false
            }
        }
    }

    /// A file failed: what was not flushed is missing, and will be asked for again.
    pub(super) fn failed(&mut self, id: &str, error: &str, now: Instant) {
        self.shared.complain(error);
        let Some(track) = self.tracks.get_mut(id) else { return };
        track.output.writer = None;
        track.output.retry = Some(now + RETRY_AFTER);
        track.fall_back();
    }

    /// Looks at the disk while nothing is written to it, so that a problem shows before a flight, and after a file failed: a vehicle
    /// that is lost sends nothing by which the end of the problem would show.
    pub(super) fn check_disk(&mut self, now: Instant) {
        self.free_bytes = free_bytes(self.store.folder());
        let reserve = self.config.reserve_bytes;
        if self.free_bytes < reserve {
            let text = low_space(self.store.folder(), self.free_bytes, reserve);
            for id in self.tracks.keys().cloned().collect::<Vec<_>>() {
                if self.tracks.get(&id).is_some_and(|t| t.output.writer.is_some()) {
                    let flushed = self.tracks.get_mut(&id).map(|t| t.flush(now, true));
                    tracing::error!(flight = %id, ?flushed, "recording stopped: {text}");
                    self.failed(&id, &text, now);
                }
            }
            self.shared.complain(&text);
        } else if self.tracks.values().all(|t| t.output.writer.is_none())
            || self.tracks.values().any(|t| t.output.retry.is_some())
        {
            match self.store.probe() {
                Ok(()) => {
                    for track in self.tracks.values_mut().filter(|t| t.output.retry.is_some_and(|at| now >= at)) {
                        track.output.retry = None;
                        // What is missing is waited for from now on.
                        track.progressed = now;
                    }
                    if self.tracks.values().all(|t| t.output.retry.is_none()) {
                        self.shared.recover();
                    }
                }
                Err(error) => self.shared.complain(&error.to_string()),
            }
        }
    }
}

fn low_space(folder: &Path, free: u64, reserve: u64) -> String {
    format!("{}: {free} bytes are free, recording needs {reserve}", folder.display())
}
