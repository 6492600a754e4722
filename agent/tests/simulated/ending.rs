//! GIVEN a vehicle in flight WHEN the program is asked to end, or its flight thread hangs THEN it lands, or its motors stand.

use std::sync::{Arc, Mutex};
use std::time::Duration;

use plumbline_agent::flight::{Failsafe, Flight};
use plumbline_agent::runner::pace::Pace;
use plumbline_agent::runner::stop::Stop;
use plumbline_agent::runner::{Runner, RunnerPorts};
use plumbline_agent::sensor::SensorFrame;
use plumbline_agent::sim::{Scenario, SimVehicle};
use plumbline_agent::telemetry::Telemetry;
use plumbline_agent::types::{Mode, MotorCommand};
use plumbline_agent::vehicle::{MotorStop, Truth, Vehicle, VehicleError};
use plumbline_support::flown::{identification, runner_options, scenario};

/// What happens at a time of the flight, once.
type Moment = Box<dyn FnMut(&SimVehicle) + Send>;

/// The simulator, with something happening at `at_s`; it notes when its truth was how.
struct Watched {
    sim: SimVehicle,
    moments: Vec<(f64, Moment)>,
    truths: Arc<Mutex<Vec<Truth>>>,
}

impl Vehicle for Watched {
    fn sense(&mut self) -> Result<SensorFrame, VehicleError> {
        let frame = self.sim.sense()?;
        self.truths.lock().unwrap().extend(self.sim.truth());
        let now_s = frame.time.as_seconds();
        for (at_s, moment) in &mut self.moments {
            if now_s >= *at_s {
                *at_s = f64::INFINITY;
                moment(&self.sim);
            }
        }
        Ok(frame)
    }

    fn actuate(&mut self, command: &MotorCommand) -> Result<MotorCommand, VehicleError> {
        self.sim.actuate(command)
    }

    fn motor_stop(&self) -> Option<Arc<dyn MotorStop>> {
        self.sim.motor_stop()
    }

    fn pass_over(&mut self, gap_s: f64) -> f64 {
        self.sim.pass_over(gap_s)
    }

    fn truth(&self) -> Option<Truth> {
        self.sim.truth()
    }
}

/// The string rig hovering at 0.5 m from 7 s on, and what is left of it after `moments`.
fn flown(pace: Pace, end_s: f64, stop: &Stop, moments: Vec<(f64, Moment)>) -> (Ended, Vec<Truth>) {
    let mut scenario = Scenario::from_toml(&scenario("altitude_step")).unwrap();
    scenario.script.steps.retain(|s| s.at_s < 6.0);
    let flight = Flight::new(scenario.flight_config()).unwrap();
    let options = runner_options(pace, Some(end_s), Some(scenario.script.clone()));
    let truths = Arc::new(Mutex::new(Vec::new()));
    let sim = SimVehicle::new(&scenario).unwrap();
    let vehicle = Box::new(Watched { sim, moments, truths: truths.clone() });
    let telemetry = Telemetry::new(identification(&scenario), &flight, None, None);
    let mut runner = Runner::new(vehicle, flight, telemetry, options, RunnerPorts::default());
    let summary = runner.run(stop).unwrap();
    let status = runner.flight().status();
    let truths = truths.lock().unwrap().clone();
    (Ended { status, at_s: summary.time.as_seconds(), misses: summary.deadline_misses }, truths)
}

/// How the flight stood at its end.
struct Ended {
    status: plumbline_agent::flight::FlightStatus,
    at_s: f64,
    misses: u64,
}

/// Asks `stop` for the end.
fn ask(stop: &Arc<Stop>) -> Moment {
    let stop = stop.clone();
    Box::new(move |_| {
        stop.ask();
    })
}

#[test]
fn asked_once_to_end_it_lands_first() {
    let stop = Arc::new(Stop::default());
    let (end, truths) = flown(Pace::Free, 60.0, &stop, vec![(10.0, ask(&stop))]);
    assert_eq!((end.status.mode, end.status.armed, end.status.cut_latched), (Mode::Disarmed, false, false));
    assert!((12.0..20.0).contains(&end.at_s), "ended at {}", end.at_s);
    assert!(truths.iter().filter(|t| t.time.as_seconds() > 10.0).all(|t| t.velocity_enu_mps.z > -0.6), "it fell");
    assert!(truths.last().unwrap().position_enu_m.z < 0.35);
}

#[test]
fn asked_twice_it_cuts() {
    let stop = Arc::new(Stop::default());
    let (end, _) = flown(Pace::Free, 60.0, &stop, vec![(10.0, ask(&stop)), (10.2, ask(&stop))]);
    assert_eq!((end.status.mode, end.status.failsafe), (Mode::Cut, Failsafe::ShutdownCut));
    assert!(end.status.failsafe_reason.contains("asked to end: motors cut"), "{}", end.status.failsafe_reason);
    assert!(end.at_s < 10.3, "ended at {}", end.at_s);
}

#[test]
fn a_flight_thread_that_hangs_costs_its_motors_and_every_tick_is_counted() {
    // In real time, because only there is a thread late. A flight thread that sleeps 0.4 s in the air.
    let hang: Moment = Box::new(|_| std::thread::sleep(Duration::from_millis(400)));
    let (end, truths) = flown(Pace::Times(1.0), 8.5, &Stop::default(), vec![(7.5, hang)]);
    assert_eq!(
        (end.status.mode, end.status.failsafe),
        (Mode::Cut, Failsafe::StallCut),
        "{:?}",
        end.status.failsafe_reason
    );
    // What the world did meanwhile is true: rotors that stood after a tenth of a second, and a fall onto the strings.
    let gap = truths.windows(2).find(|w| w[1].time.seconds_since(w[0].time) > 0.3).expect("nothing was passed over");
    assert!(gap[0].rotor_speed_radps.iter().all(|w| *w > 400.0), "{:?}", gap[0].rotor_speed_radps);
    assert!(gap[1].rotor_speed_radps.iter().all(|w| *w < 200.0), "{:?}", gap[1].rotor_speed_radps);
    assert!(end.misses >= 60, "{} of 80 ticks counted", end.misses);
}
