//! The page's addresses.

/// A page.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub enum Route {
    /// The everyday screen.
    #[default]
    Fly,
    /// The list of recorded flights.
    Flights,
    /// One recorded flight.
    Flight(String),
    /// The report of one.
    Report(String),
    /// Several recorded flights, overlaid.
    Compare(Vec<String>),
    /// Plans of many flights.
    Experiments,
    /// Controllers designed, previewed, pushed.
    Tune,
    /// Sensors and motors calibrated.
    Calibrate,
    /// Ground, vehicle, suite, limits.
    Setup,
    /// No such page.
    Unknown(String),
}

impl Route {
    /// The page of `path`.
    pub fn from_path(path: &str) -> Self {
        let parts: Vec<&str> = path.split('/').filter(|p| !p.is_empty()).collect();
        match parts.as_slice() {
            [] => Self::Fly,
            ["flights"] => Self::Flights,
            ["flights", id] if id.contains(',') => {
                Self::Compare(id.split(',').filter(|p| !p.is_empty()).map(str::to_owned).collect())
            }
            ["flights", id] => Self::Flight((*id).to_owned()),
            ["flights", id, "report"] => Self::Report((*id).to_owned()),
            ["experiments"] => Self::Experiments,
            ["tune"] => Self::Tune,
            ["calibrate"] => Self::Calibrate,
            ["setup"] => Self::Setup,
            _ => Self::Unknown(path.to_owned()),
        }
    }

    /// Its address.
    pub fn path(&self) -> String {
        match self {
            Self::Fly => "/".to_owned(),
            Self::Flights => "/flights".to_owned(),
            Self::Flight(id) => format!("/flights/{id}"),
            Self::Report(id) => format!("/flights/{id}/report"),
            Self::Compare(ids) => format!("/flights/{}", ids.join(",")),
            Self::Experiments => "/experiments".to_owned(),
            Self::Tune => "/tune".to_owned(),
            Self::Calibrate => "/calibrate".to_owned(),
            Self::Setup => "/setup".to_owned(),
            Self::Unknown(path) => path.clone(),
        }
    }

    /// Its title in the browser's tab.
    pub fn title(&self) -> &'static str {
        match self {
            Self::Fly => "Fly – Plumbline",
            Self::Flights => "Flights – Plumbline",
            Self::Flight(_) => "Flight – Plumbline",
            Self::Report(_) => "Report – Plumbline",
            Self::Compare(_) => "Compare flights – Plumbline",
            Self::Experiments => "Experiments – Plumbline",
            Self::Tune => "Tune – Plumbline",
            Self::Calibrate => "Calibrate – Plumbline",
            Self::Setup => "Setup – Plumbline",
            Self::Unknown(_) => "Not found – Plumbline",
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paths_round_trip() {
        let routes = [
            Route::Fly,
            Route::Flights,
            Route::Flight("20261121T120000-iris-1-0001".into()),
            Route::Report("20261121T120000-iris-1-0001".into()),
            Route::Compare(vec!["a".into(), "b".into()]),
            Route::Experiments,
            Route::Tune,
            Route::Calibrate,
            Route::Setup,
        ];
        for route in routes {
            assert_eq!(Route::from_path(&route.path()), route);
        }
        assert_eq!(Route::from_path("/flights/"), Route::Flights);
        assert_eq!(Route::from_path("/nowhere"), Route::Unknown("/nowhere".into()));
    }
}
