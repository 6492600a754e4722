//! `cargo xtask reproduce [SOURCE]`: the sources' tables beside ours.

use super::{Workspace, XtaskError, bench};

/// Which source.
#[derive(Debug, Clone, clap::Args)]
pub struct Options {
    /// `paternain`, `umasankar`, `strategies` or `clinic`; all of them without a name.
    pub source: Option<String>,
}

/// Source, what of it can be run today and by which bench, and what comes with later work.
const SOURCES: [(&str, &[&str], &str); 4] = [
    (
        "paternain",
        &["steps"],
        "VIII-A roll disturbance and VIII-C take-off are in `steps`; VIII-B yaw on strings comes with the controllers",
    ),
    ("umasankar", &[], "Tables 3 and 4 (position error against camera rate) come with the experiment runner"),
    ("strategies", &[], "LQG and H-infinity trajectories come with the controllers"),
    ("clinic", &["sse"], "decoder times are in `sse`; Table 1 in closed loop comes with secure estimation in the loop"),
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
    for (name, benches, note) in chosen {
        eprintln!("[{name}] {note}");
        for bench in *benches {
            bench::run(workspace, &bench::Options { name: Some((*bench).to_owned()) })?;
        }
    }
    Ok(())
}
