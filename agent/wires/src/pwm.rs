//! The kernel's PWM as a folder: named pipes where `/sys/class/pwm/pwmchip0` has its files, and its rules about them.

use std::fs::File;
use std::io::{self, Read as _};
use std::os::unix::fs::OpenOptionsExt as _;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU8, AtomicU64, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

use plumbline_core::types::ROTORS;

use crate::{Plug, PulseLog, keep};

/// How often pipes are looked at.
const LOOK: Duration = Duration::from_micros(500);

/// One pipe's end, open for both ways so that it never ends.
struct Pipe {
    file: File,
    open: String,
}

impl Pipe {
    fn make(path: &Path) -> io::Result<Self> {
        let name = std::ffi::CString::new(path.as_os_str().as_encoded_bytes()).map_err(io::Error::other)?;
        // SAFETY: a plain system call with a string that ends in zero.
        if unsafe { libc::mkfifo(name.as_ptr(), 0o600) } != 0 {
            return Err(io::Error::last_os_error());
        }
        let file = File::options().read(true).write(true).custom_flags(libc::O_NONBLOCK).open(path)?;
        Ok(Self { file, open: String::new() })
    }

    /// The numbers that were written since.
    fn numbers(&mut self) -> Vec<u64> {
        let mut bytes = [0; 512];
        while let Ok(count @ 1..) = self.file.read(&mut bytes) {
            self.open += &String::from_utf8_lossy(&bytes[..count]);
        }
        let Some(end) = self.open.rfind('\n') else { return Vec::new() };
        let lines: String = self.open.drain(..=end).collect();
        lines.lines().filter_map(|line| line.trim().parse().ok()).collect()
    }
}

/// A channel that was exported.
struct Channel {
    number: u64,
    period: Pipe,
    duty: Pipe,
    enable: Pipe,
    period_ns: u64,
    duty_ns: u64,
    enabled: bool,
}

impl Channel {
    fn export(chip: &Path, number: u64) -> io::Result<Self> {
        // A folder of another name first: whoever waits for it finds its files in it.
        let (made, folder) = (chip.join(format!("new{number}")), chip.join(format!("pwm{number}")));
        std::fs::create_dir(&made)?;
        let [period, duty, enable] = ["period", "duty_cycle", "enable"].map(|name| Pipe::make(&made.join(name)));
        let channel =
            Self { number, period: period?, duty: duty?, enable: enable?, period_ns: 0, duty_ns: 0, enabled: false };
        std::fs::rename(made, folder)?;
        Ok(channel)
    }

    /// Takes what was written; how many values the kernel would have refused, and whether any pulse was set.
    fn look(&mut self) -> (u64, bool) {
        let (mut refused, mut set) = (0, false);
        // The driver waits for no answer between its files; what it wrote before something that is read here is there too.
        let (enables, duties) = (self.enable.numbers(), self.duty.numbers());
        for ns in self.period.numbers() {
            if ns >= self.duty_ns && ns > 0 { self.period_ns = ns } else { refused += 1 }
        }
        for ns in duties {
            // Zero into a channel without a period is what a driver begins with, and the kernel refuses it or not by version.
            if ns <= self.period_ns { (self.duty_ns, set) = (ns, true) } else { refused += 1 }
        }
        for value in enables {
            if self.period_ns > 0 { self.enabled = value == 1 } else { refused += 1 }
        }
        (refused, set)
    }

    fn width_us(&self) -> f64 {
        if self.enabled { self.duty_ns as f64 * 1e-3 } else { 0.0 }
    }
}

/// What is seen of it from outside.
#[derive(Debug, Clone, Default)]
pub struct Seen {
    /// Values that the kernel would have refused.
    pub refused: Arc<AtomicU64>,
    /// Longest period, ns.
    pub period_ns: Arc<AtomicU64>,
}

/// Serves the chip's folder `chip`; plugged out it is not there.
pub fn serve(
    chip: PathBuf,
    pulses: PulseLog,
    plug: Arc<AtomicU8>,
    seen: Seen,
    stop: Arc<AtomicBool>,
) -> io::Result<JoinHandle<()>> {
    std::fs::create_dir_all(&chip)?;
    let mut export = Pipe::make(&chip.join("export"))?;
    let away = chip.with_extension("away");
    std::thread::Builder::new().name("pwm".into()).spawn(move || {
        let mut channels: Vec<Channel> = Vec::new();
        let mut there = true;
        while !stop.load(Ordering::Acquire) {
            std::thread::sleep(LOOK);
            let wanted = plug.load(Ordering::Acquire) == Plug::In as u8;
            if wanted != there {
                let (from, to) = if wanted { (&away, &chip) } else { (&chip, &away) };
                there = wanted == std::fs::rename(from, to).is_ok();
            }
            for number in export.numbers() {
                if channels.iter().all(|channel| channel.number != number) {
                    channels.extend(Channel::export(&chip, number));
                }
            }
            let mut any = false;
            for channel in &mut channels {
                let (refused, set) = channel.look();
                any |= set;
                seen.refused.fetch_add(refused, Ordering::Relaxed);
                seen.period_ns.fetch_max(channel.period_ns, Ordering::Relaxed);
            }
            if any {
                let mut widths = [0.0; ROTORS];
                for (number, width) in (0..).zip(&mut widths) {
                    *width = channels.iter().find(|c| c.number == number).map_or(0.0, Channel::width_us);
                }
                keep(&pulses, widths);
            }
        }
    })
}

#[cfg(test)]
mod tests {
    use std::time::Instant;

    use plumbline_devices::motors::{Pulses as _, Sysfs};

    use super::*;

    /// GIVEN a driver that writes its files without waiting WHEN it opens the chip, as often as not while they are looked at,
    /// THEN every channel of it is enabled.
    #[test]
    fn what_is_written_in_one_look_is_taken_in_the_order_it_was_written() {
        let folder = std::env::temp_dir().join(format!("plumbline-pwm-{}", std::process::id()));
        for round in 0..100 {
            let (chip, stop, seen) = (folder.join(round.to_string()), Arc::default(), Seen::default());
            let pulses = PulseLog::default();
            let thread =
                serve(chip.clone(), pulses.clone(), crate::plugged_in(), seen.clone(), Arc::clone(&stop)).unwrap();
            let mut driver = Sysfs { chip, channels: [0, 1, 2, 3], rate_hz: 400.0 };
            driver.open().unwrap();
            driver.set(&[1000.0; ROTORS]).unwrap();
            let begun = Instant::now();
            let set = || crate::lock(&pulses).back().is_some_and(|(_, widths)| *widths == [1000.0; ROTORS]);
            while !set() {
                assert!(begun.elapsed() < Duration::from_secs(1), "round {round}: {:?}", crate::lock(&pulses).back());
                std::thread::sleep(LOOK);
            }
            stop.store(true, Ordering::Release);
            thread.join().unwrap();
            assert_eq!(seen.refused.load(Ordering::Relaxed), 0);
        }
        std::fs::remove_dir_all(folder).unwrap();
    }
}
