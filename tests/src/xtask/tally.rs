//! How many checks passed and failed, and the closing line that says so whatever happens.

use std::io::Write;

/// Counts; prints the closing line when dropped, so that a panic half-way still ends with it.
#[derive(Debug, Default)]
pub struct Tally {
    passed: u64,
    failed: u64,
    skipped: u64,
    /// What failed, and why.
    failures: Vec<(String, String)>,
    silent: bool,
}

impl Tally {
    /// One without a closing line, where checks are not the point.
    pub fn silent() -> Self {
        Self { passed: 0, failed: 0, skipped: 0, failures: Vec::new(), silent: true }
    }

    /// Several at once, of what `name` ran.
    pub fn add(&mut self, name: &str, passed: u64, failed: u64) {
        self.passed += passed;
        self.failed += failed;
        if failed > 0 {
            self.failures.push((name.to_owned(), format!("{failed} failed")));
        }
    }

    /// All that `other` counted, which says nothing of its own any more.
    pub fn take_over(&mut self, other: &mut Self) {
        self.passed += std::mem::take(&mut other.passed);
        self.failed += std::mem::take(&mut other.failed);
        self.skipped += std::mem::take(&mut other.skipped);
        self.failures.append(&mut other.failures);
    }

    /// Tests that were left out, and those that passed without having what they compare with: their names are told.
    pub fn skip(&mut self, ignored: u64, tests: &std::collections::BTreeSet<String>) {
        let skipped = (tests.len() as u64).min(self.passed);
        self.passed -= skipped;
        self.skipped += skipped + ignored;
        tests.iter().for_each(|test| eprintln!("xtask: skipped: {test}"));
    }

    /// One check that either worked or tells why not.
    pub fn check<T, E: std::fmt::Display>(&mut self, name: &str, outcome: Result<T, E>) -> Option<T> {
        match outcome {
            Ok(value) => {
                self.passed += 1;
                eprintln!("xtask: {name}: passed");
                Some(value)
            }
            Err(error) => {
                self.failed += 1;
                eprintln!("xtask: {name}: FAILED: {error}");
                self.failures.push((name.to_owned(), error.to_string()));
                None
            }
        }
    }

    /// What failed first.
    pub fn first_failed(&self) -> Option<&str> {
        self.failures.first().map(|(name, _)| name.as_str())
    }

    /// Did nothing fail, and something pass?
    pub fn good(&self) -> bool {
        self.failed == 0 && self.passed > 0
    }

    /// `N passed, N failed`, and `N skipped` where some were.
    pub fn closing_line(&self) -> String {
        let skipped = if self.skipped > 0 { format!(", {} skipped", self.skipped) } else { String::new() };
        format!("{} passed, {} failed{skipped}", self.passed, self.failed)
    }
}

impl Drop for Tally {
    fn drop(&mut self) {
        if std::thread::panicking() {
            self.failed += 1;
            self.failures.push(("xtask".into(), "it panicked itself".into()));
        }
        if !self.failures.is_empty() {
            eprintln!("\nfailed:");
            for (name, error) in &self.failures {
                eprintln!("  {name}: {}", error.replace('\n', "\n    "));
            }
        }
        if self.silent {
            return;
        }
        let mut out = std::io::stdout().lock();
        let _ = writeln!(out, "\n{}", self.closing_line());
        let _ = out.flush();
    }
}

/// Reads what `cargo test` prints, target by target.
#[derive(Debug, Default)]
pub struct CargoTestOutput {
    announced: u64,
    /// Tests that passed.
    pub passed: u64,
    /// Tests that failed, or were announced and never told of: their program died.
    pub failed: u64,
    /// Tests left out on purpose.
    pub ignored: u64,
}

impl CargoTestOutput {
    /// The next line.
    pub fn line(&mut self, line: &str) {
        let line = line.trim();
        let number = |text: &str, after: &str| {
            text.split([';', '.']).map(str::trim).find_map(|part| part.strip_suffix(after)?.trim().parse::<u64>().ok())
        };
        if let Some(count) =
            line.strip_prefix("running ").and_then(|rest| number(rest, " tests").or(number(rest, " test")))
        {
            self.died();
            self.announced = count;
        } else if let Some(result) = line.strip_prefix("test result:") {
            self.passed += number(result, " passed").unwrap_or(0);
            self.failed += number(result, " failed").unwrap_or(0);
            self.ignored += number(result, " ignored").unwrap_or(0);
            self.announced = 0;
        }
    }

    /// The end: `success` is cargo's own verdict.
    pub fn finish(&mut self, success: bool) {
        self.died();
        // Cargo says no and no test did: a build error, or a target without the usual report.
        if !success && self.failed == 0 {
            self.failed = 1;
        }
    }

    fn died(&mut self) {
        self.failed += std::mem::take(&mut self.announced);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str, success: bool) -> (u64, u64, u64) {
        let mut output = CargoTestOutput::default();
        text.lines().for_each(|line| output.line(line));
        output.finish(success);
        (output.passed, output.failed, output.ignored)
    }

    #[test]
    fn results_of_all_targets_are_added() {
        let text = "running 3 tests\ntest a ... ok\n\
            test result: ok. 2 passed; 0 failed; 1 ignored; 0 measured; 0 filtered out; finished in 0.00s\n\
            running 1 test\ntest b ... FAILED\n\
            test result: FAILED. 0 passed; 1 failed; 0 ignored; 0 measured; 0 filtered out; finished in 0.01s\n";
        assert_eq!(read(text, false), (2, 1, 1));
    }

    #[test]
    fn a_target_that_dies_counts_all_its_tests_as_failed() {
        let text = "running 4 tests\ntest a ... ok\nrunning 1 test\n\
            test result: ok. 1 passed; 0 failed; 0 ignored; 0 measured; 0 filtered out; finished in 0.00s\n";
        assert_eq!(read(text, false), (1, 4, 0));
        assert_eq!(read("running 2 tests\n", false), (0, 2, 0));
    }

    #[test]
    fn a_build_error_is_a_failure() {
        assert_eq!(read("", false), (0, 1, 0));
        assert_eq!(read("", true), (0, 0, 0));
    }

    #[test]
    fn the_closing_line_reads_as_promised() {
        // Silent: a closing line in the middle of the tests' output would be one too many.
        let mut tally = Tally::silent();
        tally.add("unit", 3, 0);
        assert_eq!((tally.closing_line().as_str(), tally.good()), ("3 passed, 0 failed", true));
        assert!(tally.check("format", Err::<(), _>("differs")).is_none());
        assert_eq!(tally.first_failed(), Some("format"));
        assert_eq!((tally.closing_line().as_str(), tally.good()), ("3 passed, 1 failed", false));
        tally.skip(0, &["a".to_owned(), "b".to_owned()].into());
        assert_eq!(tally.closing_line(), "1 passed, 1 failed, 2 skipped");
    }
}
