//! A worker: pulls jobs of its program, flies them, keeps their shards.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use async_nats::jetstream::AckKind;
use async_nats::jetstream::message::{Message, PublishMessage};
use futures_util::StreamExt as _;
use plumbline_experiment::part::Part;
use plumbline_experiment::plan::Plan;
use plumbline_experiment::row::Row;
use plumbline_experiment::store::Experiment;

use super::{ACK_WAIT, AGAIN, DELIVERIES, Job, ManyError, Poisoned, Queue, Shards, nats, poison};

/// An empty queue is asked again after this.
const WAITS: Duration = Duration::from_secs(2);
/// The queue hears so often that a job is still being flown.
const SAYS: Duration = Duration::from_secs(ACK_WAIT.as_secs() / 3);

/// How to work.
#[derive(Debug, Clone, Copy)]
pub struct Working {
    /// Jobs at a time.
    pub threads: usize,
    /// Ends when the queue had nothing for so long; never, when left out.
    pub idle: Option<Duration>,
}

/// Works until `stop`; what is in the air then goes back to the queue.
///
/// # Errors
/// [`ManyError::Nats`]: the queue cannot be reached at the beginning. What fails later is tried again.
pub async fn work(url: &str, shards: Shards, working: Working, stop: Arc<AtomicBool>) -> Result<(), ManyError> {
    let queue = Queue::open(url).await?;
    queue.workers().await?;
    let slots = (0..working.threads.max(1)).map(|_| slot(&queue, &shards, working.idle, &stop));
    futures_util::future::join_all(slots).await;
    Ok(())
}

/// One job after the other.
async fn slot(queue: &Queue, shards: &Shards, idle: Option<Duration>, stop: &Arc<AtomicBool>) {
    let mut busy = Instant::now();
    while !stop.load(Ordering::Relaxed) && idle.is_none_or(|idle| busy.elapsed() < idle) {
        match next(queue).await {
            Ok(None) => {}
            Ok(Some(message)) => {
                if let Err(error) = one(queue, shards, &message, stop).await {
                    tracing::warn!(%error, "a job goes to whoever asks next");
                }
                busy = Instant::now();
            }
            Err(error) => {
                tracing::warn!(%error, "no job");
                tokio::time::sleep(AGAIN).await;
            }
        }
    }
}

async fn next(queue: &Queue) -> Result<Option<Message>, ManyError> {
    let consumer = queue.workers().await?;
    let mut batch =
        consumer.batch().max_messages(1).expires(WAITS).messages().await.map_err(nats("asking for a job"))?;
    batch.next().await.transpose().map_err(nats("a job"))
}

/// What is wrong with a job is said where it is set aside; an error here is the queue's.
async fn one(queue: &Queue, shards: &Shards, message: &Message, stop: &Arc<AtomicBool>) -> Result<(), ManyError> {
    let delivered = message.info().map_err(nats("a job's delivery"))?.delivered;
    let text = String::from_utf8_lossy(&message.payload).into_owned();
    let (plan, part) = match read(&text) {
        Ok(read) => read,
        Err(error) => return set_aside(queue, message, "unread", text, error).await,
    };
    let id = Experiment::id_of(&plan);
    if delivered > DELIVERIES {
        let error =
            format!("delivered {DELIVERIES} times and never finished: it ends its workers, or takes them too long");
        return set_aside(queue, message, &id, text, error).await;
    }
    if matches!(shards.has(&id, part).await, Ok(true)) {
        return message.double_ack().await.map_err(nats("a finished job"));
    }
    match flown(message, &plan, part, stop).await {
        Ok(Some(rows)) => kept(shards, message, &id, &plan, part, &rows, stop).await,
        Ok(None) => message.ack_with(AckKind::Nak(None)).await.map_err(nats("giving a job back")),
        Err(error) => set_aside(queue, message, &id, text, error).await,
    }
}

fn read(text: &str) -> Result<(Plan, Part), String> {
    let job: Job = serde_json::from_str(text).map_err(|error| format!("no job: {error}"))?;
    let plan = Plan::parse(&job.plan).map_err(|error| error.to_string())?;
    let own = plan.hash();
    if own != job.hash {
        return Err(format!("hash {} is not that of its plan and this program, {own}", job.hash));
    }
    let end = job.part.first.checked_add(job.part.count).filter(|end| *end <= plan.flights() && job.part.count > 0);
    if end.is_none() {
        return Err(format!(
            "flights {} and {} after it are not of the {}",
            job.part.first,
            job.part.count,
            plan.flights()
        ));
    }
    Ok((plan, job.part))
}

/// The rows; `None` when it was ended early, an error when flying panicked.
async fn flown(message: &Message, plan: &Plan, part: Part, stop: &Arc<AtomicBool>) -> Result<Option<Vec<Row>>, String> {
    let (own, stop) = (plan.clone(), stop.clone());
    let mut flying = tokio::task::spawn_blocking(move || part.fly(&own, || !stop.load(Ordering::Relaxed)));
    let done = loop {
        tokio::select! {
            done = &mut flying => break done,
            () = tokio::time::sleep(SAYS) => still(message).await,
        }
    };
    let flown = done.map_err(|error| format!("{}: {error}", part.name()))?;
    Ok(flown.map(|(rows, errors)| {
        errors.iter().for_each(|error| tracing::warn!(error, "not flown"));
        rows
    }))
}

async fn still(message: &Message) {
    // Nobody who hears it costs the job a second worker, and no flight.
    let _ = message.ack_with(AckKind::Progress).await;
}

/// Keeps the shard however long the storage takes to come back: what was flown is not flown again.
async fn kept(
    shards: &Shards,
    message: &Message,
    id: &str,
    plan: &Plan,
    part: Part,
    rows: &[Row],
    stop: &AtomicBool,
) -> Result<(), ManyError> {
    while let Err(error) = shards.put(id, plan, part, rows).await {
        tracing::error!(%error, part = part.name(), "a shard waits for its storage");
        if stop.load(Ordering::Relaxed) {
            return Err(error);
        }
        still(message).await;
        tokio::time::sleep(AGAIN).await;
    }
    message.double_ack().await.map_err(nats("a finished job"))
}

async fn set_aside(queue: &Queue, message: &Message, id: &str, job: String, error: String) -> Result<(), ManyError> {
    tracing::error!(error, "a job is set aside");
    let payload = serde_json::to_vec(&Poisoned { job, error }).unwrap_or_default();
    let told = queue.context.send_publish(poison(id), PublishMessage::build().payload(payload.into())).await;
    told.map_err(nats("setting a job aside"))?.await.map_err(nats("setting a job aside"))?;
    message.double_ack_with(AckKind::Term).await.map_err(nats("setting a job aside"))
}
