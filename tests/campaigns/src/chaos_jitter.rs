//! The flight thread keeps its time whatever becomes of ground, link and disk: tick jitter of each trouble against the
//! quiet phases before and after it, in the same run, in turns. What is told is the median of the turns' ratios: a quiet
//! machine's jitter alone goes from 76 to 126 us and back within minutes, which three turns taken together could not tell
//! from an effect (0.71 to 1.24 for the same trouble in three runs).
//!
//! The jitter is the agent's own (99th percentile of |start − due| of each second), read from its onboard log, which needs
//! no link. Phases:
//!
//! | phase | what goes wrong |
//! |---|---|
//! | ground_dead | the ground is stopped (SIGSTOP) |
//! | link_saturated | a radio that loses two of three packets, half a second late, and junk at the agent's socket |
//! | disk_slow | the disk of the onboard log answers for 0.3 s every 5 s: whoever writes to it waits |
//! | disk_busy | a neighbour writes and syncs without pause: the machine's processors and interrupts are busy with it |
//!
//! On each processor a bare timer runs beside the agent, with its rate and priority, and touches nothing: what a busy
//! machine does to any thread is seen there. The promise is made for the first three; for the last it is that the agent
//! suffers no more than the bare timer of the processor that suffers most: a real-time thread stays where it is.

use std::io::Write as _;
use std::net::UdpSocket;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use super::disk::Disk;
use super::figures::{Figures, quantile, setting};
use super::witness::{Witness, now_us};
use plumbline_proto::{Message as _, v1};
use plumbline_support::files;
use plumbline_support::system::{PATIENCE, options, scenario};
use plumbline_tests::harness::{Agent, Faults, Ground, Radio, wait_until};
use serde_json::json;

/// DESIGN: within 20 % of the quiet run.
const RATIO_MAX: f64 = 1.2;
/// Packets of junk a second: far more than any radio carries.
const JUNK_HZ: u32 = 5_000;
/// The agent's own.
const TICK: Duration = Duration::from_millis(5);
/// Each trouble comes so often.
const TURNS: u32 = 9;
const FROZEN: Duration = Duration::from_millis(4_700);
const THAWED: Duration = Duration::from_millis(300);

/// Does `work` again and again while `during` runs.
fn beside(work: impl Fn() + Send + 'static, during: impl FnOnce()) {
    let ended = Arc::new(AtomicBool::new(false));
    let thread = {
        let ended = ended.clone();
        std::thread::spawn(move || {
            while !ended.load(Ordering::Relaxed) {
                work();
            }
        })
    };
    during();
    ended.store(true, Ordering::Relaxed);
    thread.join().unwrap();
}

