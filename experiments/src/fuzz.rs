//! Random and mutated inputs for every decoder, where no fuzzer is at hand: nothing may panic, nothing may grow.

mod camera;
mod host;
mod hses;

use std::error::Error;
use std::io::Write;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::time::Instant;

use bladescan::job::hex;
use clap::Args;
use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

#[derive(Args)]
pub(crate) struct FuzzArguments {
    /// How many inputs, over all decoders.
    #[arg(long, default_value_t = 1_000_000)]
    count: u64,
    /// Only decoders whose name begins so.
    #[arg(long, default_value = "")]
    only: String,
    /// Seed of the inputs.
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

/// Something that reads bytes from outside.
struct Decoder {
    name: &'static str,
    /// Reads the bytes, checks what must hold of the outcome, and tells whether they were taken.
    feed: fn(&[u8]) -> bool,
    /// Good inputs, to be mutated.
    seeds: fn() -> Vec<Vec<u8>>,
    /// Makes a mutated input's lengths true again, so that more than the first check is met.
    mend: fn(&mut [u8]),
}

const DECODERS: &[Decoder] = &[
    Decoder {
        name: "hses answer and replies",
        feed: hses::answer,
        seeds: hses::answer_seeds,
        mend: hses::mend_frame,
    },
    Decoder {
        name: "hses exchange",
        feed: hses::exchange,
        seeds: hses::answer_seeds,
        mend: hses::mend_frame,
    },
    Decoder {
        name: "hses file frame",
        feed: hses::file_answer,
        seeds: hses::file_seeds,
        mend: hses::mend_frame,
    },
    Decoder {
        name: "hses file transfer",
        feed: hses::file_transfer,
        seeds: hses::transfer_seeds,
        mend: |_| {},
    },
    Decoder {
        name: "host control answer and replies",
        feed: host::answer,
        seeds: host::answer_seeds,
        mend: |_| {},
    },
    Decoder {
        name: "host control over tcp",
        feed: host::tcp,
        seeds: host::tcp_seeds,
        mend: |_| {},
    },
    Decoder {
        name: "serial block",
        feed: host::block,
        seeds: host::block_seeds,
        mend: host::mend_block,
    },
    Decoder {
        name: "host control over serial",
        feed: host::serial,
        seeds: host::serial_seeds,
        mend: |_| {},
    },
    Decoder {
        name: "camera frames and messages",
        feed: camera::frames,
        seeds: camera::frame_seeds,
        mend: camera::mend_frames,
    },
    Decoder {
        name: "camera points, cleaned",
        feed: camera::points,
        seeds: camera::points_seeds,
        mend: |_| {},
    },
];

/// What came of some inputs.
#[derive(Default)]
struct Tally {
    taken: u64,
    /// Inputs that broke something; the first few.
    broken: Vec<Vec<u8>>,
}

pub(crate) fn run(arguments: &FuzzArguments) -> Result<(), Box<dyn Error>> {
    let mut out = std::io::stdout().lock();
    writeln!(out, "| decoder | inputs | taken | refused | broken | s |")?;
    writeln!(out, "|---|---|---|---|---|---|")?;
    let chosen = |decoder: &&Decoder| decoder.name.starts_with(&arguments.only);
    let each = arguments
        .count
        .div_ceil(DECODERS.iter().filter(chosen).count().max(1) as u64);
    let mut broken = 0;
    for (index, decoder) in DECODERS.iter().enumerate().filter(|(_, decoder)| chosen(decoder)) {
        let begun = Instant::now();
        let tally = try_all(decoder, each, arguments.seed, index as u64);
        writeln!(
            out,
            "| {} | {each} | {} | {} | {} | {:.1} |",
            decoder.name,
            tally.taken,
            each - tally.taken - tally.broken.len() as u64,
            tally.broken.len(),
            begun.elapsed().as_secs_f64()
        )?;
        for input in tally.broken.iter().take(SHOWN_MAX) {
            writeln!(out, "{}", hex(input))?;
        }
        broken += tally.broken.len();
    }
    if broken > 0 {
        return Err("a decoder broke".into());
    }
    Ok(())
}

/// Feeds `count` inputs, in fixed chunks with a stream each: the same inputs at any number of threads.
fn try_all(decoder: &Decoder, count: u64, seed: u64, decoder_index: u64) -> Tally {
    let seeds = (decoder.seeds)();
    let tallies: Vec<Tally> = (0..count.div_ceil(CHUNK))
        .into_par_iter()
        .map(|chunk| {
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            rng.set_stream(decoder_index << 40 | chunk);
            let mut tally = Tally::default();
            for _ in chunk * CHUNK..count.min((chunk + 1) * CHUNK) {
                let input = input(&mut rng, &seeds, decoder.mend);
                match catch_unwind(AssertUnwindSafe(|| (decoder.feed)(&input))) {
                    Ok(taken) => tally.taken += u64::from(taken),
                    Err(_) => tally.broken.push(input),
                }
            }
            tally
        })
        .collect();
    tallies.into_iter().fold(Tally::default(), |mut sum, tally| {
        sum.taken += tally.taken;
        sum.broken.extend(tally.broken);
        sum
    })
}

/// One input: pure noise now and then, else a good one with a few changes.
fn input(rng: &mut ChaCha8Rng, seeds: &[Vec<u8>], mend: fn(&mut [u8])) -> Vec<u8> {
    if rng.random_range(0..8) == 0 {
        let mut noise = vec![0; rng.random_range(0..=600)];
        rng.fill_bytes(&mut noise);
        return noise;
    }
    let mut bytes = pick(rng, seeds).clone();
    for _ in 0..rng.random_range(0..6) {
        mutate(rng, &mut bytes, seeds);
    }
    if rng.random_range(0..4) > 0 {
        mend(&mut bytes);
    }
    bytes
}

fn mutate(rng: &mut ChaCha8Rng, bytes: &mut Vec<u8>, seeds: &[Vec<u8>]) {
    if bytes.is_empty() {
        return bytes.push(rng.random());
    }
    let at = rng.random_range(0..bytes.len());
    match rng.random_range(0..7) {
        0 => bytes[at] ^= 1 << rng.random_range(0..8),
        1 => bytes[at] = rng.random(),
        2 => bytes[at] = [0, 1, 0x7F, 0x80, 0xFF][rng.random_range(0..5)],
        3 => {
            let word = [0, 1, 0x7FFF_FFFF, 0x8000_0000, u32::MAX][rng.random_range(0..5)].to_le_bytes();
            let end = bytes.len().min(at + 4);
            bytes[at..end].copy_from_slice(&word[..end - at]);
        }
        4 => bytes.truncate(at),
        5 => {
            let mut tail = vec![0; rng.random_range(0..64)];
            rng.fill_bytes(&mut tail);
            bytes.extend(tail);
        }
        _ => {
            let other = pick(rng, seeds);
            bytes.truncate(at);
            bytes.extend(&other[at.min(other.len())..]);
        }
    }
}

fn pick<'a>(rng: &mut ChaCha8Rng, seeds: &'a [Vec<u8>]) -> &'a Vec<u8> {
    &seeds[rng.random_range(0..seeds.len())]
}

const CHUNK: u64 = 10_000;
const SHOWN_MAX: usize = 5;
