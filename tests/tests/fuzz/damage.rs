//! Bytes, damaged at random: bits, lengths, ends, repeated and moved pieces, numbers that are none.

use plumbline_tests::harness::radio::Chance;

/// Pieces that decoders stumble over.
const STUMBLING: &[&[u8]] = &[
    b"NaN",
    b"inf",
    b"-1e999",
    b"1e-400",
    b"",
    b",,,,",
    b"\"",
    b"\xff\xff\xff\xff",
    b"\0\0\0\0\0\0\0\0",
    b"null",
    b"99999999999999999999999",
    b"[[[[[[[[[[",
    b"{",
    b"\r\n",
    b"\x7f\xff\xff\xff\xff\xff\xff\xff",
    b"-0",
    b"e",
];

pub fn below(chance: &mut Chance, end: usize) -> usize {
    (chance.number() % end.max(1) as u64) as usize
}

pub fn damage(chance: &mut Chance, seeds: &[Vec<u8>]) -> Vec<u8> {
    let mut bytes = seeds[below(chance, seeds.len())].clone();
    for _ in 0..=below(chance, 6) {
        let at = below(chance, bytes.len() + 1);
        let length = below(chance, 1 + bytes.len() - at).min(1 << below(chance, 10));
        match below(chance, 9) {
            0 | 1 if at < bytes.len() => bytes[at] ^= 1 << below(chance, 8),
            2 if at < bytes.len() => bytes[at] = chance.number() as u8,
            3 => bytes.truncate(at),
            4 => drop(bytes.drain(at..at + length)),
            5 => {
                let piece = bytes[at..at + length].to_vec();
                let to = below(chance, bytes.len() + 1);
                bytes.splice(to..to, piece);
            }
            6 => {
                let piece = STUMBLING[below(chance, STUMBLING.len())];
                let end = (at + length.min(12)).min(bytes.len());
                bytes.splice(at..end, piece.iter().copied());
            }
            7 => {
                // A length or a number, somewhere in the middle.
                let wide = 1 << (1 + below(chance, 3));
                let extreme = [0, 1, u64::MAX, u64::MAX >> 1, 1 << 31, 1 << 32, chance.number()][below(chance, 7)];
                for (byte, new) in bytes.iter_mut().skip(at).take(wide).zip(extreme.to_le_bytes()) {
                    *byte = new;
                }
            }
            _ => {
                let other = &seeds[below(chance, seeds.len())];
                let from = below(chance, other.len() + 1);
                bytes.truncate(at);
                bytes.extend_from_slice(&other[from..]);
            }
        }
        bytes.truncate(1 << 16);
    }
    bytes
}