/// A phase of the flight: name, begin and end, µs of wall time.
type Phase = (&'static str, u64, u64);

pub fn run() -> std::process::ExitCode {
    let seed = setting("PLUMBLINE_SEED", 1);
    let seconds = setting("PLUMBLINE_SECONDS", 7);
    let mut figures = Figures::new("jitter", seed);
    let folder = tempfile::tempdir().unwrap();
    let options = options(folder.path());
    let disk = Disk::mount(&options.data.join("iris-1/log")).map(Arc::new);
    if let Err(reason) = &disk {
        figures.skip("disk_slow", reason);
    }
    let mut ground = Ground::start(&options).unwrap();
    let radio = Radio::to(ground.link, Faults::default(), seed).unwrap();
    ground.link = radio.address();
    let mut agent = Agent::start(&options, "iris-1", &scenario("altitude_step"), &ground).unwrap();
    let command = |route: &str, body| ground.api.command("POST", &format!("/api/v1/vehicles/iris-1/{route}"), &body);
    command("recording", json!({ "on": true })).unwrap();
    wait_until(PATIENCE, || command("arm", json!({})).ok()).expect("armed");
    command("mode", json!({ "mode": "altitude_hold" })).unwrap();
    command("setpoint", json!({ "altitude_m": 0.5 })).unwrap();
    let processors = std::thread::available_parallelism().map_or(1, usize::from);
    let bare: Vec<_> = (0..processors).map(|processor| Witness::start(Some(processor), TICK, 0.0)).collect();
    let phases = troubles(&ground, &radio, disk.as_ref().ok(), folder.path(), seconds);
    agent.process.interrupt(Duration::from_secs(15)).unwrap();
    drop(ground);

    let flown = Flown::of(phases, &options.data.join("iris-1/log"));
    for name in ["ground_dead", "link_saturated", "disk_slow", "disk_busy"] {
        flown.report(&mut figures, name, &bare);
    }
    figures.finish()
}

/// Every trouble in its turn, a quiet phase before and after each.
fn troubles(ground: &Ground, radio: &Radio, disk: Option<&Arc<Disk>>, folder: &Path, seconds: u64) -> Vec<Phase> {
    let mut phases = Vec::new();
    let mut phase = |name: &'static str| {
        let begin = now_us();
        std::thread::sleep(Duration::from_secs(seconds));
        phases.push((name, begin, now_us()));
    };
    for _ in 0..TURNS {
        phase("quiet");
        ground.process.signal(libc::SIGSTOP);
        phase("ground_dead");
        ground.process.signal(libc::SIGCONT);
        phase("quiet");
        let to = radio.agent().expect("an agent that has spoken");
        radio.set(Faults { loss: 0.67, delay: Duration::from_millis(500), ..Faults::default() });
        let junk = UdpSocket::bind("127.0.0.1:0").unwrap();
        let flood = move || {
            let _ = junk.send_to(&[0x5a; 1_100], to);
            std::thread::sleep(Duration::from_secs(1) / JUNK_HZ);
        };
        beside(flood, || phase("link_saturated"));
        radio.set(Faults::default());
        if let Some(disk) = disk {
            phase("quiet");
            let slow = disk.clone();
            let stutter = move || {
                slow.freeze();
                std::thread::sleep(FROZEN);
                slow.thaw();
                std::thread::sleep(THAWED);
            };
            beside(stutter, || phase("disk_slow"));
        }
        phase("quiet");
        let path = folder.join("neighbour");
        let busy = move || {
            let mut file = std::fs::File::create(&path).unwrap();
            file.write_all(&vec![1; 4 << 20]).unwrap();
            file.sync_all().unwrap();
        };
        beside(busy, || phase("disk_busy"));
    }
    phase("quiet");
    phases
}

/// The phases, and what the agent told in them.
struct Flown {
    phases: Vec<Phase>,
    /// With the time of each, µs of wall time.
    statuses: Vec<(u64, v1::Status)>,
    /// Those of them that tell a new figure: each second's is told until the next one.
    told: Vec<(u64, v1::Status)>,
}

/// Jitter of a trouble against that of the quiet phases beside it.
struct Judged {
    /// Median of the turns' ratios, and the least and the most of them.
    ratio: f64,
    least: f64,
    most: f64,
    /// Medians, µs.
    troubled_us: f64,
    quiet_us: f64,
}

impl Flown {
    fn of(phases: Vec<Phase>, log: &Path) -> Self {
        let log = files::messages_of(log, "");
        let mut statuses: Vec<(u64, v1::Status)> = log
            .values()
            .filter(|message| message.topic == "/status")
            .map(|message| (message.wall_us, v1::Status::decode(message.data.as_slice()).unwrap()))
            .collect();
        statuses.sort_by_key(|(at, _)| *at);
        let mut told = statuses.clone();
        told.dedup_by_key(|(_, status)| status.tick_jitter_p99_us.to_bits());
        Self { phases, statuses, told }
    }

    /// The agent's own figures of a phase, µs.
    fn jitter_us(&self, index: usize) -> Vec<f64> {
        // The first second and a half of a phase still tells of the one before.
        let (begin, end) = (self.phases[index].1 + 1_500_000, self.phases[index].2);
        let within = self.told.iter().filter(|(at, _)| (begin..end).contains(at));
        within.map(|(_, status)| status.tick_jitter_p99_us).collect()
    }

