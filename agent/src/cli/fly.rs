//! Flying: vehicle, flight thread, log, link.

mod hardware;
mod piloted;
mod service;

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use arrayvec::ArrayVec;
use plumbline_agent::attack::Schedule;
use plumbline_agent::calibration::Calibration;
use plumbline_agent::config::{AgentConfig, RecordedFlight};
use plumbline_agent::estimate::secure::suite::{Observed, Promise, SuiteError};
use plumbline_agent::flight::{Flight, FlightConfig};
use plumbline_agent::link::backfill::Archive;
use plumbline_agent::link::clock::FlightClock;
use plumbline_agent::link::{self, INBOUND_QUEUE, LinkConfig, LinkHandle, LinkPorts, identity};
use plumbline_agent::log::{self, LogConfig, LogHandle, RING_BYTES};
use plumbline_agent::offline::{ArgumentError, calibrate};
use plumbline_agent::recordings;
use plumbline_agent::recordings::replay::{ReplayVehicle, Samples};
use plumbline_agent::runner::bounding::Bounding;
use plumbline_agent::runner::keeper;
use plumbline_agent::runner::pace::Pace;
use plumbline_agent::runner::stop::Stop;
use plumbline_agent::runner::{Runner, RunnerOptions, RunnerPorts};
use plumbline_agent::sensor::suite::{Description, Suite};
use plumbline_agent::sim::rig::{Line, MAX_STRINGS};
use plumbline_agent::sim::script::Script;
use plumbline_agent::sim::{Scenario, SimVehicle, scenario::attacks_from_toml};
use plumbline_agent::telemetry::{Identification, Outlet, Telemetry};
use plumbline_agent::vehicle::Vehicle;
use plumbline_agent::vehicle::calibrated::CalibratedVehicle;
use plumbline_devices::reader::Zero;
use plumbline_proto::SCHEMA;
use plumbline_proto::time::{FlightTime, WallTime};

use super::{Failure, FlyArguments, VehicleChoice, in_file, read};

/// Bytes that may wait for the radio's thread: several seconds of a full suite.
const LINK_RING_BYTES: usize = 2 << 20;
/// From here to the first tick: log, link, solvers and threads are set up in it.
const SET_UP: Duration = Duration::from_millis(100);

/// A vehicle and all that follows from it.
struct Chosen {
    vehicle: Box<dyn Vehicle>,
    flight: FlightConfig,
    kind: &'static str,
    rig: String,
    scenario: String,
    seed: u64,
    source_file: String,
    sensors: ArrayVec<Description, { plumbline_agent::sensor::MAX_SENSORS }>,
    strings: ArrayVec<Line, MAX_STRINGS>,
    promise: Option<Result<Promise, SuiteError>>,
    script: Option<Script>,
    /// Those of its scenario, where no script begins them.
    attacks: Option<Schedule>,
    end: Option<FlightTime>,
    /// Of a vehicle whose samples are stamped as they arrive.
    zero: Option<Zero>,
}

impl Chosen {
    /// A `vehicle` in the world of `scenario`, without its script.
    fn simulated(scenario: &Scenario, vehicle: Box<dyn Vehicle>) -> Self {
        let mut flight = scenario.flight_config().with_every_estimator();
        // The simulated world stands still until its next tick, however late that is: told, and no reason to land.
        flight.failsafe.deadline_descend = u32::MAX;
        Self {
            vehicle,
            flight,
            kind: "sim",
            rig: scenario.rig.name().to_owned(),
            scenario: scenario.text.clone(),
            seed: scenario.seed,
            source_file: String::new(),
            sensors: scenario.suite.descriptions(),
            strings: scenario.rig.lines(&scenario.airframe),
            promise: Some(Observed::promise_at_hover(&scenario.suite, &scenario.airframe)),
            script: None,
            attacks: None,
            end: None,
            zero: None,
        }
    }

    /// Its sensors: those of its scenario, or typical ones at the rates told.
    fn suite(&self) -> Result<Suite, Failure> {
        if !self.scenario.is_empty() {
            return Ok(Scenario::from_toml(&self.scenario)?.suite);
        }
        Ok(Suite::at_rates(self.sensors.iter().map(|sensor| (sensor.id, sensor.rate_hz))))
    }

