//! The rig's I²C: a PCA9685 at 0x40 and an INA226 at 0x41 behind a socket.

use std::io::{self, ErrorKind, Read as _, Write as _};
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::Path;
use std::sync::atomic::{AtomicBool, AtomicU8, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::Duration;

use plumbline_core::types::ROTORS;
use plumbline_devices::protocol::{ina, pca9685};

use crate::{Plug, PulseLog, keep, lock};

const PWM: u8 = 0x40;
const VOLTMETER: u8 = 0x41;
/// How often a thread looks whether it shall end.
const LOOK: Duration = Duration::from_millis(100);

/// Registers of the PWM chip.
struct Pwm {
    registers: [u8; 256],
    pulses: PulseLog,
}

impl Pwm {
    fn transfer(&mut self, write: &[u8], read: &mut [u8]) {
        let Some((first, data)) = write.split_first() else { return };
        let counts_up = self.registers[usize::from(pca9685::MODE1)] & 0x20 != 0;
        let mut at = usize::from(*first);
        for byte in data {
            self.registers[at & 0xff] = *byte;
            at += usize::from(counts_up || data.len() == 1);
        }
        for (offset, byte) in read.iter_mut().enumerate() {
            *byte = self.registers[(usize::from(*first) + offset) & 0xff];
        }
        if *first >= pca9685::CHANNELS && *first < pca9685::PRESCALE && !data.is_empty() {
            let prescale = self.registers[usize::from(pca9685::PRESCALE)];
            let width = |motor: usize| {
                let from = usize::from(pca9685::CHANNELS) + 4 * motor;
                let r = &self.registers;
                pca9685::decode_channel([r[from], r[from + 1], r[from + 2], r[from + 3]], prescale)
            };
            let widths: [f64; ROTORS] = std::array::from_fn(width);
            keep(&self.pulses, widths);
        }
    }
}

/// What the chips of the bus need of the world.
#[derive(Debug, Clone)]
pub struct Chips {
    /// Where pulses are written down.
    pub pulses: PulseLog,
    /// Of the battery, V.
    pub voltage: Arc<Mutex<f64>>,
    /// Of the PWM chip.
    pub motors: Arc<AtomicU8>,
    /// Of the voltmeter.
    pub battery: Arc<AtomicU8>,
}

/// Serves the bus at `path`.
pub fn serve(path: &Path, chips: &Chips, stop: Arc<AtomicBool>) -> io::Result<JoinHandle<()>> {
    let _ = std::fs::remove_file(path);
    let listener = UnixListener::bind(path)?;
    listener.set_nonblocking(true)?;
    let pwm = Arc::new(Mutex::new(Pwm { registers: [0; 256], pulses: chips.pulses.clone() }));
    let chips = chips.clone();
    std::thread::Builder::new().name("bus".into()).spawn(move || {
        let mut served = Vec::new();
        while !stop.load(Ordering::Acquire) {
            if let Ok((socket, _)) = listener.accept() {
                let (pwm, chips, stop) = (pwm.clone(), chips.clone(), stop.clone());
                served.push(std::thread::spawn(move || drop(master(socket, &pwm, &chips, &stop))));
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
fn master(mut socket: UnixStream, pwm: &Mutex<Pwm>, chips: &Chips, stop: &AtomicBool) -> io::Result<()> {
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
        let there = |plug: &AtomicU8| plug.load(Ordering::Acquire) == Plug::In as u8;
        let answers = match (address as u8, &*write) {
            (PWM, _) if there(&chips.motors) => {
                lock(pwm).transfer(write, read);
                true
            }
            (VOLTMETER, [register]) if there(&chips.battery) => {
                let word = match *register {
                    ina::MANUFACTURER => ina::TI,
                    ina::BUS_VOLTAGE => ina::encode_ina226(*lock(&chips.voltage)),
                    _ => 0,
                };
                read.iter_mut().zip(word.to_be_bytes()).for_each(|(to, from)| *to = from);
                true
            }
            _ => false,
        };
        if answers {
            socket.write_all(&[&[0], &*read].concat())?;
        } else {
            socket.write_all(&[1])?;
        }
    }
    Ok(())
}
