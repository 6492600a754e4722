//! Clocks of loggers that were started by hand: how late one runs behind another.

/// A clock is moved only where that brings the root mean square difference below this part of what it was:
/// noise and a signal that hardly moves do not.
const IMPROVEMENT: f64 = 0.5;

/// The same signal by two loggers: (time, value) in the order of time, s and any unit.
pub(super) type Signal = [(f64, f64)];

/// How much later than `reference` the clock of `other` shows the same, s: `other(t + lag) = reference(t)`.
///
/// Looks at every `step_s` up to `largest_s` both ways, at the times of `reference` that `other` has too. Zero where no
/// lag makes the two agree clearly better than none.
pub(super) fn lag_s(reference: &Signal, other: &Signal, largest_s: f64, step_s: f64) -> f64 {
    let unmoved = mean_square(reference, other, 0.0);
    let steps = (largest_s / step_s).floor() as i32;
    let (best, lag) = (-steps..=steps)
        .map(|k| f64::from(k) * step_s)
        .map(|lag| (mean_square(reference, other, lag), lag))
        .min_by(|a, b| a.0.total_cmp(&b.0))
        .unwrap_or((unmoved, 0.0));
    if best < IMPROVEMENT.powi(2) * unmoved { lag } else { 0.0 }
}

/// Mean of (other(t + lag) − reference(t))²; infinite unless they share at least half of the reference.
fn mean_square(reference: &Signal, other: &Signal, lag: f64) -> f64 {
    let (mut sum, mut count) = (0.0, 0_usize);
    for (t, value) in reference {
        if let Some(seen) = interpolated(other, t + lag) {
            sum += (seen - value).powi(2);
            count += 1;
        }
    }
    if 2 * count > reference.len() { sum / count as f64 } else { f64::INFINITY }
}

fn interpolated(signal: &Signal, t: f64) -> Option<f64> {
    let after = signal.partition_point(|(time, _)| *time < t);
    let (t1, v1) = *signal.get(after)?;
    let Some((t0, v0)) = after.checked_sub(1).and_then(|before| signal.get(before)) else {
        return (t1 == t).then_some(v1);
    };
    Some(v0 + (v1 - v0) * (t - t0) / (t1 - t0))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Swings at 0.4 and 1.1 Hz as a logger `late_s` behind sees them, at `rate_hz` for 20 s.
    fn swings(rate_hz: f64, late_s: f64, noise: f64) -> Vec<(f64, f64)> {
        let n = (20.0 * rate_hz) as usize;
        (0..n)
            .map(|k| {
                let t = k as f64 / rate_hz;
                let at = t - late_s;
                // Some noise that needs no generator.
                let rough = noise * (((k * 7919) % 1000) as f64 / 500.0 - 1.0);
                (t, (2.5 * at).sin() + 0.5 * (7.0 * at).cos() + rough)
            })
            .collect()
    }

    #[test]
    fn finds_how_late_a_clock_is_and_leaves_a_right_one_alone() {
        let reference = swings(10.0, 0.0, 0.05);
        for late in [0.7, -0.4, 0.05] {
            let lag = lag_s(&reference, &swings(120.0, late, 0.05), 2.0, 1.0 / 120.0);
            assert!((lag - late).abs() < 0.02, "{late} s late: {lag}");
        }
        assert_eq!(lag_s(&reference, &swings(120.0, 0.0, 0.05), 2.0, 1.0 / 120.0), 0.0);
    }

    #[test]
    fn moves_nothing_for_noise_stillness_or_nothing_in_common() {
        let still: Vec<_> = swings(10.0, 0.0, 0.05).iter().enumerate().map(|(k, s)| (s.0, (k % 3) as f64)).collect();
        let other: Vec<_> = swings(120.0, 0.0, 0.05).iter().enumerate().map(|(k, s)| (s.0, (k % 7) as f64)).collect();
        assert_eq!(lag_s(&still, &other, 2.0, 0.01), 0.0);
        let constant: Vec<_> = other.iter().map(|s| (s.0, 1.0)).collect();
        assert_eq!(lag_s(&constant, &constant, 2.0, 0.01), 0.0);
        let later: Vec<_> = other.iter().map(|s| (s.0 + 100.0, s.1)).collect();
        assert_eq!(lag_s(&other, &later, 2.0, 0.01), 0.0);
        assert_eq!(lag_s(&[], &[], 2.0, 0.01), 0.0);
    }
}
