//! The paper's tables and figures, computed anew: a file of numbers, plots and a summary for each.
//!
//! The four lofted blades stand in for the paper's CAD models, normalised to a longest half side of 1. Everything drawn comes
//! from the seed; all but the times is the same at any number of threads.

mod ablation;
mod chain;
mod convergence;
mod fall;
mod fig2;
mod item;
mod line;
mod multiview;
pub(crate) mod page;
pub(crate) mod peers;
mod reconstruction;
mod scene;
mod section;
mod svg;

use std::error::Error;
use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Instant;

use clap::{Args, ValueEnum};
use serde_json::json;

use self::item::Item;

/// Computes tables and figures of the paper.
#[derive(Args)]
pub(crate) struct PaperArguments {
    /// The paper's labels, all if none is named.
    labels: Vec<Label>,
    /// Few levels, few points, two repeats: to see that it works, not for the page.
    #[arg(long)]
    quick: bool,
    /// Seeds everything drawn.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// How often each setting is drawn anew [default: 10, with `--quick` 2].
    #[arg(long)]
    repeats: Option<u32>,
    /// Where `LABEL.csv`, `LABEL.json` and the plots go; made if it is not there.
    #[arg(long, default_value = "paper-results")]
    out: PathBuf,
}

/// A table or figure, by the paper's label.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum Label {
    /// RMSE by noise, four blades.
    Fig2Noise,
    /// RMSE by number of outliers, four blades.
    Fig2Outliers,
    /// Error and time by sampling ratio.
    Et,
    /// Mean and variance of the error by sampling ratio.
    Tc,
    /// Time of MPE by number of points and sample.
    Mpel,
    /// Ablation: sample, motion control, ICP.
    Ab,
    /// Error between neighbouring dense views, four blades.
    Uwae1,
    /// Time to register a dense view, four blades.
    Time,
    /// Pictures of a reconstruction: as measured, coarse, fine.
    Fig52,
    /// The NFI criterion along a line, by ε².
    P4,
    /// The NFI criterion and the squared distance along a line, by outlier.
    P3,
    /// The NFI criterion and the squared distance of a blade's section, by turn and shift.
    P2,
}

impl Label {
    /// Its name on the command line and in file names.
    pub(crate) fn name(self) -> String {
        self.to_possible_value()
            .map_or_else(String::new, |value| value.get_name().to_owned())
    }

    fn title(self) -> &'static str {
        match self {
            Self::Fig2Noise => "Error by Gaussian noise (Fig. fig2, a to d)",
            Self::Fig2Outliers => "Error by number of outliers (Fig. fig2, e to h)",
            Self::Et => "Error and time by sampling ratio (Fig. ET)",
            Self::Tc => "Mean error and its variance by sampling ratio (Table tc)",
            Self::Mpel => "Time of MPE by number of points (Table MPEL)",
            Self::Ab => "Ablation (Table ab)",
            Self::Uwae1 => "Registration error of neighbouring views (Table UWAe1)",
            Self::Time => "Time to register a view (Table time)",
            Self::Fig52 => "Multiview reconstruction (Fig. fig52)",
            Self::P4 => "The NFI criterion along a line, by ε² (Fig. P4)",
            Self::P3 => "The NFI criterion and squared distances along a line, by outlier (Fig. P3)",
            Self::P2 => "The NFI criterion and squared distances of a blade's section (Fig. P2)",
        }
    }

    fn measure(self, effort: &Effort) -> Result<Item, Box<dyn Error>> {
        match self {
            Self::Fig2Noise => fig2::noise(effort),
            Self::Fig2Outliers => fig2::outliers(effort),
            Self::Et => convergence::by_ratio_in_time(effort),
            Self::Tc => convergence::by_ratio(effort),
            Self::Mpel => convergence::by_count(effort),
            Self::Ab => ablation::measure(effort),
            Self::Uwae1 => multiview::errors(effort),
            Self::Time => multiview::times(effort),
            Self::Fig52 => reconstruction::measure(effort),
            Self::P4 => Ok(line::by_softening()),
            Self::P3 => Ok(line::by_outlier()),
            Self::P2 => section::measure(effort),
        }
    }
}

