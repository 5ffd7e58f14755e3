//! Error and time of MPE by how much of the clouds it takes (Fig. ET, Tables tc and MPEL).

use std::error::Error;
use std::time::Instant;

use bladescan::geometry::PointCloud;
use bladescan::registration::Summation;

use super::Effort;
use super::fall::{blades, fall};
use super::item::{Item, Summary, duration, short};
use super::svg::{Axis, Plot, Series, Style};
use crate::cases::{median, rmse};
use crate::generate::{self, Surface};

/// Sampling ratio with the paper's mean error in mm and its variance in 1e-6.
const PAPER_TC: [(f64, f64, f64); 16] = [
    (0.05, 10.8, 32.1),
    (0.10, 8.3, 20.7),
    (0.15, 4.8, 8.9),
    (0.20, 7.1, 16.3),
    (0.25, 5.3, 3.67),
    (0.30, 4.3, 3.03),
    (0.35, 3.5, 4.85),
    (0.40, 2.7, 2.75),
    (0.45, 3.2, 2.18),
    (0.50, 2.9, 2.07),
    (0.55, 2.6, 1.07),
    (0.60, 2.4, 0.78),
    (0.65, 1.9, 0.94),
    (0.70, 1.9, 0.97),
    (0.75, 1.8, 1.13),
    (0.80, 1.8, 0.49),
];

/// Points with the paper's times of the full sample, 200 and 100 points, in seconds.
const PAPER_MPEL: [(usize, [f64; 3]); 4] = [
    (500, [16.4, 3.3, 0.9]),
    (2000, [5.1 * 60.0, 3.9, 1.5]),
    (8000, [1.6 * 3600.0, 7.2, 4.8]),
    (32_000, [30.6 * 3600.0, 20.2, 18.4]),
];

/// One fall.
struct Fall {
    ratio: f64,
    rmse: f64,
    seconds: f64,
}

impl Fall {
    /// Whether it ended near the truth and not in a flip.
    fn is_right(&self) -> bool {
        self.rmse < WRONG_RMSE
    }
}

/// Fig. ET.
pub(crate) fn by_ratio_in_time(effort: &Effort) -> Result<Item, Box<dyn Error>> {
    let falls = falls(effort)?;
    let mut item = item(&falls);
    let of = |is_large: bool, only_right: bool, value: fn(&Fall) -> f64| -> Vec<f64> {
        falls
            .iter()
            .filter(|fall| (fall.ratio > SMOOTH_RATIO) == is_large && (fall.is_right() || !only_right))
            .map(value)
            .collect()
    };
    for (only_right, what) in [(true, "of falls to the right place"), (false, "of all falls")] {
        let spread = |is_large| variance(&of(is_large, only_right, |fall| fall.rmse)).sqrt();
        let (small, large) = (spread(false), spread(true));
        item.summary.push(Summary::new(
            format!("standard deviation of the error {what}, ratios over 0.25 against the others"),
            "smaller, smoother",
            format!("{} against {} mm", short(1e3 * large), short(1e3 * small)),
            if large < small {
                "as the paper says"
            } else if small.is_nan() || large.is_nan() {
                "none to compare"
            } else {
                "not so"
            },
        ));
    }
    let time = |is_large| median(of(is_large, false, |fall| fall.seconds));
    item.summary.push(Summary::new(
        "time of a fall, ratios over 0.25 against the others",
        "longer",
        format!("{} against {} (median)", duration(time(true)), duration(time(false))),
        if time(true) > time(false) {
            "as the paper says"
        } else {
            "not so"
        },
    ));
    let each = falls.iter().map(|fall| [fall.seconds, 1e3 * fall.rmse]).collect();
    let by_ratio = |middle: fn(Vec<f64>) -> f64| -> Vec<[f64; 2]> {
        let groups = groups(&falls).into_iter();
        groups
            .map(|(_, falls)| {
                let of = |value: fn(&Fall) -> f64| middle(falls.iter().map(value).collect());
                [of(|fall| fall.seconds), 1e3 * of(|fall| fall.rmse)]
            })
            .collect()
    };
    item.plot(
        "",
        &Plot {
            title: "Error and time of a fall, by sampling ratio".to_owned(),
            x: Axis::log("time of a fall, s"),
            y: Axis::log("RMSE, thousandths of the half length"),
            series: vec![
                Series::new("a fall", Style::Cloud, each),
                Series::new("mean of a ratio", Style::Marked, by_ratio(|values| mean(&values))),
                Series::new("median of a ratio", Style::Marked, by_ratio(median)),
            ],
            map: None,
        },
    );
    Ok(item)
}

