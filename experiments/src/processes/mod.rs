//! Real runs of the real program, killed at random instants and resumed: what is lost, what moves twice?

mod judge;
mod proxy;
mod run;

use judge::{Tally, Wrong};
use std::io::Write as _;
use std::path::{Path, PathBuf};

#[derive(clap::Args)]
pub(super) struct ProcessesArguments {
    /// How many runs.
    #[arg(long, default_value_t = 100)]
    runs: u64,
    /// The first seed; each run has its own.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// The program; without it the one beside this.
    #[arg(long)]
    program: Option<PathBuf>,
    /// Keep the folders of the runs here.
    #[arg(long)]
    keep: Option<PathBuf>,
}

pub(super) fn run(arguments: &ProcessesArguments) -> Result<(), Box<dyn std::error::Error>> {
    let program = match &arguments.program {
        Some(program) => std::path::absolute(program)?,
        None => std::env::current_exe()?.with_file_name("bladescan"),
    };
    if !program.is_file() {
        return Err(format!(
            "{} is not there: build it, or name it with --program",
            program.display()
        )
        .into());
    }
    let own = std::env::temp_dir().join(format!("bladescan-processes-{}", std::process::id()));
    let root = arguments.keep.clone().unwrap_or_else(|| own.clone());
    std::fs::create_dir_all(&root)?;
    let unbroken = run::unbroken(&program, &root)?;
    let mut out = std::io::stdout().lock();
    let mut tally = Tally::default();
    for seed in arguments.seed..arguments.seed + arguments.runs {
        let wrongs = run::carry_out(&program, &root, seed, &unbroken, &mut tally)?;
        for Wrong(text) in &wrongs {
            writeln!(out, "seed {seed}: {text}")?;
        }
        tally.wrong_count += wrongs.len();
    }
    if arguments.keep.is_none() {
        std::fs::remove_dir_all(&own).ok();
    }
    tally.print(&mut out, arguments.runs)?;
    match tally.wrong_count {
        0 => Ok(()),
        count => Err(format!("{count} things that must not be").into()),
    }
}

/// What a run leaves as its result: poses and model.
#[derive(Debug, PartialEq)]
struct Results([Vec<u8>; 2]);

impl Results {
    fn read(dir: &Path) -> std::io::Result<Self> {
        let read = |name: &str| std::fs::read(dir.join(name));
        Ok(Self([read("poses.json")?, read("model.ply")?]))
    }
}
