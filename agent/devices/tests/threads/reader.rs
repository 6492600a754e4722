//! A reader and its device: lost, hanging, back; a full queue.

use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::{Duration, Instant};

use plumbline_devices::driver::{Driver, Heard, Outlet};
use plumbline_devices::reader::{Options, QUEUE, Reader, Zero};
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

fn start(zero: &Zero) -> (Arc<AtomicU32>, Reader) {
    let does = Arc::<AtomicU32>::default();
    let options = Options { name: "fake".into(), delay_s: 0.002, silence: Duration::from_millis(200) };
    (does.clone(), Reader::start(Box::new(Fake(does)), options, zero.clone()).unwrap())
}

#[test]
fn a_device_that_is_lost_or_hangs_is_told_and_comes_back() {
    let zero = Zero::default();
    let (does, mut reader) = start(&zero);
    let told = |reader: &mut Reader, up: bool, reason: &str| {
        until(reason, || reader.notice().is_some_and(|n| n.up == up && n.reason.contains(reason)));
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
