//! MPE by formulation, stride rule and softening schedule, side by side.

use std::error::Error;
use std::io::Write;
use std::path::PathBuf;
use std::time::Instant;

use bladescan::geometry::sampling::random_indices;
use bladescan::geometry::statistics::mean;
use bladescan::registration::mpe::descend;
use bladescan::registration::{Formulation, Halving, MpeSettings, Stop, Stride};
use clap::Args;
use nalgebra::{Isometry3, Point3, Translation3, Unit, UnitQuaternion, Vector3};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;

use crate::cases;

/// Lets samples of each blade fall into other samples of it that are turned and shifted.
#[derive(Args)]
pub(crate) struct MpeArguments {
    /// Where the case folders are, at any depth: the first source of each model is the blade.
    root: PathBuf,
    /// How many falls of each blade.
    #[arg(long, default_value_t = 20)]
    seeds: u64,
    /// Points of each sample.
    #[arg(long, default_value_t = 500)]
    points: usize,
    /// Noise on the reference, over the blade's root mean square radius.
    #[arg(long, default_value_t = 0.02)]
    noise: f64,
    /// The largest turn about any axis, in degrees.
    #[arg(long, default_value_t = 90.0)]
    turn_deg: f64,
}

struct Fall {
    template: Vec<Point3<f64>>,
    reference: Vec<Point3<f64>>,
    truth: Isometry3<f64>,
    radius: f64,
}

pub(crate) fn run(arguments: &MpeArguments) -> Result<(), Box<dyn Error>> {
    let mut out = std::io::stdout().lock();
    let mut blades: Vec<(String, Vec<Point3<f64>>)> = Vec::new();
    for case in cases::find(&arguments.root, None)? {
        let model = case.meta.get("model").cloned().unwrap_or_default();
        if blades.iter().all(|(name, _)| *name != model) {
            let cloud = cases::cloud(&case.folder.join("source.ply"))?;
            blades.push((model, cloud.points().to_vec()));
        }
    }
    let falls: Vec<Fall> = blades
        .iter()
        .enumerate()
        .flat_map(|(index, (_, points))| {
            (0..arguments.seeds).map(move |seed| fall(points, index as u64, seed, arguments))
        })
        .collect();
    writeln!(
        out,
        "{} falls: {} points, noise {} of the radius, turned by up to {} degrees, shifted by up to half a radius an axis",
        falls.len(),
        arguments.points,
        arguments.noise,
        arguments.turn_deg
    )?;
    writeln!(
        out,
        "{:<44} {:>8} {:>8} {:>10} {:>10} {:>10} {:>10}",
        "rule", "success", "sums", "deg", "shift", "energy", "ms"
    )?;
    for (name, settings) in rules() {
        line(&mut out, &falls, &name, &settings)?;
    }
    for factors in [
        [0.03, 0.03],
        [0.15, 0.15],
        [0.5, 0.03],
        [0.3, 0.03],
        [0.15, 0.03],
        [0.15, 0.06],
        [0.08, 0.03],
    ] {
        for stride in [Stride::Halving, Stride::QuasiNewton] {
            let settings = MpeSettings {
                softening_factors: factors,
                stride,
                ..MpeSettings::default()
            };
            line(
                &mut out,
                &falls,
                &format!("softening {factors:?}, {stride:?}"),
                &settings,
            )?;
        }
    }
    Ok(())
}

fn rules() -> Vec<(String, MpeSettings)> {
    let default = MpeSettings {
        stride: Stride::Halving,
        ..MpeSettings::default()
    };
    let mut rules = Vec::new();
    for formulation in [Formulation::Literal, Formulation::RigidBody] {
        for (halving, stop) in [
            (Halving::Nested, Stop::Either),
            (Halving::Independent, Stop::Either),
            (Halving::Independent, Stop::Both),
        ] {
            let settings = MpeSettings {
                formulation,
                halving,
                stop,
                ..default
            };
            rules.push((format!("{formulation:?}, {halving:?}, {stop:?}"), settings));
        }
    }
    for stride in [Stride::LineSearch, Stride::Momentum, Stride::QuasiNewton] {
        rules.push((format!("RigidBody, {stride:?}"), MpeSettings { stride, ..default }));
    }
    rules
}

