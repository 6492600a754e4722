//! `plumbline-ground audit`: does the audit log hang together?

use plumbline_ground::audit;

use super::DataFolder;

/// Walks along the hashes of the audit log.
#[derive(Debug, clap::Args)]
pub struct AuditArguments {
    #[command(flatten)]
    data: DataFolder,
}

/// Prints one JSON line.
///
/// # Errors
/// The first line that does not follow from the one before, or a file that cannot be read.
pub fn run(arguments: &AuditArguments) -> Result<(), String> {
    let found = audit::verify(&arguments.data.data).map_err(|error| format!("audit log: {error}"))?;
    let line = serde_json::json!({ "lines": found.chained, "unchained": found.unchained, "torn": found.torn,
        "last": found.last, "whole": found.broken.is_none() });
    println!("{line}");
    match found.broken {
        None => Ok(()),
        Some((file, line)) => Err(format!("{file}, line {line}: it, or one before it, was changed or taken out")),
    }
}
