//! Pictures side by side, with titles and colour bars.

use super::bar::{self, Bar};
use super::glyphs;
use super::image::Image;

const INK: [u8; 3] = [40, 40, 40];

/// Pixels of a dot of the titles.
const DOT: usize = 2;

/// Height of a line of titles.
const LINE: usize = (glyphs::GLYPH[1] + 5) * DOT;

/// Rows of pictures of one width.
pub struct Montage {
    /// Above each column.
    pub columns: Vec<String>,
    /// Above each row, and its pictures.
    pub rows: Vec<(String, Vec<Image>)>,
    /// Below all, side by side.
    pub bars: Vec<Bar>,
}

impl Montage {
    /// One picture of all; each row is as high as its highest.
    #[must_use]
    pub fn image(&self) -> Image {
        let all = || self.rows.iter().flat_map(|(_, images)| images);
        let cell = all().map(|image| image.size()[0]).max().unwrap_or(1);
        let columns = self.rows.iter().map(|(_, images)| images.len()).max();
        let width = cell * columns.unwrap_or(1).max(1);
        let row_height = |images: &[Image]| images.iter().map(|i| i.size()[1]).max().unwrap_or(0);
        let rows: usize = self
            .rows
            .iter()
            .map(|(_, images)| LINE + row_height(images))
            .sum();
        let bar_width = width / self.bars.len().max(1);
        let bars = if self.bars.is_empty() {
            0
        } else {
            // The frame of a bar reaches a little above it.
            bar::height(bar_width) + LINE / 2
        };
        let mut whole = Image::white([width, LINE + rows + bars]);
        for (i, title) in self.columns.iter().enumerate() {
            let left = i * cell + cell.saturating_sub(glyphs::width(title) * DOT) / 2;
            glyphs::draw(&mut whole, [left, DOT * 2], title, DOT, INK);
        }
        let mut top = LINE;
        for (title, images) in &self.rows {
            glyphs::draw(&mut whole, [DOT * 4, top + DOT * 2], title, DOT, INK);
            top += LINE;
            let height = row_height(images);
            for (i, image) in images.iter().enumerate() {
                let [w, h] = image.size();
                whole.paste([i * cell + (cell - w) / 2, top + (height - h) / 2], image);
            }
            top += height;
        }
        for (i, bar) in self.bars.iter().enumerate() {
            bar.draw(&mut whole, i * bar_width, bar_width);
        }
        whole
    }
}
