//! The thread that owns a driver: opens it, stamps what it hears, maps the device's clock, opens it again when it is lost.
//!
//! Bounds: [`QUEUE`] readings wait for the flight thread, and [`SCANS`] scans where they are recorded; when a queue is full the
//! newest is given up and counted.

use std::sync::atomic::{AtomicBool, AtomicI64, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, OnceLock};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use plumbline_core::event::Text;
use plumbline_proto::time::FlightTime;
use rtrb::{Consumer, Producer, RingBuffer};

use crate::asking::Asking;
use crate::clock::DeviceClock;
use crate::driver::{Driver, Exchange, Heard, Scanned};
use crate::fault::{DeviceError, Fault};
use crate::reading::Reading;
use crate::scheduling;

/// Readings that may wait: a quarter of a second at 1 kHz.
pub const QUEUE: usize = 256;
/// Scans that may wait: 0.4 s of them.
pub const SCANS: usize = 4;
/// Notices that may wait.
const NOTICES: usize = 16;
/// Shortest span that a rate is counted over, s.
const COUNTED_S: f64 = 0.5;
/// First and longest pause before a device is opened again.
const PAUSES: [Duration; 2] = [Duration::from_millis(100), Duration::from_secs(1)];
/// Transfers in a row that may fail before a device that is asked is opened again: one disturbed edge on a bus costs one reading, while a
/// chip that is set up anew is away for a quarter of a second, in which motors without any other IMU are cut.
const FAILED_TRANSFERS: u32 = 2;
/// A device that talks and gives no reading is opened again after so many times the silence only: opening it brings no body into the
/// cameras' sight and no sky above an antenna, and nobody listens meanwhile. One that is asked may have lost its set-up.
const PATIENT: u32 = 10;

/// When flight time is zero, once that is known, and how often it ticks. Shared by readers and vehicle.
#[derive(Debug, Clone, Default)]
pub struct Zero {
    instant: Arc<OnceLock<Instant>>,
    tick: Option<Duration>,
    set_back_ns: Arc<AtomicI64>,
}

impl Zero {
    /// Of a flight thread that takes what arrived `rate_hz` times a second, from zero on.
    pub fn ticking(rate_hz: f64) -> Self {
        Self { tick: Some(Duration::from_secs_f64(1.0 / rate_hz)), ..Self::default() }
    }

    /// Flight time is zero at `instant`; only the first call counts.
    pub fn set(&self, instant: Instant) {
        let _ = self.instant.set(instant);
    }

    /// The tick that is nearest to `instant`, and the time between two; `None` without ticks, or before zero is known.
    pub(crate) fn nearest_tick(&self, instant: Instant) -> Option<(Instant, Duration)> {
        let (zero, tick) = (*self.instant.get()?, self.tick?);
        let set_back_s = self.set_back_s();
        let since_s = (instant.saturating_duration_since(zero).as_secs_f64() - set_back_s).max(0.0);
        let at_s = (since_s / tick.as_secs_f64()).round() * tick.as_secs_f64() + set_back_s;
        Some((zero + Duration::try_from_secs_f64(at_s).unwrap_or_default(), tick))
    }

    /// Time between two ticks; `None` without.
    pub fn tick(&self) -> Option<Duration> {
        self.tick
    }

    /// From now on flight time is so much less.
    pub fn set_back(&self, by_ns: i64) {
        self.set_back_ns.fetch_add(by_ns, Ordering::Relaxed);
    }

    fn set_back_s(&self) -> f64 {
        self.set_back_ns.load(Ordering::Relaxed) as f64 * 1e-9
    }

    /// Microseconds of flight time at `instant`; `None` before it is known. Negative before zero.
    pub fn micros(&self, instant: Instant) -> Option<f64> {
        let zero = self.instant.get()?;
        let after = instant.saturating_duration_since(*zero).as_secs_f64();
        let before = zero.saturating_duration_since(instant).as_secs_f64();
        Some(1e6 * (after - before - self.set_back_s()))
    }
}

/// A reading with its time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Arrived {
    /// When it was measured.
    pub time: FlightTime,
    /// What.
    pub reading: Reading,
}

/// What is to be told of a device.
#[derive(Debug, Clone, Copy, PartialEq)]
#[expect(clippy::large_enum_variant, reason = "it is copied through a bounded ring: nothing is allocated")]
pub enum Notice {
    /// It gives readings.
    Up,
    /// It does not any more, or not yet.
    Lost(Text),
    /// Its clock went backwards or leapt by so many seconds; the time of its samples begins anew.
    Clock(f64),
}

