//! Full and read-only data folders, of ground and agent: recording stops loudly, the flight goes on.
//!
//! Each folder is a small file system in memory, filled up by a ballast file or mounted read-only. Where nothing may be
//! mounted, the campaign says that it was skipped, and why.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, Instant};

use super::figures::{Figures, setting};
use plumbline_proto::{Kind, v1};
use plumbline_support::system::{Live, PATIENCE, options, scenario};
use plumbline_tests::harness::{System, wait_until};
use serde_json::{Value, json};

/// The disk is looked at once a second; a failed write shows at once.
const NOTICED_WITHIN_S: f64 = 2.5;
/// Ticks of a flight that nothing disturbs, on a machine that does other things.
const TICKS_MIN_HZ: f64 = 190.0;
/// Larger than the reserves of ground (64 MiB) and agent (32 MiB).
const DISK_MIB: u64 = 128;

/// A small file system; unmounted when dropped.
struct Disk {
    at: PathBuf,
}

impl Disk {
    fn mount(at: &Path) -> Result<Self, String> {
        std::fs::create_dir_all(at).unwrap();
        let size = format!("size={DISK_MIB}m");
        let mounted = Command::new("mount").args(["-t", "tmpfs", "-o", &size, "tmpfs"]).arg(at).output();
        match mounted {
            Ok(ran) if ran.status.success() => Ok(Self { at: at.to_owned() }),
            Ok(ran) => Err(String::from_utf8_lossy(&ran.stderr).trim().to_owned()),
            Err(error) => Err(format!("mount: {error}")),
        }
    }

    /// Leaves `left` free bytes.
    fn fill(&self, left: u64) {
        let ballast = std::fs::File::create(self.at.join("ballast")).unwrap();
        let free = free_bytes(&self.at);
        let chunk = vec![0_u8; 1 << 20];
        let mut writer = std::io::BufWriter::new(ballast);
        for _ in 0..free.saturating_sub(left) >> 20 {
            std::io::Write::write_all(&mut writer, &chunk).unwrap();
        }
    }

    fn empty(&self) {
        std::fs::remove_file(self.at.join("ballast")).unwrap();
    }

    fn remount(&self, mode: &str) {
        let ran = Command::new("mount").args(["-o", &format!("remount,{mode}")]).arg(&self.at).output().unwrap();
        assert!(ran.status.success(), "{}", String::from_utf8_lossy(&ran.stderr));
    }
}

impl Drop for Disk {
    fn drop(&mut self) {
        let _ = Command::new("umount").arg("--lazy").arg(&self.at).output();
    }
}

fn free_bytes(at: &Path) -> u64 {
    let ran = Command::new("df").args(["--output=avail", "-B1"]).arg(at).output().unwrap();
    String::from_utf8_lossy(&ran.stdout).lines().nth(1).unwrap().trim().parse().unwrap()
}

/// The flight as a viewer sees it.
struct Watch<'a> {
    system: &'a System,
    live: Live,
}

impl<'a> Watch<'a> {
    fn of(system: &'a System) -> Self {
        let live = Live::connect(system.api(), &system.vehicle("live?history=0"));
        Self { system, live }
    }

    fn command(&self, route: &str, body: Value) -> (u16, String) {
        let reply = self.system.api().send("POST", &self.system.vehicle(route), &body).unwrap();
        (reply.status, reply.text())
    }

    fn fly(&self) {
        let armed = wait_until(PATIENCE, || (self.command("arm", json!({})).0 == 200).then_some(()));
        assert!(armed.is_some(), "not armed: {:?}", self.command("arm", json!({})));
        self.command("mode", json!({ "mode": "altitude_hold" }));
        self.command("setpoint", json!({ "altitude_m": 0.5 }));
    }

    /// Seconds until `holds` of a status.
    fn until(&mut self, holds: impl Fn(&v1::Status) -> bool) -> f64 {
        let begun = Instant::now();
        self.live
            .until(PATIENCE, "status", |frame| frame.message::<v1::Status>(Kind::Status).filter(&holds).map(|_| ()));
        begun.elapsed().as_secs_f64()
    }

    /// Lands, and waits until it stands.
    fn land(&mut self) {
        self.command("mode", json!({ "mode": "land" }));
        self.until(|status| !status.armed);
        self.until(|status| status.checks.iter().all(|check| check.passed || check.name == "log"));
    }

    /// Control ticks a second over two seconds, and whether it is armed.
    fn ticks_hz(&mut self) -> (f64, bool) {
        let begun = Instant::now();
        let (mut ticks, mut armed) = (0, false);
        while begun.elapsed() < Duration::from_secs(2) {
            let frame = self.live.frame();
            ticks += u32::from(frame.is(Kind::Control));
            if let Some(status) = frame.message::<v1::Status>(Kind::Status) {
                armed = status.armed;
            }
        }
        (f64::from(ticks) / begun.elapsed().as_secs_f64(), armed)
    }

    fn recording_error(&self) -> Option<String> {
        let ground = self.system.api().get_json("/api/v1/ground").ok()?;
        ground["recording_error"].as_str().map(str::to_owned)
    }

