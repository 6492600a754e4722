//! What a ground shares with others, where it was built to: the one place that knows of the feature `many`.

use std::sync::Arc;

use plumbline_rest::ground::Fleet;
use tokio::runtime::Handle;
use tokio::sync::watch;

use crate::api::App;
use crate::config::GroundConfig;
use crate::error::GroundError;
#[cfg(feature = "many")]
use crate::fleet;
use crate::recorder::{Recorder, SharedArchive};
use crate::work::Work;

/// What is shared with other grounds, nothing by default.
#[derive(Debug, Clone, Default)]
pub(crate) struct Shared {
    #[cfg(feature = "many")]
    parts: Option<fleet::Parts>,
}

#[cfg(feature = "many")]
impl Shared {
    pub(crate) fn of(config: &GroundConfig, work: Handle) -> Result<Self, GroundError> {
        let parts = config.fleet.as_ref().map(|fleet| fleet::Parts::of(fleet, &config.data_folder, work));
        Ok(Self { parts: parts.transpose().map_err(|error| GroundError::Fleet(error.to_string()))? })
    }

    pub(crate) fn archive(&self) -> Option<Arc<dyn SharedArchive>> {
        Some(self.parts.as_ref()?.archive.clone()?)
    }

    pub(crate) fn keep_in_line(&self, recorder: &Recorder, work: &Work, stopped: &watch::Receiver<bool>) {
        if let Some(archive) = self.parts.as_ref().and_then(|parts| parts.archive.clone()) {
            let (recorder, stopped) = (recorder.handle(), stopped.clone());
            work.handle().spawn(async move { archive.keep_in_line(recorder, stopped).await });
        }
    }

    pub(crate) fn be_live(&self, app: &App, stopped: &watch::Receiver<bool>) {
        if let Some(bus) = self.parts.as_ref().and_then(|parts| parts.bus.clone()) {
            tokio::spawn(bus.run(app.clone(), stopped.clone()));
        }
    }

    /// How it stands, for people.
    pub(crate) fn shown(&self) -> Option<Fleet> {
        self.parts.as_ref().map(fleet::Parts::shown)
    }
}

#[cfg(not(feature = "many"))]
impl Shared {
    pub(crate) fn of(config: &GroundConfig, _work: Handle) -> Result<Self, GroundError> {
        match config.fleet {
            None => Ok(Self {}),
            Some(_) => Err(GroundError::Fleet("fleet: this ground was built without --features many".into())),
        }
    }

    pub(crate) fn archive(&self) -> Option<Arc<dyn SharedArchive>> {
        None
    }

    pub(crate) fn keep_in_line(&self, _: &Recorder, _: &Work, _: &watch::Receiver<bool>) {}

    pub(crate) fn be_live(&self, _: &App, _: &watch::Receiver<bool>) {}

    /// Nothing.
    pub(crate) fn shown(&self) -> Option<Fleet> {
        None
    }
}
