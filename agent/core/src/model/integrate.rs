//! Fourth-order Runge–Kutta with a fixed step.

use nalgebra::SVector;

/// A state that can be moved along its derivative.
pub trait Integrable: Copy {
    /// The type of its derivative.
    type Derivative: Copy;
    /// self + derivative · h.
    fn moved(&self, derivative: &Self::Derivative, h: f64) -> Self;
}

impl<const N: usize> Integrable for SVector<f64, N> {
    type Derivative = Self;
    fn moved(&self, derivative: &Self, h: f64) -> Self {
        self + derivative * h
    }
}

/// One classical Runge–Kutta step of `h` for ẋ = f(x); inputs are constant over the step.
pub fn rk4<S: Integrable>(x: &S, h: f64, f: impl Fn(&S) -> S::Derivative) -> S {
    let k1 = f(x);
    let k2 = f(&x.moved(&k1, 0.5 * h));
    let k3 = f(&x.moved(&k2, 0.5 * h));
    let k4 = f(&x.moved(&k3, h));
    x.moved(&k1, h / 6.0).moved(&k2, h / 3.0).moved(&k3, h / 3.0).moved(&k4, h / 6.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector2;

    #[test]
    fn error_falls_with_the_fourth_power_of_the_step() {
        let swing = |steps: u32| {
            let h = 1.0 / f64::from(steps);
            let mut x = Vector2::new(1.0, 0.0);
            for _ in 0..steps {
                x = rk4(&x, h, |x| Vector2::new(x.y, -x.x));
            }
            (x - Vector2::new(1f64.cos(), -1f64.sin())).norm()
        };
        let ratio = swing(20) / swing(40);
        assert!((14.0..18.0).contains(&ratio), "{ratio}");
    }
}
