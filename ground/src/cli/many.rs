//! `plumbline-ground worker`, `plumbline-ground experiment spread|part|gather`: experiments on many machines.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use clap::Subcommand;
use futures_util::StreamExt as _;
use plumbline_experiment::expectation;
use plumbline_experiment::part::Part;
use plumbline_experiment::plan::Plan;
use plumbline_experiment::run::{Ended, Options};
use plumbline_experiment::store::Experiment;
use plumbline_experiment::summary;
use plumbline_ground::many::{ManyError, Shards, lead, worker};

use super::DataFolder;

/// A flight with every estimator is large before it is on the heap.
const STACK_BYTES: usize = 32 << 20;

/// Where shards lie.
#[derive(Debug, clap::Args)]
pub(super) struct Storage {
    /// A folder that all machines see, or s3://BUCKET/PREFIX with AWS_ACCESS_KEY_ID, AWS_SECRET_ACCESS_KEY, AWS_REGION,
    /// AWS_ENDPOINT and AWS_ALLOW_HTTP from the environment.
    #[arg(long, value_name = "DIR|URL")]
    store: String,
}

/// Takes jobs.
#[derive(Debug, clap::Args)]
pub struct WorkerArguments {
    /// The NATS server with JetStream.
    #[arg(long, value_name = "URL")]
    nats: String,
    #[command(flatten)]
    storage: Storage,
    /// Jobs at a time; all cores when left out.
    #[arg(long, value_parser = clap::value_parser!(u16).range(1..=1024))]
    threads: Option<u16>,
    /// Ends when there was no job for so many seconds.
    #[arg(long, value_name = "SECONDS")]
    idle: Option<u64>,
}

#[derive(Debug, Subcommand)]
pub(super) enum Deed {
    /// Has workers fly a plan, and gathers what they flew; one that was begun goes on.
    Spread {
        /// The plan, TOML.
        plan: PathBuf,
        /// The NATS server with JetStream.
        #[arg(long, value_name = "URL")]
        nats: String,
        #[command(flatten)]
        storage: Storage,
        #[command(flatten)]
        size: Size,
        #[command(flatten)]
        data: DataFolder,
    },
    /// Flies one of N parts of a plan without a queue: a job of an array (`sbatch --array`).
    Part {
        /// The plan, TOML.
        plan: PathBuf,
        /// Which of how many, counted from 1: 3/64.
        #[arg(long, value_name = "K/N", value_parser = nth)]
        part: (u64, u64),
        #[command(flatten)]
        storage: Storage,
        #[command(flatten)]
        size: Size,
        /// Flights at a time; all cores when left out.
        #[arg(long, value_parser = clap::value_parser!(u16).range(1..=1024))]
        threads: Option<u16>,
    },
    /// Takes shards that are there into the experiment's folder; `run` flies the rest.
    Gather {
        /// The plan, TOML.
        plan: PathBuf,
        #[command(flatten)]
        storage: Storage,
        #[command(flatten)]
        data: DataFolder,
    },
}

/// How large a job is.
#[derive(Debug, clap::Args)]
pub(super) struct Size {
    /// Flights of a job, and of a shard.
    #[arg(long, default_value = "50", value_parser = clap::value_parser!(u64).range(1..=100_000))]
    size: u64,
}

fn nth(text: &str) -> Result<(u64, u64), String> {
    let parsed = text.split_once('/').and_then(|(k, n)| Some((k.parse().ok()?, n.parse().ok()?)));
    parsed.filter(|(k, n)| (1..=*n).contains(k)).ok_or_else(|| format!("{text} is not K/N with K from 1 to N"))
}

fn said(error: ManyError) -> String {
    error.to_string()
}

fn block_on<T>(work: impl Future<Output = Result<T, String>>) -> Result<T, String> {
    let mut runtime = tokio::runtime::Builder::new_multi_thread();
    let runtime = runtime.enable_all().thread_stack_size(STACK_BYTES).build().map_err(|error| error.to_string())?;
    runtime.block_on(work)
}

/// True from the first signal to end on; the second one ends the process.
fn stopped() -> Result<Arc<AtomicBool>, String> {
    let stop = Arc::new(AtomicBool::new(false));
    let mut end = tokio::signal::unix::signal(tokio::signal::unix::SignalKind::terminate())
        .map_err(|error| format!("signals: {error}"))?;
    let asked = stop.clone();
    tokio::spawn(async move {
        for _ in 0..2 {
            tokio::select! {
                _ = end.recv() => {}
                _ = tokio::signal::ctrl_c() => {}
            }
            if asked.swap(true, Ordering::Relaxed) {
                std::process::exit(130);
            }
            eprintln!("ends after the flights in the air");
        }
    });
    Ok(stop)
}

