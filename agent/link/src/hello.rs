//! The first message on each connection, both ways.

use std::time::Duration;

use plumbline_proto::SCHEMA;
use plumbline_proto::ids::FlightId;
use plumbline_proto::v1::{Hello, command_frame::Body};

use super::transport::{FrameReader, StreamError};

/// How long a peer may take to say hello.
pub const HELLO_TIMEOUT: Duration = Duration::from_secs(2);

/// Why a peer's hello is not accepted.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum HelloError {
    /// The peers speak different schemas.
    #[error("{peer} speaks schema {found} (version {version}), this side speaks schema {SCHEMA}")]
    Schema {
        /// The peer.
        peer: String,
        /// Its schema.
        found: u32,
        /// Its version.
        version: String,
    },
    /// The peer's name could not be a file's name.
    #[error("the id {id:?} is not 1 to 64 letters, digits, '-' or '_'")]
    Id {
        /// Its name.
        id: String,
    },
}

/// Waits for the peer's hello.
///
/// # Errors
/// [`StreamError`] when it does not come in time, or something else does.
pub async fn receive(reader: &mut FrameReader) -> Result<Hello, StreamError> {
    let expected = "hello";
    match tokio::time::timeout(HELLO_TIMEOUT, reader.next()).await {
        Err(_) => Err(StreamError::Timeout { expected, seconds: HELLO_TIMEOUT.as_secs_f64() }),
        Ok(frame) => match frame? {
            Some(Body::Hello(hello)) => Ok(hello),
            Some(_) => Err(StreamError::Unexpected { expected, found: "another message".to_owned() }),
            None => Err(StreamError::Unexpected { expected, found: "the end of the stream".to_owned() }),
        },
    }
}

/// Checks a hello.
///
/// # Errors
/// [`HelloError`] with both schemas, or the id.
pub fn check(hello: &Hello) -> Result<(), HelloError> {
    if hello.schema != u32::from(SCHEMA) {
        return Err(HelloError::Schema { peer: short(&hello.id), found: hello.schema, version: short(&hello.version) });
    }
    if FlightId::new(hello.id.as_str()).is_err() {
        return Err(HelloError::Id { id: short(&hello.id) });
    }
    Ok(())
}

fn short(text: &str) -> String {
    text.chars().filter(|c| !c.is_control()).take(FlightId::MAX_LEN).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_hello_of_another_schema_is_refused_naming_both() {
        let hello = Hello { schema: 9, id: "iris-1".into(), version: "2.0".into(), ..Default::default() };
        assert_eq!(
            check(&hello).unwrap_err().to_string(),
            "iris-1 speaks schema 9 (version 2.0), this side speaks schema 1"
        );
        let hello = Hello { schema: u32::from(SCHEMA), id: "../x".into(), ..Default::default() };
        assert!(check(&hello).unwrap_err().to_string().contains("../x"));
    }
}
