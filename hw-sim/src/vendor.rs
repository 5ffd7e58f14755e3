//! The vendor's side of a bridge, simulated: a slanting plane, as an ESM block or a range image, for whoever speaks the
//! lines of `docs/protocols/bridge.md`. Nothing it gives was measured.

use std::fs;
use std::io::{self, BufRead, Write};
use std::path::{Path, PathBuf};

use serde_json::{Value, json};

/// How frames are laid out.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum Layout {
    /// One ESM block.
    Esm,
    /// A range image, its mask and its map.
    Range,
}

/// What the simulated vendor's side is to be.
#[derive(Debug, Clone, clap::Args)]
pub struct Args {
    /// How frames are laid out.
    #[arg(long, value_enum)]
    pub layout: Layout,
    /// Folder for the frames.
    pub folder: PathBuf,
}

/// Answers the lines of `orders` on `answers` until they end or say so. Frames go to the folder.
///
/// # Errors
///
/// A line is no JSON, or a file or line cannot be written.
pub fn serve(args: &Args, orders: impl BufRead, mut answers: impl Write) -> io::Result<()> {
    let layout = args.layout;
    let folder = &std::path::absolute(&args.folder)?;
    fs::create_dir_all(folder)?;
    say(
        &mut answers,
        &json!({
            "is": "ready", "vendor": "bladescan", "model": "simulated plane", "serial": "SIM-PLANE",
            "simulated": true, "says_exposed": true,
        }),
    )?;
    let mut size = (0, 0);
    for line in orders.lines() {
        let order: Value = serde_json::from_str(&line?)?;
        let acquisition = &order["acquisition"];
        match order["do"].as_str() {
            Some("configure") => {
                size = frame_size(&order["settings"]);
                say(
                    &mut answers,
                    &json!({"is": "configured", "config_id": order["config_id"],
                    "predicted_exposure_us": 100_000, "predicted_total_us": 500_000}),
                )?;
            }
            Some("acquire") => {
                say(&mut answers, &json!({"is": "exposed", "acquisition": acquisition}))?;
                let mut frame = write_frame(layout, folder, acquisition, size)?;
                frame["is"] = json!("frame");
                frame["acquisition"] = acquisition.clone();
                say(&mut answers, &frame)?;
            }
            Some("status") => say(
                &mut answers,
                &json!({"is": "status", "temperature_c": [35.5, 30.0, 30.25, null],
                "warm_up_done_s": 2400, "warm_up_required_s": 2400, "link_mbit_s": 1000}),
            )?,
            Some("end") => return Ok(()),
            _ => {}
        }
    }
    Ok(())
}

fn frame_size(settings: &Value) -> (u32, u32) {
    let length = |place: usize| settings["roi_px"][place].as_u64().unwrap_or(0) as u32;
    match settings["binning"].as_bool() {
        Some(true) => (720, 540),
        _ => (length(0), length(1)),
    }
}

/// The range value of a pixel; `None` in the first column, which nothing is seen in.
fn value(column: u32, row: u32) -> Option<u16> {
    (column > 0).then_some((20_000 + 5 * column + 2 * row) as u16)
}

/// Rows of the map from (column, row, value, 1) to millimetres.
const MAP: [[f64; 4]; 3] = [
    [0.25, 0.0, 0.0, -90.0],
    [0.0, 0.25, 0.0, -67.5],
    [0.0, 0.0, 0.0125, 0.0],
];

fn point(column: u32, row: u32, value: u16) -> [f32; 3] {
    MAP.map(|[a, b, c, offset]| (a * f64::from(column) + b * f64::from(row) + c * f64::from(value) + offset) as f32)
}

fn write_frame(layout: Layout, folder: &Path, acquisition: &Value, (width, height): (u32, u32)) -> io::Result<Value> {
    let pixels = || (0..height).flat_map(move |row| (0..width).map(move |column| (column, row)));
    let gray = format!("{acquisition}.gray");
    let picture: Vec<u8> = pixels().map(|(column, row)| (column + row) as u8).collect();
    fs::write(folder.join(&gray), picture)?;
    match layout {
        Layout::Esm => {
            let path = folder.join(format!("{acquisition}.esm"));
            fs::write(&path, esm(width, height))?;
            Ok(json!({"esm": path, "intensity": gray}))
        }
        Layout::Range => {
            let (values, mask) = (format!("{acquisition}.range"), format!("{acquisition}.mask"));
            let range: Vec<u8> = pixels()
                .flat_map(|(column, row)| value(column, row).unwrap_or(0).to_le_bytes())
                .collect();
            let seen: Vec<u8> = pixels()
                .map(|(column, row)| if value(column, row).is_some() { 255 } else { 0 })
                .collect();
            fs::write(folder.join(&values), range)?;
            fs::write(folder.join(&mask), seen)?;
            Ok(json!({
                "range": {"values": values, "mask": mask, "size_px": [width, height], "vendor_from_pixel": MAP},
                "intensity": gray,
            }))
        }
    }
}

/// An ESM block: header of 168 bytes, points of 16, rows filled up to 64.
fn esm(width: u32, height: u32) -> Vec<u8> {
    let mut block = vec![0u8; 168];
    block[0..4].copy_from_slice(&0xE5BE_7A00u32.to_le_bytes());
    block[4..6].copy_from_slice(&168u16.to_le_bytes());
    block[6] = 16;
    block[7] = 64;
    block[8..12].copy_from_slice(&width.to_le_bytes());
    block[12..16].copy_from_slice(&height.to_le_bytes());
    block[152..160].copy_from_slice(&168u64.to_le_bytes());
    for row in 0..height {
        for column in 0..width {
            let seen = value(column, row);
            for coordinate in point(column, row, seen.unwrap_or(0)) {
                block.extend_from_slice(&coordinate.to_le_bytes());
            }
            block.extend_from_slice(&[0, 0, 0, u8::from(seen.is_none())]);
        }
        let filled = (block.len() - 168).next_multiple_of(64) + 168;
        block.resize(filled, 0);
    }
    block
}

fn say(answers: &mut impl Write, answer: &Value) -> io::Result<()> {
    writeln!(answers, "{answer}")?;
    answers.flush()
}
