//! The Cramer-Rao bound of a case: how small the error of the best unbiased registration of its two clouds can be.
//!
//! Two surfaces determine a motion through the distances between them along their normal. At the true pose each source
//! point of the overlap gives one such distance, of variance `σ_s² + σ_t² ρ_s / ρ_t`: its own noise along the normal, and
//! that of as many target points as lie on its share of the surface (ρ are the clouds' densities there). The bound is
//! the inverse of the summed information. It is that of the root mean square over many drawings of the noise; the median of the
//! ratio of error to bound is 0.6 to 0.95 for an efficient method, depending on how many directions share the error.
//!
//! Where the clouds are the same points (`exp` is `noise` or `outlier`) it is the bound with known correspondences, `σ √(6/N)`.

use std::error::Error;
use std::io::Write;
use std::path::PathBuf;

use bladescan::geometry::PointCloud;
use bladescan::geometry::nearest::NearestPoints;
use bladescan::geometry::normals::with_estimated_normals;
use clap::{Args, ValueEnum};
use nalgebra::{Isometry3, Matrix3, Matrix6, Vector3, Vector6};

use crate::cases::{self, Case, median};

/// Prints the bound of every case folder under a root, and the median of each group.
#[derive(Args)]
pub(crate) struct BoundArguments {
    /// Where the case folders are, at any depth.
    root: PathBuf,
    /// Only cases of this level, as `meta.txt` names it.
    #[arg(long)]
    level: Option<String>,
    #[command(flatten)]
    noise: NoiseArguments,
}

/// The noise of the measured points, in the clouds' unit. What is not given is that of `../shared/cases`, by `exp` in `meta.txt`.
#[derive(Args)]
pub(crate) struct NoiseArguments {
    /// Standard deviation along the ray of the camera, both clouds.
    #[arg(long)]
    ray_sigma: Option<f64>,
    /// Standard deviation of each coordinate, both clouds.
    #[arg(long)]
    isotropic_sigma: Option<f64>,
    /// Where the camera is.
    #[arg(long, value_enum, default_value_t = Ray::Z)]
    ray: Ray,
}

/// The direction of a cloud's camera.
#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Ray {
    /// Along z of the cloud's own frame, as in `../shared/cases/mv`.
    Z,
    /// The direction that most of the surface is square to; the sides of a thin wall are then not told apart between clouds.
    Facing,
}

/// The noise of the two clouds of a case.
struct Noise {
    /// Along the ray, both clouds.
    ray: f64,
    /// Of each coordinate.
    source: f64,
    target: f64,
}

/// The least errors.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Bound {
    /// Root mean square over the source points, in the clouds' unit; infinite where the overlap determines no motion.
    pub(crate) rmse: f64,
    /// The turn; not known for clouds of the same points.
    pub(crate) rotation_deg: f64,
}

pub(crate) fn run(arguments: &BoundArguments) -> Result<(), Box<dyn Error>> {
    let mut out = std::io::stdout().lock();
    let mut groups: std::collections::BTreeMap<String, Vec<Bound>> = std::collections::BTreeMap::new();
    for case in cases::find(&arguments.root, arguments.level.as_deref())? {
        let source = cases::cloud(&case.folder.join("source.ply"))?;
        let target = cases::cloud(&case.folder.join("target.ply"))?;
        let bound = of(&case, &source, &target, &arguments.noise)?;
        let folder = case.folder.strip_prefix(&arguments.root)?;
        writeln!(
            out,
            "{} rmse {:.3e} rot {:.2e} deg",
            folder.display(),
            bound.rmse,
            bound.rotation_deg
        )?;
        groups.entry(case.group()).or_default().push(bound);
    }
    for (name, bounds) in groups {
        writeln!(
            out,
            "{name:<28} {:>4} cases, median bound: rmse {:.3e} rot {:.2e} deg",
            bounds.len(),
            median(bounds.iter().map(|bound| bound.rmse).collect()),
            median(bounds.iter().map(|bound| bound.rotation_deg).collect()),
        )?;
    }
    Ok(())
}

