//! `plumbline-ground export FILE…`: flights as tables and bags, without a running ground.

use std::io::Write as _;
use std::path::{Path, PathBuf};

use clap::builder::{PossibleValuesParser, TypedValueParser as _};
use plumbline_ground::recorder::{Export, Format, RecordingError, Selection, Snapshot};

/// Flight files to read, and what becomes of them.
#[derive(Debug, clap::Args)]
pub struct ExportArguments {
    /// Flight files, finished or as a crash left them; of a folder every one in it.
    #[arg(required = true)]
    files: Vec<PathBuf>,
    /// What to write.
    #[arg(long, default_value = "csv", value_parser = PossibleValuesParser::new(Format::ALL.map(Format::name)).map(format))]
    format: Format,
    /// Folder to write to, one file for each flight [default: beside it].
    #[arg(long, value_name = "DIR")]
    output: Option<PathBuf>,
    /// From there on, s since the start of the flight.
    #[arg(long, default_value_t = 0.0)]
    from_s: f64,
    /// Until there, s.
    #[arg(long, default_value_t = f64::INFINITY)]
    to_s: f64,
    /// Names of columns with commas between them, or their beginnings up to a dot [default: all but residuals_N].
    #[arg(long, value_delimiter = ',')]
    columns: Vec<String>,
    /// At most so many rows a second; 0 for every control tick.
    #[arg(long, default_value_t = 100.0)]
    rate_hz: f64,
    /// Every message of one topic instead of the table (CSV).
    #[arg(long, conflicts_with_all = ["from_s", "to_s", "columns", "rate_hz"])]
    topic: Option<String>,
}

/// Of a name that is one of theirs.
fn format(name: String) -> Format {
    Format::ALL.into_iter().find(|format| format.name() == name).unwrap_or(Format::Csv)
}

/// Writes every table.
///
/// # Errors
/// What could not be written; the others are.
pub fn run(arguments: &ExportArguments) -> Result<(), String> {
    if arguments.topic.is_some() && arguments.format != Format::Csv {
        return Err(format!("--format {}: --topic is for csv alone", arguments.format.name()));
    }
    let mut files = Vec::new();
    for path in &arguments.files {
        if !path.is_dir() {
            files.push(path.clone());
            continue;
        }
        let read = std::fs::read_dir(path).map_err(|error| format!("{}: {error}", path.display()))?;
        let inside = read.flatten().map(|entry| entry.path());
        files.extend(inside.filter(|path| path.extension().is_some_and(|ending| ending == "mcap") && !exported(path)));
    }
    files.sort();
    if files.is_empty() {
        return Err("no flight file was found".into());
    }
    let mut failed = 0;
    for path in &files {
        match export(path, arguments) {
            Ok(target) => println!("{}", target.display()),
            Err(text) => {
                failed += 1;
                eprintln!("plumbline-ground: {text}");
            }
        }
    }
    if failed == 0 { Ok(()) } else { Err(format!("{failed} of {} flights were not exported", files.len())) }
}

/// Is it what an export has written beside its flight?
fn exported(path: &Path) -> bool {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    Format::ALL.iter().any(|format| name.ends_with(&format!(".{}", format.ending())))
}

fn export(path: &Path, arguments: &ExportArguments) -> Result<PathBuf, String> {
    let named = |error: RecordingError| match error {
        RecordingError::Damaged { reason, .. } => format!("{}: {reason}", path.display()),
        other => format!("{}: {other}", path.display()),
    };
    let flight = Snapshot::of(path).map_err(named)?;
    let ExportArguments { from_s, to_s, columns, rate_hz, .. } = arguments;
    let export = match &arguments.topic {
        Some(topic) => Export::topic(flight, topic),
        None => {
            let selection = Selection { from_s: *from_s, to_s: *to_s, columns: columns.clone(), rate_hz: *rate_hz };
            Export::wide(flight, selection, arguments.format)
        }
    };
    let export = export.map_err(named)?;
    let name = Path::new(path.file_name().unwrap_or_default()).with_extension(arguments.format.ending());
    let folder = arguments.output.as_deref().or(path.parent()).unwrap_or(Path::new("."));
    let target = folder.join(name);
    let failed = |error: std::io::Error| format!("{}: {error}", target.display());
    std::fs::create_dir_all(folder).map_err(failed)?;
    // A table that broke off does not look like a whole one.
    let unfinished = target.with_extension("unfinished");
    let mut file = std::fs::File::create(&unfinished).map_err(failed)?;
    let mut trouble = None;
    let written = export.write(&mut |piece| file.write_all(&piece).map_err(|error| trouble = Some(error)).is_ok());
    let outcome = match (trouble, written) {
        (Some(error), _) => Err(failed(error)),
        (None, Err(error)) => Err(named(error)),
        (None, Ok(())) => file.sync_all().and_then(|()| std::fs::rename(&unfinished, &target)).map_err(failed),
    };
    if outcome.is_err() {
        // It is of no use; that it could not be removed is the lesser trouble.
        let _ = std::fs::remove_file(&unfinished);
    }
    outcome.map(|()| target)
}
