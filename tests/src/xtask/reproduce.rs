//! `cargo xtask reproduce [SOURCE]`: the sources' tables beside ours.

use super::{Workspace, XtaskError, bench, campaign};

/// Which source.
#[derive(Debug, Clone, Default, clap::Args)]
pub struct Options {
    /// `paternain`, `umasankar`, `strategies`, `clinic`, or one of our own: `envelope`, `rotors`, `attacks`; all without a name.
    pub source: Option<String>,
    /// Fewer seeds and trials.
    #[arg(long)]
    pub quick: bool,
    /// First seed of whatever is drawn: anyone flies fresh flights.
    #[arg(long)]
    pub seed_base: Option<u64>,
    /// Flights of each row.
    #[arg(long)]
    pub flights: Option<u64>,
    /// World of the flights of `clinic`: `ideal`, `bench`, `datasheet`, `harsh`.
    #[arg(long, requires = "source")]
    pub world: Option<String>,
    /// One part of `paternain`, `clinic`, `envelope` or `rotors`, or one row of `attacks`.
    #[arg(long, requires = "source")]
    pub only: Option<String>,
}

impl Options {
    /// Of the campaigns: what one of them does not know, it refuses.
    fn arguments(&self) -> Vec<String> {
        let numbers = [("--seed-base", self.seed_base), ("--flights", self.flights)];
        let mut arguments: Vec<String> = self.quick.then(|| "--quick".into()).into_iter().collect();
        for (name, value) in numbers {
            arguments.extend(value.into_iter().flat_map(|value| [name.to_owned(), value.to_string()]));
        }
        arguments.extend(self.world.iter().flat_map(|world| ["--world".to_owned(), world.clone()]));
        arguments.extend(self.only.iter().flat_map(|only| ["--only".to_owned(), only.clone()]));
        arguments
    }
}

/// Source, also the name of its campaign; the bench that goes with it; what they show.
const SOURCES: [(&str, Option<&str>, &str); 7] = [
    ("paternain", None, "VIII: the three experiments; report in target/reproduce/paternain"),
    ("umasankar", None, "Tables 3 to 5; report in target/reproduce/umasankar"),
    (
        "strategies",
        None,
        "LQG, H-infinity and every controller on the same flights; report in target/reproduce/strategies",
    ),
    (
        "clinic",
        Some("sse"),
        "decoder times; Figures 8 to 13, Table 1 in closed loop, four real IMUs; report in target/reproduce/clinic",
    ),
    ("envelope", None, "the attack envelope flown, worst and drawn attacks; report in target/reproduce/envelope"),
    ("rotors", None, "rotors that lose thrust: isolation, altitude, the end; report in target/reproduce/rotors"),
    ("attacks", None, "drawn attacks in the worlds of data sheets and rigs; report in target/reproduce/attacks"),
];

/// Runs what there is and names what there is not.
///
/// # Errors
/// No such source, or a bench or campaign that failed.
pub fn run(workspace: &Workspace, options: &Options) -> Result<(), XtaskError> {
    let wanted = |name: &str| options.source.as_deref().is_none_or(|source| source == name);
    let chosen: Vec<_> = SOURCES.iter().filter(|(name, ..)| wanted(name)).collect();
    if chosen.is_empty() {
        let source = options.source.as_deref().unwrap_or_default();
        let names = SOURCES.map(|(name, ..)| name).join(", ");
        return Err(XtaskError::Other(format!("no source is called `{source}`; there are: {names}")));
    }
    let arguments = options.arguments();
    let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
    for (name, bench, note) in chosen {
        eprintln!("[{name}] {note}");
        if let Some(bench) = bench {
            bench::program(workspace, bench)?;
        }
        campaign::run(workspace, &campaign::Run { name, dev: false, arguments: &arguments, settings: &[] })?;
    }
    Ok(())
}
