//! A report whose figures have targets.

use std::path::{Path, PathBuf};

use plumbline_agent::offline::{ErrorSample, EstimateArgs, Score, run};
use plumbline_tests::report::{Plot, Report, ReportError, Series};
use serde_json::json;

/// What a figure must reach.
#[derive(Debug, Clone, Copy)]
pub enum Target {
    /// At most.
    Most(f64),
    /// Nothing promised; a peer's figure is shown beside it where there is one.
    Peer(Option<f64>),
}

/// The report, and its figures as one table.
pub struct Scored {
    pub report: Report,
    folder: tempfile::TempDir,
    rows: Vec<Vec<String>>,
    missed: usize,
}

impl Scored {
    pub fn new(report: Report) -> Self {
        Self { report, folder: tempfile::tempdir().unwrap(), rows: Vec::new(), missed: 0 }
    }

    /// One figure with its target.
    pub fn value(&mut self, name: &str, value: f64, unit: &str, target: Target) {
        let (shown, verdict, more) = match target {
            Target::Most(limit) => {
                let met = value <= limit;
                self.missed += usize::from(!met);
                let verdict = if met { "met" } else { "missed" };
                (format!("≤ {limit}"), verdict, json!({ "target": limit, "met": met }))
            }
            Target::Peer(Some(peer)) => (format!("peer {peer}"), "", json!({ "peer": peer })),
            Target::Peer(None) => (String::new(), "", json!({})),
        };
        let digits = if value.abs() < 1e-3 { format!("{value:.1e}") } else { format!("{value:.3}") };
        self.rows.push(vec![name.to_owned(), digits, unit.to_owned(), shown, verdict.to_owned()]);
        self.report.value(name, value, unit, more);
    }

    /// A group that cannot be measured here.
    pub fn skipped(&mut self, name: &str, reason: &str) {
        self.rows.push(vec![name.to_owned(), "skipped".to_owned(), String::new(), String::new(), reason.to_owned()]);
        self.report.skipped(name, reason);
    }

    /// Runs one estimator over one recording, as `plumbline-agent estimate` does.
    pub fn estimate(&self, input: &Path, estimator: &str, change: impl FnOnce(&mut EstimateArgs)) -> (Score, PathBuf) {
        let output = self.folder.path().join("estimate.csv");
        let mut args = EstimateArgs::new(input, estimator, &output);
        change(&mut args);
        (run(&args).unwrap_or_else(|e| panic!("{}: {e}", input.display())), output)
    }

    /// Errors over time of several recordings in one plot.
    pub fn trace(
        &mut self,
        stem: &str,
        caption: &str,
        label: &str,
        traces: &[(String, Vec<ErrorSample>)],
        pick: impl Fn(&ErrorSample) -> Option<f64>,
    ) -> Result<(), ReportError> {
        let mut plot = Plot::new(caption, "t, s", label);
        let mut points = 0;
        for (name, samples) in traces {
            let line: Vec<(f64, f64)> = samples.iter().filter_map(|s| Some((s.time_s, pick(s)?))).collect();
            points += line.len();
            plot = plot.with(Series::line(name, line));
        }
        if points == 0 { Ok(()) } else { self.report.figure(stem, caption, &plot) }
    }

    /// The table of everything, and the page.
    pub fn finish(mut self) -> Result<(), ReportError> {
        self.report.heading("Everything");
        let headers = ["figure", "value", "unit", "target", "verdict"];
        self.report.table("figures", "Every figure with its target.", &headers, &self.rows)?;
        self.report.value(
            "targets_missed",
            self.missed as f64,
            "figures",
            json!({ "target": 0, "met": self.missed == 0 }),
        );
        let page = self.report.finish()?;
        eprintln!("evaluate: {}", page.display());
        Ok(())
    }
}