/// How a device is doing; written by its thread, read by anybody.
#[derive(Debug, Default)]
pub struct State {
    up: AtomicBool,
    readings: AtomicU64,
    faults: AtomicU64,
    given_up: AtomicU64,
    opened: AtomicU64,
    last_us: AtomicU64,
    jitter_ns: AtomicU64,
    skew_ppb: AtomicI64,
    round_trip_ns: AtomicU64,
    clock_offset_ns: AtomicI64,
    reason: Mutex<Text>,
}

/// [`State`] at one moment.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Health {
    /// Does it give readings?
    pub up: bool,
    /// Frames with readings so far.
    pub readings: u64,
    /// Frames given up.
    pub faults: u64,
    /// Readings that the full queue refused.
    pub given_up: u64,
    /// Times it was opened.
    pub opened: u64,
    /// Flight time of the last reading, µs; 0 for none.
    pub last_us: u64,
    /// One sigma of the delays of its frames, µs; 0 without a clock of its own.
    pub jitter_us: f64,
    /// How much faster our clock runs than its own.
    pub skew: f64,
    /// Least time from a question about its clock to the answer, µs; 0 where none was answered lately.
    pub round_trip_us: f64,
    /// Its clock less flight time by those answers, µs; 0 where none was answered lately.
    pub clock_offset_us: f64,
    /// The last fault, or why it is not up.
    pub reason: Text,
}

impl State {
    /// As it is now. Never waits: the reason is missing while its thread writes it.
    pub fn health(&self) -> Health {
        let load = |value: &AtomicU64| value.load(Ordering::Relaxed);
        Health {
            up: self.up.load(Ordering::Relaxed),
            readings: load(&self.readings),
            faults: load(&self.faults),
            given_up: load(&self.given_up),
            opened: load(&self.opened),
            last_us: load(&self.last_us),
            jitter_us: load(&self.jitter_ns) as f64 * 1e-3,
            skew: self.skew_ppb.load(Ordering::Relaxed) as f64 * 1e-9,
            round_trip_us: load(&self.round_trip_ns) as f64 * 1e-3,
            clock_offset_us: self.clock_offset_ns.load(Ordering::Relaxed) as f64 * 1e-3,
            reason: self.reason.try_lock().map_or_else(|_| Text::new(), |reason| *reason),
        }
    }

    /// When the last reading arrived; zero for none.
    pub(crate) fn last(&self) -> FlightTime {
        FlightTime(self.last_us.load(Ordering::Relaxed))
    }

    fn say(&self, reason: Text) {
        *self.reason.lock().unwrap_or_else(std::sync::PoisonError::into_inner) = reason;
    }
}

/// How a reader treats its device.
#[derive(Debug, Clone)]
pub struct Options {
    /// For people.
    pub name: String,
    /// Constant latency of the device, before anything can be measured of it, s.
    pub delay_s: f64,
    /// Without a reading for this long the device is lost, and opened again unless it says why.
    pub silence: Duration,
    /// Whether its thread asks for real-time priority.
    pub real_time: bool,
    /// Whether whole scans are handed over, too.
    pub record_scans: bool,
}

/// The flight thread's end of a reader.
#[derive(Debug)]
pub struct Reader {
    arrived: Consumer<Arrived>,
    scans: Consumer<(FlightTime, Scanned)>,
    notices: Consumer<Notice>,
    state: Arc<State>,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
    /// When readings were counted last, how many there were, and how many a second came before.
    counted: (FlightTime, u64, f64),
    talks: bool,
}

impl Reader {
    /// Starts the thread of `driver`.
    ///
    /// # Errors
    /// No thread could be started.
    pub fn start(driver: Box<dyn Driver>, options: Options, zero: Zero) -> std::io::Result<Self> {
        let (arrivals, arrived) = RingBuffer::new(QUEUE);
        let (scanned, scans) = RingBuffer::new(if options.record_scans { SCANS } else { 0 });
        let (notify, notices) = RingBuffer::new(NOTICES);
        let (state, stop) = (Arc::new(State::default()), Arc::new(AtomicBool::new(false)));
        let talks = driver.period().is_none();
        let mut work = Work {
            driver,
            zero,
            arrivals,
            scanned,
            notify,
            state: state.clone(),
            stop: stop.clone(),
            clock: DeviceClock::default(),
            told: None,
            options,
        };
        let name = format!("dev {}", work.options.name);
        let run = move || {
            if work.options.real_time {
                scheduling::ask_for_real_time(scheduling::READER);
            }
            work.run();
        };
        let thread = std::thread::Builder::new().name(name).spawn(run)?;
        let counted = (FlightTime(0), 0, 0.0);
        Ok(Self { arrived, scans, notices, state, stop, thread: Some(thread), counted, talks })
    }

