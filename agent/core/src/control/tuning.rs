//! What a designer may turn: the kind of controller, weights, and the parameters that weights do not cover.
//!
//! | kind | from |
//! |---|---|
//! | `lqr_integral`, `lqr` | weights (the second ignores those of the integrals), or K outright |
//! | `lqg` | weights without integrals, and the noise of [`super::lqg::PARAMETERS`] |
//! | `hinf` | [`super::hinf::PARAMETERS`] |
//! | `pid` | [`super::pid::PARAMETERS`] |

use arrayvec::{ArrayString, ArrayVec};

use super::gains::{Gain, GainsError};
use super::lqr_integral::Weights;
use super::{ControllerKind, hinf, lqg, pid};
use crate::model::airframe::Airframe;

/// Longest name of a parameter.
pub const MAX_NAME: usize = 32;
/// Most parameters of a kind.
pub const MAX_PARAMETERS: usize = 24;

/// One parameter: what a field or slider needs to know.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Parameter {
    /// Name in files and messages.
    pub name: &'static str,
    /// SI.
    pub unit: &'static str,
    /// Least value accepted.
    pub min: f64,
    /// Largest value accepted.
    pub max: f64,
}

impl Parameter {
    pub(crate) const fn new(name: &'static str, unit: &'static str, min: f64, max: f64) -> Self {
        Self { name, unit, min, max }
    }
}

/// Every kind.
pub const KINDS: [ControllerKind; 5] =
    [ControllerKind::LqrIntegral, ControllerKind::Lqr, ControllerKind::Lqg, ControllerKind::Hinf, ControllerKind::Pid];

/// The name in files, messages and commands.
pub fn kind_name(kind: ControllerKind) -> &'static str {
    match kind {
        ControllerKind::Unspecified => "unspecified",
        ControllerKind::LqrIntegral => "lqr_integral",
        ControllerKind::Lqr => "lqr",
        ControllerKind::Lqg => "lqg",
        ControllerKind::Hinf => "hinf",
        ControllerKind::Pid => "pid",
    }
}

/// Inverse of [`kind_name`]; `lqi` is short for `lqr_integral`.
pub fn kind_by_name(name: &str) -> Option<ControllerKind> {
    let name = if name == "lqi" { "lqr_integral" } else { name };
    KINDS.into_iter().find(|&kind| kind_name(kind) == name)
}

/// Parameters of `kind` beyond the weights, in the order of [`Design::parameters`].
pub fn parameters(kind: ControllerKind) -> &'static [Parameter] {
    match kind {
        ControllerKind::Lqg => &lqg::PARAMETERS,
        ControllerKind::Hinf => &hinf::PARAMETERS,
        ControllerKind::Pid => &pid::PARAMETERS,
        _ => &[],
    }
}

/// Does `kind` come from weights?
pub fn weighted(kind: ControllerKind) -> bool {
    matches!(kind, ControllerKind::LqrIntegral | ControllerKind::Lqr | ControllerKind::Lqg)
}

/// A design as it is asked for: what is left out takes its default for the airframe.
#[derive(Debug, Clone, PartialEq)]
pub struct Proposal {
    /// Which law.
    pub kind: ControllerKind,
    /// Weights, where the law comes from them.
    pub weights: Option<Weights>,
    /// Parameters by name.
    pub parameters: ArrayVec<(ArrayString<MAX_NAME>, f64), MAX_PARAMETERS>,
    /// K and K without the horizontal loop, instead of weights.
    pub k: Option<[Gain; 2]>,
}

impl Proposal {
    /// `kind` with all its defaults.
    pub fn new(kind: ControllerKind) -> Self {
        Self { kind, weights: None, parameters: ArrayVec::new(), k: None }
    }

    /// LQR with integrals from `weights`.
    pub fn from_weights(weights: Weights) -> Self {
        Self { weights: Some(weights), ..Self::new(ControllerKind::LqrIntegral) }
    }

    /// Adds a parameter.
    ///
    /// # Errors
    /// A text: the name is too long for any parameter, or there are more than any controller has.
    pub fn parameter(&mut self, name: &str, value: f64) -> Result<(), String> {
        let short = ArrayString::from(name).map_err(|_| format!("no parameter is called {name:.40?}"))?;
        let full = |_| format!("more than {MAX_PARAMETERS} parameters");
        self.parameters.try_push((short, value)).map_err(full)
    }

    /// The whole design for `airframe`.
    ///
    /// # Errors
    /// [`GainsError::UnknownParameter`].
    pub fn complete(&self, airframe: &Airframe) -> Result<Design, GainsError> {
        let mut design = Design::new(self.kind, airframe);
        if let Some(weights) = self.weights {
            design.weights = weights;
        }
        for (name, value) in &self.parameters {
            design.set(name, *value)?;
        }
        design.k = self.k;
        Ok(design)
    }
}

/// A controller to be solved and examined.
#[derive(Debug, Clone, PartialEq)]
pub struct Design {
    /// Which law.
    pub kind: ControllerKind,
    /// Where the law comes from weights.
    pub weights: Weights,
    /// Values of [`parameters`].
    pub parameters: ArrayVec<f64, MAX_PARAMETERS>,
    /// K and K without the horizontal loop, instead of weights.
    pub k: Option<[Gain; 2]>,
}

impl Design {
    /// `kind` with every default for `airframe`.
    pub fn new(kind: ControllerKind, airframe: &Airframe) -> Self {
        let defaults: &[f64] = match kind {
            ControllerKind::Lqg => &lqg::DEFAULTS,
            ControllerKind::Hinf => &hinf::DEFAULTS,
            ControllerKind::Pid => &pid::DEFAULTS,
            _ => &[],
        };
        Self { kind, weights: Weights::for_airframe(airframe), parameters: defaults.iter().copied().collect(), k: None }
    }

    /// LQR with integrals from `weights`.
    pub fn from_weights(weights: Weights) -> Self {
        Self { kind: ControllerKind::LqrIntegral, weights, parameters: ArrayVec::new(), k: None }
    }

    /// Sets one parameter by its name.
    ///
    /// # Errors
    /// [`GainsError::UnknownParameter`]; the value is checked by [`Design::check`].
    pub fn set(&mut self, name: &ArrayString<MAX_NAME>, value: f64) -> Result<(), GainsError> {
        let place = parameters(self.kind).iter().position(|p| p.name == name.as_str());
        let unknown = GainsError::UnknownParameter { controller: kind_name(self.kind), name: *name };
        *place.and_then(|i| self.parameters.get_mut(i)).ok_or(unknown)? = value;
        Ok(())
    }

    /// Checks every number.
    ///
    /// # Errors
    /// The first bad one, by name and value.
    pub fn check(&self) -> Result<(), GainsError> {
        if self.kind == ControllerKind::Unspecified {
            return Err(GainsError::NoSuchController { controller: kind_name(self.kind) });
        }
        if let Some(gains) = &self.k {
            if !matches!(self.kind, ControllerKind::LqrIntegral | ControllerKind::Lqr) {
                return Err(GainsError::NotByK { controller: kind_name(self.kind) });
            }
            return gains.iter().try_for_each(super::gains::check_k);
        }
        if weighted(self.kind) {
            super::gains::check_weights(&self.weights)?;
        }
        for (parameter, &value) in parameters(self.kind).iter().zip(&self.parameters) {
            if !(parameter.min..=parameter.max).contains(&value) {
                let Parameter { name, unit, min, max } = *parameter;
                return Err(GainsError::Parameter { name, value, unit, min, max });
            }
        }
        Ok(())
    }
}
