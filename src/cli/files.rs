//! Reading recipes and stations, making the run's folder.

use super::Failure;
use crate::plan::Plan;
use crate::seed::Seed;
use crate::settings::{Cad, Recipe, Station};
use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};
use std::time::SystemTime;

/// A file's text and its meaning.
pub(super) struct Read<T> {
    pub(super) text: String,
    pub(super) meaning: T,
}

pub(super) fn read_recipe(path: &Path) -> Result<Read<Recipe>, Failure> {
    let text = read_text(path)?;
    let meaning =
        Recipe::parse(&path.display().to_string(), &text).map_err(|error| Failure::Settings(Box::new(error)))?;
    check_cad(path, &meaning.cad)?;
    Ok(Read { text, meaning })
}

fn check_cad(path: &Path, cad: &Cad) -> Result<(), Failure> {
    match cad {
        Cad::File(cad) => {
            let cad = beside(path, cad);
            if !cad.is_file() {
                return Err(Failure::Usage(format!(
                    "{}: blade.cad names {}, which is not there",
                    path.display(),
                    cad.display()
                )));
            }
        }
        #[cfg(feature = "sim")]
        Cad::Builtin(name) => {
            use hw_sim::blade::Builtin;
            if Builtin::from_name(name).is_none() {
                let known: Vec<String> = Builtin::ALL
                    .iter()
                    .map(|blade| format!("builtin:{}", blade.name()))
                    .collect();
                return Err(Failure::Usage(format!(
                    "{}: blade.cad names builtin:{name}, which there is not; there are {}",
                    path.display(),
                    known.join(", ")
                )));
            }
        }
        #[cfg(not(feature = "sim"))]
        Cad::Builtin(_) => {}
    }
    Ok(())
}

/// Reads the number of views of `--views`.
pub(super) fn parse_views(text: &str) -> Result<NonZeroUsize, String> {
    text.parse()
        .map_err(|_| "give a whole number from 1; more than the plan has means all of them".to_owned())
}

pub(super) fn read_station(path: &Path) -> Result<Read<Station>, Failure> {
    let text = read_text(path)?;
    let meaning =
        Station::parse(&path.display().to_string(), &text).map_err(|error| Failure::Settings(Box::new(error)))?;
    Ok(Read { text, meaning })
}

pub(super) fn builtin_station() -> Read<Station> {
    Read {
        text: Station::BUILTIN_SIMULATED_TEXT.to_owned(),
        meaning: Station::builtin_simulated(),
    }
}

/// The built-in station, if need be with another link or another way to move, each by its word in a station file.
pub(super) fn builtin_station_with(link: &str, motion: &str) -> Read<Station> {
    let station = builtin_station();
    if (link, motion) == ("hses", "direct") {
        return station;
    }
    let robot = format!("[robot]\nlink = \"{link}\"\nmotion = \"{motion}\"\n");
    let text = station.text.replacen("[robot]\n", &robot, 1);
    let meaning = Station::parse("the built-in station", &text).expect("its words are those of the station's keys");
    Read { text, meaning }
}

/// A path in a recipe is relative to the recipe's folder.
pub(super) fn beside(recipe_path: &Path, path: &Path) -> PathBuf {
    recipe_path.parent().unwrap_or(Path::new("")).join(path)
}

pub(super) fn plan(
    recipe: &Recipe,
    station: &Station,
    seed: Seed,
    views: Option<NonZeroUsize>,
) -> Result<Plan, Failure> {
    let plan = Plan::new(recipe, station, seed).map_err(|error| Failure::Usage(error.to_string()))?;
    Ok(match views {
        Some(views) => plan.truncated(views),
        None => plan,
    })
}

/// Makes the folder of a run: `out`, or `runs/<recipe>-<UTC time>`. An existing one is refused.
pub(super) fn make_run_dir(out: Option<&Path>, recipe: &Recipe, now: SystemTime) -> Result<PathBuf, Failure> {
    let dir = match out {
        Some(out) => out.to_owned(),
        None => default_dir(recipe, now),
    };
    if let Some(parent) = dir.parent().filter(|parent| !parent.as_os_str().is_empty()) {
        std::fs::create_dir_all(parent)
            .map_err(|error| Failure::Usage(format!("cannot create {}: {error}", parent.display())))?;
    }
    std::fs::create_dir(&dir).map_err(|error| match error.kind() {
        std::io::ErrorKind::AlreadyExists => Failure::Usage(format!(
            "{} exists: a run never writes into a folder that is there; give another one with --out",
            dir.display()
        )),
        _ => Failure::Usage(format!("cannot create {}: {error}", dir.display())),
    })?;
    Ok(dir)
}

/// `runs/<recipe>-<UTC time>`.
pub(super) fn default_dir(recipe: &Recipe, now: SystemTime) -> PathBuf {
    Path::new("runs").join(format!("{}-{}", recipe.name, compact_utc(now)))
}

/// For example `20261121T120000Z`.
fn compact_utc(now: SystemTime) -> String {
    humantime::format_rfc3339_seconds(now)
        .to_string()
        .replace(['-', ':'], "")
}

fn read_text(path: &Path) -> Result<String, Failure> {
    std::fs::read_to_string(path).map_err(|source| Failure::Read {
        path: path.to_owned(),
        source,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    #[test]
    fn folder_names_carry_the_utc_time() {
        let moment = SystemTime::UNIX_EPOCH + Duration::from_secs(1_795_262_400);
        assert_eq!(compact_utc(moment), "20261121T120000Z");
    }
}