/// Table tc.
pub(crate) fn by_ratio(effort: &Effort) -> Result<Item, Box<dyn Error>> {
    let falls = falls(effort)?;
    let mut item = item(&falls);
    let mut lines = [const { Vec::new() }; 4];
    for (ratio, falls) in groups(&falls) {
        let errors: Vec<f64> = falls.iter().map(|fall| fall.rmse).collect();
        let right: Vec<f64> = falls
            .iter()
            .filter(|fall| fall.is_right())
            .map(|fall| fall.rmse)
            .collect();
        let (paper_mean, paper_variance) = PAPER_TC
            .iter()
            .find(|row| row.0 == ratio)
            .map_or((f64::NAN, f64::NAN), |row| (row.1, row.2));
        let said = |values: &[f64]| {
            let (mean, variance) = (short(1e3 * mean(values)), short(1e6 * variance(values)));
            format!("{mean} mm, variance {variance}e-6")
        };
        let (wrong_count, middle) = (errors.len() - right.len(), median(errors.clone()));
        let (of_right, verdict) = if right.is_empty() {
            ("none".to_owned(), "all to a wrong place".to_owned())
        } else {
            let mean = short(1e3 * mean(&right) / paper_mean);
            let variance = short(1e6 * variance(&right) / paper_variance);
            (
                said(&right),
                format!("without those mean × {mean}, variance × {variance} of the paper's"),
            )
        };
        item.summary.push(Summary::new(
            format!("ratio {ratio:.2}"),
            format!("{paper_mean} mm, variance {paper_variance}e-6"),
            format!(
                "{} (median {}); without {wrong_count} of {} to a wrong place {of_right}",
                said(&errors),
                short(1e3 * middle),
                errors.len(),
            ),
            verdict,
        ));
        let values = [1e3 * mean(&errors), 1e3 * middle, 1e3 * mean(&right), paper_mean];
        for (line, value) in lines.iter_mut().zip(values) {
            line.push([ratio, value]);
        }
    }
    let [means, medians, right, paper] = lines;
    item.plot(
        "",
        &Plot {
            title: "Error by sampling ratio".to_owned(),
            x: Axis::linear("sampling ratio"),
            y: Axis::log("RMSE, thousandths of the half length"),
            series: vec![
                Series::new("mean", Style::Marked, means),
                Series::new("median", Style::Marked, medians),
                Series::new("mean, right place", Style::Marked, right),
                Series::new("the paper's mean", Style::Marked, paper),
            ],
            map: None,
        },
    );
    Ok(item)
}

