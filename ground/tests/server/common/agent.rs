//! An agent made of two channels: what it says and what it is asked.

use std::collections::{BTreeMap, BTreeSet};
use std::future::Future;
use std::time::Instant;

use plumbline_ground::agent_link::{CommandReceiver, CommandSender, LinkEvent, Outgoing};
use plumbline_proto::codec::{self, Frame};
use plumbline_proto::{Kind, Message, v1};
use tokio::sync::mpsc;

use super::PATIENCE;

/// An agent: it numbers its messages, keeps its own log, and answers as it is told.
pub struct Agent {
    pub id: String,
    pub boot_id: u64,
    link: mpsc::Sender<LinkEvent>,
    pub outgoing: CommandReceiver,
    /// The onboard log: every frame ever encoded, with its sequence number.
    pub log: Vec<(u64, Vec<u8>)>,
    pub sequence: u64,
    pub time_us: u64,
    /// What the onboard log has lost.
    pub forgotten: BTreeSet<u64>,
}

pub const BOOT_WALL_US: u64 = 1_700_000_000_000_000;

impl Agent {
    pub async fn connect(link: mpsc::Sender<LinkEvent>, id: &str, boot_id: u64) -> Self {
        let (commands, outgoing) = CommandSender::channel();
        let agent = Self {
            id: id.into(),
            boot_id,
            link,
            outgoing,
            log: Vec::new(),
            sequence: 0,
            time_us: 0,
            forgotten: BTreeSet::new(),
        };
        agent.hello(commands).await;
        agent
    }

    async fn hello(&self, commands: CommandSender) {
        let event = LinkEvent::Connected {
            agent_id: self.id.clone(),
            boot_id: self.boot_id,
            boot_wall_time_us: BOOT_WALL_US,
            version: "test".into(),
            commands,
        };
        self.link.send(event).await.unwrap();
    }

    /// Comes back, to this or another ground, with its log and its count.
    pub async fn reconnect(&mut self, link: mpsc::Sender<LinkEvent>) {
        let (commands, outgoing) = CommandSender::channel();
        self.link = link;
        self.outgoing = outgoing;
        self.hello(commands).await;
    }

    pub async fn disconnect(&mut self) {
        self.outgoing.close();
        let event = LinkEvent::Disconnected { agent_id: self.id.clone(), reason: "test".into() };
        self.link.send(event).await.unwrap();
    }

    /// Encodes one message into the log and returns its sequence number. Nothing is sent.
    pub fn encode<M: Message>(&mut self, kind: Kind, instance: u16, message: &M) -> u64 {
        self.sequence += 1;
        let payload = message.encode_to_vec();
        let mut bytes = Vec::new();
        Frame { kind: kind.to_wire(), instance, sequence: self.sequence, time_us: self.time_us, payload: &payload }
            .encode(&mut bytes);
        self.log.push((self.sequence, bytes));
        self.sequence
    }

    /// Sends frames of the log as one batch.
    pub async fn send(&self, sequences: impl IntoIterator<Item = u64>, backfill: bool) {
        let mut batch = Vec::new();
        codec::begin_batch(&mut batch);
        for sequence in sequences {
            let (found, bytes) = &self.log[sequence as usize - 1];
            assert_eq!(*found, sequence);
            batch.extend_from_slice(bytes);
        }
        let event = LinkEvent::Batch {
            agent_id: self.id.clone(),
            batch: codec::Batch::parse(batch.into()).unwrap(),
            received: Instant::now(),
            backfill,
        };
        self.link.send(event).await.unwrap();
    }

    /// Encodes and sends at once.
    pub async fn say<M: Message>(&mut self, kind: Kind, instance: u16, message: &M) -> u64 {
        let sequence = self.encode(kind, instance, message);
        self.send([sequence], false).await;
        sequence
    }

    /// One tick of 5 ms: control, estimate, one height. Returns the sequence numbers, unsent.
    pub fn tick(&mut self) -> Vec<u64> {
        self.time_us += 5000;
        let t = self.time_us as f64 * 1e-6;
        let control = v1::Control {
            time_us: self.time_us,
            mode: v1::Mode::AltitudeHold as i32,
            armed: true,
            setpoint: Some(v1::Setpoint { altitude_m: Some(0.8), ..Default::default() }),
            thrust_n: 9.81 * t,
            motor_command: vec![0.5; 4],
            motor_applied: vec![0.5; 4],
            integrator: vec![0.0; 4],
            ..Default::default()
        };
        let estimate = v1::Estimate {
            time_us: self.time_us,
            estimator: v1::EstimatorKind::EkfBias as i32,
            in_loop: true,
            world_from_body: Some(v1::Quaternion { w: 1.0, ..Default::default() }),
            position_enu_m: Some(v1::Vector3 { x: 0.0, y: 0.0, z: 0.9 }),
            ..Default::default()
        };
        let height = v1::HeightSample { time_us: self.time_us, sensed_m: 0.81, ..Default::default() };
        vec![
            self.encode(Kind::Control, 0, &control),
            self.encode(Kind::Estimate, 1, &estimate),
            self.encode(Kind::Height, 2, &height),
        ]
    }

