//! One page out of the files that `experiments paper` leaves.

use std::error::Error;
use std::fs;
use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};
use serde_json::Value;

use super::{Label, peers};

/// Writes the page of a folder of results.
#[derive(Args)]
pub(crate) struct PageArguments {
    /// Where the `LABEL.json` are.
    folder: PathBuf,
    /// The page to write [default: RESULTS.md in the folder].
    #[arg(long)]
    page: Option<PathBuf>,
}

pub(crate) fn run(arguments: &PageArguments) -> Result<(), Box<dyn Error>> {
    let page = arguments
        .page
        .clone()
        .unwrap_or_else(|| arguments.folder.join("RESULTS.md"));
    let beside = page.parent().unwrap_or(Path::new(""));
    let prefix = arguments.folder.strip_prefix(beside).unwrap_or(&arguments.folder);
    let mut text = String::from(HEAD);
    let labels = Label::value_variants()
        .iter()
        .map(|label| (label.name(), label.title()));
    for (name, title) in labels.chain([(peers::NAME.to_owned(), peers::TITLE)]) {
        let path = arguments.folder.join(format!("{name}.json"));
        if path.exists() {
            text += &section(&serde_json::from_slice(&fs::read(path)?)?, prefix)?;
        } else {
            text += &format!("\n## {name}: {title}\n\nTo come.\n");
        }
    }
    for (name, what) in TO_COME {
        text += &format!("\n## {name}: {what}\n\nTo come.\n");
    }
    text += TAIL;
    fs::write(page, text)?;
    Ok(())
}

/// What one file says; plots are linked under `prefix`.
fn section(document: &Value, prefix: &Path) -> Result<String, Box<dyn Error>> {
    let field = |value: &Value, name: &str| -> Result<String, Box<dyn Error>> {
        match &value[name] {
            Value::String(text) => Ok(text.clone()),
            Value::Number(number) => Ok(number.to_string()),
            _ => Err(format!("`{name}` is missing").into()),
        }
    };
    let list = |name: &str| document[name].as_array().ok_or_else(|| format!("`{name}` is missing"));
    let mut text = format!("\n## {}: {}\n\n", field(document, "label")?, field(document, "title")?);
    text += "| what | paper | peer | ours | verdict |\n|---|---|---|---|---|\n";
    for row in list("summary")? {
        let cells = ["what", "paper", "peer", "ours", "verdict"].map(|name| field(row, name));
        for cell in cells {
            text += &format!("| {} ", cell?.replace('|', "\\|"));
        }
        text += "|\n";
    }
    text.push('\n');
    for note in list("notes")? {
        text += &format!("{}\n\n", note.as_str().ok_or("a note is not text")?);
    }
    text += &format!(
        "`{}`, version {}, revision {}, {} threads on {} cores, {:.0} s.\n",
        field(document, "command")?,
        field(document, "version")?,
        field(document, "revision")?,
        field(document, "threads")?,
        field(document, "cores")?,
        document["wall_s"].as_f64().ok_or("`wall_s` is missing")?,
    );
    if document["quick"].as_bool().ok_or("`quick` is missing")? {
        text += "**A quick run: few levels and points; not to be quoted.**\n";
    }
    let plots: Vec<String> = list("plots")?
        .iter()
        .filter_map(Value::as_str)
        .map(|plot| format!("[{plot}]({})", prefix.join(plot).display()))
        .collect();
    if !plots.is_empty() {
        text += &format!("\nPlots: {}.\n", plots.join(", "));
    }
    Ok(text)
}

const HEAD: &str = "# The paper's tables and figures\n\n\
    Four lofted blades stand in for the paper's CAD models, and views come from our simulator: the paper's blades and scans are not public.\n\
    So numbers are compared with the paper's claims, not blade by blade. Clouds are normalised to a longest half side of 1, which the paper calls a metre.\n\
    The other methods are written anew from their papers. Written by `experiments paper-page`.\n";

const TAIL: &str = "\n## What is not reproduced, and why\n\n\
    - The paper's blades, scans and programs: none is public. Where its figures hang on its own data (which noise a blade forgives, which views overlap), ours can only be like them.\n\
    - \"Lowest by at least 45.5 %\" (fig2): not by the paper's two stages, and not by anything else. The mixtures come within a few percent of the most likely pose, \
    below which nobody can be by much; trimmed ICP, the paper's second stage, takes nearest points for true pairs, which noise makes wrong.\n\
    - 0.10 to 0.12 mm at a noise of 20 mm and 3,000 points (ab): below what known correspondences give, about σ √(6/N) = 0.9 mm, so it cannot be the RMSE of an alignment.\n\
    - Error and variance by sampling ratio (tc, ET) without a single blade laid end to end: over rotations to 90 degrees some falls end so at every ratio. Without them our figures are the paper's in kind.\n\
    - The paper's times (MPEL, ab, time): an Intel i5 at 3.4 GHz, no language named. The other methods, too, are tens to hundreds of times faster here, so a ratio to the paper's seconds \
    speaks of programs more than of methods; the column of peers is the fair one.\n\
    - The paper's true poses (UWAe1): aligned by hand and refined by ICP, so its errors hold those of an ICP. Ours are the simulator's own.\n";

/// What is not computed yet.
const TO_COME: &[(&str, &str)] = &[
    ("uwae2", "Errors of cross-sections (Table UWAe2)"),
    ("fig511", "Error chromatogram of cross-sections (Fig. fig511)"),
];

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn document() -> Value {
        json!({
            "label": "ab", "title": "Ablation", "command": "experiments paper ab", "seed": 1, "repeats": 2, "quick": false,
            "cores": 2, "threads": 2, "version": "1.2.3", "revision": "abc", "wall_s": 3.4, "notes": ["A note."], "plots": ["ab.svg"],
            "summary": [{ "what": "500 points", "paper": "0.11 mm", "peer": "-", "ours": "1.3 mm", "verdict": "no | yes" }],
        })
    }

    #[test]
    fn what_a_file_says_is_a_row_with_its_command_and_plots() {
        let text = section(&document(), Path::new("results")).unwrap();
        assert!(
            text.contains("| 500 points | 0.11 mm | - | 1.3 mm | no \\| yes |\n"),
            "{text}"
        );
        assert!(
            text.contains("`experiments paper ab`, version 1.2.3, revision abc, 2 threads on 2 cores, 3 s."),
            "{text}"
        );
        assert!(
            text.contains("[ab.svg](results/ab.svg)") && !text.contains("quick run"),
            "{text}"
        );
    }

    #[test]
    fn a_file_without_its_summary_is_refused() {
        let mut document = document();
        document["summary"] = Value::Null;
        assert!(section(&document, Path::new("")).is_err());
    }
}
