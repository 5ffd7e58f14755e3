//! `bladescan register`: one cloud to another.

use super::{Exit, Failure, print};
use crate::geometry::{Measured, PointCloud, isometry_from_rows, matrix_rows, read_cloud};
use crate::registration::{
    Reference, RegisterError, Registration, Search, Settings, Stage, StartSigma, Status, WeakDirections,
    can_be_registered, register_from,
};
use crate::seed::{Seed, Stream};
use nalgebra::Isometry3;
use serde_json::{Value, json};
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
    /// How well the start is known, one standard deviation of a turn about each axis (deg, about the template's centroid)
    /// and of a shift (the clouds' unit): the answer is the mean of start and surfaces, each weighed by its certainty
    /// [default: the start counts only where the surfaces say nothing].
    #[arg(long, value_name = "DEG,LENGTH", requires = "init", value_parser = start_sigma)]
    init_sigma: Option<StartSigma>,
    /// Seeds the samples.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Print one JSON document.
    #[arg(long)]
    json: bool,
}

pub(super) fn main(args: &Args) -> Result<Exit, Failure> {
    let (template, template_dropped_count) = read(&args.template)?;
    let (reference, reference_dropped_count) = read(&args.reference)?;
    let start = match &args.init {
        Some(path) => read_motion(path)?,
        None => Isometry3::identity(),
    };
    let began = Instant::now();
    let mut last = began;
    let mut stages = Vec::new();
    let refused = |path: &Path, error: RegisterError| Failure::Usage(format!("{}: {error}", path.display()));
    can_be_registered(&template).map_err(|error| refused(&args.template, error))?;
    let prepared = Reference::new(&reference).map_err(|error| refused(&args.reference, error))?;
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
        weak_directions: match (&args.init, args.init_sigma) {
            (Some(_), Some(sigma)) => WeakDirections::Weigh(sigma),
            // A given start is a measurement; the identity is only a guess.
            (Some(_), None) => WeakDirections::Hold,
            (None, _) => WeakDirections::Report,
        },
        search: match args.init {
            Some(_) => Search::Near,
            None => Search::Automatic,
        },
        ..Settings::default()
    };
    let stream = Seed(args.seed).stream(Stream::Sampling { view_index: 0 });
    let found = register_from(&template, &prepared, &start, &settings, stream, &mut on_stage);
    let outcome = Outcome {
        found,
        stages,
        template_dropped_count,
        reference_dropped_count,
        seconds: began.elapsed().as_secs_f64(),
    };
    if args.json {
        print(&outcome.as_json().to_string())?;
    } else {
        print(&outcome.as_text())?;
    }
    Ok(match outcome.found.status {
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

/// What is said of a registration.
struct Outcome {
    found: Registration,
    stages: Vec<Value>,
    template_dropped_count: usize,
    reference_dropped_count: usize,
    seconds: f64,
}

impl Outcome {
    fn as_json(&self) -> Value {
        let found = &self.found;
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
            "covariance": self.covariance_rows(),
            "weak_directions": weak_directions,
            "dropped_count": { "template": self.template_dropped_count, "reference": self.reference_dropped_count },
            "stages": self.stages,
            "seconds": self.seconds,
        })
    }

    fn as_text(&self) -> String {
        let found = &self.found;
        let mut lines: Vec<String> = matrix_rows(&found.reference_from_template)
            .map(|row| row.map(|value| format!("{value:15.9}")).join(" "))
            .into();
        lines.push(format!(
            "{}: overlap {:.3} ({} points), residual {:.4e}, {:.3} s",
            status_name(found.status),
            found.overlap.fraction,
            found.overlap.count,
            found.rmse,
            self.seconds
        ));
        let numbers = |row: &[f64]| row.iter().map(|value| format!("{value:11.3e}")).collect::<String>();
        for weak in &found.weak_directions {
            lines.push(format!(
                "weak direction: sigma {:.3e} along{}",
                weak.sigma,
                numbers(&weak.direction)
            ));
        }
        match self.covariance_rows() {
            Some(rows) => {
                lines.push("covariance of rx ry rz (rad) tx ty tz about the template's centroid:".to_owned());
                lines.extend(rows.iter().map(|row| numbers(row)));
            }
            None => lines.push("no covariance".to_owned()),
        }
        lines.push(format!(
            "points dropped because they are not finite: {} of the template, {} of the reference",
            self.template_dropped_count, self.reference_dropped_count
        ));
        lines.join("\n")
    }

    fn covariance_rows(&self) -> Option<[[f64; 6]; 6]> {
        let matrix = self.found.covariance?;
        Some(std::array::from_fn(|row| {
            std::array::from_fn(|column| matrix[(row, column)])
        }))
    }
}

/// Reads `DEG,LENGTH`.
fn start_sigma(text: &str) -> Result<StartSigma, String> {
    let numbers: Vec<f64> = text.split(',').filter_map(|word| word.trim().parse().ok()).collect();
    let allowed = |value: &f64| value.is_finite() && *value > 0.0;
    match numbers.as_slice() {
        [deg, shift] if text.split(',').count() == 2 && allowed(deg) && allowed(shift) => Ok(StartSigma {
            turn_rad: deg.to_radians(),
            shift: *shift,
        }),
        _ => Err("two positive numbers belong here: degrees and a length, such as 0.05,0.1".to_owned()),
    }
}

/// A cloud, and how many points of the file were not finite.
fn read(path: &Path) -> Result<(PointCloud, usize), Failure> {
    let bytes = std::fs::read(path).map_err(|source| Failure::Read {
        path: path.to_owned(),
        source,
    })?;
    let Measured { cloud, dropped_count } = read_cloud(&path.display().to_string(), &bytes)
        .map_err(|error| Failure::Usage(format!("{}: {error}", path.display())))?;
    Ok((cloud, dropped_count))
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
