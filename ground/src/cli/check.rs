//! `plumbline-ground check FILE…`: is a flight file whole?

use std::path::PathBuf;

use plumbline_ground::recorder;

/// Files to read; nothing is changed.
#[derive(Debug, clap::Args)]
pub struct CheckArguments {
    /// Flight files, finished or not.
    #[arg(required = true)]
    files: Vec<PathBuf>,
}

/// Prints one JSON line for each file.
///
/// # Errors
/// How many files are not whole.
pub fn run(arguments: &CheckArguments) -> Result<(), String> {
    let mut broken = 0;
    for path in &arguments.files {
        let file = path.display().to_string();
        let line = match recorder::inspect(path) {
            Ok(found) => {
                broken += u32::from(found.damage.is_some());
                serde_json::json!({ "file": file, "whole": found.damage.is_none(), "flight_id": found.flight_id,
                    "messages": found.messages, "damage": found.damage })
            }
            Err(error) => {
                broken += 1;
                serde_json::json!({ "file": file, "whole": false, "damage": error.to_string() })
            }
        };
        println!("{line}");
    }
    if broken == 0 { Ok(()) } else { Err(format!("{broken} of {} files are not whole", arguments.files.len())) }
}
