//! Bodies of downloads: files in ranges, exports as they are made.
//!
//! A client may stop reading in the middle. A file's next piece is read when the client has taken the one before, so that
//! a stalled one holds no thread; an export holds one, [`MAX_DOWNLOADS_EACH`] at most for each person, until the
//! connection's time-out ends it.

use std::collections::HashMap;
use std::sync::{Arc, Mutex};

use axum::body::{Body, Bytes};
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{IntoResponse as _, Response};
use futures_util::stream;
use tokio::runtime::Handle;
use tokio::sync::mpsc;

use super::error::ApiError;
use super::tag::{self, Known};
use crate::recorder::{RecordingError, Snapshot};
use crate::sync::lock;

/// Most downloads at once.
const MAX_DOWNLOADS: usize = 24;
/// Most of one person: as many connections as a browser makes.
const MAX_DOWNLOADS_EACH: usize = 6;
/// A download turned away may be tried again after this long, s.
const AGAIN_S: u64 = 5;
/// Bytes of a file read at once.
const PIECE: usize = 64 << 10;
/// Pieces of an export made ahead of the client.
const AHEAD: usize = 8;

/// The downloads that go on, by person.
#[derive(Debug, Default)]
pub(crate) struct Downloads(Mutex<HashMap<String, usize>>);

/// One of them; over when dropped.
#[derive(Debug)]
pub(crate) struct Download {
    downloads: Arc<Downloads>,
    who: String,
}

impl Downloads {
    /// Begins one.
    pub(crate) fn begin(self: &Arc<Self>, who: &str) -> Result<Download, ApiError> {
        let mut open = lock(&self.0);
        let (all, theirs) = (open.values().sum::<usize>(), open.get(who).copied().unwrap_or(0));
        if theirs >= MAX_DOWNLOADS_EACH {
            return Err(ApiError::Throttled(AGAIN_S, format!("{theirs} of your downloads go on, no more are allowed")));
        }
        if all >= MAX_DOWNLOADS {
            return Err(ApiError::Throttled(AGAIN_S, format!("{all} downloads go on, no more are allowed")));
        }
        *open.entry(who.to_owned()).or_default() += 1;
        Ok(Download { downloads: self.clone(), who: who.to_owned() })
    }

    /// How many go on.
    pub(crate) fn count(&self) -> usize {
        lock(&self.0).values().sum()
    }
}

impl Drop for Download {
    fn drop(&mut self) {
        let mut open = lock(&self.downloads.0);
        if let Some(count) = open.get_mut(&self.who) {
            *count -= 1;
            if *count == 0 {
                open.remove(&self.who);
            }
        }
    }
}

/// A flight's file, or the range of it that is asked for. With `If-Range` a download that broke off goes on where it was,
/// also when the flight has grown meanwhile.
pub(crate) fn file(
    mut flight: Snapshot,
    asked: &HeaderMap,
    download: Download,
    threads: Handle,
) -> Result<Response, ApiError> {
    let text = |name| asked.get(name).and_then(|value| value.to_str().ok());
    let tag = flight.tag();
    if Known::of(asked).has(&tag) {
        return Ok(tag::unchanged(tag));
    }
    let unchanged = text(header::IF_RANGE).is_none_or(|tag| flight.go_back_to(tag));
    let (length, tag) = (flight.length(), flight.tag());
    // Several ranges at once are as good as none, and so is what is no range: everything is sent.
    let ranges = text(header::RANGE).filter(|range| unchanged && !range.contains(',')).and_then(|range| {
        let range = http_range_header::parse_range_header(range).ok()?;
        Some(range.validate(length).ok().and_then(|valid| valid.first().cloned()))
    });
    let (status, range) = match ranges {
        None => (StatusCode::OK, None),
        Some(Some(range)) => (StatusCode::PARTIAL_CONTENT, Some(range)),
        Some(None) => return Err(ApiError::Range(length)),
    };
    let (from, until) = range.as_ref().map_or((0, length), |range| (*range.start(), range.end() + 1));
    let mut headers = vec![
        (header::CONTENT_TYPE, "application/octet-stream".to_owned()),
        (header::ACCEPT_RANGES, "bytes".to_owned()),
        (header::ETAG, tag),
        (header::CONTENT_LENGTH, (until - from).to_string()),
    ];
    if range.is_some() {
        headers.push((header::CONTENT_RANGE, format!("bytes {from}-{}/{length}", until - 1)));
    }
    let pieces = stream::try_unfold((Arc::new(flight), from, download), move |(flight, at, download)| {
        let threads = threads.clone();
        async move {
            let most = usize::try_from(until - at).unwrap_or(PIECE).min(PIECE);
            if most == 0 {
                return Ok::<_, std::io::Error>(None);
            }
            let source = flight.clone();
            let piece = threads.spawn_blocking(move || source.piece(at, most)).await??;
            Ok(Some((Bytes::from(piece), (flight, at + most as u64, download))))
        }
    });
    let headers = axum::response::AppendHeaders(headers);
    Ok((status, headers, Body::from_stream(pieces)).into_response())
}

/// A body that `write` produces on a thread of its own, at most [`AHEAD`] pieces ahead of the client.
pub(crate) fn export(
    download: Download,
    write: impl FnOnce(&mut dyn FnMut(Vec<u8>) -> bool) -> Result<(), RecordingError> + Send + 'static,
) -> Body {
    let (sender, receiver) = mpsc::channel::<Result<Vec<u8>, std::io::Error>>(AHEAD);
    tokio::task::spawn_blocking(move || {
        let _download = download;
        let mut sink = |piece: Vec<u8>| sender.blocking_send(Ok(piece)).is_ok();
        if let Err(error) = write(&mut sink) {
            tracing::error!(%error, "download broke off");
            // The client sees a broken body, not a short one.
            let _ = sender.blocking_send(Err(std::io::Error::other(error.to_string())));
        }
    });
    Body::from_stream(stream::unfold(receiver, |mut receiver| async move {
        receiver.recv().await.map(|piece| (piece, receiver))
    }))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_person_takes_no_place_of_others_and_a_place_comes_back() {
        let downloads = Arc::new(Downloads::default());
        let (ann, bob) = ("ann", "bob");
        let mut open: Vec<_> = (0..MAX_DOWNLOADS_EACH).map(|_| downloads.begin(ann).unwrap()).collect();
        assert!(matches!(downloads.begin(ann), Err(ApiError::Throttled(AGAIN_S, _))));
        assert!(downloads.begin(bob).is_ok());
        assert_eq!(downloads.count(), MAX_DOWNLOADS_EACH);
        open.pop();
        assert!(downloads.begin(ann).is_ok());
        drop(open);
        assert!(lock(&downloads.0).is_empty());
    }
}
