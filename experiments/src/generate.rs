//! Case sets with ground truth, of the kinds that registration is judged by, from any blade and any seed.
//!
//! The folders are those that [`crate::cases`] reads. The same arguments give the same bytes.

pub(crate) mod case_set;
mod mesh_file;
mod surface;
pub(crate) mod views;

use std::error::Error;
use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};

use bladescan::geometry::PointCloud;
use bladescan::geometry::nearest::NearestPoints;
use bladescan::geometry::ply::write_ply;
use clap::{Args, ValueEnum};
use hw_sim::blade::Builtin;
use nalgebra::{Isometry3, Point3, Translation3, Unit, UnitQuaternion, Vector3};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;

pub(crate) use self::surface::{Surface, extents};
use crate::kabsch::motion_between;

/// Writes case folders of one kind.
#[derive(Args)]
pub(crate) struct GenerateArguments {
    /// Where the case folders go; made if it is not there.
    pub(crate) out: PathBuf,
    /// What the cases ask for.
    #[arg(long)]
    pub(crate) kind: Kind,
    /// A built-in blade (lpt, hpt-a, hpt-b, hpt-c); may be given again [default: all four].
    #[arg(long, value_name = "NAME")]
    pub(crate) blade: Vec<String>,
    /// A closed mesh, STL or PLY; may be given again. Its longest side becomes z.
    #[arg(long, value_name = "FILE")]
    pub(crate) mesh: Vec<PathBuf>,
    /// Seeds everything drawn.
    #[arg(long, default_value_t = 1)]
    pub(crate) seed: u64,
    /// How many cases of each blade and level; of `views`, how many views [default: 2, 36 views].
    #[arg(long)]
    pub(crate) count: Option<u32>,
    /// Only this level, one of the kind's own.
    #[arg(long)]
    pub(crate) level: Option<String>,
}

#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum Kind {
    /// The same 3,000 points, Gaussian noise on the target.
    Noise,
    /// Uniform points added to the target.
    Outlier,
    /// Source and target sampled independently.
    Resample,
    /// Two single views, some degrees apart about z.
    Partial,
    /// Dense views in mm all around one blade, and the pairs that link them.
    Views,
}

pub(crate) fn run(arguments: &GenerateArguments) -> Result<(), Box<dyn Error>> {
    let mut blades = Vec::new();
    let names: Vec<&str> = match (arguments.blade.is_empty(), arguments.mesh.is_empty()) {
        (true, true) => Builtin::ALL.iter().map(|blade| blade.name()).collect(),
        _ => arguments.blade.iter().map(String::as_str).collect(),
    };
    for name in names {
        let blade = Builtin::from_name(name).ok_or_else(|| format!("`{name}` is not a built-in blade"))?;
        blades.push((name.to_owned(), Surface::of_builtin(blade)?));
    }
    for path in &arguments.mesh {
        let name = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        blades.push((name, Surface::of_file(path)?));
    }
    let mut case_count = 0;
    for (name, surface) in &blades {
        case_count += match arguments.kind {
            Kind::Views => {
                if blades.len() > 1 {
                    return Err("views go straight into OUT: give one blade or one mesh".into());
                }
                views::write(
                    &arguments.out,
                    name,
                    surface,
                    arguments.seed,
                    arguments.count.unwrap_or(36),
                )?
            }
            kind => write_cases(arguments, kind, name, surface)?,
        };
    }
    writeln!(
        std::io::stdout(),
        "{}: {case_count} cases, seed {}",
        arguments.out.display(),
        arguments.seed
    )?;
    Ok(())
}

