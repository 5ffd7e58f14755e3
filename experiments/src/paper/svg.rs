//! Plots as SVG text: axes with round ticks, lines with markers, and maps of a value over a plane.

use std::fmt::Write as _;

/// How values are laid along an axis.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Scale {
    Linear,
    Log,
}

/// What stands along an axis.
pub(crate) struct Axis {
    pub(crate) label: String,
    pub(crate) scale: Scale,
    /// What stands at 0, 1, ... instead of numbers, if anything.
    pub(crate) names: Vec<String>,
}

impl Axis {
    pub(crate) fn linear(label: &str) -> Self {
        Self {
            label: label.to_owned(),
            scale: Scale::Linear,
            names: Vec::new(),
        }
    }

    pub(crate) fn log(label: &str) -> Self {
        Self {
            scale: Scale::Log,
            ..Self::linear(label)
        }
    }

    /// Things without an order, at 0, 1, ...
    pub(crate) fn named(label: &str, names: &[&str]) -> Self {
        Self {
            names: names.iter().map(|name| (*name).to_owned()).collect(),
            ..Self::linear(label)
        }
    }

    /// Where ticks are, and what stands there; `range` is as the scale has it.
    fn ticks(&self, range: (f64, f64)) -> Vec<(f64, String)> {
        if self.names.is_empty() {
            let values = ticks(range, self.scale).into_iter();
            return values.map(|value| (value, number(value))).collect();
        }
        let names = self.names.iter().enumerate();
        names.map(|(place, name)| (place as f64, name.clone())).collect()
    }
}

/// How the points of a series are drawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Style {
    /// A line without markers.
    Line,
    /// A line with a marker at each point.
    Marked,
    /// Markers alone.
    Scatter,
    /// Small pale dots, for many points under other series.
    Cloud,
    /// A thick grey line without markers: a bound.
    Bound,
}

/// Points with one name.
pub(crate) struct Series {
    pub(crate) name: String,
    pub(crate) style: Style,
    pub(crate) points: Vec<[f64; 2]>,
}

impl Series {
    pub(crate) fn new(name: &str, style: Style, points: Vec<[f64; 2]>) -> Self {
        Self {
            name: name.to_owned(),
            style,
            points,
        }
    }
}

/// A value over a grid: rows from the lowest y up, columns from the lowest x on.
pub(crate) struct Map {
    /// What the colours stand for.
    pub(crate) label: String,
    pub(crate) x: [f64; 2],
    pub(crate) y: [f64; 2],
    pub(crate) rows: Vec<Vec<f64>>,
}

/// One plot.
pub(crate) struct Plot {
    pub(crate) title: String,
    pub(crate) x: Axis,
    pub(crate) y: Axis,
    pub(crate) series: Vec<Series>,
    pub(crate) map: Option<Map>,
}

impl Plot {
    /// The picture; points that are not finite, or not positive on a logarithmic axis, are left out.
    pub(crate) fn svg(&self) -> String {
        let frame = Frame::of(self);
        let mut out = format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {WIDTH} {HEIGHT}\" width=\"{WIDTH}\" height=\"{HEIGHT}\" \
             font-family=\"sans-serif\" font-size=\"13\">\n<rect width=\"{WIDTH}\" height=\"{HEIGHT}\" fill=\"white\"/>\n"
        );
        if let Some(map) = &self.map {
            out += &frame.map(map);
        }
        out += &frame.axes(self);
        for (index, series) in self.series.iter().enumerate() {
            out += &frame.series(series, index);
        }
        out += &self.legend();
        out += "</svg>\n";
        out
    }

    fn legend(&self) -> String {
        let mut out = String::new();
        let x = RIGHT + 20.0;
        for (index, series) in self.series.iter().enumerate() {
            let y = TOP + 10.0 + 22.0 * index as f64;
            let _ = write!(out, "{}", stroke(&[[x, y], [x + 34.0, y]], series.style, index));
            out += &mark([x + 17.0, y], series.style, index);
            out += &text([x + 42.0, y + 4.5], "start", &series.name);
        }
        if let Some(map) = &self.map {
            let (low, high) = extent(map.rows.iter().flatten().copied());
            let top = TOP + 40.0 + 22.0 * self.series.len() as f64;
            let step = (BOTTOM - top) / f64::from(BAND_COUNT);
            out += &text([x, top - 12.0], "start", &map.label);
            for band in 0..BAND_COUNT {
                let y = BOTTOM - step * f64::from(band + 1);
                let fill = colour(f64::from(band) / f64::from(BAND_COUNT - 1));
                let _ = writeln!(
                    out,
                    "<rect x=\"{x:.1}\" y=\"{y:.1}\" width=\"22\" height=\"{:.1}\" fill=\"{fill}\"/>",
                    step + 0.3
                );
            }
            out += &text([x + 28.0, BOTTOM], "start", &number(low));
            out += &text([x + 28.0, top + 10.0], "start", &number(high));
        }
        out
    }
}

