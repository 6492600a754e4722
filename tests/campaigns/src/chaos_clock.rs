//! What clocks do to the system: drift of two crystals for a day and more, a clock that stands or is slewed, delay that
//! varies, a ground that is stopped in flight, and steps of either side's wall clock, to 1970 as well.
//!
//! The first part is the agent's estimate of how late a command is, fed with `PLUMBLINE_SECONDS` simulated hours. The
//! rest are real processes; their wall clocks are moved by libfaketime (Debian's `libfaketime`, or the file that
//! `PLUMBLINE_FAKETIME` names), and where there is none that part says that it was skipped.

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use super::figures::{Figures, setting};
use plumbline_agent::link::lateness::{COMMAND_MAX_AGE_S, Lateness};
use plumbline_proto::{Kind, v1};
use plumbline_support::files;
use plumbline_support::system::{PATIENCE, Rig, options, scenario};
use plumbline_tests::harness::radio::Chance;
use plumbline_tests::harness::{Agent, Ground, System, wait_until};
use serde_json::json;

const DRIFTS_PPM: [f64; 9] = [-200.0, -100.0, -50.0, -10.0, 0.0, 10.0, 50.0, 100.0, 200.0];
/// A clock that stood must be the measure again within this, s.
const TRUSTED_WITHIN_S: f64 = 10.5;
/// Steps of a wall clock, s: a time server's small one, an hour, a day back, and a computer without a clock that wakes
/// in 1970.
const STEPS_S: [i64; 5] = [2, 3_600, -3_600, -86_400, -1_767_225_600];
/// Longer than a picture may be old, shorter than the link needs to give up.
const STOOD_FOR: Duration = Duration::from_millis(2_500);
const AGE_MAX_MS: f64 = 500.0;
/// A recording's times may step back by this from message to message, ms; the least step of a clock is 2 s.
const BACK_MAX_MS: f64 = 100.0;

pub fn run() -> std::process::ExitCode {
    let (hours, seed) = (setting("PLUMBLINE_SECONDS", 25), setting("PLUMBLINE_SEED", 1));
    let mut figures = Figures::new("clock", seed);
    for ppm in DRIFTS_PPM {
        drift(&mut figures, ppm, hours, seed);
    }
    stood(&mut figures);
    stopped_ground(&mut figures);
    asked_of_a_stopped_ground(&mut figures);
    let known = [
        "/usr/lib/x86_64-linux-gnu/faketime/libfaketimeMT.so.1",
        "/usr/lib/aarch64-linux-gnu/faketime/libfaketimeMT.so.1",
    ];
    let named = std::env::var_os("PLUMBLINE_FAKETIME").map(PathBuf::from);
    match named.or_else(|| known.map(PathBuf::from).into_iter().find(|path| path.exists())) {
        Some(library) => steps(&mut figures, &library),
        None => figures.skip("wall_clock_steps", "libfaketime is not installed, and PLUMBLINE_FAKETIME names none"),
    }
    figures.finish()
}

/// Heartbeats with a jitter of 20 ms over clocks that drift; once an hour a command waits out a fade of 3 s.
fn drift(figures: &mut Figures, ppm: f64, hours: u64, seed: u64) {
    let begun = Instant::now();
    let mut chance = Chance(seed);
    let mut lateness = Lateness::new(begun);
    let (mut refused, mut commands, mut stale_taken, mut fades) = (0, 0, 0, 0);
    for beat in 0..hours * 36_000 {
        let s = beat as f64 * 0.1;
        let sent_us = (1e6 * (1_000.0 + s * (1.0 + ppm * 1e-6))) as u64;
        let at = |s: f64| begun + Duration::from_secs_f64(s);
        let way_s = 0.003 + 0.02 * chance.draw();
        lateness.heartbeat(sent_us, at(s + way_s), Duration::from_millis(20));
        if beat % 10 == 0 {
            commands += 1;
            refused += u32::from(lateness.command_s(at(s + way_s + 0.07)) > COMMAND_MAX_AGE_S);
        }
        if beat % 36_000 == 35_000 {
            fades += 1;
            stale_taken += u32::from(lateness.command_s(at(s + 3.0)) <= COMMAND_MAX_AGE_S);
        }
    }
    let more = json!({ "hours": hours, "commands": commands });
    figures.at_most(&format!("drift_{ppm}_ppm_refused"), f64::from(refused), 0.0, "commands", more);
    let more = json!({ "fades": fades });
    figures.at_most(&format!("drift_{ppm}_ppm_stale_taken"), f64::from(stale_taken), 0.0, "commands", more);
}

