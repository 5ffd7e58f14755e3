//! Pairwise registration from the identity, on cases with ground truth.

use std::collections::BTreeMap;
use std::error::Error;
use std::fs;
use std::io::Write;
use std::path::PathBuf;
use std::time::Instant;

use bladescan::registration::{Reference, Search, Settings, WeakDirections, register};
use bladescan::seed::{Seed, Stream};
use clap::Args;
use nalgebra::Isometry3;

use crate::cases::{self, Errors};

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
        } else {
            Search::Near
        },
        ..Settings::default()
    };
    let mut groups: BTreeMap<String, Vec<(Errors, f64)>> = BTreeMap::new();
    for case in &cases {
        let source = cases::cloud(&case.folder.join("source.ply"))?;
        let target = cases::cloud(&case.folder.join("target.ply"))?;
        let begun = Instant::now();
        let reference = Reference::new(&target)?;
        let mut times = vec![("reference", 0, begun.elapsed().as_secs_f64())];
        let mut last = Instant::now();
        let found = register(
            &source,
            &reference,
            &Isometry3::identity(),
            &settings,
            Seed(arguments.seed).stream(Stream::Sampling { view_index: 0 }),
            &mut |stage| {
                times.push((stage.name, stage.iterations, last.elapsed().as_secs_f64()));
                last = Instant::now();
            },
        );
        let seconds = begun.elapsed().as_secs_f64();
        let errors = cases::errors(case, &source, &found.reference_from_template);
        let relative = case.folder.strip_prefix(&arguments.root)?;
        if let Some(folder) = &arguments.out {
            let path = folder.join(format!("{}.txt", relative.display()));
            fs::create_dir_all(path.parent().unwrap_or(folder))?;
            let matrix = found.reference_from_template.to_homogeneous().transpose();
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
                "{} {} {:?} rot {:.5} trans {:.5} rmse {:.5} overlap {:.3} fuzziness {:.2} weak {:?} [{}]",
                relative.display(),
                if errors.success { "ok" } else { "FAIL" },
                found.status,
                errors.rotation_deg,
                errors.translation,
                errors.rmse,
                found.overlap.fraction,
                reference.roughness().fuzziness,
                found.weak_directions.iter().map(|weak| weak.sigma).collect::<Vec<_>>(),
                stages.join(", "),
            )?;
        }
        let key = |name: &str| case.meta.get(name).cloned().unwrap_or_default();
        groups
            .entry(format!("{} {} {}", key("exp"), key("model"), key("level")))
            .or_default()
            .push((errors, seconds));
    }
    writeln!(
        out,
        "{:<28} {:>6} {:>9} {:>12} {:>12} {:>12} {:>9}",
        "group", "cases", "success", "median deg", "median trans", "median rmse", "median s"
    )?;
    for (name, results) in groups {
        let successes = results.iter().filter(|(errors, _)| errors.success).count();
        let of = |value: fn(&(Errors, f64)) -> f64| cases::median(results.iter().map(value).collect());
        writeln!(
            out,
            "{name:<28} {:>6} {:>8.1}% {:>12.5} {:>12.5} {:>12.5} {:>9.3}",
            results.len(),
            100.0 * successes as f64 / results.len() as f64,
            of(|(errors, _)| errors.rotation_deg),
            of(|(errors, _)| errors.translation),
            of(|(errors, _)| errors.rmse),
            of(|(_, seconds)| *seconds),
        )?;
    }
    Ok(())
}
