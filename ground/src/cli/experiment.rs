//! `plumbline-ground experiment run|status|stop|resume|report|compare|open`: plans of many flights, without a ground that runs
//! and beside one.

use std::io::{IsTerminal as _, Write as _};
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;
use std::time::{Duration, Instant};

use clap::Subcommand;
use plumbline_experiment::plan::Plan;
use plumbline_experiment::recordings::Library;
use plumbline_experiment::run::{Ended, Options, Progress, expected_s, run as fly};
use plumbline_experiment::store::{Experiment, write_whole};
use plumbline_experiment::{open, parquet, report, summary, trace};
use plumbline_rest::experiment::State;

use super::DataFolder;

/// How often the bar moves.
const SHOWN: Duration = Duration::from_millis(200);
/// The same where nobody watches.
const SAID: Duration = Duration::from_secs(10);

/// What to do with which experiment.
#[derive(Debug, clap::Args)]
pub struct ExperimentArguments {
    #[command(subcommand)]
    deed: Deed,
}

#[derive(Debug, Subcommand)]
enum Deed {
    /// Checks a plan, says what it comes to, and flies it; one that was begun goes on.
    Run {
        /// The plan, TOML; recordings that it names are flights of the data folder by their ids, or files.
        plan: PathBuf,
        /// Says what it comes to and flies nothing.
        #[arg(long)]
        check: bool,
        #[command(flatten)]
        flying: Flying,
        #[command(flatten)]
        data: DataFolder,
    },
    /// Says how experiments stand; one JSON line for each.
    Status {
        /// Which; all when left out.
        id: Option<String>,
        #[command(flatten)]
        data: DataFolder,
    },
    /// Ends a run after the flights that are in the air.
    Stop {
        /// Which.
        id: String,
        #[command(flatten)]
        data: DataFolder,
    },
    /// Flies what is missing.
    Resume {
        /// Which.
        id: String,
        #[command(flatten)]
        flying: Flying,
        #[command(flatten)]
        data: DataFolder,
    },
    /// Writes `report.html` and `flights.parquet` of what is there.
    Report {
        /// Which.
        id: String,
        /// Flies so many flights of each condition again, for errors over time: a part of the report, and `traces.parquet`.
        #[arg(long, value_name = "REPEATS", value_parser = clap::value_parser!(u64).range(1..))]
        traces: Option<u64>,
        /// The ground that the dots lead to.
        #[arg(long, default_value = "http://127.0.0.1:4747")]
        address: String,
        #[command(flatten)]
        data: DataFolder,
    },
    /// Writes what a second experiment differs from a first one in, condition by condition and flight by flight of the same seed:
    /// two versions of the program on the same plan, or two plans that vary the same factors.
    Compare {
        /// The first.
        first: String,
        /// The second; the page goes into its folder.
        second: String,
        /// The ground that flights lead to.
        #[arg(long, default_value = "http://127.0.0.1:4747")]
        address: String,
        #[command(flatten)]
        data: DataFolder,
    },
    #[cfg(feature = "many")]
    #[command(flatten)]
    Many(super::many::Deed),
    /// Flies one flight again and puts it among the recorded ones; a ground that runs shows it after its next start, and opens
    /// it at once from its own page.
    Open {
        /// Which experiment.
        id: String,
        /// Which flight.
        index: u64,
        #[command(flatten)]
        data: DataFolder,
    },
}

/// How it is flown.
#[derive(Debug, clap::Args)]
struct Flying {
    /// Threads; all cores when left out.
    #[arg(long, value_parser = clap::value_parser!(u16).range(1..=1024))]
    threads: Option<u16>,
}

impl Flying {
    fn options(&self) -> Options {
        let all = Options::default();
        Options { threads: self.threads.map_or(all.threads, usize::from), ..all }
    }
}

/// Does it.
///
/// # Errors
/// A sentence for people.
pub fn run(arguments: &ExperimentArguments) -> Result<(), String> {
    let root = |folder: &DataFolder| Experiment::root(&folder.data);
    let one = |folder: &DataFolder, id: &str| Experiment::open(&root(folder), id).map_err(|error| error.to_string());
    match &arguments.deed {
        Deed::Run { plan, check, flying, data } => begin(plan, *check, flying, &data.data),
        Deed::Status { id: Some(id), data } => print(&summary::state(&one(data, id)?)),
        Deed::Status { id: None, data } => {
            Experiment::all(&root(data)).iter().try_for_each(|experiment| print(&summary::state(experiment)))
        }
        Deed::Stop { id, data } => one(data, id)?.ask_to_stop().map_err(|error| error.to_string()),
        Deed::Resume { id, flying, data } => flown(&one(data, id)?, flying),
        Deed::Report { id, traces, address, data } => written(&one(data, id)?, *traces, address),
        Deed::Compare { first, second, address, data } => compared(&one(data, first)?, &one(data, second)?, address),
        #[cfg(feature = "many")]
        Deed::Many(deed) => super::many::run(deed),
        Deed::Open { id, index, data } => opened(&one(data, id)?, *index, &data.data),
    }
}

