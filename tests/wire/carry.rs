//! What a bad wire does to datagrams, and to the characters of a serial line.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// How bad a wire is. Shares count datagrams, or bursts of the serial line.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Weather {
    /// Share that gets lost.
    pub loss_fraction: f64,
    /// Share that comes twice; on the serial line one byte of it.
    pub double_fraction: f64,
    /// Share that is overtaken.
    pub late_fraction: f64,
    /// The most that one is late, ns.
    pub late_ns_max: u64,
    /// Share that is late by seconds.
    pub very_late_fraction: f64,
    /// The most that one of those is late, ns.
    pub very_late_ns_max: u64,
}

/// Both ways of one wire.
#[derive(Debug)]
pub struct Carrier {
    weather: Weather,
    to_robot: ChaCha8Rng,
    to_client: ChaCha8Rng,
}

impl Carrier {
    /// A wire on which nothing has passed.
    pub fn new(weather: Weather, seed: u64) -> Self {
        let way = |stream| {
            let mut chance = ChaCha8Rng::seed_from_u64(seed);
            chance.set_stream(stream);
            chance
        };
        Self {
            weather,
            to_robot: way(1),
            to_client: way(2),
        }
    }

    /// What comes of a datagram to the robot: how late, and what.
    pub fn carried_to_robot(&mut self, bytes: Vec<u8>) -> Vec<(u64, Vec<u8>)> {
        carry(&self.weather, &mut self.to_robot, bytes)
    }

    /// What comes of an answer.
    pub fn carried_to_client(&mut self, bytes: Vec<u8>) -> Vec<(u64, Vec<u8>)> {
        carry(&self.weather, &mut self.to_client, bytes)
    }

    /// What comes of a burst of characters to the robot, besides what the simulator's own line does to it.
    pub fn line_to_robot(&mut self, bytes: Vec<u8>) -> Vec<u8> {
        double_byte(&self.weather, &mut self.to_robot, bytes)
    }

    /// What comes of a burst of characters from the robot.
    pub fn line_to_client(&mut self, bytes: Vec<u8>) -> Vec<u8> {
        double_byte(&self.weather, &mut self.to_client, bytes)
    }
}

fn carry(weather: &Weather, chance: &mut ChaCha8Rng, bytes: Vec<u8>) -> Vec<(u64, Vec<u8>)> {
    let one = |chance: &mut ChaCha8Rng| {
        let is_lost = chance.random::<f64>() < weather.loss_fraction;
        let is_late = chance.random::<f64>() < weather.late_fraction;
        let is_very_late = chance.random::<f64>() < weather.very_late_fraction;
        let share: f64 = chance.random();
        let most_ns = match (is_very_late, is_late) {
            (true, _) => weather.very_late_ns_max,
            (false, true) => weather.late_ns_max,
            (false, false) => 0,
        };
        let late_ns = SOON_NS + (share * (SOON_NS + most_ns) as f64) as u64;
        (!is_lost).then_some(late_ns)
    };
    let is_doubled = chance.random::<f64>() < weather.double_fraction;
    let first = one(chance);
    let second = one(chance).filter(|_| is_doubled);
    first
        .into_iter()
        .chain(second)
        .map(|late_ns| (late_ns, bytes.clone()))
        .collect()
}

fn double_byte(weather: &Weather, chance: &mut ChaCha8Rng, mut bytes: Vec<u8>) -> Vec<u8> {
    let is_doubled = chance.random::<f64>() < weather.double_fraction;
    let at = chance.random::<u32>() as usize;
    if is_doubled && !bytes.is_empty() {
        let at = at % bytes.len();
        bytes.insert(at, bytes[at]);
    }
    bytes
}

/// What every datagram takes, and as much again by chance.
const SOON_NS: u64 = 200_000;
