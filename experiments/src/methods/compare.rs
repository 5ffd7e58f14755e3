//! The methods side by side: a table by method and level, and a row a case.

use std::collections::BTreeMap;
use std::error::Error;
use std::fs;
use std::io::Write;
use std::path::PathBuf;
use std::time::Instant;

use bladescan::geometry::PointCloud;
use clap::{Args, ValueEnum};
use rayon::{ThreadPool, ThreadPoolBuilder};

use super::Method;
use crate::cases::{self, Case, Errors};

/// Registers every case folder under a root by one method after the other.
#[derive(Args)]
pub(crate) struct MethodsArguments {
    /// Where the case folders are, at any depth.
    root: PathBuf,
    /// Which methods, all if none is named; may be repeated.
    #[arg(long = "method", value_name = "NAME")]
    methods: Vec<Method>,
    /// Only cases of these levels, as `meta.txt` names them; may be repeated.
    #[arg(long = "level", value_name = "LEVEL")]
    levels: Vec<String>,
    /// Only the cases of each level that come first, this many.
    #[arg(long)]
    count: Option<usize>,
    /// Only every N-th point of both clouds.
    #[arg(long, default_value_t = 1)]
    every: usize,
    /// Threads; as many as there are cores if not given.
    #[arg(long)]
    threads: Option<usize>,
    /// Where to write a row for each case and method.
    #[arg(long)]
    csv: Option<PathBuf>,
}

pub(crate) fn run(arguments: &MethodsArguments) -> Result<(), Box<dyn Error>> {
    let pool = ThreadPoolBuilder::new()
        .num_threads(arguments.threads.unwrap_or(0))
        .build()?;
    let methods = match arguments.methods.as_slice() {
        [] => Method::value_variants(),
        chosen => chosen,
    };
    let mut rows = String::from(COLUMNS);
    let mut groups: BTreeMap<(usize, String), Vec<Outcome>> = BTreeMap::new();
    for case in chosen(arguments)? {
        let relative = case.folder.strip_prefix(&arguments.root)?.display().to_string();
        for (order, &method) in methods.iter().enumerate() {
            let outcome = measure(&case, method, &pool, arguments.every)?;
            rows += &outcome.row(method, pool.current_num_threads(), &case, &relative);
            let level = format!("{} {}", key(&case, "exp"), key(&case, "level"));
            groups.entry((order, level)).or_default().push(outcome);
        }
    }
    if let Some(path) = &arguments.csv {
        fs::write(path, rows)?;
    }
    print(methods, &groups)
}

/// The cases of the levels that are wanted, at most so many of each.
fn chosen(arguments: &MethodsArguments) -> Result<Vec<Case>, Box<dyn Error>> {
    let mut counts: BTreeMap<(String, String), usize> = BTreeMap::new();
    let mut cases = cases::find(&arguments.root, None)?;
    cases.retain(|case| {
        let level = key(case, "level");
        let is_wanted = arguments.levels.is_empty() || arguments.levels.contains(&level);
        let count = counts.entry((key(case, "exp"), level)).or_default();
        *count += usize::from(is_wanted);
        is_wanted && arguments.count.is_none_or(|most| *count <= most)
    });
    Ok(cases)
}

struct Outcome {
    errors: Errors,
    seconds: f64,
}

fn measure(case: &Case, method: Method, pool: &ThreadPool, every: usize) -> Result<Outcome, Box<dyn Error>> {
    let thinned = |name: &str| -> Result<PointCloud, Box<dyn Error>> {
        let cloud = cases::cloud(&case.folder.join(name))?;
        let indices: Vec<usize> = (0..cloud.len()).step_by(every.max(1)).collect();
        Ok(cloud.select(&indices))
    };
    let (source, target) = (thinned("source.ply")?, thinned("target.ply")?);
    let begun = Instant::now();
    let estimate = pool.install(|| method.estimate(&source, &target));
    let seconds = begun.elapsed().as_secs_f64();
    Ok(Outcome {
        errors: cases::errors(case, &source, &estimate),
        seconds,
    })
}

impl Outcome {
    fn row(&self, method: Method, thread_count: usize, case: &Case, relative: &str) -> String {
        format!(
            "{},{thread_count},{relative},{},{},{},{},{},{:.9},{:.9},{:.9},{:.4}\n",
            method.name(),
            key(case, "exp"),
            key(case, "model"),
            key(case, "level"),
            key(case, "seed"),
            u8::from(self.errors.success),
            self.errors.rotation_deg,
            self.errors.translation,
            self.errors.rmse,
            self.seconds
        )
    }
}

fn print(methods: &[Method], groups: &BTreeMap<(usize, String), Vec<Outcome>>) -> Result<(), Box<dyn Error>> {
    let mut out = std::io::stdout().lock();
    writeln!(
        out,
        "{:<10} {:<16} {:>6} {:>6} {:>12} {:>12} {:>12} {:>9} {:>8}",
        "method", "level", "cases", "right", "median deg", "median trans", "median rmse", "median s", "worst s"
    )?;
    for ((order, level), outcomes) in groups {
        let of = |value: fn(&Outcome) -> f64| cases::median(outcomes.iter().map(value).collect());
        writeln!(
            out,
            "{:<10} {level:<16} {:>6} {:>6} {:>12.5} {:>12.6} {:>12.6} {:>9.3} {:>8.3}",
            methods[*order].name(),
            outcomes.len(),
            outcomes.iter().filter(|outcome| outcome.errors.success).count(),
            of(|outcome| outcome.errors.rotation_deg),
            of(|outcome| outcome.errors.translation),
            of(|outcome| outcome.errors.rmse),
            of(|outcome| outcome.seconds),
            outcomes.iter().map(|outcome| outcome.seconds).fold(0.0, f64::max),
        )?;
    }
    Ok(())
}

fn key(case: &Case, name: &str) -> String {
    case.meta.get(name).cloned().unwrap_or_default()
}

/// As `experiments/peers/peers.py` writes them.
const COLUMNS: &str = "method,threads,case,exp,model,level,seed,success,rot_deg,trans,rmse,seconds\n";
