//! Seeded mutations of valid bytes: flips, cuts, splices, repetitions, extreme numbers, and corrected
//! checksums.

use rand::{Rng, RngExt};
use rand_chacha::ChaCha8Rng;

/// Texts that are difficult for number parsers.
const TEXTS: [&str; 14] = [
    "0",
    "-1",
    "-0",
    "1e999",
    "-1e999",
    "NaN",
    "nan",
    "inf",
    "4294967296",
    "18446744073709551616",
    "9223372036854775807",
    "1e-320",
    "0.1e",
    "\"",
];

/// One to six changes of `bytes`; parts of `others` may be inserted.
pub fn mutated(bytes: &[u8], others: &[Vec<u8>], random: &mut ChaCha8Rng) -> Vec<u8> {
    let mut bytes = bytes.to_vec();
    for _ in 0..random.random_range(1..=6) {
        change(&mut bytes, others, random);
    }
    if bytes.starts_with(b"\x89PNG") && random.random_bool(0.7) {
        mend_png(&mut bytes);
    }
    bytes
}

fn change(bytes: &mut Vec<u8>, others: &[Vec<u8>], random: &mut ChaCha8Rng) {
    // Headers have the greatest effect, so half of the changes are near the beginning.
    let length = bytes.len();
    let near = if random.random_bool(0.5) { length.min(200) } else { length };
    let at = random.random_range(0..=near);
    let some = random.random_range(0..=(length - at).min(64));
    match random.random_range(0..9) {
        0 | 1 => {
            if let Some(byte) = bytes.get_mut(at) {
                *byte ^= 1 << random.random_range(0..8);
            }
        }
        2 => {
            if let Some(byte) = bytes.get_mut(at) {
                *byte = random.random();
            }
        }
        3 => bytes.truncate(at),
        4 => drop(bytes.drain(at..at + some)),
        5 => {
            let again = bytes[at..at + some].to_vec();
            bytes.splice(at..at, again);
        }
        6 => {
            let other = &others[random.random_range(0..others.len())];
            let from = random.random_range(0..=other.len());
            let to = random.random_range(from..=other.len().min(from + 256));
            bytes.splice(at..at + some, other[from..to].iter().copied());
        }
        7 => put(bytes, at, &extreme(random)),
        _ => text(bytes, at, random),
    }
}

/// An extreme integer or float of 1 to 8 bytes, in either byte order.
fn extreme(random: &mut ChaCha8Rng) -> Vec<u8> {
    let wide = [
        0,
        1,
        u64::MAX,
        u64::MAX - 7,
        1 << 63,
        (1 << 63) - 1,
        1 << 31,
        (1 << 31) - 1,
        1 << 32,
        1 << 16,
        0x7fff,
        0xff,
    ];
    let floats = [f64::NAN, f64::INFINITY, -0.0, f64::MAX, f64::MIN_POSITIVE / 2.0, 1e38];
    let mut bytes = match random.random_range(0..4) {
        0 => floats[random.random_range(0..floats.len())].to_le_bytes().to_vec(),
        1 => (floats[random.random_range(0..floats.len())] as f32).to_le_bytes().to_vec(),
        _ => {
            let value: u64 = wide[random.random_range(0..wide.len())];
            let width = [1, 2, 4, 8][random.random_range(0..4)];
            value.to_le_bytes()[..width].to_vec()
        }
    };
    if random.random_bool(0.5) {
        bytes.reverse();
    }
    bytes
}

fn put(bytes: &mut [u8], at: usize, what: &[u8]) {
    for (to, from) in bytes[at..].iter_mut().zip(what) {
        *to = *from;
    }
}

/// Replaces the next number by a text; without a number, writes noise.
fn text(bytes: &mut Vec<u8>, at: usize, random: &mut ChaCha8Rng) {
    let is_number = |byte: &u8| byte.is_ascii_digit() || matches!(byte, b'.' | b'-');
    let Some(begin) = bytes[at..].iter().take(400).position(is_number).map(|offset| at + offset) else {
        let mut noise = [0; 8];
        random.fill_bytes(&mut noise);
        return put(bytes, at, &noise);
    };
    let length = bytes[begin..].iter().take_while(|byte| is_number(byte)).count();
    let text = TEXTS[random.random_range(0..TEXTS.len())];
    bytes.splice(begin..begin + length, text.bytes());
}

/// Corrects the checksums of a PNG's chunks, as far as the chunks can be parsed.
fn mend_png(bytes: &mut [u8]) {
    let mut at = 8;
    while let Some(head) = bytes.get(at..at + 4).and_then(|head| head.first_chunk::<4>()) {
        let Some(end) = usize::try_from(u32::from_be_bytes(*head)).ok().and_then(|n| at.checked_add(8 + n))
        else {
            return;
        };
        let Some(chunk) = bytes.get(at + 4..end) else { return };
        let mut sum = flate2::Crc::new();
        sum.update(chunk);
        let sum = sum.sum().to_be_bytes();
        let Some(place) = bytes.get_mut(end..end + 4) else { return };
        place.copy_from_slice(&sum);
        at = end + 4;
    }
}