    /// Does its device speak without being asked?
    pub fn talks(&self) -> bool {
        self.talks
    }

    /// The oldest reading that waits. Never blocks, never allocates.
    pub fn pop(&mut self) -> Option<Arrived> {
        self.arrived.pop().ok()
    }

    /// The oldest scan that waits, with its time. Never blocks, never allocates.
    pub fn scan(&mut self) -> Option<(FlightTime, Scanned)> {
        self.scans.pop().ok()
    }

    /// The oldest notice that waits.
    pub fn notice(&mut self) -> Option<Notice> {
        self.notices.pop().ok()
    }

    /// Frames with readings a second, counted over half a second and more.
    pub fn rate_hz(&mut self, now: FlightTime) -> f64 {
        let (then, before, _) = self.counted;
        let (readings, span_s) = (self.state.readings.load(Ordering::Relaxed), now.seconds_since(then));
        if span_s >= COUNTED_S {
            self.counted = (now, readings, readings.saturating_sub(before) as f64 / span_s);
        }
        self.counted.2
    }

    /// How the device is doing.
    pub fn state(&self) -> &Arc<State> {
        &self.state
    }
}

impl Drop for Reader {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Release);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// What the thread has.
struct Work {
    driver: Box<dyn Driver>,
    options: Options,
    zero: Zero,
    clock: DeviceClock,
    /// Why it was lost the last time.
    told: Option<Text>,
    arrivals: Producer<Arrived>,
    scanned: Producer<(FlightTime, Scanned)>,
    notify: Producer<Notice>,
    state: Arc<State>,
    stop: Arc<AtomicBool>,
}

impl Work {
    fn run(&mut self) {
        let [first, longest] = PAUSES;
        let mut pause = first;
        while !self.stop.load(Ordering::Acquire) {
            let before = self.state.readings.load(Ordering::Relaxed);
            let error = self.use_device();
            self.driver.close();
            if let Some(error) = error {
                lost(&error, &self.options, &self.state, &mut self.told, &mut self.notify);
            }
            let came = self.state.readings.load(Ordering::Relaxed) > before;
            pause = if came { first } else { (2 * pause).min(longest) };
            let until = Instant::now() + pause;
            while Instant::now() < until && !self.stop.load(Ordering::Acquire) {
                std::thread::sleep(Duration::from_millis(20));
            }
        }
    }

    /// Until it is lost, or nobody wants it any more (`None`).
    fn use_device(&mut self) -> Option<DeviceError> {
        if let Err(error) = self.driver.open() {
            return Some(error);
        }
        self.state.opened.fetch_add(1, Ordering::Relaxed);
        self.clock = DeviceClock::default();
        let Self { driver, options, zero, clock, told, arrivals, scanned, notify, state, stop } = self;
        let mut last = Instant::now();
        let (mut stamped, mut fault, mut failed) = (None, None, 0);
        let (mut spoke, mut silent) = (last, false);
        let mut asking = driver.period().map(|period| Asking::new(period, last));
        while !stop.load(Ordering::Acquire) {
            let (mut heard_one, mut speaks, mut time, mut answer) = (false, false, None, None);
            if let Some(asking) = &asking {
                std::thread::sleep(asking.wait(Instant::now()));
            }
            let polled = driver.poll(&mut |heard| match heard {
                Ok(heard) => {
                    (heard_one, answer) = (true, Some(heard.at));
                    // A frame may hold several readings.
                    if heard.stamp.is_none() || heard.stamp != stamped {
                        state.readings.fetch_add(1, Ordering::Relaxed);
                    }
                    stamped = heard.stamp;
                    let taken = take(heard, options, zero, clock, arrivals, state);
                    time = taken.time.or(time);
                    if let Some(jumped_s) = taken.jumped_s {
                        tracing::warn!(device = options.name, jumped_s, "device's clock jumped");
                        let _ = notify.push(Notice::Clock(jumped_s));
                    }
                }
                Err(given) => {
                    (fault, speaks) = (Some(given), true);
                    given_up(given, state);
                }
            });
            match polled {
                Err(error @ DeviceError::Port { .. }) if asking.is_some() && failed < FAILED_TRANSFERS => {
                    failed += 1;
                    given_up(&error, state);
                }
                Err(error) => return Some(error),
                Ok(()) => failed = 0,
            }
            if let Some(asking) = &mut asking {
                let now = Instant::now();
                asking.answered(answer.unwrap_or(now), now, zero);
            }
            if let Some(exchange) = driver.exchange() {
                answered(&exchange, zero, clock, state);
            }
            if let Some(scan) = driver.scan().filter(|_| options.record_scans) {
                // One without a floor has its arrival's.
                let time = time.or_else(|| flight_time(zero.micros(scan.at)? - 1e6 * options.delay_s));
                if time.is_some_and(|time| scanned.push((time, scan)).is_err()) {
                    state.given_up.fetch_add(1, Ordering::Relaxed);
                }
            }
            if driver.speaks() || speaks {
                spoke = Instant::now();
            }
            if heard_one {
                (fault, silent) = (None, false);
                last = Instant::now();
                if !state.up.swap(true, Ordering::AcqRel) {
                    tracing::info!(device = options.name, "device up");
                    let _ = notify.push(Notice::Up);
                }
            } else if last.elapsed() > options.silence {
                // What it says instead of readings tells more than that there is none.
                let none = DeviceError::Silent { what: "reading", seconds: options.silence.as_secs_f64() };
                let error = fault.map_or(none, DeviceError::Frame);
                let patient = asking.is_none() && spoke.elapsed() <= options.silence;
                if !patient || last.elapsed() > PATIENT * options.silence {
                    return Some(error);
                }
                if !std::mem::replace(&mut silent, true) {
                    lost(&error, options, state, told, notify);
                }
            }
        }
        None
    }
}

