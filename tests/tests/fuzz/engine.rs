//! Gives a harness inputs for as long as is asked, watches time, memory and panics, and keeps what it failed on.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Once, OnceLock};
use std::time::{Duration, Instant};

use arbitrary::Unstructured;
use plumbline_tests::harness::radio::Chance;

use super::damage::{below, damage};

/// What all decoders together may ever take, MiB: the largest bound of one is that of an MCAP chunk (256 MiB).
const MEMORY_MAX_MIB: f64 = 512.0;
/// What one input of a few kilobytes may take of processor time.
const TIME_MAX: Duration = Duration::from_secs(10);
const SHORT: Duration = Duration::from_millis(500);
/// A new seed begins, and a line is printed, after this much work.
const PIECE: Duration = Duration::from_secs(60);
/// Memory is looked at once in so many inputs.
const LOOK_EVERY: u64 = 256;

/// Most memory that this process ever held, MiB. What is reserved and never touched does not count: the MCAP reader
/// reserves what a length field claims before it finds the record shorter.
fn peak_mib() -> f64 {
    plumbline_support::memory_mib(std::process::id(), "VmHWM")
}

/// Inputs that a decoder once failed on.
fn corpus(name: &str) -> Vec<Vec<u8>> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/corpus").join(name);
    let files =
        std::fs::read_dir(folder).map(|entries| entries.flatten().map(|entry| entry.path()).collect::<Vec<_>>());
    let mut files = files.unwrap_or_default();
    files.sort();
    files.iter().map(|file| std::fs::read(file).unwrap()).collect()
}

/// By which clock a harness is given its minutes.
#[derive(Clone, Copy)]
enum Clock {
    /// Processor time of this thread: all that the harness does is done here.
    Thread,
    /// Wall time: what is tested has threads of its own.
    Wall,
}

impl Clock {
    fn now(self) -> Duration {
        static BEGUN: OnceLock<Instant> = OnceLock::new();
        let mut time = libc::timespec { tv_sec: 0, tv_nsec: 0 };
        match self {
            Self::Wall => return BEGUN.get_or_init(Instant::now).elapsed(),
            // SAFETY: `time` is a valid place for the answer.
            Self::Thread => unsafe { libc::clock_gettime(libc::CLOCK_THREAD_CPUTIME_ID, &raw mut time) },
        };
        Duration::new(time.tv_sec as u64, time.tv_nsec as u32)
    }
}

/// Panics so far of threads that are no test's own. A server answers on although one of its tasks panicked.
pub fn panics() -> u64 {
    static SEEN: AtomicU64 = AtomicU64::new(0);
    static HOOK: Once = Once::new();
    HOOK.call_once(|| {
        let usual = std::panic::take_hook();
        std::panic::set_hook(Box::new(move |info| {
            if !std::thread::current().name().is_some_and(|name| name.contains("fuzz_")) {
                SEEN.fetch_add(1, Ordering::Relaxed);
            }
            usual(info);
        }));
    });
    SEEN.load(Ordering::Relaxed)
}

/// Runs `decoder` on damaged `seeds` for as long as is asked.
pub fn fuzz(name: &str, seeds: &[Vec<u8>], mut decoder: impl FnMut(&[u8])) {
    let seeds = [seeds, &corpus(name)].concat();
    // What is valid passes: else nothing but the first check would be tried.
    seeds.iter().for_each(|valid| decoder(valid));
    pieces(name, Clock::Thread, |chance| damage(chance, &seeds), decoder);
}

