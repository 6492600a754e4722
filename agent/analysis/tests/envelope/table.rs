//! The bound of a flight, read between the rows of its table, against the bound itself.

use plumbline_analysis::envelope::sets::{Asked, USUAL_HORIZON_S, largest_m};
use plumbline_rest::design::Design;
use plumbline_rest::envelope::{EnvelopeQuestion, NOISES_MPS2, between};
use rand::{RngExt as _, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;

/// What is read is larger than the bound by at most so much.
const LARGER: f64 = 1.13;
/// Noises drawn for each vehicle.
const DRAWN: usize = 5;

fn bound_m(of: &EnvelopeQuestion, noise_mps2: f64) -> f64 {
    let asked = Asked::new(&EnvelopeQuestion { noise_mps2: Some(noise_mps2), ..of.clone() }, None).unwrap();
    largest_m(&asked.flying, 1, USUAL_HORIZON_S, || true).unwrap().unwrap()
}

/// GIVEN gains, and sensors that are excluded WHEN the bound of one attacked sensor is read between two rows for a drawn noise THEN it is
/// never less than the bound found there, and hardly more.
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
            // The two rows that it is read from.
            let after = NOISES_MPS2.iter().position(|row| *row >= noise_mps2).unwrap();
            let rows: Vec<(f64, f64)> =
                NOISES_MPS2[after - 1..=after].iter().map(|row| (*row, bound_m(&of, *row))).collect();
            let (read_m, bound_m) = (between(&rows, noise_mps2).unwrap(), bound_m(&of, noise_mps2));
            println!(
                "{:?} without {:?}, {noise_mps2:.3} m/s²: {read_m:.4} m, the bound {bound_m:.4} m",
                of.design.controller, of.without
            );
            (least, most) = (least.min(read_m / bound_m), most.max(read_m / bound_m));
        }
    }
    println!("{least:.3} to {most:.3} of the bound");
    assert!(least >= 1.0 && most <= LARGER, "{least} to {most}");
}
