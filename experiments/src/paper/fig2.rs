//! RMSE of every method by noise and by number of outliers (Fig. fig2).

use std::error::Error;
use std::time::Instant;

use super::Effort;
use super::fall::blades;
use super::item::{Item, Summary, short};
use super::svg::{Axis, Plot, Series, Style};
use crate::cases::{median, rmse};
use crate::generate::{self, OUTLIER_SIGMA, Surface};
use crate::methods::Method;

/// Noise over the blade's half length, which the paper calls a metre.
const SIGMAS: [f64; 6] = [0.01, 0.02, 0.05, 0.08, 0.11, 0.14];
const OUTLIER_COUNTS: [f64; 4] = [200.0, 950.0, 2000.0, 2800.0];
/// The paper's five, then the paper's own and what it has become.
const METHODS: [Method; 8] = [
    Method::Cpd,
    Method::LmIcp,
    Method::EmIcp,
    Method::Hmm,
    Method::Bcpd,
    Method::Mpe,
    Method::MpeTricp,
    Method::Bladescan,
];
/// How many of the first methods are those that the paper compares itself with.
const BASELINE_COUNT: usize = 5;
/// The paper: lower than every other by at least 45.5 %.
const CLAIMED_RATIO: f64 = 1.0 - 0.455;
/// As good as the lowest.
const CLOSE_RATIO: f64 = 1.1;

/// What is disturbed, level by level.
struct Sweep {
    name: &'static str,
    /// What stands along the axis.
    axis: &'static str,
    levels: Vec<f64>,
    /// Noise and number of outliers of a level.
    disturbance: fn(f64, &Effort) -> (f64, usize),
    claim: &'static str,
}

/// One registration.
struct Outcome {
    blade: &'static str,
    level: f64,
    /// `None` for known correspondences.
    method: Option<Method>,
    rmse: f64,
}

/// Fig. fig2, a to d.
pub(crate) fn noise(effort: &Effort) -> Result<Item, Box<dyn Error>> {
    measure(
        effort,
        &Sweep {
            name: "σ",
            axis: "noise σ over the half length",
            levels: effort.some(&SIGMAS).into_iter().copied().collect(),
            disturbance: |sigma, _| (sigma, 0),
            claim: "lowest, at most 0.545 of the next",
        },
    )
}

/// Fig. fig2, e to h.
pub(crate) fn outliers(effort: &Effort) -> Result<Item, Box<dyn Error>> {
    measure(
        effort,
        &Sweep {
            name: "outliers",
            axis: "outliers to 3,000 points",
            levels: effort.some(&OUTLIER_COUNTS).into_iter().copied().collect(),
            disturbance: |count, effort| {
                let share = effort.point_count() as f64 / generate::POINT_COUNT as f64;
                (OUTLIER_SIGMA, (count * share) as usize)
            },
            claim: "lowest, near zero",
        },
    )
}

fn measure(effort: &Effort, sweep: &Sweep) -> Result<Item, Box<dyn Error>> {
    let mut item = Item::new(
        &[
            "blade",
            "level",
            "repeat",
            "method",
            "rmse",
            "rotation_deg",
            "translation",
            "seconds",
        ],
        "RMSE over the moved points, in half lengths; the median of all repeats, failures included. \"Known pairs\" is the least-squares motion of \
             the true correspondences. A rank counts the method and the paper's five others.",
    );
    let mut outcomes = Vec::new();
    for (blade, surface) in blades()? {
        for &level in &sweep.levels {
            for repeat in 0..effort.repeats {
                let measured = register_all(effort, sweep, blade, &surface, level, repeat, &mut item.rows);
                outcomes.extend(measured);
            }
        }
        item.plot(blade, &plot(sweep, blade, &outcomes));
    }
    for &level in &sweep.levels {
        for method in [Method::MpeTricp, Method::Mpe, Method::Bladescan] {
            item.summary.push(compared(sweep, level, method, &outcomes));
        }
    }
    Ok(item)
}

/// One drawn pair, registered by every method.
fn register_all(
    effort: &Effort,
    sweep: &Sweep,
    blade: &'static str,
    surface: &Surface,
    level: f64,
    repeat: u32,
    rows: &mut Vec<Vec<String>>,
) -> Vec<Outcome> {
    let mut rng = generate::stream(effort.seed, &format!("fig2 {} {blade} {level} {repeat}", sweep.name));
    let truth = generate::motion(&mut rng);
    let (sigma, outlier_count) = (sweep.disturbance)(level, effort);
    let pair = generate::repeated(surface, effort.point_count(), &truth, sigma, outlier_count, &mut rng);
    let known = pair.known;
    let (source, target) = pair.into_clouds();
    let mut outcomes = Vec::new();
    for method in METHODS.into_iter().map(Some).chain([None]) {
        let begun = Instant::now();
        let estimate = method.map_or(known, |method| method.estimate(&source, &target));
        let seconds = begun.elapsed().as_secs_f64();
        let rmse = rmse(&source, &estimate.to_homogeneous(), &truth.to_homogeneous());
        let between = truth.inverse() * estimate;
        rows.push(vec![
            blade.to_owned(),
            level.to_string(),
            repeat.to_string(),
            name(method),
            format!("{rmse:.9}"),
            format!("{:.6}", between.rotation.angle().to_degrees()),
            format!("{:.9}", (estimate.translation.vector - truth.translation.vector).norm()),
            format!("{seconds:.4}"),
        ]);
        outcomes.push(Outcome {
            blade,
            level,
            method,
            rmse,
        });
    }
    outcomes
}

fn name(method: Option<Method>) -> String {
    method.map_or_else(|| "known".to_owned(), Method::name)
}

