//! Figures of a campaign: one JSON line each, with the limit it was promised and whether it holds.

use serde_json::{Value, json};

/// Prints figures and remembers whether all promises held.
pub struct Figures {
    campaign: &'static str,
    seed: u64,
    broken: Vec<String>,
}

impl Figures {
    pub fn new(campaign: &'static str, seed: u64) -> Self {
        Self { campaign, seed, broken: Vec::new() }
    }

    /// A figure without a promise.
    pub fn tell(&mut self, name: &str, value: f64, unit: &str, more: Value) {
        self.line(name, value, unit, None, more);
    }

    /// A figure that must not exceed `limit`.
    pub fn at_most(&mut self, name: &str, value: f64, limit: f64, unit: &str, more: Value) {
        // Not `value > limit`: no number is no success.
        let holds = value <= limit;
        self.line(name, value, unit, Some((limit, holds)), more);
    }

    /// A figure that must reach `limit`.
    pub fn at_least(&mut self, name: &str, value: f64, limit: f64, unit: &str, more: Value) {
        let holds = value >= limit;
        self.line(name, value, unit, Some((limit, holds)), more);
    }

    fn line(&mut self, name: &str, value: f64, unit: &str, promise: Option<(f64, bool)>, more: Value) {
        let value = (value * 1e3).round() / 1e3;
        let mut line = json!({ "chaos": self.campaign, "name": name, "value": value, "unit": unit, "seed": self.seed });
        if let (Some(line), Some(more)) = (line.as_object_mut(), more.as_object()) {
            if let Some((limit, holds)) = promise {
                line.insert("limit".into(), limit.into());
                line.insert("holds".into(), holds.into());
            }
            line.extend(more.clone());
        }
        println!("{line}");
        if let Some((limit, false)) = promise {
            self.broken.push(format!("{name} is {value} {unit}, promised {limit}"));
        }
    }

    /// What cannot be found out here, and why: nothing is promised of it.
    pub fn skip(&self, name: &str, reason: &str) {
        println!("{}", json!({ "chaos": self.campaign, "name": name, "skipped": reason, "seed": self.seed }));
        eprintln!("chaos {}: {name} skipped: {reason}", self.campaign);
    }

    /// Ends the program: in failure when a promise was broken.
    pub fn finish(self) -> std::process::ExitCode {
        for broken in &self.broken {
            eprintln!("chaos {}: {broken}", self.campaign);
        }
        if self.broken.is_empty() { std::process::ExitCode::SUCCESS } else { std::process::ExitCode::FAILURE }
    }
}

/// A number given by `cargo xtask chaos`, or by hand.
pub fn setting(name: &str, default: u64) -> u64 {
    std::env::var(name).ok().map_or(default, |text| text.parse().unwrap_or_else(|_| panic!("{name}={text}")))
}

/// The `q` quantile.
pub fn quantile(values: &mut [f64], q: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    let index = (values.len().saturating_sub(1) as f64 * q).round() as usize;
    values.get(index).copied().unwrap_or(f64::NAN)
}
