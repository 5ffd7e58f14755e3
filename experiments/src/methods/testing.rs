//! Clouds whose registration is known.

use bladescan::geometry::PointCloud;
use nalgebra::{Isometry3, Point3, Translation3, Unit, UnitQuaternion, Vector3};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;

/// Two clouds and the motion between them, target_from_source.
pub(crate) struct Known {
    pub(crate) source: PointCloud,
    pub(crate) target: PointCloud,
    pub(crate) truth: Isometry3<f64>,
}

/// Points on a bent, tapering blade of half length 1: no symmetry, thinner than wide, thicker than its spacing.
pub(crate) fn wedge(count: usize, seed: u64) -> Vec<Point3<f64>> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    (0..count)
        .map(|_| {
            let (along, around) = (
                2.0 * rng.random::<f64>() - 1.0,
                std::f64::consts::TAU * rng.random::<f64>(),
            );
            let width = 0.5 - 0.2 * along;
            let (x, y) = (
                width * around.cos(),
                0.3 * width * around.sin() * (1.0 + 0.5 * around.cos()),
            );
            let (sin, cos) = (0.6 * along).sin_cos();
            Point3::new(cos * x - sin * y + 0.2 * along * along, sin * x + cos * y, along)
        })
        .collect()
}

/// A turn about a slanted axis, then a shift.
pub(crate) fn motion(turn_deg: f64, shift: [f64; 3]) -> Isometry3<f64> {
    let axis = Unit::new_normalize(Vector3::new(0.3, -0.5, 0.8));
    Translation3::from(Vector3::from(shift)) * UnitQuaternion::from_axis_angle(&axis, turn_deg.to_radians())
}

/// The same points, moved and in another order.
pub(crate) fn permuted(count: usize, turn_deg: f64, shift: [f64; 3]) -> Known {
    let source = wedge(count, 1);
    let truth = motion(turn_deg, shift);
    // 7 has no factor in common with the counts in use.
    let target = (0..count).map(|index| truth * source[index * 7 % count]).collect();
    known(source, target, truth)
}

/// As `permuted`, with normal noise on the target.
pub(crate) fn noisy(count: usize, turn_deg: f64, sigma: f64) -> Known {
    let source = wedge(count, 1);
    let truth = motion(turn_deg, [0.1, -0.1, 0.05]);
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    let mut normal = || {
        let (u, v): (f64, f64) = (rng.random::<f64>().max(f64::MIN_POSITIVE), rng.random());
        sigma * (-2.0 * u.ln()).sqrt() * (std::f64::consts::TAU * v).cos()
    };
    let target = source
        .iter()
        .map(|point| truth * point + Vector3::from_fn(|_, _| normal()))
        .collect();
    known(source, target, truth)
}

/// The source has a further `share` of its points in a heap on one side, which the target lacks.
pub(crate) fn with_one_sided_outliers(count: usize, share: f64) -> Known {
    let points = wedge(count, 1);
    let truth = motion(5.0, [0.02, -0.02, 0.02]);
    let target = points.iter().map(|point| truth * point).collect();
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let outlier_count = (share / (1.0 - share) * count as f64) as usize;
    let heap = (0..outlier_count)
        .map(|_| Point3::from(Vector3::from_fn(|_, _| 0.6 * rng.random::<f64>()) + Vector3::new(1.0, 0.0, 0.4)));
    let source = points.iter().copied().chain(heap).collect();
    known(source, target, truth)
}

/// The target has further points all over the cube that holds it.
pub(crate) fn with_scattered_outliers(count: usize, outlier_count: usize) -> Known {
    let source = wedge(count, 1);
    let truth = motion(20.0, [0.1, -0.1, 0.05]);
    let mut rng = ChaCha8Rng::seed_from_u64(4);
    let scattered = (0..outlier_count).map(|_| Point3::from(Vector3::from_fn(|_, _| 2.4 * rng.random::<f64>() - 1.2)));
    let target = source.iter().map(|point| truth * point).chain(scattered).collect();
    known(source, target, truth)
}

/// Two unlike samples of a ball, whose points know nothing of its turn, with normals that do: a bent field.
pub(crate) fn ball_with_a_field_of_normals(count: usize, turn_deg: f64) -> Known {
    let truth = motion(turn_deg, [0.0, 0.0, 0.0]);
    let ball = |seed: u64| -> Vec<Vector3<f64>> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut points = Vec::new();
        while points.len() < count {
            let point = Vector3::from_fn(|_, _| 2.0 * rng.random::<f64>() - 1.0);
            if (0.1..1.0).contains(&point.norm()) {
                points.push(point.normalize());
            }
        }
        points
    };
    let field = |p: &Vector3<f64>| Vector3::new(p.y + 0.3, p.x * p.z + 0.2, 1.0 + 0.5 * p.x).normalize();
    let (points, others) = (ball(5), ball(6));
    let cloud = |points: Vec<Vector3<f64>>, normals: Vec<Vector3<f64>>| {
        let cloud = PointCloud::from_measured(points.into_iter().map(Point3::from)).cloud;
        cloud.with_normals(normals).unwrap()
    };
    let normals = points.iter().map(field).collect();
    let moved_normals = others.iter().map(|point| truth * field(point)).collect();
    Known {
        source: cloud(points, normals),
        target: cloud(others.iter().map(|point| truth * point).collect(), moved_normals),
        truth,
    }
}

/// What a method finds from the identity with its own settings.
pub(crate) fn found<S: Default>(
    pair: &Known,
    register: fn(&PointCloud, &PointCloud, &Isometry3<f64>, &S) -> Isometry3<f64>,
) -> Isometry3<f64> {
    register(&pair.source, &pair.target, &Isometry3::identity(), &S::default())
}

/// Asserts that an estimate differs from the truth by less than `tolerance`, in radians and in the clouds' unit.
pub(crate) fn assert_near(estimate: &Isometry3<f64>, truth: &Isometry3<f64>, tolerance: f64) {
    let error = truth.inverse() * estimate;
    let (turn, shift) = (error.rotation.angle(), error.translation.vector.norm());
    assert!(turn < tolerance && shift < tolerance, "off by {turn} rad and {shift}");
}

fn known(source: Vec<Point3<f64>>, target: Vec<Point3<f64>>, truth: Isometry3<f64>) -> Known {
    Known {
        source: PointCloud::from_measured(source).cloud,
        target: PointCloud::from_measured(target).cloud,
        truth,
    }
}
