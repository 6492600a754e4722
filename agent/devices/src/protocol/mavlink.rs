//! MAVLink 1 and 2 frames of the common dialect in a stream, or in datagrams.
//!
//! 0xFE, length, sequence, system, component, message (1 byte), payload, sum; or 0xFD, length, flags that must be understood,
//! flags that need not, sequence, system, component, message (3 bytes), payload, sum, signature (13 bytes, where the first
//! flag says so). Without a key signatures are passed over; with one, a frame that is not signed with it is refused, as is one
//! whose signature's time is not newer than the last of its sender.

use std::sync::Arc;

use mavlink::dialects::common::MavMessage;
use mavlink::{
    MAV_STX, MAV_STX_V2, MAVLinkV2MessageRaw, MavHeader, MavlinkVersion, Message as _, SigningConfig, SigningData,
    calculate_crc,
};

use crate::fault::Fault;
use crate::framer::{Protocol, Scan, le};

/// The only flag that must be understood and is.
const SIGNED: u8 = 1;
const SIGNATURE: usize = 13;

/// Link of a signature: there is one.
const LINK: u8 = 0;

/// Signs and verifies with one key, which is never printed.
pub struct Signer(SigningData);

impl Signer {
    /// With `key`.
    pub fn new(key: [u8; 32]) -> Self {
        Self(SigningData::from_config(SigningConfig::new(key, LINK, true, false)))
    }

    /// `message` of `header`, signed.
    pub fn sign(&self, header: MavHeader, message: &MavMessage) -> MAVLinkV2MessageRaw {
        let mut raw = MAVLinkV2MessageRaw::new();
        raw.serialize_message_for_signing(header, message);
        self.0.sign_message(&mut raw);
        raw
    }

    /// Is this whole frame of version 2 signed, with our key, and not an old one?
    fn accepts(&self, frame: &[u8]) -> bool {
        let mut raw = MAVLinkV2MessageRaw::new();
        raw.as_mut_slice().iter_mut().zip(frame).for_each(|(to, from)| *to = *from);
        self.0.verify_signature(&raw)
    }
}

impl std::fmt::Debug for Signer {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("Signer")
    }
}

/// Decoder.
#[derive(Debug, Clone, Default)]
pub struct Frames {
    /// Who verifies signatures; `None`: nobody.
    pub signer: Option<Arc<Signer>>,
}

impl Protocol for Frames {
    type Reading = (MavHeader, MavMessage);
    const LONGEST: usize = 10 + 255 + 2 + SIGNATURE;

    fn scan(&mut self, bytes: &[u8]) -> Scan<Self::Reading> {
        let byte = |at: usize| bytes.get(at).copied();
        let (version, head) = match byte(0) {
            Some(MAV_STX_V2) => (MavlinkVersion::V2, 10),
            Some(MAV_STX) => (MavlinkVersion::V1, 6),
            _ => {
                let next = bytes.iter().position(|b| matches!(*b, MAV_STX | MAV_STX_V2));
                return Scan::Skip(next.unwrap_or(bytes.len()));
            }
        };
        let Some(length) = byte(1).map(usize::from) else { return Scan::More };
        let (signature, id, sender) = if version == MavlinkVersion::V2 {
            let Some(flags) = byte(2) else { return Scan::More };
            if flags & !SIGNED != 0 {
                return Scan::Frame(1, Err(Fault::Malformed("MAVLink flags")));
            }
            let [a, b, c] = le::bytes(bytes, 7);
            let id = u32::from_le_bytes([a, b, c, 0]);
            (if flags == SIGNED { SIGNATURE } else { 0 }, id, 4)
        } else {
            (0, byte(5).unwrap_or_default().into(), 2)
        };
        let Some(frame) = bytes.get(..head + length + 2 + signature) else { return Scan::More };
        let (body, sum) = frame.split_at(head + length);
        let expected = calculate_crc(body.get(1..).unwrap_or_default(), MavMessage::extra_crc(id));
        let got = le::u16(sum, 0);
        if expected != got {
            return Scan::Frame(1, Err(Fault::Checksum { expected: expected.into(), got: got.into() }));
        }
        let trusted = |signer: &Arc<Signer>| version == MavlinkVersion::V2 && signer.accepts(frame);
        if !self.signer.as_ref().is_none_or(trusted) {
            return Scan::Frame(frame.len(), Err(Fault::Unsigned));
        }
        let [sequence, system, component_id] = le::bytes(body, sender);
        let header = MavHeader { system_id: system.into(), component_id, sequence };
        // A value that the dialect does not know: of a newer dialect, or of another message with the same sum.
        let message = MavMessage::parse(version, id, body.get(head..).unwrap_or_default());
        Scan::Frame(frame.len(), message.map(|m| (header, m)).map_err(|_| Fault::Malformed("MAVLink message")))
    }
}