    /// The vehicle behind its calibration, and what telemetry says of it.
    fn identified(self, agent_id: &str, boot: &Boot, calibration: Calibration) -> (CalibratedVehicle, Identification) {
        let identification = Identification {
            agent_id: agent_id.to_owned(),
            boot_id: boot.id,
            boot_wall_time: boot.wall_time,
            vehicle: self.kind,
            rig: self.rig,
            scenario: self.scenario,
            seed: self.seed,
            source_file: self.source_file,
            sensors: self.sensors,
            strings: self.strings,
            promise: self.promise,
        };
        (CalibratedVehicle::new(self.vehicle, calibration), identification)
    }
}

/// Flies until the end, Ctrl-C, SIGTERM or the end of its terminal.
pub fn fly(arguments: &FlyArguments) -> Result<(), Failure> {
    let config = configuration(arguments)?;
    let pace = pace(&arguments.speed)?;
    let attacks = match &arguments.attack_schedule {
        Some(path) => Some(attacks_from_toml(&read(path)?).map_err(|e| in_file(path, e))?),
        None => None,
    };
    // What is only simulated, or recorded, has other errors at the next start.
    let attached = matches!(arguments.vehicle, VehicleChoice::Hardware | VehicleChoice::Mavlink);
    let kept = attached.then(|| config.kept_calibrations.clone());
    // Before any device is opened.
    let calibration = calibration(&config, kept.as_deref())?;
    let stop = Arc::new(Stop::default());
    let mut chosen = match arguments.vehicle {
        VehicleChoice::Sim => simulated(arguments)?,
        VehicleChoice::Replay => recorded(arguments, &config)?,
        VehicleChoice::Hardware | VehicleChoice::Mavlink => hardware::attached(arguments, &config)?,
        VehicleChoice::Px4 | VehicleChoice::Ardupilot => piloted::piloted(arguments, attacks.as_ref(), pace, &stop)?,
    };
    configure(&mut chosen, &config, &calibration)?;
    let flight = Flight::new(chosen.flight.clone())?;
    // Flight time begins when everything that follows is set up, and not before the wall time that is told of it.
    let boot = Boot::in_a_moment()?;
    if let Some(zero) = &chosen.zero {
        zero.set(boot.zero);
    }

    let (log_ring, log) = start_log(&config, &boot)?;
    let clock = Arc::new(FlightClock::default());
    let (link_ring, link_frames) = rtrb::RingBuffer::new(LINK_RING_BYTES);
    let (commands, inbound) = rtrb::RingBuffer::new(INBOUND_QUEUE);
    let with_ground = !config.ground.is_empty();
    let link = if with_ground {
        let archive: Arc<dyn Archive> = log.archive();
        let ports = LinkPorts { telemetry: link_frames, inbound: commands, clock: clock.clone(), archive };
        Some(start_link(&config, &boot, ports)?)
    } else {
        None
    };

    let replay = arguments.vehicle == VehicleChoice::Replay;
    let piloted = matches!(arguments.vehicle, VehicleChoice::Px4 | VehicleChoice::Ardupilot);
    let radio = link.is_some().then(|| Outlet::new(link_ring));
    let options = RunnerOptions {
        pace,
        end: chosen.end,
        own_operator: chosen.script.is_some() || ((replay || piloted) && !with_ground),
        script: chosen.script.take(),
        attacks: attacks.or(chosen.attacks.take()),
        stay: replay && with_ground,
        real_time: config.real_time && matches!(pace, Pace::Times(_)),
        calibrations: kept,
        bounding: Bounding::new(&chosen.flight, &chosen.suite()?),
    };
    let ports = RunnerPorts {
        inbound: Some(inbound),
        link: link.as_ref().map(|link| link.state().clone()),
        log: Some(log.state().clone()),
        clock: clock.clone(),
        // A recording has a time of its own.
        zero: (!replay).then_some(boot.zero),
    };
    let (vehicle, identification) = chosen.identified(&config.id, &boot, calibration);
    let telemetry = Telemetry::new(identification, &flight, radio, Some(Outlet::new(log_ring)));

    stop_on_signal(stop.clone())?;
    let flying = std::thread::Builder::new()
        .name("flight".into())
        .spawn(move || Runner::new(vehicle, flight, telemetry, options, ports).run(&stop))?;
    service::serving(clock);
    let outcome = flying.join().map_err(|_| "the flight thread died")?;
    // The log first: what the flight wrote last is on the disk when the link says goodbye.
    log.stop();
    if let Some(link) = link {
        link.stop();
    }
    let summary = outcome?;
    tracing::info!(
        ticks = summary.ticks,
        flown_s = summary.time.as_seconds(),
        wall_s = summary.wall_s,
        messages = summary.messages,
        deadline_misses = summary.deadline_misses,
        "ended"
    );
    Ok(())
}

