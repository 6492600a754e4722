mod chips;
mod garbage;
mod gnss;
mod mavlink;
mod mocap;
mod peers;
mod scanner;

use plumbline_devices::fault::Fault;
use plumbline_devices::framer::{Framer, Protocol};

/// All that `protocol` makes of `bytes`, in pieces of `piece`.
pub fn read<P: Protocol>(protocol: P, bytes: &[u8], piece: usize) -> Vec<Result<P::Reading, Fault>> {
    let mut framer = Framer::new(protocol);
    let mut all = Vec::new();
    for piece in bytes.chunks(piece) {
        framer.push(piece, |frame| all.push(frame));
    }
    all
}