    /// So many ticks, sent as they come.
    pub async fn fly(&mut self, ticks: usize) {
        for _ in 0..ticks {
            let tick = self.tick();
            self.send(tick, false).await;
        }
    }

    pub async fn describe(&mut self) {
        let sensor = |instance| v1::SensorDescription {
            kind: v1::SensorKind::Height as i32,
            instance,
            name: format!("height {instance}"),
            ..Default::default()
        };
        let description = v1::Description {
            agent_id: self.id.clone(),
            agent_version: "test 1".into(),
            schema: 1,
            vehicle: "sim".into(),
            airframe: "iris".into(),
            rig: "strings".into(),
            seed: 7,
            sensors: (1..=3).map(sensor).collect(),
            boot_wall_time_us: BOOT_WALL_US,
            ..Default::default()
        };
        self.say(Kind::Description, 0, &description).await;
    }

    /// Opens a flight; its first message is the mark itself.
    pub async fn begin(&mut self, flight_id: &str) -> u64 {
        let first_sequence = self.sequence + 1;
        let mark = v1::FlightMark {
            time_us: self.time_us,
            flight_id: flight_id.into(),
            first_sequence,
            last_sequence: None,
            reason: "armed".into(),
        };
        self.say(Kind::Flight, 0, &mark).await
    }

    /// Encodes the mark that closes a flight and is its last message.
    pub fn end(&mut self, flight_id: &str, first_sequence: u64) -> u64 {
        let mark = v1::FlightMark {
            time_us: self.time_us,
            flight_id: flight_id.into(),
            first_sequence,
            last_sequence: Some(self.sequence + 1),
            reason: "disarmed".into(),
        };
        self.encode(Kind::Flight, 0, &mark)
    }

    /// The next command the ground sent; backfill requests are answered from the log on the way.
    pub async fn command(&mut self) -> v1::Command {
        loop {
            let outgoing = tokio::time::timeout(PATIENCE, self.outgoing.recv()).await.expect("a command in time");
            match outgoing.expect("an open link") {
                Outgoing::Command(command) => return command,
                Outgoing::Backfill(request) => self.backfill(&request).await,
                Outgoing::OperatorAlive(_) | Outgoing::FlightKept(_) => {}
            }
        }
    }

    /// Answers from the log; what it does not hold (any more) is said to be unavailable.
    pub async fn backfill(&mut self, request: &v1::BackfillRequest) {
        let last = request.last_sequence.min(self.sequence);
        let asked = request.first_sequence..=last;
        let (gone, held): (Vec<u64>, Vec<u64>) = asked.partition(|s| self.forgotten.contains(s));
        for piece in held.chunks(200) {
            self.send(piece.iter().copied(), true).await;
        }
        for sequence in gone {
            self.unavailable(request, sequence, sequence).await;
        }
        if request.last_sequence > last {
            self.unavailable(request, request.first_sequence.max(last + 1), request.last_sequence).await;
        }
    }

    async fn unavailable(&self, request: &v1::BackfillRequest, first_sequence: u64, last_sequence: u64) {
        let request = v1::BackfillRequest { first_sequence, last_sequence, ..request.clone() };
        self.link.send(LinkEvent::BackfillUnavailable { agent_id: self.id.clone(), request }).await.unwrap();
    }

    /// Answers backfill requests while `work` goes on.
    pub async fn answering<T>(&mut self, work: impl Future<Output = T>) -> T {
        tokio::pin!(work);
        loop {
            tokio::select! {
                done = &mut work => return done,
                Some(outgoing) = self.outgoing.recv() => if let Outgoing::Backfill(request) = outgoing {
                    self.backfill(&request).await;
                },
            }
        }
    }

    /// Says that a flight goes on (or, with an empty name, that none does).
    pub async fn status(&mut self, flight_id: &str, flight_start_us: u64) {
        let status =
            v1::Status { time_us: self.time_us, flight_id: flight_id.into(), flight_start_us, ..Default::default() };
        self.say(Kind::Status, 0, &status).await;
    }

    /// Messages of each topic that the log holds of `first..=last`.
    pub fn counts(&self, first: u64, last: u64) -> BTreeMap<String, u64> {
        let mut counts = BTreeMap::new();
        for (_, bytes) in self.log.iter().filter(|(s, _)| (first..=last).contains(s)) {
            let frame = codec::decode_frames(bytes).next().unwrap().unwrap();
            *counts.entry(frame.known_kind().unwrap().topic(frame.instance)).or_default() += 1;
        }
        counts
    }

    pub async fn ack(&mut self, command_id: u64, stage: v1::AckStage, reason: &str) {
        let ack = v1::Ack { time_us: self.time_us, command_id, stage: stage as i32, reason: reason.into() };
        self.say(Kind::Ack, 0, &ack).await;
    }

    /// Takes one command and accepts it.
    pub async fn accept(&mut self) -> v1::Command {
        let command = self.command().await;
        self.ack(command.command_id, v1::AckStage::Accepted, "done").await;
        command
    }
}