/// Where values lie in the picture.
struct Frame {
    x: (f64, f64),
    y: (f64, f64),
    scales: [Scale; 2],
}

impl Frame {
    fn of(plot: &Plot) -> Self {
        let values = |axis: usize| {
            let map = plot.map.iter().flat_map(move |map| [map.x, map.y][axis]);
            let points = plot.series.iter().flat_map(|series| &series.points);
            map.chain(points.map(move |point| point[axis]))
        };
        let range = |axis: usize, scale: Scale| {
            let (low, high) = extent(values(axis).filter(|value| scale == Scale::Linear || *value > 0.0));
            let (low, high) = (scaled(low, scale), scaled(high, scale));
            let margin = if plot.map.is_some() { 0.0 } else { MARGIN };
            let spare = if high > low { margin * (high - low) } else { 0.5 };
            (low - spare, high + spare)
        };
        Self {
            x: range(0, plot.x.scale),
            y: range(1, plot.y.scale),
            scales: [plot.x.scale, plot.y.scale],
        }
    }

    fn at(&self, point: [f64; 2]) -> Option<[f64; 2]> {
        let [x, y] = [scaled(point[0], self.scales[0]), scaled(point[1], self.scales[1])];
        let place = [
            LEFT + (RIGHT - LEFT) * (x - self.x.0) / (self.x.1 - self.x.0),
            BOTTOM - (BOTTOM - TOP) * (y - self.y.0) / (self.y.1 - self.y.0),
        ];
        place.iter().all(|value| value.is_finite()).then_some(place)
    }

    fn axes(&self, plot: &Plot) -> String {
        let mut out = String::new();
        let faint = if plot.map.is_some() { "none" } else { "#ddd" };
        for (value, name) in plot.x.ticks(self.x) {
            let Some([x, _]) = self.at([value, unscaled(self.y.0, plot.y.scale)]) else {
                continue;
            };
            out += &segment([x, TOP], [x, BOTTOM], faint);
            out += &segment([x, BOTTOM], [x, BOTTOM + 5.0], "#333");
            out += &text([x, BOTTOM + 20.0], "middle", &name);
        }
        for (value, name) in plot.y.ticks(self.y) {
            let Some([_, y]) = self.at([unscaled(self.x.0, plot.x.scale), value]) else {
                continue;
            };
            out += &segment([LEFT, y], [RIGHT, y], faint);
            out += &segment([LEFT - 5.0, y], [LEFT, y], "#333");
            out += &text([LEFT - 9.0, y + 4.5], "end", &name);
        }
        let _ = writeln!(
            out,
            "<rect x=\"{LEFT}\" y=\"{TOP}\" width=\"{}\" height=\"{}\" fill=\"none\" stroke=\"#333\"/>",
            RIGHT - LEFT,
            BOTTOM - TOP
        );
        let middle = [(LEFT + RIGHT) / 2.0, (TOP + BOTTOM) / 2.0];
        out += &text([LEFT, TOP - 16.0], "start", &plot.title);
        out += &text([middle[0], BOTTOM + 42.0], "middle", &plot.x.label);
        let _ = writeln!(
            out,
            "<text transform=\"translate(20 {}) rotate(-90)\" text-anchor=\"middle\">{}</text>",
            middle[1],
            escaped(&plot.y.label)
        );
        out
    }

