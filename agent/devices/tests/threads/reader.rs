//! A reader and its device: lost, hanging, back; a full queue; scans.

use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::{Duration, Instant};

use plumbline_devices::clock::Stamp;
use plumbline_devices::driver::{Driver, Heard, Outlet, Scanned};
use plumbline_devices::reader::{Notice, Options, QUEUE, Reader, SCANS, Zero};
use plumbline_devices::{DeviceError, Fault, Reading};

/// What the device does: 0 talks, 1 hangs, 2 is gone.
#[derive(Default)]
struct Fake(Arc<AtomicU32>);

impl Driver for Fake {
    fn open(&mut self) -> Result<(), DeviceError> {
        match self.0.load(Ordering::Relaxed) {
            2 => Err(DeviceError::Silent { what: "port", seconds: 0.0 }),
            _ => Ok(()),
        }
    }

    fn poll(&mut self, out: &mut Outlet<'_>) -> Result<(), DeviceError> {
        std::thread::sleep(Duration::from_millis(1));
        match self.0.load(Ordering::Relaxed) {
            0 => {
                out(Ok(Heard { at: Instant::now(), stamp: None, after_us: 0.0, reading: Reading::Battery(14.8) }));
                out(Err(Fault::Malformed("frame")));
            }
            2 => return Err(Fault::Malformed("port").into()),
            _ => {}
        }
        Ok(())
    }
}

fn until(what: &str, mut done: impl FnMut() -> bool) {
    let begun = Instant::now();
    while !done() {
        assert!(begun.elapsed() < Duration::from_secs(20), "{what}");
        std::thread::sleep(Duration::from_millis(1));
    }
}

/// Of a device that is lost after so much silence.
fn options(name: &str, silence: Duration) -> Options {
    Options { name: name.into(), delay_s: 0.0, silence, real_time: false, record_scans: false }
}

fn start(zero: &Zero) -> (Arc<AtomicU32>, Reader) {
    let does = Arc::<AtomicU32>::default();
    let options = Options { delay_s: 0.002, ..options("fake", Duration::from_millis(200)) };
    (does.clone(), Reader::start(Box::new(Fake(does)), options, zero.clone()).unwrap())
}

#[test]
fn a_device_that_is_lost_or_hangs_is_told_and_comes_back() {
    let zero = Zero::default();
    let (does, mut reader) = start(&zero);
    let told = |reader: &mut Reader, up: bool, reason: &str| {
        let fits = |notice: Notice| match notice {
            Notice::Up => up,
            Notice::Lost(why) => !up && why.contains(reason),
            Notice::Clock(_) => false,
        };
        until(reason, || reader.notice().is_some_and(fits));
    };
    told(&mut reader, true, "");
    assert_eq!(reader.pop(), None, "nothing before flight time begins");
    zero.set(Instant::now() - Duration::from_secs(1));
    until("a reading", || reader.pop().is_some_and(|arrived| arrived.time.as_seconds() > 0.9));
    does.store(1, Ordering::Relaxed);
    told(&mut reader, false, "no reading within 0.20 s");
    does.store(2, Ordering::Relaxed);
    until("gone", || reader.state().health().reason.contains("no port"));
    does.store(0, Ordering::Relaxed);
    told(&mut reader, true, "");
    let health = reader.state().health();
    assert!(health.up && health.opened >= 2 && health.faults > 0, "{health:?}");
}

#[test]
fn a_full_queue_keeps_the_oldest_and_counts_the_rest() {
    let zero = Zero::default();
    zero.set(Instant::now());
    let (_, mut reader) = start(&zero);
    until("full", || reader.state().health().given_up > 10);
    let kept: Vec<_> = std::iter::from_fn(|| reader.pop()).take(QUEUE).collect();
    assert_eq!(kept.len(), QUEUE);
    assert!(kept.windows(2).all(|pair| pair[0].time <= pair[1].time));
}

/// A chip on a bus, asked two hundred times a second, of which so many transfers fail.
struct Chip(Arc<AtomicU32>);

