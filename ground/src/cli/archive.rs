//! `plumbline-ground archive`: flights in a backup folder, verified by their hashes.

use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

use clap::Subcommand;
use plumbline_ground::audit::{Audit, Deed};
use plumbline_ground::recorder::archive::{self, Outcome, SUMS};

use super::DataFolder;

/// Copies flights to a backup folder, checks it, and puts them back.
#[derive(Debug, clap::Args)]
pub struct ArchiveArguments {
    #[command(subcommand)]
    work: Work,
}

#[derive(Debug, Subcommand)]
enum Work {
    /// Copies every finished flight that the backup does not hold yet; the ground may run.
    Backup {
        /// The backup: a folder, made where there is none.
        folder: PathBuf,
        /// Only these flights.
        ids: Vec<String>,
        #[command(flatten)]
        data: DataFolder,
    },
    /// Reads a backup, or an unpacked tar of flights, and says what is not as it was.
    Check {
        /// The backup.
        folder: PathBuf,
    },
    /// Puts flights back that the data folder does not have; no ground may run there.
    Restore {
        /// The backup, or an unpacked tar of flights.
        folder: PathBuf,
        /// Only these flights.
        ids: Vec<String>,
        #[command(flatten)]
        data: DataFolder,
    },
}

/// Prints what was done, one line for each file.
///
/// # Errors
/// What could not be done, with the file.
pub fn run(arguments: &ArchiveArguments) -> Result<(), String> {
    match &arguments.work {
        Work::Backup { folder, ids, data } => {
            let outcome = archive::back_up(&data.data, folder, ids).map_err(|error| error.to_string())?;
            tell(&outcome, "copied", folder);
            Ok(())
        }
        Work::Check { folder } => {
            let (whole, wrong) = archive::check(folder).map_err(|error| error.to_string())?;
            wrong.iter().for_each(|text| eprintln!("plumbline-ground: {text}"));
            println!("{whole} files of {} are as they were", folder.join(SUMS).display());
            if wrong.is_empty() { Ok(()) } else { Err(format!("{} are not", wrong.len())) }
        }
        Work::Restore { folder, ids, data } => {
            let outcome = archive::restore(folder, &data.data, ids).map_err(|error| error.to_string())?;
            tell(&outcome, "put back", folder);
            write_down(&outcome, &data.data, folder)
        }
    }
}

fn tell(outcome: &Outcome, done: &str, folder: &Path) {
    outcome.copied.iter().for_each(|name| println!("{done}: {name}"));
    outcome.left.iter().for_each(|(name, why)| println!("left: {name}: {why}"));
    let (copied, same) = (outcome.copied.len(), outcome.same);
    println!("{}: {copied} {done}, {same} the same, {} left", folder.display(), outcome.left.len());
}

/// What was put back stands in the audit log, as what was deleted does.
fn write_down(outcome: &Outcome, data: &Path, folder: &Path) -> Result<(), String> {
    let audit = Audit::open(data).map_err(|error| format!("audit log: {error}"))?;
    let unix_us = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default().as_micros();
    for name in &outcome.copied {
        audit.record(Deed {
            unix_us: u64::try_from(unix_us).unwrap_or(u64::MAX),
            who: "command line".into(),
            role: "ground",
            from: String::new(),
            method: "RESTORE".into(),
            path: format!("flights/{name}"),
            body: folder.display().to_string(),
            status: 201,
            times: 1,
        });
    }
    audit.flush();
    Ok(())
}
