//! How the ticks keep their time: work and jitter over the last second, deadlines missed.

use std::time::{Duration, Instant};

use crate::telemetry::TickStats;

/// Jitter and work of the ticks of one second; memory is taken once.
#[derive(Debug)]
pub struct Timing {
    period: Duration,
    work_us: Vec<f32>,
    jitter_us: Vec<f32>,
    since: Instant,
    ticks: u32,
    /// Periods by which the last tick ended too late.
    late: u32,
    stats: TickStats,
}

impl Timing {
    /// For ticks of this rate.
    pub fn new(tick_rate_hz: f64) -> Self {
        // Replays as fast as possible make more ticks a second; they are sampled up to this many.
        let room = tick_rate_hz.ceil() as usize * 2 + 16;
        Self {
            period: Duration::from_secs_f64(1.0 / tick_rate_hz.max(1.0)),
            work_us: Vec::with_capacity(room),
            jitter_us: Vec::with_capacity(room),
            since: Instant::now(),
            ticks: 0,
            late: 0,
            stats: TickStats::default(),
        }
    }

    /// Notes one tick; returns how many control ticks were lost by it: those due before it ended that an earlier late one
    /// has not counted.
    pub fn tick(&mut self, due: Option<Instant>, started: Instant, ended: Instant) -> u32 {
        self.ticks += 1;
        if self.work_us.len() < self.work_us.capacity() {
            self.work_us.push(micros(ended.duration_since(started)));
        }
        if let Some(due) = due
            && self.jitter_us.len() < self.jitter_us.capacity()
        {
            self.jitter_us.push(micros(started.saturating_duration_since(due)));
        }
        let elapsed = ended.duration_since(self.since);
        if elapsed >= Duration::from_secs(1) {
            self.stats = TickStats {
                rate_hz: f64::from(self.ticks) / elapsed.as_secs_f64(),
                work_p50_us: quantile(&mut self.work_us, 0.5),
                work_p99_us: quantile(&mut self.work_us, 0.99),
                jitter_p99_us: quantile(&mut self.jitter_us, 0.99),
            };
            self.work_us.clear();
            self.jitter_us.clear();
            self.since = ended;
            self.ticks = 0;
        }
        let overrun = due.map_or(Duration::ZERO, |due| ended.saturating_duration_since(due + self.period));
        let late = (overrun.as_secs_f64() / self.period.as_secs_f64()).ceil() as u32;
        // Catching up after one long delay ends late again, by a period less each time.
        let lost = late.saturating_sub(self.late.saturating_sub(1));
        self.late = late;
        lost
    }

    /// Of the last full second.
    pub fn stats(&self) -> TickStats {
        self.stats
    }
}

fn micros(duration: Duration) -> f32 {
    (duration.as_secs_f64() * 1e6) as f32
}

/// The `q` quantile; rearranges `values`. Zero when there are none.
fn quantile(values: &mut [f32], q: f64) -> f64 {
    if values.is_empty() {
        return 0.0;
    }
    let index = ((values.len() - 1) as f64 * q).round() as usize;
    let (_, value, _) = values.select_nth_unstable_by(index, f32::total_cmp);
    f64::from(*value)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_second_of_ticks_is_summed_up_and_late_ones_are_told() {
        let mut timing = Timing::new(100.0);
        let begin = timing.since;
        let mut missed = 0;
        for n in 0..=100 {
            let due = begin + Duration::from_millis(10 * n);
            let work = if n == 50 { 12_000 } else { n };
            let started = due + Duration::from_micros(n);
            missed += timing.tick(Some(due), started, started + Duration::from_micros(work));
        }
        let stats = timing.stats();
        assert_eq!(missed, 1);
        assert!((99.0..102.0).contains(&stats.rate_hz), "{stats:?}");
        assert!((45.0..55.0).contains(&stats.work_p50_us) && stats.jitter_p99_us > 95.0, "{stats:?}");
    }

    #[test]
    fn a_long_delay_counts_in_ticks_and_once() {
        let mut timing = Timing::new(200.0);
        let begin = timing.since;
        let period = Duration::from_millis(5);
        let mut lost = 0;
        let mut now = begin;
        for n in 0..20 {
            let due = begin + period * n;
            // Stands for 32 ms before the tick due at 25 ms, and catches up from there.
            now = now.max(due) + if n == 5 { Duration::from_millis(32) } else { Duration::ZERO };
            lost += timing.tick(Some(due), now, now + Duration::from_micros(10));
        }
        assert_eq!(lost, 6, "32 ms after its due time, and a period for itself");
        let overrun = |timing: &mut Timing, n: u32| {
            let due = begin + Duration::from_secs(1) + period * n;
            timing.tick(Some(due), due, due + Duration::from_millis(6))
        };
        assert_eq!((0..10).map(|n| overrun(&mut timing, n)).sum::<u32>(), 10, "each that takes too long is one");
    }
}
