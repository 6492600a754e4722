//! Closed forms of what is expected of attacks that only add where no judge of the lanes hears it.
//!
//! | attack | who tells | form |
//! |---|---|---|
//! | a rotor scaled | the sums of `flight/rotors.rs` | a Brownian motion passes a limit (Wald 1947, inverse Gaussian) |
//! | an accelerometer replayed | the watermark, once in 10 s | Φ((δ − 3.09)/√(1 + (κδ)²)) |
//!
//! δ = 57 A for a watermark of rms A, m/s²: t lay at −5.7 for 0.1 in flight. κ: what is replayed carries the watermark of then, which
//! resembles that of now by chance, as the decoys do that σ comes of; both grow with δ. Flown, t spread by 1.8 at δ = 5.7.

use plumbline_core::flight::watermark::{BLOCK_S, LIMIT};
use plumbline_core::flight::{ROTOR_LIMIT, ROTOR_LOSS};

/// δ over A, s²/m.
const DEFLECTION: f64 = 57.0;
/// κ, by the spread of 1.8 at 5.7: √(1.8² − 1)/5.7.
const RESEMBLES: f64 = 0.263;

/// How likely a loss ℓ is isolated within `within_s`: a Brownian motion of drift (ℓ ℓ₀ − ½ ℓ₀²) S and variance ℓ₀² S passes h by
/// then. S is the information of a whole rotor in a second.
pub fn rotor_isolated(loss: f64, information: f64, within_s: f64) -> f64 {
    let drift = (loss * ROTOR_LOSS - 0.5 * ROTOR_LOSS * ROTOR_LOSS) * information;
    let spread = ROTOR_LOSS * information.sqrt();
    let root = within_s.sqrt();
    let first = normal((drift * within_s - ROTOR_LIMIT) / (spread * root));
    let exponent = 2.0 * drift * ROTOR_LIMIT / (spread * spread);
    let second = normal((-drift * within_s - ROTOR_LIMIT) / (spread * root));
    (first + if second > 0.0 { (exponent + second.ln()).exp() } else { 0.0 }).clamp(0.0, 1.0)
}

/// How likely a block of 10 s that is wholly replayed does not carry a watermark of this rms, m/s².
pub fn block_told(rms_mps2: f64) -> f64 {
    let deflection = DEFLECTION * rms_mps2;
    normal((deflection - LIMIT) / (1.0 + (RESEMBLES * deflection).powi(2)).sqrt())
}

/// How likely any block of a replay of `lasts_s` is told, the onset anywhere in a block. Blocks that it fills in part count for nothing.
pub fn replay_told(rms_mps2: f64, lasts_s: f64) -> f64 {
    let blocks = (lasts_s / BLOCK_S).max(0.0);
    let (whole, part) = (blocks.floor(), blocks.fract());
    let none = |blocks: f64| (1.0 - block_told(rms_mps2)).powf(blocks.max(0.0));
    1.0 - part * none(whole) - (1.0 - part) * none(whole - 1.0)
}

/// Φ, by the complementary error function of Abramowitz & Stegun 7.1.26 (1.5e-7).
fn normal(x: f64) -> f64 {
    let z = x.abs() / std::f64::consts::SQRT_2;
    let t = 1.0 / (1.0 + 0.327_591_1 * z);
    let poly =
        t * (0.254_829_592 + t * (-0.284_496_736 + t * (1.421_413_741 + t * (-1.453_152_027 + t * 1.061_405_429))));
    let tail = 0.5 * poly * (-z * z).exp();
    if x > 0.0 { 1.0 - tail } else { tail }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_watermark_tells_what_it_did_in_flight_and_nothing_without_one() {
        // Φ((5.7 − 3.09)/1.8) = Φ(1.45).
        assert!((block_told(0.1) - 0.926_5).abs() < 1e-3, "{}", block_told(0.1));
        // One healthy block of a thousand.
        assert!((block_told(0.0) - 0.001).abs() < 1e-5);
        assert!((normal(1.96) - 0.975).abs() < 1e-5 && (normal(-1.0) - 0.158_655).abs() < 1e-6);
        // 10 s fill a block by no chance at all, 15 s by one of two, 20 s in any case.
        let told = [10.0, 15.0, 20.0].map(|lasts_s| replay_told(0.1, lasts_s));
        assert!(told[0].abs() < 1e-12 && (told[1] - 0.5 * told[2]).abs() < 1e-12, "{told:?}");
        assert!(
            (told[2] - block_told(0.1)).abs() < 1e-12 && replay_told(0.1, 40.0) > 0.99 && replay_told(0.1, 3.0) == 0.0
        );
    }

    #[test]
    fn the_larger_the_loss_and_the_longer_the_surer() {
        let of = |loss, within_s| rotor_isolated(loss, 2000.0, within_s);
        assert!(of(0.2, 0.3) > of(0.1, 0.3) && of(0.1, 5.0) > of(0.1, 0.3), "{} {}", of(0.1, 0.3), of(0.2, 0.3));
        assert!(of(0.5, 5.0) > 0.999 && of(0.0, 0.3) < 0.01);
    }
}