/// The ground's clock stands for 2.5 s (a computer suspended), or is slewed by 5 % for 40 s.
fn stood(figures: &mut Figures) {
    for (name, lost_s) in [
        ("stood", (|s: f64| if s > 20.0 { 2.5 } else { 0.0 }) as fn(f64) -> f64),
        ("slewed", |s| 0.05 * (s - 60.0).clamp(0.0, 40.0)),
    ] {
        let begun = Instant::now();
        let mut lateness = Lateness::new(begun);
        let mut refused = 0;
        for beat in 0..3000_u32 {
            let s = f64::from(beat) * 0.1;
            let now = begun + Duration::from_secs_f64(s + 0.005);
            lateness.heartbeat(((1_000.0 + s - lost_s(s)) * 1e6) as u64, now, Duration::from_millis(10));
            refused += u32::from(lateness.command_s(now) > COMMAND_MAX_AGE_S);
        }
        let refused_s = 0.1 * f64::from(refused);
        figures.at_most(&format!("{name}_refused_for"), refused_s, TRUSTED_WITHIN_S, "s", json!({}));
    }
}

/// The ground is stopped for 1.2 s in flight, and goes on: the setpoint freezes and thaws, nothing descends.
fn stopped_ground(figures: &mut Figures) {
    let rig = Rig::start(&scenario("altitude_step"));
    rig.fly_to(0.5);
    std::thread::sleep(Duration::from_secs(3));
    let ground = &rig.system().ground.process;
    ground.signal(libc::SIGSTOP);
    std::thread::sleep(Duration::from_millis(1_200));
    ground.signal(libc::SIGCONT);
    let begun = Instant::now();
    let setpoint = rig.system().vehicle("setpoint");
    let accepted = wait_until(PATIENCE, || {
        rig.api().command("POST", &setpoint, &json!({ "altitude_m": 0.6 })).ok().filter(|r| r["stage"] == "accepted")
    });
    let after_s = accepted.map_or(f64::NAN, |_| begun.elapsed().as_secs_f64());
    figures.at_most("stopped_ground_commands_again_after", after_s, 1.0, "s", json!({}));
    let (status, _) = seen(&rig);
    let still = status.armed && status.failsafe() == v1::Failsafe::None;
    figures.at_least("stopped_ground_flies_on", f64::from(u8::from(still)), 1.0, "yes", json!({}));
    figures.at_most("stopped_ground_cut", cut_ms(&rig), 250.0, "ms", json!({}));
    drop(rig);
}

/// What is asked of a ground that stands still waits in its socket, where no heartbeat tells how long: the vehicle knows by
/// the picture it was asked on.
fn asked_of_a_stopped_ground(figures: &mut Figures) {
    let rig = Rig::start(&scenario("altitude_step"));
    rig.fly_to(0.5);
    let seen_us = rig.live().status("a status", |status| status.armed).time_us;
    let ground = &rig.system().ground.process;
    ground.signal(libc::SIGSTOP);
    let reply = std::thread::scope(|scope| {
        let asked = scope.spawn(|| {
            let body = json!({ "altitude_m": 0.9 }).to_string();
            let seen = [("X-Plumbline-Seen", &*seen_us.to_string())];
            rig.api().request("POST", &rig.system().vehicle("setpoint"), Some(body.as_bytes()), &seen)
        });
        std::thread::sleep(STOOD_FOR);
        ground.signal(libc::SIGCONT);
        asked.join().unwrap()
    });
    let more = json!({ "answer": reply.as_ref().map_or_else(ToString::to_string, |reply| reply.text()) });
    let refused = reply.is_ok_and(|reply| reply.status == 409);
    figures.at_least("asked_of_a_stopped_ground_refused", f64::from(u8::from(refused)), 1.0, "yes", more);
    figures.at_most("asked_of_a_stopped_ground_cut", cut_ms(&rig), 250.0, "ms", json!({}));
}

