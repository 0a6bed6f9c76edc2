//! The colour bar below a picture.
//!
//! ```text
//!     [==========|==========]
//!     |          |          |
//!   -0.3         0         0.3
//!       mean curvature (1/mm)
//! ```

use super::colours::ColourMap;
use super::glyphs;
use super::image::{Image, srgb};

const INK: [u8; 3] = [60, 60, 60];

/// Share of the picture's width that the bar takes.
const LENGTH: f64 = 0.45;

/// What the bar explains.
pub struct Bar {
    /// The colours.
    pub colours: ColourMap,
    /// Below the bar.
    pub title: String,
}

/// Pixels of a dot of the font, and of the lines, in a picture of this width.
fn dot(width: usize) -> usize {
    (width / 400).max(1)
}

/// Height of the bar with its texts and the room around them, in a picture of this width.
pub(super) fn height(width: usize) -> usize {
    46 * dot(width)
}

impl Bar {
    /// Draws it into a part of a picture that begins at `left` and is `width` wide, at the bottom.
    pub(super) fn draw(&self, image: &mut Image, left: usize, width: usize) {
        let [_, image_height] = image.size();
        let dot = dot(width);
        // Odd, so that the middle of the scale is in the middle of a pixel.
        let length = (width as f64 * LENGTH) as usize | 1;
        let left = left + (width - length) / 2;
        let mut top = image_height - height(width);
        let thickness = 8 * dot;
        image.fill(
            [left - dot, top - dot],
            [length + 2 * dot, thickness + 2 * dot],
            INK,
        );
        let [low, high] = self.colours.ends();
        for x in 0..length {
            let share = (x as f32 + 0.5) / length as f32;
            let colour = srgb(self.colours.colour(low + share * (high - low)));
            image.fill([left + x, top], [1, thickness], colour);
        }
        top += thickness + dot;
        for (x, share) in [(0, 0.0), (length / 2, 0.5), (length - 1, 1.0)] {
            let centre = left + x;
            image.fill([centre - dot / 2, top], [dot, 3 * dot], INK);
            let value = number(low + share * (high - low));
            text(image, [centre, top + 5 * dot], &value, dot);
        }
        text(image, [left + length / 2, top + 18 * dot], &self.title, dot);
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
