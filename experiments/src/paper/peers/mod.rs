//! Ours and today's open programs on the same cases, out of the files of `experiments/peers/`.
//!
//! Every comparison is paired: a ratio is that of a peer to ours on one case, with as many threads, and of those the median.

mod read;

use std::collections::{BTreeMap, BTreeSet};
use std::error::Error;
use std::fs;
use std::path::{Path, PathBuf};

use clap::Args;

use self::read::{A_VIEW, Row, WHOLE};
use super::item::{Item, Summary, duration, short};
use super::svg::{Axis, Plot, Series, Style};
use super::{Origin, write};
use crate::cases::median;

/// The section's name on the page and in file names.
pub(crate) const NAME: &str = "peers";
pub(crate) const TITLE: &str = "Today's open programs on the same cases, in turns";

/// Compares ours with other programs, out of what `experiments/peers/` has measured.
#[derive(Args)]
pub(crate) struct PeersArguments {
    /// What `peers.py` has written.
    cases: Vec<PathBuf>,
    /// What `chain.py` has written; its name without `.csv` names the reconstruction. May be given again.
    #[arg(long = "chain", value_name = "FILE")]
    chains: Vec<PathBuf>,
    /// Where `peers.csv`, `peers.json` and the plots go; made if it is not there.
    #[arg(long, default_value = "paper-results")]
    out: PathBuf,
}

pub(crate) fn run(arguments: &PeersArguments) -> Result<(), Box<dyn Error>> {
    let mut rows = Vec::new();
    for path in &arguments.cases {
        rows.extend(read::registrations(&fs::read_to_string(path)?).map_err(in_file(path))?);
    }
    for path in &arguments.chains {
        let name = path.file_stem().unwrap_or_default().to_string_lossy();
        rows.extend(read::reconstructions(&name, &fs::read_to_string(path)?).map_err(in_file(path))?);
    }
    let item = compared(&rows);
    if item.summary.is_empty() {
        return Err(format!("there is no case with both {OURS} and another method").into());
    }
    let names = |paths: &[PathBuf], before: &str| -> String {
        let name = |path: &PathBuf| path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        paths.iter().map(|path| format!(" {before}{}", name(path))).collect()
    };
    let repeats: BTreeSet<&String> = rows.iter().map(|row| &row.repeat).collect();
    let origin = Origin {
        name: NAME.to_owned(),
        title: TITLE,
        command: format!(
            "experiments peers{}{}",
            names(&arguments.cases, ""),
            names(&arguments.chains, "--chain ")
        ),
        seed: None,
        repeats: repeats.len() as u32,
        quick: false,
    };
    fs::create_dir_all(&arguments.out)?;
    let registering = rows.iter().filter(|row| !row.group.ends_with(A_VIEW));
    write(
        &arguments.out,
        &origin,
        &item,
        registering
            .map(|row| row.seconds)
            .filter(|seconds| seconds.is_finite())
            .sum(),
    )
}

fn in_file(path: &Path) -> impl Fn(String) -> String {
    move |error| format!("{}: {error}", path.display())
}

/// One method on one case: medians over the repeats.
struct Outcome {
    is_right: bool,
    error: f64,
    seconds: f64,
}

/// One method on all cases of a group, by case.
type Outcomes = BTreeMap<String, Outcome>;

fn compared(rows: &[Row]) -> Item {
    let mut item = Item::new(
        &[
            "group", "method", "threads", "case", "repeat", "success", "error", "seconds", "wall_s",
        ],
        NOTE,
    );
    item.rows = rows.iter().map(cells).collect();
    let groups = in_order(rows.iter().map(|row| &row.group));
    let methods = in_order(rows.iter().map(|row| &row.method));
    let threads: BTreeSet<usize> = rows.iter().map(|row| row.threads).collect();
    for group in groups {
        let unit = Unit::of(group);
        let mut series: Vec<Series> = Vec::new();
        for &threads in &threads {
            let of = |method: &str| outcomes(rows, group, threads, method);
            let mut peers = Vec::new();
            for &method in &methods {
                let outcomes = of(method);
                if outcomes.is_empty() {
                    continue;
                }
                let place = [middle(&outcomes, |one| one.seconds), middle(&outcomes, |one| one.error)];
                match series.iter_mut().find(|series| series.name == *method) {
                    Some(series) => series.points.push(place),
                    None => series.push(Series::new(method, Style::Marked, vec![place])),
                }
                if method != OURS {
                    peers.push((method, outcomes));
                }
            }
            let ours = of(OURS);
            if !ours.is_empty() {
                let what = format!("{group}, {threads} thread{}", if threads == 1 { "" } else { "s" });
                item.summary.extend(summaries(&what, peers, &ours, unit));
            }
        }
        if !group.ends_with(A_VIEW) {
            let plot = Plot {
                title: format!("{group}: one thread to all threads"),
                x: Axis::log("median time, s"),
                y: Axis::log(unit.axis()),
                series,
                map: None,
            };
            item.plot(group.replace([',', ' '], "-").replace("--", "-"), &plot);
        }
    }
    item
}

