//! Dense views of four blades, registered by every method: error of neighbours (Table UWAe1) and time a scan (Table time).

use std::error::Error;
use std::time::Instant;

use bladescan::geometry::PointCloud;
use hw_sim::blade::Builtin;
use nalgebra::Isometry3;

use super::Effort;
use super::chain::{Chain, view};
use super::item::{Item, Summary, duration, short};
use super::svg::{Axis, Plot, Series, Style};
use crate::cases::{median, rmse};
use crate::generate::Surface;
use crate::generate::views::AROUND_COUNT;
use crate::methods::Method;

/// The paper's three others, the ICP that its text names, its own two stages, and what they have become.
const METHODS: [Method; 6] = [
    Method::Icp,
    Method::EmIcp,
    Method::Cpd,
    Method::Bcpd,
    Method::MpeTricp,
    Method::Bladescan,
];
/// How many of the first methods are others.
const OTHER_COUNT: usize = 4;

/// Of a method the paper's degrees and mm of its four models.
const PAPER_ERRORS: [(Method, [(f64, f64); 4]); 4] = [
    (Method::EmIcp, [(4.81, 0.60), (4.71, 0.41), (3.17, 0.67), (2.37, 0.42)]),
    (Method::Cpd, [(1.77, 0.31), (2.21, 0.22), (1.43, 0.43), (1.98, 0.29)]),
    (Method::Bcpd, [(0.87, 0.13), (1.24, 0.12), (0.65, 0.16), (1.23, 0.26)]),
    (
        Method::MpeTricp,
        [(0.27, 0.06), (0.38, 0.05), (0.15, 0.03), (0.32, 0.04)],
    ),
];

/// Of a method the paper's seconds a scan of its four models.
const PAPER_SECONDS: [(Method, [f64; 4]); 4] = [
    (Method::EmIcp, [1013.27, 986.45, 1146.32, 1025.65]),
    (Method::Cpd, [5698.32, 6215.49, 6389.80, 4432.15]),
    (Method::Bcpd, [423.58, 544.35, 521.33, 468.78]),
    (Method::MpeTricp, [391.84, 449.48, 406.72, 387.40]),
];

/// How a pair of neighbours is registered.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Way {
    /// By themselves, from the identity.
    Pair(Method),
    /// Each to the growing model, all views one after the other.
    Chain,
}

impl Way {
    fn all() -> Vec<Self> {
        METHODS.into_iter().map(Self::Pair).chain([Self::Chain]).collect()
    }

    fn name(self) -> String {
        match self {
            Self::Pair(method) => method.name(),
            Self::Chain => "bladescan, to the model".to_owned(),
        }
    }

    /// The paper's values for this method; for bladescan's own those of MPE, which it has grown from.
    fn paper<T: Copy>(self, table: &[(Method, [T; 4])], blade: usize) -> Option<T> {
        let listed = match self {
            Self::Pair(Method::Bladescan) | Self::Chain => Method::MpeTricp,
            Self::Pair(method) => method,
        };
        let row = table.iter().find(|(method, _)| *method == listed);
        row.map(|(_, values)| values[blade])
    }

    /// What is said of it: against the paper where that has it, and against the best other if it is no other itself.
    fn verdict(self, to_paper: Option<String>, to_best_other: String) -> String {
        let is_other = METHODS[..OTHER_COUNT].iter().any(|method| self == Self::Pair(*method));
        let to_best_other = (!is_other).then_some(to_best_other);
        to_paper.into_iter().chain(to_best_other).collect::<Vec<_>>().join(", ")
    }
}

/// One pair of neighbours.
struct Outcome {
    blade: usize,
    way: Way,
    rotation_deg: f64,
    translation_mm: f64,
    seconds: f64,
}

/// Table UWAe1.
pub(crate) fn errors(effort: &Effort) -> Result<Item, Box<dyn Error>> {
    let mut item = item(
        "Neighbouring views of about 52,000 points, 10 degrees apart and each up to 3 degrees and 2.5 mm off its place; noise 0.02 mm along the ray. Pairs are registered \
         by themselves from the identity; \"to the model\" lays all 36 views one after the other on the growing model, with no robot to tell where they lie. Errors by \
         eq. 11 and 12 against the known truth (the paper's truth is its own ICP), medians over the pairs.",
    );
    let outcomes = measured(effort, effort.repeats, &mut item)?;
    let value = |outcome: &Outcome| outcome.rotation_deg;
    for (number, blade) in Builtin::ALL.into_iter().enumerate() {
        for way in Way::all() {
            let [deg, mm] =
                [value, |outcome: &Outcome| outcome.translation_mm].map(|value| of(&outcomes, number, way, value));
            let paper = way.paper(&PAPER_ERRORS, number);
            let (best, best_deg) = best_other(&outcomes, number, value);
            let row = Summary::new(
                format!("{}, {}", blade.name(), way.name()),
                paper.map_or("-".to_owned(), |(deg, mm)| format!("{deg}° / {mm} mm")),
                format!("{}° / {} mm", short(deg), short(mm)),
                way.verdict(
                    paper.map(|(paper_deg, _)| format!("{} × the paper's turn", short(deg / paper_deg))),
                    format!("{} × the best other's", short(deg / best_deg)),
                ),
            );
            item.summary
                .push(row.with_peer(format!("{} {}°", best.name(), short(best_deg))));
        }
    }
    item.plot(
        "",
        &plot("Turn between neighbouring views", "error, degrees", &outcomes, value),
    );
    Ok(item)
}

