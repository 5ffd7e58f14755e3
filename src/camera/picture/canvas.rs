//! Pixels to draw on.

use super::font;

/// Red, green, blue.
pub(super) type Rgb = [u8; 3];

/// A picture in the making, rows from the top.
#[derive(Debug)]
pub(super) struct Canvas {
    width: usize,
    pixels: Vec<Rgb>,
}

impl Canvas {
    pub(super) fn new(width: usize, height: usize, paper: Rgb) -> Self {
        Self {
            width,
            pixels: vec![paper; width * height],
        }
    }

    pub(super) fn height(&self) -> usize {
        self.pixels.len() / self.width
    }

    /// A filled rectangle; what lies outside is left out.
    pub(super) fn fill(&mut self, left: usize, top: usize, width: usize, height: usize, colour: Rgb) {
        let (right, bottom) = ((left + width).min(self.width), (top + height).min(self.height()));
        for y in top..bottom {
            self.pixels[y * self.width..][left.min(right)..right].fill(colour);
        }
    }

    /// Black capitals, digits and signs; characters without a shape leave a gap.
    pub(super) fn text(&mut self, left: usize, top: usize, text: &str) {
        for (place, letter) in text.chars().enumerate() {
            for (x, y) in font::dots(letter) {
                let corner = (
                    left + place * font::ADVANCE_PX + x * font::DOT_PX,
                    top + y * font::DOT_PX,
                );
                self.fill(corner.0, corner.1, font::DOT_PX, font::DOT_PX, [0; 3]);
            }
        }
    }

    /// A square of a colour, framed, and what it means.
    pub(super) fn swatch(&mut self, left: usize, top: usize, colour: Rgb, meaning: &str) {
        self.fill(left, top, font::HEIGHT_PX + 2, font::HEIGHT_PX + 2, [0; 3]);
        self.fill(left + 1, top + 1, font::HEIGHT_PX, font::HEIGHT_PX, colour);
        self.text(left + font::HEIGHT_PX + 8, top + 1, meaning);
    }

    #[cfg(test)]
    pub(super) fn at(&self, x: usize, y: usize) -> Rgb {
        self.pixels[y * self.width + x]
    }

    /// The bytes of a PNG file, 8 bits per channel.
    pub(super) fn encode(&self) -> Vec<u8> {
        let mut bytes = Vec::new();
        let mut encoder = png::Encoder::new(&mut bytes, self.width as u32, self.height() as u32);
        encoder.set_color(png::ColorType::Rgb);
        encoder.set_depth(png::BitDepth::Eight);
        let mut writer = encoder.write_header().expect("a vector takes every byte");
        let pixels = self.pixels.as_flattened();
        writer
            .write_image_data(pixels)
            .expect("the count of bytes is that of the header");
        writer.finish().expect("a vector takes every byte");
        bytes
    }
}