/// It gives no readings for this reason, which is told unless that is known.
fn lost(error: &DeviceError, options: &Options, state: &State, told: &mut Option<Text>, notify: &mut Producer<Notice>) {
    let reason = error.text();
    state.say(reason);
    let was_up = state.up.swap(false, Ordering::AcqRel);
    if was_up || *told != Some(reason) {
        tracing::warn!(device = options.name, reason = reason.as_str(), "device lost");
        let _ = notify.push(Notice::Lost(reason));
    }
    *told = Some(reason);
}

fn given_up(fault: impl std::fmt::Display, state: &State) {
    state.faults.fetch_add(1, Ordering::Relaxed);
    state.say(plumbline_core::event::text(format_args!("{fault}")));
}

/// Takes an answer about the device's clock in.
fn answered(exchange: &Exchange, zero: &Zero, clock: &mut DeviceClock, state: &State) {
    let (Some(asked_us), Some(answered_us)) = (zero.micros(exchange.asked), zero.micros(exchange.answered)) else {
        return;
    };
    clock.answered(exchange.stamp, asked_us, answered_us);
    let (round_trip_us, offset_us) = clock.offset().unwrap_or_default();
    state.round_trip_ns.store((round_trip_us * 1e3) as u64, Ordering::Relaxed);
    state.clock_offset_ns.store((offset_us * 1e3) as i64, Ordering::Relaxed);
}

/// What became of a reading.
#[derive(Debug, Clone, Copy, Default)]
struct Taken {
    /// When it was measured; `None` before flight time began.
    time: Option<FlightTime>,
    /// By how much its clock jumped, s, if it did.
    jumped_s: Option<f64>,
}

fn flight_time(us: f64) -> Option<FlightTime> {
    (us >= 0.0).then_some(FlightTime(us as u64))
}

/// Stamps a reading and hands it on.
fn take(
    heard: Heard,
    options: &Options,
    zero: &Zero,
    clock: &mut DeviceClock,
    arrivals: &mut Producer<Arrived>,
    state: &State,
) -> Taken {
    // Before flight time begins readings only say that the device is there.
    let Some(arrival_us) = zero.micros(heard.at) else { return Taken::default() };
    let (mut time_us, mut jumped_s) = (arrival_us, None);
    if let Some(stamp) = heard.stamp {
        let mapped = clock.map(stamp, arrival_us);
        jumped_s = mapped.jumped_s;
        if let Some(value) = jumped_s {
            given_up(Fault::Value { what: "clock's jump, s", value, expected: "none" }, state);
        }
        time_us = mapped.time_us;
        state.jitter_ns.store((clock.jitter_us() * 1e3) as u64, Ordering::Relaxed);
        state.skew_ppb.store((clock.skew() * 1e9) as i64, Ordering::Relaxed);
    }
    time_us = (time_us + heard.after_us - 1e6 * options.delay_s).min(arrival_us);
    let time = flight_time(time_us);
    if let Some(time) = time {
        state.last_us.store(arrival_us as u64, Ordering::Relaxed);
        if arrivals.push(Arrived { time, reading: heard.reading }).is_err() {
            state.given_up.fetch_add(1, Ordering::Relaxed);
        }
    }
    Taken { time, jumped_s }
}