/// Every level of one kind, each as often as asked for.
fn write_cases(
    arguments: &GenerateArguments,
    kind: Kind,
    name: &str,
    surface: &Surface,
) -> Result<u32, Box<dyn Error>> {
    let surface = surface.normalised();
    let mut case_count = 0;
    let levels: Vec<(String, f64)> = match kind {
        Kind::Noise => (1..=14)
            .map(|step| f64::from(step) / 100.0)
            .map(|sigma| (sigma.to_string(), sigma))
            .collect(),
        Kind::Outlier => [200, 950, 2000, 2800]
            .map(|count| (count.to_string(), f64::from(count)))
            .into(),
        Kind::Resample => vec![("0.01".to_owned(), 0.01)],
        Kind::Partial | Kind::Views => [10, 30, 60, 90].map(|deg| (deg.to_string(), f64::from(deg))).into(),
    };
    for (level, value) in levels {
        if arguments.level.as_ref().is_some_and(|only| *only != level) {
            continue;
        }
        for index in 0..arguments.count.unwrap_or(2) {
            let (exp, letter) = match kind {
                Kind::Noise => ("noise", "s"),
                Kind::Outlier => ("outlier", "k"),
                Kind::Resample => ("resample", ""),
                Kind::Partial | Kind::Views => ("partial", "g"),
            };
            let mut rng = stream(arguments.seed, &format!("{exp} {name} {level} {index}"));
            let truth = motion(&mut rng);
            let (source, target) = match kind {
                Kind::Noise => {
                    let pair = repeated(&surface, POINT_COUNT, &truth, value, 0, &mut rng);
                    (pair.source, pair.target)
                }
                Kind::Outlier => {
                    let pair = repeated(&surface, POINT_COUNT, &truth, OUTLIER_SIGMA, value as usize, &mut rng);
                    (pair.source, pair.target)
                }
                Kind::Resample => {
                    let source = surface.sample(POINT_COUNT, &mut rng);
                    let other = surface.sample(POINT_COUNT, &mut rng);
                    (source, noisy(&moved(&other, &truth), value, &mut rng))
                }
                Kind::Partial | Kind::Views => {
                    let azimuth = rng.random_range(0.0..std::f64::consts::TAU);
                    let mut seen = |azimuth: f64| {
                        let points = surface.sample_seen_from(&camera(azimuth), POINT_COUNT, &mut rng)?;
                        Ok::<_, Box<dyn Error>>(noisy(&points, PARTIAL_SIGMA, &mut rng))
                    };
                    let source = seen(azimuth)?;
                    let target = seen(azimuth + value.to_radians())?;
                    (source, moved(&target, &truth))
                }
            };
            let mut meta = format!("exp={exp}\nmodel={name}\nlevel={level}\nseed={index}\n");
            if kind == Kind::Partial {
                let share = share_within(&moved(&source, &truth), &target, OVERLAP_DISTANCE);
                meta += &format!("overlap={share:.3}\n");
            }
            let folder = match kind {
                Kind::Resample => format!("{name}_{index}"),
                _ => format!("{name}_{letter}{level}_{index}"),
            };
            let folder = arguments.out.join(folder);
            fs::create_dir_all(&folder)?;
            fs::write(folder.join("source.ply"), as_ply(source))?;
            fs::write(folder.join("target.ply"), as_ply(target))?;
            fs::write(folder.join("gt.txt"), rows(&truth))?;
            fs::write(folder.join("meta.txt"), meta)?;
            case_count += 1;
        }
    }
    Ok(case_count)
}

/// Two clouds of a normalised blade of which the second repeats the first one's points.
pub(crate) struct Repeated {
    pub(crate) source: Vec<Point3<f64>>,
    /// The source moved, with noise, in another order, and outliers after it.
    pub(crate) target: Vec<Point3<f64>>,
    /// What the known correspondences give, target_from_source.
    pub(crate) known: Isometry3<f64>,
}

impl Repeated {
    /// Source and target.
    pub(crate) fn into_clouds(self) -> (PointCloud, PointCloud) {
        let cloud = |points| PointCloud::from_measured(points).cloud;
        (cloud(self.source), cloud(self.target))
    }
}

/// Draws `point_count` points of `surface`, and moves them with noise of `sigma` and outliers in the enclosing cube.
pub(crate) fn repeated(
    surface: &Surface,
    point_count: usize,
    truth: &Isometry3<f64>,
    sigma: f64,
    outlier_count: usize,
    rng: &mut ChaCha8Rng,
) -> Repeated {
    let source = surface.sample(point_count, rng);
    let in_order = noisy(&moved(&source, truth), sigma, rng);
    let known = motion_between(&source, &in_order);
    let mut target = shuffled(in_order, rng);
    let extra = in_enclosing_cube(&target, outlier_count, rng);
    target.extend(extra);
    Repeated { source, target, known }
}

