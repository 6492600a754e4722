//! Paths and queries as handlers take them, with the API's own errors.

use axum::extract::FromRequestParts;
use axum::http::request::Parts;
use plumbline_rest::flight::{MAX_PAGE, finds};
use serde::Deserialize;
use serde::de::DeserializeOwned;

use super::error::ApiError;

/// The parts of a path.
pub(crate) struct Path<T>(pub(crate) T);

impl<T: DeserializeOwned + Send, S: Send + Sync> FromRequestParts<S> for Path<T> {
    type Rejection = ApiError;

    async fn from_request_parts(parts: &mut Parts, state: &S) -> Result<Self, ApiError> {
        let path = <axum::extract::Path<T> as FromRequestParts<S>>::from_request_parts(parts, state).await;
        path.map(|axum::extract::Path(path)| Self(path)).map_err(|e| ApiError::Invalid(e.body_text()))
    }
}

/// What is asked behind the question mark.
pub(crate) struct Query<T>(pub(crate) T);

impl<T: DeserializeOwned, S: Send + Sync> FromRequestParts<S> for Query<T> {
    type Rejection = ApiError;

    async fn from_request_parts(parts: &mut Parts, state: &S) -> Result<Self, ApiError> {
        let query = axum::extract::Query::<T>::from_request_parts(parts, state).await;
        query.map(|axum::extract::Query(query)| Self(query)).map_err(|e| ApiError::Invalid(e.body_text()))
    }
}

/// Which page of a list is asked for.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Page {
    /// So many are passed over.
    #[serde(default)]
    pub(crate) offset: usize,
    limit: Option<usize>,
    /// Words that must all be found in what is listed.
    #[serde(default)]
    pub(crate) search: String,
}

impl Page {
    /// How many it may have; `standard` where nothing is said.
    pub(crate) fn limit(&self, standard: usize) -> Result<usize, ApiError> {
        page_limit(self.limit.unwrap_or(standard))
    }

    /// What is on it, of all whose text has every word; and how many those are.
    pub(crate) fn of<T>(&self, mut all: Vec<T>, text: impl Fn(&T) -> String) -> Result<(Vec<T>, u64), ApiError> {
        if !self.search.trim().is_empty() {
            let found = finds(&self.search);
            all.retain(|entry| found(&text(entry)));
        }
        let total = all.len() as u64;
        Ok((all.into_iter().skip(self.offset).take(self.limit(MAX_PAGE)?).collect(), total))
    }
}

/// A number of entries that a page may have.
pub(crate) fn page_limit(limit: usize) -> Result<usize, ApiError> {
    if (1..=MAX_PAGE).contains(&limit) {
        return Ok(limit);
    }
    Err(ApiError::Invalid(format!("limit {limit} is outside 1 to {MAX_PAGE}")))
}
