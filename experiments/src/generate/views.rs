//! Dense views of one blade in mm, all around it, and the pairs that link them.

use std::error::Error;
use std::f64::consts::TAU;
use std::fs;
use std::path::Path;

use nalgebra::{Isometry3, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::surface::{Hit, Surface};
use super::{as_ply, normal, rows, stream, write_link};

/// What the camera measures of a blade from one place.
pub(crate) struct View {
    /// In the view's frame, mm.
    pub(crate) points: Vec<Point3<f64>>,
    pub(crate) view_from_blade: Isometry3<f64>,
}

impl View {
    /// View `index` of the [`AROUND_COUNT`] all around, of about so many points.
    pub(crate) fn new(surface: &Surface, name: &str, seed: u64, index: u32, point_count: usize) -> Self {
        let mut rng = stream(seed, &format!("views {name} {index}"));
        let view_from_blade = pose(index, &mut rng);
        Self {
            points: measured(surface, &view_from_blade, point_count, &mut rng),
            view_from_blade,
        }
    }
}

/// Writes `view_NN.ply`, `pose_NN.txt` (view_from_blade) and the `pair_II_JJ` of views 10, 30 and 60 degrees apart;
/// returns how many pairs.
///
/// A view's frame has its origin near the blade's, up to 2.5 mm away, and z towards the camera.
pub(super) fn write(
    out: &Path,
    name: &str,
    surface: &Surface,
    seed: u64,
    view_count: u32,
) -> Result<u32, Box<dyn Error>> {
    if view_count > AROUND_COUNT {
        return Err(format!("{AROUND_COUNT} views go all around").into());
    }
    fs::create_dir_all(out)?;
    let mut view_from_blade = Vec::new();
    for index in 0..view_count {
        let view = View::new(surface, name, seed, index, VIEW_POINT_COUNT);
        fs::write(out.join(format!("view_{index:02}.ply")), as_ply(view.points))?;
        fs::write(out.join(format!("pose_{index:02}.txt")), rows(&view.view_from_blade))?;
        view_from_blade.push(view.view_from_blade);
    }
    let mut pair_count = 0;
    for source in 0..view_count {
        for apart in [1, 3, 6] {
            let target = (source + apart) % AROUND_COUNT;
            if target >= view_count {
                continue;
            }
            let folder = out.join(format!("pair_{source:02}_{target:02}"));
            fs::create_dir_all(&folder)?;
            let truth = view_from_blade[target as usize] * view_from_blade[source as usize].inverse();
            let deg = 10 * apart;
            let diagonal = 2.0 * surface.half_diagonal();
            write_link(&folder.join("source.ply"), &format!("../view_{source:02}.ply"))?;
            write_link(&folder.join("target.ply"), &format!("../view_{target:02}.ply"))?;
            fs::write(folder.join("gt.txt"), rows(&truth))?;
            fs::write(
                folder.join("meta.txt"),
                format!("exp=mv{deg}\nmodel={name}\nlevel={deg}\nseed={source}\ndiag={diagonal}\n"),
            )?;
            pair_count += 1;
        }
    }
    Ok(pair_count)
}

/// The camera 45 degrees above, 10 degrees on for each view, both a little off, as a robot and a hand-eye calibration
/// are that nobody has measured.
fn pose(view: u32, rng: &mut ChaCha8Rng) -> Isometry3<f64> {
    let mut off_rad = || (rng.random_range(-1.0..1.0) * ANGLE_OFF_DEG).to_radians();
    let azimuth = TAU * f64::from(view) / f64::from(AROUND_COUNT) + off_rad();
    let elevation = 45f64.to_radians() + off_rad();
    let roll = off_rad();
    let (sin, cos) = azimuth.sin_cos();
    let z = Vector3::new(cos * elevation.cos(), sin * elevation.cos(), elevation.sin());
    let x = Vector3::new(-sin, cos, 0.0);
    let axes = Rotation3::from_basis_unchecked(&[x, z.cross(&x), z]);
    let turn = UnitQuaternion::from_rotation_matrix(&axes.inverse());
    let shift = Vector3::from_fn(|_, _| rng.random_range(-2.5..2.5));
    Translation3::from(shift) * UnitQuaternion::from_axis_angle(&Vector3::z_axis(), roll) * turn
}

/// What the camera of `view_from_blade` measures, in the view's frame.
fn measured(
    surface: &Surface,
    view_from_blade: &Isometry3<f64>,
    point_count: usize,
    rng: &mut ChaCha8Rng,
) -> Vec<Point3<f64>> {
    let reach = surface.half_diagonal();
    let camera = Point3::new(0.0, 0.0, CAMERA_DISTANCE_DIAGONALS * 2.0 * reach);
    let blade_from_view = view_from_blade.inverse();
    let camera_in_blade = blade_from_view * camera;
    // A ray through a random place of the square across the axis that holds the whole blade.
    let cast = |rng: &mut ChaCha8Rng| -> Option<(Hit, Vector3<f64>)> {
        let across = Point3::new(
            rng.random_range(-1.1..1.1) * reach,
            rng.random_range(-1.1..1.1) * reach,
            0.0,
        );
        let ray = (across - camera).normalize();
        let hit = surface.hit(&camera_in_blade, &(blade_from_view * ray))?;
        let cosine = -(view_from_blade * hit.normal).dot(&ray);
        // The more grazing, the fewer points are measured.
        let measured = rng.random::<f64>() < (cosine / GRAZING_COSINE).min(1.0);
        measured.then(|| {
            let hit = Hit {
                point: view_from_blade * hit.point,
                ..hit
            };
            (hit, ray)
        })
    };
    let pilot = (0..PILOT_COUNT).filter(|_| cast(rng).is_some()).count();
    let ray_count = PILOT_COUNT * point_count / pilot.max(1);
    let hits: Vec<(Hit, Vector3<f64>)> = (0..ray_count).filter_map(|_| cast(rng)).collect();
    let holes: Vec<(Point3<f64>, f64)> = (0..HOLE_COUNT)
        .filter_map(|_| {
            let (hit, _) = hits.get(rng.random_range(0..hits.len().max(1) as u64) as usize)?;
            Some((hit.point, rng.random_range(0.005..0.02) * reach))
        })
        .collect();
    let mut points = Vec::with_capacity(hits.len());
    for (hit, ray) in hits {
        let is_lost = holes
            .iter()
            .any(|(middle, radius)| (hit.point - middle).norm() < *radius);
        let [along, x, y, z] = [(); 4].map(|()| normal(rng));
        let mut point = hit.point + ray * (ALONG_RAY_MM * along) + Vector3::new(x, y, z) * ISOTROPIC_MM;
        if rng.random::<f64>() < OUTLIER_FRACTION {
            point += ray * (rng.random_range(-1.0..1.0) * OUTLIER_REACH * reach);
        }
        if !is_lost {
            points.push(point);
        }
    }
    points
}

/// Views all around, 10 degrees apart.
pub(crate) const AROUND_COUNT: u32 = 36;
/// How far each angle of the camera is off at most.
const ANGLE_OFF_DEG: f64 = 3.0;
/// Distance of the camera over the blade's diagonal.
const CAMERA_DISTANCE_DIAGONALS: f64 = 4.0;
/// Below this cosine of the incidence points begin to be missing.
const GRAZING_COSINE: f64 = 0.3;
/// Points of a view, about.
pub(crate) const VIEW_POINT_COUNT: usize = 52_000;
/// Rays that tell how many are needed.
const PILOT_COUNT: usize = 20_000;
/// Noise along the ray.
const ALONG_RAY_MM: f64 = 0.02;
/// Noise along every axis.
const ISOTROPIC_MM: f64 = 0.005;
/// The share of points that lie anywhere along their ray.
const OUTLIER_FRACTION: f64 = 0.005;
/// How far they lie from the surface at most, over half the diagonal.
const OUTLIER_REACH: f64 = 0.3;
/// Round patches without points.
const HOLE_COUNT: usize = 12;