/// One start of the agent.
struct Boot {
    /// Differs from every other start.
    id: u64,
    /// When flight time is zero.
    zero: Instant,
    /// The same on the wall clock.
    wall_time: WallTime,
}

impl Boot {
    /// Leaves [`SET_UP`] for log, link, solvers and threads.
    fn in_a_moment() -> Result<Self, Failure> {
        let zero = Instant::now() + SET_UP;
        let since_epoch = SystemTime::now().duration_since(UNIX_EPOCH)? + SET_UP;
        let id = since_epoch.as_nanos() as u64 ^ u64::from(std::process::id());
        Ok(Self { id, zero, wall_time: WallTime(since_epoch.as_micros() as u64) })
    }
}

/// The calibrations of the configuration, and those in the folder `kept`.
fn calibration(config: &AgentConfig, kept: Option<&Path>) -> Result<Calibration, Failure> {
    let of_devices = config.device.iter().filter_map(|device| device.calibration.clone());
    let files: Vec<PathBuf> = config.calibrations.iter().cloned().chain(of_devices).collect();
    let mut calibration = calibrate::load(&files)?;
    if let Some(folder) = kept {
        keeper::load(folder, &mut calibration)?;
    }
    Ok(calibration)
}

/// What the configuration says of the flight of a vehicle, and what its calibrations say of the vehicle itself.
fn configure(chosen: &mut Chosen, config: &AgentConfig, calibration: &Calibration) -> Result<(), Failure> {
    let frame_rate_hz = chosen.flight.tick_rate_hz;
    config.apply(&mut chosen.flight)?;
    calibration.apply_to_airframe(&mut chosen.flight.airframe);
    // Frames come at the rate of the scenario or the recording, whatever the configuration says.
    chosen.flight.tick_rate_hz = frame_rate_hz;
    Ok(())
}

/// The onboard log, and the ring that it is filled through.
fn start_log(config: &AgentConfig, boot: &Boot) -> Result<(rtrb::Producer<u8>, LogHandle), Failure> {
    let (ring, frames) = rtrb::RingBuffer::new(RING_BYTES);
    let settings = LogConfig {
        folder: config.log.folder.clone(),
        max_bytes: config.log.max_mib << 20,
        agent_id: config.id.clone(),
        boot_wall_time: boot.wall_time,
    };
    Ok((ring, log::spawn(settings, frames)?))
}

/// The radio to the configured ground.
fn start_link(config: &AgentConfig, boot: &Boot, ports: LinkPorts) -> Result<LinkHandle, Failure> {
    let identity = identity::load_or_create(&config.identity)?;
    tracing::info!(agent = config.id, ground = config.ground, fingerprint = %identity.fingerprint(), "link");
    let settings = LinkConfig {
        ground: config.ground.clone(),
        agent_id: config.id.clone(),
        version: env!("CARGO_PKG_VERSION").to_owned(),
        schema: u32::from(SCHEMA),
        boot_id: boot.id,
        boot_wall_time: boot.wall_time,
        identity,
        telemetry_bytes_per_s: config.link.telemetry_kb_per_s * 1e3,
        backfill_bytes_per_s: config.link.backfill_kb_per_s * 1e3,
    };
    Ok(link::spawn(settings, ports)?)
}

fn configuration(arguments: &FlyArguments) -> Result<AgentConfig, Failure> {
    let mut config = match &arguments.config {
        Some(path) => AgentConfig::read(path)?,
        None => AgentConfig::default(),
    };
    if let Some(ground) = &arguments.ground {
        config.ground = if ground == "none" { String::new() } else { ground.clone() };
    }
    if let Some(id) = &arguments.id {
        config.id.clone_from(id);
    }
    if let Some(identity) = &arguments.identity {
        config.identity.clone_from(identity);
    }
    if let Some(folder) = &arguments.log {
        config.log.folder.clone_from(folder);
    }
    if let Some(name) = &arguments.estimator {
        config.estimators.in_loop = Some(name.clone());
    }
    if let Some(name) = &arguments.decoder {
        config.estimators.decoder = Some(name.clone());
    }
    config.validate()?;
    Ok(config)
}

