//! `bladescan register`: one cloud to another.

use super::{Exit, Failure, print};
use crate::geometry::{Measured, PointCloud, isometry_from_rows, matrix_rows, read_cloud};
use crate::registration::{Reference, Registration, Search, Settings, Stage, Status, WeakDirections, register};
use crate::seed::{Seed, Stream};
use nalgebra::Isometry3;
use serde_json::{Value, json};
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::time::Instant;

#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// The cloud that moves: PLY (ascii or binary), PCD (ascii or binary) or XYZ.
    template: PathBuf,
    /// The cloud that stays.
    reference: PathBuf,
    /// Start: 16 numbers, 4x4 row-major, reference_from_template [default: the identity, and any other when that
    /// does not explain the clouds].
    #[arg(long, value_name = "T.txt")]
    init: Option<PathBuf>,
    /// Seeds the samples.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Print one JSON document.
    #[arg(long)]
    json: bool,
}

pub(super) fn main(args: &Args) -> Result<Exit, Failure> {
    let template = read(&args.template)?;
    let reference = read(&args.reference)?;
    let start = match &args.init {
        Some(path) => read_motion(path)?,
        None => Isometry3::identity(),
    };
    let began = Instant::now();
    let mut last = began;
    let mut stages = Vec::new();
    let prepared =
        Reference::new(&reference).map_err(|error| Failure::Usage(format!("{}: {error}", args.reference.display())))?;
    if template.len() < crate::registration::POINT_MIN_COUNT {
        return Err(Failure::Usage(format!(
            "{}: {} points are too few to register, at least {} are needed",
            args.template.display(),
            template.len(),
            crate::registration::POINT_MIN_COUNT
        )));
    }
    let mut on_stage = |stage: &Stage| {
        let now = Instant::now();
        stages.push(json!({
            "name": stage.name,
            "iterations": stage.iterations,
            "seconds": (now - last).as_secs_f64(),
        }));
        last = now;
    };
    let settings = Settings {
        weak_directions: match args.init {
            // A given start is a measurement; the identity is only a guess.
            Some(_) => WeakDirections::Hold,
            None => WeakDirections::Report,
        },
        search: match args.init {
            Some(_) => Search::Near,
            None => Search::Automatic,
        },
        ..Settings::default()
    };
    let stream = Seed(args.seed).stream(Stream::Sampling { view_index: 0 });
    let found = register(&template, &prepared, &start, &settings, stream, &mut on_stage);
    let seconds = began.elapsed().as_secs_f64();
    if args.json {
        print(&as_json(&found, &stages, seconds).to_string())?;
    } else {
        print(&as_text(&found, seconds))?;
    }
    Ok(match found.status {
        Status::Converged => Exit::Done,
        Status::Ambiguous | Status::Weak | Status::Failed => Exit::Short,
    })
}

fn status_name(status: Status) -> &'static str {
    match status {
        Status::Converged => "converged",
        Status::Ambiguous => "ambiguous",
        Status::Weak => "weak",
        Status::Failed => "failed",
    }
}

fn as_json(found: &Registration, stages: &[Value], seconds: f64) -> Value {
    let covariance = found.covariance.map(|matrix| {
        (0..6)
            .map(|row| (0..6).map(|column| matrix[(row, column)]).collect::<Vec<f64>>())
            .collect::<Vec<_>>()
    });
    let weak_directions: Vec<Value> = found
        .weak_directions
        .iter()
        // JSON has no infinity: a direction the data say nothing about has a null sigma.
        .map(|weak| json!({ "direction": weak.direction, "sigma": weak.sigma.is_finite().then_some(weak.sigma) }))
        .collect();
    json!({
        "reference_from_template": matrix_rows(&found.reference_from_template),
        "status": status_name(found.status),
        "overlap": { "count": found.overlap.count, "fraction": found.overlap.fraction },
        "rmse": found.rmse,
        "covariance": covariance,
        "weak_directions": weak_directions,
        "stages": stages,
        "seconds": seconds,
    })
}

fn as_text(found: &Registration, seconds: f64) -> String {
    let rows = matrix_rows(&found.reference_from_template)
        .map(|row| row.map(|value| format!("{value:15.9}")).join(" "))
        .join("\n");
    format!(
        "{rows}\n{}: overlap {:.3} ({} points), residual {:.6}, {} weak directions, {seconds:.3} s",
        status_name(found.status),
        found.overlap.fraction,
        found.overlap.count,
        found.rmse,
        found.weak_directions.len()
    )
}

fn read(path: &Path) -> Result<PointCloud, Failure> {
    let bytes = std::fs::read(path).map_err(|source| Failure::Read {
        path: path.to_owned(),
        source,
    })?;
    let Measured { cloud, dropped_count } = read_cloud(&path.display().to_string(), &bytes)
        .map_err(|error| Failure::Usage(format!("{}: {error}", path.display())))?;
    if dropped_count > 0 {
        writeln!(
            std::io::stderr(),
            "{}: {dropped_count} points that are not finite were dropped",
            path.display()
        )
        .ok();
    }
    Ok(cloud)
}

fn read_motion(path: &Path) -> Result<Isometry3<f64>, Failure> {
    let text = std::fs::read_to_string(path).map_err(|source| Failure::Read {
        path: path.to_owned(),
        source,
    })?;
    let wrong = |what: String| Failure::Usage(format!("{}: {what}", path.display()));
    let numbers: Vec<f64> = text
        .split(|c: char| c.is_whitespace() || c == ',')
        .filter(|word| !word.is_empty())
        .map(|word| word.parse().map_err(|_| wrong(format!("`{word}` is not a number"))))
        .collect::<Result<_, _>>()?;
    let [r0, r1, r2, r3] = <[f64; 16]>::try_from(numbers.as_slice())
        .map(|flat| [0, 4, 8, 12].map(|at| [flat[at], flat[at + 1], flat[at + 2], flat[at + 3]]))
        .map_err(|_| wrong(format!("{} numbers where 16 belong (4x4, row-major)", numbers.len())))?;
    isometry_from_rows(&[r0, r1, r2, r3]).map_err(|error| wrong(error.to_string()))
}