/// Table MPEL.
pub(crate) fn by_count(effort: &Effort) -> Result<Item, Box<dyn Error>> {
    let mut item = Item::new(
        &["points", "sample", "summation", "repeat", "rotation_deg", "seconds"],
        "One fall by halved strides, the drawing of the samples included, on two independent samples of the first blade; medians. \
             \"As printed\" sums all pairs (once, beyond 2,000 points); \"fast\" is the tree that bladescan takes from 2,000 points on.",
    );
    let (_, surface) = blades()?.swap_remove(0);
    let mut lines: Vec<(&str, Vec<[f64; 2]>)> = [
        "fast",
        "as printed",
        "200 points",
        "100 points",
        "the paper's full sample",
    ]
    .map(|name| (name, Vec::new()))
    .into();
    for (count, paper) in effort.some(&PAPER_MPEL) {
        let modes = [
            (*count, Summation::Automatic, "fast"),
            (*count, Summation::Pairs, "as printed"),
            (200, Summation::Automatic, "200 points"),
            (100, Summation::Automatic, "100 points"),
        ];
        for (mode, (sample_count, summation, name)) in modes.into_iter().enumerate() {
            let once = summation == Summation::Pairs && *count > 2000;
            let repeats = if once { 1 } else { effort.repeats };
            let mut times = Vec::new();
            for repeat in 0..repeats {
                let mut rng = generate::stream(effort.seed, &format!("mpel {count} {repeat}"));
                let truth = generate::motion(&mut rng);
                let source = PointCloud::from_measured(surface.sample(*count, &mut rng)).cloud;
                let other = surface.sample(*count, &mut rng);
                let target = PointCloud::from_measured(generate::moved(&other, &truth)).cloud;
                let begun = Instant::now();
                let found = fall(&source, &target, sample_count, summation, &mut rng);
                let seconds = begun.elapsed().as_secs_f64();
                times.push(seconds);
                item.rows.push(vec![
                    count.to_string(),
                    sample_count.to_string(),
                    name.to_owned(),
                    repeat.to_string(),
                    format!("{:.6}", (truth.inverse() * found).rotation.angle().to_degrees()),
                    format!("{seconds:.6}"),
                ]);
            }
            let seconds = median(times);
            lines[mode].1.push([*count as f64, seconds]);
            let paper_s = paper[mode.saturating_sub(1)];
            let what = if mode < 2 {
                format!("full sample, {name}")
            } else {
                name.to_owned()
            };
            item.summary.push(Summary::new(
                format!("{count} × 3, {what}"),
                duration(paper_s),
                duration(seconds),
                format!("{} times as fast", short(paper_s / seconds)),
            ));
        }
        lines[4].1.push([*count as f64, paper[0]]);
    }
    item.plot(
        "",
        &Plot {
            title: "Time of a fall by number of points".to_owned(),
            x: Axis::log("points of each cloud"),
            y: Axis::log("time of a fall, s"),
            series: lines
                .into_iter()
                .map(|(name, points)| Series::new(name, Style::Marked, points))
                .collect(),
            map: None,
        },
    );
    Ok(item)
}

/// Every blade at every ratio, as often as asked for.
fn falls(effort: &Effort) -> Result<Vec<Fall>, Box<dyn Error>> {
    let mut falls = Vec::new();
    for (ratio, _, _) in effort.some(&PAPER_TC) {
        for (blade, surface) in blades()? {
            for repeat in 0..effort.repeats {
                falls.push(one(effort, *ratio, blade, &surface, repeat));
            }
        }
    }
    Ok(falls)
}

fn one(effort: &Effort, ratio: f64, blade: &str, surface: &Surface, repeat: u32) -> Fall {
    let mut rng = generate::stream(effort.seed, &format!("tc {blade} {ratio} {repeat}"));
    let truth = generate::motion(&mut rng);
    let count = effort.point_count();
    let pair = generate::repeated(surface, count, &truth, 0.0, 0, &mut rng);
    let (source, target) = pair.into_clouds();
    let sample_count = (ratio * count as f64).round() as usize;
    let begun = Instant::now();
    let found = fall(&source, &target, sample_count, Summation::Automatic, &mut rng);
    Fall {
        ratio,
        seconds: begun.elapsed().as_secs_f64(),
        rmse: rmse(&source, &found.to_homogeneous(), &truth.to_homogeneous()),
    }
}

fn item(falls: &[Fall]) -> Item {
    let row = |fall: &Fall| {
        let [ratio, rmse, seconds] = [
            fall.ratio.to_string(),
            format!("{:.9}", fall.rmse),
            format!("{:.6}", fall.seconds),
        ];
        vec![ratio, rmse, seconds]
    };
    let mut item = Item::new(
        &["ratio", "rmse", "seconds"],
        "MPE by halved strides without ICP, from the identity, on samples of two clouds of the same 3,000 points without noise, over all four blades. \
         A thousandth of the half length stands for the paper's mm. Motions turn by up to 90 degrees; a fall whose error is over a tenth of the half length has \
         gone to a wrong place (the blade end to end or turned over), which no ratio prevents and the paper's figures do not show.",
    );
    item.rows = falls.iter().map(row).collect();
    item
}

/// The falls of each ratio, in order.
fn groups(falls: &[Fall]) -> Vec<(f64, &[Fall])> {
    falls
        .chunk_by(|a, b| a.ratio == b.ratio)
        .map(|group| (group[0].ratio, group))
        .collect()
}

/// NaN of nothing.
fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

fn variance(values: &[f64]) -> f64 {
    let middle = mean(values);
    mean(&values.iter().map(|value| (value - middle).powi(2)).collect::<Vec<_>>())
}

/// A fall that ends farther off, over the half length, has missed.
const WRONG_RMSE: f64 = 0.1;

/// From here on the paper calls the error smooth.
const SMOOTH_RATIO: f64 = 0.24;
