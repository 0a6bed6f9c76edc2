//! The colour bar below a picture.
//!
//! ```text
//!     [==========|==========]
//!     |          |          |
//!   -0.3         0         0.3
//!       mean curvature (1/mm)
//! ```

use curvox::sink::Palette;

use super::glyphs;
use super::image::{Image, srgb};

const INK: [u8; 3] = [60, 60, 60];

/// Share of the picture's width that the bar takes.
const LENGTH: f64 = 0.45;

/// What the bar explains.
pub(super) struct Bar<'a> {
    pub(super) palette: Palette,
    /// The scale runs from minus to plus this.
    pub(super) range: f32,
    /// Below the bar.
    pub(super) title: &'a str,
}

/// Pixels of a dot of the font, and of the lines, in a picture of this width.
fn dot(width: usize) -> usize {
    (width / 400).max(1)
}

/// Height of the bar with its texts and the room around them, in a picture of this width.
pub(super) fn height(width: usize) -> usize {
    46 * dot(width)
}

impl Bar<'_> {
    /// Draws it at the bottom of a picture.
    pub(super) fn draw(&self, image: &mut Image) {
        let [width, image_height] = image.size();
        let dot = dot(width);
        // Odd, so that 0 is in the middle of a pixel.
        let length = (width as f64 * LENGTH) as usize | 1;
        let left = (width - length) / 2;
        let mut top = image_height - height(width);
        let thickness = 8 * dot;
        image.fill(
            [left - dot, top - dot],
            [length + 2 * dot, thickness + 2 * dot],
            INK,
        );
        for x in 0..length {
            let share = 2.0 * (x as f32 + 0.5) / length as f32 - 1.0;
            let colour = srgb(self.palette.colour(share * self.range, self.range));
            image.fill([left + x, top], [1, thickness], colour);
        }
        top += thickness + dot;
        let ticks = [
            (0, -self.range),
            (length / 2, 0.0),
            (length - 1, self.range),
        ];
        for (x, value) in ticks {
            let centre = left + x;
            image.fill([centre - dot / 2, top], [dot, 3 * dot], INK);
            text(image, [centre, top + 5 * dot], &number(value), dot);
        }
        text(image, [left + length / 2, top + 18 * dot], self.title, dot);
    }
}

/// Draws a text whose middle is at the given x, at least partly within the picture.
fn text(image: &mut Image, at: [usize; 2], text: &str, dot: usize) {
    let left = at[0].saturating_sub(glyphs::width(text) * dot / 2);
    glyphs::draw(image, [left, at[1]], text, dot, INK);
}

/// A number in three significant digits, without needless zeros.
pub(super) fn number(value: f32) -> String {
    // The nearest value of three digits: printing it shows no more.
    let rounded: f32 = format!("{value:.2e}").parse().unwrap_or(value);
    if rounded != 0.0 && !(1e-3..1e5).contains(&rounded.abs()) {
        format!("{rounded:e}")
    } else {
        format!("{rounded}")
    }
}