fn seen(rig: &Rig) -> (v1::Status, v1::LinkStatus) {
    let mut live = rig.live();
    let status = live.status("status", |_| true);
    let link = live.until(PATIENCE, "link", |frame| frame.message::<v1::LinkStatus>(Kind::Link));
    (status, link)
}

/// From the request to its answer.
fn cut_ms(rig: &Rig) -> f64 {
    let begun = Instant::now();
    rig.command("POST", "cut", json!({}));
    begun.elapsed().as_secs_f64() * 1e3
}

/// Steps the wall clock of one side after the other, in flight.
fn steps(figures: &mut Figures, library: &Path) {
    let folder = tempfile::tempdir().unwrap();
    let clocks = ["ground", "agent"].map(|side| folder.path().join(format!("{side}.clock")));
    let faked = |clock: &Path| {
        std::fs::write(clock, "+0").unwrap();
        // SAFETY: nothing else runs in this process now; children inherit it.
        unsafe {
            std::env::set_var("LD_PRELOAD", library);
            std::env::set_var("FAKETIME_DONT_FAKE_MONOTONIC", "1");
            std::env::set_var("FAKETIME_NO_CACHE", "1");
            std::env::set_var("FAKETIME_TIMESTAMP_FILE", clock);
        }
    };
    let options = options(folder.path());
    faked(&clocks[0]);
    let ground = Ground::start(&options).unwrap();
    faked(&clocks[1]);
    let agent = Agent::start(&options, "iris-1", &scenario("altitude_step"), &ground).unwrap();
    // SAFETY: as above.
    unsafe { std::env::remove_var("LD_PRELOAD") };
    let rig = Rig { system: Some(System { ground, agent }), folder };
    rig.fly_to(0.5);
    std::thread::sleep(Duration::from_secs(3));
    for (side, clock) in ["ground", "agent"].into_iter().zip(&clocks) {
        for step_s in STEPS_S {
            std::fs::write(clock, format!("{step_s:+}")).unwrap();
            std::thread::sleep(Duration::from_millis(1_500));
            let altitude_m = if step_s > 0 { 0.5 } else { 0.6 };
            let answer =
                rig.api().command("POST", &rig.system().vehicle("setpoint"), &json!({ "altitude_m": altitude_m }));
            let accepted = answer.as_ref().is_ok_and(|reply| reply["stage"] == "accepted");
            let (status, link) = seen(&rig);
            // A tick is late now and then beneath libfaketime, which is asked for the time by every thread.
            let calm = matches!(status.failsafe(), v1::Failsafe::None | v1::Failsafe::DeadlineWarn);
            let holds = accepted && status.armed && calm;
            let more = json!({ "answer": format!("{answer:?}"), "failsafe": status.failsafe().as_str_name() });
            figures.at_least(&format!("{side}_step_{step_s}_flies_on"), f64::from(u8::from(holds)), 1.0, "yes", more);
            let more = json!({ "clock_offset_ms": link.clock_offset_us * 1e-3 });
            figures.at_most(&format!("{side}_step_{step_s}_age"), link.age_ms, AGE_MAX_MS, "ms", more);
            std::fs::write(clock, "+0").unwrap();
        }
    }
    figures.at_most("steps_cut", cut_ms(&rig), 250.0, "ms", json!({}));
    let flight = rig.finished_flight();
    let id = flight["id"].as_str().unwrap();
    let file = rig.api().get(&format!("/api/v1/flights/{id}/mcap")).unwrap().body;
    let times: Vec<u64> = files::messages(&file).values().map(|message| message.wall_us).collect();
    // What is computed of past windows is stamped with their time, and comes a little later.
    let back_us = times.windows(2).map(|pair| pair[0].saturating_sub(pair[1])).max().unwrap_or_default();
    let more = json!({ "messages": times.len() });
    figures.at_most("steps_time_back", back_us as f64 * 1e-3, BACK_MAX_MS, "ms", more);
    figures.at_least("steps_file_finished", f64::from(u8::from(files::finished(&file))), 1.0, "yes", json!({}));
}
