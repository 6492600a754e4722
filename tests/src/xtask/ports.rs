//! How late this machine serves pseudo terminals, as what flies through them cannot know.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use serial2::SerialPort;

/// Times that the wire rig is flown at most.
pub const WIRE_FLIGHTS: u32 = 3;
/// IMUs that are silent for 80 ms cut the motors, as they should: ports so late come near to that by themselves.
pub const PORTS_LATE: Duration = Duration::from_millis(60);
/// As often as an IMU sends.
const EVERY: Duration = Duration::from_millis(10);
/// Nothing for so long is as late as that.
const TOO_LONG: Duration = Duration::from_secs(2);

/// Sent at the end.
const LAST: u64 = u64::MAX;

/// A pair of pseudo terminals through which it is sent when each word was due, until it is asked what came of it.
#[derive(Debug)]
pub struct Ports {
    stop: Arc<AtomicBool>,
    worst_us: Arc<AtomicU64>,
    sender: JoinHandle<SerialPort>,
    receiver: JoinHandle<()>,
}

impl Ports {
    /// Begins to send.
    ///
    /// # Errors
    /// No pseudo terminal.
    pub fn watch() -> std::io::Result<Self> {
        let (near, mut far) = SerialPort::pair()?;
        far.set_read_timeout(TOO_LONG)?;
        let (stop, worst_us) = (Arc::new(AtomicBool::new(false)), Arc::new(AtomicU64::new(0)));
        let begun = Instant::now();
        let now_us = move || begun.elapsed().as_micros() as u64;
        let sender = {
            let stop = stop.clone();
            std::thread::spawn(move || {
                // When it is due, not when it is sent: a machine that stands still has nobody send meanwhile.
                let mut due_us = now_us();
                while !stop.load(Ordering::Acquire) && near.write_all(&due_us.to_le_bytes()).is_ok() {
                    due_us = now_us() + EVERY.as_micros() as u64;
                    std::thread::sleep(EVERY);
                }
                // The last word ends what the other one reads.
                let _ = near.write_all(&LAST.to_le_bytes());
                // Closed, it would take along what is on its way.
                near
            })
        };
        let receiver = {
            let worst_us = worst_us.clone();
            std::thread::spawn(move || {
                let mut sent = [0; 8];
                while far.read_exact(&mut sent).is_ok() {
                    match u64::from_le_bytes(sent) {
                        LAST => return,
                        sent_us => drop(worst_us.fetch_max(now_us().saturating_sub(sent_us), Ordering::AcqRel)),
                    }
                }
                worst_us.fetch_max(TOO_LONG.as_micros() as u64, Ordering::AcqRel);
            })
        };
        Ok(Self { stop, worst_us, sender, receiver })
    }

    /// Ends it; by how much the latest of all arrived too late.
    pub fn worst(self) -> Duration {
        self.stop.store(true, Ordering::Release);
        // One that panicked has told what there is.
        let near = self.sender.join();
        let _ = self.receiver.join();
        drop(near);
        Duration::from_micros(self.worst_us.load(Ordering::Acquire))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_sent_arrives_and_its_lateness_is_told() {
        let ports = Ports::watch().unwrap();
        std::thread::sleep(Duration::from_millis(100));
        let worst = ports.worst();
        assert!(worst > Duration::ZERO && worst < TOO_LONG, "{worst:?}");
    }
}