impl Driver for Chip {
    fn open(&mut self) -> Result<(), DeviceError> {
        Ok(())
    }

    fn period(&self) -> Option<Duration> {
        Some(Duration::from_millis(5))
    }

    fn poll(&mut self, out: &mut Outlet<'_>) -> Result<(), DeviceError> {
        if self.0.fetch_update(Ordering::AcqRel, Ordering::Acquire, |left| left.checked_sub(1)).is_ok() {
            let source = std::io::Error::from_raw_os_error(121);
            return Err(DeviceError::Port { port: "/dev/i2c-1".into(), source });
        }
        out(Ok(Heard { at: Instant::now(), stamp: None, after_us: 0.0, reading: Reading::Battery(14.8) }));
        Ok(())
    }
}

#[test]
fn two_failed_transfers_cost_two_readings_and_the_third_the_device() {
    let zero = Zero::default();
    zero.set(Instant::now());
    let options = options("chip", Duration::from_millis(500));
    let fail = Arc::<AtomicU32>::default();
    let mut reader = Reader::start(Box::new(Chip(fail.clone())), options, zero).unwrap();
    until("up", || reader.notice() == Some(Notice::Up));
    for times in 1..=5 {
        while reader.pop().is_some() {}
        fail.store(2, Ordering::Release);
        until("failed and read again", || fail.load(Ordering::Acquire) == 0 && reader.pop().is_some());
        until("read again", || reader.pop().is_some());
        let health = reader.state().health();
        assert!(health.up && health.opened == 1 && health.faults == 2 * times, "{health:?}");
        assert!(health.reason.starts_with("/dev/i2c-1: "), "{health:?}");
    }
    assert_eq!(reader.notice(), None);
    fail.store(3, Ordering::Release);
    until("lost", || matches!(reader.notice(), Some(Notice::Lost(why)) if why.starts_with("/dev/i2c-1: ")));
    until("back", || reader.notice() == Some(Notice::Up));
    assert_eq!(reader.state().health().opened, 2);
}

/// A device with a clock of its own, a hundred times a second; after a second of frames it goes a minute back.
struct Clocked(u64);

impl Driver for Clocked {
    fn open(&mut self) -> Result<(), DeviceError> {
        Ok(())
    }

    fn poll(&mut self, out: &mut Outlet<'_>) -> Result<(), DeviceError> {
        std::thread::sleep(Duration::from_millis(10));
        self.0 += 10;
        let ticks = if self.0 > 101_000 { self.0 - 60_000 } else { self.0 };
        let stamp = Some(Stamp { ticks, tick_us: 1e3, roll_over: 1 << 32 });
        out(Ok(Heard { at: Instant::now(), stamp, after_us: 0.0, reading: Reading::Battery(14.8) }));
        Ok(())
    }
}

#[test]
fn a_clock_that_goes_backwards_is_told_and_no_sample_goes_with_it() {
    let zero = Zero::default();
    zero.set(Instant::now());
    let options = options("clocked", Duration::from_secs(5));
    let mut reader = Reader::start(Box::new(Clocked(100_000)), options, zero).unwrap();
    let (mut told, mut last) = (None, plumbline_proto::time::FlightTime(0));
    until("told", || {
        while let Some(arrived) = reader.pop() {
            // A pause of this thread moves the line a little, and never by the jump.
            assert!(arrived.time.seconds_since(last).abs() < 2.0, "{} after {last}", arrived.time);
            last = arrived.time;
        }
        told = told.or(reader.notice().filter(|notice| matches!(notice, Notice::Clock(_))));
        told.is_some()
    });
    let Some(Notice::Clock(jumped_s)) = told else { panic!("{told:?}") };
    assert!((jumped_s + 60.0).abs() < 1.0, "{jumped_s}");
    until("goes on", || reader.pop().is_some_and(|arrived| arrived.time.as_seconds() > 0.9));
}

/// What it says: 0 frames that are whole, and of another version, 1 such as hold no reading, 2 readings.
struct Other(Arc<AtomicU32>);

impl Driver for Other {
    fn open(&mut self) -> Result<(), DeviceError> {
        Ok(())
    }

