//! What hostile and clumsy clients do, each until it is dropped.

use std::any::Any;
use std::io::{Read as _, Write as _};
use std::net::TcpStream;
use std::process::Command;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;

use serde_json::json;

use super::client::Client;

/// One load: begun by a function, over when what that returns is dropped.
pub struct Load {
    pub name: &'static str,
    pub begin: fn(&Client) -> Box<dyn Any>,
}

pub const PLAIN: &[Load] = &[
    Load { name: "quiet", begin: |_| Box::new(()) },
    Load { name: "sign_in_waits_for_disk", begin: sign_in_waits_for_disk },
    Load { name: "sign_ins_refused", begin: sign_ins_refused },
    Load { name: "commands_flood", begin: commands_flood },
    Load { name: "half_sent_requests", begin: half_sent },
    Load { name: "half_sent_bodies", begin: half_bodies },
    Load { name: "connections_churn", begin: churn },
    Load { name: "stalled_viewers", begin: viewers },
    Load { name: "downloads_in_flight", begin: downloads },
    Load { name: "stalled_downloads", begin: stalled_downloads },
    Load { name: "calibration_uploads", begin: uploads },
    Load { name: "estimates_given_up", begin: estimates_given_up },
];

/// For a ground that may open few files.
pub const SCARCE: &[Load] = &[
    Load { name: "scarce_descriptors_silent", begin: silent },
    Load { name: "scarce_descriptors_viewers", begin: viewers },
];

pub const TLS: &[Load] = &[
    Load { name: "tls_quiet", begin: |_| Box::new(()) },
    Load { name: "tls_silent", begin: silent },
    Load { name: "tls_handshakes", begin: handshakes },
];

/// More than there are places.
const CONNECTIONS: usize = 1200;
/// More than may watch.
const VIEWERS: usize = 300;
/// What froze the link.
const DOWNLOADS: usize = 24;

/// Threads that do the same again and again.
struct Busy {
    stop: Arc<AtomicBool>,
    threads: Vec<JoinHandle<()>>,
}

impl Busy {
    fn begin(client: &Client, threads: usize, again: impl Fn(&Client, usize) + Clone + Send + 'static) -> Box<dyn Any> {
        let stop = Arc::new(AtomicBool::new(false));
        let begin = |number| {
            let (client, again, stop) = (client.clone(), again.clone(), stop.clone());
            std::thread::spawn(move || {
                give_way();
                while !stop.load(Ordering::Relaxed) {
                    again(&client, number);
                }
            })
        };
        let threads = (0..threads).map(begin).collect();
        Box::new(Self { stop, threads })
    }
}

/// Real clients have processors of their own: what these compute must not slow down ground and agent.
fn give_way() {
    // SAFETY: a plain system call; 0 is the calling thread.
    unsafe {
        libc::setpriority(libc::PRIO_PROCESS, 0, 19);
    }
}

impl Drop for Busy {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        self.threads.drain(..).for_each(|thread| thread.join().unwrap());
    }
}

/// Somebody of the crowd.
fn somebody(client: &Client, number: usize) -> &str {
    &client.crowd[number % client.crowd.len()]
}

/// A pipe where sessions are written: opening it waits, as a disk that does not answer.
struct StalledDisk {
    pipe: std::path::PathBuf,
    waiting: Vec<JoinHandle<()>>,
}

fn sign_in_waits_for_disk(client: &Client) -> Box<dyn Any> {
    let pipe = client.data.join("people/sessions.json.tmp");
    let made = Command::new("mkfifo").arg(&pipe).status().unwrap();
    assert!(made.success());
    let sign_in = |name: &'static str| {
        let client = client.clone();
        std::thread::spawn(move || drop(client.sign_in(name, super::PASSWORD)))
    };
    Box::new(StalledDisk { pipe, waiting: vec![sign_in("crowd-0"), sign_in("crowd-1")] })
}

impl Drop for StalledDisk {
    fn drop(&mut self) {
        // Open for both: this waits for nobody, and whoever waits for a reader has one. Then a file can be written again.
        let reader = std::fs::File::options().read(true).write(true).open(&self.pipe);
        std::fs::remove_file(&self.pipe).unwrap();
        let _reader = reader.unwrap();
        self.waiting.drain(..).for_each(|thread| thread.join().unwrap());
    }
}

fn sign_ins_refused(client: &Client) -> Box<dyn Any> {
    // An account that is nobody's: what is throttled is neither pilot nor crowd. The address is.
    Busy::begin(client, 8, |client, _| drop(client.sign_in("nobody", "a wrong password")))
}