/// The bound of a case whose noise is `arguments`, or known by the kind of the case.
pub(crate) fn of(
    case: &Case,
    source: &PointCloud,
    target: &PointCloud,
    arguments: &NoiseArguments,
) -> Result<Bound, Box<dyn Error>> {
    let noise = noise_of(case, arguments)?;
    if is_of_the_same_points(case) {
        let sigma = noise.source.hypot(noise.target);
        return Ok(Bound {
            rmse: sigma * (6.0 / source.len().max(1) as f64).sqrt(),
            rotation_deg: f64::NAN,
        });
    }
    let truth = cases::isometry(&case.truth);
    let fixed = Surface::new(target, arguments.ray, &noise, noise.target);
    let moving = Surface::new(source, arguments.ray, &noise, noise.source).moved(&truth);
    Ok(surface_bound(&moving, &fixed))
}

fn is_of_the_same_points(case: &Case) -> bool {
    matches!(case.meta.get("exp").map(String::as_str), Some("noise" | "outlier"))
}

fn noise_of(case: &Case, arguments: &NoiseArguments) -> Result<Noise, Box<dyn Error>> {
    if arguments.ray_sigma.is_some() || arguments.isotropic_sigma.is_some() {
        let both = arguments.isotropic_sigma.unwrap_or(0.0);
        return Ok(Noise {
            ray: arguments.ray_sigma.unwrap_or(0.0),
            source: both,
            target: both,
        });
    }
    let level = || case.meta.get("level").and_then(|text| text.parse::<f64>().ok());
    let (ray, source, target) = match case.meta.get("exp").map_or("", String::as_str) {
        exp if exp.starts_with("mv") => (0.02, 0.005, 0.005),
        "noise" | "resample" => (0.0, 0.0, level().ok_or("meta.txt has no level")?),
        "outlier" => (0.0, 0.0, 0.005),
        "partial" => (0.0, 0.002, 0.002),
        other => return Err(format!("cases of the kind \"{other}\" need --ray-sigma or --isotropic-sigma").into()),
    };
    Ok(Noise { ray, source, target })
}

/// A cloud with all that the bound needs of each point.
struct Surface {
    cloud: PointCloud,
    /// The side to which the normals face.
    towards_camera: Vector3<f64>,
    /// Variance along the normal.
    variances: Vec<f64>,
    /// Squared distance to the last of the neighbours: over 1/density, up to a factor that is the same in both clouds.
    areas: Vec<f64>,
}

impl Surface {
    fn new(cloud: &PointCloud, ray: Ray, noise: &Noise, isotropic: f64) -> Self {
        let tree = NearestPoints::new(cloud.points());
        let camera = match ray {
            Ray::Z => Vector3::z(),
            Ray::Facing => faced(cloud, &tree),
        };
        let cloud = with_estimated_normals(cloud, &tree, NORMAL_NEIGHBOUR_COUNT, None);
        // All on one side, so that the two sides of a thin wall differ.
        let signed = |normal: &Vector3<f64>| normal * if normal.dot(&camera) < 0.0 { -1.0 } else { 1.0 };
        let facing = cloud.normals().unwrap_or(&[]).iter().map(signed).collect();
        let cloud = cloud.clone().with_normals(facing).unwrap_or(cloud);
        let along = |normal: &Vector3<f64>| isotropic.powi(2) + (noise.ray * normal.dot(&camera)).powi(2);
        let areas = cloud
            .points()
            .iter()
            .map(|point| {
                let last = tree
                    .nearest_many(point, DENSITY_NEIGHBOUR_COUNT)
                    .last()
                    .map(|found| found.distance);
                last.unwrap_or(0.0).powi(2)
            })
            .collect();
        Self {
            variances: cloud.normals().unwrap_or(&[]).iter().map(along).collect(),
            areas,
            cloud,
            towards_camera: camera,
        }
    }

