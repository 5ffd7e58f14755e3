//! The far field in few masses: a tree of cells, each with four masses that stand for all of its points.
//!
//! Points near one another that are looked at together see near cells point by point and far cells through their
//! four stand-ins, which have the cell's mass, centroid and second moments (so monopole, dipole and quadrupole, and the
//! trace, which counts because the softened potential is not harmonic). Stand-ins are masses like all others: near and
//! far go through one kernel, and the force is the exact gradient of the energy as long as no cell changes sides.
//!
//! A cell of radius `a` about its centroid is far if `a <= opening · D`, with `D` the least distance from the centroid
//! to the sphere about the points that look. The first moments that the stand-ins lack are the third ones: the error of a
//! cell's pull is of the order of `opening³` times that pull whatever the softening, so the sum's error is bounded by
//! a share of the *sum of the magnitudes*: [`FORCE_ERROR_MAX`](super::FORCE_ERROR_MAX). A cell of half the mass has half
//! the share, so the opening grows from a cell to its halves: the same error with less than half the masses.

use nalgebra::{Matrix3, Point3, SymmetricEigen, Vector3};

use super::kernel::{Block, LANE_COUNT};

/// The static tree over a fixed set of unit masses.
pub(super) struct Tree {
    /// The points, each leaf one block.
    blocks: Vec<Block>,
    /// In preorder.
    cells: Vec<Cell>,
    stand_ins: Vec<StandIns>,
}

struct Cell {
    centre: Point3<f32>,
    /// Points at least this far from the centre may look at the stand-ins.
    reach: f32,
    /// The cell after this one and all within it.
    next: u32,
    /// The block of a leaf.
    leaf_block: Option<u32>,
}

struct StandIns {
    at: [Point3<f32>; STAND_IN_COUNT],
    mass: f32,
}

impl Tree {
    pub(super) fn new(points: &[Point3<f64>]) -> Self {
        let mut tree = Self {
            blocks: Vec::new(),
            cells: Vec::new(),
            stand_ins: Vec::new(),
        };
        let mut indices: Vec<usize> = (0..points.len()).collect();
        if !points.is_empty() {
            tree.grow(points, &mut indices, ROOT_OPENING);
        }
        tree
    }

    /// Adds the cell of these points and all within it.
    fn grow(&mut self, points: &[Point3<f64>], indices: &mut [usize], opening: f64) {
        let index = self.cells.len();
        let (cell, stand_ins) = summary(points, indices, opening);
        self.cells.push(cell);
        self.stand_ins.push(stand_ins);
        if indices.len() <= LANE_COUNT {
            self.cells[index].leaf_block = Some(self.blocks.len() as u32);
            indices.sort_unstable();
            self.blocks
                .extend(Block::of_units(indices.iter().map(|&index| &points[index])));
        } else {
            let (low, high) = halves(points, indices);
            let opening = (opening * OPENING_GROWTH).min(OPENING_MAX);
            self.grow(points, low, opening);
            self.grow(points, high, opening);
        }
        self.cells[index].next = self.cells.len() as u32;
    }

    /// Fills `list` with the masses that points in `ball` look at.
    pub(super) fn gather(&self, ball: &Ball, list: &mut Vec<Block>) {
        let centre = ball.centre.cast::<f32>();
        let radius = ball.radius as f32;
        let mut far = Block::EMPTY;
        let mut lane = 0;
        let mut index = 0;
        list.clear();
        while let Some(cell) = self.cells.get(index) {
            let reach = cell.reach + radius;
            if (cell.centre - centre).norm_squared() > reach * reach {
                let stand_ins = &self.stand_ins[index];
                for at in &stand_ins.at {
                    far.put(lane, at, stand_ins.mass);
                    lane += 1;
                }
                if lane == LANE_COUNT {
                    list.push(far);
                    (far, lane) = (Block::EMPTY, 0);
                }
                index = cell.next as usize;
            } else {
                if let Some(block) = cell.leaf_block {
                    list.push(self.blocks[block as usize]);
                }
                index += 1;
            }
        }
        if lane > 0 {
            list.push(far);
        }
    }
}

/// A ball about some points.
#[derive(Debug, Clone, Copy)]
pub(super) struct Ball {
    pub(super) centre: Point3<f64>,
    pub(super) radius: f64,
}

