//! `bladescan camera frame`.

use super::super::{Exit, Failure, print};
use super::{Place, Source};
use crate::camera::{Capture, Pictures, TriggerId};
use crate::geometry::PointCloud;
use crate::geometry::ply::write_ply;
use nalgebra::Point3;
use std::path::{Path, PathBuf};

#[derive(Debug, clap::Args)]
pub(super) struct Args {
    #[command(flatten)]
    place: Place,
    /// What to write: a cloud in NAME.ply, or pictures in NAME-depth.png and NAME-intensity.png.
    #[arg(long, value_name = "NAME.ply|NAME.png", value_parser = parse_out)]
    out: PathBuf,
    #[command(flatten)]
    source: Source,
}

pub(super) fn main(args: &Args, json: bool) -> Result<Exit, Failure> {
    let recipe = args.source.read()?;
    let mut visit = args.place.control()?;
    let caps = visit.caps()?;
    let settings = args.source.settings(recipe.as_ref(), &caps);
    let configured = visit.configure(&settings)?;
    let capture = visit.capture(&configured, TriggerId::new(0, 0));
    let simulated = visit.greeting().simulated;
    visit.leave();
    let capture = capture?;
    let files = match is_ply(&args.out) {
        true => vec![(args.out.clone(), cloud(&capture, simulated))],
        false => {
            let pictures = Pictures::draw(&capture);
            let intensity = pictures.intensity_png.map(|png| (beside(&args.out, "intensity"), png));
            let depth = (beside(&args.out, "depth"), pictures.depth_png);
            [Some(depth), intensity].into_iter().flatten().collect()
        }
    };
    for (path, bytes) in &files {
        std::fs::write(path, bytes)
            .map_err(|error| Failure::Usage(format!("cannot write {}: {error}", path.display())))?;
    }
    let names: Vec<String> = files.iter().map(|(path, _)| path.display().to_string()).collect();
    if json {
        let document = serde_json::json!({
            "width_px": capture.width_px,
            "height_px": capture.height_px,
            "valid_count": capture.valid_count,
            "saturated_count": capture.saturated_count,
            "simulated": simulated,
            "files": names,
        });
        print(&document.to_string())?;
    } else {
        let pixels = capture.width_px * capture.height_px;
        let note = if simulated { "SIMULATED, " } else { "" };
        print(&format!(
            "{note}{} x {} px, {} of {pixels} with 3D, {} saturated: {}",
            capture.width_px,
            capture.height_px,
            capture.valid_count,
            capture.saturated_count,
            names.join(", ")
        ))?;
    }
    Ok(Exit::Done)
}

fn cloud(capture: &Capture, simulated: bool) -> Vec<u8> {
    let grid = capture.grid();
    let points = grid.points().flatten().map(|point| Point3::from(point.map(f64::from)));
    let comments: &[&str] = match simulated {
        true => &["mm, camera frame", "SIMULATED: nothing was measured"],
        false => &["mm, camera frame"],
    };
    write_ply(&PointCloud::from_measured(points).cloud, comments)
}

fn is_ply(path: &Path) -> bool {
    path.extension()
        .is_some_and(|ending| ending.eq_ignore_ascii_case("ply"))
}

/// `blade.png` becomes `blade-depth.png`.
fn beside(path: &Path, what: &str) -> PathBuf {
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    path.with_file_name(format!("{stem}-{what}.png"))
}

fn parse_out(text: &str) -> Result<PathBuf, String> {
    let path = PathBuf::from(text);
    let is_png = path
        .extension()
        .is_some_and(|ending| ending.eq_ignore_ascii_case("png"));
    match is_png || is_ply(&path) {
        true => Ok(path),
        false => Err("give a name that ends in .ply or .png".into()),
    }
}
