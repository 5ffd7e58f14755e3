//! Chance: every draw of the simulated world comes from a seed through a named stream.

use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use std::f64::consts::PI;

/// What the draws of one acquisition come from. Equal values give equal bits, whatever the number of threads.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Draws {
    /// The seed of the run.
    pub seed: u64,
    /// The acquisition: view << 16 | attempt, so that a retake draws anew.
    pub trigger_id: u64,
}

/// What a stream is for. Streams with different purposes never share draws.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Purpose {
    /// White noise under the correlated fields of normal numbers (depth noise and others), one stream a field and row.
    Depth = 1,
    /// Lateral noise and the fate of pixels seen at a grazing angle, one stream a row.
    Pixel = 2,
    /// Compact holes, one stream a cell of the image.
    Holes = 3,
    /// Where the robot really stands.
    PoseError = 4,
    /// How far the calibration is off.
    CalibrationError = 5,
    /// What the network does to what it carries, one stream a path.
    Network = 6,
    /// What silhouettes do to pixels, one stream a row.
    Silhouettes = 20,
    /// Gross mismatches, one stream a row.
    Outliers = 21,
    /// Ghosts of inter-reflections.
    Ghosts = 22,
    /// What is the same in every frame of one camera.
    Device = 23,
    /// Inputs of tests.
    #[cfg(test)]
    Test = 1000,
}

/// The generator of one stream: (seed, purpose, `which`, `part`) is the whole key of the cipher.
pub(crate) fn generator(seed: u64, purpose: Purpose, which: u64, part: u64) -> ChaCha8Rng {
    let mut key = [0; 32];
    for (bytes, word) in key.chunks_exact_mut(8).zip([seed, purpose as u64, which, part]) {
        bytes.copy_from_slice(&word.to_le_bytes());
    }
    ChaCha8Rng::from_seed(key)
}

/// Uniform in 0 (included) to 1 (excluded).
pub(crate) fn uniform(rng: &mut ChaCha8Rng) -> f64 {
    rng.random::<f64>()
}

/// Two independent standard normal numbers from two uniform ones in 0 (included) to 1 (Box and Muller, 1958).
pub(crate) fn normal_pair(u: f64, v: f64) -> [f64; 2] {
    let radius = (-2.0 * (1.0 - u).ln()).sqrt();
    let (sin, cos) = (2.0 * PI * v).sin_cos();
    [radius * cos, radius * sin]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn normal_numbers_have_the_moments_of_the_normal_distribution() {
        let mut rng = generator(1, Purpose::Depth, 2, 3);
        let drawn: Vec<f64> = (0..100_000)
            .flat_map(|_| normal_pair(uniform(&mut rng), uniform(&mut rng)))
            .collect();
        let moment = |power| drawn.iter().map(|x| x.powi(power)).sum::<f64>() / drawn.len() as f64;
        assert!(
            moment(1).abs() < 0.01 && (moment(2) - 1.0).abs() < 0.02,
            "{} {}",
            moment(1),
            moment(2)
        );
        assert!((moment(4) - 3.0).abs() < 0.1, "{}", moment(4));
    }

    #[test]
    fn every_part_of_the_key_changes_the_stream() {
        let first = |mut rng: ChaCha8Rng| rng.random::<u64>();
        let reference = first(generator(1, Purpose::Depth, 2, 3));
        assert_eq!(reference, first(generator(1, Purpose::Depth, 2, 3)));
        assert_ne!(reference, first(generator(9, Purpose::Depth, 2, 3)));
        assert_ne!(reference, first(generator(1, Purpose::Pixel, 2, 3)));
        assert_ne!(reference, first(generator(1, Purpose::Depth, 9, 3)));
        assert_ne!(reference, first(generator(1, Purpose::Depth, 2, 9)));
    }
}
