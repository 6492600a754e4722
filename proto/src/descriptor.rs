//! The schema's own description, embedded in every flight file.

/// The compiled `FileDescriptorSet` of `schema/`, protobuf-encoded.
pub const FILE_DESCRIPTOR_SET: &[u8] = include_bytes!(concat!(env!("OUT_DIR"), "/descriptors.bin"));

/// What of [`FILE_DESCRIPTOR_SET`] describes the message of this full name and all that is in it, itself a `FileDescriptorSet`; all of it
/// for a name that the schema has not.
pub fn describing(message: &str) -> &'static [u8] {
    include!(concat!(env!("OUT_DIR"), "/describing.rs"))
}
