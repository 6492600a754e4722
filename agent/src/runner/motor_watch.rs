//! Stops the motors when the flight thread falls silent: a thread of its own, above it in priority.
//!
//! The flight thread leaves a mark at every tick. Armed and without a new mark for the limit, the motors are stopped
//! through the vehicle's own [`MotorStop`], which needs nothing of the flight thread; when that thread comes back, the
//! flight latches the cut.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};

use plumbline_devices::scheduling;

use super::worker::{Going, Worker};
use crate::vehicle::MotorStop;

/// How often the mark is looked at.
const PERIOD: Duration = Duration::from_millis(10);

#[derive(Debug)]
struct Marks {
    begun: Instant,
    /// Nanoseconds since `begun` of the last mark; 0 while there is nothing to watch.
    last_ns: AtomicU64,
    stopped: AtomicBool,
}

/// The watch. Ends with the runner.
#[derive(Debug)]
pub struct MotorWatch {
    marks: Arc<Marks>,
    _thread: Worker,
}

impl MotorWatch {
    /// Watches with this `limit`; `real_time` asks for priority.
    ///
    /// # Errors
    /// No thread could be started.
    pub fn start(motors: Arc<dyn MotorStop>, limit: Duration, real_time: bool) -> std::io::Result<Self> {
        let marks =
            Arc::new(Marks { begun: Instant::now(), last_ns: AtomicU64::new(0), stopped: AtomicBool::new(false) });
        let seen = marks.clone();
        let watch = move |going: Going| {
            if real_time {
                scheduling::ask_for_real_time(scheduling::MOTOR_WATCH);
            }
            while going.on() {
                std::thread::sleep(PERIOD);
                let last_ns = seen.last_ns.load(Ordering::Acquire);
                let silent = seen.begun.elapsed().saturating_sub(Duration::from_nanos(last_ns));
                if last_ns != 0 && silent > limit && !seen.stopped.swap(true, Ordering::AcqRel) {
                    motors.stop();
                    tracing::error!(silent_s = silent.as_secs_f64(), "the flight thread is silent: motors stopped");
                }
            }
        };
        Ok(Self { marks, _thread: Worker::start("motor-watch", watch)? })
    }

    /// A tick begins; `armed` is what the last one left.
    pub fn mark(&self, armed: bool) {
        let now_ns = if armed { self.marks.begun.elapsed().as_nanos() as u64 } else { 0 };
        self.marks.last_ns.store(now_ns, Ordering::Release);
    }

    /// Have the motors been stopped since this was asked last?
    pub fn stopped(&self) -> bool {
        self.marks.stopped.swap(false, Ordering::AcqRel)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::Mutex;

    #[derive(Debug, Default)]
    struct Motors(Mutex<Option<Instant>>);

    impl MotorStop for Motors {
        fn stop(&self) {
            *self.0.lock().unwrap() = Some(Instant::now());
        }
    }

    #[test]
    fn an_armed_flight_thread_that_hangs_stops_the_motors_and_a_disarmed_one_does_not() {
        let motors = Arc::new(Motors::default());
        let watch = MotorWatch::start(motors.clone(), Duration::from_millis(100), false).unwrap();
        watch.mark(false);
        std::thread::sleep(Duration::from_millis(300));
        assert!(motors.0.lock().unwrap().is_none() && !watch.stopped());
        let hung = Instant::now();
        watch.mark(true);
        while !watch.stopped() {
            assert!(hung.elapsed() < Duration::from_secs(10), "nobody stopped the motors");
            std::thread::sleep(Duration::from_millis(1));
        }
        let after = motors.0.lock().unwrap().unwrap() - hung;
        assert!(after >= Duration::from_millis(100), "{after:?}");
    }
}