/// How much is computed.
pub(crate) struct Effort {
    pub(crate) seed: u64,
    pub(crate) repeats: u32,
    pub(crate) quick: bool,
}

impl Effort {
    /// All of `full`, or every so many that two are left: the first of each half.
    fn some<'a, T>(&self, full: &'a [T]) -> Vec<&'a T> {
        let step = if self.quick { full.len().div_ceil(2) } else { 1 };
        full.iter().step_by(step).collect()
    }

    /// Points of a cloud: the paper's 3,000.
    fn point_count(&self) -> usize {
        if self.quick {
            QUICK_POINT_COUNT
        } else {
            crate::generate::POINT_COUNT
        }
    }
}

pub(crate) fn run(arguments: &PaperArguments) -> Result<(), Box<dyn Error>> {
    let labels = match arguments.labels.as_slice() {
        [] => Label::value_variants(),
        named => named,
    };
    let default = if arguments.quick { 2 } else { 10 };
    let effort = Effort {
        seed: arguments.seed,
        repeats: arguments.repeats.unwrap_or(default).max(1),
        quick: arguments.quick,
    };
    fs::create_dir_all(&arguments.out)?;
    let mut out = std::io::stdout().lock();
    for label in labels {
        let begun = Instant::now();
        let item = label.measure(&effort)?;
        let wall_s = begun.elapsed().as_secs_f64();
        write(&arguments.out, &Origin::of(*label, &effort), &item, wall_s)?;
        writeln!(out, "{}: {wall_s:.1} s", label.name())?;
        for row in &item.summary {
            writeln!(out, "  {} | {} | {} | {}", row.what, row.paper, row.ours, row.verdict)?;
        }
    }
    Ok(())
}

/// Where numbers come from.
struct Origin {
    /// In file names and as the section's heading.
    name: String,
    title: &'static str,
    command: String,
    seed: Option<u64>,
    repeats: u32,
    quick: bool,
}

impl Origin {
    fn of(label: Label, effort: &Effort) -> Self {
        let (name, quick) = (label.name(), if effort.quick { " --quick" } else { "" });
        Self {
            command: format!(
                "experiments paper {name}{quick} --seed {} --repeats {}",
                effort.seed, effort.repeats
            ),
            name,
            title: label.title(),
            seed: Some(effort.seed),
            repeats: effort.repeats,
            quick: effort.quick,
        }
    }
}

/// Writes `NAME.csv`, `NAME.json` and the pictures.
fn write(out: &Path, origin: &Origin, item: &Item, wall_s: f64) -> Result<(), Box<dyn Error>> {
    let name = &origin.name;
    let mut plots = Vec::new();
    for (part, picture) in &item.pictures {
        let file = if part.is_empty() {
            format!("{name}.svg")
        } else {
            format!("{name}-{part}.svg")
        };
        fs::write(out.join(&file), picture)?;
        plots.push(file);
    }
    fs::write(out.join(format!("{name}.csv")), item.csv())?;
    let document = json!({
        "label": name,
        "title": origin.title,
        "command": origin.command,
        "seed": origin.seed,
        "repeats": origin.repeats,
        "quick": origin.quick,
        "cores": std::thread::available_parallelism()?.get(),
        "threads": rayon::current_num_threads(),
        "version": env!("CARGO_PKG_VERSION"),
        "revision": revision(),
        "wall_s": wall_s,
        "notes": item.notes,
        "summary": item.summary.iter().map(item::Summary::json).collect::<Vec<_>>(),
        "plots": plots,
    });
    let text = serde_json::to_string_pretty(&document)? + "\n";
    fs::write(out.join(format!("{name}.json")), text)?;
    Ok(())
}

/// The commit of the folder that the program is called in, `-dirty` if something there differs from it.
fn revision() -> String {
    let words = ["describe", "--always", "--dirty", "--abbrev=9"];
    let said = Command::new("git").args(words).output().ok();
    let text = said.filter(|said| said.status.success()).map(|said| said.stdout);
    text.and_then(|text| String::from_utf8(text).ok())
        .map_or_else(|| "unknown".to_owned(), |text| text.trim().to_owned())
}

const QUICK_POINT_COUNT: usize = 600;