fn cells(row: &Row) -> Vec<String> {
    vec![
        row.group.replace(',', ""),
        row.method.clone(),
        row.threads.to_string(),
        row.case.clone(),
        row.repeat.clone(),
        u8::from(row.is_right).to_string(),
        format!("{:.9}", row.error),
        format!("{:.4}", row.seconds),
        row.wall_s.clone(),
    ]
}

/// Each once, in the order in which they come first.
fn in_order<'a>(names: impl Iterator<Item = &'a String>) -> Vec<&'a str> {
    let mut seen = Vec::new();
    for name in names {
        if !seen.contains(&name.as_str()) {
            seen.push(name.as_str());
        }
    }
    seen
}

fn outcomes(rows: &[Row], group: &str, threads: usize, method: &str) -> Outcomes {
    let mut by_case: BTreeMap<String, Vec<&Row>> = BTreeMap::new();
    let of_method = |row: &&Row| row.group == group && row.threads == threads && row.method == method;
    for row in rows.iter().filter(of_method) {
        by_case.entry(row.case.clone()).or_default().push(row);
    }
    let outcome = |repeats: Vec<&Row>| Outcome {
        is_right: repeats.iter().all(|row| row.is_right),
        error: median(repeats.iter().map(|row| row.error).collect()),
        seconds: median(repeats.iter().map(|row| row.seconds).collect()),
    };
    by_case
        .into_iter()
        .map(|(case, repeats)| (case, outcome(repeats)))
        .collect()
}

fn middle(outcomes: &Outcomes, value: fn(&Outcome) -> f64) -> f64 {
    median(outcomes.values().map(value).collect())
}

/// Median of theirs over ours, case by case.
fn ratio(theirs: &Outcomes, ours: &Outcomes, value: fn(&Outcome) -> f64) -> f64 {
    let pairs = theirs.iter().filter_map(|(case, one)| Some((one, ours.get(case)?)));
    median(pairs.map(|(one, own)| value(one) / value(own)).collect())
}

/// A row for each peer, the one with the lowest error first.
fn summaries(what: &str, mut peers: Vec<(&str, Outcomes)>, ours: &Outcomes, unit: Unit) -> Vec<Summary> {
    let said = |outcomes: &Outcomes| {
        format!(
            "{}, {}, {} of {} right",
            unit.said(middle(outcomes, |one| one.error)),
            duration(middle(outcomes, |one| one.seconds)),
            outcomes.values().filter(|one| one.is_right).count(),
            outcomes.len()
        )
    };
    let error = |outcomes: &Outcomes| middle(outcomes, |one| one.error);
    peers.sort_by(|a, b| error(&a.1).total_cmp(&error(&b.1)));
    let seconds = peers.iter().map(|(_, theirs)| middle(theirs, |one| one.seconds));
    let fastest = seconds.fold(f64::INFINITY, f64::min);
    let row = |(place, (method, theirs)): (usize, &(&str, Outcomes))| {
        let is_fastest = middle(theirs, |one| one.seconds) <= fastest;
        Summary::new(
            format!("{what}, {method}"),
            "-",
            said(ours),
            format!(
                "theirs to ours: error × {}{}, time × {}{}",
                short(ratio(theirs, ours, |one| one.error)),
                if place == 0 { " (their lowest)" } else { "" },
                short(ratio(theirs, ours, |one| one.seconds)),
                if is_fastest { " (their fastest)" } else { "" },
            ),
        )
        .with_peer(said(theirs))
    };
    peers.iter().enumerate().map(row).collect()
}

/// What errors are counted in.
#[derive(Clone, Copy)]
enum Unit {
    HalfLength,
    Millimetre,
}

impl Unit {
    /// Dense views are in mm, all else is normalised.
    fn of(group: &str) -> Self {
        if group.starts_with("mv") || group.ends_with(A_VIEW) || group.ends_with(WHOLE) {
            Self::Millimetre
        } else {
            Self::HalfLength
        }
    }