fn commands_flood(client: &Client) -> Box<dyn Any> {
    // A simulated vehicle has no replay to be set: it refuses, and nothing changes.
    Busy::begin(client, 64, |client, _| drop(client.command("replay", &json!({ "speed": 1.0 }))))
}

fn half_sent(client: &Client) -> Box<dyn Any> {
    let half = |_| {
        let mut stream = TcpStream::connect(client.address).unwrap();
        let _ = stream.write_all(b"POST /api/v1/vehicles/iris-1/cut HTTP/1.1\r\nHost: ");
        stream
    };
    Box::new((0..CONNECTIONS).map(half).collect::<Vec<_>>())
}

fn half_bodies(client: &Client) -> Box<dyn Any> {
    let half = |number| {
        let mut stream = client.open().unwrap();
        let body = " ".repeat(1000);
        let request = client.request("POST", "/api/v1/design/preview", somebody(client, number), &body);
        let _ = stream.write_all(&request.as_bytes()[..request.len() - 500]);
        stream
    };
    Box::new((0..CONNECTIONS).map(half).collect::<Vec<_>>())
}

fn churn(client: &Client) -> Box<dyn Any> {
    Busy::begin(client, 4, |client, _| drop(TcpStream::connect(client.address)))
}

fn viewers(client: &Client) -> Box<dyn Any> {
    let open = |number| client.socket("/api/v1/vehicles/iris-1/live?history=60", somebody(client, number));
    Box::new((0..VIEWERS).filter_map(open).collect::<Vec<_>>())
}

/// The flight being recorded, and the way to it.
fn flight(client: &Client) -> String {
    let (_, list) = client.get("/api/v1/flights?limit=1000", &client.pilot).expect("flights");
    let list: serde_json::Value = serde_json::from_str(&list).expect("a list");
    let id = list["flights"][0]["id"].as_str().expect("a flight");
    format!("/api/v1/flights/{id}")
}

fn downloads(client: &Client) -> Box<dyn Any> {
    let flight = flight(client);
    Busy::begin(client, DOWNLOADS, move |client, number| {
        let form = ["mcap", "csv", "frames"][number % 3];
        let request = client.request("GET", &format!("{flight}/{form}"), somebody(client, number), "");
        let Ok(mut stream) = client.open() else { return };
        if stream.write_all(request.as_bytes()).is_ok() {
            let mut piece = vec![0; 64 << 10];
            while stream.read(&mut piece).is_ok_and(|got| got > 0) {}
        }
    })
}

fn stalled_downloads(client: &Client) -> Box<dyn Any> {
    let flight = flight(client);
    let stalled = |number| {
        let mut stream = client.open().unwrap();
        let form = ["mcap", "csv", "frames"][number % 3];
        let request = client.request("GET", &format!("{flight}/{form}"), somebody(client, number), "");
        let _ = stream.write_all(request.as_bytes());
        stream
    };
    Box::new((0..600).map(stalled).collect::<Vec<_>>())
}

/// Tables as large as are taken, ten at a time: they took 8.2 GB once.
fn uploads(client: &Client) -> Box<dyn Any> {
    let mut csv =
        "t_s,gx_radps,gy_radps,gz_radps,ax_mps2,ay_mps2,az_mps2,mx_ut,my_ut,mz_ut,temperature_c\\n".to_owned();
    for line in 0..900_000_u32 {
        csv += &format!("{:.3},0.001,-0.003,0.005,0.11,-0.22,9.81,20.1,1.2,-43.0,31.5\\n", f64::from(line) * 0.005);
    }
    let body = format!(r#"{{"kind":"accelerometer","name":"large","csv":"{csv}"}}"#);
    let request: Arc<str> = client.request("POST", "/api/v1/calibrations", &client.pilot, &body).into();
    Busy::begin(client, 10, move |client, _| drop(client.exchange(&request)))
}

/// Asks for an estimate of the flight so far and hangs up: nobody waits for it.
fn estimates_given_up(client: &Client) -> Box<dyn Any> {
    let flight = flight(client);
    Busy::begin(client, DOWNLOADS, move |client, number| {
        let path = format!("{flight}/estimate?estimator=ukf");
        let request = client.request("GET", &path, somebody(client, number), "");
        let Ok(mut stream) = client.open() else { return };
        let _ = stream.write_all(request.as_bytes());
        std::thread::sleep(std::time::Duration::from_millis(200));
    })
}

fn silent(client: &Client) -> Box<dyn Any> {
    Box::new((0..CONNECTIONS).map(|_| TcpStream::connect(client.address).unwrap()).collect::<Vec<_>>())
}

fn handshakes(client: &Client) -> Box<dyn Any> {
    Busy::begin(client, 4, |client, _| {
        let Ok(mut stream) = client.open() else { return };
        let _ = stream.flush();
    })
}
