//! Which stage does what (Table ab), against the bound of known correspondences.

use std::error::Error;
use std::time::Instant;

use bladescan::geometry::PointCloud;
use bladescan::registration::Summation;
use nalgebra::Isometry3;
use rand_chacha::ChaCha8Rng;

use super::Effort;
use super::fall::{blades, fall};
use super::item::{Item, Summary, duration, short};
use super::svg::{Axis, Plot, Series, Style};
use crate::cases::{median, rmse};
use crate::generate;
use crate::methods::Method;
use crate::methods::product::sample;
use crate::methods::tricp::{self, TrimmedSettings};

/// What is done with the samples.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Stages {
    /// MPE on the samples.
    Motion,
    /// MPE on the samples, then trimmed ICP over all points.
    MotionAndIcp,
    /// Trimmed ICP on the samples.
    Icp,
}

/// A row of the paper's table: sample (`None`: full), stages, accuracy in mm, runtime in s.
const PAPER: [(Option<usize>, Stages, f64, f64); 9] = [
    (None, Stages::Motion, 0.12, 241.54),
    (Some(500), Stages::Motion, 5.14, 15.34),
    (Some(100), Stages::Motion, 10.03, 1.94),
    (None, Stages::MotionAndIcp, 0.10, 276.41),
    (Some(500), Stages::MotionAndIcp, 0.11, 18.64),
    (Some(100), Stages::MotionAndIcp, 10.04, 2.32),
    (None, Stages::Icp, 60.43, 22.54),
    (Some(500), Stages::Icp, 125.32, 3.18),
    (Some(100), Stages::Icp, 230.14, 0.93),
];

/// 20 mm, with a half length of a metre.
const SIGMA: f64 = 0.02;
const OUTLIER_FRACTION: f64 = 0.1;

/// A drawn pair.
struct Drawn {
    source: PointCloud,
    target: PointCloud,
    truth: Isometry3<f64>,
    known_rmse: f64,
    rng: ChaCha8Rng,
}

pub(crate) fn measure(effort: &Effort) -> Result<Item, Box<dyn Error>> {
    let mut drawn = Vec::new();
    for (blade, surface) in blades()? {
        for repeat in 0..effort.repeats {
            let mut rng = generate::stream(effort.seed, &format!("ab {blade} {repeat}"));
            let truth = generate::motion(&mut rng);
            let count = effort.point_count();
            let outlier_count = (OUTLIER_FRACTION * count as f64) as usize;
            let pair = generate::repeated(&surface, count, &truth, SIGMA, outlier_count, &mut rng);
            let known = pair.known;
            let (source, target) = pair.into_clouds();
            drawn.push(Drawn {
                known_rmse: rmse(&source, &known.to_homogeneous(), &truth.to_homogeneous()),
                source,
                target,
                truth,
                rng,
            });
        }
    }
    let known = median(drawn.iter().map(|pair| pair.known_rmse).collect());
    let mut item = Item::new(
        &["sample", "stages", "pair", "rmse", "known_rmse", "seconds"],
        format!(
            "RMSE over the moved points in thousandths of the half length, the paper's mm; medians over four blades. Known correspondences of the same points \
             give {} mm: nothing can be expected below, so the paper's 0.10 to 0.12 mm cannot be an RMSE of the alignment.",
            short(1e3 * known)
        ),
    );
    let stages = [Stages::Motion, Stages::MotionAndIcp, Stages::Icp];
    let mut ours = stages.map(|stages| Series::new(name(stages), Style::Scatter, Vec::new()));
    let mut papers = stages.map(|stages| Series::new(&format!("paper: {}", name(stages)), Style::Scatter, Vec::new()));
    for (sample_count, stages, accuracy, runtime_s) in PAPER {
        let what = format!(
            "{}, {}",
            sample_count.map_or("full".to_owned(), |count| format!("{count} points")),
            name(stages)
        );
        let count = sample_count.unwrap_or(usize::MAX);
        let (error, seconds) = over(&drawn, &mut item.rows, &what, |pair, rng| {
            let motion = |rng: &mut ChaCha8Rng| fall(&pair.source, &pair.target, count, Summation::Automatic, rng);
            match stages {
                Stages::Motion => motion(rng),
                Stages::MotionAndIcp => {
                    let near = motion(rng);
                    tricp::register(&pair.source, &pair.target, &near, &TrimmedSettings::default())
                }
                Stages::Icp => {
                    let [source, target] = [&pair.source, &pair.target]
                        .map(|cloud| PointCloud::from_measured(sample(cloud, count, rng)).cloud);
                    Method::Tricp.estimate(&source, &target)
                }
            }
        });
        ours[stages as usize].points.push([seconds, 1e3 * error]);
        papers[stages as usize].points.push([runtime_s, accuracy]);
        item.summary.push(Summary::new(
            what,
            format!("{accuracy} mm, {}", duration(runtime_s)),
            format!("{} mm, {}", short(1e3 * error), duration(seconds)),
            format!(
                "{} × known pairs; {} times as fast",
                short(error / known),
                short(runtime_s / seconds)
            ),
        ));
    }
    let (error, seconds) = over(&drawn, &mut item.rows, "bladescan", |pair, _| {
        Method::Bladescan.estimate(&pair.source, &pair.target)
    });
    item.summary.push(Summary::new(
        "bladescan",
        "-",
        format!("{} mm, {}", short(1e3 * error), duration(seconds)),
        format!("{} × known pairs", short(error / known)),
    ));
    let own = Series::new("bladescan", Style::Scatter, vec![[seconds, 1e3 * error]]);
    let times = ours.iter().chain(&papers).flat_map(|series| &series.points);
    let (first, last) = times.fold((seconds, seconds), |(low, high), point| {
        (low.min(point[0]), high.max(point[0]))
    });
    let bound = Series::new(
        "known pairs",
        Style::Bound,
        [first, last].map(|time| [time, 1e3 * known]).into(),
    );
    item.plot(
        "",
        &Plot {
            title: "Error and time by stage: full sample, 500 and 100 points".to_owned(),
            x: Axis::log("time, s"),
            y: Axis::log("RMSE, thousandths of the half length"),
            series: ours.into_iter().chain(papers).chain([own, bound]).collect(),
            map: None,
        },
    );
    Ok(item)
}

/// The medians of error and time over all pairs.
fn over(
    drawn: &[Drawn],
    rows: &mut Vec<Vec<String>>,
    what: &str,
    register: impl Fn(&Drawn, &mut ChaCha8Rng) -> Isometry3<f64>,
) -> (f64, f64) {
    let (mut errors, mut times) = (Vec::new(), Vec::new());
    let (sample, stages) = what.split_once(", ").unwrap_or(("", what));
    for (index, pair) in drawn.iter().enumerate() {
        let mut rng = pair.rng.clone();
        let begun = Instant::now();
        let found = register(pair, &mut rng);
        let seconds = begun.elapsed().as_secs_f64();
        let error = rmse(&pair.source, &found.to_homogeneous(), &pair.truth.to_homogeneous());
        rows.push(vec![
            sample.to_owned(),
            stages.to_owned(),
            index.to_string(),
            format!("{error:.9}"),
            format!("{:.9}", pair.known_rmse),
            format!("{seconds:.6}"),
        ]);
        errors.push(error);
        times.push(seconds);
    }
    (median(errors), median(times))
}

fn name(stages: Stages) -> &'static str {
    match stages {
        Stages::Motion => "MC",
        Stages::MotionAndIcp => "MC + ICP",
        Stages::Icp => "ICP",
    }
}
