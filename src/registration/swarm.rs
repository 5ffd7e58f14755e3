//! Where the solution may lie when nothing is known: many cheap falls at once.
//!
//! Trimmed ICP of a few hundred template points, from starts with rotations all over SO(3) and the centroids laid on each
//! other. A fall needs nearest points by the thousand, but none exactly: a grid over the reference, each cell holding the
//! anchor (a point of a thinned reference) nearest to its middle, answers in a few nanoseconds, so that hundreds of falls
//! cost about as much as one registration with exact pairs. What covers most of the template is most plausible.

use std::f64::consts::{SQRT_2, TAU};

use nalgebra::{Isometry3, Matrix3, Matrix6, Point3, Quaternion, Translation3, UnitQuaternion, Vector3, Vector6};
use rayon::prelude::*;

use super::coarse::distinct;
use super::distinct::add_distinct;
use super::icp::Sample;
use super::reference::Reference;
use super::twist::{moved, unscaled};
use crate::geometry::nearest::NearestPoints;
use crate::geometry::normals::agreement;
use crate::geometry::sampling::even_indices;

/// The thinned reference and its grid.
pub(super) struct Swarm {
    anchors: Vec<(Point3<f64>, Vector3<f64>)>,
    low: Point3<f64>,
    cell: f64,
    size: [usize; 3],
    nearest: Vec<u32>,
    oriented: bool,
}

/// The part of a template that falls.
pub(super) struct Faller {
    pub(super) sample: Sample,
    /// The template's centroid and radius of gyration.
    pub(super) centroid: Point3<f64>,
    pub(super) radius: f64,
}

impl Swarm {
    pub(super) fn new(reference: &Reference, oriented: bool) -> Self {
        let indices = even_indices(reference.points().len(), ANCHOR_COUNT);
        let anchors: Vec<_> = indices
            .iter()
            .map(|&index| (reference.points()[index], reference.normals()[index]))
            .collect();
        let points: Vec<Point3<f64>> = anchors.iter().map(|anchor| anchor.0).collect();
        let (mut low, mut high) = (points[0], points[0]);
        for point in &points {
            low = low.inf(point);
            high = high.sup(point);
        }
        let margin = MARGIN_FACTOR * reference.radius();
        low -= Vector3::repeat(margin);
        high += Vector3::repeat(margin);
        let extent = high - low;
        let cell = (extent.x * extent.y * extent.z / CELL_COUNT).cbrt();
        let size = [0, 1, 2].map(|axis| (extent[axis] / cell) as usize + 1);
        let tree = NearestPoints::new(&points);
        let nearest = (0..size[0] * size[1] * size[2])
            .into_par_iter()
            .with_min_len(1024)
            .map(|index| {
                let (x, y, z) = (index % size[0], index / size[0] % size[1], index / size[0] / size[1]);
                let middle = low + Vector3::new(x as f64 + 0.5, y as f64 + 0.5, z as f64 + 0.5) * cell;
                tree.nearest(&middle).map_or(0, |found| found.index as u32)
            })
            .collect();
        Self {
            anchors,
            low,
            cell,
            size,
            nearest,
            oriented,
        }
    }

    fn anchor(&self, point: &Point3<f64>) -> &(Point3<f64>, Vector3<f64>) {
        let offset = (point - self.low) / self.cell;
        let place = |axis: usize| (offset[axis].max(0.0) as usize).min(self.size[axis] - 1);
        &self.anchors[self.nearest[(place(2) * self.size[1] + place(1)) * self.size[0] + place(0)] as usize]
    }

    /// Where `faller` comes to from `start` while the reach shrinks from and to these multiples of its radius.
    pub(super) fn fall(&self, faller: &Faller, start: &Isometry3<f64>, from: f64, to: f64) -> Isometry3<f64> {
        let (points, normals) = (&faller.sample.points, &faller.sample.normals);
        let (centroid, radius) = (&faller.centroid, faller.radius);
        let mut pose = *start;
        let mut reach = from * radius;
        while reach > to * radius {
            let centre = pose * centroid;
            let mut sums = Sums::default();
            let scale = (SCALE_FRACTION * reach).powi(2);
            for (point, normal) in points.iter().zip(normals) {
                let placed = pose * point;
                let (anchor, surface) = self.anchor(&placed);
                let offset = placed - anchor;
                let squared = offset.norm_squared();
                if squared > reach * reach {
                    continue;
                }
                let turned = pose * normal;
                let cosine = agreement(&turned, surface, self.oriented);
                if cosine > AGREEMENT_FALLING {
                    let weight = cosine * (scale / (scale + squared)).powi(2);
                    sums.add(weight, &((placed - centre) / radius), surface, &offset);
                }
            }
            let Some(mut step) = sums.step(points.len()) else { break };
            let length = step.norm();
            if length > STEP_MAX_FACTOR * radius {
                step *= STEP_MAX_FACTOR * radius / length;
            }
            pose = moved(&pose, &centre, &unscaled(&step, radius));
            reach *= REACH_SHRINK;
        }
        pose
    }

