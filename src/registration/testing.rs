//! Shapes for the tests of registration and reconstruction.

use nalgebra::{Point3, Vector3};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;

use crate::geometry::PointCloud;

/// `count` points along a line that loops through a box of half extents 1, 0.7 and 0.4; `phase` shifts them along it.
pub(crate) fn looped(count: u32, phase: f64) -> Vec<Point3<f64>> {
    (0..count)
        .map(|i| {
            let t = f64::from(i) * 0.7 + phase;
            Point3::new(t.sin(), (1.3 * t).cos() * 0.7, (0.37 * t).sin() * 0.4)
        })
        .collect()
}

/// A twisted, cambered blade of half height 1 with a slanted platform, about `count` points without normals; `phase`
/// (0 to 1) shifts the sampling along the surface.
pub(crate) fn blade(count: usize, phase: f64) -> PointCloud {
    let on_platform = count / 4;
    let on_blade = count - on_platform;
    let golden = 0.618_033_988_749_895;
    let blade = (0..on_blade).map(|i| {
        let height = 2.0 * ((i as f64 + phase) / on_blade as f64) - 1.0;
        let around = std::f64::consts::TAU * (i as f64 * golden + 0.37 * phase).fract();
        let chord = 0.5 * around.cos() * (1.0 - 0.2 * height);
        let thickness = 0.1 * around.sin() * (1.0 - 0.6 * around.cos()) + 0.25 * (0.25 - chord * chord);
        let (sin, cos) = (0.5 * height).sin_cos();
        Point3::new(cos * chord - sin * thickness, sin * chord + cos * thickness, height)
    });
    let platform = (0..on_platform).map(|i| {
        let u = (i as f64 + phase) / on_platform as f64 - 0.5;
        let v = (i as f64 * golden + 0.71 * phase).fract() - 0.5;
        Point3::new(1.3 * u, v, -1.0 + 0.15 * u)
    });
    PointCloud::from_measured(blade.chain(platform)).cloud
}

/// The same section all along z: an extruded airfoil from -1 to 1 with exact outward normals.
pub(crate) fn extruded(count: usize, phase: f64) -> PointCloud {
    let golden = 0.618_033_988_749_895;
    let (mut points, mut normals) = (Vec::new(), Vec::new());
    for i in 0..count {
        let height = 2.0 * ((i as f64 + phase) / count as f64) - 1.0;
        let around = std::f64::consts::TAU * (i as f64 * golden + 0.37 * phase).fract();
        let (sin, cos) = around.sin_cos();
        points.push(Point3::new(0.5 * cos, 0.15 * sin + 0.1 * cos * cos, height));
        // The tangent of the section turned by a quarter.
        let tangent = Vector3::new(-0.5 * sin, 0.15 * cos - 0.2 * cos * sin, 0.0);
        normals.push(tangent.cross(&Vector3::z()));
    }
    let cloud = PointCloud::from_measured(points).cloud;
    cloud.with_normals(normals).unwrap()
}

/// The cloud with independent Gaussian noise of standard deviation `sigma` on every coordinate, without normals.
pub(crate) fn noisy(cloud: &PointCloud, sigma: f64, seed: u64) -> PointCloud {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut normal = || {
        let (u, v): (f64, f64) = (rng.random::<f64>().max(1e-300), rng.random());
        sigma * (-2.0 * u.ln()).sqrt() * (std::f64::consts::TAU * v).cos()
    };
    let points: Vec<_> = cloud
        .points()
        .iter()
        .map(|point| point + Vector3::new(normal(), normal(), normal()))
        .collect();
    PointCloud::from_measured(points).cloud
}