    fn goes_on(&mut self, figures: &mut Figures, name: &str) {
        let (hz, armed) = self.ticks_hz();
        figures.at_least(&format!("{name}_flight_goes_on"), hz, TICKS_MIN_HZ, "Hz", json!({ "armed": armed }));
        assert!(armed, "{name}: the flight ended");
    }
}

fn seconds_until(mut holds: impl FnMut() -> bool) -> f64 {
    let begun = Instant::now();
    wait_until(PATIENCE, || holds().then_some(())).map_or(f64::NAN, |()| begun.elapsed().as_secs_f64())
}

pub fn run() -> std::process::ExitCode {
    let mut figures = Figures::new("disk", setting("PLUMBLINE_SEED", 1));
    let folder = tempfile::tempdir().unwrap();
    let options = options(folder.path());
    let mounted = Disk::mount(&options.data.join("ground"))
        .and_then(|ground| Ok((ground, Disk::mount(&options.data.join("iris-1/log"))?)));
    let (ground, log) = match mounted {
        Ok(disks) => disks,
        Err(reason) => {
            figures.skip("disk", &reason);
            return figures.finish();
        }
    };
    let vehicle = scenario("altitude_step");
    let system = System::start(&options, &vehicle).unwrap();
    {
        let mut watch = Watch::of(&system);
        ground_full(&mut figures, &mut watch, &ground);
        log_full(&mut figures, &mut watch, &log);
    }
    system.stop().unwrap();

    // Both start on folders that cannot be written.
    ground.remount("ro");
    log.remount("ro");
    let system = System::start(&options, &vehicle).unwrap();
    read_only(&mut figures, &mut Watch::of(&system));
    system.stop().unwrap();
    figures.finish()
}

/// The ground's disk fills up in flight.
fn ground_full(figures: &mut Figures, watch: &mut Watch, ground: &Disk) {
    watch.fly();
    watch.ticks_hz();
    ground.fill(16 << 20);
    let noticed = seconds_until(|| watch.recording_error().is_some());
    figures.at_most(
        "ground_full_shown_after",
        noticed,
        NOTICED_WITHIN_S,
        "s",
        json!({ "error": watch.recording_error() }),
    );
    watch.goes_on(figures, "ground_full");
    ground.empty();
    let recovered = seconds_until(|| watch.recording_error().is_none());
    figures.at_most("ground_records_again_after", recovered, NOTICED_WITHIN_S, "s", json!({}));
    watch.ticks_hz();
    watch.land();
    let complete = wait_until(Duration::from_secs(60), || {
        let flights = watch.system.api().get_json("/api/v1/flights?limit=1000").ok()?;
        let flight = flights["flights"].get(0)?.clone();
        (flight["completeness"] == "complete").then_some(flight)
    });
    let flight = complete.expect("a complete flight");
    figures.at_most(
        "missing_after_ground_full",
        flight["missing"].as_f64().unwrap(),
        0.0,
        "messages",
        json!({ "filled": flight["filled"], "live": flight["live"] }),
    );
}

/// The agent's disk fills up in flight.
fn log_full(figures: &mut Figures, watch: &mut Watch, log: &Disk) {
    watch.fly();
    log.fill(8 << 20);
    let noticed = watch.until(|status| !status.log_healthy);
    figures.at_most("log_full_shown_after", noticed, NOTICED_WITHIN_S, "s", json!({}));
    watch.goes_on(figures, "log_full");
    watch.land();
    watch.until(|status| status.checks.iter().any(|check| check.name == "log" && !check.passed));
    let (status, text) = watch.command("arm", json!({}));
    figures.at_least("log_full_arming_refused", f64::from(status), 409.0, "status", json!({ "answer": text }));
    log.empty();
    watch.fly();
    watch.ticks_hz();
    watch.land();
}

/// Nothing can be written from the start.
fn read_only(figures: &mut Figures, watch: &mut Watch) {
    let shown = seconds_until(|| watch.recording_error().is_some());
    figures.at_most(
        "ground_read_only_shown_after",
        shown,
        NOTICED_WITHIN_S,
        "s",
        json!({ "error": watch.recording_error() }),
    );
    let ready = || {
        watch.system.api().get_json("/api/v1/flights?limit=1000").is_ok_and(|list| list["ready"] == true).then_some(())
    };
    wait_until(PATIENCE, ready).expect("every file looked at");
    let listed =
        watch.system.api().get_json("/api/v1/flights?limit=1000").unwrap()["flights"].as_array().map_or(0, Vec::len);
    figures.at_least("ground_read_only_flights_served", listed as f64, 2.0, "flights", json!({}));
    let noticed = watch.until(|status| !status.log_healthy);
    figures.at_most("log_read_only_shown_after", noticed, NOTICED_WITHIN_S, "s", json!({}));
    let (hz, _) = watch.ticks_hz();
    figures.at_least("read_only_ticks", hz, TICKS_MIN_HZ, "Hz", json!({}));
    let (status, text) = watch.command("arm", json!({}));
    figures.at_least("read_only_arming_refused", f64::from(status), 409.0, "status", json!({ "answer": text }));
}