/// The stream of one case: the seed, and the case's name as the stream's number (FNV-1a).
pub(crate) fn stream(seed: u64, name: &str) -> ChaCha8Rng {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    rng.set_stream(name.bytes().fold(0xcbf2_9ce4_8422_2325, |hash: u64, byte| {
        (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3)
    }));
    rng
}

/// A turn of 0 to 90 degrees about an axis drawn evenly, and a shift of at most 0.5 along each axis.
pub(crate) fn motion(rng: &mut ChaCha8Rng) -> Isometry3<f64> {
    let angle = rng.random_range(0.0..std::f64::consts::FRAC_PI_2);
    let axis = Unit::new_normalize(Vector3::from_fn(|_, _| normal(rng)));
    let shift = Vector3::from_fn(|_, _| rng.random_range(-0.5..0.5));
    Isometry3::from_parts(Translation3::from(shift), UnitQuaternion::from_axis_angle(&axis, angle))
}

/// A standard normal number (Box and Muller, 1958).
pub(crate) fn normal(rng: &mut ChaCha8Rng) -> f64 {
    let (u, v): (f64, f64) = (rng.random(), rng.random());
    (-2.0 * (1.0 - u).ln()).sqrt() * (std::f64::consts::TAU * v).cos()
}

pub(crate) fn noisy(points: &[Point3<f64>], sigma: f64, rng: &mut ChaCha8Rng) -> Vec<Point3<f64>> {
    points
        .iter()
        .map(|point| point + Vector3::from_fn(|_, _| sigma * normal(rng)))
        .collect()
}

pub(crate) fn moved(points: &[Point3<f64>], pose: &Isometry3<f64>) -> Vec<Point3<f64>> {
    points.iter().map(|point| pose * point).collect()
}

fn shuffled(mut points: Vec<Point3<f64>>, rng: &mut ChaCha8Rng) -> Vec<Point3<f64>> {
    for index in (1..points.len()).rev() {
        points.swap(index, rng.random_range(0..=index as u64) as usize);
    }
    points
}

/// Points drawn evenly from the cube about the middle of the points' box, as wide as its longest side.
fn in_enclosing_cube(points: &[Point3<f64>], count: usize, rng: &mut ChaCha8Rng) -> Vec<Point3<f64>> {
    let (low, high) = extents(points);
    let half = (high - low).max() / 2.0;
    let middle = nalgebra::center(&low, &high);
    (0..count)
        .map(|_| middle + Vector3::from_fn(|_, _| rng.random_range(-half..half)))
        .collect()
}

/// A camera 45 degrees above the middle of a normalised blade.
fn camera(azimuth_rad: f64) -> Point3<f64> {
    let (sin, cos) = azimuth_rad.sin_cos();
    Point3::from(Vector3::new(cos, sin, 1.0).normalize() * CAMERA_DISTANCE)
}

/// The share of `points` that have a point of `others` within `distance`.
fn share_within(points: &[Point3<f64>], others: &[Point3<f64>], distance: f64) -> f64 {
    let tree = NearestPoints::new(others);
    let near = points
        .iter()
        .filter(|point| tree.nearest_within(point, distance).is_some());
    near.count() as f64 / points.len().max(1) as f64
}

fn as_ply(points: Vec<Point3<f64>>) -> Vec<u8> {
    write_ply(&PointCloud::from_measured(points).cloud, &[])
}

/// A motion as `gt.txt` has it.
fn rows(motion: &Isometry3<f64>) -> String {
    let row = |row: [f64; 4]| row.map(|value| format!("{value:.17e}")).join(" ") + "\n";
    bladescan::geometry::matrix_rows(motion).map(row).concat()
}

fn write_link(path: &Path, target: &str) -> std::io::Result<()> {
    fs::write(path, target)
}

/// Points of a cloud of every kind but `views`.
pub(crate) const POINT_COUNT: usize = 3000;
/// Noise of the points that outliers are added to, over the blade's half length.
pub(crate) const OUTLIER_SIGMA: f64 = 0.005;
/// Noise of a single view, over the blade's half length.
const PARTIAL_SIGMA: f64 = 0.002;
/// Points nearer than this, over the blade's half length, overlap: one and a half times the spacing of 3,000 points.
const OVERLAP_DISTANCE: f64 = 0.04;
/// How far a single view's camera is away, over the blade's half length.
const CAMERA_DISTANCE: f64 = 6.0;