fn line(out: &mut dyn Write, falls: &[Fall], name: &str, settings: &MpeSettings) -> Result<(), Box<dyn Error>> {
    let (mut successes, mut sums, mut turns, mut shifts) = (0, 0, Vec::new(), Vec::new());
    let (mut energies, mut seconds) = (Vec::new(), 0.0);
    for fall in falls {
        let begun = Instant::now();
        let ended = descend(&fall.template, &fall.reference, &Isometry3::identity(), settings);
        seconds += begun.elapsed().as_secs_f64();
        let error = fall.truth.inverse() * ended.reference_from_template;
        let turn = error.rotation.angle().to_degrees();
        let shift = error.translation.vector.norm() / fall.radius;
        // What is looked for is the basin of what comes after.
        if turn < SUCCESS_DEG && shift < SUCCESS_SHIFT {
            successes += 1;
            turns.push(turn);
            shifts.push(shift);
            // The criterion at the default's sharp softening, over its value where the blade truly is.
            energies.push(energy(fall, &ended.reference_from_template) / energy(fall, &fall.truth));
        }
        sums += ended.iterations;
    }
    let count = falls.len() as f64;
    writeln!(
        out,
        "{name:<44} {:>7.1}% {:>8.1} {:>10.3} {:>10.4} {:>10.4} {:>10.2}",
        100.0 * f64::from(successes) / count,
        f64::from(sums) / count,
        cases::median(turns),
        cases::median(shifts),
        cases::median(energies),
        1e3 * seconds / count,
    )?;
    Ok(())
}

fn energy(fall: &Fall, pose: &Isometry3<f64>) -> f64 {
    let settings = MpeSettings {
        softening_factors: [MpeSettings::default().softening_factors[1]; 2],
        stride: Stride::Halving,
        iteration_max_count: 1,
        ..MpeSettings::default()
    };
    descend(&fall.template, &fall.reference, pose, &settings).energy
}

/// Two independent samples of a blade, the second one moved and noisy.
fn fall(points: &[Point3<f64>], blade: u64, seed: u64, arguments: &MpeArguments) -> Fall {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    rng.set_stream(blade);
    let template: Vec<Point3<f64>> = random_indices(points.len(), arguments.points, &mut rng)
        .into_iter()
        .map(|index| points[index])
        .collect();
    let centroid = mean(points).coords;
    let squared: f64 = points
        .iter()
        .map(|point| (point.coords - centroid).norm_squared())
        .sum();
    let radius = (squared / points.len().max(1) as f64).sqrt();
    let mut normal = || {
        let (u, v): (f64, f64) = (rng.random::<f64>().max(f64::MIN_POSITIVE), rng.random());
        (-2.0 * u.ln()).sqrt() * (std::f64::consts::TAU * v).cos()
    };
    let axis = Unit::new_normalize(Vector3::from_fn(|_, _| normal()));
    let mut noise: Vec<Vector3<f64>> = Vec::with_capacity(arguments.points);
    for _ in 0..arguments.points {
        noise.push(Vector3::from_fn(|_, _| arguments.noise * radius * normal()));
    }
    let angle = rng.random::<f64>() * arguments.turn_deg.to_radians();
    let shift = Vector3::from_fn(|_, _| (rng.random::<f64>() - 0.5) * radius);
    let truth = Translation3::from(shift) * UnitQuaternion::from_axis_angle(&axis, angle);
    let reference = random_indices(points.len(), arguments.points, &mut rng)
        .into_iter()
        .zip(&noise)
        .map(|(index, noise)| truth * points[index] + noise)
        .collect();
    Fall {
        template,
        reference,
        truth,
        radius,
    }
}

/// Nearer than this the fine stages find the rest.
const SUCCESS_DEG: f64 = 10.0;
/// Over the radius.
const SUCCESS_SHIFT: f64 = 0.15;
