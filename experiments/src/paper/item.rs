//! What one table or figure gives.

use serde_json::{Value, json};

use super::svg::Plot;

/// Numbers, plots and the comparison with the paper.
pub(crate) struct Item {
    pub(crate) columns: Vec<&'static str>,
    pub(crate) rows: Vec<Vec<String>>,
    /// SVG text with the part of the file's name that follows the label; empty for the only one.
    pub(crate) pictures: Vec<(String, String)>,
    pub(crate) summary: Vec<Summary>,
    /// What a reader has to know besides: how this differs from the paper's.
    pub(crate) notes: Vec<String>,
}

/// One comparison with the paper.
pub(crate) struct Summary {
    pub(crate) what: String,
    pub(crate) paper: String,
    /// What the best of the others gives, where there are others.
    pub(crate) peer: String,
    pub(crate) ours: String,
    pub(crate) verdict: String,
}

impl Item {
    pub(crate) fn new(columns: &[&'static str], note: impl Into<String>) -> Self {
        Self {
            columns: columns.to_vec(),
            rows: Vec::new(),
            pictures: Vec::new(),
            summary: Vec::new(),
            notes: vec![note.into()],
        }
    }

    /// Adds a plot.
    pub(crate) fn plot(&mut self, part: impl Into<String>, plot: &Plot) {
        self.pictures.push((part.into(), plot.svg()));
    }

    /// A line of column names, then the rows.
    pub(crate) fn csv(&self) -> String {
        let rows = self.rows.iter().map(|row| row.join(",") + "\n");
        self.columns.join(",") + "\n" + &rows.collect::<String>()
    }
}

impl Summary {
    pub(crate) fn new(
        what: impl Into<String>,
        paper: impl Into<String>,
        ours: impl Into<String>,
        verdict: impl Into<String>,
    ) -> Self {
        Self {
            what: what.into(),
            paper: paper.into(),
            peer: "-".to_owned(),
            ours: ours.into(),
            verdict: verdict.into(),
        }
    }

    pub(crate) fn with_peer(self, peer: impl Into<String>) -> Self {
        Self {
            peer: peer.into(),
            ..self
        }
    }

    pub(crate) fn json(&self) -> Value {
        json!({ "what": self.what, "paper": self.paper, "peer": self.peer, "ours": self.ours, "verdict": self.verdict })
    }
}

/// Three digits that count.
pub(crate) fn short(value: f64) -> String {
    if value == 0.0 || !value.is_finite() {
        return value.to_string();
    }
    let digits = (2 - value.abs().log10().floor() as i32).clamp(0, 9) as usize;
    format!("{value:.digits$}")
}

/// A time as one reads it.
pub(crate) fn duration(seconds: f64) -> String {
    match seconds {
        s if s < 1.0 => format!("{} ms", short(1e3 * s)),
        s if s < 120.0 => format!("{} s", short(s)),
        s if s < 7200.0 => format!("{} min", short(s / 60.0)),
        s => format!("{} h", short(s / 3600.0)),
    }
}
