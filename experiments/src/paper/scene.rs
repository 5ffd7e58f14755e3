//! Clouds side by side as SVG text: dots in a panel each, one colour a cloud, with a bar that tells the scale.

use std::fmt::Write as _;

use super::svg::{COLOURS, text};

/// Panels in a row under one title.
pub(crate) struct Scene {
    pub(crate) title: String,
    /// Names of the first clouds of every panel; more than these are grey.
    pub(crate) legend: Vec<String>,
    pub(crate) panels: Vec<Panel>,
}

/// One picture of clouds.
pub(crate) struct Panel {
    pub(crate) caption: String,
    /// Places in mm, to the right and up.
    pub(crate) clouds: Vec<Vec<[f64; 2]>>,
    /// The part that is shown, its middle and its half width in mm; all of it otherwise.
    pub(crate) window: Option<([f64; 2], f64)>,
    /// The length of the bar, mm.
    pub(crate) bar_mm: f64,
}

impl Scene {
    pub(crate) fn svg(&self) -> String {
        let width = SIDE * self.panels.len() as f64;
        let mut out = format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width} {HEIGHT}\" width=\"{width}\" height=\"{HEIGHT}\" \
             font-family=\"sans-serif\" font-size=\"13\">\n<rect width=\"{width}\" height=\"{HEIGHT}\" fill=\"white\"/>\n"
        );
        out += &text([12.0, 22.0], "start", &self.title);
        let has_others = self.panels.iter().any(|panel| panel.clouds.len() > self.legend.len());
        let others = has_others.then(|| "others".to_owned());
        for (index, name) in self.legend.iter().chain(&others).enumerate() {
            let x = 12.0 + 90.0 * index as f64;
            let _ = writeln!(
                out,
                "<rect x=\"{x}\" y=\"{}\" width=\"12\" height=\"12\" fill=\"{}\"/>",
                HEIGHT - 20.0,
                self.colour(index)
            );
            out += &text([x + 17.0, HEIGHT - 9.0], "start", name);
        }
        for (index, panel) in self.panels.iter().enumerate() {
            out += &self.panel(panel, SIDE * index as f64);
        }
        out += "</svg>\n";
        out
    }

    fn panel(&self, panel: &Panel, left: f64) -> String {
        let (middle, half) = panel.window.unwrap_or_else(|| panel.whole());
        let scale = (SIDE / 2.0 - GAP) / half;
        let centre = [left + SIDE / 2.0, TOP + SIDE / 2.0];
        let dot = if panel.window.is_some() { 2.2 } else { 1.3 };
        let mut out = text([centre[0], TOP - 8.0], "middle", &panel.caption);
        // The others lie under the others.
        for (index, cloud) in panel.clouds.iter().enumerate().rev() {
            let _ = write!(
                out,
                "<path stroke=\"{}\" stroke-width=\"{dot}\" stroke-linecap=\"round\" d=\"",
                self.colour(index)
            );
            for [x, y] in cloud {
                let [x, y] = [x - middle[0], y - middle[1]];
                if x.abs() <= half && y.abs() <= half {
                    let _ = write!(out, "M{:.1} {:.1}h0", centre[0] + scale * x, centre[1] - scale * y);
                }
            }
            out += "\"/>\n";
        }
        let side = SIDE - 2.0 * GAP;
        let _ = writeln!(
            out,
            "<rect x=\"{}\" y=\"{}\" width=\"{side}\" height=\"{side}\" fill=\"none\" stroke=\"#bbb\"/>",
            left + GAP,
            TOP + GAP
        );
        let (right, bottom) = (left + SIDE - GAP - 8.0, TOP + SIDE - GAP - 8.0);
        let _ = writeln!(
            out,
            "<path d=\"M{right:.1} {bottom:.1}h{:.1}\" stroke=\"#000\" stroke-width=\"3\"/>",
            -scale * panel.bar_mm
        );
        out += &text([right, bottom - 6.0], "end", &format!("{} mm", panel.bar_mm));
        out
    }

    fn colour(&self, index: usize) -> &'static str {
        if index < self.legend.len() {
            COLOURS[index % COLOURS.len()]
        } else {
            "#aaa"
        }
    }
}

impl Panel {
    /// Middle and half width of a square that holds every place.
    fn whole(&self) -> ([f64; 2], f64) {
        let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        for place in self.clouds.iter().flatten() {
            for axis in 0..2 {
                low[axis] = low[axis].min(place[axis]);
                high[axis] = high[axis].max(place[axis]);
            }
        }
        let half = (high[0] - low[0]).max(high[1] - low[1]) / 2.0;
        let middle = [(low[0] + high[0]) / 2.0, (low[1] + high[1]) / 2.0];
        (
            middle,
            if half.is_finite() {
                half.max(f64::MIN_POSITIVE)
            } else {
                1.0
            },
        )
    }
}

const SIDE: f64 = 260.0;
const TOP: f64 = 58.0;
const GAP: f64 = 6.0;
const HEIGHT: f64 = TOP + SIDE + 30.0;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_scene_shows_what_lies_in_each_window_to_scale() {
        let panel = |window| Panel {
            caption: "a < b".to_owned(),
            clouds: vec![vec![[-10.0, 0.0], [10.0, 0.0]], vec![[0.0, 3.0]]],
            window,
            bar_mm: 5.0,
        };
        let scene = Scene {
            title: "two".to_owned(),
            legend: vec!["view 0".to_owned()],
            panels: vec![panel(None), panel(Some(([0.0, 3.0], 1.0)))],
        };
        let svg = scene.svg();
        // All three dots in the first panel, one in the second.
        assert_eq!(svg.matches("h0").count(), 4);
        // 20 mm fill the first panel but for the gaps: 5 mm are a quarter of it.
        assert!(svg.contains(&format!("h-{:.1}\"", (SIDE - 2.0 * GAP) / 4.0)), "{svg}");
        assert!(svg.contains(">a &lt; b</text>") && svg.contains(">view 0</text>"));
        // The second cloud of both panels, and what the colour means.
        assert_eq!(svg.matches("#aaa").count(), 3);
        assert!(svg.contains(">others</text>"));
    }
}
