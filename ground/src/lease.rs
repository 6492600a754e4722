//! Who holds control of a vehicle: one operator at a time, any number of viewers.
//!
//! A command while nobody holds control takes it; taking over is always possible, explicit, and
//! shown to everyone. Control that is not used, by an operator who shows no sign of life, is given
//! up after a while. The motor cut never asks.

use std::collections::BTreeMap;
use std::sync::Mutex;
use std::time::{Duration, Instant};

use crate::sync::lock;

/// Another operator holds control.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("operator {holder:?} holds control")]
pub struct Held {
    /// Who.
    pub holder: String,
}

#[derive(Debug)]
struct Lease {
    holder: String,
    used: Instant,
}

/// The leases of all vehicles.
#[derive(Debug, Default)]
pub struct Leases {
    leases: Mutex<BTreeMap<String, Lease>>,
}

impl Leases {
    /// Lets `operator` command `vehicle` when it holds control or nobody does.
    /// Answers whether the holder changed.
    ///
    /// # Errors
    /// [`Held`] by someone else.
    pub fn claim(&self, vehicle: &str, operator: &str) -> Result<bool, Held> {
        let mut leases = lock(&self.leases);
        match leases.get_mut(vehicle) {
            Some(lease) if lease.holder == operator => {
                lease.used = Instant::now();
                Ok(false)
            }
            Some(lease) => Err(Held { holder: lease.holder.clone() }),
            None => {
                leases.insert(vehicle.to_owned(), Lease { holder: operator.to_owned(), used: Instant::now() });
                Ok(true)
            }
        }
    }

    /// Takes control, from whoever has it. Answers the holder before.
    pub fn take(&self, vehicle: &str, operator: &str) -> Option<String> {
        let lease = Lease { holder: operator.to_owned(), used: Instant::now() };
        lock(&self.leases).insert(vehicle.to_owned(), lease).map(|before| before.holder)
    }

    /// A sign of life of `operator`; does it hold control of `vehicle`?
    pub fn alive(&self, vehicle: &str, operator: &str) -> bool {
        let mut leases = lock(&self.leases);
        let Some(lease) = leases.get_mut(vehicle).filter(|lease| lease.holder == operator) else { return false };
        lease.used = Instant::now();
        true
    }

    /// Gives control back.
    ///
    /// # Errors
    /// [`Held`] by someone else. Releasing what nobody holds is not an error.
    pub fn release(&self, vehicle: &str, operator: &str) -> Result<(), Held> {
        let mut leases = lock(&self.leases);
        match leases.get(vehicle) {
            Some(lease) if lease.holder != operator => Err(Held { holder: lease.holder.clone() }),
            _ => {
                leases.remove(vehicle);
                Ok(())
            }
        }
    }

    /// Ends the leases unused for `idle`; answers vehicle and former holder of each.
    pub fn expire(&self, idle: Duration) -> Vec<(String, String)> {
        let now = Instant::now();
        let mut ended = Vec::new();
        lock(&self.leases).retain(|vehicle, lease| {
            let keep = now.saturating_duration_since(lease.used) < idle;
            if !keep {
                ended.push((vehicle.clone(), lease.holder.clone()));
            }
            keep
        });
        ended
    }

    /// Who holds control.
    pub fn holder(&self, vehicle: &str) -> Option<String> {
        lock(&self.leases).get(vehicle).map(|lease| lease.holder.clone())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_holder_until_someone_takes_over() {
        let leases = Leases::default();
        assert_eq!(leases.claim("v", "ann"), Ok(true));
        assert_eq!(leases.claim("v", "ann"), Ok(false));
        assert_eq!(leases.claim("v", "bob"), Err(Held { holder: "ann".into() }));
        assert_eq!(leases.claim("w", "bob"), Ok(true), "another vehicle is another lease");
        assert_eq!(leases.take("v", "bob"), Some("ann".into()));
        assert!(leases.release("v", "ann").is_err());
        assert_eq!(leases.release("v", "bob"), Ok(()));
        assert_eq!(leases.holder("v"), None);
    }

    #[test]
    fn unused_control_is_given_up_and_a_sign_of_life_keeps_it() {
        let leases = Leases::default();
        leases.claim("v", "ann").unwrap();
        assert!(leases.expire(Duration::from_secs(60)).is_empty());
        std::thread::sleep(Duration::from_millis(30));
        assert!(leases.alive("v", "ann") && !leases.alive("v", "bob"));
        assert!(leases.expire(Duration::from_millis(20)).is_empty());
        std::thread::sleep(Duration::from_millis(30));
        assert_eq!(leases.expire(Duration::from_millis(20)), [("v".to_owned(), "ann".to_owned())]);
        assert_eq!(leases.claim("v", "bob"), Ok(true));
    }
}
