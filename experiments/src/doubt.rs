//! How well the stated covariance among noise fits the errors: on points that repeat, and on other points of the surface.

use std::collections::BTreeMap;
use std::collections::btree_map::Entry;
use std::error::Error;
use std::io::Write;
use std::path::PathBuf;

use bladescan::geometry::PointCloud;
use bladescan::geometry::sampling::random_indices;
use bladescan::registration::{FineStage, Reference, Registration, Search, Settings, WeakDirections, register_from};
use clap::Args;
use nalgebra::{Isometry3, Point3, Vector3, Vector6};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;

use crate::cases;

/// Registers halves of each blade among noise, started near the truth, and compares the errors with the covariance.
#[derive(Args)]
pub(crate) struct DoubtArguments {
    /// Where the case folders are, at any depth: the first source of each model is the blade.
    root: PathBuf,
    /// How many pairs of each blade, kind and noise.
    #[arg(long, default_value_t = 10)]
    seeds: u64,
    /// The standard deviations of the noise, over the longest half extent of the blade as the cases have it.
    #[arg(long, value_delimiter = ',', default_values_t = [0.01, 0.02, 0.05, 0.1, 0.14])]
    sigmas: Vec<f64>,
}

#[derive(Clone, Copy, Debug)]
enum Kind {
    /// The reference repeats the template's points with noise.
    Same,
    /// The reference has the other half of the points, with noise.
    Other,
    /// As `Other`, and the template is as noisy.
    BothNoisy,
}

pub(crate) fn run(arguments: &DoubtArguments) -> Result<(), Box<dyn Error>> {
    let mut out = std::io::stdout().lock();
    let mut blades: BTreeMap<String, PointCloud> = BTreeMap::new();
    for case in cases::find(&arguments.root, None)? {
        let model = case.meta.get("model").cloned().unwrap_or_default();
        if let Entry::Vacant(first) = blades.entry(model) {
            first.insert(cases::cloud(&case.folder.join("source.ply"))?);
        }
    }
    writeln!(
        out,
        "{:<10} {:>6} {:>6} {:>12} {:>12} {:>12}  statuses",
        "points", "sigma", "pairs", "median rmse", "normalised", "its median"
    )?;
    for kind in [Kind::Same, Kind::Other, Kind::BothNoisy] {
        for &sigma in &arguments.sigmas {
            let (mut errors, mut normalised) = (Vec::new(), Vec::new());
            let mut statuses: BTreeMap<String, usize> = BTreeMap::new();
            for (blade, points) in blades.values().enumerate() {
                for seed in 0..arguments.seeds {
                    let mut rng = ChaCha8Rng::seed_from_u64(seed);
                    rng.set_stream(blade as u64);
                    let (rmse, square, status) = once(points.points(), kind, sigma, rng)?;
                    errors.push(rmse);
                    normalised.extend(square);
                    *statuses.entry(status).or_default() += 1;
                }
            }
            let mean = normalised.iter().sum::<f64>() / normalised.len() as f64;
            writeln!(
                out,
                "{:<10} {sigma:>6} {:>6} {:>12.6} {mean:>12.2} {:>12.2}  {statuses:?}",
                format!("{kind:?}"),
                errors.len(),
                cases::median(errors),
                cases::median(normalised),
            )?;
        }
    }
    Ok(())
}

/// Surface RMSE, the squared error in units of the covariance (6 in the mean when that is right), status.
fn once(
    points: &[Point3<f64>],
    kind: Kind,
    sigma: f64,
    mut rng: ChaCha8Rng,
) -> Result<(f64, Option<f64>, String), Box<dyn Error>> {
    let half = random_indices(points.len(), points.len() / 2, &mut rng);
    let mut first = vec![false; points.len()];
    for index in half {
        first[index] = true;
    }
    let part = |wanted: bool| -> Vec<Point3<f64>> {
        let chosen = points.iter().zip(&first).filter(|(_, first)| **first == wanted);
        chosen.map(|(point, _)| *point).collect()
    };
    let mut normal = || {
        let (u, v): (f64, f64) = (rng.random::<f64>().max(f64::MIN_POSITIVE), rng.random());
        (-2.0 * u.ln()).sqrt() * (std::f64::consts::TAU * v).cos()
    };
    let mut noisy = |points: Vec<Point3<f64>>| -> Vec<Point3<f64>> {
        let draw = |point: Point3<f64>| point + Vector3::from_fn(|_, _| sigma * normal());
        points.into_iter().map(draw).collect()
    };
    let truth = Isometry3::new(Vector3::new(0.3, -0.2, 0.4), Vector3::new(0.4, -0.3, 0.5));
    let reference = match kind {
        Kind::Same => noisy(part(true)),
        Kind::Other | Kind::BothNoisy => noisy(part(false)),
    };
    let template = match kind {
        Kind::Same | Kind::Other => part(true),
        Kind::BothNoisy => noisy(part(true)),
    };
    let reference: Vec<Point3<f64>> = reference.iter().map(|point| truth * point).collect();
    let template = PointCloud::from_measured(template).cloud;
    let settings = Settings {
        search: Search::Near,
        fine: FineStage::Pointwise,
        weak_directions: WeakDirections::Report,
        ..Settings::default()
    };
    let found = register_from(
        &template,
        &Reference::new(&PointCloud::from_measured(reference).cloud)?,
        &truth,
        &settings,
        rng,
        &mut |_| {},
    );
    let pose = &found.reference_from_template;
    let squared: f64 = template
        .points()
        .iter()
        .map(|point| (pose * point - truth * point).norm_squared())
        .sum();
    let rmse = (squared / template.len() as f64).sqrt();
    let square = normalised(&found, &truth, &template.centroid());
    Ok((rmse, square, format!("{:?}", found.status)))
}

/// The error as a motion about the template's centroid, squared in the metric of the stated covariance.
pub(crate) fn normalised(found: &Registration, truth: &Isometry3<f64>, centroid: &Point3<f64>) -> Option<f64> {
    let inverse = found.covariance?.try_inverse()?;
    let estimate = &found.reference_from_template;
    let turned = (estimate.rotation * truth.rotation.inverse()).scaled_axis();
    let shifted = estimate * centroid - truth * centroid;
    let error = Vector6::new(turned.x, turned.y, turned.z, shifted.x, shifted.y, shifted.z);
    Some((error.transpose() * inverse * error)[0])
}