/// Runs `harness` on choices drawn at random: it makes what is well formed and odd of them.
pub fn drawn(name: &str, mut harness: impl FnMut(&mut Unstructured<'_>)) {
    let mut run = |choices: &[u8]| harness(&mut Unstructured::new(choices));
    corpus(name).iter().for_each(|choices| run(choices));
    let draw = |chance: &mut Chance| (0..64 << below(chance, 6)).map(|_| chance.number() as u8).collect::<Vec<_>>();
    pieces(name, Clock::Wall, draw, run);
}

/// Runs `decoder` on what `make` makes, for as long as is asked.
fn pieces(name: &str, clock: Clock, make: impl Fn(&mut Chance) -> Vec<u8>, mut decoder: impl FnMut(&[u8])) {
    let minutes: f64 = std::env::var("PLUMBLINE_FUZZ_MINUTES").map_or(0.0, |text| text.parse().unwrap());
    let seed: u64 = std::env::var("PLUMBLINE_SEED").map_or(1, |text| text.parse().unwrap());
    let span = if minutes > 0.0 { Duration::from_secs_f64(60.0 * minutes) } else { SHORT };
    let begun = clock.now();
    for seed in seed.. {
        let left = span.saturating_sub(clock.now().saturating_sub(begun));
        if left.is_zero() {
            break;
        }
        piece(name, clock, &make, &mut decoder, seed, left.min(PIECE));
    }
}

/// Runs `decoder` for so long on what `seed` makes.
fn piece(
    name: &str,
    clock: Clock,
    make: &impl Fn(&mut Chance) -> Vec<u8>,
    decoder: &mut impl FnMut(&[u8]),
    seed: u64,
    span: Duration,
) {
    let mut chance = Chance(seed);
    let (begun, wall) = (clock.now(), Instant::now());
    let (mut inputs, mut slowest) = (0_u64, Duration::ZERO);
    while clock.now().saturating_sub(begun) < span {
        let input = make(&mut chance);
        let started = clock.now();
        let outcome = catch_unwind(AssertUnwindSafe(|| decoder(&input)));
        let took = clock.now().saturating_sub(started);
        inputs += 1;
        slowest = slowest.max(took);
        let peak = if inputs.is_multiple_of(LOOK_EVERY) { peak_mib() } else { 0.0 };
        if outcome.is_err() || took > TIME_MAX || peak > MEMORY_MAX_MIB {
            let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../target/fuzz");
            std::fs::create_dir_all(&folder).unwrap();
            let kept = folder.join(format!("{name}-{seed}-{inputs}"));
            std::fs::write(&kept, &input).unwrap();
            let panicked = outcome.is_err();
            println!(
                "{{\"fuzz\":\"{name}\",\"name\":\"finding\",\"value\":{inputs},\"unit\":\"input\",\"seed\":{seed},\"panicked\":{panicked},\
                 \"took_ms\":{:.0},\"process_peak_mib\":{peak:.0},\"kept\":{kept:?}}}",
                took.as_secs_f64() * 1e3
            );
            panic!("{name}: seed {seed}, input {inputs}: panic {panicked}, {took:?}, {peak:.0} MiB; kept as {kept:?}");
        }
    }
    println!(
        "{{\"fuzz\":\"{name}\",\"name\":\"inputs\",\"value\":{inputs},\"unit\":\"inputs\",\"seed\":{seed},\
         \"minutes\":{:.3},\"wall_s\":{:.1},\"slowest_ms\":{:.3},\"process_peak_mib\":{:.0},\"findings\":0}}",
        clock.now().saturating_sub(begun).as_secs_f64() / 60.0,
        wall.elapsed().as_secs_f64(),
        slowest.as_secs_f64() * 1e3,
        peak_mib()
    );
}

/// A file that decoders which want one read each input from.
pub struct Scratch {
    pub folder: tempfile::TempDir,
}

impl Scratch {
    pub fn new() -> Self {
        // In memory where there is such a folder: the disk is not what is tested.
        let memory = Path::new("/dev/shm");
        let folder = if memory.is_dir() { tempfile::tempdir_in(memory) } else { tempfile::tempdir() };
        Self { folder: folder.unwrap() }
    }

    pub fn with(&self, name: &str, bytes: &[u8]) -> PathBuf {
        let path = self.folder.path().join(name);
        std::fs::write(&path, bytes).unwrap();
        path
    }
}
