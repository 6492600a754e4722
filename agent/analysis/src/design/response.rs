//! What a step of the setpoint does to the nonlinear vehicle: rigid body with drag, motors' lag, mixer with
//! its limits, profile of the setpoint, one tick between asking and acting. The state is known exactly.

use nalgebra::Vector3;
use plumbline_core::control::Controller;
use plumbline_core::control::gains::OUTPUT_NAMES;
use plumbline_core::control::law::Law;
use plumbline_core::control::setpoint::{Limits, Profile};
use plumbline_core::control::step_response::{self, StepMeter};
use plumbline_core::estimate::{Estimate, Health, Motion};
use plumbline_core::frames::roll_pitch_yaw;
use plumbline_core::mix::Mixer;
use plumbline_core::model::airframe::Airframe;
use plumbline_core::model::integrate::rk4;
use plumbline_core::model::motor;
use plumbline_core::model::rigid_body::{Input, State, derivative};
use plumbline_core::types::{Loops, MotorCommand, ROTORS, Setpoint};
use plumbline_proto::time::FlightTime;

/// Where the vehicle hovers before the step, m.
const ALTITUDE_M: f64 = 1.0;
/// Integration steps in a tick: at most 2.5 ms each.
const LONGEST_STEP_S: f64 = 0.0025;
/// Curves are given at this spacing, s.
const CURVE_S: f64 = 0.02;
/// A vehicle that is further away than this from its setpoint has been lost, m.
const LOST_M: f64 = 100.0;

/// One step of one output, flown.
#[derive(Debug, Clone, PartialEq)]
pub struct Flown {
    /// `x`, `y`, `z` or `yaw`.
    pub output: &'static str,
    /// m or rad.
    pub size: f64,
    /// Times of the curves, s.
    pub t_s: Vec<f64>,
    /// The profile that the controller is given.
    pub setpoint: Vec<f64>,
    /// The output.
    pub response: Vec<f64>,
    /// Largest motor command of each moment, 0 to 1.
    pub largest_command: Vec<f64>,
    /// The step as the flight's own meter measures it.
    pub measured: step_response::StepResponse,
    /// How long the mixer could not give what was asked for, s.
    pub saturated_s: f64,
    /// Did the vehicle stay near its setpoint?
    pub stayed: bool,
}

/// Steps output number `output` (x, y, z, yaw) by `size` and flies for `duration_s`; `None` when the rotors
/// cannot give every wrench.
pub fn fly_step(
    airframe: &Airframe,
    law: &Law,
    period_s: f64,
    limits: &Limits,
    output: usize,
    size: f64,
    duration_s: f64,
) -> Option<Flown> {
    let mut law = law.clone();
    let mixer = Mixer::new(airframe, f64::INFINITY)?;
    let mut plant = Plant::hovering(airframe, period_s);
    let start = Setpoint { position_enu_m: plant.state.position_enu_m, ..Setpoint::default() };
    let mut target = start;
    match output {
        3 => target.roll_pitch_yaw_rad.z += size,
        axis => target.position_enu_m[axis.min(2)] += size,
    }
    let value = |position: &Vector3<f64>, yaw: f64| if output == 3 { yaw } else { position[output.min(2)] };
    let mut profile = Profile::default();
    profile.restart(start);
    let mut meter = StepMeter::default();
    let from = value(&start.position_enu_m, 0.0);
    meter.begin(FlightTime(0), from, from + size, from);
    let mut flown = Flown {
        output: OUTPUT_NAMES.get(output).copied().unwrap_or("yaw"),
        size,
        t_s: Vec::new(),
        setpoint: Vec::new(),
        response: Vec::new(),
        largest_command: Vec::new(),
        measured: *meter.response()?,
        saturated_s: 0.0,
        stayed: true,
    };
    let ticks = (duration_s / period_s).round() as u64;
    let mut due_s = 0.0;
    for tick in 0..=ticks {
        let t_s = tick as f64 * period_s;
        let setpoint = *profile.step(&target, limits, period_s);
        let loops = Loops { horizontal: true, altitude: true };
        let asked = law.control(&plant.estimate(), &setpoint, loops, period_s);
        let mixed = mixer.mix(&asked);
        law.applied(&asked, &mixed.given, 0.0);
        if mixed.saturated {
            flown.saturated_s += period_s;
        }
        let aim = value(&setpoint.position_enu_m, setpoint.roll_pitch_yaw_rad.z);
        let reached = value(&plant.state.position_enu_m, roll_pitch_yaw(&plant.state.attitude()).z);
        if let Some(step) = meter.update(FlightTime::from_seconds(t_s), reached, aim) {
            flown.measured = step.to_owned();
        }
        if t_s >= due_s - 1e-9 {
            due_s += CURVE_S.max(period_s);
            flown.t_s.push(t_s);
            flown.setpoint.push(aim);
            flown.response.push(reached);
            flown.largest_command.push(mixed.command.throttle.into_iter().fold(0.0, f64::max));
        }
        let state = &plant.state;
        if !state.is_finite() || (state.position_enu_m - setpoint.position_enu_m).norm() > LOST_M {
            flown.stayed = false;
            break;
        }
        plant.fly(mixed.command);
    }
    Some(flown)
}

/// Rigid body and rotors, in steps of the control period.
struct Plant<'a> {
    airframe: &'a Airframe,
    period_s: f64,
    state: State,
    speeds_radps: [f64; ROTORS],
    /// The command of the period before acts during the next one.
    waiting: MotorCommand,
}

impl<'a> Plant<'a> {
    fn hovering(airframe: &'a Airframe, period_s: f64) -> Self {
        Self {
            airframe,
            period_s,
            state: State::at_rest(Vector3::new(0.0, 0.0, ALTITUDE_M)),
            speeds_radps: [airframe.hover_speed_radps(); ROTORS],
            waiting: MotorCommand { throttle: [airframe.hover_command(); ROTORS] },
        }
    }

    /// Everything is known exactly.
    fn estimate(&self) -> Estimate {
        Estimate {
            motion: Some(Motion {
                position_enu_m: self.state.position_enu_m,
                velocity_enu_mps: self.state.velocity_enu_mps,
                horizontal_known: true,
                altitude_known: true,
                ..Motion::default()
            }),
            world_from_body: self.state.attitude(),
            body_rates_radps: self.state.body_rates_radps,
            health: Health::Healthy,
            ..Estimate::default()
        }
    }

    fn fly(&mut self, command: MotorCommand) {
        let acting = std::mem::replace(&mut self.waiting, command);
        let steady = motor::steady_speed(self.airframe, &acting.throttle, 1.0);
        let substeps = (self.period_s / LONGEST_STEP_S).ceil().max(1.0);
        let h = self.period_s / substeps;
        for _ in 0..substeps as u32 {
            let acceleration = motor::acceleration(self.airframe, &self.speeds_radps, &steady);
            let input = Input::from_rotors(self.airframe, &self.speeds_radps, &acceleration);
            self.state = rk4(&self.state, h, |x| derivative(self.airframe, x, &input)).normalised();
            self.speeds_radps = motor::after(self.airframe, &self.speeds_radps, &steady, h);
        }
    }
}
