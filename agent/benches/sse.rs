//! `cargo xtask bench sse`: the decoders on the reference windows, one thread, one run; JSON lines.
#![allow(clippy::unwrap_used, clippy::expect_used)]

use std::hint::black_box;
use std::path::{Path, PathBuf};
use std::time::Duration;

use nalgebra::DMatrix;
use plumbline_agent::estimate::secure::{
    Program, compress::Compressed, conic::Conic, newton::Newton, newton::Settings,
};

#[derive(serde::Deserialize)]
struct Windows {
    #[serde(rename = "Phi")]
    phi: Vec<Vec<Vec<f64>>>,
    cases: Vec<Window>,
}

#[derive(serde::Deserialize)]
struct Window {
    #[serde(rename = "Y")]
    y: Vec<Vec<f64>>,
}

/// CPU time of this thread.
fn cpu_time() -> Duration {
    let mut time = libc::timespec { tv_sec: 0, tv_nsec: 0 };
    // SAFETY: `time` is a valid, exclusively borrowed timespec for the whole call.
    let status = unsafe { libc::clock_gettime(libc::CLOCK_THREAD_CPUTIME_ID, &raw mut time) };
    assert_eq!(status, 0, "CLOCK_THREAD_CPUTIME_ID");
    Duration::new(time.tv_sec as u64, time.tv_nsec as u32)
}

/// Times `run` on every window, `rounds` times; microseconds, sorted.
fn measure(windows: &[Vec<f64>], rounds: usize, mut run: impl FnMut(&[f64])) -> Vec<f64> {
    windows.iter().for_each(|w| run(w));
    let mut times: Vec<f64> = (0..rounds)
        .flat_map(|_| windows)
        .map(|window| {
            let begun = cpu_time();
            run(black_box(window));
            (cpu_time() - begun).as_secs_f64() * 1e6
        })
        .collect();
    times.sort_by(f64::total_cmp);
    times
}

fn print(name: &str, times: &[f64], ratio: f64) {
    let at = |q: f64| times[((times.len() - 1) as f64 * q) as usize];
    let line = serde_json::json!({
        "bench": "sse", "name": name, "unit": "us", "value": at(0.5), "median": at(0.5), "p99": at(0.99),
        "samples": times.len(), "ratio_to_newton": ratio,
    });
    println!("{line}");
}

fn main() {
    let root = std::env::var_os("PLUMBLINE_DATA")
        .map_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared"), PathBuf::from);
    let path = root.join("reference/sse_windows.json");
    let Ok(text) = std::fs::read_to_string(&path) else {
        println!("{}", serde_json::json!({ "bench": "sse", "skipped": format!("{} is absent", path.display()) }));
        return;
    };
    let file: Windows = serde_json::from_str(&text).unwrap();
    let phi: Vec<_> = file.phi.iter().map(|r| DMatrix::from_fn(r.len(), 10, |i, j| r[i][j])).collect();
    let windows: Vec<Vec<f64>> = file.cases.into_iter().map(|c| c.y.concat()).collect();

    let problem = Compressed::<10>::new(&phi, Program::L2).unwrap();
    // The flying tolerance; the tests use the tighter default.
    let settings = Settings { tolerance: 1e-6, ..Settings::default() };
    let mut newton = Newton::new(&problem, settings);
    let times = measure(&windows, 400, |w| {
        black_box(newton.decode(&problem, w, None).unwrap());
    });
    let median = times[times.len() / 2];
    print("newton l2, cold start", &times, 1.0);

    let mut conic = Conic::new(&problem).unwrap();
    let times = measure(&windows, 20, |w| {
        black_box(conic.decode(&problem, w).unwrap());
    });
    print("clarabel l2, compressed cones, update_b", &times, times[times.len() / 2] / median);

    let problem = Compressed::<10>::new(&phi, Program::L1).unwrap();
    let mut newton = Newton::new(&problem, settings);
    let times = measure(&windows, 40, |w| {
        black_box(newton.decode(&problem, w, None).unwrap());
    });
    print("newton l1, cold start", &times, times[times.len() / 2] / median);
    let mut conic = Conic::new(&problem).unwrap();
    let times = measure(&windows, 5, |w| {
        black_box(conic.decode(&problem, w).unwrap());
    });
    print("clarabel l1, update_b", &times, times[times.len() / 2] / median);
}
