//! Who holds control of a vehicle: one operator at a time, any number of viewers.
//!
//! A command while nobody holds control takes it; taking over is always possible, explicit, and
//! shown to everyone. The motor cut never asks.

use std::collections::BTreeMap;
use std::sync::Mutex;

use crate::sync::lock;

/// Another operator holds control.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("operator {holder:?} holds control")]
pub struct Held {
    /// Who.
    pub holder: String,
}

/// The leases of all vehicles.
#[derive(Debug, Default)]
pub struct Leases {
    holders: Mutex<BTreeMap<String, String>>,
}

impl Leases {
    /// Lets `operator` command `vehicle` when it holds control or nobody does.
    /// Answers whether the holder changed.
    ///
    /// # Errors
    /// [`Held`] by someone else.
    pub fn claim(&self, vehicle: &str, operator: &str) -> Result<bool, Held> {
        let mut holders = lock(&self.holders);
        match holders.get(vehicle) {
            Some(holder) if holder == operator => Ok(false),
            Some(holder) => Err(Held { holder: holder.clone() }),
            None => {
                holders.insert(vehicle.to_owned(), operator.to_owned());
                Ok(true)
            }
        }
    }

    /// Takes control, from whoever has it. Answers the holder before.
    pub fn take(&self, vehicle: &str, operator: &str) -> Option<String> {
        lock(&self.holders).insert(vehicle.to_owned(), operator.to_owned())
    }

    /// Gives control back.
    ///
    /// # Errors
    /// [`Held`] by someone else. Releasing what nobody holds is not an error.
    pub fn release(&self, vehicle: &str, operator: &str) -> Result<(), Held> {
        let mut holders = lock(&self.holders);
        match holders.get(vehicle) {
            Some(holder) if holder != operator => Err(Held { holder: holder.clone() }),
            _ => {
                holders.remove(vehicle);
                Ok(())
            }
        }
    }

    /// Who holds control.
    pub fn holder(&self, vehicle: &str) -> Option<String> {
        lock(&self.holders).get(vehicle).cloned()
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
}