    fn moved(self, target_from_source: &Isometry3<f64>) -> Self {
        Self {
            cloud: self.cloud.transformed(target_from_source),
            towards_camera: target_from_source * self.towards_camera,
            ..self
        }
    }
}

/// The direction that most of the surface is square to.
fn faced(cloud: &PointCloud, tree: &NearestPoints) -> Vector3<f64> {
    let with_normals = with_estimated_normals(cloud, tree, NORMAL_NEIGHBOUR_COUNT, None);
    let mut squared = Matrix3::zeros();
    for normal in with_normals.normals().unwrap_or(&[]) {
        squared += normal * normal.transpose();
    }
    let eigen = squared.symmetric_eigen();
    eigen.eigenvectors.column(eigen.eigenvalues.imax()).into_owned()
}

/// Unknowns are `[rx ry rz tx ty tz]` about the moving cloud's centroid. The information is taken from the two clouds'
/// independent normals, so that noise in them adds nothing.
fn surface_bound(moving: &Surface, fixed: &Surface) -> Bound {
    let tree = NearestPoints::new(fixed.cloud.points());
    let reach = OVERLAP_FACTOR * median(fixed.areas.clone()).sqrt();
    let centre = moving.cloud.centroid();
    let mut information = Matrix6::zeros();
    let mut spread = Matrix6::zeros();
    let (moving_normals, fixed_normals) = (normals(moving), normals(fixed));
    let side = moving.towards_camera.dot(&fixed.towards_camera).signum();
    for (index, point) in moving.cloud.points().iter().enumerate() {
        let arm = point - centre;
        for axis in [Vector3::x(), Vector3::y(), Vector3::z()] {
            let row = row(&arm, &axis);
            spread += row * row.transpose();
        }
        let Some(found) = tree.nearest_within(point, reach) else {
            continue;
        };
        let (first, second) = (moving_normals[index], fixed_normals[found.index] * side);
        if first.dot(&second) < AGREEMENT || fixed.areas[found.index] <= 0.0 {
            continue;
        }
        // Few points on a surface have large areas.
        let density_ratio = fixed.areas[found.index] / moving.areas[index].max(f64::MIN_POSITIVE);
        let variance = moving.variances[index] + fixed.variances[found.index] * density_ratio;
        let (a, b) = (row(&arm, &first), row(&arm, &second));
        information += (a * b.transpose() + b * a.transpose()) / (2.0 * variance);
    }
    spread /= moving.cloud.len().max(1) as f64;
    let covariance = information.cholesky().map(|factors| factors.inverse());
    covariance.map_or(
        Bound {
            rmse: f64::INFINITY,
            rotation_deg: f64::INFINITY,
        },
        |covariance| Bound {
            rmse: (covariance * spread).trace().sqrt(),
            rotation_deg: covariance.fixed_view::<3, 3>(0, 0).trace().sqrt().to_degrees(),
        },
    )
}

fn normals(surface: &Surface) -> &[Vector3<f64>] {
    surface.cloud.normals().unwrap_or(&[])
}

fn row(arm: &Vector3<f64>, normal: &Vector3<f64>) -> Vector6<f64> {
    let turn = arm.cross(normal);
    Vector6::new(turn.x, turn.y, turn.z, normal.x, normal.y, normal.z)
}

/// Neighbours in a plane fit: few, so that edges stay sharp (noise in the normals cancels between the clouds).
const NORMAL_NEIGHBOUR_COUNT: usize = 10;
/// Neighbours whose radius tells the density.
const DENSITY_NEIGHBOUR_COUNT: usize = 20;
/// A point overlaps if it is nearer than this share of the radius that holds the neighbours, about two spacings.
const OVERLAP_FACTOR: f64 = 0.8;
/// Least cosine between the normals of one surface.
const AGREEMENT: f64 = 0.5;