/// Table time.
pub(crate) fn times(effort: &Effort) -> Result<Item, Box<dyn Error>> {
    let mut item = item(
        "Time to register one view of about 52,000 points to its neighbour, everything included that follows the reading; \"to the model\" is a view of the chain with \
         its normals, its registration to the view before it and then to the model, and the merging. Medians; the other methods are our own programs, which sum by trees what the paper's may sum pair by pair.",
    );
    let outcomes = measured(effort, effort.repeats.div_ceil(TIMES_SHARE), &mut item)?;
    let value = |outcome: &Outcome| outcome.seconds;
    for (number, blade) in Builtin::ALL.into_iter().enumerate() {
        for way in Way::all() {
            let seconds = of(&outcomes, number, way, value);
            let paper = way.paper(&PAPER_SECONDS, number);
            let (best, best_s) = best_other(&outcomes, number, value);
            let row = Summary::new(
                format!("{}, {}", blade.name(), way.name()),
                paper.map_or("-".to_owned(), duration),
                duration(seconds),
                way.verdict(
                    paper.map(|paper_s| format!("{} times as fast as the paper's", short(paper_s / seconds))),
                    format!("{} × the fastest other's time", short(seconds / best_s)),
                ),
            );
            item.summary
                .push(row.with_peer(format!("{} {}", best.name(), duration(best_s))));
        }
    }
    item.plot("", &plot("Time to register a view", "s", &outcomes, value));
    Ok(item)
}

fn item(note: &str) -> Item {
    let columns = [
        "blade",
        "source_view",
        "target_view",
        "method",
        "rotation_deg",
        "translation_mm",
        "rmse_mm",
        "seconds",
    ];
    Item::new(&columns, note)
}

/// So many pairs of each blade, spread around it, by every method, and all pairs of its chain.
fn measured(effort: &Effort, pair_count: u32, item: &mut Item) -> Result<Vec<Outcome>, Box<dyn Error>> {
    let mut outcomes = Vec::new();
    for (number, blade) in Builtin::ALL.into_iter().enumerate() {
        let surface = Surface::of_builtin(blade)?;
        let mut add = |way: Way,
                       [source, target]: [u32; 2],
                       cloud: &PointCloud,
                       found: &Isometry3<f64>,
                       truth: &Isometry3<f64>,
                       seconds: f64| {
            let between = truth.inverse() * found;
            let outcome = Outcome {
                blade: number,
                way,
                rotation_deg: between.rotation.angle().to_degrees(),
                translation_mm: (found.translation.vector - truth.translation.vector).norm(),
                seconds,
            };
            item.rows.push(vec![
                blade.name().to_owned(),
                source.to_string(),
                target.to_string(),
                way.name().replace(',', ""),
                format!("{:.7}", outcome.rotation_deg),
                format!("{:.7}", outcome.translation_mm),
                format!("{:.7}", rmse(cloud, &found.to_homogeneous(), &truth.to_homogeneous())),
                format!("{seconds:.4}"),
            ]);
            outcomes.push(outcome);
        };
        let pair_count = pair_count.min(AROUND_COUNT);
        for source in (0..pair_count).map(|index| index * AROUND_COUNT / pair_count) {
            let target = (source + 1) % AROUND_COUNT;
            let [from, to] = [source, target].map(|index| view(effort, blade.name(), &surface, index));
            let truth = to.view_from_blade * from.view_from_blade.inverse();
            let [from, to] = [from, to].map(|view| PointCloud::from_measured(view.points).cloud);
            for method in METHODS {
                let begun = Instant::now();
                let found = method.estimate(&from, &to);
                let seconds = begun.elapsed().as_secs_f64();
                add(Way::Pair(method), [source, target], &from, &found, &truth, seconds);
            }
        }
        let chain = Chain::new(effort, blade.name(), &surface);
        for (index, pair) in chain.views.windows(2).enumerate() {
            let found = pair[1].fine.inverse() * pair[0].fine;
            let truth = pair[1].truth.inverse() * pair[0].truth;
            let indices = [index as u32, index as u32 + 1];
            add(Way::Chain, indices, &pair[0].cloud, &found, &truth, pair[1].seconds);
        }
    }
    Ok(outcomes)
}

/// The median over the pairs of a blade.
fn of(outcomes: &[Outcome], blade: usize, way: Way, value: impl Fn(&Outcome) -> f64) -> f64 {
    let chosen = outcomes
        .iter()
        .filter(|outcome| outcome.blade == blade && outcome.way == way);
    median(chosen.map(value).collect())
}

/// The lowest of the methods that are not ours.
fn best_other(outcomes: &[Outcome], blade: usize, value: fn(&Outcome) -> f64) -> (Method, f64) {
    METHODS[..OTHER_COUNT]
        .iter()
        .map(|method| (*method, of(outcomes, blade, Way::Pair(*method), value)))
        .min_by(|a, b| a.1.total_cmp(&b.1))
        .unwrap_or((METHODS[0], f64::NAN))
}

fn plot(title: &str, y: &str, outcomes: &[Outcome], value: fn(&Outcome) -> f64) -> Plot {
    let names = Builtin::ALL.map(Builtin::name);
    let series = Way::all().into_iter().map(|way| {
        let points = (0..names.len()).map(|number| [number as f64, of(outcomes, number, way, value)]);
        Series::new(&way.name(), Style::Marked, points.collect())
    });
    Plot {
        title: title.to_owned(),
        x: Axis::named("blade", &names),
        y: Axis::log(y),
        series: series.collect(),
        map: None,
    }
}

/// Of how many repeats times take one: they vary less than errors.
const TIMES_SHARE: u32 = 4;
