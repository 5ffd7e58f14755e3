//! Clouds far larger than a view: time by stage and the most memory that was held.

use std::error::Error;
use std::io::Write;
use std::time::Instant;

use bladescan::geometry::PointCloud;
use bladescan::registration::{Reference, Search, Settings, WeakDirections, register_from};
use bladescan::seed::{Seed, Stream};
use clap::Args;
use nalgebra::{Isometry3, Vector3};

use crate::bench::blade;

/// Registers two clouds of many points.
#[derive(Args)]
pub(crate) struct LargeArguments {
    /// Points of each cloud.
    #[arg(long, default_value_t = 10_000_000)]
    points: usize,
    /// Seeds the samples.
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

pub(crate) fn run(arguments: &LargeArguments) -> Result<(), Box<dyn Error>> {
    let mut out = std::io::stdout();
    let truth = Isometry3::new(Vector3::new(0.1, -0.1, 0.05), Vector3::new(0.1, 0.2, 0.3));
    let cloud = |phase, motion: &Isometry3<f64>| {
        PointCloud::from_measured(blade(arguments.points, phase).into_iter().map(|point| motion * point)).cloud
    };
    let template = cloud(0.0, &Isometry3::identity());
    let fixed = cloud(0.5, &truth);
    writeln!(
        out,
        "two clouds of {} points, {} threads, {} MiB before",
        arguments.points,
        rayon::current_num_threads(),
        peak_mib()?
    )?;
    let begun = Instant::now();
    let mut last = begun;
    let mut stage = |name: &str, iterations: u32| {
        let seconds = last.elapsed().as_secs_f64();
        last = Instant::now();
        writeln!(
            std::io::stdout(),
            "  {name:<10} {seconds:>8.2} s  {iterations} iterations"
        )
        .ok();
    };
    let reference = Reference::new(&fixed)?;
    stage("reference", 0);
    let settings = Settings {
        search: Search::Automatic,
        weak_directions: WeakDirections::Report,
        ..Settings::default()
    };
    let found = register_from(
        &template,
        &reference,
        &Isometry3::identity(),
        &settings,
        Seed(arguments.seed).stream(Stream::Sampling { view_index: 0 }),
        &mut |ended| stage(ended.name, ended.iterations),
    );
    let error = truth.inverse() * found.reference_from_template;
    writeln!(
        out,
        "  {:<10} {:>8.2} s  {:?}, overlap {:.3}, off by {:.2e} rad and {:.2e}; at most {} MiB",
        "all",
        begun.elapsed().as_secs_f64(),
        found.status,
        found.overlap.fraction,
        error.rotation.angle(),
        error.translation.vector.norm(),
        peak_mib()?
    )?;
    Ok(())
}

/// The most memory that this process has held, MiB, as Linux counts it.
fn peak_mib() -> Result<u64, Box<dyn Error>> {
    let status = std::fs::read_to_string("/proc/self/status")?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
    let kib = line.and_then(|line| line.split_whitespace().next()).ok_or("no VmHWM")?;
    Ok(kib.parse::<u64>()? / 1024)
}
