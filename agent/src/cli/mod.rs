//! The command line: flying is what happens without a subcommand; tools are subcommands, one file each.

mod calibrate;
mod decode;
mod design;
mod devices;
mod envelope;
mod estimate;
mod fly;
mod identity;
mod motors;
mod observability;
mod riccati;

use std::fmt::Display;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};

use clap::{Parser, Subcommand, ValueEnum};
use plumbline_agent::design::Equation;
use plumbline_agent::offline::EstimateArgs;

/// What ends the program, for people.
type Failure = Box<dyn std::error::Error>;

/// The onboard agent: sensors, estimation, control, attacks, log and link.
#[derive(Debug, Parser)]
#[command(version, args_conflicts_with_subcommands = true)]
pub struct Arguments {
    #[command(subcommand)]
    tool: Option<Tool>,
    #[command(flatten)]
    fly: FlyArguments,
}

#[derive(Debug, Subcommand)]
enum Tool {
    /// Shows this agent's fingerprint; pairs it with a ground.
    Identity(identity::IdentityArguments),
    /// Pairs this agent with a ground by a short code.
    Pair(identity::PairArguments),
    /// Runs an estimator over a recording: estimates as CSV, errors against the truth as one JSON line.
    Estimate(EstimateArgs),
    /// Fits a calibration to a recording or a table: JSON file, and its summary as one JSON line.
    Calibrate(calibrate::CalibrateArguments),
    /// Designs a controller: weights in, certified gains out.
    Design(design::DesignArguments),
    /// Solves continuous-time Riccati equations, one JSON line per case.
    Care(riccati::RiccatiArguments),
    /// Solves discrete-time Riccati equations, one JSON line per case.
    Dare(riccati::RiccatiArguments),
    /// Decodes windows of attacked samples, one JSON line per case.
    Decode(decode::DecodeArguments),
    /// What a sensor suite can promise: rank, sparse observability, correctable attacks, binding state (JSON).
    Observability(observability::ObservabilityArguments),
    /// How far an attacker who is not seen can push the vehicle, for every set of sensors.
    Envelope(envelope::EnvelopeArguments),
    /// Lists ports and what answers on them; `devices test NAME` shows what a device says.
    Devices(devices::DevicesArguments),
    /// Turns one motor at low throttle, on the bench; or stops all of them.
    Motors(motors::MotorsArguments),
    /// Holds the motors of an agent that flies, and stops them when it is gone.
    #[command(hide = true)]
    MotorGuard(motors::GuardArguments),
}

/// What can be flown.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum VehicleChoice {
    /// The simulator.
    Sim,
    /// A recording: our own flight file, BROAD, Phantom 4, RotorPy or PX4 ULog.
    Replay,
    /// The quadrotor.
    Hardware,
    /// The quadrotor behind a PX4 autopilot: by body rates and thrust, or by a pose and where to be.
    Mavlink,
    /// The simulator, flown by a stock PX4 (SITL): its MAVLink interface for simulators, lockstep over TCP.
    Px4,
    /// The simulator, flown by a stock ArduPilot (SITL): its JSON interface over UDP.
    Ardupilot,
}

/// How to fly.
#[derive(Debug, clap::Args)]
struct FlyArguments {
    /// Configuration file (TOML).
    #[arg(long)]
    config: Option<PathBuf>,
    /// What to fly.
    #[arg(long, value_enum, default_value = "sim")]
    vehicle: VehicleChoice,
    /// The recording to replay.
    file: Option<PathBuf>,
    /// Scenario of the simulator; altitude steps on the string rig when left out.
    #[arg(long)]
    scenario: Option<PathBuf>,
    /// `host:port` of the ground; `none` flies without one.
    #[arg(long)]
    ground: Option<String>,
    /// Name of this agent.
    #[arg(long)]
    id: Option<String>,
    /// Folder of the link identity.
    #[arg(long)]
    identity: Option<PathBuf>,
    /// Folder of the onboard log.
    #[arg(long)]
    log: Option<PathBuf>,
    /// Times real time; 0 begins standing still (replay), `max` is as fast as possible.
    #[arg(long, default_value = "1")]
    speed: String,
    /// Attacks to run: a TOML file of `[[attack]]` tables, onsets counted from the first heartbeat.
    #[arg(long)]
    attack_schedule: Option<PathBuf>,
    /// Estimator in the loop.
    #[arg(long)]
    estimator: Option<String>,
    /// Program that the secure estimator solves: l2, l1, l2_split or l1_split.
    #[arg(long)]
    decoder: Option<String>,
    /// Fly the scenario's own script and end with it; where an autopilot flies, only end with it.
    #[arg(long)]
    script: bool,
    /// Where a stock autopilot finds the simulator; 127.0.0.1:4560 (PX4) or 127.0.0.1:9002 (ArduPilot) when left out.
    #[arg(long)]
    listen: Option<SocketAddr>,
    /// Longest wait for an answer of a stock autopilot in lockstep, s.
    #[arg(long, default_value_t = 10.0)]
    answer_s: f64,
}

impl Arguments {
    /// Does what is asked.
    pub fn run(self) -> Result<(), Failure> {
        match self.tool {
            Some(Tool::Identity(arguments)) => arguments.run(),
            Some(Tool::Pair(arguments)) => arguments.run(),
            Some(Tool::Estimate(arguments)) => estimate::estimate(&arguments),
            Some(Tool::Calibrate(arguments)) => arguments.run(),
            Some(Tool::Design(arguments)) => arguments.run(),
            Some(Tool::Care(arguments)) => arguments.run(Equation::Care),
            Some(Tool::Dare(arguments)) => arguments.run(Equation::Dare),
            Some(Tool::Decode(arguments)) => arguments.run(),
            Some(Tool::Observability(arguments)) => arguments.run(),
            Some(Tool::Envelope(arguments)) => arguments.run(),
            Some(Tool::Devices(arguments)) => arguments.run(),
            Some(Tool::Motors(arguments)) => arguments.run(),
            Some(Tool::MotorGuard(arguments)) => arguments.run(),
            None => fly::fly(&self.fly),
        }
    }
}

/// What is wrong with a file, its name in front.
fn in_file(path: &Path, error: impl Display) -> Failure {
    format!("{}: {error}", path.display()).into()
}

/// The text of a file.
fn read(path: &Path) -> Result<String, Failure> {
    std::fs::read_to_string(path).map_err(|error| in_file(path, error))
}
