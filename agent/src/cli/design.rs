//! `plumbline-agent design`: weights in, certified gains out.

use std::path::{Path, PathBuf};

use plumbline_agent::control::gains::Examiner;
use plumbline_agent::control::policy::MarginPolicy;
use plumbline_agent::design::file::{self, controller, export_certified, proposal};
use plumbline_agent::model::airframe::Airframe;
use plumbline_agent::offline::ArgumentError;
use plumbline_agent::types::TICK_RATE_HZ;
use plumbline_proto::ids::GainsRevision;
use plumbline_rest::design::Design;

use super::{Failure, in_file, read};

/// Solves, examines and writes gains. Files are JSON:
///
/// --weights: a design, `{"state_weight": [16], "input_weight": [4], "parameters": {"name": number}}`; weights in
/// the order x y z vx vy vz roll pitch yaw p q r, integrals of x y z yaw, and thrust, torque x y z, each
/// 1/(largest deviation)². What is left out takes its default. Gains written by this command are read as well.
///
/// --output: the same with K, units and a certificate (slowest pole, margins, policy, hash); it can be pushed as it is.
#[derive(Debug, clap::Args)]
#[command(verbatim_doc_comment)]
pub struct DesignArguments {
    /// Airframe: a TOML file, or iris, paternain or clinic.
    #[arg(long)]
    airframe: String,
    /// lqr, lqi (lqr_integral), lqg, hinf or pid.
    #[arg(long)]
    controller: String,
    /// Weights and parameters (JSON); defaults without it.
    #[arg(long)]
    weights: Option<PathBuf>,
    /// Where the gains go (JSON).
    #[arg(long)]
    output: PathBuf,
    /// Ticks they are for, Hz.
    #[arg(long, default_value_t = 200.0)]
    tick_rate_hz: f64,
    /// What the loop must forgive: standard, careful or experimental.
    #[arg(long, default_value = "standard")]
    policy: String,
}

impl DesignArguments {
    pub fn run(&self) -> Result<(), Failure> {
        let airframe = self.airframe()?;
        let kind = controller(&self.controller)?;
        let mut file = match &self.weights {
            Some(path) => file::read(read(path)?.as_bytes()).map_err(|e| in_file(path, e))?,
            None => Design::default(),
        };
        if let Some(named) = &file.controller
            && controller(named)? != kind
        {
            let reason = format!("the weights are for controller {named:?}");
            return Err(ArgumentError::new("controller", &self.controller, reason).into());
        }
        file.controller = Some(self.controller.clone());
        if !TICK_RATE_HZ.contains(&self.tick_rate_hz) {
            return Err(ArgumentError::new("tick-rate-hz", self.tick_rate_hz, "not 50 to 1000").into());
        }
        let policy = MarginPolicy::by_name(&self.policy)
            .ok_or_else(|| ArgumentError::new("policy", &self.policy, "not standard, careful or experimental"))?;
        let examiner = Examiner::new(&airframe, 1.0 / self.tick_rate_hz, policy)?;
        let gains = examiner.certify(&proposal(&file)?.complete(&airframe)?, GainsRevision(0))?;
        let out = export_certified(&gains, &airframe.name, self.tick_rate_hz);
        let text = serde_json::to_string_pretty(&out)? + "\n";
        std::fs::write(&self.output, text).map_err(|e| in_file(&self.output, e))
    }

    fn airframe(&self) -> Result<Airframe, Failure> {
        if Airframe::NAMES.contains(&self.airframe.as_str()) {
            return Ok(Airframe::by_name(&self.airframe)?);
        }
        let path = Path::new(&self.airframe);
        Airframe::from_toml(&read(path)?).map_err(|e| in_file(path, e))
    }
}