    fn poll(&mut self, out: &mut Outlet<'_>) -> Result<(), DeviceError> {
        std::thread::sleep(Duration::from_millis(10));
        match self.0.load(Ordering::Relaxed) {
            0 => out(Err(Fault::Value { what: "frame version", value: 2.0, expected: "1" })),
            2 => out(Ok(Heard { at: Instant::now(), stamp: None, after_us: 0.0, reading: Reading::Battery(14.8) })),
            _ => {}
        }
        Ok(())
    }

    fn speaks(&mut self) -> bool {
        self.0.load(Ordering::Relaxed) == 1
    }
}

#[test]
fn a_device_that_speaks_another_version_is_lost_for_that_and_heard_all_the_while() {
    let (says, silence) = (Arc::<AtomicU32>::default(), Duration::from_millis(500));
    let mut reader = Reader::start(Box::new(Other(says.clone())), options("other", silence), Zero::default()).unwrap();
    until("lost", || matches!(reader.notice(), Some(Notice::Lost(why)) if why.as_str() == "frame version 2 is not 1"));
    says.store(1, Ordering::Relaxed);
    std::thread::sleep(2 * silence);
    let health = reader.state().health();
    assert!(!health.up && reader.notice().is_none(), "told once: {health:?}");
    says.store(2, Ordering::Relaxed);
    until("up", || reader.notice() == Some(Notice::Up));
    assert_eq!(reader.state().health().opened, 1);
}

/// A scanner with a clock of its own that finds a floor in every second scan.
struct Scanner(u32);

impl Driver for Scanner {
    fn open(&mut self) -> Result<(), DeviceError> {
        Ok(())
    }

    fn poll(&mut self, out: &mut Outlet<'_>) -> Result<(), DeviceError> {
        std::thread::sleep(Duration::from_millis(10));
        self.0 += 1;
        let stamp = Some(Stamp { ticks: (10 * self.0).into(), tick_us: 1e3, roll_over: 1 << 24 });
        out(if self.0.is_multiple_of(2) {
            let reading = Reading::Battery(f64::from(self.0));
            Ok(Heard { at: Instant::now(), stamp, after_us: -3e3, reading })
        } else {
            Err(Fault::Malformed("floor"))
        });
        Ok(())
    }

    fn scan(&mut self) -> Option<Scanned> {
        let ranges_mm = std::iter::repeat_n(self.0 as u16, 7).collect();
        Some(Scanned { at: Instant::now(), stamp_ms: 10 * self.0, ranges_mm })
    }
}

#[test]
fn scans_are_handed_over_where_they_are_asked_for_at_the_time_of_what_was_found_in_them() {
    let zero = Zero::default();
    zero.set(Instant::now() - Duration::from_secs(1));
    let options = |record_scans| Options { record_scans, ..options("scanner", Duration::from_secs(5)) };
    let mut reader = Reader::start(Box::new(Scanner(0)), options(true), zero.clone()).unwrap();
    until("more than there is room for", || reader.state().health().given_up > 2);
    let scans: Vec<_> = std::iter::from_fn(|| reader.scan()).take(SCANS).collect();
    assert_eq!(
        scans.iter().map(|(_, scan)| scan.stamp_ms).collect::<Vec<_>>(),
        [10, 20, 30, 40],
        "the oldest are kept"
    );
    let found: Vec<_> = std::iter::from_fn(|| reader.pop()).take(2).collect();
    for (time, scan) in &scans {
        let number = scan.stamp_ms / 10;
        assert_eq!(scan.ranges_mm[..], [number as u16; 7]);
        let own = found.iter().find(|arrived| arrived.reading == Reading::Battery(f64::from(number)));
        assert_eq!(own.map(|arrived| arrived.time), number.is_multiple_of(2).then_some(*time), "scan {number}");
    }
    let mut reader = Reader::start(Box::new(Scanner(0)), options(false), zero).unwrap();
    until("readings", || reader.pop().is_some());
    assert_eq!(reader.scan(), None, "nobody asked");
}
