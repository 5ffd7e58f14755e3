//! A frame as two pictures for people: depth and intensity, each with a legend.
//!
//! One picture pixel is one camera pixel; a strip on the right holds the legend. Colours are never the only sign: the
//! legend names them, and pixels without 3D have a colour that the depth scale does not have.

mod canvas;
mod font;
mod scale;

use super::capture::Capture;
use canvas::{Canvas, Rgb};
use scale::{DepthScale, depth_colour};

/// Two PNG files.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Pictures {
    /// Depth along z, coloured from dark (near) to bright (far), pixels without 3D grey.
    pub depth_png: Vec<u8>,
    /// Camera 1's picture in grey, saturated pixels red, other pixels without 3D bluish; `None` where it was not sent.
    pub intensity_png: Option<Vec<u8>>,
}

impl Pictures {
    /// Draws both.
    pub fn draw(capture: &Capture) -> Self {
        Self {
            depth_png: draw_depth(capture).encode(),
            intensity_png: capture
                .intensity
                .as_deref()
                .map(|intensity| draw_intensity(capture, intensity).encode()),
        }
    }
}

fn draw_depth(capture: &Capture) -> Canvas {
    let depths_mm: Vec<f32> = capture
        .grid()
        .points()
        .map(|point| point.map_or(f32::NAN, |[_, _, z]| z))
        .collect();
    let scale = DepthScale::of(&depths_mm);
    let mut canvas = blank(capture);
    for (index, &depth_mm) in depths_mm.iter().enumerate() {
        let colour = match depth_mm.is_nan() {
            true => NO_DEPTH,
            false => depth_colour(scale.share(f64::from(depth_mm))),
        };
        put(&mut canvas, capture, index, colour);
    }
    let left = capture.width_px as usize + MARGIN_PX;
    canvas.text(left, MARGIN_PX, "DEPTH MM");
    let (top, height) = (MARGIN_PX + 2 * LINE_PX, canvas.height() - MARGIN_PX - 4 * LINE_PX);
    for row in 0..height {
        let colour = depth_colour(row as f64 / (height - 1) as f64);
        canvas.fill(left, top + row, BAR_PX, 1, colour);
    }
    let last = TICK_COUNT - 1;
    for tick in 0..TICK_COUNT {
        let row = top + tick * (height - 1) / last;
        canvas.fill(left + BAR_PX, row, TICK_PX, 1, INK);
        let label = scale.label(tick as f64 / last as f64);
        canvas.text(
            left + BAR_PX + 2 * TICK_PX,
            row.saturating_sub(font::HEIGHT_PX / 2),
            &label,
        );
    }
    canvas.swatch(left, top + height + LINE_PX / 2, NO_DEPTH, "NO 3D");
    canvas
}

fn draw_intensity(capture: &Capture, intensity: &[u8]) -> Canvas {
    let mut canvas = blank(capture);
    for (index, (&grey, &mask)) in intensity.iter().zip(&capture.mask).enumerate() {
        let colour = match mask {
            mask if mask & MASK_SATURATED != 0 => SATURATED,
            mask if mask & MASK_INVALID != 0 => [grey / 2, grey / 2, 96 + grey / 2],
            _ => [grey; 3],
        };
        put(&mut canvas, capture, index, colour);
    }
    let left = capture.width_px as usize + MARGIN_PX;
    canvas.text(left, MARGIN_PX, "INTENSITY");
    let rows = [
        ([255; 3], "255"),
        ([128; 3], "128"),
        ([0; 3], "0"),
        (SATURATED, "SATURATED"),
        ([48, 48, 144], "NO 3D"),
    ];
    for (row, (colour, label)) in rows.into_iter().enumerate() {
        canvas.swatch(left, MARGIN_PX + (row + 2) * LINE_PX, colour, label);
    }
    canvas
}

fn blank(capture: &Capture) -> Canvas {
    let (width, height) = (capture.width_px as usize, capture.height_px as usize);
    Canvas::new(width + LEGEND_PX, height.max(LEGEND_HEIGHT_PX), PAPER)
}

fn put(canvas: &mut Canvas, capture: &Capture, index: usize, colour: Rgb) {
    let width = capture.width_px as usize;
    canvas.fill(index % width, index / width, 1, 1, colour);
}

const MASK_INVALID: u8 = 1;
const MASK_SATURATED: u8 = 2;
const PAPER: Rgb = [255; 3];
const INK: Rgb = [0; 3];
/// Light neutral grey: the depth scale has no neutral colour.
const NO_DEPTH: Rgb = [190; 3];
const SATURATED: Rgb = [230, 30, 30];
const MARGIN_PX: usize = 10;
const LINE_PX: usize = 18;
const BAR_PX: usize = 18;
const TICK_PX: usize = 4;
const TICK_COUNT: usize = 5;
const LEGEND_PX: usize = 110;
const LEGEND_HEIGHT_PX: usize = 200;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::capture::CapturedPoints;
    use crate::camera::message::TriggerId;

    /// 3 x 1 pixels: near, far, and one without 3D that is saturated.
    pub(super) fn capture() -> Capture {
        let points = [[0.0, 0.0, 300.0], [1.0, 0.0, 310.0], [f32::NAN; 3]];
        Capture {
            trigger_id: TriggerId(0),
            width_px: 3,
            height_px: 1,
            valid_count: 2,
            saturated_count: 1,
            points: CapturedPoints::Xyz(
                points
                    .iter()
                    .flatten()
                    .flat_map(|value: &f32| value.to_le_bytes())
                    .collect(),
            ),
            intensity: Some(vec![100, 200, 255]),
            confidence: None,
            mask: vec![0, 0, MASK_INVALID | MASK_SATURATED],
        }
    }

    #[test]
    fn near_is_darker_than_far_and_no_3d_is_neither() {
        let canvas = draw_depth(&capture());
        assert_eq!(canvas.at(0, 0), depth_colour(0.0));
        assert_eq!(canvas.at(1, 0), depth_colour(1.0));
        assert_eq!(canvas.at(2, 0), NO_DEPTH);
    }

    #[test]
    fn saturated_pixels_are_marked_over_the_grey() {
        let canvas = draw_intensity(&capture(), &[100, 200, 255]);
        assert_eq!([0, 1, 2].map(|x| canvas.at(x, 0)), [[100; 3], [200; 3], SATURATED]);
    }

    #[test]
    fn the_png_has_the_size_of_the_frame_and_its_legend() {
        let pictures = Pictures::draw(&capture());
        for bytes in [pictures.depth_png, pictures.intensity_png.unwrap()] {
            let decoder = png::Decoder::new(std::io::Cursor::new(bytes));
            let info = decoder.read_info().unwrap();
            let size = (info.info().width as usize, info.info().height as usize);
            assert_eq!(size, (3 + LEGEND_PX, LEGEND_HEIGHT_PX));
        }
    }

    #[test]
    fn a_frame_without_a_point_is_drawn_too() {
        let mut capture = capture();
        capture.mask = vec![MASK_INVALID; 3];
        let canvas = draw_depth(&capture);
        assert_eq!([0, 1, 2].map(|x| canvas.at(x, 0)), [NO_DEPTH; 3]);
    }
}
