//! What is written on a picture: the time, what the colours mean, how long something is.

use noto_sans_mono_bitmap::{FontWeight, RasterHeight, get_raster, get_raster_width};

use super::{Image, Rgb};

/// Characters of one size, in one colour.
#[derive(Clone, Copy)]
pub(super) struct Pen {
    size: RasterHeight,
    colour: Rgb,
}

impl Pen {
    /// A size for a picture, and a colour to be read on its background.
    pub(super) fn on(image: &Image, background: Rgb) -> Self {
        let size = match image.height_px {
            0..=599 => RasterHeight::Size16,
            600..=1199 => RasterHeight::Size24,
            _ => RasterHeight::Size32,
        };
        let [red, green, blue] = background.map(u32::from);
        let is_light = 2 * red + 5 * green + blue > 8 * 128;
        Self { size, colour: if is_light { [45, 50, 60] } else { [225, 228, 232] } }
    }

    /// The same size, to be read on what is light, whatever the background.
    pub(super) fn dark(image: &Image) -> Self {
        Self::on(image, [255; 3])
    }

    /// Height of a line, pixels.
    pub(super) fn line_px(&self) -> usize {
        self.size.val()
    }

    /// Width of a text, pixels.
    pub(super) fn width_px(&self, text: &str) -> usize {
        text.chars().count() * get_raster_width(FontWeight::Regular, self.size)
    }

    /// Writes with the upper left corner at a pixel. Characters that the font does not have are question marks.
    pub(super) fn write(&self, image: &mut Image, [left, top]: [usize; 2], text: &str) {
        let raster = |character| get_raster(character, FontWeight::Regular, self.size);
        let glyphs = text.chars().filter_map(|character| raster(character).or_else(|| raster('?')));
        for (place, glyph) in glyphs.enumerate() {
            for (row, line) in glyph.rows().enumerate() {
                for (column, cover) in line.iter().enumerate() {
                    image.blend([left + place * glyph.width() + column, top + row], self.colour, *cover);
                }
            }
        }
    }

    /// A bar from the colour of 0 to that of 1, its ends named, with the lower right corner at a pixel.
    pub(super) fn scale(
        &self,
        image: &mut Image,
        corner: [usize; 2],
        ends: [&str; 2],
        colour: impl Fn(f64) -> Rgb,
    ) {
        let (line, width) = (self.line_px(), 9 * self.line_px());
        let (left, top) = (corner[0].saturating_sub(width), corner[1].saturating_sub(line + 2 * line / 3));
        for column in 0..width {
            let colour = colour(column as f64 / (width - 1) as f64);
            for row in 0..line / 2 {
                image.blend([left + column, top + row], colour, 255);
            }
        }
        let below = top + 2 * line / 3;
        self.write(image, [left, below], ends[0]);
        self.write(image, [corner[0].saturating_sub(self.width_px(ends[1])), below], ends[1]);
    }

    /// Coloured squares with names, one below the other, with the lower right corner at a pixel.
    pub(super) fn key(&self, image: &mut Image, corner: [usize; 2], entries: &[(Rgb, String)]) {
        let line = self.line_px() + self.line_px() / 4;
        let width = entries.iter().map(|(_, name)| self.width_px(name)).max().unwrap_or(0);
        let left = corner[0].saturating_sub(width);
        for (place, (colour, name)) in entries.iter().enumerate() {
            let top = corner[1].saturating_sub((entries.len() - place) * line);
            let square = self.line_px() / 2;
            for pixel in 0..square * square {
                let at =
                    [left.saturating_sub(2 * square) + pixel % square, top + square / 2 + pixel / square];
                image.blend(at, *colour, 255);
            }
            self.write(image, [left, top], name);
        }
    }
}
