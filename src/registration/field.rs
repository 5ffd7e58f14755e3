//! The potential field of a fixed cloud: energy and attraction at a point.
//!
//! | paper | here | unit |
//! |---|---|---|
//! | `r = ‖y_j − (R x_i + t)‖ + ε²` (eq. 5) | `d + softening` | the clouds' unit |
//! | `−1/r`, summed: `E_I` (NFI criterion), `φ` | [`Pull::energy`] | 1/unit |
//! | `F_xi`, attraction | [`Pull::force`]: `Σ n_ij / r²`, the exact negative gradient of the energy | 1/unit² |
//!
//! Sums run over a fixed number of lanes in a fixed order and nothing is fused, so the bits do not depend on which
//! vector unit the processor has.

use nalgebra::{Point3, Vector3};
use rayon::prelude::*;

/// A fixed set of unit masses.
pub struct Field {
    blocks: Vec<Block>,
}

/// What a field does to a point of unit mass.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pull {
    /// The attraction.
    pub force: Vector3<f64>,
    /// The potential energy, never positive.
    pub energy: f64,
}

const LANE_COUNT: usize = 16;

struct Block {
    x: [f32; LANE_COUNT],
    y: [f32; LANE_COUNT],
    z: [f32; LANE_COUNT],
    mass: [f32; LANE_COUNT],
}

impl Field {
    /// The field of one unit mass at each of `points`. Coordinates are rounded to single precision: give them centred
    /// and of the order of one.
    pub fn new(points: &[Point3<f64>]) -> Self {
        let blocks = points
            .chunks(LANE_COUNT)
            .map(|chunk| {
                let mut block = Block {
                    x: [0.0; LANE_COUNT],
                    y: [0.0; LANE_COUNT],
                    z: [0.0; LANE_COUNT],
                    mass: [0.0; LANE_COUNT],
                };
                for (lane, point) in chunk.iter().enumerate() {
                    block.x[lane] = point.x as f32;
                    block.y[lane] = point.y as f32;
                    block.z[lane] = point.z as f32;
                    block.mass[lane] = 1.0;
                }
                block
            })
            .collect();
        Self { blocks }
    }

    /// The pull on each of `points`, in order. `softening` is the paper's `ε²`, a length, positive.
    pub fn pulls(&self, points: &[Point3<f64>], softening: f64) -> Vec<Pull> {
        points
            .par_chunks(CHUNK_COUNT)
            .map(|chunk| pulls_of_chunk(&self.blocks, chunk, softening as f32))
            .collect::<Vec<_>>()
            .concat()
    }
}

/// Points per task: enough work to be worth a task.
const CHUNK_COUNT: usize = 64;

fn pulls_of_chunk(blocks: &[Block], points: &[Point3<f64>], softening: f32) -> Vec<Pull> {
    #[cfg(target_arch = "x86_64")]
    {
        if std::arch::is_x86_feature_detected!("avx512f") {
            #[expect(
                unsafe_code,
                reason = "the processor has just been asked whether it has the instructions"
            )]
            return unsafe { pulls_avx512(blocks, points, softening) };
        }
        if std::arch::is_x86_feature_detected!("avx2") {
            #[expect(
                unsafe_code,
                reason = "the processor has just been asked whether it has the instructions"
            )]
            return unsafe { pulls_avx2(blocks, points, softening) };
        }
    }
    pulls_portable(blocks, points, softening)
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx512f")]
fn pulls_avx512(blocks: &[Block], points: &[Point3<f64>], softening: f32) -> Vec<Pull> {
    pulls_portable(blocks, points, softening)
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn pulls_avx2(blocks: &[Block], points: &[Point3<f64>], softening: f32) -> Vec<Pull> {
    pulls_portable(blocks, points, softening)
}

#[inline(always)]
fn pulls_portable(blocks: &[Block], points: &[Point3<f64>], softening: f32) -> Vec<Pull> {
    points.iter().map(|point| pull(blocks, point, softening)).collect()
}

#[inline(always)]
fn pull(blocks: &[Block], point: &Point3<f64>, softening: f32) -> Pull {
    let (px, py, pz) = (point.x as f32, point.y as f32, point.z as f32);
    let mut fx = [0.0f32; LANE_COUNT];
    let mut fy = [0.0f32; LANE_COUNT];
    let mut fz = [0.0f32; LANE_COUNT];
    let mut potential = [0.0f32; LANE_COUNT];
    for block in blocks {
        for lane in 0..LANE_COUNT {
            let dx = block.x[lane] - px;
            let dy = block.y[lane] - py;
            let dz = block.z[lane] - pz;
            let d = (dx * dx + dy * dy + dz * dz + COINCIDENT).sqrt();
            let r = d + softening;
            let g = block.mass[lane] / (d * r * r);
            fx[lane] += g * dx;
            fy[lane] += g * dy;
            fz[lane] += g * dz;
            potential[lane] += g * d * r;
        }
    }
    let total = |lanes: &[f32; LANE_COUNT]| lanes.iter().map(|&value| f64::from(value)).sum::<f64>();
    Pull {
        force: Vector3::new(total(&fx), total(&fy), total(&fz)),
        energy: -total(&potential),
    }
}

/// Keeps the direction to a coinciding mass finite (it pulls nowhere).
const COINCIDENT: f32 = 1e-20;

#[cfg(test)]
mod tests {
    use super::*;

    fn points(count: u32, phase: f64) -> Vec<Point3<f64>> {
        (0..count)
            .map(|i| {
                let t = f64::from(i) * 0.7 + phase;
                Point3::new(t.sin(), (1.3 * t).cos() * 0.7, (0.37 * t).sin() * 0.4)
            })
            .collect()
    }

    #[test]
    fn the_force_is_the_negative_gradient_of_the_energy() {
        let field = Field::new(&points(100, 0.0));
        for softening in [0.02, 0.2, 1.0] {
            for at in points(20, 0.31) {
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
    fn every_vector_width_gives_the_same_bits() {
        let field = Field::new(&points(333, 0.0));
        let at = points(70, 0.2);
        let dispatched = field.pulls(&at, 0.1);
        assert_eq!(dispatched, pulls_portable(&field.blocks, &at, 0.1));
    }

    #[test]
    fn no_masses_pull_nowhere() {
        let pull = Field::new(&[]).pulls(&[Point3::origin()], 0.1)[0];
        assert_eq!((pull.force, pull.energy), (Vector3::zeros(), 0.0));
    }
}
