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
            stats: TickStats::default(),
        }
    }

    /// Notes one tick; `true` when it ended after the next one was due.
    pub fn tick(&mut self, due: Option<Instant>, started: Instant, ended: Instant) -> bool {
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
        due.is_some_and(|due| ended > due + self.period)
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
            missed += u32::from(timing.tick(Some(due), started, started + Duration::from_micros(work)));
        }
        let stats = timing.stats();
        assert_eq!(missed, 1);
        assert!((99.0..102.0).contains(&stats.rate_hz), "{stats:?}");
        assert!((45.0..55.0).contains(&stats.work_p50_us) && stats.jitter_p99_us > 95.0, "{stats:?}");
    }
}
