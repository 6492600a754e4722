//! What the machine itself does to a thread that must keep time: a bare timer beside the flight thread, with its
//! priority, that touches nothing. What it suffers the flight thread would suffer without ground, link or disk.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use plumbline_agent::runner::pace;
use plumbline_devices::scheduling;

use super::figures::quantile;

/// Wall clock, µs.
pub fn now_us() -> u64 {
    SystemTime::now().duration_since(UNIX_EPOCH).unwrap().as_micros() as u64
}

/// One tick of the timer: when it was over (wall clock, µs) and how late it began, µs.
type Tick = (u64, f32);

/// The running timer.
pub struct Witness {
    ticks: Arc<Mutex<Vec<Tick>>>,
    ended: Arc<AtomicBool>,
    thread: Option<std::thread::JoinHandle<()>>,
}

impl Witness {
    /// Starts it; on one processor only where that is given. Ticks less late than `least_us` are not kept.
    pub fn start(processor: Option<usize>, period: Duration, least_us: f32) -> Self {
        let (ticks, ended) = (Arc::new(Mutex::new(Vec::new())), Arc::new(AtomicBool::new(false)));
        let thread = {
            let (ticks, ended) = (ticks.clone(), ended.clone());
            std::thread::spawn(move || {
                if let Some(processor) = processor {
                    stay_on(processor);
                }
                scheduling::ask_for_real_time(scheduling::FLIGHT);
                let mut due = Instant::now() + period;
                while !ended.load(Ordering::Relaxed) {
                    pace::sleep_until(due);
                    let late = due.elapsed();
                    let late_us = late.as_secs_f32() * 1e6;
                    if late_us >= least_us {
                        ticks.lock().unwrap().push((now_us(), late_us));
                    }
                    due += period * (1 + (late.as_micros() / period.as_micros()) as u32);
                }
            })
        };
        Self { ticks, ended, thread: Some(thread) }
    }

    /// How late it was between two moments, 99th percentile of each second, µs: as the agent tells its own.
    pub fn jitter_us(&self, begin: u64, end: u64) -> Vec<f64> {
        let ticks = self.ticks.lock().unwrap();
        let from = ticks.partition_point(|(at, _)| *at < begin);
        let mut seconds: Vec<Vec<f64>> = Vec::new();
        for (at, late) in ticks[from..].iter().take_while(|(at, _)| *at < end) {
            let second = ((at - begin) / 1_000_000) as usize;
            seconds.resize(seconds.len().max(second + 1), Vec::new());
            seconds[second].push(f64::from(*late));
        }
        seconds.into_iter().filter(|second| second.len() > 50).map(|mut second| quantile(&mut second, 0.99)).collect()
    }

    /// The latest it ever was between two moments, µs.
    pub fn worst_us(&self, begin: u64, end: u64) -> f64 {
        let ticks = self.ticks.lock().unwrap();
        let from = ticks.partition_point(|(at, _)| *at < begin);
        let within = ticks[from..].iter().take_while(|(at, _)| *at < end);
        within.map(|(_, late)| f64::from(*late)).fold(0.0, f64::max)
    }
}

impl Drop for Witness {
    fn drop(&mut self) {
        self.ended.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

fn stay_on(processor: usize) {
    // SAFETY: a plain set of bits, filled in here, for the calling thread.
    unsafe {
        let mut set: libc::cpu_set_t = std::mem::zeroed();
        libc::CPU_SET(processor, &mut set);
        libc::sched_setaffinity(0, size_of::<libc::cpu_set_t>(), &raw const set);
    }
}
