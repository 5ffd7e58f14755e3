//! `bladescan reconstruct`.

use super::files::{default_dir, make_run_dir, read_recipe};
use super::live_run::{exit, target};
use super::{Exit, Failure, print};
use crate::controller::{Header, Reconstructed, Source};
use crate::job::sha256;
use crate::journal::Recording;
use crate::run::{Console, Pool, reconstruct, write_files};
use crate::settings::Recipe;
use std::path::{Path, PathBuf};
use std::time::SystemTime;

#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// The recording of a run; its end may be missing.
    #[arg(long, value_name = "RUN.mcap")]
    from: PathBuf,
    /// How to clean, register and merge; it must plan as many views [default: the recipe in the recording].
    #[arg(long, value_name = "OTHER.toml")]
    recipe: Option<PathBuf>,
    /// Folder for the files; must not exist [default: runs/<recipe>-<UTC time>-reconstructed].
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Print summary.json to standard output.
    #[arg(long)]
    json: bool,
}

pub(super) fn main(args: &Args) -> Result<Exit, Failure> {
    let bytes = std::fs::read(&args.from).map_err(|source| Failure::Read {
        path: args.from.clone(),
        source,
    })?;
    let unusable = |error: String| Failure::Usage(format!("{}: {error}", args.from.display()));
    let recording = Recording::open(&bytes).map_err(|error| unusable(error.to_string()))?;
    let (recipe, recipe_text) = recipe(args, &recording)?;
    let source = Source {
        file: file_name(&args.from),
        sha256: sha256(&bytes),
    };
    let header = Header {
        version: env!("CARGO_PKG_VERSION").into(),
        target: target(),
        recipe: recipe.name.clone(),
        recipe_sha256: sha256(recipe_text.as_bytes()),
        ..recording.header().clone()
    };
    let dir = make_dir(args, &recipe)?;
    let done = register(&recording, header, source, &recipe).map_err(|failure| {
        // Nothing was written, so the folder just made is empty.
        std::fs::remove_dir(&dir).ok();
        match failure {
            Failure::Usage(text) => unusable(text),
            other => other,
        }
    })?;
    write_files(&dir, &done.files).map_err(|error| Failure::Broken(error.to_string()))?;
    tell(args, &dir, &done)
}

/// The recipe and its text.
fn recipe(args: &Args, recording: &Recording<'_>) -> Result<(Recipe, String), Failure> {
    match &args.recipe {
        Some(path) => read_recipe(path).map(|read| (read.meaning, read.text)),
        None => {
            let text = recording.recipe_text();
            let recipe = Recipe::parse("recipe.toml", text).map_err(|error| Failure::Settings(Box::new(error)))?;
            Ok((recipe, text.to_owned()))
        }
    }
}

fn make_dir(args: &Args, recipe: &Recipe) -> Result<PathBuf, Failure> {
    let now = SystemTime::now();
    let out = args.out.clone().unwrap_or_else(|| {
        let mut name = default_dir(recipe, now).into_os_string();
        name.push("-reconstructed");
        name.into()
    });
    make_run_dir(Some(&out), recipe, now)
}

/// Registers the views; shows how far it is.
fn register(
    recording: &Recording<'_>,
    header: Header,
    source: Source,
    recipe: &Recipe,
) -> Result<Reconstructed, Failure> {
    let pool = Pool::new().map_err(|error| Failure::Broken(format!("cannot start threads: {error}")))?;
    let mut console = Console::new();
    let view_count = header
        .view_count
        .map_or(recipe.view_count(), |count| count.min(recipe.view_count()));
    let text = format!("registering the views of {} under recipe {}", source.file, recipe.name);
    console.begin(&text, view_count);
    let done = reconstruct(recording, header, source, recipe, &pool, &mut |event| {
        console.show(event)
    });
    console.close();
    done.map_err(|error| Failure::Usage(error.to_string()))
}

fn tell(args: &Args, dir: &Path, done: &Reconstructed) -> Result<Exit, Failure> {
    let merged = done.views.iter().filter(|view| view.model_from_view().is_some());
    let merged_count = merged.count();
    if args.json
        && let Some((_, summary)) = done.files.iter().find(|(name, _)| *name == "summary.json")
    {
        print(String::from_utf8_lossy(summary).trim_end())?;
    }
    Console::new().say(&format!(
        "{merged_count} of {} views merged (at least {} wanted); files in {}",
        done.views.len(),
        done.merged_min_count,
        dir.display()
    ));
    Ok(exit(&done.ending, merged_count, done.merged_min_count))
}

fn file_name(path: &Path) -> String {
    path.file_name().map_or_else(
        || path.display().to_string(),
        |name| name.to_string_lossy().into_owned(),
    )
}
