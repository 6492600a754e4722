//! A running system in a folder of its own, the live stream decoded, a hand on the controls.

use std::collections::VecDeque;
use std::net::{TcpListener, TcpStream, UdpSocket};
use std::path::Path;
use std::time::{Duration, Instant};

use crate::scenario_file;
use plumbline_proto::{Kind, Message, codec, v1};
use plumbline_tests::harness::{Api, Binaries, System, SystemOptions, Vehicle, wait_until};
use serde_json::{Value, json};
use tokio_tungstenite::tungstenite::client::IntoClientRequest;
use tokio_tungstenite::tungstenite::{Message as WsMessage, WebSocket, client};

/// Longest wait for anything that should happen promptly, on a machine that compiles beside us.
pub const PATIENCE: Duration = Duration::from_secs(20);

/// A scenario of `tests/scenarios`.
pub fn scenario(name: &str) -> Vehicle {
    Vehicle::Simulated { scenario: scenario_file(name) }
}

/// Options of a system in `folder`, on free ports.
pub fn options(folder: &Path) -> SystemOptions {
    SystemOptions { binaries: Binaries::of_this_build().unwrap(), data: folder.to_path_buf(), port: 0, echo: false }
}

/// Two neighbouring ports that are free now, for TCP and UDP.
pub fn free_port() -> u16 {
    (0..100)
        .find_map(|_| {
            let page = TcpListener::bind("127.0.0.1:0").ok()?;
            let port = page.local_addr().ok()?.port();
            UdpSocket::bind(("127.0.0.1", port.checked_add(1)?)).ok().map(|_| port)
        })
        .expect("two free ports")
}

/// A running system and the folder it may fill.
pub struct Rig {
    /// `None` once it is stopped.
    pub system: Option<System>,
    /// Everything that it keeps.
    pub folder: tempfile::TempDir,
}

impl Rig {
    /// Starts ground and agent; a test whose system does not start fails.
    pub fn start(vehicle: &Vehicle) -> Self {
        Self::configured(vehicle, "")
    }

    /// The same, with this configuration of the ground (TOML).
    pub fn configured(vehicle: &Vehicle, ground: &str) -> Self {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("ground.toml"), ground).unwrap();
        let system = System::start(&options(folder.path()), vehicle).unwrap_or_else(|error| panic!("{error}"));
        Self { system: Some(system), folder }
    }

    /// Both programs. They must not have been stopped.
    pub fn system(&self) -> &System {
        self.system.as_ref().unwrap()
    }

    /// The ground's HTTP interface.
    pub fn api(&self) -> &Api {
        self.system().api()
    }

    /// A viewer without history.
    pub fn live(&self) -> Live {
        Live::connect(self.api(), &self.system().vehicle("live?history=0"))
    }

    /// A command that must be accepted.
    pub fn command(&self, method: &str, route: &str, body: Value) -> Value {
        let reply = self.api().command(method, &self.system().vehicle(route), &body).unwrap();
        assert_eq!(reply["stage"], "accepted", "{method} {route} {body}: {reply}");
        reply
    }

    /// Arms as soon as the checks let it.
    pub fn arm(&self) {
        let route = self.system().vehicle("arm");
        let mut last = String::new();
        let armed = wait_until(PATIENCE, || {
            let reply = self.api().send("POST", &route, &json!({})).unwrap();
            last = format!("{} {}", reply.status, reply.text());
            (reply.status == 200).then_some(())
        });
        assert!(armed.is_some(), "not armed after {PATIENCE:?}: {last}");
    }

    /// Armed, in altitude hold, told to go to `altitude_m`.
    pub fn fly_to(&self, altitude_m: f64) {
        self.arm();
        self.command("POST", "mode", json!({ "mode": "altitude_hold" }));
        self.command("POST", "setpoint", json!({ "altitude_m": altitude_m }));
    }

    /// Disarms.
    pub fn disarm(&self) {
        self.command("POST", "disarm", json!({}));
    }

    /// The only flight in the list, once it is complete.
    pub fn finished_flight(&self) -> Value {
        let mut last = Value::Null;
        let finished = wait_until(PATIENCE, || {
            last = self.api().get_json("/api/v1/flights?limit=1000").unwrap();
            let flights = last["flights"].as_array().cloned().unwrap_or_default();
            let [flight] = flights.as_slice() else { return None };
            (flight["completeness"] == "complete").then(|| flight.clone())
        });
        finished.unwrap_or_else(|| panic!("no complete flight after {PATIENCE:?}: {last}"))
    }

    /// Stops both programs; either failing to stop cleanly fails the test.
    pub fn stop(mut self) -> tempfile::TempDir {
        self.system.take().unwrap().stop().unwrap_or_else(|error| panic!("{error}"));
        self.folder
    }
}