    fn series(&self, series: &Series, index: usize) -> String {
        let places: Vec<[f64; 2]> = series.points.iter().filter_map(|point| self.at(*point)).collect();
        let mut out = stroke(&places, series.style, index);
        out.extend(places.iter().map(|place| mark(*place, series.style, index)));
        out
    }

    /// Cells of one colour that are neighbours in a row are one rectangle.
    fn map(&self, map: &Map) -> String {
        let (low, high) = extent(map.rows.iter().flatten().copied());
        let band = |value: f64| {
            let share = (value - low) / (high - low).max(f64::MIN_POSITIVE);
            (share * f64::from(BAND_COUNT)).floor().min(f64::from(BAND_COUNT - 1))
        };
        let height = (BOTTOM - TOP) / map.rows.len().max(1) as f64;
        let mut out = String::from("<g shape-rendering=\"crispEdges\">\n");
        for (row, values) in map.rows.iter().enumerate() {
            let width = (RIGHT - LEFT) / values.len().max(1) as f64;
            let mut column = 0;
            for run in values.chunk_by(|a, b| band(*a) == band(*b)) {
                let _ = writeln!(
                    out,
                    "<rect x=\"{:.2}\" y=\"{:.2}\" width=\"{:.2}\" height=\"{:.2}\" fill=\"{}\"/>",
                    LEFT + width * column as f64,
                    BOTTOM - height * (row + 1) as f64,
                    width * run.len() as f64 + SEAM,
                    height + SEAM,
                    colour(band(run[0]) / f64::from(BAND_COUNT - 1)),
                );
                column += run.len();
            }
        }
        out += "</g>\n";
        out
    }
}

/// Round values from `range.0` to `range.1`, both as the scale has them.
pub(crate) fn ticks(range: (f64, f64), scale: Scale) -> Vec<f64> {
    if scale == Scale::Log {
        let factors: &[f64] = match range.1 - range.0 {
            decades if decades > 2.5 => &[1.0],
            decades if decades > 1.0 => &[1.0, 2.0, 5.0],
            _ => &[1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0],
        };
        let decades = range.0.floor() as i32..=range.1.ceil() as i32;
        let values = decades.flat_map(|decade| factors.iter().map(move |factor| factor * 10f64.powi(decade)));
        return values
            .filter(|value| (range.0..=range.1).contains(&value.log10()))
            .collect();
    }
    let rough = (range.1 - range.0) / TICK_COUNT;
    let decade = 10f64.powf(rough.log10().floor());
    let step = [1.0, 2.0, 5.0, 10.0].map(|factor| factor * decade);
    let step = step.into_iter().find(|step| *step >= rough).unwrap_or(decade);
    let (first, last) = ((range.0 / step).ceil() as i64, (range.1 / step).floor() as i64);
    (first..=last).map(|index| index as f64 * step).collect()
}

fn scaled(value: f64, scale: Scale) -> f64 {
    match scale {
        Scale::Linear => value,
        Scale::Log => value.log10(),
    }
}

fn unscaled(value: f64, scale: Scale) -> f64 {
    match scale {
        Scale::Linear => value,
        Scale::Log => 10f64.powf(value),
    }
}

fn extent(values: impl Iterator<Item = f64>) -> (f64, f64) {
    let mut values = values.filter(|value| value.is_finite());
    let first = values.next().unwrap_or(1.0);
    values.fold((first, first), |(low, high), value| (low.min(value), high.max(value)))
}

/// Three digits, without zeros at the end.
fn number(value: f64) -> String {
    if value == 0.0 {
        return "0".to_owned();
    }
    if !(1e-3..1e5).contains(&value.abs()) {
        return format!("{value:.0e}");
    }
    let digits = (2 - value.abs().log10().floor() as i32).max(0) as usize;
    let text = format!("{value:.digits$}");
    if text.contains('.') {
        return text.trim_end_matches('0').trim_end_matches('.').to_owned();
    }
    text
}

pub(crate) fn text(at: [f64; 2], anchor: &str, what: &str) -> String {
    format!(
        "<text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"{anchor}\">{}</text>\n",
        at[0],
        at[1],
        escaped(what)
    )
}

