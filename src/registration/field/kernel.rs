//! The pull of a list of masses on points, in the widest vector unit there is.
//!
//! Sums run over a fixed number of lanes in a fixed order and nothing is fused, so every kernel gives the same bits.

use nalgebra::{Point3, Vector3};

use super::Pull;
pub use crate::geometry::simd::Kernel;
pub(super) use crate::geometry::simd::{LANE_COUNT, Work};

impl Kernel {
    /// The pull of all `blocks` on each of `points`, in order.
    pub(super) fn pulls(self, blocks: &[Block], points: &[Point3<f64>], softening: f32) -> Vec<Pull> {
        self.run(Pulls {
            blocks,
            points,
            softening,
        })
    }
}

/// As many masses as there are lanes; a lane without one has mass 0.
#[derive(Debug, Clone, Copy)]
#[repr(align(64))]
pub(super) struct Block {
    pub(super) x: [f32; LANE_COUNT],
    pub(super) y: [f32; LANE_COUNT],
    pub(super) z: [f32; LANE_COUNT],
    pub(super) mass: [f32; LANE_COUNT],
}

impl Block {
    /// No masses.
    pub(super) const EMPTY: Self = Self {
        x: [0.0; LANE_COUNT],
        y: [0.0; LANE_COUNT],
        z: [0.0; LANE_COUNT],
        mass: [0.0; LANE_COUNT],
    };

    /// Puts a mass into a lane.
    pub(super) fn put(&mut self, lane: usize, at: &Point3<f32>, mass: f32) {
        self.x[lane] = at.x;
        self.y[lane] = at.y;
        self.z[lane] = at.z;
        self.mass[lane] = mass;
    }

    /// One unit mass at each of `points`, in order.
    pub(super) fn of_units<'a>(points: impl IntoIterator<Item = &'a Point3<f64>>) -> Vec<Self> {
        let mut blocks: Vec<Self> = Vec::new();
        for (index, point) in points.into_iter().enumerate() {
            let lane = index % LANE_COUNT;
            if lane == 0 {
                blocks.push(Self::EMPTY);
            }
            if let Some(block) = blocks.last_mut() {
                block.put(lane, &point.cast::<f32>(), 1.0);
            }
        }
        blocks
    }
}

struct Pulls<'a> {
    blocks: &'a [Block],
    points: &'a [Point3<f64>],
    softening: f32,
}

impl Work for Pulls<'_> {
    type Output = Vec<Pull>;

    #[inline(always)]
    fn run(self) -> Vec<Pull> {
        let Self {
            blocks,
            points,
            softening,
        } = self;
        let mut pulls = Vec::with_capacity(points.len());
        let pairs = points.chunks_exact(2);
        let rest = pairs.remainder();
        for pair in pairs {
            pulls.extend(pull(blocks, [&pair[0], &pair[1]], softening));
        }
        for point in rest {
            pulls.extend(pull(blocks, [point], softening));
        }
        pulls
    }
}

/// The pull on a few points at once, each summed by itself: the divider then never waits for a sum.
#[inline(always)]
fn pull<const COUNT: usize>(blocks: &[Block], points: [&Point3<f64>; COUNT], softening: f32) -> [Pull; COUNT] {
    let at = points.map(|point| point.cast::<f32>());
    let mut fx = [[0.0f32; LANE_COUNT]; COUNT];
    let mut fy = [[0.0f32; LANE_COUNT]; COUNT];
    let mut fz = [[0.0f32; LANE_COUNT]; COUNT];
    let mut potential = [[0.0f32; LANE_COUNT]; COUNT];
    for block in blocks {
        for i in 0..COUNT {
            for lane in 0..LANE_COUNT {
                let dx = block.x[lane] - at[i].x;
                let dy = block.y[lane] - at[i].y;
                let dz = block.z[lane] - at[i].z;
                let d = (dx * dx + dy * dy + dz * dz + COINCIDENT).sqrt();
                let r = d + softening;
                let g = block.mass[lane] / (d * r * r);
                fx[i][lane] += g * dx;
                fy[i][lane] += g * dy;
                fz[i][lane] += g * dz;
                potential[i][lane] += g * d * r;
            }
        }
    }
    std::array::from_fn(|i| Pull {
        force: Vector3::new(total(&fx[i]), total(&fy[i]), total(&fz[i])),
        energy: -total(&potential[i]),
    })
}

/// The sum of all lanes, in their order.
#[inline(always)]
pub(super) fn total(lanes: &[f32; LANE_COUNT]) -> f64 {
    lanes.iter().map(|&value| f64::from(value)).sum()
}

/// Keeps the direction to a coinciding mass finite (it pulls nowhere).
const COINCIDENT: f32 = 1e-20;
