/// Why bytes are not a valid batch, frame or message.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum DecodeError {
    /// The batch does not begin with the magic byte.
    #[error("not a Plumbline batch: first byte {found:#04x}, expected {expected:#04x}")]
    Magic {
        /// Byte found.
        found: u8,
        /// Byte expected.
        expected: u8,
    },
    /// The peer speaks another version of the contract.
    #[error("schema {found}, this side speaks schema {expected}")]
    Schema {
        /// Version found.
        found: u8,
        /// Version of this build.
        expected: u8,
    },
    /// The bytes end inside a header or a payload.
    #[error("truncated: {needed} bytes needed, {available} left")]
    Truncated {
        /// Bytes needed.
        needed: usize,
        /// Bytes left.
        available: usize,
    },
    /// A length field above its limit.
    #[error("oversized: {length} bytes, limit {limit}")]
    Oversized {
        /// Length claimed.
        length: usize,
        /// Limit.
        limit: usize,
    },
    /// The payload is not the protobuf message its kind promises.
    #[error("malformed {message}: {reason}")]
    Malformed {
        /// Name of the message.
        message: &'static str,
        /// What the protobuf decoder says.
        reason: String,
    },
    /// A number that must be finite is not.
    #[error("{field} is {value}, a finite number is needed")]
    NotFinite {
        /// Name of the field.
        field: &'static str,
        /// Value found.
        value: String,
    },
}