    /// The poses that cover the template best, best first, clearly different from each other.
    pub(super) fn best_poses(&self, faller: &Faller, target: &Point3<f64>) -> Vec<Isometry3<f64>> {
        let mut found: Vec<(Isometry3<f64>, f64)> = spread_rotations(ROTATION_COUNT)
            .into_par_iter()
            .with_min_len(4)
            .map(|rotation| {
                let start = Translation3::from(target.coords) * rotation * Translation3::from(-faller.centroid.coords);
                let pose = self.fall(faller, &start, REACH_START, REACH_END);
                (pose, self.covered_fraction(faller, &pose))
            })
            .collect();
        found.sort_by(|a, b| b.1.total_cmp(&a.1));
        let least = found.first().map_or(0.0, |best| best.1 - CLEARLY);
        let good = found.iter().take_while(|(_, share)| *share >= least);
        let mut kept: Vec<Isometry3<f64>> = Vec::new();
        add_distinct(&mut kept, good.map(|(pose, _)| *pose), KEPT_COUNT, |a, b| {
            distinct(a, b, &faller.centroid, faller.radius)
        });
        kept
    }

    /// The share of the template that lies on the reference at `pose`, each point weighed by how near, 0 to 1.
    pub(super) fn covered_fraction(&self, faller: &Faller, pose: &Isometry3<f64>) -> f64 {
        let near = NEAR_FACTOR * faller.radius;
        let mut sum = 0.0;
        for (point, normal) in faller.sample.points.iter().zip(&faller.sample.normals) {
            let placed = pose * point;
            let (anchor, surface) = self.anchor(&placed);
            let offset = placed - anchor;
            if offset.norm() < 3.0 * near && agreement(&(pose * normal), surface, self.oriented) > AGREEMENT_COVERED {
                let residual = surface.dot(&offset) / near;
                sum += 1.0 / (1.0 + 9.0 * residual * residual);
            }
        }
        sum / faller.sample.points.len().max(1) as f64
    }
}

/// The normal equations of a fall's step: the distance along the surface's normal, and a share of that between points.
#[derive(Default)]
struct Sums {
    matrix: Matrix6<f64>,
    vector: Vector6<f64>,
    weight: f64,
    arm: Vector3<f64>,
    arms: Matrix3<f64>,
    offset: Vector3<f64>,
    torque: Vector3<f64>,
}

impl Sums {
    fn add(&mut self, weight: f64, arm: &Vector3<f64>, surface: &Vector3<f64>, offset: &Vector3<f64>) {
        let turn = arm.cross(surface);
        let row = Vector6::new(turn.x, turn.y, turn.z, surface.x, surface.y, surface.z);
        self.matrix.syger(weight, &row, &row, 1.0);
        self.vector.axpy(-weight * surface.dot(offset), &row, 1.0);
        self.weight += weight;
        self.arm += arm * weight;
        self.arms.syger(weight, arm, arm, 1.0);
        self.offset += offset * weight;
        self.torque += arm.cross(offset) * weight;
    }

    /// The step `[L·rx L·ry L·rz tx ty tz]`, slightly damped for `count` points; `None` if there is none.
    fn step(mut self, count: usize) -> Option<Vector6<f64>> {
        self.arms.fill_upper_triangle_with_lower_triangle();
        self.matrix.fill_upper_triangle_with_lower_triangle();
        let turning = Matrix3::identity() * self.arms.trace() - self.arms;
        let mixed = self.arm.cross_matrix();
        let mut between = Matrix6::identity() * self.weight;
        between.fixed_view_mut::<3, 3>(0, 0).copy_from(&turning);
        between.fixed_view_mut::<3, 3>(0, 3).copy_from(&mixed);
        between.fixed_view_mut::<3, 3>(3, 0).copy_from(&mixed.transpose());
        let damping = Matrix6::identity() * (DAMPING * count as f64);
        let (torque, offset) = (&self.torque, &self.offset);
        let pull = Vector6::new(torque.x, torque.y, torque.z, offset.x, offset.y, offset.z);
        let matrix = self.matrix + between * POINT_SHARE + damping;
        let step = matrix.cholesky()?.solve(&(self.vector - pull * POINT_SHARE));
        step.iter().all(|value| value.is_finite()).then_some(step)
    }
}

