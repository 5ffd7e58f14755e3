//! Pairwise registration from the identity, on cases with ground truth.

use std::collections::BTreeMap;
use std::error::Error;
use std::fs;
use std::io::Write;
use std::path::PathBuf;
use std::time::Instant;

use bladescan::geometry::PointCloud;
use bladescan::registration::{Reference, Registration, Search, Settings, Status, WeakDirections, register_from};
use bladescan::seed::{Seed, Stream};
use clap::Args;
use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion, Vector3};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use rayon::{ThreadPool, ThreadPoolBuilder};

use crate::bound::{self, NoiseArguments};
use crate::cases::{self, Errors};
use crate::kabsch;

/// Registers every case folder under a root from the identity.
#[derive(Args)]
pub(crate) struct PairsArguments {
    /// Where the case folders are, at any depth.
    root: PathBuf,
    /// Only cases of this level, as `meta.txt` names it.
    #[arg(long)]
    level: Option<String>,
    /// Where to write one estimate a case: `<out>/<case>.txt`, 16 numbers and the seconds.
    #[arg(long)]
    out: Option<PathBuf>,
    /// Searches all rotations instead of the neighbourhood of the identity.
    #[arg(long)]
    everywhere: bool,
    /// Searches all rotations when the neighbourhood of the identity does not explain the clouds.
    #[arg(long, conflicts_with = "everywhere")]
    automatic: bool,
    /// Starts from the truth: what fails then fails by the judgement, not by the search.
    #[arg(long)]
    from_truth: bool,
    /// Turns every source at random (all of SO(3), about its centroid) and shifts it by up to its radius before it is
    /// registered; this seeds the draws. Scored in the case's own frame.
    #[arg(long, value_name = "SEED")]
    turned: Option<u64>,
    /// Registers every case once with each of these numbers of threads and says how many cases give the same bits.
    #[arg(long, value_name = "N,N,...", value_delimiter = ',')]
    threads: Vec<usize>,
    /// Prints the ratio of the errors to those of the known correspondences, for cases whose points repeat.
    #[arg(long)]
    kabsch: bool,
    /// Compares each error with the Cramer-Rao bound of its case: the median over a group, and the root mean square over
    /// its successes.
    #[arg(long)]
    bound: bool,
    #[command(flatten)]
    noise: NoiseArguments,
    /// Prints a line for every case, with the stages.
    #[arg(long)]
    verbose: bool,
    /// Seeds the samples.
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

pub(crate) fn run(arguments: &PairsArguments) -> Result<(), Box<dyn Error>> {
    let mut out = std::io::stdout().lock();
    let cases = cases::find(&arguments.root, arguments.level.as_deref())?;
    let settings = Settings {
        weak_directions: WeakDirections::Report,
        search: if arguments.everywhere {
            Search::Everywhere
        } else if arguments.automatic {
            Search::Automatic
        } else {
            Search::Near
        },
        ..Settings::default()
    };
    let pools = arguments
        .threads
        .iter()
        .map(|count| ThreadPoolBuilder::new().num_threads(*count).build())
        .collect::<Result<Vec<_>, _>>()?;
    let mut same_count = 0;
    let mut groups: BTreeMap<String, Vec<Outcome>> = BTreeMap::new();
    let mut known = kabsch::Table::default();
    for (index, case) in cases.iter().enumerate() {
        let source = cases::cloud(&case.folder.join("source.ply"))?;
        let turn = arguments
            .turned
            .map_or_else(Isometry3::identity, |seed| turn(&source, seed, index as u64));
        let turned = source.transformed(&turn);
        let start = if arguments.from_truth {
            cases::isometry(&case.truth) * turn.inverse()
        } else {
            Isometry3::identity()
        };
        let target = cases::cloud(&case.folder.join("target.ply"))?;
        let stream = || Seed(arguments.seed).stream(Stream::Sampling { view_index: 0 });
        if !pools.is_empty() {
            let is_same = same_bits(&pools, || {
                let reference = Reference::new(&target).ok()?;
                Some(register_from(
                    &turned,
                    &reference,
                    &start,
                    &settings,
                    stream(),
                    &mut |_| {},
                ))
            });
            same_count += usize::from(is_same);
            if !is_same {
                writeln!(out, "{}: the bits differ", case.folder.display())?;
            }
        }
        let begun = Instant::now();
        let reference = Reference::new(&target)?;
        let mut times = vec![("reference", 0, begun.elapsed().as_secs_f64())];
        let mut last = Instant::now();
        let found = register_from(&turned, &reference, &start, &settings, stream(), &mut |stage| {
            times.push((stage.name, stage.iterations, last.elapsed().as_secs_f64()));
            last = Instant::now();
        });
        let seconds = begun.elapsed().as_secs_f64();
        let estimate = found.reference_from_template * turn;
        let errors = cases::errors(case, &source, &estimate);
        known.add(case, &source, &target, &turn, &found);
        let over_bound = if arguments.bound {
            errors.rmse / bound::of(case, &source, &target, &arguments.noise)?.rmse
        } else {
            f64::NAN
        };
        let relative = case.folder.strip_prefix(&arguments.root)?;
        if let Some(folder) = &arguments.out {
            let path = folder.join(format!("{}.txt", relative.display()));
            fs::create_dir_all(path.parent().unwrap_or(folder))?;
            let matrix = estimate.to_homogeneous().transpose();
            let numbers: Vec<String> = matrix.iter().map(|value| format!("{value:.17e}")).collect();
            fs::write(path, format!("{} {seconds}\n", numbers.join(" ")))?;
        }
        if arguments.verbose {
            let stages: Vec<String> = times
                .iter()
                .map(|(name, iterations, seconds)| format!("{name} {iterations} {:.0}ms", seconds * 1e3))
                .collect();
            writeln!(
                out,
                "{} {} {:?} rot {:.5} trans {:.5} rmse {:.5} over bound {over_bound:.2} overlap {:.3} fuzziness {:.2} oriented {} weak {:?} [{}]",
                relative.display(),
                if errors.success { "ok" } else { "FAIL" },
                found.status,
                errors.rotation_deg,
                errors.translation,
                errors.rmse,
                found.overlap.fraction,
                reference.roughness().fuzziness,
                reference.is_oriented(),
                found.weak_directions.iter().map(|weak| weak.sigma).collect::<Vec<_>>(),
                stages.join(", "),
            )?;
        }
        groups.entry(case.group()).or_default().push(Outcome {
            errors,
            over_bound,
            seconds,
            status: found.status,
        });
    }
    writeln!(
        out,
        "{:<28} {:>6} {:>9} {:>12} {:>12} {:>12} {:>9} {:>7} {:>6} {:>12} {:>9}",
        "group",
        "cases",
        "success",
        "median deg",
        "median trans",
        "median rmse",
        "median s",
        "worst s",
        "silent",
        "median/bound",
        "rms/bound"
    )?;
    let mut all = (0, 0, 0, 0);
    for (name, results) in groups {
        let successes = results.iter().filter(|outcome| outcome.errors.success).count();
        let silent = results.iter().filter(|outcome| outcome.is_silently_wrong()).count();
        let sure = results
            .iter()
            .filter(|outcome| outcome.status == Status::Converged)
            .count();
        all = (all.0 + results.len(), all.1 + successes, all.2 + sure, all.3 + silent);
        let of = |value: fn(&Outcome) -> f64| cases::median(results.iter().map(value).collect());
        writeln!(
            out,
            "{name:<28} {:>6} {:>8.1}% {:>12.5} {:>12.5} {:>12.5} {:>9.3} {:>7.3} {silent:>6} {:>12.2} {:>9.2}",
            results.len(),
            100.0 * successes as f64 / results.len() as f64,
            of(|outcome| outcome.errors.rotation_deg),
            of(|outcome| outcome.errors.translation),
            of(|outcome| outcome.errors.rmse),
            of(|outcome| outcome.seconds),
            results.iter().map(|outcome| outcome.seconds).fold(0.0, f64::max),
            of(|outcome| outcome.over_bound),
            root_mean_square(
                results
                    .iter()
                    .filter(|outcome| outcome.errors.success)
                    .map(|outcome| outcome.over_bound)
            ),
        )?;
    }
    writeln!(
        out,
        "all: {} cases, {} right, {} converged, {} converged but wrong",
        all.0, all.1, all.2, all.3
    )?;
    if !pools.is_empty() {
        let counts: Vec<String> = arguments.threads.iter().map(usize::to_string).collect();
        writeln!(
            out,
            "same bits at {} threads: {same_count} of {}",
            counts.join(", "),
            cases.len()
        )?;
    }
    if arguments.kabsch {
        known.print(&mut out)?;
    }
    Ok(())
}

/// Whether `work` gives the same bits in every pool. The shortest decimals that read back as the same number tell two
/// numbers apart whenever their bits differ.
fn same_bits(pools: &[ThreadPool], work: impl Fn() -> Option<Registration> + Sync) -> bool {
    let outcomes: Vec<String> = pools.iter().map(|pool| format!("{:?}", pool.install(&work))).collect();
    outcomes.windows(2).all(|pair| pair[0] == pair[1])
}

struct Outcome {
    errors: Errors,
    over_bound: f64,
    seconds: f64,
    status: Status,
}

impl Outcome {
    fn is_silently_wrong(&self) -> bool {
        self.status == Status::Converged && !self.errors.success
    }
}

fn root_mean_square(values: impl Iterator<Item = f64>) -> f64 {
    let (sum, count) = values.fold((0.0, 0), |(sum, count), value| (sum + value * value, count + 1));
    (sum / f64::from(count.max(1))).sqrt()
}

/// A rotation drawn evenly from SO(3) about the cloud's centroid, and a shift of at most the cloud's radius each way.
fn turn(cloud: &PointCloud, seed: u64, stream: u64) -> Isometry3<f64> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    rng.set_stream(stream);
    let mut quaternion = Quaternion::identity() * 2.0;
    // Even over the ball, and so over directions: at most a few dozen draws in any likelihood.
    while quaternion.norm() > 1.0 {
        let mut draw = || 2.0 * rng.random::<f64>() - 1.0;
        quaternion = Quaternion::new(draw(), draw(), draw(), draw());
    }
    let centroid = cloud.centroid();
    let squared: f64 = cloud
        .points()
        .iter()
        .map(|point| (point - centroid).norm_squared())
        .sum();
    let radius = (squared / cloud.len().max(1) as f64).sqrt();
    let mut draw = || (2.0 * rng.random::<f64>() - 1.0) * radius;
    let shift = Vector3::new(draw(), draw(), draw());
    Translation3::from(centroid.coords + shift)
        * UnitQuaternion::from_quaternion(quaternion)
        * Translation3::from(-centroid.coords)
}
