//! A bad radio: a UDP relay between agent and ground that loses, delays, reorders and repeats packets, by seed.
//!
//! [`Radio::to`] listens on the loopback; an agent that is given [`Radio::address`] as its ground talks through it.
//! Each way has its own random numbers, so that the fate of the n-th packet of a way depends on the seed alone.

use std::cmp::Reverse;
use std::collections::BinaryHeap;
use std::io;
use std::net::{Ipv4Addr, SocketAddr, UdpSocket};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// What a packet may suffer; the same for both ways. [`Faults::default`] is a cable.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Faults {
    /// Chance that a packet is lost.
    pub loss: f64,
    /// Chance that a good stretch ends and a burst of loss begins, at each packet.
    pub burst_begins: f64,
    /// Chance that such a burst ends, at each packet.
    pub burst_ends: f64,
    /// Least time on the way.
    pub delay: Duration,
    /// Up to this much is added, evenly; more than the distance of two packets reorders them.
    pub jitter: Duration,
    /// Chance that a packet comes twice.
    pub repeated: f64,
    /// Nothing passes at all.
    pub outage: bool,
}

/// What has passed, both ways together.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Passed {
    /// Packets that came in.
    pub taken: u64,
    /// Lost on purpose, outages included.
    pub lost: u64,
    /// Sent twice.
    pub repeated: u64,
    /// Sent on after one that came in later.
    pub reordered: u64,
}

/// Packets that wait for their time; more are lost, as in any radio.
const MAX_WAITING: usize = 20_000;
const LARGEST_PACKET: usize = 65_536;
/// How often a thread that hears nothing looks whether it should end.
const LISTEN: Duration = Duration::from_millis(50);

#[derive(Debug, Default)]
struct Shared {
    faults: Mutex<Faults>,
    agent: Mutex<Option<SocketAddr>>,
    stop: AtomicBool,
    taken: AtomicU64,
    lost: AtomicU64,
    repeated: AtomicU64,
    reordered: AtomicU64,
}

/// A running relay; ends when dropped.
#[derive(Debug)]
pub struct Radio {
    address: SocketAddr,
    shared: Arc<Shared>,
    ways: Vec<Arc<Way>>,
    threads: Vec<JoinHandle<()>>,
}

impl Radio {
    /// A relay to `ground`, all of whose accidents follow from `seed`.
    ///
    /// # Errors
    /// No socket.
    pub fn to(ground: SocketAddr, faults: Faults, seed: u64) -> io::Result<Self> {
        let near = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0))?;
        let far = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0))?;
        far.connect(ground)?;
        let address = near.local_addr()?;
        let shared = Arc::new(Shared { faults: Mutex::new(faults), ..Shared::default() });
        let mut radio = Self { address, shared, ways: Vec::new(), threads: Vec::new() };
        radio.way(near.try_clone()?, far.try_clone()?, true, seed)?;
        radio.way(far, near, false, seed ^ 0x5bd1_e995_9e37_79b9)?;
        Ok(radio)
    }

    /// What the agent takes for its ground.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// The agent's own address, once it has spoken.
    pub fn agent(&self) -> Option<SocketAddr> {
        *locked(&self.shared.agent)
    }

    /// From now on.
    pub fn set(&self, faults: Faults) {
        *locked(&self.shared.faults) = faults;
    }

    /// Since the start.
    pub fn passed(&self) -> Passed {
        let count = |counter: &AtomicU64| counter.load(Ordering::Relaxed);
        let s = &self.shared;
        Passed {
            taken: count(&s.taken),
            lost: count(&s.lost),
            repeated: count(&s.repeated),
            reordered: count(&s.reordered),
        }
    }

    fn way(&mut self, from: UdpSocket, to: UdpSocket, up: bool, seed: u64) -> io::Result<()> {
        from.set_read_timeout(Some(LISTEN))?;
        let way = Arc::new(Way::default());
        self.ways.push(way.clone());
        let (shared, sender) = (self.shared.clone(), way.clone());
        self.threads.push(std::thread::spawn(move || sender.send(&to, up, &shared)));
        let shared = self.shared.clone();
        self.threads.push(std::thread::spawn(move || way.listen(&from, up, &shared, Chance(seed))));
        Ok(())
    }
}

impl Drop for Radio {
    fn drop(&mut self) {
        self.shared.stop.store(true, Ordering::Release);
        self.ways.iter().for_each(|way| way.changed.notify_all());
        for thread in self.threads.drain(..) {
            let _ = thread.join();
        }
    }
}

/// Due, order of arrival, packet.
type Waiting = Reverse<(Instant, u64, Vec<u8>)>;

/// Packets on their way.
#[derive(Debug, Default)]
struct Way {
    waiting: Mutex<BinaryHeap<Waiting>>,
    changed: Condvar,
}

