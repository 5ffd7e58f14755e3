//! The potential field of a fixed cloud: energy and attraction at a point.
//!
//! | paper | here | unit |
//! |---|---|---|
//! | `r = ‖y_j − (R x_i + t)‖ + ε²` (eq. 5) | `d + softening` | the clouds' unit |
//! | `−1/r`, summed: `E_I` (NFI criterion), `φ` | [`Pull::energy`] | 1/unit |
//! | `F_xi`, attraction | [`Pull::force`]: `Σ n_ij / r²`, the exact negative gradient of the energy | 1/unit² |
//!
//! Sums run over a fixed number of lanes in a fixed order and nothing is fused, so the bits depend neither on the
//! vector unit of the processor nor on the number of threads. Large fields are summed by a tree with a bounded error
//! ([`Summation`]).

mod gaussian;
mod kernel;
mod tree;

use nalgebra::{Point3, Vector3};
use rayon::prelude::*;

pub(crate) use self::gaussian::{Affinity, Gaussians, Lookers};
use self::kernel::Block;
pub use self::kernel::Kernel;
use self::tree::{Ball, Tree};

/// A fixed set of unit masses.
pub struct Field {
    masses: Masses,
    kernel: Kernel,
}

/// What a field does to a point of unit mass.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pull {
    /// The attraction.
    pub force: Vector3<f64>,
    /// The potential energy, never positive.
    pub energy: f64,
}

/// How the masses of a field are summed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Summation {
    /// Pair by pair below [`TREE_MIN_COUNT`] masses, by a tree from there on.
    Automatic,
    /// Every pair, in single precision: the work is the product of the counts.
    Pairs,
    /// Near masses one by one, far ones in cells: nearly linear work, force errors of at most [`FORCE_ERROR_MAX`].
    Tree,
}

/// From this many masses on a tree is faster.
pub const TREE_MIN_COUNT: usize = 2000;

/// What a tree may be wrong by: the error of a force over the sum of the magnitudes of the single pulls. The relative
/// error of an energy stays below it too.
pub const FORCE_ERROR_MAX: f64 = 1e-3;

enum Masses {
    Listed(Vec<Block>),
    InTree(Tree),
}

impl Field {
    /// The field of one unit mass at each of `points`, summed pair by pair. Coordinates are rounded to single precision:
    /// give them centred and of the order of one.
    pub fn new(points: &[Point3<f64>]) -> Self {
        Self::summed(points, Summation::Pairs)
    }

    /// The same, summed as asked.
    pub fn summed(points: &[Point3<f64>], summation: Summation) -> Self {
        let in_tree = match summation {
            Summation::Automatic => points.len() >= TREE_MIN_COUNT,
            Summation::Pairs => false,
            Summation::Tree => true,
        };
        let masses = if in_tree {
            Masses::InTree(Tree::new(points))
        } else {
            Masses::Listed(Block::of_units(points))
        };
        Self {
            masses,
            kernel: Kernel::fastest(),
        }
    }

    /// The same field, summed with another kernel: to compare them. The results do not change.
    pub fn with_kernel(self, kernel: Kernel) -> Self {
        Self { kernel, ..self }
    }

    /// The order in which points are best given to [`Field::pulls`], as indices. `None`: any order will do.
    ///
    /// A tree is fast for points whose neighbours in the slice are neighbours in space.
    pub fn best_order(&self, points: &[Point3<f64>]) -> Option<Vec<usize>> {
        match self.masses {
            Masses::Listed(_) => None,
            Masses::InTree(_) => Some(tree::coherent_order(points)),
        }
    }

    /// The pull on each of `points`, in order. `softening` is the paper's `ε²`, a length, positive.
    pub fn pulls(&self, points: &[Point3<f64>], softening: f64) -> Vec<Pull> {
        let softening = softening as f32;
        match &self.masses {
            Masses::Listed(blocks) => points
                .par_chunks(CHUNK_COUNT)
                .map(|chunk| self.kernel.pulls(blocks, chunk, softening))
                .collect::<Vec<_>>()
                .concat(),
            Masses::InTree(tree) => points
                .par_chunks(GROUP_COUNT)
                .map_init(Vec::new, |list, group| {
                    tree.gather(&Ball::about(group), list);
                    self.kernel.pulls(list, group, softening)
                })
                .collect::<Vec<_>>()
                .concat(),
        }
    }
}

