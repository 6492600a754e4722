//! `plumbline-agent care` and `dare`: Riccati equations from a file, one JSON line per case.

use std::io::Write;
use std::path::PathBuf;

use plumbline_agent::design::{Equation, solve_cases};

use super::{Failure, in_file, read};

#[derive(Debug, clap::Args)]
pub struct RiccatiArguments {
    /// JSON: one case, a list of cases or `{"cases": [...]}`, each with A, B, Q and R as lists of rows.
    #[arg(long)]
    input: PathBuf,
}

impl RiccatiArguments {
    pub fn run(&self, equation: Equation) -> Result<(), Failure> {
        let text = read(&self.input)?;
        let mut out = std::io::stdout().lock();
        let mut written = Ok(());
        solve_cases(equation, &text, |line| {
            if written.is_ok() {
                written = writeln!(out, "{line}");
            }
        })
        .map_err(|e| in_file(&self.input, e))?;
        Ok(written?)
    }
}