impl Way {
    fn listen(&self, from: &UdpSocket, up: bool, shared: &Shared, mut chance: Chance) {
        let mut buffer = vec![0; LARGEST_PACKET];
        let mut burst = false;
        let mut number = 0;
        while !shared.stop.load(Ordering::Acquire) {
            let Ok((length, sender)) = from.recv_from(&mut buffer) else { continue };
            let now = Instant::now();
            if up {
                *locked(&shared.agent) = Some(sender);
            }
            shared.taken.fetch_add(1, Ordering::Relaxed);
            let faults = *locked(&shared.faults);
            // Drawn for every packet, so that one fault does not shift the others.
            let [lose, turn, late, repeat, later] = std::array::from_fn(|_| chance.draw());
            burst = if burst { turn >= faults.burst_ends } else { turn < faults.burst_begins };
            let mut waiting = locked(&self.waiting);
            if faults.outage || burst || lose < faults.loss || waiting.len() >= MAX_WAITING {
                shared.lost.fetch_add(1, Ordering::Relaxed);
                continue;
            }
            let packet = buffer.get(..length).unwrap_or_default().to_vec();
            if repeat < faults.repeated {
                shared.repeated.fetch_add(1, Ordering::Relaxed);
                waiting.push(Reverse((now + faults.delay + faults.jitter.mul_f64(later), number, packet.clone())));
            }
            waiting.push(Reverse((now + faults.delay + faults.jitter.mul_f64(late), number, packet)));
            number += 1;
            drop(waiting);
            self.changed.notify_one();
        }
    }

    fn send(&self, to: &UdpSocket, up: bool, shared: &Shared) {
        let mut newest = 0;
        let mut waiting = locked(&self.waiting);
        while !shared.stop.load(Ordering::Acquire) {
            let now = Instant::now();
            let due = waiting.peek().map(|Reverse((due, ..))| *due);
            match due {
                Some(due) if due <= now => {
                    let Some(Reverse((_, number, packet))) = waiting.pop() else { continue };
                    drop(waiting);
                    shared.reordered.fetch_add(u64::from(number < newest), Ordering::Relaxed);
                    newest = newest.max(number);
                    // A ground that is gone refuses its packets; a radio would not notice either.
                    let _ = match (up, *locked(&shared.agent)) {
                        (true, _) => to.send(&packet),
                        (false, Some(agent)) => to.send_to(&packet, agent),
                        (false, None) => Ok(0),
                    };
                    waiting = locked(&self.waiting);
                }
                _ => {
                    let wait = due.map_or(LISTEN, |due| due - now);
                    waiting = self.changed.wait_timeout(waiting, wait).unwrap_or_else(PoisonError::into_inner).0;
                }
            }
        }
    }
}

fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// SplitMix64: enough chance for a radio, and the same everywhere.
#[derive(Debug, Clone)]
pub struct Chance(pub u64);

impl Chance {
    /// Evenly from 0 to 1, without 1.
    pub fn draw(&mut self) -> f64 {
        (self.number() >> 11) as f64 / (1_u64 << 53) as f64
    }

    /// Any number.
    pub fn number(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Sends `count` numbered packets through a radio and answers which came, in order.
    fn through(faults: Faults, seed: u64, count: u16) -> Vec<u16> {
        let ground = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
        ground.set_read_timeout(Some(Duration::from_millis(500))).unwrap();
        let radio = Radio::to(ground.local_addr().unwrap(), faults, seed).unwrap();
        let agent = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
        let (to, sender) = (radio.address(), agent.try_clone().unwrap());
        // Beside the receiver: a socket holds no more than a few hundred packets.
        let sending = std::thread::spawn(move || {
            for number in 0..count {
                sender.send_to(&number.to_le_bytes(), to).unwrap();
                if number % 16 == 15 {
                    std::thread::sleep(Duration::from_millis(2));
                }
            }
        });
        let mut buffer = [0; 2];
        let mut came = Vec::new();
        while let Ok((_, relay)) = ground.recv_from(&mut buffer) {
            came.push(u16::from_le_bytes(buffer));
            if came.len() == 1 && faults == Faults::default() {
                // And back.
                let mut answer = [0; 3];
                agent.set_read_timeout(Some(Duration::from_secs(2))).unwrap();
                ground.send_to(b"ack", relay).unwrap();
                agent.recv_from(&mut answer).unwrap();
                assert_eq!(&answer, b"ack");
            }
        }
        sending.join().unwrap();
        came
    }

    #[test]
    fn a_cable_passes_everything_in_order_both_ways() {
        assert_eq!(through(Faults::default(), 1, 500), (0..500).collect::<Vec<_>>());
    }

    #[test]
    fn jitter_reorders_and_repetition_repeats() {
        let faults = Faults { jitter: Duration::from_millis(20), repeated: 0.2, ..Faults::default() };
        let came = through(faults, 3, 500);
        assert!((560..640).contains(&came.len()), "{} of 500 with every fifth twice", came.len());
        assert!(came.windows(2).any(|pair| pair[0] > pair[1]));
    }

    #[test]
    fn loss_follows_the_seed() {
        let faults = Faults { burst_begins: 0.05, burst_ends: 0.2, loss: 0.1, ..Faults::default() };
        let came = through(faults, 5, 1000);
        // A fifth of the time in bursts, a tenth of the rest.
        assert!((500..900).contains(&came.len()), "{} of 1000", came.len());
        // So few that a socket holds them all.
        let [once, again, other] = [5, 5, 6].map(|seed| through(faults, seed, 200));
        assert!(once == again && once != other, "{once:?}, {again:?}, {other:?}");
    }
}