fn threads(asked: Option<u16>) -> usize {
    asked.map_or(Options::default().threads, usize::from)
}

/// Works.
///
/// # Errors
/// A sentence for people.
pub fn work(arguments: &WorkerArguments) -> Result<(), String> {
    tracing_subscriber::fmt().with_writer(std::io::stderr).init();
    let shards = Shards::open(&arguments.storage.store).map_err(said)?;
    let idle = arguments.idle.map(Duration::from_secs);
    let working = worker::Working { threads: threads(arguments.threads), idle };
    block_on(async { worker::work(&arguments.nats, shards, working, stopped()?).await.map_err(said) })
}

/// Does it.
///
/// # Errors
/// A sentence for people.
pub(super) fn run(deed: &Deed) -> Result<(), String> {
    match deed {
        Deed::Spread { plan, nats, storage, size, data } => {
            let experiment = made(plan, data)?;
            eprintln!("experiment {}", experiment.id);
            let shards = Shards::open(&storage.store).map_err(said)?;
            let ended = block_on(async {
                let (stop, flights) = (stopped()?, experiment.plan.flights());
                let each = |done: u64| eprintln!("{done}/{flights}");
                lead::spread(&experiment, nats, &shards, size.size, &stop, each).await.map_err(said)
            })?;
            eprintln!("{}", if ended == Ended::Complete { "complete" } else { "stopped; the same command goes on" });
            gathered(&experiment)
        }
        Deed::Part { plan, part, storage, size, threads: asked } => {
            let plan = read(plan)?;
            let shards = Shards::open(&storage.store).map_err(said)?;
            block_on(array(&plan, *part, &shards, size.size, threads(*asked)))
        }
        Deed::Gather { plan, storage, data } => {
            let experiment = made(plan, data)?;
            let shards = Shards::open(&storage.store).map_err(said)?;
            let came = block_on(async { lead::gather(&experiment, &shards).await.map_err(said) })?;
            eprintln!("{came} flights came");
            gathered(&experiment)
        }
    }
}

/// Says how it stands, with what the model expects kept as after a run here.
fn gathered(experiment: &Experiment) -> Result<(), String> {
    expectation::keep(experiment, || true).map_err(|error| error.to_string())?;
    super::experiment::print(&summary::state(experiment))
}

fn read(file: &Path) -> Result<Plan, String> {
    let text = std::fs::read_to_string(file).map_err(|error| format!("{}: {error}", file.display()))?;
    Plan::from_toml(&text).map_err(|error| format!("{}: {error}", file.display()))
}

fn made(file: &Path, data: &DataFolder) -> Result<Experiment, String> {
    Experiment::create(&Experiment::root(&data.data), read(file)?).map_err(|error| error.to_string())
}

/// Every N-th job of the plan, from the K-th on; what is there already is not flown again.
async fn array(plan: &Plan, (k, n): (u64, u64), shards: &Shards, size: u64, threads: usize) -> Result<(), String> {
    let id = Experiment::id_of(plan);
    let stop = stopped()?;
    let (id, stop) = (&id, &stop);
    let parts = Part::all(plan.flights(), size).zip(1..).filter(move |(_, at)| at % n == k % n);
    let one = |part: Part| async move {
        if stop.load(Ordering::Relaxed) || shards.has(id, part).await.map_err(said)? {
            return Ok(());
        }
        let (own, asked) = (plan.clone(), stop.clone());
        let flown = tokio::task::spawn_blocking(move || part.fly(&own, || !asked.load(Ordering::Relaxed))).await;
        let Some((rows, errors)) = flown.map_err(|error| format!("{}: {error}", part.name()))? else { return Ok(()) };
        errors.iter().for_each(|error| eprintln!("{error}"));
        shards.put(id, plan, part, &rows).await.map_err(said)?;
        eprintln!("{id}/{}", part.name());
        Ok::<(), String>(())
    };
    let mut flying = futures_util::stream::iter(parts.map(|(part, _)| one(part))).buffer_unordered(threads);
    while let Some(ended) = flying.next().await {
        ended?;
    }
    Ok(())
}