fn segment(from: [f64; 2], to: [f64; 2], stroke: &str) -> String {
    format!(
        "<line x1=\"{:.1}\" y1=\"{:.1}\" x2=\"{:.1}\" y2=\"{:.1}\" stroke=\"{stroke}\"/>\n",
        from[0], from[1], to[0], to[1]
    )
}

fn stroke(places: &[[f64; 2]], style: Style, index: usize) -> String {
    let (colour, width, dash) = match style {
        Style::Scatter | Style::Cloud => return String::new(),
        Style::Bound => ("#999", 5.0, ""),
        Style::Line | Style::Marked => (COLOURS[index % COLOURS.len()], 1.8, DASHES[index % DASHES.len()]),
    };
    let points: Vec<String> = places.iter().map(|[x, y]| format!("{x:.1},{y:.1}")).collect();
    format!(
        "<polyline points=\"{}\" fill=\"none\" stroke=\"{colour}\" stroke-width=\"{width}\" stroke-dasharray=\"{dash}\"/>\n",
        points.join(" ")
    )
}

/// What a series of this style has at each point.
fn mark([x, y]: [f64; 2], style: Style, index: usize) -> String {
    match style {
        Style::Line | Style::Bound => String::new(),
        Style::Marked | Style::Scatter => marker([x, y], index),
        Style::Cloud => {
            let colour = COLOURS[index % COLOURS.len()];
            format!("<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"2.2\" fill=\"{colour}\" fill-opacity=\"0.45\"/>\n")
        }
    }
}

/// A shape of about 9 pixels, another one for each index.
fn marker([x, y]: [f64; 2], index: usize) -> String {
    let colour = COLOURS[index % COLOURS.len()];
    let outline: &[[f64; 2]] = match index % 8 {
        0 => {
            return format!(
                "<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"4.5\" fill=\"{colour}\" stroke=\"white\" stroke-width=\"0.7\"/>\n"
            );
        }
        1 => &[[-4.0, -4.0], [4.0, -4.0], [4.0, 4.0], [-4.0, 4.0]],
        2 => &[[0.0, -5.0], [5.0, 4.0], [-5.0, 4.0]],
        3 => &[[0.0, 5.0], [5.0, -4.0], [-5.0, -4.0]],
        4 => &[[0.0, -5.5], [5.5, 0.0], [0.0, 5.5], [-5.5, 0.0]],
        5 => &[
            [-1.5, -5.0],
            [1.5, -5.0],
            [1.5, -1.5],
            [5.0, -1.5],
            [5.0, 1.5],
            [1.5, 1.5],
            [1.5, 5.0],
            [-1.5, 5.0],
            [-1.5, 1.5],
            [-5.0, 1.5],
            [-5.0, -1.5],
            [-1.5, -1.5],
        ],
        6 => &[
            [-5.0, -3.0],
            [-3.0, -5.0],
            [0.0, -2.0],
            [3.0, -5.0],
            [5.0, -3.0],
            [2.0, 0.0],
            [5.0, 3.0],
            [3.0, 5.0],
            [0.0, 2.0],
            [-3.0, 5.0],
            [-5.0, 3.0],
            [-2.0, 0.0],
        ],
        _ => &[
            [0.0, -6.5],
            [1.6, -1.6],
            [6.5, 0.0],
            [1.6, 1.6],
            [0.0, 6.5],
            [-1.6, 1.6],
            [-6.5, 0.0],
            [-1.6, -1.6],
        ],
    };
    let points: Vec<String> = outline
        .iter()
        .map(|[right, down]| format!("{:.1},{:.1}", x + right, y + down))
        .collect();
    format!(
        "<polygon points=\"{}\" fill=\"{colour}\" stroke=\"white\" stroke-width=\"0.7\"/>\n",
        points.join(" ")
    )
}