fn medians<'a>(outcomes: impl Iterator<Item = &'a Outcome> + Clone, method: Option<Method>) -> f64 {
    median(
        outcomes
            .filter(|outcome| outcome.method == method)
            .map(|outcome| outcome.rmse)
            .collect(),
    )
}

fn plot(sweep: &Sweep, blade: &str, outcomes: &[Outcome]) -> Plot {
    let points = |method: Option<Method>| {
        let at = |level: &f64| {
            let here = outcomes
                .iter()
                .filter(|outcome| outcome.blade == blade && outcome.level == *level);
            [*level, medians(here, method)]
        };
        sweep.levels.iter().map(at).collect::<Vec<_>>()
    };
    let known = Series::new("known pairs", Style::Bound, points(None));
    let mut series: Vec<Series> = METHODS
        .iter()
        .map(|method| Series::new(&method.name(), Style::Marked, points(Some(*method))))
        .collect();
    series.push(known);
    Plot {
        title: format!("{blade}: median RMSE by {}", sweep.name),
        x: Axis::linear(sweep.axis),
        y: Axis::log("RMSE over the half length"),
        series,
        map: None,
    }
}

/// How a method stands among the paper's others at one level, over all blades, by blade and pair by pair.
fn compared(sweep: &Sweep, level: f64, method: Method, outcomes: &[Outcome]) -> Summary {
    let here = outcomes.iter().filter(|outcome| outcome.level == level);
    let own = medians(here.clone(), Some(method));
    let (best, best_rmse) = best_other(here.clone());
    let others = METHODS[..BASELINE_COUNT].iter();
    let rank = 1 + others
        .filter(|other| medians(here.clone(), Some(**other)) < own)
        .count();
    let mut blades: Vec<&str> = here.clone().map(|outcome| outcome.blade).collect();
    blades.dedup();
    let by_blade = blades.into_iter().map(|blade| {
        let here = here.clone().filter(move |outcome| outcome.blade == blade);
        short(medians(here.clone(), Some(method)) / best_other(here).1)
    });
    Summary::new(
        format!("{} {level}, {}", sweep.name, method.name()),
        sweep.claim,
        format!(
            "{}: rank {rank} of {}, {} × known pairs; by blade {} × the best other; pair by pair {} × {}",
            short(own),
            BASELINE_COUNT + 1,
            short(own / medians(here.clone(), None)),
            by_blade.collect::<Vec<_>>().join(", "),
            short(paired(here, method, best)),
            best.name()
        ),
        judged(rank, own / best_rmse),
    )
    .with_peer(format!("{} {}", best.name(), short(best_rmse)))
}

/// The one of the paper's others with the lowest median.
fn best_other<'a>(outcomes: impl Iterator<Item = &'a Outcome> + Clone) -> (Method, f64) {
    METHODS[..BASELINE_COUNT]
        .iter()
        .map(|other| (*other, medians(outcomes.clone(), Some(*other))))
        .min_by(|a, b| a.1.total_cmp(&b.1))
        .unwrap_or((METHODS[0], f64::NAN))
}

/// The median of the ratios of two methods' errors on the same pairs, which come in the same order.
fn paired<'a>(outcomes: impl Iterator<Item = &'a Outcome> + Clone, method: Method, other: Method) -> f64 {
    let of = |method: Method| {
        let chosen = outcomes.clone().filter(move |outcome| outcome.method == Some(method));
        chosen.map(|outcome| outcome.rmse)
    };
    median(of(method).zip(of(other)).map(|(own, theirs)| own / theirs).collect())
}

fn judged(rank: usize, ratio: f64) -> String {
    let ratio_said = short(ratio);
    if rank == 1 && ratio <= CLAIMED_RATIO {
        format!("as the paper says: {ratio_said} × the best other")
    } else if rank == 1 {
        format!("lowest: {ratio_said} × the best other")
    } else if ratio <= CLOSE_RATIO {
        format!("not lowest, within 10 %: {ratio_said} × the best other")
    } else {
        format!("not lowest: {ratio_said} × the best other")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_method_is_judged_by_its_rank_and_its_ratio_to_the_best_other() {
        let outcome = |method, rmse| Outcome {
            blade: "lpt",
            level: 200.0,
            method,
            rmse,
        };
        let mut outcomes: Vec<Outcome> = METHODS[..BASELINE_COUNT]
            .iter()
            .map(|method| outcome(Some(*method), 0.4))
            .collect();
        outcomes[1].rmse = 0.2;
        outcomes.extend([
            outcome(Some(Method::Mpe), 0.3),
            outcome(Some(Method::Bladescan), 0.1),
            outcome(None, 0.05),
        ]);
        let effort = Effort {
            seed: 1,
            repeats: 1,
            quick: true,
        };
        let sweep = Sweep {
            name: "outliers",
            axis: "outliers",
            levels: vec![200.0],
            disturbance: |_, _| (0.0, 0),
            claim: "lowest",
        };
        assert_eq!(effort.some(&OUTLIER_COUNTS), [&200.0, &2000.0]);
        let of_mpe = compared(&sweep, 200.0, Method::Mpe, &outcomes);
        assert_eq!(
            of_mpe.ours,
            "0.300: rank 2 of 6, 6.00 × known pairs; by blade 1.50 × the best other; pair by pair 1.50 × lm-icp"
        );
        assert_eq!(of_mpe.peer, "lm-icp 0.200");
        assert_eq!(of_mpe.verdict, "not lowest: 1.50 × the best other");
        let of_own = compared(&sweep, 200.0, Method::Bladescan, &outcomes);
        assert_eq!(of_own.verdict, "as the paper says: 0.500 × the best other");
        assert_eq!(judged(1, 0.9), "lowest: 0.900 × the best other");
        assert_eq!(judged(2, 1.05), "not lowest, within 10 %: 1.05 × the best other");
    }
}