/// Points per task: enough work to be worth a task.
const CHUNK_COUNT: usize = 64;

/// Points that look at a tree together.
const GROUP_COUNT: usize = 32;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::registration::testing::looped;
    use nalgebra::Isometry3;
    use rand::RngExt;
    use rand_chacha::ChaCha8Rng;
    use rand_chacha::rand_core::SeedableRng;

    #[test]
    fn the_force_is_the_negative_gradient_of_the_energy() {
        let field = Field::new(&looped(100, 0.0));
        for softening in [0.02, 0.2, 1.0] {
            for at in looped(20, 0.31) {
                let h = 4e-3;
                let at = at * 1.5;
                let pull = field.pulls(&[at], softening)[0];
                let slope = |axis: Vector3<f64>| {
                    let energies = field.pulls(&[at + axis * h, at - axis * h], softening);
                    (energies[1].energy - energies[0].energy) / (2.0 * h)
                };
                let gradient = Vector3::new(slope(Vector3::x()), slope(Vector3::y()), slope(Vector3::z()));
                let error = (gradient - pull.force).norm();
                assert!(
                    error < 0.03 * pull.force.norm() + 0.3,
                    "{softening} {gradient:?} {:?}",
                    pull.force
                );
            }
        }
    }

    #[test]
    fn a_single_mass_attracts_with_the_inverse_square_of_the_softened_distance() {
        let field = Field::new(&[Point3::new(3.0, 0.0, 0.0)]);
        let pull = field.pulls(&[Point3::origin()], 0.5)[0];
        assert!((pull.force - Vector3::new(1.0 / 12.25, 0.0, 0.0)).norm() < 1e-7);
        assert!((pull.energy + 1.0 / 3.5).abs() < 1e-7);
        let inside = field.pulls(&[Point3::new(3.0, 0.0, 0.0)], 0.5)[0];
        assert_eq!(inside.force, Vector3::zeros());
        assert!((inside.energy + 2.0).abs() < 1e-6);
    }

    #[test]
    fn every_kernel_gives_the_same_bits() {
        let at = looped(71, 0.2);
        for summation in [Summation::Pairs, Summation::Tree] {
            let with = |kernel| {
                Field::summed(&looped(333, 0.0), summation)
                    .with_kernel(kernel)
                    .pulls(&at, 0.1)
            };
            for kernel in Kernel::available() {
                assert_eq!(with(kernel), with(Kernel::fastest()), "{}", kernel.name());
            }
        }
    }

    #[test]
    fn any_number_of_threads_gives_the_same_bits() {
        let at = looped(3000, 0.2);
        for summation in [Summation::Pairs, Summation::Tree] {
            let field = Field::summed(&looped(3000, 0.0), summation);
            let with = |count| {
                let pool = rayon::ThreadPoolBuilder::new().num_threads(count).build().unwrap();
                pool.install(|| field.pulls(&at, 0.1))
            };
            let alone = with(1);
            assert_eq!(alone, with(2));
            assert_eq!(alone, with(8));
        }
    }

    /// Clouds of four kinds: a closed airfoil, a ball of points crowding at one corner, a cube, a line.
    fn clouds(count: usize, seed: u64) -> [Vec<Point3<f64>>; 4] {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut of = |shape: fn(f64, f64, f64) -> Point3<f64>| -> Vec<Point3<f64>> {
            (0..count)
                .map(|_| shape(rng.random(), rng.random(), rng.random()))
                .collect()
        };
        [
            of(|u, v, _| {
                let (sin, cos) = (std::f64::consts::TAU * u).sin_cos();
                Point3::new(0.6 * cos, 0.1 * sin + 0.2 * cos * cos, 3.4 * v - 1.7)
            }),
            of(|u, v, w| Point3::new(3.0 * u.powi(4), 3.0 * v.powi(4), 3.0 * w.powi(4))),
            of(|u, v, w| Point3::new(2.0 * u - 1.0, 2.0 * v - 1.0, 2.0 * w - 1.0)),
            of(|u, v, _| Point3::new(4.0 * u - 2.0, 0.0, 1e-3 * v)),
        ]
    }

    /// The sum of the magnitudes of the single pulls.
    fn magnitude(masses: &[Point3<f64>], at: &Point3<f64>, softening: f64) -> f64 {
        masses
            .iter()
            .map(|mass| ((mass - at).norm() + softening).powi(-2))
            .sum()
    }

    #[test]
    fn a_tree_is_as_exact_as_it_says() {
        for (kind, (masses, others)) in clouds(3000, 1).iter().zip(&clouds(500, 2)).enumerate() {
            let (exact, tree) = (Field::new(masses), Field::summed(masses, Summation::Tree));
            for shift in [0.0, 0.3, 1.0, 4.0] {
                let motion = Isometry3::new(
                    Vector3::new(shift, -0.4 * shift, 0.2 * shift),
                    Vector3::new(0.1, 0.3, 0.2),
                );
                let at: Vec<_> = others.iter().map(|point| motion * point).collect();
                let at: Vec<_> = tree.best_order(&at).unwrap().into_iter().map(|i| at[i]).collect();
                for softening in [1e-3, 0.03, 0.15, 1.0] {
                    let pairs = exact.pulls(&at, softening).into_iter().zip(tree.pulls(&at, softening));
                    for (at, (exact, tree)) in at.iter().zip(pairs) {
                        let error = (exact.force - tree.force).norm() / magnitude(masses, at, softening);
                        let energy = (tree.energy / exact.energy - 1.0).abs();
                        assert!(
                            error < FORCE_ERROR_MAX && energy < FORCE_ERROR_MAX,
                            "cloud {kind} moved by {shift}, softening {softening}: {error:.1e} {energy:.1e}"
                        );
                    }
                }
            }
        }
    }

    #[test]
    fn the_force_of_a_tree_is_the_negative_gradient_of_its_energy_within_its_bound() {
        let masses = &clouds(3000, 1)[0];
        let field = Field::summed(masses, Summation::Tree);
        for softening in [0.05, 0.2, 1.0] {
            for at in looped(20, 0.31) {
                let pull = field.pulls(&[at], softening)[0];
                let h = 0.01;
                let slope = |axis: Vector3<f64>| {
                    let energy = |at| field.pulls(&[at], softening)[0].energy;
                    (energy(at - axis * h) - energy(at + axis * h)) / (2.0 * h)
                };
                let gradient = Vector3::new(slope(Vector3::x()), slope(Vector3::y()), slope(Vector3::z()));
                let error = (gradient - pull.force).norm() / magnitude(masses, &at, softening);
                assert!(error < 10.0 * FORCE_ERROR_MAX, "{softening} {error:.1e}");
            }
        }
    }

    #[test]
    fn masses_in_one_place_and_points_that_are_no_numbers_do_not_upset_a_tree() {
        let field = Field::summed(&[Point3::new(1.0, 0.0, 0.0); 100], Summation::Tree);
        let pull = field.pulls(&[Point3::origin()], 0.5)[0];
        assert!((pull.force - Vector3::new(100.0 / 2.25, 0.0, 0.0)).norm() < 1e-4);
        assert!(field.pulls(&[Point3::from([f64::NAN; 3])], 0.5)[0].energy.is_nan());
        for wrong in [f64::NAN, f64::INFINITY, 1e200] {
            let mut masses = looped(100, 0.0);
            masses[50].y = wrong;
            let field = Field::summed(&masses, Summation::Tree);
            assert_eq!(field.pulls(&masses, 0.5).len(), 100);
        }
    }

    #[test]
    fn no_masses_pull_nowhere() {
        for summation in [Summation::Pairs, Summation::Tree] {
            let pull = Field::summed(&[], summation).pulls(&[Point3::origin()], 0.1)[0];
            assert_eq!((pull.force, pull.energy), (Vector3::zeros(), 0.0));
        }
    }
}