impl Ball {
    /// The one about the middle of the points' box.
    pub(super) fn about<'a>(points: impl IntoIterator<Item = &'a Point3<f64>> + Clone) -> Self {
        let (low, high) = bounds(points.clone());
        let centre = nalgebra::center(&low, &high);
        let squared = points.into_iter().map(|point| (point - centre).norm_squared());
        Self {
            centre,
            radius: squared.fold(0.0, f64::max).sqrt(),
        }
    }
}

/// An order of `points` in which neighbours in the order are neighbours in space.
pub(super) fn coherent_order(points: &[Point3<f64>]) -> Vec<usize> {
    let mut indices: Vec<usize> = (0..points.len()).collect();
    sort_coherently(points, &mut indices);
    indices
}

fn sort_coherently(points: &[Point3<f64>], indices: &mut [usize]) {
    if indices.len() <= LANE_COUNT {
        indices.sort_unstable();
        return;
    }
    let (low, high) = halves(points, indices);
    sort_coherently(points, low);
    sort_coherently(points, high);
}

/// Parts the points across their longest side, the lower half rounded up to whole blocks. Ties by the lower index.
fn halves<'a>(points: &[Point3<f64>], indices: &'a mut [usize]) -> (&'a mut [usize], &'a mut [usize]) {
    let (low, high) = bounds(indices.iter().map(|&index| &points[index]));
    let axis = (high - low).imax();
    let middle = (indices.len() / 2).next_multiple_of(LANE_COUNT).min(indices.len() - 1);
    indices.select_nth_unstable_by(middle, |&a, &b| {
        points[a][axis].total_cmp(&points[b][axis]).then(a.cmp(&b))
    });
    indices.split_at_mut(middle)
}

/// The corners of the box about some points.
fn bounds<'a>(points: impl IntoIterator<Item = &'a Point3<f64>>) -> (Point3<f64>, Point3<f64>) {
    let mut low = Point3::from([f64::INFINITY; 3]);
    let mut high = Point3::from([f64::NEG_INFINITY; 3]);
    for point in points {
        low = low.inf(point);
        high = high.sup(point);
    }
    (low, high)
}

fn summary(points: &[Point3<f64>], indices: &[usize], opening: f64) -> (Cell, StandIns) {
    let count = indices.len() as f64;
    let sum: Vector3<f64> = indices.iter().map(|&index| points[index].coords).sum();
    let centre = Point3::from(sum / count);
    let mut covariance = Matrix3::zeros();
    let mut squared_radius = 0.0f64;
    for &index in indices {
        let from_centre = points[index] - centre;
        covariance += from_centre * from_centre.transpose();
        squared_radius = squared_radius.max(from_centre.norm_squared());
    }
    // Without finite axes (points that are no numbers) all stand at the centroid.
    let axes = SymmetricEigen::try_new(covariance / count, f64::EPSILON, EIGEN_ITERATION_MAX_COUNT);
    let half_axes = axes.map_or_else(Matrix3::zeros, |axes| {
        let lengths = axes.eigenvalues.map(|value| value.max(0.0).sqrt());
        axes.eigenvectors * Matrix3::from_diagonal(&lengths)
    });
    let at = TETRAHEDRON.map(|corner| (centre + half_axes * Vector3::from(corner)).cast::<f32>());
    let cell = Cell {
        centre: centre.cast::<f32>(),
        reach: (squared_radius.sqrt() / opening) as f32,
        next: 0,
        leaf_block: None,
    };
    let mass = (count / STAND_IN_COUNT as f64) as f32;
    (cell, StandIns { at, mass })
}

const STAND_IN_COUNT: usize = 4;

/// Corners with centroid 0 and covariance 1.
const TETRAHEDRON: [[f64; 3]; STAND_IN_COUNT] =
    [[1.0, 1.0, 1.0], [1.0, -1.0, -1.0], [-1.0, 1.0, -1.0], [-1.0, -1.0, 1.0]];

/// More than enough for a matrix of three rows.
const EIGEN_ITERATION_MAX_COUNT: usize = 100;
/// The radius of the whole over the distance from which its stand-ins may be looked at.
const ROOT_OPENING: f64 = 0.12;
/// The same ratio of a cell's halves over that of the cell: 2^(1/6).
const OPENING_GROWTH: f64 = 1.122_462_048_309_373;
/// The ratio does not grow beyond this.
const OPENING_MAX: f64 = 0.35;
