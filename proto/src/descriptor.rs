//! The schema's own description, embedded in every flight file.

/// The compiled `FileDescriptorSet` of `schema/`, protobuf-encoded.
pub const FILE_DESCRIPTOR_SET: &[u8] = include_bytes!(concat!(env!("OUT_DIR"), "/descriptors.bin"));

#[cfg(test)]
mod tests {
    use crate::Kind;

    #[test]
    fn every_kind_names_a_message_of_the_schema() {
        let text = String::from_utf8_lossy(super::FILE_DESCRIPTOR_SET).into_owned();
        for kind in Kind::ALL {
            let short = kind.message_name().rsplit('.').next().unwrap();
            assert!(text.contains(short), "{short} is not in the descriptor set");
        }
    }
}
