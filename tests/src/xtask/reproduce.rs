//! `cargo xtask reproduce [SOURCE]`: the sources' tables beside ours.

use super::{Workspace, XtaskError, bench, campaign};

/// Which source.
#[derive(Debug, Clone, clap::Args)]
pub struct Options {
    /// `paternain`, `umasankar`, `strategies` or `clinic`; all of them without a name.
    pub source: Option<String>,
    /// Fewer seeds and trials, where a program knows it.
    #[arg(long)]
    pub quick: bool,
}

/// Source, also the name of its campaign; the bench that goes with it; what they show.
const SOURCES: [(&str, Option<&str>, &str); 4] = [
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
    let arguments: &[&str] = if options.quick { &["--quick"] } else { &[] };
    for (name, bench, note) in chosen {
        eprintln!("[{name}] {note}");
        if let Some(bench) = bench {
            bench::program(workspace, bench)?;
        }
        campaign::run(workspace, &campaign::Run { name, dev: false, arguments, settings: &[] })?;
    }
    Ok(())
}
