//! `plumbline-agent decode`: windows from a file through the secure decoder, one JSON line per case.

use std::path::PathBuf;

use clap::ValueEnum;
use plumbline_agent::estimate::secure::Program;
use plumbline_agent::offline::decode::{self, Engine};

#[derive(Debug, clap::Args)]
pub struct DecodeArguments {
    /// JSON with `Phi` (one matrix per sensor) and `cases`, each with `Y` (one list of samples per sensor).
    #[arg(long)]
    input: PathBuf,
    /// Norm of each sensor's residual.
    #[arg(long, value_enum, default_value = "l2")]
    program: ProgramChoice,
    /// Solver.
    #[arg(long, value_enum, default_value = "newton")]
    engine: EngineChoice,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum ProgramChoice {
    /// Σ‖Yᵢ − Φᵢx‖₂.
    L2,
    /// Σ‖Yᵢ − Φᵢx‖₁.
    L1,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum EngineChoice {
    /// The specialised primal-dual Newton, as in flight.
    Newton,
    /// Clarabel on the compressed cones.
    Clarabel,
}

impl DecodeArguments {
    pub fn run(&self) -> Result<(), super::Failure> {
        let program = match self.program {
            ProgramChoice::L2 => Program::L2,
            ProgramChoice::L1 => Program::L1,
        };
        let engine = match self.engine {
            EngineChoice::Newton => Engine::Newton,
            EngineChoice::Clarabel => Engine::Clarabel,
        };
        decode::run(&self.input, program, engine, &mut std::io::stdout().lock())?;
        Ok(())
    }
}