    fn said(self, error: f64) -> String {
        match self {
            Self::HalfLength => format!("{} ‰", short(1e3 * error)),
            Self::Millimetre => format!("{} µm", short(1e3 * error)),
        }
    }

    fn axis(self) -> &'static str {
        match self {
            Self::HalfLength => "median RMSE over the half length",
            Self::Millimetre => "median RMSE, mm",
        }
    }
}

const OURS: &str = "bladescan";
const NOTE: &str = "Same files, same errors, all from the identity (views of a reconstruction: from the same disturbed start), one process after the other, whose order turns from case \
    to case; with 1 thread each is held to one core. Medians over cases of the medians over repeats; ratios are the medians of each case's own. ‰: thousandths of the half length. \
    Times leave reading out; the other programs' leave out starting Python and loading it, too. A view of a reconstruction is right if it is merged less than 0.15 mm off. Settings \
    and what is not fair: `experiments/peers/README.md`.";

#[cfg(test)]
mod tests {
    use super::*;

    const CASES: &str = "\
method,threads,case,exp,model,level,seed,success,rot_deg,trans,rmse,seconds,repeat,wall_s
bladescan,1,a,noise,lpt,0.02,1,1,0,0,0.001,0.1,0,0.2
bladescan,1,a,noise,lpt,0.02,1,1,0,0,0.001,0.3,1,0.2
bladescan,1,a,noise,lpt,0.02,1,1,0,0,0.001,0.2,2,0.2
bladescan,1,b,noise,lpt,0.02,2,1,0,0,0.002,0.4,0,0.5
bladescan,1,c,noise,lpt,0.02,3,1,0,0,0.003,0.4,0,0.5
icp,1,a,noise,lpt,0.02,1,0,0,0,nan,0.4,0,0.5
icp,1,b,noise,lpt,0.02,2,1,0,0,0.006,0.4,0,0.5
icp,1,c,noise,lpt,0.02,3,1,0,0,0.003,0.2,0,0.5
icp,2,c,noise,lpt,0.02,3,1,0,0,0.003,0.2,0,0.5
";

    #[test]
    fn a_peer_is_compared_case_by_case_with_ours_of_as_many_threads() {
        let item = compared(&read::registrations(CASES).unwrap());
        assert_eq!(item.rows.len(), 9);
        assert_eq!(item.summary.len(), 1);
        let row = &item.summary[0];
        assert_eq!(row.what, "noise 0.02, 1 thread, icp");
        assert_eq!(row.ours, "2.00 ‰, 400 ms, 3 of 3 right");
        // Errors: nothing found, 0.006 and 0.003; ratios: infinite, 3 and 1.
        assert_eq!(row.peer, "6.00 ‰, 400 ms, 2 of 3 right");
        // Times: 0.4 to 0.2 (the middle of three repeats), 0.4 to 0.4, 0.2 to 0.4.
        assert_eq!(
            row.verdict,
            "theirs to ours: error × 3.00 (their lowest), time × 1.00 (their fastest)"
        );
    }

    #[test]
    fn a_reconstruction_is_all_its_views_and_the_first_has_no_error() {
        let text = "\
method,threads,repeat,view,merged,rms_mm,seconds
bladescan,1,0,0,1,0.0,0.5
bladescan,1,0,1,1,0.003,1.0
bladescan,1,0,2,1,0.004,1.0
gicp,1,0,0,1,0.0,0.5
gicp,1,0,1,1,0.3,0.25
gicp,1,0,2,1,0.4,0.25
";
        let rows = read::reconstructions("lpt", text).unwrap();
        let whole: Vec<&Row> = rows.iter().filter(|row| row.group == "lpt, whole").collect();
        assert_eq!(rows.len(), 4 + whole.len());
        assert_eq!((whole[0].seconds, whole[0].is_right), (2.5, true));
        assert!((whole[0].error - 12.5e-6f64.sqrt()).abs() < 1e-12);
        assert_eq!((whole[1].seconds, whole[1].is_right), (1.0, false));
        let summary = compared(&rows).summary;
        assert_eq!(summary[0].what, "lpt, a view, 1 thread, gicp");
        assert_eq!(
            summary[0].verdict,
            "theirs to ours: error × 100 (their lowest), time × 0.250 (their fastest)"
        );
        assert_eq!(
            summary[1].verdict,
            "theirs to ours: error × 100 (their lowest), time × 0.400 (their fastest)"
        );
    }
}
