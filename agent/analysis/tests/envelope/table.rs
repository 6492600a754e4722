//! The bound of a flight, read between the rows of its table, against the bound itself.

use plumbline_analysis::envelope::sets::{Asked, USUAL_HORIZON_S, largest_m};
use plumbline_rest::design::Design;
use plumbline_rest::envelope::{EnvelopeQuestion, NOISES_MPS2, around, between};
use rand::{RngExt as _, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;

/// What is read is larger than the bound by at most so much.
const LARGER: f64 = 1.15;
/// Noises drawn for each vehicle.
const DRAWN: usize = 5;

fn bound_m(of: &EnvelopeQuestion, noise_mps2: f64, rectified_mps2: f64) -> f64 {
    let [noise_mps2, rectified_mps2] = [noise_mps2, rectified_mps2].map(Some);
    let asked = Asked::new(&EnvelopeQuestion { noise_mps2, rectified_mps2, ..of.clone() }, None).unwrap();
    largest_m(&asked.flying, 1, USUAL_HORIZON_S, || true).unwrap().unwrap()
}

/// GIVEN gains, and sensors that are excluded WHEN the bound of one attacked sensor is read between two rows for a drawn
/// noise, of accelerometers that rectify something, THEN it is never less than the bound found there, and hardly more.
#[test]
fn what_is_read_between_two_rows_is_never_less_than_the_bound() {
    let controlled = |name: &str| Design { controller: Some(name.into()), ..Design::default() };
    let vehicles = [
        (Design::default(), vec![]),
        (Design::default(), vec!["height 2".to_owned()]),
        (Design::default(), vec!["imu 1".to_owned(), "height 3".to_owned()]),
        (controlled("pid"), vec![]),
    ];
    let mut dice = Xoshiro256PlusPlus::seed_from_u64(3);
    let (mut least, mut most) = (f64::INFINITY, 0.0_f64);
    for (design, without) in vehicles {
        let of = EnvelopeQuestion { design, without, ..EnvelopeQuestion::default() };
        for _ in 0..DRAWN {
            let noise_mps2 = (dice.random_range(NOISES_MPS2[0].ln()..NOISES_MPS2[NOISES_MPS2.len() - 1].ln())).exp();
            let rectified_mps2 = dice.random_range(0.0..1.2);
            let either = around(rectified_mps2).unwrap();
            // The rows that it is read from.
            let after = NOISES_MPS2.iter().position(|row| *row >= noise_mps2).unwrap();
            let two = &NOISES_MPS2[after - 1..=after];
            let rows = either.map(|own| two.iter().map(|row| (*row, bound_m(&of, *row, own))).collect::<Vec<_>>());
            let read_m = between(&rows, noise_mps2, rectified_mps2).unwrap();
            let bound_m = bound_m(&of, noise_mps2, rectified_mps2);
            println!(
                "{:?} without {:?}, {noise_mps2:.3} and {rectified_mps2:.2} m/s²: {read_m:.4} m, the bound {bound_m:.4} m",
                of.design.controller, of.without
            );
            (least, most) = (least.min(read_m / bound_m), most.max(read_m / bound_m));
        }
    }
    println!("{least:.3} to {most:.3} of the bound");
    assert!(least >= 1.0 && most <= LARGER, "{least} to {most}");
}
