//! Poses from pairs of oriented points: a start for views that nothing is known about.
//!
//! Two points with normals have four numbers that no motion changes: their distance, the angles of either normal with the
//! line between them, and the angle between the normals. A pair of the template and a pair of the reference with the same
//! four numbers give one pose. Every template point lets its pairs vote for the reference point that it lies on and for
//! the turn about the normal there (Drost and others, 2010); what many pairs agree on becomes a candidate. Unlike a fall
//! in the field of all points this asks for no overlap of most of the clouds.

use nalgebra::{Isometry3, Point3, Translation3, Unit, UnitQuaternion, Vector3};
use rayon::prelude::*;

use super::icp::Sample;
use crate::geometry::statistics::mean;

/// A pose that pairs have voted for.
#[derive(Debug, Clone, Copy)]
struct Voted {
    pose: Isometry3<f64>,
    votes: f64,
}

/// Poses of `template` on `reference` with the most votes first, at most `count`, clearly different from each other.
///
/// The normals' signs count. `radius` is the template's. Work grows with the square of the samples, which hold at most
/// 65,536 points each. Samples without pairs that are not flat give no pose.
pub(super) fn voted_poses(template: &Sample, reference: &Sample, radius: f64, count: usize) -> Vec<Isometry3<f64>> {
    let Some(table) = Table::new(reference, radius) else {
        return Vec::new();
    };
    let origins = crate::geometry::sampling::even_indices(template.points.len(), ORIGIN_COUNT);
    let mut all: Vec<Voted> = origins
        .par_iter()
        .map(|&origin| table.peaks(template, origin, radius))
        .collect::<Vec<_>>()
        .concat();
    all.sort_by(|a, b| b.votes.total_cmp(&a.votes));
    let mut clusters: Vec<Voted> = Vec::new();
    let mut sums: Vec<f64> = Vec::new();
    let centroid = mean(&template.points);
    for voted in all {
        let near = clusters.iter().position(|cluster: &Voted| {
            (cluster.pose.rotation.inverse() * voted.pose.rotation).angle() < CLUSTER_RAD
                && (cluster.pose * centroid - voted.pose * centroid).norm() < CLUSTER_FACTOR * radius
        });
        match near {
            Some(index) => sums[index] += voted.votes,
            None => {
                clusters.push(voted);
                sums.push(voted.votes);
            }
        }
    }
    for (cluster, sum) in clusters.iter_mut().zip(sums) {
        cluster.votes = sum;
    }
    clusters.sort_by(|a, b| b.votes.total_cmp(&a.votes));
    clusters.iter().take(count).map(|cluster| cluster.pose).collect()
}

/// The pairs of the reference by their four numbers.
struct Table<'a> {
    reference: &'a Sample,
    /// The motion that lays each point on the origin and its normal along x.
    frames: Vec<Isometry3<f64>>,
    /// Where the pairs of each key begin in `pairs`; one more than there are keys.
    begins: Vec<u32>,
    /// First point and turn about its normal.
    pairs: Vec<(u16, f32)>,
    /// Keys with more pairs than this are passed over.
    common: f64,
}

impl<'a> Table<'a> {
    fn new(reference: &'a Sample, radius: f64) -> Option<Self> {
        let frames: Vec<Isometry3<f64>> = frames(reference);
        let rows: Vec<Vec<(u32, u16, f32)>> = (0..reference.points.len())
            .into_par_iter()
            .map(|first| pairs_from(reference, first, &frames[first], radius).collect())
            .collect();
        let mut begins = vec![0u32; KEY_COUNT + 1];
        for (key, ..) in rows.iter().flatten() {
            begins[*key as usize + 1] += 1;
        }
        let filled = begins.iter().filter(|size| **size > 0).count();
        for key in 0..KEY_COUNT {
            begins[key + 1] += begins[key];
        }
        let total = begins[KEY_COUNT] as usize;
        if total == 0 {
            return None;
        }
        let mut next = begins.clone();
        let mut pairs = vec![(0u16, 0f32); total];
        for (key, first, turn) in rows.into_iter().flatten() {
            pairs[next[key as usize] as usize] = (first, turn);
            next[key as usize] += 1;
        }
        Some(Self {
            reference,
            frames,
            begins,
            pairs,
            common: COMMON_FACTOR * total as f64 / filled as f64,
        })
    }

