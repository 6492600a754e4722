//! The lead: makes jobs of what is missing of an experiment, and gathers the shards into its folder.

use std::collections::BTreeSet;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use async_nats::jetstream::consumer::{AckPolicy, DeliverPolicy, pull};
use async_nats::jetstream::message::PublishMessage;
use futures_util::{StreamExt as _, TryStreamExt as _};
use plumbline_experiment::part::Part;
use plumbline_experiment::run::Ended;
use plumbline_experiment::store::{Experiment, Held, StoreError};

use super::{Job, ManyError, Poisoned, Queue, Shards, jobs, nats, poison};

/// The storage is looked at so often.
const LOOKS: Duration = Duration::from_secs(1);
/// An empty queue that was quiet for so long has lost jobs, or flown into a damaged shard: what is missing is asked for again.
const QUIET: Duration = Duration::from_secs(10);
/// Jobs on their way to the queue at a time.
const ON_THE_WAY: usize = 128;
/// Jobs set aside that are read at a time.
const ASIDE: usize = 100;

/// An experiment being gathered.
struct Gathered<'a> {
    experiment: &'a Experiment,
    shards: &'a Shards,
    held: Held,
    /// Flights that are there.
    done: BTreeSet<u64>,
    /// Shards that were taken.
    taken: BTreeSet<String>,
}

impl<'a> Gathered<'a> {
    fn hold(experiment: &'a Experiment, shards: &'a Shards) -> Result<Self, ManyError> {
        let held = experiment.hold()?;
        let done = experiment.rows()?.iter().map(|row| row.index.into()).collect();
        Ok(Self { experiment, shards, held, done, taken: BTreeSet::new() })
    }

    /// Takes shards that came since; how many flights.
    async fn look(&mut self) -> Result<u64, ManyError> {
        let before = self.done.len();
        let id = &self.experiment.id;
        for name in self.shards.names(id).await? {
            if self.taken.contains(&name) {
                continue;
            }
            let Some(rows) = self.shards.rows(id, &name).await? else { continue };
            for row in rows {
                let index = u64::from(row.index);
                if index < self.experiment.plan.flights() && self.done.insert(index) {
                    self.held.append(&row)?;
                }
            }
            self.taken.insert(name);
        }
        if self.done.len() > before {
            self.held.sync();
        }
        Ok((self.done.len() - before) as u64)
    }

    /// Parts of which a flight is missing.
    fn missing(&self, size: u64) -> Vec<Part> {
        let parts = Part::all(self.experiment.plan.flights(), size);
        parts.filter(|part| part.indices().any(|index| !self.done.contains(&index))).collect()
    }

    fn left(&self) -> u64 {
        self.experiment.plan.flights().saturating_sub(self.done.len() as u64)
    }
}

/// Takes what is there of an experiment into its folder; how many flights came.
///
/// # Errors
/// [`ManyError`]: its folder or the storage.
pub async fn gather(experiment: &Experiment, shards: &Shards) -> Result<u64, ManyError> {
    Gathered::hold(experiment, shards)?.look().await
}

/// Has workers fly what is missing, `size` flights a job, until all is there or `stop`. `each` hears of flights that are there.
///
/// # Errors
/// [`ManyError`]: what was gathered before is kept, and whoever begins again goes on.
pub async fn spread(
    experiment: &Experiment,
    url: &str,
    shards: &Shards,
    size: u64,
    stop: &AtomicBool,
    mut each: impl FnMut(u64),
) -> Result<Ended, ManyError> {
    if experiment.plan.stop.is_some() {
        return Err(ManyError::Stops);
    }
    if experiment.plan.is_by_hand() {
        return Err(StoreError::ByHand(experiment.id.clone()).into());
    }
    let mut gathered = Gathered::hold(experiment, shards)?;
    let mut queue = Queue::open(url).await?;
    let before = queue.poison.info().await.map_err(nats("jobs set aside"))?.state.last_sequence;
    let begun = experiment.since().map_or(0, |since| since.unix_us);
    gathered.look().await?;
    each(gathered.done.len() as u64);
    let (mut asked, mut quiet) = (0_u64, None::<Instant>);
    while gathered.left() > 0 {
        if stop.load(Ordering::Relaxed) || experiment.asked_to_stop() {
            return Ok(Ended::Stopped);
        }
        if quiet.is_none_or(|quiet| quiet.elapsed() >= QUIET) {
            quiet = Some(Instant::now());
            match ask(&mut queue, &gathered, size, before, &format!("{begun}-{asked}"), asked == 0).await {
                Ok(jobs) => asked += u64::from(jobs > 0),
                // It comes back, and so do its jobs.
                Err(error @ ManyError::Nats { .. }) => tracing::warn!(%error, "the queue is away"),
                Err(error) => return Err(error),
            }
        }
        tokio::time::sleep(LOOKS).await;
        match gathered.look().await {
            Ok(0) => {}
            Ok(_) => {
                quiet = Some(Instant::now());
                each(gathered.done.len() as u64);
            }
            Err(error @ ManyError::Storage { .. }) => tracing::warn!(%error, "the storage is away"),
            Err(error) => return Err(error),
        }
    }
    Ok(Ended::Complete)
}