/// From dark blue (0) to pale yellow (1), lighter all the way.
fn colour(share: f64) -> String {
    let place = share.clamp(0.0, 1.0) * (RAMP.len() - 1) as f64;
    let index = (place as usize).min(RAMP.len() - 2);
    let [low, high] = [RAMP[index], RAMP[index + 1]];
    let mixed: [u8; 3] =
        std::array::from_fn(|channel| (low[channel] + (high[channel] - low[channel]) * (place - index as f64)) as u8);
    format!("#{:02x}{:02x}{:02x}", mixed[0], mixed[1], mixed[2])
}

fn escaped(what: &str) -> String {
    what.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;")
}

const WIDTH: f64 = 780.0;
const HEIGHT: f64 = 440.0;
const LEFT: f64 = 80.0;
const RIGHT: f64 = 560.0;
const TOP: f64 = 40.0;
const BOTTOM: f64 = 380.0;
/// Free room beyond the outermost values, over their range.
const MARGIN: f64 = 0.04;
/// About how many ticks an axis has.
const TICK_COUNT: f64 = 7.0;
/// By how much neighbours in a map overlap, so that nothing shows between them.
const SEAM: f64 = 0.4;
/// Colours of a map.
const BAND_COUNT: u32 = 20;
const RAMP: [[f64; 3]; 4] = [
    [20.0, 20.0, 80.0],
    [30.0, 110.0, 140.0],
    [110.0, 190.0, 110.0],
    [250.0, 245.0, 160.0],
];
pub(crate) const COLOURS: [&str; 8] = [
    "#1b6ca8", "#d1495b", "#2e8b57", "#b8860b", "#6a4c93", "#444444", "#e07a1f", "#0aa3a3",
];
const DASHES: [&str; 4] = ["", "7 3", "2 3", "9 3 2 3"];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_round_and_lie_in_their_range() {
        assert_eq!(ticks((0.0, 0.14), Scale::Linear).len(), 8);
        assert_eq!(
            ticks((-3.0, 11.0), Scale::Linear),
            [-2.0, 0.0, 2.0, 4.0, 6.0, 8.0, 10.0]
        );
        assert_eq!(ticks((-4.2, -0.8), Scale::Log), [1e-4, 1e-3, 1e-2, 1e-1]);
        let fine = ticks((0.9f64.log10(), 30f64.log10()), Scale::Log);
        assert_eq!(fine, [1.0, 2.0, 5.0, 10.0, 20.0]);
        let finest = ticks((0.55f64.log10(), 1.3f64.log10()), Scale::Log);
        assert_eq!(finest.len(), 3, "{finest:?}");
    }

    #[test]
    fn a_plot_has_its_series_and_every_tag_is_closed() {
        let plot = Plot {
            title: "a < b & c".to_owned(),
            x: Axis::linear("noise"),
            y: Axis::log("error"),
            series: vec![
                Series::new("first", Style::Marked, vec![[0.0, 0.1], [1.0, 1.0], [2.0, 0.0]]),
                Series::new("bound", Style::Bound, vec![[0.0, 0.01], [2.0, 0.02]]),
            ],
            map: Some(Map {
                label: "loss".to_owned(),
                x: [0.0, 2.0],
                y: [0.01, 1.0],
                rows: vec![vec![0.0, 1.0], vec![1.0, 1.0]],
            }),
        };
        let svg = plot.svg();
        for name in ["first", "bound", "noise", "error", "loss", "a &lt; b &amp; c"] {
            assert!(svg.contains(&format!(">{name}</text>")), "{name}");
        }
        // The point at zero has no place on a logarithmic axis: two markers and the legend's.
        assert_eq!(svg.matches("<circle").count(), 3);
        // Neighbours of one colour in a row are one rectangle.
        assert_eq!(
            svg.split("</g>").next().map(|map| map.matches("<rect").count()),
            Some(4)
        );
        let mut open = Vec::new();
        for tag in svg.split('<').skip(1) {
            let (tag, _) = tag.split_once('>').unwrap();
            let name = tag.split([' ', '/']).next().unwrap_or_default();
            if let Some(closed) = tag.strip_prefix('/') {
                assert_eq!(open.pop(), Some(closed));
            } else if !tag.ends_with('/') {
                open.push(name);
            }
            assert_eq!(tag.matches('"').count() % 2, 0, "{tag}");
        }
        assert!(open.is_empty(), "{open:?}");
    }
}
