//! The rig's I²C: chips at their addresses behind a socket.

use std::io::{self, ErrorKind, Read as _, Write as _};
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::Path;
use std::sync::atomic::{AtomicBool, AtomicU8, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::Duration;

use crate::chips::Chip;
use crate::{Plug, lock};

/// How often a thread looks whether it shall end.
const LOOK: Duration = Duration::from_millis(100);

/// A chip on the bus.
pub struct Placed {
    /// Its address.
    pub address: u8,
    /// Does it answer? One that hangs leaves its master without any answer; the others go on, unlike on two real wires.
    pub plug: Arc<AtomicU8>,
    /// Itself.
    pub chip: Mutex<Box<dyn Chip>>,
}

/// Serves the bus at `path`.
pub fn serve(path: &Path, chips: Vec<Placed>, stop: Arc<AtomicBool>) -> io::Result<JoinHandle<()>> {
    let _ = std::fs::remove_file(path);
    let listener = UnixListener::bind(path)?;
    listener.set_nonblocking(true)?;
    let chips: Arc<[Placed]> = chips.into();
    std::thread::Builder::new().name("bus".into()).spawn(move || {
        let mut served = Vec::new();
        while !stop.load(Ordering::Acquire) {
            if let Ok((socket, _)) = listener.accept() {
                let (chips, stop) = (chips.clone(), stop.clone());
                served.push(std::thread::spawn(move || drop(master(socket, &chips, &stop))));
            } else {
                std::thread::sleep(Duration::from_millis(5));
            }
        }
        for thread in served {
            let _ = thread.join();
        }
    })
}

/// Transfers of one master until it goes.
fn master(mut socket: UnixStream, chips: &[Placed], stop: &AtomicBool) -> io::Result<()> {
    socket.set_nonblocking(false)?;
    socket.set_read_timeout(Some(LOOK))?;
    while !stop.load(Ordering::Acquire) {
        let mut head = [0; 3];
        match socket.read_exact(&mut head) {
            Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => continue,
            other => other?,
        }
        let [address, written, wanted] = head.map(usize::from);
        let (mut write, mut read) = ([0; 256], [0; 256]);
        let (write, read) = (&mut write[..written], &mut read[..wanted]);
        socket.read_exact(write)?;
        let placed = chips.iter().find(|placed| usize::from(placed.address) == address);
        let plug = placed.map_or(Plug::Out as u8, |placed| placed.plug.load(Ordering::Acquire));
        if plug == Plug::Hanging as u8 {
            continue;
        }
        let there = placed.filter(|_| plug == Plug::In as u8);
        if there.is_some_and(|placed| lock(&placed.chip).transfer(write, read)) {
            socket.write_all(&[&[0], &*read].concat())?;
        } else {
            socket.write_all(&[1])?;
        }
    }
    Ok(())
}