/// Makes jobs of what is missing where the queue has none, or at the `first` time; how many.
async fn ask(
    queue: &mut Queue,
    gathered: &Gathered<'_>,
    size: u64,
    before: u64,
    attempt: &str,
    first: bool,
) -> Result<usize, ManyError> {
    let aside = set_aside(queue, &gathered.experiment.id, before).await?;
    let gone = |part: &Part| aside.iter().any(|aside| part_of(aside) == Some(*part));
    let missing = gathered.missing(size);
    let wanted: Vec<Part> = missing.iter().filter(|part| !gone(part)).copied().collect();
    if let (Some(first), true) = (aside.first(), wanted.is_empty()) {
        let (jobs, first) = (missing.len(), first.error.clone());
        return Err(ManyError::Poisoned { jobs, missing: gathered.left(), first });
    }
    if !first && queue.jobs.info().await.map_err(nats("jobs"))?.state.messages > 0 {
        return Ok(0);
    }
    publish(queue, gathered.experiment, &wanted, attempt).await?;
    Ok(wanted.len())
}

fn part_of(aside: &Poisoned) -> Option<Part> {
    serde_json::from_str::<Job>(&aside.job).ok().map(|job| job.part)
}

async fn publish(queue: &Queue, experiment: &Experiment, parts: &[Part], attempt: &str) -> Result<(), ManyError> {
    let (hash, plan) = (&experiment.identity.hash, &experiment.plan.text);
    let one = |part: Part| async move {
        let job = Job { hash: hash.clone(), plan: plan.clone(), part };
        let payload = serde_json::to_vec(&job).unwrap_or_default();
        let id = format!("{hash}-{}-{attempt}", part.name());
        let message = PublishMessage::build().payload(payload.into()).message_id(id);
        let kept = queue.context.send_publish(jobs(), message).await.map_err(nats("a job"))?;
        kept.await.map_err(nats("a job")).map(drop)
    };
    futures_util::stream::iter(parts.iter().copied().map(one)).buffer_unordered(ON_THE_WAY).try_collect().await
}

/// Jobs of an experiment that were set aside after so many others.
async fn set_aside(queue: &mut Queue, id: &str, before: u64) -> Result<Vec<Poisoned>, ManyError> {
    let mut found = Vec::new();
    if queue.poison.info().await.map_err(nats("jobs set aside"))?.state.last_sequence <= before {
        return Ok(found);
    }
    let config = pull::Config {
        filter_subject: poison(id),
        deliver_policy: DeliverPolicy::ByStartSequence { start_sequence: before + 1 },
        ack_policy: AckPolicy::None,
        inactive_threshold: QUIET,
        ..pull::Config::default()
    };
    let consumer = queue.poison.create_consumer(config).await.map_err(nats("jobs set aside"))?;
    loop {
        let mut batch = consumer.fetch().max_messages(ASIDE).messages().await.map_err(nats("jobs set aside"))?;
        let mut read = 0;
        while let Some(message) = batch.next().await {
            found.extend(serde_json::from_slice(&message.map_err(nats("a job set aside"))?.payload));
            read += 1;
        }
        if read < ASIDE {
            return Ok(found);
        }
    }
}
