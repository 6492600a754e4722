//! Experiments on many machines: parts of a plan as jobs on NATS JetStream, shards of their results in a folder or a bucket.
//!
//! ```text
//! lead ─► PLUMBLINE_JOBS (work queue) ─► workers ─► shards (folder, S3) ─► lead ─► flights.rows
//!                                          └─► PLUMBLINE_POISON: jobs that cannot be flown, with the reason
//! ```
//! A job is a part of a plan; its shard follows from plan, program and part alone. So a job that is delivered twice, to a worker
//! that comes or after one that went, does no harm: a shard that is there is not flown again, and two of them are the same.
//! Workers take jobs of their own program only. The lead is whoever holds the experiment's folder; it may be killed as well.
//! What ends a lead, a worker, the NATS server or the storage costs the jobs in the air and nothing that was finished.

pub mod lead;
pub mod shards;
pub mod worker;

use std::time::Duration;

use async_nats::jetstream::consumer::{PullConsumer, pull};
use async_nats::jetstream::stream::{Config, RetentionPolicy, Stream};
use async_nats::jetstream::{self, Context};
use plumbline_experiment::part::Part;
use plumbline_experiment::plan::PROGRAM;
use plumbline_experiment::store::StoreError;
use serde::{Deserialize, Serialize};

pub use shards::Shards;

/// The work queue.
const JOBS: &str = "PLUMBLINE_JOBS";
/// Jobs set aside.
const POISON: &str = "PLUMBLINE_POISON";
/// A job whose worker says nothing for so long goes to another.
const ACK_WAIT: Duration = Duration::from_secs(30);
/// A job that was delivered more often is set aside: it ends its workers.
const DELIVERIES: i64 = 5;
/// After something failed, it is tried again.
const AGAIN: Duration = Duration::from_secs(1);
/// Jobs set aside are kept so long.
const KEPT: Duration = Duration::from_hours(24 * 30);

/// What went wrong with an experiment on many machines.
#[derive(Debug, thiserror::Error)]
pub enum ManyError {
    /// The queue.
    #[error("NATS: {doing}: {reason}")]
    Nats {
        /// What was tried.
        doing: &'static str,
        /// Why it failed.
        reason: String,
    },
    /// The storage.
    #[error("storage {at}: {reason}")]
    Storage {
        /// Where.
        at: String,
        /// Why it failed.
        reason: String,
    },
    /// The experiment's own folder.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// A plan that ends early.
    #[error("the plan has a [stop]: what ends it early is looked at on one machine only; leave it out")]
    Stops,
    /// Jobs set aside.
    #[error("{jobs} jobs were set aside, {missing} flights are missing; the first: {first}")]
    Poisoned {
        /// How many.
        jobs: usize,
        /// Flights that nobody will fly.
        missing: u64,
        /// What its worker said.
        first: String,
    },
}

fn nats<E: std::fmt::Display>(doing: &'static str) -> impl FnOnce(E) -> ManyError {
    move |error| ManyError::Nats { doing, reason: error.to_string() }
}

/// One job.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Job {
    /// Hash of plan and program.
    pub hash: String,
    /// The plan, TOML.
    pub plan: String,
    /// Which of its flights.
    pub part: Part,
}

/// A job set aside.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Poisoned {
    /// The job as it came.
    pub job: String,
    /// Why it cannot be flown.
    pub error: String,
}

/// This program as a part of a subject.
fn program() -> String {
    PROGRAM.replace(|c: char| !c.is_ascii_alphanumeric(), "_")
}

/// Jobs of this program.
pub fn jobs() -> String {
    format!("plumbline.jobs.{}", program())
}

/// Jobs of this program and an experiment that were set aside.
pub fn poison(id: &str) -> String {
    format!("plumbline.poison.{}.{id}", program())
}

/// The two streams.
struct Queue {
    context: Context,
    jobs: Stream,
    poison: Stream,
}

impl Queue {
    /// Connects, and makes the streams where they are not there.
    async fn open(url: &str) -> Result<Self, ManyError> {
        let options = async_nats::ConnectOptions::new().name("plumbline");
        let client = options.connect(url).await.map_err(nats("connecting"))?;
        let context = jetstream::new(client);
        let stream = |name: &str, subjects: &str, retention, max_age| Config {
            name: name.to_owned(),
            subjects: vec![subjects.to_owned()],
            retention,
            max_age,
            ..Config::default()
        };
        let work = stream(JOBS, "plumbline.jobs.*", RetentionPolicy::WorkQueue, Duration::ZERO);
        let aside = stream(POISON, "plumbline.poison.>", RetentionPolicy::Limits, KEPT);
        let jobs = context.get_or_create_stream(work).await.map_err(nats("stream of jobs"))?;
        let poison = context.get_or_create_stream(aside).await.map_err(nats("stream of jobs set aside"))?;
        Ok(Self { context, jobs, poison })
    }

    /// What every worker of this program pulls from.
    async fn workers(&self) -> Result<PullConsumer, ManyError> {
        let name = format!("workers_{}", program());
        let config = pull::Config {
            durable_name: Some(name.clone()),
            filter_subject: jobs(),
            ack_wait: ACK_WAIT,
            ..pull::Config::default()
        };
        self.jobs.get_or_create_consumer(&name, config).await.map_err(nats("consumer of jobs"))
    }
}
