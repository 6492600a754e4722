//! Figures in Prometheus' text format 0.0.4.

use std::fmt::Write as _;

/// Media type of the format.
pub const MEDIA: &str = "text/plain; version=0.0.4; charset=utf-8";

/// Families of figures, each told once with its samples below it.
#[derive(Debug, Default)]
pub struct Metrics(String);

/// What a figure does over time.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Type {
    /// Goes up and down.
    Gauge,
    /// Only goes up, until a restart.
    Counter,
}

impl Metrics {
    /// A family without labels.
    pub fn one(&mut self, kind: Type, name: &str, help: &str, value: f64) {
        self.family(kind, name, help, [("", "", value)]);
    }

    /// A family with one label: label, its value, figure.
    pub fn family<'a>(
        &mut self,
        kind: Type,
        name: &str,
        help: &str,
        samples: impl IntoIterator<Item = (&'a str, &'a str, f64)>,
    ) {
        let mut samples = samples.into_iter().peekable();
        if samples.peek().is_none() {
            return;
        }
        let kind = if kind == Type::Counter { "counter" } else { "gauge" };
        // Writing to a string does not fail.
        let _ = write!(self.0, "# HELP plumbline_{name} {help}\n# TYPE plumbline_{name} {kind}\n");
        for (label, of, value) in samples {
            let _ = if label.is_empty() {
                writeln!(self.0, "plumbline_{name} {value}")
            } else {
                let of = of.replace('\\', "\\\\").replace('"', "\\\"").replace('\n', "\\n");
                writeln!(self.0, "plumbline_{name}{{{label}=\"{of}\"}} {value}")
            };
        }
    }

    /// The text.
    pub fn text(self) -> String {
        self.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn families_are_told_once_and_labels_are_escaped() {
        let mut metrics = Metrics::default();
        metrics.one(Type::Gauge, "disk_free_bytes", "Free.", 1e12);
        metrics.family(
            Type::Counter,
            "received_total",
            "Messages.",
            [("vehicle", "a\"\\\nb", 2.0), ("vehicle", "c", 3.5)],
        );
        metrics.family(Type::Gauge, "nothing", "None.", []);
        let expected = "# HELP plumbline_disk_free_bytes Free.\n# TYPE plumbline_disk_free_bytes gauge\n\
                        plumbline_disk_free_bytes 1000000000000\n\
                        # HELP plumbline_received_total Messages.\n# TYPE plumbline_received_total counter\n\
                        plumbline_received_total{vehicle=\"a\\\"\\\\\\nb\"} 2\nplumbline_received_total{vehicle=\"c\"} 3.5\n";
        assert_eq!(metrics.text(), expected);
    }
}
