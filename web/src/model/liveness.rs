//! The page's sign of life: the challenge of the newest status in a batch, to be sent back at once.
//!
//! Triggered by the arrival of telemetry and not by a timer: browsers slow down the timers of a hidden tab, and not its
//! sockets. What a page in the background still answers is that it runs, with its operator signed in.

use plumbline_proto::{Kind, Message, codec, v1};

/// The answer to the newest challenge of `batch`, as it goes to the ground; `None` when it holds none.
pub fn answer(batch: &[u8]) -> Option<Vec<u8>> {
    let frames = codec::decode_batch(batch).ok()?.map_while(Result::ok);
    let status = frames.filter(|frame| frame.known_kind() == Some(Kind::Status)).last()?;
    let challenge = status.message::<v1::Status>().ok()?.challenge;
    (challenge != 0).then(|| v1::OperatorAlive { challenge }.encode_to_vec())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_newest_challenge_is_answered() {
        let mut batch = Vec::new();
        codec::begin_batch(&mut batch);
        assert_eq!(answer(&batch), None);
        for challenge in [7, 0, 9] {
            let status = v1::Status { challenge, ..Default::default() };
            codec::encode_message(&mut batch, Kind::Status, 0, 1, 1, &status);
        }
        codec::encode_message(&mut batch, Kind::Control, 0, 2, 1, &v1::Control::default());
        let sent = v1::OperatorAlive::decode(answer(&batch).unwrap().as_slice()).unwrap();
        assert_eq!(sent.challenge, 9);
        assert_eq!(answer(b"nonsense"), None);
    }
}
