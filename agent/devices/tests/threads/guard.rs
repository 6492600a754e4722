//! The guard of the motors: silence, a closed socket, damaged records.

use std::cell::Cell;
use std::io::Write as _;
use std::os::unix::net::UnixStream;
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use plumbline_core::types::{MotorCommand, ROTORS};
use plumbline_devices::DeviceError;
use plumbline_devices::motors::{GuardLine, PulseRange, Pulses, SILENCE, encode, guard};

type Log = Arc<Mutex<Vec<(Instant, [f64; ROTORS])>>>;

/// What is set, but for so many that are refused.
struct Recorded(Log, Arc<AtomicU32>);

impl Pulses for Recorded {
    fn open(&mut self) -> Result<(), DeviceError> {
        Ok(())
    }
    fn set(&mut self, widths_us: &[f64; ROTORS]) -> Result<(), DeviceError> {
        // Locked first: what is refused from a moment on is told from what was set before it.
        let mut log = self.0.lock().unwrap();
        if self.1.fetch_update(Ordering::AcqRel, Ordering::Acquire, |left| left.checked_sub(1)).is_ok() {
            return Err(DeviceError::Silent { what: "acknowledgement", seconds: 0.0 });
        }
        log.push((Instant::now(), *widths_us));
        Ok(())
    }
}

struct Guarded {
    log: Log,
    refuses: Arc<AtomicU32>,
    /// So much of the log was looked at: the guard stops what this thread is too slow to look at.
    seen: Cell<usize>,
    thread: std::thread::JoinHandle<Result<(), DeviceError>>,
}

impl Guarded {
    fn start() -> (UnixStream, Self) {
        let (near, mut far) = UnixStream::pair().unwrap();
        let log = Log::default();
        let refuses = Arc::<AtomicU32>::default();
        let mut pulses = Recorded(log.clone(), refuses.clone());
        let range = PulseRange { stop_us: 1000.0, full_us: 2000.0 };
        let thread = std::thread::spawn(move || guard(&mut far, &mut pulses, range, Duration::ZERO));
        (near, Self { log, refuses, seen: Cell::new(0), thread })
    }

    /// The next pulses of `motor` that are about `width_us`, and when they were set.
    fn next(&self, motor: usize, width_us: f64) -> (Instant, [f64; ROTORS]) {
        let begun = Instant::now();
        loop {
            let log = self.log.lock().unwrap().clone();
            let fits = |(_, widths): &(Instant, [f64; ROTORS])| (widths[motor] - width_us).abs() < 0.1;
            if let Some(at) = log.iter().skip(self.seen.get()).position(fits) {
                let at = self.seen.get() + at;
                self.seen.set(at + 1);
                return log[at];
            }
            assert!(begun.elapsed() < Duration::from_secs(20), "no pulse of {width_us} µs");
            std::thread::sleep(Duration::from_micros(200));
        }
    }

    /// When the first motor's pulse became about `width_us`.
    fn until(&self, width_us: f64) -> Instant {
        self.next(0, width_us).0
    }
}

#[test]
fn silence_and_a_closed_socket_stop_the_motors() {
    let (socket, guarded) = Guarded::start();
    let line = GuardLine::new(socket).unwrap();
    guarded.until(1000.0);
    let sent = Instant::now();
    line.send(&MotorCommand { throttle: [0.5; 4] }).unwrap();
    guarded.until(1500.0);
    assert!(guarded.until(1000.0) - sent >= SILENCE, "not before");
    line.send(&MotorCommand { throttle: [1.0; 4] }).unwrap();
    guarded.until(2000.0);
    drop(line);
    guarded.thread.join().unwrap().unwrap();
    assert_eq!(guarded.log.lock().unwrap().last().unwrap().1, [1000.0; 4]);
}

#[test]
fn refused_pulses_are_tried_again_and_after_a_while_the_motors_stop_as_soon_as_they_can() {
    let (socket, guarded) = Guarded::start();
    let line = GuardLine::new(socket).unwrap();
    let send = |throttle: f64| line.send(&MotorCommand { throttle: [throttle; 4] });
    send(0.5).unwrap();
    guarded.until(1500.0);
    // Once: the next command is set.
    guarded.refuses.store(1, Ordering::Release);
    send(0.6).unwrap();
    let begun = Instant::now();
    while guarded.refuses.load(Ordering::Acquire) > 0 {
        assert!(begun.elapsed() < Duration::from_secs(20), "it is not tried");
        std::thread::sleep(Duration::from_micros(200));
    }
    send(0.7).unwrap();
    guarded.until(1700.0);
    // For long: the line is closed, and what stops is tried until it is taken.
    let before = {
        let log = guarded.log.lock().unwrap();
        guarded.refuses.store(u32::MAX, Ordering::Release);
        log.clone()
    };
    let begun = Instant::now();
    while send(0.8).is_ok() {
        assert!(begun.elapsed() < Duration::from_secs(20), "it goes on");
        std::thread::sleep(Duration::from_millis(5));
    }
    assert!(before.last().unwrap().0.elapsed() >= SILENCE, "not before");
    assert_eq!(*guarded.log.lock().unwrap(), before, "nothing could be set");
    guarded.refuses.store(0, Ordering::Release);
    guarded.until(1000.0);
    assert!(guarded.thread.join().unwrap().is_err(), "and it says why");
}

#[test]
fn damaged_records_and_values_that_are_no_numbers_turn_nothing() {
    let (mut socket, guarded) = Guarded::start();
    let mut damaged = encode(&MotorCommand { throttle: [0.9; 4] });
    damaged[3] ^= 1;
    let odd = encode(&MotorCommand { throttle: [f64::NAN, 7.0, -1.0, 0.25] });
    socket.write_all(&[&[1, 2, 0xA7][..], &damaged, &odd].concat()).unwrap();
    let (_, seen) = guarded.next(3, 1250.0);
    assert_eq!(seen[..3], [1000.0, 2000.0, 1000.0]);
    assert!(guarded.log.lock().unwrap().iter().all(|(_, widths)| (widths[0] - 1000.0).abs() < 0.1), "0.9 never passed");
}