pub(super) fn print(state: &State) -> Result<(), String> {
    let line = serde_json::to_string(state).unwrap_or_default();
    writeln!(std::io::stdout(), "{line}").map_err(|error| format!("standard output: {error}"))
}

fn begin(file: &Path, check: bool, flying: &Flying, data: &Path) -> Result<(), String> {
    let text = std::fs::read_to_string(file).map_err(|error| format!("{}: {error}", file.display()))?;
    let library = Library::archive(data).with_files();
    let plan = Plan::over(&text, &library).map_err(|error| format!("{}: {error}", file.display()))?;
    let threads = flying.options().threads;
    let (conditions, flights) = (plan.conditions(), plan.flights());
    let seconds = expected_s(&plan, flights, threads)?;
    eprintln!(
        "{}: {conditions} conditions × {} repeats = {flights} flights, about {} on {threads} threads",
        plan.name,
        plan.repeats,
        duration(seconds)
    );
    if check {
        return Ok(());
    }
    let experiment = Experiment::create(&Experiment::root(data), plan).map_err(|error| error.to_string())?;
    eprintln!("experiment {}", experiment.id);
    flown(&experiment, flying)
}

/// As people say it.
fn duration(seconds: f64) -> String {
    match seconds {
        s if s < 100.0 => format!("{s:.0} s"),
        s if s < 6000.0 => format!("{:.0} min", s / 60.0),
        s => format!("{:.1} h", s / 3600.0),
    }
}

fn flown(experiment: &Experiment, flying: &Flying) -> Result<(), String> {
    let watched = std::io::stderr().is_terminal();
    let every = if watched { SHOWN } else { SAID };
    let mut said = Instant::now();
    let (mut lost, mut squares, mut kept) = (0_u64, 0.0, 0.0);
    let ended = fly(experiment, &flying.options(), &AtomicBool::new(false), |progress: &Progress, row| {
        let altitude_m = row.value("altitude_m");
        if !row.lost().is_empty() {
            lost += 1;
        } else if altitude_m.is_finite() {
            squares += altitude_m.powi(2);
            kept += 1.0;
        }
        if said.elapsed() < every && progress.done < progress.flights {
            return;
        }
        said = Instant::now();
        let Progress { done, flights, per_s, left_s } = *progress;
        let part = (30 * done / flights.max(1)) as usize;
        let bar: String = (0..30).map(|at| if at < part { '=' } else { ' ' }).collect();
        // A recording may know no altitude, or nothing that it was to be.
        let rms = if kept > 0.0 { format!("{:.1} mm rms", 1e3 * f64::sqrt(squares / kept)) } else { "unknown".into() };
        let left = duration(left_s);
        let line = format!("[{bar}] {done}/{flights}  {per_s:.2}/s  {left} left  altitude {rms}  {lost} lost");
        // A terminal that takes no more costs the line, and nothing else.
        let _ =
            if watched { write!(std::io::stderr(), "\r{line}\x1b[K") } else { writeln!(std::io::stderr(), "{line}") };
    });
    if watched {
        eprintln!();
    }
    let ended = ended.map_err(|error| error.to_string())?;
    match ended {
        Ended::Complete => eprintln!("complete"),
        Ended::Stopped => eprintln!("stopped; plumbline-ground experiment resume {} goes on", experiment.id),
        Ended::Spent => {
            eprintln!("its minutes are spent; plumbline-ground experiment resume {} goes on", experiment.id)
        }
    }
    print(&summary::state(experiment))
}

fn written(experiment: &Experiment, traces: Option<u64>, address: &str) -> Result<(), String> {
    let traced =
        traces.map(|repeats| trace::write(experiment, repeats)).transpose().map_err(|error| error.to_string())?;
    let page = report::write(experiment, address).map_err(|error| error.to_string())?;
    let table = parquet::export(experiment).map_err(|error| error.to_string())?;
    [page, table].iter().chain(&traced).for_each(|path| println!("{}", path.display()));
    Ok(())
}

fn compared(first: &Experiment, second: &Experiment, address: &str) -> Result<(), String> {
    let page = report::compare(first, second, address).map_err(|error| error.to_string())?;
    let path = second.folder.join(format!("against-{}.html", first.id));
    write_whole(&path, page.as_bytes()).map_err(|error| error.to_string())?;
    println!("{}", path.display());
    Ok(())
}

fn opened(experiment: &Experiment, index: u64, data: &Path) -> Result<(), String> {
    let file = open::open(experiment, index).map_err(|error| error.to_string())?;
    let folder = data.join("flights");
    let to = folder.join(file.file_name().unwrap_or_default());
    let moved = std::fs::create_dir_all(&folder).and_then(|()| std::fs::rename(&file, &to));
    moved.map_err(|error| format!("{}: {error}", to.display()))?;
    if let Some(emptied) = file.parent() {
        let _ = std::fs::remove_dir_all(emptied);
    }
    println!("{}", to.display());
    Ok(())
}
