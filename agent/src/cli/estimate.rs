//! `plumbline-agent estimate`: any estimator over a recording; its score is the line on stdout.

use plumbline_agent::offline::{EstimateArgs, run};

pub fn estimate(arguments: &EstimateArgs) -> Result<(), Box<dyn std::error::Error>> {
    let score = run(arguments)?;
    println!("{}", score.to_json());
    Ok(())
}
