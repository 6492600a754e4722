//! The values of the last T slots, as they came.

use nalgebra::SVector;

use super::MAX_SLOTS;

/// Values by sensor and slot number modulo T. Age 0 is the newest slot.
#[derive(Debug, Clone)]
pub(super) struct Ring<const N: usize> {
    slots: usize,
    filled: usize,
    head: usize,
    masks: Vec<u128>,
    /// Sensor × slots.
    values: Vec<f64>,
    /// Forced response from the slot before.
    forced: Vec<SVector<f64, N>>,
    is_forced: bool,
}

impl<const N: usize> Ring<N> {
    /// Empty.
    pub fn new(sensors: usize, slots: usize) -> Self {
        Self {
            slots,
            filled: 0,
            head: 0,
            masks: vec![0; sensors],
            values: vec![0.0; sensors * slots],
            forced: vec![SVector::zeros(); slots],
            is_forced: false,
        }
    }

    /// T.
    pub fn slots(&self) -> usize {
        self.slots
    }

    /// Slots so far, at most T.
    pub fn filled(&self) -> usize {
        self.filled
    }

    /// Has any slot had a forced response?
    pub fn is_forced(&self) -> bool {
        self.is_forced
    }

    /// Slots filled of `sensor`, bit k = age k.
    pub fn mask(&self, sensor: usize) -> u128 {
        self.masks.get(sensor).copied().unwrap_or_default()
    }

    /// The sensors with values, and their masks.
    pub fn present(&self) -> impl Iterator<Item = (usize, u128)> {
        self.masks.iter().copied().enumerate().filter(|(_, mask)| *mask != 0)
    }

    /// Forgets every value.
    pub fn clear(&mut self) {
        self.filled = 0;
        self.masks.fill(0);
        self.is_forced = false;
        self.forced.fill(SVector::zeros());
    }

    /// Begins a new slot, with the forced response of the step into it.
    pub fn advance(&mut self, forced: Option<&SVector<f64, N>>) {
        self.head = (self.head + 1) % self.slots;
        self.filled = (self.filled + 1).min(self.slots);
        let keep = if self.slots == MAX_SLOTS { u128::MAX } else { (1 << self.slots) - 1 };
        self.masks.iter_mut().for_each(|mask| *mask = (*mask << 1) & keep);
        if let Some(slot) = self.forced.get_mut(self.head) {
            *slot = forced.copied().filter(|b| b.iter().all(|v| v.is_finite())).unwrap_or_else(SVector::zeros);
        }
        self.is_forced |= forced.is_some();
    }

    /// Value of `sensor` in the newest slot; what is not finite is skipped.
    pub fn put(&mut self, sensor: usize, value: f64) {
        let at = sensor * self.slots + self.head;
        if let (Some(mask), Some(slot), true) =
            (self.masks.get_mut(sensor), self.values.get_mut(at), value.is_finite() && self.filled > 0)
        {
            *slot = value;
            *mask |= 1;
        }
    }

    /// Where the value of `sensor` of that `age` is, filled or not.
    fn place(&self, sensor: usize, age: usize) -> usize {
        sensor * self.slots + self.slot(age)
    }

    fn slot(&self, age: usize) -> usize {
        (self.head + self.slots - age) % self.slots
    }

    /// Value of `sensor` of that `age`, filled or not.
    pub fn value(&self, sensor: usize, age: usize) -> Option<f64> {
        self.values.get(self.place(sensor, age)).copied()
    }

    /// The same, to alter.
    pub fn value_mut(&mut self, sensor: usize, age: usize) -> Option<&mut f64> {
        let at = self.place(sensor, age);
        self.values.get_mut(at)
    }

    /// Forced response into the slot of that `age`.
    pub fn forced(&self, age: usize) -> Option<&SVector<f64, N>> {
        self.forced.get(self.slot(age))
    }
}
