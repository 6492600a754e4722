//! `plumbline-agent estimate`: any estimator over a recording; its score is the line on stdout.

use std::io::Write as _;

use plumbline_agent::offline::{EstimateArgs, run};

pub fn estimate(arguments: &EstimateArgs) -> Result<(), super::Failure> {
    let score = run(arguments)?;
    Ok(writeln!(std::io::stdout(), "{}", score.to_json())?)
}