    /// The best few poses that lay template point `origin` on a reference point.
    fn peaks(&self, template: &Sample, origin: usize, radius: f64) -> Vec<Voted> {
        let frame = frame(&template.points[origin], &template.normals[origin]);
        let count = self.reference.points.len();
        let mut votes = vec![0f32; count * TURN_COUNT];
        for (key, _, turn) in pairs_from(template, origin, &frame, radius) {
            let (begin, end) = (
                self.begins[key as usize] as usize,
                self.begins[key as usize + 1] as usize,
            );
            if (end - begin) as f64 > self.common || begin == end {
                continue;
            }
            let weight = 1.0 / ((end - begin) as f32).sqrt();
            for &(first, reference_turn) in &self.pairs[begin..end] {
                let difference = (reference_turn - turn).rem_euclid(1.0) * TURN_COUNT as f32;
                let bin = (difference as usize).min(TURN_COUNT - 1);
                votes[first as usize * TURN_COUNT + bin] += weight;
            }
        }
        let mut best: Vec<(f32, usize, usize)> = Vec::with_capacity(count);
        for first in 0..count {
            let row = &votes[first * TURN_COUNT..(first + 1) * TURN_COUNT];
            let (mut value, mut place) = (0.0, 0);
            for bin in 0..TURN_COUNT {
                let sum = row[bin] + 0.5 * (row[(bin + 1) % TURN_COUNT] + row[(bin + TURN_COUNT - 1) % TURN_COUNT]);
                if sum > value {
                    (value, place) = (sum, bin);
                }
            }
            if value > 0.0 {
                best.push((value, first, place));
            }
        }
        best.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
        best.iter()
            .take(PEAK_COUNT)
            .map(|&(value, first, bin)| {
                let turn = (bin as f64 + 0.5) / TURN_COUNT as f64 * std::f64::consts::TAU;
                let about = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), turn);
                Voted {
                    pose: self.frames[first].inverse() * about * frame,
                    votes: f64::from(value),
                }
            })
            .collect()
    }
}

/// The key of every pair that starts at `first`, the first point's index and the second's turn about its normal, 0 to 1.
fn pairs_from(
    sample: &Sample,
    first: usize,
    frame: &Isometry3<f64>,
    radius: f64,
) -> impl Iterator<Item = (u32, u16, f32)> {
    let (point, normal) = (sample.points[first], sample.normals[first]);
    let step = DISTANCE_FACTOR * radius;
    sample
        .points
        .iter()
        .zip(&sample.normals)
        .filter_map(move |(other, other_normal)| {
            let line = other - point;
            let distance = line.norm();
            let place = distance / step;
            if !(DISTANCE_MIN..DISTANCE_COUNT as f64).contains(&place) {
                return None;
            }
            let unit = line / distance;
            let (a, b, c) = (normal.dot(&unit), other_normal.dot(&unit), normal.dot(other_normal));
            if c > FLAT && a.abs() < FLAT_SLOPE && b.abs() < FLAT_SLOPE {
                return None;
            }
            let mut key = place as usize;
            for cosine in [a, b, c] {
                let angle = cosine.clamp(-1.0, 1.0).acos() / std::f64::consts::PI;
                key = key * ANGLE_COUNT + ((angle * ANGLE_COUNT as f64) as usize).min(ANGLE_COUNT - 1);
            }
            let local = frame.rotation * line;
            let turn = local.z.atan2(local.y) / std::f64::consts::TAU;
            Some((key as u32, first as u16, turn.rem_euclid(1.0) as f32))
        })
}

fn frames(sample: &Sample) -> Vec<Isometry3<f64>> {
    sample
        .points
        .iter()
        .zip(&sample.normals)
        .map(|(point, normal)| frame(point, normal))
        .collect()
}