/// `count` rotations spread evenly over SO(3): super-Fibonacci spirals (Alexa, CVPR 2022).
pub(super) fn spread_rotations(count: usize) -> Vec<UnitQuaternion<f64>> {
    const PSI: f64 = 1.533_751_168_755_204_3;
    (0..count)
        .map(|index| {
            let along = index as f64 + 0.5;
            let share = along / count as f64;
            let (inner, outer) = (share.sqrt(), (1.0 - share).sqrt());
            let (alpha, beta) = (TAU * along / SQRT_2, TAU * along / PSI);
            UnitQuaternion::from_quaternion(Quaternion::new(
                outer * beta.cos(),
                inner * alpha.sin(),
                inner * alpha.cos(),
                outer * beta.sin(),
            ))
        })
        .collect()
}

/// How many points of the reference the grid knows.
const ANCHOR_COUNT: usize = 3000;
/// How many cells the grid has, about.
const CELL_COUNT: f64 = 60_000.0;
/// How far the grid reaches beyond the reference, over its radius; farther out the nearest cell answers.
const MARGIN_FACTOR: f64 = 0.3;
const REACH_SHRINK: f64 = 0.87;
/// The offset that quarters a pair's weight, over the reach.
const SCALE_FRACTION: f64 = 0.5;
const STEP_MAX_FACTOR: f64 = 0.3;
/// What the distance between the points counts beside that from the surface: enough to keep a fall from sliding.
const POINT_SHARE: f64 = 0.1;
const DAMPING: f64 = 1e-6;
/// Spread so that no rotation is farther than about 30 degrees from one of them.
const ROTATION_COUNT: usize = 600;
/// The reach of a fall at its start and end, over the template's radius.
const REACH_START: f64 = 0.8;
const REACH_END: f64 = 0.05;
/// At most this many poses are kept, ...
const KEPT_COUNT: usize = 12;
/// ... and none that covers this much less than the best.
const CLEARLY: f64 = 0.15;
/// Least cosine between the normals of a pair while falling, and of one that covers.
const AGREEMENT_FALLING: f64 = 0.3;
const AGREEMENT_COVERED: f64 = 0.8;
/// A point covers the reference within three times this, over the radius.
const NEAR_FACTOR: f64 = 0.04;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::registration::testing::blade;

    #[test]
    fn spread_rotations_leave_no_rotation_far_from_all() {
        let spread = spread_rotations(600);
        for index in 0..200 {
            let some =
                UnitQuaternion::from_euler_angles(0.7 * f64::from(index), 1.3 * f64::from(index), f64::from(index));
            let nearest = spread
                .iter()
                .map(|one| one.angle_to(&some))
                .fold(f64::INFINITY, f64::min);
            assert!(nearest < 0.6, "{nearest}");
        }
    }

    #[test]
    fn the_equations_are_those_of_the_single_rows() {
        let (arm, surface) = (Vector3::new(0.3, -0.5, 0.9), Vector3::new(0.0, 0.6, 0.8));
        let offset = Vector3::new(0.02, 0.01, -0.03);
        let mut sums = Sums::default();
        let (mut matrix, mut vector) = (Matrix6::identity() * DAMPING, Vector6::zeros());
        for (weight, arm) in [(0.7, arm), (0.4, -arm), (0.9, arm.yzx()), (0.5, arm.zxy() * 2.0)] {
            sums.add(weight, &arm, &surface, &offset);
            for (share, axis) in [
                (1.0, surface),
                (POINT_SHARE, Vector3::x()),
                (POINT_SHARE, Vector3::y()),
                (POINT_SHARE, Vector3::z()),
            ] {
                let turn = arm.cross(&axis);
                let row = Vector6::new(turn.x, turn.y, turn.z, axis.x, axis.y, axis.z);
                matrix += row * row.transpose() * (share * weight);
                vector -= row * (share * weight * axis.dot(&offset));
            }
        }
        let expected = matrix.cholesky().unwrap().solve(&vector);
        let step = sums.step(1).unwrap();
        assert!((step - expected).norm() < 1e-9 * expected.norm(), "{step} {expected}");
    }

    #[test]
    fn a_blade_falls_onto_itself_from_a_turned_start() {
        let cloud = blade(2000, 0.0);
        let reference = Reference::new(&cloud).unwrap();
        let swarm = Swarm::new(&reference, false);
        let few = super::super::icp::Sample {
            points: cloud.points().iter().copied().step_by(10).collect(),
            normals: reference.normals().iter().copied().step_by(10).collect(),
        };
        let faller = Faller {
            sample: few,
            centroid: cloud.centroid(),
            radius: reference.radius(),
        };
        let start = Isometry3::new(Vector3::new(0.1, 0.0, -0.1), Vector3::new(0.1, 0.2, 0.3));
        let pose = swarm.fall(&faller, &start, REACH_START, REACH_END);
        assert!(pose.rotation.angle() < 0.05, "{}", pose.rotation.angle());
        assert!(swarm.covered_fraction(&faller, &pose) > 2.0 * swarm.covered_fraction(&faller, &start));
    }
}