/// One frame of the live stream, owned.
#[derive(Debug, Clone)]
pub struct OwnedFrame {
    /// As on the wire; an unknown one is possible.
    pub kind: u16,
    /// Of the sensor, or of what else comes in several.
    pub instance: u16,
    /// 0 where the ground made it.
    pub sequence: u64,
    /// Flight time, µs.
    pub time_us: u64,
    /// The encoded message.
    pub payload: Vec<u8>,
}

impl OwnedFrame {
    /// Is it of that kind?
    pub fn is(&self, kind: Kind) -> bool {
        self.kind == kind.to_wire()
    }

    /// The message, if the frame is of that kind.
    pub fn message<M: Message + Default>(&self, kind: Kind) -> Option<M> {
        self.is(kind).then(|| M::decode(self.payload.as_slice()).unwrap())
    }
}

/// A viewer.
pub struct Live {
    socket: WebSocket<TcpStream>,
    frames: VecDeque<OwnedFrame>,
}

impl Live {
    /// Opens the live view at `path`, as a page of that ground would.
    pub fn connect(api: &Api, path: &str) -> Self {
        let stream = TcpStream::connect(api.address).unwrap();
        stream.set_read_timeout(Some(PATIENCE)).unwrap();
        let mut request = format!("ws://{}{path}", api.address).into_client_request().unwrap();
        request.headers_mut().insert("origin", format!("http://{}", api.address).parse().unwrap());
        let (socket, _) = client(request, stream).unwrap();
        Self { socket, frames: VecDeque::new() }
    }

    /// The next frame; waits.
    pub fn frame(&mut self) -> OwnedFrame {
        self.try_frame().expect("an open socket")
    }

    /// The next frame; waits. `None` when the socket has ended.
    pub fn try_frame(&mut self) -> Option<OwnedFrame> {
        loop {
            if let Some(frame) = self.frames.pop_front() {
                return Some(frame);
            }
            match self.socket.read().ok()? {
                WsMessage::Binary(batch) => self.frames.extend(frames(&batch)),
                WsMessage::Close(_) => return None,
                _ => {}
            }
        }
    }

    /// Waits for a frame that `wanted` turns into something; fails the test after `limit`.
    pub fn until<T>(&mut self, limit: Duration, what: &str, mut wanted: impl FnMut(&OwnedFrame) -> Option<T>) -> T {
        let until = Instant::now() + limit;
        while Instant::now() < until {
            if let Some(found) = wanted(&self.frame()) {
                return found;
            }
        }
        panic!("no {what} within {limit:?}");
    }

    /// Waits for the end of the response to the step that ends at `to_m`.
    pub fn step_response(&mut self, to_m: f64) -> v1::StepResponse {
        self.until(Duration::from_secs(30), &format!("finished step to {to_m} m"), |frame| {
            let step: v1::StepResponse = frame.message(Kind::StepResponse)?;
            (step.finished && (step.to_m - to_m).abs() < 1e-9).then_some(step)
        })
    }

    /// Waits for a status that satisfies.
    pub fn status(&mut self, what: &str, wanted: impl Fn(&v1::Status) -> bool) -> v1::Status {
        self.until(PATIENCE, what, |frame| frame.message(Kind::Status).filter(&wanted))
    }
}

/// All frames of one batch; a malformed one fails the test.
pub fn frames(batch: &[u8]) -> Vec<OwnedFrame> {
    let own = |frame: Result<codec::Frame<'_>, _>| {
        let codec::Frame { kind, instance, sequence, time_us, payload } = frame.unwrap();
        OwnedFrame { kind, instance, sequence, time_us, payload: payload.to_vec() }
    };
    codec::decode_batch(batch).unwrap().map(own).collect()
}

/// The counts the API promises for a flight.
pub fn promised_counts(flight: &Value) -> std::collections::BTreeMap<String, u64> {
    let counts = flight["counts"].as_object().expect("counts");
    counts.iter().map(|(topic, count)| (topic.clone(), count.as_u64().unwrap())).collect()
}