/// The motion that lays `point` on the origin and `normal` along x.
fn frame(point: &Point3<f64>, normal: &Vector3<f64>) -> Isometry3<f64> {
    let rotation = UnitQuaternion::rotation_between(normal, &Vector3::x())
        .unwrap_or_else(|| UnitQuaternion::from_axis_angle(&Unit::new_unchecked(Vector3::z()), std::f64::consts::PI));
    Isometry3::from_parts(Translation3::identity(), rotation) * Translation3::from(-point.coords)
}

/// How many template points let their pairs vote, and how many poses of each are kept.
const ORIGIN_COUNT: usize = 100;
const PEAK_COUNT: usize = 5;
/// Turns about a normal in 12-degree steps.
const TURN_COUNT: usize = 30;
/// Distances in steps of this multiple of the radius: nearer pairs than the least have no direction among noise, farther
/// ones hardly lie both in what two views share.
const DISTANCE_FACTOR: f64 = 0.12;
const DISTANCE_MIN: f64 = 2.0;
const DISTANCE_COUNT: usize = 16;
/// Angles in 15-degree steps.
const ANGLE_COUNT: usize = 12;
const KEY_COUNT: usize = DISTANCE_COUNT * ANGLE_COUNT * ANGLE_COUNT * ANGLE_COUNT;
/// Pairs with a larger cosine between the normals and smaller slopes lie in one plane and determine nothing.
const FLAT: f64 = 0.96;
const FLAT_SLOPE: f64 = 0.2;
/// Keys with more pairs than this many times the mean say little and cost much.
const COMMON_FACTOR: f64 = 10.0;
/// Poses nearer to each other than this are one: 14 degrees, a fifth of the radius.
const CLUSTER_RAD: f64 = 0.25;
const CLUSTER_FACTOR: f64 = 0.2;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::PointCloud;
    use crate::geometry::nearest::NearestPoints;
    use crate::geometry::normals::with_estimated_normals;
    use crate::registration::testing::blade;

    /// What a camera far away at `direction` sees of a blade, roughly: what faces it.
    fn view(phase: f64, direction: &Vector3<f64>) -> PointCloud {
        let whole = blade(4000, phase);
        let tree = NearestPoints::new(whole.points());
        let camera = Point3::from(direction * 1e3);
        let centroid = whole.centroid();
        let seen: Vec<usize> = (0..whole.len())
            .filter(|&i| (whole.points()[i] - centroid).dot(direction) > 0.0)
            .collect();
        with_estimated_normals(&whole, &tree, 12, Some(&camera)).select(&seen)
    }

    fn sample(cloud: &PointCloud) -> Sample {
        let indices = crate::geometry::sampling::even_indices(cloud.len(), 400);
        let cloud = cloud.select(&indices);
        Sample {
            points: cloud.points().to_vec(),
            normals: cloud.normals().map(<[_]>::to_vec).unwrap_or_default(),
        }
    }

    #[test]
    fn two_views_vote_for_their_motion_whatever_it_is() {
        let truth = Isometry3::new(Vector3::new(3.0, -1.0, 0.5), Vector3::new(1.1, -1.9, 0.7));
        let template = view(0.0, &Vector3::new(0.9, 0.3, 0.3).normalize());
        let reference = view(0.5, &Vector3::new(0.7, 0.6, 0.4).normalize()).transformed(&truth);
        let found = voted_poses(&sample(&template), &sample(&reference), 0.7, 5);
        let near = found.iter().any(|pose| {
            let error = truth.inverse() * pose;
            error.rotation.angle() < 0.3 && error.translation.vector.norm() < 0.3
        });
        assert!(near, "{found:?}");
    }

    #[test]
    fn a_plane_votes_for_nothing() {
        let points: Vec<_> = (0..400)
            .map(|i| Point3::new(f64::from(i % 20), f64::from(i / 20), 0.0))
            .collect();
        let plane = Sample {
            normals: vec![Vector3::z(); points.len()],
            points,
        };
        assert!(voted_poses(&plane, &plane, 8.0, 5).is_empty());
    }
}