fn pace(speed: &str) -> Result<Pace, Failure> {
    if speed == "max" {
        return Ok(Pace::Free);
    }
    match speed.parse::<f64>() {
        Ok(0.0) => Ok(Pace::Stepped),
        Ok(times) if times > 0.0 && times <= link::inbound::REPLAY_SPEED_MAX => Ok(Pace::Times(times)),
        _ => {
            let reason = format!("not 0 to {} or max", link::inbound::REPLAY_SPEED_MAX);
            Err(ArgumentError::new("speed", speed, reason).into())
        }
    }
}

/// The scenario asked for.
fn scenario(arguments: &FlyArguments) -> Result<Scenario, Failure> {
    if let Some(file) = &arguments.file {
        return Err(in_file(file, "only --vehicle replay takes a file"));
    }
    Ok(match &arguments.scenario {
        Some(path) => Scenario::from_toml(&read(path)?).map_err(|e| in_file(path, e))?,
        None => Scenario::default_string_rig(),
    })
}

fn simulated(arguments: &FlyArguments) -> Result<Chosen, Failure> {
    let scenario = scenario(arguments)?;
    Ok(Chosen {
        script: arguments.script.then(|| scenario.script.clone()),
        end: arguments.script.then(|| FlightTime::from_seconds(scenario.duration_s)),
        ..Chosen::simulated(&scenario, Box::new(SimVehicle::new(&scenario)?))
    })
}

fn recorded(arguments: &FlyArguments, config: &AgentConfig) -> Result<Chosen, Failure> {
    let path = arguments.file.as_deref().ok_or("--vehicle replay needs a file")?;
    let recording = recordings::open(path)?;
    let info = recording.info().clone();
    for note in &info.notes {
        tracing::info!(file = %path.display(), note, "recording");
    }
    let RecordedFlight { flight, scenario, sensors } =
        RecordedFlight::new(&info, &config.airframe).map_err(|e| in_file(path, e))?;
    // Another schedule attacks the clean samples; otherwise the old attacks are seen again.
    let samples = if arguments.attack_schedule.is_some() { Samples::Sensed } else { Samples::Received };
    Ok(Chosen {
        vehicle: Box::new(ReplayVehicle::new(recording, samples)),
        flight,
        kind: "replay",
        rig: scenario.as_ref().map_or("recording", |scenario| scenario.rig.name()).to_owned(),
        seed: scenario.as_ref().map_or(0, |scenario| scenario.seed),
        scenario: info.scenario.unwrap_or_default(),
        source_file: path.file_name().unwrap_or(path.as_os_str()).to_string_lossy().into_owned(),
        sensors,
        promise: scenario.as_ref().map(|s| Observed::promise_at_hover(&s.suite, &s.airframe)),
        strings: scenario.map(|scenario| scenario.rig.lines(&scenario.airframe)).unwrap_or_default(),
        script: None,
        attacks: None,
        end: None,
        zero: None,
    })
}

/// The first signal lands, the second one cuts the motors, the third ends the program wherever it hangs. A terminal that goes (an SSH
/// session that breaks off) lands, too, and is none of these.
fn stop_on_signal(stop: Arc<Stop>) -> Result<(), Failure> {
    use tokio::signal::unix::{SignalKind, signal};
    let stays = ignored(libc::SIGHUP);
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    std::thread::Builder::new().name("signals".into()).spawn(move || {
        runtime.block_on(async {
            let (Ok(mut interrupt), Ok(mut terminate), Ok(mut hang_up)) =
                (signal(SignalKind::interrupt()), signal(SignalKind::terminate()), signal(SignalKind::hangup()))
            else {
                tracing::error!("signals cannot be heard; Ctrl-C will not end the flight in order");
                return;
            };
            loop {
                tokio::select! {
                    _ = interrupt.recv() => {}
                    _ = terminate.recv() => {}
                    _ = hang_up.recv() => {
                        if !stays && stop.hang_up() {
                            tracing::info!("its terminal is gone: landing");
                        }
                        continue;
                    }
                }
                match stop.ask() {
                    1 => tracing::info!("asked to end: landing; asked again the motors are cut"),
                    2 => tracing::warn!("asked again: motors cut"),
                    _ => std::process::exit(130),
                }
            }
        });
    })?;
    Ok(())
}

/// Was this program told to ignore `number`, as `nohup` does?
fn ignored(number: libc::c_int) -> bool {
    // SAFETY: a plain structure, of which zeros are a value.
    let mut now: libc::sigaction = unsafe { std::mem::zeroed() };
    // SAFETY: nothing is changed, and `now` is a valid place for the answer.
    let known = unsafe { libc::sigaction(number, std::ptr::null(), &raw mut now) } == 0;
    known && now.sa_sigaction == libc::SIG_IGN
}
