//! `cargo xtask reproduce [SOURCE]`: the sources' tables beside ours.

use super::{Workspace, XtaskError, bench};

/// Which source.
#[derive(Debug, Clone, clap::Args)]
pub struct Options {
    /// `paternain`, `umasankar`, `strategies` or `clinic`; all of them without a name.
    pub source: Option<String>,
    /// Fewer seeds and trials, where a program knows it.
    #[arg(long)]
    pub quick: bool,
}

/// Source, its programs, and what comes with later work.
const SOURCES: [(&str, &[&str], &str); 4] = [
    ("paternain", &["paternain"], "VIII: the three experiments; report in target/reproduce/paternain"),
    ("umasankar", &["umasankar"], "Tables 3 to 5; report in target/reproduce/umasankar"),
    (
        "strategies",
        &["strategies"],
        "LQG, H-infinity and every controller on the same flights; report in target/reproduce/strategies",
    ),
    (
        "clinic",
        &["sse", "clinic"],
        "decoder times; Figures 8 to 13, Table 1 in closed loop, four real IMUs; report in target/reproduce/clinic",
    ),
];

/// Runs what there is and names what there is not.
///
/// # Errors
/// No such source, or a bench that failed.
pub fn run(workspace: &Workspace, options: &Options) -> Result<(), XtaskError> {
    let wanted = |name: &str| options.source.as_deref().is_none_or(|source| source == name);
    let chosen: Vec<_> = SOURCES.iter().filter(|(name, ..)| wanted(name)).collect();
    if chosen.is_empty() {
        let source = options.source.as_deref().unwrap_or_default();
        let names = SOURCES.map(|(name, ..)| name).join(", ");
        return Err(XtaskError::Other(format!("no source is called `{source}`; there are: {names}")));
    }
    let arguments: &[&str] = if options.quick { &["--quick"] } else { &[] };
    for (name, programs, note) in chosen {
        eprintln!("[{name}] {note}");
        for program in *programs {
            bench::program(workspace, program, arguments)?;
        }
    }
    Ok(())
}
