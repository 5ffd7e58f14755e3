//! Samples of point lists: at random from a seeded stream, or evenly by index.

use rand::RngExt;
use rand_chacha::ChaCha8Rng;

/// Draws `count` different indices out of `0..len` without replacement, in ascending order; all of them when there are
/// not more than `count`.
///
/// Every subset is equally likely (Floyd's method), and the same stream gives the same subset.
pub fn random_indices(len: usize, count: usize, rng: &mut ChaCha8Rng) -> Vec<usize> {
    if count >= len {
        return (0..len).collect();
    }
    let mut chosen = std::collections::BTreeSet::new();
    for upper in len - count..len {
        let drawn = rng.random_range(0..=upper as u64) as usize;
        if !chosen.insert(drawn) {
            chosen.insert(upper);
        }
    }
    chosen.into_iter().collect()
}

/// At most `count` indices spread evenly over `0..len`, in ascending order.
pub fn even_indices(len: usize, count: usize) -> Vec<usize> {
    let count = count.min(len);
    (0..count).map(|i| i * len / count).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand_chacha::rand_core::SeedableRng;

    #[test]
    fn random_indices_are_distinct_sorted_and_repeatable() {
        let draw = || random_indices(1000, 200, &mut ChaCha8Rng::seed_from_u64(3));
        let drawn = draw();
        assert_eq!(drawn.len(), 200);
        assert!(drawn.windows(2).all(|pair| pair[0] < pair[1]));
        assert!(drawn.iter().all(|&index| index < 1000));
        assert_eq!(drawn, draw());
        assert_eq!(random_indices(5, 9, &mut ChaCha8Rng::seed_from_u64(3)), [0, 1, 2, 3, 4]);
        assert!(random_indices(0, 9, &mut ChaCha8Rng::seed_from_u64(3)).is_empty());
    }

    #[test]
    fn even_indices_span_the_range() {
        assert_eq!(even_indices(10, 5), [0, 2, 4, 6, 8]);
        assert_eq!(even_indices(3, 5), [0, 1, 2]);
        assert!(even_indices(0, 5).is_empty());
    }
}