    fn misses(&self, index: usize) -> u64 {
        let (_, begin, end) = self.phases[index];
        let within = self.statuses.iter().filter(|(at, _)| (begin..end).contains(at));
        let mut within = within.map(|(_, status)| status.deadline_misses);
        let first = within.next().unwrap_or(0);
        within.next_back().unwrap_or(first) - first
    }

    /// The quiet phases beside a phase.
    fn around(&self, index: usize) -> impl Iterator<Item = usize> {
        [index - 1, index + 1].into_iter().filter(move |index| self.phases[*index].0 == "quiet")
    }

    /// Compares the jitter `of` each turn, troubled and quiet; then of all turns, the least and the most of their ratios,
    /// and the medians.
    fn judge(&self, turns: &[usize], of: &dyn Fn(usize) -> Vec<f64>) -> Judged {
        let turn = |index: &usize| {
            let mut quiet: Vec<f64> = self.around(*index).flat_map(of).collect();
            [quantile(&mut of(*index), 0.5), quantile(&mut quiet, 0.5)]
        };
        let pairs: Vec<[f64; 2]> = turns.iter().map(turn).filter(|pair| pair.iter().all(|v| *v > 0.0)).collect();
        let all = |value: &dyn Fn(&[f64; 2]) -> f64, q| quantile(&mut pairs.iter().map(value).collect::<Vec<_>>(), q);
        let [least, ratio, most] = [0.0, 0.5, 1.0].map(|q| all(&|[troubled, quiet]| troubled / quiet, q));
        let (troubled_us, quiet_us) = (all(&|pair| pair[0], 0.5).round(), all(&|pair| pair[1], 0.5).round());
        Judged { ratio, least, most, troubled_us, quiet_us }
    }

    /// What one trouble does to the agent, and to the bare timer that suffers most.
    fn report(&self, figures: &mut Figures, name: &str, bare: &[Witness]) {
        let turns: Vec<usize> = (0..self.phases.len()).filter(|index| self.phases[*index].0 == name).collect();
        if turns.is_empty() {
            return;
        }
        let agent = self.judge(&turns, &|index| self.jitter_us(index));
        let of_timer =
            |timer: &Witness| self.judge(&turns, &|index| timer.jitter_us(self.phases[index].1, self.phases[index].2));
        let none = Judged { ratio: f64::NAN, least: 0.0, most: 0.0, troubled_us: 0.0, quiet_us: 0.0 };
        let timer = bare.iter().map(of_timer).max_by(|a, b| a.ratio.total_cmp(&b.ratio)).unwrap_or(none);
        let missed: u64 = turns.iter().map(|index| self.misses(*index)).sum();
        let quiet = turns.iter().flat_map(|index| self.around(*index));
        let missed_quiet: u64 = quiet.map(|index| self.misses(index)).sum();
        let rounded = |ratio: f64| (ratio * 1e3).round() / 1e3;
        let more = json!({ "jitter_p99_us": agent.troubled_us, "quiet_us": agent.quiet_us, "turns": turns.len(),
            "least": rounded(agent.least), "most": rounded(agent.most), "bare_timer_ratio": rounded(timer.ratio),
            "bare_timer_us": timer.troubled_us, "bare_timer_quiet_us": timer.quiet_us,
            "missed": missed, "missed_quiet": missed_quiet });
        if name == "disk_busy" {
            figures.tell("disk_busy_ratio", agent.ratio, "of quiet", more);
            let beyond = agent.ratio / timer.ratio;
            figures.at_most("disk_busy_beyond_bare_timer", beyond, RATIO_MAX, "of its ratio", json!({}));
        } else {
            figures.at_most(&format!("{name}_ratio"), agent.ratio, RATIO_MAX, "of quiet", more);
        }
    }
}
